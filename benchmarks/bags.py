"""Bags of ROS messages: messages per second from arrays to a file, and megabytes per minute of an episode.

    python benchmarks/bags.py --out benchmarks/results/bags.json

The steps are simulated first and are not in the time. One process, one core. The share of the markers is the
time that a bag without them saves.
"""

import dataclasses
import os
import platform
import tempfile
import time
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
from options import Option, parse
from timing import Stopwatch, write_json

import sean_jax
from sean_jax import sensors
from sean_jax.core.data_types import Scenario
from sean_jax.io.versions import versions
from sean_jax.ros import bag_writing, messages

STEPS = 100


def written(
    scenario: Scenario, steps: list[messages.StepValues], table: dict[str, messages.Topic], version: Literal["1", "2"]
) -> tuple[int, float, int]:
    """Number of messages, s of the processor, and bytes of a bag of these steps."""
    with tempfile.TemporaryDirectory() as folder:
        watch = Stopwatch(time.process_time)
        with bag_writing.Bag(Path(folder), "episode", table, version) as bag:
            for step in steps:
                now = round(int(step.tick) * scenario.time_step * messages.SECOND) + messages.SECOND
                bag.write(messages.messages(table, step, now), now)
        seconds = watch.seconds
        return bag.count, seconds, sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())


def main() -> None:
    """Measure, print and write."""
    options = parse(
        __doc__,
        environment="lab",
        people=12,
        out=Option(None, kind=Path),
    )
    scenario = sean_jax.make(options.environment, people=options.people)
    scenario = dataclasses.replace(scenario, sensors=(sensors.SENSORS["lidar"](scenario.robot),))

    def one(state, _):  # noqa: ANN001, ANN202
        command = jnp.asarray([0.3, 0.1])
        state = sean_jax.step(scenario, state, command)
        return state, messages.step(scenario, state, command)

    run = jax.jit(lambda key: jax.lax.scan(one, sean_jax.reset(scenario, key), length=STEPS)[1])
    stacked = jax.device_get(run(jax.random.key(0)))
    steps = [jax.tree.map(lambda leaf: leaf[t], stacked) for t in range(STEPS)]  # noqa: B023
    table = messages.topics(scenario)
    rows = {}
    for version, name in (("1", "rosbag 1"), ("2", "rosbag2 MCAP")):
        count, seconds, size = written(scenario, steps, table, version)
        without = {topic: recorder for topic, recorder in table.items() if topic != "/markers"}
        rows[name] = {
            "messages per second": round(count / seconds),
            "times real time": round(STEPS * scenario.time_step / seconds, 1),
            "MB per minute": round(60 * size / 1e6 / (STEPS * scenario.time_step), 1),
            "share of markers": round(1 - written(scenario, steps, without, version)[1] / seconds, 2),
        }
        print(name, rows[name])
    if options.out is not None:
        about = {"environment": options.environment, "people": scenario.people, "topics": len(table)}
        machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
        content = {
            "command": "python benchmarks/bags.py",
            **about,
            **machine,
            "versions": versions() | {"rosbags": version_of("rosbags")},
            "bags": rows,
        }
        write_json(options.out, content)


if __name__ == "__main__":
    main()

"""Updates of ``sean train ppo`` on one device and on several: scenario-steps/s of all agents, and what a card adds.

    python benchmarks/ppo_devices.py --agents 4 --scenarios 4096 8192 --epochs 2

Each number of devices is measured in this program, after the other, on the same state of a training. ``chained`` has no
host between updates; ``read`` reads the log of each update before the next, as a training does.
"""

import json

import jax
from options import Option, parse
from timing import stopwatch

from sean_jax.config import PPOConfig
from sean_jax.core import devices
from sean_jax.learning import reinforcement


def measure(options: PPOConfig, count: int, updates: int) -> dict:
    """Seconds of an update on that many devices, and of its compilation."""
    jax.devices = lambda *_: DEVICES[:count]  # a training takes all that it sees
    setting = reinforcement.build(options)
    layout = reinforcement.device_layout(options.seeds)
    programs = reinforcement.programs(options, setting.network, layout)
    envs, _ = reinforcement.draw_starts(options, setting.scenarios, setting.envs)
    state = programs.begin(envs, reinforcement._first_agents(options, setting))
    state = devices.place(state, reinforcement.placement(layout))
    envs = devices.replicate(layout.mesh, envs)

    with stopwatch() as compiling:
        state, log = jax.block_until_ready(programs.update(envs, state))

    with stopwatch() as chained:
        for _ in range(updates):
            state, log = programs.update(envs, state)
        jax.block_until_ready(state)

    with stopwatch() as read:
        for _ in range(updates):
            state, log = programs.update(envs, state)
            jax.device_get(log)

    return {
        "devices": layout.mesh.size,
        "compiling": compiling.seconds,
        "chained": chained.seconds / updates,
        "read": read.seconds / updates,
    }


def main() -> None:
    """Measure each number of scenarios on each number of devices."""
    arguments = parse(
        __doc__,
        agents=4,
        scenarios=[4096],
        epochs=2,
        environment="warehouse",
        pool=4096,
        devices=Option([1, len(DEVICES)], kind=int),
        updates=20,
        out=Option(None, "file of JSON lines that results are added to"),
    )
    for scenarios in arguments.scenarios:
        first = None
        for count in arguments.devices:
            options = PPOConfig(
                method="ppo",
                environment=arguments.environment,
                scenarios=scenarios,
                seeds=arguments.agents,
                epochs=arguments.epochs,
                pool=arguments.pool,
            )
            row = measure(options, count, arguments.updates)
            steps = arguments.agents * scenarios * options.horizon
            first = first or row["read"]
            row |= {"agents": arguments.agents, "scenarios": scenarios, "device": DEVICES[0].device_kind}
            row |= {"steps_per_second": steps / row["read"], "times_one": first / row["read"]}
            print(json.dumps(row), flush=True)
            if arguments.out:
                with open(arguments.out, "a", encoding="utf-8") as stream:
                    stream.write(json.dumps(row) + "\n")


DEVICES = jax.devices()

if __name__ == "__main__":
    main()

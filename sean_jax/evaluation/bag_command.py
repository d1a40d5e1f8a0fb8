"""``sean export bag``: simulate episodes of a folder again, and write them as bags of ROS messages."""

import functools
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import struct
from jaxtyping import Bool
from rich.console import Console

from sean_jax import sensors
from sean_jax.config import ExportBagConfig
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.evaluation.replay_command import read_source, until_terminated, with_progress
from sean_jax.io import files, writing
from sean_jax.io.progress import progress
from sean_jax.ros import bag_writing, messages
from sean_jax.simulation.episode_runner import Record, Runner
from sean_jax.simulation.scenario_stack import Stack

CHUNK = 2.0  # s of messages in memory
VIEW = Path(__file__).parents[1] / "ros" / "view.rviz"


@struct.dataclass
class BagRow:
    """A step of the episodes of a batch."""

    step: messages.StepValues
    active: Bool[Array, "B"]


def write(options: ExportBagConfig, console: Console) -> tuple[Path, int]:
    """Simulate the episodes and write their bags; the folder and the number of messages.

    Raises:
        InputError: the folder has no episodes, or none of that number, or a sensor is unknown.
        FloatingPointError: a number is not finite.
    """
    bag_writing.check_package()
    writing.check_new_folder(options.out)
    numbers = list(dict.fromkeys(options.episodes))
    with console.status("preparing the scenario"):
        source = read_source(options.source, numbers)
        if source.robots > 1:
            raise InputError(f"{options.source}: has a team of robots; a bag is of one robot; give a run with one.")
        floors = [with_sensors(each, options.sensors) for each in source.floors]
    record = Record(lambda *_: (), _rows)
    record = record if source.ends is None else until_terminated(record, source.ends)
    runner = Runner(floors, source.policy, 1, source.use, record, chunk=CHUNK)

    count = 0
    with progress(console) as bar, writing.atomic_folder(options.out) as folder:
        for number, callbacks in with_progress(runner, numbers, bar):
            scenario = floors[source.turn(number)].at(source.place(number))
            table = messages.topics(scenario, options.naming, number)
            with bag_writing.Bag(folder, f"episode_{number}", table, options.ros) as bag:
                callbacks.rows = functools.partial(_add, bag, scenario)
                source.run(runner, number, callbacks, keep_rows=False)
            count += bag.count
        writing.write(folder / VIEW.name, files.read_text(VIEW))
    return options.out, count


def with_sensors(floors: Stack[Scenario], names: str | None) -> Stack[Scenario]:
    """The floors with more sensors: those of the names, or without names the robot's lidar if it has one.

    Raises:
        InputError: a sensor is unknown, or the robot lacks its mount.
    """
    member = floors.member
    robot = member.robot
    own = {sensor.name for sensor in member.sensors}
    if names is None:
        more = ["lidar"] if any(mount.name == "lidar" for mount in robot.mounts) else []
    else:
        more = [name.strip() for name in names.split(",") if name.strip() not in ("", "none")]
    made = [sensor for sensor in sensors.as_sensors(more, robot) if sensor.name not in own]
    return floors.with_fields(sensors=(*member.sensors, *made)) if made else floors


def _rows(
    floors: Stack[Scenario], before: State, after: State, actions: Array, active: Array, total: Any
) -> tuple[Any, BagRow]:
    return total, BagRow(floors.vmap(messages.step)(after, actions[-1]), active)


def _add(bag: bag_writing.Bag, scenario: Scenario, rows: BagRow) -> None:
    """Write the messages of a chunk of time (T, 1, ...) until the episode's end."""
    for t in np.flatnonzero(rows.active[:, 0]):
        step = jax.tree.map(lambda leaf, t=int(t): leaf[t, 0], rows.step)
        time = messages.BEGIN + round(int(step.tick) * scenario.time_step * messages.SECOND)
        if bag.count == 0:
            bag.write(messages.messages(bag.table, step, time, latched=True), time)
        bag.write(messages.messages(bag.table, step, time), time)

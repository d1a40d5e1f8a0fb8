"""The paper's protocol of data collection (section V-B): which demonstrations get how much of the time.

Random people: one task for all the time. Handcrafted people: each of the five situations for a fifth of it. The
Behavior Graph: half of it joining groups, half of it leaving them. A part of the time is a stream of episodes.
"""

import dataclasses
import math
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from sean_jax import assembly, files, robots, sensors
from sean_jax.base import Policy, Scenario
from sean_jax.learning.options import Collect, Refused
from sean_jax.policies import POLICIES


@dataclasses.dataclass(frozen=True)
class Stream:
    """Episodes of one kind. The scenarios of all streams differ in leaves alone, and by which task it is."""

    name: str
    scenario: Scenario
    turn: int  # which of the tasks


def check(options: Collect) -> None:
    """Refuse all that can be told before a scenario is made. Raises Refused."""
    who_drives(options.driver)
    try:
        assembly.check(options.environment, **_parts(options))
        for task in options.tasks[1:]:
            assembly.check_task(task, options.behavior)
        robot = robots.load(options.robot, "twin")
        sensors.camera(robot, "depth", width=options.width, height=options.height)
    except ValueError as error:
        raise Refused(str(error)) from error


def _parts(options: Collect) -> dict[str, Any]:
    """What ``make`` and ``assembly.check`` are told beside the environment."""
    return {
        "behavior": options.behavior,
        "task": options.tasks[0],
        "robot": options.robot,
        "people": options.people,
        "parties": options.parties,
        "paths": options.paths,
        "spreading": options.spreading,
        "model": options.model,
        "forces": options.forces,
        "dynamics": options.dynamics,
        "handcrafted": options.handcrafted,
        "situations": options.situations,
    }


def streams(options: Collect) -> tuple[list[Stream], tuple]:
    """What takes part, and the functions of the tasks. Raises Refused for what does not exist or go together."""
    try:
        first = assembly.make(options.environment, **_parts(options), time_limit=options.time_limit)
        scenarios = [first, *(assembly.with_task(first, task) for task in options.tasks[1:])]
    except ValueError as error:
        raise Refused(str(error)) from error
    first = replace(first, metrics=())  # nobody asks for them here
    tasks = tuple(scenario.task for scenario in scenarios)
    if options.behavior == "handcrafted" and options.handcrafted is None and options.tasks == ("handcrafted",):
        names = dict.fromkeys(first.behavior.data.situations)
        return [Stream(name, _only(first, name), 0) for name in names], tasks
    return [Stream(each.task_name, first, turn) for turn, each in enumerate(scenarios)], tasks


def _only(scenario: Scenario, situation: str) -> Scenario:
    """The scenario with the handcrafted sets of that situation alone: their weights differ, and nothing else."""
    sets = scenario.behavior.data
    chosen = np.array([held == situation for held in sets.situations])
    weight = jnp.where(jnp.asarray(chosen)[:, None, None], sets.weight, 0.0)
    return replace(scenario, behavior=replace(scenario.behavior, data=replace(sets, weight=weight)))


def who_drives(name: str, option: str = "--driver") -> Policy:
    """The policy of that name. Raises Refused if there is none."""
    if name not in POLICIES:
        raise Refused(f"{option}: '{name}' is not one of {', '.join(POLICIES)}{files.suggest(name, POLICIES) or '.'}")
    return POLICIES[name]


def share(hours: float, number: int) -> int:
    """Seconds of each of so many streams."""
    return math.ceil(3600.0 * hours / number - 1e-6)


def next_stream(recorded: list[int], wanted: int) -> int | None:
    """The stream of which least is recorded [s]; None when each has what is wanted [s].

    It does not depend on how much is wanted, so a dataset that is made longer later equals one made at once.
    """
    least = min(range(len(recorded)), key=lambda stream: (recorded[stream], stream))
    return None if recorded[least] >= wanted else least

"""The paper's protocol of data collection (section V-B): which demonstrations get how much of the time.

Random people: one task for all the time. Handcrafted people: each of the five situations for a fifth of it. The
Behavior Graph: half of it joining groups, half of it leaving them. A part of the time is a stream of episodes.
"""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from sean_jax import assembly, robots, sensors
from sean_jax.base import Scenario
from sean_jax.config import CollectConfig, HandcraftedBehavior, OwnPart, Value
from sean_jax.errors import InputError
from sean_jax.learning import choice


def check(config: CollectConfig) -> None:
    """Refuse all that can be told before a scenario is made.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    choice.check(config.policy, config)
    if config.labels is not None:
        choice.check(config.labels, config, "labels")
    assembly.check(config)
    if isinstance(config.robot, OwnPart | Value):
        return
    try:
        robot = robots.load(config.robot.kind, "twin")
        sensors.camera(robot, "depth", width=config.width, height=config.height)
    except ValueError as error:
        raise InputError(str(error)) from error


def streams(config: CollectConfig) -> dict[str, Scenario]:
    """What takes part.

    Returns:
        Name of a stream -> its scenario. They differ in their leaves and their task alone.

    Raises:
        InputError: one sentence for what does not exist or go together.
    """
    scenarios = [replace(scenario, metrics=()) for scenario in assembly.build(config)]  # nobody asks for them here
    first = scenarios[0]
    if isinstance(config.behavior, HandcraftedBehavior) and [each.task_name for each in scenarios] == ["handcrafted"]:
        situations = dict.fromkeys(first.behavior.data.situations)
        if len(situations) > 1:
            return {name: _only(first, name) for name in situations}
    return {scenario.task_name: scenario for scenario in scenarios}


def _only(scenario: Scenario, situation: str) -> Scenario:
    """The scenario with the handcrafted sets of that situation alone: their odds differ, and nothing else."""
    sets = scenario.behavior.data
    chosen = np.array([name == situation for name in sets.situations])
    odds = jnp.where(jnp.asarray(chosen)[:, None, None], sets.odds, 0.0)
    return replace(scenario, behavior=replace(scenario.behavior, data=replace(sets, odds=odds)))


def seconds_of_each(hours: float, number: int) -> int:
    """How long each of some streams is recorded."""
    return math.ceil(3600.0 * hours / number - 1e-6)


def next_stream(recorded: list[int], wanted: int) -> int | None:
    """The stream of which least is recorded.

    It does not depend on how much is wanted, so a dataset that is made longer later equals one made at once.

    Returns:
        Its index; None when each has what is wanted.
    """
    shortest = min(range(len(recorded)), key=lambda stream: (recorded[stream], stream))
    return None if recorded[shortest] >= wanted else shortest

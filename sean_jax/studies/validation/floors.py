"""Checks of people on Behavior Graphs: half turns, curves, heads and standstill on the floors that users look at.

The detectors are those of ``floor_measures``, which see recorded people in the same way. No robot is on these floors.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.people.behaviors import trips
from sean_jax.simulation.making import make
from sean_jax.simulation.scenario import NOWHERE, direct_pedestrians, move_pedestrians, reset
from sean_jax.studies.scenes import Model
from sean_jax.studies.validation.checks import PUBLISHED, CheckContext, CheckResult, result
from sean_jax.studies.validation.floor_measures import Liveliness, Observed, liveliness
from sean_jax.world import generated

WARM_UP = 20.0  # s, after which people are observed
SEED = 1
WORLD_SEED = 0


class Seen(NamedTuple):
    """What is observed of people at each moment."""

    position: Array  # (T, N, 2) m
    present: Array  # (T, N)
    standing: Array  # (T, N)
    heading: Array  # (T, N, 2)
    group: Int[Array, "T N"]


def watch(scenario: Scenario, key: Array, robot: Float[Array, "2"], seconds: float) -> Seen:
    """People from ``WARM_UP`` on for some seconds, beside a robot that stands at a place [m] all the time."""
    state = reset(scenario, key)
    state = replace(state, robot=scenario.robot.place(scenario.robot, robot, state.robot.heading))

    def one(state: State, _: None) -> tuple[State, Seen]:
        key = jax.random.fold_in(state.streams.people, state.tick)
        after = move_pedestrians(scenario, direct_pedestrians(scenario, state, key))
        after = replace(after, tick=state.tick + 1)
        people = after.pedestrians
        standing = (people.group >= 0) | trips.at_errand(after.memory)
        return after, Seen(people.position, people.present, standing, people.heading, people.group)

    first = round(WARM_UP / scenario.time_step)
    steps = first + round(seconds / scenario.time_step)
    seen = jax.lax.scan(one, state, length=steps)[1]
    return jax.tree.map(lambda rows: rows[first:], seen)


def observe(scenario: Scenario, seconds: float, seed: int = SEED) -> tuple[Observed, np.ndarray]:
    """People without a robot, from ``WARM_UP`` on for some seconds; and the group (T, N) of each, -1 none."""
    nowhere = jnp.full(2, NOWHERE, float)
    seen = jax.jit(lambda key: watch(scenario, key, nowhere, seconds))(jax.random.key(seed))
    seen = jax.tree.map(np.asarray, seen)
    observed = Observed(seen.position, seen.present, seen.standing, seen.heading, scenario.time_step)
    return observed, seen.group


def shipped(context: CheckContext, environment: str, seconds: float = 120.0) -> CheckResult:
    """People on the Behavior Graph of a shipped environment."""
    scenario = _with_model(make(environment, behavior="graph", routing="trips"), context.model)
    seconds = seconds / 2 if context.quick else seconds
    return _result({environment: liveliness(observe(scenario, seconds)[0])})


def worlds(context: CheckContext, families: Sequence[str], crowd: float = 1.0, seconds: float = 90.0) -> CheckResult:
    """People on a generated floor of each family, ``crowd`` times as many as it has by default."""
    measured = {}
    with tempfile.TemporaryDirectory() as folder:
        for family in context.progress(list(families)):
            path = Path(folder) / family
            world = generated.generate(family, WORLD_SEED)
            generated.save(world, path)
            people = round(crowd * world.settings.people)
            scenario = make(str(path), behavior="graph", routing="trips", people=people)
            measured[family] = liveliness(observe(_with_model(scenario, context.model), seconds)[0])
    return _result(measured)


def _with_model(scenario: Scenario, model: Model) -> Scenario:
    """The scenario with people who move by the model."""
    return replace(scenario, forces=model.forces, move=model.move)


def _result(measured: dict[str, Liveliness]) -> CheckResult:
    """Whether people on all floors walk as gently as recorded ones; the numbers of each floor."""
    limits: dict[str, float] = PUBLISHED["floors"]["limits"]
    misses = []
    numbers = {}
    for floor, values in measured.items():
        for name, value in values._asdict().items():
            numbers[f"{floor} {name}"] = float(value)
            if name in limits and value > limits[name]:
                misses.append(f"{floor} {name.replace('_', ' ')} {value:.2f}")

    worst = {name: max(getattr(values, name) for values in measured.values()) for name in limits}
    text = ", ".join(f"{name.replace('_', ' ')} {value:.2f}" for name, value in worst.items())
    wanted = ", ".join(f"{name.replace('_', ' ')} {limit:g}" for name, limit in limits.items())
    return result(not misses, f"at most {text}", f"at most {wanted}; missed: {', '.join(misses)}", numbers=numbers)

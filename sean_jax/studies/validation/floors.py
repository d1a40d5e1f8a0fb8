"""Checks of people on Behavior Graphs: how they turn, where they stand and where they walk, on the floors in use.

The detectors are those of ``floor_measures``, which see recorded people in the same way. No robot is on these floors.
"""

import itertools
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
from sean_jax.studies.validation.floor_measures import Liveliness, Observed, liveliness, used_cells
from sean_jax.world import generated

WARM_UP = 20.0  # s, after which people are observed
SEED = 1
WORLD_SEED = 0
CROWDED = 2.5  # times the people of a generated floor


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
    scenario = _with_model(make(environment, behavior="graph"), context.model)
    seconds = seconds / 2 if context.quick else seconds
    return _result({environment: liveliness(observe(scenario, seconds)[0])})


def world(context: CheckContext, family: str, seconds: float = 90.0) -> CheckResult:
    """People on a generated floor of a family: as many as it has by default, and ``CROWDED`` times as many."""
    measured = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / family
        floor = generated.generate(family, WORLD_SEED)
        generated.save(floor, path)
        for crowd in context.progress([1.0, CROWDED]):
            people = round(crowd * floor.settings.people)
            scenario = make(str(path), behavior="graph", people=people)
            seen, _ = observe(_with_model(scenario, context.model), seconds)
            measured[f"{family}, {people} people:"] = liveliness(seen)
    return _result(measured)


def used(context: CheckContext, environments: Sequence[str], minutes: float = 30.0) -> CheckResult:
    """The share of the floor between entrances on which people have walked after some time."""
    least = PUBLISHED["floors"]["least_used"]
    shares = {}
    for environment in context.progress(list(environments)):
        scenario = _with_model(make(environment, behavior="graph"), context.model)
        seen, _ = observe(scenario, 60.0 * minutes)
        reachable = cells_between_entrances(scenario)
        shares[environment] = len(used_cells(seen) & reachable) / len(reachable)
    text = ", ".join(f"{environment} {share:.0%}" for environment, share in shares.items())
    return result(min(shares.values()) >= least, text, f"{least:.0%} or more", numbers=shares)


def cells_between_entrances(scenario: Scenario, walks: int = 40) -> set[tuple[int, int]]:
    """Cells of 1 m on the cheapest ways between entrances, over random places of the nodes on the way."""
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    entrances = np.flatnonzero(graph.entrance > 0.0)
    generator = np.random.default_rng(0)
    points = []
    for begin, end in itertools.permutations(entrances, 2):
        nodes = [begin]
        while nodes[-1] != end:
            nodes.append(graph.next_hop[nodes[-1], end])
        for _ in range(walks):
            column = generator.integers(graph.places.shape[1], size=len(nodes))
            points.append(_along(graph.places[nodes, column]))
    cells = np.floor(np.concatenate(points)).astype(int)
    return set(map(tuple, np.unique(cells, axis=0).tolist()))


def _along(corners: Float[np.ndarray, "K 2"], step: float = 0.2) -> Float[np.ndarray, "P 2"]:
    """Points [m] on the straight lines from corner to corner, about ``step`` [m] apart."""
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=-1)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    along = np.linspace(0.0, at[-1], max(2, int(at[-1] / step)))
    return np.stack([np.interp(along, at, corners[:, axis]) for axis in range(2)], -1)


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

"""Checks of people on Behavior Graphs: how they turn, where they stand and where they walk, on the floors in use.

The detectors are those of ``floor_measures``, which see recorded people in the same way. No robot is on these floors,
but one stands before the door of ``before_a_door``.
"""

import itertools
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, Groups, Scenario, State
from sean_jax.people.behaviors import trips
from sean_jax.simulation.making import make
from sean_jax.simulation.scenario import NOWHERE, direct_pedestrians, move_pedestrians, reset
from sean_jax.studies.scenes import Model
from sean_jax.studies.validation.checks import PUBLISHED, CheckContext, CheckResult, result
from sean_jax.studies.validation.floor_measures import (
    HANDOVER,
    O_SPACE,
    SHORT_STAY,
    GatheredPeople,
    GroupLife,
    Liveliness,
    Observed,
    group_life,
    liveliness,
    longest_near,
    passes,
    used_cells,
)
from sean_jax.world import generated

WARM_UP = 20.0  # s, after which people are observed
SEED = 1
WORLD_SEED = 0
CROWDED = 2.5  # times the people of a generated floor
DOOR_FLOOR = "rooms", 3, {"door": 1.33}  # family, seed and settings of the floor with a robot before a door
DOOR_PEOPLE = 27  # ``CROWDED`` times those of that floor
DOOR = np.array([[14.36, 6.636], [15.69, 6.636]])  # m, both ends of one of its doors
DOOR_ROBOT = 15.19  # m, x of the robot, which leaves half of the door free
BEFORE_DOOR = 0.3, 0.6  # m from the wall to the robot, in the first and in the last draw
HALF_WALL = 0.064  # m
NEAR_ROBOT = 1.0  # m
DOOR_SECONDS = 90.0  # s
DOOR_SEED = 5


class Seen(NamedTuple):
    """What is observed of people at each moment."""

    position: Array  # (T, N, 2) m
    present: Array  # (T, N)
    standing: Array  # (T, N)
    heading: Array  # (T, N, 2)
    group: Int[Array, "T N"]


def watch(scenario: Scenario, key: Array, robot: Float[Array, "2"], seconds: float) -> tuple[Seen, Groups]:
    """People from ``WARM_UP`` on for some seconds, beside a robot that stands at a place [m], and their groups."""
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
    return jax.tree.map(lambda rows: rows[first:], seen), state.groups


def observe(scenario: Scenario, seconds: float, seed: int = SEED) -> tuple[Observed, GatheredPeople]:
    """People and groups without a robot, from ``WARM_UP`` on for some seconds."""
    nowhere = jnp.full(2, NOWHERE, float)
    program = jax.jit(lambda key: watch(scenario, key, nowhere, seconds))
    seen, groups = jax.tree.map(np.asarray, program(jax.random.key(seed)))
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    visit = graph.stay[graph.groups]  # of trips the graph's ``visit``
    return _observed(seen, scenario.time_step), GatheredPeople(seen.group, groups.center, groups.radius, visit)


def _observed(seen: Seen, time_step: float) -> Observed:
    """What is seen, as the detectors take it."""
    position, present, standing, heading, _ = map(np.asarray, seen)
    return Observed(position, present, standing, heading, time_step)


def shipped(context: CheckContext, environment: str, seconds: float = 120.0) -> CheckResult:
    """People on the Behavior Graph of a shipped environment."""
    scenario = _with_model(make(environment, behavior="graph"), context.model)
    seconds = seconds / 2 if context.quick else seconds
    return _result({environment: liveliness(observe(scenario, seconds)[0])})


def world(context: CheckContext, family: str, seconds: float = 90.0) -> CheckResult:
    """People on a generated floor of a family: as many as it has by default, and ``CROWDED`` times as many."""
    measured = {}
    usual = generated.generate(family, WORLD_SEED).settings.people
    for crowd in context.progress([1.0, CROWDED]):
        people = round(crowd * usual)
        scenario = _generated((family, WORLD_SEED), people)
        seen, _ = observe(_with_model(scenario, context.model), seconds)
        measured[f"{family}, {people} people:"] = liveliness(seen)
    return _result(measured)


def groups(
    context: CheckContext, environments: Sequence[str], families: Sequence[str], minutes: float = 15.0
) -> CheckResult:
    """How long people stay in the groups of some floors, and how often others walk through the groups."""
    if context.quick:
        environments, families, minutes = environments[:1], (), minutes / 3.0
    scenarios = {name: make(name, behavior="graph") for name in environments}
    scenarios |= {family: _generated((family, WORLD_SEED)) for family in families}

    measured = {}
    for floor, scenario in zip(scenarios, context.progress(list(scenarios.values())), strict=True):
        seen, gathered = observe(_with_model(scenario, context.model), 60.0 * minutes)
        measured[floor] = group_life(seen, gathered)
    return compare_groups(measured)


def compare_groups(measured: dict[str, GroupLife]) -> CheckResult:
    """The result of the groups on some floors. A floor on which nobody ends a stay fails."""
    most = PUBLISHED["floors"]["most_intruded"]
    passed = True
    words = []
    numbers = {}
    for floor, life in measured.items():
        numbers |= {f"{floor} {name}": float(value) for name, value in life._asdict().items()}
        passed = passed and life.unlike_graph == 0.0 and life.intruded <= most
        words.append(
            f"{floor}: {life.stays:.0f} stays of {life.mean_stay:.0f} s on average, {life.shortest_stay:.0f} to "
            f"{life.longest_stay:.0f} s, {life.short_stays:.0%} below {SHORT_STAY:g} s, {life.unlike_graph:.0%} unlike "
            f"the graph's; {life.changes:.2f} people leave a group and minute; others within {O_SPACE:g} radii of its "
            f"center {life.intruded:.1%} of the time"
        )
    wanted = f"all stays within the graph's limits and {HANDOVER:g} s, others inside {most:.0%} of the time at most"
    return result(passed, "; ".join(words), wanted, numbers=numbers)


class DoorDraws(NamedTuple):
    """People at a door in some draws."""

    longest: list[float]  # s, near the robot's place
    passes: list[int]
    returns: list[int]  # of people who come back at once, and have not passed


def door_draws(draws: int, model: Model | None = None) -> dict[str, DoorDraws]:
    """The figures of the door with a ``robot`` before it, and with ``nobody`` there, of the same draws."""
    scenario = _generated(DOOR_FLOOR, DOOR_PEOPLE, robot="kuri")
    scenario = scenario if model is None else _with_model(scenario, model)
    keys = jax.random.split(jax.random.key(DOOR_SEED), draws)
    distance = DOOR[0, 1] + HALF_WALL + np.linspace(*BEFORE_DOOR, draws)
    places = np.stack([np.full(draws, DOOR_ROBOT), distance], -1)  # (draws, 2) m

    program = jax.jit(jax.vmap(lambda key, place: watch(scenario, key, place, DOOR_SECONDS)[0]))
    figures = {}
    for name, robots in (("robot", places), ("nobody", np.full_like(places, NOWHERE))):
        seen = jax.tree.map(np.asarray, program(keys, jnp.asarray(robots, float)))
        draws_of = DoorDraws([], [], [])
        for place, *rows in zip(places, *seen, strict=True):
            observed = _observed(Seen(*rows), scenario.time_step)
            n_passes, n_returns = passes(observed, *DOOR)
            draws_of.longest.append(round(longest_near(observed, place, NEAR_ROBOT), 1))
            draws_of.passes.append(n_passes)
            draws_of.returns.append(n_returns)
        figures[name] = draws_of
    return figures


def before_a_door(context: CheckContext, draws: int = 20) -> CheckResult:
    """Whether people get by a robot that stands before a door."""
    return compare_doors(door_draws(draws // 4 if context.quick else draws, context.model))


def compare_doors(figures: dict[str, DoorDraws]) -> CheckResult:
    """The result of draws with and without a robot."""
    limits = PUBLISHED["floors"]["door"]
    longest = np.array(figures["robot"].longest)
    calm = int((longest <= limits["longest"]).sum())
    flow, usual = sum(figures["robot"].passes), sum(figures["nobody"].passes)
    returns, usual_returns = sum(figures["robot"].returns), sum(figures["nobody"].returns)
    share = flow / max(usual, 1)

    enough = calm >= limits["calm_draws"] * len(longest)
    as_usual = abs(share - 1.0) <= limits["flow"]
    numbers = {"calm_draws": calm / len(longest), "longest": longest.max(), "flow": share, "returns": returns}
    return result(
        enough and as_usual,
        f"nobody within {NEAR_ROBOT:g} m for more than {limits['longest']:g} s in {calm} of {len(longest)} draws, "
        f"{longest.max():.1f} s at most; {flow} people pass and {returns} come back at once, without a robot {usual} "
        f"and {usual_returns}",
        f"{limits['calm_draws']:.0%} of the draws, passes within {limits['flow']:.0%}",
        numbers={name: float(value) for name, value in numbers.items()},
    )


def _generated(floor: tuple[Any, ...], people: int | None = None, robot: str | None = None) -> Scenario:
    """People on the Behavior Graph of a generated floor, given by the arguments of ``generate``."""
    options = {} if robot is None else {"robot": robot}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / floor[0]
        generated.save(generated.generate(*floor), path)
        return make(str(path), behavior="graph", people=people, **options)


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

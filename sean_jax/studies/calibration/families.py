"""Crowds that a fit is judged by: scenes of ``sean validate`` in families, and how each is measured.

A family records what it needs of each moment and measures the records by ``validation.measures``. Its rows have targets
in targets.yaml.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.robots import load
from sean_jax.social_forces.forces import look_direction
from sean_jax.studies.scenes import Scene
from sean_jax.studies.scenes.scene import TIME_STEP
from sean_jax.studies.validation import crowds, doors, guideline_scenes, individuals
from sean_jax.studies.validation.measures import (
    accelerations,
    body_gaps,
    densities,
    deviation_in_time,
    flow,
    lane_order,
    peak,
    separation,
    steps_along,
)

Values = dict[str, Array]
Rows = dict[str, np.ndarray]

SPAN = 4  # control steps, over which speeds and accelerations are measured, as in recordings


class Case(NamedTuple):
    """A scene and the row to which it counts; rows are means over their scenes."""

    row: str
    scene: Scene


class SceneFamily:
    """Cases of one kind that last equally long, and what is measured in each.

    ``record`` and ``measure`` work on one scene, under ``jit`` and ``vmap``.
    """

    seconds: ClassVar[float]
    counted: ClassVar[float] = 0.5  # share of the time, at its end, that counts

    def __init__(self, cases: Sequence[Case]):
        self.cases = [case._replace(scene=replace(case.scene, seed=k)) for k, case in enumerate(cases)]

    @property
    def ticks(self) -> int:
        """Control steps of a scene."""
        return round(self.seconds / TIME_STEP)

    @property
    def uncounted(self) -> int:
        """Control steps before those that count."""
        return round((1.0 - self.counted) * self.ticks)

    def record(self, scenario: Scenario, state: State) -> Values:
        """What is recorded of a moment."""
        raise NotImplementedError

    def measure(self, scenario: Scenario, records: Values) -> Values:
        """The values of a scene, from the records (T, ...) of its start and of the moment after each control step."""
        raise NotImplementedError

    def rows(self, values: Rows) -> Rows:
        """The measured values (L,) of each row, from the values (L, S, ...) of the scenes of L candidates."""
        raise NotImplementedError

    def by_row(self, name: str, values: np.ndarray) -> Rows:
        """Means (L,) over the cases of each row, of values (L, S): ``name`` and the case."""
        cases: dict[str, list[int]] = {}
        for k, case in enumerate(self.cases):
            cases.setdefault(case.row, []).append(k)
        return {f"{name} {row}".strip(): values[:, chosen].mean(1) for row, chosen in cases.items()}


def along_record(state: State) -> Values:
    """Positions (N,) m along a corridor, and presence (N,)."""
    return {"x": state.pedestrians.position[:, 0], "present": state.pedestrians.present}


def speeds_along(scenario: Scenario, records: Values, span: int = 1) -> Array:
    """(S, N) m/s along a periodic corridor, over ``span`` control steps each; NaN of absent people."""
    x, present = records["x"][::span], records["present"][::span]
    speed = steps_along(x, scenario.behavior.data.period) / (span * TIME_STEP)
    return jnp.where(present[1:], speed, jnp.nan)


# ------------------------------------------------------------------ one way


class Corridor(SceneFamily):
    """Mean speeds along a periodic corridor of 1.8 m by density, of people at random places."""

    seconds = 40.0

    def record(self, scenario: Scenario, state: State) -> Values:
        return along_record(state)

    def measure(self, scenario: Scenario, records: Values) -> Values:
        return {"speed": jnp.nanmean(speeds_along(scenario, records)[self.uncounted :])}

    def rows(self, values: Rows) -> Rows:
        return self.by_row("corridor", values["speed"])


class SingleFile(SceneFamily):
    """Speeds of people who cannot pass each other, their mean and each person's deviation in time."""

    name, seconds = "file", 60.0

    def record(self, scenario: Scenario, state: State) -> Values:
        return along_record(state)

    def measure(self, scenario: Scenario, records: Values) -> Values:
        speed = speeds_along(scenario, records, SPAN)[self.uncounted // SPAN :]
        return {"speed": jnp.nanmean(speed), "deviation": deviation_in_time(speed)}

    def rows(self, values: Rows) -> Rows:
        return self.by_row(self.name, values["speed"]) | self.by_row(f"{self.name} deviation", values["deviation"])


class Waves(SingleFile):
    """The loop in which stop-and-go was recorded."""

    name, seconds, counted = "waves", crowds.WAVE_SECONDS, crowds.WAVE_COUNTED / crowds.WAVE_SECONDS


class StreetFamily(SceneFamily):
    """Accelerations of people in a street."""

    seconds = 40.0
    BINS, WIDTH = 200, 0.025  # m/s2

    def record(self, scenario: Scenario, state: State) -> Values:
        return along_record(state) | {"y": state.pedestrians.position[:, 1]}

    def measure(self, scenario: Scenario, records: Values) -> Values:
        along = speeds_along(scenario, records, SPAN)
        across = jnp.diff(records["y"][::SPAN], axis=0) / (SPAN * TIME_STEP)
        velocity = jnp.stack([along, across], -1)  # (S, N, 2)

        # The first acceleration is the change from the first span to the second.
        first = max(self.uncounted // SPAN - 1, 0)
        size = accelerations(velocity, SPAN * TIME_STEP)[first:]
        bins = jnp.minimum((size / self.WIDTH).astype(jnp.int32), self.BINS - 1)
        histogram = jnp.zeros(self.BINS, float).at[bins].add(jnp.isfinite(size).astype(float))
        return {"histogram": histogram}

    def rows(self, values: Rows) -> Rows:
        share = np.cumsum(values["histogram"].sum(1), -1)
        share = share / np.maximum(share[:, -1:], 1.0)
        return {"acceleration p95": self.WIDTH * (0.5 + (share >= 0.95).argmax(-1))}


# ------------------------------------------------------------------ two ways


class Lanes(SceneFamily):
    """The order of lanes out of a random mix."""

    seconds, counted = 60.0, crowds.LANE_SHARE

    def record(self, scenario: Scenario, state: State) -> Values:
        people = state.pedestrians
        direction = jnp.sign(people.desired_velocity[:, 0])
        return {"order": lane_order(people.position[:, 1], direction, people.present)}

    def measure(self, scenario: Scenario, records: Values) -> Values:
        return {"order": records["order"][1 + self.uncounted :].mean()}

    def rows(self, values: Rows) -> Rows:
        return self.by_row("lanes", values["order"])


class Encounter(SceneFamily):
    """The least distance of two bodies."""

    seconds = 2.0 * individuals.BEFORE

    def __init__(self, cases: Sequence[Case], bodies: float):
        super().__init__(cases)
        self.bodies = bodies  # m, both radii

    def measure(self, scenario: Scenario, records: Values) -> Values:
        return {"distance": separation(records["person"], records["other"])}


class Pairs(Encounter):
    """The least distance of two people who meet."""

    def record(self, scenario: Scenario, state: State) -> Values:
        return {"person": state.pedestrians.position[0], "other": state.pedestrians.position[1]}

    def rows(self, values: Rows) -> Rows:
        head_on = [k for k, case in enumerate(self.cases) if case.row == "180"]
        distance = values["distance"]
        return {"pairs gap": distance.min(1) - self.bodies, "pairs head-on": distance[:, head_on].mean(1)}


class Passing(Encounter):
    """The clearance of a person from a robot that crosses their way and does not react."""

    def record(self, scenario: Scenario, state: State) -> Values:
        return {"person": state.pedestrians.position[0], "other": state.robot.position}

    def rows(self, values: Rows) -> Rows:
        distance = values["distance"]
        return {
            "robot clearance": distance.mean(1),
            "robot deviation": distance.std(1),
            "robot touched": (distance < self.bodies).mean(1),
        }


# ------------------------------------------------------------------ doors


class Doors(SceneFamily):
    """Flow through doors and passages, who is left inside, density before them and overlap of bodies."""

    seconds = doors.WITHIN
    PRESS = "press"  # the row of people who all prefer 1.34 m/s

    def record(self, scenario: Scenario, state: State) -> Values:
        people = state.pedestrians
        facing = jnp.stack(look_direction(people), -1)
        gap = body_gaps(people.position, facing, people.present, scenario.forces.walking)
        return {
            "crossed": (state.memory.leg > 0).sum(),
            "density": densities(people.position, people.present, *doors.BEFORE),
            "gap": gap.min(),
        }

    def measure(self, scenario: Scenario, records: Values) -> Values:
        # The k-th crossing is as many control steps after the start as moments have at most k people outside.
        rank = jnp.arange(doors.PEOPLE, dtype=jnp.int32)
        outside = records["crossed"][1:, None] <= rank[None]  # (T, N)

        parted = round(doors.APART / TIME_STEP)  # bodies whose drawn places overlap part first
        return {
            "steps": outside.astype(float).sum(0),
            "density": records["density"][1:],
            "gap": records["gap"][parted:].min(),
        }

    def rows(self, values: Rows) -> Rows:
        crosses = values["steps"] < self.ticks
        times = np.where(crosses, TIME_STEP * values["steps"], np.inf)  # (L, S, N)
        flows = np.nan_to_num(flow(times, shortest=TIME_STEP))
        density = peak(values["density"], round(doors.PEAK / TIME_STEP))

        press = [k for k, case in enumerate(self.cases) if case.row == self.PRESS]
        inside = doors.PEOPLE - crosses.sum(-1)
        return {
            **self.by_row("flow", flows),
            **self.by_row("density", density),
            "doors inside": np.delete(inside, press, 1).max(1),
            "overlap": np.maximum(-values["gap"][:, press], 0.0).max(1),
        }


# ------------------------------------------------------------------ all of them

QUICK_DENSITIES = 1.0, 2.0  # 1/m2
CORRIDOR_DENSITIES = tuple(density for density in crowds.DENSITIES if density != 3.25)  # 1/m2
WIDTHS = 0.8, 1.2, 1.6, 2.4  # m, of doors
ANGLES = 180, 135, 120, 90, 60, 45  # degrees between the ways of two
ENCOUNTERS = 256  # with a robot
STREET = 16, 0.5  # people, 1/m2


def families(forces: Any, draws: int, quick: bool) -> list[SceneFamily]:
    """The crowds of a fit.

    Args:
        forces: the radius of bodies is that of their walking law.
        draws: of people in each corridor, street, wave and mix; half as many in each single file and door.
        quick: a few small scenes, for tests.
    """
    radius = float(forces.walking.radius)
    pairs = _meetings()
    encounters = individuals.passing_scenes(8 if quick else ENCOUNTERS)
    chosen: list[SceneFamily] = [
        Corridor(_corridors(QUICK_DENSITIES if quick else CORRIDOR_DENSITIES, draws)),
        StreetFamily([Case("", _street(seed)) for seed in range(draws)]),
        Pairs(pairs[:4] if quick else pairs, 2.0 * radius),
        Passing([Case("", scene) for scene in encounters], radius + float(load("kuri").radius)),
    ]
    if quick:
        return chosen

    few = max(1, draws // 2)
    files, waves, mixed = [], [], []
    for density, seed in itertools.product(crowds.ENVELOPE, range(few)):
        files.append(Case(f"{density:g}", crowds.in_file(round(density * crowds.LOOP), crowds.LOOP, 0.0, seed, 0.2)))
    for number, seed in itertools.product(crowds.WAVES, range(draws)):
        waves.append(Case(f"{number}", crowds.in_file(number, crowds.WAVE_LOOP, 0.0, seed, 0.2)))
    for density, seed in itertools.product(crowds.LANE_DENSITIES, range(draws)):
        mixed.append(Case(f"{density:g}", crowds.mixed_corridor(density, seed)))
    return [*chosen, SingleFile(files), Waves(waves), Lanes(mixed), Doors(_rooms(few))]


def _corridors(densities: Sequence[float], draws: int) -> list[Case]:
    scenes, _ = crowds.corridors(densities, draws, 0.0, crowds.hermes_speeds)
    names = [f"{density:g}" for density in densities for _ in range(draws)]
    return [Case(name, scene) for name, scene in zip(names, scenes, strict=True)]


def _street(seed: int) -> Scene:
    people, density = STREET
    return guideline_scenes.ring(people / density / crowds.WIDTH, crowds.WIDTH, people, 0.0, None, seed)


def _meetings() -> list[Case]:
    cases = []
    for angle, offset, speeds in itertools.product(ANGLES, individuals.OFFSETS, individuals.SPEEDS):
        cases.append(Case(f"{angle}", individuals.two(np.deg2rad(angle), offset, speeds)))
    return cases


def _rooms(draws: int) -> list[Case]:
    """Crowds before doors and passages, and before one door with equal preferred speeds."""
    cases = []
    for passage, width, seed in itertools.product(doors.PASSAGES, WIDTHS, range(draws)):
        speed = crowds.hermes_speeds(doors.PEOPLE, seed)
        cases.append(Case(f"{width:g} x {passage:g}", _room(width, seed, speed, passage)))
    return cases + [Case(Doors.PRESS, _room(1.0, seed, doors.FREE, doors.PASSAGES[0])) for seed in range(draws)]


def _room(width: float, seed: int, speed: np.ndarray | float, passage: float) -> Scene:
    return doors.before_door(width, doors.crowd_in_room(seed), speed, 0.0, passage)

"""Crowds that a fit is judged by: scenes of ``sean validate`` in families, and what is measured in them step by step.

A family measures by sums over the control steps, so that no tracks are kept. Its rows have targets in targets.yaml.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from sean_jax.core.data_types import Array, Pedestrians, Scenario, State
from sean_jax.core.geometry import length
from sean_jax.robots import load
from sean_jax.social_forces.forces import look_direction
from sean_jax.studies.scenes import Scene
from sean_jax.studies.scenes.scene import TIME_STEP
from sean_jax.studies.validation import crowds, doors, guideline_scenes, individuals, measures

Sums = dict[str, Array]
Rows = dict[str, np.ndarray]

SPAN = 4  # control steps, over which speeds and accelerations are measured, as in recordings
FAR = 1e6  # m


class Case(NamedTuple):
    """A scene and the row to which it counts; rows are means over their scenes."""

    row: str
    scene: Scene


class Family:
    """Cases of one kind that last equally long, and what is measured in each.

    ``begin``, ``count`` and ``end`` work on one scene, under ``jit`` and ``vmap``.
    """

    seconds: ClassVar[float]
    counted: ClassVar[float] = 0.5  # share of the time, at its end, that counts

    def __init__(self, cases: Sequence[Case]):
        self.cases = [case._replace(scene=replace(case.scene, seed=k)) for k, case in enumerate(cases)]

    @property
    def ticks(self) -> int:
        """Control steps of a scene."""
        return round(self.seconds / TIME_STEP)

    def begin(self, state: State) -> Sums:
        """The sums before the first step."""
        raise NotImplementedError

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        """The sums after a step."""
        raise NotImplementedError

    def end(self, sums: Sums) -> Sums:
        """What is kept of a scene."""
        return sums

    def rows(self, kept: Rows) -> Rows:
        """The measured values (L,) of each row, from what is kept (L, S, ...) of the scenes of L candidates."""
        raise NotImplementedError

    def counts(self, state: State) -> Array:
        """() 1 where a step counts, else 0."""
        return (state.tick > round((1.0 - self.counted) * self.ticks)).astype(float)

    def by_row(self, name: str, values: np.ndarray) -> Rows:
        """Means (L,) over the cases of each row, of values (L, S): ``name`` and the case."""
        named = [case.row for case in self.cases]
        return {
            f"{name} {row}".strip(): values[:, [k for k, own in enumerate(named) if own == row]].mean(1)
            for row in dict.fromkeys(named)
        }


def steps_of(scenario: Scenario, before: State, after: State) -> Array:
    """(N, 2) m that people moved, over the seam of a periodic scene if need be."""
    step = after.pedestrians.position - before.pedestrians.position
    period = scenario.behavior.data.period
    turns = jnp.round(step[:, 0] / jnp.where(period > 0.0, period, FAR))
    return step.at[:, 0].add(-period * turns)


def nearest(before: Array, after: Array) -> Array:
    """(...) m, the least length of a gap that changes evenly from (..., 2) m to (..., 2) m."""
    step = after - before
    squared = (step * step).sum(-1)
    share = jnp.clip(-(before * step).sum(-1) / jnp.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    gap = before + share[..., None] * step
    return length(gap[..., 0], gap[..., 1])


def gaps(scenario: Scenario, people: Pedestrians) -> Array:
    """(N, N) m between the surfaces of bodies, negative if they overlap; far from oneself and from absent people."""
    x, y = (jnp.where(people.present, part, FAR) for part in people.position.T)
    dx, dy, walking = x[:, None] - x[None], y[:, None] - y[None], scenario.forces.walking
    shape = walking.shape(*look_direction(people))
    both = None if shape is None else tuple(part[:, None] + part[None] for part in shape)
    gap = jnp.sqrt(dx * dx + dy * dy) - walking.radii(dx, dy, both)
    both = people.present[:, None] & people.present[None] & ~jnp.eye(len(x), dtype=bool)
    return jnp.where(both, gap, FAR)


def mean_present(values: Array, state: State) -> Array:
    """() the mean of values (N,) over the people present."""
    there = state.pedestrians.present.astype(float)
    return (values * there).sum() / jnp.maximum(there.sum(), 1.0)


# ------------------------------------------------------------------ one way


class Corridor(Family):
    """Mean speeds along a periodic corridor of 1.8 m by density, of people at random places."""

    seconds = 40.0

    def begin(self, state: State) -> Sums:
        return {"speed": jnp.zeros((), float)}

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        speed = mean_present(steps_of(scenario, before, after)[:, 0], after) / TIME_STEP
        return {"speed": sums["speed"] + self.counts(after) * speed / (self.counted * self.ticks)}

    def rows(self, kept: Rows) -> Rows:
        return self.by_row("corridor", kept["speed"])


class SingleFile(Family):
    """Speeds of people who cannot pass each other, their mean and each person's deviation in time."""

    name, seconds = "file", 60.0

    def begin(self, state: State) -> Sums:
        nothing = jnp.zeros(state.pedestrians.present.shape, float)
        there = state.pedestrians.present.astype(float)
        return dict(moved=nothing, total=nothing, square=nothing, there=there, spans=jnp.zeros((), float))

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        moved = sums["moved"] + steps_of(scenario, before, after)[:, 0]
        over = after.tick % SPAN == 0
        counts = self.counts(after) * over.astype(float)
        speed = moved / (SPAN * TIME_STEP)
        return dict(
            moved=jnp.where(over, 0.0, moved),
            total=sums["total"] + counts * speed,
            square=sums["square"] + counts * speed * speed,
            there=sums["there"],
            spans=sums["spans"] + counts,
        )

    def end(self, sums: Sums) -> Sums:
        mean = sums["total"] / sums["spans"]
        variance = jnp.maximum(sums["square"] / sums["spans"] - mean * mean, 0.0)
        people = sums["there"].sum()
        return {
            "speed": (mean * sums["there"]).sum() / people,
            "deviation": jnp.sqrt((variance * sums["there"]).sum() / people),
        }

    def rows(self, kept: Rows) -> Rows:
        return self.by_row(self.name, kept["speed"]) | self.by_row(f"{self.name} deviation", kept["deviation"])


class Waves(SingleFile):
    """The loop in which stop-and-go was recorded."""

    name, seconds, counted = "waves", crowds.WAVE_SECONDS, crowds.WAVE_COUNTED / crowds.WAVE_SECONDS


class Street(Family):
    """Accelerations of people in a street."""

    seconds = 40.0
    BINS, WIDTH = 200, 0.025  # m/s2

    def begin(self, state: State) -> Sums:
        nothing = jnp.zeros_like(state.pedestrians.position)
        return dict(moved=nothing, last=nothing, histogram=jnp.zeros(self.BINS, float))

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        moved, over = sums["moved"] + steps_of(scenario, before, after), after.tick % SPAN == 0
        span = SPAN * TIME_STEP
        change = (moved - sums["last"]) / (span * span)
        size = length(change[:, 0], change[:, 1])
        bins = jnp.minimum((size / self.WIDTH).astype(jnp.int32), self.BINS - 1)
        counts = self.counts(after) * over.astype(float) * after.pedestrians.present.astype(float)
        return dict(
            moved=jnp.where(over, 0.0, moved),
            last=jnp.where(over, moved, sums["last"]),
            histogram=sums["histogram"].at[bins].add(counts),
        )

    def end(self, sums: Sums) -> Sums:
        return {"histogram": sums["histogram"]}

    def rows(self, kept: Rows) -> Rows:
        share = np.cumsum(kept["histogram"].sum(1), -1)
        share = share / np.maximum(share[:, -1:], 1.0)
        return {"acceleration p95": self.WIDTH * (0.5 + (share >= 0.95).argmax(-1))}


# ------------------------------------------------------------------ two ways


class Lanes(Family):
    """The order of lanes out of a random mix, as ``measures.lane_order``."""

    seconds, counted = 60.0, crowds.LANE_SHARE

    def begin(self, state: State) -> Sums:
        return {"order": jnp.zeros((), float)}

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        people = after.pedestrians
        across, direction = people.position[:, 1], jnp.sign(people.desired_velocity[:, 0])
        near = (jnp.abs(across[:, None] - across[None]) < measures.LANE) & people.present[None]
        near = near.astype(float)
        order = mean_present(((near @ direction) / jnp.maximum(near.sum(1), 1.0)) ** 2, after)
        return {"order": sums["order"] + self.counts(after) * order / (self.counted * self.ticks)}

    def rows(self, kept: Rows) -> Rows:
        return self.by_row("lanes", kept["order"])


class Pairs(Family):
    """The least distance of two people who meet."""

    seconds = 2.0 * individuals.BEFORE

    def __init__(self, cases: Sequence[Case], bodies: float):
        super().__init__(cases)
        self.bodies = bodies  # m, both radii

    def begin(self, state: State) -> Sums:
        return {"distance": jnp.full((), FAR, float)}

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        gaps = (state.pedestrians.position[0] - state.pedestrians.position[1] for state in (before, after))
        return {"distance": jnp.minimum(sums["distance"], nearest(*gaps))}

    def rows(self, kept: Rows) -> Rows:
        head_on = [k for k, case in enumerate(self.cases) if case.row == "180"]
        distance = kept["distance"]
        return {"pairs gap": distance.min(1) - self.bodies, "pairs head-on": distance[:, head_on].mean(1)}


class Passing(Family):
    """The clearance of a person from a robot that crosses their way and does not react."""

    seconds = 2.0 * individuals.BEFORE

    def __init__(self, cases: Sequence[Case], bodies: float):
        super().__init__(cases)
        self.bodies = bodies  # m, both radii

    def begin(self, state: State) -> Sums:
        return {"distance": jnp.full((), FAR, float)}

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        gaps = (state.pedestrians.position[0] - state.robot.position for state in (before, after))
        return {"distance": jnp.minimum(sums["distance"], nearest(*gaps))}

    def rows(self, kept: Rows) -> Rows:
        distance = kept["distance"]
        return {
            "robot clearance": distance.mean(1),
            "robot deviation": distance.std(1),
            "robot touched": (distance < self.bodies).mean(1),
        }


# ------------------------------------------------------------------ doors


class Doors(Family):
    """Flow through doors and passages, who is left inside, density before them and overlap of bodies."""

    seconds = doors.WITHIN
    PRESS = "press"  # the row of people who all prefer 1.34 m/s

    def begin(self, state: State) -> Sums:
        return dict(
            before=jnp.zeros(doors.PEOPLE, float),  # steps before each crossing
            last=jnp.zeros(round(doors.PEAK / TIME_STEP), float),  # densities, as a ring
            dense=jnp.zeros((), float),  # the largest sum of them
            gap=jnp.full((), FAR, float),
        )

    def count(self, scenario: Scenario, before: State, after: State, sums: Sums) -> Sums:
        people = after.pedestrians
        crossed = (after.memory.leg > 0).sum()
        own = jnp.arange(doors.PEOPLE, dtype=jnp.int32)
        low, high = (jnp.asarray(corner, float)[None] for corner in doors.BEFORE)
        inside = ((people.position >= low) & (people.position <= high)).all(-1) & people.present
        last = sums["last"].at[after.tick % len(sums["last"])].set(inside.sum().astype(float) / (high - low).prod())
        parted = after.tick >= round(doors.APART / TIME_STEP)
        return dict(
            before=sums["before"] + (crossed <= own).astype(float),
            last=last,
            dense=jnp.maximum(sums["dense"], last.sum() / len(last)),
            gap=jnp.minimum(sums["gap"], jnp.where(parted, gaps(scenario, people), FAR).min()),
        )

    def end(self, sums: Sums) -> Sums:
        return {name: sums[name] for name in ("before", "dense", "gap")}

    def rows(self, kept: Rows) -> Rows:
        times = TIME_STEP * kept["before"]
        out = (kept["before"] < self.ticks).sum(-1)
        first, last = (np.round(share * np.maximum(out - 1, 0)).astype(int) for share in (0.2, 0.8))
        at = lambda index: np.take_along_axis(times, index[..., None], -1)[..., 0]  # noqa: E731
        flow = np.where(out < 3, 0.0, (last - first) / np.maximum(at(last) - at(first), TIME_STEP))
        rows = self.by_row("flow", flow) | self.by_row("density", kept["dense"])
        press = [k for k, case in enumerate(self.cases) if case.row == self.PRESS]
        inside = doors.PEOPLE - out
        rows |= {"doors inside": np.delete(inside, press, 1).max(1)}
        return rows | {"overlap": np.maximum(-kept["gap"][:, press], 0.0).max(1)}


# ------------------------------------------------------------------ all of them

QUICK_DENSITIES = 1.0, 2.0
WIDTHS = 0.8, 1.2, 1.6, 2.4  # m, of doors
ANGLES = 180, 135, 120, 90, 60, 45  # degrees between the ways of two
ENCOUNTERS = 256  # with a robot
STREET = 16, 0.5  # people, 1/m2


def families(forces: Any, draws: int, quick: bool) -> list[Family]:
    """The crowds of a fit.

    Args:
        forces: whose radius bodies have.
        draws: of people in each corridor, file and mix; half as many in each door.
        quick: a few small scenes, for tests.
    """
    radius = float(forces.walking.radius)
    seeds, few = range(draws), range(max(1, draws // 2))
    densities = QUICK_DENSITIES if quick else tuple(density for density in crowds.DENSITIES if density != 3.25)
    scenes, _ = crowds.corridors(densities, draws, 0.0, crowds.hermes_speeds)
    names = [f"{density:g}" for density in densities for _ in seeds]
    street = [
        guideline_scenes.ring(STREET[0] / STREET[1] / crowds.WIDTH, crowds.WIDTH, STREET[0], 0.0, None, k)
        for k in seeds
    ]
    meeting = [(a, o, s) for a in ANGLES for o in individuals.OFFSETS for s in individuals.SPEEDS]
    meeting = meeting[:4] if quick else meeting
    encounters = individuals.passing_scenes(8 if quick else ENCOUNTERS)
    chosen: list[Family] = [
        Corridor([Case(*each) for each in zip(names, scenes, strict=True)]),
        Street([Case("", scene) for scene in street]),
        Pairs([Case(f"{a}", individuals.two(np.deg2rad(a), o, s)) for a, o, s in meeting], 2.0 * radius),
        Passing([Case("", scene) for scene in encounters], radius + float(load("kuri").radius)),
    ]
    if quick:
        return chosen
    file = [
        Case(f"{density:g}", crowds.in_file(round(density * crowds.LOOP), crowds.LOOP, 0.0, seed, 0.2))
        for density in crowds.ENVELOPE
        for seed in few
    ]
    waves = [
        Case(f"{number}", crowds.in_file(number, crowds.WAVE_LOOP, 0.0, seed, 0.2))
        for number in crowds.WAVES
        for seed in seeds
    ]
    mixed = [
        Case(f"{density:g}", crowds.mixed_corridor(density, k)) for density in crowds.LANE_DENSITIES for k in seeds
    ]
    rooms = [
        Case(f"{width:g} x {passage:g}", _room(width, k, crowds.hermes_speeds(doors.PEOPLE, k), passage))
        for passage in doors.PASSAGES
        for width in WIDTHS
        for k in few
    ]
    rooms += [Case(Doors.PRESS, _room(1.0, k, doors.FREE, doors.PASSAGES[0])) for k in few]
    return [*chosen, SingleFile(file), Waves(waves), Lanes(mixed), Doors(rooms)]


def _room(width: float, seed: int, speed: np.ndarray | float, passage: float) -> Scene:
    return doors.before_door(width, doors.crowd_in_room(seed), speed, 0.0, passage)

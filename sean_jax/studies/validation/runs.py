"""Checks of recorded runs that are walked again: people come as they did, and from a line on they walk freely.

In project Hermes (Forschungszentrum Juelich, doi 10.34735/ped.2009.13) people walk along a corridor of 1.8 m, y from 4
to -4 m, to an exit at its end. Until ``FREE_FROM`` they are moved as recorded, so the inflow is that of the run. What
follows, such as a queue before the exit, has to come from the model.
"""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, Behavior, Groups, Pedestrians, Scenario, State
from sean_jax.people.recordings import Tracks, motion_between_rows, read
from sean_jax.studies.scenes import Gate, Model, Scene, box, scenario_of, stage, walkers
from sean_jax.studies.scenes.scene import TIME_STEP
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.scenes.walkers import NEVER, Memory
from sean_jax.studies.validation.checks import CheckContext, CheckResult, Skipped, by_name, curve, reference, result
from sean_jax.studies.validation.crowds import STEADY, TOLERANCE, hermes_speeds
from sean_jax.studies.validation.measures import SPEED_SPAN, area_series, crossing_times, first_and_last, flow, pedpy

FREE_FROM = 3.0  # m, y of the line from which people walk freely
WIDTH = 1.8  # m, of the corridor
EXIT = -4.0  # m, y of the exit
BEHIND = 2.0  # m behind the exit people leave
WALL = 0.2  # m, thickness
FLOOR = 0.0, EXIT, WIDTH, 4.0
SLICES = 2.0, 0.5, -1.0, -2.5, EXIT  # m, y of the borders of the parts in which people are measured
MIDDLES = tuple(0.5 * (upper + lower) - EXIT for upper, lower in itertools.pairwise(SLICES))  # m before the exit
FRAME_RATE = 16.0  # of the numbers of frames in the files
ROWS = 5  # moments, 0.1 s, from one that is measured to the next
DRAWS = 3  # of free speeds and differences
SPREAD = 0.7, 1.3  # times the recorded deviation of speeds


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run: T moments, 0.1 s apart, of its N people, who walk along -y."""

    name: str
    exit_width: float  # m
    tracks: Tracks
    steady: slice  # moments that are measured


class Passage(NamedTuple):
    """How people walk to the exit in a run, recorded or simulated."""

    speed: float  # m/s
    deviation: float  # m/s, of speeds over people and moments
    flow: float  # people/s through the exit
    density: Float[np.ndarray, "P"]  # 1/m2, in each part of the way to the exit
    speeds: Float[np.ndarray, "P"]  # m/s, likewise


# ------------------------------------------------------------------ runs


def runs(folder: Path) -> list[RecordedRun]:
    """The runs in a folder of which the steady frames are known.

    Raises:
        FileError: a file cannot be read.
    """
    found = []
    for name, steady in STEADY.items():
        found += [read_run(path, steady) for path in sorted(folder.glob(f"{name}*.csv"))]
    return found


def read_run(path: Path, steady: Iterable[int]) -> RecordedRun:
    """A run in a file of project Hermes, whose name ends with the width of the exit [cm], as ``uo-180-180-095``.

    Args:
        steady: the first and the last steady frame.

    Raises:
        FileError: the file cannot be read.
    """
    recorded = read(path, "juelich")
    name = path.stem.split("_")[0]
    frames = np.asarray(recorded.frame)
    begin, end = (round((frame - frames[0]) / FRAME_RATE / TIME_STEP) for frame in steady)
    return RecordedRun(name, float(name.split("-")[-1]) / 100.0, resampled(recorded), slice(begin, end))


def resampled(tracks: Tracks) -> Tracks:
    """A recording with moments 0.1 s apart, interpolated linearly; a column is one person, as before."""
    moments, people = tracks.present.shape
    known = tracks.time_step * np.arange(moments)
    time = np.arange(0.0, known[-1] + 1e-6, TIME_STEP)
    position = np.zeros((len(time), people, 2))
    present = np.zeros((len(time), people), bool)
    for person in range(people):
        there = np.asarray(tracks.present)[:, person]
        first, last = known[there][[0, -1]]
        present[:, person] = (time >= first - 1e-6) & (time <= last + 1e-6)
        for axis in range(2):
            position[:, person, axis] = np.interp(time, known[there], np.asarray(tracks.position)[there, person, axis])
    return _tracks(position, present)


def _tracks(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"]) -> Tracks:
    moments, people = present.shape
    column = np.arange(people, dtype=np.int32)
    return Tracks(
        position=position,  # pyright: ignore[reportArgumentType]
        facing=np.broadcast_to([1.0, 0.0], position.shape),  # pyright: ignore[reportArgumentType]
        group=np.full(present.shape, -1, np.int32),  # pyright: ignore[reportArgumentType]
        present=present,  # pyright: ignore[reportArgumentType]
        person=np.where(present, column, -1),  # pyright: ignore[reportArgumentType]
        frame=np.arange(moments, dtype=np.int32),  # pyright: ignore[reportArgumentType]
        time_step=TIME_STEP,
    )


def corridor_of(run: RecordedRun, seed: int) -> Scene:
    """The corridor of a run and its exit, with people whose free speeds are drawn."""
    middle = WIDTH / 2.0
    half = run.exit_width / 2.0
    walls = [box((-WALL, EXIT), (0.0, 9.0)), box((WIDTH, EXIT), (WIDTH + WALL, 9.0))]
    if run.exit_width < WIDTH:
        walls.append(box((-WALL, EXIT - WALL), (middle - half, EXIT)))
        walls.append(box((middle + half, EXIT - WALL), (WIDTH + WALL, EXIT)))

    # Who walks along -y has +x on the left.
    door = Gate((middle + half, EXIT), (middle - half, EXIT))
    behind = Gate((WIDTH + 1.0, EXIT - BEHIND), (-1.0, EXIT - BEHIND))
    present = np.asarray(run.tracks.present)
    first, _ = first_and_last(present)
    people = np.arange(present.shape[1])
    start = np.asarray(run.tracks.position)[first, people]
    speed = hermes_speeds(len(people), seed)
    crowd = walkers(start, route=(0, 1), speed=speed, entry_time=NEVER)
    return Scene(np.concatenate(walls), crowd, (door, behind), TIME_STEP * run.steady.stop, seed=seed)


# ------------------------------------------------------------------ people who come as recorded


@struct.dataclass
class RecordedEntries:
    """Walkers, whom a recording moves at first: T moments, one control step apart, of N people."""

    walkers: Behavior  # of free people
    position: Float[Array, "T N 2"]  # m
    velocity: Float[Array, "T N 2"]  # m/s
    recorded: Bool[Array, "T N"]  # whether the recording moves a person


def recorded_entries(scenario: Scenario, run: RecordedRun) -> Scenario:
    """The scenario of a run's corridor, whose people come as recorded until ``FREE_FROM``."""
    velocity, _ = motion_between_rows(run.tracks)
    position = np.asarray(run.tracks.position)

    # Who has crossed the line once is free, also after a step back.
    has_crossed = np.logical_or.accumulate(np.asarray(run.tracks.present) & (position[..., 1] < FREE_FROM), axis=0)
    recorded = np.asarray(run.tracks.present) & ~has_crossed
    missing = scenario.people - recorded.shape[1]
    pad = [(0, 0), (0, missing), (0, 0)]
    data = RecordedEntries(
        walkers=scenario.behavior,
        position=jnp.asarray(np.pad(position, pad), float),
        velocity=jnp.asarray(np.pad(np.asarray(velocity), pad), float),
        recorded=jnp.asarray(np.pad(recorded, pad[:2])),
    )
    behavior = replace(scenario.behavior, data=data, name="recorded_entries", reset=reset, direct=direct)
    return replace(scenario, behavior=behavior)


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """N people, none of whom has come yet."""
    walkers = scenario.behavior.data.walkers
    return walkers.reset(replace(scenario, behavior=walkers), key)


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """Send free people to their gates, and put the others where they were recorded."""
    entries: RecordedEntries = scenario.behavior.data
    state = entries.walkers.direct(replace(scenario, behavior=entries.walkers), state, key)
    people = state.pedestrians
    moment = jnp.minimum(state.tick, entries.recorded.shape[0] - 1)
    is_recorded = entries.recorded[moment]
    column = is_recorded[:, None]
    velocity = entries.velocity[moment]
    people = replace(
        people,
        present=people.present | is_recorded,
        position=jnp.where(column, entries.position[moment], people.position),
        velocity=jnp.where(column, velocity, people.velocity),
        desired_velocity=jnp.where(column, velocity, people.desired_velocity),
    )
    return replace(state, pedestrians=people)


def walk_on(run: RecordedRun, model: Model, seed: int) -> tuple[Scene, Tracks]:
    """The corridor of a run, and its people, who are simulated from ``FREE_FROM`` on."""
    scene = corridor_of(run, seed)
    scenario = recorded_entries(scenario_of(scene, model), run)
    state = stage(scenario, scene)
    moments = jnp.arange(run.steady.stop, dtype=jnp.int32)
    position, present = jax.tree.map(np.asarray, _walk(scenario, state, moments))

    # A row is one step after the one before; people beyond N are padding.
    number = run.tracks.present.shape[1]
    position = np.concatenate([np.asarray(state.pedestrians.position)[None], position])
    present = np.concatenate([np.asarray(state.pedestrians.present)[None], present])
    return scene, _tracks(position[:, :number].astype(float), present[:, :number])


@jax.jit
def _walk(scenario: Scenario, state: State, moments: Int[Array, "T"]) -> tuple[Array, Array]:
    def one(state: State, _: Array) -> tuple[State, tuple[Array, Array]]:
        after = advance(scenario, state)
        return after, (after.pedestrians.position, after.pedestrians.present)

    return jax.lax.scan(one, state, moments)[1]


# ------------------------------------------------------------------ measures


def measure(tracks: Tracks, steady: slice) -> Passage:
    """Speed, density and flow at the steady moments of a run.

    Raises:
        Skipped: PedPy is not installed.
    """
    rows = slice(steady.start, steady.stop, ROWS * 2)
    density = []
    speeds = []
    for upper, lower in itertools.pairwise(SLICES):
        values = area_series(tracks, FLOOR, (0.0, lower, WIDTH, upper), rows)  # (K, 2)
        density.append(values[:, 0].mean())
        speeds.append(np.nanmean(values[:, 1]))

    # People who leave are counted while the run is steady.
    line = Gate((WIDTH + 0.5, EXIT), (-0.5, EXIT))
    times = crossing_times(tracks, line)
    begin, end = TIME_STEP * steady.start, TIME_STEP * steady.stop
    times = np.where((times >= begin) & (times <= end), times, np.inf)

    weights = np.array(density)
    return Passage(
        speed=float((weights * speeds).sum() / weights.sum()),
        deviation=float(individual_speeds(tracks, steady).std()),
        flow=float(flow(times)),
        density=weights,
        speeds=np.array(speeds),
    )


def individual_speeds(tracks: Tracks, steady: slice) -> Float[np.ndarray, "K"]:
    """Speeds [m/s] of people between the first and the last border, over ``SPEED_SPAN`` before and after."""
    reach = round(SPEED_SPAN / TIME_STEP)
    position = np.asarray(tracks.position, float)
    present = np.asarray(tracks.present)
    moment = np.arange(steady.start, min(steady.stop, len(position) - reach), ROWS)
    y = position[moment, :, 1]
    there = present[moment - reach] & present[moment + reach] & (y < SLICES[0]) & (y > SLICES[-1])
    step = np.linalg.norm(position[moment + reach] - position[moment - reach], axis=-1)  # (K, N) m
    return step[there] / (2.0 * reach * TIME_STEP)


def mean_passage(passages: list[Passage]) -> Passage:
    """The mean of several draws."""
    return Passage(*(np.mean(values, axis=0) for values in zip(*passages, strict=True)))


def walk_runs_again(context: CheckContext) -> CheckResult:
    """Speed, its deviation, density on the way to the exit, and flow of recorded runs that are walked again.

    Raises:
        Skipped: there are no runs, or PedPy is not installed.
    """
    pedpy()  # before what takes long
    found = runs(context.recordings() / "juelich")
    if not found:
        raise Skipped("no runs in juelich; give a folder with juelich/uo-180-180-180_4of16fps.csv with --data.")
    known = {}
    walked = {}
    for run in context.progress(found):
        passages = []
        for seed in range(1 if context.quick else DRAWS):
            scene, tracks = walk_on(run, context.model, seed)
            passages.append(measure(tracks, run.steady))
            if seed == 0:
                context.pictures.append((run.name, scene, tracks))
        known[run.name] = measure(run.tracks, run.steady)
        walked[run.name] = mean_passage(passages)
    return compare_passages(known, walked)


def compare_passages(known: dict[str, Passage], walked: dict[str, Passage]) -> CheckResult:
    """The result of runs by name, recorded and walked again."""
    misses = []
    words = []
    numbers = {}
    curves = []
    for name, recorded in known.items():
        again = walked[name]
        change = changes(recorded, again)
        misses += [f"{name} {what}" for what in _missed(change)]

        profile = ", ".join(f"{value:+.0%}" for value in change.profile)
        words.append(
            f"{name}: speed {change.speed:+.0%} of {recorded.speed:.2f} m/s, density {change.density:+.0%} of "
            f"{recorded.density.mean():.2f} /m² ({profile} towards the exit), flow {change.flow:+.0%} of "
            f"{recorded.flow:.2f} /s, deviation of speeds {change.spread:.2f} times {recorded.deviation:.2f} m/s"
        )
        numbers |= by_name(f"profile_{name}_", MIDDLES, change.profile)
        for what in ("speed", "density", "flow", "spread"):
            numbers[f"{what}_{name}"] = getattr(change, what)
        curves.append(curve(name, MIDDLES, again.density))
        curves.append(reference(f"{name}, recorded", MIDDLES, recorded.density))

    least, most = SPREAD
    wanted = f"speed, density, each part of it and flow within {TOLERANCE:.0%}, deviation {least:g} to {most:g} times"
    if misses:
        wanted += f" (missed: {', '.join(misses)})"
    return result(
        not misses,
        "; ".join(words),
        wanted,
        numbers=numbers,
        curves=tuple(curves),
        axes=("distance to the exit [m]", "density [1/m²]"),
    )


class Changes(NamedTuple):
    """What is different in a run that is walked again, as shares of the recorded values."""

    speed: float
    density: float
    flow: float
    spread: float  # times the recorded deviation of speeds
    profile: Float[np.ndarray, "P"]  # of the densities towards the exit


def changes(recorded: Passage, again: Passage) -> Changes:
    """The changes from a recorded to a simulated passage."""
    return Changes(
        speed=again.speed / recorded.speed - 1.0,
        density=float(again.density.mean() / recorded.density.mean() - 1.0),
        flow=again.flow / recorded.flow - 1.0,
        spread=again.deviation / recorded.deviation,
        profile=again.density / recorded.density - 1.0,
    )


def _missed(change: Changes) -> list[str]:
    """The names of what is not as recorded; NaN is not."""
    least, most = SPREAD
    missed = [what for what in ("speed", "density", "flow") if not abs(getattr(change, what)) <= TOLERANCE]
    if not np.abs(change.profile).max() <= TOLERANCE:
        missed.append("profile")
    if not least <= change.spread <= most:
        missed.append("deviation")
    return missed

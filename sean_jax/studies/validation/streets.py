"""Checks of motion in recorded streets: people who enter when and where they did walk again to where they left.

A recording is cut into windows. Who is there at the beginning of one starts there, at their recorded velocity; the
others enter when they were first seen. Recorded and simulated people are measured in the same windows.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax.people.recordings import Tracks, read, read_companions
from sean_jax.studies.scenes import Gate, Scene, join, walkers
from sean_jax.studies.validation.checks import CheckContext, CheckResult, Curve, result
from sean_jax.studies.validation.measures import Motion, company, motion, sideways, slowest, smoothed

TIME_STEP = 0.4  # s, of the recordings of ETH and UCY
WINDOW = 150  # moments
LEAST_WAY, LEAST_MOMENTS = 2.0, 5  # m and moments, of people who walk
GATE = 1.2  # m, width of the line where a person left
STRIDE = 4  # moments of a simulation, 0.1 s, in one of the recordings
TOLERANCE = 0.25
TINY = 1e-6  # m/s2, m/s3 or rad/s, of people who walk straight on
QUICK_WINDOWS = 2
NO_WALLS = np.zeros((0, 5))


@dataclass(frozen=True)
class Street:
    """A window of a recording: T moments of N people who walk."""

    position: Float[np.ndarray, "T N 2"]  # m
    present: Bool[np.ndarray, "T N"]
    goal: Float[np.ndarray, "N 2"]  # m, where they left, maybe later
    speed: Float[np.ndarray, "N"]  # m/s, mean of the whole recording
    group: Int[np.ndarray, "N"]  # of the recording, with whom they walk; -1 alone

    def pairs(self) -> Int[np.ndarray, "P 2"]:
        """Columns of two who walk together, without others."""
        members = [np.flatnonzero(self.group == each) for each in np.unique(self.group[self.group >= 0])]
        return np.array([each for each in members if len(each) == 2], int).reshape(-1, 2)


def windows_by_recording(context: CheckContext) -> dict[str, list[Street]]:
    """The ``streets`` of each recording of ETH and UCY by its name; a quick check takes the first two.

    Raises:
        Skipped: there are no recordings.
    """
    most = QUICK_WINDOWS if context.quick else None
    return {path.stem: streets(path)[:most] for path in context.eth_ucy()}


def streets(path: str | Path) -> list[Street]:
    """The windows of a recording of ETH or UCY with two or more people; groups are in a file beside it or none.

    Raises:
        FileError: a file cannot be read.
    """
    path = Path(path)
    tracks = read(path, "eth_ucy", time_step=None)
    groups = path.with_name(f"{path.stem}.groups.txt")
    group = read_companions(groups, tracks) if groups.is_file() else np.full(tracks.present.shape[1], -1)
    position, present = np.asarray(tracks.position, float), np.asarray(tracks.present)
    own, first = np.arange(present.shape[1]), present.argmax(0)
    last = len(present) - 1 - present[::-1].argmax(0)
    way = np.linalg.norm(position[last, own] - position[first, own], axis=-1)
    walks = (way > LEAST_WAY) & (present.sum(0) >= LEAST_MOMENTS)
    step = np.linalg.norm(np.diff(position, axis=0), axis=-1) * (present[1:] & present[:-1])
    speed = step.sum(0) / np.maximum((last - first) * tracks.time_step, tracks.time_step)
    windows = []
    for begin in range(0, len(present) - 1, WINDOW):
        rows = slice(begin, begin + WINDOW)
        chosen = np.flatnonzero(walks & (present[rows].sum(0) >= LEAST_MOMENTS))
        if len(chosen) >= 2:
            part = position[rows][:, chosen], present[rows][:, chosen], position[last[chosen], chosen], speed[chosen]
            windows.append(Street(*part, group[chosen]))
    return windows


def walked_again(street: Street) -> Scene:
    """The scene in which people of a window enter when and where they did, and walk to where they left."""
    number = street.present.shape[1]
    own, first = np.arange(number), street.present.argmax(0)
    start = street.position[first, own]
    velocity = (street.position[first + 1, own] - start) / TIME_STEP
    way = street.goal - start
    way = way / np.maximum(np.linalg.norm(way, axis=-1), 1e-9)[:, None]
    left = street.goal + 0.5 * GATE * np.stack([-way[:, 1], way[:, 0]], 1)
    gates = tuple(Gate(tuple(a), tuple(2.0 * b - a)) for a, b in zip(left, street.goal, strict=True))
    chain = np.full((number, 2), -1, np.int32)
    for group in np.unique(street.group[street.group >= 0]):
        members = np.flatnonzero(street.group == group)
        ahead = way[members].mean(0)
        order = members[np.argsort(start[members] @ np.array([-ahead[1], ahead[0]]))]  # side by side, from the right
        chain[order[1:], 0], chain[order[:-1], 1] = order[:-1], order[1:]
    each = [
        walkers(start[k : k + 1], route=(k,), speed=street.speed[k], velocity=tuple(velocity[k])) for k in range(number)
    ]
    crowd = replace(join(*each), entry_time=first * TIME_STEP, companion=chain)
    return Scene(NO_WALLS, crowd, gates, (len(street.present) - 1) * TIME_STEP)


class Walk(NamedTuple):
    """How people of one recording move."""

    motion: Motion
    sideways: np.ndarray  # m, of each person
    slowest: np.ndarray  # of each person, over the first
    spacing: np.ndarray  # m, of pairs at all moments
    beside: np.ndarray  # whether pairs walk side by side


def measure(windows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Walk:
    """The motion in windows of positions [m], presence and pairs; recorded and simulated ones are smoothed alike."""
    motions = [motion(*smoothed(position, present), TIME_STEP) for position, present, _ in windows]
    together = [company(position, present, pairs, TIME_STEP) for position, present, pairs in windows]
    rest = [
        np.concatenate([function(position, present) for position, present, _ in windows])
        for function in (sideways, slowest)
    ]
    joined = (np.concatenate(parts) for parts in zip(*motions, strict=True))
    pairs = (np.concatenate(parts) for parts in zip(*together, strict=True))
    return Walk(Motion(*joined), *rest, *pairs)


def walk_again(context: CheckContext) -> CheckResult:
    """Accelerations, jerk and turn rates of streets that are walked again, against the recordings.

    Raises:
        Skipped: there are no recordings.
    """
    several = windows_by_recording(context)
    scenes = [walked_again(street) for windows in several.values() for street in windows]
    captions = ["" if k else name for name, windows in several.items() for k in range(len(windows))]
    simulated = iter(context.simulate(scenes, captions))
    both = {}
    for name, windows in several.items():
        recorded = measure([(street.position, street.present, street.pairs()) for street in windows])
        again = measure([_sampled(next(simulated), street) for street in windows])
        both[name] = recorded, again
    return compare_walks(both)


def _sampled(tracks: Tracks, street: Street) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.asarray(tracks.position)[::STRIDE], np.asarray(tracks.present)[::STRIDE], street.pairs()


UNITS = {"acceleration": "m/s²", "jerk": "m/s³", "turn_rate": "rad/s"}  # of magnitudes


def compare_walks(both: dict[str, tuple[Walk, Walk]]) -> CheckResult:
    """The result of the motion in several recordings, recorded and simulated."""
    words, numbers = [], {}
    ratios = {what: [] for what in UNITS}
    for name, (recorded, again) in both.items():
        values = {what: (summary(recorded)[what], value) for what, value in summary(again).items()}
        for what in UNITS:
            ratios[what].append(max(values[what][1], TINY) / max(values[what][0], TINY))
        numbers |= {f"{what}_{name}": own for what, (_, own) in values.items()}
        numbers |= {f"{what}_{name}_recorded": known for what, (known, _) in values.items()}
        each = (f"{what.replace('_', ' ')} {own:.2f} ({known:.2f})" for what, (known, own) in values.items())
        words.append(f"{name}: {', '.join(each)}")
    mean = {what: float(np.exp(np.mean(np.log(each)))) for what, each in ratios.items()}
    numbers |= {f"ratio_{what}": value for what, value in mean.items()}
    number = tuple(float(k) for k in range(1, len(both) + 1))
    return result(
        all(abs(value - 1.0) <= TOLERANCE for value in mean.values()),
        f"{', '.join(f'{what} {value:.2f}' for what, value in mean.items())} times the recorded; {'; '.join(words)} "
        "(recorded)",
        f"95th percentiles of {', '.join(UNITS)} within {100 * TOLERANCE:.0f} % of the recorded, in the mean of scenes",
        numbers=numbers,
        curves=(
            *(Curve(what, number, tuple(each), points=True) for what, each in ratios.items()),
            Curve("recorded", (number[0], number[-1]), (1.0, 1.0), reference=True),
        ),
        axes=("scene: " + ", ".join(f"{k + 1} {name}" for k, name in enumerate(both)), "95th percentile / recorded"),
    )


def summary(walk: Walk) -> dict[str, float]:
    """The 95th percentiles of ``UNITS``, and medians or means of the rest; NaN without pairs."""
    values = {what: float(np.quantile(getattr(walk.motion, what), 0.95)) for what in UNITS}
    values |= {what: float(np.nanmedian(getattr(walk, what))) for what in ("sideways", "slowest")}
    pairs = bool(len(walk.spacing))
    spacing = (walk.spacing.mean(), walk.spacing.std(), walk.beside.mean()) if pairs else (np.nan,) * 3
    return values | dict(zip(("spacing", "spacing_deviation", "beside"), map(float, spacing), strict=True))

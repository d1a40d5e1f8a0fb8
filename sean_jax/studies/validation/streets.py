"""Checks of motion in recorded streets: people who enter when and where they did walk again to where they left.

A recording is cut into windows. Who is there at the beginning of one starts there, at their recorded velocity; the
others enter when they were first seen. Recorded and simulated people are measured in the same windows.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax.people.intent import Intent
from sean_jax.people.recordings import Tracks, read, read_companions
from sean_jax.studies.scenes import Gate, Scene, join, walkers
from sean_jax.studies.validation.checks import (
    CheckContext,
    CheckResult,
    curve,
    level,
    numbered,
    result,
)
from sean_jax.studies.validation.measures import (
    Motion,
    company,
    first_and_last,
    motion,
    sideways,
    slowest,
    smoothed,
)

TIME_STEP = 0.4  # s, of the recordings of ETH and UCY
WINDOW = 150  # moments
LEAST_WAY = 2.0  # m, of people who walk
LEAST_MOMENTS = 5  # likewise
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
    velocity: Float[np.ndarray, "N 2"] | None = None  # m/s, at the first moment; None: towards the second one

    def pairs(self) -> Int[np.ndarray, "P 2"]:
        """Columns of two who walk together, without others."""
        return np.array([members for members in self.groups() if len(members) == 2], int).reshape(-1, 2)

    def groups(self) -> list[np.ndarray]:
        """The columns of each group."""
        return [np.flatnonzero(self.group == name) for name in np.unique(self.group[self.group >= 0])]


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
    position = np.asarray(tracks.position, float)
    present = np.asarray(tracks.present)
    people = np.arange(present.shape[1])
    file = path.with_name(f"{path.stem}.groups.txt")
    group = read_companions(file, tracks) if file.is_file() else np.full(len(people), -1)

    # Who hardly moves does not walk, and is left out.
    first, last = first_and_last(present)
    goal = position[last, people]
    way = np.linalg.norm(goal - position[first, people], axis=-1)
    walks = (way > LEAST_WAY) & (present.sum(0) >= LEAST_MOMENTS)
    both = present[1:] & present[:-1]
    step = np.linalg.norm(np.diff(position, axis=0), axis=-1) * both  # (T - 1, N) m

    # The mean speed is the whole way over the whole time, with gaps in it.
    time = (last - first) * tracks.time_step
    speed = step.sum(0) / np.maximum(time, tracks.time_step)

    # Goals and speeds are of the whole recording, also if a person is in several windows.
    windows = []
    for begin in range(0, len(position) - 1, WINDOW):
        window = slice(begin, begin + WINDOW)
        chosen = np.flatnonzero(walks & (present[window].sum(0) >= LEAST_MOMENTS))
        if len(chosen) < 2:
            continue
        street = Street(
            position=position[window][:, chosen],
            present=present[window][:, chosen],
            goal=goal[chosen],
            speed=speed[chosen],
            group=group[chosen],
        )
        windows.append(street)
    return windows


def walked_again(street: Street, intent: Intent | None = None) -> Scene:
    """The scene in which people of a window enter when and where they did, and walk to where they left."""
    # Only ends are given: what is between them has to come from the model and can be compared.
    people = np.arange(street.present.shape[1])
    first = street.present.argmax(0)  # (N,)
    start = street.position[first, people]  # (N, 2) m
    velocity = street.velocity  # (N, 2) m/s
    if velocity is None:
        velocity = (street.position[first + 1, people] - start) / TIME_STEP
    way = street.goal - start  # (N, 2) m
    way = way / np.maximum(np.linalg.norm(way, axis=-1), 1e-9)[:, None]

    # Everybody has a gate of their own, a line across the way where they left.
    crowd = []
    gates = []
    for k in people:
        person = walkers(
            start[k : k + 1],
            route=(k,),
            speed=street.speed[k],
            velocity=tuple(velocity[k]),
        )
        crowd.append(person)

        # The normal to the left of (x, y) is (-y, x); the other end is opposite to it.
        goal = street.goal[k]
        x, y = way[k]
        left = goal + 0.5 * GATE * np.array([-y, x])
        right = 2.0 * goal - left
        gates.append(Gate(tuple(left), tuple(right)))

    # Members of a group walk side by side: each has the one on the right and the one on the left as companions.
    companion = np.full((len(people), 2), -1, np.int32)
    for members in street.groups():
        ahead = way[members].mean(0)  # (2,)
        to_left = start[members] @ np.array([-ahead[1], ahead[0]])
        order = members[np.argsort(to_left)]
        companion[order[1:], 0] = order[:-1]
        companion[order[:-1], 1] = order[1:]

    # Who comes later enters at the time of the recording, so that density changes as it did.
    entering = replace(join(*crowd), entry_time=first * TIME_STEP, companion=companion)
    seconds = (len(street.present) - 1) * TIME_STEP
    return Scene(NO_WALLS, entering, tuple(gates), seconds, intent=intent)


class Walk(NamedTuple):
    """How people of one recording move."""

    motion: Motion
    sideways: np.ndarray  # m, of each person
    slowest: np.ndarray  # of each person, over the first
    spacing: np.ndarray  # m, of pairs at all moments
    beside: np.ndarray  # whether pairs walk side by side


def measure(windows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Walk:
    """The motion in windows of positions [m], presence and pairs; recorded and simulated ones are smoothed alike."""
    motions = []
    deviations = []
    slowest_steps = []
    together = []
    for position, present, pairs in windows:
        motions.append(motion(*smoothed(position, present), TIME_STEP))
        deviations.append(sideways(position, present))
        slowest_steps.append(slowest(position, present))
        together.append(company(position, present, pairs, TIME_STEP))

    magnitudes = map(np.concatenate, zip(*motions, strict=True))
    spacing, beside = map(np.concatenate, zip(*together, strict=True))
    return Walk(Motion(*magnitudes), np.concatenate(deviations), np.concatenate(slowest_steps), spacing, beside)


def walk_again(context: CheckContext) -> CheckResult:
    """Accelerations, jerk and turn rates of streets that are walked again, against the recordings.

    Raises:
        Skipped: there are no recordings.
    """
    recordings = windows_by_recording(context)
    scenes = []
    captions = []
    for name, windows in recordings.items():
        scenes += [walked_again(street) for street in windows]
        captions += [name, *[""] * (len(windows) - 1)][: len(windows)]

    simulated = iter(context.simulate(scenes, captions))
    walks = {}
    for name, windows in recordings.items():
        recorded = measure([(street.position, street.present, street.pairs()) for street in windows])
        again = measure([_sampled(next(simulated), street) for street in windows])
        walks[name] = recorded, again
    return compare_walks(walks)


def _sampled(tracks: Tracks, street: Street) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and presence at the moments of the recording, and pairs."""
    position = np.asarray(tracks.position)[::STRIDE]
    present = np.asarray(tracks.present)[::STRIDE]
    return position, present, street.pairs()


UNITS = {"acceleration": "m/s²", "jerk": "m/s³", "turn_rate": "rad/s"}  # of magnitudes


def compare_walks(walks: dict[str, tuple[Walk, Walk]]) -> CheckResult:
    """The result of the motion in several recordings, recorded and simulated."""
    words = []
    numbers = {}
    ratios: dict[str, list[float]] = {name: [] for name in UNITS}
    for scene, (recorded, again) in walks.items():
        known = summary(recorded)
        simulated = summary(again)

        # The ratio is of magnitudes; a floor keeps its logarithm finite for people who walk straight on.
        for name in UNITS:
            ratios[name].append(max(simulated[name], TINY) / max(known[name], TINY))

        numbers |= {f"{name}_{scene}": value for name, value in simulated.items()}
        numbers |= {f"{name}_{scene}_recorded": value for name, value in known.items()}
        values = []
        for name, value in simulated.items():
            values.append(f"{name.replace('_', ' ')} {value:.2f} ({known[name]:.2f})")
        words.append(f"{scene}: {', '.join(values)}")

    # The geometric mean: twice and half as much as recorded balance each other.
    mean = {}
    for name, values in ratios.items():
        logarithm = np.mean(np.log(values))
        mean[name] = float(np.exp(logarithm))
    numbers |= {f"ratio_{name}": value for name, value in mean.items()}

    number, scenes = numbered(walks)
    curves = [curve(name, number, values, points=True) for name, values in ratios.items()]
    curves.append(level("recorded", number, 1.0))

    # 95th percentiles, because the largest values of a recording are often errors of tracking (rough in eth and hotel).
    mean_words = ", ".join(f"{name} {value:.2f}" for name, value in mean.items())
    return result(
        all(abs(value - 1.0) <= TOLERANCE for value in mean.values()),
        f"{mean_words} times the recorded; {'; '.join(words)} (recorded)",
        f"95th percentiles of {', '.join(UNITS)} within {100 * TOLERANCE:.0f} % of the recorded, in the mean of scenes",
        numbers=numbers,
        curves=tuple(curves),
        axes=(f"scene: {scenes}", "95th percentile / recorded"),
    )


def summary(walk: Walk) -> dict[str, float]:
    """The 95th percentiles of ``UNITS``, and medians or means of the rest; NaN without pairs."""
    values = {name: float(np.quantile(getattr(walk.motion, name), 0.95)) for name in UNITS}
    values["sideways"] = float(np.nanmedian(walk.sideways))
    values["slowest"] = float(np.nanmedian(walk.slowest))

    values |= dict.fromkeys(("spacing", "spacing_deviation", "beside"), np.nan)
    if len(walk.spacing):
        values["spacing"] = float(walk.spacing.mean())
        values["spacing_deviation"] = float(walk.spacing.std())
        values["beside"] = float(walk.beside.mean())
    return values

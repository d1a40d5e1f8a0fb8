"""Recorded people as tables at the control step (playback, section IV-D): who is where, when they are there."""

import heapq
import math
from pathlib import Path

import numpy as np
from flax import struct

from sean_jax.base import Array
from sean_jax.files import FileError, shown
from sean_jax.quantities import MOST_PEOPLE
from sean_jax.recordings import lines
from sean_jax.recordings.lines import LONGEST_GAP, ROUNDING, Lines

MOST_MOMENTS = 5_000_000  # of all people together
MOST_STEPS = 1_000_000  # from the first moment to the last
WALKING = 0.1  # m/s: who is slower keeps the heading


@struct.dataclass
class Tracks:
    """T moments, one control step apart, of as many people as are there at once; a row serves one after another."""

    position: Array  # (T, N, 2) m; of who is absent, where somebody was or will be
    velocity: Array  # (T, N, 2) m/s, that led to the position; zero of who is absent
    heading: Array  # (T, N, 2) unit vector
    present: Array  # (T, N) bool


def read(path: str | Path, frame_rate: float | None, time_step: float, kind: str | None = None) -> Tracks:
    """The recording in a CSV file, read by ``recordings.lines``: its clock is that of its format unless told otherwise.

    Positions at the control steps are interpolated linearly. Nobody is there before their first row, after their
    last one, or in between for more than 2 s without any.

    Raises:
        FileError: the file does not exist or holds something else, with the line.
    """
    found = lines.read(path, kind, frame_rate)
    walks = _walks(found)
    first = min(walk[0, 0] for walk in walks)
    moments = sum(walk[-1, 0] - walk[0, 0] for walk in walks) / time_step
    if moments > MOST_MOMENTS or (max(walk[-1, 0] for walk in walks) - first) / time_step > MOST_STEPS:
        raise FileError(
            f"{shown(Path(path))}: is too long to be played in steps of {time_step:g} s; cut the recording."
        )
    sampled = [sample for walk in walks if (sample := _sample(walk, first, time_step)) is not None]
    if not sampled:
        raise FileError(f"{shown(Path(path))}: nobody is there for two control steps of {time_step:g} s; is frame_rate "
                        f"{1.0 / found.seconds:g} frames a second right?")  # fmt: skip
    return _tables(sorted(sampled, key=lambda sample: sample[0]), time_step, Path(path))


def _walks(found: Lines) -> list[np.ndarray]:
    """(K, 3) time [s], x, y [m] for each stretch in which a person is there, person by person."""
    order = np.lexsort((found.values["frame"], found.person))
    frame, x, y = (found.values[name][order] for name in ("frame", "x", "y"))
    away = np.diff(frame) * found.seconds > LONGEST_GAP + ROUNDING
    ends = np.flatnonzero(away | (np.diff(found.person[order]) != 0)) + 1
    return np.split(np.stack([frame * found.seconds, x, y], -1), ends)


def _sample(walk: np.ndarray, first: float, time_step: float) -> tuple[int, np.ndarray] | None:
    """Number of the first control step in a walk and (K, 2) [m] the places from there on; None if there is but one."""
    begin = math.ceil((walk[0, 0] - first) / time_step - 1e-6)
    end = math.floor((walk[-1, 0] - first) / time_step + 1e-6)
    if end <= begin:
        return None
    time = first + np.arange(begin, end + 1) * time_step
    return begin, np.stack([np.interp(time, walk[:, 0], walk[:, k]) for k in (1, 2)], -1)


def _tables(sampled: list[tuple[int, np.ndarray]], time_step: float, path: Path) -> Tracks:
    """Walks in order of their begin, each in the first row that has been free for a step."""
    rows = _rows(sampled, path)
    moments = max(begin + len(places) for begin, places in sampled)
    if moments * len(rows) > MOST_MOMENTS:
        size = f"{moments:,} steps with up to {len(rows):,} people at once"
        raise FileError(f"{shown(path)}: {size} are too much to be played; cut the recording.")
    position, velocity = np.zeros((2, moments, len(rows), 2))
    heading, present = np.zeros((moments, len(rows), 2)), np.zeros((moments, len(rows)), bool)
    for n, row in enumerate(rows):
        before = 0
        for begin, places in row:
            end = begin + len(places)
            steps = np.diff(places, axis=0) / time_step
            position[before:begin, n], position[begin:end, n] = places[0], places
            velocity[begin:end, n] = np.concatenate([steps[:1], steps])
            present[begin:end, n] = True
            heading[before:end, n] = _headings(velocity[before:end, n])
            before = end
        position[before:, n], heading[before:, n] = position[before - 1, n], heading[before - 1, n]
    return Tracks(position, velocity, heading, present)  # pyright: ignore


def _rows(sampled: list[tuple[int, np.ndarray]], path: Path) -> list[list[tuple[int, np.ndarray]]]:
    """The walks of each row, in order."""
    rows: list[list[tuple[int, np.ndarray]]] = []
    busy: list[tuple[int, int]] = []  # heap of (the moment after a row's last walk, row)
    free: list[int] = []  # heap of rows
    for begin, places in sampled:
        while busy and busy[0][0] < begin:
            heapq.heappush(free, heapq.heappop(busy)[1])
        if not free:
            if len(rows) == MOST_PEOPLE:
                raise FileError(
                    f"{shown(path)}: more than {MOST_PEOPLE:,} people are there at once; cut the recording."
                )
            free.append(len(rows))
            rows.append([])
        row = heapq.heappop(free)
        rows[row].append((begin, places))
        heapq.heappush(busy, (begin + len(places), row))
    return rows


def _headings(velocity: np.ndarray) -> np.ndarray:
    """(T, 2) direction of the last velocity that was fast enough, or the first one that is, or along x."""
    speed = np.linalg.norm(velocity, axis=-1)
    fast = np.flatnonzero(speed > WALKING)
    if not len(fast):
        return np.tile([1.0, 0.0], (len(velocity), 1))
    latest = np.searchsorted(fast, np.arange(len(velocity)), side="right") - 1
    index = fast[np.maximum(latest, 0)]
    return velocity[index] / speed[index, None]

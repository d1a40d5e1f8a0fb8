"""Recorded people, predicted by any pedestrian model, and the errors: 8 observed and 12 predicted moments, 0.4 s apart.

[G18] A. Gupta, J. Johnson, L. Fei-Fei, S. Savarese & A. Alahi, "Social GAN", CVPR 2018: windows of 20 moments, one
beginning at each moment, of the people present throughout, if these are two or more. Errors are means over the tracks
of all windows. [S20] C. Schoeller, V. Aravantinos, F. Lay & A. Knoll, IEEE RA-L 5(2), 2020: constant velocity in the
same windows, the mark to beat.
"""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.core import random_streams
from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError
from sean_jax.io.files import short_name
from sean_jax.people.recordings import read
from sean_jax.people.recordings.reading import read_lines
from sean_jax.studies.prediction.forecast import HABITS, Predictable, observed_people, predict

__all__ = [
    "HABITS",
    "Predictable",
    "SampleScores",
    "Scores",
    "Windows",
    "evaluate",
    "evaluate_samples",
    "observed_people",
    "predict",
    "read_windows",
    "score",
    "score_samples",
]

SEEN, PREDICTED, TIME_STEP = 8, 12, 0.4  # moments, moments, s
FRAMES = 10  # of the recording, between two moments as [G18] takes them
TOUCH = 0.2  # m: a predicted pair nearer than this has collided
LEAST_LIKELY = -20.0  # the least logarithm of a density [S20b]


@struct.dataclass
class Windows:
    """B windows of a recording: T moments of up to N people who are present throughout."""

    position: Float[np.ndarray, "B T N 2"]  # m; of nobody zero
    present: Bool[np.ndarray, "B N"]
    time_step: float = struct.field(pytree_node=False)  # s between moments


class Scores(NamedTuple):
    """How good predictions are, over all tracks of some windows."""

    ade: float  # m, mean distance from where people were, over all predicted moments
    fde: float  # m, at the last predicted moment
    collisions: float  # share of the tracks that come within 0.2 m of another one of their window
    tracks: int


class SampleScores(NamedTuple):
    """How good K samples of a prediction are, over all tracks of some windows."""

    best_ade: float  # m, of each track's best sample, mean over the tracks
    best_fde: float  # m, likewise, at the last predicted moment
    nll: float  # of positions in m: minus the mean logarithm of a Gaussian kernel density of the samples
    samples: int


def read_windows(path: str | Path, clock: str = "social_gan") -> Windows:
    """The windows of a recording in the format of ETH and UCY: CSV with frame, ped_id, x_m and y_m.

    Args:
        clock: ``social_gan``: moments are ten frames apart and count as 0.4 s, as in [G18]. That holds for UCY and
            hotel; in eth ten frames are 0.67 s, so that people there seem fast. ``recorded``: moments are 0.4 s apart.

    Raises:
        FileError: the file cannot be read.
        InputError: there is no such clock, or not one window.
    """
    if clock == "social_gan":
        places = _every_ten_frames(Path(path))
    elif clock == "recorded":
        tracks = read(path, "eth_ucy")
        there = np.asarray(tracks.present)
        places = np.where(there[..., None], np.asarray(tracks.position, float), np.nan)
    else:
        raise InputError(f"clock: '{clock}' is not one of social_gan, recorded.")
    places = places[np.isfinite(places).any((1, 2))]  # moments without anybody do not count [G18]
    windows = cut_windows(places)
    if not len(windows.position):
        raise InputError(
            f"{short_name(Path(path))}: never are two people there for {SEEN + PREDICTED} moments of {TIME_STEP} s; "
            "take another recording."
        )
    return windows


def evaluate(model: Predictable, windows: Windows, chunk: int = 256, **options) -> Scores:
    """Predict the later moments of windows and compare.

    Args:
        chunk: windows at a time.
        **options: of ``predict``.
    """
    predicted = _predicted(model, windows, chunk, **options)
    return score(predicted, np.asarray(windows.position)[:, SEEN:], np.asarray(windows.present))


def evaluate_samples(
    model: Predictable, windows: Windows, samples: int = 20, seed: int = 0, chunk: int = 256, **options
) -> SampleScores:
    """Predict the later moments of windows several times, with the noise and the differences of people, and compare.

    Args:
        **options: of ``predict``.
    """
    keys = jax.random.split(random_streams.key("scene", seed), samples)
    predicted = np.stack([_predicted(model, windows, chunk, key=key, **options) for key in keys])
    return score_samples(predicted, np.asarray(windows.position)[:, SEEN:], np.asarray(windows.present))


def _predicted(model: Predictable, windows: Windows, chunk: int, key: Array | None = None, **options) -> np.ndarray:
    """(B, S, N, 2) m, a number of windows at a time."""
    steps = windows.position.shape[1] - SEEN
    parts = []
    for first in range(0, len(windows.position), chunk):
        some, there = (np.asarray(part[first : first + chunk]) for part in (windows.position, windows.present))
        missing = chunk - len(some) if len(windows.position) > chunk else 0  # one shape, compiled once
        some = np.pad(some, ((0, missing), (0, 0), (0, 0), (0, 0)))[:, :SEEN]
        there = np.broadcast_to(np.pad(there, ((0, missing), (0, 0)))[:, None], some.shape[:3])
        own = None if key is None else jax.random.fold_in(key, first)
        places = jnp.asarray(some), windows.time_step, steps
        predicted = predict(model, *places, present=jnp.asarray(there), key=own, **options)
        parts.append(np.asarray(predicted)[: chunk - missing])
    return np.concatenate(parts)


def score(
    predicted: Float[np.ndarray, "B S N 2"], recorded: Float[np.ndarray, "B S N 2"], present: Bool[np.ndarray, "B N"]
) -> Scores:
    """Errors and collisions of predictions (B, S, N, 2) m, at the predicted moments, of the tracks (B, N) present."""
    predicted, recorded, present = np.asarray(predicted, float), np.asarray(recorded, float), np.asarray(present)
    away = np.linalg.norm(predicted - recorded, axis=-1)  # (B, S, N)
    number = present.shape[1]
    touched = np.zeros(present.shape, bool)
    for one in range(number):  # pair by pair, for windows may be many
        for other in range(one + 1, number):
            both = present[:, one] & present[:, other]
            gap = np.linalg.norm(predicted[:, :, one] - predicted[:, :, other], axis=-1).min(1)
            hit = both & (gap < TOUCH)
            touched[:, one] |= hit
            touched[:, other] |= hit
    return Scores(
        float(away.mean(1)[present].mean()),
        float(away[:, -1][present].mean()),
        float(touched[present].mean()),
        int(present.sum()),
    )


def score_samples(
    predicted: Float[np.ndarray, "K B S N 2"],
    recorded: Float[np.ndarray, "B S N 2"],
    present: Bool[np.ndarray, "B N"],
) -> SampleScores:
    """The best of K samples of each track (B, N) present, and the likelihood of what was recorded, by moment [S20b].

    The kernels have Scott's width. Where the samples lie on a line, the likelihood is the least.
    """
    predicted, recorded = (np.moveaxis(np.asarray(part, float), -2, -3) for part in (predicted, recorded))
    predicted, recorded = predicted[:, present], recorded[present]  # (K, tracks, S, 2), (tracks, S, 2)
    away = np.linalg.norm(predicted - recorded, axis=-1)
    return SampleScores(
        float(away.mean(-1).min(0).mean()),
        float(away[..., -1].min(0).mean()),
        -float(_log_density(predicted, recorded).mean()),
        len(predicted),
    )


def _log_density(samples: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(...) logarithm of the density of K samples (K, ..., 2) at a place (..., 2), ``LEAST_LIKELY`` at least."""
    number = len(samples)
    away = samples - samples.mean(0)
    spread = np.einsum("k...i,k...j->...ij", away, away) / max(number - 1, 1) * number ** (-1.0 / 3.0)  # Scott, squared
    determinant = np.linalg.det(spread)
    usable = determinant > 1e-12
    inverse = np.linalg.inv(np.where(usable[..., None, None], spread, np.eye(2)))
    gap = samples - place
    power = -0.5 * np.einsum("k...i,...ij,k...j->k...", gap, inverse, gap)
    density = np.exp(power).mean(0) / (2.0 * np.pi * np.sqrt(np.where(usable, determinant, 1.0)))
    return np.where(usable, np.log(np.maximum(density, np.exp(LEAST_LIKELY))), LEAST_LIKELY)


def _every_ten_frames(path: Path) -> np.ndarray:
    """(T, N, 2) m at frames 0, 10, 20, ..., NaN of absent people, who begin at the frame before their first line."""
    recorded = read_lines(path, "eth_ucy")
    order = np.lexsort((recorded.values["frame"], recorded.person))
    frame, x, y = (recorded.values[name][order] for name in ("frame", "x", "y"))
    ends = np.flatnonzero(np.diff(recorded.person[order])) + 1
    first = np.floor(frame.min() / FRAMES)
    count = int(np.floor(frame.max() / FRAMES) - first) + 1
    places = np.full((count, len(ends) + 1, 2), np.nan)
    for column, (own, own_x, own_y) in enumerate(zip(*(np.split(each, ends) for each in (frame, x, y)), strict=True)):
        if len(own) < 2:
            continue
        begin, end = int(np.floor(own[0] / FRAMES) - first), int(np.floor(own[-1] / FRAMES) - first)
        time = (first + np.arange(begin, end + 1)) * FRAMES
        early = np.minimum(time - own[0], 0.0) / (own[1] - own[0])
        for axis, line in enumerate((own_x, own_y)):
            places[begin : end + 1, column, axis] = np.interp(time, own, line) + early * (line[1] - line[0])
    return places


def cut_windows(places: np.ndarray, length: int = SEEN + PREDICTED) -> Windows:
    """The windows of some moments of a recording (T, N, 2) m, NaN of absent people."""
    there = np.asarray(np.isfinite(places).all(-1))
    columns = [np.flatnonzero(there[begin : begin + length].all(0)) for begin in range(len(places) - length + 1)]
    windows = [places[k : k + length, own] for k, own in enumerate(columns) if len(own) >= 2]
    people = max((each.shape[1] for each in windows), default=0)
    position, present = np.zeros((len(windows), length, people, 2)), np.zeros((len(windows), people), bool)
    for row, each in enumerate(windows):
        position[row, :, : each.shape[1]], present[row, : each.shape[1]] = each, True
    return Windows(position=position, present=present, time_step=TIME_STEP)

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

SEEN = 8  # moments
PREDICTED = 12  # moments
TIME_STEP = 0.4  # s
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
        present = np.asarray(tracks.present)
        places = np.where(present[..., None], np.asarray(tracks.position, float), np.nan)
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
    recorded = np.asarray(windows.position)[:, SEEN:]
    return score(predicted, recorded, np.asarray(windows.present))


def evaluate_samples(
    model: Predictable, windows: Windows, samples: int = 20, seed: int = 0, chunk: int = 256, **options
) -> SampleScores:
    """Predict the later moments of windows several times, with the noise and the differences of people, and compare.

    Args:
        **options: of ``predict``.
    """
    keys = jax.random.split(random_streams.key("scene", seed), samples)
    predicted = [_predicted(model, windows, chunk, key=key, **options) for key in keys]
    recorded = np.asarray(windows.position)[:, SEEN:]
    return score_samples(np.stack(predicted), recorded, np.asarray(windows.present))


def _predicted(model: Predictable, windows: Windows, chunk: int, key: Array | None = None, **options) -> np.ndarray:
    """(B, S, N, 2) m, a number of windows at a time."""
    number, moments = windows.position.shape[:2]
    steps = moments - SEEN
    parts = []
    for first in range(0, number, chunk):
        observed = np.asarray(windows.position[first : first + chunk])[:, :SEEN]
        present = np.asarray(windows.present[first : first + chunk])

        # All chunks have one shape, which is compiled once.
        missing = 0
        if number > chunk:
            missing = chunk - len(observed)
        observed = np.pad(observed, ((0, missing), (0, 0), (0, 0), (0, 0)))  # (chunk, SEEN, N, 2)
        present = np.pad(present, ((0, missing), (0, 0)))
        present = np.broadcast_to(present[:, None], observed.shape[:3])

        if key is not None:
            options["key"] = jax.random.fold_in(key, first)
        predicted = predict(
            model, jnp.asarray(observed), windows.time_step, steps, present=jnp.asarray(present), **options
        )
        parts.append(np.asarray(predicted)[: chunk - missing])
    return np.concatenate(parts)


def score(
    predicted: Float[np.ndarray, "B S N 2"], recorded: Float[np.ndarray, "B S N 2"], present: Bool[np.ndarray, "B N"]
) -> Scores:
    """Errors and collisions of predictions (B, S, N, 2) m, at the predicted moments, of the tracks (B, N) present."""
    predicted = np.asarray(predicted, float)
    recorded = np.asarray(recorded, float)
    present = np.asarray(present)
    error = np.linalg.norm(predicted - recorded, axis=-1)  # (B, S, N)
    number = present.shape[1]
    touched = np.zeros(present.shape, bool)
    for one in range(number):  # pair by pair, for windows may be many
        for other in range(one + 1, number):
            both = present[:, one] & present[:, other]
            gap = predicted[:, :, one] - predicted[:, :, other]  # (B, S, 2)
            distance = np.linalg.norm(gap, axis=-1).min(1)
            hit = both & (distance < TOUCH)
            touched[:, one] |= hit
            touched[:, other] |= hit
    return Scores(
        float(error.mean(1)[present].mean()),
        float(error[:, -1][present].mean()),
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
    predicted = np.moveaxis(np.asarray(predicted, float), -2, -3)
    recorded = np.moveaxis(np.asarray(recorded, float), -2, -3)
    predicted = predicted[:, present]  # (K, tracks, S, 2)
    recorded = recorded[present]  # (tracks, S, 2)
    error = np.linalg.norm(predicted - recorded, axis=-1)  # (K, tracks, S)
    return SampleScores(
        float(error.mean(-1).min(0).mean()),
        float(error[..., -1].min(0).mean()),
        -float(_log_density(predicted, recorded).mean()),
        len(predicted),
    )


def _log_density(samples: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(...) logarithm of the density of K samples (K, ..., 2) at a place (..., 2), ``LEAST_LIKELY`` at least."""
    # The kernels have the shape of the samples, and Scott's width, which is squared here.
    number = len(samples)
    deviation = samples - samples.mean(0)
    covariance = np.einsum("k...i,k...j->...ij", deviation, deviation) / max(number - 1, 1)
    kernel = covariance * number ** (-1.0 / 3.0)  # (..., 2, 2)

    # Samples on a line have no density.
    determinant = np.linalg.det(kernel)
    usable = determinant > 1e-12
    kernel = np.where(usable[..., None, None], kernel, np.eye(2))
    determinant = np.where(usable, determinant, 1.0)

    gap = samples - place
    power = -0.5 * np.einsum("k...i,...ij,k...j->k...", gap, np.linalg.inv(kernel), gap)
    density = np.exp(power).mean(0) / (2.0 * np.pi * np.sqrt(determinant))
    logarithm = np.log(np.maximum(density, np.exp(LEAST_LIKELY)))
    return np.where(usable, logarithm, LEAST_LIKELY)


def _every_ten_frames(path: Path) -> np.ndarray:
    """(T, N, 2) m at frames 0, 10, 20, ..., NaN of absent people, who begin at the frame before their first line."""
    recorded = read_lines(path, "eth_ucy")
    order = np.lexsort((recorded.values["frame"], recorded.person))
    lines = np.stack([recorded.values[name][order] for name in ("frame", "x", "y")])  # (3, L)
    ends = np.flatnonzero(np.diff(recorded.person[order])) + 1
    moment = np.floor(lines[0] / FRAMES)
    first = moment.min()
    count = int(moment.max() - first) + 1
    places = np.full((count, len(ends) + 1, 2), np.nan)
    for column, (frame, x, y) in enumerate(np.split(lines, ends, axis=1)):
        if len(frame) < 2:
            continue
        begin = int(np.floor(frame[0] / FRAMES) - first)
        end = int(np.floor(frame[-1] / FRAMES) - first) + 1
        time = (first + np.arange(begin, end)) * FRAMES

        # Before the first line people walk as between the first two.
        before = np.minimum(time - frame[0], 0.0) / (frame[1] - frame[0])
        for axis, line in enumerate((x, y)):
            step = line[1] - line[0]
            places[begin:end, column, axis] = np.interp(time, frame, line) + before * step
    return places


def cut_windows(places: np.ndarray, length: int = SEEN + PREDICTED) -> Windows:
    """The windows of some moments of a recording (T, N, 2) m, NaN of absent people."""
    present_at = np.asarray(np.isfinite(places).all(-1))  # (T, N)
    windows = []
    for begin in range(len(places) - length + 1):
        window = slice(begin, begin + length)
        people = np.flatnonzero(present_at[window].all(0))
        if len(people) >= 2:
            windows.append(places[window, people])

    # Windows have different numbers of people: they are filled up to the most.
    most = max((window.shape[1] for window in windows), default=0)
    position = np.zeros((len(windows), length, most, 2))
    present = np.zeros((len(windows), most), bool)
    for row, window in enumerate(windows):
        number = window.shape[1]
        position[row, :, :number] = window
        present[row, :number] = True
    return Windows(position=position, present=present, time_step=TIME_STEP)

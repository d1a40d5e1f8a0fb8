"""When people cross a line, what flow that is, and trajectories as PedPy takes them."""

from typing import Any

import numpy as np
from jaxtyping import Float

from sean_jax.recordings import Tracks
from sean_jax.studies.scenes import Gate
from sean_jax.studies.validation.check import Skipped


def crossing_times(tracks: Tracks, gate: Gate) -> Float[np.ndarray, "N"]:
    """When each person first crosses a gate in its direction.

    Returns:
        (N,) s, interpolated between moments; of who vanishes there, the moment of vanishing; inf of who never does.
    """
    position, present = np.asarray(tracks.position, float), np.asarray(tracks.present)
    left, right = np.asarray(gate.left, float), np.asarray(gate.right, float)
    side = right - left
    wide = np.hypot(*side)
    ux, uy = side / wide
    gap = position - left
    behind = gap[..., 1] * ux - gap[..., 0] * uy  # (T, N) m
    along = gap[..., 0] * ux + gap[..., 1] * uy
    there = present | np.concatenate([np.zeros((1, present.shape[1]), bool), present[:-1]])
    step = (behind[:-1] <= 0.0) & (behind[1:] > 0.0) & there[1:] & present[:-1]
    step &= (along[1:] > -0.5) & (along[1:] < wide + 0.5)
    first = np.where(step.any(0), step.argmax(0), -1)
    own = np.arange(position.shape[1])
    before, after = behind[first, own], behind[np.minimum(first + 1, len(behind) - 1), own]
    share = np.where(first >= 0, -before / np.where(after > before, after - before, 1.0), 0.0)
    return np.where(first >= 0, (first + share) * tracks.time_step, np.inf)


def vanishing_times(tracks: Tracks) -> Float[np.ndarray, "N"]:
    """When each person vanishes for good.

    Returns:
        (N,) s; inf of who is still there at the end, or never was.
    """
    present = np.asarray(tracks.present)
    last = len(present) - 1 - present[::-1].argmax(0)
    return np.where(present.any(0) & ~present[-1], (last + 1) * tracks.time_step, np.inf)


def flow(times: Float[np.ndarray, "N"], shares: tuple[float, float] = (0.2, 0.8)) -> float:
    """The mean flow between two of the crossings.

    Args:
        times: (N,) s, when each person crosses; inf of who never does.
        shares: of all crossings, between which it is measured.

    Returns:
        people/s; NaN with fewer than 3 crossings.
    """
    crossed = np.sort(times[np.isfinite(times)])
    if len(crossed) < 3:
        return float("nan")
    first, last = (int(round(share * (len(crossed) - 1))) for share in shares)
    return (last - first) / max(float(crossed[last] - crossed[first]), 1e-9)


def pedpy() -> Any:
    """The package PedPy.

    Raises:
        Skipped: it is not installed.
    """
    try:
        import pedpy
    except ImportError:
        raise Skipped('PedPy is not installed; pip install "sean_jax[validation]".') from None
    return pedpy


def trajectory_data(tracks: Tracks, period: float | None = None) -> Any:
    """A recording as PedPy takes it.

    Args:
        tracks: T moments of N people, simulated or recorded.
        period: m along x, of a periodic scene: who comes around is another person from then on.

    Returns:
        ``pedpy.TrajectoryData`` with the columns id, frame, x and y [m].

    Raises:
        Skipped: PedPy is not installed.
    """
    import pandas

    position, present = np.asarray(tracks.position, float), np.asarray(tracks.present)
    person = np.asarray(tracks.person).astype(int)
    if period is not None:
        around = np.abs(np.diff(position[..., 0], axis=0)) > period / 2
        rounds = np.concatenate([np.zeros((1, person.shape[1]), int), np.cumsum(around, 0)])
        person = person + rounds * (int(person.max(initial=0)) + 1)
    time, column = np.nonzero(present)
    table = pandas.DataFrame(
        {
            "id": person[time, column],
            "frame": time,
            "x": position[time, column, 0],
            "y": position[time, column, 1],
        }
    )
    return pedpy().TrajectoryData(data=table, frame_rate=1.0 / tracks.time_step)

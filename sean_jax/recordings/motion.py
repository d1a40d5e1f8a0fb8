"""Velocities and headings from noisy positions: a straight line fitted to each stretch of a track.

SEAN 2.0 does the same for its classifiers, by ordinary least squares over a pedestrian's last poses. Here the stretch
lies around the moment, as a recording allows, so that nothing lags behind.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Shaped

from sean_jax.base import Array
from sean_jax.recordings.tracks import Tracks


def fit_motion(
    position: Float[Array, "T N 2"], present: Bool[Array, "T N"], time_step: float, window: int = 2
) -> tuple[Float[Array, "T N 2"], Float[Array, "T N 2"]]:
    """Least-squares line through each person's positions at the 2 window + 1 times around each.

    Times at which the person is absent are left out. With one time alone the position stays and the velocity is zero.

    Args:
        position: (T, N, 2) m.
        time_step: s between rows.

    Returns:
        Position (T, N, 2) m on the line, and velocity (T, N, 2) m/s; where absent, the argument's and zero.
    Source: SEAN 2.0's classifiers, which fit a line to a person's last poses.
    """
    count, first, second, value, product = (jnp.zeros((), position.dtype),) * 5
    for shift in range(-window, window + 1):
        there = _shifted(present, shift, False).astype(position.dtype)
        offset = (_shifted(position, shift, 0.0) - position) * there[..., None]
        count, first, second = count + there, first + there * shift, second + there * shift**2
        value, product = value + offset, product + offset * shift
    determinant = count * second - first * first
    usable = present & (determinant > 0.5)  # it is a whole number
    inverse = jnp.where(usable, 1.0 / jnp.where(usable, determinant, 1.0), 0.0)[..., None]
    slope = (count[..., None] * product - first[..., None] * value) * inverse
    middle = (second[..., None] * value - first[..., None] * product) * inverse
    return position + middle, slope / time_step


def headings(velocity: Float[Array, "T N 2"], present: Bool[Array, "T N"], still: float = 0.1) -> Float[Array, "T N 2"]:
    """The direction of motion, and for who stands the last direction before, else the next after.

    Args:
        velocity: (T, N, 2) m/s.
        still: m/s, below which a direction says nothing; who never moves faster looks along x.

    Returns:
        (T, N, 2) unit vectors.
    """
    speed = jnp.sqrt(jnp.maximum((velocity * velocity).sum(-1), 1e-12))
    moving = present & (speed > still)
    direction = jnp.where(moving[..., None], velocity / speed[..., None], 0.0)

    def carry_on(last, now):
        known, vector = now
        last = jnp.where(known[:, None], vector, last)
        return last, last

    nothing = jnp.zeros_like(direction[0])
    _, forward = jax.lax.scan(carry_on, nothing, (moving, direction))
    _, backward = jax.lax.scan(carry_on, nothing, (moving, direction), reverse=True)
    known = (forward * forward).sum(-1, keepdims=True) > 0.5
    either = jnp.where(known, forward, backward)
    some = (either * either).sum(-1, keepdims=True) > 0.5
    along_x = jnp.zeros_like(either).at[..., 0].set(1.0)
    return jnp.where(some, either, along_x)


def windowed_mean(values: Float[Array, "T N 2"], present: Bool[Array, "T N"], window: int = 1) -> Float[Array, "T N 2"]:
    """The mean of each person's values over the 2 window + 1 times around, absent ones left out."""
    total, count = jnp.zeros_like(values), jnp.zeros(present.shape, values.dtype)
    for shift in range(-window, window + 1):
        there = _shifted(present, shift, False).astype(values.dtype)
        total, count = total + _shifted(values, shift, 0.0) * there[..., None], count + there
    return total / jnp.maximum(count, 1.0)[..., None]


def motion_between_rows(tracks: Tracks, walking: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """The velocity by which people came to each row, and where they look: the last direction in which they walked.

    Runs on the host, in the precision of the positions. In a column, each person is separated from the next by a row
    without anybody, as in a sampled recording.

    Args:
        walking: m/s, at or below which the direction of motion says nothing.

    Returns:
        Velocity (T, N, 2) m/s, zero of who is absent and in a person's first row as in the second; and heading
        (T, N, 2) unit vectors, of who is absent as of who comes next.
    """
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    velocity, heading = np.zeros_like(position), np.zeros_like(position)
    edge = np.zeros((1, present.shape[1]), bool)
    change = np.diff(np.concatenate([edge, present, edge]).astype(np.int8), axis=0)
    for n in range(present.shape[1]):
        before = 0
        for begin, end in zip(np.flatnonzero(change[:, n] > 0), np.flatnonzero(change[:, n] < 0), strict=True):
            steps = np.diff(position[begin:end, n], axis=0) / tracks.time_step
            if len(steps):
                velocity[begin:end, n] = np.concatenate([steps[:1], steps])
            heading[before:end, n] = _last_directions(velocity[before:end, n], walking)
            before = end
        heading[before:, n] = heading[before - 1, n] if before else (1.0, 0.0)
    return velocity, heading


def _last_directions(velocity: np.ndarray, walking: float) -> np.ndarray:
    """(T, 2) direction of the last velocity that was fast enough, or the first one that is, or along x."""
    speed = np.linalg.norm(velocity, axis=-1)
    fast = np.flatnonzero(speed > walking)
    if not len(fast):
        return np.tile([1.0, 0.0], (len(velocity), 1))
    latest = np.searchsorted(fast, np.arange(len(velocity)), side="right") - 1
    index = fast[np.maximum(latest, 0)]
    return velocity[index] / speed[index, None]


def _shifted(rows: Shaped[Array, "T ..."], shift: int, fill: float | bool) -> Shaped[Array, "T ..."]:
    """The rows ``shift`` later, ``fill`` beyond the ends."""
    if shift == 0:
        return rows
    spare = jnp.full((min(abs(shift), rows.shape[0]), *rows.shape[1:]), fill, rows.dtype)
    return jnp.concatenate([rows[shift:], spare]) if shift > 0 else jnp.concatenate([spare, rows[:shift]])

"""Velocities and headings from noisy positions: a straight line fitted to each stretch of a track.

SEAN 2.0 does the same for its classifiers, by ordinary least squares over a pedestrian's last poses. Here the stretch
lies around the moment, as a recording allows, so that nothing lags behind.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array


def fit_motion(position: Array, present: Array, time_step: float, window: int = 2) -> tuple[Array, Array]:
    """Least-squares line through each person's positions at the 2 window + 1 times around each.

    Times at which the person is absent are left out. With one time alone the position stays and the velocity is zero.

    Args:
        position: (T, N, 2) m.
        present: (T, N) bool.
        time_step: s between rows.
        window: rows on each side.

    Returns:
        position (T, N, 2) m on the line, and velocity (T, N, 2) m/s; where absent, as given and zero.
    """
    count, first, second, value, product = (jnp.zeros((), position.dtype),) * 5
    for shift in range(-window, window + 1):
        weight = _shifted(present, shift, False).astype(position.dtype)
        offset = (_shifted(position, shift, 0.0) - position) * weight[..., None]
        count, first, second = count + weight, first + weight * shift, second + weight * shift**2
        value, product = value + offset, product + offset * shift
    determinant = count * second - first * first
    usable = present & (determinant > 0.5)  # it is a whole number
    inverse = jnp.where(usable, 1.0 / jnp.where(usable, determinant, 1.0), 0.0)[..., None]
    slope = (count[..., None] * product - first[..., None] * value) * inverse
    middle = (second[..., None] * value - first[..., None] * product) * inverse
    return position + middle, slope / time_step


def headings(velocity: Array, present: Array, still: float = 0.1) -> Array:
    """(T, N, 2) unit headings: the direction of motion, and for who stands the last one before, else the next after.

    Args:
        velocity: (T, N, 2) m/s.
        present: (T, N) bool.
        still: m/s, below which a direction says nothing; who never moves faster looks along x.
    """
    speed = jnp.sqrt(jnp.maximum((velocity * velocity).sum(-1), 1e-12))
    told = present & (speed > still)
    direction = jnp.where(told[..., None], velocity / speed[..., None], 0.0)

    def keep(last, now):
        known, vector = now
        last = jnp.where(known[:, None], vector, last)
        return last, last

    nothing = jnp.zeros_like(direction[0])
    _, forward = jax.lax.scan(keep, nothing, (told, direction))
    _, backward = jax.lax.scan(keep, nothing, (told, direction), reverse=True)
    known = (forward * forward).sum(-1, keepdims=True) > 0.5
    either = jnp.where(known, forward, backward)
    some = (either * either).sum(-1, keepdims=True) > 0.5
    along_x = jnp.zeros_like(either).at[..., 0].set(1.0)
    return jnp.where(some, either, along_x)


def windowed_mean(values: Array, present: Array, window: int = 1) -> Array:
    """(T, N, 2) mean of each person's values (T, N, 2) over the 2 window + 1 times around, absent ones left out."""
    total, count = jnp.zeros_like(values), jnp.zeros(present.shape, values.dtype)
    for shift in range(-window, window + 1):
        weight = _shifted(present, shift, False).astype(values.dtype)
        total, count = total + _shifted(values, shift, 0.0) * weight[..., None], count + weight
    return total / jnp.maximum(count, 1.0)[..., None]


def _shifted(rows: Array, shift: int, fill: float | bool) -> Array:
    """The rows ``shift`` later, ``fill`` beyond the ends."""
    if shift == 0:
        return rows
    spare = jnp.full((min(abs(shift), rows.shape[0]), *rows.shape[1:]), fill, rows.dtype)
    return jnp.concatenate([rows[shift:], spare]) if shift > 0 else jnp.concatenate([spare, rows[:shift]])

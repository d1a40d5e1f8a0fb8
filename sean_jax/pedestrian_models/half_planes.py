"""The best velocity in an intersection of half-planes: the linear programmes of reciprocal collision avoidance.

A half-plane is n . v >= c with a unit normal n = (nx, ny). The best velocity is the one nearest to a preferred one; it
is the preferred one, or lies on the border of some half-plane. So one candidate for each border, the nearest point of
what the others leave of it, decides; all are computed side by side.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array
from sean_jax.geometry import length

PARALLEL = 1e-6  # sine of the angle below which two borders count as parallel
TOLERANCE = 1e-5  # m/s
HALVINGS = 18  # of the violation that is searched for
NEVER = -1e6  # m/s: c of a half-plane that holds everything


def nearest(nx: Array, ny: Array, c: Array, px: Array, py: Array, limit: Array) -> tuple[Array, Array, Array]:
    """The velocity (), () [m/s] nearest to (px, py), no faster than ``limit``, in all half-planes (M,); and if any is.

    Without any, the velocity has no meaning.
    """
    speed = length(px, py)
    slower = jnp.where(speed > limit, limit / jnp.where(speed > limit, speed, 1.0), 1.0)
    free_x, free_y = px * slower, py * slower
    is_free = (nx * free_x + ny * free_y >= c - TOLERANCE).all()

    chord = limit * limit - c * c
    crosses = chord > 0.0
    half = jnp.sqrt(jnp.where(crosses, chord, 1.0))
    # Along the border of i, c n + t (-ny, nx), half-plane j says rate t >= rest.
    rate = ny[None, :] * nx[:, None] - nx[None, :] * ny[:, None]  # (i, j)
    rest = c[None, :] - c[:, None] * (nx[:, None] * nx[None, :] + ny[:, None] * ny[None, :])
    itself = jnp.eye(c.shape[0], dtype=bool)
    slope = jnp.abs(rate) > PARALLEL
    bound = rest / jnp.where(slope, rate, 1.0)
    lower = jnp.where(slope & (rate > 0.0) & ~itself, bound, -jnp.inf).max(1)
    upper = jnp.where(slope & (rate < 0.0) & ~itself, bound, jnp.inf).min(1)
    lower, upper = jnp.maximum(lower, -half), jnp.minimum(upper, half)
    possible = crosses & (lower <= upper + TOLERANCE) & (slope | itself | (rest <= TOLERANCE)).all(1)
    t = jnp.clip(px * -ny + py * nx, lower, jnp.maximum(lower, upper))
    x, y = c * nx - t * ny, c * ny + t * nx
    away = jnp.where(possible, (x - px) ** 2 + (y - py) ** 2, jnp.inf)
    best = jnp.argmin(away)
    return jnp.where(is_free, free_x, x[best]), jnp.where(is_free, free_y, y[best]), is_free | possible[best]


def best_velocity(
    nx: Array, ny: Array, c: Array, hard: Array, px: Array, py: Array, limit: Array
) -> tuple[Array, Array]:
    """As ``nearest``; where nothing is left, the velocity whose greatest violation of a half-plane is least.

    ``hard`` (M,) bool half-planes are not violated; they must hold the zero velocity.
    """
    x, y, found = nearest(nx, ny, c, px, py, limit)

    def halve(carry: tuple, _) -> tuple:
        low, high, x, y = carry
        middle = 0.5 * (low + high)
        new_x, new_y, works = nearest(nx, ny, jnp.where(hard, c, c - middle), px, py, limit)
        after = jnp.where(works, low, middle), jnp.where(works, middle, high)
        return (*after, jnp.where(works, new_x, x), jnp.where(works, new_y, y)), None

    zero = jnp.zeros_like(x)
    most = jnp.maximum(jnp.max(jnp.where(hard, NEVER, c)), 0.0)  # of the zero velocity
    violating = jax.lax.scan(halve, (zero, most, zero, zero), length=HALVINGS)[0]
    return jnp.where(found, x, violating[2]), jnp.where(found, y, violating[3])

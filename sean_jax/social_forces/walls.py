"""What obstacles do to people: the wall force, and the guarantee that no body enters an obstacle.

Helbing & Molnar (1995), eq. (5): U(d) = U0 exp(-d / R), the force being its negative gradient.
"""

from typing import Any

import jax.numpy as jnp

from sean_jax.base import Array, Nearby
from sean_jax.geometry import from_rectangle, sum_vectors
from sean_jax.nearby import around

SLACK = 1e-3  # m/s, or rounding would hold whoever walks along a wall: 0.05 mm in a step of 0.05 s


def distances(px: Array, py: Array, nearby: Nearby) -> tuple[Array, Array, Array]:
    """(N, K) distance [m] from the surfaces of the obstacles near each person (N,) to their centre, and normals."""
    rows = around(nearby, px, py)
    return from_rectangle(px[:, None], py[:, None], *(rows[..., part] for part in range(6)))


def wall_forces(distance: Array, nx: Array, ny: Array, parameters: Any) -> tuple[Array, Array]:
    """(N,) x and y parts [m/s2] of the push of all obstacles along their normals."""
    push = parameters.wall_strength * jnp.exp((parameters.wall_reach - distance) * (1.0 / parameters.wall_range))
    push = push * (1.0 + parameters.wall_lever * (distance - 1.0))
    push = jnp.where(distance < parameters.perception, push, 0.0)
    return sum_vectors(push * nx, push * ny, 1)


def keep_out(
    vx: Array, vy: Array, gap: Array, nx: Array, ny: Array, time_step: float, rub: Array | None = None
) -> tuple[Array, Array]:
    """Velocities (N,) [m/s] with which nobody ends the step inside an obstacle.

    A body at that gap (N, K) [m] may approach by no more than the gap in one step: n . v >= -gap / time_step.
    For a convex obstacle this linear bound is exact or stricter. All violated bounds are mended together, which is
    exact at the inner corner of two walls and leads out a body that is inside (a negative gap). Where that violates
    another bound, as in an acute corner, the velocity is shortened until it does not.

    ``rub`` [s/m] is kappa / k of Helbing, Farkas & Vicsek (2000), None without friction. The guarantee takes the place
    of their body force k g at walls: where it takes away n . v = u in a step, it has pushed with u / time_step, so
    their friction kappa g is rub u / time_step. An implicit step of it divides the speed along the wall by 1 + rub u,
    which turns nobody round, however long the step.
    """
    excess = jnp.maximum(-gap / time_step - (nx * vx[:, None] + ny * vy[:, None]), 0.0)
    x, y = sum_vectors(excess * nx, excess * ny, 1)
    vx, vy = vx + x, vy + y
    if rub is not None:
        along = ny * vx[:, None] - nx * vy[:, None]
        lost = along * (1.0 - 1.0 / (1.0 + rub * excess))
        x, y = sum_vectors(lost * ny, -lost * nx, 1)
        vx, vy = vx - x, vy - y
    approach = -(nx * vx[:, None] + ny * vy[:, None])
    allowed = jnp.maximum(gap / time_step + SLACK, 0.0)
    over = approach > allowed
    share = jnp.min(jnp.where(over, allowed / jnp.where(over, approach, 1.0), 1.0), axis=1)
    return vx * share, vy * share

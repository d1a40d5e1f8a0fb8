"""What obstacles do to people: the wall force, and the guarantee that no body enters an obstacle.

Helbing & Molnar (1995), eq. (5): U(d) = U0 exp(-d / R), the force being its negative gradient.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Nearby
from sean_jax.geometry import from_rectangle, sum_vectors
from sean_jax.nearby import around
from sean_jax.platforms import by_platform

SLACK = 1e-3  # m/s, or rounding would hold whoever walks along a wall: 0.05 mm in a step of 0.05 s
DEEPEST = 20.0  # of exponents: a push e^20 times the usual one is as good as any, and its square is still a number
LEAST = 1e-9  # m/s, a slower approach is none, for the gradient of a share of it would overflow


def distances(px: Array, py: Array, nearby: Nearby) -> tuple[Array, Array, Array]:
    """(N, K) distance [m] from the surfaces of the obstacles near each person (N,) to their centre, and normals."""
    rows = around(nearby, px, py)
    return from_rectangle(px[:, None], py[:, None], *(rows[..., part] for part in range(6)))


def wall_forces(px: Array, py: Array, nearby: Nearby, parameters: Any) -> tuple[Array, Array]:
    """(N,) x and y parts [m/s2] of the push of all obstacles along their normals, on people at (px, py) (N,) [m]."""

    def push(distance, nx, ny, parameters):
        into = (parameters.wall_reach - distance) * (1.0 / parameters.wall_range)  # a hundred and more in a wide wall
        size = parameters.wall_strength * jnp.exp(jnp.minimum(into, DEEPEST))
        size = size * (1.0 + parameters.wall_lever * (distance - 1.0))
        size = jnp.where(distance < parameters.perception, size, 0.0)
        return size * nx, size * ny

    return _summed(push, px, py, around(nearby, px, py), (), (parameters,))


def keep_out(
    px: Array,
    py: Array,
    vx: Array,
    vy: Array,
    nearby: Nearby,
    radius: Array,
    time_step: float,
    rub: Array | None = None,
) -> tuple[Array, Array]:
    """Velocities (N,) [m/s] with which no body of that radius [m] at (px, py) [m] ends the step [s] inside an obstacle.

    A body at a gap [m] from an obstacle may approach by no more than the gap in one step: n . v >= -gap / time_step.
    For a convex obstacle this linear bound is exact or stricter. All violated bounds are mended together, which is
    exact at the inner corner of two walls and leads out a body that is inside (a negative gap). Where that violates
    another bound, as in an acute corner, the velocity is shortened until it does not.

    ``rub`` [s/m] is kappa / k of Helbing, Farkas & Vicsek (2000), None without friction. The guarantee takes the place
    of their body force k g at walls: where it takes away n . v = u in a step, it has pushed with u / time_step, so
    their friction kappa g is rub u / time_step. An implicit step of it divides the speed along the wall by 1 + rub u,
    which turns nobody round, however long the step.
    """
    rows = around(nearby, px, py)

    def excess(distance, nx, ny, vx, vy, radius, time_step):
        return jnp.maximum((radius - distance) / time_step - (nx * vx + ny * vy), 0.0)

    def mended(distance, nx, ny, vx, vy, radius, time_step):
        over = excess(distance, nx, ny, vx, vy, radius, time_step)
        return over * nx, over * ny

    def rubbed(distance, nx, ny, before_x, before_y, vx, vy, radius, time_step, rub):
        over = excess(distance, nx, ny, before_x, before_y, radius, time_step)
        lost = (ny * vx - nx * vy) * (1.0 - 1.0 / (1.0 + rub * over))
        return -lost * ny, lost * nx

    def share(distance, nx, ny, vx, vy, radius, time_step):
        approach, allowed = -(nx * vx + ny * vy), jnp.maximum((distance - radius) / time_step + SLACK, LEAST)
        over = approach > allowed
        return jnp.where(over, allowed / jnp.where(over, approach, 1.0), 1.0)

    shared = radius, time_step
    x, y = _summed(mended, px, py, rows, (vx, vy), shared)
    before, vx, vy = (vx, vy), vx + x, vy + y
    if rub is not None:
        x, y = _summed(rubbed, px, py, rows, (*before, vx, vy), (*shared, rub))
        vx, vy = vx + x, vy + y
    least = _least(share, px, py, rows, (vx, vy), shared)
    return vx * least, vy * least


def _summed(law: Callable, px: Array, py: Array, rows: Array, each: tuple, shared: tuple) -> tuple[Array, Array]:
    """(N,) x and y: the sums over obstacles, of ``rows`` (N, K, 6), of ``law(distance, nx, ny, *each, *shared)``."""

    def add(total: tuple, one: tuple) -> tuple:
        return total[0] + one[0], total[1] + one[1]

    nothing = jnp.zeros_like(px), jnp.zeros_like(px)
    return _over_obstacles(
        law, lambda pushes: sum_vectors(pushes[0], pushes[1], 1), add, nothing, px, py, rows, each, shared
    )


def _least(law: Callable, px: Array, py: Array, rows: Array, each: tuple, shared: tuple) -> Array:
    """(N,) the least that the law gives, at most 1."""
    whole = jnp.ones_like(px)
    return _over_obstacles(law, lambda values: values.min(1), jnp.minimum, whole, px, py, rows, each, shared)


def _over_obstacles(law: Callable, reduce: Callable, join: Callable, start: Any, *given: Any) -> Any:
    """The law of all obstacles (N, K): on a CPU at once and then reduced, elsewhere joined to the start one by one.

    XLA for a GPU writes what is (N, K) to memory and reads it again for each sum over K; one by one it makes a single
    kernel of it all, which would be slow on a CPU.
    """

    def value(px: Array, py: Array, row: Any, each: tuple, shared: tuple) -> Any:  # of one obstacle
        distance, nx, ny = from_rectangle(px, py, *row)
        return law(distance, nx, ny, *each, *shared)

    def at_once(start: Any, px: Array, py: Array, rows: Array, each: tuple, shared: tuple) -> Any:
        obstacles = jax.vmap(value, (None, None, 0, None, None))
        return reduce(jax.vmap(obstacles, (0, 0, 0, 0, None))(px, py, rows, each, shared))

    def one_by_one(start: Any, px: Array, py: Array, rows: Array, each: tuple, shared: tuple) -> Any:
        def turn(total: Any, row: tuple) -> tuple:
            return join(total, value(px, py, row, each, shared)), None

        parts = tuple(rows[..., part].T for part in range(rows.shape[2]))
        return jax.lax.scan(turn, start, parts, unroll=rows.shape[1])[0]

    return by_platform(at_once, one_by_one)(start, *given)

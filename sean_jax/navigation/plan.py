"""The global plan: the next points of the shortest path, as a planner hands them to a driver (section V-B)."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array
from sean_jax.geometry import length, rotate, unit
from sean_jax.navigation.bends import of_one
from sean_jax.navigation.tables import Navigation
from sean_jax.navigation.ways import first_bend, last_bends

BENDS = 12  # that are followed: more than lie on some metres of a path
FINE = 0.05  # m, between the places on the path that are looked at
CURVED = 1.6  # times as far along the path as the points would reach on a straight one
ROUNDING = 1e-3  # m


def bend_to_goal(navigation: Navigation, goal: Array) -> Array:
    """(V,) int32 last bend on the shortest path from each bend to a goal (2,) [m]: made once for a task."""
    return last_bends(navigation, goal)[1]


def plan(
    navigation: Navigation,
    position: Array,
    goal: Array,
    to_goal: Array,
    last: Array,
    points: int = 10,
    apart: float = 0.5,
) -> Array:
    """(points, 2) [m] the nearest points of the shortest path ahead, each ``apart`` [m] or more from the one before it.

    From the position (2,) to the goal (2,) [m], whose ``to_goal`` (2, V) and ``bend_to_goal`` (V,) are given. The goal
    stands for the points that there is no room for.
    """
    along = FINE * jnp.arange(1, round(CURVED * points * apart / FINE) + 1, dtype=float)
    x, y = _places(navigation, position, goal, to_goal, last, along)
    index = jnp.arange(along.shape[0], dtype=jnp.int32)

    def pick(carry: tuple, _) -> tuple[tuple, Array]:
        before, px, py = carry
        far = (index > before) & (length(x - px, y - py) >= apart - ROUNDING)
        found, chosen = far.any(), jnp.argmax(far).astype(jnp.int32)
        px, py = jnp.where(found, x[chosen], goal[0]), jnp.where(found, y[chosen], goal[1])
        return (jnp.where(found, chosen, index[-1]), px, py), jnp.stack([px, py])

    return jax.lax.scan(pick, (jnp.full((), -1, jnp.int32), position[0], position[1]), length=points)[1]


def _places(navigation, position, goal, to_goal, last, along: Array) -> tuple[Array, Array]:
    """x and y (K,) [m] of the places that lie so far (K,) [m] along the path; the goal beyond its end."""
    bends, radius = navigation.bends, navigation.radius
    straight, around, first, spot, _ = first_bend(navigation, position, goal, to_goal)

    def follow(carry: tuple, _) -> tuple[tuple, tuple]:
        place, bend, free = carry
        enter, _, touch, _ = of_one(bends, bend, place, radius)
        touch = jnp.where(free, goal, touch)
        turn = jnp.where(free, 0.0, jnp.maximum(to_goal[1, bend] - enter, 0.0))
        out = jnp.where(free, goal, jnp.stack(_on_circle(navigation, bend, enter + turn)))
        gap = touch - place
        onward = navigation.onward[bend, last[bend]].astype(jnp.int32)
        is_last = last[bend] == bend
        part = place, gap, bend, enter, jnp.stack([length(gap[0], gap[1]), radius * turn])
        return (out, jnp.where(is_last, bend, onward), free | is_last), part

    begin = spot, first, straight | ~jnp.isfinite(around)
    _, (place, gap, bend, enter, far) = jax.lax.scan(follow, begin, length=BENDS + 1)
    ends = jnp.cumsum(far.reshape(-1))
    part = jnp.sum(along[:, None] > ends[None, :], axis=1, dtype=jnp.int32)
    over = part >= ends.shape[0]
    part = jnp.minimum(part, ends.shape[0] - 1)
    leg, rest = part // 2, along - (ends - far.reshape(-1))[part]
    ux, uy = unit(gap[leg, 0], gap[leg, 1])
    angle = enter[leg] + rest / radius
    arc_x, arc_y = jax.vmap(_on_circle, (None, 0, 0))(navigation, bend[leg], angle)
    on_arc = part % 2 == 1
    x = jnp.where(on_arc, arc_x, place[leg, 0] + rest * ux)
    y = jnp.where(on_arc, arc_y, place[leg, 1] + rest * uy)
    return jnp.where(over, goal[0], x), jnp.where(over, goal[1], y)


def _on_circle(navigation: Navigation, bend: Array, angle: Array) -> tuple[Array, Array]:
    """x and y [m] of the place at that angle [rad] of a bend."""
    bends = navigation.bends
    middle, corner, turned = bends.middle[bend], bends.corner[bend], bends.side[bend] * angle
    nx, ny = rotate(middle[0], middle[1], jnp.cos(turned), jnp.sin(turned))
    return corner[0] + navigation.radius * nx, corner[1] + navigation.radius * ny

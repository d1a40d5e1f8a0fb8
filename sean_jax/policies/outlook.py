"""How far it still is to the goal from many places near the robot: what planners that try many ways out ask (IV-E).

``navigation.geodesic`` looks at all bends of an environment from one place. Here a few bends are chosen once in a
control step, and then only those are looked at from each place, through the table of cells from which they are seen.
"""

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import from_rectangle, length
from sean_jax.navigation import sees
from sean_jax.navigation.bends import ANGLE, Bends, tangents
from sean_jax.navigation.ways import last_bends
from sean_jax.nearby import around

BENDS = 6  # that are chosen for being near
CHAIN = 3  # that are chosen for following one another
PAST = 0.35  # rad, by which a way may go round a bend too far and still counts: cells and places are not points
SPARE = 1e-3  # m
NARROW = 0.7  # of the radius: how near the straight way to the goal may pass obstacles, as in geodesic_roughly


@struct.dataclass
class Outlook:
    """The K bends by which the shortest ways lead from places near the robot."""

    bends: Bends  # K of them
    index: Array  # (K,) int32, in the tables
    to_goal: Array  # (2, K) m, the shortest way from each to the goal, inf if none; rad, where it leaves


def onward(scenario: Scenario, state: State) -> Array:
    """(V,) int32: the bend that follows each bend on the shortest way to the goal; itself if it is the last.

    Found once in an episode, for it asks for ways between all bends.
    """
    last = last_bends(scenario.navigation, state.task.goal)[1]
    own = jnp.arange(last.shape[0], dtype=jnp.int32)
    return scenario.navigation.onward[own, last].astype(jnp.int32)


def look(scenario: Scenario, state: State, follows: Array, x: Array, y: Array) -> Outlook:
    """The bends that are best, or nearly, from one of the places (S,), (S,) [m]; and those after the first's best.

    ``follows`` (V,) is what ``onward`` gave.
    """
    navigation, to_goal = scenario.navigation, state.task.to_goal
    every = jnp.arange(to_goal.shape[1], dtype=jnp.int32)
    total = jax.lax.stop_gradient(_ways(scenario, navigation.bends, every, to_goal, x, y))  # (S, V)
    best = jnp.min(total, axis=1, keepdims=True)
    worse = jnp.where(jnp.isfinite(total), total - jnp.where(jnp.isfinite(best), best, 0.0), jnp.inf)
    _, index = jax.lax.top_k(-jnp.min(worse, axis=0), min(BENDS, every.shape[0]))
    chain = [jnp.argmin(total[0]).astype(jnp.int32)]
    for _ in range(CHAIN):
        chain.append(follows[chain[-1]])
    index = jnp.concatenate([index.astype(jnp.int32), jnp.stack(chain[1:])])
    return Outlook(jax.tree.map(lambda part: part[index], navigation.bends), index, to_goal[:, index])


def remaining(scenario: Scenario, state: State, outlook: Outlook, x: Array, y: Array) -> Array:
    """(P,) m from the places (P,), (P,) [m] to the goal; inf where none of the chosen bends is in sight.

    As ``navigation.geodesic`` where the shortest way is by one of these bends, which is so for 95 of 100 places within
    1.5 m and in sight of where they were chosen; else longer.
    """
    navigation, goal = scenario.navigation, state.task.goal
    ways = _ways(scenario, outlook.bends, outlook.index, outlook.to_goal, x, y)
    boxes, near = navigation.obstacles, NARROW * navigation.radius
    straight = jax.vmap(lambda px, py: sees(boxes, jnp.stack([px, py]), goal, near))(x, y)
    return jnp.where(straight, length(goal[0] - x, goal[1] - y), jnp.min(ways, axis=1))


def _ways(scenario: Scenario, bends: Bends, index: Array, to_goal: Array, x: Array, y: Array) -> Array:
    """(P, K) m from places (P,), (P,) by each of the bends to the goal; inf by those that are not in sight."""
    navigation = scenario.navigation
    x, y = _led_out(scenario, x, y)
    most_x, most_y = navigation.visible.shape[0] - 1, navigation.visible.shape[1] - 1
    stop = jax.lax.stop_gradient
    i = jnp.clip(jnp.floor((stop(x) - navigation.origin[0]) / navigation.cell).astype(jnp.int32), 0, most_x)
    j = jnp.clip(jnp.floor((stop(y) - navigation.origin[1]) / navigation.cell).astype(jnp.int32), 0, most_y)
    seen = navigation.visible[i[:, None], j[:, None], index[None, :]]

    def one(px: Array, py: Array) -> tuple[Array, Array]:
        far, angle, _, _, on = tangents(bends, jnp.stack([px, py]), navigation.radius, True)
        past = jnp.maximum(angle - to_goal[1] - ANGLE, 0.0)
        return far - navigation.radius * (angle - past) + to_goal[0], on & (past < PAST)

    total, fits = jax.vmap(one)(x, y)
    return jnp.where(seen & fits, total, jnp.inf)


def _led_out(scenario: Scenario, x: Array, y: Array) -> tuple[Array, Array]:
    """The places (P,), (P,) [m], led out of the grown obstacles, where tables know no way; gradients are their own."""
    stop = jax.lax.stop_gradient
    rows = around(scenario.environment.nearby, stop(x), stop(y))
    parts = (rows[..., part] for part in range(6))
    distance, nx, ny = from_rectangle(stop(x)[:, None], stop(y)[:, None], *parts)
    nearest = jnp.argmin(distance, axis=1, keepdims=True)
    distance, nx, ny = (jnp.take_along_axis(part, nearest, 1)[:, 0] for part in (distance, nx, ny))
    out = jnp.maximum(scenario.navigation.radius + SPARE - distance, 0.0)
    return x + out * nx, y + out * ny

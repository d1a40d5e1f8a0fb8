"""Distance to the goal from many places near the robot, for planners that try many paths (section IV-E).

``navigation.geodesic`` looks at all corners of an environment from one place. Here a few corners are chosen once in a
control step. Each place then uses only these, by the table of cells that see them.
"""

import functools

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, PathsToGoal, Scenario, State
from sean_jax.core.geometry import length
from sean_jax.policies.obstacles import obstacle_distances
from sean_jax.world.navigation import segment_is_free
from sean_jax.world.navigation.arcs import ANGLE, CornerArcs, tangents
from sean_jax.world.navigation.shortest_paths import last_arcs
from sean_jax.world.navigation.tables import cell_of

NEAR_CORNERS = 6  # chosen because they are near
CHAIN_CORNERS = 3  # chosen as consecutive corners
MAX_OVERSHOOT = 0.35  # rad, by which a path may go round a corner too far: cells and places are not points
SPARE = 1e-3  # m
NARROW = 0.7  # of the radius: how near the straight way to the goal may pass obstacles, as in geodesic_approx


@struct.dataclass
class CostToGo:
    """The K corners by which the shortest paths lead from places near the robot."""

    corners: CornerArcs  # K of them
    index: Int[Array, "K"]  # in the tables
    paths_to_goal: PathsToGoal  # (K,) from each


def corner_successors(scenario: Scenario, state: State) -> Int[Array, "V"]:
    """(V,) int32, the corner that follows each corner on the shortest path to the goal; the last corner follows itself.

    Expensive, since it needs paths between all corners: call it once per episode.
    """
    last = last_arcs(scenario.navigation, state.task.goal)[1]
    first = jnp.arange(last.shape[0], dtype=jnp.int32)
    return scenario.navigation.next_arc[first, last].astype(jnp.int32)


def build_cost_to_go(
    scenario: Scenario, state: State, successors: Int[Array, "V"], x: Float[Array, "P"], y: Float[Array, "P"]
) -> CostToGo:
    """Choose the corners that are best, or nearly, from one of P places (x, y) [m].

    The corners that follow the first place's best one are added.
    """
    navigation = scenario.navigation
    paths_to_goal = state.task.paths_to_goal
    all_corners = jnp.arange(paths_to_goal.distance.shape[0], dtype=jnp.int32)
    lengths = _path_lengths(scenario, navigation.arcs, all_corners, paths_to_goal, x, y)
    lengths = jax.lax.stop_gradient(lengths)  # (P, V)

    # Corners whose path is little longer than the shortest one of some place.
    shortest = jnp.min(lengths, axis=1, keepdims=True)
    shortest = jnp.where(jnp.isfinite(shortest), shortest, 0.0)
    detour = jnp.where(jnp.isfinite(lengths), lengths - shortest, jnp.inf)
    least_detour = jnp.min(detour, axis=0)  # (V,)
    count = min(NEAR_CORNERS, len(all_corners))
    _, near = jax.lax.top_k(-least_detour, count)

    # The corners after the first one of the first place's path.
    chain = [jnp.argmin(lengths[0]).astype(jnp.int32)]
    for _ in range(CHAIN_CORNERS):
        chain.append(successors[chain[-1]])

    consecutive = jnp.stack(chain[1:])
    index = jnp.concatenate([near.astype(jnp.int32), consecutive])
    corners, chosen_paths = jax.tree.map(lambda leaf: leaf[index], (navigation.arcs, paths_to_goal))
    return CostToGo(corners, index, chosen_paths)


def distance_to_goal(
    scenario: Scenario, state: State, table: CostToGo, x: Float[Array, "P"], y: Float[Array, "P"]
) -> Float[Array, "P"]:
    """Length [m] of the shortest path from places (x, y) [m] to the goal by the chosen corners; inf if none is visible.

    It equals ``navigation.geodesic`` where the shortest path passes one of these corners, which holds for 95 of 100
    places within 1.5 m and in sight of where they were chosen. Elsewhere it is longer.
    """
    navigation = scenario.navigation
    goal = state.task.goal
    paths = _path_lengths(scenario, table.corners, table.index, table.paths_to_goal, x, y)
    clearance = NARROW * navigation.radius

    def goal_is_visible(px: Array, py: Array) -> Array:
        return segment_is_free(navigation.obstacles, jnp.stack([px, py]), goal, clearance)

    straight = jax.vmap(goal_is_visible)(x, y)
    return jnp.where(straight, length(goal[0] - x, goal[1] - y), jnp.min(paths, axis=1))


def _path_lengths(
    scenario: Scenario, corners: CornerArcs, index: Array, paths_to_goal: PathsToGoal, x: Array, y: Array
) -> Array:
    """(P, K) m from places by each of the corners to the goal; inf by corners that are not in sight."""
    navigation = scenario.navigation
    x, y = _push_out(scenario, x, y)
    places = jnp.stack([x, y], -1)  # (P, 2)
    cells = functools.partial(cell_of, navigation.visible, navigation.origin, navigation.cell)
    i, j = jax.vmap(cells)(jax.lax.stop_gradient(places))

    # The tables have a bit for each corner, eight in a word.
    words = navigation.visible[i[:, None], j[:, None], index[None, :] // 8]
    bit = (index % 8).astype(words.dtype)[None, :]
    visible = (words >> bit) & 1 != 0

    def from_place(px: Array, py: Array) -> tuple[Array, Array]:
        place = jnp.stack([px, py])
        to_arc, angle, _, _, exists = tangents(corners, place, navigation.radius, True)
        overshoot = jnp.maximum(angle - paths_to_goal.departure_angle - ANGLE, 0.0)
        along_arc = navigation.radius * (angle - overshoot)
        path_length = to_arc - along_arc + paths_to_goal.distance
        return path_length, exists & (overshoot < MAX_OVERSHOOT)

    lengths, fits = jax.vmap(from_place)(x, y)
    return jnp.where(visible & fits, lengths, jnp.inf)


def _push_out(
    scenario: Scenario, x: Float[Array, "P"], y: Float[Array, "P"]
) -> tuple[Float[Array, "P"], Float[Array, "P"]]:
    """The places (x, y) [m] moved out of the inflated obstacles, in which tables know no path.

    Gradients are the gradients of the places.
    """
    fixed_x, fixed_y = jax.lax.stop_gradient((x, y))
    distances, normals_x, normals_y = obstacle_distances(scenario.environment, fixed_x, fixed_y)
    nearest = jnp.argmin(distances, axis=1, keepdims=True)
    distance = jnp.take_along_axis(distances, nearest, 1)[:, 0]
    nx = jnp.take_along_axis(normals_x, nearest, 1)[:, 0]
    ny = jnp.take_along_axis(normals_y, nearest, 1)[:, 0]
    out = jnp.maximum(scenario.navigation.radius + SPARE - distance, 0.0)
    return x + out * nx, y + out * ny

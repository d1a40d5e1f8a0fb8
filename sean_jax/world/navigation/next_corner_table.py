"""Next corners for many people: the corner arc to walk to from each cell to each of a few points.

Looking up a table is cheaper than the robot's search over all arcs (``shortest_paths``).
"""

import functools
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, PathsToGoal
from sean_jax.core.devices import to_device
from sean_jax.core.geometry import from_box, length
from sean_jax.core.padding import FlatTable, flat_table, in_programs
from sean_jax.io import cache
from sean_jax.world.navigation.arcs import (
    ANGLE,
    Tangent,
    map_in_batches,
    push_out_of_obstacles,
    segment_is_free,
    segments_are_free,
    tangent_to_arc,
    tangents,
)
from sean_jax.world.navigation.shortest_paths import last_arcs
from sean_jax.world.navigation.tables import CELL, CODE, Navigation, arc_bits, cell_of, inputs, visible_words

CLOSE = 0.8  # of the radius: bodies of people have 0.2 m, their paths are for 0.25 m
MIN_AHEAD = 0.5  # m ahead: the nearest place that people aim at
CANDIDATES = 4  # arcs that ``next_point_approx`` tests
MAX_DETOUR = 0.3  # m
POINTS = 16  # the number of points is rounded up to a multiple, so that floors share programs
NEIGHBORS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))  # of a cell


@struct.dataclass
class NextCornerTable:
    """The next arc on the way to each of M points, as the index of an arc, or -1 for the point itself."""

    point: Float[Array, "M 2"]  # m
    first_arc: FlatTable  # (X, Y, M) int16, from a cell of 0.25 m; -1 also where there is no path
    next_arc: FlatTable  # (M, V) int16, after an arc
    departure_angle: FlatTable  # (M, V) rad, where the path leaves that arc


def build_next_corner_table(navigation: Navigation, points: Float[Array, "M 2"]) -> NextCornerTable:
    """Build the table for points [m] on the host, or read it from the user's cache."""
    key = [*inputs(navigation), points]
    fields = cache.load_or_build("next_corner", CODE, key, lambda: _make(navigation, points))
    tables = {name: flat_table(table) for name, table in fields.items()}
    return NextCornerTable(to_device(points), **tables)


def next_corner(
    navigation: Navigation, table: NextCornerTable, position: Float[Array, "2"], index: Int[Array, ""]
) -> Float[Array, "2"]:
    """A place [m] ahead on the way from a position [m] to a point of the table: the point, or on an arc's tangent."""
    i, j = cell_of(table.first_arc, navigation.origin, CELL, position)
    first_arc = table.first_arc[i, j, index]
    arc, tangent = _next_arc(navigation, table, position, index, first_arc)
    any_arc = jnp.maximum(arc, 0)
    aim = _past_corner(navigation, any_arc, position, tangent)
    return jnp.where(arc >= 0, aim, table.point[index])


def next_point_approx(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> Float[Array, "2"]:
    """``next_point`` [m] for many people: by the best arc in sight among those visible from the cells around.

    It is the goal if that is in sight or if there is no path.
    """
    arcs = navigation.arcs
    radius = navigation.radius
    visible = _visible_around(navigation, position)
    spot, _ = push_out_of_obstacles(navigation.obstacles, position, radius)

    # Length of the path by each arc, and the few shortest.
    distance, angle, _, _, on_arc = tangents(arcs, spot, radius, True)
    before_departure = angle <= paths_to_goal.departure_angle + ANGLE
    reachable = visible & on_arc & before_departure
    by_arc = distance - radius * angle + paths_to_goal.distance  # (V,) m
    total = jnp.where(reachable, by_arc, jnp.inf)
    shortest, index = jax.lax.top_k(-total, min(CANDIDATES, total.shape[0]))
    no_path = ~jnp.isfinite(jnp.max(shortest))  # not shortest[0]: XLA on a CPU would compute it again, ten times slower

    # The first of these in sight, or the shortest if none is; the goal is tested with them.
    candidates = jax.tree.map(lambda field: field[index], arcs)
    _, _, x, y, _ = tangents(candidates, spot, radius, True)
    x = jnp.append(x, goal[0])
    y = jnp.append(y, goal[1])
    clear = segments_are_free(navigation.obstacles, position, x, y, CLOSE * radius)
    first_clear = jnp.argmax(clear[:-1])
    chosen = index[first_clear]

    tangent = tangent_to_arc(arcs, chosen, spot, radius)
    aim = _past_corner(navigation, chosen, position, tangent)
    to_goal = clear[-1] | no_path
    return jnp.where(to_goal, goal, aim)


def _visible_around(navigation: Navigation, position: Float[Array, "2"]) -> Bool[Array, "V"]:
    """The arcs visible from any of the four cells whose middles are around a position [m]."""
    grid = navigation.visible, navigation.origin, navigation.cell
    left, below = cell_of(*grid, position - 0.5 * navigation.cell)
    right, above = cell_of(*grid, position + 0.5 * navigation.cell)
    words = []
    for i in (left, right):
        for j in (below, above):
            words.append(visible_words(navigation, i, j))
    from_any = functools.reduce(jnp.bitwise_or, words)
    return arc_bits(from_any, navigation.arcs.side.shape[0])


def _past_corner(navigation: Navigation, arc: Array, position: Array, tangent: Tangent) -> Array:
    """(2,) [m] a place past a corner, as far ahead as where the tangent touches, ``MIN_AHEAD`` at least.

    The tangent from a place at a distance d from the corner turns infinitely fast with that place where it touches the
    circle of radius r: it leads (d^2 - r^2)^(1/2) towards the corner and r past it. Here (d^2 - r^2) / d takes the
    place of the root. So the path bends a little wider and reaches the circle smoothly from either side, and its
    derivative is at most about 2 / r.
    """
    corner = navigation.arcs.corner[arc]
    radius = navigation.radius
    out = position - corner
    distance = length(out[0], out[1])
    distance = jnp.maximum(distance, 0.1 * radius)
    left = jnp.stack([-out[1], out[0]])
    across = navigation.arcs.side[arc] * left
    outward = radius / distance - distance / radius
    direction = outward * out + across  # times d / r
    direction_length = jnp.maximum(length(direction[0], direction[1]), 1e-6)

    gap = tangent.point - position
    ahead = jnp.maximum(length(gap[0], gap[1]), MIN_AHEAD)
    return position + ahead / direction_length * direction


def _next_arc(
    navigation: Navigation, table: "NextCornerTable | PathsToPoints", position: Array, index: Array, arc: Array
) -> tuple[Array, Tangent]:
    """The arc () int32, or the one that follows it once the position (2,) is past it; and the tangent to it."""
    arcs = navigation.arcs
    radius = navigation.radius
    current = jnp.maximum(arc.astype(jnp.int32), 0)
    angle = tangent_to_arc(arcs, current, position, radius).angle
    departure_angle = table.departure_angle[index, current]
    next_arc = table.next_arc[index, current]
    past = (arc >= 0) & (angle > departure_angle)
    arc = jnp.where(past, next_arc, arc).astype(jnp.int32)
    tangent = tangent_to_arc(arcs, jnp.maximum(arc, 0), position, radius)
    return arc, tangent


# --- the table, built on the host ---


class PathsToPoints(NamedTuple):
    """The shortest paths from each of V arcs to each of M points; ends are the points, pushed out of obstacles."""

    distance: Float[Array, "M V"]  # m
    departure_angle: Float[Array, "M V"]  # rad
    next_arc: Int[Array, "M V"]  # int16, -1 at the last arc
    end: Float[Array, "M 2"]  # m
    end_radius: Float[Array, "M"]  # m, with which segments to there have to be free


class CellCorners(NamedTuple):
    """The corners of the table's cells, pushed out of obstacles: (X + 1) (Y + 1) = K of them, column by column."""

    place: Float[np.ndarray, "K 2"]  # m
    free_radius: Float[np.ndarray, "K"]  # m, with which segments from there have to be free
    weight: Float[np.ndarray, "K"]  # small where people cannot be, and zero inside obstacles


class Votes(NamedTuple):
    """The corners of C cells on a path by some arc."""

    weight_for: Float[np.ndarray, "C"]  # of those from which the path begins free
    weight_against: Float[np.ndarray, "C"]  # of the others
    length: Float[np.ndarray, "C"]  # m, mean length of the path


def _make(navigation: Navigation, points: Array) -> dict[str, np.ndarray]:
    """The fields of ``NextCornerTable`` but the points.

    A cell takes the best arc of the middle of its cell of the visibility grid, if the path to it begins free at all
    corners of the cell. Otherwise it takes, of this arc and those of the cells around, the one to which the path begins
    free from most corners; but none with a much longer path, or people would walk to and fro between two cells.
    """
    n_points = len(points)
    n_arcs = navigation.arcs.side.shape[0]  # without padding
    scale = round(float(navigation.cell) / CELL)
    visible = navigation.visible.on_host()  # (X, Y, V8)

    # Programs are shared by floors, so they take padded arrays; and visibility by rows, not the whole table.
    navigation = in_programs(replace(navigation, visible=None, places=None, mesh_places=None))
    n_padding = -n_points % POINTS
    padded_points = np.pad(np.asarray(points), [(0, n_padding), (0, 0)], mode="edge")
    padded_points = jnp.asarray(padded_points, float)
    paths = _paths_to_points(navigation, padded_points)

    best_arc = _best_from_middles(navigation, paths, visible)
    best_arc = best_arc[..., :n_points].repeat(scale, 0).repeat(scale, 1)  # (X, Y, M)
    return {
        "first_arc": _elect(navigation, paths, best_arc, scale),
        "next_arc": np.asarray(paths.next_arc)[:n_points, :n_arcs],
        "departure_angle": np.asarray(paths.departure_angle)[:n_points, :n_arcs],
    }


def _best_from_middles(navigation: Navigation, paths: PathsToPoints, visible: np.ndarray) -> Int[np.ndarray, "X Y M"]:
    """The best arc from the middle of each cell of the visibility grid (X, Y, V8)."""
    cells = visible.shape[:2]
    words = visible.reshape(-1, visible.shape[2])
    n_padding = navigation.arcs.side.shape[0] // 8 - words.shape[1]
    words = np.pad(words, [(0, 0), (0, n_padding)])

    index = np.indices(cells).reshape(2, -1).T
    middles = (index + 0.5) * float(navigation.cell)
    middles = np.asarray(navigation.origin) + middles  # (X * Y, 2) m
    best_arc = map_in_batches(_first_arcs, (navigation, paths), middles, words)
    return best_arc.reshape(*cells, -1)


def _elect(
    navigation: Navigation, paths: PathsToPoints, best_arc: Int[np.ndarray, "X Y M"], scale: int
) -> Int[np.ndarray, "X Y M"]:
    """The arc of each cell and point: ``best_arc``, or that of a cell ``scale`` cells away with more votes."""
    corners = _cell_corners(navigation, best_arc.shape)
    count = functools.partial(_count_votes, (navigation, paths), corners, best_arc.shape)

    # Only cells with a vote against their arc look at others.
    cells = np.indices(best_arc.shape).reshape(3, -1).T
    votes = count(cells, best_arc.reshape(-1))
    unsure = votes.weight_against > 0
    cells = cells[unsure]
    weight_for = votes.weight_for[unsure]
    limit = votes.length[unsure] + MAX_DETOUR

    elected = best_arc.copy()
    last_cell = np.array(best_arc.shape[:2]) - 1
    for step in NEIGHBORS:
        neighbor = cells[:, :2] + scale * np.array(step)
        neighbor = np.clip(neighbor, 0, last_cell)
        i, j = neighbor.T
        arc = best_arc[i, j, cells[:, 2]]
        votes = count(cells, arc)

        # It needs more votes, and no much longer path.
        has_more_votes = votes.weight_for > weight_for + 1e-3
        better = has_more_votes & (votes.length < limit)
        better_cells = tuple(cells[better].T)
        elected[better_cells] = arc[better]
        weight_for = np.where(better, votes.weight_for, weight_for)
    return elected


def _cell_corners(navigation: Navigation, shape: tuple[int, ...]) -> CellCorners:
    indices = np.indices((shape[0] + 1, shape[1] + 1), np.float32).reshape(2, -1).T
    corners = indices * CELL + np.asarray(navigation.origin)  # (K, 2) m
    shared = navigation.obstacles, navigation.radius
    return CellCorners(*map_in_batches(_corner_of_cell, shared, corners))


def _count_votes(
    shared: tuple[Navigation, PathsToPoints],
    corners: CellCorners,
    shape: tuple[int, int, int],
    cells: Int[np.ndarray, "C 3"],
    arc: Int[np.ndarray, "C"],
) -> Votes:
    """The votes of the corners of cells (i, j, point) of a table on an arc each."""
    column = shape[1] + 1
    first_corner = cells[:, :1] * column + cells[:, 1:2]
    corner = first_corner + np.array([0, 1, column, column + 1])  # (C, 4)
    weight = corners.weight[corner]
    counted = weight > 0.0

    # Cells beside each other share corners, so many paths (corner, point, arc) occur several times.
    navigation, _ = shared
    n_arcs = navigation.arcs.side.shape[0]
    sizes = len(corners.weight), shape[2], n_arcs + 1
    path = np.ravel_multi_index((corner, cells[:, 2:], arc[:, None] + 1), sizes)  # (C, 4)
    path, index = np.unique(path[counted], return_inverse=True)
    start, point, path_arc = np.unravel_index(path, sizes)
    path_arc = (path_arc - 1).astype(arc.dtype)  # -1: straight to the point
    place = corners.place[start]
    free_radius = corners.free_radius[start]
    clear, distance = map_in_batches(_path_from, shared, place, free_radius, point.astype(np.int32), path_arc)

    # Sums over the corners of each cell.
    weight = weight[counted]
    cell, _ = np.nonzero(counted)
    sum_by_cell = functools.partial(np.bincount, cell, minlength=len(cells))
    weight_for = sum_by_cell(weight * clear[index])
    weight_against = sum_by_cell(weight * ~clear[index])
    total_weight = np.maximum(weight_for + weight_against, 1e-3)
    mean_distance = sum_by_cell(weight * distance[index]) / total_weight
    return Votes(weight_for, weight_against, mean_distance)


def _path_from(
    shared: tuple[Navigation, PathsToPoints], place: Array, free_radius: Array, index: Array, arc: Array
) -> tuple[Array, Array]:
    """Whether the path from a place (2,) by that arc begins free, () bool; and its length [m] (), free or not."""
    navigation, paths = shared
    arc, tangent = _next_arc(navigation, paths, place, index, arc)
    is_arc = arc >= 0
    target = jnp.where(is_arc, tangent.point, paths.end[index])
    radius_to_end = jnp.minimum(free_radius, paths.end_radius[index])
    free_radius = jnp.where(is_arc, free_radius, radius_to_end)

    # The segment to the target, and the path from there.
    after_target = paths.distance[index, jnp.maximum(arc, 0)] - navigation.radius * tangent.angle
    after_target = jnp.where(is_arc, after_target, 0.0)
    to_target = length(target[0] - place[0], target[1] - place[1])
    distance = to_target + after_target
    is_free = segment_is_free(navigation.obstacles, place, target, free_radius)
    on_arc = tangent.on_arc | ~is_arc
    return on_arc & is_free, distance


@jax.jit
def _paths_to_points(navigation: Navigation, points: Float[Array, "M 2"]) -> PathsToPoints:
    distance, last, departure_angle = jax.vmap(last_arcs, in_axes=(None, 0))(navigation, points)
    first = jnp.arange(navigation.arcs.side.shape[0], dtype=jnp.int32)[None, :]
    next_arc = navigation.next_arc[first, last].astype(jnp.int32)
    is_last = last == first
    next_arc = jnp.where(is_last, -1, next_arc).astype(jnp.int16)
    push_out = jax.vmap(push_out_of_obstacles, in_axes=(None, 0, None))
    end, end_radius = push_out(navigation.obstacles, points, navigation.radius)
    return PathsToPoints(distance, departure_angle, next_arc, end, end_radius)


def _first_arcs(shared: tuple[Navigation, PathsToPoints], spot: Array, words: Array) -> Array:
    """(M,) int16 the best of the visible arcs on the way from a spot (2,) [m] to each point."""
    navigation, paths = shared
    arcs = navigation.arcs
    radius = navigation.radius
    place, free_radius = push_out_of_obstacles(navigation.obstacles, spot, radius)
    are_free = jax.vmap(segment_is_free, in_axes=(None, None, 0, 0))
    radius_to_end = jnp.minimum(free_radius, paths.end_radius)
    clear = are_free(navigation.obstacles, place, paths.end, radius_to_end)

    # Length of the path to each point by each arc.
    distance, angle, *_ = tangents(arcs, place, radius, True)
    visible = arc_bits(words, arcs.side.shape[0])
    before_departure = angle[None, :] <= paths.departure_angle + ANGLE
    reachable = visible[None, :] & before_departure  # (M, V)
    to_middle = distance - radius * angle  # (V,) m
    total = jnp.where(reachable, to_middle[None, :] + paths.distance, jnp.inf)

    no_path = ~jnp.isfinite(jnp.min(total, axis=1))
    best = jnp.argmin(total, axis=1).astype(jnp.int32)
    straight = clear | no_path
    return jnp.where(straight, -1, best).astype(jnp.int16)


def _corner_of_cell(shared: tuple, spot: Array) -> tuple[Array, Array, Array]:
    """The fields of ``CellCorners`` for one corner (2,) [m]."""
    boxes, radius = shared
    distance, _, _ = jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)
    clearance = jnp.min(distance, initial=jnp.inf)
    weight = jnp.where(clearance > 0.0, 0.01, 0.0)
    weight = jnp.where(clearance >= CLOSE * radius, 1.0, weight)
    place, free_radius = push_out_of_obstacles(boxes, spot, radius)
    return place, free_radius, weight

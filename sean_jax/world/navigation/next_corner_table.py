"""Next corners for many people: the corner arc to walk to from each cell to each of a few points.

Looking up a table is cheaper than the robot's search over all arcs (``shortest_paths``).
"""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

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
    fields = cache.load_or_build("next_corner", CODE, [*inputs(navigation), points], lambda: _make(navigation, points))
    return NextCornerTable(to_device(points), **{name: flat_table(table) for name, table in fields.items()})


def next_corner(
    navigation: Navigation, table: NextCornerTable, position: Float[Array, "2"], index: Int[Array, ""]
) -> Float[Array, "2"]:
    """A place [m] ahead on the way from a position [m] to a point of the table: the point, or on an arc's tangent."""
    cell = cell_of(table.first_arc, navigation.origin, CELL, position)
    arc, tangent = _next_arc(navigation, table, position, index, table.first_arc[*cell, index])
    aim = _past(navigation, jnp.maximum(arc, 0), position, tangent)
    return jnp.where(arc >= 0, aim, table.point[index])


def next_point_approx(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> Float[Array, "2"]:
    """``next_point`` [m] for many people: by the best arc in sight among those visible from the cells around.

    It is the goal if that is in sight or if there is no path.
    """
    boxes, radius = navigation.obstacles, navigation.radius
    grid = navigation.visible, navigation.origin, navigation.cell
    i, j = cell_of(*grid, position - 0.5 * navigation.cell)
    k, m = cell_of(*grid, position + 0.5 * navigation.cell)
    words = functools.reduce(jnp.bitwise_or, (visible_words(navigation, x, y) for x in (i, k) for y in (j, m)))
    visible_here = arc_bits(words, navigation.arcs.side.shape[0])
    spot, _ = push_out_of_obstacles(boxes, position, radius)
    far, angle, _, _, on_arc = tangents(navigation.arcs, spot, radius, True)
    reachable = visible_here & on_arc & (angle <= paths_to_goal.departure_angle + ANGLE)
    total = jnp.where(reachable, far - radius * angle + paths_to_goal.distance, jnp.inf)
    shortest, index = jax.lax.top_k(-total, min(CANDIDATES, total.shape[0]))
    no_path = ~jnp.isfinite(jnp.max(shortest))  # not shortest[0]: XLA on a CPU would compute it again, ten times slower
    candidates = jax.tree.map(lambda part: part[index], navigation.arcs)
    _, _, x, y, _ = tangents(candidates, spot, radius, True)
    x, y = jnp.append(x, goal[0]), jnp.append(y, goal[1])
    clear = segments_are_free(boxes, position, x, y, CLOSE * radius)
    chosen = index[jnp.argmax(clear[:-1])]  # the best one if none is in sight
    tangent = tangent_to_arc(navigation.arcs, chosen, spot, radius)
    return jnp.where(clear[-1] | no_path, goal, _past(navigation, chosen, position, tangent))


def _past(navigation: Navigation, arc: Array, position: Array, tangent: Tangent) -> Array:
    """(2,) [m] a place past a corner, as far ahead as where the tangent touches, ``MIN_AHEAD`` at least.

    The tangent from a place at a distance d from the corner turns infinitely fast with that place where it touches the
    circle of radius r: it leads (d^2 - r^2)^(1/2) towards the corner and r past it. Here (d^2 - r^2) / d takes the
    place of the root. So the path bends a little wider and reaches the circle smoothly from either side, and its
    derivative is at most about 2 / r.
    """
    corner, radius = navigation.arcs.corner[arc], navigation.radius
    out = position - corner
    away = jnp.maximum(length(out[0], out[1]), 0.1 * radius)
    past = navigation.arcs.side[arc] * jnp.stack([-out[1], out[0]])
    direction = (radius / away - away / radius) * out + past  # times d / r
    gap = tangent.point - position
    far = jnp.maximum(length(gap[0], gap[1]), MIN_AHEAD)
    return position + far / jnp.maximum(length(direction[0], direction[1]), 1e-6) * direction


def _next_arc(
    navigation: Navigation, table: NextCornerTable, position: Array, index: Array, arc: Array
) -> tuple[Array, Tangent]:
    """() int32 the arc, or the one after it if the position (2,) is past it; and the tangent to it."""
    radius, before = navigation.radius, jnp.maximum(arc.astype(jnp.int32), 0)
    angle = tangent_to_arc(navigation.arcs, before, position, radius).angle
    past = (arc >= 0) & (angle > table.departure_angle[index, before])
    arc = jnp.where(past, table.next_arc[index, before], arc).astype(jnp.int32)
    return arc, tangent_to_arc(navigation.arcs, jnp.maximum(arc, 0), position, radius)


def _make(navigation: Navigation, points: Array) -> dict[str, np.ndarray]:
    """The fields of ``NextCornerTable`` but the points.

    A cell takes the best arc of the middle of its cell of the visibility grid, if the path to it begins free at all
    corners of the cell. Otherwise it takes, of this arc and those of the cells around, the one to which the path begins
    free from most corners; but none with a much longer path, or people would walk to and fro between two cells.
    """
    scale = round(float(navigation.cell) / CELL)
    visible, number, size = navigation.visible.on_host(), len(points), navigation.arcs.side.shape[0]
    cells, words = visible.shape[:2], visible.reshape(-1, visible.shape[2])
    navigation = in_programs(replace(navigation, visible=None, places=None, mesh_places=None))  # rows have visibility
    words = np.pad(words, [(0, 0), (0, navigation.arcs.side.shape[0] // 8 - words.shape[1])])
    points = jnp.asarray(np.pad(np.asarray(points), [(0, -number % POINTS), (0, 0)], mode="edge"), float)
    distance, departure_angle, next_arc, ends = _paths_to_points(navigation, points)
    middle = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), -1).reshape(-1, 2) + 0.5
    shared = navigation, distance, departure_angle, ends
    spots = np.asarray(navigation.origin) + middle * float(navigation.cell)
    best = map_in_batches(_first_arcs, shared, spots, words)[:, :number].reshape(*cells, number)
    best = np.repeat(np.repeat(best, scale, 0), scale, 1)  # (X, Y, M)
    tables = {"next_arc": flat_table(next_arc), "departure_angle": flat_table(departure_angle)}
    table = NextCornerTable(point=points, first_arc=None, **tables)  # pyright: ignore[reportArgumentType]
    corners = [np.arange(count + 1, dtype=np.float32) * CELL for count in best.shape[:2]]
    spots = np.stack(np.meshgrid(*corners, indexing="ij"), -1).reshape(-1, 2) + np.asarray(navigation.origin)
    place, free_radius, weight = map_in_batches(_corner_of_cell, (navigation.obstacles, navigation.radius), spots)
    row, arcs = best.shape[1] + 1, navigation.arcs.side.shape[0] + 1
    shared = navigation, table, distance, ends

    def rate(cells: np.ndarray, arc: np.ndarray) -> tuple[np.ndarray, ...]:
        """The weight of the corners of cells (K, 3) for and against an arc (K,), and the mean length of path [m]."""
        yes, no, far = np.zeros(len(cells)), np.zeros(len(cells)), np.zeros(len(cells))
        spot = cells[:, :1] * row + cells[:, 1:2] + np.array([0, 1, row, row + 1])
        key = (spot * number + cells[:, 2:]) * arcs + arc[:, None] + 1  # cells beside each other share their corners
        each, inverse = np.unique(key[weight[spot] > 0.0], return_inverse=True)
        rest, of = each // arcs, each % arcs - 1
        at, index = rest // number, (rest % number).astype(np.int32)
        clear, length = map_in_batches(_path_from, shared, place[at], free_radius[at], index, of.astype(best.dtype))
        counted = np.nonzero(weight[spot] > 0.0)
        where, share = counted[0], weight[spot][counted]
        clear, length = clear[inverse], length[inverse]
        np.add.at(yes, where, share * clear)
        np.add.at(no, where, share * ~clear)
        np.add.at(far, where, share * length)
        return yes, no, far / np.maximum(yes + no, 1e-3)

    every = np.stack(np.meshgrid(*map(np.arange, best.shape), indexing="ij"), -1).reshape(-1, 3)
    yes, no, far = rate(every, best.reshape(-1))
    unsure = no > 0
    cells, yes, far = every[unsure], yes[unsure], far[unsure]
    result = best.copy()
    for step in NEIGHBORS:
        i, j = np.clip(cells[:, :2] + scale * np.array(step), 0, np.array(best.shape[:2]) - 1).T
        other = best[i, j, cells[:, 2]]
        more, _, farther = rate(cells, other)
        better = (more > yes + 1e-3) & (farther < far + MAX_DETOUR)
        result[tuple(cells[better].T)] = other[better]
        yes = np.where(better, more, yes)
    return {
        "first_arc": result,
        "next_arc": np.asarray(next_arc)[:number, :size],
        "departure_angle": np.asarray(departure_angle)[:number, :size],
    }


def _path_from(shared: tuple, place: Array, free_radius: Array, index: Array, arc: Array) -> tuple[Array, Array]:
    """() bool whether the path from a place (2,) by that arc begins free; and () its length [m], free or not."""
    navigation, table, distance, (ends, end_radius) = shared
    arc, (angle, on_arc, touch, _) = _next_arc(navigation, table, place, index, arc)
    is_arc = arc >= 0
    touch = jnp.where(is_arc, touch, ends[index])
    free_radius = jnp.where(is_arc, free_radius, jnp.minimum(free_radius, end_radius[index]))
    rest = distance[index, jnp.maximum(arc, 0)] - navigation.radius * angle
    far = length(touch[0] - place[0], touch[1] - place[1]) + jnp.where(is_arc, rest, 0.0)
    return (on_arc | ~is_arc) & segment_is_free(navigation.obstacles, place, touch, free_radius), far


@jax.jit
def _paths_to_points(navigation: Navigation, points: Array) -> tuple:
    """(M, V) lengths [m] from the arcs to the points, ``departure_angle`` and ``next_arc``; and the points, pushed out
    of obstacles.
    """
    distance, last, departure_angle = jax.vmap(last_arcs, in_axes=(None, 0))(navigation, points)
    first = jnp.arange(navigation.arcs.side.shape[0], dtype=jnp.int32)[None, :]
    next_arc = jnp.where(last == first, -1, navigation.next_arc[first, last].astype(jnp.int32)).astype(jnp.int16)
    ends = jax.vmap(push_out_of_obstacles, in_axes=(None, 0, None))(navigation.obstacles, points, navigation.radius)
    return distance, departure_angle, next_arc, ends


def _first_arcs(shared: tuple, spot: Array, words: Array) -> Array:
    """(M,) int16 the best of the visible arcs on the way from a spot (2,) [m] to each point."""
    navigation, distance, departure_angle, (ends, end_radius) = shared
    obstacles, radius = navigation.obstacles, navigation.radius
    place, free_radius = push_out_of_obstacles(obstacles, spot, radius)
    clear = jax.vmap(segment_is_free, in_axes=(None, None, 0, 0))(
        obstacles, place, ends, jnp.minimum(free_radius, end_radius)
    )
    far, angle, *_ = tangents(navigation.arcs, place, radius, True)
    visible = arc_bits(words, navigation.arcs.side.shape[0])
    reachable = visible[None, :] & (angle[None, :] <= departure_angle + ANGLE)
    total = jnp.where(reachable, (far - radius * angle)[None, :] + distance, jnp.inf)
    no_path = ~jnp.isfinite(jnp.min(total, axis=1))
    return jnp.where(clear | no_path, -1, jnp.argmin(total, axis=1).astype(jnp.int32)).astype(jnp.int16)


def _corner_of_cell(shared: tuple, spot: Array) -> tuple[Array, Array, Array]:
    """The spot (2,) pushed out of obstacles, the free radius there, and its weight.

    The weight is small where people cannot be, and zero inside obstacles.
    """
    boxes, radius = shared
    clearance = jnp.min(jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)[0], initial=jnp.inf)
    weight = jnp.where(clearance >= CLOSE * radius, 1.0, jnp.where(clearance > 0.0, 0.01, 0.0))
    return *push_out_of_obstacles(boxes, spot, radius), weight

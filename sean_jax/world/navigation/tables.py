"""The tables of shortest paths for a disc of one radius, built once on the host."""

import math
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from sean_jax.core.data_types import FAR, Array, Environment, Obstacles
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.core.padding import FlatTable, flat_table, in_programs
from sean_jax.io import cache
from sean_jax.world import environment as environments
from sean_jax.world.navigation.arcs import (
    ANGLE,
    SLACK,
    CornerArcs,
    map_in_batches,
    pairs_are_free,
    push_out_of_obstacles,
    segments_are_free,
    tangents,
)

CODE = "world/navigation", "world/environment", "core/geometry", "core/padding"  # on which the tables depend
FIELDS = "corner", "middle", "side", "first", "last"
TABLES = "distance", "arrival_angle", "departure_angle", "rotation", "next_arc", "visible"
CELL = 0.25  # m
MAX_CELLS = 100_000  # of a visibility grid; larger floors have wider cells
MAX_ARCS = 2_500  # the tables have all pairs of them
FREE_POINTS = 1024  # free places from which starts and goals are drawn
ROOM = 0.1  # m, their distance from obstacles beyond the radius
STRAIGHT = 1e-3  # rad, by which an arc may run backwards because of rounding
SAMPLES = 91  # sampled places on a quarter of a circle, one each degree


@struct.dataclass
class Navigation:
    """Tables of shortest paths for a disc of one radius.

    A path from arc to arc goes from the middle of the first to the middle of the second. Angles on an arc are counted
    from its middle, in the direction of travel. The tables know nothing of arcs that are padding.
    """

    arcs: CornerArcs  # V of them
    distance: FlatTable  # (V, V) m, length of the path to the first arc from the second; inf if there is none
    arrival_angle: FlatTable  # (V, V) rad, where that path enters the first
    departure_angle: FlatTable  # (V, V) rad, where the path from the first arc to the second leaves the first
    rotation: FlatTable  # (V, V) rad, its total rotation, left plus right
    next_arc: FlatTable  # (V, V) int16, the arc that follows the first
    visible: FlatTable  # (X, Y, V8) uint8, a bit for each arc: whether the tangent from the middle of a cell is free
    origin: Float[Array, "2"]  # m, lower left corner of the grid of cells
    cell: Float[Array, ""]  # m, side of a cell
    # m, uniform over all places that the disc can reach
    places: Float[Array, "P 2"] = struct.field(metadata={"pad": FAR})
    obstacles: Obstacles
    radius: Float[Array, ""]  # m
    mesh_places: Int[Array, "M"] | None = None  # indices of places, repeated by their probability; None: uniform


def visible_words(navigation: Navigation, i: Int[Array, ""], j: Int[Array, ""]) -> UInt8[Array, "V8"]:
    """The bits of a cell (i, j): whether the tangent from its middle to each of the V arcs is free."""
    return navigation.visible.row((i, j), -(-navigation.arcs.side.shape[0] // 8))


def cell_of(
    table: FlatTable, origin: Float[Array, "2"], cell: Float[Array, ""] | float, position: Float[Array, "2"]
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """The cell of a table over the floor in which a position [m] is, or the nearest to it."""
    index = jnp.floor((position - origin) / cell).astype(jnp.int32)
    index = jnp.clip(index, 0, table.shape[:2] - 1)
    return index[0], index[1]


def arc_bits(words: UInt8[Array, "*places V8"], number: int) -> Bool[Array, "..."]:
    """The bits of ``Navigation.visible``, for each of so many arcs."""
    bits = words[..., None] & (1 << np.arange(8)).astype(np.uint8).reshape((1,) * words.ndim + (8,))
    return (bits != 0).reshape(*words.shape[:-1], -1)[..., :number]


class CommonTangents(NamedTuple):
    """K straight segments from arc to arc that touch both circles, in float64."""

    source: np.ndarray  # (K,) int, the arc that they leave
    target: np.ndarray  # (K,) int, the arc that they enter
    length: np.ndarray  # (K,) m
    departure_angle: np.ndarray  # (K,) rad, where they leave
    arrival_angle: np.ndarray  # (K,) rad, where they enter
    begin: np.ndarray  # (K, 2) m
    end: np.ndarray  # (K, 2) m


def build(environment: Environment, radius: float, cell: float | None = None) -> Navigation:
    """Build the tables on the host, or read them from the user's cache.

    Args:
        radius: m, of the disc.
        cell: m, side of the cells of the visibility grid; if None 0.25, or a multiple of it on large floors.

    Raises:
        InputError: there is hardly a free place for such a disc, or there are too many corners.
    """
    boxes = environment.obstacles
    inputs = environment.floor, boxes.center, boxes.half_extent, boxes.yaw, radius, 0.0 if cell is None else cell
    fields = dict(cache.load_or_build("navigation", CODE, inputs, lambda: _make(environment, radius, cell)))
    tables = {name: flat_table(fields.pop(name)) for name in TABLES}
    fields |= {"origin": np.asarray(environment.floor)[:2], "radius": np.asarray(radius)}
    fields = to_device(fields) | tables
    arcs = CornerArcs(*(fields.pop(name) for name in FIELDS))
    return Navigation(**fields, arcs=arcs, obstacles=boxes)


def inputs(navigation: Navigation) -> list:
    """The key of these tables in the cache, for tables that are computed from them."""
    boxes, grid = navigation.obstacles, (navigation.origin, navigation.cell, navigation.visible.shape)
    shape = boxes.center, boxes.half_extent, boxes.yaw, navigation.radius
    return [*shape, *jax.tree.leaves(navigation.arcs), navigation.distance.values, navigation.places, *grid]


def _make(environment: Environment, radius: float, cell: float | None) -> dict[str, np.ndarray]:
    """The fields of the tables and of their arcs, as numpy arrays."""
    boxes = environment.obstacles
    drawn = environments.free_points(environment, radius + ROOM, FREE_POINTS, seed=1)
    exact = find_arcs(environment, radius)
    if len(exact.side) > MAX_ARCS:
        what = f"{len(exact.side):,} arcs around corners, and paths are planned over {MAX_ARCS:,} at most"
        raise InputError(f"environment '{environment.name}' has {what}; describe it by fewer and larger boxes.")
    links = common_tangents(exact, radius)
    clear = pairs_are_free(boxes, max(radius - SLACK, 0.0), links.begin, links.end)
    links = CommonTangents(*(part[clear] for part in links))
    paths = _shortest_chains(len(exact.side), links, radius)
    floor = np.asarray(environment.floor)
    if cell is None:
        area = float(np.prod(floor[2:] - floor[:2]))
        cell = CELL * max(1, math.ceil(math.sqrt(area / MAX_CELLS) / CELL))
    count = np.ceil((floor[2:] - floor[:2]) / cell).astype(int)
    middle = [floor[k] + (np.arange(count[k]) + 0.5) * cell for k in (0, 1)]
    spots = np.stack(np.meshgrid(*middle, indexing="ij"), -1).reshape(-1, 2).astype(np.float32)
    shared = in_programs(boxes), in_programs(exact), jnp.asarray(radius, float)
    visible = map_in_batches(_visible_arcs, shared, np.concatenate([drawn, spots]))[:, : len(exact.side)]
    return {
        **{name: getattr(exact, name) for name in FIELDS},
        **paths,
        "visible": np.packbits(visible[FREE_POINTS:].reshape(*count, -1), axis=-1, bitorder="little"),
        "cell": np.asarray(cell),
        "places": drawn[_connected(visible[:FREE_POINTS], links)],
    }


def _visible_arcs(shared: tuple[Obstacles, CornerArcs, Array], spot: Array) -> Array:
    """(V,) bool: whether the tangent from the spot (2,) [m] to each arc is free.

    Within 0.4 of the radius of a corner, both of its arcs can be visible; then only one of the two tangents is tested.
    """
    boxes, arcs, radius = shared
    start, free_radius = push_out_of_obstacles(boxes, spot, radius)
    _, _, x, y, on_arc = tangents(arcs, start, radius, True)
    x, y = (jnp.where(on_arc[1::2], part[1::2], part[::2]) for part in (x, y))
    clear = segments_are_free(boxes, start, x, y, free_radius)
    return on_arc & jnp.repeat(clear, 2)


def _shortest_chains(number: int, links: CommonTangents, radius: float) -> dict[str, np.ndarray]:
    """The (V, V) tables of ``Navigation``: shortest chains of common tangents and arcs from arc to arc.

    By the relaxation of Bellman and Ford. Dijkstra's algorithm does not apply, because no arc runs backwards: the place
    where a path enters an arc decides which tangents it can take from there.
    """
    distance, arrival = np.full((number, number), np.inf), np.full((number, number), -np.inf)
    departure, rotation = np.zeros((number, number)), np.zeros((number, number))
    next_arc = np.zeros((number, number), int)
    first = np.arange(number)
    distance[first, first], next_arc[first, first] = 0.0, first
    order = np.argsort(links.target, kind="stable")
    source, target_of, leave, enter = (
        part[order] for part in (links.source, links.target, links.departure_angle, links.arrival_angle)
    )
    cost = links.length[order] + radius * (leave - enter)
    slices = np.searchsorted(target_of, np.arange(number + 1))
    changed = True
    while changed:
        changed = False
        for target in range(number):
            into = slice(slices[target], slices[target + 1])
            before = source[into]
            if len(before) == 0:
                continue
            feasible = arrival[:, before] <= leave[into] + STRAIGHT
            total = np.where(feasible, distance[:, before] + cost[into], np.inf)
            best = np.argmin(total, axis=1)
            rows = np.flatnonzero(total[first, best] < distance[:, target] - 1e-9)
            if len(rows) == 0:
                continue
            changed, best = True, best[rows]
            link = slices[target] + best
            starts = before[best] == rows
            distance[rows, target], arrival[rows, target] = total[rows, best], enter[link]
            rotation[rows, target] = rotation[rows, before[best]] + leave[link] - enter[link]
            departure[rows, target] = np.where(starts, leave[link], departure[rows, before[best]])
            next_arc[rows, target] = np.where(starts, target, next_arc[rows, before[best]])
    return {
        "distance": distance.T,
        "arrival_angle": arrival.T,
        "departure_angle": departure,
        "rotation": rotation,
        "next_arc": next_arc.astype(np.int16),
    }


def _connected(visible: np.ndarray, links: CommonTangents) -> np.ndarray:
    """(P,) bool: the spots from which an arc of the largest connected part is ``visible`` (P, V); all if none is."""
    number = visible.shape[1]
    if not visible.any():
        return np.ones(len(visible), bool)
    first = np.arange(0, number, 2)  # the two arcs of a corner are connected
    ends = np.append(links.source, first), np.append(links.target, first + 1)
    graph = coo_matrix((np.ones(len(ends[0])), ends), shape=(number, number))
    part = connected_components(graph, directed=False)[1]
    count = np.array([(visible[:, part == label]).any(1).sum() for label in range(part.max() + 1)])
    return np.asarray(visible[:, part == count.argmax()].any(1))


# --- arcs and their common tangents ---


def find_arcs(environment: Environment, radius: float) -> CornerArcs:
    """The corner arcs of an environment for a disc of a radius [m], as numpy arrays of float64.

    If there are none, one that no path can use.
    """
    boxes = environment.obstacles
    center, half, yaw = (np.asarray(part, float) for part in (boxes.center, boxes.half_extent, boxes.yaw))
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    corner = (center[:, None] + _rotated(half[:, None] * signs, yaw[:, None])).reshape(-1, 2)
    middle = _rotated(np.broadcast_to(signs / np.sqrt(2), (len(yaw), 4, 2)), yaw[:, None]).reshape(-1, 2)

    def free(index: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Whether the disc is clear at these angles, counter-clockwise, of the circles about those corners."""
        place = corner[index] + radius * _rotated(middle[index], angle)
        return np.minimum(*signed_distances_on_host(environment, place)) >= radius - 1e-6

    angles = np.linspace(-np.pi / 4, np.pi / 4, SAMPLES)
    index = np.arange(len(corner))
    clear = np.stack([free(index, np.full(len(corner), angle)) for angle in angles], 1)
    change = np.diff(np.pad(clear, [(0, 0), (1, 1)]).astype(int), axis=1)
    (where, begin), (_, end) = np.nonzero(change == 1), np.nonzero(change == -1)
    ends = []
    for inside, outside in ((begin, begin - 1), (end - 1, end)):  # bisection between a free sample and a covered one
        good, bad = angles[inside], angles[np.clip(outside, 0, SAMPLES - 1)]
        for _ in range(30):
            between = (good + bad) / 2
            is_free = free(where, between)
            good, bad = np.where(is_free, between, good), np.where(is_free, bad, between)
        ends.append(good)
    wide = ends[1] - ends[0] > np.sqrt(SLACK / max(radius, SLACK))  # paths over narrower ones may go straight
    where, low, high = where[wide], ends[0][wide], ends[1][wide]
    if len(where) == 0:
        corner, middle, where = np.zeros((1, 2)), np.array([[1.0, 0.0]]), np.zeros(1, int)
        low, high = np.full(1, 9.0), np.full(1, -9.0)  # an arc that no path touches: the tables must not be empty
    parts = {
        "corner": np.repeat(corner[where], 2, axis=0),
        "middle": np.repeat(middle[where], 2, axis=0),
        "side": np.tile([1.0, -1.0], len(where)),
        "first": np.stack([low, -high], 1).ravel(),
        "last": np.stack([high, -low], 1).ravel(),
    }
    return CornerArcs(**cast(dict[str, Any], parts))  # numpy's float64, until the tables are complete


def common_tangents(arcs: CornerArcs, radius: float) -> CommonTangents:
    """The segments from arc to arc that touch both circles of a radius [m], through any obstacles in between."""
    corner, middle, side, first, last = (
        np.asarray(part) for part in (arcs.corner, arcs.middle, arcs.side, arcs.first, arcs.last)
    )
    gap = corner[None] - corner[:, None]
    far = np.hypot(gap[..., 0], gap[..., 1])
    from_side, to_side = side[:, None], side[None, :]
    crossing = from_side != to_side
    exists = (far > 1e-6) & (~crossing | (far >= 2 * radius - SLACK))
    tilt = from_side * np.arcsin(np.minimum(np.where(crossing, 2 * radius, 0.0) / np.maximum(far, 1e-6), 1.0))
    along = _rotated(gap / np.maximum(far, 1e-6)[..., None], tilt)
    right = np.stack([along[..., 1], -along[..., 0]], -1)
    departure, arrival = (_touch_angle(middle, side, right, axis) for axis in (0, 1))
    for angle, axis in ((departure, 0), (arrival, 1)):
        low, high = (np.expand_dims(limit, 1 - axis) for limit in (first, last))
        exists = exists & (angle >= low - ANGLE) & (angle <= high + ANGLE)
    i, j = np.nonzero(exists)
    begin = corner[i] + radius * side[i, None] * right[i, j]
    end = corner[j] + radius * side[j, None] * right[i, j]
    return CommonTangents(i, j, np.hypot(*(end - begin).T), departure[i, j], arrival[i, j], begin, end)


def _rotated(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], -1)


def _touch_angle(middle: np.ndarray, side: np.ndarray, right: np.ndarray, axis: int) -> np.ndarray:
    """(V, V) rad where segments with that right-hand normal touch the first (axis 0) or the second (axis 1) arc."""
    middle, side = np.expand_dims(middle, 1 - axis), np.expand_dims(side, 1 - axis)
    normal = side[..., None] * right
    cross = middle[..., 0] * normal[..., 1] - middle[..., 1] * normal[..., 0]
    return side * np.arctan2(cross, (middle * normal).sum(-1))

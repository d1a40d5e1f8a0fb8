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
    masks = (1 << np.arange(8)).astype(np.uint8)
    masks = masks.reshape((1,) * words.ndim + (8,))
    bits = (words[..., None] & masks) != 0  # (*places, V8, 8)
    bits = bits.reshape(*words.shape[:-1], -1)
    return bits[..., :number]


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
    key = environment.floor, boxes.center, boxes.half_extent, boxes.yaw, radius, 0.0 if cell is None else cell
    fields = dict(cache.load_or_build("navigation", CODE, key, lambda: _make(environment, radius, cell)))
    tables = {name: flat_table(fields.pop(name)) for name in TABLES}
    fields |= {"origin": np.asarray(environment.floor)[:2], "radius": np.asarray(radius)}
    fields = to_device(fields) | tables
    arcs = CornerArcs(*(fields.pop(name) for name in FIELDS))
    return Navigation(**fields, arcs=arcs, obstacles=boxes)


def inputs(navigation: Navigation) -> list:
    """The key of these tables in the cache, for tables that are computed from them."""
    boxes = navigation.obstacles
    shape = boxes.center, boxes.half_extent, boxes.yaw, navigation.radius
    grid = navigation.origin, navigation.cell, navigation.visible.shape
    return [*shape, *jax.tree.leaves(navigation.arcs), navigation.distance.values, navigation.places, *grid]


def _make(environment: Environment, radius: float, cell: float | None) -> dict[str, np.ndarray]:
    """The fields of the tables and of their arcs, as numpy arrays."""
    boxes = environment.obstacles
    places = environments.free_points(environment, radius + ROOM, FREE_POINTS, seed=1)  # (P, 2) m
    arcs = find_arcs(environment, radius)
    n_arcs = len(arcs.side)
    if n_arcs > MAX_ARCS:
        raise InputError(
            f"environment '{environment.name}' has {n_arcs:,} arcs around corners, and paths are planned over "
            f"{MAX_ARCS:,} at most; describe it by fewer and larger boxes."
        )
    links = common_tangents(arcs, radius)
    clear = pairs_are_free(boxes, max(radius - SLACK, 0.0), links.begin, links.end)
    links = CommonTangents(*(field[clear] for field in links))

    # The arcs in sight of each place and of the middle of each cell.
    floor = np.asarray(environment.floor)
    cell = _default_cell(floor) if cell is None else cell
    n_cells = np.ceil((floor[2:] - floor[:2]) / cell).astype(int)
    cells = np.indices(tuple(n_cells)).reshape(2, -1).T
    middles = floor[:2] + (cells + 0.5) * cell  # (X * Y, 2) m
    spots = np.concatenate([places, middles.astype(np.float32)])
    shared = in_programs(boxes), in_programs(arcs), jnp.asarray(radius, float)
    visible = map_in_batches(_visible_arcs, shared, spots)[:, :n_arcs]
    from_places, from_cells = np.split(visible, [FREE_POINTS])
    from_cells = from_cells.reshape(*n_cells, -1)  # (X, Y, V)

    return {
        **{name: getattr(arcs, name) for name in FIELDS},
        **_shortest_chains(n_arcs, links, radius),
        "visible": np.packbits(from_cells, axis=-1, bitorder="little"),
        "cell": np.asarray(cell),
        "places": places[_connected(from_places, links)],
    }


def _default_cell(floor: np.ndarray) -> float:
    """Side [m] of the cells of the visibility grid: a multiple of ``CELL``."""
    area = float(np.prod(floor[2:] - floor[:2]))
    min_cell = math.sqrt(area / MAX_CELLS)
    return CELL * max(1, math.ceil(min_cell / CELL))


def _visible_arcs(shared: tuple[Obstacles, CornerArcs, Array], spot: Array) -> Array:
    """(V,) bool: whether the tangent from the spot (2,) [m] to each arc is free.

    Within 0.4 of the radius of a corner, both of its arcs can be visible; then only one of the two tangents is tested.
    """
    boxes, arcs, radius = shared
    start, free_radius = push_out_of_obstacles(boxes, spot, radius)
    _, _, x, y, on_arc = tangents(arcs, start, radius, True)
    x, y = (jnp.where(on_arc[1::2], component[1::2], component[::2]) for component in (x, y))
    clear = segments_are_free(boxes, start, x, y, free_radius)
    return on_arc & jnp.repeat(clear, 2)


def _connected(visible: Bool[np.ndarray, "P V"], links: CommonTangents) -> Bool[np.ndarray, "P"]:
    """The spots from which an arc of the largest connected component is ``visible``; all if none is."""
    n_arcs = visible.shape[1]
    if not visible.any():
        return np.ones(len(visible), bool)

    # Tangents connect arcs, and the two arcs of a corner are connected.
    left = np.arange(0, n_arcs, 2)
    source = np.append(links.source, left)
    target = np.append(links.target, left + 1)
    graph = coo_matrix((np.ones(len(source)), (source, target)), shape=(n_arcs, n_arcs))
    n_components, component = connected_components(graph, directed=False)

    # (C, P) whether a spot sees an arc of a component
    in_sight = np.stack([visible[:, component == label].any(1) for label in range(n_components)])
    return in_sight[in_sight.sum(1).argmax()]


# --- shortest chains of tangents and arcs ---


class Chains(NamedTuple):
    """The shortest chains so far, to the second arc (column) from the first (row)."""

    distance: Float[np.ndarray, "V V"]  # m, inf if there is none
    arrival_angle: Float[np.ndarray, "V V"]  # rad
    departure_angle: Float[np.ndarray, "V V"]  # rad
    rotation: Float[np.ndarray, "V V"]  # rad
    next_arc: Int[np.ndarray, "V V"]


def _shortest_chains(n_arcs: int, links: CommonTangents, radius: float) -> dict[str, np.ndarray]:
    """The (V, V) tables of ``Navigation``: shortest chains of common tangents and arcs from arc to arc.

    By the relaxation of Bellman and Ford. Dijkstra's algorithm does not apply, because no arc runs backwards: the place
    where a path enters an arc decides which tangents it can take from there.
    """
    shape = n_arcs, n_arcs
    chains = Chains(
        distance=np.full(shape, np.inf),
        arrival_angle=np.full(shape, -np.inf),
        departure_angle=np.zeros(shape),
        rotation=np.zeros(shape),
        next_arc=np.diag(np.arange(n_arcs)),
    )
    np.fill_diagonal(chains.distance, 0.0)

    # The tangents into each arc are a slice.
    order = np.argsort(links.target, kind="stable")
    links = CommonTangents(*(field[order] for field in links))
    ends = np.searchsorted(links.target, np.arange(n_arcs + 1))

    changed = True
    while changed:
        changed = False
        for target in range(n_arcs):
            into = slice(ends[target], ends[target + 1])
            links_into = CommonTangents(*(field[into] for field in links))
            changed |= _relax(chains, target, links_into, radius)

    # The first arc of distances and arrivals is the one to which the path leads.
    return {
        "distance": chains.distance.T,
        "arrival_angle": chains.arrival_angle.T,
        "departure_angle": chains.departure_angle,
        "rotation": chains.rotation,
        "next_arc": chains.next_arc.astype(np.int16),
    }


def _relax(chains: Chains, target: int, links: CommonTangents, radius: float) -> bool:
    """Replace, in place, the chains to an arc that are shorter by one of the tangents into it; whether any is."""
    if len(links.source) == 0:
        return False
    feasible = chains.arrival_angle[:, links.source] <= links.departure_angle + STRAIGHT
    rotation = links.departure_angle - links.arrival_angle
    link_length = links.length + radius * rotation
    total = chains.distance[:, links.source] + link_length
    total = np.where(feasible, total, np.inf)  # (V, links)

    # The first arcs that have a shorter chain by their best link.
    link = np.argmin(total, axis=1)
    shortest = np.take_along_axis(total, link[:, None], 1)[:, 0]
    start = np.flatnonzero(shortest < chains.distance[:, target] - 1e-9)
    link = link[start]
    source = links.source[link]
    leave = links.departure_angle[link]
    enter = links.arrival_angle[link]
    to_source = start, source
    to_target = start, target

    # The chain is the link alone, or goes on from a chain to its source.
    is_first = source == start
    chains.distance[to_target] = shortest[start]
    chains.arrival_angle[to_target] = enter
    chains.rotation[to_target] = chains.rotation[to_source] + leave - enter
    chains.departure_angle[to_target] = np.where(is_first, leave, chains.departure_angle[to_source])
    chains.next_arc[to_target] = np.where(is_first, target, chains.next_arc[to_source])
    return len(start) > 0


# --- arcs and their common tangents ---


class Quarters(NamedTuple):
    """The quarters of circles that a disc's middle describes around corners of obstacles."""

    corner: Float[np.ndarray, "K 2"]  # m
    middle: Float[np.ndarray, "K 2"]  # unit vector from the corner to the middle of the quarter


def find_arcs(environment: Environment, radius: float) -> CornerArcs:
    """The corner arcs of an environment for a disc of a radius [m], as numpy arrays of float64.

    If there are none, one that no path can use.
    """
    quarters = _quarters(environment.obstacles)
    index, low, high = _free_ranges(environment, radius, quarters)

    # Paths over narrower ranges may go straight.
    wide = high - low > np.sqrt(SLACK / max(radius, SLACK))
    corner = quarters.corner[index[wide]]
    middle = quarters.middle[index[wide]]
    low = low[wide]
    high = high[wide]

    # The tables must not be empty: an arc that no path touches.
    if len(corner) == 0:
        corner = np.zeros((1, 2))
        middle = np.array([[1.0, 0.0]])
        low = np.full(1, 9.0)
        high = np.full(1, -9.0)

    # Two arcs of each range: angles grow in the direction of travel.
    fields = {
        "corner": np.repeat(corner, 2, axis=0),
        "middle": np.repeat(middle, 2, axis=0),
        "side": np.tile([1.0, -1.0], len(corner)),
        "first": np.stack([low, -high], 1).ravel(),
        "last": np.stack([high, -low], 1).ravel(),
    }
    return CornerArcs(**cast(dict[str, Any], fields))  # numpy's float64, until the tables are complete


def _quarters(boxes: Obstacles) -> Quarters:
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    center = np.asarray(boxes.center, float)
    half = np.asarray(boxes.half_extent, float)
    yaw = np.asarray(boxes.yaw, float)[:, None]
    diagonal = np.broadcast_to(signs / np.sqrt(2), (len(yaw), 4, 2))
    corner = center[:, None] + _rotated(half[:, None] * signs, yaw)  # (W, 4, 2)
    middle = _rotated(diagonal, yaw)
    return Quarters(corner.reshape(-1, 2), middle.reshape(-1, 2))


def _free_ranges(
    environment: Environment, radius: float, quarters: Quarters
) -> tuple[Int[np.ndarray, "R"], Float[np.ndarray, "R"], Float[np.ndarray, "R"]]:
    """The parts of quarters on which the disc is free: index of the quarter, first and last angle [rad] in it."""
    angles = np.linspace(-np.pi / 4, np.pi / 4, SAMPLES)
    samples = []
    for angle in angles:
        same_angle = np.full(len(quarters.corner), angle)
        samples.append(_is_free(environment, radius, quarters, same_angle))
    clear = np.stack(samples, 1)  # (K, SAMPLES)

    # A part begins where samples become free, and ends before they are covered again.
    between_covered = np.pad(clear, [(0, 0), (1, 1)])
    change = np.diff(between_covered.astype(int), axis=1)
    index, first = np.nonzero(change == 1)
    _, last = np.nonzero(change == -1)
    last = last - 1

    # Between a free sample and the covered one beside it.
    quarters = Quarters(*(field[index] for field in quarters))
    before = np.clip(first - 1, 0, SAMPLES - 1)
    after = np.clip(last + 1, 0, SAMPLES - 1)
    low = _bisect(environment, radius, quarters, angles[first], angles[before])
    high = _bisect(environment, radius, quarters, angles[last], angles[after])
    return index, low, high


def _is_free(
    environment: Environment, radius: float, quarters: Quarters, angle: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Whether the disc touches nothing else at an angle [rad], counter-clockwise, of each quarter."""
    place = quarters.corner + radius * _rotated(quarters.middle, angle)  # (K, 2) m
    to_obstacle, to_edge = signed_distances_on_host(environment, place)
    return np.minimum(to_obstacle, to_edge) >= radius - 1e-6


def _bisect(
    environment: Environment, radius: float, quarters: Quarters, free: np.ndarray, covered: np.ndarray
) -> np.ndarray:
    """The last free angles [rad] between angles that are free and angles that are covered, or equal to them."""
    for _ in range(30):
        between = (free + covered) / 2
        is_free = _is_free(environment, radius, quarters, between)
        free = np.where(is_free, between, free)
        covered = np.where(is_free, covered, between)
    return free


def common_tangents(arcs: CornerArcs, radius: float) -> CommonTangents:
    """The segments from arc to arc that touch both circles of a radius [m], through any obstacles in between."""
    # A shortest path of a disc consists of arcs around corners and of tangents common to two of them.
    corner, middle, side, first, last = (np.asarray(getattr(arcs, name)) for name in FIELDS)
    gap = corner[None] - corner[:, None]  # (V, V, 2)
    distance = np.hypot(gap[..., 0], gap[..., 1])  # (V, V) m
    divisor = np.maximum(distance, 1e-6)
    direction = gap / divisor[..., None]

    # Tangents that pass the corners on different sides cross the line between them, if the circles are apart.
    from_side = side[:, None]
    crossing = from_side != side[None, :]
    exists = (distance > 1e-6) & (~crossing | (distance >= 2 * radius - SLACK))

    # A crossing tangent is tilted against the line of centers by asin(2 r / d), an outer one is parallel to it.
    sine = np.where(crossing, 2 * radius, 0.0) / divisor
    tilt = from_side * np.arcsin(np.minimum(sine, 1.0))
    along = _rotated(direction, tilt)
    right = np.stack([along[..., 1], -along[..., 0]], -1)  # (V, V, 2)

    # A path turns on the free part of an arc alone, so tangents must touch it there.
    departure = _touch_angle(middle[:, None], from_side, right)  # (V, V) rad
    arrival = _touch_angle(middle[None], side[None], right)
    lowest = first - ANGLE
    highest = last + ANGLE
    exists &= (departure >= lowest[:, None]) & (departure <= highest[:, None])
    exists &= (arrival >= lowest) & (arrival <= highest)

    # From a point of the first circle to one of the second.
    i, j = np.nonzero(exists)  # (P,)
    normal = right[i, j]  # (P, 2)
    begin = corner[i] + radius * side[i, None] * normal  # (P, 2) m
    end = corner[j] + radius * side[j, None] * normal
    length = np.hypot(*(end - begin).T)
    return CommonTangents(i, j, length, departure[i, j], arrival[i, j], begin, end)


def _rotated(vectors: Float[np.ndarray, "*batch 2"], angle: Float[np.ndarray, "..."]) -> Float[np.ndarray, "*batch 2"]:
    x = vectors[..., 0]
    y = vectors[..., 1]
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], -1)


def _touch_angle(middle: np.ndarray, side: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(V, V) rad where segments with that right-hand normal touch arcs, whose fields broadcast."""
    normal = side[..., None] * right
    cross = middle[..., 0] * normal[..., 1] - middle[..., 1] * normal[..., 0]
    dot = (middle * normal).sum(-1)
    return side * np.arctan2(cross, dot)

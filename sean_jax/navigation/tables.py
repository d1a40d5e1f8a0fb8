"""The tables of shortest paths for a disc of one radius, built once on the host."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from sean_jax import cache
from sean_jax import environment as environments
from sean_jax.base import Array, Environment, Obstacles
from sean_jax.devices import to_device
from sean_jax.errors import InputError
from sean_jax.navigation import corner_arcs
from sean_jax.navigation.corner_arcs import CommonTangents, CornerArcs
from sean_jax.navigation.segments import (
    SLACK,
    map_in_batches,
    pairs_are_free,
    push_out_of_obstacles,
    segments_are_free,
)

CODE = "navigation", "environment", "geometry"  # on which the tables depend
FIELDS = "corner", "middle", "side", "first", "last"
CELL = 0.25  # m
MAX_CELLS = 100_000  # of a visibility grid; larger floors have wider cells
MAX_ARCS = 2_500  # the tables have all pairs of them
PLACES = 1024  # free places from which starts and goals are drawn
ROOM = 0.1  # m, by which they are farther from obstacles than the radius
STRAIGHT = 1e-3  # rad, by which an arc may run backwards because of rounding


@struct.dataclass
class Navigation:
    """Tables of shortest paths for a disc of one radius.

    A path from arc to arc goes from the middle of the first to the middle of the second. Angles on an arc are counted
    from its middle, in the direction of travel.
    """

    arcs: CornerArcs  # V of them
    distance: Float[Array, "V V"]  # m, length of the path from the first arc to the second; inf if there is none
    departure_angle: Float[Array, "V V"]  # rad, where that path leaves the first
    arrival_angle: Float[Array, "V V"]  # rad, where it enters the second
    rotation: Float[Array, "V V"]  # rad, how much it turns, left and right added up
    next_arc: Int[Array, "V V"]  # the arc that follows the first
    visible: Bool[Array, "X Y V"]  # whether the tangent from the middle of a cell to the arc is free
    origin: Float[Array, "2"]  # m, lower left corner of the grid of cells
    cell: Float[Array, ""]  # m, side of a cell
    places: Float[Array, "P 2"]  # m, uniform over all places that the disc can reach
    obstacles: Obstacles
    radius: Float[Array, ""]  # m
    mesh_places: Int[Array, "M"] | None = None  # indices of places, as often as they are drawn; None: all alike


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
    made = to_device(dict(cache.load_or_build("navigation", CODE, inputs, lambda: _make(environment, radius, cell))))
    arcs = CornerArcs(*(made.pop(name) for name in FIELDS))
    origin, size = to_device((np.asarray(environment.floor)[:2], np.asarray(radius)))
    return Navigation(**made, arcs=arcs, origin=origin, obstacles=boxes, radius=size)


def inputs(navigation: Navigation) -> list:
    """The inputs that identify these tables in the cache, for tables that are computed from them.

    Args:
        navigation: of ``build``.
    """
    boxes, grid = navigation.obstacles, (navigation.origin, navigation.cell, navigation.visible.shape)
    shape = boxes.center, boxes.half_extent, boxes.yaw, navigation.radius
    return [*shape, *jax.tree.leaves(navigation.arcs), navigation.distance, navigation.places, *grid]


def _make(environment: Environment, radius: float, cell: float | None) -> dict[str, np.ndarray]:
    """The fields of the tables and of their arcs, as numpy arrays."""
    boxes = environment.obstacles
    drawn = environments.free_points(environment, radius + ROOM, PLACES, seed=1)
    exact = corner_arcs.find_arcs(environment, radius)
    if len(exact.side) > MAX_ARCS:
        what = f"{len(exact.side):,} arcs around corners, and paths are planned over {MAX_ARCS:,} at most"
        raise InputError(f"environment '{environment.name}' has {what}; describe it by fewer and larger boxes.")
    links = corner_arcs.common_tangents(exact, radius)
    clear = pairs_are_free(boxes, max(radius - SLACK, 0.0), links.begin, links.end)
    links = CommonTangents(*(part[clear] for part in links))
    paths = _shortest_chains(len(exact.side), links, radius)
    arcs = jax.tree.map(lambda part: jnp.asarray(part, float), exact)
    floor = np.asarray(environment.floor)
    if cell is None:
        area = float(np.prod(floor[2:] - floor[:2]))
        cell = CELL * max(1, math.ceil(math.sqrt(area / MAX_CELLS) / CELL))
    count = np.ceil((floor[2:] - floor[:2]) / cell).astype(int)
    middle = [floor[k] + (np.arange(count[k]) + 0.5) * cell for k in (0, 1)]
    spots = np.stack(np.meshgrid(*middle, indexing="ij"), -1).reshape(-1, 2).astype(np.float32)
    visible = map_in_batches(_visible_arcs, (boxes, arcs, jnp.asarray(radius, float)), np.concatenate([drawn, spots]))
    return {
        **{name: getattr(exact, name) for name in FIELDS},
        **paths,
        "visible": visible[PLACES:].reshape(*count, -1),
        "cell": np.asarray(cell),
        "places": drawn[_connected(visible[:PLACES], links)],
    }


def _visible_arcs(shared: tuple[Obstacles, CornerArcs, Array], spot: Array) -> Array:
    """(V,) bool: whether the tangent from the spot (2,) [m] to each arc is free.

    Within 0.4 of the radius of a corner, both of its arcs can be visible; then only one of the two tangents is tested.
    """
    boxes, arcs, radius = shared
    half = arcs.side.shape[0] // 2
    start, free_radius = push_out_of_obstacles(boxes, spot, radius)
    _, _, x, y, on_arc = corner_arcs.tangents(arcs, start, radius, True)
    x, y = (jnp.where(on_arc[half:], part[half:], part[:half]) for part in (x, y))
    clear = segments_are_free(boxes, start, x, y, free_radius)
    return on_arc & jnp.concatenate([clear, clear])


def _shortest_chains(number: int, links: CommonTangents, radius: float) -> dict[str, np.ndarray]:
    """The (V, V) tables of ``Navigation``: shortest chains of common tangents and arcs from arc to arc.

    By the relaxation of Bellman and Ford. Dijkstra's algorithm does not apply, because no arc runs backwards: the place
    where a path enters an arc decides which tangents it can take from there.
    """
    distance, arrival = np.full((number, number), np.inf), np.full((number, number), -np.inf)
    departure, rotation = np.zeros((number, number)), np.zeros((number, number))
    next_arc = np.zeros((number, number), int)
    own = np.arange(number)
    distance[own, own], next_arc[own, own] = 0.0, own
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
            rows = np.flatnonzero(total[own, best] < distance[:, target] - 1e-9)
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
        "distance": distance,
        "departure_angle": departure,
        "arrival_angle": arrival,
        "rotation": rotation,
        "next_arc": next_arc.astype(np.int16),
    }


def _connected(visible: np.ndarray, links: CommonTangents) -> np.ndarray:
    """(P,) bool: the spots from which an arc of the largest connected part is ``visible`` (P, V); all if none is."""
    number = visible.shape[1]
    if not visible.any():
        return np.ones(len(visible), bool)
    first = np.arange(number // 2)  # the two arcs of a corner are connected
    ends = np.append(links.source, first), np.append(links.target, first + number // 2)
    graph = coo_matrix((np.ones(len(ends[0])), ends), shape=(number, number))
    part = connected_components(graph, directed=False)[1]
    count = np.array([(visible[:, part == label]).any(1).sum() for label in range(part.max() + 1)])
    return np.asarray(visible[:, part == count.argmax()].any(1))

"""The tables of shortest paths for a disc of one radius, built once on the host."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from sean_jax import cache
from sean_jax import environment as environments
from sean_jax.base import Array, Environment, Obstacles
from sean_jax.navigation import bends as arcs
from sean_jax.navigation.bends import Bends
from sean_jax.navigation.sight import SLACK, in_parts, led_out, pairs_see, sees_each
from sean_jax.platforms import put

CODE = "navigation", "environment", "geometry"  # that the tables depend on
BENDS = "corner", "middle", "side", "first", "last"
CELL = 0.25  # m
MOST_CELLS = 100_000  # of a visibility grid; the cells of larger floors are wider
MOST_BENDS = 2_500  # the tables hold all pairs of them
PLACES = 1024  # free places kept for drawing starts and goals
ROOM = 0.1  # m, by which these are farther from obstacles than they must be
STRAIGHT = 1e-3  # rad, by which an arc may run backwards: rounding


@struct.dataclass
class Navigation:
    """Tables of shortest paths for a disc of one radius. Arcs are counted from the middles of bends, forward."""

    bends: Bends  # V of them
    distance: Array  # (V, V) m, along the shortest path from bend to bend; inf where there is none
    leave: Array  # (V, V) rad, where that path leaves the first of the two
    enter: Array  # (V, V) rad, where it enters the second
    turn: Array  # (V, V) rad, how much it turns in all
    onward: Array  # (V, V) int16, the bend that comes after the first
    visible: Array  # (X, Y, V) bool, whether the tangent from the middle of the cell is clear
    origin: Array  # (2,) m, lower left corner of the grid
    cell: Array  # () m, side of its cells
    places: Array  # (P, 2) m, uniform over where the disc is free and from where it can go anywhere else
    obstacles: Obstacles
    radius: Array  # () m


def build(environment: Environment, radius: float, cell: float | None = None) -> Navigation:
    """The tables for a disc of that radius [m]; made on the host, once for all processes.

    ``cell`` [m] is the side of the cells of the visibility grid: 0.25 if None, or a multiple of it on large floors.

    Raises:
        ValueError: there is hardly a free place for such a disc, or there are too many corners.
    """
    boxes = environment.obstacles
    inputs = environment.floor, boxes.center, boxes.half_extent, boxes.yaw, radius, 0.0 if cell is None else cell
    made = put(dict(cache.kept("navigation", CODE, inputs, lambda: _make(environment, radius, cell))))
    bends = Bends(*(made.pop(name) for name in BENDS))
    origin, size = put((np.asarray(environment.floor)[:2], np.asarray(radius)))
    return Navigation(**made, bends=bends, origin=origin, obstacles=boxes, radius=size)


def inputs(navigation: Navigation) -> list:
    """What tells these tables from others, for what is made of them."""
    boxes, grid = navigation.obstacles, (navigation.origin, navigation.cell, navigation.visible.shape)
    shape = boxes.center, boxes.half_extent, boxes.yaw, navigation.radius
    return [*shape, *jax.tree.leaves(navigation.bends), navigation.distance, navigation.places, *grid]


def _make(environment: Environment, radius: float, cell: float | None) -> dict[str, np.ndarray]:
    """The fields of the tables and of their bends, as numpy arrays."""
    boxes = environment.obstacles
    drawn = environments.free_points(environment, radius + ROOM, PLACES, seed=1)
    exact = arcs.find(environment, radius)
    if len(exact.side) > MOST_BENDS:
        what = f"{len(exact.side):,} bends around corners, and paths are planned over {MOST_BENDS:,} at most"
        raise ValueError(f"environment '{environment.name}' has {what}; describe it by fewer and larger boxes.")
    i, j, straight, leave, enter, begin, end = arcs.common_tangents(exact, radius)
    clear = pairs_see(boxes, max(radius - SLACK, 0.0), begin, end)
    i, j, straight, leave, enter = (part[clear] for part in (i, j, straight, leave, enter))
    tables = _chains(len(exact.side), i, j, straight, leave, enter, radius)
    bends = jax.tree.map(lambda part: jnp.asarray(part, float), exact)
    floor = np.asarray(environment.floor)
    if cell is None:
        area = float(np.prod(floor[2:] - floor[:2]))
        cell = CELL * max(1, math.ceil(math.sqrt(area / MOST_CELLS) / CELL))
    count = np.ceil((floor[2:] - floor[:2]) / cell).astype(int)
    middle = [floor[k] + (np.arange(count[k]) + 0.5) * cell for k in (0, 1)]
    spots = np.stack(np.meshgrid(*middle, indexing="ij"), -1).reshape(-1, 2).astype(np.float32)
    seen = in_parts(_seen, (boxes, bends, jnp.asarray(radius, float)), np.concatenate([drawn, spots]))
    return {
        **{name: getattr(exact, name) for name in BENDS},
        **dict(zip(("distance", "leave", "enter", "turn"), tables[:4], strict=True)),
        "onward": tables[4].astype(np.int16),
        "visible": seen[PLACES:].reshape(*count, -1),
        "cell": np.asarray(cell),
        "places": drawn[_connected(seen[:PLACES], i, j)],
    }


def _seen(shared: tuple, spot: Array) -> Array:
    """(V,) bool: whether the tangent from the spot (2,) [m] to each bend is clear.

    A corner's two bends can both be seen from within 0.4 of the radius of it: then it is one of them that is looked at.
    """
    boxes, bends, radius = shared
    half = bends.side.shape[0] // 2
    out, near = led_out(boxes, spot, radius)
    _, _, x, y, on = arcs.tangents(bends, out, radius, True)
    x, y = (jnp.where(on[half:], part[half:], part[:half]) for part in (x, y))
    clear = sees_each(boxes, out, x, y, near)
    return on & jnp.concatenate([clear, clear])


def _chains(number: int, i, j, straight, leave, enter, radius: float) -> tuple[np.ndarray, ...]:
    """(V, V) lengths [m] of shortest chains of tangents and arcs, where they leave and enter, turns, and second bends.

    From bend to bend, over the K tangents given; Bellman and Ford's relaxation, and not Dijkstra's algorithm, for it
    depends on where a bend is entered what can follow: no arc runs backwards.
    """
    distance, at = np.full((number, number), np.inf), np.full((number, number), -np.inf)
    first, turn, onward = np.zeros((number, number)), np.zeros((number, number)), np.zeros((number, number), int)
    own = np.arange(number)
    distance[own, own], onward[own, own] = 0.0, own
    order = np.argsort(j, kind="stable")
    i, j, leave, enter = i[order], j[order], leave[order], enter[order]
    cost = straight[order] + radius * (leave - enter)
    slices = np.searchsorted(j, np.arange(number + 1))
    changed = True
    while changed:
        changed = False
        for target in range(number):
            into = slice(slices[target], slices[target + 1])
            before = i[into]
            if len(before) == 0:
                continue
            feasible = at[:, before] <= leave[into] + STRAIGHT
            total = np.where(feasible, distance[:, before] + cost[into], np.inf)
            best = np.argmin(total, axis=1)
            rows = np.flatnonzero(total[own, best] < distance[:, target] - 1e-9)
            if len(rows) == 0:
                continue
            changed, best = True, best[rows]
            link = slices[target] + best
            starts = before[best] == rows
            distance[rows, target], at[rows, target] = total[rows, best], enter[link]
            turn[rows, target] = turn[rows, before[best]] + leave[link] - enter[link]
            first[rows, target] = np.where(starts, leave[link], first[rows, before[best]])
            onward[rows, target] = np.where(starts, target, onward[rows, before[best]])
    return distance, first, at, turn, onward


def _connected(seen: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(S,) bool: the spots that see (S, V) a bend of the largest connected part; all if there are no bends to see."""
    number = seen.shape[1]
    if not seen.any():
        return np.ones(len(seen), bool)
    both = np.arange(number // 2)  # one corner's two bends
    links = coo_matrix(
        (np.ones(len(i) + len(both)), (np.append(i, both), np.append(j, both + number // 2))), shape=(number, number)
    )
    part = connected_components(links, directed=False)[1]
    count = np.array([(seen[:, part == label]).any(1).sum() for label in range(part.max() + 1)])
    return np.asarray(seen[:, part == count.argmax()].any(1))

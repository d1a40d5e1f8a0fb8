"""Shortest paths of a disc among boxes in float64, found without the program: the oracle of its tests and benchmark.

A visibility graph over many points on the circles about all corners, taut edges alone, and scipy's Dijkstra. And at the
end, what the program says and where its next points lead, to be compared.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from sean_jax.world import navigation
from sean_jax.world.navigation import Navigation

ROUNDING = 1e-6  # m
BATCH = 100_000  # ways looked at in one go


class Boxes(NamedTuple):
    center: np.ndarray  # (W, 2) m
    half: np.ndarray  # (W, 2) m
    yaw: np.ndarray  # (W,) rad
    floor: np.ndarray  # (4,) m


def boxes_of(environment) -> Boxes:
    """The obstacles and the floor of an environment, in float64."""
    boxes = environment.obstacles
    return Boxes(*(np.asarray(part, float) for part in (boxes.center, boxes.half_extent, boxes.yaw, environment.floor)))


def locals_of(points, boxes: Boxes) -> np.ndarray:
    """(..., W, 2) points (..., 2) in the frames of the boxes."""
    offset = np.asarray(points, float)[..., None, :] - boxes.center
    cosine, sine = np.cos(boxes.yaw), np.sin(boxes.yaw)
    return np.stack([cosine * offset[..., 0] + sine * offset[..., 1],
                     cosine * offset[..., 1] - sine * offset[..., 0]], -1)  # fmt: skip


def clearance(points, boxes: Boxes) -> np.ndarray:
    """(...,) m outside the nearest box; 0 inside one."""
    return np.linalg.norm(np.maximum(np.abs(locals_of(points, boxes)) - boxes.half, 0), axis=-1).min(-1)


def to_edge(points, boxes: Boxes) -> np.ndarray:
    """(...,) m from points (..., 2) to the edge of the floor; negative off it."""
    return np.minimum(points - boxes.floor[:2], boxes.floor[2:] - points).min(-1)


def ways_clearance(p, q, boxes: Boxes) -> np.ndarray:
    """(...,) distance from the segments p to q (..., 2) to the nearest box, 0 if they meet."""
    a, b = locals_of(p, boxes), locals_of(q, boxes)
    half = boxes.half
    along = b - a
    still, inside = along == 0, np.abs(a) <= half
    slope = np.where(still, 1.0, along)
    one, other = (-half - a) / slope, (half - a) / slope
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(one, other)).max(-1)
    leave = np.where(still, np.inf, np.maximum(one, other)).min(-1)
    meets = np.maximum(enter, 0) <= np.minimum(leave, 1)
    ends = np.minimum(*(np.linalg.norm(np.maximum(np.abs(end) - half, 0), axis=-1) for end in (a, b)))
    square = np.maximum((along**2).sum(-1), 1e-30)
    nearest = ends
    for su in (-1, 1):
        for sv in (-1, 1):
            corner = np.array([su, sv]) * half
            share = np.clip(((corner - a) * along).sum(-1) / square, 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(a + share[..., None] * along - corner, axis=-1))
    return np.where(meets, 0.0, nearest).min(-1)


def clear(p, q, boxes: Boxes, radius: float) -> np.ndarray:
    """(K,) bool: which ways p to q (K, 2) keep that far [m] from all boxes."""
    parts = [slice(k, k + BATCH) for k in range(0, len(p), BATCH)]
    return np.concatenate([np.zeros(0, bool), *(ways_clearance(p[k], q[k], boxes) >= radius for k in parts)])


def walked_clearance(paths, boxes: Boxes) -> float:
    """Least distance [m] from the polylines (K, T, 2) to the nearest box; 0 if one is cut."""
    begin, end = paths[:, :-1].reshape(-1, 2), paths[:, 1:].reshape(-1, 2)
    moved = (begin != end).any(1)
    begin, end = begin[moved], end[moved]
    parts = [slice(k, k + BATCH) for k in range(0, len(begin), BATCH)]
    return min(ways_clearance(begin[k], end[k], boxes).min() for k in parts)


def geodesics(boxes: Boxes, radius: float, p, q, arc: int = 24) -> np.ndarray:
    """(K,) lengths [m] of the shortest ways of a disc of that radius from each p to each q (K, 2), or inf."""
    return shortest(boxes, radius, p, q, arc)[0]


def shortest(boxes: Boxes, radius: float, p, q, arc: int = 24) -> tuple[np.ndarray, list[np.ndarray]]:
    """(K,) ``geodesics``, and the ways themselves: K polylines (..., 2) [m], of their start alone where there is none.

    With ``arc`` points on each quarter of a circle and chords between them, which are shorter than the circle by about
    one part in 10 arc^2, and may cut into it by as much as they must.
    """
    nodes, normals = _circles(boxes, radius, arc)
    free = (clearance(nodes, boxes) >= radius - ROUNDING) & (to_edge(nodes, boxes) >= radius - ROUNDING)
    nodes, normals = nodes[free], normals[free]
    step = np.pi / 2 / (arc - 1)
    least = radius * np.cos(step / 2) - ROUNDING
    taut = np.sin(1.01 * step)  # a shortest way leaves a circle along its tangent
    found = []

    def link(rows, columns, begin, end, *sides):
        along = end - begin
        far = np.linalg.norm(along, axis=1)
        kept = far > 0
        for side in sides:
            kept &= np.abs((along * side).sum(1)) <= taut * far
        rows, columns, begin, end, far = (part[kept] for part in (rows, columns, begin, end, far))
        kept = clear(begin, end, boxes, least)
        found.append((rows[kept], columns[kept], far[kept]))

    number, pairs = len(nodes), len(p)
    for i in range(number - 1):
        j = np.arange(i + 1, number)
        link(np.full(len(j), i), j, nodes[[i] * len(j)], nodes[j], normals[[i] * len(j)], normals[j])
    for k in range(pairs):
        for row, spot in ((number + k, p[k]), (number + pairs + k, q[k])):
            link(np.full(number, row), np.arange(number), np.broadcast_to(spot, nodes.shape), nodes, normals)
    link(np.arange(pairs) + number, np.arange(pairs) + number + pairs, p, q)
    i, j, far = (np.concatenate(parts) for parts in zip(*found, strict=True))
    size = number + 2 * pairs
    starts = number + np.arange(pairs)
    graph = csr_matrix((far, (i, j)), shape=(size, size))
    lengths, before = dijkstra(graph, directed=False, indices=starts, return_predecessors=True)
    spots, ways = np.concatenate([nodes, p, q]), []
    for k in range(pairs):
        way = [starts[k] + pairs]
        while before[k, way[-1]] >= 0:
            way.append(before[k, way[-1]])
        ways.append(spots[way[::-1]])
    return lengths[np.arange(pairs), starts + pairs], ways


def _circles(boxes: Boxes, radius: float, arc: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (4 W arc, 2) on the circles about all corners, and the unit vectors (4 W arc, 2) out of them there."""
    angle = np.linspace(0, np.pi / 2, arc)
    cosine, sine = np.cos(boxes.yaw)[:, None], np.sin(boxes.yaw)[:, None]
    nodes, normals = [], []
    for su, sv in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        u, v = su * np.cos(angle), sv * np.sin(angle)
        ku, kv = su * boxes.half[:, :1], sv * boxes.half[:, 1:]
        normals.append(np.stack([cosine * u - sine * v, sine * u + cosine * v], -1))
        corner = np.stack([cosine * ku - sine * kv, sine * ku + cosine * kv], -1) + boxes.center[:, None]
        nodes.append(corner + radius * normals[-1])
    return np.concatenate(nodes).reshape(-1, 2), np.concatenate(normals).reshape(-1, 2)


@jax.jit
def lengths(tables: Navigation, starts, goals):
    """(K,) m what the program says of the ways from starts to goals (K, 2)."""

    def one(start, goal):
        return navigation.geodesic(tables, start, goal, navigation.build_paths_to_goal(tables, goal))

    return jax.vmap(one)(starts, goals)


@functools.partial(jax.jit, static_argnums=4)
def follow(tables: Navigation, starts, goals, stride, count: int):
    """Positions (K, count, 2) of points that go straight to the next point, not farther than a stride [m] at a time."""

    def one(start, goal):
        paths_to_goal = navigation.build_paths_to_goal(tables, goal)

        def step(position, _):
            gap = navigation.next_point(tables, position, goal, paths_to_goal) - position
            far = jnp.sqrt((gap * gap).sum())
            position = position + gap * (jnp.minimum(far, stride) / jnp.maximum(far, 1e-6))
            return position, position

        return jax.lax.scan(step, start, length=count)[1]

    return jax.vmap(one)(starts, goals)

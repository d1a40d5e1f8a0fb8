"""Shortest paths of a disc among boxes in float64, found without the program: the oracle of its tests and benchmark.

A visibility graph over many points on the circles about all corners, taut edges alone, and scipy's Dijkstra.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

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


def geodesics(boxes: Boxes, radius: float, p, q, arc: int = 24) -> np.ndarray:
    """(K,) lengths [m] of the shortest ways of a disc of that radius from each p to each q (K, 2); inf without a way.

    With ``arc`` points on each quarter of a circle and chords between them, which is too short by less than one part
    in 10 arc^2 of what is bent. Chords may cut into the circle by as much as they must.
    """
    angle = np.linspace(0, np.pi / 2, arc)
    step = angle[1]
    nodes, normals = [], []
    for su, sv in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        nu, nv = su * np.cos(angle), sv * np.sin(angle)
        for parts, u, v in ((normals, nu + 0 * boxes.half[:, :1], nv + 0 * boxes.half[:, :1]),
                            (nodes, su * boxes.half[:, :1] + radius * nu, sv * boxes.half[:, 1:] + radius * nv)):  # fmt: skip
            turned = np.stack([np.cos(boxes.yaw)[:, None] * u - np.sin(boxes.yaw)[:, None] * v,
                               np.sin(boxes.yaw)[:, None] * u + np.cos(boxes.yaw)[:, None] * v], -1)  # fmt: skip
            parts.append((turned + (boxes.center[:, None] if parts is nodes else 0)).reshape(-1, 2))
    nodes, normals = np.concatenate(nodes), np.concatenate(normals)
    free = (clearance(nodes, boxes) >= radius - ROUNDING) & (to_edge(nodes, boxes) >= radius - ROUNDING)
    nodes, normals = nodes[free], normals[free]
    least = radius * np.cos(step / 2) - ROUNDING
    taut = np.sin(1.01 * step) + 1e-9  # a shortest way leaves a circle along its tangent
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
        for offset, spot in ((number, p[k]), (number + pairs, q[k])):
            many = np.broadcast_to(spot, nodes.shape)
            link(np.full(number, offset + k), np.arange(number), many, nodes, normals)
    link(np.arange(pairs) + number, np.arange(pairs) + number + pairs, p, q)
    i, j, far = (np.concatenate(parts) for parts in zip(*found, strict=True))
    size = number + 2 * pairs
    lengths = dijkstra(csr_matrix((far, (i, j)), shape=(size, size)), directed=False, indices=number + np.arange(pairs))
    return lengths[np.arange(pairs), number + pairs + np.arange(pairs)]

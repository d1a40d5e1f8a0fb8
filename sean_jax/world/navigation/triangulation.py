"""The free floor as triangles, as in a navigation mesh.

Edges are segments between corners of the free floor that enter no obstacle, the shortest first, as far as they cross no
shorter edge. Once no segment can be added, the edges enclose triangles (greedy triangulation). Recast, whose meshes
Unity has, also cuts by the shortest diagonals. Boxes may overlap in any way.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from sean_jax.core.data_types import Environment

ROUNDING = 1e-6  # m, of corners
SAME = 5e-6  # m, nearer corners are one, and a segment passes through a corner that is nearer to it
CELLS = 256  # of a side of the room: pairs of corners are sorted out by cells that are in an obstacle
SAMPLES = 63  # cells on the segment between two corners that are looked up
CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])


class Boxes(NamedTuple):
    """Obstacles that are grown by a radius without rounding, in float64; the last box is the room, shrunk by it."""

    center: Float[np.ndarray, "W 2"]  # m
    half: Float[np.ndarray, "W 2"]  # m
    cosine: Float[np.ndarray, "W"]
    sine: Float[np.ndarray, "W"]


def free_triangles(environment: Environment, radius: float) -> Float[np.ndarray, "T 3 2"]:
    """The floor that is free for a disc of a radius [m] as triangles [m], counter-clockwise, with sharp corners."""
    boxes = _grow(environment, radius)
    corner = _corners(boxes)
    triangles = _faces(corner, _shortest_edges(corner, _free_pairs(boxes, corner)))
    return corner[triangles[_clearance(boxes, corner[triangles].mean(1)) > 0.0]]


def _grow(environment: Environment, radius: float) -> Boxes:
    obstacles, floor = environment.obstacles, np.asarray(environment.floor, float)
    center, half, yaw = (np.asarray(part, float) for part in (obstacles.center, obstacles.half_extent, obstacles.yaw))
    center = np.concatenate([center, [(floor[:2] + floor[2:]) / 2]])
    half = np.concatenate([half + radius, [(floor[2:] - floor[:2]) / 2 - radius]])
    yaw = np.append(yaw, 0.0)
    return Boxes(center, half, np.cos(yaw), np.sin(yaw))


def _in_frames(boxes: Boxes, points: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "2 P W"]:
    """The points [m] in the frame of each box."""
    x, y = np.moveaxis(points[:, None] - boxes.center, -1, 0)
    return np.stack([boxes.cosine * x + boxes.sine * y, boxes.cosine * y - boxes.sine * x])


def _clearance(boxes: Boxes, points: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P"]:
    """To the nearest side [m] along the axes of its box, negative within an obstacle or outside the room."""
    clearance = np.empty(len(points))
    for part in np.array_split(np.arange(len(points)), max(1, len(points) // 1024)):
        over = (np.abs(_in_frames(boxes, points[part])) - boxes.half.T[:, None]).max(0)  # negative inside
        over[:, -1] *= -1
        clearance[part] = over.min(1)
    return clearance


def _corners(boxes: Boxes) -> Float[np.ndarray, "K 2"]:
    """The corners [m] of boxes, and where sides of two of them meet, as far as they are free, in order, each once."""
    x, y = np.moveaxis(boxes.half[:, None] * CORNERS, -1, 0)
    cosine, sine = boxes.cosine[:, None], boxes.sine[:, None]
    corner = boxes.center[:, None] + np.stack([cosine * x - sine * y, sine * x + cosine * y], -1)
    begin, way = corner.reshape(-1, 2), (np.roll(corner, -1, 1) - corner).reshape(-1, 2)
    crossings = [begin]
    for origin, along in zip(begin, way, strict=True):
        gap = begin - origin
        cross = along[0] * way[:, 1] - along[1] * way[:, 0]
        crosses = np.abs(cross) > 1e-9 * (1.0 + np.abs(way).max(1))
        scale = 1.0 / np.where(crosses, cross, 1.0)
        mine = (gap[:, 0] * way[:, 1] - gap[:, 1] * way[:, 0]) * scale
        other = (gap[:, 0] * along[1] - gap[:, 1] * along[0]) * scale
        meets = crosses & (np.minimum(mine, other) >= 0.0) & (np.maximum(mine, other) <= 1.0)
        crossings.append(origin + mine[meets, None] * along)
    spots = np.unique(np.round(np.concatenate(crossings) / ROUNDING).astype(np.int64), axis=0) * ROUNDING
    spots = spots[_clearance(boxes, spots) >= -2 * ROUNDING]
    doubles = KDTree(spots).query_pairs(SAME, output_type="ndarray")[:, 1] if len(spots) else []
    return np.delete(spots, doubles, 0)


def _free_pairs(boxes: Boxes, corner: Float[np.ndarray, "K 2"]) -> Int[np.ndarray, "P 2"]:
    """The pairs of corners between which a segment enters no obstacle and passes through no other corner."""
    pairs = np.stack(np.triu_indices(len(corner), 1), 1)
    low, cell = boxes.center[-1] - boxes.half[-1], np.maximum(2 * boxes.half[-1] / CELLS, ROUNDING)
    middle = low + (np.indices((CELLS, CELLS)).reshape(2, -1).T + 0.5) * cell
    full = (_clearance(boxes, middle) < -np.hypot(*cell) / 2).reshape(CELLS, CELLS)
    for share in np.arange(1, SAMPLES + 1) / (SAMPLES + 1):
        point = (1 - share) * corner[pairs[:, 0]] + share * corner[pairs[:, 1]]
        i, j = np.clip((point - low) // cell, 0, CELLS - 1).astype(int).T
        pairs = pairs[~full[i, j]]
    begin, end = corner[pairs[:, 0]], corner[pairs[:, 1]]
    way = end - begin
    span = np.hypot(*way.T)
    free = np.ones(len(pairs), bool)
    for index in range(len(boxes.center) - 1):
        box = Boxes(*(part[index : index + 1] for part in boxes))
        here, there = (_in_frames(box, points)[..., 0] for points in (begin, end))
        side, step = np.maximum(box.half.T - 2 * SAME, 0.0), there - here
        step = np.where(np.abs(step) < 1e-12, 1e-12, step)
        enters, leaves = np.sort([(-side - here) / step, (side - here) / step], axis=0)
        free &= np.maximum(enters.max(0), 0.0) >= np.minimum(leaves.min(0), 1.0)
    for point in corner:
        gap = point - begin
        share = (gap * way).sum(1) / span
        passes = np.abs(way[:, 0] * gap[:, 1] - way[:, 1] * gap[:, 0]) < SAME * span
        free &= ~(passes & (share > SAME) & (share < span - SAME))
    return pairs[free]


def _shortest_edges(corner: Float[np.ndarray, "K 2"], pairs: Int[np.ndarray, "P 2"]) -> Int[np.ndarray, "E 2"]:
    """The pairs of corners whose segments cross none that is shorter and chosen."""
    x, y = corner.T
    order = np.argsort(np.hypot(*(corner[pairs[:, 1]] - corner[pairs[:, 0]]).T), kind="stable")
    chosen = np.empty((3 * len(corner), 2), int)  # a plane graph has fewer edges
    count = 0

    def left_of(a, b, c):
        return (x[b] - x[a]) * (y[c] - y[a]) > (y[b] - y[a]) * (x[c] - x[a])

    for a, b in pairs[order]:
        c, d = chosen[:count].T
        apart = (c != a) & (c != b) & (d != a) & (d != b)
        crosses = (left_of(a, b, c) != left_of(a, b, d)) & (left_of(c, d, a) != left_of(c, d, b))
        if not (apart & crosses).any():
            chosen[count] = a, b
            count += 1
    return chosen[:count]


def _faces(corner: Float[np.ndarray, "K 2"], edges: Int[np.ndarray, "E 2"]) -> Int[np.ndarray, "T 3"]:
    """The triangles that edges enclose, counter-clockwise."""
    source, target = np.concatenate([edges, edges[:, ::-1]]).T
    angle = np.arctan2(*(corner[target] - corner[source]).T[::-1])
    order = np.lexsort((angle, source))
    source, target = source[order], target[order]
    begin, count = np.unique(source, return_index=True, return_counts=True)[1:]
    following = np.arange(1, len(source) + 1)
    following[begin + count - 1] = begin
    wedges = np.stack([source, target, target[following]], 1)  # a corner and two neighbors, one after the other
    lowest = wedges.argmin(1)
    wedges = np.take_along_axis(wedges, (lowest[:, None] + np.arange(3)) % 3, 1)
    triangles, times = np.unique(wedges, axis=0, return_counts=True)
    triangles = triangles[times == 3]  # of all its corners
    first, second = corner[triangles[:, 1]] - corner[triangles[:, 0]], corner[triangles[:, 2]] - corner[triangles[:, 0]]
    return triangles[first[:, 0] * second[:, 1] > first[:, 1] * second[:, 0]]

"""The free floor as triangles, as in a navigation mesh.

Edges are segments between corners of the free floor that enter no obstacle, the shortest first, as far as they cross no
shorter edge. Once no segment can be added, the edges enclose triangles (greedy triangulation). Recast, whose meshes
Unity has, also cuts by the shortest diagonals. Boxes may overlap in any way.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from sean_jax.core.data_types import Environment

ROUNDING = 1e-6  # m, of corners
SAME = 5e-6  # m, nearer corners are one, and a segment passes through a corner that is nearer to it
CELLS = 256  # of a side of the room: pairs of corners are sorted out by cells that are in an obstacle
SAMPLES = 63  # cells on the segment between two corners that are looked up
CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])


class Boxes(NamedTuple):
    """Obstacles that are grown by a radius without rounding, in float64; the last box is the room, shrunk by it."""

    center: Float[np.ndarray, "*boxes 2"]  # m
    half: Float[np.ndarray, "*boxes 2"]  # m
    cosine: Float[np.ndarray, "*boxes"]
    sine: Float[np.ndarray, "*boxes"]


class Segments(NamedTuple):
    """Straight segments between two corners."""

    start: Float[np.ndarray, "P 2"]  # m
    end: Float[np.ndarray, "P 2"]  # m


def free_triangles(environment: Environment, radius: float) -> Float[np.ndarray, "T 3 2"]:
    """The floor that is free for a disc of a radius [m] as triangles [m], counter-clockwise, with sharp corners."""
    boxes = _grow(environment, radius)
    corners = _corners(boxes)
    pairs = _free_pairs(boxes, corners)
    edges = _shortest_edges(corners, pairs)
    faces = _faces(corners, edges)
    triangles = corners[faces]  # (T, 3, 2) m

    # Edges also enclose obstacles.
    clearance = _clearance(boxes, triangles.mean(1))
    return triangles[clearance > 0.0]


def _grow(environment: Environment, radius: float) -> Boxes:
    obstacles = environment.obstacles
    floor = np.asarray(environment.floor, float)
    lower = floor[:2]
    upper = floor[2:]

    # The room comes last.
    room_center = (lower + upper) / 2
    center = np.concatenate([obstacles.center, [room_center]], dtype=float)  # (W, 2) m
    half = np.asarray(obstacles.half_extent, float) + radius
    room_half = (upper - lower) / 2 - radius
    half = np.concatenate([half, [room_half]])
    yaw = np.append(np.asarray(obstacles.yaw, float), 0.0)
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    return Boxes(center, half, cosine, sine)


def _obstacles(boxes: Boxes) -> Iterator[Boxes]:
    """Each box but the room."""
    for index in range(len(boxes.center) - 1):
        yield Boxes(*(field[index] for field in boxes))


def _to_frame(boxes: Boxes, points: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "2 ..."]:
    """The points [m], which broadcast with the boxes, in the frame of their box."""
    offsets = points - boxes.center
    x, y = np.moveaxis(offsets, -1, 0)
    return _rotated(x, y, boxes.cosine, -boxes.sine)


def _rotated(x: np.ndarray, y: np.ndarray, cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
    u = cosine * x - sine * y
    v = sine * x + cosine * y
    return np.stack([u, v])


def _cross(u: Float[np.ndarray, "*us 2"], v: Float[np.ndarray, "*vs 2"]) -> Float[np.ndarray, "..."]:
    """The cross product of vectors in the plane, which broadcast; positive if v is to the left of u."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def _clearance(boxes: Boxes, points: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P"]:
    """To the nearest side [m] along the axes of its box, negative within an obstacle or outside the room."""
    n_batches = max(1, len(points) // 1024)
    batches = np.array_split(points, n_batches)
    return np.concatenate([_clearance_of_batch(boxes, batch) for batch in batches])


def _clearance_of_batch(boxes: Boxes, points: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P"]:
    local = _to_frame(boxes, points[:, None])  # (2, P, W)
    beyond_sides = np.abs(local) - boxes.half.T[:, None]
    beyond = beyond_sides.max(0)  # (P, W), negative inside
    beyond[:, -1] *= -1  # the room is free inside
    return beyond.min(1)


# --- corners and segments between them ---


def _corners(boxes: Boxes) -> Float[np.ndarray, "K 2"]:
    """The corners [m] of boxes, and where sides of two of them meet, as far as they are free, in order, each once."""
    x, y = (boxes.half[:, None] * CORNERS).T  # (4, W)
    offsets = _rotated(x, y, boxes.cosine, boxes.sine)  # (2, 4, W)
    corners = boxes.center[:, None] + offsets.T  # (W, 4, 2)
    following = np.roll(corners, -1, 1)
    sides = Segments(corners.reshape(-1, 2), following.reshape(-1, 2))

    # Rounded, the same corner of two boxes occurs once.
    points = np.concatenate([sides.start, *_crossings(sides)])  # (K, 2) m
    rounded = np.round(points / ROUNDING).astype(np.int64)
    rounded = np.unique(rounded, axis=0)
    points = rounded * ROUNDING
    is_free = _clearance(boxes, points) >= -2 * ROUNDING
    points = points[is_free]
    if len(points) == 0:
        return points

    # On either side of a border between two roundings it occurs twice.
    pairs = KDTree(points).query_pairs(SAME, output_type="ndarray")
    return np.delete(points, pairs[:, 1], 0)


def _crossings(sides: Segments) -> Iterator[Float[np.ndarray, "X 2"]]:
    """Where each side crosses others [m], by Cramer's rule."""
    direction = sides.end - sides.start
    size = np.abs(direction).max(1)
    parallel = 1e-9 * (1.0 + size)
    for start, along in zip(sides.start, direction, strict=True):
        gap = sides.start - start
        determinant = _cross(along, direction)
        crosses = np.abs(determinant) > parallel
        divisor = np.where(crosses, determinant, 1.0)
        scale = 1.0 / divisor

        # They meet if the crossing of their lines lies on both.
        share = _cross(gap, direction) * scale
        other_share = _cross(gap, along) * scale
        low = np.minimum(share, other_share)
        high = np.maximum(share, other_share)
        on_both = (low >= 0.0) & (high <= 1.0)
        meets = crosses & on_both
        meeting_share = share[meets, None]
        yield start + meeting_share * along


def _free_pairs(boxes: Boxes, corners: Float[np.ndarray, "K 2"]) -> Int[np.ndarray, "P 2"]:
    """The pairs of corners between which a segment enters no obstacle and passes through no other corner."""
    pairs = _pairs_past_full_cells(boxes, corners)
    segments = _between(corners, pairs)

    blocked = np.zeros(len(pairs), bool)
    for box in _obstacles(boxes):
        blocked |= _enters_box(segments, box)

    # Through a third corner, two triangles would share only a part of an edge.
    for corner in corners:
        blocked |= _passes_through(segments, corner)
    return pairs[~blocked]


def _between(corners: Float[np.ndarray, "K 2"], pairs: Int[np.ndarray, "P 2"]) -> Segments:
    start, end = pairs.T
    return Segments(corners[start], corners[end])


def _pairs_past_full_cells(boxes: Boxes, corners: Float[np.ndarray, "K 2"]) -> Int[np.ndarray, "P 2"]:
    """The pairs of corners between which no sample lies in a cell inside an obstacle: the few worth an exact test."""
    room = boxes.half[-1]
    low = boxes.center[-1] - room
    cell = np.maximum(2 * room / CELLS, ROUNDING)  # (2,) m

    # A cell is full if its corners are in an obstacle as well as its middle.
    cells = np.indices((CELLS, CELLS)).reshape(2, -1).T
    middles = low + (cells + 0.5) * cell  # (CELLS^2, 2) m
    half_diagonal = np.hypot(*cell) / 2
    full = _clearance(boxes, middles) < -half_diagonal
    full = full.reshape(CELLS, CELLS)

    # Each sample leaves the pairs between which it lies in no full cell.
    pairs = np.stack(np.triu_indices(len(corners), 1), 1)  # (P, 2)
    for sample in range(1, SAMPLES + 1):
        share = sample / (SAMPLES + 1)
        start, end = _between(corners, pairs)
        samples = (1 - share) * start + share * end
        cells = (samples - low) // cell
        cells = np.clip(cells, 0, CELLS - 1)
        i, j = cells.astype(int).T
        is_full = full[i, j]
        pairs = pairs[~is_full]
    return pairs


def _enters_box(segments: Segments, box: Boxes) -> Bool[np.ndarray, "P"]:
    """Whether each segment enters the inside of a box (slab method; Kay and Kajiya 1986)."""
    start = _to_frame(box, segments.start)  # (2, P)
    end = _to_frame(box, segments.end)
    direction = end - start
    is_parallel = np.abs(direction) < 1e-12
    direction = np.where(is_parallel, 1e-12, direction)

    half = np.maximum(box.half - 2 * SAME, 0.0)[:, None]  # a segment along a side does not enter
    at_low = (-half - start) / direction
    at_high = (half - start) / direction
    first = np.minimum(at_low, at_high).max(0)
    last = np.maximum(at_low, at_high).min(0)
    enter = np.maximum(first, 0.0)
    leave = np.minimum(last, 1.0)
    return enter < leave


def _passes_through(segments: Segments, corner: Float[np.ndarray, "2"]) -> Bool[np.ndarray, "P"]:
    """Whether each segment passes through a corner that is not one of its ends."""
    direction = segments.end - segments.start
    length = np.hypot(*direction.T)

    gap = corner - segments.start
    product = (gap * direction).sum(1)
    along = product / length
    across = np.abs(_cross(direction, gap))  # times the length
    is_near = across < SAME * length
    is_between = (along > SAME) & (along < length - SAME)
    return is_near & is_between


# --- edges and triangles ---


def _shortest_edges(corners: Float[np.ndarray, "K 2"], pairs: Int[np.ndarray, "P 2"]) -> Int[np.ndarray, "E 2"]:
    """The pairs of corners whose segments cross none that is shorter and chosen."""
    start, end = _between(corners, pairs)
    length = np.hypot(*(end - start).T)

    chosen = np.empty((3 * len(corners), 2), int)  # a plane graph has fewer edges
    count = 0
    order = np.argsort(length, kind="stable")
    for a, b in pairs[order]:
        if _crosses_any(corners, a, b, chosen[:count]):
            continue
        chosen[count] = a, b
        count += 1
    return chosen[:count]


def _crosses_any(corners: Float[np.ndarray, "K 2"], a: int, b: int, edges: Int[np.ndarray, "E 2"]) -> bool:
    """Whether the segment from corner a to corner b crosses an edge (c, d)."""
    c, d = edges.T
    apart = (c != a) & (c != b) & (d != a) & (d != b)

    # They cross if the ends of each lie on different sides of the other.
    start = corners[a]
    end = corners[b]
    starts = corners[c]  # (E, 2)
    ends = corners[d]
    splits = _left_of(start, end, starts) != _left_of(start, end, ends)
    is_split = _left_of(starts, ends, start) != _left_of(starts, ends, end)
    return bool((apart & splits & is_split).any())


def _left_of(start: np.ndarray, end: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Whether a point lies to the left of the line from start to end (*batch, 2)."""
    return _cross(end - start, point - start) > 0.0


def _faces(corners: Float[np.ndarray, "K 2"], edges: Int[np.ndarray, "E 2"]) -> Int[np.ndarray, "T 3"]:
    """The triangles that edges enclose, counter-clockwise."""
    wedges = _wedges(corners, edges)
    lowest = wedges.argmin(1)[:, None]
    rotation = (lowest + np.arange(3)) % 3
    wedges = np.take_along_axis(wedges, rotation, 1)

    # A triangle is a wedge of each of its three corners.
    triangles, counts = np.unique(wedges, axis=0, return_counts=True)
    complete = counts == 3
    triangles = triangles[complete]

    # The rest is the outside of a triangle that is apart from all others.
    first, second, third = corners[triangles.T]
    return triangles[_left_of(first, second, third)]


def _wedges(corners: Float[np.ndarray, "K 2"], edges: Int[np.ndarray, "E 2"]) -> Int[np.ndarray, "W 3"]:
    """Each corner with two of its neighbors that follow one another counter-clockwise."""
    backward = edges[:, ::-1]
    directed = np.concatenate([edges, backward])
    start, end = _between(corners, directed)
    dx, dy = (end - start).T
    angle = np.arctan2(dy, dx)
    order = np.lexsort((angle, directed[:, 0]))
    source, target = directed[order].T

    # The last neighbor of a corner is followed by the first.
    following = np.arange(1, len(source) + 1)
    _, first, count = np.unique(source, return_index=True, return_counts=True)
    last = first + count - 1
    following[last] = first
    next_target = target[following]
    return np.stack([source, target, next_target], 1)

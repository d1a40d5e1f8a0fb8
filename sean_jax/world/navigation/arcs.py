"""Straight segments and corner arcs: the parts of a disc's shortest paths past boxes that are inflated by its radius.

Inflated boxes have straight sides and a quarter of a circle at each corner. A shortest path of the disc is a chain of
common tangents of these quarters and of the parts of quarters between them. So a corner arc is a corner, the side on
which the path passes it, and the part of its quarter that no other obstacle covers. A place on an arc is defined by its
angle from the middle of the quarter, which grows in the direction of travel.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax.core.data_types import FAR, Array, Obstacles
from sean_jax.core.geometry import crosses_box, from_box, length
from sean_jax.core.padding import in_programs

ANGLE = 0.02  # rad, by which a tangent may touch beyond the end of an arc: at 0.25 m that is 0.05 mm off it
NEAR = 1e-8  # m2, a tangent with a smaller square counts as one without length
SLACK = 5e-4  # m, by which a path may pass nearer than the radius: far above rounding in float32, too little to matter
PART = 32  # obstacles
BATCHES = 512, 2048, 8192  # rows computed at once on the host


@struct.dataclass
class CornerArcs:
    """V corner arcs, two for each corner: passed on the left, counter-clockwise, and on the right."""

    corner: Float[Array, "V 2"] = struct.field(metadata={"pad": FAR})  # m, of an obstacle
    # unit vector from the corner to the middle of its quarter
    middle: Float[Array, "V 2"] = struct.field(metadata={"pad": (1.0, 0.0)})
    # 1 if the corner is on the left, -1 if it is on the right
    side: Float[Array, "V"] = struct.field(metadata={"pad": 1.0})
    first: Float[Array, "V"] = struct.field(metadata={"pad": 9.0})  # rad, where the free part begins
    last: Float[Array, "V"] = struct.field(metadata={"pad": -9.0})  # rad, where it ends


class Tangents(NamedTuple):
    """Tangents between a place and each of V arcs."""

    length: Float[Array, "V"]  # m
    angle: Float[Array, "V"]  # rad, where they touch
    x: Float[Array, "V"]  # m, there
    y: Float[Array, "V"]  # m, there
    on_arc: Bool[Array, "V"]  # whether that is on the free part of the arc


class Tangent(NamedTuple):
    """The tangent from a place to one arc."""

    angle: Float[Array, ""]  # rad, where it touches
    on_arc: Bool[Array, ""]  # whether that is on the free part of the arc
    point: Float[Array, "2"]  # m, there
    direction: Float[Array, "2"]  # unit vector of travel there


def tangents(arcs: CornerArcs, place: Float[Array, "2"], radius: Float[Array, ""], arriving: bool) -> Tangents:
    """The tangents between a place [m] and all arcs, for a disc of a radius [m].

    From inside a circle the tangent starts at the nearest point on the circle, and has no length. With ``arriving``
    the travel is from the place to the arcs, else from the arcs to the place.
    """
    cx = arcs.corner[:, 0]
    cy = arcs.corner[:, 1]
    dx = place[0] - cx
    dy = place[1] - cy
    distance = length(dx, dy)
    square = distance * distance - radius * radius  # of the tangent's length
    inside = square < NEAR
    root = jnp.sqrt(jnp.where(inside, 1.0, square))
    tangent = jnp.where(inside, 0.0, root)

    # The normal (nx, ny) from the corner to where the tangent touches: radius and tangent are the legs of a triangle.
    leg = arcs.side * tangent if arriving else -arcs.side * tangent
    scale = 1.0 / jnp.maximum(distance * jnp.maximum(distance, radius), NEAR)
    nx = scale * (radius * dx - leg * dy)
    ny = scale * (radius * dy + leg * dx)

    angle = arcs.side * _angle_to(arcs.middle[:, 0], arcs.middle[:, 1], nx, ny)
    on_arc = (angle >= arcs.first - ANGLE) & (angle <= arcs.last + ANGLE)
    x = cx + radius * nx
    y = cy + radius * ny
    return Tangents(tangent, angle, x, y, on_arc)


def tangent_to_arc(
    arcs: CornerArcs, index: Int[Array, ""], place: Float[Array, "2"], radius: Float[Array, ""]
) -> Tangent:
    """The tangent from a place [m] to one arc, for a disc of a radius [m]."""
    arc = jax.tree.map(lambda field: field[index][None], arcs)
    _, angle, x, y, on_arc = tangents(arc, place, radius, True)
    point = jnp.concatenate([x, y])
    out = point - arc.corner[0]
    scale = arc.side[0] / jnp.maximum(length(out[0], out[1]), 1e-6)
    direction = scale * jnp.stack([-out[1], out[0]])
    return Tangent(angle[0], on_arc[0], point, direction)


def _angle_to(mx: Array, my: Array, nx: Array, ny: Array) -> Array:
    """(V,) rad from unit vectors (mx, my) to (nx, ny), counter-clockwise: exact up to 1 rad; larger ones stay above 1.

    It uses the tangent of a quarter of the angle, because an arc tangent takes XLA on a CPU 20 times longer.
    """
    cross = mx * ny - my * nx
    dot = mx * nx + my * ny
    half = cross / jnp.maximum(1.0 + dot, 1e-3)  # tangent of half the angle
    quarter = half / (1.0 + jnp.sqrt(1.0 + half * half))
    square = quarter * quarter
    return 4.0 * quarter * (1.0 + square * (-1 / 3 + square * (1 / 5 + square * (-1 / 7 + square / 9))))


def segment_is_free(
    boxes: Obstacles, start: Float[Array, "2"], end: Float[Array, "2"], radius: Float[Array, ""] | float
) -> Bool[Array, ""]:
    """Whether a disc of a radius [m] can move straight from one place [m] to another; exact."""
    return segments_are_free(boxes, start, end[0], end[1], radius)


def segments_are_free(
    boxes: Obstacles,
    start: Float[Array, "2"],
    x: Float[Array, "*V"],
    y: Float[Array, "*V"],
    radius: Float[Array, ""] | float,
) -> Bool[Array, "*V"]:
    """``segment_is_free`` between one place [m] and several others (x, y) [m]."""
    crosses_boxes = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))
    hit = crosses_boxes(start[0], start[1], x, y, boxes, radius)  # (W, V)
    return ~_any(hit)  # over the first axis: several times faster on a CPU than over the last


def _any(hit: Bool[Array, "W *rest"]) -> Bool[Array, "*rest"]:
    """``hit.any(0)``, in parts: XLA for GPUs compiles a reduction over more for minutes, if the batch is large."""
    result = jnp.zeros(hit.shape[1:], bool)
    for start in range(0, hit.shape[0], PART):
        result = jnp.logical_or(result, hit[start : start + PART].any(0))
    return result


def push_out_of_obstacles(
    boxes: Obstacles, place: Float[Array, "2"], radius: Float[Array, ""] | float
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Move a place [m] out of the boxes inflated by a radius [m], in which the tables know no path.

    Returns:
        (2,) m the place itself, or the nearest place outside, with the gradient of the place. And () m the radius with
        which segments from there have to be free, which is smaller where there is too little room.
    """
    if boxes.yaw.shape[0] == 0:
        return place, jnp.full_like(place[0], jnp.maximum(radius - SLACK, 0.0))
    from_boxes = jax.vmap(from_box, in_axes=(None, None, 0))

    # Out of the nearest box, and then out of one that is nearest there.
    spot = place
    for _ in range(2):
        distance, nx, ny = from_boxes(spot[0], spot[1], boxes)  # (W,)
        nearest = jnp.argmin(distance)
        out = jnp.maximum(radius - distance[nearest], 0.0)
        spot = spot + out * jnp.stack([nx[nearest], ny[nearest]])
    distance, _, _ = from_boxes(spot[0], spot[1], boxes)
    clearance = jnp.min(distance, initial=jnp.inf)
    free_radius = jnp.maximum(jnp.minimum(radius, clearance) - SLACK, 0.0)

    # Without the barrier XLA computes the spot again for each pair of a point and a box, and compiles for minutes.
    fixed = jax.lax.stop_gradient((spot - place, free_radius))
    shift, free_radius = jax.lax.optimization_barrier(fixed)
    return place + shift, free_radius


def pairs_are_free(
    boxes: Obstacles, radius: float, starts: Float[np.ndarray, "K 2"], ends: Float[np.ndarray, "K 2"]
) -> Bool[np.ndarray, "K"]:
    """``segment_is_free`` for many pairs [m], on the host."""
    shared = in_programs(boxes), jnp.asarray(radius, float)
    return map_in_batches(_pair_is_free, shared, starts, ends)


def _pair_is_free(shared: tuple[Obstacles, Array], start: Array, end: Array) -> Array:
    boxes, radius = shared
    return segment_is_free(boxes, start, end, radius)


def map_in_batches(function: Callable, shared: PyTree, *rows: np.ndarray) -> PyTree:
    """``function(shared, *row)`` of each of many rows, batch by batch, as numpy arrays (K, ...).

    It is compiled once for all numbers of rows, if the function is at module level.
    """
    rows = tuple(row.astype(float) if row.dtype.kind == "f" else row for row in rows)  # jit casts to its precision
    results = []
    for start in range(0, max(len(rows[0]), 1), BATCHES[-1]):
        batch = [row[start : start + BATCHES[-1]] for row in rows]
        results.append(_map_batch(function, shared, batch))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)


def _map_batch(function: Callable, shared: PyTree, batch: list[np.ndarray]) -> PyTree:
    """The results of a batch, padded to the next size for which the function is compiled."""
    count = len(batch[0])
    size = next(size for size in BATCHES if size >= count)
    padded = [np.pad(rows, [(0, size - count)] + [(0, 0)] * (rows.ndim - 1)) for rows in batch]
    results = _map(function, shared, *padded)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:count], results)


@functools.partial(jax.jit, static_argnums=0)
def _map(function: Callable, shared: PyTree, *rows: Array) -> PyTree:
    return jax.vmap(lambda *row: function(shared, *row))(*rows)

"""Corner arcs: the rounded corners of inflated obstacles, each in one direction of travel.

Boxes inflated by a disc have straight sides and a quarter of a circle at each corner. A shortest path of the disc is a
chain of common tangents of these quarters and of the parts of quarters between them. So a corner arc is a corner, the
side on which the path passes it, and the part of its quarter that no other obstacle covers. A place on an arc is given
by its angle from the middle of the quarter, which grows in the direction of travel.
"""

from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array, Environment
from sean_jax.geometry import length
from sean_jax.navigation.segments import SLACK

SAMPLES = 91  # sampled places on a quarter of a circle, one each degree
ANGLE = 0.02  # rad, by which a tangent may touch beyond the end of an arc: at 0.25 m that is 0.05 mm off it
NEAR = 1e-8  # m2, a tangent with a smaller square counts as one without length


@struct.dataclass
class CornerArcs:
    """V corner arcs: first those passed on the left, counter-clockwise, then those passed on the right."""

    corner: Float[Array, "V 2"]  # m, of an obstacle
    middle: Float[Array, "V 2"]  # unit vector from the corner to the middle of its quarter
    side: Float[Array, "V"]  # 1 if the corner is on the left, -1 if it is on the right
    first: Float[Array, "V"]  # rad, where the free part begins
    last: Float[Array, "V"]  # rad, where it ends


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
    """The tangents between a place and all arcs.

    From inside a circle the tangent is that of the nearest point on the circle, and has no length.

    Args:
        place: (2,) m.
        radius: m, of the disc.
        arriving: whether the travel is from the place to the arcs, or from the arcs to the place.
    """
    cx, cy = arcs.corner[:, 0], arcs.corner[:, 1]
    dx, dy = place[0] - cx, place[1] - cy
    away = length(dx, dy)
    beyond = away * away - radius * radius
    touches = beyond < NEAR
    straight = jnp.where(touches, 0.0, jnp.sqrt(jnp.where(touches, 1.0, beyond)))
    turn = arcs.side * straight if arriving else -arcs.side * straight
    scale = 1.0 / jnp.maximum(away * jnp.maximum(away, radius), NEAR)
    nx, ny = scale * (radius * dx - turn * dy), scale * (radius * dy + turn * dx)
    angle = arcs.side * _angle_to(arcs.middle[:, 0], arcs.middle[:, 1], nx, ny)
    on_arc = (angle >= arcs.first - ANGLE) & (angle <= arcs.last + ANGLE)
    return Tangents(straight, angle, cx + radius * nx, cy + radius * ny, on_arc)


def tangent_to_arc(
    arcs: CornerArcs, index: Int[Array, ""], place: Float[Array, "2"], radius: Float[Array, ""]
) -> Tangent:
    """The tangent from a place to one arc.

    Args:
        place: (2,) m.
        radius: m, of the disc.
    """
    one = jax.tree.map(lambda part: part[index][None], arcs)
    _, angle, x, y, on_arc = tangents(one, place, radius, True)
    point = jnp.concatenate([x, y])
    out = point - one.corner[0]
    scale = one.side[0] / jnp.maximum(length(out[0], out[1]), 1e-6)
    return Tangent(angle[0], on_arc[0], point, scale * jnp.stack([-out[1], out[0]]))


def _angle_to(mx: Array, my: Array, nx: Array, ny: Array) -> Array:
    """(V,) rad from unit vectors (mx, my) to (nx, ny), counter-clockwise: exact up to 1 rad; larger ones stay above 1.

    It uses the tangent of a quarter of the angle, because an arc tangent takes XLA on a CPU 20 times longer.
    """
    cross, dot = mx * ny - my * nx, mx * nx + my * ny
    half = cross / jnp.maximum(1.0 + dot, 1e-3)
    quarter = half / (1.0 + jnp.sqrt(1.0 + half * half))
    square = quarter * quarter
    return 4.0 * quarter * (1.0 + square * (-1 / 3 + square * (1 / 5 + square * (-1 / 7 + square / 9))))


def find_arcs(environment: Environment, radius: float) -> CornerArcs:
    """Find the corner arcs of an environment, on the host.

    Args:
        radius: m, of the disc.

    Returns:
        The arcs, as numpy arrays of float64; if there are none, one that no path can use.
    """
    boxes = environment.obstacles
    center, half, yaw = (np.asarray(part, float) for part in (boxes.center, boxes.half_extent, boxes.yaw))
    floor = np.asarray(environment.floor, float)
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    corner = (center[:, None] + _rotated(half[:, None] * signs, yaw[:, None])).reshape(-1, 2)
    middle = _rotated(np.broadcast_to(signs / np.sqrt(2), (len(yaw), 4, 2)), yaw[:, None]).reshape(-1, 2)

    def free(index: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Whether the disc is clear at these angles, counter-clockwise, of the circles about those corners."""
        place = corner[index] + radius * _rotated(middle[index], angle)
        u, v = np.moveaxis(_rotated(place[..., None, :] - center, -yaw), -1, 0)
        over = np.hypot(np.maximum(np.abs(u) - half[:, 0], 0.0), np.maximum(np.abs(v) - half[:, 1], 0.0))
        to_edge = np.minimum(place - floor[:2], floor[2:] - place).min(-1)
        return np.minimum(over.min(-1, initial=np.inf), to_edge) >= radius - 1e-6

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
        "corner": np.concatenate([corner[where]] * 2),
        "middle": np.concatenate([middle[where]] * 2),
        "side": np.repeat([1.0, -1.0], len(where)),
        "first": np.concatenate([low, -high]),
        "last": np.concatenate([high, -low]),
    }
    return CornerArcs(**cast(dict[str, Any], parts))  # numpy's float64, until the tables are complete


class CommonTangents(NamedTuple):
    """K straight segments from arc to arc that touch both circles, in float64."""

    source: np.ndarray  # (K,) int, the arc that they leave
    target: np.ndarray  # (K,) int, the arc that they enter
    length: np.ndarray  # (K,) m
    departure_angle: np.ndarray  # (K,) rad, where they leave
    arrival_angle: np.ndarray  # (K,) rad, where they enter
    begin: np.ndarray  # (K, 2) m
    end: np.ndarray  # (K, 2) m


def common_tangents(arcs: CornerArcs, radius: float) -> CommonTangents:
    """The segments from arc to arc that touch both circles, whatever obstacles are in between.

    Args:
        radius: m, of the disc.
    """
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

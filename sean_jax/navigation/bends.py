"""Bends: the rounded corners of grown obstacles, where alone a shortest path can turn, each in one direction of travel.

Boxes grown by a disc have straight sides and a quarter of a circle at each corner. A shortest path of the disc is a
chain of common tangents of these quarters, and of arcs of them in between. So a bend is a corner, a side on which it
is passed, and the part of its quarter that no other obstacle covers. Places on it are told by the angle from its
middle, which grows in the direction of travel.
"""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax.base import Array, Environment
from sean_jax.geometry import length
from sean_jax.navigation.sight import SLACK

SAMPLES = 91  # places on a quarter of a circle that are looked at, one each degree
ANGLE = 0.02  # rad, by which a tangent may touch beyond the end of an arc: at 0.25 m that is 0.05 mm off it
NEAR = 1e-8  # m2, the square of a tangent that is taken to have no length


@struct.dataclass
class Bends:
    """V bends: all of them passed on the left, that is counter-clockwise, then all of them passed on the right."""

    corner: Array  # (V, 2) m, of an obstacle
    middle: Array  # (V, 2) unit vector from the corner to the middle of its quarter
    side: Array  # (V,) 1 if the corner is on the left, -1 if it is on the right
    first: Array  # (V,) rad, where the free part begins
    last: Array  # (V,) rad, where it ends


def tangents(bends: Bends, place: Array, radius: Array, arriving: bool) -> tuple[Array, ...]:
    """The tangents from a place (2,) [m] to the bends, or if not ``arriving`` from the bends to it.

    (V,) lengths [m], (V,) angles [rad] where they touch, (V,) and (V,) x and y [m] there, and (V,) bool whether that is
    on the bends. From inside a circle the tangent is that of the nearest point on it, with no length.
    """
    cx, cy = bends.corner[:, 0], bends.corner[:, 1]
    dx, dy = place[0] - cx, place[1] - cy
    away = length(dx, dy)
    beyond = away * away - radius * radius
    touches = beyond < NEAR
    straight = jnp.where(touches, 0.0, jnp.sqrt(jnp.where(touches, 1.0, beyond)))
    turn = bends.side * straight if arriving else -bends.side * straight
    scale = 1.0 / jnp.maximum(away * jnp.maximum(away, radius), NEAR)
    nx, ny = scale * (radius * dx - turn * dy), scale * (radius * dy + turn * dx)
    angle = bends.side * _angle_to(bends.middle[:, 0], bends.middle[:, 1], nx, ny)
    on = (angle >= bends.first - ANGLE) & (angle <= bends.last + ANGLE)
    return straight, angle, cx + radius * nx, cy + radius * ny, on


def of_one(bends: Bends, bend: Array, place: Array, radius: Array) -> tuple[Array, ...]:
    """The tangent from a place (2,) [m] to one bend () int32.

    () rad where it touches, () bool whether that is on the bend, (2,) [m] there, and (2,) its direction there.
    """
    one = jax.tree.map(lambda part: part[bend][None], bends)
    _, angle, x, y, on = tangents(one, place, radius, True)
    point = jnp.concatenate([x, y])
    out = point - one.corner[0]
    scale = one.side[0] / jnp.maximum(length(out[0], out[1]), 1e-6)
    return angle[0], on[0], point, scale * jnp.stack([-out[1], out[0]])


def _angle_to(mx: Array, my: Array, nx: Array, ny: Array) -> Array:
    """(V,) rad from the unit vectors (mx, my) to (nx, ny), counter-clockwise: exact up to 1 rad, and above that beyond.

    By the tangent of a quarter of it, for XLA on a CPU takes 20 times longer for an arc tangent.
    """
    cross, dot = mx * ny - my * nx, mx * nx + my * ny
    half = cross / jnp.maximum(1.0 + dot, 1e-3)
    quarter = half / (1.0 + jnp.sqrt(1.0 + half * half))
    square = quarter * quarter
    return 4.0 * quarter * (1.0 + square * (-1 / 3 + square * (1 / 5 + square * (-1 / 7 + square / 9))))


def find(environment: Environment, radius: float) -> Bends:
    """The bends for a disc of that radius [m], as float64 numpy arrays; one that nobody can use if there are none.

    Runs on the host, once.
    """
    boxes = environment.obstacles
    center, half, yaw = (np.asarray(part, float) for part in (boxes.center, boxes.half_extent, boxes.yaw))
    floor = np.asarray(environment.floor, float)
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    corner = (center[:, None] + _turned(half[:, None] * signs, yaw[:, None])).reshape(-1, 2)
    middle = _turned(np.broadcast_to(signs / np.sqrt(2), (len(yaw), 4, 2)), yaw[:, None]).reshape(-1, 2)

    def free(index: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Whether the disc is clear at these angles, counter-clockwise, of the circles about those corners."""
        place = corner[index] + radius * _turned(middle[index], angle)
        u, v = np.moveaxis(_turned(place[..., None, :] - center, -yaw), -1, 0)
        over = np.hypot(np.maximum(np.abs(u) - half[:, 0], 0.0), np.maximum(np.abs(v) - half[:, 1], 0.0))
        to_edge = np.minimum(place - floor[:2], floor[2:] - place).min(-1)
        return np.minimum(over.min(-1, initial=np.inf), to_edge) >= radius - 1e-6

    angles = np.linspace(-np.pi / 4, np.pi / 4, SAMPLES)
    index = np.arange(len(corner))
    clear = np.stack([free(index, np.full(len(corner), angle)) for angle in angles], 1)
    change = np.diff(np.pad(clear, [(0, 0), (1, 1)]).astype(int), axis=1)
    (where, begin), (_, end) = np.nonzero(change == 1), np.nonzero(change == -1)
    ends = []
    for inside, outside in ((begin, begin - 1), (end - 1, end)):  # halving, between a free sample and one that is not
        good, bad = angles[inside], angles[np.clip(outside, 0, SAMPLES - 1)]
        for _ in range(30):
            between = (good + bad) / 2
            is_free = free(where, between)
            good, bad = np.where(is_free, between, good), np.where(is_free, bad, between)
        ends.append(good)
    wide = ends[1] - ends[0] > np.sqrt(SLACK / max(radius, SLACK))  # ways over narrower ones may go straight
    where, low, high = where[wide], ends[0][wide], ends[1][wide]
    if len(where) == 0:
        corner, middle, where = np.zeros((1, 2)), np.array([[1.0, 0.0]]), np.zeros(1, int)
        low, high = np.full(1, 9.0), np.full(1, -9.0)  # a bend that no way touches: the tables must not be empty
    parts = {
        "corner": np.concatenate([corner[where]] * 2),
        "middle": np.concatenate([middle[where]] * 2),
        "side": np.repeat([1.0, -1.0], len(where)),
        "first": np.concatenate([low, -high]),
        "last": np.concatenate([high, -low]),
    }
    return Bends(**cast(dict[str, Any], parts))  # numpy's float64, until the tables are done


def common_tangents(bends: Any, radius: float) -> tuple[np.ndarray, ...]:
    """Straight ways from bend to bend (``Bends`` of numpy arrays) that touch both circles, in float64: K of them.

    (K,) int from which, (K,) int to which bend, (K,) m lengths, (K,) and (K,) rad where they leave and where they
    enter, (K, 2) and (K, 2) m the points there. What is in the way is not looked at.
    """
    gap = bends.corner[None] - bends.corner[:, None]
    far = np.hypot(gap[..., 0], gap[..., 1])
    side, other = bends.side[:, None], bends.side[None, :]
    crossing = side != other
    exists = (far > 1e-6) & (~crossing | (far >= 2 * radius - SLACK))
    tilt = side * np.arcsin(np.minimum(np.where(crossing, 2 * radius, 0.0) / np.maximum(far, 1e-6), 1.0))
    along = _turned(gap / np.maximum(far, 1e-6)[..., None], tilt)
    right = np.stack([along[..., 1], -along[..., 0]], -1)
    leave, enter = (_angle(bends.middle, bends.side, right, axis) for axis in (0, 1))
    for angle, axis in ((leave, 0), (enter, 1)):
        first, last = (np.expand_dims(limit, 1 - axis) for limit in (bends.first, bends.last))
        exists = exists & (angle >= first - ANGLE) & (angle <= last + ANGLE)
    i, j = np.nonzero(exists)
    begin = bends.corner[i] + radius * bends.side[i, None] * right[i, j]
    end = bends.corner[j] + radius * bends.side[j, None] * right[i, j]
    return i, j, np.hypot(*(end - begin).T), leave[i, j], enter[i, j], begin, end


def _turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], -1)


def _angle(middle: np.ndarray, side: np.ndarray, right: np.ndarray, axis: int) -> np.ndarray:
    """(V, V) rad from the middle of the first (axis 0) or second bend to where a way with that right hand touches."""
    middle, side = np.expand_dims(middle, 1 - axis), np.expand_dims(side, 1 - axis)
    normal = side[..., None] * right
    cross = middle[..., 0] * normal[..., 1] - middle[..., 1] * normal[..., 0]
    return side * np.arctan2(cross, (middle * normal).sum(-1))

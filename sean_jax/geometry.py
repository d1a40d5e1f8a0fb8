"""Plane geometry in components, with finite gradients everywhere: lengths, angles, upright boxes.

Functions take scalars (or arrays that broadcast) rather than vectors with a trailing axis of two: on a GPU
the layout decides the speed of a pairwise law.
"""

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Array, Environment, Obstacles

PART = 8192  # places that are measured at once on the host
TINY = 1e-24  # a smaller square counts as zero, for 1 / sqrt(square) ** 3, in gradients, would overflow


def length(x: Array, y: Array) -> Array:
    """Euclidean length of (x, y) [m]; zero, with zero gradient, below 1e-12 m."""
    square = x * x + y * y
    zero = square < TINY
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, square)))


def unit(x: Array, y: Array) -> tuple[Array, Array]:
    """(x, y) divided by its length; (0, 0), with zero gradient, where that is below 1e-12."""
    square = x * x + y * y
    zero = square < TINY
    scale = jnp.where(zero, 0.0, 1.0 / jnp.sqrt(jnp.where(zero, 1.0, square)))
    return x * scale, y * scale


def rotate(x: Array, y: Array, cosine: Array, sine: Array) -> tuple[Array, Array]:
    """(x, y) turned counter-clockwise by the angle with that cosine and sine."""
    return cosine * x - sine * y, sine * x + cosine * y


def sum_vectors(x: Array, y: Array, axis: int) -> tuple[Array, Array]:
    """(x, y) summed along an axis as complex numbers.

    One reduction, into which XLA fuses what makes x and y; two of them would write both to memory first, which
    makes a pairwise law 1.7 times slower on a GPU.
    """
    total = jax.lax.complex(x, y).sum(axis)
    return total.real, total.imag


def unit_vectors(vectors: Array, otherwise: Array) -> Array:
    """(..., 2) vectors scaled to length one; ``otherwise`` (..., 2) where one is shorter than 1e-12."""
    x, y = vectors[..., 0], vectors[..., 1]
    ux, uy = unit(x, y)
    zero = x * x + y * y < TINY
    return jnp.where(zero[..., None], otherwise, jnp.stack([ux, uy], -1))


def angle_between(heading: Array, target: Array) -> Array:
    """Signed angle [rad] in (-pi, pi] from one (..., 2) direction to another, counter-clockwise; 0 if one is zero."""
    cross = heading[..., 0] * target[..., 1] - heading[..., 1] * target[..., 0]
    dot = heading[..., 0] * target[..., 0] + heading[..., 1] * target[..., 1]
    zero = cross * cross + dot * dot < TINY
    return jnp.arctan2(jnp.where(zero, 0.0, cross), jnp.where(zero, 1.0, dot))


def from_box(x: Array, y: Array, box: Obstacles) -> tuple[Array, Array, Array]:
    """Signed distance [m] from an upright box to a point, and the unit normal (nx, ny) that leads away from it.

    Outside, the normal points from the nearest point of the box; inside, where the distance is negative, out of
    the nearest side. ``box`` has fields without a trailing obstacle axis that broadcast with ``x`` and ``y``.
    """
    center, half = box.center, box.half_extent
    return from_rectangle(
        x, y, center[..., 0], center[..., 1], half[..., 0], half[..., 1], jnp.cos(box.yaw), jnp.sin(box.yaw)
    )


def from_rectangle(x, y, cx, cy, hx, hy, cosine, sine) -> tuple[Array, Array, Array]:
    """``from_box`` of the box with that centre, half extent, and cosine and sine of its yaw."""
    u, v = rotate(x - cx, y - cy, cosine, -sine)
    side_u, side_v = jnp.where(u < 0, -1.0, 1.0), jnp.where(v < 0, -1.0, 1.0)
    over_u, over_v = jnp.abs(u) - hx, jnp.abs(v) - hy
    out_u, out_v = jnp.maximum(over_u, 0.0), jnp.maximum(over_v, 0.0)
    square = out_u * out_u + out_v * out_v
    outside = square > TINY
    inverse = jax.lax.rsqrt(jnp.where(outside, square, 1.0))
    by_u = over_u > over_v
    nu = jnp.where(outside, out_u * inverse, jnp.where(by_u, 1.0, 0.0)) * side_u
    nv = jnp.where(outside, out_v * inverse, jnp.where(by_u, 0.0, 1.0)) * side_v
    distance = jnp.where(outside, square * inverse, jnp.maximum(over_u, over_v))
    return distance, *rotate(nu, nv, cosine, sine)


def room(environment: Environment, points: Array) -> tuple[Array, Array]:
    """(P,) signed distance [m] from each of the points (P, 2) [m] to the nearest obstacle, and to the floor's edge."""
    x, y = points[:, 0], points[:, 1]
    each_box = jax.vmap(lambda px, py, box: from_box(px, py, box)[0], in_axes=(None, None, 0))
    to_boxes = jax.vmap(each_box, in_axes=(0, 0, None))(x, y, environment.obstacles)  # (P, W) m
    return jnp.min(to_boxes, axis=1, initial=jnp.inf), to_edge(environment, x, y)


def room_on_host(environment: Environment, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As ``room``, in double precision and by numpy: nothing is compiled for what is asked once."""
    points, floor = np.asarray(points, float), np.asarray(environment.floor, float)
    boxes = environment.obstacles
    center, half, yaw = (np.asarray(part, float) for part in (boxes.center, boxes.half_extent, boxes.yaw))
    cosine, sine = np.cos(yaw), np.sin(yaw)
    to_box = []
    for part in np.array_split(points, max(1, len(points) // PART)):
        x, y = part[:, None, 0] - center[:, 0], part[:, None, 1] - center[:, 1]
        u, v = np.abs(cosine * x + sine * y) - half[:, 0], np.abs(cosine * y - sine * x) - half[:, 1]
        away = np.hypot(np.maximum(u, 0.0), np.maximum(v, 0.0)) + np.minimum(np.maximum(u, v), 0.0)
        to_box.append(away.min(1, initial=np.inf))
    return np.concatenate(to_box), np.minimum(points - floor[:2], floor[2:] - points).min(1)


def to_edge(environment: Environment, x: Array, y: Array) -> Array:
    """Signed distance [m] from places (x, y) [m] to the nearest edge of the floor, of their shape; negative off it."""
    x_min, y_min, x_max, y_max = environment.floor
    return jnp.minimum(jnp.minimum(x - x_min, x_max - x), jnp.minimum(y - y_min, y_max - y))


def to_border(environment: Environment, x: Array, y: Array) -> Array:
    """As ``to_edge``, but infinite where the floor is open: distance [m] to what holds people and robots there."""
    return jnp.full_like(x, jnp.inf) if environment.open else to_edge(environment, x, y)


def crosses_box(px: Array, py: Array, qx: Array, qy: Array, box: Obstacles, radius: Array | float) -> Array:
    """True where a disc of that radius [m], moved straight from p to q, cuts the box; touching is not cutting.

    Exact, by separating axes: what is nearest to each other is an end of the way and a point of the box, or a corner
    of the box and a point between the ends, so that one of three directions tells the distance.
    """
    cosine, sine = jnp.cos(box.yaw), jnp.sin(box.yaw)
    hu, hv = box.half_extent[..., 0], box.half_extent[..., 1]
    pu, pv = rotate(px - box.center[..., 0], py - box.center[..., 1], cosine, -sine)
    qu, qv = rotate(qx - box.center[..., 0], qy - box.center[..., 1], cosine, -sine)
    du, dv = qu - pu, qv - pv
    square = du * du + dv * dv
    over = jnp.abs(qu * dv - qv * du) - hu * jnp.abs(dv) - hv * jnp.abs(du)
    beside = (square > 0.0) & (over >= radius * jnp.sqrt(square))
    return ~(beside | _ahead_of(pu, pv, qu, qv, hu, hv, radius) | _ahead_of(qu, qv, pu, pv, hu, hv, radius))


def _ahead_of(pu, pv, qu, qv, hu, hv, radius) -> Array:
    """Whether p and q are both that far from the rectangle |u| < hu, |v| < hv in the direction from it to p."""
    nu, nv = jnp.clip(pu, -hu, hu), jnp.clip(pv, -hv, hv)
    ou, ov = pu - nu, pv - nv
    square = ou * ou + ov * ov
    enough = radius * jnp.sqrt(square)
    return (square > 0.0) & (square >= enough) & ((qu - nu) * ou + (qv - nv) * ov >= enough)

"""One ray and one body: how far along the ray the body is hit (section IV-F).

Written for one pair in components, as forces are; arrays broadcast. The ray leaves the origin along the unit vector
``(dx, dy, dz)``; ``q`` leads from the ray's origin to the middle of the body. Distances are in metres, ``MISS`` where
there is no hit ahead. Every law has finite gradients, on grazing rays too.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array

MISS = 1e9  # m
STEEP = 1e-9  # a component of a direction below it counts as that much

# A person as a ray sees one: an upright capsule that stands on the floor, and a round head.
SHOULDER = 1.26  # m above the floor, the middle of the capsule's upper end
HEAD = 1.60  # m, the middle of the head
HEAD_RADIUS = 0.13  # m


def box(qx, qy, qz, hx, hy, hz, cosine, sine, dx, dy, dz, inverse_dz) -> Array:
    """Distance to an upright box with that half extent, turned about z by the angle of that cosine and sine."""
    iu, iv = inverse(cosine * dx + sine * dy), inverse(cosine * dy - sine * dx)
    at_u, at_v, at_z = (cosine * qx + sine * qy) * iu, (cosine * qy - sine * qx) * iv, qz * inverse_dz
    in_u, in_v, in_z = hx * jnp.abs(iu), hy * jnp.abs(iv), hz * jnp.abs(inverse_dz)
    near = jnp.maximum(jnp.maximum(at_u - in_u, at_v - in_v), at_z - in_z)
    far = jnp.minimum(jnp.minimum(at_u + in_u, at_v + in_v), at_z + in_z)
    return jnp.where((near <= far) & (near > 0.0), near, MISS)


def sphere(qx, qy, qz, radius, dx, dy, dz) -> Array:
    """Distance to a sphere, from outside of it."""
    middle = qx * dx + qy * dy + qz * dz
    px, py, pz = qx - middle * dx, qy - middle * dy, qz - middle * dz
    return _enter(radius * radius - (px * px + py * py + pz * pz), middle)


def legs(qx, qy, qz, radius, dx, dy, dz, inverse_flat) -> Array:
    """Distance to a person up to the shoulders, whose feet are at ``q``; all that a ray meets that does not rise there.

    ``inverse_flat`` is 1 / (dx2 + dy2), 0 for a vertical ray.
    """
    middle = (qx * dx + qy * dy) * inverse_flat
    px, py = qx - middle * dx, qy - middle * dy
    square = radius * radius - (px * px + py * py)
    touches = (square > 0.0) & (inverse_flat > 0.0)
    side = middle - root(jnp.where(touches, square * inverse_flat, 1.0))
    return jnp.where(touches & (side > 0.0) & (side * dz - qz <= SHOULDER), side, MISS)


def person(qx, qy, qz, radius, dx, dy, dz, inverse_flat) -> Array:
    """Distance to a person whose feet are at ``q``: ``legs``, shoulders and head."""
    rounded = jnp.minimum(
        sphere(qx, qy, qz + SHOULDER, radius, dx, dy, dz), sphere(qx, qy, qz + HEAD, HEAD_RADIUS, dx, dy, dz)
    )
    return jnp.minimum(legs(qx, qy, qz, radius, dx, dy, dz, inverse_flat), rounded)


def cylinder(qx, qy, qz, ax, ay, az, radius, half, dx, dy, dz) -> Array:
    """Distance to a cylinder with flat ends about the unit axis ``a``, half as long as ``half`` says."""
    along_d, along_q = ax * dx + ay * dy + az * dz, ax * qx + ay * qy + az * qz
    fx, fy, fz = dx - along_d * ax, dy - along_d * ay, dz - along_d * az
    gx, gy, gz = qx - along_q * ax, qy - along_q * ay, qz - along_q * az
    flat = fx * fx + fy * fy + fz * fz
    inverse_flat = jnp.where(flat > 1e-12, 1.0 / jnp.where(flat > 1e-12, flat, 1.0), 0.0)
    middle = (gx * fx + gy * fy + gz * fz) * inverse_flat
    px, py, pz = gx - middle * fx, gy - middle * fy, gz - middle * fz
    square = radius * radius - (px * px + py * py + pz * pz)
    touches = square > 0.0
    chord = root(jnp.where(touches & (inverse_flat > 0.0), square * inverse_flat, 1.0))
    # Along the axis: a slab, as in a box. A ray along the axis is inside the round for ever.
    ends = inverse(along_d)
    deep = jnp.where(inverse_flat > 0.0, chord, MISS)
    near = jnp.maximum(middle - deep, along_q * ends - half * jnp.abs(ends))
    far = jnp.minimum(middle + deep, along_q * ends + half * jnp.abs(ends))
    return jnp.where(touches & (near <= far) & (near > 0.0), near, MISS)


def ground(height, dz, inverse_dz) -> Array:
    """Distance to the floor from ``height`` above it."""
    return jnp.where(dz < 0.0, -height * inverse_dz, MISS)


def _enter(square: Array, middle: Array) -> Array:
    touches = square > 0.0
    distance = middle - root(jnp.where(touches, square, 1.0))
    return jnp.where(touches & (distance > 0.0), distance, MISS)


def root(square: Array) -> Array:
    """Square root of a positive number: on a GPU this way takes a third of the time."""
    return square * jax.lax.rsqrt(square)


def inverse(value: Array) -> Array:
    """1 / value, of 1e-9 for what is nearer to zero; as fast as ``root``."""
    value = jnp.where(jnp.abs(value) < STEEP, STEEP, value)
    size = jax.lax.rsqrt(value * value)
    return jnp.where(value < 0.0, -size, size)

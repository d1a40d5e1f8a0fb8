"""The predicates of section III-A as printed: on positions, orientations and velocities of two agents.

Vectors are (2,) arrays in one frame; each predicate gives a () bool. Orientations need not have unit length.
"""

import jax.numpy as jnp

from sean_jax.base import Array


def near(x1: Array, x2: Array, distance: Array) -> Array:
    """Near(x1, x2): the positions are separated by less than D [m]."""
    gap = x1 - x2
    return (gap * gap).sum() < distance * distance


def member(group_of_agent: Array, group: Array) -> Array:
    """Member(x, g): the agent with that () int32 group index belongs to the group g; index -1 is no group."""
    return (group >= 0) & (group_of_agent == group)


def walking(velocity: Array, speed: Array) -> Array:
    """Walking(v): the agent moves at more than V [m/s]."""
    return (velocity * velocity).sum() > speed * speed


def perpendicular_trajectory(d1: Array, d2: Array, angle: Array) -> Array:
    """PerpTraj(d1, d2): cos(pi/2 + A) <= d1 . d2 / (|d1| |d2|) <= cos(pi/2 - A), A in rad."""
    cosine = _cosine(d1, d2)
    return (jnp.cos(jnp.pi / 2 + angle) <= cosine) & (cosine <= jnp.cos(jnp.pi / 2 - angle))


def parallel_trajectory(d1: Array, d2: Array, angle: Array) -> Array:
    """ParTraj(d1, d2): cos(A) <= d1 . d2 / (|d1| |d2|), A in rad."""
    return jnp.cos(angle) <= _cosine(d1, d2)


def _cosine(d1: Array, d2: Array) -> Array:
    """Cosine of the angle between two vectors; -2, so that no predicate holds, if one of them is zero."""
    square = (d1 * d1).sum() * (d2 * d2).sum()
    zero = square == 0.0
    return jnp.where(zero, -2.0, (d1 * d2).sum() / jnp.sqrt(jnp.where(zero, 1.0, square)))

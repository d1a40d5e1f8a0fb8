"""The predicates of section III-A as printed: on positions, orientations and velocities of two agents.

Vectors are (2,) arrays in one frame; each predicate gives a () bool. Orientations need not have unit length.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Moment, Pedestrians
from sean_jax.geometry import TINY


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
    between = cosine(d1, d2)
    return (jnp.cos(jnp.pi / 2 + angle) <= between) & (between <= jnp.cos(jnp.pi / 2 - angle))


def parallel_trajectory(d1: Array, d2: Array, angle: Array) -> Array:
    """ParTraj(d1, d2): cos(A) <= d1 . d2 / (|d1| |d2|), A in rad."""
    return jnp.cos(angle) <= cosine(d1, d2)


def cosine(d1: Array, d2: Array) -> Array:
    """Cosine of the angle between two vectors; -2, so that no predicate holds, if one of them is zero (to 1e-12)."""
    square = (d1 * d1).sum() * (d2 * d2).sum()
    zero = square < TINY
    return jnp.where(zero, -2.0, (d1 * d2).sum() / jnp.sqrt(jnp.where(zero, 1.0, square)))


def ahead_and_aside(heading: Array, offset: Array) -> tuple[Array, Array]:
    """Parts of an offset (2,) [m] along a unit heading (2,) and to its left [m]."""
    ahead = heading[0] * offset[0] + heading[1] * offset[1]
    return ahead, heading[0] * offset[1] - heading[1] * offset[0]


def any_person(moment: Moment, holds: Callable[[Pedestrians], Array]) -> Array:
    """() bool: whether ``holds`` is true of anybody present; it takes one person, fields without the axis N."""
    return (jax.vmap(holds)(moment.people) & moment.people.present).any()

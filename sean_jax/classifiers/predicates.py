"""The predicates of section III-A as printed: on positions, orientations and velocities of two agents.

Vectors are (2,) arrays in one frame; each predicate gives a () bool. Orientations need not have unit length.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, Pedestrians, Snapshot
from sean_jax.core.geometry import TINY

Scalar = Float[Array, ""] | float


def near(x1: Float[Array, "2"], x2: Float[Array, "2"], distance: Scalar) -> Bool[Array, ""]:
    """Near(x1, x2): the positions [m] are separated by less than D [m]."""
    gap = x1 - x2
    return (gap * gap).sum() < distance * distance


def member(group_of_agent: Int[Array, ""], group: Int[Array, ""]) -> Bool[Array, ""]:
    """Member(x, g): the agent belongs to the group g; nobody belongs to group -1."""
    return (group >= 0) & (group_of_agent == group)


def walking(velocity: Float[Array, "2"], speed: Scalar) -> Bool[Array, ""]:
    """Walking(v): the agent moves at more than V [m/s]."""
    return (velocity * velocity).sum() > speed * speed


def perpendicular_trajectory(d1: Float[Array, "2"], d2: Float[Array, "2"], angle: Scalar) -> Bool[Array, ""]:
    """PerpTraj(d1, d2): cos(pi/2 + A) <= d1 . d2 / (|d1| |d2|) <= cos(pi/2 - A), with A in rad."""
    between = cosine(d1, d2)
    return (jnp.cos(jnp.pi / 2 + angle) <= between) & (between <= jnp.cos(jnp.pi / 2 - angle))


def parallel_trajectory(d1: Float[Array, "2"], d2: Float[Array, "2"], angle: Scalar) -> Bool[Array, ""]:
    """ParTraj(d1, d2): cos(A) <= d1 . d2 / (|d1| |d2|), with A in rad."""
    return jnp.cos(angle) <= cosine(d1, d2)


def cosine(d1: Float[Array, "2"], d2: Float[Array, "2"]) -> Float[Array, ""]:
    """Cosine of the angle between two vectors; -2, so that no predicate holds, if one of them is zero (to 1e-12)."""
    square = (d1 * d1).sum() * (d2 * d2).sum()
    zero = square < TINY
    product = (d1 * d2).sum()
    lengths = jnp.sqrt(jnp.where(zero, 1.0, square))
    return jnp.where(zero, -2.0, product / lengths)


def ahead_and_aside(heading: Float[Array, "2"], offset: Float[Array, "2"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Parts of an offset [m] along a heading and to its left."""
    ahead = heading[0] * offset[0] + heading[1] * offset[1]
    aside = heading[0] * offset[1] - heading[1] * offset[0]
    return ahead, aside


def any_person(snapshot: Snapshot, holds: Callable[[Pedestrians], Array]) -> Bool[Array, ""]:
    """Whether a predicate of a person, ``Pedestrians`` without the axis N, holds for at least one present person."""
    people = snapshot.people
    holds_for_person = jax.vmap(holds)(people)  # (N,)
    return (holds_for_person & people.present).any()

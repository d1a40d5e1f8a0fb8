"""Gradients over long horizons: what may be done to the derivative that a state carries from step to step.

Crowds are chaotic: who passes whom on which side depends on centimetres, and derivatives grow with the time that they
are carried. These functions leave the state as it is and change the derivative of what moves in it: positions,
velocities and headings of people, and the robot. They are given to rollouts as ``between``, or stand in a user's own
scan. Traits of people, goals and constants outside of the state keep their derivatives. docs/gradients.md measures what
each does to a gradient.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Float, PyTree

from sean_jax.base import Array, State
from sean_jax.social_forces.linear import linear_call

MOVING = ("position", "velocity", "heading", "desired_velocity")  # of people


def truncate(state: State, every: int) -> State:
    """Ends the derivative at each ``every``-th step: backpropagation through that many steps, block by block.

    Returns:
        The same state.
    """
    return damp(state, jnp.where(state.tick % every == 0, 0.0, 1.0))


def damp(state: State, factor: Float[Array, ""] | float) -> State:
    """Multiplies the derivative by a factor: what lies n steps back counts ``factor ** n``.

    Args:
        factor: 1, between 0 and 1; at 0 the derivative ends here.

    Returns:
        The same state.
    """
    return _with_moving(
        state, jax.tree.map(lambda leaf: _scaled(leaf, jnp.asarray(factor, leaf.dtype)), _moving(state))
    )


def clip(state: State, limit: Float[Array, ""] | float) -> State:
    """Shortens the cotangent of each body to a length, in reverse mode; forward mode is as without.

    Args:
        limit: of the length, over all that moves of one person, or of the robot; of the unit of what is differentiated
            per metre.

    Returns:
        The same state.
    """
    moving = _moving(state)
    return _with_moving(state, linear_call(_same, _clipped, jnp.asarray(limit, float), moving, moving))


def _moving(state: State) -> tuple[list[Array], list[Array]]:
    """The leaves (N, ...) of people and (...) of the robot that move."""
    people = [getattr(state.pedestrians, name) for name in MOVING]
    return people, [leaf for leaf in jax.tree.leaves(state.robot) if _is_float(leaf)]


def _with_moving(state: State, moving: tuple[list[Array], list[Array]]) -> State:
    people, robot = moving
    leaves, structure = jax.tree.flatten(state.robot)
    rest = iter(robot)
    leaves = [next(rest) if _is_float(leaf) else leaf for leaf in leaves]
    pedestrians = replace(state.pedestrians, **dict(zip(MOVING, people, strict=True)))
    return replace(state, pedestrians=pedestrians, robot=structure.unflatten(leaves))


def _is_float(leaf: Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jnp.floating)


@jax.custom_jvp
def _scaled(leaf: Array, factor: Array) -> Array:
    return leaf


@_scaled.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    leaf, factor = primals
    return leaf, jnp.where(factor == 0.0, 0.0, factor * tangents[0])  # infinity ends too


def _same(limit: Array, moving: PyTree) -> PyTree:
    return moving


def _clipped(limit: Array, cotangents: tuple[list[Array], list[Array]]) -> tuple[list[Array], list[Array]]:
    people, robot = cotangents
    square = jnp.stack([jnp.square(leaf).reshape(leaf.shape[0], -1).sum(1) for leaf in people]).sum(0)
    scale = _shorter(square, limit)
    by_person = [leaf * scale.reshape(-1, *[1] * (leaf.ndim - 1)) for leaf in people]
    scale = _shorter(jnp.stack([jnp.square(leaf).sum() for leaf in robot]).sum(0), limit)
    return by_person, [leaf * scale for leaf in robot]


def _shorter(square: Array, limit: Array) -> Array:
    """The factor that shortens vectors with these squared lengths to the limit; 0 for those beyond all numbers."""
    over = square > limit * limit
    return jnp.where(over, limit * jax.lax.rsqrt(jnp.where(over, square, 1.0)), 1.0)

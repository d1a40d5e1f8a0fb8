"""Gradients over long horizons: truncate, damp or clip the derivative that a state carries from step to step.

Crowds are chaotic: on which side people pass depends on centimetres, and derivatives grow with the horizon. These
functions return the same state and change the derivative of its moving parts: positions, velocities and headings of
people, and the robot. Use them as ``between`` of rollouts, or in your own scan. Traits of people, goals and constants
outside of the state keep their derivatives. docs/gradients.md measures the effect of each.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Float, PyTree

from sean_jax.base import Array, State
from sean_jax.social_forces.linear import linear_call

MOVING = ("position", "velocity", "heading", "desired_velocity")  # of people


def truncate(state: State, every: int) -> State:
    """Ends the derivative at each ``every``-th step: truncated backpropagation through blocks of steps."""
    return damp(state, jnp.where(state.tick % every == 0, 0.0, 1.0))


def damp(state: State, factor: Float[Array, ""] | float) -> State:
    """Multiplies the derivative by a factor from 0 to 1: n steps back it is ``factor ** n``; 0 ends it here."""
    return _with_moving(
        state, jax.tree.map(lambda leaf: _scaled(leaf, jnp.asarray(factor, leaf.dtype)), _moving(state))
    )


def clip(state: State, limit: Float[Array, ""] | float) -> State:
    """Shortens the cotangent of each person and of the robot, in reverse mode; forward mode is unchanged.

    Args:
        limit: maximum length of the cotangent of all moving parts of a body, in units of the loss per metre.
    """
    moving = _moving(state)
    return _with_moving(state, linear_call(_same, _clipped, jnp.asarray(limit, float), moving, moving))


def _moving(state: State) -> tuple[list[Array], list[Array]]:
    """The moving leaves (N, ...) of people and (...) of the robot."""
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
    """The factor that shortens vectors with these squared lengths to the limit; 0 for infinite ones."""
    over = square > limit * limit
    return jnp.where(over, limit * jax.lax.rsqrt(jnp.where(over, square, 1.0)), 1.0)

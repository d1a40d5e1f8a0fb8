"""Pedestrian models (section IV-D, low level) by name: how people move to the goals of their behavior."""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from sean_jax import social_forces
from sean_jax.core.data_types import Array, Pedestrians
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length, unit
from sean_jax.people.constant_velocity import constant_velocity
from sean_jax.people.orca import orca

PREFERRED_SPEED = 1.34  # m/s, Helbing & Molnar, Phys. Rev. E 51, 4282 (1995)


MODELS = {"social_forces": social_forces.move, "constant_velocity": constant_velocity, "orca": orca}
"""name -> (scenario, state) -> Pedestrians one control step later"""


def pedestrians_at(
    position: Float[Array, "N 2"],
    velocity: Float[Array, "N 2"] | None = None,
    *,
    goal: Float[Array, "N 2"] | Float[Array, "2"] | None = None,
    desired_velocity: Float[Array, "N 2"] | None = None,
    preferred_speed: Float[Array, "N"] | Float[Array, ""] | float | None = None,
    heading: Float[Array, "N 2"] | None = None,
    present: Bool[Array, "N"] | None = None,
) -> Pedestrians:
    """People at these positions, in no group, each walking alone. To direct them later, replace ``desired_velocity``.

    People with a goal desire to walk straight to it at their preferred speed; people without one keep their velocity.

    Args:
        position: m.
        velocity: m/s; the desired velocity if None.
        goal: m, or (2,) one for all; excludes ``desired_velocity``.
        desired_velocity: m/s.
        preferred_speed: m/s, or one for all; if None, the speed of ``desired_velocity``, and 1.34 for people with a
            goal or who stand (top speed is a multiple of it, so 0 would freeze them).
        heading: unit vectors; if None, along the velocity, else along the desired one, else (1, 0).
        present: all if None.

    Raises:
        InputError: both a goal and a desired velocity are given.
    """
    if goal is not None and desired_velocity is not None:
        raise InputError("goal: a desired velocity is given as well; give one of the two.")
    position = jnp.asarray(position, float)
    number = position.shape[0]
    if goal is not None:
        speed = PREFERRED_SPEED if preferred_speed is None else preferred_speed
        preferred_speed = jnp.broadcast_to(jnp.asarray(speed, float), (number,))
        gap = jnp.asarray(goal, float).reshape(-1, 2) - position
        desired = jnp.stack(unit(gap[:, 0], gap[:, 1]), -1) * preferred_speed[:, None]
    else:
        desired = velocity if desired_velocity is None else desired_velocity
        desired = jnp.zeros_like(position) if desired is None else jnp.asarray(desired, float)

    velocity = desired if velocity is None else jnp.asarray(velocity, float)
    if preferred_speed is None:
        speed = length(desired[:, 0], desired[:, 1])
        preferred_speed = jnp.where(speed > 0.0, speed, PREFERRED_SPEED)
    heading = _heading_along(velocity, desired) if heading is None else jnp.asarray(heading, float)
    return Pedestrians(
        position=position,
        velocity=velocity,
        heading=heading,
        desired_velocity=desired,
        group=jnp.full(number, -1, jnp.int32),
        walking_group=jnp.full(number, -1, jnp.int32),
        present=jnp.ones(number, bool) if present is None else jnp.asarray(present, bool),
        preferred_speed=jnp.broadcast_to(jnp.asarray(preferred_speed, float), (number,)),
        robot_distance=jnp.zeros(number, float),
    )


def _heading_along(velocity: Float[Array, "N 2"], desired: Float[Array, "N 2"]) -> Float[Array, "N 2"]:
    """Unit vectors along the velocity, or else the desired one, or else (1, 0)."""
    moves = (velocity != 0.0).any(-1)[:, None]
    along = jnp.where(moves, velocity, desired)
    exists = (along != 0.0).any(-1)[:, None]
    along = jnp.where(exists, along, jnp.asarray([[1.0, 0.0]], float))
    return jnp.stack(unit(along[:, 0], along[:, 1]), -1)

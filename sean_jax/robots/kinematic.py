"""The kinematic robot: speed and turn rate are what the command says, as in SEAN 2.0, whose robots have no inertia.

SEAN sets the velocity of the robot's body in each step of physics, and bodies in its way stop it. Here the way is the
arc of these speeds in closed form, and contacts are those of the other robots (``ground.touching``).
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, RobotModel
from sean_jax.geometry import from_box, rotate
from sean_jax.robots.ground import Surroundings, touching

OVERLAP = 1e-4  # m, how deep a robot may press into an obstacle; a step that would go deeper is not made


class Way(NamedTuple):
    """Where a robot is after a control step, and how it moves there."""

    position: Float[Array, "2"]  # m
    speed: Float[Array, ""]  # m/s along its heading: less than commanded where something is in the way
    sideways: Float[Array, ""]  # m/s to the left: what a contact adds


def move(
    steps: int,
    model: RobotModel,
    surroundings: Surroundings,
    position: Float[Array, "2"],
    heading: Float[Array, "2"],
    speed: Float[Array, ""],
    turn_rate: Float[Array, ""],
) -> Way:
    """The way of a control step at a constant speed and turn rate.

    Args:
        position: (2,) m, at its start.
        heading: (2,) unit vector, there.
        speed: () m/s.
        turn_rate: () rad/s.

    Returns:
        Where it leads. Without contacts that is the arc of these speeds.
    """
    make = jax.checkpoint(functools.partial(_move, steps), prevent_cse=False)  # reverse mode computes it again
    return make(model, surroundings, position, heading, speed, turn_rate)


def _move(
    steps: int,
    model: RobotModel,
    surroundings: Surroundings,
    position: Array,
    heading: Array,
    speed: Array,
    turn_rate: Array,
) -> Way:
    turn = model.time_step * turn_rate  # rad in a step of physics
    chord = speed * jnp.sinc(turn / (2.0 * jnp.pi))  # m/s, along the straight line between the ends of its arc

    def one(carry: tuple[Way, Array], index: Array) -> tuple[tuple[Way, Array], None]:
        (place, _, _), gap = carry
        angle = (index + 0.5) * turn
        cosine, sine = rotate(heading[0], heading[1], jnp.cos(angle), jnp.sin(angle))
        vx, vy = chord * cosine, chord * sine
        ux, uy = touching(model, surroundings, model.time_step * (steps - index), place, vx, vy)
        there = place + model.time_step * jnp.stack([ux, uy])
        left = _gap(model, surroundings, there)
        free = left >= jnp.minimum(gap, -OVERLAP)
        along, across = rotate(ux - vx, uy - vy, cosine, -sine)
        along, across = jnp.where(free, speed + along, 0.0), jnp.where(free, across, 0.0)
        return (Way(jnp.where(free, there, place), along, across), jnp.where(free, left, gap)), None

    begin = Way(position, speed, jnp.zeros_like(speed)), _gap(model, surroundings, position)
    return jax.lax.scan(one, begin, jnp.arange(steps).astype(position.dtype))[0][0]


def _gap(model: RobotModel, surroundings: Surroundings, place: Array) -> Array:
    """() m to the nearest obstacle, negative inside, without a gradient; infinite if there is none."""
    x, y = jax.lax.stop_gradient((place[0], place[1]))
    boxes = jax.lax.stop_gradient(surroundings.obstacles)
    return from_box(x, y, boxes)[0].min(initial=jnp.inf) - model.radius

"""The space of an observation or an action: a box of numbers; actions from -1 to 1 as commands.

An action of 0 is rest; 1 and -1 are the robot's top speeds ahead and backward.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, RobotModel
from sean_jax.robots.drive import max_reverse_speed


class Box(NamedTuple):
    """Arrays of one shape whose numbers lie within bounds."""

    low: float
    high: float
    shape: tuple[int, ...]


def to_command(robot: RobotModel, action: Float[Array, "2"]) -> Float[Array, "2"]:
    """The command (2,) [m/s, rad/s] of an action (2,), clipped to -1 to 1."""
    ahead, turn = jnp.clip(action[0], -1.0, 1.0), jnp.clip(action[1], -1.0, 1.0)
    top = jnp.where(ahead >= 0.0, robot.max_speed, max_reverse_speed(robot))
    return jnp.stack([ahead * top, turn * robot.max_turn_rate])


def to_action(robot: RobotModel, command: Float[Array, "2"]) -> Float[Array, "2"]:
    """The action (2,) from -1 to 1 of a command (2,) [m/s, rad/s]; the inverse of ``to_command``."""
    top = jnp.where(command[0] >= 0.0, robot.max_speed, max_reverse_speed(robot))
    action = jnp.stack([command[0] / jnp.maximum(top, 1e-6), command[1] / jnp.maximum(robot.max_turn_rate, 1e-6)])
    return jnp.clip(action, -1.0, 1.0)

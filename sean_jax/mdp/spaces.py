"""The space of an observation or an action: a box of numbers; actions from -1 to 1 as commands.

An action of 0 is rest; 1 and -1 are the robot's top speeds ahead and backward. The second number of a car's action is
the steering angle, which it holds at rest; its commands have turn rates, as those of other robots.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, RobotModel
from sean_jax.robots import ackermann
from sean_jax.robots.drive import command_size, max_reverse_speed


class Box(NamedTuple):
    """Arrays of one shape whose numbers lie within bounds."""

    low: float
    high: float
    shape: tuple[int, ...]


def action_space(robot: RobotModel) -> Box:
    """The actions of a robot from -1 to 1: (3,) of an omnidirectional one, else (2,)."""
    return Box(-1.0, 1.0, (command_size(robot),))


def to_command(robot: RobotModel, action: Float[Array, "command"]) -> Float[Array, "command"]:
    """The command [m/s, rad/s] of an action, clipped to -1 to 1."""
    ahead = jnp.clip(action[0], -1.0, 1.0)
    turn = jnp.clip(action[-1], -1.0, 1.0)
    top = jnp.where(ahead >= 0.0, robot.max_speed, max_reverse_speed(robot))
    speed = ahead * top
    if robot.lateral is not None:
        left = jnp.clip(action[1], -1.0, 1.0) * robot.lateral.max_speed
        return jnp.stack([speed, left, turn * robot.max_turn_rate])
    if robot.steering is not None:
        angle = turn * robot.steering.max_angle
        turn_rate = ackermann.turn_rate_of(robot, speed, angle)
    else:
        turn_rate = turn * robot.max_turn_rate
    return jnp.stack([speed, turn_rate])


def to_action(robot: RobotModel, command: Float[Array, "command"]) -> Float[Array, "command"]:
    """The action from -1 to 1 of a command [m/s, rad/s]; the inverse of ``to_command``."""
    top = jnp.where(command[0] >= 0.0, robot.max_speed, max_reverse_speed(robot))
    if robot.lateral is not None:
        tops = jnp.stack([top, robot.lateral.max_speed, robot.max_turn_rate])
        return jnp.clip(command / jnp.maximum(tops, 1e-6), -1.0, 1.0)
    if robot.steering is not None:
        angle = ackermann.steering_angle(robot, command[0], command[1], jnp.zeros_like(command[0]))
        ahead = command[0] / jnp.maximum(top, 1e-6)
        turn = angle / robot.steering.max_angle
    else:
        ahead = command[0] / jnp.maximum(top, 1e-6)
        turn = command[1] / jnp.maximum(robot.max_turn_rate, 1e-6)
    return jnp.clip(jnp.stack([ahead, turn]), -1.0, 1.0)

"""Actions from -1 to 1 as commands of a robot: 0 is rest, 1 and -1 its top speeds ahead and backward."""

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, RobotModel
from sean_jax.robots.limits import max_reverse_speed


def to_command(robot: RobotModel, action: Float[Array, "2"]) -> Float[Array, "2"]:
    """The command that an action stands for.

    Args:
        action: (2,) of the speed and of the turn rate, from -1 to 1; clipped to that.

    Returns:
        (2,) m/s, rad/s.
    """
    ahead, turn = jnp.clip(action[0], -1.0, 1.0), jnp.clip(action[1], -1.0, 1.0)
    top = jnp.where(ahead >= 0.0, robot.max_speed, max_reverse_speed(robot))
    return jnp.stack([ahead * top, turn * robot.max_turn_rate])


def to_action(robot: RobotModel, command: Float[Array, "2"]) -> Float[Array, "2"]:
    """The action that stands for a command; the inverse of ``to_command``.

    Args:
        command: (2,) m/s, rad/s.

    Returns:
        (2,) from -1 to 1.
    """
    top = jnp.where(command[0] >= 0.0, robot.max_speed, max_reverse_speed(robot))
    action = jnp.stack([command[0] / jnp.maximum(top, 1e-6), command[1] / jnp.maximum(robot.max_turn_rate, 1e-6)])
    return jnp.clip(action, -1.0, 1.0)

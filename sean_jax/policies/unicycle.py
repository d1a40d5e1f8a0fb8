"""What a planner believes of a robot (Fig. 3): commands within its limits, and where it gets by them.

The closed-form twin without what planners avoid: contact, and wheels that slip.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Array, RobotModel
from sean_jax.geometry import rotate


def constant(value: float) -> Any:
    """() a setting, which becomes an array of the default precision where it is used: it is made at import."""
    return np.asarray(value, float)


def backward(model: RobotModel) -> Array:
    """() m/s, the top speed backward."""
    return model.max_speed if model.max_reverse_speed is None else model.max_reverse_speed


def limited(model: RobotModel, speed: Array, turn: Array, command: tuple[Array, Array], time_step: float) -> tuple:
    """Speed and turn rate a ``time_step`` [s] after these ones and a command, all [m/s] and [rad/s], elementwise."""
    fall = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    change = model.max_turn_acceleration * time_step
    ahead = jnp.clip(command[0], speed - fall * time_step, speed + model.max_acceleration * time_step)
    ahead = jnp.clip(ahead, -backward(model), model.max_speed)
    rate = jnp.clip(command[1], turn - change, turn + change)
    return ahead, jnp.clip(rate, -model.max_turn_rate, model.max_turn_rate)


def roll(model: RobotModel, speed: Array, turn: Array, commands: tuple[Array, Array], time_step: float) -> tuple:
    """Where commands (T, P) [m/s] and (T, P) [rad/s] lead from speed and turn rate () [m/s], [rad/s].

    Five (T, P) in the robot's frame of now, after each ``time_step`` [s]: x, y [m], yaw [rad], speed [m/s] and turn
    rate [rad/s]. Chords of arcs: the heading of a step is that of its middle.
    """
    start = jnp.full(commands[0].shape[1:], speed), jnp.full(commands[1].shape[1:], turn)

    def change(now: tuple, command: tuple) -> tuple[tuple, tuple]:
        after = limited(model, now[0], now[1], command, time_step)
        return after, after

    _, (ahead, rate) = jax.lax.scan(change, start, commands)
    turned = time_step * rate
    yaw = jnp.cumsum(turned, axis=0)
    middle = yaw - 0.5 * turned
    x = jnp.cumsum(time_step * ahead * jnp.cos(middle), axis=0)
    y = jnp.cumsum(time_step * ahead * jnp.sin(middle), axis=0)
    return x, y, yaw, ahead, rate


def over_ground(position: Array, heading: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Places x, y [m] in the frame of a robot at (2,) [m] with heading (2,) as places on the floor."""
    gx, gy = rotate(x, y, heading[0], heading[1])
    return position[0] + gx, position[1] + gy

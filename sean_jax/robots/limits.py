"""A robot's limits (Fig. 3): top speeds, and speeds that it can reach in one step.

As in the controllers of ROS, deceleration limits the fall of the speed along the heading, in braking and in speeding
up backward.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, RobotModel


class Reach(NamedTuple):
    """The speeds that a robot can reach in one step, before its top speeds are taken into account."""

    speed_min: Float[Array, "..."]  # m/s
    speed_max: Float[Array, "..."]  # m/s
    turn_rate_min: Float[Array, "..."]  # rad/s
    turn_rate_max: Float[Array, "..."]  # rad/s


def max_reverse_speed(model: RobotModel) -> Float[Array, ""]:
    """Top speed backward [m/s], positive; the top speed ahead if the robot has no other backward."""
    return model.max_speed if model.max_reverse_speed is None else model.max_reverse_speed


def reachable(
    model: RobotModel, speed: Float[Array, "*shape"], turn_rate: Float[Array, "*shape"], time_step: float
) -> Reach:
    """The speeds that the limits of acceleration allow one step [s] after a speed [m/s] and a turn rate [rad/s]."""
    fall = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    change = model.max_turn_acceleration * time_step
    return Reach(
        speed - fall * time_step, speed + model.max_acceleration * time_step, turn_rate - change, turn_rate + change
    )


def clip_speeds(
    model: RobotModel, speed: Float[Array, "*shape"], turn_rate: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Clip speeds [m/s] and turn rates [rad/s] to the robot's maxima."""
    return jnp.clip(speed, -max_reverse_speed(model), model.max_speed), clip_turn_rate(model, turn_rate)


def clip_turn_rate(model: RobotModel, turn_rate: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Clip turn rates [rad/s] to the robot's maximum."""
    return jnp.clip(turn_rate, -model.max_turn_rate, model.max_turn_rate)


def limit_command(
    model: RobotModel,
    speed: Float[Array, "*shape"],
    turn_rate: Float[Array, "*shape"],
    command: tuple[Float[Array, "*shape"], Float[Array, "*shape"]],
    time_step: float,
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Speed [m/s] and turn rate [rad/s] within all limits that are nearest to a command, after one step [s]."""
    reach = reachable(model, speed, turn_rate, time_step)
    ahead = jnp.clip(command[0], reach.speed_min, reach.speed_max)
    turn = jnp.clip(command[1], reach.turn_rate_min, reach.turn_rate_max)
    return clip_speeds(model, ahead, turn)

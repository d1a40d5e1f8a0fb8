"""Robots steered by a velocity: the point that moves in any direction, its velocity to the goal, and its command.

The middle of an axle cannot move in any direction, but a point ahead of it can: J. Snape, J. van den Berg, S. J. Guy &
D. Manocha, "Smooth and collision-free navigation for multiple robots under differential-drive constraints" (IROS 2010)
steer that point. An omnidirectional robot is steered at its middle. No such point of a car at rest can move sideways.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Observation, Robot, RobotModel, Scenario
from sean_jax.core.geometry import angle_between, length
from sean_jax.robots.drive import clip_speeds, clip_turn_rate, max_reverse_speed

POINT = 0.6  # of the radius: distance of the point ahead of the axle
TURN_GAIN = 2.0  # 1/s
DEVIATION = 0.3  # rad, of the direction that a standing robot wishes: two that meet head-on would stand forever
GOAL_TOLERANCE = 0.1  # m from the goal, where it turns to the goal's heading
BRAKING = 0.5  # m from the goal, where it begins to slow down


def point_ahead(model: RobotModel, robot: Robot) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """How far ahead [m] of the robot's middle the point is, and its velocity [m/s] ahead and to the left."""
    if robot.sideways is not None:
        return jnp.zeros_like(robot.speed), robot.speed, robot.sideways
    lever = jnp.asarray(POINT * model.radius, robot.speed.dtype)
    return lever, robot.speed, lever * robot.turn_rate


def top_speed(model: RobotModel, observation: Observation) -> Float[Array, ""]:
    """The robot's top speed [m/s] in all directions, or less near the goal."""
    share = jnp.clip(length(observation.goal[0], observation.goal[1]) / BRAKING, 0.0, 1.0)
    max_speed = model.max_speed
    if model.lateral is not None:
        max_speed = jnp.minimum(max_speed, model.lateral.max_speed)
    return share * max_speed


def turn_toward(model: RobotModel, direction: Float[Array, "2"]) -> Float[Array, ""]:
    """The turn rate [rad/s] toward a direction in the robot's frame."""
    return clip_turn_rate(model, TURN_GAIN * angle_between(_ahead(), direction))


def bearing(model: RobotModel, robot: Robot, observation: Observation, key: Array) -> Float[Array, ""]:
    """The direction [rad] of the shortest path in the robot's frame; the slower it is, the more the key turns it."""
    slowness = 1.0 - jnp.clip(jnp.abs(robot.speed) / model.max_speed, 0.0, 1.0)
    to_path = angle_between(_ahead(), observation.path)
    return to_path + DEVIATION * slowness * jax.random.normal(key, (), float)


def follow(
    scenario: Scenario, robot: Robot, observation: Observation, x: Float[Array, ""], y: Float[Array, ""]
) -> Float[Array, "command"]:
    """The command [m/s, rad/s] that moves the point at (x, y) [m/s], ahead and to the left; ``arrive`` at the goal."""
    model = scenario.robot
    if model.lateral is None:
        lever, _, _ = point_ahead(model, robot)
        return arrive(scenario, observation, jnp.stack(clip_speeds(model, x, y / lever)))
    max_lateral_speed = model.lateral.max_speed
    ahead = jnp.clip(x, -max_reverse_speed(model), model.max_speed)
    left = jnp.clip(y, -max_lateral_speed, max_lateral_speed)
    return arrive(scenario, observation, jnp.stack([ahead, left, turn_toward(model, observation.path)]))


def arrive(scenario: Scenario, observation: Observation, command: Float[Array, "command"]) -> Float[Array, "command"]:
    """The command [m/s, rad/s], or at the goal the turn on the spot to its heading."""
    arrived = length(observation.goal[0], observation.goal[1]) < GOAL_TOLERANCE
    turn = turn_toward(scenario.robot, observation.goal_heading)
    return jnp.where(arrived, jnp.zeros_like(command).at[-1].set(turn), command)


def _ahead() -> Array:
    return jnp.asarray([1.0, 0.0], float)

"""go_to_goal: pure pursuit of the shortest path around obstacles, giving way to people."""

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import angle_between, length
from sean_jax.robots.drive import clip_turn_rate
from sean_jax.scenario import observe

TURN_GAIN = 2.0  # 1/s
STOP_DISTANCE = 0.55  # m between centers, at which the robot stands behind people
SLOW_DISTANCE = 1.2  # m, from where it slows down
PASSING_DISTANCE = 0.7  # m, by which it passes beside a person in its way
GOAL_TOLERANCE = 0.1  # m from the goal, where it turns to the goal's heading


def go_to_goal(scenario: Scenario, state: State, key: Array) -> Float[Array, "2"]:
    """Drives along the shortest path around obstacles, giving way to people.

    The robot aims at the next corner of the path or, if a person is near in that direction, beside the person on the
    nearer side. It drives as fast as the free distance ahead allows, and turns on the spot where there is none. The
    command is (2,) [m/s, rad/s]; the key is not used.
    """
    observation = observe(scenario, state)
    to_path = length(observation.path[0], observation.path[1])
    bearing = jnp.arctan2(observation.path[1], jnp.where(to_path > 0.0, observation.path[0], 1.0))

    distance = length(observation.people[:, 0], observation.people[:, 1])
    direction = jnp.arctan2(observation.people[:, 1], jnp.where(distance > 0.0, observation.people[:, 0], 1.0))
    off = _wrap(direction - bearing)
    span = _half_width(distance)
    in_way = observation.people_present & (distance < jnp.minimum(2.0, to_path + 0.3)) & (jnp.abs(off) < span)
    aim = bearing
    if in_way.shape[0]:
        nearest = jnp.argmin(jnp.where(in_way, distance, jnp.inf))
        side = jnp.where(off[nearest] > 0.0, -1.0, 1.0)
        aside = direction[nearest] + side * span[nearest]
        aim = _wrap(jnp.where(in_way.any(), aside, bearing))

    ahead = observation.people_present & (jnp.abs(direction) < jnp.pi / 3)
    closing = jnp.maximum(-observation.people_velocity[:, 0], 0.0)  # approaching people need more distance
    free = jnp.min(jnp.where(ahead, distance - STOP_DISTANCE - 0.3 * closing, SLOW_DISTANCE), initial=SLOW_DISTANCE)
    share = jnp.clip(free / (SLOW_DISTANCE - STOP_DISTANCE), 0.0, 1.0) * jnp.clip(jnp.cos(aim), 0.0, 1.0)
    speed = (
        scenario.robot.max_speed * share * jnp.clip(length(observation.goal[0], observation.goal[1]) / 0.5, 0.0, 1.0)
    )

    arrived = length(observation.goal[0], observation.goal[1]) < GOAL_TOLERANCE
    forward = jnp.asarray([1.0, 0.0], float)
    turn = jnp.where(arrived, angle_between(forward, observation.goal_heading), aim)
    return jnp.stack([jnp.where(arrived, 0.0, speed), clip_turn_rate(scenario.robot, TURN_GAIN * turn)])


def _half_width(distance: Array) -> Array:
    """Half the angle [rad] of a disc of radius ``PASSING_DISTANCE`` at a distance [m]; inside, pi / 2."""
    beyond = distance * distance - PASSING_DISTANCE * PASSING_DISTANCE
    outside = beyond > 0.0
    return jnp.where(outside, jnp.arctan2(PASSING_DISTANCE, jnp.sqrt(jnp.where(outside, beyond, 1.0))), 0.5 * jnp.pi)


def _wrap(angle: Array) -> Array:
    """The angle [rad] in [-pi, pi)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi

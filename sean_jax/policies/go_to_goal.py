"""go_to_goal: pure pursuit of the shortest path around obstacles, giving way to people."""

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Observation, Scenario, State
from sean_jax.core.geometry import angle_between, from_rectangle, length, nearby_obstacles
from sean_jax.robots import ackermann
from sean_jax.robots.drive import clip_turn_rate, max_reverse_speed
from sean_jax.simulation.scenario import observe

TURN_GAIN = 2.0  # 1/s
STOP_DISTANCE = 0.55  # m between centers, at which the robot stands behind people
SLOW_DISTANCE = 1.2  # m, from where it slows down
PASSING_DISTANCE = 0.7  # m, by which it passes beside a person in its way
GOAL_TOLERANCE = 0.1  # m from the goal, where it turns to the goal's heading

# Of a car, which cannot turn on the spot:
LATERAL_ACCELERATION = 1.5  # m/s2, in a curve
LOOK_AHEAD = 0.4  # m, shortest distance of pure pursuit
BEHIND, AHEAD = 1.9, 0.8  # rad, bearings at which it begins and ends to back up
OUTSIDE = 1.2  # share of the turning circle, outside which a place has to be to end backing up
WALL_GAP, FREE_GAP = 0.1, 0.5  # m, gaps to a wall at which it changes its direction, and at which it may drive on
TOWARD_WALL = 0.3  # cosine between its direction and the way to a wall, at least


def go_to_goal(scenario: Scenario, state: State, key: Array) -> Float[Array, "command"]:
    """Drives along the shortest path around obstacles, giving way to people.

    The robot aims at the next corner of the path or, if a person is near in that direction, beside the person on the
    nearer side. It drives as fast as the free distance ahead allows, and turns on the spot where there is none. An
    omnidirectional robot drives in that direction and turns on the way. A car backs up while that place is behind it or
    inside its turning circle, and stops at half the goal's radius, whatever its heading. The command is in m/s and
    rad/s; the key is not used.
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

    if scenario.robot.lateral is not None:
        return _omnidirectional(scenario, observation, direction, aim)
    if scenario.robot.steering is not None:
        return _car(scenario, state, observation, direction, aim)

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


def _omnidirectional(scenario: Scenario, observation: Observation, direction: Array, aim: Array) -> Array:
    """The command (3,) of a robot that drives at the angle ``aim`` [rad], with people in these directions [rad]."""
    model, lateral = scenario.robot, scenario.robot.lateral
    assert lateral is not None
    to_goal = length(observation.goal[0], observation.goal[1])
    top = jnp.minimum(model.max_speed, lateral.max_speed) * jnp.clip(to_goal / 0.5, 0.0, 1.0)
    speed = top * _free_share(observation, direction, aim)
    arrived = to_goal < GOAL_TOLERANCE
    speed = jnp.where(arrived, 0.0, speed)
    turn = jnp.where(arrived, angle_between(jnp.asarray([1.0, 0.0], float), observation.goal_heading), aim)
    return jnp.stack([speed * jnp.cos(aim), speed * jnp.sin(aim), clip_turn_rate(model, TURN_GAIN * turn)])


def _car(scenario: Scenario, state: State, observation: Observation, direction: Array, aim: Array) -> Array:
    """The command (2,) of a car: pure pursuit ahead, and back with the other lock while the place is out of reach.

    Source: pure pursuit is R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", 1992.
    """
    model, steering = scenario.robot, ackermann.steering(scenario.robot)
    circle = steering.wheelbase / jnp.tan(steering.max_angle)  # m, radius of the rear axle's sharpest turn
    away = length(observation.path[0], observation.path[1])
    x, y = away * jnp.cos(aim) + steering.rear_axle, away * jnp.sin(aim)  # from the rear axle
    distance = length(x, y)
    bearing = jnp.arctan2(y, jnp.where(distance > 0.0, x, 1.0))
    sine = jnp.sin(bearing)

    backing = state.robot.drive_state.command[0] < 0.0
    begin = (jnp.abs(bearing) > BEHIND) | (distance < 2.0 * circle * jnp.abs(sine))
    end = (jnp.abs(bearing) < AHEAD) & (distance > 2.0 * OUTSIDE * circle * jnp.abs(sine))
    front, rear = _gaps(scenario, state)
    back = jnp.where(backing, ~end | (front < FREE_GAP), begin | (front < WALL_GAP))
    back = back & (rear > jnp.where(backing, WALL_GAP, FREE_GAP))

    curvature = jnp.clip(2.0 * sine / jnp.maximum(distance, LOOK_AHEAD), -1.0 / circle, 1.0 / circle)
    curvature = jnp.where(back, -jnp.sign(bearing) / circle, curvature)
    bend = jnp.sqrt(LATERAL_ACCELERATION / jnp.maximum(jnp.abs(curvature), 1e-3))
    to_goal = length(observation.goal[0], observation.goal[1])
    ahead = jnp.minimum(model.max_speed * jnp.clip(to_goal / 1.0, 0.2, 1.0), bend)
    ahead = ahead * _free_share(observation, direction, jnp.zeros_like(aim))
    reverse = jnp.minimum(max_reverse_speed(model), bend) * _free_share(
        observation, direction, jnp.full_like(aim, jnp.pi)
    )
    speed = jnp.where(back, -reverse, ahead)
    speed = jnp.where(to_goal < 0.5 * scenario.goal_radius, 0.0, speed)
    return jnp.stack([speed, speed * curvature])


def _gaps(scenario: Scenario, state: State) -> tuple[Array, Array]:
    """Gaps [m] between the robot's disc and the nearest obstacle in front of it and behind it."""
    (x, y), heading = state.robot.position, state.robot.heading
    rows = nearby_obstacles(scenario.environment.obstacle_grid, x, y)
    distance, nx, ny = from_rectangle(x, y, *(rows[:, part] for part in range(6)))
    gap, toward = distance - scenario.robot.radius, nx * heading[0] + ny * heading[1]
    front = jnp.min(jnp.where(toward < -TOWARD_WALL, gap, jnp.inf), initial=jnp.inf)
    return front, jnp.min(jnp.where(toward > TOWARD_WALL, gap, jnp.inf), initial=jnp.inf)


def _free_share(observation: Observation, direction: Array, way: Array) -> Array:
    """Share of the speed that people leave on a way at that angle [rad]; they are in these directions [rad]."""
    near = observation.people_present & (jnp.abs(_wrap(direction - way)) < jnp.pi / 3)
    distance = length(observation.people[:, 0], observation.people[:, 1])
    velocity = observation.people_velocity
    closing = jnp.maximum(-(velocity[:, 0] * jnp.cos(way) + velocity[:, 1] * jnp.sin(way)), 0.0)
    free = jnp.min(jnp.where(near, distance - STOP_DISTANCE - 0.3 * closing, SLOW_DISTANCE), initial=SLOW_DISTANCE)
    return jnp.clip(free / (SLOW_DISTANCE - STOP_DISTANCE), 0.0, 1.0)


def _half_width(distance: Array) -> Array:
    """Half the angle [rad] of a disc of radius ``PASSING_DISTANCE`` at a distance [m]; inside, pi / 2."""
    beyond = distance * distance - PASSING_DISTANCE * PASSING_DISTANCE
    outside = beyond > 0.0
    return jnp.where(outside, jnp.arctan2(PASSING_DISTANCE, jnp.sqrt(jnp.where(outside, beyond, 1.0))), 0.5 * jnp.pi)


def _wrap(angle: Array) -> Array:
    """The angle [rad] in [-pi, pi)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi

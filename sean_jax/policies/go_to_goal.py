"""go_to_goal: pure pursuit of the shortest path around obstacles, giving way to people."""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from sean_jax.core.data_types import Array, Observation, Scenario, State
from sean_jax.core.geometry import angle_between, length
from sean_jax.policies.obstacles import obstacle_distances
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
    direction, aim = _aim(observation)
    if scenario.robot.lateral is not None:
        return _omnidirectional(scenario, observation, direction, aim)
    if scenario.robot.steering is not None:
        return _car(scenario, state, observation, direction, aim)
    return _differential(scenario, observation, direction, aim)


def _aim(observation: Observation) -> tuple[Array, Array]:
    """Directions (N,) [rad] of the people, and the direction () [rad] in which to drive: the path, or beside a person.

    All of them in the robot's frame.
    """
    path = observation.path
    to_corner = length(path[0], path[1])
    bearing = jnp.arctan2(path[1], jnp.where(to_corner > 0.0, path[0], 1.0))

    people_x = observation.people[:, 0]
    people_y = observation.people[:, 1]
    distance = length(people_x, people_y)  # (N,)
    direction = jnp.arctan2(people_y, jnp.where(distance > 0.0, people_x, 1.0))

    # A person is in the way if the disc to pass around hides the bearing.
    offset = _wrap(direction - bearing)
    half_width = _half_width(distance)
    reach = jnp.minimum(2.0, to_corner + 0.3)
    is_near = observation.people_present & (distance < reach)
    in_way = is_near & (jnp.abs(offset) < half_width)
    if not len(in_way):
        return direction, bearing

    # The nearest of them is passed on the side where the bearing is.
    nearest = jnp.argmin(jnp.where(in_way, distance, jnp.inf))
    side = jnp.where(offset[nearest] > 0.0, -1.0, 1.0)
    beside_person = direction[nearest] + side * half_width[nearest]
    aim = jnp.where(in_way.any(), beside_person, bearing)
    return direction, _wrap(aim)


def _differential(
    scenario: Scenario, observation: Observation, direction: Float[Array, "N"], aim: Float[Array, ""]
) -> Float[Array, "2"]:
    """The command of a robot that turns toward ``aim`` [rad], with people in these directions [rad]."""
    model = scenario.robot
    is_ahead = observation.people_present & (jnp.abs(direction) < jnp.pi / 3)
    distance = length(observation.people[:, 0], observation.people[:, 1])
    closing = jnp.maximum(-observation.people_velocity[:, 0], 0.0)  # approaching people need more distance
    free = _share_of_speed(is_ahead, distance, closing)
    share = free * jnp.clip(jnp.cos(aim), 0.0, 1.0)

    # Slower near the goal, and at rest in it, where the robot turns to the goal's heading.
    to_goal = _to_goal(observation)
    speed = model.max_speed * share * jnp.clip(to_goal / 0.5, 0.0, 1.0)
    arrived = to_goal < GOAL_TOLERANCE
    turn = jnp.where(arrived, _to_goal_heading(observation), aim)
    speed = jnp.where(arrived, 0.0, speed)
    turn_rate = clip_turn_rate(model, TURN_GAIN * turn)
    return jnp.stack([speed, turn_rate])


def _omnidirectional(
    scenario: Scenario, observation: Observation, direction: Float[Array, "N"], aim: Float[Array, ""]
) -> Float[Array, "3"]:
    """The command of a robot that drives at the angle ``aim`` [rad], with people in these directions [rad]."""
    model = scenario.robot
    assert model.lateral is not None
    to_goal = _to_goal(observation)
    limit = jnp.minimum(model.max_speed, model.lateral.max_speed)
    top_speed = limit * jnp.clip(to_goal / 0.5, 0.0, 1.0)
    speed = top_speed * _free_share(observation, direction, aim)

    arrived = to_goal < GOAL_TOLERANCE
    speed = jnp.where(arrived, 0.0, speed)
    turn = jnp.where(arrived, _to_goal_heading(observation), aim)
    ahead = speed * jnp.cos(aim)
    left = speed * jnp.sin(aim)
    turn_rate = clip_turn_rate(model, TURN_GAIN * turn)
    return jnp.stack([ahead, left, turn_rate])


def _to_goal(observation: Observation) -> Array:
    """() m, the distance to the goal."""
    return length(observation.goal[0], observation.goal[1])


def _to_goal_heading(observation: Observation) -> Array:
    """() rad, the turn to the goal's heading."""
    return angle_between(jnp.asarray([1.0, 0.0], float), observation.goal_heading)


def _car(
    scenario: Scenario, state: State, observation: Observation, direction: Float[Array, "N"], aim: Float[Array, ""]
) -> Float[Array, "2"]:
    """The command of a car: pure pursuit ahead, and back with the other lock while the place is out of reach.

    Source: pure pursuit is R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", 1992.
    """
    steering = ackermann.steering(scenario.robot)
    turning_radius = steering.wheelbase / jnp.tan(steering.max_angle)  # m, of the rear axle

    # The place to drive to, from the rear axle.
    to_corner = length(observation.path[0], observation.path[1])
    x = to_corner * jnp.cos(aim) + steering.rear_axle
    y = to_corner * jnp.sin(aim)
    distance = length(x, y)
    bearing = jnp.arctan2(y, jnp.where(distance > 0.0, x, 1.0))
    sine = jnp.sin(bearing)
    reverses = _reverses(scenario, state, bearing, distance, turning_radius)

    # Pure pursuit, or the other lock backward.
    curvature = 2.0 * sine / jnp.maximum(distance, LOOK_AHEAD)
    right_lock = -1.0 / turning_radius
    left_lock = 1.0 / turning_radius
    curvature = jnp.clip(curvature, right_lock, left_lock)
    curvature = jnp.where(reverses, -jnp.sign(bearing) / turning_radius, curvature)

    speed = _car_speed(scenario, observation, direction, curvature, reverses)
    return jnp.stack([speed, speed * curvature])


def _car_speed(
    scenario: Scenario,
    observation: Observation,
    direction: Float[Array, "N"],
    curvature: Float[Array, ""],
    reverses: Bool[Array, ""],
) -> Float[Array, ""]:
    """The speed [m/s] of a car in a curve [1/m], which curves, people in these directions [rad] and the goal limit."""
    model = scenario.robot
    sharpness = jnp.maximum(jnp.abs(curvature), 1e-3)
    curve_speed = jnp.sqrt(LATERAL_ACCELERATION / sharpness)
    to_goal = _to_goal(observation)
    top_speed = model.max_speed * jnp.clip(to_goal / 1.0, 0.2, 1.0)
    free_ahead = _free_share(observation, direction, jnp.zeros_like(curvature))
    free_behind = _free_share(observation, direction, jnp.full_like(curvature, jnp.pi))
    ahead = jnp.minimum(top_speed, curve_speed) * free_ahead
    backward = jnp.minimum(max_reverse_speed(model), curve_speed) * free_behind
    speed = jnp.where(reverses, -backward, ahead)
    return jnp.where(to_goal < 0.5 * scenario.goal_radius, 0.0, speed)


def _reverses(scenario: Scenario, state: State, bearing: Array, distance: Array, turning_radius: Array) -> Array:
    """() bool, whether a car backs up, while its place is behind it or inside a circle to one side."""
    was_reversing = state.robot.drive_state.command[0] < 0.0
    sine = jnp.abs(jnp.sin(bearing))  # the circle to that side ends 2 r sin(bearing) ahead
    is_behind = jnp.abs(bearing) > BEHIND
    begins = is_behind | (distance < 2.0 * turning_radius * sine)
    is_ahead = jnp.abs(bearing) < AHEAD
    ends = is_ahead & (distance > 2.0 * OUTSIDE * turning_radius * sine)

    # Walls change the direction: the one in front at once, the one behind if it is too near to begin or to go on.
    front, rear = _gaps(scenario, state)
    goes_on = ~ends | (front < FREE_GAP)
    begins = begins | (front < WALL_GAP)
    reverses = jnp.where(was_reversing, goes_on, begins)
    least_rear = jnp.where(was_reversing, WALL_GAP, FREE_GAP)
    return reverses & (rear > least_rear)


def _gaps(scenario: Scenario, state: State) -> tuple[Array, Array]:
    """Gaps [m] between the robot's disc and the nearest obstacle in front of it and behind it."""
    x, y = state.robot.position
    heading = state.robot.heading
    distance, nx, ny = obstacle_distances(scenario.environment, x, y)
    gap = distance - scenario.robot.radius
    ahead = nx * heading[0] + ny * heading[1]  # of the normal, which points away from the obstacle
    front_gaps = jnp.where(ahead < -TOWARD_WALL, gap, jnp.inf)  # (W,)
    front = jnp.min(front_gaps, initial=jnp.inf)
    rear_gaps = jnp.where(ahead > TOWARD_WALL, gap, jnp.inf)
    rear = jnp.min(rear_gaps, initial=jnp.inf)
    return front, rear


def _free_share(observation: Observation, direction: Array, course: Array) -> Array:
    """Share of the speed that people leave on a course at that angle [rad]; they are in these directions [rad]."""
    deviation = jnp.abs(_wrap(direction - course))  # (N,)
    is_ahead = observation.people_present & (deviation < jnp.pi / 3)
    distance = length(observation.people[:, 0], observation.people[:, 1])
    vx = observation.people_velocity[:, 0]
    vy = observation.people_velocity[:, 1]
    along = vx * jnp.cos(course) + vy * jnp.sin(course)
    closing = jnp.maximum(-along, 0.0)
    return _share_of_speed(is_ahead, distance, closing)


def _share_of_speed(is_ahead: Array, distance: Array, closing: Array) -> Array:
    """Share of the speed by the distance [m] of people ahead, and the speed [m/s] with which they come nearer."""
    lost = 0.3 * closing
    free = distance - STOP_DISTANCE - lost
    free = jnp.where(is_ahead, free, SLOW_DISTANCE)
    free = jnp.min(free, initial=SLOW_DISTANCE)
    return jnp.clip(free / (SLOW_DISTANCE - STOP_DISTANCE), 0.0, 1.0)


def _half_width(distance: Array) -> Array:
    """Half the angle [rad] of a disc of radius ``PASSING_DISTANCE`` at a distance [m]; inside, pi / 2."""
    beyond = distance * distance - PASSING_DISTANCE * PASSING_DISTANCE
    outside = beyond > 0.0
    tangent = jnp.sqrt(jnp.where(outside, beyond, 1.0))  # m, to the disc
    half_width = jnp.arctan2(PASSING_DISTANCE, tangent)
    return jnp.where(outside, half_width, 0.5 * jnp.pi)


def _wrap(angle: Array) -> Array:
    """The angle [rad] in [-pi, pi)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi

"""orca: optimal reciprocal collision avoidance for robots on two wheels and omnidirectional ones (van den Berg, 2011).

The half-planes are defined in ``orca_solver``. They are those of a disc around the point of ``steering`` that contains
the robot (J. Snape et al., IROS 2010).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Observation, Scenario, State
from sean_jax.core.geometry import rotate
from sean_jax.people.orca_solver import UNBOUNDED, VelocityProgram, best_velocity, half_plane
from sean_jax.policies import steering
from sean_jax.policies.obstacles import obstacle_distances
from sean_jax.policies.prediction import nearest_people
from sean_jax.robots.drive import clip_turn_rate, require
from sean_jax.simulation.scenario import observe

PEOPLE_HORIZON = 4.0  # s, without a collision with people
OBSTACLE_HORIZON = 0.5  # s, without a collision with obstacles
MAX_PEOPLE = 8  # the nearest that are avoided
MAX_OBSTACLES = 4  # the nearest that are avoided
MAX_DISTANCE = 6.0  # m, of people that are avoided
PEOPLE_MARGIN = 0.1  # m, distance from bodies
OBSTACLE_MARGIN = 0.03  # m, distance from obstacles


def orca(scenario: Scenario, state: State, key: Array) -> Float[Array, "command"]:
    """Drives along the shortest path, at the nearest velocity without a collision with people within 4 s (ORCA).

    The robot takes all of the avoidance, for people need not reciprocate, as far as its speed allows; otherwise it
    takes the velocity that violates the half-planes least. Obstacles bound its speed. The command is in m/s and rad/s.

    Raises:
        InputError: the robot is a car.
    """
    robot = state.robot
    model = scenario.robot
    require(model, ("differential", "omnidirectional"), "orca steers")
    observation = observe(scenario, state)
    lever, speed_ahead, speed_left = steering.point_ahead(model, robot)
    bearing = steering.bearing(model, robot, observation, key)
    preferred = _preferred_velocity(scenario, observation, lever, bearing)

    people_x, people_y, people = _people_half_planes(scenario, state, lever, speed_ahead, speed_left)
    obstacles_x, obstacles_y, obstacles = _obstacle_half_planes(scenario, state)
    nx = jnp.concatenate([people_x, obstacles_x])
    ny = jnp.concatenate([people_y, obstacles_y])
    bounds = jnp.concatenate([people, obstacles])
    hard = jnp.arange(len(bounds)) >= len(people)  # half-planes of obstacles are never violated
    program = VelocityProgram(nx, ny, bounds, hard, *preferred, model.max_speed)
    x, y = best_velocity(program)
    return steering.follow(scenario, robot, observation, x, y)


def _preferred_velocity(
    scenario: Scenario, observation: Observation, lever: Array, bearing: Array
) -> tuple[Array, Array]:
    """The velocity [m/s] of the point ahead in the robot's frame, at which it turns to the bearing [rad]."""
    model = scenario.robot
    speed = steering.top_speed(model, observation)
    if model.lateral is not None:
        return speed * jnp.cos(bearing), speed * jnp.sin(bearing)
    turn_rate = clip_turn_rate(model, steering.TURN_GAIN * bearing)
    return speed * jnp.clip(jnp.cos(bearing), 0.0, 1.0), lever * turn_rate


def _people_half_planes(
    scenario: Scenario, state: State, lever: Array, speed_ahead: Array, speed_left: Array
) -> tuple[Float[Array, "K"], Float[Array, "K"], Float[Array, "K"]]:
    """Normals x, y and m/s: half-planes that bound the velocity in the robot's frame, clear of people."""
    robot = state.robot
    cosine, sine = robot.heading[0], robot.heading[1]
    people = nearest_people(state, MAX_PEOPLE)
    gap = people.position - robot.position[None, :]  # (K, 2) m
    dx, dy = _to_robot(gap, cosine, sine)
    vx, vy = _to_robot(people.velocity, cosine, sine)

    reach = scenario.robot.radius + lever + scenario.forces.walking.radius + PEOPLE_MARGIN
    breaks_tie = jnp.ones((), bool)  # of two at one place
    dx = dx - lever
    vx = speed_ahead - vx
    vy = speed_left - vy
    planes = jax.vmap(half_plane, in_axes=(0, 0, 0, 0, None, None, None, None))
    nx, ny, out = planes(dx, dy, vx, vy, reach, PEOPLE_HORIZON, scenario.time_step, breaks_tie)

    square = gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1]
    is_near = people.present & (square < MAX_DISTANCE * MAX_DISTANCE)
    bound = nx * speed_ahead + ny * speed_left + out
    return nx, ny, jnp.where(is_near, bound, UNBOUNDED)


def _to_robot(
    vectors: Float[Array, "K 2"], cosine: Float[Array, ""], sine: Float[Array, ""]
) -> tuple[Float[Array, "K"], Float[Array, "K"]]:
    """Components of vectors ahead and to the left."""
    x = vectors[:, 0]
    y = vectors[:, 1]
    ahead = x * cosine + y * sine
    left = y * cosine - x * sine
    return ahead, left


def _obstacle_half_planes(
    scenario: Scenario, state: State
) -> tuple[Float[Array, "W"], Float[Array, "W"], Float[Array, "W"]]:
    """Normals x, y and m/s: half-planes that bound the velocity in the robot's frame, clear of obstacles.

    Only the velocity moves a disc, not how it turns: n . v >= -gap / horizon for the normal n away from an obstacle.
    The velocity of a differential drive is along its heading, so that its normals are (1, 0) or (-1, 0).
    """
    x, y = state.robot.position
    heading = state.robot.heading
    distance, nx, ny = obstacle_distances(scenario.environment, x, y)
    count = min(MAX_OBSTACLES, len(distance))
    _, nearest = jax.lax.top_k(-jax.lax.stop_gradient(distance), count)
    gap = distance[nearest] - scenario.robot.radius - OBSTACLE_MARGIN
    gap = jnp.maximum(gap, 0.0)
    if state.robot.sideways is not None:
        ahead, left = rotate(nx[nearest], ny[nearest], heading[0], -heading[1])
        return ahead, left, -gap / OBSTACLE_HORIZON

    # An obstacle beside the robot bounds no speed.
    ahead = nx[nearest] * heading[0] + ny[nearest] * heading[1]
    is_steep = jnp.abs(ahead) > 1e-3
    steepness = jnp.where(is_steep, jnp.abs(ahead), 1.0)
    bound = -gap / (OBSTACLE_HORIZON * steepness)
    bound = jnp.where(is_steep, bound, UNBOUNDED)
    side = jnp.where(ahead < 0.0, -1.0, 1.0)
    return side, jnp.zeros_like(side), bound

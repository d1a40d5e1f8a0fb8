"""orca: optimal reciprocal collision avoidance for robots on two wheels and omnidirectional ones (van den Berg, 2011).

The half-planes are defined in ``orca_solver``. They are those of a disc around the point of ``steering`` that contains
the robot (J. Snape et al., IROS 2010).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Observation, Scenario, State
from sean_jax.core.geometry import from_rectangle, nearby_obstacles, rotate
from sean_jax.people.orca_solver import UNBOUNDED, VelocityProgram, best_velocity, half_plane
from sean_jax.policies import steering
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
    robot, model = state.robot, scenario.robot
    require(model, ("differential", "omnidirectional"), "orca steers")
    hx, hy = robot.heading[0], robot.heading[1]
    observation = observe(scenario, state)
    lever, own_x, own_y = steering.point_ahead(model, robot)
    wish = _wish(scenario, observation, lever, steering.bearing(model, robot, observation, key))

    people = nearest_people(state, MAX_PEOPLE)
    gap, motion = people.position - robot.position[None, :], people.velocity
    dx, dy = gap[:, 0] * hx + gap[:, 1] * hy - lever, gap[:, 1] * hx - gap[:, 0] * hy
    vx, vy = motion[:, 0] * hx + motion[:, 1] * hy, motion[:, 1] * hx - motion[:, 0] * hy
    reach = model.radius + lever + scenario.forces.walking.radius + PEOPLE_MARGIN
    each = jax.vmap(half_plane, in_axes=(0, 0, 0, 0, None, None, None, None))
    first = jnp.ones((), bool)
    nx, ny, out = each(dx, dy, own_x - vx, own_y - vy, reach, PEOPLE_HORIZON, scenario.time_step, first)
    near = people.present & (gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1] < MAX_DISTANCE * MAX_DISTANCE)
    c = jnp.where(near, nx * own_x + ny * own_y + out, UNBOUNDED)

    wall_x, wall_y, wall = _obstacle_half_planes(scenario, state)
    nx, ny = jnp.concatenate([nx, wall_x]), jnp.concatenate([ny, wall_y])
    bounds, hard = jnp.concatenate([c, wall]), jnp.arange(c.shape[0] + wall.shape[0]) >= c.shape[0]
    x, y = best_velocity(VelocityProgram(nx, ny, bounds, hard, *wish, model.max_speed))
    return steering.follow(scenario, robot, observation, x, y)


def _wish(scenario: Scenario, observation: Observation, lever: Array, bearing: Array) -> tuple[Array, Array]:
    """The velocity [m/s] of the point ahead in the robot's frame, at which it turns to the bearing [rad]."""
    model, speed = scenario.robot, steering.top_speed(scenario.robot, observation)
    if model.lateral is not None:
        return speed * jnp.cos(bearing), speed * jnp.sin(bearing)
    turn = clip_turn_rate(model, steering.TURN_GAIN * bearing)
    return speed * jnp.clip(jnp.cos(bearing), 0.0, 1.0), lever * turn


def _obstacle_half_planes(scenario: Scenario, state: State) -> tuple[Array, Array, Array]:
    """(W,) normals x, y and (W,) m/s: half-planes that bound the velocity in the robot's frame, clear of obstacles.

    Only the velocity moves a disc, not how it turns: n . v >= -gap / horizon for the normal n away from an obstacle.
    The velocity of a differential drive is along its heading, so that its normals are (1, 0) or (-1, 0).
    """
    (x, y), heading = state.robot.position, state.robot.heading
    rows = nearby_obstacles(scenario.environment.obstacle_grid, x, y)
    distance, nx, ny = from_rectangle(x, y, *(rows[:, part] for part in range(6)))
    _, index = jax.lax.top_k(-jax.lax.stop_gradient(distance), min(MAX_OBSTACLES, distance.shape[0]))
    gap = jnp.maximum(distance[index] - scenario.robot.radius - OBSTACLE_MARGIN, 0.0)
    if state.robot.sideways is not None:
        x, y = rotate(nx[index], ny[index], heading[0], -heading[1])
        return x, y, -gap / OBSTACLE_HORIZON
    toward = nx[index] * heading[0] + ny[index] * heading[1]
    steep = jnp.abs(toward) > 1e-3
    bound = -gap / (OBSTACLE_HORIZON * jnp.where(steep, jnp.abs(toward), 1.0))
    side = jnp.where(toward < 0.0, -1.0, 1.0)
    return side, jnp.zeros_like(side), jnp.where(steep, bound, UNBOUNDED)

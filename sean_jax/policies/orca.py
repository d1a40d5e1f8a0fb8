"""orca: a robot on two wheels that takes velocities without a collision ahead (van den Berg et al., 2011).

The half-planes are those of ``pedestrian_models.orca``. Its wheels cannot take any velocity, but a point ahead of the
axle can: J. Snape, J. van den Berg, S. J. Guy & D. Manocha, "Smooth and collision-free navigation for multiple robots
under differential-drive constraints" (IROS 2010) steer that point, with a disc around it that holds the whole robot.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import angle_between, from_rectangle, length
from sean_jax.nearby import around
from sean_jax.observation import Observation
from sean_jax.pedestrian_models.half_planes import NEVER, best_velocity
from sean_jax.pedestrian_models.orca import half_plane
from sean_jax.policies.prediction import nearest_people
from sean_jax.policies.unicycle import backward
from sean_jax.scenario import observe

POINT = 0.6  # of the radius: how far ahead of the axle the point lies
HORIZON = 4.0  # s, without a collision with people
WALL_HORIZON = 0.5  # s, likewise with obstacles
PEOPLE = 8  # the nearest that are heeded
WALLS = 4  # the nearest obstacles that are
RANGE = 6.0  # m, who is farther away is not
SPACE = 0.1  # m, kept from bodies
SPARE = 0.03  # m, kept from obstacles
TURN_GAIN = 2.0  # 1/s
SLIGHTLY = 0.3  # rad, by which a robot that gets nowhere wishes to go aside, or two who face each other stand for ever
ARRIVED = 0.1  # m from the goal, where it turns to the goal's heading


def orca(scenario: Scenario, state: State, key: Array) -> Array:
    """Drives along the shortest path, at the nearest velocity without a collision with anybody within 4 s (ORCA).

    Gives the (2,) command [m/s, rad/s]. It avoids people wholly, for they need not reciprocate, as far as that is
    possible at its speed; else it takes the velocity that fails them least. Obstacles bound its speed, ahead and
    backward. At most 19 programmes of 12 half-planes are solved: some 30,000 operations, a quarter of what the look-up
    of the shortest path takes.
    """
    robot, model = state.robot, scenario.robot
    hx, hy = robot.heading[0], robot.heading[1]
    lever = jnp.asarray(POINT * model.radius, float)
    seen = observe(scenario, state)
    stuck = 1.0 - jnp.clip(jnp.abs(robot.speed) / model.max_speed, 0.0, 1.0)
    wish = _wish(scenario, seen, lever, SLIGHTLY * stuck * jax.random.normal(key, (), float))

    people = nearest_people(state, PEOPLE)
    gap, motion = people.position - robot.position[None, :], people.velocity
    dx, dy = gap[:, 0] * hx + gap[:, 1] * hy - lever, gap[:, 1] * hx - gap[:, 0] * hy
    vx, vy = motion[:, 0] * hx + motion[:, 1] * hy, motion[:, 1] * hx - motion[:, 0] * hy
    own_x, own_y = robot.speed, lever * robot.turn_rate
    reach = model.radius + lever + scenario.forces.radius + SPACE
    each = jax.vmap(half_plane, in_axes=(0, 0, 0, 0, None, None, None, None))
    first = jnp.ones((), bool)
    nx, ny, out = each(dx, dy, own_x - vx, own_y - vy, reach, HORIZON, scenario.time_step, first)
    heeded = people.present & (gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1] < RANGE * RANGE)
    c = jnp.where(heeded, nx * own_x + ny * own_y + out, NEVER)

    wall_x, wall = _walls(scenario, state)
    x, y = best_velocity(
        jnp.concatenate([nx, wall_x]),
        jnp.concatenate([ny, jnp.zeros_like(wall_x)]),
        jnp.concatenate([c, wall]),
        jnp.arange(c.shape[0] + wall.shape[0]) >= c.shape[0],
        *wish,
        model.max_speed,
    )
    turn = jnp.clip(y / lever, -model.max_turn_rate, model.max_turn_rate)
    arrived = length(seen.goal[0], seen.goal[1]) < ARRIVED
    final = jnp.clip(TURN_GAIN * angle_between(_ahead(), seen.goal_heading), -model.max_turn_rate, model.max_turn_rate)
    speed = jnp.clip(x, -backward(model), model.max_speed)
    return jnp.stack([jnp.where(arrived, 0.0, speed), jnp.where(arrived, final, turn)])


def _wish(scenario: Scenario, seen: Observation, lever: Array, aside: Array) -> tuple[Array, Array]:
    """The velocity [m/s] of the point ahead that leads to the goal or ``aside`` [rad] of it, in the robot's frame."""
    model = scenario.robot
    bearing = angle_between(_ahead(), seen.path) + aside
    turn = jnp.clip(TURN_GAIN * bearing, -model.max_turn_rate, model.max_turn_rate)
    slower = jnp.clip(length(seen.goal[0], seen.goal[1]) / 0.5, 0.0, 1.0)
    return model.max_speed * jnp.clip(jnp.cos(bearing), 0.0, 1.0) * slower, lever * turn


def _walls(scenario: Scenario, state: State) -> tuple[Array, Array]:
    """(W,) 1 or -1 and (W,) m/s: half-planes that bound the speed along the heading, so that obstacles stay clear.

    Only the speed moves a disc, not how it turns: n . h v >= -gap / horizon for the normal n away from an obstacle.
    """
    (x, y), heading = state.robot.position, state.robot.heading
    rows = around(scenario.environment.nearby, x, y)
    distance, nx, ny = from_rectangle(x, y, *(rows[:, part] for part in range(6)))
    _, index = jax.lax.top_k(-jax.lax.stop_gradient(distance), min(WALLS, distance.shape[0]))
    gap = jnp.maximum(distance[index] - scenario.robot.radius - SPARE, 0.0)
    toward = nx[index] * heading[0] + ny[index] * heading[1]
    steep = jnp.abs(toward) > 1e-3
    bound = -gap / (WALL_HORIZON * jnp.where(steep, jnp.abs(toward), 1.0))
    return jnp.where(toward < 0.0, -1.0, 1.0), jnp.where(steep, bound, NEVER)


def _ahead() -> Array:
    return jnp.asarray([1.0, 0.0], float)

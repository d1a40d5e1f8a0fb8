"""social_force: a robot moved by the social force model (Helbing & Molnar, Phys. Rev. E 51, 4282, 1995).

The force of goal, people and obstacles is an acceleration, as for a person: G. Ferrer, A. Garrell & A. Sanfeliu, "Robot
companion: a social-force based approach with human awareness-navigation in crowded environments" (IROS 2013). The terms
of people and obstacles are those of ``social_forces`` with the constants of 1995. The robot follows the velocity after
one step with the point of ``steering``, on which the forces act.
"""

from dataclasses import replace

import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.core.data_types import Array, Policy, Scenario, State
from sean_jax.core.devices import parameter
from sean_jax.core.geometry import rotate
from sean_jax.policies import steering
from sean_jax.policies.known_people import KnownPeople, Sight, as_known, known_people, nobody
from sean_jax.policies.prediction import nearest_people, to_world
from sean_jax.robots.drive import require
from sean_jax.simulation.scenario import observe
from sean_jax.social_forces import PRESETS, Pair, Repulsion, Walls
from sean_jax.social_forces.walls import wall_forces

MAX_PEOPLE = 8  # the nearest that act on the robot


@struct.dataclass
class SocialForceParams(Sight):
    """Parameters of the forces on the robot; all leaves are () floats."""

    relaxation_time: Float[Array, ""] = parameter(0.5)  # s, in which the velocity to the goal is taken up [1995]
    repulsion: Repulsion = struct.field(default_factory=lambda: PRESETS["helbing1995"].repulsion)  # of people
    walls: Walls = struct.field(default_factory=lambda: PRESETS["helbing2000"].walls)  # of obstacles


def init(scenario: Scenario, params: SocialForceParams, state: State) -> KnownPeople:
    """Drives by the social force of goal, visible people and obstacles (Helbing & Molnar, 1995)."""
    return nobody(state)


def apply(
    scenario: Scenario, params: SocialForceParams, state: State, key: Array
) -> tuple[Float[Array, "command"], KnownPeople]:
    """The command [m/s, rad/s] of the velocity after a step of the forces, and the new memory.

    Raises:
        InputError: the robot is a car.
    """
    robot = state.robot
    model = scenario.robot
    require(model, ("differential", "omnidirectional"), "social_force steers")
    known = known_people(scenario, params, state, state.policy_state)
    state = as_known(state, known)
    observation = observe(scenario, state)
    lever, vx, vy = steering.point_ahead(model, robot)
    bearing = steering.bearing(model, robot, observation, key)
    speed = steering.top_speed(model, observation)
    look_x, look_y = jnp.cos(bearing), jnp.sin(bearing)
    desired_vx, desired_vy = speed * look_x, speed * look_y

    # Forces act in the world, and the robot accelerates in its own frame.
    point = jnp.stack(to_world(robot.position, robot.heading, lever, jnp.zeros_like(lever)))
    look = jnp.stack(rotate(look_x, look_y, *robot.heading))
    velocity = jnp.stack(rotate(vx, vy, *robot.heading))
    world_fx, world_fy = push(scenario, params, state, point, velocity, look)
    fx, fy = rotate(world_fx, world_fy, robot.heading[0], -robot.heading[1])
    vx = vx + scenario.time_step * ((desired_vx - vx) / params.relaxation_time + fx)
    vy = vy + scenario.time_step * ((desired_vy - vy) / params.relaxation_time + fy)
    return steering.follow(scenario, robot, observation, vx, vy), known


def push(
    scenario: Scenario,
    params: SocialForceParams,
    state: State,
    point: Float[Array, "2"],
    velocity: Float[Array, "2"],
    look: Float[Array, "2"],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The acceleration [m/s2] by people and obstacles of a body at a point [m] with a velocity [m/s] and a look."""
    x, y = point
    people = nearest_people(state, MAX_PEOPLE)
    px, py = people.position.T
    pvx, pvy = people.velocity.T
    radii = scenario.robot.radius + scenario.forces.walking.radius
    pair = Pair(x - px, y - py, pvx, pvy, velocity[0], velocity[1], look[0], look[1], radii)
    people_fx, people_fy = params.repulsion.pair(pair)
    people_fx = jnp.where(people.present, people_fx, 0.0).sum()
    people_fy = jnp.where(people.present, people_fy, 0.0).sum()

    walls = replace(params.walls, reach=scenario.robot.radius)
    walls_fx, walls_fy = wall_forces(walls, x[None], y[None], scenario.environment.obstacle_grid, jnp.inf)
    return people_fx + walls_fx[0], people_fy + walls_fy[0]


social_force = Policy(params=SocialForceParams(), name="social_force", init=init, apply=apply, sensing="tracks")
"""The robot with the usual constants; others by ``replace(social_force, params=...)``."""

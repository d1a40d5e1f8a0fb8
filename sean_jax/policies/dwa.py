"""dwa: the dynamic window approach (Fox, Burgard & Thrun, IEEE Robotics & Automation Magazine 4(1), 1997).

The robot takes the best of the velocities that it can reach within a short time and from which it can stop before a
collision: by its heading to the target, its free way, and its speed. The target is the next corner of the shortest
path. The paper's obstacles stand; here the people that the robot knows walk on at constant velocity. The paper's robot
has a synchro-drive; an omnidirectional one chooses speeds ahead and to the left, and turns toward the target.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.core.data_types import Array, Observation, Policy, Robot, RobotModel, Scenario, State
from sean_jax.core.devices import parameter
from sean_jax.core.geometry import length
from sean_jax.policies import steering
from sean_jax.policies.expert import obstacle_gap
from sean_jax.policies.known_people import KnownPeople, Sight, as_known, known_people, nobody
from sean_jax.policies.prediction import (
    PeopleMotion,
    RobotMotion,
    nearest_people,
    predict_robot,
    predict_straight,
    to_world,
)
from sean_jax.robots.drive import LAWS, clip_turn_rate, max_reverse_speed, reachable, require
from sean_jax.simulation.scenario import observe

STEPS, INTERVAL = 12, 0.25  # of a trajectory, 3 s, and s of each; the window is of one interval
SPEEDS, SIDES = 11, 21  # samples of the speed ahead, and of the turn rate or the speed to the left
MAX_PEOPLE = 8  # the nearest that are avoided
PEOPLE_MARGIN = 0.1  # m, distance from bodies
FORBIDDEN = 1e3  # s/m: no objective is worth an inadmissible speed


@struct.dataclass
class DwaParams(Sight):
    """Parameters of the dynamic window; all leaves are () floats."""

    heading: Float[Array, ""] = parameter(0.4)  # 1, weight alpha of the paper
    distance: Float[Array, ""] = parameter(0.4)  # 1, beta
    velocity: Float[Array, ""] = parameter(0.2)  # 1, gamma


def init(scenario: Scenario, params: DwaParams, state: State) -> KnownPeople:
    """Drives by the dynamic window approach (Fox et al., 1997), among visible people."""
    return nobody(state)


def apply(
    scenario: Scenario, params: DwaParams, state: State, key: Array
) -> tuple[Float[Array, "command"], KnownPeople]:
    """The command [m/s, rad/s] with the best objective, and the new memory.

    Its derivatives are those of the chosen sample, by the robot's speeds and limits.

    Raises:
        InputError: the robot is a car.
    """
    model = scenario.robot
    require(model, ("differential", "omnidirectional"), "dwa steers")
    known = known_people(scenario, params, state, state.policy_state)
    observation = observe(scenario, as_known(state, known))
    commands = window(model, state.robot, observation)
    fixed = jax.lax.stop_gradient((scenario, params, as_known(state, known), observation.path, commands))
    best = jnp.argmax(objective(*fixed).reshape(-1))
    command = jnp.stack([part.reshape(-1)[best] for part in commands])
    return steering.arrive(scenario, observation, command), known


def window(model: RobotModel, robot: Robot, observation: Observation) -> tuple[Float[Array, "S W"], ...]:
    """The parts [m/s, rad/s] of commands that the robot reaches within an interval."""
    reach, top = reachable(model, robot.speed, robot.turn_rate, INTERVAL), steering.top_speed(model, observation)
    back = jnp.zeros_like(top) if model.lateral is None else jnp.minimum(max_reverse_speed(model), top)
    ahead = jnp.linspace(jnp.clip(reach.speed_min, -back, top), jnp.clip(reach.speed_max, -back, top), SPEEDS)
    if model.lateral is None or robot.sideways is None:
        right, left = (clip_turn_rate(model, rate) for rate in (reach.turn_rate_min, reach.turn_rate_max))
        return tuple(jnp.meshgrid(ahead, jnp.linspace(right, left, SIDES), indexing="ij"))
    change = INTERVAL * model.lateral.max_acceleration
    right, left = (jnp.clip(robot.sideways + part, -top, top) for part in (-change, change))
    x, y = jnp.meshgrid(ahead, jnp.linspace(right, left, SIDES), indexing="ij")
    return x, y, jnp.full_like(x, steering.turn_toward(model, observation.path))


def objective(
    scenario: Scenario,
    params: DwaParams,
    state: State,
    target: Float[Array, "2"],
    commands: tuple[Float[Array, "S W"], ...],
) -> Float[Array, "S W"]:
    """The paper's G of commands [m/s, rad/s], smoothed; far lower the more a speed exceeds the admissible one.

    Args:
        target: m, in the robot's frame.
    """
    model, robot, shape = scenario.robot, state.robot, commands[0].shape
    constant = tuple(jnp.broadcast_to(part.reshape(-1), (STEPS, part.size)) for part in commands)
    motion = predict_robot(model, LAWS[model.drive_type].speeds(model, robot), constant, INTERVAL)
    people = predict_straight(nearest_people(state, MAX_PEOPLE), STEPS, INTERVAL)
    free = free_way(scenario, state, motion, people).reshape(shape)
    if model.lateral is None:
        speed, braking = commands[0], motion.turn_rate[0] * jnp.abs(motion.turn_rate[0]) / 2.0
        course = motion.yaw[0] + braking / model.max_turn_acceleration  # once the robot has braked
    else:
        speed, course = length(commands[0], commands[1]), jnp.arctan2(commands[1], commands[0]).reshape(-1)
    off = jnp.arctan2(target[1], target[0]) - course
    heading = (1.0 - jnp.abs((off + jnp.pi) % (2.0 * jnp.pi) - jnp.pi) / jnp.pi).reshape(shape)
    # Of all directions: the speed toward the target, or a robot that drives away from it would go on.
    toward = speed if model.lateral is None else speed * jnp.cos(off).reshape(shape)
    value = params.heading * heading + params.velocity * toward / model.max_speed
    value = value + params.distance * free / (model.max_speed * STEPS * INTERVAL)
    around = jnp.pad(value, 1, mode="edge")
    rows, columns = shape
    smooth = sum(around[i : i + rows, j : j + columns] for i in range(3) for j in range(3)) / 9.0
    brake = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    return smooth - FORBIDDEN * jnp.maximum(speed - jnp.sqrt(2.0 * brake * free), 0.0)


def free_way(scenario: Scenario, state: State, motion: RobotMotion, people: PeopleMotion) -> Float[Array, "P"]:
    """Length [m] of each way, in the robot's frame, before the first collision; of all 3 s at top speed without any.

    A robot that is too near to somebody already collides only where it comes nearer.
    """
    robot, model = state.robot, scenario.robot
    ahead, left = (jnp.concatenate([jnp.zeros_like(part[:1]), part]) for part in (motion.x, motion.y))
    x, y = to_world(robot.position, robot.heading, ahead, left)
    now = predict_straight(nearest_people(state, MAX_PEOPLE), 1, 0.0)
    px, py = (jnp.concatenate([one, other])[:, None] for one, other in ((now.x, people.x), (now.y, people.y)))
    reach = model.radius + scenario.forces.walking.radius + PEOPLE_MARGIN
    gap = jnp.min(length(x[..., None] - px, y[..., None] - py) - reach, axis=-1, initial=jnp.inf)
    gap = jnp.minimum(gap, obstacle_gap(scenario, x, y))
    free = jnp.cumsum(gap[1:] < jnp.minimum(gap[:1], 0.0), axis=0, dtype=jnp.int32) == 0
    way = jnp.where(free, length(jnp.diff(ahead, axis=0), jnp.diff(left, axis=0)), 0.0).sum(0)
    return jnp.where(free[-1], model.max_speed * STEPS * INTERVAL, way)


dwa = Policy(params=DwaParams(), name="dwa", init=init, apply=apply, sensing="tracks")
"""The robot with weights of this package (docs/policies.md); others by ``replace(dwa, params=...)``."""

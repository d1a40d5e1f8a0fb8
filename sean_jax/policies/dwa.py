"""dwa: the dynamic window approach (Fox, Burgard & Thrun, IEEE Robotics & Automation Magazine 4(1), 1997).

The robot takes the best of the velocities that it can reach within a short time and from which it can stop before a
collision: by its heading to the target, its free way, and its speed. The target is the next corner of the shortest
path. The paper's obstacles stand; here the people that the robot knows walk on at constant velocity. The paper's robot
has a synchro-drive; an omnidirectional one chooses speeds ahead and to the left, and turns toward the target.
"""

from typing import Any

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
    samples = [component.reshape(-1) for component in commands]
    command = jnp.stack([component[best] for component in samples])
    return steering.arrive(scenario, observation, command), known


def window(model: RobotModel, robot: Robot, observation: Observation) -> tuple[Float[Array, "S W"], ...]:
    """The components [m/s, rad/s] of commands that the robot reaches within an interval."""
    reach = reachable(model, robot.speed, robot.turn_rate, INTERVAL)
    top = steering.top_speed(model, observation)
    if model.lateral is None:
        reverse = jnp.zeros_like(top)
    else:
        reverse = jnp.minimum(max_reverse_speed(model), top)
    slowest = jnp.clip(reach.speed_min, -reverse, top)
    fastest = jnp.clip(reach.speed_max, -reverse, top)
    ahead = jnp.linspace(slowest, fastest, SPEEDS)

    if model.lateral is None or robot.sideways is None:
        right = clip_turn_rate(model, reach.turn_rate_min)
        left = clip_turn_rate(model, reach.turn_rate_max)
        turn_rate = jnp.linspace(right, left, SIDES)
        return tuple(jnp.meshgrid(ahead, turn_rate, indexing="ij"))

    # An omnidirectional robot samples its speed to the left, and turns toward the target.
    change = INTERVAL * model.lateral.max_acceleration
    right = jnp.clip(robot.sideways + -change, -top, top)
    left = jnp.clip(robot.sideways + change, -top, top)
    sideways = jnp.linspace(right, left, SIDES)
    x, y = jnp.meshgrid(ahead, sideways, indexing="ij")
    turn = steering.turn_toward(model, observation.path)
    return x, y, jnp.full_like(x, turn)


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
    model = scenario.robot
    robot = state.robot
    shape = commands[0].shape
    constant = tuple(jnp.broadcast_to(component.reshape(-1), (STEPS, component.size)) for component in commands)
    motion = predict_robot(model, LAWS[model.drive_type].speeds(model, robot), constant, INTERVAL)
    people = predict_straight(nearest_people(state, MAX_PEOPLE), STEPS, INTERVAL)
    free = free_way(scenario, state, motion, people).reshape(shape)

    speed, course = _speed_and_course(model, commands, motion)
    deviation = jnp.arctan2(target[1], target[0]) - course
    wrapped = (deviation + jnp.pi) % (2.0 * jnp.pi) - jnp.pi
    heading = (1.0 - jnp.abs(wrapped) / jnp.pi).reshape(shape)
    # Of all directions: the speed toward the target, or a robot that drives away from it would go on.
    velocity = speed if model.lateral is None else speed * jnp.cos(deviation).reshape(shape)

    value = params.heading * heading + params.velocity * velocity / model.max_speed
    value = value + params.distance * free / (model.max_speed * STEPS * INTERVAL)
    deceleration = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    admissible = jnp.sqrt(2.0 * deceleration * free)  # m/s, from which the robot stops in time
    return _smooth(value) - FORBIDDEN * jnp.maximum(speed - admissible, 0.0)


def _speed_and_course(model: RobotModel, commands: tuple[Array, ...], motion: RobotMotion) -> tuple[Array, Array]:
    """(S, W) m/s of commands, and (P,) rad, the direction in which the robot then drives."""
    if model.lateral is not None:
        ahead, left, _ = commands
        return length(ahead, left), jnp.arctan2(left, ahead).reshape(-1)
    turn_rate = motion.turn_rate[0]
    braking = turn_rate * jnp.abs(turn_rate) / 2.0
    return commands[0], motion.yaw[0] + braking / model.max_turn_acceleration  # once the robot has braked


def _smooth(values: Array) -> Array:
    """The mean of each value and its eight neighbors."""
    rows, columns = values.shape
    padded = jnp.pad(values, 1, mode="edge")
    total: Any = 0
    for i in range(3):
        for j in range(3):
            total = total + padded[i : i + rows, j : j + columns]
    return total / 9.0


def free_way(scenario: Scenario, state: State, motion: RobotMotion, people: PeopleMotion) -> Float[Array, "P"]:
    """Length [m] of each way, in the robot's frame, before the first collision; of all 3 s at top speed without any.

    A robot that is too near to somebody already collides only where it comes nearer.
    """
    robot = state.robot
    model = scenario.robot
    ahead = jnp.concatenate([jnp.zeros_like(motion.x[:1]), motion.x])  # (1 + T, P), now and after each step
    left = jnp.concatenate([jnp.zeros_like(motion.y[:1]), motion.y])
    x, y = to_world(robot.position, robot.heading, ahead, left)
    people_gap = _people_gap(scenario, state, x, y, people)
    gap = jnp.minimum(people_gap, obstacle_gap(scenario, x, y))

    # Until the first collision.
    least_gap = jnp.minimum(gap[:1], 0.0)
    collides = gap[1:] < least_gap
    is_free = jnp.cumsum(collides, axis=0, dtype=jnp.int32) == 0
    step = length(jnp.diff(ahead, axis=0), jnp.diff(left, axis=0))
    free_step = jnp.where(is_free, step, 0.0)
    until_collision = free_step.sum(0)
    return jnp.where(is_free[-1], model.max_speed * STEPS * INTERVAL, until_collision)


def _people_gap(
    scenario: Scenario, state: State, x: Float[Array, "ticks P"], y: Float[Array, "ticks P"], people: PeopleMotion
) -> Float[Array, "ticks P"]:
    """Gaps [m] between the robot at places (x, y) [m] and the nearest person, now and after each step."""
    people_now = predict_straight(nearest_people(state, MAX_PEOPLE), 1, 0.0)
    px = jnp.concatenate([people_now.x, people.x])[:, None]  # (1 + T, 1, K)
    py = jnp.concatenate([people_now.y, people.y])[:, None]
    reach = scenario.robot.radius + scenario.forces.walking.radius + PEOPLE_MARGIN
    distance = length(x[..., None] - px, y[..., None] - py)  # (1 + T, P, K)
    gap = distance - reach
    return jnp.min(gap, axis=-1, initial=jnp.inf)


dwa = Policy(params=DwaParams(), name="dwa", init=init, apply=apply, sensing="tracks")
"""The robot with weights of this package (docs/policies.md); others by ``replace(dwa, params=...)``."""

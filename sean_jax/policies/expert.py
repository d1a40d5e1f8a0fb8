"""expert: a model-predictive controller that drives politely; it stands in for the human of section V.

The paper's learned policies imitate a human operator. Here every control step searches a plan of the
next seconds: robot and people are predicted (``prediction``), social costs are summed along the way, and the rest of
the path is a shortest path (``cost_to_go``). The search samples in two rounds: widely around the last plan and over
constant arcs, then narrowly around the best of these. The robot drives the weighted mean of the second round (G.
Williams et al., "Information theoretic MPC for model-based reinforcement learning", ICRA 2017, with two rounds). The
expert knows more than a robot's sensors: all people and their goals; ``sensing_expert`` does not. A control step takes
some three million operations.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, Policy, Robot, RobotModel, Scenario, State
from sean_jax.core.devices import parameter
from sean_jax.core.geometry import length, to_border
from sean_jax.metrics.proximity import INTIMATE, PERSONAL
from sean_jax.policies import prediction
from sean_jax.policies.cost_to_go import CostToGo, build_cost_to_go, corner_successors, distance_to_goal
from sean_jax.policies.obstacles import obstacle_distances
from sean_jax.policies.prediction import PeopleMotion, RobotMotion
from sean_jax.robots import ackermann
from sean_jax.robots.drive import LAWS, command_size, max_reverse_speed

STEPS, TIME_STEP = 16, 0.2  # of a plan, and s of each: 3.2 s ahead
KNOTS = 5  # commands of a plan, interpolated linearly
WIDE_SAMPLES, CLOSE_SAMPLES = 48, 48  # of the two rounds
DEVIATION = (0.5, 0.15)  # of the limits: standard deviations in the two rounds
MAX_PEOPLE = 8  # the nearest, which are predicted
MAX_TURN_RATE = 2.0  # rad/s, of a plan
MAX_SPEED = 1.5  # m/s, of a plan among people
UNKNOWN_DISTANCE = 40.0  # m, for places from which no path is known
MIN_PROGRESS = 0.3  # m nearer to the goal
INITIAL_DISTANCE = 1e6  # m, more than any path
ARC_SPEEDS = (-0.4, 0.0, 0.35, 0.7, 1.0)  # of the limits: constant arcs
ARC_TURN_RATES = (-1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0)
SIDE_SPEEDS = (-1.0, -0.5, 0.5, 1.0)  # of an omnidirectional robot, without turning
OBSTACLE_MARGIN = 0.03  # m, distance from obstacles with a high cost below it
OBSTACLE_REACH = 0.15  # m, beyond it: the cost falls to 0
PERSON_MARGIN = 0.07  # m, by which predictions may be wrong: added to the intimate distance and to contact
STRETCH_TIME = 0.7  # s, by which the speed of people stretches their personal space ahead


@struct.dataclass
class SocialCosts:
    """Weights of the social costs (sections IV-G, IV-H); one unit of cost is worth one metre of path."""

    contact: Float[Array, ""] = parameter(8.0)  # 1/s, with an obstacle or inside the intimate distance
    obstacle: Float[Array, ""] = parameter(0.4)  # 1/s, at contact
    personal_space: Float[Array, ""] = parameter(1.5)  # 1/s, in its middle
    o_space: Float[Array, ""] = parameter(1.0)  # 1/s, in the middle of a group without a part in the task
    reverse: Float[Array, ""] = parameter(1.0)  # 1/m, of driving backward
    turn_rate: Float[Array, ""] = parameter(0.03)  # s/rad2, of its square
    acceleration: Float[Array, ""] = parameter(0.02)  # s3/m2, of its square
    goal_heading: Float[Array, ""] = parameter(0.3)  # 1, of the opposite heading at the goal


@struct.dataclass
class ExpertParams:
    """Parameters of the expert; all leaves are () floats."""

    weights: SocialCosts = struct.field(default_factory=SocialCosts)
    halfway: Float[Array, ""] = parameter(0.5)  # 1, weight of the remaining path in the middle of a plan; 1 at its end
    goal_tolerance: Float[Array, ""] = parameter(0.2)  # m from the goal, where it is reached
    temperature: Float[Array, ""] = parameter(0.05)  # of the weighted mean
    patience: Float[Array, ""] = parameter(10.0)  # s without progress, which halve the weight of personal space


class ExpertMemory(NamedTuple):
    """The expert's memory."""

    knots: Float[Array, "knots command"]  # of the last plan, shares of the limits
    successors: Int[Array, "V"]  # of ``cost_to_go.corner_successors``
    distance_min: Float[Array, ""]  # m, the path that was left at the last progress
    waiting_ticks: Int[Array, ""]  # since then


def init(scenario: Scenario, params: ExpertParams, state: State) -> ExpertMemory:
    """Plans seconds ahead by sampling, with predicted people, and costs of their distances and o-spaces."""
    knots = jnp.zeros((KNOTS, command_size(scenario.robot)), float)
    distance_min = jnp.full((), INITIAL_DISTANCE, float)
    successors = corner_successors(scenario, state)
    waiting_ticks = jnp.zeros((), jnp.int32)
    return ExpertMemory(knots, successors, distance_min, waiting_ticks)


def apply(
    scenario: Scenario, params: ExpertParams, state: State, key: Array
) -> tuple[Float[Array, "command"], ExpertMemory]:
    """The command [m/s, rad/s] of the best plan, and the new memory."""
    nearest = prediction.nearest_people(state, MAX_PEOPLE)
    people = prediction.predict_people(scenario, nearest, state.groups, STEPS, TIME_STEP)
    return plan(scenario, params, state, people, key)


def plan(
    scenario: Scenario, params: ExpertParams, state: State, people: PeopleMotion, key: Array
) -> tuple[Float[Array, "command"], ExpertMemory]:
    """The command [m/s, rad/s] and the new memory, by a search with any prediction of people.

    Args:
        state: now, with an ``ExpertMemory``; its groups are used, its people are not.
        people: ``STEPS`` steps of ``TIME_STEP``.
    """
    search = begin_search(scenario, params, state, people)
    last = search.last_knots
    noise = jax.random.normal(key, (WIDE_SAMPLES + CLOSE_SAMPLES, *last.shape), float)

    wide_deviation, close_deviation = DEVIATION

    # Widely around the last plan and over constant arcs, ...
    wide = jnp.clip(last[None] + wide_deviation * noise[:WIDE_SAMPLES], -1.0, 1.0)
    arcs = jnp.asarray(_arcs(last.shape[1]), float)
    wide = jnp.concatenate([last[None], wide, arcs])  # (P, KNOTS, command)
    costs = plan_costs(search, wide)
    best = wide[jnp.argmin(costs)]

    # ... then narrowly around the best.
    close = jnp.clip(best[None] + close_deviation * noise[WIDE_SAMPLES:], -1.0, 1.0)
    close = jnp.concatenate([best[None], close])
    weights = importance(plan_costs(search, close), params.temperature)
    weighted = weights[:, None, None] * close
    return follow_plan(search, weighted.sum(0))


class PlanSearch(NamedTuple):
    """What is fixed during the search of a control step."""

    scenario: Scenario
    params: ExpertParams
    state: State
    people: PeopleMotion
    limits: tuple[Array, Array, Array]  # of ``plan_limits``
    last_knots: Array  # (KNOTS, command), the last plan, continued
    table: CostToGo
    distance_min: Array  # m, of ``ExpertMemory``
    waiting_ticks: Array


def begin_search(scenario: Scenario, params: ExpertParams, state: State, people: PeopleMotion) -> PlanSearch:
    """Prepare the search of a control step. Arguments as in ``plan``."""
    memory: ExpertMemory = state.policy_state
    limits = plan_limits(scenario)
    last_knots = _shift(memory.knots, scenario.time_step)

    # Corners that are near from the robot and from four places along the last plan.
    motion = _simulate(scenario, state, last_knots[None], limits)
    position = state.robot.position
    quarter = STEPS // 4
    x = jnp.append(position[0], motion.x[quarter - 1 :: quarter, 0])
    y = jnp.append(position[1], motion.y[quarter - 1 :: quarter, 0])
    table = build_cost_to_go(scenario, state, memory.successors, x, y)

    # A robot that waits comes nearer to people.
    distance_min, waiting_ticks = _progress(scenario, params, state, table)
    waiting = scenario.time_step * waiting_ticks.astype(position.dtype)
    weights = params.weights
    patience = params.patience
    personal_space = weights.personal_space * patience / (patience + waiting)
    weights = replace(weights, personal_space=personal_space)
    params = replace(params, weights=weights)
    return PlanSearch(scenario, params, state, people, limits, last_knots, table, distance_min, waiting_ticks)


def plan_costs(search: PlanSearch, knots: Float[Array, "P knots command"]) -> Float[Array, "P"]:
    """The costs of plans in shares of the limits."""
    motion = _simulate(search.scenario, search.state, knots, search.limits)
    return _cost(search.scenario, search.params, search.state, search.table, search.people, motion)


def follow_plan(
    search: PlanSearch, knots: Float[Array, "knots command"]
) -> tuple[Float[Array, "command"], ExpertMemory]:
    """The command [m/s, rad/s] of the chosen plan, and the new memory."""
    command = _commands(search.scenario.robot, knots[0], search.limits)
    successors = search.state.policy_state.successors
    return command, ExpertMemory(knots, successors, search.distance_min, search.waiting_ticks)


def importance(costs: Float[Array, "P"], temperature: Float[Array, ""]) -> Float[Array, "P"]:
    """Weights of plans, which sum to 1: exp(-cost / temperature). Source: Williams et al., ICRA 2017."""
    return jax.nn.softmax(-(costs - jnp.min(costs)) / temperature)


def plan_limits(scenario: Scenario) -> tuple[Array, Array, Array]:
    """Top speeds ahead and backward [m/s] and turn rate [rad/s]: the robot's, or lower ones among people."""
    model = scenario.robot
    ahead = jnp.minimum(model.max_speed, MAX_SPEED)
    backward = jnp.minimum(max_reverse_speed(model), ahead)
    turn_rate = jnp.minimum(model.max_turn_rate, MAX_TURN_RATE)
    return ahead, backward, turn_rate


def _progress(scenario: Scenario, params: ExpertParams, state: State, table: CostToGo) -> tuple[Array, Array]:
    """() m, the remaining path at the last progress of ``MIN_PROGRESS``; and () int32 ticks since then, 0 at the goal.

    Without it two polite agents would wait for each other forever.
    """
    memory = state.policy_state
    position = state.robot.position
    distance = jax.lax.stop_gradient(distance_to_goal(scenario, state, table, position[:1], position[1:])[0])
    distance = jnp.where(jnp.isfinite(distance), distance, memory.distance_min)
    nearer = distance < memory.distance_min - MIN_PROGRESS
    progresses = nearer | (distance < params.goal_tolerance + MIN_PROGRESS)
    distance_min = jnp.where(progresses, distance, memory.distance_min)
    return distance_min, jnp.where(progresses, 0, memory.waiting_ticks + 1)


CONSTANT_ARCS = [np.tile([ahead, turn], (KNOTS, 1)) for ahead in ARC_SPEEDS for turn in ARC_TURN_RATES]
TURNS_FIRST = [np.array([(0.0, turn)] * 2 + [(1.0, 0.0)] * (KNOTS - 2)) for turn in ARC_TURN_RATES]  # then ahead
ARCS = np.stack([*CONSTANT_ARCS, *TURNS_FIRST])  # (A, KNOTS, 2)
SIDE_ARCS = np.stack([np.tile([ahead, left, 0.0], (KNOTS, 1)) for ahead in ARC_SPEEDS for left in SIDE_SPEEDS])
STEP_TIMES, KNOT_TIMES = np.arange(STEPS) * TIME_STEP, np.linspace(0, STEPS * TIME_STEP, KNOTS)  # s
INTERPOLATION = np.stack([np.interp(STEP_TIMES, KNOT_TIMES, weight) for weight in np.eye(KNOTS)], -1)


def _arcs(size: int) -> np.ndarray:
    """(A, KNOTS, size): the constant arcs of commands of that size."""
    return ARCS if size == 2 else np.concatenate([np.insert(ARCS, 1, 0.0, axis=2), SIDE_ARCS])


def _shift(knots: Array, seconds: float) -> Array:
    """The plan with that much of its beginning removed; its last command continues."""
    share = seconds * (KNOTS - 1) / (STEPS * TIME_STEP)
    change = jnp.diff(knots, axis=0, append=knots[-1:])
    return knots + share * change


def _commands(
    model: RobotModel, shares: Float[Array, "... command"], limits: tuple[Array, Array, Array]
) -> Float[Array, "... command"]:
    """Commands [m/s, rad/s] of shares of the limits; the second share of a car is of its steering angle."""
    ahead, backward, turn_rate = limits
    top_speed = jnp.where(shares[..., 0] > 0.0, ahead, backward)
    speed = top_speed * shares[..., 0]
    if model.lateral is not None:
        left = jnp.minimum(model.lateral.max_speed, ahead) * shares[..., 1]
        turn = turn_rate * shares[..., 2]
        return jnp.stack([speed, left, turn], -1)
    if model.steering is not None:
        angle = model.steering.max_angle * shares[..., 1]
        turn = ackermann.turn_rate_of(model, speed, angle)
    else:
        turn = turn_rate * shares[..., 1]
    return jnp.stack([speed, turn], -1)


def _simulate(
    scenario: Scenario, state: State, knots: Float[Array, "P knots command"], limits: tuple[Array, Array, Array]
) -> RobotMotion:
    """The motion of plans on the floor."""
    model = scenario.robot
    robot = state.robot
    interpolation = jnp.asarray(INTERPOLATION, float)
    shares = jnp.einsum("tk,pkc->tpc", interpolation, knots)
    commands = _commands(model, shares, limits)
    components = tuple(commands[..., index] for index in range(commands.shape[-1]))
    speeds = LAWS[model.drive_type].speeds(model, robot)
    motion = prediction.predict_robot(model, speeds, components, TIME_STEP)

    # From the robot's frame to the floor's.
    heading = robot.heading
    x, y = prediction.to_world(robot.position, heading, motion.x, motion.y)
    yaw = motion.yaw + jnp.arctan2(heading[1], heading[0])
    return motion._replace(x=x, y=y, yaw=yaw)


def _cost(
    scenario: Scenario, params: ExpertParams, state: State, table: CostToGo, people: PeopleMotion, motion: RobotMotion
) -> Float[Array, "P"]:
    """(P,) cost of trajectories (T, P): the remaining path, and the social costs along the way."""
    x, y, yaw, speed, turn_rate = motion
    weights = params.weights
    rate = obstacle_rate(scenario, weights, x, y)
    rate = rate + people_rate(scenario, weights, x, y, people)
    rate = rate + group_rate(state, weights, x, y)
    rate = rate + comfort_rate(weights, state.robot, speed, turn_rate)
    halfway, end = _remaining_paths(scenario, params, state, table, x, y)
    away_from_heading = _goal_heading_cost(state, x[-1], y[-1], yaw[-1], weights)
    return TIME_STEP * rate.sum(0) + params.halfway * halfway + end + away_from_heading


def _remaining_paths(
    scenario: Scenario, params: ExpertParams, state: State, table: CostToGo, x: Array, y: Array
) -> tuple[Array, Array]:
    """(P,) m, the paths that remain in the middle and at the end of trajectories (T, P)."""
    half = STEPS // 2 - 1
    middle_and_end_x = jnp.concatenate([x[half], x[-1]])  # (2 P,)
    middle_and_end_y = jnp.concatenate([y[half], y[-1]])
    distance = distance_to_goal(scenario, state, table, middle_and_end_x, middle_and_end_y)
    distance = jnp.where(jnp.isfinite(distance), distance, UNKNOWN_DISTANCE)
    remaining = jnp.maximum(distance - params.goal_tolerance, 0.0)
    middle, end = jnp.split(remaining, 2)
    return middle, end


def _goal_heading_cost(
    state: State, x: Float[Array, "P"], y: Float[Array, "P"], yaw: Float[Array, "P"], weights: SocialCosts
) -> Float[Array, "P"]:
    """Cost of another heading than the goal's, within 0.6 m of the goal."""
    goal = state.task.goal
    goal_heading = state.task.goal_heading
    distance = length(goal[0] - x, goal[1] - y)
    nearness = jnp.clip(1.0 - distance / 0.6, 0.0, 1.0)
    cosine = jnp.cos(yaw) * goal_heading[0] + jnp.sin(yaw) * goal_heading[1]
    turned_away = 1.0 - cosine
    return weights.goal_heading * nearness * turned_away


# Social costs: rates of the shape of the trajectories (T, P), to be integrated over time.


def obstacle_rate(
    scenario: Scenario, weights: SocialCosts, x: Float[Array, "T P"], y: Float[Array, "T P"]
) -> Float[Array, "T P"]:
    """Cost [1/s] of being near obstacles or the edge of the floor, at (x, y) [m]."""
    gap = obstacle_gap(scenario, x, y)
    near = jnp.clip(1.0 - gap / OBSTACLE_REACH, 0.0, 1.0)
    inside = jnp.clip(-gap / OBSTACLE_MARGIN, 0.0, 10.0)
    touches = jnp.where(gap < 0.0, 1.0, 0.0)
    return weights.obstacle * near * near + weights.contact * (inside + touches)


def obstacle_gap(scenario: Scenario, x: Float[Array, "T P"], y: Float[Array, "T P"]) -> Float[Array, "T P"]:
    """Distance [m] of the robot at (x, y) [m] from obstacles and the edge of the floor, less ``OBSTACLE_MARGIN``."""
    to_edge = to_border(scenario.environment, x, y)
    distance, _, _ = obstacle_distances(scenario.environment, x, y)
    nearest = jnp.minimum(jnp.min(distance, -1), to_edge)
    return nearest - scenario.robot.radius - OBSTACLE_MARGIN


def people_rate(
    scenario: Scenario, weights: SocialCosts, x: Float[Array, "T P"], y: Float[Array, "T P"], people: PeopleMotion
) -> Float[Array, "T P"]:
    """Cost [1/s] of being near people, at (x, y) [m]: contact, less than 0.45 m, and personal space.

    Personal space reaches 1.2 m, and farther ahead of walking people.
    """
    px, py, vx, vy = (component[:, None, :] for component in people)  # (T, 1, K)
    dx = x[..., None] - px  # (T, P, K)
    dy = y[..., None] - py
    distance = length(dx, dy)
    contact_distance = scenario.robot.radius + scenario.forces.walking.radius
    distance_min = jnp.maximum(INTIMATE, contact_distance) + PERSON_MARGIN

    # Ahead of walking people distances shrink.
    speed = length(vx, vy)
    ahead = (dx * vx + dy * vy) / jnp.maximum(speed, 0.1)
    shrink = 1.0 - 1.0 / (1.0 + STRETCH_TIME * speed)
    stretched = jnp.where(ahead > 0.0, distance - shrink * ahead, distance)

    reach = jnp.maximum(PERSONAL, distance_min + 0.4)
    personal = jnp.clip(1.0 - stretched / reach, 0.0, 1.0)
    inside = jnp.clip((distance_min - distance) / 0.2, 0.0, 3.0)
    touches = jnp.where(distance < distance_min, 1.0, 0.0)
    contact = weights.contact * (inside + touches)
    rate = weights.personal_space * personal * personal + contact
    return rate.sum(-1)


def group_rate(
    state: State, weights: SocialCosts, x: Float[Array, "T P"], y: Float[Array, "T P"]
) -> Float[Array, "T P"]:
    """Cost [1/s] of being in o-spaces, at (x, y) [m]; less far for groups that the task joins or leaves."""
    groups = state.groups
    task = state.task
    index = jnp.arange(groups.radius.shape[0], dtype=jnp.int32)
    is_task_group = (index == task.goal_group) | (index == task.start_group)
    share = jnp.where(is_task_group, 0.5, 1.2)  # of an o-space's radius
    radius = share * jnp.maximum(groups.radius, 1e-3)  # (G,)

    center_x = groups.center[None, None, :, 0]
    center_y = groups.center[None, None, :, 1]
    distance = length(x[..., None] - center_x, y[..., None] - center_y)  # (T, P, G)
    depth = jnp.clip(1.0 - distance / radius[None, None, :], 0.0, 1.0)
    depth = jnp.where(groups.present[None, None, :], depth, 0.0)
    return weights.o_space * depth.sum(-1)


def comfort_rate(
    weights: SocialCosts, robot: Robot, speed: Float[Array, "T P"], turn_rate: Float[Array, "T P"]
) -> Float[Array, "T P"]:
    """Cost [1/s] of driving backward, of turning and of acceleration, at speeds [m/s] and turn rates [rad/s]."""
    speed_now = jnp.full_like(speed[:1], robot.speed)
    turn_rate_now = jnp.full_like(turn_rate[:1], robot.turn_rate)
    acceleration = jnp.diff(speed, axis=0, prepend=speed_now) / TIME_STEP
    turn_acceleration = jnp.diff(turn_rate, axis=0, prepend=turn_rate_now) / TIME_STEP
    turning = weights.turn_rate * (turn_rate * turn_rate + 0.05 * turn_acceleration * turn_acceleration)
    reverse = weights.reverse * jnp.maximum(-speed, 0.0)
    return reverse + turning + weights.acceleration * acceleration * acceleration


expert = Policy(params=ExpertParams(), name="expert", init=init, apply=apply)
"""The expert with its usual parameters; others by ``replace(expert, params=...)``."""

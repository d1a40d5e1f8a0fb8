"""The local planner of ROS's navigation stack, TrajectoryPlanner with the dynamic window, for ``social_costmap``.

It scores 20 speeds by 40 turn rates, each driven for two seconds on the cost map: steps from the plan and steps to the
goal at the end, and the highest cost that the footprint's edge or the robot's middle enters on the way. Cost 254 at the
edge forbids a command. Cost 253 is legal and only counts, so standing, (0, 0), may be the best command. It is valid.

A turn on the spot is chosen only if it costs no more than the best of these commands. After two turns to one side,
turns to the other side are forbidden until the robot has moved 0.05 m. If no command is legal, the robot backs up at
0.5 m/s.

Source: ros-planning/navigation, noetic-devel at 9ad6441, base_local_planner; the numbers are those of SEAN's files.
In ROS a trajectory has up to 300 points, here 25 with the same last one.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, UInt8

from sean_jax.core.data_types import Array, Robot, RobotModel
from sean_jax.core.devices import parameter
from sean_jax.core.geometry import length
from sean_jax.policies.costmap import FOOTPRINT_CORNERS, LETHAL, UNREACHED, WINDOW, Window, cell_index
from sean_jax.robots.drive import clip_turn_rate, reachable

SPEED_SAMPLES, TURN_RATE_SAMPLES = 20, 40
MOVING = SPEED_SAMPLES * TURN_RATE_SAMPLES  # commands that are no turns on the spot
HORIZON = 2.0  # s, of a trajectory (sim_time)
GRANULARITY, ANGLE_GRANULARITY = 0.025, 0.01  # m and rad (sim_granularity, angular_sim_granularity)
POINTS = 25  # of a trajectory, at which costs are looked up
MAX_REACH = 2.8  # m, of a trajectory in the window
ESCAPE_SPEED = -0.5  # m/s (escape_vel)
LOOKAHEAD = 0.325  # m, by which turns on the spot are compared (heading_lookahead)
RESET_DISTANCE = 0.05  # m, after which turns to both sides are allowed (oscillation_reset_dist)
ESCAPE_DISTANCE = 0.1  # m, after which an escape ends (escape_reset_dist)
ESCAPE_ANGLE = 0.1  # rad, likewise (escape_reset_theta)
LEGAL, COLLIDES, NO_WAY = 0, 1, 2  # results of a trajectory


@struct.dataclass
class LocalPlannerParams:
    """Limits and weights of the local planner; all leaves are () floats."""

    top_speed: Float[Array, ""] = parameter(0.6)  # 1, of the robot's own: 0.3 of 0.5 m/s
    spin_min: Float[Array, ""] = parameter(0.5)  # rad/s, of a turn on the spot (min_in_place_vel_theta)
    path: Float[Array, ""] = parameter(0.75)  # per metre from the plan (pdist_scale, by meter_scoring)
    goal: Float[Array, ""] = parameter(1.0)  # per metre to the goal (gdist_scale, by meter_scoring)
    obstacle: Float[Array, ""] = parameter(0.1)  # per cost (occdist_scale)


class Oscillation(NamedTuple):
    """What the local planner remembers from command to command."""

    right: Bool[Array, ""]  # a turn on the spot to the right since the robot moved
    left: Bool[Array, ""]
    only_right: Bool[Array, ""]  # two turns to the right: turns to the left are forbidden
    only_left: Bool[Array, ""]
    place: Float[Array, "2"]  # m, of the last command that did not drive ahead
    escaping: Bool[Array, ""]  # no command may drive ahead
    escape_pose: Float[Array, "3"]  # m, m, rad, where the escape began


class Distances(NamedTuple):
    """The window's cells, as the local planner reads them."""

    costs: Float[Array, "W W"]  # whole numbers up to 255
    path: Float[Array, "W W"]  # steps from the plan
    goal: Float[Array, "W W"]  # steps to the goal


class Trajectories(NamedTuple):
    """P trajectories and their scores."""

    score: Float[Array, "P"]
    result: Int[Array, "P"]  # LEGAL, COLLIDES or NO_WAY
    yaw: Float[Array, "P"]  # rad, at the last point


def initial_oscillation(robot: Robot) -> Oscillation:
    """The memory of a robot that has not turned yet."""
    no = jnp.zeros((), bool)
    return Oscillation(no, no, no, no, robot.position, no, jnp.zeros(3, robot.position.dtype))


def sample_commands(
    model: RobotModel,
    params: LocalPlannerParams,
    robot: Robot,
    to_goal: Float[Array, ""],
    time_step: float,
) -> tuple[Float[Array, "P"], Float[Array, "P"], Float[Array, ""]]:
    """Speeds [m/s] and turn rates [rad/s] of 20 x 40 commands, 40 turns on the spot and the escape; the rates' step.

    The 40 commands of a speed are straight ahead and 39 turn rates, without the highest.

    Args:
        to_goal: m, distance to the goal, which the robot does not overshoot in two seconds.
        time_step: s, in which the commands can be reached.
    """
    reach = reachable(model, robot.speed, robot.turn_rate, time_step)
    top = jnp.minimum(params.top_speed * model.max_speed, MAX_REACH / HORIZON)
    slowest = jnp.clip(reach.speed_min, 0.0, top)  # of a robot that was pushed, too
    fastest = jnp.minimum(top, to_goal / HORIZON)
    fastest = jnp.minimum(fastest, reach.speed_max)
    fastest = jnp.maximum(fastest, 0.0)
    right = clip_turn_rate(model, reach.turn_rate_min)
    left = clip_turn_rate(model, reach.turn_rate_max)
    step = (left - right) / (TURN_RATE_SAMPLES - 1)

    # Turns on the spot are at least as fast as ``spin_min``.
    turns = right + step * jnp.arange(TURN_RATE_SAMPLES, dtype=float)
    left_spins = jnp.maximum(turns, params.spin_min)
    right_spins = jnp.minimum(turns, -params.spin_min)
    spins = jnp.where(turns > 0.0, left_spins, right_spins)

    speed_step = (fastest - slowest) / (SPEED_SAMPLES - 1)
    ahead = slowest + speed_step * jnp.arange(SPEED_SAMPLES, dtype=float)

    zero = jnp.zeros(1, float)
    curves = jnp.concatenate([zero, turns[:-1]])  # turn rates of each speed
    speeds = [jnp.repeat(ahead, TURN_RATE_SAMPLES), jnp.zeros(TURN_RATE_SAMPLES, float), zero + ESCAPE_SPEED]
    rates = [jnp.tile(curves, SPEED_SAMPLES), spins, zero]
    return jnp.concatenate(speeds), jnp.concatenate(rates), step


class PlannerMap(NamedTuple):
    """The window's cells, as they are looked up along trajectories: a cell's index is i * WINDOW + j."""

    pair_costs: UInt8[Array, "pairs"]  # of ``_pair_costs``
    costs: Float[Array, "cells"]
    no_way: Bool[Array, "cells"]  # no steps from the plan or to the goal


class TrajectoryPoint(NamedTuple):
    """The last point of P trajectories."""

    x: Float[Array, "P"]  # cells
    y: Float[Array, "P"]  # cells
    yaw: Float[Array, "P"]  # rad
    speed: Float[Array, "P"]  # m/s
    turn_rate: Float[Array, "P"]  # rad/s
    highest_cost: Float[Array, "P"]
    result: Int[Array, "P"]
    cell: Int[Array, "P"]  # of the point before


def score_trajectories(
    model: RobotModel,
    params: LocalPlannerParams,
    robot: Robot,
    window: Window,
    distances: Distances,
    commands: tuple[Float[Array, "P"], Float[Array, "P"]],
) -> Trajectories:
    """Drive P commands [m/s, rad/s] up to ``last_time``, within the robot's accelerations, and score them.

    A score is ``path`` and ``goal`` times a cell's side times the steps at the last point, plus ``obstacle`` times the
    highest cost on the way.
    """
    # ROS looks up as many points as its granularity asks for, up to 300: here 25, with the same last one.
    step = last_time(*commands) / (POINTS - 1)  # (P,) s

    # The map is the same at all points, so its look-ups are prepared once, two corners of the footprint in one.
    pair_costs = _pair_costs(distances.costs)
    costs, path, goal = (cells.reshape(-1) for cells in distances)
    no_way = (path >= UNREACHED) | (goal >= UNREACHED)
    planner_map = PlannerMap(pair_costs, costs, no_way)
    corners = _quarter_corners(model.radius / window.cell)

    def drive(point: TrajectoryPoint, _: Any) -> tuple[TrajectoryPoint, None]:
        # ROS's order: look up here, then take the new speed along the old yaw.
        cosine, sine = jnp.cos(point.yaw), jnp.sin(point.yaw)
        cell, highest_cost, result = _enter_cells(planner_map, point, corners, cosine, sine)
        speed, turn_rate = _accelerate(model, point, commands, step)
        distance = step * speed / window.cell
        x = point.x + distance * cosine
        y = point.y + distance * sine
        yaw = point.yaw + step * turn_rate
        return TrajectoryPoint(x, y, yaw, speed, turn_rate, highest_cost, result, cell), None

    # Places are in cells of the window, so that a look-up is a conversion to an integer.
    zeros = jnp.zeros_like(commands[0])
    none = jnp.zeros_like(commands[0], jnp.int32)
    place = (robot.position - window.origin) / window.cell  # (2,) cells
    yaw = jnp.arctan2(robot.heading[1], robot.heading[0])
    start = TrajectoryPoint(
        x=zeros + place[0],
        y=zeros + place[1],
        yaw=zeros + yaw,
        speed=zeros + robot.speed,
        turn_rate=zeros + robot.turn_rate,
        highest_cost=zeros,
        result=none,
        cell=none,
    )
    last, _ = jax.lax.scan(drive, start, length=POINTS)

    # Plan and goal count at the end of a trajectory alone, obstacles at their worst on the way.
    path_cost = params.path * window.cell * path[last.cell]  # (P,)
    goal_cost = params.goal * window.cell * goal[last.cell]
    score = path_cost + goal_cost + params.obstacle * last.highest_cost

    # The scan goes a step beyond the last look-up, so the yaw goes back by that step.
    return Trajectories(score, last.result, last.yaw - step * last.turn_rate)


def _quarter_corners(radius: Array) -> list[tuple[Array, Array]]:
    """Four of the footprint's 16 corners, ahead and left of its middle; the others follow by quarter turns."""
    angles = 2.0 * np.pi / FOOTPRINT_CORNERS * np.arange(FOOTPRINT_CORNERS // 4)
    return [(radius * float(np.cos(angle)), radius * float(np.sin(angle))) for angle in angles]


def _cell_of(x: Array, y: Array) -> tuple[Array, Array]:
    """The cell of places in cells of the window, which trajectories do not leave."""
    return x.astype(jnp.int32), y.astype(jnp.int32)


def _look_up(cells: Array, index: Array) -> Array:
    return cells.at[index].get(mode="promise_in_bounds")


def _enter_cells(
    planner_map: PlannerMap, point: TrajectoryPoint, corners: list[tuple[Array, Array]], cosine: Array, sine: Array
) -> tuple[Array, Array, Array]:
    """The middle's cell of each point, the highest cost so far, and the result so far."""
    i, j = _cell_of(point.x, point.y)
    cell = i * WINDOW + j
    edge = _edge_cost(planner_map, point, corners, cosine, sine)
    no_way = _look_up(planner_map.no_way, cell)
    result_here = jnp.where(no_way, NO_WAY, LEGAL)
    result_here = jnp.where(edge >= LETHAL, COLLIDES, result_here)
    result = jnp.where(point.result == LEGAL, result_here, point.result)
    cost_here = jnp.maximum(edge, _look_up(planner_map.costs, cell))
    return cell, jnp.maximum(point.highest_cost, cost_here), result


def _edge_cost(
    planner_map: PlannerMap, point: TrajectoryPoint, corners: list[tuple[Array, Array]], cosine: Array, sine: Array
) -> Array:
    """The highest cost (P,) at the footprint's 16 corners, two at a time."""
    offsets = []
    for ahead, left in corners:
        dx = ahead * cosine - left * sine
        dy = ahead * sine + left * cosine
        offsets.append((dx, dy))
    for _ in range(3):
        offsets += [(-dy, dx) for dx, dy in offsets[-len(corners) :]]

    highest = jnp.zeros_like(point.x, jnp.uint8)
    for (dx, dy), (next_dx, next_dy) in zip(offsets[::2], offsets[1::2], strict=True):
        i, j = _cell_of(point.x + dx, point.y + dy)
        next_i, next_j = _cell_of(point.x + next_dx, point.y + next_dy)
        neighbor = (next_i - i + 1) * 3 + (next_j - j + 1)  # two corners lie in one cell or in neighbors
        index = (neighbor * WINDOW + i) * WINDOW + j
        highest = jnp.maximum(highest, _look_up(planner_map.pair_costs, index))
    return highest.astype(point.x.dtype)


def _accelerate(
    model: RobotModel, point: TrajectoryPoint, commands: tuple[Array, Array], step: Array
) -> tuple[Array, Array]:
    """Speeds and turn rates (P,) one step nearer to the commands."""
    deceleration = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    turn_acceleration = model.max_turn_acceleration

    def ramp(value: Array, target: Array, up: Array, down: Array) -> Array:
        return jnp.clip(target, value - down * step, value + up * step)

    speed = ramp(point.speed, commands[0], model.max_acceleration, deceleration)
    turn_rate = ramp(point.turn_rate, commands[1], turn_acceleration, turn_acceleration)
    return speed, turn_rate


def _pair_costs(costs: Float[Array, "W W"]) -> UInt8[Array, "cells"]:
    """The higher cost of each cell and of one of nine cells around it, for two corners of the footprint at once."""
    whole = jnp.round(costs).astype(jnp.uint8)
    padded = jnp.pad(whole, 1)
    neighbors = [padded[i : i + WINDOW, j : j + WINDOW] for i in range(3) for j in range(3)]
    return jnp.stack([jnp.maximum(whole, neighbor) for neighbor in neighbors]).reshape(-1)


def last_time(speed: Float[Array, "P"], turn_rate: Float[Array, "P"]) -> Float[Array, "P"]:
    """Time [s] of the last point of ROS's trajectories: of n points, the first is now and the last is 2 / n s early."""
    count_by_speed = jnp.abs(speed) * (HORIZON / GRANULARITY)
    count_by_turn = jnp.abs(turn_rate) / ANGLE_GRANULARITY
    count = jnp.maximum(count_by_speed, count_by_turn)
    count = jnp.maximum(jnp.floor(count + 0.5), 1.0)
    return HORIZON * (1.0 - 1.0 / count)


def best_command(
    model: RobotModel,
    params: LocalPlannerParams,
    robot: Robot,
    window: Window,
    distances: Distances,
    oscillation: Oscillation,
    to_goal: Float[Array, ""],
    time_step: float,
) -> tuple[Float[Array, "2"], Bool[Array, ""], Oscillation]:
    """The command (2,) [m/s, rad/s], whether it is valid, and what to remember; the command is 0 if it is not valid.

    Args:
        to_goal: m, distance to the goal.
        time_step: s, of a control step.
    """
    fixed = jax.lax.stop_gradient
    speeds, rates, rate_step = sample_commands(model, params, robot, to_goal, time_step)
    commands = fixed(speeds), fixed(rates)
    trajectories = score_trajectories(*fixed((model, params, robot, window, distances)), commands)
    score = jnp.where(trajectories.result == LEGAL, trajectories.score, jnp.inf)
    best, cost = _best_curve(score, oscillation.escaping)
    turns = fixed(rates[1] + rate_step * jnp.arange(TURN_RATE_SAMPLES, dtype=float))  # before the least turn rate
    allowed = _allowed_turns(turns, rate_step, oscillation)
    to_look = _goal_steps_ahead(window, robot, fixed(distances.goal), trajectories.yaw[MOVING:-1])
    best, cost = _best_spin(best, cost, score[MOVING:-1], to_look, allowed)

    # Without a legal command the robot backs up, if there is a way.
    legal = jnp.isfinite(cost)
    index = jnp.where(legal, best, len(speeds) - 1)
    valid = legal | (trajectories.result[-1] != NO_WAY)
    command = jnp.where(valid, jnp.stack([speeds[index], rates[index]]), 0.0)
    escape = ~legal & valid
    return command, valid, _remember(robot, oscillation, fixed(command), legal, escape)


def _best_curve(score: Array, escaping: Array) -> tuple[Array, Array]:
    """The number of the best command that drives ahead, and its score; inf if the robot is escaping."""
    ahead = jnp.where(escaping, jnp.inf, score[:MOVING])
    best = jnp.argmin(ahead).astype(jnp.int32)
    return best, ahead[best]


def _allowed_turns(turns: Array, rate_step: Array, oscillation: Oscillation) -> Array:
    """Whether each turn on the spot [rad/s] is none to the side that oscillation forbids, nor too slow."""
    forbidden = jnp.where(turns < 0.0, oscillation.only_left, oscillation.only_right)
    return (jnp.abs(turns) > rate_step) & ~forbidden


def _goal_steps_ahead(window: Window, robot: Robot, goal: Array, yaw: Array) -> Array:
    """Steps to the goal from the places ``LOOKAHEAD`` m ahead of the robot after turns to these angles [rad]."""
    x = robot.position[0] + LOOKAHEAD * jnp.cos(yaw)
    y = robot.position[1] + LOOKAHEAD * jnp.sin(yaw)
    return goal[cell_index(window, x, y)]


def _best_spin(best: Array, cost: Array, score: Array, to_look: Array, allowed: Array) -> tuple[Array, Array]:
    """The number of the best command and its score, after the turns on the spot: in ROS's order, one after another.

    A turn is better if it costs no more and looks at a place that is nearer to the goal.
    """

    def compare(best: tuple[Array, Array, Array], spin: tuple[Array, ...]) -> tuple[tuple, None]:
        *candidate, is_allowed = spin
        _, spin_cost, spin_look = candidate
        _, cost, look = best
        better = is_allowed & jnp.isfinite(spin_cost) & (spin_cost <= cost) & (spin_look < look)
        return tuple(jnp.where(better, new, old) for new, old in zip(candidate, best, strict=True)), None

    number = jnp.arange(MOVING, MOVING + TURN_RATE_SAMPLES, dtype=jnp.int32)
    begin = best, cost, jnp.asarray(jnp.inf, score.dtype)
    (best, cost, _), _ = jax.lax.scan(compare, begin, (number, score, to_look, allowed))
    return best, cost


def _remember(robot: Robot, before: Oscillation, command: Array, legal: Array, escape: Array) -> Oscillation:
    """The memory after a command, whether it is legal and whether it is an escape."""
    yaw = jnp.arctan2(robot.heading[1], robot.heading[0])
    stays = legal & ~(command[0] > 0.0)
    place = jnp.where(stays, robot.position, before.place)
    moved = length(*(robot.position - place)) > RESET_DISTANCE

    # The second turn to a side forbids the other side, until the robot has moved.
    right = stays & (command[1] < 0.0)
    left = stays & (command[1] > 0.0)
    only_right = before.only_right | (right & before.right)
    only_left = before.only_left | (left & before.left)

    # An escape ends away from where it began.
    begins = escape & ~before.escaping
    pose = jnp.where(begins, jnp.append(robot.position, yaw), before.escape_pose)
    turn = yaw - pose[2]
    turned = jnp.abs(jnp.arctan2(jnp.sin(turn), jnp.cos(turn))) > ESCAPE_ANGLE
    is_away = turned | (length(*(robot.position - pose[:2])) > ESCAPE_DISTANCE)
    return Oscillation(
        right=(before.right | right) & ~moved,
        left=(before.left | left) & ~moved,
        only_right=only_right & ~moved,
        only_left=only_left & ~moved,
        place=place,
        escaping=(before.escaping | begins) & ~is_away,
        escape_pose=pose,
    )

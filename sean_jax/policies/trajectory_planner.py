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
HORIZON = 2.0  # s, of a trajectory (sim_time)
GRANULARITY, ANGLE_GRANULARITY = 0.025, 0.01  # m and rad (sim_granularity, angular_sim_granularity)
POINTS = 25  # of a trajectory, at which costs are looked up
MAX_REACH = 2.8  # m, of a trajectory in the window
ESCAPE_SPEED = -0.5  # m/s (escape_vel)
LOOKAHEAD = 0.325  # m, by which turns on the spot are compared (heading_lookahead)
RESET_DISTANCE = 0.05  # m, after which turns to both sides are allowed (oscillation_reset_dist)
ESCAPE_DISTANCE, ESCAPE_ANGLE = (
    0.1,
    0.1,
)  # m and rad, after which an escape ends (escape_reset_dist, escape_reset_theta)
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
    low = jnp.clip(reach.speed_min, 0.0, top)  # of a robot that was pushed, too
    high = jnp.maximum(jnp.minimum(jnp.minimum(top, to_goal / HORIZON), reach.speed_max), 0.0)
    right, left = (clip_turn_rate(model, rate) for rate in (reach.turn_rate_min, reach.turn_rate_max))
    step = (left - right) / (TURN_RATE_SAMPLES - 1)
    turns = right + step * jnp.arange(TURN_RATE_SAMPLES, dtype=float)
    ahead = low + (high - low) / (SPEED_SAMPLES - 1) * jnp.arange(SPEED_SAMPLES, dtype=float)
    spins = jnp.where(turns > 0.0, jnp.maximum(turns, params.spin_min), jnp.minimum(turns, -params.spin_min))
    zero = jnp.zeros(1, float)
    speeds = [jnp.repeat(ahead, TURN_RATE_SAMPLES), jnp.zeros(TURN_RATE_SAMPLES, float), zero + ESCAPE_SPEED]
    rates = [jnp.tile(jnp.concatenate([zero, turns[:-1]]), SPEED_SAMPLES), spins, zero]
    return jnp.concatenate(speeds), jnp.concatenate(rates), step


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
    step = last_time(*commands) / (POINTS - 1)
    pairs = _pair_costs(distances.costs)
    costs, path, goal = (part.reshape(-1) for part in distances)
    closed = (path >= UNREACHED) | (goal >= UNREACHED)
    still = jnp.zeros_like(commands[0])
    yaw = jnp.arctan2(robot.heading[1], robot.heading[0])
    deceleration = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    angle = 2.0 * np.pi / FOOTPRINT_CORNERS * np.arange(FOOTPRINT_CORNERS // 4)
    radius = model.radius / window.cell
    quarter = [(radius * float(np.cos(turn)), radius * float(np.sin(turn))) for turn in angle]

    def number(x: Array, y: Array) -> tuple[Array, Array]:  # of a cell; trajectories stay in the window
        return x.astype(jnp.int32), y.astype(jnp.int32)

    def read(cells: Array, index: Array) -> Array:
        return cells.at[index].get(mode="promise_in_bounds")

    def edge_cost(x: Array, y: Array, cosine: Array, sine: Array) -> Array:
        """The highest cost at the 16 corners, two at a time."""
        corners = [(ahead * cosine - left * sine, ahead * sine + left * cosine) for ahead, left in quarter]
        for _ in range(3):
            corners += [(-dy, dx) for dx, dy in corners[-len(quarter) :]]
        highest = jnp.zeros_like(x, jnp.uint8)
        for one, other in zip(corners[::2], corners[1::2], strict=True):
            (i, j), (k, m) = (number(x + dx, y + dy) for dx, dy in (one, other))
            beside = (k - i + 1) * 3 + (m - j + 1)
            highest = jnp.maximum(highest, read(pairs, (beside * WINDOW + i) * WINDOW + j))
        return highest.astype(x.dtype)

    def ramp(speed: Array, target: Array, up: Array, down: Array) -> Array:
        return jnp.clip(target, speed - down * step, speed + up * step)

    def point(now: tuple[Array, ...], _: Any) -> tuple[tuple[Array, ...], None]:
        x, y, yaw, speed, rate, highest, result = now[:7]  # x and y in cells
        cosine, sine = jnp.cos(yaw), jnp.sin(yaw)
        i, j = number(x, y)
        middle, edge = i * WINDOW + j, edge_cost(x, y, cosine, sine)
        failure = jnp.where(edge >= LETHAL, COLLIDES, jnp.where(read(closed, middle), NO_WAY, LEGAL))
        result = jnp.where(result == LEGAL, failure, result)
        highest = jnp.maximum(highest, jnp.maximum(edge, read(costs, middle)))
        speed = ramp(speed, commands[0], model.max_acceleration, deceleration)
        rate = ramp(rate, commands[1], model.max_turn_acceleration, model.max_turn_acceleration)
        gap = step * speed / window.cell
        after = x + gap * cosine, y + gap * sine, yaw + step * rate
        return (*after, speed, rate, highest, result, middle), None

    place = (robot.position - window.origin) / window.cell
    begin = [still + part for part in (place[0], place[1], yaw, robot.speed, robot.turn_rate)]
    none = jnp.zeros_like(still, jnp.int32)
    (_, _, yaw, _, rate, highest, result, last), _ = jax.lax.scan(point, (*begin, still, none, none), length=POINTS)
    weights = params.path * window.cell, params.goal * window.cell
    score = weights[0] * path[last] + weights[1] * goal[last] + params.obstacle * highest
    return Trajectories(score, result, yaw - step * rate)


def _pair_costs(costs: Float[Array, "W W"]) -> UInt8[Array, "cells"]:
    """The higher cost of each cell and of one of nine cells around it, for two corners of the footprint at once."""
    whole = jnp.round(costs).astype(jnp.uint8)
    padded = jnp.pad(whole, 1)
    around = [padded[i : i + WINDOW, j : j + WINDOW] for i in range(3) for j in range(3)]
    return jnp.stack([jnp.maximum(whole, other) for other in around]).reshape(-1)


def last_time(speed: Float[Array, "P"], turn_rate: Float[Array, "P"]) -> Float[Array, "P"]:
    """Time [s] of the last point of ROS's trajectories: of n points, the first is now and the last is 2 / n s early."""
    count = jnp.maximum(jnp.abs(speed) * (HORIZON / GRANULARITY), jnp.abs(turn_rate) / ANGLE_GRANULARITY)
    return HORIZON * (1.0 - 1.0 / jnp.maximum(jnp.floor(count + 0.5), 1.0))


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
    scored = score_trajectories(*fixed((model, params, robot, window, distances)), commands)
    score = jnp.where(scored.result == LEGAL, scored.score, jnp.inf)
    moving = SPEED_SAMPLES * TURN_RATE_SAMPLES
    ahead = jnp.where(oscillation.escaping, jnp.inf, score[:moving])
    start = jnp.argmin(ahead).astype(jnp.int32)
    spins = jnp.arange(moving, moving + TURN_RATE_SAMPLES, dtype=jnp.int32)
    end = scored.yaw[moving:-1]
    look = cell_index(
        window, robot.position[0] + LOOKAHEAD * jnp.cos(end), robot.position[1] + LOOKAHEAD * jnp.sin(end)
    )
    to_look = fixed(distances.goal)[look]
    turns = fixed(rates[1] + rate_step * jnp.arange(TURN_RATE_SAMPLES, dtype=float))  # before the least turn rate
    allowed = (jnp.abs(turns) > rate_step) & ~jnp.where(turns < 0.0, oscillation.only_left, oscillation.only_right)

    def spin(best: tuple[Array, Array, Array], each: tuple[Array, ...]) -> tuple[tuple, None]:
        index, cost, seen = best
        number, turn_cost, turn_look, free = each
        better = free & jnp.isfinite(turn_cost) & (turn_cost <= cost) & (turn_look < seen)
        return tuple(jnp.where(better, a, b) for a, b in zip((number, turn_cost, turn_look), best, strict=True)), None

    begin = start, ahead[start], jnp.asarray(jnp.inf, score.dtype)
    (best, cost, _), _ = jax.lax.scan(spin, begin, (spins, score[moving:-1], to_look, allowed))
    legal = jnp.isfinite(cost)
    index = jnp.where(legal, best, len(speeds) - 1)
    valid = legal | (scored.result[-1] != NO_WAY)
    command = jnp.where(valid, jnp.stack([speeds[index], rates[index]]), 0.0)
    escape = ~legal & valid
    return command, valid, _remember(robot, oscillation, fixed(command), legal, escape)


def _remember(robot: Robot, before: Oscillation, command: Array, legal: Array, escape: Array) -> Oscillation:
    yaw = jnp.arctan2(robot.heading[1], robot.heading[0])
    stays = legal & ~(command[0] > 0.0)
    right, left = stays & (command[1] < 0.0), stays & (command[1] > 0.0)
    only_right, only_left = before.only_right | (right & before.right), before.only_left | (left & before.left)
    place = jnp.where(stays, robot.position, before.place)
    moved = length(*(robot.position - place)) > RESET_DISTANCE
    begins = escape & ~before.escaping
    pose = jnp.where(begins, jnp.append(robot.position, yaw), before.escape_pose)
    turn = yaw - pose[2]
    turned = jnp.abs(jnp.arctan2(jnp.sin(turn), jnp.cos(turn))) > ESCAPE_ANGLE
    away = turned | (length(*(robot.position - pose[:2])) > ESCAPE_DISTANCE)
    turns = (before.right | right) & ~moved, (before.left | left) & ~moved
    escaping = (before.escaping | begins) & ~away
    return Oscillation(*turns, only_right & ~moved, only_left & ~moved, place, escaping, pose)

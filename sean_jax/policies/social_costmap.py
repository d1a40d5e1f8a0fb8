"""social_costmap and move_base: a planner after ROS's navigation stack, with social cost layers [49] or without.

This file has four parts:

1. a cost map in layers: obstacles with their inflation, people's bodies likewise, as a lidar sees them, and the
   proxemic layer (D. V. Lu, D. Hershberger & W. D. Smart, "Layered costmaps for context-sensitive navigation", IROS
   2014; the formula as in navigation_layers, the numbers as in SEAN 2.0's configuration). Costs are as in ROS: 0
   is free, 252 is the highest beside an obstacle, 253 touches. A cell has the highest cost of all layers. Here no
   command may touch; ROS's local planner may enter 253 at its price, and only 254, the obstacle itself, stops it;
2. a global plan on it, as of global_planner, by a wave that starts at the goal. ROS plans over the whole map. Here the
   map is a window around the robot, and the tables of shortest paths give the rest: the wave starts at the window's
   border with the remaining distance from there, and at a goal inside. People change the plan only in the window;
3. a local planner, the dynamic window approach after ROS's TrajectoryPlanner (D. Fox, W. Burgard & S. Thrun, 1997):
   20 speeds by 40 turn rates that can be reached in one control step, each driven for two seconds on the cost map;
   path distance counts .75 and goal distance 1 for each 0.05 m, a cost .1;
4. recovery: the robot turns on the spot where these fail for 5 seconds.

The paper says that the stack has social cost layers. SEAN 2.0's public files for Kuri have their numbers, but the
proxemic layer is commented out, the local map's obstacle layer is disabled, and the global map's has no sensor: no
person is on any map. ``social_costmap`` has people on its maps, ``move_base`` nobody.

Neither stands still as ROS's move_base does with the same files: docs/policies.md lists the differences. Here the
global plan is renewed every half second, on 32 x 32 cells of 0.2 m around the robot, and the local map has 32 x 32
cells of 0.05 m or, for a faster robot, as much as two seconds of it need. Maps hold the current places of people,
without the errors of a lidar. A control step takes some three million operations, most of them for the two maps.
"""

from dataclasses import replace
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax import clock
from sean_jax.base import Array, Pedestrians, Policy, Robot, RobotModel, Scenario, State
from sean_jax.devices import parameter, scalar
from sean_jax.geometry import from_rectangle, length, nearby_obstacles, to_border
from sean_jax.policies.cost_to_go import CostToGo, build_cost_to_go, corner_successors, distance_to_goal
from sean_jax.policies.prediction import nearest_people, to_world
from sean_jax.robots.drive import clip_turn_rate, reachable

MAX_PEOPLE = 10  # the nearest, on the maps
CONTACT_COST = 253.0  # the disc of the robot touches something there
MAX_COST = 252.0  # of a cell that can be driven over
NEUTRAL_COST, COST_FACTOR = 50.0, 3.0  # of global_planner: cost of a free cell, and weight of the map
STRAIGHT_STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1))
DIAGONAL_STEPS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
UNREACHED = 1e6  # m, of cells that the wave has not reached
GLOBAL_CELLS, GLOBAL_CELL = 32, 0.2  # of the global map, and m
PLAN_PERIOD, SWEEPS = 5, 12  # control steps that a plan takes; cells that the wave moves in each
PATH_POINTS = 20  # of a plan
LOCAL_CELLS, LOCAL_CELL = 32, 0.05  # of the local map, and m at least
LOCAL_PATH_POINTS = 8  # of the plan, for the local planner
SPEED_SAMPLES, TURN_RATE_SAMPLES = 20, 40
HORIZON = 2.0  # s, of a trajectory
TRAJECTORY_POINTS = 10  # at which costs are looked up
SCORE_CELL = 0.05  # m, unit of distances in scores
ESCAPE_SPEED = -0.1  # m/s, out of a contact
LOOKAHEAD = 0.325  # m, by which turns on the spot are compared

Tree = TypeVar("Tree")


@struct.dataclass
class CostmapParams:
    """Parameters of the cost map's layers; all leaves are () floats.

    The numbers are those of SEAN's files, but for the inflation: in the files its radius is 0.1 m on the local map,
    and its decay 3.
    """

    amplitude: Float[Array, ""] = parameter(77.0)  # A, cost in the middle of a person
    cutoff: Float[Array, ""] = parameter(10.0)  # lower costs become 0
    covariance: Float[Array, ""] = parameter(0.1)  # m2, C of a person who stands, as in SEAN; ROS's default is 0.25
    factor: Float[Array, ""] = parameter(5.0)  # s/m, by how much longer the Gaussian is ahead for each m/s
    inflation: Float[Array, ""] = parameter(0.3)  # m beyond contact, the reach of inflation (inflation_radius)
    decay: Float[Array, ""] = parameter(10.0)  # 1/m, of the inflation's cost (cost_scaling_factor)
    bodies: Float[Array, ""] = parameter(1.0)  # 1 if people's bodies are on the map, 0 if not


@struct.dataclass
class LocalPlannerParams:
    """Limits and weights of the local planner; all leaves are () floats."""

    top_speed: Float[Array, ""] = parameter(0.6)  # 1, of the robot's own: 0.3 of 0.5 m/s
    spin_min: Float[Array, ""] = parameter(0.5)  # rad/s, of a turn on the spot
    path: Float[Array, ""] = parameter(0.75)  # per cell of 0.05 m from the plan (pdist_scale)
    goal: Float[Array, ""] = parameter(1.0)  # per cell of 0.05 m from where the plan leaves the map (gdist_scale)
    obstacle: Float[Array, ""] = parameter(0.1)  # per cost (occdist_scale)


@struct.dataclass
class SocialCostmapParams:
    """Parameters of the navigation stack; leaves are () floats."""

    global_costmap: CostmapParams = struct.field(default_factory=CostmapParams)
    local_costmap: CostmapParams = struct.field(default_factory=CostmapParams)
    local_planner: LocalPlannerParams = struct.field(default_factory=LocalPlannerParams)
    goal_tolerance: Float[Array, ""] = parameter(0.35)  # m from the goal, where it stops (xy_goal_tolerance)
    patience: Float[Array, ""] = parameter(5.0)  # s without a path, after which it turns on the spot
    spin: Float[Array, ""] = parameter(1.0)  # rad/s, of that turn, once around


@struct.dataclass
class Window:
    """A square of cells that moves with the robot."""

    origin: Float[Array, "2"]  # m, middle of the first cell
    cell: Float[Array, ""]  # m, side of a cell


class SocialCostmapMemory(NamedTuple):
    """The policy's memory."""

    successors: Int[Array, "V"]  # of ``cost_to_go.corner_successors``
    window: Window  # of the plan in the making
    resistance: Float[Array, "C C"]  # metres of free way that a metre there is worth
    wave: Float[Array, "C C"]  # m
    path: Float[Array, "2 points"]  # m, x and y of the current plan
    path_complete: Bool[Array, ""]  # whether it leads to the goal
    waiting_ticks: Int[Array, ""]  # without a path; negative while it turns on the spot


def default_params(top_speed: float = 0.6, covariance: float = 0.1) -> SocialCostmapParams:
    """The paper's stack: the proxemic layer and people's bodies on both maps.

    Args:
        top_speed: 1, share of the robot's own top speed.
        covariance: m2, of personal space.
    """
    layers = CostmapParams(covariance=scalar(covariance))
    return SocialCostmapParams(layers, layers, LocalPlannerParams(top_speed=scalar(top_speed)))


def sean2_params() -> SocialCostmapParams:
    """The maps of SEAN 2.0's public files: no people, and an inflation that falls slower and ends sooner.

    The weights of the local planner are theirs, but ``meter_scoring``, which they set, is left out. In ROS Noetic it
    multiplies the weights of path and goal by a cell's side, and not the weight of cost.

    Source: yale-sean/social_sim_ros, ``params/kuri``: ``costmap_common_params.yaml`` and ``map_nav_params/*.yaml``.
    """
    layers = CostmapParams(amplitude=scalar(0.0), decay=scalar(3.0), bodies=scalar(0.0))
    return SocialCostmapParams(layers, replace(layers, inflation=scalar(0.1)))


# 1. Cost map


def rolling_window(middle: Float[Array, "2"], cell: Float[Array, ""], count: int) -> Window:
    """The window of ``count`` x ``count`` cells [m] around a place [m], moved by whole cells."""
    first = jnp.round(jax.lax.stop_gradient(middle) / cell) - (count // 2)
    return Window(first * cell, cell)


def cell_centers(window: Window, count: int) -> tuple[Float[Array, "C C"], Float[Array, "C C"]]:
    """x and y [m] of the middles of a window's cells; x varies along the first axis."""
    steps = jnp.arange(count, dtype=float) * window.cell
    x, y = window.origin[0] + steps, window.origin[1] + steps
    return jnp.broadcast_to(x[:, None], (count, count)), jnp.broadcast_to(y[None, :], (count, count))


def cell_index(
    window: Window, count: int, x: Float[Array, "*shape"], y: Float[Array, "*shape"]
) -> tuple[Int[Array, "*shape"], Int[Array, "*shape"]]:
    """Indices along both axes of the cells at places (x, y) [m], or of the nearest cells."""
    i = jnp.round((x - window.origin[0]) / window.cell).astype(jnp.int32)
    j = jnp.round((y - window.origin[1]) / window.cell).astype(jnp.int32)
    return jnp.clip(i, 0, count - 1), jnp.clip(j, 0, count - 1)


def proxemic_cost(
    params: CostmapParams,
    dx: Float[Array, "..."],
    dy: Float[Array, "..."],
    vx: Float[Array, "..."],
    vy: Float[Array, "..."],
) -> Float[Array, "..."]:
    """Cost of a place at (dx, dy) [m] from a person at velocity (vx, vy) [m/s]: a Gaussian, longer ahead of walkers.

    A exp(-(mx^2 / (2 sx) + my^2 / (2 sy))) with m along and across the heading, sy = C, and sx = C (1 + 5 |v|) ahead
    and C behind; 0 below the cutoff. The costs are whole numbers, as in the map, with the gradient of the Gaussian.
    """
    speed = length(vx, vy)
    standing = speed < 1e-6
    hx = jnp.where(standing, 1.0, vx / jnp.where(standing, 1.0, speed))
    hy = jnp.where(standing, 0.0, vy / jnp.where(standing, 1.0, speed))
    along, across = dx * hx + dy * hy, dy * hx - dx * hy
    ahead = params.covariance * jnp.where(along > 0.0, 1.0 + params.factor * speed, 1.0)
    cost = params.amplitude * jnp.exp(-(along * along / (2.0 * ahead) + across * across / (2.0 * params.covariance)))
    return jnp.where(cost < params.cutoff, 0.0, cost - jax.lax.stop_gradient(cost - jnp.floor(cost)))


def inflation_cost(params: CostmapParams, gap: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Cost of a gap [m] between the robot's disc and another body, by the formula of costmap_2d."""
    near = MAX_COST * jnp.exp(-params.decay * jnp.maximum(gap, 0.0))
    return jnp.where(gap <= 0.0, CONTACT_COST, jnp.where(gap <= params.inflation, near, 0.0))


def cell_costs(
    scenario: Scenario,
    params: CostmapParams,
    people: Pedestrians,
    x: Float[Array, "*shape"],
    y: Float[Array, "*shape"],
) -> Float[Array, "*shape"]:
    """Costs of places (x, y) [m], by all layers."""
    shape, radius = x.shape, scenario.robot.radius
    x, y = x.ravel(), y.ravel()
    rows = nearby_obstacles(scenario.environment.obstacle_grid, x, y)
    walls = from_rectangle(x[:, None], y[:, None], *(rows[..., part] for part in range(6)))[0]
    edge = to_border(scenario.environment, x, y)
    gap = jnp.minimum(jnp.min(walls, 1), edge) - radius

    def person(px: Array, py: Array, vx: Array, vy: Array, present: Array) -> tuple[Array, Array]:
        dx, dy = x - px, y - py
        body = length(dx, dy) - radius - scenario.forces.walking.radius
        social = proxemic_cost(params, dx, dy, vx, vy)
        return jnp.where(present & (params.bodies > 0.0), body, jnp.inf), jnp.where(present, social, 0.0)

    (px, py), (vx, vy) = people.position.T, people.velocity.T
    bodies, social = jax.vmap(person)(px, py, vx, vy, people.present)
    gap = jnp.minimum(gap, jnp.min(bodies, 0, initial=jnp.inf))
    return jnp.maximum(inflation_cost(params, gap), jnp.max(social, 0, initial=0.0)).reshape(shape)


# 2. Global plan


def traversal_resistance(costs: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Metres of free way that a metre through a cell is worth: at most 252 / 50; ``UNREACHED`` for cells in contact."""
    free = jnp.minimum(NEUTRAL_COST + COST_FACTOR * costs, MAX_COST) / NEUTRAL_COST
    return jnp.where(costs >= CONTACT_COST, UNREACHED, free)


def initial_wave(
    scenario: Scenario, state: State, table: CostToGo, window: Window, costs: Float[Array, "C C"]
) -> Float[Array, "C C"]:
    """The wave [m] before the first sweep: remaining distances on the border and near the goal, else ``UNREACHED``."""
    count = costs.shape[0]
    x, y = cell_centers(window, count)
    edge = jnp.concatenate([jnp.arange(count, dtype=jnp.int32)] * 2)
    low, high = jnp.zeros(count, jnp.int32), jnp.full(count, count - 1, jnp.int32)
    i = jnp.concatenate([edge, low, high])
    j = jnp.concatenate([low, high, edge])
    left = distance_to_goal(scenario, state, table, x[i, j], y[i, j])
    left = jnp.where(jnp.isfinite(left) & (costs[i, j] < CONTACT_COST), left, UNREACHED)
    wave = jnp.full_like(costs, UNREACHED).at[i, j].set(left)
    to_goal = length(x - state.task.goal[0], y - state.task.goal[1])
    return jnp.where(to_goal < window.cell, to_goal, wave)


def sweep_wave(
    wave: Float[Array, "C C"], resistance: Float[Array, "C C"], cell: Float[Array, ""]
) -> Float[Array, "C C"]:
    """Move the wave [m], the distance to the goal so far, on by one cell of side ``cell`` [m] everywhere.

    A cell gets the minimum of its own distance, and of its eight neighbors' distances plus the step there.
    """
    padded = jnp.pad(wave, 1, constant_values=UNREACHED)
    count = wave.shape[0]

    def minimum(steps: tuple) -> Array:
        neighbors = [padded[1 + i : 1 + i + count, 1 + j : 1 + j + count] for i, j in steps]
        return jnp.minimum(jnp.minimum(neighbors[0], neighbors[1]), jnp.minimum(neighbors[2], neighbors[3]))

    step = cell * resistance
    diagonal = jnp.asarray(2**0.5, float) * step
    return jnp.minimum(wave, jnp.minimum(minimum(STRAIGHT_STEPS) + step, minimum(DIAGONAL_STEPS) + diagonal))


def descend_wave(
    wave: Float[Array, "C C"], window: Window, x: Float[Array, ""], y: Float[Array, ""], points: int
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """The plan (x, y) [m] from a place (x, y) [m]: from cell to cell down the wave [m]."""
    count = wave.shape[0]
    padded = jnp.pad(wave, 1, constant_values=2.0 * UNREACHED)
    steps = jnp.asarray(((0, 0), *STRAIGHT_STEPS, *DIAGONAL_STEPS), jnp.int32)

    def step(here: tuple[Array, Array], _: None) -> tuple[tuple, tuple]:
        i, j = here
        best = steps[jnp.argmin(padded[1 + i + steps[:, 0], 1 + j + steps[:, 1]])]
        here = i + best[0], j + best[1]
        return here, here

    _, (i, j) = jax.lax.scan(step, cell_index(window, count, x, y), length=points)
    return window.origin[0] + window.cell * i.astype(float), window.origin[1] + window.cell * j.astype(float)


# 3. Local plan


def sample_commands(
    model: RobotModel,
    params: LocalPlannerParams,
    speed: Float[Array, ""],
    turn_rate: Float[Array, ""],
    time_step: float,
) -> tuple[Float[Array, "P"], Float[Array, "P"]]:
    """Speeds [m/s] and turn rates [rad/s] of the 20 x 40 commands of the dynamic window, straight ahead among them.

    One more command, the last, backs out of a contact.

    Args:
        speed, turn_rate: m/s and rad/s, now.
        time_step: s, in which the commands can be reached.
    """
    reach = reachable(model, speed, turn_rate, time_step)
    top = params.top_speed * model.max_speed
    low = jnp.clip(reach.speed_min, 0.0, top)
    high = jnp.clip(reach.speed_max, low, top)
    right, left = (clip_turn_rate(model, rate) for rate in (reach.turn_rate_min, reach.turn_rate_max))
    share = jnp.linspace(0.0, 1.0, SPEED_SAMPLES, dtype=float)
    share_turn = jnp.linspace(0.0, 1.0, TURN_RATE_SAMPLES - 1, dtype=float)
    ahead = jnp.repeat(low + (high - low) * share, TURN_RATE_SAMPLES)
    turns = jnp.concatenate([jnp.zeros(1, float), right + (left - right) * share_turn])
    turns = jnp.tile(turns, SPEED_SAMPLES)
    spin = jnp.where(turns < 0.0, -1.0, 1.0) * jnp.maximum(jnp.abs(turns), params.spin_min)
    turns = jnp.where((ahead < 1e-3) & (turns != 0.0), spin, turns)
    return jnp.append(ahead, jnp.asarray(ESCAPE_SPEED, float)), jnp.append(turns, jnp.asarray(0.0, float))


def arc_trajectories(
    speed: Float[Array, "P"], turn_rate: Float[Array, "P"]
) -> tuple[Float[Array, "points P"], Float[Array, "points P"], Float[Array, "points P"]]:
    """x, y [m] and yaw [rad], in the robot's frame, along constant speeds [m/s] and turn rates [rad/s]."""
    time = jnp.linspace(HORIZON / TRAJECTORY_POINTS, HORIZON, TRAJECTORY_POINTS, dtype=float)[:, None]
    yaw = time * turn_rate[None, :]
    half = 0.5 * yaw
    flat = jnp.abs(half) < 1e-3
    chord = time * speed[None, :] * jnp.where(flat, 1.0, jnp.sin(half) / jnp.where(flat, 1.0, half))
    return chord * jnp.cos(half), chord * jnp.sin(half), yaw


def best_command(
    scenario: Scenario,
    params: LocalPlannerParams,
    robot: Robot,
    window: Window,
    costs: Float[Array, "C C"],
    path: tuple[Float[Array, "L"], Float[Array, "L"]],
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """The command (2,) [m/s, rad/s] of the dynamic window with the best score; and whether any command touches nothing.

    If all commands have contact, the best command ends without contact, or is to stand.

    Args:
        path: x and y [m] of the plan inside the window.
    """
    position, heading = robot.position, robot.heading
    ahead, turns = sample_commands(scenario.robot, params, robot.speed, robot.turn_rate, scenario.time_step)
    x, y, yaw = arc_trajectories(ahead, turns)
    world_x, world_y = to_world(position, heading, x, y)
    costs_along = costs[cell_index(window, costs.shape[0], world_x, world_y)]
    cost_max = jnp.max(costs_along, 0)
    clear = (cost_max < CONTACT_COST) & (ahead >= 0.0)
    way_out = costs_along[-1] < CONTACT_COST
    still = jnp.abs(ahead) < 1e-3
    angle = yaw[-1] + jnp.arctan2(heading[1], heading[0])
    end_x = world_x[-1] + jnp.where(still, LOOKAHEAD * jnp.cos(angle), 0.0)
    end_y = world_y[-1] + jnp.where(still, LOOKAHEAD * jnp.sin(angle), 0.0)
    goal_x, goal_y = path[0][-1], path[1][-1]
    end_to_goal = length(end_x - goal_x, end_y - goal_y)
    here_to_goal = length(position[0] - goal_x, position[1] - goal_y)
    to_goal = jnp.where(still, here_to_goal + 1e-3 * end_to_goal, end_to_goal)
    to_path = jnp.where(still, distance_to_path(world_x[-1], world_y[-1], *path), distance_to_path(end_x, end_y, *path))
    score = (params.path * to_path + params.goal * to_goal) / SCORE_CELL + params.obstacle * cost_max
    any_clear = clear.any()
    allowed = jnp.where(any_clear, clear, way_out)
    best = jnp.argmin(jnp.where(allowed, score, jnp.inf))
    command = jnp.stack([ahead[best], turns[best]])
    return jnp.where(allowed.any(), command, 0.0), any_clear


def distance_to_path(
    x: Float[Array, "P"], y: Float[Array, "P"], path_x: Float[Array, "L"], path_y: Float[Array, "L"]
) -> Float[Array, "P"]:
    """Distance [m] from places (x, y) [m] to the nearest segment of a path [m]."""

    def segment(ax: Array, ay: Array, bx: Array, by: Array) -> Array:
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        along = ((x - ax) * dx + (y - ay) * dy) / jnp.maximum(square, 1e-9)
        along = jnp.clip(along, 0.0, 1.0)
        return length(x - ax - along * dx, y - ay - along * dy)

    return jnp.min(jax.vmap(segment)(path_x[:-1], path_y[:-1], path_x[1:], path_y[1:]), 0)


# 4. The policy


def init(scenario: Scenario, params: SocialCostmapParams, state: State) -> SocialCostmapMemory:
    """A planner after ROS's navigation stack: social_costmap has people on its maps, move_base nobody."""
    here = jnp.broadcast_to(state.robot.position[:, None], (2, PATH_POINTS))
    cells = jnp.full((GLOBAL_CELLS, GLOBAL_CELLS), UNREACHED, float)
    window = Window(jnp.zeros(2, float), jnp.ones((), float))
    successors, incomplete = corner_successors(scenario, state), jnp.zeros((), bool)
    return SocialCostmapMemory(successors, window, cells, cells, here, incomplete, jnp.zeros((), jnp.int32))


def apply(
    scenario: Scenario, params: SocialCostmapParams, state: State, key: Array
) -> tuple[Float[Array, "2"], SocialCostmapMemory]:
    """The command (2,) [m/s, rad/s] along the plan, and the memory with a few cells more of the next plan."""
    memory: SocialCostmapMemory = state.policy_state
    first, last = state.tick % PLAN_PERIOD == 0, state.tick % PLAN_PERIOD == PLAN_PERIOD - 1
    start = _start_plan(scenario, params, state, memory.successors)
    window, resistance, wave = _select(first, start, (memory.window, memory.resistance, memory.wave))
    wave = jax.lax.scan(lambda now, _: (sweep_wave(now, resistance, window.cell), None), wave, length=SWEEPS)[0]
    path, path_complete = _select(last, _global_path(state, window, wave), (memory.path, memory.path_complete))
    robot = state.robot
    window_and_costs, local_path = _local_map(scenario, params, state), _local_path(path, robot.position)
    command, clear = best_command(scenario, params.local_planner, robot, *window_and_costs, local_path)
    command = jnp.where(path_complete, command, 0.0)
    command, waiting_ticks = _recover(scenario, params, memory.waiting_ticks, command, clear & path_complete)
    gap = state.task.goal - robot.position
    arrived = length(gap[0], gap[1]) < params.goal_tolerance
    command, waiting_ticks = jnp.where(arrived, 0.0, command), jnp.where(arrived, 0, waiting_ticks)
    return command, SocialCostmapMemory(memory.successors, window, resistance, wave, path, path_complete, waiting_ticks)


def _start_plan(
    scenario: Scenario, params: SocialCostmapParams, state: State, successors: Array
) -> tuple[Window, Array, Array]:
    """The window around the robot now, its resistance, and the wave before the first sweep."""
    cell = jnp.maximum(GLOBAL_CELL, 0.5 * scenario.robot.radius)
    here = state.robot.position
    window = rolling_window(here, cell, GLOBAL_CELLS)
    x, y = cell_centers(window, GLOBAL_CELLS)
    costs = cell_costs(scenario, params.global_costmap, nearest_people(state, MAX_PEOPLE), x, y)
    reach = 0.5 * (GLOBAL_CELLS - 1) * cell
    places = [here[axis] + reach * jnp.asarray(BORDER_PLACES[axis], float) for axis in (0, 1)]
    table = build_cost_to_go(scenario, state, successors, *places)
    return window, traversal_resistance(costs), initial_wave(scenario, state, table, window, costs)


# Middle, sides and corners of the window, from -1 to 1.
BORDER_PLACES = np.asarray([(0, 1, 1, 0, -1, -1, -1, 0, 1), (0, 0, 1, 1, 1, 0, -1, -1, -1)], float)


def _select(condition: Array, chosen: Tree, other: Tree) -> Tree:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, other)


def _global_path(state: State, window: Window, wave: Array) -> tuple[Array, Array]:
    """(2, PATH_POINTS) m the plan from the robot on, and () bool whether the wave has reached the robot."""
    x, y = descend_wave(wave, window, state.robot.position[0], state.robot.position[1], PATH_POINTS)
    end = wave[cell_index(window, GLOBAL_CELLS, x[0], y[0])]
    path = jnp.stack([jnp.append(state.robot.position[axis], part)[:PATH_POINTS] for axis, part in enumerate((x, y))])
    for _ in range(2):  # grid paths have corners
        path = path.at[:, 1:-1].set(0.25 * (path[:, :-2] + path[:, 2:]) + 0.5 * path[:, 1:-1])
    return path, end < 0.5 * UNREACHED


def _local_map(scenario: Scenario, params: SocialCostmapParams, state: State) -> tuple[Window, Array]:
    """The window in which the local planner drives, and its costs."""
    reach = HORIZON * params.local_planner.top_speed * scenario.robot.max_speed + 0.1
    cell = jnp.maximum(2.0 * reach / LOCAL_CELLS, LOCAL_CELL)
    window = rolling_window(state.robot.position, cell, LOCAL_CELLS)
    people = nearest_people(state, MAX_PEOPLE)
    return window, cell_costs(scenario, params.local_costmap, people, *cell_centers(window, LOCAL_CELLS))


def _local_path(path: Array, here: Array) -> tuple[Array, Array]:
    """x and y (LOCAL_PATH_POINTS,) [m]: the plan (2, PATH_POINTS) from its point nearest to a place (2,) on."""
    nearest = jnp.argmin(length(path[0] - here[0], path[1] - here[1])).astype(jnp.int32)
    index = jnp.minimum(nearest + jnp.arange(LOCAL_PATH_POINTS, dtype=jnp.int32), PATH_POINTS - 1)
    return path[0][index], path[1][index]


def _recover(
    scenario: Scenario, params: SocialCostmapParams, waiting_ticks: Array, command: Array, free: Array
) -> tuple[Array, Array]:
    """The command, or a turn on the spot if there has been no path for too long; and the ticks without one."""
    turning, longer = waiting_ticks < 0, jnp.where(free, 0, waiting_ticks + 1)
    patience, full_turn = (
        clock.to_ticks(time, scenario.time_step) for time in (params.patience, 2.0 * jnp.pi / params.spin)
    )
    lost = longer.astype(patience.dtype) > patience
    after = jnp.where(lost, -jnp.ceil(full_turn).astype(jnp.int32), longer)
    after = jnp.where(turning, waiting_ticks + 1, after)
    spin = jnp.stack([jnp.zeros((), float), jnp.minimum(params.spin, scenario.robot.max_turn_rate)])
    return jnp.where(turning, spin, command), after


social_costmap = Policy(params=default_params(), name="social_costmap", init=init, apply=apply)
"""The stack of the paper's text; otherwise by ``replace(social_costmap, params=default_params(top_speed=1.0))``."""

move_base = Policy(params=sean2_params(), name="move_base", init=init, apply=apply)
"""The same planner with the maps of SEAN 2.0's public files, on which nobody is."""

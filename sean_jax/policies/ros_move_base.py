"""social_costmap and move_base: ROS's move_base with SEAN's parameters, with the paper's layers [49] or without.

The parts are in two other files: ``costmap`` has the cost maps, the marks of a lidar and the global plan, and
``trajectory_planner`` the local planner. This file has move_base's states:

- PLANNING: it tries to plan 20 times a second. The 11th failure begins the recoveries.
- CONTROLLING: it drives along its last plan, even if no new plan is found. After 5 s without a valid command the
  recoveries begin. (0, 0) is a valid command.
- CLEARING: one recovery, then PLANNING again. The first and the third clear layers named ``obstacles``. SEAN's layer is
  named ``obstacles_layer``, so they do nothing. The second turns, for one control step, for it ends within
  ``yaw_goal_tolerance: 3.14159``. After the third, move_base aborts.
- IDLE: after an abort or at the goal, it stands until SEAN publishes the goal again, which it does each 10 s.

The paper says that the stack has social cost layers. SEAN 2.0's public files for Kuri have their numbers, but the
proxemic layer is commented out, the local map's obstacle layer is disabled, and the global map's has no sensor: no
person is on any map. ``social_costmap`` has the proxemic layer and the marks of a lidar on both maps, ``move_base``
neither.

Differences from ROS are in docs/move_base.md. Gradients of a command are those of the sampled command, by the robot's
speed, turn rate and limits.
"""

from dataclasses import replace
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from sean_jax.core import clock
from sean_jax.core.data_types import Array, Policy, Robot, Scenario, State
from sean_jax.core.devices import parameter, scalar
from sean_jax.core.geometry import length
from sean_jax.policies import costmap
from sean_jax.policies.costmap import LETHAL, UNREACHED, WINDOW, CostmapParams, Window
from sean_jax.policies.prediction import nearest_people
from sean_jax.policies.trajectory_planner import (
    Distances,
    LocalPlannerParams,
    Oscillation,
    best_command,
    initial_oscillation,
)
from sean_jax.robots.drive import require

MAX_PEOPLE = 16  # the nearest, on the maps
PATH_POINTS = 72  # of a plan, half a cell apart
PLANS_PER_SECOND, MAX_RETRIES = 20.0, 10  # planner_frequency, max_planning_retries
CONTROLLER_PATIENCE = 5.0  # s
GOAL_PERIOD = 10.0  # s, after which SEAN publishes the goal again
RECOVERIES, TURN_RECOVERY = 3, 1  # their number, and which of them turns
PLANNING, CONTROLLING, CLEARING, IDLE = 0, 1, 2, 3

Tree = TypeVar("Tree")


@struct.dataclass
class SocialCostmapParams:
    """Parameters of the navigation stack; leaves are () floats."""

    global_costmap: CostmapParams
    local_costmap: CostmapParams
    local_planner: LocalPlannerParams = struct.field(default_factory=LocalPlannerParams)
    goal_tolerance: Float[Array, ""] = parameter(0.35)  # m from the goal, where it stops (xy_goal_tolerance)
    social: bool = struct.field(pytree_node=False, default=True)  # whether the maps have people's personal space
    lidar: bool = struct.field(pytree_node=False, default=True)  # whether the maps have the marks of a lidar


class MoveBaseProgress(NamedTuple):
    """The state of move_base."""

    status: Int[Array, ""]  # PLANNING, CONTROLLING, CLEARING or IDLE
    retries: Int[Array, ""]  # failed plans in a row
    recovery: Int[Array, ""]  # the next one
    by_planning: Bool[Array, ""]  # whether a failed plan, not a failed command, began the last recovery
    invalid_ticks: Int[Array, ""]  # since the last valid command


class SocialCostmapMemory(NamedTuple):
    """The policy's memory: X x Y cells of the whole map, the plan and the states."""

    obstacles: UInt8[Array, "X B"]  # of ``costmap.pack``
    potential: Float[Array, "X Y"]  # of the global plan to the goal, without people and marks
    steps: UInt16[Array, "X Y"]  # to the goal over free cells of the local map, without marks; of ``pack_steps``
    marks: UInt8[Array, "X B"]  # of the lidar, of ``costmap.pack``
    path: Float[Array, "2 points"]  # m, x and y of the last plan
    progress: MoveBaseProgress
    oscillation: Oscillation


def default_params(top_speed: float = 0.6, covariance: float = 0.1) -> SocialCostmapParams:
    """The paper's stack: SEAN's files with the proxemic layer and the lidar's marks on both maps.

    Args:
        top_speed: 1, share of the robot's own top speed.
        covariance: m2, of personal space.
    """
    layers = CostmapParams(covariance=scalar(covariance))
    planner = LocalPlannerParams(top_speed=scalar(top_speed))
    return SocialCostmapParams(replace(layers, inflation=scalar(0.3)), layers, planner)


def sean2_params() -> SocialCostmapParams:
    """The maps of SEAN 2.0's public files, without people and marks.

    Source: yale-sean/social_sim_ros, ``params/kuri``: ``costmap_common_params.yaml`` and ``map_nav_params/*.yaml``.
    """
    return replace(default_params(), social=False, lidar=False)


def init(scenario: Scenario, params: SocialCostmapParams, state: State) -> SocialCostmapMemory:
    """ROS's move_base with SEAN's parameters: social_costmap has people on its maps, move_base nobody.

    Raises:
        InputError: the robot is no differential drive.
    """
    require(scenario.robot, ("differential",), "this planner steers")
    scenario, params, state = jax.lax.stop_gradient((scenario, params, state))
    obstacles = costmap.static_cells(scenario.environment)
    start = _goal_cell(scenario, state, obstacles.shape)
    global_costs, local_costs = _inflated(scenario, params, obstacles)

    # Distances to the goal on the whole map, on which the waves in windows begin.
    cost = costmap.resistance(global_costs)
    potential = costmap.potentials(jnp.where(cost < costmap.BLOCKED, start, UNREACHED), cost)
    steps = costmap.pack_steps(costmap.steps_from(start, local_costs < costmap.INSCRIBED))

    zero = jnp.zeros((), jnp.int32)
    packed = costmap.pack(obstacles)
    return SocialCostmapMemory(
        obstacles=packed,
        potential=potential,
        steps=steps,
        marks=jnp.zeros_like(packed),
        path=jnp.broadcast_to(state.robot.position[:, None], (2, PATH_POINTS)),
        progress=MoveBaseProgress(zero + PLANNING, zero, zero, jnp.zeros((), bool), zero),
        oscillation=initial_oscillation(state.robot),
    )


def _goal_cell(scenario: Scenario, state: State, shape: tuple[int, ...]) -> Array:
    """The start of waves (X, Y) from the goal: 0 in its cell, ``UNREACHED`` elsewhere."""
    origin, cell = costmap.map_frame(scenario.environment)
    last = jnp.asarray(shape, jnp.int32) - 1
    goal = jnp.clip(jnp.floor((state.task.goal - origin) / cell).astype(jnp.int32), 0, last)
    return jnp.full(shape, UNREACHED, float).at[goal[0], goal[1]].set(0.0)


def _inflated(scenario: Scenario, params: SocialCostmapParams, lethal: Array) -> tuple[Array, Array]:
    """Costs of the global and of the local map, without people."""
    _, cell = costmap.map_frame(scenario.environment)
    radius = scenario.robot.radius
    global_costs = costmap.inflate(params.global_costmap, radius, cell, lethal)
    return global_costs, costmap.inflate(params.local_costmap, radius, cell, lethal)


def apply(
    scenario: Scenario, params: SocialCostmapParams, state: State, key: Array
) -> tuple[Float[Array, "2"], SocialCostmapMemory]:
    """The command (2,) [m/s, rad/s] of move_base, and its memory."""
    fixed_scenario, fixed_params, fixed_state = jax.lax.stop_gradient((scenario, params, state))
    memory: SocialCostmapMemory = fixed_state.policy_state
    robot = fixed_state.robot
    window = costmap.window_around(fixed_scenario.environment, robot.position)

    # Maps, the global plan, and what the local planner makes of them.
    memory, global_costs, local_costs = _update_maps(fixed_scenario, fixed_params, fixed_state, window)
    path, planned = _plan(fixed_params, memory, robot, window, global_costs)
    path = jnp.where(planned, path, memory.path)
    distances = _distances(fixed_scenario, fixed_params, fixed_state, memory, window, local_costs, path)
    gap = fixed_state.task.goal - robot.position
    to_goal = length(gap[0], gap[1])
    command, valid, oscillation = best_command(
        scenario.robot, params.local_planner, state.robot, window, distances, memory.oscillation,
        to_goal, scenario.time_step,
    )  # fmt: skip

    # What move_base does with them.
    may_turn = _may_turn(fixed_scenario, robot, window, local_costs)
    arrived = to_goal <= fixed_params.goal_tolerance
    progress, drives, turns = next_progress(
        memory.progress, state.tick, scenario.time_step, planned, valid, arrived, may_turn
    )
    zero = jnp.zeros((), command.dtype)
    turn = jnp.stack([zero, zero + scenario.robot.max_turn_rate])
    command = jnp.where(drives, command, jnp.where(turns, turn, 0.0))
    oscillation = _select(drives | _tried(memory.progress, progress), oscillation, memory.oscillation)
    return command, memory._replace(path=path, progress=progress, oscillation=oscillation)


def _update_maps(
    scenario: Scenario, params: SocialCostmapParams, state: State, window: Window
) -> tuple[SocialCostmapMemory, Array, Array]:
    """The memory with the marks of now, and the costs of the window on the global and on the local map."""
    memory: SocialCostmapMemory = state.policy_state
    lethal = costmap.crop_bits(memory.obstacles, window)
    if params.lidar:
        marks = costmap.update_marks(scenario, state, window, costmap.crop_bits(memory.marks, window))
        memory = memory._replace(marks=costmap.update_bits(memory.marks, window, marks))
        lethal = lethal | marks
    global_costs, local_costs = _inflated(scenario, params, lethal)
    if params.social:
        people = nearest_people(state, MAX_PEOPLE)
        global_costs = jnp.maximum(global_costs, costmap.social_costs(params.global_costmap, people, window))
        local_costs = jnp.maximum(local_costs, costmap.social_costs(params.local_costmap, people, window))
    return memory, global_costs, local_costs


def _plan(
    params: SocialCostmapParams, memory: SocialCostmapMemory, robot: Robot, window: Window, costs: Array
) -> tuple[Array, Array]:
    """(2, PATH_POINTS) m, the global plan from the robot on; and () bool, whether there is one."""
    i, j = costmap.cell_index(window, robot.position[0], robot.position[1])
    cost = costmap.resistance(costs.at[i, j].set(0.0))
    potential = costmap.crop(memory.potential, window)
    if params.social or params.lidar:
        is_free = cost < costmap.BLOCKED
        start = costmap.from_border(jnp.where(is_free, potential, UNREACHED), is_free)
        potential = costmap.potentials(start, cost)
    planned = potential[i, j] < UNREACHED
    place = (robot.position - window.origin) / window.cell - 0.5
    x, y = costmap.descend(potential, place[0], place[1], PATH_POINTS)
    return window.origin[:, None] + window.cell * (jnp.stack([x, y]) + 0.5), planned


def _distances(
    scenario: Scenario,
    params: SocialCostmapParams,
    state: State,
    memory: SocialCostmapMemory,
    window: Window,
    costs: Array,
    path: Array,
) -> Distances:
    """What the local planner reads of each cell of the window."""
    free = costs < costmap.INSCRIBED
    goal = costmap.crop_steps(memory.steps, window)
    if params.lidar:
        goal = costmap.steps_from(costmap.from_border(goal, free), free)
    start = jnp.full((WINDOW, WINDOW), UNREACHED, float).at[costmap.cell_index(window, path[0], path[1])].set(0.0)
    footprint = costmap.footprint_cells(scenario, state, window)
    return Distances(costs, costmap.steps_from(start, free | footprint), goal)


def _may_turn(scenario: Scenario, robot: Robot, window: Window, costs: Array) -> Array:
    """() bool, whether a whole turn on the spot keeps the footprint's edge off obstacles."""
    angle = jnp.linspace(0.0, 2.0 * jnp.pi / costmap.FOOTPRINT_CORNERS, 24, dtype=float)
    x = jnp.full_like(angle, robot.position[0])
    y = jnp.full_like(angle, robot.position[1])
    corner_x, corner_y = costmap.footprint(scenario.robot.radius, x, y, angle)
    return (costs[costmap.cell_index(window, corner_x, corner_y)] < LETHAL).all()


def next_progress(
    before: MoveBaseProgress,
    tick: Int[Array, ""],
    time_step: float,
    planned: Bool[Array, ""],
    valid: Bool[Array, ""],
    arrived: Bool[Array, ""],
    may_turn: Bool[Array, ""],
) -> tuple[MoveBaseProgress, Bool[Array, ""], Bool[Array, ""]]:
    """move_base's state after a control step; whether the local planner's command drives, and whether the robot turns.

    Args:
        tick: of the step; SEAN publishes the goal at the first one and each 10 s.
        time_step: s, of a control step.
        planned: whether the global plan reaches the robot.
        valid: whether the local planner has a valid command.
        arrived: whether the robot is at the goal.
        may_turn: whether the turn of the second recovery is free.
    """
    published = tick % clock.ceil_ticks(GOAL_PERIOD, time_step) == 0
    new_goal = MoveBaseProgress(*(jnp.zeros_like(field) for field in before))._replace(by_planning=before.by_planning)
    progress = _select(published, new_goal, before)

    # One recovery a control step, before a plan or a command.
    clearing = progress.status == CLEARING
    turns = clearing & (progress.recovery == TURN_RECOVERY) & may_turn
    progress = _recover(progress, clearing)
    progress = _count_plans(progress, clearing, planned, time_step)
    progress, drives = _count_commands(progress, clearing, valid, arrived, time_step)
    status, retries, recovery, by_planning, invalid_ticks = progress
    after = MoveBaseProgress(
        status.astype(jnp.int32),
        retries.astype(jnp.int32),
        recovery.astype(jnp.int32),
        by_planning,
        invalid_ticks.astype(jnp.int32),
    )
    return after, drives, turns


def _recover(progress: MoveBaseProgress, clearing: Array) -> MoveBaseProgress:
    """The state after a recovery; after the last one move_base aborts."""
    recovered = clearing & (progress.recovery < RECOVERIES)
    status = jnp.where(clearing, jnp.where(recovered, PLANNING, IDLE), progress.status)
    recovery = jnp.where(recovered, progress.recovery + 1, progress.recovery)
    return progress._replace(
        status=status,
        recovery=jnp.where(clearing & ~recovered, 0, recovery),
        retries=jnp.where(recovered, 0, progress.retries),
    )


def _count_plans(progress: MoveBaseProgress, clearing: Array, planned: Array, time_step: float) -> MoveBaseProgress:
    """The state after the plans of a control step, of which too many failures begin a recovery."""
    planning = ~clearing & (progress.status == PLANNING)
    tries = clock.ceil_ticks(time_step, 1.0 / PLANS_PER_SECOND)
    retries = jnp.where(planning, jnp.where(planned, 0, progress.retries + tries), progress.retries)
    gives_up = planning & ~planned & (retries > MAX_RETRIES)
    status = jnp.where(gives_up, CLEARING, progress.status)
    status = jnp.where(planning & planned, CONTROLLING, status)

    # A plan ends the recoveries that failed plans began.
    by_planning = progress.by_planning | gives_up
    active = (status == PLANNING) | (status == CONTROLLING)
    ends_recoveries = active & ~clearing & planned & by_planning
    recovery = jnp.where(ends_recoveries, 0, progress.recovery)
    return progress._replace(status=status, retries=retries, recovery=recovery, by_planning=by_planning)


def _count_commands(
    progress: MoveBaseProgress, clearing: Array, valid: Array, arrived: Array, time_step: float
) -> tuple[MoveBaseProgress, Array]:
    """The state after a command, of which no valid one for too long begins a recovery; and whether it drives."""
    controlling = ~clearing & (progress.status == CONTROLLING)
    tries_command = controlling & ~arrived
    drives = tries_command & valid
    recovery = jnp.where(drives & ~progress.by_planning, 0, progress.recovery)
    invalid_ticks = jnp.where(drives, 0, progress.invalid_ticks + 1)

    lost = tries_command & ~valid
    impatient = lost & (invalid_ticks > clock.ceil_ticks(CONTROLLER_PATIENCE, time_step))
    status = jnp.where(impatient, CLEARING, jnp.where(lost, PLANNING, progress.status))
    status = jnp.where(controlling & arrived, IDLE, status)
    retries = jnp.where(lost, 0, progress.retries)
    by_planning = progress.by_planning & ~impatient
    return MoveBaseProgress(status, retries, recovery, by_planning, invalid_ticks), drives


def _tried(before: MoveBaseProgress, after: MoveBaseProgress) -> Array:
    """Whether the local planner looked for a command and found none."""
    return after.invalid_ticks > before.invalid_ticks


def _select(condition: Array, chosen: Tree, other: Tree) -> Tree:
    return jax.tree.map(lambda chosen, other: jnp.where(condition, chosen, other), chosen, other)


social_costmap = Policy(params=default_params(), name="social_costmap", init=init, apply=apply)
"""The stack of the paper's text; otherwise by ``replace(social_costmap, params=default_params(top_speed=1.0))``."""

move_base = Policy(params=sean2_params(), name="move_base", init=init, apply=apply, sensing="raw")
"""The same stack with the maps of SEAN 2.0's public files, on which nobody is."""

"""The cost maps of ROS's navigation stack and the distances on them, for ``social_costmap`` and ``move_base``.

The cells are 0.1 m wide and cover the floor. Obstacles, the marks of a lidar and the distances to the goal are kept
for the whole map. What people and marks change is computed in a window of 64 x 64 cells around the robot: there the
waves start at the border with the distances that hold without people and marks.

Costs are as in costmap_2d: 254 is an obstacle, 253 lies within the robot's radius of an obstacle, 0 is free. Layers are
added in this order: obstacles, marks, inflation, personal space. Inflation ends at its own radius: with 0.1 m only the
four neighbors of an obstacle's cell cost 253, though the robot's radius is 0.16 m.

Sources: ros-planning/navigation, noetic-devel at 9ad6441 (costmap_2d, global_planner, base_local_planner);
DLu/navigation_layers at a9ee49b (proxemic layer).
"""

import functools
import itertools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from sean_jax import sensors
from sean_jax.core.data_types import Array, Environment, Pedestrians, Scenario, State
from sean_jax.core.devices import parameter
from sean_jax.core.geometry import from_rectangle, length, nearby_obstacles, rotate, to_border
from sean_jax.policies import wave_kernel
from sean_jax.sensors.lidars import lidar_directions

CELLS_PER_BIN = 10  # cells along a side of a cell of the environment's obstacle grid, which is 1 m wide
MAX_MAP_CELLS = 1_000_000  # larger floors have wider cells
WINDOW = 64  # cells along a side
MARGIN = WINDOW // 2  # cells around the floor
LETHAL, INSCRIBED, MAX_COST = 254.0, 253.0, 252.0
NEUTRAL_COST, COST_FACTOR = 50.0, 3.0  # of global_planner: cost of a free cell, and weight of the map
UNREACHED, BLOCKED = 1e6, 2e6  # distance of cells that no wave reaches, and cost of cells that stop a wave
MOST_STEPS = 65_535  # in a memory; as many or more count as UNREACHED (6.5 km)
TOUCH = 1e-4  # m, by which obstacles may reach into a cell
MAX_INFLATION = 3  # cells
MARK_RANGE, CLEAR_RANGE = 2.5, 3.0  # m (obstacle_range, raytrace_range)
FOOTPRINT_CORNERS = 16

Rule = Callable[[Array, Array, Array], Array]
"""The value of a cell by the lower neighbors of each axis and by its cost."""


@struct.dataclass
class CostmapParams:
    """Parameters of a cost map's layers; all leaves are () floats. The numbers are those of SEAN's files."""

    amplitude: Float[Array, ""] = parameter(77.0)  # A, cost in the middle of a person
    cutoff: Float[Array, ""] = parameter(10.0)  # lower costs become 0
    covariance: Float[Array, ""] = parameter(0.1)  # m2, C of a standing person; ROS's default is 0.25
    factor: Float[Array, ""] = parameter(5.0)  # s/m, by how much longer the Gaussian is ahead for each m/s
    inflation: Float[Array, ""] = parameter(0.1)  # m, reach of inflation (inflation_radius), 3 cells at most
    decay: Float[Array, ""] = parameter(3.0)  # 1/m, of the inflation's cost (cost_scaling_factor)


@struct.dataclass
class Window:
    """A square of ``WINDOW`` x ``WINDOW`` cells of the map around the robot."""

    first: Int[Array, "2"]  # index of its first cell in the map
    origin: Float[Array, "2"]  # m, lower left corner
    cell: Float[Array, ""]  # m, side of a cell


# 1. The map


def cells_per_bin(environment: Environment) -> int:
    """Cells of the map along a side of a cell of the obstacle grid: 10, or fewer on large floors."""
    columns, rows = environment.obstacle_grid.rows.shape[:2]
    largest = math.isqrt(MAX_MAP_CELLS // (columns * rows))
    return max(1, min(CELLS_PER_BIN, largest))


def map_shape(environment: Environment) -> tuple[int, int]:
    """Cells of the map along x and y, with a margin of half a window on all sides."""
    columns, rows = environment.obstacle_grid.rows.shape[:2]
    cells = cells_per_bin(environment)
    return columns * cells + 2 * MARGIN, rows * cells + 2 * MARGIN


def map_frame(environment: Environment) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """The lower left corner [m] of the map, and the side [m] of a cell."""
    grid = environment.obstacle_grid
    cell = grid.cell / cells_per_bin(environment)
    return grid.origin - MARGIN * cell, cell


def static_cells(environment: Environment) -> Bool[Array, "X Y"]:
    """Whether each cell overlaps an obstacle, more than to touch it, or its middle is off a floor with an edge."""
    columns, rows = map_shape(environment)
    origin, cell = map_frame(environment)
    middles = jnp.arange(rows, dtype=float) + 0.5
    y = origin[1] + middles * cell

    def column(index: Array) -> Array:
        middle = origin[0] + (index.astype(y.dtype) + 0.5) * cell
        x = jnp.full_like(y, middle)
        boxes = nearby_obstacles(environment.obstacle_grid, x, y)  # (Y, B, 6)
        center_x, center_y, half_x, half_y, cosine, sine = (boxes[..., field] for field in range(6))

        # A cell overlaps a box if its middle lies in the box grown by half a cell.
        half_x = half_x + 0.5 * cell - TOUCH
        half_y = half_y + 0.5 * cell - TOUCH
        distance, _, _ = from_rectangle(x[:, None], y[:, None], center_x, center_y, half_x, half_y, cosine, sine)
        overlaps = jnp.min(distance, 1) <= 0.0
        is_off = to_border(environment, x, y) <= 0.0
        return overlaps | is_off

    indices = jnp.arange(columns, dtype=jnp.int32)
    return jax.lax.map(column, indices)


def window_around(environment: Environment, place: Float[Array, "2"]) -> Window:
    """The window whose middle cell has a place [m]; at the border of the map for places beyond it."""
    origin, cell = map_frame(environment)
    shape = jnp.asarray(map_shape(environment), jnp.int32)
    last = shape - WINDOW
    middle = jnp.floor((place - origin) / cell).astype(jnp.int32)
    first = jnp.clip(middle - WINDOW // 2, 0, last)
    corner = origin + first.astype(origin.dtype) * cell
    return Window(first, corner, cell)


def crop(cells: Array, window: Window) -> Array:
    """The window of a map."""
    i, j = window.first[0], window.first[1]
    return jax.lax.dynamic_slice(cells, (i, j), (WINDOW, WINDOW))


def pack(cells: Bool[Array, "X Y"]) -> UInt8[Array, "X B"]:
    """A map of bits, with a byte more than it needs: a window may begin within a byte."""
    padded = jnp.pad(cells, ((0, 0), (0, 8)))
    return jnp.packbits(padded, axis=1, bitorder="little")


def crop_bits(packed: UInt8[Array, "X B"], window: Window) -> Bool[Array, "W W"]:
    """The window of a map of bits."""
    i, j = window.first
    rows = _unpack(packed, window)
    return jax.lax.dynamic_slice(rows, (jnp.zeros_like(i), j % 8), (WINDOW, WINDOW))


def update_bits(packed: UInt8[Array, "X B"], window: Window, cells: Bool[Array, "W W"]) -> UInt8[Array, "X B"]:
    """The map of bits with other cells in the window."""
    i, j = window.first
    rows = _unpack(packed, window)
    rows = jax.lax.dynamic_update_slice(rows, cells, (jnp.zeros_like(i), j % 8))
    in_bytes = jnp.packbits(rows, axis=1, bitorder="little")
    return jax.lax.dynamic_update_slice(packed, in_bytes, (i, j // 8))


def _unpack(packed: UInt8[Array, "X B"], window: Window) -> Bool[Array, "W bits"]:
    """The WINDOW + 8 bits of each row in the bytes of the window."""
    i, j = window.first[0], window.first[1]
    rows = jax.lax.dynamic_slice(packed, (i, j // 8), (WINDOW, WINDOW // 8 + 1))
    bits = jnp.unpackbits(rows, axis=1, bitorder="little")
    return bits.astype(bool)


def pack_steps(steps: Float[Array, "X Y"]) -> UInt16[Array, "X Y"]:
    """Steps as whole numbers, ``MOST_STEPS`` at most."""
    return jnp.minimum(steps, MOST_STEPS).astype(jnp.uint16)


def crop_steps(steps: UInt16[Array, "X Y"], window: Window) -> Float[Array, "W W"]:
    """The window of a map of ``pack_steps``."""
    cells = crop(steps, window).astype(float)
    return jnp.where(cells < MOST_STEPS, cells, UNREACHED)


def cell_index(
    window: Window, x: Float[Array, "*shape"], y: Float[Array, "*shape"]
) -> tuple[Int[Array, "*shape"], Int[Array, "*shape"]]:
    """The cells of the window in which places (x, y) [m] lie, or the nearest cells."""
    i, j = _unclipped_cell_index(window, x, y)
    return _clip_cells(i), _clip_cells(j)


def _clip_cells(index: Array) -> Array:
    """Indices of cells along an axis, moved into the window."""
    return jnp.clip(index, 0, WINDOW - 1)


def _unclipped_cell_index(
    window: Window, x: Float[Array, "*shape"], y: Float[Array, "*shape"]
) -> tuple[Int[Array, "*shape"], Int[Array, "*shape"]]:
    """The cells in which places (x, y) [m] lie, counted from the window's first cell."""
    i = jnp.floor((x - window.origin[0]) / window.cell).astype(jnp.int32)
    j = jnp.floor((y - window.origin[1]) / window.cell).astype(jnp.int32)
    return i, j


def cell_middles(window: Window) -> tuple[Float[Array, "W 1"], Float[Array, "1 W"]]:
    """x [m] of the middles of the window's columns, and y [m] of the middles of its rows."""
    steps = (jnp.arange(WINDOW, dtype=float) + 0.5) * window.cell
    x = window.origin[0] + steps
    y = window.origin[1] + steps
    return x[:, None], y[None, :]


# 2. Layers


def footprint(
    radius: Float[Array, ""], x: Float[Array, "*shape"], y: Float[Array, "*shape"], yaw: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape 16"], Float[Array, "*shape 16"]]:
    """x and y [m] of the 16 corners of the robot's footprint at poses [m, m, rad]."""
    angle = 2.0 * np.pi / FOOTPRINT_CORNERS * np.arange(FOOTPRINT_CORNERS)
    angle = angle.reshape((1,) * yaw.ndim + (-1,))  # (..., 16)
    ahead = radius * jnp.asarray(np.cos(angle), float)
    left = radius * jnp.asarray(np.sin(angle), float)

    cosine = jnp.cos(yaw)[..., None]
    sine = jnp.sin(yaw)[..., None]
    dx, dy = rotate(ahead, left, cosine, sine)
    return x[..., None] + dx, y[..., None] + dy


def footprint_cells(scenario: Scenario, state: State, window: Window) -> Bool[Array, "W W"]:
    """Whether each cell of the window is in the robot's footprint or has a corner of it."""
    radius = scenario.robot.radius
    robot_x, robot_y = state.robot.position[0], state.robot.position[1]
    x, y = cell_middles(window)
    inside = length(x - robot_x, y - robot_y) <= radius

    heading = state.robot.heading
    yaw = jnp.arctan2(heading[1], heading[0])
    corner_x, corner_y = footprint(radius, robot_x, robot_y, yaw)
    corners = cell_index(window, corner_x, corner_y)
    return inside.at[corners].set(True)


def update_marks(scenario: Scenario, state: State, window: Window, marks: Bool[Array, "W W"]) -> Bool[Array, "W W"]:
    """The marks in the window after one scan of the robot's lidar.

    A hit nearer than 2.5 m marks its cell. A ray that hits clears the cells up to its hit, or up to 3 m. SEAN's lidar
    reports a miss as 0, which ROS drops: such a ray clears nothing, so marks stay. The robot's footprint is cleared.
    """
    lidar = sensors.lidar(scenario)
    distance = sensors.scan(scenario, state, lidar)  # (R,)
    hit = distance < lidar.far

    # Where the rays end and where they start.
    position = state.robot.position
    heading = state.robot.heading
    mounts = {mount.name: mount.origin for mount in scenario.robot.mounts}
    mount = mounts[lidar.name]
    ahead, left = _scan_points(lidar, mount, distance)
    dx, dy = rotate(ahead, left, heading[0], heading[1])
    x = position[0] + dx
    y = position[1] + dy
    mount_dx, mount_dy = rotate(mount[0], mount[1], heading[0], heading[1])
    mount_x = position[0] + mount_dx
    mount_y = position[1] + mount_dy
    start_i, start_j = cell_index(window, mount_x, mount_y)

    # A line to a cell beyond the window keeps its direction; its cells end at 3 m.
    end_i, end_j = _unclipped_cell_index(window, x, y)
    i, j = ray_cells(start_i, start_j, end_i, end_j, window.cell)
    line = _clip_cells(i), _clip_cells(j)
    cleared = jnp.zeros_like(marks).at[line].max(hit[:, None])

    end = cell_index(window, x, y)
    is_mark = hit & (distance < MARK_RANGE)
    marked = jnp.zeros_like(marks).at[end].max(is_mark)
    marks = (marks & ~cleared) | marked
    return marks & ~footprint_cells(scenario, state, window)


def _scan_points(
    lidar: sensors.Lidar, mount: Float[Array, "3"], distance: Float[Array, "R"]
) -> tuple[Float[Array, "R"], Float[Array, "R"]]:
    """Places [m] ahead and left of the robot, in which the rays of a planar lidar end."""
    axes = np.reshape(lidar.axes, (3, 3))
    directions = lidar_directions(lidar)[0] @ axes.T  # (R, 3)
    ahead = mount[0] + distance * jnp.asarray(directions[:, 0], float)
    left = mount[1] + distance * jnp.asarray(directions[:, 1], float)
    return ahead, left


def ray_cells(
    i0: Int[Array, ""], j0: Int[Array, ""], i1: Int[Array, "R"], j1: Int[Array, "R"], cell: Float[Array, ""]
) -> tuple[Int[Array, "R K"], Int[Array, "R K"]]:
    """Cells of Bresenham's lines from one cell to others, up to ``CLEAR_RANGE``; the last cell of a line repeats."""
    di = i1 - i0
    dj = j1 - j0
    steps = jnp.maximum(jnp.abs(di), jnp.abs(dj))  # of the whole line

    # The share of the line that is within the range, and the number of its last cell.
    line_length = length(di.astype(float), dj.astype(float))
    range_in_cells = jnp.ceil(CLEAR_RANGE / cell - 1e-3)
    share = jnp.minimum(1.0, range_in_cells / jnp.maximum(line_length, 1.0))
    steps_in_range = share * steps.astype(float)
    last = jnp.floor(steps_in_range + 1e-4).astype(jnp.int32)

    number = jnp.arange(WINDOW // 2, dtype=jnp.int32)
    step = jnp.minimum(number[None, :], last[:, None])  # (R, K)
    divisor = jnp.maximum(steps, 1)[:, None]

    def coordinate(start: Array, difference: Array) -> Array:
        size = jnp.abs(difference)[:, None]
        rounded = (step * size + divisor // 2) // divisor
        direction = jnp.sign(difference)[:, None]
        return start + direction * rounded

    return coordinate(i0, di), coordinate(j0, dj)


def inflate(
    params: CostmapParams, radius: Float[Array, ""], cell: Float[Array, ""], lethal: Bool[Array, "X Y"]
) -> Float[Array, "X Y"]:
    """Costs of cells near obstacles: 254 in them, and a whole number by the distance of the cells' middles around them.

    Args:
        radius: m, of the robot.
        cell: m, side of a cell.
    """
    reach = jnp.ceil(params.inflation / cell - 1e-3)  # in cells
    reach = jnp.minimum(reach, MAX_INFLATION)
    costs = jnp.where(lethal, LETHAL, 0.0)
    for square, is_near in _lethal_at_distance(lethal).items():
        cells = math.sqrt(square)
        distance = cells * cell
        decayed = MAX_COST * jnp.exp(-params.decay * (distance - radius))
        cost = jnp.floor(decayed)
        cost = jnp.where(distance <= radius, INSCRIBED, cost)
        cost = jnp.where(is_near & (cells <= reach), cost, 0.0)
        costs = jnp.maximum(costs, cost)
    return costs


def _lethal_at_distance(lethal: Bool[Array, "X Y"]) -> dict[int, Bool[Array, "X Y"]]:
    """Whether cells have a lethal one at a distance, whose square in cells is the key."""
    columns, rows = lethal.shape
    padded = jnp.pad(lethal, MAX_INFLATION)
    shifts = range(2 * MAX_INFLATION + 1)
    near: dict[int, Array] = {}
    for i, j in itertools.product(shifts, shifts):
        square = (i - MAX_INFLATION) ** 2 + (j - MAX_INFLATION) ** 2
        if not 0 < square <= MAX_INFLATION**2:
            continue
        neighbor = padded[i : i + columns, j : j + rows]
        if square in near:
            neighbor = near[square] | neighbor
        near[square] = neighbor
    return near


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
    # The heading; of a standing person any.
    speed = length(vx, vy)
    standing = speed < 1e-6
    divisor = jnp.where(standing, 1.0, speed)
    hx = jnp.where(standing, 1.0, vx / divisor)
    hy = jnp.where(standing, 0.0, vy / divisor)

    along = dx * hx + dy * hy
    across = dy * hx - dx * hy
    stretch = jnp.where(along > 0.0, 1.0 + params.factor * speed, 1.0)
    covariance_along = params.covariance * stretch
    exponent_along = along * along / (2.0 * covariance_along)
    exponent_across = across * across / (2.0 * params.covariance)
    exponent = exponent_along + exponent_across
    cost = params.amplitude * jnp.exp(-exponent)

    remainder = cost - jnp.floor(cost)
    whole = cost - jax.lax.stop_gradient(remainder)
    return jnp.where(cost < params.cutoff, 0.0, whole)


def social_costs(params: CostmapParams, people: Pedestrians, window: Window) -> Float[Array, "W W"]:
    """Costs of the window's cells by the personal space of people."""
    x, y = cell_middles(window)

    def person(position: Array, velocity: Array, present: Array) -> Array:
        dx = x - position[0]
        dy = y - position[1]
        cost = proxemic_cost(params, dx, dy, velocity[0], velocity[1])
        return jnp.where(present, cost, 0.0)

    costs = jax.vmap(person)(people.position, people.velocity, people.present)
    return jnp.max(costs, 0, initial=0.0)


# 3. Distances


def resistance(costs: Float[Array, "X Y"]) -> Float[Array, "X Y"]:
    """What the global plan pays for a cell: 50 + 3 cost, at most 252; ``BLOCKED`` from a cost of 252 on."""
    price = NEUTRAL_COST + COST_FACTOR * costs
    return jnp.where(costs >= MAX_COST, BLOCKED, jnp.minimum(price, MAX_COST))


def potentials(start: Float[Array, "X Y"], cost: Float[Array, "X Y"]) -> Float[Array, "X Y"]:
    """Potentials of the global plan: from the start's values on, by the two nearest neighbors of each cell.

    Args:
        cost: of ``resistance``.

    Source: the quadratic rule of global_planner.
    """

    return _settle(start, cost, _quadratic_rule, 0.01)


def _quadratic_rule(
    a: Float[Array, "*shape"], b: Float[Array, "*shape"], cost: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """The potential of a cell by its lower neighbors of the two axes."""
    lower = jnp.minimum(a, b)
    difference = jnp.abs(a - b)
    share = jnp.minimum(difference / cost, 1.0)
    quadratic = -0.2301 * share * share + 0.5307 * share + 0.7040
    return lower + cost * jnp.where(difference >= cost, 1.0, quadratic)


def steps_from(start: Float[Array, "X Y"], free: Bool[Array, "X Y"]) -> Float[Array, "X Y"]:
    """Steps over the sides of free cells from the start's values on; ``UNREACHED`` in the other cells."""
    cost = jnp.where(free, 1.0, BLOCKED)
    return _settle(start, cost, _step_rule, 0.5)


def _step_rule(
    a: Float[Array, "*shape"], b: Float[Array, "*shape"], cost: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """The steps of a cell by its lower neighbors of the two axes."""
    return jnp.minimum(a, b) + cost


def _settle(wave: Float[Array, "X Y"], cost: Float[Array, "X Y"], rule: Rule, tolerance: float) -> Float[Array, "X Y"]:
    """The wave when a round lowers no cell by more than a tolerance.

    On a CPU a round is four sweeps, which need the fewest operations; on a GPU likewise, for windows, in a kernel.
    Elsewhere it is all cells at once, which needs the fewest programs one after another.
    """

    settle_at_once = functools.partial(_settle_in_rounds, _at_once, rule, tolerance)
    if wave_kernel.supports(wave):
        settle_at_once = functools.partial(wave_kernel.settle, rule, tolerance, UNREACHED)
    sweep = functools.partial(_settle_in_rounds, _four_sweeps, rule, tolerance)
    return jax.lax.platform_dependent(wave, cost, cpu=sweep, default=settle_at_once)


def _settle_in_rounds(
    round_: Callable, rule: Rule, tolerance: float, wave: Float[Array, "X Y"], cost: Float[Array, "X Y"]
) -> Float[Array, "X Y"]:
    """The wave when a round, which computes all cells, lowers none by more than a tolerance."""

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        before, _ = carry
        after = round_(before, cost, rule)
        is_lower = after < before - tolerance
        return after, is_lower.any()

    def goes_on(carry: tuple[Array, Array]) -> Array:
        _, any_is_lower = carry
        return any_is_lower

    settled, _ = jax.lax.while_loop(goes_on, body, (wave, jnp.ones((), bool)))
    return settled


def _four_sweeps(wave: Array, cost: Array, rule: Rule) -> Array:
    """A sweep in each direction."""
    for transpose in (False, True):
        for flip in (False, True):
            wave = _sweep_turned(wave, cost, rule, flip, transpose)
    return wave


def _sweep_turned(wave: Array, cost: Array, rule: Rule, flip: bool, transpose: bool) -> Array:
    """A sweep backward along an axis if ``flip``, and along the other axis if ``transpose``."""
    if transpose:
        wave, cost = wave.T, cost.T
    if flip:
        wave, cost = wave[::-1], cost[::-1]

    wave = _sweep(wave, cost, rule)
    if flip:
        wave = wave[::-1]
    if transpose:
        wave = wave.T
    return wave


def _sweep(wave: Float[Array, "X Y"], cost: Float[Array, "X Y"], rule: Rule) -> Float[Array, "X Y"]:
    """Row by row, each with the new values of the row before."""
    padded = jnp.pad(wave, ((0, 1), (1, 1)), constant_values=UNREACHED)
    horizontal = jnp.minimum(padded[:-1, :-2], padded[:-1, 2:])
    next_rows = padded[1:, 1:-1]

    def settle_row(before: Array, row: tuple[Array, ...]) -> tuple[Array, Array]:
        wave, after, horizontal, cost = row
        vertical = jnp.minimum(before, after)
        settled = jnp.minimum(wave, rule(vertical, horizontal, cost))
        return settled, settled

    edge = jnp.full(wave.shape[1], UNREACHED, wave.dtype)
    _, settled = jax.lax.scan(settle_row, edge, (wave, next_rows, horizontal, cost))
    return settled


def _at_once(wave: Array, cost: Array, rule: Rule) -> Array:
    """Eight times all cells, each from the values before; one after another, so that no value is computed twice."""
    for _ in range(8):
        padded = jnp.pad(wave, 1, constant_values=UNREACHED)
        left, right, down, up = _four_neighbors(jax.lax.optimization_barrier(padded))
        horizontal = jnp.minimum(left, right)
        vertical = jnp.minimum(down, up)
        wave = jnp.minimum(wave, rule(horizontal, vertical, cost))
    return wave


def _four_neighbors(padded: Array) -> tuple[Array, Array, Array, Array]:
    """The left, right, lower and upper neighbors of cells, which are padded by one cell."""
    left = padded[:-2, 1:-1]
    right = padded[2:, 1:-1]
    down = padded[1:-1, :-2]
    up = padded[1:-1, 2:]
    return left, right, down, up


def from_border(field: Float[Array, "W W"], free: Bool[Array, "W W"]) -> Float[Array, "W W"]:
    """The start of a wave in the window: a map's values in free cells at the window's border, and 0 at the goal."""
    border = np.ones((WINDOW, WINDOW), bool)
    border[1:-1, 1:-1] = False
    at_border = jnp.asarray(border) & free
    is_goal = field == 0.0
    return jnp.where(at_border | is_goal, field, UNREACHED)


def descend(
    potential: Float[Array, "W W"], x: Float[Array, ""], y: Float[Array, ""], points: int
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """The plan from a place down the potentials, in half cells, up to the goal or the window's border.

    Args:
        x, y: in cells of the window; whole numbers are middles of cells.
    """
    directions = _descent_directions(potential)
    neighbors = jnp.asarray([(i, j) for i in (0, -1, 1) for j in (0, -1, 1)], jnp.int32)  # the cell itself first

    def step(carry: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], Array]:
        place, before, earlier = carry
        after = _next_place(potential, directions, neighbors, place, earlier)
        return (after, place, before), after

    start = jnp.stack([x, y])
    nowhere = jnp.full_like(start, -1.0)
    _, path = jax.lax.scan(step, (start, nowhere, nowhere), length=points - 1)
    path = jnp.concatenate([start[None], path])
    return path[:, 0], path[:, 1]


def _next_place(
    potential: Float[Array, "W W"],
    directions: Float[Array, "2 W W"],
    neighbors: Int[Array, "9 2"],
    place: Float[Array, "2"],
    earlier: Float[Array, "2"],
) -> Float[Array, "2"]:
    """The place of a plan after ``place``; ``earlier`` is two places before it."""
    cell = jnp.round(place).astype(jnp.int32)
    middle = jnp.clip(cell, 1, WINDOW - 2)
    i = middle[0] + neighbors[:, 0]
    j = middle[1] + neighbors[:, 1]
    near = potential[i, j]  # (9,)
    lowest = middle + neighbors[jnp.argmin(near)]
    lowest = lowest.astype(place.dtype)
    smooth = _half_cell_down(directions, place)

    # Half a cell down the slope, or to the middle of the lowest cell around where the slope is of no use.
    returns = length(*(place - earlier)) < 0.05  # back and forth over a crease
    reached = (near < UNREACHED).all()
    is_smooth = reached & (near[0] > near.min()) & ~returns
    after = jnp.where(is_smooth, smooth, lowest)

    # The plan ends at the goal and at the border.
    inside = (place >= 1.0).all() & (place <= WINDOW - 2.0).all()
    goes_on = inside & (near[0] > 0.0)
    return jnp.where(goes_on, after, place)


def _descent_directions(potential: Float[Array, "W W"]) -> Float[Array, "2 W W"]:
    """Unit vectors down the potentials; 0 in cells that no wave reaches."""
    padded = jnp.pad(potential, 1, constant_values=UNREACHED)
    left, right, down, up = _four_neighbors(padded)
    reached = potential < UNREACHED

    def slope(low: Array, high: Array) -> Array:
        to_low = jnp.where(low < UNREACHED, low - potential, 0.0)
        to_high = jnp.where(high < UNREACHED, potential - high, 0.0)
        return jnp.where(reached, to_low + to_high, 0.0)

    slope_x = slope(left, right)
    slope_y = slope(down, up)
    norm = jnp.maximum(length(slope_x, slope_y), 1e-6)
    return jnp.stack([slope_x / norm, slope_y / norm])


def _half_cell_down(directions: Float[Array, "2 W W"], place: Float[Array, "2"]) -> Float[Array, "2"]:
    """The place half a cell farther in the direction between those of four cells (bilinear)."""
    corner = jnp.floor(place).astype(jnp.int32)
    corner = jnp.clip(corner, 0, WINDOW - 2)
    i, j = corner
    cells = jax.lax.dynamic_slice(directions, (jnp.zeros_like(i), i, j), (2, 2, 2))

    share_i, share_j = place - corner.astype(place.dtype)
    rows = cells[:, 0] * (1.0 - share_i) + cells[:, 1] * share_i  # (2, 2)
    direction = rows[:, 0] * (1.0 - share_j) + rows[:, 1] * share_j  # (2,)
    size = length(direction[0], direction[1])
    norm = jnp.maximum(size, 1e-6)
    return place + 0.5 * direction / norm

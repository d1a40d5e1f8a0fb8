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
    return max(1, min(CELLS_PER_BIN, math.isqrt(MAX_MAP_CELLS // (columns * rows))))


def map_shape(environment: Environment) -> tuple[int, int]:
    """Cells of the map along x and y, with a margin of half a window on all sides."""
    columns, rows = environment.obstacle_grid.rows.shape[:2]
    each = cells_per_bin(environment)
    return columns * each + 2 * MARGIN, rows * each + 2 * MARGIN


def map_frame(environment: Environment) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """The lower left corner [m] of the map, and the side [m] of a cell."""
    cell = environment.obstacle_grid.cell / cells_per_bin(environment)
    return environment.obstacle_grid.origin - MARGIN * cell, cell


def static_cells(environment: Environment) -> Bool[Array, "X Y"]:
    """Whether each cell overlaps an obstacle, more than to touch it, or its middle is off a floor with an edge."""
    (columns, rows), (origin, cell) = map_shape(environment), map_frame(environment)
    y = origin[1] + (jnp.arange(rows, dtype=float) + 0.5) * cell

    def column(index: Array) -> Array:
        x = jnp.full_like(y, origin[0] + (index.astype(y.dtype) + 0.5) * cell)
        near = nearby_obstacles(environment.obstacle_grid, x, y)
        center_x, center_y, half_x, half_y, cosine, sine = (near[..., part] for part in range(6))
        halves = half_x + 0.5 * cell - TOUCH, half_y + 0.5 * cell - TOUCH
        walls = from_rectangle(x[:, None], y[:, None], center_x, center_y, *halves, cosine, sine)[0]
        return (jnp.min(walls, 1) <= 0.0) | (to_border(environment, x, y) <= 0.0)

    return jax.lax.map(column, jnp.arange(columns, dtype=jnp.int32))


def window_around(environment: Environment, place: Float[Array, "2"]) -> Window:
    """The window whose middle cell has a place [m]; at the border of the map for places beyond it."""
    origin, cell = map_frame(environment)
    last = jnp.asarray(map_shape(environment), jnp.int32) - WINDOW
    first = jnp.clip(jnp.floor((place - origin) / cell).astype(jnp.int32) - WINDOW // 2, 0, last)
    return Window(first, origin + first.astype(origin.dtype) * cell, cell)


def crop(cells: Array, window: Window) -> Array:
    """The window of a map."""
    return jax.lax.dynamic_slice(cells, (window.first[0], window.first[1]), (WINDOW, WINDOW))


def pack(cells: Bool[Array, "X Y"]) -> UInt8[Array, "X B"]:
    """A map of bits, with a byte more than it needs: a window may begin within a byte."""
    return jnp.packbits(jnp.pad(cells, ((0, 0), (0, 8))), axis=1, bitorder="little")


def crop_bits(packed: UInt8[Array, "X B"], window: Window) -> Bool[Array, "W W"]:
    """The window of a map of bits."""
    i, j = window.first
    return jax.lax.dynamic_slice(_unpack(packed, window), (jnp.zeros_like(i), j % 8), (WINDOW, WINDOW))


def update_bits(packed: UInt8[Array, "X B"], window: Window, cells: Bool[Array, "W W"]) -> UInt8[Array, "X B"]:
    """The map of bits with other cells in the window."""
    i, j = window.first
    rows = jax.lax.dynamic_update_slice(_unpack(packed, window), cells, (jnp.zeros_like(i), j % 8))
    return jax.lax.dynamic_update_slice(packed, jnp.packbits(rows, axis=1, bitorder="little"), (i, j // 8))


def _unpack(packed: Array, window: Window) -> Array:
    """(WINDOW, WINDOW + 8) bool, the bytes of the window."""
    rows = jax.lax.dynamic_slice(packed, (window.first[0], window.first[1] // 8), (WINDOW, WINDOW // 8 + 1))
    return jnp.unpackbits(rows, axis=1, bitorder="little").astype(bool)


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
    i = jnp.floor((x - window.origin[0]) / window.cell).astype(jnp.int32)
    j = jnp.floor((y - window.origin[1]) / window.cell).astype(jnp.int32)
    return jnp.clip(i, 0, WINDOW - 1), jnp.clip(j, 0, WINDOW - 1)


def cell_middles(window: Window) -> tuple[Float[Array, "W 1"], Float[Array, "1 W"]]:
    """x [m] of the middles of the window's columns, and y [m] of the middles of its rows."""
    steps = (jnp.arange(WINDOW, dtype=float) + 0.5) * window.cell
    return (window.origin[0] + steps)[:, None], (window.origin[1] + steps)[None, :]


# 2. Layers


def footprint(
    radius: Float[Array, ""], x: Float[Array, "*shape"], y: Float[Array, "*shape"], yaw: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape 16"], Float[Array, "*shape 16"]]:
    """x and y [m] of the 16 corners of the robot's footprint at poses [m, m, rad]."""
    angle = 2.0 * np.pi / FOOTPRINT_CORNERS * np.arange(FOOTPRINT_CORNERS)
    ahead, left = (np.reshape(turn(angle), (1,) * yaw.ndim + (-1,)) for turn in (np.cos, np.sin))
    corners = radius * jnp.asarray(ahead, float), radius * jnp.asarray(left, float)
    ahead, left = rotate(*corners, jnp.cos(yaw)[..., None], jnp.sin(yaw)[..., None])
    return x[..., None] + ahead, y[..., None] + left


def footprint_cells(scenario: Scenario, state: State, window: Window) -> Bool[Array, "W W"]:
    """Whether each cell of the window is in the robot's footprint or has a corner of it."""
    robot, radius = state.robot, scenario.robot.radius
    x, y = cell_middles(window)
    inside = length(x - robot.position[0], y - robot.position[1]) <= radius
    yaw = jnp.arctan2(robot.heading[1], robot.heading[0])
    return inside.at[cell_index(window, *footprint(radius, robot.position[0], robot.position[1], yaw))].set(True)


def update_marks(scenario: Scenario, state: State, window: Window, marks: Bool[Array, "W W"]) -> Bool[Array, "W W"]:
    """The marks in the window after one scan of the robot's lidar.

    A hit nearer than 2.5 m marks its cell. A ray that hits clears the cells up to its hit, or up to 3 m. SEAN's lidar
    reports a miss as 0, which ROS drops: such a ray clears nothing, so marks stay. The robot's footprint is cleared.
    """
    lidar = sensors.lidar(scenario)
    distance = sensors.scan(scenario, state, lidar)
    hit = distance < lidar.far
    angle = lidar.first + lidar.span * np.arange(lidar.count) / lidar.count
    rays = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1) @ np.reshape(lidar.axes, (3, 3)).T
    robot = state.robot
    mount = next(mount.origin for mount in scenario.robot.mounts if mount.name == lidar.name)
    ahead, left = (mount[axis] + distance * jnp.asarray(rays[:, axis], float) for axis in (0, 1))
    x, y = rotate(ahead, left, robot.heading[0], robot.heading[1])
    eye_x, eye_y = rotate(mount[0], mount[1], robot.heading[0], robot.heading[1])
    i, j = cell_index(window, robot.position[0] + x, robot.position[1] + y)
    i0, j0 = cell_index(window, robot.position[0] + eye_x, robot.position[1] + eye_y)
    # A line to a cell beyond the window keeps its direction; its cells end at 3 m.
    end_i = jnp.floor((robot.position[0] + x - window.origin[0]) / window.cell).astype(jnp.int32)
    end_j = jnp.floor((robot.position[1] + y - window.origin[1]) / window.cell).astype(jnp.int32)
    cells = (jnp.clip(part, 0, WINDOW - 1) for part in ray_cells(i0, j0, end_i, end_j, window.cell))
    cleared = jnp.zeros_like(marks).at[tuple(cells)].max(hit[:, None])
    marked = jnp.zeros_like(marks).at[i, j].max(hit & (distance < MARK_RANGE))
    return ((marks & ~cleared) | marked) & ~footprint_cells(scenario, state, window)


def ray_cells(
    i0: Int[Array, ""], j0: Int[Array, ""], i1: Int[Array, "R"], j1: Int[Array, "R"], cell: Float[Array, ""]
) -> tuple[Int[Array, "R K"], Int[Array, "R K"]]:
    """Cells of Bresenham's lines from one cell to others, up to ``CLEAR_RANGE``; the last cell of a line repeats."""
    di, dj = i1 - i0, j1 - j0
    long, gap = jnp.maximum(jnp.abs(di), jnp.abs(dj)), length(di.astype(float), dj.astype(float))
    share = jnp.minimum(1.0, jnp.ceil(CLEAR_RANGE / cell - 1e-3) / jnp.maximum(gap, 1.0))
    last = jnp.floor(share * long.astype(float) + 1e-4).astype(jnp.int32)
    step = jnp.minimum(jnp.arange(WINDOW // 2, dtype=jnp.int32)[None, :], last[:, None])
    length_ = jnp.maximum(long, 1)[:, None]

    def along(start: Array, whole: Array) -> Array:
        return start + jnp.sign(whole)[:, None] * ((step * jnp.abs(whole)[:, None] + length_ // 2) // length_)

    return along(i0, di), along(j0, dj)


def inflate(
    params: CostmapParams, radius: Float[Array, ""], cell: Float[Array, ""], lethal: Bool[Array, "X Y"]
) -> Float[Array, "X Y"]:
    """Costs of cells near obstacles: 254 in them, and a whole number by the distance of the cells' middles around them.

    Args:
        radius: m, of the robot.
        cell: m, side of a cell.
    """
    reach = jnp.minimum(jnp.ceil(params.inflation / cell - 1e-3), MAX_INFLATION)
    padded = jnp.pad(lethal, MAX_INFLATION)
    near: dict[int, Array] = {}  # by the squared distance in cells
    for i in range(-MAX_INFLATION, MAX_INFLATION + 1):
        for j in range(-MAX_INFLATION, MAX_INFLATION + 1):
            square = i * i + j * j
            if 0 < square <= MAX_INFLATION * MAX_INFLATION:
                first = MAX_INFLATION + i, MAX_INFLATION + j
                part = padded[first[0] : first[0] + lethal.shape[0], first[1] : first[1] + lethal.shape[1]]
                near[square] = near[square] | part if square in near else part
    costs = jnp.where(lethal, LETHAL, 0.0)
    for square, cells in near.items():
        gap = math.sqrt(square) * cell
        cost = jnp.floor(MAX_COST * jnp.exp(-params.decay * (gap - radius)))
        cost = jnp.where(gap <= radius, INSCRIBED, cost)
        costs = jnp.maximum(costs, jnp.where(cells & (math.sqrt(square) <= reach), cost, 0.0))
    return costs


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


def social_costs(params: CostmapParams, people: Pedestrians, window: Window) -> Float[Array, "W W"]:
    """Costs of the window's cells by the personal space of people."""
    x, y = cell_middles(window)

    def person(position: Array, velocity: Array, present: Array) -> Array:
        cost = proxemic_cost(params, x - position[0], y - position[1], velocity[0], velocity[1])
        return jnp.where(present, cost, 0.0)

    costs = jax.vmap(person)(people.position, people.velocity, people.present)
    return jnp.max(costs, 0, initial=0.0)


# 3. Distances


def resistance(costs: Float[Array, "X Y"]) -> Float[Array, "X Y"]:
    """What the global plan pays for a cell: 50 + 3 cost, at most 252; ``BLOCKED`` from a cost of 252 on."""
    return jnp.where(costs >= MAX_COST, BLOCKED, jnp.minimum(NEUTRAL_COST + COST_FACTOR * costs, MAX_COST))


def potentials(start: Float[Array, "X Y"], cost: Float[Array, "X Y"]) -> Float[Array, "X Y"]:
    """Potentials of the global plan: from the start's values on, by the two nearest neighbors of each cell.

    Args:
        cost: of ``resistance``.

    Source: the quadratic rule of global_planner.
    """

    def rule(one: Array, other: Array, cost: Array) -> Array:
        low, gap = jnp.minimum(one, other), jnp.abs(one - other)
        share = jnp.minimum(gap / cost, 1.0)
        return low + cost * jnp.where(gap >= cost, 1.0, -0.2301 * share * share + 0.5307 * share + 0.7040)

    return _settle(start, cost, rule, 0.01)


def steps_from(start: Float[Array, "X Y"], free: Bool[Array, "X Y"]) -> Float[Array, "X Y"]:
    """Steps over the sides of free cells from the start's values on; ``UNREACHED`` in the other cells."""
    cost = jnp.where(free, 1.0, BLOCKED)
    return _settle(start, cost, lambda one, other, cost: jnp.minimum(one, other) + cost, 0.5)


def _settle(wave: Array, cost: Array, rule: Callable[[Array, Array, Array], Array], tolerance: float) -> Array:
    """The wave when a round lowers no cell by more than a tolerance.

    On a CPU a round is four sweeps, which need the fewest operations; on a GPU likewise, for windows, in a kernel.
    Elsewhere it is all cells at once, which needs the fewest programs one after another.
    """

    def settle(round_: Callable, wave: Array, cost: Array) -> Array:
        def body(now: tuple[Array, Array]) -> tuple[Array, Array]:
            after = round_(now[0], cost, rule)
            return after, (after < now[0] - tolerance).any()

        return jax.lax.while_loop(lambda now: now[1], body, (wave, jnp.ones((), bool)))[0]

    sweeps, other = (functools.partial(settle, each) for each in (_four_sweeps, _at_once))
    if wave_kernel.supports(wave):
        other = functools.partial(wave_kernel.settle, rule, tolerance, UNREACHED)
    return jax.lax.platform_dependent(wave, cost, cpu=sweeps, default=other)


def _four_sweeps(wave: Array, cost: Array, rule: Callable[[Array, Array, Array], Array]) -> Array:
    """A sweep in each direction."""

    def sweep(wave: Array, cost: Array) -> Array:
        """Row by row, each with the new values of the row before."""
        padded = jnp.pad(wave, ((0, 1), (1, 1)), constant_values=UNREACHED)
        beside = jnp.minimum(padded[:-1, :-2], padded[:-1, 2:])

        def row(before: Array, here: tuple[Array, ...]) -> tuple[Array, Array]:
            own, after, beside, cost = here
            value = jnp.minimum(own, rule(jnp.minimum(before, after), beside, cost))
            return value, value

        edge = jnp.full(wave.shape[1], UNREACHED, wave.dtype)
        return jax.lax.scan(row, edge, (wave, padded[1:, 1:-1], beside, cost))[1]

    for flip, turn in ((False, False), (True, False), (False, True), (True, True)):
        parts = [part.T if turn else part for part in (wave, cost)]
        parts = [part[::-1] if flip else part for part in parts]
        wave = sweep(*parts)
        wave = wave[::-1] if flip else wave
        wave = wave.T if turn else wave
    return wave


def _at_once(wave: Array, cost: Array, rule: Callable[[Array, Array, Array], Array]) -> Array:
    """Eight times all cells, each from the values before; one after another, so that no value is computed twice."""
    for _ in range(8):
        padded = jax.lax.optimization_barrier(jnp.pad(wave, 1, constant_values=UNREACHED))
        beside = jnp.minimum(padded[:-2, 1:-1], padded[2:, 1:-1]), jnp.minimum(padded[1:-1, :-2], padded[1:-1, 2:])
        wave = jnp.minimum(wave, rule(*beside, cost))
    return wave


def from_border(field: Float[Array, "W W"], free: Bool[Array, "W W"]) -> Float[Array, "W W"]:
    """The start of a wave in the window: a map's values in free cells at the window's border, and 0 at the goal."""
    edge = np.ones((WINDOW, WINDOW), bool)
    edge[1:-1, 1:-1] = False
    return jnp.where((jnp.asarray(edge) & free) | (field == 0.0), field, UNREACHED)


def descend(
    potential: Float[Array, "W W"], x: Float[Array, ""], y: Float[Array, ""], points: int
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """The plan from a place down the potentials, in half cells, up to the goal or the window's border.

    Args:
        x, y: in cells of the window; whole numbers are middles of cells.
    """
    padded = jnp.pad(potential, 1, constant_values=UNREACHED)
    left, right, down, up = padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]

    def slope(low: Array, high: Array) -> Array:
        return jnp.where(low < UNREACHED, low - potential, 0.0) + jnp.where(high < UNREACHED, potential - high, 0.0)

    reached = potential < UNREACHED
    ahead = jnp.where(reached, slope(left, right), 0.0), jnp.where(reached, slope(down, up), 0.0)
    norm = jnp.maximum(length(*ahead), 1e-6)
    ahead = jnp.stack([part / norm for part in ahead])
    around = jnp.asarray([(i, j) for i in (0, -1, 1) for j in (0, -1, 1)], jnp.int32)

    def step(last: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], Array]:
        here, before, earlier = last
        middle = jnp.clip(jnp.round(here).astype(jnp.int32), 1, WINDOW - 2)
        near = potential[middle[0] + around[:, 0], middle[1] + around[:, 1]]
        lowest = (middle + around[jnp.argmin(near)]).astype(here.dtype)
        corner = jnp.clip(jnp.floor(here).astype(jnp.int32), 0, WINDOW - 2)
        share = here - corner.astype(here.dtype)
        four = jax.lax.dynamic_slice(ahead, (jnp.zeros_like(corner[0]), corner[0], corner[1]), (2, 2, 2))
        rows = four[:, 0] * (1.0 - share[0]) + four[:, 1] * share[0]
        direction = rows[:, 0] * (1.0 - share[1]) + rows[:, 1] * share[1]
        smooth = here + 0.5 * direction / jnp.maximum(length(direction[0], direction[1]), 1e-6)
        returns = length(*(here - earlier)) < 0.05  # back and forth over a crease
        after = jnp.where((near < UNREACHED).all() & (near[0] > near.min()) & ~returns, smooth, lowest)
        inside = (here >= 1.0).all() & (here <= WINDOW - 2.0).all()
        after = jnp.where(inside & (near[0] > 0.0), after, here)
        return (after, here, before), after

    start = jnp.stack([x, y])
    nowhere = jnp.full_like(start, -1.0)
    _, path = jax.lax.scan(step, (start, nowhere, nowhere), length=points - 1)
    path = jnp.concatenate([start[None], path])
    return path[:, 0], path[:, 1]

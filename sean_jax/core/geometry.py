"""Plane geometry in components, with finite gradients everywhere: lengths, angles, upright boxes, obstacles by cell.

Most functions take scalars, or arrays (...) that broadcast, and not vectors with a trailing axis of two: on a GPU the
layout decides the speed of a pairwise law.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core.data_types import FAR, Array, Environment, ObstacleGrid, Obstacles, Robot
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError

HOST_BATCH = 8192  # points measured at once on the host
TINY = 1e-24  # a smaller square counts as zero: 1 / sqrt(square) ** 3, in gradients, would overflow
REACH = 3.0  # m, where exp(-d / 0.2 m) is 3e-7
MAX_CELLS = 50_000  # larger floors have wider cells
MAX_ROWS = 5_000_000


def length(x: Array, y: Array) -> Array:
    """Euclidean length of (x, y); zero, with zero gradient, below 1e-12."""
    zero, square = _square(x, y)
    root = jnp.sqrt(square)
    return jnp.where(zero, 0.0, root)


def unit(x: Array, y: Array) -> tuple[Array, Array]:
    """(x, y) divided by its length; (0, 0), with zero gradient, where the length is below 1e-12."""
    zero, square = _square(x, y)
    inverse = 1.0 / jnp.sqrt(square)
    scale = jnp.where(zero, 0.0, inverse)
    unit_x = x * scale
    unit_y = y * scale
    return unit_x, unit_y


def _square(x: Array, y: Array) -> tuple[Array, Array]:
    """Whether the square of a length counts as zero, and the square, or 1 where it does: the root has a gradient."""
    square = x * x + y * y
    zero = square < TINY
    square = jnp.where(zero, 1.0, square)
    return zero, square


def rotate(x: Array, y: Array, cosine: Array, sine: Array) -> tuple[Array, Array]:
    """(x, y) turned counter-clockwise by an angle of that cosine and sine."""
    turned_x = cosine * x - sine * y
    turned_y = sine * x + cosine * y
    return turned_x, turned_y


def ground_velocity(robot: Robot) -> Float[Array, "... 2"]:
    """Velocity [m/s] of a robot over the ground; of a differential drive it is along the heading."""
    heading = robot.heading
    forward = robot.speed[..., None] * heading
    if robot.sideways is None:
        return forward
    left = jnp.stack([-heading[..., 1], heading[..., 0]], -1)
    return forward + robot.sideways[..., None] * left


def sum_vectors(x: Array, y: Array, axis: int) -> tuple[Array, Array]:
    """Sum (x, y) along an axis, as complex numbers.

    XLA fuses this one reduction with the computation of x and y. Two reductions would write x and y to memory first,
    which makes a pairwise law 1.7 times slower on a GPU.
    """
    vectors = jax.lax.complex(x, y)
    total = vectors.sum(axis)
    return total.real, total.imag


def sum_in_pairs(arrays: Sequence[Array], axis: int) -> tuple[Array, ...]:
    """Sum each of several arrays along an axis, two at a time as ``sum_vectors`` does."""
    sums = []
    for i in range(0, len(arrays) - 1, 2):
        sums.extend(sum_vectors(arrays[i], arrays[i + 1], axis))
    if len(arrays) % 2:
        sums.append(arrays[-1].sum(axis))
    return tuple(sums)


def unit_vectors(vectors: Float[Array, "*batch 2"], default: Float[Array, "*default 2"]) -> Float[Array, "*batch 2"]:
    """Vectors scaled to length one; ``default``, which broadcasts, where they are shorter than 1e-12."""
    x = vectors[..., 0]
    y = vectors[..., 1]
    scaled = unit(x, y)
    scaled = jnp.stack(scaled, -1)
    square = x * x + y * y
    zero = square < TINY
    return jnp.where(zero[..., None], default, scaled)


def angle_between(heading: Float[Array, "*batch 2"], target: Float[Array, "*other 2"]) -> Float[Array, "..."]:
    """Signed angle from one direction to another, counter-clockwise, in (-pi, pi]; 0 where one of the two is zero."""
    heading_x = heading[..., 0]
    heading_y = heading[..., 1]
    target_x = target[..., 0]
    target_y = target[..., 1]
    cross = heading_x * target_y - heading_y * target_x
    dot = heading_x * target_x + heading_y * target_y

    # The angle of a zero vector has a gradient, too.
    square = cross * cross + dot * dot
    zero = square < TINY
    cross = jnp.where(zero, 0.0, cross)
    dot = jnp.where(zero, 1.0, dot)
    return jnp.arctan2(cross, dot)


def from_box(x: Array, y: Array, box: Obstacles) -> tuple[Array, Array, Array]:
    """Signed distance [m] from an upright box to points x, y [m], negative inside, and the unit normal (x, y) there.

    The box's fields broadcast with x and y. Outside, the normal points from the nearest point of the box to the point;
    inside, out of the nearest side.
    """
    cx = box.center[..., 0]
    cy = box.center[..., 1]
    hx = box.half_extent[..., 0]
    hy = box.half_extent[..., 1]
    cosine = jnp.cos(box.yaw)
    sine = jnp.sin(box.yaw)
    return from_rectangle(x, y, cx, cy, hx, hy, cosine, sine)


def from_rectangle(
    x: Array, y: Array, cx: Array, cy: Array, hx: Array, hy: Array, cosine: Array, sine: Array
) -> tuple[Array, Array, Array]:
    """``from_box`` of a box in components: its centre cx, cy, half extent hx, hy [m], cosine and sine of its yaw."""
    # The box's own axes u and v, in which it is |u| <= hx, |v| <= hy.
    dx = x - cx
    dy = y - cy
    u, v = rotate(dx, dy, cosine, -sine)
    side_u = jnp.where(u < 0, -1.0, 1.0)
    side_v = jnp.where(v < 0, -1.0, 1.0)
    beyond_u = jnp.abs(u) - hx
    beyond_v = jnp.abs(v) - hy

    # Outside, the nearest point is on a side or a corner; the inner ``where`` keeps the gradient finite inside.
    out_u = jnp.maximum(beyond_u, 0.0)
    out_v = jnp.maximum(beyond_v, 0.0)
    square = out_u * out_u + out_v * out_v
    outside = square > TINY
    inverse = jax.lax.rsqrt(jnp.where(outside, square, 1.0))

    # Inside, the normal points out of the nearest side.
    by_u = beyond_u > beyond_v
    inside_u = jnp.where(by_u, 1.0, 0.0)
    inside_v = jnp.where(by_u, 0.0, 1.0)
    normal_u = jnp.where(outside, out_u * inverse, inside_u) * side_u
    normal_v = jnp.where(outside, out_v * inverse, inside_v) * side_v
    normal_x, normal_y = rotate(normal_u, normal_v, cosine, sine)

    outside_distance = square * inverse
    depth = jnp.maximum(beyond_u, beyond_v)
    distance = jnp.where(outside, outside_distance, depth)
    return distance, normal_x, normal_y


def signed_distances(
    environment: Environment, points: Float[Array, "P 2"]
) -> tuple[Float[Array, "P"], Float[Array, "P"]]:
    """Signed distances [m] to the nearest obstacle (inf without any) and to the edge of the floor, negative beyond."""
    x = points[:, 0]
    y = points[:, 1]
    to_all_boxes = jax.vmap(_distance_to_box, in_axes=(None, None, 0))
    distances = jax.vmap(to_all_boxes, in_axes=(0, 0, None))(x, y, environment.obstacles)  # (P, W) m
    to_obstacle = jnp.min(distances, axis=1, initial=jnp.inf)
    return to_obstacle, to_edge(environment, x, y)


def _distance_to_box(x: Array, y: Array, box: Obstacles) -> Array:
    distance, _, _ = from_box(x, y, box)
    return distance


def signed_distances_on_host(
    environment: Environment, points: np.ndarray
) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P"]]:
    """``signed_distances`` by numpy in double precision: nothing is compiled for a call that happens once."""
    points = np.asarray(points, float)
    floor = np.asarray(environment.floor, float)
    # Few points at once, as W may be large.
    to_boxes = []
    for batch in np.array_split(points, max(1, len(points) // HOST_BATCH)):
        distances = _distances_to_boxes(environment.obstacles, batch)
        to_boxes.append(distances.min(1, initial=np.inf))
    lower = floor[:2]
    upper = floor[2:]
    to_edges = np.minimum(points - lower, upper - points)  # (P, 2) m, in x and in y
    return np.concatenate(to_boxes), to_edges.min(1)


def _distances_to_boxes(boxes: Obstacles, points: np.ndarray) -> np.ndarray:
    """(P, W) signed distances [m] from each box to the points (P, 2) [m], negative inside, by numpy."""
    center = np.asarray(boxes.center, float)
    half = np.asarray(boxes.half_extent, float)
    yaw = np.asarray(boxes.yaw, float)
    cosine = np.cos(yaw)
    sine = np.sin(yaw)

    # How far a point is beyond the sides, along the box's own axes u and v.
    x = points[:, None, 0] - center[:, 0]  # (P, W)
    y = points[:, None, 1] - center[:, 1]
    u = cosine * x + sine * y
    v = cosine * y - sine * x
    beyond_u = np.abs(u) - half[:, 0]
    beyond_v = np.abs(v) - half[:, 1]

    out_u = np.maximum(beyond_u, 0.0)
    out_v = np.maximum(beyond_v, 0.0)
    outside = np.hypot(out_u, out_v)
    depth = np.maximum(beyond_u, beyond_v)
    inside = np.minimum(depth, 0.0)
    return outside + inside


def to_edge(environment: Environment, x: Array, y: Array) -> Array:
    """Signed distance [m] from (x, y) [m] to the nearest edge of the floor, negative beyond it."""
    x_min, y_min, x_max, y_max = environment.floor
    in_x = jnp.minimum(x - x_min, x_max - x)
    in_y = jnp.minimum(y - y_min, y_max - y)
    return jnp.minimum(in_x, in_y)


def to_border(environment: Environment, x: Array, y: Array) -> Array:
    """``to_edge`` where the edge stops people and robots; inf where the floor is open."""
    if environment.open:
        return jnp.full_like(x, jnp.inf)
    return to_edge(environment, x, y)


def crosses_box(px: Array, py: Array, qx: Array, qy: Array, box: Obstacles, radius: Array | float) -> Array:
    """Whether a disc (radius [m]) that moves straight from p to q [m] cuts a box (fields broadcast); touching does not.

    The test is exact, by separating axes: the nearest pair of points is an end of the segment with a point of the box,
    or a corner of the box with a point between the ends. So three directions decide.
    """
    cosine = jnp.cos(box.yaw)
    sine = jnp.sin(box.yaw)
    hu = box.half_extent[..., 0]
    hv = box.half_extent[..., 1]
    cx = box.center[..., 0]
    cy = box.center[..., 1]
    pu, pv = rotate(px - cx, py - cy, cosine, -sine)
    qu, qv = rotate(qx - cx, qy - cy, cosine, -sine)

    # Across the segment: its line passes all corners at the radius or more.
    du = qu - pu
    dv = qv - pv
    square = du * du + dv * dv
    to_center = jnp.abs(qu * dv - qv * du)  # times the length, as are the others
    beyond = to_center - hu * jnp.abs(dv) - hv * jnp.abs(du)
    limit = radius * jnp.sqrt(square)
    moves = square > 0.0
    beside = moves & (beyond >= limit)

    # From the box to each end.
    beyond_p = _separated(pu, pv, qu, qv, hu, hv, radius)
    beyond_q = _separated(qu, qv, pu, pv, hu, hv, radius)
    return ~(beside | beyond_p | beyond_q)


def _separated(pu, pv, qu, qv, hu, hv, radius) -> Array:
    """Whether p and q are both ``radius`` away from the rectangle |u| < hu, |v| < hv, in the direction from it to p."""
    nearest_u = jnp.clip(pu, -hu, hu)
    nearest_v = jnp.clip(pv, -hv, hv)
    du = pu - nearest_u
    dv = pv - nearest_v
    square = du * du + dv * dv
    limit = radius * jnp.sqrt(square)
    is_outside = square > 0.0
    p_is_apart = is_outside & (square >= limit)
    q_du = qu - nearest_u
    q_dv = qv - nearest_v
    along = q_du * du + q_dv * dv  # times the distance of p
    q_is_apart = along >= limit
    return p_is_apart & q_is_apart


# ------------------------------------------------------------------ obstacles by cell


def build_obstacle_grid(obstacles: Obstacles, floor: Float[Array, "4"], cell: float = 1.0) -> ObstacleGrid:
    """Build, on the host, a grid that has for each cell all obstacles within ``REACH`` of any of its points.

    Args:
        floor: (4,) m, x_min, y_min, x_max, y_max.
        cell: m, side of a cell; wider on a floor with more than ``MAX_CELLS`` of them.

    Raises:
        InputError: too many obstacles lie near one place to fit in memory.
    """
    bounds = np.asarray(floor, float)
    lower = bounds[:2]
    size = bounds[2:] - lower
    min_cell = np.sqrt(np.prod(size) / MAX_CELLS)
    cell = max(cell, float(min_cell))
    shape = np.maximum(1, np.ceil(size / cell).astype(int))
    near = _obstacles_near_cells(obstacles, lower, cell, shape)
    counts = near.sum(-1)
    rows_max = max(1, int(counts.max(initial=0)))
    n_rows = shape[0] * shape[1] * rows_max
    if n_rows > MAX_ROWS:
        raise InputError(f"up to {rows_max} obstacles are within {REACH:g} m of one place; use fewer and larger boxes.")

    # Cells with fewer obstacles than others have boxes far away.
    rows = np.zeros((*shape, rows_max, 6))
    rows[..., 0] = FAR
    rows[..., 1] = FAR
    rows[..., 4] = 1.0  # cosine of the yaw
    yaw = np.asarray(obstacles.yaw, float)[:, None]
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    table = np.concatenate([obstacles.center, obstacles.half_extent, cosine, sine], 1)  # (W, 6)
    for i, j in np.argwhere(near.any(-1)):
        index = np.flatnonzero(near[i, j])
        rows[i, j, : len(index)] = table[index]
    return ObstacleGrid(*to_device((rows, lower, np.asarray(cell))))


def _obstacles_near_cells(obstacles: Obstacles, lower: np.ndarray, cell: float, shape: np.ndarray) -> np.ndarray:
    """(X, Y, W) bool, whether an obstacle may be within ``REACH`` of a point of a cell."""
    columns, rows = shape
    x = lower[0] + (np.arange(columns) + 0.5) * cell  # of the middles of the cells
    y = lower[1] + (np.arange(rows) + 0.5) * cell
    count = len(np.asarray(obstacles.yaw))
    near = np.zeros((*shape, count), bool)
    reach = REACH + cell / np.sqrt(2)
    for i in range(columns):  # by column: large floors would need too much memory at once
        column_x = np.full_like(y, x[i])
        column = np.stack([column_x, y], -1)  # (Y, 2) m
        distances = _distances_to_boxes(obstacles, column)  # (Y, W) m
        near[i] = distances <= reach
    return near


def obstacle_cells(
    grid: ObstacleGrid, x: Float[Array, "*places"], y: Float[Array, "*places"]
) -> tuple[Int[Array, "*places"], Int[Array, "*places"]]:
    """The grid's cell of each place x, y [m], or the nearest cell for places off the grid."""
    columns, rows = grid.rows.shape[:2]
    i = _cell_index(x - grid.origin[0], grid.cell, columns)
    j = _cell_index(y - grid.origin[1], grid.cell, rows)
    return i, j


def _cell_index(offset: Array, cell: Array, count: int) -> Array:
    """The index of the cell at an offset [m] from the first of ``count`` cells in a row, or of the nearest one."""
    index = jnp.floor(offset / cell)
    index = index.astype(jnp.int32)
    return jnp.clip(index, 0, count - 1)


def nearby_obstacles(
    grid: ObstacleGrid, x: Float[Array, "*places"], y: Float[Array, "*places"]
) -> Float[Array, "*places K 6"]:
    """Rows of the grid's cell of each place x, y [m], or of the nearest cell for places off the grid."""
    i, j = obstacle_cells(grid, x, y)
    return grid.rows[i, j]

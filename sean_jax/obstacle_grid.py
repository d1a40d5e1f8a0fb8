"""A grid of cells with the obstacles near each: most obstacles are too far away to act on a person or a robot."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.base import Array, ObstacleGrid, Obstacles
from sean_jax.errors import InputError
from sean_jax.platforms import to_device

REACH = 3.0  # m, where exp(-d / 0.2 m) is 3e-7
MAX_CELLS = 50_000  # larger floors have wider cells
MAX_ROWS = 5_000_000
FAR = 1e4  # m, where unused rows lie


def build(obstacles: Obstacles, floor: Float[Array, "4"], cell: float = 1.0, reach: float = REACH) -> ObstacleGrid:
    """Build the grid on the host: for each cell all obstacles within reach of any point of it.

    Args:
        floor: (4,) m, x_min, y_min, x_max, y_max.
        cell: m, side of a cell; wider on a floor with more than ``MAX_CELLS`` of them.
        reach: m.

    Returns:
        The grid, with as many rows K for each cell as the fullest one needs, at least one.

    Raises:
        InputError: too many obstacles lie near one place to fit in memory.
    """
    lower, upper = np.asarray(floor, float)[:2], np.asarray(floor, float)[2:]
    cell = max(cell, float(np.sqrt(np.prod(upper - lower) / MAX_CELLS)))
    count = np.maximum(1, np.ceil((upper - lower) / cell).astype(int))
    x = lower[0] + (np.arange(count[0]) + 0.5) * cell
    y = lower[1] + (np.arange(count[1]) + 0.5) * cell
    center, half = np.asarray(obstacles.center, float), np.asarray(obstacles.half_extent, float)
    cosine, sine = np.cos(np.asarray(obstacles.yaw, float)), np.sin(np.asarray(obstacles.yaw, float))
    near = np.zeros((*count, len(center)), bool)
    for i in range(count[0]):  # by column: large floors would need too much memory at once
        dx, dy = x[i] - center[:, 0], y[:, None] - center[:, 1]  # (W,), (Y, W)
        along, across = np.abs(cosine * dx + sine * dy) - half[:, 0], np.abs(cosine * dy - sine * dx) - half[:, 1]
        near[i] = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)) <= reach + cell / np.sqrt(2)
    rows_max = max(1, int(near.sum(-1).max(initial=0)))
    if count[0] * count[1] * rows_max > MAX_ROWS:
        raise InputError(f"up to {rows_max} obstacles are within {reach:g} m of one place; use fewer and larger boxes.")
    rows = np.zeros((*count, rows_max, 6))
    rows[..., 0], rows[..., 1], rows[..., 4] = FAR, FAR, 1.0
    table = np.concatenate([center, half, cosine[:, None], sine[:, None]], 1)
    for i, j in np.argwhere(near.any(-1)):
        index = np.flatnonzero(near[i, j])
        rows[i, j, : len(index)] = table[index]
    return ObstacleGrid(*to_device((rows, lower, np.asarray(cell))))


def lookup(grid: ObstacleGrid, x: Float[Array, "*places"], y: Float[Array, "*places"]) -> Float[Array, "*places K 6"]:
    """The obstacles near places.

    Args:
        grid: of ``build``.
        x: (...) m.
        y: (...) m.

    Returns:
        (..., K, 6) rows of ``ObstacleGrid`` of the cell of each place, or of the nearest cell for places off the grid.
    """
    max_x, max_y = grid.rows.shape[0] - 1, grid.rows.shape[1] - 1
    i = jnp.clip(jnp.floor((x - grid.origin[0]) / grid.cell).astype(jnp.int32), 0, max_x)
    j = jnp.clip(jnp.floor((y - grid.origin[1]) / grid.cell).astype(jnp.int32), 0, max_y)
    return grid.rows[i, j]

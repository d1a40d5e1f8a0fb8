"""Obstacles near a place, looked up by cell: most of an environment is too far away to be felt or touched."""

import jax.numpy as jnp
import numpy as np

from sean_jax.base import Array, Nearby, Obstacles
from sean_jax.platforms import put

REACH = 3.0  # m: exp(-d / 0.2 m) has fallen to 3e-7 there
MOST_CELLS = 50_000  # the cells of larger floors are wider
MOST_ROWS = 5_000_000
FAR = 1e4  # m, where spare rows lie


def tabulate(obstacles: Obstacles, floor: Array, cell: float = 1.0, reach: float = REACH) -> Nearby:
    """The table for obstacles (W) on a floor (4,) [m]: for each cell all that lie within ``reach`` of any of it.

    Runs on the host, once. The number of rows K is that of the fullest cell, at least one. Raises ValueError for more
    obstacles in one place than there is memory for.
    """
    lower, upper = np.asarray(floor, float)[:2], np.asarray(floor, float)[2:]
    cell = max(cell, float(np.sqrt(np.prod(upper - lower) / MOST_CELLS)))
    count = np.maximum(1, np.ceil((upper - lower) / cell).astype(int))
    x = lower[0] + (np.arange(count[0]) + 0.5) * cell
    y = lower[1] + (np.arange(count[1]) + 0.5) * cell
    center, half = np.asarray(obstacles.center, float), np.asarray(obstacles.half_extent, float)
    cosine, sine = np.cos(np.asarray(obstacles.yaw, float)), np.sin(np.asarray(obstacles.yaw, float))
    felt = np.zeros((*count, len(center)), bool)
    for i in range(count[0]):  # column by column, or large floors would need too much memory
        dx, dy = x[i] - center[:, 0], y[:, None] - center[:, 1]  # (W,), (Y, W)
        along, across = np.abs(cosine * dx + sine * dy) - half[:, 0], np.abs(cosine * dy - sine * dx) - half[:, 1]
        felt[i] = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)) <= reach + cell / np.sqrt(2)
    most = max(1, int(felt.sum(-1).max(initial=0)))
    if count[0] * count[1] * most > MOST_ROWS:
        raise ValueError(f"up to {most} obstacles are within {reach:g} m of one place; use fewer and larger boxes.")
    rows = np.zeros((*count, most, 6))
    rows[..., 0], rows[..., 1], rows[..., 4] = FAR, FAR, 1.0
    table = np.concatenate([center, half, cosine[:, None], sine[:, None]], 1)
    for i, j in np.argwhere(felt.any(-1)):
        near = np.flatnonzero(felt[i, j])
        rows[i, j, : len(near)] = table[near]
    return Nearby(*put((rows, lower, np.asarray(cell))))


def around(nearby: Nearby, x: Array, y: Array) -> Array:
    """(..., K, 6) rows of the obstacles near the places (x, y) [m]; places off the grid take the nearest cell."""
    most_x, most_y = nearby.rows.shape[0] - 1, nearby.rows.shape[1] - 1
    i = jnp.clip(jnp.floor((x - nearby.origin[0]) / nearby.cell).astype(jnp.int32), 0, most_x)
    j = jnp.clip(jnp.floor((y - nearby.origin[1]) / nearby.cell).astype(jnp.int32), 0, most_y)
    return nearby.rows[i, j]

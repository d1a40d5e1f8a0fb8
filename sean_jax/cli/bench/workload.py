"""The crowd of benchmarks and tests: people who start on a jittered grid and cross a square hall with shelves."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core import random_streams
from sean_jax.core.data_types import ObstacleGrid, Obstacles, Pedestrians
from sean_jax.core.geometry import build_obstacle_grid, rotate

DENSITY = 0.1  # people per m2


def side(people: int) -> float:
    """Side [m] of the square hall for so many people."""
    return float(np.sqrt(people / DENSITY))


def boxes(people: int, walls: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (W, 2) [m], half extents (W, 2) [m] and yaws (W,) [rad] of the hall's 0 or at least 4 obstacles.

    The first four are thin outer walls, the others shelves on a lattice.
    """
    if walls == 0:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    half = side(people) / 2 + 1.0
    center = [(-half, 0.0), (half, 0.0), (0.0, -half), (0.0, half)]
    extent = [(0.0, half), (0.0, half), (half, 0.0), (half, 0.0)]
    rows = int(np.ceil(np.sqrt(walls - 4)))
    for k in range(walls - 4):
        spot = (np.array([k % rows, k // rows]) + 0.5) / rows * 2 - 1
        center.append(tuple(spot * side(people) / 2))
        extent.append((min(0.5, half / rows / 4), half / rows / 3))
    yaw = np.where(np.arange(walls) < 4, 0.0, 0.1 * np.arange(walls))
    return np.array(center), np.array(extent), yaw


def crowd(people: int, walls: int, seed: int = 0) -> tuple[Pedestrians, ObstacleGrid | None, dict[str, np.ndarray]]:
    """A crowd outside the shelves whose N people walk toward the center of the hall.

    Returns:
        The people (N), the obstacle grid (None without walls), and the same numbers in float64 by name.

    Raises:
        ValueError: the people do not fit between the walls.
    """
    random = random_streams.generator("bench", seed)
    center, half, yaw = boxes(people, walls)
    rows = int(np.ceil(np.sqrt(4 * people)))
    cell = side(people) / rows
    grid = (np.stack(np.meshgrid(np.arange(rows), np.arange(rows)), -1).reshape(-1, 2) + 0.5) * cell
    grid = grid - side(people) / 2 + random.uniform(-0.5, 0.5, grid.shape) * max(cell - 0.6, 0.0)
    reach = np.sqrt((half**2).sum(-1)) + 0.35 if walls else np.zeros(0)
    free = (np.linalg.norm(grid[:, None] - center[None, 4:], axis=-1) > reach[None, 4:]).all(1)
    grid = grid[free]
    x = grid[random.permutation(len(grid))[:people]]
    if len(x) < people:
        raise ValueError(f"workload: {people} people do not fit between {walls} walls")
    heading = -x / np.linalg.norm(x, axis=-1, keepdims=True)
    preferred = np.clip(random.normal(1.34, 0.26, people), 0.5, 2.2)
    exact = dict(
        x=x, v=heading * preferred[:, None] * random.uniform(0.5, 1.0, (people, 1)), heading=heading,
        desired=heading * preferred[:, None], preferred=preferred, center=center, half=half, yaw=yaw,
    )  # fmt: skip
    exact = {key: value.astype(np.float32).astype(np.float64) for key, value in exact.items()}
    single = {key: jnp.asarray(value, float) for key, value in exact.items()}
    pedestrians = Pedestrians(
        position=single["x"],
        velocity=single["v"],
        heading=single["heading"],
        desired_velocity=single["desired"],
        group=jnp.full(people, -1, jnp.int32),
        walking_group=jnp.full(people, -1, jnp.int32),
        present=jnp.ones(people, bool),
        preferred_speed=single["preferred"],
        robot_distance=jnp.zeros(people, float),
    )
    obstacles = Obstacles(
        center=single["center"], half_extent=single["half"], yaw=single["yaw"],
        height=jnp.full(walls, 2.0, float),
    )  # fmt: skip
    half = side(people) / 2 + 1.0
    floor = jnp.asarray([-half, -half, half, half], float)
    return pedestrians, build_obstacle_grid(obstacles, floor) if walls else None, exact


def repeat(people: Pedestrians, size: int) -> Pedestrians:
    """Copies (size, N) of a crowd (N,), with velocities turned by a different angle in each copy."""
    angle = jnp.linspace(0.0, 0.3, size, dtype=float)[:, None]
    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (size, *leaf.shape)), people)
    vx, vy = rotate(many.velocity[..., 0], many.velocity[..., 1], jnp.cos(angle), jnp.sin(angle))
    return replace(many, velocity=jnp.stack([vx, vy], -1))

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
    area = people / DENSITY  # m2
    return float(np.sqrt(area))


def boxes(people: int, walls: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (W, 2) [m], half extents (W, 2) [m] and yaws (W,) [rad] of the hall's 0 or at least 4 obstacles.

    The first four are thin outer walls, the others shelves on a lattice.
    """
    if walls == 0:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    half = side(people) / 2 + 1.0
    center = [(-half, 0.0), (half, 0.0), (0.0, -half), (0.0, half)]
    extent = [(0.0, half), (0.0, half), (half, 0.0), (half, 0.0)]

    # Shelves in the middles of the cells of a square lattice.
    n_shelves = walls - 4
    rows = max(1, int(np.ceil(np.sqrt(n_shelves))))
    shelf = min(0.5, half / rows / 4), half / rows / 3
    for k in range(n_shelves):
        column, row = k % rows, k // rows
        middle = (np.array([column, row]) + 0.5) / rows  # from 0 to 1
        place = (middle * 2 - 1) * side(people) / 2
        center.append(tuple(place))
        extent.append(shelf)

    index = np.arange(walls)
    yaw = np.where(index < 4, 0.0, 0.1 * index)
    return np.array(center), np.array(extent), yaw


def crowd(people: int, walls: int, seed: int = 0) -> tuple[Pedestrians, ObstacleGrid | None, dict[str, np.ndarray]]:
    """A crowd outside the shelves whose N people walk toward the center of the hall.

    Returns:
        The people (N), the obstacle grid (None without walls), and the same numbers in float64 by name.

    Raises:
        ValueError: the people do not fit between the walls.
    """
    # People start at places that the shelves leave free.
    random = random_streams.generator("bench", seed)
    center, half, yaw = boxes(people, walls)
    shelf_center, shelf_half = center[4:], half[4:]
    free = _free_places(people, shelf_center, shelf_half, random)
    order = random.permutation(len(free))
    position = free[order[:people]]
    if len(position) < people:
        raise ValueError(f"workload: {people} people do not fit between {walls} walls")

    distance = np.linalg.norm(position, axis=-1, keepdims=True)
    heading = -position / distance
    preferred = np.clip(random.normal(1.34, 0.26, people), 0.5, 2.2)
    exact = dict(
        x=position,
        v=heading * preferred[:, None] * random.uniform(0.5, 1.0, (people, 1)),
        heading=heading,
        desired=heading * preferred[:, None],
        preferred=preferred,
        center=center,
        half=half,
        yaw=yaw,
    )
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
    return pedestrians, _grid(people, single) if walls else None, exact


def _free_places(people: int, center: np.ndarray, half: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Places (K, 2) [m] on a jittered grid, outside the shelves of these centers and half extents (W, 2) [m]."""
    rows = int(np.ceil(np.sqrt(4 * people)))
    cell = side(people) / rows
    index = np.arange(rows)
    x, y = np.meshgrid(index, index)
    cells = np.stack([x, y], -1).reshape(-1, 2)
    grid = (cells + 0.5) * cell  # (rows^2, 2)
    most_jitter = max(cell - 0.6, 0.0)
    jitter = random.uniform(-0.5, 0.5, grid.shape) * most_jitter
    places = grid - side(people) / 2 + jitter

    # Outside the circles around the shelves, with room for a body.
    reach = np.sqrt((half**2).sum(-1)) + 0.35  # (W,)
    gap = places[:, None] - center[None]  # (rows^2, W, 2)
    distance = np.linalg.norm(gap, axis=-1)
    is_free = (distance > reach[None]).all(1)
    return places[is_free]


def _grid(people: int, single: dict[str, jax.Array]) -> ObstacleGrid:
    """The walls of a hall by cells."""
    obstacles = Obstacles(
        center=single["center"],
        half_extent=single["half"],
        yaw=single["yaw"],
        height=jnp.full(len(single["yaw"]), 2.0, float),
    )
    half = side(people) / 2 + 1.0
    bounds = jnp.asarray([-half, -half, half, half], float)
    return build_obstacle_grid(obstacles, bounds)


def repeat(people: Pedestrians, size: int) -> Pedestrians:
    """Copies (size, N) of a crowd (N,), with velocities turned by a different angle in each copy."""
    angle = jnp.linspace(0.0, 0.3, size, dtype=float)
    angle = angle[:, None]  # (size, 1)

    def copies(leaf: jax.Array) -> jax.Array:
        return jnp.broadcast_to(leaf, (size, *leaf.shape))

    many = jax.tree.map(copies, people)
    vx = many.velocity[..., 0]
    vy = many.velocity[..., 1]
    vx, vy = rotate(vx, vy, jnp.cos(angle), jnp.sin(angle))
    velocity = jnp.stack([vx, vy], -1)
    return replace(many, velocity=velocity)

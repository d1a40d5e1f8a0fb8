"""The rays of a sensor, in the robot's frame: fixed, so that all scenarios share them (section IV-F).

Rays lie in tiles of neighbours. A tile stores the sector and the slopes that its rays cover, so that bodies outside of
them are never tested. Everything here is numpy on the host, and constant inside jit.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int, Shaped

from sean_jax.base import Array
from sean_jax.raycast.bodies import SHOULDER, STEEP

MAX_HALF_SECTOR = np.deg2rad(85.0)  # of a tile; wider ones exclude no body


@dataclasses.dataclass(frozen=True, eq=False)
class Rays:
    """Tiles of rays in the robot's frame: x ahead, y to the left, z up from the floor."""

    origin: Float[np.ndarray, "3"]  # m, of the sensor
    offset: Float[np.ndarray, "3 tiles rays"] | None  # m, from there to the start of each ray; None: all start there
    direction: Float[np.ndarray, "3 tiles rays"]  # unit vectors
    inverse_rise: Float[np.ndarray, "tiles rays"]  # 1 / the vertical component of the direction
    inverse_run: Float[np.ndarray, "tiles rays"]  # 1 / the square of the horizontal component; 0 for vertical rays
    left: Float[np.ndarray, "tiles 2"]  # inward normal of the left edge of the tile's sector; 0 if it has none
    right: Float[np.ndarray, "tiles 2"]  # inward normal of the right edge
    slope_min: Float[np.ndarray, "tiles"]  # rise over run
    reach: Float[np.ndarray, "tiles"]  # m, maximum horizontal distance before the rays meet the floor
    low: bool  # whether all rays stay below people's shoulders
    grid: tuple[int, int, int, int]  # rows and columns of tiles, rows and columns of a tile
    shape: tuple[int, int]  # rows and columns of the sensor; the last tiles may be larger than needed

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return self.direction.shape[1]


@struct.dataclass
class Beams:
    """The rays of some tiles as arrays; the fields are those of ``Rays``, vectors in components."""

    direction: tuple[Array, Array, Array]  # (tiles, rays) each
    inverse_rise: Float[Array, "tiles rays"]
    inverse_run: Float[Array, "tiles rays"]
    offset: tuple[Array, Array, Array] | None  # (tiles, rays) m each

    @classmethod
    def of(cls, rays: Rays) -> "Beams":
        """All rays as arrays."""
        offset = None if rays.offset is None else _components(rays.offset)
        return cls(_components(rays.direction), jnp.asarray(rays.inverse_rise), jnp.asarray(rays.inverse_run), offset)

    def of_tiles(self, tile: Int[Array, "tasks"]) -> "Beams":
        """The rays of chosen tiles (tasks,)."""
        return jax.tree.map(lambda part: part[tile], self)


def _components(parts: np.ndarray) -> tuple[Array, Array, Array]:
    return jnp.asarray(parts[0]), jnp.asarray(parts[1]), jnp.asarray(parts[2])


def bundle(
    origin: Sequence[float] | np.ndarray,
    direction: np.ndarray,
    tile: tuple[int, int],
    reach: float,
    offset: np.ndarray | None = None,
) -> Rays:
    """Arrange the rays of a sensor in tiles.

    Args:
        origin: (3,) m, of the sensor in the robot's frame.
        direction: (H, W, 3) of any length.
        reach: m, horizontal range of the sensor.
        offset: (H, W, 3) m, from the origin to the start of each ray; None if all start there.
    """
    origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    rows, columns = direction.shape[:2]
    grid, places = _tiles(rows, columns, tile)
    flat = direction.reshape(-1, 3)[places]
    starts = None if offset is None else np.asarray(offset, np.float64).reshape(-1, 3)[places]
    left, right = _sectors(flat, starts is None)
    run = np.linalg.norm(flat[..., :2], axis=-1)
    rise = np.where(np.abs(flat[..., 2]) < STEEP, STEEP, flat[..., 2])
    slope = flat[..., 2] / np.maximum(run, 1e-9)
    highest = slope.max(1)
    with np.errstate(divide="ignore"):
        meets = np.where(highest < 0.0, origin[2] / np.maximum(-highest, 1e-9), np.inf)
    spread = 0.0 if starts is None else float(np.linalg.norm(starts[..., :2], axis=-1).max())
    return Rays(
        origin=origin,
        offset=None if starts is None else _to_components(starts),
        direction=_to_components(flat),
        inverse_rise=(1.0 / rise),
        inverse_run=np.where(run > 1e-6, 1.0 / np.maximum(run, 1e-6) ** 2, 0.0),
        left=left,
        right=right,
        slope_min=slope.min(1),
        reach=(np.minimum(meets, reach) + spread),
        low=starts is None and float(highest.max()) <= 0.0 and origin[2] < SHOULDER,
        grid=grid,
        shape=(rows, columns),
    )


def by_rows(rays: Rays, values: Shaped[Array, "tiles rays"]) -> Shaped[Array, "H W"]:
    """Values of rays, of any type, as the rows of the sensor."""
    down, across, height, width = rays.grid
    image = values.reshape(rays.grid).swapaxes(1, 2).reshape(down * height, across * width)
    return image[: rays.shape[0], : rays.shape[1]]


def _to_components(vectors: np.ndarray) -> np.ndarray:
    """(3, tiles, rays) of (tiles, rays, 3). XLA would otherwise separate the components again at each use."""
    return np.ascontiguousarray(np.moveaxis(vectors, -1, 0))


def _tiles(rows: int, columns: int, tile: tuple[int, int]) -> tuple[tuple[int, int, int, int], np.ndarray]:
    """The grid, and (tiles, rays) indices of rays; beyond the sensor's last row or column, that one is repeated."""
    height, width = min(tile[0], rows), min(tile[1], columns)
    down, across = -(-rows // height), -(-columns // width)
    i = np.minimum(np.arange(down * height), rows - 1).reshape(down, 1, height, 1)
    j = np.minimum(np.arange(across * width), columns - 1).reshape(1, across, 1, width)
    return (down, across, height, width), (i * columns + j).reshape(down * across, height * width)


def _sectors(direction: np.ndarray, from_one_point: bool) -> tuple[np.ndarray, np.ndarray]:
    """Inward normals (tiles, 2) of the left and right edges of the sectors that the rays (tiles, rays, 3) cover."""
    flat = direction[..., :2]
    run = np.linalg.norm(flat, axis=-1, keepdims=True)
    middle = (flat / np.maximum(run, 1e-9)).sum(1)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-9)
    along = (flat * middle[:, None]).sum(-1)
    across = middle[:, None, 0] * flat[..., 1] - middle[:, None, 1] * flat[..., 0]
    angle = np.arctan2(across, along)
    angle_max, angle_min = angle.max(1) + 1e-6, angle.min(1) - 1e-6
    narrow = (run[..., 0].min(1) > 1e-3) & (np.maximum(angle_max, -angle_min) < MAX_HALF_SECTOR) & from_one_point
    yaw = np.arctan2(middle[:, 1], middle[:, 0])
    left = np.stack([np.sin(yaw + angle_max), -np.cos(yaw + angle_max)], -1)
    right = np.stack([-np.sin(yaw + angle_min), np.cos(yaw + angle_min)], -1)
    return np.where(narrow[:, None], left, 0.0), np.where(narrow[:, None], right, 0.0)

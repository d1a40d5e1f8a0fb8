"""The rays of a sensor, in the robot's frame: fixed, so that all scenarios share them (section IV-F).

Rays lie in tiles, neighbours together. A tile knows the sector and the slopes that its rays fill, so that a body
outside of them is never asked about. Everything here is numpy on the host, and constant inside jit.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax.base import Array
from sean_jax.raycast.laws import SHOULDER, STEEP

WIDEST = np.deg2rad(85.0)  # half of a sector; wider ones keep everything


@dataclasses.dataclass(frozen=True, eq=False)
class Rays:
    """``T`` tiles of ``P`` rays. Lengths in metres, the robot's frame: x ahead, y to the left, z up from the floor."""

    origin: np.ndarray  # (3,) m, where the sensor is
    offset: np.ndarray | None  # (3, T, P) m from there to where each ray begins; None: all begin there
    direction: np.ndarray  # (3, T, P) unit vectors
    inverse_rise: np.ndarray  # (T, P) 1 / the vertical part of the direction
    inverse_run: np.ndarray  # (T, P) 1 / the square of the part over the ground, 0 for a vertical ray
    left: np.ndarray  # (T, 2) inward normal of the sector's left edge; 0 where there is none
    right: np.ndarray  # (T, 2) and of its right edge
    lowest: np.ndarray  # (T,) least slope of its rays: rise over run
    reach: np.ndarray  # (T,) m, farthest that its rays get before they meet the floor, over the ground
    low: bool  # whether no ray comes as high as people's shoulders
    grid: tuple[int, int, int, int]  # tiles from top to bottom and side by side, rows and columns of each
    shape: tuple[int, int]  # rows and columns of the sensor; the last tiles may stand over

    @property
    def tiles(self) -> int:
        return self.direction.shape[1]


@struct.dataclass
class Beams:
    """The rays of ``T`` tiles, or of some, as arrays."""

    direction: tuple[Array, Array, Array]  # (T, P) each, x, y and z of unit vectors
    inverse_rise: Array  # (T, P)
    inverse_run: Array  # (T, P)
    offset: tuple[Array, Array, Array] | None  # (T, P) m each

    @classmethod
    def of(cls, rays: Rays) -> "Beams":
        """All rays."""
        offset = None if rays.offset is None else _three(rays.offset)
        return cls(_three(rays.direction), jnp.asarray(rays.inverse_rise), jnp.asarray(rays.inverse_run), offset)

    def of_tiles(self, tile: Array) -> "Beams":
        """Those of the tiles with these numbers (W,)."""
        return jax.tree.map(lambda part: part[tile], self)


def _three(parts: np.ndarray) -> tuple[Array, Array, Array]:
    return jnp.asarray(parts[0]), jnp.asarray(parts[1]), jnp.asarray(parts[2])


def bundle(origin, direction, tile, reach: float, offset=None) -> Rays:
    """The rays (H, W, 3) of a sensor at ``origin`` (3,) m, in tiles of ``tile`` = (rows, columns).

    ``reach`` [m] is the sensor's. ``offset`` (H, W, 3) m, if given, is where each ray begins, from the origin.
    """
    origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    rows, columns = direction.shape[:2]
    grid, places = _tiles(rows, columns, tile)
    flat = direction.reshape(-1, 3)[places]
    begins = None if offset is None else np.asarray(offset, np.float64).reshape(-1, 3)[places]
    left, right = _sectors(flat, begins is None)
    run = np.linalg.norm(flat[..., :2], axis=-1)
    rise = np.where(np.abs(flat[..., 2]) < STEEP, STEEP, flat[..., 2])
    slope = flat[..., 2] / np.maximum(run, 1e-9)
    highest = slope.max(1)
    with np.errstate(divide="ignore"):
        meets = np.where(highest < 0.0, origin[2] / np.maximum(-highest, 1e-9), np.inf)
    spread = 0.0 if begins is None else float(np.linalg.norm(begins[..., :2], axis=-1).max())
    return Rays(
        origin=origin,
        offset=None if begins is None else _apart(begins),
        direction=_apart(flat),
        inverse_rise=(1.0 / rise),
        inverse_run=np.where(run > 1e-6, 1.0 / np.maximum(run, 1e-6) ** 2, 0.0),
        left=left,
        right=right,
        lowest=slope.min(1),
        reach=(np.minimum(meets, reach) + spread),
        low=begins is None and float(highest.max()) <= 0.0 and origin[2] < SHOULDER,
        grid=grid,
        shape=(rows, columns),
    )


def by_rows(rays: Rays, values):
    """(H, W) values of the rays as the sensor has them, from (T, P)."""
    down, across, height, width = rays.grid
    image = values.reshape(rays.grid).swapaxes(1, 2).reshape(down * height, across * width)
    return image[: rays.shape[0], : rays.shape[1]]


def _apart(vectors: np.ndarray) -> np.ndarray:
    """(3, T, P) of (T, P, 3): XLA shall not have to take them apart, which it does anew at each use."""
    return np.ascontiguousarray(np.moveaxis(vectors, -1, 0))


def _tiles(rows: int, columns: int, tile: tuple[int, int]) -> tuple[tuple[int, int, int, int], np.ndarray]:
    """The grid, and (T, P) indices of rays by tile; where tiles stand over, the last row or column is repeated."""
    height, width = min(tile[0], rows), min(tile[1], columns)
    down, across = -(-rows // height), -(-columns // width)
    i = np.minimum(np.arange(down * height), rows - 1).reshape(down, 1, height, 1)
    j = np.minimum(np.arange(across * width), columns - 1).reshape(1, across, 1, width)
    return (down, across, height, width), (i * columns + j).reshape(down * across, height * width)


def _sectors(direction: np.ndarray, from_one_point: bool) -> tuple[np.ndarray, np.ndarray]:
    """Inward normals (T, 2) of the left and right edges of the sector that the rays (T, P, 3) of a tile fill."""
    flat = direction[..., :2]
    run = np.linalg.norm(flat, axis=-1, keepdims=True)
    middle = (flat / np.maximum(run, 1e-9)).sum(1)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-9)
    along = (flat * middle[:, None]).sum(-1)
    across = middle[:, None, 0] * flat[..., 1] - middle[:, None, 1] * flat[..., 0]
    angle = np.arctan2(across, along)
    most, least = angle.max(1) + 1e-6, angle.min(1) - 1e-6
    narrow = (run[..., 0].min(1) > 1e-3) & (np.maximum(most, -least) < WIDEST) & from_one_point
    turn = np.arctan2(middle[:, 1], middle[:, 0])
    left = np.stack([np.sin(turn + most), -np.cos(turn + most)], -1)
    right = np.stack([-np.sin(turn + least), np.cos(turn + least)], -1)
    return np.where(narrow[:, None], left, 0.0), np.where(narrow[:, None], right, 0.0)

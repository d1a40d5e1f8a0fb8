"""The bodies and the rays of a sensor, in the robot's frame (section IV-F).

Rays are fixed, so that all scenarios share them: numpy on the host, and constant inside jit. They lie in tiles of
neighbours. A tile stores the sector and the slopes that its rays cover, so that bodies outside are never tested.
Distances are in metres, ``MISS`` where a ray meets nothing ahead.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax.core.data_types import Array, Solids

MISS = 1e9  # m
STEEP = 1e-9  # smaller components of a direction count as this one

# A person: an upright capsule that stands on the floor, and a round head.
SHOULDER = 1.26  # m above the floor, the middle of the capsule's upper end
HEAD = 1.60  # m, the middle of the head
HEAD_RADIUS = 0.13  # m
AWAY = 1e6  # m, where absent people stand

MAX_HALF_SECTOR = np.deg2rad(85.0)  # of a tile; wider ones exclude no body


@struct.dataclass
class View:
    """Bodies around a sensor, in the robot's axes and from the sensor: x ahead, y to the left, z up.

    Bodies have numbers: first boxes, then cylinders, spheres and people, then the floor, then the sky.
    """

    boxes: Float[Array, "boxes 8"]  # middle x, y, z, half extent x, y, z [m], cosine and sine of the yaw
    cylinders: Float[Array, "cylinders 8"]  # middle x, y, z [m], axis x, y, z, radius, half length [m]
    spheres: Float[Array, "spheres 4"]  # middle x, y, z, radius [m]
    people: Float[Array, "N 2"]  # m
    radius: Float[Array, ""]  # m, of a person's body
    place: Float[Array, "3"]  # m, of the sensor in the robot's frame

    @property
    def height(self) -> Array:
        """() m, of the sensor above the floor."""
        return self.place[2]

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Numbers of boxes, cylinders, spheres and people."""
        return self.boxes.shape[0], self.cylinders.shape[0], self.spheres.shape[0], self.people.shape[0]


def make_view(
    solids: Solids,
    people: Float[Array, "N 2"],
    present: Bool[Array, "N"],
    radius: Float[Array, ""],
    position: Float[Array, "2"],
    heading: Float[Array, "2"],
    origin: Float[Array, "3"],
) -> View:
    """Transform the bodies of the world to the frame of a sensor.

    Args:
        people: m, in the world; absent people are invisible.
        radius: m, of a person's body.
        position, heading: m and unit vector, of the robot.
        origin: m, of the sensor in the robot's frame.
    """
    cosine, sine = heading[0], heading[1]
    place = jnp.asarray(origin, float)

    def transform(x: Array, y: Array) -> tuple[Array, Array]:
        x, y = x - position[0], y - position[1]
        return cosine * x + sine * y - place[0], cosine * y - sine * x - place[1]

    boxes, cylinders, spheres = solids.boxes, solids.cylinders, solids.spheres
    bx, by = transform(boxes[:, 0], boxes[:, 1])
    cx, cy = transform(cylinders[:, 0], cylinders[:, 1])
    sx, sy = transform(spheres[:, 0], spheres[:, 1])
    px, py = transform(people[:, 0], people[:, 1])
    yaw = cosine * boxes[:, 6] + sine * boxes[:, 7], cosine * boxes[:, 7] - sine * boxes[:, 6]
    ax, ay = cosine * cylinders[:, 3] + sine * cylinders[:, 4], cosine * cylinders[:, 4] - sine * cylinders[:, 3]
    return View(
        boxes=jnp.stack([bx, by, boxes[:, 2] - place[2], *boxes[:, 3:6].T, *yaw], -1),
        cylinders=jnp.stack([cx, cy, cylinders[:, 2] - place[2], ax, ay, *cylinders[:, 5:].T], -1),
        spheres=jnp.stack([sx, sy, spheres[:, 2] - place[2], spheres[:, 3]], -1),
        people=jnp.where(present[:, None], jnp.stack([px, py], -1), AWAY),
        radius=radius,
        place=place,
    )


def ground(height: Array, dz: Array, inverse_dz: Array) -> Array:
    """Distance to the floor, ``height`` [m] below the origin of the ray."""
    return jnp.where(dz < 0.0, -height * inverse_dz, MISS)


@dataclasses.dataclass(frozen=True, eq=False)
class Rays:
    """Tiles of rays of a sensor, anywhere on a robot, in its axes: x ahead, y to the left, z up from the floor."""

    offset: (
        Float[np.ndarray, "3 tiles rays"] | None
    )  # m, from the sensor to the start of each ray; None: all start there
    direction: Float[np.ndarray, "3 tiles rays"]  # unit vectors
    inverse_rise: Float[np.ndarray, "tiles rays"]  # 1 / the vertical component of the direction
    inverse_run: Float[np.ndarray, "tiles rays"]  # 1 / the square of the horizontal component; 0 for vertical rays
    left: Float[np.ndarray, "tiles 2"]  # inward normal of the left edge of the tile's sector; 0 if it has none
    right: Float[np.ndarray, "tiles 2"]  # inward normal of the right edge
    slope_min: Float[np.ndarray, "tiles"]  # rise over run
    slope_max: Float[np.ndarray, "tiles"]
    reach: float  # m, horizontal range of the sensor
    spread: float  # m, greatest horizontal distance from the sensor to the start of a ray
    low: bool  # whether all rays stay below people's shoulders
    grid: tuple[int, int, int, int]  # rows and columns of tiles, rows and columns of a tile
    shape: tuple[int, int]  # rows and columns of the sensor; the last tiles may be larger than needed

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return self.direction.shape[1]


@struct.dataclass
class Beams:
    """The rays of some tiles as arrays; the fields of ``Rays``, vectors in components."""

    direction: tuple[Array, Array, Array]  # (tiles, rays) each
    inverse_rise: Float[Array, "tiles rays"]
    inverse_run: Float[Array, "tiles rays"]
    offset: tuple[Array, Array, Array] | None  # (tiles, rays) m each

    @classmethod
    def of(cls, rays: Rays) -> "Beams":
        """All rays as arrays."""
        offset = None if rays.offset is None else _components(rays.offset)
        slopes = jnp.asarray(rays.inverse_rise, float), jnp.asarray(rays.inverse_run, float)
        return cls(_components(rays.direction), *slopes, offset)

    def of_tiles(self, tile: Int[Array, "tasks"]) -> "Beams":
        """The rays of chosen tiles (tasks,)."""
        return jax.tree.map(lambda part: part[tile], self)


def _components(parts: np.ndarray) -> tuple[Array, Array, Array]:
    return jnp.asarray(parts[0], float), jnp.asarray(parts[1], float), jnp.asarray(parts[2], float)


def bundle(
    direction: np.ndarray, tile: tuple[int, int], reach: float, offset: np.ndarray | None = None, low: bool = False
) -> Rays:
    """Arrange the rays of a sensor in tiles.

    Args:
        direction: (H, W, 3) of any length.
        reach: m, horizontal range of the sensor.
        offset: (H, W, 3) m, from the sensor to the start of each ray; None if all start there.
        low: whether the sensor is below people's shoulders; then rays that do not rise are searched faster.
    """
    direction = np.asarray(direction, np.float64)
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
    spread = 0.0 if starts is None else float(np.linalg.norm(starts[..., :2], axis=-1).max())
    return Rays(
        offset=None if starts is None else _to_components(starts),
        direction=_to_components(flat),
        inverse_rise=(1.0 / rise),
        inverse_run=np.where(run > 1e-6, 1.0 / np.maximum(run, 1e-6) ** 2, 0.0),
        left=left,
        right=right,
        slope_min=slope.min(1),
        slope_max=highest,
        reach=reach,
        spread=spread,
        low=low and starts is None and float(highest.max()) <= 0.0,
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

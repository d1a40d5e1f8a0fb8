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
from sean_jax.sensors.raycast.vectors import Vector, to_frame

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
    cosine = heading[0]
    sine = heading[1]
    place = jnp.asarray(origin, float)
    boxes = solids.boxes
    cylinders = solids.cylinders
    spheres = solids.spheres

    def to_sensor(points: Array) -> tuple[Array, Array]:
        x, y = to_frame(points[:, 0] - position[0], points[:, 1] - position[1], cosine, sine)
        return x - place[0], y - place[1]

    # The columns of each table, with places and directions turned to the robot's axes.
    box_yaw = to_frame(boxes[:, 6], boxes[:, 7], cosine, sine)
    box_columns = [*to_sensor(boxes), boxes[:, 2] - place[2], *boxes[:, 3:6].T, *box_yaw]

    axis = to_frame(cylinders[:, 3], cylinders[:, 4], cosine, sine)
    cylinder_columns = [*to_sensor(cylinders), cylinders[:, 2] - place[2], *axis, *cylinders[:, 5:].T]

    sphere_columns = [*to_sensor(spheres), spheres[:, 2] - place[2], spheres[:, 3]]
    visible_people = jnp.where(present[:, None], jnp.stack(to_sensor(people), -1), AWAY)
    return View(
        boxes=jnp.stack(box_columns, -1),
        cylinders=jnp.stack(cylinder_columns, -1),
        spheres=jnp.stack(sphere_columns, -1),
        people=visible_people,
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

    direction: Vector  # (tiles, rays) each
    inverse_rise: Float[Array, "tiles rays"]
    inverse_run: Float[Array, "tiles rays"]
    offset: Vector | None  # (tiles, rays) m each

    @classmethod
    def of(cls, rays: Rays) -> "Beams":
        """All rays as arrays."""
        return cls(
            direction=_vector(rays.direction),
            inverse_rise=jnp.asarray(rays.inverse_rise, float),
            inverse_run=jnp.asarray(rays.inverse_run, float),
            offset=None if rays.offset is None else _vector(rays.offset),
        )

    def of_tiles(self, tile: Int[Array, "tasks"]) -> "Beams":
        """The rays of chosen tiles (tasks,)."""
        return jax.tree.map(lambda leaf: leaf[tile], self)


def _vector(components: np.ndarray) -> Vector:
    return Vector(*(jnp.asarray(component, float) for component in components))


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
    grid, index = _tile_index(rows, columns, tile)
    unit = direction.reshape(-1, 3)[index]  # (tiles, rays, 3)
    start = None if offset is None else np.asarray(offset, np.float64).reshape(-1, 3)[index]
    left, right = _sectors(unit, start is None)

    # Slopes, and reciprocals that no ray divides by zero for.
    run = np.linalg.norm(unit[..., :2], axis=-1)
    rise = unit[..., 2]
    slope = rise / np.maximum(run, 1e-9)
    steepest = slope.max(1)
    inverse_run = np.where(run > 1e-6, 1.0 / np.maximum(run, 1e-6) ** 2, 0.0)
    inverse_rise = 1.0 / np.where(np.abs(rise) < STEEP, STEEP, rise)
    return Rays(
        offset=None if start is None else _to_components(start),
        direction=_to_components(unit),
        inverse_rise=inverse_rise,
        inverse_run=inverse_run,
        left=left,
        right=right,
        slope_min=slope.min(1),
        slope_max=steepest,
        reach=reach,
        spread=0.0 if start is None else float(np.linalg.norm(start[..., :2], axis=-1).max()),
        low=low and start is None and float(steepest.max()) <= 0.0,
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


def _tile_index(rows: int, columns: int, tile: tuple[int, int]) -> tuple[tuple[int, int, int, int], np.ndarray]:
    """The grid, and (tiles, rays) indices of rays; beyond the sensor's last row or column, that one is repeated."""
    height = min(tile[0], rows)
    width = min(tile[1], columns)
    down = -(-rows // height)
    across = -(-columns // width)
    row = np.minimum(np.arange(down * height), rows - 1)
    column = np.minimum(np.arange(across * width), columns - 1)
    index = row.reshape(down, 1, height, 1) * columns + column.reshape(1, across, 1, width)
    return (down, across, height, width), index.reshape(down * across, height * width)


def _sectors(direction: np.ndarray, from_one_point: bool) -> tuple[np.ndarray, np.ndarray]:
    """Inward normals (tiles, 2) of the left and right edges of the sectors that the rays (tiles, rays, 3) cover."""
    flat = direction[..., :2]
    run = np.linalg.norm(flat, axis=-1, keepdims=True)
    middle = (flat / np.maximum(run, 1e-9)).sum(1)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-9)  # (tiles, 2)
    angle = _angles_from(middle, flat)
    angle_max = angle.max(1) + 1e-6
    angle_min = angle.min(1) - 1e-6

    # A tile with a vertical ray, a wide one, and rays from several points have no edges: they exclude no body.
    half_sector = np.maximum(angle_max, -angle_min)
    is_level = run[..., 0].min(1) > 1e-3
    has_edges = (is_level & (half_sector < MAX_HALF_SECTOR) & from_one_point)[:, None]
    yaw = np.arctan2(middle[:, 1], middle[:, 0])
    left_edge = yaw + angle_max
    right_edge = yaw + angle_min
    left = np.stack([np.sin(left_edge), -np.cos(left_edge)], -1)
    right = np.stack([-np.sin(right_edge), np.cos(right_edge)], -1)
    return np.where(has_edges, left, 0.0), np.where(has_edges, right, 0.0)


def _angles_from(middle: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Angles (tiles, rays) [rad] of directions (tiles, rays, 2) from the middle (tiles, 2) of their tile."""
    x = flat[..., 0]
    y = flat[..., 1]
    along = (flat * middle[:, None]).sum(-1)
    across = middle[:, None, 0] * y - middle[:, None, 1] * x
    return np.arctan2(across, along)

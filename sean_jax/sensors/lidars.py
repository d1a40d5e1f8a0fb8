"""Lidars (section IV-F) on every robot: distances and points all around, in one plane or in rings one above the other.

The default is SEAN 2.0's: 360 rays, from 0.12 to 3.5 m, in one plane. A lidar with elevations has one ring of rays for
each. A lidar is a fixed value. Its rays are made once and shared by all scenarios.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, RobotModel, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.sensors.mounts import TILE, bands_of_rise, is_low, sensor_view
from sean_jax.sensors.raycast import Rays, bundle, by_rows, distance

SECTOR = 15  # rays of a tile of a planar lidar, which share the bodies that they may meet
LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # axes of a mount that looks straight ahead


@dataclasses.dataclass(frozen=True)
class Lidar:
    """A lidar on a robot. It measures all rays at the same moment."""

    name = "lidar"  # of its mount
    origin: tuple[float, ...] | None  # (3,) m in the robot's frame; None: of the mount on the scenario's robot
    count: int  # rays, of each ring
    first: float  # rad, of the first ray, counter-clockwise from x about z of the site
    span: float  # rad, that the rays cover together, beginning with the first
    near: float  # m, nearer bodies are invisible
    far: float  # m, farther bodies are invisible
    axes: tuple[float, ...] = LEVEL  # (9,) of ``data_types.Mount``
    low: bool = False  # as of ``data_types.Mount``; with an origin, its height counts
    elevations: tuple[float, ...] = ()  # rad, of each ring above the plane of x and y, ascending; (): one plane


def lidar(
    of: Scenario | RobotModel,
    *,
    count: int = 360,
    first: float = 0.0,
    span: float = 2 * np.pi,
    near: float = 0.12,
    far: float = 3.5,
    elevations: Sequence[float] = (),
) -> Lidar:
    """The lidar of a robot, or of a scenario's robot.

    Args:
        count: number of rays, ``span / count`` rad apart; of each ring.
        first: rad, direction of the first ray, counter-clockwise from straight ahead.
        span: rad, that the rays cover together.
        near, far: m, nothing nearer or farther is visible.
        elevations: rad, of each ring above the horizontal, ascending, such as ``VLP16["elevations"]``; without them
            the lidar measures in one plane.

    Raises:
        InputError: the robot's file has no site 'lidar', there is no ray, the range is empty, or elevations do not
            ascend between -pi/2 and pi/2.
    """
    robot = of.robot if isinstance(of, Scenario) else of
    mount = next((mount for mount in robot.mounts if mount.name == "lidar"), None)
    if mount is None:
        raise InputError(f"lidar: the file of robot '{robot.name}' has no <site name=\"lidar\">; add one to its base.")
    if count < 1:
        raise InputError(f"count: {count} rays see nothing; give 1 or more.")
    if not 0.0 <= near < far:
        raise InputError(f"near, far: {near:g} and {far:g} m must be a lesser and a greater distance.")
    rings = tuple(float(angle) for angle in elevations)
    if not all(below < above for below, above in itertools.pairwise((-np.pi / 2, *rings, np.pi / 2))):
        degrees = ", ".join(f"{angle:g}" for angle in np.rad2deg(rings))
        raise InputError(f"elevations: {degrees} degrees must ascend, each more than -90 and less than 90.")
    return Lidar(None, count, first, span, near, far, mount.axes, mount.low, rings)


VLP16: dict[str, Any] = {
    "count": 1800,
    "near": 0.4,
    "far": 100.0,
    "elevations": tuple(np.deg2rad(np.arange(-15.0, 16.0, 2.0)).tolist()),
}
"""Arguments of ``lidar`` for a Velodyne VLP-16: 16 rings 2 degrees apart, 0.2 degrees from ray to ray, up to 100 m.

Sources: Velodyne Lidar, VLP-16 User Manual, 63-9243 Rev. D, 2018: rings (table 9-1), range, and 0.2 degrees at its 10
turns a second (section 8.3.1); ``near`` is the ``min_range`` of its ROS driver (github.com/ros-drivers/velodyne).
"""
VLP16_DEVIATION = 0.03  # m, of its noise: the typical accuracy that the manual states


def lidar_directions(sensor: Lidar) -> Float[np.ndarray, "rings rays 3"]:
    """Unit vectors along the rays of a lidar in its own frame: x ahead, y to the left, z up; one ring if planar."""
    angle = (sensor.first + sensor.span * np.arange(sensor.count) / sensor.count)[None, :]
    level = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)  # (1, rays, 3)
    elevation = np.asarray(sensor.elevations or (0.0,), float)[:, None, None]
    upward = np.array([0.0, 0.0, 1.0])
    return level * np.cos(elevation) + np.sin(elevation) * upward


@functools.lru_cache(maxsize=64)
def lidar_rays(sensor: Lidar) -> tuple[Rays, ...]:
    """The rays of a lidar in one or two bundles, as of a camera's ``bands``."""
    direction = lidar_directions(sensor) @ np.asarray(sensor.axes).reshape(3, 3).T
    tile = TILE if sensor.elevations else (1, SECTOR)
    low = is_low(sensor)
    return tuple(bundle(direction[band], tile, sensor.far, low=low) for band in bands_of_rise(direction))


@jax.named_scope("scan")
def scan(scenario: Scenario, state: State, sensor: Lidar) -> Float[Array, "rays"] | Float[Array, "rings rays"]:
    """Distances [m] along the rays of a lidar; ``sensor.far`` where nothing lies between ``near`` and ``far``.

    (rays,) of a planar lidar, else (rings, rays), the lowest ring first. Differentiable in the robot's pose and in
    people's positions.
    """
    view = sensor_view(scenario, state, sensor)
    rings = [by_rows(rays, distance(view, rays)) for rays in lidar_rays(sensor)]
    distances = jnp.concatenate(rings) if sensor.elevations else rings[0][0]
    return jnp.where((distances >= sensor.near) & (distances <= sensor.far), distances, sensor.far)


def points(sensor: Lidar, distances: Float[Array, "*shape"]) -> Float[Array, "*shape 3"]:
    """Points [m] of a scan in the lidar's frame: x ahead, y to the left, z up.

    Rays that miss have points at ``sensor.far``; ``point_cloud`` leaves them out.

    Args:
        distances: m, (rays,) or (rings, rays) as of ``scan``, also with noise.
    """
    directions = lidar_directions(sensor)
    if not sensor.elevations:
        directions = directions[0]
    return distances[..., None] * jnp.asarray(directions, distances.dtype)


def point_cloud(
    sensor: Lidar, distances: Float[Array, "*shape"] | Float[np.ndarray, "*shape"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """The points [m] of the rays of a scan that meet a body, and the number of the ring of each, 0 for the lowest.

    On the host, for messages and files. Ring by ring, each from the first ray on.

    Args:
        distances: m, as of ``points``.
    """
    directions = lidar_directions(sensor)
    rings = np.asarray(distances, np.float32).reshape(directions.shape[:2])
    ring, ray = np.nonzero(rings < np.float32(sensor.far))
    hits = rings[ring, ray, None] * directions[ring, ray].astype(np.float32)
    return hits, ring.astype(np.int32)

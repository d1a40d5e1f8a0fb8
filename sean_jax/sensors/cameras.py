"""Cameras and lidars (section IV-F) on every robot: depth images, visible people, distances and points all around.

The defaults are SEAN 2.0's: 640 x 480 pixels, 60 degrees high, from 0.1 to 20 m; the overhead view is orthographic and
6 m high; the lidar has 360 rays, from 0.12 to 3.5 m, in one plane. A lidar with elevations has one ring of rays for
each. A camera or lidar is a fixed value. Its rays are made once and shared by all scenarios.
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

from sean_jax.core.data_types import Array, RobotModel, Scenario, Solids, State
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.sensors.raycast import SHOULDER, Rays, View, bundle, by_rows, distance, make_view, search

OVERHEAD = "overhead"
SEES_ROBOT = ("third_person", OVERHEAD)
TILE = (8, 16)  # rows and columns of pixels of a tile, which share the bodies that they may meet
SECTOR = 15  # rays of a tile, likewise


@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera on a robot. ``axes`` as in ``data_types.Mount``."""

    name: str  # of its mount on the robot
    origin: tuple[float, ...] | None  # (3,) m in the robot's frame; None: of the mount on the scenario's robot
    axes: tuple[float, ...]  # (9,)
    width: int  # pixels
    height: int  # pixels
    fovy: float  # degrees
    near: float  # m, along the view: nearer bodies are invisible
    far: float  # m, along the view: farther bodies are invisible
    orthographic: float  # m, height of the picture without perspective; 0: with perspective
    sees_robot: bool  # whether the robot itself is in the picture
    low: bool = False  # as of ``data_types.Mount``; with an origin, its height counts

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with another resolution in pixels."""
        return dataclasses.replace(self, width=width, height=height)


def camera(
    of: Scenario | RobotModel,
    name: str = "depth",
    *,
    width: int = 640,
    height: int = 480,
    fovy: float | None = None,
    near: float = 0.1,
    far: float | None = None,
    orthographic: float | None = None,
) -> Camera:
    """A camera of a robot, or of a scenario's robot.

    Args:
        name: ``depth``, ``first_person``, ``third_person``, ``overhead``, or another camera of the robot's file.
        width, height: pixels.
        fovy: degrees, vertical field of view; the file's if None.
        near, far: m, along the view: nothing nearer or farther is visible; ``far`` is 20 for ``depth``, 200 for others.
        orthographic: m, height of the part of the floor that a view without perspective shows; 0 for perspective;
            if None 6 for ``overhead`` and 0 for the others.

    Raises:
        InputError: the robot has no such camera, or a number makes no picture.
    """
    robot = of.robot if isinstance(of, Scenario) else of
    mounts = {mount.name: mount for mount in robot.mounts if mount.fovy > 0.0}
    if name not in mounts:
        cure = files.suggest(name, mounts) or f"; it has {', '.join(mounts) or 'none'}."
        raise InputError(f"camera: robot '{robot.name}' has no '{name}'{cure}")
    if width < 1 or height < 1:
        raise InputError(f"camera: a picture of {width} x {height} pixels shows nothing; give 1 or more of each.")
    mount = mounts[name]
    angle = mount.fovy if fovy is None else fovy
    if not 0.0 < angle < 180.0:
        raise InputError(f"fovy: {angle:g} degrees must lie between 0 and 180.")
    limit = (20.0 if name == "depth" else 200.0) if far is None else far
    if not 0.0 <= near < limit:
        raise InputError(f"near, far: {near:g} and {limit:g} m must be a lesser and a greater distance.")
    extent = (6.0 if name == OVERHEAD else 0.0) if orthographic is None else orthographic
    if not extent >= 0.0:
        raise InputError(f"orthographic: {extent:g} m must be the height of the picture, or 0 for perspective.")
    sees_robot = name in SEES_ROBOT
    return Camera(name, None, mount.axes, width, height, angle, near, limit, extent, sees_robot, mount.low)


@functools.lru_cache(maxsize=64)
def rays(view: Camera) -> tuple[Rays, Float[np.ndarray, "H W"]]:
    """The rays of a camera, and the cosine of the angle between each ray and the direction of view."""
    direction, offset, cosine = _directions(view)
    return _bundle(view, direction, offset), cosine


@functools.lru_cache(maxsize=64)
def bands(view: Camera) -> tuple[tuple[Rays, ...], Float[np.ndarray, "H W"]]:
    """The rays in one or two bundles, which are faster to search: rows that rise, and others; and the cosines."""
    direction, offset, cosine = _directions(view)
    parts = _bands(direction) if offset is None else [slice(None)]
    return tuple(_bundle(view, direction[part], offset) for part in parts), cosine


def _bands(direction: np.ndarray) -> list[slice]:
    """The rows of directions (H, W, 3) in two bands, if all rows that rise lie on one side of the others; else in one.

    Rays that do not rise are faster to search (``raycast.bundle``).
    """
    falls = np.all(direction[..., 2] <= 0.0, axis=1)
    edges = (np.flatnonzero(falls[1:] != falls[:-1]) + 1).tolist()
    return [slice(0, edges[0]), slice(edges[0], None)] if len(edges) == 1 else [slice(None)]


def _directions(view: Camera) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """(H, W, 3) unit vectors, (H, W, 3) m the starts of rays without perspective, else None, and (H, W) cosines."""
    half = view.orthographic / 2 if view.orthographic else np.tan(np.deg2rad(view.fovy) / 2)
    up = half * (1 - (2 * np.arange(view.height) + 1) / view.height)
    right = half * view.width / view.height * ((2 * np.arange(view.width) + 1) / view.width - 1)
    across, along = np.meshgrid(right, up)
    axes = np.asarray(view.axes).reshape(3, 3)
    spread = across[..., None] * axes[:, 0] + along[..., None] * axes[:, 1]
    if view.orthographic:
        return np.broadcast_to(-axes[:, 2], spread.shape), spread, np.ones(spread.shape[:2])
    direction = spread - axes[:, 2]
    length = np.linalg.norm(direction, axis=-1)
    return direction / length[..., None], None, 1.0 / length


def _bundle(view: Camera, direction: np.ndarray, offset: np.ndarray | None) -> Rays:
    cosine = -(direction @ np.asarray(view.axes).reshape(3, 3)[:, 2])
    over_ground = np.linalg.norm(direction[..., :2], axis=-1) / cosine
    return bundle(direction, TILE, view.far * float(over_ground.max()), offset, _is_low(view))


def focal_length(view: Camera) -> float:
    """Focal length fx = fy [pixels] of a camera with perspective, as in the ROS message CameraInfo."""
    return view.height / 2 / float(np.tan(np.deg2rad(view.fovy) / 2))


# --- depth images and visible people ---


@jax.named_scope("depth")
def depth(scenario: Scenario, state: State, camera: Camera) -> Float[Array, "H W"]:
    """Depth image [m]: distances along the direction of view, as depth cameras measure them, not along each ray.

    It is ``camera.far`` where nothing lies between ``camera.near`` and ``camera.far``. It is differentiable in the
    robot's pose and in people's positions: exact within the outline of each body, and finite on its edges.
    """
    bundles, cosine = bands(camera)
    view = sensor_view(scenario, state, camera, camera.sees_robot)
    parts = [by_rows(bundle, distance(view, bundle)) for bundle in bundles]
    image = jnp.concatenate(parts) * jnp.asarray(cosine, float)
    return jnp.where((image >= camera.near) & (image <= camera.far), image, camera.far)


def sensor_view(scenario: Scenario, state: State, device: "Camera | Lidar", with_robot: bool = False) -> View:
    """The bodies around a sensor."""
    people, robot, origin = state.pedestrians, state.robot, _origin(scenario.robot, device)
    solids = scenario.environment.scenery.solids
    radius = scenario.forces.walking.radius
    present = people.present
    if state.others is not None:  # other robots are behind the people of the scenario, and rays meet their solids
        present = present & (jnp.arange(present.shape[0], dtype=jnp.int32) < scenario.people)
    view = make_view(solids, people.position, present, radius, robot.position, robot.heading, origin)
    return _add_robot(view, scenario.robot.solids) if with_robot else view


def _origin(robot: RobotModel, device: "Camera | Lidar") -> Float[Array, "3"]:
    """m, of a sensor in the robot's frame."""
    if device.origin is not None:
        return jnp.asarray(device.origin, float)
    origin = next((mount.origin for mount in robot.mounts if mount.name == device.name), None)
    if origin is None:
        raise InputError(f"sensors: robot '{robot.name}' has no mount '{device.name}'; add one to its file.")
    return origin


def _is_low(device: "Camera | Lidar") -> bool:
    """Whether a sensor stays below people's shoulders."""
    return device.low if device.origin is None else device.origin[2] < SHOULDER


def _add_robot(view: View, solids: Solids) -> View:
    """Append the bodies of the robot, whose frame differs from the view's only by the place of the sensor."""

    def shifted(table: Array) -> Array:
        return table.at[:, :3].add(-view.place[None, :])

    return dataclasses.replace(
        view,
        boxes=jnp.concatenate([view.boxes, shifted(solids.boxes)]),
        cylinders=jnp.concatenate([view.cylinders, shifted(solids.cylinders)]),
        spheres=jnp.concatenate([view.spheres, shifted(solids.spheres)]),
    )


@jax.named_scope("pixels_of_people")
def pixels_of_people(scenario: Scenario, state: State, camera: Camera) -> Int[Array, "N"]:
    """How many pixels of a camera's picture show each person, as a perfect detector of people would count them.

    Obstacles, decoration and other people hide people. It is 0 for absent and hidden people, and outside of the
    picture, or not between ``camera.near`` and ``camera.far``. Few pixels are enough to decide visibility. No
    derivatives.
    """
    bundles, cosine = bands(camera)
    view = jax.lax.stop_gradient(sensor_view(scenario, state, camera, camera.sees_robot))
    parts = [[by_rows(bundle, part) for part in search(view, bundle)] for bundle in bundles]
    distance, number = (jnp.concatenate(part) for part in zip(*parts, strict=True))
    image = distance * jnp.asarray(cosine, float)
    in_range = (image >= camera.near) & (image <= camera.far)
    boxes, cylinders, spheres, people = view.counts
    person = jnp.where(in_range, number - (boxes + cylinders + spheres), -1).reshape(-1)
    return (person[:, None] == jnp.arange(people, dtype=person.dtype)[None, :]).sum(0, dtype=jnp.int32)


# --- lidars: distances all around the robot, in one plane or in rings one above the other ---


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
    axes: tuple[float, ...] = (
        1.0,
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
        0.0,
        0.0,
        1.0,
    )  # (9,) of ``data_types.Mount``: level, ahead
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
    rise = np.asarray(sensor.elevations or (0.0,), float)[:, None]
    level = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    return level * np.cos(rise)[..., None] + np.sin(rise)[..., None] * np.array([0.0, 0.0, 1.0])


@functools.lru_cache(maxsize=64)
def lidar_rays(sensor: Lidar) -> tuple[Rays, ...]:
    """The rays of a lidar in one or two bundles, as of a camera's ``bands``."""
    direction = lidar_directions(sensor) @ np.asarray(sensor.axes).reshape(3, 3).T
    tile = TILE if sensor.elevations else (1, SECTOR)
    low = _is_low(sensor)
    return tuple(bundle(direction[part], tile, sensor.far, low=low) for part in _bands(direction))


@jax.named_scope("scan")
def scan(scenario: Scenario, state: State, sensor: Lidar) -> Float[Array, "rays"] | Float[Array, "rings rays"]:
    """Distances [m] along the rays of a lidar; ``sensor.far`` where nothing lies between ``near`` and ``far``.

    (rays,) of a planar lidar, else (rings, rays), the lowest ring first. Differentiable in the robot's pose and in
    people's positions.
    """
    view = sensor_view(scenario, state, sensor)
    parts = [by_rows(fan, distance(view, fan)) for fan in lidar_rays(sensor)]
    distances = jnp.concatenate(parts) if sensor.elevations else parts[0][0]
    return jnp.where((distances >= sensor.near) & (distances <= sensor.far), distances, sensor.far)


def points(sensor: Lidar, distances: Float[Array, "*shape"]) -> Float[Array, "*shape 3"]:
    """Points [m] of a scan in the lidar's frame: x ahead, y to the left, z up.

    Rays that miss have points at ``sensor.far``; ``point_cloud`` leaves them out.

    Args:
        distances: m, (rays,) or (rings, rays) as of ``scan``, also with noise.
    """
    ways = lidar_directions(sensor)
    return distances[..., None] * jnp.asarray(ways if sensor.elevations else ways[0], distances.dtype)


def point_cloud(
    sensor: Lidar, distances: Float[Array, "*shape"] | Float[np.ndarray, "*shape"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """The points [m] of the rays of a scan that meet a body, and the number of the ring of each, 0 for the lowest.

    On the host, for messages and files. Ring by ring, each from the first ray on.

    Args:
        distances: m, as of ``points``.
    """
    ways = lidar_directions(sensor)
    rows = np.asarray(distances, np.float32).reshape(ways.shape[:2])
    ring, ray = np.nonzero(rows < np.float32(sensor.far))
    return rows[ring, ray, None] * ways[ring, ray].astype(np.float32), ring.astype(np.int32)

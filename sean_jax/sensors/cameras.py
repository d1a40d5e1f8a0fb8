"""Cameras and a lidar (section IV-F) on every robot: depth images, visible people, and distances all around.

The defaults are SEAN 2.0's: 640 x 480 pixels, 60 degrees high, from 0.1 to 20 m; the overhead view is orthographic and
6 m high; the lidar has 360 rays, from 0.12 to 3.5 m, in one plane. A camera or lidar is a fixed value. Its rays are
made once and shared by all scenarios.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax import files
from sean_jax.base import Array, RobotModel, Scenario, Solids, State
from sean_jax.errors import InputError
from sean_jax.raycast import SHOULDER, Rays, View, bundle, by_rows, distance, make_view, search

OVERHEAD = "overhead"
SEES_ROBOT = ("third_person", OVERHEAD)
TILE = (8, 16)  # rows and columns of pixels of a tile, which share the bodies that they may meet
SECTOR = 15  # rays of a tile, likewise


@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera on a robot. ``axes`` as in ``base.Mount``."""

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
    low: bool = False  # as of ``base.Mount``; with an origin, its height counts

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
    falls = np.all(direction[..., 2] <= 0.0, axis=1)
    first = int(np.argmax(falls)) if falls.any() else len(falls)
    parts = [part for part in (slice(0, first), slice(first, None)) if falls[part].size]
    if offset is not None or not falls[first:].all():
        parts = [slice(None)]
    return tuple(_bundle(view, direction[part], None if offset is None else offset) for part in parts), cosine


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
    view = make_view(solids, people.position, people.present, radius, robot.position, robot.heading, origin)
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


# --- a planar lidar: distances all around the robot, at one height ---


@dataclasses.dataclass(frozen=True)
class Lidar:
    """A planar lidar on a robot."""

    name = "lidar"  # of its mount
    origin: tuple[float, ...] | None  # (3,) m in the robot's frame; None: of the mount on the scenario's robot
    count: int  # rays
    first: float  # rad, of the first ray, counter-clockwise from x about z of the site
    span: float  # rad, that the rays cover together, beginning with the first
    near: float  # m, nearer bodies are invisible
    far: float  # m, farther bodies are invisible
    axes: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # (9,) of ``base.Mount``: level, ahead
    low: bool = False  # as of ``base.Mount``; with an origin, its height counts


def lidar(
    of: Scenario | RobotModel,
    *,
    count: int = 360,
    first: float = 0.0,
    span: float = 2 * np.pi,
    near: float = 0.12,
    far: float = 3.5,
) -> Lidar:
    """The lidar of a robot, or of a scenario's robot.

    Args:
        count: number of rays, ``span / count`` rad apart.
        first: rad, direction of the first ray, counter-clockwise from straight ahead.
        span: rad, that the rays cover together.
        near, far: m, nothing nearer or farther is visible.

    Raises:
        InputError: the robot's file has no site 'lidar', there is no ray, or the range is empty.
    """
    robot = of.robot if isinstance(of, Scenario) else of
    mount = next((mount for mount in robot.mounts if mount.name == "lidar"), None)
    if mount is None:
        raise InputError(f"lidar: the file of robot '{robot.name}' has no <site name=\"lidar\">; add one to its base.")
    if count < 1:
        raise InputError(f"count: {count} rays see nothing; give 1 or more.")
    if not 0.0 <= near < far:
        raise InputError(f"near, far: {near:g} and {far:g} m must be a lesser and a greater distance.")
    return Lidar(None, count, first, span, near, far, mount.axes, mount.low)


@functools.lru_cache(maxsize=64)
def lidar_rays(sensor: Lidar) -> Rays:
    """The rays of a lidar."""
    angle = sensor.first + sensor.span * np.arange(sensor.count) / sensor.count
    direction = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    direction = direction @ np.asarray(sensor.axes).reshape(3, 3).T
    return bundle(direction[None], (1, SECTOR), sensor.far, low=_is_low(sensor))


@jax.named_scope("scan")
def scan(scenario: Scenario, state: State, sensor: Lidar) -> Float[Array, "rays"]:
    """Distances [m] along the rays of a lidar; ``sensor.far`` where nothing lies between ``near`` and ``far``.

    Differentiable in the robot's pose and in people's positions.
    """
    fan = lidar_rays(sensor)
    distances = by_rows(fan, distance(sensor_view(scenario, state, sensor), fan))[0]
    return jnp.where((distances >= sensor.near) & (distances <= sensor.far), distances, sensor.far)

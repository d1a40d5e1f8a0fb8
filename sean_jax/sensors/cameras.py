"""Cameras (section IV-F) on every robot: depth images, and the people in them.

The defaults are SEAN 2.0's: 640 x 480 pixels, 60 degrees high, from 0.1 to 20 m; the overhead view is orthographic and
6 m high. A camera is a fixed value. Its rays are made once and shared by all scenarios.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, RobotModel, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.sensors.mounts import TILE, bands_of_rise, is_low, sensor_view
from sean_jax.sensors.raycast import Rays, bundle, by_rows, distance, search

OVERHEAD = "overhead"
SEES_ROBOT = ("third_person", OVERHEAD)
DEPTH_FAR = 20.0  # m, of the depth camera, if nothing else is said
PICTURE_FAR = 200.0  # m, of the others
OVERHEAD_EXTENT = 6.0  # m, height of the overhead picture


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

    # What is not given is the mount's, or the default of that name.
    mount = mounts[name]
    if fovy is None:
        fovy = mount.fovy
    if far is None:
        far = DEPTH_FAR if name == "depth" else PICTURE_FAR
    if orthographic is None:
        orthographic = OVERHEAD_EXTENT if name == OVERHEAD else 0.0

    if not 0.0 < fovy < 180.0:
        raise InputError(f"fovy: {fovy:g} degrees must lie between 0 and 180.")
    if not 0.0 <= near < far:
        raise InputError(f"near, far: {near:g} and {far:g} m must be a lesser and a greater distance.")
    if not orthographic >= 0.0:
        raise InputError(f"orthographic: {orthographic:g} m must be the height of the picture, or 0 for perspective.")
    sees_robot = name in SEES_ROBOT
    return Camera(name, None, mount.axes, width, height, fovy, near, far, orthographic, sees_robot, mount.low)


@functools.lru_cache(maxsize=64)
def rays(view: Camera) -> tuple[Rays, Float[np.ndarray, "H W"]]:
    """The rays of a camera, and the cosine of the angle between each ray and the direction of view."""
    direction, offset, cosine = _directions(view)
    return _bundle(view, direction, offset), cosine


@functools.lru_cache(maxsize=64)
def bands(view: Camera) -> tuple[tuple[Rays, ...], Float[np.ndarray, "H W"]]:
    """The rays in one or two bundles, which are faster to search: rows that rise, and others; and the cosines."""
    direction, offset, cosine = _directions(view)
    bands = bands_of_rise(direction) if offset is None else [slice(None)]
    return tuple(_bundle(view, direction[band], offset) for band in bands), cosine


def _directions(view: Camera) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """(H, W, 3) unit vectors, (H, W, 3) m the starts of rays without perspective, else None, and (H, W) cosines."""
    # Middles of the pixels on the picture plane: in m without perspective, else 1 m ahead of the camera.
    half_height = view.orthographic / 2 if view.orthographic else np.tan(np.deg2rad(view.fovy) / 2)
    rows = (2 * np.arange(view.height) + 1) / view.height
    columns = (2 * np.arange(view.width) + 1) / view.width
    up = half_height * (1 - rows)
    right = half_height * view.width / view.height * (columns - 1)
    across, along = np.meshgrid(right, up)

    # MuJoCo's cameras look along -z, x is to the right and y up.
    x_axis, y_axis, z_axis = np.asarray(view.axes).reshape(3, 3).T
    pixels = across[..., None] * x_axis + along[..., None] * y_axis
    if view.orthographic:
        return np.broadcast_to(-z_axis, pixels.shape), pixels, np.ones(pixels.shape[:2])
    direction = pixels - z_axis
    length = np.linalg.norm(direction, axis=-1)
    return direction / length[..., None], None, 1.0 / length


def _bundle(view: Camera, direction: np.ndarray, offset: np.ndarray | None) -> Rays:
    backward = np.asarray(view.axes).reshape(3, 3)[:, 2]
    cosine = -(direction @ backward)
    over_ground = np.linalg.norm(direction[..., :2], axis=-1) / cosine  # m, for each m of depth
    reach = view.far * float(over_ground.max())
    return bundle(direction, TILE, reach, offset, is_low(view))


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
    rows = [by_rows(bundle, distance(view, bundle)) for bundle in bundles]
    image = jnp.concatenate(rows) * jnp.asarray(cosine, float)
    return jnp.where((image >= camera.near) & (image <= camera.far), image, camera.far)


@jax.named_scope("pixels_of_people")
def pixels_of_people(scenario: Scenario, state: State, camera: Camera) -> Int[Array, "N"]:
    """How many pixels of a camera's picture show each person, as a perfect detector of people would count them.

    Obstacles, decoration and other people hide people. It is 0 for absent and hidden people, and outside of the
    picture, or not between ``camera.near`` and ``camera.far``. Few pixels are enough to decide visibility. No
    derivatives.
    """
    bundles, cosine = bands(camera)
    view = jax.lax.stop_gradient(sensor_view(scenario, state, camera, camera.sees_robot))
    distances = []
    numbers = []
    for band in bundles:
        to_body, body = search(view, band)
        distances.append(by_rows(band, to_body))
        numbers.append(by_rows(band, body))
    image = jnp.concatenate(distances) * jnp.asarray(cosine, float)
    in_range = (image >= camera.near) & (image <= camera.far)

    # People have the numbers after those of boxes, cylinders and spheres.
    first_person = sum(view.counts[:3])
    people = view.counts[3]
    person = jnp.where(in_range, jnp.concatenate(numbers) - first_person, -1).reshape(-1)
    is_person = person[:, None] == jnp.arange(people, dtype=person.dtype)[None, :]  # (pixels, N)
    return is_person.sum(0, dtype=jnp.int32)

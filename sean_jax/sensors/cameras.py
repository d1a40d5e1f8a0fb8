"""Cameras (section IV-F): one depth sensor and three of color on every robot, at the mounts of its file.

Defaults are SEAN 2.0's: 640 x 480 pixels, 60 degrees high, from 0.1 to 20 m, the overhead view orthographic and 6 m
high. A camera is a fixed value; its rays are made once and shared by all scenarios.
"""

import dataclasses
import difflib
import functools

import numpy as np

from sean_jax.base import RobotModel, Scenario
from sean_jax.raycast import Rays, bundle

OVERHEAD = "overhead"
SEES_ROBOT = ("third_person", OVERHEAD)
TILE = (48, 4)  # rows and columns of pixels that share what they may see


@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera on a robot. ``origin`` and ``axes`` are those of ``base.Mount``."""

    name: str
    origin: tuple[float, ...]  # (3,) m
    axes: tuple[float, ...]  # (9,)
    width: int  # pixels
    height: int  # pixels
    fovy: float  # degrees
    near: float  # m, along the view: nothing nearer is seen
    far: float  # m, along the view: what is farther is as good as nothing
    orthographic: float  # m, height of the picture of a camera without perspective; 0: with perspective
    sees_robot: bool  # whether the robot itself is in the picture

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with other numbers of pixels."""
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
    """The camera of that name on a robot, or on the robot of a scenario.

    Args:
        name: ``depth``, ``first_person``, ``third_person``, ``overhead``, or another camera of the robot's file.
        width: of the picture [pixels].
        height: of the picture [pixels].
        fovy: vertical field of view [degrees]; the file's if None.
        near: nothing nearer is seen [m].
        far: what is farther is as good as nothing [m]; 20 for ``depth`` and 200 for the others if None.
        orthographic: height [m] of the part of the floor that a view without perspective shows; 0 for perspective;
            6 for ``overhead`` and 0 for the others if None.

    Raises:
        ValueError: the robot has no such camera, or a number makes no picture.
    """
    robot = of.robot if isinstance(of, Scenario) else of
    mounts = {mount.name: mount for mount in robot.mounts if mount.fovy > 0.0}
    if name not in mounts:
        meant = difflib.get_close_matches(name, mounts, 1)
        cure = f"did you mean '{meant[0]}'?" if meant else f"it has {', '.join(mounts) or 'none'}."
        raise ValueError(f"camera: robot '{robot.name}' has no '{name}'; {cure}")
    if width < 1 or height < 1:
        raise ValueError(f"camera: a picture of {width} x {height} pixels shows nothing; give 1 or more of each.")
    mount = mounts[name]
    angle = mount.fovy if fovy is None else fovy
    if not 0.0 < angle < 180.0:
        raise ValueError(f"fovy: {angle:g} degrees must lie between 0 and 180.")
    farthest = (20.0 if name == "depth" else 200.0) if far is None else far
    if not 0.0 <= near < farthest:
        raise ValueError(f"near, far: {near:g} and {farthest:g} m must be a lesser and a greater distance.")
    shown = (6.0 if name == OVERHEAD else 0.0) if orthographic is None else orthographic
    if not shown >= 0.0:
        raise ValueError(f"orthographic: {shown:g} m must be the height of what is shown, or 0 for perspective.")
    seen = name in SEES_ROBOT
    return Camera(name, mount.origin, mount.axes, width, height, angle, near, farthest, shown, seen)


@functools.lru_cache(maxsize=64)
def rays(view: Camera) -> tuple[Rays, np.ndarray]:
    """The rays of a camera, and (H, W) the cosine of the angle between each and the direction of view."""
    direction, offset, cosine = _directions(view)
    return _bundle(view, direction, offset), cosine


@functools.lru_cache(maxsize=64)
def bands(view: Camera) -> tuple[tuple[Rays, ...], np.ndarray]:
    """As ``rays``, in one bundle for the rows that rise and one for those that do not: faster to search."""
    direction, offset, cosine = _directions(view)
    falls = np.all(direction[..., 2] <= 0.0, axis=1)
    first = int(np.argmax(falls)) if falls.any() else len(falls)
    parts = [part for part in (slice(0, first), slice(first, None)) if falls[part].size]
    if offset is not None or not falls[first:].all():
        parts = [slice(None)]
    return tuple(_bundle(view, direction[part], None if offset is None else offset) for part in parts), cosine


def _directions(view: Camera) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """(H, W, 3) unit vectors, (H, W, 3) m where rays begin if not at one point, and (H, W) cosines."""
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
    return bundle(view.origin, direction, TILE, view.far * float(over_ground.max()), offset)


def focal_length(view: Camera) -> float:
    """fx = fy [pixels] of a camera with perspective, as a CameraInfo message wants it."""
    return view.height / 2 / float(np.tan(np.deg2rad(view.fovy) / 2))

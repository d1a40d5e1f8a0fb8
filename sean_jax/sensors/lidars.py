"""A planar lidar (section IV-F): distances all around the robot, at one height.

The defaults are SEAN 2.0's: 360 rays, from 0.12 to 3.5 m. Bodies above and below the plane are invisible.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.base import Array, RobotModel, Scenario, State
from sean_jax.errors import InputError
from sean_jax.raycast import Rays, bundle, by_rows, distance
from sean_jax.sensors.cameras import sensor_view

SECTOR = 15  # rays of a tile, which share the bodies that they may meet


@dataclasses.dataclass(frozen=True)
class Lidar:
    """A planar lidar on a robot."""

    origin: tuple[float, ...]  # (3,) m in the robot's frame
    count: int  # rays
    first: float  # rad, of the first ray, counter-clockwise from x about z of the site
    span: float  # rad, that the rays cover together, beginning with the first
    near: float  # m, nearer bodies are invisible
    far: float  # m, farther bodies are invisible
    axes: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # (9,) of ``base.Mount``: level, ahead


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
    return Lidar(mount.origin, count, first, span, near, far, mount.axes)


@functools.lru_cache(maxsize=64)
def rays(sensor: Lidar) -> Rays:
    """The rays of a lidar."""
    angle = sensor.first + sensor.span * np.arange(sensor.count) / sensor.count
    direction = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    direction = direction @ np.asarray(sensor.axes).reshape(3, 3).T
    return bundle(sensor.origin, direction[None], (1, SECTOR), sensor.far)


@jax.named_scope("scan")
def scan(scenario: Scenario, state: State, sensor: Lidar) -> Float[Array, "rays"]:
    """Distances [m] along the rays of a lidar; ``sensor.far`` where nothing lies between ``near`` and ``far``.

    Differentiable in the robot's pose and in people's positions.
    """
    fan = rays(sensor)
    distances = by_rows(fan, distance(sensor_view(scenario, state, fan), fan))[0]
    return jnp.where((distances >= sensor.near) & (distances <= sensor.far), distances, sensor.far)

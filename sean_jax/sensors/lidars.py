"""A planar lidar (section IV-F): distances all around the robot, at one height.

Defaults are SEAN 2.0's: 360 rays, from 0.12 to 3.5 m. Bodies that are not there where the rays pass are not seen.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Array, RobotModel, Scenario, State
from sean_jax.raycast import Rays, bundle, by_rows, distance
from sean_jax.sensors.sight import sight

SECTOR = 15  # rays that share what they may see


@dataclasses.dataclass(frozen=True)
class Lidar:
    """A planar lidar on a robot."""

    origin: tuple[float, ...]  # (3,) m in the robot's frame
    count: int  # rays
    first: float  # rad, of the first ray, counter-clockwise from x about z of the site
    span: float  # rad, that the rays cover together, beginning with the first
    near: float  # m, nothing nearer is seen
    far: float  # m, nothing farther is seen
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
    """The lidar of a robot, or of a scenario's: ``count`` rays, ``span / count`` rad apart.

    Raises:
        ValueError: the robot's file has no site 'lidar', or there is no ray, or no distance to see.
    """
    robot = of.robot if isinstance(of, Scenario) else of
    mount = next((mount for mount in robot.mounts if mount.name == "lidar"), None)
    if mount is None:
        raise ValueError(f"lidar: the file of robot '{robot.name}' has no <site name=\"lidar\">; add one to its base.")
    if count < 1:
        raise ValueError(f"count: {count} rays see nothing; give 1 or more.")
    if not 0.0 <= near < far:
        raise ValueError(f"near, far: {near:g} and {far:g} m must be a lesser and a greater distance.")
    return Lidar(mount.origin, count, first, span, near, far, mount.axes)


@functools.lru_cache(maxsize=64)
def rays(sensor: Lidar) -> Rays:
    """The rays of a lidar."""
    angle = sensor.first + sensor.span * np.arange(sensor.count) / sensor.count
    direction = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    direction = direction @ np.asarray(sensor.axes).reshape(3, 3).T
    return bundle(sensor.origin, direction[None], (1, SECTOR), sensor.far)


@jax.named_scope("scan")
def scan(scenario: Scenario, state: State, sensor: Lidar) -> Array:
    """(R,) m to what each ray meets; ``sensor.far`` where there is nothing between ``near`` and ``far``.

    Differentiable in the robot's pose and people's positions.
    """
    fan = rays(sensor)
    found = by_rows(fan, distance(sight(scenario, state, fan), fan))[0]
    return jnp.where((found >= sensor.near) & (found <= sensor.far), found, sensor.far)

"""What cameras and lidars share (section IV-F): their place on the robot, the bodies around it, tiles of rays."""

import dataclasses
from typing import Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.core.data_types import Array, RobotModel, Scenario, Solids, State
from sean_jax.core.errors import InputError
from sean_jax.sensors.raycast import SHOULDER, View, make_view

TILE = (8, 16)  # rows and columns of pixels of a tile, which share the bodies that they may meet


class Device(Protocol):
    """A camera or a lidar."""

    @property
    def name(self) -> str:
        """Of its mount on the robot."""
        ...

    @property
    def origin(self) -> tuple[float, ...] | None:
        """(3,) m in the robot's frame; None: of the mount on the scenario's robot."""
        ...

    @property
    def low(self) -> bool:
        """As of ``data_types.Mount``; with an origin, its height counts."""
        ...


def sensor_view(scenario: Scenario, state: State, device: Device, with_robot: bool = False) -> View:
    """The bodies around a sensor."""
    people = state.pedestrians
    robot = state.robot
    origin = _origin(scenario.robot, device)
    solids = scenario.environment.scenery.solids
    radius = scenario.forces.walking.radius
    present = people.present
    if state.others is not None:  # other robots are behind the people of the scenario, and rays meet their solids
        present = present & (jnp.arange(present.shape[0], dtype=jnp.int32) < scenario.people)
    view = make_view(solids, people.position, present, radius, robot.position, robot.heading, origin)
    return _add_robot(view, scenario.robot.solids) if with_robot else view


def _origin(robot: RobotModel, device: Device) -> Float[Array, "3"]:
    """m, of a sensor in the robot's frame."""
    if device.origin is not None:
        return jnp.asarray(device.origin, float)
    origin = next((mount.origin for mount in robot.mounts if mount.name == device.name), None)
    if origin is None:
        raise InputError(f"sensors: robot '{robot.name}' has no mount '{device.name}'; add one to its file.")
    return origin


def is_low(device: Device) -> bool:
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


def bands_of_rise(direction: np.ndarray) -> list[slice]:
    """The rows of directions (H, W, 3) in two bands, if all rows that rise lie on one side of the others; else in one.

    Rays that do not rise are faster to search (``raycast.bundle``).
    """
    falls = np.all(direction[..., 2] <= 0.0, axis=1)
    edges = (np.flatnonzero(falls[1:] != falls[:-1]) + 1).tolist()
    return [slice(0, edges[0]), slice(edges[0], None)] if len(edges) == 1 else [slice(None)]

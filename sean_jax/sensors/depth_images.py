"""Depth images (section IV-F), and the bodies that a sensor of the robot can see."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.base import Array, Scenario, Solids, State
from sean_jax.raycast import Rays, View, by_rows, distance, make_view
from sean_jax.sensors.cameras import Camera, bands


@jax.named_scope("depth")
def depth(scenario: Scenario, state: State, camera: Camera) -> Float[Array, "H W"]:
    """Depth image: distances along the direction of view, as depth cameras measure them, not along each ray.

    Differentiable in the robot's pose and in people's positions. The gradient is exact within the outline of each body
    and finite on its edges.

    Args:
        camera: of ``sensors.camera``.

    Returns:
        (H, W) m. It is ``camera.far`` where nothing lies between ``camera.near`` and ``camera.far``.
    """
    bundles, cosine = bands(camera)
    view = sensor_view(scenario, state, bundles[0], camera.sees_robot)
    parts = [by_rows(bundle, distance(view, bundle)) for bundle in bundles]
    image = jnp.concatenate(parts) * cosine
    return jnp.where((image >= camera.near) & (image <= camera.far), image, camera.far)


def sensor_view(scenario: Scenario, state: State, rays: Rays, with_robot: bool = False) -> View:
    """The bodies around a sensor of the robot.

    Args:
        rays: of the sensor; only its origin is used.
    """
    people, robot = state.pedestrians, state.robot
    solids = scenario.environment.scenery.solids
    radius = scenario.forces.walking.radius
    view = make_view(solids, people.position, people.present, radius, robot.position, robot.heading, rays.origin)
    return _add_robot(view, scenario.robot.solids, rays.origin) if with_robot else view


def _add_robot(view: View, solids: Solids, origin: np.ndarray) -> View:
    """Append the bodies of the robot, whose frame differs from that of the view only by the origin (3,) m."""
    place = jnp.asarray(origin, float)

    def shifted(table: Array) -> Array:
        return table.at[:, :3].add(-place[None, :])

    return dataclasses.replace(
        view,
        boxes=jnp.concatenate([view.boxes, shifted(solids.boxes)]),
        cylinders=jnp.concatenate([view.cylinders, shifted(solids.cylinders)]),
        spheres=jnp.concatenate([view.spheres, shifted(solids.spheres)]),
    )

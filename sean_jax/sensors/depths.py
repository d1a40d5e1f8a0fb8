"""The depth camera (section IV-F): how far everything is along the direction of view."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Scenario, State
from sean_jax.raycast import by_rows, distance
from sean_jax.sensors.cameras import Camera, bands
from sean_jax.sensors.sight import sight


@jax.named_scope("depth")
def depth(scenario: Scenario, state: State, camera: Camera) -> Array:
    """(H, W) m, measured along the direction of view as depth cameras do, not along each ray.

    ``camera.far`` where there is nothing within it, and for what is nearer than ``camera.near``, which a sensor does
    not see either. Differentiable in the robot's pose and people's positions: exact within what a ray meets, finite
    at edges.
    """
    bundles, cosine = bands(camera)
    view = sight(scenario, state, bundles[0], camera.sees_robot)
    parts = [by_rows(bundle, distance(view, bundle)) for bundle in bundles]
    image = jnp.concatenate(parts) * cosine
    return jnp.where((image >= camera.near) & (image <= camera.far), image, camera.far)

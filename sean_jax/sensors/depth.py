"""The depth camera (section IV-F): how far everything is along the direction of view."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Scenario, State
from sean_jax.raycast import distance
from sean_jax.sensors.cameras import Camera, rays
from sean_jax.sensors.sight import picture, sight


@jax.named_scope("depth")
def depth(scenario: Scenario, state: State, camera: Camera) -> Array:
    """(H, W) m, measured along the direction of view as depth cameras do, not along each ray.

    ``camera.far`` where there is nothing within it, and for what is nearer than ``camera.near``, which a sensor does not
    see either. Differentiable in the robot's pose and people's positions: exact within what a ray meets, 0 at edges.
    """
    bundle, cosine = rays(camera)
    along = distance(sight(scenario, state, bundle, camera.sees_robot), bundle)
    image = picture(along, bundle, cosine.shape) * cosine
    return jnp.where((image >= camera.near) & (image <= camera.far), image, camera.far)

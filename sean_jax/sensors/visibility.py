"""Whom a camera shows (section IV-F): what a perfect detector of people would find in its picture."""

import jax
import jax.numpy as jnp
from jaxtyping import Int

from sean_jax.base import Array, Scenario, State
from sean_jax.raycast import by_rows, search
from sean_jax.sensors.cameras import Camera, bands
from sean_jax.sensors.depth_images import sensor_view


@jax.named_scope("pixels_of_people")
def pixels_of_people(scenario: Scenario, state: State, camera: Camera) -> Int[Array, "N"]:
    """How many pixels of a camera's picture show each person.

    Obstacles, decoration and other people hide people. Without derivatives.

    Args:
        camera: of ``sensors.camera``; few pixels are enough to know who is in sight.

    Returns:
        (N,) int32. It is 0 for who is absent, hidden, outside of the picture, or not between ``camera.near`` and
        ``camera.far``.
    """
    bundles, cosine = bands(camera)
    view = jax.lax.stop_gradient(sensor_view(scenario, state, bundles[0], camera.sees_robot))
    parts = [[by_rows(bundle, part) for part in search(view, bundle)] for bundle in bundles]
    distance, number = (jnp.concatenate(part) for part in zip(*parts, strict=True))
    image = distance * cosine
    in_range = (image >= camera.near) & (image <= camera.far)
    boxes, cylinders, spheres, people = view.counts
    person = jnp.where(in_range, number - (boxes + cylinders + spheres), -1).reshape(-1)
    return (person[:, None] == jnp.arange(people, dtype=person.dtype)[None, :]).sum(0, dtype=jnp.int32)

"""Pictures in color (section IV-F), with depth, class and instance of what each pixel shows."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.base import Array, Scenario, Solids, State
from sean_jax.raycast import View, by_rows, search, surface
from sean_jax.sensors import paint
from sean_jax.sensors.cameras import Camera, rays
from sean_jax.sensors.depth_images import sensor_view

SKY, FLOOR, OBSTACLE, PERSON, ROBOT = range(5)
CLASSES = ("sky", "floor", "obstacle", "person", "robot")
"""The meaning of the numbers in ``Picture.semantic``."""


@struct.dataclass
class Picture:
    """The picture of a camera, row by row from the top."""

    rgb: Float[Array, "H W 3"]  # from 0 to 1
    depth: Float[Array, "H W"]  # m along the direction of view, the camera's far where there is nothing
    semantic: Int[Array, "H W"]  # index into CLASSES
    instance: Int[Array, "H W"]  # a person's index, N + that of a body of the scenery, then the robot; -1 floor, sky


@jax.named_scope("render")
def render(scenario: Scenario, state: State, camera: Camera) -> Picture:
    """The picture of a camera. Depth and color are differentiable as in ``depth``; class and instance are not.

    Args:
        camera: of ``sensors.camera``.
    """
    bundle, cosine = rays(camera)
    view = sensor_view(scenario, state, bundle, camera.sees_robot)
    number = search(jax.lax.stop_gradient(view), bundle)[1]
    distance, nx, ny, nz = surface(view, bundle, number)
    # Without the barriers XLA computes all of this again for each color.
    number, distance, nx, ny, nz = jax.lax.optimization_barrier((number, distance, nx, ny, nz))
    semantic, instance = (jnp.asarray(table)[number] for table in _labels(scenario, view, camera.sees_robot))
    kinds = semantic == SKY, semantic == FLOOR, semantic == PERSON
    body_color = _body_colors(scenario, view, camera.sees_robot)[:, number]
    rgb = paint.colors(scenario, state, view, bundle, number, distance, (nx, ny, nz), kinds, body_color)
    picture = jnp.zeros((*cosine.shape, 3), float)
    for channel, part in enumerate(rgb):  # not jnp.stack: XLA would compute their common parts once for each
        picture = picture.at[..., channel].set(by_rows(bundle, part))
    image = by_rows(bundle, distance) * cosine
    in_range = (image >= camera.near) & (image <= camera.far)
    return Picture(
        rgb=picture,
        depth=jnp.where(in_range, image, camera.far),
        semantic=by_rows(bundle, semantic),
        instance=by_rows(bundle, instance),
    )


def _counts(solids: Solids) -> tuple[int, int, int]:
    """Numbers of boxes, cylinders and spheres."""
    return solids.boxes.shape[0], solids.cylinders.shape[0], solids.spheres.shape[0]


def _labels(scenario: Scenario, view: View, with_robot: bool) -> tuple[np.ndarray, np.ndarray]:
    """Class and instance (bodies + 2,) by number in the view; the floor and the sky come last."""
    scenery, own = _counts(scenario.environment.scenery.solids), _counts(scenario.robot.solids)
    people, bodies = view.counts[3], sum(scenery)
    semantic, instance, first = [], [], people
    for of_scenery, of_robot in zip(scenery, own if with_robot else (0, 0, 0), strict=True):
        semantic += [OBSTACLE] * of_scenery + [ROBOT] * of_robot
        instance += [*range(first, first + of_scenery)] + [people + bodies] * of_robot
        first += of_scenery
    semantic += [PERSON] * people + [FLOOR, SKY]
    instance += [*range(people), -1, -1]
    return np.array(semantic, np.int32), np.array(instance, np.int32)


def _body_colors(scenario: Scenario, view: View, with_robot: bool) -> Array:
    """(3, bodies + 2) colors by number in the view; zeros for people, floor and sky, whose colors ``paint`` makes."""
    parts = []
    solids, own = scenario.environment.scenery.solids, scenario.robot.solids
    first, own_first = np.cumsum((0, *_counts(solids))), np.cumsum((0, *_counts(own)))
    for kind in range(3):
        parts.append(solids.color[first[kind] : first[kind + 1]])
        if with_robot:
            parts.append(own.color[own_first[kind] : own_first[kind + 1]])
    return jnp.concatenate([*parts, jnp.zeros((view.counts[3] + 2, 3), float)]).T

"""Pictures in color (section IV-F), and with them depth, what each pixel shows, and of whom."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax.base import Array, Scenario, Solids, State
from sean_jax.raycast import View, by_rows, search, surface
from sean_jax.sensors import paint
from sean_jax.sensors.cameras import Camera, rays
from sean_jax.sensors.sight import sight

SKY, FLOOR, OBSTACLE, PERSON, ROBOT = range(5)
CLASSES = ("sky", "floor", "obstacle", "person", "robot")
"""what the numbers of ``Picture.semantic`` mean"""


@struct.dataclass
class Picture:
    """What a camera shows, row by row from the top."""

    rgb: Array  # (H, W, 3) float from 0 to 1
    depth: Array  # (H, W) m along the direction of view, the camera's far where there is nothing
    semantic: Array  # (H, W) int32, see CLASSES
    instance: Array  # (H, W) int32: a person's index, N + that of a body of the scenery, then the robot; -1 floor, sky


@jax.named_scope("render")
def render(scenario: Scenario, state: State, camera: Camera) -> Picture:
    """The picture of a camera: color, depth as ``depth`` has it, class and instance of what each pixel shows.

    Depth and color can be differentiated as distances can, class and instance cannot.
    """
    bundle, cosine = rays(camera)
    view = sight(scenario, state, bundle, camera.sees_robot)
    number = search(jax.lax.stop_gradient(view), bundle)[1]
    found, nx, ny, nz = surface(view, bundle, number)
    # Without the barriers XLA computes all of this anew for each color.
    number, found, nx, ny, nz = jax.lax.optimization_barrier((number, found, nx, ny, nz))
    semantic, instance = (jnp.asarray(table)[number] for table in _named(scenario, view, camera.sees_robot))
    kinds = semantic == SKY, semantic == FLOOR, semantic == PERSON
    shell = _shell(scenario, view, camera.sees_robot)[:, number]
    rgb = paint.colors(scenario, state, view, bundle, number, found, (nx, ny, nz), kinds, shell)
    picture = jnp.zeros((*cosine.shape, 3), float)
    for channel, part in enumerate(rgb):  # one by one: in a stack XLA computes for each what they have in common
        picture = picture.at[..., channel].set(by_rows(bundle, part))
    image = by_rows(bundle, found) * cosine
    seen = (image >= camera.near) & (image <= camera.far)
    return Picture(
        rgb=picture,
        depth=jnp.where(seen, image, camera.far),
        semantic=by_rows(bundle, semantic),
        instance=by_rows(bundle, instance),
    )


def _kinds(solids: Solids) -> tuple[int, int, int]:
    return solids.boxes.shape[0], solids.cylinders.shape[0], solids.spheres.shape[0]


def _named(scenario: Scenario, view: View, with_robot: bool) -> tuple[np.ndarray, np.ndarray]:
    """Class and instance of the bodies by their numbers in the view, the floor and the sky at the end."""
    scenery, own = _kinds(scenario.environment.scenery.solids), _kinds(scenario.robot.solids)
    people, bodies = view.counts[3], sum(scenery)
    semantic, instance, first = [], [], people
    for theirs, mine in zip(scenery, own if with_robot else (0, 0, 0), strict=True):
        semantic += [OBSTACLE] * theirs + [ROBOT] * mine
        instance += [*range(first, first + theirs)] + [people + bodies] * mine
        first += theirs
    semantic += [PERSON] * people + [FLOOR, SKY]
    instance += [*range(people), -1, -1]
    return np.array(semantic, np.int32), np.array(instance, np.int32)


def _shell(scenario: Scenario, view: View, with_robot: bool) -> Array:
    """(3, bodies) the colors of the bodies by their numbers in the view; people, floor and sky have others."""
    parts = []
    solids, own = scenario.environment.scenery.solids, scenario.robot.solids
    theirs, mine = np.cumsum((0, *_kinds(solids))), np.cumsum((0, *_kinds(own)))
    for kind in range(3):
        parts.append(solids.color[theirs[kind] : theirs[kind + 1]])
        if with_robot:
            parts.append(own.color[mine[kind] : mine[kind + 1]])
    return jnp.concatenate([*parts, jnp.zeros((view.counts[3] + 2, 3), float)]).T

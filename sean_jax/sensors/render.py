"""Pictures in color (section IV-F), and with them depth, what each pixel shows, and of whom.

Shaded by a sun and an ambient light, dark under and beside what stands on the floor. Each person has a color of their
own, a face on the side where they look, and hair on the other.
"""

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import length, rotate
from sean_jax.raycast import MISS, Rays, View, by_rows, search, surface
from sean_jax.sensors.cameras import Camera, rays
from sean_jax.sensors.sight import sight

SKY, FLOOR, OBSTACLE, PERSON, ROBOT = range(5)
CLASSES = ("sky", "floor", "obstacle", "person", "robot")
"""what the numbers of ``Picture.semantic`` mean"""

AMBIENT, SUN = 0.55, 0.5  # shares of the light
SKIN, HAIR, LEGS = (0.87, 0.70, 0.58), (0.24, 0.18, 0.15), (0.22, 0.25, 0.32)
NECK, WAIST = 1.47, 0.85  # m above the floor
SHADOW, SHADOW_REACH = 0.45, 0.22  # of the light that is lost beside a body, and m over which that fades


@struct.dataclass
class Picture:
    """What a camera shows, row by row from the top."""

    rgb: Array  # (H, W, 3) float from 0 to 1
    depth: Array  # (H, W) m along the direction of view, the camera's far where there is nothing
    semantic: Array  # (H, W) int32, see CLASSES
    instance: Array  # (H, W) int32: a person's index, N + an obstacle's or other body's, -1 for floor and sky


@jax.named_scope("render")
def render(scenario: Scenario, state: State, camera: Camera) -> Picture:
    """The picture of a camera."""
    bundle, cosine = rays(camera)
    view = sight(scenario, state, bundle, camera.sees_robot)
    number = search(jax.lax.stop_gradient(view), bundle, which=True)[1]
    assert number is not None
    along, nx, ny, nz = surface(view, bundle, number)
    semantic, instance = _named(scenario, view, number, camera.sees_robot)
    rgb = _shaded(scenario, state, view, bundle, number, along, (nx, ny, nz), semantic, camera.sees_robot)
    image = by_rows(bundle, along) * cosine
    seen = (image >= camera.near) & (image <= camera.far)
    return Picture(
        rgb=jnp.stack([by_rows(bundle, part) for part in rgb], -1),
        depth=jnp.where(seen, image, camera.far),
        semantic=by_rows(bundle, semantic),
        instance=by_rows(bundle, instance),
    )


def _named(scenario: Scenario, view: View, number: Array, with_robot: bool) -> tuple[Array, Array]:
    """(T, P) class and (T, P) instance of the bodies of those numbers."""
    boxes, cylinders, spheres, people = view.counts
    own = scenario.robot.solids
    mine = (own.boxes.shape[0], own.cylinders.shape[0], own.spheres.shape[0]) if with_robot else (0, 0, 0)
    solid = boxes + cylinders + spheres
    robot, end = jnp.zeros_like(number, bool), 0
    for count, part in zip((boxes, cylinders, spheres), mine, strict=True):
        end += count
        robot |= (number >= end - part) & (number < end)
    semantic = jnp.where(number < solid, OBSTACLE, jnp.where(number < solid + people, PERSON, FLOOR))
    semantic = jnp.where(number == solid + people + 1, SKY, jnp.where(robot, ROBOT, semantic)).astype(jnp.int32)
    instance = jnp.where(number < solid, people + number, number - solid)
    return semantic, jnp.where(number >= solid + people, -1, instance).astype(jnp.int32)


def _shaded(scenario, state, view: View, bundle: Rays, number, along, normal, semantic, with_robot) -> tuple:
    """Red, green and blue (T, P) of each ray."""
    looks = scenario.environment.scenery
    direction = tuple(jnp.asarray(bundle.direction[..., axis]) for axis in range(3))
    reach = jnp.where(along < MISS, along, 0.0)
    offset = (0.0, 0.0, 0.0) if bundle.offset is None else tuple(bundle.offset[..., axis] for axis in range(3))
    x, y, z = (place + reach * part for place, part in zip(offset, direction, strict=True))  # from the sensor
    heading = state.robot.heading
    sun_x, sun_y = rotate(looks.sun[0], looks.sun[1], heading[0], -heading[1])
    facing = jnp.maximum(normal[0] * sun_x + normal[1] * sun_y + normal[2] * looks.sun[2], 0.0)
    light = AMBIENT + SUN * facing
    light = light * jnp.where(semantic == FLOOR, _in_the_shade(view, x, y), 1.0)
    ground_x, ground_y = rotate(x + bundle.origin[0], y + bundle.origin[1], heading[0], heading[1])
    ground = _floor(looks, ground_x + state.robot.position[0], ground_y + state.robot.position[1])
    worn = _people(state, view, number, x, y, z + view.height)
    shell = _colors(scenario, number, with_robot)
    rise = jnp.clip(direction[2], 0.0, 1.0)
    colors = []
    for axis in range(3):
        lit = jnp.where(semantic == FLOOR, ground[axis], jnp.where(semantic == PERSON, worn[axis], shell[axis]))
        sky = looks.sky[1, axis] + (looks.sky[0, axis] - looks.sky[1, axis]) * rise
        colors.append(jnp.clip(jnp.where(semantic == SKY, sky, lit * light), 0.0, 1.0))
    return tuple(colors)


def _in_the_shade(view: View, x: Array, y: Array) -> Array:
    """(T, P) share of the light that places of the floor get beside what stands there."""

    def darker(dark: Array, distance: Array) -> Array:
        return jnp.maximum(dark, jnp.exp(-jnp.maximum(distance, 0.0) / SHADOW_REACH))

    def by_person(dark: Array, place: Array) -> tuple[Array, None]:
        return darker(dark, length(x - place[0], y - place[1]) - view.radius), None

    def by_box(dark: Array, box: Array) -> tuple[Array, None]:
        u, v = rotate(x - box[0], y - box[1], box[6], -box[7])
        out = length(jnp.maximum(jnp.abs(u) - box[3], 0.0), jnp.maximum(jnp.abs(v) - box[4], 0.0))
        return darker(dark, out + jnp.maximum(box[2] - box[5] + view.height, 0.0)), None

    dark = jax.lax.scan(by_person, jnp.zeros_like(x), view.people)[0]
    dark = jax.lax.scan(by_box, dark, view.boxes)[0]
    return 1.0 - SHADOW * dark


def _floor(looks, x: Array, y: Array) -> tuple:
    """The squares of the floor at places (x, y) over the ground."""
    odd = jnp.mod(jnp.floor(x / looks.square) + jnp.floor(y / looks.square), 2.0) > 0.5
    return tuple(jnp.where(odd, looks.floor[1, axis], looks.floor[0, axis]) for axis in range(3))


def _colors(scenario: Scenario, number: Array, with_robot: bool) -> tuple:
    """The color of each body of the scenery, and of the robot's, by number."""
    solids, own = scenario.environment.scenery.solids, scenario.robot.solids
    counts = solids.boxes.shape[0], solids.cylinders.shape[0]
    parts = [solids.color[: counts[0]], solids.color[counts[0] : sum(counts)], solids.color[sum(counts) :]]
    if with_robot:
        mine = own.boxes.shape[0], own.cylinders.shape[0]
        its = [own.color[: mine[0]], own.color[mine[0] : sum(mine)], own.color[sum(mine) :]]
        parts = [part for pair in zip(parts, its, strict=True) for part in pair]
    color = jnp.concatenate([*parts, jnp.zeros((1, 3), jnp.float32)])
    row = color[jnp.minimum(number, color.shape[0] - 1)]
    return row[..., 0], row[..., 1], row[..., 2]


def _people(state: State, view: View, number: Array, x: Array, y: Array, up: Array) -> tuple:
    """What people wear at places (x, y) from the sensor and ``up`` above the floor."""
    boxes, cylinders, spheres, count = view.counts
    if not count:
        return tuple(jnp.full_like(x, part) for part in SKIN)
    who = jnp.clip(number - (boxes + cylinders + spheres), 0, count - 1)
    heading = state.pedestrians.heading
    look_x, look_y = rotate(heading[:, 0], heading[:, 1], state.robot.heading[0], -state.robot.heading[1])
    ahead = (x - view.people[who, 0]) * look_x[who] + (y - view.people[who, 1]) * look_y[who]
    face = (up > NECK) & (ahead > 0.03) & (up < NECK + 0.22)
    hue = jnp.mod(who.astype(jnp.float32) * 0.618034 + 0.08, 1.0)
    shirt = tuple(0.35 + 0.5 * jnp.clip(jnp.abs(jnp.mod(hue + turn, 1.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0)
                  for turn in (0.0, 2.0 / 3.0, 1.0 / 3.0))  # fmt: skip
    return tuple(
        jnp.where(face, SKIN[axis], jnp.where(up > NECK, HAIR[axis], jnp.where(up > WAIST, shirt[axis], LEGS[axis])))
        for axis in range(3)
    )

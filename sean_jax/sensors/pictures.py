"""Pictures in color (section IV-F), with depth, class and instance of each pixel.

A sun and an ambient light shade all bodies. The floor is darker beside bodies that stand on it. Each person has a shirt
of another color, a face, hair, and legs that stride as they walk. All that is paint: rays meet a capsule and a head.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array, Scenario, Scenery, Solids, State
from sean_jax.geometry import rotate
from sean_jax.raycast import MISS, Rays, View, along, by_rows, search, surface
from sean_jax.sensors.cameras import Camera, rays, sensor_view

SKY, FLOOR, OBSTACLE, PERSON, ROBOT = range(5)
CLASSES = ("sky", "floor", "obstacle", "person", "robot")
"""The meaning of the numbers in ``Picture.semantic``."""
AMBIENT, SUN = 0.55, 0.5  # shares of the light
SKIN, HAIR, LEGS = (0.87, 0.70, 0.58), (0.24, 0.18, 0.15), (0.22, 0.25, 0.32)
NECK, WAIST = 1.47, 0.85  # m above the floor
FACE = 0.22  # m, height of a face
LEG, APART = 0.08, 0.1  # m, radius of a leg, and distance between the centers of body and leg
STRIDE, SPREAD = 1.4, 0.3  # m, length of two steps, and maximum distance of a foot ahead of the body, from 1 m/s on
BETWEEN = 0.35  # share of the light between the legs
SHADOW, SHADOW_REACH = 0.45, 0.22  # share of the light lost beside a body, and m over which the loss fades
Color = tuple[Array, Array, Array]  # red, green and blue, of one shape


@struct.dataclass
class Picture:
    """The picture of a camera, row by row from the top."""

    rgb: Float[Array, "H W 3"]  # from 0 to 1
    depth: Float[Array, "H W"]  # m along the direction of view, the camera's far where there is nothing
    semantic: Int[Array, "H W"]  # index into CLASSES
    instance: Int[Array, "H W"]  # a person's index, N + a body's index, then the robot; -1 floor, sky


@jax.named_scope("render")
def render(scenario: Scenario, state: State, camera: Camera) -> Picture:
    """The picture of a camera. Depth and color are differentiable as in ``depth``; class and instance are not."""
    bundle, cosine = rays(camera)
    view = sensor_view(scenario, state, camera, camera.sees_robot)
    number = search(jax.lax.stop_gradient(view), bundle)[1]
    distance, nx, ny, nz = surface(view, bundle, number)
    # Without the barriers XLA computes all of this again for each color.
    number, distance, nx, ny, nz = jax.lax.optimization_barrier((number, distance, nx, ny, nz))
    semantic, instance = (jnp.asarray(table)[number] for table in _labels(scenario, view, camera.sees_robot))
    kinds = semantic == SKY, semantic == FLOOR, semantic == PERSON
    body_color = _body_colors(scenario, view, camera.sees_robot)[:, number]
    rgb = colors(scenario, state, view, bundle, number, distance, (nx, ny, nz), kinds, body_color)
    picture = jnp.zeros((*cosine.shape, 3), float)
    for channel, part in enumerate(rgb):  # not jnp.stack: XLA would compute their common parts once for each
        picture = picture.at[..., channel].set(by_rows(bundle, part))
    image = by_rows(bundle, distance) * jnp.asarray(cosine, float)
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
    scenery, robot = _counts(scenario.environment.scenery.solids), _counts(scenario.robot.solids)
    people, bodies = view.counts[3], sum(scenery)
    semantic, instance, first = [], [], people
    for of_scenery, of_robot in zip(scenery, robot if with_robot else (0, 0, 0), strict=True):
        semantic += [OBSTACLE] * of_scenery + [ROBOT] * of_robot
        instance += [*range(first, first + of_scenery)] + [people + bodies] * of_robot
        first += of_scenery
    semantic += [PERSON] * people + [FLOOR, SKY]
    instance += [*range(people), -1, -1]
    return np.array(semantic, np.int32), np.array(instance, np.int32)


def _body_colors(scenario: Scenario, view: View, with_robot: bool) -> Array:
    """(3, bodies + 2) colors by number in the view; zeros for people, floor and sky, which ``colors`` paints."""
    parts = []
    solids, robot = scenario.environment.scenery.solids, scenario.robot.solids
    first, robot_first = np.cumsum((0, *_counts(solids))), np.cumsum((0, *_counts(robot)))
    for kind in range(3):
        parts.append(solids.color[first[kind] : first[kind + 1]])
        if with_robot:
            parts.append(robot.color[robot_first[kind] : robot_first[kind + 1]])
    return jnp.concatenate([*parts, jnp.zeros((view.counts[3] + 2, 3), float)]).T


# --- paint ---


def colors(
    scenario: Scenario,
    state: State,
    view: View,
    bundle: Rays,
    number: Int[Array, "tiles rays"],
    distance: Float[Array, "tiles rays"],
    normal: tuple[Float[Array, "tiles rays"], Float[Array, "tiles rays"], Float[Array, "tiles rays"]],
    kinds: tuple[Bool[Array, "tiles rays"], Bool[Array, "tiles rays"], Bool[Array, "tiles rays"]],
    body_color: Float[Array, "3 tiles rays"],
) -> Color:
    """Red, green and blue of each ray, from 0 to 1.

    Args:
        number: in the view, of the first body that each ray meets.
        distance: m, along each ray to that body.
        normal: x, y and z of the outward normal there.
        kinds: whether the ray meets the sky, the floor, a person.
        body_color: color of any other body.
    """
    looks, heading = scenario.environment.scenery, state.robot.heading
    is_sky, is_floor, is_person = kinds
    x, y, z = along(bundle, jnp.where(distance < MISS, distance, 0.0))
    sun_x, sun_y = rotate(looks.sun[0], looks.sun[1], heading[0], -heading[1])
    facing = jnp.maximum(normal[0] * sun_x + normal[1] * sun_y + normal[2] * looks.sun[2], 0.0)
    light = (AMBIENT + SUN * facing) * jnp.where(is_floor, _beside_bodies(view, x, y), 1.0)
    light = jax.lax.optimization_barrier(light)
    ground_x, ground_y = rotate(x + view.place[0], y + view.place[1], heading[0], heading[1])
    ground = _floor(looks, ground_x + state.robot.position[0], ground_y + state.robot.position[1])
    clothes = _clothes(state, view, number, x, y, z + view.height)
    rise = jnp.clip(jnp.asarray(bundle.direction[2]), 0.0, 1.0)

    def channel(axis: int) -> Array:
        lit = jnp.where(is_floor, ground[axis], jnp.where(is_person, clothes[axis], body_color[axis]))
        sky = looks.sky[1, axis] + (looks.sky[0, axis] - looks.sky[1, axis]) * rise
        return jnp.clip(jnp.where(is_sky, sky, lit * light), 0.0, 1.0)

    return channel(0), channel(1), channel(2)


def _beside_bodies(view: View, x: Array, y: Array) -> Array:
    """Share of the light that reaches places of the floor, which is less beside bodies."""

    def person(nearest: Array, place: Array) -> tuple[Array, None]:
        dx, dy = x - place[0], y - place[1]
        return jnp.minimum(nearest, dx * dx + dy * dy), None

    def box(nearest: Array, row: Array) -> tuple[Array, None]:
        u, v = rotate(x - row[0], y - row[1], row[6], -row[7])
        u, v = jnp.maximum(jnp.abs(u) - row[3], 0.0), jnp.maximum(jnp.abs(v) - row[4], 0.0)
        below = jnp.maximum(row[2] - row[5] + view.height, 0.0)
        return jnp.minimum(nearest, u * u + v * v + below * below), None

    far = jnp.full_like(x, 1e6)
    people = jax.lax.scan(person, far, jax.lax.stop_gradient(view.people), unroll=4)[0]
    boxes = jax.lax.scan(box, far, jax.lax.stop_gradient(view.boxes), unroll=4)[0]
    away = jnp.minimum(jnp.maximum(jnp.sqrt(people) - view.radius, 0.0), jnp.sqrt(boxes))
    return 1.0 - SHADOW * jnp.exp(-jax.lax.stop_gradient(away) / SHADOW_REACH)


def _floor(looks: Scenery, x: Array, y: Array) -> Color:
    """The color of the floor at places (x, y) [m] over the ground."""
    odd = jnp.mod(jnp.floor(x / looks.square) + jnp.floor(y / looks.square), 2.0) > 0.5
    red, green, blue = (jnp.where(odd, looks.floor[1, axis], looks.floor[0, axis]) for axis in range(3))
    return red, green, blue


def _clothes(state: State, view: View, number: Array, x: Array, y: Array, up: Array) -> Color:
    """The color of people at places (x, y) [m] from the sensor and ``up`` [m] above the floor."""
    boxes, cylinders, spheres, count = view.counts
    if not count:
        return x, x, x
    person = jnp.clip(number - (boxes + cylinders + spheres), 0, count - 1)
    heading = state.pedestrians.heading
    look_x, look_y = rotate(heading[:, 0], heading[:, 1], state.robot.heading[0], -state.robot.heading[1])
    look_x, look_y = look_x[person], look_y[person]
    away_x, away_y = x - view.people[:, 0][person], y - view.people[:, 1][person]
    head = up > NECK
    face = head & (away_x * look_x + away_y * look_y > 0.03) & (up < NECK + FACE)
    on_leg = _on_leg(_foot(state)[person] * (1.0 - up / WAIST), look_x, look_y, x, y, away_x, away_y)
    shirt, legs = shirts(count), jnp.where(on_leg, 1.0, BETWEEN)

    def channel(axis: int) -> Array:
        body = jnp.where(up > WAIST, shirt[axis][person], LEGS[axis] * legs)
        return jnp.where(face, SKIN[axis], jnp.where(head, HAIR[axis], body))

    return channel(0), channel(1), channel(2)


def _foot(state: State) -> Float[Array, "N"]:
    """How far [m] each person's left foot is ahead of the body, and the right one behind it."""
    people = state.pedestrians
    along_way = (people.position * people.heading).sum(-1)
    speed = jnp.sqrt((people.velocity * people.velocity).sum(-1) + 1e-12)
    return SPREAD * jnp.minimum(speed, 1.0) * jnp.sin(2.0 * jnp.pi / STRIDE * along_way)


def _on_leg(ahead: Array, look_x: Array, look_y: Array, x: Array, y: Array, away_x: Array, away_y: Array) -> Array:
    """Whether the ray to (x, y) passes a leg: the left one is ``ahead`` [m] of the body there, the right one behind."""
    far = jnp.maximum(jnp.sqrt(x * x + y * y), 1e-6)

    def passes(forward: Array, left: float) -> Array:
        to_x = forward * look_x - left * look_y - away_x
        to_y = forward * look_y + left * look_x - away_y
        return jnp.abs(to_x * y - to_y * x) < LEG * far

    return passes(ahead, APART) | passes(-ahead, -APART)


def shirts(count: int) -> Color:
    """Red, green and blue (N,) of each person's shirt, from 0 to 1; people with successive indices differ most."""
    hue = jnp.mod(jnp.arange(count, dtype=float) * 0.618034 + 0.08, 1.0)

    def part(turn: float) -> Array:
        return 0.35 + 0.5 * jnp.clip(jnp.abs(jnp.mod(hue + turn, 1.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0)

    return part(0.0), part(2.0 / 3.0), part(1.0 / 3.0)

"""Pictures in color (section IV-F), with depth, class and instance of each pixel.

Rays meet a capsule and a head for each person, as in depth images. In color, a figure with arms and striding legs
stands inside them (``sensors.figures``), and beside its limbs the picture shows what is behind the person. Floors,
ceilings, walls, shelves and facades have patterns, which are paint alone. A sun and the sky light all bodies. The floor
is darker beside bodies that stand on it, and bodies are darker near the floor.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.core.data_types import PATTERNS, Array, Scenario, Scenery, Solids, State
from sean_jax.core.geometry import rotate
from sean_jax.sensors import person_figure
from sean_jax.sensors.cameras import Camera, rays
from sean_jax.sensors.mounts import sensor_view
from sean_jax.sensors.raycast import MISS, Rays, View, along, attach, by_rows, search_behind, surface

SKY, FLOOR, OBSTACLE, PERSON, ROBOT = range(5)
CLASSES = ("sky", "floor", "obstacle", "person", "robot")
"""The meaning of the numbers in ``Picture.semantic``."""
AMBIENT, SKYLIGHT, SUN = 0.5, 0.16, 0.4  # shares of the light; the skylight comes from above
SHADOW, SHADOW_REACH = 0.45, 0.22  # share of the light lost beside a body, and m over which the loss fades
CORNER, CORNER_REACH = 0.35, 0.12  # likewise, on a body near the floor
JOINT_FADE, SQUARE_FADE = 5.0, 12.0  # m, at which joints and squares have lost much of their contrast
TILE, LAMP = 0.25, (4.0, 3.0)  # sides of a ceiling's tile over its height; tiles from one lamp to the next
PANEL, LAMPS, SEAM = (0.84, 0.84, 0.82), (1.0, 1.0, 0.96), 0.9  # colors of tiles and lamps, light of the seams
BAY, LEVEL, BEAM, UPRIGHT = 2.0, 1.0, 0.09, 0.07  # m, of shelves: width, height, thickness of beams and uprights
BEAM_COLOR, GOODS, INSIDE = (0.84, 0.45, 0.16), (0.74, 0.58, 0.40), 0.3
BOARD, DADO = (0.1, 0.6), (1.1, 0.86)  # m up to which a wall is darker, and its light there
STOREY, PLINTH, GLASS = 3.0, (0.6, 0.7), (0.36, 0.45, 0.53)  # m, of a facade; its foot; color of windows
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
    """The picture of a camera. Depth and color are differentiable as in ``depth``; class and instance are not.

    Depth, class and instance are those of the bodies that ``depth`` sees, without figures, patterns and ceilings.
    """
    bundle, cosine = rays(camera)
    view = sensor_view(scenario, state, camera, camera.sees_robot)
    first = search_behind(jax.lax.stop_gradient(view), bundle)
    # Without the barriers XLA computes all of this again for each color.
    distance, number, _, behind = jax.lax.optimization_barrier(first)
    distance = attach(bundle, view, distance, number)
    semantic, instance = (jnp.asarray(table)[number] for table in _labels(scenario, view, camera.sees_robot))
    body_color = _body_colors(scenario, view, camera.sees_robot)
    rgb = colors(scenario, state, view, bundle, number, distance, behind, body_color)
    picture = jax.lax.platform_dependent(rgb, cpu=partial(_one_by_one, bundle), default=partial(_at_once, bundle))
    image = by_rows(bundle, distance) * jnp.asarray(cosine, float)
    in_range = (image >= camera.near) & (image <= camera.far)
    return Picture(
        rgb=picture,
        depth=jnp.where(in_range, image, camera.far),
        semantic=by_rows(bundle, semantic),
        instance=by_rows(bundle, instance),
    )


# XLA computes the common parts of the channels once for each, unless one is written after the other on a CPU, or all
# are written before they are put together on a GPU.
def _one_by_one(bundle: Rays, rgb: Color) -> Array:
    picture = jnp.zeros((*bundle.shape, 3), float)
    for channel, part in enumerate(rgb):
        picture = picture.at[..., channel].set(by_rows(bundle, part))
    return picture


def _at_once(bundle: Rays, rgb: Color) -> Array:
    return jnp.stack([by_rows(bundle, part) for part in jax.lax.optimization_barrier(rgb)], -1)


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
    """(4, bodies + 2) as of ``Solids.color``, by number in the view without people; zeros for floor and sky."""
    parts = []
    solids, robot = scenario.environment.scenery.solids, scenario.robot.solids
    first, robot_first = np.cumsum((0, *_counts(solids))), np.cumsum((0, *_counts(robot)))
    for kind in range(3):
        parts.append(solids.color[first[kind] : first[kind + 1]])
        if with_robot:
            parts.append(robot.color[robot_first[kind] : robot_first[kind + 1]])
    return jnp.concatenate([*parts, jnp.zeros((2, 4), float)]).T


# --- paint ---


def colors(
    scenario: Scenario,
    state: State,
    view: View,
    bundle: Rays,
    number: Int[Array, "tiles rays"],
    distance: Float[Array, "tiles rays"],
    behind: Int[Array, "tiles rays"],
    body_color: Float[Array, "4 bodies"],
) -> Color:
    """Red, green and blue of each ray, from 0 to 1.

    Args:
        number: in the view, of the first body that each ray meets.
        distance: m, along each ray to that body.
        behind: number of the first body that is no person.
        body_color: of all bodies but people, as of ``Solids.color``, then of floor and sky.
    """
    looks, heading, place = scenario.environment.scenery, state.robot.heading, state.robot.position
    people, first = view.counts[3], sum(view.counts[:3])
    behind = jnp.where(behind >= first, behind - people, behind)  # in a view without people
    away, nx, ny, nz = surface(dataclasses.replace(view, people=view.people[:0]), bundle, behind)
    if people:
        person = jnp.where((number >= first) & (number < first + people), number - first, -1)
        figure = person_figure.figure(state, view, bundle, person, distance)
        on_figure = figure.distance < MISS
        away = jnp.where(on_figure, figure.distance, away)
        nx, ny, nz = (jnp.where(on_figure, new, old) for new, old in zip(figure.normal, (nx, ny, nz), strict=True))
    else:
        figure, on_figure = None, jnp.zeros(behind.shape, bool)
    away, nx, ny, nz, on_figure = jax.lax.optimization_barrier((away, nx, ny, nz, on_figure))
    is_floor, is_sky = (behind == first) & ~on_figure, (behind == first + 1) & ~on_figure
    x, y, z = along(bundle, jnp.where(away < MISS, away, 0.0))
    up = z + view.height

    def over_ground(x: Array, y: Array) -> tuple[Array, Array]:
        x, y = rotate(x + view.place[0], y + view.place[1], heading[0], heading[1])
        return x + place[0], y + place[1]

    sun_x, sun_y = rotate(looks.sun[0], looks.sun[1], heading[0], -heading[1])
    facing = jnp.maximum(nx * sun_x + ny * sun_y + nz * looks.sun[2], 0.0)
    corner = 1.0 - CORNER * jnp.exp(-jnp.maximum(up, 0.0) / CORNER_REACH)
    light = AMBIENT + SKYLIGHT * (0.5 + 0.5 * nz) + SUN * facing
    light = light * jnp.where(is_floor, _beside_bodies(view, bundle, x, y), corner)
    ground_x, ground_y = over_ground(x, y)
    tangent_x, tangent_y = rotate(-ny, nx, heading[0], heading[1])
    across = ground_x * tangent_x + ground_y * tangent_y
    light, ground_x, ground_y, across = jax.lax.optimization_barrier((light, ground_x, ground_y, across))
    floor = _floor(looks, ground_x, ground_y, away)
    red, green, blue, pattern = (column[jnp.where(on_figure, first, behind)] for column in body_color)
    side = jnp.where(jnp.abs(nz) < 0.5, pattern, 0.0)
    painted = _pattern((red, green, blue), side, across, up)

    # The ceiling hides what rises above it.
    rise = jnp.asarray(np.maximum(bundle.direction[2], 0.0), float)
    room = looks.ceiling - view.height
    to_ceiling = jnp.where((rise > 1e-6) & (room > 0.0), room / jnp.maximum(rise, 1e-6), MISS)
    is_ceiling = to_ceiling < away
    far = jnp.where(is_ceiling, to_ceiling, 0.0)
    above_x, above_y = over_ground(*along(bundle, far)[:2])
    ceiling = _ceiling(looks, above_x, above_y, far)

    def channel(axis: int) -> Array:
        clothes = painted[axis] if figure is None else jnp.where(on_figure, figure.color[axis], painted[axis])
        lit = jnp.where(is_floor, floor[axis], clothes)
        sky = looks.sky[1, axis] + (looks.sky[0, axis] - looks.sky[1, axis]) * rise
        inside = jnp.where(is_ceiling, ceiling[axis], jnp.where(is_sky, sky, lit * light))
        return jnp.clip(inside, 0.0, 1.0)

    return channel(0), channel(1), channel(2)


def _beside_bodies(view: View, bundle: Rays, x: Array, y: Array) -> Array:
    """Share of the light that reaches places of the floor, which is less beside bodies; 1 for rays that rise."""
    falls = np.flatnonzero((bundle.direction[2] < 0.0).any(1))  # tiles
    if not len(falls):
        return jnp.ones_like(x)
    first, last = falls[0], falls[-1] + 1
    light = _beside(view, x[first:last], y[first:last])
    return jnp.pad(light, ((first, len(x) - last), (0, 0)), constant_values=1.0)


def _beside(view: View, x: Array, y: Array) -> Array:
    def person(nearest: Array, place: Array) -> tuple[Array, None]:
        dx, dy = x - place[0], y - place[1]
        return jnp.minimum(nearest, dx * dx + dy * dy), None

    def box(nearest: Array, row: Array) -> tuple[Array, None]:
        u, v = rotate(x - row[0], y - row[1], row[6], -row[7])
        u, v = jnp.maximum(jnp.abs(u) - row[3], 0.0), jnp.maximum(jnp.abs(v) - row[4], 0.0)
        below = jnp.maximum(row[2] - row[5] + view.height, 0.0)
        return jnp.minimum(nearest, u * u + v * v + below * below), None

    far = jnp.full_like(x, 1e6)
    people = jax.lax.scan(person, far, jax.lax.stop_gradient(view.people), unroll=16)[0]
    boxes = jax.lax.scan(box, far, jax.lax.stop_gradient(view.boxes), unroll=16)[0]
    away = jnp.minimum(jnp.maximum(jnp.sqrt(people) - 0.6 * view.radius, 0.0), jnp.sqrt(boxes))
    return 1.0 - SHADOW * jnp.exp(-jax.lax.stop_gradient(away) / SHADOW_REACH)


def _floor(looks: Scenery, x: Array, y: Array, distance: Array) -> Color:
    """The color of the floor at places (x, y) [m] over the ground, less in contrast at a distance [m]."""
    odd = jnp.mod(jnp.floor(x / looks.square) + jnp.floor(y / looks.square), 2.0) > 0.5
    period = 2.0 * looks.square
    beside = jnp.minimum(jnp.abs(x - period * jnp.round(x / period)), jnp.abs(y - period * jnp.round(y / period)))
    in_joint = jnp.where(beside < 0.5 * looks.joint, 1.0 / (1.0 + jnp.square(distance / JOINT_FADE)), 0.0)
    contrast = 0.5 * jnp.exp(-distance / SQUARE_FADE)
    second = jnp.where(odd, 0.5 + contrast, 0.5 - contrast)

    def channel(axis: int) -> Array:
        square = looks.floor[0, axis] + second * (looks.floor[1, axis] - looks.floor[0, axis])
        return square + in_joint * (looks.floor[2, axis] - square)

    return channel(0), channel(1), channel(2)


def _ceiling(looks: Scenery, x: Array, y: Array, distance: Array) -> Color:
    """The color of the ceiling at places (x, y) [m] over the ground: square tiles with lamps, darker far away."""
    side = jnp.maximum(TILE * looks.ceiling, 1e-3)
    u, v = x / side, y / side
    seam = (jnp.abs(u - jnp.round(u)) < 0.02) | (jnp.abs(v - jnp.round(v)) < 0.02)
    lamp = (jnp.mod(u, LAMP[0]) < 2.0) & (jnp.mod(v, LAMP[1]) < 1.0)
    fade = jnp.exp(-distance / (8.0 * looks.ceiling + 1e-3))
    tile = jnp.where(seam, 1.0 - (1.0 - SEAM) * fade, 1.0) * (0.82 + 0.18 * fade)

    def channel(axis: int) -> Array:
        return jnp.where(lamp & ~seam, LAMPS[axis], PANEL[axis] * tile)

    return channel(0), channel(1), channel(2)


def _pattern(color: Color, pattern: Array, across: Array, up: Array) -> Color:
    """The colors of bodies with a pattern, an index into PATTERNS, ``across`` a side and ``up`` from the floor [m]."""
    is_wall, is_shelf, is_facade = (pattern == PATTERNS.index(name) for name in PATTERNS[1:])
    wall = jnp.where(up < BOARD[0], BOARD[1], jnp.where(up < DADO[0], DADO[1], 1.0))

    bay, level = across / BAY, up / LEVEL
    upright = jnp.abs(bay - jnp.round(bay)) * BAY < 0.5 * UPRIGHT
    beam = (level - jnp.floor(level)) * LEVEL < BEAM
    slot = 2.0 * bay
    chance = jnp.mod(0.618034 * jnp.floor(slot) + 0.754878 * jnp.floor(level), 1.0)
    within = jnp.abs(slot - jnp.floor(slot) - 0.5) < 0.3 + 0.14 * chance
    goods = within & (level - jnp.floor(level) < 0.45 + 0.4 * jnp.mod(7.0 * chance, 1.0)) & (chance > 0.12)

    column, storey = across / STOREY, up / STOREY
    pane = (jnp.abs(column - jnp.floor(column) - 0.5) < 0.24) & (jnp.abs(storey - jnp.floor(storey) - 0.55) < 0.26)
    foot = jnp.where(up < PLINTH[0], PLINTH[1], 1.0)

    def channel(axis: int) -> Array:
        own = color[axis]
        inside = jnp.where(goods, GOODS[axis] * (0.7 + 0.4 * chance), INSIDE * own)
        shelf = jnp.where(upright, own, jnp.where(beam, BEAM_COLOR[axis], inside))
        facade = jnp.where(pane, GLASS[axis], own * foot)
        return jnp.where(is_shelf, shelf, jnp.where(is_facade, facade, jnp.where(is_wall, own * wall, own)))

    return channel(0), channel(1), channel(2)

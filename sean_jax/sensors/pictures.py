"""Pictures in color (section IV-F), with depth, class and instance of each pixel.

Rays meet a capsule and a head for each person, as in depth images. In color, a figure with arms and striding legs
stands inside them (``person_figure``), and beside its limbs the picture shows what is behind the person. Floors,
ceilings, walls, shelves and facades have patterns, which are paint alone. A sun and the sky light all bodies. The floor
is darker beside bodies that stand on it, and bodies are darker near the floor.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.core.data_types import PATTERNS, Array, Scenario, Scenery, Solids, State
from sean_jax.core.geometry import rotate
from sean_jax.sensors.cameras import Camera, rays
from sean_jax.sensors.mounts import sensor_view
from sean_jax.sensors.person_figure import PersonFigure, trace_figures
from sean_jax.sensors.raycast import MISS, Rays, View, along, attach, by_rows, search_behind, surface
from sean_jax.sensors.raycast.vectors import Vector

SKY, FLOOR, OBSTACLE, PERSON, ROBOT = range(5)
CLASSES = ("sky", "floor", "obstacle", "person", "robot")
"""The meaning of the numbers in ``Picture.semantic``."""
Color = tuple[Array, Array, Array]  # red, green and blue, of one shape

# Light.
AMBIENT = 0.5  # share of the light that is the same on all sides
SKYLIGHT = 0.16  # share of the light from above
SUN = 0.4  # share of the light from the sun
SHADOW = 0.45  # share of the light lost beside a body
SHADOW_REACH = 0.22  # m, over which the loss fades
CORNER = 0.35  # share of the light lost on a body near the floor
CORNER_REACH = 0.12  # m, over which the loss fades
JOINT_FADE = 5.0  # m, at which joints have lost much of their contrast
SQUARE_FADE = 12.0  # m, at which squares have lost much of their contrast

# Ceilings.
TILE = 0.25  # sides of a tile over the height of the ceiling
LAMP = (4.0, 3.0)  # tiles from one lamp to the next
PANEL = (0.84, 0.84, 0.82)  # color of tiles
LAMPS = (1.0, 1.0, 0.96)  # color of lamps
SEAM = 0.9  # light of the seams

# Shelves.
BAY = 2.0  # m, width
LEVEL = 1.0  # m, height
BEAM = 0.09  # m, thickness of beams
UPRIGHT = 0.07  # m, thickness of uprights
BEAM_COLOR = (0.84, 0.45, 0.16)
GOODS = (0.74, 0.58, 0.40)
INSIDE = 0.3  # light inside a shelf, over that of its frame

# Walls and facades.
BOARD = (0.1, 0.6)  # m up to which a wall is darkest, and its light there
DADO = (1.1, 0.86)  # m up to which a wall is darker, and its light there
STOREY = 3.0  # m, height of a storey of a facade, and distance of its windows
PLINTH = (0.6, 0.7)  # m up to which a facade is darker, and its light there
GLASS = (0.36, 0.45, 0.53)  # color of windows


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
    hits = search_behind(jax.lax.stop_gradient(view), bundle)
    # Without the barriers XLA computes all of this again for each color.
    distance, number, _, number_behind = jax.lax.optimization_barrier(hits)
    distance = attach(bundle, view, distance, number)
    semantic, instance = (jnp.asarray(table)[number] for table in _labels(scenario, view, camera.sees_robot))

    body_color = _body_colors(scenario, camera.sees_robot)
    rgb = colors(scenario, state, view, bundle, number, distance, number_behind, body_color)
    on_cpu = partial(_one_by_one, bundle)
    on_gpu = partial(_at_once, bundle)
    picture = jax.lax.platform_dependent(rgb, cpu=on_cpu, default=on_gpu)

    image = by_rows(bundle, distance) * jnp.asarray(cosine, float)
    in_range = (image >= camera.near) & (image <= camera.far)
    depth = jnp.where(in_range, image, camera.far)
    return Picture(
        rgb=picture,
        depth=depth,
        semantic=by_rows(bundle, semantic),
        instance=by_rows(bundle, instance),
    )


# XLA computes the common parts of the channels once for each, unless one is written after the other on a CPU, or all
# are written before they are put together on a GPU.
def _one_by_one(bundle: Rays, rgb: Color) -> Array:
    picture = jnp.zeros((*bundle.shape, 3), float)
    for channel, values in enumerate(rgb):
        picture = picture.at[..., channel].set(by_rows(bundle, values))
    return picture


def _at_once(bundle: Rays, rgb: Color) -> Array:
    rgb = jax.lax.optimization_barrier(rgb)
    return jnp.stack([by_rows(bundle, values) for values in rgb], -1)


def _counts(solids: Solids) -> tuple[int, int, int]:
    """Numbers of boxes, cylinders and spheres."""
    return solids.boxes.shape[0], solids.cylinders.shape[0], solids.spheres.shape[0]


def _labels(scenario: Scenario, view: View, with_robot: bool) -> tuple[np.ndarray, np.ndarray]:
    """Class and instance (bodies + 2,) by number in the view; the floor and the sky come last."""
    scenery_counts = _counts(scenario.environment.scenery.solids)
    robot_counts = (0, 0, 0)
    if with_robot:
        robot_counts = _counts(scenario.robot.solids)
    people = view.counts[3]
    obstacles = sum(scenery_counts)
    semantic = []
    instance = []
    first = people
    for scenery_count, robot_count in zip(scenery_counts, robot_counts, strict=True):
        semantic += [OBSTACLE] * scenery_count
        semantic += [ROBOT] * robot_count
        instance += range(first, first + scenery_count)
        instance += [people + obstacles] * robot_count
        first += scenery_count
    semantic += [PERSON] * people
    semantic += [FLOOR, SKY]
    instance += [*range(people), -1, -1]
    return np.array(semantic, np.int32), np.array(instance, np.int32)


def _body_colors(scenario: Scenario, with_robot: bool) -> Array:
    """(4, bodies + 2) as of ``Solids.color``, by number in the view without people; zeros for floor and sky."""
    scenery = _colors_by_kind(scenario.environment.scenery.solids)
    robot = _colors_by_kind(scenario.robot.solids)
    colors = []
    for scenery_colors, robot_colors in zip(scenery, robot, strict=True):
        colors.append(scenery_colors)
        if with_robot:
            colors.append(robot_colors)
    floor_and_sky = jnp.zeros((2, 4), float)
    return jnp.concatenate([*colors, floor_and_sky]).T


def _colors_by_kind(solids: Solids) -> list[Array]:
    """(K, 4) of boxes, cylinders and spheres."""
    ends = np.cumsum((0, *_counts(solids)))
    return [solids.color[first:end] for first, end in zip(ends[:-1], ends[1:], strict=True)]


# --- paint ---


def _channels(channel: Callable[[int], Array]) -> Color:
    """Red, green and blue, each by its number."""
    return channel(0), channel(1), channel(2)


class Surface(NamedTuple):
    """What is visible along each ray; (tiles, rays) each."""

    distance: Array  # m, MISS for the sky
    normal: Vector  # in the robot's axes
    on_figure: Array  # bool, of a person


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
    # Colors have no rows for people, whose clothes belong to figures: numbers beyond them move up.
    scenery = scenario.environment.scenery
    people = view.counts[3]
    floor_number = sum(view.counts[:3])  # in a view without people; the sky has the next number
    behind = jnp.where(behind >= floor_number, behind - people, behind)

    # What is visible: figures of people, and beside their limbs what is behind.
    figure, visible = _visible_surface(state, view, bundle, number, distance, behind)
    to_surface, normal, on_figure = jax.lax.optimization_barrier(visible)
    is_floor = (behind == floor_number) & ~on_figure
    is_sky = (behind == floor_number + 1) & ~on_figure
    to_point = jnp.where(to_surface < MISS, to_surface, 0.0)
    point = along(bundle, to_point)
    up = point.z + view.height

    # Bodies and floor darken each other where they touch, or things would seem to float.
    light = _light(scenery, state, normal)
    floor_share = _beside_bodies(view, bundle, point.x, point.y)
    body_share = _near_floor(up)
    light = light * jnp.where(is_floor, floor_share, body_share)
    ground_x, ground_y = _over_ground(state, view, point)
    across = _across_wall(state, normal, ground_x, ground_y)
    light, ground_x, ground_y, across = jax.lax.optimization_barrier((light, ground_x, ground_y, across))

    # Paint depends on places in the world, so patterns stay where they are as the robot moves.
    floor = _floor(scenery, ground_x, ground_y, to_surface)
    body = jnp.where(on_figure, floor_number, behind)
    red, green, blue, pattern = (column[body] for column in body_color)

    # Patterns are for upright sides; tops are plain.
    side_pattern = jnp.where(jnp.abs(normal.z) < 0.5, pattern, 0.0)
    painted = _pattern((red, green, blue), side_pattern, across, up)

    # The ceiling hides what rises above it.
    rise = jnp.asarray(np.maximum(bundle.direction[2], 0.0), float)
    to_ceiling = _to_ceiling(scenery, view, rise)
    is_ceiling = to_ceiling < to_surface
    to_visible = jnp.where(is_ceiling, to_ceiling, 0.0)
    ceiling = _visible_ceiling(scenery, state, view, bundle, to_visible)

    # A pixel is ceiling, else sky, else a lit surface: ceiling and sky have their colors without light.
    def channel(axis: int) -> Array:
        body = painted[axis]
        if figure is not None:
            body = jnp.where(on_figure, figure.color[axis], body)
        lit = jnp.where(is_floor, floor[axis], body) * light
        open_air = jnp.where(is_sky, _sky(scenery, axis, rise), lit)
        color = jnp.where(is_ceiling, ceiling[axis], open_air)
        return jnp.clip(color, 0.0, 1.0)

    return _channels(channel)


def _visible_surface(
    state: State, view: View, bundle: Rays, number: Array, distance: Array, behind: Array
) -> tuple[PersonFigure | None, Surface]:
    """The figures of people, and the surface along each ray: of a figure, or of what is behind the people."""
    without_people = dataclasses.replace(view, people=view.people[:0])
    to_body, body_normal = surface(without_people, bundle, behind)
    people = view.counts[3]
    first_person = sum(view.counts[:3])
    if not people:
        on_figure = jnp.zeros(behind.shape, bool)
        return None, Surface(to_body, body_normal, on_figure)

    end = first_person + people
    is_person = (number >= first_person) & (number < end)
    person = jnp.where(is_person, number - first_person, -1)
    figure = trace_figures(state, view, bundle, person, distance)
    on_figure = figure.distance < MISS
    to_surface = jnp.where(on_figure, figure.distance, to_body)
    components = zip(figure.normal, body_normal, strict=True)
    normal = Vector(*(jnp.where(on_figure, of_figure, of_body) for of_figure, of_body in components))
    return figure, Surface(to_surface, normal, on_figure)


def _to_ceiling(scenery: Scenery, view: View, rise: Array) -> Array:
    """Distance [m] along rays, whose vertical components are ``rise``, to the ceiling; MISS without one."""
    room = scenery.ceiling - view.height
    meets = (rise > 1e-6) & (room > 0.0)
    distance = room / jnp.maximum(rise, 1e-6)
    return jnp.where(meets, distance, MISS)


def _visible_ceiling(scenery: Scenery, state: State, view: View, bundle: Rays, distance: Array) -> Color:
    """The color of the ceiling at a distance [m] along each ray."""
    point = along(bundle, distance)
    x, y = _over_ground(state, view, point)
    return _ceiling(scenery, x, y, distance)


def _sky(scenery: Scenery, axis: int, rise: Array) -> Array:
    """A color of the sky, from the horizon up."""
    horizon = scenery.sky[1, axis]
    zenith = scenery.sky[0, axis]
    return horizon + (zenith - horizon) * rise


def _over_ground(state: State, view: View, point: Vector) -> tuple[Array, Array]:
    """Points from the sensor [m] as (x, y) in the world."""
    position = state.robot.position
    heading = state.robot.heading
    ahead = point.x + view.place[0]
    left = point.y + view.place[1]
    x, y = rotate(ahead, left, heading[0], heading[1])
    return x + position[0], y + position[1]


def _across_wall(state: State, normal: Vector, x: Array, y: Array) -> Array:
    """How far [m] places (x, y) in the world are along a wall with that normal, whose pattern repeats."""
    heading = state.robot.heading
    tangent_x, tangent_y = rotate(-normal.y, normal.x, heading[0], heading[1])
    return x * tangent_x + y * tangent_y


def _light(scenery: Scenery, state: State, normal: Vector) -> Array:
    """Light of the sun and the sky on a surface with that normal."""
    heading = state.robot.heading
    sun_x, sun_y = rotate(scenery.sun[0], scenery.sun[1], heading[0], -heading[1])
    to_sun = normal.x * sun_x + normal.y * sun_y + normal.z * scenery.sun[2]
    sunlight = jnp.maximum(to_sun, 0.0)
    skylight = 0.5 + 0.5 * normal.z
    return AMBIENT + SKYLIGHT * skylight + SUN * sunlight


def _near_floor(up: Array) -> Array:
    """Share of the light that reaches bodies ``up`` m above the floor."""
    fade = jnp.exp(-jnp.maximum(up, 0.0) / CORNER_REACH)
    return 1.0 - CORNER * fade


def _beside_bodies(view: View, bundle: Rays, x: Array, y: Array) -> Array:
    """Share of the light that reaches places of the floor, which is less beside bodies; 1 for rays that rise."""
    falling = np.flatnonzero((bundle.direction[2] < 0.0).any(1))  # tiles
    if not len(falling):
        return jnp.ones_like(x)
    first = falling[0]
    end = falling[-1] + 1
    light = _beside(view, x[first:end], y[first:end])
    other_tiles = first, len(x) - end
    return jnp.pad(light, (other_tiles, (0, 0)), constant_values=1.0)


def _beside(view: View, x: Array, y: Array) -> Array:
    """Share of the light by the distance from the nearest body that stands on the floor."""

    def nearer_person(nearest: Array, position: Array) -> tuple[Array, None]:
        dx = x - position[0]
        dy = y - position[1]
        square = dx * dx + dy * dy
        return jnp.minimum(nearest, square), None

    def nearer_box(nearest: Array, row: Array) -> tuple[Array, None]:
        square = _squared_distance_below(view, row, x, y)
        return jnp.minimum(nearest, square), None

    far = jnp.full_like(x, 1e6)  # m2
    people = jax.lax.stop_gradient(view.people)
    boxes = jax.lax.stop_gradient(view.boxes)
    person_square, _ = jax.lax.scan(nearer_person, far, people, unroll=16)
    box_square, _ = jax.lax.scan(nearer_box, far, boxes, unroll=16)
    to_person = jnp.maximum(jnp.sqrt(person_square) - 0.6 * view.radius, 0.0)
    distance = jnp.minimum(to_person, jnp.sqrt(box_square))
    fade = jnp.exp(-jax.lax.stop_gradient(distance) / SHADOW_REACH)
    return 1.0 - SHADOW * fade


def _squared_distance_below(view: View, box: Array, x: Array, y: Array) -> Array:
    """m2, from places of the floor to the underside of a box, a row of ``View.boxes``."""
    u, v = rotate(x - box[0], y - box[1], box[6], -box[7])
    u = jnp.maximum(jnp.abs(u) - box[3], 0.0)
    v = jnp.maximum(jnp.abs(v) - box[4], 0.0)
    underside = jnp.maximum(box[2] - box[5] + view.height, 0.0)
    return u * u + v * v + underside * underside


def _floor(scenery: Scenery, x: Array, y: Array, distance: Array) -> Color:
    """The color of the floor at places (x, y) [m] over the ground, less in contrast at a distance [m]."""
    # Squares of two colors, in turn.
    column = jnp.floor(x / scenery.square)
    row = jnp.floor(y / scenery.square)
    is_odd = jnp.mod(column + row, 2.0) > 0.5
    contrast = 0.5 * jnp.exp(-distance / SQUARE_FADE)
    second = jnp.where(is_odd, 0.5 + contrast, 0.5 - contrast)

    # Joints around each two squares.
    period = 2.0 * scenery.square
    to_joint = jnp.minimum(_to_multiple(x, period), _to_multiple(y, period))
    is_joint = to_joint < 0.5 * scenery.joint
    fade = 1.0 + jnp.square(distance / JOINT_FADE)
    joint = jnp.where(is_joint, 1.0 / fade, 0.0)

    def channel(axis: int) -> Array:
        first_color = scenery.floor[0, axis]
        square = first_color + second * (scenery.floor[1, axis] - first_color)
        return square + joint * (scenery.floor[2, axis] - square)

    return _channels(channel)


def _to_multiple(x: Array, period: Array) -> Array:
    """Distance from the nearest multiple of a period."""
    return jnp.abs(x - period * jnp.round(x / period))


def _to_integer(x: Array) -> Array:
    """Distance from the nearest integer."""
    return jnp.abs(x - jnp.round(x))


def _fraction(x: Array) -> Array:
    """From 0 to 1, beyond the integer below."""
    return x - jnp.floor(x)


def _ceiling(scenery: Scenery, x: Array, y: Array, distance: Array) -> Color:
    """The color of the ceiling at places (x, y) [m] over the ground: square tiles with lamps, darker far away."""
    side = jnp.maximum(TILE * scenery.ceiling, 1e-3)
    u = x / side
    v = y / side
    is_seam = (_to_integer(u) < 0.02) | (_to_integer(v) < 0.02)
    in_column = jnp.mod(u, LAMP[0]) < 2.0
    in_row = jnp.mod(v, LAMP[1]) < 1.0
    is_lamp = in_column & in_row & ~is_seam
    fade = jnp.exp(-distance / (8.0 * scenery.ceiling + 1e-3))
    seam_light = 1.0 - (1.0 - SEAM) * fade
    light = jnp.where(is_seam, seam_light, 1.0) * (0.82 + 0.18 * fade)

    def channel(axis: int) -> Array:
        return jnp.where(is_lamp, LAMPS[axis], PANEL[axis] * light)

    return _channels(channel)


def _pattern(color: Color, pattern: Array, across: Array, up: Array) -> Color:
    """The colors of bodies with a pattern, an index into PATTERNS, ``across`` a side and ``up`` from the floor [m]."""
    is_wall, is_shelf, is_facade = (pattern == PATTERNS.index(name) for name in PATTERNS[1:])
    above_board = jnp.where(up < DADO[0], DADO[1], 1.0)
    wall_light = jnp.where(up < BOARD[0], BOARD[1], above_board)
    shelf = _shelf(color, across, up)
    facade = _facade(color, across, up)

    def channel(axis: int) -> Array:
        plain = color[axis]
        painted = jnp.where(is_wall, plain * wall_light, plain)
        painted = jnp.where(is_facade, facade[axis], painted)
        return jnp.where(is_shelf, shelf[axis], painted)

    return _channels(channel)


def _shelf(color: Color, across: Array, up: Array) -> Color:
    """Uprights and beams, and between them goods of various sizes, two in each bay of a level."""
    bay = across / BAY
    level = up / LEVEL
    above_beam = _fraction(level)
    is_upright = _to_integer(bay) * BAY < 0.5 * UPRIGHT
    is_beam = above_beam * LEVEL < BEAM

    # Fractions of multiples of irrational numbers look random, and are equal in all pictures.
    slot = 2.0 * bay
    chance = jnp.mod(0.618034 * jnp.floor(slot) + 0.754878 * jnp.floor(level), 1.0)
    other_chance = jnp.mod(7.0 * chance, 1.0)
    within_width = jnp.abs(_fraction(slot) - 0.5) < 0.3 + 0.14 * chance
    within_height = above_beam < 0.45 + 0.4 * other_chance
    is_goods = within_width & within_height & (chance > 0.12)

    def channel(axis: int) -> Array:
        frame = color[axis]
        goods = GOODS[axis] * (0.7 + 0.4 * chance)
        inside = jnp.where(is_goods, goods, INSIDE * frame)
        below_upright = jnp.where(is_beam, BEAM_COLOR[axis], inside)
        return jnp.where(is_upright, frame, below_upright)

    return _channels(channel)


def _facade(color: Color, across: Array, up: Array) -> Color:
    """Windows in each storey, above a darker foot."""
    column = across / STOREY
    storey = up / STOREY
    within_width = jnp.abs(_fraction(column) - 0.5) < 0.24
    within_height = jnp.abs(_fraction(storey) - 0.55) < 0.26
    is_window = within_width & within_height
    light = jnp.where(up < PLINTH[0], PLINTH[1], 1.0)

    def channel(axis: int) -> Array:
        return jnp.where(is_window, GLASS[axis], color[axis] * light)

    return _channels(channel)

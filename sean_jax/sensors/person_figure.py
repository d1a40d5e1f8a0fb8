"""The figure of a person in color pictures: head, trunk, swinging arms and striding legs, inside the person's capsule.

Only the person whose capsule a ray meets is looked at, so the figure costs each ray the same in any crowd.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, State
from sean_jax.core.geometry import rotate
from sean_jax.sensors.raycast import MISS, Rays, View, along
from sean_jax.sensors.raycast.vectors import Vector, dot, to_frame

SKIN = ((0.87, 0.70, 0.58), (0.55, 0.38, 0.27), (0.93, 0.78, 0.67), (0.72, 0.53, 0.40))  # of successive people
HAIR = ((0.24, 0.18, 0.15), (0.10, 0.09, 0.09), (0.55, 0.42, 0.26), (0.36, 0.22, 0.14))
TROUSERS = ((0.22, 0.26, 0.36), (0.30, 0.28, 0.26), (0.40, 0.36, 0.30), (0.17, 0.18, 0.20), (0.26, 0.33, 0.45))
SHOE = (0.12, 0.11, 0.11)
HEAD, BODY, LIMB, LOWER = range(4)  # parts: arms are limbs, legs lower limbs

# Gait.
STRIDE = 1.4  # m, length of two steps
SPREAD = 0.16  # m, maximum distance of a foot ahead of the body, from 1 m/s on
SWING = 0.5  # of a hand, over that of a foot

# Heights [m] above the floor.
BROW = 1.66
CHIN = 1.52
ARMPIT = 1.35  # of the upper end of an arm
WAIST = 0.95
HIP = 0.88
CUFF = 0.88
GROIN = 0.86
SOLE = 0.1  # of the edge of a sole, below which there are shoes
ANKLE = 0.07
CRANIUM_ENDS = (1.572, 1.632)  # of the axes of head and trunk
TRUNK_ENDS = (0.93, 1.31)

# Sizes and distances [m].
CRANIUM = 0.098  # radius
TRUNK = 0.15  # half width
FLAT = 1.45  # width over depth of the trunk
LEG = 0.068  # radius
APART = 0.088  # between the centers of body and leg
ARM = 0.04  # radius
SHOULDERS = 0.152  # half width
HAND = (0.158, 0.80)  # aside, and up from the floor
FACE = 0.02  # ahead of the middle of the head
MIDDLE = 0.2  # along a ray from a person's capsule, about to its axis


@struct.dataclass
class PersonFigure:
    """What each ray meets of a figure."""

    distance: Float[Array, "tiles rays"]  # m, MISS without a figure
    normal: Vector  # in the robot's axes, unit
    color: tuple[Array, Array, Array]  # red, green and blue without light


class Capsule(NamedTuple):
    """A part of a figure, or one for each ray: a capsule in the person's frame, which looks along x."""

    part: Array  # HEAD, BODY, LIMB or LOWER
    radius: Array  # m
    flatness: Array  # width over depth
    left: Array  # m, of the start of the axis from the middle of the body
    bottom: Array  # m, of the start of the axis above the floor
    aside: Array  # m, of the axis to the left
    rise: Array  # m, of the axis
    swing: Array  # what of the foot's way ahead is the axis's way ahead


def trace_figures(
    state: State, view: View, rays: Rays, person: Int[Array, "tiles rays"], distance: Float[Array, "tiles rays"]
) -> PersonFigure:
    """The figures along rays that meet the capsules of people.

    Args:
        person: index of the person whose capsule a ray meets; -1 without one.
        distance: m, along the ray to the capsule.
    """
    # Rays are in the robot's axes, so people's looks are turned into them once, not each ray.
    index = jnp.maximum(person, 0)
    heading = state.pedestrians.heading
    robot_heading = state.robot.heading
    look_x, look_y = rotate(heading[:, 0], heading[:, 1], robot_heading[0], -robot_heading[1])
    look = jnp.stack([look_x, look_y], -1)  # (N, 2)
    foot = left_foot(state)[:, None]
    people = jnp.concatenate([look, view.people, foot], -1).T  # (5, N)
    look_x, look_y, x, y, foot = (column[index] for column in people)  # (tiles, rays) each

    # All limbs are capsules in the person's frame: a ray is turned once, and starts near, which keeps precision.
    is_person = person >= 0
    to_point = jnp.where(is_person, distance, 0.0)
    point = along(rays, to_point)
    offset = Vector(point.x - x, point.y - y, point.z + view.height)
    components = (jnp.asarray(component, float) for component in rays.direction)
    direction = Vector(*components)
    start = _turned(offset, look_x, look_y)
    direction = _turned(direction, look_x, look_y)

    # Without the barrier XLA computes the turned ray again for each limb.
    start, direction, foot = jax.lax.optimization_barrier((start, direction, foot))

    # Clothes depend on the place on the body, light on the normal in the robot's axes.
    to_limb, normal, part = _limbs(start, direction, foot)
    meets = (to_limb < MISS) & is_person
    # A ray without a limb stays at its start, so that MISS enters no color and no derivative.
    to_limb = jnp.where(meets, to_limb, 0.0)
    forward = start.x + to_limb * direction.x
    up = start.z + to_limb * direction.z
    color = _clothes(index, part, forward, up, view.counts[3])
    nx, ny = rotate(normal.x, normal.y, look_x, look_y)
    normal = Vector(nx, ny, normal.z)
    distance = jnp.where(meets, distance + to_limb, MISS)
    return PersonFigure(distance, normal, color)


def _turned(vector: Vector, look_x: Array, look_y: Array) -> Vector:
    """A vector in the frame of a person who looks in that direction."""
    x, y = to_frame(vector.x, vector.y, look_x, look_y)
    return Vector(x, y, vector.z)


def left_foot(state: State) -> Float[Array, "N"]:
    """How far [m] each person's left foot is ahead of the body, and the right one behind it."""
    people = state.pedestrians
    along_way = (people.position * people.heading).sum(-1)
    square = (people.velocity * people.velocity).sum(-1)
    speed = jnp.sqrt(square + 1e-12)
    reach = SPREAD * jnp.minimum(speed, 1.0)
    phase = 2.0 * jnp.pi / STRIDE * along_way
    return reach * jnp.sin(phase)


# Rows of ``Capsule``: two that all rays may meet, and two legs or two arms.
TRUNK_AND_HEAD = (
    (BODY, TRUNK, FLAT, 0.0, TRUNK_ENDS[0], 0.0, TRUNK_ENDS[1] - TRUNK_ENDS[0], 0.0),
    (HEAD, CRANIUM, 1.0, 0.0, CRANIUM_ENDS[0], 0.0, CRANIUM_ENDS[1] - CRANIUM_ENDS[0], 0.0),
)
SIDES = (1.0, -1.0)  # left and right
LEGS = tuple((LOWER, LEG, 1.0, side * APART, HIP, 0.0, ANKLE - HIP, side) for side in SIDES)
ARMS = tuple(
    (LIMB, ARM, 1.0, side * SHOULDERS, ARMPIT, side * (HAND[0] - SHOULDERS), HAND[1] - ARMPIT, -SWING * side)
    for side in SIDES
)
WITH_LEGS = np.array(TRUNK_AND_HEAD + LEGS).T  # (8, 4), a row for each field of ``Capsule``
WITH_ARMS = np.array(TRUNK_AND_HEAD + ARMS).T


def _limbs(start: Vector, direction: Vector, foot: Array) -> tuple[Array, Vector, Array]:
    """Distance [m] from the start of a ray to a figure, MISS without; its normal, and its part.

    A ray meets trunk and head, and either legs or arms: arms if its point ``MIDDLE`` m on is above ``GROIN``.
    """
    middle_up = start.z + MIDDLE * direction.z
    with_arms = (middle_up > GROIN).astype(foot.dtype)

    # All capsules are one array: XLA would compute the ones before again for each result of a loop over them.
    index = np.arange(WITH_LEGS.shape[1]).reshape(-1, *[1] * foot.ndim)
    all_starts, all_directions, all_feet = jax.tree.map(lambda leaf: leaf[None], (start, direction, foot))
    capsules = _capsules(index, with_arms[None])
    distances, _ = _meet(all_starts, all_directions, all_feet, capsules)  # (4, tiles, rays) m
    distances = jax.lax.optimization_barrier(distances)

    # The nearest of them counts.
    distance = distances.min(0)
    nearest = jax.lax.stop_gradient(distances).argmin(0)
    distance, nearest = jax.lax.optimization_barrier((distance, nearest))

    # The normal leads away from the axis of the nearest capsule.
    capsule = _capsules(nearest, with_arms)
    _, share = _meet(start, direction, foot, capsule)
    to_point = jnp.where(distance < MISS, distance, 0.0)
    point = start + direction * to_point
    squeezed = capsule.flatness * capsule.flatness * point.x
    nx = squeezed - share * capsule.swing * foot
    ny = point.y - capsule.left - share * capsule.aside
    nz = point.z - capsule.bottom - share * capsule.rise
    normal = Vector(nx, ny, nz)
    square = jnp.maximum(dot(normal, normal), 1e-12)
    unit_normal = normal * jax.lax.rsqrt(square)
    return distance, unit_normal, capsule.part


def _capsules(index: Array | np.ndarray, with_arms: Array) -> Capsule:
    """The capsules of these indices, with arms (1) or with legs (0)."""
    fields = []
    differences = WITH_ARMS - WITH_LEGS
    for legs, difference in zip(WITH_LEGS, differences, strict=True):
        legs_field = jnp.asarray(legs, float)[index]
        difference_field = jnp.asarray(difference, float)[index]
        fields.append(legs_field + with_arms * difference_field)
    return Capsule(*fields)


def _meet(start: Vector, direction: Vector, foot: Array, capsule: Capsule) -> tuple[Array, Array]:
    """Distance along a ray to a capsule, MISS without; and where on its axis that is, from 0 to 1."""
    # A flat capsule is round in a frame whose x is stretched.
    q = Vector(capsule.flatness * start.x, start.y - capsule.left, start.z - capsule.bottom)
    d = Vector(capsule.flatness * direction.x, direction.y, direction.z)
    axis = Vector(capsule.swing * foot, capsule.aside, capsule.rise)

    # |q + t d| across the axis is the radius: a quadratic equation for the distance t, whose first root counts.
    aa = dot(axis, axis)
    ad = dot(axis, d)
    aq = dot(axis, q)
    dd = dot(d, d)
    dq = dot(d, q)
    radius = capsule.radius
    qq = dot(q, q) - radius * radius
    a = jnp.maximum(aa * dd - ad * ad, 1e-6)
    b = aa * dq - aq * ad
    c = aa * qq - aq * aq
    touches, side = _first_root(a, b, c)
    height = aq + side * ad

    # Beyond its ends the capsule is a ball.
    is_upper = height > 0.5 * aa
    upper_end = is_upper.astype(dd.dtype)
    ball_b = dq - upper_end * ad
    beyond_end = 2.0 * aq - aa
    ball_c = qq - upper_end * beyond_end
    touches_ball, ball = _first_root(dd, ball_b, ball_c)

    on_side = (height > 0.0) & (height < aa)
    is_round = touches & on_side
    ball = jnp.where(touches_ball, ball, MISS)
    distance = jnp.where(is_round, side, ball)
    share = jnp.where(is_round, height / aa, upper_end)
    return distance, share


def _first_root(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Whether a t^2 + 2 b t + c has two roots, and the lower one."""
    discriminant = b * b - a * c
    exists = discriminant > 0.0
    discriminant = jnp.where(exists, discriminant, 1.0)
    lower = (-b - jnp.sqrt(discriminant)) / a
    return exists, lower


def _clothes(person: Array, part: Array, forward: Array, up: Array, count: int) -> tuple[Array, Array, Array]:
    """The colors of a part of a person, ``forward`` of the middle and ``up`` from the floor [m]."""
    hair = part == HEAD
    face = (forward > FACE) & (up < BROW)
    neck = up < CHIN
    hand = (part == LIMB) & (up < CUFF)
    skin = (hair & (face | neck)) | hand
    leg = part == LOWER
    hips = (part == BODY) & (up < WAIST)
    trousers = leg | hips
    shoe = leg & (up < SOLE)
    index = jnp.arange(count)
    shirt = shirts(count)

    def of_people(table: tuple, channel: int) -> Array:
        colors = jnp.asarray([color[channel] for color in table], float)
        by_person = colors[index % len(table)]
        return by_person[person]

    def channel(number: int) -> Array:
        below_waist = jnp.where(shoe, SHOE[number], of_people(TROUSERS, number))
        clothes = jnp.where(trousers, below_waist, shirt[number][person])
        skin_color = of_people(SKIN, number)
        covered = jnp.where(hair, of_people(HAIR, number), clothes)
        return jnp.where(skin, skin_color, covered)

    return channel(0), channel(1), channel(2)


def shirts(count: int) -> tuple[Array, Array, Array]:
    """Red, green and blue (N,) of each person's shirt, from 0 to 1; people with successive indices differ most."""
    index = jnp.arange(count, dtype=float)
    hue = jnp.mod(index * 0.618034 + 0.08, 1.0)

    def channel(shift: float) -> Array:
        turned = jnp.mod(hue + shift, 1.0)
        distance = jnp.abs(turned * 6.0 - 3.0)
        saturated = jnp.clip(distance - 1.0, 0.0, 1.0)
        return 0.35 + 0.5 * saturated

    return channel(0.0), channel(2.0 / 3.0), channel(1.0 / 3.0)

"""The figure of a person in color pictures: head, trunk, swinging arms and striding legs, inside the person's capsule.

Only the person whose capsule a ray meets is looked at, so the figure costs each ray the same in any crowd.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, State
from sean_jax.core.geometry import rotate
from sean_jax.sensors.raycast import MISS, Rays, View, along

SKIN = ((0.87, 0.70, 0.58), (0.55, 0.38, 0.27), (0.93, 0.78, 0.67), (0.72, 0.53, 0.40))  # of successive people
HAIR = ((0.24, 0.18, 0.15), (0.10, 0.09, 0.09), (0.55, 0.42, 0.26), (0.36, 0.22, 0.14))
TROUSERS = ((0.22, 0.26, 0.36), (0.30, 0.28, 0.26), (0.40, 0.36, 0.30), (0.17, 0.18, 0.20), (0.26, 0.33, 0.45))
SHOE = (0.12, 0.11, 0.11)
STRIDE, SPREAD = 1.4, 0.16  # m, length of two steps, and maximum distance of a foot ahead of the body, from 1 m/s on
SWING = 0.5  # of a hand, over that of a foot
WAIST, HIP, ANKLE, SOLE = 0.95, 0.88, 0.07, 0.1  # m above the floor; below the sole's edge there are shoes
LEG, APART = 0.068, 0.088  # m, radius of a leg, and distance between the centers of body and leg
ARM, SHOULDERS, HAND, CUFF = 0.04, 0.152, (0.158, 0.80), 0.88  # m: radius, half width; of a hand: aside, up; of a cuff
ARMPIT = 1.35  # m above the floor, of the upper end of an arm
TRUNK, TRUNK_ENDS, FLAT = 0.15, (0.93, 1.31), 1.45  # m, half width; ends of its axis; width over depth
CRANIUM, CRANIUM_ENDS = 0.098, (1.572, 1.632)  # m
GROIN, MIDDLE = 0.86, 0.2  # m above the floor; along a ray from the capsule, about to its axis
BROW, CHIN, FACE = 1.66, 1.52, 0.02  # m above the floor, likewise, and ahead of the middle of the head
Vector = tuple[Array, Array, Array]


@struct.dataclass
class Figure:
    """What each ray meets of a figure."""

    distance: Float[Array, "tiles rays"]  # m, MISS without a figure
    normal: Vector  # x, y and z in the robot's axes, unit
    color: tuple[Array, Array, Array]  # red, green and blue without light


def figure(
    state: State, view: View, rays: Rays, person: Int[Array, "tiles rays"], distance: Float[Array, "tiles rays"]
) -> Figure:
    """The figures along rays that meet the capsules of people.

    Args:
        person: index of the person whose capsule a ray meets; -1 without one.
        distance: m, along the ray to the capsule.
    """
    someone = jnp.maximum(person, 0)
    heading, robot = state.pedestrians.heading, state.robot.heading
    look = jnp.stack(rotate(heading[:, 0], heading[:, 1], robot[0], -robot[1]), -1)
    own = jnp.concatenate([look, view.people, foot(state)[:, None]], -1).T
    look_x, look_y, x0, y0, ahead = (column[someone] for column in own)
    x, y, z = along(rays, jnp.where(person >= 0, distance, 0.0))
    here = (*_turn(x - x0, y - y0, look_x, look_y), z + view.height)  # on the capsule, in the person's frame
    dx, dy, dz = (jnp.asarray(part, float) for part in rays.direction)
    way = (*_turn(dx, dy, look_x, look_y), dz)
    here, way, ahead = jax.lax.optimization_barrier((here, way, ahead))

    on, normal, part = _limbs(here, way, ahead)
    meets = (on < MISS) & (person >= 0)
    shift = jnp.where(meets, on, 0.0)
    forward, up = here[0] + shift * way[0], here[2] + shift * way[2]
    color = _clothes(someone, part, forward, up, view.counts[3])
    out_x, out_y = rotate(normal[0], normal[1], look_x, look_y)
    return Figure(jnp.where(meets, distance + shift, MISS), (out_x, out_y, normal[2]), color)


def foot(state: State) -> Float[Array, "N"]:
    """How far [m] each person's left foot is ahead of the body, and the right one behind it."""
    people = state.pedestrians
    along_way = (people.position * people.heading).sum(-1)
    speed = jnp.sqrt((people.velocity * people.velocity).sum(-1) + 1e-12)
    return SPREAD * jnp.minimum(speed, 1.0) * jnp.sin(2.0 * jnp.pi / STRIDE * along_way)


def _turn(x: Array, y: Array, look_x: Array, look_y: Array) -> tuple[Array, Array]:
    """A vector as ahead and left of whoever looks there."""
    return x * look_x + y * look_y, y * look_x - x * look_y


HEAD, BODY, LIMB, LOWER = range(4)  # parts: arms are limbs, legs lower limbs
# Capsules: part, radius, width over depth, start, axis [m], and what of the foot's way ahead adds to the axis.
TRUNK_AND_HEAD = (
    (BODY, TRUNK, FLAT, 0.0, TRUNK_ENDS[0], 0.0, TRUNK_ENDS[1] - TRUNK_ENDS[0], 0.0),
    (HEAD, CRANIUM, 1.0, 0.0, CRANIUM_ENDS[0], 0.0, CRANIUM_ENDS[1] - CRANIUM_ENDS[0], 0.0),
)
LEGS = tuple((LOWER, LEG, 1.0, side * APART, HIP, 0.0, ANKLE - HIP, side) for side in (1.0, -1.0))
ARMS = tuple(
    (LIMB, ARM, 1.0, side * SHOULDERS, ARMPIT, side * (HAND[0] - SHOULDERS), HAND[1] - ARMPIT, -SWING * side)
    for side in (1.0, -1.0)
)
LOW, HIGH = np.array(TRUNK_AND_HEAD + LEGS).T, np.array(TRUNK_AND_HEAD + ARMS).T


def _limbs(here: Vector, way: Vector, ahead: Array) -> tuple[Array, Vector, Array]:
    """Distance [m] from ``here`` along a ray to a figure, MISS without; its normal, and its part.

    A ray meets trunk and head, and either legs or arms: arms if its point ``MIDDLE`` m on is above ``GROIN``.
    """
    is_high = (here[2] + MIDDLE * way[2] > GROIN).astype(ahead.dtype)
    each_here, each_way, each_ahead = jax.tree.map(lambda part: part[None], (here, way, ahead))

    def columns(index: Array | np.ndarray) -> tuple[Array, ...]:
        pairs = ((jnp.asarray(part, float)[index] for part in pair) for pair in zip(LOW, HIGH - LOW, strict=True))
        high = is_high if index.ndim == is_high.ndim else is_high[None]
        return tuple(low + high * more for low, more in pairs)

    # All capsules are one array: XLA would compute the ones before again for each result of a loop over them.
    numbers = np.arange(len(LOW.T))[(..., *(None,) * ahead.ndim)]
    every = jax.lax.optimization_barrier(_capsule(each_here, each_way, each_ahead, columns(numbers))[0])
    distance, nearest = every.min(0), jax.lax.stop_gradient(every).argmin(0)
    distance, nearest = jax.lax.optimization_barrier((distance, nearest))
    of_nearest = columns(nearest)
    share = _capsule(here, way, ahead, of_nearest)[1]
    at = jnp.where(distance < MISS, distance, 0.0)
    part, _, flat, left, low, aside, rise, swing = of_nearest
    nx = flat * flat * (here[0] + at * way[0]) - share * swing * ahead
    ny, nz = here[1] + at * way[1] - left - share * aside, here[2] + at * way[2] - low - share * rise
    size = jax.lax.rsqrt(jnp.maximum(nx * nx + ny * ny + nz * nz, 1e-12))
    return distance, (nx * size, ny * size, nz * size), part


def _capsule(here: Vector, way: Vector, ahead: Array, columns: tuple[Array, ...]) -> tuple[Array, Array]:
    """Distance along a ray to a capsule, MISS without; and where on its axis that is, from 0 to 1."""
    _, radius, flat, left, low, ay, az, swing = columns
    qx, qy, qz = flat * here[0], here[1] - left, here[2] - low
    dx, dy, dz = flat * way[0], way[1], way[2]
    ax = swing * ahead
    long = ax * ax + ay * ay + az * az
    along_d, along_q = ax * dx + ay * dy + az * dz, ax * qx + ay * qy + az * qz
    dd, dq = dx * dx + dy * dy + dz * dz, dx * qx + dy * qy + dz * qz
    qq = qx * qx + qy * qy + qz * qz - radius * radius
    a = jnp.maximum(long * dd - along_d * along_d, 1e-6)
    b, c = long * dq - along_q * along_d, long * qq - along_q * along_q
    square = b * b - a * c
    touches = square > 0.0
    side = (-b - jnp.sqrt(jnp.where(touches, square, 1.0))) / a
    height = along_q + side * along_d
    # Beyond its ends the capsule is a ball.
    upper = (height > 0.5 * long).astype(dd.dtype)
    bq, bqq = dq - upper * along_d, qq - upper * (2.0 * along_q - long)
    ball = bq * bq - dd * bqq
    at_ball = (-bq - jnp.sqrt(jnp.where(ball > 0.0, ball, 1.0))) / dd
    is_round = touches & (height > 0.0) & (height < long)
    distance = jnp.where(is_round, side, jnp.where(ball > 0.0, at_ball, MISS))
    return distance, jnp.where(is_round, height / long, upper)


def _clothes(person: Array, part: Array, forward: Array, up: Array, count: int) -> tuple[Array, Array, Array]:
    """The colors of a part of a person, ``forward`` of the middle and ``up`` from the floor [m]."""
    face = ((part == HEAD) & (((forward > FACE) & (up < BROW)) | (up < CHIN))) | ((part == LIMB) & (up < CUFF))
    hair, legs = part == HEAD, (part == LOWER) | ((part == BODY) & (up < WAIST))
    shoe = (part == LOWER) & (up < SOLE)
    index = jnp.arange(count)
    shirt = shirts(count)

    def channel(axis: int) -> Array:
        skins, hairs, trousers = (
            jnp.asarray([each[axis] for each in table], float)[index % len(table)] for table in (SKIN, HAIR, TROUSERS)
        )
        skins, hairs, trousers, tops = (table[person] for table in (skins, hairs, trousers, shirt[axis]))
        below = jnp.where(shoe, SHOE[axis], trousers)
        return jnp.where(face, skins, jnp.where(hair, hairs, jnp.where(legs, below, tops)))

    return channel(0), channel(1), channel(2)


def shirts(count: int) -> tuple[Array, Array, Array]:
    """Red, green and blue (N,) of each person's shirt, from 0 to 1; people with successive indices differ most."""
    hue = jnp.mod(jnp.arange(count, dtype=float) * 0.618034 + 0.08, 1.0)

    def part(turn: float) -> Array:
        return 0.35 + 0.5 * jnp.clip(jnp.abs(jnp.mod(hue + turn, 1.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0)

    return part(0.0), part(2.0 / 3.0), part(1.0 / 3.0)

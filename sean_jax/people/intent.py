"""Intent: which velocity people want on the way to a goal, and how it differs between people and in time.

A person keeps a share of what the first speed differs from the usual one. From then on the logarithm of the wanted
speed is an Ornstein-Uhlenbeck process that begins at 0. The wanted direction turns to the goal slowly. The route is a
spiral: the direction keeps an angle to the goal, drawn once for each person, until it fades near the goal.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.core.data_types import Array
from sean_jax.core.geometry import length, rotate, unit

FADE = 2.0  # m from the goal, within which the route becomes straight
OPPOSITE = -0.95  # cosine of the angle to the route, below which people turn to their left first


@struct.dataclass
class Intent:
    """The constants; the defaults are two habits of average people.

    ``sean calibrate --fit intent`` finds .9, .24, 32 s, 1.5 s and .09 rad for people who walk alone. In a crowd, noise
    and differences of the forces spread people, too: with both, scenes differ in whether errors fall.
    """

    speed_share: Float[Array, ""] | float = 0.9  # of the difference between the first and the usual speed, that lasts
    speed_deviation: Float[Array, ""] | float = 0.0  # 1, of the logarithm of the wanted speed, after a long time
    speed_time: Float[Array, ""] | float = 30.0  # s, in which that is forgotten
    turn_time: Float[Array, ""] | float = 1.1  # s, in which the wanted direction turns to the goal; 0: at once
    route_deviation: Float[Array, ""] | float = 0.0  # rad, of the angle between a route and the way to the goal

    def average(self) -> "Intent":
        """The intent of average people, who have no deviations."""
        return replace(self, speed_deviation=0.0, route_deviation=0.0)


class Latents(NamedTuple):
    """What nobody sees of N people."""

    speed: Float[Array, "N"]  # 1, logarithm of the wanted speed over the lasting one
    route: Float[Array, "N"]  # rad, to the left of the way to the goal


def lasting_speed(
    intent: Intent, first: Float[Array, "N"], usual: Float[Array, "N"] | Float[Array, ""] | float
) -> Float[Array, "N"]:
    """The speed [m/s] of people whose first speed is known, where another one is usual, for all or for each."""
    return usual + intent.speed_share * (first - usual)


def draw(intent: Intent, key: Array, people: int) -> Latents:
    """The latents of people who come on: routes differ, and speeds still are as they were seen."""
    route = intent.route_deviation * jax.random.normal(key, (people,), float)
    return Latents(jnp.zeros(people, float), route)


def advance(intent: Intent, latents: Latents, key: Array, time_step: float) -> Latents:
    """The latents ``time_step`` [s] later."""
    noise = jax.random.normal(key, latents.speed.shape, float)
    ratio = time_step / intent.speed_time
    spread = intent.speed_deviation * jnp.sqrt(-jnp.expm1(-2.0 * ratio))
    return latents._replace(speed=jnp.exp(-ratio) * latents.speed + spread * noise)


def wanted_velocity(
    intent: Intent,
    latents: Latents,
    wanted: Float[Array, "N 2"],
    way: Float[Array, "N 2"],
    speed: Float[Array, "N"],
    time_step: float,
) -> Float[Array, "N 2"]:
    """The velocity [m/s] that people want ``time_step`` later; whoever wanted none turns at once.

    Args:
        wanted: the velocity until now [m/s].
        way: to the goal [m].
        speed: the one that lasts [m/s].
    """
    # The route is at an angle to the straight way, less and less near the goal, so that it ends there.
    to_x, to_y = unit(way[:, 0], way[:, 1])
    angle = latents.route * jnp.minimum(length(way[:, 0], way[:, 1]) / FADE, 1.0)
    to_x, to_y = rotate(to_x, to_y, jnp.cos(angle), jnp.sin(angle))

    # The direction goes a part of the way to that of the route; who walks straight away from it turns to the left.
    x, y = unit(wanted[:, 0], wanted[:, 1])
    is_behind = x * to_x + y * to_y < OPPOSITE
    to_x, to_y = jnp.where(is_behind, -y, to_x), jnp.where(is_behind, x, to_y)
    share = time_step / jnp.maximum(intent.turn_time, time_step)
    turned_x, turned_y = unit(x + share * (to_x - x), y + share * (to_y - y))
    stands = (x == 0.0) & (y == 0.0)
    x = jnp.where(stands, to_x, turned_x)
    y = jnp.where(stands, to_y, turned_y)

    size = speed * jnp.exp(latents.speed)
    return jnp.stack([size * x, size * y], -1)

"""Walking (section IV-D, low level): a person without others: body, speed, and how headings turn.

D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995): people take up their desired velocity within a relaxation time.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array, Pedestrians
from sean_jax.geometry import length, rotate, unit

MIN_SPEED = 0.1  # m/s: a slower body does not turn into its direction of motion


@struct.dataclass
class Walking:
    """How people move. All forces have exactly one of these; it is the term that drives people."""

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "radius": (0.01, 10.0),
        "relaxation_time": (1e-3, 1e9),
        "speed_mean": (0.0, 100.0),
        "speed_deviation": (0.0, 100.0),
        "speed_min": (0.0, 100.0),
        "speed_max": (0.0, 100.0),
        "speed_ratio": (0.0, 100.0),
        "turn_rate": (0.0, 1e3),
        "perception": (0.0, 1e9),
        "lateral_damping": (1e-3, 1e6),
        "backward_scale": (0.0, 1e3),
    }
    relations: ClassVar[dict[str, Callable[[Any], Any]]] = {
        "speed_min is more than speed_max": lambda term: term.speed_min > term.speed_max,
    }

    radius: Float[Array, ""]  # m, of a body; obstacles are kept out of it
    relaxation_time: Float[Array, ""]  # s, in which the desired velocity is taken up
    speed_mean: Float[Array, ""]  # m/s, of the preferred speeds drawn per person
    speed_deviation: Float[Array, ""]  # m/s, their standard deviation
    speed_min: Float[Array, ""]  # m/s, the draw is truncated here ...
    speed_max: Float[Array, ""]  # m/s, ... and here
    speed_ratio: Float[Array, ""]  # 1, top speed over preferred speed
    companion_slowdown: Float[Array, ""]  # m/s, by which each companion lowers the preferred speed
    turn_rate: Float[Array, ""]  # rad/s, at which a body turns into its direction of motion
    perception: Float[Array, ""]  # m, nobody and no wall farther away is felt
    lateral_damping: Float[Array, ""]  # 1, divides the part of the social force across the heading
    backward_scale: Float[Array, ""]  # 1, scales the part of the social force against the heading

    def damp(
        self, fx: Float[Array, "N"], fy: Float[Array, "N"], heading: Float[Array, "N 2"]
    ) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        """The social force [m/s2] scaled by ``backward_scale`` against the heading and damped across it."""
        hx, hy = heading[:, 0], heading[:, 1]
        along, across = fx * hx + fy * hy, fy * hx - fx * hy
        along = jnp.where(along < 0.0, along * self.backward_scale, along)
        across = across / self.lateral_damping
        return along * hx - across * hy, along * hy + across * hx

    def limit_speed(
        self, vx: Float[Array, "N"], vy: Float[Array, "N"], preferred_speed: Float[Array, "N"]
    ) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        """Velocities shortened to ``speed_ratio`` times the preferred speed [m/s]."""
        # A step of an optimizer may make a preferred speed negative: such a person stands.
        speed, speed_max = length(vx, vy), jnp.maximum(self.speed_ratio * preferred_speed, 0.0)
        slower = jnp.where(speed > speed_max, speed_max / jnp.where(speed > speed_max, speed, 1.0), 1.0)
        return vx * slower, vy * slower


def look_direction(people: Pedestrians) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """The look of each person, a unit vector: along the desired velocity, or along the heading when they stand."""
    x, y = unit(people.desired_velocity[:, 0], people.desired_velocity[:, 1])
    standing = (people.group >= 0) | ((x == 0.0) & (y == 0.0))
    return jnp.where(standing, people.heading[:, 0], x), jnp.where(standing, people.heading[:, 1], y)


def turn(
    people: Pedestrians, velocity: Float[Array, "N 2"], max_angle: Float[Array, ""] | float
) -> Float[Array, "N 2"]:
    """Headings turned towards the velocity [m/s] by ``max_angle`` [rad] at most; standing group members keep theirs."""
    x, y = people.heading[:, 0], people.heading[:, 1]
    goal_x, goal_y = unit(velocity[:, 0], velocity[:, 1])
    cosine, sine = x * goal_x + y * goal_y, x * goal_y - y * goal_x  # of the angle between both, without trigonometry
    most = jnp.minimum(max_angle, jnp.pi)
    within = cosine >= jnp.cos(most)
    cosine = jnp.where(within, cosine, jnp.cos(most))
    sine = jnp.where(within, sine, jnp.where(sine < 0.0, -jnp.sin(most), jnp.sin(most)))
    walking = (people.group < 0) & (length(velocity[:, 0], velocity[:, 1]) > MIN_SPEED)
    x, y = rotate(x, y, jnp.where(walking, cosine, 1.0), jnp.where(walking, sine, 0.0))
    return jnp.stack(unit(x, y), -1)

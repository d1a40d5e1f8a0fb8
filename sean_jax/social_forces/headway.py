"""Headway (section IV-D, low level): nobody walks faster than the room ahead allows.

A. Tordeux, M. Chraibi & A. Seyfried, Traffic and Granular Flow '15, 225 (2016): the speed of people in the plane is
limited by the gap to whoever is ahead, (gap - l) / T. Here the limit sets in smoothly.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.social_forces.repulsion import TINY
from sean_jax.social_forces.terms import Crowd, Force, Pair
from sean_jax.social_forces.walking import Walking

SHORTEST = 1e-3  # m, of a ramp or a width that is divided by; its tenth power is still a float
MAX_SHARE = 0.95  # of the desired velocity; single files of 1.9 people/m still move at 0.05 m/s or more


@struct.dataclass
class Headway:
    """Takes a share of the desired velocity for each person in the way: ((range - gap) / (range - length))^2.

    The gap is between the surfaces of the bodies: at ``range`` people walk freely, at ``length`` they stand still. Who
    is aside of the line of sight is less in the way, by (1 - (aside / width)^2)^2. Who comes towards the person is less
    in the way, the faster they come: ``Evasion`` deals with them. The shares of all others add up to 95 % of the
    desired velocity at most, so people in a queue shuffle on.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "length": (-10.0, 10.0),
        "range": (-10.0, 100.0),
        "width": (0.0, 100.0),
        "ramp": (0.0, 100.0),
    }
    relations: ClassVar[dict[str, Callable[[Any], Any]]] = {
        "range is less than 0.01 m more than length": lambda term: term.range - term.length < 0.0099,
    }

    length: Float[Array, ""]  # m, the gap at which people stand still
    range: Float[Array, ""]  # m, the gap from which on they walk freely
    width: Float[Array, ""]  # m, aside of which nobody is in the way
    ramp: Float[Array, ""]  # m, ahead, over which somebody comes to be in the way

    def gather(self, pair: Pair) -> tuple[Array]:
        """The share of the desired velocity that one other takes. ``act`` multiplies what is the same for all others.

        Returns:
            () m7, the share times ``_scale``.
        """
        dx, dy = pair.dx, pair.dy
        dd = dx * dx + dy * dy + TINY
        near = jnp.maximum(self.range + pair.radii - dd * jax.lax.rsqrt(dd), 0.0)
        ahead = -(dx * pair.look_x + dy * pair.look_y)
        aside = dx * pair.look_y - dy * pair.look_x
        before = jnp.maximum(self.width * self.width - aside * aside, 0.0)
        following = jnp.clip(1.0 + (pair.wx * pair.look_x + pair.wy * pair.look_y), 0.0, 1.0)
        return (jnp.clip(ahead, 0.0, self._ramp()) * following * (near * before) ** 2,)

    def act(self, crowd: Crowd, share: Float[Array, "N"]) -> Force:
        """The braking that takes that share from the desired velocity.

        Returns:
            (N,) x and y parts [m/s2].
        """
        rate = -jnp.minimum(share * (1.0 / self._scale()), MAX_SHARE) / crowd.forces.walking.relaxation_time
        desired = crowd.people.desired_velocity
        return rate * desired[:, 0], rate * desired[:, 1]

    def _ramp(self) -> Array:
        return jnp.maximum(self.ramp, SHORTEST)

    def _scale(self) -> Array:
        """By what the sum over all others is divided once, rather than each of them."""
        return self._ramp() * (self.range - self.length) ** 2 * jnp.maximum(self.width, SHORTEST) ** 4

    def cutoff(self, walking: Walking) -> Array:
        """The distance within which somebody is in the way.

        Returns:
            () m.
        """
        return 2.0 * walking.radius + self.range

"""Evasion (section IV-D [44]): people step out of the way of whoever they would run into, rather to the right.

F. Zanlungo, T. Ikeda & T. Kanda, EPL 93, 68005 (2011): what repels is where the other will be at the closest approach.
It has the purpose of ``Sidestep``, without its jumps; and however many people come, the push is bounded.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.social_forces.headway import SHORTEST
from sean_jax.social_forces.terms import Crowd, Force, Pair
from sean_jax.social_forces.walking import Walking


@struct.dataclass
class Evasion:
    """A push across the look that makes the closest approach to others wider. Standing members of groups feel none.

    If both keep their velocities, the closest approach is in a time t at an offset m. The push is the part of m across
    the look, the stronger the sooner and the nearer: (1 - t / horizon)^2 (1 - m^2 / width^2)^2, for those ahead who
    come closer faster than about ``speed``. ``side`` is added to the offset, so that both step to their right where
    they would meet exactly. Pushes of all others together are at most ``strength``.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "horizon": (1e-3, 100.0),
        "width": (0.0, 100.0),
        "speed": (1e-3, 100.0),
        "ramp": (0.0, 100.0),
    }

    strength: Float[Array, ""]  # m/s2, of the push when many come
    gain: Float[Array, ""]  # 1, share of it for one person who is about to be run into
    horizon: Float[Array, ""]  # s, a later approach does not count
    width: Float[Array, ""]  # m, nor does a wider one
    side: Float[Array, ""]  # m, by which people keep to the right
    speed: Float[Array, ""]  # m/s, of the relative speed at which an approach counts by half
    ramp: Float[Array, ""]  # m, ahead, over which somebody comes in sight

    def gather(self, pair: Pair) -> tuple[Array]:
        """By how much to step to the right for one other. ``act`` multiplies what is the same for all others.

        Returns:
            () m6 s2, the share of the push, negative to the left, times ``_scale``.
        """
        dx, dy, look_x, look_y = pair.dx, pair.dy, pair.look_x, pair.look_y
        ux, uy = pair.vx - pair.wx, pair.vy - pair.wy
        uu = ux * ux + uy * uy
        inverse = jax.lax.rsqrt(uu + self.speed * self.speed) ** 2  # cheaper than a division
        approach = -(dx * ux + dy * uy)
        time = jnp.maximum(approach, 0.0) * inverse
        mx, my = dx + ux * time, dy + uy * time
        soon = jnp.maximum(self.horizon - time, 0.0)
        near = jnp.maximum(self.width * self.width - (mx * mx + my * my), 0.0)
        seen = jnp.clip(-(dx * look_x + dy * look_y), 0.0, self._ramp())
        right = mx * look_y - my * look_x + self.side
        closing = jnp.where(approach > 0.0, uu * inverse, 0.0)
        return (seen * closing * (soon * near) ** 2 * right,)

    def act(self, crowd: Crowd, share: Float[Array, "N"]) -> Force:
        """The push to the side, ``strength`` at most.

        Args:
            share: (N,) the sum of what ``gather`` gives of all others.

        Returns:
            (N,) x and y parts [m/s2].
        """
        share = share * (self.gain / self._scale())
        push = self.strength * share * jax.lax.rsqrt(1.0 + share * share)
        push = jnp.where(crowd.people.group >= 0, 0.0, push)
        return push * crowd.look_y, -push * crowd.look_x

    def _ramp(self) -> Array:
        return jnp.maximum(self.ramp, SHORTEST)

    def _scale(self) -> Array:
        """As in ``Headway``."""
        return self._ramp() * self.horizon**2 * jnp.maximum(self.width, SHORTEST) ** 5

    def cutoff(self, walking: Walking) -> Array:
        """The distance beyond which nobody can come near within the horizon.

        Returns:
            () m.
        """
        return self.width + 2.0 * walking.speed_ratio * walking.speed_max * self.horizon

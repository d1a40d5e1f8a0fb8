"""Sidestep (section IV-D [44]): people step to one side of somebody who comes towards them."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.social_forces.repulsion import TINY
from sean_jax.social_forces.terms import Force, Pair
from sean_jax.social_forces.walking import Walking


@struct.dataclass
class Sidestep:
    """A push across the look of whoever has somebody come towards them. Standing members of groups do not step aside.

    In SEAN 2.0's form: of the size of ``preference`` times the cosine of the bearing, while the other is within
    ``range`` and ``cosine`` ahead and the two are closing.
    """

    preference: Float[Array, ""]  # m/s2; positive to the right
    cosine: Float[Array, ""]  # 1, cosine of the half angle within which somebody counts as oncoming
    range: Float[Array, ""]  # m, and the distance
    scaled_by_robot: bool = struct.field(pytree_node=False, default=False)  # whether by a moving robot's factor, too

    def pair(self, pair: Pair) -> Force:
        """The push to the side, zero unless the other is oncoming.

        Returns:
            () x and y parts [m/s2].
        """
        dx, dy, look_x, look_y = pair.dx, pair.dy, pair.look_x, pair.look_y
        dd = dx * dx + dy * dy + TINY
        bearing = -(dx * look_x + dy * look_y) * jax.lax.rsqrt(dd)
        closing = (pair.wx - pair.vx) * look_x + (pair.wy - pair.vy) * look_y < 0.0
        oncoming = closing & (bearing >= self.cosine) & (dd < self.range * self.range)
        push = jnp.where(oncoming, jnp.where(pair.standing, 0.0, self.preference) * bearing, 0.0)
        if self.scaled_by_robot and pair.repulsion_scale is not None:
            push = push * pair.repulsion_scale
        return push * look_y, -push * look_x

    def cutoff(self, walking: Walking) -> Array:
        """The distance within which people step aside, ``range``.

        Args:
            walking: not used.

        Returns:
            () m.
        """
        return self.range

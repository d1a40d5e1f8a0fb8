"""O-spaces of conversational groups (section IV-D, low level): people walk around those who stand and talk.

A. Kendon, Conducting Interaction (1990).
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.geometry import sum_vectors
from sean_jax.social_forces.repulsion import TINY
from sean_jax.social_forces.terms import Crowd, Force


@struct.dataclass
class GroupSpace:
    """A push A exp((radius - distance) / B) away from the centre of each group, on all but its standing members."""

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "strength": (-1e6, 1e6),
        "range": (0.05, 1e3),
    }

    strength: Float[Array, ""]  # m/s2, A
    range: Float[Array, ""]  # m, B

    def person(self, crowd: Crowd) -> Force | None:
        """The push of all groups on everybody.

        Returns:
            (N,) x and y parts [m/s2]; None if there are no groups.
        """
        groups, people = crowd.groups, crowd.people
        if groups is None:
            return None

        def push(px, py, member_of, index, center, radius, present):
            dx, dy = px - center[0], py - center[1]
            dd = dx * dx + dy * dy + TINY
            inverse = jax.lax.rsqrt(dd)
            size = self.strength * jnp.exp((radius - dd * inverse) / self.range) * inverse
            size = jnp.where(present & (member_of != index), size, 0.0)
            return size * dx, size * dy

        index = jnp.arange(groups.radius.shape[0], dtype=jnp.int32)
        each_group = jax.vmap(push, in_axes=(None, None, None, 0, 0, 0, 0))
        pushes = jax.vmap(each_group, in_axes=(0, 0, 0, None, None, None, None))(
            people.position[:, 0],
            people.position[:, 1],
            people.group,
            index,
            groups.center,
            groups.radius,
            groups.present,
        )
        return sum_vectors(*pushes, 1)

"""Contact (section IV-D, low level): bodies that touch push and rub; how short the steps must be for stiff bodies.

[H00] D. Helbing, I. Farkas & T. Vicsek, Nature 407, 487 (2000).
"""

import math
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.social_forces.repulsion import TINY
from sean_jax.social_forces.terms import Force, Forces, Pair
from sean_jax.social_forces.walking import Walking

SUBSTEP = 0.05  # s, at most: a tenth of the relaxation time
NEIGHBORS = 6  # whom a body touches in the densest packing; they make its stiffest mode
OVERLAP = 0.01  # m, up to which friction is stable in that packing; where fewer touch, at deeper overlaps


@struct.dataclass
class Contact:
    """A push of two discs in proportion to their overlap g, and sliding friction between them.

    As printed in [H00]: the body force k g n and the sliding friction kappa g ((w - v) . t) t, with n along d and t
    across it. At obstacles ``walls.project_velocity`` takes the place of the body force.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "stiffness": (0.0, 1e6),
        "friction": (0.0, 1e6),
    }

    relations: ClassVar[dict[str, Callable[[Any], Any]]] = {
        "friction of bodies without stiffness": lambda term: term.friction is not None and term.stiffness <= 0,
    }

    stiffness: Float[Array, ""]  # 1/s2, by which overlapping bodies part: k / m of [H00]
    friction: Float[Array, ""] | None = None  # 1/(m s), of bodies that slide: kappa / m of [H00]; None: not computed

    def pair(self, pair: Pair) -> Force:
        """The push and the friction, zero unless the two touch.

        Returns:
            () x and y parts [m/s2].
        """
        dx, dy = pair.dx, pair.dy
        dd = dx * dx + dy * dy + TINY
        inverse = jax.lax.rsqrt(dd)
        overlap = jnp.maximum(pair.radii - dd * inverse, 0.0)
        push = self.stiffness * overlap * inverse
        if self.friction is None:
            return push * dx, push * dy
        slide = (pair.wy - pair.vy) * dx - (pair.wx - pair.vx) * dy
        rub = self.friction * overlap * inverse * inverse * slide
        return push * dx - rub * dy, push * dy + rub * dx

    def cutoff(self, walking: Walking) -> Array:
        """The distance at which bodies touch: two radii.

        Returns:
            () m.
        """
        return 2.0 * walking.radius


def longest_step(forces: Forces) -> float:
    """The longest step with which touching bodies stay stable. Runs on the host.

    Semi-implicit Euler of a spring of frequency w that friction damps at a rate c is stable while
    (w step)^2 + 2 c step < 4. In the densest packing the largest w^2 is 6 k and, at an overlap g, the largest c is
    6 kappa g, with k = ``stiffness`` and kappa = ``friction``; that both belong to one motion is the worst case.

    Args:
        forces: with or without ``Contact``.

    Returns:
        Seconds, ``SUBSTEP`` at most.
    """
    contact = forces.get(Contact)
    if contact is None:
        return SUBSTEP
    stiffness = NEIGHBORS * max(float(np.max(np.asarray(contact.stiffness))), 1e-9)
    friction = 0.0 if contact.friction is None else float(np.max(np.asarray(contact.friction)))
    rate = NEIGHBORS * OVERLAP * friction
    return min(SUBSTEP, (math.sqrt(rate**2 + 4.0 * stiffness) - rate) / stiffness)


def substeps(forces: Forces, time_step: float) -> int:
    """Into how many steps of the social forces a control step is divided.

    Args:
        forces: whose ``Contact`` decides.
        time_step: of control [s].

    Returns:
        The number, 1 or more.
    """
    return math.ceil(time_step / longest_step(forces) - 1e-6)

"""Repulsion between two people (section IV-D, low level), and the weight of what a person does not see.

[HM95] D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995). [J07] A. Johansson, D. Helbing & P. Shukla, Adv. Complex
Syst. 10, 271 (2007). Laws are written for one pair in components, as printed: ``d`` leads from the other person to the
one who feels the push, ``w`` is the other's velocity and ``v`` one's own.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.social_forces.terms import Force, Pair
from sean_jax.social_forces.walking import Walking

TINY = 1e-8  # m2: keeps lengths differentiable at zero, 1e-7 of the square of a distance of 0.3 m
MAX_EXPONENT = 20.0  # a push e^20 times the usual one is as good as any, and its square is still a number
NEGLIGIBLE = 1e-4  # m/s2, of a push


@struct.dataclass
class Repulsion:
    """A push away from each other person, the stronger the nearer, weaker if the other is out of sight."""

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "strength": (-1e6, 1e6),
        "range": (0.01, 1e3),
        "anticipation": (0.0, 100.0),
        "sight_cosine": (-1.0, 1.0),
    }
    relations: ClassVar[dict[str, Callable[[Any], Any]]] = {
        "reach is more than 20 times range": lambda term: term.reach > MAX_EXPONENT * term.range,
    }

    strength: Float[Array, ""]  # m/s2, A of A exp((reach - b) / range)
    range: Float[Array, ""]  # m, B
    reach: Float[Array, ""]  # m, added to the exponent's distance (SEAN: both radii and half a metre)
    anticipation: Float[Array, ""]  # s, the step that b looks ahead; 0 makes ellipses circles
    own_motion: Float[Array, ""]  # 1, share of the own velocity in that step: 0 as in [HM95], 1 as in [J07]
    back_weight: Float[Array, ""]  # 1, weight of what is not in sight: c of [HM95], lambda of [J07]
    sight_cosine: Float[Array, ""]  # 1, cosine of the half angle of sight of [HM95]
    law: Callable = struct.field(pytree_node=False)  # (parameters, pair) -> (fx, fy) m/s2: elliptical or circular
    sight: Callable = struct.field(pytree_node=False)  # (parameters, pair, fx, fy) -> weight, such as in_cone

    def pair(self, pair: Pair) -> Force:
        """The law's push, weighted by sight and, if the other is a robot that moves, by the pair's scale.

        Returns:
            () x and y parts [m/s2].
        """
        fx, fy = self.law(self, pair)
        weight = self.sight(self, pair, fx, fy)
        if pair.repulsion_scale is not None:
            weight = weight * pair.repulsion_scale
        return weight * fx, weight * fy

    def cutoff(self, walking: Walking) -> Array | None:
        """The distance [m] beyond which the push is below 1e-4 m/s2.

        A push of the elliptical law decays with b, and the ellipse of that b reaches sqrt(b^2 + (y / 2)^2) + y / 2 from
        the other person, y being how far they walk in the time of the anticipation.

        Returns:
            () m, or None if the law is not one of this file.
        """
        if self.law not in (elliptical, circular):
            return None
        b = self.reach + self.range * jnp.log(jnp.maximum(2.0 * self.strength / NEGLIGIBLE, 1.0))
        y = (1.0 + self.own_motion) * self.anticipation * walking.speed_ratio * walking.speed_max
        return jnp.sqrt(b * b + 0.25 * y * y) + 0.5 * y


def elliptical(parameters: Repulsion, pair: Pair) -> Force:
    """Repulsion that decays with the semi-minor axis b of the ellipse around the other's next step.

    With y = (w - own_motion v) anticipation, 2 b = sqrt((|d| + |d - y|)^2 - |y|^2), the push is
    A exp((reach - b) / B) (|d| + |d - y|) / (4 b) (d / |d| + (d - y) / |d - y|). The difference of squares is evaluated
    as 2 (|d| |d - y| + d . (d - y)), and that sum, where it would cancel, by way of the cross product.

    Returns:
        () x and y parts [m/s2].
    Source:
        The negative gradient of the potential of [HM95], eq. (3)-(4), and the elliptical specification II of [J07].
    """
    dx, dy = pair.dx, pair.dy
    ex = dx - (pair.wx - parameters.own_motion * pair.vx) * parameters.anticipation
    ey = dy - (pair.wy - parameters.own_motion * pair.vy) * parameters.anticipation
    dd, ee = dx * dx + dy * dy + TINY, ex * ex + ey * ey + TINY
    inverse_d, inverse_e = jax.lax.rsqrt(dd), jax.lax.rsqrt(ee)
    d, e = dd * inverse_d, ee * inverse_e
    dot, cross = dx * ex + dy * ey, dx * ey - dy * ex
    ahead = dot < 0.0
    bb = 0.5 * jnp.where(ahead, cross * cross / (d * e + jnp.abs(dot)), d * e + dot) + TINY
    inverse_b = jax.lax.rsqrt(bb)
    push = parameters.strength * jnp.exp((parameters.reach - bb * inverse_b) * (1.0 / parameters.range))
    push = push * (0.25 * (d + e) * inverse_b)
    return push * (dx * inverse_d + ex * inverse_e), push * (dy * inverse_d + ey * inverse_e)


def circular(parameters: Repulsion, pair: Pair) -> Force:
    """Repulsion A exp((reach - |d|) / B) along d.

    Returns:
        () x and y parts [m/s2].
    Source:
        The circular specification of [J07], and the law of SEAN 2.0's code.
    """
    dx, dy = pair.dx, pair.dy
    dd = dx * dx + dy * dy + TINY
    inverse = jax.lax.rsqrt(dd)
    push = parameters.strength * jnp.exp((parameters.reach - dd * inverse) * (1.0 / parameters.range)) * inverse
    return push * dx, push * dy


def in_cone(parameters: Repulsion, pair: Pair, fx: Array, fy: Array) -> Array:
    """Weight of a push: 1 if it comes from within the angle of sight, else ``back_weight``.

    The condition h . (-f) >= |f| cos(phi) is compared by signed squares.

    Args:
        fx: () x part of the push [m/s2].
        fy: () y part [m/s2].

    Returns:
        () weight.
    Source:
        [HM95], eq. (8).
    """
    along = -(fx * pair.look_x + fy * pair.look_y)
    limit = parameters.sight_cosine * jnp.abs(parameters.sight_cosine) * (fx * fx + fy * fy)
    return jnp.where(along * jnp.abs(along) >= limit, 1.0, parameters.back_weight)


def in_front(parameters: Repulsion, pair: Pair, fx: Array, fy: Array) -> Array:
    """Weight of a push: lambda + (1 - lambda) (1 + cos(phi)) / 2, phi between the look and the other person.

    Args:
        fx: not used.
        fy: not used.

    Returns:
        () weight.
    Source:
        [J07], eq. (7).
    """
    dx, dy = pair.dx, pair.dy
    cosine = -(dx * pair.look_x + dy * pair.look_y) * jax.lax.rsqrt(dx * dx + dy * dy + TINY)
    return parameters.back_weight + (1.0 - parameters.back_weight) * 0.5 * (1.0 + cosine)


def all_round(parameters: Repulsion, pair: Pair, fx: Array, fy: Array) -> float:
    """Weight of a push that people feel from all sides alike: 1.

    So a uniform crowd, however dense, pushes nobody back.

    Args:
        parameters: not used.
        pair: not used.
        fx: not used.
        fy: not used.
    """
    return 1.0

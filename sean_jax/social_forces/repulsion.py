"""The pair law: how one person is pushed by another (Helbing & Molnar 1995; Johansson et al. 2007).

Written for one pair in components, as printed; ``vmap`` lifts it. ``d`` leads from the other to the one,
``w`` is the other's velocity, ``v`` the own one. ``parameters`` is ``social_forces.Parameters``.
"""

from typing import Any

import jax
import jax.numpy as jnp

from sean_jax.base import Array

TINY = 1e-8  # m2: keeps lengths differentiable at zero, 1e-7 of the square of a distance of 0.3 m


def elliptical(dx: Array, dy: Array, wx: Array, wy: Array, vx: Array, vy: Array, parameters: Any) -> tuple:
    """Repulsion [m/s2] that decays with the semi-minor axis b of the ellipse around the other's next step.

    With y = (w - own_motion v) anticipation, 2 b = sqrt((|d| + |d - y|)^2 - |y|^2), the push is
    A exp((reach - b) / B) (|d| + |d - y|) / (4 b) (d / |d| + (d - y) / |d - y|): the negative gradient of the
    potential of Helbing & Molnar (1995), eq. (3)-(4), and the elliptical specification II of Johansson et al.
    (2007). The difference of squares is evaluated as 2 (|d| |d - y| + d . (d - y)), and that sum, where it would
    cancel, by way of the cross product.
    """
    ex = dx - (wx - parameters.own_motion * vx) * parameters.anticipation
    ey = dy - (wy - parameters.own_motion * vy) * parameters.anticipation
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


def circular(dx: Array, dy: Array, wx: Array, wy: Array, vx: Array, vy: Array, parameters: Any) -> tuple:
    """Repulsion [m/s2] A exp((reach - |d|) / B) along d: the circular specification, and SEAN 2.0's own."""
    dd = dx * dx + dy * dy + TINY
    inverse = jax.lax.rsqrt(dd)
    push = parameters.strength * jnp.exp((parameters.reach - dd * inverse) * (1.0 / parameters.range)) * inverse
    return push * dx, push * dy


def contact(dx: Array, dy: Array, wx: Array, wy: Array, vx: Array, vy: Array, apart: Array, parameters: Any) -> tuple:
    """Push [m/s2] of a touching body: of two discs that touch at ``apart`` [m], in proportion to their overlap g.

    Helbing, Farkas & Vicsek (2000): the body force k g n and, if ``friction`` is not None, the sliding friction
    kappa g ((w - v) . t) t, with n along d and t across it.
    """
    dd = dx * dx + dy * dy + TINY
    inverse = jax.lax.rsqrt(dd)
    overlap = jnp.maximum(apart - dd * inverse, 0.0)
    push = parameters.body * overlap * inverse
    if parameters.friction is None:
        return push * dx, push * dy
    rub = parameters.friction * overlap * inverse * inverse * ((wy - vy) * dx - (wx - vx) * dy)
    return push * dx - rub * dy, push * dy + rub * dx


def in_cone(fx: Array, fy: Array, dx: Array, dy: Array, hx: Array, hy: Array, parameters: Any) -> Array:
    """Weight of a push: 1 if it comes from within the angle of sight about the heading, else ``back_weight``.

    Helbing & Molnar (1995), eq. (8): h . (-f) >= |f| cos(phi), compared by signed squares.
    """
    along = -(fx * hx + fy * hy)
    limit = parameters.sight_cosine * jnp.abs(parameters.sight_cosine) * (fx * fx + fy * fy)
    return jnp.where(along * jnp.abs(along) >= limit, 1.0, parameters.back_weight)


def in_front(fx: Array, fy: Array, dx: Array, dy: Array, hx: Array, hy: Array, parameters: Any) -> Array:
    """Weight of a push: lambda + (1 - lambda) (1 + cos(phi)) / 2, phi between the heading and the other person.

    Johansson et al. (2007), eq. (7).
    """
    cosine = -(dx * hx + dy * hy) * jax.lax.rsqrt(dx * dx + dy * dy + TINY)
    return parameters.back_weight + (1.0 - parameters.back_weight) * 0.5 * (1.0 + cosine)


def sidestep(
    dx: Array, dy: Array, wx: Array, wy: Array, vx: Array, vy: Array, hx: Array, hy: Array, preference: Array, p: Any
) -> tuple:
    """Push [m/s2] to the right of the heading (hx, hy) by somebody who comes towards one [44].

    In SEAN 2.0's form: of the size of the ``preference`` (negative: to the left) but for the cosine of the bearing,
    while the other is within ``side_range`` and ``side_cosine`` ahead and the two are closing.
    """
    dd = dx * dx + dy * dy + TINY
    bearing = -(dx * hx + dy * hy) * jax.lax.rsqrt(dd)
    closing = (wx - vx) * hx + (wy - vy) * hy < 0.0
    oncoming = closing & (bearing >= p.side_cosine) & (dd < p.side_range * p.side_range)
    push = jnp.where(oncoming, preference * bearing, 0.0)
    return push * hy, -push * hx

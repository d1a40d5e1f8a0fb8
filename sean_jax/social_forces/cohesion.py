"""Cohesion of parties (section IV-D, low level): two or three people who walk together, side by side.

M. Moussaid, N. Perozo, S. Garnier, D. Helbing & G. Theraulaz, PLoS ONE 5(4), e10047 (2010): people slow down when they
would have to turn their heads to see the others (gaze), are drawn to the middle of the party when they are far from it
(attraction), and keep off one another (repulsion). As printed the last two switch on and off; here they fade in over
``party_ramp``, so that nobody jerks and the law can be differentiated.
"""

from typing import Any

import jax.numpy as jnp

from sean_jax.base import Array, Pedestrians
from sean_jax.geometry import angle_between, length, unit
from sean_jax.social_forces.repulsion import contact

BESIDE = 0.01  # m2: the direction of a companion means less and less below a distance of 0.1 m, and nothing at 0


def cohesion_forces(
    parameters: Any, people: Pedestrians, companions: Array, look_x: Array, look_y: Array
) -> tuple[Array, Array]:
    """(N,) x and y parts [m/s2] of gaze, attraction, repulsion and contact among ``companions`` (N, 2), -1 none."""
    there = (companions >= 0) & people.present[companions]
    position, velocity = people.position, people.velocity
    dx = jnp.where(there, position[:, 0][:, None] - position[companions, 0], 0.0)
    dy = jnp.where(there, position[:, 1][:, None] - position[companions, 1], 0.0)
    number = there.sum(1, dtype=jnp.int32).astype(float)
    share = 1.0 / jnp.maximum(number, 1.0)
    cx, cy = -dx.sum(1) * share, -dy.sum(1) * share  # to the middle of the others
    fx, fy = gaze(cx, cy, velocity[:, 0], velocity[:, 1], look_x, look_y, parameters)
    ax, ay = attraction(cx, cy, number, parameters)
    wx, wy = velocity[companions, 0], velocity[companions, 1]
    vx, vy = jnp.broadcast_to(velocity[:, :1], wx.shape), jnp.broadcast_to(velocity[:, 1:], wy.shape)
    rx, ry = apart(dx, dy, parameters)
    bx, by = contact(dx, dy, wx, wy, vx, vy, 2.0 * parameters.radius, parameters)
    px, py = jnp.where(there, rx + bx, 0.0).sum(1), jnp.where(there, ry + by, 0.0).sum(1)
    felt = number > 0.0
    return jnp.where(felt, fx + ax + px, 0.0), jnp.where(felt, fy + ay + py, 0.0)


def gaze(cx: Array, cy: Array, vx: Array, vy: Array, hx: Array, hy: Array, parameters: Any) -> tuple:
    """Push [m/s2] -beta1 alpha v against one's own velocity.

    alpha [rad] is by how much the middle of the others, at c, lies beyond ``party_view`` off the heading h.
    """
    angle = jnp.abs(angle_between(jnp.stack([hx, hy], -1), jnp.stack([cx, cy], -1)))
    square = cx * cx + cy * cy
    size = parameters.party_gaze * jnp.maximum(angle - parameters.party_view, 0.0) * square / (square + BESIDE)
    return -size * vx, -size * vy


def attraction(cx: Array, cy: Array, number: Array, parameters: Any) -> tuple:
    """Pull [m/s2] beta2 towards the middle of a party of 1 + number people, from far from it.

    That middle lies at number / (1 + number) of the way c to the middle of the others; far is number / 2 times
    ``party_far``.
    """
    away = length(cx, cy) * number / (1.0 + number) - 0.5 * number * parameters.party_far
    ux, uy = unit(cx, cy)
    pull = parameters.party_attraction * jnp.clip(away / parameters.party_ramp, 0.0, 1.0)
    return pull * ux, pull * uy


def apart(dx: Array, dy: Array, parameters: Any) -> tuple:
    """Push [m/s2] beta3 along d away from a companion who is nearer than ``party_near``."""
    ux, uy = unit(dx, dy)
    share = (parameters.party_near - length(dx, dy)) / parameters.party_ramp
    push = parameters.party_repulsion * jnp.clip(share, 0.0, 1.0)
    return push * ux, push * uy

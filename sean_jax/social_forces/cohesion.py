"""Cohesion of walking groups (section IV-D, low level): two or three people who walk together, side by side.

M. Moussaid, N. Perozo, S. Garnier, D. Helbing & G. Theraulaz, PLoS ONE 5(4), e10047 (2010) [M10]: people slow down when
they would have to turn their heads to see the others (gaze), are drawn to the middle of the group when they are far
from it (attraction), and keep off one another (repulsion). As printed the last two switch on and off. Here they fade in
over ``ramp``, so that nobody jerks and the law can be differentiated.
"""

from typing import ClassVar

import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.geometry import angle_between, length, unit
from sean_jax.social_forces.contact import Contact
from sean_jax.social_forces.terms import Crowd, Force, Pair

SOFTENING = 0.01  # m2: the direction of a companion means less and less below a distance of 0.1 m, and nothing at 0


@struct.dataclass
class Cohesion:
    """Gaze, attraction, repulsion and contact among companions, who do not feel one another's pair terms."""

    damped: ClassVar[bool] = False
    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "ramp": (1e-3, 1e3),
    }

    gaze: Float[Array, ""]  # 1/(s rad), beta1 of [M10]: braking when companions are out of view
    view_angle: Float[Array, ""]  # rad, half angle of that view
    attraction: Float[Array, ""]  # m/s2, beta2 of [M10]: pull to the middle of one's walking group
    attraction_distance: Float[Array, ""]  # m, times half the number of companions: from the middle to where it begins
    repulsion: Float[Array, ""]  # m/s2, beta3 of [M10]: push from a companion ...
    repulsion_distance: Float[Array, ""]  # m, ... nearer than that
    ramp: Float[Array, ""]  # m, over which pull and push fade in; [M10] has steps

    def person(self, crowd: Crowd) -> Force | None:
        """Gaze, attraction, repulsion and contact of everybody's companions.

        Returns:
            (N,) x and y parts [m/s2], zero for those who walk alone; None if there are no companions.
        """
        people, companions = crowd.people, crowd.companions
        if companions is None:
            return None
        there = (companions >= 0) & people.present[companions]
        position, velocity = people.position, people.velocity
        dx = jnp.where(there, position[:, 0][:, None] - position[companions, 0], 0.0)
        dy = jnp.where(there, position[:, 1][:, None] - position[companions, 1], 0.0)
        number = there.sum(1, dtype=jnp.int32).astype(float)
        share = 1.0 / jnp.maximum(number, 1.0)
        cx, cy = -dx.sum(1) * share, -dy.sum(1) * share  # to the middle of the others
        fx, fy = gaze(self, cx, cy, velocity[:, 0], velocity[:, 1], crowd.look_x, crowd.look_y)
        ax, ay = attraction(self, cx, cy, number)
        wx, wy = velocity[companions, 0], velocity[companions, 1]
        vx, vy = jnp.broadcast_to(velocity[:, :1], wx.shape), jnp.broadcast_to(velocity[:, 1:], wy.shape)
        rx, ry = apart(self, dx, dy)
        contact = crowd.forces.get(Contact)
        if contact is not None:
            radii = 2.0 * crowd.forces.walking.radius
            bx, by = contact.pair(Pair(dx, dy, wx, wy, vx, vy, crowd.look_x[:, None], crowd.look_y[:, None], radii))
            rx, ry = rx + bx, ry + by
        px, py = jnp.where(there, rx, 0.0).sum(1), jnp.where(there, ry, 0.0).sum(1)
        felt = number > 0.0
        return jnp.where(felt, fx + ax + px, 0.0), jnp.where(felt, fy + ay + py, 0.0)


def gaze(
    parameters: Cohesion,
    cx: Float[Array, "*N"],
    cy: Float[Array, "*N"],
    vx: Float[Array, "*N"],
    vy: Float[Array, "*N"],
    look_x: Float[Array, "*N"],
    look_y: Float[Array, "*N"],
) -> Force:
    """Push -beta1 alpha v against one's own velocity.

    alpha [rad] is by how much the middle of the others lies beyond ``view_angle`` off the look.

    Args:
        cx: x part of the way to the middle of the others [m].
        cy: y part [m].
        vx: x part of one's own velocity [m/s].
        vy: y part [m/s].

    Returns:
        x and y parts [m/s2].
    Source:
        [M10], eq. (2).
    """
    angle = jnp.abs(angle_between(jnp.stack([look_x, look_y], -1), jnp.stack([cx, cy], -1)))
    square = cx * cx + cy * cy
    size = parameters.gaze * jnp.maximum(angle - parameters.view_angle, 0.0) * square / (square + SOFTENING)
    return -size * vx, -size * vy


def attraction(
    parameters: Cohesion, cx: Float[Array, "*N"], cy: Float[Array, "*N"], number: Float[Array, "*N"] | float
) -> Force:
    """Pull beta2 towards the middle of a walking group of 1 + number people, from far from it.

    That middle lies at number / (1 + number) of the way to the middle of the others; far is number / 2 times
    ``attraction_distance``.

    Args:
        cx: x part of the way to the middle of the others [m].
        cy: y part [m].

    Returns:
        x and y parts [m/s2].
    Source:
        [M10], eq. (3).
    """
    away = length(cx, cy) * number / (1.0 + number) - 0.5 * number * parameters.attraction_distance
    ux, uy = unit(cx, cy)
    pull = parameters.attraction * jnp.clip(away / parameters.ramp, 0.0, 1.0)
    return pull * ux, pull * uy


def apart(parameters: Cohesion, dx: Float[Array, "*N"], dy: Float[Array, "*N"]) -> Force:
    """Push beta3 away from a companion who is nearer than ``repulsion_distance``.

    Args:
        dx: x part of the way from the companion [m].
        dy: y part [m].

    Returns:
        x and y parts [m/s2].
    Source:
        [M10], eq. (4).
    """
    ux, uy = unit(dx, dy)
    share = (parameters.repulsion_distance - length(dx, dy)) / parameters.ramp
    push = parameters.repulsion * jnp.clip(share, 0.0, 1.0)
    return push * ux, push * uy

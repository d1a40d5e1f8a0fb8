"""The impulses on a robot in one physics step: tyres on the floor, contacts with boxes and people (Fig. 3).

Generalised coordinates are x, y [m], yaw, left and right wheel angle [rad]. Impulses follow from predicted velocities
(velocity-implicit). A force from the slip or the approach speed at the start of a step would overshoot and oscillate
at time steps of practical size.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.base import Array, Obstacles, RobotModel
from sean_jax.geometry import from_box, length, rotate, unit

GRAVITY = 9.81  # m/s2
RECOVERY = 0.2  # share of an overlap that one physics step undoes (Baumgarte 1972); a larger one bounces

Motion = tuple[Float[Array, "5"], Float[Array, "5"]]
"""Generalised coordinates of a robot and their rates."""


@struct.dataclass
class Surroundings:
    """Everything that a robot can touch during one control step."""

    obstacles: Obstacles
    position: Float[Array, "N 2"]  # m, of people at the end of the control step
    velocity: Float[Array, "N 2"]  # m/s
    present: Bool[Array, "N"]
    person_radius: Float[Array, ""]  # m


def impulse(
    model: RobotModel,
    surroundings: Surroundings,
    time_left: Float[Array, ""],
    motion: Motion,
    velocity: Float[Array, "5"],
) -> Float[Array, "5"]:
    """Generalised impulse of the ground and of all contacts.

    The tyres act first, then people, then obstacles, so that no wall is ever passed.

    Args:
        time_left: s, from the start of this physics step to the end of the control step.
        velocity: (5,) rates at the end of the physics step, if there were no impulse.

    Returns:
        (5,) N s and N m s.
    """
    position, _ = motion
    middle = position[2] + 0.5 * model.time_step * velocity[2]  # yaw halfway through the step: else turning would slip
    cosine, sine = jnp.cos(middle), jnp.sin(middle)
    jx, jy, spin, left, right = _tyres(model, cosine, sine, velocity)
    start = velocity[0] + jx / model.mass, velocity[1] + jy / model.mass
    vx, vy = touching(model, surroundings, time_left, position, *start)
    px, py = model.mass * (vx - start[0]), model.mass * (vy - start[1])
    return jnp.stack([jx + px, jy + py, spin, left, right])


def _tyres(model: RobotModel, cosine: Array, sine: Array, velocity: Array) -> tuple[Array, ...]:
    """The impulses of two tyres that end all slip, each within its friction circle.

    The longitudinal impulses solve a symmetric 2x2 system, because a push on one wheel also moves the other.
    """
    half = 0.5 * model.track
    along, across = rotate(velocity[0], velocity[1], cosine, -sine)
    slip_left = along - half * velocity[2] - model.wheel_radius * velocity[3]
    slip_right = along + half * velocity[2] - model.wheel_radius * velocity[4]
    linear, angular = 1.0 / model.mass, half * half / model.inertia
    own = linear + angular + model.wheel_radius * model.wheel_radius / model.wheel_inertia
    other = linear - angular
    determinant = own * own - other * other
    sideways = -0.5 * model.mass * across  # of each tyre: they share it
    limit = 0.5 * model.friction * model.mass * GRAVITY * model.time_step
    left, left_side = _clip_length((other * slip_right - own * slip_left) / determinant, sideways, limit)
    right, right_side = _clip_length((other * slip_left - own * slip_right) / determinant, sideways, limit)
    jx, jy = rotate(left + right, left_side + right_side, cosine, sine)
    return jx, jy, half * (right - left), -model.wheel_radius * left, -model.wheel_radius * right


def _clip_length(x: Array, y: Array, limit: Array) -> tuple[Array, Array]:
    """(x, y), shortened to the length ``limit`` if it is longer: the friction circle."""
    size = length(x, y)
    over = size > limit
    scale = jnp.where(over, limit / jnp.where(over, size, 1.0), 1.0)
    return x * scale, y * scale


def touching(
    model: RobotModel,
    surroundings: Surroundings,
    time_left: Float[Array, ""],
    position: Float[Array, "..."],
    vx: Float[Array, ""],
    vy: Float[Array, ""],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The velocity that the contacts of the robot's disc leave it.

    A contact limits the approach speed to the one that closes the gap within the physics step, so that the robot comes
    to rest at the surface. It undoes a share of an overlap. There is no friction: the robot slides along.

    Args:
        time_left: s, from the start of this physics step to the end of the control step.
        position: its first two are x and y [m].
        vx: m/s without contacts.
        vy: m/s likewise.

    Returns:
        m/s along x and along y.
    """
    x, y = position[0], position[1]
    px, py, ux, uy = *surroundings.position.T, *surroundings.velocity.T

    def person(x: Array, y: Array, people: tuple) -> tuple[Array, Array, Array]:
        px, py, ux, uy, present = people
        dx, dy = x - (px - ux * time_left), y - (py - uy * time_left)
        nx, ny = unit(dx, dy)
        gap = length(dx, dy) - (surroundings.person_radius + model.radius)
        allowed = _approach(model, gap) - (ux * nx + uy * ny)
        return nx, ny, jnp.where(present, allowed, jnp.inf)

    def obstacle(x: Array, y: Array, box: Obstacles) -> tuple[Array, Array, Array]:
        distance, nx, ny = from_box(x, y, box)
        return nx, ny, _approach(model, distance - model.radius)

    if surroundings.present.shape[0]:
        vx, vy = _touch(person, (px, py, ux, uy, surroundings.present), 1, x, y, vx, vy)
    if surroundings.obstacles.yaw.shape[0]:
        vx, vy = _touch(obstacle, surroundings.obstacles, 2, x, y, vx, vy)  # a corner has two walls
    return vx, vy


def _approach(model: RobotModel, gap: Array) -> Array:
    """Maximum approach speed [m/s] at a contact with this gap [m]; negative for an overlap, where bodies separate.

    The speed of separation is limited to the robot's top speed, so that a deep overlap does not throw the robot out.
    """
    share = jnp.where(gap > 0.0, 1.0, RECOVERY)
    return jnp.maximum(share * gap / model.time_step, -model.max_speed)


def _touch(contact: Callable, things: Any, times: int, x: Array, y: Array, vx: Array, vy: Array) -> tuple[Array, Array]:
    """(vx, vy) of a robot at (x, y) after the most violated contact was enforced, ``times`` times.

    ``contact(x, y, things) -> normal x, normal y, allowed approach speed``. One contact at a time, because a wall of
    several boxes would otherwise throw the robot back once for each box. The choice of the contact has no gradient, so
    that reverse mode stores and visits this one only.
    """
    stop = jax.lax.stop_gradient
    nx, ny, allowed = contact(stop(x), stop(y), stop(things))
    for _ in range(times):
        strongest = jnp.argmax(-(stop(vx) * nx + stop(vy) * ny) - allowed)
        one_nx, one_ny, one_allowed = contact(x, y, jax.tree.map(lambda leaf: leaf[strongest], things))  # noqa: B023
        push = jnp.maximum(-(vx * one_nx + vy * one_ny) - one_allowed, 0.0)
        vx, vy = vx + push * one_nx, vy + push * one_ny
    return vx, vy

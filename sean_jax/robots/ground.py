"""What the world does to a robot in one physics step: tyres on the floor, boxes and people in the way (Fig. 3).

Generalised coordinates are x, y [m], yaw, left and right wheel angle [rad]. Laws are impulses on predicted velocities
(velocity-implicit): a force that follows from the slip or the approach speed at the start of a step overshoots, and
limit-cycles, at the time steps that are worth using.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, Obstacles, RobotModel
from sean_jax.geometry import from_box, length, rotate, unit

GRAVITY = 9.81  # m/s2
RECOVERY = 0.2  # share of an overlap that is undone in one physics step (Baumgarte 1972); more of it bounces


@struct.dataclass
class Surroundings:
    """What a robot can touch during one control step."""

    obstacles: Obstacles
    position: Array  # (N, 2) m, of people at the end of the control step
    velocity: Array  # (N, 2) m/s
    present: Array  # (N,) bool
    person_radius: Array  # () m


def impulse(model: RobotModel, around: Surroundings, time_left: Array, body: tuple, velocity: Array) -> Array:
    """Generalised impulse (5,) [N s, N m s] of the ground and of everything that the robot touches.

    ``body`` is (positions (5,), velocities (5,)) at the start of the physics step, ``velocity`` (5,) what the
    velocities would be at its end without this impulse, ``time_left`` () s from the start of the physics step
    to the end of the control step. The tyres act first, then people, then obstacles: walls have the last word.
    """
    position, _ = body
    middle = position[2] + 0.5 * model.time_step * velocity[2]  # the heading halfway, or a turning robot would slip
    cosine, sine = jnp.cos(middle), jnp.sin(middle)
    jx, jy, spin, left, right = _tyres(model, cosine, sine, velocity)
    px, py = _contacts(model, around, time_left, position, velocity[0] + jx / model.mass, velocity[1] + jy / model.mass)
    return jnp.stack([jx + px, jy + py, spin, left, right])


def _tyres(model: RobotModel, cosine: Array, sine: Array, velocity: Array) -> tuple[Array, ...]:
    """The impulse of two tyres that ends all slip, each at most what its friction circle allows.

    The longitudinal impulses that null both slips solve a symmetric 2x2 system: a push on one wheel moves the other.
    """
    half = 0.5 * model.track
    along, across = rotate(velocity[0], velocity[1], cosine, -sine)
    slip_left = along - half * velocity[2] - model.wheel_radius * velocity[3]
    slip_right = along + half * velocity[2] - model.wheel_radius * velocity[4]
    straight, turning = 1.0 / model.mass, half * half / model.inertia
    own = straight + turning + model.wheel_radius * model.wheel_radius / model.wheel_inertia
    other = straight - turning
    determinant = own * own - other * other
    sideways = -0.5 * model.mass * across  # of each tyre: they share it
    most = 0.5 * model.friction * model.mass * GRAVITY * model.time_step
    left, left_side = _at_most((other * slip_right - own * slip_left) / determinant, sideways, most)
    right, right_side = _at_most((other * slip_left - own * slip_right) / determinant, sideways, most)
    jx, jy = rotate(left + right, left_side + right_side, cosine, sine)
    return jx, jy, half * (right - left), -model.wheel_radius * left, -model.wheel_radius * right


def _at_most(x: Array, y: Array, most: Array) -> tuple[Array, Array]:
    """(x, y), shortened to the length ``most`` where it is longer: the friction circle."""
    size = length(x, y)
    over = size > most
    scale = jnp.where(over, most / jnp.where(over, size, 1.0), 1.0)
    return x * scale, y * scale


def _contacts(model, around: Surroundings, time_left: Array, position: Array, vx: Array, vy: Array):
    """Impulse (jx, jy) of the contacts of the robot's disc, given the velocity that it would have without them.

    A contact lets the robot approach just as fast as closes the gap within the physics step, so that it comes to
    rest at the surface, and undoes a share of an overlap that is there already. There is no friction: the robot
    glides.
    """
    x, y = position[0], position[1]
    start = vx, vy
    px, py, ux, uy = *around.position.T, *around.velocity.T

    def person(x: Array, y: Array, people: tuple) -> tuple[Array, Array, Array]:
        px, py, ux, uy, present = people
        dx, dy = x - (px - ux * time_left), y - (py - uy * time_left)
        nx, ny = unit(dx, dy)
        gap = length(dx, dy) - (around.person_radius + model.radius)
        allowed = _approach(model, gap) - (ux * nx + uy * ny)
        return nx, ny, jnp.where(present, allowed, jnp.inf)

    def obstacle(x: Array, y: Array, box: Obstacles) -> tuple[Array, Array, Array]:
        distance, nx, ny = from_box(x, y, box)
        return nx, ny, _approach(model, distance - model.radius)

    if around.present.shape[0]:
        vx, vy = _touch(person, (px, py, ux, uy, around.present), 1, x, y, vx, vy)
    if around.obstacles.yaw.shape[0]:
        vx, vy = _touch(obstacle, around.obstacles, 2, x, y, vx, vy)  # a corner has two walls
    return model.mass * (vx - start[0]), model.mass * (vy - start[1])


def _approach(model: RobotModel, gap: Array) -> Array:
    """Greatest approach speed [m/s] that a contact with this gap [m] allows: negative, so a separation, for an overlap.

    The separation is at most the robot's top speed: nothing is catapulted out of a deep overlap.
    """
    share = jnp.where(gap > 0.0, 1.0, RECOVERY)
    return jnp.maximum(share * gap / model.time_step, -model.max_speed)


def _touch(contact: Callable, things: Any, times: int, x: Array, y: Array, vx: Array, vy: Array) -> tuple[Array, Array]:
    """(vx, vy) after the contact that needs it most was enforced, so many times, of a robot at (x, y).

    ``contact(x, y, things) -> normal x, normal y, allowed approach speed``. One at a time: the boxes side by side that
    make a wall would otherwise throw the robot back once for each. Which one it is has no gradient, so that reverse
    mode keeps and visits that one alone.
    """
    stop = jax.lax.stop_gradient
    nx, ny, allowed = contact(stop(x), stop(y), stop(things))
    for _ in range(times):
        strongest = jnp.argmax(-(stop(vx) * nx + stop(vy) * ny) - allowed)
        one_nx, one_ny, one_allowed = contact(x, y, jax.tree.map(lambda leaf: leaf[strongest], things))  # noqa: B023
        push = jnp.maximum(-(vx * one_nx + vy * one_ny) - one_allowed, 0.0)
        vx, vy = vx + push * one_nx, vy + push * one_ny
    return vx, vy

"""The physics of an omnidirectional base: mecanum wheels, swerve modules or legs, as one body that is pushed.

Generalised coordinates are x, y [m] and yaw [rad]. Three servos push the base ahead, to the left and about the
vertical. The body carries its velocity along when it turns, as ideal wheels do. All horizontal force of the ground is
limited by friction.
"""

import functools

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Lateral, RobotModel
from sean_jax.core.geometry import rotate
from sean_jax.robots.dynamics import GRAVITY, Touch, clip_length, mjx_advance

Motion = tuple[Float[Array, "3"], Float[Array, "3"]]
"""x, y [m] and yaw [rad], and their rates."""


def twin_substep(model: RobotModel, touch: Touch, motion: Motion, targets: Float[Array, "3"]) -> Motion:
    """One physics step of the closed form, by semi-implicit Euler.

    Args:
        targets: m/s ahead, m/s to the left and rad/s.
    """
    position, velocity = motion
    gain, max_force = _servo(model)
    mass = diagonal(model)
    yaw = position[2]
    cosine = jnp.cos(yaw)
    sine = jnp.sin(yaw)

    # Servos push in the robot's frame.
    ahead, left = rotate(velocity[0], velocity[1], cosine, -sine)
    rates = jnp.stack([ahead, left, velocity[2]])
    push = gain * (targets - rates)
    push = jnp.clip(push, -max_force, max_force)
    push_x, push_y = rotate(push[0], push[1], cosine, sine)
    push = jnp.stack([push_x, push_y, push[2]])

    # The ground and the contacts act on the velocity that the servos alone would give.
    free = velocity + model.time_step * push / mass
    impulse = ground_impulse(model, touch, motion, free)
    velocity = free + impulse / mass
    position = position + model.time_step * velocity
    return position, velocity


def mjx_substep(model: RobotModel, touch: Touch, motion: Motion, targets: Float[Array, "3"]) -> Motion:
    """One physics step by MJX; arguments as of ``twin_substep``."""
    ground = functools.partial(ground_impulse, model, touch, motion)
    inertia = diagonal(model)
    servo = _servo(model)
    return mjx_advance(model, inertia, servo, motion, targets, ground)


def ground_impulse(model: RobotModel, touch: Touch, motion: Motion, free: Float[Array, "3"]) -> Float[Array, "3"]:
    """Generalised impulse (3,) [N s, N s, N m s] of the ground, besides the servos', and of all contacts.

    Args:
        free: rates at the end of the physics step, of the servos alone.
    """
    position, velocity = motion
    # From the middle of the last step to that of this one the body turns its velocity along.
    turn_rates = velocity[2] + free[2]
    turned = 0.5 * model.time_step * turn_rates
    cosine = jnp.cos(turned)
    sine = jnp.sin(turned)
    free_vx = free[0]
    free_vy = free[1]
    vx, vy = rotate(free_vx, free_vy, cosine, sine)

    # Friction limits the change of the velocity; contacts act after it.
    limit = model.friction * GRAVITY * model.time_step
    old_vx = velocity[0]
    old_vy = velocity[1]
    dx, dy = clip_length(vx - old_vx, vy - old_vy, limit)
    vx, vy = touch(position, old_vx + dx, old_vy + dy)
    impulse_x = model.mass * (vx - free_vx)
    impulse_y = model.mass * (vy - free_vy)
    no_turn = jnp.zeros_like(vx)
    return jnp.stack([impulse_x, impulse_y, no_turn])


def diagonal(model: RobotModel) -> Float[Array, "3"]:
    """The diagonal of the mass matrix: kg, kg, kg m2."""
    return jnp.stack([model.mass, model.mass, model.inertia])


def _servo(model: RobotModel) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Gain and maximum force of the servos: ahead, to the left, about the vertical."""
    lateral = model.lateral
    assert isinstance(lateral, Lateral)
    gain = jnp.stack([model.servo_gain, model.servo_gain, lateral.turn_gain])
    max_force = jnp.stack([model.servo_torque, model.servo_torque, lateral.turn_torque])
    return gain, max_force

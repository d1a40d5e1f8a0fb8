"""The closed-form twin of the MJX robot (Fig. 3): the same equations of motion written out, for gradients and speed.

The mass matrix of a planar base with its centre of mass above the middle of the axle is diagonal and constant, and no
velocity-dependent forces remain, so that one physics step fits on a screen.
"""

import jax.numpy as jnp

from sean_jax.base import Array, RobotModel
from sean_jax.robots.ground import Surroundings, impulse


def substep(model: RobotModel, around: Surroundings, time_left: Array, body: tuple, targets: Array) -> tuple:
    """``body`` = (positions (5,) m and rad, velocities (5,)) one physics step later.

    ``targets`` (2,) rad/s are the wheel speeds that the servos work towards; ``time_left`` () s runs from the start of
    the physics step to the end of the control step. Semi-implicit Euler.
    """
    position, velocity = body
    torque = jnp.clip(model.servo_gain * (targets - velocity[3:]), -model.servo_torque, model.servo_torque)
    free = jnp.concatenate([velocity[:3], velocity[3:] + model.time_step * torque / model.wheel_inertia])
    velocity = free + impulse(model, around, time_left, body, free) / diagonal(model)
    return position + model.time_step * velocity, velocity


def diagonal(model: RobotModel) -> Array:
    """Mass matrix (5,): kg, kg, kg m2, kg m2, kg m2."""
    return jnp.stack([model.mass, model.mass, model.inertia, model.wheel_inertia, model.wheel_inertia])

"""The closed-form twin of the MJX robot (Fig. 3): the same equations of motion in closed form, for gradients and speed.

A planar base whose centre of mass lies above the middle of the axle has a diagonal, constant mass matrix and no forces
that depend on the velocity.
"""

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, RobotModel
from sean_jax.robots.ground import Motion, Surroundings, impulse


def substep(
    model: RobotModel,
    surroundings: Surroundings,
    time_left: Float[Array, ""],
    motion: Motion,
    targets: Float[Array, "2"],
) -> Motion:
    """One physics step by semi-implicit Euler.

    Args:
        time_left: s, from the start of this physics step to the end of the control step.
        motion: generalised coordinates (5,) and their rates (5,).
        targets: (2,) rad/s, the wheel speeds that the servos aim at.
    """
    position, velocity = motion
    torque = jnp.clip(model.servo_gain * (targets - velocity[3:]), -model.servo_torque, model.servo_torque)
    free = jnp.concatenate([velocity[:3], velocity[3:] + model.time_step * torque / model.wheel_inertia])
    velocity = free + impulse(model, surroundings, time_left, motion, free) / diagonal(model)
    return position + model.time_step * velocity, velocity


def diagonal(model: RobotModel) -> Float[Array, "5"]:
    """The diagonal of the mass matrix.

    Returns:
        (5,) kg, kg, kg m2, kg m2, kg m2.
    """
    return jnp.stack([model.mass, model.mass, model.inertia, model.wheel_inertia, model.wheel_inertia])

"""The MJX robot (Fig. 3): MuJoCo XLA computes mass matrix, bias and servo forces, the ground acts as an applied force.

Only the stages of ``mjx.step`` that a base without constraints needs are called: no collision, no solver (whose loop
reverse mode refuses), no sensors, and no factorization, since loading has checked that the mass matrix is diagonal.
"""

import contextlib
import functools
import io
from typing import Any

import jax
import jax.numpy as jnp

from sean_jax.base import Array, RobotModel
from sean_jax.robots.ground import Surroundings, impulse
from sean_jax.robots.twin import diagonal


@functools.cache
def mjx() -> Any:
    """The module ``mujoco.mjx``, imported when it is first needed: that takes a second, and prints about Warp."""
    with contextlib.redirect_stdout(io.StringIO()):
        import mujoco.mjx as module
    return module


def put(model: Any, built: Array) -> tuple:
    """What ``RobotModel.data`` holds: the MJX model of a ``mujoco.MjModel``, and its mass matrix (5,) as built."""
    return mjx().put_model(model, impl="jax"), built


def substep(model: RobotModel, around: Surroundings, time_left: Array, body: tuple, targets: Array) -> tuple:
    """``body`` = (qpos (5,), qvel (5,)) one physics step later; arguments as in ``twin.substep``."""
    # MJX mixes ranks and dtypes on purpose; a caller may have forbidden that for its own code.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        physics = _parametrized(model)
        data = mjx().make_data(physics, impl="jax").replace(qpos=body[0], qvel=body[1], ctrl=targets)
        for stage in ("kinematics", "com_pos", "crb", "transmission", "fwd_velocity", "fwd_actuation"):
            data = getattr(mjx(), stage)(physics, data)
        mass = jnp.diagonal(mjx().full_m(physics, data))
        free = (data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias) / mass
        ground = impulse(model, around, time_left, body, data.qvel + model.time_step * free)
        data = data.replace(qacc=free + ground / (model.time_step * mass))
        data = mjx().euler(physics, data)
        return data.qpos, data.qvel


def _parametrized(model: RobotModel) -> Any:
    """The MJX model with the parameters of the robot model, which may have been replaced since it was loaded.

    An armature is an inertia that is added to one joint: the way to change a mass matrix without its geometry.
    """
    physics, built = model.data
    gain, torque = model.servo_gain, model.servo_torque
    return physics.replace(
        dof_armature=physics.dof_armature + (diagonal(model) - built),
        actuator_gainprm=physics.actuator_gainprm.at[:, 0].set(gain),
        actuator_biasprm=physics.actuator_biasprm.at[:, 2].set(-gain),
        actuator_forcerange=jnp.broadcast_to(jnp.stack([-torque, torque]), physics.actuator_forcerange.shape),
    )

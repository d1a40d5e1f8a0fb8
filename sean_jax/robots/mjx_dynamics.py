"""The MJX robot (Fig. 3): MuJoCo XLA computes mass matrix, bias and servo forces; the ground acts as an applied force.

Only those stages of ``mjx.step`` run that a base without constraints needs: no collision, no solver (reverse mode
refuses its loop), no sensors, and no factorization, because loading has checked that the mass matrix is diagonal.
"""

import contextlib
import functools
import io
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, RobotModel
from sean_jax.robots.dynamics import Motion, Surroundings, diagonal, impulse


@functools.cache
def mjx() -> ModuleType:
    """The module ``mujoco.mjx``. It is imported here because that takes a second and prints a message about Warp."""
    with contextlib.redirect_stdout(io.StringIO()):
        import mujoco.mjx as module
    return module


def put(model: Any, mass: Float[Array, "5"]) -> tuple:
    """``RobotModel.data`` of the MJX robot of a ``mujoco.MjModel``."""
    return mjx().put_model(model, impl="jax"), mass


def substep(
    model: RobotModel,
    surroundings: Surroundings,
    time_left: Float[Array, ""],
    motion: Motion,
    targets: Float[Array, "2"],
) -> Motion:
    """One physics step by MJX; arguments as of ``dynamics.twin_substep``."""
    # MJX mixes ranks and dtypes on purpose; a caller may have forbidden that for its own code.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        physics = _parametrized(model)
        data = mjx().make_data(physics, impl="jax").replace(qpos=motion[0], qvel=motion[1], ctrl=targets)
        for stage in ("kinematics", "com_pos", "crb", "transmission", "fwd_velocity", "fwd_actuation"):
            data = getattr(mjx(), stage)(physics, data)
        mass = jnp.diagonal(mjx().full_m(physics, data))
        free = (data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias) / mass
        ground = impulse(model, surroundings, time_left, motion, data.qvel + model.time_step * free)
        data = data.replace(qacc=free + ground / (model.time_step * mass))
        data = mjx().euler(physics, data)
        return data.qpos, data.qvel


def _parametrized(model: RobotModel) -> Any:
    """The MJX model with the parameters of the robot model, which may differ from those of its file.

    An armature is an inertia added to one joint. It changes the mass matrix without changing the geometry.
    """
    physics, mass = model.data
    gain, torque = model.servo_gain, model.servo_torque
    return physics.replace(
        dof_armature=physics.dof_armature + (diagonal(model) - mass),
        actuator_gainprm=physics.actuator_gainprm.at[:, 0].set(gain),
        actuator_biasprm=physics.actuator_biasprm.at[:, 2].set(-gain),
        actuator_forcerange=jnp.broadcast_to(jnp.stack([-torque, torque]), physics.actuator_forcerange.shape),
    )

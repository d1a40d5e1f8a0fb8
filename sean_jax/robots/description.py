"""Reads a robot (Fig. 3) from its MJCF file: masses, wheels, servos and limits, checked against the dynamics."""

from importlib import import_module
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from sean_jax import quantities, scenery
from sean_jax.base import Mount, Solids
from sean_jax.files import FileError, mjcf

RANGES = {  # least, greatest and unit of a figure: wider than any robot that moves among people
    "max_speed": (0.01, 30.0, "m/s"),
    "max_reverse_speed": (0.001, 30.0, "m/s"),
    "max_turn_rate": (0.01, 100.0, "rad/s"),
    "max_acceleration": (0.01, 1e3, "m/s2"),
    "max_deceleration": (0.01, 1e3, "m/s2"),
    "max_turn_acceleration": (0.01, 1e4, "rad/s2"),
    "command_timeout": (1e-3, 3600.0, "s"),
    "radius": (0.01, 10.0, "m"),
    "friction": (0.01, 10.0, ""),
    "mass": (0.01, 1e5, "kg"),
    "inertia": (1e-6, 1e6, "kg m2"),
    "wheel_radius": (1e-3, 5.0, "m"),
    "wheel_inertia": (1e-8, 1e4, "kg m2"),
    "track": (0.01, 10.0, "m"),
    "servo_gain": (1e-6, 1e6, "N m s/rad"),
    "servo_torque": (1e-6, 1e6, "N m"),
}
FARTHEST_MOUNT = 100.0  # m
LIMITS = ("max_speed", "max_turn_rate", "max_acceleration", "max_turn_acceleration", "command_timeout")
NUMERICS = (*LIMITS, "radius", "friction")
OPTIONAL = ("max_reverse_speed", "max_deceleration")  # those ahead hold backward as well where these are absent
BUILD = (
    "a base with the joints slide x, slide y and hinge z, then a left and a right wheel hinge with a velocity servo "
    "each, without springs, damping and friction losses in the joints"
)


def read(path: Path) -> tuple[Any, dict[str, Any], np.ndarray]:
    """The ``mujoco.MjModel`` of a file, the figures of a ``RobotModel`` by field name, and its mass matrix (5,).

    Raises ValueError, one sentence that names the file, for a file that is no MJCF, lacks a figure, or describes
    another kind of robot than a planar differential-drive base.
    """
    mujoco: Any = import_module("mujoco")  # late, for it takes time; Any, for it has no type stubs
    model = mjcf.read(path)
    disable = mujoco.mjtDisableBit
    for unused in (disable.mjDSBL_CONSTRAINT, disable.mjDSBL_SPRING, disable.mjDSBL_DAMPER, disable.mjDSBL_EULERDAMP):
        model.opt.disableflags |= int(unused)
    numerics = _numerics(path, model)
    _check_build(path, model)
    mass = _mass_matrix(path, model)
    left, right = model.body_pos[2], model.body_pos[3]
    wheel = int(np.flatnonzero(model.geom_bodyid == 2)[0])
    figures = {
        "mass": mass[0],
        "inertia": mass[2],
        "wheel_radius": model.geom_size[wheel, 0],
        "wheel_inertia": mass[3],
        "track": left[1] - right[1],
        "servo_gain": model.actuator_gainprm[0, 0],
        "servo_torque": model.actuator_forcerange[0, 1],
        **{key: value for key, value in numerics.items() if key != "radius"},
    }
    for key, value in figures.items():
        _within(path, f"its {key.replace('_', ' ')}", value, *RANGES[key])
    _within(path, "the timestep of its <option>", model.opt.timestep, *quantities.STEPS, "s")
    fields = {key: jnp.asarray(value, jnp.result_type(float)) for key, value in figures.items()}
    seen = {"mounts": mounts(model), "solids": _solids(model)}
    for mount in seen["mounts"]:
        far = max(map(abs, mount.origin))
        _within(path, f"the greatest coordinate of its mount '{mount.name}'", far, 0.0, FARTHEST_MOUNT, "m")
    return model, {**fields, **seen, "radius": numerics["radius"], "time_step": float(model.opt.timestep)}, mass


def mounts(model: Any) -> tuple[Mount, ...]:
    """The cameras and sites of a robot's ``mujoco.MjModel``, all of which must sit on its base."""
    found = []
    for number in range(model.ncam):
        axes = np.zeros(9)
        import_module("mujoco").mju_quat2Mat(axes, model.cam_quat[number])
        place = tuple(map(float, model.cam_pos[number]))
        found.append(Mount(model.camera(number).name, place, tuple(map(float, axes)), float(model.cam_fovy[number])))
    upright = tuple(map(float, np.eye(3).ravel()))
    for number in range(model.nsite):
        found.append(Mount(model.site(number).name, tuple(map(float, model.site_pos[number])), upright, 0.0))
    return tuple(found)


def _solids(model: Any) -> Solids:
    mujoco: Any = import_module("mujoco")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return scenery.solids(model, data, list(range(model.ngeom)))


def _numerics(path: Path, model: Any) -> dict[str, float]:
    there = {model.numeric(i).name: model.numeric_data[model.numeric_adr[i]] for i in range(model.nnumeric)}
    told = (*NUMERICS, *(key for key in OPTIONAL if key in there))
    for key in told:
        if key not in there:
            raise ValueError(f'{path}: <custom> lacks <numeric name="{key}" data="..."/>, which every robot needs')
        _within(path, f"the numeric {key}", there[key], *RANGES[key])
    return {key: float(there[key]) for key in told}


def _within(path: Path, what: str, value: float, least: float, most: float, unit: str) -> None:
    if not least <= value <= most:
        raise FileError(f"{path}: {what} is {value:g}, but must be from {least:g} to {most:g}{unit and ' ' + unit}.")


def _check_build(path: Path, model: Any) -> None:
    """The joints, bodies and servos that the equations of motion are written for."""
    axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 1, 0]]
    fits = (
        (model.nbody, model.njnt, model.nu) == (4, 5, 2)
        and model.jnt_type.tolist() == [2, 2, 3, 3, 3]
        and model.jnt_bodyid.tolist() == [1, 1, 1, 2, 3]
        and np.allclose(model.jnt_axis, axes)
        and model.actuator_trnid[:, 0].tolist() == [3, 4]
        and np.allclose(model.actuator_gear[:, 0], 1.0)
        and np.allclose(model.actuator_biasprm[:, :3], np.outer(model.actuator_gainprm[:, 0], [0.0, 0.0, -1.0]))
        and bool(model.actuator_forcelimited.all())
        and np.allclose(model.actuator_forcerange[0], model.actuator_forcerange[1] * [[1.0, 1.0]])
        and np.isclose(model.actuator_forcerange[0].sum(), 0.0)
        and np.isclose(model.body_pos[2, 1], -model.body_pos[3, 1])
        and model.body_pos[2, 1] > 0.0
        and bool((model.geom_bodyid == 2).any())
        and not (model.dof_damping.any() or model.jnt_stiffness.any() or model.dof_frictionloss.any())
    )
    if not fits:
        raise ValueError(f"{path}: a robot must be {BUILD} (see envs/robots/kuri.xml)")


def _mass_matrix(path: Path, model: Any) -> np.ndarray:
    """Diagonal (5,) of the mass matrix, which has to be diagonal and the same everywhere."""
    mujoco: Any = import_module("mujoco")
    data = mujoco.MjData(model)
    matrices = []
    for position in (np.zeros(5), np.array([1.0, -2.0, 0.7, 1.9, -0.4])):
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        matrix = np.zeros((5, 5))
        for i, axis in enumerate(np.eye(5)):
            mujoco.mj_mulM(model, data, matrix[i], axis)
        matrices.append(matrix)
    diagonal = np.diag(matrices[0]).copy()
    scale = np.sqrt(np.outer(diagonal, diagonal))
    if max(np.max(np.abs(matrix - np.diag(diagonal)) / scale) for matrix in matrices) > 1e-6:
        raise ValueError(f"{path}: the centre of mass must lie above the middle of the axle, the origin of the base")
    if not np.isclose(diagonal[3], diagonal[4]):
        raise ValueError(f"{path}: the left and the right wheel must have the same inertia, armature included")
    return diagonal

"""Robots read from MJCF files (Fig. 3): masses, wheels, servos and limits, checked against the dynamics."""

from importlib import import_module
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from sean_jax import environment, quantities
from sean_jax.base import Mount, Solids
from sean_jax.errors import FileError
from sean_jax.files import mjcf
from sean_jax.robots import build

RANGES = {  # minimum, maximum and unit of each figure: wider than those of any robot that moves among people
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
MAX_MOUNT = 100.0  # m
LIMITS = ("max_speed", "max_turn_rate", "max_acceleration", "max_turn_acceleration", "command_timeout")
NUMERICS = (*LIMITS, "radius", "friction")
OPTIONAL = ("max_reverse_speed", "max_deceleration")  # without them, the forward limits apply backward too


def read(path: Path) -> tuple[Any, dict[str, Any], np.ndarray]:
    """Read a robot.

    Returns:
        ``mujoco.MjModel``; fields of ``RobotModel`` by name; and (5,) the diagonal of the mass matrix.

    Raises:
        FileError: the file is no MJCF, lacks a figure, or does not describe a planar differential-drive base.
    """
    mujoco: Any = import_module("mujoco")  # late, for it takes time; Any, for it has no type stubs
    model = mjcf.read(path)
    disable = mujoco.mjtDisableBit
    for unused in (disable.mjDSBL_CONSTRAINT, disable.mjDSBL_SPRING, disable.mjDSBL_DAMPER, disable.mjDSBL_EULERDAMP):
        model.opt.disableflags |= int(unused)
    data = mujoco.MjData(model)
    for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
        stage(model, data)
    numerics = _numerics(path, model)
    for key, value in numerics.items():
        _check_range(path, f"the numeric {key}", value, *RANGES[key])
    faults, problems = build.faults(model, data, numerics.get("radius", np.inf)), _missing(numerics)
    if faults:
        problems.append(f"a robot must be {build.BUILD}, but {', '.join(faults)} (see envs/robots/kuri.xml)")
    if problems:
        raise FileError(f"{path}: {'; '.join(problems)}.")
    _check_mounts(path, model)
    mass = _mass_matrix(path, model)
    left, right = (build.to_base(model, data, data.xanchor[joint]) for joint in (3, 4))
    figures = {
        "mass": mass[0],
        "inertia": mass[2],
        "wheel_radius": model.geom_size[build.wheel_geoms(model)[0], 0],
        "wheel_inertia": mass[3],
        "track": left[1] - right[1],
        "servo_gain": model.actuator_gainprm[0, 0],
        "servo_torque": model.actuator_forcerange[0, 1],
        **{key: value for key, value in numerics.items() if key != "radius"},
    }
    for key, value in figures.items():
        _check_range(path, f"its {key.replace('_', ' ')}", value, *RANGES[key])
    _check_range(path, "the timestep of its <option>", model.opt.timestep, *quantities.TIME_STEP_RANGE, "s")
    fields = {key: jnp.asarray(value, jnp.result_type(float)) for key, value in figures.items()}
    seen = {"mounts": mounts(model, data), "solids": _solids(model, data)}
    for mount in seen["mounts"]:
        far = max(map(abs, mount.origin))
        _check_range(path, f"the largest coordinate of its mount '{mount.name}'", far, 0.0, MAX_MOUNT, "m")
    return model, {**fields, **seen, "radius": numerics["radius"], "time_step": float(model.opt.timestep)}, mass


def mounts(model: Any, data: Any) -> tuple[Mount, ...]:
    """The cameras and sites of a robot.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with their poses.
    """
    result, frame = [], build.base_rotation(model, data)
    places = [
        *((model.camera(k).name, data.cam_xpos[k], data.cam_xmat[k], model.cam_fovy[k]) for k in range(model.ncam)),
        *((model.site(k).name, data.site_xpos[k], data.site_xmat[k], 0.0) for k in range(model.nsite)),
    ]
    for name, place, axes, fovy in places:
        origin = build.to_base(model, data, place)
        axes = np.round(frame.T @ axes.reshape(3, 3), 12) + 0.0  # so that level axes are level to the bit
        result.append(Mount(name, tuple(origin.tolist()), tuple(axes.ravel().tolist()), float(fovy)))
    return tuple(result)


def _check_mounts(path: Path, model: Any) -> None:
    """Refuse sensors on a wheel or in the world, which do not move with the base, and cameras that see nothing."""
    base = model.jnt_bodyid[0]
    sensors = [("camera", model.camera(k).name, model.cam_bodyid[k]) for k in range(model.ncam)]
    sensors += [("site", model.site(k).name, model.site_bodyid[k]) for k in range(model.nsite)]
    loose = [f"{kind} '{name}'" for kind, name, body in sensors if model.body_weldid[body] != base]
    if loose:
        raise FileError(f"{path}: {' and '.join(loose)} must be on the base, not on a wheel or in the world.")
    for k in range(model.ncam):
        if not 0.0 < model.cam_fovy[k] < 180.0:
            what = f"the fovy of camera '{model.camera(k).name}' is {model.cam_fovy[k]:g}"
            raise FileError(f"{path}: {what}, but must be more than 0 and less than 180 degrees.")


def _solids(model: Any, data: Any) -> Solids:
    frame = build.base_rotation(model, data)
    data.geom_xpos[:] = build.to_base(model, data, data.geom_xpos)
    data.geom_xmat[:] = (frame.T @ data.geom_xmat.reshape(-1, 3, 3)).reshape(-1, 9)
    return environment.solids_from_mjcf(model, data, list(range(model.ngeom)))


def _numerics(path: Path, model: Any) -> dict[str, float]:
    """The numerics of the file that a robot uses, one number each."""
    numerics = {model.numeric(i).name: model.numeric(i).data for i in range(model.nnumeric)}
    numerics = {key: numerics[key] for key in (*NUMERICS, *OPTIONAL) if key in numerics}
    for key, data in numerics.items():
        if len(data) != 1:
            given = " ".join(f"{value:g}" for value in data[:9])
            raise FileError(f'{path}: the numeric {key} is "{given}", {len(data)} numbers; give one.')
    return {key: float(data[0]) for key, data in numerics.items()}


def _missing(numerics: dict[str, float]) -> list[str]:
    """A clause that names all missing figures, if there are any."""
    missing = [f'<numeric name="{key}" data="..."/>' for key in NUMERICS if key not in numerics]
    return [f"<custom> lacks {' and '.join(missing)}, which every robot needs"] if missing else []


def _check_range(path: Path, what: str, value: float, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:
        raise FileError(f"{path}: {what} is {value:g}, but must be from {low:g} to {high:g}{unit and ' ' + unit}.")


def _mass_matrix(path: Path, model: Any) -> np.ndarray:
    """The diagonal (5,) of the mass matrix, which must be diagonal and independent of the pose."""
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
        raise FileError(f"{path}: the centre of mass must lie above the middle of the axle, the origin of the base")
    if not np.isclose(diagonal[3], diagonal[4]):
        raise FileError(f"{path}: the left and the right wheel must have the same inertia, armature included")
    return diagonal

"""Robots read from MJCF files (Fig. 3): masses, wheels, servos and limits, checked against the equations of motion."""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from sean_jax import environment, quantities
from sean_jax.base import Mount, Solids
from sean_jax.errors import FileError
from sean_jax.files import mjcf
from sean_jax.raycast.view import SHOULDER

RANGES = {  # minimum, maximum and unit of each number: wider than for any robot among people
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
BUILD = (
    "a base with the joints slide x, slide y and hinge z, then a left and a right wheel hinge with a velocity servo "
    "each, without springs, damping and friction losses in the joints"
)
JOINTS = (("slide", "x"), ("slide", "y"), ("hinge", "z"), ("hinge", "y"), ("hinge", "y"))
AXES = dict(zip("xyz", np.eye(3), strict=True))
UPRIGHT = 1e-6  # maximum deviation of the cosine of the base's tilt from 1
BESIDE = 1e-4  # m, maximum distance of a wheel ahead of the base's hinge
MIN_MASS = 1e-3  # kg, of the base and of a wheel; MuJoCo takes 1e-15
ON_FLOOR = 5e-3  # m, maximum distance of the lowest point of a wheel from the floor


def read(path: Path) -> tuple[Any, dict[str, Any], np.ndarray]:
    """Read a robot.

    Returns:
        ``mujoco.MjModel``; fields of ``RobotModel`` by name; and (5,) the diagonal of the mass matrix.

    Raises:
        FileError: the file is no MJCF, lacks a number, or does not describe a planar differential-drive base.
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
    clauses, problems = faults(model, data, numerics.get("radius", np.inf)), _missing(numerics)
    if clauses:
        problems.append(f"a robot must be {BUILD}, but {', '.join(clauses)} (see envs/robots/kuri.xml)")
    if problems:
        raise FileError(f"{path}: {'; '.join(problems)}.")
    _check_mounts(path, model)
    mass = _mass_matrix(path, model)
    left, right = (to_base(model, data, data.xanchor[joint]) for joint in (3, 4))
    numbers = {
        "mass": mass[0],
        "inertia": mass[2],
        "wheel_radius": model.geom_size[wheel_geoms(model)[0], 0],
        "wheel_inertia": mass[3],
        "track": left[1] - right[1],
        "servo_gain": model.actuator_gainprm[0, 0],
        "servo_torque": model.actuator_forcerange[0, 1],
        **numerics,
    }
    for key, value in numbers.items():
        _check_range(path, f"its {key.replace('_', ' ')}", value, *RANGES[key])
    _check_range(path, "the timestep of its <option>", model.opt.timestep, *quantities.TIME_STEP_RANGE, "s")
    fields = {key: jnp.asarray(value, jnp.result_type(float)) for key, value in numbers.items()}
    sensors = {"mounts": mounts(model, data), "solids": _solids(model, data)}
    for mount in sensors["mounts"]:
        far = float(np.abs(mount.origin).max())
        _check_range(path, f"the largest coordinate of its mount '{mount.name}'", far, 0.0, MAX_MOUNT, "m")
    return model, {**fields, **sensors, "time_step": float(model.opt.timestep)}, mass


def mounts(model: Any, data: Any) -> tuple[Mount, ...]:
    """The cameras and sites of a robot in a ``mujoco.MjModel``, whose ``MjData`` has their poses."""
    result, frame = [], base_rotation(model, data)
    places = [
        *((model.camera(k).name, data.cam_xpos[k], data.cam_xmat[k], model.cam_fovy[k]) for k in range(model.ncam)),
        *((model.site(k).name, data.site_xpos[k], data.site_xmat[k], 0.0) for k in range(model.nsite)),
    ]
    for name, place, axes, fovy in places:
        origin = to_base(model, data, place)
        axes = np.round(frame.T @ axes.reshape(3, 3), 12) + 0.0  # so that level axes are level to the bit
        where = jnp.asarray(origin, jnp.result_type(float))
        result.append(Mount(where, name, tuple(axes.ravel().tolist()), float(fovy), bool(origin[2] < SHOULDER)))
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
    frame = base_rotation(model, data)
    data.geom_xpos[:] = to_base(model, data, data.geom_xpos)
    data.geom_xmat[:] = (frame.T @ data.geom_xmat.reshape(-1, 3, 3)).reshape(-1, 9)
    return environment.solids_from_mjcf(model, data, list(range(model.ngeom)))


def _numerics(path: Path, model: Any) -> dict[str, float]:
    """The numerics of the file that a robot uses, one number each."""
    numerics = {model.numeric(i).name: model.numeric(i).data for i in range(model.nnumeric)}
    numerics = {key: numerics[key] for key in (*NUMERICS, *OPTIONAL) if key in numerics}
    for key, data in numerics.items():
        if len(data) != 1:
            numbers = " ".join(f"{value:g}" for value in data[:9])
            raise FileError(f'{path}: the numeric {key} is "{numbers}", {len(data)} numbers; give one.')
    return {key: float(data[0]) for key, data in numerics.items()}


def _missing(numerics: dict[str, float]) -> list[str]:
    """A clause that names all missing numbers, if there are any."""
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


# --- checks of joints, bodies and servos ---


def faults(model: Any, data: Any, radius: float) -> list[str]:
    """Where a model differs from the equations of motion: clauses that follow "a robot must be ..., but".

    If joints or servos are missing, nothing that depends on them is checked.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with the poses of its bodies.
        radius: m, of the disc that touches people and obstacles.
    """
    problems = [*_joints(model), *_servos(model)]
    return problems or [*_bodies(model, data, radius), *_losses(model)]


def _joints(model: Any) -> Iterator[str]:
    mujoco: Any = import_module("mujoco")  # late, for it takes time; Any, for it has no type stubs
    if model.njnt != len(JOINTS):
        yield f"it has {model.njnt} joints and not {len(JOINTS)}"
        return
    for number, (kind, axis) in enumerate(JOINTS):
        has = mujoco.mjtJoint(int(model.jnt_type[number])).name.removeprefix("mjJNT_").lower()
        if has != kind:
            yield f"joint {_label(model.joint(number), number)} is a {has} and not a {kind}"
        elif not np.allclose(model.jnt_axis[number], AXES[axis]):
            along = " ".join(f"{part:g}" for part in model.jnt_axis[number])
            yield f"the axis of joint {_label(model.joint(number), number)} is ({along}), not {axis}"


def _servos(model: Any) -> Iterator[str]:
    affine = int(import_module("mujoco").mjtBias.mjBIAS_AFFINE)
    if model.nu != 2:
        yield f"it has {model.nu} actuators and not 2"
        return
    if model.actuator_trnid[:, 0].tolist() != [3, 4] or model.actuator_trntype.any():
        yield "its actuators do not drive the left and then the right wheel, the fourth and the fifth joint"
    if not np.allclose(model.actuator_gear[:, 0], 1.0):
        yield "the gear of an actuator is not 1"
    gain = model.actuator_gainprm[:, 0]
    if not np.allclose(model.actuator_biasprm[:, :3], np.outer(gain, [0.0, 0.0, -1.0])) or not np.isclose(*gain):
        yield "its actuators are no velocity servos of one and the same gain kv"
    elif model.actuator_dyntype.any() or model.actuator_gaintype.any() or (model.actuator_biastype != affine).any():
        yield "its actuators are not of the kind that <velocity> makes"
    if model.actuator_ctrllimited.any():
        yield "its actuators have a ctrlrange, which limits are not read from; use the numeric max_speed"
    low, high = model.actuator_forcerange.T
    if not model.actuator_forcelimited.all() or not (np.allclose(low, -high) and np.isclose(*high)):
        yield "its actuators lack one and the same forcerange, as much backward as ahead"


def _bodies(model: Any, data: Any, radius: float) -> Iterator[str]:
    base, *others = model.jnt_bodyid[[0, 3, 4]].tolist()
    if (model.jnt_bodyid[:3] != base).any():
        yield "its first three joints are not all in one body, the base"
        return
    upright = data.xmat[base, 8] >= 1.0 - UPRIGHT
    if not upright:
        yield f"its base is tilted by {np.degrees(np.arccos(min(data.xmat[base, 8], 1.0))):.3g} degrees"
    if len({base, *others}) < 3 or any(model.body_weldid[model.body_parentid[wheel]] != base for wheel in others):
        yield "its wheels are not two bodies on the base"
        return
    for what, body in zip(("base", "left wheel", "right wheel"), (base, *others), strict=True):
        if (mass := float(model.body_mass[model.body_weldid == body].sum())) < MIN_MASS:
            yield f"its {what} has {mass:g} kg, less than {MIN_MASS:g} kg"
    yield from list(_wheels(model)) or _places(model, data, radius)
    left, right = (to_base(model, data, data.xanchor[joint])[:2] for joint in (3, 4))
    if not (left[1] > 0.0 and np.isclose(left[1], -right[1])):
        yield f"its wheels lie {left[1]:g} m and {right[1]:g} m left of the base's hinge, not as far left as right"
    if upright and max(abs(left[0]), abs(right[0])) > BESIDE:
        yield f"its wheels lie {left[0]:g} m and {right[0]:g} m ahead of the base's hinge, not beside it"


def _wheels(model: Any) -> Iterator[str]:
    mujoco: Any = import_module("mujoco")
    round_kinds = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE
    geoms = wheel_geoms(model)
    for side, geom in zip(("left", "right"), geoms, strict=True):
        if geom is None:
            yield f"its {side} wheel has no geom, whose size is the wheel's radius"
        elif model.geom_type[geom] not in map(int, round_kinds):
            kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
            yield f"the first geom of its {side} wheel is a {kind} and not a cylinder or a sphere"
    if None not in geoms and not np.isclose(*model.geom_size[geoms, 0]):
        left, right = model.geom_size[geoms, 0]
        yield f"the radii of its wheels are {left:g} m and {right:g} m, not the same"


def _places(model: Any, data: Any, radius: float) -> Iterator[str]:
    """Where round wheels are not between the base and the floor."""
    for side, joint, geom in zip(("left", "right"), (3, 4), wheel_geoms(model), strict=True):
        axis, offset = data.xaxis[joint], data.geom_xpos[geom] - data.xanchor[joint]
        bottom, away = data.geom_xpos[geom, 2] - model.geom_size[geom, 0], to_base(model, data, data.geom_xpos[geom])
        cylinder = model.geom_type[geom] == int(import_module("mujoco").mjtGeom.mjGEOM_CYLINDER)
        turns = not cylinder or abs(data.geom_xmat[geom].reshape(3, 3)[:, 2] @ axis) >= 1.0 - UPRIGHT
        if not turns or np.linalg.norm(offset - (offset @ axis) * axis) > BESIDE:
            yield f"the first geom of its {side} wheel is not round about its hinge"
        elif abs(bottom) > ON_FLOOR:
            yield f"its {side} wheel begins {bottom:.4g} m above the floor and does not touch it"
        elif (distance := float(np.hypot(*away[:2]))) > radius:
            yield f"its {side} wheel is {distance:.4g} m from the base's hinge, beyond its radius of {radius:g} m"


def wheel_geoms(model: Any) -> list[int | None]:
    """The first geom of the left and of the right wheel, whose size is its radius; None for a wheel without a geom."""
    return [next(iter(np.flatnonzero(model.geom_bodyid == model.jnt_bodyid[joint]).tolist()), None) for joint in (3, 4)]


def _losses(model: Any) -> Iterator[str]:
    for what, number in (("density", model.opt.density), ("viscosity", model.opt.viscosity)):
        if number:
            yield f"its <option> has a {what}"
    if model.body_gravcomp.any():
        yield "one of its bodies has a gravcomp"
    for number in range(model.njnt):
        for what, loss in (("damping", model.dof_damping), ("stiffness", model.jnt_stiffness),
                           ("frictionloss", model.dof_frictionloss)):  # fmt: skip
            if loss[number]:
                yield f"joint {_label(model.joint(number), number)} has a {what}"
        if model.jnt_actfrclimited[number]:
            yield f"joint {_label(model.joint(number), number)} has an actuatorfrcrange"


def to_base(model: Any, data: Any, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) [m] of the world in the robot's frame: x ahead, from the floor below the base's hinge."""
    return (points - data.xanchor[2] * [1.0, 1.0, 0.0]) @ base_rotation(model, data)


def base_rotation(model: Any, data: Any) -> np.ndarray:
    """The rotation matrix (3, 3) from the robot's frame to the world, about the vertical."""
    matrix = data.xmat[model.jnt_bodyid[2]].reshape(3, 3)
    yaw = np.arctan2(matrix[1, 0], matrix[0, 0])
    return np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])


def _label(item: Any, number: int) -> str:
    return f"'{item.name}'" if item.name else f"number {number + 1}"

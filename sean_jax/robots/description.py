"""Robots read from MJCF files (Fig. 3): masses, wheels, servos and limits, checked against the equations of motion."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np

from sean_jax.core import bounds
from sean_jax.core.data_types import Lateral, Mount, Solids, Steering
from sean_jax.core.errors import FileError
from sean_jax.io.files import mjcf
from sean_jax.sensors.raycast.view import SHOULDER
from sean_jax.world import environment

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
    "max_lateral_speed": (0.001, 30.0, "m/s"),
    "max_lateral_acceleration": (0.01, 1e3, "m/s2"),
    "wheelbase": (0.01, 10.0, "m"),
    "max_steering_angle": (0.01, 1.5, "rad"),
    "max_steering_rate": (0.01, 100.0, "rad/s"),
}
MAX_MOUNT = 100.0  # m
LIMITS = ("max_speed", "max_turn_rate", "max_acceleration", "max_turn_acceleration", "command_timeout")
NUMERICS = (*LIMITS, "radius", "friction")
OPTIONAL = ("max_reverse_speed", "max_deceleration")  # without them, the forward limits apply backward too
STEERING_NUMERICS = ("wheelbase", "max_steering_angle", "max_steering_rate")  # of a car


class Build(NamedTuple):
    """The joints, servos and numbers that a robot of one drive must have."""

    text: str  # follows "a robot must be"
    joints: tuple[tuple[str, str], ...]  # kind and axis
    numerics: tuple[str, ...]
    example: str  # name of a file in ``envs/robots``


PLANE = ("slide", "x"), ("slide", "y"), ("hinge", "z")
LOSSLESS = "without springs, damping and friction losses in the joints"
BUILDS = {
    "differential": Build(
        "a base with the joints slide x, slide y and hinge z, then a left and a right wheel hinge with a velocity "
        f"servo each, {LOSSLESS}",
        (*PLANE, ("hinge", "y"), ("hinge", "y")),
        NUMERICS,
        "kuri",
    ),
    "omnidirectional": Build(
        "a base with the joints slide x, slide y and hinge z, and three velocity servos on one site of it, with the "
        f"gears 1 0 0 0 0 0, 0 1 0 0 0 0 and 0 0 0 0 0 1, {LOSSLESS}",
        PLANE,
        (*NUMERICS, "max_lateral_speed", "max_lateral_acceleration"),
        "hsr",
    ),
    "ackermann": Build(
        "a base with the joints slide x, slide y and hinge z, then one hinge for the rear wheels with a velocity "
        f"servo, {LOSSLESS}",
        (*PLANE, ("hinge", "y")),
        ("max_speed", "max_acceleration", "command_timeout", "radius", "friction", *STEERING_NUMERICS),
        "f1tenth",
    ),
}
"""Type of a drive -> its build. The ``<text name="drive">`` of a file names it; without it, it is differential."""
AXES = dict(zip("xyz", np.eye(3), strict=True))
UPRIGHT = 1e-6  # maximum deviation of the cosine of the base's tilt from 1
BESIDE = 1e-4  # m, maximum distance of a wheel ahead of the base's hinge
MIN_MASS = 1e-3  # kg, of the base and of a wheel; MuJoCo takes 1e-15
ON_FLOOR = 5e-3  # m, maximum distance of the lowest point of a wheel from the floor


def read_robot(path: Path) -> tuple[Any, dict[str, Any], np.ndarray]:
    """Read a robot.

    Returns:
        ``mujoco.MjModel``; fields of ``RobotModel`` by name; and the diagonal of the mass matrix.

    Raises:
        FileError: the file is no MJCF, lacks a number, or does not describe a planar base of its drive.
    """
    # Only poses are needed at first; stages that a planar base does not need are off in its physics, too.
    model = mjcf.read(path)
    _disable_unused(model)
    data = mujoco.MjData(model)
    for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
        stage(model, data)

    # A wrong unit, such as mm or degrees, is told here rather than seen as odd motion.
    drive = _drive(path, model)
    numerics = _numerics(path, model, BUILDS[drive])
    for key, value in numerics.items():
        _check_range(path, f"the numeric {key}", value, *RANGES[key])
    _check_build(path, model, data, numerics, drive)
    _check_mounts(path, model)

    # The mass matrix is diagonal and constant, which is checked: its entries are mass and inertia.
    mass = _mass_matrix(path, model)
    numbers = {"mass": mass[0], "inertia": mass[2], **_servo_numbers(model, data, mass, drive), **numerics}
    for key, value in numbers.items():
        _check_range(path, f"its {key.replace('_', ' ')}", value, *RANGES[key])
    _check_range(path, "the timestep of its <option>", model.opt.timestep, *bounds.TIME_STEP_RANGE, "s")

    # All drives share the leaves of ``RobotModel``: what a drive does not have is 0.
    fields: dict[str, Any] = {}
    if drive == "omnidirectional":
        fields["lateral"] = _lateral(model, numbers)
        numbers |= dict.fromkeys(("wheel_radius", "wheel_inertia", "track"), 0.0)
    if drive == "ackermann":
        fields["steering"] = _steering(path, model, data, numbers)
        numbers |= _car_turn_limits(numbers) | {"track": 0.0}
    for key, value in numbers.items():
        if key not in STEERING_NUMERICS:
            fields[key] = _array(value)

    # Sensors read mounts and solids, physics do not.
    fields["mounts"] = mounts(model, data)
    fields["solids"] = solids(model, data)
    fields["time_step"] = float(model.opt.timestep)
    for mount in fields["mounts"]:
        largest = float(np.abs(mount.origin).max())
        _check_range(path, f"the largest coordinate of its mount '{mount.name}'", largest, 0.0, MAX_MOUNT, "m")
    return model, fields, mass


def _disable_unused(model: Any) -> None:
    """Disable the stages of MuJoCo that a base without constraints, springs and losses does not need."""
    bits = mujoco.mjtDisableBit
    for unused in (bits.mjDSBL_CONSTRAINT, bits.mjDSBL_SPRING, bits.mjDSBL_DAMPER, bits.mjDSBL_EULERDAMP):
        model.opt.disableflags |= int(unused)


def _check_build(path: Path, model: Any, data: Any, numerics: dict[str, float], drive: str) -> None:
    """FileError unless joints, servos and numbers are those of the drive's build."""
    build = BUILDS[drive]
    problems = _missing(numerics, build)
    clauses = faults(model, data, numerics.get("radius", np.inf), drive)
    if clauses:
        problems.append(f"a robot must be {build.text}, but {', '.join(clauses)} (see envs/robots/{build.example}.xml)")
    if problems:
        raise FileError(f"{path}: {'; '.join(problems)}.")


def _car_turn_limits(numbers: dict[str, float]) -> dict[str, float]:
    """The greatest turn rate and its change: at the top speed, by the steering."""
    top_speed = numbers["max_speed"]
    wheelbase = numbers["wheelbase"]
    curvature = np.tan(numbers["max_steering_angle"]) / wheelbase
    curvature_rate = numbers["max_steering_rate"] / wheelbase
    return {"max_turn_rate": top_speed * curvature, "max_turn_acceleration": top_speed * curvature_rate}


def _drive(path: Path, model: Any) -> str:
    """The type of the drive, by the text ``drive`` of the file."""
    texts = {}
    for index in range(model.ntext):
        begin = model.text_adr[index]
        size = model.text_size[index]
        text = bytes(model.text_data[begin : begin + size]).rstrip(b"\0").decode()
        texts[mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, index)] = text
    drive = texts.get("drive", "differential")
    if drive not in BUILDS:
        raise FileError(f'{path}: the text drive is "{drive}", but must be one of {", ".join(BUILDS)}.')
    return drive


def _array(value: float) -> Any:
    return jnp.asarray(value, jnp.result_type(float))


def _servo_numbers(model: Any, data: Any, mass: np.ndarray, drive: str) -> dict[str, float]:
    """The numbers of wheels and servos."""
    servo = {"servo_gain": model.actuator_gainprm[0, 0], "servo_torque": model.actuator_forcerange[0, 1]}
    if drive == "omnidirectional":
        return servo
    wheels = {"wheel_radius": model.geom_size[wheel_geoms(model)[0], 0], "wheel_inertia": mass[3], **servo}
    if drive == "differential":
        left, right = (to_base(model, data, data.xanchor[joint]) for joint in (3, 4))
        wheels["track"] = left[1] - right[1]
    return wheels


def _lateral(model: Any, numbers: dict[str, float]) -> Lateral:
    """The numbers of sideways motion, which leave ``numbers``."""
    speed = numbers.pop("max_lateral_speed")
    acceleration = numbers.pop("max_lateral_acceleration")
    turn_gain = model.actuator_gainprm[2, 0]
    turn_torque = model.actuator_forcerange[2, 1]
    return Lateral(*map(_array, (speed, acceleration, turn_gain, turn_torque)))


def _steering(path: Path, model: Any, data: Any, numbers: dict[str, float]) -> Steering:
    rear = -to_base(model, data, data.xanchor[3])[0]
    wheelbase = numbers["wheelbase"]
    if not 0.0 <= rear < wheelbase:
        raise FileError(
            f"{path}: its rear wheels lie {rear:g} m behind the base's hinge, but must be from 0 to less than the "
            f"wheelbase of {wheelbase:g} m."
        )
    max_angle = numbers["max_steering_angle"]
    max_rate = numbers["max_steering_rate"]
    return Steering(*map(_array, (wheelbase, rear, max_angle, max_rate)))


def mounts(model: Any, data: Any) -> tuple[Mount, ...]:
    """The cameras and sites of a robot in a ``mujoco.MjModel``, whose ``MjData`` has their poses.

    The site of servos is no mount, nor is one on a moving part.
    """
    drives_site = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_SITE)
    servo_sites = model.actuator_trnid[drives_site, 0].tolist()
    on_base = model.body_weldid == model.jnt_bodyid[0]
    result = []
    for camera in range(model.ncam):
        if on_base[model.cam_bodyid[camera]]:
            pose = data.cam_xpos[camera], data.cam_xmat[camera]
            result.append(_mount(model, data, model.camera(camera).name, *pose, model.cam_fovy[camera]))
    for site in range(model.nsite):
        if on_base[model.site_bodyid[site]] and site not in servo_sites:
            pose = data.site_xpos[site], data.site_xmat[site]
            result.append(_mount(model, data, model.site(site).name, *pose, 0.0))
    return tuple(result)


def _mount(model: Any, data: Any, name: str, place: np.ndarray, axes: np.ndarray, fovy: float) -> Mount:
    """A mount at a place (3,) [m] of the world, with axes (9,)."""
    origin = to_base(model, data, place)
    frame = base_rotation(model, data)
    axes = np.round(frame.T @ axes.reshape(3, 3), 12) + 0.0  # so that level axes are level to the bit
    array = jnp.asarray(origin, jnp.result_type(float))
    return Mount(array, name, tuple(axes.ravel().tolist()), float(fovy), bool(origin[2] < SHOULDER))


def _check_mounts(path: Path, model: Any) -> None:
    """Refuse sensors on a wheel or in the world, which do not move with the base, and cameras that see nothing."""
    base = model.jnt_bodyid[0]
    loose = []
    for camera in range(model.ncam):
        if model.body_weldid[model.cam_bodyid[camera]] != base:
            loose.append(f"camera '{model.camera(camera).name}'")
    for site in range(model.nsite):
        if model.body_weldid[model.site_bodyid[site]] != base:
            loose.append(f"site '{model.site(site).name}'")
    if loose:
        raise FileError(f"{path}: {' and '.join(loose)} must be on the base, not on a wheel or in the world.")
    for camera, fovy in enumerate(model.cam_fovy):
        if not 0.0 < fovy < 180.0:
            name = model.camera(camera).name
            raise FileError(
                f"{path}: the fovy of camera '{name}' is {fovy:g}, but must be more than 0 and less than 180 degrees."
            )


def solids(model: Any, data: Any) -> Solids:
    """The looks of a robot in a ``mujoco.MjModel``, whose ``MjData`` has the poses of its geoms, without planes."""
    frame = base_rotation(model, data)
    data.geom_xpos[:] = to_base(model, data, data.geom_xpos)
    data.geom_xmat[:] = (frame.T @ data.geom_xmat.reshape(-1, 3, 3)).reshape(-1, 9)
    return environment.solids_from_mjcf(model, data, list(range(model.ngeom)))


def _numerics(path: Path, model: Any, build: Build) -> dict[str, float]:
    """The numerics of the file that a robot uses, one number each."""
    numerics = {model.numeric(i).name: model.numeric(i).data for i in range(model.nnumeric)}
    numerics = {key: numerics[key] for key in (*build.numerics, *OPTIONAL) if key in numerics}
    for key, data in numerics.items():
        if len(data) != 1:
            numbers = " ".join(f"{value:g}" for value in data[:9])
            raise FileError(f'{path}: the numeric {key} is "{numbers}", {len(data)} numbers; give one.')
    return {key: float(data[0]) for key, data in numerics.items()}


def _missing(numerics: dict[str, float], build: Build) -> list[str]:
    """A clause that names all missing numbers, if there are any."""
    missing = [f'<numeric name="{key}" data="..."/>' for key in build.numerics if key not in numerics]
    if missing:
        return [f"<custom> lacks {' and '.join(missing)}, which every robot needs"]
    return []


def _check_range(path: Path, what: str, value: float, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:
        raise FileError(f"{path}: {what} is {value:g}, but must be from {low:g} to {high:g}{unit and ' ' + unit}.")


def _mass_matrix(path: Path, model: Any) -> np.ndarray:
    """The diagonal of the mass matrix, which must be diagonal and independent of the pose."""
    data = mujoco.MjData(model)
    size = model.nv
    matrices = []
    for position in (np.zeros(size), np.array([1.0, -2.0, 0.7, 1.9, -0.4])[:size]):
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        matrix = np.zeros((size, size))
        for row, axis in zip(matrix, np.eye(size), strict=True):
            mujoco.mj_mulM(model, data, row, axis)
        matrices.append(matrix)

    diagonal = np.diag(matrices[0]).copy()
    scale = np.sqrt(np.outer(diagonal, diagonal))
    deviations = [np.max(np.abs(matrix - np.diag(diagonal)) / scale) for matrix in matrices]
    if max(deviations) > 1e-6:
        raise FileError(f"{path}: the centre of mass must lie above the middle of the axle, the origin of the base")
    if size == 5 and not np.isclose(diagonal[3], diagonal[4]):
        raise FileError(f"{path}: the left and the right wheel must have the same inertia, armature included")
    return diagonal


# --- checks of joints, bodies and servos ---


def faults(model: Any, data: Any, radius: float, drive: str = "differential") -> list[str]:
    """Where a model differs from the equations of motion: clauses that follow "a robot must be ..., but".

    If joints or servos are missing, nothing that depends on them is checked.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with the poses of its bodies.
        radius: m, of the disc that touches people and obstacles.
        drive: its type.
    """
    problems = [*_joints(model, drive), *_servos(model, drive)]
    return problems or [*_bodies(model, data, radius), *_losses(model)]


def _joints(model: Any, drive: str) -> Iterator[str]:
    joints = BUILDS[drive].joints
    if model.njnt != len(joints):
        yield f"it has {model.njnt} joints and not {len(joints)}"
        return
    for index, (expected_kind, expected_axis) in enumerate(joints):
        label = _label(model.joint(index), index)
        kind = mujoco.mjtJoint(int(model.jnt_type[index])).name.removeprefix("mjJNT_").lower()
        if kind != expected_kind:
            yield f"joint {label} is a {kind} and not a {expected_kind}"
        elif not np.allclose(model.jnt_axis[index], AXES[expected_axis]):
            axis = " ".join(f"{component:g}" for component in model.jnt_axis[index])
            yield f"the axis of joint {label} is ({axis}), not {expected_axis}"


def _servos(model: Any, drive: str) -> Iterator[str]:
    affine = int(mujoco.mjtBias.mjBIAS_AFFINE)
    count = {"differential": 2, "omnidirectional": 3, "ackermann": 1}[drive]
    if model.nu != count:
        yield f"it has {model.nu} actuators and not {count}"
        return
    yield from _transmission(model, drive)
    gain = model.actuator_gainprm[:, 0]
    one_gain = np.isclose(gain[:2], gain[0]).all()  # the third servo of an omnidirectional base turns it
    is_velocity_servo = np.allclose(model.actuator_biasprm[:, :3], np.outer(gain, [0.0, 0.0, -1.0]))
    if not is_velocity_servo or not one_gain:
        yield "its actuators are no velocity servos of one and the same gain kv"
    elif model.actuator_dyntype.any() or model.actuator_gaintype.any() or (model.actuator_biastype != affine).any():
        yield "its actuators are not of the kind that <velocity> makes"
    if model.actuator_ctrllimited.any():
        yield "its actuators have a ctrlrange, which limits are not read from; use the numeric max_speed"
    low, high = model.actuator_forcerange.T
    one_range = np.allclose(low, -high) and np.isclose(high[:2], high[0]).all()
    if not model.actuator_forcelimited.all() or not one_range:
        yield "its actuators lack one and the same forcerange, as much backward as ahead"


def _transmission(model: Any, drive: str) -> Iterator[str]:
    """Where the servos do not drive what they should."""
    if drive == "omnidirectional":
        on_sites = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_SITE)).all()
        sites = {*model.actuator_trnid[:, 0].tolist()}
        if not on_sites or len(sites) > 1 or (model.actuator_trnid[:, 1] >= 0).any():
            yield "its actuators do not all drive one and the same site"
        elif not np.allclose(model.actuator_gear, np.eye(6)[[0, 1, 5]]):
            yield "the gears of its actuators are not 1 0 0 0 0 0, 0 1 0 0 0 0 and 0 0 0 0 0 1"
        elif not _in_the_middle(model, int(model.actuator_trnid[0, 0])):
            yield "the site of its actuators is not at the base's hinge with the axes of the base"
        return
    joints = [3] if drive == "ackermann" else [3, 4]
    if model.actuator_trnid[:, 0].tolist() != joints or model.actuator_trntype.any():
        if drive == "ackermann":
            yield "its actuators do not drive the rear wheels, the fourth joint"
        else:
            yield "its actuators do not drive the left and then the right wheel, the fourth and the fifth joint"
    if not np.allclose(model.actuator_gear[:, 0], 1.0):
        yield "the gear of an actuator is not 1"


def _in_the_middle(model: Any, site: int) -> bool:
    """Whether a site is on the base above its hinge, with the axes of the base."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    axes = base_rotation(model, data).T @ data.site_xmat[site].reshape(3, 3)
    on_base = model.body_weldid[model.site_bodyid[site]] == model.jnt_bodyid[2]
    above_hinge = np.allclose(data.site_xpos[site, :2], data.xanchor[2, :2], atol=BESIDE)
    return bool(on_base and above_hinge and np.allclose(axes, np.eye(3), atol=UPRIGHT))


def _bodies(model: Any, data: Any, radius: float) -> Iterator[str]:
    base, *wheels = model.jnt_bodyid[[0, *range(3, model.njnt)]].tolist()
    if (model.jnt_bodyid[:3] != base).any():
        yield "its first three joints are not all in one body, the base"
        return
    upright = data.xmat[base, 8] >= 1.0 - UPRIGHT
    if not upright:
        yield f"its base is tilted by {np.degrees(np.arccos(min(data.xmat[base, 8], 1.0))):.3g} degrees"

    names = _wheel_names(model)
    on_base = all(model.body_weldid[model.body_parentid[wheel]] == base for wheel in wheels)
    if len({base, *wheels}) < 1 + len(names) or not on_base:
        yield "its wheels are not two bodies on the base" if len(names) == 2 else "its wheels are no body on the base"
        return
    for name, body in zip(("base", *names), (base, *wheels), strict=True):
        mass = float(model.body_mass[model.body_weldid == body].sum())
        if mass < MIN_MASS:
            yield f"its {name} has {mass:g} kg, less than {MIN_MASS:g} kg"
    yield from list(_wheels(model)) or _places(model, data, radius)
    yield from _hinges(model, data, upright)


def _hinges(model: Any, data: Any, upright: bool) -> Iterator[str]:
    """Where the hinges of wheels are not beside the base's hinge."""
    hinges = [to_base(model, data, data.xanchor[joint])[:2] for joint in range(3, model.njnt)]
    if len(hinges) == 1:
        ((_, left),) = hinges
        if abs(left) > BESIDE:
            yield f"the hinge of its rear wheels lies {left:g} m left of the base's hinge"
    if len(hinges) == 2:
        left, right = hinges
        if not (left[1] > 0.0 and np.isclose(left[1], -right[1])):
            yield f"its wheels lie {left[1]:g} m and {right[1]:g} m left of the base's hinge, not as far left as right"
        if upright and max(abs(left[0]), abs(right[0])) > BESIDE:
            yield f"its wheels lie {left[0]:g} m and {right[0]:g} m ahead of the base's hinge, not beside it"


def _wheels(model: Any) -> Iterator[str]:
    round_kinds = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE
    geoms = wheel_geoms(model)
    for wheel, geom in zip(_wheel_names(model), geoms, strict=True):
        if geom is None:
            yield f"its {wheel} has no geom, whose size is the wheel's radius"
            continue
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        if kind not in round_kinds:
            name = kind.name.removeprefix("mjGEOM_").lower()
            yield f"the first geom of its {wheel} is a {name} and not a cylinder or a sphere"
    if len(geoms) == 2 and None not in geoms:
        left, right = model.geom_size[geoms, 0]
        if not np.isclose(left, right):
            yield f"the radii of its wheels are {left:g} m and {right:g} m, not the same"


def _places(model: Any, data: Any, radius: float) -> Iterator[str]:
    """Where round wheels are not between the base and the floor."""
    for joint, (wheel, geom) in enumerate(zip(_wheel_names(model), wheel_geoms(model), strict=True), start=3):
        place = data.geom_xpos[geom]
        bottom = place[2] - model.geom_size[geom, 0]
        distance = float(np.hypot(*to_base(model, data, place)[:2]))
        if not _is_round_about(model, data, geom, joint):
            yield f"the first geom of its {wheel} is not round about its hinge"
        elif abs(bottom) > ON_FLOOR:
            yield f"its {wheel} begins {bottom:.4g} m above the floor and does not touch it"
        elif distance > radius:
            yield f"its {wheel} is {distance:.4g} m from the base's hinge, beyond its radius of {radius:g} m"


def _is_round_about(model: Any, data: Any, geom: int | None, joint: int) -> bool:
    """Whether a cylinder or a sphere has its middle on the axis of a hinge, and a cylinder also its axis."""
    axis = data.xaxis[joint]
    offset = data.geom_xpos[geom] - data.xanchor[joint]
    is_centered = np.linalg.norm(offset - (offset @ axis) * axis) <= BESIDE
    if model.geom_type[geom] != int(mujoco.mjtGeom.mjGEOM_CYLINDER):
        return bool(is_centered)
    cylinder_axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    return bool(is_centered and abs(cylinder_axis @ axis) >= 1.0 - UPRIGHT)


def wheel_geoms(model: Any) -> list[int | None]:
    """The first geom of the left and of the right wheel, whose size is its radius; None for a wheel without a geom."""
    bodies = model.jnt_bodyid[3:]
    return [next(iter(np.flatnonzero(model.geom_bodyid == body).tolist()), None) for body in bodies]


def _wheel_names(model: Any) -> tuple[str, ...]:
    """Names of the hinges after those of the base, for messages."""
    return {3: (), 4: ("rear wheel",), 5: ("left wheel", "right wheel")}[model.njnt]


def _losses(model: Any) -> Iterator[str]:
    if model.opt.density:
        yield "its <option> has a density"
    if model.opt.viscosity:
        yield "its <option> has a viscosity"
    if model.body_gravcomp.any():
        yield "one of its bodies has a gravcomp"
    for joint in range(model.njnt):
        label = _label(model.joint(joint), joint)
        if model.dof_damping[joint]:
            yield f"joint {label} has a damping"
        if model.jnt_stiffness[joint]:
            yield f"joint {label} has a stiffness"
        if model.dof_frictionloss[joint]:
            yield f"joint {label} has a frictionloss"
        if model.jnt_actfrclimited[joint]:
            yield f"joint {label} has an actuatorfrcrange"


def to_base(model: Any, data: Any, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) [m] of the world in the robot's frame: x ahead, from the floor below the base's hinge."""
    return (points - data.xanchor[_pivot(model)] * [1.0, 1.0, 0.0]) @ base_rotation(model, data)


def base_rotation(model: Any, data: Any) -> np.ndarray:
    """The rotation matrix (3, 3) from the robot's frame to the world, about the vertical."""
    matrix = data.xmat[model.jnt_bodyid[_pivot(model)]].reshape(3, 3)
    yaw = np.arctan2(matrix[1, 0], matrix[0, 0])
    return np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])


def _pivot(model: Any) -> int:
    """The joint that turns the base about the vertical: a freejoint, or the third in the plane."""
    if model.jnt_type[0] == int(mujoco.mjtJoint.mjJNT_FREE):
        return 0
    return 2


def _label(joint: Any, index: int) -> str:
    if joint.name:
        return f"'{joint.name}'"
    return f"number {index + 1}"

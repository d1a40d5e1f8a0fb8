"""Checks of a robot's file (Fig. 3): joints, bodies and servos of a planar differential-drive base."""

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

BUILD = (
    "a base with the joints slide x, slide y and hinge z, then a left and a right wheel hinge with a velocity servo "
    "each, without springs, damping and friction losses in the joints"
)
JOINTS = (("slide", "x"), ("slide", "y"), ("hinge", "z"), ("hinge", "y"), ("hinge", "y"))
AXES = dict(zip("xyz", np.eye(3), strict=True))
UPRIGHT = 1e-6  # how far from 1 the cosine of the base's tilt may be
BESIDE = 1e-4  # m, how far ahead of the base's hinge a wheel may be
MIN_MASS = 1e-3  # kg, of the base and of a wheel; MuJoCo takes 1e-15
ON_FLOOR = 5e-3  # m, how far above or below the floor the lowest point of a wheel may be


def faults(model: Any, data: Any, radius: float) -> list[str]:
    """Find where a model differs from the equations of motion.

    If joints or servos are missing, nothing that depends on them is checked.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with the poses of its bodies.
        radius: m, of the disc that touches people and obstacles.

    Returns:
        Clauses that follow the words "a robot must be ..., but".
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
            yield f"the axis of joint {_label(model.joint(number), number)} is ({along}) and not that of {axis}"


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
    """The geoms whose size is the radius of a wheel.

    Args:
        model: ``mujoco.MjModel``.

    Returns:
        The index of the first geom of the left wheel and of the right wheel; None for a wheel without a geom.
    """
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
    """Transform points of the world to the robot's frame: x ahead, from the floor below the base's hinge.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with the pose of the base.
        points: (..., 3) m.

    Returns:
        (..., 3) m.
    """
    return (points - data.xanchor[2] * [1.0, 1.0, 0.0]) @ base_rotation(model, data)


def base_rotation(model: Any, data: Any) -> np.ndarray:
    """The rotation of the robot's frame in the world, about the vertical.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with the pose of the base.

    Returns:
        (3, 3) matrix from the robot's frame to the world.
    """
    matrix = data.xmat[model.jnt_bodyid[2]].reshape(3, 3)
    yaw = np.arctan2(matrix[1, 0], matrix[0, 0])
    return np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])


def _label(item: Any, number: int) -> str:
    return f"'{item.name}'" if item.name else f"number {number + 1}"

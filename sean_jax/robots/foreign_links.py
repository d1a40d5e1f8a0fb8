"""The links of another project's robot, read from MJCF or URDF, with meshes reduced to boxes, cylinders and spheres.

All poses are in the frame of the robot's root link, at rest: all joints at zero, or where the MJCF file has them.
"""

import dataclasses
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sean_jax.io.files import file_error, mjcf

GRAY = (0.6, 0.62, 0.66)
THIN = 5e-4  # m, minimum half extent of a shape


@dataclasses.dataclass
class Shape:
    """A box, a cylinder along its z, or a sphere."""

    kind: str
    size: np.ndarray  # m: half extents (3,); radius and half length (2,); radius (1,)
    place: np.ndarray  # (3,) m
    turn: np.ndarray  # (3, 3), columns are its axes
    color: tuple[float, ...] = GRAY


@dataclasses.dataclass
class Link:
    """A rigid body, and the joint by which it hangs on its parent."""

    name: str
    parent: int  # index of a link; -1 of the root
    joint: str  # name
    kind: str  # of the joint: fixed, hinge, slide or other
    axis: np.ndarray  # (3,) unit vector
    place: np.ndarray  # (3,) m, of the link's frame, and a point of the axis
    turn: np.ndarray  # (3, 3) of the link's frame
    mass: float = 0.0  # kg
    center: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))  # m, of mass
    inertia: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))  # kg m2, about the center
    shapes: list[Shape] = dataclasses.field(default_factory=list)
    max_rate: float | None = None  # rad/s or m/s
    max_torque: float | None = None  # N m or N
    max_angle: float | None = None  # rad, of a hinge to either side
    driven: bool | None = None  # None: the file does not say


@dataclasses.dataclass
class Body:
    """All of a robot."""

    name: str
    links: list[Link]
    cameras: list[tuple[str, np.ndarray, np.ndarray]]  # name, place [m] and axes of ``data_types.Mount``
    frames: list[tuple[str, np.ndarray, np.ndarray]]  # of links and sites: x ahead, y to the left, z up
    missing: list[str] = dataclasses.field(default_factory=list)  # meshes without a shape


def enclosing(points: np.ndarray, place: np.ndarray, turn: np.ndarray, color: tuple[float, ...] = GRAY) -> Shape:
    """The smallest of a box, three cylinders and a sphere that contain points (n, 3), along the axes of their frame."""
    low, high = points.min(0), points.max(0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, THIN)
    away = points - middle
    candidates = [(8 * np.prod(half), "box", half, np.eye(3))]
    for axis in range(3):
        others = [(axis + 1) % 3, (axis + 2) % 3]
        radius = max(float(np.linalg.norm(away[:, others], axis=1).max()), THIN)
        along = np.eye(3)[:, [*others, axis]]
        size = np.array([radius, half[axis]])
        candidates.append((2 * np.pi * radius**2 * half[axis], "cylinder", size, along))
    radius = max(float(np.linalg.norm(away, axis=1).max()), THIN)
    candidates.append((4 / 3 * np.pi * radius**3, "sphere", np.array([radius]), np.eye(3)))
    _, kind, size, along = min(candidates, key=lambda candidate: candidate[0])
    return Shape(kind, size, place + turn @ middle, turn @ along, color)


def from_mjcf(path: Path) -> Body:
    """The robot of an MJCF file: the body with a freejoint, or with slide joints in the plane and a hinge about z.

    Raises:
        FileError: the file cannot be read, or it has no such body, or several.
    """
    model = mjcf.read(path)
    data = mujoco.MjData(model)
    for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
        stage(model, data)
    roots = [body for body in range(1, model.nbody) if _is_base(model, body)]
    if len(roots) != 1:
        what = "no body has a <freejoint>, or slide joints and a hinge about z" if not roots else (
            f"{len(roots)} bodies have a <freejoint>: {', '.join(repr(model.body(root).name) for root in roots)}"
        )  # fmt: skip
        raise file_error(path, f"{what}; a robot is one body that moves in the plane, with its wheels on it")
    origin, axes = data.xpos[roots[0]], data.xmat[roots[0]].reshape(3, 3)
    if axes[2, 2] < np.cos(np.deg2rad(1.0)):
        name = model.body(roots[0]).name
        raise file_error(path, f"body '{name}' is tilted; give it a pose in which the robot stands upright")
    index, links = {roots[0]: 0}, []
    for body in range(roots[0], model.nbody):
        parent = int(model.body_parentid[body])
        if body != roots[0] and parent not in index:
            continue
        index[body] = len(links)
        links.append(_link(model, data, body, -1 if body == roots[0] else index[parent], origin, axes))
    cameras = [
        (model.camera(k).name, axes.T @ (data.cam_xpos[k] - origin), axes.T @ data.cam_xmat[k].reshape(3, 3))
        for k in range(model.ncam)
        if int(model.cam_bodyid[k]) in index
    ]
    frames = [
        (model.site(k).name, axes.T @ (data.site_xpos[k] - origin), axes.T @ data.site_xmat[k].reshape(3, 3))
        for k in range(model.nsite)
        if int(model.site_bodyid[k]) in index
    ]
    frames += [(link.name, link.place, link.turn) for link in links]
    return Body(path.stem, links, cameras, frames)


def _is_base(model: Any, body: int) -> bool:
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    kinds = [int(model.jnt_type[joint]) for joint in joints]
    slides, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    return kinds == [int(mujoco.mjtJoint.mjJNT_FREE)] or (kinds.count(slides) == 2 and kinds.count(hinge) == 1)


def _link(model: Any, data: Any, body: int, parent: int, origin: np.ndarray, axes: np.ndarray) -> Link:
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "hinge", int(mujoco.mjtJoint.mjJNT_SLIDE): "slide"}
    first, number = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    joint = first if number and parent >= 0 else -1
    own = axes.T @ data.ximat[body].reshape(3, 3)
    link = Link(
        name=model.body(body).name,
        parent=parent,
        joint=model.joint(joint).name if joint >= 0 else "",
        kind="fixed" if joint < 0 else kinds.get(int(model.jnt_type[joint]), "other") if number == 1 else "other",
        axis=axes.T @ data.xaxis[joint] if joint >= 0 else np.array([0.0, 0.0, 1.0]),
        place=axes.T @ ((data.xanchor[joint] if joint >= 0 else data.xpos[body]) - origin),
        turn=axes.T @ data.xmat[body].reshape(3, 3),
        mass=float(model.body_mass[body]),
        center=axes.T @ (data.xipos[body] - origin),
        inertia=own @ np.diag(model.body_inertia[body]) @ own.T,
    )
    geoms = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    solid = [geom for geom in geoms if model.geom_contype[geom] or model.geom_conaffinity[geom]]
    for geom in solid or geoms:
        if (shape := _shape(model, data, geom, origin, axes)) is not None:
            link.shapes.append(shape)
    if joint >= 0:
        _limits(model, joint, link)
    return link


def _shape(model: Any, data: Any, geom: int, origin: np.ndarray, axes: np.ndarray) -> Shape | None:
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    place, turn = axes.T @ (data.geom_xpos[geom] - origin), axes.T @ data.geom_xmat[geom].reshape(3, 3)
    size, material = model.geom_size[geom], model.geom_matid[geom]
    shade = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    color = tuple(shade[:3].tolist())
    if kind == "mesh":
        mesh = int(model.geom_dataid[geom])
        begin = model.mesh_vertadr[mesh]
        return enclosing(np.array(model.mesh_vert[begin : begin + model.mesh_vertnum[mesh]], float), place, turn, color)
    if kind in ("cylinder", "capsule"):
        length = size[1] + (size[0] if kind == "capsule" else 0.0)
        return Shape("cylinder", np.array([size[0], length]), place, turn, color)
    if kind == "ellipsoid":
        return Shape("box", size.copy(), place, turn, color)
    return Shape(kind, size[: {"box": 3, "sphere": 1}[kind]].copy(), place, turn, color) if kind in (
        "box", "sphere") else None  # fmt: skip


def _limits(model: Any, joint: int, link: Link) -> None:
    """The limits of a joint, by its range and its actuators."""
    if model.jnt_limited[joint]:
        link.max_angle = float(np.abs(model.jnt_range[joint]).min())
    on_joint = [
        k
        for k in range(model.nu)
        if int(model.actuator_trntype[k]) == int(mujoco.mjtTrn.mjTRN_JOINT) and int(model.actuator_trnid[k, 0]) == joint
    ]
    link.driven = bool(on_joint) if model.nu else None
    for k in on_joint:
        gain, bias = float(model.actuator_gainprm[k, 0]), model.actuator_biasprm[k]
        gear = abs(float(model.actuator_gear[k, 0])) or 1.0
        control = float(np.abs(model.actuator_ctrlrange[k]).max()) if model.actuator_ctrllimited[k] else None
        if bias[2] < 0.0 and bias[1] == 0.0 and control:  # a velocity servo
            link.max_rate = abs(gain * control / (bias[2] * gear))
        forces = [float(np.abs(model.actuator_forcerange[k]).max())] if model.actuator_forcelimited[k] else []
        forces += [abs(gain * control)] if control and not bias.any() else []  # a motor
        if forces:
            link.max_torque = min(forces) * gear

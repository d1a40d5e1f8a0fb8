"""The links of another project's robot, read from MJCF or URDF, with meshes reduced to boxes, cylinders and spheres.

All poses are in the frame of the robot's root link, at rest: all joints at zero, or where the MJCF file has them.
"""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sean_jax.io.files import file_error, mjcf

GRAY = (0.6, 0.62, 0.66)
THIN = 5e-4  # m, minimum half extent of a shape


@dataclasses.dataclass
class LinkShape:
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
    shapes: list[LinkShape] = dataclasses.field(default_factory=list)
    max_rate: float | None = None  # rad/s or m/s
    max_torque: float | None = None  # N m or N
    max_angle: float | None = None  # rad, of a hinge to either side
    driven: bool | None = None  # None: the file does not say


@dataclasses.dataclass
class ForeignBody:
    """All of a robot."""

    name: str
    links: list[Link]
    cameras: list[tuple[str, np.ndarray, np.ndarray]]  # name, place [m] and axes of ``data_types.Mount``
    frames: list[tuple[str, np.ndarray, np.ndarray]]  # of links and sites: x ahead, y to the left, z up
    missing: list[str] = dataclasses.field(default_factory=list)  # meshes without a shape


def enclosing(points: np.ndarray, place: np.ndarray, turn: np.ndarray, color: tuple[float, ...] = GRAY) -> LinkShape:
    """The smallest of a box, three cylinders and a sphere that contain points (n, 3), along the axes of their frame."""
    low = points.min(0)
    high = points.max(0)
    middle = (low + high) / 2
    half = np.maximum((high - low) / 2, THIN)
    offsets = points - middle

    def radius_of(offsets: np.ndarray) -> float:
        return max(float(np.linalg.norm(offsets, axis=1).max()), THIN)

    # Volume, kind, size and axes of each.
    candidates = [(8 * np.prod(half), "box", half, np.eye(3))]
    for axis in range(3):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        radius = radius_of(offsets[:, across])
        volume = 2 * np.pi * radius**2 * half[axis]
        axes = np.eye(3)[:, [*across, axis]]
        candidates.append((volume, "cylinder", np.array([radius, half[axis]]), axes))
    radius = radius_of(offsets)
    candidates.append((4 / 3 * np.pi * radius**3, "sphere", np.array([radius]), np.eye(3)))

    _, kind, size, axes = min(candidates, key=lambda candidate: candidate[0])
    return LinkShape(kind, size, place + turn @ middle, turn @ axes, color)


class RestPose(NamedTuple):
    """A model at rest, and the frame of its root link."""

    model: Any  # mujoco.MjModel
    data: Any  # mujoco.MjData
    origin: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3), columns

    def place(self, point: np.ndarray) -> np.ndarray:
        """A point [m] of the world in the root link's frame."""
        return self.axes.T @ (point - self.origin)

    def turn(self, rotation: np.ndarray) -> np.ndarray:
        """A rotation (9,) to the world as one to the root link's frame (3, 3)."""
        return self.axes.T @ rotation.reshape(3, 3)


def from_mjcf(path: Path) -> ForeignBody:
    """The robot of an MJCF file: the body with a freejoint, or with slide joints in the plane and a hinge about z.

    Raises:
        FileError: the file cannot be read, or it has no such body, or several.
    """
    # Only poses are read, so these stages will do; mj_forward would also solve contacts.
    model = mjcf.read(path)
    data = mujoco.MjData(model)
    for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
        stage(model, data)

    # All poses are relative to the root, and "ahead" and "up" mean nothing on one that is tilted.
    root = _root_body(path, model)
    pose = RestPose(model, data, data.xpos[root], data.xmat[root].reshape(3, 3))
    if pose.axes[2, 2] < np.cos(np.deg2rad(1.0)):
        name = model.body(root).name
        raise file_error(path, f"body '{name}' is tilted; give it a pose in which the robot stands upright")

    # MuJoCo numbers parents before children, so one pass finds all that hangs on the root.
    index = {root: 0}
    links = []
    for body in range(root, model.nbody):
        parent = int(model.body_parentid[body])
        if body != root and parent not in index:
            continue
        index[body] = len(links)
        links.append(_link(pose, body, -1 if body == root else index[parent]))

    # Cameras and sites of other bodies belong to the scene, not to the robot.
    cameras = []
    frames = []
    for camera in range(model.ncam):
        if int(model.cam_bodyid[camera]) in index:
            place = pose.place(data.cam_xpos[camera])
            axes = pose.turn(data.cam_xmat[camera])
            cameras.append((model.camera(camera).name, place, axes))
    for site in range(model.nsite):
        if int(model.site_bodyid[site]) in index:
            place = pose.place(data.site_xpos[site])
            axes = pose.turn(data.site_xmat[site])
            frames.append((model.site(site).name, place, axes))

    # Links are frames, too: files that were made from URDF mark their sensors by links.
    frames += [(link.name, link.place, link.turn) for link in links]
    return ForeignBody(path.stem, links, cameras, frames)


def _root_body(path: Path, model: Any) -> int:
    """The one body that moves in the plane."""
    roots = [body for body in range(1, model.nbody) if _is_base(model, body)]
    if not roots:
        raise file_error(
            path,
            "no body has a <freejoint>, or slide joints and a hinge about z; a robot is one body that moves in the "
            "plane, with its wheels on it",
        )
    if len(roots) > 1:
        names = ", ".join(repr(model.body(root).name) for root in roots)
        raise file_error(
            path,
            f"{len(roots)} bodies have a <freejoint>: {names}; a robot is one body that moves in the plane, with its "
            "wheels on it",
        )
    return roots[0]


def _is_base(model: Any, body: int) -> bool:
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    kinds = [int(model.jnt_type[joint]) for joint in joints]
    slides = kinds.count(int(mujoco.mjtJoint.mjJNT_SLIDE))
    hinges = kinds.count(int(mujoco.mjtJoint.mjJNT_HINGE))
    return kinds == [int(mujoco.mjtJoint.mjJNT_FREE)] or (slides == 2 and hinges == 1)


def _link(pose: RestPose, body: int, parent: int) -> Link:
    model = pose.model
    data = pose.data
    inertia_axes = pose.turn(data.ximat[body])
    link = Link(
        name=model.body(body).name,
        parent=parent,
        joint="",
        kind="fixed",
        axis=np.array([0.0, 0.0, 1.0]),
        place=pose.place(data.xpos[body]),
        turn=pose.turn(data.xmat[body]),
        mass=float(model.body_mass[body]),
        center=pose.place(data.xipos[body]),
        inertia=inertia_axes @ np.diag(model.body_inertia[body]) @ inertia_axes.T,
    )
    if model.body_jntnum[body] and parent >= 0:
        _add_joint(pose, body, link)

    # Geoms that touch something, or all of them if none does.
    first = model.body_geomadr[body]
    geoms = range(first, first + model.body_geomnum[body])
    touching = [geom for geom in geoms if model.geom_contype[geom] or model.geom_conaffinity[geom]]
    for geom in touching or geoms:
        shape = _shape(pose, geom)
        if shape is not None:
            link.shapes.append(shape)
    return link


def _add_joint(pose: RestPose, body: int, link: Link) -> None:
    """The joint of a link, and its limits; several joints of one body are of no kind."""
    model = pose.model
    data = pose.data
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "hinge", int(mujoco.mjtJoint.mjJNT_SLIDE): "slide"}
    joint = int(model.body_jntadr[body])
    link.joint = model.joint(joint).name
    link.kind = kinds.get(int(model.jnt_type[joint]), "other") if model.body_jntnum[body] == 1 else "other"
    link.axis = pose.axes.T @ data.xaxis[joint]
    link.place = pose.place(data.xanchor[joint])
    _add_limits(model, joint, link)


def _shape(pose: RestPose, geom: int) -> LinkShape | None:
    """The shape of a geom; None for planes and height fields."""
    model = pose.model
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    place = pose.place(pose.data.geom_xpos[geom])
    turn = pose.turn(pose.data.geom_xmat[geom])
    size = model.geom_size[geom]
    material = model.geom_matid[geom]
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    color = tuple(rgba[:3].tolist())
    if kind == "mesh":
        mesh = int(model.geom_dataid[geom])
        begin = model.mesh_vertadr[mesh]
        vertices = np.array(model.mesh_vert[begin : begin + model.mesh_vertnum[mesh]], float)
        return enclosing(vertices, place, turn, color)
    if kind in ("cylinder", "capsule"):
        half_length = size[1] + (size[0] if kind == "capsule" else 0.0)
        return LinkShape("cylinder", np.array([size[0], half_length]), place, turn, color)
    if kind in ("box", "ellipsoid"):
        return LinkShape("box", size.copy(), place, turn, color)
    if kind == "sphere":
        return LinkShape("sphere", size[:1].copy(), place, turn, color)
    return None


def _add_limits(model: Any, joint: int, link: Link) -> None:
    """The limits of a joint, by its range and its actuators."""
    if model.jnt_limited[joint]:
        link.max_angle = float(np.abs(model.jnt_range[joint]).min())
    drives_joints = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    actuators = np.flatnonzero(drives_joints & (model.actuator_trnid[:, 0] == joint)).tolist()
    link.driven = bool(actuators) if model.nu else None
    for actuator in actuators:
        gain = float(model.actuator_gainprm[actuator, 0])
        bias = model.actuator_biasprm[actuator]
        gear = abs(float(model.actuator_gear[actuator, 0])) or 1.0
        max_control = None
        if model.actuator_ctrllimited[actuator]:
            max_control = float(np.abs(model.actuator_ctrlrange[actuator]).max())
        is_velocity_servo = bias[2] < 0.0 and bias[1] == 0.0
        if is_velocity_servo and max_control:
            link.max_rate = abs(gain * max_control / (bias[2] * gear))

        forces = []
        if model.actuator_forcelimited[actuator]:
            forces.append(float(np.abs(model.actuator_forcerange[actuator]).max()))
        if max_control and not bias.any():  # a motor
            forces.append(abs(gain * max_control))
        if forces:
            link.max_torque = min(forces) * gear

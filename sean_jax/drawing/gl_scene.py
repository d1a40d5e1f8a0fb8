"""A scenario as a MuJoCo model for pictures: scenery, people and robot, drawn with OpenGL (section IV-F).

It simulates nothing. Its bodies are those that rays meet, so both kinds of pictures show the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

from sean_jax.base import Scenario, Scenery, Solids, Trajectory
from sean_jax.errors import InputError
from sean_jax.raycast import bodies
from sean_jax.sensors import Camera, pictures

ROBOT_GROUP = 3  # of the robot's geoms, which its own cameras may leave out
ABSENT_HEIGHT = -50.0  # m, at which absent people are placed
SUN_DISTANCE, SHADOW_REACH = 20.0, 12.0  # m, of the sun, and of its shadows around the robot
FACE_RADIUS = 0.08  # m
CURE = "set MUJOCO_GL=egl (Linux without a screen, with the package libegl1) before Python starts, or choose 'rays'"


def check() -> None:
    """Check that MuJoCo can draw here.

    Raises:
        InputError: it cannot, with the cure.
    """
    mujoco: Any = import_module("mujoco")
    _renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16).close()


def images(frames: Trajectory, scenario: Scenario, eye: Camera) -> Iterator[np.ndarray]:
    """Color pictures of frames.

    Args:
        frames: (T, ...) of one episode.

    Returns:
        An iterator of (H, W, 3) uint8 for each frame.
    """
    return _rendered(frames, scenario, eye, False)


def depths(frames: Trajectory, scenario: Scenario, eye: Camera) -> Iterator[np.ndarray]:
    """Depth pictures of frames.

    Args:
        frames: (T, ...) of one episode.

    Yields:
        (H, W) m for each frame, ``eye.far`` where there is nothing nearer.
    """
    for image in _rendered(frames, scenario, eye, True):
        yield np.where(image < eye.far, image, np.float32(eye.far))


def _rendered(frames: Trajectory, scenario: Scenario, eye: Camera, depth: bool) -> Iterator[np.ndarray]:
    mujoco: Any = import_module("mujoco")
    model = _model(mujoco, scenario, eye, frames.people.shape[1])
    data = mujoco.MjData(model)
    options = mujoco.MjvOption()
    options.geomgroup[ROBOT_GROUP] = eye.sees_robot
    renderer = _renderer(model, eye.height, eye.width)
    try:
        if depth:
            renderer.enable_depth_rendering()
        for t in range(len(frames.active)):
            headings = np.concatenate([frames.heading[t][None], frames.people_heading[t]])
            data.mocap_pos[:, :2] = np.concatenate([frames.position[t][None], frames.people[t]])
            data.mocap_pos[1:, 2] = np.where(frames.present[t], 0.0, ABSENT_HEIGHT)
            half = 0.5 * np.arctan2(headings[:, 1], headings[:, 0])
            data.mocap_quat[:] = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], -1)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera="eye", scene_option=options)
            yield renderer.render().copy()
    finally:
        renderer.close()


def _renderer(model: Any, height: int, width: int) -> Any:
    mujoco: Any = import_module("mujoco")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of GLFW, before it fails
            return mujoco.Renderer(model, height, width)
    except Exception as error:  # each OpenGL library fails in its own way
        why = str(error).split("\n")[0].rstrip(".") or type(error).__name__
        raise InputError(f"renderer: MuJoCo cannot draw here ({why}); {CURE}.") from None


def _model(mujoco: Any, scenario: Scenario, eye: Camera, people: int) -> Any:
    looks = scenario.environment.scenery
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = eye.width, eye.height
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [pictures.AMBIENT - 0.15] * 3, [0.1] * 3
    spec.visual.headlight.specular = [0.0] * 3
    x_min, y_min, x_max, y_max = np.asarray(scenario.environment.floor, float)
    spec.stat.extent = 1.0  # m, the unit of what follows
    spec.visual.map.znear, spec.visual.map.zfar = eye.near, float(np.hypot(x_max - x_min, y_max - y_min)) + SUN_DISTANCE
    spec.visual.map.shadowclip, spec.visual.quality.shadowsize = SHADOW_REACH, 4096
    _surroundings(mujoco, spec, looks)
    _solids(mujoco, spec.worldbody, looks.solids, 0)
    robot = spec.worldbody.add_body(mocap=True)
    sun = np.asarray(looks.sun, float)
    light = robot.add_light(
        pos=SUN_DISTANCE * sun, dir=-sun, castshadow=True, diffuse=[pictures.SUN] * 3, specular=[0.0] * 3
    )
    light.type, light.mode = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    _solids(mujoco, robot, scenario.robot.solids, ROBOT_GROUP)
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, np.asarray(eye.axes, float))
    place = robot.add_camera(name="eye", pos=eye.origin, quat=turn, fovy=eye.orthographic or eye.fovy)
    if eye.orthographic:
        if hasattr(place, "proj"):  # MuJoCo 4
            place.proj = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC
        else:
            place.orthographic = True
    shirts = np.stack([np.asarray(part) for part in pictures.shirts(people)], -1)
    for color in shirts:
        _person(mujoco, spec.worldbody.add_body(mocap=True), float(scenario.forces.walking.radius), color)
    return spec.compile()


def _surroundings(mujoco: Any, spec: Any, looks: Scenery) -> None:
    """Sky and floor."""
    kind, built = mujoco.mjtTexture, mujoco.mjtBuiltin
    sky, floor = np.asarray(looks.sky, float), np.asarray(looks.floor, float)
    above, below = built.mjBUILTIN_GRADIENT, built.mjBUILTIN_CHECKER
    spec.add_texture(type=kind.mjTEXTURE_SKYBOX, builtin=above, rgb1=sky[0], rgb2=sky[1], width=64, height=384)
    named = {"name": "floor", "type": kind.mjTEXTURE_2D, "width": 256, "height": 256}
    spec.add_texture(builtin=below, rgb1=floor[0], rgb2=floor[1], **named)
    repeat = 1.0 / float(looks.square)  # MuJoCo lays a texture over 2 m for each, and this one is two squares wide
    material = spec.add_material(name="floor", texuniform=True, texrepeat=[repeat, repeat])
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], material="floor")


def _solids(mujoco: Any, body: Any, solids: Solids, group: int) -> None:
    kind, colors = mujoco.mjtGeom, iter(np.asarray(solids.color, float))
    for row in np.asarray(solids.boxes, float):
        half = 0.5 * np.arctan2(row[7], row[6])
        turn = [np.cos(half), 0, 0, np.sin(half)]
        _add(body, kind.mjGEOM_BOX, row[3:6], row[:3], next(colors), group, turn)
    for row in np.asarray(solids.cylinders, float):
        turn = np.zeros(4)
        mujoco.mju_quatZ2Vec(turn, row[3:6])
        _add(body, kind.mjGEOM_CYLINDER, [row[6], row[7], 0], row[:3], next(colors), group, turn)
    for row in np.asarray(solids.spheres, float):
        _add(body, kind.mjGEOM_SPHERE, [row[3], 0, 0], row[:3], next(colors), group)


def _person(mujoco: Any, body: Any, radius: float, color: np.ndarray) -> None:
    """A person with the outline that rays meet: legs, trunk and head, with the face ahead."""
    kind, sink = mujoco.mjtGeom, bodies.HEAD_RADIUS - FACE_RADIUS + 0.01
    _add(body, kind.mjGEOM_CYLINDER, [radius, pictures.WAIST / 2, 0], [0, 0, pictures.WAIST / 2], pictures.LEGS, 0)
    half = (bodies.SHOULDER - pictures.WAIST) / 2
    _add(body, kind.mjGEOM_CYLINDER, [radius, half, 0], [0, 0, pictures.WAIST + half], color, 0)
    _add(body, kind.mjGEOM_SPHERE, [radius, 0, 0], [0, 0, bodies.SHOULDER], color, 0)
    _add(body, kind.mjGEOM_SPHERE, [bodies.HEAD_RADIUS, 0, 0], [0, 0, bodies.HEAD], pictures.HAIR, 0)
    _add(body, kind.mjGEOM_SPHERE, [FACE_RADIUS, 0, 0], [sink, 0, bodies.HEAD - 0.01], pictures.SKIN, 0)


def _add(body: Any, kind: Any, size: Any, place: Any, color: Any, group: int, turn: Any = (1.0, 0.0, 0.0, 0.0)) -> None:
    body.add_geom(type=kind, size=size, pos=place, quat=turn, rgba=[*color, 1.0], group=group)

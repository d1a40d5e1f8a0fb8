"""The appearance of an MJCF file: its boxes, cylinders and spheres, in the colors of their materials."""

from importlib import import_module
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from sean_jax.base import Obstacles, Scenery, Solids
from sean_jax.platforms import to_device

OBSTACLE = (0.62, 0.64, 0.68)  # color of an obstacle that has none
FLOOR = ((0.78, 0.78, 0.76), (0.74, 0.74, 0.72))
SKY = ((0.55, 0.70, 0.88), (0.92, 0.95, 0.97))
SUN = (0.35, -0.25, 0.9)
SQUARE = 1.0  # m


def plain_scenery(obstacles: Obstacles) -> Scenery:
    """The scenery of obstacles of which nothing but the boxes is known.

    Returns:
        Grey boxes on the default floor, under the default sky.
    """
    number = obstacles.height.shape[0]
    half = jnp.concatenate([obstacles.half_extent, 0.5 * obstacles.height[:, None]], 1)
    middle = jnp.concatenate([obstacles.center, 0.5 * obstacles.height[:, None]], 1)
    turn = jnp.stack([jnp.cos(obstacles.yaw), jnp.sin(obstacles.yaw)], -1)
    color = jnp.broadcast_to(jnp.asarray(OBSTACLE, float), (number, 3))
    return _scenery(_solids(jnp.concatenate([middle, half, turn], 1), np.zeros((0, 8)), np.zeros((0, 4)), color))


def scenery_from_mjcf(model: Any, data: Any, obstacles: list[int]) -> Scenery:
    """The scenery of a MuJoCo model.

    Args:
        model: a ``mujoco.MjModel``.
        data: a ``mujoco.MjData`` with the positions of its geoms.
        obstacles: indices of the geoms that can be touched; they come first.
    """
    rest = [index for index in range(model.ngeom) if index not in set(obstacles)]
    shape = solids_from_mjcf(model, data, [*obstacles, *rest])
    floor, sky = _texture(model, "2d"), _texture(model, "skybox")
    sun = -model.light_dir[0] if model.nlight else np.array(SUN)
    return _scenery(
        shape, FLOOR if floor is None else (floor[0], floor[-1]), SKY if sky is None else (sky[0], sky[-1]), sun
    )


def solids_from_mjcf(model: Any, data: Any, geoms: list[int]) -> Solids:
    """The bodies of geoms of a MuJoCo model.

    A capsule becomes a cylinder of the same extent. Geoms of other kinds and transparent geoms are left out.

    Args:
        model: a ``mujoco.MjModel``.
        data: a ``mujoco.MjData`` with the positions of its geoms.
    """
    kind = import_module("mujoco").mjtGeom
    boxes, cylinders, spheres = [], [], []
    colors: tuple[list, list, list] = [], [], []
    for index in geoms:
        place, size = data.geom_xpos[index], model.geom_size[index]
        turn, shade = data.geom_xmat[index].reshape(3, 3), _color(model, index)
        if shade[3] < 0.5:
            continue
        geom_type = kind(int(model.geom_type[index]))
        if geom_type == kind.mjGEOM_BOX:
            boxes.append([*place, *size, turn[0, 0], turn[1, 0]])
            colors[0].append(shade[:3])
        elif geom_type in (kind.mjGEOM_CYLINDER, kind.mjGEOM_CAPSULE):
            longer = size[0] if geom_type == kind.mjGEOM_CAPSULE else 0.0
            cylinders.append([*place, *turn[:, 2], size[0], size[1] + longer])
            colors[1].append(shade[:3])
        elif geom_type == kind.mjGEOM_SPHERE:
            spheres.append([*place, size[0]])
            colors[2].append(shade[:3])
    return _solids(boxes, cylinders, spheres, [*colors[0], *colors[1], *colors[2]])


def _solids(boxes: ArrayLike, cylinders: ArrayLike, spheres: ArrayLike, color: ArrayLike) -> Solids:
    shapes = (("boxes", boxes, 8), ("cylinders", cylinders, 8), ("spheres", spheres, 4), ("color", color, 3))
    return Solids(**{name: to_device(np.asarray(rows, float).reshape(-1, width)) for name, rows, width in shapes})


def _scenery(shape: Solids, floor: ArrayLike = FLOOR, sky: ArrayLike = SKY, sun: ArrayLike = SUN) -> Scenery:
    towards = np.asarray(sun, float)
    looks = np.asarray(floor), np.asarray(SQUARE), np.asarray(sky)
    return Scenery(shape, *to_device((*looks, towards / np.linalg.norm(towards))))


def _color(model: Any, index: int) -> np.ndarray:
    """(4,) of a geom: its material's, if it has one."""
    material = model.geom_matid[index]
    return model.geom_rgba[index] if material < 0 else model.mat_rgba[material]


def _texture(model: Any, kind: str) -> np.ndarray | None:
    """(n, 3) colors of the first texture of a kind: a floor's darkest and lightest, a sky's from its top down.

    None without one.
    """
    mujoco: Any = import_module("mujoco")
    wanted = {"2d": mujoco.mjtTexture.mjTEXTURE_2D, "skybox": mujoco.mjtTexture.mjTEXTURE_SKYBOX}[kind]
    for index in range(model.ntex):
        if model.tex_type[index] == wanted:
            start, channels = model.tex_adr[index], model.tex_nchannel[index]
            pixels = model.tex_data[start : start + model.tex_height[index] * model.tex_width[index] * channels]
            pixels = pixels.reshape(model.tex_height[index], -1, channels)
            pixels = pixels[:, :, :3] if channels >= 3 else np.repeat(pixels[:, :, :1], 3, axis=-1)  # grey
            if kind == "skybox":
                return pixels[:, pixels.shape[1] // 2] / 255.0
            shades = pixels.reshape(-1, 3)
            light = shades.sum(-1, dtype=np.int32)
            return shades[[light.argmin(), light.argmax()]] / 255
    return None

"""Solids that rays meet, and the distances that C MuJoCo finds."""

from importlib import import_module
from typing import Any

import jax.numpy as jnp
import numpy as np

from sean_jax.core.data_types import Solids
from sean_jax.sensors import raycast
from sean_jax.sensors.raycast.view import HEAD, HEAD_RADIUS, SHOULDER
from sean_jax.world import environment

mujoco: Any = import_module("mujoco")  # Any, for it has no type stubs

RADIUS = 0.2  # m, of people


def mujoco_hits(name, people, origin, directions, radius=RADIUS):
    """(R,) m and (R,) the person who is met, or -1, by C `mj_ray`: people are capsules and balls, the floor endless."""
    spec = mujoco.MjSpec.from_file(str(environment.find(name) / "scene.xml"))
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.size = [0, 0, 0.1]
    below = 1.0  # m, of the capsule under the floor, so that only its upper end is round
    for index, (x, y) in enumerate(people):
        half = (SHOULDER + below) / 2
        capsule, ball = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE
        place = [x, y, SHOULDER - half]
        spec.worldbody.add_geom(name=f"body-{index}", type=capsule, size=[radius, half, 0], pos=place)
        spec.worldbody.add_geom(name=f"head-{index}", type=ball, size=[HEAD_RADIUS, 0, 0], pos=[x, y, HEAD])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found, geom = np.empty(len(directions)), np.empty((len(directions), 1), np.int32)
    for index, way in enumerate(directions):
        found[index] = mujoco.mj_ray(model, data, origin, way, None, 1, -1, geom[index])
    owner = np.full(model.ngeom + 1, -1)  # the last is that of -1, which rays that meet nothing give
    for index in range(len(people)):
        owner[[model.geom(f"body-{index}").id, model.geom(f"head-{index}").id]] = index
    return np.where(found < 0, raycast.MISS, found), owner[geom[:, 0]]


def mujoco_distances(name, people, origin, directions):
    """(R,) m of `mujoco_hits`."""
    return mujoco_hits(name, people, origin, directions)[0]


def yard(boxes=(), cylinders=(), spheres=()):
    """A scenery of rows as ``data_types.Solids`` has them."""
    shapes = (boxes, 8), (cylinders, 8), (spheres, 4), ([[0.5] * 3] * (len(boxes) + len(cylinders) + len(spheres)), 3)
    return Solids(*(jnp.asarray(np.asarray(rows, np.float32).reshape(-1, width)) for rows, width in shapes))


def cluttered(random):
    """A yard with all kinds of bodies, more boxes than bits of a word."""
    turn = random.uniform(0, 6, 40)
    size = random.uniform(0.1, 0.6, (40, 3))
    boxes = np.column_stack([random.uniform(-8, 8, (40, 2)), size[:, 2], size, np.cos(turn), np.sin(turn)])
    axis = random.normal(size=(3, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    cylinders = np.column_stack([random.uniform(-6, 6, (3, 3)), axis, random.uniform(0.1, 0.5, (3, 2))])
    return yard(boxes, cylinders, np.column_stack([random.uniform(-6, 6, (2, 3)), [0.3, 0.5]]))

"""People and walls for the social forces alone, without a scenario: they feel, and walk."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import social_forces
from sean_jax.core.data_types import ObstacleGrid, Obstacles, Pedestrians
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.social_forces import Crowd
from sean_jax.social_forces.model import pair_forces

STEP = 0.05
FLOOR = (-12.0, -12.0, 12.0, 12.0)


def plain() -> social_forces.Forces:
    """Walking and one repulsion, which are compiled soon."""
    whole = social_forces.preset("helbing1995")
    return social_forces.build([whole.walking, whole.repulsion])


def felt(forces, people):
    """x and y (N,): pushes of pair terms and acts of gather terms together."""
    parts = [part for part in pair_forces(around(forces, people)) if part is not None]
    return sum(part[0] for part in parts), sum(part[1] for part in parts)


@jax.jit
def pair_pushes(forces, people):
    """As ``felt``, (N, 2)."""
    return jnp.stack(felt(forces, people), -1)


@functools.partial(jax.jit, static_argnames="steps")
def walk(parameters, people, table=None, groups=None, robot=None, companions=None, steps=1):
    """People after each of so many steps."""

    def one(carry, _):
        after = social_forces.integrate(parameters, carry, table, groups, robot, STEP, 0.16, companions=companions)
        return after, after

    return jax.lax.scan(one, people, length=steps)[1]


def crowd(position, desired, velocity=None, preferred=None, **others) -> Pedestrians:
    """People who look where they want to go, and by default already walk there."""
    position, desired = np.array(position, np.float32), np.array(desired, np.float32)
    speed = np.linalg.norm(desired, axis=1)
    heading = np.where(speed[:, None] > 0, desired / np.where(speed > 0, speed, 1)[:, None], [1.0, 0.0])
    people = Pedestrians(
        position=position,
        velocity=desired if velocity is None else np.array(velocity, np.float32),
        heading=heading.astype(np.float32),
        desired_velocity=desired,
        group=np.full(len(position), -1, np.int32),
        walking_group=np.full(len(position), -1, np.int32),
        present=np.ones(len(position), bool),
        preferred_speed=np.array(speed if preferred is None else preferred, np.float32),
        robot_distance=np.zeros(len(position), np.float32),
    )
    return jax.device_put(replace(people, **others))


def scene(*boxes) -> tuple[ObstacleGrid, tuple[np.ndarray, ...]]:
    """Table and float64 arrays of boxes (center x, y, half extent x, y, yaw in degrees)."""
    rows = np.array(boxes, np.float32)
    center, half, yaw = rows[:, :2], rows[:, 2:4], np.deg2rad(rows[:, 4]).astype(np.float32)
    obstacles = Obstacles(*(jnp.asarray(part) for part in (center, half, yaw, np.ones(len(rows), np.float32))))
    return build_obstacle_grid(obstacles, jnp.asarray(FLOOR)), tuple(part.astype(float) for part in (center, half, yaw))


def around(forces, people, groups=None, robot=None, robot_radius=0.0, companions=None, grid=None) -> Crowd:
    """What terms see of the people, who look along their headings."""
    return Crowd(forces, people, *people.heading.T, grid, groups, robot, robot_radius, companions)

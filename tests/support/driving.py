"""A robot among boxes and people, without a scenario: the little of it and of a state that a drive reads."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core.data_types import Obstacles

BATCH, STEPS = 8, 200
TIME_STEP, PERSON_RADIUS, RADIUS = 0.1, 0.3, 0.16  # s, m, m of Kuri
WALL = (1.5, 0.0, 0.5, 5.0, 0.0)  # its face is x = 1
FAR = (90.0, 90.0, 1.0, 1.0, 0.0)


def obstacles(boxes: Sequence[Sequence[float]], count: int) -> Obstacles:
    """So many boxes (x, y, half extents, yaw), the missing ones far away."""
    rows = np.array([*boxes, *[FAR] * (count - len(boxes))])
    number = jnp.result_type(float)
    parts = rows[:, :2], rows[:, 2:4], rows[:, 4], np.ones(count)
    return Obstacles(*(jnp.asarray(part, number) for part in parts))


def drive(
    model: Any, robot: Any, action: jax.Array, boxes: Obstacles, position: jax.Array, velocity: jax.Array,
    present: jax.Array,
) -> Any:  # fmt: skip
    """The robot after 0.1 s among people (N, 2) of 0.3 m."""
    radius = jnp.asarray(PERSON_RADIUS, position.dtype)
    scenario = SimpleNamespace(
        environment=SimpleNamespace(obstacles=boxes),
        robot=model,
        time_step=TIME_STEP,
        forces=SimpleNamespace(walking=SimpleNamespace(radius=radius)),
    )
    people = SimpleNamespace(position=position, velocity=velocity, present=present)
    return model.drive(scenario, SimpleNamespace(robot=robot, pedestrians=people), action)


def world(boxes=(), people=(), velocity=None):
    """Three boxes (x, y, half extents, yaw) and two people, the missing ones far away and absent."""
    present = np.arange(2) < len(people)
    people = np.array([*people, *[(80.0, 80.0)] * (2 - len(people))])
    number = jnp.result_type(float)
    return SimpleNamespace(
        obstacles=obstacles(boxes, 3),
        people=jnp.asarray(people, number),
        velocity=jnp.zeros((2, 2), number) if velocity is None else jnp.asarray(velocity, number),
        present=jnp.asarray(present),
    )


def leaves(place):
    return place.obstacles, place.people, place.velocity, place.present


def advance(model, place, robot, people, action):
    obstacles, _, velocity, present = place
    return drive(model, robot, action, obstacles, people, velocity, present)


def rollout(model, place, start, actions):
    def one(carry, action):
        robot, people = carry
        people = people + TIME_STEP * place[2]
        robot = advance(model, place, robot, people, action)
        return (robot, people), (robot, people)

    robot = model.place(model, start[:2], jnp.stack([jnp.cos(start[2]), jnp.sin(start[2])]))
    return jax.lax.scan(one, (robot, place[1]), actions)[1]


batched = jax.jit(jax.vmap(rollout, in_axes=(None, None, 0, 0)))  # one compilation a dynamics for nearly all tests


def run(model, actions, place=None, start=(0.0, 0.0, 0.0)):
    """Robot and people after each action (T, 2), of one robot; numpy arrays."""
    actions = np.asarray(actions, np.float32)
    padded = np.concatenate([actions, np.repeat(actions[-1:], STEPS - len(actions), 0)])
    many = jnp.asarray(np.broadcast_to(padded, (BATCH, STEPS, 2)))
    starts = jnp.asarray(np.broadcast_to(np.asarray(start, np.float32), (BATCH, 3)))
    out = batched(model, leaves(place or world()), starts, many)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0, : len(actions)], out)


CLUTTER = world([WALL, (0.0, 1.4, 2.0, 0.3, 0.3), (-1.6, 0.0, 0.4, 3.0, -0.2)], [(0.4, -0.9), (-0.5, -1.2)])

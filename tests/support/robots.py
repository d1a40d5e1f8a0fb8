"""A robot among boxes and people, without a scenario: where it is after each command."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Obstacles

BATCH, STEPS, TIME_STEP = 8, 200, 0.1

FAR = (90.0, 90.0, 1.0, 1.0, 0.0)

WALL = (1.5, 0.0, 0.5, 5.0, 0.0)  # its face is x = 1

PERSON_RADIUS, RADIUS = 0.3, 0.16


def world(boxes=(), people=(), velocity=None):
    """Three boxes (x, y, half extents, yaw) and two people, the missing ones far away and absent."""
    boxes = np.array([*boxes, *[FAR] * (3 - len(boxes))])
    present = np.arange(2) < len(people)
    people = np.array([*people, *[(80.0, 80.0)] * (2 - len(people))])
    number = jnp.result_type(float)
    return SimpleNamespace(
        obstacles=Obstacles(*(jnp.asarray(x, number) for x in (boxes[:, :2], boxes[:, 2:4], boxes[:, 4], np.ones(3)))),
        people=jnp.asarray(people, number),
        velocity=jnp.zeros((2, 2), number) if velocity is None else jnp.asarray(velocity, number),
        present=jnp.asarray(present),
    )


def leaves(place):
    return place.obstacles, place.people, place.velocity, place.present


def advance(model, place, robot, people, action):
    obstacles, _, velocity, present = place
    radius = jnp.asarray(PERSON_RADIUS, velocity.dtype)
    scenario = SimpleNamespace(
        environment=SimpleNamespace(obstacles=obstacles),
        robot=model,
        time_step=TIME_STEP,
        forces=SimpleNamespace(walking=SimpleNamespace(radius=radius)),
    )
    pedestrians = SimpleNamespace(position=people, velocity=velocity, present=present)
    return model.drive(scenario, SimpleNamespace(robot=robot, pedestrians=pedestrians), action)


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

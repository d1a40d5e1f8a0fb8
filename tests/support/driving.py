"""One step of a robot: the little of a scenario and a state that a drive reads."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Obstacles

TIME_STEP, PERSON_RADIUS = 0.1, 0.3  # s, m
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

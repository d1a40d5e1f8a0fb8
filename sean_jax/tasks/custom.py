"""Custom start and goal (section IV-E), the same in every episode."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax import cache
from sean_jax import navigation as paths
from sean_jax.base import Array, Groups, Pedestrians, RobotTask, Scenario
from sean_jax.errors import InputError
from sean_jax.geometry import signed_distances_on_host
from sean_jax.quantities import MAX_COORDINATE, check_number
from sean_jax.tasks.task import build_task


def custom(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from the start to the goal that are given as (x, y) or (x, y, heading in degrees).

    Raises:
        InputError: always; ``poses`` makes the task that takes its place.
    """
    raise InputError("task: 'custom' needs a start and a goal; give start=(x, y) and goal=(x, y) in metres.")


@dataclasses.dataclass(frozen=True)
class Poses:
    """The task ``custom`` with its poses. Equal poses are equal values, so that nothing is traced again."""

    start: tuple[float, float]  # m
    goal: tuple[float, float]  # m
    start_angle: float  # rad
    goal_angle: float  # rad

    def __call__(
        self, scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array
    ) -> RobotTask:
        """The task, the same for every key."""
        return build_task(
            scenario,
            jnp.asarray(self.start, float),
            jnp.asarray(self.goal, float),
            start_heading=_heading(self.start_angle),
            goal_heading=_heading(self.goal_angle),
        )


def poses(scenario: Scenario, start: tuple[float, ...], goal: tuple[float, ...]) -> Poses:
    """The task ``custom`` for ``scenario.task``. Without headings the robot looks from the start to the goal.

    Args:
        start, goal: x and y in metres, and optionally a heading in degrees.

    Raises:
        InputError: one of them is not free, or no path leads from the start to the goal.
    """
    for name, pose in (("start", start), ("goal", goal)):
        if np.ndim(pose) != 1 or len(pose) not in (2, 3):
            raise InputError(f"{name}: {pose} must be x and y in metres, and if you like a heading in degrees.")
        bounds = MAX_COORDINATE, MAX_COORDINATE, 3600.0
        for part, number, limit in zip(("x", "y", "heading"), pose, bounds, strict=False):
            check_number(f"{name}: {part}", number, -limit, limit, "degrees" if part == "heading" else "m")
        room = float(np.min(signed_distances_on_host(scenario.environment, np.array([pose[:2]]))))
        radius = scenario.robot.radius
        if not room >= radius:
            where = f"({pose[0]:g}, {pose[1]:g})"
            lies = "off the floor or inside an obstacle" if room < 0 else f"{room:.2f} m from an obstacle or the edge"
            raise InputError(f"{name}: {where} lies {lies}, where a robot of radius {radius:g} m cannot be; move it.")
    ahead = math.atan2(goal[1] - start[1], goal[0] - start[0])
    angle = [math.radians(pose[2]) if len(pose) == 3 else ahead for pose in (start, goal)]
    task = Poses((float(start[0]), float(start[1])), (float(goal[0]), float(goal[1])), *angle)
    inputs = *paths.inputs(scenario.navigation), task.start, task.goal
    make = lambda: {"walk": np.asarray(jax.jit(task)(scenario, None, None, None, None).geodesic)}  # noqa: E731
    walk = float(cache.load_or_build("walk", ("tasks/custom", "tasks/task", *paths.CODE), inputs, make)["walk"])
    if not math.isfinite(walk):
        raise InputError(f"goal: there is no way from {task.start} to {task.goal} in {scenario.environment.name}.")
    return task


def _heading(angle: float) -> Float[Array, "2"]:
    return jnp.asarray([math.cos(angle), math.sin(angle)], float)

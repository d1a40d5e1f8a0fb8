"""Custom start and goal (section IV-E): the robot goes from a given place to a given place in every episode."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import cache
from sean_jax import navigation as paths
from sean_jax.base import Array, Groups, Pedestrians, RobotTask, Scenario
from sean_jax.geometry import room_on_host
from sean_jax.quantities import FARTHEST, check


def custom(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from the start to the goal that are given as (x, y) or (x, y, heading in degrees)."""
    raise ValueError("task: 'custom' needs a start and a goal; give start=(x, y) and goal=(x, y) in metres.")


@dataclasses.dataclass(frozen=True)
class Poses:
    """The task ``custom`` with its poses: equal ones are equal values, so that nothing is traced again for them."""

    start: tuple[float, float]  # m
    goal: tuple[float, float]  # m
    start_angle: float  # rad
    goal_angle: float  # rad

    def __call__(
        self, scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array
    ) -> RobotTask:
        """The task for ``scenario.task``; the same for every key."""
        start, goal = jnp.asarray(self.start, float), jnp.asarray(self.goal, float)
        to_goal = paths.to_goal(scenario.navigation, goal)
        nobody = jnp.full((), -1, jnp.int32)
        return RobotTask(
            start=start,
            start_heading=_heading(self.start_angle),
            goal=goal,
            goal_heading=_heading(self.goal_angle),
            start_group=nobody,
            goal_group=nobody,
            geodesic=paths.geodesic(scenario.navigation, start, goal, to_goal),
            to_goal=to_goal,
        )


def poses(scenario: Scenario, start: tuple[float, ...], goal: tuple[float, ...]) -> Poses:
    """The task from ``start`` to ``goal``, each (x, y) [m] or (x, y, heading [degrees]).

    Without headings the robot looks from the start to the goal.

    Raises:
        ValueError: one of them is not free, or there is no way between them.
    """
    for name, pose in (("start", start), ("goal", goal)):
        if np.ndim(pose) != 1 or len(pose) not in (2, 3):
            raise ValueError(f"{name}: {pose} must be x and y in metres, and if you like a heading in degrees.")
        for what, number, most in zip(("x", "y", "heading"), pose, (FARTHEST, FARTHEST, 3600.0), strict=False):
            check(f"{name}: {what}", number, -most, most, "degrees" if what == "heading" else "m")
        room = float(np.min(room_on_host(scenario.environment, np.array([pose[:2]]))))
        needed = scenario.robot.radius
        if not room >= needed:
            where = f"({pose[0]:g}, {pose[1]:g})"
            lies = "off the floor or inside an obstacle" if room < 0 else f"{room:.2f} m from an obstacle or the edge"
            raise ValueError(f"{name}: {where} lies {lies}, where a robot of radius {needed:g} m cannot be; move it.")
    ahead = math.atan2(goal[1] - start[1], goal[0] - start[0])
    angle = [math.radians(pose[2]) if len(pose) == 3 else ahead for pose in (start, goal)]
    task = Poses((float(start[0]), float(start[1])), (float(goal[0]), float(goal[1])), *angle)
    inputs = *paths.inputs(scenario.navigation), task.start, task.goal
    make = lambda: {"walk": np.asarray(jax.jit(task)(scenario, None, None, None, None).geodesic)}  # noqa: E731
    walk = float(cache.kept("walk", ("tasks/custom", *paths.CODE), inputs, make)["walk"])
    if not math.isfinite(walk):
        raise ValueError(f"goal: there is no way from {task.start} to {task.goal} in {scenario.environment.name}.")
    return task


def _heading(angle: float) -> Array:
    return jnp.asarray([math.cos(angle), math.sin(angle)], float)

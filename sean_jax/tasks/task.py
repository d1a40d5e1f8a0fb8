"""Robot tasks as values (section IV-E): start, goal and the paths between them; requirements; mixtures of tasks."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PyTree

from sean_jax import robots
from sean_jax.core.bounds import MAX_COORDINATE, check_number
from sean_jax.core.data_types import Array, Groups, PathsToGoal, Pedestrians, RobotTask, Scenario
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host, unit_vectors
from sean_jax.io import cache
from sean_jax.world import navigation as paths

Task = TypeVar("Task", bound=Callable[..., RobotTask])


class Requirement(NamedTuple):
    """The offer of a behavior (``Behavior.offers``) that a task needs, and a check of the scenario."""

    offer: str
    check: Callable[[Scenario], None] | None = None  # raises InputError


def requires(offer: str, check: Callable[[Scenario], None] | None = None) -> Callable[[Task], Task]:
    """A decorator for tasks that do not fit every scenario.

    Args:
        offer: an offer of the behavior, such as "groups".
        check: of a scenario with the task; raises InputError if it does not fit.
    """

    def mark(task: Task) -> Task:
        setattr(task, "requirement", Requirement(offer, check))  # noqa: B010 (functions have no such attribute)
        return task

    return mark


def requirement(task: Callable[..., RobotTask]) -> Requirement | None:
    """The requirement of a task; None if it fits every scenario."""
    return getattr(task, "requirement", None)


def check_requirement(scenario: Scenario) -> None:
    """Refuse a task that does not fit the scenario's behavior or robot.

    Raises:
        InputError: the behavior lacks an offer that the task requires, or the task's own check fails.
    """
    needed = requirement(scenario.task)
    if needed is None:
        return
    behavior = scenario.behavior
    name = scenario.task_name
    if needed.offer not in behavior.offers:
        what = {"groups": "a group", "handcrafted_sets": "handcrafted sets"}.get(needed.offer, needed.offer)
        raise InputError(
            f"task: '{name}' needs {what}, and the {behavior.name} of {scenario.environment.name} has none; "
            "add one or choose another task."
        )
    if needed.check is not None:
        needed.check(scenario)


def build_task(
    scenario: Scenario,
    start: Float[Array, "2"],
    goal: Float[Array, "2"],
    *,
    start_heading: Float[Array, "2"] | None = None,
    goal_heading: Float[Array, "2"] | None = None,
    start_group: Int[Array, ""] | None = None,
    goal_group: Int[Array, ""] | None = None,
    paths_to_goal: PathsToGoal | None = None,
    geodesic: Float[Array, ""] | None = None,
) -> RobotTask:
    """The task to go from a start [m] to a goal [m], with the shortest paths. Works inside jit.

    Args:
        start_heading, goal_heading: unit vectors; from the start to the goal if None.
        start_group, goal_group: index of the group in which the start or goal is a member's place; none if None.
        paths_to_goal: of ``navigation.build_paths_to_goal``; built if None.
        geodesic: m, length of the shortest path; computed if None.
    """
    nobody = jnp.full((), -1, jnp.int32)
    if start_heading is None or goal_heading is None:
        ahead = unit_vectors(goal - start, jnp.asarray([1.0, 0.0], float))
        start_heading = ahead if start_heading is None else start_heading
        goal_heading = ahead if goal_heading is None else goal_heading
    if paths_to_goal is None:
        paths_to_goal = paths.build_paths_to_goal(scenario.navigation, goal)
    if geodesic is None:
        geodesic = paths.geodesic(scenario.navigation, start, goal, paths_to_goal)
    return RobotTask(
        start=start,
        start_heading=start_heading,
        goal=goal,
        goal_heading=goal_heading,
        start_group=nobody if start_group is None else start_group,
        goal_group=nobody if goal_group is None else goal_group,
        geodesic=geodesic,
        paths_to_goal=paths_to_goal,
    )


@dataclasses.dataclass(frozen=True)
class Mixture:
    """A random one of several tasks in each episode, all equally likely (section V-B lets tasks take turns).

    Mixtures of equal tasks are equal, so nothing is compiled again.
    """

    tasks: tuple[Callable[..., RobotTask], ...]

    def __call__(
        self, scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: PyTree, key: Array
    ) -> RobotTask:
        """The task of an episode."""
        choice_key, task_key = jax.random.split(key)
        which = jax.random.randint(choice_key, (), 0, len(self.tasks), jnp.int32)
        return choose(which, [task(scenario, pedestrians, groups, memory, task_key) for task in self.tasks])


def choose(index: Int[Array, ""], tasks: Sequence[RobotTask]) -> RobotTask:
    """The task of that index.

    ``jax.lax.switch`` computes all tasks of a batch as well, and copies the tables of the floor for each row.
    """
    if len(tasks) == 1:
        return tasks[0]
    return jax.tree.map(lambda *cases: jax.lax.select_n(index, *cases), *tasks)


# --- custom start and goal, the same in every episode ---


def custom(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot drives from a start to a goal, (x, y) or (x, y, heading in degrees).

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
        _check_pose(scenario, name, pose)
    ahead = math.atan2(goal[1] - start[1], goal[0] - start[0])
    task = Poses(
        start=(float(start[0]), float(start[1])),
        goal=(float(goal[0]), float(goal[1])),
        start_angle=math.radians(start[2]) if len(start) == 3 else ahead,
        goal_angle=math.radians(goal[2]) if len(goal) == 3 else ahead,
    )

    inputs = *paths.inputs(scenario.navigation), task.start, task.goal
    make = lambda: {"walk": np.asarray(jax.jit(task)(scenario, None, None, None, None).geodesic)}  # noqa: E731
    walk = float(cache.load_or_build("walk", ("tasks/task", *paths.CODE), inputs, make)["walk"])
    if not math.isfinite(walk):
        raise InputError(f"goal: there is no way from {task.start} to {task.goal} in {scenario.environment.name}.")
    return task


def _check_pose(scenario: Scenario, name: str, pose: tuple[float, ...]) -> None:
    """Refuse a pose that is no pose, or where the robot cannot be."""
    if np.ndim(pose) != 1 or len(pose) not in (2, 3):
        raise InputError(f"{name}: {pose} must be x and y in metres, and if you like a heading in degrees.")
    limits = ("x", MAX_COORDINATE, "m"), ("y", MAX_COORDINATE, "m"), ("heading", 3600.0, "degrees")
    for value, (word, limit, unit) in zip(pose, limits, strict=False):
        check_number(f"{name}: {word}", value, -limit, limit, unit)

    room = float(np.min(signed_distances_on_host(scenario.environment, np.array([pose[:2]]))))
    radius = robots.radius(scenario.robot)
    if not room >= radius:
        if room < 0:
            raise InputError(
                f"{name}: ({pose[0]:g}, {pose[1]:g}) lies off the floor or inside an obstacle, where a robot of radius "
                f"{radius:g} m cannot be; move it."
            )
        raise InputError(
            f"{name}: ({pose[0]:g}, {pose[1]:g}) lies {room:.2f} m from an obstacle or the edge, where a robot of "
            f"radius {radius:g} m cannot be; move it."
        )


def _heading(angle: float) -> Float[Array, "2"]:
    return jnp.asarray([math.cos(angle), math.sin(angle)], float)

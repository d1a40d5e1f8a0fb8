"""What every robot task is made of (section IV-E): a start, a goal and the paths between them; and what it needs."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
from jaxtyping import Float, Int

from sean_jax import navigation as paths
from sean_jax.base import Array, PathsToGoal, RobotTask, Scenario
from sean_jax.errors import InputError
from sean_jax.geometry import unit_vectors

Task = TypeVar("Task", bound=Callable[..., RobotTask])


class Requirement(NamedTuple):
    """What a task needs of the behavior (``Behavior.offers``), and of all else if there is a check."""

    offer: str
    check: Callable[[Scenario], None] | None = None  # raises InputError


def requires(offer: str, check: Callable[[Scenario], None] | None = None) -> Callable[[Task], Task]:
    """A decorator for tasks that not every scenario can have.

    Args:
        offer: what the behavior must offer, such as "groups".
        check: of a scenario with the task; raises InputError if it does not fit.

    Returns:
        A function that gives the task back, with its requirement.
    """

    def mark(task: Task) -> Task:
        setattr(task, "requirement", Requirement(offer, check))  # noqa: B010 (functions have no such attribute)
        return task

    return mark


def requirement(task: Callable[..., RobotTask]) -> Requirement | None:
    """What a task needs.

    Args:
        task: any, of the package or of a user.

    Returns:
        None if it fits every scenario.
    """
    return getattr(task, "requirement", None)


def check_requirement(scenario: Scenario) -> None:
    """Refuse a task that does not fit the scenario's behavior or robot.

    Raises:
        InputError: the behavior does not offer what the task needs, or the task's own check fails.
    """
    needed = requirement(scenario.task)
    if needed is None:
        return
    behavior, name = scenario.behavior, scenario.task_name
    if needed.offer not in behavior.offers:
        what = {"groups": "a group", "handcrafted_sets": "handcrafted sets"}.get(needed.offer, needed.offer)
        where = f"the {behavior.name} of {scenario.environment.name} has none"
        raise InputError(f"task: '{name}' needs {what}, and {where}; add one or choose another task.")
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
    """The task to go from a start to a goal, with the shortest paths that belong to it. Works inside jit.

    Args:
        start: (2,) m.
        goal: (2,) m.
        start_heading: (2,) unit vector; from the start to the goal if None.
        goal_heading: (2,) unit vector; from the start to the goal if None.
        start_group: () index of the group of which the start is a member's place; none if None.
        goal_group: () likewise for the goal.
        paths_to_goal: of ``navigation.build_paths_to_goal``; built if None.
        geodesic: () m, length of the shortest path; computed if None.
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

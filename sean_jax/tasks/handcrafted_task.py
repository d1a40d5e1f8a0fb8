"""Handcrafted task (section IV-E): start and goal are poses that the designer of a handcrafted set has chosen."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import cache, files
from sean_jax import navigation as paths
from sean_jax.base import Array, Groups, Pedestrians, RobotTask, Scenario
from sean_jax.geometry import room_on_host, unit_vectors
from sean_jax.handcrafted import Sets


def handcrafted(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from one of the five starts to one of the five goals of the handcrafted set.

    The episode's set is read from ``memory``, that of behavior ``handcrafted``.
    """
    sets: Sets = scenario.behavior.data
    one: Sets = jax.tree.map(lambda leaf: leaf[memory.set], sets)
    drawn = jax.random.categorical(key, jnp.log(one.weight).reshape(-1))
    first, last = drawn // one.weight.shape[1], drawn % one.weight.shape[1]
    start, start_heading = _pose(groups, one.start[first], one.start_heading[first], one.start_group[first])
    goal, goal_heading = _pose(groups, one.goal[last], one.goal_heading[last], one.goal_group[last])
    to_goal = paths.to_goal(scenario.navigation, goal)
    return RobotTask(
        start=start,
        start_heading=start_heading,
        goal=goal,
        goal_heading=goal_heading,
        start_group=one.start_group[first],
        goal_group=one.goal_group[last],
        geodesic=paths.geodesic(scenario.navigation, start, goal, to_goal),
        to_goal=to_goal,
    )


def pair(scenario: Scenario, name: str, start: int, goal: int) -> Scenario:
    """The scenario in which every episode has that handcrafted set, and its start and goal of those numbers, 0 to 4.

    Only a leaf differs, the weight of each set and pair, so that nothing is compiled again and pairs can be vmapped.

    Raises:
        ValueError: the behavior is another, the set is not among those chosen, or there is no such start or goal.
    """
    if scenario.behavior.name != "handcrafted":
        raise ValueError(f"behavior: '{scenario.behavior.name}' has no handcrafted sets; make one with 'handcrafted'.")
    sets: Sets = scenario.behavior.data
    if name not in sets.names:
        raise ValueError(f"name: '{name}' is not one of {', '.join(sets.names)}{files.suggest(name, sets.names)}")
    most = sets.weight.shape[1] - 1
    for word, number in (("start", start), ("goal", goal)):
        if not 0 <= number <= most:
            raise ValueError(f"{word}: {number} must be a whole number from 0 to {most}.")
    weight = jnp.zeros_like(sets.weight).at[sets.names.index(name), start, goal].set(1.0)
    return replace(scenario, behavior=replace(scenario.behavior, data=replace(sets, weight=weight)))


def check_room(scenario: Scenario) -> None:
    """ValueError if the scenario's robot does not fit at a pose of a set, or cannot go from a start to a goal."""
    sets: Sets = scenario.behavior.data
    for word, place in (("starts", sets.start), ("goals", sets.goal)):
        room = np.minimum(*room_on_host(scenario.environment, np.asarray(place).reshape(-1, 2)))
        room = room.reshape(place.shape[:2])
        for number, index in np.argwhere(room < scenario.robot.radius):
            where = f"set '{sets.names[number]}' has {room[number, index]:.2f} m of room at {word}[{index}]"
            raise ValueError(f"robot: {where}, too little for {scenario.robot.name}; choose a smaller robot or a set.")
    ends = scenario.navigation, sets.start, sets.goal
    inputs = *paths.inputs(scenario.navigation), sets.start, sets.goal
    make = lambda: {"walks": np.asarray(jax.jit(jax.vmap(_walks, in_axes=(None, 0, 0)))(*ends))}  # noqa: E731
    walk = cache.kept("walks", ("tasks/handcrafted_task", *paths.CODE), inputs, make)["walks"]
    for number, start, goal in np.argwhere(~np.isfinite(walk)):
        way = f"from starts[{start}] to goals[{goal}] of set '{sets.names[number]}'"
        raise ValueError(f"robot: there is no way {way} for {scenario.robot.name}; choose a smaller robot or a set.")


def _walks(navigation: paths.Navigation, starts: Array, goals: Array) -> Array:
    """(5, 5) lengths [m] of the shortest paths from each start to each goal."""
    rows = jax.vmap(paths.to_goal, in_axes=(None, 0))(navigation, goals)
    each_goal = jax.vmap(paths.geodesic, in_axes=(None, None, 0, 0))
    return jax.vmap(each_goal, in_axes=(None, 0, None, None))(navigation, starts, goals, rows)


def _pose(groups: Groups, place: Array, heading: Array, group: Array) -> tuple[Array, Array]:
    """The pose (2,), (2,) as given, or the open place of the group () and the direction into it."""
    index = jnp.maximum(group, 0)
    opening = groups.opening[index]
    inward = unit_vectors(groups.center[index] - opening, heading)
    return jnp.where(group >= 0, opening, place), jnp.where(group >= 0, inward, heading)

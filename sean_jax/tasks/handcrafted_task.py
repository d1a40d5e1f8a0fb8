"""Handcrafted task (section IV-E): start and goal are poses of a handcrafted set."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax import robots
from sean_jax.core.data_types import Array, Groups, Pedestrians, RobotTask, Scenario
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host, unit_vectors
from sean_jax.io import cache, files
from sean_jax.people.handcrafted import Sets
from sean_jax.tasks.task import build_task, requires
from sean_jax.world import navigation as paths


def check_room(scenario: Scenario) -> None:
    """Refuse a robot that does not fit at a pose of a set, or cannot go from a start to a goal.

    Raises:
        InputError: with the set and the pose.
    """
    sets: Sets = scenario.behavior.data
    _check_clearance(scenario, "starts", sets.start)
    _check_clearance(scenario, "goals", sets.goal)

    inputs = *paths.inputs(scenario.navigation), sets.start, sets.goal

    def build() -> dict[str, np.ndarray]:
        walks = jax.jit(jax.vmap(_walks, in_axes=(None, 0, 0)))
        return {"walks": np.asarray(walks(scenario.navigation, sets.start, sets.goal))}

    walks = cache.load_or_build("walks", ("tasks/handcrafted_task", *paths.CODE), inputs, build)["walks"]
    for number, start, goal in np.argwhere(~np.isfinite(walks)):
        raise InputError(
            f"robot: there is no way from starts[{start}] to goals[{goal}] of set '{sets.names[number]}' for "
            f"{scenario.robot.name}; choose a smaller robot or a set."
        )


def _check_clearance(scenario: Scenario, word: str, places: Float[Array, "sets 5 2"]) -> None:
    """Refuse a robot that does not fit at places of a set; the word is their key in the file."""
    names = scenario.behavior.data.names
    room = np.minimum(*signed_distances_on_host(scenario.environment, np.asarray(places).reshape(-1, 2)))
    room = room.reshape(places.shape[:2])
    for number, index in np.argwhere(room < robots.radius(scenario.robot)):
        raise InputError(
            f"robot: set '{names[number]}' has {room[number, index]:.2f} m of room at {word}[{index}], too little for "
            f"{scenario.robot.name}; choose a smaller robot or a set."
        )


@requires("handcrafted_sets", check_room)
def handcrafted(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from one of the five starts to one of the five goals of the handcrafted set.

    The episode's set is in ``memory`` of behavior ``handcrafted``.
    """
    sets: Sets = scenario.behavior.data
    chosen = sets.one(memory.set)
    drawn = jax.random.categorical(key, jnp.log(chosen.odds).reshape(-1))
    first, last = drawn // chosen.odds.shape[1], drawn % chosen.odds.shape[1]
    start, start_heading = _pose(groups, chosen.start[first], chosen.start_heading[first], chosen.start_group[first])
    goal, goal_heading = _pose(groups, chosen.goal[last], chosen.goal_heading[last], chosen.goal_group[last])
    return build_task(
        scenario,
        start,
        goal,
        start_heading=start_heading,
        goal_heading=goal_heading,
        start_group=chosen.start_group[first],
        goal_group=chosen.goal_group[last],
    )


def pair(scenario: Scenario, name: str, start: int, goal: int) -> Scenario:
    """The scenario in which every episode has one handcrafted set, with its start and goal of these numbers, 0 to 4.

    Only a leaf differs, the odds of each set and pair, so that nothing is compiled again and pairs can be vmapped.

    Raises:
        InputError: the behavior is not ``handcrafted``, or the scenario has no such set, start or goal.
    """
    if scenario.behavior.name != "handcrafted":
        raise InputError(f"behavior: '{scenario.behavior.name}' has no handcrafted sets; make one with 'handcrafted'.")
    sets: Sets = scenario.behavior.data
    if name not in sets.names:
        raise InputError(files.unknown_name("name", name, sets.names))
    limit = sets.odds.shape[1] - 1
    for word, number in (("start", start), ("goal", goal)):
        if not 0 <= number <= limit:
            raise InputError(f"{word}: {number} must be a whole number from 0 to {limit}.")
    odds = jnp.zeros_like(sets.odds).at[sets.names.index(name), start, goal].set(1.0)
    return replace(scenario, behavior=replace(scenario.behavior, data=replace(sets, odds=odds)))


def _walks(
    navigation: paths.Navigation, starts: Float[Array, "5 2"], goals: Float[Array, "5 2"]
) -> Float[Array, "5 5"]:
    """Lengths [m] of the shortest paths from each start [m] to each goal [m]."""
    rows = jax.vmap(paths.build_paths_to_goal, in_axes=(None, 0))(navigation, goals)
    over_goals = jax.vmap(paths.geodesic, in_axes=(None, None, 0, 0))
    return jax.vmap(over_goals, in_axes=(None, 0, None, None))(navigation, starts, goals, rows)


def _pose(
    groups: Groups, place: Float[Array, "2"], heading: Float[Array, "2"], group: Int[Array, ""]
) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """The place and the heading, or the open place of the group and the direction into it."""
    index = jnp.maximum(group, 0)
    opening = groups.opening[index]
    inward = unit_vectors(groups.center[index] - opening, heading)
    return jnp.where(group >= 0, opening, place), jnp.where(group >= 0, inward, heading)

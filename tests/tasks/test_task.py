"""What every robot task is made of: poses and the paths between them, and what a task needs of the behavior."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import tasks
from sean_jax.core.errors import InputError
from sean_jax.people import behaviors
from sean_jax.world import navigation as paths


def test_a_task_of_two_places_has_the_shortest_path_between_them(scenario):
    start, goal = scenario.navigation.places[3], scenario.navigation.places[40]
    task = jax.jit(lambda start, goal: tasks.build_task(scenario, start, goal))(start, goal)
    to_goal = paths.build_paths_to_goal(scenario.navigation, goal)
    np.testing.assert_allclose(task.geodesic, paths.geodesic(scenario.navigation, start, goal, to_goal), rtol=1e-5)
    for one, other in zip(jax.tree.leaves(task.paths_to_goal), jax.tree.leaves(to_goal), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)
    ahead = np.asarray(goal - start) / np.linalg.norm(goal - start)
    np.testing.assert_allclose([task.start_heading, task.goal_heading], [ahead, ahead], atol=1e-5)
    assert int(task.start_group) == int(task.goal_group) == -1
    assert task.geodesic >= np.linalg.norm(goal - start) - 1e-4


def test_what_is_given_stands_in_the_task(scenario):
    start, goal = scenario.navigation.places[3], scenario.navigation.places[40]
    up, two = jnp.asarray([0.0, 1.0], jnp.float32), jnp.int32(2)
    task = tasks.build_task(scenario, start, goal, start_heading=up, goal_group=two)
    np.testing.assert_array_equal(task.start_heading, up)
    assert not np.array_equal(task.goal_heading, up)
    assert int(task.goal_group) == 2 and int(task.start_group) == -1


def test_a_task_says_what_it_needs():
    needed = {
        name: found and found.offer for name, found in ((n, tasks.requirement(t)) for n, t in tasks.TASKS.items())
    }
    assert {name for name, offer in needed.items() if offer == "groups"} == {"join_group", "leave_group"}
    assert {name for name, offer in needed.items() if offer == "handcrafted_sets"} == {"handcrafted"}
    assert set(behaviors.OFFERS) == set(behaviors.BEHAVIORS)


def test_what_a_behavior_does_not_offer_is_refused(scenario):
    tasks.check_requirement(scenario)  # the graph of the warehouse has groups
    without = scenario.replace(behavior=scenario.behavior.replace(offers=()))
    with pytest.raises(InputError, match="^task: 'join_group' needs a group, and the graph of warehouse has none; .*"):
        tasks.check_requirement(without)
    tasks.check_requirement(without.replace(task=tasks.TASKS["random_ab_nav"], task_name="random_ab_nav"))


def test_a_users_task_has_requirements_of_its_own(scenario):
    def refuse(scenario):
        raise InputError("task: 'mine' never fits; choose another.")

    @tasks.requires("trees")
    def among_trees(scenario, pedestrians, groups, memory, key):
        return scenario

    @tasks.requires("groups", refuse)
    def mine(scenario, pedestrians, groups, memory, key):
        return scenario

    with pytest.raises(InputError, match="'among_trees' needs trees, and the graph of warehouse has none"):
        tasks.check_requirement(scenario.replace(task=among_trees, task_name="among_trees"))
    wood = dataclasses.replace(scenario.behavior, offers=("trees",))
    tasks.check_requirement(scenario.replace(task=among_trees, task_name="among_trees", behavior=wood))
    with pytest.raises(InputError, match="'mine' never fits"):
        tasks.check_requirement(scenario.replace(task=mine, task_name="mine"))

"""Tasks between two places (section IV-E): valid for every key; k-means equal to scipy's; poses given by the user."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.cluster.vq import kmeans2

import sean_jax
from sean_jax.simulation.making import with_task
from sean_jax.tasks import TASKS
from sean_jax.tasks.random_tasks import CANDIDATES, CLEAR, DETOUR, RING, SNAP, busiest, far_place, k_means
from sean_jax.world.navigation import draw_places
from support import programs
from support.scenes import box, room

SEEDS = 48


@pytest.fixture(scope="module")
def busy():
    return sean_jax.make(behavior="random", task="busy_ab_nav", people=14, dynamics="twin")


@pytest.fixture(scope="module", params=["random_ab_nav", "busy_ab_nav"])
def drawn(request, busy):
    """Scenario, people and tasks for many keys."""
    scenario = with_task(busy, request.param)

    def one(key):
        people, groups, memory = scenario.behavior.reset(scenario, key)
        return people, scenario.task(scenario, people, groups, memory, jax.random.fold_in(key, 1))

    people, tasks = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), SEEDS))
    return scenario, people, tasks


def test_places_are_free_clear_of_people_and_as_far_apart_as_asked(drawn):
    scenario, people, tasks = drawn
    walk = np.asarray(tasks.geodesic)
    assert (walk >= 4.0).all() and (walk <= 20.0).all()
    for place in (tasks.start, tasks.goal):
        assert np.asarray(programs.clearance(scenario.environment, place)).min() >= scenario.robot.radius
        gap = np.linalg.norm(np.asarray(people.position) - np.asarray(place)[:, None], axis=-1)
        assert gap.min() >= 1.0
    assert (np.asarray(tasks.goal_group) == -1).all() and (np.asarray(tasks.start_group) == -1).all()
    np.testing.assert_allclose(np.linalg.norm(np.asarray(tasks.start_heading), axis=-1), 1.0, rtol=1e-5)
    assert len(np.unique(np.asarray(tasks.start)[:, 0])) > 40


def test_places_are_all_over_or_around_the_largest_cluster(drawn):
    scenario, people, tasks = drawn
    position, ends = np.asarray(people.position), np.stack([np.asarray(tasks.start), np.asarray(tasks.goal)], 1)
    if scenario.task_name == "random_ab_nav":
        floor = np.asarray(scenario.environment.floor)
        share = ((ends.reshape(-1, 2) - floor[:2]) / (floor[2:] - floor[:2])).mean(0)
        np.testing.assert_allclose(share, 0.5, atol=0.12)
        return
    # both ends lie 5 +- 1 m from one and the same person
    off = np.abs(np.linalg.norm(position[:, :, None] - ends[:, None], axis=-1) - RING).max(-1)
    assert (off.min(1) <= SNAP + 1e-3).all()


def test_k_means_equals_scipy():
    random = np.random.default_rng(0)
    run = jax.jit(k_means)
    for _ in range(20):
        points = random.normal(size=(30, 2)) * 3 + random.choice([-6.0, 0.0, 5.0], (30, 1))
        there = random.uniform(size=30) < 0.8
        start = points[there][:3]
        expected, labels = kmeans2(points[there], start, iter=10, minit="matrix")
        centers, mine = run(*(jnp.asarray(x, jnp.float32) for x in (points,)), jnp.asarray(there), jnp.float32(start))
        np.testing.assert_allclose(np.asarray(centers), expected, atol=1e-4)
        assert np.asarray(mine)[there].tolist() == labels.tolist()
        assert (np.asarray(mine)[~there] == -1).all()


def test_an_empty_cluster_keeps_its_centre():
    points = jnp.asarray([[0.0, 0.0], [1.0, 0.0]], jnp.float32)
    start = jnp.asarray([[0.0, 0.0], [1.0, 0.0], [50.0, 0.0]], jnp.float32)
    centers, _ = k_means(points, jnp.ones(2, bool), start)
    np.testing.assert_array_equal(np.asarray(centers), np.asarray(start))


def test_the_busiest_person_is_in_the_middle_of_the_largest_cluster():
    random = np.random.default_rng(1)
    crowd = random.normal(size=(9, 2)) * 0.5 + [4.0, 4.0]
    points = np.concatenate([crowd, random.normal(size=(3, 2)) * 0.3 - [6.0, 0.0], [[9.0, -9.0]]])
    there = np.ones(13, bool)
    total = np.linalg.norm(crowd[:, None] - crowd[None], axis=-1).sum(1)
    found = [
        int(busiest(jnp.asarray(points, jnp.float32), jnp.asarray(there), jax.random.key(seed))) for seed in range(4)
    ]
    assert all(index < 9 for index in found)
    assert total.argmin() in found
    alone = int(busiest(jnp.asarray(points, jnp.float32), jnp.arange(13) == 12, jax.random.key(0)))
    assert alone == 12


@pytest.mark.slow
def test_custom_task_is_the_one_given():
    scenario = sean_jax.make(
        behavior="random", task="custom", people=4, dynamics="twin", start=(0.0, 17.0, 90.0), goal=(0.0, -17.0)
    )
    state = programs.reset(scenario, jax.random.key(0))
    np.testing.assert_allclose(np.asarray(state.robot.position), [0.0, 17.0])
    np.testing.assert_allclose(np.asarray(state.robot.heading), [0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(np.asarray(state.task.goal_heading), [0.0, -1.0], atol=1e-6)
    assert 34.0 <= float(state.task.geodesic) < 60.0
    poses = dict(start=np.array([0.0, 17.0, 90.0]), goal=jnp.array([0.0, -17.0]))
    again = sean_jax.make(behavior="random", task="custom", people=4, dynamics="twin", **poses)
    assert again.task == scenario.task and hash(again.task) == hash(scenario.task)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (dict(behavior="random", task="join_group"), "needs groups, which only behavior 'graph' has"),
        (dict(task="custom"), "needs a start and a goal"),
        (dict(task="custom", start=(0.0, 0.0)), "needs a start and a goal"),
        (dict(task="random_ab_nav", goal=(0.0, 0.0)), "has no such option; choose task 'custom'"),
        (dict(task="custom", start=(0.0, 90.0), goal=(0.0, 17.0)), "start: .0, 90. lies off the floor"),
        (dict(task="custom", start=(0.0, 17.0), goal=(0.0,)), "goal: has 1 numbers; give x and y"),
    ],
)
def test_what_does_not_go_together_is_refused_with_the_reason(arguments, words):
    with pytest.raises(ValueError, match=words):
        sean_jax.make(**arguments, people=4, dynamics="twin")


def test_a_place_in_an_obstacle_or_behind_walls_is_refused(tmp_path):
    room(tmp_path, (0, 0, 8, 6), [box((4, 3), (0.1, 3)), box((6, 3), (0.3, 0.3))])
    common: Any = dict(behavior="random", task="custom", people=1, dynamics="twin", start=(2.0, 3.0))
    with pytest.raises(ValueError, match="goal: .6, 3. lies off the floor or inside an obstacle"):
        sean_jax.make(tmp_path, goal=(6.0, 3.0), **common)
    with pytest.raises(ValueError, match="there is no way from"):
        sean_jax.make(tmp_path, goal=(7.0, 1.0), **common)


def test_custom_is_refused_as_one_of_several_tasks(busy):
    with pytest.raises(ValueError, match="needs a start and a goal"):
        with_task(busy, "custom")
    with pytest.raises(ValueError, match="needs a start and a goal"):
        nothing: Any = None
        TASKS["custom"](busy, nothing, nothing, nothing, nothing)


def test_without_a_longest_distance_all_places_that_can_be_reached_are_drawn(tmp_path):
    """As in SEAN 2.0, near ones and far ones; never one behind walls, whose distance is infinite as well."""
    room(tmp_path, (0, 0, 60, 10), [box((30, 5), (0.1, 5))])
    common: Any = dict(behavior="random", task="random_ab_nav", people=1, dynamics="twin")
    scenario = sean_jax.make(tmp_path, task_distance=(0.0, np.inf), **common)
    places = np.resize(np.float32([[5.0, 5.0], [55.0, 5.0]]), scenario.navigation.places.shape)
    both = scenario.replace(navigation=scenario.navigation.replace(places=jnp.asarray(places)))

    def one(scenario, key):
        people, groups, memory = scenario.behavior.reset(scenario, key)
        return scenario.task(scenario, people, groups, memory, key)

    draw, keys = jax.jit(jax.vmap(one, (None, 0))), jax.random.split(jax.random.key(0), 256)
    with jax.debug_nans(True):
        walk = np.asarray(draw(scenario, keys).geodesic)
        tasks = draw(both, keys)
    assert np.isfinite(walk).all() and walk.min() < 3.0 and walk.max() > 22.0
    np.testing.assert_allclose(tasks.start, tasks.goal)  # the other place is behind the wall


def test_on_a_large_floor_the_place_that_is_least_off_is_taken(tmp_path):
    """Few places are near enough there: of those drawn, the best by a plain computation, and not the farthest."""
    room(tmp_path, (0, 0, 200, 200), people=4)
    common: Any = dict(behavior="random", task="random_ab_nav", people=4, dynamics="twin")
    scenario = sean_jax.make(tmp_path, task_distance=(2.0, 12.0), **common)
    crowd = sean_jax.pedestrians_at(np.random.default_rng(0).uniform(80, 120, (4, 2)), np.zeros((4, 2)))
    middle, keys = jnp.array([100.0, 100.0]), jax.random.split(jax.random.key(3), SEEDS)
    found = jax.jit(jax.vmap(lambda key: far_place(scenario, crowd, middle, key)))(keys)
    places, people, off = np.asarray(scenario.navigation.places), np.asarray(crowd.position), 0
    for key, place in zip(keys, np.asarray(found), strict=True):
        drawn = draw_places(scenario.navigation, jax.random.split(key)[0], CANDIDATES)
        spots = places[np.asarray(drawn)]
        walk = np.linalg.norm(spots - 100.0, axis=1)  # nothing is in the way
        crowded = np.maximum(CLEAR - np.linalg.norm(spots[:, None] - people, axis=-1).min(1), 0.0)
        cost = DETOUR * (np.maximum(2.0 - walk, 0.0) + np.maximum(walk - 12.0, 0.0)) + crowded
        chosen = np.linalg.norm(spots - place, axis=1).argmin()
        assert cost[chosen] <= cost.min() + DETOUR * 0.3, "right to a cell of the navigation"
        off += cost.min() > 0
    assert off > SEEDS // 4

"""Random behavior (section IV-D): uniform starts and goals that can be reached, ways around obstacles, no groups."""

import functools
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.drawing import view
from sean_jax.people.behaviors import random_behavior, starts
from sean_jax.people.behaviors.random_behavior import paths_to_place
from sean_jax.policies import go_to_goal
from sean_jax.world import navigation as paths
from support import programs
from support.scenes import box, room

PEOPLE, STEPS = 12, 500


@pytest.fixture(scope="module")
def random_scenario():
    return sean_jax.make(behavior="random", task="random_ab_nav", people=PEOPLE, dynamics="twin")


@pytest.fixture(scope="module")
def episode(random_scenario):
    """Frames and goals of an episode of 50 s."""

    def record(before, after, action):
        return sean_jax.simulation.scenario.frame(before, after, action), after.memory.goal

    run = jax.jit(lambda key: sean_jax.rollout(random_scenario, go_to_goal, key, STEPS, record))
    last, (frames, goals) = run(jax.random.key(0))
    return last, frames, np.asarray(goals)


@pytest.mark.night
def test_people_walk_around_obstacles_to_their_goals_and_on_to_others(random_scenario, episode):
    last, frames, goals = episode
    people = np.asarray(frames.people)
    changed = goals[1:] != goals[:-1]
    assert changed.sum() >= PEOPLE  # in 50 s everybody arrives about once
    places = np.asarray(random_scenario.behavior.data.navigation.places)
    for step, person in np.argwhere(changed):
        assert np.linalg.norm(people[step, person] - places[goals[step, person]]) < random_behavior.ARRIVED + 0.01
    room = np.asarray(programs.clearance(random_scenario.environment, jnp.asarray(people.reshape(-1, 2))))
    assert room.min() >= 0.2 - 1e-3
    moved = np.linalg.norm(people[200:] - people[:-200], axis=-1)
    assert (moved.max(0) > 3.0).all()  # nobody is stuck for all the time
    assert all(np.isfinite(np.asarray(leaf, float)).all() for leaf in jax.tree.leaves((last.pedestrians, frames)))


@pytest.mark.slow
def test_there_are_no_groups_and_everything_works_without(random_scenario, episode):
    last, frames, _ = episode
    assert (np.asarray(frames.group) == -1).all() and last.groups.radius.shape == (0,)
    names = [name for name, _ in random_scenario.situations]
    group_ones = [names.index("join_group"), names.index("leave_group")]
    assert not np.asarray(frames.situations)[:, group_ones].any()
    assert view(frames, random_scenario).axes


def test_next_points_lead_along_shortest_paths(random_scenario):
    """The cheap look-up of everybody's way gives ways as long as those of the exact one."""
    tables = random_scenario.behavior.data
    navigation = tables.navigation
    spots, goals = navigation.places[:60], jnp.arange(100, 160, dtype=jnp.int32)

    def both(spot, goal):
        place, row = navigation.places[goal], paths_to_place(tables, goal)
        ahead = paths.next_point_approx(navigation, spot, place, row)
        through = jnp.sqrt(((ahead - spot) ** 2).sum()) + paths.geodesic(navigation, ahead, place, row)
        return through, paths.geodesic(navigation, spot, place, row), paths.build_paths_to_goal(navigation, place)

    through, shortest, rows = jax.jit(jax.vmap(both))(spots, goals)
    (length, angle), (kept, kept_angle) = (
        (np.asarray(each.distance), np.asarray(each.departure_angle))
        for each in (rows, jax.vmap(functools.partial(paths_to_place, tables))(goals))
    )
    np.testing.assert_allclose(length, kept, rtol=1e-5, atol=1e-4)
    turned = np.angle(np.exp(1j * (angle - kept_angle).astype(float)))  # angles near zero have no relative error
    np.testing.assert_allclose(turned[np.isfinite(kept)], 0.0, atol=1e-3)
    assert (np.asarray(through) <= np.asarray(shortest) + 0.3).all()
    straight = np.linalg.norm(np.asarray(spots - navigation.places[goals]), axis=-1)
    assert (np.asarray(shortest) > straight + 0.05).sum() >= 10  # many ways do bend


def test_starts_and_goals_are_uniform_and_apart(random_scenario):
    keys = jax.random.split(jax.random.key(3), 64)
    people, _, memory = jax.jit(jax.vmap(lambda key: random_scenario.behavior.reset(random_scenario, key)))(keys)
    position = np.asarray(people.position)
    gap = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1) + 9 * np.eye(PEOPLE)
    assert gap.min() >= starts.MIN_DISTANCE - 1e-5
    places = np.asarray(random_scenario.behavior.data.navigation.places)
    expected = quarters(places, random_scenario)
    for drawn in (position.reshape(-1, 2), places[np.asarray(memory.goal).ravel()]):
        np.testing.assert_allclose(quarters(drawn, random_scenario), expected, atol=0.07)


def quarters(points, scenario):
    """Share of the points in each quarter of the floor."""
    floor = np.asarray(scenario.environment.floor)
    right, upper = (points > (floor[:2] + floor[2:]) / 2).T
    return np.bincount(2 * right + upper, minlength=4) / len(points)


def test_more_people_than_fit_are_refused_with_the_most_that_do(tmp_path):
    room(tmp_path, (0, 0, 6, 5), [box((3, 2.5), (0.5, 0.5))], 4)
    with pytest.raises(ValueError, match="do not fit in room; the most that do is ") as refused:
        sean_jax.make(tmp_path, behavior="random", task="random_ab_nav", people=200, dynamics="twin")
    most = int(str(refused.value).rstrip(".").split()[-1])
    assert 30 < most < 120
    full = sean_jax.make(tmp_path, behavior="random", task="random_ab_nav", people=most, dynamics="twin")
    assert full.people == most
    with pytest.raises(ValueError, match=f"is {most}"):
        sean_jax.make(tmp_path, behavior="random", task="random_ab_nav", people=most + 1, dynamics="twin")


def test_candidates_are_bounded_before_they_are_drawn(monkeypatch):
    """A floor of kilometres and hundreds of the widest discs; what needs fewer is drawn as ever."""
    drawn = []

    def nowhere(_, spots):
        drawn.append(len(spots))
        return np.zeros((2, len(spots)))

    monkeypatch.setattr(starts, "signed_distances_on_host", nowhere)
    monkeypatch.setattr(starts, "_reachable", lambda _, spots: np.zeros(len(spots), bool))
    monkeypatch.setattr(starts.cache, "load_or_build", lambda kind, code, inputs, make: make())
    monkeypatch.setattr(starts, "inputs", lambda _: [])
    navigation: Any = SimpleNamespace(radius=0.25, places=np.zeros((1, 2), np.float32))
    boxes = SimpleNamespace(center=np.zeros((0, 2)), half_extent=np.zeros((0, 2)), yaw=np.zeros(0))
    field: Any = SimpleNamespace(floor=np.array([-2000.0, -2000.0, 2000.0, 2000.0]), obstacles=boxes)
    starts.anywhere(field, navigation, 10)
    starts.in_discs(field, navigation, np.zeros((500, 2)), np.full(500, 100.0), np.ones(500), [])
    starts.in_discs(field, navigation, np.zeros((3, 2)), np.array([1.0, 2.0, 50.0]), np.array([1.0, 0.0, 1.0]), [])
    starts.in_discs(field, navigation, np.zeros((2, 2)), np.array([1.0, 2.0]), np.ones(2), [])
    assert drawn[0] == starts.MAX_TRIES and starts.MAX_TRIES <= drawn[1] <= starts.MAX_TRIES + 500
    assert drawn[2:] == [133 + 330579, 133 + 529]

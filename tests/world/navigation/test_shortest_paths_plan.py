"""The global plan: points of the shortest path, against next points walked step by step and the path's length."""

import jax
import numpy as np
import pytest

from sean_jax.world import navigation


@pytest.fixture(scope="module")
def tables(scenario):
    return scenario.navigation


@jax.jit
def plans(tables, starts, goals):
    def one(start, goal):
        rows = navigation.build_paths_to_goal(tables, goal)
        found = navigation.plan(tables, start, goal, rows, navigation.last_arc_to_goal(tables, goal))
        rest = jax.vmap(lambda point: navigation.geodesic(tables, point, goal, rows))(found)
        return found, navigation.geodesic(tables, start, goal, rows), rest

    return jax.vmap(one)(starts, goals)


def test_points_lie_on_the_shortest_path_and_apart(tables):
    """A point lies on a shortest path if what is left from it and what led to it make up the whole."""
    random = np.random.default_rng(0)
    starts, goals = (tables.places[random.integers(0, len(tables.places), 40)] for _ in range(2))
    found, whole, rest = map(np.asarray, plans(tables, starts, goals))
    starts, goals = np.asarray(starts), np.asarray(goals)
    assert np.isfinite(found).all()
    for k in range(len(starts)):
        left = np.linalg.norm(found[k] - goals[k], axis=-1) > 1e-4
        count = int(left.sum())
        assert left[:count].all(), "nothing comes after the goal"
        chain = np.concatenate([starts[k][None], found[k][:count]])
        gaps = np.linalg.norm(np.diff(chain, axis=0), axis=-1)
        assert (gaps >= 0.5 - 2e-3).all() and (gaps < 0.6).all()
        spent = whole[k] - np.concatenate([[whole[k]], rest[k][:count]])
        along = np.diff(spent)
        assert (along >= gaps - 0.02).all(), "each point is nearer to the goal by its distance along the path"
        assert (along <= 1.6 * gaps + 0.05).all()
        if count < 10:
            assert rest[k][count - 1] < 0.6 or whole[k] < 0.6 if count else whole[k] < 0.6


def test_without_obstacles_in_the_way_the_plan_is_straight(tables):
    start = np.resize(tables.places[:1], (40, 2))
    goal = start + np.float32([0.36, 0.0])
    found, *_ = plans(tables, start, goal)
    assert np.allclose(found[0], goal[:1], atol=1e-5), "nearer than half a metre there is only the goal"

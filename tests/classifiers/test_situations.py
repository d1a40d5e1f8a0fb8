"""Predicates and situations of section III-A, against the equations as printed in double precision."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import classifiers
from sean_jax.classifiers import predicates
from support.situations import AHEAD, BACK, LEFT, NAMES, classify, occurring, snapshot, turned

D, V, A = 2.4, 1.4, np.pi / 12


def test_predicates_equal_the_printed_inequalities():
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, 4000, 2)).astype(np.float32) * 1.7
    b[:1000] = np.stack([-a[:1000, 1], a[:1000, 0]], -1) * random.uniform(0.5, 2) + random.normal(size=(1000, 2)) * 0.3
    first, second = a.astype(float), b.astype(float)
    cosine = (first * second).sum(1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    exact = {
        "near": np.linalg.norm(first - second, axis=1) < D,
        "walking": np.linalg.norm(first, axis=1) > V,
        "perpendicular": (np.cos(np.pi / 2 + A) <= cosine) & (cosine <= np.cos(np.pi / 2 - A)),
        "parallel": np.cos(A) <= cosine,
    }
    close = {
        "near": np.abs(np.linalg.norm(first - second, axis=1) - D),
        "walking": np.abs(np.linalg.norm(first, axis=1) - V),
        "perpendicular": np.abs(np.abs(cosine) - np.sin(A)),
        "parallel": np.abs(cosine - np.cos(A)),
    }
    d, v, angle = jnp.float32(D), jnp.float32(V), jnp.float32(A)
    found = {
        "near": jax.vmap(predicates.near, (0, 0, None))(a, b, d),
        "walking": jax.vmap(predicates.walking, (0, None))(a, v),
        "perpendicular": jax.vmap(predicates.perpendicular_trajectory, (0, 0, None))(a, b, angle),
        "parallel": jax.vmap(predicates.parallel_trajectory, (0, 0, None))(a, b, angle),
    }
    for name, expected in exact.items():
        told = close[name] > 1e-6  # single precision cannot tell the others
        assert told.mean() > 0.99 and 0.05 < expected.mean() < 0.95
        np.testing.assert_array_equal(np.asarray(found[name])[told], expected[told], err_msg=name)


def test_near_and_walking_are_strict():
    """2.5 and 1.5 have exact squares; one step of float32 inside the limit is enough."""
    zero, limit = jnp.zeros(2), jnp.float32(2.5)
    assert not predicates.near(zero, jnp.array([2.5, 0.0]), limit)
    assert not predicates.near(zero, jnp.array([1.5, -2.0]), limit)
    assert predicates.near(zero, jnp.array([np.nextafter(np.float32(2.5), np.float32(0)), 0.0]), limit)
    assert not predicates.walking(jnp.array([0.0, -1.5]), jnp.float32(1.5))
    assert predicates.walking(jnp.array([0.0, -np.nextafter(np.float32(1.5), np.float32(9))]), jnp.float32(1.5))


def test_angle_limits_are_included():
    """With an angle of zero only the limit itself is left."""
    x, zero = jnp.array([2.0, 0.0]), jnp.float32(0.0)
    assert predicates.parallel_trajectory(x, jnp.array([0.5, 0.0]), zero)
    assert not predicates.parallel_trajectory(x, jnp.array([0.5, 0.01]), zero)
    wide = jnp.float32(np.pi / 2)  # cos(pi/2 + pi/2) = -1 <= cosine <= 1: everything, the opposite direction too
    for other in (x, -x, jnp.array([0.0, 1.0])):
        assert predicates.perpendicular_trajectory(x, other, wide)


def test_member_needs_a_group():
    def member(agent, group):
        return bool(predicates.member(jnp.int32(agent), jnp.int32(group)))

    assert member(0, 0) and member(2, 2)
    assert not member(0, 1) and not member(-1, 0) and not member(-1, -1)


def test_angles_of_path_situations():
    """Perpendicular within 15 degrees on either side of both normals; parallel within 15 degrees, one way only."""
    limits = {0: "down_path", 14.9: "down_path", 15.1: "", 74.9: "", 75.1: "cross_path", 90: "cross_path"}
    limits |= {104.9: "cross_path", 105.1: "", 165: "", 179.9: ""}
    for degrees, name in limits.items():
        for side in (-1, 1):
            found = occurring([((1.0, 0.5), turned(side * degrees), 1.5, -1)])
            assert found == {name} - {""}, (side, degrees)


@pytest.mark.parametrize("heading", [30, 135, -100])
def test_only_the_angle_to_the_robot_counts(heading):
    robot = turned(heading)
    for degrees, name in ((90, "cross_path"), (-90, "cross_path"), (10, "down_path"), (180, None)):
        found = occurring([((0.4, 0.3), turned(heading + degrees), 1.6, -1)], heading=robot)
        assert found == ({name} if name else set())


def test_crossing_needs_a_walker_and_down_path_does_not():
    assert occurring([((1.0, 0.0), LEFT, 1.41, -1)]) == {"cross_path"}
    assert occurring([((1.0, 0.0), LEFT, 1.39, -1)]) == set()
    assert occurring([((1.0, 0.0), AHEAD, 0.0, -1)]) == {"down_path"}


def test_orientation_counts_not_velocity():
    here = snapshot([((1.0, 0.0), AHEAD, 0.0, -1)])
    sideways = replace(here.people, velocity=here.people.velocity.at[0].set(jnp.array([0.0, 1.5])))
    flags = dict(zip(NAMES, np.asarray(classify(replace(here, people=sideways))), strict=True))
    assert flags["down_path"] and not flags["cross_path"]


def test_group_situations_need_the_right_group():
    agent = ((1.0, 0.0), BACK, 0.0, 2)
    assert occurring([agent], goal_group=2) == {"join_group"}
    assert occurring([agent], start_group=2) == {"leave_group"}
    assert occurring([agent], start_group=2, goal_group=2) == {"join_group", "leave_group"}
    assert occurring([agent], start_group=1, goal_group=3) == set()
    assert occurring([((1.0, 0.0), BACK, 0.0, -1)]) == set()  # no group is nobody's group
    assert occurring([((2.5, 0.0), BACK, 0.0, 2)], start_group=2, goal_group=2) == {"empty"}


def test_near_and_member_must_hold_for_one_agent():
    near, member = ((1.0, 0.0), BACK, 0.0, 1), ((4.0, 0.0), BACK, 0.0, 2)
    assert occurring([near, member], goal_group=2, start_group=2) == set()
    walker, crosser = ((3.0, 0.0), LEFT, 1.5, -1), ((1.0, 0.0), LEFT, 0.5, -1)
    assert occurring([walker, crosser]) == set()


def test_join_group_ends_at_the_goal_and_leave_group_does_not():
    agent = ((1.0, 0.0), BACK, 0.0, 2)
    for goal, there in (((0.19, 0.0), True), ((0.0, 0.0), True), ((0.0, -0.21), False)):
        found = occurring([agent], goal=goal, goal_group=2, start_group=2)
        assert ("join_group" in found) is not there and "leave_group" in found


def test_empty_is_nobody_near():
    assert occurring() == {"empty"}  # nobody is there at all
    assert occurring([((2.41, 0.0), AHEAD, 1.5, 0)], goal_group=0) == {"empty"}
    assert occurring([((2.39, 0.0), turned(45), 1.5, -1)]) == set()
    far, near = ((8.0, 0.0), LEFT, 1.5, -1), ((0.0, -2.0), LEFT, 1.5, -1)
    assert occurring([far, near]) == {"cross_path"}


def test_absent_people_are_ignored():
    """The spare slots stand right in front of the robot, look as it does, and belong to group 0."""
    assert occurring([], goal_group=0, start_group=0) == {"empty"}
    assert occurring([((1.0, 0.0), LEFT, 1.5, -1)], goal_group=0, start_group=0) == {"cross_path"}


def test_several_situations_at_once():
    agents = [((1, 0), LEFT, 1.5, -1), ((0, 1), AHEAD, 0.5, -1), ((0, -1), BACK, 0, 1), ((-1, 0), BACK, 0, 3)]
    assert occurring(agents, goal_group=1, start_group=3) == set(NAMES) - {"empty"}


def test_zero_vectors_have_no_angle():
    for agent, robot in ((((1.0, 0.0), (0.0, 0.0), 0.0, -1), AHEAD), (((1.0, 0.0), AHEAD, 0.0, -1), (0.0, 0.0))):
        assert occurring([agent], heading=robot) == set()
    zero = jnp.zeros(2)
    for law in (predicates.parallel_trajectory, predicates.perpendicular_trajectory):
        assert not law(zero, zero, jnp.float32(A)) and not law(zero, jnp.ones(2), jnp.float32(A))


def test_thresholds_can_be_chosen():
    here = snapshot([((3.0, 0.0), turned(60), 1.0, -1)])
    wide = classifiers.thresholds(near=4.0, walking=0.5, angle=np.deg2rad(31))
    flags = dict(zip(NAMES, np.asarray(classifiers.classify(here, wide)), strict=True))
    assert flags["cross_path"] and not flags["down_path"] and not flags["empty"]

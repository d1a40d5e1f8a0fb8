"""People from positions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import InputError, pedestrians_at, preset
from support.forces import walk

rng = np.random.default_rng(5)
PLACES = rng.uniform(-5.0, 5.0, (6, 2))


def test_people_with_a_goal_walk_straight_to_it_at_their_preferred_speed():
    goal, speed = rng.uniform(-50.0, 50.0, (6, 2)), rng.uniform(0.5, 2.0, 6)
    people = pedestrians_at(PLACES, goal=goal, preferred_speed=speed)
    way = goal - PLACES
    expected = way / np.linalg.norm(way, axis=1, keepdims=True) * speed[:, None]
    np.testing.assert_allclose(people.desired_velocity, expected, atol=1e-5)
    np.testing.assert_allclose(people.velocity, expected, atol=1e-5)
    np.testing.assert_allclose(people.heading * speed[:, None], expected, atol=1e-5)
    one = pedestrians_at(PLACES, goal=goal[0], preferred_speed=1.0)
    np.testing.assert_allclose(np.linalg.norm(one.desired_velocity, axis=1), 1.0, atol=1e-5)
    assert (np.sum(np.array(one.desired_velocity) * (goal[0] - PLACES), -1) > 0).all()


def test_people_with_a_velocity_go_on_with_it_and_who_stands_can_still_be_pushed():
    velocity = rng.normal(size=(6, 2))
    velocity[0] = 0.0
    people = pedestrians_at(PLACES, velocity)
    np.testing.assert_allclose(people.desired_velocity, velocity, atol=1e-6)
    np.testing.assert_allclose(people.preferred_speed[1:], np.linalg.norm(velocity[1:], axis=1), atol=1e-6)
    np.testing.assert_allclose(people.heading[0], [1.0, 0.0])
    close = PLACES.copy()
    close[1] = close[0] + [0.3, 0.0]
    moved = walk(preset("helbing1995"), pedestrians_at(close, velocity))
    assert float(jnp.abs(moved.velocity[0, 0]).max()) > 0.0


def test_who_is_not_there_moves_nobody_and_does_not_move():
    present = np.array([True, False] * 3)
    people = pedestrians_at(np.zeros((6, 2)) + np.arange(6)[:, None] * 0.2, np.ones((6, 2)), present=present)
    after = walk(preset("helbing1995"), people)
    np.testing.assert_array_equal(after.position[0, ~present], people.position[~present])
    np.testing.assert_array_equal(after.present[0], present)


def test_two_wishes_are_refused_and_gradients_are_finite():
    with pytest.raises(InputError, match="goal: .*give one"):
        pedestrians_at(PLACES, goal=PLACES, desired_velocity=PLACES)

    def size(position, velocity):
        people = pedestrians_at(position, velocity)
        to_goal = pedestrians_at(position, goal=position)
        return (people.heading**2).sum() + people.preferred_speed.sum() + (to_goal.desired_velocity**2).sum()

    found = jax.jit(jax.grad(size, (0, 1)))(jnp.zeros((3, 2)), jnp.zeros((3, 2)))
    assert all(bool(jnp.isfinite(each).all()) for each in found)

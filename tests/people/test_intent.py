"""The velocity that people want on the way to a goal."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.people.intent import Intent, Latents, advance, draw, lasting_speed, wanted_velocity
from sean_jax.studies.scenes import Gate, Scene, model, simulate, walkers
from sean_jax.studies.validation.streets import NO_WALLS

INTENT = Intent(speed_share=0.8, speed_deviation=0.3, speed_time=5.0, turn_time=1.5, route_deviation=0.1)


def test_speeds_are_a_process_of_a_deviation_and_a_time():
    """Of 20,000 people after 20 s and 3 s more, against the formulas of Ornstein and Uhlenbeck."""
    keys = jax.random.split(jax.random.key(0), 230)
    latents = draw(INTENT, jax.random.key(1), 20_000)
    assert (np.asarray(latents.speed) == 0.0).all()

    def step(latents, key):
        latents = advance(INTENT, latents, key, 0.1)
        return latents, latents.speed

    speed = np.asarray(jax.lax.scan(step, latents, keys)[1])
    np.testing.assert_allclose(speed[9].std(), 0.3 * np.sqrt(1.0 - np.exp(-2.0 * 1.0 / 5.0)), rtol=0.03)
    np.testing.assert_allclose(speed[199].std(), 0.3, rtol=0.03)
    correlation = np.corrcoef(speed[199], speed[229])[0, 1]
    np.testing.assert_allclose(correlation, np.exp(-3.0 / 5.0), atol=0.02)


def test_routes_differ_by_their_deviation_and_end_at_the_goal():
    latents = draw(INTENT, jax.random.key(1), 20_000)
    np.testing.assert_allclose(np.asarray(latents.route).std(), 0.1, rtol=0.03)

    # A route to the left of a way along x, which a loop in 64 bits walks in steps of 5 cm.
    bent = Latents(jnp.zeros(1), jnp.full(1, 0.3))
    at_once = replace(INTENT, turn_time=0.0)
    near = wanted_velocity(at_once, bent, jnp.zeros((1, 2)), jnp.array([[1.0, 0.0]]), jnp.ones(1), 0.05)
    np.testing.assert_allclose(near, [[np.cos(0.15), np.sin(0.15)]], rtol=1e-5)
    place, goal, sideways = np.zeros((1, 2)), np.array([[10.0, 0.0]]), []
    for _ in range(215):
        way = jnp.asarray(goal - place)
        velocity = wanted_velocity(at_once, bent, jnp.zeros((1, 2)), way, jnp.ones(1), 0.05)
        place = place + 0.05 * np.asarray(velocity, float)
        sideways.append(place[0, 1])
    assert np.abs(place - goal).max() < 0.2 and 0.9 < max(sideways) < 1.2
    # A spiral at an angle a leaves the way by up to exp(-phi / tan a) sin phi of it, where tan phi = tan a.
    np.testing.assert_allclose(max(sideways), 10.0 * np.exp(-0.3 / np.tan(0.3)) * np.sin(0.3), rtol=0.02)


def test_first_speeds_last_by_a_share():
    np.testing.assert_allclose(lasting_speed(INTENT, jnp.array([1.0, 2.0]), 1.5), [1.1, 1.9], rtol=1e-6)


def test_gradients_are_finite_at_the_goal_and_at_rest():
    def reached(intent, way):
        latents = advance(intent, draw(intent, jax.random.key(0), 2), jax.random.key(1), 0.1)
        wanted = jnp.array([[0.0, 0.0], [1.0, 0.0]])
        return wanted_velocity(intent, latents, wanted, way, jnp.array([0.0, 1.0]), 0.1).sum()

    numbers = jax.tree.map(jnp.asarray, INTENT)
    for intent in (numbers, jax.tree.map(jnp.asarray, INTENT.average()), replace(numbers, turn_time=jnp.zeros(()))):
        gradients = jax.jit(jax.grad(reached, argnums=(0, 1)))(intent, jnp.zeros((2, 2)))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))


def test_the_noise_of_intent_is_a_stream_of_its_own():
    """People without deviations, who turn at once, walk as without intent, noise of the forces and all."""
    people = walkers(np.array([[0.0, 0.0], [0.3, 1.0]]), route=(0,), speed=1.3, velocity=(1.0, 0.0))
    scene = Scene(NO_WALLS, people, (Gate((9.0, 3.0), (9.0, -3.0)),), 2.0)
    alike = replace(scene, intent=Intent(turn_time=0.0).average())
    differ = replace(scene, intent=replace(INTENT, turn_time=0.0))
    without, same, other = (np.asarray(simulate(one, model())[0].position) for one in (scene, alike, differ))
    np.testing.assert_allclose(same, without, atol=1e-5)
    assert np.abs(other - without).max() > 0.01


def test_who_walks_straight_away_from_the_goal_turns_round():
    """Halfway between two opposite directions lies none, so they turn to their left first."""
    latents = Latents(jnp.zeros(1), jnp.zeros(1))
    place, wanted = jnp.zeros((1, 2)), jnp.array([[-1.3, 0.0]])
    for _ in range(60):
        wanted = wanted_velocity(Intent(), latents, wanted, jnp.array([[5.0, 0.0]]) - place, jnp.full(1, 1.3), 0.1)
        place = place + 0.1 * wanted
    assert wanted[0, 0] > 1.0 and place[0, 1] < 0.0

"""The terms of benchmarks/residual.py: nothing at the start, equivariant under rotations, bounded, differentiable."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import predict, social_forces
from sean_jax.people.pedestrian_models import pedestrians_at
from sean_jax.social_forces.forces import Crowd, look_direction
from sean_jax.social_forces.model import pair_forces
from support.checkout import benchmark

residual = benchmark("residual")
LAWS = social_forces.preset("calibrated")


def crowd(forces, seed: int, angle: float = 0.0, people: int = 12):
    """A dense crowd with all kinds of velocities, turned by an angle."""
    draw = np.random.default_rng(seed)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    position, velocity, desired, heading = (scale * draw.normal(size=(people, 2)) @ turn for scale in (2.0, 1, 1, 1))
    heading = heading / np.linalg.norm(heading, axis=1, keepdims=True)
    walkers = pedestrians_at(position, velocity, desired_velocity=desired, heading=heading)
    return Crowd(forces, walkers, *look_direction(walkers), None, None, None, 0.0, None), turn


def forces_of(terms, seed: int, angle: float = 0.0):
    """(2, N, 2) m/s2: of other people, and of the goal."""
    forces = social_forces.build([LAWS.walking, *terms])
    several, turn = crowd(forces, seed, angle)
    return np.stack([np.stack(pair_forces(several)[1], -1), np.stack(terms[1].person(several), -1)]), turn


@pytest.fixture(scope="module")
def windows():
    """(B, T, N, 2) m: two moments of people who meet."""
    draw = np.random.default_rng(0)
    start, step = 2.0 * draw.normal(size=(3, 1, 6, 2)), 0.5 * draw.normal(size=(3, 1, 6, 2))
    return jnp.asarray(np.concatenate([start - step, start], 1), float)


def test_without_weights_people_move_by_the_laws(windows):
    own = social_forces.build([*LAWS, *residual.residual()])
    tracks = [np.asarray(predict(forces, windows, 0.4, 6)) for forces in (LAWS, own)]
    np.testing.assert_allclose(*tracks, atol=1e-5)
    other = predict(social_forces.build([*LAWS, *residual.residual(outer=1.0)]), windows, 0.4, 6)
    assert np.abs(other - tracks[0]).max() > 0.05


@pytest.mark.parametrize("seed", range(4))
def test_forces_turn_with_the_crowd_and_are_bounded(seed):
    terms = residual.residual(seed, outer=3.0)
    (before, _), (after, turn) = forces_of(terms, seed), forces_of(terms, seed, angle=0.7 + seed)
    np.testing.assert_allclose(after, before @ turn, atol=2e-5)
    size = np.linalg.norm(before, axis=-1)
    assert (size.max(1) > 0.1).all() and size[0].max() < residual.MOST and size[1].max() < 1.5 * residual.MOST


@pytest.mark.night
def test_gradients_of_weights_are_finite(windows):
    still = windows.at[:, :, 0].set(windows[:, :, 1])  # two at one place, and somebody who stands
    still = still.at[:, 0, 2].set(still[:, 1, 2])

    def loss(terms):
        return jnp.square(predict(social_forces.build([LAWS.walking, *terms]), still, 0.4, 6)).sum()

    slopes = jax.tree.leaves(jax.jit(jax.grad(loss))(residual.residual(outer=1.0)))
    assert all(np.isfinite(slope).all() and np.abs(slope).max() > 0.0 for slope in slopes)


def test_matrices_are_shortened():
    steep = jax.tree.map(lambda leaf: 10.0 * leaf, residual.residual(outer=1.0))
    for term in residual.bounded(steep):
        for matrix in (term.inner, term.outer):
            assert np.linalg.norm(matrix, 2) == pytest.approx(residual.STEEP, rel=1e-4)


@pytest.mark.slow
def test_program(recordings, tmp_path, monkeypatch):
    """A short trial writes what it measured."""
    arguments = "residual.py", "--data", str(recordings / "eth_ucy"), "--quick", "--out", str(tmp_path)
    monkeypatch.setattr("sys.argv", list(arguments))
    with jax.numpy_dtype_promotion("standard"):  # the arithmetic of optax is not strict
        residual.main()
    results = json.loads((tmp_path / "residual.json").read_text())
    own = results["without"]["eth"]
    assert list(own["scores"]["eth (social_gan)"]) == list(residual.MODELS)
    for values in own["speeds"].values():  # three updates break no crowd
        assert np.abs(np.divide(values, results["measured"]) - 1.0).max() < 0.4

"""Samples of predictions: the best of each track, and the likelihood against scipy's kernel density."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import gaussian_kde

from sean_jax.studies.prediction import cut_windows, evaluate, evaluate_samples, predict, score_samples

generator = np.random.default_rng(5)
samples = generator.normal(0.0, 1.0, (20, 3, 4, 2, 2))
recorded = generator.normal(0.0, 1.0, (3, 4, 2, 2))
present = np.array([[True, False], [True, True], [False, True]])


def test_best_samples_are_of_each_track():
    found = score_samples(samples, recorded, present)
    ade, fde = [], []
    for window, person in zip(*np.nonzero(present), strict=True):
        away = [np.linalg.norm(each[window, :, person] - recorded[window, :, person], axis=-1) for each in samples]
        ade.append(min(each.mean() for each in away))
        fde.append(min(each[-1] for each in away))
    assert found.best_ade == pytest.approx(np.mean(ade)) and found.best_fde == pytest.approx(np.mean(fde))
    assert found.samples == 20


def test_likelihood_is_that_of_kernels_of_scott():
    known = []
    for window, person in zip(*np.nonzero(present), strict=True):
        for moment in range(4):
            kernel = gaussian_kde(samples[:, window, moment, person].T)
            known.append(max(kernel.logpdf(recorded[window, moment, person])[0], -20.0))
    assert score_samples(samples, recorded, present).nll == pytest.approx(-np.mean(known))


def test_samples_that_are_alike_are_least_likely():
    assert score_samples(np.zeros_like(samples), recorded, present).nll == 20.0
    assert score_samples(samples + 1e3, recorded, present).nll == pytest.approx(20.0)


def walking(number=3):
    moments = np.arange(28.0)[:, None]
    place = np.stack([np.stack([0.5 * moments[:, 0], 2.0 * k + 0 * moments[:, 0]], -1) for k in range(number)], 1)
    return cut_windows(place)


def test_samples_differ_by_key_window_and_person_and_none_are_average():
    windows = walking()
    seen = jnp.asarray(windows.position[:, :8])
    one, other, again = (np.asarray(predict("calibrated", seen, 0.4, 12, key=jax.random.key(k))) for k in (0, 1, 0))
    plain = np.asarray(predict("calibrated", seen, 0.4, 12))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.01 and np.abs(one - plain).max() > 0.01
    away = one - plain
    assert np.abs(away[0] - away[1]).max() > 0.01  # windows
    assert np.abs(away[:, :, 0] - away[:, :, 1]).max() > 0.01  # people
    assert np.abs(away).max() < 3.0
    scores = evaluate_samples("calibrated", windows, 5)
    single = evaluate("calibrated", windows, key=jax.random.key(0))
    assert scores.samples == 5 and 0.0 < scores.best_ade < single.ade + 0.5

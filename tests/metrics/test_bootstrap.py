"""Figures over episodes: means and bootstrap intervals against closed forms and scipy's bootstrap."""

import math
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import sean_jax
from sean_jax.metrics import aggregate, aggregate_ratio, bootstrap, interval, resamples
from sean_jax.studies.experiments import shares
from support import programs


@pytest.fixture(scope="module")
def normal():
    """400 episodes of three columns: normal around 10 and 3, and a mean of 0."""
    return np.random.default_rng(0).normal([10.0, 3.0, 0.0], [2.0, 0.5, 1.0], (400, 3))


def test_interval_of_normal_data_is_that_of_their_standard_error(normal):
    found = aggregate(normal)
    half = 1.96 * normal.std(0) / 20
    np.testing.assert_allclose(found.mean, normal.mean(0), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.low, normal.mean(0) - half, atol=0.1 * half.max())
    np.testing.assert_allclose(found.high, normal.mean(0) + half, atol=0.1 * half.max())
    assert found.episodes.tolist() == [400] * 3


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_interval_equals_scipys(normal, level):
    """Two Monte-Carlo estimates of the same quantiles: they differ by the noise of 2000 resamples."""
    found = aggregate(normal[:60], level=level)
    for k in range(3):
        theirs = scipy.stats.bootstrap(
            (normal[:60, k],), np.mean, n_resamples=8000, confidence_level=level, method="percentile", rng=1
        )
        noise = 0.12 * float(theirs.standard_error)
        np.testing.assert_allclose([found.low[k], found.high[k]], tuple(theirs.confidence_interval), atol=noise)


def test_ratio_equals_scipys():
    random = np.random.default_rng(2)
    total = random.uniform(5.0, 30.0, 80)
    part = total * random.beta(2.0, 5.0, 80)
    found = aggregate_ratio(part, total)
    theirs = scipy.stats.bootstrap(
        (part, total), lambda a, b, axis: a.sum(axis) / b.sum(axis), paired=True, n_resamples=8000,
        method="percentile", rng=3,
    )  # fmt: skip
    assert found.mean == pytest.approx(part.sum() / total.sum()) and found.mean.shape == ()
    noise = 0.12 * float(theirs.standard_error)
    np.testing.assert_allclose([found.low, found.high], tuple(theirs.confidence_interval), atol=noise)


@pytest.mark.parametrize("sizes", [(3, 2, 8), (10, 3, 8), (1, 4, 20)])
@pytest.mark.parametrize("spreads", [(1.0, 0.6, 2.0), (0.0, 0.0, 1.0)])
def test_hierarchical_intervals_hold_the_truth_as_often_as_they_say(sizes, spreads):
    """Normal effects of datasets, seeds and episodes; a single dataset is part of the truth."""
    random, experiments = np.random.default_rng(3), 1000
    data = np.zeros((experiments, *sizes))
    for depth, spread in enumerate(spreads):
        if sizes[depth] > 1:
            data += random.normal(0, spread, (experiments, *sizes[: depth + 1], *[1] * (2 - depth)))
    weights = bootstrap.hierarchical_resamples(sizes)
    np.testing.assert_allclose(weights.sum(1), math.prod(sizes), rtol=1e-4)
    found = aggregate(data.reshape(experiments, -1).T, weights=weights)
    assert 0.92 <= ((found.low <= 0) & (found.high >= 0)).mean() <= 0.97


@pytest.mark.slow
@pytest.mark.parametrize(
    ("datasets", "mean", "spread", "least", "most"),
    [(3, 2.5, 0.7, 0.89, 0.93), (3, 4.0, 1.5, 0.75, 0.80), (10, 2.5, 0.7, 0.90, 0.94), (10, 4.0, 1.5, 0.78, 0.83)],
)
def test_intervals_of_few_skewed_networks_are_too_narrow(datasets, mean, spread, least, most):
    """Shares of 410 tasks, logit-normal between datasets, 91 and 96 % in the mean, as docs/experiments.md has them."""
    random = np.random.default_rng(0)

    def shares(*shape: int) -> np.ndarray:
        return 1.0 / (1.0 + np.exp(-random.normal(mean, spread, shape)))

    truth = shares(2_000_000).mean()
    completed = random.binomial(410, shares(datasets, 3000)) / 410
    found = aggregate(completed, weights=bootstrap.hierarchical_resamples((datasets, 1, 1)), bounds=(0.0, 1.0))
    assert least <= ((found.low <= truth) & (truth <= found.high)).mean() <= most


def test_intervals_are_cut_at_the_range_of_the_figure_and_not_at_the_data():
    """Three networks whose episodes hardly vary: the interval goes on beyond the largest episode."""
    random, weights = np.random.default_rng(5), bootstrap.hierarchical_resamples((3, 1, 40))
    times = np.repeat([1.0, 2.0, 3.0], 40) + 0.01 * random.normal(size=120)
    found = aggregate(times, weights=weights, bounds=(0.0, math.inf))
    half = scipy.stats.t.ppf(0.975, 2) / np.sqrt(3)
    assert found.high == pytest.approx(2.0 + half, rel=0.05) and found.high > times.max() + 1.0 and found.low == 0.0
    gaps = aggregate(times - 2.0, weights=weights)
    assert gaps.low == pytest.approx(-half, rel=0.15) and gaps.high == pytest.approx(half, rel=0.15)

    # 400 experiments with three networks: 95 % of the intervals hold the truth.
    data = np.repeat(random.normal(5.0, 1.0, (3, 400)), 40, axis=0) + 0.01 * random.normal(size=(120, 400))
    found = aggregate(data, weights=weights, bounds=(0.0, math.inf))
    assert 0.92 <= ((found.low <= 5.0) & (found.high >= 5.0)).mean() <= 0.98


def test_intervals_of_networks_stay_within_the_values():
    """Student's interval of three networks would go beyond 100 % and below 0 s. Numbers that are equal stay so."""
    random, weights = np.random.default_rng(5), bootstrap.hierarchical_resamples((3, 1, 40))
    share = (random.random((3, 40)) < [[0.7], [0.98], [0.99]]).ravel()
    seconds = np.where(random.random((3, 40)) < [[0.9], [0.05], [0.0]], random.exponential(9.0, (3, 40)), 0.0).ravel()
    values = np.stack([share, seconds, np.full(120, 0.1), np.zeros(120)], 1)
    bounds = [(0.0, 1.0), (0.0, math.inf), (0.0, 1.0), (0.0, 1.0)]
    each = [aggregate(column, weights=weights, bounds=both) for column, both in zip(values.T, bounds, strict=True)]
    mean, low, high = (np.array([getattr(one, name) for one in each]) for name in ("mean", "low", "high"))
    np.testing.assert_allclose(mean, values.mean(0))
    assert low[0] > 0.0 and high[0] == 1.0 and low[1] == 0.0
    np.testing.assert_allclose(low[2:], high[2:], rtol=1e-12)
    assert (low <= mean + 1e-12).all() and (mean <= high + 1e-12).all()
    assert bootstrap.interval(weights @ share / 120)[1] > 1.0 and bootstrap.interval(weights @ seconds / 120)[0] < 0.0
    swept = random.random((120, 200)) < np.repeat(random.beta(0.5, 0.5, (3, 200)), 40, axis=0)
    found = aggregate(swept, weights=weights, bounds=(0.0, 1.0))
    assert (0.0 <= found.low).all() and (found.low <= found.mean + 1e-12).all()
    assert (found.mean <= found.high + 1e-12).all() and (found.high <= 1.0).all()


def test_one_group_of_many_episodes_is_the_plain_bootstrap(normal):
    found = aggregate(normal, weights=bootstrap.hierarchical_resamples((1, 1, 400)))
    for k in range(3):
        theirs = scipy.stats.bootstrap((normal[:, k],), np.mean, n_resamples=8000, method="percentile", rng=1)
        noise = 0.15 * float(theirs.standard_error)
        np.testing.assert_allclose([found.low[k], found.high[k]], tuple(theirs.confidence_interval), atol=noise)
    assert (bootstrap.hierarchical_resamples((1, 1, 1)) == 1).all()


@pytest.mark.parametrize("number", [1, 16, 400])
@pytest.mark.parametrize("level", [0.5, 0.95])
def test_shares_of_episodes_have_the_interval_of_wilson(number, level):
    random = np.random.default_rng(number)
    for count in {0, 1, number, int(random.integers(number + 1)), int(random.integers(number + 1))}:
        found = bootstrap.of_share(aggregate(np.arange(number) < count), level)
        exact = scipy.stats.binomtest(count, number).proportion_ci(level, "wilson")
        np.testing.assert_allclose([found.low, found.high], [exact.low, exact.high], atol=1e-9)
    some = aggregate(np.arange(20) % 3 == 0)
    assert bootstrap.of_share(some, where=False) == some
    counts = aggregate(np.arange(20.0))  # no share, so the square root of Wilson's interval does not exist
    with warnings.catch_warnings(action="error"):
        assert bootstrap.of_share(counts, where=False) == counts
    assert bootstrap.of_share(aggregate(np.full(3, np.nan))) == (0, 0, 0, 0)


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_counts_of_no_event_have_the_exact_interval(level):
    """The largest Poisson rate under which no event in all episodes is as probable as the tail of the level."""
    for number in (1, 16, 400):
        found = bootstrap.of_count(aggregate(np.zeros(number)), level)
        assert found.low == 0 and scipy.stats.poisson.cdf(0, number * found.high) == pytest.approx((1 - level) / 2)
    some = aggregate(np.arange(20) % 3)
    assert bootstrap.of_count(some) == some


def test_interval_of_a_ratio_is_that_of_the_delta_method():
    """The error of a / b is that of the mean of (a - r b) / mean(b), r the ratio."""
    random = np.random.default_rng(6)
    total = random.uniform(8.0, 12.0, 900)
    part = total * random.uniform(0.0, 0.6, 900)
    found, share = aggregate_ratio(part, total), part.sum() / total.sum()
    half = 1.96 * (part - share * total).std() / total.mean() / 30
    np.testing.assert_allclose([found.low, found.high], [share - half, share + half], atol=0.1 * half)


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_interval_of_evenly_spaced_samples(level):
    """Quantiles of 0, 1, ..., 1000 are those numbers; of each column by itself."""
    samples = np.random.default_rng(7).permutation(1001)[:, None] * [1.0, -2.0]
    low, high = interval(samples, level)
    ends = 1000 * np.array([(1 - level) / 2, (1 + level) / 2])
    np.testing.assert_allclose([low[0], high[0]], ends)
    np.testing.assert_allclose([low[1], high[1]], -2 * ends[::-1])


def test_shares_of_table_1_have_the_intervals_of_their_chains():
    """Seconds of a chain are all alike here, so the error is that of 400 draws, not of 24,000."""
    chain = np.random.default_rng(8).uniform(size=(400, 1, 5)) < [0.1, 0.2, 0.3, 0.4, 0.5]
    flags = np.broadcast_to(chain, (1, 400, 60, 5))
    table = shares.chain_rows(flags, flags[0], np.array([1, 0]), 1, [""])
    (found,) = shares.chain_shares(table, [], draw=lambda _: resamples(400)).values()
    share = chain.mean((0, 1))
    np.testing.assert_allclose(found[0, :5], share, rtol=1e-12)
    half = 1.96 * np.sqrt(share * (1 - share) / 400)
    ends = shares.interval(found[:, :5])
    np.testing.assert_allclose(ends, [share - half, share + half], atol=0.12 * half.max())
    by_aggregate = aggregate(chain[:, 0].astype(float))
    np.testing.assert_allclose(ends, [by_aggregate.low, by_aggregate.high], rtol=1e-9)
    assert found[0, 5] == pytest.approx((~chain.any(-1)).mean())


@pytest.mark.parametrize(("strata", "size"), [(1, 4), (2, 5), (5, 20), (2, 50)])
def test_stratified_intervals_hold_the_truth_as_often_as_they_say(strata, size):
    """2,000 experiments with strata of different means and deviations; and their means are Student's."""
    random, means, deviations = np.random.default_rng(9), np.arange(strata), 1.0 + np.arange(strata) % 2
    weights = bootstrap.with_estimate(bootstrap.stratified_resamples(strata, size))
    np.testing.assert_allclose(weights.sum(1), 1.0, atol=1e-4)
    data = random.normal(means[:, None], deviations[:, None], (2000, strata, size)).reshape(2000, -1)
    samples = weights @ data.T
    np.testing.assert_allclose(samples[0], data.mean(1))
    low, high = interval(samples[1:])
    assert 0.93 <= ((low <= means.mean()) & (means.mean() <= high)).mean() <= 0.97


@pytest.mark.parametrize(("strata", "size", "future"), [(1, 100, 10), (2, 50, 5), (5, 20, 2), (1, 5, 2)])
def test_predictive_intervals_hold_new_means_as_often_as_they_say(strata, size, future):
    random, means = np.random.default_rng(10), np.arange(strata)
    weights = bootstrap.with_estimate(bootstrap.predictive_resamples(strata, size, future))
    data = random.normal(means[:, None], 1.0, (2000, strata, size)).reshape(2000, -1)
    new = random.normal(means[:, None], 1.0, (2000, strata, future)).mean((1, 2))
    low, high = interval((weights @ data.T)[1:])
    assert 0.93 <= ((low <= new) & (new <= high)).mean() <= 0.97


def test_intervals_hold_the_truth_as_often_as_they_say():
    """300 experiments of 40 episodes: 95 % intervals hold the true mean in about 93 %, for the percentile is short."""
    data = np.random.default_rng(4).normal(1.0, 1.0, (40, 300))
    found = aggregate(data)
    share = ((found.low <= 1.0) & (found.high >= 1.0)).mean()
    assert 0.89 <= share <= 0.97


def test_what_does_not_apply_does_not_count_and_is_no_number_of_the_result(normal):
    applies = np.random.default_rng(5).uniform(size=normal.shape) < 0.3
    applies[:, 2] = False
    told = np.where(applies, normal, np.nan)
    found = aggregate(told)
    for name, other in zip(found._fields, aggregate(np.where(applies, normal, np.inf), applies), strict=True):
        np.testing.assert_array_equal(getattr(found, name), other, err_msg=name)
    np.testing.assert_allclose(found.mean[:2], [normal[applies[:, k], k].mean() for k in (0, 1)], rtol=1e-12)
    half = [1.96 * normal[applies[:, k], k].std() / np.sqrt(applies[:, k].sum()) for k in (0, 1)]
    np.testing.assert_allclose(found.high[:2] - found.low[:2], 2 * np.array(half), rtol=0.15)
    assert found.episodes.tolist() == applies.sum(0).tolist()
    assert (found.mean[2], found.low[2], found.high[2], found.episodes[2]) == (0.0, 0.0, 0.0, 0)
    assert all(np.isfinite(part).all() for part in found)


def test_seed_decides_and_shared_resamples_are_the_same(normal):
    same, other = aggregate(normal, seed=7), aggregate(normal, seed=8)
    for one, again in zip(same, aggregate(normal, weights=resamples(400, 7)), strict=True):
        np.testing.assert_array_equal(one, again)
    assert (same.low != other.low).all() and (same.mean == other.mean).all()
    one_column = aggregate(normal[:, 0], seed=7)
    assert one_column.low == same.low[0] and one_column.episodes == 400
    weights = resamples(50, 1)
    assert weights.shape == (2000, 50) and (weights.sum(1) == 50).all()
    assert len(resamples(50_000)) == 400 and len(resamples(50_000, count=7)) == 7
    np.testing.assert_array_equal(resamples(60, 2, 2000), resamples(60, 2))


def test_one_episode_has_an_interval_of_no_width():
    found = aggregate(np.array([3.5]))
    assert found == (3.5, 3.5, 3.5, 1)


@pytest.mark.night
def test_metrics_of_a_batch_of_episodes(scenario):
    """As a user has them: a dict of what ``results`` gives, vmapped over states."""
    states = programs.resets(scenario, jax.random.split(jax.random.key(0), 4))
    measured = jax.jit(jax.vmap(lambda state: sean_jax.results(scenario, state)))(states)
    found = jax.tree.map(sean_jax.aggregate, measured)
    assert set(found) == set(measured)
    distance = np.asarray(measured["min_distance_to_goal"], float)
    assert found["min_distance_to_goal"].mean == pytest.approx(distance.mean())
    assert found["time_in_situation"].mean.shape == (1 + len(scenario.situations),)
    assert all(np.isfinite(part).all() for estimate in found.values() for part in estimate)
    assert (found["mean_speed"].episodes[1:] == 0).all()  # no step, so no situation has occurred


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: aggregate(np.zeros((0, 3))), "with an E of 1 or more"),
        (lambda: aggregate(np.zeros((2, 3, 4))), r"\(E,\) or \(E, 1 \+ S\)"),
        (lambda: aggregate(np.zeros(3), np.ones(2, bool)), r"\(2,\) must be bool of the shape \(3,\)"),
        (lambda: aggregate(np.zeros(3), np.ones(3)), "must be bool"),
        (lambda: aggregate(jnp.array([1.0, jnp.nan]), np.ones(2, bool)), "one that counts is not finite"),
        (lambda: aggregate(np.zeros(3), level=95), "level: 95 must lie between 0 and 1"),
        (lambda: interval(np.zeros(3), 0.0), "level: 0.0 must lie between 0 and 1"),
        (lambda: aggregate_ratio(np.zeros(3), np.zeros(2)), "must be equal"),
        (lambda: aggregate_ratio(np.ones(3), -np.ones(3)), "denominator: -1 is negative"),
    ],
)
def test_what_cannot_be_aggregated_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_rows_of_a_cluster_are_drawn_together():
    """Copies of each episode tell nothing new: intervals are those of the episodes alone."""
    weights = resamples(60, 2, cluster=3)
    assert weights.shape == (2000, 60) and (weights.sum(1) == 60).all()
    np.testing.assert_array_equal(weights[:, ::3], weights[:, 2::3])
    values = np.random.default_rng(0).random(20)
    one, copies = aggregate(values), aggregate(np.repeat(values, 3), weights=resamples(60, cluster=3))
    np.testing.assert_allclose(copies[:3], one[:3], rtol=1e-6)
    for number in (0, 20):
        share = np.repeat(np.arange(20) < number, 3).astype(float)
        one = bootstrap.of_share(aggregate(share[::3]))
        copies = bootstrap.of_share(aggregate(share, weights=resamples(60, cluster=3)), cluster=3)
        np.testing.assert_allclose(copies[:3], one[:3], rtol=1e-6, atol=1e-12)
    none = aggregate(np.zeros(60), weights=resamples(60, cluster=3))
    assert bootstrap.of_count(none, cluster=3).high == bootstrap.of_count(aggregate(np.zeros(20))).high

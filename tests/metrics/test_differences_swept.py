"""Statistics against scipy and loops, on drawn numbers of many sizes: differences, Holm, resamples, ranks."""

import math
import warnings

import numpy as np
import pytest
from scipy import stats

from sean_jax.metrics import bootstrap
from sean_jax.metrics.differences import Difference, difference, holm, p_value
from sean_jax.studies.experiments import ranks, scores


def samples(seed: int):
    """Pairs of runs: shares and other figures, of one to 30 episodes, paired and not, some of them without a value."""
    random = np.random.default_rng(seed)
    for k in range(240):
        paired, share = bool(k % 2), bool(k // 2 % 2)
        sizes = (random.integers(1, 31),) * 2 if paired else random.integers(1, 31, 2)
        sizes = np.minimum(sizes, 4) if k % 5 == 0 else sizes
        rates, shift = random.uniform(0.05, 0.95, 2), random.normal(0.0, 3.0)
        one, other = (
            (random.random(n) < rate).astype(float) if share else random.normal(j * shift, 1.0 + 2.0 * rate, n)
            for j, (n, rate) in enumerate(zip(sizes, rates, strict=True))
        )
        if paired:  # some pairs are equal
            other = np.where(random.random(len(one)) < 0.3, one, other)
        for part in (one, other):
            part[random.random(len(part)) < 0.1] = np.nan
        yield paired, one, other


def left(paired, one, other):
    both = np.isfinite(one) & np.isfinite(other) if paired else None
    return (one[both], other[both]) if paired else (one[np.isfinite(one)], other[np.isfinite(other)])


def is_share(one, other):
    return set(one.tolist()) | set(other.tolist()) <= {0.0, 1.0}


def p_by_scipy(paired, one, other) -> float:
    gaps = other - one if paired else None
    if (gaps == 0).all() if paired else len({*one.tolist(), *other.tolist()}) == 1:
        return math.nan
    if is_share(one, other) and paired:
        return stats.binomtest(int((gaps == 1).sum()), int((gaps != 0).sum()), 0.5).pvalue
    if is_share(one, other):
        return stats.fisher_exact([[(one == 1).sum(), (one == 0).sum()], [(other == 1).sum(), (other == 0).sum()]])[1]
    least = 0.5 ** ((gaps != 0).sum() - 1) if paired else 2 / math.comb(len(one) + len(other), len(other))
    if paired and len(one) < 2:
        return 1.0
    if not paired and min(len(one), len(other)) < 2:  # the variance of a single episode counts as none
        parts = [part for part in (one, other) if len(part) > 1]
        if not parts:
            return 1.0
        (single,) = next(part for part in (one, other) if len(part) == 1)
        return min(1.0, max(least, stats.ttest_1samp(parts[0], single).pvalue))
    test = stats.ttest_rel(one, other) if paired else stats.ttest_ind(one, other, equal_var=False)
    return min(1.0, max(least, test.pvalue))


def test_p_values_are_scipys():
    seen = 0
    for paired, *runs in samples(1):
        one, other = left(paired, *runs)
        if len(one) and len(other):
            with warnings.catch_warnings(action="ignore"):
                expected = p_by_scipy(paired, one, other)
            assert p_value(one, other, paired) == pytest.approx(expected, rel=1e-6, abs=1e-300, nan_ok=True)
            seen += 1
    assert seen > 180
    # Differences that are all alike have no variance: only permutations bound the p-value.
    assert p_value(np.zeros(4), np.full(4, 2.0), True) == 2**-3
    assert p_value(np.zeros(4), np.full(3, 2.0), False) == 2 / 35
    assert p_value(np.zeros(1), np.full(1, 2.0), True) == 1.0


def test_figures_of_differences():
    """Means, deviation and effect of what has a value."""
    for paired, *runs in samples(2):
        one, other = left(paired, *runs)
        found = difference(*runs, paired)
        if not (len(one) and len(other)):
            assert found is None
            continue
        gaps = other - one if paired else np.zeros(1)
        freedom = len(one) + len(other) - 2
        squares = (len(one) - 1) * np.var(one, ddof=1) if len(one) > 1 else 0.0
        squares += (len(other) - 1) * np.var(other, ddof=1) if len(other) > 1 else 0.0
        spread = float(np.std(gaps, ddof=1)) if paired and len(gaps) > 1 else 0.0
        deviation = spread if paired else math.sqrt(squares / freedom) if freedom else 0.0
        assert found[:3] == pytest.approx((one.mean(), other.mean(), other.mean() - one.mean()), abs=1e-12)
        assert found.deviation == pytest.approx(deviation, abs=1e-12)
        assert found.low <= found.difference + 1e-12 and found.high >= found.difference - 1e-12
        if found.difference and deviation > 1e-9:
            assert found.effect == pytest.approx(found.difference / deviation)
    nothing = Difference(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert nothing.effect == 0.0 and nothing._replace(difference=-1.0).effect == -math.inf


def test_intervals_of_differences():
    """Newcombe's of shares by hand; of others the quantiles of means of drawn episodes, and each way round."""
    for paired, *runs in samples(3):
        one, other = left(paired, *runs)
        if not (len(one) and len(other)):
            continue
        found = difference(*runs, paired)
        if is_share(one, other):
            ends = [stats.binomtest(int(v.sum()), len(v)).proportion_ci(0.95, "wilson") for v in (one, other)]
            p, q, phi = one.mean(), other.mean(), 0.0
            if paired:
                table = np.array([[((one == i) & (other == j)).sum() for j in (1, 0)] for i in (1, 0)], float)
                odds = np.linalg.det(table)
                odds = max(odds - len(one) / 2, 0.0) if odds > 1e-9 else odds
                product = np.prod([*table.sum(0), *table.sum(1)])
                phi = odds / math.sqrt(product) if product else 0.0
            down = np.array([q - ends[1].low, ends[0].high - p])
            up = np.array([ends[1].high - q, p - ends[0].low])
            matrix = np.array([[1.0, -phi], [-phi, 1.0]])
            low, high = (q - p + sign * math.sqrt(max(v @ matrix @ v, 0.0)) for sign, v in ((-1, down), (1, up)))
            assert (found.low, found.high) == pytest.approx((low, high), abs=1e-7)
        elif min(len(one), len(other)) > 8:
            error = (
                np.std(other - one) / math.sqrt(len(one))
                if paired
                else math.hypot(*(v.std() / math.sqrt(len(v)) for v in (one, other)))
            )
            np.testing.assert_allclose(
                [found.low, found.high], found.difference + 1.96 * error * np.array([-1, 1]), atol=0.55 * error
            )


def test_intervals_of_skewed_differences_are_the_bootstraps():
    random = np.random.default_rng(4)
    one, other = random.exponential(1.0, 25), random.exponential(4.0, 40)
    for paired, runs in ((False, (one, other)), (False, (other, one)), (True, (one, other[:25]))):
        if paired:
            drawn, mean = (runs[1] - runs[0],), np.mean
        else:
            drawn, mean = runs, lambda a, b, axis: b.mean(axis) - a.mean(axis)
        theirs = stats.bootstrap(drawn, mean, n_resamples=8000, method="percentile", rng=1)
        found = difference(*runs, paired)
        noise = 0.2 * float(theirs.standard_error)
        np.testing.assert_allclose([found.low, found.high], tuple(theirs.confidence_interval), atol=noise)


def test_holm_by_its_definition():
    """A p-value times the number of those that are not smaller, and never below what a smaller one became."""
    random = np.random.default_rng(5)
    for number in (1, 2, 3, 8, 20):
        p = random.uniform(0.0, 0.3, number) ** 2
        p[random.random(number) < 0.2] = np.nan
        kept = p[np.isfinite(p)]
        expected = [max(min(1.0, (kept >= v).sum() * v) for v in kept if v <= x) if x == x else np.nan for x in p]
        np.testing.assert_allclose(holm(p.tolist()), expected, rtol=1e-12)
    assert holm([0.5, 0.6]) == [1.0, 1.0] and holm([]) == []


@pytest.mark.parametrize(("strata", "size"), [(1, 4), (2, 5), (5, 3), (2, 12)])
def test_stratified_weights_have_students_freedom(strata, size):
    """A block that is not drawn has 1 - f, with f the factor: freedom / f squared is chi-square of that freedom."""
    weights = bootstrap.stratified_resamples(strata, size).reshape(-1, strata, size)
    np.testing.assert_allclose(weights.mean(-1), 1.0, atol=1e-5)
    freedom = strata * (size - 1)
    square = freedom / (1.0 - weights.min((1, 2))) ** 2
    assert square.mean() == pytest.approx(freedom, rel=0.05)
    assert square.var() == pytest.approx(2 * freedom, rel=0.15)
    assert stats.kstest(square, stats.chi2(freedom).cdf).pvalue > 0.01
    # Without the factor, the variance of a mean is that of its blocks.
    plain = 1.0 + (weights - 1.0) / (1.0 - weights.min((1, 2)))[:, None, None]
    data = np.random.default_rng(1).normal(0.0, 1.0 + np.arange(strata)[:, None], (strata, size))
    means = (plain * data).mean((1, 2))
    assert means.var() == pytest.approx((data.var(1, ddof=1) / size).sum() / strata**2, rel=0.12)
    another = bootstrap.stratified_resamples(strata, size, 1).reshape(weights.shape)
    assert (another != weights).any()


@pytest.mark.parametrize(("strata", "size", "future"), [(1, 60, 10), (2, 30, 4), (4, 12, 2)])
def test_predictive_weights_vary_as_new_means_do(strata, size, future):
    weights = bootstrap.predictive_resamples(strata, size, future).reshape(-1, strata, size)
    freedom = strata * (size - 1)
    data = np.random.default_rng(2).normal(0.0, 1.0 + np.arange(strata)[:, None], (strata, size))
    means = (weights * data).mean((1, 2))
    square = data.var(1, ddof=1).sum() / strata**2 * (1 / future + 1 / size)
    assert means.var() == pytest.approx(square * freedom / (freedom - 2), rel=0.1)
    factor = (1.0 - weights.min((1, 2))) / math.sqrt((size + future) / (size - 1))
    assert (freedom / factor**2).var() == pytest.approx(2 * freedom, rel=0.15)
    assert (freedom / factor**2).mean() == pytest.approx(freedom, rel=0.05)


@pytest.mark.parametrize("sizes", [(3, 2, 4), (1, 5, 2), (8, 1, 1)])
def test_hierarchical_weights_make_students_distribution_of_the_outermost_groups(sizes):
    groups = next(size for size in sizes if size > 1)
    each = bootstrap.hierarchical_resamples(sizes).reshape(-1, groups, math.prod(sizes) // groups)
    np.testing.assert_array_equal(each, each[..., :1].repeat(each.shape[-1], -1))
    values = np.random.default_rng(3).normal(size=groups)
    means = (each[..., 0] * values).mean(1)
    scaled = (means - values.mean()) / (values.std(ddof=1) / math.sqrt(groups))
    assert stats.kstest(scaled, stats.t(groups - 1).cdf).pvalue > 0.01


def flat(*seeds: float) -> np.ndarray:
    """Shares of an entry whose seeds have these in two tracks; no resample differs."""
    return np.stack([np.repeat(np.array(seeds)[:, None] + shift, 50, 1) for shift in (0.1, -0.1)])


def differ(one: np.ndarray, other: np.ndarray) -> tuple[tuple[float, float, float], float]:
    return ranks._difference(one, other, lambda: 0)


def test_differences_of_seeds_are_welchs():
    """Where episodes do not vary, all is scipy's; entries of one seed have no variance between seeds."""
    first, second = [0.52, 0.61, 0.55], [0.70, 0.58, 0.66, 0.75]
    (middle, low, high), p = differ(flat(*first), flat(*second))
    test = stats.ttest_ind(second, first, equal_var=False)
    assert p == pytest.approx(test.pvalue) and middle == pytest.approx(100 * (np.mean(second) - np.mean(first)))
    assert (low / 100, high / 100) == pytest.approx(tuple(test.confidence_interval(0.95)))
    (middle, low, high), p = differ(flat(0.9), flat(*second))
    test = stats.ttest_1samp(second, 0.9)
    assert p == pytest.approx(test.pvalue) and middle < 0
    assert (low / 100 + 0.9, high / 100 + 0.9) == pytest.approx(tuple(test.confidence_interval(0.95)))
    assert differ(flat(0.9), flat(0.8)) == (pytest.approx((-10.0, -10.0, -10.0)), 0.0)
    same, p = differ(flat(0.9), flat(0.9))
    assert same == (0.0, 0.0, 0.0) and math.isnan(p)


def test_variances_of_seeds_and_of_episodes_add_up():
    random = np.random.default_rng(6)
    one, other = (random.normal(0.5, 0.05, (1, n, 400)) for n in (3, 5))
    (middle, low, high), p = differ(one, other)
    shares = [100 * one[0], 100 * other[0]]
    parts = [share[:, 0].var(ddof=1) / len(share) for share in shares]
    gaps = shares[1][:, 1:].mean(0) - shares[0][:, 1:].mean(0)
    square = gaps.var(ddof=1) + sum(parts)
    freedom = square**2 / (parts[0] ** 2 / 2 + parts[1] ** 2 / 4)
    exact = stats.t(freedom, middle, math.sqrt(square))
    assert middle == pytest.approx(shares[1][:, 0].mean() - shares[0][:, 0].mean())
    assert (low, high) == pytest.approx(exact.interval(0.95)) and p == pytest.approx(2 * min(exact.cdf(0), exact.sf(0)))


def test_few_episodes_that_differ_have_no_small_p():
    """Five of 400 differ, all one way: permutations of them have no p-value below 1/16, whatever Student says."""
    for tracks in ([5], [2, 3]):
        one, other = np.zeros((2, len(tracks), 1, 301))
        for k, number in enumerate(tracks):
            other[k] = number / 400
            other[k, :, 1:] += np.random.default_rng(k).normal(0.0, 1e-5, 300)
        for pair in ((one, other), (other, one)):
            assert ranks._difference(*pair, lambda: 5)[1] == 2.0**-4


def test_sums_and_figures_of_entries():
    """Violations a minute, shares of tasks, and their intervals, from the columns of the episodes."""
    random = np.random.default_rng(7)

    def columns() -> dict:
        counts = random.poisson([[0.5, 0.3, 0.0, 0.2, 0.1, 0.0]], (60, 6)).astype(float)
        time = random.uniform(0.0, 60.0, (60, 6)) * [1, 1, 1, 0, 1, 0]
        fault = {name: np.zeros((60, 6)) for name in scores.ROBOTS_FAULT}
        return fault | {
            "completed": random.random(60) < 0.8,
            "intimate_robot_on_person": counts,
            "time_in_situation": time,
        }

    tracks = ["a", "b"]
    for seeds in (1, 3):
        entry = ranks.Entry("it", "raw", seeds > 1, [{track: columns() for track in tracks} for _ in range(seeds)])
        (row,) = ranks.rank([entry], {"one": tracks}, []).rows
        rates, shares = [], []
        for measured in entry.measured:
            events, minutes = np.zeros(5), np.zeros(5)
            share = []
            for track in tracks:
                events += measured[track]["intimate_robot_on_person"][:, 1:].sum(0) / 60
                minutes += measured[track]["time_in_situation"][:, 1:].sum(0) / 60 / 60.0
                share.append(np.mean([done and not any(measured[track][n][k, 0] > 0 for n in scores.ROBOTS_FAULT)
                                      for k, done in enumerate(measured[track]["completed"])]))  # fmt: skip
            rates.append([e / m if m else e for e, m in zip(events, minutes, strict=True)])
            shares.append(100 * np.mean(share))
        np.testing.assert_allclose(row.violations.mean, np.mean(rates, 0), rtol=1e-9)
        assert float(row.of["all"].mean) == pytest.approx(np.mean(shares)) and row.of["all"].episodes == 120
        if seeds > 1:
            half = stats.t.ppf(0.975, seeds - 1) * stats.sem(rates, 0)
            np.testing.assert_allclose(row.violations.high, np.mean(rates, 0) + half, rtol=1e-9)
            np.testing.assert_allclose(row.violations.low, np.maximum(np.mean(rates, 0) - half, 0.0), atol=1e-12)
            assert row.seeds == "3"
        else:
            assert (row.violations.low <= row.violations.mean).all() and row.seeds == "-"
            assert row.violations.high[0] > row.violations.mean[0] > row.violations.low[0] > 0.0


def test_the_effective_number_of_clusters_is_kishs():
    """Wilson's interval holds the x with (p - x)^2 <= z^2 x (1 - x) / n; n follows from the width, in its limits."""
    z, p = stats.norm.ppf(0.975), 0.4
    for width, number in ((0.3, 4 * z**2 * p * (1 - p) / 0.3**2), (0.2, 60), (0.9, 20)):
        given = bootstrap.Estimate(*map(np.asarray, (p, p - width / 2, p + width / 2, 60)))
        found = bootstrap.of_share(given, cluster=3)
        ends = np.sort(np.roots([1 + z**2 / number, -2 * p - z**2 / number, p * p]))
        np.testing.assert_allclose([found.low, found.high], ends)


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_levels_are_shares_between_none_and_all(level):
    with pytest.raises(ValueError, match="level: .* must lie between 0 and 1"):
        bootstrap.interval(np.arange(9.0), level)


@pytest.mark.parametrize("level", [0.9, 0.95])
def test_the_bound_where_nothing_was_counted_is_garwoods(level):
    """Half a chi-square quantile of two degrees of freedom over independent numbers; other counts stay as they are."""
    number = np.array([40, 40, 40, 0, 2])
    mean, low, high = np.array([0.0, 1.0, 0.3, 0.0, 0.0]), np.zeros(5), np.array([0.0, 1.4, 0.5, 0.0, 0.0])
    given = bootstrap.Estimate(mean, low, high, number)
    quantile = stats.chi2.ppf((1 + level) / 2, 2) / 2
    for cluster in (1, 5):
        found = bootstrap.of_count(given, level, cluster)
        expected = [quantile / (40 / cluster), 1.4, 0.5, 0.0, quantile / max(2 / cluster, 1)]
        np.testing.assert_allclose(found.high, expected, rtol=1e-9)
        assert found.low is low and found.mean is mean and found.episodes is number

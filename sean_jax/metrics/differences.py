"""Differences of a figure between two runs: interval, effect and p-value; and the correction for many tests.

Runs of the same episodes are compared by the differences of each episode, so the difficulty of an episode cancels.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sean_jax.metrics.bootstrap import Estimate, aggregate, interval, of_share, resamples


class Difference(NamedTuple):
    """The means of a figure in two runs, and their difference."""

    first: float
    second: float
    difference: float  # second minus first
    low: float  # of its 95 % interval
    high: float
    deviation: float  # standard deviation of the differences of paired episodes; of the others, pooled
    p: float  # of equal means; NaN if no episode differs, which is not tested

    @property
    def effect(self) -> float:
        """Cohen's d, for paired episodes d_z: the difference in standard deviations, infinite if there is none."""
        if self.difference == 0.0:
            return 0.0
        if self.deviation > 0:
            return self.difference / self.deviation
        return math.copysign(math.inf, self.difference)


def difference(first: np.ndarray, second: np.ndarray, paired: bool) -> Difference | None:
    """The difference of two figures (E,) and (F,), where NaN is no value; None if nothing is left.

    Paired episodes (E = F) are used where both have a value. The interval is Newcombe's where a figure is 0 or 1 in
    each episode, and else the bootstrap's.

    Sources: R. Newcombe, "Interval estimation for the difference between independent proportions" (method 10) and
    "Improved confidence intervals for the difference between binomial proportions based on paired data" (method 10),
    Statistics in Medicine 17 (1998).
    """
    if paired:
        valid = np.isfinite(first) & np.isfinite(second)
        a = first[valid]
        b = second[valid]
    else:
        a = first[np.isfinite(first)]
        b = second[np.isfinite(second)]
    if not (len(a) and len(b)):
        return None

    if paired:
        gaps = b - a
        mean = float(gaps.mean())
        deviation = float(gaps.std(ddof=1)) if len(gaps) > 1 else 0.0
    else:
        mean = float(b.mean() - a.mean())
        deviation = _pooled_deviation(a, b)
    low, high = _newcombe(a, b, paired) if _is_share(a, b) else _bootstrap(first, second, paired)
    p = p_value(a, b, paired)
    return Difference(float(a.mean()), float(b.mean()), mean, low, high, deviation, p)


def p_value(a: np.ndarray, b: np.ndarray, paired: bool) -> float:
    """The p-value of equal means (E,) and (F,) in a test with two sides; NaN if no episode differs.

    Figures that are 0 or 1 in each episode have McNemar's exact test if they are paired, else Fisher's. All others have
    Student's test of the differences or Welch's; no p-value is smaller than permutations of so few episodes could give.
    """
    same = np.all(a == b) if paired else np.ptp(np.concatenate([a, b])) == 0
    if same:
        return math.nan
    if _is_share(a, b):
        if paired:
            return _mcnemar(b - a)
        return _fisher(a, b)
    p, smallest = _student(b - a) if paired else _welch(a, b)
    return float(min(max(p, smallest), 1.0))


def _mcnemar(gaps: np.ndarray) -> float:
    from scipy import stats

    above = int((gaps > 0).sum())
    different = int(np.count_nonzero(gaps))
    return float(stats.binomtest(above, different).pvalue)


def _fisher(a: np.ndarray, b: np.ndarray) -> float:
    from scipy import stats

    table = []
    for values in (a, b):
        count = int(values.sum())
        table.append([count, len(values) - count])
    return float(stats.fisher_exact(table).pvalue)  # pyright: ignore[reportAttributeAccessIssue]


def _student(gaps: np.ndarray) -> tuple[float, float]:
    """The p-value of differences, and the smallest one that permutations could give."""
    freedom = len(gaps) - 1
    square = gaps.var(ddof=1) / len(gaps) if freedom else 0.0
    smallest = math.ldexp(1.0, 1 - int(np.count_nonzero(gaps)))
    return _two_sided(gaps.mean(), square, freedom), smallest


def _welch(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """The p-value of two means, and the smallest one that permutations could give."""
    squares = [values.var(ddof=1) / len(values) if len(values) > 1 else 0.0 for values in (a, b)]
    square = sum(squares)
    shares = [part**2 / max(len(values) - 1, 1) for part, values in zip(squares, (a, b), strict=True)]
    freedom = square**2 / sum(shares) if square else 0.0
    p = _two_sided(b.mean() - a.mean(), square, freedom)
    permutations = math.comb(len(a) + len(b), len(a))
    return p, 2 / permutations


def _two_sided(mean: float, square: float, freedom: float) -> float:
    """The p-value of a mean of this squared standard error; 0 without any."""
    from scipy import stats

    if not square:
        return 0.0
    statistic = abs(mean) / math.sqrt(square)
    return 2 * float(stats.t.sf(statistic, freedom))


def holm(p: Sequence[float]) -> list[float]:
    """P-values that are corrected for their number; NaN is no test.

    The probability of any false one below 0.05 is at most 5 %.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
    (1979).
    """
    tests = sorted((value, k) for k, value in enumerate(p) if math.isfinite(value))
    largest = 0.0
    corrected = [math.nan] * len(p)
    for rank, (value, k) in enumerate(tests):
        remaining = len(tests) - rank
        largest = max(largest, min(1.0, remaining * value))
        corrected[k] = largest
    return corrected


def _is_share(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.isin(np.concatenate([a, b]), (0.0, 1.0)).all())


def _pooled_deviation(a: np.ndarray, b: np.ndarray) -> float:
    freedom = len(a) + len(b) - 2
    squares = ((a - a.mean()) ** 2).sum() + ((b - b.mean()) ** 2).sum()
    if freedom:
        return math.sqrt(squares / freedom)
    return 0.0


@functools.lru_cache(maxsize=2)  # 160 MB each at most
def _weights(episodes: int, seed: int) -> np.ndarray:
    return resamples(episodes, seed).astype(np.float64)  # products with float64 need no copy of it


def _bootstrap(first: np.ndarray, second: np.ndarray, paired: bool) -> tuple[float, float]:
    if paired:
        estimate = aggregate(second - first, weights=_weights(len(first), 0))
        return float(estimate.low), float(estimate.high)
    first_means = _resampled_means(first, 0)
    second_means = _resampled_means(second, 1)
    count = min(len(first_means), len(second_means))
    gaps = second_means[:count] - first_means[:count]
    low, high = interval(gaps[np.isfinite(gaps)])
    return float(low), float(high)


def _resampled_means(values: np.ndarray, seed: int) -> np.ndarray:
    """(R,) means of the finite values in resamples; NaN without any."""
    weights = _weights(len(values), seed)
    finite = np.isfinite(values)
    number = weights @ finite
    total = weights @ np.where(finite, values, 0.0)
    return np.where(number > 0, total, np.nan) / np.maximum(number, 1)


def _newcombe(a: np.ndarray, b: np.ndarray, paired: bool) -> tuple[float, float]:
    """The interval of the difference of two shares, from Wilson's interval of each."""
    p, p_low, p_high = _wilson(a)
    q, q_low, q_high = _wilson(b)
    phi = _phi(a, b) if paired else 0.0

    # How far each share may be below and above its estimate.
    p_down = p - p_low
    p_up = p_high - p
    q_down = q - q_low
    q_up = q_high - q
    down = q_down**2 - 2 * phi * q_down * p_up + p_up**2
    up = q_up**2 - 2 * phi * q_up * p_down + p_down**2
    low = q - p - math.sqrt(max(down, 0.0))
    high = q - p + math.sqrt(max(up, 0.0))
    return low, high


def _wilson(values: np.ndarray) -> tuple[float, float, float]:
    """A share and its interval."""
    mean = np.asarray(values.mean())
    share = of_share(Estimate(mean, mean, mean, np.asarray(len(values))))
    return float(share.mean), float(share.low), float(share.high)


def _phi(a: np.ndarray, b: np.ndarray) -> float:
    """The correlation of paired shares, with Newcombe's correction for continuity."""
    both = float((a * b).sum())
    neither = float(((1 - a) * (1 - b)).sum())
    only_a = float((a * (1 - b)).sum())
    only_b = float(((1 - a) * b).sum())
    sides = (both + only_a) * (only_b + neither) * (both + only_b) * (only_a + neither)
    product = both * neither - only_a * only_b
    if product > 0:
        product = max(product - len(a) / 2, 0.0)
    if sides:
        return product / math.sqrt(sides)
    return 0.0

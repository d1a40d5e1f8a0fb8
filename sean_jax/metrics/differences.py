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
        return self.difference / self.deviation if self.deviation > 0 else math.copysign(math.inf, self.difference)


def difference(first: np.ndarray, second: np.ndarray, paired: bool) -> Difference | None:
    """The difference of two figures (E,) and (F,), where NaN is no value; None if nothing is left.

    Paired episodes (E = F) are used where both have a value. The interval is Newcombe's where a figure is 0 or 1 in
    each episode, and else the bootstrap's.

    Sources: R. Newcombe, "Interval estimation for the difference between independent proportions" (method 10) and
    "Improved confidence intervals for the difference between binomial proportions based on paired data" (method 10),
    Statistics in Medicine 17 (1998).
    """
    if paired:
        both = np.isfinite(first) & np.isfinite(second)
        one, other = first[both], second[both]
    else:
        one, other = first[np.isfinite(first)], second[np.isfinite(second)]
    if not (len(one) and len(other)):
        return None
    middle, deviation = float(other.mean() - one.mean()), _pooled(one, other)
    if paired:
        middle, deviation = float((other - one).mean()), float((other - one).std(ddof=1)) if len(one) > 1 else 0.0
    low, high = _newcombe(one, other, paired) if _is_share(one, other) else _bootstrap(first, second, paired)
    p = p_value(one, other, paired)
    return Difference(float(one.mean()), float(other.mean()), middle, low, high, deviation, p)


def p_value(one: np.ndarray, other: np.ndarray, paired: bool) -> float:
    """The p-value of equal means (E,) and (F,) in a test with two sides; NaN if no episode differs.

    Figures that are 0 or 1 in each episode have McNemar's exact test if they are paired, else Fisher's. All others have
    Student's test of the differences or Welch's; no p-value is smaller than permutations of so few episodes could give.
    """
    from scipy import stats

    if np.all(one == other) if paired else np.ptp(np.concatenate([one, other])) == 0:
        return math.nan
    gaps = other - one if paired else np.zeros(0)
    changed = int(np.count_nonzero(gaps))
    if _is_share(one, other):
        if paired:
            return float(stats.binomtest(int((gaps > 0).sum()), changed).pvalue)
        table = [[int(part.sum()), len(part) - int(part.sum())] for part in (one, other)]
        return float(stats.fisher_exact(table).pvalue)  # pyright: ignore[reportAttributeAccessIssue]
    if paired:
        fewest, freedom = math.ldexp(1.0, 1 - changed), len(gaps) - 1
        middle, square = gaps.mean(), gaps.var(ddof=1) / len(gaps) if freedom else 0.0
    else:
        fewest, squares = 2 / math.comb(len(one) + len(other), len(one)), []
        for part in (one, other):
            squares.append(part.var(ddof=1) / len(part) if len(part) > 1 else 0.0)
        middle, square = other.mean() - one.mean(), sum(squares)
        shares = [part**2 / max(len(each) - 1, 1) for part, each in zip(squares, (one, other), strict=True)]
        freedom = square**2 / sum(shares) if square else 0.0
    p = 2 * float(stats.t.sf(abs(middle) / math.sqrt(square), freedom)) if square else 0.0
    return float(min(max(p, fewest), 1.0))


def holm(p: Sequence[float]) -> list[float]:
    """P-values that are corrected for their number; NaN is no test.

    The probability of any false one below 0.05 is at most 5 %.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
    (1979).
    """
    tests = sorted((value, k) for k, value in enumerate(p) if math.isfinite(value))
    largest, corrected = 0.0, [math.nan] * len(p)
    for rank, (value, k) in enumerate(tests):
        largest = max(largest, min(1.0, (len(tests) - rank) * value))
        corrected[k] = largest
    return corrected


def _is_share(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.isin(np.concatenate([one, other]), (0.0, 1.0)).all())


def _pooled(one: np.ndarray, other: np.ndarray) -> float:
    freedom = len(one) + len(other) - 2
    squares = ((one - one.mean()) ** 2).sum() + ((other - other.mean()) ** 2).sum()
    return math.sqrt(squares / freedom) if freedom else 0.0


@functools.lru_cache(maxsize=2)  # 160 MB each at most
def _weights(episodes: int, seed: int) -> np.ndarray:
    return resamples(episodes, seed).astype(np.float64)  # products with float64 need no copy of it


def _bootstrap(first: np.ndarray, second: np.ndarray, paired: bool) -> tuple[float, float]:
    if paired:
        estimate = aggregate(second - first, weights=_weights(len(first), 0))
        return float(estimate.low), float(estimate.high)
    means = []
    for seed, part in enumerate((first, second)):
        weights, finite = _weights(len(part), seed), np.isfinite(part)
        number = weights @ finite
        means.append(np.where(number > 0, weights @ np.where(finite, part, 0.0), np.nan) / np.maximum(number, 1))
    count = min(map(len, means))
    gaps = means[1][:count] - means[0][:count]
    low, high = interval(gaps[np.isfinite(gaps)])
    return float(low), float(high)


def _newcombe(one: np.ndarray, other: np.ndarray, paired: bool) -> tuple[float, float]:
    """The interval of the difference of two shares, from Wilson's interval of each."""
    (p, below, above), (q, under, over) = _wilson(one), _wilson(other)
    phi = _phi(one, other) if paired else 0.0
    down = (q - under) ** 2 - 2 * phi * (q - under) * (above - p) + (above - p) ** 2
    up = (over - q) ** 2 - 2 * phi * (over - q) * (p - below) + (p - below) ** 2
    return q - p - math.sqrt(max(down, 0.0)), q - p + math.sqrt(max(up, 0.0))


def _wilson(values: np.ndarray) -> tuple[float, float, float]:
    """A share and its interval."""
    mean = np.asarray(values.mean())
    share = of_share(Estimate(mean, mean, mean, np.asarray(len(values))))
    return float(share.mean), float(share.low), float(share.high)


def _phi(one: np.ndarray, other: np.ndarray) -> float:
    """The correlation of paired shares, with Newcombe's correction for continuity."""
    both, first = float((one * other).sum()), float((one * (1 - other)).sum())
    second, none = float(((1 - one) * other).sum()), float(((1 - one) * (1 - other)).sum())
    sides = (both + first) * (second + none) * (both + second) * (first + none)
    product = both * none - first * second
    if product > 0:
        product = max(product - len(one) / 2, 0.0)
    return product / math.sqrt(sides) if sides else 0.0

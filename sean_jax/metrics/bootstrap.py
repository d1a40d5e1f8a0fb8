"""Bootstrap intervals over many episodes (section V): of means, of ratios of sums, of any figure.

Episodes are drawn with replacement and the figure is computed again for each resample (Efron 1979). The interval holds
the middle 95 % of the results: the variation of the figure over seeds. Table I draws chains of episodes
instead of episodes, and figures of its own. All of this runs at the end, on the host and in double precision.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sean_jax.core.errors import InputError

RESAMPLES = 2000
MIN_RESAMPLES = 200  # where there are so many episodes that more of them would not fit in memory
ENTRIES = 20_000_000  # of the table of resamples, 80 MB
UNBOUNDED = (-math.inf, math.inf)


class Estimate(NamedTuple):
    """A figure over episodes. No number is NaN: where ``episodes`` is 0, the others are 0 and mean nothing."""

    mean: np.ndarray  # () or (1 + S,)
    low: np.ndarray  # same shape, lower end of the interval
    high: np.ndarray  # same shape, upper end
    episodes: np.ndarray  # same shape, int, number of episodes


def aggregate(
    values: ArrayLike,
    applies: ArrayLike | None = None,
    *,
    seed: int = 0,
    level: float = 0.95,
    weights: np.ndarray | None = None,
    bounds: tuple[float, float] = UNBOUNDED,
) -> Estimate:
    """The mean over episodes and its bootstrap interval, for each column.

    ``jax.tree.map(aggregate, measured)`` does all metrics of a dict.

    Args:
        values: (E,) or (E, 1 + S), a metric as ``results`` gives it for each of E episodes.
        applies: of the same shape, bool: which values count; by default the finite ones, for a mean or an extreme over
            a situation that never occurred is NaN. The other values may be anything.
        seed: of the resamples; equal seeds draw the same episodes, so that figures can be compared.
        level: share of the resamples that the interval holds.
        weights: (R, E) from ``resamples``, instead of drawing them from the seed; one draw can serve many metrics.
        bounds: the least and the largest value that the figure can have, such as 0 and 1 for a share: some weights may
            be negative (``hierarchical_resamples``), and then the interval is cut off there.

    Raises:
        InputError: there is no episode, shapes differ, or a value that applies is not finite.
    """
    values = np.asarray(values, np.float64)
    applies = np.isfinite(values) if applies is None else np.asarray(applies)
    if applies.shape != values.shape or applies.dtype != bool:
        raise InputError(
            f"applies: {applies.dtype} {applies.shape} must be bool of the shape {values.shape} of values."
        )
    return aggregate_ratio(
        np.where(applies, values, 0.0),
        applies.astype(np.float64),
        seed=seed,
        level=level,
        weights=weights,
        bounds=bounds,
    )


def aggregate_ratio(
    numerator: ArrayLike,
    denominator: ArrayLike,
    *,
    seed: int = 0,
    level: float = 0.95,
    weights: np.ndarray | None = None,
    bounds: tuple[float, float] = UNBOUNDED,
) -> Estimate:
    """``sum(numerator) / sum(denominator)`` over episodes and its bootstrap interval, for each column.

    Shares of time are such ratios. Resamples whose denominator is zero have no ratio and are left out.

    Args:
        numerator: (E,) or (E, 1 + S).
        denominator: of the same shape, not negative; ``episodes`` counts where it is above 0.
        seed, level, weights, bounds: as in ``aggregate``.

    Raises:
        InputError: there is no episode, shapes differ, a number is not finite, or a denominator is negative.
    """
    above = np.asarray(numerator, np.float64)
    below = np.asarray(denominator, np.float64)
    if above.shape != below.shape or above.ndim not in (1, 2) or not above.size:
        shapes = f"{above.shape} and {below.shape}"
        raise InputError(f"episodes: shapes {shapes} must be equal, (E,) or (E, 1 + S), with an E of 1 or more.")
    if not (np.isfinite(above).all() and np.isfinite(below).all()):
        raise InputError("values: one that counts is not finite; leave its episode out, or say that it does not apply.")
    if (below < 0).any():
        raise InputError(f"denominator: {below.min():g} is negative; give weights, counts or times of 0 or more.")
    _check_level(level)
    weights = resamples(len(above), seed) if weights is None else weights
    shape = above.shape[1:]
    columns = above.reshape(len(above), -1).T, below.reshape(len(above), -1).T
    estimates = [_column(top, bottom, weights, level, bounds) for top, bottom in zip(*columns, strict=True)]
    mean, low, high = (np.array(values).reshape(shape) for values in zip(*estimates, strict=True))
    episodes = np.count_nonzero(below, axis=0) * np.ones(shape, np.int64)
    return Estimate(mean, low, high, episodes)


def resamples(episodes: int, seed: int = 0, count: int | None = None, cluster: int = 1) -> np.ndarray:
    """(R, E) float32, number of times that each of E episodes (or blocks) is in each of R resamples.

    R is 2000 if ``count`` is None, and less with more than 10,000 episodes.

    Args:
        cluster: number of successive rows that are drawn together, such as the robots of a team; it divides E.
    """
    if count is None:
        count = int(np.clip(ENTRIES // episodes, MIN_RESAMPLES, RESAMPLES))
    draw = np.random.default_rng(seed)
    number = episodes // cluster
    drawn = draw.multinomial(number, np.full(number, 1 / number), size=count).astype(np.float32)
    return np.repeat(drawn, cluster, axis=1)


def stratified_resamples(strata: int, size: int, seed: int = 0) -> np.ndarray:
    """(R, strata * size) float32 weights of independent blocks in resamples, with mean 1 in each stratum.

    The share of each stratum is fixed, so only blocks within a stratum vary. Weights are rescaled to an unbiased
    variance and to Student's distribution, so they are no counts, and a weight may be negative.

    Args:
        strata: number of strata, whose blocks come one stratum after another.
        size: number of blocks of each, 2 or more.

    Source: J. Rao and C. Wu, "Resampling inference with complex survey data", Journal of the American Statistical
    Association 83 (1988), with size - 1 draws.
    """
    draw = np.random.default_rng(seed)
    counts = draw.multinomial(size - 1, np.full(size, 1 / size), size=(RESAMPLES, strata))
    return _students(size / (size - 1) * counts, strata * (size - 1), draw)


def predictive_resamples(strata: int, size: int, future: int, seed: int = 0) -> np.ndarray:
    """(R, strata * size) float32 weights as of ``stratified_resamples``, for the mean of ``future`` new blocks.

    The resamples vary by as much as a mean over so few new blocks of each stratum differs from the mean over all: by
    the blocks' variance times (1 / future + 1 / size).
    """
    draw = np.random.default_rng(seed)
    counts = draw.multinomial(future, np.full(size, 1 / size), size=(RESAMPLES, strata))
    wider = math.sqrt((size + future) / (size - 1))
    weights = 1.0 + wider * (size / future * counts - 1.0)
    return _students(weights, strata * (size - 1), draw)


def _students(weights: np.ndarray, freedom: int, draw: np.random.Generator) -> np.ndarray:
    """(R, strata * size) of weights (R, strata, size) of mean 1, so that normal means have Student's distribution."""
    factor = np.sqrt(freedom / draw.chisquare(freedom, (len(weights), 1, 1)))
    weights = 1.0 + factor * (weights - 1.0)
    return weights.reshape(len(weights), -1).astype(np.float32)


def hierarchical_resamples(sizes: Sequence[int]) -> np.ndarray:
    """(R, E) float32 weights of episodes in resamples, where groups of episodes are random themselves.

    Networks that were trained with several seeds on several datasets are such groups. Only the outermost level with
    several groups is independent; the spread of their means contains the levels below, which would otherwise count
    twice. There are few of them, so the weights are not counts: they make the interval of a mean equal to Student's
    distribution; a weight may be negative. ``aggregate`` cuts such an interval off at the ``bounds`` of the figure.

    Args:
        sizes: number of groups at each level, and last the number of episodes of each innermost group: (10, 3, 410).
            E is their product; the episodes of the first dataset's first seed come first.

    Source: D. Rubin, "The Bayesian bootstrap", Annals of Statistics 9 (1981), for weights that are no counts.
    """
    number = math.prod(sizes)
    count = int(np.clip(ENTRIES // number, MIN_RESAMPLES, RESAMPLES))
    groups = next((size for size in sizes if size > 1), 1)
    if groups == 1:
        return np.ones((count, number), np.float32)
    draw = np.random.default_rng(0)
    normal = draw.standard_normal((count, groups))
    scale = np.sqrt(groups / draw.chisquare(groups - 1, (count, 1)))
    student = (normal - normal.mean(1, keepdims=True)) * scale
    return np.repeat(1.0 + student, number // groups, axis=1).astype(np.float32)


def of_share(estimate: Estimate, level: float = 0.95, where: ArrayLike = True, cluster: int = 1) -> Estimate:
    """The estimate of a share of independent episodes, with Wilson's interval: 80.6 to 100 % for 16 of 16 episodes.

    Rows of a cluster depend on each other. Their effective number follows from the width of the bootstrap interval
    (Kish's design effect); it is between the number of clusters and the number of rows.

    Args:
        where: bool; the interval of other entries stays as it is.
        cluster: number of rows that the bootstrap of the estimate has drawn together.

    Raises:
        InputError: the level does not lie between 0 and 1.

    Sources: E. Wilson, "Probable inference", Journal of the American Statistical Association 22 (1927); L. Kish,
    "Survey Sampling" (1965), section 8.2.
    """
    _check_level(level)
    square = NormalDist().inv_cdf((1 + level) / 2) ** 2
    known = (estimate.episodes > 0) & np.asarray(where)
    share = np.where(known, estimate.mean, 0.0)
    number = np.maximum(estimate.episodes, 1)
    if cluster > 1:
        width = np.maximum(estimate.high - estimate.low, 1e-9)
        number = np.clip(4 * square * share * (1 - share) / width**2, number / cluster, number)

    scale = 1 + square / number
    middle = (share + square / (2 * number)) / scale
    half = np.sqrt(square * (share * (1 - share) + square / (4 * number)) / number) / scale
    low = np.where(share == 0, 0.0, middle - half)
    high = np.where(share == 1, 1.0, middle + half)
    low = np.where(known, low, estimate.low)
    high = np.where(known, high, estimate.high)
    return estimate._replace(low=low, high=high)


def of_count(estimate: Estimate, level: float = 0.95, cluster: int = 1) -> Estimate:
    """The estimate of a count per episode, with the exact interval of a Poisson number where no event occurred.

    Other counts keep their bootstrap interval, for events of one episode depend on each other.

    Args:
        cluster: number of rows that depend on each other; together they are one number.

    Raises:
        InputError: the level does not lie between 0 and 1.

    Source: F. Garwood, "Fiducial limits for the Poisson distribution", Biometrika 28 (1936).
    """
    _check_level(level)
    none = (estimate.mean == 0) & (estimate.episodes > 0)
    high = -math.log((1 - level) / 2) / np.maximum(estimate.episodes / cluster, 1)
    return estimate._replace(high=np.where(none, high, estimate.high))


def with_estimate(weights: np.ndarray) -> np.ndarray:
    """(1 + R, E) weights, each row of sum one, for the mean over all episodes and over resamples (R, E)."""
    episodes = weights.shape[1]
    return np.concatenate([np.ones((1, episodes)), weights]) / episodes


def interval(samples: ArrayLike, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper end (...) of the percentile interval of a figure (R, ...) of each resample.

    Raises:
        InputError: the level does not lie between 0 and 1.
    """
    _check_level(level)
    low, high = np.quantile(np.asarray(samples), [(1 - level) / 2, (1 + level) / 2], axis=0)
    return low, high


def _check_level(level: float) -> None:
    if not 0 < level < 1:
        raise InputError(f"level: {level} must lie between 0 and 1, such as 0.95.")


def _column(
    above: np.ndarray, below: np.ndarray, weights: np.ndarray, level: float, bounds: tuple[float, float]
) -> tuple[float, float, float]:
    """Ratio and ends of the interval of (E,) over (E,)."""
    total = below.sum()
    if total <= 0:
        return 0.0, 0.0, 0.0
    bottom = weights @ below
    ratio = above.sum() / total
    low, high = np.clip(interval((weights @ above)[bottom > 0] / bottom[bottom > 0], level), *bounds)
    return ratio, float(low), float(high)

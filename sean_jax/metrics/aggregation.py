"""Metrics over many episodes (section V): means, or ratios of sums, with bootstrap intervals.

Episodes are drawn with replacement and the figure is computed anew for each such resample (Efron 1979); the interval
holds the middle 95 % of what comes out. It says how much the figure would change with other seeds. This is done at the
end, on the host and in double precision; nothing here is traced.
"""

from typing import NamedTuple

import numpy as np

RESAMPLES = 2000
LEAST_RESAMPLES = 200  # where there are so many episodes that more of them would not fit in memory
ENTRIES = 20_000_000  # of the table of resamples, 80 MB


class Estimate(NamedTuple):
    """A figure over episodes; no number is NaN: where ``episodes`` is 0 the others are 0 and mean nothing."""

    mean: np.ndarray  # () or (1 + S,)
    low: np.ndarray  # likewise, lower end of the interval
    high: np.ndarray  # likewise, upper end
    episodes: np.ndarray  # likewise, int, how many it is made of


def aggregate(values, applies=None, *, seed: int = 0, level: float = 0.95, weights: np.ndarray | None = None):
    """The mean over episodes and its bootstrap interval, for each column.

    Args:
        values: (E,) or (E, 1 + S), a metric as ``results`` gives it for each of E episodes.
        applies: of the same shape, bool: which values count; by default those that are finite, for a mean or an
            extreme over a situation that never occurred is NaN. What does not apply may hold anything.
        seed: of the resamples; equal ones draw the same episodes, so that figures can be compared.
        level: share of the resamples that the interval holds.
        weights: (R, E) from ``resamples``, instead of drawing them from the seed; one draw can serve many metrics.

    Returns:
        an ``Estimate`` of the shape of an episode. ``jax.tree.map(aggregate, measured)`` does all metrics of a dict.

    Raises:
        ValueError: there is no episode, shapes differ, or a value that applies is not finite.
    """
    values = np.asarray(values, np.float64)
    applies = np.isfinite(values) if applies is None else np.asarray(applies)
    if applies.shape != values.shape or applies.dtype != bool:
        raise ValueError(
            f"applies: {applies.dtype} {applies.shape} must be bool of the shape {values.shape} of values."
        )
    return aggregate_ratio(
        np.where(applies, values, 0.0), applies.astype(np.float64), seed=seed, level=level, weights=weights
    )


def aggregate_ratio(numerator, denominator, *, seed: int = 0, level: float = 0.95, weights: np.ndarray | None = None):
    """``sum(numerator) / sum(denominator)`` over episodes and its bootstrap interval, for each column.

    Such are shares of time: that of all episodes together in a situation, over that of all together. Resamples whose
    denominator is zero have no ratio and are left out.

    Args:
        numerator: (E,) or (E, 1 + S).
        denominator: of the same shape, not negative; ``episodes`` counts where it is above 0.
        seed, level, weights: as in ``aggregate``.

    Raises:
        ValueError: there is no episode, shapes differ, or a number is not finite or below 0 in the denominator.
    """
    above, below = np.asarray(numerator, np.float64), np.asarray(denominator, np.float64)
    if above.shape != below.shape or above.ndim not in (1, 2) or not above.size:
        shapes = f"{above.shape} and {below.shape}"
        raise ValueError(f"episodes: shapes {shapes} must be equal, (E,) or (E, 1 + S), with an E of 1 or more.")
    if not (np.isfinite(above).all() and np.isfinite(below).all()):
        raise ValueError("values: one that counts is not finite; leave its episode out, or say that it does not apply.")
    if (below < 0).any():
        raise ValueError(f"denominator: {below.min():g} is negative; give weights, counts or times of 0 or more.")
    if not 0 < level < 1:
        raise ValueError(f"level: {level} must lie between 0 and 1, such as 0.95.")
    weights = resamples(len(above), seed) if weights is None else weights
    tops, bottoms = above.reshape(len(above), -1), below.reshape(len(above), -1)
    columns = [_column(top, bottom, weights, level) for top, bottom in zip(tops.T, bottoms.T, strict=True)]
    shape = above.shape[1:]
    mean, low, high = (np.array(part).reshape(shape) for part in zip(*columns, strict=True))
    return Estimate(mean, low, high, np.count_nonzero(below, axis=0) * np.ones(shape, np.int64))


def resamples(episodes: int, seed: int = 0) -> np.ndarray:
    """(R, E) float32 how often each episode is in each resample; fewer resamples where there are many episodes."""
    count = int(np.clip(ENTRIES // episodes, LEAST_RESAMPLES, RESAMPLES))
    draw = np.random.default_rng(seed)
    return draw.multinomial(episodes, np.full(episodes, 1 / episodes), size=count).astype(np.float32)


def _column(above: np.ndarray, below: np.ndarray, weights: np.ndarray, level: float) -> tuple[float, float, float]:
    """Ratio and ends of the interval of (E,) over (E,)."""
    total = below.sum()
    if total <= 0:
        return 0.0, 0.0, 0.0
    bottom = weights @ below
    drawn = (weights @ above)[bottom > 0] / bottom[bottom > 0]
    low, high = np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2])
    return above.sum() / total, low, high

"""Figures over the episodes of a run: shares of the situations and metrics, overall and by situation (Table I, Fig. 4).

Every figure is a ratio of two sums over episodes, so one bootstrap (``metrics.bootstrap``) serves them all.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax.metrics import Estimate, aggregate_ratio, resamples
from sean_jax.metrics.bootstrap import of_share

if TYPE_CHECKING:
    from sean_jax.evaluation import Evaluation


def aggregate(results: "Evaluation") -> dict[str, Any]:
    """Means with 95 % bootstrap intervals over episodes.

    By situation, a time or a count is the mean per episode of what fell into that situation. ``completed`` and metrics
    of completed episodes only are means over the episodes in which the situation occurred.

    Args:
        results: of E episodes. Without the metric ``time_in_situation`` it is unknown in which episodes a situation
            occurred, so what depends on it is None.

    Returns:
        ``{"situations": {situation: figure}, "metrics": {name: {column: figure}}}``. The columns are "overall" and the
        situations. A figure has a mean, an interval and the number of its episodes, or is None where there is none.
    """
    columns = ("overall", *results.situations)
    weights = resamples(len(results.completed))
    every = np.ones(len(results.completed))

    def by_column(values: np.ndarray, applies: np.ndarray, shares: bool = False) -> dict[str, Any]:
        estimate = aggregate_ratio(values * applies, applies, weights=weights)
        estimate = of_share(estimate) if shares else estimate
        return {
            name: _figure(Estimate(*(part[k] for part in estimate)))
            for k, name in enumerate(columns[: values.shape[1]])
        }

    shares, among = dict.fromkeys(results.situations), every[:, None]
    if (spent := results.metrics.get("time_in_situation")) is not None:  # (E, 1 + S) s
        shares = {
            name: _figure(aggregate_ratio(spent[:, k + 1], spent[:, 0], weights=weights))
            for k, name in enumerate(results.situations)
        }
        among = np.concatenate([among, spent[:, 1:] > 0], 1).astype(float)
    number = among.shape[1]
    figures = {"completed": by_column(np.repeat(results.completed[:, None], number, 1).astype(float), among, True)}
    for name, values in results.metrics.items():
        if name in ("completed", "timed_out"):
            continue
        completed_only = results.definitions[name].completed_only
        table = values.reshape(len(values), -1).astype(float)
        if completed_only:
            table = np.repeat(table, number, 1) if table.shape[1] == 1 else table[:, :number]
        applies = np.isfinite(table).astype(float)
        if completed_only:
            applies = applies * among * results.completed[:, None]
        figures[name] = by_column(np.where(np.isfinite(table), table, 0.0), applies)
    figures["seconds"] = by_column(results.seconds[:, None].astype(float), every[:, None])
    return {"situations": shares, "metrics": figures}


def _figure(estimate: Estimate) -> dict[str, Any] | None:
    """An estimate of shape () as the summary has it; None where it is made of no episode."""
    if not estimate.episodes:
        return None
    interval = [float(estimate.low), float(estimate.high)]
    return {"mean": float(estimate.mean), "interval": interval, "episodes": int(estimate.episodes)}


def exclusive_shares(results: "Evaluation") -> dict[str, float]:
    """Shares of robot time that add up to one: time in several situations is divided equally among them.

    Returns:
        Situation, or "none" for time in no situation, -> share from 0 to 1.
    """
    total = max(float(results.together.sum()), 1e-9)
    shares = dict.fromkeys((*results.situations, "none"), 0.0)
    for index in np.flatnonzero(results.together):
        names = [name for bit, name in enumerate(results.situations) if index >> bit & 1] or ["none"]
        for name in names:
            shares[name] += float(results.together[index]) / len(names) / total
    return shares

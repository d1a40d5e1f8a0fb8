"""Episodes summed up: shares of the situations and metrics overall and split by situation (Table I, Fig. 4).

Every figure is a ratio of two sums over episodes, so one bootstrap serves them all.
"""

from typing import Any

import numpy as np

from sean_jax.main_job.results import Results
from sean_jax.metrics import Estimate, aggregate_ratio, resamples

OF_COMPLETED = ("path_efficiency",)  # an unfinished path has no efficiency


def aggregate(results: Results) -> dict[str, Any]:
    """Means with 95 % bootstrap intervals over episodes: ``{"situations": ..., "metrics": ...}``.

    Metrics by situation: a time or a count is the mean per episode of what fell into that situation; ``completed``
    and ``path_efficiency`` are means over the episodes in which it occurred; None where it never did.
    """
    spent = results.metrics["time_in_situation"]  # (E, 1 + S) s
    occurred = spent[:, 1:] > 0
    columns = ("overall", *results.situations)
    weights = resamples(len(results.completed))
    every = np.ones(len(results.completed))

    def by_column(values: np.ndarray, among: np.ndarray) -> dict[str, Any]:
        return {
            name: _told(aggregate_ratio(values[:, k] * among[:, k], among[:, k], weights=weights))
            for k, name in enumerate(columns[: values.shape[1]])
        }

    shares = {
        name: _told(aggregate_ratio(spent[:, k + 1], spent[:, 0], weights=weights))
        for k, name in enumerate(results.situations)
    }
    among = np.concatenate([every[:, None], occurred], 1).astype(float)
    measured = {"completed": by_column(np.repeat(results.completed[:, None], len(columns), 1).astype(float), among)}
    for name, values in results.metrics.items():
        if name in ("completed", "timed_out"):
            continue
        table = values.reshape(len(values), -1).astype(float)
        if name in OF_COMPLETED and table.shape[1] == 1:
            table = np.repeat(table, len(columns), 1)
        use = np.isfinite(table).astype(float)
        if name in OF_COMPLETED:
            use = use * among[:, : table.shape[1]] * results.completed[:, None]
        measured[name] = by_column(np.where(np.isfinite(table), table, 0.0), use)
    measured["seconds"] = by_column(results.seconds[:, None].astype(float), every[:, None])
    return {"situations": shares, "metrics": measured}


def _told(estimate: Estimate) -> dict[str, Any] | None:
    """An estimate of shape () as the summary has it; None where it is made of no episode."""
    if not estimate.episodes:
        return None
    interval = [float(estimate.low), float(estimate.high)]
    return {"mean": float(estimate.mean), "interval": interval, "episodes": int(estimate.episodes)}


def exclusive_shares(results: Results) -> dict[str, float]:
    """Shares of robot time that add up to one: time in several situations is divided equally among them."""
    total = max(float(results.together.sum()), 1e-9)
    shares = dict.fromkeys((*results.situations, "none"), 0.0)
    for held, seconds in enumerate(results.together):
        names = [name for bit, name in enumerate(results.situations) if held >> bit & 1] or ["none"]
        for name in names:
            shares[name] += float(seconds) / len(names) / total
    return shares

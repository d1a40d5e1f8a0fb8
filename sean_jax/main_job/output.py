"""The files of a run's results."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.main_job.results import Results


def write_episodes(path: Path, results: Results) -> None:
    """episodes.csv: one row an episode, metrics overall and as ``metric__situation``.

    The same results give the same bytes: fixed digits, no time of day. A value that is not finite is an empty cell.
    """
    columns: dict[str, np.ndarray] = {}
    for name, values in results.metrics.items():
        if name in ("completed", "timed_out"):
            continue
        values = values.astype(np.int64) if name in results.counts else values
        if values.ndim == 1:
            columns[name] = values
            continue
        columns[name] = values[:, 0]
        for k, situation in enumerate(results.situations):
            columns[f"{name}__{situation}"] = values[:, k + 1]
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["episode", "task", "completed", "timed_out", "seconds", *columns])
        for i, task in enumerate(results.tasks):
            ended = [str(bool(results.completed[i])), str(bool(results.timed_out[i])), f"{results.seconds[i]:.3f}"]
            writer.writerow([i, task, *ended, *(_cell(values[i]) for values in columns.values())])


def _cell(value: Any) -> str:
    if isinstance(value, np.integer | np.bool_):
        return str(int(value))
    return f"{value:.6f}" if np.isfinite(value) else ""


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Raises ValueError for NaN and infinities, which JSON has no words for."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def write_yaml(path: Path, content: dict[str, Any]) -> None:
    """Block style, keys in the order given."""
    import yaml

    path.write_text(yaml.safe_dump(content, sort_keys=False, width=1000), encoding="utf-8")

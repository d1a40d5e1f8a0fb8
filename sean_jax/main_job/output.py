"""The folder of a run: written under another name and renamed when complete, so there is never half a run."""

import contextlib
import csv
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.main_job.options import BadInput
from sean_jax.main_job.results import Results


@contextlib.contextmanager
def unfinished(folder: Path) -> Iterator[Path]:
    """A new empty folder beside ``folder`` that becomes ``folder`` at the end, or vanishes if anything is raised.

    Raises BadInput if ``folder`` holds something already or cannot be written.
    """
    folder = Path(os.path.abspath(folder))
    made: list[Path] = []
    temporary = folder.parent / f".{folder.name}.unfinished-{os.getpid()}"
    try:
        if folder.exists() and not folder.is_dir():
            raise BadInput(f"{folder} is a file, give the name of a new folder with --out.")
        made = [parent for parent in folder.parents if not parent.exists()]
        if folder.is_dir() and any(folder.iterdir()):
            raise BadInput(f"the folder {folder} is not empty, choose another with --out.")
        temporary.mkdir(parents=True)
    except OSError as error:
        _remove_empty(made)
        reason = (error.strerror or str(error)).lower()
        raise BadInput(f"cannot write {folder}: {reason}; choose another folder with --out.") from error
    try:
        yield temporary
        if folder.is_dir():
            folder.rmdir()
        temporary.rename(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        _remove_empty(made)
        raise


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:  # the innermost first
        with contextlib.suppress(OSError):
            folder.rmdir()


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

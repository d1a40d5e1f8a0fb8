"""``sean validate``: what is known of real people, checked with the ordinary simulator.

Each check is done for each model and kept as soon as it is done, so a run that was stopped goes on.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax import writing
from sean_jax.config import OwnPart, ValidateConfig, is_own_part, validate
from sean_jax.errors import InputError
from sean_jax.files import listed
from sean_jax.progress import Progress, progress
from sean_jax.studies.scenes import Model, model
from sean_jax.studies.validation import page, results
from sean_jax.studies.validation.check import Check, Curve, Finding, Laboratory, Skipped, judge, speeds
from sean_jax.studies.validation.crossings import crossing_times, flow, trajectory_data, vanishing_times
from sean_jax.studies.validation.results import Row
from sean_jax.studies.validation.suite import CHECKS, GATES, chosen
from sean_jax.workspace import refuse_others

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "CHECKS",
    "GATES",
    "Check",
    "Curve",
    "Finding",
    "Laboratory",
    "Row",
    "Skipped",
    "chosen",
    "crossing_times",
    "flow",
    "judge",
    "models_of",
    "run",
    "speeds",
    "trajectory_data",
    "vanishing_times",
]


def run(options: ValidateConfig, console: "Console | None" = None) -> list[str]:
    """Do what the folder lacks, show the table, and write results.json, table.md and report.html.

    Args:
        console: shows the rows as they are found; None shows nothing.

    Returns:
        Names of the checks that fail for the first model.

    Raises:
        InputError: a check, a model or the folder of recordings does not exist, or the folder holds something else.
        WriteError: another process writes in the folder.
        KeyboardInterrupt: Ctrl-C. What was finished until then is kept.
    """
    checks, models = chosen(options.only, options.quick), models_of(options.models)
    if options.data is not None and not options.data.is_dir():
        raise InputError(f"--data: {options.data} is no folder; give the one that holds the recordings.")
    folder = options.folder
    refuse_others(folder, results.OURS)
    rows: list[Row] = []
    done: dict[Any, Row] = {}  # guidelines share tests
    with writing.folder_lock(folder), progress(console) as bar:
        for number, check in enumerate(checks):
            for moved_by in models:
                bar.start(check.name, len(checks))
                bar.update(number, moved_by.name)
                row = results.load(folder, check, moved_by, options)
                if row is None:
                    twin = done.get((check.function, moved_by.name))
                    if twin is not None:
                        row = replace(twin, check=check.name, seconds=0.0)
                    else:
                        tell = partial(_tell, bar, number, moved_by.name)
                        row = results.find(check, Laboratory(moved_by, options.data, options.quick, tell))
                    results.save(folder, check, moved_by, options, row)
                done[check.function, moved_by.name] = row
                rows.append(row)
                _print(console, page.line(row, checks, models))
        results.write(folder, options, rows)
        writing.write(folder / "table.md", page.markdown(checks, models, rows))
        writing.write(folder / "report.html", page.html(options, checks, models, rows))
    gates = page.gate_lines(rows, models[0])
    _print(console, *gates)
    return [row.check for row in rows if row.model == models[0].name and row.verdict == "fails"]


def models_of(names: str | None, source: Path | None = None) -> list[Model]:
    """The models that a list of names stands for.

    Args:
        names: separated by commas: presets, files of constants, pedestrian models, FILE.py:NAME; the default forces if
            None.
        source: the file that holds the names; None for those that the user has given.

    Returns:
        One or more models.

    Raises:
        InputError: there is none of a name, or a file gives no model.
    """
    found = []
    for name in listed(names):
        if is_own_part(name):
            from sean_jax.components import load

            part = validate(OwnPart, {"kind": name}, source=source)
            found.append(model(load(part, "models"), part.name))
        else:
            found.append(model(name))
    return found or [model()]


def _tell(bar: Progress, number: int, name: str, share: float) -> None:
    bar.update(number + share, name)


def _print(console: "Console | None", *lines: str) -> None:
    if console is None:
        return
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)

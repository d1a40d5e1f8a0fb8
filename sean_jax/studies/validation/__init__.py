"""``sean validate``: measurements of real people, compared with the ordinary simulator.

Each check is done for each model and saved when it is done, so a run that was stopped is resumed.
"""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sean_jax import writing
from sean_jax.config import ValidateConfig
from sean_jax.errors import InputError
from sean_jax.progress import Progress, progress
from sean_jax.studies.validation import page, results
from sean_jax.studies.validation.check import CheckContext, Row, models_of
from sean_jax.studies.validation.checks import select
from sean_jax.workspace import refuse_others

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["run"]


def run(options: ValidateConfig, console: "Console | None" = None) -> list[str]:
    """Do the checks that the folder lacks, show the table, and write results.json, table.md and report.html.

    Args:
        console: shows each row when it is done; None shows nothing.

    Returns:
        Names of the checks that fail for the first model.

    Raises:
        InputError: a check, a model or the folder of recordings does not exist, or the folder holds something else.
        WriteError: another process writes in the folder.
        KeyboardInterrupt: Ctrl-C. Finished checks are saved.
    """
    checks, models = select(options.only, options.quick), models_of(options.models)
    if options.data is not None and not options.data.is_dir():
        raise InputError(f"--data: {options.data} is no folder; give the one that holds the recordings.")
    folder = options.folder
    refuse_others(folder, results.OURS)
    rows: list[Row] = []
    done: dict[Any, Row] = {}  # several guidelines demand the same test
    with writing.folder_lock(folder), progress(console) as bar:
        for number, check in enumerate(checks):
            for model in models:
                bar.start(check.name, len(checks))
                bar.update(number, model.name)
                row = results.load(folder, check, model, options)
                if row is None:
                    twin = done.get((check.function, model.name))
                    if twin is not None:
                        row = replace(twin, check=check.name, seconds=0.0)
                    else:
                        report = partial(_report, bar, number, model.name)
                        row = results.do(check, CheckContext(model, options.data, options.quick, report))
                    results.save(folder, check, model, options, row)
                done[check.function, model.name] = row
                rows.append(row)
                _print(console, page.line(row, checks, models))
        results.write(folder, options, rows)
        writing.write(folder / "table.md", page.markdown(checks, models, rows))
        writing.write(folder / "report.html", page.html(options, checks, models, rows))
    _print(console, *page.gate_lines(rows, models[0]))
    return [row.check for row in rows if row.model == models[0].name and row.verdict == "fails"]


def _report(bar: Progress, number: int, name: str, share: float) -> None:
    bar.update(number + share, name)


def _print(console: "Console | None", *lines: str) -> None:
    if console is None:
        return
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)

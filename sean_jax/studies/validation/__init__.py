"""``sean validate``: measurements of real people, compared with the ordinary simulator.

Each check is done for each model and saved when it is done, so a run that was stopped is resumed.
"""

import itertools
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from sean_jax.config import ValidateConfig
from sean_jax.config.workspace import refuse_others
from sean_jax.core.errors import InputError
from sean_jax.drawing.svg import svg
from sean_jax.io import writing
from sean_jax.io.progress import Progress, progress
from sean_jax.studies.validation import checks, page, pictures
from sean_jax.studies.validation.checks import (
    FAILS,
    PASSES,
    SKIPPED,
    Check,
    CheckContext,
    CheckResult,
    CheckRow,
    Skipped,
)

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["run"]

TABLE, REPORT = "table.md", "report.html"


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
    selected, models = checks.select(options.only, options.quick), checks.models_of(options.models, typed=True)

    # A wrong folder is refused at once; without one, checks that need recordings are skipped.
    if options.data is not None and not options.data.is_dir():
        raise InputError(f"--data: {options.data} is no folder; give the folder of the recordings.")
    folder = options.folder
    refuse_others(folder, {checks.RESULTS, checks.PARTS, TABLE, REPORT})

    # Checks take long: each row is a file in the folder, so a run that was stopped goes on after it.
    rows: list[CheckRow] = []
    done: dict[tuple[str, ...], CheckRow] = {}  # several guidelines demand the same test
    with writing.folder_lock(folder), progress(console) as bar:
        for number, (check, model) in enumerate(itertools.product(selected, models)):
            finished = number // len(models)
            bar.start(check.name, len(selected))
            bar.update(finished, model.name)

            # The same test of two guidelines is done once: it has one result, with the name of each.
            test = check.function, str(check.arguments), model.name
            row = checks.load(folder, check, model, options)
            if row is None:
                if test in done:
                    row = replace(done[test], check=check.name, seconds=0.0)
                else:
                    report = partial(_report, bar, finished, model.name)
                    row = do(check, CheckContext(model, options.data, options.quick, report))
                checks.save(folder, check, model, options, row)

            done[test] = row
            rows.append(row)
            _print(console, page.line(row, selected, models))

        # The page needs all rows, since it compares the models.
        checks.write(folder, options, rows)
        writing.write(folder / TABLE, page.markdown(selected, models, rows))
        writing.write(folder / REPORT, page.html(options, selected, models, rows))

    # Only the first model decides: the others are there to be compared with.
    _print(console, *page.gate_lines(rows, models[0]))
    return [row.check for row in rows if row.model == models[0].name and row.verdict == FAILS]


def do(check: Check, context: CheckContext) -> CheckRow:
    """Do a check."""
    begin = time.monotonic()
    try:
        result = check.run(context)
        verdict = PASSES if result.passed else FAILS
    except Skipped as error:
        result, verdict = CheckResult(False, "", str(error)), SKIPPED
    drawings = []
    for k, (caption, scene, tracks) in enumerate(context.pictures):
        drawing = svg(pictures.trajectories(scene, tracks), f"{check.name}-{context.model.name}-{k}")
        drawings.append((caption, drawing))
    fields = {name: value for name, value in vars(result).items() if name != "passed"}
    seconds = time.monotonic() - begin
    return CheckRow(check.name, context.model.name, verdict, **fields, pictures=tuple(drawings), seconds=seconds)


def _report(bar: Progress, number: int, name: str, share: float) -> None:
    bar.update(number + share, name)


def _print(console: "Console | None", *lines: str) -> None:
    if console is not None:
        for line in lines:
            console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)

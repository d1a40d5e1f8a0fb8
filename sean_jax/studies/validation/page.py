"""What ``sean validate`` shows: a line for each row, the gates, and a page with set-up, paths, curves and verdicts."""

import dataclasses
from collections.abc import Sequence

from sean_jax import pages
from sean_jax.config import ValidateConfig
from sean_jax.flags import command
from sean_jax.studies.scenes import Model
from sean_jax.studies.validation import figures
from sean_jax.studies.validation.check import Check
from sean_jax.studies.validation.results import FAILS, PASSES, SKIPPED, Row
from sean_jax.studies.validation.suite import GATES, matches
from sean_jax.versions import versions


def line(row: Row, checks: Sequence[Check], models: Sequence[Model]) -> str:
    """A row for the terminal.

    Args:
        models: likewise; a single one is not named.
    """
    wide = max(len(check.name) for check in checks)
    who = f"{row.model:<{max(len(each.name) for each in models)}}  " if len(models) > 1 else ""
    return f"{row.check:<{wide}}  {who}{row.verdict:<7}  {row.reason or row.measured}"


def gate_lines(rows: Sequence[Row], model: Model) -> list[str]:
    """The gates for the terminal.

    Returns:
        A heading and a line for each gate of which something was checked; empty if there is none.
    """
    found = [(title, verdict, why) for title, _, verdict, why in gates(rows, model.name) if verdict != SKIPPED or why]
    if not found:
        return []
    wide = max(len(title) for title, *_ in found)
    return [f"gates of {model.name}:"] + [f"  {title:<{wide}}  {verdict:<7}  {why}" for title, verdict, why in found]


def gates(rows: Sequence[Row], model: str) -> list[tuple[str, str, str, str]]:
    """What has become of each gate.

    Returns:
        For each gate its title, its promise, the verdict (passes, fails, partly if a part was skipped or left out, or
        skipped), and what was measured or which checks fail.
    """
    of_model = {row.check: row for row in rows if row.model == model}
    table = []
    for gate in GATES:
        names = [name for pattern in gate.checks for name in matches(pattern)]
        done = [of_model[name] for name in names if name in of_model]
        failing = [row.check for row in done if row.verdict == FAILS]
        passing = [row for row in done if row.verdict == PASSES]
        if failing:
            why = (
                f"{len(failing)} of {len(names)}: {', '.join(failing)}"
                if len(names) > 1
                else of_model[failing[0]].reason
            )
            table.append((gate.title, gate.promise, FAILS, why))
        elif names and len(passing) == len(names):
            why = f"all {len(names)}" if len(names) > 1 else passing[0].measured
            table.append((gate.title, gate.promise, PASSES, why))
        elif passing:
            table.append((gate.title, gate.promise, "partly", f"{len(passing)} of {len(names)} done, all pass"))
        else:
            table.append((gate.title, gate.promise, SKIPPED, "; ".join(dict.fromkeys(row.reason for row in done))))
    return table


def markdown(checks: Sequence[Check], models: Sequence[Model], rows: Sequence[Row]) -> str:
    """The table as docs/validation.md has it.

    Returns:
        A table of Markdown, and one of the gates of the first model.
    """
    found = {(row.check, row.model): row for row in rows}
    names = [model.name for model in models]
    lines = ["| check | " + " | ".join(names) + " |", "|---" * (1 + len(names)) + "|"]
    for check in checks:
        cells = (found[check.name, name] for name in names)
        texts = (f"{row.verdict}: {row.reason or row.measured}".replace("|", "/") for row in cells)
        lines.append(f"| {check.name} | " + " | ".join(texts) + " |")
    lines += ["", f"| gate | promise | {names[0]} |", "|---|---|---|"]
    for title, promise, verdict, why in gates(rows, names[0]):
        lines.append(f"| {title} | {promise} | {verdict}{why and ': ' + why} |")
    return "\n".join(lines) + "\n"


def html(options: ValidateConfig, checks: Sequence[Check], models: Sequence[Model], rows: Sequence[Row]) -> str:
    """The report."""
    by_name = {(row.check, row.model): row for row in rows}
    verdicts = []
    for check in checks:
        cells = [
            _verdict(row.verdict, row.reason or row.measured) for row in (by_name[check.name, m.name] for m in models)
        ]
        verdicts.append([pages.Cell(check.name, check.title), check.criterion, *cells])
    kept = [[title, promise, _verdict(verdict, why)] for title, promise, verdict, why in gates(rows, models[0].name)]
    head = ["", "criterion", *(model.name for model in models)]
    sections = [
        pages.section("Verdicts", pages.table(head, verdicts, "words"), pages.note("Nothing is tuned for a check.")),
        pages.section(f"Gates of {models[0].name}", pages.table([], kept, "words")),
        *(_check(check, [by_name[check.name, model.name] for model in models]) for check in checks),
        pages.origin(command("validate", options), versions()),
    ]
    return pages.page("Validation of the people", "sean_jax · sean validate", sections)


def _verdict(verdict: str, reason: str) -> pages.Cell:
    return pages.Cell(verdict, reason, verdict)


def _check(check: Check, rows: Sequence[Row]) -> str:
    """The section of a check, with a row for each model."""
    facts = {"set-up": check.setup, "measured": check.measure, "passes if": check.criterion, "source": check.source}
    facts |= {row.model: f"{row.verdict}: {row.reason or row.measured}" for row in rows}
    pictures = [pages.figure(picture, f"{row.model}: {caption}") for row in rows for caption, picture in row.pictures]
    curves = {}
    for row in rows:
        several = len({one.name for one in row.curves if not one.reference}) > 1
        for curve in row.curves:
            name = curve.name if curve.reference else f"{row.model}: {curve.name}" if several else row.model
            curves[name, curve.reference] = dataclasses.replace(curve, name=name)
    if curves:
        plot = figures.svg(figures.plot(list(curves.values()), rows[0].axes), f"{check.name}-curves")
        pictures.append(pages.figure(plot))
    parts = [pages.facts(facts), pages.grid(pictures)] if pictures else [pages.facts(facts)]
    return pages.section(f"{check.name} · {check.title}", *parts)

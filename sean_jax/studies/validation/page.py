"""What ``sean validate`` shows: a line for each row, the gates, and a page with set-up, paths, curves and verdicts."""

from collections.abc import Sequence
from dataclasses import replace

from sean_jax.config import ValidateConfig, flags
from sean_jax.drawing.svg import svg
from sean_jax.io.versions import versions
from sean_jax.studies.scenes import Model
from sean_jax.studies.validation.checks import FAILS, GATES, PASSES, SKIPPED, Check, CheckRow, Curve, matches
from sean_jax.studies.validation.pictures import plot
from sean_jax.web import pages

DATA = "Fitted: the loss of sean calibrate has the same measurement, so a fit should pass. Held out: it has not."


def line(row: CheckRow, checks: Sequence[Check], models: Sequence[Model]) -> str:
    """A row for the terminal; a single model is not named."""
    check_width = max(len(check.name) for check in checks)
    (data,) = (check.data for check in checks if check.name == row.check)
    model = ""
    if len(models) > 1:
        model_width = max(len(model.name) for model in models)
        model = f"{row.model:<{model_width}}  "
    return f"{row.check:<{check_width}}  {model}{row.verdict:<7}  {data:<8}  {_why(row)}"


def _why(row: CheckRow) -> str:
    """The reason of a row that fails or is skipped, and the measurement of one that passes."""
    return row.reason or row.measured


def gate_lines(rows: Sequence[CheckRow], model: Model) -> list[str]:
    """A heading and a line for each gate of which something was checked, for the terminal; or nothing."""
    table = []
    for title, _, verdict, why in gates(rows, model.name):
        if verdict != SKIPPED or why:
            table.append((title, verdict, why))
    if not table:
        return []
    width = max(len(title) for title, *_ in table)
    lines = [f"gates of {model.name}:"]
    for title, verdict, why in table:
        lines.append(f"  {title:<{width}}  {verdict:<7}  {why}")
    return lines


def gates(rows: Sequence[CheckRow], model: str) -> list[tuple[str, str, str, str]]:
    """Each gate's title, promise, verdict, and the measurement or the failed checks.

    The verdict is passes, fails, partly if a part was skipped or left out, or skipped.
    """
    by_check = {row.check: row for row in rows if row.model == model}
    table = []
    for gate in GATES:
        names = [name for pattern in gate.checks for name in matches(pattern)]
        rows_done = [by_check[name] for name in names if name in by_check]
        verdict, why = _gate_verdict(names, rows_done)
        table.append((gate.title, gate.promise, verdict, why))
    return table


def _gate_verdict(names: list[str], rows: list[CheckRow]) -> tuple[str, str]:
    """The verdict of checks of which some have rows, and why."""
    failing = [row for row in rows if row.verdict == FAILS]
    passing = [row for row in rows if row.verdict == PASSES]
    if failing and len(names) == 1:
        return FAILS, failing[0].reason
    if failing:
        which = ", ".join(row.check for row in failing)
        return FAILS, f"{len(failing)} of {len(names)}: {which}"
    if passing and len(names) == 1:
        return PASSES, passing[0].measured
    if names and len(passing) == len(names):
        return PASSES, f"all {len(names)}"
    if passing:
        return "partly", f"{len(passing)} of {len(names)} done, all pass"
    return SKIPPED, "; ".join(dict.fromkeys(row.reason for row in rows))


def markdown(checks: Sequence[Check], models: Sequence[Model], rows: Sequence[CheckRow]) -> str:
    """The table as docs/validation.md has it, and one of the gates of the first model."""
    by_name = {(row.check, row.model): row for row in rows}
    names = [model.name for model in models]
    lines = [f"| check | data | {' | '.join(names)} |", "|---" * (2 + len(names)) + "|"]
    for check in checks:
        texts = []
        for name in names:
            row = by_name[check.name, name]
            texts.append(f"{row.verdict}: {_why(row)}".replace("|", "/"))
        lines.append(f"| {check.name} | {check.data} | {' | '.join(texts)} |")

    lines.append("")
    lines.append(f"| gate | promise | {names[0]} |")
    lines.append("|---|---|---|")
    for title, promise, verdict, why in gates(rows, names[0]):
        lines.append(f"| {title} | {promise} | {verdict}{why and ': ' + why} |")
    return "\n".join(lines) + "\n"


def html(options: ValidateConfig, checks: Sequence[Check], models: Sequence[Model], rows: Sequence[CheckRow]) -> str:
    """The report."""
    by_name = {(row.check, row.model): row for row in rows}
    names = [model.name for model in models]

    # A line of verdicts and a section for each check.
    verdicts = []
    details = []
    for check in checks:
        check_rows = [by_name[check.name, name] for name in names]
        cells = [_verdict(row.verdict, _why(row)) for row in check_rows]
        verdicts.append([pages.Cell(check.name, check.title), check.data, check.criterion, *cells])
        details.append(_check(check, check_rows))

    # Gates are promises about the first model alone.
    promises = []
    for title, promise, verdict, why in gates(rows, names[0]):
        promises.append([title, promise, _verdict(verdict, why)])

    table = pages.table(["", "data", "criterion", *names], verdicts, "words")
    sections = [
        pages.section("Verdicts", table, pages.note(DATA)),
        pages.section(f"Gates of {names[0]}", pages.table([], promises, "words")),
        *details,
        pages.origin(flags.command("validate", options), versions()),
    ]
    return pages.page("Validation of the people", "sean_jax · sean validate", sections)


def _verdict(verdict: str, reason: str) -> pages.Cell:
    return pages.Cell(verdict, reason, verdict)


def _check(check: Check, rows: Sequence[CheckRow]) -> str:
    """The section of a check, with a row for each model."""
    facts = {
        "set-up": check.setup,
        "measured": check.measure,
        "passes if": check.criterion,
        "source": check.source,
        "data": check.data,
    }
    figures = []
    for row in rows:
        facts[row.model] = f"{row.verdict}: {_why(row)}"
        for caption, picture in row.pictures:
            figures.append(pages.figure(picture, f"{row.model}: {caption}"))

    curves = _curves(rows)
    if curves:
        picture = svg(plot(curves, rows[0].axes), f"{check.name}-curves")
        figures.append(pages.figure(picture))

    parts = [pages.facts(facts)]
    if figures:
        parts.append(pages.grid(figures))
    return pages.section(f"{check.name} · {check.title}", *parts)


def _curves(rows: Sequence[CheckRow]) -> list[Curve]:
    """The curves of all models by the model's name, and each reference once."""
    curves: dict[tuple[str, bool], Curve] = {}
    for row in rows:
        several = len({curve.name for curve in row.curves if not curve.reference}) > 1
        for curve in row.curves:
            if curve.reference:
                name = curve.name
            elif several:
                name = f"{row.model}: {curve.name}"
            else:
                name = row.model
            curves[name, curve.reference] = replace(curve, name=name)
    return list(curves.values())

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
    wide = max(len(check.name) for check in checks)
    (data,) = (check.data for check in checks if check.name == row.check)
    wide_model = max(len(model.name) for model in models)
    model = f"{row.model:<{wide_model}}  " if len(models) > 1 else ""
    return f"{row.check:<{wide}}  {model}{row.verdict:<7}  {data:<8}  {row.reason or row.measured}"


def gate_lines(rows: Sequence[CheckRow], model: Model) -> list[str]:
    """A heading and a line for each gate of which something was checked, for the terminal; or nothing."""
    table = [(title, verdict, why) for title, _, verdict, why in gates(rows, model.name) if verdict != SKIPPED or why]
    if not table:
        return []
    wide = max(len(title) for title, *_ in table)
    return [f"gates of {model.name}:"] + [f"  {title:<{wide}}  {verdict:<7}  {why}" for title, verdict, why in table]


def gates(rows: Sequence[CheckRow], model: str) -> list[tuple[str, str, str, str]]:
    """Each gate's title, promise, verdict, and the measurement or the failed checks.

    The verdict is passes, fails, partly if a part was skipped or left out, or skipped.
    """
    by_check = {row.check: row for row in rows if row.model == model}
    table = []
    for gate in GATES:
        names = [name for pattern in gate.checks for name in matches(pattern)]
        rows_done = [by_check[name] for name in names if name in by_check]
        table.append((gate.title, gate.promise, *_gate_verdict(names, rows_done)))
    return table


def _gate_verdict(names: list[str], rows: list[CheckRow]) -> tuple[str, str]:
    """The verdict of checks of which some have rows, and why."""
    failing = [row for row in rows if row.verdict == FAILS]
    passing = [row for row in rows if row.verdict == PASSES]
    several = len(names) > 1
    if failing:
        which = f"{len(failing)} of {len(names)}: {', '.join(row.check for row in failing)}"
        return FAILS, which if several else failing[0].reason
    if names and len(passing) == len(names):
        return PASSES, f"all {len(names)}" if several else passing[0].measured
    if passing:
        return "partly", f"{len(passing)} of {len(names)} done, all pass"
    return SKIPPED, "; ".join(dict.fromkeys(row.reason for row in rows))


def markdown(checks: Sequence[Check], models: Sequence[Model], rows: Sequence[CheckRow]) -> str:
    """The table as docs/validation.md has it, and one of the gates of the first model."""
    by_name = {(row.check, row.model): row for row in rows}
    names = [model.name for model in models]
    lines = ["| check | data | " + " | ".join(names) + " |", "|---" * (2 + len(names)) + "|"]
    for check in checks:
        cells = [by_name[check.name, name] for name in names]
        texts = [f"{row.verdict}: {row.reason or row.measured}".replace("|", "/") for row in cells]
        lines.append(f"| {check.name} | {check.data} | " + " | ".join(texts) + " |")
    lines += ["", f"| gate | promise | {names[0]} |", "|---|---|---|"]
    for title, promise, verdict, why in gates(rows, names[0]):
        lines.append(f"| {title} | {promise} | {verdict}{why and ': ' + why} |")
    return "\n".join(lines) + "\n"


def html(options: ValidateConfig, checks: Sequence[Check], models: Sequence[Model], rows: Sequence[CheckRow]) -> str:
    """The report."""
    by_name = {(row.check, row.model): row for row in rows}
    verdicts, details = [], []
    for check in checks:
        check_rows = [by_name[check.name, model.name] for model in models]
        cells = [_verdict(row.verdict, row.reason or row.measured) for row in check_rows]
        verdicts.append([pages.Cell(check.name, check.title), check.data, check.criterion, *cells])
        details.append(_check(check, check_rows))

    first = models[0].name
    promises = [[title, promise, _verdict(verdict, why)] for title, promise, verdict, why in gates(rows, first)]
    head = ["", "data", "criterion", *(model.name for model in models)]
    sections = [
        pages.section("Verdicts", pages.table(head, verdicts, "words"), pages.note(DATA)),
        pages.section(f"Gates of {first}", pages.table([], promises, "words")),
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
    facts |= {row.model: f"{row.verdict}: {row.reason or row.measured}" for row in rows}

    figures = [pages.figure(picture, f"{row.model}: {caption}") for row in rows for caption, picture in row.pictures]
    curves = _curves(rows)
    if curves:
        figures.append(pages.figure(svg(plot(curves, rows[0].axes), f"{check.name}-curves")))
    parts = [pages.facts(facts), pages.grid(figures)] if figures else [pages.facts(facts)]
    return pages.section(f"{check.name} · {check.title}", *parts)


def _curves(rows: Sequence[CheckRow]) -> list[Curve]:
    """The curves of all models by the model's name, and each reference once."""
    curves: dict[tuple[str, bool], Curve] = {}
    for row in rows:
        several = len({curve.name for curve in row.curves if not curve.reference}) > 1
        for curve in row.curves:
            of_model = f"{row.model}: {curve.name}" if several else row.model
            name = curve.name if curve.reference else of_model
            curves[name, curve.reference] = replace(curve, name=name)
    return list(curves.values())

"""What ``sean validate`` shows: a line for each row, the gates, and a page with set-up, paths, curves and verdicts."""

import dataclasses
import html as markup
from collections.abc import Sequence

from sean_jax import report
from sean_jax.config import ValidateConfig
from sean_jax.flags import command
from sean_jax.studies.scenes import Model
from sean_jax.studies.validation import figures
from sean_jax.studies.validation.check import Check
from sean_jax.studies.validation.results import FAILS, PASSES, SKIPPED, Row
from sean_jax.studies.validation.suite import GATES, matches
from sean_jax.versions import versions

STYLE = (
    "td,th{white-space:normal;text-align:left}td:nth-child(2){font-weight:400}"
    "b.passes{color:#228833}b.fails{color:#cc3344}b.skipped{color:var(--muted)}b.partly{color:#aa7700}"
)


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
    found = {(row.check, row.model): row for row in rows}
    sections = [
        _section("Verdicts", _verdicts(checks, models, found)),
        _section(f"Gates of {markup.escape(models[0].name)}", _gates(rows, models[0].name)),
        *(_section(markup.escape(f"{check.name} · {check.title}"), _check(check, models, found)) for check in checks),
        _section(
            "How to get this again", f"<pre>{markup.escape(command('validate', options))}</pre>" + _facts(versions())
        ),
    ]
    return report.page("Validation of the people", "sean_jax · sean validate", sections, STYLE)


def _section(title: str, body: str) -> str:
    return f"<section><h2>{title}</h2>\n{body}</section>"


def _facts(facts: dict[str, str]) -> str:
    rows = (f"<dt>{markup.escape(name)}</dt><dd>{markup.escape(text)}</dd>" for name, text in facts.items())
    return f"<dl>{''.join(rows)}</dl>"


def _verdict(word: str) -> str:
    return f"<b class={word}>{word}</b>"


def _verdicts(checks: Sequence[Check], models: Sequence[Model], found: dict) -> str:
    head = "".join(f"<th>{markup.escape(model.name)}</th>" for model in models)
    body = []
    for check in checks:
        cells = ""
        for model in models:
            row = found[check.name, model.name]
            cells += f"<td>{_verdict(row.verdict)}<small>{markup.escape(row.reason or row.measured)}</small></td>"
        criterion = f"<td>{markup.escape(check.criterion)}</td>"
        body.append(f"<tr><th>{check.name}<br><small>{markup.escape(check.title)}</small></th>{criterion}{cells}</tr>")
    table = f"<table><thead><tr><th></th><th>criterion</th>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    return f"<div class=wide>{table}</div><p class=note>Nothing is tuned for a check.</p>"


def _gates(rows: Sequence[Row], model: str) -> str:
    body = "".join(
        f"<tr><th>{markup.escape(title)}</th><td>{markup.escape(promise)}</td><td>{_verdict(verdict)}"
        f"<small>{markup.escape(why)}</small></td></tr>"
        for title, promise, verdict, why in gates(rows, model)
    )
    return f"<div class=wide><table><tbody>{body}</tbody></table></div>"


def _check(check: Check, models: Sequence[Model], found: dict) -> str:
    facts = {
        "set-up": check.setup,
        "measured": check.measure,
        "passes if": check.criterion,
        "source": check.source,
    }
    for model in models:
        row = found[check.name, model.name]
        facts[model.name] = f"{row.verdict}: {row.reason or row.measured}"
    rows = [found[check.name, model.name] for model in models]
    pictures = [
        f"<figure>{picture}<figcaption>{markup.escape(f'{row.model}: {caption}')}</figcaption></figure>"
        for row in rows
        for caption, picture in row.pictures
    ]
    curves = {}
    for row in rows:
        for curve in row.curves:
            several = len({one.name for one in row.curves if not one.reference}) > 1
            name = curve.name if curve.reference else f"{row.model}: {curve.name}" if several else row.model
            curves[name, curve.reference] = dataclasses.replace(curve, name=name)
    if curves:
        drawn = figures.svg(figures.plot(list(curves.values()), rows[0].axes), f"{check.name}-curves")
        pictures.append(f"<figure>{drawn}</figure>")
    return _facts(facts) + (f"<p></p><div class=grid>{''.join(pictures)}</div>" if pictures else "")

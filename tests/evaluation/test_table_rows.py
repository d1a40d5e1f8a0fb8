"""What is counted is shown: tables and pages have each row that their figures have, also with extreme effects.

``sean compare`` and the report of a run have such tests beside their others.
"""

import io

import matplotlib
import numpy as np
import pytest
from rich.console import Console

from sean_jax.config import BenchmarkRankConfig, ValidateConfig
from sean_jax.evaluation import results, table
from sean_jax.studies.experiments import page, pictures, ranks
from sean_jax.studies.survey import report
from sean_jax.studies.validation import page as validation_page
from sean_jax.studies.validation.checks import CheckRow, Model
from sean_jax.web import pages
from support.benchmark_results import entry
from support.checks import made_check
from support.reports import NAMES, evaluation

EVERY = {"one": ["0"], "other": ["1"]}


def rows_of(text: str) -> list[int]:
    """The number of rows of each table of a page."""
    return [part.split("</tbody>")[0].count("<tr>") for part in text.split("<tbody>")[1:]]


@pytest.mark.parametrize("width", [60, 200])
def test_the_terminal_has_each_headline(width):
    given, console = evaluation(), Console(width=width, file=io.StringIO())
    summary = results.aggregate_episodes(given)
    table.print_table(console, summary, given.definitions, "a run", 0.0)
    said = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    headlines = table.table_rows(summary, given.definitions)
    blocks = said.count("share of robot time")
    assert blocks == 1 if width == 200 else blocks > 1
    for row in headlines:
        lines = [line for line in said.splitlines() if line.strip().startswith(f"{row.title} ")]
        assert len(lines) == blocks, row.title
    assert "Situations may overlap" in said and "nobody is near" in said
    assert len(headlines) == 2 + sum(metric.headline for metric in given.definitions.values())
    assert all(name.split("_")[0] in said for name in NAMES)


def test_a_ranking_has_each_entry_and_each_pair():
    """Also entries that differ in every episode, whose p-values are the smallest."""
    matplotlib.use("Agg")
    none, every = np.zeros((1, 2, 50), bool), np.ones((1, 2, 50), bool)
    half = np.arange(100).reshape(1, 2, 50) % 2 == 0
    entries = [entry(name, each) for name, each in {"none": none, "half": half, "every": every}.items()]
    entries += [entry("knows", every, "all-knowing"), entry("agent", none, "all-knowing", trained=True)]
    found = ranks.rank(entries, EVERY, [])
    assert len(found.rows) == len(entries) and len(found.pairs) == 3 + 1
    assert all(type(pair.p) is float for pair in found.pairs) and min(pair.p for pair in found.pairs) < 1e-9

    lines = found.table().splitlines()
    drawn = {sensing: pictures.situations(rows) for sensing, rows in found.by_class().items()}
    text = page.ranking(BenchmarkRankConfig(results=("a", "b")), found, drawn)  # pyright: ignore[reportArgumentType]
    for each in entries:
        assert sum(each.name in line.split() for line in lines) == 1
        assert text.count(f">{each.name}</td>") == 1
    for pair in found.pairs:
        assert text.count(f">{pair.second} - {pair.first}</t") == 1
    assert sum(rows_of(text)) == len(found.rows) + len(found.pairs)


def test_the_page_of_the_validation_has_each_check_and_each_gate():
    checks = [made_check(name, None) for name in ("rimea-1", "rimea-4", "prediction")]
    models = [Model("one", None, {}), Model("other", None, {})]  # pyright: ignore
    verdicts = {"rimea-1": "passes", "rimea-4": "fails", "prediction": "skipped"}
    rows = [
        CheckRow(
            check.name, model.name, verdicts[check.name], f"measured by {model.name}", "", {}, (), ("", ""), (), 0.0
        )
        for check in checks
        for model in models
    ]
    text = validation_page.html(ValidateConfig(models="constant_velocity"), checks, models, rows)
    first, second, *_ = rows_of(text)
    assert first == len(checks) and second == len(validation_page.gates(rows, "one"))
    for verdict in verdicts.values():
        assert text.split("<tbody>")[1].split("</tbody>")[0].count(f"<td class={verdict}>") == len(models)
    lines = validation_page.markdown(checks, models, rows).splitlines()
    assert sum(line.startswith("| ") for line in lines) == 2 + len(checks) + second


def test_the_report_of_a_study_has_each_correlation():
    """Those of the smallest p-values are counted as clear, and are bold."""
    values = (0.0, 1e-300, 0.049, 0.051, 1.0)
    found = [report.Correlation("safe", f"own_{k}", 0.5, 0.4, 0.6, 30, 10, np.float64(p)) for k, p in enumerate(values)]
    head, rows = report.correlation_table(found)
    assert len(rows) == len(found) and rows_of(pages.table(head, rows)) == [len(found)]
    bold = [any(isinstance(cell, pages.Cell) and cell.kind == "ours" for cell in row) for row in rows]
    assert bold == [True, True, True, False, False] and report.counted(found).endswith("correction: 3, in bold.")
    console = Console(width=200, file=io.StringIO())
    report.print_table(console, "all", head, rows)
    said = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert all(f"own {k}" in said for k in range(len(values)))

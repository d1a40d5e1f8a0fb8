"""The table of a run: its figures with their titles, units and intervals, overall and by situation."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sean_jax.drawing.colors import situation_colors
from sean_jax.io import files
from sean_jax.metrics import Metric
from sean_jax.metrics.metric import MEAN


class TableFigure(NamedTuple):
    """The presentation of a figure."""

    title: str
    unit: str  # "%" shows a share in percent
    digits: int
    definition: str
    better: str = ""  # "lower" or "higher" values; "" if neither is better
    completed_only: bool = False  # means leave out episodes that were not completed
    best: float | Literal["goal_radius"] | None = None  # values beyond it are no better


EPISODE_FIGURES = {
    name: TableFigure(**figure) for name, figure in files.read_yaml(Path(__file__).with_suffix(".yaml"))[1].items()
}
"""Figures of the episode itself, which no metric measures; first in the table."""

_UNITS = {"1": "", "m/s2": "m/s²", "m/s3": "m/s³"}  # as they are shown
SECTIONS = {"intimate": "distances", "personal": "distances", "collision": "collisions"}  # first word -> section
GAP = 3  # characters between columns


@dataclasses.dataclass
class MeasureRow:
    """A row of the table, as text."""

    name: str
    title: str
    unit: str
    definition: str
    cells: list[str]  # overall, then each situation; "" where there is no figure
    intervals: list[str]  # 95 %, likewise; "" where both ends are the same, or for a count of 0
    better: str


def table_rows(summary: dict[str, Any], definitions: Mapping[str, Metric], complete: bool = False) -> list[MeasureRow]:
    """The rows of a summary (``results.aggregate_episodes``): episode figures, then metrics in the scenario's order.

    They are the headlines, or every metric if ``complete``, except the time in situations, which the share of robot
    time shows.
    """
    figures = summary["metrics"]
    shares = {"overall": {"mean": 1.0, "interval": [1.0, 1.0]}, **summary["situations"]}
    columns = list(shares)
    lines = [_row("share", EPISODE_FIGURES["share"], shares, columns)]
    for name in ("completed", "seconds") if complete else ("completed",):
        if name in figures:
            lines.append(_row(name, EPISODE_FIGURES[name], figures[name], columns))
    for name, metric in definitions.items():
        if name in figures and name != "time_in_situation" and (complete or metric.headline):
            lines.append(_row(name, metric_figure(name, metric), figures[name], columns))
    return lines


def metric_figure(name: str, metric: Metric) -> TableFigure:
    """The title, unit, digits and definition of a metric."""
    unit = "%" if metric.kind == "share" else _UNITS.get(metric.unit, metric.unit)
    title = metric.title or name.replace("_", " ")
    definition = metric.definition or MEAN
    return TableFigure(title, unit, metric.digits, definition, metric.better, metric.completed_only, metric.best)


def _row(name: str, figure: TableFigure, values: dict[str, Any], columns: list[str]) -> MeasureRow:
    scale = 100.0 if figure.unit == "%" else 1.0
    cells = []
    intervals = []
    for column in columns:
        value = values.get(column)
        cells.append("" if value is None else f"{scale * value['mean']:.{figure.digits}f}")
        ends = [f"{scale * end:.{figure.digits}f}" for end in value["interval"]] if value else []
        shown = value is not None and (value["mean"] != 0 or figure.unit == "%")
        intervals.append(" to ".join(ends) if shown and len(set(ends)) > 1 else "")
    return MeasureRow(name, figure.title, figure.unit, figure.definition, cells, intervals, figure.better)


def print_table(
    console: Console, summary: dict[str, Any], definitions: Mapping[str, Metric], title: str, none: float
) -> None:
    """Print the table of a summary in blocks as wide as the terminal; ``none`` is the share of time in no situation."""
    names = list(summary["situations"])
    rows = table_rows(summary, definitions)
    margin = 1 + max(len(f"{row.title} {row.unit}".strip()) for row in rows)
    widths = []
    for k, name in enumerate(("overall", *names)):
        widths.append(max(max(len(row.cells[k]) for row in rows), *map(len, name.split("_"))))
    for first, last in _blocks(widths, console.width - margin):
        console.print(_block(rows, names, first, last, title if first == 0 else ""))

    console.print(f"In no situation: {100.0 * none:.1f} % of the robot's time.", highlight=False)
    notes = ["Situations may overlap; completed is there of the episodes in which the situation occurred."]
    if "empty" in names:
        notes.append("Empty is a situation: nobody is near.")
    notes.append("Violations and collisions are times per episode; 95 % intervals are in summary.json.")
    console.print(Text(" ".join(notes), "dim"), soft_wrap=True)


def _block(rows: list[MeasureRow], names: list[str], first: int, last: int, title: str) -> Table:
    """The columns of some situations; the first block has the overall column, too."""
    table = Table(box=box.SIMPLE_HEAD, title=Text(title), title_justify="left", title_style="bold", pad_edge=False)
    table.add_column("", no_wrap=True)
    if first == 0:
        table.add_column("overall", justify="right", style="bold", no_wrap=True)
    colors = situation_colors(tuple(names))
    for name, color in zip(names[first:last], colors[first:last], strict=True):
        table.add_column(Text(name.replace("_", "\n"), style=f"bold {color}"), justify="right", no_wrap=True)

    last_section = ""
    for row in rows:
        section = SECTIONS.get(row.name.split("_")[0], "")
        if section != last_section:
            table.add_section()
        last_section = section
        head = Text.assemble(row.title, (f" {row.unit}" if row.unit else "", "dim"))
        cells = row.cells[first + (first > 0) : last + 1]
        table.add_row(head, *(Text(cell) if cell else Text("–", "dim") for cell in cells))
    return table


def _blocks(widths: list[int], width: int) -> list[tuple[int, int]]:
    """(first, last) situation of each block of ``width`` characters.

    ``widths`` are the widths of the columns: overall, in the first block, and the situations.
    """
    overall, *situations = widths
    blocks = []
    first = 0
    remaining = width - overall - GAP
    for k, column in enumerate(situations):
        if column + GAP > remaining and k > first:
            blocks.append((first, k))
            first, remaining = k, width
        remaining -= column + GAP
    return [*blocks, (first, len(situations))]

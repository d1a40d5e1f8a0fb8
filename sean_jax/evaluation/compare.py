"""``sean compare``: two runs side by side, by the paired differences of their common episodes.

Runs that differ only in options that do not draw an episode, such as the policy, have the same episodes. They are
compared episode by episode, so the difficulty of an episode cancels. Other runs are compared by their means.
"""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sean_jax import components, files, pages, replay, writing
from sean_jax.config import CompareConfig, RunConfig, validate
from sean_jax.errors import InputError
from sean_jax.evaluation import saved
from sean_jax.evaluation.table import EPISODE_FIGURES, metric_figure
from sean_jax.flags import flag
from sean_jax.metrics import METRICS, aggregate, resamples
from sean_jax.metrics.bootstrap import interval

UNDRAWN = ("policy", "dynamics", "robot", "metrics", "sensors", "situations", "thresholds", "camera")
"""Options that do not change the draw of an episode."""

REPLAY = re.compile(r'<script type="application/json" id="replay">(.*?)</script>', re.S)


@dataclasses.dataclass
class SavedRun:
    """A run, read from its folder."""

    folder: Path
    config: RunConfig
    description: dict[str, Any]  # option -> value, with digests in place of files
    tasks: list[str]
    columns: dict[str, np.ndarray]  # name, or metric__situation -> (E,), NaN for an empty cell
    replay: dict[str, Any] | None  # of its report
    no_replay: str = ""  # why there is none

    @property
    def name(self) -> str:
        """The name of its folder."""
        return self.folder.resolve().name


class Difference(NamedTuple):
    """A figure of both runs, and of the second less the first."""

    name: str
    title: str
    unit: str
    digits: int
    first: float
    second: float
    difference: float
    low: float  # of the 95 % interval of ``difference``
    high: float

    @property
    def significant(self) -> bool:
        """Whether the interval excludes 0."""
        return self.low > 0.0 or self.high < 0.0


def compare(options: CompareConfig, console: Console) -> Path:
    """Print the table and write the page.

    Raises:
        InputError: a folder holds no run.
    """
    path = options.out or Path(f"compare-{options.first.resolve().name}-{options.second.resolve().name}.html")
    writing.check_file(path, (".html",))
    runs = read(options.first), read(options.second)
    rows, summary = differences(*runs), summarize(*runs)
    console.print(_table(rows, [each.name for each in runs]))
    console.print(Text(summary, "dim"), soft_wrap=True)
    writing.write(path, page(rows, runs, summary))
    return path


def read(folder: Path) -> SavedRun:
    """The run in a folder.

    Raises:
        InputError: the folder holds no run.
    """
    for name in ("config.yaml", "episodes.csv"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: holds no {name}; give a folder that `sean run` has finished.")
    content = saved.read_config(folder / "config.yaml", check=False)
    config = validate(RunConfig, content.description)
    description = components.relocate(saved.rename(config.identity(), content.identities), content.identities)
    tasks, columns = saved.read_episodes(folder / "episodes.csv")
    if len(tasks) > config.episodes:
        what = f"has {len(tasks):,} episodes and config.yaml {config.episodes:,}"
        raise InputError(f"{folder / 'episodes.csv'}: {what}; restore the files.")
    columns.pop("timed_out", None)
    try:
        return SavedRun(folder, config, description, tasks, columns, _replay(folder / "report.html"))
    except InputError as error:
        return SavedRun(folder, config, description, tasks, columns, None, str(error))


def _replay(page: Path) -> dict[str, Any]:
    """The replay in a report."""
    texts = REPLAY.findall(files.read_text(page, files.MAX_RECORD))
    if not texts:
        raise InputError(f"{files.short_name(page)}: holds none.")
    with files.sentence(page, "run it again to see its replay"):
        recording = json.loads(texts[0])
        json.dumps(recording, allow_nan=False)
        if not isinstance(recording, dict):
            raise TypeError
    return recording


def paired(first: SavedRun, second: SavedRun) -> int:
    """The number of common episodes, from episode 0 on; 0 if the runs draw other episodes."""
    if [name for name in differing_options(first, second) if name not in UNDRAWN]:
        return 0
    number = min(len(first.tasks), len(second.tasks))
    return number if first.tasks[:number] == second.tasks[:number] else 0


def differing_options(first: SavedRun, second: SavedRun) -> list[str]:
    """Options in which two runs differ."""
    one, other = first.description, second.description
    return [name for name in one if name != "episodes" and one[name] != other.get(name)]


def differences(first: SavedRun, second: SavedRun) -> list[Difference]:
    """The differences of all figures that both runs have."""
    number, rows = paired(first, second), []
    for name in first.columns:
        if "__" in name or name not in second.columns:
            continue
        pair = [each.columns[name][: number or None] for each in (first, second)]
        metric = METRICS.get(name)
        if metric is not None and metric.completed_only:
            pair = [np.where(each.columns["completed"][: len(part)] > 0, part, np.nan)
                    for part, each in zip(pair, (first, second), strict=True)]  # fmt: skip
        if (row := _difference(name, pair, number > 0)) is not None:
            rows.append(row)
    return rows


def _difference(name: str, pair: list[np.ndarray], same: bool) -> Difference | None:
    figure = EPISODE_FIGURES.get(name) or (metric_figure(name, METRICS[name]) if name in METRICS else None)
    title, unit, digits = figure[:3] if figure else (name.replace("_", " "), "", 3)
    scale = 100.0 if unit == "%" else 1.0
    if same:
        both = np.isfinite(pair[0]) & np.isfinite(pair[1])
        if not both.any():
            return None
        one, other = (part[both] for part in pair)
        difference = aggregate(other - one)
        low, high, middle = float(difference.low), float(difference.high), float(difference.mean)
    else:
        one, other = (part[np.isfinite(part)] for part in pair)
        if not (len(one) and len(other)):
            return None
        drawn = [(resamples(len(part), seed) @ part) / len(part) for seed, part in enumerate((one, other))]
        count = min(map(len, drawn))
        ends = interval((drawn[1][:count] - drawn[0][:count])[:, None])
        low, high, middle = float(ends[0][0]), float(ends[1][0]), float(other.mean() - one.mean())
    numbers = (scale * float(value) for value in (one.mean(), other.mean(), middle, low, high))
    return Difference(name, title, unit, digits, *numbers)


def summarize(first: SavedRun, second: SavedRun) -> str:
    """The comparison in words."""
    number, options = paired(first, second), differing_options(first, second)
    rest = f"The runs differ in {', '.join(map(flag, options))}." if options else "The runs have equal options."
    rest += "".join(f" No replay of {each.name}: {each.no_replay}" for each in (first, second) if each.no_replay)
    if number:
        return f"{number} common episodes, compared one by one. {rest}"
    return f"The runs have different episodes, so their means are compared. {rest}"


def _cells(row: Difference) -> tuple[str, str, str, str]:
    one, other = f"{row.first:.{row.digits}f}", f"{row.second:.{row.digits}f}"
    return one, other, f"{row.difference:+.{row.digits}f}", f"{row.low:+.{row.digits}f} to {row.high:+.{row.digits}f}"


def _table(rows: list[Difference], names: list[str]) -> Table:
    lines = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    lines.add_column("", no_wrap=True)
    for name in (*names, "second minus first", "95 % interval"):
        lines.add_column(Text(name), justify="right", no_wrap=name == "95 % interval")
    for row in rows:
        head = Text.assemble(row.title, (f" {row.unit}" if row.unit else "", "dim"))
        lines.add_row(head, *(Text(cell, "bold" if row.significant else "") for cell in _cells(row)))
    return lines


def page(differences: list[Difference], runs: tuple[SavedRun, SavedRun], summary: str) -> str:
    """The comparison as a page, with the replays of both."""
    names = [run.name for run in runs]
    rows = []
    for row in differences:
        one, other, *difference = _cells(row)
        cells = [pages.Cell(cell, kind="ours" if row.significant else "") for cell in difference]
        rows.append([pages.Cell(row.title, row.unit and f" {row.unit}"), one, other, *cells])
    players = [
        (run.name, replay.element(run.replay, f"replay-{index}", linked=False, program=False, clock=True))
        for index, run in enumerate(runs)
        if run.replay is not None
    ]
    return pages.render(
        "evaluation/compare.html",
        title=" and ".join(names),
        kicker="sean_jax · two runs",
        table=pages.table(["", *names, "second minus first", "95 % interval"], rows, "units"),
        note=f"{summary} Bold: the interval excludes 0.",
        players=players,
        script=replay.script(),
        runs=runs,
    )

"""``sean compare``: two runs side by side, by the differences in the episodes that both have.

Runs that differ in who drives, and in nothing that draws an episode, have the same episodes: then each is compared with
itself, and what makes an episode easy or hard cancels. Other runs are compared by their means alone.
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
from sean_jax.evaluation import inputs, output, table
from sean_jax.flags import flag
from sean_jax.metrics import METRICS, aggregate, resamples
from sean_jax.metrics.bootstrap import interval

DRIVING = ("policy", "dynamics", "robot", "metrics", "sensors", "situations", "thresholds", "camera", "renderer")
"""Options that leave the draw of an episode as it is."""

HELD = re.compile(r'<script type="application/json" id="replay">(.*?)</script>', re.S)


@dataclasses.dataclass
class Measured:
    """A run as its folder tells it."""

    folder: Path
    config: RunConfig
    description: dict[str, Any]  # option -> value, with digests in place of files
    tasks: list[str]
    columns: dict[str, np.ndarray]  # name, or metric__situation -> (E,), NaN for an empty cell
    shown: dict[str, Any] | None  # the recording of its report
    unseen: str = ""  # why there is none

    @property
    def name(self) -> str:
        """What tells it from the other."""
        return self.folder.resolve().name


class Difference(NamedTuple):
    """A figure of both runs, and of the second less the first."""

    name: str
    title: str
    unit: str
    digits: int
    first: float
    second: float
    apart: float
    low: float  # of the 95 % interval of ``apart``
    high: float

    @property
    def decided(self) -> bool:
        """Whether the interval leaves out 0."""
        return self.low > 0.0 or self.high < 0.0


def compare(options: CompareConfig, console: Console) -> Path:
    """Print the table and write the page.

    Raises:
        InputError: a folder holds no run.
    """
    path = options.out or Path(f"compare-{options.first.resolve().name}-{options.second.resolve().name}.html")
    writing.check_file(path, (".html",))
    runs = read(options.first), read(options.second)
    found, said = differences(*runs), told(*runs)
    console.print(_table(found, [each.name for each in runs]))
    console.print(Text(said, "dim"), soft_wrap=True)
    writing.write(path, page(found, runs, said))
    return path


def read(folder: Path) -> Measured:
    """A run.

    Args:
        folder: that ``sean run`` has written.

    Raises:
        InputError: it holds no run.
    """
    for name in ("config.yaml", "episodes.csv"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: holds no {name}; give a folder that `sean run` has finished.")
    saved = output.read_config(folder / "config.yaml", check=False)
    config = validate(RunConfig, saved.description)
    description = components.relocate(inputs.rename(config.identity(), saved.identities), saved.identities)
    tasks, columns = output.read_episodes(folder / "episodes.csv")
    if len(tasks) > config.episodes:
        what = f"has {len(tasks):,} episodes and config.yaml {config.episodes:,}"
        raise InputError(f"{folder / 'episodes.csv'}: {what}; restore the files.")
    columns.pop("timed_out", None)
    try:
        return Measured(folder, config, description, tasks, columns, _shown(folder / "report.html"))
    except InputError as error:
        return Measured(folder, config, description, tasks, columns, None, str(error))


def _shown(page: Path) -> dict[str, Any]:
    """The recording in a report."""
    found = HELD.findall(files.read_text(page, files.MAX_RECORD))
    if not found:
        raise InputError(f"{files.short_name(page)}: holds none.")
    with files.sentence(page, "run it again to see its replay"):
        shown = json.loads(found[0])
        json.dumps(shown, allow_nan=False)
        if not isinstance(shown, dict):
            raise TypeError
    return shown


def paired(first: Measured, second: Measured) -> int:
    """How many episodes are the same in both.

    Returns:
        Their number, from episode 0 on; 0 if they were drawn otherwise.
    """
    if [name for name in unlike(first, second) if name not in DRIVING]:
        return 0
    number = min(len(first.tasks), len(second.tasks))
    return number if first.tasks[:number] == second.tasks[:number] else 0


def unlike(first: Measured, second: Measured) -> list[str]:
    """Options in which they differ."""
    one, other = first.description, second.description
    return [name for name in one if name != "episodes" and one[name] != other.get(name)]


def differences(first: Measured, second: Measured) -> list[Difference]:
    """Each figure that both have."""
    number, found = paired(first, second), []
    for name in first.columns:
        if "__" in name or name not in second.columns:
            continue
        pair = [each.columns[name][: number or None] for each in (first, second)]
        metric = METRICS.get(name)
        if metric is not None and metric.completed_only:
            pair = [np.where(each.columns["completed"][: len(part)] > 0, part, np.nan)
                    for part, each in zip(pair, (first, second), strict=True)]  # fmt: skip
        if (row := _difference(name, pair, number > 0)) is not None:
            found.append(row)
    return found


def _difference(name: str, pair: list[np.ndarray], same: bool) -> Difference | None:
    figure = table.EPISODE_FIGURES.get(name) or (table.figure(name, METRICS[name]) if name in METRICS else None)
    title, unit, digits = figure[:3] if figure else (name.replace("_", " "), "", 3)
    scale = 100.0 if unit == "%" else 1.0
    if same:
        both = np.isfinite(pair[0]) & np.isfinite(pair[1])
        if not both.any():
            return None
        one, other = (part[both] for part in pair)
        apart = aggregate(other - one)
        low, high, middle = float(apart.low), float(apart.high), float(apart.mean)
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


def told(first: Measured, second: Measured) -> str:
    """What was compared, in a sentence or two."""
    number, others = paired(first, second), unlike(first, second)
    unlikeness = f"They differ in {', '.join(map(flag, others))}." if others else "They were told the same."
    unseen = "".join(f" No replay of {each.name}: {each.unseen}" for each in (first, second) if each.unseen)
    if number:
        return f"{number} episodes that both have, each compared with itself. {unlikeness}{unseen}"
    return f"Their episodes are not the same, so their means are compared. {unlikeness}{unseen}"


def _cells(row: Difference) -> tuple[str, str, str, str]:
    one, other = f"{row.first:.{row.digits}f}", f"{row.second:.{row.digits}f}"
    return one, other, f"{row.apart:+.{row.digits}f}", f"{row.low:+.{row.digits}f} to {row.high:+.{row.digits}f}"


def _table(found: list[Difference], names: list[str]) -> Table:
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    made.add_column("", no_wrap=True)
    for name in (*names, "second less first", "95 % interval"):
        made.add_column(Text(name), justify="right", no_wrap=name == "95 % interval")
    for row in found:
        head = Text.assemble(row.title, (f" {row.unit}" if row.unit else "", "dim"))
        made.add_row(head, *(Text(cell, "bold" if row.decided else "") for cell in _cells(row)))
    return made


def page(found: list[Difference], runs: tuple[Measured, Measured], said: str) -> str:
    """The comparison as a page, with the replays of both."""
    names = [run.name for run in runs]
    rows = []
    for row in found:
        one, other, *difference = _cells(row)
        cells = [pages.Cell(cell, kind="ours" if row.decided else "") for cell in difference]
        rows.append([pages.Cell(row.title, row.unit and f" {row.unit}"), one, other, *cells])
    players = [
        (run.name, replay.element(run.shown, f"replay-{index}", linked=False, program=False))
        for index, run in enumerate(runs)
        if run.shown is not None
    ]
    return pages.render(
        "evaluation/comparison.html",
        title=" and ".join(names),
        kicker="sean_jax · two runs",
        table=pages.table(["", *names, "second less first", "95 % interval"], rows, "units"),
        note=f"{said} Bold: the interval leaves out 0.",
        players=players,
        script=replay.script(),
        runs=runs,
    )

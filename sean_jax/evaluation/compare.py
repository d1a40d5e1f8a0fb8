"""``sean compare``: runs against the first of them, overall and within each situation.

Runs that differ only in options that do not draw an episode, such as the policy, have the same episodes. They are
compared episode by episode, so the difficulty of an episode cancels. Other runs are compared by their means.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sean_jax.config import CompareConfig, RunConfig, validate
from sean_jax.config.flags import command, flag
from sean_jax.config.input_files import rename
from sean_jax.core.errors import InputError
from sean_jax.evaluation import run_folder
from sean_jax.evaluation.table import EPISODE_FIGURES, TableFigure, metric_figure
from sean_jax.io import files, writing
from sean_jax.metrics import METRICS
from sean_jax.metrics.differences import Difference, difference, holm
from sean_jax.web import pages, replay

UNDRAWN = ("policy", "dynamics", "robot", "metrics", "sensors", "situations", "thresholds", "camera")
"""Options that do not change the draw of an episode."""

REPLAY = '<script type="application/json" id="replay">', "</script>"  # around the replay of a report
OVERALL = "overall"
LEVEL = 0.05  # of corrected p-values
SYMBOLS = {"better": "✓ better", "worse": "✗ worse", "differs": "≠ differs", "": ""}
SAME = "same in each"  # episode, which is not tested
LONGEST = 100  # characters of the page's default name
WIDEST = 3.0  # standard deviations that a plot shows


@dataclasses.dataclass
class SavedRun:
    """A run, read from its folder."""

    folder: Path
    name: str
    config: RunConfig
    description: dict[str, Any]  # option -> value, with digests in place of files
    tasks: list[str]
    columns: dict[str, np.ndarray]  # name, or metric__situation -> (E,), NaN for an empty cell
    figures: dict[str, TableFigure]  # of the user's own metrics
    replay: dict[str, Any] | None = None  # of its report
    no_replay: str = ""  # why there is none

    @property
    def robots(self) -> int:
        """The number of rows of an episode."""
        return len(self.config.team) or 1


class ComparedFigure(NamedTuple):
    """A figure of two runs."""

    name: str
    figure: TableFigure
    values: Difference
    up_to_best: Difference | None = None  # of the values cut at the figure's best one; None if none is beyond it
    clear: bool = False  # whether a difference is significant among all that are tested
    directed: bool = False  # whether it is one of better and worse values

    @property
    def tested(self) -> bool:
        """Whether any episode differs."""
        return math.isfinite(self.values.p)

    def judged(self, p: float, p_up_to_best: float) -> "ComparedFigure":
        """The row with corrected p-values of its differences."""
        clear = bool(p <= LEVEL)
        directed = clear if self.up_to_best is None else bool(p_up_to_best <= LEVEL)
        return self._replace(clear=clear or directed, directed=directed)

    @property
    def verdict(self) -> str:
        """The second run is "better" or "worse", it "differs" without a better direction, or ""."""
        if not self.clear:
            return ""
        if not (self.figure.better and self.directed):
            return "differs"
        rise = (self.up_to_best or self.values).difference > 0
        return "better" if rise == (self.figure.better == "higher") else "worse"

    def texts(self) -> tuple[str, str, str, str]:
        """Both means, the difference, and its interval, which is empty where both ends are the same."""
        scale = 100.0 if self.figure.unit == "%" else 1.0
        digits = self.figure.digits
        one, other = (f"{scale * mean:.{digits}f}" for mean in self.values[:2])
        middle, low, high = (_signed(scale * value, digits) for value in self.values[2:5])
        interval = "" if low == high else f"{low} to {high}"
        return one, other, middle, interval


def _signed(value: float, digits: int) -> str:
    text = f"{value:+.{digits}f}"
    return text if float(text) else text[1:]


Views = dict[str, list[list[ComparedFigure]]]
"""OVERALL or a situation -> for each run but the first, its rows by the size of their effect."""


def compare(options: CompareConfig, console: Console) -> Path:
    """Print the tables and write the page.

    Raises:
        InputError: there are fewer than two folders, one holds no run, or none has the situation.
    """
    if len(options.runs) < 2:
        raise InputError(f"compare: needs the folders of two or more runs, not of {len(options.runs)}.")
    names = [folder.resolve().name for folder in options.runs]
    path = options.out or Path(f"compare-{'-'.join(names)[:LONGEST]}.html")
    writing.check_file(path, (".html",))

    # Runs in folders of one name have their paths as names.
    runs = []
    for folder, name in zip(options.runs, names, strict=True):
        runs.append(read_run(folder, name if names.count(name) == 1 else str(folder)))
    views = differences(runs)
    words = summarize(runs)
    if options.situation not in views:
        raise InputError(f"--situation: '{options.situation}' is not one of {', '.join(views)}.")

    for other, rows in zip(runs[1:], views[options.situation], strict=True):
        console.print(_table(rows, runs[0].name, other.name))
    family = OVERALL if options.situation == OVERALL else "situations"
    console.print(Text(f"{words} {tested(views)[family]}", "dim"), soft_wrap=True)
    writing.write(path, page(views, runs, words))
    return path


def read_run(folder: Path, name: str = "") -> SavedRun:
    """The run in a folder; its name is by default that of the folder.

    Raises:
        InputError: the folder holds no run.
    """
    for file in ("config.yaml", "episodes.csv"):
        if not (folder / file).is_file():
            raise InputError(f"{folder}: holds no {file}; give a folder that `sean run` has finished.")
    content = run_folder.read_config(folder / "config.yaml", check=False)
    config = validate(RunConfig, content.description)
    description = rename(config.identity(), content.identities)
    tasks, columns = run_folder.read_episodes(folder / "episodes.csv")
    if len(tasks) > config.episodes * (len(config.team) or 1):
        raise InputError(
            f"{folder / 'episodes.csv'}: has {len(tasks):,} rows and config.yaml {config.episodes:,} episodes; "
            "restore the files."
        )
    columns.pop("timed_out", None)
    figures = _own_figures(folder / "summary.json")
    run = SavedRun(folder, name or folder.resolve().name, config, description, tasks, columns, figures)
    try:
        return dataclasses.replace(run, replay=_replay(folder / "report.html"))
    except InputError as error:
        return dataclasses.replace(run, no_replay=str(error))


def _own_figures(path: Path) -> dict[str, TableFigure]:
    """The user's own metrics in a summary.json; {} if there is none."""
    if not path.is_file():
        return {}
    content = files.read_json(path)
    with files.sentence(path, "restore it, or remove it"):
        figures = {name: TableFigure(**fields) for name, fields in content["own_metrics"].items()}
        for figure in figures.values():
            is_text = all(isinstance(text, str) for text in figure[:2])
            if not (is_text and type(figure.digits) is int and 0 <= figure.digits < 10):
                raise ValueError
            if figure.better not in ("", "lower", "higher"):
                raise ValueError
            if figure.best not in (None, "goal_radius") and not math.isfinite(float(figure.best)):
                raise ValueError
    return figures


def _replay(page: Path) -> dict[str, Any]:
    """The replay in a report."""
    text = files.read_text(page, files.MAX_RECORD)
    begin = text.find(REPLAY[0])
    end = text.find(REPLAY[1], begin)
    if begin < 0 or end < 0:
        raise InputError(f"{files.short_name(page)}: holds none.")
    with files.sentence(page, "run it again to see its replay"):
        recording = files.parse_json(text[begin + len(REPLAY[0]) : end])
        if not isinstance(recording, dict):
            raise TypeError
    return recording


def paired(first: SavedRun, second: SavedRun) -> int:
    """The number of common episodes, from episode 0 on; 0 if the runs draw other episodes.

    A team has a row for each robot of an episode.
    """
    if [name for name in differing_options(first, second) if name not in UNDRAWN]:
        return 0
    number = min(len(first.tasks), len(second.tasks))
    return number // first.robots if first.tasks[:number] == second.tasks[:number] else 0


def differing_options(first: SavedRun, second: SavedRun) -> list[str]:
    """Options in which two runs differ."""
    one, other = first.description, second.description
    return [name for name in one if name != "episodes" and one[name] != other.get(name)]


def differences(runs: Sequence[SavedRun]) -> Views:
    """The figures of all runs beside those of the first, overall and in each situation.

    The overall figures of all runs are one family of tests, and those within situations are another. In each family,
    the probability of any false difference is 5 % at most (``metrics.differences.holm``).
    """
    names = [name for name in runs[0].columns if all(name in run.columns for run in runs)]
    situations = list(dict.fromkeys(name.partition("__")[2] or OVERALL for name in names))
    views = {view: [_rows(runs[0], run, names, view) for run in runs[1:]] for view in (OVERALL, *situations)}
    _judge(views, [OVERALL])
    _judge(views, [view for view in views if view != OVERALL])
    return views


def _judge(views: Views, family: list[str]) -> None:
    """Give the rows of some views p-values that are corrected for all of them."""
    p_values = []
    for view in family:
        for row in itertools.chain(*views[view]):
            p_values += [row.values.p, math.nan if row.up_to_best is None else row.up_to_best.p]
    corrected = iter(holm(p_values))
    for view in family:
        views[view] = [[row.judged(next(corrected), next(corrected)) for row in rows] for rows in views[view]]


def _rows(first: SavedRun, second: SavedRun, names: list[str], view: str) -> list[ComparedFigure]:
    """The figures of a view, by the size of their effect."""
    common = paired(first, second)
    rows = []
    for column in names:
        name, _, situation = column.partition("__")
        is_duration = name == "time_in_situation" and not situation
        if (situation or OVERALL) == view and not is_duration:
            row = _row(first, second, column, common)
            rows += [] if row is None else [row]
    return sorted(rows, key=lambda row: (not row.tested, -abs(row.values.effect)))


def _row(first: SavedRun, second: SavedRun, column: str, common: int) -> ComparedFigure | None:
    """A figure of two runs, of which the first ``common`` episodes are the same; None without values."""
    name = column.partition("__")[0]
    figure = _figure(name, first)
    values = []
    cut_values = []
    is_cut = False
    for run in (first, second):
        rows = run.columns[column][: common * run.robots or None]
        if figure.completed_only:
            rows = np.where(run.columns["completed"][: len(rows)] > 0, rows, np.nan)
        cut_rows = _up_to_best(rows, figure, run)
        is_cut |= not np.array_equal(cut_rows, rows, equal_nan=True)
        values.append(_by_episode(rows, run.robots))
        cut_values.append(_by_episode(cut_rows, run.robots))

    change = difference(values[0], values[1], common > 0)
    if change is None:
        return None
    return ComparedFigure(
        name, figure, change, difference(cut_values[0], cut_values[1], common > 0) if is_cut else None
    )


def _figure(name: str, run: SavedRun) -> TableFigure:
    """The presentation of a figure of the package, or of the user's own in a run."""
    if name in EPISODE_FIGURES:
        return EPISODE_FIGURES[name]
    if name in METRICS:
        return metric_figure(name, METRICS[name])
    return run.figures.get(name) or TableFigure(name.replace("_", " "), "", 3, "")


def _up_to_best(values: np.ndarray, figure: TableFigure, run: SavedRun) -> np.ndarray:
    """The values of a run with the figure's best value in place of those beyond it."""
    if figure.best is None or not figure.better:
        return values
    best = run.config.goal_radius if figure.best == "goal_radius" else figure.best
    return np.maximum(values, best) if figure.better == "lower" else np.minimum(values, best)


def _by_episode(values: np.ndarray, robots: int) -> np.ndarray:
    """The means (E,) over the robots of each episode that have a value; they depend on each other."""
    if robots == 1:
        return values
    rows = values.reshape(-1, robots)
    number = np.isfinite(rows).sum(1)
    return np.where(number > 0, np.nansum(rows, 1) / np.maximum(number, 1), np.nan)


def summarize(runs: Sequence[SavedRun]) -> str:
    """The episodes and the options in words."""
    first, *others = runs
    sentences = []
    for other in others:
        number = paired(first, other)
        names = differing_options(first, other)
        subject = f"{other.name} and {first.name}" if len(others) > 1 else "The runs"
        episodes = "have different episodes, so their means are compared"
        if number:
            episodes = f"have {number} common episodes, compared one by one"
        options = f"differ in {', '.join(map(flag, names))}" if names else "have equal options"
        sentences.append(f"{subject} {episodes}; they {options}.")
    sentences += [f"No replay of {run.name}: {run.no_replay}" for run in runs if run.no_replay]
    return " ".join(sentences)


def tested(views: Views) -> dict[str, str]:
    """OVERALL and "situations" -> the number of tests and the correction in words."""
    words = {}
    for name in (OVERALL, "situations"):
        family = [view for view in views if (view == OVERALL) == (name == OVERALL)]
        count = sum(row.tested for view in family for rows in views[view] for row in rows)
        figures = "figures" if name == OVERALL else "figures within situations"
        words[name] = (
            f"{count} {figures} were tested and marked after Holm's correction: the probability of any false mark "
            f"among them is 5 % at most. Intervals are not corrected, so one may exclude 0 without a mark."
        )
    return words


def _table(rows: list[ComparedFigure], first: str, second: str) -> Table:
    title = Text(f"{second} minus {first}: {_counts(rows)}")
    lines = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold", pad_edge=False)
    lines.add_column("")
    body = [(*row.texts(), SYMBOLS[row.verdict] if row.tested else SAME) for row in rows]
    for k, name in enumerate((first, second, "change", "95 % interval", "")):
        width = max((len(texts[k]) for texts in body), default=0)
        least_width = 6 if name else 0
        justify = "right" if name else "left"
        lines.add_column(Text(name, overflow="fold"), justify=justify, width=max(width, least_width))
    for row, texts in zip(rows, body, strict=True):
        figure = row.figure
        unit = f" {figure.unit}" if figure.unit else ""
        head = Text.assemble(figure.title, (unit, "dim"))
        lines.add_row(head, *(Text(text, "bold" if row.clear else "") for text in texts))
    return lines


def _counts(rows: list[ComparedFigure]) -> str:
    """How many figures are better, worse, or neither, in words."""
    number = {verdict: sum(row.verdict == verdict for row in rows) for verdict in SYMBOLS}
    different = f", {number['differs']} different without a better direction" if number["differs"] else ""
    return f"{number['better']} better, {number['worse']} worse{different}, {number['']} without a clear difference"


# ------------------------------------------------------------------ the page


def page(views: Views, runs: Sequence[SavedRun], words: str) -> str:
    """The comparison as a page, with the replays of all runs on one clock."""
    players = [
        (run.name, replay.element(run.replay, f"replay-{index}", linked=False, program=False, clock=True))
        for index, run in enumerate(runs)
        if run.replay is not None
    ]
    differing = [name for name in runs[0].description if any(name in differing_options(runs[0], run) for run in runs)]
    return pages.render(
        "evaluation/compare.html",
        title=" and ".join([", ".join(run.name for run in runs[:-1]), runs[-1].name]),
        kicker=f"sean_jax · {len(runs)} runs",
        views={
            view: [_Side.of(run, rows) for run, rows in zip(runs[1:], each, strict=True)]
            for view, each in views.items()
        },  # fmt: skip
        first=runs[0],
        note=words,
        tested=tested(views),
        symbols=SYMBOLS,
        same=SAME,
        players=players,
        script=replay.script(),
        runs=runs,
        head=["option", *(run.name for run in runs)],
        options=[[flag(name), *_values(name, runs)] for name in differing],
        commands=[command("run", run.config).replace(" --", "\n--") for run in runs],
    )


class _Side(NamedTuple):
    """A run beside the first."""

    run: SavedRun
    clear: list[ComparedFigure]
    others: list[ComparedFigure]
    scale: float  # standard deviations at the edge of a plot
    counts: str

    @classmethod
    def of(cls, run: SavedRun, rows: list[ComparedFigure]) -> "_Side":
        sizes = [abs(end) / row.values.deviation for row in rows if row.values.deviation for end in row.values[3:5]]
        clear = [row for row in rows if row.clear]
        others = [row for row in rows if not row.clear]
        return cls(run, clear, others, min(max([*sizes, 0.5]), WIDEST), _counts(rows))

    def at(self, row: ComparedFigure, value: float) -> float:
        """The place of a difference or an end of its interval in a plot, from -1 to 1."""
        deviation = row.values.deviation
        if deviation:
            size = value / deviation
        else:
            size = math.copysign(math.inf, value) if value else 0.0
        return max(-1.0, min(1.0, size / self.scale))


def _values(name: str, runs: Sequence[SavedRun]) -> list[str]:
    """The value of an option in each run as text."""
    values = [run.config.identity()[name] for run in runs]
    texts = [value if isinstance(value, str) else yaml.safe_dump(value, default_flow_style=True, width=1000)
             .removesuffix("...\n").strip() for value in values]  # fmt: skip
    if len(set(texts)) == 1:  # files of one name
        texts = [f"{text} ({run.folder}'s)" for text, run in zip(texts, runs, strict=True)]
    return texts

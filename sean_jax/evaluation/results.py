"""The results of a run: ``Evaluation``, its figures with intervals, its table, and its files.

Every figure is a ratio of two sums over episodes, so one bootstrap (``metrics.bootstrap``) serves all.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sean_jax import writing
from sean_jax.base import Scenario, Trajectory
from sean_jax.config import RunConfig
from sean_jax.drawing.colors import situation_colors
from sean_jax.evaluation import saved
from sean_jax.flags import command
from sean_jax.metrics import Estimate, Metric, aggregate_ratio, resamples
from sean_jax.metrics.bootstrap import of_share
from sean_jax.metrics.metric import MEAN
from sean_jax.versions import versions


@dataclasses.dataclass
class Evaluation:
    """The results of E episodes of a policy with S situations, as numpy arrays."""

    scenario: Scenario  # the first, if several took turns
    policy: str
    situations: tuple[str, ...]
    tasks: list[str]  # per episode
    completed: np.ndarray  # (E,) bool
    timed_out: np.ndarray  # (E,) bool
    seconds: np.ndarray  # (E,) s, until the episode ended
    metrics: dict[str, np.ndarray]  # name -> (E,) or (E, 1 + S): overall, then by situation
    definitions: dict[str, Metric]  # name -> the metric, in the scenario's order
    heat: np.ndarray  # (rows, columns) s that people spent in each cell of the floor
    walks: np.ndarray  # (M, M) people who walked the edge from the row's node to the column's, (0, 0) without a graph
    together: np.ndarray  # (2 ** S,) s of robot time per set of situations
    penetration: float  # m, deepest that a body was in an obstacle
    group_size: np.ndarray  # (G,) most members
    frames: list[Trajectory]  # of the first episodes, (T, ...) each
    compile_seconds: float
    run_seconds: float
    wanted: int  # requested episodes; Ctrl-C leaves fewer

    def summary(self) -> dict[str, Any]:
        """Shares of the situations, means of the metrics with 95 % bootstrap intervals, checks and timing."""
        simulated = float(self.seconds.sum())
        return {
            "scenario": self.names(),
            "episodes": len(self.tasks),
            "episodes_wanted": self.wanted,
            "simulated_seconds": round(simulated, 3),
            **aggregate_episodes(self),
            "checks": {
                "largest_penetration_mm": round(max(1000.0 * self.penetration, 0.0), 4),
                "people_inside_obstacles": bool(self.penetration > float(self.scenario.forces.walking.radius)),
                "largest_groups": [int(size) for size in self.group_size],
                "not_finite": 0,
            },
            "timing": {
                "compile_seconds": round(self.compile_seconds, 3),
                "run_seconds": round(self.run_seconds, 3),
                "simulated_seconds_per_second": round(simulated / max(self.run_seconds, 1e-9), 1),
                "device": f"{len(jax.devices())} x {jax.devices()[0].device_kind}",
            },
        }

    def names(self) -> dict[str, Any]:
        """The names of the environment, behavior, tasks, robot and policy, and the number of people."""
        scenario = self.scenario
        return {
            "environment": scenario.environment.name,
            "behavior": scenario.behavior.name,
            "tasks": list(dict.fromkeys(self.tasks)),
            "robot": scenario.robot.name,
            "policy": self.policy,
            "people": scenario.people,
        }

    @property
    def title(self) -> str:
        """The names in one line."""
        return title(self.scenario, list(dict.fromkeys(self.tasks)), len(self.tasks))

    def rows(self, complete: bool = False) -> list[Row]:
        """The rows of the table: the headlines, or every metric if ``complete``."""
        return table_rows(self.summary(), self.definitions, complete)

    def print_table(self, console: Console) -> None:
        """Print the table."""
        print_table(console, self.summary(), self.definitions, self.title, self.exclusive_shares()["none"])

    def table(self, width: int = 120) -> str:
        """The table as text."""
        stream = io.StringIO()
        self.print_table(Console(file=stream, width=width, color_system=None))
        return stream.getvalue()

    def exclusive_shares(self) -> dict[str, float]:
        """Situation, or "none" -> its share of robot time; time in several situations is divided equally among them."""
        total = max(float(self.together.sum()), 1e-9)
        shares = dict.fromkeys((*self.situations, "none"), 0.0)
        for index in np.flatnonzero(self.together):
            names = [name for bit, name in enumerate(self.situations) if index >> bit & 1] or ["none"]
            for name in names:
                shares[name] += float(self.together[index]) / len(names) / total
        return shares

    def save(self, folder: Path | str) -> Path:
        """Write the files of ``sean run`` to a new or empty folder: report, episodes.csv, summary.json, animation.

        Raises:
            InputError: the folder is not empty.
            WriteError: it cannot be written.
        """
        folder = Path(folder)
        writing.check_new_folder(folder, "folder")
        with writing.atomic_folder(folder) as new_folder:
            write_all(new_folder, self)
        return folder


def title(scenario: Scenario, tasks: list[str], episodes: int) -> str:
    """A run in one line."""
    what = f"{scenario.environment.name} · {scenario.behavior.name} · {' / '.join(tasks)} · {scenario.robot.name}"
    return f"{what} · {scenario.people} people · {episodes} episodes"


def aggregate_episodes(results: Evaluation) -> dict[str, Any]:
    """Means with 95 % bootstrap intervals over episodes, overall and by situation (Table I, Figure 4).

    By situation, a time or a count is the mean per episode of its part in that situation. ``completed`` and metrics of
    completed episodes are means over the episodes in which the situation occurred. Without the metric
    ``time_in_situation`` these episodes are unknown, and such figures are None.

    Returns:
        ``{"situations": {situation: figure}, "metrics": {name: {column: figure}}}`` with the columns "overall" and the
        situations. A figure has a mean, an interval and its number of episodes; it is None without episodes.
    """
    columns = ("overall", *results.situations)
    weights = resamples(len(results.completed))
    every = np.ones(len(results.completed))

    def by_column(values: np.ndarray, applies: np.ndarray, shares: bool = False) -> dict[str, Any]:
        estimate = aggregate_ratio(values * applies, applies, weights=weights)
        estimate = of_share(estimate) if shares else estimate
        return {
            name: _figure(Estimate(*(part[k] for part in estimate)))
            for k, name in enumerate(columns[: values.shape[1]])
        }

    shares, among = dict.fromkeys(results.situations), every[:, None]
    if (spent := results.metrics.get("time_in_situation")) is not None:  # (E, 1 + S) s
        shares = {
            name: _figure(aggregate_ratio(spent[:, k + 1], spent[:, 0], weights=weights))
            for k, name in enumerate(results.situations)
        }
        among = np.concatenate([among, spent[:, 1:] > 0], 1).astype(float)
    number = among.shape[1]
    figures = {"completed": by_column(np.repeat(results.completed[:, None], number, 1).astype(float), among, True)}
    for name, values in results.metrics.items():
        if name in ("completed", "timed_out"):
            continue
        completed_only = results.definitions[name].completed_only
        cells = values.reshape(len(values), -1).astype(float)
        if completed_only:
            cells = np.repeat(cells, number, 1) if cells.shape[1] == 1 else cells[:, :number]
        applies = np.isfinite(cells).astype(float)
        if completed_only:
            applies = applies * among * results.completed[:, None]
        figures[name] = by_column(np.where(np.isfinite(cells), cells, 0.0), applies)
    figures["seconds"] = by_column(results.seconds[:, None].astype(float), every[:, None])
    return {"situations": shares, "metrics": figures}


def _figure(estimate: Estimate) -> dict[str, Any] | None:
    """An estimate of shape () as summary.json has it; None if it has no episode."""
    if not estimate.episodes:
        return None
    interval = [float(estimate.low), float(estimate.high)]
    return {"mean": float(estimate.mean), "interval": interval, "episodes": int(estimate.episodes)}


# ------------------------------------------------------------------ the table


class Figure(NamedTuple):
    """The presentation of a figure."""

    title: str
    unit: str  # "%" shows a share in percent
    digits: int
    definition: str


EPISODE_FIGURES = {  # of the episode itself, which no metric measures; first in the table
    "share": Figure(
        "share of robot time",
        "%",
        1,
        "Time in the situation over the time that the episodes lasted; situations may overlap.",
    ),
    "completed": Figure(
        "completed",
        "%",
        1,
        "The robot came to its goal within the time limit; by situation: of the episodes in which it occurred.",
    ),
    "seconds": Figure("duration", "s", 1, "Until the goal or the time limit."),
}
_UNITS = {"1": "", "m/s2": "m/s²", "m/s3": "m/s³"}  # as they are shown
SECTIONS = {"intimate": "distances", "personal": "distances", "collision": "collisions"}  # first word -> section
GAP = 3  # characters between columns


@dataclasses.dataclass
class Row:
    """A row of the table, as text."""

    name: str
    title: str
    unit: str
    definition: str
    cells: list[str]  # overall, then each situation; "" where there is no figure
    intervals: list[str]  # 95 %, likewise


def table_rows(summary: dict[str, Any], definitions: Mapping[str, Metric], complete: bool = False) -> list[Row]:
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
            lines.append(_row(name, figure(name, metric), figures[name], columns))
    return lines


def figure(name: str, metric: Metric) -> Figure:
    """The title, unit, digits and definition of a metric."""
    unit = "%" if metric.kind == "share" else _UNITS.get(metric.unit, metric.unit)
    title, definition = metric.title or name.replace("_", " "), metric.definition or MEAN
    return Figure(title, unit, metric.digits, definition)


def _row(name: str, figure: Figure, values: dict[str, Any], columns: list[str]) -> Row:
    scale = 100.0 if figure.unit == "%" else 1.0
    cells, intervals = [], []
    for column in columns:
        value = values.get(column)
        cells.append("" if value is None else f"{scale * value['mean']:.{figure.digits}f}")
        low_high = (f"{scale * end:.{figure.digits}f}" for end in value["interval"]) if value else ()
        intervals.append(" to ".join(low_high))
    return Row(name, figure.title, figure.unit, figure.definition, cells, intervals)


def print_table(
    console: Console, summary: dict[str, Any], definitions: Mapping[str, Metric], title: str, none: float
) -> None:
    """Print the table of a summary in blocks as wide as the terminal; ``none`` is the share of time in no situation."""
    names = list(summary["situations"])
    shades = situation_colors(tuple(names))
    lines = table_rows(summary, definitions)
    margin = 1 + max(len(f"{row.title} {row.unit}".strip()) for row in lines)
    longest = [max(len(row.cells[k]) for row in lines) for k in range(1 + len(names))]
    widths = [max(cell, *map(len, name.split("_"))) for name, cell in zip(("overall", *names), longest, strict=True)]
    for first, last in _blocks(widths, console.width - margin):
        table = Table(box=box.SIMPLE_HEAD, title=Text(title), title_justify="left", title_style="bold", pad_edge=False)
        table.add_column("", no_wrap=True)
        if first == 0:
            table.add_column("overall", justify="right", style="bold", no_wrap=True)
        for name, color in zip(names[first:last], shades[first:last], strict=True):
            table.add_column(Text(name.replace("_", "\n"), style=f"bold {color}"), justify="right", no_wrap=True)
        last_section, title = "", ""
        for row in lines:
            section = SECTIONS.get(row.name.split("_")[0], "")
            if section != last_section:
                table.add_section()
            last_section = section
            head = Text.assemble(row.title, (f" {row.unit}" if row.unit else "", "dim"))
            cells = row.cells[first + (first > 0) : last + 1]
            table.add_row(head, *(Text(cell) if cell else Text("–", "dim") for cell in cells))
        console.print(table)
    console.print(f"In no situation: {100.0 * none:.1f} % of the robot's time.", highlight=False)
    console.print(
        "[dim]Violations and collisions are times per episode; 95 % intervals are in summary.json.[/]", soft_wrap=True
    )


def _blocks(widths: list[int], width: int) -> list[tuple[int, int]]:
    """(first, last) situation of each block of ``width`` characters.

    ``widths`` are those of the columns: overall, in the first block, and the situations.
    """
    overall, *situations = widths
    blocks, first, left = [], 0, width - overall - GAP
    for k, needed in enumerate(situations):
        if needed + GAP > left and k > first:
            blocks.append((first, k))
            first, left = k, width
        left -= needed + GAP
    return [*blocks, (first, len(situations))]


# ------------------------------------------------------------------ files


def write_all(
    folder: Path, evaluation: Evaluation, config: RunConfig | None = None, inputs: saved.Inputs | None = None
) -> None:
    """Write all files of an evaluation to an empty folder.

    ``config`` and its input files are those of ``sean run``; an evaluation in Python, which no file repeats, has none.
    """
    from sean_jax import drawing, replay, report

    packages = versions()
    about = {"scenario": evaluation.names(), "people": evaluation.scenario.people, "versions": packages}
    saved.write_config(folder, about, config, inputs)
    write_episodes(folder / "episodes.csv", evaluation)
    summary = evaluation.summary()
    (folder / "summary.json").write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    scenario = evaluation.scenario
    graph = drawing.graph_of(scenario)
    if evaluation.frames:
        drawing.animate(
            scenario.environment,
            evaluation.frames[0],
            folder / "episode.gif",
            graph=graph,
            situations=evaluation.situations,
            time_step=scenario.time_step,
            robot_radius=scenario.robot.radius,
            title=evaluation.tasks[0].replace("_", " "),
        )
    if evaluation.frames and config is not None and config.camera is not None:
        drawing.video(evaluation.frames[0], scenario, folder / "camera.gif", view=config.camera)
    shown = []
    for i, frames in enumerate(evaluation.frames):
        ended = outcome(bool(evaluation.completed[i]), float(evaluation.seconds[i]))
        shown.append(replay.Episode(frames, f"episode {i} · {evaluation.tasks[i].replace('_', ' ')}", ended))
    page = report.Report(
        title=evaluation.title,
        command="sean_jax.evaluate, in a Python program" if config is None else command("run", config),
        versions=packages,
        environment=scenario.environment,
        graph=graph,
        situations=evaluation.situations,
        rows=[dataclasses.asdict(row) for row in evaluation.rows(complete=True)],
        shares=evaluation.exclusive_shares(),
        heat=evaluation.heat,
        walks=evaluation.walks,
        tasks=evaluation.tasks,
        completed=evaluation.completed,
        seconds=evaluation.seconds,
        frames=evaluation.frames,
        replay=replay.of_scenario(scenario, shown) if shown else None,
        time_step=scenario.time_step,
        robot_radius=scenario.robot.radius,
        time_limit=scenario.time_limit,
        checks=summary["checks"],
        timing=summary["timing"],
    )
    (folder / "report.html").write_text(report.html(page), encoding="utf-8")


def outcome(completed: bool, seconds: float) -> str:
    """How an episode of so many seconds ended, in words."""
    return f"{'completed' if completed else 'not completed'} in {seconds:.1f} s"


def write_episodes(path: Path, evaluation: Evaluation) -> None:
    """Write episodes.csv: a row for each episode, with metrics overall and as ``metric__situation``.

    Equal results give equal bytes. A value that is not finite is an empty cell.
    """
    columns: dict[str, np.ndarray] = {}
    for name, values in evaluation.metrics.items():
        if name in ("completed", "timed_out"):
            continue
        values = values.astype(np.int64) if evaluation.definitions[name].kind == "count" else values
        if values.ndim == 1:
            columns[name] = values
            continue
        columns[name] = values[:, 0]
        for k, situation in enumerate(evaluation.situations):
            columns[f"{name}__{situation}"] = values[:, k + 1]
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["episode", "task", "completed", "timed_out", "seconds", *columns])
        for i, task in enumerate(evaluation.tasks):
            ended = str(bool(evaluation.completed[i])), str(bool(evaluation.timed_out[i]))
            cells = (_cell(values[i]) for values in columns.values())
            writer.writerow([i, task, *ended, f"{evaluation.seconds[i]:.3f}", *cells])


def _cell(value: Any) -> str:
    if isinstance(value, np.integer | np.bool_):
        return str(int(value))
    return f"{value:.6f}" if np.isfinite(value) else ""

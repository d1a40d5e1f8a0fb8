"""The results of a run: ``Evaluation``, its figures with intervals, its files and its report.

Every figure is a ratio of two sums over episodes, so one bootstrap (``metrics.bootstrap``) serves all but shares of
episodes and counts without an event, whose intervals are exact or Wilson's.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from rich.console import Console

from sean_jax import drawing, metrics, robots
from sean_jax.core.data_types import Scenario, Trajectory
from sean_jax.drawing.colors import NO_SITUATION, situation_colors
from sean_jax.drawing.svg import svg
from sean_jax.evaluation import compare, run_plan, table
from sean_jax.evaluation.compare import SavedRun
from sean_jax.evaluation.run_plan import RunPlan
from sean_jax.io import writing
from sean_jax.io.versions import versions
from sean_jax.metrics import Estimate, Metric, aggregate_ratio, resamples
from sean_jax.metrics.bootstrap import of_count, of_share
from sean_jax.web import pages, replay


@dataclasses.dataclass
class Evaluation:
    """The results of E episodes of a policy with S situations, as numpy arrays."""

    scenario: Scenario  # the first, if several took turns; on the first of several floors
    policy: str
    situations: tuple[str, ...]
    tasks: list[str]  # per episode
    completed: np.ndarray  # (E,) bool
    timed_out: np.ndarray  # (E,) bool
    seconds: np.ndarray  # (E,) s, until the episode ended
    metrics: dict[str, np.ndarray]  # name -> (E,) or (E, 1 + S): overall, then by situation
    definitions: dict[str, Metric]  # name -> the metric, in the scenario's order
    heat: np.ndarray  # (rows, columns) s that people spent in each cell of the floor; (0, 0) of several floors
    walks: np.ndarray  # (M, M) people who walked the edge from the row's node to the column's, (0, 0) without a graph
    together: np.ndarray  # (2 ** S,) s of robot time per set of situations
    penetration: float  # m, deepest that a body was in an obstacle
    group_size: np.ndarray  # (G,) most members
    frames: list[Trajectory]  # of the first episodes, (T, ...) each
    compile_seconds: float
    run_seconds: float
    wanted: int  # requested episodes; Ctrl-C leaves fewer
    floors: Sequence[str] = ()  # name per episode, if there are several
    places: Sequence[Scenario] = ()  # of the frames, if there are several floors
    set_floors: int = 1  # of the set; fewer episodes are on the first ones
    robots: Sequence[str] = ()  # of a team, whose E rows are the robots of an episode in turn; empty without one

    def place(self, index: int) -> Scenario:
        """The scenario of the frames of an episode, on its floor."""
        return self.places[index] if self.places else self.scenario

    @property
    def episodes(self) -> int:
        """The number of episodes; a team has as many rows for each as it has robots."""
        return len(self.tasks) // (len(self.robots) or 1)

    def summary(self) -> dict[str, Any]:
        """Shares of the situations, means of the metrics with 95 % intervals, checks and timing."""
        simulated = float(self.seconds.sum())
        floors = list(dict.fromkeys(self.floors))
        of_set = {"floors": len(floors), "set_floors": self.set_floors, "environments": floors} if floors else {}
        groups = {} if floors else {"largest_groups": [int(size) for size in self.group_size]}
        own = {name: metric for name, metric in self.definitions.items() if name not in metrics.METRICS}
        return {
            "scenario": self.names(),
            **of_set,
            "episodes": self.episodes,
            "episodes_wanted": self.wanted // (len(self.robots) or 1),
            **({"robots": list(self.robots)} if self.robots else {}),
            "simulated_seconds": round(simulated, 3),
            **aggregate_episodes(self),
            "own_metrics": {name: table.metric_figure(name, metric)._asdict() for name, metric in own.items()},
            "checks": {
                "largest_penetration_mm": round(max(1000.0 * self.penetration, 0.0), 4),
                "people_inside_obstacles": bool(self.penetration > float(self.scenario.forces.walking.radius)),
                **groups,
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
        tasks = list(dict.fromkeys(self.tasks))
        return title(self.scenario, tasks, self.episodes, len(set(self.floors)), self.robots)

    def print_table(self, console: Console) -> None:
        """Print the table."""
        table.print_table(console, self.summary(), self.definitions, self.title, self.concurrence()["none"][0])

    def table(self, width: int = 120) -> str:
        """The table as text."""
        stream = io.StringIO()
        self.print_table(Console(file=stream, width=width, color_system=None))
        return stream.getvalue()

    def concurrence(self) -> dict[str, tuple[float, float]]:
        """Situation -> the shares of robot time in it alone, and in it and others at once.

        "none" has the share of time in no situation, and "several" that of all time in two or more at once.
        """
        times = self.together / max(float(self.together.sum()), 1e-9)  # (2 ** S,)
        sets = np.arange(len(times))  # situation s is bit s
        sizes = np.array([index.bit_count() for index in range(len(times))])
        shares = {}
        for bit, name in enumerate(self.situations):
            inside = sets >> bit & 1 == 1
            alone = times[inside & (sizes == 1)]
            among_others = times[inside & (sizes > 1)]
            shares[name] = float(alone.sum()), float(among_others.sum())
        shares["none"] = float(times[0]), 0.0
        shares["several"] = 0.0, float(times[sizes > 1].sum())
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


def title(
    scenario: Scenario, tasks: list[str], episodes: int, floors: int = 0, robots_of_team: Sequence[str] = ()
) -> str:
    """A run in one line; ``floors`` is their number, 0 without a set."""
    robot = " + ".join(robots_of_team) or scenario.robot.name
    names = f"{scenario.environment.name} · {scenario.behavior.name} · {' / '.join(tasks)} · {robot}"
    if floors:
        return f"{names} · up to {scenario.people} people · {episodes} episodes on {floors} floors"
    return f"{names} · {scenario.people} people · {episodes} episodes"


def aggregate_episodes(results: Evaluation) -> dict[str, Any]:
    """Means with 95 % intervals over episodes, overall and by situation (Table I, Figure 4).

    Shares of episodes have Wilson's interval, counts without an event the exact one, and all else, with shares of time,
    that of the bootstrap over episodes. The robots of a team in one episode are drawn together.

    By situation, a time or a count is the mean per episode of its part in that situation. ``completed`` and metrics of
    completed episodes are means over the episodes in which the situation occurred. Without the metric
    ``time_in_situation`` these episodes are unknown, and such figures are None.

    Returns:
        ``{"situations": {situation: figure}, "metrics": {name: {column: figure}}}`` with the columns "overall" and the
        situations. A figure has a mean, an interval and its number of episodes; it is None without episodes.
    """
    # All figures have equal resamples, so that their intervals belong together; a team counts as one unit.
    columns = ("overall", *results.situations)
    cluster = len(results.robots) or 1
    weights = resamples(len(results.completed), cluster=cluster)  # (R, E)

    def estimate(values: np.ndarray, applies: np.ndarray, kind: str) -> dict[str, Any]:
        return _by_column(columns, values, applies, kind, weights, cluster)

    # Episodes (E, columns) that a column is about: in which its situation occurred.
    among = np.ones((len(results.completed), 1))
    shares = dict.fromkeys(results.situations)
    if (spent := results.metrics.get("time_in_situation")) is not None:  # (E, 1 + S) s
        ratios = [aggregate_ratio(spent[:, k], spent[:, 0], weights=weights) for k in range(1, spent.shape[1])]
        shares = dict(zip(results.situations, map(_figure, ratios), strict=True))
        among = np.concatenate([among, spent[:, 1:] > 0], 1).astype(float)

    # The share of completed episodes is by situation, as a policy may fail in one of them alone.
    completed = np.repeat(results.completed[:, None], among.shape[1], 1)  # (E, columns)
    figures = {"completed": estimate(completed.astype(float), among, "share")}
    for name, values in results.metrics.items():
        if name in ("completed", "timed_out"):
            continue

        # NaN marks an episode to which a metric does not apply; it counts neither above nor below in the mean.
        metric = results.definitions[name]
        cells = values.reshape(len(values), -1).astype(float)  # (E, 1) or (E, columns)
        applies = np.isfinite(cells).astype(float)

        # Such a figure by situation takes whole episodes: there is no part of it in a situation.
        if metric.completed_only:
            cells = np.repeat(cells, among.shape[1], 1) if cells.shape[1] == 1 else cells[:, : among.shape[1]]
            applies = np.isfinite(cells) * among * results.completed[:, None]
        figures[name] = estimate(np.where(np.isfinite(cells), cells, 0.0), applies, metric.kind)

    # The duration of an episode has no parts by situation besides time_in_situation.
    figures["seconds"] = estimate(results.seconds[:, None].astype(float), among[:, :1], "number")
    return {"situations": shares, "metrics": figures}


def _by_column(
    columns: Sequence[str], values: np.ndarray, applies: np.ndarray, kind: str, weights: np.ndarray, cluster: int
) -> dict[str, Any]:
    """Column -> the mean of values (E, columns) over the episodes to which they apply."""
    estimate = aggregate_ratio(values * applies, applies, weights=weights)
    if kind == "share":  # of episodes, where each is 0 or 1; else of time
        is_share = np.all((values == 0) | (values == 1) | (applies == 0), 0)
        estimate = of_share(estimate, where=is_share, cluster=cluster)
    elif kind == "count":
        estimate = of_count(estimate, cluster=cluster)
    names = columns[: values.shape[1]]
    return {name: _figure(Estimate(*(field[k] for field in estimate))) for k, name in enumerate(names)}


def _figure(estimate: Estimate) -> dict[str, Any] | None:
    """An estimate of shape () as summary.json has it; None if it has no episode."""
    if not estimate.episodes:
        return None
    interval = [float(estimate.low), float(estimate.high)]
    return {"mean": float(estimate.mean), "interval": interval, "episodes": int(estimate.episodes)}


# ------------------------------------------------------------------ files


def write_all(folder: Path, evaluation: Evaluation, plan: RunPlan | None = None, content: str = "") -> None:
    """Write all files of an evaluation to an empty folder.

    ``plan`` is of ``sean run``, and ``content`` the fingerprint of its scenario and policy; an evaluation in Python,
    which no file repeats, has none.
    """
    packages = versions()
    about = {"scenario": evaluation.names(), "people": evaluation.scenario.people, "versions": packages}
    run_plan.write_config(folder, about, plan, content)
    write_episodes(folder / "episodes.csv", evaluation)
    summary = evaluation.summary()
    (folder / "summary.json").write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if evaluation.frames:
        _animate(folder, evaluation, None if plan is None else plan.config.camera)

    in_python = "sean_jax.evaluate, in a Python program"
    command = in_python if plan is None else plan.command()
    complete = in_python if plan is None else plan.command(complete=True)
    runs = [plan.baseline, compare.read_run(folder)] if plan is not None and plan.baseline is not None else []
    text = report_page(evaluation, summary, _recording(evaluation), command, packages, complete, runs)
    (folder / "report.html").write_text(text, encoding="utf-8")


def _animate(folder: Path, evaluation: Evaluation, camera: str | None) -> None:
    """Write animations of the first episode: from above, and as a camera sees it."""
    scenario = evaluation.place(0)
    frames = evaluation.frames[0]
    drawing.animate(
        scenario.environment,
        frames,
        folder / "episode.gif",
        graph=drawing.graph_of(scenario),
        situations=evaluation.situations,
        time_step=scenario.time_step,
        robot_radius=robots.radii(scenario),
        title=evaluation.tasks[0].replace("_", " "),
    )
    if camera is not None:
        drawing.video(frames, scenario, folder / "camera.gif", view=camera)


def _recording(evaluation: Evaluation) -> dict[str, Any] | None:
    """The first episodes for the player of the report; None if there are none."""
    shown = []
    for i, frames in enumerate(evaluation.frames):
        if evaluation.floors and evaluation.floors[i] != evaluation.floors[0]:
            continue  # the player has one floor
        if evaluation.robots and i % len(evaluation.robots):
            continue  # the frames of the first robot have the others, too
        name = f"{_label(evaluation, i)} · {evaluation.tasks[i].replace('_', ' ')}"
        shown.append(replay.ReplayEpisode(frames, name, outcome(evaluation.completed[i], evaluation.seconds[i])))
    return replay.of_scenario(evaluation.place(0), shown) if shown else None


def _label(evaluation: Evaluation, row: int) -> str:
    """The episode of a row, and its robot in a team."""
    names = evaluation.robots
    return f"episode {row // len(names)} {names[row % len(names)]}" if names else f"episode {row}"


def outcome(completed: Any, seconds: float) -> str:
    """The end of an episode of a duration in seconds, in words."""
    return f"{'completed' if completed else 'not completed'} in {seconds:.1f} s"


def write_episodes(path: Path, evaluation: Evaluation) -> None:
    """Write episodes.csv: a row for each episode, with metrics overall and as ``metric__situation``.

    Equal results give equal bytes. A value that is not finite is an empty cell. With several floors, ``environment`` is
    the floor of an episode. A team has a row for each robot, named in the column ``robot``.
    """
    robots_of_team = len(evaluation.robots) or 1
    columns: dict[str, Iterable[Any]] = {"episode": (row // robots_of_team for row in range(len(evaluation.tasks)))}
    if evaluation.robots:
        columns["robot"] = itertools.cycle(evaluation.robots)
    if evaluation.floors:
        columns["environment"] = evaluation.floors
    columns["task"] = evaluation.tasks
    columns["completed"] = evaluation.completed.astype(bool)
    columns["timed_out"] = evaluation.timed_out.astype(bool)
    columns["seconds"] = map("{:.3f}".format, evaluation.seconds)
    for name, values in evaluation.metrics.items():
        if name not in ("completed", "timed_out"):
            values = values.astype(np.int64) if evaluation.definitions[name].kind == "count" else values
            names = [name, *(f"{name}__{situation}" for situation in evaluation.situations)]
            columns |= {
                column: map(_cell, cells) for column, cells in zip(names, np.atleast_2d(values.T), strict=False)
            }

    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=False))


def _cell(value: Any) -> str:
    if isinstance(value, np.integer | np.bool_):
        return str(int(value))
    return f"{value:.6f}" if np.isfinite(value) else ""


# ------------------------------------------------------------------ the report

TILES = "completed", "seconds", "path_efficiency", "time_not_moving", "personal_robot_on_person"
EPISODE = "episodes"  # topic of the rows that no metric measures
OPEN = (EPISODE, "distances and collisions")  # topics that the table shows unless folded


def report_page(
    evaluation: Evaluation,
    summary: dict[str, Any],
    recording: dict[str, Any] | None,
    command: str,
    packages: dict[str, str],
    complete: str = "",
    runs: Sequence[SavedRun] = (),
) -> str:
    """The report: one self-contained HTML page for light and dark screens and for paper.

    It holds the figures of Table I and Fig. 4 for this run, the pictures of Fig. 1, and the command that makes them
    again. It shows the scenario's situations and metrics, the user's own included.

    Args:
        summary: of ``Evaluation.summary``.
        recording: the first episodes, of ``replay.of_scenario``.
        complete: the command with every option.
        runs: the baseline and this run, or none.
    """
    against = compare.differences(runs)[compare.OVERALL][0] if runs else []
    rows = table.table_rows(summary, evaluation.definitions, complete=True)
    by_name = {row.name: row for row in rows}
    topics = dict[str, list[table.MeasureRow]]()
    for row in rows:
        topic = EPISODE if row.name in table.EPISODE_FIGURES else metrics.topic(row.name)
        topics.setdefault(topic, []).append(row)
    shades = dict(zip(evaluation.situations, situation_colors(evaluation.situations), strict=True))
    return pages.render(
        "evaluation/run.html",
        title=evaluation.title,
        kicker="sean_jax · report of a run",
        situations=evaluation.situations,
        bars=_bars(evaluation, by_name["share"].cells[1:]),
        command=command,
        complete=complete,
        versions=packages,
        against={row.name: row for row in against},
        against_note=_against(runs),
        baseline=runs[0].name if runs else "",
        symbols=compare.SYMBOLS,
        number=evaluation.episodes,
        fewest=f"{float(of_count(Estimate(*map(np.array, (0.0, 0.0, 0.0, evaluation.episodes)))).high):.2g}",
        player="" if recording is None else replay.element(recording),
        tiles=[by_name[name] for name in TILES if name in by_name],
        shades=shades | {"none": NO_SITUATION},
        topics=topics,
        open_topics=OPEN,
        episodes=_episodes(evaluation),
        people=_people(evaluation),
        durations=_durations(evaluation),
        checks=_checks(summary),
        definitions={row.title + (f" [{row.unit}]" if row.unit else ""): row.definition for row in rows},
    )


def _against(runs: Sequence[SavedRun]) -> str:
    """The comparison with the baseline in words; "" without one."""
    if not runs:
        return ""
    number = compare.paired(*runs)
    how = f"in {number} common episodes" if number else "by their means, for the episodes differ"
    return (
        f"The run is compared with {runs[0].name} {how}. Marks follow Holm's correction for all figures, which "
        f"sean compare shows: the probability of any false mark is 5 % at most."
    )


class Bar(NamedTuple):
    """A bar of the situations; lengths are parts of the longest bar."""

    name: str
    text: str
    color: str
    alone: float
    shared: float  # in other situations at the same time


def _bars(evaluation: Evaluation, cells: list[str]) -> list[Bar]:
    """A bar for each situation, as long as its share of robot time, with the text of its cell in the table."""
    shares = evaluation.concurrence()
    longest = max(map(sum, shares.values())) or 1.0
    colors = *situation_colors(evaluation.situations), NO_SITUATION, NO_SITUATION
    texts = dict(zip(evaluation.situations, cells, strict=True))
    return [
        Bar(name, texts.get(name) or f"{100 * (alone + shared):.1f}", color, alone / longest, shared / longest)
        for (name, (alone, shared)), color in zip(shares.items(), colors, strict=True)
    ]


def _episodes(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Pictures of the first episodes, and their captions."""
    pictures = []
    for i, frames in enumerate(evaluation.frames):
        scenario = evaluation.place(i)
        figure = drawing.top_down(
            scenario.environment,
            graph=drawing.graph_of(scenario),
            frames=frames,
            situations=evaluation.situations,
            time_step=scenario.time_step,
            robot_radius=robots.radii(scenario),
        )
        words = [_label(evaluation, i).capitalize(), *evaluation.floors[i : i + 1], evaluation.tasks[i]]
        words = [word.replace("_", " ") for word in words] + [outcome(evaluation.completed[i], evaluation.seconds[i])]
        pictures.append((svg(figure, f"episode-{i}"), " · ".join(words)))
    return pictures


def _people(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Where people were, and the behavior graph, with captions; nothing of several floors."""
    if evaluation.floors:
        return []
    environment = evaluation.scenario.environment
    graph = drawing.graph_of(evaluation.scenario)
    seconds = max(float(evaluation.seconds.sum()), 1e-9)
    x0, y0, x1, y1 = (float(v) for v in np.asarray(environment.floor))
    density = evaluation.heat * evaluation.heat.size / ((x1 - x0) * (y1 - y0) * seconds)
    crowds = drawing.congestion_map(environment, density, graph=graph, flow=evaluation.walks * (60.0 / seconds))
    caption = "Where people were, mean over all episodes"
    if graph is None:
        return [(svg(crowds, "congestion"), caption)]
    caption += "; bands are as wide as the flow each way along an edge"
    picture = svg(drawing.top_down(environment, graph=graph), "behavior-graph")
    name = environment.name.replace("_", " ")
    return [(svg(crowds, "congestion"), caption), (picture, f"Behavior graph of the {name}")]


def _checks(summary: dict[str, Any]) -> dict[str, str]:
    checks = summary["checks"]
    timing = summary["timing"]
    groups = checks.get("largest_groups")
    facts = {}
    if groups is not None:
        facts["most people in each group"] = ", ".join(map(str, groups)) or "there are no groups"
    return {
        "deepest penetration of a person into an obstacle": f"{checks['largest_penetration_mm']:.3f} mm",
        **facts,
        "numbers that are not finite": str(checks["not_finite"]),
        "simulated": f"{summary['simulated_seconds']:,.0f} s of robot time, "
        f"{timing['simulated_seconds_per_second']:,.0f} s per second on {timing['device']}",
        "time taken": f"{timing['compile_seconds']:.1f} s to compile, {timing['run_seconds']:.1f} s to run",
    }


def _durations(evaluation: Evaluation) -> str:
    """Histogram of the episodes' durations as SVG, up to the time limit; completed ones stand below."""
    time_limit = evaluation.scenario.time_limit
    seconds = np.minimum(evaluation.seconds, time_limit)
    edges = np.linspace(0.0, time_limit, 25)
    completed, _ = np.histogram(seconds[evaluation.completed], edges)
    late, _ = np.histogram(seconds[~evaluation.completed], edges)

    # Bars of a picture whose axes meet at (left, base), in pixels.
    highest = max(1, int((completed + late).max()))
    left = 36.0
    base = 160.0
    width = 668.0 / len(completed)
    scale = 140.0 / highest
    bars = []
    for k, (lower, upper) in enumerate(zip(scale * completed, scale * late, strict=True)):
        x = left + k * width + 1.0
        if lower:
            bars.append(("done", x, base - lower, width - 2.0, lower))
        if upper:
            bars.append(("late", x, base - lower - upper, width - 2.0, upper))
    ticks = [(left + k * width, f"{edges[k]:.3g}") for k in range(0, len(edges), 4)]
    return pages.render("evaluation/durations.html", bars=bars, ticks=ticks, highest=highest)

"""The report of a run: one self-contained HTML page for light and dark screens and for paper.

It holds the figures of Table I and Fig. 4 for this run, the pictures of Fig. 1, and the command that makes them again.
Situations and metrics are those of the scenario, the user's own included.
"""

import dataclasses
import html as markup
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax import drawing, files, metrics, replay
from sean_jax.base import Environment, Trajectory
from sean_jax.drawing import colors
from sean_jax.report import figures

if TYPE_CHECKING:
    from sean_jax.graph.behavior_graph import BehaviorGraph

STYLE = Path(__file__).with_name("style.css")
OF_EPISODES = ("share", "completed", "seconds")  # rows that no metric measures
EPISODE = "episodes"  # what those are about
OPEN = (EPISODE, "distances and collisions")  # topics that the table shows unless folded


@dataclasses.dataclass
class Report:
    """The content of the page; E episodes, S situations, M nodes of the graph."""

    title: str
    command: str
    versions: dict[str, str]
    environment: Environment
    graph: "BehaviorGraph | None"
    situations: tuple[str, ...]
    rows: list[dict[str, Any]]  # name, title, unit, definition, cells (1 + S) and intervals (1 + S) as text
    shares: dict[str, float]  # situation or "none" -> share of robot time, adding up to one
    heat: np.ndarray  # (rows, columns) s
    walks: np.ndarray  # (M, M) people who walked each edge of the graph
    tasks: list[str]  # (E,)
    completed: np.ndarray  # (E,) bool
    seconds: np.ndarray  # (E,) s
    frames: list[Trajectory]  # of the first episodes
    replay: dict[str, Any] | None  # the same as ``replay.recording`` has them
    time_step: float  # s
    robot_radius: float  # m
    time_limit: float  # s
    checks: dict[str, Any]
    timing: dict[str, Any]


def html(report: Report) -> str:
    """The page as text."""
    sections = [
        *([] if report.replay is None else [replay.element(report.replay)]),
        _tiles(report),
        _section("Situations", _situations(report)),
        _section("Results", _table(report)),
        _section("Episodes", _episodes(report)),
        _section("People and time", _people_and_time(report)),
        _section("Checks", _facts(_checks(report))),
        _section("How to get this again", _again(report)),
        _section("What the numbers mean", _definitions(report)),
    ]
    style = "" if report.replay is None else replay.style() + ".replay{margin:16px 0}"
    return page(report.title, "sean_jax · report of a run", sections, style)


def page(title: str, kicker: str, sections: Iterable[str], style: str = "") -> str:
    """A page of the package's looks, whole in one file."""
    body, title = "\n".join(sections), markup.escape(title)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{title}</title>'
        f"<style>\n{files.read_text(STYLE)}{style}</style></head>\n<body><main><header>"
        f"<p class=kicker>{kicker}</p><h1>{title}</h1></header>\n{body}\n</main></body></html>\n"
    )


def _section(title: str, body: str) -> str:
    return f"<section><h2>{title}</h2>\n{body}</section>"


def _words(name: str) -> str:
    return markup.escape(name.replace("_", " "))


def _unit(row: dict[str, Any]) -> str:
    """The unit of a row in small print, or nothing."""
    return f" <small>{markup.escape(row['unit'])}</small>" if row["unit"] else ""


def _dot(color: str) -> str:
    return f'<i class=dot style="background:{color}"></i>'


def _tiles(report: Report) -> str:
    by_name = {row["name"]: row for row in report.rows}
    tiles = []
    for name in ("completed", "seconds", "path_efficiency", "time_not_moving", "personal_robot_on_person"):
        if row := by_name.get(name):
            interval = f"<p>{row['intervals'][0]}</p>" if row["intervals"][0] else "<p>&nbsp;</p>"
            title, cell = markup.escape(row["title"]), row["cells"][0] or "–"
            tiles.append(f"<div><h3>{title}</h3><b>{cell}{_unit(row)}</b>{interval}</div>")
    return f"<div class=tiles>{''.join(tiles)}</div>"


def _situations(report: Report) -> str:
    shades = dict(zip(report.situations, colors.situation_colors(report.situations), strict=True))
    shades["none"] = colors.NO_SITUATION
    positive = {name: share for name, share in report.shares.items() if share > 0}
    parts = "".join(
        f'<i style="width:{100 * share:.3f}%;background:{shades[name]}" title="{_words(name)} {100 * share:.1f} %"></i>'
        for name, share in positive.items()
    )
    names = {"none": "no situation"}
    legend = "".join(
        f"<li>{_dot(shades[name])}{_words(names.get(name, name))} <b>{100 * share:.1f} %</b></li>"
        for name, share in report.shares.items()
        if share > 0 or name != "none"
    )
    return (
        f"<div class=bar>{parts}</div><ul class=legend>{legend}</ul>"
        "<p class=note>Share of the robot's time; a moment in several situations is divided equally among them here, "
        "and counts fully for each of them in the table.</p>"
    )


def _table(report: Report) -> str:
    shades = colors.situation_colors(report.situations)
    head = "".join(
        f"<th>{_dot(color)}{_words(name)}</th>" for name, color in zip(report.situations, shades, strict=True)
    )
    by_topic: dict[str, list[str]] = {}
    for row in report.rows:
        cells = "".join(
            f"<td>{cell}<small>{interval}</small></td>" if cell else "<td class=none>–</td>"
            for cell, interval in zip(row["cells"], row["intervals"], strict=True)
        )
        about = EPISODE if row["name"] in OF_EPISODES else metrics.topic(row["name"])
        by_topic.setdefault(about, []).append(f"<tr><th>{_words(row['title'])}{_unit(row)}</th>{cells}</tr>")
    head = f"<thead><tr><th></th><th>overall</th>{head}</tr></thead>"
    tables = "".join(
        f"<details{' open' if about in OPEN else ''}><summary>{about} <small>{len(rows)}</small></summary>"
        f"<div class=wide><table>{head}<tbody>{''.join(rows)}</tbody></table></div></details>"
        for about, rows in by_topic.items()
    )
    return (
        f"<div class=topics>{tables}</div>"
        "<p class=note>Small print: 95 % bootstrap intervals over episodes. Violations and collisions are times "
        "per episode. A dash stands for a situation that did not occur, or a metric that is not split by situation.</p>"
    )


def _episodes(report: Report) -> str:
    pictures = []
    for i, frames in enumerate(report.frames):
        figure = drawing.top_down(
            report.environment,
            graph=report.graph,
            frames=frames,
            situations=report.situations,
            time_step=report.time_step,
            robot_radius=report.robot_radius,
        )
        outcome = "completed" if report.completed[i] else "not completed"
        caption = f"Episode {i} · {_words(report.tasks[i])} · {outcome} in {report.seconds[i]:.1f} s"
        pictures.append(f"<figure>{figures.svg(figure, f'episode-{i}')}<figcaption>{caption}</figcaption></figure>")
    note = (
        "<p class=note>The first episodes from above: the robot's path in the colours of the situations, people where "
        "they stood at the end, with their trails over the last 40 s.</p>"
    )
    return f"<div class=grid>{''.join(pictures)}</div>{note}"


def _people_and_time(report: Report) -> str:
    seconds = max(float(report.seconds.sum()), 1e-9)
    x0, y0, x1, y1 = (float(v) for v in np.asarray(report.environment.floor))
    density = report.heat * report.heat.size / ((x1 - x0) * (y1 - y0) * seconds)
    flow = report.walks * (60.0 / seconds)
    crowds = drawing.congestion_map(report.environment, density, graph=report.graph, flow=flow)
    caption = "Where people were, mean over all episodes"
    if report.graph is not None:
        caption += "; bands are as wide as the flow each way along an edge"
    pictures = [f"<figure>{figures.svg(crowds, 'congestion')}<figcaption>{caption}</figcaption></figure>"]
    if report.graph is not None:
        graph = figures.svg(drawing.top_down(report.environment, graph=report.graph), "behavior-graph")
        pictures.append(
            f"<figure>{graph}<figcaption>Behavior graph of the {_words(report.environment.name)}</figcaption></figure>"
        )
    chart = figures.durations(report.completed, report.seconds, report.time_limit)
    bars = f"<figure>{chart}<figcaption>How long the episodes lasted</figcaption></figure>"
    return f"<div class=grid>{''.join(pictures)}</div><div class=alone>{bars}</div>"


def _checks(report: Report) -> dict[str, str]:
    return {
        "deepest penetration of a person into an obstacle": f"{report.checks['largest_penetration_mm']:.3f} mm",
        "most people seen in each group": ", ".join(map(str, report.checks["largest_groups"])) or "there are no groups",
        "numbers that are not finite": str(report.checks["not_finite"]),
        "simulated": f"{float(report.seconds.sum()):,.0f} s of robot time, "
        f"{report.timing['simulated_seconds_per_second']:,.0f} s per second on {report.timing['device']}",
        "time taken": f"{report.timing['compile_seconds']:.1f} s to compile, "
        f"{report.timing['run_seconds']:.1f} s to run",
    }


def _facts(facts: dict[str, str]) -> str:
    return (
        "<dl>" + "".join(f"<dt>{markup.escape(k)}</dt><dd>{markup.escape(v)}</dd>" for k, v in facts.items()) + "</dl>"
    )


def _again(report: Report) -> str:
    words = (f"<span>{markup.escape(word)}</span>" for word in re.split(r" (?=--)", report.command))
    return f"<pre>{' '.join(words)}</pre>{_facts(report.versions)}"


def _definitions(report: Report) -> str:
    units = {row["name"]: f" [{row['unit']}]" if row["unit"] else "" for row in report.rows}
    return _facts({row["title"] + units[row["name"]]: row["definition"] for row in report.rows})

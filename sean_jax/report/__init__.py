"""The report of a run: one self-contained HTML page for light and dark screens and for paper.

It holds the figures of Table I and Fig. 4 for this run, the pictures of Fig. 1, and the command that makes them again.
It shows the scenario's situations and metrics, the user's own included.
"""

import dataclasses
import html as markup
import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax import drawing, metrics, pages, replay
from sean_jax.base import Environment, Trajectory
from sean_jax.drawing import colors

if TYPE_CHECKING:
    from sean_jax.graph.behavior_graph import BehaviorGraph

TILES = "completed", "seconds", "path_efficiency", "time_not_moving", "personal_robot_on_person"
OF_EPISODES = ("share", "completed", "seconds")  # rows that no metric measures
EPISODE = "episodes"  # their topic
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
    by_name = {row["name"]: row for row in report.rows}
    topics: dict[str, list[dict[str, Any]]] = {}
    for row in report.rows:
        topic = EPISODE if row["name"] in OF_EPISODES else metrics.topic(row["name"])
        topics.setdefault(topic, []).append(row)
    units = {row["name"]: f" [{row['unit']}]" if row["unit"] else "" for row in report.rows}
    shades = dict(zip(report.situations, colors.situation_colors(report.situations), strict=True))
    return pages.render(
        "report/run.html",
        title=report.title,
        kicker="sean_jax · report of a run",
        report=report,
        player="" if report.replay is None else replay.element(report.replay),
        tiles=[by_name[name] for name in TILES if name in by_name],
        shades=shades | {"none": colors.NO_SITUATION},
        topics=topics,
        open_topics=OPEN,
        episodes=_episodes(report),
        people=_people(report),
        durations=_durations(report.completed, report.seconds, report.time_limit),
        checks=_checks(report),
        definitions={row["title"] + units[row["name"]]: row["definition"] for row in report.rows},
    )


def _episodes(report: Report) -> list[tuple[str, str]]:
    """Pictures of the first episodes, and their captions."""
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
        task, outcome = report.tasks[i].replace("_", " "), "completed" if report.completed[i] else "not completed"
        caption = f"Episode {i} · {task} · {outcome} in {report.seconds[i]:.1f} s"
        pictures.append((svg(figure, f"episode-{i}"), caption))
    return pictures


def _people(report: Report) -> list[tuple[str, str]]:
    """Where people were, and the behavior graph, with captions."""
    seconds = max(float(report.seconds.sum()), 1e-9)
    x0, y0, x1, y1 = (float(v) for v in np.asarray(report.environment.floor))
    density = report.heat * report.heat.size / ((x1 - x0) * (y1 - y0) * seconds)
    flow = report.walks * (60.0 / seconds)
    crowds = drawing.congestion_map(report.environment, density, graph=report.graph, flow=flow)
    caption = "Where people were, mean over all episodes"
    if report.graph is None:
        return [(svg(crowds, "congestion"), caption)]
    caption += "; bands are as wide as the flow each way along an edge"
    graph = svg(drawing.top_down(report.environment, graph=report.graph), "behavior-graph")
    name = report.environment.name.replace("_", " ")
    return [(svg(crowds, "congestion"), caption), (graph, f"Behavior graph of the {name}")]


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


def svg(figure: Any, name: str) -> str:
    """A figure as inline SVG in the colors of the page, light or dark; its name makes ids unique."""
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(stream, format="svg", dpi=170, metadata={"Date": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'<svg([^>]*?) width="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'<svg([^>]*?) height="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'(id="|url\(#|href="#)', rf"\g<1>{name}-", text)
    for shade, variable in (
        (colors.PAPER, "paper"),
        (colors.FLOOR, "floor"),
        (colors.INK, "ink"),
        (colors.MUTED, "muted"),
        (colors.TRAIL, "trail"),
        (colors.FAINT_EDGE, "faint"),
        (colors.OBSTACLE, "obstacle"),
    ):
        text = text.replace(shade, f"var(--{variable})")
    return text.replace("<svg", f'<svg role="img" aria-label="{markup.escape(name)}"', 1)


def _durations(completed: np.ndarray, seconds: np.ndarray, time_limit: float) -> str:
    """Histogram of the episodes' durations (E,) s as SVG, up to the time limit; completed ones stand below."""
    edges = np.linspace(0.0, time_limit, 25)
    done, late = (np.histogram(np.minimum(seconds[mask], time_limit), edges)[0] for mask in (completed, ~completed))
    highest = max(1, int((done + late).max()))
    left, base, step, scale = 36.0, 160.0, 668.0 / len(done), 140.0 / highest
    bars = []
    for k, (lower, upper) in enumerate(zip(scale * done, scale * late, strict=True)):
        for kind, top, height in (("done", base - lower, lower), ("late", base - lower - upper, upper)):
            if height:
                bars.append((kind, left + k * step + 1.0, top, step - 2.0, height))
    ticks = [(left + k * step, f"{edges[k]:g}") for k in range(0, len(edges), 4)]
    return pages.render("report/durations.html", bars=bars, ticks=ticks, highest=highest)

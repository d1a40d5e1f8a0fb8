"""The inverse Behavior Graph (section IV-D): from what people do, to the graph that makes them do it.

``sean fit-graph`` proposes a graph for an environment (``graph_proposal``), measures what recorded or simulated people
do on it (``measuring``), finds the weights, stays and speeds with which a model of flows has people do the same
(``fitting``), and checks them on other people.
"""

import csv
import functools
import io
import json
import operator
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import matplotlib
import numpy as np

from sean_jax.config import FitGraphConfig, GraphBehavior, Named, ScenarioConfig
from sean_jax.config.flags import command
from sean_jax.core import random_streams
from sean_jax.core.data_types import Environment, Scenario
from sean_jax.core.errors import InputError
from sean_jax.drawing import colors, layers
from sean_jax.graph import BehaviorGraph, annotation, graph_of
from sean_jax.io import files, writing
from sean_jax.io.files.mjcf import MAX_TEXT
from sean_jax.io.progress import Progress, progress
from sean_jax.io.versions import versions
from sean_jax.people.recordings import read
from sean_jax.simulation import making
from sean_jax.studies.inverse_graph.fitting import (
    FlowWeights,
    GraphFit,
    annotate,
    expected_flows,
    fit_flows,
    flow_error,
    layout,
    weights_of,
)
from sean_jax.studies.inverse_graph.measuring import Calls, FlowMeasure, measure_flows, people_alone, people_called
from sean_jax.world import environment as environments
from sean_jax.world.generated.graph_proposal import propose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

__all__ = [
    "Calls",
    "FlowMeasure",
    "FlowWeights",
    "GraphFit",
    "expected_flows",
    "fit_flows",
    "flow_error",
    "layout",
    "measure_flows",
    "people_alone",
    "people_called",
    "propose",
    "run",
    "weights_of",
]

GRAPH = "graph.yaml"
EPISODE = 300.0  # s, of a simulated episode
EVERY = 2  # control steps from one row of a simulation to the next
ROW = 0.1  # s, between rows of a recording
HELD_OUT = "held out"
FEWEST = 20  # walks along edges, from which anything is fitted
ROUNDS = 2  # of simulating how a fitted graph calls people to its groups, and fitting it again
SEEN, OTHERS, ANEW, CALLED = range(4)  # each simulation has its own chance; of the rounds each, from CALLED on
WIDEST = 7.0  # points, of the arrow of the greatest flow


def run(options: FitGraphConfig, console: "Console") -> list[str]:
    """Propose a graph, or fit one to people, and write it as an environment.

    The folder holds graph.yaml and the environment's own files, so that ``sean run --environment`` takes it, and, if
    there were people, flows.png, flows.csv and fit.json.

    Raises:
        InputError: there is no such environment, or hardly anybody walks along the graph's edges.
        FileError: a file cannot be used.
        WriteError: the folder cannot be written.
    """
    source = environments.find(options.environment)
    environment = environments.load(source)
    with progress(console) as bar, writing.atomic_folder(options.folder) as folder:
        words = _words(options, source, environment, bar)
        for name in (environments.SETTINGS, environments.SCENE):
            writing.write(folder / name, files.read_bytes(source / name, MAX_TEXT))
        graph = annotation.build_graph(words, environment)
        lines = [f"{len(words.nodes)} nodes, {len(words.edges)} edges"]
        if options.recording is None and not options.simulate:
            writing.write(folder / GRAPH, annotation.to_yaml(words))
            return lines
        return lines + _fit_people(options, folder, environment, words, graph, bar)


def _fit_people(
    options: FitGraphConfig,
    folder: Path,
    environment: Environment,
    words: annotation.Annotation,
    graph: BehaviorGraph,
    bar: Progress,
) -> list[str]:
    """Fit a graph to people, check it on others, and write graph.yaml, flows.png, flows.csv and fit.json."""
    # In a simulation people walk from goal to goal for ever; in a recording they enter and leave.
    closed = options.recording is None
    measured, held_out = _simulated(options, bar) if closed else _recorded(options, graph, bar)

    # Weights fitted to a handful of walks would only repeat these walks.
    walks = float(measured.edges.sum())
    if walks < FEWEST:
        raise InputError(
            f"{options.recording or options.environment}: people walk {walks:.0f} times along edges of the graph, "
            f"and {FEWEST} are the fewest to fit it to; look at --graph and at the units."
        )
    people = f"recording {options.recording.name}" if options.recording else "people simulated on its own graph"

    # The graph is written at once, because the simulations of further rounds read it from the folder.
    def fit(calls: Calls | None = None) -> GraphFit:
        fitted = fit_flows(graph, measured, closed, options.temperature, calls, progress=bar)
        annotated = annotate(words, fitted, closed, f"fitted by sean fit-graph to {people}")
        writing.write(folder / GRAPH, annotation.to_yaml(annotated))
        return fitted

    # How a graph calls people to its groups is known only when it is simulated.
    fitted = fit()
    for attempt in range(ROUNDS if closed and graph.groups.shape[0] else 0):
        title = "simulating how groups call people"
        _, calls = _episodes(_scenario(options, folder), options, CALLED + attempt, bar, title)
        fitted = fit(calls)

    # The flow model has no unit of time, so that its flows are drawn with the sum of those held out.
    flow = np.asarray(fitted.flows.edges, float)
    scale = held_out.flow.sum() / max(flow.sum(), 1e-30)
    panels = {HELD_OUT: held_out.flow, "fitted to": measured.flow, "flow model": flow * scale}
    if closed:
        anew, _ = _episodes(_scenario(options, folder), options, ANEW, bar, "simulating the fit")
        panels["simulated anew"] = anew.flow

    # The people fitted to differ from those held out by chance alone: no fit is expected to come below that.
    errors = {name: flow_error(flow, panels[HELD_OUT]) for name, flow in panels.items() if name != HELD_OUT}

    # The figure and the numbers of one fit have the same panels.
    with writing.atomic_file(folder / "flows.png") as stream:
        picture(environment, graph, panels, f"{environment.name}: {people}").savefig(stream, dpi=130, format="png")
    writing.write(folder / "flows.csv", _table(graph, panels))
    writing.write(folder / "fit.json", json.dumps(_summary(options, graph, fitted, errors), indent=2) + "\n")
    lines = [f"{name}, against people held out: flows differ by {100 * e:.1f} %" for name, e in errors.items()]
    return lines + _report(graph, fitted)


def _words(options: FitGraphConfig, source: Path, environment: Environment, bar: Progress) -> annotation.Annotation:
    """The annotation whose nodes and edges are taken."""
    file = options.graph or source / GRAPH
    people = options.recording is not None or options.simulate
    if options.graph is not None or (people and not options.propose and file.is_file()):
        return files.load(
            file, annotation.Annotation, annotation.check, lambda graph: annotation.check_against(graph, environment)
        )
    bar.stage("proposing a graph")
    ends = None
    if options.recording is not None:
        tracks = read(options.recording, options.recording_format, options.frame_rate, ROW)
        position, present = np.asarray(tracks.position), np.asarray(tracks.present)
        begins = present & ~np.pad(present, ((1, 0), (0, 0)))[:-1]
        stops = present & ~np.pad(present, ((0, 1), (0, 0)))[1:]
        ends = np.concatenate([position[begins], position[stops]])
    return propose(environment, ends)


def _recorded(options: FitGraphConfig, graph: BehaviorGraph, bar: Progress) -> list[FlowMeasure]:
    """The even and the odd people of a recording."""
    bar.stage("reading the recording")
    tracks = read(options.recording or "", options.recording_format, options.frame_rate, ROW)
    position, present, person = (np.asarray(part) for part in (tracks.position, tracks.present, tracks.person))
    _, order = np.unique(person, return_inverse=True)
    even = order.reshape(person.shape) % 2 == 0
    return [measure_flows(graph, position, present & part, ROW) for part in (even, ~even)]


def _simulated(options: FitGraphConfig, bar: Progress) -> list[FlowMeasure]:
    """Episodes on the environment's own graph, and as many others."""
    scenario = _scenario(options, environments.find(options.environment))
    titles = {SEEN: "simulating people", OTHERS: "simulating people to check it by"}
    return [_episodes(scenario, options, part, bar, title)[0] for part, title in titles.items()]


def _scenario(options: FitGraphConfig, folder: Path) -> Scenario:
    described = ScenarioConfig(
        environment=str(folder),
        behavior=GraphBehavior(routing=options.routing),
        task=(Named(kind="random_ab_nav"),),
        people=options.people,
        time_step=ROW,
    )
    return making.scenarios(described)[0]


def _episodes(
    scenario: Scenario, options: FitGraphConfig, part: int, bar: Progress, words: str
) -> tuple[FlowMeasure, Calls]:
    """What people do in the episodes of one part, and how they are called to groups."""
    graph = graph_of(scenario)
    assert graph is not None  # it is of the behavior "graph"
    number = max(1, round(options.minutes * 60.0 / EPISODE))
    steps = round(min(EPISODE, options.minutes * 60.0) / scenario.time_step)
    simulate: Callable = jax.jit(lambda key: people_called(scenario, graph, key, steps, EVERY))
    key = jax.random.fold_in(random_streams.key("fit-graph", options.seed), part)
    measures: list[tuple[FlowMeasure, Calls]] = []
    bar.start(words, number)
    for episode in range(number):
        position, present, calls = simulate(jax.random.fold_in(key, episode))
        flows = measure_flows(graph, np.asarray(position), np.asarray(present), scenario.time_step * EVERY)
        measures.append((flows, calls))
        bar.update(episode + 1)
    flows, calls = (functools.reduce(operator.add, parts) for parts in zip(*measures, strict=True))
    return flows, calls


def _summary(options: FitGraphConfig, graph: BehaviorGraph, fit: GraphFit, errors: dict[str, float]) -> dict:
    def plain(value: float) -> float | None:
        return round(float(value), 5) if np.isfinite(value) else None

    groups = {
        graph.names[node]: {"stay": [plain(value) for value in fit.stay[k]], "capacity": int(fit.capacity[k])}
        for k, node in enumerate(np.asarray(graph.groups))
    }
    return {
        "command": command("fit-graph", options),
        "flow_error": {name: plain(error) for name, error in errors.items()},
        "preferred_speed": {"mean": plain(fit.speed[0]), "deviation": plain(fit.speed[1])},
        "groups": groups,
        "loss": [plain(value) for value in fit.loss[:: max(1, len(fit.loss) // 50)]],
        "versions": versions(),
    }


# ------------------------------------------------------------------ pictures and tables


def picture(
    environment: Environment, graph: BehaviorGraph, panels: dict[str, np.ndarray], title: str, width: float = 5.0
) -> "Figure":
    """Draw flows as arrows along the edges, a panel for each measure, and compare the others with the first one.

    Args:
        panels: title -> (M, M) people per minute.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    x0, y0, x1, y1 = (float(v) for v in np.asarray(environment.floor))
    tall = float(np.clip(width * (y1 - y0) / (x1 - x0), 1.6, 2 * width))
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": colors.MUTED}):
        figure = Figure(figsize=(width * (len(panels) + 1), tall + 0.6), layout="constrained", facecolor=colors.PAPER)
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(panels) + 1)
    figure.suptitle(title, fontsize=10, color=colors.INK)
    greatest = max(float(flow.max(initial=0.0)) for flow in panels.values())
    for own, (name, flow) in zip(axes, panels.items(), strict=False):
        own.set_title(name, loc="left", color=colors.INK)
        own.set_xlim(x0, x1)
        own.set_ylim(y0, y1)
        own.set_aspect("equal")
        own.set_axis_off()
        own.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, color=colors.FLOOR, zorder=0))
        layers.draw_obstacles(own, environment)
        layers.draw_graph(own, graph, alone=False)
        _arrows(own, graph, flow, greatest)
    _compare(axes[-1], panels, greatest)
    return figure


def _arrows(axes: "Axes", graph: BehaviorGraph, flow: np.ndarray, greatest: float) -> None:
    """Draw each direction of an edge on its right, as wide as its flow."""
    position = np.asarray(graph.position, float)
    low, high = np.asarray(axes.dataLim.intervalx)
    aside = 0.006 * (high - low)
    for u, v in np.argwhere(flow > 0.005 * greatest):
        along = (position[v] - position[u]) / max(float(np.linalg.norm(position[v] - position[u])), 1e-9)
        right = aside * np.array([along[1], -along[0]])
        width = WIDEST * flow[u, v] / greatest
        arrow = dict(arrowstyle="-|>", color=colors.FLOW, linewidth=width, mutation_scale=5 + 1.5 * width, alpha=0.8)
        axes.annotate("", xy=position[v] + right, xytext=position[u] + right, arrowprops=arrow, zorder=5)


def _compare(axes: "Axes", panels: dict[str, np.ndarray], greatest: float) -> None:
    """Plot the flows of all panels against the first one."""
    names = list(panels)
    first = panels[names[0]]
    shades = [*colors.SITUATION_COLORS.values()]
    for name, shade in zip(names[1:], shades, strict=False):
        counts = (first > 0) | (panels[name] > 0)
        axes.plot(first[counts], panels[name][counts], "o", ms=4, color=shade, alpha=0.8, label=name)
    axes.plot([0, greatest], [0, greatest], color=colors.MUTED, lw=0.8)
    axes.set_xlabel(f"{names[0]}, people per minute", color=colors.MUTED)
    axes.set_ylabel("people per minute", color=colors.MUTED)
    axes.set_title("edge by edge", loc="left", color=colors.INK)
    if len(names) > 1:
        axes.legend(frameon=False)


def _table(graph: BehaviorGraph, panels: dict[str, np.ndarray]) -> str:
    """The flow [people per minute] along each directed edge in each panel (M, M), as CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["from", "to", *(f"{name} [1/min]" for name in panels)])
    for u, v in np.argwhere(np.isfinite(np.asarray(graph.edge_cost))):
        writer.writerow([graph.names[u], graph.names[v], *(f"{flow[u, v]:.3f}" for flow in panels.values())])
    return stream.getvalue()


def _report(graph: BehaviorGraph, fit: GraphFit) -> list[str]:
    """The fit in words."""
    mean, deviation = fit.speed
    lines = [f"preferred speed: {mean:.2f} m/s, standard deviation {deviation:.2f} m/s"] if np.isfinite(mean) else []
    for number, node in enumerate(np.asarray(graph.groups)):
        shortest, longest = fit.stay[number]
        stays = f"stays of {shortest:.1f} to {longest:.1f} s" if np.isfinite(shortest) else "hardly any stays"
        lines.append(f"group {graph.names[node]}: {stays}, {fit.capacity[number]} people")
    return lines

"""What ``sean fit-graph`` shows: measured and fitted flows side by side, their table, and what was found."""

import csv
import io
from typing import TYPE_CHECKING

import matplotlib
import numpy as np

from sean_jax.base import Environment
from sean_jax.drawing import colors, layers
from sean_jax.graph import BehaviorGraph
from sean_jax.studies.inverse_graph.fitting import GraphFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDEST = 7.0  # points, of the arrow of the greatest flow


def picture(
    environment: Environment, graph: BehaviorGraph, panels: dict[str, np.ndarray], title: str, width: float = 5.0
) -> "Figure":
    """Draw flows as arrows along the edges, each measure in a panel of its own, and compare them in a last one.

    Args:
        panels: title -> (M, M) people per minute; the first is what the others are compared with.
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
    """Plot the flows of all panels against those of the first one."""
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


def table(graph: BehaviorGraph, panels: dict[str, np.ndarray]) -> str:
    """The flow along each directed edge, as CSV.

    Args:
        panels: title -> (M, M) people per minute.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["from", "to", *(f"{name} [1/min]" for name in panels)])
    for u, v in np.argwhere(np.isfinite(np.asarray(graph.edge_cost))):
        writer.writerow([graph.names[u], graph.names[v], *(f"{flow[u, v]:.3f}" for flow in panels.values())])
    return stream.getvalue()


def findings(graph: BehaviorGraph, fit: GraphFit) -> list[str]:
    """What was found, for people."""
    mean, deviation = fit.speed
    lines = [f"preferred speed: {mean:.2f} m/s, standard deviation {deviation:.2f} m/s"] if np.isfinite(mean) else []
    for number, node in enumerate(np.asarray(graph.groups)):
        shortest, longest = fit.stay[number]
        stays = f"stays of {shortest:.1f} to {longest:.1f} s" if np.isfinite(shortest) else "hardly any stay was seen"
        lines.append(f"group {graph.names[node]}: {stays}, {fit.capacity[number]} people")
    return lines

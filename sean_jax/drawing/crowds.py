"""Pictures of crowds (section IV-D): how dense people are over the floor, and how many walk along each edge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax.base import Environment
from sean_jax.drawing import colors, parts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDEST = 0.45, 0.024  # of the nodes' mean radius, and of the floor's width at most: the edge with most people
THINNEST = 0.002  # of the floor's width: the bands of edges with hardly any


def congestion_map(
    environment: Environment,
    density: np.ndarray,
    *,
    graph: Any = None,
    flow: np.ndarray | None = None,
    width: float = 6.4,
    title: str = "",
) -> Figure:
    """People's density over the floor, and over it the edges of a graph as wide as their flow.

    ``density`` (rows, columns) is in people per m2, row 0 at the lowest y; ``flow`` (M, M) in people per minute from
    the row's node to the column's. Either way of an edge has a band of its own, on the right as one walks, that
    narrows in that direction; edges that nobody walked are left out.
    """
    figure, axes = parts.canvas(environment, width, title)
    draw_heat(axes, environment, np.asarray(density, float), "people per m²")
    parts.draw_obstacles(axes, environment)
    if graph is not None and flow is not None:
        draw_flow(axes, environment, graph, np.asarray(flow, float))
    parts.draw_scale(axes, environment)
    return figure


def draw_heat(axes: Axes, environment: Environment, density: np.ndarray, label: str) -> None:
    """Values (rows, columns) over the floor, with their scale below it; the 3 % highest share one colour."""
    from matplotlib.colors import LinearSegmentedColormap, PowerNorm
    from matplotlib.ticker import MaxNLocator

    x0, y0, x1, y1 = (float(v) for v in np.asarray(environment.floor))
    busy = density[density > 0]
    most = float(np.quantile(busy, 0.97)) if busy.size else 1.0
    image = axes.imshow(
        density,
        extent=(x0, x1, y0, y1),
        origin="lower",
        cmap=LinearSegmentedColormap.from_list("heat", colors.HEAT),
        norm=PowerNorm(0.5, 0.0, most),
        interpolation="nearest",
        aspect="auto",
        zorder=1,
    )
    span = x1 - x0
    below = axes.inset_axes((x1 - 0.38 * span, y0 - 0.034 * span, 0.38 * span, 0.014 * span), transform=axes.transData)
    bar = axes.get_figure().colorbar(image, cax=below, orientation="horizontal", extend="max", ticks=MaxNLocator(3))  # pyright: ignore[reportOptionalMemberAccess]
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    below.tick_params(size=0, labelsize=7.5, labelcolor=colors.MUTED, pad=2)
    place = (x1 - 0.40 * span, y0 - 0.027 * span)
    axes.text(*place, label, fontsize=7.5, color=colors.MUTED, ha="right", va="center")


def draw_flow(axes: Axes, environment: Environment, graph: Any, flow: np.ndarray) -> None:
    """A band for each directed edge that was walked, as wide as its ``flow`` (M, M), with its tip where it leads."""
    from matplotlib.collections import PolyCollection

    x0, y0, x1, _ = (float(v) for v in np.asarray(environment.floor))
    span, most = x1 - x0, float(flow.max(initial=0.0))
    position, widest = (
        np.asarray(graph.position, float),
        min(WIDEST[0] * float(np.mean(graph.radius)), WIDEST[1] * span),
    )
    bands = []
    for u, v in np.argwhere(flow > 0):
        wide = max(widest * float(flow[u, v]) / most, THINNEST * span)
        bands.append(_band(position[u], position[v], wide))
    corner = np.array([x0 + 0.19 * span, y0 - 0.027 * span + 0.5 * widest])
    bands.append(_band(corner, corner + np.array([0.05 * span, 0.0]), widest))
    drawn = PolyCollection(bands, facecolors=colors.FLOW, edgecolors=colors.FLOOR, linewidths=0.5, alpha=0.7, zorder=4)
    drawn.set_clip_on(False)
    axes.add_collection(drawn)
    axes.plot(*position.T, linestyle="", marker="o", markersize=3.5, color=colors.FLOW_EDGE, zorder=5)
    place = (x0 + 0.25 * span, y0 - 0.027 * span)
    axes.text(*place, f"{most:.3g} people a minute", fontsize=7.5, color=colors.MUTED, ha="left", va="center")


def _band(start: np.ndarray, end: np.ndarray, wide: float) -> np.ndarray:
    """(5, 2) m corners of a band right of the way from start to end, pointed at the end."""
    along = end - start
    long = max(float(np.hypot(*along)), 1e-9)
    along = along / long
    right = np.array([along[1], -along[0]]) * wide
    tip = end - along * min(1.5 * wide, 0.5 * long)
    return np.stack([start, start + right, tip + right, end, end])

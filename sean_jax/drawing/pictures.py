"""Stills: an episode from above, where people spent their time, and how they crowd (section IV-D)."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import obstacle_grid
from sean_jax.base import Environment, Obstacles, Scenario, Trajectory
from sean_jax.drawing import animation, colors, parts
from sean_jax.graph import BehaviorGraph, graph_of
from sean_jax.scenery import plain_scenery

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAX_BAND = 0.45, 0.024  # of the nodes' mean radius, and of the floor's width: the band of the edge with most people
MIN_BAND = 0.002  # of the floor's width: the bands of edges with hardly any people


def top_down(
    environment: Environment,
    *,
    graph: BehaviorGraph | None = None,
    frames: Trajectory | None = None,
    situations: Sequence[str] | None = None,
    time_step: float = 0.1,
    robot_radius: float = parts.ROBOT_RADIUS,
    trail: float = 40.0,
    width: float = 6.4,
    title: str = "",
) -> Figure:
    """Draw an environment from above, with one episode.

    The episode is drawn as people's trails, their places at its end, and the robot's path in the colors of the
    situations.

    Args:
        frames: (T, ...) of one episode, if there is one.
        situations: names of the frames' situations, any names; the paper's five, or numbers, if None.
        time_step: s, between two frames.
        robot_radius: m.
        trail: s, of people's trails.

    Raises:
        InputError: the frames have a batch axis, or another number of situations.
    """
    figure, axes = parts.canvas(environment, width, title)
    parts.draw_obstacles(axes, environment)
    if graph is not None:
        parts.draw_graph(axes, graph, alone=frames is None)
    if frames is not None:
        frames = parts.one_episode(frames)
        situations = parts.situation_names(frames, situations)
        parts.draw_trails(axes, frames, round(trail / time_step))
        parts.draw_people(axes, frames)
        parts.draw_robot(axes, frames, situations, robot_radius)
    parts.draw_legend(axes, graph is not None, frames, situations or ())
    parts.draw_scale(axes, environment)
    return figure


def heat_map(environment: Environment, seconds: np.ndarray, *, width: float = 6.4, title: str = "") -> Figure:
    """Draw where people spent their time.

    Args:
        seconds: (rows, columns) s, the time that people spent in each of the equal cells that cover the floor, row 0
            at its lowest y.
    """
    figure, axes = parts.canvas(environment, width, title)
    x0, y0, x1, y1 = (float(v) for v in np.asarray(environment.floor))
    density = np.asarray(seconds, float) * seconds.size / ((x1 - x0) * (y1 - y0))
    draw_heat(axes, environment, density, "person-seconds per m²")
    parts.draw_obstacles(axes, environment)
    parts.draw_scale(axes, environment)
    return figure


def congestion_map(
    environment: Environment,
    density: np.ndarray,
    *,
    graph: BehaviorGraph | None = None,
    flow: np.ndarray | None = None,
    width: float = 6.4,
    title: str = "",
) -> Figure:
    """Draw people's density over the floor, and over it the edges of a graph as wide as their flow.

    Each direction of an edge has a band of its own, on the right as one walks, with its tip in that direction. Edges
    that nobody walked are left out.

    Args:
        density: (rows, columns) people per m2, row 0 at the lowest y.
        flow: (M, M) people per minute from the row's node to the column's.
    """
    figure, axes = parts.canvas(environment, width, title)
    draw_heat(axes, environment, np.asarray(density, float), "people per m²")
    parts.draw_obstacles(axes, environment)
    if graph is not None and flow is not None:
        draw_flow(axes, environment, graph, np.asarray(flow, float))
    parts.draw_scale(axes, environment)
    return figure


def draw_heat(axes: Axes, environment: Environment, density: np.ndarray, label: str) -> None:
    """Draw values over the floor, with their scale below it; the 3 % highest share one color.

    Args:
        density: (rows, columns) values, row 0 at the lowest y.
    """
    from matplotlib.colors import LinearSegmentedColormap, PowerNorm
    from matplotlib.ticker import MaxNLocator

    x0, y0, x1, y1 = (float(v) for v in np.asarray(environment.floor))
    busy = density[density > 0]
    highest = float(np.quantile(busy, 0.97)) if busy.size else 1.0
    image = axes.imshow(
        density,
        extent=(x0, x1, y0, y1),
        origin="lower",
        cmap=LinearSegmentedColormap.from_list("heat", colors.HEAT),
        norm=PowerNorm(0.5, 0.0, highest),
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


def draw_flow(axes: Axes, environment: Environment, graph: BehaviorGraph, flow: np.ndarray) -> None:
    """Draw a band for each directed edge that was walked, as wide as its flow, with its tip where it leads.

    Args:
        flow: (M, M) people per minute.
    """
    from matplotlib.collections import PolyCollection

    x0, y0, x1, _ = (float(v) for v in np.asarray(environment.floor))
    span, flow_max = x1 - x0, float(flow.max(initial=0.0))
    position, widest = (
        np.asarray(graph.position, float),
        min(MAX_BAND[0] * float(np.mean(graph.radius)), MAX_BAND[1] * span),
    )
    bands = []
    for u, v in np.argwhere(flow > 0):
        wide = max(widest * float(flow[u, v]) / flow_max, MIN_BAND * span)
        bands.append(_band(position[u], position[v], wide))
    corner = np.array([x0 + 0.19 * span, y0 - 0.027 * span + 0.5 * widest])
    bands.append(_band(corner, corner + np.array([0.05 * span, 0.0]), widest))
    collection = PolyCollection(
        bands, facecolors=colors.FLOW, edgecolors=colors.FLOOR, linewidths=0.5, alpha=0.7, zorder=4
    )
    collection.set_clip_on(False)
    axes.add_collection(collection)
    axes.plot(*position.T, linestyle="", marker="o", markersize=3.5, color=colors.FLOW_EDGE, zorder=5)
    place = (x0 + 0.25 * span, y0 - 0.027 * span)
    axes.text(*place, f"{flow_max:.3g} people a minute", fontsize=7.5, color=colors.MUTED, ha="left", va="center")


def _band(start: np.ndarray, end: np.ndarray, wide: float) -> np.ndarray:
    """(5, 2) m corners of a band on the right of the way from start to end, with its tip at the end."""
    along = end - start
    long = max(float(np.hypot(*along)), 1e-9)
    along = along / long
    right = np.array([along[1], -along[0]]) * wide
    tip = end - along * min(1.5 * wide, 0.5 * long)
    return np.stack([start, start + right, tip + right, end, end])


def view(trajectory: Trajectory, scenario: Scenario | None = None, animate: bool = False) -> Any:
    """Draw a trajectory for a notebook.

    The behavior graph is drawn if the scenario has one. Without a scenario, people and robot are drawn on an empty
    floor.

    Args:
        trajectory: (T, ...) frames; of a batch (B, T, ...) the first episode.

    Returns:
        A matplotlib ``Figure``, or with ``animate`` a moving IPython ``Image``.
    """
    frames = trajectory
    while np.ndim(frames.active) > 1:
        frames = jax.tree.map(lambda leaf: leaf[0], frames)
    if scenario is None:
        environment, graph, names, time_step = empty_floor(frames), None, None, 0.1
    else:
        environment, graph, time_step = scenario.environment, graph_of(scenario), scenario.time_step
        names = tuple(name for name, _ in scenario.situations)
    radius = parts.ROBOT_RADIUS if scenario is None else scenario.robot.radius
    shown: dict[str, Any] = dict(graph=graph, situations=names, time_step=time_step, robot_radius=radius)
    if not animate:
        return top_down(environment, frames=frames, **shown)
    from IPython.display import Image

    stream = io.BytesIO()
    animation.animate(environment, frames, stream, **shown)
    return Image(data=stream.getvalue(), format="gif")


def empty_floor(frames: Trajectory) -> Environment:
    """A floor without obstacles that contains all positions, with 2 m around them.

    Args:
        frames: (T, ...).
    """
    places = np.concatenate([np.asarray(frames.people).reshape(-1, 2), np.asarray(frames.position).reshape(-1, 2)])
    floor = jnp.asarray(np.concatenate([places.min(0) - 2.0, places.max(0) + 2.0]), float)
    none, pairs = jnp.zeros(0, float), jnp.zeros((0, 2), float)
    obstacles = Obstacles(center=pairs, half_extent=pairs, yaw=none, height=none)
    return Environment(
        floor=floor,
        obstacles=obstacles,
        obstacle_grid=obstacle_grid.build(obstacles, floor),
        scenery=plain_scenery(obstacles),
        name="empty floor",
    )

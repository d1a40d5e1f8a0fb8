"""Layers of a picture from above: floor, obstacles, graph, heat, trails, people, robot, legend, scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy.typing import ArrayLike

from sean_jax.core.data_types import Environment, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.drawing import colors
from sean_jax.graph import FLOWS, NO_EDGE, BehaviorGraph

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

DARKEST_HEIGHT = 4.0  # m, from which obstacles have the darkest shade
PERSON_RADIUS = 0.25  # m, as drawn: a body of 0.2 m and its edge
DEPTH = 0.6  # of a person's width, from chest to back, so that shoulders tell the heading
ROBOT_RADIUS = 0.16  # m, Kuri's, where no scenario tells another
HALO = 0.7  # m, around a robot: at its true size alone it would be hard to find
MAX_BAND = 0.45, 0.024  # of the nodes' mean radius, and of the floor's width: the band of the edge with most people
MIN_BAND = 0.002  # of the floor's width: the bands of edges with hardly any people
MARGIN, FOOT = 0.02, 0.075  # of the floor's width, around it and below it


def one_episode(frames: Trajectory) -> Trajectory:
    """The frames (T, ...) of one episode on the host, cut after the last active one; InputError for a batch."""
    if np.ndim(frames.active) != 1:
        raise InputError(f"frames of one episode have one leading axis, these have {np.ndim(frames.active)}.")
    frames = jax.tree.map(np.asarray, frames)
    last = int(np.flatnonzero(frames.active)[-1]) + 1 if np.any(frames.active) else 1
    return jax.tree.map(lambda leaf: leaf[:last], frames)


def first_episode(frames: Trajectory) -> Trajectory:
    """Frames (T, ...); of a batch (B, T, ...) those of the first episode."""
    while np.ndim(frames.active) > 1:
        frames = jax.tree.map(lambda leaf: leaf[0], frames)
    return frames


def situation_names(frames: Trajectory, names: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the frames' S situations: ``names``, or the paper's five, or numbers if there are not five.

    Raises:
        InputError: there are not S names.
    """
    number = np.shape(frames.situations)[-1]
    if names is None:
        paper = tuple(colors.SITUATION_COLORS)
        return paper if number == len(paper) else tuple(f"situation_{index}" for index in range(1, number + 1))
    if len(names) != number:
        raise InputError(f"situations: {len(names)} names for frames with {number} situations; give one name for each.")
    return tuple(names)


def situation_indices(frames: Trajectory) -> np.ndarray:
    """(T,) int, the first situation that holds in each step, S if none holds."""
    flags = np.asarray(frames.situations, bool)
    none = np.ones((*flags.shape[:-1], 1), bool)
    return np.concatenate([flags, none], -1).argmax(-1)


def step_colors(frames: Trajectory, situations: Sequence[str]) -> list[str]:
    """The color of each step: that of the first situation that holds."""
    shades = [*colors.situation_colors(situations), colors.NO_SITUATION]
    return [shades[index] for index in situation_indices(frames)]


def canvas(environment: Environment, width: float, title: str) -> tuple[Figure, Axes]:
    """A figure of ``width`` inches and its axes [m], which show the floor in true proportion, without ticks."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    x0, y0, x1, y1 = (float(v) for v in np.asarray(environment.floor))
    span = x1 - x0
    low, high = y0 - FOOT * span, y1 + MARGIN * span
    wide, tall = span * (1 + 2 * MARGIN), high - low
    head = 0.32 if title else 0.0  # inches
    floor_height = width * tall / wide
    figure = Figure(figsize=(width, floor_height + head), facecolor=colors.PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, floor_height / (floor_height + head)))
    axes.set_xlim(x0 - MARGIN * span, x1 + MARGIN * span)
    axes.set_ylim(low, high)
    axes.set_axis_off()
    axes.add_patch(
        Rectangle((x0, y0), span, y1 - y0, facecolor=colors.FLOOR, edgecolor=colors.MUTED, linewidth=0.8, zorder=0)
    )
    if title:
        top = 1 - 0.14 / (floor_height + head)
        figure.text(MARGIN * span / wide, top, title, fontsize=10, color=colors.INK, va="center", weight="bold")
    return figure, axes


def draw_obstacles(axes: Axes, environment: Environment) -> None:
    """Draw the visible boxes, the higher the darker."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    boxes = jax.tree.map(np.asarray, environment.obstacles)
    boxes = jax.tree.map(lambda part: part[boxes.height > 0.0], boxes)
    corners = boxes.half_extent[:, None] * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], float)
    cosine, sine = np.cos(boxes.yaw)[:, None], np.sin(boxes.yaw)[:, None]
    x = boxes.center[:, None, 0] + cosine * corners[..., 0] - sine * corners[..., 1]
    y = boxes.center[:, None, 1] + sine * corners[..., 0] + cosine * corners[..., 1]
    outlines = list(np.stack([x, y], -1))
    opacity = 0.18 + 0.44 * np.clip(boxes.height / DARKEST_HEIGHT, 0, 1) ** 0.7
    axes.add_collection(PolyCollection(outlines, facecolors=colors.FLOOR, edgecolors="none", zorder=2))
    for alphas, filled in ((opacity, True), (np.minimum(1.5 * opacity, 1.0), False)):
        shades = [to_rgba(colors.OBSTACLE, alpha) for alpha in alphas]
        face, edge = (shades, "none") if filled else ("none", shades)
        axes.add_collection(PolyCollection(outlines, facecolors=face, edgecolors=edge, linewidths=0.6, zorder=2))


def draw_graph(axes: Axes, graph: BehaviorGraph, alone: bool) -> None:
    """Draw nodes as discs and edges as lines: thick for high flow, dotted for low, with an arrow for one way.

    Args:
        alone: name the nodes; otherwise colors are faint, for a background.
    """
    from matplotlib.collections import LineCollection

    count = len(graph.names) or graph.nodes
    position, radius = np.asarray(graph.position)[:count], np.asarray(graph.radius)[:count]
    group, flows = np.asarray(graph.is_group, bool)[:count], np.asarray(graph.flow)
    color = colors.EDGE if alone else colors.FAINT_EDGE
    lines, styles, widths = [], [], []
    for u, v in np.argwhere(np.triu(flows != NO_EDGE, 1)):
        flow = FLOWS[flows[u, v]]
        one_way = flow in ("forward", "backward")
        start, end = (position[v], position[u]) if flow == "backward" else (position[u], position[v])
        lines.append((start, end))
        styles.append((0, (1, 1.6)) if flow == "low" else "-")
        widths.append(2.6 if flow == "high" else 1.2)
        if one_way:
            along = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
            tip = 0.5 * (start + end) + 0.5 * along
            arrow = dict(arrowstyle="-|>", color=color, mutation_scale=13, linewidth=0)
            axes.annotate("", xy=tuple(tip), xytext=tuple(tip - 0.1 * along), arrowprops=arrow, zorder=3)
    axes.add_collection(LineCollection(lines, colors=color, linewidths=widths, linestyles=styles, zorder=3))
    for members, shade in ((~group, color), (group, colors.MEMBER)):
        size = 2 * radius[members]
        for alpha, face, edge in ((0.16, shade, "none"), (1.0, "none", shade)):
            dashes = "--" if shade == colors.MEMBER else "-"
            style = dict(facecolors=face, edgecolors=edge, alpha=alpha, linewidths=0.9, linestyles=dashes, zorder=3)
            _draw_ellipses(axes, position[members], size, size, np.zeros_like(size), style)
    if alone:
        from matplotlib.patheffects import withStroke

        halo = [withStroke(linewidth=2.5, foreground=colors.FLOOR)]
        for name, place, standing, size in zip(graph.names, position, group, radius, strict=True):
            label = name.replace("_", " ")
            x, y = (float(v) for v in place)
            up, side = (float(size), "bottom") if standing else (0.0, "center")  # people stand in the middle of a group
            axes.text(x, y + up, label, fontsize=7, color=colors.INK, ha="center", va=side, path_effects=halo, zorder=4)


def draw_trails(axes: Axes, frames: Trajectory, steps: int) -> None:
    """Draw where each person walked in the last ``steps`` of frames (T, ...), fading with age."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgb

    people, present = (np.asarray(part)[-steps - 1 :] for part in (frames.people, frames.present))
    stride = max(1, len(people) // 240)
    people, present = people[::-stride][::-1], present[::-stride][::-1]
    if len(people) < 2:
        return
    segments = np.stack([people[:-1], people[1:]], 2)  # (T - 1, N, 2, 2)
    walked = (present[:-1] & present[1:]).ravel()  # people who are absent at one end did not walk there
    age = np.linspace(0.03, 1.0, len(segments)) ** 1.6
    shade = np.concatenate([np.tile(to_rgb(colors.TRAIL), (len(segments), 1)), 0.75 * age[:, None]], 1)
    trails = LineCollection(
        list(segments.reshape(-1, 2, 2)[walked]),
        colors=np.repeat(shade, people.shape[1], 0)[walked],
        linewidths=1.1,
        zorder=4,
    )
    trails.set_rasterized(True)  # thousands of segments: an image is smaller than their outlines
    trails.set_capstyle("butt")
    axes.add_collection(trails)


def draw_people(axes: Axes, frames: Trajectory) -> None:
    """Draw each person at the last of frames (T, ...): a disc with a tick along the heading, blue in a group."""
    present = np.asarray(frames.present[-1], bool)
    position, heading, group = (
        np.asarray(part[-1])[present] for part in (frames.people, frames.people_heading, frames.group)
    )
    draw_discs(axes, position, heading, group >= 0, PERSON_RADIUS, 0.8)


def draw_discs(
    axes: Axes, position: np.ndarray, heading: np.ndarray, member: np.ndarray, radius: float, linewidth: float
) -> None:
    """Draw people from above, by their shoulders, with a tick along the heading.

    Args:
        position: (N, 2) m.
        heading: (N, 2) unit vectors.
        member: (N,) bool, whether a person is in a group, which has another color.
        radius: m, half of the width of the shoulders.
    """
    from matplotlib.collections import LineCollection

    ends = np.stack([position, position + 1.9 * radius * heading], 1)
    axes.add_collection(LineCollection(list(ends), colors=colors.PERSON_EDGE, linewidths=linewidth + 0.1, zorder=6))
    across = np.full(len(position), 2 * radius)
    angles = np.degrees(np.arctan2(heading[:, 1], heading[:, 0]))
    faces = [colors.MEMBER if is_member else colors.PERSON for is_member in member]
    style = dict(facecolors=faces, edgecolors=colors.PERSON_EDGE, linewidths=linewidth, zorder=7)
    _draw_ellipses(axes, position, DEPTH * across, across, angles, style)


def _draw_ellipses(
    axes: Axes, position: np.ndarray, width: np.ndarray, height: np.ndarray, angle: np.ndarray, style: dict[str, Any]
) -> None:
    """Draw ellipses at positions (N, 2) [m], of widths and heights (N,) [m], turned by angles (N,) [degrees]."""
    from matplotlib.collections import EllipseCollection

    place: Any = dict(units="xy", offsets=position, offset_transform=axes.transData)
    axes.add_collection(EllipseCollection(width, height, angle, **place, **style))


def draw_robot(axes: Axes, frames: Trajectory, situations: Sequence[str], radius: ArrayLike = ROBOT_RADIUS) -> None:
    """Draw the robot's path in the colors of situations, its start (ring), goal (target) and last pose, to scale.

    Other robots of a team have dashed paths and goals.

    Args:
        frames: (T, ...) of one episode.
        radius: m, of all robots, or (1 + R,) of the robot and the other ones.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle

    path, others = np.asarray(frames.position), of_others(frames)
    radius, *radii = map(float, np.broadcast_to(radius, 1 + len(others)))
    shades = step_colors(frames, situations)
    axes.plot(*path.T, color=colors.PAPER, linewidth=5.0, solid_capstyle="round", zorder=8)
    runs = np.flatnonzero([True, *(a != b for a, b in zip(shades[1:], shades[:-1], strict=True))])
    pieces = [path[max(a - 1, 0) : b] for a, b in zip(runs, [*runs[1:], len(path)], strict=True)]
    axes.add_collection(
        LineCollection(pieces, colors=[shades[a] for a in runs], linewidths=3.0, zorder=9, capstyle="butt")
    )
    axes.add_patch(Circle(path[0], 0.42, facecolor=colors.PAPER, edgecolor=colors.ROBOT, linewidth=1.8, zorder=10))
    goal = (float(frames.goal[-1][0]), float(frames.goal[-1][1]))
    for ring, face in ((0.75, "none"), (0.28, colors.ROBOT)):
        axes.add_patch(Circle(goal, ring, facecolor=face, edgecolor=colors.ROBOT, linewidth=1.8, zorder=10))
    here = (float(path[-1][0]), float(path[-1][1]))
    axes.add_patch(Circle(here, HALO, facecolor=colors.ROBOT, edgecolor="none", alpha=0.35, zorder=11))
    axes.add_patch(Circle(here, radius, facecolor=colors.ROBOT, edgecolor=colors.ROBOT_EDGE, linewidth=1.0, zorder=11))
    for other, size in zip(others, radii, strict=True):
        axes.plot(*other[:, :2].T, color=colors.ROBOT, linewidth=1.4, linestyle="--", zorder=8)
        x, y, hx, hy, *goal = map(float, other[-1])
        body: Any = dict(facecolor=colors.ROBOT, edgecolor=colors.ROBOT_EDGE, linewidth=1.0, zorder=11)
        axes.add_patch(Circle((x, y), size, **body))
        axes.plot([x, x + 2.2 * size * hx], [y, y + 2.2 * size * hy], color=colors.ROBOT_EDGE, linewidth=1.4, zorder=12)
        ring: Any = dict(facecolor="none", edgecolor=colors.ROBOT, linewidth=1.4, linestyle="--", zorder=10)
        axes.add_patch(Circle((goal[0], goal[1]), 0.75, **ring))
        axes.add_patch(Circle((goal[0], goal[1]), 0.28, facecolor=colors.ROBOT, edgecolor="none", zorder=10))
    nose = path[-1] + 2.2 * radius * frames.heading[-1]
    axes.plot(*zip(path[-1], nose, strict=True), color=colors.ROBOT_EDGE, linewidth=1.4, zorder=12)


def of_others(frames: Trajectory) -> np.ndarray:
    """(R, T, 6) of the other robots of a team, as ``Trajectory.robots``; R is 0 without a team."""
    robots = np.zeros((len(frames.position), 0, 6)) if frames.robots is None else np.asarray(frames.robots)
    return robots.swapaxes(0, 1)


def draw_scale(axes: Axes, environment: Environment) -> None:
    """Draw a bar of a round length below the floor's left corner."""
    x0, y0, x1, _ = (float(v) for v in np.asarray(environment.floor))
    span = x1 - x0
    bar = max(length for length in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if length <= max(0.15 * span, 0.5))
    y = y0 - 0.030 * span
    tick = 0.008 * span
    axes.plot([x0, x0, x0 + bar, x0 + bar], [y + tick, y, y, y + tick], color=colors.MUTED, linewidth=1.1, zorder=5)
    axes.text(x0, y - 0.010 * span, f"{bar:g} m", fontsize=8, color=colors.MUTED, ha="left", va="top", zorder=5)


def draw_heat(axes: Axes, environment: Environment, density: np.ndarray, label: str) -> None:
    """Draw values (rows, columns) over the floor, row 0 at its lowest y, and a scale; the highest 3 % share a color."""
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
    """Draw a band for each walked direction of an edge, as wide as its flow, with its tip where it leads.

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


def mark(shape: str, face: str, edge: str, size: float = 6) -> Line2D:
    """A mark of a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", marker=shape, markersize=size, markerfacecolor=face, markeredgecolor=edge)


def draw_legend(axes: Axes, graph: bool, frames: Trajectory | None, situations: Sequence[str]) -> None:
    """Draw what the marks mean, in up to three rows below the floor; only situations that occurred are named.

    Args:
        frames: (T, ...) of one episode, if one is drawn.
    """
    from matplotlib.legend_handler import HandlerTuple
    from matplotlib.lines import Line2D

    entries: list[tuple[Any, str]] = []
    if frames is not None:
        entries += [
            (mark("o", colors.ROBOT, colors.ROBOT_EDGE, 6.5), "robot"),
            (mark("o", colors.PAPER, colors.ROBOT, 6.5), "start"),
            ((mark("o", "none", colors.ROBOT, 8.5), mark("o", colors.ROBOT, colors.ROBOT, 3)), "goal"),
            (mark("o", colors.PERSON, colors.PERSON_EDGE, 6.5), "person"),
            (mark("o", colors.MEMBER, colors.PERSON_EDGE, 6.5), "in a group"),
        ]
        occurred = set(situation_indices(frames).tolist())
        shades = [*zip(situations, colors.situation_colors(situations), strict=True), ("none", colors.NO_SITUATION)]
        for index, (name, color) in enumerate(shades):
            if index in occurred:
                entries.append((Line2D([], [], color=color, linewidth=3), name.replace("_", " ")))
    elif graph:
        entries += [
            (mark("o", "#e9ecf2", colors.EDGE, 8), "waypoint"),
            (mark("o", "#e2f4f9", colors.MEMBER, 8), "group"),
            (Line2D([], [], color=colors.EDGE, linewidth=1.2), "both ways"),
            (Line2D([], [], color=colors.EDGE, linewidth=1.2, marker=">", markersize=5), "one way"),
        ]
    if entries:
        handles, labels = zip(*entries, strict=True)
        columns = max(5 if frames is not None else 4, -(-len(entries) // 3))  # three rows fit below the floor
        legend = axes.legend(
            handles, labels, loc="lower right", bbox_to_anchor=(1.0 - MARGIN, 0.0),
            ncols=columns, fontsize=7.5 if columns < 6 else 6.5,
            frameon=False, labelcolor=colors.INK, handlelength=1.1, handletextpad=0.5,
            columnspacing=1.2, borderpad=0.1, borderaxespad=0.2, labelspacing=0.35,
            handler_map={tuple: HandlerTuple(ndivide=1)},
        )  # fmt: skip
        legend.set_zorder(20)

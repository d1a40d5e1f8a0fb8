"""Layers of a picture from above: floor, obstacles, graph, heat, trails, people, robot, legend, scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy.typing import ArrayLike

from sean_jax.core.data_types import Environment, Obstacles, Trajectory
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
MARGIN = 0.02  # of the floor's width, around it
FOOT = 0.075  # of the floor's width, below it


def one_episode(frames: Trajectory) -> Trajectory:
    """The frames (T, ...) of one episode on the host, cut after the last active one; InputError for a batch."""
    axes = np.ndim(frames.active)
    if axes != 1:
        raise InputError(f"frames of one episode have one leading axis, these have {axes}.")
    frames = jax.tree.map(np.asarray, frames)
    active = np.flatnonzero(frames.active)
    count = int(active[-1]) + 1 if len(active) else 1
    return jax.tree.map(lambda leaf: leaf[:count], frames)


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
    paper = tuple(colors.SITUATION_COLORS)
    if names is None and number == len(paper):
        return paper
    if names is None:
        return tuple(f"situation_{index}" for index in range(1, number + 1))
    if len(names) != number:
        raise InputError(f"situations: {len(names)} names for frames with {number} situations; give one name for each.")
    return tuple(names)


def situation_indices(frames: Trajectory) -> np.ndarray:
    """(T,) int, the first situation that holds in each step, S if none holds."""
    flags = np.asarray(frames.situations, bool)
    none = np.ones((*flags.shape[:-1], 1), bool)
    flags = np.concatenate([flags, none], -1)
    return flags.argmax(-1)


def step_colors(frames: Trajectory, situations: Sequence[str]) -> list[str]:
    """The color of each step: that of the first situation that holds."""
    shades = [*colors.situation_colors(situations), colors.NO_SITUATION]
    indices = situation_indices(frames)
    return [shades[index] for index in indices]


def canvas(environment: Environment, width: float, title: str) -> tuple[Figure, Axes]:
    """A figure of ``width`` inches and its axes [m], which show the floor in true proportion, without ticks."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    # The floor with its margins [m], and a title above it [inches].
    x0, y0, x1, y1 = map(float, np.asarray(environment.floor))
    span = x1 - x0
    margin = MARGIN * span
    bottom = y0 - FOOT * span
    top = y1 + margin
    width_shown = span * (1 + 2 * MARGIN)
    floor_height = width * (top - bottom) / width_shown
    height = floor_height
    if title:
        height += 0.32

    figure = Figure(figsize=(width, height), facecolor=colors.PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, floor_height / height))
    axes.set_xlim(x0 - margin, x1 + margin)
    axes.set_ylim(bottom, top)
    axes.set_axis_off()
    style: Any = dict(facecolor=colors.FLOOR, edgecolor=colors.MUTED, linewidth=0.8, zorder=0)
    axes.add_patch(Rectangle((x0, y0), span, y1 - y0, **style))
    if title:
        style = dict(fontsize=10, color=colors.INK, va="center", weight="bold")
        figure.text(margin / width_shown, 1 - 0.14 / height, title, **style)
    return figure, axes


def draw_obstacles(axes: Axes, environment: Environment) -> None:
    """Draw the visible boxes, the higher the darker."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    boxes = jax.tree.map(np.asarray, environment.obstacles)
    is_visible = boxes.height > 0.0
    boxes = jax.tree.map(lambda leaf: leaf[is_visible], boxes)
    outlines = _box_outlines(boxes)
    relative_height = np.clip(boxes.height / DARKEST_HEIGHT, 0, 1)
    opacity = 0.18 + 0.44 * relative_height**0.7
    edge_opacity = np.minimum(1.5 * opacity, 1.0)
    faces = [to_rgba(colors.OBSTACLE, alpha) for alpha in opacity]
    edges = [to_rgba(colors.OBSTACLE, alpha) for alpha in edge_opacity]

    # The floor's color below hides what is under translucent boxes.
    axes.add_collection(PolyCollection(outlines, facecolors=colors.FLOOR, edgecolors="none", zorder=2))
    axes.add_collection(PolyCollection(outlines, facecolors=faces, edgecolors="none", linewidths=0.6, zorder=2))
    axes.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=edges, linewidths=0.6, zorder=2))


def _box_outlines(boxes: Obstacles) -> list[np.ndarray]:
    """(4, 2) m, the corners of each box."""
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], float)
    offsets = np.asarray(boxes.half_extent)[:, None] * signs  # (K, 4, 2) m
    u, v = np.moveaxis(offsets, -1, 0)
    cosine = np.cos(boxes.yaw)[:, None]
    sine = np.sin(boxes.yaw)[:, None]
    center_x, center_y = boxes.center.T[..., None]  # (K, 1) m each
    x = center_x + cosine * u - sine * v
    y = center_y + sine * u + cosine * v
    return list(np.stack([x, y], -1))


def draw_graph(axes: Axes, graph: BehaviorGraph, alone: bool) -> None:
    """Draw nodes as discs and edges as lines: thick for high flow, dotted for low, with an arrow for one way.

    Args:
        alone: name the nodes; otherwise colors are faint, for a background.
    """
    count = len(graph.names) or graph.nodes
    position = np.asarray(graph.position)[:count]
    radius = np.asarray(graph.radius)[:count]
    is_group = np.asarray(graph.is_group, bool)[:count]
    color = colors.FAINT_EDGE
    if alone:
        color = colors.EDGE
    is_waypoint = ~is_group
    _draw_edges(axes, position, np.asarray(graph.flow), color)
    _draw_nodes(axes, position[is_waypoint], radius[is_waypoint], color, "-")
    _draw_nodes(axes, position[is_group], radius[is_group], colors.MEMBER, "--")
    if alone:
        _draw_node_names(axes, graph.names, position, radius, is_group)


def _draw_edges(axes: Axes, position: np.ndarray, flows: np.ndarray, color: str) -> None:
    """Lines between nodes at positions (M, 2) [m], by their flows (M, M), indices into FLOWS."""
    from matplotlib.collections import LineCollection

    lines = []
    styles = []
    widths = []
    for u, v in np.argwhere(np.triu(flows != NO_EDGE, 1)):
        flow = FLOWS[flows[u, v]]
        start = position[u]
        end = position[v]
        if flow == "backward":
            start, end = end, start
        style: Any = "-"
        width = 1.2
        if flow == "low":
            style = (0, (1, 1.6))  # dots
        elif flow == "high":
            width = 2.6
        elif flow in ("forward", "backward"):
            _draw_direction(axes, start, end, color)
        lines.append((start, end))
        styles.append(style)
        widths.append(width)
    axes.add_collection(LineCollection(lines, colors=color, linewidths=widths, linestyles=styles, zorder=3))


def _draw_direction(axes: Axes, start: np.ndarray, end: np.ndarray, color: str) -> None:
    """An arrow past the middle of a line from start to end (2,) [m]."""
    gap = end - start
    along = gap / max(float(np.hypot(*gap)), 1e-9)
    tip = 0.5 * (start + end) + 0.5 * along
    tail = tip - 0.1 * along
    arrow = dict(arrowstyle="-|>", color=color, mutation_scale=13, linewidth=0)
    axes.annotate("", xy=tuple(tip), xytext=tuple(tail), arrowprops=arrow, zorder=3)


def _draw_nodes(axes: Axes, position: np.ndarray, radius: np.ndarray, color: str, line: str) -> None:
    """Faint discs with an outline."""
    size = 2 * radius
    angle = np.zeros_like(size)
    outline = dict(linewidths=0.9, linestyles=line, zorder=3)
    _draw_ellipses(axes, position, size, size, angle, dict(facecolors=color, edgecolors="none", alpha=0.16) | outline)
    _draw_ellipses(axes, position, size, size, angle, dict(facecolors="none", edgecolors=color, alpha=1.0) | outline)


def _draw_node_names(
    axes: Axes, names: Sequence[str], position: np.ndarray, radius: np.ndarray, is_group: np.ndarray
) -> None:
    """Names in the middle of waypoints, and above groups, in whose middle people stand."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.5, foreground=colors.FLOOR)]
    style: Any = dict(fontsize=7, color=colors.INK, ha="center", path_effects=halo, zorder=4)
    for name, (x, y), size, group in zip(names, position.tolist(), radius.tolist(), is_group, strict=True):
        label = name.replace("_", " ")
        if group:
            axes.text(x, y + size, label, va="bottom", **style)
        else:
            axes.text(x, y, label, va="center", **style)


def draw_trails(axes: Axes, frames: Trajectory, steps: int) -> None:
    """Draw where each person walked in the last ``steps`` of frames (T, ...), fading with age."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgb

    first = -steps - 1
    people = np.asarray(frames.people)[first:]
    present = np.asarray(frames.present)[first:]
    stride = max(1, len(people) // 240)
    absences = np.cumsum(~present, axis=0)  # (T, N) so far
    people = people[::-stride][::-1]
    present = present[::-stride][::-1]
    absences = absences[::-stride][::-1]
    if len(people) < 2:
        return

    # Who was absent in between has left and come in elsewhere.
    segments = np.stack([people[:-1], people[1:]], 2)  # (T - 1, N, 2, 2)
    walked = present[:-1] & (absences[:-1] == absences[1:])
    walked = walked.ravel()

    # Trails fade with age.
    age = np.linspace(0.03, 1.0, len(segments))[:, None]  # from the oldest
    opacity = 0.75 * age**1.6
    color = np.tile(to_rgb(colors.TRAIL), (len(segments), 1))
    shades = np.concatenate([color, opacity], 1)
    shades = np.repeat(shades, people.shape[1], 0)  # for each person
    lines = list(segments.reshape(-1, 2, 2)[walked])
    trails = LineCollection(lines, colors=shades[walked], linewidths=1.1, zorder=4)
    trails.set_rasterized(True)  # thousands of segments: an image is smaller than their outlines
    trails.set_capstyle("butt")
    axes.add_collection(trails)


def draw_people(axes: Axes, frames: Trajectory) -> None:
    """Draw each person at the last of frames (T, ...): a disc with a tick along the heading, blue in a group."""
    present = np.asarray(frames.present[-1], bool)
    position = np.asarray(frames.people[-1])[present]
    heading = np.asarray(frames.people_heading[-1])[present]
    group = np.asarray(frames.group[-1])[present]
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

    tips = position + 1.9 * radius * heading
    ticks = np.stack([position, tips], 1)
    axes.add_collection(LineCollection(list(ticks), colors=colors.PERSON_EDGE, linewidths=linewidth + 0.1, zorder=6))

    # From shoulder to shoulder, and less deep.
    across = np.full(len(position), 2 * radius)
    angles = np.arctan2(heading[:, 1], heading[:, 0])
    angles = np.degrees(angles)
    faces = [colors.MEMBER if is_member else colors.PERSON for is_member in member]
    style = dict(facecolors=faces, edgecolors=colors.PERSON_EDGE, linewidths=linewidth, zorder=7)
    _draw_ellipses(axes, position, DEPTH * across, across, angles, style)


def _draw_ellipses(
    axes: Axes, position: np.ndarray, width: np.ndarray, height: np.ndarray, angle: np.ndarray, style: dict[str, Any]
) -> None:
    """Draw ellipses at positions (N, 2) [m], of widths and heights (N,) [m], turned by angles (N,) [degrees]."""
    from matplotlib.collections import EllipseCollection

    offsets: Any = dict(units="xy", offsets=position, offset_transform=axes.transData)
    axes.add_collection(EllipseCollection(width, height, angle, **offsets, **style))


def draw_robot(axes: Axes, frames: Trajectory, situations: Sequence[str], radius: ArrayLike = ROBOT_RADIUS) -> None:
    """Draw the robot's path in the colors of situations, its start (ring), goal (target) and last pose, to scale.

    Other robots of a team have dashed paths and goals.

    Args:
        frames: (T, ...) of one episode.
        radius: m, of all robots, or (1 + R,) of the robot and the other ones.
    """
    path = np.asarray(frames.position)
    others = other_robots(frames)
    radius, *other_radii = map(float, np.broadcast_to(radius, 1 + len(others)))
    _draw_path(axes, path, step_colors(frames, situations))
    start = _point(path[0])
    goal = _point(frames.goal[-1])
    place = _point(path[-1])

    # Start and goal.
    ring: Any = dict(edgecolor=colors.ROBOT, linewidth=1.8, zorder=10)
    _draw_circle(axes, start, 0.42, facecolor=colors.PAPER, **ring)
    _draw_circle(axes, goal, 0.75, facecolor="none", **ring)
    _draw_circle(axes, goal, 0.28, facecolor=colors.ROBOT, **ring)

    # The robot at its last pose, and the other ones.
    body: Any = dict(facecolor=colors.ROBOT, edgecolor=colors.ROBOT_EDGE, linewidth=1.0, zorder=11)
    nose: Any = dict(color=colors.ROBOT_EDGE, linewidth=1.4, zorder=12)
    _draw_circle(axes, place, HALO, facecolor=colors.ROBOT, edgecolor="none", alpha=0.35, zorder=11)
    _draw_circle(axes, place, radius, **body)
    for robot, other_radius in zip(others, other_radii, strict=True):
        _draw_other_robot(axes, robot, other_radius, body, nose)
    end = path[-1]
    tip = end + 2.2 * radius * frames.heading[-1]
    axes.plot(*np.stack([end, tip], 1), **nose)


def _draw_other_robot(axes: Axes, robot: np.ndarray, radius: float, body: dict, nose: dict) -> None:
    """Draw another robot of a team (T, 6), as of ``other_robots``: path, last pose and goal."""
    line: Any = dict(linewidth=1.4, linestyle="--")
    path = robot[:, :2]
    axes.plot(*path.T, color=colors.ROBOT, zorder=8, **line)
    x, y, heading_x, heading_y, goal_x, goal_y = map(float, robot[-1])
    length = 2.2 * radius
    tip_x = x + length * heading_x
    tip_y = y + length * heading_y
    goal = goal_x, goal_y
    _draw_circle(axes, (x, y), radius, **body)
    axes.plot([x, tip_x], [y, tip_y], **nose)
    _draw_circle(axes, goal, 0.75, facecolor="none", edgecolor=colors.ROBOT, zorder=10, **line)
    _draw_circle(axes, goal, 0.28, facecolor=colors.ROBOT, edgecolor="none", zorder=10)


def _draw_path(axes: Axes, path: np.ndarray, shades: list[str]) -> None:
    """A path (T, 2) [m] in the colors of its steps, one line for each run of a color."""
    from matplotlib.collections import LineCollection

    axes.plot(*path.T, color=colors.PAPER, linewidth=5.0, solid_capstyle="round", zorder=8)
    starts = [0]
    for step in range(1, len(shades)):
        if shades[step] != shades[step - 1]:
            starts.append(step)
    ends = [*starts[1:], len(path)]
    runs = [path[max(start - 1, 0) : end] for start, end in zip(starts, ends, strict=True)]
    run_colors = [shades[start] for start in starts]
    axes.add_collection(LineCollection(runs, colors=run_colors, linewidths=3.0, zorder=9, capstyle="butt"))


def _draw_circle(axes: Axes, center: tuple[float, float], radius: float, **style: Any) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(Circle(center, radius, **style))


def _point(place: ArrayLike) -> tuple[float, float]:
    x, y = map(float, np.asarray(place))
    return x, y


def other_robots(frames: Trajectory) -> np.ndarray:
    """(R, T, 6) of the other robots of a team, as ``Trajectory.robots``; R is 0 without a team."""
    if frames.robots is None:
        return np.zeros((0, len(frames.position), 6))
    return np.asarray(frames.robots).swapaxes(0, 1)


def draw_scale(axes: Axes, environment: Environment) -> None:
    """Draw a bar of a round length below the floor's left corner."""
    x0, y0, x1, _ = map(float, np.asarray(environment.floor))
    span = x1 - x0
    max_length = max(0.15 * span, 0.5)
    lengths = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
    bar = max(length for length in lengths if length <= max_length)
    y = y0 - 0.030 * span
    tick = y + 0.008 * span
    end = x0 + bar
    axes.plot([x0, x0, end, end], [tick, y, y, tick], color=colors.MUTED, linewidth=1.1, zorder=5)
    axes.text(x0, y - 0.010 * span, f"{bar:g} m", fontsize=8, color=colors.MUTED, ha="left", va="top", zorder=5)


def draw_heat(axes: Axes, environment: Environment, density: np.ndarray, label: str) -> None:
    """Draw values (rows, columns) over the floor, row 0 at its lowest y, and a scale; the highest 3 % share a color."""
    from matplotlib.colors import LinearSegmentedColormap, PowerNorm
    from matplotlib.ticker import MaxNLocator

    x0, y0, x1, y1 = map(float, np.asarray(environment.floor))
    busy = density[density > 0]
    highest = 1.0
    if busy.size:
        highest = float(np.quantile(busy, 0.97))
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
    width = 0.38 * span
    bounds = (x1 - width, y0 - 0.034 * span, width, 0.014 * span)
    below = axes.inset_axes(bounds, transform=axes.transData)
    bar = axes.get_figure().colorbar(image, cax=below, orientation="horizontal", extend="max", ticks=MaxNLocator(3))  # pyright: ignore[reportOptionalMemberAccess]
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    below.tick_params(size=0, labelsize=7.5, labelcolor=colors.MUTED, pad=2)
    label_x = x1 - 0.40 * span
    label_y = y0 - 0.027 * span
    axes.text(label_x, label_y, label, fontsize=7.5, color=colors.MUTED, ha="right", va="center")


def draw_flow(axes: Axes, environment: Environment, graph: BehaviorGraph, flow: np.ndarray) -> None:
    """Draw a band for each walked direction of an edge, as wide as its flow, with its tip where it leads.

    Args:
        flow: (M, M) people per minute.
    """
    from matplotlib.collections import PolyCollection

    x0, y0, x1, _ = map(float, np.asarray(environment.floor))
    span = x1 - x0
    flow_max = float(flow.max(initial=0.0))
    position = np.asarray(graph.position, float)
    mean_radius = float(np.mean(graph.radius))
    widest = min(MAX_BAND[0] * mean_radius, MAX_BAND[1] * span)
    narrowest = MIN_BAND * span
    bands = []
    for u, v in np.argwhere(flow > 0):
        width = widest * float(flow[u, v]) / flow_max
        bands.append(_band(position[u], position[v], max(width, narrowest)))

    # The widest band explains the others, below the floor.
    label_y = y0 - 0.027 * span
    start = np.array([x0 + 0.19 * span, label_y + 0.5 * widest])
    end = start + np.array([0.05 * span, 0.0])
    bands.append(_band(start, end, widest))
    style: Any = dict(facecolors=colors.FLOW, edgecolors=colors.FLOOR, linewidths=0.5, alpha=0.7, zorder=4)
    collection = PolyCollection(bands, **style)
    collection.set_clip_on(False)
    axes.add_collection(collection)
    axes.plot(*position.T, linestyle="", marker="o", markersize=3.5, color=colors.FLOW_EDGE, zorder=5)
    label = f"{flow_max:.3g} people a minute"
    axes.text(x0 + 0.25 * span, label_y, label, fontsize=7.5, color=colors.MUTED, ha="left", va="center")


def _band(start: np.ndarray, end: np.ndarray, width: float) -> np.ndarray:
    """(5, 2) m corners of a band on the right of the way from start to end, with its tip at the end."""
    along = end - start
    length = max(float(np.hypot(*along)), 1e-9)
    along = along / length
    x, y = along
    right = np.array([y, -x]) * width
    tip_length = min(1.5 * width, 0.5 * length)
    tip = end - along * tip_length
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

    entries: list[tuple[Any, str]] = []
    if frames is not None:
        entries = [*_episode_marks(), *_situation_marks(frames, situations)]
    elif graph:
        entries = _graph_marks()
    if not entries:
        return

    handles, labels = zip(*entries, strict=True)
    columns = 4 if frames is None else 5
    columns = max(columns, -(-len(entries) // 3))  # three rows fit below the floor
    legend = axes.legend(
        handles, labels, loc="lower right", bbox_to_anchor=(1.0 - MARGIN, 0.0),
        ncols=columns, fontsize=7.5 if columns < 6 else 6.5,
        frameon=False, labelcolor=colors.INK, handlelength=1.1, handletextpad=0.5,
        columnspacing=1.2, borderpad=0.1, borderaxespad=0.2, labelspacing=0.35,
        handler_map={tuple: HandlerTuple(ndivide=1)},
    )  # fmt: skip
    legend.set_zorder(20)


def _episode_marks() -> list[tuple[Any, str]]:
    """Marks and labels of robot and people."""
    ring = mark("o", "none", colors.ROBOT, 8.5)
    disc = mark("o", colors.ROBOT, colors.ROBOT, 3)
    return [
        (mark("o", colors.ROBOT, colors.ROBOT_EDGE, 6.5), "robot"),
        (mark("o", colors.PAPER, colors.ROBOT, 6.5), "start"),
        ((ring, disc), "goal"),
        (mark("o", colors.PERSON, colors.PERSON_EDGE, 6.5), "person"),
        (mark("o", colors.MEMBER, colors.PERSON_EDGE, 6.5), "in a group"),
    ]


def _situation_marks(frames: Trajectory, situations: Sequence[str]) -> list[tuple[Any, str]]:
    """Lines and names of the situations that occurred."""
    from matplotlib.lines import Line2D

    names = [*situations, "none"]
    shades = [*colors.situation_colors(situations), colors.NO_SITUATION]
    marks = []
    for index in sorted(set(situation_indices(frames).tolist())):
        line = Line2D([], [], color=shades[index], linewidth=3)
        label = names[index].replace("_", " ")
        marks.append((line, label))
    return marks


def _graph_marks() -> list[tuple[Any, str]]:
    """Marks and labels of a behavior graph."""
    from matplotlib.lines import Line2D

    line: Any = dict(color=colors.EDGE, linewidth=1.2)
    return [
        (mark("o", "#e9ecf2", colors.EDGE, 8), "waypoint"),
        (mark("o", "#e2f4f9", colors.MEMBER, 8), "group"),
        (Line2D([], [], **line), "both ways"),
        (Line2D([], [], marker=">", markersize=5, **line), "one way"),
    ]

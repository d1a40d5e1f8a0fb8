"""Pictures of a scenario from above: stills, heat maps and animations (Figs. 1 and 2 of the paper); videos of cameras.

The robot is an orange square and people are discs, as in Fig. 2. x points right, y up the page, distances are metres.
Situations and policies may have any names. Nothing here touches pyplot's global state, and matplotlib is imported only
when something is drawn. This file has the stills: an episode, maps of where people are, sheets of a graph or of
handcrafted sets (IV-D).
"""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import robots
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Environment, Groups, Obstacles, Scenario, Trajectory
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.drawing import colors, gifs, layers
from sean_jax.drawing.colors import policy_colors, situation_colors
from sean_jax.drawing.gifs import animate, video
from sean_jax.graph import FLOWS, NO_EDGE, BehaviorGraph, graph_of
from sean_jax.graph.formation import formation
from sean_jax.people.handcrafted import Sets
from sean_jax.world import navigation as paths
from sean_jax.world.environment import plain_scenery

__all__ = ["animate", "congestion_map", "empty_floor", "floors_sheet", "graph_of", "graph_sheet", "handcrafted_sheet"]
__all__ += ["policy_colors", "situation_colors", "top_down", "video", "view"]

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

COLUMNS = 5  # of a sheet
PANEL = 3.2  # inches, width of a panel
TRAIL = 40.0  # s, length of people's trails
PANEL_MARGIN = 2.0  # m, shown around the points of a set
MIN_PANEL = 11.0  # m, shown from side to side at least
MAX_CORNERS = 24  # of a path that is drawn
MIN_RADIUS = 0.2  # m, of a person


def top_down(
    environment: Environment,
    *,
    graph: BehaviorGraph | None = None,
    frames: Trajectory | None = None,
    situations: Sequence[str] | None = None,
    time_step: float = 0.1,
    robot_radius: ArrayLike = layers.ROBOT_RADIUS,
    width: float = 6.4,
) -> Figure:
    """Draw an environment from above, and one episode: trails of people, their last positions, the robot's path.

    Args:
        frames: (T, ...) of one episode, or None.
        situations: names of the frames' situations; the paper's five, or numbers, if None.
        time_step: s, between two frames.
        robot_radius: m, of all robots, or (1 + R,) of the robot and the other ones of its team.

    Raises:
        InputError: the frames have a batch axis, or another number of situations.
    """
    figure, axes = layers.canvas(environment, width, "")
    layers.draw_obstacles(axes, environment)
    if graph is not None:
        layers.draw_graph(axes, graph, alone=frames is None)
    if frames is not None:
        frames = layers.one_episode(frames)
        situations = layers.situation_names(frames, situations)
        layers.draw_trails(axes, frames, round(TRAIL / time_step))
        layers.draw_people(axes, frames)
        layers.draw_robot(axes, frames, situations, robot_radius)
    layers.draw_legend(axes, graph is not None, frames, situations or ())
    layers.draw_scale(axes, environment)
    return figure


def congestion_map(
    environment: Environment,
    density: np.ndarray,
    *,
    graph: BehaviorGraph | None = None,
    flow: np.ndarray | None = None,
    title: str = "",
) -> Figure:
    """Draw people's density over the floor, and over it the edges of a graph as wide as their flow.

    Each direction of an edge has its own band, on the right as one walks. Edges without people are left out.

    Args:
        density: (rows, columns) people per m2, row 0 at the lowest y.
        flow: (M, M) people per minute from the row's node to the column's.
    """
    figure, axes = layers.canvas(environment, 6.4, title)
    layers.draw_heat(axes, environment, np.asarray(density, float), "people per m²")
    layers.draw_obstacles(axes, environment)
    if graph is not None and flow is not None:
        layers.draw_flow(axes, environment, graph, np.asarray(flow, float))
    layers.draw_scale(axes, environment)
    return figure


def view(trajectory: Trajectory, scenario: Scenario | None = None, animate: bool = False) -> Any:
    """Draw a trajectory for a notebook, with the scenario's behavior graph; on an empty floor without a scenario.

    Args:
        trajectory: (T, ...) frames; of a batch (B, T, ...) the first episode.

    Returns:
        A matplotlib ``Figure``, or with ``animate`` a moving IPython ``Image``.
    """
    frames = layers.first_episode(trajectory)
    if scenario is None:
        environment = empty_floor(frames)
        graph = None
        names = None
        time_step = 0.1
        radius = layers.ROBOT_RADIUS
    else:
        environment = scenario.environment
        graph = graph_of(scenario)
        time_step = scenario.time_step
        names = tuple(name for name, _ in scenario.situations)
        radius = robots.radii(scenario)
    options: dict[str, Any] = dict(graph=graph, situations=names, time_step=time_step, robot_radius=radius)
    if not animate:
        return top_down(environment, frames=frames, **options)
    from IPython.display import Image

    stream = io.BytesIO()
    gifs.animate(environment, frames, stream, **options)
    return Image(data=stream.getvalue(), format="gif")


def empty_floor(frames: Trajectory) -> Environment:
    """A floor without obstacles that contains all positions of the frames, with 2 m around them."""
    people = np.asarray(frames.people).reshape(-1, 2)
    robot = np.asarray(frames.position).reshape(-1, 2)
    positions = np.concatenate([people, robot])
    lower = positions.min(0) - 2.0
    upper = positions.max(0) + 2.0
    floor = jnp.asarray(np.concatenate([lower, upper]), float)
    no_numbers = jnp.zeros(0, float)
    no_vectors = jnp.zeros((0, 2), float)
    obstacles = Obstacles(center=no_vectors, half_extent=no_vectors, yaw=no_numbers, height=no_numbers)
    return Environment(
        floor=floor,
        obstacles=obstacles,
        obstacle_grid=build_obstacle_grid(obstacles, floor),
        scenery=plain_scenery(obstacles),
        name="empty floor",
    )


# ------------------------------------------------------------------ contact sheets


class _Starts(NamedTuple):
    """Where each of the H sets begins: 5 starts and goals of the robot, and N people."""

    start: Array  # (H, 5, 2) m
    goal: Array  # (H, 5, 2) m
    people: Array  # (H, N, 2) m
    people_heading: Array  # (H, N, 2) unit vector
    path: Array  # (H, 5, 5, MAX_CORNERS, 2) m, shortest paths from each start to each goal
    start_heading: Array  # (H, 5, 2) unit vector
    goal_heading: Array  # (H, 5, 2) unit vector
    leg: Array  # (H, L, K, MAX_CORNERS, 2) m, people's ways from each waypoint to the next


def handcrafted_sheet(scenario: Scenario) -> Figure:
    """Draw every handcrafted set of a scenario, one panel each: people, loops, the robot's starts, goals and paths.

    Args:
        scenario: with behavior and task ``handcrafted``.
    """
    sets: Sets = scenario.behavior.data
    starts = jax.jit(_starts)(scenario, random_streams.key("draw", 0))
    starts = jax.tree.map(np.asarray, starts)
    table = jax.tree.map(np.asarray, replace(sets, ways=None))
    floor = np.asarray(scenario.environment.floor, float)
    windows = _set_windows(floor, starts, table)

    # One panel for each set and one for the meaning of marks, as tall as the tallest window.
    aspect = max((window[3] - window[1]) / (window[2] - window[0]) for window in windows)
    title = f"Handcrafted sets: {scenario.environment.name}"
    figure, panels = _panels(len(sets.names) + 1, PANEL * aspect, title)
    for index, window in enumerate(windows):
        axes = panels[index]
        set_starts, set_table = jax.tree.map(lambda leaf, index=index: leaf[index], (starts, table))
        _draw_set(axes, scenario.environment, window, set_starts, set_table)
        present = int(table.present[index].sum())
        axes.set_title(f"{sets.names[index]}  ", fontsize=9, color=colors.INK, loc="left", pad=4)
        axes.set_title(f"{present} people", fontsize=8, color=colors.MUTED, loc="right", pad=4)
    _draw_set_key(panels[-1])
    return figure


def _panels(count: int, panel_height: float, title: str) -> tuple[Figure, list[Axes]]:
    """A figure with a title, and empty panels of a height [inches] in rows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(COLUMNS, count)
    rows = math.ceil(count / columns)
    row_height = panel_height + 0.36  # with its title
    width = columns * PANEL
    height = rows * row_height + 0.4
    figure = Figure(figsize=(width, height), facecolor=colors.PAPER)
    FigureCanvasAgg(figure)
    figure.text(0.12 / width, 1 - 0.2 / height, title, fontsize=13, color=colors.INK, weight="bold", va="center")

    panels = []
    for index in range(count):
        row, column = divmod(index, columns)
        left = column * PANEL + 0.08
        bottom = height - 0.34 - (row + 1) * row_height
        axes = figure.add_axes((left / width, bottom / height, (PANEL - 0.16) / width, panel_height / height))
        axes.set_axis_off()
        panels.append(axes)
    return figure, panels


def _set_windows(floor: np.ndarray, starts: _Starts, table: Sets) -> list[tuple[float, float, float, float]]:
    """The window of each set, which shows its starts, goals, people and waypoints."""
    windows = []
    for row in range(len(starts.start)):
        people = starts.people[row][table.present[row]]
        waypoints = table.waypoint[row][np.isfinite(table.walked[row])]
        points = np.concatenate([starts.start[row], starts.goal[row], people, waypoints])
        windows.append(_window(floor, points))
    return windows


def graph_sheet(environment: Environment, graph: BehaviorGraph) -> Figure:
    """Draw the behavior graph with its names, flows and one-way edges, and with full groups; the floor is cut to it."""
    low, high = _graph_extent(environment, graph)
    around_graph = replace(environment, floor=jnp.asarray([*low, *high], float))
    figure, axes = layers.canvas(around_graph, 9.0, f"Behavior graph: {environment.name}")
    layers.draw_obstacles(axes, environment)
    for collection in axes.collections:
        collection.set_clip_path(axes.patches[0])
    layers.draw_graph(axes, graph, alone=True)
    if len(np.asarray(graph.groups)):
        radius = 0.0035 * (high[0] - low[0])
        _draw_groups(axes, graph, max(radius, MIN_RADIUS))
    axes.legend(
        *_graph_key(graph), loc="lower right", bbox_to_anchor=(1.0 - layers.MARGIN, 0.0), ncols=3, fontsize=8,
        frameon=False, labelcolor=colors.INK, handlelength=1.4, columnspacing=1.4, borderpad=0.1, labelspacing=0.35,
    )  # fmt: skip
    layers.draw_scale(axes, around_graph)
    return figure


def _graph_extent(environment: Environment, graph: BehaviorGraph) -> tuple[np.ndarray, np.ndarray]:
    """(2,) and (2,) m, the lower left and upper right corner of the part of the floor around the graph."""
    floor = np.asarray(environment.floor, float)
    position = np.asarray(graph.position, float)
    radius = np.asarray(graph.radius, float)[:, None]
    low = (position - radius).min(0) - 6.0
    high = (position + radius).max(0) + 6.0

    # At least half as wide as high.
    min_width = 0.5 * (high[1] - low[1])
    left, right = low[0], high[0]
    low[0] = min(left, right - min_width)
    high[0] = max(right, left + min_width)
    return np.maximum(low, floor[:2]), np.minimum(high, floor[2:])


def _draw_groups(axes: Axes, graph: BehaviorGraph, radius: float) -> None:
    """Draw the members of full groups, by shoulders of that radius [m], and the places that are left open."""
    center = graph.position[graph.groups]
    key = random_streams.key("draw", 0)
    form = jax.jit(formation)(key, graph.capacity[graph.groups], center, graph.seat_group)
    seat, heading, _, opening = (np.asarray(array) for array in form)
    layers.draw_discs(axes, seat, heading, np.ones(len(seat), bool), radius, 0.7)
    axes.plot(*opening.T, linestyle="", marker="o", markersize=5, color=colors.MEMBER, fillstyle="none", zorder=6)


def floors_sheet(floors: Sequence[tuple[Environment, BehaviorGraph]]) -> Figure:
    """Draw many floors with their graphs side by side, in one scale, each with its name."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    rows = -(-len(floors) // COLUMNS)
    figure = Figure(figsize=(2.6 * COLUMNS, 2.2 * rows), layout="constrained", facecolor=colors.PAPER)
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, COLUMNS, squeeze=False).flatten()
    corners = np.array([environment.floor for environment, _ in floors], float).reshape(-1, 2, 2)
    sides = corners[:, 1] - corners[:, 0]  # (floors, 2) m
    width, height = sides.max(0, initial=0.0) + 0.4  # m, of all panels
    for axes in panels:
        axes.set_axis_off()
    for axes, (environment, graph), ((x0, y0), (x1, y1)) in zip(panels, floors, corners, strict=False):
        left = (x0 + x1 - width) / 2
        bottom = y0 - 0.2
        axes.set(xlim=(left, left + width), ylim=(bottom, bottom + height), aspect="equal")
        axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, facecolor=colors.FLOOR, edgecolor=colors.MUTED))
        layers.draw_obstacles(axes, environment)
        layers.draw_graph(axes, graph, alone=False)
        axes.set_title(environment.name.replace("_", " "), fontsize=8, color=colors.INK)
    return figure


def _starts(scenario: Scenario, key: Array) -> _Starts:
    """The starts of all sets."""
    sets: Sets = scenario.behavior.data

    def set_starts(row: Array) -> _Starts:
        # Odds of 0 for all other sets.
        is_set = jnp.arange(sets.odds.shape[0]) == row
        odds = jnp.where(is_set[:, None, None], sets.odds, 0.0)
        only_set = replace(sets, odds=odds)
        behavior = replace(scenario.behavior, data=only_set)
        people, groups, _ = scenario.behavior.reset(replace(scenario, behavior=behavior), key)

        start_group = sets.start_group[row]
        goal_group = sets.goal_group[row]
        start = _or_opening(sets.start[row], start_group, groups)
        goal = _or_opening(sets.goal[row], goal_group, groups)
        all_paths = jax.vmap(jax.vmap(_path, in_axes=(None, None, 0)), in_axes=(None, 0, None))
        return _Starts(
            start=start,
            goal=goal,
            people=people.position,
            people_heading=people.heading,
            path=all_paths(scenario.navigation, start, goal),
            start_heading=_facing(sets.start_heading[row], start_group, groups, start),
            goal_heading=_facing(sets.goal_heading[row], goal_group, groups, goal),
            leg=_legs(sets, row),
        )

    return jax.lax.map(set_starts, jnp.arange(sets.odds.shape[0], dtype=jnp.int32))


def _or_opening(place: Array, group: Array, groups: Groups) -> Array:
    """(5, 2) m, the places, or the places that groups leave open where there is one."""
    opening = groups.opening[jnp.maximum(group, 0)]
    return jnp.where(group[:, None] >= 0, opening, place)


def _legs(sets: Sets, row: Array) -> Array:
    """(L, K, MAX_CORNERS, 2) m: paths from each waypoint of a set's loops to the next one."""
    waypoint = sets.waypoint[row]
    count = sets.waypoints[row][:, None]
    next_index = jnp.arange(1, waypoint.shape[1] + 1)[None, :] % count  # (L, K)
    next_waypoint = jnp.take_along_axis(waypoint, next_index[..., None], axis=1)
    if sets.ways is None:
        share = jnp.linspace(0.0, 1.0, MAX_CORNERS)[None, None, :, None]
        return waypoint[:, :, None] + share * (next_waypoint - waypoint)[:, :, None]

    path = functools.partial(_path, sets.ways.navigation)

    def loop_legs(starts: Array, ends: Array) -> Array:
        return jax.lax.map(lambda leg: path(*leg), (starts, ends))

    return jax.vmap(loop_legs)(waypoint, next_waypoint)


def _facing(heading: Array, group: Array, groups: Groups, place: Array) -> Array:
    """(5, 2) the headings, or from a place in a group to its center."""
    inward = groups.center[jnp.maximum(group, 0)] - place
    inward = inward / jnp.sqrt((inward * inward).sum(-1, keepdims=True) + 1e-9)
    return jnp.where(group[:, None] >= 0, inward, heading)


def _path(navigation: paths.Navigation, start: Array, goal: Array) -> Array:
    """(MAX_CORNERS, 2) m: the start, each corner of the shortest path, and the goal in all other rows."""
    paths_to_goal = paths.build_paths_to_goal(navigation, goal)

    def step(place: Array, _: None) -> tuple[Array, Array]:
        return paths.next_point(navigation, place, goal, paths_to_goal), place

    _, corners = jax.lax.scan(step, start, length=MAX_CORNERS)
    return corners


def _window(floor: np.ndarray, points: np.ndarray) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max [m]: a square around points (P, 2), or the floor where it is smaller."""
    low = points.min(0) - PANEL_MARGIN
    high = points.max(0) + PANEL_MARGIN
    side = max(MIN_PANEL, *(high - low))
    lower = floor[:2]
    upper = floor[2:]
    extent = np.minimum(side, upper - lower)
    width, height = extent
    x0, y0 = np.clip((low + high - extent) / 2, lower, upper - extent)
    return x0, y0, x0 + width, y0 + height


def _draw_set(axes: Axes, environment: Environment, window: tuple, starts: _Starts, sets: Sets) -> None:
    """Draw one set: floor, obstacles, paths, loops, people, poses."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    # Sets differ in extent: marks are sized by the side of the panel, so that all panels look alike.
    x0, y0, x1, y1 = window
    side = x1 - x0
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
    axes.set_aspect("equal", anchor="N")
    axes.add_patch(Rectangle((x0, y0), side, y1 - y0, facecolor=colors.FLOOR, edgecolor=colors.MUTED, zorder=0))
    layers.draw_obstacles(axes, environment)

    # All 25 pairs of start and goal are tasks: as a thin, pale bundle, their paths do not hide the people.
    lines = list(np.asarray(starts.path).reshape(-1, *starts.path.shape[2:]))  # (25, MAX_CORNERS, 2) m
    axes.add_collection(LineCollection(lines, colors=colors.ROBOT, linewidths=0.5, alpha=0.55, zorder=3))

    # Who walks a loop against its order meets the robot head-on, so arrows show both directions.
    in_loop = sets.present & (sets.loop >= 0)
    in_both_directions = bool((sets.way[in_loop] < 0).any())
    for leg, count, walked in zip(starts.leg, sets.waypoints, sets.walked, strict=True):
        if np.isfinite(walked).any():  # padding has no length
            _draw_loop(axes, np.asarray(leg)[:count], side, in_both_directions)

    # Sets are padded to the most people, and absent ones are not where their row says.
    people = np.asarray(starts.people[sets.present])
    heading = np.asarray(starts.people_heading[sets.present])
    is_member = np.asarray(sets.group[sets.present] >= 0)
    radius = max(0.012 * side, MIN_RADIUS)
    layers.draw_discs(axes, people, heading, is_member, radius, 0.7)

    # A pose may be the open place of a group, so poses are drawn above people.
    _draw_poses(axes, starts.start, starts.start_heading, side, "s", colors.PAPER)
    _draw_poses(axes, starts.goal, starts.goal_heading, side, "o", colors.ROBOT)

    _draw_panel_scale(axes, x0 + 0.03 * side, y0 + 0.03 * side, side)


def _draw_panel_scale(axes: Axes, x: float, y: float, side: float) -> None:
    """Draw a bar of a round length at (x, y) [m] in a panel of a side [m]."""
    bar = max(length for length in (1.0, 2.0, 5.0, 10.0, 20.0) if length <= 0.3 * side)
    axes.plot([x, x + bar], [y, y], color=colors.INK, linewidth=1.4, zorder=12)
    axes.text(x, y + 0.012 * side, f"{bar:g} m", fontsize=7, color=colors.INK, va="bottom", zorder=12)


def _draw_poses(axes: Axes, position: Array, heading: Array, side: float, marker: str, face: str) -> None:
    """Draw poses of the robot, with ticks along the headings, in a panel of a side [m]."""
    from matplotlib.collections import LineCollection

    tips = position + 0.04 * side * heading
    ticks = np.stack([position, tips], 1)
    axes.add_collection(LineCollection(list(ticks), colors=colors.ROBOT_EDGE, linewidths=0.8, zorder=8))
    style: Any = dict(markerfacecolor=face, markeredgecolor=colors.ROBOT_EDGE, markeredgewidth=0.8)
    axes.plot(*position.T, linestyle="", marker=marker, markersize=4.2, zorder=9, **style)


def _draw_loop(axes: Axes, legs: np.ndarray, side: float, both: bool) -> None:
    """Draw the legs (K, P, 2) [m] of a loop, with one or two arrows in the middle of each straight one."""
    axes.plot(*legs.reshape(-1, 2).T, color=colors.TRAIL, linewidth=1.2, zorder=4, solid_joinstyle="round")
    for start, end in zip(legs[:, 0], legs[:, -1], strict=True):
        length = float(np.hypot(*(end - start)))
        if length < 0.12 * side:
            continue
        along = (end - start) / length
        middle = 0.5 * (start + end)
        from_middle = 0.02 * side + 0.03 * side * both
        for sign in (1.0, -1.0) if both else (1.0,):
            tip = middle + sign * from_middle * along
            tail = tip - 1e-2 * sign * along
            arrow = dict(arrowstyle="-|>", color=colors.TRAIL, mutation_scale=9, linewidth=0)
            axes.annotate("", xy=tuple(tip), xytext=tuple(tail), arrowprops=arrow, zorder=4)


def _graph_key(graph: BehaviorGraph) -> tuple[list, list[str]]:
    """Marks of a behavior graph and their meaning, for the flows that it has."""
    from matplotlib.lines import Line2D

    flows = {FLOWS[flow] for flow in np.unique(np.asarray(graph.flow)) if flow != NO_EDGE}
    line: Any = dict(color=colors.EDGE, linewidth=1.2)
    entries = {
        "waypoint": layers.mark("o", "#e9ecf2", colors.EDGE, 8),
        "group": layers.mark("o", "#e2f4f9", colors.MEMBER, 8),
        "member": layers.mark("o", colors.MEMBER, colors.PERSON_EDGE),
        "place left open": layers.mark("o", "none", colors.MEMBER, 5),
        "both ways": Line2D([], [], **line),
        "one way": Line2D([], [], marker=">", markersize=5, **line),
        "high flow": Line2D([], [], **line | {"linewidth": 2.6}),
        "low flow": Line2D([], [], linestyle=(0, (1, 1.6)), **line),
    }
    present = {"one way": "forward" in flows, "high flow": "high" in flows, "low flow": "low" in flows}
    entries = {name: mark for name, mark in entries.items() if present.get(name, True)}
    return list(entries.values()), list(entries)


def _draw_set_key(axes: Axes) -> None:
    """Draw the meaning of the marks."""
    from matplotlib.lines import Line2D

    entries = {
        "robot's start": layers.mark("s", colors.PAPER, colors.ROBOT_EDGE),
        "robot's goal": layers.mark("o", colors.ROBOT, colors.ROBOT_EDGE),
        "robot's shortest paths": Line2D([], [], color=colors.ROBOT, linewidth=1.0),
        "people's loop": Line2D([], [], color=colors.TRAIL, linewidth=1.4, marker=">", markersize=5),
        "person at the start": layers.mark("o", colors.PERSON, colors.PERSON_EDGE),
        "member of a group": layers.mark("o", colors.MEMBER, colors.PERSON_EDGE),
    }
    axes.legend(
        list(entries.values()), list(entries), loc="upper left", fontsize=9, frameon=False, labelcolor=colors.INK,
        handlelength=1.6, labelspacing=0.7,
    )  # fmt: skip

"""Contact sheets: all handcrafted sets of an environment (section IV-D), and its behavior graph with full groups."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import navigation as paths
from sean_jax import prng
from sean_jax.base import Array, Environment, Groups, Scenario
from sean_jax.drawing import colors, parts
from sean_jax.graph import FLOWS, NO_EDGE, BehaviorGraph
from sean_jax.graph.formation import formation
from sean_jax.handcrafted import Sets

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

COLUMNS = 5
PANEL_MARGIN = 2.0  # m, shown around the points of a set
MIN_PANEL = 11.0  # m, shown from side to side at least
MAX_CORNERS = 24  # of a path that is drawn
MIN_RADIUS = 0.2  # m, of a person


class _Starts(NamedTuple):
    """What each of the H sets begins with: 5 starts and goals of the robot, and N people."""

    start: Array  # (H, 5, 2) m
    goal: Array  # (H, 5, 2) m
    people: Array  # (H, N, 2) m
    people_heading: Array  # (H, N, 2) unit vector
    path: Array  # (H, 5, 5, MAX_CORNERS, 2) m, shortest paths from each start to each goal
    start_heading: Array  # (H, 5, 2) unit vector
    goal_heading: Array  # (H, 5, 2) unit vector
    leg: Array  # (H, L, K, MAX_CORNERS, 2) m, people's ways from each waypoint to the next


def handcrafted_sheet(scenario: Scenario, *, panel: float = 3.2, seed: int = 0) -> Figure:
    """Draw every handcrafted set of a scenario, one panel each.

    A panel shows loops with arrows, around obstacles where people walk so, people at their starts, the robot's starts
    and goals, and its shortest paths between them.

    Args:
        scenario: with behavior and task ``handcrafted``.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sets: Sets = scenario.behavior.data
    starts = jax.tree.map(np.asarray, jax.jit(_starts)(scenario, prng.key("draw", seed)))
    table = jax.tree.map(np.asarray, replace(sets, ways=None))
    floor = np.asarray(scenario.environment.floor, float)
    windows = []
    for row in range(len(sets.names)):
        people, waypoints = starts.people[row][table.present[row]], table.waypoint[row][np.isfinite(table.walked[row])]
        windows.append(_window(floor, np.concatenate([starts.start[row], starts.goal[row], people, waypoints])))
    tall = max((window[3] - window[1]) / (window[2] - window[0]) for window in windows)
    columns = min(COLUMNS, len(sets.names) + 1)
    rows = math.ceil((len(sets.names) + 1) / columns)
    size = columns * panel, rows * (panel * tall + 0.36) + 0.4
    figure = Figure(figsize=size, facecolor=colors.PAPER)
    FigureCanvasAgg(figure)
    title = f"Handcrafted sets: {scenario.environment.name}"
    figure.text(0.12 / size[0], 1 - 0.2 / size[1], title, fontsize=13, color=colors.INK, weight="bold", va="center")
    for index, window in enumerate((*windows, None)):
        row, column = divmod(index, columns)
        bottom = size[1] - 0.34 - (row + 1) * (panel * tall + 0.36)
        box = ((column * panel + 0.08) / size[0], bottom / size[1], (panel - 0.16) / size[0], panel * tall / size[1])
        axes = figure.add_axes(box)
        axes.set_axis_off()
        if window is None:
            _key(axes)
            continue
        _panel(axes, scenario.environment, window, *jax.tree.map(lambda leaf, i=index: leaf[i], (starts, table)))
        present = int(table.present[index].sum())
        axes.set_title(f"{sets.names[index]}  ", fontsize=9, color=colors.INK, loc="left", pad=4)
        axes.set_title(f"{present} people", fontsize=8, color=colors.MUTED, loc="right", pad=4)
    return figure


def graph_sheet(environment: Environment, graph: BehaviorGraph, *, width: float = 9.0, seed: int = 0) -> Figure:
    """Draw the behavior graph with its names, flows and one-way edges, and with full groups.

    Of a large floor, only the part around the graph is drawn.
    """
    floor = np.asarray(environment.floor, float)
    place, radius = np.asarray(graph.position, float), np.asarray(graph.radius, float)[:, None]
    low, high = (place - radius).min(0) - 6.0, (place + radius).max(0) + 6.0
    low[0], high[0] = min(low[0], high[0] - 0.5 * (high[1] - low[1])), max(high[0], low[0] + 0.5 * (high[1] - low[1]))
    low, high = np.maximum(low, floor[:2]), np.minimum(high, floor[2:])
    part = replace(environment, floor=jnp.asarray([*low, *high], float))
    figure, axes = parts.canvas(part, width, f"Behavior graph: {environment.name}")
    parts.draw_obstacles(axes, environment)
    for collection in axes.collections:
        collection.set_clip_path(axes.patches[0])
    parts.draw_graph(axes, graph, alone=True)
    groups = np.asarray(graph.groups)
    if len(groups):
        center = graph.position[graph.groups]
        form = jax.jit(formation)(prng.key("draw", seed), graph.capacity[graph.groups], center, graph.seat_group)
        seat, heading, _, opening = (np.asarray(part) for part in form)
        radius = max(0.0035 * (high[0] - low[0]), MIN_RADIUS)
        parts.draw_discs(axes, seat, heading, np.ones(len(seat), bool), radius, 0.7)
        axes.plot(*opening.T, linestyle="", marker="o", markersize=5, color=colors.MEMBER, fillstyle="none", zorder=6)
    axes.legend(
        *_graph_key(graph), loc="lower right", bbox_to_anchor=(1.0 - parts.MARGIN, 0.0), ncols=3, fontsize=8,
        frameon=False, labelcolor=colors.INK, handlelength=1.4, columnspacing=1.4, borderpad=0.1, labelspacing=0.35,
    )  # fmt: skip
    parts.draw_scale(axes, part)
    return figure


def _starts(scenario: Scenario, key: Array) -> _Starts:
    """The starts of all sets."""
    sets: Sets = scenario.behavior.data

    def of_set(row: Array) -> _Starts:
        own = jnp.arange(sets.odds.shape[0]) == row
        odds = jnp.where(own[:, None, None], sets.odds, 0.0)
        one_set = replace(scenario, behavior=replace(scenario.behavior, data=replace(sets, odds=odds)))
        people, groups, _ = scenario.behavior.reset(one_set, key)
        ends = []
        for place, group in ((sets.start, sets.start_group), (sets.goal, sets.goal_group)):
            index = group[row]
            ends.append(jnp.where(index[:, None] >= 0, groups.opening[jnp.maximum(index, 0)], place[row]))
        headings = [_facing(sets.start_heading[row], sets.start_group[row], groups, ends[0])]
        headings.append(_facing(sets.goal_heading[row], sets.goal_group[row], groups, ends[1]))
        all_paths = jax.vmap(jax.vmap(_path, in_axes=(None, None, 0)), in_axes=(None, 0, None))
        path = all_paths(scenario.navigation, *ends)
        leg = _legs(sets, row)
        return _Starts(ends[0], ends[1], people.position, people.heading, path, headings[0], headings[1], leg)

    return jax.lax.map(of_set, jnp.arange(sets.odds.shape[0], dtype=jnp.int32))


def _legs(sets: Sets, row: Array) -> Array:
    """(L, K, MAX_CORNERS, 2) m: ways from each waypoint of a set's loops to the next one."""
    waypoint, count = sets.waypoint[row], sets.waypoints[row][:, None]
    number = jnp.arange(1, waypoint.shape[1] + 1)[None, :] % count  # (L, K)
    following = jnp.take_along_axis(waypoint, number[..., None], axis=1)
    if sets.ways is None:
        between = jnp.linspace(0.0, 1.0, MAX_CORNERS)[None, None, :, None]
        return waypoint[:, :, None] + between * (following - waypoint)[:, :, None]
    one = functools.partial(_path, sets.ways.navigation)
    return jax.vmap(lambda a, b: jax.lax.map(lambda ends: one(*ends), (a, b)))(waypoint, following)


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

    return jax.lax.scan(step, start, length=MAX_CORNERS)[1]


def _window(floor: np.ndarray, points: np.ndarray) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max [m]: a square around points (P, 2), or the floor where it is smaller."""
    low, high = points.min(0) - PANEL_MARGIN, points.max(0) + PANEL_MARGIN
    side = max(MIN_PANEL, *(high - low))
    extent = np.minimum(side, floor[2:] - floor[:2])
    low = np.clip((low + high - extent) / 2, floor[:2], floor[2:] - extent)
    return low[0], low[1], low[0] + extent[0], low[1] + extent[1]


def _panel(axes: Axes, environment: Environment, window: tuple, starts: _Starts, sets: Sets) -> None:
    """Draw one set: floor, obstacles, paths, loops, people, poses."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    x0, y0, x1, y1 = window
    side = x1 - x0
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
    axes.set_aspect("equal", anchor="N")
    axes.add_patch(Rectangle((x0, y0), side, y1 - y0, facecolor=colors.FLOOR, edgecolor=colors.MUTED, zorder=0))
    parts.draw_obstacles(axes, environment)
    lines = list(np.asarray(starts.path).reshape(-1, *starts.path.shape[2:]))
    axes.add_collection(LineCollection(lines, colors=colors.ROBOT, linewidths=0.5, alpha=0.55, zorder=3))
    for leg, count, walked in zip(starts.leg, sets.waypoints, sets.walked, strict=True):
        if np.isfinite(walked).any():
            both = (sets.way[sets.present & (sets.loop >= 0)] < 0).any()
            _draw_loop(axes, np.asarray(leg)[:count], side, bool(both))
    present, radius = sets.present, max(0.012 * side, MIN_RADIUS)
    people, heading = starts.people[present], starts.people_heading[present]
    parts.draw_discs(axes, np.asarray(people), np.asarray(heading), np.asarray(sets.group[present] >= 0), radius, 0.7)
    tick = 0.04 * side
    for places, headings, face in (
        (starts.start, starts.start_heading, colors.PAPER),
        (starts.goal, starts.goal_heading, colors.ROBOT),
    ):
        ends = np.stack([places, places + tick * headings], 1)
        axes.add_collection(LineCollection(list(ends), colors=colors.ROBOT_EDGE, linewidths=0.8, zorder=8))
        axes.plot(
            *places.T, linestyle="", marker="s" if face == colors.PAPER else "o", markersize=4.2, zorder=9,
            markerfacecolor=face, markeredgecolor=colors.ROBOT_EDGE, markeredgewidth=0.8,
        )  # fmt: skip
    bar = max(size for size in (1.0, 2.0, 5.0, 10.0, 20.0) if size <= 0.3 * side)
    y = y0 + 0.03 * side
    axes.plot([x0 + 0.03 * side, x0 + 0.03 * side + bar], [y, y], color=colors.INK, linewidth=1.4, zorder=12)
    axes.text(x0 + 0.03 * side, y + 0.012 * side, f"{bar:g} m", fontsize=7, color=colors.INK, va="bottom", zorder=12)


def _draw_loop(axes: Axes, legs: np.ndarray, side: float, both: bool) -> None:
    """Draw the legs (K, P, 2) [m] of a loop, with one or two arrows in the middle of each straight one."""
    axes.plot(*legs.reshape(-1, 2).T, color=colors.TRAIL, linewidth=1.2, zorder=4, solid_joinstyle="round")
    for a, b in zip(legs[:, 0], legs[:, -1], strict=True):
        gap = float(np.hypot(*(b - a)))
        if gap < 0.12 * side:
            continue
        along = (b - a) / gap
        for sign in (1.0, -1.0) if both else (1.0,):
            tip = 0.5 * (a + b) + sign * (0.02 * side + 0.03 * side * both) * along
            arrow = dict(arrowstyle="-|>", color=colors.TRAIL, mutation_scale=9, linewidth=0)
            axes.annotate("", xy=tuple(tip), xytext=tuple(tip - 1e-2 * sign * along), arrowprops=arrow, zorder=4)


def _mark(shape: str, face: str, edge: str, size: float = 6) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", marker=shape, markersize=size, markerfacecolor=face, markeredgecolor=edge)


def _graph_key(graph: BehaviorGraph) -> tuple[list, list[str]]:
    """Marks of a behavior graph and their meaning; of flows, those of its edges."""
    from matplotlib.lines import Line2D

    flows = {FLOWS[flow] for flow in np.unique(np.asarray(graph.flow)) if flow != NO_EDGE}
    line: Any = dict(color=colors.EDGE, linewidth=1.2)
    entries = {
        "waypoint": _mark("o", "#e9ecf2", colors.EDGE, 8),
        "group": _mark("o", "#e2f4f9", colors.MEMBER, 8),
        "member": _mark("o", colors.MEMBER, colors.PERSON_EDGE),
        "place left open": _mark("o", "none", colors.MEMBER, 5),
        "both ways": Line2D([], [], **line),
        "one way": Line2D([], [], marker=">", markersize=5, **line),
        "high flow": Line2D([], [], **line | {"linewidth": 2.6}),
        "low flow": Line2D([], [], linestyle=(0, (1, 1.6)), **line),
    }
    present = {"one way": "forward" in flows, "high flow": "high" in flows, "low flow": "low" in flows}
    entries = {name: mark for name, mark in entries.items() if present.get(name, True)}
    return list(entries.values()), list(entries)


def _key(axes: Axes) -> None:
    """Draw the meaning of the marks."""
    from matplotlib.lines import Line2D

    entries = {
        "robot's start": _mark("s", colors.PAPER, colors.ROBOT_EDGE),
        "robot's goal": _mark("o", colors.ROBOT, colors.ROBOT_EDGE),
        "robot's shortest paths": Line2D([], [], color=colors.ROBOT, linewidth=1.0),
        "people's loop": Line2D([], [], color=colors.TRAIL, linewidth=1.4, marker=">", markersize=5),
        "person at the start": _mark("o", colors.PERSON, colors.PERSON_EDGE),
        "member of a group": _mark("o", colors.MEMBER, colors.PERSON_EDGE),
    }
    axes.legend(
        list(entries.values()), list(entries), loc="upper left", fontsize=9, frameon=False, labelcolor=colors.INK,
        handlelength=1.6, labelspacing=0.7,
    )  # fmt: skip

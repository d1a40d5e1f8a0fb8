"""Contact sheets: all handcrafted sets of an environment (section IV-D), and its behavior graph with people seated."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import chance
from sean_jax import navigation as paths
from sean_jax.base import Array, Environment, Scenario
from sean_jax.drawing import colors, parts
from sean_jax.graph import BehaviorGraph
from sean_jax.graph.formation import formation
from sean_jax.handcrafted import Sets

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 5
AROUND = 2.0  # m, shown around what a set holds
LEAST = 11.0  # m, shown at least, from side to side
BENDS = 24  # at most, of a way that is drawn


def handcrafted_sheet(scenario: Scenario, *, panel: float = 3.2, seed: int = 0) -> Figure:
    """Every handcrafted set of a scenario with behavior and task ``handcrafted``, one panel each.

    Loops with arrows, people as they start with that ``seed``, the robot's starts and goals, and its shortest ways
    between them. ``panel`` is a panel's width in inches.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sets: Sets = scenario.behavior.data
    shown = jax.tree.map(np.asarray, jax.jit(_starts)(scenario, chance.key("draw", seed)))
    table = jax.tree.map(np.asarray, sets)
    floor = np.asarray(scenario.environment.floor, float)
    windows = []
    for row in range(len(sets.names)):
        people, waypoints = shown[2][row][table.present[row]], table.waypoint[row][np.isfinite(table.walked[row])]
        windows.append(_window(floor, np.concatenate([shown[0][row], shown[1][row], people, waypoints])))
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
        _panel(axes, scenario.environment, window, jax.tree.map(lambda leaf, i=index: leaf[i], (shown, table)))
        present = int(table.present[index].sum())
        axes.set_title(f"{sets.names[index]}  ", fontsize=9, color=colors.INK, loc="left", pad=4)
        axes.set_title(f"{present} people", fontsize=8, color=colors.MUTED, loc="right", pad=4)
    return figure


def graph_sheet(environment: Environment, graph: BehaviorGraph, *, width: float = 9.0, seed: int = 0) -> Figure:
    """The behavior graph with its names, flows and one-way edges, and everybody seated who fits into its groups.

    Of a large floor, the part around the graph. ``width`` is in inches.
    """
    floor = np.asarray(environment.floor, float)
    place, radius = np.asarray(graph.position, float), np.asarray(graph.radius, float)[:, None]
    low, high = (place - radius).min(0) - 6.0, (place + radius).max(0) + 6.0
    low[0], high[0] = min(low[0], high[0] - 0.5 * (high[1] - low[1])), max(high[0], low[0] + 0.5 * (high[1] - low[1]))
    low, high = np.maximum(low, floor[:2]), np.minimum(high, floor[2:])
    part = replace(environment, floor=jnp.asarray([*low, *high], float))
    figure, axes = parts.canvas(part, width, f"Behavior graph: {environment.name}")
    parts.draw_obstacles(axes, environment)
    for drawn in axes.collections:
        drawn.set_clip_path(axes.patches[0])
    parts.draw_graph(axes, graph, alone=True)
    groups = np.asarray(graph.groups)
    if len(groups):
        center = graph.position[graph.groups]
        form = jax.jit(formation)(chance.key("draw", seed), graph.capacity[graph.groups], center, graph.seat_group)
        seat, look, _, opening = (np.asarray(part) for part in form)
        _draw_people(axes, seat, look, np.ones(len(seat), bool), 0.0035 * (high[0] - low[0]))
        axes.plot(*opening.T, linestyle="", marker="o", markersize=5, color=colors.MEMBER, fillstyle="none", zorder=6)
    axes.legend(
        *_graph_key(graph), loc="lower right", bbox_to_anchor=(1.0 - parts.MARGIN, 0.0), ncols=3, fontsize=8,
        frameon=False, labelcolor=colors.INK, handlelength=1.4, columnspacing=1.4, borderpad=0.1, labelspacing=0.35,
    )  # fmt: skip
    parts.draw_scale(axes, part)
    return figure


def _starts(scenario: Scenario, key: Array) -> tuple:
    """Of each set: starts (5, 2), goals (5, 2), people (N, 2) [m], their headings, and the ways (5, 5, BENDS, 2)."""
    sets: Sets = scenario.behavior.data

    def one(row: Array) -> tuple:
        mine = jnp.arange(sets.weight.shape[0]) == row
        weight = jnp.where(mine[:, None, None], sets.weight, 0.0)
        chosen = replace(scenario, behavior=replace(scenario.behavior, data=replace(sets, weight=weight)))
        people, groups, _ = scenario.behavior.reset(chosen, key)
        ends = []
        for place, group in ((sets.start, sets.start_group), (sets.goal, sets.goal_group)):
            index = group[row]
            ends.append(jnp.where(index[:, None] >= 0, groups.opening[jnp.maximum(index, 0)], place[row]))
        headings = [_facing(sets.start_heading[row], sets.start_group[row], groups, ends[0])]
        headings.append(_facing(sets.goal_heading[row], sets.goal_group[row], groups, ends[1]))
        every = jax.vmap(jax.vmap(_way, in_axes=(None, None, 0)), in_axes=(None, 0, None))
        ways = every(scenario.navigation, *ends)
        return *ends, people.position, people.heading, ways, *headings

    return jax.lax.map(one, jnp.arange(sets.weight.shape[0], dtype=jnp.int32))


def _facing(heading: Array, group: Array, groups: Any, place: Array) -> Array:
    """(5, 2) headings as given, or from a place in a group to its centre."""
    inward = groups.center[jnp.maximum(group, 0)] - place
    inward = inward / jnp.sqrt((inward * inward).sum(-1, keepdims=True) + 1e-9)
    return jnp.where(group[:, None] >= 0, inward, heading)


def _way(navigation: paths.Navigation, start: Array, goal: Array) -> Array:
    """(BENDS, 2) m: from the start on, each place where the shortest path bends, then the goal again and again."""
    to_goal = paths.to_goal(navigation, goal)

    def following(place: Array, _) -> tuple[Array, Array]:
        return paths.next_point(navigation, place, goal, to_goal), place

    return jax.lax.scan(following, start, length=BENDS)[1]


def _window(floor: np.ndarray, held: np.ndarray) -> tuple[float, float, float, float]:
    """x and y from and to [m]: a square around all points (P, 2) that a set holds, or the floor where it is smaller."""
    low, high = held.min(0) - AROUND, held.max(0) + AROUND
    side = max(LEAST, *(high - low))
    extent = np.minimum(side, floor[2:] - floor[:2])
    low = np.clip((low + high - extent) / 2, floor[:2], floor[2:] - extent)
    return low[0], low[1], low[0] + extent[0], low[1] + extent[1]


def _panel(axes: Axes, environment: Environment, window: tuple, held: tuple) -> None:
    """One set: floor, obstacles, ways, loops, people, poses."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    (starts, goals, people, look, ways, start_look, goal_look), sets = held
    x0, y0, x1, y1 = window
    side = x1 - x0
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
    axes.set_aspect("equal", anchor="N")
    axes.add_patch(Rectangle((x0, y0), side, y1 - y0, facecolor=colors.FLOOR, edgecolor=colors.MUTED, zorder=0))
    parts.draw_obstacles(axes, environment)
    every = list(ways.reshape(-1, *ways.shape[2:]))
    axes.add_collection(LineCollection(every, colors=colors.ROBOT, linewidths=0.5, alpha=0.55, zorder=3))
    for loop, count, walked in zip(sets.waypoint, sets.waypoints, sets.walked, strict=True):
        if np.isfinite(walked).any():
            both = (sets.way[sets.present & (sets.loop >= 0)] < 0).any()
            _draw_loop(axes, loop[:count], side, bool(both))
    there = sets.present
    _draw_people(axes, people[there], look[there], sets.group[there] >= 0, 0.012 * side)
    tick = 0.04 * side
    for places, looks, face in ((starts, start_look, colors.PAPER), (goals, goal_look, colors.ROBOT)):
        ends = np.stack([places, places + tick * looks], 1)
        axes.add_collection(LineCollection(list(ends), colors=colors.ROBOT_EDGE, linewidths=0.8, zorder=8))
        axes.plot(
            *places.T, linestyle="", marker="s" if face == colors.PAPER else "o", markersize=4.2, zorder=9,
            markerfacecolor=face, markeredgecolor=colors.ROBOT_EDGE, markeredgewidth=0.8,
        )  # fmt: skip
    bar = max(size for size in (1.0, 2.0, 5.0, 10.0, 20.0) if size <= 0.3 * side)
    y = y0 + 0.03 * side
    axes.plot([x0 + 0.03 * side, x0 + 0.03 * side + bar], [y, y], color=colors.INK, linewidth=1.4, zorder=12)
    axes.text(x0 + 0.03 * side, y + 0.012 * side, f"{bar:g} m", fontsize=7, color=colors.INK, va="bottom", zorder=12)


def _draw_loop(axes: Axes, loop: np.ndarray, side: float, both: bool) -> None:
    """A closed line with an arrow, or two, in the middle of each leg."""
    closed = np.concatenate([loop, loop[:1]])
    axes.plot(*closed.T, color=colors.TRAIL, linewidth=1.2, zorder=4, solid_joinstyle="round")
    for a, b in zip(closed[:-1], closed[1:], strict=True):
        gap = float(np.hypot(*(b - a)))
        if gap < 0.12 * side:
            continue
        along = (b - a) / gap
        for way in (1.0, -1.0) if both else (1.0,):
            tip = 0.5 * (a + b) + way * (0.02 * side + 0.03 * side * both) * along
            arrow = dict(arrowstyle="-|>", color=colors.TRAIL, mutation_scale=9, linewidth=0)
            axes.annotate("", xy=tuple(tip), xytext=tuple(tip - 1e-2 * way * along), arrowprops=arrow, zorder=4)


def _draw_people(axes: Axes, place: np.ndarray, look: np.ndarray, member: np.ndarray, radius: float) -> None:
    """Discs with a tick where each looks, at least as large as a body."""
    from matplotlib.collections import EllipseCollection, LineCollection

    radius = max(radius, 0.2)
    ends = np.stack([place, place + 1.9 * radius * look], 1)
    axes.add_collection(LineCollection(list(ends), colors=colors.PERSON_EDGE, linewidths=0.8, zorder=6))
    size = np.full(len(place), 2 * radius)
    faces = [colors.MEMBER if there else colors.PERSON for there in member]
    axes.add_collection(
        EllipseCollection(
            size, size, np.zeros_like(size), units="xy", offsets=place, offset_transform=axes.transData,
            facecolors=faces, edgecolors=colors.PERSON_EDGE, linewidths=0.7, zorder=7,
        )
    )  # fmt: skip


def _mark(shape: str, face: str, edge: str, size: float = 6) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", marker=shape, markersize=size, markerfacecolor=face, markeredgecolor=edge)


def _graph_key(graph: BehaviorGraph) -> tuple[list, list[str]]:
    """Marks of a behavior graph and what they mean; of flows, those that it has."""
    from matplotlib.lines import Line2D

    weight, place = np.asarray(graph.weight, float), np.asarray(graph.position, float)
    gap = np.linalg.norm(place[:, None] - place[None, :], axis=-1)
    joined = np.isfinite(weight) & (gap > 0)
    flow = np.minimum(weight, weight.T)[joined] / gap[joined]
    one_way = np.maximum(weight, weight.T)[joined] >= parts.ONE_WAY * np.minimum(weight, weight.T)[joined]
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
    seen = {"one way": one_way, "high flow": flow < 0.99, "low flow": ~one_way & (flow > 1.01)}
    kept = {name: mark for name, mark in entries.items() if name not in seen or seen[name].any()}
    return list(kept.values()), list(kept)


def _key(axes: Axes) -> None:
    """What the marks mean."""
    from matplotlib.lines import Line2D

    entries = {
        "robot's start": _mark("s", colors.PAPER, colors.ROBOT_EDGE),
        "robot's goal": _mark("o", colors.ROBOT, colors.ROBOT_EDGE),
        "robot's shortest ways": Line2D([], [], color=colors.ROBOT, linewidth=1.0),
        "people's loop": Line2D([], [], color=colors.TRAIL, linewidth=1.4, marker=">", markersize=5),
        "person at the start": _mark("o", colors.PERSON, colors.PERSON_EDGE),
        "member of a group": _mark("o", colors.MEMBER, colors.PERSON_EDGE),
    }
    axes.legend(
        list(entries.values()), list(entries), loc="upper left", fontsize=9, frameon=False, labelcolor=colors.INK,
        handlelength=1.6, labelspacing=0.7,
    )  # fmt: skip

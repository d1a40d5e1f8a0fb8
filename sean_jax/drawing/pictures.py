"""Stills: the environment with what happened in it, and where people spent their time."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Environment, Frame, Obstacles, Scenario
from sean_jax.drawing import animation, colors, crowds, parts
from sean_jax.graph import graph_of
from sean_jax.nearby import tabulate
from sean_jax.scenery import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def top_down(
    environment: Environment,
    *,
    graph: Any = None,
    frames: Frame | None = None,
    situations: tuple[str, ...] = tuple(colors.SITUATION_COLORS),
    time_step: float = 0.1,
    trail: float = 40.0,
    width: float = 6.4,
    title: str = "",
) -> Figure:
    """The environment from above, with what happened in it.

    ``graph`` is a behavior graph to draw below, ``frames`` the (T, ...) frames of one episode: people's trails over
    the last ``trail`` seconds, where they stood at its end, and the robot's path in the colours of the situations.
    ``width`` is in inches. Raises ValueError for frames with a batch axis: draw one episode at a time.
    """
    figure, axes = parts.canvas(environment, width, title)
    parts.draw_obstacles(axes, environment)
    if graph is not None:
        parts.draw_graph(axes, graph, alone=frames is None)
    if frames is not None:
        frames = parts.one_episode(frames)
        parts.draw_trails(axes, frames, round(trail / time_step))
        parts.draw_people(axes, frames)
        parts.draw_robot(axes, frames, situations)
    parts.draw_legend(axes, graph is not None, frames, situations)
    parts.draw_scale(axes, environment)
    return figure


def heat_map(environment: Environment, seconds: np.ndarray, *, width: float = 6.4, title: str = "") -> Figure:
    """Where people spent their time.

    ``seconds`` (rows, columns) s is the time that people spent in each of the equal cells that cover the floor,
    row 0 at its lowest y.
    """
    figure, axes = parts.canvas(environment, width, title)
    x0, y0, x1, y1 = (float(v) for v in np.asarray(environment.floor))
    density = np.asarray(seconds, float) * seconds.size / ((x1 - x0) * (y1 - y0))
    crowds.draw_heat(axes, environment, density, "person-seconds per m²")
    parts.draw_obstacles(axes, environment)
    parts.draw_scale(axes, environment)
    return figure


def view(trajectory: Frame, scenario: Scenario | None = None, animate: bool = False) -> Any:
    """A trajectory for a notebook: a matplotlib ``Figure``, or with ``animate`` a moving IPython ``Image``.

    ``trajectory`` has a leading time axis (T, ...); of a batch (B, T, ...) the first episode is shown. The behavior
    graph is drawn if the scenario has one; without a scenario, people and robot are drawn on an empty floor.
    """
    frames = trajectory
    while np.ndim(frames.active) > 1:
        frames = jax.tree.map(lambda leaf: leaf[0], frames)
    if scenario is None:
        environment, graph, names, time_step = _empty_floor(frames), None, tuple(colors.SITUATION_COLORS), 0.1
    else:
        environment, graph, time_step = scenario.environment, graph_of(scenario), scenario.time_step
        names = tuple(name for name, _ in scenario.situations)
    if not animate:
        return top_down(environment, graph=graph, frames=frames, situations=names, time_step=time_step)
    from IPython.display import Image

    stream = io.BytesIO()
    animation.animate(environment, frames, stream, graph=graph, situations=names, time_step=time_step)
    return Image(data=stream.getvalue(), format="gif")


def _empty_floor(frames: Frame) -> Environment:
    """A floor without obstacles that holds everybody's way, with 2 m around it."""
    seen = np.concatenate([np.asarray(frames.people).reshape(-1, 2), np.asarray(frames.position).reshape(-1, 2)])
    floor = jnp.asarray(np.concatenate([seen.min(0) - 2.0, seen.max(0) + 2.0]), float)
    none, pairs = jnp.zeros(0, float), jnp.zeros((0, 2), float)
    obstacles = Obstacles(center=pairs, half_extent=pairs, yaw=none, height=none)
    return Environment(
        floor=floor,
        obstacles=obstacles,
        nearby=tabulate(obstacles, floor),
        scenery=plain(obstacles),
        name="empty floor",
    )

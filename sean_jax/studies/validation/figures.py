"""Pictures of checks: people's paths through a scene, and curves beside those that others have measured."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sean_jax.drawing import colors
from sean_jax.recordings import Tracks
from sean_jax.report.figures import svg
from sean_jax.studies.scenes import Scene
from sean_jax.studies.validation.check import Curve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot", "svg", "trajectories"]

PATHS = 60  # of people who are drawn
STRIDE = 5  # moments between two points of a path
RADIUS = 0.2  # m, of the discs at the last moment that is drawn
BORDER = 1.5  # m of floor around people
NEAR = 3.0  # m from people within which corners of walls are shown
WIDTH, TALLEST = 6.4, 6.4  # inches


def trajectories(scene: Scene, tracks: Tracks) -> "Figure":
    """Walls, gates, the paths of some people, and everybody half way through the time."""
    from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
    from matplotlib.figure import Figure

    position, present = np.asarray(tracks.position, float), np.asarray(tracks.present)
    seen = position[present]
    lower, upper = (seen.min(0), seen.max(0)) if len(seen) else (np.zeros(2), np.ones(2))
    boxes = np.asarray(scene.walls).reshape(-1, 5)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * boxes[:, None, 2:4]
    cosine, sine = np.cos(boxes[:, None, 4]), np.sin(boxes[:, None, 4])
    x, y = corners[..., 0] * cosine - corners[..., 1] * sine, corners[..., 0] * sine + corners[..., 1] * cosine
    corners = np.stack([x, y], -1) + boxes[:, None, :2]
    near = corners[((corners > lower - NEAR) & (corners < upper + NEAR)).all(-1)]
    lower, upper = lower - BORDER, upper + BORDER
    lower, upper = np.min([lower, *near], axis=0), np.max([upper, *near], axis=0)
    wide, tall = upper - lower
    height = min(max(WIDTH * tall / wide, 0.8), TALLEST)
    figure = Figure(figsize=(WIDTH, height), facecolor=colors.PAPER)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.add_collection(PolyCollection(list(corners), facecolors=colors.OBSTACLE))
    gates = [gate for gate in scene.gates if np.abs(np.asarray(gate)).max() < 1e3]
    axes.add_collection(LineCollection(gates, colors=colors.FLOW, linewidths=1.6, linestyles="dashed", zorder=2))
    shown = np.linspace(0, present.shape[1] - 1, min(PATHS, present.shape[1])).astype(int)
    for person in shown:
        path = position[:, person].copy()
        path[~present[:, person]] = np.nan
        path = path[::STRIDE]
        jump = np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1) > STRIDE  # around a period
        path[jump] = np.nan
        axes.plot(*path.T, color=colors.TRAIL, linewidth=0.9, alpha=0.7, zorder=3, rasterized=True)
    there = present.any(1)
    moment = int(np.flatnonzero(there)[there.sum() // 2]) if there.any() else 0
    spots = position[moment][present[moment]]
    size = np.full(len(spots), 2 * RADIUS)
    discs = EllipseCollection(
        size, size, np.zeros_like(size), units="xy", offsets=spots, offset_transform=axes.transData,
        facecolors=colors.PERSON, edgecolors=colors.PERSON_EDGE, linewidths=0.6, zorder=4,
    )  # fmt: skip
    axes.add_collection(discs)
    if scene.robot is not None:
        place, velocity = (np.asarray(part) for part in scene.robot)
        path = place + np.array([0.0, (len(position) - 1) * tracks.time_step])[:, None] * velocity
        axes.plot(*path.T, color=colors.ROBOT, linewidth=2.0, zorder=5)
    return figure


def plot(curves: Sequence[Curve], axes: tuple[str, str]) -> "Figure":
    """Curves of all models, and grey those that others have measured.

    Args:
        curves: one or more.
        axes: quantity and unit along x and y.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained", facecolor=colors.PAPER)
    axis = figure.add_subplot()
    names = list(dict.fromkeys(curve.name for curve in curves if not curve.reference))
    shades = dict(zip(names, colors.policy_colors(names), strict=True))
    for curve in curves:
        color = colors.MUTED if curve.reference else shades[curve.name]
        axis.plot(
            curve.x,
            curve.y,
            color=color,
            linestyle="none" if curve.points else "--" if curve.reference else "-",
            marker="o" if curve.points or not curve.reference else "",
            markersize=4,
            linewidth=1.6,
            label=curve.name,
        )
    axis.set_xlabel(axes[0], color=colors.MUTED)
    axis.set_ylabel(axes[1], color=colors.MUTED)
    axis.tick_params(colors=colors.MUTED)
    axis.set_facecolor(colors.PAPER)
    axis.grid(True, color="#e4e8ef", linewidth=0.8)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    axis.legend(frameon=False)
    return figure

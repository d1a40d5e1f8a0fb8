"""Pictures of ``sean validate``: the paths of people between walls, and curves of models beside measured ones."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from sean_jax.drawing import colors
from sean_jax.people.recordings import Tracks
from sean_jax.studies.scenes import Scene
from sean_jax.studies.validation.checks import Curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PATHS = 60  # maximum number of drawn people
STRIDE = 5  # moments between two points of a path
RADIUS = 0.2  # m, of people
BORDER = 1.5  # m of floor around people
NEAR = 3.0  # m from people within which walls are shown
FAR = 1e3  # m, from where on gates are not drawn
WIDTH = 6.4  # inches
TALLEST = 6.4  # inches
LOWEST = 0.8  # inches


def extent(places: Float[np.ndarray, "K 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (2,) [m] around places; of the unit square without any."""
    if not len(places):
        return np.zeros(2), np.ones(2)
    return places.min(0), places.max(0)


def wall_corners(walls: Float[np.ndarray, "W 5"]) -> Float[np.ndarray, "W 4 2"]:
    """The corners [m] of the walls of a scene."""
    walls = np.asarray(walls, float).reshape(-1, 5)
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    sides = signs * walls[:, None, 2:4]  # (W, 4, 2)
    cosine = np.cos(walls[:, None, 4])
    sine = np.sin(walls[:, None, 4])
    x = sides[..., 0] * cosine - sides[..., 1] * sine
    y = sides[..., 0] * sine + sides[..., 1] * cosine
    return np.stack([x, y], -1) + walls[:, None, :2]


def trajectories(scene: Scene, tracks: Tracks) -> "Figure":
    """Walls, gates, the paths of some people, and everybody half way through the time."""
    position = np.asarray(tracks.position, float)
    present = np.asarray(tracks.present)
    corners = wall_corners(scene.walls)
    lower, upper = _view(position[present], corners)
    axes = _floor(lower, upper)

    _draw_plan(axes, scene, corners)
    _draw_paths(axes, position, present)
    _draw_people(axes, _middle_moment(position, present))
    if scene.robot is not None:
        times = np.array([0.0, (len(position) - 1) * tracks.time_step])
        axes.plot(*scene.robot_path(times).T, color=colors.ROBOT, linewidth=2.0, zorder=5)
    return axes.figure  # pyright: ignore[reportReturnType]


def _view(places: Float[np.ndarray, "K 2"], corners: Float[np.ndarray, "W 4 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (2,) [m] of a picture: people with a border, and the corners of walls near them."""
    lower, upper = extent(places)
    is_near = (corners > lower - NEAR) & (corners < upper + NEAR)
    near = corners[is_near.all(-1)]  # (K, 2) m
    lower = np.min([lower - BORDER, *near], axis=0)
    upper = np.max([upper + BORDER, *near], axis=0)
    return lower, upper


def _floor(lower: np.ndarray, upper: np.ndarray) -> "Axes":
    """Axes in metres without a frame, in a figure of their shape."""
    from matplotlib.figure import Figure

    wide, tall = upper - lower
    height = min(max(WIDTH * tall / wide, LOWEST), TALLEST)
    figure = Figure(figsize=(WIDTH, height), facecolor=colors.PAPER)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes


def _draw_plan(axes: "Axes", scene: Scene, corners: Float[np.ndarray, "W 4 2"]) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    walls = PolyCollection(list(corners), facecolors=colors.OBSTACLE)
    axes.add_collection(walls)
    gates = [gate for gate in scene.gates if np.abs(np.asarray(gate)).max() < FAR]
    lines = LineCollection(gates, colors=colors.FLOW, linewidths=1.6, linestyles="dashed", zorder=2)
    axes.add_collection(lines)


def _draw_paths(axes: "Axes", position: Float[np.ndarray, "T N 2"], present: np.ndarray) -> None:
    people = present.shape[1]
    drawn = np.linspace(0, people - 1, min(PATHS, people)).astype(int)
    for person in drawn:
        path = np.where(present[:, person, None], position[:, person], np.nan)
        path = path[::STRIDE]
        step = np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1)
        path[step > STRIDE] = np.nan  # around a period
        axes.plot(*path.T, color=colors.TRAIL, linewidth=0.9, alpha=0.7, zorder=3, rasterized=True)


def _middle_moment(position: Float[np.ndarray, "T N 2"], present: np.ndarray) -> Float[np.ndarray, "K 2"]:
    """The places of everybody at the middle one of the moments with people; none without."""
    moments = np.flatnonzero(present.any(1))
    moment = moments[len(moments) // 2] if len(moments) else 0
    return position[moment][present[moment]]


def _draw_people(axes: "Axes", places: Float[np.ndarray, "K 2"]) -> None:
    from matplotlib.collections import EllipseCollection

    size = np.full(len(places), 2 * RADIUS)
    style = dict(facecolors=colors.PERSON, edgecolors=colors.PERSON_EDGE, linewidths=0.6, zorder=4)
    people = EllipseCollection(
        size, size, np.zeros_like(size), units="xy", offsets=places, offset_transform=axes.transData, **style
    )
    axes.add_collection(people)


def plot(curves: Sequence[Curve], labels: tuple[str, str]) -> "Figure":
    """Curves of all models, and in grey reference curves, with the quantities and units of both axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained", facecolor=colors.PAPER)
    axes = figure.add_subplot()
    names = list(dict.fromkeys(curve.name for curve in curves if not curve.reference))
    shades = dict(zip(names, colors.policy_colors(names), strict=True))
    for curve in curves:
        if curve.reference:
            color = colors.MUTED
            line = "--"
            marker = ""
        else:
            color = shades[curve.name]
            line = "-"
            marker = "o"
        if curve.points:
            line = "none"
            marker = "o"

        style: Any = dict(color=color, linestyle=line, marker=marker, markersize=4, linewidth=1.6)
        axes.plot(curve.x, curve.y, label=curve.name, **style)

    axes.set_xlabel(labels[0], color=colors.MUTED)
    axes.set_ylabel(labels[1], color=colors.MUTED)
    axes.tick_params(colors=colors.MUTED)
    axes.set_facecolor(colors.PAPER)
    axes.grid(True, color="#e4e8ef", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    return figure

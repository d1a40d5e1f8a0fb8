"""A picture of an imported robot: its shapes from the side and from above, beside its numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sean_jax.core.messages import shorten
from sean_jax.robots.foreign_links import LinkShape
from sean_jax.robots.importing import ImportedRobot, outline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def robot_sheet(robot: ImportedRobot) -> Figure:
    """The matplotlib figure of an imported robot."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    figure = Figure(figsize=(13, 5), layout="compressed")
    side, above, text = figure.subplots(1, 3, width_ratios=(1, 1, 1.9))

    # Nearer shapes hide others: those to the right, and those higher up.
    from_left = sorted(robot.shapes, key=lambda shape: -shape.place[1])
    from_below = sorted(robot.shapes, key=lambda shape: shape.place[2])
    _draw_shapes(side, from_left, (0, 2), title="from the right", ylabel="z [m]")
    _draw_shapes(above, from_below, (0, 1), title="from above", ylabel="y left [m]")
    side.axhline(0.0, color="#555555", lw=1)
    above.add_patch(Circle((0.0, 0.0), robot.radius, fill=False, ec="#cc1133", ls="--", lw=1.2, label="radius"))
    above.plot([0.0], [0.0], "+", color="#cc1133", ms=9, label="origin")
    above.autoscale_view()
    above.legend(loc="upper right", fontsize=8, frameon=False)
    _draw_numbers(text, robot)
    figure.suptitle(robot.path.stem, fontsize=12)
    return figure


def _draw_shapes(axes: Axes, shapes: list[LinkShape], columns: tuple[int, int], title: str, ylabel: str) -> None:
    """Draw shapes one over the other, by two of their coordinates."""
    for shape in shapes:
        _draw_outline(axes, shape, columns)
    axes.set(aspect="equal", title=title, xlabel="x ahead [m]", ylabel=ylabel)
    axes.autoscale_view()
    axes.margins(0.08)


def _draw_numbers(axes: Axes, robot: ImportedRobot) -> None:
    """Write the numbers of a robot and where they are from, one in a row."""
    axes.set_axis_off()
    rows = [list(row) for row in robot.numbers]
    rows.append(["MJX, 3 s drive", f"{1e3 * robot.gap:.2g} mm", "to its closed form"])
    rows.append(["without inertia", f"{1e3 * robot.lag:.2g} mm", "at the end of that drive"])
    for index, (name, value, source) in enumerate(rows):
        y = 1.0 - (index + 0.5) / max(len(rows), 14)
        axes.text(0.0, y, name, fontsize=9, va="center", color="#444444", transform=axes.transAxes)
        axes.text(0.36, y, shorten(value, 26), fontsize=9, va="center", weight="bold", transform=axes.transAxes)
        axes.text(0.64, y, shorten(source, 48), fontsize=7.5, va="center", color="#666666", transform=axes.transAxes)


def _draw_outline(axes: Axes, shape: LinkShape, columns: tuple[int, int]) -> None:
    from matplotlib.patches import Polygon
    from scipy.spatial import ConvexHull, QhullError

    points = outline(shape)[:, list(columns)]
    if shape.kind == "sphere":
        angle = 2 * np.pi * np.arange(32) / 32
        points = shape.place[list(columns)] + shape.size[0] * np.stack([np.cos(angle), np.sin(angle)], -1)
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:  # flat, seen from its edge
        pass
    axes.add_patch(Polygon(points, fc=shape.color, ec="#222222", lw=0.6, alpha=0.8))

"""Figures of the experiments: Table I's bars, sweeps over V and people, Figure 4's grids. SVG for pages, and PNG."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import matplotlib.colors
import numpy as np
from matplotlib.figure import Figure

from sean_jax import writing
from sean_jax.drawing import colors
from sean_jax.experiments import shares
from sean_jax.experiments.options import BEHAVIORS, Experiment
from sean_jax.report.figures import svg

if TYPE_CHECKING:
    from sean_jax.experiments.claims import Found
    from sean_jax.experiments.table1 import Cell


def shades() -> list[str]:
    """One color for each situation."""
    return colors.situation_colors(shares.NAMES)


def _figure(width: float, height: float, rows: int, columns: int) -> tuple[Figure, Any]:
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": colors.MUTED}):
        figure = Figure(figsize=(width, height), layout="constrained", facecolor=colors.PAPER)
        axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.set_facecolor(colors.PAPER)
        each.tick_params(colors=colors.MUTED)
        for side in ("top", "right"):
            each.spines[side].set_visible(False)
    return figure, axes


def shown(figure: Figure, name: str) -> str:
    """The figure for a page."""
    return f"<figure>{svg(figure, name)}</figure>"


def save(folder: Path, figures: dict[str, Figure]) -> None:
    """Each as a picture of its name."""
    for name, figure in figures.items():
        with writing.whole(folder / f"{name}.png") as stream:
            figure.savefig(stream, dpi=110, format="png", metadata={"Software": None})


def table1(options: Experiment, cells: list[Cell], swept: list[Cell]) -> dict[str, Figure]:
    """What there is to draw of Table I, by name."""
    figures = {"table1-bars": bars(cells)}
    if len(options.speeds) > 1:
        figures["table1-speeds"] = speeds(options, cells)
    if swept:
        figures["table1-crowds"] = crowds(cells, swept)
    return figures


def bars(cells: list[Cell]) -> Figure:
    """Shares of each driver and behavior as bars with intervals, and the paper's as ticks."""
    drivers = list(dict.fromkeys(cell.driver for cell in cells))
    figure, axes = _figure(3.6 * len(BEHAVIORS), 2.1 * len(drivers) + 0.3, len(drivers), len(BEHAVIORS))
    for cell in cells:
        spot = axes[drivers.index(cell.driver), BEHAVIORS.index(cell.behavior)]
        found = cell.shares()
        low, high = shares.interval(found.multi)
        value = 100 * found.multi[0]
        x = np.arange(5)
        spot.bar(x, value, 0.7, color=shades())
        ends = [np.maximum(value - 100 * low, 0), np.maximum(100 * high - value, 0)]
        spot.errorbar(x, value, ends, fmt="none", ecolor=colors.INK, elinewidth=1.1, capsize=2)
        printed = np.array(shares.PAPER[cell.behavior])
        spot.hlines(printed, x - 0.42, x + 0.42, color=colors.INK, lw=1.4, linestyles=(0, (2, 1)))
        spot.set_xticks(x, [name.replace("_", "\n") for name in shares.NAMES], fontsize=7.5)
        spot.set_ylim(0, 100)
        spot.set_title(f"{cell.behavior} · {cell.driver}", loc="left", fontsize=9.5, color=colors.INK)
        spot.text(0.03, 0.97, f"entropy {found.entropy()[0]:.2f}\npaper {shares.normalised_entropy(printed):.2f}",
                  transform=spot.transAxes, ha="left", va="top", fontsize=8, color=colors.MUTED)  # fmt: skip
    for row in axes:
        row[0].set_ylabel("% of examples", color=colors.MUTED)
    return figure


def speeds(options: Experiment, cells: list[Cell]) -> Figure:
    """Entropy and share of cross path against the walking speed V, of each behavior; lines are drivers."""
    drivers = list(dict.fromkeys(cell.driver for cell in cells))
    figure, axes = _figure(10.8, 2.8, 1, 2)
    kinds: dict[str, str] = dict(
        zip(BEHAVIORS, (colors.FLOW, colors.ROBOT, colors.SITUATION_COLORS["join_group"]), strict=True)
    )
    styles = ("-", "--", ":", "-.")
    for cell in cells:
        found = [cell.shares(index) for index in range(len(options.speeds))]
        style = styles[drivers.index(cell.driver) % len(styles)]
        label = f"{cell.behavior} · {cell.driver}"
        order = np.argsort(options.speeds)
        x = np.array(options.speeds)[order]
        for spot, values in (
            (axes[0, 0], [each.entropy()[0] for each in found]),
            (axes[0, 1], [100 * each.multi[0, 0] for each in found]),
        ):
            spot.plot(x, np.array(values)[order], style, color=kinds[cell.behavior], marker="o", ms=3, label=label)
    for spot, name in zip(axes[0], ("normalised entropy", "cross path, % of examples"), strict=True):
        spot.set_title(name, loc="left", fontsize=9.5, color=colors.INK)
        spot.set_xlabel("V, m/s", color=colors.MUTED)
        spot.set_ylim(bottom=0)
    axes[0, 1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def crowds(cells: list[Cell], swept: list[Cell]) -> Figure:
    """Entropy and share of each situation against the number of people, random and graph, one driver."""
    first = [cell for cell in cells if cell.driver == swept[0].driver]
    kinds = list(dict.fromkeys(cell.behavior for cell in swept))
    figure, axes = _figure(5.0 * len(kinds), 2.8, 1, len(kinds))
    for spot, behavior in zip(axes[0], kinds, strict=True):
        chosen = sorted((c for c in [*first, *swept] if c.behavior == behavior), key=lambda cell: cell.people)
        people, found = [cell.people for cell in chosen], [cell.shares() for cell in chosen]
        for k, (name, shade) in enumerate(zip(shares.NAMES, shades(), strict=True)):
            values = [100 * each.multi[0, k] for each in found]
            spot.plot(people, values, color=shade, marker="o", ms=3, label=name.replace("_", " "))
        spot.plot(people, [100 * each.entropy()[0] for each in found], ":", color=colors.INK, label="100 x entropy")
        spot.set_title(f"{behavior} · {swept[0].driver}", loc="left", fontsize=9.5, color=colors.INK)
        spot.set_xlabel("people", color=colors.MUTED)
        spot.set_ylim(0, 100)
    axes[0, 0].set_ylabel("% of examples", color=colors.MUTED)
    axes[0, -1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def grids(found: Found) -> Figure:
    """Figure 4: for each measure, scenarios down and policies across; violations by situation below."""
    names = list(found.MEASURES)
    figure, axes = _figure(3.2 * 5, 5.6, 2, 5)
    for spot, name in zip(axes[0], names, strict=False):
        values = np.array([[found.cells[p][b][name].mean for p in found.policies] for b in BEHAVIORS])
        _grid(spot, values, found.policies, found.MEASURES[name])
    waits = np.array([[found.waiting[p][b].mean for p in found.policies] for b in BEHAVIORS])
    _grid(axes[0][len(names)], waits, found.policies, "time not moving of completed, s")
    by = np.array([[found.by_situation[p][b].mean for p in found.policies] for b in BEHAVIORS])
    for k, (spot, situation) in enumerate(zip(axes[1], shares.NAMES, strict=True)):
        _grid(spot, by[:, :, k], found.policies, f"violations, {situation.replace('_', ' ')}", top=float(by.max()))
    return figure


def _grid(spot: Any, values: np.ndarray, policies: tuple[str, ...], title: str, top: float | None = None) -> None:
    shade = matplotlib.colors.LinearSegmentedColormap.from_list("", ["#eef3fa", colors.FLOW, colors.FLOW_EDGE])
    most = max(float(values.max()) if top is None else top, 1e-9)
    spot.imshow(values, cmap=shade, vmin=0, vmax=most, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        ink = "#ffffff" if value > 0.45 * most else colors.INK
        told = f"{value:g}" if value == round(value) else f"{value:.{2 if value < 9.995 else 1}f}"
        spot.text(column, row, told, ha="center", va="center", color=ink, fontsize=9)
    spot.set_xticks(range(len(policies)), policies)
    spot.set_yticks(range(len(BEHAVIORS)), [name[:1].upper() for name in BEHAVIORS])
    spot.set_title(title, loc="left", fontsize=9, color=colors.INK)
    for side in ("left", "bottom"):
        spot.spines[side].set_visible(False)

"""Figures of the experiments, as SVG and PNG: Table I's bars, sweeps, Figure 4's grids, and G's learning curve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import matplotlib.colors
import numpy as np
from matplotlib.figure import Figure

from sean_jax.drawing import colors
from sean_jax.io import writing
from sean_jax.studies.experiments import shares
from sean_jax.studies.experiments.measures import MEASURES
from sean_jax.studies.experiments.shares import BEHAVIORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sean_jax.config import Table1Config
    from sean_jax.studies.experiments.measures import Curve, Results, Variant
    from sean_jax.studies.experiments.ranks import Row
    from sean_jax.studies.experiments.shares import Cell


def shades() -> list[str]:
    """One color for each situation."""
    return colors.situation_colors(shares.NAMES)


def _figure(width: float, height: float, rows: int, columns: int) -> tuple[Figure, np.ndarray]:
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": colors.MUTED}):
        figure = Figure(figsize=(width, height), layout="constrained", facecolor=colors.PAPER)
        axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.set_facecolor(colors.PAPER)
        each.tick_params(colors=colors.MUTED)
        for side in ("top", "right"):
            each.spines[side].set_visible(False)
    return figure, axes


def save(folder: Path, figures: dict[str, Figure]) -> None:
    """Write figures, by name of the file without its ending, as PNG files.

    Raises:
        WriteError: another process writes one of the files.
    """
    for name, figure in figures.items():
        with writing.atomic_file(folder / f"{name}.png") as stream:
            figure.savefig(stream, dpi=110, format="png", metadata={"Software": None})


def table1(options: Table1Config, cells: list[Cell], swept: list[Cell]) -> dict[str, Figure]:
    """The figures of Table I, by name of the file without its ending; sweeps are drawn if the options have them."""
    if not cells:
        return {}
    figures = {"table1-bars": bars(cells)}
    if len(options.speeds) > 1:
        figures["table1-speeds"] = speeds(options, cells)
    if swept:
        figures["table1-crowds"] = crowds(cells, swept)
    return figures


def bars(cells: list[Cell]) -> Figure:
    """Shares of each policy and behavior as bars with intervals, and the paper's as ticks."""
    policies = list(dict.fromkeys(cell.policy for cell in cells))
    figure, axes = _figure(3.6 * len(BEHAVIORS), 2.1 * len(policies) + 0.3, len(policies), len(BEHAVIORS))
    for cell in cells:
        spot = axes[policies.index(cell.policy), BEHAVIORS.index(cell.behavior)]
        estimate = cell.shares()
        flags = estimate.of("flags")
        low, high = shares.interval(flags)
        value = 100 * flags[0]
        x = np.arange(5)
        spot.bar(x, value, 0.7, color=shades())
        ends = [np.maximum(value - 100 * low, 0), np.maximum(100 * high - value, 0)]
        spot.errorbar(x, value, ends, fmt="none", ecolor=colors.INK, elinewidth=1.1, capsize=2)
        reference = 100 * shares.paper()[cell.behavior]
        spot.hlines(reference, x - 0.42, x + 0.42, color=colors.INK, lw=1.4, linestyles=(0, (2, 1)))
        spot.set_xticks(x, [name.replace("_", "\n") for name in shares.NAMES], fontsize=7.5)
        spot.set_ylim(0, 100)
        spot.set_title(f"{cell.behavior} · {cell.policy}", loc="left", fontsize=9.5, color=colors.INK)
        spot.text(0.03, 0.97, f"entropy {estimate.entropy()[0]:.2f}\npaper {shares.normalised_entropy(reference):.2f}",
                  transform=spot.transAxes, ha="left", va="top", fontsize=8, color=colors.MUTED)  # fmt: skip
    for row in axes:
        row[0].set_ylabel("% of flags", color=colors.MUTED)
    return figure


def speeds(options: Table1Config, cells: list[Cell]) -> Figure:
    """Entropy and share of cross path by the walking speed V; one line for each behavior and policy."""
    policies = list(dict.fromkeys(cell.policy for cell in cells))
    figure, axes = _figure(10.8, 2.8, 1, 2)
    kinds: dict[str, str] = dict(
        zip(BEHAVIORS, (colors.FLOW, colors.ROBOT, colors.SITUATION_COLORS["join_group"]), strict=True)
    )
    styles = ("-", "--", ":", "-.")
    for cell in cells:
        estimates = [cell.shares(index) for index in range(len(options.speeds))]
        style = styles[policies.index(cell.policy) % len(styles)]
        label = f"{cell.behavior} · {cell.policy}"
        order = np.argsort(options.speeds)
        x = np.array(options.speeds)[order]
        for spot, values in (
            (axes[0, 0], [each.entropy()[0] for each in estimates]),
            (axes[0, 1], [100 * each.examples[0, 0] for each in estimates]),
        ):
            spot.plot(x, np.array(values)[order], style, color=kinds[cell.behavior], marker="o", ms=3, label=label)
    for spot, name in zip(axes[0], ("normalised entropy", "cross path, % of examples"), strict=True):
        spot.set_title(name, loc="left", fontsize=9.5, color=colors.INK)
        spot.set_xlabel("V, m/s", color=colors.MUTED)
        spot.set_ylim(bottom=0)
    axes[0, 1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def crowds(cells: list[Cell], swept: list[Cell]) -> Figure:
    """Entropy and share of each situation by the number of people, for one policy."""
    first = [cell for cell in cells if cell.policy == swept[0].policy]
    kinds = list(dict.fromkeys(cell.behavior for cell in swept))
    figure, axes = _figure(5.0 * len(kinds), 2.8, 1, len(kinds))
    for spot, behavior in zip(axes[0], kinds, strict=True):
        selection = sorted((c for c in [*first, *swept] if c.behavior == behavior), key=lambda cell: cell.people)
        people, estimates = [cell.people for cell in selection], [cell.shares() for cell in selection]
        for k, (name, shade) in enumerate(zip(shares.NAMES, shades(), strict=True)):
            values = [100 * each.examples[0, k] for each in estimates]
            spot.plot(people, values, color=shade, marker="o", ms=3, label=name.replace("_", " "))
        spot.plot(people, [100 * each.entropy()[0] for each in estimates], ":", color=colors.INK, label="100 x entropy")
        spot.set_title(f"{behavior} · {swept[0].policy}", loc="left", fontsize=9.5, color=colors.INK)
        spot.set_xlabel("people", color=colors.MUTED)
        spot.set_ylim(0, 100)
    axes[0, 0].set_ylabel("% of examples", color=colors.MUTED)
    axes[0, -1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def ablation(by_world: dict[str, list[Cell]], references: dict[str, str]) -> Figure:
    """Change of the shares of flags in each world from its reference, in points, means over the policies."""
    worlds = [world for world in by_world if world != references[world]]

    def mean(world: str, behavior: str) -> np.ndarray:
        chosen = [cell.shares() for cell in by_world[world] if cell.behavior == behavior]
        flags = np.mean([each.of("flags")[0] for each in chosen], 0)
        return 100 * np.append(flags, np.mean([each.entropy()[0] for each in chosen]))

    figure, axes = _figure(3.4 * len(BEHAVIORS) + 1.2, 0.3 * len(worlds) + 1.5, 1, len(BEHAVIORS))
    names = [*(name.replace("_", "\n") for name in shares.NAMES), "100 x\nentropy"]
    for spot, behavior in zip(axes[0], BEHAVIORS, strict=True):
        values = np.stack([mean(world, behavior) - mean(references[world], behavior) for world in worlds])
        shades = [colors.ROBOT, colors.PAPER, colors.FLOW]
        _heat(spot, values, shades, (-30, 30), lambda value: (f"{value:+.0f}", colors.INK), 8)
        spot.set_xticks(range(len(names)), names, fontsize=7)
        spot.set_yticks(range(len(worlds)), worlds if spot is axes[0, 0] else [""] * len(worlds))
        spot.set_title(behavior, loc="left", fontsize=9.5, color=colors.INK)
    return figure


def _heat(
    spot: Axes,
    values: np.ndarray,
    shades: list[str],
    limits: tuple[float, float],
    text: Callable[[float], tuple[str, str]],
    size: float,
) -> None:
    """A matrix as colored cells without a frame; ``text`` gives a cell's text and its color."""
    shade = matplotlib.colors.LinearSegmentedColormap.from_list("", shades)
    spot.imshow(values, cmap=shade, vmin=limits[0], vmax=limits[1], aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        words, ink = text(value)
        spot.text(column, row, words, ha="center", va="center", color=ink, fontsize=size)
    for side in ("left", "bottom"):
        spot.spines[side].set_visible(False)


def grids(results: Results) -> Figure:
    """Figure 4: a grid of scenarios and policies for each measure; below or beside it, violations in each situation."""
    policies = list(results.values)
    wide = len(policies) > 8  # then names and numbers need the width of half a page
    size = (2 * (0.42 * len(policies) + 0.6), 11.0, 5, 2) if wide else (16.0, 5.6, 2, 5)
    figure, axes = _figure(*size)
    several, by_situation = axes.T if wide else axes

    def values(cell: Callable[[str, str], np.ndarray]) -> np.ndarray:
        return np.array([[cell(policy, behavior) for policy in policies] for behavior in BEHAVIORS])

    for spot, name in zip(several, MEASURES, strict=False):
        _grid(spot, values(lambda p, b, name=name: results.cells[p][b][name].mean), policies, MEASURES[name])
    _grid(several[-1], values(lambda p, b: results.waiting[p][b].mean), policies, "time not moving of completed, s")
    by = values(lambda p, b: results.by_situation[p][b].mean)
    for k, (spot, situation) in enumerate(zip(by_situation, shares.NAMES, strict=True)):
        _grid(spot, by[:, :, k], policies, f"violations, {situation.replace('_', ' ')}", top=float(by.max()))
    return figure


def _grid(spot: Axes, values: np.ndarray, policies: Sequence[str], title: str, top: float | None = None) -> None:
    scale = max(float(values.max()) if top is None else top, 1e-9)

    def text(value: float) -> tuple[str, str]:
        words = f"{value:g}" if value == round(value) else f"{value:.{2 if value < 9.995 else 1}f}"
        return words, "#ffffff" if value > 0.45 * scale else colors.INK

    _heat(spot, values, ["#eef3fa", colors.FLOW, colors.FLOW_EDGE], (0, scale), text, 9)
    spot.set_xticks(range(len(policies)), policies)
    if max(map(len, policies)) > 2:  # names and folders of further drivers
        spot.set_xticks(range(len(policies)), policies, rotation=50, ha="right", rotation_mode="anchor", fontsize=7)
    spot.set_yticks(range(len(BEHAVIORS)), [name[:1].upper() for name in BEHAVIORS])
    spot.set_title(title, loc="left", fontsize=9, color=colors.INK)


def learning_curve(curve: Curve) -> Figure:
    """Measures by hours of demonstrations: a line with intervals, and points for other rates and for flags.

    A row for each measure, and a column for each scenario and their mean.
    """
    names = {"completed": "completed, %", "time_not_moving": "not moving, s", "violations": "violations"}
    plain = [each for each in curve.variants if each.rate == 1 and not each.flags]
    apart = [each for each in curve.variants if each not in plain]
    places = list(curve.cells[plain[0].name])
    marks = "s^Dv"
    shade = [colors.ROBOT, colors.SITUATION_COLORS["join_group"], colors.FLOW_EDGE, colors.INK]
    figure, axes = _figure(2.9 * len(places), 2.2 * len(names) + 0.4, len(names), len(places))
    for (row, column), spot in np.ndenumerate(axes):
        measure, place = list(names)[row], places[column]

        def draw(several: list[Variant], shift: float, spot=spot, place=place, measure=measure, **style) -> None:
            cells = [curve.cells[each.name][place][measure] for each in several]
            mean = np.array([cell.mean for cell in cells])
            ends = [np.maximum(mean - [cell.low for cell in cells], 0), np.maximum([c.high for c in cells] - mean, 0)]
            hours = np.array([each.hours for each in several]) * shift
            spot.errorbar(hours, mean, ends, capsize=2, ms=4, elinewidth=1.1, **style)

        draw(plain, 1.0, fmt="-o", color=colors.FLOW, label="1 Hz")
        for k, each in enumerate(apart):
            label = each.title.partition(" h ")[2]
            draw([each], 1.15 ** (k + 1), fmt=marks[k % len(marks)], color=shade[k % len(shade)], label=label)
        spot.set_xscale("log")
        hours = [each.hours for each in plain]
        spot.set_xticks(hours, [f"{each:g}" for each in hours])
        spot.minorticks_off()
        spot.margins(x=0.1)
        every = [cell[measure] for by in curve.cells.values() for cell in by.values()]  # all of a row alike
        low = min(float(cell.low) for cell in every) if measure == "completed" else 0.0
        high = max(float(cell.high) for cell in every)
        spot.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low) + 1e-3)
        if row == 0:
            spot.set_title(
                place if place not in BEHAVIORS else f"in {place}", loc="left", fontsize=9.5, color=colors.INK
            )
        if row == len(names) - 1:
            spot.set_xlabel("hours of demonstrations", color=colors.MUTED)
        if column == 0:
            spot.set_ylabel(names[measure], color=colors.MUTED)
    axes[0, -1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def situations(rows: Sequence[Row]) -> Figure:
    """Violations a minute in each situation of the entries of a ranking, with intervals."""
    figure, axes = _figure(9.0, 2.6, 1, 1)
    spot, x = axes[0, 0], np.arange(len(shares.NAMES))
    width = 0.8 / len(rows)
    for number, row in enumerate(rows):
        at = x + (number - (len(rows) - 1) / 2) * width
        value, low, high = row.violations[:3]
        ends = [np.maximum(value - low, 0), np.maximum(high - value, 0)]
        color = matplotlib.colormaps["viridis"](number / max(len(rows) - 1, 1) * 0.9)
        spot.errorbar(at, value, ends, fmt="o", ms=4, capsize=2, color=color, label=row.entry.name)
    spot.set_xticks(x, [name.replace("_", " ") for name in shares.NAMES])
    spot.set_ylim(bottom=0)
    spot.set_ylabel("a minute", color=colors.MUTED)
    spot.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure

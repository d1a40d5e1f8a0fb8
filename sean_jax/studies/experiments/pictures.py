"""Figures of the experiments, as SVG and PNG: Table I's bars, sweeps, Figure 4's grids, and G's learning curve."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import matplotlib.colors
import numpy as np
from matplotlib.figure import Figure

from sean_jax.drawing import colors
from sean_jax.io import writing
from sean_jax.studies.experiments import shares
from sean_jax.studies.experiments.measures import MEAN, MEASURES, WAITING
from sean_jax.studies.experiments.results_table import ALL
from sean_jax.studies.experiments.shares import BEHAVIORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

    from sean_jax.metrics import Estimate
    from sean_jax.studies.experiments.measures import Variant
    from sean_jax.studies.experiments.ranks import RankingRow
    from sean_jax.studies.experiments.results_table import Estimates
    from sean_jax.studies.experiments.shares import Shares, Tables


STYLE: Any = {
    "font.size": 9,
    "figure.facecolor": colors.PAPER,
    "axes.facecolor": colors.PAPER,
    "axes.edgecolor": colors.MUTED,
    "axes.labelcolor": colors.MUTED,
    "axes.titlecolor": colors.INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": colors.MUTED,
    "ytick.color": colors.MUTED,
    "legend.fontsize": 7,
    "legend.frameon": False,
}


styled: Any = matplotlib.rc_context(STYLE)  # a decorator of what draws a figure


def shades() -> list[str]:
    """One color for each situation."""
    return colors.situation_colors(shares.NAMES)


def _figure(width: float, height: float, rows: int, columns: int) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(folder: Path, figures: dict[str, Figure]) -> None:
    """Write figures, by name of the file without its ending, as PNG files.

    Raises:
        WriteError: another process writes one of the files.
    """
    for name, figure in figures.items():
        with writing.atomic_file(folder / f"{name}.png") as stream:
            figure.savefig(stream, dpi=110, format="png", metadata={"Software": None})


def table1(speeds: Sequence[str], cells: Shares, swept: Shares) -> dict[str, Figure]:
    """The figures of Table I, by name of the file without its ending; sweeps are drawn if there are any.

    Args:
        speeds: walking speeds in words, the first of which is the table's.
        cells: (policy, behavior, people, speed) -> shares.
        swept: (policy, behavior, people) -> shares with other numbers of people.
    """
    if not cells:
        return {}
    first = {}
    for (*cell, speed), values in cells.items():
        if speed == speeds[0]:
            first[tuple(cell)] = values
    figures = {"table1-bars": bars(first)}
    if len(speeds) > 1:
        figures["table1-speeds"] = by_speed(speeds, cells)
    if swept:
        figures["table1-crowds"] = crowds(first, swept)
    return figures


def _ends(mean: ArrayLike, low: ArrayLike, high: ArrayLike) -> list[np.ndarray]:
    """The lengths of the lines of an interval, below and above the mean."""
    below = np.subtract(mean, low)
    above = np.subtract(high, mean)
    return [np.maximum(below, 0), np.maximum(above, 0)]


def _entropies(samples: Sequence[np.ndarray]) -> list[float]:
    """The normalised entropy of the shares of each cell."""
    return [shares.entropy(values)[0] for values in samples]


def _situation_names(space: str) -> list[str]:
    """The names of situations, with ``space`` between their words."""
    return [name.replace("_", space) for name in shares.NAMES]


def _legend(axes: Axes) -> None:
    """A legend to the right of the axes."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


@styled
def bars(cells: Shares) -> Figure:
    """Shares of each policy and behavior as bars with intervals, and the paper's as ticks."""
    policies = list(dict.fromkeys(policy for policy, *_ in cells))
    width = 3.6 * len(BEHAVIORS)
    height = 2.1 * len(policies) + 0.3
    figure, grid = _figure(width, height, len(policies), len(BEHAVIORS))
    x = np.arange(5)
    for (policy, behavior, _), samples in cells.items():
        axes = grid[policies.index(policy), BEHAVIORS.index(behavior)]
        flags = shares.counted(samples)
        low, high = shares.interval(flags)
        value = 100 * flags[0]
        axes.bar(x, value, 0.7, color=shades())
        ends = _ends(value, 100 * low, 100 * high)
        axes.errorbar(x, value, ends, fmt="none", ecolor=colors.INK, elinewidth=1.1, capsize=2)

        paper = 100 * shares.paper()[behavior]
        dashes = (0, (2, 1))
        axes.hlines(paper, x - 0.42, x + 0.42, color=colors.INK, lw=1.4, linestyles=dashes)
        entropy = shares.entropy(samples)[0]
        entropies = f"entropy {entropy:.2f}\npaper {shares.normalised_entropy(paper):.2f}"
        axes.set_xticks(x, _situation_names("\n"), fontsize=7.5)
        axes.set_ylim(0, 100)
        axes.set_title(f"{behavior} · {policy}")
        corner = {"transform": axes.transAxes, "ha": "left", "va": "top"}
        axes.text(0.03, 0.97, entropies, fontsize=8, color=colors.MUTED, **corner)
    for row in grid:
        row[0].set_ylabel("% of flags")
    return figure


@styled
def by_speed(speeds: Sequence[str], cells: Shares) -> Figure:
    """Entropy and share of cross path by the walking speed V; one line for each behavior and policy."""
    figure, ((entropies, cross_paths),) = _figure(10.8, 2.8, 1, 2)
    palette = colors.FLOW, colors.ROBOT, colors.SITUATION_COLORS["join_group"]
    shade = dict(zip(BEHAVIORS, palette, strict=True))
    styles = ("-", "--", ":", "-.")
    policies = list(dict.fromkeys(policy for policy, *_ in cells))
    ordered = sorted(speeds, key=float)
    x = np.array([float(speed) for speed in ordered])
    for policy, behavior, people in dict.fromkeys(labels[:3] for labels in cells):
        samples = [cells[policy, behavior, people, speed] for speed in ordered]
        style = styles[policies.index(policy) % len(styles)]
        line = {"color": shade[behavior], "marker": "o", "ms": 3, "label": f"{behavior} · {policy}"}
        cross_path = [100 * values[0, 0] for values in samples]
        entropies.plot(x, _entropies(samples), style, **line)
        cross_paths.plot(x, cross_path, style, **line)
    for axes, title in ((entropies, "normalised entropy"), (cross_paths, "cross path, % of examples")):
        axes.set_title(title)
        axes.set_xlabel("V, m/s")
        axes.set_ylim(bottom=0)
    _legend(cross_paths)
    return figure


@styled
def crowds(cells: Shares, swept: Shares) -> Figure:
    """Entropy and share of each situation by the number of people, for one policy."""
    policy = next(iter(swept))[0]
    behaviors = list(dict.fromkeys(behavior for _, behavior, _ in swept))
    figure, (row,) = _figure(5.0 * len(behaviors), 2.8, 1, len(behaviors))
    for axes, behavior in zip(row, behaviors, strict=True):
        selection = []
        for labels, values in [*cells.items(), *swept.items()]:
            if labels[:2] == (policy, behavior):
                selection.append((labels[2], values))
        selection.sort(key=lambda people_and_values: people_and_values[0])
        people, samples = zip(*selection, strict=True)

        for k, (name, shade) in enumerate(zip(_situation_names(" "), shades(), strict=True)):
            values = [100 * sample[0, k] for sample in samples]
            axes.plot(people, values, color=shade, marker="o", ms=3, label=name)
        entropies = [100 * entropy for entropy in _entropies(samples)]
        axes.plot(people, entropies, ":", color=colors.INK, label="100 x entropy")
        axes.set_title(f"{behavior} · {policy}")
        axes.set_xlabel("people")
        axes.set_ylim(0, 100)
    row[0].set_ylabel("% of examples")
    _legend(row[-1])
    return figure


@styled
def ablation(tables: Tables, references: Mapping[str, str]) -> Figure:
    """Change of the shares of flags in each world from its reference, in points, means over the policies."""
    worlds = [world for world in tables if world != references[world]]
    width = 3.4 * len(BEHAVIORS) + 1.2
    height = 0.3 * len(worlds) + 1.5
    figure, (row,) = _figure(width, height, 1, len(BEHAVIORS))

    names = [*_situation_names("\n"), "100 x\nentropy"]
    shades = [colors.ROBOT, colors.PAPER, colors.FLOW]
    for axes, behavior in zip(row, BEHAVIORS, strict=True):
        changes = []
        for world in worlds:
            reference = _mean_shares(tables, references[world], behavior)
            changes.append(_mean_shares(tables, world, behavior) - reference)
        _heat(axes, np.stack(changes), shades, (-30, 30), lambda value: (f"{value:+.0f}", colors.INK), 8)
        axes.set_xticks(range(len(names)), names, fontsize=7)
        labels = worlds if axes == row[0] else [""] * len(worlds)
        axes.set_yticks(range(len(worlds)), labels)
        axes.set_title(behavior)
    return figure


def _mean_shares(tables: Tables, world: str, behavior: str) -> np.ndarray:
    """(6,) percent, the shares of flags and the entropy in a world, means over the policies."""
    samples = [by_behavior[behavior] for by_behavior in tables[world].values()]
    flags = np.mean([shares.counted(values)[0] for values in samples], 0)
    entropy = np.mean(_entropies(samples))
    return 100 * np.append(flags, entropy)


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


@styled
def grids(policies: Sequence[str], estimates: Estimates) -> Figure:
    """Figure 4: a grid of scenarios and policies for each measure; below or beside it, violations in each situation."""
    if len(policies) > 8:  # names and numbers need the width of half a page
        width = 2 * (0.42 * len(policies) + 0.6)
        figure, axes = _figure(width, 11.0, 5, 2)
        several, by_situation = axes.T
    else:
        figure, axes = _figure(16.0, 5.6, 2, 5)
        several, by_situation = axes

    def means(measure: str, situation: str = ALL) -> np.ndarray:
        rows = []
        for behavior in BEHAVIORS:
            rows.append([estimates[policy, behavior, measure, situation].mean for policy in policies])
        return np.array(rows)

    titles = {**MEASURES, WAITING: "time not moving of completed, s"}
    for spot, (measure, title) in zip(several, titles.items(), strict=True):
        _grid(spot, means(measure), policies, title)
    violations = {situation: means("violations", situation) for situation in shares.NAMES}
    top = max(float(values.max()) for values in violations.values())
    for spot, (situation, values) in zip(by_situation, violations.items(), strict=True):
        _grid(spot, values, policies, f"violations, {situation.replace('_', ' ')}", top)
    return figure


def _grid(spot: Axes, values: np.ndarray, policies: Sequence[str], title: str, top: float | None = None) -> None:
    if top is None:
        top = float(values.max())
    scale = max(top, 1e-9)

    def text(value: float) -> tuple[str, str]:
        ink = "#ffffff" if value > 0.45 * scale else colors.INK
        if value == round(value):
            return f"{value:g}", ink
        if value < 9.995:
            return f"{value:.2f}", ink
        return f"{value:.1f}", ink

    _heat(spot, values, ["#eef3fa", colors.FLOW, colors.FLOW_EDGE], (0, scale), text, 9)
    spot.set_xticks(range(len(policies)), policies)
    if max(map(len, policies)) > 2:  # names and folders of further drivers
        spot.set_xticks(range(len(policies)), policies, rotation=50, ha="right", rotation_mode="anchor", fontsize=7)
    spot.set_yticks(range(len(BEHAVIORS)), [name[:1].upper() for name in BEHAVIORS])
    spot.set_title(title, fontsize=9)


@styled
def learning_curve(variants: Sequence[Variant], estimates: Estimates) -> Figure:
    """Measures by hours of demonstrations: a line with intervals, and points for other rates and for flags.

    A row for each measure, and a column for each scenario and their mean.
    """
    names = {"completed": "completed, %", "time_not_moving": "not moving, s", "violations": "violations"}
    columns = (*BEHAVIORS, MEAN)
    width = 2.9 * len(columns)
    height = 2.2 * len(names) + 0.4
    figure, grid = _figure(width, height, len(names), len(columns))
    for row, (measure, name) in zip(grid, names.items(), strict=True):
        low, high = _limits(estimates, measure)
        border = 0.05 * (high - low)
        for axes, behavior in zip(row, columns, strict=True):
            by_variant = {variant.name: estimates[variant.name, behavior, measure] for variant in variants}
            _variants(axes, variants, by_variant)
            axes.set_ylim(low - border, high + border + 1e-3)
        row[0].set_ylabel(name)
    for axes, behavior in zip(grid[0], columns, strict=True):
        axes.set_title(f"in {behavior}" if behavior in BEHAVIORS else behavior)
    for axes in grid[-1]:
        axes.set_xlabel("hours of demonstrations")
    _legend(grid[0, -1])
    return figure


def _limits(estimates: Estimates, measure: str) -> tuple[float, float]:
    """The ends of the axis of a measure, equal in all scenarios."""
    intervals = [value for (_, _, name), value in estimates.items() if name == measure]
    low = 0.0
    if measure == "completed":
        low = min(float(value.low) for value in intervals)
    high = max(float(value.high) for value in intervals)
    return low, high


def _variants(axes: Axes, variants: Sequence[Variant], estimates: Mapping[str, Estimate]) -> None:
    """A line of the amounts of demonstrations, and a mark for each other variant."""
    shades = [colors.ROBOT, colors.SITUATION_COLORS["join_group"], colors.FLOW_EDGE, colors.INK]
    marks = "s^Dv"

    def draw(chosen: Sequence[Variant], shift: float, **style: Any) -> None:
        values = [estimates[variant.name] for variant in chosen]
        mean, low, high = np.array([value[:3] for value in values]).T
        hours = np.array([variant.hours for variant in chosen]) * shift
        axes.errorbar(hours, mean, _ends(mean, low, high), capsize=2, ms=4, elinewidth=1.1, **style)

    plain = [variant for variant in variants if variant.is_plain]
    draw(plain, 1.0, fmt="-o", color=colors.FLOW, label="1 Hz")
    others = (variant for variant in variants if not variant.is_plain)
    for k, variant in enumerate(others):
        mark = marks[k % len(marks)]
        shade = shades[k % len(shades)]
        label = variant.title.partition(" h ")[2]
        draw([variant], 1.15 ** (k + 1), label=label, fmt=mark, color=shade)
    hours = [variant.hours for variant in plain]
    axes.set_xscale("log")
    axes.set_xticks(hours, [f"{value:g}" for value in hours])
    axes.minorticks_off()
    axes.margins(x=0.1)


@styled
def situations(rows: Sequence[RankingRow]) -> Figure:
    """Violations a minute in each situation of the entries of a ranking, with intervals."""
    figure, ((axes,),) = _figure(9.0, 2.6, 1, 1)
    x = np.arange(len(shares.NAMES))
    width = 0.8 / len(rows)
    shades = matplotlib.colormaps["viridis"]
    for number, row in enumerate(rows):
        shifted = x + (number - (len(rows) - 1) / 2) * width
        ends = _ends(*row.violations[:3])
        color = shades(number / max(len(rows) - 1, 1) * 0.9)
        style: Any = {"fmt": "o", "ms": 4, "capsize": 2, "color": color}
        axes.errorbar(shifted, row.violations.mean, ends, label=row.entry.name, **style)
    axes.set_xticks(x, _situation_names(" "))
    axes.set_ylim(bottom=0)
    axes.set_ylabel("a minute")
    _legend(axes)
    return figure

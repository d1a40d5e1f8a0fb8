"""The output of ``sean bench``: lines of a table, notes on memory and scaling, and a picture of three panels."""

import os
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from sean_jax.bench.cases import Row, Setup
from sean_jax.drawing import colors

HEAD = f"{'part':<9}{'B':>7}{'people':>8}{'pixels':>9}{'devices':>8}{'per second':>13}  {'of':<27}{'us a call':>11}" + (
    f"{'compile s':>11}{'KiB a scenario':>16}"
)


def title(setup: Setup) -> str:
    """Name the machine and the scenario."""
    return (
        f"{setup['device']} ({setup['devices']}), jax {setup['versions']['jax']}; {setup['environment']}, "
        f"{setup['people']} people, {setup['robot']} ({setup['dynamics']})"
    )


def line(row: Row) -> str:
    """Format a row to stand under ``HEAD``.

    Returns:
        One line, as long as ``HEAD``.
    """
    pixels = str(row.pixels) if row.pixels else "-"
    kib = "-" if np.isnan(row.scenario_bytes) else f"{row.scenario_bytes / 1024:.1f}"
    return (
        f"{row.part:<9}{row.batch:7d}{row.people:8d}{pixels:>9}{row.devices:8d}{row.per_second:13.4g}  {row.what:<27}"
        f"{row.microseconds:11.0f}{row.compile_seconds:11.1f}{kib:>16}"
    )


def notes(rows: list[Row], setup: Setup) -> list[str]:
    """Estimate the largest batch that fits into memory, and compare several devices with one."""
    lines = []
    for part, name in (("step", "without images"), ("depth", "with a depth image each")):
        largest = max((row for row in rows if row.part == part), key=lambda row: row.batch, default=None)
        if largest is not None and setup["memory"] and largest.scenario_bytes > 0:
            number = int(setup["memory"] / largest.scenario_bytes)
            lines.append(
                f"memory: {largest.scenario_bytes / 1024:.0f} KiB a scenario {name} at B = {largest.batch}; "
                f"about {number:.2g} would fit into {setup['memory'] / 2**30:.0f} GiB."
            )
    scaling = [row for row in rows if row.part == "devices"]
    for row in scaling[1:]:
        share = row.per_second / scaling[0].per_second
        lines.append(f"{row.devices} devices: {share:.2f} times one ({100 * share / row.devices:.0f} % of each).")
    return lines


def memory() -> int:
    """Bytes of memory of the first device, or of the machine for a CPU; 0 if unknown."""
    import jax

    stats = jax.devices()[0].memory_stats() or {}
    if stats.get("bytes_limit"):
        return int(stats["bytes_limit"])
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0


def picture(rows: list[Row], setup: Setup) -> Figure:
    """Plot throughput by batch, the cost of an agent-step by people, and the cost of an image by pixels.

    Args:
        rows: of the table; a panel without rows says so.
    """
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": colors.MUTED, "svg.fonttype": "none"}):
        figure = Figure(figsize=(12.5, 4.2), layout="constrained", facecolor="white")
        left, middle, right = figure.subplots(1, 3)
    figure.suptitle(title(setup), fontsize=10, color=colors.INK)
    for part, name, shade in (
        ("step", "step", colors.SITUATION_COLORS["down_path"]),
        ("depth", "step + depth 64x48", colors.SITUATION_COLORS["cross_path"]),
        ("images", "depth images 64x48", colors.SITUATION_COLORS["join_group"]),
    ):
        chosen = [row for row in rows if row.part == part and row.pixels in (0, 64 * 48)]
        chosen = sorted({row.batch: row for row in chosen}.values(), key=lambda row: row.batch)
        _curve(left, [row.batch for row in chosen], [row.per_second for row in chosen], name, shade)
    _label(left, "throughput", "scenarios at once (B)", "per second")
    crowds = [row for row in rows if row.part == "crowd"]
    for name, shade, pick in (("one crowd", colors.MUTED, min), ("many at once", colors.FLOW, max)):
        best = {n: pick((row.batch, row) for row in crowds if row.people == n)[1] for n in {r.people for r in crowds}}
        chosen = [best[n] for n in sorted(best)]
        _curve(middle, [row.people for row in chosen], [1e9 / row.per_second for row in chosen], name, shade)
    _label(middle, "crowd alone, 32 walls", "people (N)", "ns per agent-step")
    for part, name, shade in (
        ("images", "depth", colors.SITUATION_COLORS["join_group"]),
        ("pictures", "color", colors.ROBOT),
    ):
        best: dict[int, Row] = {}
        for row in (row for row in rows if row.part == part):
            if row.pixels not in best or row.per_second > best[row.pixels].per_second:
                best[row.pixels] = row
        chosen = [best[pixels] for pixels in sorted(best)]
        _curve(right, [row.pixels for row in chosen], [1e6 / row.per_second for row in chosen], name, shade)
    _label(right, "images, best B", "pixels", "µs per image")
    return figure


def _curve(axes: Axes, x: Sequence[float], y: Sequence[float], name: str, shade: str) -> None:
    if x:
        axes.loglog(x, y, marker="o", ms=4, lw=1.6, color=shade, label=name)
        axes.annotate(_short(y[-1]), (x[-1], y[-1]), textcoords="offset points", xytext=(0, 6), ha="right", color=shade)


def _label(axes: Axes, name: str, across: str, up: str) -> None:
    axes.set_title(name, loc="left", color=colors.INK)
    axes.set_xlabel(across, color=colors.MUTED)
    axes.set_ylabel(up, color=colors.MUTED)
    axes.grid(True, which="major", color="#e4e8ef", lw=0.8)
    axes.set_axisbelow(True)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(_short))
        axis.set_minor_formatter(NullFormatter())
    axes.tick_params(colors=colors.MUTED)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if axes.lines:
        axes.legend(frameon=False, loc="best")
    else:
        axes.text(0.5, 0.5, "not measured", transform=axes.transAxes, ha="center", color=colors.MUTED)


def _short(value: float, _: int | None = None) -> str:
    """The value with three digits and a unit prefix, such as 6.92M."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"

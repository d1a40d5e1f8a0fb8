"""``sean bench``: the speed of everything on this machine, as a table, as JSON and as a picture."""

import dataclasses
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from rich.console import Console

from sean_jax.cli.bench import programs
from sean_jax.cli.bench.programs import Program, measure
from sean_jax.config import BenchConfig, ScenarioConfig, validate
from sean_jax.config.flags import command
from sean_jax.core.data_types import Scenario
from sean_jax.core.errors import IncompleteError
from sean_jax.drawing import colors
from sean_jax.io import writing
from sean_jax.io.versions import versions
from sean_jax.simulation import making
from sean_jax.simulation.scenario_stack import Stack

__all__ = ["run"]

IMAGE = 64, 48  # pixels of the image of a step
SIZES = (16, 12), (32, 24), (64, 48), (160, 120), (320, 240), (640, 480)
CROWDS = 62, 200, 1000, 10_000  # people
HEAD = (
    f"{'part':<9}{'B':>7}{'people':>7}{'pixels':>7}{'devices':>8}{'per second':>11}  {'of':<15}{'us a call':>9}"
    f"{'compile s':>10}{'KiB each':>9}"
)


@dataclasses.dataclass(frozen=True)
class Measurement:
    """One row of the table."""

    part: str  # a key of ``CASES``
    what: str  # the unit, such as "scenario-steps"
    batch: int  # scenarios at once
    people: int
    pixels: int  # of an image, 0 for none
    devices: int
    per_second: float  # units; for the part "compile" the seconds themselves
    microseconds: float  # of one call for the whole batch
    compile_seconds: float
    scenario_bytes: float  # state and temporary memory of one scenario


def run(options: BenchConfig, console: Console) -> Path:
    """Time the parts that the options name, and write table.txt, bench.json and bench.png.

    The table is written after each row, so Ctrl-C or a kill loses at most the row under way.

    Raises:
        InputError: the options name a scenario that does not exist or a folder that is not empty.
        WriteError: the folder cannot be written.
        IncompleteError: the disk is full.
        KeyboardInterrupt: Ctrl-C came before the first row, or before the picture was complete.
    """
    folder = options.folder()
    writing.check_new_folder(folder)
    with writing.folder_lock(folder):
        writing.check_new_folder(folder)
        with console.status("preparing the scenario"):
            stack, setup = _prepare(options)
        rows: list[Measurement] = []
        _print(console, title(setup), HEAD)
        try:
            for part in options.parts:
                with console.status(f"compiling and timing: {part}"):
                    for row in CASES[part](options, stack):
                        rows.append(row)
                        _print(console, line(row))
                        _save(folder, rows, setup)
        except KeyboardInterrupt:
            if not rows:
                raise
            _print(console, "stopped; what was measured until then is written.")
        except OSError as error:
            raise _broken(folder, error) from error
        _print(console, *notes(rows, setup))
        try:
            with writing.atomic_file(folder / "bench.png") as stream:
                picture(rows, setup).savefig(stream, dpi=150, format="png")
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"stopped before the picture was drawn; the table is in {folder}.") from None
        except OSError as error:
            raise _broken(folder, error) from error
    return folder


def _broken(folder: Path, error: OSError) -> IncompleteError:
    kept = f"what was measured until then is in {folder}" if writing.contents(folder) else "nothing was written"
    return IncompleteError(f"{writing.broken(error)}; {kept}.")


def _save(folder: Path, rows: list[Measurement], setup: dict[str, Any]) -> None:
    """Write table.txt and bench.json of the rows so far; NaN becomes null."""
    lines = [title(setup), HEAD, *map(line, rows), *notes(rows, setup)]
    writing.write(folder / "table.txt", "\n".join(lines) + "\n")

    finite = []
    for row in rows:
        values = dataclasses.asdict(row)
        finite.append({key: None if value != value else value for key, value in values.items()})
    content = json.dumps({**setup, "rows": finite}, indent=2, allow_nan=False)
    writing.write(folder / "bench.json", content + "\n")


def _prepare(options: BenchConfig) -> tuple[Stack[Scenario], dict[str, Any]]:
    """The scenario on each floor, and the setup of the measurement: machine and scenario, as in bench.json."""
    choices = {name: getattr(options, name) for name in ("environment", "people", "robot", "dynamics")}
    stack = making.build(making.plan_scenario(validate(ScenarioConfig, choices)))[0]
    scenario = stack.member
    return stack, {
        "command": command("bench", options),
        "device": jax.devices()[0].device_kind,
        "devices": jax.device_count(),
        "memory": memory(),
        "environment": options.environment,
        "floors": stack.size,
        "people": scenario.people,
        "robot": options.robot.kind,
        "dynamics": options.dynamics,
        "time_step": scenario.time_step,
        "crowd_steps": scenario.substeps,
        "versions": versions(),
    }


def memory() -> int:
    """Bytes of memory of the first device, or of the machine for a CPU; 0 if unknown."""
    stats = jax.devices()[0].memory_stats() or {}
    if stats.get("bytes_limit"):
        return int(stats["bytes_limit"])
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0


def _print(console: Console, *lines: str) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)


# ------------------------------------------------------------------ what is timed


def on_cpu() -> bool:
    """Whether there is no accelerator."""
    return jax.devices()[0].platform == "cpu"


def batches(options: BenchConfig) -> tuple[int, ...]:
    """Sizes of the batches: from the options, or the default of the device."""
    return options.batches or ((1, 16, 64, 256) if on_cpu() else (1, 64, 1024, 8192, 32768, 65536))


def turns(batch: int) -> int:
    """Control steps in one call, 2 to 200: enough to hide the cost of the call, few enough to take seconds."""
    return int(np.clip((4e3 if on_cpu() else 4e5) / batch, 2, 200))


def _fitting(stack: Stack[Scenario], batch: int) -> tuple[Stack[Scenario], int]:
    """The floors of a batch, the first ones of a small batch, and its size, rounded up to a multiple of them."""
    number = min(stack.size, batch)
    stack = stack if number == stack.size else stack.take(np.arange(number))
    return stack, -(-batch // number) * number


def _row(
    options: BenchConfig, part: str, what: str, batch: int, people: int, program: Program, pixels: int = 0,
    devices: int = 1,
) -> Measurement:  # fmt: skip
    """Time a program of a batch."""
    figures = measure(program, options.repeats, options.seconds)
    scenario_bytes = figures.pop("bytes") / batch
    return Measurement(part, what, batch, people, pixels, devices, scenario_bytes=scenario_bytes, **figures)


def steps(
    options: BenchConfig, stack: Stack[Scenario], part: str = "step", image: tuple[int, int] | None = None
) -> Iterator[Measurement]:
    """Time the whole step with restarts; with an ``image``, one depth image of that size for each scenario."""
    for size in batches(options):
        some, batch = _fitting(stack, size)
        program = programs.stepping(some, batch, turns(batch), image)
        pixels = image[0] * image[1] if image else 0
        yield _row(options, part, "scenario-steps", batch, stack.member.people, program, pixels)


def images(options: BenchConfig, stack: Stack[Scenario], part: str, camera: str, what: str) -> Iterator[Measurement]:
    """Time images alone, by size of the image; those of the part ``images`` by batch as well."""
    most = max(batches(options))
    pixels = most * IMAGE[0] * IMAGE[1]
    cases: list[tuple[int, int, int]] = []
    if part == "images":
        cases += [(batch, *IMAGE) for batch in batches(options)]
    else:
        pixels //= 8

    # Of larger images there are fewer at once.
    for width, height in SIZES:
        batch = max(1, min(most, pixels // (width * height)))
        cases.append((batch, width, height))

    for size, width, height in dict.fromkeys(cases):
        some, batch = _fitting(stack, size)
        pixels_a_run = 1e6 if on_cpu() else 1e9
        often = int(np.clip(pixels_a_run / (batch * width * height), 1, 200))
        program = programs.images(some, camera, batch, width, height, often)
        yield _row(options, part, what, batch, stack.member.people, program, width * height)


def crowd(options: BenchConfig, stack: Stack[Scenario]) -> Iterator[Measurement]:
    """Time the social forces alone, in a hall with 32 walls, by number of people and of crowds at once."""
    totals = (2**14,) if on_cpu() else (2**19, 2**21)
    for people in CROWDS:
        for batch in sorted({1, *(max(1, total // people) for total in totals)}):
            number = int(np.clip((2e5 if on_cpu() else 2e8) / (batch * people), 2, 40)) // 2 * 2
            yield _row(options, "crowd", "agent-steps", batch, people, programs.crowd(people, batch, number))


def compiling(options: BenchConfig, stack: Stack[Scenario]) -> Iterator[Measurement]:
    """Time tracing and compiling of the whole step of 64 scenarios, without and with a cache on the disk."""
    from jax.experimental.compilation_cache import compilation_cache

    names = "jax_compilation_cache_dir", "jax_enable_compilation_cache"
    settings = {name: getattr(jax.config, name) for name in names}
    floors, batch = _fitting(stack, 64)
    program = programs.stepping(floors, batch, 10)
    try:
        with tempfile.TemporaryDirectory() as folder:
            jax.config.update("jax_enable_compilation_cache", True)
            jax.config.update("jax_compilation_cache_dir", folder)
            for what in ("seconds, cold", "seconds, cached"):
                jax.clear_caches()
                compilation_cache.reset_cache()
                began = time.perf_counter()
                program.run.lower(*program.fixed, program.carried).compile()
                spent = time.perf_counter() - began
                yield Measurement(
                    "compile", what, batch, stack.member.people, 0, 1, per_second=spent, microseconds=1e6 * spent,
                    compile_seconds=spent, scenario_bytes=float("nan"),
                )  # fmt: skip
    finally:
        for name, value in settings.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def scaling(options: BenchConfig, stack: Stack[Scenario]) -> Iterator[Measurement]:
    """Time the whole step on 1, 2, 4 and more devices, with equally many scenarios on each."""
    floors, batch = _fitting(stack, batches(options)[-1] if on_cpu() else 32768)
    number = 1
    while number <= jax.device_count():
        program = programs.stepping(floors, batch, turns(batch), None, number)
        yield _row(options, "devices", "scenario-steps", batch * number, stack.member.people, program, 0, number)
        number *= 2


CASES: dict[str, Callable[[BenchConfig, Stack[Scenario]], Iterator[Measurement]]] = {
    "step": steps,
    "depth": partial(steps, part="depth", image=IMAGE),
    "images": partial(images, part="images", camera="depth", what="depth images"),
    "pictures": partial(images, part="pictures", camera="first_person", what="color images"),
    "crowd": crowd,
    "compile": compiling,
    "devices": scaling,
}


# ------------------------------------------------------------------ table and picture


def title(setup: dict[str, Any]) -> str:
    """The machine and the scenario."""
    most = "up to " if setup.get("floors", 1) > 1 else ""
    return (
        f"{setup['device']} ({setup['devices']}), jax {setup['versions']['jax']}; {setup['environment']}, "
        f"{most}{setup['people']} people, {setup['robot']} ({setup['dynamics']})"
    )


def line(row: Measurement) -> str:
    """A row of the table, as long as ``HEAD``."""
    pixels = str(row.pixels) if row.pixels else "-"
    kib = "-" if np.isnan(row.scenario_bytes) else f"{row.scenario_bytes / 1024:.1f}"
    return (
        f"{row.part:<9}{row.batch:7d}{row.people:7d}{pixels:>7}{row.devices:8d}{row.per_second:11.4g}  {row.what:<15}"
        f"{row.microseconds:9.0f}{row.compile_seconds:10.1f}{kib:>9}"
    )


def notes(rows: list[Measurement], setup: dict[str, Any]) -> list[str]:
    """Which batches fixed costs bind, how many scenarios fit into memory, several devices beside one."""
    return [*_launch_notes(rows), *_memory_notes(rows, setup["memory"]), *_device_notes(rows)] if rows else []


def _launch_notes(rows: list[Measurement]) -> list[str]:
    """Batches that take less than twice as long as the smallest, although they are four times as large or more."""
    kinds: dict[tuple, list[Measurement]] = {}
    for row in rows:
        if row.part not in ("compile", "devices"):
            kinds.setdefault((row.part, row.people, row.pixels), []).append(row)

    lines = []
    for (part, people, _), same in kinds.items():
        small = min(same, key=lambda row: row.batch)
        flat = [row for row in same if row.batch >= 4 * small.batch and row.microseconds < 2 * small.microseconds]
        if flat:
            large = max(flat, key=lambda row: row.batch)
            lines.append(
                f"{part}, {people} people: a call takes {small.microseconds:.0f} us at B = {small.batch} and "
                f"{large.microseconds:.0f} us at B = {large.batch}; so far launches and the host bind."
            )
    return lines


def _memory_notes(rows: list[Measurement], memory: int) -> list[str]:
    """How many scenarios as those of the largest batch would fit into the memory [bytes]."""
    lines = []
    for part, name in (("step", "without images"), ("depth", "with a depth image each")):
        same = [row for row in rows if row.part == part]
        if not same or not memory:
            continue
        largest = max(same, key=lambda row: row.batch)
        if largest.scenario_bytes > 0:
            lines.append(
                f"memory: {largest.scenario_bytes / 1024:.0f} KiB a scenario {name} at B = {largest.batch}; "
                f"about {int(memory / largest.scenario_bytes):.2g} would fit into {memory / 2**30:.0f} GiB."
            )
    return lines


def _device_notes(rows: list[Measurement]) -> list[str]:
    """How much faster several devices are than one."""
    measured = [row for row in rows if row.part == "devices"]
    lines = []
    for row in measured[1:]:
        first = measured[0]
        share = row.per_second / first.per_second
        lines.append(f"{row.devices} devices: {share:.2f} times one ({100 * share / row.devices:.0f} % of each).")
    return lines


def picture(rows: list[Measurement], setup: dict[str, Any]) -> Figure:
    """Plot throughput by batch, the cost of an agent-step by people, and the cost of an image by pixels.

    Args:
        rows: of the table; a panel without rows is labelled.
    """
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": colors.MUTED, "svg.fonttype": "none"}):
        figure = Figure(figsize=(12.5, 4.2), layout="constrained", facecolor="white")
        left, middle, right = figure.subplots(1, 3)
    figure.suptitle(title(setup), fontsize=10, color=colors.INK)
    _throughput(left, rows)
    _crowds(middle, [row for row in rows if row.part == "crowd"])
    _images(right, rows)
    return figure


def _throughput(axes: Axes, rows: list[Measurement]) -> None:
    """Scenarios a second by batch."""
    for part, name, situation in (
        ("step", "step", "down_path"),
        ("depth", "step + depth 64x48", "cross_path"),
        ("images", "depth images 64x48", "join_group"),
    ):
        by_batch = {row.batch: row for row in rows if row.part == part and row.pixels in (0, 64 * 48)}
        per_second = {batch: by_batch[batch].per_second for batch in sorted(by_batch)}
        _curve(axes, per_second, name, colors.SITUATION_COLORS[situation])
    _label(axes, "throughput", "scenarios at once (B)", "per second")


def _crowds(axes: Axes, rows: list[Measurement]) -> None:
    """Nanoseconds of an agent-step by people, of the smallest and of the largest batch."""
    for name, shade, choose in (("one crowd", colors.MUTED, min), ("many at once", colors.FLOW, max)):
        nanoseconds = {}
        for people in sorted({row.people for row in rows}):
            chosen = choose((row for row in rows if row.people == people), key=lambda row: row.batch)
            nanoseconds[people] = 1e9 / chosen.per_second
        _curve(axes, nanoseconds, name, shade)
    _label(axes, "crowd alone, 32 walls", "people (N)", "ns per agent-step")


def _images(axes: Axes, rows: list[Measurement]) -> None:
    """Microseconds of an image by pixels, of the fastest batch."""
    for part, name, shade in (
        ("images", "depth", colors.SITUATION_COLORS["join_group"]),
        ("pictures", "color", colors.ROBOT),
    ):
        same = [row for row in rows if row.part == part]
        microseconds = {}
        for pixels in sorted({row.pixels for row in same}):
            microseconds[pixels] = 1e6 / max(row.per_second for row in same if row.pixels == pixels)
        _curve(axes, microseconds, name, shade)
    _label(axes, "images, best B", "pixels", "µs per image")


def _curve(axes: Axes, values: dict[int, float], name: str, shade: str) -> None:
    if values:
        axes.loglog(list(values), list(values.values()), marker="o", ms=4, lw=1.6, color=shade, label=name)
        last = max(values.items())
        axes.annotate(_short(last[1]), last, textcoords="offset points", xytext=(0, 6), ha="right", color=shade)


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
    axes.spines[["top", "right"]].set_visible(False)
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

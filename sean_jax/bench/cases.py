"""The cases of ``sean bench``: which programs are timed, at which sizes, and the rows of the table."""

import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import TypedDict

import jax
import numpy as np

from sean_jax.base import Scenario
from sean_jax.bench import programs
from sean_jax.bench.programs import Program, measure
from sean_jax.config import BenchConfig

IMAGE = 64, 48  # pixels of the image that goes with a step
SIZES = (16, 12), (32, 24), (64, 48), (160, 120), (320, 240), (640, 480)
CROWDS = 62, 200, 1000, 10_000  # people


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of the table."""

    part: str  # a key of ``CASES``
    what: str  # the unit, such as "scenario-steps"
    batch: int  # scenarios at once
    people: int
    pixels: int  # of an image, 0 for none
    devices: int
    per_second: float  # units; for the part "compile" the seconds themselves
    microseconds: float  # of one turn of the whole batch
    compile_seconds: float
    scenario_bytes: float  # state and temporary memory of one scenario


class Setup(TypedDict):
    """The machine and the scenario of a measurement, in bench.json."""

    command: str
    device: str
    devices: int
    memory: int  # bytes, 0 if unknown
    environment: str
    people: int
    robot: str
    dynamics: str
    time_step: float  # s
    crowd_steps: int  # in one control step
    versions: dict[str, str]


def on_cpu() -> bool:
    """Whether there is no accelerator."""
    return jax.devices()[0].platform == "cpu"


def batches(options: BenchConfig) -> tuple[int, ...]:
    """Sizes of the batches: those of the options, or the usual ones of the device."""
    return options.batches or ((1, 16, 64, 256) if on_cpu() else (1, 64, 1024, 8192, 32768, 65536))


def turns(batch: int) -> int:
    """Control steps in one call, 2 to 200: enough to hide the cost of the call, few enough to take seconds."""
    return int(np.clip((4e3 if on_cpu() else 4e5) / batch, 2, 200))


def steps(options: BenchConfig, scenario: Scenario) -> Iterator[Row]:
    """Time the whole step with restarts."""
    for batch in batches(options):
        yield _row(options, "step", "scenario-steps", scenario, batch, programs.stepping(scenario, batch, turns(batch)))


def depth(options: BenchConfig, scenario: Scenario) -> Iterator[Row]:
    """Time the whole step with restarts and one depth image for each scenario."""
    for batch in batches(options):
        program = programs.stepping(scenario, batch, turns(batch), IMAGE)
        yield _row(options, "depth", "scenario-steps", scenario, batch, program, IMAGE)


def images(options: BenchConfig, scenario: Scenario) -> Iterator[Row]:
    """Time depth images alone, by batch and by size of the image."""
    yield from _images(options, scenario, "images", "depth", "depth images")


def pictures(options: BenchConfig, scenario: Scenario) -> Iterator[Row]:
    """Time color images of the robot's own camera, by size of the image."""
    yield from _images(options, scenario, "pictures", "first_person", "color images")


def crowd(options: BenchConfig, scenario: Scenario) -> Iterator[Row]:
    """Time the social forces alone, in a hall with 32 walls, by number of people and of crowds at once."""
    totals = (2**14,) if on_cpu() else (2**19, 2**21)
    for people in CROWDS:
        for batch in sorted({1, *(max(1, each // people) for each in totals)}):
            number = int(np.clip((2e5 if on_cpu() else 2e8) / (batch * people), 2, 40)) // 2 * 2
            program = programs.crowd(people, batch, number)
            figures = measure(program, options.repeats, options.seconds)
            yield Row("crowd", "agent-steps", batch, people, 0, 1, **_shared(figures, batch))


def compiling(options: BenchConfig, scenario: Scenario) -> Iterator[Row]:
    """Time tracing and compiling of the whole step of 64 scenarios, without and with a cache on the disk."""
    from jax.experimental.compilation_cache import compilation_cache

    settings = {
        name: getattr(jax.config, name) for name in ("jax_compilation_cache_dir", "jax_enable_compilation_cache")
    }
    program = programs.stepping(scenario, 64, 10)
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_enable_compilation_cache", True)
        jax.config.update("jax_compilation_cache_dir", folder)
        for what in ("seconds to compile, cold", "seconds to compile, cached"):
            jax.clear_caches()
            compilation_cache.reset_cache()
            began = time.perf_counter()
            program.run.lower(*program.fixed, program.carried).compile()
            spent = time.perf_counter() - began
            yield Row("compile", what, 64, scenario.people, 0, 1, spent, 1e6 * spent, spent, float("nan"))
    for name, value in settings.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


def scaling(options: BenchConfig, scenario: Scenario) -> Iterator[Row]:
    """Time the whole step on 1, 2, 4 and more devices, with equally many scenarios on each."""
    number, each = 1, batches(options)[-1] if on_cpu() else 32768
    while number <= jax.device_count():
        program = programs.stepping(scenario, each, turns(each), None, number)
        yield _row(options, "devices", "scenario-steps", scenario, each * number, program, (0, 0), number)
        number *= 2


def _images(options: BenchConfig, scenario: Scenario, part: str, camera: str, what: str) -> Iterator[Row]:
    cases = [(batch, *IMAGE) for batch in batches(options)] if part == "images" else []
    pixels = max(batches(options)) * IMAGE[0] * IMAGE[1] // (1 if part == "images" else 8)
    cases += [(max(1, min(max(batches(options)), pixels // (w * h))), w, h) for w, h in SIZES]
    for batch, width, height in dict.fromkeys(cases):
        often = int(np.clip((1e6 if on_cpu() else 1e9) / (batch * width * height), 1, 200))
        program = programs.images(scenario, camera, batch, width, height, often)
        yield _row(options, part, what, scenario, batch, program, (width, height))


def _row(
    options: BenchConfig,
    part: str,
    what: str,
    scenario: Scenario,
    batch: int,
    program: Program,
    image: tuple[int, int] = (0, 0),
    devices: int = 1,
) -> Row:
    figures = measure(program, options.repeats, options.seconds)
    return Row(part, what, batch, scenario.people, image[0] * image[1], devices, **_shared(figures, batch))


def _shared(figures: dict[str, float], batch: int) -> dict[str, float]:
    return {**{k: v for k, v in figures.items() if k != "bytes"}, "scenario_bytes": figures["bytes"] / batch}


CASES: dict[str, Callable[[BenchConfig, Scenario], Iterator[Row]]] = {
    "step": steps,
    "depth": depth,
    "images": images,
    "pictures": pictures,
    "crowd": crowd,
    "compile": compiling,
    "devices": scaling,
}

"""The timers, the device line and the files of results that the programs beside this file share."""

import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax


def device() -> str:
    """The first device and the version of JAX."""
    return f"{jax.devices()[0].device_kind}, jax {jax.__version__}"


class Stopwatch:
    """Seconds since it was made; they stand still once it is stopped."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock, self._begin = clock, clock()
        self._end: float | None = None

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return (self._clock() if self._end is None else self._end) - self._begin

    def stop(self) -> None:
        """Let the seconds stand still."""
        self._end = self._clock()


@contextmanager
def stopwatch(clock: Callable[[], float] = time.perf_counter) -> Iterator[Stopwatch]:
    """The time of a block, such as ``with stopwatch() as watch: ...``; then ``watch.seconds``."""
    watch = Stopwatch(clock)
    try:
        yield watch
    finally:
        watch.stop()


def compiled(function: Callable, *arguments: Any) -> tuple[Any, float]:
    """The compiled function of JAX, and the seconds that this took."""
    with stopwatch() as watch:
        program = jax.jit(function).lower(*arguments).compile()
    return program, watch.seconds


def temporary(program: Any) -> float:
    """MiB of temporary memory of a compiled program; NaN if the compiler does not report it."""
    analysis = program.memory_analysis()
    return analysis.temp_size_in_bytes / 2**20 if analysis else float("nan")


def times(call: Callable[[], Any], repeats: int = 3, calls: int = 1) -> list[float]:
    """Seconds of one call, measured ``repeats`` times over ``calls`` calls, after a first one that does not count."""
    jax.block_until_ready(call())
    measured = []
    for _ in range(repeats):
        with stopwatch() as watch:
            for _ in range(calls):
                result = call()
            jax.block_until_ready(result)
        measured.append(watch.seconds / calls)
    return measured


def least(call: Callable[[], Any], repeats: int = 3, calls: int = 1) -> float:
    """The shortest time [s] of a call, as of ``times``."""
    return min(times(call, repeats, calls))


def median(call: Callable[[], Any], repeats: int = 3, calls: int = 1) -> float:
    """The median time [s] of a call, as of ``times``."""
    return statistics.median(times(call, repeats, calls))


def write_json(path: Path, content: Any, indent: int = 1) -> None:
    """Write a file of results."""
    path.write_text(json.dumps(content, indent=indent) + "\n", encoding="utf-8")


def import_from_tests() -> None:
    """Let ``import support`` find what the tests share, such as oracles."""
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

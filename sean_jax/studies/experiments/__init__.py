"""Experiments of the paper (section V), each a report by one command: what they share.

Independent parts of an experiment run at the same time, in threads. Compiling keeps one core busy for some twenty
seconds; meanwhile other parts use the other cores and the device. The result of a part does not depend on the parts
beside it.
"""

from __future__ import annotations

import functools
import gc
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax.io import writing
from sean_jax.io.progress import progress

if TYPE_CHECKING:
    from rich.console import Console

MAX_PARTS = 16  # parts at once
BYTES = 3e9  # of memory for each: its compilation takes one or two GB


@dataclass(frozen=True)
class ExperimentPart:
    """One piece of work: ``work(tell)`` calls ``tell(share)`` with its progress, 0 to 1, and returns its result."""

    name: str
    work: Callable[[Callable[[float], None]], Any]
    needs: tuple[str, ...] = ()  # names of parts before it in the list that must be finished first


class Stopped(Exception):
    """Raised in a part when it reports progress after another part failed or Ctrl-C was pressed."""


def cached(function: Callable) -> Callable:
    """``functools.cache`` of a function that one thread at a time calls."""
    lock, cache = threading.Lock(), functools.cache(function)

    def call(*arguments: Any) -> Any:
        with lock:
            return cache(*arguments)

    return call


def workers() -> int:
    """How many parts run at once: as many as cores and memory allow; on a CPU half, since there parts compute too.

    With several devices it is one: programs that exchange data must start in the same order on all devices.
    """
    import jax

    if len(jax.devices()) > 1:
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    cores = cores // 2 if jax.default_backend() == "cpu" else cores
    names = getattr(os, "sysconf_names", {})  # none on Windows
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if "SC_PHYS_PAGES" in names else BYTES * MAX_PARTS
    return max(1, min(MAX_PARTS, cores, int(memory // BYTES)))


def run_parts(
    parts: Sequence[ExperimentPart], console: Console | None, title: str, at_once: int | None = None
) -> dict[str, Any]:
    """Run parts, several at once, under one progress bar; name -> result. ``at_once`` is the number of threads.

    After the first failure, or Ctrl-C, each other part stops when it next reports progress; then the failure is raised.
    Files that parts have written stay. The order of the list is one in which parts could run one by one.
    """
    shares, stop, lock = dict[str, float](), threading.Event(), threading.Lock()
    at_once = min(workers(), len(parts)) if at_once is None else at_once
    with progress(console) as bar:
        bar.start(title, len(parts))

        def run(part: ExperimentPart) -> Any:
            def tell(share: float) -> None:
                if stop.is_set():
                    raise Stopped(part.name)
                with lock:
                    shares[part.name] = share
                    finished = sum(value >= 1.0 for value in shares.values())
                    others = len(shares) - finished - (share < 1.0)
                    more = f" and {others} more" if others else ""
                    bar.update(sum(shares.values()), f"{finished} of {len(parts)} · {part.name}{more}")

            tell(0.0)
            result = part.work(tell)
            tell(1.0)
            return result

        return _in_threads(parts, run, at_once, stop) if at_once > 1 else {part.name: run(part) for part in parts}


def _in_threads(
    parts: Sequence[ExperimentPart], run: Callable[[ExperimentPart], Any], at_once: int, stop: threading.Event
) -> dict[str, Any]:
    """Parts in ``at_once`` threads, in half as many once a part is out of device memory; that part runs again."""
    from sean_jax.core.devices import is_out_of_memory

    results: dict[str, Any] = {}
    waiting, running = list(parts), dict[Future, tuple[ExperimentPart, int]]()
    with ThreadPoolExecutor(at_once, thread_name_prefix="sean-part") as pool:
        try:
            while waiting or running:
                ready = [part for part in waiting if results.keys() >= set(part.needs)]
                for part in ready[: max(0, at_once - len(running))]:
                    waiting.remove(part)
                    running[pool.submit(run, part)] = part, at_once
                done = wait(running, return_when=FIRST_COMPLETED).done
                while done:  # a variable that stays would keep the arrays of a failed part
                    future = done.pop()
                    part, threads = running.pop(future)
                    try:
                        results[part.name] = future.result()
                    except RuntimeError as error:
                        if threads == 1 or not is_out_of_memory(error):
                            raise
                        waiting.insert(0, part)
                        at_once = min(at_once, threads // 2)
                    del future
                gc.collect()
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def write_csv(file: Path, head: str, rows: Iterable[Sequence[Any]]) -> None:
    """Write a table with the columns of ``head``; numbers that are not whole have five digits.

    Raises:
        WriteError: another process writes the file.
    """

    def text(value: Any) -> str:
        return f"{value:.5f}" if isinstance(value, float | np.floating | np.ndarray) else str(value)

    writing.write(file, "".join(",".join(line) + "\n" for line in [[head], *(map(text, row) for row in rows)]))

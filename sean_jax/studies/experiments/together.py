"""Independent parts of an experiment (section V) at the same time, in threads.

Compiling a program keeps one core busy for some twenty seconds. Meanwhile other parts use the other cores and the
device. The result of a part does not depend on which parts run beside it.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sean_jax.progress import progress

if TYPE_CHECKING:
    from rich.console import Console

MAX_PARTS = 16  # parts at once
GIGABYTES = 3.0  # of memory for each: its compilation takes one or two


@dataclass(frozen=True)
class Part:
    """One piece of work: ``work(tell)`` calls ``tell(share)`` with its progress, 0 to 1, and returns its result."""

    name: str
    work: Callable[[Callable[[float], None]], Any]
    needs: tuple[str, ...] = ()  # names of earlier parts in the list that must be finished before


class Stopped(Exception):
    """Raised in a part when it reports progress after another part failed or Ctrl-C was pressed."""


class Once:
    """A function with a cache, which one thread at a time calls.

    Args:
        make: the function; its arguments must be hashable.
    """

    def __init__(self, make: Callable):
        self.make, self.values, self.lock = make, dict[tuple, Any](), threading.Lock()

    def __call__(self, *arguments: Any) -> Any:
        with self.lock:
            if arguments not in self.values:
                self.values[arguments] = self.make(*arguments)
            return self.values[arguments]


def workers() -> int:
    """How many parts run at once: as many as cores and memory allow; on a CPU half, since there parts compute too.

    With several devices it is one: programs that exchange data must start in the same order on all devices.
    """
    import jax

    if len(jax.devices()) > 1:
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if jax.default_backend() == "cpu":
        cores //= 2
    return max(1, min(MAX_PARTS, cores, math.floor(_memory() / GIGABYTES)))


def _memory() -> float:
    """GB that this machine has; where it does not tell, enough."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (AttributeError, OSError, ValueError):
        return GIGABYTES * MAX_PARTS


def together(parts: Sequence[Part], console: Console | None, what: str) -> dict[str, Any]:
    """Run parts, several at once, under one progress bar.

    After the first failure, or Ctrl-C, each other part stops when it next reports progress; then the failure is raised.
    Files that parts have written stay.

    Args:
        parts: in an order in which they could run one by one.
        console: shows the bar; None shows nothing.
    """
    at_once = min(workers(), len(parts))
    with progress(console) as tell:
        tell.start(what, len(parts))
        work = _Progress(len(parts), tell.update)
        if at_once > 1:
            return _in_threads(parts, work, at_once)
        return {part.name: work.run(part) for part in parts}


def _in_threads(parts: Sequence[Part], work: _Progress, at_once: int) -> dict[str, Any]:
    results: dict[str, Any] = {}
    waiting, running = list(parts), dict[Future, Part]()
    with ThreadPoolExecutor(at_once, thread_name_prefix="sean-part") as pool:
        try:
            while waiting or running:
                for part in [part for part in waiting if results.keys() >= set(part.needs)]:
                    waiting.remove(part)
                    running[pool.submit(work.run, part)] = part
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    results[running.pop(future).name] = future.result()
        except BaseException:
            work.over.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


class _Progress:
    """The progress of all parts, as one bar."""

    def __init__(self, number: int, show: Callable[[float, str], None]):
        self.number, self.show, self.over = number, show, threading.Event()
        self.shares: dict[str, float] = {}
        self.lock = threading.Lock()

    def run(self, part: Part) -> Any:
        def tell(share: float) -> None:
            if self.over.is_set():
                raise Stopped(part.name)
            with self.lock:
                self.shares[part.name] = share
                finished = sum(each >= 1.0 for each in self.shares.values())
                others = len(self.shares) - finished - (share < 1.0)
                at_work = f" and {others} more" if others else ""
                self.show(sum(self.shares.values()), f"{finished} of {self.number} · {part.name}{at_work}")

        tell(0.0)
        result = part.work(tell)
        tell(1.0)
        return result

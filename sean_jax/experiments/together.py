"""Independent parts of an experiment (section V) at the same time, in threads.

Compiling a program takes one core some twenty seconds and leaves the others, and the device, to other parts: so parts
overlap, although a device executes one program after the other. What a part finds does not depend on the others.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sean_jax.learning.progress import shown

if TYPE_CHECKING:
    from rich.console import Console

MOST = 8  # parts at once: each holds the memory that its compilation takes, one or two GB


@dataclass(frozen=True)
class Part:
    """One piece of work. ``work(tell)`` tells how far it is, ``tell(share)`` from 0 to 1, and gives what it found."""

    name: str
    work: Callable[[Callable[[float], None]], Any]
    needs: tuple[str, ...] = ()  # names of parts that come before it in the list and have to be finished first


class Stopped(Exception):
    """Raised in a part at its next word, since another one failed or Ctrl-C was pressed."""


class Once:
    """``make(*arguments)``, made at first use, by one thread at a time, and kept."""

    def __init__(self, make: Callable):
        self.make, self.made, self.lock = make, {}, threading.Lock()

    def __call__(self, *arguments: Any) -> Any:
        with self.lock:
            if arguments not in self.made:
                self.made[arguments] = self.make(*arguments)
            return self.made[arguments]


def workers() -> int:
    """How many parts at once: half the cores, for the parts' own threads and the device want some too.

    One with several devices: programs that exchange anything must be started in the same order on all of them.
    """
    import jax

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return 1 if len(jax.devices()) > 1 else max(1, min(MOST, cores // 2))


def together(parts: Sequence[Part], console: Console | None, what: str) -> dict[str, Any]:
    """What each part found, by its name; one bar shows how far they all are.

    The first failure, or Ctrl-C, is raised as soon as the other parts have stopped, each at its next word; what parts
    wrote until then stays.
    """
    at_once = min(workers(), len(parts))
    with shown(console, what, len(parts)) as show:
        progress = _Progress(len(parts), show)
        if at_once > 1:
            return _in_threads(parts, progress, at_once)
        return {part.name: progress.watched(part) for part in parts}


def _in_threads(parts: Sequence[Part], progress: _Progress, at_once: int) -> dict[str, Any]:
    found: dict[str, Any] = {}
    waiting, running = list(parts), dict[Future, Part]()
    with ThreadPoolExecutor(at_once, thread_name_prefix="sean-part") as pool:
        try:
            while waiting or running:
                for part in [part for part in waiting if found.keys() >= set(part.needs)]:
                    waiting.remove(part)
                    running[pool.submit(progress.watched, part)] = part
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    found[running.pop(future).name] = future.result()
        except BaseException:
            progress.over.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return found


class _Progress:
    """How far each part is, as one bar."""

    def __init__(self, number: int, show: Callable[[float, str], None]):
        self.number, self.show, self.over = number, show, threading.Event()
        self.shares: dict[str, float] = {}
        self.lock = threading.Lock()

    def watched(self, part: Part) -> Any:
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
        found = part.work(tell)
        tell(1.0)
        return found

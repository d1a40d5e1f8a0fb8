"""The progress of long work: its stage, the share that is done, and a note, on a console or for a longer work."""

import contextlib
import datetime
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from rich.console import Console

ProgressLike: TypeAlias = "Console | Callable[[float], None] | None"
"""A console on which progress is shown, or a function that receives the share that is done."""

INTERVAL, MAX_INTERVAL = 10.0, 60.0  # s between two plain lines, at least and at most


class Progress:
    """Progress of some work: calls a function, if there is one, with the share that is done."""

    def __init__(self, report: Callable[[float], None] | None = None) -> None:
        self._report = report
        self._total = 1.0

    def stage(self, text: str) -> None:
        """Work of unknown length begins."""

    def start(self, text: str, total: float) -> None:
        """Work of a known length, in any unit, begins."""
        self._total = max(total, 1e-9)

    def update(self, done: float, note: str = "") -> None:
        """The length that is done."""
        if self._report is not None:
            self._report(min(1.0, done / self._total))

    @contextlib.contextmanager
    def aside(self, text: str) -> Iterator[None]:
        """Work within a stage that is not part of its length, such as an evaluation; its time does not count."""
        yield


class _Bar(Progress):
    """A bar on the console."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._text = "starting"
        self._task = bar.add_task(self._text, total=None, note="")

    def stage(self, text: str) -> None:
        self._text = text
        self._bar.update(self._task, description=text, total=None, note="")

    def start(self, text: str, total: float) -> None:
        self._text = text
        self._bar.reset(self._task, description=text, total=total, note="")

    def update(self, done: float, note: str = "") -> None:
        self._bar.update(self._task, completed=done, note=note)

    @contextlib.contextmanager
    def aside(self, text: str) -> Iterator[None]:
        self._bar.update(self._task, description=text)
        try:
            yield
        finally:
            self._bar.update(self._task, description=self._text)


class _Lines(Progress):
    """Plain lines for a pipe or a file, where no bar can be drawn. The longer the work, the rarer they are."""

    def __init__(self, console: Any) -> None:
        self._console = console
        self._text = "starting"
        self._note = ""
        self._total = 0.0
        self._done = 0.0
        self._begin = time.monotonic()
        self._last = self._begin  # when a line was printed
        self._first = self._begin, 0.0  # time and length of the first update
        self._aside = 0.0  # s that do not count
        self._aside_text = ""  # what is done beside
        self._aside_began = 0.0

    def stage(self, text: str) -> None:
        self.start(text, 0.0)

    def start(self, text: str, total: float) -> None:
        self._text = text
        self._note = ""
        self._total = total
        self._done = 0.0
        self.line()

    def update(self, done: float, note: str = "") -> None:
        if not self._done:  # before it, programs were compiled, or a training was resumed
            self._first = time.monotonic(), done
            self._aside = 0.0
        self._done = done
        self._note = note
        self.line()

    @contextlib.contextmanager
    def aside(self, text: str) -> Iterator[None]:
        self._aside_text = text
        self._aside_began = time.monotonic()
        try:
            yield
        finally:
            self._aside += time.monotonic() - self._aside_began
            self._aside_text = ""

    def line(self) -> None:
        """Print a line if it is time for one."""
        now = time.monotonic()
        if now - self._last < min(max(INTERVAL, 0.1 * (self._last - self._begin)), MAX_INTERVAL):
            return
        self._last = now
        text = f"{self._text}, {self._aside_text}" if self._aside_text else self._text
        if self._total and self._done:
            text += f" {min(1.0, self._done / self._total):.0%}"
        if self._note:
            text += f" · {self._note}"
        text += f" · {_clock(now - self._begin)}"
        remaining = self._remaining(now)
        if self._total and self._done and remaining > 0.0:
            text += f", {_clock(remaining)} left"
        self._console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)
        self._console.file.flush()

    def _remaining(self, now: float) -> float:
        """Seconds until the end, as fast as since the first update; 0 if nothing is known."""
        begin, first_done = self._first
        if self._done <= first_done:
            return 0.0
        spent = (self._aside_began if self._aside_text else now) - begin - self._aside
        return spent * (self._total - self._done) / (self._done - first_done)


def _clock(seconds: float) -> datetime.timedelta:
    return datetime.timedelta(seconds=int(seconds))


def say(console: ProgressLike, sentence: str) -> None:
    """Print a sentence on a console; a function or None is told nothing."""
    if console is not None and hasattr(console, "print"):
        console.print(sentence, markup=False)  # pyright: ignore[reportAttributeAccessIssue]


@contextlib.contextmanager
def progress(console: ProgressLike) -> Iterator[Progress]:
    """The progress of the block's work.

    Args:
        console: shows a bar until the block ends, or prints a line now and then if it is no terminal; or a function
            that is called with the share that is done; or None.
    """
    if console is None or not hasattr(console, "print"):
        yield Progress(console)  # pyright: ignore[reportArgumentType]
        return
    if not (console.is_terminal or console.is_jupyter):  # pyright: ignore[reportAttributeAccessIssue]
        lines = _Lines(console)
        ended = threading.Event()

        def repeat() -> None:  # while a program is compiled, nothing else calls
            while not ended.wait(INTERVAL):
                lines.line()

        threading.Thread(target=repeat, name="sean-progress", daemon=True).start()
        try:
            yield lines
        finally:
            ended.set()
        return
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    description, note = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}"))
    columns = (SpinnerColumn(), description, BarColumn(bar_width=30), note, TimeElapsedColumn())
    with Bar(*columns, console=console, transient=True) as bar:  # pyright: ignore[reportArgumentType]
        yield _Bar(bar)

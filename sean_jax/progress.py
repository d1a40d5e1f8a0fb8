"""The progress of long work: what is being done, how far it is, and a note, on a console or told to a longer work."""

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console


class Progress:
    """Tells how far some work is; this one tells nobody."""

    def stage(self, text: str) -> None:
        """Work of unknown length begins.

        Args:
            text: what it is.
        """

    def start(self, text: str, total: float) -> None:
        """Work of known length begins.

        Args:
            text: what it is.
            total: its length, in any unit.
        """

    def update(self, done: float, note: str = "") -> None:
        """How far it is.

        Args:
            done: out of the total.
            note: further words.
        """


class _Share(Progress):
    """Tells a function the share that is done, so that the work is a part of a longer one."""

    def __init__(self, tell: Callable[[float], None]) -> None:
        self._tell, self._total = tell, 1.0

    def start(self, text: str, total: float) -> None:
        self._total = max(total, 1e-9)

    def update(self, done: float, note: str = "") -> None:
        self._tell(min(1.0, done / self._total))


class _Bar(Progress):
    """A bar on the console."""

    def __init__(self, bar: Any) -> None:
        self._bar, self._task = bar, bar.add_task("starting", total=None, note="")

    def stage(self, text: str) -> None:
        self._bar.update(self._task, description=text, total=None, note="")

    def start(self, text: str, total: float) -> None:
        self._bar.reset(self._task, description=text, total=total, note="")

    def update(self, done: float, note: str = "") -> None:
        self._bar.update(self._task, completed=done, note=note)


@contextlib.contextmanager
def progress(console: "Console | Callable[[float], None] | None") -> Iterator[Progress]:
    """What tells how far the work of the block is.

    Args:
        console: shows a bar until the block ends; a function is told the share that is done; None tells nobody.

    Yields:
        A ``Progress``.
    """
    if console is None:
        yield Progress()
        return
    if not hasattr(console, "print"):
        yield _Share(console)  # pyright: ignore[reportArgumentType]
        return
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    description, note = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}"))
    columns = (SpinnerColumn(), description, BarColumn(bar_width=30), note, TimeElapsedColumn())
    with Bar(*columns, console=console, transient=True) as bar:  # pyright: ignore[reportArgumentType]
        yield _Bar(bar)

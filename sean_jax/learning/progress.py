"""The progress of long work on the console: how far, and a note; experiments show theirs with it as well."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console


@contextlib.contextmanager
def shown(console: Console | Callable[[float], None] | None, what: str, total: float) -> Iterator[Any]:
    """Tells ``(done, note)``, out of ``total``, on the console until the block ends; nobody if there is none.

    In the place of a console, a function is told the share that is done: so the work is a part of a longer one.
    """
    if callable(console):
        yield lambda done, note: console(min(1.0, done / total))
        return
    if console is None:
        yield lambda done, note: None
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    said = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}"))
    columns = (SpinnerColumn(), next(said), BarColumn(bar_width=20), next(said), TimeElapsedColumn())
    bar = Progress(*columns, console=console, transient=True)
    with bar:
        task = bar.add_task(what, total=total, note="compiling")
        yield lambda done, note: bar.update(task, completed=done, note=note)

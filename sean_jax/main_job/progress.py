"""What ``sean run`` shows while it works: what it compiles and for how long, then how far and how fast it is."""

import contextlib
import time
from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from sean_jax.main_job.simulation import Watch


@contextlib.contextmanager
def shown(console: Console) -> Iterator[Watch]:
    """A watch that draws on the console until the block ends."""
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.fields[note]}", markup=False),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    )
    began = time.perf_counter()

    def compiling(what: str) -> None:
        bar.update(task, description=what, total=None, note="")

    def begun(total: float) -> None:
        console.print(f"[dim]compiled in {time.perf_counter() - began:.1f} s[/]", highlight=False)
        bar.reset(task, description="simulating", total=total, note="")

    def advanced(simulated: float, speed: float) -> None:
        note = f"{simulated:.0f} s of each episode · {speed:,.0f} simulated s per s"
        bar.update(task, completed=simulated, note=note)

    with bar:
        task = bar.add_task("starting", total=None, note="")
        yield Watch(compiling, begun, advanced)

"""What an experiment has finished: files written under another name and renamed, and taken up again."""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax.experiments.options import Experiment
from sean_jax.learning.options import Refused
from sean_jax.versions import versions

if TYPE_CHECKING:
    from rich.console import Console

OPTIONS = "experiment.json"


def begin(options: Experiment) -> Path:
    """The folder, with the options in it. Raises Refused if it holds another experiment or something else."""
    folder, asked = options.folder, options.lasting()
    if folder.is_file():
        raise Refused(f"{folder} is a file, give the name of a folder with --out.")
    if (folder / OPTIONS).is_file():
        try:
            had = json.loads((folder / OPTIONS).read_text(encoding="utf-8"))["options"]
        except (ValueError, KeyError, TypeError):
            raise Refused(f"{folder / OPTIONS} is damaged; choose another folder with --out.") from None
        for name in asked:
            if asked[name] != had.get(name):
                said = f"--{name.replace('_', '-')} {had.get(name)}, not {asked[name]}"
                raise Refused(f"{folder} was begun with {said}; ask for the same or choose another --out.")
        return folder
    if folder.is_dir() and any(folder.iterdir()):
        raise Refused(f"the folder {folder} holds something else already, choose another with --out.")
    folder.mkdir(parents=True, exist_ok=True)
    save(folder / OPTIONS, {"options": asked, "versions": versions()})
    return folder


def save(path: Path, content: Any) -> None:
    """JSON, or text if it is a str, under another name first."""
    text = content if isinstance(content, str) else json.dumps(content, indent=1, allow_nan=False) + "\n"
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def saved(path: Path) -> Any:
    """What was saved there, or None."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


@contextlib.contextmanager
def shown(console: "Console | None", total: float) -> Iterator[Any]:
    """Tells (done, note) on the console until the block ends."""
    if console is None:
        yield lambda done, note: None
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), BarColumn(bar_width=30), TextColumn("{task.percentage:3.0f} % {task.description}"))
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bar:
        task = bar.add_task("preparing", total=total)
        yield lambda done, note: bar.update(task, completed=done, description=note)

"""``sean bench``: the speed of everything on this machine, as a table, as JSON and as a picture.

Importing this imports no JAX: the command line must answer at once.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax import writing
from sean_jax.bench.options import PARTS, Options
from sean_jax.learning.options import Failed
from sean_jax.options import BadInput, check_new_folder

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["PARTS", "BadInput", "Options", "run"]


def run(options: Options, console: Console) -> Path:
    """Measure what the options name; the folder written, which has table.txt, bench.json and bench.png.

    After Ctrl-C or a kill what was measured until then is there; KeyboardInterrupt is raised if there is nothing.
    Raises BadInput for options that cannot be met, Unwritable for a folder that cannot be written, Failed for a full
    disk.
    """
    options.check()
    folder = options.folder()
    with writing.held(folder):
        check_new_folder(folder)
        with console.status("importing JAX and preparing the scenario"):
            from sean_jax.bench import page, parts

            _check(options)
            scenario, about = _prepare(options)
        rows: list[Any] = []
        _print(console, page.title(about), page.HEAD)
        try:
            for part in options.parts:
                with console.status(f"compiling and timing: {part}"):
                    for row in parts.MEASURES[part](options, scenario):
                        rows.append(row)
                        _print(console, page.line(row))
                        _save(folder, rows, about)
        except KeyboardInterrupt:
            if not rows:
                raise
            _print(console, "stopped; what was measured until then is written.")
        except OSError as error:
            raise _broken(folder, error) from error
        _print(console, *page.notes(rows, about))
        try:
            with writing.whole(folder / "bench.png") as stream:
                page.picture(rows, about).savefig(stream, dpi=150, format="png")
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"stopped before the picture was drawn; the table is in {folder}.") from None
        except OSError as error:
            raise _broken(folder, error) from error
    return folder


def _broken(folder: Path, error: OSError) -> Failed:
    kept = f"what was measured until then is in {folder}" if writing.contents(folder) else "nothing was written"
    return Failed(f"{writing.broken(error)}; {kept}.")


def _save(folder: Path, rows: list[Any], about: dict[str, Any]) -> None:
    """table.txt and bench.json of what was measured so far."""
    from sean_jax.bench import page

    lines = [page.title(about), page.HEAD, *(page.line(row) for row in rows), *page.notes(rows, about)]
    writing.write(folder / "table.txt", "\n".join(lines) + "\n")
    told = {**about, "rows": [_finite(dataclasses.asdict(row)) for row in rows]}
    writing.write(folder / "bench.json", json.dumps(told, indent=2, allow_nan=False) + "\n")


def _check(options: Options) -> None:
    """Refuse all that can be told before the scenario is made."""
    from sean_jax import assembly

    try:
        parts = {"people": options.people, "robot": options.robot, "dynamics": options.dynamics}
        assembly.check(options.environment, **parts)
    except ValueError as error:
        raise BadInput(str(error)) from error


def _prepare(options: Options) -> tuple[Any, dict[str, Any]]:
    """The scenario, and on what it is measured."""
    import jax

    from sean_jax.assembly import make
    from sean_jax.bench import page
    from sean_jax.versions import versions

    try:
        scenario = make(options.environment, people=options.people, robot=options.robot, dynamics=options.dynamics)
    except ValueError as error:
        raise BadInput(str(error)) from error
    about = {
        "command": options.command,
        "device": jax.devices()[0].device_kind,
        "devices": jax.device_count(),
        "memory": page.memory(),
        "environment": options.environment,
        "people": scenario.people,
        "robot": options.robot,
        "dynamics": options.dynamics,
        "time_step": scenario.time_step,
        "crowd_steps": scenario.substeps,
        "versions": versions(),
    }
    return scenario, about


def _print(console: Console, *lines: str) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)


def _finite(row: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN."""
    return {name: None if value != value else value for name, value in row.items()}

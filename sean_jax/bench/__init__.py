"""``sean bench``: the speed of everything on this machine, as a table, as JSON and as a picture.

Importing this imports no JAX: the command line must answer at once.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING

from sean_jax import writing
from sean_jax.config import BenchConfig, ScenarioConfig
from sean_jax.errors import IncompleteError
from sean_jax.flags import command
from sean_jax.writing import check_new_folder

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Scenario
    from sean_jax.bench.cases import Row, Setup

__all__ = ["run"]


def run(options: BenchConfig, console: Console) -> Path:
    """Time the parts that the options name, and write table.txt, bench.json and bench.png.

    The table is written after each row, so Ctrl-C or a kill loses at most the row under way.

    Raises:
        InputError: the options name a scenario that does not exist or a folder that is not empty.
        WriteError: the folder cannot be written.
        IncompleteError: the disk is full.
        KeyboardInterrupt: Ctrl-C came before the first row, or before the picture was complete.
    """
    folder = options.folder()
    check_new_folder(folder)
    with writing.folder_lock(folder):
        check_new_folder(folder)
        with console.status("importing JAX and preparing the scenario"):
            from sean_jax.bench import cases, page

            _check(options)
            scenario, setup = _prepare(options)
        rows: list[Row] = []
        _print(console, page.title(setup), page.HEAD)
        try:
            for part in options.parts:
                with console.status(f"compiling and timing: {part}"):
                    for row in cases.CASES[part](options, scenario):
                        rows.append(row)
                        _print(console, page.line(row))
                        _save(folder, rows, setup)
        except KeyboardInterrupt:
            if not rows:
                raise
            _print(console, "stopped; what was measured until then is written.")
        except OSError as error:
            raise _broken(folder, error) from error
        _print(console, *page.notes(rows, setup))
        try:
            with writing.atomic_file(folder / "bench.png") as stream:
                page.picture(rows, setup).savefig(stream, dpi=150, format="png")
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"stopped before the picture was drawn; the table is in {folder}.") from None
        except OSError as error:
            raise _broken(folder, error) from error
    return folder


def _broken(folder: Path, error: OSError) -> IncompleteError:
    rest = f"what was measured until then is in {folder}" if writing.contents(folder) else "nothing was written"
    return IncompleteError(f"{writing.broken(error)}; {rest}.")


def _save(folder: Path, rows: list[Row], setup: Setup) -> None:
    """Write table.txt and bench.json of the rows so far."""
    from sean_jax.bench import page

    lines = [page.title(setup), page.HEAD, *(page.line(row) for row in rows), *page.notes(rows, setup)]
    writing.write(folder / "table.txt", "\n".join(lines) + "\n")
    content = {**setup, "rows": [_finite(dataclasses.asdict(row)) for row in rows]}
    writing.write(folder / "bench.json", json.dumps(content, indent=2, allow_nan=False) + "\n")


def _check(options: BenchConfig) -> None:
    """Refuse wrong options before the scenario is built."""
    from sean_jax import assembly

    assembly.check(_scenario(options))


def _scenario(options: BenchConfig) -> ScenarioConfig:
    return ScenarioConfig(
        environment=options.environment, people=options.people, robot=options.robot, dynamics=options.dynamics
    )


def _prepare(options: BenchConfig) -> tuple[Scenario, Setup]:
    """The scenario, and the setup of the measurement."""
    import jax

    from sean_jax.assembly import build
    from sean_jax.bench import page
    from sean_jax.versions import versions

    scenario = build(_scenario(options))[0]
    setup: Setup = {
        "command": command("bench", options),
        "device": jax.devices()[0].device_kind,
        "devices": jax.device_count(),
        "memory": page.memory(),
        "environment": options.environment,
        "people": scenario.people,
        "robot": options.robot.kind,
        "dynamics": options.dynamics,
        "time_step": scenario.time_step,
        "crowd_steps": scenario.substeps,
        "versions": versions(),
    }
    return scenario, setup


def _print(console: Console, *lines: str) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)


def _finite(row: dict[str, object]) -> dict[str, object]:
    """The row with None for NaN, which JSON does not have."""
    return {name: None if value != value else value for name, value in row.items()}

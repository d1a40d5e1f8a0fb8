"""Table I under several conditions: this package's, SEAN 2.0's, and this package's with one switch of SEAN 2.0 each.

So each cell, and each of the paper's orderings, is traced to the switch that moves it. The switches are the options of
preset ``sean2`` that differ from the defaults.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sean_jax import writing
from sean_jax.config import PRESETS, AblationConfig, CollectConfig, with_defaults
from sean_jax.learning.collection import check_collection, streams
from sean_jax.studies.experiments import page, pictures, shares, table1
from sean_jax.studies.experiments.chains import Streams
from sean_jax.studies.experiments.scheduler import Part, cached, run_parts
from sean_jax.studies.experiments.shares import BEHAVIORS, Cell
from sean_jax.workspace import Workspace, identity

if TYPE_CHECKING:
    from rich.console import Console

DEFAULT, ALL = "default", "sean2"
SWITCHES = {
    name: value
    for name, value in PRESETS[ALL].options.items()
    if name not in CollectConfig.model_fields or CollectConfig.model_fields[name].get_default() != value
}
WORLDS = (DEFAULT, *SWITCHES, ALL)
"""The conditions: the defaults, the defaults with one switch each, and SEAN 2.0's with all switches."""


def run(options: AblationConfig, console: Console | None = None) -> Path:
    """Simulate what the folder lacks, and write the report.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        WriteError: another process writes in the folder.
        FileError: a file in the folder is damaged.
        FloatingPointError: a position is not finite. Finished cells stay.

    Source: section V-B, Table I.
    """
    policies = table1.policies(options)
    for world in WORLDS:
        for behavior in BEHAVIORS:
            check_collection(description(options, world, behavior))
    places = cached(functools.partial(_places, options))
    sources = {world: {behavior: simulated(options, world, behavior) for behavior in BEHAVIORS} for world in WORLDS}
    cells_of = {
        world: [(by[behavior], policy, behavior) for policy in policies for behavior in BEHAVIORS]
        for world, by in sources.items()
    }
    jobs = dict.fromkeys(job for each in cells_of.values() for job in each)
    with Workspace(options.folder, identity(options)).open() as work:
        work.begin()
        parts = [Part(" · ".join(job), functools.partial(_cell, options, work, *job, places)) for job in jobs]
        cells = run_parts(parts, console, "ablation")
        write(options, {world: [cells[" · ".join(job)] for job in each] for world, each in cells_of.items()})
    return options.folder


def description(options: AblationConfig, world: str, behavior: str) -> CollectConfig:
    """The scenario of one of ``WORLDS`` with people of a behavior, which may not have its switch."""
    chosen = SWITCHES if world == ALL else {name: value for name, value in SWITCHES.items() if name == world}
    return CollectConfig(**with_defaults(CollectConfig, table1.fields(options, behavior, options.people), chosen))


def simulated(options: AblationConfig, world: str, behavior: str) -> str:
    """The world that is simulated for a world: the default if the switch changes nothing for people of the behavior."""
    own, default = (description(options, each, behavior).identity() for each in (world, DEFAULT))
    return DEFAULT if own == default else world


def _places(options: AblationConfig, world: str, behavior: str) -> Streams:
    return table1.with_starts(options, list(streams(description(options, world, behavior)).values()))


def _cell(
    options: AblationConfig,
    work: Workspace,
    world: str,
    policy: str,
    behavior: str,
    places: Callable[..., Streams],
    tell: Callable[[float], None],
) -> Cell:
    file = f"{world}-{behavior}-{policy}.npz"
    return table1.cell(options, work, file, behavior, policy, functools.partial(places, world, behavior), tell)


def write(options: AblationConfig, by_world: dict[str, list[Cell]]) -> None:
    """Write ablation.csv, orderings.csv, the figure and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, lines = options.folder, ["world,policy,behavior,counting,situation,share,low,high"]
    verdicts = ["world,policy,counting,ordering,hard,statement,holds,share_of_resamples"]
    for world, cells in by_world.items():
        for cell in cells:
            head = f"{world},{cell.policy},{cell.behavior}"
            estimate = cell.shares()
            for counting in shares.COUNTINGS:
                samples = estimate.of(counting)
                low, high = shares.interval(samples)
                for k, name in enumerate(shares.NAMES):
                    lines.append(f"{head},{counting},{name},{samples[0, k]:.5f},{low[k]:.5f},{high[k]:.5f}")
        for policy in dict.fromkeys(cell.policy for cell in cells):
            by_behavior = {cell.behavior: cell.shares() for cell in cells if cell.policy == policy}
            for counting in shares.COUNTINGS:
                for row in shares.orderings(by_behavior, counting):
                    verdicts.append(f'{world},{policy},{counting},{row["name"]},{row["hard"]},"{row["statement"]}",'
                                    f"{row['holds']},{row['share']:.4f}")  # fmt: skip
    writing.write(folder / "ablation.csv", "\n".join(lines) + "\n")
    writing.write(folder / "orderings.csv", "\n".join(verdicts) + "\n")
    figure = pictures.ablation(by_world)
    pictures.save(folder, {"ablation": figure})
    writing.write(folder / "report.html", page.ablation(options, by_world, figure))

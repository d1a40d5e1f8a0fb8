"""Table I in several worlds: this package's, SEAN 2.0's, and this package's with one of SEAN's switches at a time.

So each cell, and each of the paper's orderings, is traced to the switch that moves it. The switches are the options of
preset ``sean2`` whose values are others than by default.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sean_jax import writing
from sean_jax.config import AblationConfig, CollectConfig, with_defaults
from sean_jax.learning.collection import check_collection, streams
from sean_jax.presets import PRESETS
from sean_jax.studies.experiments import page, parts, pictures, shares, table1
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.studies.experiments.table1 import Cell
from sean_jax.studies.experiments.together import Once, Part, together

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.studies.experiments.rollouts import Streams

DEFAULT, ALL = "default", "sean2"
SWITCHES = {
    name: value
    for name, value in PRESETS[ALL].options.items()
    if name not in CollectConfig.model_fields or CollectConfig.model_fields[name].get_default() != value
}
WORLDS = (DEFAULT, *SWITCHES, ALL)
"""The package's world, that world with one switch each, and SEAN 2.0's, which has them all."""


def run(options: AblationConfig, console: Console | None = None) -> Path:
    """Simulate what the folder lacks, and write the report.

    Args:
        console: shows progress; None shows nothing.

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
    folder, places = options.folder, Once(functools.partial(_places, options))
    parts.has_started(options)
    sources = {world: {behavior: simulated(options, world, behavior) for behavior in BEHAVIORS} for world in WORLDS}
    cells_of = {
        world: [(by[behavior], policy, behavior) for policy in policies for behavior in BEHAVIORS]
        for world, by in sources.items()
    }
    jobs = dict.fromkeys(job for each in cells_of.values() for job in each)
    with writing.folder_lock(folder):
        parts.start(options)
        work = [Part(" · ".join(job), functools.partial(_cell, options, *job, places)) for job in jobs]
        cells = together(work, console, "ablation")
        write(options, folder, {world: [cells[" · ".join(job)] for job in each] for world, each in cells_of.items()})
    return folder


def description(options: AblationConfig, world: str, behavior: str) -> CollectConfig:
    """What is simulated in a world with people of a behavior.

    Args:
        world: one of ``WORLDS``.
        behavior: random, handcrafted or graph.

    Returns:
        The description. A switch that people of that behavior do not have changes nothing.
    """
    chosen = SWITCHES if world == ALL else {name: value for name, value in SWITCHES.items() if name == world}
    return CollectConfig(**with_defaults(CollectConfig, table1.fields(options, behavior, options.people), chosen))


def simulated(options: AblationConfig, world: str, behavior: str) -> str:
    """The world that is simulated for a world: the default one if the switch changes nothing for people of a behavior.

    Args:
        world: one of ``WORLDS``.
        behavior: random, handcrafted or graph.

    Returns:
        That world or the default.
    """
    own, usual = (description(options, each, behavior).identity() for each in (world, DEFAULT))
    return DEFAULT if own == usual else world


def _places(options: AblationConfig, world: str, behavior: str) -> Streams:
    return table1.with_starts(options, list(streams(description(options, world, behavior)).values()))


def _cell(
    options: AblationConfig, world: str, policy: str, behavior: str, places: Once, watch: Callable[[float], None]
) -> Cell:
    file = options.folder / f"{world}-{behavior}-{policy}.npz"
    make = functools.partial(places, world, behavior)
    return table1.cell(options, file, behavior, policy, make, watch)


def write(options: AblationConfig, folder: Path, by_world: dict[str, list[Cell]]) -> None:
    """Write ablation.csv, orderings.csv, the figure and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    lines = ["world,policy,behavior,counting,situation,share,low,high"]
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
    parts.save(folder / "ablation.csv", "\n".join(lines) + "\n")
    parts.save(folder / "orderings.csv", "\n".join(verdicts) + "\n")
    figure = pictures.ablation(by_world)
    pictures.save(folder, {"ablation": figure})
    parts.save(folder / "report.html", page.ablation(options, by_world, figure))

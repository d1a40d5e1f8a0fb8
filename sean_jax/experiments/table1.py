"""Table I: how much of the time a robot is in each social situation, with people of three behaviors (section V-B).

For each behavior and driver an hour or more as in the paper's protocol, some times over; beside it the paper's row. The
speed V above which people count as walking is swept, for the paper's 1.4 m/s is faster than most walk, and so is the
number of people.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from sean_jax import writing
from sean_jax.experiments import page, parts, pictures, shares
from sean_jax.experiments.options import BEHAVIORS, Experiment
from sean_jax.experiments.rollouts import MINUTE, Chains
from sean_jax.experiments.shares import Shares
from sean_jax.experiments.together import Once, Part, together
from sean_jax.learning import protocol
from sean_jax.learning.options import Collect, Failed
from sean_jax.learning.protocol import Stream, streams, who_drives
from sean_jax.options import written

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Array, Moment, Scenario

SWEPT = "random", "graph"  # behaviors whose number of people can be chosen
CHAIN = 6  # minutes of a chain, which an hour, a half and a fifth of it are multiples of
STARTS = 64  # of each stream and seed, from which its chains restart


@dataclasses.dataclass
class Cell:
    """One behavior with one driver and so many people."""

    behavior: str
    driver: str
    people: int
    flags: np.ndarray  # (V, blocks, 60, 5) bool
    ended: np.ndarray  # (2,) episodes completed and not

    def shares(self, speed: int = 0) -> Shares:
        """With the walking speed of that index."""
        return shares.count(self.flags[speed])


def run(options: Experiment, console: Console | None = None) -> Path:
    """Simulate what is missing, and write the report; the folder.

    Raises Refused for what cannot be asked for, Unwritable if somebody else writes in the folder, FloatingPointError
    for numbers that are not finite; what was finished before stays.
    """
    options = options.settled()
    drivers = list(dict.fromkeys(name.strip() for name in options.drivers.split(",") if name.strip()))
    for name in drivers:
        who_drives(name, "--drivers")
    for behavior, people in [(each, options.people) for each in BEHAVIORS] + [
        (each, crowd) for crowd in options.crowds or () for each in SWEPT
    ]:
        protocol.check(_asked(options, behavior, people))
    folder, known = options.folder, parts.begun(options)
    jobs = [(behavior, driver, options.people) for driver in drivers for behavior in BEHAVIORS]
    sweep = [(behavior, drivers[0], people) for people in options.crowds or () for behavior in SWEPT]
    places = Once(functools.partial(_places, options))
    with writing.held(folder):
        for behavior, _, people in [] if known else dict.fromkeys([*jobs, *sweep]):
            places(behavior, people)  # to refuse what cannot be before anything is written
        parts.begin(options)
        _run(options, folder, console, places, jobs, sweep)
    return folder


def _run(options: Experiment, folder: Path, console: Console | None, places: Once, jobs: list, sweep: list) -> None:
    parts_of = [
        Part(_named(*job), functools.partial(_cell, options, folder, *job, places))
        for job in dict.fromkeys([*jobs, *sweep])
    ]
    found = together(parts_of, console, "driving")
    write(options, folder, *([found[_named(*job)] for job in each] for each in (jobs, sweep)))


def _named(behavior: str, driver: str, people: int | None) -> str:
    return f"{behavior}, {driver}" + ("" if people is None else f", {people} people")


def _asked(options: Experiment, behavior: str, people: int | None) -> Collect:
    return Collect(
        behavior=behavior, environment=options.environment, people=None if behavior == "handcrafted" else people,
        robot=options.robot, dynamics=options.dynamics, time_limit=options.time_limit,
    )  # fmt: skip


def _places(options: Experiment, behavior: str, people: int | None) -> tuple[list[Stream], tuple]:
    """The streams of the protocol, with situations for each walking speed, and their tasks."""
    kinds, tasks = streams(_asked(options, behavior, people))
    held = _at_speeds(kinds[0].scenario, options.speeds)
    kinds = [dataclasses.replace(k, scenario=dataclasses.replace(k.scenario, situations=held)) for k in kinds]
    return kinds, tasks


def _cell(
    options: Experiment,
    folder: Path,
    behavior: str,
    driver: str,
    people: int | None,
    places: Once,
    watch: Callable[[float], None],
) -> Cell:
    """As saved in the folder, or simulated."""
    file = folder / f"{behavior}-{driver}{'' if people is None else f'-{people}'}.npz"
    if file.is_file():
        try:
            with np.load(file, allow_pickle=False) as kept:
                flags = np.unpackbits(kept["flags"], axis=-1, count=len(shares.NAMES)).astype(bool)
                return Cell(behavior, driver, int(kept["people"]), flags, kept["ended"])
        except writing.DAMAGED as error:
            raise Failed(f"{file} is damaged ({error}); remove it, and the same command makes it anew.") from error
    kinds, tasks = places(behavior, people)
    seeds, speeds = options.seeds or 1, options.speeds
    wanted = max(1, math.ceil(60.0 * (options.hours or 1.0) / len(kinds) - 1e-6))
    each = min(CHAIN, wanted)
    chains = seeds * math.ceil(wanted / each)
    flags, ended = Chains(tasks, who_drives(driver)).minutes(kinds, options.seed, chains, each, STARTS * seeds, watch)
    flags = np.moveaxis(flags.reshape(-1, MINUTE, len(speeds), len(shares.NAMES)), 2, 0)
    with writing.whole(file) as stream:
        np.savez_compressed(stream, flags=np.packbits(flags, axis=-1), people=kinds[0].scenario.people, ended=ended)
    return Cell(behavior, driver, kinds[0].scenario.people, flags, ended)


def _at_speeds(scenario: Scenario, speeds: tuple[float, ...]) -> tuple:
    """The paper's situations once for each walking speed, to take the place of the scenario's."""
    return tuple(
        (f"{name}_{written(speed)}", functools.partial(_at, holds, speed))
        for speed in speeds
        for name, holds in scenario.situations
    )


def _at(holds: Callable, speed: float, moment: Moment, thresholds: Any) -> Array:
    return holds(moment, dataclasses.replace(thresholds, walking=jnp.asarray(speed, float)))


def write(options: Experiment, folder: Path, cells: list[Cell], swept: list[Cell]) -> None:
    """shares.csv, entropies.csv, orderings.csv, the figures and report.html."""
    lines = ["driver,behavior,people,V,counting,situation,share,low,high"]
    entropies = ["driver,behavior,people,V,counting,entropy,low,high,examples,none,completed,not_completed"]
    for cell in [*cells, *swept]:
        for index, speed in enumerate(options.speeds):
            found = cell.shares(index)
            for counting in ("multi", "exclusive"):
                samples = getattr(found, counting)
                low, high = shares.interval(samples)
                head = f"{cell.driver},{cell.behavior},{cell.people},{written(speed)},{counting}"
                for k, name in enumerate(shares.NAMES):
                    lines.append(f"{head},{name},{samples[0, k]:.5f},{low[k]:.5f},{high[k]:.5f}")
                entropy = shares.normalised_entropy(samples)
                ends = shares.interval(entropy)
                rest = f"{found.examples},{found.none:.5f},{cell.ended[0]},{cell.ended[1]}"
                entropies.append(f"{head},{entropy[0]:.5f},{ends[0]:.5f},{ends[1]:.5f},{rest}")
    parts.save(folder / "shares.csv", "\n".join(lines) + "\n")
    parts.save(folder / "entropies.csv", "\n".join(entropies) + "\n")
    held = ["driver,V,counting,ordering,hard,statement,holds,share_of_resamples"]
    for driver in dict.fromkeys(cell.driver for cell in cells):
        for index, speed in enumerate(options.speeds):
            found = {cell.behavior: cell.shares(index) for cell in cells if cell.driver == driver}
            for exclusive in (True, False):
                for row in shares.orderings(found, exclusive):
                    name = "exclusive" if exclusive else "multi"
                    held.append(f'{driver},{written(speed)},{name},{row["name"]},{row["hard"]},"{row["statement"]}",'
                                f"{row['holds']},{row['share']:.4f}")  # fmt: skip
    parts.save(folder / "orderings.csv", "\n".join(held) + "\n")
    figures = pictures.table1(options, cells, swept)
    pictures.save(folder, figures)
    parts.save(folder / "report.html", page.table1(options, cells, figures))

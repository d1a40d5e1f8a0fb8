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

from sean_jax.experiments import page, parts, shares
from sean_jax.experiments.options import BEHAVIORS, Experiment
from sean_jax.experiments.rollouts import MINUTE, Chains
from sean_jax.experiments.shares import Shares
from sean_jax.learning.options import Collect, Refused
from sean_jax.learning.progress import shown
from sean_jax.learning.protocol import streams, who_drives

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Array, Moment, Scenario

SWEPT = "random", "graph"  # behaviors whose number of people can be chosen


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

    Raises Refused for what cannot be asked for, FloatingPointError for numbers that are not finite; what was finished
    before stays.
    """
    options = options.settled()
    drivers = [name.strip() for name in options.drivers.split(",") if name.strip()]
    if not drivers:
        raise Refused("--drivers names nobody, try --drivers go_to_goal.")
    for name in drivers:
        who_drives(name, "--drivers")
    folder = parts.begin(options)
    jobs = [(behavior, driver, options.people) for driver in drivers for behavior in BEHAVIORS]
    jobs += [(behavior, drivers[0], people) for people in options.crowds or () for behavior in SWEPT]
    cells = []
    with shown(console, "driving", len(jobs)) as tell:
        for number, (behavior, driver, people) in enumerate(jobs):
            what = f"{behavior}, {driver}" + (f", {people} people" if people else "")

            def watch(share: float, number: int = number, what: str = what) -> None:
                tell(number + share, what)

            watch(0.0)
            cells.append(_cell(options, folder, behavior, driver, people, watch))
    write(options, folder, cells[: len(drivers) * len(BEHAVIORS)], cells[len(drivers) * len(BEHAVIORS) :])
    return folder


def _cell(options: Experiment, folder: Path, behavior: str, driver: str, people: int | None, watch: Callable) -> Cell:
    """As saved in the folder, or simulated."""
    file = folder / f"{behavior}-{driver}{'' if people is None else f'-{people}'}.npz"
    if file.is_file():
        with np.load(file) as kept:
            flags = np.unpackbits(kept["flags"], axis=-1, count=len(shares.NAMES)).astype(bool)
            return Cell(behavior, driver, int(kept["people"]), flags, kept["ended"])
    asked = Collect(
        behavior=behavior, environment=options.environment, people=None if behavior == "handcrafted" else people,
        robot=options.robot, dynamics=options.dynamics, time_limit=options.time_limit,
    )  # fmt: skip
    kinds, tasks = streams(asked)
    speeds = options.speeds
    chains = None
    # A chain is ten minutes long, or as long as there is time for.
    wanted = max(1, math.ceil(60.0 * (options.hours or 1.0) / len(kinds) - 1e-6))
    each = min(10, wanted)
    number = (options.seeds or 1) * math.ceil(wanted / each)
    found, ended = [], np.zeros(2, int)
    for turn, kind in enumerate(kinds):
        scenario = _with_speeds(kind.scenario, speeds)
        chains = chains or Chains(tasks, who_drives(driver))
        done = lambda minutes, turn=turn: watch((turn + minutes / each) / len(kinds))  # noqa: E731
        flags, over = chains.minutes(scenario, kind.turn, options.seed + 1000 * turn, number, each, done)
        found.append(flags.reshape(-1, MINUTE, len(speeds), len(shares.NAMES)))
        ended += over
    flags = np.moveaxis(np.concatenate(found), 2, 0)
    temporary = file.with_name(f".{file.name}")
    with temporary.open("wb") as stream:
        np.savez_compressed(stream, flags=np.packbits(flags, axis=-1), people=kinds[0].scenario.people, ended=ended)
    temporary.replace(file)
    return Cell(behavior, driver, kinds[0].scenario.people, flags, ended)


def _with_speeds(scenario: Scenario, speeds: tuple[float, ...]) -> Scenario:
    """The scenario with the paper's situations once for each walking speed."""
    held = tuple(
        (f"{name}_{speed:g}", functools.partial(_at, holds, speed))
        for speed in speeds
        for name, holds in scenario.situations
    )
    return dataclasses.replace(scenario, situations=held)


def _at(holds: Callable, speed: float, moment: Moment, thresholds: Any) -> Array:
    return holds(moment, dataclasses.replace(thresholds, walking=jnp.asarray(speed, jnp.float32)))


def write(options: Experiment, folder: Path, cells: list[Cell], swept: list[Cell]) -> None:
    """table1.csv, sweeps.csv, orderings.csv and report.html."""
    lines = ["driver,behavior,people,V,counting,situation,share,low,high"]
    entropies = ["driver,behavior,people,V,counting,entropy,low,high,examples,none,completed,not_completed"]
    for cell in [*cells, *swept]:
        for index, speed in enumerate(options.speeds):
            found = cell.shares(index)
            for counting in ("multi", "exclusive"):
                samples = getattr(found, counting)
                low, high = shares.interval(samples)
                head = f"{cell.driver},{cell.behavior},{cell.people},{speed:g},{counting}"
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
                    held.append(f'{driver},{speed:g},{name},{row["name"]},{row["hard"]},"{row["statement"]}",'
                                f"{row['holds']},{row['share']:.4f}")  # fmt: skip
    parts.save(folder / "orderings.csv", "\n".join(held) + "\n")
    parts.save(folder / "report.html", page.table1(options, cells, swept))

"""Table I: how much of the time a robot is in each social situation, with people of three behaviors (section V-B).

Each behavior and policy is simulated for an hour or more by the paper's protocol, with several seeds, and compared with
the paper's row. Sweeps vary the number of people and the speed V above which people count as walking, since the paper's
1.4 m/s is faster than most people walk. Situations beyond the paper's five are counted besides, and all of them in
recordings of people.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from sean_jax import files, writing
from sean_jax.classifiers import MORE_SITUATIONS
from sean_jax.config import CollectConfig, ExperimentConfig, ScenarioConfig, SituationConfig, Table1Config
from sean_jax.errors import InputError
from sean_jax.files import listed
from sean_jax.flags import number
from sean_jax.learning.collection import check_collection, streams
from sean_jax.learning.policy import check_policy, load_policy
from sean_jax.studies.experiments import page, parts, pictures, recorded, shares
from sean_jax.studies.experiments.recorded import Recorded
from sean_jax.studies.experiments.rollouts import MINUTE, Chains, Streams
from sean_jax.studies.experiments.shares import BEHAVIORS, Shares
from sean_jax.studies.experiments.together import Once, Part, together

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Array, Moment, Scenario
    from sean_jax.classifiers import Situation, Thresholds

SWEPT = "random", "graph"  # behaviors whose number of people can be chosen
CHAIN = 6  # minutes of a chain, which an hour, a half and a fifth of it are multiples of
TOLD = "environment", "robot", "dynamics", "time_limit"  # options that scenarios have as well
FURTHER = tuple(MORE_SITUATIONS.items())
STARTS = 64  # of each stream and seed, from which its chains restart


@dataclasses.dataclass
class Cell:
    """Examples with one behavior, one policy and one number of people."""

    behavior: str
    policy: str
    people: int
    flags: np.ndarray  # (V, blocks, 60, 5) bool
    more: np.ndarray  # (blocks, 60, M) bool, the further situations, which do not depend on V
    ended: np.ndarray  # (2,) episodes completed and not
    streams: int  # of the protocol, each with as many blocks

    def shares(self, speed: int = 0) -> Shares:
        """Shares of the situations."""
        return shares.count(self.flags[speed], streams=self.streams)

    def further(self) -> Shares:
        """Shares of the situations beyond the paper's five."""
        return shares.count(self.more, streams=self.streams)


def run(options: Table1Config, console: Console | None = None) -> Path:
    """Simulate what the folder lacks, and write the report.

    Args:
        console: shows progress; None shows nothing.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        FileError: a recording cannot be read.
        WriteError: another process writes in the folder.
        FileError: a file in the folder is damaged.
        FloatingPointError: a position is not finite. Finished cells stay.

    Source: section V-B, Table I.
    """
    drivers = [] if listed(options.policies) == ["none"] and listed(options.recordings) else policies(options)
    jobs = [(behavior, policy, options.people) for policy in drivers for behavior in BEHAVIORS]
    sweep = [(behavior, policy, crowd) for policy in drivers[:1] for crowd in options.crowds for behavior in SWEPT]
    for behavior, _, people in [*jobs, *sweep]:
        check_collection(description(options, behavior, people))
    kind = description(options, "random", None).situations[0].kind
    real = recorded.read(listed(options.recordings), options.frame_rate)
    folder, started = options.folder, parts.has_started(options)
    places = Once(functools.partial(_places, options))
    with writing.folder_lock(folder):
        for behavior, _, people in [] if started else dict.fromkeys([*jobs, *sweep]):
            places(behavior, people)  # so that wrong options are refused before anything is written
        parts.start(options)
        counted = [
            Part(name, functools.partial(recorded.count, name, each, options.speeds, kind=kind))
            for name, each in real.items()
        ]
        found = together(counted, console, "counting")
        _run(options, folder, console, places, jobs, sweep, [found[name] for name in real])
    return folder


def _run(
    options: Table1Config,
    folder: Path,
    console: Console | None,
    places: Once,
    jobs: list,
    sweep: list,
    real: list[Recorded],
) -> None:
    parts_of = [
        Part(_part_name(*job), functools.partial(_cell, options, folder, *job, places))
        for job in dict.fromkeys([*jobs, *sweep])
    ]
    results = together(parts_of, console, "driving")
    cells, swept = ([results[_part_name(*job)] for job in each] for each in (jobs, sweep))
    write(options, folder, cells, swept, real)


def _part_name(behavior: str, policy: str, people: int | None) -> str:
    return f"{behavior}, {policy}" + ("" if people is None else f", {people} people")


def policies(options: SituationConfig) -> list[str]:
    """Who drives.

    Returns:
        Names or folders, each once.

    Raises:
        InputError: there is none, or no policy of that name.
    """
    names = list(dict.fromkeys(listed(options.policies)))
    if not names:
        raise InputError("--policies names no policy; try --policies go_to_goal.")
    for name in names:
        check_policy(name, ScenarioConfig(), "--policies")
    return names


def description(options: Table1Config, behavior: str, people: int | None) -> CollectConfig:
    """What is simulated with people of a behavior.

    Args:
        behavior: random, handcrafted or graph.
        people: how many; None for as many as the environment says, and with handcrafted people.
    """
    return CollectConfig(preset=options.preset, **fields(options, behavior, people))


def fields(options: ExperimentConfig, behavior: str, people: int | None) -> dict[str, Any]:
    """What an experiment was told of its scenarios; a preset may fill in the rest.

    Args:
        behavior: random, handcrafted or graph.
        people: how many; None for as many as the environment says, and with handcrafted people.
    """
    told = {name: getattr(options, name) for name in TOLD if name in options.model_fields_set}
    return told | {"behavior": behavior, "people": None if behavior == "handcrafted" else people}


def _places(options: Table1Config, behavior: str, people: int | None) -> Streams:
    """The streams of the protocol, with situations for each walking speed."""
    kinds = list(streams(description(options, behavior, people)).values())
    situations = _at_speeds(kinds[0], options.speeds)
    return with_starts(options, [dataclasses.replace(kind, situations=situations) for kind in kinds])


def with_starts(options: SituationConfig, kinds: list[Scenario]) -> Streams:
    """The streams of the protocol, with as many starts as the experiment needs."""
    return Streams(kinds, options.seed, STARTS * options.seeds)


def _cell(
    options: Table1Config,
    folder: Path,
    behavior: str,
    policy: str,
    people: int | None,
    places: Once,
    watch: Callable[[float], None],
) -> Cell:
    file = folder / f"{behavior}-{policy}{'' if people is None else f'-{people}'}.npz"
    return cell(options, file, behavior, policy, lambda: places(behavior, people), watch, FURTHER)


def cell(
    options: SituationConfig,
    file: Path,
    behavior: str,
    policy: str,
    places: Callable[[], Streams],
    watch: Callable[[float], None],
    further: tuple[tuple[str, Situation], ...] = (),
) -> Cell:
    """A cell from its file, or simulated.

    Args:
        places: the streams of the protocol. Their situations may be those of several walking speeds, one after another.
        watch: called with the finished share.
        further: names and functions of situations that are noted besides. A file without them is made anew.

    Raises:
        FileError: the file is damaged.
        FloatingPointError: a position is not finite.
    """
    names = tuple(name for name, _ in further)
    if file.is_file():
        arrays = files.read_arrays(file)
        with files.sentence(file, "remove it, and the same command makes it anew"):
            flags = np.unpackbits(arrays["flags"], axis=-1, count=len(shares.NAMES)).astype(bool)
            if not further or tuple(arrays["names"] if "names" in arrays else ()) == names:
                more = np.unpackbits(arrays["more"], axis=-1, count=len(names)).astype(bool)
                number = int(arrays["streams"]) if "streams" in arrays else len(places().scenarios)
                return Cell(behavior, policy, int(arrays["people"]), flags, more, arrays["ended"], number)
    there, seeds = places(), options.seeds
    kinds = there.scenarios
    minutes = max(1, math.ceil(60.0 * options.hours / len(kinds) - 1e-6))
    each = min(CHAIN, minutes)
    chains = seeds * math.ceil(minutes / each)
    chain = Chains(load_policy(policy, kinds[0]), further)
    flags, ended = chain.minutes(there, chains, each, watch)
    flags, more = np.split(flags.reshape(-1, MINUTE, flags.shape[-1]), [flags.shape[-1] - len(names)], axis=-1)
    flags = np.moveaxis(flags.reshape(*flags.shape[:2], -1, len(shares.NAMES)), 2, 0)
    packed = {"flags": np.packbits(flags, axis=-1), "more": np.packbits(more, axis=-1), "names": np.array(names, str)}
    with writing.atomic_file(file) as stream:
        np.savez_compressed(stream, **packed, people=kinds[0].people, ended=ended, streams=len(kinds))
    return Cell(behavior, policy, kinds[0].people, flags, more, ended, len(kinds))


def _at_speeds(scenario: Scenario, speeds: tuple[float, ...]) -> tuple:
    """The scenario's situations, repeated for each walking speed."""
    return tuple(
        (f"{name}_{number(speed)}", functools.partial(_at, holds, speed))
        for speed in speeds
        for name, holds in scenario.situations
    )


def _at(holds: Callable, speed: float, moment: Moment, thresholds: Thresholds) -> Array:
    return holds(moment, dataclasses.replace(thresholds, walking=jnp.asarray(speed, float)))


def write(
    options: Table1Config, folder: Path, cells: list[Cell], swept: list[Cell], real: list[Recorded] | None = None
) -> None:
    """Write shares.csv, more.csv, entropies.csv, orderings.csv, recordings.csv, the figures and report.html.

    Args:
        cells: of each policy and behavior, with the experiment's number of people.
        real: recordings, none by default.

    Raises:
        WriteError: another process writes one of the files.
    """
    lines = ["policy,behavior,people,V,counting,situation,share,low,high"]
    more = ["policy,behavior,people,situation,share,low,high"]
    entropies = ["policy,behavior,people,V,entropy,low,high,examples,none,completed,not_completed"]
    for cell in [*cells, *swept]:
        more += _rows(f"{cell.policy},{cell.behavior},{cell.people}", list(MORE_SITUATIONS), cell.further().examples)
        for index, speed in enumerate(options.speeds):
            estimate = cell.shares(index)
            for counting in shares.COUNTINGS:
                head = f"{cell.policy},{cell.behavior},{cell.people},{number(speed)},{counting}"
                lines += _rows(head, shares.NAMES, estimate.of(counting))
            entropy = estimate.entropy()
            ends = shares.interval(entropy)
            rest = f"{estimate.seconds},{estimate.none[0]:.5f},{cell.ended[0]},{cell.ended[1]}"
            head = f"{cell.policy},{cell.behavior},{cell.people},{number(speed)}"
            entropies.append(f"{head},{entropy[0]:.5f},{ends[0]:.5f},{ends[1]:.5f},{rest}")
    parts.save(folder / "shares.csv", "\n".join(lines) + "\n")
    parts.save(folder / "more.csv", "\n".join(more) + "\n")
    parts.save(folder / "entropies.csv", "\n".join(entropies) + "\n")
    if real:
        parts.save(folder / "recordings.csv", "\n".join(_recorded(options, real)) + "\n")
    ordering_lines = ["policy,V,counting,ordering,hard,statement,holds,share_of_resamples"]
    for policy in dict.fromkeys(cell.policy for cell in cells):
        for index, speed in enumerate(options.speeds):
            by_behavior = {cell.behavior: cell.shares(index) for cell in cells if cell.policy == policy}
            for counting in shares.COUNTINGS:
                for row in shares.orderings(by_behavior, counting):
                    ordering_lines.append(f'{policy},{number(speed)},{counting},{row["name"]},{row["hard"]},"{row["statement"]}",'
                                f"{row['holds']},{row['share']:.4f}")  # fmt: skip
    parts.save(folder / "orderings.csv", "\n".join(ordering_lines) + "\n")
    figures = pictures.table1(options, cells, swept)
    pictures.save(folder, figures)
    parts.save(folder / "report.html", page.table1(options, cells, figures, real or []))


def _rows(head: str, names: Sequence[str], samples: np.ndarray, known: Collection[str] | None = None) -> list[str]:
    """A line for each situation that is known: its share and the ends of its interval."""
    low, high = shares.interval(samples)
    return [
        f"{head},{name},{samples[0, k]:.5f},{low[k]:.5f},{high[k]:.5f}"
        for k, name in enumerate(names)
        if known is None or name in known
    ]


def _recorded(options: Table1Config, real: list[Recorded]) -> list[str]:
    lines = ["recording,people,V,counting,situation,share,low,high"]  # no V where a situation does not depend on it
    for each in real:
        for index, speed in enumerate(options.speeds):
            estimate = each.shares(index)
            for counting in shares.COUNTINGS:
                head = f"{each.name},{each.people},{number(speed)},{counting}"
                lines += _rows(head, shares.NAMES, estimate.of(counting), each.known)
        head = f"{each.name},{each.people},,examples"
        lines += _rows(head, list(MORE_SITUATIONS), each.further().examples, each.known)
    return lines

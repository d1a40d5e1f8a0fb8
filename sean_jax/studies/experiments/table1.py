"""Table I: the share of time of a robot in each social situation, with people of three behaviors (section V-B).

Each behavior and policy is simulated for an hour or more by the paper's protocol, with several seeds, and compared with
the paper's row. Sweeps vary the number of people and the speed V above which people count as walking, since the paper's
1.4 m/s is faster than most people walk. Further situations are counted too, and all of them in recordings of people.
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
from sean_jax.studies.experiments import page, pictures, shares
from sean_jax.studies.experiments.chains import MINUTE, Chains, Streams
from sean_jax.studies.experiments.scheduler import Part, cached, run_parts
from sean_jax.studies.experiments.shares import BEHAVIORS, Cell, Recorded
from sean_jax.workspace import REMAKE, Workspace, identity

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Array, Scenario, Snapshot
    from sean_jax.classifiers import Situation, Thresholds

SWEPT = "random", "graph"  # behaviors whose number of people can be chosen
CHAIN = 6  # minutes of a chain, which an hour, a half and a fifth of it are multiples of
SHARED = "environment", "robot", "dynamics", "time_limit"  # options of the experiment and of its scenarios
MORE = tuple(MORE_SITUATIONS.items())
STARTS = 64  # of each stream and seed, from which its chains restart


def run(options: Table1Config, console: Console | None = None) -> Path:
    """Simulate what the folder lacks, and write the report.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        FileError: a recording cannot be read, or a file in the folder is damaged.
        WriteError: another process writes in the folder.
        FloatingPointError: a position is not finite. Finished cells stay.

    Source: section V-B, Table I.
    """
    names = [] if listed(options.policies) == ["none"] and listed(options.recordings) else policies(options)
    jobs = [(behavior, policy, options.people) for policy in names for behavior in BEHAVIORS]
    sweep = [(behavior, policy, crowd) for policy in names[:1] for crowd in options.crowds for behavior in SWEPT]
    for behavior, _, people in [*jobs, *sweep]:
        check_collection(description(options, behavior, people))
    kind = description(options, "random", None).situations[0].kind
    real = shares.read_recordings(listed(options.recordings), options.frame_rate)
    with Workspace(options.folder, identity(options)).open() as work:
        places = cached(functools.partial(_places, options))
        for behavior, _, people in [] if work.begun() else dict.fromkeys([*jobs, *sweep]):
            places(behavior, people)  # so that wrong options are refused before anything is written
        work.begin()
        counting = [
            Part(name, functools.partial(shares.count_recording, name, each, options.speeds, kind=kind))
            for name, each in real.items()
        ]
        recordings = run_parts(counting, console, "counting")
        driving = [
            Part(_part_name(*job), functools.partial(_cell, options, work, *job, places))
            for job in dict.fromkeys([*jobs, *sweep])
        ]
        results = run_parts(driving, console, "driving")
        cells, swept = ([results[_part_name(*job)] for job in each] for each in (jobs, sweep))
        write(options, cells, swept, [recordings[name] for name in real])
    return options.folder


def _part_name(behavior: str, policy: str, people: int | None) -> str:
    return f"{behavior}, {policy}" + ("" if people is None else f", {people} people")


def policies(options: SituationConfig) -> list[str]:
    """The policies, names or folders, each once.

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
    """The scenario with so many people of a behavior: random, handcrafted or graph."""
    return CollectConfig(preset=options.preset, **fields(options, behavior, people))


def fields(options: ExperimentConfig, behavior: str, people: int | None) -> dict[str, Any]:
    """The options of an experiment's scenarios; a preset may fill in the rest.

    ``people`` None is the environment's number; handcrafted people have their own.
    """
    chosen = {name: getattr(options, name) for name in SHARED if name in options.model_fields_set}
    return chosen | {"behavior": behavior, "people": None if behavior == "handcrafted" else people}


def _places(options: Table1Config, behavior: str, people: int | None) -> Streams:
    """The streams of the protocol, with situations for each walking speed."""
    kinds = list(streams(description(options, behavior, people)).values())
    situations = _at_speeds(kinds[0], options.speeds)
    return with_starts(options, [dataclasses.replace(kind, situations=situations) for kind in kinds])


def with_starts(options: SituationConfig, kinds: list[Scenario]) -> Streams:
    """The streams of the protocol with their starts."""
    return Streams(kinds, options.seed, STARTS * options.seeds)


def _cell(
    options: Table1Config,
    work: Workspace,
    behavior: str,
    policy: str,
    people: int | None,
    places: Callable[..., Streams],
    tell: Callable[[float], None],
) -> Cell:
    file = f"{behavior}-{policy}{'' if people is None else f'-{people}'}.npz"
    return cell(options, work, file, behavior, policy, lambda: places(behavior, people), tell, MORE)


def cell(
    options: SituationConfig,
    work: Workspace,
    file: str,
    behavior: str,
    policy: str,
    places: Callable[[], Streams],
    tell: Callable[[float], None],
    more: tuple[tuple[str, Situation], ...] = (),
) -> Cell:
    """A cell from its file, or simulated.

    Args:
        places: gives the streams of the protocol, with situations of one or several walking speeds.
        tell: called with the finished share.
        more: names and functions of further situations. A file without them is made anew.

    Raises:
        FileError: the file is damaged.
        FloatingPointError: a position is not finite.
    """
    names = tuple(name for name, _ in more)
    arrays = work.load(file)
    if arrays is not None:
        with files.sentence(work.folder / file, REMAKE):
            flags = np.unpackbits(arrays["flags"], axis=-1, count=len(shares.NAMES)).astype(bool)
            if not more or tuple(arrays["names"] if "names" in arrays else ()) == names:
                others = np.unpackbits(arrays["more"], axis=-1, count=len(names)).astype(bool)
                number = int(arrays["streams"]) if "streams" in arrays else len(places().scenarios)
                return Cell(behavior, policy, int(arrays["people"]), flags, others, arrays["ended"], number)
    pool, seeds = places(), options.seeds
    kinds = pool.scenarios
    minutes = max(1, math.ceil(60.0 * options.hours / len(kinds) - 1e-6))
    each = min(CHAIN, minutes)
    chains = seeds * math.ceil(minutes / each)
    flags, ended = Chains(load_policy(policy, kinds[0]), more).minutes(pool, chains, each, tell)
    flags, others = np.split(flags.reshape(-1, MINUTE, flags.shape[-1]), [flags.shape[-1] - len(names)], axis=-1)
    flags = np.moveaxis(flags.reshape(*flags.shape[:2], -1, len(shares.NAMES)), 2, 0)
    packed = {"flags": np.packbits(flags, axis=-1), "more": np.packbits(others, axis=-1), "names": np.array(names, str)}
    work.save(file, packed | {"people": kinds[0].people, "ended": ended, "streams": len(kinds)})
    return Cell(behavior, policy, kinds[0].people, flags, others, ended, len(kinds))


def _at_speeds(scenario: Scenario, speeds: tuple[float, ...]) -> tuple:
    """The scenario's situations, repeated for each walking speed."""
    return tuple(
        (f"{name}_{number(speed)}", functools.partial(_at, holds, speed))
        for speed in speeds
        for name, holds in scenario.situations
    )


def _at(holds: Callable, speed: float, snapshot: Snapshot, thresholds: Thresholds) -> Array:
    return holds(snapshot, dataclasses.replace(thresholds, walking=jnp.asarray(speed, float)))


def write(options: Table1Config, cells: list[Cell], swept: list[Cell], real: list[Recorded]) -> None:
    """Write shares.csv, more.csv, entropies.csv, orderings.csv, recordings.csv, the figures and report.html.

    ``cells`` have the experiment's number of people, ``swept`` other numbers.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, lines = options.folder, ["policy,behavior,people,V,counting,situation,share,low,high"]
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
    writing.write(folder / "shares.csv", "\n".join(lines) + "\n")
    writing.write(folder / "more.csv", "\n".join(more) + "\n")
    writing.write(folder / "entropies.csv", "\n".join(entropies) + "\n")
    if real:
        writing.write(folder / "recordings.csv", "\n".join(_recorded(options, real)) + "\n")
    ordering_lines = ["policy,V,counting,ordering,hard,statement,holds,share_of_resamples"]
    for policy in dict.fromkeys(cell.policy for cell in cells):
        for index, speed in enumerate(options.speeds):
            by_behavior = {cell.behavior: cell.shares(index) for cell in cells if cell.policy == policy}
            for counting in shares.COUNTINGS:
                for row in shares.orderings(by_behavior, counting):
                    ordering_lines.append(f'{policy},{number(speed)},{counting},{row["name"]},{row["hard"]},"{row["statement"]}",'
                                f"{row['holds']},{row['share']:.4f}")  # fmt: skip
    writing.write(folder / "orderings.csv", "\n".join(ordering_lines) + "\n")
    figures = pictures.table1(options, cells, swept)
    pictures.save(folder, figures)
    writing.write(folder / "report.html", page.table1(options, cells, figures, real))


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

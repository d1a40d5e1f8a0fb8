"""Table I: the share of time of a robot in each social situation, with people of three behaviors (section V-B).

Each behavior and policy is simulated for an hour or more by the paper's protocol, with several seeds, and the paper's
row is compared with the interval of one hour. Sweeps vary the number of people and the speed V above which people count
as walking, since the paper's 1.4 m/s is faster than most people walk. Further situations are counted too, and all of
them in recordings of people.

The time is split into chains: episodes without a break, many at once. The streams of the protocol differ in what a
reset draws, but not in what a step reads. So each stream has its own pool of starts, and the chains of all streams run
in one batch (``episodes.rollout_autoreset``).

The ablation is Table I under several conditions: this package's, SEAN 2.0's, the former with one switch of SEAN 2.0
each, and the latter without one switch each. So each cell, and each of the paper's orderings, is traced to the switch
that moves it, also where switches depend on each other.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.classifiers import MORE_SITUATIONS, classify
from sean_jax.config import (
    PRESETS,
    AblationConfig,
    CollectConfig,
    ExperimentConfig,
    ScenarioConfig,
    SituationConfig,
    Table1Config,
    validate,
    with_defaults,
)
from sean_jax.config.flags import number
from sean_jax.config.workspace import REMAKE, Workspace, identity
from sean_jax.core import devices, random_streams
from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.io.files import listed
from sean_jax.learning.collection import check_collection, streams
from sean_jax.learning.policy import check_policy, load_policy
from sean_jax.simulation import episode_runner, episodes
from sean_jax.simulation.episodes import ResetPool
from sean_jax.simulation.scenario import snapshot
from sean_jax.studies.experiments import (
    ExperimentPart,
    cached,
    demonstrations,
    page,
    pictures,
    run_parts,
    shares,
    write_csv,
)
from sean_jax.studies.experiments.results_table import Table, join
from sean_jax.studies.experiments.shares import (
    BEHAVIORS,
    by_policy,
    chain_rows,
    chain_shares,
    interval_rows,
    ordering_rows,
    people_shares,
    share_rows,
)

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.classifiers import Situation, Thresholds
    from sean_jax.core.data_types import Array, Policy, Scenario, Snapshot, State

SWEPT = "random", "graph"  # behaviors whose number of people can be chosen
CHAIN = 6  # minutes of a chain, which an hour, a half and a fifth of it are multiples of
MINUTE = 60  # s
LEAD = 1  # min at the start of each chain that are not counted, since all chains begin with a start of an episode
SHARED = "environment", "robot", "dynamics", "time_limit"  # options of the experiment and of its scenarios
MORE = tuple(MORE_SITUATIONS.items())
CELL = "policy", "behavior", "people"  # columns of the labels of a cell of the table
RECORDING = "behavior", "people", "speed"
STARTS = 64  # of each stream and seed, from which its chains restart


def run_table1(options: Table1Config, console: Console | None = None) -> Path:
    """Simulate the missing parts of the folder, and write the report.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        FileError: a recording cannot be read, or a file in the folder is damaged.
        WriteError: another process writes in the folder.
        FloatingPointError: a position is not finite. Finished cells stay.

    Source: section V-B, Table I.
    """
    # A table of recordings or demonstrations alone needs no simulation.
    others = listed(options.recordings) or options.demonstrations
    names = [] if listed(options.policies) == ["none"] and others else policies(options)

    # The density of the crowd is swept with one policy alone: it asks about people, not about the robot.
    jobs = [(behavior, policy, options.people) for policy in names for behavior in BEHAVIORS]
    sweep = [(behavior, policy, crowd) for policy in names[:1] for crowd in options.crowds for behavior in SWEPT]

    # Simulations take long: a wrong option of the last one is refused before the first one begins.
    for behavior, _, people in [*jobs, *sweep]:
        check_collection(description(options, behavior, people))

    # Situations of recordings are counted as the simulator counts them.
    kind = description(options, "random", None).situations[0].kind
    real = shares.read_recordings(listed(options.recordings), options.frame_rate)
    driven = demonstrations.examples(demonstrations.read(options.demonstrations))

    # The folder belongs to these options alone: finished cells are read and not simulated again.
    with Workspace(options.folder, identity(options)).open() as work:
        pools = cached(functools.partial(_streams, options))
        by_name = {_name(*job): job for job in [*jobs, *sweep]}
        for behavior, _, people in () if work.begun() else by_name.values():
            pools(behavior, people)  # so that wrong options are refused before anything is written
        work.begin()

        # Recordings are counted without a simulation, so they come first: a damaged one stops the command soon.
        counting = [
            ExperimentPart(name, functools.partial(shares.count_recording, name, tracks, options.speeds, kind=kind))
            for name, tracks in real.items()
        ]
        recordings = run_parts(counting, console, "counting")

        simulate = functools.partial(cell, options, work, more=MORE, speeds=[number(speed) for speed in options.speeds])
        driving = [
            ExperimentPart(
                name, functools.partial(simulate, name, behavior, policy, functools.partial(pools, behavior, people))
            )
            for name, (behavior, policy, people) in by_name.items()
        ]
        cells = run_parts(driving, console, "driving")

        # Cells of both are simulated once where they agree.
        measured, swept = (join(cells[_name(*job)] for job in chosen) for chosen in (jobs, sweep))
        write_table1(options, measured, swept, join(recordings[name] for name in real), driven)
    return options.folder


def _name(behavior: str, policy: str, people: int | None) -> str:
    return f"{behavior}-{policy}{'' if people is None else f'-{people}'}"


def policies(options: SituationConfig) -> list[str]:
    """The policies, names or folders, each once.

    Raises:
        InputError: there is none, or no policy of that name.
    """
    names = list(dict.fromkeys(listed(options.policies)))
    if not names:
        raise InputError("--policies names no policy; try --policies go_to_goal.")
    for name in names:
        check_policy(name, ScenarioConfig(), "--policies", typed=True)
    return names


def description(options: ExperimentConfig, behavior: str, people: int | None) -> CollectConfig:
    """The scenario with so many people of a behavior: random, handcrafted or graph."""
    return validate(CollectConfig, fields(options, behavior, people))


def fields(options: ExperimentConfig, behavior: str, people: int | None) -> dict[str, Any]:
    """The options of an experiment's scenarios; a preset fills in the rest.

    ``people`` None is the environment's number; handcrafted people have their own.
    """
    chosen = {name: getattr(options, name) for name in SHARED if name in options.model_fields_set}
    chosen |= {"preset": getattr(options, "preset", None), "behavior": behavior}
    return chosen | {"people": None if behavior == "handcrafted" else people}


def _streams(options: Table1Config, behavior: str, people: int | None) -> ProtocolStreams:
    """The streams of the protocol, with situations for each walking speed."""
    kinds = list(streams(description(options, behavior, people)).values())
    situations = tuple(
        (f"{name}_{number(speed)}", functools.partial(_at, holds, speed))
        for speed in options.speeds
        for name, holds in kinds[0].situations
    )
    kinds = [dataclasses.replace(kind, situations=situations) for kind in kinds]
    return ProtocolStreams(kinds, options.seed, options.seeds)


def _at(holds: Callable, speed: float, snapshot: Snapshot, thresholds: Thresholds) -> Array:
    return holds(snapshot, dataclasses.replace(thresholds, walking=jnp.asarray(speed, float)))


def cell(
    options: SituationConfig,
    work: Workspace,
    name: str,
    behavior: str,
    policy: str,
    pools: Callable[[], ProtocolStreams],
    tell: Callable[[float], None],
    more: tuple[tuple[str, Situation], ...] = (),
    speeds: Sequence[str] = ("",),
    **labels: str,
) -> Table:
    """The rows of one behavior and policy, from the file ``name``.npz, or simulated.

    Args:
        pools: gives the streams of the protocol, with situations of one or several walking speeds.
        tell: called with the finished share.
        more: names and functions of further situations. A file without them is computed again.
        speeds: the walking speeds in words.
        labels: further columns of the table.

    Raises:
        FileError: the file is damaged.
        FloatingPointError: a position is not finite.
    """
    file, further = f"{name}.npz", tuple(name for name, _ in more)
    stored = work.load(file)
    if stored is None or not _is_complete(work.folder / file, stored, further):
        stored = _simulate_cell(options, policy, pools(), tell, more)
        work.save(file, stored)
    with files.sentence(work.folder / file, REMAKE):
        flags = np.unpackbits(stored["flags"], axis=-1, count=len(shares.NAMES)).astype(bool)
        others = np.unpackbits(stored["more"], axis=-1, count=len(further)).astype(bool)
        streams = flags.shape[1] // int(stored["chains"])
        labels_of_cell = {"policy": policy, "behavior": behavior, "people": int(stored["people"]), **labels}
        return chain_rows(flags, others, stored["ended"], streams, speeds, further, **labels_of_cell)


def _is_complete(file: Path, stored: dict[str, np.ndarray], further: tuple[str, ...]) -> bool:
    """Whether a file has the number of chains and all further situations, which files of former versions lack."""
    with files.sentence(file, REMAKE):
        return "chains" in stored and (not further or tuple(stored["names"]) == further)


def _simulate_cell(
    options: SituationConfig,
    policy: str,
    pool: ProtocolStreams,
    tell: Callable[[float], None],
    more: tuple[tuple[str, Situation], ...],
) -> dict[str, Any]:
    """What the file of a cell holds: flags are bits, of each walking speed apart."""
    scenario, names = pool.scenarios[0], tuple(name for name, _ in more)
    minutes = max(1, math.ceil(60.0 * options.hours / len(pool.scenarios) - 1e-6))
    length = min(CHAIN, minutes)
    chains = max(math.ceil(minutes / length), 2 if options.seeds == 1 else 1)  # one chain alone has no interval
    flags, ended = simulate_chains(load_policy(policy, scenario, typed=True), pool, chains, length, tell, more)

    flags = flags.reshape(len(flags), -1, flags.shape[-1])  # (C * seeds * chains, seconds, V * 5 + M)
    flags, others = np.split(flags, [flags.shape[-1] - len(names)], axis=-1)
    flags = np.moveaxis(flags.reshape(*flags.shape[:2], -1, len(shares.NAMES)), 2, 0)
    bits = {"flags": np.packbits(flags, axis=-1), "more": np.packbits(others, axis=-1)}
    numbers = {"people": scenario.people, "ended": ended, "chains": chains * options.seeds}
    return {**bits, "names": np.array(names, str), **numbers}


def write_table1(options: Table1Config, measured: Table, swept: Table, real: Table, driven: Table) -> None:
    """Write shares.csv, more.csv, entropies.csv, hours.csv, orderings.csv, the figures and report.html.

    recordings.csv and demonstrations.csv are written if there are any.

    Args:
        measured: rows of ``shares.chain_rows`` with the experiment's number of people.
        swept: those with other numbers of people.
        real: rows of ``shares.count_recording``.
        driven: rows of ``demonstrations.examples``.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, simulated = options.folder, (measured, swept)  # apart, since both may have a number of people
    speeds = [number(speed) for speed in options.speeds]
    _write_shares(folder, simulated)
    _write_entropies(folder, simulated)
    compared = shares.hours(measured.where(speed=(speeds[0], "")))
    head = "policy,behavior,figure,mean,low,high,paper,p,holm"
    write_csv(folder / "hours.csv", head, [tuple(test.values()) for test in compared])
    if len(real):
        _write_recordings(folder, real)
    if len(driven):
        head = "policy,behavior,people,counting,situation,share,low,high"
        write_csv(folder / "demonstrations.csv", head, share_rows(people_shares(driven, CELL)))

    by_speed = chain_shares(measured, (*CELL, "speed"))
    rows = []
    for policy, speed in itertools.product(measured.levels("policy"), speeds):
        cells = chain_shares(measured.where(policy=policy, speed=speed), ["behavior"])
        by_behavior = {behavior: samples for (behavior,), samples in cells.items()}
        rows += ordering_rows(by_behavior, policy, speed)
    head = "policy,V,counting,ordering,source,statement,holds,share_of_resamples"
    write_csv(folder / "orderings.csv", head, rows)

    figures = pictures.table1(speeds, by_speed, chain_shares(swept.where(speed=speeds[0]), CELL))
    pictures.save(folder, figures)
    writing.write(folder / "report.html", page.table1(options, measured, figures, compared, real, driven))


def _write_shares(folder: Path, simulated: Sequence[Table]) -> None:
    """Shares of the five situations for each walking speed, and of the further ones."""
    rows, further = [], []
    for table in simulated:
        rows += share_rows(chain_shares(table, (*CELL, "speed")))
        further += interval_rows(chain_shares(table, CELL, tuple(MORE_SITUATIONS)), MORE_SITUATIONS)
    write_csv(folder / "shares.csv", "policy,behavior,people,V,counting,situation,share,low,high", rows)
    write_csv(folder / "more.csv", "policy,behavior,people,situation,share,low,high", further)


def _write_entropies(folder: Path, simulated: Sequence[Table]) -> None:
    rows = []
    for table in simulated:
        counts = table.where(measure=(shares.EXAMPLES, shares.COMPLETED)).groups((*CELL, "measure"))
        for (*labels, speed), samples in chain_shares(table, (*CELL, "speed")).items():
            examples = int(counts[*labels, shares.EXAMPLES].value.sum())
            completed = counts[*labels, shares.COMPLETED].value
            ended = int(completed.sum()), int((completed == 0).sum())
            rows.append((*labels, speed, *_entropy(samples), examples, samples[0, 5], *ended))
    head = "policy,behavior,people,V,entropy,low,high,examples,none,completed,not_completed"
    write_csv(folder / "entropies.csv", head, rows)


def _entropy(samples: np.ndarray) -> tuple[np.ndarray, ...]:
    """The entropy of shares, and the ends of its interval."""
    entropy = shares.entropy(samples)
    return (entropy[0], *shares.interval(entropy))


def _write_recordings(folder: Path, real: Table) -> None:
    """There is no V where a situation does not depend on it."""
    rows = []
    for recording in real.groups(["behavior"]).values():
        rows += share_rows(people_shares(recording, RECORDING))
        further = people_shares(recording, RECORDING, tuple(MORE_SITUATIONS))
        rows += interval_rows(further, MORE_SITUATIONS, "examples")
    write_csv(folder / "recordings.csv", "recording,people,V,counting,situation,share,low,high", rows)


# ------------------------------------------------------------------ chains


class ProtocolStreams:
    """C scenarios that differ in their resets alone, with ``size`` starts of each and each seed that policies share.

    The seeds are ``seed``, ``seed + 1`` and so on. What belongs to a seed does not depend on the others.
    """

    def __init__(self, scenarios: Sequence[Scenario], seed: int, seeds: int = 1, size: int = STARTS):
        self.scenarios, self.seeds, self.size = list(scenarios), range(seed, seed + seeds), size
        self.starts = cached(self._draw)  # once, since a reset compiles as long as a step

    def _draw(self) -> State:
        """(C * seeds, K, ...) without a policy's memory."""
        keys = [random_streams.key("table1 starts", seed) for seed in self.seeds]
        number = len(self.scenarios)
        folded = [jax.random.fold_in(key, stream) for stream in range(number) for key in keys]
        drawn = jnp.stack([jax.random.split(key, self.size) for key in folded])
        index = jnp.repeat(jnp.arange(number, dtype=jnp.int32), len(keys))
        draw = jax.jit(functools.partial(_starts, tuple(each.task for each in self.scenarios)))
        return draw(self.scenarios[0], episode_runner.varying_leaves(self.scenarios), index, drawn)

    def chain_keys(self, chains: int) -> Array:
        """(C * seeds * chains,) keys of the chains, of which each seed has ``chains`` in each stream."""
        every = [
            jax.random.split(random_streams.key("table1", seed), len(self.scenarios) * chains) for seed in self.seeds
        ]
        return jnp.stack([keys.reshape(-1, chains) for keys in every], axis=1).reshape(-1)


def _starts(tasks: tuple, scenario: Scenario, varying: dict[int, Array], streams: Array, keys: Array) -> State:
    def stream(index_and_keys: tuple[Array, Array]) -> State:
        index, keys = index_and_keys
        return jax.vmap(lambda key: episode_runner.first_state(tasks, scenario, varying, index, key))(keys)

    return jax.lax.map(stream, (streams, keys))


def simulate_chains(
    policy: Policy,
    streams: ProtocolStreams,
    chains: int,
    minutes: int,
    tell: Callable[[float], None],
    more: tuple[tuple[str, Situation], ...] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Situations once a second in ``chains`` of each stream and seed, after ``LEAD`` minutes.

    Args:
        tell: called with the finished share.
        more: situations that are noted besides those of the scenario.

    Returns:
        Whether each situation holds, (C * seeds * chains, minutes, 60, S) bool, the scenario's before ``more``; and the
        numbers of completed and other episodes, (2,).

    Raises:
        FloatingPointError: the position of a robot or a person is not finite.
    """
    mesh, scenario, keys = devices.mesh(), streams.scenarios[0], streams.chain_keys(chains)
    begin, run = devices.shard(mesh, _begin), devices.shard(mesh, functools.partial(_minute, more), donate=True)
    number = len(keys)
    padded = np.minimum(np.arange(-(-number // mesh.size) * mesh.size), number - 1)
    pool = ResetPool(jax.jit(_init_policy)(scenario, policy, streams.starts()))
    fixed = devices.replicate(mesh, (scenario, policy, pool))
    row = jnp.asarray(padded // chains, jnp.int32)  # of the pool: a stream and a seed
    carry = begin(fixed, *devices.split(mesh, (keys[padded], row)))
    situations, ended = [], np.zeros(2, int)
    for minute in range(LEAD + minutes):
        carry, flags, ends, finite = run(fixed, carry)
        if not bool(np.asarray(finite).all()):
            raise FloatingPointError("a robot's or a person's place is not finite; nothing more is written.")
        if minute >= LEAD:
            situations.append(np.asarray(flags)[:number])
            ended += np.asarray(ends)[:number].sum(0)
        tell((minute + 1) / (LEAD + minutes))
    return np.stack(situations, 1), ended


def _init_policy(scenario: Scenario, policy: Policy, starts: State) -> State:
    """(C, K, ...) starts with the policy's memory."""
    return jax.vmap(jax.vmap(lambda state: episodes.init_policy(scenario, policy, state)))(starts)


def _begin(fixed: tuple, key: Array, row: Array) -> tuple[Array, State]:
    choice_key, streams_key = jax.random.split(key)
    return row, episodes.draw_start(fixed[2], choice_key, streams_key, row)


def _minute(more: tuple[tuple[str, Situation], ...], fixed: tuple, carry: tuple[Array, State]) -> tuple:
    """One minute of a chain: ``episodes.rollout_autoreset`` with the starts of the chain's row of the pool."""
    scenario, policy, pool = fixed
    row, state = carry
    ticks = round(1.0 / scenario.time_step)

    def tick(before: State, _) -> tuple[State, Array]:
        after, _ = episodes.policy_step(scenario, policy, before)
        return episodes.autoreset(pool, after, row), jnp.stack([after.completed, after.timed_out])

    def second(state: State, _) -> tuple:
        state, ended = jax.lax.scan(tick, state, length=ticks)
        situations = state.situations
        if more:  # evaluated once a second, as often as they are read
            situations = jnp.concatenate([situations, classify(snapshot(scenario, state), scenario.thresholds, more)])
        return state, (situations, ended.sum(0, dtype=jnp.int32))

    state, (flags, ended) = jax.lax.scan(second, state, length=MINUTE)
    finite = jnp.isfinite(state.robot.position).all() & jnp.isfinite(state.pedestrians.position).all()
    return (row, state), flags, ended.sum(0, dtype=jnp.int32), finite


# ------------------------------------------------------------------ ablation

DEFAULT, ALL = "default", "sean2"
CHANGED = {
    name: value
    for name, value in PRESETS[ALL].options.items()
    if name not in CollectConfig.model_fields or CollectConfig.model_fields[name].get_default() != value
}
"""The options of preset ``sean2`` that differ from the defaults."""
SWITCHES = {name: value for name, value in CHANGED.items() if name != "violation_distance"}
"""Those that a situation may depend on."""
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    DEFAULT: (DEFAULT, {}),
    **{name: (DEFAULT, {name: value}) for name, value in SWITCHES.items()},
    ALL: (DEFAULT, CHANGED),
    **{f"{ALL}-without-{name}": (ALL, {k: v for k, v in CHANGED.items() if k != name}) for name in SWITCHES},
}
"""The conditions, with the one that each is compared with and its switches: the defaults, the defaults with one switch
each, SEAN 2.0's with all switches, and those without one switch each."""


def run_ablation(options: AblationConfig, console: Console | None = None) -> Path:
    """Simulate what the folder lacks, and write the report; raises as ``run_table1``."""
    names = policies(options)
    for world in WORLDS:
        for behavior in BEHAVIORS:
            check_collection(world_description(options, world, behavior))

    @cached
    def pools(world: str, behavior: str) -> ProtocolStreams:
        scenarios = streams(world_description(options, world, behavior)).values()
        return ProtocolStreams(list(scenarios), options.seed, options.seeds)

    jobs = {}  # (world, policy, behavior) -> the world, the behavior and the policy that are simulated for it
    for job in itertools.product(WORLDS, names, BEHAVIORS):
        world, policy, behavior = job
        jobs[job] = simulated_world(options, world, behavior), behavior, policy
    with Workspace(options.folder, identity(options)).open() as work:
        work.begin()
        simulate = functools.partial(cell, options, work, world="")
        parts = []
        for world, behavior, policy in dict.fromkeys(jobs.values()):
            pool, name = functools.partial(pools, world, behavior), f"{world}-{behavior}-{policy}"
            parts.append(ExperimentPart(name, functools.partial(simulate, name, behavior, policy, pool)))
        cells = run_parts(parts, console, "ablation")
        tables = (cells["-".join(simulated)].relabel(world=world) for (world, *_), simulated in jobs.items())
        write_ablation(options, join(tables))
    return options.folder


def world_description(options: AblationConfig, world: str, behavior: str) -> CollectConfig:
    """The scenario of one of ``WORLDS`` with people of a behavior, which may not have its switch."""
    _, switches = WORLDS[world]
    return validate(CollectConfig, with_defaults(CollectConfig, fields(options, behavior, options.people), switches))


def simulated_world(options: AblationConfig, world: str, behavior: str) -> str:
    """The world that is simulated for a world: its reference if they are equal for people of the behavior."""
    reference, _ = WORLDS[world]
    identity_of_world = world_description(options, world, behavior).identity()
    identity_of_reference = world_description(options, reference, behavior).identity()
    return reference if identity_of_world == identity_of_reference else world


def write_ablation(options: AblationConfig, measured: Table) -> None:
    """Write ablation.csv, entropies.csv, orderings.csv, the figure and report.html.

    Args:
        measured: rows of ``shares.chain_rows`` with a column ``world``.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, by_cell = options.folder, chain_shares(measured, ("world", "policy", "behavior"))
    head = "world,policy,behavior,counting,situation,share,low,high"
    write_csv(folder / "ablation.csv", head, share_rows(by_cell))
    entropies = [(*labels, *_entropy(samples)) for labels, samples in by_cell.items()]
    write_csv(folder / "entropies.csv", "world,policy,behavior,entropy,low,high", entropies)

    worlds = measured.levels("world")
    tables = {world: by_policy(chain_shares(measured.where(world=world), ("policy", "behavior"))) for world in worlds}
    rows = [
        row
        for world, table in tables.items()
        for policy, by_behavior in table.items()
        for row in ordering_rows(by_behavior, world, policy)
    ]
    head = "world,policy,counting,ordering,source,statement,holds,share_of_resamples"
    write_csv(folder / "orderings.csv", head, rows)

    references = {world: WORLDS[world][0] for world in worlds}
    figure = pictures.ablation(tables, references)
    pictures.save(folder, {"ablation": figure})
    writing.write(folder / "report.html", page.ablation(options, tables, references, figure))

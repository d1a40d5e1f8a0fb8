"""``sean collect`` and the ``Recorder``: demonstrations of so many hours, shard by shard (section V-B).

The paper's schedule: random people have one task for all the time; handcrafted people each of the five situations for
a fifth of it; the Behavior Graph half of it joining groups and half of it leaving them. A part of the time is a stream
of episodes. Episode ``i`` is drawn from ``fold_in(prng.key("collect", seed), i)`` alone. Committed shards
are never lost: after a kill, or for more hours, the same command continues with the next shard, and repeats lost ones.
The result is the same, to the byte, as of one run. A shard is written while the next one is simulated.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import robots, sensors
from sean_jax.config import MAX_PIXELS, CollectConfig, HandcraftedBehavior, OwnPart, Value, user_parts
from sean_jax.config.flags import command, number
from sean_jax.config.workspace import CONTENT, refuse_difference, refuse_others
from sean_jax.core import devices, random_streams
from sean_jax.core.data_types import Array, Policy, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.io.progress import Progress, ProgressLike, progress
from sean_jax.io.versions import fingerprint, versions
from sean_jax.learning import dataset
from sean_jax.learning.dataset import Dataset, EpisodeBatch, stream_seconds
from sean_jax.learning.examples import DemonstrationRow, row
from sean_jax.learning.policy import check_policy, label, labelled, load_policy
from sean_jax.robots.drive import require
from sean_jax.simulation import making
from sean_jax.simulation.episode_runner import Callbacks, Record, Runner, batch_size, not_finite
from sean_jax.simulation.scenario import reset, step
from sean_jax.simulation.scenario_stack import Stack, as_stacks
from sean_jax.world import generated, navigation

# ------------------------------------------------------------------ schedule of streams


def check_collection(config: CollectConfig) -> None:
    """Refuse options that cannot work, as far as no scenario is needed to know it.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    check_policy(config.policy, config)
    if config.labels is not None:
        check_policy(config.labels, config, "labels")
    making.plan_scenario(config)
    for robot in config.robot_parts:
        if not isinstance(robot, OwnPart | Value):
            sensors.camera(robots.load(robot.kind), "depth", width=config.width, height=config.height)


def streams(config: CollectConfig) -> dict[str, Scenario]:
    """Name of a stream -> its scenario; scenarios differ only in leaves and task.

    Raises:
        InputError: unknown names, or impossible combinations.
    """
    scenarios = [replace(scenario, metrics=()) for scenario in making.scenarios(config)]  # not needed here
    first = scenarios[0]
    if isinstance(config.behavior, HandcraftedBehavior) and [each.task_name for each in scenarios] == ["handcrafted"]:
        situations = dict.fromkeys(first.behavior.data.situations)
        if len(situations) > 1:
            return {name: _only(first, name) for name in situations}
    return {scenario.task_name: scenario for scenario in scenarios}


def stream_floors(config: CollectConfig) -> dict[str, Stack[Scenario]]:
    """Name of a stream -> its scenario on each floor, as ``streams``.

    Raises:
        InputError: unknown names, or impossible combinations.
    """
    if generated.count(config.environment) == 1:
        parts = streams(config)
        return dict(zip(parts, as_stacks(list(parts.values())), strict=True))
    floors = [
        each.map_member(lambda scenario: replace(scenario, metrics=()))
        for each in making.build(making.plan_scenario(config))
    ]
    return {each.member.task_name: each for each in floors}


def _only(scenario: Scenario, situation: str) -> Scenario:
    """The scenario with the handcrafted sets of that situation alone: their odds differ, and nothing else."""
    sets = scenario.behavior.data
    chosen = np.array([name == situation for name in sets.situations])
    odds = jnp.where(jnp.asarray(chosen)[:, None, None], sets.odds, 0.0)
    return replace(scenario, behavior=replace(scenario.behavior, data=replace(sets, odds=odds)))


def next_stream(recorded: list[int], target_rows: int) -> int | None:
    """The index of the stream with the fewest recorded rows; None when each has ``target_rows``.

    It does not depend on ``target_rows`` otherwise, so a dataset extended later equals a dataset recorded at once.
    """
    shortest = min(range(len(recorded)), key=lambda stream: (recorded[stream], stream))
    return None if recorded[shortest] >= target_rows else shortest


# ------------------------------------------------------------------ rows of simulated episodes


def row_record(
    scenario: Scenario, camera: sensors.Camera, command: Callable[[State], Array] | None = None, rate: int = 1
) -> Record:
    """The record of a ``Runner`` that stores ``rate`` rows per second.

    Args:
        command: the recorded command, from the state after a step; the policy's if None.
    """
    return Record(_init_rows, functools.partial(_update_rows, camera), steps_per_row(scenario, rate), command)


def steps_per_row(scenario: Scenario, rate: int) -> int:
    """Control steps from one row to the next; ``rate`` rows per second divide the steps per second."""
    return round(1.0 / scenario.time_step) // rate


def simulate_shard(
    runner: Runner, seed: int, shard: int, stream: int, watch: Callable[[int], None] | None = None, turn: int = 0
) -> EpisodeBatch:
    """A shard: the episodes from number ``shard * runner.size`` on, all of one stream.

    Args:
        runner: with the record of ``row_record``.
        watch: is called with the seconds that are simulated.
        turn: number of shards of the stream before this one; each stream has the floors in turn.

    Raises:
        FloatingPointError: a number is not finite; the message names the episodes.
    """
    callbacks = Callbacks(advanced=lambda seconds, simulated: watch(round(seconds)) if watch is not None else None)
    first = shard * runner.size
    place = turn * runner.size
    batch = runner.run(seed, first, index=np.full(runner.size, stream), callbacks=callbacks, turn=place)
    scenario = runner.scenarios[0]

    # An episode has at most a row for each second of its time limit, at a rate of 1.
    rate = round(1.0 / scenario.time_step) // runner.record.every
    most = rate * math.ceil(scenario.time_limit - 1e-6)
    rows: dict[str, np.ndarray] = {}
    lengths = np.zeros(runner.size, np.int64)
    begin = 0
    for values, active in batch.rows:
        lengths += _put_rows(rows, values, active, begin, most)
        begin += len(active)

    floats = [values for values in rows.values() if values.dtype.kind == "f"]
    faulty = np.any([~np.isfinite(values.reshape(len(values), -1)).all(1) for values in floats], 0)
    if faulty.any():
        raise FloatingPointError(not_finite(first, faulty))
    floors = runner.floor_indices(place) if runner.floors.size > 1 else None
    return EpisodeBatch(rows, lengths, np.asarray(batch.states.completed), floors)


def _put_rows(
    arrays: dict[str, np.ndarray], rows: DemonstrationRow, active: np.ndarray, begin: int, most: int
) -> np.ndarray:
    """Put rows (C, B, ...) from row ``begin`` on into arrays (B, most, ...); number of rows of each episode, (B,)."""
    end = min(begin + len(active), most)
    active = active[: end - begin].T
    for field in dataclasses.fields(DemonstrationRow):  # pyright: ignore[reportArgumentType]
        values = np.swapaxes(np.asarray(getattr(rows, field.name)), 0, 1)
        if field.name not in arrays:
            arrays[field.name] = np.zeros((len(values), most, *values.shape[2:]), values.dtype)
        where = active.reshape(*active.shape, *(1,) * (values.ndim - 2))
        np.copyto(arrays[field.name][:, begin:end], values[:, : end - begin], where=where)
    return active.sum(1)


def _init_rows(floors: Stack[Scenario], states: State) -> tuple[Array, Array]:
    """The way to the goal of each episode, and no command yet."""
    last = floors.vmap(lambda scenario, goal: navigation.last_arc_to_goal(scenario.navigation, goal))(states.task.goal)
    return last, jnp.zeros((*states.tick.shape, 2), float)


def _update_rows(
    camera: sensors.Camera,
    floors: Stack[Scenario],
    before: State,
    after: State,
    actions: Array,
    active: Array,
    total: tuple,
) -> tuple[tuple[Array, Array], tuple[DemonstrationRow, Array]]:
    """The rows before the latest steps, with whether the episodes had not ended by then."""

    last, latest = total
    latest, rows = floors.vmap(functools.partial(_row_of, camera))(before, actions.swapaxes(0, 1), last, latest)
    return (last, latest), (rows, active)


def _row_of(
    camera: sensors.Camera, scenario: Scenario, before: State, actions: Array, last: Array, latest: Array
) -> tuple[Array, DemonstrationRow]:
    """The command after some steps, and the row before them; a command that is not finite is no new one.

    Args:
        actions: (steps, 2) m/s, rad/s.
        latest: (2,) the command before.
    """
    finite = jnp.isfinite(actions).all(-1)
    command = jnp.where(finite[0], actions[0], latest)
    newest = jnp.max(jnp.where(finite, jnp.arange(len(actions), dtype=jnp.int32), -1))
    latest = jnp.where(newest >= 0, actions[newest], latest)
    return latest, row(scenario, before, command, camera, last)


TYPICAL = 30.0  # s, of an episode: batches are sized so that no stream gets many more rows than it needs
MAX_BATCH, MAX_BATCH_CPU = 1024, 32  # episodes at once
MIN_BATCH = 32  # at a high rate, where larger batches would fill the memory with their images


# ------------------------------------------------------------------ sean collect


def collect(config: CollectConfig, console: ProgressLike = None) -> Dataset:
    """Record until every stream has its time. Committed shards are kept if an error is raised.

    Args:
        console: shows the progress; a function receives the share that is done.

    Raises:
        InputError: the options are impossible, or the folder holds something else.
        WriteError: another process records in the folder.
        IncompleteError: something broke midway.
        FloatingPointError: a number is not finite.
    """
    with user_parts.read_once():
        check_collection(config)
        check_folder(config.folder)
        with writing.folder_lock(config.folder):
            return _collect(config, console)


def load_driver(config: CollectConfig, scenario: Scenario) -> Policy:
    """The policy that drives, ``labelled`` if the options have labels or noise."""
    driver = load_policy(config.policy, scenario)
    if config.labels is None and config.noise is None:
        return driver
    return labelled(driver, config.labels and load_policy(config.labels, scenario, "labels"), config.noise)


def _collect(config: CollectConfig, console: ProgressLike) -> Dataset:
    """Record in a folder that this process has locked."""
    parts = stream_floors(config)
    stacks = list(parts.values())
    first = stacks[0].member
    policy = load_driver(config, first)
    camera = sensors.camera(first, "depth", width=config.width, height=config.height)
    mesh = devices.mesh()
    _check_batch(config, stacks, mesh.size)
    data = _open(config, parts, policy, camera)
    if data.batch % mesh.size:
        raise InputError(
            f"{data.folder} was begun with --batch {data.batch}, which does not spread evenly over {mesh.size} "
            "devices; choose another --out."
        )

    # A shard is written while the next one is simulated.
    is_labelled = config.labels is not None or config.noise is not None
    record = row_record(first, camera, label if is_labelled else None, config.rate)
    runner = Runner(stacks, policy, data.batch, "collect", record, mesh)
    with progress(console) as tell, ThreadPoolExecutor(1, thread_name_prefix="sean-commit") as pool:
        recording = _Recording(data, runner, config, tell)
        tell.start("recording", recording.total)
        recording.show("compiling")
        commit: Future | None = None
        for stream, shard in _due(data, recording.rows, recording.target_rows):
            batch = recording.simulate(stream, shard)
            if commit is not None:
                commit.result()  # raises the error of the shard before
            commit = pool.submit(data.commit, stream, batch, shard)
        if commit is not None:
            commit.result()
    return data


def _check_batch(config: CollectConfig, stacks: list[Stack[Scenario]], device_count: int) -> None:
    """Refuse a batch that does not divide among devices or floors."""
    if (config.batch or 0) % device_count:
        raise InputError(
            f"--batch: {config.batch} episodes do not spread evenly over {device_count} devices; take a multiple."
        )
    even = _even(config.batch or 1, stacks)
    if config.batch not in (None, even):
        raise InputError(
            f"--batch: {config.batch} episodes do not spread evenly over {stacks[0].size} floors; take {even}."
        )


class _Recording:
    """The recorded rows of each stream while shards are simulated, and their progress."""

    def __init__(self, data: Dataset, runner: Runner, config: CollectConfig, tell: Progress):
        count = len(data.manifest["streams"])
        self.data = data
        self.runner = runner
        self.config = config
        self.tell = tell
        self.target_rows = config.rate * stream_seconds(config.hours, count)  # of each stream
        self.total = self.target_rows * count // config.rate  # s
        self.rows = data.stream_rows
        self.streams = [shard["stream"] for shard in data.manifest["shards"]]
        self.first_new = len(self.streams)  # shards before it are repeated, since their files were lost

    def simulate(self, stream: int, shard: int) -> EpisodeBatch:
        """The episodes of a shard."""
        began = time.perf_counter()
        if shard == len(self.streams):
            self.streams.append(stream)
        people = self.runner.scenarios[0].people

        def watch(seconds: int) -> None:
            self.show(f"shard {shard}: {self.data.batch} episodes of {people} people at {seconds} s")

        turn = self.streams[:shard].count(stream)
        batch = simulate_shard(self.runner, self.config.seed, shard, stream, watch, turn)
        examples = int(batch.lengths.sum())
        if shard >= self.first_new:
            self.rows[stream] += examples
        self.show(f"shard {shard}: {examples} examples in {time.perf_counter() - began:.1f} s")
        return batch

    def show(self, note: str) -> None:
        """Show the progress, with a note."""
        done = sum(min(rows, self.target_rows) for rows in self.rows) // self.config.rate
        self.tell.update(done, f"{done:,} of {self.total:,} s · {note}")


def _due(data: Dataset, recorded: list[int], target_rows: int) -> Iterator[tuple[int, int]]:
    """(stream, shard) of the shards to record: first lost shards, then new ones of the stream with the fewest rows."""
    shards = data.manifest["shards"]
    for shard in data.damaged_shards():
        yield shards[shard]["stream"], shard
    number = len(shards)
    while (stream := next_stream(recorded, target_rows)) is not None:
        yield stream, number
        number += 1


def _open(config: CollectConfig, parts: dict[str, Stack[Scenario]], policy: Policy, camera: sensors.Camera) -> Dataset:
    """The dataset of the folder, if it was begun with the same description and content, or an empty one."""
    folder = config.folder
    manifest = _manifest(config, parts, policy, camera)
    check_folder(folder)
    if (folder / dataset.MANIFEST).exists():
        data = dataset.open_dataset(folder)
        _check_same(config, data, manifest)
        if config.hours > data.manifest["hours"]:
            data.save({**data.manifest, "command": _command(config, data.batch), "hours": config.hours})
        return data
    return dataset.create_dataset(folder, manifest)


def check_folder(folder: Path) -> None:
    """Refuse a folder without a dataset, or with the remains of a dataset that was killed at its start.

    Raises:
        InputError: it holds something else.
    """
    if not any((folder / name).is_file() for name in (dataset.MANIFEST, "zarr.json")):
        refuse_others(folder, dataset.fields(1, 1, 1))


def _check_same(config: CollectConfig, data: Dataset, manifest: dict[str, Any]) -> None:
    """Refuse to resume with other options, versions or content: it would be two datasets in one."""
    content = CONTENT + "scenario and policy"
    had = data.manifest | {content: data.manifest.get("content")}
    facts = {name: manifest[name] for name in ("environment", "people", "robot", "camera", "situations")}
    now = {"options": config.identity(), "versions": versions(), **facts, content: manifest["content"]}
    now["parts"] = manifest["parts"]
    refuse_difference(data.folder, had, now)
    if config.batch not in (None, data.batch):
        raise InputError(f"{data.folder} was begun with --batch {data.batch}, not {config.batch}; ask for the same.")
    if config.hours < data.manifest["hours"]:
        had_hours = number(data.manifest["hours"])
        hours = number(config.hours)
        raise InputError(f"{data.folder} was begun with --hours {had_hours}, not {hours}; ask for as much or more.")


def _manifest(
    config: CollectConfig, parts: dict[str, Stack[Scenario]], policy: Policy, camera: sensors.Camera
) -> dict[str, Any]:
    stacks = list(parts.values())
    floors = stacks[0]
    size = _batch_size(config, stacks)
    return {
        "command": _command(config, size),
        "options": config.identity(),
        **scenario_facts(floors.member, camera, config.policy.kind, config.rate),
        **({"environments": list(floors.names)} if floors.size > 1 else {}),
        "content": content(stacks, policy),
        "parts": user_parts.digests(config),
        "hours": config.hours,
        "batch": size,
        "streams": list(parts),
    }


def content(stacks: list[Stack[Scenario]], policy: Policy) -> str:
    """The digest of the numbers of scenarios and a policy."""
    first = stacks[0].member if stacks[0].size == 1 else stacks[0]
    return fingerprint(first, [each.member.behavior for each in stacks], policy.params)


def _command(config: CollectConfig, batch: int) -> str:
    """The command that records this dataset again, in full."""
    return f"{command('collect', config)} --hours {number(config.hours)} --batch {batch}"


def scenario_facts(scenario: Scenario, camera: sensors.Camera, policy: str, rate: int = 1) -> dict[str, Any]:
    """A manifest's entries about a scenario and its policy; ``rate`` in rows per second.

    Raises:
        InputError: the robot is no differential drive.
    """
    require(scenario.robot, ("differential",), "demonstrations are recorded with")
    image = {"width": camera.width, "height": camera.height, "fovy": camera.fovy, "far": camera.far}
    limits = {"max_speed": float(scenario.robot.max_speed), "max_turn_rate": float(scenario.robot.max_turn_rate)}
    return {
        "versions": versions(),
        "environment": scenario.environment.name,
        "behavior": scenario.behavior.name,
        "policy": policy,
        "people": scenario.people,
        "robot": {"name": scenario.robot.name, **limits},
        "camera": image,
        "situations": [name for name, _ in scenario.situations],
        "rate": float(rate),
        "seconds": math.ceil(scenario.time_limit - 1e-6),
    }


def _even(batch: int, stacks: list[Stack[Scenario]]) -> int:
    """The batch, or the next larger one that has equal turns of floors."""
    floors = replace(stacks[0], turn=len(stacks))
    return batch if floors.size == 1 else batch_size(batch, floors, len(jax.devices()))


def _batch_size(config: CollectConfig, stacks: list[Stack[Scenario]]) -> int:
    """Episodes at once, a multiple of the number of devices."""
    count = len(jax.devices())
    if config.batch is not None:
        return config.batch
    largest = MAX_BATCH_CPU if jax.default_backend() == "cpu" else MAX_BATCH
    largest = min(largest, max(MIN_BATCH, largest // config.rate))
    needed = math.ceil(stream_seconds(config.hours, len(stacks)) / TYPICAL)
    return _even(math.ceil(min(largest, max(4, needed)) / count) * count, stacks)


# ------------------------------------------------------------------ commands from outside


class EpisodePart(NamedTuple):
    """Rows of a recorded episode that become a demonstration, and what the manifest says about it."""

    first: int
    end: int
    about: Mapping[str, Any]


class Recorder:
    """Demonstrations from any source of commands, outside ``jit``: a joystick, a web page, a planner, a list.

    Episodes of one scenario are appended to a dataset as of ``sean collect``, new or resumed; each
    is a shard. ``state = recorder.begin()``, then ``state = recorder.step(command)`` for each step of control, then
    ``recorder.commit()`` or ``recorder.discard()``.
    """

    def __init__(
        self,
        folder: Path | str,
        scenario: Scenario,
        *,
        driver: str = "human",
        seed: int = 0,
        width: int = 64,
        height: int = 48,
        rate: int = 1,
    ):
        """Open or create the dataset; depth images have width x height pixels.

        Args:
            driver: a word for the manifest about the source of the commands.
            seed: episode ``i`` is drawn from ``fold_in(prng.key("record", seed), i)``.
            rate: rows per second, a divisor of the control steps per second.

        Raises:
            InputError: the folder holds something else, the images are too large, or the rate is no divisor.
        """
        if width * height > MAX_PIXELS:
            raise InputError(f"width: {width} times {height} are more than {MAX_PIXELS:,} pixels; ask for fewer.")
        if (steps := round(1.0 / scenario.time_step)) % rate:
            raise InputError(f"rate: {rate} rows per second do not divide its {steps} steps; choose a divisor.")
        folder = Path(folder)
        self.scenario = scenario
        self.seed = seed
        self.rate = rate
        self.camera = sensors.camera(scenario, "depth", width=width, height=height)
        self.data = self._opened(folder, driver)
        self._begin = jax.jit(begin_episode)
        self._step = jax.jit(step)
        self._row = jax.jit(lambda scenario, state, command, last: row(scenario, state, command, self.camera, last))
        self.discard()

    @property
    def number(self) -> int:
        """Of the next episode."""
        return len(self.data.manifest["shards"])

    def episode_key(self, number: int) -> Array:
        """The () typed key of an episode of the recorder's own stream."""
        return jax.random.fold_in(random_streams.key("record", self.seed), jnp.uint32(number))

    def begin(self, key: Array | None = None) -> State:
        """A new episode; one that was not committed is forgotten.

        Args:
            key: () typed PRNG key of the episode, such as of another program's episode; by default of the
                recorder's own stream, which no other episodes have.
        """
        self.discard()
        key = self.episode_key(self.number) if key is None else key
        self.state, self._last = self._begin(self.scenario, key)
        return self.state

    def step(self, command: Any) -> State:
        """The state one step of control later.

        Args:
            command: (2,) m/s and rad/s; None, or one that is not finite, is no new one.

        Raises:
            InputError: no episode has begun.
        """
        if self.state is None:
            raise InputError("recorder: no episode has begun; call begin first.")
        action = np.full(2, np.nan) if command is None else np.asarray(command, np.float64).reshape(2)
        new = bool(np.isfinite(action).all())
        self._command = np.where(new, action, self._command)
        is_due = int(self.state.tick) % steps_per_row(self.scenario, self.rate) == 0
        if is_due and len(self._rows) < self.data.most_rows:
            latest = jnp.asarray(self._command, float)
            self._rows.append(jax.tree.map(np.asarray, self._row(self.scenario, self.state, latest, self._last)))
        self.state = self._step(self.scenario, self.state, jnp.asarray(action, float))
        return self.state

    def commit(self, parts: Sequence[EpisodePart] | None = None) -> None:
        """Keep the episode, or parts of it, each as a demonstration of its own.

        Raises:
            IncompleteError: it cannot be written; it can be tried again.
            InputError: there is nothing to commit, or another program has recorded in the folder.
            WriteError: another process records in the folder.
        """
        if self.state is None or not self._rows:
            raise InputError("recorder: there is nothing to commit; call begin and step first.")
        parts = [EpisodePart(0, len(self._rows), {})] if parts is None else parts
        with writing.folder_lock(self.data.folder):
            if dataset.open_dataset(self.data.folder).manifest != self.data.manifest:
                raise InputError(f"{self.data.folder} was continued by another program; record in another folder.")
            for part in parts:
                self.data.commit(0, self._batch(self._rows[part.first : part.end]), about=part.about)
        self.discard()

    def _batch(self, recorded: Sequence[Any]) -> EpisodeBatch:
        """Rows of this episode as a batch of one."""
        rows = {}
        for name, (shape, kind) in self.data.fields.items():
            rows[name] = np.zeros((1, self.data.most_rows, *shape), kind)
            rows[name][0, : len(recorded)] = np.stack([getattr(one, name) for one in recorded])
        return EpisodeBatch(rows, np.array([len(recorded)]), np.array([bool(self.state.completed)]))

    def discard(self) -> None:
        """Forget the episode."""
        self.state: Any = None
        self._rows: list[Any] = []
        self._command = np.zeros(2)

    def _opened(self, folder: Path, driver: str) -> Dataset:
        options = {
            "seed": self.seed,
            "driver": driver,
            "task": self.scenario.task_name,
            "people": self.scenario.people,
            "rate": self.rate,
            "environment": self.scenario.environment.name,
            "size": [self.camera.width, self.camera.height],
        }
        manifest = {
            "command": "",
            "options": options,
            **scenario_facts(self.scenario, self.camera, driver, self.rate),
            "hours": 1e6,  # all that is recorded takes part
            "batch": 1,
            "streams": [self.scenario.task_name],
        }
        if not (folder / dataset.MANIFEST).exists():
            check_folder(folder)
            with writing.folder_lock(folder):
                return dataset.create_dataset(folder, manifest)
        data = dataset.open_dataset(folder)
        if data.manifest["options"] != options:
            raise InputError(f"{folder} was begun with another scenario, driver, seed or rate; choose another folder.")
        return data


def record(recorder: Recorder, commands: Callable[[State], Any] | Iterable[Any], episodes: int) -> Dataset:
    """Record so many episodes, each until it is completed or timed out, and commit them.

    Args:
        commands: a function of the state, or one command (2,) for each step. If they end midway, the last episode is
            committed as it is then.
    """
    stream = iter(()) if callable(commands) else iter(commands)
    source = commands if callable(commands) else lambda _: next(stream)
    for _ in range(episodes):
        state = recorder.begin()
        ended = False
        while not (ended or bool(state.completed | state.timed_out)):
            try:
                state = recorder.step(source(state))
            except StopIteration:
                ended = True
        if recorder._rows:
            recorder.commit()
        if ended:
            break
    return recorder.data


def begin_episode(scenario: Scenario, key: Array) -> tuple[State, Array]:
    """The first state of an episode, and the last arc of the way to its goal."""
    state = reset(scenario, key)
    return state, navigation.last_arc_to_goal(scenario.navigation, state.task.goal)

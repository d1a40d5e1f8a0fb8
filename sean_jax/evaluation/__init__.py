"""Evaluation (section V): episodes of a policy in scenarios that take turns, their metrics, a table and a report.

``evaluate`` is a function of values; ``run`` is ``sean run``, which resumes an interrupted run.
"""

from __future__ import annotations

import contextlib
import datetime
import functools
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import jax
import numpy as np
from rich.console import Console
from rich.text import Text

from sean_jax.config import RunConfig, outside, user_parts
from sean_jax.config.flags import number
from sean_jax.core.data_types import Array, Policy, PolicyLike, Scenario, State, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.evaluation import results
from sean_jax.evaluation.batches import (
    FRAMES,
    FinishedBatch,
    RunFolder,
    batch_frames,
    check_run_folder,
    finish,
    record,
    unfinished_runs,
)
from sean_jax.evaluation.results import Evaluation
from sean_jax.evaluation.run_plan import RunPlan, plan_run
from sean_jax.io import interrupts, trajectories, writing
from sean_jax.io.progress import Progress, progress
from sean_jax.io.versions import fingerprint
from sean_jax.io.writing import check_new_folder
from sean_jax.learning.policy import load_policies, load_policy
from sean_jax.metrics import Metric
from sean_jax.simulation import making
from sean_jax.simulation.episode_runner import CHUNK, Callbacks, Runner
from sean_jax.simulation.scenario_stack import Stack, as_stacks
from sean_jax.web.replay.live import Live, serve

__all__ = ["Evaluation", "evaluate", "run"]

MISSED = "missed_commands"
MISSED_COMMANDS = Metric(
    lambda now: 0,  # counted by the ``Driver``, as no state of the simulation knows it
    lambda value, before, after: value,
    lambda value: value,
    title="missed commands",
    definition="States for which no command of the controller outside came in time.",
    kind="count",
    headline=True,
    better="lower",
)
"""Of controllers outside of this program; a run in which none was missed does not have it."""


class Schedule(NamedTuple):
    """The numbered episodes of an evaluation, in batches. A team has a row for each robot of an episode."""

    episodes: int
    seed: int
    batch: int  # episodes at once
    robots: int = 1  # of a team

    @property
    def rows(self) -> int:
        """The number of rows of all episodes."""
        return self.episodes * self.robots

    @property
    def batches(self) -> Iterator[tuple[int, int]]:
        """The first row and the number of rows of each batch."""
        size = self.batch * self.robots
        return ((first, min(size, self.rows - first)) for first in range(0, self.rows, size))

    @property
    def shown(self) -> int:
        """The number of rows of the episodes that the report shows."""
        return -(-FRAMES // self.robots) * self.robots


class RunContext(NamedTuple):
    """Who takes part in an evaluation besides the runner."""

    bar: Progress
    console: Console | None = None
    folder: RunFolder | None = None  # keeps finished batches
    live: Live | None = None  # a page that shows the first episode
    driver: Driver | None = None


def evaluate(
    scenario: Scenario | Stack[Scenario] | Sequence[Scenario | Stack[Scenario]],
    policy: PolicyLike | str = "go_to_goal",
    *,
    episodes: int = 64,
    seed: int = 0,
    batch: int = 1024,
    out: Path | str | None = None,
    console: Console | None = None,
) -> Evaluation:
    """Simulate episodes and measure them.

    Args:
        scenario: one, or several that take turns and differ in their task or in leaves alone; or a stack for each, with
            floors that take turns (``making.build``).
        policy: a ``Policy``, a function (scenario, state, key) -> (2,) [m/s, rad/s], a name, the folder of a training,
            or FILE.py:NAME.
        seed: equal seeds give equal episodes, the episodes of ``sean run``.
        out: new or empty folder for the report and all results.

    Raises:
        InputError: the scenarios do not go together, there is no such policy, or the folder is not empty.
        FloatingPointError: a number is not finite; the message names the episodes.
    """
    stacks = as_stacks(scenario)
    config = RunConfig(episodes=episodes, seed=seed, batch=batch)
    schedule = Schedule(config.episodes, config.seed, batch_size(config.episodes, config.batch, stacks))
    loaded = load_policy(policy, stacks[0].member, typed=True)
    if out is not None:
        check_new_folder(Path(out), "out")
    with progress(console) as bar:
        evaluation = _evaluate(stacks, loaded, schedule, stacks[0].size, RunContext(bar, console))
    if out is not None:
        evaluation.save(out)
    return evaluation


class Driver(Protocol):
    """A controller outside of this program that drives one episode at a time."""

    policy: Policy

    def __call__(self, scenario: Scenario, number: int, states: State) -> Policy:
        """The policy, with its command for the next step; ``states`` are of a batch of one."""
        ...

    def finish(self, states: State) -> int:
        """Send the last state of an episode; the number of its states for which no command came."""
        ...

    def close(self) -> None:
        """End the connection."""
        ...


def run(
    config: RunConfig, console: Console, connect: Callable[[Scenario], Driver] | None = None
) -> tuple[Path, Evaluation]:
    """``sean run``: simulate, summarize, write.

    Ctrl-C between two batches leaves fewer episodes. Finished batches stay in the folder; the same description and
    folder resume the run.

    Args:
        connect: gives the driver of a scenario if the policy is outside of this program (``config.outside``).

    Raises:
        InputError: the description cannot be met.
        WriteError: the folder cannot be written.
        FloatingPointError: a number is not finite.
        IncompleteError: the disk is full, or something else broke midway.
        KeyboardInterrupt: no batch was finished.
    """
    with user_parts.read_once():
        plan = plan_run(config, is_driven=connect is not None)
        with _locked_folder(plan) as folder, contextlib.ExitStack() as stack:
            return folder.folder, _run(plan, folder, console, connect, stack)


def _run(
    plan: RunPlan,
    folder: RunFolder,
    console: Console,
    connect: Callable[[Scenario], Driver] | None,
    stack: contextlib.ExitStack,
) -> Evaluation:
    """The run of a plan in its folder; ``stack`` closes what it opens."""
    _tell_unfinished(plan, folder.folder, console)

    # A set may have more floors than a task has episodes; those that no episode visits are not built.
    with console.status("preparing the scenario"):
        limit = -(-plan.config.episodes // len(plan.scenario.tasks))
        stacks = making.build(plan.scenario, limit)
        if connect is not None and stacks[0].size > 1:
            kind = plan.config.policy.kind
            raise InputError(f"policy: {kind} drives on one floor or robot, not on {stacks[0].size}.")

    # The policy fits the scenario, and both decide whether finished batches are of this run.
    first = stacks[0].member
    driver = None if connect is None else stack.enter_context(contextlib.closing(connect(first)))
    policy = load_policies(plan.config.policies, first) if driver is None else driver.policy
    content = fingerprint(first if stacks[0].size == 1 else stacks[0], policy.params)
    folder.check_content(content)
    _announce(plan, stacks, policy, folder, console)

    # The page of a live run opens before the first batch, which includes the time of compiling.
    live = None
    if plan.config.live:
        live = stack.enter_context(serve(first, f"{folder.folder.name} · live"))
        console.print(f"live: {live.url}", highlight=False, soft_wrap=True)

    # Finished batches are read from the folder, so a run that was stopped goes on where it ended.
    schedule = _schedule(plan, stacks)
    with progress(console) as bar:
        context = RunContext(bar, console, folder, live, driver)
        evaluation = _evaluate(stacks, policy, schedule, plan.scenario.floors, context)
    evaluation.print_table(console)

    # A run that was stopped early gets a report, too, of the episodes that it has.
    with console.status("drawing the report"), folder.results(evaluation.episodes == schedule.episodes) as stage:
        results.write_all(stage, evaluation, plan, content)

        # Each batch has its own file of frames; only those of finished batches are joined.
        if plan.config.trajectories is not None:
            finished = [(row, count) for row, count in schedule.batches if row < len(evaluation.tasks)]
            parts = [path for path in (folder.frames(row, count) for row, count in finished) if path is not None]
            trajectories.join_trajectories(parts, stage / f"trajectories.{plan.config.trajectories}")
    return evaluation


@contextlib.contextmanager
def _locked_folder(plan: RunPlan) -> Iterator[RunFolder]:
    """The folder for the results, locked until the block ends."""
    with contextlib.ExitStack() as stack:
        now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
        path = plan.config.folder(now)
        if plan.config.out is not None:
            check_run_folder(path)
            stack.enter_context(writing.folder_lock(path))
        else:
            attempt = 1
            while not _lock_new(path, stack):  # several runs may begin in one second
                attempt += 1
                path = plan.config.folder(f"{now}-{attempt}")
        folder = RunFolder(path, plan.identity, plan.robots, plan.config.trajectories)
        with folder.explain_errors():
            yield folder


def _lock_new(path: Path, stack: contextlib.ExitStack) -> bool:
    """Lock a folder that does not exist; False if another run has it."""
    if path.exists():
        return False
    try:
        stack.enter_context(writing.folder_lock(path))
    except writing.WriteError:
        if not path.exists():
            raise
        return False
    return True


def _tell_unfinished(plan: RunPlan, path: Path, console: Console) -> None:
    """Name the unfinished runs of this description, which --out would resume."""
    if plan.config.out is not None:
        return
    for other, episodes in unfinished_runs(plan.identity, plan.robots, path):
        text = f"{other} has {episodes} of {plan.config.episodes} episodes of such a run; --out {other} resumes it"
        console.print(Text(text, "dim"), soft_wrap=True)


def _announce(
    plan: RunPlan, stacks: list[Stack[Scenario]], policy: Policy, folder: RunFolder, console: Console
) -> None:
    """Print what will be simulated."""
    config = plan.config
    floors = stacks[0]
    wanted = plan.scenario.floors
    tasks = [each.member.task_name for each in stacks]
    robots_of_team = floors.names if plan.scenario.team else ()
    title = results.title(floors.member, tasks, config.episodes, floors.size if wanted > 1 else 0, robots_of_team)
    console.print(Text(title, "bold"), soft_wrap=True)
    devices = f"{len(jax.devices())} × {jax.devices()[0].device_kind}"
    lines = [f"{number(config.time_limit)} s each, policy {policy.name}, seed {config.seed}, on {devices}"]
    if floors.size < wanted:
        lines.append(f"{config.episodes} episodes are on the first {floors.size} of {wanted} floors")
    if folder.episodes:
        lines.append(f"going on after {folder.episodes} finished episodes")
    for line in lines:
        console.print(Text(line, "dim"), soft_wrap=True)


def _schedule(plan: RunPlan, stacks: list[Stack[Scenario]]) -> Schedule:
    """The episodes of a plan; a controller outside of this program drives one at a time."""
    config = plan.config
    size = min(config.episodes, 1 if outside(config.policy) else config.batch)
    size = size if plan.scenario.team else batch_size(config.episodes, size, stacks)
    return Schedule(config.episodes, config.seed, size, plan.robots)


def batch_size(episodes: int, largest: int, stacks: list[Stack[Scenario]]) -> int:
    """Episodes of a batch; of several floors, a batch has whole turns if there is another batch."""
    size = min(episodes, largest)
    tasks = len(stacks)
    if stacks[0].size == 1 or size == episodes:
        return size
    period = tasks * stacks[0].size
    return size - size % period if size >= period else max(tasks, size - size % tasks)


# ------------------------------------------------------------------ batches of episodes


def _evaluate(
    stacks: list[Stack[Scenario]], policy: Policy, schedule: Schedule, set_floors: int, context: RunContext
) -> Evaluation:
    """Simulate batch after batch; finished ones are loaded. Ctrl-C ends with those that are finished."""
    batches: list[FinishedBatch] = []
    simulator = None
    try:
        for first, count in schedule.batches:
            batch = None if context.folder is None else context.folder.load(first, count)
            if batch is None:
                simulator = simulator or _Simulator(stacks, policy, schedule, context)
                batch = simulator.simulate(first, count)
            batches.append(batch)
    except KeyboardInterrupt:
        if not batches or simulator is None:
            raise
    compile_seconds = 0.0 if simulator is None else simulator.runner.compile_seconds
    return _join(stacks, policy, batches, schedule.rows, set_floors, compile_seconds)


class _Simulator:
    """Simulates batches of episodes with one compiled program."""

    def __init__(self, stacks: list[Stack[Scenario]], policy: Policy, schedule: Schedule, context: RunContext) -> None:
        bar, console, folder, self.live, self.driver = context
        self.bar = bar
        self.folder = folder
        self.schedule = schedule
        self.scenario = stacks[0].member
        rows = schedule.batch * schedule.robots
        keeps_all = folder is not None and folder.trajectories is not None
        run_record = record(stacks[0], rows, rows if keeps_all else schedule.shown)

        chunk = CHUNK if self.driver is None else self.scenario.time_step
        self.runner = Runner(stacks, policy, rows, "run", run_record, chunk=chunk)
        self.runner.compile(Callbacks(compiling=bar.stage))
        if console is not None:
            console.print(f"[dim]compiled in {self.runner.compile_seconds:.1f} s[/]", highlight=False)

        bar.start("simulating", -(-schedule.episodes // schedule.batch) * self.scenario.time_limit)
        self.began = time.perf_counter()  # s
        self.simulated = 0.0  # s of finished batches

    def simulate(self, first: int, count: int) -> FinishedBatch:
        """The batch of ``count`` rows from number ``first`` on, saved in the folder."""
        start = time.perf_counter()
        chunks = list[Trajectory]()
        receivers = list[Callable[[Trajectory], None]]()
        with contextlib.ExitStack() as stack, interrupts.unwrapped():
            if first == 0:
                receivers.append(lambda chunk: chunks.append(self._shown(chunk)))
            if self.live is not None:
                receivers.append(self.live.add)
            file = None if self.folder is None else self.folder.frames(first, count)
            if file is not None:
                receivers.append(stack.enter_context(batch_frames(file, self.scenario, first, count)).add)
            callbacks = Callbacks(
                advanced=functools.partial(self._advanced, first),
                rows=functools.partial(_hand_on, receivers) if receivers else None,
                drive=self._drive(first),
            )
            batch = self.runner.run(self.schedule.seed, first, count, callbacks=callbacks, keep_rows=False)

        seconds = time.perf_counter() - start
        finished = finish(self.scenario, batch._replace(rows=chunks), first, seconds)
        if self.driver is not None:
            finished.metrics[MISSED] = np.array([self.driver.finish(batch.states)], np.int32)
        self._finish_live(first, finished)
        if self.folder is not None:
            self.folder.save(first, finished)
        self.simulated += float(finished.steps.sum()) * self.scenario.time_step
        return finished

    def _shown(self, chunk: Trajectory) -> Trajectory:
        """A copy of the episodes that the report shows, of a chunk of time (T, B, ...)."""
        return jax.tree.map(lambda leaf: np.array(leaf[:, : self.schedule.shown]), chunk)

    def _advanced(self, first: int, seconds: float, simulated: float) -> None:
        """Show the progress of a batch, of which each episode has lasted ``seconds``."""
        speed = (self.simulated + simulated) / (time.perf_counter() - self.began)
        index = first // (self.schedule.batch * self.schedule.robots)
        done = index * self.scenario.time_limit + seconds
        self.bar.update(done, f"{done:.0f} s of each episode · {speed:,.0f} simulated s per s")

    def _drive(self, first: int) -> Callable[[int, State], Policy] | None:
        """The driver in the scenario of an episode."""
        if self.driver is None:
            return None
        return functools.partial(self.driver, self.runner.scenarios[first % len(self.runner.scenarios)])

    def _finish_live(self, first: int, finished: FinishedBatch) -> None:
        """End the page, which shows the first batch only."""
        if self.live is not None:
            seconds = float(finished.steps[0]) * self.scenario.time_step
            self.live.finish(f"episode {first} {results.outcome(finished.completed[0], seconds)}")
            self.live = None


def _hand_on(receivers: Sequence[Callable[[Trajectory], None]], chunk: Trajectory) -> None:
    for receive in receivers:
        receive(chunk)


def _join(
    stacks: list[Stack[Scenario]],
    policy: Policy,
    batches: list[FinishedBatch],
    wanted: int,
    set_floors: int,
    compile_seconds: float,
) -> Evaluation:
    """The evaluation of all batches; ``wanted`` is the number of rows of all."""
    floors = stacks[0]
    first = stacks[0].member
    totals = [batch.totals for batch in batches]
    steps = np.concatenate([batch.steps for batch in batches])  # (E,)

    # Frames are of the first batch alone, since only its episodes are drawn in the report.
    frames = batches[0].frames

    # Only a driver outside of this program can miss commands; other runs do not show that metric.
    definitions = dict(first.metrics)
    if any(batch.metrics.get(MISSED, np.zeros(1)).any() for batch in batches):
        definitions[MISSED] = MISSED_COMMANDS

    # The task and, of floors that take turns, the floor of each row.
    is_team = first.others is not None
    robots = floors.size if is_team else 1
    rows = np.arange(len(steps))
    tasks = [stack.member.task_name for stack in stacks]

    # Rows go through all tasks on one floor of a set before they change the floor.
    is_set = not is_team and (floors.size > 1 or bool(floors.names))
    turns = rows // len(stacks) % floors.size if is_set else rows % robots
    floor_names = floors.names or [f"floor_{k}" for k in range(floors.size)]

    # Totals count control steps; times the step [s] they are durations.
    return Evaluation(
        scenario=first,
        policy=policy.name,
        situations=tuple(name for name, _ in first.situations),
        tasks=[tasks[k] for k in rows // robots % len(stacks)],
        completed=np.concatenate([batch.completed for batch in batches]),
        timed_out=np.concatenate([batch.timed_out for batch in batches]),
        seconds=steps * first.time_step,
        metrics={name: np.concatenate([batch.metrics[name] for batch in batches]) for name in definitions},
        definitions=definitions,
        heat=_total([each.heat for each in totals]) * first.time_step,
        walks=_total([each.walks for each in totals]),
        together=_total([each.together for each in totals]) * first.time_step,
        penetration=max(float(each.penetration) for each in totals),
        group_size=np.max([each.group_size for each in totals], 0),
        frames=frames,
        compile_seconds=compile_seconds,
        run_seconds=sum(batch.seconds for batch in batches),
        wanted=wanted,
        floors=[floor_names[k] for k in turns] if is_set else [],
        places=[floors.at(k) for k in turns[: len(frames)].tolist()] if is_set or is_team else [],
        set_floors=set_floors,
        robots=floors.names if is_team else (),
    )


def _total(counts: Sequence[Array]) -> np.ndarray:
    """The sum of the counts of all batches."""
    return np.stack(counts).sum(0, dtype=np.int64)

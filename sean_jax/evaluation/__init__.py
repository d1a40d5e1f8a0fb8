"""Evaluation (section V): episodes of a policy in scenarios that take turns, their metrics, a table and a report.

``evaluate`` is a function of values; ``run`` is ``sean run``, which resumes an interrupted run.
"""

from __future__ import annotations

import contextlib
import datetime
import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import jax
import numpy as np
from rich.console import Console
from rich.text import Text

from sean_jax import robots, sensors
from sean_jax.config import OwnPart, RunConfig, Value, outside, user_parts
from sean_jax.config.flags import number
from sean_jax.core.data_types import Policy, PolicyLike, Scenario, State, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.evaluation import compare, results, run_folder
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
from sean_jax.io import files, interrupts, trajectories, writing
from sean_jax.io.progress import Progress, progress
from sean_jax.io.versions import fingerprint
from sean_jax.io.writing import check_new_folder
from sean_jax.learning.policy import check_policy, load_policies, load_policy
from sean_jax.metrics import Metric
from sean_jax.simulation import making
from sean_jax.simulation.episode_runner import CHUNK, Callbacks, Runner
from sean_jax.simulation.scenario_stack import Stack, as_stacks
from sean_jax.web.replay.live import Live, serve
from sean_jax.world import generated

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
            floors that take turns (``making.build_floors``).
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
    loaded = load_policy(policy, stacks[0].member, typed=True)
    if out is not None:
        check_new_folder(Path(out), "out")
    with progress(console) as bar:
        evaluation = _episodes(stacks, loaded, config, stacks[0].size, bar, None, console)
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
    with contextlib.ExitStack() as stack:
        stack.enter_context(user_parts.read_once())
        path = _locked_folder(config, stack)
        folder = RunFolder(path, config)
        stack.enter_context(folder.explain_errors())
        for other, episodes in unfinished_runs(config, path) if config.out is None else []:
            text = f"{other} has {episodes} of {config.episodes} episodes of such a run; --out {other} resumes it"
            console.print(Text(text, "dim"), soft_wrap=True)
        with console.status("preparing the scenario"):
            _check(config, connect is not None)
            inputs = run_folder.read_inputs(config)
            teams = making.build_team(config, config.team) if config.team else None
            stacks = teams or making.build_floors(config, config.episodes)
            wanted = generated.count(config.environment)
            floors, first = stacks[0], stacks[0].member
            if connect is not None and floors.size > 1:
                raise InputError(f"policy: {config.policy.kind} drives on one floor or robot, not on {floors.size}.")
        driver = None if connect is None else stack.enter_context(contextlib.closing(connect(first)))
        policy = load_policies(config.policies, first) if driver is None else driver.policy
        content = first if floors.size == 1 else floors
        folder.check_content(content, policy)
        inputs = inputs._replace(fingerprint=fingerprint(content, policy.params))
        tasks, several = [each.member.task_name for each in stacks], floors.size if wanted > 1 else 0
        robots_of_team = len(config.team) or 1
        title = results.title(first, tasks, config.episodes, several, floors.names if config.team else ())
        devices = f"{len(jax.devices())} × {jax.devices()[0].device_kind}"
        about = f"{number(config.time_limit)} s each, policy {policy.name}, seed {config.seed}, on {devices}"
        console.print(Text(title, "bold"), soft_wrap=True)
        console.print(Text(about, "dim"), soft_wrap=True)
        if floors.size < wanted and not config.team:
            few = f"{config.episodes} episodes are on the first {floors.size} of {wanted} floors"
            console.print(Text(few, "dim"), soft_wrap=True)
        if folder.episodes:
            console.print(f"[dim]going on after {folder.episodes} finished episodes[/]", highlight=False)
        live = None
        if config.live:
            live = stack.enter_context(serve(first, f"{path.name} · live"))
            console.print(f"live: {live.url}", highlight=False, soft_wrap=True)
        with progress(console) as bar:
            evaluation = _episodes(stacks, policy, config, wanted, bar, folder, console, live, driver)
        evaluation.print_table(console)
        count = len(evaluation.tasks) // robots_of_team
        with console.status("drawing the report"), folder.results(count == config.episodes) as stage:
            results.write_all(stage, evaluation, config, inputs)
            if config.trajectories is not None:
                size = _batch_size(config, stacks)
                parts = [folder.frames(base, min(size, config.episodes - base)) for base in range(0, count, size)]
                whole = stage / f"trajectories.{config.trajectories}"
                trajectories.join_trajectories([part for part in parts if part is not None], whole)
    return path, evaluation


def _episodes(
    stacks: list[Stack[Scenario]],
    policy: Policy,
    config: RunConfig,
    set_floors: int,
    bar: Progress,
    folder: RunFolder | None,
    console: Console | None,
    live: Live | None = None,
    driver: Driver | None = None,
) -> Evaluation:
    """Batch after batch; finished ones are loaded from ``folder``, and new ones are saved there."""
    robots_of_team = len(config.team) or 1  # each has rows of its own
    episodes, first = config.episodes * robots_of_team, stacks[0].member
    size = _batch_size(config, stacks) * robots_of_team
    shown = -(-FRAMES // robots_of_team) * robots_of_team
    starts = range(0, episodes, size)
    runner, batches, simulated, began = None, list[FinishedBatch](), 0.0, 0.0
    try:
        for base in starts:
            count = min(size, episodes - base)
            if folder is not None and (batch := folder.load(base, count)) is not None:
                batches.append(batch)
                continue
            if runner is None:
                run_record = record(stacks[0], size, shown if config.trajectories is None else size)
                programs = Runner(
                    stacks, policy, size, "run", run_record, chunk=CHUNK if driver is None else first.time_step
                )
                programs.compile(Callbacks(compiling=bar.stage))
                if console is not None:
                    console.print(f"[dim]compiled in {programs.compile_seconds:.1f} s[/]", highlight=False)
                bar.start("simulating", len(starts) * first.time_limit)
                runner, began = programs, time.perf_counter()

            def advanced(seconds: float, more: float, base: int = base, s: float = simulated, t: float = began) -> None:
                speed = (s + more) / (time.perf_counter() - t)
                done = base // size * first.time_limit + seconds
                bar.update(done, f"{done:.0f} s of each episode · {speed:,.0f} simulated s per s")

            batches.append(_simulate(runner, config.seed, base, count, advanced, folder, live, driver))
            live = None  # the page shows the first batch only
            simulated += float(batches[-1].steps.sum()) * first.time_step
    except KeyboardInterrupt:
        if not batches or runner is None:
            raise
    return _join(stacks, policy, batches, episodes, set_floors, 0.0 if runner is None else runner.compile_seconds)


def _batch_size(config: RunConfig, stacks: list[Stack[Scenario]]) -> int:
    """Episodes of a batch; of several floors, a batch has whole turns if there is another batch."""
    size, turn = min(config.episodes, 1 if outside(config.policy) else config.batch), len(stacks)
    if stacks[0].size == 1 or size == config.episodes or config.team:
        return size
    period = turn * stacks[0].size
    return size - size % period if size >= period else max(turn, size - size % turn)


def _simulate(
    runner: Runner,
    seed: int,
    base: int,
    count: int,
    advanced: Callable[[float, float], None],
    folder: RunFolder | None,
    live: Live | None,
    driver: Driver | None,
) -> FinishedBatch:
    """A batch of ``count`` episodes, saved in the folder; ``live`` shows its first episode meanwhile."""
    scenario, start = runner.scenarios[0], time.perf_counter()
    shown = -(-FRAMES // runner.robots) * runner.robots
    file = None if folder is None else folder.frames(base, count)
    report_frames, receivers = list[Trajectory](), list[Callable[[Trajectory], None]]()
    with contextlib.ExitStack() as stack, interrupts.unwrapped():
        if live is not None:
            receivers.append(live.add)
        if file is not None:
            receivers.append(stack.enter_context(batch_frames(file, scenario, base, count)).add)

        def rows(chunk: Trajectory) -> None:
            if base == 0:  # a copy of the episodes that the report shows, of a chunk of time (T, B, ...)
                report_frames.append(jax.tree.map(lambda leaf: np.array(leaf[:, :shown]), chunk))
            for receive in receivers:
                receive(chunk)

        own = runner.scenarios[base % len(runner.scenarios)]
        drive = None if driver is None else functools.partial(driver, own)
        callbacks = Callbacks(advanced=advanced, rows=rows if receivers or base == 0 else None, drive=drive)
        batch = runner.run(seed, base, count, callbacks=callbacks, keep_rows=False)
    seconds = time.perf_counter() - start
    finished = finish(scenario, batch._replace(rows=report_frames), base, seconds)
    if driver is not None:
        finished.metrics[MISSED] = np.array([driver.finish(batch.states)], np.int32)
    if live is not None:
        ended = results.outcome(finished.completed[0], float(finished.steps[0]) * scenario.time_step)
        live.finish(f"episode {base} {ended}")
    if folder is not None:
        folder.save(base, finished)
    return finished


def _join(
    stacks: list[Stack[Scenario]],
    policy: Policy,
    batches: list[FinishedBatch],
    wanted: int,
    set_floors: int,
    compile_seconds: float,
) -> Evaluation:
    floors, first, totals = stacks[0], stacks[0].member, [batch.totals for batch in batches]

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(batch, name) for batch in batches])

    def total(name: str) -> np.ndarray:
        return np.stack([getattr(each, name) for each in totals]).sum(0, dtype=np.int64)

    completed, frames = joined("completed"), batches[0].frames
    definitions = dict(first.metrics)
    if any(batch.metrics.get(MISSED, np.zeros(1)).any() for batch in batches):
        definitions[MISSED] = MISSED_COMMANDS
    team = first.others is not None
    is_set = not team and (floors.size > 1 or bool(floors.names))
    turns = [i // len(stacks) % floors.size for i in range(len(completed))] if is_set else []
    robots_of_team = floors.size if team else 1
    return Evaluation(
        scenario=first,
        policy=policy.name,
        situations=tuple(name for name, _ in first.situations),
        tasks=[stacks[i // robots_of_team % len(stacks)].member.task_name for i in range(len(completed))],
        completed=completed,
        timed_out=joined("timed_out"),
        seconds=joined("steps") * first.time_step,
        metrics={name: np.concatenate([batch.metrics[name] for batch in batches]) for name in definitions},
        definitions=definitions,
        heat=total("heat") * first.time_step,
        walks=total("walks"),
        together=total("together") * first.time_step,
        penetration=max(float(each.penetration) for each in totals),
        group_size=np.max([each.group_size for each in totals], 0),
        frames=frames,
        compile_seconds=compile_seconds,
        run_seconds=sum(batch.seconds for batch in batches),
        wanted=wanted,
        floors=[floors.names[turn] if floors.names else f"floor_{turn}" for turn in turns],
        places=[floors.at(i % floors.size if team else turns[i]) for i in range(len(frames)) if team or is_set],
        set_floors=set_floors,
        robots=floors.names if team else (),
    )


def _locked_folder(config: RunConfig, stack: contextlib.ExitStack) -> Path:
    """The folder for the results, locked until the stack is closed."""
    now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    if config.out is not None:
        check_run_folder(config.out)
        stack.enter_context(writing.folder_lock(config.out))
        return config.out
    folder, attempt = config.folder(now), 1
    while True:  # several runs may begin in one second
        try:
            if not folder.exists():
                stack.enter_context(writing.folder_lock(folder))
                return folder
        except writing.WriteError:
            if not folder.exists():
                raise
        attempt += 1
        folder = config.folder(f"{now}-{attempt}")


def _check(config: RunConfig, driven: bool) -> None:
    """Refuse wrong options before the scenario is built, which takes long; the policy too, unless it is driven."""
    if config.baseline is not None:
        compare.read(config.baseline)
    if config.trajectories is not None:
        trajectories.check_packages(f".{config.trajectories}")
    making.check(config)
    if config.team:
        for name in config.team:
            if name not in robots.ROBOTS:  # a file of a robot is not copied beside the results
                raise InputError(files.unknown_name("robots", name, robots.ROBOTS))
        making.check_team(config, config.team)
    for policy in config.policies if not driven else []:
        check_policy(policy, config)
    for robot in config.robot_parts:
        if config.camera is not None and not isinstance(robot, OwnPart | Value):
            try:
                sensors.camera(robots.load(robot.kind), config.camera)
            except ValueError as error:
                raise InputError(str(error)) from error

"""Evaluation (section V): episodes of a policy in scenarios that take turns, their metrics, a table and a report.

``evaluate`` is the main job as a function of values; ``run`` is ``sean run``, which goes on where it was interrupted.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from sean_jax import assembly, components, drawing, interrupts, robots, sensors, trajectories, writing
from sean_jax.base import Policy, PolicyLike, Scenario, Trajectory
from sean_jax.config import OwnPart, RunConfig, Value
from sean_jax.errors import InputError
from sean_jax.evaluation import frames, inputs, output, statistics, table, tally
from sean_jax.evaluation.tally import Finished
from sean_jax.evaluation.unfinished import Unfinished, check_place, unfinished_runs
from sean_jax.flags import number
from sean_jax.learning.policy import check_policy, load_policy
from sean_jax.metrics import Metric
from sean_jax.progress import Progress, progress
from sean_jax.replay.live import Live, serve
from sean_jax.runner import Batch, Runner, Watch, not_finite
from sean_jax.scenario import results
from sean_jax.versions import fingerprint
from sean_jax.writing import check_new_folder

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Evaluation", "evaluate", "run"]


@dataclasses.dataclass
class Evaluation:
    """What a policy did in E episodes, as numpy arrays; S situations."""

    scenario: Scenario  # the first of those that took turns
    policy: str
    situations: tuple[str, ...]
    tasks: list[str]  # per episode
    completed: np.ndarray  # (E,) bool
    timed_out: np.ndarray  # (E,) bool
    seconds: np.ndarray  # (E,) s, until the episode ended
    metrics: dict[str, np.ndarray]  # name -> (E,) or (E, 1 + S): overall, then by situation
    definitions: dict[str, Metric]  # name -> the metric, in the scenario's order
    heat: np.ndarray  # (rows, columns) s that people spent in each cell of the floor
    walks: np.ndarray  # (M, M) people who walked the edge from the row's node to the column's, (0, 0) without a graph
    together: np.ndarray  # (2 ** S,) s of robot time per set of situations
    penetration: float  # m, deepest that a body was in an obstacle
    group_size: np.ndarray  # (G,) most members
    frames: list[Trajectory]  # of the first episodes, (T, ...) each
    compile_seconds: float
    run_seconds: float
    wanted: int  # episodes asked for; fewer are here after Ctrl-C

    def summary(self) -> dict[str, Any]:
        """Shares of the situations, means of the metrics with 95 % bootstrap intervals, checks and timing."""
        simulated = float(self.seconds.sum())
        return {
            "scenario": self.names(),
            "episodes": len(self.tasks),
            "episodes_wanted": self.wanted,
            "simulated_seconds": round(simulated, 3),
            **statistics.aggregate(self),
            "checks": {
                "largest_penetration_mm": round(max(1000.0 * self.penetration, 0.0), 4),
                "people_inside_obstacles": bool(self.penetration > float(self.scenario.forces.walking.radius)),
                "largest_groups": [int(size) for size in self.group_size],
                "not_finite": 0,
            },
            "timing": {
                "compile_seconds": round(self.compile_seconds, 3),
                "run_seconds": round(self.run_seconds, 3),
                "simulated_seconds_per_second": round(simulated / max(self.run_seconds, 1e-9), 1),
                "device": f"{len(jax.devices())} x {jax.devices()[0].device_kind}",
            },
        }

    def names(self) -> dict[str, Any]:
        """What took part, by name."""
        scenario = self.scenario
        return {
            "environment": scenario.environment.name,
            "behavior": scenario.behavior.name,
            "tasks": list(dict.fromkeys(self.tasks)),
            "robot": scenario.robot.name,
            "policy": self.policy,
            "people": scenario.people,
        }

    @property
    def title(self) -> str:
        """What took part, in one line."""
        return _title(self.scenario, list(dict.fromkeys(self.tasks)), len(self.tasks))

    def rows(self, complete: bool = False) -> list[table.Row]:
        """The rows of the table.

        Args:
            complete: every metric, not only the headlines.
        """
        return table.rows(self.summary(), self.definitions, complete)

    def table(self, width: int = 120) -> str:
        """The table as text."""
        from rich.console import Console

        stream = io.StringIO()
        console = Console(file=stream, width=width, color_system=None)
        table.print_table(console, self.summary(), self.definitions, self.title, self.exclusive_shares()["none"])
        return stream.getvalue()

    def exclusive_shares(self) -> dict[str, float]:
        """Shares of robot time that add up to one.

        Returns:
            Situation, or "none", -> share; time in several situations is divided equally among them.
        """
        return statistics.exclusive_shares(self)

    def save(self, folder: Path | str) -> Path:
        """Write the files of ``sean run``: the report, episodes.csv, summary.json, the animation.

        Args:
            folder: a new or an empty one.

        Raises:
            InputError: it holds something.
            WriteError: it cannot be written.
        """
        folder = Path(folder)
        check_new_folder(folder, "folder")
        with writing.atomic_folder(folder) as made:
            output.write_all(made, self)
        return folder


def evaluate(
    scenario: Scenario | Sequence[Scenario],
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
        scenario: what is simulated; several, which differ in their task or in leaves alone, take turns.
        policy: who drives: a ``Policy``, a function (scenario, state, key) -> (2,) [m/s, rad/s], a name, the folder of
            a training, or FILE.py:NAME.
        seed: the same seed gives the same episodes, those of ``sean run``.
        out: folder to write the report and all results to; a new or an empty one.

    Returns:
        The metrics of each episode, and what was counted over all.

    Raises:
        InputError: the scenarios do not go together, there is no such policy, or the folder holds something.
        FloatingPointError: a number is not finite; the message names the episodes.
    """
    scenarios = [scenario] if isinstance(scenario, Scenario) else list(scenario)
    config = RunConfig(episodes=episodes, seed=seed, batch=batch)
    driver = load_policy(policy, scenarios[0])
    if out is not None:
        check_new_folder(Path(out), "out")
    with progress(console) as tell:
        evaluation = _episodes(scenarios, driver, config, tell, None, console)
    if out is not None:
        evaluation.save(out)
    return evaluation


def run(config: RunConfig, console: Console) -> tuple[Path, Evaluation]:
    """``sean run``: simulate, summarize, write.

    Fewer episodes than asked for are there after Ctrl-C between two batches. Batches that were finished until then, or
    until a kill, stay in the folder; given the same description and that folder, the run goes on.

    Raises:
        InputError: the description cannot be met.
        WriteError: the folder cannot be written.
        FloatingPointError: a number is not finite.
        IncompleteError: the disk is full, or something else broke midway.
        KeyboardInterrupt: no batch was finished.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(components.read_once())
        folder = _own_folder(config, stack)
        unfinished = Unfinished(folder, config)
        stack.enter_context(unfinished.explained())
        _tell_of_others(console, config, folder)
        with console.status("preparing the scenario"):
            _check(config)
            made_of = inputs.read(config)
            scenarios = assembly.build(config)
            policy = load_policy(config.policy, scenarios[0])
        unfinished.settle(scenarios[0], policy)
        made_of = made_of._replace(fingerprint=fingerprint(scenarios[0], policy.params))
        _introduce(console, scenarios, policy, config)
        if unfinished.episodes:
            console.print(f"[dim]going on after {unfinished.episodes} finished episodes[/]", highlight=False)
        live = None
        if config.live:
            live = stack.enter_context(serve(scenarios[0], f"{folder.name} · live"))
            console.print(f"live: {live.url}", highlight=False, soft_wrap=True)
        with progress(console) as tell:
            evaluation = _episodes(scenarios, policy, config, tell, unfinished, console, live)
        none = evaluation.exclusive_shares()["none"]
        table.print_table(console, evaluation.summary(), evaluation.definitions, evaluation.title, none)
        complete = len(evaluation.tasks) == config.episodes
        with console.status("drawing the report"), unfinished.results(complete) as place:
            output.write_all(place, evaluation, config, made_of)
            if config.trajectories is not None:
                parts = [unfinished.frames(*batch) for batch in _batches(len(evaluation.tasks), config)]
                whole = place / f"trajectories.{config.trajectories}"
                trajectories.join_trajectories([part for part in parts if part is not None], whole)
    return folder, evaluation


def _episodes(
    scenarios: list[Scenario],
    policy: Policy,
    config: RunConfig,
    tell: Progress,
    unfinished: Unfinished | None,
    console: Console | None,
    live: Live | None = None,
) -> Evaluation:
    """Batch after batch; those that are finished are taken from ``unfinished``, and new ones kept there."""
    episodes, size, first = config.episodes, min(config.episodes, config.batch), scenarios[0]
    starts = range(0, episodes, size)

    def load(base: int) -> Finished | None:
        return None if unfinished is None else unfinished.load(base, min(size, episodes - base))

    runner, found = None, list[Finished]()
    for base in starts:
        if (batch := load(base)) is None:
            break
        found.append(batch)
    if len(found) < len(starts):
        recorded = tally.FRAMES if config.trajectories is None else size
        runner = Runner(scenarios, policy, size, "run", tally.record(first, size, recorded))
        runner.compile(Watch(compiling=tell.stage))
        if console is not None:
            console.print(f"[dim]compiled in {runner.compile_seconds:.1f} s[/]", highlight=False)
        tell.start("simulating", len(starts) * first.time_limit)
        began, simulated_before = time.perf_counter(), 0.0
        try:
            for base in starts[len(found) :]:
                if (finished := load(base)) is not None:
                    found.append(finished)
                    continue

                def advanced(seconds: float, simulated: float, base: int = base, s: float = simulated_before) -> None:
                    speed = (s + simulated) / (time.perf_counter() - began)
                    done = base // size * first.time_limit + seconds
                    tell.update(done, f"{done:.0f} s of each episode · {speed:,.0f} simulated s per s")

                start, count = time.perf_counter(), min(size, episodes - base)
                rows, file = list[Trajectory](), None if unfinished is None else unfinished.frames(base, count)
                takers = list[Callable[[Trajectory], None]]()
                if base == 0:
                    takers.append(lambda chunk, rows=rows: rows.append(_first(chunk)))
                if live is not None:
                    takers.append(live.add)
                with contextlib.ExitStack() as stack, interrupts.unwrapped():
                    if file is not None:
                        takers.append(stack.enter_context(frames.kept(file, first, base, count)).add)
                    watch = Watch(advanced=advanced, rows=_to_all(takers) if takers else None)
                    batch = runner.run(config.seed, base, count, watch=watch, keep_rows=False)
                finished = _finished(first, batch._replace(rows=rows), base, time.perf_counter() - start)
                if live is not None:
                    ended = output.outcome(bool(finished.completed[0]), float(finished.steps[0]) * first.time_step)
                    live.finish(f"episode {base} {ended}")
                    live = None  # the frames of other batches stay where they are
                if unfinished is not None:
                    unfinished.save(base, finished)
                found.append(finished)
                simulated_before += float(finished.steps.sum()) * first.time_step
        except KeyboardInterrupt:
            if not found:
                raise
    return _joined(scenarios, policy, found, episodes, 0.0 if runner is None else runner.compile_seconds)


def _batches(episodes: int, config: RunConfig) -> list[tuple[int, int]]:
    """First episode and number of episodes of each batch, of so many episodes that are finished."""
    size = min(config.episodes, config.batch)
    return [(base, min(size, config.episodes - base)) for base in range(0, episodes, size)]


def _first(chunk: Trajectory) -> Trajectory:
    """Of a chunk of time (T, B, ...), a copy of the episodes that the report shows."""
    return jax.tree.map(lambda leaf: np.array(leaf[:, : tally.FRAMES]), chunk)


def _to_all(takers: Sequence[Callable[[Trajectory], None]]) -> Callable[[Trajectory], None]:
    def rows(chunk: Trajectory) -> None:
        for take in takers:
            take(chunk)

    return rows


def _finished(scenario: Scenario, batch: Batch, base: int, seconds: float) -> Finished:
    measured = jax.tree.map(np.asarray, jax.vmap(results, (None, 0))(scenario, batch.states))
    faulty = np.zeros(len(batch.steps), bool)
    for values in measured.values():
        faulty |= np.isnan(values.reshape(len(faulty), -1)[:, 0])
    if faulty.any():
        raise FloatingPointError(not_finite(base + np.flatnonzero(faulty), len(faulty)))
    ended = np.asarray(batch.states.completed), np.asarray(batch.states.timed_out)
    shown = tally.episodes(batch.rows, len(batch.steps))
    return Finished(*ended, batch.steps, measured, batch.total, shown, seconds)


def _joined(
    scenarios: list[Scenario], policy: Policy, batches: list[Finished], wanted: int, compile_seconds: float
) -> Evaluation:
    first, tallies = scenarios[0], [batch.tally for batch in batches]
    completed = np.concatenate([batch.completed for batch in batches])
    return Evaluation(
        scenario=first,
        policy=policy.name,
        situations=tuple(name for name, _ in first.situations),
        tasks=[scenarios[i % len(scenarios)].task_name for i in range(len(completed))],
        completed=completed,
        timed_out=np.concatenate([batch.timed_out for batch in batches]),
        seconds=np.concatenate([batch.steps for batch in batches]) * first.time_step,
        metrics={name: np.concatenate([batch.metrics[name] for batch in batches]) for name, _ in first.metrics},
        definitions=dict(first.metrics),
        heat=np.stack([each.heat for each in tallies]).sum(0, dtype=np.int64) * first.time_step,
        walks=np.stack([each.walks for each in tallies]).sum(0, dtype=np.int64),
        together=np.stack([each.together for each in tallies]).sum(0, dtype=np.int64) * first.time_step,
        penetration=max(float(each.penetration) for each in tallies),
        group_size=np.max([each.group_size for each in tallies], 0),
        frames=batches[0].frames,
        compile_seconds=compile_seconds,
        run_seconds=sum(batch.seconds for batch in batches),
        wanted=wanted,
    )


def _own_folder(config: RunConfig, stack: contextlib.ExitStack) -> Path:
    """The folder for the results, which nobody else writes until the stack is closed."""
    now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    if config.out is not None:
        check_place(config.out)
        stack.enter_context(writing.folder_lock(config.out))
        return config.out
    folder, attempt = config.folder(now), 1
    while True:  # for several runs may begin in one second
        try:
            if not folder.exists():
                stack.enter_context(writing.folder_lock(folder))
                return folder
        except writing.WriteError:
            if not folder.exists():
                raise
        attempt += 1
        folder = config.folder(f"{now}-{attempt}")


def _tell_of_others(console: Console, config: RunConfig, folder: Path) -> None:
    from rich.text import Text

    for place, episodes in unfinished_runs(config, folder) if config.out is None else []:
        text = f"{place} has {episodes} of {config.episodes} episodes of such a run; --out {place} goes on with it"
        console.print(Text(text, "dim"), soft_wrap=True)


def _check(config: RunConfig) -> None:
    """Refuse all that can be told before the scenario is made, which takes long."""
    if config.trajectories is not None:
        trajectories.check_packages(f".{config.trajectories}")
    if config.camera is not None:
        drawing.check_renderer(config.renderer or "rays")
    assembly.check(config)
    check_policy(config.policy, config)
    if config.camera is not None and not isinstance(config.robot, OwnPart | Value):
        try:
            sensors.camera(robots.load(config.robot.kind, "twin"), config.camera)
        except ValueError as error:
            raise InputError(str(error)) from error


def _title(scenario: Scenario, tasks: list[str], episodes: int) -> str:
    what = f"{scenario.environment.name} · {scenario.behavior.name} · {' / '.join(tasks)} · {scenario.robot.name}"
    return f"{what} · {scenario.people} people · {episodes} episodes"


def _introduce(console: Console, scenarios: list[Scenario], policy: Policy, config: RunConfig) -> None:
    from rich.text import Text

    devices, tasks = jax.devices(), [scenario.task_name for scenario in scenarios]
    console.print(Text(_title(scenarios[0], tasks, config.episodes), "bold"), soft_wrap=True)
    about = f"{number(config.time_limit)} s each, policy {policy.name}, seed {config.seed}"
    console.print(Text(f"{about}, on {len(devices)} × {devices[0].device_kind}", "dim"), soft_wrap=True)

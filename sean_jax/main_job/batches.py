"""Batch after batch of episodes until there are as many as asked for; what is finished is kept, whatever comes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sean_jax.base import Policy, Scenario
from sean_jax.main_job import simulation
from sean_jax.main_job.results import Results
from sean_jax.main_job.simulation import Batch, Watch

if TYPE_CHECKING:
    from sean_jax.main_job.unfinished import Unfinished


def run_batches(
    scenarios: Sequence[Scenario],
    policy: Policy,
    episodes: int,
    batch: int,
    seed: int,
    watch: Watch,
    unfinished: Unfinished | None = None,
) -> Results:
    """Simulate ``episodes`` episodes, at most about ``batch`` at once.

    ``scenarios`` differ in their task alone and take turns. The batches that ``unfinished`` has are not simulated
    again, and the others are kept there. After Ctrl-C the finished batches are returned, or KeyboardInterrupt is raised
    if there are none. Raises FloatingPointError naming the episodes with a NaN.
    """
    size, limit = min(episodes, batch), scenarios[0].time_limit
    bases = range(0, episodes, size)

    def loaded(base: int) -> Batch | None:
        return None if unfinished is None else unfinished.load(base, min(size, episodes - base))

    batches: list[Batch] = []
    for base in bases:
        if (found := loaded(base)) is None:
            break
        batches.append(found)
    if len(batches) == len(bases):
        return _results(scenarios, batches, episodes, 0.0)
    programs = simulation.prepare(scenarios, policy, size, watch)
    watch.begun(len(bases) * limit)
    began, before = time.perf_counter(), 0.0
    try:
        for base in bases[len(batches) :]:
            if (found := loaded(base)) is not None:
                batches.append(found)
                continue

            def advanced(done: float, simulated: float, base: int = base, before: float = before) -> None:
                speed = (before + simulated) / (time.perf_counter() - began)
                watch.advanced(base // size * limit + done, speed)

            start = time.perf_counter()
            done = simulation.run_batch(programs, seed, base, min(size, episodes - base), advanced)
            done.seconds = time.perf_counter() - start
            _refuse_nan(done, base)
            if unfinished is not None:
                unfinished.save(base, done)
            batches.append(done)
            before += float(done.tally.steps.sum()) * scenarios[0].time_step
    except KeyboardInterrupt:
        if not batches:
            raise
    return _results(scenarios, batches, episodes, programs.seconds)


def _results(scenarios: Sequence[Scenario], batches: list[Batch], wanted: int, compile_seconds: float) -> Results:
    first, tallies = scenarios[0], [batch.tally for batch in batches]
    completed = np.concatenate([batch.completed for batch in batches])
    measured = {name: np.concatenate([batch.metrics[name] for batch in batches]) for name, _ in first.metrics}
    return Results(
        situations=tuple(name for name, _ in first.situations),
        tasks=[scenarios[i % len(scenarios)].task_name for i in range(len(completed))],
        completed=completed,
        timed_out=np.concatenate([batch.timed_out for batch in batches]),
        seconds=np.concatenate([tally.steps for tally in tallies]) * first.time_step,
        metrics=measured,
        counts=tuple(name for name, metric in first.metrics if metric.unit == "count"),
        walks=np.stack([tally.walks for tally in tallies]).sum(0, dtype=np.int64),
        heat=np.stack([tally.heat for tally in tallies]).sum(0, dtype=np.int64) * first.time_step,
        together=np.stack([tally.together for tally in tallies]).sum(0, dtype=np.int64) * first.time_step,
        penetration=max(float(tally.penetration) for tally in tallies),
        group_size=np.max([tally.group_size for tally in tallies], 0),
        frames=batches[0].frames,
        compile_seconds=compile_seconds,
        run_seconds=sum(batch.seconds for batch in batches),
        wanted=wanted,
    )


def _refuse_nan(batch: Batch, base: int) -> None:
    faulty = batch.tally.faulty
    for values in batch.metrics.values():
        faulty = faulty | np.isnan(values.reshape(len(faulty), -1)[:, 0])
    if faulty.any():
        which = base + np.flatnonzero(faulty)
        listed = ", ".join(map(str, which[:8])) + (f" and {len(which) - 8} more" if len(which) > 8 else "")
        raise FloatingPointError(f"{len(which)} of {len(faulty)} episodes hold numbers that are not finite: {listed}.")

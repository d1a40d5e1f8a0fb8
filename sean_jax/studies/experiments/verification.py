"""``sean benchmark verify FOLDER``: a random sample of a result's episodes is simulated again, measure by measure.

The sample is a batch of episodes of each of some tracks. On the same kind of device with the same versions it is the
same program with the same inputs, so each number must be that of the result, within a tolerance for what is stored.
Elsewhere programs round differently and episodes diverge; then the means must agree: the differences of the same
episodes may not be significant after Holm's correction for all of them.
"""

from __future__ import annotations

import dataclasses
import functools
import secrets
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from sean_jax.config import BenchmarkVerifyConfig, Component, is_own_part, outside
from sean_jax.core.errors import InputError
from sean_jax.io.versions import version_mismatch
from sean_jax.metrics.differences import difference, holm
from sean_jax.studies.experiments import ExperimentPart, benchmark, run_parts, shares
from sean_jax.studies.experiments.scores import Arrays

if TYPE_CHECKING:
    from rich.console import Console

TOLERANCE = 1e-3  # of a number, relative and absolute
LEVEL = 0.01  # of corrected p-values, so that one honest result in a hundred is refused at most


@dataclasses.dataclass(frozen=True)
class Sample:
    """Episodes of a track as the result has them, and as they are simulated here."""

    track: str
    numbers: range
    had: Arrays
    now: Arrays

    def differ(self, name: str) -> np.ndarray:
        """(E,) bool, episodes whose measure differs by more than the tolerance."""
        had, now = (columns[name].astype(float).reshape(len(self.numbers), -1) for columns in (self.had, self.now))
        return np.logical_not(np.isclose(now, had, TOLERANCE, TOLERANCE).all(axis=1, keepdims=True))[:, 0]

    def equal(self) -> int:
        """Number of episodes that are equal in each measure."""
        return int((~np.any([self.differ(name) for name in self.had], axis=0)).sum())


def verify(options: BenchmarkVerifyConfig, console: Console | None = None) -> tuple[list[str], str]:
    """Simulate a sample of a result's episodes again.

    Returns:
        What was compared, in lines, and a sentence on what differs, "" if the result is verified.

    Raises:
        InputError: ``benchmark.check`` refuses the result, its policy or recordings are not here, or its policy is a
            controller outside of this program.
        IncompleteError: as in ``benchmark.check``.
    """
    benchmark.check_protocol()
    result = benchmark.check(options.result)
    driver = _driver(options, result)
    names = _verifiable_tracks(options, result)

    seed = secrets.randbits(32) if options.seed is None else options.seed
    random = np.random.default_rng(seed)
    tracks = [names[k] for k in random.choice(len(names), min(options.tracks, len(names)), replace=False)]
    chosen = {track: int(random.integers(result.episodes)) for track in tracks}
    jobs = [
        ExperimentPart(track, functools.partial(_again, options, driver, result, track, episode))
        for track, episode in chosen.items()
    ]
    samples = list(run_parts(jobs, console, "benchmark").values())

    # Another device or version rounds differently, and then episodes diverge.
    here, mismatch = benchmark.device(), version_mismatch(result.versions)
    same = here == result.device and mismatch is None
    origin = "" if same else f"; the result is of {result.device}{mismatch and f', {mismatch}' or ''}"
    lines = [f"sample of seed {seed}, on {here}{origin}"]
    for sample in samples:
        numbers = f"episodes {sample.numbers[0]} to {sample.numbers[-1]}"
        lines.append(f"  {sample.track:<28}{numbers}: {sample.equal()} of {len(sample.numbers)} are equal")
    differences = unequal(samples) if same else significant(samples)
    if differences:
        return lines, f"the sample differs from the result: {', '.join(differences)}."
    lines.append("verified: " + ("equal in each measure" if same else "no measure differs beyond chance"))
    return lines, ""


def _driver(options: BenchmarkVerifyConfig, result: benchmark.Result) -> Component:
    """The policy of a result.

    Raises:
        InputError: it is another one, or a controller outside of this program.
    """
    policy = options.policy or result.policy
    source = None if options.policy else options.result / benchmark.RESULT
    driver = benchmark.read_policy(policy, source, typed=options.policy is not None)
    if outside(driver):
        raise InputError(f"{options.result}: {policy} is a controller outside of this program, which need not repeat.")
    described = benchmark.describe(driver)
    if described.policy_digest != result.policy_digest:
        raise InputError(
            f"--policy: {policy} has the digest {described.policy_digest}, and the result's policy "
            f"{result.policy_digest}; give the place of that policy."
        )
    if not is_own_part(policy) and described.sensing != result.sensing:
        raise InputError(f"{options.result}: sensing {result.sensing} is not that of {policy}, {described.sensing}.")
    return driver


def _verifiable_tracks(options: BenchmarkVerifyConfig, result: benchmark.Result) -> list[str]:
    """The tracks of a result whose recordings are given.

    Raises:
        InputError: a recording is another one.
    """
    recorded = benchmark.recorded()
    names = [track for track in result.files if options.recordings or track not in recorded]
    for file, digest in benchmark.recording_digests(names, options.recordings).items():
        if digest != result.recordings[file]:
            raise InputError(f"--recordings: {options.recordings / file} is not the recording of the result.")  # pyright: ignore
    return names


def _again(
    options: BenchmarkVerifyConfig,
    policy: Component,
    result: benchmark.Result,
    track: str,
    episode: int,
    tell: Callable[[float], None],
) -> Sample:
    numbers, now = benchmark.batch_again(policy, track, options.recordings, result.episodes, episode, tell)
    columns = benchmark.read_track(options.result, track, result.episodes)
    had = {name: values[numbers.start : numbers.stop] for name, values in columns.items()}
    return Sample(track, numbers, had, now)


def unequal(samples: list[Sample]) -> list[str]:
    """The measures in which episodes differ by more than the tolerance, in words."""
    return [
        f"{name} of {number} of {len(sample.numbers)} episodes of {sample.track}"
        for sample in samples
        for name in sample.had
        if (number := int(sample.differ(name).sum()))
    ]


def significant(samples: list[Sample]) -> list[str]:
    """The measures whose means differ beyond chance, in words."""
    tests = []
    for sample in samples:
        for name, had in sample.had.items():
            columns = had.astype(float).reshape(len(had), -1).T, sample.now[name].astype(float).reshape(len(had), -1).T
            for situation, (one, other) in zip(("", *shares.NAMES), zip(*columns, strict=True), strict=False):
                where = f"{name}{situation and f' in {situation}'} of {sample.track}"
                tests.append((where, difference(one, other, paired=True)))
    corrected = holm([test.p for _, test in tests if test is not None])
    return [
        f"{where} by {test.difference:.3g} ({test.low:.3g} to {test.high:.3g})"
        for (where, test), p in zip(tests, corrected, strict=True)
        if test is not None and p < LEVEL
    ]

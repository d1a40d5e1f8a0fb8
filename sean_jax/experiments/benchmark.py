"""``sean benchmark POLICY``: a driver on the tracks of a frozen protocol, a table by situation and a sealed result.

All drivers drive the same numbered episodes, so that two of them are compared in pairs. ``tracks`` has the protocol.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax import assembly, components, files, writing
from sean_jax.config import BenchmarkConfig, OwnPart, RunConfig, validate
from sean_jax.errors import IncompleteError, InputError
from sean_jax.experiments import page, parts, tracks
from sean_jax.experiments.together import Part, together
from sean_jax.learning import choice
from sean_jax.metrics import Estimate, aggregate, aggregate_ratio, bootstrap
from sean_jax.runner import Runner, Watch
from sean_jax.scenario import results
from sean_jax.versions import fingerprint, version_mismatch, versions

if TYPE_CHECKING:
    from rich.console import Console

BATCH = {"cpu": 64}  # episodes at once, by kind of device
BATCH_ELSEWHERE = 4_200
RESULT, REPORT, DRIVER = "result.json", "report.html", "driver.json"
RESAMPLES = 1_000
ROBOTS_FAULT = "intimate_robot_on_person", "collision_robot_on_person", "collision_with_obstacle"
COUNTED = (*ROBOTS_FAULT, "intimate_person_on_robot", "collision_person_on_robot")
METRICS = ("time_in_situation", *COUNTED, "time_not_moving", "path_efficiency")
Columns = dict[str, np.ndarray]  # of the E episodes of a track: (E,), or (E, 1 + S) overall and by situation


@dataclasses.dataclass(frozen=True)
class Scores:
    """What a driver did, over all tracks or on one; each number with its 95 % interval."""

    FIGURES = {
        "polite": "completed politely %",
        "completed": "completed %",
        "seconds": "s",
        "intimate_robot_on_person": "within 0.45 m, by the robot",
        "intimate_person_on_robot": "by people",
        "collision_robot_on_person": "touched people",
        "collision_with_obstacle": "touched obstacles",
    }
    figures: dict[str, Estimate]  # name of FIGURES -> () mean of an episode
    shares: Estimate  # (S,) of the time in each situation
    violations: Estimate  # (S,) times a minute, in each situation, that the robot came within 0.45 m of somebody


def run(options: BenchmarkConfig, console: Console | None = None) -> Path:
    """Drive the tracks that the folder lacks, and write the result and the report.

    Args:
        options: of the benchmark.
        console: shows progress; None shows nothing.

    Returns:
        The folder.

    Raises:
        InputError: there is no such driver, the folder holds something else, or this package is not that of the
            protocol.
        WriteError: another process writes in the folder.
        IncompleteError: a file in the folder is damaged.
        FloatingPointError: a number is not finite. Finished tracks stay.
    """
    if (found := tracks.content()) != tracks.CONTENT:
        text = f"places, robot or forces have the digest {found}, and protocol {tracks.VERSION} has {tracks.CONTENT}"
        raise InputError(f"benchmark: {text}; take a version of sean_jax whose protocol it is.")
    options = options.replace(episodes=options.episodes or (tracks.QUICK if options.quick else tracks.EPISODES))
    for track in tracks.TRACKS:
        choice.check(options.policy, tracks.description(track))
    parts.has_started(options)
    with writing.folder_lock(options.folder):
        parts.start(options)
        _check_driver(options)
        work = [Part(track, functools.partial(_drive, options, track)) for track in tracks.TRACKS]
        measured: dict[str, Columns] = together(work, console, "benchmark")
        write(options, measured)
    return options.folder


def _check_driver(options: BenchmarkConfig) -> None:
    """Refuse to go on with another driver of the same name, such as a training that has gone on."""
    file, digest = options.folder / DRIVER, policy_digest(options.policy)
    had = parts.load(file)
    if had is None:
        parts.save(file, {"policy": options.policy, "digest": digest})
    elif had.get("digest") != digest:
        raise InputError(f"{options.folder} was begun when {options.policy} was another driver; choose another --out.")


def _drive(options: BenchmarkConfig, track: str, watch: Callable[[float], None]) -> Columns:
    """What was measured on a track, from its file or simulated."""
    import jax

    file = options.folder / f"{track}.npz"
    if file.is_file():
        return read_track(file)
    from sean_jax.metrics import METRICS as ALL

    scenario = dataclasses.replace(
        assembly.build(tracks.description(track))[0], metrics=tuple((name, ALL[name]) for name in METRICS)
    )
    number, most = options.episodes or 1, BATCH.get(jax.default_backend(), BATCH_ELSEWHERE)
    runner = Runner(
        scenario, choice.policy(options.policy, scenario), math.ceil(number / -(-number // most)), "benchmark"
    )
    compute, found = jax.jit(jax.vmap(results, (None, 0))), []
    for first in range(0, number, runner.size):
        tell = Watch(advanced=lambda seconds, _, first=first: watch(
            (first + runner.size * seconds / scenario.time_limit) / (number + runner.size)))  # fmt: skip
        batch = runner.run(tracks.SEED, first, min(runner.size, number - first), watch=tell)
        measured = {name: np.asarray(value, np.float32) for name, value in compute(scenario, batch.states).items()}
        ended = {"completed": np.asarray(batch.states.completed), "seconds": batch.steps * scenario.time_step}
        found.append(ended | measured)
    columns = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    for name in ("seconds", "time_in_situation", *COUNTED):
        if not np.isfinite(columns[name]).all():
            raise FloatingPointError(f"{track}: {name} is not finite; nothing of this track is written.")
    with writing.atomic_file(file) as stream:
        np.savez_compressed(stream, **columns)  # pyright: ignore[reportArgumentType]
    return columns


def read_track(file: Path) -> Columns:
    """What was measured on a track.

    Args:
        file: that ``run`` has written.

    Returns:
        name -> (E,) or (E, 1 + S).

    Raises:
        IncompleteError: it is damaged.
    """
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except writing.DAMAGED as error:
        raise IncompleteError(
            f"{file} is damaged ({error}); remove it, and the same command makes it again."
        ) from error


# ------------------------------------------------------------------ figures


def polite(columns: Columns) -> np.ndarray:
    """Which tasks were completed without an intimate violation or a collision by the robot's fault.

    Args:
        columns: of E episodes.

    Returns:
        (E,) bool.
    """
    return columns["completed"] & ~np.any([_overall(columns[name]) > 0 for name in ROBOTS_FAULT], axis=0)


def scores(measured: dict[str, Columns]) -> Scores:
    """Figures over some tracks, all of which count alike; a resample draws as many episodes of each.

    Args:
        measured: track -> what was measured on it.

    Returns:
        The figures.
    """
    each = list(measured.values())
    sizes = [len(columns["completed"]) for columns in each]
    weights = np.concatenate([bootstrap.resamples(size, seed, RESAMPLES) for seed, size in enumerate(sizes)], axis=1)

    def joined(take: Callable[[Columns], np.ndarray]) -> np.ndarray:
        return np.concatenate([np.asarray(take(columns), float) for columns in each])

    def percent(take: Callable[[Columns], np.ndarray]) -> Estimate:
        share = bootstrap.of_share(aggregate(joined(take), weights=weights))
        return share._replace(mean=100.0 * share.mean, low=100.0 * share.low, high=100.0 * share.high)

    figures = {"polite": percent(polite), "completed": percent(lambda columns: columns["completed"])}
    for name in Scores.FIGURES:
        if name not in figures:
            figures[name] = aggregate(joined(lambda columns, name=name: _overall(columns[name])), weights=weights)
    time = joined(lambda columns: columns["time_in_situation"])
    events = joined(lambda columns: columns["intimate_robot_on_person"][:, 1:])
    whole = np.repeat(time[:, :1], time.shape[1] - 1, axis=1)
    return Scores(
        figures,
        aggregate_ratio(time[:, 1:], whole, weights=weights),
        aggregate_ratio(events, time[:, 1:] / 60.0, weights=weights),
    )


def _overall(values: np.ndarray) -> np.ndarray:
    return values if values.ndim == 1 else values[:, 0]


# ------------------------------------------------------------------ the result


def write(options: BenchmarkConfig, measured: dict[str, Columns]) -> None:
    """Write result.json and report.html.

    Args:
        options: of the benchmark.
        measured: track -> what was measured on it.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder = options.folder
    by_track = {track: scores({track: columns}) for track, columns in measured.items()}
    content = {
        "protocol": tracks.VERSION,
        "content": tracks.CONTENT,
        "complete": options.episodes == tracks.EPISODES,
        "policy": options.policy,
        "policy_digest": policy_digest(options.policy),
        "episodes": options.episodes,
        "versions": versions(),
        "files": {track: components.digest(folder / f"{track}.npz") for track in measured},
        "scores": _as_json(scores(measured)),
        "tracks": {track: _as_json(each) for track, each in by_track.items()},
    }
    parts.save(folder / RESULT, content | {"seal": seal(content)})
    parts.save(folder / REPORT, page.benchmark(options, scores(measured), by_track))


def _as_json(found: Scores) -> dict[str, Any]:
    def told(estimate: Estimate) -> dict[str, Any]:
        return {name: np.round(getattr(estimate, name), 5).tolist() for name in ("mean", "low", "high")}

    figures = {name: told(each) for name, each in found.figures.items()}
    by_situation = {"share_of_time": told(found.shares), "violations_per_minute": told(found.violations)}
    return {"figures": figures, "situations": list(tracks.SITUATIONS), **by_situation}


def policy_digest(policy: str) -> str:
    """What tells a driver from another of the same name.

    Args:
        policy: a name, a folder, or FILE.py:NAME.

    Returns:
        16 letters: of the numbers of a policy of the package or of a training, or of a file of one's own.
    """
    described = validate(RunConfig, {"policy": policy}).policy
    if isinstance(described, OwnPart):
        return components.digest(Path(described.file))[:16]
    scenario = assembly.build(tracks.description(next(iter(tracks.TRACKS))))[0]
    return fingerprint(choice.policy(described, scenario).params)


def seal(content: dict[str, Any]) -> str:
    """The SHA-256 of a result, by which a change of it is found.

    Args:
        content: of result.json, without its seal.

    Returns:
        64 hexadecimal digits.
    """
    text = json.dumps({name: content[name] for name in content if name != "seal"}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def check(folder: Path) -> dict[str, Any]:
    """A result whose seal, files and figures hold together.

    Args:
        folder: that ``run`` has written.

    Returns:
        The content of result.json.

    Raises:
        InputError: something was changed, or it is of another version of the protocol.
    """
    content = files.read_json(folder / RESULT)
    if not isinstance(content, dict) or content.get("seal") != seal(content):
        raise InputError(f"{folder / RESULT} was changed after it was written; run the benchmark again.")
    if content["protocol"] != tracks.VERSION or content["content"] != tracks.CONTENT:
        text = f"is of protocol {content['protocol']} ({content['content']}), not {tracks.VERSION} ({tracks.CONTENT})"
        raise InputError(f"{folder / RESULT} {text}; run it again with this version.")
    for track, digest in content["files"].items():
        if components.digest(folder / f"{track}.npz") != digest:
            raise InputError(f"{folder / track}.npz is not the file of the result; run the benchmark again.")
    again = _as_json(scores({track: read_track(folder / f"{track}.npz") for track in content["files"]}))
    if again != content["scores"]:
        other = version_mismatch(content["versions"]) or "other figures than its episodes have"
        raise InputError(f"{folder / RESULT} does not follow from its episodes ({other}); run the benchmark again.")
    return content


def table(content: dict[str, Any]) -> str:
    """A result as text.

    Args:
        content: of result.json.

    Returns:
        Some lines.
    """
    found = content["scores"]
    size = f"{len(content['tracks'])} tracks x {content['episodes']} episodes"
    lines = [f"{content['policy']} · protocol {content['protocol']} · {size}"]
    if not content["complete"]:
        lines.append(f"not ranked: the protocol has {tracks.EPISODES} episodes a track")
    for name, words in Scores.FIGURES.items():
        lines.append(f"  {words:<28}{_interval(found['figures'][name])}")
    lines.append("  by situation: share of time; times a minute within 0.45 m by the robot")
    for k, situation in enumerate(found["situations"]):
        share, rate = (
            {end: values[k] for end, values in found[name].items()}
            for name in ("share_of_time", "violations_per_minute")
        )
        lines.append(f"  {situation.replace('_', ' '):<28}{100 * share['mean']:5.1f} %   {_interval(rate)}")
    return "\n".join(lines)


def _interval(figure: dict[str, float]) -> str:
    return f"{figure['mean']:8.3f}  ({figure['low']:.3f} to {figure['high']:.3f})"


def ranking(folders: list[Path]) -> list[dict[str, Any]]:
    """Results in the order of how many tasks were completed politely.

    Args:
        folders: of complete results.

    Returns:
        The content of each result.json, the best first.

    Raises:
        InputError: a result was changed, is of another protocol, or is not complete.
    """
    found = [check(folder) for folder in folders]
    for folder, content in zip(folders, found, strict=True):
        if not content["complete"]:
            raise InputError(
                f"{folder} has {content['episodes']} episodes a track, too few to rank it; run it in full."
            )
    return sorted(found, key=lambda content: -content["scores"]["figures"]["polite"]["mean"])

"""``sean benchmark POLICY``: a driver on the tracks of a frozen protocol, a table by situation and a result to rank.

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
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from sean_jax import assembly, components, files, writing
from sean_jax.config import BenchmarkConfig, Config, Number, OwnPart, RunConfig, Text, validate
from sean_jax.errors import FileError, IncompleteError, InputError
from sean_jax.learning.policy import AGENTS, check_policy, load_policy
from sean_jax.metrics import Estimate, aggregate, aggregate_ratio, bootstrap
from sean_jax.policies import POLICIES
from sean_jax.runner import Runner, Watch
from sean_jax.scenario import results
from sean_jax.studies.experiments import page, parts, tracks
from sean_jax.studies.experiments.together import Part, together
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
MAX_BYTES = 10_000_000  # of what was measured on a track
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


class Result(Config):
    """The content of result.json."""

    protocol: Annotated[int, Number(1, 2**31)]
    content: Text
    complete: bool
    policy: Text
    policy_digest: Text
    episodes: Annotated[int, Number(1, tracks.EPISODES)]
    versions: dict[str, str]
    files: dict[str, str]
    scores: dict[str, Any]
    tracks: dict[str, dict[str, Any]]
    checksum: Text


def run(options: BenchmarkConfig, console: Console | None = None) -> Path:
    """Drive the tracks that the folder lacks, and write the result and the report.

    Args:
        console: shows progress; None shows nothing.

    Raises:
        InputError: there is no such driver, the folder holds something else, there are more episodes than the protocol
            has, or this package is not that of the protocol.
        WriteError: another process writes in the folder.
        IncompleteError: a file in the folder is damaged.
        FloatingPointError: a number is not finite. Finished tracks stay.
    """
    if (found := tracks.content()) != tracks.CONTENT:
        text = f"places, robot or forces have the digest {found}, and protocol {tracks.VERSION} has {tracks.CONTENT}"
        raise InputError(f"benchmark: {text}; take a version of sean_jax whose protocol it is.")
    options = options.replace(episodes=options.episodes or (tracks.QUICK if options.quick else tracks.EPISODES))
    if (options.episodes or 0) > tracks.EPISODES:
        text = f"{options.episodes} are more than the {tracks.EPISODES} of a track of protocol {tracks.VERSION}"
        raise InputError(f"--episodes: {text}; ask for fewer.")
    for track in tracks.TRACKS:
        check_policy(options.policy, tracks.description(track))
    parts.has_started(options)
    with writing.folder_lock(options.folder):
        parts.start(options)
        _check_driver(options)
        work = [Part(track, functools.partial(_drive, options, track)) for track in tracks.TRACKS]
        measured: dict[str, Columns] = together(work, console, "benchmark")
        write(options, {track: measured[track] for track in tracks.TRACKS})
    return options.folder


def _check_driver(options: BenchmarkConfig) -> None:
    """Refuse to go on with another driver of the same name, such as a training that has gone on."""
    file, digest = options.folder / DRIVER, policy_digest(options.policy)
    driver = {"policy": options.policy, "digest": digest}
    if not file.exists():
        parts.save(file, driver)
    elif parts.load(file) != driver:
        raise InputError(f"{options.folder} was begun when {options.policy} was another driver; choose another --out.")


def _drive(options: BenchmarkConfig, track: str, watch: Callable[[float], None]) -> Columns:
    """What was measured on a track, from its file or simulated."""
    import jax

    file = options.folder / f"{track}.npz"
    if file.is_file():
        return read_track(options.folder, track, options.episodes or 1)
    from sean_jax.metrics import METRICS as ALL

    scenario = dataclasses.replace(
        assembly.build(tracks.description(track))[0], metrics=tuple((name, ALL[name]) for name in METRICS)
    )
    number, most = options.episodes or 1, BATCH.get(jax.default_backend(), BATCH_ELSEWHERE)
    runner = Runner(
        scenario, load_policy(options.policy, scenario), math.ceil(number / -(-number // most)), "benchmark"
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
    for name, values in columns.items():
        if not np.isfinite(values).all():
            raise FloatingPointError(f"{track}: {name} is not finite; nothing of this track is written.")
    with writing.atomic_file(file) as stream:
        np.savez_compressed(stream, **columns)  # pyright: ignore[reportArgumentType]
    return columns


def read_track(folder: Path, track: str, episodes: int) -> Columns:
    """What was measured on a track.

    Args:
        folder: that ``run`` has written.
        track: one of ``tracks.TRACKS``.
        episodes: how many it must have.

    Returns:
        name -> (E,) or (E, 1 + S).

    Raises:
        IncompleteError: the file is missing or damaged, or no episodes can have what it holds.
    """
    file = folder / f"{track}.npz"
    try:
        columns = files.read_arrays(file, MAX_BYTES)
        check_columns(columns, episodes, tracks.TRACKS[track]["time_limit"] + tracks.TRACKS[track]["time_step"])
    except (FileError, ValueError) as error:
        text = str(error).rstrip(".")
        raise IncompleteError(f"{file} is damaged ({text}); remove it, and the same command makes it again.") from error
    return columns


def check_columns(columns: Columns, episodes: int, limit: float) -> None:
    """Refuse what no episodes can have.

    Args:
        limit: s, the longest duration of an episode.

    Raises:
        ValueError: a column is missing or unknown, or has another shape or type, or an impossible number.
    """
    alone = {"completed", "seconds", "path_efficiency"}
    wanted = {name: (episodes,) if name in alone else (episodes, 1 + len(tracks.SITUATIONS)) for name in METRICS}
    wanted |= {name: (episodes,) for name in alone}
    if columns.keys() != wanted.keys():
        other = ", ".join(sorted(columns.keys() ^ wanted.keys()))
        raise ValueError(f"its columns are not those of a track: {other:.100}")
    for name, values in columns.items():
        kind = "b" if name == "completed" else "f"
        if values.shape != wanted[name] or values.dtype.kind != kind:
            named = {"b": "bool", "f": "float"}[kind]
            raise ValueError(f"{name} is {values.dtype} {values.shape}, not {named} {wanted[name]}")
        if not np.isfinite(values).all() or (values < 0).any():
            raise ValueError(f"{name} has a number that is negative or not finite")
    seconds, time = columns["seconds"], columns["time_in_situation"]
    close = 1e-3 * limit  # of times in 32 bits
    if (seconds <= 0).any() or (seconds > limit + close).any():
        raise ValueError(f"seconds must be more than 0 and at most {limit:g}")
    if (np.abs(time[:, 0] - seconds) > close).any():
        raise ValueError("time_in_situation differs from seconds")
    for name in ("time_in_situation", "time_not_moving"):
        if (columns[name] > seconds[:, None] + close).any():
            raise ValueError(f"{name} is longer than its episode")
    for name in COUNTED:
        values = columns[name]
        if (values != np.round(values)).any() or (values > values[:, :1]).any():
            raise ValueError(f"{name} must be whole numbers, of which no situation has more than the episode")


# ------------------------------------------------------------------ figures


def polite(columns: Columns) -> np.ndarray:
    """Which tasks were completed without an intimate violation or a collision by the robot's fault.

    Returns:
        (E,) bool.
    """
    return columns["completed"] & ~np.any([_overall(columns[name]) > 0 for name in ROBOTS_FAULT], axis=0)


def scores(measured: dict[str, Columns]) -> Scores:
    """Figures over some tracks, all of which count alike; a resample draws as many episodes of each."""
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
        "files": {track: components.digest(folder / f"{track}.npz", MAX_BYTES) for track in measured},
        "scores": _as_json(scores(measured)),
        "tracks": {track: _as_json(each) for track, each in by_track.items()},
    }
    parts.save(folder / RESULT, content | {"checksum": checksum(content)})
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
        16 letters: of the numbers of an agent or of a training, of those of a policy of the package and its name, or of
        a file of one's own and the name in it.
    """
    described = validate(RunConfig, {"policy": policy}).policy
    if isinstance(described, OwnPart):
        return _digest(components.content(described.file).digest, described.name)
    scenario = assembly.build(tracks.description(next(iter(tracks.TRACKS))))[0]
    numbers = fingerprint(load_policy(described, scenario).params)
    return _digest(numbers, described.kind) if described.kind in POLICIES else numbers


_digest_of_package = functools.cache(policy_digest)


def _digest(*texts: str) -> str:
    return hashlib.sha256(" ".join(texts).encode()).hexdigest()[:16]


def checksum(content: dict[str, Any]) -> str:
    """The SHA-256 of a result, by which an accidental change of it is seen. Whoever means to can compute it anew.

    Args:
        content: of result.json, without its checksum.

    Returns:
        64 hexadecimal digits.
    """
    text = json.dumps({name: content[name] for name in content if name != "checksum"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check(folder: Path) -> dict[str, Any]:
    """A result that is whole, and whose checksum, driver, files and figures hold together.

    That shows accidents, and does not prove who drove: whoever doubts a result runs its command again.

    Args:
        folder: that ``run`` has written.

    Raises:
        InputError: something was changed or is missing, or it is of another version of the protocol.
        IncompleteError: a file of episodes is damaged, or no episodes can have what it holds.
    """
    file = folder / RESULT
    content = files.read_json(file)
    if not isinstance(content, dict) or content.get("checksum") != checksum(content):
        raise InputError(f"{file} was changed after it was written; run the benchmark again.")
    try:
        result = validate(Result, content)
    except InputError as error:
        raise InputError(f"{file} is no result ({str(error).rstrip('.')}); run the benchmark again.") from None
    if (result.protocol, result.content) != (tracks.VERSION, tracks.CONTENT):
        text = f"is of protocol {result.protocol} ({result.content}), not {tracks.VERSION} ({tracks.CONTENT})"
        raise InputError(f"{file} {text}; run it again with this version.")
    for part, names in (("files", result.files), ("tracks", result.tracks)):
        if names.keys() != tracks.TRACKS.keys():
            other = ", ".join(sorted(names.keys() ^ tracks.TRACKS.keys()))
            raise InputError(f"{file}: {part} lack, or should not have, {other:.200}; run the benchmark again.")
    made = version_mismatch(result.versions)
    if result.policy in (*POLICIES, *AGENTS) and result.policy_digest != _digest_of_package(result.policy):
        text = f"{result.policy} of this package has another digest than its driver ({made or result.policy_digest})"
        raise InputError(f"{file}: {text}; run the benchmark again.")
    for track, digest in result.files.items():
        if components.digest(folder / f"{track}.npz", MAX_BYTES) != digest:
            raise InputError(f"{folder / track}.npz is not the file of the result; run the benchmark again.")
    measured = {track: read_track(folder, track, result.episodes) for track in tracks.TRACKS}
    again = {
        "complete": result.episodes == tracks.EPISODES,
        "scores": _as_json(scores(measured)),
        "tracks": {track: _as_json(scores({track: columns})) for track, columns in measured.items()},
    }
    if any(again[name] != content[name] for name in again):
        other = made or "other figures than its episodes have"
        raise InputError(f"{file} does not follow from its episodes ({other}); run the benchmark again.")
    return content


def table(content: dict[str, Any]) -> str:
    """A result as text."""
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

    Raises:
        InputError: ``check`` refuses a result, one is not complete, or two are of one driver or of one name.
        IncompleteError: as of ``check``.
    """
    found = [check(folder) for folder in folders]
    for folder, content in zip(folders, found, strict=True):
        if not content["complete"]:
            raise InputError(
                f"{folder} has {content['episodes']} episodes a track, too few to rank it; run it in full."
            )
    for key, what in (("policy_digest", "driver"), ("policy", "name")):
        by_value: dict[str, Path] = {}
        for folder, content in zip(folders, found, strict=True):
            if content[key] in by_value:
                both = f"{by_value[content[key]]} and {folder}"
                raise InputError(f"{both} have the same {what}, {content[key]}; rank one of them.")
            by_value[content[key]] = folder
    return sorted(found, key=lambda content: -content["scores"]["figures"]["polite"]["mean"])

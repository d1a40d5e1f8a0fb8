"""``sean benchmark POLICY``: a policy on the tracks of a frozen protocol, a table by situation and a result to rank.

A track is an environment with people of a behavior and a task for the robot. All policies drive the same numbered
episodes, so two of them are compared in pairs. The options of the tracks are written out in ``tracks.yaml``, and not
left to this package's defaults, which may change. A digest covers the files of environments and robots and the
constants of the social forces: if it differs, results are not comparable, and nothing is run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import jax
import numpy as np

from sean_jax import assembly, components, environment, files, robots, writing
from sean_jax.base import Scenario
from sean_jax.config import BenchmarkConfig, CollectConfig, Config, Number, OwnPart, RunConfig, Text, outside, validate
from sean_jax.errors import FileError, IncompleteError, InputError
from sean_jax.evaluation import Driver
from sean_jax.learning.policy import AGENTS, check_policy, load_policy
from sean_jax.metrics import METRICS, Estimate
from sean_jax.policies import POLICIES
from sean_jax.runner import Callbacks, Runner, even_batch
from sean_jax.social_forces import preset
from sean_jax.studies.experiments import Part, page, run_parts, shares
from sean_jax.studies.experiments.measures import COUNTED, MEASURED, Arrays, Scores, scores, scores_by_track
from sean_jax.versions import fingerprint, version_mismatch, versions
from sean_jax.workspace import Workspace, identity

if TYPE_CHECKING:
    from rich.console import Console

RESULT, REPORT = "result.json", "report.html"
MAX_BYTES = 10_000_000  # of the measurements of a track

# ------------------------------------------------------------------ the protocol

VERSION = 2
EPISODES = 8_400  # of each track; 100,800 of all
SEED = 20_260  # of all episodes
QUICK = 16  # episodes of each track, enough on a CPU to see that a policy works

CONTENT = "5a6ac9d6cf58607f"
"""The digest of all files and constants that the tracks of this version read."""

OPTIONS = files.read_yaml(Path(__file__).with_name("tracks.yaml"))[1]
TRACKS: dict[str, dict[str, Any]] = {
    f"{place}-{task}": {
        **OPTIONS["common"],
        "environment": place,
        "behavior": behavior,
        "task": task,
        "people": None if task == "handcrafted" else people,
    }
    for place, people in OPTIONS["people"].items()
    for task, behavior in OPTIONS["behavior_by_task"].items()
}
"""name -> the options that make its scenario"""


def description(track: str) -> CollectConfig:
    """The scenario of one of ``TRACKS``."""
    return CollectConfig(**TRACKS[track])


def protocol_digest() -> str:
    """The digest, 16 letters, of all inputs of the tracks besides their options."""
    digest = hashlib.sha256()
    folders = [environment.find(place) for place in OPTIONS["people"]]
    read = [file for folder in folders for file in sorted(folder.iterdir()) if file.is_file()]
    for file in [*read, robots.ROBOTS["kuri"]]:
        digest.update(f"{file.name}\n{files.read_text(file)}".encode())
    for leaf in jax.tree.leaves(preset("calibrated")):
        digest.update(" ".join(f"{value:.5g}" for value in np.ravel(np.asarray(leaf))).encode())
    return digest.hexdigest()[:16]


# ------------------------------------------------------------------ the episodes


class Result(Config):
    """The content of result.json."""

    protocol: Annotated[int, Number(1, 2**31)]
    content: Text
    complete: bool
    policy: Text
    policy_digest: Text
    episodes: Annotated[int, Number(1, EPISODES)]
    versions: dict[str, str]
    files: dict[str, str]
    scores: dict[str, Any]
    tracks: dict[str, dict[str, Any]]
    checksum: Text


def run(
    options: BenchmarkConfig, console: Console | None = None, connect: Callable[[Scenario], Driver] | None = None
) -> Path:
    """Drive the tracks that the folder lacks, and write the result and the report.

    Args:
        connect: as of ``evaluation.run``; then one episode runs at a time.

    Raises:
        InputError: there is no such policy, the folder holds something else, there are more episodes than the protocol
            has, or this package is not the protocol's.
        WriteError: another process writes in the folder.
        IncompleteError: a file in the folder is damaged.
        FloatingPointError: a number is not finite. Finished tracks stay.
    """
    if (digest := protocol_digest()) != CONTENT:
        text = f"places, robot or forces have the digest {digest}, and protocol {VERSION} has {CONTENT}"
        raise InputError(f"benchmark: {text}; take a version of sean_jax whose protocol it is.")
    options = options.replace(episodes=options.episodes or (QUICK if options.quick else EPISODES))
    if (options.episodes or 0) > EPISODES:
        text = f"{options.episodes} are more than the {EPISODES} of a track of protocol {VERSION}"
        raise InputError(f"--episodes: {text}; ask for fewer.")
    for track in TRACKS if connect is None else ():
        check_policy(options.policy, description(track))
    with Workspace(options.folder, identity(options)).open() as work:
        parts = work.identity["parts"] | {options.policy: policy_digest(options.policy)}  # a training may have gone on
        work = dataclasses.replace(work, identity=work.identity | {"parts": parts})
        work.begin()
        jobs = [Part(track, functools.partial(_drive, work, options, track, connect)) for track in TRACKS]
        measured: dict[str, Arrays] = run_parts(jobs, console, "benchmark", None if connect is None else 1)
        write(options, {track: measured[track] for track in TRACKS})
    return options.folder


def _drive(
    work: Workspace,
    options: BenchmarkConfig,
    track: str,
    connect: Callable[[Scenario], Driver] | None,
    tell: Callable[[float], None],
) -> Arrays:
    """The columns of a track, from its file or simulated."""
    if (work.folder / f"{track}.npz").is_file():
        return read_track(work.folder, track, options.episodes or 1)
    scenario = assembly.build(description(track))[0]
    scenario = dataclasses.replace(scenario, metrics=tuple((name, METRICS[name]) for name in MEASURED))
    number = options.episodes or 1
    if connect is None:
        runner = Runner(scenario, load_policy(options.policy, scenario), even_batch(number), "benchmark")
        measured = runner.measure(SEED, 0, number, tell)
    else:
        with contextlib.closing(connect(scenario)) as driver:
            runner = Runner(scenario, driver.policy, 1, "benchmark", chunk=scenario.time_step)
            runner.compile(Callbacks())  # before the controller gets a state
            measured = runner.measure(SEED, 0, number, tell, functools.partial(driver, scenario))
    ended = {name: measured.pop(name) for name in ("completed", "seconds")}
    columns = ended | {name: values.astype(np.float32) for name, values in measured.items()}
    if wrong := [name for name, values in columns.items() if not np.isfinite(values).all()]:
        raise FloatingPointError(f"{track}: {', '.join(wrong)} is not finite; nothing of this track is written.")
    work.save(f"{track}.npz", columns)
    return columns


def read_track(folder: Path, track: str, episodes: int) -> Arrays:
    """The columns of a track with so many episodes, from its file: name -> (E,) or (E, 1 + S).

    Raises:
        IncompleteError: the file is missing or damaged, or no episodes can have what it holds.
    """
    file = folder / f"{track}.npz"
    try:
        columns = files.read_arrays(file, MAX_BYTES)
        check_columns(columns, episodes, TRACKS[track]["time_limit"] + TRACKS[track]["time_step"])
        return columns
    except (FileError, ValueError) as error:
        text = str(error).rstrip(".")
        raise IncompleteError(f"{file} is damaged ({text}); remove it, and the same command makes it again.") from error


def check_columns(columns: Arrays, episodes: int, limit: float) -> None:
    """Refuse columns that no episodes of at most ``limit`` s can have.

    Raises:
        ValueError: a column is missing or unknown, or has another shape or type, or an impossible number.
    """
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(MEASURED, (episodes, 1 + len(shares.NAMES)))
    shapes |= dict.fromkeys(("completed", "seconds", "path_efficiency"), (episodes,))
    if columns.keys() != shapes.keys():
        other = ", ".join(sorted(columns.keys() ^ shapes.keys()))
        raise ValueError(f"its columns are not the columns of a track: {other:.100}")
    for name, values in columns.items():
        named = "bool" if name == "completed" else "float"
        if values.shape != shapes[name] or values.dtype.kind != named[0]:
            raise ValueError(f"{name} is {values.dtype} {values.shape}, not {named} {shapes[name]}")
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


# ------------------------------------------------------------------ the result


def write(options: BenchmarkConfig, measured: dict[str, Arrays]) -> None:
    """Write result.json and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder = options.folder
    content = {
        "protocol": VERSION,
        "content": CONTENT,
        "complete": options.episodes == EPISODES,
        "policy": options.policy,
        "policy_digest": policy_digest(options.policy),
        "episodes": options.episodes,
        "versions": versions(),
        "files": {track: components.digest(folder / f"{track}.npz", MAX_BYTES) for track in measured},
        **_figures(measured),
    }
    writing.write(folder / RESULT, content | {"checksum": checksum(content)})
    writing.write(folder / REPORT, page.benchmark(options, scores(measured), scores_by_track(measured)))


def _figures(measured: dict[str, Arrays]) -> dict[str, Any]:
    """The entries of result.json that follow from the episodes."""
    by_track = {track: _as_json(each) for track, each in scores_by_track(measured).items()}
    return {"scores": _as_json(scores(measured)), "tracks": by_track}


def _as_json(scores: Scores) -> dict[str, Any]:
    def numbers(estimate: Estimate) -> dict[str, Any]:
        return {name: np.round(getattr(estimate, name), 5).tolist() for name in ("mean", "low", "high")}

    figures = {name: numbers(each) for name, each in scores.figures.items()}
    by_situation = {"share_of_time": numbers(scores.shares), "violations_per_minute": numbers(scores.violations)}
    return {"figures": figures, "situations": list(shares.NAMES), **by_situation}


def policy_digest(policy: str) -> str:
    """A digest, 16 letters, of a policy by name, folder, or FILE.py:NAME.

    It covers the numbers of an agent or a training, the numbers and the name of a policy of the package, or the user's
    own file and the name in it.
    """
    described = validate(RunConfig, {"policy": policy}).policy
    if outside(described):  # nothing is known but the name
        return _digest("outside", described.kind)
    if isinstance(described, OwnPart):
        return _digest(components.content(described.file).digest, described.name)
    scenario = assembly.build(description(next(iter(TRACKS))))[0]
    numbers = fingerprint(load_policy(described, scenario).params)
    return _digest(numbers, described.kind) if described.kind in POLICIES else numbers


_digest_of_package = functools.cache(policy_digest)


def _digest(*texts: str) -> str:
    return hashlib.sha256(" ".join(texts).encode()).hexdigest()[:16]


def checksum(content: dict[str, Any]) -> str:
    """The SHA-256, 64 hexadecimal digits, of result.json without its checksum; it shows accidental changes only."""
    text = json.dumps({name: content[name] for name in content if name != "checksum"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check(folder: Path) -> dict[str, Any]:
    """The result in a folder, if it is complete and its checksum, policy, files and figures agree.

    This finds accidents; it does not prove which policy drove. To verify a result, run its command again.

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
    if (result.protocol, result.content) != (VERSION, CONTENT):
        text = f"is of protocol {result.protocol} ({result.content}), not {VERSION} ({CONTENT})"
        raise InputError(f"{file} {text}; run it again with this version.")
    for part, names in (("files", result.files), ("tracks", result.tracks)):
        if names.keys() != TRACKS.keys():
            other = ", ".join(sorted(names.keys() ^ TRACKS.keys()))
            raise InputError(f"{file}: {part} lack, or should not have, {other:.200}; run the benchmark again.")
    mismatch = version_mismatch(result.versions)
    if result.policy in (*POLICIES, *AGENTS) and result.policy_digest != _digest_of_package(result.policy):
        text = f"{result.policy} of this package has another digest ({mismatch or result.policy_digest})"
        raise InputError(f"{file}: {text}; run the benchmark again.")
    for track, digest in result.files.items():
        if components.digest(folder / f"{track}.npz", MAX_BYTES) != digest:
            raise InputError(f"{folder / track}.npz is not the file of the result; run the benchmark again.")
    measured = {track: read_track(folder, track, result.episodes) for track in TRACKS}
    expected = {"complete": result.episodes == EPISODES, **_figures(measured)}
    if any(content[name] != value for name, value in expected.items()):
        other = mismatch or "other figures than its episodes have"
        raise InputError(f"{file} does not follow from its episodes ({other}); run the benchmark again.")
    return content


def table(content: dict[str, Any]) -> str:
    """A result as text."""
    scores = content["scores"]
    size = f"{len(content['tracks'])} tracks x {content['episodes']} episodes"
    lines = [f"{content['policy']} · protocol {content['protocol']} · {size}"]
    if not content["complete"]:
        lines.append(f"not ranked: the protocol has {EPISODES} episodes a track")
    for name, words in Scores.FIGURES.items():
        lines.append(f"  {words:<28}{_interval(scores['figures'][name])}")
    lines.append("  by situation: share of time; times a minute within 0.45 m by the robot")
    for k, situation in enumerate(scores["situations"]):
        share, rate = (
            {end: values[k] for end, values in scores[name].items()}
            for name in ("share_of_time", "violations_per_minute")
        )
        lines.append(f"  {situation.replace('_', ' '):<28}{100 * share['mean']:5.1f} %   {_interval(rate)}")
    return "\n".join(lines)


def _interval(figure: dict[str, float]) -> str:
    return f"{figure['mean']:8.3f}  ({figure['low']:.3f} to {figure['high']:.3f})"


def ranking(folders: list[Path]) -> list[dict[str, Any]]:
    """Results in the order of their share of tasks completed politely.

    Raises:
        InputError: ``check`` refuses a result, one is not complete, or two have the same policy or the same name.
        IncompleteError: as in ``check``.
    """
    results = [check(folder) for folder in folders]
    for folder, content in zip(folders, results, strict=True):
        if not content["complete"]:
            raise InputError(
                f"{folder} has {content['episodes']} episodes a track, too few to rank it; run it in full."
            )
    for key, what in (("policy_digest", "driver"), ("policy", "name")):
        by_value: dict[str, Path] = {}
        for folder, content in zip(folders, results, strict=True):
            if content[key] in by_value:
                both = f"{by_value[content[key]]} and {folder}"
                raise InputError(f"{both} have the same {what}, {content[key]}; rank one of them.")
            by_value[content[key]] = folder
    return sorted(results, key=lambda content: -content["scores"]["figures"]["polite"]["mean"])

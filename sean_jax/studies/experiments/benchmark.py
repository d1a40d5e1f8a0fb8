"""``sean benchmark run POLICY``: a policy on the tracks of a frozen protocol, with a table and a result to rank.

A track is an environment with people of a behavior and a task for the robot. Tracks form groups, such as more and fewer
people or other laws of people. All policies drive the same numbered episodes, so two of them are compared in pairs
(``ranking``). The options of the tracks are written out in ``tracks.yaml``, and not left to this package's defaults,
which may change. A digest covers the files of environments and robots and the constants of the social forces: if it
differs, results are not comparable, and nothing is run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import platform
import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import jax
import numpy as np

from sean_jax import robots, social_forces
from sean_jax.config import (
    METHODS,
    BenchmarkConfig,
    Component,
    Config,
    Named,
    Number,
    OwnPart,
    ReinforcementConfig,
    RunConfig,
    ScenarioConfig,
    Text,
    outside,
    user_parts,
    validate,
)
from sean_jax.config.workspace import Workspace, identity
from sean_jax.core.data_types import Scenario
from sean_jax.core.errors import FileError, IncompleteError, InputError
from sean_jax.evaluation import Driver
from sean_jax.io import files, writing
from sean_jax.io.versions import fingerprint, version_mismatch, versions
from sean_jax.learning.networks import read_method
from sean_jax.learning.policy import AGENTS, agent_folder, check_policy, load_policy, read_options
from sean_jax.metrics import METRICS, OF_GROUPS
from sean_jax.policies import POLICIES
from sean_jax.simulation import making
from sean_jax.simulation.episode_runner import Callbacks, Runner, even_batch
from sean_jax.simulation.scenario_stack import Stack
from sean_jax.studies.experiments import ExperimentPart, page, run_parts, shares
from sean_jax.studies.experiments.results_table import ALL, Estimates
from sean_jax.studies.experiments.scores import (
    COUNTED,
    FIGURES,
    MEASURED,
    PER_MINUTE,
    SHARE_OF_TIME,
    Arrays,
    scores,
    scores_by_track,
    track_table,
)
from sean_jax.world import generated

if TYPE_CHECKING:
    from rich.console import Console

RESULT, REPORT = "result.json", "report.html"
MAX_BYTES = 10_000_000  # of the measurements of a track

# ------------------------------------------------------------------ the protocol

VERSION = 4
EPISODES = 5_040  # of each track; 100,800 of all
SEED = 20_260  # of all episodes
QUICK = 16  # episodes of each track, enough on a CPU to see that a policy works

CONTENT = "cc4faebcfba7b30c"
"""The digest of all files and constants that the tracks of this version read."""

FIRST_SEED = 2_000_000_000
"""The first seed of the generated floors."""

HERE = Path(__file__).parent
FLOORS = "floors/"  # first letters of environments beside this file


class Track(NamedTuple):
    """A track; all its options decide its episodes."""

    group: str
    options: dict[str, Any]  # of its scenario
    parameters: dict[str, float]  # of the social forces that differ from the preset: term.parameter -> value
    recording: str  # the file of recorded people; "" if people are simulated


def _read_tracks() -> dict[str, Track]:
    """The tracks of tracks.yaml by name."""
    content = files.read_yaml(HERE / "tracks.yaml")[1]
    tracks = {}
    for group, members in content["groups"].items():
        for name, fields in members.items():
            options = {**content["common"], **fields}
            parameters, recording = options.pop("parameters", {}), options.pop("recording", "")
            if options["environment"].startswith(FLOORS):
                options["environment"] = str(HERE / options["environment"])
            tracks[name] = Track(group, options, parameters, recording)
    return tracks


TRACKS = _read_tracks()


def description(track: str, recordings: Path | None = None) -> ScenarioConfig:
    """The scenario of one of ``TRACKS``.

    Args:
        recordings: folder of the files of recorded people.

    Raises:
        InputError: the track has recorded people, and the folder lacks their file.
    """
    _, track_options, parameters, recording = TRACKS[track]
    options: dict[str, Any] = dict(track_options)
    if parameters:
        options["forces"] = list(social_forces.with_parameters(options["forces"], parameters))
    if recording:
        options["behavior"] = options["behavior"] | {"recording": str(_recording(recording, recordings))}
    return validate(ScenarioConfig, options)


def _recording(name: str, folder: Path | None) -> Path:
    """The file of a recording."""
    file = (folder or Path()) / name
    if folder is None or not file.is_file():
        raise InputError(f"recordings: {folder} has no {name}; give a folder with {', '.join(recorded().values())}.")
    return file


def recorded() -> dict[str, str]:
    """Track with recorded people -> the name of the recording."""
    return {name: track.recording for name, track in TRACKS.items() if track.recording}


def members() -> dict[str, list[str]]:
    """Group -> its tracks."""
    groups: dict[str, list[str]] = {}
    for name, track in TRACKS.items():
        groups.setdefault(track.group, []).append(name)
    return groups


def protocol_digest() -> str:
    """The digest, 16 letters, of all inputs of the tracks besides their options and the recordings."""
    digest, tracks = hashlib.sha256(), _read_tracks().values()
    places = dict.fromkeys(track.options["environment"] for track in tracks)
    folders = [folder for place in places for folder in generated.find(place)]
    read = [file for folder in folders for file in sorted(folder.iterdir()) if file.is_file()]
    for file in [*read, robots.ROBOTS["kuri"]]:
        digest.update(f"{file.name}\n{files.read_text(file)}".encode())
    for track in tracks:
        for leaf in jax.tree.leaves(social_forces.with_parameters(track.options["forces"], track.parameters)):
            digest.update(" ".join(f"{value:.5g}" for value in np.ravel(np.asarray(leaf))).encode())
    return digest.hexdigest()[:16]


def skipped(tracks: Collection[str]) -> str:
    """A sentence on the tracks of the protocol that a result lacks; "" if it has all."""
    missing = [name for name in TRACKS if name not in tracks]
    names = ", ".join(dict.fromkeys(recorded().get(name, name) for name in missing))
    return f"Without {', '.join(missing)}, which need the recordings {names} (--recordings)." if missing else ""


# ------------------------------------------------------------------ the policy


class Described(NamedTuple):
    """What a result says of its policy."""

    policy_digest: str  # 16 letters
    sensing: str  # one of ``data_types.SENSING``
    trained: bool  # whether it is a network of a training


def read_policy(policy: str, source: Path | None = None, *, typed: bool = False) -> Component:
    """The description of a policy by name, folder, or FILE.py:NAME; ``source`` and ``typed`` as of ``validate``."""
    return validate(RunConfig, {"policy": policy}, source=source, typed=typed).policy


def describe(policy: Component, sensing: str | None = None) -> Described:
    """What a result says of a policy.

    The digest covers the numbers of an agent or a training, the numbers and the name of a policy of the package, or the
    user's own file and the name in it.

    Args:
        sensing: class of a policy of the user's own or of a controller outside; by default the attribute ``sensing`` of
            the policy.

    Raises:
        InputError: there is no such policy, the class is that of a policy of the package or of an agent, or an agent
            was trained on floors of the benchmark.
    """
    if outside(policy):  # nothing is known but the name
        return Described(_digest("outside", policy.kind), sensing or "all-knowing", False)
    if isinstance(policy, Named) and sensing is not None:
        raise InputError(f"sensing: {policy.kind} says itself what it senses; leave {sensing} out.")
    scenario = making.scenarios(description(next(iter(TRACKS))))[0]
    loaded = load_policy(policy, scenario)
    if isinstance(policy, OwnPart):
        digest = _digest(user_parts.content(policy.file).digest, policy.name)
        return Described(digest, sensing or loaded.sensing, False)
    numbers, is_known = fingerprint(loaded.params), policy.kind in POLICIES
    if not is_known:
        check_training(policy.kind, agent_folder(policy.kind, "policy"))
    return Described(_digest(numbers, policy.kind) if is_known else numbers, loaded.sensing, not is_known)


def check_training(policy: str, folder: Path) -> None:
    """Refuse an agent of reinforcement learning that was trained on floors of the benchmark.

    Raises:
        InputError: the floors.
    """
    if not issubclass(METHODS[read_method(folder)], ReinforcementConfig):
        return
    for name in read_options(folder).environments:
        place = generated.parse_set(name)
        if place is not None and place.seed + place.number > FIRST_SEED:
            raise InputError(
                f"policy: {policy} was trained on {name}, and seeds from {FIRST_SEED:,} on are for the benchmark; "
                "train on other seeds."
            )


@functools.cache
def describe_of_package(name: str) -> Described:
    """The description of a policy of ``POLICIES`` or ``AGENTS``, which stays what it is."""
    return describe(Named(kind=name))


def _digest(*texts: str) -> str:
    return hashlib.sha256(" ".join(texts).encode()).hexdigest()[:16]


# ------------------------------------------------------------------ the episodes


Connect = Callable[[Scenario], Driver]


def run(options: BenchmarkConfig, console: Console | None = None, connect: Connect | None = None) -> Path:
    """Drive the tracks that the folder lacks, and write the result and the report.

    Args:
        connect: as of ``evaluation.run``; then one episode runs at a time.

    Raises:
        InputError: there is no such policy or recording, the folder holds something else, there are more episodes than
            the protocol has, or this package is not the protocol's.
        WriteError: another process writes in the folder.
        IncompleteError: a file in the folder is damaged.
        FloatingPointError: a number is not finite. Finished tracks stay.
    """
    check_protocol()
    options = options.replace(episodes=options.episodes or (QUICK if options.quick else EPISODES))
    if (options.episodes or 0) > EPISODES:
        raise InputError(
            f"--episodes: {options.episodes} are more than the {EPISODES} of a track of protocol {VERSION}; "
            "ask for fewer."
        )
    tracks = [name for name, track in TRACKS.items() if options.recordings or not track.recording]
    described = {track: description(track, options.recordings) for track in tracks}
    driver = read_policy(options.policy, typed=True)
    for scenario in described.values() if connect is None else ():
        check_policy(driver, scenario)
    policy = describe(driver, options.sensing)
    with Workspace(options.folder, identity(options) | {"the device": device()}).open() as work:
        parts = {options.policy: policy.policy_digest, **recording_digests(tracks, options.recordings)}
        parts = work.identity["parts"] | parts  # a training may have gone on
        work = dataclasses.replace(work, identity=work.identity | {"parts": parts})
        work.begin()
        jobs = [ExperimentPart(track, functools.partial(_drive, work, options, track, connect)) for track in tracks]
        measured: dict[str, Arrays] = run_parts(jobs, console, "benchmark", None if connect is None else 1)
        write(options, {track: measured[track] for track in tracks}, policy)
    return options.folder


def check_protocol() -> None:
    """Refuse a package whose places, robot or forces are not those of the protocol.

    Raises:
        InputError: both digests.
    """
    if (digest := protocol_digest()) != CONTENT:
        raise InputError(
            f"benchmark: places, robot or forces have the digest {digest}, and protocol {VERSION} has {CONTENT}; "
            "take a version of sean_jax whose protocol it is."
        )


def recording_digests(tracks: list[str], folder: Path | None) -> dict[str, str]:
    """Name of the recording of each of these tracks -> its SHA-256.

    Raises:
        InputError: the folder lacks a recording.
    """
    names = [recorded()[track] for track in tracks if track in recorded()]
    return {name: user_parts.digest(_recording(name, folder), files.MAX_TABLE) for name in names}


def _drive(
    work: Workspace,
    options: BenchmarkConfig,
    track: str,
    connect: Connect | None,
    tell: Callable[[float], None],
) -> Arrays:
    """The columns of a track, from its file or simulated."""
    number = options.episodes or 1
    if (work.folder / f"{track}.npz").is_file():
        return read_track(work.folder, track, number)
    floors = _floors(track, options.recordings, number)
    if connect is None:
        runner = _runner(read_policy(options.policy, typed=True), floors, number)
        columns = _columns(track, runner.measure(SEED, 0, number, tell))
    else:
        columns = _columns(track, _measure_outside(floors, connect, number, tell))
    work.save(f"{track}.npz", columns)
    return columns


def _floors(track: str, recordings: Path | None, number: int) -> Stack[Scenario]:
    """The floors of a track with so many episodes, with the metrics of the benchmark."""
    known = METRICS | OF_GROUPS
    metrics = tuple((name, known[name]) for name in MEASURED)
    floors = making.build(making.plan_scenario(description(track, recordings)), number)[0]
    return floors.map_member(lambda member: dataclasses.replace(member, metrics=metrics))


def _runner(policy: Component, floors: Stack[Scenario], number: int) -> Runner:
    return Runner(floors, load_policy(policy, floors.member), even_batch(number), "benchmark")


def batch_again(
    policy: Component,
    track: str,
    recordings: Path | None,
    number: int,
    episode: int,
    tell: Callable[[float], None],
) -> tuple[range, Arrays]:
    """The batch with an episode of a track with so many: the numbers of its episodes and their columns.

    It is the same program with the same inputs as in ``run``, so the same device kind and versions give equal numbers.

    Raises:
        FloatingPointError: a number is not finite.
    """
    runner = _runner(policy, _floors(track, recordings, number), number)
    first = episode // runner.size * runner.size
    numbers = range(first, min(first + runner.size, number))
    return numbers, _columns(track, runner.measure(SEED, first, len(numbers), tell))


def _measure_outside(
    floors: Stack[Scenario], connect: Connect, number: int, tell: Callable[[float], None]
) -> dict[str, np.ndarray]:
    """As ``Runner.measure`` of a controller outside, which is connected anew for each floor."""
    rows: dict[int, dict[str, np.ndarray]] = {}
    for index in range(min(floors.size, number)):
        floor = floors.take(np.array([index]))
        with contextlib.closing(connect(floor.member)) as driver:
            runner = Runner(floor, driver.policy, 1, "benchmark", chunk=floor.member.time_step)
            runner.compile(Callbacks())  # before the controller gets a state
            for episode in range(index, number, floors.size):
                done = len(rows)
                rows[episode] = runner.measure(
                    SEED,
                    episode,
                    1,
                    lambda share, done=done: tell((done + share) / number),
                    functools.partial(driver, floor.member),
                )
    return {name: np.concatenate([rows[k][name] for k in range(number)]) for name in rows[0]}


def _columns(track: str, measured: dict[str, np.ndarray]) -> Arrays:
    """What a track's file holds of the results of a runner."""
    ended = {name: measured.pop(name) for name in ("completed", "seconds")}
    columns = ended | {name: values.astype(np.float32) for name, values in measured.items()}
    if wrong := [name for name, values in columns.items() if not np.isfinite(values).all()]:
        raise FloatingPointError(f"{track}: {', '.join(wrong)} is not finite; nothing of this track is written.")
    return columns


def read_track(folder: Path, track: str, episodes: int) -> Arrays:
    """The columns of a track with so many episodes, from its file: name -> (E,) or (E, 1 + S).

    Raises:
        IncompleteError: the file is missing or damaged, or no episodes can have what it holds.
    """
    file, options = folder / f"{track}.npz", TRACKS[track].options
    try:
        columns = files.read_arrays(file, MAX_BYTES)
        check_columns(columns, episodes, options["time_limit"] + options["time_step"])
        return columns
    except (FileError, ValueError) as error:
        raise IncompleteError(
            f"{file} is damaged ({str(error).rstrip('.')}); remove it, and the same command makes it again."
        ) from error


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

Real = Annotated[float, Number(-1e9, 1e9)]


class TrackFigure(Config):
    """A mean over episodes and the ends of its 95 % interval."""

    mean: Real
    low: Real
    high: Real


class Figures(Config):
    """A mean for each situation, and the ends of their 95 % intervals."""

    mean: list[Real]
    low: list[Real]
    high: list[Real]


class Tables(Config):
    """The scores of some tracks."""

    figures: dict[str, TrackFigure]
    situations: list[Text]
    share_of_time: Figures
    violations_per_minute: Figures


class Result(Config):
    """The content of result.json; ``Result.model_json_schema()`` is its JSON schema."""

    protocol: Annotated[int, Number(1, 2**31)]
    """Version of the protocol."""
    content: Text
    """Digest of the places, the robot and the forces."""
    complete: bool
    """Whether each track has the protocol's episodes."""
    name: Text
    """Entry of the ranking; results of one name are the training seeds of one agent."""
    policy: Text
    """Policy: a name, a folder, or FILE.py:NAME."""
    policy_digest: Text
    """Digest of its code or weights."""
    sensing: Literal["all-knowing", "tracks", "raw"]
    """Class of the policy by its knowledge of people."""
    trained: bool
    """Whether it is a network of a training."""
    episodes: Annotated[int, Number(1, EPISODES)]
    """Episodes of each track."""
    device: Text
    """Devices that simulated the episodes."""
    versions: dict[str, str]
    """Versions of the package and of the packages that it uses."""
    recordings: dict[str, str]
    """File of recorded people -> its SHA-256; empty if the recorded tracks are skipped."""
    files: dict[str, str]
    """Track -> SHA-256 of the file of its episodes."""
    scores: Tables
    """Scores over all tracks."""
    groups: dict[str, Tables]
    """Group of tracks -> its scores."""
    tracks: dict[str, Tables]
    """Track -> its scores."""
    checksum: Text
    """SHA-256 of this file without the checksum."""


def write(options: BenchmarkConfig, measured: dict[str, Arrays], policy: Described) -> None:
    """Write result.json and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, scored = options.folder, _scored(measured)
    content = {
        "protocol": VERSION,
        "content": CONTENT,
        "complete": options.episodes == EPISODES,
        "name": options.name or options.policy,
        "policy": options.policy,
        **policy._asdict(),
        "episodes": options.episodes,
        "device": device(),
        "versions": versions(),
        "recordings": recording_digests(list(measured), options.recordings),
        "files": {track: user_parts.digest(folder / f"{track}.npz", MAX_BYTES) for track in measured},
        **_figures(scored),
    }
    writing.write(folder / RESULT, content | {"checksum": checksum(content)})
    writing.write(folder / REPORT, page.benchmark(options, *scored, skipped(measured)))


def device() -> str:
    """Number and kind of the devices, such as "1 x NVIDIA H200"; of a CPU the processor, for which XLA compiles."""
    kind = jax.devices()[0].device_kind
    if jax.default_backend() == "cpu":
        kind = f"{kind} {platform.processor() or platform.machine()}"
        with contextlib.suppress(FileError):  # of Linux alone
            models = re.findall(r"(?m)^model name\s*:\s*(.+)$", files.read_text("/proc/cpuinfo"))
            kind = models[0] if models else kind
    return f"{len(jax.devices())} x {kind}"


class Scored(NamedTuple):
    """The scores of a result."""

    whole: Estimates
    groups: dict[str, Estimates]  # of tracks
    tracks: dict[str, Estimates]


def _scored(measured: dict[str, Arrays]) -> Scored:
    """The scores of all tracks that are measured, of each group with any, and of each track."""
    table = track_table(measured)
    in_groups = {group: table.where(behavior=tracks) for group, tracks in members().items()}
    by_group = {group: scores(episodes) for group, episodes in in_groups.items() if len(episodes)}
    return Scored(scores(table), by_group, scores_by_track(table))


def _figures(scored: Scored) -> dict[str, Any]:
    """The entries of result.json that follow from the episodes."""
    by_group = {group: _as_json(scores) for group, scores in scored.groups.items()}
    by_track = {track: _as_json(scores) for track, scores in scored.tracks.items()}
    return {"scores": _as_json(scored.whole), "groups": by_group, "tracks": by_track}


def _as_json(scores: Estimates) -> dict[str, Any]:
    ends = {labels: np.round(np.array(value[:3], float), 5).tolist() for labels, value in scores.items()}
    names = "mean", "low", "high"
    figures = {name: dict(zip(names, ends[name, ALL], strict=True)) for name in FIGURES}
    content = {"figures": figures, "situations": list(shares.NAMES)}
    for name in (SHARE_OF_TIME, PER_MINUTE):
        columns = zip(*(ends[name, situation] for situation in shares.NAMES), strict=True)
        content[name] = dict(zip(names, map(list, columns), strict=True))
    return content


def checksum(content: dict[str, Any]) -> str:
    """The SHA-256, 64 hexadecimal digits, of result.json without its checksum; it shows accidental changes only."""
    text = json.dumps({name: content[name] for name in content if name != "checksum"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check(folder: Path) -> Result:
    """The result in a folder, if it has its schema, and checksum, policy, files and figures agree.

    This finds accidents; it does not prove which policy drove: ``verification.verify`` simulates episodes again.

    Raises:
        InputError: something was changed or is missing, or it is of another version of the protocol.
        IncompleteError: a file of episodes is damaged, or no episodes can have what it holds.
    """
    file = folder / RESULT
    content = _read_content(file)
    try:
        result = validate(Result, content)
    except InputError as error:
        raise InputError(f"{file}: {str(error).rstrip('.')}; run the benchmark again.") from None
    _check_members(file, result)
    mismatch = version_mismatch(result.versions)
    _check_policy_of_package(file, result, mismatch)
    for track, digest in result.files.items():
        if user_parts.digest(folder / f"{track}.npz", MAX_BYTES) != digest:
            raise InputError(f"{folder / track}.npz is not the file of the result; run the benchmark again.")
    figures = _figures(_scored(measurements(folder, result)))
    if any(content[name] != value for name, value in {"complete": result.episodes == EPISODES, **figures}.items()):
        reason = mismatch or "other figures than its episodes have"
        raise InputError(f"{file} does not follow from its episodes ({reason}); run the benchmark again.")
    return result


def _read_content(file: Path) -> dict[str, Any]:
    """The content of a result.json of this version of the protocol, unchanged since it was written."""
    content = files.read_json(file)
    if not isinstance(content, dict):
        raise InputError(f"{file} is no result; run the benchmark again.")
    if content.get("checksum") != checksum(content):
        raise InputError(f"{file} was changed after it was written: its checksum differs; run the benchmark again.")
    version, digest = content.get("protocol"), content.get("content")
    if (version, digest) != (VERSION, CONTENT) and isinstance(version, int) and isinstance(digest, str):
        raise InputError(
            f"{file} is of protocol {version} ({digest:.16}), not {VERSION} ({CONTENT}); "
            "run it again with this version."
        )
    return content


def _check_members(file: Path, result: Result) -> None:
    """Refuse a result that lacks tracks, groups, files or recordings of the protocol, or has others."""
    names = [track for track in TRACKS if track not in recorded() or result.recordings]
    groups = [group for group, tracks in members().items() if set(tracks) & set(names)]
    recordings = [recorded()[track] for track in names if track in recorded()]
    for key, expected in {"files": names, "tracks": names, "groups": groups, "recordings": recordings}.items():
        if wrong := sorted(set(getattr(result, key)) ^ set(expected)):
            raise InputError(
                f"{file}: {key} lack, or should not have, {', '.join(wrong):.200}; run the benchmark again."
            )


def _check_policy_of_package(file: Path, result: Result, mismatch: str | None) -> None:
    """Refuse a result that describes a policy of the package otherwise than it is."""
    if result.policy not in (*POLICIES, *AGENTS):
        return
    versions_differ = f" ({mismatch})" if mismatch else ""
    for key, expected in describe_of_package(result.policy)._asdict().items():
        if (value := getattr(result, key)) != expected:
            raise InputError(
                f"{file}: {key} {value} is not that of {result.policy} of this package, {expected}{versions_differ}; "
                "run the benchmark again."
            )


def measurements(folder: Path, result: Result) -> dict[str, Arrays]:
    """Track -> the columns of a result's episodes.

    Raises:
        IncompleteError: as of ``read_track``.
    """
    return {track: read_track(folder, track, result.episodes) for track in result.files}


def table(result: Result) -> str:
    """A result as text."""
    size = f"{len(result.tracks)} tracks x {result.episodes} episodes"
    lines = [f"{result.name} · {result.sensing} · protocol {result.protocol} · {size}"]
    if not result.complete:
        lines.append(f"not ranked: the protocol has {EPISODES} episodes a track")
    lines += [skipped(result.tracks)] if skipped(result.tracks) else []
    lines += [f"  {words:<28}{_interval(result.scores.figures[name])}" for name, words in FIGURES.items()]
    lines.append(f"  {FIGURES['polite']} by group of tracks")
    lines += [f"  {group:<28}{_interval(scores.figures['polite'])}" for group, scores in result.groups.items()]
    lines.append("  by situation: share of time; times a minute within 0.45 m by the robot")
    share, rate = result.scores.share_of_time, result.scores.violations_per_minute
    for k, situation in enumerate(result.scores.situations):
        figure = TrackFigure(mean=rate.mean[k], low=rate.low[k], high=rate.high[k])
        lines.append(f"  {situation.replace('_', ' '):<28}{100 * share.mean[k]:5.1f} %   {_interval(figure)}")
    return "\n".join(lines)


def _interval(figure: TrackFigure) -> str:
    return f"{figure.mean:8.3f}  ({figure.low:.3f} to {figure.high:.3f})"

"""Recorded drives: the options, the number of the episode and all commands, from which it is simulated again.

A trial is a file of JSON lines: a head, then the commands of each second with who gave each, and the outcome at the
end. Each line is on the disk before the next second begins. Trials become demonstrations of a ``learning.Recorder``,
each of which names its trial by file, SHA-256 and rows: what a person discards is no longer in the dataset.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
import pydantic

from sean_jax import assembly, components, files, writing
from sean_jax.config import StudioConfig, validate
from sean_jax.errors import FileError, InputError
from sean_jax.learning.collection import EpisodePart, Recorder, steps_per_row
from sean_jax.learning.dataset import Dataset

VERSION = 2  # of the files; those of version 1 do not say who drove
STOPPED = "stopped"  # outcome of a trial that did not reach the end of its episode
TRIALS, DISCARDED = "trials", "discarded"
DATASETS = {"person": "demonstrations", "all": "demonstrations-all"}
MAX_TRIAL = 20_000_000  # bytes of a file
MAX_COMMAND = 100.0  # m/s, rad/s
MAX_NAME = 60  # characters of a drive's name
CURE = "move it out of the folder"


# ------------------------------------------------------------------ lines of a file

Speed = Annotated[float, pydantic.Field(ge=-MAX_COMMAND, le=MAX_COMMAND)]
Count = Annotated[int, pydantic.Field(ge=0, lt=2**32)]


class TrialLine(pydantic.BaseModel):
    """A line of JSON."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)


class TrialHead(TrialLine):
    """The first line."""

    version: Literal[1, 2]
    options: dict[str, Any]
    episode: Count
    sha256: dict[str, str] = {}
    """File -> SHA-256, of the user's own files that the options name."""


class CommandLine(TrialLine):
    """Commands of some steps [m/s, rad/s], and whether a person gave each; version 1 does not say it."""

    commands: list[tuple[Speed, Speed]]
    by_person: list[bool] | None = None


class RewindLine(TrialLine):
    """The steps from a number on did not happen."""

    rewind: Count


class EndLine(TrialLine):
    """The last line."""

    end: Literal["completed", "timed out", "stopped"]


LINES: dict[str, type[TrialLine]] = {"commands": CommandLine, "rewind": RewindLine, "end": EndLine}


class RecordedDrive(NamedTuple):
    """The content of a trial."""

    file: Path
    sha256: str
    options: dict[str, Any]
    episode: int
    commands: np.ndarray  # (T, 2) m/s, rad/s
    by_person: np.ndarray | None  # (T,) bool; None in a file that does not say it
    outcome: str | None  # None: the program was killed
    code: dict[str, str]  # file -> SHA-256, of the user's own files


def read(file: Path) -> RecordedDrive:
    """The content of a trial; a last line without its end was not written whole, and does not count.

    Raises:
        FileError: it is no trial.
    """
    head, commands, by_person, outcome = None, list[tuple[float, float]](), list[bool](), None
    for number, text in enumerate(files.read_text(file, MAX_TRIAL).split("\n")[:-1], 1):
        place = Path(f"{file}:{number}")
        line = _parsed(place, text, head is None)
        if isinstance(line, TrialHead):
            head = line
        elif outcome is not None:
            raise files.file_error(place, f"the drive has ended in an earlier line; {CURE}")
        elif isinstance(line, CommandLine):
            commands += line.commands
            by_person += _drivers(place, line, head)
        elif isinstance(line, RewindLine):
            if line.rewind > len(commands):
                steps = f"rewind: {line.rewind} is beyond the {len(commands)} steps before it"
                raise files.file_error(place, f"{steps}; {CURE}")
            del commands[line.rewind :], by_person[line.rewind :]
        elif isinstance(line, EndLine):
            outcome = line.end
    if head is None:
        raise files.file_error(file, f"it has no line of a trial; {CURE}")
    digest = hashlib.sha256(files.read_bytes(file, MAX_TRIAL)).hexdigest()
    drivers = np.asarray(by_person, bool) if head.version == VERSION else None
    numbers = np.asarray(commands, float).reshape(-1, 2)
    return RecordedDrive(file, digest, head.options, head.episode, numbers, drivers, outcome, head.sha256)


def _parsed(place: Path, text: str, first: bool) -> TrialLine:
    """A line, checked; the first one is the head."""
    data = files.parse_file_json(place, text)
    if not isinstance(data, dict):
        raise files.file_error(place, f"it is no line of a trial; {CURE}")
    model = TrialHead if first else next((LINES[key] for key in LINES if key in data), None)
    if model is None:
        raise files.file_error(place, f"it has none of {', '.join(LINES)}; {CURE}")
    return files.check_json(place, data, model)


def _drivers(place: Path, line: CommandLine, head: TrialHead | None) -> list[bool]:
    """Whether a person gave each command of a line."""
    if head is not None and head.version == 1:
        return [False] * len(line.commands)
    if line.by_person is None or len(line.by_person) != len(line.commands):
        raise files.file_error(place, f"by_person has another number of values than commands; {CURE}")
    return line.by_person


@functools.lru_cache(4096)
def _read_known(file: Path, size: int, changed: int) -> RecordedDrive:
    return read(file)


def read_folder(folder: Path) -> tuple[list[RecordedDrive], list[str]]:
    """The drives of a studio's folder by number, and a sentence for each file that is none."""
    drives, problems = [], []
    for file in sorted((folder / TRIALS).glob("*.jsonl")):
        try:
            status = file.lstat()
            drives.append(_read_known(file, status.st_size, status.st_mtime_ns))
        except FileError as error:
            problems.append(f"{str(error).splitlines()[0]} The drive is left out.")
        except OSError as error:
            problems.append(f"{file} cannot be read: {writing.reason(error)}. The drive is left out.")
    return drives, problems


# ------------------------------------------------------------------ a drive that goes on


class Trial:
    """The file of a drive that goes on."""

    def __init__(self, file: Path, head: dict[str, Any], per_line: int):
        self.file, self._per_line = file, per_line
        self._pending: list[tuple[tuple[float, float], bool]] = []
        self._steps = 0
        writing.write(file, json.dumps(head) + "\n")  # whole or not at all
        self._stream = file.open("a", encoding="utf-8")

    @classmethod
    def begin(cls, config: StudioConfig, number: int) -> Trial:
        """A new file in the folder for drives.

        Raises:
            InputError: the folder has drives of other options.
            OSError: the file cannot be written.
        """
        assert config.record is not None
        folder = config.record / TRIALS
        folder.mkdir(parents=True, exist_ok=True)
        head = {"version": VERSION, "options": config.identity(), "episode": number}
        head["sha256"] = components.digests(config)
        check(config.record, head["options"], head["sha256"])
        taken = [_number(file) for file in (*folder.glob("*.jsonl"), *(folder / DISCARDED).glob("*.jsonl"))]
        return cls(folder / f"{1 + max(taken, default=-1):06d}.jsonl", head, max(1, round(1.0 / config.time_step)))

    def add(self, commands: Iterable[tuple[float, float]], by_person: Iterable[bool]) -> None:
        """Commands of further steps; whole seconds are written."""
        steps = list(zip(commands, by_person, strict=True))
        self._pending += steps
        self._steps += len(steps)
        while len(self._pending) >= self._per_line:
            self._write_steps(self._pending[: self._per_line])
            del self._pending[: self._per_line]

    def rewind(self, tick: int) -> None:
        """The steps from ``tick`` on did not happen."""
        self._flush()
        self._write({"rewind": tick})
        self._steps = min(self._steps, tick)

    def end(self, outcome: str) -> None:
        """Write the rest, and close the file; one without commands is deleted."""
        with self._stream:
            self._flush()
            self._write({"end": outcome or STOPPED})
        if not self._steps:
            self.file.unlink()

    def abandon(self) -> None:
        """Close the file after its last whole line: it cannot be written."""
        try:
            self._stream.close()
        except OSError:  # what is pending in the stream cannot be written either
            pass

    def _flush(self) -> None:
        if self._pending:
            self._write_steps(self._pending)
            self._pending = []

    def _write_steps(self, steps: Sequence[tuple[tuple[float, float], bool]]) -> None:
        commands, by_person = zip(*steps, strict=True)
        self._write({"commands": commands, "by_person": by_person})

    def _write(self, line: dict[str, Any]) -> None:
        self._stream.write(json.dumps(line) + "\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())


def _number(file: Path) -> int:
    """The number at the beginning of a file's name; -1 if there is none."""
    digits = re.match(r"[0-9]{1,12}", file.name)
    return int(digits[0]) if digits else -1


def check(folder: Path, options: Mapping[str, Any], code: Mapping[str, str]) -> None:
    """Refuse a folder whose drives have other options, or other code by its SHA-256.

    Raises:
        InputError: it names the first that differs.
    """
    now = json.loads(json.dumps(options))
    for drive in read_folder(folder)[0][:1]:
        had = drive.options
        other = next((name for name in {**had, **now} if had.get(name) != now.get(name)), None)
        if other is not None:
            text = f"{folder} has drives with {other} {had.get(other)}, not {now.get(other)}"
            raise InputError(f"record: {text}; choose another folder.")
        if changed := _changed(drive.code, code):
            raise InputError(f"record: {folder} has drives with another {changed}; choose another folder.")


def _changed(code: Mapping[str, str], other: Mapping[str, str]) -> str | None:
    """The first file that is not the same in both."""
    return next((file for file in sorted({**code, **other}) if code.get(file) != other.get(file)), None)


# ------------------------------------------------------------------ after a kill


def recover(folder: Path) -> list[str]:
    """End drives whose program was killed, after the last whole second; a sentence for each file of note.

    A file without a whole head has no step, and is removed. A file of something else stays, and is told.
    """
    said = []
    place = folder / TRIALS
    for file in place.glob(".*.jsonl.new"):  # a head that was not written whole
        file.unlink(missing_ok=True)
    for file in sorted(place.glob("*.jsonl")):
        try:
            text = _recover_file(file)
        except FileError as error:
            text = f"{str(error).splitlines()[0]} The drive is left out."
        except OSError as error:
            text = f"{file} cannot be ended: {writing.reason(error)}. The drive is left out."
        said += [text] if text else []
    return said


def _recover_file(file: Path) -> str:
    """End a drive that was killed; what is to be said about it.

    Raises:
        FileError: it is no trial.
        OSError: it cannot be written.
    """
    data = files.read_bytes(file, MAX_TRIAL)
    if b"\n" not in data and _is_half_head(data):
        file.unlink()
        return f"{file} was stopped before its first step; it is removed."
    drive = read(file)
    if drive.outcome is not None:
        return ""
    if not len(drive.commands):
        file.unlink()
        return f"{file} was stopped before its first step; it is removed."
    whole = data.rpartition(b"\n")[0]
    with file.open("r+b") as stream:
        stream.truncate(len(whole) + 1)
        stream.seek(0, os.SEEK_END)
        stream.write(json.dumps({"end": STOPPED}).encode() + b"\n")
        os.fsync(stream.fileno())
    return f"{file} was stopped; it ends after its last whole second."


def _is_half_head(data: bytes) -> bool:
    """Whether a file without a whole line is the beginning of a head, and nobody's other file."""
    begin = b'{"version": '
    return data[: len(begin)] == begin[: len(data)]


# ------------------------------------------------------------------ the list of a person's drives


def rows_of_page(folder: Path, current: Path | None = None) -> list[dict[str, Any]]:
    """What the page lists of each drive that has ended."""
    rows = []
    for drive in read_folder(folder)[0]:
        if drive.file == current or drive.outcome is None or not len(drive.commands):
            continue
        share = None if drive.by_person is None else round(float(drive.by_person.mean()), 4)
        step = drive.options.get("time_step")
        seconds = len(drive.commands) * step if isinstance(step, float) and math.isfinite(step) else None
        rows.append(
            {
                "file": drive.file.name,
                "name": drive.file.stem.partition("-")[2],
                "episode": drive.episode,
                "seconds": None if seconds is None else round(seconds, 2),
                "outcome": drive.outcome,
                "by_person": share,
            }
        )
    return rows


def find(folder: Path, name: Any) -> Path:
    """The file of a drive that the page names.

    Raises:
        InputError: there is no such drive.
    """
    file = next((each.file for each in read_folder(folder)[0] if each.file.name == name), None)
    if file is None:
        raise InputError("drives: there is no such drive; reload the page.")
    return file


def discard(folder: Path, name: Any) -> None:
    """Move a drive to ``trials/discarded``, from where it is no demonstration.

    Raises:
        InputError: there is no such drive, or it cannot be moved.
    """
    file = find(folder, name)
    _move(file, file.parent / DISCARDED / file.name)


def rename(folder: Path, name: Any, words: Any) -> None:
    """Give a drive a name; it becomes a part of the file's name.

    Raises:
        InputError: there is no such drive, or the name is none for a file.
    """
    file = find(folder, name)
    if not isinstance(words, str) or not re.fullmatch(rf"[\w ]{{0,{MAX_NAME}}}", words):
        raise InputError(f"drives: give a name of letters, digits, _ and spaces, {MAX_NAME} at most.")
    words = words.strip()
    number = file.stem.partition("-")[0]
    _move(file, file.with_name(f"{number}-{words}.jsonl" if words else f"{number}.jsonl"))


def _move(file: Path, other: Path) -> None:
    try:
        other.parent.mkdir(exist_ok=True)
        if other != file and not os.path.lexists(other):
            file.rename(other)
    except (OSError, ValueError) as error:
        raise InputError(f"drives: {file.name} cannot be moved: {writing.reason(error)}.") from None


# ------------------------------------------------------------------ demonstrations


class Summary(NamedTuple):
    """What became of the drives of a folder."""

    data: Dataset | None  # None: there is no demonstration
    said: list[str]  # sentences about drives that are left out


def demonstrations(config: StudioConfig, watch: Callable[[str], None] = lambda text: None) -> Summary:
    """The dataset of the drives in a studio's folder, each simulated again unless the dataset has it already.

    Args:
        watch: is called with what is done at the moment.

    Raises:
        InputError: the dataset is another's, or a drive names code that the studio's own options do not.
    """
    folder = config.record
    assert folder is not None
    drives, said = read_folder(folder)
    drives = [drive for drive in drives if drive.outcome is not None and len(drive.commands)]
    place = folder / DATASETS[config.demonstrations]
    if not drives and not place.exists():
        return Summary(None, said)
    recorded = _options(config, drives)
    drives, foreign = _alike(drives, recorded)
    scenario = assembly.build(recorded)[0]
    wanted = [(drive, parts) for drive in drives if (parts := _parts(drive, scenario, config.demonstrations))]
    if left := len(drives) - len(wanted):
        said.append(
            f"{left} of {len(drives)} drives have no demonstration of a person: they were not completed, or the policy "
            "drove, or their file does not say who did. --demonstrations all takes them."
        )
    if not wanted and not place.exists():
        return Summary(None, said + foreign)
    driver = "human" if config.demonstrations == "person" else "human and policy"
    recorder = Recorder(place, scenario, driver=driver, seed=recorded.seed)
    kept = _keep(recorder.data, wanted)
    for number, (drive, parts) in enumerate(wanted[kept:], kept + 1):
        watch(f"demonstrations: drive {number} of {len(wanted)}, {drive.file.name}")
        replay(recorder, drive.episode, drive.commands)
        recorder.commit(parts)
    return Summary(recorder.data, said + foreign)


def _options(config: StudioConfig, drives: Sequence[RecordedDrive]) -> StudioConfig:
    """The options of the drives: the studio's own, or those of the first drive with the studio's own code.

    Raises:
        InputError: the first drive names code that is not the studio's own, by its name or by its content.
    """
    if not drives:
        return config
    first, recorded = drives[0], config
    if first.options != json.loads(json.dumps(config.identity())):
        recorded = _with_own_code(config, validate(StudioConfig, first.options, source=first.file))
    if changed := _changed(first.code, components.digests(recorded)):
        text = f"the drives in {config.record} were driven with another {changed}, or do not say with which"
        raise InputError(f"record: {text}; restore that file, or choose another folder.")
    return recorded


def _with_own_code(config: StudioConfig, recorded: StudioConfig) -> StudioConfig:
    """Recorded options, whose code is that of the studio's options; other code is not even read.

    Raises:
        InputError: they name other code: another file, another name in the file, or other options of it.
    """
    own, named = components.by_option(config), components.by_option(recorded)
    for option, parts in named.items():
        if parts != own.get(option):
            text = f"the drives in {config.record} need the code {parts[0]['kind']}"
            raise InputError(f"record: {text}; start the studio with the same options to use them.")
    return recorded.replace(**{option: getattr(config, option) for option in named})


def _alike(drives: Sequence[RecordedDrive], recorded: StudioConfig) -> tuple[list[RecordedDrive], list[str]]:
    """The drives with the options of the first, and no longer than an episode; a sentence for each other one."""
    alike, said = [], []
    longest = math.ceil(recorded.time_limit / recorded.time_step - 1e-6)
    for drive in drives:
        if (drive.options, drive.code) != (drives[0].options, drives[0].code):
            other = "code" if drive.options == drives[0].options else "options"
            said.append(f"{drive.file} has other {other} than {drives[0].file.name}; {CURE}. The drive is left out.")
        elif len(drive.commands) > longest:
            steps = f"{len(drive.commands)} steps, and an episode at most {longest}"
            said.append(f"{drive.file} has {steps}; {CURE}. The drive is left out.")
        else:
            alike.append(drive)
    return alike, said


def _parts(drive: RecordedDrive, scenario: Any, which: str) -> list[EpisodePart]:
    """The rows of a drive that are demonstrations, each piece without a gap: a person's, or all."""
    if which == "person" and (drive.by_person is None or drive.outcome != "completed"):
        return []
    by_person = _by_row(drive, steps_per_row(scenario, 1))
    takes = by_person if which == "person" else np.ones(len(by_person), bool)
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], takes, [False]]).astype(int)))
    parts = []
    for first, end in zip(bounds[::2].tolist(), bounds[1::2].tolist(), strict=True):
        about = {"trial": drive.file.name, "sha256": drive.sha256, "rows": [first, end]}
        parts.append(EpisodePart(first, end, about | {"by_person": by_person[first:end].tolist()}))
    return parts


def _by_row(drive: RecordedDrive, every: int) -> np.ndarray:
    """Whether a person gave all commands of each row, of so many steps."""
    steps = np.zeros(len(drive.commands), bool) if drive.by_person is None else drive.by_person
    return np.array([steps[first : first + every].all() for first in range(0, len(steps), every)], bool)


def _keep(data: Dataset, wanted: Sequence[tuple[RecordedDrive, list[EpisodePart]]]) -> int:
    """Cut the dataset after the first drives that it has as they are wanted; their number."""
    shards = data.manifest["shards"]
    drives = kept = 0
    for _, parts in wanted:
        had = shards[kept : kept + len(parts)]
        same = [_identity(shard) == _identity(part.about) for shard, part in zip(had, parts, strict=False)]
        if len(had) < len(parts) or not all(same):
            break
        drives, kept = drives + 1, kept + len(parts)
    names = [part.about["trial"] for _, parts in wanted[:drives] for part in parts]
    named = [shard | {"trial": name} for shard, name in zip(shards[:kept], names, strict=True)]
    if named != shards[:kept]:  # a drive has another name
        data.save({**data.manifest, "shards": [*named, *shards[kept:]]})
    if kept < len(shards):
        data.cut(kept)
    return drives


def _identity(entry: Mapping[str, Any]) -> tuple[Any, ...]:
    """What tells demonstrations apart: the content of the drive, and the rows of it."""
    return entry.get("sha256"), entry.get("rows"), entry.get("by_person")


def replay(recorder: Recorder, episode: int, commands: np.ndarray) -> Any:
    """The last state of an episode that is simulated again from its commands (T, 2)."""
    state = recorder.begin(recorder.episode_key(episode))
    for action in commands:
        state = recorder.step(jnp.asarray(action))
    return state

"""Recorded drives: the options, the number of the episode and all commands, from which it is simulated again.

A trial is a file of JSON lines: a head, then the commands of each second with who gave each, and the outcome at the
end. Each line is on the disk before the next second begins. Trials become demonstrations of a ``learning.Recorder``,
each of which names its trial by file, SHA-256 and rows: what a person discards is no longer in the dataset.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import math
import os
import re
import stat
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
import pydantic

from sean_jax.config import StudioConfig, user_parts, validate
from sean_jax.core.bounds import TIME_STEP_RANGE
from sean_jax.core.data_types import RobotModel, Scenario, State
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.messages import shorten
from sean_jax.io import files, writing
from sean_jax.learning.collection import EpisodePart, Recorder, steps_per_row
from sean_jax.learning.dataset import Dataset
from sean_jax.robots.drive import command_size, max_reverse_speed
from sean_jax.simulation import making

VERSION = 2  # of the files
STOPPED = "stopped"  # outcome of a trial that did not reach the end of its episode
TRIALS, DISCARDED = "trials", "discarded"
DATASETS = {"person": "demonstrations", "all": "demonstrations-all"}
MAX_TRIAL = 20_000_000  # bytes of a file
END_ROOM = 200_000  # bytes of a file that are kept for its last second, which has 1,000 steps at most, and its end
MAX_COMMAND = 100.0  # m/s, rad/s
MAX_NAME = 60  # characters of a drive's name
ROUNDING = 1e-5  # of a robot's limit, in single precision
CURE = "move it out of the folder"
LINK = f"is a link or no regular file, through which nothing is written; {CURE}"
FULL = "a drive has at most 20 MB"
LEFT_OUT = "The drive is left out."


# ------------------------------------------------------------------ lines of a file

Speed = Annotated[float, pydantic.Field(ge=-MAX_COMMAND, le=MAX_COMMAND)]
Count = Annotated[int, pydantic.Field(ge=0, lt=2**32)]


class TrialLine(pydantic.BaseModel):
    """A line of JSON."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)


class TrialHead(TrialLine):
    """The first line."""

    version: Literal[2]  # VERSION
    options: dict[str, Any]
    episode: Count
    sha256: dict[str, str] = {}
    """File -> SHA-256, of the user's own files that the options name."""


Numbers = Annotated[list[Speed], pydantic.Field(min_length=2, max_length=3)]


class CommandLine(TrialLine):
    """Commands of some steps, as ``robots.drive``, and whether a person gave each."""

    commands: list[Numbers]
    by_person: list[bool]


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
    commands: np.ndarray  # (T, 2) m/s, rad/s, or (T, 3) of an omnidirectional robot
    by_person: np.ndarray  # (T,) bool
    outcome: str | None  # None: the program was killed
    code: dict[str, str]  # file -> SHA-256, of the user's own files


def read(file: Path) -> RecordedDrive:
    """The content of a trial; a last line without its end was not written whole, and does not count.

    Raises:
        FileError: it is no trial.
    """
    head, commands, by_person, outcome = None, list[list[float]](), list[bool](), None
    for number, text in enumerate(files.read_text(file, MAX_TRIAL).split("\n")[:-1], 1):
        place = Path(f"{file}:{number}")
        line = _parsed(place, text, head is None)
        if isinstance(line, TrialHead):
            head = line
        elif outcome is not None:
            raise files.file_error(place, f"the drive has ended in an earlier line; {CURE}")
        elif isinstance(line, CommandLine):
            commands += line.commands
            if len({len(row) for row in [*commands[:1], *line.commands]}) > 1:
                raise files.file_error(place, f"commands: some have 2 numbers, and some 3; {CURE}")
            if len(line.by_person) != len(line.commands):
                raise files.file_error(place, f"by_person has another number of values than commands; {CURE}")
            by_person += line.by_person
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
    numbers = np.asarray(commands, float) if commands else np.zeros((0, 2))
    return RecordedDrive(
        file, digest, head.options, head.episode, numbers, np.asarray(by_person, bool), outcome, head.sha256
    )


def _parsed(place: Path, text: str, first: bool) -> TrialLine:
    """A line, checked; the first one is the head."""
    data = files.parse_file_json(place, text)
    if not isinstance(data, dict):
        raise files.file_error(place, f"it is no line of a trial; {CURE}")
    model = TrialHead if first else next((LINES[key] for key in LINES if key in data), None)
    if model is None:
        raise files.file_error(place, f"it has none of {', '.join(LINES)}; {CURE}")
    return files.check_json(place, data, model)


@functools.lru_cache(4096)
def _read_known(file: Path, size: int, changed: int) -> RecordedDrive:
    return read(file)


def read_folder(folder: Path) -> tuple[list[RecordedDrive], list[str]]:
    """The drives of a studio's folder by number, and a sentence for each file that is none."""
    drives, problems = [], []
    place = folder / TRIALS
    if place.is_symlink():
        return [], [f"{place} {LINK}. Its drives are left out."]
    for file in sorted(place.glob("*.jsonl")):
        try:
            status = _regular(file)
            drives.append(_read_known(file, status.st_size, status.st_mtime_ns))
        except FileError as error:
            problems.append(f"{str(error).splitlines()[0]} {LEFT_OUT}")
        except OSError as error:
            problems.append(f"{file} cannot be read: {writing.reason(error)}. {LEFT_OUT}")
    return drives, problems


def _regular(file: Path) -> os.stat_result:
    """The status of a file.

    Raises:
        FileError: it is a link, or no file: who sends a folder could lead elsewhere by it.
        OSError: there is none.
    """
    status = file.lstat()
    if not stat.S_ISREG(status.st_mode):
        raise files.file_error(file, LINK)
    return status


# ------------------------------------------------------------------ a drive that goes on


class Trial:
    """The file of a drive that goes on: never one that ``read`` refuses."""

    def __init__(self, file: Path, head: dict[str, Any], per_line: int):
        self.file, self._per_line = file, per_line
        self._pending: list[tuple[tuple[float, ...], bool]] = []
        self._steps = 0
        text = json.dumps(head) + "\n"
        self._bytes = len(text)
        writing.write(file, text)  # whole or not at all
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
        if folder.is_symlink():
            raise InputError(f"record: {folder} {LINK}.")
        folder.mkdir(parents=True, exist_ok=True)
        head = {"version": VERSION, "options": config.identity(), "episode": number}
        head["sha256"] = user_parts.digests(config)
        check(config.record, head["options"], head["sha256"])
        taken = [_number(file) for file in (*folder.glob("*.jsonl"), *(folder / DISCARDED).glob("*.jsonl"))]
        return cls(folder / f"{1 + max(taken, default=-1):06d}.jsonl", head, max(1, round(1.0 / config.time_step)))

    def add(self, commands: Iterable[tuple[float, ...]], by_person: Iterable[bool]) -> None:
        """Commands of further steps; whole seconds are written.

        Raises:
            InputError: the file is full, or a command is no number that it can have; it has to be ended.
        """
        steps = list(zip(commands, by_person, strict=True))
        wrong = next((row for row, _ in steps if not all(abs(value) <= MAX_COMMAND for value in row)), None)
        if wrong is not None:
            raise InputError(f"the command {list(wrong)} is not from -{MAX_COMMAND:g} to {MAX_COMMAND:g}")
        self._pending += steps
        self._steps += len(steps)
        while len(self._pending) >= self._per_line:
            if self._is_full:
                self._pending = []  # the file ends with its last whole second
                raise InputError(FULL)
            self._write_steps(self._pending[: self._per_line])
            del self._pending[: self._per_line]

    @property
    def _is_full(self) -> bool:
        return self._bytes > MAX_TRIAL - END_ROOM

    def rewind(self, tick: int) -> None:
        """The steps from ``tick`` on did not happen.

        Raises:
            InputError: the file is full; it has to be ended.
        """
        if self._is_full:
            raise InputError(FULL)
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

    def _write_steps(self, steps: Sequence[tuple[tuple[float, ...], bool]]) -> None:
        commands, by_person = zip(*steps, strict=True)
        self._write({"commands": commands, "by_person": by_person})

    def _write(self, line: dict[str, Any]) -> None:
        text = json.dumps(line) + "\n"
        self._bytes += len(text)
        self._stream.write(text)
        self._stream.flush()
        os.fsync(self._stream.fileno())


def _number(file: Path) -> int:
    """The number at the beginning of a file's name; -1 if there is none."""
    digits = re.match(r"[0-9]{1,12}", file.name)
    return int(digits[0]) if digits else -1


def check(folder: Path, options: Mapping[str, Any], code: Mapping[str, str]) -> None:
    """Refuse a folder whose drives have other options, or other code by its SHA-256.

    The first drive that is valid counts, unless there is one with these options.

    Raises:
        InputError: it names the first that differs.
    """
    now = json.loads(json.dumps(options))
    for drive in _own_first(read_folder(folder)[0], now):
        had, cure = drive.options, f"choose another folder, or move {drive.file.name} away"
        other = next((name for name in {**had, **now} if had.get(name) != now.get(name)), None)
        if other is not None:
            try:
                validate(StudioConfig, had, source=drive.file)
            except InputError:  # it is left out of the demonstrations, too
                continue
            text = f"{folder} has drives with {other} {shorten(str(had.get(other)))}, not {now.get(other)}"
            raise InputError(f"record: {text}; {cure}.")
        if changed := _changed(drive.code, code):
            raise InputError(f"record: {folder} has drives with another {changed}; {cure}.")
        return


def _own_first(drives: Sequence[RecordedDrive], options: Mapping[str, Any]) -> list[RecordedDrive]:
    return sorted(drives, key=lambda drive: drive.options != options)


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
    if place.is_symlink():
        return [f"{place} {LINK}. Its drives are left out."]
    for file in place.glob(".*.jsonl.new"):  # a head that was not written whole
        with contextlib.suppress(OSError):  # such as a folder of that name
            file.unlink()
    for file in sorted(place.glob("*.jsonl")):
        try:
            text = _recover_file(file)
        except FileError as error:
            text = f"{str(error).splitlines()[0]} {LEFT_OUT}"
        except OSError as error:
            text = f"{file} cannot be ended: {writing.reason(error)}. {LEFT_OUT}"
        said += [text] if text else []
    return said


def _recover_file(file: Path) -> str:
    """End a drive that was killed; what is to be said about it.

    Raises:
        FileError: it is no trial, or a link.
        OSError: it cannot be written.
    """
    _regular(file)
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
    descriptor = os.open(file, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    with open(descriptor, "r+b") as stream:
        if os.fstat(descriptor).st_nlink > 1:  # another name of a file elsewhere
            raise files.file_error(file, LINK)
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
        step = drive.options.get("time_step")
        least, most = TIME_STEP_RANGE
        seconds = len(drive.commands) * step if isinstance(step, int | float) and least <= step <= most else None
        rows.append(
            {
                "file": drive.file.name,
                "name": drive.file.stem.partition("-")[2],
                "episode": drive.episode,
                "seconds": None if seconds is None else round(seconds, 2),
                "outcome": drive.outcome,
                "by_person": round(float(drive.by_person.mean()), 4),
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
    place = file.parent / DISCARDED
    names = [file.name, *(f"{file.stem} {number}.jsonl" for number in range(2, 1000))]
    _move(file, next((place / each for each in names if not os.path.lexists(place / each)), place / file.name))


def rename(folder: Path, name: Any, words: Any) -> None:
    """Give a drive a name; it becomes a part of the file's name.

    Raises:
        InputError: there is no such drive, the name is none for a file, or another file has it.
    """
    file = find(folder, name)
    if not isinstance(words, str) or not re.fullmatch(rf"[\w ]{{0,{MAX_NAME}}}", words):
        raise InputError(f"drives: give a name of letters, digits, _ and spaces, {MAX_NAME} at most.")
    words = words.strip()
    number = file.stem.partition("-")[0]
    _move(file, file.with_name(f"{number}-{words}.jsonl" if words else f"{number}.jsonl"))


def _move(file: Path, other: Path) -> None:
    if other == file:
        return
    if other.parent.is_symlink():
        raise InputError(f"drives: {other.parent} {LINK}.")
    try:
        other.parent.mkdir(exist_ok=True)
        if os.path.lexists(other):
            raise InputError(f"drives: there is a file {other.name} already, so {file.name} stays; give another name.")
        file.rename(other)
    except InputError:
        raise
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
    if place.is_symlink():
        raise InputError(f"record: {place} {LINK}.")
    if not drives and not place.exists():
        return Summary(None, said)
    recorded, scenario, drives, foreign = _scenario_of(config, drives)
    if refused := no_demonstrations(scenario):
        return Summary(None, [*said, *foreign, refused])
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
        problem = _belied(drive, replay(recorder, drive.episode, drive.commands))
        if problem:
            recorder.discard()
            said.append(f"{drive.file} {problem}; {CURE}. {LEFT_OUT}")
        else:
            recorder.commit(parts)
    return Summary(recorder.data, said + foreign)


def no_demonstrations(scenario: Scenario) -> str:
    """Why the drives of a robot become no demonstrations; "" if they do."""
    robot = scenario.robot
    if robot.drive_type == "differential":
        return ""
    why = f"demonstrations are of differential robots, and the drive of {robot.name} is {robot.drive_type}"
    return f"{why}; its drives are recorded in {TRIALS}/ and stay there, but become no dataset."


def _belied(drive: RecordedDrive, state: State) -> str:
    """What a drive says that is not so when it is simulated again; "" if all is."""
    if int(state.tick) < len(drive.commands):
        return f"has {len(drive.commands)} steps, and its episode ends after {int(state.tick)}"
    if drive.outcome == "completed" and not bool(state.completed):
        return "says that it was completed, and does not complete when it is simulated again"
    return ""


def _scenario_of(
    config: StudioConfig, drives: Sequence[RecordedDrive]
) -> tuple[StudioConfig, Scenario, list[RecordedDrive], list[str]]:
    """Options and scenario of the drives, those of these options, and what is left out.

    They are the studio's own, or those of the first drive whose options can be met with the studio's own code.

    Raises:
        InputError: no drive has such options.
    """
    problems: dict[Path, str] = {}
    for first in _own_first(drives, json.loads(json.dumps(config.identity()))):
        try:
            recorded = _options(config, first)
            scenario = making.scenarios(recorded)[0]
        except InputError as error:
            text = str(error).splitlines()[0]
            problems[first.file] = text if str(first.file) in text else f"record: {first.file}: {text}"
            continue
        rest = [drive for drive in drives if drive.file not in problems]
        alike, said = _alike(rest, first, recorded, scenario)
        return recorded, scenario, alike, [*(f"{text} {LEFT_OUT}" for text in problems.values()), *said]
    for text in problems.values():
        raise InputError(text)
    return config, making.scenarios(config)[0], [], []


def _options(config: StudioConfig, drive: RecordedDrive) -> StudioConfig:
    """The options of a drive: the studio's own, or the drive's with the studio's own code.

    Raises:
        InputError: it is invalid, or names code that is not the studio's own, by its name or by its content.
    """
    recorded = config
    if drive.options != json.loads(json.dumps(config.identity())):
        recorded = _with_own_code(config, validate(StudioConfig, drive.options, source=drive.file), drive.file)
    if changed := _changed(drive.code, user_parts.digests(recorded)):
        text = f"{drive.file} was driven with another {changed}, or does not say with which"
        raise InputError(f"record: {text}; restore that file, or choose another folder.")
    return recorded


def _with_own_code(config: StudioConfig, recorded: StudioConfig, file: Path) -> StudioConfig:
    """Recorded options, whose code is that of the studio's options; other code is not even read.

    Raises:
        InputError: they name other code: another file, another name in the file, or other options of it.
    """
    own, named = user_parts.by_option(config), user_parts.by_option(recorded)
    for option, parts in named.items():
        if parts != own.get(option):
            text = f"{file} needs the code {parts[0]['kind']}"
            raise InputError(f"record: {text}; start the studio with the same options to use it.")
    return recorded.replace(**{option: getattr(config, option) for option in named})


def _alike(
    drives: Sequence[RecordedDrive], first: RecordedDrive, recorded: StudioConfig, scenario: Scenario
) -> tuple[list[RecordedDrive], list[str]]:
    """The drives with the options of one that its robot and episode can have; a sentence for each other one."""
    alike, said = [], []
    longest = math.ceil(recorded.time_limit / recorded.time_step - 1e-6)
    for drive in drives:
        problem = _unlike(drive, first, longest) or _beyond_robot(drive, scenario.robot)
        if problem:
            said.append(f"{drive.file} {problem}; {CURE}. {LEFT_OUT}")
        else:
            alike.append(drive)
    return alike, said


def _unlike(drive: RecordedDrive, first: RecordedDrive, longest: int) -> str:
    """What a drive has that the first one has not, or more steps than an episode; "" if nothing."""
    if (drive.options, drive.code) != (first.options, first.code):
        return f"has other {'code' if drive.options == first.options else 'options'} than {first.file.name}"
    if len(drive.commands) > longest:
        return f"has {len(drive.commands)} steps, and an episode at most {longest}"
    return ""


def _beyond_robot(drive: RecordedDrive, robot: RobotModel) -> str:
    """What the commands of a drive have that a person cannot give this robot in the studio; "" if nothing."""
    size = command_size(robot)
    if drive.commands.shape[1] != size:
        return f"has commands of {drive.commands.shape[1]} numbers, and those of {robot.name} have {size}"
    sides = [] if robot.lateral is None else [float(robot.lateral.max_speed)]
    most = np.array([float(robot.max_speed), *sides, _turn_rate(robot)])
    least = -np.array([float(max_reverse_speed(robot)), *most[1:]])
    beyond = (drive.commands > most * (1 + ROUNDING)) | (drive.commands < least * (1 + ROUNDING))
    wrong = np.flatnonzero(drive.by_person & beyond.any(1))
    if len(wrong):
        row = drive.commands[wrong[0]].tolist()
        return f"has a person's command {row} at step {wrong[0]}, beyond the limits of {robot.name}"
    return ""


def _turn_rate(robot: RobotModel) -> float:
    """rad/s, the most that a person commands; of a car at its top speed."""
    if robot.steering is None:
        return float(robot.max_turn_rate)
    fastest = max(float(robot.max_speed), float(max_reverse_speed(robot)))
    return fastest * math.tan(float(robot.steering.max_angle)) / float(robot.steering.wheelbase)


def _parts(drive: RecordedDrive, scenario: Scenario, which: str) -> list[EpisodePart]:
    """The rows of a drive that are demonstrations, each piece without a gap: a person's, or all."""
    if which == "person" and drive.outcome != "completed":
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
    steps = drive.by_person
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
    """The last state of an episode that is simulated again from its commands (T, 2) or (T, 3), to its end at most."""
    state = recorder.begin(recorder.episode_key(episode))
    for action in commands:
        if bool(state.completed) or bool(state.timed_out):
            break
        state = recorder.step(jnp.asarray(action))
    return state

"""The folder of a run: config.yaml with copies of the input files, and episodes.csv, written and read again.

Input files are the description's files, except Python files. An environment, a robot, forces and sensors are copied.
A recording may be large and stays where it is, as the folder of a policy does: the description has absolute paths.
"""

import array
import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from sean_jax.config import Named, PlaybackBehavior, RunConfig, outside, user_parts
from sean_jax.config.flags import command
from sean_jax.core.bounds import MAX_DURATION, MAX_MAGNITUDE
from sean_jax.core.errors import FileError, InputError
from sean_jax.io import files
from sean_jax.io.files import mjcf
from sean_jax.learning.policy import AGENTS
from sean_jax.metrics import METRICS
from sean_jax.policies import POLICIES
from sean_jax.robots import ROBOTS
from sean_jax.world import environment, generated

MAX_COPY = 10_000_000  # bytes of an environment's or a robot's files; more stay where they are
MAX_FILE = 100_000_000  # bytes of a file, such as a recording
ENDINGS = (".yaml", ".yml")  # of forces and sensors in a file
COPIED = ("environment", "robot", "forces", "sensors")  # options whose files are copied
OPTIONS = (*COPIED, "policy", "behavior")  # that name files

LIMITS = {"episode": (0, 2**31), "completed": (0, 1), "timed_out": (0, 1), "seconds": (0, MAX_DURATION)}
"""Column of episodes.csv -> least and most; none of its cells is empty."""

TEXTS = "task", "environment", "robot"  # columns without numbers
CELLS = {"True": 1.0, "False": 0.0, "": math.nan}  # of episodes.csv


class Inputs(NamedTuple):
    """The input files of a run, as they were when the run began."""

    content: dict[str, bytes]  # file in the run's folder -> its bytes
    copies: dict[str, str]  # file or folder as the description names it -> its copy in the run's folder
    hashes: dict[str, str]  # absolute path of a file without a copy -> SHA-256
    description: dict[str, Any]  # field -> value, with absolute paths
    fingerprint: str = ""  # of the scenario and the policy

    def write(self, folder: Path) -> dict[str, str]:
        """Write the copies; file -> SHA-256, of the copies by their path in the folder."""
        for name, content in self.content.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return {name: hashlib.sha256(content).hexdigest() for name, content in self.content.items()} | self.hashes


def read_inputs(config: RunConfig) -> Inputs:
    """The files that a description names.

    Raises:
        InputError: a file cannot be read.
    """
    content: dict[str, bytes] = {}
    copies: dict[str, str] = {}
    hashes: dict[str, str] = {}
    names: dict[str, str] = {}
    for option, name, path in _named(config):
        names[name] = name if name in environment.available() else os.path.abspath(path)
        root, sources = _sources(option, path)
        read = {part: files.read_bytes(part, MAX_FILE) for part in sources}
        small = sum(map(len, read.values())) <= MAX_COPY and all(part.is_relative_to(root) for part in read)
        if option not in COPIED or not small:
            hashes |= {str(part): hashlib.sha256(data).hexdigest() for part, data in read.items()}
            continue
        number = sum(copy.startswith(option) for copy in copies.values())
        place = f"{option}_{number + 1}" if number else option
        copies[names[name]] = f"{place}/{path.name}"
        inside = copies[names[name]] if path.is_dir() else place
        content |= {f"{inside}/{part.relative_to(root).as_posix()}": data for part, data in read.items()}
    description = config.identity() | {"camera": config.camera}
    return Inputs(content, copies, hashes, rename(description, names))


def rename(description: dict[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """A description with other files: ``names`` maps a file or folder to its new name."""

    def renamed(value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [renamed(each) for each in value]
        if isinstance(value, Mapping):
            return {key: renamed(each) for key, each in value.items()}
        if not isinstance(value, str) or value in names:
            return names.get(value, value)
        return ",".join(names.get(part, part) for part in value.split(","))  # of several robots

    return {field: renamed(value) if field in OPTIONS else value for field, value in description.items()}


def locate(copies: Mapping[str, str], hashes: Mapping[str, str], folder: Path) -> tuple[dict[str, str], list[str]]:
    """Compare the input files of a run with its copies (``Inputs.copies``) by their SHA-256.

    Returns:
        File or folder, as the description names it, that is missing or has changed -> its copy; and a sentence on each
        that has changed.
    """
    names, sentences = {}, []
    for name, copy in copies.items():
        option = copy.partition("/")[0].partition("_")[0]
        inside = f"{copy}/" if option == "environment" else f"{Path(copy).parent.as_posix()}/"
        then = {part.removeprefix(inside): value for part, value in hashes.items() if part.startswith(inside)}
        try:
            path = _environment(name) if option == "environment" else Path(name)
            root, sources = _sources(option, path)
            now = {part.relative_to(root).as_posix(): user_parts.digest(part, MAX_FILE) for part in sources}
        except (ValueError, OSError):  # it is missing, or is another kind of file now
            now = {}
        if now != then:
            names[name] = str(folder / copy)
        if now and now != then:
            other = ", ".join(sorted(part for part in now.keys() | then.keys() if now.get(part) != then.get(part)))
            sentences.append(f"{option}: {name} is not as it was in the run ({other}); the copy in {folder} is used.")
    return names, sentences


def _named(config: RunConfig) -> Iterator[tuple[str, str, Path]]:
    """Option, name and path of each file and folder of a description."""
    if not generated.parse_set(config.environment):  # which is made by its name
        yield "environment", config.environment, _environment(config.environment)
    for robot in config.robot_parts:
        if isinstance(robot, Named) and robot.kind not in ROBOTS:
            yield "robot", robot.kind, Path(robot.kind)
    for option, parts in (("forces", config.forces), ("sensors", config.sensors)):
        for part in parts:
            if isinstance(part, Named) and part.kind.lower().endswith(ENDINGS):
                yield option, part.kind, Path(part.kind)
    behavior = config.behavior
    for policy in config.policies:
        if isinstance(policy, Named) and not (policy.kind in POLICIES or policy.kind in AGENTS or outside(policy)):
            yield "policy", policy.kind, Path(policy.kind)
    if isinstance(behavior, PlaybackBehavior) and behavior.recording is not None:
        yield "behavior", behavior.recording, Path(behavior.recording)


def _environment(name: str) -> Path:
    """The folder of an environment, or of a set of them."""
    folders = generated.find(name)
    return folders[0] if len(folders) == 1 else folders[0].parent


def _sources(option: str, path: Path) -> tuple[Path, list[Path]]:
    """The folder of a file or folder, and the files that are read for it; a policy's are in the fingerprint."""
    if option == "environment":
        sources = [source for folder in generated.find(path) for source in environment.sources(folder)]
    elif option == "robot":
        sources = [path, *mjcf.sources(path)]
    else:
        sources = [] if option == "policy" else [path]
    root = path if path.is_dir() else path.parent
    return Path(os.path.abspath(root)), [Path(os.path.abspath(part)) for part in sources]


def write_config(folder: Path, about: dict[str, Any], config: RunConfig | None, inputs: Inputs | None) -> None:
    """Write config.yaml, by which ``sean run --config`` repeats the run, and copies of its input files beside it.

    ``about`` has the names of the scenario, the number of people and the versions. ``config`` and ``inputs`` are those
    of ``sean run``, or None.
    """
    content: dict[str, Any] = {}
    if config is not None and inputs is not None:
        copies, hashes = user_parts.copy(folder, config)
        description = {name: value for name, value in inputs.description.items() if value is not None}
        content["command"] = command("run", config)
        content["config"] = user_parts.relocate(json.loads(json.dumps(description)), copies)
        content["copies"] = inputs.copies
        content["sha256"] = hashes | inputs.write(folder)
        content["fingerprint"] = inputs.fingerprint
    else:
        content["made by"] = "a Python program with values of its own, which a file cannot repeat"
        content["scenario"] = about["scenario"]
    content |= {name: about[name] for name in ("people", "versions")}
    text = yaml.safe_dump(content, sort_keys=False, width=1000)
    (folder / "config.yaml").write_text(text, encoding="utf-8")


class SavedConfig(NamedTuple):
    """The content of a config.yaml."""

    description: dict[str, Any]  # field -> value, for ``RunConfig``
    changes: list[str]  # a sentence on each file that has changed since the run
    identities: dict[str, str]  # file or folder of the description -> digests of its content
    fingerprint: str  # of the scenario and the policy; "" if the file has none
    versions: dict[str, str]  # package -> version; {} if the file has none


def read_config(path: Path, check: bool = True) -> SavedConfig:
    """The content of a config.yaml; where an input file has changed, the description names its copy.

    Args:
        check: refuse changed copies and changed Python files, as a run must.

    Raises:
        InputError: the file cannot be used, or a file that it names has changed.
    """
    _, content = files.read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no description; give a config.yaml, such as `sean run` writes.")
    if "made by" in content:
        raise InputError(f"{path}: was made by {content['made by']}; put the parts into separate files.")
    data = content.get("config", {name: value for name, value in content.items() if name != "$schema"})
    if not isinstance(data, dict):
        raise InputError(f"{path}: config: holds no description; give field: value lines.")
    hashes, copies = _texts(path, content, "sha256", "digest"), _texts(path, content, "copies", "copy")
    folder = path.parent
    code = {name: digest for name, digest in hashes.items() if name.endswith(".py")}
    for name, digest in hashes.items() if check else ():
        if name not in code and user_parts.digest(folder / name, MAX_FILE) != digest:
            cure = f"restore it, or remove its line under sha256 in {path.name} to accept it"
            raise InputError(f"{folder / name}: is not the file that the run was made with; {cure}.")
    places, changes = locate(copies, hashes, folder)
    description = user_parts.recorded(path, rename(data, places), code if check else None, "sha256")
    copied = ((folder / name, digest) for name, digest in code.items())
    identities = {str(file): user_parts.content(file).digest if file.is_file() else then for file, then in copied}
    for name, copy in copies.items():
        digests = " ".join(f"{part} {digest}" for part, digest in hashes.items() if part.startswith(copy))
        identities |= {name: digests, str(folder / copy): digests}
    versions = content.get("versions")
    return SavedConfig(
        description=description,
        changes=changes,
        identities=identities,
        fingerprint=str(content.get("fingerprint", "")),
        versions=versions if isinstance(versions, dict) else {},
    )


def _texts(path: Path, content: dict[str, Any], key: str, what: str) -> dict[str, str]:
    """The lines under a key of a config.yaml."""
    lines = content.get(key) or {}
    if not isinstance(lines, dict) or not all(isinstance(text, str) for pair in lines.items() for text in pair):
        raise InputError(f"{path}: {key}: {lines!r:.60} is no list of files; give file: {what} lines, or none.")
    return lines


def read_episodes(path: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """The E tasks of an episodes.csv, and its columns (E,) of numbers, NaN for an empty cell; without its floors.

    Of a team there is a row for each robot, in the order of the team.

    Raises:
        FileError: the file cannot be read, its episodes do not count from 0, or a value is out of range.
    """
    rows, place = files.read_rows(path), files.short_name(path)
    head = next(rows, [])
    for name in ("episode", "task", "completed", "seconds"):
        if name not in head:
            raise FileError(f"{place}: has no column {name}; restore the file.")
    team = list[str]()  # robots of episode 0
    tasks, numbers = [], {name: array.array("d") for name in head if name not in TEXTS}
    limits = {name: _limits(name) for name in numbers}
    for number, row in enumerate(rows):
        for name, cell in zip(head, row, strict=True):
            if name == "task":
                tasks.append(cell)
            if name == "robot" and cell not in team:
                team.append(cell)
            if name in TEXTS:
                continue
            low, high = limits[name]
            value = _number(cell)
            if not (low <= value <= high or (cell == "" and name not in LIMITS)):
                what = f"{name}: {cell[:40]!r} is no number from {low:,g} to {high:,g}"
                raise FileError(f"{place}: episode {number}: {what}; restore the file.")
            numbers[name].append(value)
        if "robot" not in head and numbers["episode"][-1] != number:
            raise FileError(f"{place}: episode {number} is missing; restore the file.")
    if not tasks:
        raise FileError(f"{place}: holds no episode; run it again.")
    number = len(tasks)
    if team and (number % len(team) or not np.array_equal(numbers["episode"], np.arange(number) // len(team))):
        raise FileError(f"{place}: its episodes do not have a row for each of {', '.join(team)}; restore the file.")
    return tasks, {name: np.array(values) for name, values in numbers.items() if name != "episode"}


def _limits(name: str) -> tuple[float, float]:
    metric = METRICS.get(name.partition("__")[0])
    of_kind = {"count": (0.0, MAX_MAGNITUDE), "share": (0.0, 1.0)}
    return LIMITS.get(name) or of_kind.get(metric.kind if metric else "", (-MAX_MAGNITUDE, MAX_MAGNITUDE))


def _number(cell: str) -> float:
    try:
        return CELLS[cell] if cell in CELLS else float(cell.replace("_", "no"))
    except ValueError:
        return math.inf

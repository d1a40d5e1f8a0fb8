"""The folder of a run, read again: config.yaml with copies of the input files, and episodes.csv."""

import array
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sean_jax.config import user_parts
from sean_jax.config.input_files import rename, texts
from sean_jax.core.bounds import MAX_DURATION, MAX_MAGNITUDE
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.messages import listed
from sean_jax.io import files
from sean_jax.metrics import METRICS

MAX_FILE = 100_000_000  # bytes of a file, such as a recording
OPTIONS = (
    *("environment", "robot", "forces", "sensors", "policy", "behavior"),
    *("labels", "pretrained", "imitate", "laws", "randomization"),  # of collect and train
)
"""The options that name files."""

RECORDED = ("$schema", "command", "config", "copies", "sha256", "fingerprint", "people", "versions")
"""The keys of a config.yaml with what a run records; its options are in ``config``."""

LIMITS = {"episode": (0, 2**31), "completed": (0, 1), "timed_out": (0, 1), "seconds": (0, MAX_DURATION)}
"""Column of episodes.csv -> least and most; none of its cells is empty."""

TEXTS = "task", "environment", "robot"  # columns without numbers
CELLS = {"True": 1.0, "False": 0.0, "": math.nan}  # of episodes.csv


def rename_files(description: dict[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """A description with other files: ``names`` maps a file or folder to its new name."""
    return {field: rename(value, names) if field in OPTIONS else value for field, value in description.items()}


class SavedConfig(NamedTuple):
    """The content of a config.yaml."""

    description: dict[str, Any]  # field -> value, for ``RunConfig``
    identities: dict[str, str]  # file or folder of the description -> digests of its content
    fingerprint: str  # of the scenario and the policy; "" if the file has none
    versions: dict[str, str]  # package -> version; {} if the file has none
    is_run: bool  # whether `sean run` wrote the file


def read_config(path: Path, check: bool = True) -> SavedConfig:
    """The content of a config.yaml; its description names the copies of files that have one.

    Args:
        check: refuse changed files, as a run must.

    Raises:
        InputError: the file cannot be used, or a file that it names has changed.
    """
    _, content = files.read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no description; write key: value lines, such as people: 8.")
    if "made by" in content:
        raise InputError(f"{path}: was made by {content['made by']}; put the parts into separate files.")
    if "command" in content and "config" not in content:
        raise InputError(f"{path}: records a command and is no file of options; repeat that command.")
    saved = content.get("config", {name: value for name, value in content.items() if name != "$schema"})
    if not isinstance(saved, dict):
        raise InputError(f"{path}: config: holds no description; give field: value lines.")
    for key in content:
        if check and "config" in content and key not in RECORDED:
            raise InputError(f"{path}: {key}: stands beside config, where nothing reads it; write it into config.")

    hashes = _texts(path, content, "sha256", "digest")
    copies = _texts(path, content, "copies", "copy")
    code = {name: digest for name, digest in hashes.items() if name.endswith(".py")}
    if check:
        _check_files(path, {name: digest for name, digest in hashes.items() if name not in code})
    description = user_parts.recorded(path, saved, code if check else None, "sha256")
    description = rename_files(description, _beside(path, description))
    description = rename_files(description, {name: str(path.parent / copy) for name, copy in copies.items()})
    versions = content.get("versions")
    return SavedConfig(
        description=description,
        identities=_identities(path.parent, code, copies, hashes),
        fingerprint=str(content.get("fingerprint", "")),
        versions=versions if isinstance(versions, dict) else {},
        is_run=str(content.get("command", "")).startswith("sean run "),
    )


def _beside(path: Path, description: Mapping[str, Any]) -> dict[str, str]:
    """Relative path in a description -> its path from here, of what lies beside the file; others are from here."""
    found = dict[str, str]()
    for field in OPTIONS:
        for text in texts(description.get(field)):
            for name in listed(text):
                is_path = "/" in name or Path(name).suffix  # else a name of the package
                if is_path and os.path.exists(path.parent / name):
                    found[name] = str(path.parent / name)
    return found


def _check_files(path: Path, hashes: Mapping[str, str]) -> None:
    """Refuse files that are not as a config.yaml says."""
    for name, digest in hashes.items():
        file = path.parent / name
        if not os.path.exists(file):
            raise InputError(f"{path}: {file} is missing; restore it, and keep {path.name} in the folder of its run.")
        if user_parts.digest(file, MAX_FILE) != digest:
            raise InputError(
                f"{file}: is not the file that the run was made with; "
                f"restore it, or remove its line under sha256 in {path.name} to accept it."
            )


def _identities(
    folder: Path, code: Mapping[str, str], copies: Mapping[str, str], hashes: Mapping[str, str]
) -> dict[str, str]:
    """File or folder of a description -> digests of its content."""
    identities = {}
    for name, digest in code.items():
        file = folder / name
        identities[str(file)] = user_parts.content(file).digest if file.is_file() else digest
    for copy in copies.values():
        parts = (f"{name} {digest}" for name, digest in hashes.items() if name.startswith(copy))
        identities[str(folder / copy)] = " ".join(parts)
    return identities


def _texts(path: Path, content: dict[str, Any], key: str, value: str) -> dict[str, str]:
    """The lines under a key of a config.yaml."""
    lines = content.get(key) or {}
    if not isinstance(lines, dict) or not all(isinstance(text, str) for pair in lines.items() for text in pair):
        raise InputError(f"{path}: {key}: {lines!r:.60} is no list of files; give file: {value} lines, or none.")
    return lines


def read_episodes(path: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """The E tasks of an episodes.csv, and its columns (E,) of numbers, NaN for an empty cell; without its floors.

    Of a team there is a row for each robot, in the order of the team.

    Raises:
        FileError: the file cannot be read, its episodes do not count from 0, or a value is out of range.
    """
    rows = files.read_rows(path)
    name = files.short_name(path)
    head = next(rows, [])
    for column in ("episode", "task", "completed", "seconds"):
        if column not in head:
            raise FileError(f"{name}: has no column {column}; restore the file.")

    texts: dict[str, list[str]] = {column: [] for column in head if column in TEXTS}
    numbers = {column: array.array("d") for column in head if column not in TEXTS}
    limits = {column: _limits(column) for column in numbers}
    for index, row in enumerate(rows):
        for column, cell in zip(head, row, strict=True):
            if column in TEXTS:
                texts[column].append(cell)
            else:
                numbers[column].append(_checked_number(cell, column, limits[column], f"{name}: episode {index}"))
        if "robot" not in head and numbers["episode"][-1] != index:
            raise FileError(f"{name}: episode {index} is missing; restore the file.")

    if not texts["task"]:
        raise FileError(f"{name}: holds no episode; run it again.")
    columns = {column: np.array(values) for column, values in numbers.items()}
    episodes = columns.pop("episode")
    team = list(dict.fromkeys(texts.get("robot", ())))
    rows_of_team = np.arange(len(episodes)) // max(len(team), 1)
    if team and (len(episodes) % len(team) or not np.array_equal(episodes, rows_of_team)):
        raise FileError(f"{name}: its episodes do not have a row for each of {', '.join(team)}; restore the file.")
    return texts["task"], columns


def _checked_number(cell: str, column: str, limits: tuple[float, float], where: str) -> float:
    """The number of a cell, NaN for an empty one."""
    low, high = limits
    value = _number(cell)
    if not (low <= value <= high or (cell == "" and column not in LIMITS)):
        raise FileError(f"{where}: {column}: {cell[:40]!r} is no number from {low:,g} to {high:,g}; restore the file.")
    return value


def _limits(name: str) -> tuple[float, float]:
    metric = METRICS.get(name.partition("__")[0])
    of_kind = {"count": (0.0, MAX_MAGNITUDE), "share": (0.0, 1.0)}
    return LIMITS.get(name) or of_kind.get(metric.kind if metric else "", (-MAX_MAGNITUDE, MAX_MAGNITUDE))


def _number(cell: str) -> float:
    try:
        return CELLS[cell] if cell in CELLS else float(cell.replace("_", "no"))
    except ValueError:
        return math.inf

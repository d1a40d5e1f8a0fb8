"""Files of the finished parts of an experiment, which a later run of the same command reads."""

import json
from pathlib import Path
from typing import Any

from sean_jax import components, files, writing
from sean_jax.config import BenchmarkConfig, ExperimentConfig, present_names
from sean_jax.errors import FileError, InputError
from sean_jax.flags import flag
from sean_jax.versions import version_mismatch, versions

OPTIONS = "experiment.json"


def has_started(options: ExperimentConfig | BenchmarkConfig) -> bool:
    """Whether the folder holds the beginning of this experiment, made with the same versions of packages.

    Returns:
        False if the folder is new or empty.

    Raises:
        InputError: the folder holds another experiment, results of other versions, or other files.
    """
    folder, current = options.folder, options.identity()
    if (folder / OPTIONS).is_file():
        try:
            content = files.read_json(folder / OPTIONS)
            previous, previous_versions = present_names(content["options"]), content.get("versions")
            had = content.get("parts", {})
            if not (isinstance(previous, dict) and isinstance(had, dict)):
                raise TypeError
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(f"{folder / OPTIONS} is damaged; choose another folder with --out.") from None
        for name in current:
            if current[name] != previous.get(name):
                text = f"{flag(name)} {previous.get(name)}, not {current[name]}"
                raise InputError(f"{folder} was begun with {text}; ask for the same or choose another --out.")
        for name, digest in components.digests(options).items():
            if had.get(name, digest) != digest:
                raise InputError(f"{folder} was begun with another {name}; restore it, or choose another --out.")
        if (other := version_mismatch(previous_versions)) is not None:
            raise InputError(f"{folder} was begun with {other}; go on with the same, or choose another --out.")
        return True
    if writing.contents(folder):
        raise InputError(f"the folder {folder} holds something else already, choose another with --out.")
    return False


def start(options: ExperimentConfig | BenchmarkConfig) -> None:
    """Write the options into a new folder; a folder that holds this experiment stays as it is.

    Args:
        options: of the experiment; the caller holds the lock of its folder.

    Raises:
        InputError: the folder holds another experiment, results of other versions, or other files.
    """
    content = load(options.folder / OPTIONS) if has_started(options) else None
    about = content or {"options": options.identity(), "versions": versions()}
    about = about | {"parts": about.get("parts", {}) | components.digests(options)}  # drivers can be added later
    if about != content:
        save(options.folder / OPTIONS, about)


def save(path: Path, content: Any) -> None:
    """Write a file.

    Args:
        content: text, or anything that JSON has.

    Raises:
        WriteError: another process writes the file.
    """
    text = content if isinstance(content, str) else json.dumps(content, indent=1, allow_nan=False) + "\n"
    writing.write(path, text)


def load(path: Path) -> Any:
    """Read a JSON file.

    Returns:
        Its content, or None if there is no such file or it is damaged.
    """
    try:
        return files.read_json(path)
    except FileError:
        return None

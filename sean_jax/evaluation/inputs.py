"""The files that a run's description names, but for Python: read when it begins, and kept beside its config.yaml.

An environment, a robot, forces and sensors are copied. A recording may be large and stays where it is, as the folder of
a policy does: the description has their absolute paths.
"""

import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from sean_jax import components, environment, files
from sean_jax.config import Named, PlaybackBehavior, RunConfig
from sean_jax.files import mjcf
from sean_jax.learning.policy import AGENTS
from sean_jax.policies import POLICIES
from sean_jax.robots import ROBOTS

MAX_COPY = 10_000_000  # bytes of an environment's or a robot's files; more stay where they are
MAX_FILE = 100_000_000  # bytes of a file, such as a recording
ENDINGS = (".yaml", ".yml")  # of forces and sensors in a file
COPIED = ("environment", "robot", "forces", "sensors")  # options whose files are copied
OPTIONS = (*COPIED, "policy", "behavior")  # that name files


class Inputs(NamedTuple):
    """What a run was made with, as it was when the run began."""

    content: dict[str, bytes]  # file in the run's folder -> its bytes
    copies: dict[str, str]  # file or folder as the description names it -> its copy in the run's folder
    hashes: dict[str, str]  # absolute path of a file without a copy -> SHA-256
    description: dict[str, Any]  # field -> value, with absolute paths
    fingerprint: str = ""  # of the scenario and the policy

    def write(self, folder: Path) -> dict[str, str]:
        """Write the copies.

        Returns:
            File -> SHA-256, of the copies by their path in the folder.
        """
        for name, content in self.content.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return {name: hashlib.sha256(content).hexdigest() for name, content in self.content.items()} | self.hashes


def read(config: RunConfig) -> Inputs:
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
        found = {part: files.read_bytes(part, MAX_FILE) for part in sources}
        small = sum(map(len, found.values())) <= MAX_COPY and all(part.is_relative_to(root) for part in found)
        if option not in COPIED or not small:
            hashes |= {str(part): hashlib.sha256(data).hexdigest() for part, data in found.items()}
            continue
        number = sum(copy.startswith(option) for copy in copies.values())
        place = f"{option}_{number + 1}" if number else option
        copies[names[name]] = f"{place}/{path.name}"
        inside = copies[names[name]] if path.is_dir() else place
        content |= {f"{inside}/{part.relative_to(root).as_posix()}": data for part, data in found.items()}
    description = config.identity() | {name: getattr(config, name) for name in ("camera", "renderer")}
    return Inputs(content, copies, hashes, rename(description, names))


def rename(description: dict[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """A description with files elsewhere.

    Args:
        names: file or folder as it is named there -> its new name.

    Returns:
        The same with the new names.
    """

    def renamed(value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [renamed(each) for each in value]
        if isinstance(value, Mapping):
            return {key: renamed(each) for key, each in value.items()}
        return names.get(value, value) if isinstance(value, str) else value

    return {field: renamed(value) if field in OPTIONS else value for field, value in description.items()}


def locate(copies: Mapping[str, str], hashes: Mapping[str, str], folder: Path) -> tuple[dict[str, str], list[str]]:
    """Where the files of a run are to be read: where they were if they are as they were, else from its copies.

    Args:
        copies: as of ``Inputs``.
        hashes: file -> SHA-256.

    Returns:
        File or folder as the description names it -> the copy that is read in its stead; and a sentence on each that
        has changed since the run.
    """
    names, sentences = {}, []
    for name, copy in copies.items():
        option = copy.partition("/")[0].partition("_")[0]
        inside = f"{copy}/" if option == "environment" else f"{Path(copy).parent.as_posix()}/"
        then = {part.removeprefix(inside): value for part, value in hashes.items() if part.startswith(inside)}
        try:
            path = environment.find(name) if option == "environment" else Path(name)
            root, sources = _sources(option, path)
            now = {part.relative_to(root).as_posix(): components.digest(part, MAX_FILE) for part in sources}
        except (ValueError, OSError):  # it is not here, or is another thing now
            now = {}
        if now != then:
            names[name] = str(folder / copy)
        if now and now != then:
            other = ", ".join(sorted(part for part in now.keys() | then.keys() if now.get(part) != then.get(part)))
            sentences.append(f"{option}: {name} is not as it was in the run ({other}); the copy in {folder} is used.")
    return names, sentences


def _named(config: RunConfig) -> Iterator[tuple[str, str, Path]]:
    """Option, name and path of each file and folder of a description."""
    yield "environment", config.environment, environment.find(config.environment)
    if isinstance(config.robot, Named) and config.robot.kind not in ROBOTS:
        yield "robot", config.robot.kind, Path(config.robot.kind)
    for option, parts in (("forces", config.forces), ("sensors", config.sensors)):
        for part in parts:
            if isinstance(part, Named) and part.kind.lower().endswith(ENDINGS):
                yield option, part.kind, Path(part.kind)
    policy, behavior = config.policy, config.behavior
    if isinstance(policy, Named) and policy.kind not in POLICIES and policy.kind not in AGENTS:
        yield "policy", policy.kind, Path(policy.kind)
    if isinstance(behavior, PlaybackBehavior) and behavior.recording is not None:
        yield "behavior", behavior.recording, Path(behavior.recording)


def _sources(option: str, path: Path) -> tuple[Path, list[Path]]:
    """The folder of a file or folder, and the files that are read for it; those of a policy the fingerprint tells."""
    if option == "environment":
        sources = environment.sources(path)
    elif option == "robot":
        sources = [path, *mjcf.sources(path)]
    else:
        sources = [] if option == "policy" else [path]
    root = path if path.is_dir() else path.parent
    return Path(os.path.abspath(root)), [Path(os.path.abspath(part)) for part in sources]

"""The folder of a long command: its identity, its lock, and its finished parts, which are not computed again."""

import contextlib
import dataclasses
import json
import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from sean_jax.config import Config, user_parts
from sean_jax.config.flags import flag, number
from sean_jax.core.errors import FileError, InputError
from sean_jax.io import files, writing
from sean_jax.io.versions import versions

IDENTITY = "experiment.json"  # of an experiment
CURE = "ask for the same or choose another --out."
REMAKE = "remove it, and the same command makes it anew"
VERSION, CONTENT = "the version of ", "the content of "
LABELS = {"options": flag, "versions": VERSION.__add__, "parts": CONTENT.__add__}
"""Section of an identity -> how messages call its entries."""


@dataclasses.dataclass(frozen=True)
class Workspace:
    """A folder that a long command fills part by part, and that the same command resumes.

    The identity holds everything that affects the results, as JSON values: the sections ``options`` (field -> value),
    ``versions`` (package -> version) and ``parts`` (file of the user's own -> SHA-256), and single values by name.
    """

    folder: Path
    identity: dict[str, Any]
    file: str = IDENTITY  # in the folder

    def begun(self) -> bool:
        """Whether the folder holds the beginning of this command; False if it is new or empty.

        Raises:
            InputError: the folder holds another command's results, results of other versions, or other files.
        """
        had = read_identity(self.folder / self.file)
        if had is None:
            refuse_others(self.folder)
            return False
        refuse_difference(self.folder, had, self.identity)
        return True

    def begin(self) -> None:
        """Write the identity, with the digests of own files that were added later; the caller holds the lock.

        Raises:
            InputError: as of ``begun``.
        """
        had = read_identity(self.folder / self.file) if self.begun() else {}
        parts = {**(had or {}).get("parts", {}), **self.identity.get("parts", {})}
        now = {**self.identity, **(had or {}), "parts": parts}
        if now != had:
            (self.folder / self.file).parent.mkdir(exist_ok=True)
            writing.write(self.folder / self.file, now)

    @contextlib.contextmanager
    def open(self) -> Iterator["Workspace"]:
        """The folder, checked and locked until the block ends. Nothing is written before ``begin``.

        Raises:
            InputError: as of ``begun``.
            WriteError: another process writes in the folder, or it cannot be written.
        """
        self.begun()
        with writing.folder_lock(self.folder):
            self.begun()
            yield self

    def load(self, part: str) -> Any:
        """A finished part: the content of a JSON file, the arrays of a .npz file; None if there is none.

        Raises:
            FileError: the file is damaged.
        """
        file = self.folder / part
        if not os.path.lexists(file):
            return None
        if file.suffix == ".npz":
            return files.read_arrays(file)
        try:
            return files.read_json(file)
        except FileError as error:
            raise FileError(f"{str(error).rstrip('.')}; {REMAKE}.") from None

    def save(self, part: str, content: Any) -> None:
        """Write a part, whole or not at all: text, JSON values, or arrays by name for a .npz file.

        Raises:
            WriteError: another process writes the file.
        """
        if part.endswith(".npz"):
            writing.write_arrays(self.folder / part, content)
        else:
            writing.write(self.folder / part, content)


def identity(options: Config) -> dict[str, Any]:
    """The identity of a command: its options, the versions and the digests of the user's own files."""
    return {"options": options.identity(), "versions": versions(), "parts": user_parts.digests(options)}


def read_identity(file: Path) -> dict[str, Any] | None:
    """The content of an identity file; None if there is none.

    Raises:
        InputError: the file is damaged.
    """
    try:
        content = files.read_json(file)
    except FileError as error:
        if not os.path.lexists(file):
            return None
        raise InputError(f"{file} is damaged ({str(error).rstrip('.')}); choose another folder with --out.") from None
    if not isinstance(content, dict) or any(not isinstance(content.get(name, {}), dict) for name in LABELS):
        raise InputError(f"{file} is damaged; choose another folder with --out.")
    return content


def difference(had: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """The first difference of two identities, such as "with --seed 0, not 1" or "with another my.py"; None if equal.

    Only what ``now`` names is compared. Versions and own files that ``had`` lacks may be added.
    """
    before = _entries(had)
    addable = _entries({name: now.get(name, {}) for name in ("versions", "parts")})
    for name, value in _entries(now).items():
        if before.get(name) == value or (name in addable and name not in before):
            continue
        if name not in before:
            return f"without {name}"
        if name.startswith(CONTENT) or (isinstance(value, dict | list) and not name.startswith("--")):
            return f"with another {name.removeprefix(CONTENT)}"
        return f"with {name.removeprefix(VERSION)} {value_text(before[name])}, not {value_text(value)}"
    return None


def _entries(content: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of all sections, by the names that messages use; values are as JSON gives them back."""
    entries: dict[str, Any] = {}
    for name, value in content.items():
        entries |= {LABELS[name](key): each for key, each in value.items()} if name in LABELS else {name: value}
    return json.loads(json.dumps(entries))


def value_text(value: Any) -> str:
    """A value of a description as messages show it, such as "graph --routing edge"."""
    if isinstance(value, dict):
        rest = " ".join(f"{flag(name)} {value_text(each)}" for name, each in value.items() if name != "kind")
        return f"{value.get('kind', '')} {rest}".strip()
    if isinstance(value, bool):
        return "on" if value else "off"
    each = value if isinstance(value, list | tuple) else [value]
    return " ".join(value_text(one) if isinstance(one, dict) else number(one) for one in each)


def refuse_difference(folder: Path, had: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse to resume a folder that was begun with another identity.

    Raises:
        InputError: the first difference and the cure.
    """
    if (text := difference(had, now)) is not None:
        raise InputError(f"{folder} was begun {text}; {CURE}")


def refuse_others(folder: Path, names: Collection[str] = ()) -> None:
    """Refuse a folder that holds anything but these names.

    Raises:
        InputError: it does.
    """
    if not set(writing.contents(folder)) <= set(names):
        raise InputError(f"the folder {folder} holds something else already, choose another with --out.")

"""The files that a description names, and their copies in the folder of a result.

Copies are written as they were read, before anything ran. A file that is too large stays where it is, with its SHA-256.
"""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from sean_jax.config.components import is_own_part
from sean_jax.io import writing


class InputFiles(NamedTuple):
    """The files of a description, as they were read."""

    content: dict[str, bytes]  # path in the folder of the result -> bytes
    copies: dict[str, str]  # file or folder, as the description names it -> its copy in that folder
    hashes: dict[str, str]  # absolute path of a file without a copy -> SHA-256

    @property
    def digests(self) -> dict[str, str]:
        """File with a copy, as the description names it -> SHA-256."""
        return {name: sha256(self.content[copy]) for name, copy in self.copies.items()}

    def bundle(self, folder: Path) -> dict[str, str]:
        """Write the copies into the folder of a result; path in the folder, or absolute path -> SHA-256."""
        for name, content in self.content.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            writing.write(folder / name, content)
        return {name: sha256(content) for name, content in self.content.items()} | self.hashes

    def describe(self, description: Any) -> Any:
        """A description by the names of the copies."""
        return rename(description, self.copies)


def sha256(content: bytes) -> str:
    """SHA-256, as 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def rename(value: Any, names: Mapping[str, str]) -> Any:
    """A value of a description with other files: ``names`` maps a file or folder to its new name."""
    if isinstance(value, list | tuple):
        return [rename(each, names) for each in value]
    if isinstance(value, Mapping):
        return {key: rename(each, names) for key, each in value.items()}
    if not isinstance(value, str) or value in names:
        return names.get(value, value)
    if is_own_part(value):
        file, _, name = value.rpartition(":")
        return f"{names.get(file, file)}:{name}"
    return ",".join(names.get(part, part) for part in value.split(","))  # of several robots


def texts(value: Any) -> Iterator[str]:
    """The texts in a value of a description, at any depth."""
    if isinstance(value, str):
        yield value
    values = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    for each in values:
        yield from texts(each)

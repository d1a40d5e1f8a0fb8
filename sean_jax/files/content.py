"""The content of files that somebody else wrote: regular files of bounded size, read whole, as bytes, text or JSON.

Every reader of the package opens its files here. A folder, a pipe or a device is refused and not waited for, and what
is too large for its kind is refused before there is memory for it.
"""

import difflib
import json
import os
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any

MOST = 2_000_000  # bytes of a file that people write, unless its reader says otherwise
DEEPEST = 60  # values within values


class FileError(ValueError):
    """A file that cannot be used; the message names file, place, value and cure, one line an error."""


def suggest(word: str, choices: Iterable[str]) -> str:
    """``; did you mean 'x'?`` for the choice most like the word, or nothing if none is like it."""
    choices = [str(choice) for choice in choices]
    lower = {choice.lower(): choice for choice in choices}
    found = difflib.get_close_matches(str(word).lower()[:100], lower, n=1, cutoff=0.6)
    return f"; did you mean '{lower[found[0]]}'?" if found else ""


def shown(path: Path) -> str:
    """A file's name as messages give it: with the folder that it lies in."""
    return "/".join(part for part in (path.parent.name, path.name) if part)


def content(path: Path | str, most: int = MOST) -> bytes:
    """The bytes of a regular file of at most ``most`` bytes. Raises FileError."""
    path = Path(path)
    try:
        # Without O_NONBLOCK a pipe would be waited for until somebody writes.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(descriptor, "rb") as stream:
            about = os.fstat(descriptor)
            if not stat.S_ISREG(about.st_mode):
                raise FileError(f"{path}: cannot be read: it is {_kind(about.st_mode)}; give a file.")
            found = stream.read(most + 1) if about.st_size <= most else b""
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file{_neighbour(path)}") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}.") from None
    except ValueError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"{str(path)!r}: cannot be the name of a file: {error}.") from None
    if about.st_size > most or len(found) > most:
        size = max(about.st_size, len(found))
        raise FileError(f"{shown(path)}: has {size:,} bytes and at most {most:,} are read; make it smaller.")
    return found


def text(path: Path | str, most: int = MOST) -> str:
    """The text of a UTF-8 file of at most ``most`` bytes, without a byte-order mark. Raises FileError."""
    path = Path(path)
    found = content(path, most)
    try:
        return found.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = found.count(b"\n", 0, error.start) + 1
        raise FileError(
            f"{shown(path)}:{line}: byte {error.start} is not UTF-8 text; save the file as UTF-8."
        ) from None


def read_json(path: Path | str, most: int = 100 * MOST) -> Any:
    """The values of a JSON file; NaN and infinities are not JSON. Raises FileError."""
    path = Path(path)
    found = text(path, most)

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    try:
        return json.loads(found, parse_constant=refuse)
    except json.JSONDecodeError as error:
        place = f"{shown(path)}:{error.lineno}:{error.colno}"
        raise FileError(f"{place}: is not JSON: {error.msg[:1].lower()}{error.msg[1:]}.") from None
    except RecursionError:
        raise FileError(f"{shown(path)}: is nested too deeply; it was not written by this program.") from None
    except ValueError as error:
        raise FileError(f"{shown(path)}: cannot be used: {error}.") from None


def _kind(mode: int) -> str:
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
    return kinds.get(stat.S_IFMT(mode), "no regular file")


def _neighbour(path: Path) -> str:
    """The suggestion of a file beside a missing one, or a full stop."""
    try:
        return suggest(path.name, (item.name for item in path.parent.iterdir())) or "."
    except OSError:
        return "; its folder does not exist either."

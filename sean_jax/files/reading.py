"""Reading of files from outside the package: regular files of bounded size, as bytes, text or JSON.

Every reader of the package opens its files here. Folders, pipes and devices are refused without waiting for them, and
a file that is too large for its kind is refused before memory is used for it.
"""

import difflib
import io
import json
import os
import stat
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sean_jax.errors import FileError

MAX_BYTES = 2_000_000  # of a file that people write; readers of other files give another bound
MAX_DEPTH = 60  # of values within values


def listed(text: str | None) -> list[str]:
    """The names in a text.

    Args:
        text: names separated by commas; None has none.

    Returns:
        The names in order, without space around them.
    """
    return [name.strip() for name in (text or "").split(",") if name.strip()]


def suggest(word: str, choices: Iterable[str]) -> str:
    """The end of a message about an unknown name.

    Args:
        word: the unknown name.
        choices: the names that there are.

    Returns:
        "; did you mean 'x'?" with the choice most like the word, or nothing if none is like it.
    """
    choices = [str(choice) for choice in choices]
    lower = {choice.lower(): choice for choice in choices}
    close = difflib.get_close_matches(str(word).lower()[:100], lower, n=1, cutoff=0.6)
    return f"; did you mean '{lower[close[0]]}'?" if close else ""


def unknown_name(option: str, name: str, choices: Iterable[str]) -> str:
    """The message about an unknown name.

    Args:
        option: that the name was given for.
        name: the unknown name.
        choices: the names that there are.

    Returns:
        A sentence that names the option, the name and the choices, with a suggestion if a choice is like it.
    """
    choices = list(choices)
    return f"{option}: '{name}' is not one of {', '.join(choices)}{suggest(name, choices) or '.'}"


def short_name(path: Path) -> str:
    """A file's name as messages give it.

    Args:
        path: of the file.

    Returns:
        Its name and that of its folder.
    """
    return "/".join(part for part in (path.parent.name, path.name) if part)


def read_bytes(path: Path | str, max_bytes: int = MAX_BYTES) -> bytes:
    """Read a regular file.

    Args:
        path: of the file.
        max_bytes: that it may have.

    Returns:
        Its bytes.

    Raises:
        FileError: there is no such file, or it cannot be read, or is too large.
    """
    path = Path(path)
    try:
        # Without O_NONBLOCK a pipe would be waited for until somebody writes.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(descriptor, "rb") as stream:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise FileError(f"{path}: cannot be read: it is {_kind(status.st_mode)}; give a file.")
            data = stream.read(max_bytes + 1) if status.st_size <= max_bytes else b""
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file{_similar_file(path)}") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}.") from None
    except ValueError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"{str(path)!r}: cannot be the name of a file: {error}.") from None
    if status.st_size > max_bytes or len(data) > max_bytes:
        size = max(status.st_size, len(data))
        what = f"has {size:,} bytes and at most {max_bytes:,} are read"
        raise FileError(f"{short_name(path)}: {what}; make it smaller.")
    return data


def read_text(path: Path | str, max_bytes: int = MAX_BYTES) -> str:
    """Read a UTF-8 file.

    Args:
        path: of the file.
        max_bytes: that it may have.

    Returns:
        Its text, without a byte-order mark.

    Raises:
        FileError: there is no such file, or it cannot be read, is too large, or is not UTF-8.
    """
    path = Path(path)
    data = read_bytes(path, max_bytes)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise FileError(
            f"{short_name(path)}:{line}: byte {error.start} is not UTF-8 text; save the file as UTF-8."
        ) from None


def read_json(path: Path | str, max_bytes: int = 100 * MAX_BYTES) -> Any:
    """Read a JSON file; NaN and infinities are not JSON.

    Args:
        path: of the file.
        max_bytes: that it may have.

    Returns:
        Its values.

    Raises:
        FileError: there is no such file, or it cannot be read, is too large, or is not JSON.
    """
    path = Path(path)
    text = read_text(path, max_bytes)

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    try:
        return json.loads(text, parse_constant=refuse)
    except json.JSONDecodeError as error:
        place = f"{short_name(path)}:{error.lineno}:{error.colno}"
        raise FileError(f"{place}: is not JSON: {error.msg[:1].lower()}{error.msg[1:]}.") from None
    except RecursionError:
        raise FileError(f"{short_name(path)}: is nested too deeply; it was not written by this program.") from None
    except ValueError as error:
        raise FileError(f"{short_name(path)}: cannot be used: {error}.") from None


def _kind(mode: int) -> str:
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
    return kinds.get(stat.S_IFMT(mode), "no regular file")


def _similar_file(path: Path) -> str:
    """The suggestion of a file in the folder of a missing one, or a full stop."""
    try:
        return suggest(path.name, (item.name for item in path.parent.iterdir())) or "."
    except OSError:
        return "; its folder does not exist either."


def read_arrays(path: Path | str, max_bytes: int) -> dict[str, Any]:
    """Read a .npz file of numbers.

    Args:
        path: of the file.
        max_bytes: that it may have, and may unpack to.

    Returns:
        Name to array of numpy.

    Raises:
        FileError: there is no such file, or it cannot be read, is too large, or is damaged.
    """
    import numpy as np  # here, as the command line reads its options without it

    path = Path(path)
    stream = io.BytesIO(read_bytes(path, max_bytes))
    try:
        size = sum(part.file_size for part in zipfile.ZipFile(stream).infolist())
        if size > max_bytes:
            raise ValueError(f"it unpacks to {size:,} bytes and at most {max_bytes:,} are read")
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as opened:
            return {name: opened[name] for name in opened.files}
    except Exception as error:  # which one depends on the byte that is damaged
        why = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")[:200]
        raise FileError(f"{short_name(path)}: cannot be read: {why}; get the file anew.") from error

"""Reading of all files from outside the package: regular files of bounded size, as bytes, text, JSON, rows or arrays.

Folders, pipes and devices are refused without waiting for them, and a file that is too large for its kind is refused
before memory is used for it. Whatever another package raises about the content becomes a sentence.
"""

import contextlib
import csv
import io
import itertools
import json
import math
import os
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from sean_jax.core.errors import FileError, SeanError
from sean_jax.core.messages import parse_json, suggest

MAX_BYTES = 2_000_000  # of a file that people write
MAX_RECORD = 50_000_000  # of one text that this program writes: JSON, a log, a page
MAX_ARRAYS = 500_000_000  # of a .npz file of this program, packed and unpacked
MAX_TABLE = 10_000_000_000  # of a table with a row for each episode or frame, which is read row by row
MAX_LINE = 1_000_000  # characters of a line of a table


def short_name(path: Path) -> str:
    """A file's name in messages."""
    return "/".join(part for part in (path.parent.name, path.name) if part)


def file_error(path: Path | str, text: str, *place: Any) -> FileError:
    """The error about a file: ``text`` without a full stop, at a line and a column if these are known."""
    return FileError(f"{':'.join([short_name(Path(path)), *map(str, place)])}: {text}.")


@contextlib.contextmanager
def open_file(path: Path | str, max_bytes: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """A regular file of at most ``max_bytes``, open for reading; FileError if it is missing, unreadable or larger."""
    path = Path(path)
    with contextlib.ExitStack() as stack:
        try:
            # Without O_NONBLOCK opening a pipe would wait for a writer.
            descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                os.close(descriptor)
                raise FileError(f"{path}: cannot be read: it is {_kind(status.st_mode)}; give a file.")
            stream = stack.enter_context(open(descriptor, "rb"))
        except FileNotFoundError:
            raise FileError(f"{path}: there is no such file{_similar_file(path)}") from None
        except OSError as error:
            raise FileError(f"{path}: cannot be read: {error.strerror}.") from None
        except ValueError as error:
            if isinstance(error, FileError):
                raise
            raise FileError(f"{str(path)!r}: cannot be the name of a file: {error}.") from None
        if status.st_size > max_bytes:
            raise _too_large(path, status.st_size, max_bytes)
        yield stream


def read_bytes(path: Path | str, max_bytes: int = MAX_BYTES) -> bytes:
    """The content of a regular file of at most ``max_bytes``; FileError as in ``open_file``."""
    with open_file(path, max_bytes) as stream:
        try:
            data = stream.read(max_bytes + 1)
        except OSError as error:
            raise FileError(f"{path}: cannot be read: {error.strerror}.") from None
    if len(data) > max_bytes:  # of a file that grows, or of one of /proc
        raise _too_large(Path(path), len(data), max_bytes)
    return data


def _too_large(path: Path, size: int, max_bytes: int) -> FileError:
    return file_error(path, f"has {size:,} bytes and at most {max_bytes:,} are read; make it smaller")


@contextlib.contextmanager
def sentence(path: Path | str, cure: str) -> Iterator[None]:
    """Turn another package's errors about a file's content in this block into a ``FileError``.

    Args:
        cure: the end of the sentence, such as ``get it again``.
    """
    try:
        yield
    except SeanError:
        raise
    except OSError as error:
        if not error.strerror:
            raise file_error(path, f"cannot be read: it is damaged; {cure}") from error
        raise file_error(path, f"cannot be read: {error.strerror.lower()}; {cure}") from error
    except MemoryError as error:
        raise file_error(path, f"does not fit into memory; {cure}") from error
    except Exception as error:  # which one depends on the byte that is damaged
        raise file_error(path, f"is damaged; {cure}") from error


def read_text(path: Path | str, max_bytes: int = MAX_BYTES) -> str:
    """The text of a UTF-8 file, without a byte-order mark; FileError as in ``open_file``, or if it is not UTF-8."""
    path = Path(path)
    data = read_bytes(path, max_bytes)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise file_error(path, f"byte {error.start} is not UTF-8 text; save the file as UTF-8", line) from None


def read_json(path: Path | str, strict: bool = True) -> Any:
    """The content of a JSON file, without NaN and infinities; FileError if it cannot be read or is not JSON.

    Args:
        strict: words must not contain the ends of lines and other control characters.
    """
    path = Path(path)
    return parse_file_json(path, read_text(path, MAX_RECORD), strict)


def parse_file_json(path: Path | str, text: str, strict: bool = True) -> Any:
    """The value of a text of JSON, such as one line of a file; arguments and errors as of ``read_json``."""
    try:
        return parse_json(text, strict)
    except json.JSONDecodeError as error:
        text = f"is not JSON: {error.msg[:1].lower()}{error.msg[1:]}"
        raise file_error(path, text, error.lineno, error.colno) from None
    except ValueError as error:
        raise file_error(path, f"cannot be used: {error}") from None


def read_json_lines(path: Path | str, finite: bool = True, max_bytes: int = MAX_RECORD) -> Iterator[Any]:
    """The value of each line of JSON of a log that is only appended to; a last line without its end is left out.

    Args:
        finite: NaN and infinities are refused.

    Raises:
        FileError: the file cannot be read, or a line is not JSON.
    """
    path = Path(path)
    for number, text in enumerate(read_text(path, max_bytes).split("\n")[:-1], 1):
        try:
            yield parse_json(text, finite=finite)
        except ValueError:
            raise file_error(path, "is not JSON; restore the file", number) from None


def _kind(mode: int) -> str:
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
    return kinds.get(stat.S_IFMT(mode), "no regular file")


def _similar_file(path: Path) -> str:
    """The suggestion of a file in the folder of a missing one, or a full stop."""
    try:
        return suggest(path.name, (item.name for item in path.parent.iterdir())) or "."
    except OSError:
        return "; its folder does not exist either."


def read_rows(path: Path | str) -> Iterator[list[str]]:
    """The cells of each row of a CSV file, names of columns first; a first line with # comes before, as one cell.

    Raises:
        FileError: the file cannot be read, is too large, is no CSV, names a column twice, or has another number of
            cells in a row than columns.
    """
    path = Path(path)
    with open_file(path, MAX_TABLE) as stream:
        lines = _lines(path, io.TextIOWrapper(stream, "utf-8-sig", newline=""))
        first = next(lines, "")
        above = 0
        if first.startswith("#"):
            yield [first.rstrip("\r\n")]
            first = next(lines, "")
            above = 1
        reader = csv.reader(itertools.chain([first], lines), strict=True)
        head = None

        def wrong(text: str) -> FileError:
            return file_error(path, text, reader.line_num + above)

        try:
            for row in reader:
                if not row:
                    continue  # an empty line
                if head is None:
                    head = row
                    if len(set(row)) < len(row):
                        raise wrong("names a column twice; give each a name of its own")
                elif len(row) != len(head):
                    raise wrong(f"has {len(row)} cells and there are {len(head)} columns; restore the file")
                yield row
        except csv.Error as error:
            raise wrong(f"is no row of CSV ({error}); restore the file") from None


def _lines(path: Path, stream: io.TextIOWrapper) -> Iterator[str]:
    number = 0
    while True:
        number += 1
        try:
            line = stream.readline(MAX_LINE)
        except UnicodeDecodeError:
            raise file_error(path, "is not UTF-8 text; save the file as UTF-8", number) from None
        except OSError as error:
            raise FileError(f"{path}: cannot be read: {error.strerror}.") from None
        if len(line) == MAX_LINE:
            raise file_error(path, f"has more than {MAX_LINE:,} characters; restore the file", number)
        if not line:
            return
        yield line


def read_arrays(
    path: Path | str, max_bytes: int = MAX_ARRAYS, cure: str = "remove it, and the same command makes it anew"
) -> dict[str, Any]:
    """The arrays of a .npz file of numbers and words, of ``max_bytes`` at most, packed and unpacked.

    Args:
        cure: the end of the sentence if it is damaged.

    Raises:
        FileError: the file cannot be read, is too large, or is damaged.
    """
    import numpy as np  # here, as the command line reads its options without it

    path = Path(path)
    with open_file(path, max_bytes) as stream, sentence(path, cure), zipfile.ZipFile(stream) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
        if size > max_bytes:
            raise file_error(path, f"unpacks to {size:,} bytes and at most {max_bytes:,} are read; {cure}")
        arrays = {}
        for entry in archive.infolist():
            with archive.open(entry) as packed:
                _check_array(packed, entry.file_size)
            with archive.open(entry) as packed:
                name = entry.filename.removesuffix(".npy")
                arrays[name] = np.lib.format.read_array(packed, allow_pickle=False)
        return arrays


def _check_array(packed: Any, size: int) -> None:
    """ValueError unless an array has the size of its header, for which numpy allocates memory."""
    import numpy as np

    version = np.lib.format.read_magic(packed)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
    shape, _, dtype = read(packed)
    if dtype.kind not in "biufU" or not dtype.itemsize or math.prod(shape) * dtype.itemsize != size - packed.tell():
        raise ValueError(f"{shape} numbers of {dtype} are not what it holds")

"""Writing results: whole or not at all, and by one process at a time.

A file is written under another name and renamed. While a process works in a folder, the folder holds a ``.lock`` that
names the process; the kernel frees the lock however the process ends, so it is never stale. Readers write nothing.

The lock is ``flock``. On NFS it also holds between machines if the server runs its lock service, as version 4 does; the
lock of a machine that crashed is freed after the server's grace period. A file system without locks is refused.
"""

import contextlib
import datetime
import errno
import json
import os
import shutil
import socket
import stat
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from sean_jax.core.errors import IncompleteError, InputError, SeanError, WriteError

try:
    import fcntl
except ImportError:  # Windows, where folders are not locked
    fcntl = None

MAX_HOLDER = 200  # bytes of a lock that are shown
LOCK = ".lock"
DISK_FULL = "the disk is full"
LINK = "is a link or no regular file, through which nothing is written; remove it."
PATIENCE = 0.1  # s that a writer waits for processes that only look at a lock (``is_locked``)


@contextlib.contextmanager
def atomic_file(file: Path) -> Iterator[BinaryIO]:
    """A stream whose content becomes the file when the block ends; after an error or a kill the file is as before.

    Raises:
        WriteError: another process writes the file, or its temporary name is a link.
    """
    temporary = file.with_name(f".{file.name}.new")
    try:
        stream = os.fdopen(_lock(temporary), "r+b")
    except BlockingIOError:
        raise WriteError(f"{file} is being written by another process; try again when it is done.") from None
    with stream:
        try:
            stream.truncate()
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            os.replace(temporary, file)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    sync(file.parent)


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on disk for good."""
    if path.is_dir() and os.name != "posix":
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write(file: Path, content: Any) -> None:
    """Write a file, whole or not at all: text as UTF-8, bytes, or anything else as JSON, in which NaN is refused.

    Half a surrogate, which UTF-8 cannot hold, is written out as \\ud83d.

    Raises:
        WriteError: another process writes the file.
    """
    if not isinstance(content, str | bytes):
        content = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with atomic_file(file) as stream:
        stream.write(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def write_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as a compressed .npz file, whole or not at all.

    Raises:
        WriteError: another process writes the file.
    """
    import numpy as np

    with atomic_file(file) as stream:
        np.savez_compressed(stream, **arrays)  # pyright: ignore[reportArgumentType]


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Make and lock a folder, or the folder that a symbolic link leads to, until the block ends.

    If the folder is empty at the end, the new folders are removed.

    Raises:
        WriteError: another process holds the lock, or the folder cannot be written.
    """
    folder = Path(os.path.realpath(folder))
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise WriteError(f"{folder} is a file, give the name of a folder with --out.")
    missing = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    if os.path.isdir(folder) and _names(folder) == [LOCK]:
        missing = [folder]  # left by a process that was killed
    lock = folder / LOCK
    try:
        descriptor = None
        while descriptor is None:
            folder.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):  # another process removed the folder with its lock
                descriptor = _lock(lock)
    except BlockingIOError:
        raise WriteError(
            f"{folder} is being written by {_holder(lock)}; wait until it is done, or choose another folder with --out."
        ) from None
    except OSError as error:
        _remove_empty(missing)
        raise WriteError(f"cannot write {folder}: {reason(error)}; choose another folder with --out.") from error
    try:
        since = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %z")
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()} since {since}\n".encode())
        yield
    finally:
        with contextlib.suppress(OSError):
            lock.unlink()
        os.close(descriptor)
        _remove_empty(missing)


@contextlib.contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """A new folder that becomes ``folder`` when the block ends, or is removed if anything is raised.

    After a kill it lies in ``.NAME.unfinished`` until the next process that writes ``folder``.

    Raises:
        WriteError: ``folder`` is not empty, or cannot be written.
    """
    folder = Path(os.path.realpath(folder))
    unfinished = folder.with_name(f".{folder.name}.unfinished")
    if os.path.ismount(folder):
        raise WriteError(f"{folder} is a mount point, which no other folder can replace; give --out a folder in it.")
    if os.path.islink(unfinished):
        raise WriteError(f"{unfinished} {LINK}")
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise WriteError(f"{folder} is a file, give the name of a folder with --out.")
    try:
        with folder_lock(unfinished):
            _check_vacant(folder)
            whole = unfinished / "whole"
            shutil.rmtree(whole, ignore_errors=True)
            whole.mkdir()
            try:
                yield whole
                _check_vacant(folder, remove=True)
                whole.rename(folder)
            finally:
                shutil.rmtree(whole, ignore_errors=True)
    finally:
        with contextlib.suppress(OSError):
            unfinished.rmdir()


def contents(folder: Path) -> list[str]:
    """Sorted names in a folder without its lock and half-written files; none if there is no such folder."""
    return sorted(
        name for name in _names(folder) if name != LOCK and not (name.startswith(".") and name.endswith(".new"))
    )


def is_locked(folder: Path) -> bool:
    """Whether a process writes in the folder now; the folder may be missing. This writes nothing."""
    if fcntl is None:
        return False
    try:
        descriptor = os.open(folder / LOCK, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    except OSError:  # no lock, or no permission to read it
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        pass
    finally:
        os.close(descriptor)
    return False


@contextlib.contextmanager
def explain_errors(place: Path, rest: str, cause: Callable[[Exception], str] | None = None) -> Iterator[None]:
    """An error of the system or of a package in the block becomes an ``IncompleteError``.

    Args:
        place: the file or folder that the message names.
        rest: end of the message: what is left, or the cure.
        cause: the words for an error; ``reason`` if None.
    """
    try:
        yield
    except SeanError:
        raise
    except (OSError, ValueError) as error:
        raise IncompleteError(f"{place}: {(cause or reason)(error)}; {rest}") from error


def reason(error: Exception) -> str:
    """The cause of an error in one line: ``DISK_FULL``, also where a package wraps it, or the error's own words."""
    text = str(error).strip().split("\n")[0].rstrip(".")
    if getattr(error, "errno", None) == errno.ENOSPC or "No space left" in str(error):
        return DISK_FULL
    return (error.strerror or text).lower() if isinstance(error, OSError) else text[:200]


def broken(error: OSError) -> str:
    """The cause of an error in a few words, and its file in brackets."""
    return reason(error) + (f" ({error.filename})" if error.filename else "")


def _lock(file: Path) -> int:
    """An exclusively locked descriptor of a file, which is created if it is missing.

    Raises BlockingIOError if another process keeps the lock, WriteError for a link or anything but a regular file,
    through which another file would be overwritten, and OSError if the file cannot be opened.
    """
    if file.is_symlink():
        raise WriteError(f"{file} {LINK}")
    until = time.monotonic() + PATIENCE
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
                raise WriteError(f"{file} {LINK}")
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(status, file.lstat()):
                return descriptor
        except FileNotFoundError:
            pass  # another process renamed or removed it meanwhile
        except BlockingIOError:
            if time.monotonic() > until:
                os.close(descriptor)
                raise
            time.sleep(PATIENCE / 20)
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _check_vacant(folder: Path, remove: bool = False) -> None:
    """Refuse a folder that is not empty or is being written; ``remove`` deletes what a kill left there."""
    if not folder.is_dir():
        return
    with folder_lock(folder):
        if contents(folder):
            raise WriteError(f"the folder {folder} is not empty, choose another with --out.")
        if remove:
            shutil.rmtree(folder)


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []


def _holder(lock: Path) -> str:
    """Who holds a lock, as it says itself; whatever another program wrote there is shown, and not believed."""
    try:
        with lock.open("rb") as stream:
            text = stream.read(MAX_HOLDER).decode("utf-8", "replace")
    except OSError:
        return "another process"
    words = "".join(letter if letter.isprintable() else " " for letter in text)
    return " ".join(words.split()) or "another process"


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:  # the innermost first
        with contextlib.suppress(OSError):
            folder.rmdir()


def check_new_folder(folder: Path, option: str = "--out") -> None:
    """Refuse a path that is not a new or empty folder.

    Raises:
        InputError: the sentence names the option, the folder and the cure.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{option}: {folder} is a file or a device; give the name of a new folder.")
    if contents(folder):
        raise InputError(f"{option}: the folder {folder} is not empty; give the name of a new folder.")
    if folder.exists() and os.path.samefile(folder, "."):
        raise InputError(f"{option}: {folder} is the folder that you are in; give the name of a new folder.")


def check_file(path: Path, suffixes: Collection[str], option: str = "--out") -> None:
    """Refuse a file that cannot be written, or whose suffix is not one of these; an existing file is replaced.

    Raises:
        InputError: the sentence names the option, the file and the cure.
    """
    if path.is_dir():
        raise InputError(f"{option}: {path} is a folder; give the name of a file, such as {path / 'picture.png'}.")
    if path.exists() and not path.is_file():
        raise InputError(f"{option}: {path} is a device or a pipe; give the name of a file, such as picture.png.")
    if not path.suffix and "" not in suffixes:
        raise InputError(f"{option}: {path} has no ending, but must end in one of {', '.join(suffixes)}.")
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{option}: {path} ends in {path.suffix}, but must end in one of {', '.join(suffixes)}.")
    if not path.parent.is_dir():
        raise InputError(f"{option}: there is no folder {path.parent} to write {path.name} to; make it first.")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"{option}: {path} cannot be written: permission denied; choose another place.")

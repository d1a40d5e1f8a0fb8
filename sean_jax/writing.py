"""Writing results: whole or not at all, and by one process at a time.

A file is written under another name and renamed. A folder that is worked in holds a ``.lock`` meanwhile, which says by
whom; the kernel frees it however its process ends, so it is never stale. Readers write nothing, and hold no lock for
longer than a look.
"""

import contextlib
import datetime
import errno
import os
import shutil
import socket
import struct
import time
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

try:
    import fcntl
except ImportError:  # Windows, where folders are not locked
    fcntl = None

LOCK = ".lock"
PATIENCE = 0.1  # s, for which one who wants to write waits for those who look
DAMAGED = (
    OSError, ValueError, LookupError, TypeError, EOFError, OverflowError, MemoryError, RuntimeError, SyntaxError,
    struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""what numpy raises for a .npz file that is damaged, whichever of its bytes it is"""


class Unwritable(ValueError):
    """A place cannot be written; the message is one sentence that says why and what to do."""


@contextlib.contextmanager
def whole(file: Path) -> Iterator[BinaryIO]:
    """A stream; when the block ends, what was written there is the file, for good.

    If anything is raised or this is killed, the file is as it was. Raises Unwritable if another process writes it.
    """
    temporary = file.with_name(f".{file.name}.new")
    try:
        stream = os.fdopen(_alone(temporary), "r+b")
    except BlockingIOError:
        raise Unwritable(f"{file} is being written by another process; try again when it is done.") from None
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
    if os.name == "posix":
        folder = os.open(file.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)


def write(file: Path, content: str | bytes) -> None:
    """The file is as it was or new, whenever this is interrupted, and new for good when it returns."""
    with whole(file) as stream:
        stream.write(content.encode("utf-8") if isinstance(content, str) else content)


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Until the block ends the folder, which is made if need be, is written by nobody else.

    If it is empty then, what was made for it vanishes again. Raises Unwritable, which says who holds it or why it
    cannot be written.
    """
    folder = Path(os.path.abspath(folder))
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise Unwritable(f"{folder} is a file, give the name of a folder with --out.")
    made = [each for each in (folder, *folder.parents) if not os.path.exists(each)]
    if os.path.isdir(folder) and _names(folder) == [LOCK]:
        made = [folder]  # all that is left of one who was killed
    lock = folder / LOCK
    try:
        descriptor = None
        while descriptor is None:
            folder.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):  # the folder vanished with who held it
                descriptor = _alone(lock)
    except BlockingIOError:
        raise Unwritable(
            f"{folder} is being written by {_holder(lock)}; wait until it is done, or choose another folder with --out."
        ) from None
    except OSError as error:
        _remove_empty(made)
        raise Unwritable(f"cannot write {folder}: {reason(error)}; choose another folder with --out.") from error
    try:
        since = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %z")
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()} since {since}\n".encode())
        yield
    finally:
        with contextlib.suppress(OSError):
            lock.unlink()
        os.close(descriptor)
        _remove_empty(made)


@contextlib.contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A new folder that becomes ``folder`` when the block ends, or vanishes if anything is raised.

    After a kill it lies in ``.NAME.unfinished`` until the next who writes ``folder``. Raises Unwritable if ``folder``
    holds something already or cannot be written.
    """
    folder = Path(os.path.abspath(folder))
    unfinished = folder.with_name(f".{folder.name}.unfinished")
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise Unwritable(f"{folder} is a file, give the name of a folder with --out.")
    try:
        with held(unfinished):
            _vacant(folder)
            made = unfinished / "whole"
            shutil.rmtree(made, ignore_errors=True)
            made.mkdir()
            try:
                yield made
                _vacant(folder, remove=True)
                made.rename(folder)
            finally:
                shutil.rmtree(made, ignore_errors=True)
    finally:
        with contextlib.suppress(OSError):
            unfinished.rmdir()


def contents(folder: Path) -> list[str]:
    """Names in a folder, in order, but for a lock and half-written files; none if there is no such folder."""
    return sorted(
        name for name in _names(folder) if name != LOCK and not (name.startswith(".") and name.endswith(".new"))
    )


def is_held(folder: Path) -> bool:
    """Whether somebody writes in the folder now. This writes nothing."""
    if fcntl is None:
        return False
    try:
        with (folder / LOCK).open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # there is none, or it is somebody else's
        pass
    return False


def reason(error: OSError) -> str:
    """What went wrong, in a few words."""
    return "the disk is full" if error.errno == errno.ENOSPC else (error.strerror or str(error)).lower()


def broken(error: OSError) -> str:
    """What went wrong, and with which file."""
    return reason(error) + (f" ({error.filename})" if error.filename else "")


def _alone(file: Path) -> int:
    """A descriptor of the file, made if need be, that nobody else gets until it is closed.

    Raises BlockingIOError if another has it for longer than a look, OSError if it cannot be had.
    """
    until = time.monotonic() + PATIENCE
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(descriptor), file.stat()):
                return descriptor
        except FileNotFoundError:
            pass  # who had it renamed or removed it in between
        except BlockingIOError:
            if time.monotonic() > until:
                os.close(descriptor)
                raise
            time.sleep(PATIENCE / 20)
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _vacant(folder: Path, remove: bool = False) -> None:
    """Refuse a folder that holds something, or is being written; what a kill left there may go with the folder."""
    if not folder.is_dir():
        return
    with held(folder):
        if contents(folder):
            raise Unwritable(f"the folder {folder} is not empty, choose another with --out.")
        if remove:
            shutil.rmtree(folder)


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []


def _holder(lock: Path) -> str:
    try:
        return lock.read_text(encoding="utf-8").strip() or "another process"
    except OSError:
        return "another process"


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:  # the innermost first
        with contextlib.suppress(OSError):
            folder.rmdir()

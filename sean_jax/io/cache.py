"""Tables in the user's cache folder: a table that takes seconds to build is built once for all processes.

The key of a table is a digest of its inputs and source code, never a name or a time, so a table is never older than
the files it depends on. If the folder cannot be read or written, tables are built again.
"""

import functools
import hashlib
import itertools
import os
import tempfile
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.core.errors import FileError
from sean_jax.io import files

PACKAGE = Path(__file__).resolve().parents[1]
MAX_SIZE, MAX_FILES = 1 << 31, 20_000  # bytes and files in the folder, beyond which the oldest are removed
MAX_RECENT = 16  # tables that this process keeps in memory
ABANDONED_AFTER = 3600.0  # s, after which an unfinished file is removed

WRITES = 64  # of a process, between two looks at the folder's size
_writes = itertools.count()

Tables = Mapping[str, np.ndarray]
_recent: OrderedDict[str, Tables] = OrderedDict()


def folder() -> Path:
    """The package's folder in the user's cache, which need not exist; a temporary one for a user without a home."""
    place = os.environ.get("XDG_CACHE_HOME")
    if not place:
        try:
            place = Path.home() / ".cache"
        except RuntimeError:
            place = Path(tempfile.gettempdir()) / f"cache-{os.getuid() if hasattr(os, 'getuid') else 'own'}"
    return Path(place) / "sean_jax"


def load_or_build(kind: str, code: tuple[str, ...], inputs: Iterable[Any], build: Callable[[], Tables]) -> Tables:
    """Build tables (arrays by name), or load what any process has built from the same inputs.

    Args:
        code: files and folders of the package, such as ``navigation``, on which the result depends.
        inputs: numbers and arrays, compared in single precision. Tables of one precision are not used in the other, or
            results would depend on which of the two ran first.
        build: runs if there is no table, or if it cannot be read.
    """
    import jax.numpy as jnp  # here, for the command line configures jax's own cache before it is imported

    digest = hashlib.sha256(f"{kind} {jnp.result_type(float)} {source(*code)}".encode())
    for value in inputs:
        array = np.ascontiguousarray(value, np.float32)
        digest.update(f"{array.shape}".encode() + array.tobytes())
    name = f"{kind}-{digest.hexdigest()[:32]}"
    if name not in _recent:
        path = folder() / "tables" / f"{name}.npz"
        tables = _read(path, name)
        if tables is None:
            tables = dict(build())
            _write(path, name, tables)
        _recent[name] = tables
    _recent.move_to_end(name)
    while len(_recent) > MAX_RECENT:
        _recent.popitem(last=False)
    return _recent[name]


@functools.cache
def source(*code: str) -> str:
    """Digest of source files and folders of the package."""
    digest = hashlib.sha256()
    for name in code:
        path = PACKAGE / name
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path.with_suffix(".py")]:
            digest.update(files.read_bytes(file) if file.is_file() else b"")
    return digest.hexdigest()


def _read(path: Path, name: str) -> Tables | None:
    """The arrays of an intact file that was written under that name; None without one."""
    try:
        tables = files.read_arrays(path)
        if str(tables.pop("name", "")) != f"{name} {_digest(tables)}":
            return None
        os.utime(path)  # the oldest are removed first
    except (FileError, OSError):
        return None
    return tables


def _write(path: Path, name: str, tables: Tables) -> None:
    """Write the tables atomically, if the folder can be written."""
    unfinished = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", suffix=".unfinished", delete=False) as stream:
            unfinished = stream.name
            arrays: Any = dict(tables, name=np.array(f"{name} {_digest(tables)}"))
            np.savez_compressed(stream, **arrays)
        os.replace(unfinished, path)
        if next(_writes) % WRITES == 0:
            _remove_oldest(path.parent)
    except OSError:
        pass  # a full or read-only disk
    finally:
        if unfinished is not None:
            Path(unfinished).unlink(missing_ok=True)


def _digest(tables: Tables) -> str:
    """Digest of names, types, shapes and numbers; a zip file that was written anew has valid checksums."""
    digest = hashlib.sha256()
    for name in sorted(tables):
        array = np.ascontiguousarray(tables[name])
        digest.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()[:32]


def _remove_oldest(tables: Path) -> None:
    """Keep to ``MAX_FILES`` files and ``MAX_SIZE`` bytes, and remove unfinished files an hour after the last write."""
    total = 0
    files = []
    for file in tables.iterdir():
        state = file.stat()
        if file.suffix == ".npz":
            files.append((state.st_mtime, state.st_size, file))
        elif file.suffix == ".unfinished" and time.time() - state.st_mtime > ABANDONED_AFTER:
            file.unlink(missing_ok=True)
    for number, (_, size, file) in enumerate(sorted(files, reverse=True)):
        total += size
        if number >= MAX_FILES or total > MAX_SIZE:
            file.unlink(missing_ok=True)

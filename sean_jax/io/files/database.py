"""SQLite files: opened, read and written in one place, and never trusted.

A database that comes from elsewhere may be damaged, or made to do harm: a view that never ends, a trigger that deletes,
a page that is its own child. So a file is used if its schema is that of the program, word for word, and if SQLite finds
all of its pages and indices in order. Rows are checked by a model. What SQLite raises becomes a sentence.
"""

import contextlib
import json
import os
import sqlite3
import stat
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pydantic

from sean_jax.core.errors import FileError, InputError, WriteError
from sean_jax.core.messages import error_clause, shorten
from sean_jax.io.files.reading import MAX_TABLE, file_error, short_name

MAX_CELL = 50_000_000  # bytes of a value, and of a row
MAX_ROWS = 10_000_000  # of one query
WAIT = 10.0  # s, for another program that writes
OWNER_ALONE = 0o600  # permissions of a new file; SQLite gives them to the files beside it too
BESIDE = ("-wal", "-shm", "-journal")  # ends of the names of SQLite's files beside a database
CAUSES = {
    "SQLITE_FULL": "the disk is full; free some space",
    "SQLITE_IOERR": "the disk is full or fails; free some space, or use another disk",
    "SQLITE_READONLY": "the file or its folder is read-only; copy the folder to a place where you may write",
    "SQLITE_CANTOPEN": "its folder is missing or read-only; copy the folder to a place where you may write",
    "SQLITE_PERM": "its folder is read-only; copy the folder to a place where you may write",
    "SQLITE_BUSY": "another program keeps it locked; close that program",
    "SQLITE_LOCKED": "another program keeps it locked; close that program",
    "SQLITE_TOOBIG": f"a value has more than {MAX_CELL:,} bytes; restore the file from a copy",
}
DAMAGED = "it is damaged; restore the file from a copy"


def _scalar(text: Any) -> Any:
    """The number or the text of a JSON cell; half a surrogate, which no file can hold, is written out as \\ud83d."""
    if not isinstance(text, str):
        raise ValueError(f"{shorten(repr(text))} is not JSON")
    try:
        value = json.loads(text)
        if isinstance(value, int):
            float(value)  # OverflowError for 400 digits
    except (ValueError, OverflowError, RecursionError):
        raise ValueError(f"{shorten(repr(text))} is not JSON") from None
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
Scalar = Annotated[str | int | Finite, pydantic.BeforeValidator(_scalar)]


class DatabaseRow(pydantic.BaseModel):
    """A row of a query; its fields are the columns."""

    model_config = pydantic.ConfigDict(extra="forbid", strict=True)
    table: ClassVar[str]  # as messages name it


class Database:
    """An open database. Methods may be called from any thread."""

    def __init__(self, file: Path, tables: str):
        """Open a file that is there.

        Args:
            tables: the statements that made it.

        Raises:
            FileError: it cannot be opened, has another schema, or is damaged.
        """
        _check_regular(file)
        self.file = file
        self._lock = threading.RLock()
        with explained(file, FileError):
            self._base = _connect(file)
        try:
            self._check(tables)
        except BaseException:
            self._base.close()
            raise

    def _check(self, tables: str) -> None:
        with explained(self.file, FileError):
            if _schema(self._base) != _schema_of(tables):
                raise file_error(self.file, "its tables are not those that this program makes; give another file")
            result = self._base.execute("PRAGMA integrity_check(1)").fetchone()
            if result != ("ok",):
                raise file_error(self.file, f"cannot be read: {DAMAGED}")
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=FULL")

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._base.close()

    def rows(self, model: type[DatabaseRow], query: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """The rows of a query, whose columns are the fields of ``model``.

        Raises:
            FileError: the file cannot be read, or a value is wrong.
        """
        with self._lock, explained(self.file, FileError):
            cursor = self._base.execute(query, values)
            names = [column[0] for column in cursor.description]
            cells = cursor.fetchmany(MAX_ROWS + 1)
        if len(cells) > MAX_ROWS:
            raise self.wrong(model.table, f"has more than {MAX_ROWS:,} rows")
        found = []
        for row in cells:
            content = dict(zip(names, row, strict=True))
            try:
                found.append(dict(model.model_validate(content)))
            except pydantic.ValidationError as error:
                item = error.errors(include_url=False)[0]
                raise self.wrong(model.table, f"{item['loc'][0]}: {error_clause(item)}") from None
        return found

    def wrong(self, table: str, what: str) -> FileError:
        """The error about a table's content."""
        return file_error(self.file, f"table {table}: {what}; restore the file from a copy")

    @contextlib.contextmanager
    def transaction(self) -> Iterator[Callable[..., sqlite3.Cursor]]:
        """Statements that are on the disk when the block ends, all of them or none; the block gets what executes one.

        Raises:
            WriteError: they cannot be written.
        """
        with self._lock, explained(self.file, WriteError):
            self._base.execute("BEGIN IMMEDIATE")
            try:
                yield self._base.execute
                self._base.execute("COMMIT")
            except BaseException:
                if self._base.in_transaction:  # a full disk has ended it already
                    self._base.execute("ROLLBACK")
                raise


@contextlib.contextmanager
def new_database(file: Path, tables: str) -> Iterator[Callable[..., sqlite3.Cursor]]:
    """A database that becomes ``file`` when the block ends, which only its owner may read; after an error, nothing.

    The block gets what executes a statement.

    Raises:
        WriteError: it cannot be written.
    """
    temporary = file.with_name(f".{file.name}.new")
    with explained(file, WriteError):
        _remove(temporary)
        try:
            os.close(os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, OWNER_ALONE))
            with contextlib.closing(_connect(temporary)) as base:
                base.execute("PRAGMA synchronous=FULL")
                base.execute("BEGIN")
                for statement in tables.split(";"):
                    base.execute(statement)
                yield base.execute
                base.execute("COMMIT")
            os.replace(temporary, file)
        except BaseException:
            _remove(temporary)
            raise


def make_private(file: Path) -> None:
    """Let only its owner read a database; OSError if it belongs to somebody else."""
    for name in (file.name, *(file.name + end for end in BESIDE)):
        with contextlib.suppress(FileNotFoundError):
            file.with_name(name).chmod(OWNER_ALONE)


@contextlib.contextmanager
def explained(file: Path, kind: type[InputError]) -> Iterator[None]:
    """Turn SQLite's errors in the block into the package's.

    Args:
        kind: FileError while reading, WriteError while writing.
    """
    word = "read" if kind is FileError else "written"
    try:
        yield
    except sqlite3.Error as error:
        raise kind(f"{short_name(file)}: cannot be {word}: {_cause(error)}.") from None
    except MemoryError:
        raise kind(
            f"{short_name(file)}: cannot be {word}: it does not fit into memory; close other programs."
        ) from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise kind(f"{short_name(file)}: cannot be {word}: {reason}; choose another folder.") from None


def _cause(error: sqlite3.Error) -> str:
    """Cause and cure; of a family of codes such as SQLITE_IOERR_WRITE, the family's."""
    name = getattr(error, "sqlite_errorname", "")
    return next((text for start, text in CAUSES.items() if name.startswith(start)), DAMAGED)


def _check_regular(file: Path) -> None:
    """Refuse what is no regular file, which is not opened for that: closing it would end SQLite's locks."""
    for path in (file, *(file.with_name(file.name + end) for end in BESIDE)):
        try:
            status = path.stat()
        except FileNotFoundError:
            if path == file:
                raise FileError(f"{path}: there is no such file.") from None
            continue
        except OSError as error:
            raise FileError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}.") from None
        if not stat.S_ISREG(status.st_mode):
            raise FileError(f"{path}: cannot be read: it is no regular file; give another one.")
        if status.st_size > MAX_TABLE:
            raise FileError(f"{path}: has {status.st_size:,} bytes and at most {MAX_TABLE:,} are read.")


def _connect(file: Path | str) -> sqlite3.Connection:
    base = sqlite3.connect(file, check_same_thread=False, isolation_level=None, timeout=WAIT)
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CELL)
    base.execute("PRAGMA trusted_schema=OFF")
    base.execute("PRAGMA cell_size_check=ON")
    base.text_factory = lambda data: data.decode("utf-8", "replace")  # so that all that is stored can be read
    return base


def _schema(base: sqlite3.Connection) -> set[tuple[Any, ...]]:
    return set(base.execute("SELECT type, name, tbl_name, sql FROM sqlite_master").fetchmany(1000))


def _schema_of(tables: str) -> set[tuple[Any, ...]]:
    with contextlib.closing(_connect(":memory:")) as base:
        base.executescript(tables)
        return _schema(base)


def _remove(file: Path) -> None:
    for name in (file.name, *(file.name + end for end in BESIDE)):
        file.with_name(name).unlink(missing_ok=True)

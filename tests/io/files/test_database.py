"""Files of SQLite: transactions are whole or nothing, and what is no file of ours is refused before it is opened."""

import contextlib
import os
import stat

import pydantic
import pytest

from sean_jax.core.errors import FileError, WriteError
from sean_jax.io.files import database

TABLES = "CREATE TABLE words (word TEXT NOT NULL, number INTEGER NOT NULL UNIQUE)"


class WordRow(database.DatabaseRow):
    """A row of the only table."""

    table = "words"
    word: str
    number: pydantic.NonNegativeInt


@pytest.fixture
def file(tmp_path):
    with database.new_database(tmp_path / "words.sqlite", TABLES) as execute:
        execute("INSERT INTO words VALUES ('one', 1)")
    return tmp_path / "words.sqlite"


def words(base):
    return [
        (row["word"], row["number"]) for row in base.rows(WordRow, "SELECT word, number FROM words ORDER BY number")
    ]


def test_a_transaction_is_whole_or_nothing(file):
    """After a mistake in its midst the next one goes on; another program sees what is complete alone."""
    with (
        contextlib.closing(database.Database(file, TABLES)) as base,
        contextlib.closing(database.Database(file, TABLES)) as other,
    ):
        for mistake, raised in (("INSERT INTO words VALUES ('again', 1)", WriteError), (None, ZeroDivisionError)):
            with pytest.raises(raised), base.transaction() as execute:
                execute("INSERT INTO words VALUES ('lost', 9)")
                assert words(other) == [("one", 1)]
                _ = execute(mistake) if mistake else 1 / 0
            assert words(base) == words(other) == [("one", 1)]
        # What has ended by itself, as on a full disk, is not ended again.
        with pytest.raises(ZeroDivisionError), base.transaction() as execute:
            execute("INSERT INTO words VALUES ('lost', 9)")
            execute("ROLLBACK")
            _ = 1 / 0
        with base.transaction() as execute:
            execute("INSERT INTO words VALUES ('two', 2)")
        assert words(base) == words(other) == [("one", 1), ("two", 2)]


def test_a_new_file_is_the_owners_and_whole(tmp_path):
    file = tmp_path / "new.sqlite"
    with pytest.raises(ZeroDivisionError), database.new_database(file, TABLES) as execute:
        execute("INSERT INTO words VALUES ('lost', 9)")
        _ = 1 / 0
    assert not list(tmp_path.iterdir())
    with database.new_database(file, TABLES) as execute:
        execute("INSERT INTO words VALUES ('one', 1)")
        assert not file.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["new.sqlite"]
    with contextlib.closing(database.Database(file, TABLES)) as base:
        with base.transaction() as execute:
            execute("INSERT INTO words VALUES ('two', 2)")
        beside = sorted(path.name for path in tmp_path.iterdir())
        assert beside == ["new.sqlite", "new.sqlite-shm", "new.sqlite-wal"]
        for path in tmp_path.iterdir():
            path.chmod(0o644)
        database.make_private(file)
        assert {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()} == {0o600}


@pytest.mark.parametrize("end", ["", "-wal", "-journal"])
def test_what_is_no_regular_file_or_too_large_is_refused(file, end, monkeypatch):
    path = file.with_name(file.name + end)
    content = path.read_bytes() if path.exists() else b""
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    with pytest.raises(FileError, match=f"{path.name}: cannot be read: it is no regular file"):
        database.Database(file, TABLES)
    path.unlink()
    path.write_bytes(content or b"\0" * 64)
    size = path.stat().st_size
    monkeypatch.setattr(database, "MAX_TABLE", max(size, file.stat().st_size) if not end else file.stat().st_size)
    database._check_regular(file)  # as large as may be
    path.write_bytes(b"\0" * (database.MAX_TABLE + 1))
    with pytest.raises(FileError, match=rf"{path.name}: has {database.MAX_TABLE + 1:,} bytes and at most"):
        database.Database(file, TABLES)


def test_a_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(FileError, match="nothing.sqlite: there is no such file"):
        database.Database(tmp_path / "nothing.sqlite", TABLES)

"""The file of a study, ``study.sqlite``: links, answers, drives and progress, each on the disk before it is confirmed.

The file is in SQLite's WAL mode with ``synchronous=FULL``: what is confirmed survives a kill of the process and a
loss of power. It has no names and no addresses of participants. It may be read while the study runs.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import sqlite3
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from sean_jax.errors import FileError, InputError, WriteError
from sean_jax.survey.study import Study

FILE = "study.sqlite"
VERSION = 1
TABLES = """
CREATE TABLE study (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE participants (id INTEGER PRIMARY KEY, secret TEXT NOT NULL UNIQUE, consented REAL, finished REAL);
CREATE TABLE events (time REAL NOT NULL, participant INTEGER NOT NULL, what TEXT NOT NULL);
CREATE TABLE steps (participant INTEGER NOT NULL, step INTEGER NOT NULL, shown REAL, done REAL,
  PRIMARY KEY (participant, step));
CREATE TABLE answers (participant INTEGER NOT NULL, step INTEGER NOT NULL, question TEXT NOT NULL, value TEXT NOT NULL,
  time REAL NOT NULL, PRIMARY KEY (participant, step, question));
CREATE TABLE episodes (trial INTEGER NOT NULL, side INTEGER NOT NULL, policy TEXT NOT NULL, outcome TEXT NOT NULL,
  metrics TEXT NOT NULL, recording TEXT NOT NULL, PRIMARY KEY (trial, side));
CREATE TABLE drives (id INTEGER PRIMARY KEY, participant INTEGER NOT NULL, step INTEGER NOT NULL, began REAL NOT NULL,
  ended REAL, outcome TEXT, metrics TEXT, recording TEXT);
CREATE TABLE moments (drive INTEGER NOT NULL, tick INTEGER NOT NULL, moments TEXT NOT NULL,
  PRIMARY KEY (drive, tick));
"""
BROKEN_OFF = "broken off"


class Answers:
    """An open study file. Methods may be called from any thread."""

    def __init__(self, file: Path):
        """Open a file that is there.

        Raises:
            FileError: it is no study of this version.
        """
        self.file = file
        self._lock = threading.RLock()
        if not file.is_file():
            raise FileError(f"{file.parent}: holds no {FILE}; give the folder of `sean studio --survey`.")
        self._base = sqlite3.connect(file, check_same_thread=False, isolation_level=None, timeout=10.0)
        try:
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=FULL")
            values = dict(self._base.execute("SELECT name, value FROM study"))
            version = int(values["version"])
            self.study = Study.model_validate_json(values["study"])
            self.researcher = values["researcher"]
        except (sqlite3.DatabaseError, KeyError, ValueError):
            raise FileError(f"{file}: is no study; give the folder of `sean studio --survey`.") from None
        if version != VERSION:
            raise FileError(
                f"{file}: has version {version} of the format, not {VERSION}; use the sean_jax that wrote it."
            )

    @classmethod
    def begin(cls, folder: Path, study: Study) -> Answers:
        """The file of a folder, which is made if it is missing.

        Raises:
            InputError: it belongs to another study.
            WriteError: it cannot be written.
        """
        file = folder / FILE
        if not file.exists():
            temporary = file.with_name(f".{FILE}.new")
            temporary.unlink(missing_ok=True)
            try:
                base = sqlite3.connect(temporary, isolation_level=None)
            except sqlite3.Error as error:
                raise WriteError(f"cannot write {file}: {error}; choose another folder with --out.") from None
            with contextlib.closing(base):
                base.execute("PRAGMA synchronous=FULL")
                base.executescript(f"BEGIN;{TABLES}")
                rows = {
                    "version": str(VERSION),
                    "study": study.model_dump_json(),
                    "researcher": secrets.token_urlsafe(16),
                }
                base.executemany("INSERT INTO study VALUES (?, ?)", rows.items())
                links = [(number, secrets.token_urlsafe(16)) for number in range(study.participants)]
                base.executemany("INSERT INTO participants (id, secret) VALUES (?, ?)", links)
                base.execute("COMMIT")
            temporary.replace(file)
        answers = cls(file)
        had, now = answers.study.identity(), study.identity()
        other = next((name for name in now if had.get(name) != now[name]), None)
        if other is not None:
            answers.close()
            raise InputError(f"survey: {file} has a study with other {other}; choose another folder with --out.")
        answers.study = study
        return answers

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._base.close()

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            self._base.execute("BEGIN IMMEDIATE")
            try:
                yield self._base
            except BaseException:
                self._base.execute("ROLLBACK")
                raise
            self._base.execute("COMMIT")

    def _rows(self, query: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
        with self._lock:
            cursor = self._base.execute(query, values)
            names = [each[0] for each in cursor.description]
            return [dict(zip(names, row, strict=True)) for row in cursor]

    @property
    def port(self) -> int:
        """The port of the latest server, so that links stay the same; 0 before the first one."""
        rows = self._rows("SELECT value FROM study WHERE name = 'port'")
        return int(rows[0]["value"]) if rows else 0

    def keep_port(self, port: int) -> None:
        """Set ``port``."""
        with self._transaction() as base:
            base.execute("INSERT OR REPLACE INTO study VALUES ('port', ?)", (str(port),))

    # ------------------------------------------------------------------ participants

    def secrets(self) -> dict[int, str]:
        """Number of a participant -> the secret of the link."""
        return {row["id"]: row["secret"] for row in self._rows("SELECT id, secret FROM participants ORDER BY id")}

    def event(self, participant: int, what: str) -> None:
        """Note what a participant has done."""
        with self._transaction() as base:
            base.execute("INSERT INTO events VALUES (?, ?, ?)", (time.time(), participant, what))

    def consent(self, participant: int) -> None:
        """The participant agrees."""
        with self._transaction() as base:
            query = "UPDATE participants SET consented = coalesce(consented, ?) WHERE id = ?"
            base.execute(query, (time.time(), participant))

    def show(self, participant: int, step: int) -> None:
        """The participant has watched the trial, or driven it, and goes on to its questions."""
        with self._transaction() as base:
            query = "INSERT INTO steps (participant, step, shown) VALUES (?, ?, ?) ON CONFLICT DO NOTHING"
            base.execute(query, (participant, step, time.time()))

    def answer(self, participant: int, step: int, question: str, value: Any) -> None:
        """An answer, in place of an earlier one; None takes it back."""
        with self._transaction() as base:
            if value is None:
                query = "DELETE FROM answers WHERE participant = ? AND step = ? AND question = ?"
                base.execute(query, (participant, step, question))
                return
            row = (participant, step, question, json.dumps(value), time.time())
            base.execute("INSERT OR REPLACE INTO answers VALUES (?, ?, ?, ?, ?)", row)

    def finish(self, participant: int, step: int, last: bool) -> None:
        """The step is done; after the last one, so is the participant."""
        with self._transaction() as base:
            now = time.time()
            query = "INSERT INTO steps VALUES (?, ?, ?, ?) ON CONFLICT (participant, step) DO UPDATE SET done = ?"
            base.execute(query, (participant, step, now, now, now))
            if last:
                base.execute("UPDATE participants SET finished = ? WHERE id = ?", (now, participant))

    def progress(self, participant: int) -> tuple[bool, int, bool]:
        """Whether the participant has consented, the number of steps that are done, whether the next one is shown."""
        consented = self._rows("SELECT consented FROM participants WHERE id = ?", (participant,))[0]["consented"]
        rows = self._rows("SELECT step, done FROM steps WHERE participant = ?", (participant,))
        done = sum(row["done"] is not None for row in rows)
        return consented is not None, done, any(row["step"] == done for row in rows)

    def answers_of(self, participant: int, step: int) -> dict[str, Any]:
        """Question -> answer."""
        query = "SELECT question, value FROM answers WHERE participant = ? AND step = ?"
        return {row["question"]: json.loads(row["value"]) for row in self._rows(query, (participant, step))}

    # ------------------------------------------------------------------ episodes and drives

    def episodes(self) -> dict[tuple[int, int], dict[str, Any]]:
        """Trial and side -> policy, outcome, metrics and recording of an episode to watch."""
        return {
            (row["trial"], row["side"]): row | {name: json.loads(row[name]) for name in ("metrics", "recording")}
            for row in self._rows("SELECT * FROM episodes")
        }

    def add_episode(
        self, trial: int, side: int, policy: str, outcome: str, metrics: dict[str, float], recording: dict[str, Any]
    ) -> None:
        """An episode to watch."""
        with self._transaction() as base:
            row = (trial, side, policy, outcome, json.dumps(metrics), json.dumps(recording))
            base.execute("INSERT OR REPLACE INTO episodes VALUES (?, ?, ?, ?, ?, ?)", row)

    def begin_drive(self, participant: int, step: int) -> int:
        """The number of a new drive."""
        with self._transaction() as base:
            query = "INSERT INTO drives (participant, step, began) VALUES (?, ?, ?)"
            number = base.execute(query, (participant, step, time.time())).lastrowid
        assert number is not None
        return number

    def add_moments(self, drive: int, tick: int, moments: Sequence[Sequence[float]]) -> None:
        """Control steps from number ``tick`` on: speed, turn rate, then x, y and heading after the step."""
        with self._transaction() as base:
            base.execute("INSERT INTO moments VALUES (?, ?, ?)", (drive, tick, json.dumps(moments)))

    def end_drive(
        self, drive: int, outcome: str, metrics: dict[str, float] | None = None, recording: dict[str, Any] | None = None
    ) -> None:
        """The drive has ended; with metrics, its trial is shown."""
        with self._transaction() as base:
            texts = [None if value is None else json.dumps(value) for value in (metrics, recording)]
            query = "UPDATE drives SET ended = ?, outcome = ?, metrics = ?, recording = ? WHERE id = ?"
            base.execute(query, (time.time(), outcome, *texts, drive))
            if metrics is not None:
                query = "INSERT INTO steps (participant, step, shown) SELECT participant, step, ended FROM drives"
                base.execute(f"{query} WHERE id = ? ON CONFLICT DO NOTHING", (drive,))

    def recover(self) -> None:
        """Drives that a killed process has left are broken off."""
        with self._transaction() as base:
            base.execute("UPDATE drives SET ended = began, outcome = ? WHERE ended IS NULL", (BROKEN_OFF,))

    # ------------------------------------------------------------------ all of it

    def participants(self) -> list[dict[str, Any]]:
        """id, consented, finished, steps done, and the time of the latest event or answer of each participant."""
        times = "SELECT time, participant FROM events UNION ALL SELECT time, participant FROM answers"
        return self._rows(
            "SELECT id, consented, finished, (SELECT count(done) FROM steps WHERE participant = id) AS done, "
            f"(SELECT max(time) FROM ({times}) WHERE participant = id) AS seen FROM participants ORDER BY id"
        )

    def all_steps(self) -> list[dict[str, Any]]:
        """participant, step, shown and done of each step that has begun."""
        return self._rows("SELECT * FROM steps ORDER BY participant, step")

    def all_answers(self) -> list[dict[str, Any]]:
        """participant, step, question, value and time of each answer."""
        rows = self._rows("SELECT * FROM answers ORDER BY participant, step, rowid")
        return [row | {"value": json.loads(row["value"])} for row in rows]

    def drives(self) -> list[dict[str, Any]]:
        """All drives, without their recordings."""
        rows = self._rows("SELECT id, participant, step, began, ended, outcome, metrics FROM drives ORDER BY id")
        return [row | {"metrics": json.loads(row["metrics"] or "null")} for row in rows]

    def recording(self, drive: int) -> dict[str, Any] | None:
        """The recording of a drive that came to its end."""
        text = self._rows("SELECT recording FROM drives WHERE id = ?", (drive,))[0]["recording"]
        return None if text is None else json.loads(text)

    def moments(self, drive: int) -> list[list[float]]:
        """The control steps of a drive, as in ``add_moments``."""
        rows = self._rows("SELECT moments FROM moments WHERE drive = ? ORDER BY tick", (drive,))
        return [moment for row in rows for moment in json.loads(row["moments"])]

"""The file of a study, ``study.sqlite``: links, answers, drives and progress, each on the disk before it is confirmed.

The file is in SQLite's WAL mode with ``synchronous=FULL``: what is confirmed survives a kill of the process and a
loss of power. It has no names and no addresses of participants. It may be read while the study runs. Only its owner
may read it, since it holds everybody's link.
"""

from __future__ import annotations

import collections
import contextlib
import json
import secrets
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pydantic

from sean_jax.core.bounds import TIME_STEP_RANGE, parse_digits
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.messages import count_values
from sean_jax.io import writing
from sean_jax.io.files import file_error
from sean_jax.io.files.database import Database, DatabaseRow, Finite, Scalar, make_private, new_database
from sean_jax.studies.survey import visits
from sean_jax.studies.survey.study import MAX_STUDY, MAX_WORD, Step, Study, checked, name_problems

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
MAX_EVENTS = 20_000  # of a participant; further ones are not noted
MAX_PORT = 65_535
MAX_FILM = 8_000_000  # bytes: 120 s among 62 people take 124,000
MAX_VALUES = 500_000  # of a film, most of which is one text; a value of JSON takes up to 240 bytes of memory
MAX_FILMS = 400_000_000  # bytes, of all episodes to watch
MAX_JSON = 500_000  # characters of metrics, of moments and of an answer, as JSON
MOMENT = 5  # numbers of a control step: speed, turn rate, x, y, heading; one more of a robot that drives sideways
PARTICIPANT = "id, consented, finished, (SELECT count(done) FROM steps WHERE participant = id) AS done"  # columns

Time = Annotated[float, pydantic.Field(ge=0, le=4e9)]  # s since 1970
Number = Annotated[int, pydantic.Field(ge=0, le=2**40)]
Secret = Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9_-]{20,100}$")]
Word = Annotated[str, pydantic.Field(max_length=MAX_WORD)]


def _finite(content: dict[str, Any]) -> dict[str, Any]:
    json.dumps(content, allow_nan=False)  # ValueError for NaN, which no page reads
    return content


def _short(text: Any) -> Any:
    if isinstance(text, str) and len(text) > MAX_JSON:  # before it is parsed, which takes 40 times the memory
        raise ValueError(f"has {len(text):,} characters and at most {MAX_JSON:,} are read")
    return text


Short = pydantic.BeforeValidator(_short)
Metrics = Annotated[pydantic.Json[dict[str, Finite]], Short]


def _bounded(text: Any) -> Any:
    if isinstance(text, str) and (problem := film_problem(text)) is not None:
        raise ValueError(f"the film {problem}")
    return text


def film_problem(text: str) -> str | None:
    """Why a film, as JSON, is neither stored nor read: it would take too much memory."""
    if (size := len(text)) > MAX_FILM:
        return f"has {size:,} bytes and at most {MAX_FILM:,} are read"
    if (count := count_values(text)) > MAX_VALUES:
        return f"has {count:,} values and at most {MAX_VALUES:,} are read"
    return None


Film = Annotated[
    pydantic.Json[dict[str, Any]], pydantic.BeforeValidator(_bounded), pydantic.AfterValidator(_finite)
]  # of ``replay.recording``


class SettingRow(DatabaseRow):
    """A fact of the study."""

    table: ClassVar = "study"
    name: Word
    value: Annotated[str, pydantic.Field(max_length=MAX_STUDY)]


class SecretRow(DatabaseRow):
    """A participant's link."""

    table: ClassVar = "participants"
    id: Number
    secret: Secret


class ParticipantRow(DatabaseRow):
    """How far a participant has come."""

    table: ClassVar = "participants"
    id: Number
    consented: Time | None
    finished: Time | None
    done: Number
    seen: Time | None


class EventRow(DatabaseRow):
    """What a participant has done."""

    table: ClassVar = "events"
    participant: Number
    time: Time
    what: Annotated[str, pydantic.Field(pattern=visits.EVENT)]


class StepRow(DatabaseRow):
    """A page that is being answered, or done."""

    table: ClassVar = "steps"
    participant: Number
    step: Number
    shown: Time | None
    done: Time | None


class AnswerRow(DatabaseRow):
    """An answer."""

    table: ClassVar = "answers"
    participant: Number
    step: Number
    question: Word
    value: Annotated[Scalar, Short]
    time: Time


class EpisodeRow(DatabaseRow):
    """An episode to watch, without its film."""

    table: ClassVar = "episodes"
    trial: Number
    side: Number
    policy: Word
    outcome: Word
    metrics: Metrics


class FilmRow(DatabaseRow):
    """The film of an episode to watch."""

    table: ClassVar = "episodes"
    recording: Film


class FilmsRow(DatabaseRow):
    """The bytes of all films."""

    table: ClassVar = "episodes"
    size: Number


class DriveRow(DatabaseRow):
    """A drive, which goes on while it has not ended."""

    table: ClassVar = "drives"
    id: Number
    participant: Number
    step: Number
    began: Time
    ended: Time | None
    outcome: Word | None
    metrics: Metrics | None


class RecordingRow(DatabaseRow):
    """The recording of a drive."""

    table: ClassVar = "drives"
    recording: Film | None


class MomentsRow(DatabaseRow):
    """Control steps of a drive."""

    table: ClassVar = "moments"
    moments: Annotated[
        pydantic.Json[
            Annotated[
                list[Annotated[list[Finite], pydantic.Field(min_length=MOMENT, max_length=MOMENT + 1)]],
                pydantic.Field(max_length=1000),
            ]
        ],
        Short,
    ]


class FilmHead(pydantic.BaseModel):
    """The number of frames of a recorded episode."""

    frames: Annotated[int, pydantic.Field(ge=1, le=10_000_000)]


class FilmLength(pydantic.BaseModel):
    """What tells how long a recording takes."""

    timeStep: Annotated[float, pydantic.Field(ge=TIME_STEP_RANGE[0], le=TIME_STEP_RANGE[1])]  # noqa: N815
    episodes: Annotated[list[FilmHead], pydantic.Field(min_length=1)]

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (self.episodes[0].frames - 1) * self.timeStep


class Answers:
    """An open study file. Methods may be called from any thread.

    All that read raise FileError for a file that is damaged, and all that write WriteError, such as for a full disk.
    """

    def __init__(self, file: Path):
        """Open a file that is there.

        Raises:
            FileError: it is no study of this version, or it is damaged.
        """
        self.file = file
        if not file.exists():
            raise FileError(f"{file.parent}: holds no {FILE}; give the folder of `sean studio --survey`.")
        self._base = Database(file, TABLES)
        try:
            self._read_settings()
            self._pages = len(self.study.steps(0))
            self._steps: dict[int, list[Step]] = {}
            self._events = collections.Counter(row["participant"] for row in self.all_events())
        except BaseException:
            self.close()
            raise

    def _read_settings(self) -> None:
        values = {row["name"]: row["value"] for row in self._base.rows(SettingRow, "SELECT name, value FROM study")}
        version = values.get("version", "")
        if version.isdecimal() and version != str(VERSION):
            what = f"has version {version:.9} of the format, not {VERSION}; use the sean_jax that wrote it"
            raise file_error(self.file, what)
        try:
            self.study = Study.model_validate_json(values["study"])
            problem = next((clause for _, clause in name_problems(self.study)), None)
            self.researcher = SecretRow(id=0, secret=values["researcher"]).secret
            self._port = parse_digits(values.get("port", "0"))
        except (KeyError, pydantic.ValidationError):
            raise self.wrong("study", "is not what this program writes") from None
        if problem is not None:
            raise self.wrong("study", problem)
        if version != str(VERSION) or self._port is None or self._port > MAX_PORT:
            raise self.wrong("study", "is not what this program writes")

    @classmethod
    def begin(cls, folder: Path, study: Study) -> Answers:
        """The file of a folder, which is made if it is missing.

        Raises:
            InputError: it belongs to another study.
            WriteError: it cannot be written.
        """
        file = folder / FILE
        if file.exists():
            with contextlib.suppress(OSError):  # it belongs to somebody else
                make_private(file)  # a copy may not be
        else:
            with new_database(file, TABLES) as execute:
                settings = {
                    "version": str(VERSION),
                    "study": study.model_dump_json(),
                    "researcher": secrets.token_urlsafe(16),
                }
                for setting in settings.items():
                    execute("INSERT INTO study VALUES (?, ?)", setting)
                for number in range(study.participants):
                    link = number, secrets.token_urlsafe(16)
                    execute("INSERT INTO participants (id, secret) VALUES (?, ?)", link)
            writing.sync(folder)
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
        self._base.close()

    def steps(self, participant: int) -> list[Step]:
        """The pages of a participant."""
        if participant not in self._steps:
            self._steps[participant] = self.study.steps(participant)
        return self._steps[participant]

    def _placed(self, rows: list[dict[str, Any]], table: str) -> list[dict[str, Any]]:
        """The rows, if each is of a participant and a page of this study."""
        for row in rows:
            participant, step = row["participant"], row.get("step", 0)
            if participant >= self.study.participants or step >= self._pages:
                raise self.wrong(table, f"there is no page {step + 1} of participant {participant + 1}")
        return rows

    def wrong(self, table: str, what: str) -> FileError:
        """The error about what a table holds."""
        return self._base.wrong(table, what)

    @property
    def port(self) -> int:
        """The port of the latest server, so that links stay the same; 0 before the first one."""
        return self._port or 0

    def keep_port(self, port: int) -> None:
        """Set ``port``."""
        with self._base.transaction() as execute:
            execute("INSERT OR REPLACE INTO study VALUES ('port', ?)", (str(port),))
        self._port = port

    # ------------------------------------------------------------------ participants

    def secrets(self) -> dict[int, str]:
        """Number of a participant -> the secret of the link."""
        rows = self._base.rows(SecretRow, "SELECT id, secret FROM participants ORDER BY id")
        found = {row["id"]: row["secret"] for row in rows}
        if list(found) != list(range(self.study.participants)) or len(set(found.values())) < len(found):
            raise self.wrong("participants", f"does not hold {self.study.participants} links")
        return found

    def event(self, participant: int, what: str) -> None:
        """Note what a participant has done, in a word of ``visits``."""
        if self._events[participant] >= MAX_EVENTS:
            return
        with self._base.transaction() as execute:
            execute("INSERT INTO events VALUES (?, ?, ?)", (time.time(), participant, what))
        self._events[participant] += 1

    def consent(self, participant: int) -> None:
        """The participant agrees."""
        with self._base.transaction() as execute:
            query = "UPDATE participants SET consented = coalesce(consented, ?) WHERE id = ?"
            execute(query, (time.time(), participant))

    def show(self, participant: int, step: int) -> None:
        """The participant has watched the trial, or driven it, and goes on to its questions."""
        with self._base.transaction() as execute:
            query = "INSERT INTO steps (participant, step, shown) VALUES (?, ?, ?) ON CONFLICT DO NOTHING"
            execute(query, (participant, step, time.time()))

    def answer(self, participant: int, step: int, question: str, value: Any) -> None:
        """An answer, in place of an earlier one; None takes it back."""
        with self._base.transaction() as execute:
            if value is None:
                query = "DELETE FROM answers WHERE participant = ? AND step = ? AND question = ?"
                execute(query, (participant, step, question))
                return
            row = (participant, step, question, json.dumps(value), time.time())
            execute("INSERT OR REPLACE INTO answers VALUES (?, ?, ?, ?, ?)", row)

    def finish(self, participant: int, step: int, last: bool) -> None:
        """The step is done; after the last one, so is the participant."""
        with self._base.transaction() as execute:
            now = time.time()
            query = "INSERT INTO steps VALUES (?, ?, ?, ?) ON CONFLICT (participant, step) DO UPDATE SET done = ?"
            execute(query, (participant, step, now, now, now))
            if last:
                execute("UPDATE participants SET finished = ? WHERE id = ?", (now, participant))

    def progress(self, participant: int) -> tuple[bool, int, bool]:
        """Whether the participant has consented, the number of steps that are done, whether the next one is shown."""
        query = f"SELECT {PARTICIPANT}, NULL AS seen FROM participants WHERE id = ?"
        found = self._base.rows(ParticipantRow, query, (participant,))
        if not found:
            raise self.wrong("participants", f"has no participant {participant + 1}")
        rows = self._base.rows(StepRow, "SELECT * FROM steps WHERE participant = ?", (participant,))
        done = sum(row["done"] is not None for row in self._placed(rows, "steps"))
        return found[0]["consented"] is not None, done, any(row["step"] == done for row in rows)

    def watched(self, participant: int, step: int) -> float:
        """Seconds since the film of a page began, without those in which its tab was hidden."""
        query = "SELECT participant, time, what FROM events WHERE participant = ? ORDER BY rowid"
        events = [(row["time"], row["what"]) for row in self._base.rows(EventRow, query, (participant,))]
        visit = visits.visits(events, time.time()).get(step)
        return 0.0 if visit is None else visit.watched

    def answers_of(self, participant: int, step: int) -> dict[str, Any]:
        """Question -> answer."""
        query = "SELECT * FROM answers WHERE participant = ? AND step = ?"
        return {row["question"]: row["value"] for row in self._answers(query, (participant, step))}

    def _answers(self, query: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
        rows = self._placed(self._base.rows(AnswerRow, query, values), "answers")
        for row in rows:
            question = self.steps(row["participant"])[row["step"]].question(row["question"])
            if question is not None and question["kind"] != "text":  # a text is what a participant wrote
                try:
                    checked(question, row["value"])
                except InputError as error:
                    raise self.wrong("answers", str(error).rstrip(".")) from None
        return rows

    # ------------------------------------------------------------------ episodes and drives

    def episodes(self) -> dict[tuple[int, int], dict[str, Any]]:
        """Trial and side -> policy, outcome and metrics of an episode to watch."""
        places = {(k, side) for k, trial in enumerate(self.study.trials) for side in range(len(trial.episodes))}
        if (size := self._film_bytes()) > MAX_FILMS:
            raise self.wrong("episodes", f"has films of {size:,} bytes and at most {MAX_FILMS:,} are read")
        query = f"SELECT trial, side, policy, outcome, metrics FROM episodes LIMIT {len(places) + 1}"
        rows = self._base.rows(EpisodeRow, query)
        for row in rows:
            if (row["trial"], row["side"]) not in places:
                raise self.wrong("episodes", f"there is no episode {row['side'] + 1} of trial {row['trial'] + 1}")
        return {(row["trial"], row["side"]): row for row in rows}

    def _film_bytes(self) -> int:
        """Of all episodes to watch."""
        query = "SELECT coalesce(sum(length(CAST(recording AS BLOB))), 0) AS size FROM episodes"
        return self._base.rows(FilmsRow, query)[0]["size"]

    def film(self, trial: int, side: int) -> dict[str, Any]:
        """The recording of an episode to watch."""
        query = "SELECT recording FROM episodes WHERE trial = ? AND side = ?"
        return self._base.rows(FilmRow, query, (trial, side))[0]["recording"]

    def film_lengths(self) -> dict[int, float]:
        """Trial -> seconds of its film, of two the longer one."""
        lengths: dict[int, float] = {}
        for trial, side in self.episodes():
            try:
                length = FilmLength.model_validate(self.film(trial, side)).seconds
            except pydantic.ValidationError:
                raise self.wrong("episodes", f"the recording of trial {trial + 1} has no frames") from None
            lengths[trial] = max(lengths.get(trial, 0.0), length)
        return lengths

    def add_episode(
        self, trial: int, side: int, policy: str, outcome: str, metrics: dict[str, float], recording: dict[str, Any]
    ) -> None:
        """An episode to watch.

        Raises:
            InputError: its film is too large.
            WriteError: it cannot be written.
        """
        film = json.dumps(recording)
        if (problem := film_problem(film)) is not None:
            name = self.study.trials[trial].name
            raise InputError(f"trials: the film of '{name}' {problem}; choose a shorter time_limit or fewer people.")
        if self._film_bytes() + len(film) > MAX_FILMS:
            raise InputError(f"trials: their films have more than {MAX_FILMS:,} bytes; leave some trials out.")
        with self._base.transaction() as execute:
            row = (trial, side, policy, outcome, json.dumps(metrics), film)
            execute("INSERT OR REPLACE INTO episodes VALUES (?, ?, ?, ?, ?, ?)", row)

    def begin_drive(self, participant: int, step: int) -> int:
        """The number of a new drive."""
        with self._base.transaction() as execute:
            query = "INSERT INTO drives (participant, step, began) VALUES (?, ?, ?)"
            number = execute(query, (participant, step, time.time())).lastrowid
        assert number is not None
        return number

    def add_moments(self, drive: int, tick: int, moments: Sequence[Sequence[float]]) -> None:
        """Control steps from number ``tick`` on: the command, then x, y and heading after the step.

        A command is speed and turn rate; of a robot that drives sideways, speed, speed to the left and turn rate.
        """
        with self._base.transaction() as execute:
            execute("INSERT INTO moments VALUES (?, ?, ?)", (drive, tick, json.dumps(moments)))

    def end_drive(
        self, drive: int, outcome: str, metrics: dict[str, float] | None = None, recording: dict[str, Any] | None = None
    ) -> None:
        """The drive has ended; with metrics, its trial is shown. A recording that is too large is left out."""
        with self._base.transaction() as execute:
            texts = [None if value is None else json.dumps(value) for value in (metrics, recording)]
            if texts[1] is not None and film_problem(texts[1]) is not None:
                texts[1] = None
            query = "UPDATE drives SET ended = ?, outcome = ?, metrics = ?, recording = ? WHERE id = ?"
            execute(query, (time.time(), outcome, *texts, drive))
            if metrics is not None:
                query = "INSERT INTO steps (participant, step, shown) SELECT participant, step, ended FROM drives"
                execute(f"{query} WHERE id = ? ON CONFLICT DO NOTHING", (drive,))

    def recover(self) -> None:
        """Drives that a killed process has left are broken off."""
        with self._base.transaction() as execute:
            execute("UPDATE drives SET ended = began, outcome = ? WHERE ended IS NULL", (BROKEN_OFF,))

    # ------------------------------------------------------------------ all of it

    def participants(self) -> list[dict[str, Any]]:
        """id, consented, finished, steps done, and the time of the latest event or answer of each participant."""
        times = "SELECT time, participant FROM events UNION ALL SELECT time, participant FROM answers"
        latest = f"SELECT participant, max(time) AS seen FROM ({times}) GROUP BY participant"
        query = f"SELECT {PARTICIPANT}, seen FROM participants LEFT JOIN ({latest}) ON participant = id ORDER BY id"
        rows = self._base.rows(ParticipantRow, query)
        if [row["id"] for row in rows] != list(range(self.study.participants)):
            raise self.wrong("participants", f"does not hold {self.study.participants} participants")
        return rows

    def all_events(self) -> list[dict[str, Any]]:
        """participant, time and what of each event, in the order in which they were stored."""
        rows = self._base.rows(EventRow, "SELECT participant, time, what FROM events ORDER BY participant, rowid")
        return self._placed(rows, "events")

    def all_visits(self) -> dict[int, dict[int, visits.Visit]]:
        """Participant -> page -> when and how long it was open."""
        events: dict[int, list[tuple[float, str]]] = {}
        for row in self.all_events():
            events.setdefault(row["participant"], []).append((row["time"], row["what"]))
        return {participant: visits.visits(some) for participant, some in events.items()}

    def all_steps(self) -> list[dict[str, Any]]:
        """participant, step, shown and done of each step that has begun."""
        return self._placed(self._base.rows(StepRow, "SELECT * FROM steps ORDER BY participant, step"), "steps")

    def all_answers(self) -> list[dict[str, Any]]:
        """participant, step, question, value and time of each answer."""
        return self._answers("SELECT * FROM answers ORDER BY participant, step, rowid")

    def drives(self) -> list[dict[str, Any]]:
        """All drives, without their recordings."""
        query = "SELECT id, participant, step, began, ended, outcome, metrics FROM drives ORDER BY id"
        rows = self._placed(self._base.rows(DriveRow, query), "drives")
        for row in rows:
            if self.steps(row["participant"])[row["step"]].kind != "drive":
                raise self.wrong("drives", f"page {row['step'] + 1} of participant {row['participant'] + 1} is none")
        return rows

    def recording(self, drive: int) -> dict[str, Any] | None:
        """The recording of a drive that came to its end."""
        rows = self._base.rows(RecordingRow, "SELECT recording FROM drives WHERE id = ?", (drive,))
        return rows[0]["recording"] if rows else None

    def moments(self, drive: int) -> list[list[float]]:
        """The control steps of a drive, as in ``add_moments``, all of the same length."""
        rows = self._base.rows(MomentsRow, "SELECT moments FROM moments WHERE drive = ? ORDER BY tick", (drive,))
        found = [moment for row in rows for moment in row["moments"]]
        if len(set(map(len, found))) > 1:
            raise self.wrong("moments", f"drive {drive} has steps with and without a sideways command")
        return found

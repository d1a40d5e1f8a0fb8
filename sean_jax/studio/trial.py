"""Recorded drives: the options, the number of the episode and all commands, from which it is simulated again.

A trial is a file of JSON lines: a head, then the commands of each second, and the outcome at the end. Each line is on
the disk before the next second begins. Trials that ended become demonstrations of a ``learning.Recorder``.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from sean_jax import assembly, components, files
from sean_jax.config import StudioConfig, validate
from sean_jax.errors import FileError, InputError
from sean_jax.learning.collection import Recorder
from sean_jax.learning.dataset import Dataset

VERSION = 1
STOPPED = "stopped"  # outcome of a trial that did not reach the end of its episode
TRIALS, DATASET = "trials", "demonstrations"


class Trial:
    """The file of a drive that goes on."""

    def __init__(self, file: Path, head: dict[str, Any], per_line: int):
        self.file, self._per_line = file, per_line
        self._stream = file.open("x", encoding="utf-8")
        self._pending: list[tuple[float, float]] = []
        self._write(head)

    @classmethod
    def begin(cls, config: StudioConfig, number: int) -> Trial:
        """A new file in the folder for drives."""
        assert config.record is not None
        folder = config.record / TRIALS
        folder.mkdir(parents=True, exist_ok=True)
        head = {"version": VERSION, "options": config.identity(), "episode": number}
        check(config.record, head)
        index = 1 + max((int(path.stem) for path in folder.glob("*.jsonl") if path.stem.isdecimal()), default=-1)
        return cls(folder / f"{index:06d}.jsonl", head, max(1, round(1.0 / config.time_step)))

    def add(self, commands: Iterable[tuple[float, float]]) -> None:
        """Commands of further steps; whole seconds are written."""
        self._pending += commands
        while len(self._pending) >= self._per_line:
            self._write({"commands": self._pending[: self._per_line]})
            del self._pending[: self._per_line]

    def rewind(self, tick: int) -> None:
        """The steps from ``tick`` on did not happen."""
        self._flush()
        self._write({"rewind": tick})

    def end(self, outcome: str) -> None:
        """Write the rest, and close the file; one without commands is deleted."""
        self._flush()
        self._write({"end": outcome or STOPPED})
        self._stream.close()
        if not len(read(self.file)[1]):
            self.file.unlink()

    def _flush(self) -> None:
        if self._pending:
            self._write({"commands": self._pending})
            self._pending = []

    def _write(self, line: dict[str, Any]) -> None:
        self._stream.write(json.dumps(line) + "\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())


def check(folder: Path, head: dict[str, Any]) -> None:
    """Refuse a folder whose trials have other options.

    Raises:
        InputError: it names the first that differs.
    """
    for file in sorted((folder / TRIALS).glob("*.jsonl"))[:1]:
        had, _, _ = read(file)
        had, now = had["options"], json.loads(json.dumps(head["options"]))
        other = next((name for name in {**had, **now} if had.get(name) != now.get(name)), None)
        if other is not None:
            text = f"{folder} has drives with {other} {had.get(other)}, not {now.get(other)}"
            raise InputError(f"record: {text}; choose another folder.")


def read(file: Path) -> tuple[dict[str, Any], np.ndarray, str | None]:
    """The head of a trial, its commands (T, 2) [m/s, rad/s], and its outcome; None: it was killed.

    Raises:
        FileError: it is no trial.
    """
    head, commands, outcome = None, list[list[float]](), None
    lines = files.read_text(file).split("\n")
    for number, text in enumerate(lines[:-1], 1):  # a last line without its end was not written whole
        try:
            line = json.loads(text)
            if head is None:
                head = {name: line[name] for name in ("version", "options", "episode")}
            elif "commands" in line:
                commands += [[float(speed), float(turn)] for speed, turn in line["commands"]]
            elif "rewind" in line:
                del commands[int(line["rewind"]) :]
            else:
                outcome = str(line["end"])
        except (ValueError, KeyError, TypeError):
            raise FileError(f"{file}, line {number}: it is no line of a trial.") from None
    if head is None or head["version"] != VERSION or not all(math.isfinite(x) for row in commands for x in row):
        raise FileError(f"{file} is no trial of this version.")
    return head, np.asarray(commands, float).reshape(-1, 2), outcome


def recover(folder: Path) -> list[Path]:
    """End trials whose program was killed, after the last whole second; their files."""
    recovered = []
    for file in sorted((folder / TRIALS).glob("*.jsonl")):
        _, commands, outcome = read(file)
        if outcome is not None:
            continue
        if not len(commands):
            file.unlink()
            continue
        whole = files.read_bytes(file).rpartition(b"\n")[0]
        with file.open("r+b") as stream:
            stream.truncate(len(whole) + 1)
            stream.seek(0, os.SEEK_END)
            stream.write(json.dumps({"end": STOPPED}).encode() + b"\n")
            os.fsync(stream.fileno())
        recovered.append(file)
    return recovered


def demonstrations(config: StudioConfig) -> Dataset | None:
    """The dataset of the trials in a studio's folder, each simulated again; None without one. Earlier ones are in it.

    Raises:
        InputError: the dataset is another's, or a trial names code that the studio's own options do not.
    """
    folder = config.record
    assert folder is not None
    trials = [(head, commands) for head, commands, outcome in _all(folder) if outcome is not None]
    if not trials:
        return None
    recorded = validate(StudioConfig, trials[0][0]["options"])
    if foreign := sorted(set(components.digests(recorded)) - set(components.digests(config))):
        text = f"the drives in {folder} need the code {foreign[0]}"
        raise InputError(f"record: {text}; start the studio with the same options to use them.")
    with components.trust():  # all code that the trials name is that of the user's own options
        recorder = Recorder(folder / DATASET, assembly.build(recorded)[0], driver="human", seed=recorded.seed)
    for head, commands in trials[recorder.number :]:
        replay(recorder, head["episode"], commands)
        recorder.commit()
    return recorder.data


def _all(folder: Path) -> list[tuple[dict[str, Any], np.ndarray, str | None]]:
    return [read(file) for file in sorted((folder / TRIALS).glob("*.jsonl"))]


def replay(recorder: Recorder, episode: int, commands: np.ndarray) -> Any:
    """The last state of an episode that is simulated again from its commands (T, 2)."""
    state = recorder.begin(recorder.episode_key(episode))
    for action in commands:
        state = recorder.step(jnp.asarray(action))
    return state

"""Episodes of a study: those to watch, and a participant's drive, which is stored each second."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sean_jax.config import StudioConfig
from sean_jax.core.data_types import Scenario
from sean_jax.core.errors import FileError, WriteError
from sean_jax.studies.survey.answers import BROKEN_OFF, Answers
from sean_jax.web import local_server, replay
from sean_jax.web.studio.session import Session, SessionFrame, episode


class Sessions:
    """Sessions of equal options, which share scenario and programs."""

    def __init__(self) -> None:
        self._scenarios: dict[str, Scenario] = {}

    def make(self, config: StudioConfig) -> Session:
        """A session at the beginning of its episode.

        Raises:
            InputError: the options cannot be met.
        """
        identity = {name: value for name, value in config.identity().items() if name not in ("policy", "seed")}
        key = json.dumps(identity, sort_keys=True)
        session = Session(config, self._scenarios.get(key))
        self._scenarios.setdefault(key, session.scenario)
        return session


def recording(session: Session, plan: bool = False, live: str = "") -> dict[str, Any]:
    """The session's episode so far for a player, without names, situations and metrics.

    Args:
        plan: whether the robot's shortest path is drawn.
        live: as of ``replay.recording``, for an episode whose frames follow.
    """
    scenario = session.scenario
    episodes = [] if live else [_plain(session.frames, session.outcome, plan)]
    content = replay.recording(
        episodes, scenario.environment, scenario=scenario, situations=(), time_step=scenario.time_step, live=live
    )
    content["place"]["name"], content["robot"]["name"], content["robot"]["views"] = "", "robot", []
    return content | {"curves": []}


def encoded(first: int, frames: Sequence[SessionFrame]) -> bytes:
    """The message with frames from number ``first`` on."""
    head, numbers = replay.packed(_plain(frames, "", True), ())
    return local_server.framed(head | {"kind": "frames", "first": first}, numbers)


def _plain(frames: Sequence[SessionFrame], outcome: str, plan: bool) -> replay.ReplayEpisode:
    one = episode(frames, "", outcome)
    plain = dataclasses.replace(one.frames, situations=one.frames.situations[..., :0])
    return dataclasses.replace(one, frames=plain, plan=one.plan if plan else None)


class Drive:
    """A drive from its first step to its last."""

    def __init__(self, answers: Answers, session: Session, participant: int, step: int):
        self.session, self.outcome = session, ""
        self.error = ""  # why it has neither been driven nor stored to its end
        self.send: Callable[[bytes], None] = lambda message: None
        self.ended: Callable[[], None] = lambda: None
        """Called in the session's thread when the episode has ended and is stored, or has failed."""
        self._answers, self._number = answers, answers.begin_drive(participant, step)
        self._per_row = max(1, round(1.0 / session.scenario.time_step))
        self._pending: list[list[float]] = []
        self._stored = 0
        self._thread = threading.Thread(target=session.run, name="sean-survey-drive", daemon=True)
        session.drive(True)
        session.send = self._news

    def start(self) -> None:
        """Let time pass."""
        self._thread.start()
        self.session.play(True)

    def close(self) -> None:
        """End the drive; before the end of its episode, it is broken off."""
        self.session.close()
        if self._thread.is_alive():
            self._thread.join()
        if not self.outcome:
            with contextlib.suppress(FileError, WriteError):
                self._store()
                self._answers.end_drive(self._number, BROKEN_OFF)

    def _news(self, kind: str, content: Any) -> None:
        """News of the session, in its thread."""
        if kind == "frames":
            first, frames = content
            self._note(frames[-1])
            self.send(encoded(first, frames))
        elif kind == "status" and content["outcome"] and not self.outcome:
            try:
                self._finish(content["outcome"])
            except (FileError, WriteError) as error:  # such as a full disk
                self.error = str(error)
            self.ended()
        elif kind == "error":
            self.error = content
            self.ended()

    def _finish(self, outcome: str) -> None:
        self._store()
        metrics, whole = self.session.metrics(), recording(self.session, plan=True)
        self._answers.end_drive(self._number, outcome, metrics, whole)
        self.outcome = outcome

    def _note(self, frame: SessionFrame) -> None:
        body = frame.trajectory
        heading = np.asarray(body.heading, float)
        place = [*np.asarray(body.position, float), np.arctan2(heading[1], heading[0])]
        self._pending.append([*self.session.commands[-1], *(round(float(value), 4) for value in place)])
        if len(self._pending) == self._per_row:
            self._store()

    def _store(self) -> None:
        if self._pending:
            self._answers.add_moments(self._number, self._stored, self._pending)
            self._stored += len(self._pending)
            self._pending = []

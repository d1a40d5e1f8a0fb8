"""The server of a study: a page for each participant, and one for the researcher, on this computer.

A participant's page gets one step after the other, and nothing of other participants, policies or metrics. Each answer
is on the disk before the page hears that it is stored. A participant has one tab: a second one takes over, and the
first one is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import http
import json
import secrets
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from sean_jax.core.errors import FileError, InputError, WriteError
from sean_jax.studies.survey import export, visits
from sean_jax.studies.survey.answers import Answers
from sean_jax.studies.survey.drive import Drive, Sessions, encoded, recording
from sean_jax.studies.survey.study import Step, checked
from sean_jax.web import local_server
from sean_jax.web.studio.session import Session

LONGEST = 16_384  # bytes of a message from a page
RATE = 100  # messages of a page in a second; more close it
LINES = 100  # of faults in the terminal, each once
TABS = 16  # of researchers, and besides one for each participant
NEWS = 1.0  # s, between two messages to researchers
PICTURE = (320, 240)  # pixels of a driver's view
PICTURE_INTERVAL = 0.1  # s
WAIT = "Other people drive at the moment. Your drive begins when a place is free."
TOLERANCE = 0.5  # s, by which a film may end before the server expects it
BROKEN = "This page has a fault. Please tell the researcher, and load it again."
NOT_STORED = "This could not be stored. Please tell the researcher, and load this page again."
REPLACED = 4000  # code of a socket that another tab has replaced


@dataclasses.dataclass(eq=False)
class Tab:
    """A page that is open."""

    socket: ServerConnection
    participant: int | None  # None: a researcher
    queue: asyncio.Queue[str | bytes] = dataclasses.field(default_factory=lambda: asyncio.Queue(256))
    closed: asyncio.Event = dataclasses.field(default_factory=asyncio.Event)
    page: int = -1  # number of the page that was sent last
    is_hidden: bool = False
    drive: Drive | None = None
    task: asyncio.Task[None] | None = None  # that waits for a place, and drives

    def put(self, message: dict[str, Any] | bytes) -> None:
        """Send a message; a tab that does not read is closed, and may come again."""
        try:
            self.queue.put_nowait(message if isinstance(message, bytes) else json.dumps(message, allow_nan=False))
        except asyncio.QueueFull:
            asyncio.ensure_future(self.socket.close(1013, "too slow"))


class Survey:
    """An open study."""

    def __init__(self, answers: Answers, page: str, source: Path, report: Callable[[str], None] = lambda text: None):
        """Simulate the episodes to watch that are not in the file, and compile the drives.

        Args:
            source: the file of the study.
            report: is called with what is done at the moment.

        Raises:
            InputError: an episode's options cannot be met.
        """
        self.answers, self.study, self.port = answers, answers.study, 0
        self._page, self._source = page.encode("utf-8"), source
        self._steps = [self.study.steps(number) for number in range(self.study.participants)]
        self._secrets = {secret: number for number, secret in answers.secrets().items()}
        self._tabs: dict[int, Tab] = {}
        self._researchers: set[Tab] = set()
        self._sessions = Sessions()
        self._previews: dict[int, tuple[dict[str, Any], list[bytes]]] = {}  # trial -> what a drive begins with
        self._rules: dict[int, dict[str, float]] = {}  # trial -> s, how long a drive takes, and stays at its goal
        answers.recover()
        self._prepare(report)
        self._lengths = answers.film_lengths()  # trial -> s
        self._places = asyncio.Semaphore(self.study.drivers)
        self._said: set[str] = set()  # in the terminal

    def _prepare(self, report: Callable[[str], None]) -> None:
        stored = self.answers.episodes()
        for index, trial in enumerate(self.study.trials):
            report(f"trial {trial.name}")
            if trial.kind == "drive":
                session = self._session(index)
                session.metrics()  # compile
                messages = [encoded(0, session.frames)]
                if trial.view != "plan":
                    messages.append(_picture(session, trial.view))
                self._previews[index] = recording(session, live="frames"), messages
                limit, hold = session.scenario.time_limit, float(session.scenario.hold_time)
                self._rules[index] = {"limit": round(limit, 2), "hold": round(hold, 2)}
                continue
            for side, options in enumerate(trial.episodes):
                if (index, side) in stored:
                    continue
                config = self.study.config(options, self._source)
                session = self._sessions.make(config)
                session.complete()
                policy = options.get("name", config.policy.label)
                self.answers.add_episode(
                    index, side, policy, session.outcome, session.metrics(), recording(session)
                )  # fmt: skip

    def _session(self, trial: int) -> Session:
        return self._sessions.make(self.study.config(self.study.trials[trial].episodes[0], self._source))

    @property
    def address(self) -> str:
        """Of the pages, without their secrets."""
        return self.study.address or f"http://{local_server.HOST}:{self.port}"

    @property
    def researcher_link(self) -> str:
        """The address of the researcher's page."""
        return f"{self.address}/?researcher={self.answers.researcher}"

    def links(self) -> list[str]:
        """The address of each participant's page."""
        return [f"{self.address}/?participant={secret}" for secret in self._secrets]

    # ------------------------------------------------------------------ requests

    async def run(self, port: int, ready: Callable[[], None]) -> None:
        """Serve until Ctrl-C or SIGTERM.

        Raises:
            OSError: the port is taken.
        """
        with local_server.signals() as stopped:  # before anybody knows the address
            async with local_server.listen(self._serve_tab, self._answer, port, LONGEST) as self.port:
                await asyncio.to_thread(self.answers.keep_port, self.port)
                ready()
                news = asyncio.ensure_future(self._report_progress())
                try:
                    await stopped.wait()
                finally:
                    news.cancel()

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a table, a refusal, or None for a web socket."""
        if (refused := local_server.refusal(request, self.port, self.study.address)) is not None:
            return refused
        who = self._who(request)
        if who is None:
            text = b"wrong link: open the address that you were given, to its last letter"
            return local_server.response(http.HTTPStatus.FORBIDDEN, text)
        path = local_server.path_of(request)
        if path == local_server.SOCKET:
            full = len(self._researchers) >= TABS if who < 0 else False
            return local_server.response(http.HTTPStatus.SERVICE_UNAVAILABLE, b"too many tabs") if full else None
        if who < 0 and path.lstrip("/") in export.TABLES:
            try:
                text = await asyncio.to_thread(export.table, self.answers, path.lstrip("/"))
            except FileError as error:
                return local_server.response(http.HTTPStatus.INTERNAL_SERVER_ERROR, str(error).encode(errors="replace"))
            return local_server.response(http.HTTPStatus.OK, text.encode(), "text/csv; charset=utf-8")
        if path != "/":
            return local_server.response(http.HTTPStatus.NOT_FOUND, b"not found")
        return local_server.page(self._page, self.port, self.study.address)

    def _who(self, request: Request) -> int | None:
        """The participant's number, -1 for the researcher; None for a wrong link."""
        if secrets.compare_digest(
            local_server.query_of(request, "researcher").encode(), self.answers.researcher.encode()
        ):
            return -1
        return self._secrets.get(local_server.query_of(request, "participant"))

    async def _serve_tab(self, socket: ServerConnection) -> None:
        """A tab, from its first message to its last."""
        assert socket.request is not None
        who = self._who(socket.request)
        assert who is not None
        tab = Tab(socket, None if who < 0 else who)
        writer = asyncio.ensure_future(self._write(tab))
        try:
            await self._open(tab)
            began, count = time.monotonic(), 0
            async for message in socket:
                now = time.monotonic()
                began, count = (now, 1) if now > began + 1.0 else (began, count + 1)
                if count > RATE:
                    await socket.close(1008, "too many messages")
                    break
                try:
                    await self._handle(tab, local_server.parse(message))
                except (FileError, WriteError) as error:  # such as a full disk
                    tab.put({"kind": "error", "content": NOT_STORED})
                    self._say(str(error))
                except InputError as error:
                    tab.put({"kind": "error", "content": str(error)})
                except Exception as error:  # a fault of this program ends no page
                    tab.put({"kind": "error", "content": BROKEN})
                    self._say(f"a message of a page failed: {type(error).__name__}: {error}")
        except ConnectionClosed:
            pass
        except (FileError, WriteError) as error:
            self._say(str(error))
            await socket.close(1011, "not stored")
        finally:
            writer.cancel()
            await self._close(tab)

    def _say(self, text: str) -> None:
        """A line in the terminal, once."""
        line = " ".join(text.split())[:300]
        if line not in self._said and len(self._said) < LINES:
            self._said.add(line)
            print(f"sean: {line}", file=sys.stderr, flush=True)

    async def _write(self, tab: Tab) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await tab.socket.send(await tab.queue.get())

    async def _open(self, tab: Tab) -> None:
        if tab.participant is None:
            self._researchers.add(tab)
            tab.put({"kind": "study", "title": self.study.title, "links": self.links(), "tables": list(export.TABLES)})
            tab.put(await self._progress())
            return
        while (other := self._tabs.get(tab.participant)) is not None:
            await other.socket.close(REPLACED, "this study is open in another tab")
            await other.closed.wait()
        self._tabs[tab.participant] = tab
        await asyncio.to_thread(self.answers.event, tab.participant, visits.OPENED)
        await self._show(tab)

    async def _close(self, tab: Tab) -> None:
        if tab.task is not None:
            tab.task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await tab.task
        self._researchers.discard(tab)
        if tab.participant is not None and self._tabs.get(tab.participant) is tab:
            try:
                await asyncio.to_thread(self.answers.event, tab.participant, visits.CLOSED)
            except (FileError, WriteError) as error:
                self._say(str(error))
            del self._tabs[tab.participant]
        tab.closed.set()

    # ------------------------------------------------------------------ a participant

    async def _show(self, tab: Tab) -> None:
        """Send the page at which the participant is."""
        participant = tab.participant
        assert participant is not None
        steps = self._steps[participant]
        consented, done, shown = await asyncio.to_thread(self.answers.progress, participant)
        head = {"title": self.study.title, "number": done, "count": len(steps)}
        if not consented:
            tab.put(head | {"kind": "consent", "text": self.study.consent})
            return
        if tab.page != done:  # not the same one again, such as after a double click
            await asyncio.to_thread(self.answers.event, participant, f"{visits.PAGE} {done}")
            tab.page = done
        if done == len(steps):
            tab.put(head | {"kind": "end", "text": self.study.thanks})
            return
        step = steps[done]
        content: dict[str, Any] = {
            "kind": "step", "what": step.kind, "text": step.text, "questions": step.questions, "view": step.view,
            "shown": shown or step.kind == "questions", "recordings": await asyncio.to_thread(self._recordings, step),
            "answers": await asyncio.to_thread(self.answers.answers_of, participant, done),
            "rules": None if step.trial is None else self._rules.get(step.trial),
        }  # fmt: skip
        tab.put(head | content)
        if step.kind == "drive" and not shown:
            assert step.trial is not None
            for message in self._previews[step.trial][1]:
                tab.put(message)

    def _recordings(self, step: Step) -> list[dict[str, Any]]:
        if step.trial is None:
            return []
        if step.kind == "drive":
            return [self._previews[step.trial][0]]
        sides = [0] if step.kind == "watch" else [1, 0] if step.swapped else [0, 1]
        return [self.answers.film(step.trial, side) for side in sides]

    async def _handle(self, tab: Tab, request: dict[str, Any]) -> None:
        """What a page asks for.

        Raises:
            InputError: one sentence for the participant.
        """
        participant, word = tab.participant, request["do"]
        if participant is None:
            raise InputError("the researcher's page only shows the study.")

        # Commands come many times a second: they need no look at the study's file.
        if word == "command":
            if tab.drive is not None:
                session = tab.drive.session
                session.command(
                    local_server.number(request, "ahead", -1.0, 1.0), local_server.number(request, "left", -1.0, 1.0)
                )
            return

        # The page only tells that it is hidden; the server notes when, by its own clock.
        if word in (visits.HIDDEN, visits.VISIBLE):
            if tab.is_hidden != (word == visits.HIDDEN):
                tab.is_hidden = word == visits.HIDDEN
                await asyncio.to_thread(self.answers.event, participant, word)
            return

        # What a participant may do is read from the file: a page may be old, or not be ours.
        consented, done, shown = await asyncio.to_thread(self.answers.progress, participant)
        if word == "consent":
            if not consented:
                await asyncio.to_thread(self.answers.consent, participant)
            await self._show(tab)
            return
        steps = self._steps[participant]
        if not consented or done == len(steps) or request.get("step") != done:
            await self._show(tab)  # a page that is behind, such as after a double click
            return

        # A page says that its film began or is over; whether it was watched is up to the clock of the server.
        step = steps[done]
        if word == visits.BEGAN and step.kind in ("watch", "choose") and not shown:
            await asyncio.to_thread(self.answers.event, participant, f"{visits.BEGAN} {done}")
        elif word == "shown" and step.kind in ("watch", "choose"):
            await self._show_questions(tab, step, done, shown)
        elif word == "start" and step.kind == "drive" and not shown:
            # Only one drive at a time, also after a double click.
            if tab.task is None or tab.task.done():
                tab.task = asyncio.ensure_future(self._try_drive(tab, step, done))
        elif word == "answer" and (shown or step.kind == "questions"):
            # Each answer is stored at once, so that a closed tab loses none.
            question = step.question(request.get("question"))
            if question is None:
                raise InputError("a question that this page does not have; reload the page.")
            value = checked(question, request.get("value"))
            await asyncio.to_thread(self.answers.answer, participant, done, question["name"], value)
            tab.put({"kind": "stored", "content": question["name"]})
        elif word == "done" and (shown or step.kind == "questions"):
            # Required questions are checked here and not in the page, which anyone can change.
            answers = await asyncio.to_thread(self.answers.answers_of, participant, done)
            missing = [each["name"] for each in step.questions if each["required"] and each["name"] not in answers]
            if missing:
                tab.put({"kind": "missing", "content": missing})
                return
            await asyncio.to_thread(self.answers.finish, participant, done, done + 1 == len(steps))
            await self._show(tab)
        else:
            raise InputError("a request that does not belong to this page; reload the page.")

    async def _show_questions(self, tab: Tab, step: Step, number: int, shown: bool) -> None:
        """Show the questions about a film that a participant has watched; before its end, say how long it still takes.

        The time runs from the film's first picture, by the clock of the server: no page and no program can shorten it.
        """
        assert tab.participant is not None and step.trial is not None
        if not shown:
            watched = await asyncio.to_thread(self.answers.watched, tab.participant, number)
            left = self._lengths[step.trial] - TOLERANCE - watched
            if left > 0:
                await asyncio.to_thread(self.answers.event, tab.participant, f"{visits.EARLY} {number}")
                tab.put({"kind": "early", "content": left})
                return
            await asyncio.to_thread(self.answers.show, tab.participant, number)
            await asyncio.to_thread(self.answers.event, tab.participant, f"{visits.SHOWN} {number}")
        tab.put({"kind": "shown", "content": number})

    async def _try_drive(self, tab: Tab, step: Step, number: int) -> None:
        """A drive, whose failure is told in one sentence and ends neither the page nor the study."""
        try:
            await self._drive(tab, step, number)
        except (FileError, WriteError) as error:
            tab.put({"kind": "error", "content": NOT_STORED})
            self._say(str(error))
        except Exception as error:
            tab.put({"kind": "error", "content": BROKEN})
            self._say(f"a drive failed: {type(error).__name__}: {error}")

    async def _drive(self, tab: Tab, step: Step, number: int) -> None:
        """Wait for a place, and drive."""
        assert tab.participant is not None and step.trial is not None
        if self._places.locked():
            tab.put({"kind": "wait", "content": WAIT})
        async with self._places:
            session = await asyncio.to_thread(self._session, step.trial)
            drive = await asyncio.to_thread(Drive, self.answers, session, tab.participant, number)
            loop, ended = asyncio.get_running_loop(), asyncio.Event()
            drive.send = lambda message: _call(loop, tab.put, message)
            drive.ended = lambda: _call(loop, ended.set)
            tab.put({"kind": "go", "content": session.scenario.time_step})
            tab.drive = drive
            views = asyncio.ensure_future(self._views(tab, session, step.view))
            try:
                drive.start()
                await ended.wait()
            finally:
                tab.drive = None
                views.cancel()
                await asyncio.to_thread(drive.close)
        if drive.outcome:
            tab.put({"kind": "over", "content": drive.outcome})
        else:
            tab.put({"kind": "error", "content": NOT_STORED})
            self._say(drive.error or "a drive has stopped, and could not be stored to its end.")

    async def _views(self, tab: Tab, session: Session, view: str) -> None:
        """Send what the driver sees."""
        sent = -1
        while view != "plan":
            if sent != (sent := len(session.commands)) and tab.queue.qsize() < 3:  # a slow page misses some
                tab.put(await asyncio.to_thread(_picture, session, view))
            await asyncio.sleep(PICTURE_INTERVAL / 2)

    # ------------------------------------------------------------------ researchers

    async def _progress(self) -> dict[str, Any]:
        rows = []
        for row in await asyncio.to_thread(self.answers.participants):
            number = row["id"]
            tab = self._tabs.get(number)
            row |= {"steps": len(self._steps[number]), "open": tab is not None}
            row["drives"] = tab is not None and tab.drive is not None
            rows.append(row)
        return {"kind": "progress", "content": rows}

    async def _report_progress(self) -> None:
        sent = None
        while True:
            await asyncio.sleep(NEWS)
            if self._researchers:
                try:
                    news = await self._progress()
                except FileError as error:
                    self._say(str(error))
                    continue
                if news != sent:
                    sent = news
                    for tab in self._researchers:
                        tab.put(news)


def _picture(session: Session, view: str) -> bytes:
    """The message with what a driver sees."""
    width, height = PICTURE
    head = {"kind": "picture", "name": view, "width": width, "height": height}
    return local_server.framed(head, session.picture(view, width, height).tobytes())


def _call(loop: asyncio.AbstractEventLoop, function: Callable[..., Any], *values: Any) -> None:
    """Call a function in the loop, from another thread."""
    with contextlib.suppress(RuntimeError):  # the loop has ended
        loop.call_soon_threadsafe(function, *values)

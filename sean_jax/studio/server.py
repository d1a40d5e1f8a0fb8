"""The studio's server: one page on 127.0.0.1, and a web socket for each of its tabs.

A message of the server is JSON (a ``hello``, a ``status``, an ``error``, a ``card``) or bytes: four bytes with the
length of a JSON head, the head, and the numbers of frames or of a picture. Frames are encoded as in replays
(``replay.packed``). One tab drives at a time, the others watch.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import http
import json
import secrets
import threading
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from sean_jax import behaviors, environment, flags, policies, replay, robots, tasks, web
from sean_jax.config import StudioConfig, validate
from sean_jax.errors import InputError
from sean_jax.learning.policy import AGENTS
from sean_jax.studio.session import SPEED_RANGE, Choice, Frame, Session, episode
from sean_jax.web import HOST, SOCKET

LONGEST = 4096  # bytes of a message from a page
CONNECTIONS = 32
INTERVAL = 1 / 30  # s, shortest between two messages with frames
VIEWS = {"first_person": (240, 180), "third_person": (240, 180), "depth": (160, 120)}  # pixels
LIDAR, RAYS = "lidar", 180
VIEW_INTERVAL = 0.1  # s
BASELINES = ("go_to_goal", "expert")  # policies beside a person's drive
CHOICES = {
    "environment": environment.available(),
    "task": list(tasks.TASKS),
    "robot": list(robots.ROBOTS),
    "behavior": list(behaviors.BEHAVIORS),
    "policy": [*policies.POLICIES, *AGENTS],
}
OPENED = {*CHOICES, "people", "seed"}  # options that a page can change


class Studio:
    """The tabs of a session."""

    def __init__(self, config: StudioConfig, page: str):
        """Build the scenario of a description; ``close`` ends its thread.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.token = secrets.token_urlsafe(16)
        self.port = 0
        self._page = page.encode("utf-8")
        self._tabs: dict[ServerConnection, asyncio.Queue[str | bytes]] = {}
        self._views: dict[ServerConnection, str] = {}  # which picture a tab shows
        self._driver: ServerConnection | None = None
        self._card: asyncio.Task[None] | None = None  # metrics of the episode that has ended
        self._comparison: asyncio.Task[None] | None = None
        self._frames: list[Frame] = []  # not yet sent
        self._first, self._sent = 0, 0.0  # number of the first of them, and time of the latest message
        self._flush: asyncio.TimerHandle | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._begin(Session(config))

    def _begin(self, session: Session) -> None:
        self.session, self.hello = session, _hello(session)
        self._thread = threading.Thread(target=session.run, name="sean-studio", daemon=True)
        session.send = self.send
        self._thread.start()

    def close(self) -> None:
        """End the session."""
        self.session.close()
        self._thread.join()

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    # ------------------------------------------------------------------ news of the session, from its thread

    def send(self, kind: str, content: Any) -> None:
        """News for all tabs; from any thread."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._broadcast, kind, content)

    def _broadcast(self, kind: str, content: Any) -> None:
        if kind == "frames":
            first, frames = content
            if not self._frames:
                self._first = first
            self._frames += frames
            if self._flush is None:
                assert self._loop is not None
                wait = self._sent + INTERVAL - self._loop.time()
                self._flush = self._loop.call_later(max(0.0, wait), self._send_frames)
            return
        self._send_frames()
        if kind == "hello":
            for message in self._first_messages():
                self._put(message)
            self._card = None
            self._end_comparison()
            return
        self._put({"kind": kind, "content": content})
        if kind == "cut":
            self._card = None
        elif kind == "status" and content["outcome"] and self._card is None:
            self._card = asyncio.ensure_future(self._baselines())

    async def _baselines(self) -> None:
        """Send the metrics of the episode that has ended, and those of policies in it."""
        cards = self.session.baselines(BASELINES)
        while (card := await asyncio.to_thread(next, cards, None)) is not None:
            self._put({"kind": "card", "content": {"driver": card[0], "metrics": card[1]}})

    async def _compare(self, tab: ServerConnection, choices: list[Choice]) -> None:
        """Send the progress and the recordings of a comparison to the tab that asks for it; time stands still."""
        await asyncio.to_thread(self.session.play, False)
        steps = self.session.compare(choices)
        try:
            while (content := await asyncio.to_thread(next, steps, None)) is not None:
                self._put_to(tab, json.dumps({"kind": "comparison", "content": content}, allow_nan=False))
        except Exception as error:  # a policy does not fit, or a user's own part fails
            self._put_to(tab, json.dumps({"kind": "error", "content": f"compare: {error}"}))

    def _end_comparison(self) -> None:
        if self._comparison is not None:
            self._comparison.cancel()
            self._comparison = None

    async def _picture(self) -> None:
        """Send pictures of the present moment to the tabs that show them."""
        sent = weakref.WeakKeyDictionary[ServerConnection, tuple[str, int, int]]()
        while True:
            await asyncio.sleep(VIEW_INTERVAL)
            for name in set(self._views.values()):
                moment = name, self.session.number, len(self.session.commands)
                tabs = [tab for tab, view in self._views.items() if view == name and sent.get(tab) != moment]
                if not tabs:
                    continue
                message = await asyncio.to_thread(self._view, name)
                for tab in tabs:
                    sent[tab] = moment
                    if tab in self._tabs and self._tabs[tab].empty():  # a slow tab misses some
                        self._tabs[tab].put_nowait(message)

    def _view(self, name: str) -> bytes:
        """The message with a picture, or with a scan in mm."""
        if name == LIDAR:
            distances, far = self.session.scan(RAYS)
            head = {"kind": "scan", "name": name, "far": far}
            return web.framed(head, np.minimum(1000.0 * distances, 65535.0).astype("<u2").tobytes())
        width, height = VIEWS[name]
        head = {"kind": "picture", "name": name, "width": width, "height": height}
        return web.framed(head, self.session.picture(name, width, height).tobytes())

    def _send_frames(self) -> None:
        if self._flush is not None:
            self._flush.cancel()
            self._flush = None
        if self._frames:
            message = self._encoded(self._first, self._frames)
            self._frames = []
            self._sent = self._loop.time() if self._loop is not None else 0.0
            self._put(message)

    def _put(self, message: dict[str, Any] | bytes) -> None:
        data = message if isinstance(message, bytes) else json.dumps(message, allow_nan=False)
        for tab in list(self._tabs):
            self._put_to(tab, data)

    def _put_to(self, tab: ServerConnection, data: str | bytes) -> None:
        try:
            self._tabs[tab].put_nowait(data)
        except KeyError:  # it is closed
            pass
        except asyncio.QueueFull:  # a tab that does not read; it may come again
            del self._tabs[tab]
            asyncio.ensure_future(tab.close(1013, "too slow"))

    def _encoded(self, first: int, frames: list[Frame]) -> bytes:
        names = [each["name"] for each in self.hello["recording"]["situations"]]
        head, numbers = replay.packed(episode(frames), names)
        return web.framed(head | {"kind": "frames", "first": first}, numbers)

    # ------------------------------------------------------------------ requests

    async def run(self, port: int, ready: Callable[[], None]) -> None:
        """Serve until Ctrl-C or SIGTERM.

        Raises:
            OSError: the port is taken.
        """
        self._loop = asyncio.get_running_loop()
        with web.signals() as stopped:  # before anybody knows the address
            async with web.listen(self._serve_tab, self._answer, port, LONGEST) as self.port:
                ready()
                pictures = asyncio.ensure_future(self._picture())
                try:
                    await stopped.wait()
                finally:
                    pictures.cancel()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a refusal, or None for a web socket."""
        path = web.path_of(request)
        if (refused := web.refusal(request, self.port)) is not None:
            return refused
        token = web.query_of(request, "token")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            text = b"wrong token: open the address that sean studio has printed"
            return web.response(http.HTTPStatus.FORBIDDEN, text)
        if path == SOCKET:
            if len(self._tabs) >= CONNECTIONS:
                return web.response(http.HTTPStatus.SERVICE_UNAVAILABLE, b"too many tabs")
            return None
        if path != "/":
            return web.response(http.HTTPStatus.NOT_FOUND, b"not found")
        return web.page(self._page, self.port)

    async def _serve_tab(self, tab: ServerConnection) -> None:
        """A tab, from its first message to its last."""
        queue: asyncio.Queue[str | bytes] = asyncio.Queue(256)
        for message in self._first_messages():
            queue.put_nowait(message if isinstance(message, bytes) else json.dumps(message, allow_nan=False))
        self._tabs[tab] = queue
        writer = asyncio.ensure_future(self._write(tab, queue))
        try:
            async for message in tab:
                try:
                    await self._handle(tab, message)
                except InputError as error:
                    queue.put_nowait(json.dumps({"kind": "error", "content": str(error)}))
        except ConnectionClosed:
            pass
        finally:
            self._tabs.pop(tab, None)
            self._views.pop(tab, None)
            writer.cancel()
            if self._driver is tab:  # nobody drives until a tab is there again
                self._end_comparison()
                await asyncio.to_thread(self.session.play, False)
                self._driver = None

    def _first_messages(self) -> list[dict[str, Any] | bytes]:
        """What a tab needs to begin: the scenario, the frames so far, what it can change, and the status."""
        messages: list[dict[str, Any] | bytes] = [self.hello | {"kind": "hello"}]
        messages.append(self._encoded(0, self.session.frames[:]))
        messages.append({"kind": "edit", "content": self.session.edits()})
        return [*messages, {"kind": "status", "content": self.session.status()}]

    async def _write(self, tab: ServerConnection, queue: asyncio.Queue[str | bytes]) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await tab.send(await queue.get())

    async def _handle(self, tab: ServerConnection, message: str | bytes) -> None:
        """What a tab asks for.

        Raises:
            InputError: there is no such request, or another tab drives.
        """
        session, request = self.session, web.parse(message)
        if request["do"] == "view":
            self._views.pop(tab, None)
            if request.get("name") in (*VIEWS, LIDAR):
                self._views[tab] = request["name"]
            return
        if self._driver is None:
            self._driver = tab
        if self._driver is not tab:
            raise InputError("another tab drives; close it, or watch.")
        word = request["do"]
        if word == "command":
            session.command(web.number(request, "ahead", -1.0, 1.0), web.number(request, "left", -1.0, 1.0))
        elif word == "compare":
            choices = _choices(request.get("choices"), session)
            self._end_comparison()
            if choices:
                self._comparison = asyncio.ensure_future(self._compare(tab, choices))
        else:
            await asyncio.to_thread(self._apply, session, word, request)

    def _open(self, options: Any) -> None:
        """Another scenario in place of the present one; the other options stay.

        Raises:
            InputError: the options cannot be met; the present scenario stays.
        """
        if not (isinstance(options, dict) and set(options) <= OPENED):
            raise InputError("open: options that the page does not have; reload the page.")
        config = self.session.config
        values = {name: value for name, value in config.identity().items() if name not in OPENED}
        given = {name: value for name, value in options.items() if value not in ("", None)}
        made = Session(validate(StudioConfig, values | given).replace(record=config.record, port=config.port))
        self.close()
        self._begin(made)
        self.send("hello", None)

    def _apply(self, session: Session, word: str, request: dict[str, Any]) -> None:
        if word == "play":
            session.play(bool(request.get("on")))
        elif word == "step":
            session.step()
        elif word == "speed":
            session.set_speed(web.number(request, "speed", *SPEED_RANGE))
        elif word == "drive":
            session.drive(bool(request.get("on")))
        elif word == "rewind":
            session.rewind(int(web.number(request, "tick", 0, 1e9)))
        elif word == "record":
            session.record() if request.get("on") else session.end_trial()
        elif word == "open":
            self._open(request.get("options"))
        elif word == "edit":
            session.edit(request.get("change") if isinstance(request.get("change"), dict) else {})
        elif word == "undo":
            session.edit(None)
        elif word == "save":
            session.save()
        elif word == "episode":
            session.restart(int(web.number(request, "episode", 0, 2**32 - 1)))
        else:
            raise InputError(f"'{word}' is no request; reload the page.")


@functools.cache
def _places() -> dict[str, Any]:
    """Name -> floor and obstacles, of the environments of the package."""
    return {name: replay.place_of_page(environment.load(environment.find(name))) for name in CHOICES["environment"]}


def _hello(session: Session) -> dict[str, Any]:
    """What a page needs to know of a scenario: first of all messages."""
    config, scenario = session.config, session.scenario
    title = f"{scenario.environment.name} · {scenario.task_name.replace('_', ' ')}"
    options = {"environment": config.environment, "task": config.tasks[0].kind, "robot": config.robot.kind,
               "behavior": config.behavior.kind, "policy": config.policy.kind, "seed": config.seed,
               "people": scenario.people}  # fmt: skip
    return {
        "recording": replay.of_scenario(scenario, [], title, live="frames"),
        "views": [*VIEWS, LIDAR],
        "policy": session.policy.name,
        "command": flags.command("studio", config),
        "record": config.record is not None,
        "options": options,
        "choices": CHOICES,
        "places": _places(),
    }


def _choices(rows: Any, session: Session) -> list[Choice]:
    """The episodes that a page compares; none ends a comparison.

    Raises:
        InputError: a policy that the page does not have, a seed or episode that is no number, or twice the same.
    """
    if not isinstance(rows, list) or len(rows) > 2 or not all(isinstance(row, dict) for row in rows):
        raise InputError("compare: the message has no two episodes; reload the page.")
    policies = {*CHOICES["policy"], session.config.policy.kind}
    if unknown := [row.get("policy") for row in rows if str(row.get("policy")) not in policies]:
        raise InputError(f"compare: policy {unknown[0]!r} is not on the page; reload the page.")
    last = 2**32 - 1
    made = [
        Choice(row["policy"], int(web.number(row, "seed", 0, last)), int(web.number(row, "episode", 0, last)))
        for row in rows
    ]
    if len(set(made)) < len(made):
        raise InputError("compare: both episodes are the same; choose another policy, seed or episode.")
    return made

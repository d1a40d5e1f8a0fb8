"""The studio's server: one page on 127.0.0.1, and a web socket for each of its tabs.

A message of the server is JSON (a ``hello``, a ``status``, an ``error``, a ``card``) or bytes: four bytes with the
length of a JSON head, the head, and the numbers of frames or of a picture. Frames are encoded as in replays
(``replay.packed``). One tab is the driver: it is the first one that asks for something, and the others watch. Each tab
hears its own role with the status, and a driver that loads its page again gets the role back by the tab's name.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import http
import json
import math
import re
import secrets
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from sean_jax import policies, robots, tasks
from sean_jax.config import StudioConfig, flags
from sean_jax.core.errors import InputError, SeanError
from sean_jax.io import writing
from sean_jax.learning.policy import AGENTS
from sean_jax.people import behaviors
from sean_jax.web import local_server, replay
from sean_jax.web.local_server import HOST, SOCKET
from sean_jax.web.studio.session import SPEED_RANGE, Choice, Session, SessionFrame, episode
from sean_jax.web.studio.trial import no_demonstrations
from sean_jax.world import environment

LONGEST = 4096  # bytes of a message from a page
CONNECTIONS = 32
INTERVAL = 1 / 30  # s, shortest between two messages with frames
SLOW = ("edit", "undo", "save", "open")  # requests that may take seconds
VIEWS = {"first_person": (240, 180), "third_person": (240, 180), "depth": (160, 120)}  # pixels
LIDAR, RAYS = "lidar", 180
VIEW_INTERVAL = 0.1  # s
RETURN = 10.0  # s, for which the role of a driver whose tab is gone is kept for it
NAME = re.compile(r"[\w-]{16,64}", re.ASCII)  # of a tab, by which it gets its role back
BASELINES = ("go_to_goal", "expert")  # policies beside a person's drive
CHOICES = {
    "environment": environment.available(),
    "task": list(tasks.TASKS),
    "robot": list(robots.ROBOTS),
    "behavior": list(behaviors.BEHAVIORS),
    "policy": [*policies.POLICIES, *AGENTS],
}
NUMBERS = ("people", "seed")  # further options that a page can change
LAST = 2**32 - 1  # the largest of them


class Studio:
    """The tabs of a session."""

    def __init__(self, config: StudioConfig, page: str, token: str | None = None):
        """Build the scenario of a description; ``close`` ends its thread.

        Args:
            token: the secret of the address; a new one if None.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.token = secrets.token_urlsafe(16) if token is None else token
        self.port = 0
        self._page = page.encode("utf-8")
        self._tabs: dict[ServerConnection, asyncio.Queue[str | bytes]] = {}
        self._views: dict[ServerConnection, str] = {}  # which picture a tab shows
        self._ready = set[str]()  # pictures whose programs are compiled
        self._driver: ServerConnection | None = None
        self._slow = asyncio.Lock()  # requests that take seconds, one after the other
        self._reserved = ""  # name of a driver whose tab is gone
        self._release: asyncio.TimerHandle | None = None  # the end of its time
        self._card: asyncio.Task[None] | None = None  # metrics of the episode that has ended
        self._cards: list[dict[str, Any]] = []  # those that are there
        self._comparison: asyncio.Task[None] | None = None
        self._frames: list[SessionFrame] = []  # not yet sent
        self._first = 0  # number of the first of them
        self._sent = 0.0  # time of the latest message
        self._flush: asyncio.TimerHandle | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._begin(Session(config))

    def _begin(self, session: Session) -> None:
        self.session = session
        self.hello = _hello(session)
        self._thread = threading.Thread(target=session.run, name="sean-studio", daemon=True)
        session.send = self.send
        self._thread.start()

    def close(self) -> None:
        """End the session, and wait for its thread."""
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
            self._end_cards()
            self._end_comparison()
            self._ready.clear()
            for tab in list(self._tabs):
                for message in self._first_messages(tab):
                    self._put_to(tab, message)
            return
        if kind == "status":
            self._put_status(content)
        else:
            self._put({"kind": kind, "content": content})
        if kind == "cut":
            self._end_cards()
        elif kind == "status" and content["outcome"] and self._card is None:
            self._card = asyncio.ensure_future(self._baselines())

    async def _baselines(self) -> None:
        """Send the metrics of the episode that has ended, and those of policies in it; tabs that come get them, too."""
        cards = self.session.baselines(BASELINES)
        while (card := await asyncio.to_thread(next, cards, None)) is not None:
            self._cards.append({"driver": card[0], "metrics": card[1]})
            self._put({"kind": "card", "content": self._cards[-1]})

    def _end_cards(self) -> None:
        if self._card is not None:
            self._card.cancel()
        self._card = None
        self._cards = []

    async def _compare(self, tab: ServerConnection, choices: list[Choice]) -> None:
        """Send the progress and the recordings of a comparison to the tab that asks for it; time stands still."""
        await asyncio.to_thread(self.session.play, False)
        steps = self.session.compare(choices)
        try:
            while (content := await asyncio.to_thread(next, steps, None)) is not None:
                self._put_to(tab, {"kind": "comparison", "content": content})
        except Exception as error:  # a policy does not fit, or a user's own part fails
            self._put_to(tab, {"kind": "error", "content": f"compare: {error}"})

    def _end_comparison(self) -> None:
        if self._comparison is not None:
            self._comparison.cancel()
            self._comparison = None

    async def _show_view(self, name: str) -> None:
        """Send pictures of the present moment to the tabs that show a view; each view waits for its own programs."""
        sent: dict[ServerConnection, tuple[Any, ...]] = {}
        while True:
            await asyncio.sleep(VIEW_INTERVAL)
            session = self.session
            moment = id(session), session.number, len(session.commands)
            showing = [tab for tab, view in self._views.items() if view == name]
            sent = {tab: latest for tab, latest in sent.items() if tab in showing and tab in self._tabs}
            tabs = [tab for tab in showing if sent.get(tab) != moment]
            if not tabs:
                continue
            try:
                message = await asyncio.to_thread(self._view, name)
            except Exception as error:  # such as of a robot without that camera
                for tab in tabs:
                    self._views.pop(tab, None)
                    self._put_to(tab, {"kind": "error", "content": f"view {name}: {str(error)[:200]}"})
                continue
            self._ready.add(name)
            for tab in tabs:
                sent[tab] = moment
                if tab in self._tabs and self._views.get(tab) == name and self._tabs[tab].empty():
                    self._put_to(tab, message)  # a slow tab misses some

    def _view(self, name: str) -> bytes:
        """The message with a picture, or with a scan in mm."""
        if name == LIDAR:
            distances, far = self.session.scan(RAYS)
            head = {"kind": "scan", "name": name, "far": far}
            return local_server.framed(head, np.minimum(1000.0 * distances, 65535.0).astype("<u2").tobytes())
        width, height = VIEWS[name]
        head = {"kind": "picture", "name": name, "width": width, "height": height}
        return local_server.framed(head, self.session.picture(name, width, height).tobytes())

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
        data = message if isinstance(message, bytes) else _text(message)
        for tab in list(self._tabs):
            self._put_to(tab, data)

    def _put_status(self, content: dict[str, Any]) -> None:
        """Send the status to all tabs, each with its own role."""
        for tab in list(self._tabs):
            self._put_to(tab, {"kind": "status", "content": content | {"you": self._role(tab)}})

    def _put_to(self, tab: ServerConnection, message: dict[str, Any] | str | bytes) -> None:
        data = _text(message) if isinstance(message, dict) else message
        try:
            self._tabs[tab].put_nowait(data)
        except KeyError:  # it is closed
            pass
        except asyncio.QueueFull:  # a tab that does not read; it may come again
            del self._tabs[tab]
            asyncio.ensure_future(tab.close(1013, "too slow"))

    def _encoded(self, first: int, frames: list[SessionFrame]) -> bytes:
        names = [situation["name"] for situation in self.hello["recording"]["situations"]]
        head, numbers = replay.packed(episode(frames), names)
        return local_server.framed(head | {"kind": "frames", "first": first}, numbers)

    # ------------------------------------------------------------------ requests

    async def run(self, port: int, ready: Callable[[], None]) -> None:
        """Serve until Ctrl-C or SIGTERM.

        Raises:
            OSError: the port is taken.
        """
        self._loop = asyncio.get_running_loop()
        with local_server.signals() as stopped:  # before anybody knows the address
            async with local_server.listen(self._serve_tab, self._answer, port, LONGEST) as self.port:
                ready()
                views = [asyncio.ensure_future(self._show_view(name)) for name in (*VIEWS, LIDAR)]
                try:
                    await stopped.wait()
                finally:
                    for view in views:
                        view.cancel()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a refusal, or None for a web socket."""
        path = local_server.path_of(request)
        if (refused := local_server.refusal(request, self.port)) is not None:
            return refused
        token = local_server.query_of(request, "token")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            text = b"wrong token: open the address that sean studio has printed"
            return local_server.response(http.HTTPStatus.FORBIDDEN, text)
        if path == SOCKET:
            if len(self._tabs) >= CONNECTIONS:
                return local_server.response(http.HTTPStatus.SERVICE_UNAVAILABLE, b"too many tabs")
            return None
        if path != "/":
            return local_server.response(http.HTTPStatus.NOT_FOUND, b"not found")
        return local_server.page(self._page, self.port)

    async def _serve_tab(self, tab: ServerConnection) -> None:
        """A tab, from its first message to its last."""
        queue: asyncio.Queue[str | bytes] = asyncio.Queue(256)
        name = _name_of(tab)
        self._tabs[tab] = queue
        if name and name == self._reserved and self._driver is None:
            self._drive_by(tab)
        for message in self._first_messages(tab):
            self._put_to(tab, message)
        writer = asyncio.ensure_future(self._write(tab, queue))
        try:
            async for message in tab:
                try:
                    await self._handle(tab, message)
                except SeanError as error:
                    self._put_to(tab, {"kind": "error", "content": str(error)})
                except OSError as error:  # such as a file that cannot be written
                    self._put_to(tab, {"kind": "error", "content": f"{writing.broken(error)}; nothing is changed."})
        except ConnectionClosed:
            pass
        finally:
            self._tabs.pop(tab, None)
            self._views.pop(tab, None)
            writer.cancel()
            if self._driver is tab:
                await self._leave(name)

    def _first_messages(self, tab: ServerConnection) -> list[dict[str, Any] | bytes]:
        """What a tab needs to begin: scenario, frames so far, what it can change, drives, metrics, and the status."""
        session = self.session
        messages: list[dict[str, Any] | bytes] = [self.hello | {"kind": "hello"}]
        messages.append(self._encoded(0, session.frames[:]))
        messages.append({"kind": "edit", "content": session.edits()})
        if (drives := session.drives()) is not None:
            messages.append({"kind": "drives", "content": drives})
        messages += [{"kind": "card", "content": card} for card in self._cards]
        return [*messages, {"kind": "status", "content": session.status() | {"you": self._role(tab)}}]

    async def _write(self, tab: ServerConnection, queue: asyncio.Queue[str | bytes]) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await tab.send(await queue.get())

    # ------------------------------------------------------------------ roles of tabs

    def _role(self, tab: ServerConnection) -> str:
        """Of a tab: ``driver``, ``watcher``, or ``free`` while there is no driver."""
        if self._driver is tab:
            return "driver"
        return "watcher" if self._driver is not None or self._reserved else "free"

    def _drive_by(self, tab: ServerConnection | None, reserved: str = "", tell: bool = True) -> None:
        """Make a tab the driver, or none; the role may be kept for the name of a tab that is gone.

        Args:
            tell: send the roles to all tabs.
        """
        if self._release is not None:
            self._release.cancel()
        self._driver = tab
        self._reserved = reserved
        self._release = None
        if reserved and self._loop is not None:
            self._release = self._loop.call_later(RETURN, self._drive_by, None)
        if tell:
            self._put_status(self.session.status())

    async def _leave(self, name: str) -> None:
        """The driver's tab is gone: time stands still, and its role is kept for a while if it has a name."""
        self._end_comparison()
        heir = next((tab for tab in self._tabs if name and _name_of(tab) == name), None)  # it has loaded its page again
        self._drive_by(heir, name if heir is None else "")
        await asyncio.to_thread(self.session.play, False)

    async def _handle(self, tab: ServerConnection, message: str | bytes) -> None:
        """What a tab asks for.

        Raises:
            InputError: there is no such request, or another tab drives.
        """
        session = self.session
        request = local_server.parse(message)
        word = request["do"]
        if word == "view":
            self._show(tab, request.get("name"))
            return
        if word == "command":  # of the driver alone; it makes nobody the driver
            if self._driver is tab:
                ahead = local_server.number(request, "ahead", -1.0, 1.0)
                left = local_server.number(request, "left", -1.0, 1.0)
                session.command(ahead, left)
            return
        if word == "take":  # the wheel, also from a tab that its person has forgotten
            self._end_comparison()
            self._drive_by(tab, tell=False)  # at once: what the tab before has asked for has no effect from now on
            await asyncio.to_thread(session.play, False)  # which tells all tabs
            return
        if self._role(tab) == "watcher":
            raise InputError("another tab drives; take the wheel, or watch.")
        if self._driver is None:
            self._drive_by(tab)
        if word == "compare":
            choices = _choices(request.get("choices"), session)
            self._end_comparison()
            if choices:
                self._comparison = asyncio.ensure_future(self._compare(tab, choices))
        elif word in SLOW:
            async with self._slow:
                self._check_driver(tab)
                await asyncio.to_thread(self._change, word, request, lambda: self._driver is tab)
        else:
            await asyncio.to_thread(self._apply_of, tab, session, word, request)

    def _check_driver(self, tab: ServerConnection) -> None:
        """Refuse what a tab asked for while it had the wheel.

        Raises:
            InputError: it has it no longer.
        """
        if self._driver is not tab:
            raise InputError("another tab has taken the wheel; nothing is changed.")

    def _show(self, tab: ServerConnection, name: Any) -> None:
        """Let a tab show a view of the sensors, or none; it hears if programs have to be compiled first."""
        self._views.pop(tab, None)
        if name in (*VIEWS, LIDAR):
            self._views[tab] = name
            if name not in self._ready:
                self._put_to(tab, {"kind": "preparing", "content": name})

    def _open(self, options: Any, allowed: Callable[[], bool] = lambda: True) -> None:
        """Another scenario in place of the present one; the other options stay.

        Raises:
            InputError: the options cannot be met, or it is not allowed; the present scenario stays.
        """
        session = Session(_opened(self.session.config, options))
        if not allowed():
            raise InputError("open: another tab has taken the wheel; nothing is changed.")
        self.close()
        self._begin(session)
        self.send("hello", None)

    def _change(self, word: str, request: dict[str, Any], allowed: Callable[[], bool]) -> None:
        """One of the ``SLOW`` requests, which takes effect if it is allowed at its end."""
        session = self.session
        if word == "open":
            self._open(request.get("options"), allowed)
        elif word == "edit":
            session.edit(request.get("change") if isinstance(request.get("change"), dict) else {}, allowed)
        elif word == "undo":
            session.edit(None, allowed)
        else:
            session.save(allowed)

    def _apply_of(self, tab: ServerConnection, session: Session, word: str, request: dict[str, Any]) -> None:
        """Any other request of the driver, if it is the driver when time stands still for it."""
        with session.standing():
            self._check_driver(tab)
            self._apply(session, word, request)

    def _apply(self, session: Session, word: str, request: dict[str, Any]) -> None:
        if word == "play":
            session.play(bool(request.get("on")))
        elif word == "step":
            session.step()
        elif word == "speed":
            session.set_speed(local_server.number(request, "speed", *SPEED_RANGE))
        elif word == "drive":
            session.drive(bool(request.get("on")))
        elif word == "rewind":
            session.rewind(int(local_server.number(request, "tick", 0, 1e9)))
        elif word == "record":
            session.record() if request.get("on") else session.end_trial()
        elif word == "discard":
            session.discard(request.get("file"))
        elif word == "rename":
            session.rename(request.get("file"), request.get("name"))
        elif word == "episode":
            session.restart(int(local_server.number(request, "episode", 0, LAST)))
        else:
            raise InputError(f"'{word[:40]}' is no request; reload the page.")


def _text(message: dict[str, Any]) -> str:
    """A message as JSON; a number that JSON has not, such as of a file, is left out rather than closing all tabs."""
    try:
        return json.dumps(message, allow_nan=False)
    except ValueError:
        return json.dumps(_finite(message), allow_nan=False)


def _finite(value: Any) -> Any:
    """The same with None in place of NaN and infinities."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _name_of(tab: ServerConnection) -> str:
    """The name by which a tab gets its role back; "" without one."""
    assert tab.request is not None
    name = local_server.query_of(tab.request, "tab")
    return name if NAME.fullmatch(name) else ""


def _opened(config: StudioConfig, options: Any) -> StudioConfig:
    """The options with those that a page has changed: choices of the page, and numbers.

    A page can name no file: what it does not offer is refused, unless it is what the user has started the studio with.

    Raises:
        InputError: the page does not have an option or a value, or the options cannot be met.
    """
    if not isinstance(options, dict) or not set(options) <= {*CHOICES, *NUMBERS}:
        raise InputError("open: options that the page does not have; reload the page.")
    before = _options_of_page(config)
    other_behavior = options.get("behavior", before["behavior"]) != before["behavior"]
    changes: dict[str, Any] = {}
    for name, value in options.items():
        if value in ("", None):
            changes[name] = StudioConfig.model_fields[name].default
        elif value == before.get(name) and not (name == "task" and other_behavior):
            continue  # also if it is code that the user has typed
        elif name in NUMBERS:
            changes[name] = _whole(name, value)
        elif value not in CHOICES[name]:
            raise InputError(f"open: {name} {str(value)[:40]!r} is not on the page; reload the page.")
        else:
            changes[name] = value
    if "behavior" in changes and not options.get("task"):
        changes["task"] = None  # as usual for the behavior
    if {"behavior", "environment"} & changes.keys() and "people" not in options:
        changes["people"] = None  # as usual for both
    return config.replace(**changes)


def _whole(name: str, value: Any) -> int:
    """A number of people, or a seed."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= LAST:
        raise InputError(f"open: {name} {str(value)[:40]} is no whole number from 0 to {LAST}; reload the page.")
    return value


def _options_of_page(config: StudioConfig) -> dict[str, Any]:
    """The options that a page can change, as they are."""
    kinds = {name: getattr(config, name).kind for name in ("robot", "behavior", "policy")}
    return {"environment": config.environment, "task": config.tasks[0].kind, **kinds, "seed": config.seed}


@functools.cache
def _places() -> dict[str, Any]:
    """Name -> floor and obstacles, of the environments of the package."""
    return {name: replay.place_of_page(environment.load(environment.find(name))) for name in CHOICES["environment"]}


def _hello(session: Session) -> dict[str, Any]:
    """What a page needs to know of a scenario: first of all messages."""
    config = session.config
    scenario = session.scenario
    title = f"{scenario.environment.name} · {scenario.task_name.replace('_', ' ')}"
    options = _options_of_page(config) | {"people": scenario.people}
    return {
        "recording": replay.of_scenario(scenario, [], title, live="frames"),
        "views": [*VIEWS, LIDAR],
        "policy": session.policy.name,
        "command": flags.command("studio", config),
        "record": config.record is not None,
        "demonstrates": not no_demonstrations(scenario),
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
        raise InputError(f"compare: policy {str(unknown[0])[:40]!r} is not on the page; reload the page.")
    choices = []
    for row in rows:
        seed = int(local_server.number(row, "seed", 0, LAST))
        choices.append(Choice(row["policy"], seed, int(local_server.number(row, "episode", 0, LAST))))
    if len(set(choices)) < len(choices):
        raise InputError("compare: both episodes are the same; choose another policy, seed or episode.")
    return choices

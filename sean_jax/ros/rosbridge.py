"""The rosbridge protocol, version 2, on a websocket: for controllers without ROS, such as roslibpy and roslibjs.

The server has a thread and an event loop of its own. Each client has a short queue for each topic, from which the
oldest message falls when the client is slow. A client that sends more than ``RATE`` messages per second is read later,
so TCP slows it down.
"""

from __future__ import annotations

import asyncio
import base64
import collections
import contextlib
import http
import ipaddress
import json
import math
import secrets
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from sean_jax.config.commands.bridge import host_and_port
from sean_jax.core.errors import InputError
from sean_jax.core.messages import parse_json
from sean_jax.ros.transport import Mailbox, Output
from sean_jax.web import local_server

CONNECTIONS = 128
LONGEST = 65_536  # bytes of a message from a client
QUEUE = 100  # messages of a topic that may wait for a client
RATE = 2_000  # messages per second from a client
BACKLOG = 1_000  # messages that may wait for the event loop
OPENING = 20.0  # s, within which the server starts
ROSAPI = {
    "/rosapi/topics",
    "/rosapi/topic_type",
    "/rosapi/services",
    "/rosapi/nodes",
    "/rosapi/get_time",
    "/rosapi/get_param",
}


class Server:
    """A rosbridge server as a ``Transport``."""

    def __init__(self, place: str, mailbox: Mailbox, outputs: Mapping[str, Output]):
        """Serve an ADDRESS:PORT; port 0 is a free one.

        Raises:
            InputError: the address is none, or not free.
        """
        self._mailbox = mailbox
        self._outputs = dict(outputs)
        self._inputs = mailbox.names.inputs
        self._services = mailbox.names.services
        self._host, self._port = _address(place)
        self._is_local = ipaddress.ip_address(self._host).is_loopback
        self.token = "" if self._is_local else secrets.token_urlsafe(16)
        self._clients: dict[ServerConnection, Client] = {}
        self._subscribed: collections.Counter[str] = collections.Counter()
        self._latest: dict[str, str] = {}  # of latched topics
        self._now = {"sec": 0, "nanosec": 0}  # of /clock
        self._backlog = 0
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._failed: list[OSError] = []
        self._thread = threading.Thread(target=self._run, name="sean-rosbridge", daemon=True)
        self._thread.start()
        self._ready.wait(OPENING)
        if self._failed:
            reason = self._failed[0].strerror or self._failed[0]
            raise InputError(f"rosbridge: {place} is not free ({reason}); give another address with --address.")
        token = f"/?token={self.token}" if self.token else ""
        host = f"[{self._host}]" if ":" in self._host else self._host
        self.address = f"ws://{host}:{self._port}{token}"

    # ------------------------------------------------------------------ of the simulation's thread

    def wanted(self, topic: str) -> bool:
        """Whether a client subscribes to a topic; latched ones are kept for later."""
        return self._outputs[topic].latched or self._subscribed[topic] > 0

    def publish(self, topic: str, message: dict[str, Any]) -> None:
        """Send a message to all clients that subscribe."""
        if topic == "/clock":
            self._now = message["clock"]
        if self._backlog > BACKLOG:  # the loop is busy: what is sent later is newer
            self._mailbox.log(
                "rosbridge busy", "rosbridge: clients send faster than they are served; messages are left out."
            )
            return
        text = json.dumps({"op": "publish", "topic": topic, "msg": _plain(message)}, separators=(",", ":"))
        self._backlog += 1
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._spread, topic, text)

    def close(self) -> None:
        """End the server."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stopped.set)
        self._thread.join(5.0)

    # ------------------------------------------------------------------ of the loop's thread

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        except OSError as error:
            self._failed.append(error)
        finally:
            self._ready.set()
            self._loop.close()

    async def _serve(self) -> None:
        self._stopped = asyncio.Event()
        async with local_server.listen(self._client, self._answer, self._port, LONGEST, self._host) as self._port:
            self._ready.set()
            await self._stopped.wait()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """A refusal, or None for a web socket."""
        token = local_server.query_of(request, "token")
        if self.token and not secrets.compare_digest(token.encode(), self.token.encode()):
            text = b"wrong token: connect to the address that sean bridge has printed"
            return local_server.response(http.HTTPStatus.FORBIDDEN, text)
        names = [f"//{request.headers.get('Host', '')}"]
        origin = request.headers.get("Origin")  # of the page that connects; "null" of a sandbox or a file
        if origin is not None:
            names.append(origin)
        if not self.token and not all(_is_local(local_server.split(name).hostname) for name in names):
            text = b"wrong host or origin: only programs and pages of this computer may connect"
            return local_server.response(http.HTTPStatus.FORBIDDEN, text)
        if len(self._clients) >= CONNECTIONS:
            return local_server.response(http.HTTPStatus.SERVICE_UNAVAILABLE, b"too many clients")
        return None

    def _spread(self, topic: str, text: str) -> None:
        self._backlog -= 1
        if self._outputs[topic].latched:
            self._latest[topic] = text
        for client in self._clients.values():
            client.put(topic, text)

    async def _client(self, connection: ServerConnection) -> None:
        """A client, from its first message to its last."""
        client = self._clients[connection] = Client(connection)
        writer = asyncio.ensure_future(client.write())
        allowance = float(RATE)  # messages that the client may send now
        before = self._loop.time()
        try:
            async for text in connection:
                now = self._loop.time()
                allowance = min(float(RATE), allowance + RATE * (now - before)) - 1.0
                before = now
                if allowance < 0.0:
                    self._mailbox.log(
                        "rosbridge flood", f"rosbridge: a client sends more than {RATE} messages/s; it is slowed down."
                    )
                    await asyncio.sleep(0.1)
                try:
                    self._handle(client, text)
                except (ValueError, TypeError, RecursionError) as error:
                    reason = str(error)[:200]
                    self._mailbox.log("rosbridge message", f"rosbridge: a message was dropped: {reason}.")
                    client.status("error", reason)
        except ConnectionClosed:
            pass
        finally:
            del self._clients[connection]
            for topic in client.topics:
                self._subscribed[topic] -= 1
            writer.cancel()
            for task in client.calls:
                task.cancel()

    def _handle(self, client: Client, text: str | bytes) -> None:
        """One operation of a client.

        Raises:
            ValueError: it is none, or malformed.
        """
        request = parse_json(text)
        if not isinstance(request, dict) or not isinstance(request.get("op"), str):
            raise ValueError("a message without an op")
        op = request["op"]
        if op in ("advertise", "unadvertise", "unadvertise_service", "set_level"):
            return
        if op == "publish":
            self._publish(request)
        elif op == "subscribe":
            self._subscribe(client, request)
        elif op == "unsubscribe":
            if client.topics.pop(_topic(request), None) is not None:
                self._subscribed[_topic(request)] -= 1
        elif op == "call_service":
            if len(client.calls) >= 4:
                raise ValueError("four services of this client are running already")
            task = asyncio.ensure_future(self._call(client, request))
            client.calls.add(task)
            task.add_done_callback(client.calls.discard)
        else:
            raise ValueError(f"the op {op[:40]!r} is not supported")

    def _publish(self, request: dict[str, Any]) -> None:
        """A message of a client, for the simulation."""
        topic = _topic(request)
        if topic not in self._inputs:
            raise ValueError(f"{topic[:80]} is not one of {', '.join(self._inputs)}")
        message = request.get("msg")
        self._mailbox.receive(topic, message if isinstance(message, dict) else {})

    def _subscribe(self, client: Client, request: dict[str, Any]) -> None:
        """Send a topic to a client from now on."""
        topic = _topic(request)
        if topic not in self._outputs:
            raise ValueError(f"{topic[:80]} is not one of {', '.join(self._outputs)}")
        if topic not in client.topics:
            self._subscribed[topic] += 1
        client.subscribe(topic, _whole(request, "throttle_rate", 0), _whole(request, "queue_length", 0))
        if topic in self._latest:
            client.put(topic, self._latest[topic])

    async def _call(self, client: Client, request: dict[str, Any]) -> None:
        """Answer the call of a service."""
        name = str(request.get("service"))
        arguments = request.get("args")
        known = self._services.get(f"/{name.removeprefix('/')}")
        values: Any
        if known is not None:
            answer = await asyncio.to_thread(self._mailbox.request, known)
            values = answer._asdict()
            result = True
        elif name in ROSAPI:
            values = self._rosapi(name, arguments if isinstance(arguments, dict) else {})
            result = True
        else:
            values = f"there is no service {name[:80]}"
            result = False
        response = {"op": "service_response", "service": name, "values": values, "result": result}
        if "id" in request:
            response["id"] = request["id"]
        client.send(response)

    def _rosapi(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """What rosapi's services of these names say of the topics."""
        types = {topic: output.type for topic, output in self._outputs.items()} | self._inputs
        short = {topic: kind.replace("/msg/", "/") for topic, kind in types.items()}
        if name == "/rosapi/topics":
            return {"topics": list(short), "types": list(short.values())}
        if name == "/rosapi/services":
            return {"services": list(self._services)}
        if name == "/rosapi/nodes":
            return {"nodes": [f"/{self._mailbox.names.node}"]}
        if name == "/rosapi/get_time":
            return {"time": _plain(self._now)}
        if name == "/rosapi/get_param":  # its value as JSON; the bridge has one parameter
            is_known = str(arguments.get("name")).removeprefix("/") == "use_sim_time"
            return {"value": "true" if is_known else str(arguments.get("default", "null"))[:1000]}
        return {"type": short.get(str(arguments.get("topic")), "")}


class Client:
    """A client: its topics, and what waits to be sent to it."""

    def __init__(self, connection: ServerConnection):
        self.connection = connection
        self.topics: dict[str, float] = {}  # subscribed -> s between two messages
        self.calls: set[asyncio.Task[None]] = set()
        self._queues: dict[str, collections.deque[str]] = {"": collections.deque(maxlen=QUEUE)}
        self._due: dict[str, float] = {}
        self._there = asyncio.Event()

    def subscribe(self, topic: str, throttle: int, length: int) -> None:
        """Send messages of a topic, at least ``throttle`` ms apart; the newest ``length`` ones wait for the client."""
        self.topics[topic] = throttle / 1000.0
        self._queues[topic] = collections.deque(maxlen=min(length, QUEUE) or QUEUE)
        self._due[topic] = 0.0

    def put(self, topic: str, text: str) -> None:
        """A message of a topic; without effect if the client does not subscribe, or too early."""
        if topic not in self.topics:
            return
        now = asyncio.get_running_loop().time()
        if now >= self._due[topic]:
            self._due[topic] = now + self.topics[topic]
            self._queues[topic].append(text)
            self._there.set()

    def send(self, message: dict[str, Any]) -> None:
        """A message that belongs to no topic."""
        self._queues[""].append(json.dumps(message))
        self._there.set()

    def status(self, level: str, text: str) -> None:
        """A status message."""
        self.send({"op": "status", "level": level, "msg": text})

    async def write(self) -> None:
        """Send what waits, until the connection ends; a client that reads nothing for a while is disconnected."""
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self._there.wait()
                self._there.clear()
                while waiting := [queue for queue in list(self._queues.values()) if queue]:
                    for queue in waiting:
                        if queue:
                            try:  # a ping would wait behind it
                                await asyncio.wait_for(self.connection.send(queue.popleft()), 2 * local_server.PATIENCE)
                            except TimeoutError:
                                return self.connection.transport.abort()


def _address(place: str) -> tuple[str, int]:
    """The address and the port of ADDRESS:PORT.

    Raises:
        InputError: it is none.
    """
    try:
        return host_and_port(place)
    except ValueError as error:
        raise InputError(f"rosbridge: {error}.") from None


def _is_local(name: str | None) -> bool:
    """Whether a name or an address is this computer's alone."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(name or "").is_loopback
    return name == "localhost"


def _topic(request: dict[str, Any]) -> str:
    """The topic of an operation; ValueError if it is no name."""
    topic = request.get("topic")
    if not isinstance(topic, str):
        raise ValueError(f"{request['op']}: the topic is {str(topic)[:40]!r}, and no name")
    return f"/{topic.removeprefix('/')}"


def _whole(request: dict[str, Any], name: str, default: int) -> int:
    value = request.get(name, default)
    value = default if value is None else value
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1e9:
        raise ValueError(f"{name} is {str(value)[:40]!r}, and no number from 0")
    return int(value)


def _plain(value: Any) -> Any:
    """A message for JSON, as rosbridge writes it: bytes in base64, null for what is not finite, both names of times."""
    if isinstance(value, dict):
        if value.keys() == {"sec", "nanosec"}:  # ROS 1 says secs and nsecs
            return {**value, "secs": value["sec"], "nsecs": value["nanosec"]}
        return {name: _plain(field) for name, field in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        if value.dtype == np.uint8:
            return base64.b64encode(value.tobytes()).decode("ascii")
        if value.dtype.kind != "f" or np.isfinite(value).all():
            return value.tolist()
        return [number if math.isfinite(number) else None for number in value.tolist()]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value

"""What the servers of this package share: a port of this computer, refusals of foreign requests, and messages.

The package websockets is imported where it is used: ``sean run`` needs only the words of this module.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import inspect
import json
import logging
import math
import re
import signal
import sys
import threading
import urllib.parse
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import TYPE_CHECKING, Any

from sean_jax.core.errors import InputError
from sean_jax.core.messages import parse_json, shorten

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

HOST = "127.0.0.1"
SOCKET = "/socket"
CONTENT_POLICY = "; ".join(
    [
        "default-src 'none'",
        "script-src 'unsafe-inline'",
        "style-src 'unsafe-inline'",
        "img-src data:",
        "connect-src {}",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    ]
)  # what a page may load: nothing but its socket
ORIGIN = re.compile(
    r"https?://([a-z0-9]([a-z0-9-]*[a-z0-9])?(\.[a-z0-9]([a-z0-9-]*[a-z0-9])?)*|\[[0-9a-f:.]+\])(:[0-9]{1,5})?"
)
"""An origin: names of letters, digits and inner hyphens, or an address of IPv6; it stands in ``CONTENT_POLICY``."""
PATIENCE = 5.0  # s, until a connection that does not answer is closed


@contextlib.asynccontextmanager
async def listen(
    serve_tab: Callable[[ServerConnection], Awaitable[None]],
    answer: Callable[[ServerConnection, Request], Response | None | Awaitable[Response | None]],
    port: int,
    longest: int,
    host: str = HOST,
) -> AsyncIterator[int]:
    """Serve a port of this computer within the block, which gets its number; 0 is a free one.

    Whatever a request or a tab holds, the terminal shows one line of each kind of error, and the server goes on.

    Args:
        longest: bytes of a message from a page.
        host: address of this computer; by default other computers cannot connect.

    Raises:
        OSError: the port is taken.
    """
    from websockets.asyncio.server import serve
    from websockets.exceptions import ConnectionClosed

    log = ServerLog()

    async def guarded_answer(connection: ServerConnection, request: Request) -> Response | None:
        try:
            check_request(request)
            answered = answer(connection, request)
            return await answered if inspect.isawaitable(answered) else answered
        except InputError as error:
            return response(http.HTTPStatus.BAD_REQUEST, str(error).encode())
        except Exception as error:
            log.tell("a request", error)
            return response(http.HTTPStatus.BAD_REQUEST, b"a request that cannot be answered")

    async def guarded_tab(tab: ServerConnection) -> None:
        try:
            await serve_tab(tab)
        except ConnectionClosed:
            pass
        except Exception as error:
            log.tell("a tab was closed by a message that", error)
            await tab.close(1011, "a message that cannot be answered; reload the page")

    async with serve(
        guarded_tab,
        host,
        port,
        process_request=guarded_answer,
        logger=log.logger,
        max_size=longest,
        open_timeout=PATIENCE,
        ping_interval=PATIENCE,
        ping_timeout=2 * PATIENCE,
        close_timeout=1.0,
        compression=None,
        server_header=None,
    ) as server:
        yield server.sockets[0].getsockname()[1]


@contextlib.contextmanager
def signals() -> Iterator[asyncio.Event]:
    """An event that Ctrl-C and SIGTERM set within the block, unless they are ignored; other threads get none."""
    loop = asyncio.get_running_loop()
    stopped = asyncio.Event()
    kinds = [kind for kind in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(kind) is not signal.SIG_IGN]
    if threading.current_thread() is not threading.main_thread():
        kinds = []
    before = {kind: signal.getsignal(kind) for kind in kinds}
    for kind in kinds:
        loop.add_signal_handler(kind, stopped.set)
    try:
        yield stopped
    finally:
        for kind, handler in before.items():
            loop.remove_signal_handler(kind)
            signal.signal(kind, handler)


class ServerLog:
    """What a server tells in the terminal: a line for each kind of error, once."""

    def __init__(self) -> None:
        self._told = set[str]()
        self.logger = logging.Logger(
            "sean_jax.web.local_server", logging.CRITICAL + 1
        )  # the tracebacks of websockets are no news

    def tell(self, what: str, error: BaseException) -> None:
        """One line about an error that nobody expected."""
        kind = type(error).__name__
        if kind not in self._told:
            self._told.add(kind)
            reason = " ".join(str(error).split())
            print(f"sean: {what} failed ({kind}: {shorten(reason, 200)}).", file=sys.stderr, flush=True)


def split(address: str) -> urllib.parse.SplitResult:
    """The parts of an address.

    Raises:
        InputError: it is none, such as ``http://[`` or one with port 99999999.
    """
    try:
        url = urllib.parse.urlsplit(address)
        _ = url.port, url.hostname  # are read only now
    except ValueError:
        raise InputError(f"{shorten(repr(address))} is no address.") from None
    return url


def is_origin(address: str) -> bool:
    """Whether an address is scheme, host and perhaps port alone, as https://study.example.org."""
    return bool(ORIGIN.fullmatch(address)) and _is_address(address)


def _is_address(address: str) -> bool:
    try:
        return bool(split(address).hostname)
    except InputError:
        return False


def path_of(request: Request) -> str:
    """The path of a request, without its query."""
    return split(request.path).path


def query_of(request: Request, name: str) -> str:
    """The first value of a name in a request's query; "" without one."""
    return urllib.parse.parse_qs(split(request.path).query).get(name, [""])[0]


def check_request(request: Request) -> None:
    """Refuse a request with a malformed address, host or origin, or with several of them.

    Raises:
        InputError: what is wrong.
    """
    split(request.path)
    for name, start in (("Host", "//"), ("Origin", "")):
        values = request.headers.get_all(name)
        if len(values) > 1:
            raise InputError(f"a request with {len(values)} {name} headers.")
        for value in values:
            split(start + value)


def refusal(request: Request, port: int, address: str | None = None) -> Response | None:
    """The answer to a request for another host, or of a socket from a page of another origin; None if it is neither.

    Args:
        address: a public address, such as https://study.example.org, besides those of this computer.
    """
    origins = _origins(port, address)
    hosts = {split(origin).netloc for origin in origins}
    if request.headers.get("Host") not in hosts:  # a page elsewhere whose name was turned to this computer
        return response(http.HTTPStatus.FORBIDDEN, b"wrong host")
    if path_of(request) == SOCKET and request.headers.get("Origin") not in origins:
        return response(http.HTTPStatus.FORBIDDEN, b"wrong origin")
    return None


def _origins(port: int, address: str | None) -> list[str]:
    own = [f"http://{name}:{port}" for name in (HOST, "localhost")]
    return own if address is None else [*own, address]


def page(content: bytes, port: int, address: str | None = None) -> Response:
    """A page that loads nothing but its socket; arguments as of ``refusal``."""
    answer = response(http.HTTPStatus.OK, content, "text/html; charset=utf-8")
    sockets = (origin.replace("http", "ws", 1) for origin in _origins(port, address))
    answer.headers["Content-Security-Policy"] = CONTENT_POLICY.format(" ".join(sockets))
    return answer


def response(status: http.HTTPStatus, body: bytes, kind: str = "text/plain; charset=utf-8") -> Response:
    """An answer that nobody stores, and whose address no other page learns."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Connection": "close",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
    )
    return Response(status.value, status.phrase, headers, body)


def framed(head: dict[str, Any], content: bytes) -> bytes:
    """Bytes with a JSON head."""
    text = json.dumps(head, allow_nan=False).encode()
    return len(text).to_bytes(4, "little") + text + content


def parse(message: str | bytes) -> dict[str, Any]:
    """A page's request, without NaN, numbers that are too large, half characters and endless levels.

    Raises:
        InputError: it is none.
    """
    try:
        request = parse_json(message)
    except ValueError:
        request = None
    if not isinstance(request, dict) or not isinstance(request.get("do"), str):
        raise InputError("a message that is no request; reload the page.")
    return request


def number(request: dict[str, Any], name: str, low: float, high: float) -> float:
    """A number of a request, between two limits.

    Raises:
        InputError: it is no number.
    """
    value = request.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise InputError(f"{name}: {shorten(repr(value))} is no number; reload the page.")
    return float(min(max(value, low), high))  # of the smaller number, as the largest have no float

"""What the servers of this package share: a port of this computer, refusals of foreign requests, and messages."""

from __future__ import annotations

import asyncio
import contextlib
import http
import json
import math
import signal
import threading
import urllib.parse
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from sean_jax.errors import InputError

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

    Args:
        longest: bytes of a message from a page.
        host: address of this computer; by default other computers cannot connect.

    Raises:
        OSError: the port is taken.
    """
    async with serve(
        serve_tab, host, port, process_request=answer, max_size=longest, open_timeout=PATIENCE,
        ping_interval=PATIENCE, ping_timeout=2 * PATIENCE, close_timeout=1.0, compression=None, server_header=None,
    ) as server:  # fmt: skip
        yield server.sockets[0].getsockname()[1]


@contextlib.contextmanager
def signals() -> Iterator[asyncio.Event]:
    """An event that Ctrl-C and SIGTERM set within the block, unless they are ignored; other threads get none."""
    loop, stopped = asyncio.get_running_loop(), asyncio.Event()
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


def refusal(request: Request, port: int, address: str | None = None) -> Response | None:
    """The answer to a request for another host, or of a socket from a page of another origin; None if it is neither.

    Args:
        address: a public address, such as https://study.example.org, besides those of this computer.
    """
    origins = _origins(port, address)
    hosts = {urllib.parse.urlsplit(origin).netloc for origin in origins}
    if request.headers.get("Host") not in hosts:  # a page elsewhere whose name was turned to this computer
        return response(http.HTTPStatus.FORBIDDEN, b"wrong host")
    is_socket = urllib.parse.urlsplit(request.path).path == SOCKET
    if is_socket and request.headers.get("Origin") not in origins:
        return response(http.HTTPStatus.FORBIDDEN, b"wrong origin")
    return None


def _origins(port: int, address: str | None) -> list[str]:
    own = [f"http://{name}:{port}" for name in (HOST, "localhost")]
    return own if address is None else [*own, address]


def page(content: bytes, port: int, address: str | None = None) -> Response:
    """A page that loads nothing but its socket; arguments as of ``refusal``."""
    made = response(http.HTTPStatus.OK, content, "text/html; charset=utf-8")
    sockets = (origin.replace("http", "ws", 1) for origin in _origins(port, address))
    made.headers["Content-Security-Policy"] = CONTENT_POLICY.format(" ".join(sockets))
    return made


def response(status: http.HTTPStatus, body: bytes, kind: str = "text/plain; charset=utf-8") -> Response:
    """An answer that nobody stores, and whose address no other page learns."""
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
    """A page's request.

    Raises:
        InputError: it is none.
    """
    try:
        request = json.loads(message)
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
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{name}: {value!r} is no number; reload the page.")
    return min(max(float(value), low), high)

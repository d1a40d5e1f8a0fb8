"""Requests and messages that no page of this package sends, and what a server must do with them."""

import json
import socket

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

SOCKET_HEADERS = (
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {}\r\n".format(
        "dGhlIHNhbXBsZSBub25jZQ=="
    )
)
PLACES = [
    "//[",
    "http://[",
    "http://[::1",
    "/%ff%fe",
    "/?token=%ed%a0%80",
    "/?" + "a=1&" * 500,
    "*",
    "/\x7f",
    "//",
    "/../..",
    "http://127.0.0.1:99999999/",
    "/?participant=%00",
    "/socket?token[]=1",
    "/" + "x" * 9000,
]
HEADERS = [
    "Host: [",
    "Host: 127.0.0.1:99999999",
    "Host: a\r\nHost: b",
    "Host: ",
    "Origin: http://[",
    "Origin: null",
    "Origin: http://a:x",
    "Origin: http://a\r\nOrigin: http://b",
    "Origin: \xff",
    "Host: [::1",
    "X: " + "y" * 9000,
    "Content-Length: 99999999999999999999",
    "Transfer-Encoding: chunked",
    "Cookie: " + "a=b;" * 900,
]
DIGITS = "9" * 400
WORDS = "", "nothing", "__class__", "../../etc/passwd", "x" * 3000
MESSAGES = [
    "",
    "{",
    "null",
    "[]",
    "7",
    '"x"',
    "[" * 2000,
    '{"a":' * 2000,
    '{"do":' + "[" * 2000,
    DIGITS,
    "\x00",
    b"\xff\xfe",
    b"",
    *(json.dumps({"do": word, "op": word, "topic": word}) for word in WORDS),
    *(
        f'{{"do":"command","op":"publish","topic":"/cmd_vel","ahead":{value},"left":{value},"msg":{{"linear":{{"x":{value}}}}}}}'
        for value in (
            DIGITS,
            "-" + DIGITS,
            "1e999",
            "NaN",
            "Infinity",
            '"\\ud83d"',
            "[1]",
            "{}",
            "null",
            "true",
            "1e300",
        )
    ),
    *(
        f'{{"do":"{word}","op":"{word}","{key}":{value},"id":{value},"args":{value}}}'
        for word, key in (
            ("rewind", "tick"),
            ("speed", "speed"),
            ("open", "options"),
            ("edit", "change"),
            ("compare", "choices"),
            ("answer", "answers"),
            ("call_service", "service"),
            ("subscribe", "topic"),
        )
        for value in (DIGITS, '"\\udc00"', "[[[[1]]]]", '{"policy":"live/evil.py:go","task":"evil.py:go"}')
    ),
]


def ask(port: int, place: str = "/", header: str = "", name: str = "127.0.0.1") -> bytes:
    """What a server answers to one request."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
        host = "" if header.startswith("Host") else f"Host: {name}:{port}\r\n"
        more = f"{header}\r\n" if header else ""
        text = f"GET {place} HTTP/1.1\r\n{host}{SOCKET_HEADERS if 'Origin' in header else ''}{more}\r\n"
        connection.sendall(text.encode("latin-1"))
        connection.settimeout(10)
        try:
            return connection.recv(1 << 16)
        except ConnectionError:
            return b""


def send_all(address: str, origin: str | None) -> int:
    """Send each message, on a new connection where the server has closed the last; the number of connections."""
    waiting, connections = list(MESSAGES), 0
    while waiting:
        connections += 1
        with connect(address, origin=origin, compression=None, max_size=None, max_queue=None) as tab:
            try:
                while waiting:
                    tab.send(waiting.pop(0))
                    tab.ping().wait(1)
            except ConnectionClosed:
                pass
    return connections


def attack(port: int, address: str, origin: str | None) -> None:
    """Send everything; whoever calls looks at what the terminal shows."""
    for place in PLACES:
        answer = ask(port, place)
        assert not answer.startswith((b"HTTP/1.1 5", b"HTTP/1.0 5", b"HTTP/1.1 101")), (place, answer[:200])
    for header in HEADERS:
        answer = ask(port, "/socket", header)
        assert not answer.startswith((b"HTTP/1.1 5", b"HTTP/1.0 5", b"HTTP/1.1 101")), (header, answer[:200])
    if address:
        send_all(address, origin)


def check_terminal(said: str) -> None:
    """AssertionError for a traceback, or for more than a line of a kind."""
    lines = [line for line in said.splitlines() if line.strip()]
    assert "Traceback" not in said and "  File " not in said, said
    assert len(lines) == len(set(lines)) and len(lines) <= 5, said

"""``sean run --live``: the replay page of the first episode during the run, served to this computer only.

The page requests new frames twice a second. All encoded frames of the episode stay in memory, so a page that is opened
later, or reloaded, begins at the first frame.
"""

import contextlib
import json
import socket
import sys
import threading
import urllib.parse
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import jax
import numpy as np

from sean_jax.core.data_types import Scenario, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.web import local_server, replay

HOST = "127.0.0.1"
FRAMES = "frames"
CONNECTIONS = 16  # at once, a thread each; of more, the oldest is closed
PATIENCE = 5.0  # s, for which a connection may be silent


class Live:
    """An episode on its way to the page."""

    def __init__(self, names: list[str], port: int):
        self.url = f"http://{HOST}:{port}/"
        self._names = names
        self._chunks: list[str] = []  # of frames, as JSON
        self._over = False
        self._outcome = ""
        self._lock = threading.Lock()

    def add(self, chunk: Trajectory) -> None:
        """Take the next chunk of frames (T, B, ...); the first episode is served until its end."""
        frames = jax.tree.map(lambda leaf: np.asarray(leaf)[:, 0], chunk)
        length = int(frames.active.sum())
        if self._over or length == 0:
            return
        episode = replay.ReplayEpisode(jax.tree.map(lambda leaf: leaf[:length], frames), "")
        text = json.dumps(replay.encoded(episode, self._names), separators=(",", ":"), allow_nan=False)
        with self._lock:
            self._chunks.append(text)

    def finish(self, outcome: str) -> None:
        """The episode has ended."""
        with self._lock:
            self._over = True
            self._outcome = outcome

    def since(self, first: int) -> str:
        """The chunks from an index on as JSON, whose layout is in ``web/src/stream.ts``."""
        with self._lock:
            end = f'"over":{json.dumps(self._over)},"outcome":{json.dumps(self._outcome)}'
            return f'{{"chunks":[{",".join(self._chunks[first:])}],{end}}}'


class _Server(ThreadingHTTPServer):
    """A server with few connections, which prints nothing in the terminal when a browser ends one."""

    daemon_threads = True

    def __init__(self, page: bytes, names: list[str]):
        self.page = page
        self._open: dict[Any, None] = {}  # sockets, the oldest first
        self._guard = threading.Lock()
        self._log = local_server.ServerLog()
        super().__init__((HOST, 0), _Handler)
        self.live = Live(names, self.server_port)

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._guard:
            if len(self._open) >= CONNECTIONS:
                oldest = next(iter(self._open))
                del self._open[oldest]
                with contextlib.suppress(OSError):
                    oldest.shutdown(socket.SHUT_RDWR)  # its thread reads an end, and ends
            self._open[request] = None
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._guard:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        error = sys.exception()
        if error is not None and not isinstance(error, OSError):
            self._log.tell("a request", error)


class _Handler(BaseHTTPRequestHandler):
    """Answers requests for the page and for frames."""

    server: _Server
    timeout = PATIENCE

    def do_GET(self) -> None:
        hosts = [[f"{name}:{self.server.server_port}"] for name in (HOST, "localhost")]
        if self.headers.get_all("Host", []) not in hosts:  # a page elsewhere whose name was turned to this computer
            self.send_error(403)
            return
        try:
            url = local_server.split(self.path)
        except InputError:
            self.send_error(400)
            return
        first = urllib.parse.parse_qs(url.query).get("from", ["0"])[0]
        if url.path == "/":
            self._answer(self.server.page, "text/html; charset=utf-8")
        elif url.path == f"/{FRAMES}" and first.isdecimal() and len(first) < 10:
            self._answer(self.server.live.since(int(first)).encode("utf-8"), "application/json")
        else:
            self.send_error(404)

    def _answer(self, content: bytes, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the terminal shows the progress of the run."""


@contextlib.contextmanager
def serve(scenario: Scenario, title: str) -> Iterator[Live]:
    """Serve the page on a free port of 127.0.0.1 until the block ends."""
    content = replay.of_scenario(scenario, [], title, live=FRAMES)
    page = replay.html(content, linked=False).encode("utf-8")
    with _Server(page, [name for name, _ in scenario.situations]) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), name="sean-live", daemon=True)
        thread.start()
        try:
            yield server.live
        finally:
            server.shutdown()
            thread.join()

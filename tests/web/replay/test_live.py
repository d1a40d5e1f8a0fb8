"""``sean run --live``: what is served is what is simulated, to this computer alone, until the run is over."""

import contextlib
import json
import socket
import struct
import subprocess
import threading
import time
import urllib.error
import urllib.request
from typing import Any

import jax
import numpy as np
import pytest

import support.replays
from sean_jax.cli import command_line
from sean_jax.io.trajectories import load_trajectory
from sean_jax.web.replay import live
from support.checkout import WEB
from support.replays import decode
from support.web import chromium

walked = support.replays.walked  # a fixture


def get(url: str, **headers: str) -> str:
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=5) as answer:
        return answer.read().decode("utf-8")


def part(frames: Any, begin: int, end: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[begin:end], frames)


def column(told: dict[str, Any], name: str) -> np.ndarray:
    """Of all chunks, one after the other."""
    return np.concatenate([decode(chunk, chunk["frames"])[name] for chunk in told["chunks"]])


def test_the_page_gets_each_frame_once_and_whoever_comes_late_gets_all(walked):
    scenario, frames = walked
    with live.serve(scenario, "a <run>") as served:
        page = get(served.url)
        assert "a &lt;run&gt;" in page and '"live":"frames"' in page and '"episodes":[]' in page
        assert json.loads(get(f"{served.url}frames?from=0")) == {"chunks": [], "over": False, "outcome": ""}
        served.add(part(frames, 0, 35))
        first = json.loads(get(f"{served.url}frames?from=0"))
        served.add(part(frames, 35, 60))
        second = json.loads(get(f"{served.url}frames?from=1"))
        assert [len(each["chunks"]) for each in (first, second)] == [1, 1]
        served.finish("completed")
        late = json.loads(get(f"{served.url}frames"))
        assert late["over"] and late["outcome"] == "completed"
        assert late["chunks"] == first["chunks"] + second["chunks"]
        served.add(part(frames, 0, 35))
        assert json.loads(get(f"{served.url}frames")) == late, "of another batch"
    np.testing.assert_allclose(column(late, "robot x")[:, 0], frames.position[:, 0, 0], atol=0.006)
    np.testing.assert_allclose(column(late, "person y"), frames.people[:, 0, :, 1], atol=0.006)
    np.testing.assert_array_equal(column(late, "situation"), frames.situations[:, 0])


def test_what_follows_an_episodes_end_is_not_served(walked):
    scenario, frames = walked
    ended = frames.replace(active=np.arange(60)[:, None] < np.array([20, 60]))
    with live.serve(scenario, "") as served:
        for begin in (0, 15, 30, 45):
            served.add(part(ended, begin, begin + 15))
        told = json.loads(get(f"{served.url}frames"))
    assert [chunk["frames"] for chunk in told["chunks"]] == [15, 5]


def test_nobody_else_is_served(walked):
    """Neither other addresses, nor pages elsewhere that name this one, nor other paths; and nobody afterwards."""
    with live.serve(walked[0], "") as served:
        port = int(served.url.split(":")[2].strip("/"))
        assert served.url == f"http://127.0.0.1:{port}/"
        assert get(served.url, Host=f"localhost:{port}")
        for path, headers, code in (
            ("", {"Host": f"evil.example:{port}"}, 403),
            ("", {"Host": "127.0.0.1"}, 403),
            ("etc/passwd", {}, 404),
            ("../pyproject.toml", {}, 404),
            ("frames?from=-1", {}, 404),
            ("frames?from=x", {}, 404),
        ):
            with pytest.raises(urllib.error.HTTPError) as refused:
                get(served.url + path, **headers)
            assert refused.value.code == code, path
        with pytest.raises(OSError), socket.create_connection(("127.0.0.2", port), timeout=2):
            pass
    with pytest.raises(urllib.error.URLError):
        get(served.url)


def test_connections_that_break_off_say_nothing_in_the_terminal(walked, capfd):
    """Reset before, within and after a request, while the page is served to others."""
    with live.serve(walked[0], "") as served:
        port = int(served.url.split(":")[2].strip("/"))
        for turn in range(60):
            connection = socket.create_connection((live.HOST, port), timeout=5)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # closing resets it
            request = f"GET / HTTP/1.1\r\nHost: {live.HOST}:{port}\r\n\r\n".encode()
            connection.sendall(request[: len(request) * (turn % 5) // 4])
            if turn % 2:
                time.sleep(0.002)
            connection.close()
        assert "<html" in get(served.url)
    assert capfd.readouterr().err == ""


def test_half_open_requests_keep_few_threads_and_nobody_out(walked):
    before = threading.active_count()
    with live.serve(walked[0], "") as served:
        port = int(served.url.split(":")[2].strip("/"))
        with contextlib.ExitStack() as stack:
            opened = []
            for _ in range(4 * live.CONNECTIONS):
                opened.append(stack.enter_context(socket.create_connection((live.HOST, port), timeout=20)))
                opened[-1].sendall(b"GET / HT")
                assert "<html" in get(served.url)
            for connection in opened[: 3 * live.CONNECTIONS]:  # the oldest were closed by the server
                with contextlib.suppress(ConnectionResetError):
                    assert connection.recv(1) == b""
            for _ in range(2000):
                if threading.active_count() <= before + 1 + live.CONNECTIONS:
                    break
                time.sleep(0.01)
            assert threading.active_count() <= before + 1 + live.CONNECTIONS


def test_a_silent_connection_is_closed(walked, monkeypatch):
    monkeypatch.setattr(live, "PATIENCE", 0.05)
    with live.serve(walked[0], "") as served:
        port = int(served.url.split(":")[2].strip("/"))
        with socket.create_connection((live.HOST, port), timeout=20) as connection:
            connection.sendall(b"GET / HT")
            assert connection.recv(1) == b""


@pytest.mark.night
def test_a_run_serves_its_first_episode(tmp_path, monkeypatch, capsys):
    """The frames that it writes are those that it served, chunk by chunk while it ran."""
    told: list[dict[str, Any]] = []
    add, finish = live.Live.add, live.Live.finish

    def asked(function: Any) -> Any:
        def then(served: live.Live, given: Any) -> None:
            function(served, given)
            told.append(json.loads(get(f"{served.url}frames")))

        return then

    monkeypatch.setattr(live.Live, "add", asked(add))
    monkeypatch.setattr(live.Live, "finish", asked(finish))
    out = tmp_path / "out"
    words = "run --environment lab --people 2 --dynamics twin --time-limit 12 --episodes 3 --batch 2".split()
    words += ["--metrics", "path_length", "--live", "--trajectories", "csv", "--out", str(out)]
    assert command_line.main(words) == 0
    assert "live: http://127.0.0.1:" in capsys.readouterr().out
    assert [len(each["chunks"]) for each in told] == [1, 2, 2] and [each["over"] for each in told] == [
        False,
        False,
        True,
    ]
    frames = load_trajectory(out / "trajectories.csv")
    length = int(frames.active[0].sum())
    np.testing.assert_allclose(column(told[-1], "robot x")[:, 0], frames.position[0, :length, 0], atol=0.006)
    assert told[-1]["outcome"].endswith(f"in {0.1 * length:.1f} s")


def test_quiet_and_live_are_refused_together(capsys):
    assert command_line.main(["run", "--live", "--quiet"]) == 2
    assert "live: its address is printed" in capsys.readouterr().err


@pytest.mark.web
def test_a_browser_plays_it_while_it_grows(walked):
    command, (scenario, frames) = chromium(), walked
    with live.serve(scenario, "growing") as served:
        words = ["node", "test/live.mjs", served.url, command, "60"]
        with subprocess.Popen(words, cwd=WEB, stdout=subprocess.PIPE, text=True) as browser:
            assert browser.stdout is not None
            served.add(part(frames, 0, 35))
            assert browser.stdout.readline() == "grown\n"
            served.add(part(frames, 35, 60))
            served.finish("completed in 6.0 s")
            seen = json.loads(browser.communicate(timeout=60)[0])
    assert seen["errors"] == [] and {f"http://{host}/" for host in seen["hosts"]} == {served.url}
    assert seen["grew"] == [35, 60] and seen["playing"] and seen["outcome"] == "completed in 6.0 s"
    assert seen["duration"] == pytest.approx(6.0) and seen["drawn"] > 20

"""What strangers send to the servers of the package is answered or dropped, and the terminal stays readable."""

import asyncio
import contextlib
import threading
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect

import support.replays
import support.studio
import support.survey
from sean_jax.core import messages
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.web import local_server
from sean_jax.web.replay import live
from support import hostile
from support.web import get

session, fresh, served = support.studio.session, support.studio.fresh, support.studio.served  # fixtures
surveyed, walked = support.survey.served, support.replays.walked


@contextlib.contextmanager
def serving(serve_tab, answer):
    """A server of ``web.listen`` in a thread; gives its port."""
    ready, stop, ports = threading.Event(), asyncio.Event(), []
    loop = asyncio.new_event_loop()

    async def run():
        async with local_server.listen(serve_tab, answer, 0, 4096) as port:
            ports.append(port)
            ready.set()
            await stop.wait()

    thread = threading.Thread(target=loop.run_until_complete, args=(run(),), daemon=True)
    thread.start()
    assert ready.wait(10)
    yield ports[0]
    loop.call_soon_threadsafe(stop.set)
    thread.join(10)
    loop.close()


def test_a_server_that_takes_messages_as_they_are_shows_one_line(capfd):
    """Also where its own code does not expect what it gets."""

    async def careless(tab):
        async for message in tab:
            request = local_server.parse(message) if message != "break" else {}[message]
            await tab.send(str(local_server.number(request, "ahead", -1.0, 1.0)))

    def answer(connection, request):
        return (
            local_server.response(local_server.http.HTTPStatus.FORBIDDEN, request.path.encode("ascii"))
            if "socket" not in request.path
            else None
        )

    with serving(careless, answer) as port:
        address = f"ws://127.0.0.1:{port}/socket"
        for place in hostile.PLACES:
            assert not hostile.ask(port, place).startswith((b"HTTP/1.1 5", b"HTTP/1.1 101")), place
        for header in (
            "Host: [",
            "Origin: http://[",
            "Host: a\r\nHost: b",
            "Origin: a\r\nOrigin: b",
            "Host: a:99999999",
        ):
            assert hostile.ask(port, "/socket", header).startswith(b"HTTP/1.1 400"), header
        for text in ("break", "break", "{", "[" * 2000, '{"do":"x","ahead":"y"}'):
            with connect(address) as tab, contextlib.suppress(Exception):
                tab.send(text)
                tab.recv(timeout=5)
        with connect(address) as tab:  # it lives
            tab.send('{"do":"x","ahead":0.5}')
            assert tab.recv(timeout=5) == "0.5"
    said = capfd.readouterr().err
    hostile.check_terminal(said)
    assert said.count("a tab was closed by a message that failed (KeyError: 'break')") == 1


@pytest.mark.parametrize(
    "text",
    [
        "9" * 400,
        "-" + "9" * 61,
        "1e999",
        "NaN",
        '"\\ud83d"',
        '{"a":"\\uDC00"}',
        '{"\\udbff":1}',
        "[" * 61 + "]" * 61,
        '{"a":' * 2000 + "1" + "}" * 2000,
        b'"\xed\xa0\x80"',
        b"\xff",
    ],
)
def test_json_of_strangers_is_bounded(text, tmp_path):
    with pytest.raises(ValueError):
        messages.parse_json(text)
    (tmp_path / "a.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(files.FileError, match=r"a\.json"):
        files.read_json(tmp_path / "a.json")
    with pytest.raises(InputError, match="a message that is no request"):
        local_server.parse(b'{"do":"x","y":' + (text if isinstance(text, bytes) else text.encode()) + b"}")


def test_json_of_friends_is_read():
    """Also a character beyond 16 bits, which JSON writes as two halves."""
    text = '{"a": "\\ud83d\\ude00", "b": [1, -2.5e3, true, null], "c": 18446744073709551615}'
    assert messages.parse_json(text) == {"a": "\U0001f600", "b": [1, -2500.0, True, None], "c": 2**64 - 1}
    assert np.isnan(messages.parse_json("NaN", finite=False))
    assert local_server.number({"ahead": 10**59}, "ahead", -1.0, 1.0) == 1.0


@pytest.mark.parametrize(
    "address",
    [
        "http://[",
        "http://a:99999999",
        "https://user:pw@h",
        "http://",
        "ftp://a",
        "http://a/b",
        "http://a?b",
        "http://a#b",
        "a",
        "http://a:x",
        "http://\u0430.example",
        "HTTP://a",
        "https://a b",
        "https://*",
        "https://*.a",
        "https://a;script-src *",
        "https://a'",
        "https://a:",
        "https://a\n",
        "https://-a",
        "https://a..b",
        "https://[::1",
        "https://[::x]",
        "https://[1:2]",
        "https://a,b",
        "https://A",
    ],
)
def test_an_address_is_scheme_host_and_port(address):
    assert not local_server.is_origin(address)
    assert local_server.is_origin("https://study.example.org") and local_server.is_origin("http://10.0.0.1:8080")
    assert local_server.is_origin("http://[::1]:8080") and local_server.is_origin("https://xn--bcher-kva.example:443")


def test_rosbridge_holds(capfd):
    from sean_jax.ros import rosbridge
    from sean_jax.ros.transport import Mailbox

    served = rosbridge.Server("127.0.0.1:0", Mailbox(lambda kind, text: None), {})
    try:
        port = int(served.address.split(":")[2])
        hostile.attack(port, f"{served.address}/", None)
        with connect(served.address) as client:
            client.send('{"op":"nothing"}')
            assert "error" in client.recv(timeout=5)
    finally:
        served.close()
    hostile.check_terminal(capfd.readouterr().err)


@pytest.mark.slow
def test_the_studio_holds(served, capfd, tmp_path, monkeypatch):
    evil(tmp_path, monkeypatch)
    origin = f"http://127.0.0.1:{served.port}"
    hostile.attack(served.port, f"ws://127.0.0.1:{served.port}/socket?token={served.token}", origin)
    assert get(f"{origin}/?token={served.token}")[0] == 200
    hostile.check_terminal(capfd.readouterr().err)
    assert not Path("ran").exists()


@pytest.mark.slow
def test_the_survey_holds(surveyed, capfd, tmp_path, monkeypatch):
    evil(tmp_path, monkeypatch)
    origin = f"http://127.0.0.1:{surveyed.port}"
    link = surveyed.links()[-1]
    hostile.attack(surveyed.port, link.replace("http", "ws").replace("/?", "/socket?"), origin)
    assert get(link)[0] == 200
    hostile.check_terminal(capfd.readouterr().err)
    assert not Path("ran").exists()


@pytest.mark.slow
def test_the_live_page_holds(walked, capfd):
    with live.serve(walked[0], "a run") as page:
        port = int(page.url.split(":")[2].strip("/"))
        hostile.attack(port, "", None)
        assert get(page.url)[0] == 200
    hostile.check_terminal(capfd.readouterr().err)


def evil(folder, monkeypatch):
    """A file that a message names, and that would say that it ran."""
    monkeypatch.chdir(folder)
    (folder / "live").mkdir()
    for file in (folder / "live/evil.py", folder / "evil.py"):
        file.write_text("open('ran', 'w')\ndef go(*_): pass\n")

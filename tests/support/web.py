"""Servers in threads, what they answer, and the browser that pages are tried in."""

import asyncio
import contextlib
import json
import shutil
import threading
import urllib.error
import urllib.request

import pytest

from support.checkout import WEB
from support.commands import output

BROWSERS = "chromium", "chromium-browser", "google-chrome"


def chromium() -> str:
    """The browser; without it, or without what `npm ci` puts in web/, the test is skipped."""
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None or not all((WEB / "node_modules" / name).is_dir() for name in ("playwright-core", "axe-core")):
        pytest.skip("there is no Chromium, or web/node_modules is not there")
    return found


def browse(script: str, page: object, *words: object) -> str:
    """What a program of web/ prints that opens a page in Chromium."""
    return output("node", script, page, chromium(), *words, cwd=WEB)


def get(address: str, **headers: str) -> tuple[int, str]:
    """The status and the text of what a server answers."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@contextlib.contextmanager
def running(served):
    """Have the ``run`` of a studio or a survey go on in a thread, from when it is ready to when the block ends."""
    ready, loop = threading.Event(), asyncio.new_event_loop()
    task = loop.create_task(served.run(0, ready.set))

    def run():
        with contextlib.suppress(asyncio.CancelledError):
            loop.run_until_complete(task)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert ready.wait(20)
    yield served
    loop.call_soon_threadsafe(task.cancel)
    thread.join(20)
    assert not thread.is_alive()


async def until(tab, *kinds: str) -> dict:
    """The next message of one of these kinds; frames are decoded no further than their head."""
    while True:
        message = await asyncio.wait_for(tab.recv(), 120)
        if isinstance(message, bytes):
            length = int.from_bytes(message[:4], "little")
            news = json.loads(message[4 : 4 + length]) | {"bytes": message[4 + length :]}
        else:
            news = json.loads(message)
        if news["kind"] in kinds:
            return news

"""``sean studio``: drive the robot in the browser, among people who walk on, and record demonstrations."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sean_jax.config import StudioConfig, user_parts
from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.web import pages
from sean_jax.web.local_server import HOST
from sean_jax.web.studio import address, trial
from sean_jax.web.studio.server import Studio

if TYPE_CHECKING:
    from rich.console import Console

TEMPLATE = "web/studio/page.html"


def run_studio(config: StudioConfig, console: Console) -> None:
    """Serve the page until Ctrl-C, then make demonstrations of the recorded drives.

    Raises:
        InputError: the options cannot be met, or the port is taken.
        WriteError: another process records in the folder.
    """

    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True, markup=False)

    with contextlib.ExitStack() as stack:
        stack.enter_context(user_parts.read_once())
        if config.record is not None:
            stack.enter_context(writing.folder_lock(config.record))
            for text in trial.recover(config.record):
                say(text)
        try:
            serve(config, say)
        finally:
            if config.record is not None:
                make_demonstrations(config, say)


def make_demonstrations(config: StudioConfig, say: Callable[[str], None]) -> None:
    """Make demonstrations of the recorded drives, and say what became of them."""
    assert config.record is not None
    trial.recover(config.record)  # a drive that could not be written to its end
    summary = trial.demonstrations(config, say)
    for text in summary.said:
        say(text)
    if summary.data is not None:
        say(f"{len(summary.data.episodes)} demonstrations: {summary.data.folder}")


def serve(config: StudioConfig, say: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C."""
    script = files.read_text(Path(__file__).with_name("page.min.js"))
    page = pages.render(TEMPLATE, title="Studio", kicker="sean_jax", script=script)
    kept = address.recall(config.record)
    began = time.monotonic()
    say("studio: building and compiling the scenario; the first time this takes a minute or more")
    studio = Studio(config, page, kept.token)

    def ready() -> None:
        address.keep(config.record, address.Address(studio.token, studio.port))
        say(f"studio: ready after {time.monotonic() - began:.0f} s")
        if config.record is not None and (refused := trial.no_demonstrations(studio.session.scenario)):
            say(f"studio: {refused}")
        say(f"studio: {studio.url}")

    try:
        asyncio.run(studio.run(_port(config, kept), ready))
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise InputError(f"port: {config.port} of {HOST} is not free ({reason}); choose another.") from None
    finally:
        say("studio: stopping")
        studio.close()


def _port(config: StudioConfig, kept: address.Address) -> int:
    """The port of the options, or the one that the folder's pages know if it is free, or any free one."""
    if config.port or not kept.port:
        return config.port
    with socket.socket() as probe, contextlib.suppress(OSError):
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, kept.port))
        return kept.port
    return 0

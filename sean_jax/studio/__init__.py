"""``sean studio``: drive the robot in the browser, among people who walk on, and record demonstrations."""

from __future__ import annotations

import asyncio
import contextlib
import os
from typing import TYPE_CHECKING

from sean_jax import components, files, pages, writing
from sean_jax.config import StudioConfig
from sean_jax.errors import InputError
from sean_jax.studio import trial
from sean_jax.studio.server import Studio
from sean_jax.web import HOST

if TYPE_CHECKING:
    from rich.console import Console

TEMPLATE = "studio/page.html"


def run(config: StudioConfig, console: Console) -> None:
    """Serve the page until Ctrl-C, then make demonstrations of the recorded drives.

    Raises:
        InputError: the options cannot be met, or the port is taken.
        WriteError: another process records in the folder.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(components.read_once())
        if config.record is not None:
            stack.enter_context(writing.folder_lock(config.record))
            for file in trial.recover(config.record):
                console.print(f"{file} was stopped; it ends after its last whole second", highlight=False)
        try:
            serve(config, console)
        finally:
            if config.record is not None and (data := trial.demonstrations(config)) is not None:
                text = f"{len(data.episodes)} demonstrations: {data.folder}"
                console.print(text, highlight=False, soft_wrap=True)


def serve(config: StudioConfig, console: Console) -> None:
    """Serve the page until Ctrl-C."""
    script = files.read_text(pages.PACKAGE / "studio" / "page.js")
    page = pages.render(TEMPLATE, title="Studio", kicker="sean_jax", script=script)
    with console.status("compiling"):
        studio = Studio(config, page)

    def ready() -> None:
        console.print(f"studio: {studio.url}", highlight=False, soft_wrap=True)

    try:
        asyncio.run(studio.run(config.port, ready))
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise InputError(f"port: {config.port} of {HOST} is not free ({reason}); choose another.") from None
    finally:
        studio.close()

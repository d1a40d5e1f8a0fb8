"""``sean studio --survey``: a study with participants in the browser. ``sean survey``: its tables and its report."""

from __future__ import annotations

import asyncio
import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from sean_jax.config import StudioConfig, user_parts
from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.studies.survey import study
from sean_jax.studies.survey.answers import Answers
from sean_jax.studies.survey.server import Survey
from sean_jax.web import local_server, pages

if TYPE_CHECKING:
    from rich.console import Console

TEMPLATE = "studies/survey/page.html"
OWNER_ALONE = 0o700  # permissions of a new folder, which holds the links of all participants


def run(config: StudioConfig, console: Console) -> None:
    """Serve the study of ``config.survey`` until Ctrl-C.

    Raises:
        InputError: the study has a mistake, the folder belongs to another one, or the port is taken.
        WriteError: another process works in the folder.
    """
    assert config.survey is not None and config.out is not None
    is_new = not config.out.exists()
    with user_parts.read_once(), writing.folder_lock(config.out):
        described = study.read(config.survey)
        if is_new:
            with contextlib.suppress(OSError):  # a file system without permissions
                config.out.chmod(OWNER_ALONE)
        answers = Answers.begin(config.out, described)
        try:
            _serve(config, answers, console)
        finally:
            answers.close()


def _serve(config: StudioConfig, answers: Answers, console: Console) -> None:
    assert config.survey is not None
    script = files.read_text(Path(__file__).with_name("page.min.js"))
    page = pages.render(TEMPLATE, title=answers.study.title, kicker="", script=script)
    with console.status("simulating the episodes") as status:
        survey = Survey(answers, page, config.survey, lambda text: status.update(f"simulating the episodes: {text}"))

    if note := answers.study.unbalanced():
        console.print(note, highlight=False, soft_wrap=True)

    def ready() -> None:
        for number, link in enumerate(survey.links(), 1):
            console.print(f"participant {number}: {link}", highlight=False, soft_wrap=True)
        console.print(f"researcher: {survey.researcher_link}", highlight=False, soft_wrap=True)

    port = config.port or answers.port
    try:
        asyncio.run(survey.run(port, ready))
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise InputError(f"port: {port} of {local_server.HOST} is not free ({reason}); choose another.") from None

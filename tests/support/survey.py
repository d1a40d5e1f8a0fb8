"""A study, its server in a thread, and answers by chance."""

import contextlib
import sqlite3

import pytest

from sean_jax.studies.survey import server, study
from sean_jax.studies.survey.answers import FILE, Answers
from support.web import running

STUDY = """
title: Robots in a lab
consent: You may stop at any time.
participants: 60
options: {environment: lab, behavior: random, people: 2, time_limit: 1.5, warm_up: 1}
questions: [navigation]
before:
  - {kind: number, name: age, text: "How old are you?", range: [18, 99], required: false}
trials:
  - {name: calm, watch: {policy: go_to_goal, seed: 3}}
  - name: mine
    drive: {seed: 4}
    questions:
      - {kind: likert, name: easy, text: It was easy., points: 5}
  - name: pair
    choose: [{policy: go_to_goal, seed: 5}, {policy: expert, seed: 5}]
    questions: [{kind: text, name: why, text: "Why?", required: false}]
after:
  - {kind: choice, name: car, text: "Do you drive a car?", choices: [often, never]}
drivers: 8
"""

FILM = {"timeStep": 0.1, "episodes": [{"frames": 16}]}  # of a recording, what tells its length


def read(folder, text=STUDY):
    (folder / "study.yaml").write_text(text)
    return study.read(folder / "study.yaml")


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """An open study in a thread of its own."""
    folder = tmp_path_factory.mktemp("study")
    answers = Answers.begin(folder, read(folder))
    survey = server.Survey(answers, "<p>the page</p>", folder / "study.yaml")
    survey._lengths = {trial: server.TOLERANCE + 0.2 for trial in survey._lengths}  # s, of films, to save time
    with running(survey):
        yield survey
    answers.close()


def reply(question, draw):
    """A random answer."""
    kind = question["kind"]
    if kind == "likert":
        return int(draw.integers(1, question["points"] + 1))
    if kind == "choice":
        return str(draw.choice(question["choices"]))
    return int(draw.integers(18, 99)) if kind == "number" else f'because {draw.integers(10**9)}; "ü", =1'


def change(folder, *statements):
    """Change a closed study's file as another program would."""
    with contextlib.closing(sqlite3.connect(folder / FILE, isolation_level=None)) as base:
        base.execute("PRAGMA writable_schema=ON")
        for statement in statements:
            base.execute(statement)
        base.execute("PRAGMA wal_checkpoint(TRUNCATE)")

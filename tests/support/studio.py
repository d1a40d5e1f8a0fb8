"""A session of the studio and its server, in threads."""

import threading

import pytest

from sean_jax.config import StudioConfig, validate
from sean_jax.web.studio import server
from sean_jax.web.studio.server import Studio
from sean_jax.web.studio.session import Session
from support.web import running

METRICS = ["path_length", "intimate_robot_on_person"]  # all of them would take long to compile
OPTIONS = {"environment": "lab", "people": 3, "time_limit": 20.0, "warm_up": 1.0, "metrics": METRICS}


@pytest.fixture(scope="module")
def session():
    """A session whose time passes in a thread."""
    made = Session(validate(StudioConfig, OPTIONS))
    thread = threading.Thread(target=made.run, daemon=True)
    thread.start()
    yield made
    made.close()
    thread.join(10)
    assert not thread.is_alive()


@pytest.fixture
def fresh(session, tmp_path):
    """The session at the beginning of episode 0, with a folder for drives."""
    session.config = session.config.replace(record=tmp_path / "drives")
    session.play(False)
    session.drive(False)
    session.restart(0)
    session.set_speed(16.0)
    yield session
    session.play(False)
    session.end_trial()


@pytest.fixture
def served(fresh, monkeypatch):
    """The studio of the session, in a thread of its own: its address and token."""
    monkeypatch.setattr(server, "Session", lambda config: fresh)
    monkeypatch.setattr(Studio, "close", lambda self: None)  # the session goes on for other tests
    monkeypatch.setattr(fresh, "run", lambda: None)  # in its thread already
    studio = Studio(fresh.config, "<p>the page</p>")
    with running(studio):
        yield studio
    fresh.send = lambda kind, content: None

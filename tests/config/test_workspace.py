"""The folder of a long command: what it was begun with, in one sentence, and parts that are whole or damaged."""

import json

import numpy as np
import pytest

from sean_jax.config.workspace import Workspace, difference, value_text
from sean_jax.core.errors import FileError, InputError, WriteError

NOW = {"options": {"seed": 0, "task_distance": (4.0, 20.0)}, "versions": {"jax": "1"}, "parts": {"my.py": "a"}}


@pytest.mark.parametrize(
    "had, text",
    [
        ({}, None),
        ({"options": {"seed": 1, "task_distance": [4, 20]}}, "with --seed 1, not 0"),
        ({"options": {"seed": 0, "task_distance": [4, 8]}}, "with --task-distance 4 8, not 4 20"),
        ({"options": {"seed": 0}}, "without --task-distance"),
        ({"versions": {"jax": "0"}}, "with jax 0, not 1"),
        ({"versions": {}, "parts": {}}, None),
        ({"parts": {"my.py": "b"}}, "with another my.py"),
    ],
)
def test_the_first_difference_is_named(had, text):
    before = json.loads(json.dumps({**NOW, **had}))
    assert difference(before, NOW) == text


def test_a_value_is_shown_as_options_are_given():
    assert value_text({"kind": "graph", "routing": "edge", "walking_groups": [0.0, 0.5]}) == (
        "graph --routing edge --walking-groups 0 0.5"
    )


def test_a_folder_is_resumed_by_the_same_command_alone(tmp_path):
    work = Workspace(tmp_path / "made", NOW)
    assert not work.begun() and not (tmp_path / "made").exists()
    with work.open():
        with pytest.raises(WriteError, match="is being written"), work.open():
            pass
        work.begin()
        work.save("a.json", {"x": [1]})
        work.save("b.npz", {"x": np.arange(3)})
    assert work.begun() and work.load("a.json") == {"x": [1]} and work.load("c.json") is None
    np.testing.assert_array_equal(work.load("b.npz")["x"], [0, 1, 2])
    more = Workspace(work.folder, {**NOW, "parts": {"other.py": "c"}})
    more.begin()
    assert json.loads((work.folder / work.file).read_text())["parts"] == {"my.py": "a", "other.py": "c"}
    with pytest.raises(InputError, match="made was begun with another other.py; ask for the same or choose another"):
        Workspace(work.folder, {**NOW, "parts": {"other.py": "d"}}).begin()
    for name in ("a.json", "b.npz"):
        (work.folder / name).write_text("{")
        with pytest.raises(FileError, match=f"{name}.*"):
            work.load(name)

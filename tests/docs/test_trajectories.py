"""docs/trajectories.md: its table has every column, and its examples run."""

import re
import shlex

import numpy as np
import pytest

from sean_jax.cli import command_line
from sean_jax.io.trajectories import COLUMNS
from support.checkout import ROOT

pytestmark = pytest.mark.form
TEXT = (ROOT / "docs" / "trajectories.md").read_text(encoding="utf-8")


def test_every_column_is_told():
    assert re.findall(r"^\| `([\w]+)` \| (.*) \|$", TEXT, re.M) == list(COLUMNS.items())


def test_examples_run(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    pytest.importorskip("pedpy")
    pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    for language, block in re.findall(r"```(python|bash)\n(.*?)```", TEXT, re.S):
        if language == "python":
            exec(block, scope)  # noqa: S102
        else:
            assert command_line.main([*shlex.split(block)[1:], "--quiet"]) == 0
    trajectory, loaded = scope["trajectory"], scope["loaded"]
    present = np.asarray(trajectory.present)
    gaps = np.linalg.norm(trajectory.people - trajectory.position[:, None], axis=-1)
    gaps = np.where(present, gaps, np.inf).min(1)
    np.testing.assert_allclose(scope["nearest"], gaps, rtol=1e-5)
    assert (scope["speeds"].speed >= 0).all()
    np.testing.assert_array_equal(loaded.present, present)
    np.testing.assert_array_equal(loaded.people[present], np.asarray(trajectory.people)[present])
    assert scope["lasted"] == pytest.approx(scope["episodes"].seconds[3])
    assert scope["everything"].active.sum(1) * 0.1 == pytest.approx(scope["episodes"].seconds.to_numpy())

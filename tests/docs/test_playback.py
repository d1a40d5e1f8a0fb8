"""docs/playback.md: its example runs from top to bottom, and its tables are those of the reader."""

import re
from typing import Any

import numpy as np
import pytest

from support.checkout import ROOT

pytestmark = pytest.mark.form

PAGE = (ROOT / "docs" / "playback.md").read_text(encoding="utf-8")


def test_columns_and_formats_are_those_of_the_reader():
    from sean_jax.people.recordings import reading

    section = PAGE.split("## The file\n")[1].split("## The clock")[0]
    rows = [line.split("|")[1:3] for line in section.splitlines() if line.startswith("| `")]
    columns = {name: needed.strip() for names, needed in rows for name in re.findall(r"`(\w+)`", names)}
    assert set(columns) == {name for names in reading.NAMES.values() for name in names}
    needed = {name for key in reading.NEEDED for name in reading.NAMES[key]}
    assert {name for name, word in columns.items() if word == "yes"} == needed
    formats = re.findall(r"^\| `(\w+)` \|", PAGE.split("## The clock\n")[1].split("## What people do")[0], re.M)
    assert tuple(formats) == tuple(reading.FORMATS)


def test_the_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for program in re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S):
        exec(compile(program, "docs/playback.md", "exec"), names)
    trajectory = names["trajectory"]
    people, present = np.asarray(trajectory.people), np.asarray(trajectory.present)
    assert people.shape[1] == 2 and present.all()
    rows = people[0][np.argsort(people[0][:, 1])]
    first = (rows[0, 0] + 6.0) / 1.2  # s since the recording began
    np.testing.assert_allclose(rows, [[-6.0 + 1.2 * first, 0.0], [6.0 - first, 1.0]], atol=1e-3)
    assert 0.1 <= first <= 2.1, "the recording lasts for the whole episode"
    measured = {name: float(np.ravel(metric.compute(names["values"][name]))[0])
                for name, metric in names["chosen"].items()}  # fmt: skip
    assert measured["path_length"] == pytest.approx(12.0, rel=0.02)
    assert 0.9 <= measured["min_distance_to_people"] <= 1.2
    assert list(names["shares"]) == [name for name, _ in names["scenario"].situations]
    assert all(0.0 <= share <= 1.0 for share in names["shares"].values()) and names["shares"]["empty"] > 0.0
    assert capsys.readouterr().out.count("\n") == 2

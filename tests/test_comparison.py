"""``sean compare``: paired where episodes are the same, by means where they are not; and the page of both."""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

from sean_jax import cli
from sean_jax.errors import InputError
from sean_jax.evaluation import comparison

NAMES = ("completed", "seconds", "path_length", "intimate_robot_on_person", "time_looked_at")


def run(folder: Path, chance: int, shift: float = 0.0, episodes: int = 40, **options) -> Path:
    """The folder of a run, with random figures."""
    random = np.random.default_rng(chance)
    folder.mkdir()
    told = {"environment": "lab", "task": ["join_group", "leave_group"], "episodes": episodes, **options}
    (folder / "config.yaml").write_text(yaml.safe_dump({"command": "sean run", "config": told}))
    with (folder / "episodes.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["episode", "task", "completed", "timed_out", *NAMES[1:], "path_length__empty"])
        for i in range(episodes):
            done = bool(random.uniform() < 0.8)
            values = [20 + 9 * random.normal() + shift, 5 + random.normal(), random.poisson(0.5)]
            looked = "" if i % 3 == 0 else f"{random.uniform():.6f}"
            writer.writerow([i, ("join_group", "leave_group")[i % 2], done, not done, *values, looked, 1.0])
    return folder


def test_the_same_episodes_are_compared_one_by_one(tmp_path):
    """What is the same in each episode cancels: the interval is that of the differences alone."""
    one, other = run(tmp_path / "one", 0), run(tmp_path / "other", 0, shift=0.7, policy="orca")
    pair = comparison.read(one), comparison.read(other)
    assert comparison.paired(*pair) == 40 and comparison.unlike(*pair) == ["policy"]
    found = {row.name: row for row in comparison.differences(*pair)}
    assert set(found) == set(NAMES)
    seconds = found["seconds"]
    assert seconds.apart == pytest.approx(0.7, abs=1e-6) and seconds.decided
    assert seconds.low == pytest.approx(0.7, abs=1e-6) == pytest.approx(seconds.high, abs=1e-6)
    assert found["completed"].unit == "%" and found["completed"].first == 100 * pair[0].columns["completed"].mean()
    assert found["path_length"].apart == 0.0 and not found["path_length"].decided
    assert "--policy" in comparison.told(*pair)


def test_other_episodes_are_compared_by_their_means(tmp_path):
    one, other = run(tmp_path / "one", 0, episodes=300), run(tmp_path / "other", 1, 3.0, episodes=200, seed=1)
    pair = comparison.read(one), comparison.read(other)
    assert comparison.paired(*pair) == 0
    row = next(row for row in comparison.differences(*pair) if row.name == "seconds")
    parts = [each.columns["seconds"] for each in pair]
    assert row.apart == pytest.approx(parts[1].mean() - parts[0].mean())
    error = 1.96 * np.sqrt(sum(part.var() / len(part) for part in parts))
    assert row.high - row.low == pytest.approx(2 * error, rel=0.15)
    assert "not the same" in comparison.told(*pair)


def test_fewer_episodes_are_those_that_both_have(tmp_path):
    pair = comparison.read(run(tmp_path / "one", 0)), comparison.read(run(tmp_path / "two", 0, episodes=25))
    assert comparison.paired(*pair) == 25
    assert all(row.apart == 0.0 for row in comparison.differences(*pair))


def test_the_page_names_both_and_refers_to_nothing_outside(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(Path("a<b>"), 0)
    run(Path("other"), 2, policy="orca")
    assert cli.main(["compare", "a<b>", "other"]) == 0
    text = Path("compare-a<b>-other.html").read_text(encoding="utf-8")
    assert "a&lt;b&gt;" in text and "<b>" not in text.split("<body>")[1] and "://" not in text
    said = capsys.readouterr().out
    assert "40 episodes that both have" in said and "duration" in said
    assert cli.main(["compare", "a<b>", "missing"]) == 2
    assert "holds no config.yaml" in capsys.readouterr().err
    Path("other/episodes.csv").write_text("episode,task,completed,timed_out,seconds\n0,join_group,True,False,abc\n")
    with pytest.raises(InputError, match="seconds is no column of numbers"):
        comparison.read(Path("other"))

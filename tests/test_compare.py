"""``sean compare``: paired where episodes are the same, by means where they are not; and the page of both."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from sean_jax import cli, replay
from sean_jax.classifiers import SITUATION_SETS
from sean_jax.errors import InputError
from sean_jax.evaluation import compare
from sean_jax.files.reading import MAX_BYTES
from sean_jax.metrics import METRICS

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
            values = [60 + 9 * random.normal() + shift, 5 + random.normal(), random.poisson(0.5)]
            looked = "" if i % 3 == 0 else f"{random.uniform():.6f}"
            writer.writerow([i, ("join_group", "leave_group")[i % 2], done, not done, *values, looked, 1.0])
    return folder


def test_the_same_episodes_are_compared_one_by_one(tmp_path):
    """What is the same in each episode cancels: the interval is that of the differences alone."""
    one, other = run(tmp_path / "one", 0), run(tmp_path / "other", 0, shift=0.7, policy="orca")
    pair = compare.read(one), compare.read(other)
    assert compare.paired(*pair) == 40 and compare.differing_options(*pair) == ["policy"]
    found = {row.name: row for row in compare.differences(*pair)}
    assert set(found) == set(NAMES)
    seconds = found["seconds"]
    assert seconds.difference == pytest.approx(0.7, abs=1e-6) and seconds.significant
    assert seconds.low == pytest.approx(0.7, abs=1e-6) == pytest.approx(seconds.high, abs=1e-6)
    assert found["completed"].unit == "%" and found["completed"].first == 100 * pair[0].columns["completed"].mean()
    assert found["path_length"].difference == 0.0 and not found["path_length"].significant
    assert "--policy" in compare.summarize(*pair)


def test_other_episodes_are_compared_by_their_means(tmp_path):
    one, other = run(tmp_path / "one", 0, episodes=300), run(tmp_path / "other", 1, 3.0, episodes=200, seed=1)
    pair = compare.read(one), compare.read(other)
    assert compare.paired(*pair) == 0
    row = next(row for row in compare.differences(*pair) if row.name == "seconds")
    parts = [each.columns["seconds"] for each in pair]
    assert row.difference == pytest.approx(parts[1].mean() - parts[0].mean())
    error = 1.96 * np.sqrt(sum(part.var() / len(part) for part in parts))
    assert row.high - row.low == pytest.approx(2 * error, rel=0.15)
    assert "have different episodes" in compare.summarize(*pair)


def test_fewer_episodes_are_those_that_both_have(tmp_path):
    pair = compare.read(run(tmp_path / "one", 0)), compare.read(run(tmp_path / "two", 0, episodes=25))
    assert compare.paired(*pair) == 25
    assert all(row.difference == 0.0 for row in compare.differences(*pair))


def test_the_page_names_both_and_refers_to_nothing_outside(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(Path("a<b>"), 0)
    run(Path("other"), 2, policy="orca")
    assert cli.main(["compare", "a<b>", "other"]) == 0
    text = Path("compare-a<b>-other.html").read_text(encoding="utf-8")
    assert "a&lt;b&gt;" in text and "<b>" not in text.split("<body>")[1] and "://" not in text
    said = capsys.readouterr().out
    assert "40 common episodes" in said and "duration" in said
    assert cli.main(["compare", "a<b>", "missing"]) == 2
    assert "holds no config.yaml" in capsys.readouterr().err
    Path("other/episodes.csv").write_text("episode,task,completed,timed_out,seconds\n0,join_group,True,False,abc\n")
    with pytest.raises(InputError, match="other/episodes.csv: episode 0: seconds: 'abc' is no number from 0 to 86,400"):
        compare.read(Path("other"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("\n1,", "\n2,", "episode 1 is missing"),
        ("\n3,", "\n0,", "episode 3 is missing"),
        ("completed,", "compleeted,", "has no column completed"),
        ("completed,", "task,", "names a column twice"),
        ("\n2,join_group,[A-Z][a-z]+", "\n2,join_group,Yes", "episode 2: completed: 'Yes' is no number from 0 to 1"),
        ("\n2,join_group,[A-Z][a-z]+", "\n2,join_group,", "episode 2: completed: '' is no number from 0 to 1"),
        ("\n2,join_group,", '\n2,"join_group,', "is no row of CSV"),
        ("\n2,join_group,", "\n2,join\x00_group,,", "has 10 cells and there are 9 columns"),
        (",0,", ",-1,", "intimate_robot_on_person: '-1' is no number from 0"),
        (",1.0\n", ",1e39\n", "path_length__empty: '1e39' is no number"),
        (",1.0\n", ",inf\n", "path_length__empty: 'inf' is no number"),
    ],
)
def test_episodes_that_no_run_wrote_are_refused_in_a_sentence(tmp_path, old, new, words):
    folder = run(tmp_path / "one", 0)
    text = (folder / "episodes.csv").read_text()
    wrong, changes = re.subn(old, new, text, count=1)
    assert changes == 1
    (folder / "episodes.csv").write_text(wrong)
    with pytest.raises(InputError, match=words) as refused:
        compare.read(folder)
    assert str(refused.value).startswith("one/episodes.csv") and "\n" not in str(refused.value)


def test_the_largest_run_of_the_docs_is_compared_with_its_replay(tmp_path):
    """4,096 episodes with every metric in every situation, and a report of 2.1 MB."""
    folder = run(tmp_path / "one", 0, episodes=4096)
    rows = [*csv.reader((folder / "episodes.csv").open())]
    more = [f"{name}__{situation}" for name in METRICS for situation in SITUATION_SETS["paper"]]
    more = [name for name in more if name not in rows[0]]
    with (folder / "episodes.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(
            [row + (more if k == 0 else ["0.123456"] * len(more)) for k, row in enumerate(rows)]
        )
    content = {"title": "mine", "filler": "x" * 2_100_000}
    (folder / "report.html").write_text(f"<html>{replay.element(content)}</html>")
    assert min(file.stat().st_size for file in folder.iterdir() if file.suffix != ".yaml") > MAX_BYTES
    found = compare.read(folder)
    assert len(found.tasks) == 4096 and found.replay == content and not found.no_replay
    assert "No replay" not in compare.summarize(found, found)


@pytest.mark.parametrize(
    ("page", "words"),
    [
        (None, "there is no such file"),
        (b"\xff", "is not UTF-8 text"),
        ('<script type="application/json" id="replay">{</script>', "is damaged; run it again to see its replay"),
        ('<script type="application/json" id="replay">[]</script>', "is damaged; run it again"),
        ('<script type="application/json" id="replay">{"a": NaN}</script>', "is damaged; run it again"),
        (f'<script type="application/json" id="replay">{"[" * 200_000}</script>', "is damaged; run it again"),
    ],
)
def test_a_missing_replay_is_named(tmp_path, capsys, monkeypatch, page, words):
    monkeypatch.chdir(tmp_path)
    run(Path("one"), 0)
    run(Path("other"), 0)
    if page is not None:
        Path("one/report.html").write_bytes(page if isinstance(page, bytes) else page.encode())
    Path("other/report.html").write_text("<html>nobody was recorded</html>")
    assert cli.main(["compare", "one", "other"]) == 0
    said = capsys.readouterr().out
    assert "No replay of one: " in said and words in said
    assert "No replay of other: other/report.html: holds none." in said
    assert words in Path("compare-one-other.html").read_text()

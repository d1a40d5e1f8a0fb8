"""``sean compare``: paired where episodes are the same, by means where they are not; and the page of both."""

import csv
import io
import json
import re
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from rich.console import Console

from sean_jax import metrics
from sean_jax.classifiers import SITUATION_SETS
from sean_jax.cli import command_line
from sean_jax.config import CompareConfig
from sean_jax.core.errors import InputError
from sean_jax.evaluation import compare, table
from sean_jax.io.files.reading import MAX_BYTES
from sean_jax.metrics import METRICS
from sean_jax.metrics.differences import difference, holm, p_value
from sean_jax.web import replay
from support.runs import NAMES, run


def rows(*runs: compare.SavedRun, view: str = "overall") -> dict[str, compare.ComparedFigure]:
    """The rows of the last run."""
    return {row.name: row for row in compare.differences(runs)[view][-1]}


def test_the_same_episodes_are_compared_one_by_one(tmp_path):
    """What is the same in each episode cancels: the interval is that of the differences alone."""
    one, other = run(tmp_path / "one", 0), run(tmp_path / "other", 0, shift=0.7, policy="orca")
    pair = compare.read_run(one), compare.read_run(other)
    assert compare.paired(*pair) == 40 and compare.differing_options(*pair) == ["policy"]
    found = rows(*pair)
    assert list(found)[0] == "seconds" and set(found) == set(NAMES), "the largest effect comes first"
    seconds = found["seconds"]
    assert seconds.values.difference == pytest.approx(0.7, abs=1e-6) and seconds.verdict == "worse"
    assert seconds.values.low == pytest.approx(0.7, abs=1e-6) == pytest.approx(seconds.values.high, abs=1e-6)
    assert seconds.texts()[2:] == ("+0.7", "")
    assert found["completed"].figure.unit == "%"
    assert found["completed"].values.first == pair[0].columns["completed"].mean()
    assert found["path_length"].values.difference == 0.0 and not found["path_length"].clear
    assert not found["path_length"].tested and set(rows(*pair, view="empty")) == {"path_length"}
    assert "--policy" in compare.summarize(pair)


def test_other_episodes_are_compared_by_their_means(tmp_path):
    one, other = run(tmp_path / "one", 0, episodes=300), run(tmp_path / "other", 1, 3.0, episodes=200, seed=1)
    pair = compare.read_run(one), compare.read_run(other)
    assert compare.paired(*pair) == 0
    row = rows(*pair)["seconds"].values
    parts = [each.columns["seconds"] for each in pair]
    assert row.difference == pytest.approx(parts[1].mean() - parts[0].mean())
    error = 1.96 * np.sqrt(sum(part.var() / len(part) for part in parts))
    assert row.high - row.low == pytest.approx(2 * error, rel=0.15)
    assert row.p == pytest.approx(scipy.stats.ttest_ind(*parts, equal_var=False).pvalue)
    assert "have different episodes" in compare.summarize(pair)


def test_fewer_episodes_are_those_that_both_have(tmp_path):
    pair = compare.read_run(run(tmp_path / "one", 0)), compare.read_run(run(tmp_path / "two", 0, episodes=25))
    assert compare.paired(*pair) == 25
    assert all(row.values.difference == 0.0 and not row.tested for row in rows(*pair).values())


def test_each_of_several_runs_is_compared_with_the_first(tmp_path):
    """One with worse times, one with better; equal names are told apart by their folders."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    folders = run(tmp_path / "a" / "go", 0), run(tmp_path / "b" / "go", 0, 5.0, policy="orca"), run(
        tmp_path / "shy", 0, -5.0, policy="social_costmap")  # fmt: skip
    path = compare.compare(CompareConfig(runs=folders, out=tmp_path / "page.html"), Console(quiet=True))
    text = path.read_text(encoding="utf-8")
    views = compare.differences([compare.read_run(folder) for folder in folders])
    verdicts = [{row.name: row.verdict for row in each}["seconds"] for each in views["overall"]]
    assert verdicts == ["worse", "better"]
    for other in folders[1], "shy":
        assert f"{other} minus {folders[0]}" in text
    assert text.count("1 better, 0 worse") == 1 == text.count("0 better, 1 worse")
    assert "✓ better" in text and "✗ worse" in text and "2 figures were tested" in text
    options = text.split("<h2>The runs</h2>")[1]
    assert "--policy" in options and all(name in options for name in ("go_to_goal", "orca", "social_costmap"))
    with pytest.raises(InputError, match="needs the folders of two or more runs, not of 1"):
        compare.compare(CompareConfig(runs=folders[:1]), Console(quiet=True))


def test_a_figure_without_a_direction_is_neither_better_nor_worse(tmp_path):
    pair = [compare.read_run(run(tmp_path / str(k), 0)) for k in range(2)]
    pair[1].columns["path_length"] = pair[1].columns["path_length"] + 2.0
    assert rows(*pair)["path_length"].verdict == "differs"


def test_own_metrics_keep_their_title_unit_and_direction(tmp_path):
    """As `sean run` writes them to summary.json; a run without them is compared all the same."""
    runs = []
    own = table.metric_figure("near", metrics.duration(lambda snapshot: True, title="time near", better="lower"))
    for name in ("one", "two"):
        folder = run(tmp_path / name, 0)
        (folder / "summary.json").write_text(json.dumps({"own_metrics": {"near": own._asdict()}}))
        runs.append(compare.read_run(folder))
        runs[-1].columns["near"] = np.arange(40.0) % 7 + 3.0 * len(runs)
    row = rows(*runs)["near"]
    assert row.figure == own and row.verdict == "worse" and (own.title, own.unit) == ("time near", "s")
    runs[0].figures = {}
    assert rows(*runs)["near"].verdict == "differs"
    for content in ('{"own_metrics": 3}', "{}", "[]", '{"own_metrics": {"near": {"title": 1}}}', "{"):
        (tmp_path / "one" / "summary.json").write_text(content)
        with pytest.raises(InputError, match=r"one/summary.json: ?.*(is damaged|is not JSON)"):
            compare.read_run(tmp_path / "one")


@pytest.mark.parametrize("same", [True, False])
def test_false_marks_are_rare_among_many_figures(same):
    """Two equal policies, 24 figures of several kinds and 200 pairs of runs: at most 5 % of the pairs have any mark."""
    false = 0
    for seed in range(200):
        random = np.random.default_rng(seed)
        places = random.normal(size=30)  # of the episodes, which the figures of both runs have in common
        p = []
        for k in range(24):
            one, other = (
                [places + random.normal(size=30), random.poisson(np.exp(places - 1)), random.exponential(size=30) ** 2,
                 random.uniform(size=30) < 0.9][k % 4].astype(float) for _ in range(2)
            )  # fmt: skip
            p.append(p_value(one, other, same))
        false += any(value <= 0.05 for value in holm(p))
    assert false / 200 <= 0.07


def test_holm():
    """Against the definition in statsmodels: the largest of (m - rank) p so far, at most 1."""
    for seed in range(100):
        random = np.random.default_rng(seed)
        p = random.uniform(size=int(random.integers(1, 30))) ** random.integers(1, 6)
        p[random.uniform(size=len(p)) < 0.2] = np.nan
        finite = np.flatnonzero(np.isfinite(p))
        order = finite[np.argsort(p[finite])]
        adjusted = np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1))
        expected = np.full(len(p), np.nan)
        expected[order] = np.minimum(adjusted, 1.0)
        np.testing.assert_allclose(holm(p.tolist()), expected, rtol=1e-12)


@pytest.mark.parametrize("number", [4, 40, 400])
def test_differences_of_shares_have_newcombes_interval_and_exact_tests(number):
    """Newcombe's formulas in terms of the four cells of the table; McNemar and Fisher by scipy."""
    for seed in range(20):
        random = np.random.default_rng(seed)
        one = random.uniform(size=number) < random.uniform(0.3, 1)
        other = np.where(random.uniform(size=number) < 0.6, one, random.uniform(size=number) < random.uniform(0.3, 1))
        a, b, c, d = (int(x.sum()) for x in (one & other, one & ~other, ~one & other, ~one & ~other))
        ends = [scipy.stats.binomtest(k, number).proportion_ci(0.95, "wilson") for k in (a + b, a + c)]
        p, q = (a + b) / number, (a + c) / number
        top = a * d - b * c
        top = max(top - number / 2, 0) if top > 0 else top
        product = (a + b) * (c + d) * (a + c) * (b + d)
        for paired in True, False:
            phi = top / product**0.5 if paired and product else 0.0
            (x, y), (u, v) = (q - ends[1].low, ends[0].high - p), (ends[1].high - q, p - ends[0].low)
            low, high = (
                q - p - np.sqrt(x * x - 2 * phi * x * y + y * y),
                q - p + np.sqrt(u * u - 2 * phi * u * v + v * v),
            )
            found = difference(one.astype(float), other.astype(float), paired)
            assert found is not None
            np.testing.assert_allclose([found.low, found.high], [low, high], atol=1e-12)
            if paired and b + c:
                assert found.p == pytest.approx(scipy.stats.binomtest(b, b + c).pvalue)
            elif not paired and 0 < p + q < 2:
                assert found.p == pytest.approx(scipy.stats.fisher_exact([[a + b, c + d], [a + c, b + d]]).pvalue)


def test_tests_of_means_are_scipys_unless_the_episodes_are_too_few():
    random = np.random.default_rng(0)
    for number in (12, 100):
        one, other = random.normal(size=number), random.normal(size=number) + 0.5
        same, means = difference(one, other, True), difference(one, other, False)
        assert same is not None and means is not None
        assert same.p == pytest.approx(scipy.stats.ttest_rel(one, other).pvalue)
        assert means.p == pytest.approx(scipy.stats.ttest_ind(one, other, equal_var=False).pvalue)
        gaps = other - one
        assert same.effect == pytest.approx(gaps.mean() / gaps.std(ddof=1))
    few = difference(np.zeros(3), np.full(3, 2.0), True)
    assert few is not None and few.p == 0.25, "of 8 signs of three equal differences, 2 give as large a mean"
    assert few.effect == np.inf and difference(np.full(3, np.nan), np.zeros(3), True) is None


def test_the_page_names_both_and_refers_to_nothing_outside(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(Path("a<b>"), 0)
    run(Path("other"), 2, policy="orca")
    assert command_line.main(["compare", "a<b>", "other"]) == 0
    text = Path("compare-a<b>-other.html").read_text(encoding="utf-8")
    assert "a&lt;b&gt;" in text and "<b>" not in text.split("<body>")[1] and "://" not in text
    pairs = re.findall(r"([-+\d.]+) to ([-+\d.]+)</", text)
    assert pairs and all(low != high for low, high in pairs) and ">+0.0<" not in text and ">-0.0<" not in text
    said = capsys.readouterr().out
    assert "40 common episodes" in said and "duration" in said
    assert command_line.main(["compare", "a<b>", "other", "--situation", "empty"]) == 0
    said = capsys.readouterr().out
    assert "path length" in said and "duration" not in said and "figures within situations were tested" in said
    assert command_line.main(["compare", "a<b>", "other", "--situation", "emty"]) == 2
    assert "--situation: 'emty' is not one of overall, empty." in capsys.readouterr().err
    assert command_line.main(["compare", "a<b>", "missing"]) == 2
    assert "holds no config.yaml" in capsys.readouterr().err
    Path("other/episodes.csv").write_text("episode,task,completed,timed_out,seconds\n0,join_group,True,False,abc\n")
    with pytest.raises(InputError, match="other/episodes.csv: episode 0: seconds: 'abc' is no number from 0 to 86,400"):
        compare.read_run(Path("other"))


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
        compare.read_run(folder)
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
    found = compare.read_run(folder)
    assert len(found.tasks) == 4096 and found.replay == content and not found.no_replay
    assert "No replay" not in compare.summarize([found, found])


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
    assert command_line.main(["compare", "one", "other"]) == 0
    said = capsys.readouterr().out
    assert "No replay of one: " in said and words in said
    assert "No replay of other: other/report.html: holds none." in said
    assert words in Path("compare-one-other.html").read_text()


def extreme_run(folder: Path, sign: float, **options) -> Path:
    """A run of 24 episodes whose figures differ by as much in each episode, so that p-values are the smallest."""
    run(folder, 0, episodes=24, **options)
    rows = [*csv.reader((folder / "episodes.csv").open())]
    rows[0] += ["mean_speed", "path_length__down_path", "mean_jerk"]
    more = np.arange(24)[:, None] * [0.25, 0.5, 0.125] + [sign, sign, 0.0]
    with (folder / "episodes.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([rows[0], *([*row, *each] for row, each in zip(rows[1:], more, strict=True))])
    return folder


def test_each_row_that_is_counted_is_shown(tmp_path):
    """Also the clearest ones, whose p-values are the smallest that permutations of so few episodes can give."""
    first = extreme_run(tmp_path / "first", 0.0)
    others = [extreme_run(tmp_path / name, sign, policy="orca") for name, sign in (("up", 4.0), ("down", -4.0))]
    out = tmp_path / "page.html"
    console = Console(record=True, width=140, quiet=False, file=io.StringIO())
    compare.compare(CompareConfig(runs=(first, *others), out=out), console)
    views = compare.differences([compare.read_run(folder) for folder in (first, *others)])
    told, text = console.export_text(), out.read_text(encoding="utf-8")
    marks = {"better": "✓ better", "worse": "✗ worse", "differs": "≠ differs"}

    # Effects at the floor of the permutation test are clear.
    floors = [row for rows in views["overall"] for row in rows if row.values.p == 2.0**-23]
    assert {row.name for row in floors} == {"mean_speed"} and all(row.verdict == "differs" for row in floors)

    for view, sides in views.items():
        begin = re.search(rf'data-view="?{view}"?>', text)
        assert begin is not None
        shown = re.split("data-view|<p class=note>✓", text[begin.end() :])[0]
        assert shown.count("</td></tr>") == sum(map(len, sides)), view
        for verdict, mark in marks.items():
            assert shown.count(f">{mark}</span>") == sum(row.verdict == verdict for rows in sides for row in rows), view
        assert shown.count("same in each") == sum(not row.tested for rows in sides for row in rows), view

    overall = [row for rows in views["overall"] for row in rows]
    for verdict, mark in marks.items():
        assert told.count(mark) == sum(row.verdict == verdict for row in overall)
    assert told.count("same in each") == sum(not row.tested for row in overall) > 0
    assert f"{sum(row.tested for row in overall)} figures were tested" in told


def test_p_values_are_numbers_of_python():
    """A bool of numpy is neither True nor False to ``is``, and no JSON."""
    one = np.arange(24.0)
    for other in one + 4.0, one + np.arange(24.0), one**2:
        for paired in True, False:
            found = difference(one, other, paired)
            assert found is not None and all(type(value) is float for value in found)
    shares = difference(np.zeros(24), np.ones(24), True)
    assert shares is not None and all(type(value) is float for value in shares)


def disc_runs(folder: Path, **columns: tuple[np.ndarray, np.ndarray]) -> list[compare.SavedRun]:
    """Two runs in the same episodes with these columns."""
    folder.mkdir(exist_ok=True)
    runs = [compare.read_run(run(folder / name, 0, policy=policy)) for name, policy in (("a", "orca"), ("b", "dwa"))]
    for name, pair in columns.items():
        for each, values in zip(runs, pair, strict=True):
            each.columns[name] = values
            each.columns["completed"] = np.ones(40)
    return runs


def test_values_beyond_the_best_are_no_better(tmp_path):
    """A robot that stops at the edge of the goal is neither better nor worse than one at its centre."""
    noise = 0.01 * np.random.default_rng(0).normal(size=40)
    inside, edge, far = 0.14 + noise, 0.74 - noise, 3.0 + noise
    runs = disc_runs(
        tmp_path, path_efficiency=(1.0 - abs(noise), 0.91 + noise), final_distance_to_goal=(inside, edge),
        min_distance_to_goal=(inside, far),
    )  # fmt: skip
    found = rows(*runs)
    assert found["path_efficiency"].verdict == found["final_distance_to_goal"].verdict == "differs"
    assert found["final_distance_to_goal"].values.first == inside.mean(), "the figure stays the distance to the centre"
    assert found["min_distance_to_goal"].verdict == "worse"

    # Of efficiencies on both sides of 1, those above decide.
    mixed = np.where(np.arange(40) % 2, 1.3, 0.9) + noise
    runs = disc_runs(tmp_path / "mixed", path_efficiency=(0.9 + noise, mixed))
    assert rows(*runs)["path_efficiency"].verdict == "worse"
    runs = disc_runs(tmp_path / "radius", final_distance_to_goal=(inside, edge))
    for each in runs:
        each.config = each.config.replace(goal_radius=0.3)
    assert rows(*runs)["final_distance_to_goal"].verdict == "worse"


def test_values_up_to_the_best_are_a_test_more(tmp_path):
    """Holm's correction counts it, so that no more marks are false than the page says."""
    random = np.random.default_rng(0)
    one = 1.3 + random.normal(size=40)
    runs = disc_runs(tmp_path, final_distance_to_goal=(one, one + 0.3 + random.normal(size=40)))
    for each in runs:
        each.columns = {name: each.columns[name] for name in ("completed", "final_distance_to_goal")}
    row = rows(*runs)["final_distance_to_goal"]
    assert row.up_to_best is not None
    p = row.values.p, row.up_to_best.p
    assert row.clear == (min(holm(p)) <= 0.05) and row.directed == (holm(p)[1] <= 0.05)
    assert row.judged(1.0, 0.01).verdict == "worse" and row.judged(0.01, 0.2).verdict == "differs"
    assert row.judged(1.0, 1.0).verdict == ""


def test_a_report_of_many_begins_is_searched_once(tmp_path):
    """A regular expression would take minutes for it."""
    (tmp_path / "report.html").write_text(compare.REPLAY[0] * 100_000)
    began = time.process_time()
    with pytest.raises(InputError, match="report.html: holds none"):
        compare._replay(tmp_path / "report.html")
    assert time.process_time() - began < 5.0

"""The report and the figures in it: self-contained, complete, and equal to a plain computation."""

import dataclasses
import html.parser
import io
import json
import re

import numpy as np
import pytest
import scipy.stats
from rich.console import Console

from sean_jax.config import RunConfig
from sean_jax.core.errors import InputError
from sean_jax.evaluation import compare, results, table
from sean_jax.evaluation import run as start
from sean_jax.web import pages
from support.reports import EPISODES, NAMES, evaluation, page
from support.runs import run


def test_means_equal_plain_ones():
    found, given = results.aggregate_episodes(evaluation()), evaluation()
    spent = given.metrics["time_in_situation"].astype(float)
    assert found["situations"]["cross_path"]["mean"] == pytest.approx(spent[:, 1].sum() / spent[:, 0].sum())
    efficiency = given.metrics["path_efficiency"]
    overall = found["metrics"]["path_efficiency"]["overall"]
    assert overall["mean"] == pytest.approx(efficiency[given.completed].mean())
    assert overall["episodes"] == given.completed.sum()
    joined = given.completed & (spent[:, 3] > 0)
    assert found["metrics"]["path_efficiency"]["join_group"]["mean"] == pytest.approx(efficiency[joined].mean())
    assert found["metrics"]["path_efficiency"]["down_path"] is None
    assert found["metrics"]["completed"]["overall"]["mean"] == pytest.approx(8 / 12)
    counts = given.metrics["intimate_robot_on_person"]
    assert found["metrics"]["intimate_robot_on_person"]["empty"]["mean"] == pytest.approx(counts[:, 5].mean())
    assert found["metrics"]["min_distance_to_people"]["overall"]["mean"] == pytest.approx(0.8)
    json.dumps(found, allow_nan=False)


def test_situations_overlap_and_every_second_is_counted_once_as_alone_several_or_none():
    shares = evaluation().concurrence()  # 1 s of none, 2 s of the first, 4 s of the first two
    assert shares["cross_path"] == pytest.approx((2 / 7, 4 / 7)) and shares["down_path"] == pytest.approx((0, 4 / 7))
    assert shares["none"][0] == pytest.approx(1 / 7) and shares["several"][1] == pytest.approx(4 / 7)
    seconds = np.random.default_rng(5).integers(0, 9, 32).astype(float)
    shares = dataclasses.replace(evaluation(), together=seconds).concurrence()
    alone = sum(shares[name][0] for name in NAMES)
    assert alone + shares["none"][0] + shares["several"][1] == pytest.approx(1.0)
    for bit, name in enumerate(NAMES):
        inside = sum(value for index, value in enumerate(seconds) if format(index, "05b")[::-1][bit] == "1")
        assert sum(shares[name]) == pytest.approx(inside / seconds.sum())


@pytest.mark.parametrize("width", [60, 76, 80, 100, 200])
def test_terminal_table_holds_every_situation_at_any_width(width):
    """Where it is too narrow, tables follow each other: no column is cut, none is left out."""
    console = Console(width=width, file=io.StringIO())
    found = {"situations": {}, "metrics": results.aggregate_episodes(evaluation())["metrics"]}
    names = [*NAMES, "frontal_approach", "a_situation_of_mine", *(f"situation_{k}" for k in range(7))]
    for k, name in enumerate(names):
        found["situations"][name] = {"mean": 0.01 * (k + 30) + 1e-4, "interval": [0.0, 1.0]}
    table.print_table(console, found, evaluation().definitions, "runs", 0.25)
    said = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert max(len(line) for line in said.splitlines()[:-1]) <= width and "…" not in said
    shares = [cell for line in said.splitlines() if "share of robot time" in line for cell in line.split()[5:]]
    assert shares == ["100.0", *(f"{k + 30}.0" for k in range(len(names)))]
    assert "In no situation: 25.0 % of the robot's time." in said


def test_episodes_file_is_the_same_bytes_again_and_reads_back(tmp_path):
    for name in ("one.csv", "two.csv"):
        results.write_episodes(tmp_path / name, evaluation())
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "two.csv").read_bytes()
    lines = (tmp_path / "one.csv").read_text().splitlines()
    rows = [dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]]
    assert len(rows) == EPISODES and rows[3]["task"] == "leave_group" and rows[3]["completed"] == "False"
    assert float(rows[5]["seconds"]) == pytest.approx(evaluation().seconds[5], abs=1e-3)
    assert rows[0]["time_in_situation__down_path"] == "0.000000"
    assert rows[4]["min_distance_to_people"] == ""
    counts = evaluation().metrics["intimate_robot_on_person"]
    assert [int(row["intimate_robot_on_person__empty"]) for row in rows] == counts[:, 5].tolist()


class Reader(html.parser.HTMLParser):
    """Collects the attributes that could lead outside, the tags left open, and the text."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "action")]
        if tag not in ("meta", "br", "hr", "img", "link", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "action")]

    def handle_data(self, data):
        self.text += data


def test_report_is_whole_and_refers_to_nothing_outside():
    given = evaluation()
    rows = table.table_rows(results.aggregate_episodes(given), given.definitions, complete=True)
    text = page(given)
    reader = Reader()
    reader.feed(text)
    assert not reader.open
    assert reader.links and all(link.startswith(("#", "data:")) for link in reader.links)
    assert "://" not in text and "@import" not in text
    for row in rows:
        assert row.title in reader.text and row.definition in reader.text
    for said in ("yard <1>", "sean run --environment yard", "1.2.3", "Episode 0 · join group · not completed"):
        assert said in reader.text
    results_section = text.split("<div class=topics>")[1].split("</section>")[0]
    topics = [part.split("</details>")[0] for part in results_section.split("<details")[1:]]
    assert sum(each.count("<tr>") - 1 for each in topics) == len(rows), "each row is in one topic"
    assert [each.startswith(" open") for each in topics].count(True) == 2 < len(topics)
    ids = [part.split('"')[0] for part in text.split(' id="')[1:]]
    assert len(set(ids)) == len(ids)


def test_one_number_for_each_share_and_no_interval_without_width():
    given = evaluation()
    counts = np.zeros_like(given.metrics["intimate_robot_on_person"])
    counts[2, 0] = counts[2, 4] = 1
    given = dataclasses.replace(given, metrics=given.metrics | {"intimate_robot_on_person": counts})
    found, text = results.aggregate_episodes(given), page(given)
    bars = re.findall(r"</i></dd>\s*<dd>([\d.]+) %</dd>", text)
    cells = next(row for row in table.table_rows(found, given.definitions) if row.name == "share").cells[1:]
    assert bars[: len(NAMES)] == cells and len(bars) == len(NAMES) + 2
    pairs = re.findall(r"([-\d.]+) to ([-\d.]+)</", text)
    assert pairs and all(low != high for low, high in pairs)
    line = text.split("<th>intimate, robot on person</th>")[1].split("</tr>")[0]
    assert line.count("<td class=zero>0.00</td>") == 4 and "0.08<small>0.00 to 0.25</small>" in line
    none = found["metrics"]["intimate_robot_on_person"]["cross_path"]
    assert none["interval"][1] == pytest.approx(-np.log(0.025) / EPISODES) and "fewer than 0.31 per episode" in text
    done = scipy.stats.binomtest(8, 12).proportion_ci(0.95, "wilson")
    assert found["metrics"]["completed"]["overall"]["interval"] == pytest.approx([done.low, done.high])


def test_cards_say_better_or_worse_than_the_baseline(tmp_path):
    text = page(evaluation())
    assert "lower is better" in text and "than" not in text.split("<div class=tiles>")[1].split("<section>")[0]
    for shift, verdict in ((5.0, "✗ worse"), (-5.0, "✓ better")):
        folder = tmp_path / verdict
        folder.mkdir()
        runs = [compare.read_run(run(folder / "before", 0)), compare.read_run(run(folder / "now", 0, shift))]
        reader = Reader()
        reader.feed(page(evaluation(), runs))
        before, now = (each.columns["seconds"].mean() for each in runs)
        said = " ".join(reader.text.split())
        assert f"{verdict} than before: {now:.1f} against {before:.1f} difference {shift:+.1f}" in said
        assert "no clear difference from before:" in reader.text and "in 40 common episodes" in reader.text
    with pytest.raises(InputError, match="missing: holds no config.yaml"):
        start(RunConfig(baseline=tmp_path / "missing", out=tmp_path / "out"), Console(quiet=True))


def test_pages_escape_every_text_and_mark_cells():
    rows = [[pages.Cell("<name>", "small & print"), "a<b", pages.Cell("3", kind="ours")]]
    parts = pages.table(["", "<head>", ""], rows), pages.note("<note>"), pages.facts({"<key>": "<value>"}), "<raw>"
    text = pages.page("<title>", "<kicker>", [pages.section("<part>", *parts), pages.origin("sean --a '<b>'", {})])
    body = text.split("</style>")[1]
    for word in ("name", "head", "note", "key", "value", "raw", "title", "kicker", "part", "b"):
        assert f"<{word}>" not in body and f"&lt;{word}&gt;" in body, word
    assert "<th>&lt;name&gt;<small>small &amp; print</small></th><td>a&lt;b</td><td class=ours>3</td>" in body
    reader = Reader()
    reader.feed(text)
    assert not reader.open

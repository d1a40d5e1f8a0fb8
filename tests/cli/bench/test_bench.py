"""``sean bench``: what it measures, writes and refuses."""

import json

import numpy as np
import pytest

from sean_jax.cli import bench, command_line
from sean_jax.cli.bench import Measurement
from sean_jax.config import BenchConfig

ABOUT = {
    "device": "cpu", "devices": 2, "memory": 2**30, "environment": "lab", "people": 4, "robot": "kuri",
    "dynamics": "twin", "versions": {"jax": "0.10.2"},
}  # fmt: skip


def row(part: str, batch: int, per_second: float, pixels: int = 0, people: int = 4, devices: int = 1) -> Measurement:
    microseconds = 1e6 * batch / per_second
    return Measurement(part, "things", batch, people, pixels, devices, per_second, microseconds, 2.0, 2.0**14)


ROWS = [
    row("step", 1, 100.0), row("step", 16, 900.0), row("depth", 16, 500.0, 3072), row("images", 1, 50.0, 3072),
    row("images", 16, 700.0, 3072), row("images", 4, 90.0, 307200), row("pictures", 4, 20.0, 3072),
    row("crowd", 1, 1e6, people=62), row("crowd", 8, 2e6, people=62), row("crowd", 1, 5e5, people=1000),
    row("devices", 16, 900.0), row("devices", 32, 1710.0, devices=2),
    Measurement("compile", "seconds, cold", 64, 4, 0, 1, 12.0, 1.2e7, 12.0, float("nan")),
]  # fmt: skip


def test_the_table_lines_up_and_says_what_follows():
    lines = [bench.line(row) for row in ROWS]
    assert {len(line) for line in lines} == {len(bench.HEAD)}
    assert lines[1][bench.HEAD.index("us a call") :].split() == ["17778", "2.0", "16.0"]
    assert lines[-1].split()[-1] == "-"
    notes = bench.notes(ROWS, ABOUT)
    assert any("16 KiB a scenario without images at B = 16; about 6.6e+04 would fit into 1 GiB" in n for n in notes)
    assert notes[-1] == "2 devices: 1.90 times one (95 % of each)."
    # Sixteen scenarios take less than twice as long as one, and eight crowds more than twice as long as one.
    assert [note for note in notes if "launches" in note] == [
        "step, 4 people: a call takes 10000 us at B = 1 and 17778 us at B = 16; so far launches and the host bind.",
        "images, 4 people: a call takes 20000 us at B = 1 and 22857 us at B = 16; so far launches and the host bind.",
    ]
    assert bench.notes([], ABOUT) == []


def test_the_picture_shows_each_series():
    left, middle, right = bench.picture(ROWS, ABOUT).axes
    assert [len(axes.lines) for axes in (left, middle, right)] == [3, 2, 2]
    np.testing.assert_allclose(middle.lines[1].get_ydata(), [500.0, 2000.0])  # ns per agent-step at the larger batch
    assert right.lines[0].get_xdata().tolist() == [3072, 307200]
    np.testing.assert_allclose(right.lines[0].get_ydata(), [1e6 / 700, 1e6 / 90])
    empty = bench.picture(ROWS[:2], ABOUT).axes
    assert not empty[1].lines and "not measured" in empty[1].texts[0].get_text()


@pytest.mark.night
def test_sean_bench_measures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench, "SIZES", ((16, 12),))
    monkeypatch.setattr(bench, "IMAGE", (8, 6))
    monkeypatch.setattr(bench, "CROWDS", (8,))
    monkeypatch.setattr(bench, "turns", lambda batch: 2)
    arguments = ["--environment", "lab", "--people", "4", "--dynamics", "twin", "--batches", "2"]
    timing = ["--only", "step,images,crowd", "--repeats", "1", "--seconds", "0.01", "--out", str(tmp_path / "found")]
    assert command_line.main(["bench", *arguments, *timing]) == 0
    found = json.loads((tmp_path / "found" / "bench.json").read_text(encoding="utf-8"))
    rows = found["rows"]
    assert {row["part"] for row in rows} == {"step", "images", "crowd"}
    assert all(row["per_second"] > 0 and row["compile_seconds"] > 0 for row in rows)
    assert {row["batch"] for row in rows if row["part"] == "step"} == {2}
    assert (tmp_path / "found" / "bench.png").stat().st_size > 10_000
    table = (tmp_path / "found" / "table.txt").read_text(encoding="utf-8").splitlines()
    assert table[1] == bench.HEAD and len(table) >= 2 + len(rows)
    assert "picture:" in capsys.readouterr().out


def test_the_default_measures_all():
    assert BenchConfig().parts == list(bench.CASES)

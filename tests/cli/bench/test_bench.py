"""``sean bench``: what it measures, writes and refuses."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import social_forces
from sean_jax.cli import bench, command_line
from sean_jax.cli.bench import Row, programs, roofline, workload
from sean_jax.config import BenchConfig
from sean_jax.social_forces import kernel, model

ABOUT = {
    "device": "cpu", "devices": 2, "memory": 2**30, "environment": "lab", "people": 4, "robot": "kuri",
    "dynamics": "twin", "versions": {"jax": "0.10.2"}, "rates": {"operations": 1e12, "special": 2e11, "bytes": 3e10},
}  # fmt: skip


def row(part: str, batch: int, per_second: float, pixels: int = 0, people: int = 4, devices: int = 1) -> Row:
    needs = {"operations": 30.0, "special": 2.0, "bytes": 1.0}
    made = Row(part, "things", batch, people, pixels, devices, per_second, 1e4, "operations", needs, 1.0, 2.0, 2.0**14)
    return replace(made, microseconds=1e6 * batch / per_second)


ROWS = [
    row("step", 1, 100.0), row("step", 16, 900.0), row("depth", 16, 500.0, 3072), row("images", 1, 50.0, 3072),
    row("images", 16, 700.0, 3072), row("images", 4, 90.0, 307200), row("pictures", 4, 20.0, 3072),
    row("crowd", 1, 1e6, people=62), row("crowd", 8, 2e6, people=62), row("crowd", 1, 5e5, people=1000),
    row("devices", 16, 900.0), row("devices", 32, 1710.0, devices=2),
    Row("compile", "seconds, cold", 64, 4, 0, 1, 12.0, float("nan"), "", {}, 1.2e7, 12.0, float("nan")),
]  # fmt: skip


def test_the_table_lines_up_and_says_what_follows():
    lines = [bench.line(row) for row in ROWS]
    assert {len(line) for line in lines} == {len(bench.HEAD)}
    places = [(bench.HEAD.index(name), name) for name in ("floor /s", "share", "bound by")]
    assert lines[1][places[0][0] :].split()[:4] == ["1e+04", "9.0", "%", "operations"]
    assert lines[-1][places[0][0] :].split()[:3] == ["-", "-", "-"]
    notes = bench.notes(ROWS, ABOUT)
    assert any("16 KiB a scenario without images at B = 16; about 6.6e+04 would fit into 1 GiB" in n for n in notes)
    assert notes[-1] == "2 devices: 1.90 times one (95 % of each)."
    assert "floor: what the program needs, at 1e+12 operations, 2e+11 special, 3e+10 bytes a second" in notes[0]
    # Sixteen scenarios take less than twice as long as one, and eight crowds more than twice as long as one.
    assert [note for note in notes if "launches" in note] == [
        "step, 4 people: a call takes 10000 us at B = 1 and 17778 us at B = 16; so far launches and the host bind, "
        "not the floor.",
        "images, 4 people: a call takes 20000 us at B = 1 and 22857 us at B = 16; so far launches and the host bind, "
        "not the floor.",
    ]
    assert bench.notes([], ABOUT) == []


def needs(function, *arguments, platform="cpu", **turns):
    """Operations, special functions and bytes of a function."""
    found = roofline.count(jax.jit(function).trace(*arguments).jaxpr, turns, platform)
    return found["operations"], found["special"], found["bytes"]


def test_counts_of_programs():
    x = jnp.ones(7)

    def turn(x, _):
        jnp.sin(x)  # unused
        return jnp.exp(x * x) + x * x, None  # the square once

    assert needs(lambda x: jax.lax.scan(turn, x, length=3)[0], x) == (3 * 14, 3 * 7, 3 * 2 * 7 * 4)
    assert needs(lambda x: jax.vmap(lambda y: y @ y)(x[None]), x) == (14, 0, 0)
    branches = dict(cpu=lambda x: x + 1, default=lambda x: x / (x + 1))
    assert needs(lambda x: jax.lax.platform_dependent(x, **branches), x) == (7, 0, 0)
    assert needs(lambda x: jax.lax.platform_dependent(x, **branches), x, platform="gpu") == (7, 7, 0)

    def search(x):
        with jax.named_scope("search"):
            return jax.lax.while_loop(lambda x: x[0] < 9.0, lambda x: x + 1, x)

    assert needs(search, x)[0] == 7 + 1 and needs(search, x, search=2.5)[0] == 2.5 * (7 + 1)


def test_counts_of_a_kernel():
    """A test of distance for each other, and the law for those within reach: three operations and one of the sum."""

    def law(shared, own, other):
        return (own[0] - other[0]) * (own[1] - other[1])

    def sums(x):
        rows = None, jnp.ones(1), (x, x), (x, x)
        near, shared, *both = rows
        return kernel.sum_pairs(kernel.trace(law, *rows), near, jnp.ones(()), shared, *both)

    some, more = (needs(sums, jnp.ones(128), platform="gpu", within_reach=turns)[0] for turns in (5.0, 6.0))
    assert more - some == 128 * 4
    assert 128 * (128 * 6) <= some - 5 * (more - some) <= 128 * (128 * 6 + 3)
    program = programs.crowd(62, 4, 2)
    traced = program.run.trace(*program.fixed, program.carried).jaxpr
    cpu, gpu = (roofline.count(traced, program.loops, platform)["operations"] for platform in ("cpu", "gpu"))
    assert 2 * gpu < cpu < 10 * gpu


def test_the_pairs_that_floors_count():
    people, _, exact = workload.crowd(20, 0)
    forces = social_forces.preset("helbing1995")
    apart = np.linalg.norm(exact["x"][:, None] - exact["x"][None], axis=-1)
    reach = float(model.cutoff(forces))
    found = programs.crowd(20, 2, 2, 0, "helbing1995").loops["within_reach"]
    assert found == pytest.approx(((apart < reach).sum() - 20) / 20) and found > 0


def test_what_binds():
    rates = roofline.Rates(operations=100.0, special=10.0, bytes=50.0)
    assert roofline.floor({"operations": 50.0, "special": 1.0, "bytes": 1.0}, rates) == (2.0, "operations")
    assert roofline.floor({"operations": 50.0, "special": 10.0, "bytes": 1.0}, rates, 4) == (4.0, "special")
    assert roofline.floor({"operations": 0.0, "special": 0.0, "bytes": 25.0}, rates) == (2.0, "bytes")
    measured = roofline.rates()
    assert measured.operations > measured.special > 0 < measured.bytes


def test_the_picture_shows_each_series():
    left, middle, right = bench.picture(ROWS, ABOUT).axes
    assert [len(axes.lines) for axes in (left, middle, right)] == [3, 2, 2]
    np.testing.assert_allclose(middle.lines[1].get_ydata(), [500.0, 2000.0])  # ns per agent-step at the larger batch
    assert right.lines[0].get_xdata().tolist() == [3072, 307200]
    np.testing.assert_allclose(right.lines[0].get_ydata(), [1e6 / 700, 1e6 / 90])
    empty = bench.picture(ROWS[:2], ABOUT).axes
    assert not empty[1].lines and "not measured" in empty[1].texts[0].get_text()


@pytest.mark.slow
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
    for row in rows:
        assert row["floor"] == pytest.approx(found["rates"][row["bound"]] / row["needs"][row["bound"]])
    assert {row["batch"] for row in rows if row["part"] == "step"} == {2}
    assert (tmp_path / "found" / "bench.png").stat().st_size > 10_000
    table = (tmp_path / "found" / "table.txt").read_text(encoding="utf-8").splitlines()
    assert table[1] == bench.HEAD and len(table) >= 2 + len(rows)
    assert "picture:" in capsys.readouterr().out


def test_the_default_measures_all():
    assert BenchConfig().parts == list(bench.CASES)

"""The mutation test: what it puts in, where it does not, which tests it asks, and that it notices and survives."""

import ast
import json

import pytest

from support.checkout import ROOT, benchmark
from support.commands import python

pytestmark = pytest.mark.form

program = benchmark("mutants")
SOURCE = b'''"""A docstring: 1 < 2."""
from typing import Literal
__all__ = ["f" + "g"]
LIMIT = 0.5  # m

def f(x: Literal[1], y: int = 3, *, on: bool = True) -> "1 < 2":
    """1 + 1"""
    if not on or x <= y:
        raise ValueError(f"{x + 1} is {y < 2}" + "!")
    z = jnp.where((x > 0) & on, x, -y)
    return z.sum(axis=1) + g(x, y) * min(x, 2.0)
'''


def test_what_is_put_in():
    made = program.mutants("f.py", SOURCE)
    changes = {(mutant.line, mutant.after) for mutant in made}
    assert len(changes) == len(made) and all(mutant.before != mutant.after for mutant in made)
    lines = {
        4: {"LIMIT = 0.75 # m"},
        6: {
            'def f(x: Literal[1], y: int = 4, *, on: bool = True) -> "1 < 2":',
            'def f(x: Literal[1], y: int = 3, *, on: bool = False) -> "1 < 2":',
        },
        8: {"if not on and x <= y:", "if on or x <= y:", "if not on or x < y:"},
        10: {
            "z = jnp.where((x >= 0) & on, x, -y)",
            "z = jnp.where((x > 1) & on, x, -y)",
            "z = jnp.where((x > 0) | on, x, -y)",
            "z = jnp.where((x > 0) & on, x, y)",
            "z = x",
            "z = -y",
        },
        11: {
            "return z.sum(axis=0) + g(x, y) * min(x, 2.0)",
            "return z.sum(axis=1) - g(x, y) * min(x, 2.0)",
            "return z.sum(axis=1) + g(y, x) * min(x, 2.0)",
            "return z.sum(axis=1) + g(x, y) / min(x, 2.0)",
            "return z.sum(axis=1) + g(x, y) * max(x, 2.0)",
            "return z.sum(axis=1) + g(x, y) * min(x, 3.0)",
        },
    }
    assert changes == {(line, text) for line, texts in lines.items() for text in texts}


@pytest.mark.slow
def test_mutants_of_the_package_are_python():
    for folder in program.FOLDERS:
        some = program.drawn(folder, 6, 1)
        assert program.drawn(folder, 3, 1) == some[:3] != program.drawn(folder, 3, 2)
        for mutant in some:
            source = (program.PACKAGE / mutant.path).read_bytes()
            ast.parse(source[: mutant.begin] + mutant.text.encode() + source[mutant.end :])


@pytest.mark.slow
def test_which_tests_are_asked():
    for folder in program.FOLDERS:
        for path in program.modules(folder):
            assert all((program.TESTS / file).is_file() for file in program.test_files(path)), path
    assert "test_metrics.py" in {file.rpartition("/")[2] for file in program.test_files("metrics/path.py")}
    others = program.independent("metrics/path.py")
    assert "sean_jax.core.geometry" in others and "sean_jax.classifiers.predicates" in others
    assert not {"sean_jax.metrics", "sean_jax.metrics.path", "sean_jax.simulation.episode_runner"} & set(others)
    seconds = {"a::slow": 9.0, "a::quick": 1.0, "b::best": 2.0, "b::aside": 0.1, "c::aside": 0.1}
    choice = program.Choice(
        seconds, {"a::slow": [7], "a::quick": [8], "b::best": [7, 8], "b::aside": [], "c::aside": []}
    )
    assert choice.order(7) == ["b::best", "b::aside", "a::slow", "a::quick", "c::aside"]


def test_the_summary_knows_what_is_explained(monkeypatch):
    known = {
        f"graph/x.py: a < b -> {after}": {"folder": "graph", "line": 3, "noticed": noticed}
        for after, noticed in (("one", "test_x"), ("two", None), ("three", None))
    }
    monkeypatch.setattr(program, "reasons", lambda: {"graph/x.py: a < b -> two": "equal"})
    rows = [row.split() for row in program.summary(known)]
    assert rows[1:3] == [["graph", "3", "1", "1", "1"], ["all", "3", "1", "1", "1"]]
    assert rows[3:] == [["graph/x.py:3:", "a", "<", "b", "->", "three"]]


def test_results_hold_what_can_still_be_put_in(tmp_path):
    """The last line of each; lines of a package that has changed go, and others are drawn besides those known."""
    out = tmp_path / "mutants.jsonl"
    first, second, third = program.drawn("survey", 3, 0)
    names = [third.name, "studies/survey/study.py: gone -> away", first.name, third.name]
    lines = [{"folder": "survey", "name": name, "line": 0, "noticed": f"test_{k}"} for k, name in enumerate(names)]
    out.write_text("".join(json.dumps(line) + "\n" for line in lines))
    program.tidy(out)
    found = program.results(out)
    assert {name: (line["line"], line["noticed"]) for name, line in found.items()} == {
        first.name: (first.line, "test_2"), third.name: (third.line, "test_3")
    }  # fmt: skip
    assert len(out.read_text().splitlines()) == 2 and [file.name for file in tmp_path.iterdir()] == [out.name]
    assert program.drawn("survey", 3, 0, found) == [first, third, second]


def test_committed_results_are_what_the_table_says():
    """results/README.md has the rows of the summary."""
    rows = [row.split() for row in program.summary(program.results(program.RESULTS))[1 : len(program.FOLDERS) + 2]]
    text = (ROOT / "results/README.md").read_text()
    for row in rows:
        assert f"| {' | '.join(row)} |" in text, row


@pytest.mark.night
def test_a_few_mutants(tmp_path):
    """Of sean2.py, in processes of their own; a second run has nothing left to do."""
    out = tmp_path / "mutants.jsonl"
    told = ["benchmarks/mutants.py", "--only", "classifiers", "--count", 7, "--out", out]
    python(*told, cwd=ROOT)
    (line,) = map(json.loads, out.read_text().splitlines())
    assert line["noticed"].startswith("tests/test_") and line["folder"] == "classifiers"
    again = python(*told, cwd=ROOT, timeout=60)
    assert again.splitlines()[1].split() == ["classifiers", "1", "1", "0", "0"]
    assert len(out.read_text().splitlines()) == 1


def test_a_mutant_that_no_test_reaches_survives():
    """Pytest without tests does not end with 0."""
    (mutant,) = program.drawn("survey", 1, 0)
    assert program.attempt(mutant, program.Choice({}, {})) == (None, 0.0)

"""Two thousand inputs made wrong at random: each is refused in sentences or read, at once, and nothing becomes NaN."""

import ast
import collections
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from support import fuzzing

MUTANTS = 2000
SEED = int(os.environ.get("SEAN_JAX_FUZZ_SEED", "0"))


def answers(seed: int, count: int, folder: Path) -> dict[int, dict]:
    """What became of each mutant; a worker that ends in the middle of one is followed by the next."""
    found, first = {}, 0
    while first < count:
        command = [
            sys.executable,
            fuzzing.__file__,
            str(seed),
            str(first),
            str(count - first),
            str(folder / f"{first}"),
        ]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        assert lines, done.stderr
        found |= {line["number"]: line for line in lines if "result" in line}
        last = lines[-1]
        if "result" not in last:
            said = f"ended by signal {-done.returncode}: {done.stderr[-1000:]}"
            found[last["number"]] = {**last, "result": "wrong", "said": said}
        first = last["number"] + 1
    return found


def test_every_reader_of_outside_data_has_a_kind():
    """A new function that reads, and that no kind names, fails here: give it a seed."""
    named = {reader for readers in fuzzing.READERS.values() for reader in readers}
    assert not named & fuzzing.ELSEWHERE.keys() and not (named | fuzzing.ELSEWHERE.keys()) & fuzzing.OWN
    assert fuzzing.readers() == named | fuzzing.ELSEWHERE.keys() | fuzzing.OWN
    made = ast.parse(Path(fuzzing.__file__).read_text(encoding="utf-8")).body
    tables = [node for node in made if isinstance(node, ast.FunctionDef) and node.name in ("kinds", "studies", "bags")]
    words = {node.value for table in tables for node in ast.walk(table) if isinstance(node, ast.Constant)}
    assert fuzzing.READERS.keys() <= words


@pytest.mark.night
def test_two_thousand_mutants_are_refused_in_sentences_or_are_finite(tmp_path):
    found = answers(SEED, MUTANTS, tmp_path)
    assert sorted(found) == list(range(MUTANTS))
    wrong = [f"mutant {one['number']} of seed {SEED}, {one['kind']}: {one['said']}" for one in found.values()
             if one["result"] == "wrong"]  # fmt: skip
    assert not wrong, "\n\n".join(wrong)
    count = collections.Counter((one["kind"], one["result"]) for one in found.values())
    for kind in {one["kind"] for one in found.values()}:  # mutants that all fail alike would test nothing
        few = count[kind, "refused"] + count[kind, "accepted"] < 30
        assert count[kind, "refused"] >= 5 and (few or count[kind, "accepted"] >= 1), (kind, count)
    assert not list(tmp_path.glob("MUJOCO_LOG.TXT")), "MuJoCo writes where the program was started"


def test_mutants_are_the_same_again():
    """So that a number and a seed are enough to see one again, whoever came before."""
    import random

    given = fuzzing.walks()
    again = [[fuzzing.mutated(random.Random(f"0 {number}"), "people.csv", given) for number in range(30)] for _ in "ab"]
    assert again[0] == again[1] and len({str(content) for content in again[0]}) > 20

"""What CI runs: its jobs are legs of .ci/run that exist, and their shards are all tests, each of them once."""

import re
import subprocess
from types import SimpleNamespace

import pytest
import yaml

from support import sharding
from support.checkout import ROOT

pytestmark = pytest.mark.form
RUN = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
LEGS = {leg for names in re.findall(r'^(?:change|others)="([a-z ]+)"$', RUN, re.M) for leg in names.split()}


def jobs() -> dict[str, dict]:
    """Of all workflows, by file and name."""
    paths = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
    return {
        f"{path.name}: {name}": job
        for path in paths
        for name, job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].items()
    }


def rows(job: dict) -> list[dict]:
    """The matrix of a job; one empty row for a job without one."""
    return job.get("strategy", {}).get("matrix", {}).get("include", [{}])


def legs(job: dict) -> set[str]:
    """Those that its steps call, by name or from the matrix."""
    commands = " ".join(step.get("run", "") for step in job["steps"])
    called = re.findall(r"\.ci/run ([a-z ]+|\$\{\{ matrix\.leg \}\})", commands)
    from_matrix = {leg for row in rows(job) for leg in row.get("leg", "").split()}
    return {leg for words in called for leg in (from_matrix if words.startswith("$") else words.split())}


def test_jobs_end_and_call_legs_that_exist():
    assert LEGS and set(re.findall(r"^([a-z]+)\(\) \{$", RUN, re.M)) >= LEGS
    called: set[str] = set()
    for name, job in jobs().items():
        assert job.get("timeout-minutes"), f"{name} has no timeout-minutes"
        assert legs(job) <= LEGS, name
        called |= legs(job)
    assert called | {"adapters"} == LEGS, "night calls adapters"


def test_shards_of_a_job_are_all_shards():
    for name, job in jobs().items():
        shards: dict[str, list[str]] = {}
        for row in rows(job):
            if "shard" in row:
                shards.setdefault(row["leg"], []).append(row["shard"])
        for leg, names in shards.items():
            assert names == [f"{shard}/{len(names)}" for shard in range(1, len(names) + 1)], f"{name}: {leg}"


@pytest.mark.parametrize(
    "words", [["all"], ["quick", "--shard"], ["quick", "--shard", "0/3"], ["slow", "--shard", "2"]]
)
def test_a_leg_that_is_none_is_refused(words):
    done = subprocess.run([ROOT / ".ci" / "run", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.startswith("usage: .ci/run")


def test_pages_agree_on_what_the_checks_take():
    readme, contributing = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "CONTRIBUTING.md"))
    rows = dict(re.findall(r"^\| `([^`]+)` \| .* \| (.*) \|$", contributing, re.M))
    assert rows["pytest -n auto"] in " ".join(readme.split()).partition("The second runs the tests, ")[2][:40]
    assert f"On 2 cores: {rows['.ci/run']}." in RUN


def test_files_that_legs_and_durations_name_are_there():
    named = {*re.findall(r"\btests/\S+\.py\b", RUN), *(name for name, _ in sharding.read_durations())}
    assert [name for name in sorted(named) if not (ROOT / name).is_file()] == []


def test_files_are_dealt_once_and_about_equally():
    seconds = {f"tests/test_{number}.py": float(number % 7) for number in range(60)}
    hands = sharding.deal(seconds, 4)
    assert sorted(name for hand in hands for name in hand) == sorted(seconds)
    loads = [sum(seconds[name] for name in hand) for hand in hands]
    assert max(loads) - min(loads) <= max(seconds.values())


@pytest.mark.parametrize("text", ["0/3", "4/3", "2", "2/", "a/b"])
def test_what_is_no_shard_is_refused(text):
    assert sharding.parse_shard("2/3") == (1, 3)
    with pytest.raises(pytest.UsageError, match="is no shard"):
        sharding.parse_shard(text)


def test_a_shard_keeps_whole_files(monkeypatch):
    nodes = [f"tests/test_{name}.py::test_{each}" for name in "abc" for each in ("one", "two")]
    kept, left = [], []
    config = SimpleNamespace(hook=SimpleNamespace(pytest_deselected=lambda items: left.extend(items)))
    for shard in "1/2", "2/2":
        monkeypatch.setenv("SHARD", shard)
        items = [SimpleNamespace(nodeid=node, keywords={}) for node in nodes]
        sharding.pytest_collection_modifyitems(config, items)
        kept.append([item.nodeid for item in items])
    assert sorted(kept[0] + kept[1]) == sorted(item.nodeid for item in left) == nodes
    files = [{node.partition("::")[0] for node in shard} for shard in kept]
    assert files[0] and files[1] and not files[0] & files[1]

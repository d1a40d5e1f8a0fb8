"""Shards of the tests, for the jobs of CI: whole files, dealt by the seconds that durations.csv has for them.

``SHARD=2/3 pytest`` runs the second of three shards; ``DURATIONS=1 pytest`` writes what it measures into the table.
"""

import collections
import csv
import os
import re
from pathlib import Path

import pytest

TABLE = Path(__file__).parents[1] / "durations.csv"
KINDS = "quick", "slow"
UNMEASURED = 10.0  # [s] of a file that the table does not have yet


def read_durations() -> dict[tuple[str, str], float]:
    """Seconds by file and kind."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        return {(row["file"], kind): float(row[kind]) for row in csv.DictReader(file) for kind in KINDS if row[kind]}


def deal(seconds: dict[str, float], shards: int) -> list[set[str]]:
    """Files of each shard: the longest file first, always to the shard that has least."""
    hands: list[set[str]] = [set() for _ in range(shards)]
    loads = [0.0] * shards
    for name in sorted(seconds, key=lambda name: (-seconds[name], name)):
        least = loads.index(min(loads))
        hands[least].add(name)
        loads[least] += seconds[name]
    return hands


def parse_shard(text: str) -> tuple[int, int]:
    """Number of the shard, from 0, and of all shards.

    Raises:
        pytest.UsageError: it is not like 2/3.
    """
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise pytest.UsageError(f"SHARD={text} is no shard: write the second of three as SHARD=2/3")
    return int(match[1]) - 1, int(match[2])


def kind(keywords) -> str:
    """The column of a test."""
    return "slow" if "slow" in keywords else "quick"


def file_of(nodeid: str) -> str:
    """tests/core/test_clock.py of tests/core/test_clock.py::test_ends."""
    return nodeid.partition("::")[0]


@pytest.hookimpl(trylast=True)  # among the tests that -m leaves
def pytest_collection_modifyitems(config, items):
    """Keeps the tests of one shard. All shards deal the same files, so that each test is in one of them."""
    if not os.environ.get("SHARD"):
        return
    shard, shards = parse_shard(os.environ["SHARD"])
    known = read_durations()
    seconds: dict[str, float] = collections.defaultdict(float)
    for name, column in sorted({(file_of(item.nodeid), kind(item.keywords)) for item in items}):
        seconds[name] += known.get((name, column), UNMEASURED)
    mine = deal(seconds, shards)[shard]
    config.hook.pytest_deselected(items=[item for item in items if file_of(item.nodeid) not in mine])
    items[:] = [item for item in items if file_of(item.nodeid) in mine]


class Durations:
    """Sums the seconds of a run by file and kind, and writes them into the table when it ends."""

    def __init__(self):
        self.seconds = collections.Counter()

    def pytest_runtest_logreport(self, report):
        """Adds a setup, a test or a teardown."""
        self.seconds[file_of(report.nodeid), kind(report.keywords)] += report.duration

    def pytest_sessionfinish(self):
        """Writes the table: measured files anew, others as they were, without those that are gone."""
        known = read_durations() | self.seconds
        files = sorted({name for name, _ in known if (TABLE.parent.parent / name).is_file()})
        with TABLE.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["file", *KINDS])
            for name in files:
                cells = [known.get((name, column)) for column in KINDS]
                writer.writerow([name, *("" if cell is None else f"{cell:.1f}" for cell in cells)])


def pytest_configure(config):
    """Only the process that starts the others writes."""
    if os.environ.get("DURATIONS") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations())

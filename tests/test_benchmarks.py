"""The benchmark programs run, at toy size, and print the table that they promise."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def run(*arguments: str) -> list[str]:
    """Lines that a program prints; it is run from the checkout, so its own folder is where it imports from."""
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_crowd():
    lines = run("benchmarks/crowd.py", "--sizes", "1x12", "2x12", "--walls", "0", "8", "--presets", "helbing1995")
    assert lines[1].split()[:3] == ["preset", "B", "N"] and lines[-1].startswith("peak resident memory")
    rows = [line.split() for line in lines[2:-1]]
    assert [row[:4] for row in rows] == [["helbing1995", b, "12", w] for b in "12" for w in "08"]
    for row in rows:
        assert float(row[4]) > 0 and float(row[5]) > 0
    for row in rows[:2]:  # errors against the float64 loop after 1 and 20 steps
        assert float(row[-2]) <= 1e-5 and float(row[-1]) <= 1e-3
    assert all(row[-3:] == ["-"] * 3 for row in rows[2:])


@pytest.mark.slow
def test_step():
    lines = run("benchmarks/step.py", "--batches", "2", "--people", "14", "--dynamics", "twin")
    parts = [line[12:33].strip() for line in lines[2:]]
    assert parts == ["direct_pedestrians", "move_pedestrians", "move_robot", "classify", "measure", "step",
                     "policy go_to_goal", "step + policy"]  # fmt: skip
    assert all(float(line[33:].split()[0]) > 0 for line in lines[2:])


@pytest.mark.slow
def test_drivers():
    arguments = "--episodes", "2", "--seconds", "2", "--environment", "lab", "--conditions", "graph, join_group"
    lines = run("benchmarks/drivers.py", *arguments)
    names = [line[:18].strip() for line in lines[4:]]
    assert names == ["stand", "go_to_goal", "social_costmap", "orca", "expert", "social_costmap 0.5"]
    assert all(float(line.split()[-1]) > 0 for line in lines[4:])


@pytest.mark.slow
def test_sensors():
    lines = run("benchmarks/sensors.py", "--batches", "2", "--people", "8", "--sizes", "8x6", "--repeats", "1")
    assert [line[:22].strip() for line in lines[2:]] == ["depth 8x6", "first_person 8x6", "overhead 8x6", "lidar 360"]
    assert all(float(line[22:].split()[2]) > 0 for line in lines[2:])


@pytest.mark.slow
def test_spreading():
    arguments = "--environment", "lab", "--spreading", "0", "10", "--episodes", "2", "--steps", "60"
    lines = run("benchmarks/spreading.py", *arguments)
    rows = [[float(part) for part in line.split()] for line in lines[1:]]
    assert [row[0] for row in rows] == [0, 10] and all(len(row) == 7 and min(row[1:]) >= 0 for row in rows)

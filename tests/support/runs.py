"""Runs: folders as `sean run` writes them, with figures by chance, and what happens in the middle of one."""

import csv
from pathlib import Path

import numpy as np
import yaml

from sean_jax.simulation.episode_runner import Runner

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


def at_second_batch(monkeypatch, what):
    """Do ``what`` with each batch from the second on, as soon as it is simulated."""
    run = Runner.run

    def disturbed(runner, seed, first, *others, **named):
        batch = run(runner, seed, first, *others, **named)
        return (what(batch) or batch) if first else batch

    monkeypatch.setattr(Runner, "run", disturbed)

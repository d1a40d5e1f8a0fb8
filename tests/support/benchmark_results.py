"""Results of the benchmark with figures by chance."""

from pathlib import Path

import numpy as np
import pytest

from sean_jax.config import BenchmarkConfig
from sean_jax.studies.experiments import benchmark, ranks, scores


def columns(random: np.random.Generator, number: int) -> scores.Arrays:
    time = random.uniform(1.0, 9.0, (number, 6))
    time[:, 0] = random.uniform(20, 30, number)
    counts = {name: random.poisson(0.2, (number, 6)).astype(np.float32) for name in benchmark.COUNTED}
    for count in counts.values():
        count[:, 0] = count.sum(1)
    rest = {"time_not_moving": time / 2, "path_efficiency": time[:, 1], "seconds": time[:, 0]}
    return {"completed": random.uniform(size=number) < 0.8, "time_in_situation": time, **counts, **rest}


def place(folder: Path, policy: str, episodes: int, seed: int) -> Path:
    """A complete result with episodes by chance."""
    folder.mkdir()
    random = np.random.default_rng(seed)
    measured = {track: columns(random, episodes) for track in benchmark.TRACKS}
    for track, values in measured.items():
        np.savez_compressed(folder / f"{track}.npz", **values)
    options = BenchmarkConfig(policy=policy, episodes=episodes, out=folder)
    benchmark.write(options, measured, benchmark.describe_of_package(policy))
    return folder


SMALL = "lab-join_group", "lab-random_ab_nav"


def smaller(patch: pytest.MonkeyPatch) -> None:
    """A protocol of two tracks of 20 episodes."""
    patch.setattr(benchmark, "EPISODES", 20)
    patch.setattr(benchmark, "TRACKS", {name: benchmark.TRACKS[name] for name in SMALL})


def entry(name: str, polite: np.ndarray, sensing: str = "raw", trained: bool = False) -> ranks.Entry:
    """An entry with tasks that were completed politely, (seeds, tracks, episodes) bool."""
    counts = dict.fromkeys(scores.ROBOTS_FAULT, np.zeros((polite.shape[-1], 6)))
    time = {"time_in_situation": np.ones((polite.shape[-1], 6))}
    measured = [{str(k): {"completed": row, **counts, **time} for k, row in enumerate(seed)} for seed in polite]
    return ranks.Entry(name, sensing, trained, measured)

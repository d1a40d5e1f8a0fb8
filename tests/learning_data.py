"""What the tests of learning share: a small scenario in the lab, and sixteen recorded episodes of it."""

import functools
from pathlib import Path

import numpy as np

from sean_jax import sensors
from sean_jax.learning import collect_job, demonstrations, protocol
from sean_jax.learning.dataset import Dataset
from sean_jax.learning.options import Collect
from sean_jax.policies import go_to_goal

EPISODES, SEED, SECONDS = 16, 3, 20
DRIVE = go_to_goal


def options(out: Path | None = None, hours: float = 0.05, **others) -> Collect:
    """Of a small collection of small images."""
    small = {"environment": "lab", "people": 4, "dynamics": "twin", "time_limit": float(SECONDS), "seed": SEED}
    return Collect(out=out, hours=hours, **{**small, "width": 16, "height": 12, "batch": EPISODES // 2, **others})


@functools.cache
def setting() -> tuple:
    """Streams, functions of the tasks, and the camera."""
    parts, tasks = protocol.streams(options())
    return parts, tasks, sensors.camera(parts[0].scenario, "depth", width=16, height=12)


@functools.cache
def batches() -> tuple[demonstrations.Batch, demonstrations.Batch]:
    """Episodes 0 to 7 join a group and 8 to 15 leave one: the first two shards of the collection."""
    parts, tasks, eye = setting()
    programs = demonstrations.prepare(parts[0].scenario, tasks, DRIVE, eye)
    size = EPISODES // 2
    first, second = (
        demonstrations.simulate(programs, part.scenario, SEED, part.turn, np.arange(k * size, (k + 1) * size))
        for k, part in enumerate(parts)
    )
    return first, second


def write(folder: Path, hours: float = 0.05) -> Dataset:
    """A dataset of these episodes."""
    parts, _, eye = setting()
    data = collect_job._begun(options(folder, hours), parts, eye)
    for stream, batch in enumerate(batches()):
        data.commit(stream, batch)
    return data

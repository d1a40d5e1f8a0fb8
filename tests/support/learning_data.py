"""What the tests of learning share: a small scenario in the lab, and sixteen recorded episodes of it."""

import functools
from pathlib import Path

import numpy as np

from sean_jax import sensors
from sean_jax.config import CollectConfig, gather, validate
from sean_jax.core.data_types import Scenario
from sean_jax.learning import collection, dataset
from sean_jax.learning.collection import row_record, simulate_shard, streams
from sean_jax.learning.dataset import Dataset
from sean_jax.learning.policy import load_policy
from sean_jax.policies import go_to_goal
from sean_jax.simulation import episode_runner
from sean_jax.simulation.scenario_stack import as_stacks

EPISODES, SEED, SECONDS = 16, 3, 20
DRIVE = go_to_goal


def options(out: Path | None = None, hours: float = 0.05, **others) -> CollectConfig:
    """Of a small collection of small images."""
    small = {"environment": "lab", "people": 4, "dynamics": "twin", "time_limit": float(SECONDS), "seed": SEED}
    images = {"width": 16, "height": 12, "batch": EPISODES // 2}
    values = {"out": out, "hours": hours, **small, **images, **others}
    return validate(CollectConfig, gather(CollectConfig, values))


@functools.cache
def setting() -> tuple[dict[str, Scenario], sensors.Camera]:
    """Streams and the camera."""
    parts = streams(options())
    return parts, sensors.camera(parts["join_group"], "depth", width=16, height=12)


@functools.cache
def batches() -> tuple[dataset.EpisodeBatch, dataset.EpisodeBatch]:
    """Episodes 0 to 7 join a group and 8 to 15 leave one: the first two shards of the collection."""
    parts, camera = setting()
    scenarios = list(parts.values())
    record = row_record(scenarios[0], camera)
    running = episode_runner.Runner(scenarios, DRIVE, EPISODES // 2, "collect", record)
    first, second = (simulate_shard(running, SEED, shard, stream=shard) for shard in range(2))
    return first, second


def begin(config: CollectConfig, parts: dict[str, Scenario] | None = None) -> Dataset:
    """The dataset that a collection of these options begins or continues; ``parts`` in place of its scenarios."""
    own, camera = setting()
    parts = own if parts is None else parts
    policy = load_policy(config.policy, next(iter(parts.values())))
    stacks = dict(zip(parts, as_stacks(list(parts.values())), strict=True))
    return collection._open(config, stacks, policy, camera)


def write(folder: Path, hours: float = 0.05) -> Dataset:
    """A dataset of these episodes."""
    data = begin(options(folder, hours))
    for stream, batch in enumerate(batches()):
        data.commit(stream, batch)
    return data


def write_fine(folder: Path) -> Dataset:
    """A dataset of ten rows a second that were made up: the robot goes a metre along x from row to row."""
    data = begin(options(folder, rate=10))
    size, rows = EPISODES // 2, np.arange(10 * SECONDS)
    for stream in range(2):
        made = {name: np.zeros((size, len(rows), *shape), kind) for name, (shape, kind) in data.fields.items()}
        made["pose"][:, :, 0], made["pose"][:, :, 2] = rows, 1.0
        made["depth"][:] = rows[:, None, None]
        lengths = np.where(np.arange(size) < 4, len(rows), 50)
        data.commit(stream, dataset.EpisodeBatch(made, lengths, np.ones(size, bool)))
    return data


def crc32c(data: bytes) -> int:
    """The checksum of Castagnoli (RFC 3720), bit by bit."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
    return value ^ 0xFFFFFFFF

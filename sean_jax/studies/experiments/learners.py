"""Networks of an experiment that learn alike: on each of several datasets, with several seeds (section V-C).

They are trained side by side, each in a folder of its own. What is finished is not done again.
"""

from __future__ import annotations

import dataclasses
import functools
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from sean_jax import learning
from sean_jax.config import CollectConfig, ImitationConfig
from sean_jax.learning.examples import balanced_probabilities
from sean_jax.studies.experiments import parts, shares
from sean_jax.studies.experiments.claims import Training
from sean_jax.studies.experiments.drivers import Driver

if TYPE_CHECKING:
    from sean_jax.base import Policy, Scenario
    from sean_jax.learning.imitation import TrainState

LOADING = threading.Lock()


@dataclasses.dataclass(frozen=True)
class Learner:
    """Networks that learn alike, one for each dataset and seed."""

    name: str  # of their files
    folder: Path  # of the experiment
    data: CollectConfig  # of all demonstrations together
    datasets: int  # equal parts of them, each of which is learned from by itself
    seeds: tuple[int, ...]
    options: dict[str, Any]  # of all trainings

    @property
    def networks(self) -> list[tuple[int, int]]:
        """Number of the dataset and of the seed of each."""
        return [(dataset, seed) for dataset in range(self.datasets) for seed in range(len(self.seeds))]

    def summary(self, network: tuple[int, int]) -> Path:
        """The file that is written when a network is trained."""
        return self.folder / f"trained-{self.name}-{network[0]}-{network[1]}.json"

    def training(self, network: tuple[int, int]) -> ImitationConfig:
        """How a network is trained."""
        dataset, seed = network
        return ImitationConfig(
            method="imitation", dataset=self.data.folder, part=(dataset + 1, self.datasets), seed=self.seeds[seed],
            out=self.folder / f"policy-{self.name}-{dataset}-{seed}", **self.options,
        )  # fmt: skip

    def driver(self, name: str) -> Driver:
        """The networks as one driver.

        Returns:
            The driver; each network has its share of the episodes.
        """
        folders = [self.training(network).folder for network in self.networks]
        return Driver(name, tuple(functools.partial(_load, folder) for folder in folders))


def collect(config: CollectConfig, learners: Sequence[Learner], watch: Callable[[float], None]) -> None:
    """Collect demonstrations in a folder of their own, or continue it, if a network still needs them.

    Args:
        watch: is told the share that is done.
    """
    needed = [learner for learner in learners if learner.data.folder == config.folder]
    if any(parts.load(learner.summary(network)) is None for learner in needed for network in learner.networks):
        learning.collect(config, watch)


def train(learner: Learner, watch: Callable[[float], None]) -> list[Training]:
    """Train the networks that are missing, side by side.

    Args:
        watch: is told the share that is done.
    """
    missing = [network for network in learner.networks if parts.load(learner.summary(network)) is None]
    if missing:
        asked = [learner.training(network) for network in missing]
        began = time.perf_counter()
        states = learning.train_ensemble(asked, watch)
        seconds = (time.perf_counter() - began) / len(missing)
        for network, own, state in zip(missing, asked, states, strict=True):
            parts.save(learner.summary(network), _summary(own, state) | {"seconds": seconds})
    return [cast(Training, parts.load(learner.summary(network))) for network in learner.networks]


def mean(summaries: Sequence[Training]) -> Training:
    """How the networks of a learner were trained on average."""
    return cast(Training, {name: float(np.mean([each[name] for each in summaries])) for name in summaries[0]})


def _summary(trained: ImitationConfig, state: TrainState) -> dict[str, Any]:
    data = learning.open_dataset(trained.dataset, trained.part)
    flags = data.read(data.episodes, ("situations",))["situations"]
    odds = balanced_probabilities(flags) if trained.balance else np.full(len(flags), 1 / len(flags))
    shared = odds @ (flags / np.maximum(flags.sum(1, keepdims=True), 1))
    return {
        "examples": int(data.example_count),
        "entropy": float(shares.normalised_entropy(shared)),
        "epochs": int(state.epoch),
        "best_epoch": int(state.best_epoch),
        "loss": float(state.best),
    }


def _load(folder: Path, scenario: Scenario) -> Policy:
    with LOADING:  # All have one name, since a policy of another name would be compiled again.
        return dataclasses.replace(learning.load(folder, scenario), name="learned")

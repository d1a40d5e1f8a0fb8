"""Figure 4: policies that learned among people of three behaviors, and social_costmap, in three scenarios.

For each behavior (G, R, H) several datasets of demonstrations are collected, and several networks are trained on each.
These policies, one with balanced examples (B), ``social_costmap`` for the paper's navigation stack (N) and the
demonstrator (E) are evaluated on the same numbered episodes (section V-C), in equal shares for the networks.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import learning
from sean_jax.config import (
    CollectConfig,
    Figure4Config,
    ImitationConfig,
    LearnedConfig,
    Named,
    ScenarioConfig,
    validate,
)
from sean_jax.config.workspace import Workspace, identity
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.io.files import listed
from sean_jax.learning.collection import check_collection, streams
from sean_jax.learning.dataset import ConcatDataset, open_datasets
from sean_jax.learning.examples import balanced_probabilities
from sean_jax.learning.policy import check_policy, load_policy
from sean_jax.metrics import METRICS
from sean_jax.simulation.episode_runner import Runner, even_batch, max_batch
from sean_jax.studies.experiments import ExperimentPart, demonstrations, page, pictures, run_parts, shares, write_csv
from sean_jax.studies.experiments.measures import (
    BALANCED,
    DEMONSTRATOR,
    INTIMATE,
    LEARNED,
    METRIC_NAMES,
    NAVIGATION,
    WAITING,
    Columns,
    claims,
    contrasts,
    episode_rows,
    figure4_estimates,
    has_learned,
)
from sean_jax.studies.experiments.results_table import Table, join
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.studies.experiments.table1 import description, fields

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.core.data_types import Policy, Scenario

LOADING = threading.Lock()
Drivers = Mapping[str, Sequence[Callable[["Scenario"], "Policy"]]]
"""Name -> one policy, or several, each of which drives its share of the episodes."""


def run_figure4(options: Figure4Config, console: Console | None = None) -> Path:
    """Collect, train and evaluate the missing parts of the folder, and write the report.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        WriteError: another process writes in the folder.
        FileError: a file in the folder is damaged.
        FloatingPointError: a metric is not finite. Finished parts stay.

    Source: section V-C, Figure 4.
    """
    for behavior in BEHAVIORS:
        check_collection(collection(options, behavior, options.hours))
    for name in baselines(options):
        check_policy(name, ScenarioConfig(), "--baselines", typed=True)
    datasets = demonstrations.read(options.demonstrations)
    if datasets and options.datasets > 1:
        raise InputError("--datasets: all demonstrations of a behavior are one dataset; leave --datasets out.")
    known = identity(options)
    known["options"]["demonstrations"] = [data.fingerprint() for data in datasets.values()]
    with Workspace(options.folder, known).open() as work:
        places = scenarios(options)
        for behavior in BEHAVIORS:
            demonstrations.check(datasets, behavior, places[behavior][0])
        work.begin()  # after all checks, so that wrong options leave no files
        outcomes = run_parts(_parts(options, work, places, datasets), console, "figure 4")
        training = {policy: mean_training(outcomes[f"training {policy}"]) for policy in (*LEARNED, BALANCED)}
        driven = demonstrations.examples(datasets)
        write_figure4(options, _measured(options, outcomes), training, driven)
    return options.folder


def baselines(options: Figure4Config) -> list[str]:
    """Policies besides the paper's, N and E: names, folders or FILE.py:NAME, each once.

    Raises:
        InputError: one has the name of a column.
    """
    names = [name for name in dict.fromkeys(listed(options.baselines)) if name != "none"]
    for name in names:
        if name in (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR):
            raise InputError(f"--baselines: '{name}' is a column of the figure already; give another driver's name.")
    return names


def scenarios(options: LearnedConfig) -> dict[str, list[Scenario]]:
    """behavior -> the scenarios in which policies are evaluated."""
    return {b: list(streams(description(options, b, options.people)).values()) for b in BEHAVIORS}


def _parts(
    options: Figure4Config,
    work: Workspace,
    places: dict[str, list[Scenario]],
    datasets: Mapping[str, ConcatDataset],
) -> list[ExperimentPart]:
    """The parts of the experiment, in an order in which they could run one by one."""
    names = {DEMONSTRATOR: options.demonstrator, NAVIGATION: "social_costmap"}
    alone = names | {name: name for name in baselines(options)}
    drivers = {name: {name: [functools.partial(load_policy, policy, typed=True)]} for name, policy in alone.items()}
    learners = {policy: learner(options, work, policy, datasets) for policy in (*LEARNED, BALANCED)}
    trainings, last = learning_parts(learners)
    every = {"learned": {policy: learner.loaders() for policy, learner in learners.items()}}  # they share programs
    alike, learned = driving_parts(options, work, places, drivers), driving_parts(options, work, places, every, last)
    return [*trainings, *alike, *learned]


def _measured(options: Figure4Config, outcomes: dict[str, Any]) -> Table:
    """The rows of all episodes, policy by policy."""
    measured = []
    for policy in (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR, *baselines(options)):
        learned = has_learned(policy)
        networks = (options.datasets, options.trainings) if learned else (1, 1)
        for behavior in BEHAVIORS:
            columns = outcomes[f"{'learned' if learned else policy} in {behavior}"][policy]
            measured.append(episode_rows(columns, policy, behavior, networks))
    return join(measured)


def sizes(options: LearnedConfig) -> tuple[int, int, int]:
    """Numbers of datasets, of trainings on each, and of episodes of each network, rounded up."""
    datasets, trainings = options.datasets, options.trainings
    return datasets, trainings, math.ceil(options.episodes / (datasets * trainings))


def collection(
    options: LearnedConfig, behavior: str, hours: float, name: str | None = None, rate: int = 1
) -> CollectConfig:
    """The demonstrations of all datasets together, since many episodes at once fill a GPU.

    ``name`` is the name of their folder, the behavior's by default.

    Raises:
        InputError: a value is out of range.
    """
    image: dict[str, Any] = dict(width=32, height=24) if options.quick else {}
    chosen: dict[str, Any] = dict(hours=hours * options.datasets, rate=rate, seed=options.seed) | image
    chosen |= dict(policy=Named(kind=options.demonstrator), out=options.folder / f"demonstrations-{name or behavior}")
    return validate(CollectConfig, fields(options, behavior, options.people) | chosen)


def learner(
    options: Figure4Config, work: Workspace, policy: str, datasets: Mapping[str, ConcatDataset] | None = None
) -> Learner:
    """The networks of a learned policy: G, R, H or B.

    ``datasets`` are demonstrations by behavior; those of the other behaviors are collected, with images as large.
    """
    behavior = LEARNED.get(policy, "graph")
    name = "graph-balanced" if policy == BALANCED else behavior
    data, more = collection(options, behavior, options.hours), {"balance": policy == BALANCED}
    if not datasets:
        return Learner(name, work, data, options, more)
    first = next(iter(datasets.values()))
    height, width = first.image_shape
    data = data.model_copy(update={"width": width, "height": height, "rate": first.rate})
    folders = tuple(part.folder for part in datasets[behavior].parts) if behavior in datasets else ()
    return Learner(name, work, data, options, more, folders)


def write_figure4(
    options: Figure4Config, measured: Table, training: dict[str, dict[str, float]], driven: Table
) -> None:
    """Write figure4.csv, contrasts.csv, claims.csv, the figure and report.html.

    Args:
        measured: rows of ``measures.episode_rows``.
        training: policy -> as trained-NAME.json, means over its networks.
        driven: rows of ``demonstrations.examples``.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, estimates = options.folder, figure4_estimates(measured)
    rows = [
        (policy, behavior, f"{measure}_{situation}" if situation else measure, *value[:3])
        for (policy, behavior, measure, situation), value in estimates.items()
        if measure != WAITING or value.episodes
    ]
    write_csv(folder / "figure4.csv", "policy,behavior,measure,mean,low,high", rows)

    tests = contrasts(measured)
    rows = [
        (test["one"], test["other"], test["measure"], *test["difference"][:3], test["effect"], test["p"], test["holm"])
        for test in tests
    ]
    write_csv(folder / "contrasts.csv", "policy,other,measure,difference,low,high,d,p,holm", rows)

    tested_claims = claims(measured)
    rows = [
        (*(f'"{claim[name]}"' for name in ("statement", "paper", "ours")), claim["holds"], f"{claim['share']:.4f}")
        for claim in tested_claims
    ]
    write_csv(folder / "claims.csv", "statement,paper,ours,holds,share_of_resamples", rows)

    policies = measured.levels("policy")
    grids = pictures.grids(policies, estimates)
    pictures.save(folder, {"figure4-grids": grids})
    report = page.figure4(options, policies, estimates, tests, tested_claims, training, grids, driven)
    writing.write(folder / "report.html", report)


# ------------------------------------------------------------------ networks


@dataclasses.dataclass(frozen=True)
class Learner:
    """Networks with equal options, one for each dataset and seed; trained in parallel, each in its own folder."""

    name: str  # of their files
    work: Workspace  # of the experiment
    data: CollectConfig  # of all demonstrations together, equal parts of which are the datasets
    experiment: LearnedConfig
    options: dict[str, Any]  # of all trainings, beside those of the experiment
    demonstrations: tuple[Path, ...] = ()  # datasets in place of ``data``

    @property
    def networks(self) -> list[tuple[int, int]]:
        """Number of the dataset and of the seed of each."""
        return list(itertools.product(range(self.experiment.datasets), range(self.experiment.trainings)))

    def summary(self, network: tuple[int, int]) -> str:
        """The name of the file that is written when a network is trained."""
        return f"trained-{self.name}-{network[0]}-{network[1]}.json"

    def missing(self) -> list[tuple[int, int]]:
        """The networks that are not trained yet."""
        return [network for network in self.networks if self.work.load(self.summary(network)) is None]

    def training(self, network: tuple[int, int]) -> ImitationConfig:
        """How a network is trained."""
        (dataset, seed), options = network, self.experiment
        chosen: dict[str, Any] = {"epochs": options.epochs, "batch": 256 if options.quick else 1024, **self.options}
        first, *others = self.demonstrations or (self.data.folder,)
        return ImitationConfig(
            method="imitation", dataset=first, datasets=tuple(others), part=(dataset + 1, options.datasets),
            seed=options.seed + seed, out=self.work.folder / f"policy-{self.name}-{dataset}-{seed}", **chosen,
        )  # fmt: skip

    def loaders(self) -> list[Callable[[Scenario], Policy]]:
        """A function that loads it for each network."""
        return [functools.partial(_load, self.training(network).folder) for network in self.networks]


def _load(folder: Path, scenario: Scenario) -> Policy:
    with LOADING:  # one name for all, since a policy of another name would be compiled again
        return dataclasses.replace(learning.load(folder, scenario), name="learned")


def learning_parts(learners: Mapping[str, Learner]) -> tuple[list[ExperimentPart], list[str]]:
    """The parts that collect demonstrations and train networks, and the name of the last.

    The trainings run one after the other, because orbax mixes up what several threads save.
    """
    every = list(learners.values())
    data = {learner.data.folder.name: learner.data for learner in every if not learner.demonstrations}
    parts = [ExperimentPart(name, functools.partial(demonstrate, config, every)) for name, config in data.items()]
    last: list[str] = []
    for name, learner in learners.items():
        needs = last if learner.demonstrations else [learner.data.folder.name, *last]
        parts.append(ExperimentPart(f"training {name}", functools.partial(train, learner), tuple(needs)))
        last = [parts[-1].name]
    return parts, last


def demonstrate(config: CollectConfig, learners: Sequence[Learner], tell: Callable[[float], None]) -> None:
    """Collect demonstrations in their own folder, or resume it, if a network still needs them."""
    if any(learner.missing() for learner in learners if learner.data.folder == config.folder):
        learning.collect(config, tell)


def train(learner: Learner, tell: Callable[[float], None]) -> list[dict[str, float]]:
    """Train the networks that are missing, side by side; the summaries of all."""
    if missing := learner.missing():
        configs = [learner.training(network) for network in missing]
        began = time.perf_counter()
        states = learning.train_ensemble(configs, tell)
        seconds = (time.perf_counter() - began) / len(missing)
        for network, config, state in zip(missing, configs, states, strict=True):
            best = state.best
            epochs = {"epochs": int(state.update), "best_epoch": int(best.update), "loss": -float(best.value)}
            learner.work.save(learner.summary(network), _examples(config) | epochs | {"seconds": seconds})
    return [learner.work.load(learner.summary(network)) for network in learner.networks]


def _examples(config: ImitationConfig) -> dict[str, Any]:
    """The number of examples of a training, and the entropy of their situations, from 0 to 1."""
    data = open_datasets([config.dataset, *config.datasets], config.part)
    flags = data.read(data.episodes, ("situations",))["situations"]
    odds = balanced_probabilities(flags) if config.balance else np.full(len(flags), 1 / len(flags))
    shared = odds @ (flags / np.maximum(flags.sum(1, keepdims=True), 1))
    return {"examples": int(data.example_count), "entropy": float(shares.normalised_entropy(shared))}


def mean_training(summaries: Sequence[dict[str, float]]) -> dict[str, float]:
    """The means over the trainings of a learner's networks."""
    return {name: float(np.mean([summary[name] for summary in summaries])) for name in summaries[0]}


# ------------------------------------------------------------------ driving


def driving_parts(
    options: LearnedConfig,
    work: Workspace,
    places: Mapping[str, list[Scenario]],
    groups: Mapping[str, Drivers],
    needs: Sequence[str] = (),
) -> list[ExperimentPart]:
    """A part for each group of drivers and behavior, after the parts ``needs``; drivers of a group share programs."""
    whole = math.prod(sizes(options))
    return [
        ExperimentPart(
            f"{name} in {behavior}",
            functools.partial(drive, drivers, work, behavior, places[behavior], options.seed, whole),
            tuple(needs),
        )
        for name, drivers in groups.items()
        for behavior in BEHAVIORS
    ]


def drive(
    drivers: Drivers,
    work: Workspace,
    behavior: str,
    kinds: list[Scenario],
    seed: int,
    episodes: int,
    tell: Callable[[float], None],
) -> dict[str, Columns]:
    """Measure drivers that differ only in their parameters, and so share compiled programs.

    A driver whose file is in the folder is not measured again. ``episodes``, from number 0 on, are a multiple of each
    driver's policies.

    Raises:
        FloatingPointError: a measure is not finite; nothing of that driver is written.
    """
    metrics = tuple((name, METRICS[name]) for name in METRIC_NAMES if name in METRICS)
    kinds = [dataclasses.replace(kind, metrics=metrics) for kind in kinds]
    runner, by_driver = None, dict[str, Columns]()
    for turn, (name, policies) in enumerate(drivers.items()):
        file = f"episodes-{file_name(name)}-{behavior}.json"
        if work.load(file) is None:
            share_of_driver = functools.partial(_tell_part, tell, turn, len(drivers))
            runner, columns = _measure(runner, kinds, policies, seed, episodes, share_of_driver)
            if not all(np.isfinite(columns[metric]).all() for metric in ("completed", "seconds", *INTIMATE)):
                raise FloatingPointError(f"{name} in {behavior}: a metric is not finite; nothing of it is written.")
            work.save(file, {metric: np.nan_to_num(values).tolist() for metric, values in columns.items()})
        by_driver[name] = work.load(file)
    return by_driver


def _tell_part(tell: Callable[[float], None], index: int, count: int, share: float) -> None:
    """Tell the progress of one of ``count`` equal pieces."""
    tell((index + share) / count)


def _measure(
    runner: Runner | None,
    kinds: list[Scenario],
    policies: Sequence[Callable[[Scenario], Policy]],
    seed: int,
    episodes: int,
    tell: Callable[[float], None],
) -> tuple[Runner | None, dict[str, np.ndarray]]:
    """The metrics of a driver's episodes, of which each policy drives an equal share; and the programs that ran."""
    together = at_once(len(policies), episodes // len(policies))
    size = episodes // len(policies) * together  # episodes of a batch of policies
    firsts, measured = range(0, len(policies), together), []
    for index, first in enumerate(firsts):
        loaded = [load(kinds[0]) for load in policies[first : first + together]]
        policy = jax.tree.map(lambda *leaves: jnp.stack(leaves), *loaded) if together > 1 else loaded[0]
        if runner is None:
            batch = size if together > 1 else even_batch(size)
            runner = Runner(kinds, policy, batch, "figure4", drivers=together if together > 1 else None)
        runner.policy = policy  # of the same structure, so nothing is compiled again
        share_of_batch = functools.partial(_tell_part, tell, index, len(firsts))
        measured.append(runner.measure(seed, index * size, size, share_of_batch))
    columns = {name: [np.asarray(batch[name], float) for batch in measured] for name in METRIC_NAMES}
    return runner, {name: np.concatenate(values) for name, values in columns.items()}


def at_once(policies: int, episodes: int) -> int:
    """How many policies, with so many episodes each, drive in one batch: as many as fit and share devices evenly."""
    fitting = (n for n in range(2, policies + 1) if policies % n == 0 and n * episodes <= max_batch())
    return max((n for n in fitting if n * episodes % jax.device_count() == 0), default=1)


def file_name(driver: str) -> str:
    """A folder or FILE.py:NAME as a part of a file's name."""
    return driver.strip("./").replace("/", "-").replace("\\", "-").replace(":", "-")

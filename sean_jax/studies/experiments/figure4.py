"""Figure 4: policies that learned among people of three behaviors, and social_costmap, in three scenarios.

For each behavior (G, R, H) several datasets of demonstrations are collected, and several networks are trained on each.
These policies, one with balanced examples (B), ``social_costmap`` for the paper's navigation stack (N) and the
demonstrator (E) are evaluated on the same numbered episodes (section V-C), in equal shares for the networks.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from sean_jax import learning, writing
from sean_jax.config import (
    CollectConfig,
    Figure4Config,
    ImitationConfig,
    LearnedConfig,
    Named,
    ScenarioConfig,
    validate,
)
from sean_jax.errors import InputError
from sean_jax.files import listed
from sean_jax.learning.collection import check_collection, streams
from sean_jax.learning.examples import balanced_probabilities
from sean_jax.learning.policy import check_policy, load_policy
from sean_jax.runner import Runner, even_batch, max_batch
from sean_jax.studies.experiments import page, pictures, shares, table1
from sean_jax.studies.experiments.measures import (
    BALANCED,
    DEMONSTRATOR,
    FOUR,
    INTIMATE,
    LEARNED,
    METRIC_NAMES,
    NAVIGATION,
    Columns,
    Results,
    Training,
    claims,
    episode_measures,
)
from sean_jax.studies.experiments.scheduler import Part, run_parts
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.workspace import Workspace, identity

LOADING = threading.Lock()

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Policy, Scenario
    from sean_jax.learning.imitation import TrainState
    from sean_jax.metrics import Estimate


def run(options: Figure4Config, console: Console | None = None) -> Path:
    """Collect, train and evaluate what the folder lacks, and write the report.

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
        check_policy(name, ScenarioConfig(), "--baselines")
    with Workspace(options.folder, identity(options)).open() as work:
        _run(options, work, console)
    return options.folder


def baselines(options: Figure4Config) -> list[str]:
    """Other policies than those of the paper, N and E: names, folders or FILE.py:NAME, each once.

    Raises:
        InputError: one has the name of a column.
    """
    names = [name for name in dict.fromkeys(listed(options.baselines)) if name != "none"]
    for name in names:
        if name in (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR):
            raise InputError(f"--baselines: '{name}' is a column of the figure already; give another driver's name.")
    return names


def _run(options: Figure4Config, work: Workspace, console: Console | None) -> None:
    policies = (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR, *baselines(options))
    places = {
        behavior: list(streams(CollectConfig(**description(options, behavior))).values()) for behavior in BEHAVIORS
    }
    work.begin()  # after all checks, so that wrong options leave no files
    outcomes = run_parts(_parts(options, work, places), console, "figure 4")
    measured = {
        policy: {behavior: outcomes[_part_name(policy, behavior)][policy] for behavior in BEHAVIORS}
        for policy in policies
    }
    trained = {policy: mean_training(outcomes[f"training {policy}"]) for policy in (*LEARNED, BALANCED)}
    write(options, _results(options, policies, measured, trained))


def _part_name(policy: str, behavior: str) -> str:
    """The name of the part that simulates the policy. Learned policies have one part, since they share programs."""
    return f"{'learned' if policy in LEARNED or policy == BALANCED else policy} in {behavior}"


def _parts(options: Figure4Config, work: Workspace, places: dict[str, list[Scenario]]) -> list[Part]:
    """The parts of the experiment, in an order in which they could run one by one."""
    taught = {policy: learner(options, work, policy) for policy in (*LEARNED, BALANCED)}
    data = {behavior: f"demonstrations in {behavior}" for behavior in reversed(BEHAVIORS)}  # two policies need graph
    jobs: list[Part] = []
    for behavior, name in data.items():
        task = functools.partial(demonstrate, collection(options, behavior, options.hours), tuple(taught.values()))
        jobs.append(Part(name, task))

    def driving(several: tuple[Driver, ...], behavior: str, needs: tuple[str, ...] = ()) -> Part:
        whole = math.prod(sizes(options))
        job = several, work, behavior, places[behavior], options.seed, whole
        return Part(_part_name(several[0].name, behavior), functools.partial(drive, *job), needs)

    names = {NAVIGATION: "social_costmap", DEMONSTRATOR: options.demonstrator}
    for policy in (DEMONSTRATOR, NAVIGATION, *baselines(options)):
        alike = functools.partial(load_policy, names.get(policy, policy))  # the same driver in all episodes
        jobs += [driving((Driver(policy, (alike,)),), behavior) for behavior in BEHAVIORS]
    before: tuple[str, ...] = ()
    for policy, learned in taught.items():  # one after the other: orbax mixes up what several threads save
        needed = data[LEARNED.get(policy, "graph")]
        jobs.append(Part(f"training {policy}", functools.partial(train, learned), (needed, *before)))
        before = (jobs[-1].name,)
    every = tuple(learned.driver(policy) for policy, learned in taught.items())
    jobs += [driving(every, behavior, before) for behavior in BEHAVIORS]  # after the last of the trainings
    return jobs


def sizes(options: LearnedConfig) -> tuple[int, int, int]:
    """Numbers of datasets, of trainings on each, and of episodes of each network, rounded up."""
    datasets, trainings = options.datasets, options.trainings
    return datasets, trainings, math.ceil(options.episodes / (datasets * trainings))


def description(options: LearnedConfig, behavior: str) -> dict[str, Any]:
    """The scenario with people of a behavior: random, handcrafted or graph."""
    return {"preset": options.preset, **table1.fields(options, behavior, options.people)}


def collection(
    options: LearnedConfig, behavior: str, hours: float, name: str | None = None, rate: int = 1
) -> CollectConfig:
    """The demonstrations of all datasets together, since many episodes at once fill a GPU.

    ``name`` is that of their folder, the behavior's by default.

    Raises:
        InputError: a value is out of range.
    """
    image: dict[str, Any] = dict(width=32, height=24) if options.quick else {}
    chosen: dict[str, Any] = dict(hours=hours * options.datasets, rate=rate, seed=options.seed) | image
    chosen |= dict(policy=Named(kind=options.demonstrator), out=options.folder / f"demonstrations-{name or behavior}")
    return validate(CollectConfig, description(options, behavior) | chosen)


def learner(options: Figure4Config, work: Workspace, policy: str) -> Learner:
    """The networks of a learned policy: G, R, H or B."""
    behavior = LEARNED.get(policy, "graph")
    name = "graph-balanced" if policy == BALANCED else behavior
    chosen = training(options) | {"balance": policy == BALANCED}
    return Learner(name, work, collection(options, behavior, options.hours), options.datasets, seeds(options), chosen)


def seeds(options: LearnedConfig) -> tuple[int, ...]:
    """The seeds of the trainings on each dataset."""
    return tuple(options.seed + more for more in range(options.trainings))


def training(options: LearnedConfig) -> dict[str, Any]:
    """The options of all trainings."""
    return {"epochs": options.epochs, "batch": 256 if options.quick else 1024}


# ------------------------------------------------------------------ networks


@dataclasses.dataclass(frozen=True)
class Learner:
    """Networks with equal options, one for each dataset and seed; trained side by side, each in its own folder."""

    name: str  # of their files
    work: Workspace  # of the experiment
    data: CollectConfig  # of all demonstrations together
    datasets: int  # equal parts of them, each for networks of its own
    seeds: tuple[int, ...]
    options: dict[str, Any]  # of all trainings

    @property
    def networks(self) -> list[tuple[int, int]]:
        """Number of the dataset and of the seed of each."""
        return [(dataset, seed) for dataset in range(self.datasets) for seed in range(len(self.seeds))]

    def summary(self, network: tuple[int, int]) -> str:
        """The name of the file that is written when a network is trained."""
        return f"trained-{self.name}-{network[0]}-{network[1]}.json"

    def training(self, network: tuple[int, int]) -> ImitationConfig:
        """How a network is trained."""
        dataset, seed = network
        return ImitationConfig(
            method="imitation", dataset=self.data.folder, part=(dataset + 1, self.datasets), seed=self.seeds[seed],
            out=self.work.folder / f"policy-{self.name}-{dataset}-{seed}", **self.options,
        )  # fmt: skip

    def driver(self, name: str) -> Driver:
        """The networks as one driver; each network drives its share of the episodes."""
        folders = [self.training(network).folder for network in self.networks]
        return Driver(name, tuple(functools.partial(_load, folder) for folder in folders))


def demonstrate(config: CollectConfig, learners: Sequence[Learner], tell: Callable[[float], None]) -> None:
    """Collect demonstrations in their own folder, or resume it, if a network still needs them."""
    needed = [learner for learner in learners if learner.data.folder == config.folder]
    if any(learner.work.load(learner.summary(network)) is None for learner in needed for network in learner.networks):
        learning.collect(config, tell)


def train(learner: Learner, tell: Callable[[float], None]) -> list[Training]:
    """Train the networks that are missing, side by side."""
    missing = [network for network in learner.networks if learner.work.load(learner.summary(network)) is None]
    if missing:
        configs = [learner.training(network) for network in missing]
        began = time.perf_counter()
        states = learning.train_ensemble(configs, tell)
        seconds = (time.perf_counter() - began) / len(missing)
        for network, own, state in zip(missing, configs, states, strict=True):
            learner.work.save(learner.summary(network), _summary(own, state) | {"seconds": seconds})
    return [cast(Training, learner.work.load(learner.summary(network))) for network in learner.networks]


def mean_training(summaries: Sequence[Training]) -> Training:
    """The means over the trainings of a learner's networks."""
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
    with LOADING:  # one name for all, since a policy of another name would be compiled again
        return dataclasses.replace(learning.load(folder, scenario), name="learned")


# ------------------------------------------------------------------ driving


@dataclasses.dataclass(frozen=True)
class Driver:
    """One policy, or several, each of which drives its share of the episodes."""

    name: str
    policies: tuple[Callable[[Scenario], Policy], ...]


def drive(
    drivers: Sequence[Driver],
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
    import jax
    import jax.numpy as jnp

    from sean_jax.metrics import METRICS

    metrics = tuple((name, METRICS[name]) for name in METRIC_NAMES if name in METRICS)
    kinds = [dataclasses.replace(kind, metrics=metrics) for kind in kinds]
    runner = None
    by_driver: dict[str, Columns] = {}
    for turn, driver in enumerate(drivers):
        file = f"episodes-{file_name(driver.name)}-{behavior}.json"
        if work.load(file) is None:
            each = episodes // len(driver.policies)
            shared = at_once(len(driver.policies), each)
            number, measured = each * shared, []
            turns = [driver.policies[first : first + shared] for first in range(0, len(driver.policies), shared)]
            for index, several in enumerate(turns):
                now = [policy(kinds[0]) for policy in several]
                policy = jax.tree.map(lambda *leaves: jnp.stack(leaves), *now) if shared > 1 else now[0]
                if runner is None:
                    size = number if shared > 1 else even_batch(number)
                    runner = Runner(kinds, policy, size, "figure4", drivers=shared if shared > 1 else None)
                runner.policy = policy  # of the same structure, so nothing is compiled again
                done, count = turn * len(turns) + index, len(drivers) * len(turns)
                report = functools.partial(lambda done, count, share: tell((done + share) / count), done, count)
                measured.append(runner.measure(seed, index * number, number, report))
            columns = {
                name: np.concatenate([np.asarray(one[name], float) for one in measured]) for name in METRIC_NAMES
            }
            if not all(np.isfinite(columns[name]).all() for name in ("completed", "seconds", *INTIMATE)):
                text = f"{driver.name} in {behavior}: a metric is not finite; nothing of it is written."
                raise FloatingPointError(text)
            work.save(file, {name: np.nan_to_num(values).tolist() for name, values in columns.items()})
        by_driver[driver.name] = work.load(file)
    return by_driver


def at_once(policies: int, each: int) -> int:
    """How many policies drive ``each`` episodes in one batch: as many as fit and share the devices evenly."""
    import jax

    fitting = (n for n in range(2, policies + 1) if policies % n == 0 and n * each <= max_batch())
    return max((n for n in fitting if n * each % jax.device_count() == 0), default=1)


def file_name(driver: str) -> str:
    """A folder or FILE.py:NAME as a part of a file's name."""
    return driver.strip("./").replace("/", "-").replace("\\", "-").replace(":", "-")


# ------------------------------------------------------------------ results


def _results(
    options: Figure4Config,
    policies: tuple[str, ...],
    measured: dict[str, dict[str, Columns]],
    trained: dict[str, Training],
) -> Results:
    values: dict = {policy: {} for policy in policies}
    situations: dict = {policy: {} for policy in policies}
    for policy in policies:
        for behavior in BEHAVIORS:
            values[policy][behavior], situations[policy][behavior] = episode_measures(measured[policy][behavior])
    results = Results(policies, sizes(options), values, situations, trained)
    results.claims = claims(results)
    return results


def _by_situation(policy: str, behavior: str, cells: Estimate) -> list[str]:
    return [
        f"{policy},{behavior},violations_{situation},{cells.mean[k]:.5f},{cells.low[k]:.5f},{cells.high[k]:.5f}"
        for k, situation in enumerate(shares.NAMES)
    ]


def write(options: Figure4Config, results: Results) -> None:
    """Write figure4.csv, claims.csv, the figure and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, lines = options.folder, ["policy,behavior,measure,mean,low,high"]
    for policy, by_behavior in results.cells.items():
        for behavior, measured in by_behavior.items():
            for name, cell in measured.items():
                lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
            lines += _by_situation(policy, behavior, results.by_situation[policy][behavior])
    more = [(policy, "mean", measured) for policy, measured in results.means.items()]
    more += [(f"{BALANCED}-G", behavior, measured) for behavior, measured in results.more.items()]
    more += [("".join(FOUR), behavior, {"violations": cell}) for behavior, cell in results.harm.items()]
    for policy, behavior, measured in more:
        for name, cell in measured.items():
            lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
    for policy, by_behavior in results.waiting.items():
        for behavior, cell in by_behavior.items():
            if cell.episodes:
                interval = f"{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}"
                lines.append(f"{policy},{behavior},time_not_moving_of_completed,{interval}")
    for behavior, less in results.balancing.items():
        lines += _by_situation(f"{BALANCED}-G", behavior, less)
    writing.write(folder / "figure4.csv", "\n".join(lines) + "\n")
    claim_lines = ["statement,paper,ours,holds,share_of_resamples"]
    for row in results.claims:
        claim_lines.append(f'"{row["statement"]}","{row["paper"]}","{row["ours"]}",{row["holds"]},{row["share"]:.4f}')
    writing.write(folder / "claims.csv", "\n".join(claim_lines) + "\n")
    grids = pictures.grids(results)
    pictures.save(folder, {"figure4-grids": grids})
    writing.write(folder / "report.html", page.figure4(options, results, grids))

"""Figure 4: policies that learned among people of three behaviors, and social_costmap, in three scenarios.

For each behavior (G, R, H) several datasets of demonstrations are collected, and several networks are trained on each.
These policies, one with balanced examples (B), ``social_costmap`` for the paper's navigation stack (N) and the
demonstrator (E) are evaluated on the same numbered episodes (section V-C), of which each network drives its share.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax import writing
from sean_jax.config import CollectConfig, Figure4Config, LearnedConfig, Named, ScenarioConfig, validate
from sean_jax.errors import InputError
from sean_jax.files import listed
from sean_jax.learning.collection import check_collection, streams
from sean_jax.learning.policy import check_policy, load_policy
from sean_jax.studies.experiments import drivers, learners, page, parts, pictures, shares, table1
from sean_jax.studies.experiments.claims import (
    BALANCED,
    DEMONSTRATOR,
    FOUR,
    LEARNED,
    NAVIGATION,
    Results,
    Training,
    claims,
)
from sean_jax.studies.experiments.drivers import Columns, Driver
from sean_jax.studies.experiments.learners import Learner
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.studies.experiments.together import Part, together

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Scenario
    from sean_jax.metrics import Estimate


def run(options: Figure4Config, console: Console | None = None) -> Path:
    """Collect, train and evaluate what the folder lacks, and write the report.

    Args:
        console: shows progress; None shows nothing.

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
    folder = options.folder
    parts.has_started(options)
    with writing.folder_lock(folder):
        _run(options, folder, console)
    return folder


def baselines(options: Figure4Config) -> list[str]:
    """Drivers beside those of the paper, N and E.

    Returns:
        Names, folders or FILE.py:NAME, each once.

    Raises:
        InputError: one has the name of a column.
    """
    names = [name for name in dict.fromkeys(listed(options.baselines)) if name != "none"]
    for name in names:
        if name in (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR):
            raise InputError(f"--baselines: '{name}' is a column of the figure already; give another driver's name.")
    return names


def _run(options: Figure4Config, folder: Path, console: Console | None) -> None:
    policies = (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR, *baselines(options))
    places = {
        behavior: list(streams(CollectConfig(**description(options, behavior))).values()) for behavior in BEHAVIORS
    }
    parts.start(options)  # after all checks, so that wrong options leave no files
    outcomes = together(_parts(options, folder, places), console, "figure 4")
    measured = {
        policy: {behavior: outcomes[_part_name(policy, behavior)][policy] for behavior in BEHAVIORS}
        for policy in policies
    }
    trained = {policy: learners.mean(outcomes[f"training {policy}"]) for policy in (*LEARNED, BALANCED)}
    write(options, folder, _results(options, policies, measured, trained))


def _part_name(policy: str, behavior: str) -> str:
    """The name of the part that simulates the policy. Learned policies have one part, since they share programs."""
    return f"{'learned' if policy in LEARNED or policy == BALANCED else policy} in {behavior}"


def _parts(options: Figure4Config, folder: Path, places: dict[str, list[Scenario]]) -> list[Part]:
    """The parts of the experiment, in an order in which they could run one by one."""
    taught = {policy: learner(options, policy) for policy in (*LEARNED, BALANCED)}
    data = {behavior: f"demonstrations in {behavior}" for behavior in reversed(BEHAVIORS)}  # two policies need graph
    jobs: list[Part] = []
    for behavior, name in data.items():
        work = functools.partial(learners.collect, collection(options, behavior, options.hours), tuple(taught.values()))
        jobs.append(Part(name, work))

    def drive(several: tuple[Driver, ...], behavior: str, needs: tuple[str, ...] = ()) -> Part:
        whole = math.prod(sizes(options))
        asked = several, folder, behavior, places[behavior], options.seed, whole
        return Part(_part_name(several[0].name, behavior), functools.partial(drivers.drive, *asked), needs)

    names = {NAVIGATION: "social_costmap", DEMONSTRATOR: options.demonstrator}
    for policy in (DEMONSTRATOR, NAVIGATION, *baselines(options)):
        alike = functools.partial(load_policy, names.get(policy, policy))  # the same driver in all episodes
        jobs += [drive((Driver(policy, (alike,)),), behavior) for behavior in BEHAVIORS]
    before: tuple[str, ...] = ()
    for policy, learned in taught.items():  # one after the other: orbax mixes up what several threads save
        needed = data[LEARNED.get(policy, "graph")]
        jobs.append(Part(f"training {policy}", functools.partial(learners.train, learned), (needed, *before)))
        before = (jobs[-1].name,)
    every = tuple(learned.driver(policy) for policy, learned in taught.items())
    jobs += [drive(every, behavior, before) for behavior in BEHAVIORS]  # after the last of the trainings
    return jobs


def sizes(options: LearnedConfig) -> tuple[int, int, int]:
    """How many there are of what the intervals are over.

    Returns:
        Datasets, trainings on each, and episodes of each network, enough to make what was asked for.
    """
    datasets, trainings = options.datasets, options.trainings
    return datasets, trainings, math.ceil(options.episodes / (datasets * trainings))


def description(options: LearnedConfig, behavior: str) -> dict[str, Any]:
    """In which scenario people of a behavior are.

    Args:
        behavior: random, handcrafted or graph.
    """
    return {"preset": options.preset, **table1.fields(options, behavior, options.people)}


def collection(
    options: LearnedConfig, behavior: str, hours: float, name: str | None = None, rate: int = 1
) -> CollectConfig:
    """What is demonstrated: the hours of all datasets together, since many episodes at once fill a GPU.

    Args:
        behavior: random, handcrafted or graph.
        hours: of each dataset.
        name: in that of the folder, the behavior's by default.

    Raises:
        InputError: a value cannot be.
    """
    image: dict[str, Any] = dict(width=32, height=24) if options.quick else {}
    told: dict[str, Any] = dict(hours=hours * options.datasets, rate=rate, seed=options.seed) | image
    told |= dict(policy=Named(kind=options.demonstrator), out=options.folder / f"demonstrations-{name or behavior}")
    return validate(CollectConfig, description(options, behavior) | told)


def learner(options: Figure4Config, policy: str) -> Learner:
    """The networks of a learned policy.

    Args:
        policy: G, R, H or B.
    """
    behavior = LEARNED.get(policy, "graph")
    name = "graph-balanced" if policy == BALANCED else behavior
    told = training(options) | {"balance": policy == BALANCED}
    return Learner(
        name, options.folder, collection(options, behavior, options.hours), options.datasets, seeds(options), told
    )


def seeds(options: LearnedConfig) -> tuple[int, ...]:
    """Those of the trainings on each dataset."""
    return tuple(options.seed + more for more in range(options.trainings))


def training(options: LearnedConfig) -> dict[str, Any]:
    """How networks are trained."""
    return {"epochs": options.epochs, "batch": 256 if options.quick else 1024}


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
            values[policy][behavior], situations[policy][behavior] = drivers.measures(measured[policy][behavior])
    results = Results(policies, sizes(options), values, situations, trained)
    results.claims = claims(results)
    return results


def _by_situation(policy: str, behavior: str, cells: Estimate) -> list[str]:
    return [
        f"{policy},{behavior},violations_{situation},{cells.mean[k]:.5f},{cells.low[k]:.5f},{cells.high[k]:.5f}"
        for k, situation in enumerate(shares.NAMES)
    ]


def write(options: Figure4Config, folder: Path, results: Results) -> None:
    """Write figure4.csv, claims.csv, the figure and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    lines = ["policy,behavior,measure,mean,low,high"]
    for policy, by_behavior in results.cells.items():
        for behavior, measured in by_behavior.items():
            for name, cell in measured.items():
                lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
            lines += _by_situation(policy, behavior, results.by_situation[policy][behavior])
    apart = [(policy, "mean", measured) for policy, measured in results.means.items()]
    apart += [(f"{BALANCED}-G", behavior, measured) for behavior, measured in results.more.items()]
    apart += [("".join(FOUR), behavior, {"violations": cell}) for behavior, cell in results.harm.items()]
    for policy, behavior, measured in apart:
        for name, cell in measured.items():
            lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
    for policy, by_behavior in results.waiting.items():
        for behavior, cell in by_behavior.items():
            if cell.episodes:
                interval = f"{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}"
                lines.append(f"{policy},{behavior},time_not_moving_of_completed,{interval}")
    for behavior, less in results.balancing.items():
        lines += _by_situation(f"{BALANCED}-G", behavior, less)
    parts.save(folder / "figure4.csv", "\n".join(lines) + "\n")
    claim_lines = ["statement,paper,ours,holds,share_of_resamples"]
    for row in results.claims:
        claim_lines.append(f'"{row["statement"]}","{row["paper"]}","{row["ours"]}",{row["holds"]},{row["share"]:.4f}')
    parts.save(folder / "claims.csv", "\n".join(claim_lines) + "\n")
    grids = pictures.grids(results)
    pictures.save(folder, {"figure4-grids": grids})
    parts.save(folder / "report.html", page.figure4(options, results, grids))

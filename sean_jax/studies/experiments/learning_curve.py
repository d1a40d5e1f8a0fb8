"""The data of policy G (section V-C): more hours of demonstrations, more examples a second, situations as an input.

The paper has an hour of G's demonstrations, and gives neither the rate of the examples nor the effect of more hours;
its network may have the situations as an input. Each variant imitates the demonstrator on the Behavior Graph, as column
G of Figure 4 does, and drives the same numbered episodes.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING

from sean_jax import writing
from sean_jax.config import CollectConfig, LearningCurveConfig
from sean_jax.flags import number
from sean_jax.learning.collection import check_collection, streams
from sean_jax.studies.experiments import figure4, page, pictures
from sean_jax.studies.experiments.figure4 import Learner
from sean_jax.studies.experiments.measures import Curve, Variant, comparisons, episode_measures
from sean_jax.studies.experiments.scheduler import Part, run_parts
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.workspace import Workspace, identity

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Scenario
    from sean_jax.metrics import Estimate

TEACHER = "graph"  # the people's behavior in all demonstrations


def run(options: LearningCurveConfig, console: Console | None = None) -> Path:
    """Collect, train and evaluate what the folder lacks, and write the report.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        WriteError: another process writes in the folder.
        FileError: a file in the folder is damaged.
        FloatingPointError: a metric is not finite. Finished parts stay.

    Source: section V-C.
    """
    compared = variants(options)
    for variant in compared:
        check_collection(collection(options, variant))
    with Workspace(options.folder, identity(options)).open() as work:
        places = {
            behavior: list(streams(CollectConfig(**figure4.description(options, behavior))).values())
            for behavior in BEHAVIORS
        }
        work.begin()  # after all checks, so that wrong options leave no files
        outcomes = run_parts(_parts(options, work, compared, places), console, "learning curve")
        write(options, _curve(options, compared, outcomes))
    return options.folder


def variants(options: LearningCurveConfig) -> tuple[Variant, ...]:
    """The variants: each amount by itself, the first amount at other rates, and the first with flags."""
    hours, first = sorted(set(options.demonstration_hours)), options.demonstration_hours[0]
    rates = (Variant(first, rate) for rate in options.rates)
    return tuple(dict.fromkeys([*map(Variant, hours), *rates, Variant(first, flags=True)]))


def collection(options: LearningCurveConfig, variant: Variant) -> CollectConfig:
    """The demonstrations of a variant.

    Raises:
        InputError: a value is out of range.
    """
    return figure4.collection(options, TEACHER, variant.hours, variant.data, variant.rate)


def learner(options: LearningCurveConfig, work: Workspace, variant: Variant) -> Learner:
    """The networks of a variant, with so few epochs that the optimizer makes no more steps than ``--updates``."""
    chosen = figure4.training(options)
    chosen |= {"flags": variant.flags}
    data, datasets = collection(options, variant), options.datasets
    learner = Learner(variant.name, work, data, datasets, figure4.seeds(options), chosen)
    own = learner.training((0, 0))
    steps = math.ceil((1.0 - own.validation) * variant.examples / own.batch)  # of an epoch
    most = max(1, options.updates // steps)
    return dataclasses.replace(learner, options=learner.options | {"epochs": min(own.epochs, most)})


def _parts(
    options: LearningCurveConfig, work: Workspace, compared: tuple[Variant, ...], places: dict[str, list[Scenario]]
) -> list[Part]:
    """The parts of the experiment, in an order in which they could run one by one."""
    taught = {variant: learner(options, work, variant) for variant in sorted(compared, key=lambda each: each.examples)}
    configs = {learned.data.folder.name: learned.data for learned in taught.values()}
    jobs = [
        Part(name, functools.partial(figure4.demonstrate, config, tuple(taught.values())))
        for name, config in configs.items()
    ]
    before: tuple[str, ...] = ()
    for variant, learned in taught.items():  # one after the other: orbax mixes up what several threads save
        task = functools.partial(figure4.train, learned)
        jobs.append(Part(f"training {variant.title}", task, (learned.data.folder.name, *before)))
        before = (jobs[-1].name,)
    for flags, behavior in itertools.product((False, True), BEHAVIORS):  # equal networks share programs
        several = [taught[variant].driver(variant.name) for variant in compared if variant.flags == flags]
        job = several, work, behavior, places[behavior], options.seed, math.prod(figure4.sizes(options))
        jobs.append(Part(_part_name(flags, behavior), functools.partial(figure4.drive, *job), before))
    return jobs


def _part_name(flags: bool, behavior: str) -> str:
    return f"driving {'with flags ' if flags else ''}in {behavior}"


def _curve(options: LearningCurveConfig, compared: tuple[Variant, ...], outcomes: dict) -> Curve:
    values: dict = {}
    for variant in compared:
        measured = {b: episode_measures(outcomes[_part_name(variant.flags, b)][variant.name])[0] for b in BEHAVIORS}
        values[variant.name] = {b: {**each, "completed": 100.0 * each["completed"]} for b, each in measured.items()}
    training = {variant.name: figure4.mean_training(outcomes[f"training {variant.title}"]) for variant in compared}
    return Curve(compared, figure4.sizes(options), values, training)


def write(options: LearningCurveConfig, curve: Curve) -> None:
    """Write learning_curve.csv, differences.csv, verdicts.csv, the figure and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, lines = options.folder, ["variant,hours,rate,flags,behavior,measure,mean,low,high"]
    for variant in curve.variants:
        head = f"{variant.name},{number(variant.hours)},{variant.rate},{variant.flags}"
        lines += [f"{head},{row}" for row in _rows(curve.cells[variant.name])]
    writing.write(folder / "learning_curve.csv", "\n".join(lines) + "\n")
    lines = ["variant,other,behavior,measure,mean,low,high"]
    for one, other in comparisons(curve.variants):
        lines += [f"{one.name},{other.name},{row}" for row in _rows(curve.differences(one, other))]
    writing.write(folder / "differences.csv", "\n".join(lines) + "\n")
    lines = ["variant,other,measure,difference,low,high,better,share_of_resamples"]
    for row in curve.verdicts:
        difference = ",".join(f"{value:.5f}" for value in row["difference"][:3])
        lines.append(f"{row['variant']},{row['other']},{row['measure']},{difference},{row['holds']},{row['share']:.4f}")
    writing.write(folder / "verdicts.csv", "\n".join(lines) + "\n")
    figure = pictures.learning_curve(curve)
    pictures.save(folder, {"learning_curve": figure})
    writing.write(folder / "report.html", page.learning_curve(options, curve, figure))


def _rows(estimates: dict[str, dict[str, Estimate]]) -> list[str]:
    return [
        f"{behavior},{measure},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}"
        for behavior, each in estimates.items()
        for measure, cell in each.items()
    ]

"""What the data does for policy G (section V-C): more hours of demonstrations, more examples a second, situations told.

The paper gives G's demonstrations, an hour of them, and says neither how often an example begins nor what more of them
would do; its network may have the situations as an input. Each variant imitates the demonstrator on the Behavior Graph,
as column G of Figure 4 does, and drives the same numbered episodes.
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
from sean_jax.studies.experiments import drivers, figure4, learners, page, parts, pictures
from sean_jax.studies.experiments.learners import Learner
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.studies.experiments.together import Part, together
from sean_jax.studies.experiments.variants import Curve, Variant, comparisons

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Scenario
    from sean_jax.metrics import Estimate

TEACHER = "graph"  # the behavior of the people among whom all demonstrations are


def run(options: LearningCurveConfig, console: Console | None = None) -> Path:
    """Collect, train and evaluate what the folder lacks, and write the report.

    Args:
        console: shows progress; None shows nothing.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        WriteError: another process writes in the folder.
        FileError: a file in the folder is damaged.
        FloatingPointError: a metric is not finite. Finished parts stay.

    Source: section V-C.
    """
    asked = variants(options)
    for variant in asked:
        check_collection(collection(options, variant))
    folder = options.folder
    parts.has_started(options)
    with writing.folder_lock(folder):
        places = {
            behavior: list(streams(CollectConfig(**figure4.description(options, behavior))).values())
            for behavior in BEHAVIORS
        }
        parts.start(options)  # after all checks, so that wrong options leave no files
        outcomes = together(_parts(options, folder, asked, places), console, "learning curve")
        write(options, folder, _curve(options, asked, outcomes))
    return folder


def variants(options: LearningCurveConfig) -> tuple[Variant, ...]:
    """What is compared.

    Returns:
        Each amount by itself, the first one at other rates, and with flags.
    """
    hours, first = sorted(set(options.demonstration_hours)), options.demonstration_hours[0]
    rates = (Variant(first, rate) for rate in options.rates)
    return tuple(dict.fromkeys([*map(Variant, hours), *rates, Variant(first, flags=True)]))


def collection(options: LearningCurveConfig, variant: Variant) -> CollectConfig:
    """What networks of a variant learn from.

    Raises:
        InputError: a value cannot be.
    """
    return figure4.collection(options, TEACHER, variant.hours, variant.data, variant.rate)


def learner(options: LearningCurveConfig, variant: Variant) -> Learner:
    """The networks of a variant.

    Returns:
        What they learn from, and how: in so few epochs that the optimizer makes no more steps than the options say.
    """
    told = figure4.training(options)
    told |= {"flags": variant.flags}
    data, datasets = collection(options, variant), options.datasets
    made = Learner(variant.name, options.folder, data, datasets, figure4.seeds(options), told)
    own = made.training((0, 0))
    steps = math.ceil((1.0 - own.validation) * variant.examples / own.batch)  # of an epoch
    most = max(1, options.updates // steps)
    return dataclasses.replace(made, options=made.options | {"epochs": min(own.epochs, most)})


def _parts(
    options: LearningCurveConfig, folder: Path, asked: tuple[Variant, ...], places: dict[str, list[Scenario]]
) -> list[Part]:
    """The parts of the experiment, in an order in which they could run one by one."""
    taught = {variant: learner(options, variant) for variant in sorted(asked, key=lambda each: each.examples)}
    configs = {learned.data.folder.name: learned.data for learned in taught.values()}
    jobs = [
        Part(name, functools.partial(learners.collect, config, tuple(taught.values())))
        for name, config in configs.items()
    ]
    before: tuple[str, ...] = ()
    for variant, learned in taught.items():  # one after the other: orbax mixes up what several threads save
        work = functools.partial(learners.train, learned)
        jobs.append(Part(f"training {variant.title}", work, (learned.data.folder.name, *before)))
        before = (jobs[-1].name,)
    for flags, behavior in itertools.product((False, True), BEHAVIORS):  # those alike share programs
        several = [taught[variant].driver(variant.name) for variant in asked if variant.flags == flags]
        given = several, folder, behavior, places[behavior], options.seed, math.prod(figure4.sizes(options))
        jobs.append(Part(_part_name(flags, behavior), functools.partial(drivers.drive, *given), before))
    return jobs


def _part_name(flags: bool, behavior: str) -> str:
    return f"driving {'with flags ' if flags else ''}in {behavior}"


def _curve(options: LearningCurveConfig, asked: tuple[Variant, ...], outcomes: dict) -> Curve:
    values: dict = {}
    for variant in asked:
        found = {b: drivers.measures(outcomes[_part_name(variant.flags, b)][variant.name])[0] for b in BEHAVIORS}
        values[variant.name] = {b: {**each, "completed": 100.0 * each["completed"]} for b, each in found.items()}
    training = {variant.name: learners.mean(outcomes[f"training {variant.title}"]) for variant in asked}
    return Curve(asked, figure4.sizes(options), values, training)


def write(options: LearningCurveConfig, folder: Path, curve: Curve) -> None:
    """Write learning_curve.csv, differences.csv, verdicts.csv, the figure and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    lines = ["variant,hours,rate,flags,behavior,measure,mean,low,high"]
    for variant in curve.variants:
        head = f"{variant.name},{number(variant.hours)},{variant.rate},{variant.flags}"
        lines += [f"{head},{row}" for row in _rows(curve.cells[variant.name])]
    parts.save(folder / "learning_curve.csv", "\n".join(lines) + "\n")
    lines = ["variant,other,behavior,measure,mean,low,high"]
    for one, other in comparisons(curve.variants):
        lines += [f"{one.name},{other.name},{row}" for row in _rows(curve.differences(one, other))]
    parts.save(folder / "differences.csv", "\n".join(lines) + "\n")
    lines = ["variant,other,measure,difference,low,high,better,share_of_resamples"]
    for row in curve.verdicts:
        apart = ",".join(f"{value:.5f}" for value in row["difference"][:3])
        lines.append(f"{row['variant']},{row['other']},{row['measure']},{apart},{row['holds']},{row['share']:.4f}")
    parts.save(folder / "verdicts.csv", "\n".join(lines) + "\n")
    figure = pictures.learning_curve(curve)
    pictures.save(folder, {"learning_curve": figure})
    parts.save(folder / "report.html", page.learning_curve(options, curve, figure))


def _rows(found: dict[str, dict[str, Estimate]]) -> list[str]:
    return [
        f"{behavior},{measure},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}"
        for behavior, each in found.items()
        for measure, cell in each.items()
    ]

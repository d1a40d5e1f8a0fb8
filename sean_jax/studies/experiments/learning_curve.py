"""The learning curve of Figure 4's policy G (section V-C): more hours of demonstrations, more examples, situations.

The paper has an hour of G's demonstrations, and gives neither the rate of the examples nor the effect of more hours.
Its network may have the situations as an input.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax.config import CollectConfig, LearningCurveConfig
from sean_jax.config.flags import number
from sean_jax.config.workspace import Workspace, identity
from sean_jax.io import writing
from sean_jax.learning.collection import check_collection
from sean_jax.metrics.bootstrap import hierarchical_resamples
from sean_jax.studies.experiments import page, pictures, run_parts, write_csv
from sean_jax.studies.experiments.figure4 import (
    Learner,
    collection,
    driving_parts,
    learning_parts,
    mean_training,
    scenarios,
)
from sean_jax.studies.experiments.measures import BOUNDS, MEAN, MEASURES, Variant, episode_rows
from sean_jax.studies.experiments.results_table import (
    ALL,
    Estimates,
    Table,
    averaged,
    contrast,
    estimate,
    join,
    samples,
)
from sean_jax.studies.experiments.shares import BEHAVIORS

if TYPE_CHECKING:
    from rich.console import Console

CURVE_BOUNDS = {**BOUNDS, "completed": (0.0, 100.0)}  # in percent
BETTER = {"completed": 1.0, "time_not_moving": -1.0, "violations": -1.0}  # the sign of an improvement
KEYS = "policy", "behavior", "measure"  # of the estimates; the policy is the name of a variant


def run_learning_curve(options: LearningCurveConfig, console: Console | None = None) -> Path:
    """Collect, train and evaluate what the folder lacks, and write the report; raises as ``run_figure4``.

    Each variant imitates the demonstrator on the Behavior Graph, as column G of Figure 4 does.

    Source: section V-C.
    """
    compared = variants(options)
    for variant in compared:
        check_collection(variant_collection(options, variant))
    with Workspace(options.folder, identity(options)).open() as work:
        in_behaviors = scenarios(options)
        work.begin()  # after all checks, so that wrong options leave no files
        by_size = sorted(compared, key=lambda variant: variant.examples)
        learners = {variant.title: variant_learner(options, work, variant) for variant in by_size}
        parts, last = learning_parts(learners)
        drivers = {_group(flags): {} for flags in (False, True)}
        for variant in compared:
            drivers[_group(variant.flags)][variant.name] = learners[variant.title].loaders()
        parts += driving_parts(options, work, in_behaviors, drivers, last)
        outcomes = run_parts(parts, console, "learning curve")
        training = {variant.name: mean_training(outcomes[f"training {variant.title}"]) for variant in compared}
        write_learning_curve(options, compared, _measured(options, compared, outcomes), training)
    return options.folder


def _group(flags: bool) -> str:
    """The name of the variants whose networks are equal, and share programs."""
    return "driving with flags" if flags else "driving"


def variants(options: LearningCurveConfig) -> tuple[Variant, ...]:
    """The variants: each amount alone, the first amount at other rates, and the first with flags."""
    hours, first = sorted(set(options.demonstration_hours)), options.demonstration_hours[0]
    rates = (Variant(first, rate) for rate in options.rates)
    return tuple(dict.fromkeys([*map(Variant, hours), *rates, Variant(first, flags=True)]))


def variant_collection(options: LearningCurveConfig, variant: Variant) -> CollectConfig:
    """The demonstrations of a variant.

    Raises:
        InputError: a value is out of range.
    """
    return collection(options, "graph", variant.hours, variant.data, variant.rate)


def variant_learner(options: LearningCurveConfig, work: Workspace, variant: Variant) -> Learner:
    """The networks of a variant, with so few epochs that the optimizer makes no more steps than ``--updates``."""
    data = variant_collection(options, variant)
    learner = Learner(variant.name, work, data, options, {"flags": variant.flags})
    training = learner.training((0, 0))
    steps = math.ceil((1.0 - training.validation) * variant.examples / training.batch)  # of an epoch
    epochs = min(training.epochs, max(1, options.updates // steps))
    return dataclasses.replace(learner, options=learner.options | {"epochs": epochs})


# ------------------------------------------------------------------ statistics


def comparisons(variants: tuple[Variant, ...]) -> list[tuple[Variant, Variant]]:
    """The pairs of variants that are compared.

    These are each amount and the next smaller one; other rates and flags and the variant without them; and a rate and
    the amount at one example per second with as many examples, if any.
    """
    plain = [variant for variant in variants if variant.is_plain]
    pairs = [(more, less) for less, more in itertools.pairwise(plain)]
    for variant in variants:
        if variant.is_plain:
            continue
        pairs.append((variant, Variant(variant.hours)))
        if variant.rate > 1:
            pairs += [(variant, other) for other in plain if math.isclose(other.examples, variant.examples)]
    return pairs


def _measured(options: LearningCurveConfig, compared: tuple[Variant, ...], outcomes: dict[str, Any]) -> Table:
    networks = options.datasets, options.trainings
    return join([
        episode_rows(outcomes[f"{_group(variant.flags)} in {behavior}"][variant.name], variant.name, behavior, networks)
        for variant in compared
        for behavior in BEHAVIORS
    ])  # fmt: skip


def with_means(table: Table) -> Table:
    """The ``MEASURES`` in each scenario, and as ``MEAN`` their means; completed tasks in percent."""
    measured = table.where(measure=tuple(MEASURES), situation=ALL)
    scale = [100.0 if measure == "completed" else 1.0 for measure in measured.names["measure"]]
    in_percent = dataclasses.replace(measured, value=measured.value * np.array(scale)[measured.columns["measure"]])
    by_variant = in_percent.groups(["policy"]).values()
    return join(table for rows in by_variant for table in (rows, averaged(rows, "behavior", MEAN)))


def differences(table: Table, one: Variant, other: Variant) -> Estimates:
    """(behavior, measure) -> difference ``one - other`` in the same episodes of a table ``with_means``."""
    return estimate(contrast(table, one.name, other.name), KEYS[1:])


def verdicts(table: Table, compared: tuple[Variant, ...]) -> list[dict[str, Any]]:
    """For each comparison and measure the difference, whether it is for the better, and in how many resamples."""
    tests = []
    for one, other in comparisons(compared):
        pair = contrast(table.where(behavior=MEAN), one.name, other.name)
        means = samples(pair, ["measure"], draw=hierarchical_resamples)
        for (measure,), difference in estimate(pair, ["measure"]).items():
            if measure not in BETTER:
                continue
            better = BETTER[measure] * means[measure,] > 0.0
            tests.append({
                "variant": one.title, "other": other.title, "measure": measure, "difference": difference,
                "holds": bool(better[0]), "share": float(better[1:].mean()),
            })  # fmt: skip
    return tests


def write_learning_curve(
    options: LearningCurveConfig, compared: tuple[Variant, ...], measured: Table, training: dict[str, dict[str, float]]
) -> None:
    """Write learning_curve.csv, differences.csv, verdicts.csv, the figure and report.html.

    Raises:
        WriteError: another process writes one of the files.
    """
    folder, table = options.folder, with_means(measured)
    estimates = estimate(table, KEYS, bounds=CURVE_BOUNDS)
    heads = {variant.name: (variant.name, number(variant.hours), variant.rate, variant.flags) for variant in compared}
    rows = [(*heads[name], *labels, *value[:3]) for (name, *labels), value in estimates.items()]
    write_csv(folder / "learning_curve.csv", "variant,hours,rate,flags,behavior,measure,mean,low,high", rows)

    pairs = {(one, other): differences(table, one, other) for one, other in comparisons(compared)}
    rows = []
    for (one, other), gaps in pairs.items():
        rows += [(one.name, other.name, *labels, *value[:3]) for labels, value in gaps.items()]
    write_csv(folder / "differences.csv", "variant,other,behavior,measure,mean,low,high", rows)

    tests = verdicts(table, compared)
    rows = []
    for test in tests:
        head = test["variant"], test["other"], test["measure"]
        rows.append((*head, *test["difference"][:3], test["holds"], f"{test['share']:.4f}"))
    head = "variant,other,measure,difference,low,high,better,share_of_resamples"
    write_csv(folder / "verdicts.csv", head, rows)

    figure = pictures.learning_curve(compared, estimates)
    pictures.save(folder, {"learning_curve": figure})
    report = page.learning_curve(options, compared, estimates, pairs, tests, training, figure)
    writing.write(folder / "report.html", report)

"""``sean survey report``: correlations of ratings with metrics, and means of ratings by trial, with intervals.

A rating is a score of a questionnaire or the answer to a Likert question. Ratings of a participant are alike, so
intervals come from a bootstrap over participants, not over trials. Many correlations are computed, so that some are
large by chance: their p-values are corrected by Holm's method.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sean_jax.config import SurveyReportConfig
from sean_jax.core.errors import InputError
from sean_jax.evaluation.table import EPISODE_FIGURES, TableFigure, metric_figure
from sean_jax.io import writing
from sean_jax.metrics import METRICS, aggregate, resamples
from sean_jax.metrics.bootstrap import interval, of_share
from sean_jax.metrics.differences import holm
from sean_jax.studies.survey import export
from sean_jax.studies.survey.answers import Answers
from sean_jax.web import pages

MIN_PARTICIPANTS = 5  # fewer have no interval
RESAMPLES = 1000
LARGEST = 1 - 1e-6  # correlation of which Fisher's z is taken
LEVEL = 0.05  # of corrected p-values


class Correlation(NamedTuple):
    """A rating and a metric."""

    rating: str
    metric: str
    value: float  # Spearman's
    low: float  # of the 95 % interval
    high: float
    pairs: int
    participants: int
    p: float  # corrected by Holm's method


class Mean(NamedTuple):
    """A rating of a trial."""

    rating: str
    trial: str
    value: float
    low: float  # of the 95 % interval
    high: float
    participants: int


class Preference(NamedTuple):
    """How often an episode was chosen in a trial."""

    trial: str
    policies: tuple[str, str]
    value: float  # share of participants that chose the first one
    low: float  # of the 95 % interval
    high: float
    participants: int


def run(answers: Answers, options: SurveyReportConfig, console: Console) -> Path:
    """Print the tables and write the page.

    Raises:
        InputError: there are no ratings yet.
    """
    path = options.out or options.folder / "report.html"
    writing.check_file(path, (".html",))
    rows = rated(answers)
    if not any(row["ratings"] for row in rows):
        raise InputError(f"survey: {options.folder} has no ratings yet; wait for the first participants.")
    levels = means(rows)
    choices = preferences(answers)
    found = correlations(rows)

    tables = []
    if levels:
        tables.append(("Means of ratings", *_means(levels)))
    if choices:
        tables.append(("Choices", *_choices(choices)))
    if found:
        tables.append(("Correlations of ratings with metrics", *correlation_table(found)))
    for title, head, cells in tables:
        print_table(console, title, head, cells)
    note = summary(found)
    console.print(Text(note, "dim"), soft_wrap=True)
    sections = [pages.section(title, pages.table(head, cells)) for title, head, cells in tables]
    finished = sum(row["finished"] is not None for row in answers.participants())
    facts = {"participants": answers.study.participants, "finished": finished, "file": str(answers.file)}
    sections.append(pages.section("How to read it", pages.note(note)))
    sections.append(pages.section("The study", pages.facts(facts)))
    writing.write(path, pages.page(answers.study.title, "sean_jax · a study", sections))
    return path


def rated(answers: Answers) -> list[dict[str, Any]]:
    """Each trial that a participant has rated: participant, trial, ``ratings`` and ``metrics``, by name.

    Ratings of a choice belong to two episodes, so they have no metrics.
    """
    answered: dict[tuple[int, int], dict[str, float]] = {}
    for row in export.answers_table(answers):
        place = row["participant"], row["place"]
        step = answers.steps(row["participant"] - 1)[row["place"] - 1]
        question = step.question(row["question"])
        own = row["kind"] == "likert" and question is not None and not question["group"]
        if step.trial is not None and (own or row["kind"] == "scale"):
            answered.setdefault(place, {})[row["question"]] = float(row["value"])
    metrics: dict[tuple[int, int], dict[str, Any]] = {}
    for row in export.trials(answers):
        place = row["participant"], row["place"]
        values = {name: float(value) for name, value in row.items() if name not in export.COLUMNS}
        if row["kind"] == "choose":
            values = {}
        metrics[place] = {"trial": row["trial"], "metrics": values}  # of several drives, the last one came to its end

    trials = []
    for place, values in answered.items():
        if place in metrics:
            participant, _ = place
            trials.append({"participant": participant, "ratings": values, **metrics[place]})
    return trials


def correlations(
    rows: Sequence[dict[str, Any]], units: tuple[str] | tuple[str, str] = ("participant",)
) -> list[Correlation]:
    """Spearman's correlation of each rating with each metric, the smallest p-values first.

    Pairs with a constant rating or metric have none. The p-value is that of Fisher's z over its standard deviation in
    the resamples.

    Args:
        units: keys of the rows whose values are drawn. The interval is the bootstrap's for one, Fisher's for two.

    Sources: B. Efron, "Bootstrap methods", Annals of Statistics 7 (1979); for the variance with two units C. Cameron,
    J. Gelbach and D. Miller, "Robust inference with multiway clustering", Journal of Business & Economic Statistics 29
    (2011).
    """
    ratings = dict.fromkeys(name for row in rows for name in row["ratings"])
    metrics = dict.fromkeys(name for row in rows for name in row["metrics"])
    tests = []
    for rating, metric in itertools.product(ratings, metrics):
        with_both = [row for row in rows if rating in row["ratings"] and metric in row["metrics"]]
        test = _correlation(rating, metric, with_both, units) if with_both else None
        if test is not None:
            tests.append(test)
    corrected = holm([test.p for test in tests])
    tests = [test._replace(p=p) for test, p in zip(tests, corrected, strict=True)]
    return sorted(tests, key=lambda test: (test.p, -abs(test.value)))


def _correlation(
    rating: str, metric: str, rows: Sequence[dict[str, Any]], units: tuple[str] | tuple[str, str]
) -> Correlation | None:
    """The correlation of a rating with a metric; None of too few units, and where one of both is constant."""
    # Ratings of one participant are not independent: whole clusters are drawn, of participants or of episodes.
    rated = np.array([row["ratings"][rating] for row in rows])
    measured = np.array([row["metrics"][metric] for row in rows])

    clusters = [np.unique([row[unit] for row in rows], return_inverse=True)[1] for unit in units]
    few = min(map(np.max, clusters)) + 1 < MIN_PARTICIPANTS
    if few or np.ptp(rated) == 0 or np.ptp(measured) == 0:
        return None

    # Spearman's correlation, as steps of a Likert scale have an order and no distances.
    value = float(spearman(rated, measured)[0])

    # With two units, clusters of both are drawn, too: the variance that both have counts once.
    number = int(clusters[0].max()) + 1
    if len(clusters) == 2:
        both = clusters[0] * len(rows) + clusters[1]
        clusters.append(np.unique(both, return_inverse=True)[1])
    drawn = [_resampled(rated, measured, cluster) for cluster in clusters]
    if min(map(len, drawn)) < RESAMPLES / 2:
        return None

    # Fisher's z makes the distribution of a correlation normal, with a variance that it does not depend on.
    z = math.atanh(max(-LARGEST, min(value, LARGEST)))
    variances = []
    for values in drawn:
        transformed = np.arctanh(np.clip(values, -LARGEST, LARGEST))
        variances.append(float(np.var(transformed)))
    if len(variances) == 1:
        (variance,) = variances
        low, high = interval(drawn[0])
    else:
        first, second, common = variances
        variance = max(first + second - common, first, second)
        half = NormalDist().inv_cdf(0.975) * math.sqrt(variance)
        low = math.tanh(z - half)
        high = math.tanh(z + half)

    # The floor of the deviation avoids a division by zero where all resamples agree.
    deviation = max(math.sqrt(variance), 1e-6)
    p = 2.0 * (1.0 - NormalDist().cdf(abs(z) / deviation))
    return Correlation(rating, metric, value, float(low), float(high), len(rows), number, p)


def _resampled(one: np.ndarray, other: np.ndarray, label: np.ndarray) -> np.ndarray:
    """(R,) correlations in which all pairs of a label (N,) are drawn together; those that are defined."""
    weights = resamples(int(label.max()) + 1, count=RESAMPLES)  # (R, labels)
    drawn = spearman(one, other, weights[:, label])
    return drawn[np.isfinite(drawn)]


def spearman(one: np.ndarray, other: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """(R,) Spearman's correlation of pairs (N,), each counted as often as its weight (R, N); NaN if one is constant."""
    weights = np.ones((1, len(one))) if weights is None else weights.astype(np.float64)
    x = _ranks(one, weights)  # (R, N)
    y = _ranks(other, weights)
    total = weights.sum(1, keepdims=True)
    x = x - (weights * x).sum(1, keepdims=True) / total
    y = y - (weights * y).sum(1, keepdims=True) / total
    square = (weights * x * x).sum(1) * (weights * y * y).sum(1)
    product = (weights * x * y).sum(1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(square > 1e-12, product / np.sqrt(square), np.nan)


def _ranks(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(R, N) ranks of values (N,), each counted as often as its weight; equal ones have the mean of their ranks."""
    _, group = np.unique(values, return_inverse=True)
    order = np.argsort(group, kind="stable")
    groups = np.arange(group.max() + 1)
    begin = np.searchsorted(group[order], groups)
    sizes = np.add.reduceat(weights[:, order], begin, axis=1)  # (R, groups)
    rank = np.cumsum(sizes, 1) - (sizes - 1.0) / 2.0
    return rank[:, group]


def means(rows: Sequence[dict[str, Any]]) -> list[Mean]:
    """The mean of each rating in each trial."""
    values: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        for rating, value in row["ratings"].items():
            values.setdefault((rating, row["trial"]), []).append(value)
    found = []
    for (rating, trial), each in sorted(values.items()):
        estimate = aggregate(each)
        mean, low, high = map(float, estimate[:3])
        found.append(Mean(rating, trial, mean, low, high, len(each)))
    return found


def preferences(answers: Answers) -> list[Preference]:
    """The share of participants that chose the first episode of each choice."""
    chosen: dict[str, list[float]] = {}
    policies: dict[str, list[str]] = {}
    for row in export.trials(answers):
        if row["chosen"] != "":
            policies.setdefault(row["trial"], []).append(row["policy"])
            chosen.setdefault(row["trial"], []).append(float(row["chosen"]))
    found = []
    for trial, values in chosen.items():
        first = values[::2]  # a participant's two rows are in the order of the file
        estimate = of_share(aggregate(first))
        names = policies[trial][0], policies[trial][1]
        share, low, high = map(float, estimate[:3])
        found.append(Preference(trial, names, share, low, high, len(first)))
    return found


# ------------------------------------------------------------------ tables


def summary(found: Sequence[Correlation]) -> str:
    """What the numbers are, in words."""
    return (
        f"{counted(found)} Correlations are Spearman's over trials; all intervals are of a bootstrap over "
        "participants, and wide or too narrow with fewer than ten of them. A trial that all participants watch has the "
        "same metrics for all: its correlations are those of few episodes. A correlation is no cause."
    )


def counted(found: Sequence[Correlation]) -> str:
    """How many correlations there are, and how many of them are clear, in words."""
    clear = sum(each.p < LEVEL for each in found)
    return (
        f"{len(found)} correlations were computed. By chance alone, about {LEVEL * len(found):.1f} of them have an "
        f"interval without 0. With a p-value below {LEVEL:g} after Holm's correction: {clear}, in bold."
    )


def _figure(name: str) -> TableFigure:
    if name in EPISODE_FIGURES:
        return EPISODE_FIGURES[name]
    if name in METRICS:
        return metric_figure(name, METRICS[name])
    return TableFigure(name.replace("_", " "), "", 3, "")


def correlation_table(found: Sequence[Correlation]) -> tuple[list[str], list[list[str | pages.Cell]]]:
    """The names of the columns, and the rows; p-values below ``LEVEL`` are marked."""
    head = ["rating", "metric", "Spearman", "95 % interval", "p, corrected", "pairs", "participants"]
    rows = []
    for each in found:
        kind = "ours" if each.p < LEVEL else ""
        ends = f"{each.low:+.2f} to {each.high:+.2f}"
        p = "< 0.001" if each.p < 0.001 else f"{each.p:.3f}"
        cells = [pages.Cell(text, kind=kind) for text in (f"{each.value:+.2f}", ends, p)]
        title = _figure(each.metric).title
        rows.append([each.rating, title, *cells, str(each.pairs), str(each.participants)])
    return head, rows


def _means(found: Sequence[Mean]) -> tuple[list[str], list[list[str | pages.Cell]]]:
    rows: list[list[str | pages.Cell]] = []
    for mean in found:
        ends = f"{mean.low:.2f} to {mean.high:.2f}"
        rows.append([mean.rating, mean.trial, f"{mean.value:.2f}", ends, str(mean.participants)])
    return ["rating", "trial", "mean", "95 % interval", "participants"], rows


def _choices(found: Sequence[Preference]) -> tuple[list[str], list[list[str | pages.Cell]]]:
    rows: list[list[str | pages.Cell]] = []
    for preference in found:
        choice = " over ".join(preference.policies)
        share = f"{100 * preference.value:.0f} %"
        ends = f"{100 * preference.low:.0f} to {100 * preference.high:.0f} %"
        rows.append([preference.trial, choice, share, ends, str(preference.participants)])
    return ["trial", "choice", "share", "95 % interval", "participants"], rows


def print_table(console: Console, title: str, head: list[str], rows: list[list[str | pages.Cell]]) -> None:
    """Print a table; cells with a kind are bold."""
    table = Table(box=box.SIMPLE_HEAD, title=Text(title), title_justify="left", title_style="bold", pad_edge=False)
    for k, name in enumerate(head):
        table.add_column(Text(name), justify="left" if k < 2 else "right")
    for row in rows:
        cells = []
        for cell in row:
            if not isinstance(cell, pages.Cell):
                cells.append(Text(cell))
            else:
                cells.append(Text(cell.text, "bold" if cell.kind else ""))
        table.add_row(*cells)
    console.print(table)

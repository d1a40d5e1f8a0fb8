"""Measures of Figure 4 (section V-C) as rows of a table; their estimates, contrasts, and the paper's claims."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sean_jax.config.flags import number
from sean_jax.io import files
from sean_jax.metrics import Estimate
from sean_jax.metrics.bootstrap import hierarchical_resamples, of_share
from sean_jax.metrics.differences import holm
from sean_jax.studies.experiments.results_table import (
    ALL,
    Estimates,
    Labels,
    Table,
    averaged,
    contrast,
    estimate,
    join,
    rows,
    samples,
)
from sean_jax.studies.experiments.shares import BEHAVIORS, NAMES

INTIMATE = "intimate_robot_on_person", "intimate_person_on_robot"
METRIC_NAMES = (
    "completed", "seconds", "time_not_moving", *INTIMATE, "collision_robot_on_person", "collision_person_on_robot",
)  # fmt: skip
MEASURES = {
    "completed": "completed tasks, %",
    "time_not_moving": "time not moving, s",
    "violations": "intimate distance violations",
    "collisions": "collisions with people",
}
"""Measure -> its title."""
WAITING = "time_not_moving_of_completed"  # s, in completed episodes

NOT_NEGATIVE = (0.0, math.inf)
BOUNDS = {**dict.fromkeys((*MEASURES, WAITING), NOT_NEGATIVE), "completed": (0.0, 1.0)}
"""Measure -> the least and the largest value that it can have."""

Columns = dict[str, list]  # metric -> E values, or E lists of them
LEARNED = {"G": "graph", "R": "random", "H": "handcrafted"}
BALANCED, NAVIGATION, DEMONSTRATOR = "B", "N", "E"
FOUR = (*LEARNED, NAVIGATION)  # of the paper
MEAN = "mean"  # over the three scenarios
KEYS = "policy", "behavior", "measure", "situation"  # of the estimates


def episode_measures(columns: Columns) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The ``MEASURES`` (E,) of episodes, and the violations (E, S) in each situation.

    Violations and collisions are by the robot and by people together.
    """
    values = {name: np.asarray(value, float) for name, value in columns.items()}
    violations = values[INTIMATE[0]] + values[INTIMATE[1]]
    collisions = values["collision_robot_on_person"] + values["collision_person_on_robot"]
    waiting = values["time_not_moving"]
    return {
        "completed": values["completed"],
        "time_not_moving": waiting[:, 0] if waiting.ndim == 2 else waiting,
        "violations": violations[:, 0],
        "collisions": collisions[:, 0] if collisions.ndim == 2 else collisions,
    }, violations[:, 1:]


def episode_rows(columns: Columns, policy: str, behavior: str, networks: tuple[int, int] = (1, 1)) -> Table:
    """The rows of a policy's episodes among people of a behavior.

    Args:
        networks: numbers of datasets and of trainings on each, whose networks drive equal shares of the episodes.
    """
    measures, violations = episode_measures(columns)
    measures[WAITING] = measures["time_not_moving"] * measures["completed"]
    datasets, trainings = networks
    count = len(violations)
    network = np.arange(count) // (count // (datasets * trainings))
    labels: dict[str, Any] = {"policy": policy, "behavior": behavior}
    labels |= {"dataset": network // trainings, "seed": network % trainings}
    overall = [rows(values, measure=name, **labels) for name, values in measures.items()]
    return join([*overall, rows(violations, NAMES, measure="violations", **labels)])


def has_learned(policy: str) -> bool:
    """Whether a column of Figure 4 is networks of the experiment."""
    return policy in (*LEARNED, BALANCED)


def percent(share: Estimate, where: ArrayLike = True) -> Estimate:
    """The estimate of a share in percent, with Wilson's interval ``where`` it is true."""
    share = of_share(share, where=where)
    return share._replace(mean=100.0 * share.mean, low=100.0 * share.low, high=100.0 * share.high)


def figure4_estimates(table: Table) -> Estimates:
    """All numbers of the figure by ``KEYS``, in the order of figure4.csv.

    Besides the policies, "B-G" are differences in the same episodes, and "GRHN" means over the paper's policies.
    """
    measured = table.where(measure=tuple(MEASURES))
    headlines = measured.where(situation=ALL)
    means = averaged(headlines, "behavior", MEAN)
    balanced = contrast(join([headlines, means]), BALANCED, "G")
    of_paper = averaged(headlines.where(policy=FOUR, measure="violations"), "policy", "".join(FOUR))
    waiting = table.where(measure=WAITING)
    completed = table.where(measure="completed").relabel(measure=WAITING)
    by_situation = contrast(measured.where(situation=NAMES), BALANCED, "G")

    estimates = estimate(measured, KEYS, bounds=BOUNDS) | estimate(means, KEYS, bounds=BOUNDS)
    estimates |= estimate(balanced, KEYS)
    for labels, value in estimates.items():
        if "completed" in labels:
            all_equal = (value.mean == 0) | (value.mean == 1)  # else groups of episodes differ, which resamples show
            estimates[labels] = percent(value, all_equal)
    estimates |= estimate(of_paper, KEYS, bounds=BOUNDS)
    estimates |= estimate(waiting, KEYS, per=completed, bounds=BOUNDS)
    return estimates | estimate(by_situation, KEYS)


# ------------------------------------------------------------------ contrasts


def contrasts(table: Table) -> list[dict[str, Any]]:
    """Differences between policies in the same episodes, over the three scenarios, and their tests.

    G against R and H, and all policies against N. The unit is the dataset where a network is compared (its seed of
    training, if there is one dataset), else the episode.

    Returns:
        For each its names, measure, difference, interval, Cohen's d of the units, p-value of Student's test and the
        same corrected for all rows (Holm); NaN where the units do not differ.
    """
    means = averaged(table.where(measure=tuple(MEASURES), situation=ALL), "behavior", MEAN)
    others = (policy for policy in means.levels("policy") if policy != NAVIGATION)
    tests = []
    for one, other in [("G", "R"), ("G", "H"), *((policy, NAVIGATION) for policy in others)]:
        for (measure,), pair in contrast(means, one, other).groups(["measure"]).items():
            in_percent = dataclasses.replace(pair, value=pair.value * (100.0 if measure == "completed" else 1.0))
            ((difference),) = estimate(in_percent, ["measure"]).values()
            effect, p = _students_test(in_percent)
            tests.append(dict(one=one, other=other, measure=measure, difference=difference, effect=effect, p=p))
    for test, corrected in zip(tests, holm([test["p"] for test in tests]), strict=True):
        test["holm"] = corrected
    return tests


def _students_test(differences: Table) -> tuple[float, float]:
    """Cohen's d and the p-value of the differences of the outermost units of which there are several."""
    from scipy import stats

    values, sizes = differences.matrix(None)
    units = next((size for size in sizes[:2] if size > 1), len(values))
    gaps = values.reshape(units, -1).mean(1)
    spread = gaps.std(ddof=1) if units > 1 else 0.0
    effect = gaps.mean() / spread if spread else math.nan
    return effect, 2.0 * float(stats.t.sf(math.sqrt(units) * abs(effect), units - 1))


# ------------------------------------------------------------------ claims

CLAIMS = files.read_yaml(Path(__file__).with_name("claims.yaml"))[1]


def claims(table: Table) -> list[dict[str, Any]]:
    """Test the statements of claims.yaml.

    Returns:
        For each the statement, the paper's numbers, ours, whether it holds, and the share of the resamples in which it
        holds.

    Source: section V-C, Figure 4.
    """
    # All policies have the same resamples, or chance between them would hide their differences.
    measured = table.where(measure=tuple(MEASURES))
    in_graph = measured.where(policy="G", behavior="graph")
    _, sizes = in_graph.where(measure="completed").matrix(None)
    of_networks = functools.cache(lambda _: hierarchical_resamples(sizes))  # also for policies that do not learn
    means = samples(measured, KEYS, draw=of_networks)

    # A claim is on the situation with most violations, which need not be the one in the paper.
    violations = in_graph.where(situation=NAMES).groups(["situation"])
    worst = max(NAMES, key=lambda name: violations[name,].value.sum())

    tests = []
    for claim in CLAIMS:
        # A claim holds if each of one side is above each of the other, in the estimate and in each resample.
        values = {name: _mean(means, worst, **numbers) for name, numbers in claim["values"].items()}
        more = np.min([values[name] for name in claim["more"]], 0)  # (1 + R,)
        than = np.max([values[name] for name in claim["than"]], 0)
        share = more / np.maximum(than, 1e-9)

        # Claims in words need a measure: a part of a sum, nearly equal, or greater by a factor.
        if "share" in claim:
            holds = share > claim["share"]
        elif "within" in claim:
            holds = np.abs(more - than) <= claim["within"]
        else:
            compare = np.greater_equal if claim.get("or_equal") else np.greater
            holds = compare(more, claim.get("factor", 1.0) * than)

        # The first column is the estimate; the others are resamples, which say how certain the claim is.
        numbers = {name: value[0] for name, value in values.items()}
        ours = claim["ours"].format(worst=worst.replace("_", " "), percent=100 * share[0], **numbers)
        test = {"statement": claim["statement"], "paper": claim["paper"], "ours": ours}
        tests.append({**test, "holds": bool(holds[0]), "share": float(holds[1:].mean())})
    return tests


def _mean(
    means: dict[Labels, np.ndarray],
    worst: str,
    measure: str,
    policies: str,
    behaviors: Sequence[str] = BEHAVIORS,
    situations: Sequence[str] = (ALL,),
) -> np.ndarray:
    """(1 + R,) the mean over policies and behaviors, of the sum over situations; of completed tasks in percent.

    Args:
        worst: the situation with that name.
    """
    names = [worst if situation == "worst" else situation for situation in situations]
    values = [
        sum(means[policy, behavior, measure, name] for name in names) for policy in policies for behavior in behaviors
    ]
    return (100.0 if measure == "completed" else 1.0) * np.mean(np.asarray(values), 0)


# ------------------------------------------------------------------ the learning curve


@dataclasses.dataclass(frozen=True)
class Variant:
    """The demonstrations of networks, and whether the situations are an input."""

    hours: float
    rate: int = 1  # examples per second
    flags: bool = False

    @property
    def data(self) -> str:
        """A name of the demonstrations."""
        return f"{number(self.hours)}h" + (f"-{self.rate}hz" if self.rate != 1 else "")

    @property
    def name(self) -> str:
        """A name for files."""
        return self.data + ("-flags" if self.flags else "")

    @property
    def title(self) -> str:
        """A name for people."""
        more = (f" at {self.rate} Hz" if self.rate != 1 else "") + (" with flags" if self.flags else "")
        return f"{number(self.hours)} h{more}"

    @property
    def examples(self) -> float:
        """Their number, not counting the excess of the last episodes."""
        return 3600.0 * self.hours * self.rate

    @property
    def is_plain(self) -> bool:
        """Whether it has more hours alone."""
        return self.rate == 1 and not self.flags

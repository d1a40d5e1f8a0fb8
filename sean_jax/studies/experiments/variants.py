"""Results of the learning curve of policy G: its variants, their measures with intervals, and what is better."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from typing import TypedDict

import numpy as np

from sean_jax.flags import number
from sean_jax.metrics import Estimate, aggregate
from sean_jax.metrics.bootstrap import hierarchical_resamples, with_estimate
from sean_jax.studies.experiments import drivers
from sean_jax.studies.experiments.claims import Training, over_behaviors

MEAN = "mean"  # over the three scenarios
BETTER = {"completed": 1.0, "time_not_moving": -1.0, "violations": -1.0}  # the sign of a difference for the better
MEASURES = {**drivers.MEASURES, "completed": "completed tasks, %"}


@dataclasses.dataclass(frozen=True)
class Variant:
    """What networks learn from, and whether they know the situations."""

    hours: float
    rate: int = 1  # examples a second
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
        """How many there are, but for what an episode has too much."""
        return 3600.0 * self.hours * self.rate


class Verdict(TypedDict):
    """Whether one variant is better than another, over the three scenarios."""

    variant: str
    other: str
    measure: str
    difference: Estimate
    holds: bool
    share: float  # of the resamples in which it holds


@dataclasses.dataclass
class Curve:
    """Measures of every variant in every scenario. All intervals use the same resamples of the numbered episodes.

    A resample draws datasets, with all networks and episodes of each, as in Figure 4.
    """

    variants: tuple[Variant, ...]
    sizes: tuple[int, int, int]  # datasets, trainings on each, episodes of each network
    values: dict[str, dict[str, dict[str, np.ndarray]]]  # variant -> behavior -> measure -> (E,), of completed percent
    training: dict[str, Training]

    def __post_init__(self) -> None:
        """Add the means over the scenarios."""
        self.values = {name: {**by, MEAN: over_behaviors(by)} for name, by in self.values.items()}

    @functools.cached_property
    def resamples(self) -> np.ndarray:
        """(R, E) number of times that each episode is in each resample."""
        return hierarchical_resamples(self.sizes)

    @functools.cached_property
    def cells(self) -> dict[str, dict[str, dict[str, Estimate]]]:
        """variant -> behavior or mean -> measure -> estimate."""
        return {
            name: {
                b: {m: aggregate(value, weights=self.resamples) for m, value in each.items()} for b, each in by.items()
            }
            for name, by in self.values.items()
        }

    def differences(self, one: Variant, other: Variant) -> dict[str, dict[str, Estimate]]:
        """By how much a variant has more than another, in the same episodes.

        Returns:
            behavior or mean -> measure -> estimate.
        """
        ours, theirs = self.values[one.name], self.values[other.name]
        return {b: {m: aggregate(ours[b][m] - theirs[b][m], weights=self.resamples) for m in ours[b]} for b in ours}

    @functools.cached_property
    def verdicts(self) -> list[Verdict]:
        """Whether each comparison is for the better."""
        weights, found = with_estimate(self.resamples), list[Verdict]()
        for one, other in comparisons(self.variants):
            apart = self.differences(one, other)[MEAN]
            for measure, sign in BETTER.items():
                both = (self.values[each.name][MEAN][measure] for each in (one, other))
                better = sign * (weights @ np.subtract(*both)) > 0.0
                found.append({
                    "variant": one.title, "other": other.title, "measure": measure, "difference": apart[measure],
                    "holds": bool(better[0]), "share": float(better[1:].mean()),
                })  # fmt: skip
        return found


def comparisons(variants: tuple[Variant, ...]) -> list[tuple[Variant, Variant]]:
    """Which variants are held against which.

    Returns:
        Each amount and the next smaller one; the other rates and flags and what they vary; and a rate beside the amount
        at one example a second that has as many examples, if there is one.
    """
    plain = [each for each in variants if each.rate == 1 and not each.flags]
    pairs = [(more, less) for less, more in itertools.pairwise(plain)]
    for each in variants:
        if each not in plain:
            pairs.append((each, Variant(each.hours)))
            pairs += [
                (each, as_many) for as_many in plain if each.rate > 1 and math.isclose(as_many.examples, each.examples)
            ]
    return pairs

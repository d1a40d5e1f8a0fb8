"""Measures of Figure 4, of the learning curve (section V-C) and of the benchmark, with intervals, and claims."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sean_jax.config.flags import number
from sean_jax.metrics import OF_GROUPS, Estimate, aggregate, aggregate_ratio
from sean_jax.metrics.bootstrap import UNBOUNDED, hierarchical_resamples, of_count, of_share, resamples, with_estimate
from sean_jax.metrics.differences import holm
from sean_jax.studies.experiments import shares
from sean_jax.studies.experiments.shares import BEHAVIORS

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

NOT_NEGATIVE = (0.0, math.inf)
BOUNDS = {**dict.fromkeys(MEASURES, NOT_NEGATIVE), "completed": (0.0, 1.0)}
"""Measure -> the least and the largest value that it can have."""

Columns = dict[str, list]  # metric -> E values, or E lists of them
LEARNED = {"G": "graph", "R": "random", "H": "handcrafted"}
BALANCED, NAVIGATION, DEMONSTRATOR = "B", "N", "E"
FOUR = (*LEARNED, NAVIGATION)  # of the paper


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


@dataclasses.dataclass
class Measured:
    """Measures in every scenario. Intervals use the same resamples of the numbered episodes.

    Episodes are in the order of the datasets, seeds of training and numbers. For networks a resample draws datasets,
    with all networks and episodes of each; or seeds, if there is one dataset. For other policies it draws episodes.
    """

    sizes: tuple[int, int, int]  # datasets of each behavior, trainings on each, episodes of each network
    values: dict[str, dict[str, dict[str, np.ndarray]]]  # policy or variant -> behavior -> measure -> (E,)
    training: dict[str, dict[str, float]]  # policy or variant -> as trained-NAME.json, means over the networks

    @functools.cached_property
    def resamples(self) -> np.ndarray:
        """(R, E) number of times that each episode is in each resample."""
        return hierarchical_resamples(self.sizes)

    @property
    def episodes(self) -> int:
        """Episodes of each policy in each scenario."""
        return math.prod(self.sizes)

    def estimate(self, values: np.ndarray, learned: bool = True, bounds: tuple[float, float] = UNBOUNDED) -> Estimate:
        """The mean over episodes (E,) or (E, S), of networks or of a policy that has not learned in the experiment.

        ``bounds`` are those of the figure: a measure has ``BOUNDS``, a difference none.
        """
        return aggregate(values, weights=self._resamples(learned), bounds=bounds)

    def _resamples(self, learned: bool) -> np.ndarray:
        several = learned and any(size > 1 for size in self.sizes[:2])
        return self.resamples if several else self._of_episodes

    @functools.cached_property
    def _of_episodes(self) -> np.ndarray:
        return resamples(self.episodes)


@dataclasses.dataclass
class Results(Measured):
    """Measures of every policy of Figure 4; N and E, which are not trained, drive the same episodes."""

    situations: dict[str, dict[str, np.ndarray]]  # policy -> behavior -> (E, 5) violations in each situation

    @functools.cached_property
    def cells(self) -> dict[str, dict[str, dict[str, Estimate]]]:
        """policy -> behavior -> measure -> mean with interval."""
        return {
            p: {b: self._estimates(each, has_learned(p)) for b, each in by.items()} for p, by in self.values.items()
        }

    @functools.cached_property
    def means(self) -> dict[str, dict[str, Estimate]]:
        """policy -> measure -> over the three scenarios."""
        return {policy: self._estimates(over_behaviors(by), has_learned(policy)) for policy, by in self.values.items()}

    @functools.cached_property
    def more(self) -> dict[str, dict[str, Estimate]]:
        """behavior, or mean -> measure -> difference of the balanced policy and G, in the same episodes."""
        ours, theirs = ({**by, "mean": over_behaviors(by)} for by in (self.values[BALANCED], self.values["G"]))
        gaps = {b: {name: ours[b][name] - theirs[b][name] for name in ours[b]} for b in ours}
        return {b: self._estimates(each, bounds={}) for b, each in gaps.items()}

    @functools.cached_property
    def harm(self) -> dict[str, Estimate]:
        """behavior -> violations, the mean over the paper's four policies."""
        means = {b: np.mean([self.values[p][b]["violations"] for p in FOUR], 0) for b in BEHAVIORS}
        return {b: self.estimate(mean, bounds=NOT_NEGATIVE) for b, mean in means.items()}

    @functools.cached_property
    def waiting(self) -> dict[str, dict[str, Estimate]]:
        """policy -> behavior -> time not moving [s] in completed episodes; ``episodes`` is 0 if there are none."""
        return {
            p: {
                b: aggregate_ratio(
                    each["time_not_moving"] * each["completed"],
                    each["completed"],
                    weights=self._resamples(has_learned(p)),
                    bounds=NOT_NEGATIVE,
                )
                for b, each in by.items()
            }
            for p, by in self.values.items()
        }

    @functools.cached_property
    def by_situation(self) -> dict[str, dict[str, Estimate]]:
        """policy -> behavior -> (5,) violations per episode."""
        return {
            p: {b: self.estimate(each, has_learned(p), NOT_NEGATIVE) for b, each in by.items()}
            for p, by in self.situations.items()
        }

    @functools.cached_property
    def balancing(self) -> dict[str, Estimate]:
        """behavior -> (5,) difference of violations per episode of the balanced policy and G, in the same episodes."""
        return {b: self.estimate(self.situations[BALANCED][b] - self.situations["G"][b]) for b in BEHAVIORS}

    @functools.cached_property
    def contrasts(self) -> list[dict[str, Any]]:
        """Differences between policies in the same episodes, over the three scenarios, and their tests.

        G against R and H, and all policies against N. The unit is the dataset where a network is compared (its seed of
        training, if there is one dataset), else the episode.

        Returns:
            For each its names, measure, difference, interval, Cohen's d of the units, p-value of Student's test and the
            same corrected for all rows (Holm); NaN where the units do not differ.
        """
        from scipy import stats

        rows = []
        pairs = [("G", "R"), ("G", "H"), *((policy, NAVIGATION) for policy in self.values if policy != NAVIGATION)]
        for one, other in pairs:
            learned = has_learned(one) or has_learned(other)
            units = next((size for size in self.sizes[:2] if size > 1), self.episodes) if learned else self.episodes
            ours, theirs = (over_behaviors(self.values[policy]) for policy in (one, other))
            for measure in MEASURES:
                difference = (100.0 if measure == "completed" else 1.0) * (ours[measure] - theirs[measure])
                gaps = difference.reshape(units, -1).mean(1)
                spread = gaps.std(ddof=1) if units > 1 else 0.0
                effect = gaps.mean() / spread if spread else math.nan
                rows.append({
                    "one": one, "other": other, "measure": measure,
                    "difference": self.estimate(difference, learned),
                    "effect": effect,
                    "p": 2.0 * float(stats.t.sf(math.sqrt(units) * abs(effect), units - 1)),
                })  # fmt: skip
        for row, corrected in zip(rows, holm([row["p"] for row in rows]), strict=True):
            row["holm"] = corrected
        return rows

    def _estimates(
        self,
        values: dict[str, np.ndarray],
        learned: bool = True,
        bounds: Mapping[str, tuple[float, float]] = BOUNDS,
    ) -> dict[str, Estimate]:
        estimates = {name: self.estimate(value, learned, bounds.get(name, UNBOUNDED)) for name, value in values.items()}
        completed = estimates["completed"]
        even = (completed.mean == 0) | (completed.mean == 1)  # else groups of episodes differ, which resamples show
        return estimates | {"completed": percent(completed, even)}


def percent(share: Estimate, where: ArrayLike = True) -> Estimate:
    """The estimate of a share in percent, with Wilson's interval ``where`` it is true."""
    share = of_share(share, where=where)
    return share._replace(mean=100.0 * share.mean, low=100.0 * share.low, high=100.0 * share.high)


def has_learned(policy: str) -> bool:
    """Whether a column of Figure 4 is networks of the experiment."""
    return policy in (*LEARNED, BALANCED)


def over_behaviors(by_behavior: dict[str, dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """measure -> mean (E,) over the three scenarios, episode by episode, from behavior -> measure -> (E,)."""
    return {name: np.mean([by_behavior[b][name] for b in BEHAVIORS], 0) for name in by_behavior[BEHAVIORS[0]]}


def claims(results: Results) -> list[dict[str, Any]]:
    """Test the paper's statements about its figure.

    Returns:
        For each the statement, the paper's numbers, ours, whether it holds, and the share of the resamples in which it
        holds.

    Source: section V-C, Figure 4.
    """
    weights = with_estimate(results.resamples)

    def of(policy: str, behavior: str, name: str) -> np.ndarray:
        return weights @ results.values[policy][behavior][name]

    wait = {p: np.mean([of(p, b, "time_not_moving") for b in BEHAVIORS], 0) for p in results.values}
    harm = {b: np.mean([of(p, b, "violations") for p in FOUR], 0) for b in BEHAVIORS}
    done = {p: 100.0 * np.mean([of(p, b, "completed") for b in BEHAVIORS], 0) for p in results.values}
    paths = np.mean([weights @ results.situations[p]["graph"][:, :2].sum(1) for p in FOUR], 0)
    paths = paths / np.maximum(harm["graph"], 1e-9)
    worst = int(results.by_situation["G"]["graph"].mean.argmax())
    worse, mended = (weights @ results.situations[p]["graph"][:, worst] for p in ("G", BALANCED))
    graph = [of(p, "graph", "time_not_moving") for p in ("G", "H")]
    statements: list[tuple] = [
        ("N stands longest, s", "28.7 against 11 to 22", _listed(wait, FOUR),
         wait["N"] > np.max([wait[p] for p in LEARNED], 0)),
        ("G stands less than R, s", "11 < 16.3", f"{wait['G'][0]:.1f}, {wait['R'][0]:.1f}", wait["G"] < wait["R"]),
        ("R stands less than H, s", "16.3 < 22", f"{wait['R'][0]:.1f}, {wait['H'][0]:.1f}", wait["R"] < wait["H"]),
        ("in graph, G stands less than H by half, s", "-55 %", f"{graph[0][0]:.1f}, {graph[1][0]:.1f}",
         graph[0] <= 0.5 * graph[1]),
        ("violations: graph at least random", "2.5, 1.9", f"{harm['graph'][0]:.2f}, {harm['random'][0]:.2f}",
         harm["graph"] >= harm["random"]),
        ("violations: random above handcrafted", "1.9, 1.0", f"{harm['random'][0]:.2f}, {harm['handcrafted'][0]:.2f}",
         harm["random"] > harm["handcrafted"]),
        ("violations in graph are mostly in cross or down path", "mainly", f"{100 * paths[0]:.0f} %", paths > 0.5),
        ("G and H complete equally many, within 5 %", "91.6, 91.6 %", f"{done['G'][0]:.1f}, {done['H'][0]:.1f} %",
         np.abs(done["G"] - done["H"]) <= 5.0),
        ("the learned complete 80 % of what the demonstrator does", "not reported",
         f"{_listed(done, (*LEARNED, DEMONSTRATOR))} %",
         np.min([done[p] for p in LEARNED], 0) >= 0.8 * done[DEMONSTRATOR]),
        ("balanced examples lower the violations in G's worst situation", "suggested",
         f"{shares.NAMES[worst].replace('_', ' ')}: {worse[0]:.2f} to {mended[0]:.2f}", mended < worse),
    ]  # fmt: skip
    return [
        {"statement": words, "paper": paper, "ours": ours, "holds": bool(holds[0]), "share": float(holds[1:].mean())}
        for words, paper, ours, holds in statements
    ]


def _listed(values: dict[str, np.ndarray], policies: Collection[str]) -> str:
    return ", ".join(f"{name} {values[name][0]:.1f}" for name in policies)


# ------------------------------------------------------------------ the learning curve

MEAN = "mean"  # over the three scenarios
CURVE_BOUNDS = {**BOUNDS, "completed": (0.0, 100.0)}  # in percent
BETTER = {"completed": 1.0, "time_not_moving": -1.0, "violations": -1.0}  # the sign of an improvement


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


@dataclasses.dataclass
class Curve(Measured):
    """Measures of every variant; those of completed tasks in percent."""

    variants: tuple[Variant, ...]

    def __post_init__(self) -> None:
        """Add the means over the scenarios."""
        self.values = {name: {**by, MEAN: over_behaviors(by)} for name, by in self.values.items()}

    @functools.cached_property
    def cells(self) -> dict[str, dict[str, dict[str, Estimate]]]:
        """variant -> behavior or mean -> measure -> estimate."""
        return {
            name: {
                b: {m: self.estimate(value, bounds=CURVE_BOUNDS[m]) for m, value in each.items()}
                for b, each in by.items()
            }
            for name, by in self.values.items()
        }

    def differences(self, one: Variant, other: Variant) -> dict[str, dict[str, Estimate]]:
        """behavior or mean -> measure -> difference ``one - other`` in the same episodes."""
        ours, theirs = self.values[one.name], self.values[other.name]
        return {b: {m: self.estimate(ours[b][m] - theirs[b][m]) for m in ours[b]} for b in ours}

    @functools.cached_property
    def verdicts(self) -> list[dict[str, Any]]:
        """For each comparison and measure the difference, whether it is for the better, and in how many resamples."""
        weights, verdicts = with_estimate(self.resamples), []
        for one, other in comparisons(self.variants):
            differences = self.differences(one, other)[MEAN]
            for measure, sign in BETTER.items():
                both = (self.values[each.name][MEAN][measure] for each in (one, other))
                better = sign * (weights @ np.subtract(*both)) > 0.0
                verdicts.append({
                    "variant": one.title, "other": other.title, "measure": measure, "difference": differences[measure],
                    "holds": bool(better[0]), "share": float(better[1:].mean()),
                })  # fmt: skip
        return verdicts


def comparisons(variants: tuple[Variant, ...]) -> list[tuple[Variant, Variant]]:
    """The pairs of variants that are compared.

    These are each amount and the next smaller one; other rates and flags and the variant without them; and a rate and
    the amount at one example per second with as many examples, if any.
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


# ------------------------------------------------------------------ the benchmark

SCORE_RESAMPLES = 1_000
ROBOTS_FAULT = "intimate_robot_on_person", "collision_robot_on_person", "collision_with_obstacle"
COUNTED = (*ROBOTS_FAULT, "intimate_person_on_robot", "collision_person_on_robot", *OF_GROUPS)
MEASURED = ("time_in_situation", *COUNTED, "time_not_moving", "path_efficiency")
Arrays = dict[str, np.ndarray]  # of the E episodes of a track: (E,), or (E, 1 + S) overall and by situation


@dataclasses.dataclass(frozen=True)
class Scores:
    """The scores of a policy, over all tracks or on one; each number has its 95 % interval."""

    FIGURES = {
        "polite": "completed politely %",
        "completed": "completed %",
        "seconds": "s",
        "intimate_robot_on_person": "within 0.45 m, by the robot",
        "intimate_person_on_robot": "by people",
        "collision_robot_on_person": "touched people",
        "collision_with_obstacle": "touched obstacles",
        "o_spaces_crossed": "crossed o-spaces",
        "groups_split": "split groups",
    }
    figures: dict[str, Estimate]  # name of FIGURES -> () mean of an episode
    shares: Estimate  # (S,) of the time in each situation
    violations: Estimate  # (S,) approaches within 0.45 m of a person per minute, in each situation


def polite(columns: Arrays) -> np.ndarray:
    """(E,) bool, tasks that were completed without an intimate violation or a collision by the robot's fault."""
    return columns["completed"] & ~np.any([_overall(columns[name]) > 0 for name in ROBOTS_FAULT], axis=0)


@functools.lru_cache(maxsize=32)  # all results of a ranking share those of the tracks, 10 MB each
def score_resamples(episodes: int, seed: int) -> np.ndarray:
    """(R, E) int16, number of times that each episode of a track is in each resample."""
    return resamples(episodes, seed, SCORE_RESAMPLES).astype(np.int16)


def scores(measured: dict[str, Arrays]) -> Scores:
    """Scores over some tracks with equal weights; a resample draws as many episodes of each."""
    each = list(measured.values())
    sizes = [len(columns["completed"]) for columns in each]
    weights, ends = (
        np.empty((SCORE_RESAMPLES, sum(sizes))),
        np.cumsum(sizes),
    )  # products with float64 need no copy of it
    for seed, (size, end) in enumerate(zip(sizes, ends, strict=True)):
        weights[:, end - size : end] = score_resamples(size, seed)

    def joined(take: Callable[[Arrays], np.ndarray]) -> np.ndarray:
        return np.concatenate([np.asarray(take(columns), float) for columns in each])

    def share(take: Callable[[Arrays], np.ndarray]) -> Estimate:
        return percent(aggregate(joined(take), weights=weights))

    figures = {"polite": share(polite), "completed": share(lambda columns: columns["completed"])}
    for name in Scores.FIGURES:
        if name not in figures:
            estimate = aggregate(joined(lambda columns, name=name: _overall(columns[name])), weights=weights)
            figures[name] = estimate if name == "seconds" else of_count(estimate)
    time = joined(lambda columns: columns["time_in_situation"])
    events = joined(lambda columns: columns["intimate_robot_on_person"][:, 1:])
    whole = np.repeat(time[:, :1], time.shape[1] - 1, axis=1)
    return Scores(
        figures,
        aggregate_ratio(time[:, 1:], whole, weights=weights),
        aggregate_ratio(events, time[:, 1:] / 60.0, weights=weights),
    )


def scores_by_track(measured: dict[str, Arrays]) -> dict[str, Scores]:
    """The scores on each track."""
    return {track: scores({track: columns}) for track, columns in measured.items()}


def _overall(values: np.ndarray) -> np.ndarray:
    return values if values.ndim == 1 else values[:, 0]

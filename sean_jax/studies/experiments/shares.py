"""Shares of social situations (Table I), in simulation and in recordings of people.

Examples are taken once a second, and each situation that holds is a flag of the example. Intervals come from the
bootstrap of ``metrics.bootstrap`` over chains of episodes, because successive examples are alike.
Entropies are divided by ln 5, the entropy of five equal shares; they are the same for all ways of counting.

The paper's rows are an hour of one person each. So the interval of our mean is not the interval of such an hour, which
is wider; ``hours`` compares the paper's rows with the latter.

In a recording each person in turn plays the robot (section III), and every row in which the person is present is an
example. Intervals are from a bootstrap over these persons. A robot walks alone; so where companions are annotated,
examples are also counted without them.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import classifiers
from sean_jax.classifiers import MORE_SITUATIONS, OBJECT_SITUATIONS, SITUATIONS
from sean_jax.metrics import bootstrap
from sean_jax.metrics.differences import holm
from sean_jax.people import recordings

if TYPE_CHECKING:
    from sean_jax.classifiers import Situation
    from sean_jax.core.data_types import Array
    from sean_jax.people.recordings import Tracks

NAMES = ("cross_path", "down_path", "join_group", "leave_group", "empty")
BEHAVIORS = ("random", "handcrafted", "graph")  # in the order of Table I
PAPER = {  # Table I, percent
    "random": (14.51, 24.68, 0.0, 0.0, 66.44),
    "handcrafted": (0.73, 0.74, 3.43, 13.48, 81.62),
    "graph": (13.24, 22.08, 12.09, 19.51, 33.08),
}
COUNTINGS = {
    "flags": "share of all flags",
    "flags_and_none": "share of all flags, none of them being one more",
    "examples": "share of all examples",
    "situated_examples": "share of the examples in some situation",
}
"""Ways of counting, the first of which makes rows add up to 1 as two of the paper's do."""
GROUPS = "join_group", "leave_group"  # unknown where groups are not annotated


@dataclasses.dataclass
class Shares:
    """Shares with one behavior and one policy: the estimate, then R bootstrap resamples."""

    examples: np.ndarray  # (1 + R, S), of all examples; S is 5 for the paper's situations
    none: np.ndarray  # (1 + R,), of the examples in which no situation holds
    seconds: int  # examples

    def of(self, counting: str) -> np.ndarray:
        """The shares by one of ``COUNTINGS``, (1 + R, S) from 0 to 1; 0 where the divisor is 0."""
        flags = self.examples.sum(1)
        by_counting = {"flags": flags, "flags_and_none": flags + self.none, "examples": np.ones_like(flags)}
        whole = by_counting.get(counting, 1.0 - self.none)
        return self.examples / np.where(whole > 0, whole, 1.0)[:, None]

    def entropy(self) -> np.ndarray:
        """Normalised entropy of the shares, (1 + R,) from 0 to 1."""
        return normalised_entropy(self.examples)

    def rows(self, *head: Any, known: Collection[str] = NAMES) -> list[tuple]:
        """Rows of a table, after ``head``: counting, situation, share and interval, of the situations ``known``."""
        return [row for name in COUNTINGS for row in interval_rows((*head, name), NAMES, self.of(name), known)]


def interval_rows(
    head: Sequence, names: Collection[str], samples: np.ndarray, known: Collection[str] | None = None
) -> list[tuple]:
    """Rows of a table, after ``head``: a name, its share and the interval, of the names ``known``, or of all."""
    low, high = interval(samples)
    values = zip(names, samples[0], low, high, strict=True)
    return [(*head, *row) for row in values if known is None or row[0] in known]


def count(flags: np.ndarray, weights: np.ndarray) -> Shares:
    """Shares of the situations, and their resamples, from 0 to 1 also where weights are negative.

    Args:
        flags: (chains, seconds, S) bool.
        weights: (R, chains) of the chains in each resample.
    """
    weights, parts = bootstrap.with_estimate(weights), (flags.mean(1), (~flags.any(-1)).mean(1))
    examples, none = (np.clip(weights @ part, 0.0, 1.0) for part in parts)
    return Shares(examples, none, flags.shape[0] * flags.shape[1])


def count_by_person(flags: np.ndarray, person: np.ndarray, seed: int = 0) -> Shares:
    """Shares of the situations in examples (E, S) bool of recorded ``person`` (E,), and resamples of persons.

    A resample has all examples of its persons; persons may have different numbers of them.
    """
    people, index = np.unique(person, return_inverse=True)
    counts = np.zeros((len(people), flags.shape[1] + 2))  # of each situation, of none, and of all
    np.add.at(counts, index, np.column_stack([flags, ~flags.any(-1), np.ones(len(flags))]))
    drawn = bootstrap.with_estimate(bootstrap.resamples(len(people), seed, bootstrap.RESAMPLES)) @ counts
    share = drawn[:, :-1] / drawn[:, -1:]
    return Shares(share[:, :-1], share[:, -1], len(flags))


def normalised_entropy(shares: np.ndarray) -> np.ndarray:
    """Entropy (...,) of shares (..., K), which need not add up to one, divided by the entropy of equal shares.

    It is from 0 to 1, and 0 if all shares are zero.
    """
    total = shares.sum(-1, keepdims=True)
    p = np.where(total > 0, shares / np.where(total > 0, total, 1), 0)
    return -(p * np.log(np.where(p > 0, p, 1))).sum(-1) / np.log(shares.shape[-1])


def interval(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper end (...) of the 95 % bootstrap interval of an estimate and its resamples, (1 + R, ...)."""
    return bootstrap.interval(samples[1:])


def orderings(by_behavior: dict[str, Shares], counting: str = "flags") -> list[dict[str, Any]]:
    """Test the orderings of the paper's table by one of ``COUNTINGS``.

    Returns:
        For each its name, its source (a statement of the paper's text, or read from its table, with thresholds that
        are ours), its statement, whether it holds, and the share of the resamples in which it holds.

    Source: Table I, and its discussion in section V-B.
    """
    r, h, g = (by_behavior[name].of(counting) for name in ("random", "handcrafted", "graph"))
    hr, hh, hg = (normalised_entropy(each) for each in (r, h, g))
    cross, down, join, leave, empty = range(5)
    groups = g[:, join] + g[:, leave]
    close = np.abs(g[:, :join] - r[:, :join]) <= 0.25 * r[:, :join]
    share = h[:, :join] / np.minimum(r, g)[:, :join].clip(1e-9)
    statements = [
        ("T1", "text", "entropy: graph above random and handcrafted", (hg > hr) & (hg > hh)),
        ("T2", "text", "random: join and leave group never", (r[:, join] == 0) & (r[:, leave] == 0)),
        ("T3", "table", "empty: handcrafted > random > graph",
         (h[:, empty] > r[:, empty]) & (r[:, empty] > g[:, empty])),
        ("T4", "table", "cross and down path of handcrafted below a fifth of the others'",
         (share < 0.2).all(1)),
        ("T5", "text", "entropy: random above handcrafted", hr > hh),
        ("T6", "table", "leave above join group, in handcrafted and graph",
         (h[:, leave] > h[:, join]) & (g[:, leave] > g[:, join])),
        ("T7", "table", "down above cross path, in random and graph", 
         (r[:, down] > r[:, cross]) & (g[:, down] > g[:, cross])),
        ("T8", "table", "cross and down path of graph within 25 % of random", close.all(1)),
        ("T9", "table", "what empty loses from random to graph is join and leave group, within a fifth",
         np.abs((r[:, empty] - g[:, empty]) - groups) <= 0.2 * groups),
        ("T10", "table", "entropy of graph at least 0.85", hg >= 0.85),
    ]  # fmt: skip
    return [
        {"name": name, "source": source, "statement": words, "holds": bool(holds[0]), "share": float(holds[1:].mean())}
        for name, source, words, holds in statements
    ]


def ordering_rows(by_behavior: dict[str, Shares], *head: Any) -> Iterator[tuple]:
    """Rows of a table, after ``head``: the orderings by each of ``COUNTINGS``."""
    for counting in COUNTINGS:
        for row in orderings(by_behavior, counting):
            name, source, statement, holds, share = row.values()
            yield (*head, counting, name, source, f'"{statement}"', holds, f"{share:.4f}")


def paper() -> dict[str, np.ndarray]:
    """behavior -> the shares (5,) that the paper prints, divided by their sum (105.63 % for random, else 100 %).

    Source: Table I.
    """
    return {name: np.array(row) / sum(row) for name, row in PAPER.items()}


# ------------------------------------------------------------------ simulated


@dataclasses.dataclass
class Cell:
    """Examples with one behavior, one policy and one number of people."""

    behavior: str
    policy: str
    people: int
    flags: np.ndarray  # (V, chains, seconds, 5) bool
    more: np.ndarray  # (chains, seconds, M) bool, the further situations, which do not depend on V
    ended: np.ndarray  # (2,) episodes completed and not
    streams: int  # of the protocol, each with as many chains, one stream after another

    def shares(self, speed: int = 0) -> Shares:
        """Shares of the paper's situations."""
        return count(self.flags[speed], self._resamples)

    def further(self) -> Shares:
        """Shares of the situations beyond the paper's five."""
        return count(self.more, self._resamples)

    def hour(self, speed: int = 0) -> Shares:
        """Shares of the paper's situations; the resamples are those of one further hour."""
        chains, seconds = self.more.shape[:2]
        future = max(1, round(3600 / (seconds * self.streams)))
        weights = bootstrap.predictive_resamples(self.streams, chains // self.streams, future)
        return count(self.flags[speed], weights)

    @functools.cached_property
    def _resamples(self) -> np.ndarray:
        return bootstrap.stratified_resamples(self.streams, len(self.more) // self.streams)


def hours(cells: Sequence[Cell], speed: int = 0) -> list[dict[str, Any]]:
    """The paper's hour of each behavior beside the 95 % interval of one hour of a policy, by shares of flags.

    Returns:
        For each cell, and each situation and the entropy: names, mean, interval, the paper's figure, the p-value of the
        paper's figure in the distribution of an hour, and the same corrected for all figures of the policy (Holm).

    Source: Table I.
    """
    rows = []
    for cell in cells:
        hour, printed = cell.hour(speed), paper()[cell.behavior]
        samples = np.column_stack([hour.of("flags"), hour.entropy()])
        low, high = interval(samples)
        values = [*printed, float(normalised_entropy(printed))]
        for k, name in enumerate((*NAMES, "entropy")):
            above, below = (1 + (samples[1:, k] >= values[k]).sum(), 1 + (samples[1:, k] <= values[k]).sum())
            p = min(1.0, 2.0 * min(above, below) / len(samples))
            rows.append({
                "policy": cell.policy, "behavior": cell.behavior, "figure": name, "mean": samples[0, k], "low": low[k],
                "high": high[k], "paper": values[k], "p": p,
            })  # fmt: skip
    for policy in dict.fromkeys(row["policy"] for row in rows):
        mine = [row for row in rows if row["policy"] == policy]
        for row, corrected in zip(mine, holm([row["p"] for row in mine]), strict=True):
            row["holm"] = corrected
    return rows


@dataclasses.dataclass
class DemonstrationCell:
    """Examples of demonstrations with one behavior, at the walking speed V with which they were recorded."""

    behavior: str
    policy: str  # the driver that the dataset names
    people: int
    episode: np.ndarray  # (E,) int
    flags: np.ndarray  # (E, 5) bool
    ended: np.ndarray  # (2,) episodes completed and not

    def shares(self, speed: int = 0) -> Shares:
        """Shares of the paper's situations; resamples are of episodes."""
        return count_by_person(self.flags, self.episode)


def by_policy(cells: Sequence[Cell | DemonstrationCell], speed: int = 0) -> dict[str, dict[str, Shares]]:
    """policy -> behavior -> shares of the paper's situations."""
    return {
        policy: {cell.behavior: cell.shares(speed) for cell in cells if cell.policy == policy}
        for policy in dict.fromkeys(cell.policy for cell in cells)
    }


# ------------------------------------------------------------------ recorded


@dataclasses.dataclass
class Recorded:
    """The examples of one recording."""

    name: str
    person: np.ndarray  # (E,) int, the person in place of the robot
    flags: np.ndarray  # (V, E, 5) bool
    more: np.ndarray  # (E, M) bool
    known: frozenset[str]  # situations that the recording can have

    @property
    def people(self) -> int:
        """How many play the robot."""
        return len(np.unique(self.person))

    def shares(self, speed: int = 0) -> Shares:
        """Shares of the paper's situations."""
        return count_by_person(self.flags[speed], self.person)

    def further(self) -> Shares:
        """Shares of the situations beyond the paper's five."""
        return count_by_person(self.more, self.person)


class People(NamedTuple):
    """A recording, and the companions of its people."""

    tracks: Tracks
    companions: np.ndarray  # (N,) int32, people of one number are left out of each other's examples; -1: nobody is


def read_recordings(paths: Sequence[str], frame_rate: float | None = None) -> dict[str, People]:
    """The recordings in files, by name, or by path where two have one name.

    NAME.groups.txt beside NAME.csv tells companions and gives a second entry without them. ``frame_rate`` [1/s] is that
    of their formats if None.

    Raises:
        FileError: one sentence that names the file and the cure.
    """
    people, stems = {}, [Path(path).stem for path in paths]
    for stem, path in zip(stems, paths, strict=True):
        name = stem if stems.count(stem) == 1 else path
        tracks = recordings.read(path, frame_rate=frame_rate)
        people[name] = People(tracks, np.full(tracks.present.shape[1], -1, np.int32))
        groups = Path(path).with_suffix(".groups.txt")
        if groups.is_file():
            people[f"{name} without companions"] = People(tracks, recordings.read_companions(groups, tracks))
    return people


def count_recording(
    name: str,
    people: People,
    speeds: Sequence[float],
    tell: Callable[[float], None] = lambda _: None,
    kind: str = "paper",
) -> Recorded:
    """The examples of everybody in a recording, one for each person and row in which the person is present.

    Args:
        speeds: walking speeds V, m/s.
        tell: called with the finished share.
        kind: of the five situations, a key of ``SITUATION_SETS``: paper or sean2.
    """
    tracks = people.tracks
    present = np.asarray(tracks.present)
    robots = np.flatnonzero(present.any(0))
    values, longest = jnp.asarray(speeds, float), int(present.sum(0).max())  # rows of one person
    flags, more, person = [], [], []
    for index, robot in enumerate(robots):
        rows = np.flatnonzero(present[:, robot])
        padded = np.pad(rows, (0, longest - len(rows)), "edge").astype(np.int32)
        five, further = _flags(kind, people, np.int32(robot), padded, values)
        flags.append(np.asarray(five)[:, : len(rows)])
        more.append(np.asarray(further)[: len(rows)])
        person.append(np.full(len(rows), robot))
        tell((index + 1) / len(robots))
    unknown = {*OBJECT_SITUATIONS, *(() if (np.asarray(tracks.group) >= 0).any() else GROUPS)}
    known = frozenset({*SITUATIONS, *MORE_SITUATIONS} - unknown)
    return Recorded(name, np.concatenate(person), np.concatenate(flags, 1), np.concatenate(more), known)


@functools.partial(jax.jit, static_argnums=0)
def _flags(kind: str, people: People, robot: Array, rows: Array, speeds: Array) -> tuple[Array, Array]:
    """(V, K, 5) and (K, M) situations of a person in place of the robot, in K rows."""
    snapshots, _ = recordings.snapshots_of(people.tracks, robot)
    snapshots = jax.tree.map(lambda leaf: leaf[rows], snapshots)
    own = people.companions[robot]
    met = ~((people.companions == own) & (own >= 0))
    others = dataclasses.replace(snapshots.people, present=snapshots.people.present & met[None, :])
    snapshots = dataclasses.replace(snapshots, people=others)
    usual = classifiers.THRESHOLD_SETS[kind]()

    def at(situations: dict[str, Situation], speed: Array) -> Array:
        rules = functools.partial(classifiers.classify, situations=tuple(situations.items()))
        return jax.vmap(rules, (0, None))(snapshots, dataclasses.replace(usual, walking=speed))

    five = jax.vmap(functools.partial(at, classifiers.SITUATION_SETS[kind]))(speeds)
    return five, at(MORE_SITUATIONS, usual.walking)

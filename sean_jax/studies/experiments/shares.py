"""Shares of social situations (Table I): ways of counting, entropy, intervals, and the orderings of the paper.

Examples are taken once a second, and each situation that holds is a flag of the example. Intervals come from the
bootstrap of ``metrics.bootstrap`` over blocks of a minute (Kuensch 1989), because successive seconds are alike.
Entropies are divided by ln 5, that of five equal shares; they are the same for all ways of counting.
"""

import dataclasses
from typing import TypedDict

import numpy as np

from sean_jax.metrics import bootstrap

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


class Ordering(TypedDict):
    """An ordering of the paper's table, tested."""

    name: str
    hard: bool  # expected with any policy
    statement: str
    holds: bool
    share: float  # of the resamples in which it holds


@dataclasses.dataclass
class Shares:
    """Shares with one behavior and one policy: the estimate, followed by those of R bootstrap resamples."""

    examples: np.ndarray  # (1 + R, S), of all examples; S is 5 for the paper's situations
    none: np.ndarray  # (1 + R,), of the examples in which no situation holds
    seconds: int  # examples

    def of(self, counting: str) -> np.ndarray:
        """The shares by one way of counting.

        Args:
            counting: one of ``COUNTINGS``.

        Returns:
            (1 + R, S) from 0 to 1; 0 where there is nothing to divide by.
        """
        flags = self.examples.sum(1)
        whole = {
            "flags": flags,
            "flags_and_none": flags + self.none,
            "examples": np.ones_like(flags),
            "situated_examples": 1.0 - self.none,
        }[counting]
        return self.examples / np.where(whole > 0, whole, 1.0)[:, None]

    def entropy(self) -> np.ndarray:
        """Normalised entropy of the shares.

        Returns:
            (1 + R,), from 0 to 1.
        """
        return normalised_entropy(self.examples)


def count(flags: np.ndarray, seed: int = 0, streams: int = 1) -> Shares:
    """Shares of the situations and their bootstrap resamples.

    Args:
        flags: (blocks, seconds, S) bool, the situations that hold in each second of each block.
        streams: of equally many blocks, one after another; a resample draws as many of each, for the protocol fixes it.
    """
    each = [seed + 1000 * stream for stream in range(streams)]
    drawn = [bootstrap.resamples(len(flags) // streams, seed, bootstrap.RESAMPLES) for seed in each]
    weights = bootstrap.with_estimate(np.concatenate(drawn, axis=1))
    none = ~flags.any(-1)
    return Shares(weights @ flags.mean(1), weights @ none.mean(1), flags.shape[0] * flags.shape[1])


def count_by_person(flags: np.ndarray, person: np.ndarray, seed: int = 0) -> Shares:
    """Shares of the situations of recorded people, and resamples of people.

    Args:
        flags: (E, S) bool, the situations that hold in each example.
        person: (E,) whose example it is; people may have different numbers of them.

    Returns:
        The shares, where a resample has all examples of the people whom it drew.
    """
    people, index = np.unique(person, return_inverse=True)
    counts = np.zeros((len(people), flags.shape[1] + 2))  # of each situation, of none, and of all
    np.add.at(counts, index, np.column_stack([flags, ~flags.any(-1), np.ones(len(flags))]))
    drawn = bootstrap.with_estimate(bootstrap.resamples(len(people), seed, bootstrap.RESAMPLES)) @ counts
    share = drawn[:, :-1] / drawn[:, -1:]
    return Shares(share[:, :-1], share[:, -1], len(flags))


def normalised_entropy(shares: np.ndarray) -> np.ndarray:
    """Entropy of shares, divided by that of equal shares.

    Args:
        shares: (..., K), which need not add up to one.

    Returns:
        (...,) from 0 to 1; 0 if all shares are zero.
    """
    total = shares.sum(-1, keepdims=True)
    p = np.where(total > 0, shares / np.where(total > 0, total, 1), 0)
    return -(p * np.log(np.where(p > 0, p, 1))).sum(-1) / np.log(shares.shape[-1])


def interval(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """95 % bootstrap interval of a figure.

    Args:
        samples: (1 + R, ...), the estimate and its resamples.

    Returns:
        Lower and upper end, (...) each.
    """
    return bootstrap.interval(samples[1:])


def orderings(by_behavior: dict[str, Shares], counting: str = "flags") -> list[Ordering]:
    """The orderings that the paper's table shows, and how sure they are here.

    Args:
        counting: one of ``COUNTINGS``.

    Returns:
        For each ordering its name, its statement, whether it is expected with any policy (hard), whether it holds, and
        the share of the resamples in which it does.
    Source: Table I.
    """
    r, h, g = (by_behavior[name].of(counting) for name in ("random", "handcrafted", "graph"))
    hr, hh, hg = (normalised_entropy(each) for each in (r, h, g))
    cross, down, join, leave, empty = range(5)
    groups = g[:, join] + g[:, leave]
    close = np.abs(g[:, : down + 1] - r[:, : down + 1]) <= 0.25 * r[:, : down + 1]
    share = h[:, : down + 1] / np.minimum(r, g)[:, : down + 1].clip(1e-9)
    statements = [
        ("T1", True, "entropy: graph above random and handcrafted", (hg > hr) & (hg > hh)),
        ("T2", True, "random: join and leave group never", (r[:, join] == 0) & (r[:, leave] == 0)),
        ("T3", True, "empty: handcrafted > random > graph", (h[:, empty] > r[:, empty]) & (r[:, empty] > g[:, empty])),
        ("T4", True, "cross and down path of handcrafted below a fifth of the others'",
         (share < 0.2).all(1)),
        ("T5", False, "entropy: random above handcrafted", hr > hh),
        ("T6", False, "leave above join group, in handcrafted and graph",
         (h[:, leave] > h[:, join]) & (g[:, leave] > g[:, join])),
        ("T7", False, "down above cross path, in random and graph", 
         (r[:, down] > r[:, cross]) & (g[:, down] > g[:, cross])),
        ("T8", False, "cross and down path of graph within 25 % of random", close.all(1)),
        ("T9", False, "what empty loses from random to graph is join and leave group, within a fifth",
         np.abs((r[:, empty] - g[:, empty]) - groups) <= 0.2 * groups),
        ("T10", False, "entropy of graph at least 0.85", hg >= 0.85),
    ]  # fmt: skip
    return [
        {"name": name, "hard": hard, "statement": words, "holds": bool(holds[0]), "share": float(holds[1:].mean())}
        for name, hard, words, holds in statements
    ]


def paper() -> dict[str, np.ndarray]:
    """The shares that the paper prints, divided by their sum: 100.00 % in two rows, 105.63 % in random's.

    Returns:
        behavior -> (5,) from 0 to 1.
    Source: Table I.
    """
    return {name: np.array(row) / sum(row) for name, row in PAPER.items()}

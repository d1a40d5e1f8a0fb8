"""Shares of social situations (Table I): two ways of counting, entropy, intervals, and the orderings of the paper.

Examples are taken once a second. Where several situations hold, each counts fully (multi-label), or they share the
example equally (exclusive). Intervals come from a bootstrap over blocks of a minute (Kuensch 1989), for seconds in a
row are alike. Entropies are divided by ln 5, that of five equal shares.
"""

import dataclasses

import numpy as np

NAMES = ("cross_path", "down_path", "join_group", "leave_group", "empty")
PAPER = {  # Table I, percent
    "random": (14.51, 24.68, 0.0, 0.0, 66.44),
    "handcrafted": (0.73, 0.74, 3.43, 13.48, 81.62),
    "graph": (13.24, 22.08, 12.09, 19.51, 33.08),
}
RESAMPLES = 2000


@dataclasses.dataclass
class Shares:
    """Of one behavior with one driver: bootstrap resamples, the first of which is the estimate itself."""

    multi: np.ndarray  # (1 + RESAMPLES, 5)
    exclusive: np.ndarray  # (1 + RESAMPLES, 5)
    none: float  # of the examples, in which no situation holds
    examples: int

    def entropy(self, exclusive: bool = True) -> np.ndarray:
        """(1 + RESAMPLES,) normalised."""
        return normalised_entropy(self.exclusive if exclusive else self.multi)


def count(flags: np.ndarray, seed: int = 0) -> Shares:
    """Shares of flags (blocks, seconds, 5) bool."""
    held = flags.sum(-1, keepdims=True)
    multi = flags.mean(1)
    exclusive = (flags / np.maximum(held, 1)).mean(1)
    random = np.random.default_rng(seed)
    picks = random.multinomial(len(flags), np.full(len(flags), 1 / len(flags)), RESAMPLES) / len(flags)
    weights = np.concatenate([np.full((1, len(flags)), 1 / len(flags)), picks])
    none = float((held == 0).mean())
    return Shares(weights @ multi, weights @ exclusive, none, flags.shape[0] * flags.shape[1])


def normalised_entropy(shares: np.ndarray) -> np.ndarray:
    """(...,) of shares (..., K), which need not add up to one; 0 if all are zero."""
    total = shares.sum(-1, keepdims=True)
    p = np.where(total > 0, shares / np.where(total > 0, total, 1), 0)
    return -(p * np.log(np.where(p > 0, p, 1))).sum(-1) / np.log(shares.shape[-1])


def interval(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the middle 95 % of resamples (1 + RESAMPLES, ...)."""
    low, high = np.percentile(samples[1:], [2.5, 97.5], axis=0)
    return low, high


def orderings(found: dict[str, Shares], exclusive: bool = True) -> list[dict]:
    """What the paper's table shows, and how sure it is here: name, statement, share of resamples in which it holds.

    ``found`` has the behaviors random, handcrafted and graph. Those marked hard are expected of any driver.
    """
    r, h, g = (getattr(found[b], "exclusive" if exclusive else "multi") for b in ("random", "handcrafted", "graph"))
    hr, hh, hg = (normalised_entropy(each) for each in (r, h, g))
    cross, down, join, leave, empty = range(5)
    groups = g[:, join] + g[:, leave]
    close = np.abs(g[:, : down + 1] - r[:, : down + 1]) <= 0.25 * r[:, : down + 1]
    share = h[:, : down + 1] / np.minimum(r, g)[:, : down + 1].clip(1e-9)
    told = [
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
        {"name": name, "hard": hard, "statement": words, "holds": bool(held[0]), "share": float(held[1:].mean())}
        for name, hard, words, held in told
    ]


def paper() -> dict[str, np.ndarray]:
    """behavior -> (5,) shares of the paper."""
    return {name: np.array(row) / 100 for name, row in PAPER.items()}

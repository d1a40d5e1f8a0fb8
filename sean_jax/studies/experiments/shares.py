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
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax import classifiers
from sean_jax.classifiers import MORE_SITUATIONS, OBJECT_SITUATIONS
from sean_jax.config.flags import number
from sean_jax.metrics import bootstrap
from sean_jax.metrics.differences import holm
from sean_jax.people import recordings
from sean_jax.studies.experiments.results_table import ALL, Draw, Labels, Table, join, rows, samples

if TYPE_CHECKING:
    from sean_jax.classifiers import Situation
    from sean_jax.core.data_types import Array
    from sean_jax.people.recordings import Tracks

NAMES = ("cross_path", "down_path", "join_group", "leave_group", "empty")
NONE = "none"  # the situation of examples in which none of the five holds
FIVE = (*NAMES, NONE)
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
UNITS = "dataset", "episode"  # a stream of the protocol and a chain of it; or a person, of one dataset
SHARE, EXAMPLES, COMPLETED = "share", "examples", "completed"  # measures; a chain has shares, and a person examples
Shares = dict[Labels, np.ndarray]  # labels -> (1 + R, 6) shares of ``FIVE`` in all examples and in R resamples of them
Tables = Mapping[str, dict[str, dict[str, np.ndarray]]]  # world -> policy -> behavior -> (1 + R, 6) shares


# ------------------------------------------------------------------ statistics


def chain_shares(
    table: Table,
    by: Sequence[str],
    situations: Sequence[str] = FIVE,
    draw: Draw = lambda sizes: bootstrap.stratified_resamples(*sizes),
) -> Shares:
    """Shares of the examples, from 0 to 1 also where weights are negative; a resample draws chains of each stream."""
    draw = functools.cache(draw)
    chosen = table.where(measure=SHARE, situation=situations)
    means = samples(chosen.where(situation=set(situations) - {NONE}), by, UNITS, across="situation", draw=draw)
    for labels, none in samples(chosen.where(situation=NONE), by, UNITS, draw=draw).items():
        means[labels] = np.column_stack([means[labels], none])
    return {labels: np.clip(values, 0.0, 1.0) for labels, values in means.items()}


def people_shares(table: Table, by: Sequence[str], situations: Sequence[str] = FIVE, seed: int = 0) -> Shares:
    """Shares of the examples; a resample draws people with all their examples, whose numbers may differ.

    Shares of situations that a recording cannot have are NaN.
    """
    chosen = table.where(measure=EXAMPLES, situation=(ALL, *situations))

    def draw(sizes: tuple[int, ...]) -> np.ndarray:
        return bootstrap.resamples(sizes[-1], seed, bootstrap.RESAMPLES)

    counts = samples(chosen, by, UNITS, across="situation", draw=draw)
    with_situations = {labels: drawn for labels, drawn in counts.items() if drawn.shape[1] > 1}
    return {labels: drawn[:, 1:] / drawn[:, :1] for labels, drawn in with_situations.items()}


def counted(shares: Float[np.ndarray, "R 6"], counting: str = "flags") -> Float[np.ndarray, "R 5"]:
    """The shares of the five situations by one of ``COUNTINGS``, from 0 to 1; 0 where the divisor is 0."""
    five, none = shares[:, :5], shares[:, 5]
    flags = np.nansum(five, 1)
    by_counting = {"flags": flags, "flags_and_none": flags + none, "examples": np.ones_like(flags)}
    whole = by_counting.get(counting, 1.0 - none)
    return five / np.where(whole > 0, whole, 1.0)[:, None]


def entropy(shares: Float[np.ndarray, "R 6"]) -> Float[np.ndarray, " R"]:
    """Normalised entropy of the shares of the five situations, from 0 to 1."""
    return normalised_entropy(np.nan_to_num(shares[:, :5]))


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


def interval_rows(shares: Shares, names: Collection[str], *counting: str) -> list[tuple]:
    """Rows of a file: labels, ``counting``, name, share and interval; without shares that are NaN."""
    rows = []
    for labels, values in shares.items():
        numbers = zip(names, values[0], *interval(values), strict=True)
        rows += [(*labels, *counting, *row) for row in numbers if not np.isnan(row[1])]
    return rows


def share_rows(shares: Shares) -> list[tuple]:
    """Rows of a file: labels, counting, situation, share and interval."""
    rows = []
    for labels, values in shares.items():
        for counting in COUNTINGS:
            rows += interval_rows({labels: counted(values, counting)}, NAMES, counting)
    return rows


# ------------------------------------------------------------------ the paper's orderings

CROSS, DOWN, JOIN, LEAVE, EMPTY = range(5)
PATHS = slice(0, 2)  # cross and down path


class Ordering(NamedTuple):
    """An ordering of the paper's table.

    Its source is a statement of the paper's text, or its table, with thresholds that are ours.
    """

    name: str
    source: str
    statement: str
    holds: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # (1 + R, 5) of random, handcrafted and graph


def _below_a_fifth(random: np.ndarray, handcrafted: np.ndarray, graph: np.ndarray) -> np.ndarray:
    least = np.minimum(random, graph)[:, PATHS].clip(1e-9)
    return np.asarray((handcrafted[:, PATHS] / least < 0.2).all(1))


def _lost_to_groups(random: np.ndarray, handcrafted: np.ndarray, graph: np.ndarray) -> np.ndarray:
    groups = graph[:, JOIN] + graph[:, LEAVE]
    return np.abs((random[:, EMPTY] - graph[:, EMPTY]) - groups) <= 0.2 * groups


ORDERINGS = (
    Ordering(
        "T1",
        "text",
        "entropy: graph above random and handcrafted",
        lambda r, h, g: normalised_entropy(g) > np.maximum(normalised_entropy(r), normalised_entropy(h)),
    ),
    Ordering(
        "T2",
        "text",
        "random: join and leave group never",
        lambda r, h, g: (r[:, JOIN] == 0) & (r[:, LEAVE] == 0),
    ),
    Ordering(
        "T3",
        "table",
        "empty: handcrafted > random > graph",
        lambda r, h, g: (h[:, EMPTY] > r[:, EMPTY]) & (r[:, EMPTY] > g[:, EMPTY]),
    ),
    Ordering("T4", "table", "cross and down path of handcrafted below a fifth of the others'", _below_a_fifth),
    Ordering(
        "T5",
        "text",
        "entropy: random above handcrafted",
        lambda r, h, g: normalised_entropy(r) > normalised_entropy(h),
    ),
    Ordering(
        "T6",
        "table",
        "leave above join group, in handcrafted and graph",
        lambda r, h, g: (h[:, LEAVE] > h[:, JOIN]) & (g[:, LEAVE] > g[:, JOIN]),
    ),
    Ordering(
        "T7",
        "table",
        "down above cross path, in random and graph",
        lambda r, h, g: (r[:, DOWN] > r[:, CROSS]) & (g[:, DOWN] > g[:, CROSS]),
    ),
    Ordering(
        "T8",
        "table",
        "cross and down path of graph within 25 % of random",
        lambda r, h, g: np.asarray((np.abs(g[:, PATHS] - r[:, PATHS]) <= 0.25 * r[:, PATHS]).all(1)),
    ),
    Ordering(
        "T9",
        "table",
        "what empty loses from random to graph is join and leave group, within a fifth",
        _lost_to_groups,
    ),
    Ordering("T10", "table", "entropy of graph at least 0.85", lambda r, h, g: normalised_entropy(g) >= 0.85),
)
"""Source: Table I, and its discussion in section V-B."""


def orderings(by_behavior: Mapping[str, np.ndarray], counting: str = "flags") -> list[dict[str, Any]]:
    """Test the orderings of the paper's table by one of ``COUNTINGS``.

    Args:
        by_behavior: behavior -> (1 + R, 6) shares.

    Returns:
        For each its name, source, statement, whether it holds, and the share of the resamples in which it holds.
    """
    shares = [counted(by_behavior[behavior], counting) for behavior in BEHAVIORS]
    tests = []
    for ordering in ORDERINGS:
        holds = ordering.holds(*shares)
        numbers = {"holds": bool(holds[0]), "share": float(holds[1:].mean())}
        tests.append({"name": ordering.name, "source": ordering.source, "statement": ordering.statement, **numbers})
    return tests


def ordering_rows(by_behavior: Mapping[str, np.ndarray], *head: Any) -> Iterator[tuple]:
    """Rows of a file, after ``head``: the orderings by each of ``COUNTINGS``."""
    for counting in COUNTINGS:
        for test in orderings(by_behavior, counting):
            statement, share = f'"{test["statement"]}"', f"{test['share']:.4f}"
            yield (*head, counting, test["name"], test["source"], statement, test["holds"], share)


def by_policy(shares: Shares) -> dict[str, dict[str, np.ndarray]]:
    """policy -> behavior -> shares, of labels that begin with both."""
    tables: dict[str, dict[str, np.ndarray]] = {}
    for (policy, behavior, *_), values in shares.items():
        tables.setdefault(policy, {})[behavior] = values
    return tables


def paper() -> dict[str, np.ndarray]:
    """behavior -> the shares (5,) that the paper prints, divided by their sum (105.63 % for random, else 100 %).

    Source: Table I.
    """
    return {name: np.array(row) / sum(row) for name, row in PAPER.items()}


# ------------------------------------------------------------------ simulated


def chain_rows(
    flags: Bool[np.ndarray, "V chains seconds 5"],
    more: Bool[np.ndarray, "chains seconds M"],
    ended: Int[np.ndarray, " 2"],
    streams: int,
    speeds: Sequence[str],
    further: Sequence[str] = (),
    **labels: Any,
) -> Table:
    """The rows of chains of episodes with one behavior, one policy and one number of people.

    Args:
        more: the situations ``further``, which do not depend on the walking speed V.
        ended: episodes completed and not.
        streams: of the protocol, each with as many chains, one stream after another.
        speeds: walking speeds V in words.
    """
    chains, seconds = flags.shape[1:3]
    units = {"dataset": np.arange(chains) // (chains // streams), **labels}
    tables = []
    for speed, holds in zip(speeds, flags, strict=True):
        shares = np.column_stack([holds.mean(1), (~holds.any(-1)).mean(1)])  # (chains, 6)
        tables.append(rows(shares, FIVE, measure=SHARE, speed=speed, **units))
    if further:
        tables.append(rows(more.mean(1), further, measure=SHARE, speed="", **units))
    tables.append(rows(np.full(chains, seconds), measure=EXAMPLES, speed="", **units))
    tables.append(rows(np.repeat([1.0, 0.0], ended), measure=COMPLETED, speed="", **labels))
    return join(tables)


def hours(table: Table) -> list[dict[str, Any]]:
    """The paper's hour of each behavior beside the 95 % interval of one hour of a policy, by shares of flags.

    Args:
        table: rows of ``chain_rows`` with one walking speed.

    Returns:
        For each policy and behavior, and each situation and the entropy: names, mean, interval, the paper's figure, the
        p-value of the paper's figure in the distribution of an hour, and the same corrected for all figures of the
        policy (Holm).

    Source: Table I.
    """
    tests = []
    for (policy, behavior), cell in table.groups(["policy", "behavior"]).items():
        (shares,) = chain_shares(cell, [], draw=functools.partial(_of_an_hour, cell)).values()
        figures = np.column_stack([counted(shares), entropy(shares)])  # (1 + R, 6)
        low, high = interval(figures)
        printed = paper()[behavior]
        values = [*printed, float(normalised_entropy(printed))]
        for k, name in enumerate((*NAMES, "entropy")):
            above = 1 + (figures[1:, k] >= values[k]).sum()
            below = 1 + (figures[1:, k] <= values[k]).sum()
            tests.append({
                "policy": policy, "behavior": behavior, "figure": name, "mean": figures[0, k], "low": low[k],
                "high": high[k], "paper": values[k], "p": min(1.0, 2.0 * min(above, below) / len(figures)),
            })  # fmt: skip
    for policy in table.levels("policy"):
        of_policy = [test for test in tests if test["policy"] == policy]
        for test, corrected in zip(of_policy, holm([test["p"] for test in of_policy]), strict=True):
            test["holm"] = corrected
    return tests


def _of_an_hour(cell: Table, sizes: tuple[int, ...]) -> np.ndarray:
    """Weights of chains, for the share in one further hour of all streams."""
    seconds = cell.where(measure=EXAMPLES).value[0]  # of a chain
    streams, chains = sizes
    return bootstrap.predictive_resamples(streams, chains, max(1, round(3600 / (seconds * streams))))


# ------------------------------------------------------------------ recorded


def people_rows(
    holds: Bool[np.ndarray, "E K"], situations: Sequence[str], person: Int[np.ndarray, " E"], **labels: Any
) -> Table:
    """The rows of people: for each how many examples there are, and in how many each situation holds.

    Args:
        holds: of the situations, after which NONE may come: the examples without any of them.
    """
    people, index = np.unique(person, return_inverse=True)
    counts = np.zeros((len(people), 1 + len(situations)))  # of all examples, and by situation
    none = [~holds.any(-1)] if len(situations) > holds.shape[1] else []
    np.add.at(counts, index, np.column_stack([np.ones(len(holds)), holds, *none]))
    return rows(counts, (ALL, *situations), measure=EXAMPLES, episode=people, **labels)


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
) -> Table:
    """The rows of everybody in a recording; each row of the recording in which a person is present is an example.

    Args:
        speeds: walking speeds V, m/s.
        tell: called with the finished share.
        kind: of the five situations, a key of ``SITUATION_SETS``: paper or sean2.
    """
    person, flags, more = _examples(people, speeds, tell, kind)
    labels = {"policy": "", "behavior": name, "people": len(np.unique(person))}
    tables = [
        people_rows(holds, FIVE, person, speed=number(speed), **labels)
        for speed, holds in zip(speeds, flags, strict=True)
    ]
    table = join([*tables, people_rows(more, tuple(MORE_SITUATIONS), person, speed="", **labels)])

    # Situations that the recording cannot have are NaN, not zero.
    grouped = (np.asarray(people.tracks.group) >= 0).any()
    unknown = (*OBJECT_SITUATIONS, *(() if grouped else GROUPS))
    codes = [code for code, situation in enumerate(table.names["situation"]) if situation in unknown]
    return dataclasses.replace(table, value=np.where(np.isin(table.columns["situation"], codes), np.nan, table.value))


def _examples(
    people: People, speeds: Sequence[float], tell: Callable[[float], None], kind: str
) -> tuple[Int[np.ndarray, " E"], Bool[np.ndarray, "V E 5"], Bool[np.ndarray, "E M"]]:
    """The person of each example, and the situations in which the person is."""
    present = np.asarray(people.tracks.present)
    robots = np.flatnonzero(present.any(0))
    longest = int(present.sum(0).max())  # rows of one person
    person, flags, more = [], [], []
    for index, robot in enumerate(robots):
        frames = np.flatnonzero(present[:, robot])
        padded = np.pad(frames, (0, longest - len(frames)), "edge").astype(np.int32)
        five, further = _flags(kind, people, np.int32(robot), padded, jnp.asarray(speeds, float))
        person.append(np.full(len(frames), robot))
        flags.append(np.asarray(five)[:, : len(frames)])
        more.append(np.asarray(further)[: len(frames)])
        tell((index + 1) / len(robots))
    return np.concatenate(person), np.concatenate(flags, 1), np.concatenate(more)


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

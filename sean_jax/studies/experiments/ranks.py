"""Ranks of policies with ties (benchmark): differences of the same episodes, intervals, correction for many pairs.

Tracks weigh the same, and a resample draws as many episodes of each. The training seeds of an agent are independent,
and there are few of them: intervals over seeds are Student's.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

from sean_jax.core.data_types import SENSING
from sean_jax.metrics import Estimate, interval
from sean_jax.metrics.differences import holm
from sean_jax.studies.experiments.measures import percent
from sean_jax.studies.experiments.results_table import ALL as EPISODE
from sean_jax.studies.experiments.results_table import join, samples
from sean_jax.studies.experiments.scores import APPROACHES, TIME, Arrays, polite, score_resamples, track_rows
from sean_jax.studies.experiments.shares import NAMES

LEVEL = 0.05  # of corrected p-values
SEEDS = 3  # of an agent, at least, for an interval that has the variation between trainings
ALL = "all"  # tracks


class Entry(NamedTuple):
    """The results of one name: of one policy, or of the training seeds of an agent."""

    name: str
    sensing: str  # one of ``data_types.SENSING``
    trained: bool  # whether it is an agent
    measured: list[dict[str, Arrays]]  # of each result, by track


Sums = dict[tuple[str, str], np.ndarray]
"""(name of an entry, measure) -> (tracks, seeds, 1 + R), or (..., S) in each situation: means over the episodes of each
track, and over those of R resamples."""


@dataclasses.dataclass(frozen=True)
class RankingRow:
    """An entry and its ranks: the first and the last that its differences from the others allow."""

    entry: Entry
    first: int
    last: int
    of: dict[str, Estimate]  # ALL, and group of tracks -> percent of tasks that were completed politely
    violations: Estimate  # (S,) a minute in each situation

    @property
    def rank(self) -> str:
        """The rank, such as "2", or the first and the last, such as "2-4"."""
        if self.first == self.last:
            return f"{self.first}"
        return f"{self.first}-{self.last}"

    @property
    def seeds(self) -> str:
        """Number of training seeds; "-" of what does not learn."""
        number = len(self.entry.measured)
        if not self.entry.trained:
            return "-"
        if number < SEEDS:
            return f"{number} of {SEEDS}"
        return f"{number}"


class RankedPair(NamedTuple):
    """Two entries of a class."""

    sensing: str
    first: str
    second: str
    difference: tuple[float, float, float]  # second minus first, % points, and the ends of its 95 % interval
    p: float  # after Holm's correction for all pairs; 1 where no episode differs


@dataclasses.dataclass(frozen=True)
class Ranking:
    """Entries by class and percent of tasks completed politely, and their differences."""

    groups: dict[str, list[str]]  # ALL, and group -> its tracks
    rows: list[RankingRow]
    pairs: list[RankedPair]
    notes: list[str]

    def by_class(self) -> dict[str, list[RankingRow]]:
        """Class of sensing -> its rows."""
        classes = {}
        for sensing in SENSING:
            rows = [row for row in self.rows if row.entry.sensing == sensing]
            if rows:
                classes[sensing] = rows
        return classes

    def table(self) -> str:
        """The ranking as text."""
        lines = []
        for sensing, rows in self.by_class().items():
            lines.append(f"{sensing} · politely completed %")
            head = "".join(f"{name:>11}" for name in self.groups)
            lines.append(f"  {'rank':<6}{'policy':<28}{'seeds':<8}{head}")
            for row in rows:
                figures = "".join(f"{float(row.of[name].mean):11.2f}" for name in self.groups)
                lines.append(f"  {row.rank:<6}{row.entry.name:<28.27}{row.seeds:<8}{figures}")
        return "\n".join([*lines, *self.notes])


def rank(entries: list[Entry], groups: dict[str, list[str]], notes: list[str]) -> Ranking:
    """The ranking of entries.

    Args:
        groups: group of tracks -> the tracks of it that all entries have.
        notes: sentences on what the ranking lacks.
    """
    groups = {ALL: [track for tracks in groups.values() for track in tracks], **groups}
    tracks = groups[ALL]
    sums = _sums(entries, tracks)
    pairs = _pairs(entries, sums, tracks)

    # Only a difference beyond chance separates two entries; a rank is therefore an interval.
    better = Counter[str]()  # numbers of entries, beyond chance
    worse = Counter[str]()
    for pair in pairs:
        if pair.p >= LEVEL:
            continue
        low = pair.second
        high = pair.first
        if pair.difference[0] > 0:
            low = pair.first
            high = pair.second
        better[low] += 1
        worse[high] += 1

    # The first rank comes after all who are surely better, the last before all who are surely worse.
    in_class = Counter(entry.sensing for entry in entries)
    rows = []
    for entry in entries:
        first = 1 + better[entry.name]
        last = in_class[entry.sensing] - worse[entry.name]
        by_group = {name: _share(entry, tracks_of_group, sums, tracks) for name, tracks_of_group in groups.items()}
        minutes = sums[entry.name, TIME] / 60.0
        violations = _violations(sums[entry.name, APPROACHES], minutes)
        rows.append(RankingRow(entry, first, last, by_group, violations))

    # Policies that see more are in a class of their own: they are compared only with each other.
    classes = list(SENSING)
    rows.sort(key=lambda row: (classes.index(row.entry.sensing), -float(row.of[ALL].mean)))

    # An interval over fewer trainings would look too certain.
    few = [row.entry.name for row in rows if row.seeds.endswith(f"of {SEEDS}")]
    if few:
        notes = [f"Fewer than {SEEDS} training seeds: {', '.join(few)}.", *notes]
    return Ranking(groups, rows, pairs, notes)


def _pairs(entries: list[Entry], sums: Sums, tracks: list[str]) -> list[RankedPair]:
    """The differences of all pairs of a class, with Holm's correction for the pairs of all classes."""
    compared = []
    differences = []
    p_values = []
    for one, other in itertools.combinations(entries, 2):
        if one.sensing != other.sensing:
            continue
        changed = functools.partial(_changed, one, other, tracks)
        shares = sums[one.name, "polite"], sums[other.name, "polite"]
        difference, p = _difference(*shares, changed)
        compared.append((one, other))
        differences.append(difference)
        p_values.append(p)

    pairs = []
    corrected = np.nan_to_num(holm(p_values), nan=1.0)
    for (one, other), difference, p in zip(compared, differences, corrected, strict=True):
        pairs.append(RankedPair(one.sensing, one.name, other.name, difference, float(p)))
    return pairs


def _sums(entries: list[Entry], tracks: list[str]) -> Sums:
    """Means of each entry on each track; equal episodes are in equal resamples of all entries."""
    sums: dict[tuple[str, str], list[np.ndarray]] = {}
    for number, track in enumerate(tracks):
        table = join(
            track_rows(measured[track], track, ["polite"], policy=entry.name, seed=seed)
            for entry in entries
            for seed, measured in enumerate(entry.measured)
        )
        draw = functools.partial(_draw, number)
        for measure, across in (("polite", None), (APPROACHES, "situation"), (TIME, "situation")):
            chosen = table.where(measure=measure, situation=NAMES if across else EPISODE)
            means = samples(chosen, ["policy", "seed"], ["episode"], across=across, draw=draw)
            for entry in entries:
                of_seeds = [means[entry.name, seed] for seed in range(len(entry.measured))]
                sums.setdefault((entry.name, measure), []).append(np.stack(of_seeds))
    return {labels: np.stack(values) for labels, values in sums.items()}


def _draw(seed: int, sizes: tuple[int, ...]) -> np.ndarray:
    """(R, E) int16, number of times that each episode of a track is in each resample."""
    return score_resamples(sizes[-1], seed)


def _changed(one: Entry, other: Entry, tracks: list[str]) -> int:
    """How many tasks one of two policies completed politely and the other did not."""
    changed = 0
    for track in tracks:
        differs = polite(one.measured[0][track]) ^ polite(other.measured[0][track])
        changed += int(differs.sum())
    return changed


def _share(entry: Entry, members: list[str], sums: Sums, tracks: list[str]) -> Estimate:
    """Percent of tasks that were completed politely; of one seed with none or all, with Wilson's interval."""
    by_track = sums[entry.name, "polite"]
    shares = np.mean([by_track[tracks.index(track)] for track in members], 0)  # (seeds, 1 + R)
    episodes = sum(len(entry.measured[0][track]["completed"]) for track in members)
    share = _over_seeds(shares, episodes)
    even = (len(shares) == 1) & ((share.mean == 0.0) | (share.mean == 1.0))
    return percent(share._replace(high=np.minimum(share.high, 1.0)), even)


def _violations(events: np.ndarray, minutes: np.ndarray) -> Estimate:
    """(S,) violations a minute in each situation, of (tracks, seeds, 1 + R, S); 0 where it never occurs."""
    events = events.sum(0)
    minutes = minutes.sum(0)
    rate = events / np.where(minutes > 0, minutes, 1.0)
    return _over_seeds(rate, 1)


def _over_seeds(values: np.ndarray, number: int) -> Estimate:
    """The mean of figures (seeds, 1 + R, ...), not negative, over seeds, and its interval."""
    seeds = values[:, 0]
    middle = seeds.mean(0)
    if len(seeds) == 1:
        low, high = interval(values[0, 1:])
    else:
        deviation = seeds.std(0, ddof=1)
        half = stats.t.ppf(0.975, len(seeds) - 1) * deviation / len(seeds) ** 0.5
        low = np.maximum(middle - half, 0.0)
        high = middle + half
    return Estimate(middle, low, high, np.full(np.shape(middle), number))


def _difference(
    one: np.ndarray, other: np.ndarray, changed: Callable[[], int]
) -> tuple[tuple[float, float, float], float]:
    """The difference of two entries [% points] with its 95 % interval, and the p-value of none; NaN if nothing differs.

    Its variance is that of the resamples, and of the seeds of each entry with several, with the degrees of freedom of
    Welch and Satterthwaite. Without seeds, no p-value is smaller than permutations of so few episodes could give.

    Args:
        one, other: (tracks, seeds, 1 + R) shares of tasks that were completed politely.
        changed: gives the number of tasks that only one of them completed politely.
    """
    values = [100.0 * shares.mean(0) for shares in (one, other)]  # (seeds, 1 + R)
    gaps = values[1].mean(0) - values[0].mean(0)
    middle = float(gaps[0])
    gaps = gaps[1:]

    # Variances of the means over several seeds, and their degrees of freedom.
    of_seeds = []
    for shares in values:
        seeds = len(shares)
        if seeds > 1:
            variance = float(shares[:, 0].var(ddof=1)) / seeds
            of_seeds.append((variance, seeds - 1))
    square = float(gaps.var(ddof=1)) + sum(variance for variance, _ in of_seeds)
    if square == 0.0:  # no episode differs, or all do in the same way
        return (middle, middle, middle), 0.0 if middle else np.nan
    spread = sum(variance**2 / freedom for variance, freedom in of_seeds)
    freedom = square**2 / spread if spread else np.inf

    p = 2.0 * float(stats.t.sf(abs(middle) / square**0.5, freedom))
    if of_seeds:
        half = float(stats.t.ppf(0.975, freedom)) * square**0.5
        return (middle, middle - half, middle + half), p
    low, high = interval(gaps)
    return (middle, float(low), float(high)), max(p, 2.0 ** (1 - changed()))

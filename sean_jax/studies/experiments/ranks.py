"""Ranks of policies with ties (benchmark): differences of the same episodes, intervals, correction for many pairs.

Tracks weigh the same, and a resample draws as many episodes of each. The training seeds of an agent are independent,
and there are few of them: intervals over seeds are Student's.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from typing import NamedTuple

import numpy as np
from scipy import stats

from sean_jax.core.data_types import SENSING
from sean_jax.metrics import Estimate, interval
from sean_jax.metrics.bootstrap import with_estimate
from sean_jax.metrics.differences import holm
from sean_jax.studies.experiments.measures import Arrays, percent, polite, score_resamples

LEVEL = 0.05  # of corrected p-values
SEEDS = 3  # of an agent, at least, for an interval that has the variation between trainings
ALL = "all"  # tracks


class Entry(NamedTuple):
    """The results of one name: of one policy, or of the training seeds of an agent."""

    name: str
    sensing: str  # one of ``data_types.SENSING``
    trained: bool  # whether it is an agent
    measured: list[dict[str, Arrays]]  # of each result, by track


class Sums(NamedTuple):
    """The sums over the episodes of a track, of all and of each of R resamples, for each seed of an entry."""

    tasks: np.ndarray  # (seeds, E) bool, whether each was completed politely
    polite: np.ndarray  # (seeds, 1 + R) share of them
    events: np.ndarray  # (seeds, 1 + R, S) approaches within 0.45 m of a person, in each situation
    minutes: np.ndarray  # (seeds, 1 + R, S) in each situation


@dataclasses.dataclass(frozen=True)
class Row:
    """An entry and its ranks: the first and the last that its differences from the others allow."""

    entry: Entry
    first: int
    last: int
    of: dict[str, Estimate]  # ALL, and group of tracks -> percent of tasks that were completed politely
    violations: Estimate  # (S,) a minute in each situation

    @property
    def rank(self) -> str:
        """The rank, such as "2", or the first and the last, such as "2-4"."""
        return f"{self.first}" if self.first == self.last else f"{self.first}-{self.last}"

    @property
    def seeds(self) -> str:
        """Number of training seeds; "-" of what does not learn."""
        number = len(self.entry.measured)
        return "-" if not self.entry.trained else f"{number}" if number >= SEEDS else f"{number} of {SEEDS}"


class Pair(NamedTuple):
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
    rows: list[Row]
    pairs: list[Pair]
    notes: list[str]

    def by_class(self) -> dict[str, list[Row]]:
        """Class of sensing -> its rows."""
        classes = {sensing: [row for row in self.rows if row.entry.sensing == sensing] for sensing in SENSING}
        return {sensing: rows for sensing, rows in classes.items() if rows}

    def table(self) -> str:
        """The ranking as text."""
        lines = []
        for sensing, rows in self.by_class().items():
            lines.append(f"{sensing} · politely completed %")
            lines.append(f"  {'rank':<6}{'policy':<28}{'seeds':<8}" + "".join(f"{name:>11}" for name in self.groups))
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
    sums = _sums(entries, groups[ALL])
    tests = [
        (one, other, *_difference(sums[one.name], sums[other.name]))
        for one, other in itertools.combinations(entries, 2)
        if one.sensing == other.sensing
    ]
    corrected = np.nan_to_num(holm([p for *_, p in tests]), nan=1.0)
    pairs = [
        Pair(one.sensing, one.name, other.name, each, float(p))
        for (one, other, each, _), p in zip(tests, corrected, strict=True)
    ]
    better, worse = dict.fromkeys(sums, 0), dict.fromkeys(sums, 0)  # numbers of entries, beyond chance
    for pair in pairs:
        if pair.p < LEVEL:
            low, high = (pair.first, pair.second) if pair.difference[0] > 0 else (pair.second, pair.first)
            better[low] += 1
            worse[high] += 1
    members = Counter(entry.sensing for entry in entries)
    rows = [
        Row(
            entry,
            1 + better[entry.name],
            members[entry.sensing] - worse[entry.name],
            {name: _share([sums[entry.name][track] for track in tracks]) for name, tracks in groups.items()},
            _violations(list(sums[entry.name].values())),
        )
        for entry in entries
    ]
    rows.sort(key=lambda row: (list(SENSING).index(row.entry.sensing), -float(row.of[ALL].mean)))
    few = [row.entry.name for row in rows if row.seeds.endswith(f"of {SEEDS}")]
    notes = [f"Fewer than {SEEDS} training seeds: {', '.join(few)}."] * bool(few) + notes
    return Ranking(groups, rows, pairs, notes)


def _sums(entries: list[Entry], tracks: list[str]) -> dict[str, dict[str, Sums]]:
    """Name of an entry -> track -> its sums; equal episodes are in equal resamples of all entries."""
    sums: dict[str, dict[str, Sums]] = {entry.name: {} for entry in entries}
    for seed, track in enumerate(tracks):
        episodes = len(entries[0].measured[0][track]["completed"])
        weights = with_estimate(score_resamples(episodes, seed))
        for entry in entries:
            each = [measured[track] for measured in entry.measured]
            tasks = np.stack([polite(columns) for columns in each])
            events = [columns["intimate_robot_on_person"][:, 1:] for columns in each]
            minutes = [columns["time_in_situation"][:, 1:] / 60.0 for columns in each]
            parts = [np.stack([weights @ np.asarray(one, float) for one in part]) for part in (tasks, events, minutes)]
            sums[entry.name][track] = Sums(tasks, *parts)
    return sums


def _overall(sums: list[Sums]) -> np.ndarray:
    """(seeds, 1 + R) share of tasks of some tracks that were completed politely."""
    return np.mean([each.polite for each in sums], 0)


def _share(sums: list[Sums]) -> Estimate:
    """Percent of tasks that were completed politely; of one seed with none or all, with Wilson's interval."""
    shares, episodes = _overall(sums), sum(each.tasks.shape[1] for each in sums)
    share = _over_seeds(shares, episodes)
    even = (len(shares) == 1) & ((share.mean == 0.0) | (share.mean == 1.0))
    return percent(share._replace(high=np.minimum(share.high, 1.0)), even)


def _violations(sums: list[Sums]) -> Estimate:
    """(S,) violations a minute in each situation; 0 where it never occurs."""
    events, minutes = (np.sum([getattr(each, name) for each in sums], 0) for name in ("events", "minutes"))
    return _over_seeds(events / np.where(minutes > 0, minutes, 1.0), 1)


def _over_seeds(values: np.ndarray, number: int) -> Estimate:
    """The mean of figures (seeds, 1 + R, ...), not negative, over seeds, and its interval."""
    seeds, middle = values[:, 0], values[:, 0].mean(0)
    if len(seeds) == 1:
        low, high = interval(values[0, 1:])
    else:
        half = stats.t.ppf(0.975, len(seeds) - 1) * seeds.std(0, ddof=1) / len(seeds) ** 0.5
        low, high = np.maximum(middle - half, 0.0), middle + half
    return Estimate(middle, low, high, np.full(np.shape(middle), number))


def _difference(one: dict[str, Sums], other: dict[str, Sums]) -> tuple[tuple[float, float, float], float]:
    """The difference of two entries [% points] with its 95 % interval, and the p-value of none; NaN if nothing differs.

    Its variance is that of the resamples, and of the seeds of each entry with several, with the degrees of freedom of
    Welch and Satterthwaite. Without seeds, no p-value is smaller than permutations of so few episodes could give.
    """
    values = [100.0 * _overall(list(each.values())) for each in (one, other)]
    gaps = values[1].mean(0) - values[0].mean(0)
    middle, gaps = float(gaps[0]), gaps[1:]
    parts = [(float(each[:, 0].var(ddof=1)) / len(each), len(each) - 1) for each in values if len(each) > 1]
    square = float(gaps.var(ddof=1)) + sum(part for part, _ in parts)
    if square == 0.0:  # no episode differs, or all do in the same way
        return (middle, middle, middle), 0.0 if middle else np.nan
    spread = sum(part**2 / freedom for part, freedom in parts)
    freedom = square**2 / spread if spread else np.inf
    p = 2.0 * float(stats.t.sf(abs(middle) / square**0.5, freedom))
    if not parts:
        p = max(p, 2.0 ** (1 - sum(int((one[track].tasks ^ other[track].tasks).sum()) for track in one)))
    half = float(stats.t.ppf(0.975, freedom)) * square**0.5
    low, high = (middle - half, middle + half) if parts else map(float, interval(gaps))
    return (middle, float(low), float(high)), p

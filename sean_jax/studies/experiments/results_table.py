"""One table of results: a row for each value of a measure in an episode; and means, contrasts and estimates of rows.

A table has the columns policy, behavior, dataset, seed, episode, situation, measure and value, and a study may add
others, such as people. The columns ``dataset`` and ``seed`` are the numbers of a network's dataset and training seed,
and 0 for policies that do not learn in the study. Episodes are numbered over all networks of a policy, so equal numbers
are equal episodes of two policies. For example::

    table = join(
        rows(delay[policy, floor], measure="delay", policy=policy, behavior=floor)  # (E,) of the episodes
        for policy in policies
        for floor in floors
    )
    estimate(table, ["policy", "behavior"])  # the mean of each policy on each floor, with its interval
    estimate(contrast(table, "orca", "dwa"), ["behavior"])  # their difference in the same episodes
    estimate(averaged(table, "behavior", "mean"), ["policy"])  # over the floors
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sean_jax.core.errors import InputError
from sean_jax.metrics import Estimate, aggregate, aggregate_ratio
from sean_jax.metrics.bootstrap import UNBOUNDED, hierarchical_resamples, resamples, with_estimate

ALL = ""  # the situation of what is measured over a whole episode
UNITS = "dataset", "seed", "episode"
MATCHED = "dataset", "seed"  # columns in which equal episodes of two policies may differ
Labels = tuple[Any, ...]  # one label of each column of ``by``
Estimates = dict[Labels, Estimate]
Draw = Callable[[tuple[int, ...]], np.ndarray]  # numbers of units at each level -> (R, E) weights of rows


@dataclass(frozen=True)
class Table:
    """N rows of results in plain columns.

    Columns of text hold indices into their ``names``, since a table may have millions of rows.
    """

    columns: dict[str, np.ndarray]  # column -> (N,) int
    names: dict[str, tuple[str, ...]]  # column of text -> its labels
    value: np.ndarray  # (N,) float

    def __len__(self) -> int:
        return len(self.value)

    def label(self, column: str, row: int) -> Any:
        """The text or number in a column of a row."""
        code = int(self.columns[column][row])
        if column not in self.names:
            return code
        return self.names[column][code]

    def levels(self, column: str) -> list[Any]:
        """The labels of a column, each once, in the order in which they were added."""
        return [label for (label,) in self.groups([column])]

    def where(self, **chosen: Any) -> Table:
        """The rows with these labels: ``where(policy="G", measure=("violations", "collisions"))``."""
        if not len(self):
            return self
        keep = np.ones(len(self), bool)
        for column, labels in chosen.items():
            wanted = (labels,) if isinstance(labels, str | int) else tuple(labels)
            if column in self.names:
                wanted = [code for code, name in enumerate(self.names[column]) if name in wanted]
            codes = np.array(wanted, int)
            keep &= np.isin(self.columns[column], codes)
        return self.take(np.flatnonzero(keep))

    def take(self, rows: np.ndarray) -> Table:
        """The rows with these indices."""
        columns = {column: codes[rows] for column, codes in self.columns.items()}
        return Table(columns, self.names, self.value[rows])

    def relabel(self, **labels: str) -> Table:
        """The same rows with one text in all rows of a column."""
        columns = {column: np.zeros(len(self), np.int32) for column in labels}
        names = {column: (text,) for column, text in labels.items()}
        return Table(self.columns | columns, self.names | names, self.value)

    def groups(self, by: Sequence[str]) -> dict[Labels, Table]:
        """Labels of the columns ``by`` -> their rows, in the order in which they were added."""
        if not len(self):
            return {}

        # One number for the labels of a row, so that a single sort finds the groups.
        code = np.zeros(len(self), np.int64)
        for column in by:
            size = int(self.columns[column].max()) + 1
            code = code * size + self.columns[column]
        _, first_row, group = np.unique(code, return_index=True, return_inverse=True)

        groups = {}
        for index in np.argsort(first_row):
            labels = tuple(self.label(column, int(first_row[index])) for column in by)
            groups[labels] = self.take(np.flatnonzero(group == index))
        return groups

    def matrix(self, across: str | None, units: Sequence[str] = UNITS) -> tuple[np.ndarray, tuple[int, ...]]:
        """The values (E,), or (E, K) of the K labels of ``across``, and how many units there are at each level.

        Rows are in the order of the units, outermost first.

        Raises:
            InputError: units have different numbers of rows.
        """
        keys = [*units, across] if across else list(units)
        innermost_first = [self.columns[column] for column in reversed(keys)]
        values = self.value[np.lexsort(innermost_first)]

        width = self._number(across) if across else 1
        outer = [self._number(column) for column in units[:-1]]
        innermost = len(self) // (width * math.prod(outer))
        sizes = (*outer, innermost)
        if math.prod(sizes) * width != len(self):
            counts = " x ".join(map(str, (*sizes, width)))
            raise InputError(f"table: {len(self)} rows are not {counts} of {', '.join(keys)}.")
        if across:
            values = values.reshape(-1, width)
        return values, sizes

    def _number(self, column: str) -> int:
        """How many labels a column has."""
        return len(np.unique(self.columns[column]))


def rows(values: Any, situations: Sequence[str] = (ALL,), **labels: Any) -> Table:
    """The rows of a measure: ``values`` (E,) of episodes, or (E, S) of episodes and situations.

    Args:
        labels: column -> the text or the number in all rows, or (E,) numbers of the episodes.
    """
    values = np.asarray(values, float).reshape(-1, len(situations))  # (E, S)
    numbers = {"dataset": 0, "seed": 0, "episode": np.arange(len(values))}
    columns = {}
    names = {"situation": tuple(situations)}
    for column, label in {**numbers, **labels}.items():
        if isinstance(label, str):
            names[column] = (label,)
            label = 0
        column_values = np.broadcast_to(np.asarray(label, np.int32), len(values))
        columns[column] = np.repeat(column_values, len(situations))
    situation = np.arange(len(situations), dtype=np.int32)
    columns["situation"] = np.tile(situation, len(values))
    return Table(columns, names, values.ravel())


def join(tables: Iterable[Table]) -> Table:
    """The rows of tables with equal columns, one after another."""
    tables = [table for table in tables if len(table)]
    if not tables:
        return Table({}, {}, np.zeros(0))
    columns = {}
    names = {}
    for column in tables[0].columns:
        codes = [table.columns[column] for table in tables]
        if column in tables[0].names:
            # A label may have another index in each table.
            index: dict[str, int] = {}
            for number, table in enumerate(tables):
                renumbered = [index.setdefault(name, len(index)) for name in table.names[column]]
                codes[number] = np.array(renumbered, np.int32)[codes[number]]
            names[column] = tuple(index)
        columns[column] = np.concatenate(codes)
    return Table(columns, names, np.concatenate([table.value for table in tables]))


# ------------------------------------------------------------------ the same episodes


def averaged(table: Table, column: str, name: str) -> Table:
    """Means over all labels of a column, episode by episode, as the label ``name``."""
    first, values = _matched(table, column, table.levels(column))
    means = replace(first, value=np.mean(values, 0))
    return means.relabel(**{column: name})


def contrast(table: Table, one: str, other: str, column: str = "policy") -> Table:
    """``one - other`` in the same episodes, as the label "one-other" of a column."""
    first, (ours, theirs) = _matched(table, column, [one, other])
    differences = replace(first, value=ours - theirs)
    return differences.relabel(**{column: f"{one}-{other}"})


def _matched(table: Table, column: str, labels: Sequence[str]) -> tuple[Table, list[np.ndarray]]:
    """The rows of the first label with the units of all, and the values (N,) of each label in these rows.

    Raises:
        InputError: the labels have different rows.
    """
    tables = [table.where(**{column: label}) for label in labels]
    first, *others = tables
    for label, other in zip(labels[1:], others, strict=True):
        for name in first.columns.keys() - {column, *MATCHED}:
            if not np.array_equal(first.columns[name], other.columns[name]):
                raise InputError(f"table: {labels[0]} and {label} differ in column {name}; compare equal episodes.")

    # A policy that does not learn has dataset and seed 0; beside networks its episodes count as theirs.
    units = {}
    for name in MATCHED:
        units[name] = np.max([rows.columns[name] for rows in tables], axis=0)
    return replace(first, columns=first.columns | units), [rows.value for rows in tables]


# ------------------------------------------------------------------ estimates


@functools.lru_cache(maxsize=4)  # 160 MB each at most
def hierarchical(sizes: tuple[int, ...]) -> np.ndarray:
    """(R, E) weights of episodes: of groups where there are several (``hierarchical_resamples``), else of episodes."""
    if any(size > 1 for size in sizes[:-1]):
        return hierarchical_resamples(sizes)
    return resamples(sizes[-1])


def estimate(
    table: Table,
    by: Sequence[str],
    units: Sequence[str] = UNITS,
    *,
    per: Table | None = None,
    across: str | None = None,
    bounds: Mapping[str, tuple[float, float]] | tuple[float, float] = UNBOUNDED,
    draw: Draw = hierarchical,
) -> Estimates:
    """The mean over episodes, and its 95 % interval from a bootstrap over units, for all labels of the columns ``by``.

    Args:
        units: columns of the units, outermost first. The outermost level with several units is drawn.
        per: rows to divide by, a ratio of sums, with the same labels of ``by``.
        across: a column whose labels become the axis (K,) of each estimate.
        bounds: the least and the largest value that a figure can have, or measure -> these.
        draw: weights of the episodes in each resample.
    """
    estimates = {}
    draw = functools.cache(draw)
    divisors = None if per is None else per.groups(by)
    for labels, group in table.groups(by).items():
        values, sizes = group.matrix(across, units)
        if isinstance(bounds, Mapping):
            limits = bounds.get(group.label("measure", 0), UNBOUNDED)
        else:
            limits = bounds
        if divisors is None:
            estimates[labels] = aggregate(values, weights=draw(sizes), bounds=limits)
        else:
            divisor, _ = divisors[labels].matrix(across, units)
            estimates[labels] = aggregate_ratio(values, divisor, weights=draw(sizes), bounds=limits)
    return estimates


def samples(
    table: Table,
    by: Sequence[str],
    units: Sequence[str] = UNITS,
    *,
    across: str | None = None,
    draw: Draw = hierarchical,
) -> dict[Labels, np.ndarray]:
    """Means over episodes, and over the episodes of R resamples: labels -> (1 + R,) or (1 + R, K); as ``estimate``."""
    means = {}
    weights = functools.cache(lambda sizes: with_estimate(draw(sizes)))  # (1 + R, E)
    for labels, group in table.groups(by).items():
        values, sizes = group.matrix(across, units)
        means[labels] = weights(sizes) @ values
    return means

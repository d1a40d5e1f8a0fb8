"""The one loss of a calibration: how far measured rows are from their targets in targets.yaml."""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sean_jax.io import files

GROUPS: dict[str, dict[str, Any]] = files.read_yaml(Path(__file__).with_name("targets.yaml"))[1]  # pyright: ignore
ANY = "any"  # case of a group whose cases are the recordings at hand
WORST = 1e6  # loss of constants with which a measure is no number


class Target(NamedTuple):
    """What a row should be."""

    group: str
    target: float
    tolerance: float
    side: str  # both, most or least


def target_of(row: str) -> Target | None:
    """The target of a row; None if it has none."""
    for group, table in sorted(GROUPS.items(), key=lambda item: -len(item[0])):
        if row != group and not row.startswith(f"{group} "):
            continue
        targets = table["target"]
        if isinstance(targets, dict):
            cases = {_case(case): value for case, value in targets.items()}
            value = cases.get(row[len(group) :].strip(), cases.get(ANY))
        else:
            value = targets if row == group else None
        if value is not None:
            tolerance = table.get("tolerance", 0.0) or table["share"] * value
            return Target(group, float(value), float(tolerance), table.get("side", "both"))
    return None


def misses(rows: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """How far rows (L,) are from their targets, in tolerances; 0 on the right side of a one-sided one."""
    return {row: _miss(target, values) for row, target, values in _aimed(rows)}


def total(rows: Mapping[str, np.ndarray], without: Collection[str] = ()) -> np.ndarray:
    """The loss (L,) of rows (L,) of L candidates, without some rows."""
    groups: dict[str, list[np.ndarray]] = {}
    for row, target, values in _aimed(rows):
        if row not in without:
            groups.setdefault(target.group, []).append(np.sqrt(1.0 + _miss(target, values) ** 2) - 1.0)
    loss = sum(GROUPS[group]["weight"] * np.mean(parts, axis=0) for group, parts in groups.items())
    return np.where(np.isfinite(loss), loss, WORST)


def _aimed(rows: Mapping[str, np.ndarray]) -> Iterator[tuple[str, Target, np.ndarray]]:
    for row, values in rows.items():
        if (target := target_of(row)) is not None:
            yield row, target, np.asarray(values, float)


def _miss(target: Target, values: np.ndarray) -> np.ndarray:
    miss = (values - target.target) / target.tolerance
    if target.side == "both":
        return miss
    return np.maximum(miss, 0.0) if target.side == "most" else np.minimum(miss, 0.0)


def _case(case: Any) -> str:
    return case if isinstance(case, str) else f"{case:g}"

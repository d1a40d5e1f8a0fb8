"""Trajectory files as arrays: people walking (ETH/UCY, Juelich, any CSV) and people in conversation.

All are CSV with a header line and one line for each person and frame: the number of the frame, the person, metres.
"""

import csv
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import files
from sean_jax.base import Array

NAMES = {  # what a column may be called
    "frame": ("frame",),
    "person": ("ped_id", "id", "person"),
    "x": ("x_m", "x"),
    "y": ("y_m", "y"),
    "facing": ("theta_rad",),
    "group": ("group_id",),
}
OPTIONAL = ("facing", "group")


@struct.dataclass
class Tracks:
    """A recording of N people at T times. Who is not there has the position (0, 0) and is not present."""

    position: Array  # (T, N, 2) m
    facing: Array  # (T, N, 2) unit vector of the head or body; (1, 0) where the file does not tell
    group: Array  # (T, N) int32 column of the first member of the person's group, -1 none or not told
    present: Array  # (T, N) bool
    person: Array  # (N,) int32 the file's number of each person, ascending
    frame: Array  # (T,) int32 the file's number of each frame, or the nearest to it
    time_step: float = struct.field(pytree_node=False)  # s between rows


def read_csv(path: str | Path, seconds: float = 1.0) -> Tracks:
    """A recording with the columns frame, id (or ped_id), x, y (or x_m, y_m), in metres.

    Rows are as far apart as a person's lines mostly are in the file. Lines between rows go to the nearest one.

    Args:
        path: of the file.
        seconds: that pass while the frame number rises by one.

    Raises:
        files.FileError: one sentence that names the file, its line or column, and the cure.
    """
    table, lines = _table(Path(path))
    return _arrange(Path(path), table, lines, seconds)


def read_eth_ucy(path: str | Path) -> Tracks:
    """ETH (Pellegrini et al. 2009) and UCY (Lerner et al. 2007) as CSV: a person has a line every 0.4 s.

    In ETH some people's lines lie between those of others; they are moved by up to half a row. Raises FileError.
    """
    table, lines = _table(Path(path))
    return _arrange(Path(path), table, lines, 0.4 / _usual_step(table))


def read_juelich(path: str | Path) -> Tracks:
    """Corridor experiments of Forschungszentrum Juelich (HERMES 2009) as CSV: frames are 1/16 s. Raises FileError."""
    return read_csv(path, 1 / 16)


def read_groups(path: str | Path, seconds: float = 1.0) -> Tracks:
    """Annotated conversations (Cocktail Party, Coffee Break): also facing (theta_rad) and group_id, -1 alone.

    ``seconds`` lie between annotated frames (Cocktail Party: 5). Raises FileError.
    """
    table, lines = _table(Path(path))
    for name in OPTIONAL:
        if name not in table:
            raise files.FileError(f"{files.shown(Path(path))}: has no column {NAMES[name][0]}, which groups need.")
    return _arrange(Path(path), table, lines, seconds)


READERS = {"csv": read_csv, "eth_ucy": read_eth_ucy, "juelich": read_juelich, "groups": read_groups}
"""name of a format -> path -> Tracks"""


def _table(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns by our names, and the line of the file that each row comes from."""
    if not path.is_file():
        raise files.FileError(f"{path}: there is no such file; give a CSV file of recorded people.")
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    header = [name.strip() for name in rows[0]] if rows else []
    places = {}
    for ours, theirs in NAMES.items():
        found = [header.index(name) for name in theirs if name in header]
        if found:
            places[ours] = found[0]
        elif ours not in OPTIONAL:
            raise files.FileError(
                f"{files.shown(path)}:1: has no column {' or '.join(theirs)}; the first line names the columns."
            )
    numbers, lines = [], []
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        try:
            numbers.append([float(row[place]) for place in places.values()])
        except (ValueError, IndexError):
            raise files.FileError(f"{files.shown(path)}:{line}: is not a line of numbers: {','.join(row)}") from None
        if not np.isfinite(numbers[-1]).all():
            raise files.FileError(f"{files.shown(path)}:{line}: holds a number that is not finite; leave the line out.")
        lines.append(line)
    if not numbers:
        raise files.FileError(f"{files.shown(path)}: holds no line besides the names of its columns.")
    return dict(zip(places, np.array(numbers).T, strict=True)), np.array(lines)


def _usual_step(table: dict[str, np.ndarray]) -> float:
    """By how much the frame number mostly rises from a person's line to their next."""
    order = np.lexsort((table["frame"], table["person"]))
    frame, person = table["frame"][order], table["person"][order]
    steps = np.diff(frame)[np.diff(person) == 0]
    steps = steps[steps > 0]
    if not len(steps):
        return 1.0
    values, counts = np.unique(steps, return_counts=True)
    return float(values[counts.argmax()])


def _arrange(path: Path, table: dict[str, np.ndarray], lines: np.ndarray, seconds: float) -> Tracks:
    step, first = _usual_step(table), table["frame"].min()
    row = np.floor((table["frame"] - first) / step + 0.5).astype(int)
    person, column = np.unique(table["person"], return_inverse=True)
    shape = (row.max() + 1, len(person))
    present = np.zeros(shape, bool)
    order = np.lexsort((column, row))
    same = (np.diff(row[order]) == 0) & (np.diff(column[order]) == 0)
    if same.any():
        line = lines[order[1:][same][0]]
        raise files.FileError(
            f"{files.shown(path)}:{line}: the person is already there in this frame; keep one of the lines."
        )
    present[row, column] = True
    position, facing = np.zeros((*shape, 2), np.float32), np.zeros((*shape, 2), np.float32)
    position[row, column] = np.stack([table["x"], table["y"]], -1)
    facing[..., 0] = 1.0
    if "facing" in table:
        facing[row, column] = np.stack([np.cos(table["facing"]), np.sin(table["facing"])], -1)
    group = np.full(shape, -1, np.int32)
    if "group" in table:
        told = np.full(shape, -1, int)
        told[row, column] = table["group"]
        for t, labels in enumerate(told):
            for label in np.unique(labels[labels >= 0]):
                members = np.flatnonzero(labels == label)
                group[t, members] = members[0]
    return Tracks(
        position=jnp.asarray(position),
        facing=jnp.asarray(facing),
        group=jnp.asarray(group),
        present=jnp.asarray(present),
        person=jnp.asarray(person.astype(np.int32)),
        frame=jnp.asarray((first + step * np.arange(shape[0])).astype(np.int32)),
        time_step=float(seconds * step),
    )

"""Trajectory files as arrays: people walking (ETH/UCY, Juelich, any CSV) and people in conversation.

``lines`` reads them; here their lines become rows at even times.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import files
from sean_jax.base import Array
from sean_jax.quantities import LONGEST, check
from sean_jax.recordings import lines
from sean_jax.recordings.lines import Lines

MOST_CELLS = 10_000_000  # of times and people


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
    return _arrange(lines.read(path, "csv", 1.0 / check("seconds", seconds, 1e-4, LONGEST, "s")))


def read_eth_ucy(path: str | Path) -> Tracks:
    """ETH (Pellegrini et al. 2009) and UCY (Lerner et al. 2007) as CSV: a person has a line every 0.4 s.

    In ETH some people's lines lie between those of others; they are moved by up to half a row. Raises FileError.
    """
    return _arrange(lines.read(path, "eth_ucy"))


def read_juelich(path: str | Path) -> Tracks:
    """Corridor experiments of Forschungszentrum Juelich (HERMES 2009) as CSV: frames are 1/16 s. Raises FileError."""
    return _arrange(lines.read(path, "juelich"))


def read_groups(path: str | Path, seconds: float = 1.0) -> Tracks:
    """Annotated conversations (Cocktail Party, Coffee Break): also facing (theta_rad) and group_id, -1 alone.

    ``seconds`` lie between annotated frames (Cocktail Party: 5). Raises FileError.
    """
    found = lines.read(path, "groups", 1.0 / check("seconds", seconds, 1e-4, LONGEST, "s"))
    for name in ("facing", "group"):
        if name not in found.values:
            column = lines.NAMES[name][0]
            raise files.FileError(f"{files.shown(Path(path))}: has no column {column}, which groups need.")
    return _arrange(found)


READERS = {"csv": read_csv, "eth_ucy": read_eth_ucy, "juelich": read_juelich, "groups": read_groups}
"""name of a format -> path -> Tracks"""


def _arrange(found: Lines) -> Tracks:
    path, table, person, seconds = found.path, found.values, found.person, found.seconds
    step, first = found.usual_step, table["frame"].min()
    times = float(np.ceil((table["frame"].max() - first) / step)) + 1
    if times * len(found.number) > MOST_CELLS:
        cells = f"{times:,.0f} times of {len(found.number):,} people are more than {MOST_CELLS:,} places"
        raise files.FileError(f"{files.shown(path)}: {cells}; cut the recording.")
    row = np.floor((table["frame"] - first) / step + 0.5).astype(int)
    column, shape = person, (row.max() + 1, len(found.number))
    present = np.zeros(shape, bool)
    order = np.lexsort((column, row))
    same = (np.diff(row[order]) == 0) & (np.diff(column[order]) == 0)
    if same.any():
        line = found.line[order[1:][same][0]]
        raise files.FileError(
            f"{files.shown(path)}:{line}: the person is already there in this frame; keep one of the lines."
        )
    present[row, column] = True
    position, facing = np.zeros((*shape, 2)), np.zeros((*shape, 2))
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
        person=jnp.asarray(found.number),
        frame=jnp.asarray((first + step * np.arange(shape[0])).astype(np.int32)),
        time_step=float(seconds * step),
    )

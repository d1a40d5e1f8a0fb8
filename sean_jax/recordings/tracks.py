"""Recorded people as arrays at even times: people walking (ETH/UCY, Juelich, any CSV) and people in conversation.

``lines`` reads a file. Here its lines become rows: as far apart as in the file, or sampled at another time step, as
playback needs them (section IV-D).
"""

import heapq
import math
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array
from sean_jax.errors import FileError
from sean_jax.files import short_name
from sean_jax.quantities import MAX_DURATION, MAX_PEOPLE, check_number
from sean_jax.recordings import lines
from sean_jax.recordings.lines import LONGEST_GAP, ROUNDING, Lines

MAX_CELLS = 10_000_000  # of times and people
MAX_MOMENTS = 5_000_000  # of all people together, sampled at another time step
MAX_STEPS = 1_000_000  # from the first moment to the last, likewise


class Walk(NamedTuple):
    """Somebody who is there from one row on, for some rows."""

    begin: int  # the first row
    places: np.ndarray  # (K, 2) m, in that row and those that follow
    person: int  # the file's number


@struct.dataclass
class Tracks:
    """A recording at T times. A column is one person, or in a sampled recording several people one after the other."""

    position: Float[Array, "T N 2"]  # m; of who is absent (0, 0), or where somebody was or will be
    facing: Float[Array, "T N 2"]  # unit vector of the head or body; (1, 0) where it is not known
    group: Int[Array, "T N"]  # column of the first member of the person's group, -1 none or not known
    present: Bool[Array, "T N"]
    person: Int[Array, "T N"]  # the file's number of each person, -1 of who is absent
    frame: Int[Array, "T"]  # the file's number of each frame, or the nearest to it
    time_step: float = struct.field(pytree_node=False)  # s between rows


def read(
    path: str | Path,
    recording_format: str | None = None,
    frame_rate: float | None = None,
    time_step: float | None = None,
) -> Tracks:
    """The recording in a CSV file.

    With a ``time_step``, positions are interpolated linearly. Nobody is there before their first line, after their last
    one, or in between for more than 2 s without any. Facing and groups are not sampled. The arrays are numpy's, in 64
    bits, and a column serves one person after the other, so that there are as few columns as people at once.

    Args:
        recording_format: a key of ``READERS``; recognised if None, where the file has velocities as ETH and UCY do.
        frame_rate: frames a second; that of the format if None.
        time_step: s between rows; as far apart as a person's lines mostly are in the file if None.

    Raises:
        FileError: one sentence that names the file, its line or column, and the cure.
    """
    recorded = lines.read(path, recording_format, frame_rate)
    return _arrange(recorded) if time_step is None else _sampled(recorded, time_step)


def read_csv(path: str | Path, seconds: float = 1.0) -> Tracks:
    """A recording with the columns frame, id (or ped_id), x, y (or x_m, y_m), in metres.

    Lines between rows go to the nearest row.

    Args:
        seconds: s that pass while the frame number rises by one.

    Raises:
        FileError: one sentence that names the file, its line or column, and the cure.
    """
    return read(path, "csv", 1.0 / check_number("seconds", seconds, 1e-4, MAX_DURATION, "s"))


def read_eth_ucy(path: str | Path) -> Tracks:
    """ETH (Pellegrini et al. 2009) and UCY (Lerner et al. 2007) as CSV: a person has a line every 0.4 s.

    In ETH some people's lines lie between those of others; they are moved by up to half a row.

    Raises:
        FileError: one sentence that names the file, its line or column, and the cure.
    """
    return read(path, "eth_ucy")


def read_juelich(path: str | Path) -> Tracks:
    """Corridor experiments of Forschungszentrum Juelich (HERMES 2009) as CSV: frames are 1/16 s.

    Raises:
        FileError: one sentence that names the file, its line or column, and the cure.
    """
    return read(path, "juelich")


def read_groups(path: str | Path, seconds: float = 1.0) -> Tracks:
    """Annotated conversations (Cocktail Party, Coffee Break), also with facing (theta_rad) and group_id, -1 alone.

    Args:
        seconds: s between annotated frames (Cocktail Party: 5).

    Raises:
        FileError: one sentence that names the file, its line or column, and the cure.
    """
    recorded = lines.read(path, "groups", 1.0 / check_number("seconds", seconds, 1e-4, MAX_DURATION, "s"))
    for name in ("facing", "group"):
        if name not in recorded.values:
            column = lines.NAMES[name][0]
            raise FileError(f"{short_name(Path(path))}: has no column {column}, which groups need.")
    return _arrange(recorded)


READERS = {"csv": read_csv, "eth_ucy": read_eth_ucy, "juelich": read_juelich, "groups": read_groups}
"""name of a format -> path -> Tracks"""


def _arrange(recorded: Lines) -> Tracks:
    """Rows as far apart as the lines are in the file, one column a person."""
    path, table, person, seconds = recorded.path, recorded.values, recorded.person, recorded.seconds
    step, first = recorded.usual_step, table["frame"].min()
    times = float(np.ceil((table["frame"].max() - first) / step)) + 1
    if times * len(recorded.number) > MAX_CELLS:
        cells = f"{times:,.0f} times of {len(recorded.number):,} people are more than {MAX_CELLS:,} places"
        raise FileError(f"{short_name(path)}: {cells}; cut the recording.")
    row = np.floor((table["frame"] - first) / step + 0.5).astype(int)
    column, shape = person, (row.max() + 1, len(recorded.number))
    present = np.zeros(shape, bool)
    order = np.lexsort((column, row))
    same = (np.diff(row[order]) == 0) & (np.diff(column[order]) == 0)
    if same.any():
        line = recorded.line[order[1:][same][0]]
        raise FileError(f"{short_name(path)}:{line}: the person is already there in this frame; keep one of the lines.")
    present[row, column] = True
    position, facing = np.zeros((*shape, 2)), np.zeros((*shape, 2))
    position[row, column] = np.stack([table["x"], table["y"]], -1)
    facing[..., 0] = 1.0
    if "facing" in table:
        facing[row, column] = np.stack([np.cos(table["facing"]), np.sin(table["facing"])], -1)
    group = np.full(shape, -1, np.int32)
    if "group" in table:
        label_of = np.full(shape, -1, int)
        label_of[row, column] = table["group"]
        for t, labels in enumerate(label_of):
            for label in np.unique(labels[labels >= 0]):
                members = np.flatnonzero(labels == label)
                group[t, members] = members[0]
    return Tracks(
        position=jnp.asarray(position),
        facing=jnp.asarray(facing),
        group=jnp.asarray(group),
        present=jnp.asarray(present),
        person=jnp.asarray(np.where(present, recorded.number, -1).astype(np.int32)),
        frame=jnp.asarray((first + step * np.arange(shape[0])).astype(np.int32)),
        time_step=float(seconds * step),
    )


def _sampled(recorded: Lines, time_step: float) -> Tracks:
    """Rows ``time_step`` apart, with as few columns as there are people at once."""
    path = recorded.path
    stretches = _stretches(recorded)
    first = min(stretch[0, 0] for _, stretch in stretches)
    moments = sum(stretch[-1, 0] - stretch[0, 0] for _, stretch in stretches) / time_step
    if moments > MAX_MOMENTS or (max(stretch[-1, 0] for _, stretch in stretches) - first) / time_step > MAX_STEPS:
        raise FileError(f"{short_name(path)}: is too long to be played in steps of {time_step:g} s; cut the recording.")
    walks = [walk for person, stretch in stretches if (walk := _sample(person, stretch, first, time_step)) is not None]
    if not walks:
        rate = f"{1.0 / recorded.seconds:g} frames a second"
        raise FileError(
            f"{short_name(path)}: nobody is there for two control steps of {time_step:g} s; is frame_rate {rate} right?"
        )
    columns = _columns(sorted(walks, key=lambda walk: walk.begin), path)
    times = max(walk.begin + len(walk.places) for walk in walks)
    if times * len(columns) > MAX_MOMENTS:
        size = f"{times:,} steps with up to {len(columns):,} people at once"
        raise FileError(f"{short_name(path)}: {size} are too much to be played; cut the recording.")
    shape = times, len(columns)
    position, present = np.zeros((*shape, 2)), np.zeros(shape, bool)
    person = np.full(shape, -1, np.int32)
    for n, column in enumerate(columns):
        before = 0
        for begin, places, number in column:
            end = begin + len(places)
            position[before:begin, n], position[begin:end, n] = places[0], places
            present[begin:end, n], person[begin:end, n] = True, number
            before = end
        position[before:, n] = position[before - 1, n]
    frame = np.rint((first + time_step * np.arange(times)) / recorded.seconds)
    arrays: dict[str, Any] = dict(
        position=position,
        facing=np.broadcast_to(np.array([1.0, 0.0]), (*shape, 2)),
        group=np.broadcast_to(np.int32(-1), shape),
        present=present,
        person=person,
        frame=frame.astype(np.int32),
    )
    return Tracks(**arrays, time_step=time_step)


def _stretches(recorded: Lines) -> list[tuple[int, np.ndarray]]:
    """For each stretch in which a person is there: the file's number of the person, and (K, 3) time [s], x, y [m]."""
    order = np.lexsort((recorded.values["frame"], recorded.person))
    frame, x, y = (recorded.values[name][order] for name in ("frame", "x", "y"))
    away = np.diff(frame) * recorded.seconds > LONGEST_GAP + ROUNDING
    ends = np.flatnonzero(away | (np.diff(recorded.person[order]) != 0)) + 1
    numbers = recorded.number[recorded.person[order]][np.concatenate([[0], ends])]
    stretches = np.split(np.stack([frame * recorded.seconds, x, y], -1), ends)
    return list(zip(numbers.tolist(), stretches, strict=True))


def _sample(person: int, stretch: np.ndarray, first: float, time_step: float) -> Walk | None:
    """A stretch as a walk, in rows that are counted from the time ``first`` on; None if it has one row or none."""
    begin = math.ceil((stretch[0, 0] - first) / time_step - 1e-6)
    end = math.floor((stretch[-1, 0] - first) / time_step + 1e-6)
    if end <= begin:
        return None
    time = first + np.arange(begin, end + 1) * time_step
    return Walk(begin, np.stack([np.interp(time, stretch[:, 0], stretch[:, k]) for k in (1, 2)], -1), person)


def _columns(walks: list[Walk], path: Path) -> list[list[Walk]]:
    """The walks of each column: in order of their begin, each in the first column that has been free for a row."""
    columns: list[list[Walk]] = []
    busy: list[tuple[int, int]] = []  # heap of (the row after a column's last walk, column)
    free: list[int] = []  # heap of columns
    for walk in walks:
        while busy and busy[0][0] < walk.begin:
            heapq.heappush(free, heapq.heappop(busy)[1])
        if not free:
            if len(columns) == MAX_PEOPLE:
                raise FileError(
                    f"{short_name(path)}: more than {MAX_PEOPLE:,} people are there at once; cut the recording."
                )
            free.append(len(columns))
            columns.append([])
        column = heapq.heappop(free)
        columns[column].append(walk)
        heapq.heappush(busy, (walk.begin + len(walk.places), column))
    return columns

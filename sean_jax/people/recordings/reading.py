"""Recordings of people as arrays at even times: people walking (ETH/UCY, Juelich, any CSV) and in conversation.

The header of a CSV file names its columns, in any order and case: the number of the frame, the person, x and y in
metres, and if known a velocity, a facing angle, and the group. Each format has its own clock: ETH counts 6 and UCY 10
frames in the 0.4 s between a person's lines, Juelich has 16 frames per second. Lines become rows as far apart
as in the file, or sampled at another time step, as playback needs them (section IV-D).
"""

import csv
import dataclasses
import heapq
import io
import math
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.bounds import MAX_COORDINATE, MAX_DURATION, MAX_PEOPLE, check_number, parse_digits
from sean_jax.core.data_types import Array
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.messages import shorten
from sean_jax.io.files import file_error, read_text, short_name, unknown_name

NAMES = {  # the names that a column may have; the first one present counts
    "frame": ("frame",),
    "person": ("ped_id", "id", "person"),
    "x": ("x_m", "x"),
    "y": ("y_m", "y"),
    "vx": ("vx_mps",),
    "vy": ("vy_mps",),
    "facing": ("theta_rad",),
    "group": ("group_id",),
}
NEEDED = ("frame", "person", "x", "y")
MAX_BYTES = 60_000_000
MAX_LINES = 1_000_000
MAX_FRAME = 2**31 - 1
ROUNDING = 1e-9  # s, of times that are a frame number times the seconds of a frame
LONGEST_GAP = 2.0  # s: a person without lines for longer has left and entered again
MAX_MEAN_SPEED = 2.0  # m/s: walking people are slower on average; known recordings have 0.5 to 1.4
MAX_SPEED = 20.0  # m/s: nobody runs as fast
CLOCK_TOLERANCE = 0.25  # share by which a clock may differ from the velocities in a file
USUAL_SPEED = 1.3  # m/s
ETH_STEP = 0.4  # s, between a person's lines in ETH and UCY
JUELICH_RATE = 16.0  # frames per second
FORMATS = ("csv", "eth_ucy", "juelich", "groups")
MAX_CELLS = 10_000_000  # of times and people
MAX_MOMENTS = 5_000_000  # of all people together, sampled at another time step
MAX_STEPS = 1_000_000  # from the first moment to the last, likewise


class RecordedWalk(NamedTuple):
    """A person's positions in consecutive rows."""

    begin: int  # the first row
    places: np.ndarray  # (K, 2) m, in this row and the following rows
    person: int  # the file's number


@struct.dataclass
class Tracks:
    """A recording at T times. A column is one person, or in a sampled recording several people one after the other."""

    position: Float[Array, "T N 2"]  # m; of absent people (0, 0), or their last or next position
    facing: Float[Array, "T N 2"]  # unit vector of the head or body; (1, 0) where it is not known
    group: Int[Array, "T N"]  # column of the first member of the person's group, -1 none or not known
    present: Bool[Array, "T N"]
    person: Int[Array, "T N"]  # the file's number of each person, -1 if absent
    frame: Int[Array, "T"]  # the file's number of each frame, or the nearest to it
    time_step: float = struct.field(pytree_node=False)  # s between rows


def read(
    path: str | Path,
    recording_format: str | None = None,
    frame_rate: float | None = None,
    time_step: float | None = None,
) -> Tracks:
    """The recording in a CSV file.

    With a ``time_step`` [s], positions are interpolated linearly. Nobody is present before the first line, after the
    last one, or in a gap of more than 2 s. Facing and groups are not sampled. The arrays are numpy's, in 64 bits, and
    columns serve one person after the other, so there are as few columns as people at once.

    Args:
        recording_format: one of ``FORMATS``; None: eth_ucy for a file with velocities, else frame_rate is needed.
        frame_rate: frames per second; the format's if None.
        time_step: s between rows; as far apart as a person's lines usually are if None.

    Raises:
        FileError: one sentence that names the file, its line or column, and the cure.
    """
    recorded = read_lines(path, recording_format, frame_rate)
    return _arrange(recorded) if time_step is None else _sampled(recorded, time_step)


def read_companions(path: str | Path, tracks: Tracks) -> Int[np.ndarray, " N"]:
    """(N,) int32 annotated walking groups, as ETH and UCY have them: column of a group's first member, -1 alone.

    Groups of section III stand in conversation; these walk.

    Args:
        path: a text file with a line for each group: the file's numbers of its people, with space between them. Lines
            that share a person are one group.

    Raises:
        FileError: one sentence that names the file, the line and the cure.
    """
    column = {int(number): k for k, number in enumerate(np.asarray(tracks.person).max(0))}
    group = np.full(len(column), -1, np.int32)
    for line, text in enumerate(read_text(Path(path)).splitlines(), 1):
        members = []
        for word in text.split():
            if (number := parse_digits(word)) not in column:
                text = f"{word[:40]!r} is the number of nobody in the recording; give a line of people for each group"
                raise file_error(path, text, line)
            members.append(column[number])
        if members:
            groups = group[members]
            together = np.isin(group, groups[groups >= 0])  # with whom a line before has joined them
            together[members] = True
            group[together] = np.flatnonzero(together)[0]
    alone = np.bincount(group[group >= 0], minlength=len(group)) < 2
    return np.where((group >= 0) & alone[group], -1, group).astype(np.int32)


# ------------------------------------------------------------------ lines of a file


@dataclasses.dataclass(frozen=True)
class Lines:
    """R lines of a recording of P people, in the order of the file."""

    path: Path
    values: dict[str, np.ndarray]  # of "frame", "x", "y" and the other columns of the file: (R,) float64
    person: np.ndarray  # (R,) int, from 0 to P - 1
    number: np.ndarray  # (P,) int32 the file's number of each person; of names that are no numbers, their order
    line: np.ndarray  # (R,) int, in the file
    seconds: float  # that pass while the frame number rises by one

    @property
    def usual_step(self) -> float:
        """Usual increase of the frame number from a person's line to their next one."""
        return _usual_step(self.values["frame"], self.person)


def read_lines(path: str | Path, recording_format: str | None = None, frame_rate: float | None = None) -> Lines:
    """The lines of a CSV file, with the clock of its format; arguments as in ``read``.

    Raises:
        FileError: one sentence that names the file, its line or column, the value and the cure, also where people
            would walk faster than anybody does, because the clock is wrong.
    """
    path = Path(path)
    values, names, line = _read_columns(path)
    index_of = {name: index for index, name in enumerate(sorted(set(names), key=_rank))}
    person = np.array([index_of[name] for name in names])

    # People keep their numbers, if all of them have one.
    are_numbers = all(_is_number(name) for name in index_of)
    numbers = [int(float(name)) for name in index_of] if are_numbers else list(index_of.values())
    number = np.array(numbers, np.int32)
    seconds = _seconds(path, values, person, recording_format, frame_rate)
    recorded = Lines(path, values, person, number, line, seconds)
    _check(recorded)
    return recorded


def column_names(path: str | Path) -> set[str]:
    """The keys of ``NAMES`` that a CSV file has; none if it is no recording. Raises FileError if it cannot be read."""
    first = read_text(Path(path), MAX_BYTES).partition("\n")[0]
    header = {name.strip().strip('"').lower() for name in first.split(",")}
    return {ours for ours, theirs in NAMES.items() if header & set(theirs)}


def check_clock(recording_format: str | None, frame_rate: float | None) -> None:
    """Raise InputError for an unknown format, or a frame rate with which nobody records; None passes."""
    if frame_rate is not None:
        check_number("frame_rate", frame_rate, 0.001, 1e4, "frames a second")
    if recording_format is not None and recording_format not in FORMATS:
        raise InputError(unknown_name("recording_format", recording_format, FORMATS))


def _read_columns(path: Path) -> tuple[dict[str, np.ndarray], list[str], np.ndarray]:
    """Columns by the keys of ``NAMES``, the person of each row, and its line in the file."""
    reader = csv.reader(io.StringIO(read_text(path, MAX_BYTES), newline=""), strict=True)
    rows, names, lines = [], [], []
    try:
        header = [name.strip().lower() for name in next(reader, [])]
        index = _column_indices(path, header)
        person_index = index.pop("person")
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if len(rows) == MAX_LINES:
                raise file_error(
                    path, f"is beyond the {MAX_LINES:,} lines that are read; cut the file", reader.line_num
                )
            try:
                rows.append([float(row[k]) for k in index.values()])
                names.append(_plain(row[person_index].strip()))
            except (ValueError, IndexError):
                text = f"is no line of a person and numbers: {shorten(','.join(row), 80)!r}; mend it"
                raise file_error(path, text, reader.line_num) from None
            lines.append(reader.line_num)
    except csv.Error as error:
        raise file_error(path, f"is not CSV: {error}", reader.line_num) from None
    if not rows:
        raise file_error(path, "holds no line besides the names of its columns")

    columns = dict(zip(index, np.array(rows, float).T, strict=True))
    line = np.array(lines)
    for name, column in columns.items():
        _check_column(path, name, header[index[name]], column, line)
    for name, name_line in zip(names, line, strict=True):
        if not name or (_is_number(name) and abs(float(name)) > MAX_FRAME):
            raise file_error(path, f"the person is {name[:40]!r}; give a name or a whole number", name_line)
    return columns, names, line


def _column_indices(path: Path, header: list[str]) -> dict[str, int]:
    """The index of each column, by the keys of ``NAMES``."""
    index = {}
    for name, spellings in NAMES.items():
        matches = [header.index(spelling) for spelling in spellings if spelling in header]
        if matches:
            index[name] = matches[0]
        elif name in NEEDED:
            columns = ", ".join(column[:40] for column in header[:12]) or "nothing"
            needed = " or ".join(spellings)
            raise file_error(path, f"has no column {needed} but {columns}; the first line names the columns", 1)
    return index


def _check_column(path: Path, name: str, title: str, column: np.ndarray, line: np.ndarray) -> None:
    """Refuse numbers that are not finite, or too large for their column."""
    limit = {"frame": MAX_FRAME, "x": MAX_COORDINATE, "y": MAX_COORDINATE, "group": MAX_FRAME}.get(name, 1e3)
    wrong = np.flatnonzero(~(np.abs(column) <= limit))
    if len(wrong) == 0:
        return
    value = column[wrong[0]]
    if not np.isfinite(value):
        raise file_error(path, f"{title} is {value:g}, which is not finite; leave the line out", line[wrong[0]])
    raise file_error(path, f"{title} is {value:g}, which is beyond {limit:,.0f}; leave the line out", line[wrong[0]])


def _is_number(name: str) -> bool:
    try:
        return float(name).is_integer()
    except ValueError:
        return False


def _plain(name: str) -> str:
    """A whole number always in the same digits, so that 1 and 1.0 are one person; other names as they are."""
    return str(int(float(name))) if _is_number(name) and abs(float(name)) <= MAX_FRAME else name


def _rank(name: str) -> tuple[bool, float, str]:
    """Numbers in their order, then words in theirs."""
    return (False, float(name), name) if _is_number(name) else (True, 0.0, name)


def _usual_step(frame: np.ndarray, person: np.ndarray) -> float:
    order = np.lexsort((frame, person))
    steps = np.diff(frame[order])[np.diff(person[order]) == 0]
    steps = steps[steps > 0]
    if not len(steps):
        return 1.0
    values, counts = np.unique(steps, return_counts=True)
    return float(values[counts.argmax()])


def _seconds(
    path: Path, values: dict, person: np.ndarray, recording_format: str | None, frame_rate: float | None
) -> float:
    """Seconds from one frame number to the next."""
    if frame_rate is not None:
        return 1.0 / frame_rate
    if recording_format is None and "vx" in values and "vy" in values:
        recording_format = "eth_ucy"
    if recording_format == "eth_ucy":
        return ETH_STEP / _usual_step(values["frame"], person)
    if recording_format == "juelich":
        return 1.0 / JUELICH_RATE
    if recording_format == "groups":
        return 1.0
    raise file_error(
        path,
        "does not tell how many frames a second it has; give frame_rate, or recording_format if it is eth_ucy or "
        "juelich",
    )


def _check(recorded: Lines) -> None:
    """Refuse people in two places at once, and impossible speeds."""
    path = recorded.path
    frame = recorded.values["frame"]
    span = (frame.max() - frame.min()) * recorded.seconds
    if span > 7 * MAX_DURATION:
        outlier = np.argmax(np.abs(frame - np.median(frame)))
        raise file_error(path, f"the frame is {span:.3g} s from others; leave the line out", recorded.line[outlier])

    # Steps from a line to the person's next one: its index, duration [s] and length [m].
    order = np.lexsort((frame, recorded.person))
    same_person = np.diff(recorded.person[order]) == 0
    next_line = order[1:][same_person]
    time = np.diff(frame[order])[same_person] * recorded.seconds
    twice = np.flatnonzero(time <= 0)
    if len(twice):
        index = next_line[twice[0]]
        text = f"the person is already there in frame {frame[index]:g}; keep one of the lines"
        raise file_error(path, text, recorded.line[index])
    distance = np.hypot(*(np.diff(recorded.values[name][order])[same_person] for name in ("x", "y")))

    present = time <= LONGEST_GAP + ROUNDING
    _check_rate(recorded, order, same_person, present, time, distance)
    jumps = np.flatnonzero(present & (distance > MAX_SPEED * time))
    if len(jumps):
        jump = jumps[0]
        raise file_error(
            path,
            f"the person is {distance[jump]:,.1f} m from where they were {time[jump]:.2g} s before; leave the line out "
            "or look at frame_rate",
            recorded.line[next_line[jump]],
        )


def _check_rate(
    recorded: Lines,
    order: np.ndarray,
    same_person: np.ndarray,
    present: np.ndarray,
    time: np.ndarray,
    distance: np.ndarray,
) -> None:
    """Refuse a clock with which people walk at other speeds than the file has, or as nobody does."""
    path = recorded.path
    rate = 1.0 / recorded.seconds
    speed = distance[present].sum() / max(time[present].sum(), 1e-9)
    if "vx" in recorded.values and "vy" in recorded.values:
        in_file = np.hypot(recorded.values["vx"], recorded.values["vy"])[order]
        in_file = 0.5 * (in_file[1:] + in_file[:-1])[same_person]  # m/s, between a person's lines
        expected = (in_file * time)[present].sum()  # m
        share = distance[present].sum() / max(expected, 1e-9)
        if expected > 1.0 and abs(share - 1.0) > CLOCK_TOLERANCE:
            raise file_error(
                path,
                f"with {_clock_text(recorded)} people walk at {share:.2f} times their vx_mps and vy_mps; by these "
                f"there are {rate / share:.3g} a second",
            )
    if speed > MAX_MEAN_SPEED:
        raise file_error(
            path,
            f"with {_clock_text(recorded)} people walk at {speed:.2f} m/s, and nobody does; look at frame_rate: with "
            f"{rate * USUAL_SPEED / speed:.2g} a second they walk at {USUAL_SPEED:g} m/s",
        )


def _clock_text(recorded: Lines) -> str:
    """The clock with its unit, such as 25 frames a second, or 1.5 s a frame."""
    rate = 1.0 / recorded.seconds
    return f"{rate:g} frames a second" if rate >= 1 else f"{recorded.seconds:g} s a frame"


# ------------------------------------------------------------------ lines as rows


def _arrange(recorded: Lines) -> Tracks:
    """Rows as far apart as the lines in the file, one column a person."""
    # Frames count a camera's pictures, of which only some have lines: rows are the usual step apart.
    path, values = recorded.path, recorded.values
    step = recorded.usual_step
    first = values["frame"].min()
    times = float(np.ceil((values["frame"].max() - first) / step)) + 1
    if times * len(recorded.number) > MAX_CELLS:
        raise file_error(
            path,
            f"{times:,.0f} times of {len(recorded.number):,} people are more than {MAX_CELLS:,} places; cut the "
            "recording",
        )

    # Lines may be some frames off the rows, so each goes to the nearest one.
    row = np.floor((values["frame"] - first) / step + 0.5).astype(int)  # of each line
    column = recorded.person
    _check_rows(recorded, row)

    # Absent people are at the origin and look along x: finite numbers, which derivatives survive.
    shape = row.max() + 1, len(recorded.number)
    present = np.zeros(shape, bool)
    present[row, column] = True
    position = np.zeros((*shape, 2))
    position[row, column] = np.stack([values["x"], values["y"]], -1)
    facing = np.zeros((*shape, 2))
    facing[..., 0] = 1.0
    if "facing" in values:
        facing[row, column] = np.stack([np.cos(values["facing"]), np.sin(values["facing"])], -1)

    # Labels of groups may change from row to row, columns do not.
    group = np.full(shape, -1, np.int32)
    if "group" in values:
        label = np.full(shape, -1, int)
        label[row, column] = values["group"]
        group = _groups_by_first_member(label)

    # The file's own numbers of people and frames stay, so that a finding leads back to its lines.
    return Tracks(
        position=jnp.asarray(position),
        facing=jnp.asarray(facing),
        group=jnp.asarray(group),
        present=jnp.asarray(present),
        person=jnp.asarray(np.where(present, recorded.number, -1).astype(np.int32)),
        frame=jnp.asarray((first + step * np.arange(shape[0])).astype(np.int32)),
        time_step=float(recorded.seconds * step),
    )


def _check_rows(recorded: Lines, row: np.ndarray) -> None:
    """Refuse people with two lines in one row."""
    column = recorded.person
    order = np.lexsort((column, row))
    same = (np.diff(row[order]) == 0) & (np.diff(column[order]) == 0)
    if same.any():
        line = recorded.line[order[1:][same][0]]
        raise file_error(recorded.path, "the person is already there in this frame; keep one of the lines", line)


def _groups_by_first_member(label: Int[np.ndarray, "T N"]) -> Int[np.ndarray, "T N"]:
    """The column of the first member of each person's group in that row; -1 without a label (-1)."""
    group = np.full(label.shape, -1, np.int32)
    for t, labels in enumerate(label):
        for value in np.unique(labels[labels >= 0]):
            members = np.flatnonzero(labels == value)
            group[t, members] = members[0]
    return group


def _sampled(recorded: Lines, time_step: float) -> Tracks:
    """Rows ``time_step`` apart, with as few columns as people at once."""
    path = recorded.path

    # Rows begin with the first line of all.
    stretches = _stretches(recorded)
    begins = [stretch[0, 0] for _, stretch in stretches]
    ends = [stretch[-1, 0] for _, stretch in stretches]

    # The limits hold before arrays exist: with a wrong frame_rate a recording may last for days.
    first = min(begins)
    moments = sum(end - begin for begin, end in zip(begins, ends, strict=True)) / time_step
    if moments > MAX_MOMENTS or (max(ends) - first) / time_step > MAX_STEPS:
        raise file_error(path, f"is too long to be played in steps of {time_step:g} s; cut the recording")

    # A walk of one row has no velocity. People share columns, or there would be one for everybody ever there.
    samples = [_sample(person, stretch, first, time_step) for person, stretch in stretches]
    walks = [walk for walk in samples if walk is not None]
    if not walks:
        raise FileError(
            f"{short_name(path)}: nobody is there for two control steps of {time_step:g} s; is frame_rate "
            f"{1.0 / recorded.seconds:g} frames a second right?"
        )

    # Columns are filled in the order of arrival, which needs no more of them than people at once.
    columns = _columns(sorted(walks, key=lambda walk: walk.begin), path)
    times = max(walk.begin + len(walk.places) for walk in walks)
    if times * len(columns) > MAX_MOMENTS:
        raise file_error(
            path,
            f"{times:,} steps with up to {len(columns):,} people at once are too much to be played; cut the recording",
        )

    # Facing and groups are not sampled.
    position, present, person = _fill_columns(columns, times)
    frame = np.rint((first + time_step * np.arange(times)) / recorded.seconds).astype(np.int32)
    facing: Any = np.broadcast_to(np.array([1.0, 0.0]), position.shape)
    group: Any = np.broadcast_to(np.int32(-1), present.shape)
    return Tracks(position, facing, group, present, person, frame, time_step)  # pyright: ignore[reportArgumentType]


def _fill_columns(columns: list[list[RecordedWalk]], times: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (T, N, 2) [m], presence and person (T, N); an absent person waits where the next walk begins."""
    shape = times, len(columns)
    position = np.zeros((*shape, 2))
    present = np.zeros(shape, bool)
    person = np.full(shape, -1, np.int32)
    for n, walks in enumerate(columns):
        before = 0
        for begin, places, number in walks:
            end = begin + len(places)
            position[before:begin, n] = places[0]
            position[begin:end, n] = places
            present[begin:end, n] = True
            person[begin:end, n] = number
            before = end
        position[before:, n] = position[before - 1, n]
    return position, present, person


def _stretches(recorded: Lines) -> list[tuple[int, np.ndarray]]:
    """For each stretch in which a person is present: the file's number of the person, and (K, 3) time [s], x, y [m]."""
    order = np.lexsort((recorded.values["frame"], recorded.person))
    frame, x, y = (recorded.values[name][order] for name in ("frame", "x", "y"))
    person = recorded.person[order]
    was_away = np.diff(frame) * recorded.seconds > LONGEST_GAP + ROUNDING
    begins = np.flatnonzero(was_away | (np.diff(person) != 0)) + 1
    numbers = recorded.number[person][np.concatenate([[0], begins])]
    stretches = np.split(np.stack([frame * recorded.seconds, x, y], -1), begins)
    return list(zip(numbers.tolist(), stretches, strict=True))


def _sample(person: int, stretch: np.ndarray, first: float, time_step: float) -> RecordedWalk | None:
    """A stretch as a walk, in rows counted from the time ``first``; None if it has fewer than two rows."""
    begin = math.ceil((stretch[0, 0] - first) / time_step - 1e-6)
    end = math.floor((stretch[-1, 0] - first) / time_step + 1e-6)
    if end <= begin:
        return None
    time = first + np.arange(begin, end + 1) * time_step
    x, y = (np.interp(time, stretch[:, 0], stretch[:, k]) for k in (1, 2))
    return RecordedWalk(begin, np.stack([x, y], -1), person)


def _columns(walks: list[RecordedWalk], path: Path) -> list[list[RecordedWalk]]:
    """The walks of each column: in order of their begin, each in the first column that has been free for a row."""
    columns: list[list[RecordedWalk]] = []
    busy: list[tuple[int, int]] = []  # heap of (the row after a column's last walk, column)
    free: list[int] = []  # heap of columns
    for walk in walks:
        while busy and busy[0][0] < walk.begin:
            heapq.heappush(free, heapq.heappop(busy)[1])
        if not free:
            if len(columns) == MAX_PEOPLE:
                raise file_error(path, f"more than {MAX_PEOPLE:,} people are there at once; cut the recording")
            free.append(len(columns))
            columns.append([])
        column = heapq.heappop(free)
        columns[column].append(walk)
        heapq.heappush(busy, (walk.begin + len(walk.places), column))
    return columns

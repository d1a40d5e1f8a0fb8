"""The lines of a recording and its clock: CSV of people walking, as playback, classifiers and metrics all read it.

A header line names the columns, in any order and case: the number of the frame, the person, x and y in metres, and if
known a velocity, where the person faces, and their group. The frame numbers of a format have a clock of their own:
ETH counts 6 and UCY 10 in the 0.4 s between a person's lines, Juelich counts sixteenths of a second.
"""

import csv
import dataclasses
import io
from pathlib import Path

import numpy as np

from sean_jax.errors import FileError, InputError
from sean_jax.files import read_text, short_name, unknown_name
from sean_jax.quantities import MAX_COORDINATE, MAX_DURATION, check_number

NAMES = {  # what a column may be called; the first that is there counts
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
LONGEST_GAP = 2.0  # s: who is not seen for longer has left and entered again
MAX_MEAN_SPEED = 2.0  # m/s: people who walk are slower on average; known recordings have 0.5 to 1.4
MAX_SPEED = 20.0  # m/s: nobody runs as fast
CLOCK_TOLERANCE = 0.25  # share by which a clock may differ from the velocities in a file
USUAL_SPEED = 1.3  # m/s
ETH_STEP = 0.4  # s, between a person's lines in ETH and UCY
JUELICH_RATE = 16.0  # frames a second
FORMATS = ("csv", "eth_ucy", "juelich", "groups")


@dataclasses.dataclass(frozen=True)
class Lines:
    """R lines of a recording of P people, in the order of the file."""

    path: Path
    values: dict[str, np.ndarray]  # of "frame", "x", "y" and whatever else the file has: (R,) float64
    person: np.ndarray  # (R,) int, from 0 to P - 1
    number: np.ndarray  # (P,) int32 the file's number of each person; of names that are no numbers, their order
    line: np.ndarray  # (R,) int, in the file
    seconds: float  # that pass while the frame number rises by one

    @property
    def usual_step(self) -> float:
        """By how much the frame number mostly rises from a person's line to their next."""
        return _usual_step(self.values["frame"], self.person)


def read(path: str | Path, recording_format: str | None = None, frame_rate: float | None = None) -> Lines:
    """The lines of a CSV file, with the clock of its format.

    Args:
        recording_format: one of ``FORMATS``; recognised if None, where the file has velocities as ETH and UCY do.
        frame_rate: frames a second; that of the format if None.

    Raises:
        FileError: one sentence that names the file, its line or column, the value and the cure, also where people
            would walk faster than anybody does, because the clock is another one.
    """
    path = Path(path)
    values, names, line = _table(path)
    order = {name: k for k, name in enumerate(sorted(set(names), key=_rank))}
    person = np.array([order[name] for name in names])
    whole = all(_is_number(name) for name in order)
    number = np.array([int(float(name)) if whole else k for name, k in order.items()], np.int32)
    seconds = _seconds(path, values, person, recording_format, frame_rate)
    recorded = Lines(path, values, person, number, line, seconds)
    _check(recorded)
    return recorded


def columns(path: str | Path) -> set[str]:
    """Which columns of a recording a CSV file has, by our names: the keys of ``NAMES``.

    Returns:
        Names; none if it is no recording.

    Raises:
        FileError: the file cannot be read.
    """
    first = read_text(Path(path), MAX_BYTES).partition("\n")[0]
    header = {name.strip().strip('"').lower() for name in first.split(",")}
    return {ours for ours, theirs in NAMES.items() if header & set(theirs)}


def check_clock(recording_format: str | None, frame_rate: float | None) -> None:
    """Refuse a format that does not exist, or a frame rate with which nobody records.

    Args:
        recording_format: one of ``FORMATS``, or None.
        frame_rate: frames a second, or None.

    Raises:
        InputError: names the option and its limits.
    """
    if frame_rate is not None:
        check_number("frame_rate", frame_rate, 0.001, 1e4, "frames a second")
    if recording_format is not None and recording_format not in FORMATS:
        raise InputError(unknown_name("recording_format", recording_format, FORMATS))


def _table(path: Path) -> tuple[dict[str, np.ndarray], list[str], np.ndarray]:
    """Columns by our names, the person of each row, and the line of the file that it comes from."""
    reader = csv.reader(io.StringIO(read_text(path, MAX_BYTES), newline=""), strict=True)
    places: dict[str, int] = {}
    rows, names, lines = [], [], []
    try:
        header = [name.strip().lower() for name in next(reader, [])]
        for ours, theirs in NAMES.items():
            matches = [header.index(name) for name in theirs if name in header]
            if matches:
                places[ours] = matches[0]
            elif ours in NEEDED:
                there = ", ".join(name[:40] for name in header[:12]) or "nothing"
                which = " or ".join(theirs)
                raise FileError(
                    f"{short_name(path)}:1: has no column {which} but {there}; the first line names the columns."
                )
        who = places.pop("person")
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if len(rows) == MAX_LINES:
                what = f"is beyond the {MAX_LINES:,} lines that are read"
                raise FileError(f"{short_name(path)}:{reader.line_num}: {what}; cut the file.")
            try:
                rows.append([float(row[place]) for place in places.values()])
                names.append(_plain(row[who].strip()))
            except (ValueError, IndexError):
                content = ",".join(row)
                content = content if len(content) <= 80 else content[:77] + "..."
                raise FileError(
                    f"{short_name(path)}:{reader.line_num}: is no line of a person and numbers: {content!r}; mend it."
                ) from None
            lines.append(reader.line_num)
    except csv.Error as error:
        raise FileError(f"{short_name(path)}:{reader.line_num}: is not CSV: {error}.") from None
    if not rows:
        raise FileError(f"{short_name(path)}: holds no line besides the names of its columns.")
    table, line = np.array(rows, float).T, np.array(lines)
    columns = dict(zip(places, table, strict=True))
    for name, column in columns.items():
        limit = {"frame": MAX_FRAME, "x": MAX_COORDINATE, "y": MAX_COORDINATE, "group": MAX_FRAME}.get(name, 1e3)
        wrong = np.flatnonzero(~(np.abs(column) <= limit))
        if len(wrong):
            where, value = f"{short_name(path)}:{line[wrong[0]]}", column[wrong[0]]
            fault = "not finite" if not np.isfinite(value) else f"beyond {limit:,.0f}"
            raise FileError(f"{where}: {header[places[name]]} is {value:g}, which is {fault}; leave the line out.")
    for name, where in zip(names, line, strict=True):
        if not name or (_is_number(name) and abs(float(name)) > MAX_FRAME):
            raise FileError(f"{short_name(path)}:{where}: the person is {name[:40]!r}; give a name or a whole number.")
    return columns, names, line


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
    """That pass while the frame number rises by one."""
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
    cure = "give frame_rate, or recording_format if it is eth_ucy or juelich"
    raise FileError(f"{short_name(path)}: does not tell how many frames a second it has; {cure}.")


def _check(recorded: Lines) -> None:
    """People are at one place at a time, and as fast as people are."""
    path, frame, person = recorded.path, recorded.values["frame"], recorded.person
    span = (frame.max() - frame.min()) * recorded.seconds
    if span > 7 * MAX_DURATION:
        at = recorded.line[np.argmax(np.abs(frame - np.median(frame)))]
        raise FileError(f"{short_name(path)}:{at}: the frame is {span:.3g} s from others; leave the line out.")
    order = np.lexsort((frame, person))
    own = np.diff(person[order]) == 0
    time = np.diff(frame[order])[own] * recorded.seconds
    twice = np.flatnonzero(time <= 0)
    if len(twice):
        at = order[1:][own][twice[0]]
        what = f"the person is already there in frame {frame[at]:g}"
        raise FileError(f"{short_name(path)}:{recorded.line[at]}: {what}; keep one of the lines.")
    way = np.hypot(*(np.diff(recorded.values[name][order])[own] for name in ("x", "y")))
    present = time <= LONGEST_GAP + ROUNDING
    in_file = _speeds_in_file(recorded, order, own)
    rate = 1.0 / recorded.seconds
    speed = way[present].sum() / max(time[present].sum(), 1e-9)
    ours = f"{rate:g} frames a second" if rate >= 1 else f"{recorded.seconds:g} s a frame"
    if in_file is not None:
        share = way[present].sum() / max((in_file * time)[present].sum(), 1e-9)
        moving = (in_file * time)[present].sum() > 1.0  # m
        if moving and abs(share - 1.0) > CLOCK_TOLERANCE:
            cure = f"by these there are {rate / share:.3g} a second"
            raise FileError(
                f"{short_name(path)}: with {ours} people walk at {share:.2f} times their vx_mps and vy_mps; {cure}."
            )
    if speed > MAX_MEAN_SPEED:
        cure = f"look at frame_rate: with {rate * USUAL_SPEED / speed:.2g} a second they walk at {USUAL_SPEED:g} m/s"
        raise FileError(f"{short_name(path)}: with {ours} people walk at {speed:.2f} m/s, and nobody does; {cure}.")
    jumps = np.flatnonzero(present & (way > MAX_SPEED * time))
    if len(jumps):
        at = order[1:][own][jumps[0]]
        what = f"the person is {way[jumps[0]]:,.1f} m from where they were {time[jumps[0]]:.2g} s before"
        raise FileError(f"{short_name(path)}:{recorded.line[at]}: {what}; leave the line out or look at frame_rate.")


def _speeds_in_file(recorded: Lines, order: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """Speeds [m/s] between a person's lines by the velocities in the file, if there are any."""
    if "vx" not in recorded.values or "vy" not in recorded.values:
        return None
    speed = np.hypot(recorded.values["vx"], recorded.values["vy"])[order]
    return 0.5 * (speed[1:] + speed[:-1])[own]

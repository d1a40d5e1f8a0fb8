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

from sean_jax.files import FileError, shown, suggest, text
from sean_jax.quantities import FARTHEST, LONGEST, check

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
MOST_BYTES = 60_000_000
MOST_LINES = 1_000_000
MOST_FRAME = 2**31 - 1
ROUNDING = 1e-9  # s, of times that are a frame number times the seconds of a frame
LONGEST_GAP = 2.0  # s: who is not seen for longer has left and entered again
WALKING = 2.0  # m/s: people who walk are slower on average; the recordings that we know have 0.5 to 1.4
FASTEST = 20.0  # m/s: nobody runs as fast
AGREE = 0.25  # share by which a clock may differ from the velocities that a file tells
USUAL = 1.3  # m/s
EVERY = 0.4  # s, between a person's lines in ETH and UCY
JUELICH = 16.0  # frames a second
FORMATS = ("csv", "eth_ucy", "juelich", "groups")


@dataclasses.dataclass(frozen=True)
class Lines:
    """R lines of a recording of P people, in the order of the file."""

    path: Path
    values: dict[str, np.ndarray]  # of "frame", "x", "y" and whatever else the file tells: (R,) float64
    person: np.ndarray  # (R,) int, from 0 to P - 1
    number: np.ndarray  # (P,) int32 the file's number of each person; of names that are no numbers, their order
    line: np.ndarray  # (R,) int, in the file
    seconds: float  # that pass while the frame number rises by one

    @property
    def usual_step(self) -> float:
        """By how much the frame number mostly rises from a person's line to their next."""
        return _usual_step(self.values["frame"], self.person)


def read(path: str | Path, kind: str | None = None, frame_rate: float | None = None) -> Lines:
    """The lines of a CSV file, with the clock of its format.

    Args:
        path: of the file.
        kind: one of ``FORMATS``; recognised if None, where the file tells velocities as ETH and UCY do.
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
    seconds = _seconds(path, values, person, kind, frame_rate)
    found = Lines(path, values, person, number, line, seconds)
    _check(found)
    return found


def check_clock(kind: str | None, frame_rate: float | None) -> None:
    """ValueError if there is no such format, or if nobody records with so many frames a second."""
    if frame_rate is not None:
        check("frame_rate", frame_rate, 0.001, 1e4, "frames a second")
    if kind is not None and kind not in FORMATS:
        cure = suggest(kind, FORMATS) or "."
        raise ValueError(f"recording_format: '{kind}' is not one of {', '.join(FORMATS)}{cure}")


def _table(path: Path) -> tuple[dict[str, np.ndarray], list[str], np.ndarray]:
    """Columns by our names, the person of each row, and the line of the file that it comes from."""
    reader = csv.reader(io.StringIO(text(path, MOST_BYTES), newline=""), strict=True)
    places: dict[str, int] = {}
    rows, names, lines = [], [], []
    try:
        header = [name.strip().lower() for name in next(reader, [])]
        for ours, theirs in NAMES.items():
            found = [header.index(name) for name in theirs if name in header]
            if found:
                places[ours] = found[0]
            elif ours in NEEDED:
                there = ", ".join(name[:40] for name in header[:12]) or "nothing"
                which = " or ".join(theirs)
                raise FileError(
                    f"{shown(path)}:1: has no column {which} but {there}; the first line names the columns."
                )
        who = places.pop("person")
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if len(rows) == MOST_LINES:
                raise FileError(
                    f"{shown(path)}:{reader.line_num}: is beyond the {MOST_LINES:,} lines that are read; cut the file."
                )
            try:
                rows.append([float(row[place]) for place in places.values()])
                names.append(_plain(row[who].strip()))
            except (ValueError, IndexError):
                said = ",".join(row)
                said = said if len(said) <= 80 else said[:77] + "..."
                raise FileError(
                    f"{shown(path)}:{reader.line_num}: is no line of a person and numbers: {said!r}; mend it."
                ) from None
            lines.append(reader.line_num)
    except csv.Error as error:
        raise FileError(f"{shown(path)}:{reader.line_num}: is not CSV: {error}.") from None
    if not rows:
        raise FileError(f"{shown(path)}: holds no line besides the names of its columns.")
    table, line = np.array(rows, float).T, np.array(lines)
    columns = dict(zip(places, table, strict=True))
    for name, column in columns.items():
        most = {"frame": MOST_FRAME, "x": FARTHEST, "y": FARTHEST, "group": MOST_FRAME}.get(name, 1e3)
        wrong = np.flatnonzero(~(np.abs(column) <= most))
        if len(wrong):
            where, value = f"{shown(path)}:{line[wrong[0]]}", column[wrong[0]]
            least = "not finite" if not np.isfinite(value) else f"beyond {most:,.0f}"
            raise FileError(f"{where}: {header[places[name]]} is {value:g}, which is {least}; leave the line out.")
    for name, where in zip(names, line, strict=True):
        if not name or (_is_number(name) and abs(float(name)) > MOST_FRAME):
            raise FileError(f"{shown(path)}:{where}: the person is {name[:40]!r}; give a name or a whole number.")
    return columns, names, line


def _is_number(name: str) -> bool:
    try:
        return float(name).is_integer()
    except ValueError:
        return False


def _plain(name: str) -> str:
    """A whole number always in the same digits, so that 1 and 1.0 are one person; other names as they are."""
    return str(int(float(name))) if _is_number(name) and abs(float(name)) <= MOST_FRAME else name


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


def _seconds(path: Path, values: dict, person: np.ndarray, kind: str | None, frame_rate: float | None) -> float:
    """That pass while the frame number rises by one."""
    if frame_rate is not None:
        return 1.0 / frame_rate
    if kind is None and "vx" in values and "vy" in values:
        kind = "eth_ucy"
    if kind == "eth_ucy":
        return EVERY / _usual_step(values["frame"], person)
    if kind == "juelich":
        return 1.0 / JUELICH
    if kind == "groups":
        return 1.0
    cure = "give frame_rate, or recording_format if it is eth_ucy or juelich"
    raise FileError(f"{shown(path)}: does not tell how many frames a second it has; {cure}.")


def _check(found: Lines) -> None:
    """People are at one place at a time, and as fast as people are."""
    path, frame, person = found.path, found.values["frame"], found.person
    span = (frame.max() - frame.min()) * found.seconds
    if span > 7 * LONGEST:
        at = found.line[np.argmax(np.abs(frame - np.median(frame)))]
        raise FileError(f"{shown(path)}:{at}: the frame is {span:.3g} s from others; leave the line out.")
    order = np.lexsort((frame, person))
    own = np.diff(person[order]) == 0
    time = np.diff(frame[order])[own] * found.seconds
    twice = np.flatnonzero(time <= 0)
    if len(twice):
        at = order[1:][own][twice[0]]
        what = f"the person is already there in frame {frame[at]:g}"
        raise FileError(f"{shown(path)}:{found.line[at]}: {what}; keep one of the lines.")
    way = np.hypot(*(np.diff(found.values[name][order])[own] for name in ("x", "y")))
    seen = time <= LONGEST_GAP + ROUNDING
    told = _told(found, order, own)
    rate = 1.0 / found.seconds
    speed = way[seen].sum() / max(time[seen].sum(), 1e-9)
    ours = f"{rate:g} frames a second" if rate >= 1 else f"{found.seconds:g} s a frame"
    if told is not None:
        share = way[seen].sum() / max((told * time)[seen].sum(), 1e-9)
        moving = (told * time)[seen].sum() > 1.0  # m
        if moving and abs(share - 1.0) > AGREE:
            cure = f"by these there are {rate / share:.3g} a second"
            raise FileError(
                f"{shown(path)}: with {ours} people walk at {share:.2f} times their vx_mps and vy_mps; {cure}."
            )
    if speed > WALKING:
        cure = f"look at frame_rate: with {rate * USUAL / speed:.2g} a second they walk at {USUAL:g} m/s"
        raise FileError(f"{shown(path)}: with {ours} people walk at {speed:.2f} m/s, and nobody does; {cure}.")
    jumps = np.flatnonzero(seen & (way > FASTEST * time))
    if len(jumps):
        at = order[1:][own][jumps[0]]
        what = f"the person is {way[jumps[0]]:,.1f} m from where they were {time[jumps[0]]:.2g} s before"
        raise FileError(f"{shown(path)}:{found.line[at]}: {what}; leave the line out or look at frame_rate.")


def _told(found: Lines, order: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """Speeds [m/s] between a person's lines by the velocities that the file tells, if it does."""
    if "vx" not in found.values or "vy" not in found.values:
        return None
    speed = np.hypot(found.values["vx"], found.values["vy"])[order]
    return 0.5 * (speed[1:] + speed[:-1])[own]

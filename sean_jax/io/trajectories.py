"""Trajectories in files that other programs read: tables as CSV or Parquet.

A table has a row for each frame of the robot and of each person present, for pandas, PedPy or a database; ``COLUMNS``
says what they hold. A ``TrajectoryWriter`` adds episode after episode, one in memory at a time.
"""

import contextlib
import itertools
import json
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, BinaryIO, NamedTuple

import jax
import numpy as np
import pydantic

from sean_jax.core.bounds import MAX_COORDINATE, MAX_DURATION, MAX_PEOPLE
from sean_jax.core.data_types import Trajectory
from sean_jax.core.errors import FileError, InputError
from sean_jax.io import files, writing

ROBOT = -1  # the robot's id; for those of people see ``_person_ids``
MAX_SPEED = 10_000.0  # m/s
COLUMNS: dict[str, str] = files.read_yaml(Path(__file__).with_suffix(".yaml"))[1]
"""Column of a table -> its meaning."""

OF_ROBOT = ("goal_x", "goal_y", "command_speed", "command_turn_rate", "active")
LEFT = "command_left"  # column of an omnidirectional robot
NUMBERS = ("episode", "frame", "id", "group")  # columns of whole numbers
SITUATION = "situation_"  # how the columns of situations begin
SUFFIXES = (".csv", ".parquet")
GROUP_ROWS = 2**18  # of a table, that Parquet stores together: episodes are gathered until they have as many
BLOCK_ROWS = 2**16  # of a table, that are read at once
MAX_ROWS = 10**8
KEY = "sean_jax"  # of the header
CURE = "give a file that save_trajectory has written"
LIMITS = {
    "frame": (0, 10**9),
    "episode": (0, 2**31 - 1),
    "time": (0.0, 10**9),
    "id": (ROBOT, 10**9 - 1),
    "group": (-1, MAX_PEOPLE),
    **{name: (-MAX_COORDINATE, MAX_COORDINATE) for name in ("x", "y", "goal_x", "goal_y")},
    **{name: (-MAX_SPEED, MAX_SPEED) for name in ("vx", "vy")},
}
"""Column -> minimum and maximum; commands are unlimited."""


class Header(pydantic.BaseModel):
    """The metadata of a file."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    time_step: Annotated[float, pydantic.Field(gt=0, le=MAX_DURATION, allow_inf_nan=False)]  # s
    situations: Annotated[tuple[str, ...], pydantic.Field(max_length=1_000)]
    people: Annotated[int, pydantic.Field(ge=0, le=MAX_PEOPLE)]  # of each episode

    def text(self) -> str:
        """As JSON, in one line."""
        return json.dumps(self.model_dump(mode="json"))


def save_trajectory(
    trajectory: Trajectory,
    path: Path | str,
    *,
    time_step: float = 0.1,
    situations: Sequence[str] | None = None,
) -> None:
    """Write the record of a rollout, without absent people: loaded, they are at (0, 0).

    Args:
        trajectory: (T, ...) frames of an episode, or (E, T, ...) of several. Headings are unit vectors or zero,
            positions within 10 km of the origin.
        path: a file that ends in ``.csv`` or ``.parquet`` (extra ``lerobot``).
        time_step: s, between two frames.
        situations: their names, as in the scenario; numbers if None.

    Raises:
        InputError: the path has another ending, names and situations differ in number, or a value is out of range.
        WriteError: another process writes the file.
    """
    path = Path(path)
    writer = _writer(path)
    arrays = {name: np.asarray(value) for name, value in vars(trajectory).items() if value is not None}
    if arrays["active"].ndim not in (1, 2):
        raise InputError(f"trajectory: frames with {arrays['active'].ndim} leading axes; give (T, ...) or (E, T, ...).")
    number = arrays["situations"].shape[-1]
    names = [f"{k}" for k in range(number)] if situations is None else list(situations)
    if len(names) != number:
        raise InputError(f"situations: {len(names)} names for {number} situations; give one name for each.")
    people = arrays["people"].shape[-2]
    header = files.check_json(path, {"time_step": time_step, "situations": names, "people": people}, Header)

    # A single episode has no column of its number.
    if arrays["active"].ndim == 2:
        table = _table(arrays, header)
    else:
        table = _table({name: value[None] for name, value in arrays.items()}, header)
        table.pop("episode")
    _check_rows(path, table, header, 1)

    with writing.atomic_file(path) as stream:
        file = writer(stream, header)
        file.write(table)
        file.close()


def load_trajectory(path: Path | str) -> Trajectory:
    """Read a file of ``save_trajectory`` (10 GB and 100 million rows at most): (T, ...) or (E, T, ...) numpy arrays.

    Raises:
        InputError: it is no such file, it is damaged, or a value is out of range (``COLUMNS``).
    """
    path = Path(path)
    header, blocks = _writer(path).read(path)
    parsed: list[dict[str, np.ndarray]] = []  # of each block
    rows = 0
    for columns in blocks:
        _check_columns(path, columns, header)
        _check_rows(path, columns, header, rows + 1)
        rows += len(columns["id"])
        if rows > MAX_ROWS:
            raise FileError(f"{files.short_name(path)}: has more than {MAX_ROWS:,} rows; save fewer episodes.")
        columns.pop("time")
        parsed.append({name: _as_stored(name, values) for name, values in columns.items()})
    if not rows:
        raise FileError(f"{files.short_name(path)}: holds no frame; {CURE}.")
    with files.sentence(path, "save fewer episodes"):
        table = {name: np.concatenate([block.pop(name) for block in parsed]) for name in [*parsed[0]]}
        return _trajectory(path, table, header)


def _as_stored(name: str, values: np.ndarray) -> np.ndarray:
    """A column in half the memory, or as whole numbers."""
    return values.astype(np.int64 if name in NUMBERS else np.float32)


def check_packages(suffix: str) -> None:
    """Raise InputError if the package of a format (one of ``SUFFIXES``) is missing."""
    if suffix == ".parquet":
        _arrow()


class TrajectoryWriter:
    """A file of many episodes that grows by one at a time; made by ``trajectory_writer``."""

    def __init__(self, file: "_Csv | _Parquet", header: Header, steps: int, episode: int):
        self._file = file
        self.header = header
        self.steps = steps
        self.episode = episode  # the number of the next one

    def add(self, trajectory: Trajectory) -> None:
        """Write the next episode, frames (T, ...); those after ``steps`` are left out."""
        arrays = {
            name: np.asarray(value)[None, : self.steps] for name, value in vars(trajectory).items() if value is not None
        }
        table = _table(arrays, self.header)
        table["episode"] = table["episode"] + self.episode
        self._file.write(table)
        self.episode += 1


@contextlib.contextmanager
def trajectory_writer(
    path: Path | str, *, time_step: float = 0.1, situations: Sequence[str], people: int, steps: int, first: int = 0
) -> Iterator[TrajectoryWriter]:
    """Write episodes one after another; the file is there when the block ends, and as before if anything is raised.

    Args:
        path: as in ``save_trajectory``.
        time_step: s, between two frames.
        people: N, of each episode.
        first: number of the first episode.

    Raises:
        InputError: the path has another ending, or a package is missing.
        WriteError: another process writes the file.
    """
    path = Path(path)
    writer = _writer(path)
    header = Header(time_step=time_step, situations=tuple(situations), people=people)
    with writing.atomic_file(path) as stream:
        file = writer(stream, header)
        yield TrajectoryWriter(file, header, steps, first)
        file.close()


def join_trajectories(parts: Sequence[Path], path: Path) -> None:
    """Write one file of several of the same format, with their episodes in order.

    Raises:
        WriteError: another process writes the file.
    """
    with writing.atomic_file(path) as stream:
        _writer(path).join(parts, stream)


def _writer(path: Path) -> "type[_Csv] | type[_Parquet]":
    """The writer of a file's format; InputError if there is none, or its package is missing."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: its name must end in {', '.join(SUFFIXES)}.")
    check_packages(path.suffix)
    return _Csv if path.suffix == ".csv" else _Parquet


# ------------------------------------------------------------------ arrays and columns


def _table(arrays: dict[str, np.ndarray], header: Header) -> dict[str, np.ndarray]:
    """Columns of all rows: for each frame the robot's row, then rows of the people present."""
    # A row for the robot, and then one for each person present, of each frame.
    episodes, steps = arrays["active"].shape
    in_table = np.concatenate([np.ones((episodes, steps, 1), bool), arrays["present"]], -1)  # (E, T, 1 + N)
    episode, frame, index = np.nonzero(in_table)  # (R,) each

    def rows(robot: np.ndarray, people: np.ndarray) -> np.ndarray:
        return np.concatenate([robot[:, :, None], people], 2)[in_table]

    columns = {"episode": episode, "frame": frame, "time": (frame + 1) * header.time_step}
    columns["id"] = rows(np.full((episodes, steps), ROBOT), _person_ids(arrays["present"]))
    columns["x"], columns["y"] = rows(arrays["position"], arrays["people"]).T
    columns["vx"], columns["vy"] = rows(arrays["velocity"], arrays["people_velocity"]).T
    columns["heading_x"], columns["heading_y"] = rows(arrays["heading"], arrays["people_heading"]).T
    columns["group"] = rows(np.full((episodes, steps), ROBOT), arrays["group"])

    # The other columns are empty in the rows of people.
    for name, values in _columns_of_robot(arrays, header).items():
        column = np.full(len(index), np.nan, np.float32)
        column[index == 0] = values.reshape(-1)
        columns[name] = column
    return columns


def _person_ids(present: np.ndarray) -> np.ndarray:
    """(E, T, N) ids: who comes in where somebody has left is another person, so each track has an id of its own.

    The people at the start have 0 to N - 1, the second in each place N to 2 N - 1, and so on.
    """
    people = present.shape[-1]
    before = np.concatenate([np.zeros_like(present[:, :1]), present[:, :-1]], 1)
    arrivals = np.cumsum(present & ~before, axis=1)
    return np.arange(people) + people * np.maximum(arrivals - 1, 0)


def _columns_of_robot(arrays: dict[str, np.ndarray], header: Header) -> dict[str, np.ndarray]:
    """Columns (E, T) of the robot's rows alone, in the order of a file."""
    goal = arrays["goal"]
    action = arrays["action"]  # ahead, turn; or ahead, left, turn
    columns = {
        "goal_x": goal[..., 0],
        "goal_y": goal[..., 1],
        "command_speed": action[..., 0],
        "command_turn_rate": action[..., -1],
        "active": arrays["active"],
    }
    if action.shape[-1] == 3:
        columns[LEFT] = action[..., 1]
    for number, name in enumerate(header.situations):
        columns[f"{SITUATION}{name}"] = arrays["situations"][..., number]
    return columns


def _check_columns(path: Path, names: Iterable[str], header: Header) -> None:
    """FileError unless these are the columns of a table, in any order."""
    columns = {*names}
    needed = [name for name in COLUMNS if name not in ("episode", "situation_NAME", LEFT)]
    needed += [f"{SITUATION}{name}" for name in header.situations]
    for name in needed:
        if name not in columns:
            raise FileError(f"{files.short_name(path)}: has no column {name}; {CURE}.")
    for name in sorted(columns - {*needed, "episode", LEFT}):
        raise FileError(f"{files.short_name(path)}: column {name[:60]!r} is not known; {CURE}.")


def _check_rows(path: Path, columns: dict[str, np.ndarray], header: Header, first: int) -> None:
    """FileError for a value out of its column's range; ``first`` is the number of the first row."""
    block = TableBlock(path, columns, first)
    robot = columns["id"] == ROBOT
    for name in columns:
        block.check_column(name, robot)

    # Columns that depend on each other.
    if header.people == 0:
        block.refuse(columns["id"] >= 0, "id", "is none of the 0 people")
    block.refuse(robot & (columns["group"] != ROBOT), "group", "stands in the row of the robot")
    size = np.hypot(columns["heading_x"], columns["heading_y"])
    block.refuse(~((np.abs(size - 1.0) < 1e-3) | (size == 0.0)), "heading_x", "belongs to no unit vector")
    time = (columns["frame"] + 1.0) * header.time_step
    block.refuse(~(np.abs(columns["time"] - time) <= 1e-6 * time), "time", "does not match its frame")


class TableBlock(NamedTuple):
    """Some rows of a file, which are checked."""

    path: Path
    columns: dict[str, np.ndarray]  # (R,) each
    first: int  # number of the first row

    def refuse(self, wrong: np.ndarray, name: str, rule: str) -> None:
        """FileError for the first wrong row, with its value in a column."""
        if wrong.any():
            index = int(wrong.argmax())
            row = self.first + index
            value = f"{self.columns[name][index]:.9g}".replace("nan", "nothing")
            raise FileError(f"{files.short_name(self.path)}: row {row}: {name}: {value} {rule}; {CURE}.")

    def check_column(self, name: str, robot: np.ndarray) -> None:
        """FileError for a value that a column cannot have; ``robot`` (R,) says which rows are the robot's."""
        values = self.columns[name]
        flag = name == "active" or name.startswith(SITUATION)
        if name in NUMBERS:
            self.refuse(~(values == np.floor(values)), name, "is no whole number")
        if name in (*OF_ROBOT, LEFT) or flag:
            self.refuse(~robot & ~np.isnan(values), name, "stands in the row of a person")
        if flag:
            self.refuse(robot & (values != 0) & (values != 1), name, "is not 0 or 1")
        elif name.startswith("command"):
            too_large = np.isfinite(values) & (np.abs(values) > np.finfo(np.float32).max)
            self.refuse(too_large, name, "is no number of 32 bits")
        elif name in LIMITS:
            low, high = LIMITS[name]
            outside = ~((low <= values) & (values <= high))
            if name in OF_ROBOT:  # which is empty in the rows of people
                outside &= robot
            self.refuse(outside, name, f"is not from {low:,} to {high:,}")


def _trajectory(path: Path, table: dict[str, np.ndarray], header: Header) -> Trajectory:
    """The arrays of all columns; FileError if rows are missing or double."""
    batched = "episode" in table
    frame = table["frame"]
    if not batched:
        table = {**table, "episode": np.zeros(len(frame), int)}
    shape = int(table["episode"].max()) + 1, int(frame.max()) + 1, header.people
    _check_size(path, len(frame), *shape)

    # Rows of the robot, and of people, whose place in the arrays follows from the id.
    is_robot = table["id"] == ROBOT
    robot = _rows(table, is_robot, ("episode", "frame"), shape[:2])
    persons = _rows_of_people(table, ~is_robot, shape)
    _check_frames(path, robot, persons)
    _check_ids(path, table["id"][~is_robot], persons)

    # Where there is no row, nobody is present.
    command = ("command_speed", *([LEFT] if LEFT in table else []), "command_turn_rate")
    group: Any = np.full(shape, -1, np.int32)
    group[persons.index] = table["group"][~is_robot]
    trajectory = Trajectory(
        position=robot.array("x", "y"),
        heading=robot.array("heading_x", "heading_y"),
        velocity=robot.array("vx", "vy"),
        action=robot.array(*command),
        people=persons.array("x", "y"),
        people_velocity=persons.array("vx", "vy"),
        people_heading=persons.array("heading_x", "heading_y"),
        group=group,
        present=persons.present(),
        goal=robot.array("goal_x", "goal_y"),
        situations=robot.array(*(f"{SITUATION}{name}" for name in header.situations)) > 0.5,
        active=robot.array("active")[..., 0] > 0.5,
    )
    return trajectory if batched else jax.tree.map(lambda leaf: leaf[0], trajectory)


def _check_size(path: Path, rows: int, episodes: int, steps: int, people: int) -> None:
    """FileError if the arrays of a few rows would take much memory."""
    if episodes * steps * (people + 1) > max(3_000_000, 1_000 * rows):
        raise FileError(
            f"{files.short_name(path)}: {rows:,} rows are too few for {episodes:,} episodes of {steps:,} frames with "
            f"{people:,} people; {CURE}."
        )


def _check_frames(path: Path, robot: "TableRows", persons: "TableRows") -> None:
    """FileError if the robot is missing in a frame, or a person is in it twice."""
    count = len(robot.mask)
    driven = robot.present()  # (E, T)
    gaps = driven[:, 1:] & ~driven[:, :-1]
    if not driven[:, 0].all() or gaps.any() or not driven[persons.index[:2]].all():
        raise FileError(
            f"{files.short_name(path)}: {count:,} rows lack one of the robot in a frame of an episode; {CURE}."
        )
    if driven.sum() + persons.present().sum() < count:
        raise FileError(f"{files.short_name(path)}: {count:,} rows have a person twice in a frame; {CURE}.")


def _check_ids(path: Path, ids: np.ndarray, persons: "TableRows") -> None:
    """FileError for an id that nobody has in its frame."""
    people = persons.shape[-1]
    wanted = _person_ids(persons.present())[persons.index]
    wrong = (ids != wanted) & (ids >= people)
    if wrong.any():
        row = int(wrong.argmax())
        raise FileError(
            f"{files.short_name(path)}: frame {persons.index[1][row]}: id: {ids[row]} is none of the {people} people, "
            f"nor of those who have come in since; {CURE}."
        )


class TableRows(NamedTuple):
    """Rows of a table, of the robot or of people, which become arrays with axes of episodes, frames and people."""

    table: dict[str, np.ndarray]
    mask: np.ndarray  # of these rows
    index: tuple[np.ndarray, ...]  # of each row in the arrays
    shape: tuple[int, ...]

    def present(self) -> Any:
        """A bool array of the places that have a row."""
        present = np.zeros(self.shape, bool)
        present[self.index] = True
        return present

    def array(self, *names: str) -> Any:
        """(..., K) float32 values of columns; 0 where there is no row."""
        values = np.zeros((*self.shape, len(names)), np.float32)
        for k, name in enumerate(names):
            values[(*self.index, k)] = self.table[name][self.mask]
        return values


def _rows_of_people(table: dict[str, np.ndarray], mask: np.ndarray, shape: tuple[int, ...]) -> TableRows:
    """Rows of people, whose place in the arrays follows from the id: see ``_person_ids``."""
    place = table["id"] % max(shape[-1], 1)
    return _rows({**table, "place": place}, mask, ("episode", "frame", "place"), shape)


def _rows(table: dict[str, np.ndarray], mask: np.ndarray, axes: Sequence[str], shape: tuple[int, ...]) -> TableRows:
    """Some rows of a table, whose places in the arrays are in the columns ``axes``."""
    return TableRows(table, mask, tuple(table[name][mask] for name in axes), shape)


# ------------------------------------------------------------------ CSV


class _Csv:
    """Rows as text, after a line with the header and a line with the names of the columns."""

    def __init__(self, stream: BinaryIO, header: Header):
        self._stream = stream
        self._head = f"# {KEY} {header.text()}"

    def write(self, table: dict[str, np.ndarray]) -> None:
        lines = [self._head, ",".join(table)] if self._head else []
        self._head = ""
        lines += [",".join(row) for row in zip(*map(_texts, table.values()), strict=True)]
        self._stream.write(("\n".join(lines) + "\n").encode("utf-8"))

    def close(self) -> None:
        pass

    @staticmethod
    def join(parts: Sequence[Path], stream: BinaryIO) -> None:
        for number, part in enumerate(parts):
            with part.open("rb") as rows:
                if number:  # only the first part keeps its header and its line of names
                    rows.readline()
                    rows.readline()
                shutil.copyfileobj(rows, stream)

    @staticmethod
    def read(path: Path) -> tuple[Header, Iterator[dict[str, np.ndarray]]]:
        rows = files.read_rows(path)
        first = next(rows, [""])
        names = next(rows, [])
        if not first[0].startswith(f"# {KEY} "):
            raise FileError(f"{files.short_name(path)}: does not begin with '# {KEY} '; {CURE}.")

        def blocks() -> Iterator[dict[str, np.ndarray]]:
            first_row = 1
            while block := list(itertools.islice(rows, BLOCK_ROWS)):
                numbers = np.array([_numbers(path, number, row) for number, row in enumerate(block, first_row)])
                first_row += len(block)
                yield dict(zip(names, numbers.T, strict=True))

        return _header(path, first[0][len(KEY) + 3 :]), blocks()


def _texts(values: np.ndarray) -> list[str]:
    """As few digits as distinguish a number from all others; nothing for NaN."""
    if values.dtype.kind in "iub":
        return [str(int(value)) for value in values]
    return ["" if value != value else np.format_float_positional(value, trim="-") for value in values]


def _numbers(path: Path, number: int, row: list[str]) -> list[float]:
    values = []
    for cell in row:
        try:
            values.append(float(cell.replace("_", "no")) if cell else np.nan)  # Python allows "_" in numbers
        except ValueError:
            raise FileError(f"{files.short_name(path)}: row {number}: {cell[:40]!r} is no number; {CURE}.") from None
    return values


def _header(path: Path, text: str | bytes) -> Header:
    try:
        content = files.parse_json(text)
    except ValueError as error:
        raise FileError(f"{files.short_name(path)}: its header is damaged: {error}; {CURE}.") from None
    return files.check_json(path, content, Header)


# ------------------------------------------------------------------ Parquet


class _Parquet:
    """Groups of rows, written as soon as they have ``GROUP_ROWS``; the header is metadata of the schema."""

    def __init__(self, stream: BinaryIO, header: Header):
        self._stream = stream
        self._header = header
        self._file: Any = None
        self._tables: list[dict[str, np.ndarray]] = []

    def write(self, table: dict[str, np.ndarray]) -> None:
        self._tables.append(table)
        if sum(len(waiting["frame"]) for waiting in self._tables) >= GROUP_ROWS:
            self._write_group()

    def _write_group(self) -> None:
        pa, pq = _arrow()
        columns = {}
        for name in self._tables[0]:
            values = np.concatenate([table[name] for table in self._tables])
            columns[name] = pa.array(values, from_pandas=True)
        group = pa.table(columns).replace_schema_metadata({KEY: self._header.text()})
        if self._file is None:
            self._file = pq.ParquetWriter(self._stream, group.schema)
        self._file.write_table(group)
        self._tables = []

    def close(self) -> None:
        if self._tables:
            self._write_group()
        if self._file is not None:
            self._file.close()

    @staticmethod
    def join(parts: Sequence[Path], stream: BinaryIO) -> None:
        pq = _arrow()[1]
        cure = "remove it, and the same command makes it anew"
        with files.sentence(parts[0], cure):
            schema = pq.read_schema(parts[0])
        with pq.ParquetWriter(stream, schema) as table:
            for part in parts:
                with files.sentence(part, cure):
                    groups = pq.ParquetFile(part)
                with groups:
                    for k in range(groups.num_row_groups):
                        with files.sentence(part, cure):
                            rows = groups.read_row_group(k)
                        table.write_table(rows)

    @staticmethod
    def read(path: Path) -> tuple[Header, Iterator[dict[str, np.ndarray]]]:
        pq = _arrow()[1]
        with (
            files.open_file(path, files.MAX_TABLE) as stream,
            files.sentence(path, CURE),
            pq.ParquetFile(stream) as table,
        ):
            _check_schema(path, table)
            header = _header(path, (table.schema_arrow.metadata or {}).get(KEY.encode(), b""))

        def blocks() -> Iterator[dict[str, np.ndarray]]:
            with (
                files.open_file(path, files.MAX_TABLE) as stream,
                files.sentence(path, CURE),
                pq.ParquetFile(stream) as table,
            ):
                for batch in table.iter_batches(BLOCK_ROWS):
                    block = {}
                    for name, column in zip(batch.schema.names, batch.columns, strict=True):
                        block[name] = column.to_numpy(zero_copy_only=False).astype(float)
                    yield block

        return header, blocks()


def _check_schema(path: Path, table: Any) -> None:
    """FileError unless a Parquet file has as many rows as its size allows, and columns of numbers alone."""
    types = _arrow()[0].types
    rows = table.metadata.num_rows
    size = path.stat().st_size
    if rows > min(MAX_ROWS, 1_000_000 + 10 * size):  # equal numbers take almost no space
        raise FileError(f"{files.short_name(path)}: {rows:,} rows in {size:,} bytes are too many; {CURE}.")
    for field in table.schema_arrow:
        if not (types.is_integer(field.type) or types.is_floating(field.type)):
            raise FileError(f"{files.short_name(path)}: {field.name[:60]!r} is no column of numbers; {CURE}.")
    names = table.schema_arrow.names
    if len(set(names)) < len(names):
        raise FileError(f"{files.short_name(path)}: names a column twice; {CURE}.")


def _arrow() -> tuple[Any, Any]:
    """The modules pyarrow and pyarrow.parquet; InputError if they are missing."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError('.parquet: pyarrow is missing; pip install "sean_jax[lerobot]", or save .csv.') from None
    return pyarrow, pyarrow.parquet

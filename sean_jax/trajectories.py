"""Trajectories in files that other programs read: tables as CSV or Parquet, arrays as zarr.

A table has a row for each frame of the robot and of each person who is there then, so that pandas, PedPy or a database
can take it as it is; ``COLUMNS`` says what they are. A folder of zarr has the arrays of ``base.Trajectory``. A
``TrajectoryWriter`` adds episode after episode, of which one is in memory at a time.
"""

import contextlib
import csv
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sean_jax import files, writing
from sean_jax.base import Trajectory
from sean_jax.errors import InputError

ROBOT = -1  # the robot's id; people have the numbers 0 to N - 1
COLUMNS = {
    "episode": "number of the episode, from 0; left out of a single one",
    "frame": "number of the step of control, from 0",
    "time": "s, after that step: (frame + 1) times the time of a step",
    "id": "-1 for the robot, 0 and more for people",
    "x": "m",
    "y": "m",
    "vx": "m/s",
    "vy": "m/s",
    "heading_x": "unit vector of the way it faces",
    "heading_y": "likewise",
    "group": "conversational group of a person, -1 for none; -1 for the robot",
    "goal_x": "m, of the robot; empty for people, as all that follows",
    "goal_y": "m",
    "command_speed": "m/s, the command that led here",
    "command_turn_rate": "rad/s",
    "active": "1 until the episode has ended",
    "situation_NAME": "1 while that social situation holds",
}
"""Column of a table -> what it is."""

PERSON = ("x", "y", "vx", "vy", "heading_x", "heading_y")
OF_ROBOT = ("goal_x", "goal_y", "command_speed", "command_turn_rate", "active")
SUFFIXES = (".csv", ".parquet", ".zarr")
GROUP_ROWS = 2**18  # of a table, that Parquet stores together: episodes are gathered until there are so many
TOLD = "sean_jax"  # key of what is told beside the columns: time_step, situations, people, episodes


def save_trajectory(
    trajectory: Trajectory,
    path: Path | str,
    *,
    time_step: float = 0.1,
    situations: Sequence[str] | None = None,
) -> None:
    """Write what a rollout recorded.

    A table leaves out people who are absent; read again, they are at (0, 0) there.

    Args:
        trajectory: (T, ...) frames of an episode, or (E, T, ...) of several.
        path: to be written: ``.csv``, ``.parquet`` (extra ``lerobot``) or a new folder ``.zarr`` (extra ``learning``).
        time_step: s, between two frames.
        situations: their names, as of the scenario; numbers if None.

    Raises:
        InputError: the path has another ending, or there are not as many names as situations.
        WriteError: another process writes the file.
        IncompleteError: the file cannot be written.
    """
    path = Path(path)
    _check_suffix(path)
    arrays = {name: np.asarray(value) for name, value in vars(trajectory).items()}
    if arrays["active"].ndim not in (1, 2):
        raise InputError(f"trajectory: frames with {arrays['active'].ndim} leading axes; give (T, ...) or (E, T, ...).")
    number = arrays["situations"].shape[-1]
    names = [f"{k}" for k in range(number)] if situations is None else list(situations)
    if len(names) != number:
        raise InputError(f"situations: {len(names)} names for {number} situations; give one name for each.")
    told = {"time_step": time_step, "situations": names, "people": arrays["people"].shape[-2]}
    if path.suffix == ".zarr":
        return _save_zarr(path, arrays, told)
    batched = arrays["active"].ndim == 2
    table = _table(arrays if batched else {name: value[None] for name, value in arrays.items()}, told)
    if not batched:
        table.pop("episode")
    _save_csv(path, table, told) if path.suffix == ".csv" else _save_parquet(path, table, told)
    return None


def load_trajectory(path: Path | str) -> Trajectory:
    """Read what ``save_trajectory`` wrote.

    Args:
        path: of the file or folder.

    Returns:
        (T, ...) or (E, T, ...), as it was saved, as numpy arrays.

    Raises:
        InputError: it is none.
        IncompleteError: it is damaged.
    """
    path = Path(path)
    _check_suffix(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such file.")
    if path.suffix == ".zarr":
        return _load_zarr(path)
    table, told = _load_csv(path) if path.suffix == ".csv" else _load_parquet(path)
    lacking = [name for name in ("frame", "id", "group", *PERSON, *OF_ROBOT) if name not in table]
    if lacking:
        raise InputError(f"{path}: has no column {lacking[0]}; give a file that save_trajectory has written.")
    return _frames(table, told)


def check_packages(suffix: str) -> None:
    """Refuse a format whose package is missing.

    Args:
        suffix: one of ``SUFFIXES``.

    Raises:
        InputError: it names the package and the cure.
    """
    if suffix == ".parquet":
        _arrow()
    if suffix == ".zarr":
        _tensorstore()


class TrajectoryWriter:
    """A file of many episodes that grows by one at a time; made by ``trajectory_writer``."""

    def __init__(self, path: Path, told: dict[str, Any], steps: int, count: int, first: int, stream: Any = None):
        self.path, self.told, self.steps, self.count, self.first = path, told, steps, count, first
        self.added = 0
        self._stream = stream
        self._table: Any = None  # the writer of a Parquet file
        self._waiting: list[dict[str, np.ndarray]] = []

    def add(self, trajectory: Trajectory) -> None:
        """Write the next episode.

        Args:
            trajectory: (T, ...) its frames; those after ``steps`` are left out.
        """
        arrays = {name: np.asarray(value)[: self.steps] for name, value in vars(trajectory).items()}
        if self.path.suffix == ".zarr":
            if not self.added:
                self._make_arrays(arrays)
            for name, values in arrays.items():
                _zarr(self.path / name, {})[self.added, : len(values)].write(values).result()
        else:
            table = _table({name: value[None] for name, value in arrays.items()}, self.told)
            table["episode"] = table["episode"] + (self.first + self.added)
            self._add_rows(table)
        self.added += 1

    def _add_rows(self, table: dict[str, np.ndarray]) -> None:
        if self.path.suffix == ".csv":
            lines = [] if self.added else [f"# {TOLD} {json.dumps(self.told)}", ",".join(table)]
            self._stream.write(("\n".join([*lines, *_lines(table)]) + "\n").encode("utf-8"))
            return
        self._waiting.append(table)
        if sum(len(each["frame"]) for each in self._waiting) >= GROUP_ROWS:
            self._write_group()

    def _write_group(self) -> None:
        pq = _arrow()[1]
        rows = {name: np.concatenate([each[name] for each in self._waiting]) for name in self._waiting[0]}
        made = _arrow_table(rows, self.told)
        if self._table is None:
            self._table = pq.ParquetWriter(self._stream, made.schema)
        self._table.write_table(made)
        self._waiting = []

    def _make_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """An array for each field, of which each episode is a file of its own."""
        self.path.mkdir(parents=True, exist_ok=True)
        for name, values in arrays.items():
            shape = [self.steps, *values.shape[1:]]
            metadata = {
                "shape": [self.count, *shape],
                "data_type": str(values.dtype),
                "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1, *(max(1, n) for n in shape)]}},
                "codecs": [{"name": "bytes"}, {"name": "zstd", "configuration": {"level": 3}}],
            }
            _zarr(self.path / name, {"create": True, "metadata": metadata})

    def close(self) -> None:
        """Write what waits; the file is whole."""
        if self.path.suffix == ".zarr":
            _finish_zarr(self.path, self.told)
        if self._waiting:
            self._write_group()
        if self._table is not None:
            self._table.close()


@contextlib.contextmanager
def trajectory_writer(
    path: Path | str,
    *,
    time_step: float = 0.1,
    situations: Sequence[str],
    people: int,
    steps: int,
    count: int,
    first: int = 0,
) -> Iterator[TrajectoryWriter]:
    """Write episodes one after another; the file is there when the block ends, and as it was if anything is raised.

    Args:
        path: to be written, as of ``save_trajectory``.
        time_step: s, between two frames.
        situations: their names.
        people: N, of each episode.
        steps: most frames of an episode.
        count: how many episodes there will be.
        first: number of the first of them.

    Yields:
        What adds an episode.

    Raises:
        InputError: the path has another ending, or a package is missing.
        WriteError: another process writes the file.
    """
    path = Path(path)
    _check_suffix(path)
    check_packages(path.suffix)
    told = {"time_step": time_step, "situations": list(situations), "people": people}
    if path.suffix == ".zarr":
        with _replaced(path) as scratch:
            writer = TrajectoryWriter(scratch, told, steps, count, first)
            yield writer
            writer.close()
        return
    with writing.atomic_file(path) as stream:
        writer = TrajectoryWriter(path, told, steps, count, first, stream)
        yield writer
        writer.close()


def join_trajectories(parts: Sequence[Path], path: Path) -> None:
    """One file of several that ``trajectory_writer`` wrote, whose episodes follow one another.

    Args:
        parts: of one format and of episodes alike.
        path: to be written, in the same format.

    Raises:
        WriteError: another process writes the file.
    """
    if path.suffix == ".zarr":
        with _replaced(path) as scratch:
            _join_zarr(parts, scratch)
        return
    with writing.atomic_file(path) as stream:
        if path.suffix == ".csv":
            for place, part in enumerate(parts):
                with part.open("rb") as rows:
                    for _ in range(2 if place else 0):  # what is told, and the head
                        rows.readline()
                    shutil.copyfileobj(rows, stream)
            return
        pq = _arrow()[1]
        with pq.ParquetWriter(stream, pq.read_schema(parts[0])) as table:
            for part in parts:
                with pq.ParquetFile(part) as groups:
                    for k in range(groups.num_row_groups):
                        table.write_table(groups.read_row_group(k))


@contextlib.contextmanager
def _replaced(path: Path) -> Iterator[Path]:
    """A folder beside this one that takes its place when the block ends; if anything is raised, the old one stays."""
    scratch = path.with_name(f".part-{path.name}")
    shutil.rmtree(scratch, ignore_errors=True)  # of one who was killed
    try:
        yield scratch
        shutil.rmtree(path, ignore_errors=True)
        scratch.rename(path)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _join_zarr(parts: Sequence[Path], path: Path) -> None:
    told = json.loads(files.read_text(parts[0] / "zarr.json"))["attributes"][TOLD]
    for name in Trajectory.__dataclass_fields__:
        arrays = [_zarr(part / name, {}) for part in parts]
        metadata = json.loads(files.read_text(parts[0] / name / "zarr.json"))
        metadata["shape"][0] = sum(each.shape[0] for each in arrays)
        metadata = {key: metadata[key] for key in ("shape", "data_type", "chunk_grid", "codecs")}
        whole, done = _zarr(path / name, {"create": True, "metadata": metadata}), 0
        for each in arrays:
            for k in range(each.shape[0]):
                whole[done].write(each[k].read().result()).result()
                done += 1
    _finish_zarr(path, told)


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: its name must end in {', '.join(SUFFIXES)}.")


def _table(arrays: dict[str, np.ndarray], told: dict[str, Any]) -> dict[str, np.ndarray]:
    """Columns of all rows: of each frame the robot's, then those of the people who are there."""
    episodes, steps = arrays["active"].shape
    present = np.concatenate([np.ones((episodes, steps, 1), bool), arrays["present"]], -1)
    episode, frame, who = np.nonzero(present)

    def both(robot: np.ndarray, people: np.ndarray) -> np.ndarray:
        return np.concatenate([robot[:, :, None], people], 2)[present]

    place = both(arrays["position"], arrays["people"])
    velocity = both(arrays["velocity"], arrays["people_velocity"])
    heading = both(arrays["heading"], arrays["people_heading"])
    group = both(np.full((episodes, steps), ROBOT), arrays["group"])
    columns = {
        "episode": episode,
        "frame": frame,
        "time": (frame + 1) * told["time_step"],
        "id": who - 1,
        **{name: part for name, part in zip(PERSON, (*place.T, *velocity.T, *heading.T), strict=True)},
        "group": group,
    }
    robots = np.where(who == 0)[0]
    own = (*np.moveaxis(arrays["goal"], -1, 0), *np.moveaxis(arrays["action"], -1, 0), arrays["active"])
    flags = np.moveaxis(arrays["situations"], -1, 0)
    labels = [*OF_ROBOT, *(f"situation_{name}" for name in told["situations"])]
    for name, values in zip(labels, (*own, *flags), strict=True):
        column = np.full(len(who), np.nan, np.float32)
        column[robots] = values.reshape(-1)
        columns[name] = column
    return columns


def _frames(table: dict[str, np.ndarray], told: dict[str, Any]) -> Trajectory:
    """The arrays of all columns."""
    batched = "episode" in table
    episode = table["episode"].astype(int) if batched else np.zeros(len(table["frame"]), int)
    frame, who = table["frame"].astype(int), table["id"].astype(int)
    episodes, steps = (int(part.max(initial=-1)) + 1 for part in (episode, frame))
    people = told["people"] if told else int(who.max(initial=-1)) + 1
    names = [name for name in table if name.startswith("situation_")]
    robot, person = who == ROBOT, who >= 0
    at_robot, at_person = (episode[robot], frame[robot]), (episode[person], frame[person], who[person])

    def of_robot(*columns: str) -> np.ndarray:
        values = np.zeros((episodes, steps, len(columns)), np.float32)
        values[at_robot] = np.stack([table[name][robot] for name in columns], -1) if columns else 0.0
        return values

    def of_people(*columns: str) -> np.ndarray:
        values = np.zeros((episodes, steps, people, len(columns)), np.float32)
        values[at_person] = np.stack([table[name][person] for name in columns], -1)
        return values

    present, group = np.zeros((episodes, steps, people), bool), np.full((episodes, steps, people), -1, np.int32)
    present[at_person], group[at_person] = True, table["group"][person].astype(np.int32)
    arrays: dict[str, Any] = dict(
        position=of_robot("x", "y"),
        heading=of_robot("heading_x", "heading_y"),
        velocity=of_robot("vx", "vy"),
        action=of_robot("command_speed", "command_turn_rate"),
        people=of_people("x", "y"),
        people_velocity=of_people("vx", "vy"),
        people_heading=of_people("heading_x", "heading_y"),
        group=group,
        present=present,
        goal=of_robot("goal_x", "goal_y"),
        situations=of_robot(*names) > 0.5,
        active=of_robot("active")[..., 0] > 0.5,
    )
    whole = Trajectory(**arrays)
    return whole if batched else jax.tree.map(lambda leaf: leaf[0], whole)


def _save_csv(path: Path, table: dict[str, np.ndarray], told: dict[str, Any]) -> None:
    with writing.atomic_file(path) as stream:
        lines = [f"# {TOLD} {json.dumps(told)}", ",".join(table)]
        stream.write(("\n".join([*lines, *_lines(table)]) + "\n").encode("utf-8"))


def _lines(table: dict[str, np.ndarray]) -> list[str]:
    columns = [_texts(values) for values in table.values()]
    return [",".join(row) for row in zip(*columns, strict=True)]


def _texts(values: np.ndarray) -> list[str]:
    """As few digits as tell a number from all others; nothing for NaN."""
    if values.dtype.kind in "iub":
        return [str(int(value)) for value in values]
    return ["" if value != value else np.format_float_positional(value, trim="-") for value in values]


def _load_csv(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    lines = files.read_text(path).splitlines()
    told: dict[str, Any] = {}
    if lines and lines[0].startswith(f"# {TOLD} "):
        try:
            told = json.loads(lines.pop(0)[len(TOLD) + 3 :])
        except ValueError:
            raise InputError(f"{path}: its first line is damaged; save the trajectory again.") from None
    reader = csv.reader(lines)
    head = next(reader, [])
    rows = list(reader)
    if not head or any(len(row) != len(head) for row in rows):
        raise InputError(f"{path}: rows have other numbers of cells than its head; save the trajectory again.")
    try:
        cells = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows]).reshape(-1, len(head))
    except ValueError as error:
        raise InputError(f"{path}: {error}; give a file that save_trajectory has written.") from None
    return dict(zip(head, cells.T, strict=True)), told


def _save_parquet(path: Path, table: dict[str, np.ndarray], told: dict[str, Any]) -> None:
    pq = _arrow()[1]
    made = _arrow_table(table, told)
    with writing.atomic_file(path) as stream:
        pq.write_table(made, stream)


def _arrow_table(table: dict[str, np.ndarray], told: dict[str, Any]) -> Any:
    pa = _arrow()[0]
    made = pa.table({name: pa.array(values, from_pandas=True) for name, values in table.items()})
    return made.replace_schema_metadata({TOLD: json.dumps(told)})


def _load_parquet(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    pa, pq = _arrow()
    try:
        read = pq.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: is no Parquet file ({str(error).splitlines()[0]}); give another.") from None
    told = json.loads((read.schema.metadata or {}).get(TOLD.encode(), b"{}"))
    return {name: read[name].to_numpy() for name in read.column_names}, told


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError('.parquet: pyarrow is missing; pip install "sean_jax[lerobot]", or save .csv.') from None
    return pyarrow, pyarrow.parquet


def _save_zarr(path: Path, arrays: dict[str, np.ndarray], told: dict[str, Any]) -> None:
    if writing.contents(path):
        raise InputError(f"{path}: holds something already; choose another folder.")
    path.mkdir(parents=True, exist_ok=True)
    for name, values in arrays.items():
        metadata = {"shape": list(values.shape), "data_type": str(values.dtype)}
        _zarr(path / name, {"create": True, "metadata": metadata}).write(values).result()
    _finish_zarr(path, told)


def _finish_zarr(path: Path, told: dict[str, Any]) -> None:
    group = {"zarr_format": 3, "node_type": "group", "attributes": {TOLD: told}}
    writing.write(path / "zarr.json", json.dumps(group, indent=2) + "\n")  # last: a folder without it is incomplete


def _load_zarr(path: Path) -> Trajectory:
    if not (path / "zarr.json").is_file():
        raise InputError(f"{path}: holds no zarr.json; give a folder that save_trajectory has finished.")
    names = Trajectory.__dataclass_fields__
    try:
        arrays: dict[str, Any] = {name: np.asarray(_zarr(path / name, {}).read().result()) for name in names}
        return Trajectory(**arrays)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {str(error).splitlines()[0][:200]}; save the trajectory again.") from None


def _tensorstore() -> Any:
    try:
        import tensorstore
    except ImportError:
        raise InputError('.zarr: tensorstore is missing; pip install "sean_jax[learning]", or save .csv.') from None
    return tensorstore


def _zarr(path: Path, more: dict[str, Any]) -> Any:
    tensorstore = _tensorstore()
    where = {"driver": "file", "path": os.path.abspath(path)}
    return tensorstore.open({"driver": "zarr3", "kvstore": where, "open": not more, **more}).result()

"""Export of a dataset to LeRobotDataset v3.0, the format of the LeRobot project: parquet files with a description.

The parquet files contain the depth images as PNG of 16 bits, in mm, as LeRobot stores images that are not videos.
"""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax import writing
from sean_jax.errors import InputError
from sean_jax.learning.dataset import Dataset, Episode, open_dataset
from sean_jax.writing import check_new_folder

FILES_IN_CHUNK = 1000  # LeRobot calls a folder of files a chunk
EPISODES_IN_FILE = 512
IMAGE, STATE, PLAN, FLAGS, ACTION = (
    "observation.images.depth",
    "observation.state",
    "observation.environment_state",
    "observation.situations",
    "action",
)
NUMBERS = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def export(dataset: Path | str, out: Path | str) -> Path:
    """Write a dataset in the format of LeRobot.

    Args:
        dataset: folder of the dataset.
        out: folder to write, new or empty.

    Returns:
        The folder that was written.

    Raises:
        InputError: there is no dataset, it is empty, or pyarrow is not installed.
        WriteError: the folder cannot be written.
        IncompleteError: a file of the dataset is damaged.
    """
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise InputError('export lerobot: pyarrow is missing; pip install "sean_jax[lerobot]".') from None
    data, out = open_dataset(dataset), Path(out)
    check_new_folder(out)
    if not data.episodes:
        raise InputError(f"{data.folder} has no episodes; collect some.")
    with writing.atomic_folder(out) as folder:
        _export(data, folder)
    return out


def _export(data: Dataset, out: Path) -> None:
    tasks, descriptions, totals, index = list(data.manifest["streams"]), [], Statistics(), 0
    for number, first in enumerate(range(0, len(data.episodes), EPISODES_IN_FILE)):
        where = {"chunk_index": number // FILES_IN_CHUNK, "file_index": number % FILES_IN_CHUNK}
        rows: list[dict[str, Any]] = []
        for episode_index, episode in enumerate(data.episodes[first : first + EPISODES_IN_FILE], first):
            frames = list(_frames(data, episode, episode_index, index))
            own = Statistics()
            own.add(frames)
            totals.join(own)
            descriptions.append(_description(episode, episode_index, index, tasks, where, own))
            rows += [_cells(frame) for frame in frames]
            index += len(frames)
        _write(out / _file("data", **where), rows, _schema(data))
    _write(out / _file("meta/episodes", 0, 0), descriptions)
    _write(out / "meta/tasks.parquet", *_tasks(tasks))
    (out / "meta/info.json").write_text(json.dumps(_info(data, index, tasks), indent=4) + "\n", encoding="utf-8")
    (out / "meta/stats.json").write_text(json.dumps(totals.as_dict(), indent=4) + "\n", encoding="utf-8")


class Statistics:
    """Minimum, maximum, mean, standard deviation and count of each feature; of images, per channel from 0 to 1."""

    def __init__(self):
        self.sums: dict[str, list[np.ndarray]] = {}

    def add(self, frames: list[dict[str, Any]]) -> None:
        """Count frames.

        Args:
            frames: name -> value of each feature, for each frame.
        """
        for name in frames[0]:
            values = np.stack([np.atleast_1d(frame[name]) for frame in frames]).astype(np.float64)
            if name == IMAGE:
                values = values.reshape(-1, 1) / 65535.0
            parts = [values.min(0), values.max(0), values.sum(0), np.square(values).sum(0), np.array([len(values)])]
            self._add(name, parts)

    def join(self, other: "Statistics") -> None:
        """Count what another object has counted.

        Args:
            other: the other.
        """
        for name, parts in other.sums.items():
            self._add(name, parts)

    def _add(self, name: str, parts: list[np.ndarray]) -> None:
        if name not in self.sums:
            self.sums[name] = parts
            return
        low, high, total, square, count = self.sums[name]
        sums = [total + parts[2], square + parts[3], count + parts[4]]
        self.sums[name] = [np.minimum(low, parts[0]), np.maximum(high, parts[1]), *sums]

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Convert to the content of stats.json. Returns feature -> statistic -> value."""
        return {name: self._feature(name) for name in self.sums}

    def _feature(self, name: str) -> dict[str, Any]:
        low, high, total, square, count = self.sums[name]
        mean = total / count
        std = np.sqrt(np.maximum(square / count - mean * mean, 0.0))
        values = {"min": low, "max": high, "mean": mean, "std": std}
        shaped = {key: value.reshape(-1, 1, 1) if name == IMAGE else value for key, value in values.items()}
        return {**{key: value.tolist() for key, value in shaped.items()}, "count": count.tolist()}


def _frames(data: Dataset, episode: Episode, number: int, index: int) -> Iterator[dict[str, Any]]:
    rows = data.read([episode])
    for row in range(episode.length):
        yield {
            IMAGE: rows["depth"][row],
            STATE: np.concatenate([rows["pose"][row], rows["velocity"][row]]),
            PLAN: rows["plan"][row].reshape(-1),
            FLAGS: rows["situations"][row].astype(np.float32),
            ACTION: rows["command"][row],
            "timestamp": np.float32(row / data.rate),
            "frame_index": row,
            "episode_index": number,
            "index": index + row,
            "task_index": episode.stream,
        }


def _cells(frame: dict[str, Any]) -> dict[str, Any]:
    """A frame as a row of a parquet file."""
    from PIL import Image

    packed = io.BytesIO()
    Image.fromarray(frame[IMAGE]).save(packed, format="PNG")
    cells = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in frame.items()}
    return {**cells, IMAGE: {"bytes": packed.getvalue(), "path": None}}


def _description(
    episode: Episode, number: int, index: int, tasks: list[str], where: dict[str, int], own: Statistics
) -> dict[str, Any]:
    """A row of meta/episodes."""
    statistics = {f"stats/{name}/{key}": value for name, stats in own.as_dict().items() for key, value in stats.items()}
    return {
        "episode_index": number,
        "tasks": [tasks[episode.stream]],
        "length": episode.length,
        "dataset_from_index": index,
        "dataset_to_index": index + episode.length,
        **{f"data/{key}": value for key, value in where.items()},
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        **statistics,
    }


def _info(data: Dataset, frames: int, tasks: list[str]) -> dict[str, Any]:
    height, width = data.image_shape
    pose = ["x", "y", "heading_x", "heading_y", "speed", "turn_rate"]
    points = [f"plan_{axis}_{number}" for number in range(1, 11) for axis in "xy"]
    flags = data.manifest["situations"]
    features = {
        IMAGE: {"dtype": "image", "shape": [height, width, 1], "names": ["height", "width", "channel"]},
        STATE: {"dtype": "float32", "shape": [6], "names": pose},
        PLAN: {"dtype": "float32", "shape": [20], "names": points},
        FLAGS: {"dtype": "float32", "shape": [len(flags)], "names": flags},
        ACTION: {"dtype": "float32", "shape": [2], "names": ["speed", "turn_rate"]},
    }
    for name in NUMBERS:
        features[name] = {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
    return {
        "codebase_version": "v3.0",
        "robot_type": data.manifest["robot"]["name"],
        "total_episodes": len(data.episodes),
        "total_frames": frames,
        "total_tasks": len(tasks),
        "chunks_size": FILES_IN_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": data.rate,
        "splits": {"train": f"0:{len(data.episodes)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }


def _schema(data: Dataset) -> Any:
    import pyarrow as pa

    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    sizes = {STATE: 6, PLAN: 20, FLAGS: len(data.manifest["situations"]), ACTION: 2}
    columns = [(IMAGE, image), *((name, pa.list_(pa.float32(), size)) for name, size in sizes.items())]
    columns += [(name, pa.float32() if name == "timestamp" else pa.int64()) for name in NUMBERS]
    return pa.schema(columns)


def _tasks(tasks: list[str]) -> tuple[list[dict[str, Any]], Any]:
    """The tasks. Their names are marked as the index of a table of pandas, where LeRobot looks for them."""
    import pyarrow as pa

    rows = [{"task_index": number, "task": name.replace("_", " ")} for number, name in enumerate(tasks)]
    columns = [
        {"name": name, "field_name": name, "pandas_type": pandas_type, "numpy_type": numpy, "metadata": None}
        for name, pandas_type, numpy in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    pandas = json.dumps({"index_columns": ["task"], "column_indexes": [], "columns": columns, "creator": {}})
    return rows, pa.schema([("task_index", pa.int64()), ("task", pa.string())], metadata={"pandas": pandas})


def _file(folder: str, chunk_index: int, file_index: int) -> str:
    return f"{folder}/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


def _write(file: Path, rows: list[dict[str, Any]], schema: Any = None) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    file.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), file)

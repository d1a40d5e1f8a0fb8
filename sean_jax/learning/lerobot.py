"""Export of a dataset to LeRobotDataset v3.0, the format of the LeRobot project: parquet files with a description.

The parquet files contain the depth images as PNG of 16 bits, in mm, as LeRobot stores images that are not videos.
"""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.io.writing import check_new_folder
from sean_jax.learning.dataset import Dataset, Episode, open_dataset

FORMAT = files.read_yaml(Path(__file__).with_suffix(".yaml"))[1]
EPISODES_IN_FILE = 512
IMAGE, STATE, PLAN, FLAGS, ACTION = list(FORMAT["features"])[:5]
QUANTILES = FORMAT["quantiles"]


def export(dataset: Path | str, out: Path | str) -> Path:
    """Write a dataset in the format of LeRobot into a new or empty folder ``out``.

    Raises:
        InputError: there is no dataset, it is empty, or pyarrow is not installed.
        WriteError: the folder cannot be written.
        IncompleteError: a file of the dataset is damaged.
    """
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise InputError('export lerobot: pyarrow is missing; pip install "sean_jax[lerobot]".') from None
    data = open_dataset(dataset)
    out = Path(out)
    check_new_folder(out)
    if not data.episodes:
        raise InputError(f"{data.folder} has no episodes; collect some.")
    with writing.atomic_folder(out) as folder:
        _export(data, folder)
    return out


def _export(data: Dataset, out: Path) -> None:
    import pyarrow.parquet as pq

    tasks = [name.replace("_", " ") for name in data.manifest["streams"]]
    schema = _schema(_features(data))

    # Depth has 16 bits: a histogram has its exact quantiles, and no image stays in memory.
    descriptions = []
    everything = []
    depths = np.zeros(2**16, np.int64)
    index = 0
    for number, first in enumerate(range(0, len(data.episodes), EPISODES_IN_FILE)):
        # Files hold many episodes and chunks many files, so that datasets of millions of episodes have few files.
        chunk, place = divmod(number, FORMAT["info"]["chunks_size"])
        where = {"chunk_index": chunk, "file_index": place}
        file = out / _file("data", **where)
        file.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(file, schema) as writer:  # a row group for each episode, as LeRobot writes them
            for episode_index, episode in enumerate(data.episodes[first : first + EPISODES_IN_FILE], first):
                # Numbers of rows and episodes go on across files; loaders find a row by them.
                columns = _columns(data, episode, episode_index, index)
                writer.write_table(_table(columns, schema))

                # The image leaves the columns once it is written: it is most of the memory.
                own = np.bincount(columns.pop(IMAGE).ravel(), minlength=len(depths))  # (65536,)
                stats = _stats(columns, own)
                descriptions.append(_description(episode, episode_index, index, tasks, where, stats))
                everything.append(columns)
                depths += own
                index += episode.length

    # Loaders read these descriptions first, and from them the place of each episode.
    _write(out / _file("meta/episodes", 0, 0), descriptions)
    _write(out / "meta/tasks.parquet", *_tasks(tasks))

    # Statistics of the whole dataset normalize the inputs of a policy; those of episodes allow for subsets.
    whole = {name: np.concatenate([columns[name] for columns in everything]) for name in everything[0]}
    for name, content in (("info", _info(data, index, tasks)), ("stats", _stats(whole, depths))):
        (out / f"meta/{name}.json").write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")


def _stats(columns: dict[str, np.ndarray], depths: np.ndarray) -> dict[str, dict[str, Any]]:
    """Feature -> statistic -> value; of depth per channel and in mm, as its pixels are.

    Args:
        columns: (T,) or (T, K) of each feature but the image.
        depths: (65,536,) number of pixels of each depth.
    """
    kinds = np.flatnonzero(depths)
    image = {name: value.reshape(1, 1, 1) for name, value in _statistics(kinds[:, None], depths[kinds]).items()}
    rest = {name: _statistics(values.reshape(len(values), -1)) for name, values in columns.items()}
    return {
        feature: {name: value.tolist() for name, value in values.items()} | {"count": [len(columns["index"])]}
        for feature, values in {IMAGE: image, **rest}.items()
    }


def _statistics(values: np.ndarray, weights: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """(K,) of each statistic of (N, K) values, each of which counts ``weights`` times."""
    values = values.astype(np.float64)
    mean = np.average(values, axis=0, weights=weights)
    std = np.sqrt(np.average(np.square(values - mean), axis=0, weights=weights))
    levels = np.quantile(values, list(QUANTILES.values()), axis=0, weights=weights, method="inverted_cdf")
    statistics = {"min": values.min(0), "max": values.max(0), "mean": mean, "std": std}
    return statistics | dict(zip(QUANTILES, levels, strict=True))


def _columns(data: Dataset, episode: Episode, number: int, index: int) -> dict[str, np.ndarray]:
    """(T, ...) of each feature; one of a single number has (T,), as LeRobot stores it."""
    rows = data.read([episode])
    steps = np.arange(episode.length)
    columns = {
        IMAGE: rows["depth"],
        STATE: np.concatenate([rows["pose"], rows["velocity"]], axis=1),
        PLAN: rows["plan"].reshape(len(steps), -1),
        FLAGS: rows["situations"].astype(np.float32),
        ACTION: rows["command"],
        "timestamp": (steps / data.rate).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full_like(steps, number),
        "index": index + steps,
        "task_index": np.full_like(steps, episode.stream),
    }
    return {name: values[:, 0] if values.shape[1:] == (1,) else values for name, values in columns.items()}


def _table(columns: dict[str, np.ndarray], schema: Any) -> Any:
    import pyarrow as pa

    images = [{"bytes": _png(image), "path": None} for image in columns[IMAGE]]
    return pa.Table.from_pydict({**{name: list(values) for name, values in columns.items()}, IMAGE: images}, schema)


def _png(image: np.ndarray) -> bytes:
    from PIL import Image

    packed = io.BytesIO()
    Image.fromarray(image).save(packed, format="PNG")
    return packed.getvalue()


def _description(
    episode: Episode, number: int, index: int, tasks: list[str], where: dict[str, int], own: dict[str, Any]
) -> dict[str, Any]:
    """A row of meta/episodes."""
    return {
        "episode_index": number,
        "tasks": [tasks[episode.stream]],
        "length": episode.length,
        "dataset_from_index": index,
        "dataset_to_index": index + episode.length,
        **{f"data/{key}": value for key, value in where.items()},
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        **{f"stats/{name}/{key}": value for name, stats in own.items() for key, value in stats.items()},
    }


def _features(data: Dataset) -> dict[str, dict[str, Any]]:
    features = {}
    for name, feature in FORMAT["features"].items():
        names = data.manifest["situations"] if name == FLAGS else feature.get("names")
        shape = [*data.image_shape, 1] if name == IMAGE else [len(names) if names else 1]
        features[name] = {**feature, "shape": shape, "names": names}
    return features


def _info(data: Dataset, frames: int, tasks: list[str]) -> dict[str, Any]:
    return {
        **FORMAT["info"],
        "robot_type": data.manifest["robot"]["name"],
        "total_episodes": len(data.episodes),
        "total_frames": frames,
        "total_tasks": len(tasks),
        "fps": data.rate,
        "splits": {"train": f"0:{len(data.episodes)}"},
        "features": _features(data),
    }


def _schema(features: dict[str, dict[str, Any]]) -> Any:
    import pyarrow as pa

    def column(feature: dict[str, Any]) -> Any:
        if feature["dtype"] == "image":
            return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        kind = getattr(pa, feature["dtype"])()
        (size,) = feature["shape"]
        return kind if size == 1 else pa.list_(kind, size)

    return pa.schema([(name, column(feature)) for name, feature in features.items()])


def _tasks(tasks: list[str]) -> tuple[list[dict[str, Any]], Any]:
    """The tasks. Their names are marked as the index of a table of pandas, where LeRobot looks for them."""
    import pyarrow as pa

    rows = [{"task_index": number, "task": name} for number, name in enumerate(tasks)]
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

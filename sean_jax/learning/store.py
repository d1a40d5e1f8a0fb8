"""The store of a dataset: sharded zarr arrays, version 3, through tensorstore (section V-B).

Each field of a row is an array (episodes, T, ...). A batch of episodes is one shard, which is one file for each field.
A committed file is never written again, so a kill cannot damage it. In the shards of the depth images each episode is
a chunk of its own. Every chunk has a checksum (crc32c).
"""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax import writing
from sean_jax.errors import IncompleteError

LEVEL = 3  # of the zstd compression
CURE = "remove the damaged file, and `sean collect` with the same options makes it anew."


def create(folder: Path, fields: dict[str, tuple[tuple[int, ...], str]], batch: int, rows: int) -> None:
    """Create arrays without episodes, in a group that other readers of zarr recognize.

    Args:
        fields: name -> (shape, type) of each field of a row.

    Raises:
        OSError: the folder cannot be written.
        ValueError: tensorstore refuses the arrays.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, (shape, kind) in fields.items():
        shard = [batch, rows, *shape]
        chunk = [1, *shard[1:]] if len(shape) > 1 and kind == "uint16" else shard
        little = {"name": "bytes"} if kind == "bool" else {"name": "bytes", "configuration": {"endian": "little"}}
        index = {"name": "bytes", "configuration": {"endian": "little"}}
        sharding = {
            "chunk_shape": chunk,
            "codecs": [little, {"name": "zstd", "configuration": {"level": LEVEL}}, {"name": "crc32c"}],
            "index_codecs": [index, {"name": "crc32c"}],
        }
        metadata = {
            "shape": [0, *shard[1:]],
            "data_type": kind,
            "fill_value": False if kind == "bool" else 0,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": shard}},
            "codecs": [{"name": "sharding_indexed", "configuration": sharding}],
        }
        _open_array(folder / name, {"metadata": metadata, "create": True, "open": True})
    group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
    writing.write(folder / "zarr.json", json.dumps(group, indent=2) + "\n")


def write(folder: Path, shard: int, fields: dict[str, np.ndarray]) -> dict[str, int]:
    """Write a shard durably.

    Args:
        fields: name -> (B, T, ...) values.

    Returns:
        Name -> size of its file [bytes].

    Raises:
        IncompleteError: it cannot be written, for example because the disk is full.
    """
    writes = []
    try:
        for name, values in fields.items():
            array = _open_array(folder / name)
            first, last = shard * len(values), (shard + 1) * len(values)
            if array.shape[0] < last:
                array = array.resize(exclusive_max=[last, *array.shape[1:]]).result()
            writes.append(array[first:last].write(values))
        for each in writes:
            each.result()
        return {name: path(folder, name, shard, values.ndim).stat().st_size for name, values in fields.items()}
    except (OSError, ValueError) as error:
        raise IncompleteError(f"{folder}: {_reason(error)}; what was committed before is as it was.") from error


def read(folder: Path, name: str, first: int, last: int) -> np.ndarray:
    """Read one field of consecutive episodes.

    Returns:
        (E, T, ...) values.

    Raises:
        IncompleteError: a file is damaged.
    """
    try:
        return np.asarray(_open_array(folder / name)[first:last].read().result())
    except (OSError, ValueError) as error:
        raise IncompleteError(f"{folder / name}: {_reason(error)}; {CURE}") from error


def path(folder: Path, name: str, shard: int, dimensions: int) -> Path:
    """Find the file of a shard.

    Args:
        dimensions: number of dimensions of the array (episodes, T, ...).
    """
    return folder / name / "c" / str(shard) / "/".join("0" * (dimensions - 1))


def _open_array(folder: Path, more: dict[str, Any] | None = None) -> Any:
    import tensorstore

    files = {"driver": "file", "path": os.path.abspath(folder)}  # tensorstore takes no path with ".."
    # Shards of zeros are written as well, so that a missing file is always a lost one.
    spec = {"driver": "zarr3", "kvstore": files, "open": True, "store_data_equal_to_fill_value": True, **(more or {})}
    return tensorstore.open(spec).result()


def _reason(error: Exception) -> str:
    """The cause in a few words that name the file."""
    text = str(error)
    if writing.reason(error) == writing.DISK_FULL:
        return writing.DISK_FULL
    if isinstance(error, OSError) and error.strerror:
        return writing.broken(error)
    cause = text.split("[")[0].strip().rstrip(".")
    file = next((part for part in text.split('"') if "/c/" in part), "")
    if "Digest mismatch" in text or "DATA_LOSS" in text or "corrupt" in text.lower():
        return f"the file {file} is damaged" if file else f"a file is damaged ({cause})"
    return cause

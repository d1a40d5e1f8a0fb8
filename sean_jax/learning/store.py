"""The store: recordings as sharded zarr arrays, version 3, through tensorstore.

An array for each field of a row, (episodes, T, ...). A batch of episodes is one shard, which is one file for each
field: no file that is committed is ever written again, so a kill cannot harm it. Inside the shard of the depth images
each episode is a chunk of its own. Every chunk has a checksum (crc32c).
"""

import errno
import os
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax import writing
from sean_jax.learning.options import Failed

LEVEL = 3  # of zstd


def create(folder: Path, fields: dict[str, tuple[tuple[int, ...], str]], batch: int, seconds: int) -> None:
    """Arrays without episodes for each field (shape, type) of a row; a group that other readers of zarr know."""
    import json

    folder.mkdir(parents=True, exist_ok=True)
    for name, (shape, kind) in fields.items():
        whole = [batch, seconds, *shape]
        chunk = [1, *whole[1:]] if len(shape) > 1 and kind == "uint16" else whole
        little = {"name": "bytes"} if kind == "bool" else {"name": "bytes", "configuration": {"endian": "little"}}
        index = {"name": "bytes", "configuration": {"endian": "little"}}
        shards = {
            "chunk_shape": chunk,
            "codecs": [little, {"name": "zstd", "configuration": {"level": LEVEL}}, {"name": "crc32c"}],
            "index_codecs": [index, {"name": "crc32c"}],
        }
        metadata = {
            "shape": [0, *whole[1:]],
            "data_type": kind,
            "fill_value": False if kind == "bool" else 0,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": whole}},
            "codecs": [{"name": "sharding_indexed", "configuration": shards}],
        }
        _opened(folder / name, {"metadata": metadata, "create": True, "open": True})
    group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
    writing.write(folder / "zarr.json", json.dumps(group, indent=2) + "\n")


def write(folder: Path, shard: int, fields: dict[str, np.ndarray]) -> dict[str, int]:
    """Write a shard of (B, T, ...) each, durably; bytes of the file of each field.

    Raises Failed if it cannot be written, such as when the disk is full.
    """
    waiting, arrays = [], {}
    try:
        for name, values in fields.items():
            array = arrays[name] = _opened(folder / name)
            first, last = shard * len(values), (shard + 1) * len(values)
            if array.shape[0] < last:
                array = array.resize(exclusive_max=[last, *array.shape[1:]]).result()
            waiting.append(array[first:last].write(values))
        for each in waiting:
            each.result()
        return {name: path(folder, name, shard, values.ndim).stat().st_size for name, values in fields.items()}
    except (OSError, ValueError) as error:
        raise Failed(f"{folder}: {_reason(error)}; what was committed before is as it was.") from error


def read(folder: Path, name: str, first: int, last: int) -> np.ndarray:
    """(E, T, ...) of the episodes from ``first`` up to ``last``. Raises Failed if a file is damaged."""
    try:
        return np.asarray(_opened(folder / name)[first:last].read().result())
    except (OSError, ValueError) as error:
        raise Failed(f"{folder / name}: {_reason(error)}; {CURE}") from error


CURE = "remove the damaged file, and `sean collect` with the same options makes it anew."


def path(folder: Path, name: str, shard: int, dimensions: int) -> Path:
    """The file of a shard."""
    return folder / name / "c" / str(shard) / "/".join("0" * (dimensions - 1))


def _opened(folder: Path, more: dict[str, Any] | None = None) -> Any:
    import tensorstore

    files = {"driver": "file", "path": os.path.abspath(folder)}  # it takes no path with ".."
    # Shards of zeros are written as well, so that a missing file is always a lost one.
    spec = {"driver": "zarr3", "kvstore": files, "open": True, "store_data_equal_to_fill_value": True, **(more or {})}
    return tensorstore.open(spec).result()


def _reason(error: Exception) -> str:
    """What went wrong, in a few words that name the file."""
    text = str(error)
    if getattr(error, "errno", None) == errno.ENOSPC or "No space left" in text:
        return "the disk is full"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.strerror.lower()} ({error.filename})" if error.filename else error.strerror.lower()
    shown = text.split("[")[0].strip().rstrip(".")
    named = next((part for part in text.split('"') if "/c/" in part), "")
    if "Digest mismatch" in text or "DATA_LOSS" in text or "corrupt" in text.lower():
        return f"the file {named} is damaged" if named else f"a file is damaged ({shown})"
    return shown

"""A dataset of demonstrations (section V-B): a manifest, and arrays in a store.

The manifest ``dataset.json`` says what was recorded and how. It is replaced as a whole after each shard, and what it
does not name does not exist. Each stream uses as many seconds of its episodes as were asked for.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import components, files, prng, writing
from sean_jax.config import CollectConfig, validate
from sean_jax.errors import FileError, IncompleteError, InputError
from sean_jax.learning import store
from sean_jax.learning.examples import POINTS, Recording, Row
from sean_jax.learning.manifests import check_manifest
from sean_jax.learning.protocol import seconds_of_each

if TYPE_CHECKING:
    from sean_jax.learning.demonstrations import Batch

MANIFEST = "dataset.json"
FORMAT = 1


@dataclasses.dataclass(frozen=True)
class Episode:
    """One demonstration of the dataset."""

    number: int  # also its index in the arrays
    stream: int
    length: int  # rows
    completed: bool


@dataclasses.dataclass
class Dataset:
    """A dataset on disk."""

    folder: Path
    manifest: dict[str, Any]  # the content of dataset.json
    part: tuple[int, int] = (1, 1)  # which of how many equal parts of the episodes is read; (3, 10) is the third of ten

    def description(self) -> CollectConfig:
        """What ``sean collect`` recorded, with the files of own parts as they are found from here.

        Raises:
            InputError: something else made the dataset, or a file is not what it was.
        """
        file, options = self.folder / MANIFEST, self.manifest["options"]
        if not self.manifest["command"].startswith("sean collect"):
            text = "was driven by hand or by another program, which cannot be simulated again"
            raise InputError(f"{self.folder}: {text}; record one with `sean collect`.")
        options = components.recorded(file, options, self.manifest.get("parts"), "parts")
        try:
            return validate(CollectConfig, options, source=file)
        except InputError as error:
            raise InputError(f"{file}: options: {error}") from None

    @property
    def batch(self) -> int:
        """Number of episodes in a shard."""
        return self.manifest["batch"]

    @property
    def rate(self) -> int:
        """Rows a second; 1 where the manifest does not say."""
        return int(self.manifest.get("rate", 1))

    @property
    def most_rows(self) -> int:
        """Number of rows that the arrays have for each episode."""
        return self.rate * self.manifest["seconds"]

    @property
    def stream_rows(self) -> list[int]:
        """Recorded rows of each stream."""
        rows = [0] * len(self.manifest["streams"])
        for shard in self.manifest["shards"]:
            rows[shard["stream"]] += sum(shard["lengths"])
        return rows

    @property
    def episodes(self) -> list[Episode]:
        """The episodes of the part; the last one of each stream ends where the time of the stream is used up.

        Parts take turns by episode, so that each has as much of every stream.
        """
        rows = self.rate * seconds_of_each(self.manifest["hours"], len(self.manifest["streams"]))
        left, episodes = [rows] * len(self.manifest["streams"]), []
        for index, shard in enumerate(self.manifest["shards"]):
            for place, length in enumerate(shard["lengths"]):
                length = min(length, left[shard["stream"]])
                if length > 0:
                    left[shard["stream"]] -= length
                    number = index * self.batch + place
                    episodes.append(Episode(number, shard["stream"], length, shard["completed"][place]))
        which, parts = self.part
        return episodes[which - 1 :: parts]

    @property
    def example_count(self) -> int:
        """Number of examples, one for each row."""
        return sum(episode.length for episode in self.episodes)

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the depth images [pixels]."""
        return self.manifest["camera"]["height"], self.manifest["camera"]["width"]

    @property
    def row_bytes(self) -> int:
        """Size of a row in memory [bytes]."""
        return sum(int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in self.fields.values())

    @property
    def fields(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """Shape and type of each field of a row."""
        return fields(*self.image_shape, len(self.manifest["situations"]))

    def fingerprint(self) -> str:
        """Hash of everything that decides what the examples are.

        Returns:
            16 hexadecimal digits of options, length and file sizes.
        """
        names = ("format", "options", "hours", "batch", "streams", "shards")
        told = {name: self.manifest[name] for name in names} | ({"part": self.part} if self.part != (1, 1) else {})
        text = json.dumps(told, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def read(self, episodes: list[Episode], names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
        """Read fields of rows.

        Args:
            names: of the fields; all if None.

        Returns:
            Name -> (R, ...) the rows of one episode after the other.

        Raises:
            IncompleteError: a file is missing or damaged.
        """
        total = sum(episode.length for episode in episodes)
        arrays = {}
        for name in self.fields if names is None else names:
            shape, kind = self.fields[name]
            array, done = np.empty((0, *shape), kind), 0
            for group in self._read_groups(episodes, sparse=name == "depth"):
                first, last = min(one.number for one in group), max(one.number for one in group)
                self._check_file(name, first // self.batch, len(shape) + 2)
                values = store.read(self.folder, name, first, last + 1)
                expected = (last + 1 - first, self.most_rows, *shape)
                if values.shape != expected or values.dtype != kind:
                    sizes = f"{values.shape} {values.dtype}, but by {MANIFEST} they are {expected} {kind}"
                    message = f"{self.folder / name}: the values are {sizes}; restore {MANIFEST} or collect anew."
                    raise IncompleteError(message)
                if done == 0:  # allocate only once the sizes in the manifest are confirmed
                    array = np.empty((total, *shape), kind)
                for one in group:
                    array[done : done + one.length] = values[one.number - first, : one.length]
                    done += one.length
            arrays[name] = array
        return arrays

    def recording(self, episodes: list[Episode]) -> Recording:
        """Read whole episodes.

        Raises:
            IncompleteError: a file is missing or damaged.
        """
        return recording_of(self.read(episodes), [episode.length for episode in episodes], self.rate)

    def commit(self, stream: int, batch: Batch, shard: int | None = None) -> None:
        """Write a batch of episodes as a shard, then name it in the manifest.

        Args:
            shard: index of a damaged shard that it replaces; the next new one if None.

        Raises:
            IncompleteError: it cannot be written. What was committed before stays.
        """
        index = len(self.manifest["shards"]) if shard is None else shard
        sizes = store.write(self.folder, index, batch.rows)
        lengths, completed = batch.lengths.tolist(), batch.completed.tolist()
        entry = {"stream": stream, "lengths": lengths, "completed": completed, "bytes": sizes}
        shards = list(self.manifest["shards"])
        shards[index : index + 1] = [entry]
        self.save({**self.manifest, "shards": shards})

    def save(self, manifest: dict[str, Any]) -> None:
        """Replace the manifest.

        Raises:
            IncompleteError: it cannot be written. What was committed before stays.
        """
        try:
            writing.write(self.folder / MANIFEST, json.dumps(manifest, indent=1) + "\n")
        except OSError as error:
            reason = writing.reason(error)
            raise IncompleteError(f"{self.folder}: {reason}; what was committed before is as it was.") from error
        self.manifest = manifest

    def damaged_shards(self) -> list[int]:
        """Find shards of which a file is missing or has another size than when it was written."""
        dimensions = {name: len(shape) + 2 for name, (shape, _) in self.fields.items()}
        return [
            index
            for index, shard in enumerate(self.manifest["shards"])
            if any(self._size(name, index, dimensions[name]) != size for name, size in shard["bytes"].items())
        ]

    def _read_groups(self, episodes: list[Episode], sparse: bool) -> list[list[Episode]]:
        """Cut the list into neighbors of one shard, which are read in one piece.

        If ``sparse``, episodes that lie far apart in a shard are read one by one.
        """
        groups = [list(group) for _, group in itertools.groupby(episodes, lambda one: one.number // self.batch)]
        if not sparse:
            return groups
        numbers = [[one.number for one in group] for group in groups]
        far_apart = [max(each) - min(each) >= 2 * len(each) for each in numbers]
        pairs = zip(groups, far_apart, strict=True)
        return [part for group, far in pairs for part in ([[one] for one in group] if far else [group])]

    def _size(self, name: str, shard: int, dimensions: int) -> int:
        file = store.path(self.folder, name, shard, dimensions)
        return file.stat().st_size if file.is_file() else -1

    def _check_file(self, name: str, shard: int, dimensions: int) -> None:
        """Raise for a missing file, which tensorstore would read as zeros."""
        if self._size(name, shard, dimensions) != self.manifest["shards"][shard]["bytes"][name]:
            file = store.path(self.folder, name, shard, dimensions)
            raise IncompleteError(f"the file {file} is missing or damaged; {store.CURE}")


def recording_of(fields: dict[str, np.ndarray], lengths: list[int], rate: int = 1) -> Recording:
    """Put the fields of whole episodes together.

    Args:
        fields: name -> (R, ...) the rows of one episode after the other.
        rate: rows a second.
    """
    each = np.array(lengths, np.int64)
    ends = np.cumsum(each)
    first, end = np.repeat(ends - each, each), np.repeat(ends, each)
    rows: Any = Row(**fields)  # pyright: ignore[reportArgumentType]
    return Recording(rows, first.astype(np.int32), end.astype(np.int32), rate)  # pyright: ignore[reportArgumentType]


def fields(height: int, width: int, situations: int) -> dict[str, tuple[tuple[int, ...], str]]:
    """Describe the fields of ``examples.Row``.

    Args:
        height: of a depth image [pixels].
        width: of a depth image [pixels].

    Returns:
        Name -> (shape, type).
    """
    return {
        "depth": ((height, width), "uint16"),
        "plan": ((POINTS, 2), "float32"),
        "pose": ((4,), "float32"),
        "velocity": ((2,), "float32"),
        "command": ((2,), "float32"),
        "situations": ((situations,), "bool"),
    }


def create_dataset(folder: Path, manifest: dict[str, Any]) -> Dataset:
    """Create a dataset without episodes. The manifest is written last.

    Args:
        folder: does not exist, or is empty.
        manifest: content of dataset.json, but for the format and the shards.

    Raises:
        InputError: the folder cannot be written.
        IncompleteError: the manifest cannot be written.
    """
    data = Dataset(folder, {"format": FORMAT, **manifest, "shards": []})
    try:
        store.create(folder, data.fields, data.batch, data.most_rows)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot write {folder}: {error}; choose another folder with --out.") from error
    data.save(data.manifest)
    return data


def open_dataset(folder: Path | str, part: tuple[int, int] = (1, 1)) -> Dataset:
    """Open a dataset for reading.

    Args:
        folder: the folder that ``sean collect`` or a ``Recorder`` has written.

    Raises:
        InputError: there is none, or this version cannot read it.
    """
    folder = Path(folder)
    file = folder / MANIFEST
    if not os.path.lexists(file):
        raise InputError(f"{folder} has no {MANIFEST}; make a dataset with `sean collect --out {folder}`.")
    try:
        manifest = files.read_json(file)
        version = manifest.get("format") if isinstance(manifest, dict) else None
        if isinstance(version, int) and version != FORMAT:
            raise InputError(f"{file} has format {version}, but this version reads {FORMAT}; collect anew.")
        check_manifest(file, manifest, tuple(fields(1, 1, 1)))
    except FileError as error:
        lines = str(error).splitlines()
        others = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
        message = f"{lines[0].rstrip('.')}{others}; {file} cannot be read: restore it or collect anew."
        raise InputError(message) from None
    return Dataset(folder, manifest, part)


def split(dataset: Dataset, share: float, seed: int) -> tuple[list[Episode], list[Episode]]:
    """Split the episodes into those to train and those to validate with. No episode is in both.

    Args:
        share: of the episodes that validate; at least one does.

    Raises:
        InputError: there are fewer than two episodes.
    """
    episodes = dataset.episodes
    if len(episodes) < 2:
        which, parts = dataset.part
        of = f" in part {which} of {parts}" if parts > 1 else ""
        text = f"{dataset.folder} has {len(episodes)} episodes{of}, too few to train and validate"
        raise InputError(f"{text}; collect more.")
    count = min(max(1, round(share * len(episodes))), len(episodes) - 1)
    chosen = set(prng.generator("validation", seed).permutation(len(episodes))[:count].tolist())
    training = [episode for index, episode in enumerate(episodes) if index not in chosen]
    return training, [episode for index, episode in enumerate(episodes) if index in chosen]


def on_device(recording: Recording) -> Recording:
    """Convert a recording to arrays of jax.

    Returns:
        The same on the default device.
    """
    return jax.tree.map(jnp.asarray, recording)

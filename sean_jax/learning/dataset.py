"""A dataset of demonstrations (section V-B): a manifest, and arrays in sharded zarr (version 3) through tensorstore.

The manifest ``dataset.json`` has the content and the options. It is replaced as a whole after each shard, and what it
does not name does not exist. Each stream uses the requested seconds of its episodes. Datasets may come from
other people: a manifest that this version would not write is refused, with the key that is wrong, before memory of the
sizes in it is allocated.

Each field of a row is an array (episodes, T, ...). A batch of episodes is one shard, which is one file for each field.
A committed file is never written again, so a kill cannot damage it. In the shards of the depth images each episode is
a chunk of its own. Every chunk has a checksum (crc32c).
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import pydantic

from sean_jax.config import MAX_HOURS, MAX_PIXELS, MAX_RATE, MAX_SHARD, MAX_SIDE, CollectConfig, user_parts, validate
from sean_jax.core import random_streams
from sean_jax.core.bounds import MAX_DURATION
from sean_jax.core.errors import FileError, IncompleteError, InputError
from sean_jax.io import files, writing
from sean_jax.learning.examples import DemonstrationRow, Recording
from sean_jax.mdp.observations import PLAN_POINTS

Count = Annotated[int, pydantic.Field(ge=0, le=10**9)]
Positive = Annotated[int, pydantic.Field(ge=1, le=MAX_SHARD)]
Side = Annotated[int, pydantic.Field(ge=1, le=MAX_SIDE)]  # pixels
Names = Annotated[list[str], pydantic.Field(max_length=1_000)]


# ------------------------------------------------------------------ manifest


class Keys(pydantic.BaseModel):
    """The keys of a file of JSON that are read; other keys are for people."""

    model_config = pydantic.ConfigDict(extra="ignore", allow_inf_nan=False)


class ImageSize(Keys):
    """Size of the depth images."""

    width: Side
    height: Side


class Shard(Keys):
    """A batch of episodes."""

    stream: Count
    lengths: list[Count]  # rows
    completed: list[bool]
    bytes: dict[str, Annotated[int, pydantic.Field(ge=0, lt=2**62)]]  # of the file of each field
    floors: list[Count] | None = None  # index of each episode's floor, if there are several
    trial: Annotated[str, pydantic.Field(max_length=300)] | None = None  # the file of the drive that it is from
    sha256: Annotated[str, pydantic.Field(pattern="^[0-9a-f]{64}$")] | None = None  # of that file
    rows: tuple[Count, Count] | None = None  # of the drive: the first, and the one after the last
    by_person: list[bool] | None = None  # of each row: whether a person drove


class RobotName(Keys):
    """The robot that was driven."""

    name: str


class Manifest(Keys):
    """The content of dataset.json."""

    command: str
    options: dict[str, Any]
    hours: Annotated[float, pydantic.Field(gt=0, le=MAX_HOURS)]
    batch: Positive
    seconds: Annotated[int, pydantic.Field(ge=1, le=MAX_DURATION)]  # of an episode, at most
    rate: Annotated[float, pydantic.Field(ge=1, le=MAX_RATE)]  # rows per second, a whole number
    streams: Annotated[Names, pydantic.Field(min_length=1)]
    situations: Names
    camera: ImageSize
    robot: RobotName
    shards: list[Shard]
    environments: Names = []  # of the floors, if there are several


def check_manifest(path: Path, data: Any, fields: tuple[str, ...]) -> None:
    """Refuse the content of a dataset.json that no dataset with these fields can have.

    Raises:
        FileError: names the key.
    """
    files.check_json(path, data, Manifest, lambda manifest: _check_relations(manifest, fields))


def _check_relations(manifest: Manifest, fields: tuple[str, ...]) -> Iterator[files.Problem]:
    if manifest.camera.width * manifest.camera.height > MAX_PIXELS:
        yield ("camera",), f"has more than {MAX_PIXELS:,} pixels"
    if manifest.rate != int(manifest.rate):
        yield ("rate",), f"{manifest.rate:g} is not a whole number"
    for number, shard in enumerate(manifest.shards):
        for key, problem in (*_check_episodes(manifest, shard), *_check_floors(manifest, shard)):
            yield ("shards", number, key), problem
        if missing := [name for name in fields if name not in shard.bytes]:
            yield ("shards", number, "bytes"), f"lacks {', '.join(missing)}"
        if unknown := [name for name in shard.bytes if name not in fields]:
            yield ("shards", number, "bytes"), f"has '{unknown[0][:40]}', which is no field of a row"


def _check_episodes(manifest: Manifest, shard: Shard) -> Iterator[tuple[str, str]]:
    """Key and problem of numbers that do not fit the manifest."""
    if shard.stream >= len(manifest.streams):
        yield "stream", f"{shard.stream} is none of the {len(manifest.streams)} streams"
    for name, values in (("lengths", shard.lengths), ("completed", shard.completed)):
        if len(values) != manifest.batch:
            yield name, f"has {len(values)} values, and a batch has {manifest.batch} episodes"
    rows = sum(shard.lengths)
    longest = max(shard.lengths, default=0)
    if shard.by_person is not None and len(shard.by_person) != rows:
        yield "by_person", f"has {len(shard.by_person)} values for {rows} rows"
    if longest > manifest.rate * manifest.seconds:
        yield "lengths", f"an episode is {longest / manifest.rate:g} s long, and {manifest.seconds} s are the most"


def _check_floors(manifest: Manifest, shard: Shard) -> Iterator[tuple[str, str]]:
    """As ``_check_episodes``, of floors."""
    count = len(manifest.environments)
    floors = shard.floors or []
    if shard.floors is None and not count:
        return
    if len(floors) != manifest.batch:
        yield "floors", f"has {len(floors)} values, and a batch has {manifest.batch} episodes"
    if max(floors, default=0) >= count:
        yield "floors", f"{max(floors)} is none of the {count} environments"


COMPRESSION = 3  # of the zstd compression
COMMITTED = "committed shards are unchanged."
CURE = "remove the damaged file, and `sean collect` with the same options records it again."


# ------------------------------------------------------------------ arrays in the store


def create_arrays(folder: Path, fields: dict[str, tuple[tuple[int, ...], str]], batch: int, rows: int) -> None:
    """Create arrays of fields, name -> (shape, type), without episodes, in a group that other readers of zarr
    recognize.

    Raises:
        OSError: the folder cannot be written.
        ValueError: tensorstore refuses the arrays.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, (shape, kind) in fields.items():
        shard = [batch, rows, *shape]
        chunk = [1, *shard[1:]] if len(shape) > 1 and kind == "uint16" else shard
        little = {"name": "bytes", "configuration": {"endian": "little"}}
        checksum = {"name": "crc32c"}
        order = {"name": "bytes"} if kind == "bool" else little
        sharding = {
            "chunk_shape": chunk,
            "codecs": [order, {"name": "zstd", "configuration": {"level": COMPRESSION}}, checksum],
            "index_codecs": [little, checksum],
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


def write_shard(folder: Path, shard: int, fields: dict[str, np.ndarray]) -> dict[str, int]:
    """Write a shard of fields, name -> (B, T, ...), durably; name -> size of its file [bytes].

    Raises:
        IncompleteError: it cannot be written, for example because the disk is full.
    """
    writes = []
    with writing.explain_errors(folder, COMMITTED, _store_reason):
        for name, values in fields.items():
            array = _open_array(folder / name)
            first, last = shard * len(values), (shard + 1) * len(values)
            if array.shape[0] < last:
                array = array.resize(exclusive_max=[last, *array.shape[1:]]).result()
            writes.append(array[first:last].write(values))
        for each in writes:
            each.result()
        return {name: shard_file(folder, name, shard, values.ndim).stat().st_size for name, values in fields.items()}


def read_array(folder: Path, name: str, first: int, last: int) -> np.ndarray:
    """One field (E, T, ...) of consecutive episodes.

    Raises:
        IncompleteError: a file is damaged.
    """
    with writing.explain_errors(folder / name, CURE, _store_reason):
        return np.asarray(_open_array(folder / name)[first:last].read().result())


def shard_file(folder: Path, name: str, shard: int, dimensions: int) -> Path:
    """The file of a shard of an array (episodes, T, ...) with so many dimensions."""
    return folder / name / "c" / str(shard) / "/".join("0" * (dimensions - 1))


def _open_array(folder: Path, more: dict[str, Any] | None = None) -> Any:
    import tensorstore

    files = {"driver": "file", "path": os.path.abspath(folder)}  # tensorstore takes no path with ".."
    # Shards of zeros are written as well, so that a missing file is always a lost one.
    spec = {"driver": "zarr3", "kvstore": files, "open": True, "store_data_equal_to_fill_value": True, **(more or {})}
    return tensorstore.open(spec).result()


def _store_reason(error: Exception) -> str:
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


MANIFEST = "dataset.json"
FORMAT = 1
WINDOW = 64  # episodes of a dataset on disk that are shuffled together


# ------------------------------------------------------------------ dataset


@dataclasses.dataclass(frozen=True)
class Episode:
    """One demonstration of the dataset."""

    number: int  # also its index in the arrays
    stream: int
    length: int  # rows
    completed: bool
    source: int = 0  # index of its dataset in a ``ConcatDataset``


@dataclasses.dataclass
class EpisodeBatch:
    """B episodes of at most T rows."""

    rows: dict[str, np.ndarray]  # field of DemonstrationRow -> (B, T, ...)
    lengths: np.ndarray  # (B,) rows of each episode
    completed: np.ndarray  # (B,) bool
    floors: np.ndarray | None = None  # (B,) index of each episode's floor, if there are several


@dataclasses.dataclass
class Dataset:
    """A dataset on disk."""

    folder: Path
    manifest: dict[str, Any]  # the content of dataset.json
    part: tuple[int, int] = (1, 1)  # number of the part, and number of equal parts; (3, 10) is the third of ten

    def description(self) -> CollectConfig:
        """The options of ``sean collect`` that recorded it, with the files of own parts as they lie from here.

        Raises:
            InputError: another program wrote the dataset, or a file has changed.
        """
        file = self.folder / MANIFEST
        options = self.manifest["options"]
        if not self.manifest["command"].startswith("sean collect"):
            raise InputError(
                f"{self.folder}: was driven by hand or by another program, which cannot be simulated again; "
                "record one with `sean collect`."
            )
        options = user_parts.recorded(file, options, self.manifest.get("parts"), "parts")
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
        """Rows per second."""
        return int(self.manifest["rate"])

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
        rows = self.rate * stream_seconds(self.manifest["hours"], len(self.manifest["streams"]))
        left = [rows] * len(self.manifest["streams"])
        episodes = []
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
        """16 hexadecimal digits of everything that decides the examples: options, length and file sizes."""
        names = ("format", "options", "hours", "batch", "streams", "shards")
        content = {name: self.manifest[name] for name in names} | ({"part": self.part} if self.part != (1, 1) else {})
        text = json.dumps(content, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def read(self, episodes: Sequence[Episode], names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
        """Fields of the rows of one episode after the other, name -> (R, ...); all fields if ``names`` is None.

        Raises:
            IncompleteError: a file is missing or damaged.
        """
        names = tuple(self.fields) if names is None else names
        return {name: self._read_field(name, episodes) for name in names}

    def _read_field(self, name: str, episodes: Sequence[Episode]) -> np.ndarray:
        """(R, ...) of one field."""
        shape, kind = self.fields[name]
        rows = np.empty((0, *shape), kind)
        done = 0
        for group in self._read_groups(episodes, sparse=name == "depth"):
            first, values = self._read_group(name, group)
            if done == 0:  # allocate only once the sizes in the manifest are confirmed
                rows = np.empty((sum(episode.length for episode in episodes), *shape), kind)
            for episode in group:
                rows[done : done + episode.length] = values[episode.number - first, : episode.length]
                done += episode.length
        return rows

    def _read_group(self, name: str, group: Sequence[Episode]) -> tuple[int, np.ndarray]:
        """The first number, and the values from the first to the last episode of a group of one shard."""
        numbers = [episode.number for episode in group]
        first, last = min(numbers), max(numbers)
        shard = first // self.batch
        if self._size(name, shard) != self.manifest["shards"][shard]["bytes"][name]:  # it would read as zeros
            raise IncompleteError(f"the file {self._file(name, shard)} is missing or damaged; {CURE}")
        values = read_array(self.folder, name, first, last + 1)

        shape, kind = self.fields[name]
        expected = (last + 1 - first, self.most_rows, *shape)
        if values.shape != expected or values.dtype != kind:
            raise IncompleteError(
                f"{self.folder / name}: the values are {values.shape} {values.dtype}, but by {MANIFEST} they are "
                f"{expected} {kind}; restore {MANIFEST} or collect again."
            )
        return first, values

    def recording(self, episodes: Sequence[Episode]) -> Recording:
        """Whole episodes, one after the other.

        Raises:
            IncompleteError: a file is missing or damaged.
        """
        lengths = np.array([episode.length for episode in episodes], np.int64)
        ends = np.cumsum(lengths)
        first, end = (np.repeat(rows, lengths).astype(np.int32) for rows in (ends - lengths, ends))
        rows: Any = DemonstrationRow(**self.read(episodes))  # pyright: ignore[reportArgumentType]
        return Recording(rows, first, end, self.rate)  # pyright: ignore[reportArgumentType]

    def by_person(self, episodes: Sequence[Episode]) -> np.ndarray:
        """(R,) whether a person drove at each row of the episodes; all rows of a dataset that does not say it."""
        columns = [np.ones(0, bool)]
        for episode in episodes:
            told = self.manifest["shards"][episode.number // self.batch].get("by_person")
            columns.append(np.ones(episode.length, bool) if told is None else np.asarray(told[: episode.length], bool))
        return np.concatenate(columns)

    def commit(
        self, stream: int, batch: EpisodeBatch, shard: int | None = None, about: Mapping[str, Any] | None = None
    ) -> None:
        """Write a batch of episodes as a shard, then name it in the manifest.

        Args:
            shard: index of a damaged shard that it replaces; the next new one if None.
            about: further entries of the shard in the manifest.

        Raises:
            IncompleteError: it cannot be written. Shards that were committed before are kept.
        """
        index = len(self.manifest["shards"]) if shard is None else shard
        sizes = write_shard(self.folder, index, batch.rows)
        lengths = batch.lengths.tolist()
        completed = batch.completed.tolist()
        entry = {"stream": stream, "lengths": lengths, "completed": completed, "bytes": sizes}
        if batch.floors is not None:
            entry["floors"] = batch.floors.tolist()
        entry |= about or {}
        shards = list(self.manifest["shards"])
        shards[index : index + 1] = [entry]
        self.save({**self.manifest, "shards": shards})

    def cut(self, shards: int) -> None:
        """Forget the shards after the first so many, and remove their files.

        Raises:
            IncompleteError: the manifest cannot be written.
        """
        count = len(self.manifest["shards"])
        self.save({**self.manifest, "shards": self.manifest["shards"][:shards]})
        for index in range(shards, count):
            for name in self.fields:
                self._file(name, index).unlink(missing_ok=True)

    def save(self, manifest: dict[str, Any]) -> None:
        """Replace the manifest.

        Raises:
            IncompleteError: it cannot be written. Shards that were committed before are kept.
        """
        with writing.explain_errors(self.folder, COMMITTED):
            writing.write(self.folder / MANIFEST, manifest)
        self.manifest = manifest

    def damaged_shards(self) -> list[int]:
        """Find shards of which a file is missing or has another size than when it was written."""
        return [
            index
            for index, shard in enumerate(self.manifest["shards"])
            if any(self._size(name, index) != size for name, size in shard["bytes"].items())
        ]

    def _read_groups(self, episodes: Sequence[Episode], sparse: bool) -> list[list[Episode]]:
        """Cut the list into neighbors of one shard, which are read in one piece.

        If ``sparse``, episodes that lie far apart in a shard are read one by one.
        """
        groups = []
        for _, neighbors in itertools.groupby(episodes, lambda episode: episode.number // self.batch):
            group = list(neighbors)
            numbers = [episode.number for episode in group]
            far_apart = max(numbers) - min(numbers) >= 2 * len(group)
            groups += [[episode] for episode in group] if sparse and far_apart else [group]
        return groups

    def _file(self, name: str, shard: int) -> Path:
        return shard_file(self.folder, name, shard, len(self.fields[name][0]) + 2)

    def _size(self, name: str, shard: int) -> int:
        file = self._file(name, shard)
        return file.stat().st_size if file.is_file() else -1


def fields(height: int, width: int, situations: int) -> dict[str, tuple[tuple[int, ...], str]]:
    """Name -> (shape, type) of the fields of a ``DemonstrationRow``, for depth images of height x width pixels."""
    return {
        "depth": ((height, width), "uint16"),
        "plan": ((PLAN_POINTS, 2), "float32"),
        "pose": ((4,), "float32"),
        "velocity": ((2,), "float32"),
        "command": ((2,), "float32"),
        "situations": ((situations,), "bool"),
    }


def create_dataset(folder: Path, manifest: dict[str, Any]) -> Dataset:
    """A dataset without episodes. The manifest is written last.

    Args:
        folder: does not exist, or is empty.
        manifest: content of dataset.json without the format and the shards.

    Raises:
        InputError: the folder cannot be written.
        IncompleteError: the manifest cannot be written.
    """
    data = Dataset(folder, {"format": FORMAT, **manifest, "shards": []})
    try:
        create_arrays(folder, data.fields, data.batch, data.most_rows)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot write {folder}: {error}; choose another folder with --out.") from error
    data.save(data.manifest)
    return data


def open_dataset(folder: Path | str, part: tuple[int, int] = (1, 1)) -> Dataset:
    """The dataset that ``sean collect`` or a ``Recorder`` has written, for reading.

    Args:
        part: (3, 10) reads the third of ten equal parts of its episodes.

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
            raise InputError(f"{file} has format {version}, but this version reads {FORMAT}; collect again.")
        check_manifest(file, manifest, tuple(fields(1, 1, 1)))
    except FileError as error:
        lines = str(error).splitlines()
        others = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
        message = f"{lines[0].rstrip('.')}{others}; {file} cannot be read: restore it or collect again."
        raise InputError(message) from None
    return Dataset(folder, manifest, part)


def split(dataset: Dataset, share: float, seed: int) -> tuple[list[Episode], list[Episode]]:
    """The episodes to train with and those to validate with: a ``share`` of all, at least one.

    Raises:
        InputError: there are fewer than two episodes.
    """
    episodes = dataset.episodes
    if len(episodes) < 2:
        which, parts = dataset.part
        if parts > 1:
            raise InputError(
                f"{dataset.folder} has {len(episodes)} episodes in part {which} of {parts}, too few to train and "
                "validate; collect more."
            )
        raise InputError(f"{dataset.folder} has {len(episodes)} episodes, too few to train and validate; collect more.")
    count = min(max(1, round(share * len(episodes))), len(episodes) - 1)
    chosen = set(random_streams.generator("validation", seed).permutation(len(episodes))[:count].tolist())
    training = [episode for index, episode in enumerate(episodes) if index not in chosen]
    return training, [episode for index, episode in enumerate(episodes) if index in chosen]


def on_device(recording: Recording) -> Recording:
    """The recording as arrays of jax, on the default device."""
    return jax.tree.map(jnp.asarray, recording)


def fill_up(recording: Recording, count: int) -> Recording:
    """A recording of ``count`` rows, the last of them zeros."""

    def fill(leaf: np.ndarray) -> np.ndarray:
        return np.concatenate([leaf, np.zeros((count - len(leaf), *leaf.shape[1:]), leaf.dtype)])

    return jax.tree.map(fill, recording)


def windows(
    data: Dataset, episodes: Sequence[Episode], batch: int, seed: int = 0, epoch: int = 0, size: int = WINDOW
) -> Iterator[tuple[Recording, np.ndarray]]:
    """Some episodes at a time, of a dataset that does not fit in the memory of the device, and (N, batch) batches of
    their rows in random order, of which -1 fills the last.

    All recordings are filled up to equal sizes. The order depends on (seed, epoch) alone.

    Args:
        size: number of episodes that are in memory, and shuffled together.

    Raises:
        IncompleteError: a file is missing or damaged.
    """
    random = random_streams.generator("order", seed, epoch)
    order = random.permutation(len(episodes))
    count = sum(sorted((episode.length for episode in episodes), reverse=True)[:size])
    for first in range(0, len(order), size):
        window = [episodes[index] for index in sorted(order[first : first + size])]  # as they lie on disk
        recording = data.recording(window)
        rows = random.permutation(len(recording.first))
        rows = np.concatenate([rows, np.full(-len(rows) % batch, -1)]).astype(np.int32)
        yield fill_up(recording, count), rows.reshape(-1, batch)


def stream_seconds(hours: float, number: int) -> int:
    """How long each of some streams is recorded."""
    return math.ceil(3600.0 * hours / number - 1e-6)


# ------------------------------------------------------------------ several datasets


class ConcatDataset(Dataset):
    """Datasets of equal cameras, situations and rate, read as one; folder and manifest are the first dataset's."""

    def __init__(self, parts: list[Dataset]):
        super().__init__(parts[0].folder, parts[0].manifest)
        self.parts = parts

    @property
    def episodes(self) -> list[Episode]:
        """The episodes of all."""
        return [dataclasses.replace(each, source=n) for n, part in enumerate(self.parts) for each in part.episodes]

    def fingerprint(self) -> str:
        """16 hexadecimal digits of everything that affects the examples; the dataset's own if it is the only one."""
        prints = [part.fingerprint() for part in self.parts]
        return prints[0] if len(prints) == 1 else hashlib.sha256(" ".join(prints).encode()).hexdigest()[:16]

    def read(self, episodes: Sequence[Episode], names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
        """As ``Dataset.read``."""
        groups = itertools.groupby(episodes, lambda episode: episode.source)
        arrays = [self.parts[source].read(list(group), names) for source, group in groups]
        if len(arrays) == 1:
            return arrays[0]
        if not arrays:
            return self.parts[0].read([], names)
        return {name: np.concatenate([array[name] for array in arrays]) for name in arrays[0]}


def open_datasets(folders: Sequence[Path], part: tuple[int, int] = (1, 1)) -> ConcatDataset:
    """Datasets to learn from together; ``part`` is of the first, as in ``open_dataset``; the others are read whole.

    Raises:
        InputError: one is none, or has other images, situations or another rate than the first.
    """
    first, *others = (open_dataset(folder, (1, 1) if more else part) for more, folder in enumerate(folders))
    for other in others:
        for name in ("camera", "situations"):
            theirs = other.manifest[name]
            ours = first.manifest[name]
            if theirs != ours:
                raise InputError(f"{other.folder} has {name} {theirs}, and {first.folder} {ours}; collect the same.")
        if other.rate != first.rate:
            raise InputError(
                f"{other.folder} has {other.rate} examples per second, and {first.folder} {first.rate}; "
                "collect with the same --rate."
            )
    return ConcatDataset([first, *others])


def split_each(data: ConcatDataset, share: float, seed: int) -> tuple[list[Episode], list[Episode]]:
    """``split`` of each dataset: what validates one training also validates the next, with more datasets.

    Raises:
        InputError: a dataset has fewer than two episodes.
    """
    training: list[Episode] = []
    validation: list[Episode] = []
    for number, part in enumerate(data.parts):
        for episodes, chosen in zip((training, validation), split(part, share, seed), strict=True):
            episodes += [dataclasses.replace(episode, source=number) for episode in chosen]
    return training, validation

"""A dataset of demonstrations (section V-B): a manifest, and arrays in a store.

``dataset.json`` says what was recorded and how, and is replaced as a whole after each shard: what it does not name
does not exist. Of the episodes, each stream keeps as many seconds as were asked for.
"""

import dataclasses
import hashlib
import itertools
import json
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import chance, files, writing
from sean_jax.learning import store
from sean_jax.learning.examples import Recording
from sean_jax.learning.manifests import check_manifest
from sean_jax.learning.options import Failed, Refused
from sean_jax.learning.protocol import share
from sean_jax.learning.rows import POINTS, Row

MANIFEST = "dataset.json"
FORMAT = 1


@dataclasses.dataclass(frozen=True)
class Episode:
    """One demonstration that takes part."""

    number: int  # also its place in the arrays
    stream: int
    length: int  # rows
    completed: bool


@dataclasses.dataclass
class Dataset:
    """A dataset on disk. ``manifest`` is the content of its dataset.json."""

    folder: Path
    manifest: dict[str, Any]

    @property
    def batch(self) -> int:
        """Episodes in a shard."""
        return self.manifest["batch"]

    @property
    def recorded(self) -> list[int]:
        """Seconds of each stream."""
        seconds = [0] * len(self.manifest["streams"])
        for shard in self.manifest["shards"]:
            seconds[shard["stream"]] += sum(shard["lengths"])
        return seconds

    @property
    def episodes(self) -> list[Episode]:
        """Those that take part, the last of each stream cut where its time is up."""
        most = share(self.manifest["hours"], len(self.manifest["streams"]))
        left, found = [most] * len(self.manifest["streams"]), []
        for index, shard in enumerate(self.manifest["shards"]):
            for place, length in enumerate(shard["lengths"]):
                length = min(length, left[shard["stream"]])
                if length > 0:
                    left[shard["stream"]] -= length
                    number = index * self.batch + place
                    found.append(Episode(number, shard["stream"], length, shard["completed"][place]))
        return found

    @property
    def examples(self) -> int:
        """One a second."""
        return sum(episode.length for episode in self.episodes)

    @property
    def image(self) -> tuple[int, int]:
        """Height and width of the depth images."""
        return self.manifest["camera"]["height"], self.manifest["camera"]["width"]

    @property
    def row_bytes(self) -> int:
        """Bytes of a row in memory."""
        return sum(int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in self.fields.values())

    @property
    def fields(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """Shape and type of each field of a row."""
        return fields(*self.image, len(self.manifest["situations"]))

    def fingerprint(self) -> str:
        """Of all that decides what the examples are: options, length and the sizes of the files."""
        kept = {name: self.manifest[name] for name in ("format", "options", "hours", "batch", "streams", "shards")}
        return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]

    def read(self, episodes: list[Episode], names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
        """The fields of those names, all if None, of those episodes: (R, ...) each, one episode after the other.

        Raises Failed if a file is missing or damaged.
        """
        total = sum(episode.length for episode in episodes)
        found = {}
        for name in self.fields if names is None else names:
            shape, kind = self.fields[name]
            whole, done = np.empty((0, *shape), kind), 0
            for group in self._together(episodes, name == "depth"):
                first, last = min(one.number for one in group), max(one.number for one in group)
                self._check_file(name, first // self.batch, len(shape) + 2)
                values = store.read(self.folder, name, first, last + 1)
                told = (last + 1 - first, self.manifest["seconds"], *shape)
                if values.shape != told or values.dtype != kind:
                    sizes = f"{values.shape} {values.dtype}, but by {MANIFEST} they are {told} {kind}"
                    raise Failed(f"{self.folder / name}: the values are {sizes}; restore {MANIFEST} or collect anew.")
                if done == 0:  # not before it is known that there is as much
                    whole = np.empty((total, *shape), kind)
                for one in group:
                    whole[done : done + one.length] = values[one.number - first, : one.length]
                    done += one.length
            found[name] = whole
        return found

    def recording(self, episodes: list[Episode]) -> Recording:
        """Those episodes as numpy arrays. Raises Failed if a file is missing or damaged."""
        lengths = np.array([episode.length for episode in episodes], np.int64)
        ends = np.cumsum(lengths)
        first, end = np.repeat(ends - lengths, lengths), np.repeat(ends, lengths)
        rows: Any = Row(**self.read(episodes))  # pyright: ignore[reportArgumentType]
        return Recording(rows, first.astype(np.int32), end.astype(np.int32))  # pyright: ignore[reportArgumentType]

    def _together(self, episodes: list[Episode], alone: bool) -> list[list[Episode]]:
        """Neighbours in the list that lie in one shard, to be read in one piece; ``alone``, if they lie far apart."""
        groups = [list(group) for _, group in itertools.groupby(episodes, lambda one: one.number // self.batch)]
        if not alone:
            return groups
        numbers = [[one.number for one in group] for group in groups]
        sparse = [max(each) - min(each) >= 2 * len(each) for each in numbers]
        pairs = zip(groups, sparse, strict=True)
        return [part for group, far in pairs for part in ([[one] for one in group] if far else [group])]

    def commit(self, stream: int, batch: Any, shard: int | None = None) -> None:
        """Write a batch (demonstrations.Batch) as the next shard, or as one that was lost, and then name it.

        Raises Failed if it cannot be written; what was committed before stays.
        """
        index = len(self.manifest["shards"]) if shard is None else shard
        sizes = store.write(self.folder, index, batch.rows)
        lengths, completed = batch.lengths.tolist(), batch.completed.tolist()
        entry = {"stream": stream, "lengths": lengths, "completed": completed, "bytes": sizes}
        shards = list(self.manifest["shards"])
        shards[index : index + 1] = [entry]
        self.save({**self.manifest, "shards": shards})

    def save(self, manifest: dict[str, Any]) -> None:
        """Replace the manifest. Raises Failed if it cannot be written."""
        try:
            writing.write(self.folder / MANIFEST, json.dumps(manifest, indent=1) + "\n")
        except OSError as error:
            raise Failed(f"{self.folder}: {writing.reason(error)}; what was committed before is as it was.") from error
        self.manifest = manifest

    def lost(self) -> list[int]:
        """Shards of which a file is missing or has another size than it had."""
        dimensions = {name: len(shape) + 2 for name, (shape, _) in self.fields.items()}
        return [
            index
            for index, shard in enumerate(self.manifest["shards"])
            if any(self._size(name, index, dimensions[name]) != size for name, size in shard["bytes"].items())
        ]

    def _size(self, name: str, shard: int, dimensions: int) -> int:
        file = store.path(self.folder, name, shard, dimensions)
        return file.stat().st_size if file.is_file() else -1

    def _check_file(self, name: str, shard: int, dimensions: int) -> None:
        """A missing file would read as zeros."""
        if self._size(name, shard, dimensions) != self.manifest["shards"][shard]["bytes"][name]:
            file = store.path(self.folder, name, shard, dimensions)
            raise Failed(f"the file {file} is missing or damaged; {store.CURE}")


def fields(height: int, width: int, situations: int) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and type of each field of ``rows.Row``."""
    return {
        "depth": ((height, width), "uint16"),
        "plan": ((POINTS, 2), "float32"),
        "pose": ((4,), "float32"),
        "velocity": ((2,), "float32"),
        "command": ((2,), "float32"),
        "situations": ((situations,), "bool"),
    }


def create_dataset(folder: Path, manifest: dict[str, Any]) -> Dataset:
    """An empty dataset in a folder that does not exist or is empty; the manifest comes last."""
    made = Dataset(folder, {"format": FORMAT, **manifest, "shards": []})
    try:
        store.create(folder, made.fields, made.batch, manifest["seconds"])
    except (OSError, ValueError) as error:
        raise Refused(f"cannot write {folder}: {error}; choose another folder with --out.") from error
    made.save(made.manifest)
    return made


def open_dataset(folder: Path | str) -> Dataset:
    """The dataset in a folder. Raises Refused if there is none, or none that this version reads."""
    folder = Path(folder)
    file = folder / MANIFEST
    if not os.path.lexists(file):
        raise Refused(f"{folder} has no {MANIFEST}; make a dataset with `sean collect --out {folder}`.")
    try:
        manifest = files.read_json(file)
        known = manifest.get("format") if isinstance(manifest, dict) else None
        if isinstance(known, int) and known != FORMAT:
            raise Refused(f"{file} has format {known}, but this version reads {FORMAT}; collect anew.")
        check_manifest(file, manifest, tuple(fields(1, 1, 1)))
    except files.FileError as error:
        more = str(error).splitlines()
        others = f" (and {len(more) - 1} more)" if len(more) > 1 else ""
        raise Refused(f"{more[0].rstrip('.')}{others}; {file} cannot be read: restore it or collect anew.") from None
    return Dataset(folder, manifest)


def split(dataset: Dataset, share: float, seed: int) -> tuple[list[Episode], list[Episode]]:
    """Episodes to train with and, as a share of them, to validate with; whole episodes, so that none is in both.

    Raises Refused if there are fewer than two.
    """
    episodes = dataset.episodes
    if len(episodes) < 2:
        raise Refused(f"{dataset.folder} has {len(episodes)} episodes, too few to train and validate; collect more.")
    count = min(max(1, round(share * len(episodes))), len(episodes) - 1)
    chosen = set(chance.generator("validation", seed).permutation(len(episodes))[:count].tolist())
    kept = [episode for index, episode in enumerate(episodes) if index not in chosen]
    return kept, [episode for index, episode in enumerate(episodes) if index in chosen]


def on_device(recording: Recording) -> Recording:
    """The recording as arrays of jax."""
    return jax.tree.map(jnp.asarray, recording)

"""Several datasets that are learned from together, read as if they were one."""

import dataclasses
import hashlib
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.errors import InputError
from sean_jax.learning.dataset import Dataset, Episode, open_dataset, recording_of, split
from sean_jax.learning.examples import Recording


@dataclasses.dataclass(frozen=True)
class Member:
    """An episode of one of the datasets."""

    part: int  # index of the dataset
    episode: Episode

    @property
    def length(self) -> int:
        """Number of rows."""
        return self.episode.length


@dataclasses.dataclass
class Several:
    """Datasets of the same cameras, situations and rate. It has what training asks of a ``Dataset``."""

    parts: list[Dataset]

    @property
    def folder(self) -> Path:
        """That of the first."""
        return self.parts[0].folder

    @property
    def manifest(self) -> dict[str, Any]:
        """That of the first."""
        return self.parts[0].manifest

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the depth images [pixels]."""
        return self.parts[0].image_shape

    @property
    def rate(self) -> int:
        """Rows a second."""
        return self.parts[0].rate

    @property
    def fields(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """Shape and type of each field of a row."""
        return self.parts[0].fields

    @property
    def row_bytes(self) -> int:
        """Size of a row in memory [bytes]."""
        return self.parts[0].row_bytes

    @property
    def example_count(self) -> int:
        """Number of examples of all."""
        return sum(part.example_count for part in self.parts)

    def fingerprint(self) -> str:
        """Hash of everything that decides what the examples are.

        Returns:
            16 hexadecimal digits; those of the dataset, if there is one alone.
        """
        prints = [part.fingerprint() for part in self.parts]
        return prints[0] if len(prints) == 1 else hashlib.sha256(" ".join(prints).encode()).hexdigest()[:16]

    def read(self, episodes: Sequence[Member], names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
        """Read fields of rows.

        Args:
            names: of the fields; all if None.

        Returns:
            Name -> (R, ...) the rows of one episode after the other.

        Raises:
            IncompleteError: a file is missing or damaged.
        """
        found = []
        for part, members in itertools.groupby(episodes, lambda member: member.part):
            found.append(self.parts[part].read([member.episode for member in members], names))
        if len(found) == 1:
            return found[0]
        if not found:
            return self.parts[0].read([], names)
        return {name: np.concatenate([one[name] for one in found]) for name in found[0]}

    def recording(self, episodes: Sequence[Member]) -> Recording:
        """Read whole episodes.

        Raises:
            IncompleteError: a file is missing or damaged.
        """
        return recording_of(self.read(episodes), [episode.length for episode in episodes], self.rate)


def open_datasets(folders: Sequence[Path], part: tuple[int, int] = (1, 1)) -> Several:
    """Open datasets to learn from them together.

    Args:
        folders: that ``sean collect`` or a ``Recorder`` has written.
        part: which of how many equal parts of the first one's episodes; of the others all are read.

    Raises:
        InputError: one is none, or has other images, situations or another rate than the first.
    """
    first, *others = (open_dataset(folder, (1, 1) if more else part) for more, folder in enumerate(folders))
    for other in others:
        for name in ("camera", "situations"):
            had, wanted = other.manifest[name], first.manifest[name]
            if had != wanted:
                raise InputError(f"{other.folder} has {name} {had}, and {first.folder} {wanted}; collect the same.")
        if other.rate != first.rate:
            rates = f"{other.folder} has {other.rate} examples a second, and {first.folder} {first.rate}"
            raise InputError(f"{rates}; collect with the same --rate.")
    return Several([first, *others])


def split_each(several: Several, share: float, seed: int) -> tuple[list[Member], list[Member]]:
    """Split the episodes of each dataset: what validates one training also validates the next, with more datasets.

    Args:
        share: of the episodes that validate; at least one of each dataset does.

    Raises:
        InputError: a dataset has fewer than two episodes.
    """
    training: list[Member] = []
    validation: list[Member] = []
    for number, part in enumerate(several.parts):
        for members, episodes in zip((training, validation), split(part, share, seed), strict=True):
            members += [Member(number, episode) for episode in episodes]
    return training, validation

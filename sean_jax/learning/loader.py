"""The loader: shuffled batches of examples from disk, for datasets that do not fit a device's memory.

Episodes are shuffled, and examples within a window of some episodes, so that few episodes are in memory at a time. The
order comes from (seed, epoch) alone: a token, which is two numbers, says where to go on after an interruption.
"""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from sean_jax import chance
from sean_jax.learning.dataset import Dataset, Episode
from sean_jax.learning.examples import Example, Recording, example
from sean_jax.learning.rows import Row


class Token(NamedTuple):
    """Where a loader is: keep it in a checkpoint."""

    epoch: int = 0
    batch: int = 0


@dataclasses.dataclass
class Loader:
    """Batches of examples of some episodes."""

    dataset: Dataset
    episodes: list[Episode]
    batch: int = 1024
    seed: int = 0
    window: int = 64  # episodes that are shuffled together
    shuffle: bool = True

    @property
    def batches(self) -> int:
        """In an epoch."""
        return -(-sum(episode.length for episode in self.episodes) // self.batch)

    def epoch(self, token: Token = Token()) -> Iterator[tuple[Token, Example, np.ndarray]]:  # noqa: B008
        """The batches that are left of the token's epoch: a token that goes on after it, B examples, and weights (B,).

        The last batch is filled with examples of weight zero. Raises Failed if a file is missing or damaged.
        """
        whose, when = self._order(token.epoch)
        held: dict[int, Recording] = {}
        for number in range(token.batch, self.batches):
            part = slice(number * self.batch, (number + 1) * self.batch)
            chosen, second = whose[part], when[part]
            weight = np.ones(self.batch, np.float32)
            weight[len(chosen) :] = 0.0
            spare = self.batch - len(chosen)
            chosen = np.concatenate([chosen, np.full(spare, chosen[0])])
            second = np.concatenate([second, np.full(spare, second[0])])
            needed = np.unique(chosen)
            held = {int(one): held.get(int(one)) or self._read(int(one)) for one in needed}
            recording = _joined([held[int(one)] for one in needed])
            begin = np.cumsum([0, *(self.episodes[one].length for one in needed)])
            index = begin[np.searchsorted(needed, chosen)] + second
            following = Token(token.epoch, number + 1) if number + 1 < self.batches else Token(token.epoch + 1, 0)
            yield following, example(recording, index.astype(np.int32), np), weight

    def _order(self, epoch: int) -> tuple[np.ndarray, np.ndarray]:
        """(R,) which episode and (R,) which of its seconds, in the order of that epoch."""
        random = chance.generator("order", self.seed, epoch)
        count = len(self.episodes)
        episodes = random.permutation(count) if self.shuffle else np.arange(count)
        whose, when = [], []
        for begin in range(0, count, self.window):
            some = episodes[begin : begin + self.window]
            lengths = np.array([self.episodes[one].length for one in some])
            owner = np.repeat(some, lengths)
            second = np.concatenate([np.arange(length) for length in lengths])
            mixed = random.permutation(len(owner)) if self.shuffle else np.arange(len(owner))
            whose.append(owner[mixed])
            when.append(second[mixed])
        return np.concatenate(whose), np.concatenate(when)

    @functools.cached_property
    def _small(self) -> dict[str, np.ndarray]:
        """All but the images, of all episodes: small enough to be held in memory."""
        return self.dataset.read(self.episodes, tuple(name for name in self.dataset.fields if name != "depth"))

    @functools.cached_property
    def _begin(self) -> np.ndarray:
        """(E + 1,) where each episode begins in it."""
        return np.cumsum([0, *(episode.length for episode in self.episodes)])

    def _read(self, index: int) -> Recording:
        """One episode."""
        begin, end = self._begin[index : index + 2]
        depth = self.dataset.read([self.episodes[index]], ("depth",))
        rows: Any = {name: values[begin:end] for name, values in self._small.items()}
        length: Any = np.full(int(end - begin), end - begin, np.int32)
        return Recording(Row(**rows, **depth), 0 * length, length)  # pyright: ignore[reportArgumentType]


def _joined(parts: list[Recording]) -> Recording:
    """Recordings one after the other."""
    begin = np.cumsum([0, *(len(part.first) for part in parts)]).astype(np.int32)
    shifted = [
        Recording(part.rows, part.first + shift, part.end + shift) for part, shift in zip(parts, begin, strict=False)
    ]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *shifted)

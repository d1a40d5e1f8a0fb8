"""The order in which examples are learned: batches from disk, and balanced probabilities (section V-C).

A ``Loader`` reads shuffled batches of a dataset that does not fit in the memory of the device. It shuffles the
episodes, and the examples within a window of some episodes, so that few episodes are in memory at a time. The order
depends on (seed, epoch) alone, so a token of two numbers says where to continue after an interruption.

``balanced_probabilities`` makes all social situations equally frequent. The paper suggests to train more on situations
in which a policy does badly. Situations overlap, so an example cannot be drawn for one of them alone. Iterative
proportional fitting (Deming & Stephan, 1940) finds the probabilities: each turn scales the probability of an example by
how much its situations are short of an equal share.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from sean_jax import prng
from sean_jax.learning.examples import Example, Recording, Row, example

FITTING_TURNS = 500


class Token(NamedTuple):
    """Where a loader is. It can be stored in a checkpoint."""

    epoch: int = 0
    batch: int = 0


@dataclasses.dataclass
class Loader:
    """Batches of the examples of some episodes."""

    dataset: Any  # Dataset or Several
    episodes: Sequence[Any]  # of it: Episode or Member
    batch: int = 1024  # examples
    seed: int = 0
    window: int = 64  # episodes that are shuffled together
    shuffle: bool = True

    @property
    def batches(self) -> int:
        """Number of batches in an epoch."""
        return -(-sum(episode.length for episode in self.episodes) // self.batch)

    def epoch(self, token: Token = Token()) -> Iterator[tuple[Token, Example, np.ndarray]]:  # noqa: B008
        """Iterate over the batches that remain of an epoch.

        Returns:
            For each batch: the token that continues after it, examples (B, ...) as numpy arrays, and weights (B,).
            Examples of weight zero fill the last batch.

        Raises:
            IncompleteError: a file is missing or damaged.
        """
        owner, row = self._order(token.epoch)
        cache: dict[int, Recording] = {}
        for number in range(token.batch, self.batches):
            part = slice(number * self.batch, (number + 1) * self.batch)
            owners, rows = owner[part], row[part]
            weight = np.ones(self.batch, np.float32)
            weight[len(owners) :] = 0.0
            spare = self.batch - len(owners)
            owners = np.concatenate([owners, np.full(spare, owners[0])])
            rows = np.concatenate([rows, np.full(spare, rows[0])])
            unique = np.unique(owners)
            cache = {int(one): cache.get(int(one)) or self._read(int(one)) for one in unique}
            recording = _join([cache[int(one)] for one in unique])
            first = np.cumsum([0, *(self.episodes[one].length for one in unique)])
            index: Any = (first[np.searchsorted(unique, owners)] + rows).astype(np.int32)
            following = Token(token.epoch, number + 1) if number + 1 < self.batches else Token(token.epoch + 1, 0)
            yield following, example(recording, index, np), weight

    def _order(self, epoch: int) -> tuple[np.ndarray, np.ndarray]:
        """(R,) index of the episode and (R,) row in it of each example, in the order of that epoch."""
        random = prng.generator("order", self.seed, epoch)
        count = len(self.episodes)
        episodes = random.permutation(count) if self.shuffle else np.arange(count)
        owners, rows = [], []
        for first in range(0, count, self.window):
            window = episodes[first : first + self.window]
            lengths = np.array([self.episodes[one].length for one in window])
            owner = np.repeat(window, lengths)
            row = np.concatenate([np.arange(length) for length in lengths])
            order = random.permutation(len(owner)) if self.shuffle else np.arange(len(owner))
            owners.append(owner[order])
            rows.append(row[order])
        return np.concatenate(owners), np.concatenate(rows)

    @functools.cached_property
    def _small_fields(self) -> dict[str, np.ndarray]:
        """All fields but the images, of all episodes: small enough to stay in memory."""
        return self.dataset.read(self.episodes, tuple(name for name in self.dataset.fields if name != "depth"))

    @functools.cached_property
    def _first_rows(self) -> np.ndarray:
        """(E + 1,) the first row of each episode in them, and the number of all rows."""
        return np.cumsum([0, *(episode.length for episode in self.episodes)])

    def _read(self, index: int) -> Recording:
        """One episode."""
        first, end = self._first_rows[index : index + 2]
        depth = self.dataset.read([self.episodes[index]], ("depth",))
        rows: Any = {name: values[first:end] for name, values in self._small_fields.items()}
        length: Any = np.full(int(end - first), end - first, np.int32)
        return Recording(Row(**rows, **depth), 0 * length, length, self.dataset.rate)  # pyright: ignore[reportArgumentType]


def balanced_probabilities(situations: Bool[np.ndarray, "R S"]) -> Float[np.ndarray, "R"]:
    """Find probabilities under which all social situations are equally frequent.

    An example in several situations counts for each of them in equal parts. Examples in no situation keep the share
    that they have, and situations that never occur are left out.

    Args:
        situations: (R, S) which situations occur in each example.

    Returns:
        (R,) float32 that sum to one.
    Source:
        W. E. Deming and F. F. Stephan, "On a least squares adjustment of a sampled frequency table when the expected
        marginal totals are known", 1940.
    """
    flags = np.asarray(situations, np.float64)
    number = flags.sum(1)
    any_flag = number > 0
    if not any_flag.any():
        return np.full(len(flags), 1 / len(flags), np.float32)
    parts = flags[any_flag][:, flags.any(0)] / number[any_flag][:, None]
    fitted = np.ones(len(parts))
    for _ in range(FITTING_TURNS):
        share = fitted @ parts
        fitted = fitted * (parts @ (1.0 / np.maximum(share, 1e-12)))
        fitted = fitted / fitted.sum()
    probabilities = np.full(len(flags), 1.0 / len(flags))
    probabilities[any_flag] = fitted * any_flag.mean()
    return (probabilities / probabilities.sum()).astype(np.float32)


def _join(parts: list[Recording]) -> Recording:
    """Recordings one after the other."""
    first = np.cumsum([0, *(len(part.first) for part in parts)]).astype(np.int32)
    shifted = [
        dataclasses.replace(part, first=part.first + shift, end=part.end + shift)
        for part, shift in zip(parts, first, strict=False)
    ]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *shifted)

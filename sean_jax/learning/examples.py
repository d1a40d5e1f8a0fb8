"""Rows and examples of demonstrations (section V-B), and the order in which examples are learned.

A **row** is recorded once a second, or at a higher rate. An **example** consists of rows one second apart, so that
the store holds a depth image once and not five times.

The paper's example has 5 depth images, a local plan of 5 points of the expert's most recent trajectory, 10 points of
the global plan and a flag for each situation, at 1 Hz. The network of [50] *predicts* the local plan. The most recent
trajectory at the end of five seconds lay ahead at their beginning, so the local planner's target is the places of the
next five seconds, in the robot's present frame. The places of the past five seconds are part of the example as well.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, UInt16

from sean_jax import sensors
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.geometry import rotate
from sean_jax.mdp.observations import plan_ahead

SECONDS = 5  # of depth images, and of the local plan
MILLIMETRES = 1000.0  # in a metre


@struct.dataclass
class Row:
    """One moment of a demonstration. A whole recording has one leading axis, or two."""

    depth: Array  # (H, W) uint16 mm, along the direction of view; the camera's far limit where nothing is visible
    plan: Array  # (10, 2) m, the next points of the shortest path, in the robot's frame
    pose: Array  # (4,) m, m, then the unit vector of the heading
    velocity: Array  # (2,) m/s along the heading, rad/s
    command: Array  # (2,) m/s, rad/s, the command of the policy
    situations: Array  # (S,) bool


@struct.dataclass
class Recording:
    """Demonstrations, one after the other."""

    rows: Row  # (R, ...)
    first: Array  # (R,) int32, the first row of the episode of each row
    end: Array  # (R,) int32, one more than its last row
    rate: int = struct.field(pytree_node=False, default=1)  # rows a second


@struct.dataclass
class Example:
    """Inputs and targets of the network at one row."""

    images: Array  # (5, H, W) uint16 mm, oldest first, present last; before the episode's first row, that row's image
    plan: Array  # (10, 2) m, global plan in the robot's frame
    situations: Array  # (S,) bool
    past: Array  # (5, 2) m, where the robot was 5 to 1 s ago, in its present frame
    future: Array  # (5, 2) m, where it will be in 1 to 5 s: the target of the local planner
    future_valid: Array  # (5,) bool, whether the episode lasted until then
    command: Array  # (2,) m/s, rad/s, the target of the controller


def row(
    scenario: Scenario,
    state: State,
    command: Float[Array, "2"],
    camera: sensors.Camera,
    last_arc: Int[Array, "V"],
) -> Row:
    """The row of a state.

    Args:
        command: (2,) m/s, rad/s, of the policy in that state.
        last_arc: (V,) ``navigation.last_arc_to_goal`` of the goal of the task.
    """
    robot = state.robot
    return Row(
        depth=depth_image(scenario, state, camera),
        plan=plan_ahead(scenario, state, last_arc),
        pose=jnp.concatenate([robot.position, robot.heading]),
        velocity=jnp.stack([robot.speed, robot.turn_rate]),
        command=command,
        situations=state.situations,
    )


def depth_image(scenario: Scenario, state: State, camera: sensors.Camera) -> UInt16[Array, "H W"]:
    """A depth image (H, W) uint16 mm."""
    metres = sensors.depth(scenario, state, camera)
    return jnp.clip(jnp.round(MILLIMETRES * metres), 0.0, 65535.0).astype(jnp.uint16)


def example(recording: Recording, index: Int[Array, "*batch"], xp: ModuleType = jnp) -> Example:
    """Examples of a recording at rows () or (B,); ``xp`` is ``numpy`` if the recording consists of numpy arrays."""
    rows, first, last = recording.rows, recording.first[index][..., None], recording.end[index][..., None] - 1
    ages = xp.arange(SECONDS, dtype=xp.int32).reshape((1,) * (first.ndim - 1) + (SECONDS,))
    present = index[..., None]
    second = recording.rate  # in rows
    visible = xp.maximum(present + second * (ages - (SECONDS - 1)), first)
    before = xp.maximum(present + second * (ages - SECONDS), first)
    after = present + second * (1 + ages)
    pose = rows.pose[index]
    return Example(
        images=rows.depth[visible],
        plan=rows.plan[index],
        situations=rows.situations[index],
        past=in_frame(pose, rows.pose[before, :2], xp),
        future=in_frame(pose, rows.pose[xp.minimum(after, last), :2], xp),
        future_valid=after <= last,
        command=rows.command[index],
    )


def in_frame(
    pose: Float[Array, "*batch 4"], places: Float[Array, "*batch K 2"], xp: ModuleType = jnp
) -> Float[Array, "*batch K 2"]:
    """Places (..., K, 2) m on the floor in the frame of a robot: x ahead and y to the left.

    Args:
        pose: (..., 4) m, m, and the unit vector of the heading.
        xp: ``numpy`` for numpy arrays.
    """
    dx, dy = places[..., 0] - pose[..., 0:1], places[..., 1] - pose[..., 1:2]
    return xp.stack(rotate(dx, dy, pose[..., 2:3], -pose[..., 3:4]), -1)


FITTING_TURNS = 500


class Token(NamedTuple):
    """Where a loader is. It can be stored in a checkpoint."""

    epoch: int = 0
    batch: int = 0


@dataclasses.dataclass
class Loader:
    """Shuffled batches of examples of a dataset that does not fit in the memory of the device.

    It shuffles the episodes, and the examples within a window of some episodes, so that few episodes are in memory at a
    time. The order depends on (seed, epoch) alone, so a token of two numbers is the position.
    """

    dataset: Any  # Dataset
    episodes: Sequence[Any]  # of it
    batch: int = 1024  # examples
    seed: int = 0
    window: int = 64  # episodes that are shuffled together
    shuffle: bool = True

    @property
    def batches(self) -> int:
        """Number of batches in an epoch."""
        return -(-sum(episode.length for episode in self.episodes) // self.batch)

    def epoch(self, token: Token = Token()) -> Iterator[tuple[Token, Example, np.ndarray]]:  # noqa: B008
        """The remaining batches of an epoch: the token that resumes after it, examples (B, ...) as numpy arrays, and
        weights (B,).

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
        random = random_streams.generator("order", self.seed, epoch)
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
    """Probabilities (R,) float32 under which all social situations (R, S) of examples are equally frequent.

    The paper suggests to train more on situations in which a policy does badly. Situations overlap, so an example
    cannot be drawn for one of them alone: each pass scales the probability of an example by how much its situations are
    short of an equal share. An example in several situations counts for each of them in equal parts. Examples in no
    situation keep their share, and situations that never occur are left out.

    Source: W. E. Deming and F. F. Stephan, "On a least squares adjustment of a sampled frequency table when the
    expected marginal totals are known", 1940.
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

"""What a run keeps of a batch of episodes: sums over steps, and frames of the first episodes or of all.

The sums are heat maps, flows along the graph's edges, times of sets of situations, and two checks of the simulation.
"""

import contextlib
import dataclasses
import functools
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import clock, crowding, geometry, trajectories
from sean_jax.base import Array, Scenario, State, Trajectory
from sean_jax.graph import graph_of
from sean_jax.runner import Batch, Record, not_finite
from sean_jax.scenario import frame, results

FRAMES = 4  # episodes whose frames the report shows


@struct.dataclass
class Totals:
    """Counts over the steps in which an episode of a batch of B was active."""

    heat: Array  # (rows, columns) int32 person-steps per cell of the floor, row 0 lowest
    walks: Array  # (M, M) int32 people who walked the edge from the row's node to the column's
    node: Array  # (B, N) int32 node that each person was at last, -1 before the first
    together: Array  # (2 ** S,) int32 steps per set of situations, situation s is bit s
    penetration: Array  # () m, deepest that a body was in an obstacle or off the floor, negative: closest to it
    group_size: Array  # (G,) int32 most members seen in each group


@dataclasses.dataclass
class FinishedBatch:
    """The results of a batch of B episodes, as numpy arrays."""

    completed: np.ndarray  # (B,)
    timed_out: np.ndarray  # (B,)
    steps: np.ndarray  # (B,)
    metrics: dict[str, np.ndarray]  # (B,) or (B, 1 + S)
    totals: Totals
    frames: list[Trajectory]  # (T, ...) of the first episodes
    seconds: float  # s of computing


def record(scenario: Scenario, size: int, frames: int = FRAMES) -> Record:
    """The record of a run's batches: ``Totals``, and the frames of the first episodes."""
    cells = crowding.grid_shape(scenario.environment)
    return Record(functools.partial(_init, cells), functools.partial(_update, min(frames, size)))


def _init(cells: tuple[int, int], scenario: Scenario, states: State) -> Totals:
    size, graph = states.tick.shape[0], graph_of(scenario)
    nodes = 0 if graph is None else len(graph.names)
    return Totals(
        heat=jnp.zeros(cells, jnp.int32),
        walks=jnp.zeros((nodes, nodes), jnp.int32),
        node=jnp.full((size, scenario.people), crowding.NO_NODE, jnp.int32),
        together=jnp.zeros((2 ** len(scenario.situations),), jnp.int32),
        penetration=jnp.full((), -1e9, float),
        group_size=jnp.zeros(states.groups.radius.shape[-1:], jnp.int32),
    )


def _update(
    count: int, scenario: Scenario, before: State, after: State, actions: Array, active: Array, totals: Totals
) -> tuple[Totals, Trajectory]:
    """One more step of B episodes, and the frames of the first ``count``."""
    frames = jax.vmap(frame)(before, after, actions[0])
    present = after.pedestrians.present
    here = present & active[:, None]
    x, y = frames.people[..., 0], frames.people[..., 1]
    rows, columns = totals.heat.shape
    cell = crowding.cell_of(scenario.environment, (rows, columns), frames.people)
    node, walks = totals.node, totals.walks
    if (graph := graph_of(scenario)) is not None:
        node, walked = jax.vmap(crowding.track_nodes, (None, 0, 0, 0))(graph, totals.node, frames.people, present)
        walks = walks.at[totals.node, node].add((walked & active[:, None]).astype(jnp.int32))
    distance, _, _ = jax.vmap(geometry.from_box, (None, None, 0))(x, y, scenario.environment.obstacles)
    edge = geometry.to_border(scenario.environment, x, y)
    nearest = jnp.minimum(jnp.min(distance, 0, initial=jnp.inf), edge)
    inside = jnp.where(here, scenario.forces.walking.radius - nearest, -jnp.inf)
    bits = jnp.asarray(2 ** np.arange(frames.situations.shape[-1]), jnp.int32)
    situations = jnp.sum(jnp.where(frames.situations, bits[None, :], 0), -1)
    index = jnp.arange(totals.group_size.shape[0], dtype=jnp.int32)
    members = jnp.sum((frames.group[..., None] == index[None, None, :]) & here[..., None], 1, dtype=jnp.int32)
    totals = dataclasses.replace(
        totals,
        heat=totals.heat.ravel().at[cell].add(here.astype(jnp.int32)).reshape(rows, columns),
        walks=walks,
        node=node,
        together=totals.together.at[situations].add(active.astype(jnp.int32)),
        penetration=jnp.maximum(totals.penetration, jnp.max(inside, initial=-jnp.inf)),
        group_size=jnp.maximum(totals.group_size, jnp.max(members, 0)),
    )
    return totals, jax.tree.map(lambda leaf: leaf[:count], frames)


def episode_frames(chunks: list[Trajectory], count: int) -> list[Trajectory]:
    """Frames (T, ...) of each episode until its end, from chunks of time (T, F, ...)."""
    if not chunks:
        return []
    frames = jax.tree.map(lambda *xs: np.concatenate(xs), *chunks)
    lengths = [max(1, int(frames.active[:, i].sum())) for i in range(min(count, frames.active.shape[1]))]
    return [jax.tree.map(lambda leaf: leaf[:n, i], frames) for i, n in enumerate(lengths)]  # noqa: B023


def finish(scenario: Scenario, batch: Batch, base: int, seconds: float) -> FinishedBatch:
    """The results of a batch whose first episode has number ``base``, computed in so many seconds.

    Raises:
        FloatingPointError: a metric is NaN; the message names the episodes.
    """
    measured = jax.tree.map(np.asarray, jax.vmap(results, (None, 0))(scenario, batch.states))
    faulty = np.zeros(len(batch.steps), bool)
    for values in measured.values():
        faulty |= np.isnan(values.reshape(len(faulty), -1)[:, 0])
    if faulty.any():
        raise FloatingPointError(not_finite(base + np.flatnonzero(faulty), len(faulty)))
    ended = np.asarray(batch.states.completed), np.asarray(batch.states.timed_out)
    return FinishedBatch(
        *ended, batch.steps, measured, batch.total, episode_frames(batch.rows, len(batch.steps)), seconds
    )


class BatchFrames:
    """Frames of all episodes of a batch on disk, so that memory holds one chunk of time."""

    def __init__(self, folder: Path, count: int, steps: int):
        self.folder, self.count, self.steps = folder, count, steps
        self.done = 0
        self.arrays: dict[str, np.ndarray] = {}

    def add(self, chunk: Trajectory) -> None:
        """Append a chunk of time (T, B, ...), of the first ``count`` episodes."""
        end = min(self.steps, self.done + len(chunk.active))
        for field in dataclasses.fields(chunk):  # pyright: ignore[reportArgumentType]
            values = np.asarray(getattr(chunk, field.name))
            if field.name not in self.arrays:
                shape = (self.count, self.steps, *values.shape[2:])
                self.arrays[field.name] = self._allocate(field.name, shape, values.dtype)
            rows = np.moveaxis(values[: end - self.done, : self.count], 0, 1)
            self.arrays[field.name][:, self.done : end] = rows
        self.done = end

    def _allocate(self, name: str, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        if 0 in shape:  # an empty file cannot be mapped
            return np.zeros(shape, dtype)
        return np.lib.format.open_memmap(self.folder / f"{name}.npy", "w+", dtype, shape)

    def episode(self, index: int) -> Trajectory:
        """Frames (T, ...) of an episode until its end."""
        length = max(1, int(self.arrays["active"][index].sum()))
        arrays: dict[str, Any] = {name: np.array(values[index, :length]) for name, values in self.arrays.items()}
        return Trajectory(**arrays)


@contextlib.contextmanager
def batch_frames(file: Path, scenario: Scenario, base: int, count: int) -> Iterator[BatchFrames]:
    """Frames of a batch that become a file of ``trajectories.trajectory_writer`` when the block ends."""
    scratch = file.parent / ".batch-frames"
    shutil.rmtree(scratch, ignore_errors=True)  # left by a killed process
    scratch.mkdir(parents=True)
    steps = clock.ceil_ticks(scenario.time_limit, scenario.time_step)
    try:
        frames = BatchFrames(scratch, count, steps)
        yield frames
        names = [name for name, _ in scenario.situations]
        with trajectories.trajectory_writer(
            file, time_step=scenario.time_step, situations=names, people=scenario.people, steps=steps, first=base
        ) as writer:
            for index in range(count):
                writer.add(frames.episode(index))
    finally:
        shutil.rmtree(scratch, ignore_errors=True)

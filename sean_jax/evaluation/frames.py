"""Frames of all episodes of a batch, for ``sean run --trajectories``: on disk, so that memory holds a chunk of time.

What is stacked comes by time, for all episodes of the batch at once; a file has one episode after another.
"""

import contextlib
import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax import clock, trajectories
from sean_jax.base import Scenario, Trajectory


class BatchFrames:
    """The frames of a batch, as they come."""

    def __init__(self, folder: Path, count: int, steps: int):
        self.folder, self.count, self.steps = folder, count, steps
        self.done = 0
        self.arrays: dict[str, np.ndarray] = {}

    def add(self, chunk: Trajectory) -> None:
        """Take the next chunk of time.

        Args:
            chunk: (T, B, ...) frames, of which those of the first ``count`` episodes are kept.
        """
        end = min(self.steps, self.done + len(chunk.active))
        for field in dataclasses.fields(chunk):  # pyright: ignore[reportArgumentType]
            values = np.asarray(getattr(chunk, field.name))
            if field.name not in self.arrays:
                shape = (self.count, self.steps, *values.shape[2:])
                self.arrays[field.name] = self._made(field.name, shape, values.dtype)
            rows = np.moveaxis(values[: end - self.done, : self.count], 0, 1)
            self.arrays[field.name][:, self.done : end] = rows
        self.done = end

    def _made(self, name: str, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        if 0 in shape:  # of nobody, which no file can be mapped for
            return np.zeros(shape, dtype)
        return np.lib.format.open_memmap(self.folder / f"{name}.npy", "w+", dtype, shape)

    def episode(self, place: int) -> Trajectory:
        """The frames of an episode, cut after its last active step.

        Returns:
            (T, ...) frames.
        """
        length = max(1, int(self.arrays["active"][place].sum()))
        arrays: dict[str, Any] = {name: np.array(values[place, :length]) for name, values in self.arrays.items()}
        return Trajectory(**arrays)


@contextlib.contextmanager
def kept(file: Path, scenario: Scenario, base: int, count: int) -> Iterator[BatchFrames]:
    """Frames of a batch that become a file of trajectories when the block ends.

    Args:
        file: to be written, as of ``trajectories.trajectory_writer``.
    """
    scratch = file.parent / ".batch-frames"
    shutil.rmtree(scratch, ignore_errors=True)  # of one who was killed
    scratch.mkdir(parents=True)
    steps = clock.ceil_ticks(scenario.time_limit, scenario.time_step)
    try:
        frames = BatchFrames(scratch, count, steps)
        yield frames
        names = [name for name, _ in scenario.situations]
        with trajectories.trajectory_writer(
            file, time_step=scenario.time_step, situations=names, people=scenario.people, steps=steps, first=base
        ) as writer:
            for place in range(count):
                writer.add(frames.episode(place))
    finally:
        shutil.rmtree(scratch, ignore_errors=True)

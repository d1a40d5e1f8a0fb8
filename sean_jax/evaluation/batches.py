"""The batches of a run: what is kept of their episodes, and the folder in which finished batches stay.

A batch keeps sums over steps, and frames of the first episodes or of all. The sums are heat maps, flows along the
graph's edges, times of sets of situations, and two checks of the simulation.

``FOLDER/unfinished`` has the identity of the run (run.json) and a file for each finished batch, so the same command
resumes with the next one. It is removed when all results have been written, so a folder that has it is not finished.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax.config import workspace
from sean_jax.config.workspace import REMAKE, Workspace
from sean_jax.core import clock, geometry
from sean_jax.core.data_types import Array, Scenario, State, Trajectory
from sean_jax.core.errors import ControllerError, IncompleteError, InputError
from sean_jax.graph import graph_of
from sean_jax.io import files, interrupts, trajectories, writing
from sean_jax.io.versions import versions
from sean_jax.io.writing import check_new_folder
from sean_jax.people import density
from sean_jax.simulation.episode_runner import Batch, Record, batch_results, not_finite
from sean_jax.simulation.scenario import frame
from sean_jax.simulation.scenario_stack import Stack

FRAMES = 4  # episodes whose frames the report shows


@struct.dataclass
class Totals:
    """Counts over the steps in which an episode of a batch of B was active; of several floors none by place."""

    heat: Array  # (rows, columns) int32 person-steps per cell of the floor, row 0 lowest
    walks: Array  # (M, M) int32 people who walked the edge from the row's node to the column's
    node: Array  # (B, N) int32 node that each person was at last, -1 before the first
    together: Array  # (2 ** S,) int32 steps per set of situations, situation s is bit s
    penetration: Array  # () m, deepest that a body was in an obstacle or off the floor, negative: closest to it
    group_size: Array  # (G,) int32 maximum number of members of each group


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


def record(floors: Stack[Scenario], size: int, frames: int = FRAMES) -> Record:
    """The record of a run's batches: ``Totals``, and the frames of the first episodes."""
    one_floor = floors.size == 1 or floors.member.others is not None
    cells = density.grid_shape(floors.member.environment) if one_floor else None
    return Record(functools.partial(_init, cells), functools.partial(_update, cells, min(frames, size)))


def _init(cells: tuple[int, int] | None, floors: Stack[Scenario], states: State) -> Totals:
    scenario = floors.member
    size = states.tick.shape[0]
    graph = None if cells is None else graph_of(scenario)
    nodes = 0 if graph is None else len(graph.names)
    groups = (0,) if cells is None else states.groups.radius.shape[-1:]
    return Totals(
        heat=jnp.zeros(cells or (0, 0), jnp.int32),
        walks=jnp.zeros((nodes, nodes), jnp.int32),
        node=jnp.full((size, scenario.people), density.NO_NODE, jnp.int32),
        together=jnp.zeros((2 ** len(scenario.situations),), jnp.int32),
        penetration=jnp.full((), -1e9, float),
        group_size=jnp.zeros(groups, jnp.int32),
    )


def _update(
    cells: tuple[int, int] | None,
    count: int,
    floors: Stack[Scenario],
    before: State,
    after: State,
    actions: Array,
    active: Array,
    totals: Totals,
) -> tuple[Totals, Trajectory]:
    """One more step of B episodes, and the frames of the first ``count``."""
    frames = jax.vmap(frame)(before, after, actions[0])
    present = after.pedestrians.present  # (B, N)
    counted = present & active[:, None]
    inside = jnp.where(counted, floors.vmap(_depth)(frames.people), -jnp.inf)  # (B, N) m

    # The set of situations of each episode as a number, situation s is bit s.
    bits = jnp.asarray(2 ** np.arange(frames.situations.shape[-1]), jnp.int32)
    situations = jnp.sum(jnp.where(frames.situations, bits[None, :], 0), -1)  # (B,)
    totals = dataclasses.replace(
        totals,
        together=totals.together.at[situations].add(active.astype(jnp.int32)),
        penetration=jnp.maximum(totals.penetration, jnp.max(inside, initial=-jnp.inf)),
    )
    if cells is not None:
        totals = _on_floor(cells, floors.member, frames, present, active, totals)
    return totals, jax.tree.map(lambda leaf: leaf[:count], frames)


def _depth(scenario: Scenario, people: Array) -> Array:
    """(N,) m, by which the bodies of people (N, 2) are in an obstacle or off the floor; negative: a distance."""
    x, y = people[..., 0], people[..., 1]
    distance, _, _ = jax.vmap(geometry.from_box, (None, None, 0))(x, y, scenario.environment.obstacles)
    edge = geometry.to_border(scenario.environment, x, y)
    nearest = jnp.min(distance, 0, initial=jnp.inf)  # (N,)
    return scenario.forces.walking.radius - jnp.minimum(nearest, edge)


def _on_floor(
    cells: tuple[int, int], scenario: Scenario, frames: Trajectory, present: Array, active: Array, totals: Totals
) -> Totals:
    """What is counted by place, which is of one floor."""
    counted = present & active[:, None]  # (B, N)
    cell = density.cell_of(scenario.environment, cells, frames.people)

    # Edges of the graph that people have walked.
    node = totals.node
    walks = totals.walks
    if (graph := graph_of(scenario)) is not None:
        node, walked = jax.vmap(density.track_nodes, (None, 0, 0, 0))(graph, totals.node, frames.people, present)
        walks = walks.at[totals.node, node].add((walked & active[:, None]).astype(jnp.int32))

    # Members of each group.
    index = jnp.arange(totals.group_size.shape[0], dtype=jnp.int32)
    is_member = (frames.group[..., None] == index[None, None, :]) & counted[..., None]  # (B, N, G)
    members = jnp.sum(is_member, 1, dtype=jnp.int32)
    return dataclasses.replace(
        totals,
        heat=totals.heat.ravel().at[cell].add(counted.astype(jnp.int32)).reshape(cells),
        walks=walks,
        node=node,
        group_size=jnp.maximum(totals.group_size, jnp.max(members, 0)),
    )


def episode_frames(chunks: list[Trajectory], count: int, robots: int = 1) -> list[Trajectory]:
    """Frames (T, ...) of each episode until its end, from chunks of time (T, F, ...).

    Of a team of ``robots``, the frames of all robots, successive ones, are active until the episode of the last ends.
    """
    if not chunks:
        return []
    frames = jax.tree.map(lambda *parts: np.concatenate(parts), *chunks)  # (T, F, ...)
    rows = min(count, frames.active.shape[1])
    lengths = np.maximum(1, frames.active[:, :rows].sum(0))  # (F,) frames of each row
    if robots > 1:
        lengths = np.maximum.reduceat(lengths, np.arange(0, rows, robots)).repeat(robots)[:rows]
        frames = dataclasses.replace(frames, active=np.ones_like(frames.active))

    episodes = []
    for row, length in enumerate(lengths.tolist()):
        episodes.append(jax.tree.map(lambda leaf, row=row, length=length: leaf[:length, row], frames))
    return episodes


def finish(scenario: Scenario, batch: Batch, base: int, seconds: float) -> FinishedBatch:
    """The results of a batch whose first episode has number ``base``, computed in so many seconds.

    Raises:
        FloatingPointError: a metric is NaN; the message names the episodes.
    """
    metrics = jax.tree.map(np.asarray, batch_results(scenario, batch.states))
    robots = 1 if scenario.others is None else 1 + scenario.others.radius.shape[0]
    faulty = np.zeros(len(batch.steps), bool)  # (B,)
    for values in metrics.values():
        faulty |= np.isnan(values.reshape(len(faulty), -1)[:, 0])
    if faulty.any():
        raise FloatingPointError(not_finite(base, faulty, robots))
    return FinishedBatch(
        completed=np.asarray(batch.states.completed),
        timed_out=np.asarray(batch.states.timed_out),
        steps=batch.steps,
        metrics=metrics,
        totals=batch.total,
        frames=episode_frames(batch.rows, len(batch.steps), robots),
        seconds=seconds,
    )


class BatchFrames:
    """Frames of all episodes of a batch on disk, so that memory holds one chunk of time."""

    def __init__(self, folder: Path, count: int, steps: int):
        self.folder = folder
        self.count = count
        self.steps = steps
        self.done = 0
        self.arrays: dict[str, np.ndarray] = {}

    def add(self, chunk: Trajectory) -> None:
        """Append a chunk of time (T, B, ...), of the first ``count`` episodes."""
        end = min(self.steps, self.done + len(chunk.active))
        for name, values in vars(chunk).items():
            if values is None:  # no other robots
                continue
            if name not in self.arrays:
                self.arrays[name] = self._new_array(name, values)
            rows = values[: end - self.done, : self.count]  # (T, B, ...)
            self.arrays[name][:, self.done : end] = np.moveaxis(rows, 0, 1)
        self.done = end

    def _new_array(self, name: str, values: np.ndarray) -> np.ndarray:
        """An array for all steps, (B, T, ...), on disk."""
        shape = self.count, self.steps, *values.shape[2:]
        if 0 in shape:  # an empty file cannot be mapped
            return np.zeros(shape, values.dtype)
        return np.lib.format.open_memmap(self.folder / f"{name}.npy", "w+", values.dtype, shape)

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


# ------------------------------------------------------------------ the folder

PLACE, STAGE = "unfinished", "written"
IDENTITY = f"{PLACE}/run.json"
SHAPES = {
    "completed": ("b", "B"),
    "timed_out": ("b", "B"),
    "steps": ("i", "B"),
    "seconds": ("f", ""),
    "tally:heat": ("i", "rows columns"),
    "tally:walks": ("i", "M M"),
    "tally:node": ("i", "size N"),
    "tally:together": ("i", "K"),
    "tally:penetration": ("f", ""),
    "tally:group_size": ("i", "G"),
    **{f"frame:{name}": ("f", "T 2") for name in ("position", "heading", "velocity", "goal")},
    "frame:action": ("f", "T command"),
    **{f"frame:{name}": ("f", "T N 2") for name in ("people", "people_velocity", "people_heading")},
    "frame:robots": ("f", "T R 6"),
    **{f"frame:{name}": (kind, "T N") for name, kind in (("group", "i"), ("present", "b"))},
    **{f"frame:{name}": ("b", shape) for name, shape in (("situations", "T S"), ("active", "T"))},
}
"""Array of a batch -> kind and dimensions: B episodes, N people, S situations, T frames of an episode."""

COUNTS = ("steps", "seconds", "tally:heat", "tally:walks", "tally:together", "tally:group_size")
"""Arrays of a batch without negative numbers."""


class RunFolder:
    """The locked folder of a run.

    Raises InputError if the folder holds something else, or batches of other options.
    """

    def __init__(self, folder: Path, identity: dict[str, Any], robots: int = 1, trajectories: str | None = None):
        """The folder of a run.

        Args:
            identity: by which an unfinished run is resumed (``run_plan.identity_of``).
            robots: of a team; an episode has as many rows.
            trajectories: ending of files with the frames of all episodes; None for none.
        """
        self.folder = folder
        self.place = folder / PLACE
        self.complete = False
        self.trajectories = trajectories
        self.robots = robots
        self.work = Workspace(folder, identity, IDENTITY)
        check_run_folder(folder, locked=True)
        self.work.begun()

    def check_content(self, content_digest: str) -> None:
        """Add versions, device, and the fingerprint of scenario and policy to the identity.

        Raises:
            InputError: the finished batches were made with others.
        """
        device = f"{len(jax.devices())} x {jax.devices()[0].device_kind}"
        content = {"the device": device, "the content of scenario and policy": content_digest}
        self.work = dataclasses.replace(self.work, identity=self.work.identity | {"versions": versions()} | content)
        self.work.begun()

    @property
    def episodes(self) -> int:
        """Number of finished episodes."""
        return _count_rows(self.place) // self.robots

    def load(self, base: int, count: int) -> FinishedBatch | None:
        """The batch of ``count`` episodes from number ``base`` on; None if it is not finished.

        Raises:
            FileError: its file is damaged.
        """
        file = self._file(base, count)
        frames = self.frames(base, count)
        if not file.is_file() or (frames is not None and not frames.exists()):
            return None
        arrays = files.read_arrays(file)
        with files.sentence(file, REMAKE):
            return _from_arrays(arrays, count)

    def save(self, base: int, batch: FinishedBatch) -> None:
        """Keep a batch; it is on disk for good when this returns."""
        if not (self.folder / IDENTITY).is_file():
            self.place.mkdir(exist_ok=True)
            writing.write(self.folder / IDENTITY, self.work.identity)
        writing.write_arrays(self._file(base, len(batch.completed)), _to_arrays(batch))

    def frames(self, base: int, count: int) -> Path | None:
        """The file of a batch's trajectories, which is written before the batch; None without ``--trajectories``."""
        return self._file(base, count).with_suffix(f".{self.trajectories}") if self.trajectories else None

    @contextlib.contextmanager
    def results(self, complete: bool) -> Iterator[Path]:
        """An empty folder whose files become the run's results when the block ends."""
        stage = self.place / STAGE
        shutil.rmtree(stage, ignore_errors=True)  # left by a killed process
        stage.mkdir(parents=True)
        yield stage
        for file in sorted(stage.rglob("*"), reverse=True):  # files before their folder
            writing.sync(file)
        for file in sorted(stage.iterdir()):
            if (self.folder / file.name).is_dir():  # copies of own parts, of a report that was written at Ctrl-C
                shutil.rmtree(self.folder / file.name)
            os.replace(file, self.folder / file.name)
        writing.sync(self.folder)
        self.complete = complete
        if complete:
            (self.folder / IDENTITY).unlink(missing_ok=True)  # from here on the run is finished
            shutil.rmtree(self.place)

    @contextlib.contextmanager
    def explain_errors(self) -> Iterator[None]:
        """Add to each error of the block a sentence on the finished episodes, and remove half-written files."""
        try:
            with interrupts.unwrapped():
                yield
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(f"stopped; {self._message()}") from error
        except (FloatingPointError, ControllerError) as error:
            message = self._message()
            raise type(error)(f"{error} {message[0].upper()}{message[1:]}") from error
        except OSError as error:
            raise IncompleteError(f"{writing.broken(error)}; {self._message()}") from error
        finally:
            begun = self.episodes and (self.folder / IDENTITY).is_file()
            shutil.rmtree(self.place / STAGE if begun else self.place, ignore_errors=True)

    def _message(self) -> str:
        if self.complete:
            return f"all results are in {self.folder}."
        if not self.episodes:
            return "nothing was written, for no batch of episodes was finished."
        return (
            f"the {self.episodes} finished episodes are kept, and the same command with --out {self.folder} resumes it."
        )

    def _file(self, base: int, count: int) -> Path:
        return self.place / f"batch-{base:08d}-{count}.npz"


def check_run_folder(folder: Path, locked: bool = False) -> None:
    """Refuse a folder that is neither new nor an unfinished run's; remains of a killed process are removed.

    Raises:
        InputError: the folder holds something else.
    """
    if (folder / PLACE).is_symlink():
        raise InputError(f"{folder / PLACE} is a link; remove it, or choose another --out.")
    if (folder / IDENTITY).is_file():
        return
    is_of_run = writing.contents(folder) == [PLACE] or (folder / "summary.json").is_file()
    has_leftovers = (folder / PLACE).is_dir() and all(map(_is_leftover, (folder / PLACE).iterdir()))
    if is_of_run and (has_leftovers or (folder / writing.LOCK).is_file()):
        with contextlib.nullcontext() if locked else writing.folder_lock(folder):
            if has_leftovers:
                shutil.rmtree(folder / PLACE)
    check_new_folder(folder)


def unfinished_runs(identity: dict[str, Any], robots: int, beside: Path) -> list[tuple[Path, int]]:
    """Neighboring folders with an unfinished run of this identity, and its episodes; without active runs.

    Empty folders of killed runs are removed. What cannot be read is left out.
    """
    neighbors: list[Path] = []
    runs: list[tuple[Path, int]] = []
    with contextlib.suppress(OSError):
        neighbors += sorted(folder for folder in beside.parent.iterdir() if folder != beside)
    for folder in neighbors:
        with contextlib.suppress(OSError, writing.WriteError, InputError):  # another user's, or one that vanishes
            if os.listdir(folder) == [writing.LOCK]:
                with writing.folder_lock(folder):
                    continue
            had = None if writing.is_locked(folder) else workspace.read_identity(folder / IDENTITY)
            if had is not None and workspace.difference(had, identity) is None:
                runs.append((folder, _count_rows(folder / PLACE) // robots))
    return runs


def _is_leftover(file: Path) -> bool:
    return file.name == STAGE or file.name.startswith((".batch-", "batch-", f".{Path(IDENTITY).name}"))


def _count_rows(place: Path) -> int:
    """Rows of finished batches: episodes, or of a team as many for each as it has robots."""
    named = (re.fullmatch(r"batch-\d{8,}-(\d+)\.npz", file.name) for file in place.glob("batch-*.npz"))
    return sum(int(match[1]) for match in named if match)


def _to_arrays(batch: FinishedBatch) -> dict[str, Any]:
    """A batch as named arrays: its own, and its metrics, totals and frames as ``group:name``."""
    arrays = {name: getattr(batch, name) for name in ("completed", "timed_out", "steps", "seconds")}
    groups = {"metrics": batch.metrics, "tally": vars(batch.totals)}
    groups |= {f"frame{k}": vars(frames) for k, frames in enumerate(batch.frames)}
    for group, fields in groups.items():
        arrays |= {f"{group}:{name}": values for name, values in fields.items() if values is not None}
    return arrays


def _from_arrays(arrays: dict[str, np.ndarray], count: int) -> FinishedBatch:
    """The batch of named arrays; raises ValueError or TypeError if they do not have ``count`` episodes."""
    _check_arrays(arrays, count)
    episodes = sum(name.endswith(":active") for name in arrays)
    return FinishedBatch(
        completed=arrays["completed"],
        timed_out=arrays["timed_out"],
        steps=arrays["steps"],
        metrics=_group(arrays, "metrics"),
        totals=Totals(**_group(arrays, "tally")),
        frames=[Trajectory(**_group(arrays, f"frame{k}")) for k in range(episodes)],
        seconds=float(arrays["seconds"]),
    )


def _group(arrays: dict[str, np.ndarray], group: str) -> dict[str, Any]:
    """The arrays of ``group:name``, by name."""
    return {name.partition(":")[2]: value for name, value in arrays.items() if name.startswith(f"{group}:")}


def _check_arrays(arrays: dict[str, np.ndarray], count: int) -> None:
    """Refuse arrays of other names, kinds, sizes or signs than those of a batch of ``count`` episodes."""
    sizes: dict[str, int] = {"B": count, "2": 2}
    for name, values in arrays.items():
        group, _, field = name.partition(":")
        kind, dimensions = SHAPES.get(f"frame:{field}" if group.startswith("frame") else name, ("", ""))
        if group == "metrics":
            kind = "biuf"
            dimensions = "B F"[: 2 * values.ndim - 1]
        if not kind:
            raise ValueError(f"{name} is none of them")

        # A letter has the same size everywhere; each episode has its own number of frames.
        letters = [f"{group}T" if letter == "T" else letter for letter in dimensions.split()]
        shape = tuple(sizes.setdefault(letter, size) for letter, size in zip(letters, values.shape, strict=True))
        if values.shape != shape or values.dtype.kind not in kind:
            raise ValueError(f"{name} is {values.dtype} {values.shape}")
        if group != "metrics" and field != "action" and not np.isfinite(values).all():
            raise ValueError(f"{name} is not finite")
        if name in COUNTS and (values < 0).any():
            raise ValueError(f"{name} is negative")

    # Situations of frames and columns of metrics, and their sets.
    situations = [sizes.get("S", -1), sizes.get("F", 0) - 1]
    if any(2**size != sizes["K"] for size in situations if size >= 0):
        raise ValueError("they are not of the same situations")

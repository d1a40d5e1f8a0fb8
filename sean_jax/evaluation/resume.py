"""The folder of ``sean run``: finished batches stay in it, and the same command resumes with the next one.

``FOLDER/unfinished`` has the identity of the run (run.json) and a file for each batch. It is removed when all results
have been written, so a folder that has it is not finished.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sean_jax import components, files, interrupts, workspace, writing
from sean_jax.base import Policy, Scenario, Trajectory
from sean_jax.config import RunConfig
from sean_jax.errors import IncompleteError, InputError
from sean_jax.evaluation.accumulate import FinishedBatch, Totals
from sean_jax.versions import fingerprint, versions
from sean_jax.workspace import REMAKE, Workspace
from sean_jax.writing import check_new_folder

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
    **{f"frame:{name}": ("f", "T 2") for name in ("position", "heading", "velocity", "action", "goal")},
    **{f"frame:{name}": ("f", "T N 2") for name in ("people", "people_velocity", "people_heading")},
    "frame:group": ("i", "T N"),
    "frame:present": ("b", "T N"),
    "frame:situations": ("b", "T S"),
    "frame:active": ("b", "T"),
}
"""Array of a batch -> kind and dimensions: B episodes, N people, S situations, T frames of an episode."""


class RunFolder:
    """The locked folder of a run.

    Raises InputError if the folder holds something else, or batches of other options.
    """

    def __init__(self, folder: Path, config: RunConfig):
        self.folder, self.place, self.complete = folder, folder / PLACE, False
        self.trajectories = config.trajectories
        self.work = Workspace(folder, _identity(config), IDENTITY)
        check_run_folder(folder, locked=True)
        self.work.begun()

    def check_content(self, scenario: Scenario, policy: Policy) -> None:
        """Add versions, device, scenario and policy to the identity.

        Raises:
            InputError: the finished batches were made with others.
        """
        device = f"{len(jax.devices())} x {jax.devices()[0].device_kind}"
        content = {"the device": device, "the content of scenario and policy": fingerprint(scenario, policy.params)}
        self.work = dataclasses.replace(self.work, identity=self.work.identity | {"versions": versions()} | content)
        self.work.begun()

    @property
    def episodes(self) -> int:
        """Number of finished episodes."""
        return _count_episodes(self.place)

    def load(self, base: int, count: int) -> FinishedBatch | None:
        """The batch of ``count`` episodes from number ``base`` on; None if it is not finished.

        Raises:
            FileError: its file is damaged.
        """
        file, frames = self._file(base, count), self.frames(base, count)
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
        """Add to each error of the block a sentence on the episodes that are kept, and remove half-written files."""
        try:
            with interrupts.unwrapped():
                yield
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(f"stopped; {self._message()}") from error
        except FloatingPointError as error:
            message = self._message()
            raise FloatingPointError(f"{error} {message[0].upper()}{message[1:]}") from error
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
    """Refuse a folder that is neither new nor an unfinished run's; what a killed process left there is removed.

    Raises:
        InputError: the folder holds something else.
    """
    if (folder / PLACE).is_symlink():
        raise InputError(f"{folder / PLACE} is a link; remove it, or choose another --out.")
    if not (folder / IDENTITY).is_file():
        of_a_run = writing.contents(folder) == [PLACE] or (folder / "summary.json").is_file()
        leftovers = all(map(_is_leftover, (folder / PLACE).iterdir())) if (folder / PLACE).is_dir() else False
        if of_a_run and (leftovers or (folder / writing.LOCK).is_file()):
            with contextlib.nullcontext() if locked else writing.folder_lock(folder):
                if leftovers:
                    shutil.rmtree(folder / PLACE)
        check_new_folder(folder)


def unfinished_runs(config: RunConfig, beside: Path) -> list[tuple[Path, int]]:
    """Folders beside one with an unfinished run of this description, and its episodes; without runs at work.

    Empty folders of killed runs are removed. What cannot be read is left out.
    """
    identity = _identity(config)
    folders: list[Path] = []
    runs: list[tuple[Path, int]] = []
    with contextlib.suppress(OSError):
        folders += sorted(each for each in beside.parent.iterdir() if each != beside)
    for folder in folders:
        with contextlib.suppress(OSError, writing.WriteError, InputError):  # another user's, or one that vanishes
            if os.listdir(folder) == [writing.LOCK]:
                with writing.folder_lock(folder):
                    continue
            had = None if writing.is_locked(folder) else workspace.read_identity(folder / IDENTITY)
            if had is not None and workspace.difference(had, identity) is None:
                runs.append((folder, _count_episodes(folder / PLACE)))
    return runs


def _is_leftover(file: Path) -> bool:
    return file.name == STAGE or file.name.startswith((".batch-", "batch-", f".{Path(IDENTITY).name}"))


def _count_episodes(place: Path) -> int:
    named = (re.fullmatch(r"batch-\d{8,}-(\d+)\.npz", file.name) for file in place.glob("batch-*.npz"))
    return sum(int(match[1]) for match in named if match)


def _identity(config: RunConfig) -> dict[str, Any]:
    options = config.identity() | {"batch": min(config.batch, config.episodes)}
    return {"options": options, "parts": components.digests(config)}


def _to_arrays(batch: FinishedBatch) -> dict[str, Any]:
    """A batch as named arrays: its own, and those of its totals and frames as ``group:name``."""
    named = {f"metrics:{name}": values for name, values in batch.metrics.items()}
    for group, one in (("tally", batch.totals), *((f"frame{k}", frame) for k, frame in enumerate(batch.frames))):
        named |= {f"{group}:{field.name}": getattr(one, field.name) for field in dataclasses.fields(one)}  # pyright: ignore[reportArgumentType]
    own = {name: getattr(batch, name) for name in ("completed", "timed_out", "steps", "seconds")}
    return {**own, **named}


def _from_arrays(arrays: dict[str, np.ndarray], count: int) -> FinishedBatch:
    """The batch of named arrays; raises ValueError or TypeError if they are not those of ``count`` episodes."""

    def of(group: str) -> dict[str, Any]:
        return {name.split(":", 1)[1]: value for name, value in arrays.items() if name.startswith(f"{group}:")}

    frames = [Trajectory(**of(f"frame{k}")) for k in range(sum(name.endswith(":active") for name in arrays))]
    sizes: dict[str, int] = {"B": count, "2": 2}
    for name, values in arrays.items():
        group, _, field = name.partition(":")
        kind, dimensions = SHAPES.get("frame:" + field if group.startswith("frame") else name, ("", ""))
        if group == "metrics":
            kind, dimensions = "biuf", "B F"[: 2 * values.ndim - 1]
        if not kind:
            raise ValueError(f"{name} is none of them")
        letters = [f"{group}T" if letter == "T" else letter for letter in dimensions.split()]
        shape = tuple(sizes.setdefault(*pair) for pair in zip(letters, values.shape, strict=True))
        if values.shape != shape or values.dtype.kind not in kind:
            raise ValueError(f"{name} is {values.dtype} {values.shape}")
        if group != "metrics" and not (np.isfinite(values) | (field == "action")).all():
            raise ValueError(f"{name} is not finite")
        if name in ("steps", "seconds", "tally:heat", "tally:walks", "tally:together", "tally:group_size"):
            if (values < 0).any():
                raise ValueError(f"{name} is negative")
    if any(2**number != sizes["K"] for number in (sizes.get("S"), sizes.get("F", 0) - 1) if number not in (None, -1)):
        raise ValueError("they are not of the same situations")
    ended = arrays["completed"], arrays["timed_out"], arrays["steps"]
    return FinishedBatch(*ended, of("metrics"), Totals(**of("tally")), frames, float(arrays["seconds"]))

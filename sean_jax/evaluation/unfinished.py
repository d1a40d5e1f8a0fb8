"""A run that is not finished: its finished batches stay in its folder, and the same command goes on with the next.

``FOLDER/unfinished`` has run.json, which is all that decides what the episodes are, and a file for each batch. It is
gone when all results have been written, so a folder that has it is not finished.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sean_jax import components, files, interrupts, writing
from sean_jax.base import Policy, Scenario, Trajectory
from sean_jax.config import RunConfig
from sean_jax.errors import FileError, IncompleteError, InputError
from sean_jax.evaluation.tally import Finished, Tally
from sean_jax.flags import flag
from sean_jax.versions import fingerprint, versions
from sean_jax.writing import check_new_folder

PLACE, ABOUT, STAGE = "unfinished", "run.json", "written"
VERSION = "the version of "
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


class Unfinished:
    """The finished batches of the run in a folder, which is ``writing.folder_lock``.

    Raises InputError if the folder holds something else, or the batches of other options.
    """

    def __init__(self, folder: Path, config: RunConfig):
        self.folder, self.place, self.complete = folder, folder / PLACE, False
        self.about, self.trajectories = _about(config), config.trajectories
        check_place(folder, held=True)
        self._compare()

    def settle(self, scenario: Scenario, policy: Policy) -> None:
        """Add what only the scenario and the policy tell.

        Raises:
            InputError: the batches were made with others.
        """
        self.about |= _made_with(scenario, policy)
        self._compare()

    @property
    def episodes(self) -> int:
        """How many are finished."""
        return _episodes(self.place)

    def load(self, base: int, kept: int) -> Finished | None:
        """The batch of so many episodes from a number on, if it is finished.

        Returns:
            The batch, or None.

        Raises:
            FileError: its file is damaged.
        """
        file, frames = self._file(base, kept), self.frames(base, kept)
        if not file.is_file() or (frames is not None and not frames.exists()):
            return None
        arrays = files.read_arrays(file)
        with files.sentence(file, "remove it, and the same command makes it anew"):
            return _finished(arrays, kept)

    def save(self, base: int, batch: Finished) -> None:
        """Keep a batch, for good when this returns."""
        self.place.mkdir(exist_ok=True)
        if not (self.place / ABOUT).is_file():
            writing.write(self.place / ABOUT, json.dumps(self.about, indent=1) + "\n")
        with writing.atomic_file(self._file(base, len(batch.completed))) as stream:
            np.savez_compressed(stream, **_arrays(batch))

    def frames(self, base: int, kept: int) -> Path | None:
        """The file of a batch's trajectories, which is written before the batch is kept.

        Returns:
            Its path, None if nobody asked for trajectories.
        """
        return self._file(base, kept).with_suffix(f".{self.trajectories}") if self.trajectories else None

    @contextlib.contextmanager
    def results(self, complete: bool) -> Iterator[Path]:
        """A folder whose files become the run's when the block ends.

        Yields:
            An empty folder.
        """
        stage = self.place / STAGE
        shutil.rmtree(stage, ignore_errors=True)  # half-written files of one who was killed
        stage.mkdir(parents=True)
        yield stage
        for file in sorted(stage.rglob("*"), reverse=True):  # what is in a folder before the folder
            writing.sync(file)
        for file in sorted(stage.iterdir()):
            if (self.folder / file.name).is_dir():  # parts of one's own, of a report that was written at Ctrl-C
                shutil.rmtree(self.folder / file.name)
            os.replace(file, self.folder / file.name)
        writing.sync(self.folder)
        self.complete = complete
        if complete:
            (self.place / ABOUT).unlink(missing_ok=True)  # and so the run is finished
            shutil.rmtree(self.place)

    @contextlib.contextmanager
    def explained(self) -> Iterator[None]:
        """Whatever ends the block too early is raised with a sentence on what is kept; what is half-written goes."""
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
            begun = self.episodes and (self.place / ABOUT).is_file()
            shutil.rmtree(self.place / STAGE if begun else self.place, ignore_errors=True)

    def _message(self) -> str:
        if self.complete:
            return f"all results are in {self.folder}."
        if not self.episodes:
            return "nothing was written, for no batch of episodes was finished."
        kept = f"the {self.episodes} episodes finished until then are kept"
        return f"{kept}, and the same command with --out {self.folder} goes on."

    def _file(self, base: int, kept: int) -> Path:
        return self.place / f"batch-{base:08d}-{kept}.npz"

    def _compare(self) -> None:
        had = _read(self.place / ABOUT)
        if had is None:
            return
        for name, value in self.about.items():
            if name not in had:
                if name.startswith(VERSION):
                    continue  # of a package that was not there
                file = self.place / ABOUT
                raise InputError(f"{file} does not tell {name}; remove {self.place} or choose another --out.")
            if had[name] != value:
                said = f"{self.folder} has an unfinished run with {name} {had[name]}, not {value}"
                raise InputError(f"{said}; ask for the same or choose another --out.")


def check_place(folder: Path, held: bool = False) -> None:
    """Refuse a folder that holds something else than such a run. What a kill left at the very beginning or end goes.

    Raises:
        InputError: the folder holds something else.
    """
    if (folder / PLACE).is_symlink():
        raise InputError(f"{folder / PLACE} is a link; remove it, or choose another --out.")
    if not (folder / PLACE / ABOUT).is_file():
        of_a_run = writing.contents(folder) == [PLACE] or (folder / "summary.json").is_file()
        ours = all(map(_is_ours, (folder / PLACE).iterdir())) if (folder / PLACE).is_dir() else False
        if of_a_run and (ours or (folder / writing.LOCK).is_file()):
            with contextlib.nullcontext() if held else writing.folder_lock(folder):
                if ours:
                    shutil.rmtree(folder / PLACE)
        check_new_folder(folder)


def unfinished_runs(config: RunConfig, beside: Path) -> list[tuple[Path, int]]:
    """Folders beside one with an unfinished run of this description that nobody is at.

    Of runs that were killed before anything was finished, the folders go. What cannot be read is left out.
    """
    asked = _about(config)
    folders: list[Path] = []
    found: list[tuple[Path, int]] = []
    with contextlib.suppress(OSError):
        folders += sorted(each for each in beside.parent.iterdir() if each != beside)
    for folder in folders:
        with contextlib.suppress(OSError, writing.WriteError, InputError):  # they are somebody's, and may vanish
            if os.listdir(folder) == [writing.LOCK]:
                with writing.folder_lock(folder):
                    continue
            had = {} if writing.is_locked(folder) else _read(folder / PLACE / ABOUT) or {}
            if all(name in had and had[name] == value for name, value in asked.items()):
                found.append((folder, _episodes(folder / PLACE)))
    return found


def _is_ours(item: Path) -> bool:
    return item.name == STAGE or (item.name.startswith((".batch-", "batch-", f".{ABOUT}")))


def _episodes(place: Path) -> int:
    named = (re.fullmatch(r"batch-\d{8,}-(\d+)\.npz", file.name) for file in place.glob("batch-*.npz"))
    return sum(int(found[1]) for found in named if found)


def _about(config: RunConfig) -> dict[str, Any]:
    """What decides the episodes, as JSON gives it back: by option, and the content of files of one's own."""
    fields = config.identity() | {"batch": min(config.batch, config.episodes)}
    parts = {f"the content of {name}": digest for name, digest in components.digests(config).items()}
    return json.loads(json.dumps({**{flag(name): value for name, value in fields.items()}, **parts}))


def _made_with(scenario: Scenario, policy: Policy) -> dict[str, Any]:
    return {
        **{f"{VERSION}{name}": version for name, version in versions().items()},
        "the device": f"{len(jax.devices())} x {jax.devices()[0].device_kind}",
        "the content of scenario and policy": fingerprint(scenario, policy.params),
    }


def _read(file: Path) -> dict[str, Any] | None:
    try:
        found = files.read_json(file)
    except FileError as error:
        if not os.path.lexists(file):
            return None
        raise InputError(f"{str(error).rstrip('.')}; remove {file.parent} or choose another --out.") from None
    if not isinstance(found, dict):
        raise InputError(f"{file} is damaged; remove {file.parent} or choose another --out.")
    return found


def _arrays(batch: Finished) -> dict[str, Any]:
    """A batch as named arrays: its own, and those that lie in it under ``of:name``."""
    named = {f"metrics:{name}": values for name, values in batch.metrics.items()}
    for place, one in (("tally", batch.tally), *((f"frame{k}", frame) for k, frame in enumerate(batch.frames))):
        named |= {f"{place}:{field.name}": getattr(one, field.name) for field in dataclasses.fields(one)}  # pyright: ignore[reportArgumentType]
    own = {name: getattr(batch, name) for name in ("completed", "timed_out", "steps", "seconds")}
    return {**own, **named}


def _finished(arrays: dict[str, np.ndarray], kept: int) -> Finished:
    """The batch of named arrays. Whatever is raised says that they are not one of so many episodes."""

    def of(place: str) -> dict[str, Any]:
        return {name.split(":", 1)[1]: value for name, value in arrays.items() if name.startswith(f"{place}:")}

    frames = [Trajectory(**of(f"frame{k}")) for k in range(sum(name.endswith(":active") for name in arrays))]
    sizes: dict[str, int] = {"B": kept, "2": 2}
    for name, values in arrays.items():
        place, _, field = name.partition(":")
        kind, dimensions = SHAPES.get("frame:" + field if place.startswith("frame") else name, ("", ""))
        if place == "metrics":
            kind, dimensions = "biuf", "B F"[: 2 * values.ndim - 1]
        if not kind:
            raise ValueError(f"{name} is none of them")
        letters = [f"{place}T" if letter == "T" else letter for letter in dimensions.split()]
        shape = tuple(sizes.setdefault(*pair) for pair in zip(letters, values.shape, strict=True))
        if values.shape != shape or values.dtype.kind not in kind:
            raise ValueError(f"{name} is {values.dtype} {values.shape}")
        if place != "metrics" and not (np.isfinite(values) | (field == "action")).all():
            raise ValueError(f"{name} is not finite")
        if name in ("steps", "seconds", "tally:heat", "tally:walks", "tally:together", "tally:group_size"):
            if (values < 0).any():
                raise ValueError(f"{name} is negative")
    if any(2**number != sizes["K"] for number in (sizes.get("S"), sizes.get("F", 0) - 1) if number not in (None, -1)):
        raise ValueError("they are not of the same situations")
    ended = arrays["completed"], arrays["timed_out"], arrays["steps"]
    return Finished(*ended, of("metrics"), Tally(**of("tally")), frames, float(arrays["seconds"]))

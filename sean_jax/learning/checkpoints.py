"""Checkpoints of trainings, through orbax.

The latest and the best checkpoint are kept, and a half-written one is never read. If only the best were kept, orbax
would delete the latest, and a training would restart. The SHA-256 of each field of the state stands beside the loss,
since orbax restores arrays whose bytes were changed on disk.
"""

import contextlib
import hashlib
import logging
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
import orbax.checkpoint as ocp
from orbax.checkpoint.checkpoint_managers import AnyPreservationPolicy, BestN, LatestN

from sean_jax.core.errors import IncompleteError, InputError
from sean_jax.io import writing
from sean_jax.learning.networks import named_leaves
from sean_jax.learning.processes import on_first_process

STATE, DIGESTS = "state", "sha256"
RESERVE = 4_000_000  # bytes that must be free in addition to the size of a checkpoint
UNCHANGED = "earlier checkpoints are as they were."  # how a message about a failed write ends
CURE = "remove it to resume from an earlier checkpoint."
ATTEMPTS = 10  # to read while a training replaces checkpoints

Result = TypeVar("Result")
Tree = TypeVar("Tree")


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    """Keep orbax's warning off the terminal that a folder is only read."""
    logger = logging.getLogger("absl")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _negative_loss(metrics: dict[str, float]) -> float:
    return -metrics["loss"]


class Checkpoints:
    """The checkpoints in a folder, each named by its number of epochs.

    If several processes train together, all of them open, save and wait. A writer, or the first of them, must hold the
    lock of the folder (``writing.folder_lock``), because opening for writing removes what a killed process left: a kill
    may leave a checkpoint half deleted, which orbax still counts. A reader changes nothing. Only checkpoints that are
    neither the latest nor the best are ever deleted, and only the latest and the best are read.
    """

    def __init__(self, folder: Path, writes: bool = False):
        """Open the checkpoints of a folder; with ``writes`` they may be saved and deleted."""
        self.folder = Path(folder).absolute()
        place = self.folder / "checkpoints"
        options = ocp.CheckpointManagerOptions(
            best_fn=_negative_loss,  # decides nothing here, but without it orbax does not store the losses
            preservation_policy=AnyPreservationPolicy([LatestN(n=1), BestN(get_metric_fn=_negative_loss, n=1)]),
            cleanup_tmp_directories=writes,
            create=writes,
            read_only=not writes,
            save_interval_steps=int(writes),  # orbax warns of any number but 0 where nothing is saved
        )
        for name in sorted(os.listdir(place)) if place.is_dir() else []:
            _check_entries(place / name)
        with _explain_errors(place), _without_warnings():
            self.manager = _retry(lambda: ocp.CheckpointManager(place, options=options))
            self.manager.best_step()  # which reads the losses of all
        if writes:
            for step in {*self.manager.all_steps()} - {self.manager.latest_step(), self.manager.best_step()}:
                self.manager.delete(step)

    def save(self, state: Any, epoch: int, loss: float) -> None:
        """Write a checkpoint in the background.

        Raises:
            IncompleteError: this checkpoint or the one before could not be written.
        """
        size = 2 * sum(leaf.nbytes for leaf in jax.tree.leaves(state)) + RESERVE
        on_first_process(lambda: self._check_space(size))
        with writing.explain_errors(self.folder, UNCHANGED):
            content = ocp.args.Composite(**{STATE: ocp.args.PyTreeSave(state)})  # pyright: ignore
            metrics = {"loss": loss, DIGESTS: _digests(state)}
            self.manager.save(epoch, args=content, metrics=metrics, force=True)

    def _check_space(self, size: int) -> None:
        if shutil.disk_usage(self.folder).free < size:  # after a failed write, threads of orbax print pages
            raise IncompleteError(f"{self.folder}: {writing.DISK_FULL}; {UNCHANGED}")

    def wait(self) -> None:
        """Wait until all checkpoints are on disk.

        Raises:
            IncompleteError: one could not be written.
        """
        with writing.explain_errors(self.folder, UNCHANGED):
            self.manager.wait_until_finished()

    def latest(self, like: Tree) -> Tree | None:
        """The latest checkpoint, of the structure, shapes and types of ``like``; None if there is none.

        Raises:
            IncompleteError: it cannot be read.
        """
        step = self.manager.latest_step()
        return None if step is None else self._restore(step, like)

    def best(self, part: str, like: Tree) -> Tree:
        """One field of the checkpoint with the lowest loss, the latest of equals, of the structure of ``like``.

        Raises:
            InputError: there is no checkpoint.
            IncompleteError: it cannot be read.
        """
        return self._read_best(lambda step: self._restore(step, like, part, finite=True))

    def shapes(self, part: str) -> dict[str, tuple[int, ...]]:
        """Name, such as statistics/mean, and shape of the arrays of one field of the checkpoint with the lowest loss.

        Raises:
            InputError: there is no checkpoint.
            IncompleteError: it cannot be read.
        """

        def read(step: int) -> dict[str, tuple[int, ...]]:
            where = self.folder / "checkpoints" / str(step)
            with _explain_errors(where):
                tree = ocp.PyTreeCheckpointHandler().metadata(where / STATE).tree[part]  # pyright: ignore
                return {name: tuple(leaf.shape) for name, leaf in named_leaves(tree).items()}

        return self._read_best(read)

    def _read_best(self, read: Callable[[int], Result]) -> Result:
        step = self._best_step()
        previous = None
        while step is not None:
            try:
                return read(step)
            except IncompleteError:
                step, previous = self._best_step(), step
                if step == previous:
                    raise  # otherwise a running training has replaced it by a better one
        raise InputError(f"{self.folder} has no checkpoint; train a network with `sean train imitation`.")

    def _best_step(self) -> int | None:
        with _explain_errors(self.folder / "checkpoints"):
            _retry(self.manager.reload)
            return self.manager.best_step()

    def _restore(self, step: int, like: Tree, part: str | None = None, finite: bool = False) -> Tree:
        sharding = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])  # each process reads all of it
        shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), like)
        target = shapes if part is None else {part: shapes}
        with _explain_errors(self.folder / "checkpoints" / str(step)):
            placement = ocp.checkpoint_utils.construct_restore_args(target)
            request = ocp.args.PyTreeRestore(item=target, restore_args=placement, partial_restore=True)  # pyright: ignore
            content = self.manager.restore(step, args=ocp.args.Composite(**{STATE: request}))
            restored = content[STATE]
            metrics: Any = self.manager.metrics(step)
            digests = metrics[DIGESTS]  # none of arrays that several processes share
            if any(digests.get(name, digest) != digest for name, digest in _digests(restored).items()):
                raise ValueError("other numbers than were saved")
            result = restored if part is None else restored[part]
            if finite and not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result)):
                raise ValueError("a number is not finite")
            return result


def _digests(state: Any) -> dict[str, str]:
    """Field of a state -> SHA-256 of its arrays; {} if this process has only a share of them."""
    leaves = named_leaves(state)
    if any(isinstance(leaf, jax.Array) and not leaf.is_fully_addressable for leaf in leaves.values()):
        return {}
    digests: dict[str, Any] = {}
    for name, leaf in sorted(leaves.items()):
        array = np.ascontiguousarray(leaf)
        digest = digests.setdefault(name.partition("/")[0], hashlib.sha256())
        digest.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return {name: digest.hexdigest() for name, digest in digests.items()}


@contextlib.contextmanager
def _explain_errors(checkpoint: Path) -> Iterator[None]:
    """Whatever orbax raises about a checkpoint becomes a sentence."""
    try:
        yield
    except IncompleteError:
        raise
    except Exception as error:  # which one depends on the byte that is damaged
        if isinstance(error, OSError) and error.strerror:
            raise IncompleteError(f"{checkpoint} cannot be read ({error.strerror.lower()}); {CURE}") from error
        raise IncompleteError(f"{checkpoint} cannot be read (it is damaged); {CURE}") from error


def _check_entries(checkpoint: Path) -> None:
    """IncompleteError for what is neither a file nor a folder: orbax would wait for a pipe, and never end a device."""
    for folder, _, names in os.walk(checkpoint):
        for name in names:
            path = Path(folder) / name
            if not path.is_file() and os.path.lexists(path):
                raise IncompleteError(f"{checkpoint} cannot be read ({name} is no file); {CURE}")


def _retry(read: Callable[[], Result]) -> Result:
    """The result of ``read``, repeated while a running training removes checkpoints."""
    for _ in range(ATTEMPTS):
        try:
            return read()
        except FileNotFoundError:
            continue
    return read()

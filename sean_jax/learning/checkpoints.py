"""The folder of a training: its configuration, and checkpoints through orbax.

The latest and the best checkpoint are kept, and a half-written one is never read. Where only the best ones are asked
for, orbax deletes the latest, and a training would start anew; so the policy below keeps both. The SHA-256 of each
field of the state stands beside the loss, since orbax restores arrays whose bytes were changed on disk.
"""

import contextlib
import functools
import hashlib
import json
import logging
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
import orbax.checkpoint as ocp
from orbax.checkpoint.checkpoint_managers import AnyPreservationPolicy, BestN, LatestN

from sean_jax import files, writing
from sean_jax.config import present_names
from sean_jax.errors import FileError, IncompleteError, InputError
from sean_jax.learning import processes
from sean_jax.learning.manifests import CONFIG

STATE, DIGESTS = "state", "sha256"
RESERVE = 4_000_000  # bytes that must be free in addition to the size of a checkpoint
UNCHANGED = "earlier checkpoints are as they were."  # how a message about a failed write ends
CURE = "remove it to go on from an earlier one."
ATTEMPTS = 10  # to read while a training replaces checkpoints

Result = TypeVar("Result")
Tree = TypeVar("Tree")


@functools.cache
def _mute_orbax() -> None:
    """Print no traceback beside the error that is raised: of its tasks, and of threads that find its loop closed."""
    logging.getLogger("asyncio").addFilter(lambda record: "orbax" not in record.getMessage())
    hook = sys.unraisablehook

    def unraisable(found: Any) -> None:
        closed = isinstance(found.exc_value, RuntimeError) and "Event loop is closed" in str(found.exc_value)
        if not closed or threading.current_thread() is threading.main_thread():
            hook(found)

    sys.unraisablehook = unraisable


def _negative_loss(metrics: dict[str, float]) -> float:
    return -metrics["loss"]


class Checkpoints:
    """The checkpoints in a folder, each named by its number of epochs.

    Where several processes train together, all of them open, save and wait. A writer, or the first of them, must hold
    the lock of the folder (``writing.folder_lock``), because opening for writing removes what a
    killed process left. A reader changes nothing. A kill may leave a checkpoint half deleted, which orbax still counts.
    Only checkpoints that are neither the latest nor the best are ever deleted, and only the latest and the best are
    read.
    """

    def __init__(self, folder: Path, writes: bool = False):
        """Open the checkpoints of a folder.

        Args:
            writes: whether checkpoints may be saved and deleted; the caller holds the lock then.
        """
        logging.getLogger("absl").setLevel(logging.CRITICAL)  # orbax logs every step
        _mute_orbax()
        self.folder = Path(folder).absolute()
        policy = AnyPreservationPolicy([LatestN(n=1), BestN(get_metric_fn=_negative_loss, n=1)])
        options = ocp.CheckpointManagerOptions(
            best_fn=_negative_loss,  # decides nothing here, but without it orbax does not store the losses
            preservation_policy=policy,
            cleanup_tmp_directories=writes,
            create=writes,
            read_only=not writes,
        )
        for name in sorted(os.listdir(self.folder / "checkpoints")) if (self.folder / "checkpoints").is_dir() else []:
            _check_entries(self.folder / "checkpoints" / name)
        with _explained(self.folder / "checkpoints"):
            self.manager = _retry(lambda: ocp.CheckpointManager(self.folder / "checkpoints", options=options))
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
        processes.by_first(lambda: self._check_space(size))
        try:
            content = ocp.args.Composite(**{STATE: ocp.args.PyTreeSave(state)})  # pyright: ignore
            metrics = {"loss": loss, DIGESTS: _digests(state)}
            self.manager.save(epoch, args=content, metrics=metrics, force=True)
        except (OSError, ValueError) as error:
            raise IncompleteError(f"{self.folder}: {writing.reason(error)}; {UNCHANGED}") from error

    def _check_space(self, size: int) -> None:
        if shutil.disk_usage(self.folder).free < size:  # after a failed write, threads of orbax print pages
            raise IncompleteError(f"{self.folder}: {writing.DISK_FULL}; {UNCHANGED}")

    def wait(self) -> None:
        """Wait until all checkpoints are on disk.

        Raises:
            IncompleteError: one could not be written.
        """
        try:
            self.manager.wait_until_finished()
        except (OSError, ValueError) as error:
            raise IncompleteError(f"{self.folder}: {writing.reason(error)}; {UNCHANGED}") from error

    def latest(self, like: Tree) -> Tree | None:
        """Read the latest checkpoint.

        Args:
            like: a pytree with the structure, shapes and types of what was saved.

        Returns:
            The state, or None if there is no checkpoint.

        Raises:
            IncompleteError: it cannot be read.
        """
        step = self.manager.latest_step()
        return None if step is None else self._restore(step, like)

    def best(self, part: str, like: Tree) -> Tree:
        """Read one field of the checkpoint with the lowest validation loss, the latest of equals.

        Args:
            like: a pytree with the structure, shapes and types of that field.

        Raises:
            InputError: there is no checkpoint.
            IncompleteError: it cannot be read.
        """
        step, previous = self._best_step(), None
        while step is not None:
            try:
                return self._restore(step, like, part, finite=True)
            except IncompleteError:
                step, previous = self._best_step(), step
                if step == previous:
                    raise  # otherwise a running training has replaced it by a better one
        raise InputError(f"{self.folder} has no checkpoint; train a network with `sean train imitation`.")

    def shapes(self, part: str) -> dict[str, tuple[int, ...]]:
        """The shapes of one field of the checkpoint with the lowest validation loss.

        Args:
            part: as of ``best``.

        Returns:
            Name of an array, such as statistics/mean, to its shape.

        Raises:
            InputError: there is no checkpoint.
            IncompleteError: it cannot be read.
        """
        step, previous = self._best_step(), None
        while step is not None:
            where = self.folder / "checkpoints" / str(step)
            try:
                with _explained(where):
                    tree = ocp.PyTreeCheckpointHandler().metadata(where / STATE).tree[part]  # pyright: ignore
                    leaves, _ = jax.tree.flatten_with_path(tree)
                    return {
                        jax.tree_util.keystr(at, simple=True, separator="/"): tuple(leaf.shape) for at, leaf in leaves
                    }
            except IncompleteError:
                step, previous = self._best_step(), step
                if step == previous:
                    raise
        raise InputError(f"{self.folder} has no checkpoint; train a network with `sean train imitation`.")

    def _best_step(self) -> int | None:
        with _explained(self.folder / "checkpoints"):
            _retry(self.manager.reload)
            return self.manager.best_step()

    def _restore(self, step: int, like: Tree, part: str | None = None, finite: bool = False) -> Tree:
        sharding = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])  # each process reads all of it
        shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), like)
        target = shapes if part is None else {part: shapes}
        with _explained(self.folder / "checkpoints" / str(step)):
            placement = ocp.checkpoint_utils.construct_restore_args(target)
            request = ocp.args.PyTreeRestore(item=target, restore_args=placement, partial_restore=True)  # pyright: ignore
            content = self.manager.restore(step, args=ocp.args.Composite(**{STATE: request}))
            restored = content[STATE]
            digests = (self.manager.metrics(step) or {}).get(DIGESTS, {})  # earlier versions wrote none
            if any(digests.get(name, digest) != digest for name, digest in _digests(restored).items()):
                raise ValueError("other numbers than were saved")
            found = restored if part is None else restored[part]
            if finite and not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found)):
                raise ValueError("a number is not finite")
            return found


def _digests(state: Any) -> dict[str, str]:
    """Field of a state -> SHA-256 of its arrays; {} where this process has only a share of them."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    if any(isinstance(leaf, jax.Array) and not leaf.is_fully_addressable for _, leaf in leaves):
        return {}
    found: dict[str, Any] = {}
    for name, leaf in sorted((jax.tree_util.keystr(path, simple=True, separator="/"), leaf) for path, leaf in leaves):
        array = np.ascontiguousarray(leaf)
        digest = found.setdefault(name.partition("/")[0], hashlib.sha256())
        digest.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return {name: digest.hexdigest() for name, digest in found.items()}


@contextlib.contextmanager
def _explained(checkpoint: Path) -> Iterator[None]:
    """Whatever orbax raises about a checkpoint becomes a sentence."""
    try:
        yield
    except IncompleteError:
        raise
    except Exception as error:  # which one depends on the byte that is damaged
        why = error.strerror.lower() if isinstance(error, OSError) and error.strerror else "it is damaged"
        raise IncompleteError(f"{checkpoint} cannot be read ({why}); {CURE}") from error


def _check_entries(checkpoint: Path) -> None:
    """IncompleteError for what is neither a file nor a folder: orbax would wait for a pipe, and never end a device."""
    for folder, _, names in os.walk(checkpoint):
        for name in names:
            path = Path(folder) / name
            if not path.is_file() and os.path.lexists(path):
                raise IncompleteError(f"{checkpoint} cannot be read ({name} is no file); {CURE}")


def check_config(folder: Path, config: dict[str, Any]) -> bool:
    """Check that a training of this configuration may start or continue in the folder.

    Args:
        config: values that JSON can hold. ``versions`` and ``command`` may differ from those on disk.

    Returns:
        Whether the folder holds a training of this configuration already.

    Raises:
        InputError: it holds another training, or something else.
    """
    file = folder / CONFIG
    if not file.exists():
        if writing.contents(folder):
            raise InputError(f"the folder {folder} holds something else already, choose another with --out.")
        return False
    try:
        saved = files.read_json(file)
    except FileError as error:
        raise InputError(f"{str(error).rstrip('.')}; choose another folder with --out.") from None
    if not isinstance(saved, dict):
        raise InputError(f"{file} is no configuration of a network; choose another folder with --out.")
    saved = present_names(saved)
    for name, value in json.loads(json.dumps(config)).items():
        if name == "parts":
            _check_parts(file, value, saved.get(name))
        elif name not in ("versions", "command") and saved.get(name) != value:
            difference = f"{name.replace('_', ' ')} {_text(saved.get(name))}, not {_text(value)}"
            raise InputError(f"{folder} has checkpoints of another network, with {difference}; choose another --out.")
    return True


def _check_parts(file: Path, now: dict[str, str], saved: Any) -> None:
    """Refuse to go on with another content of own files; a training of an earlier version does not tell theirs."""
    for name, digest in now.items():
        if not isinstance(saved, dict) or saved.get(name) != digest:
            what = f"{file.parent} was trained with another {name}, or with one whose content it does not tell"
            raise InputError(f"{what}; restore the file, or choose another --out.")


def write_config(folder: Path, config: dict[str, Any]) -> None:
    """Write the configuration of a new training.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        writing.write(folder / CONFIG, json.dumps(config, indent=1) + "\n")
    except OSError as error:
        why = writing.reason(error)
        raise InputError(f"cannot write {folder}: {why}; choose another folder with --out.") from error


def _retry(read: Callable[[], Result]) -> Result:
    """The result of ``read``, repeated while a running training removes checkpoints."""
    for _ in range(ATTEMPTS):
        try:
            return read()
        except FileNotFoundError:
            continue
    return read()


def _text(value: Any) -> str:
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else str(value)

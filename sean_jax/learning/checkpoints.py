"""Checkpoints of a training through orbax: the latest and the best are kept, and a half-written one is never seen.

orbax deletes the latest checkpoint where only the best are asked for, and a training would begin anew: so both are.
"""

import json
import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax
import orbax.checkpoint as ocp
from orbax.checkpoint.checkpoint_managers import AnyPreservationPolicy, BestN, LatestN

from sean_jax import files, writing
from sean_jax.learning.learned import Weights
from sean_jax.learning.manifests import CONFIG
from sean_jax.learning.options import Failed, Refused
from sean_jax.learning.training import TrainState

STATE = "state"
SPARE = 4_000_000  # bytes, that must be free beside what a checkpoint may take
AGAIN = 10  # times

Read = TypeVar("Read")


def _less_loss(metrics: dict[str, float]) -> float:
    return -metrics["loss"]


class Checkpoints:
    """The checkpoints in a folder, each named by the number of epochs that were done.

    Who writes them holds the folder (``writing.held``), for what is left of a kill is removed; who does not, changes
    nothing there. A kill may leave a checkpoint half deleted, which orbax still counts: only those that are neither the
    latest nor the best are ever deleted, and no others are read.
    """

    def __init__(self, folder: Path, writes: bool = False):
        logging.getLogger("absl").setLevel(logging.CRITICAL)  # orbax tells of every step it takes
        self.folder = Path(folder).absolute()
        keep = AnyPreservationPolicy([LatestN(n=1), BestN(get_metric_fn=_less_loss, n=1)])
        options = ocp.CheckpointManagerOptions(
            best_fn=_less_loss,  # decides nothing here, but without it the losses would not be kept on disk
            preservation_policy=keep,
            cleanup_tmp_directories=writes,
            create=writes,
            read_only=not writes,
        )
        self.manager = _steadily(lambda: ocp.CheckpointManager(self.folder / "checkpoints", options=options))
        if writes:
            for step in {*self.manager.all_steps()} - {self.manager.latest_step(), self.manager.best_step()}:
                self.manager.delete(step)

    def save(self, state: TrainState, loss: float) -> None:
        """Keep the state after an epoch, in the background. Raises Failed if the last one could not be written."""
        needed = 2 * sum(leaf.nbytes for leaf in jax.tree.leaves(state)) + SPARE
        if shutil.disk_usage(self.folder).free < needed:  # of a write that fails, orbax's threads print pages
            raise Failed(f"{self.folder}: the disk is full; earlier checkpoints are as they were.")
        try:
            content = ocp.args.Composite(**{STATE: ocp.args.PyTreeSave(state)})  # pyright: ignore
            self.manager.save(int(state.epoch), args=content, metrics={"loss": loss}, force=True)
        except (OSError, ValueError) as error:
            raise Failed(f"{self.folder}: {_reason(error)}; earlier checkpoints are as they were.") from error

    def wait(self) -> None:
        """Until all is written. Raises Failed if it cannot be."""
        try:
            self.manager.wait_until_finished()
        except (OSError, ValueError) as error:
            raise Failed(f"{self.folder}: {_reason(error)}; earlier checkpoints are as they were.") from error

    def latest(self, like: TrainState) -> TrainState | None:
        """The latest state, with the shapes and types of ``like``; None if there is none.

        Raises Failed if it cannot be read.
        """
        step = self.manager.latest_step()
        return None if step is None else self._restore(step, like)

    def best_weights(self, like: Weights) -> Weights:
        """The weights with the least loss in validation, the latest of equals. Raises Refused if there are none."""
        best, before = self._best(), None
        while best is not None:
            try:
                return self._restore(best, like, part="weights")
            except Failed:
                best, before = self._best(), best
                if best == before:
                    raise  # else a training that goes on has a better one by now
        raise Refused(f"{self.folder} has no checkpoint; train a network with `sean train imitation`.")

    def _best(self) -> int | None:
        _steadily(self.manager.reload)
        return self.manager.best_step()

    def _restore(self, step: int, like: Any, part: str | None = None) -> Any:
        sharding = jax.sharding.SingleDeviceSharding(jax.devices()[0])
        one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), like)
        target = one if part is None else {part: one}
        try:
            placed = ocp.checkpoint_utils.construct_restore_args(target)
            given = ocp.args.PyTreeRestore(item=target, restore_args=placed, partial_restore=True)  # pyright: ignore
            content = self.manager.restore(step, args=ocp.args.Composite(**{STATE: given}))
            return content[STATE] if part is None else content[STATE][part]
        except (OSError, ValueError, KeyError, TypeError) as error:
            where = self.folder / "checkpoints" / str(step)
            raise Failed(
                f"{where} cannot be read ({_reason(error)}); remove it to go on from an earlier one."
            ) from error


def begun(folder: Path, config: dict[str, Any]) -> bool:
    """Whether a training of that configuration was begun in the folder.

    Raises Refused if another training was, or something else is there.
    """
    file = folder / CONFIG
    if not file.exists():
        if writing.contents(folder):
            raise Refused(f"the folder {folder} holds something else already, choose another with --out.")
        return False
    try:
        had = files.read_json(file)
    except files.FileError as error:
        raise Refused(f"{str(error).rstrip('.')}; choose another folder with --out.") from None
    if not isinstance(had, dict):
        raise Refused(f"{file} is no configuration of a network; choose another folder with --out.")
    for name, value in json.loads(json.dumps(config)).items():
        if name not in ("versions", "command") and had.get(name) != value:
            said = f"{name.replace('_', ' ')} {_shown(had.get(name))}, not {_shown(value)}"
            raise Refused(f"{folder} has checkpoints of another network, with {said}; choose another --out.")
    return True


def begin(folder: Path, config: dict[str, Any]) -> None:
    """A training of that configuration begins. Raises Refused if the folder cannot be written."""
    try:
        writing.write(folder / CONFIG, json.dumps(config, indent=1) + "\n")
    except OSError as error:
        why = writing.reason(error)
        raise Refused(f"cannot write {folder}: {why}; choose another folder with --out.") from error


def _steadily(read: Callable[[], Read]) -> Read:
    """What is read, again if a training that goes on has removed a checkpoint meanwhile."""
    for _ in range(AGAIN):
        try:
            return read()
        except FileNotFoundError:
            continue
    return read()


def _shown(value: Any) -> str:
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else str(value)


def _reason(error: Exception) -> str:
    text = str(error).strip().split("\n")[0].rstrip(".")
    return "the disk is full" if "No space left" in text or getattr(error, "errno", 0) == 28 else text[:200]

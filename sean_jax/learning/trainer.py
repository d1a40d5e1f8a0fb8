"""The loop that all trainings share, and their folder: configuration, checkpoints through orbax, and log.

The latest and the best checkpoint are kept, and a half-written one is never read. If only the best were kept, orbax
would delete the latest, and a training would restart. The SHA-256 of each field of the state stands beside the loss,
since orbax restores arrays whose bytes were changed on disk.
"""

import contextlib
import hashlib
import io
import json
import logging
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
import orbax.checkpoint as ocp
from jax.experimental import multihost_utils
from orbax.checkpoint.checkpoint_managers import AnyPreservationPolicy, BestN, LatestN

from sean_jax.config import DaggerConfig, ReinforcementConfig, user_parts
from sean_jax.config.flags import command
from sean_jax.config.workspace import CONTENT, read_identity, refuse_difference, refuse_others
from sean_jax.core import user_code
from sean_jax.core.errors import IncompleteError, InputError, SeanError
from sean_jax.io import files, interrupts, writing
from sean_jax.io.versions import versions
from sean_jax.learning.networks import CONFIG, named_leaves

METRICS, CURVE = "metrics.jsonl", "curve.png"
STATE, DIGESTS = "state", "sha256"
RESERVE = 4_000_000  # bytes that must be free in addition to the size of a checkpoint
UNCHANGED = "earlier checkpoints are as they were."  # how a message about a failed write ends
CURE = "remove it to resume from an earlier checkpoint."
ATTEMPTS = 10  # to read while a training replaces checkpoints

Result = TypeVar("Result")
Tree = TypeVar("Tree")


# ------------------------------------------------------------------ the loop


class Report(NamedTuple):
    """The report of an epoch or update of a training."""

    number: int  # epochs or updates done
    metrics: dict[str, Any]  # a line of metrics.jsonl without its time
    loss: float  # by which checkpoints are compared
    due: bool  # whether a checkpoint is due
    note: str


class Loop(NamedTuple):
    """The functions of a training."""

    advance: Callable[[Any], tuple[Any, Report]]  # one epoch or update of a state
    is_over: Callable[[Any], bool]
    done: Callable[[Any], int]  # epochs or updates
    place: Callable[[Any], Any]  # puts a state on the devices
    encode: Callable[[Any], Any] = lambda state: state  # a state as checkpoints hold it
    decode: Callable[[Any, Any], Any] = lambda saved, state: saved  # its inverse, for the structure of a state


def fit(
    folder: Path,
    config: dict[str, Any],
    state: Tree,
    loop: Loop,
    total: int,
    tell: Any,
    callbacks: Sequence[Callable[[dict[str, Any]], object]] = (),
) -> Tree:
    """The state at the end of a training in a locked folder, from its latest checkpoint if it has one.

    The first Ctrl-C or SIGTERM ends it after the present epoch, with a checkpoint; until the first epoch has ended, and
    the second time, it ends at once.

    Args:
        config: of the folder, as ``check_config`` compares it.
        state: before the first epoch.
        total: epochs or updates, for the progress ``tell``.
        callbacks: are called with each line of metrics.jsonl.

    Raises:
        PartError: a callback fails. The checkpoints stay.
        IncompleteError: a file is damaged or cannot be written. The checkpoints stay.
    """
    resumes = on_first_process(lambda: check_config(folder, config))
    if not resumes:
        on_first_process(lambda: write_config(folder, config))
    checkpoints = Checkpoints(folder, writes=True)
    saved = checkpoints.latest(loop.encode(state)) if resumes else None
    state = loop.place(state if saved is None else loop.decode(saved, state))
    log = Log(folder, loop.done(state)) if is_first_process() else None
    tell.stage("compiling")
    signals, stops, compiled, unsaved = [], False, False, None
    with contextlib.ExitStack() as stack:
        try:
            while not (loop.is_over(state) or signals or stops):
                state, report = loop.advance(state)
                if log is not None:  # before the checkpoint: later lines are dropped at a restart
                    line = report.metrics | {"time": time.time()}
                    log.add(line)
                    for callback in callbacks:
                        name = getattr(callback, "__name__", type(callback).__name__)
                        user_code.call(f"callback {name}", callback, "line", json.loads(json.dumps(line)))
                if not compiled:
                    compiled = True
                    tell.start("training", total)
                    if jax.process_count() == 1:  # several must agree, by ``must_stop``
                        signals = stack.enter_context(interrupts.deferred())
                unsaved = None if report.due else report
                if report.due:
                    checkpoints.save(loop.encode(state), report.number, report.loss)
                    if log is not None and "evaluation" in report.metrics:
                        draw_curve(folder)
                tell.update(report.number, report.note)
                stops = must_stop(report.number)
            if unsaved is not None:
                checkpoints.save(loop.encode(state), unsaved.number, unsaved.loss)
        finally:
            checkpoints.wait()
        if stops:
            raise KeyboardInterrupt
    return state


# ------------------------------------------------------------------ several processes
# Every process computes the same numbers, each on its own devices; process 0 alone has the lock and the log. If one
# refuses, all must hear of it: the others would wait for it forever.


def is_first_process() -> bool:
    """Whether this process writes."""
    return jax.process_index() == 0


def must_stop(step: int) -> bool:
    """Whether a process got SIGTERM, as from a scheduler that ends the job; all processes agree on the step.

    ``jax.distributed`` takes that signal for itself, unless its option ``jax_enable_preemption_service`` is off.

    Args:
        step: greater at each call, and equal in all processes.
    """
    listens = jax.config.jax_enable_preemption_service  # pyright: ignore[reportAttributeAccessIssue]
    return listens and multihost_utils.reached_preemption_sync_point(step)


def on_all_processes(work: Callable[[], Result]) -> Result:
    """The result of work that every process does, after all have done it.

    Raises:
        InputError: another process refused; the message has its number.
        SeanError: this process refused.
    """
    if jax.process_count() == 1:
        return work()
    result, refusal = None, None
    try:
        result = work()
    except SeanError as error:
        refusal = error
    refused = np.asarray(multihost_utils.process_allgather(np.asarray(refusal is not None)))
    if refusal is not None:
        raise refusal
    if refused.any():
        raise InputError(f"process {int(refused.argmax())} of {refused.size} has refused; see its message.")
    return result  # pyright: ignore[reportReturnType]


def on_first_process(work: Callable[[], bool | None]) -> bool:
    """The result of work that process 0 does alone, while the others wait.

    Raises:
        InputError: process 0 refused.
        SeanError: the error of the work, in process 0.
    """
    result = bool(on_all_processes(work if is_first_process() else lambda: False))
    return result if jax.process_count() == 1 else bool(multihost_utils.broadcast_one_to_all(np.asarray(result)))


# ------------------------------------------------------------------ log


class Log:
    """metrics.jsonl in the folder of a training, and events for TensorBoard if tensorboardX is installed."""

    def __init__(self, folder: Path, epochs: int):
        """Open a log, and drop the lines of epochs after the last checkpoint, which an interruption left."""
        self.folder = folder
        lines = [line for line in read_metrics(folder) if line["epoch"] <= epochs]
        writing.write(folder / METRICS, "".join(json.dumps(line) + "\n" for line in lines))
        try:
            from tensorboardX import SummaryWriter  # pyright: ignore[reportMissingImports]

            self.events = SummaryWriter(str(folder), purge_step=epochs + 1)
        except ImportError:
            self.events = None

    def add(self, line: dict[str, Any]) -> None:
        """Append a line: ``epoch``, ``time`` [s since 1970], and numbers, also in dicts.

        Raises:
            IncompleteError: the log cannot be written. The checkpoints stay.
        """
        with writing.explain_errors(self.folder, "the checkpoints until then are as they were."):
            with (self.folder / METRICS).open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(line) + "\n")
            if self.events is not None:
                for name, value in _scalars(line):
                    self.events.add_scalar(name, value, line["epoch"], line["time"])
                self.events.flush()


def _scalars(line: dict[str, Any]) -> Iterator[tuple[str, float]]:
    for name, value in line.items():
        if isinstance(value, dict):
            yield from ((f"{name}/{key}", number) for key, number in value.items())
        elif name not in ("epoch", "time"):
            yield name, value


def read_metrics(folder: Path) -> list[dict[str, Any]]:
    """The complete lines of a training's log, up to the first that is damaged; a kill may have cut the last one."""
    file, lines = folder / METRICS, []
    log = files.read_text(file, files.MAX_RECORD) if file.exists() else ""
    if files.count_values(log) > files.MAX_JSON_VALUES:
        raise files.file_error(file, "has more lines than can be shown; keep the last ones")
    for text in log.splitlines():
        try:
            line = files.parse_json(text, finite=False)
            epoch, clock = int(line["epoch"]), float(line["time"])
            if not 0.0 <= clock < math.inf:
                break
            lines.append({**line, "epoch": epoch, "time": clock})
        except (ValueError, TypeError, KeyError, OverflowError):
            break
    return lines


CURVES = (
    ("return", "return of an episode"),
    ("completed", "share of tasks completed"),
    ("intimate_robot_on_person", "intimate, robot on person"),
)
"""Name in an evaluation, and title."""


def draw_curve(folder: Path) -> None:
    """Write curve.png: return, completed tasks and violations of evaluations over steps; single agents are pale."""
    from matplotlib.figure import Figure

    lines = read_metrics(folder)
    seconds = np.cumsum([line["seconds"] for line in lines])
    evaluations = [line for line in lines if "evaluation" in line]
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    for axes, (name, title) in zip(figure.subplots(1, 3), CURVES, strict=True):
        for part in sorted({key for key in evaluations[-1] if key.startswith("agent ")}):
            axes.plot(*_points(evaluations, part, name), color="#1a6faf", alpha=0.3, linewidth=1.0)
        axes.plot(*_points(evaluations, "evaluation", name), color="#1a6faf")
        axes.set(xlabel="million scenario-steps of an agent", title=title)
        axes.grid(alpha=0.3)
    figure.suptitle(f"{len(evaluations)} evaluations, {seconds[-1]:,.0f} s of training", fontsize="medium")
    picture = io.BytesIO()
    figure.savefig(picture, dpi=110, format="png")
    writing.write(folder / CURVE, picture.getvalue())


def _points(lines: list[dict], part: str, name: str) -> tuple[list[float], list[float]]:
    points = [(line["steps"] / 1e6, line[part][name]) for line in lines if name in line.get(part, {})]
    return [x for x, _ in points], [y for _, y in points]


# ------------------------------------------------------------------ checkpoints


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
        step, previous = self._best_step(), None
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
        why = error.strerror.lower() if isinstance(error, OSError) and error.strerror else "it is damaged"
        raise IncompleteError(f"{checkpoint} cannot be read ({why}); {CURE}") from error


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


# ------------------------------------------------------------------ configuration


def method_config(options: DaggerConfig | ReinforcementConfig, **facts: Any) -> dict[str, Any]:
    """The configuration of a folder of ``sean train``, with further facts that decide the result."""
    return {
        "command": command("train", options),
        "method": options.method,
        **options.identity(),
        "parts": user_parts.digests(options),
        **facts,
        "versions": versions(),
    }


def check_config(folder: Path, config: dict[str, Any]) -> bool:
    """Whether the folder holds a training of this configuration (JSON values) already.

    ``versions`` and ``command`` may differ from those on disk.

    Raises:
        InputError: it holds another training, or something else.
    """
    saved = read_identity(folder / CONFIG)
    if saved is None:
        refuse_others(folder)
        return False
    refuse_difference(folder, _identity(saved), _identity(config))
    return True


def _identity(config: dict[str, Any]) -> dict[str, Any]:
    """The entries that a training must have in common with its folder, with the digests of own files."""
    entries = {name.replace("_", " "): value for name, value in config.items()}
    parts = {CONTENT + name: digest for name, digest in entries.pop("parts", {}).items()}
    return {name: value for name, value in entries.items() if name not in ("versions", "command")} | parts


def write_config(folder: Path, config: dict[str, Any]) -> None:
    """Write the configuration of a new training.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        writing.write(folder / CONFIG, config)
    except OSError as error:
        why = writing.reason(error)
        raise InputError(f"cannot write {folder}: {why}; choose another folder with --out.") from error

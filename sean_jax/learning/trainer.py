"""The loop that all trainings share, and their folder: configuration, log and curve."""

import contextlib
import io
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int, PyTree

from sean_jax.config import DaggerConfig, ReinforcementConfig, user_parts
from sean_jax.config.flags import command
from sean_jax.config.workspace import CONTENT, read_identity, refuse_difference, refuse_others
from sean_jax.core import user_calls
from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError
from sean_jax.io import files, interrupts, writing
from sean_jax.io.versions import versions
from sean_jax.learning import costs
from sean_jax.learning.checkpoints import Checkpoints
from sean_jax.learning.curriculum import Curriculum
from sean_jax.learning.networks import CONFIG, Agent, Best
from sean_jax.learning.processes import is_first_process, must_stop, on_first_process
from sean_jax.learning.rollouts import EnvBatch

METRICS, CURVE = "metrics.jsonl", "curve.png"
LOWEST = float(np.finfo(np.float32).min)  # value of agents that were never evaluated

Result = TypeVar("Result")
Tree = TypeVar("Tree")


# ------------------------------------------------------------------ the loop


@struct.dataclass
class TrainState:
    """The state of a training. The field names are the names in checkpoints on disk."""

    agent: Agent  # (A, ...)
    optimizer: PyTree  # (A, ...)
    best: Best
    update: Int[Array, ""]  # updates or epochs done
    rows: EnvBatch | None = None  # (A, B, ...); None of a dataset
    curriculum: Curriculum | None = None  # (A, ...); None: all starts of the pool are alike
    multipliers: costs.Multipliers | None = None  # of costs; None without any


def begin_best(agent: Agent, agents: tuple[int, ...]) -> Best:
    """Agents before any evaluation; ``agents`` is (A,) or ()."""
    return Best(agent, jnp.full(agents, LOWEST, jnp.float32), jnp.zeros(agents, jnp.int32))


def keep_best(state: TrainState, value: Float[Array, "*A"]) -> TrainState:
    """The state in which agents with a greater value than before are the best."""
    better = value > state.best.value
    latest = Best(state.agent, value, jnp.broadcast_to(state.update, value.shape))

    def choose(old: Array, new: Array) -> Array:
        return jnp.where(better.reshape(*better.shape, *(1,) * (new.ndim - better.ndim)), new, old)

    return replace(state, best=jax.tree.map(choose, state.best, latest))


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
    # A training goes on from its latest checkpoint; later lines of its log are dropped.
    resumes = on_first_process(lambda: check_config(folder, config))
    if not resumes:
        on_first_process(lambda: write_config(folder, config))
    checkpoints = Checkpoints(folder, writes=True)

    # The decoded state is placed on the devices of this run, which may be others than before.
    saved = checkpoints.latest(loop.encode(state)) if resumes else None
    state = loop.place(state if saved is None else loop.decode(saved, state))
    log = MetricsLog(folder, loop.done(state)) if is_first_process() else None

    # A signal ends it between two epochs, but not while the first one compiles.
    tell.stage("compiling")
    signals = []
    stops = False
    compiled = False
    unsaved = None
    with contextlib.ExitStack() as stack:
        try:
            # A loop may be over at once: that of a finished training that is started again.
            while not (loop.is_over(state) or signals or stops):
                state, report = loop.advance(state)
                if log is not None:  # before the checkpoint: later lines are dropped at a restart
                    line = report.metrics | {"time": time.time()}
                    log.add(line)
                    for callback in callbacks:
                        # A callback gets its own copy of the line, so it cannot change the log.
                        name = getattr(callback, "__name__", type(callback).__name__)
                        user_calls.call(f"callback {name}", callback, "line", json.loads(json.dumps(line)))

                # Time that is left is estimated from here on, without compiling.
                if not compiled:
                    compiled = True
                    tell.start("training", total)
                    if jax.process_count() == 1:  # several must agree, by ``must_stop``
                        signals = stack.enter_context(interrupts.deferred())

                # What is not due is saved at the end.
                unsaved = None if report.due else report
                if report.due:
                    checkpoints.save(loop.encode(state), report.number, report.loss)
                    if log is not None and "evaluation" in report.metrics:
                        draw_curve(folder)
                tell.update(report.number, report.note)
                stops = must_stop(report.number)

            # A training that is stopped loses no finished epoch.
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


class MetricsLog:
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
    file = folder / METRICS
    lines = []
    log = files.read_text(file, files.MAX_RECORD) if file.exists() else ""
    if files.count_values(log) > files.MAX_JSON_VALUES:
        raise files.file_error(file, "has more lines than can be shown; keep the last ones")
    for text in log.splitlines():
        try:
            line = files.parse_json(text, finite=False)
            epoch = int(line["epoch"])
            clock = float(line["time"])
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

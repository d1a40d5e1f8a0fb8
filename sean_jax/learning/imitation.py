"""``sean train imitation``: learn to drive from demonstrations, with checkpoints (section V-C).

AdamW minimizes the losses of ``bc``, epoch by epoch, until the validation loss stops falling. With the dataset on the
device, an epoch is two compiled calls after the shuffle: a scan over batches, and a scan over the validation batches.
The shuffle depends on (seed, epoch) alone, so the same command continues from the latest checkpoint after an
interruption and ends with the same weights.
"""

import contextlib
import functools
import math
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float, Int

from sean_jax.config import ImitationConfig
from sean_jax.config.flags import command
from sean_jax.core import devices, random_streams
from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.io.progress import Progress, ProgressLike, progress
from sean_jax.io.versions import versions
from sean_jax.learning import bc
from sean_jax.learning.bc import CloningLosses, Student
from sean_jax.learning.checkpoints import Checkpoints
from sean_jax.learning.dataset import ConcatDataset, Episode, fill_up, on_device, open_datasets, split_each, windows
from sean_jax.learning.examples import Recording, balanced_probabilities
from sean_jax.learning.networks import AgentDescription, NetworkConfig, attention_sources, describe_imitation
from sean_jax.learning.policy import imitation_config, read_agent
from sean_jax.learning.trainer import Loop, MetricsLog, Report, TrainState, begin_best, check_config, fit, write_config

MIN_COMMAND_SCALE = 0.05  # m/s, rad/s: the scale of a command that hardly varies
CHECKPOINT_INTERVAL = 10  # epochs between two checkpoints while the loss does not improve
DEFAULT_MEMORY = 4e9  # bytes, for a device that does not report its memory


@dataclass(frozen=True)
class Training:
    """A network, and the data from which it learns."""

    options: ImitationConfig
    data: ConcatDataset
    config: NetworkConfig
    training: list[Episode]
    validation: list[Episode]

    @property
    def description(self) -> AgentDescription:
        """The agent, for a second between two examples."""
        return describe_imitation(self.config, time_step=1.0)

    @property
    def student(self) -> Student:
        """The network with its optimizer."""
        return bc.make_student(self.description, self.options.learning_rate, self.options.weight_decay)

    @property
    def length(self) -> int:
        """The number of examples that train."""
        return sum(episode.length for episode in self.training)

    @property
    def bytes(self) -> int:
        """Size of the examples in memory."""
        return self.data.example_count * self.data.row_bytes

    def read(self, field: str) -> np.ndarray:
        """A field of the examples that train, (R, ...)."""
        return self.data.read(self.training, (field,))[field]

    def recording(self) -> Recording:
        """All examples: first the training examples."""
        return self.data.recording([*self.training, *self.validation])

    def probabilities(self) -> Float[np.ndarray, "R"] | None:
        """With which examples are drawn; None: each once."""
        return balanced_probabilities(self.read("situations")) if self.options.balance else None

    def file(self) -> dict[str, Any]:
        """The content of config.json."""
        options = self.options
        data = self.data
        if data.example_count < 2:
            raise InputError(f"{data.folder} has {data.example_count} examples, too few to learn from; collect more.")
        return {
            "command": command("train", options),
            **self.config.model_dump(mode="json"),
            "sources": attention_sources(options.flags),
            **{name: value for name, value in options.identity().items() if name not in ("width", "flags")},
            "devices": len(jax.devices()),
            "dataset": {"fingerprint": data.fingerprint(), "command": data.manifest["command"]},
            "versions": versions(),
        }


def train(options: ImitationConfig, console: ProgressLike = None) -> TrainState:
    """Train a network, or resume its training; the state then. ``learning.load`` reads the best weights.

    Arguments and errors are those of ``reinforcement.train``.
    """
    training = prepare(options)
    check_config(options.folder, training.file())  # refuses before anything is written
    with writing.folder_lock(options.folder), progress(console) as tell:
        return _train(training, tell)


def prepare(options: ImitationConfig) -> Training:
    """The data and the network of a training.

    Raises:
        InputError: there is no such dataset, or the pretrained network is missing or another one.
    """
    data = open_datasets([options.dataset, *options.datasets], options.part)
    names = data.manifest["situations"]
    config = NetworkConfig(width=options.width, flags=options.flags, image=data.image_shape, situations=names)
    if options.pretrained is not None:
        had = imitation_config(options.pretrained, names).model_copy(update={"situations": names})
        if had != config:
            raise InputError(
                f"pretrained: {options.pretrained} has another network, {had}, not {config}; ask for the same."
            )
    return Training(options, data, config, *split_each(data, options.validation, options.seed))


def command_scale(commands: Float[np.ndarray | Array, "R 2"]) -> Float[Array, "2"]:
    """The standard deviation (2,) of commands (R, 2) [m/s, rad/s], the unit of the network's commands."""
    return jnp.maximum(jnp.std(jnp.asarray(commands), 0), MIN_COMMAND_SCALE)


def init_state(
    description: AgentDescription, student: Student, seed: Array | int, scale: Float[Array, "2"]
) -> TrainState:
    """The state before the first epoch. ``scale`` is of ``command_scale``."""
    agent = description.init(random_streams.key("weights", seed))
    agent = replace(agent, command_scale=scale)
    optimizer = student.optimizer.init(agent.parameters)
    return TrainState(agent, optimizer, begin_best(agent, ()), jnp.zeros((), jnp.int32))


def shuffled(rows: Int[Array, "R"], probabilities: Float[Array, "R"] | None, seed: int, epoch: Array) -> Array:
    """Rows (R,) in the order of an epoch, or drawn with these probabilities."""
    key = jax.random.fold_in(random_streams.key("order", seed), epoch)
    if probabilities is None:
        return jax.random.permutation(key, rows)
    return jax.random.choice(key, rows, rows.shape, p=probabilities)


def _train(training: Training, tell: Progress) -> TrainState:
    """Train in a folder that this process has locked."""
    options = training.options
    mesh = devices.mesh()
    epoch = _epoch(training, mesh)

    def advance(state: TrainState) -> tuple[TrainState, Report]:
        start = time.time()
        state, training_losses, validation_losses = epoch(state)
        return state, _report(options, state, training_losses, validation_losses, time.time() - start)

    # Checkpoints hold the networks that were trained in parallel, here one.
    loop = Loop(
        advance=advance,
        is_over=functools.partial(_is_over, options),
        done=lambda state: int(state.update),
        place=functools.partial(devices.replicate, mesh),
        encode=lambda state: jax.tree.map(lambda leaf: leaf[None], state),
        decode=lambda saved, _: jax.tree.map(lambda leaf: leaf[0], saved),
    )
    return fit(options.folder, training.file(), _first_state(training), loop, options.epochs, tell)


def _first_state(training: Training) -> TrainState:
    """The state before the first epoch, of new weights or of those of another training."""
    options = training.options
    description = training.description
    init = jax.jit(functools.partial(init_state, description, training.student))
    state = init(options.seed, command_scale(training.read("command")))
    if options.pretrained is None:
        return state
    agent = read_agent(options.pretrained, description)
    copied = jax.tree.map(jnp.copy, agent)  # both are donated
    return replace(state, agent=agent, best=begin_best(copied, ()))


def _is_over(options: ImitationConfig, state: TrainState) -> bool:
    epochs = int(state.update)
    return epochs >= options.epochs or epochs - int(state.best.update) >= options.patience


def _report(
    options: ImitationConfig, state: TrainState, training: CloningLosses, validation: CloningLosses, seconds: float
) -> Report:
    """The report of an epoch.

    Raises:
        FloatingPointError: a loss is not finite.
    """
    number = int(state.update)
    best_number = int(state.best.update)
    loss = float(validation.loss)
    if not (math.isfinite(float(training.loss)) and math.isfinite(loss)):
        raise FloatingPointError(
            f"the loss is not finite in epoch {number}; {options.folder} keeps the checkpoints until then; "
            "try a lower --learning-rate in another folder."
        )
    due = best_number == number or number % CHECKPOINT_INTERVAL == 0 or _is_over(options, state)
    best = f"best {-float(state.best.value):.4f} after {best_number}"
    note = f"epoch {number} · loss {loss:.4f}, {best}, {seconds:.2f} s an epoch"
    return Report(number, _line(number, training, validation), loss, due, note)


def _line(epoch: int, training: CloningLosses, validation: CloningLosses) -> dict[str, Any]:
    """A line of metrics.jsonl."""
    losses = (("train", training), ("validation", validation))
    return {"epoch": epoch} | {part: {k: float(v) for k, v in values._asdict().items()} for part, values in losses}


Windows = Callable[[int], Iterable[tuple[Recording, Int[Array, "R"]]]]
"""epoch -> recordings, and rows of each in the order of the epoch."""


def _epoch(training: Training, mesh: Mesh) -> Callable[[TrainState], tuple[TrainState, CloningLosses, CloningLosses]]:
    """An epoch, with the dataset on the devices if it fits there, else from disk."""
    options = training.options
    compiled = bc.programs(training.student, options.batch, mesh)
    fits = training.bytes <= options.device_memory_fraction * _memory()
    if options.balance and not fits:
        raise InputError(
            "--balance needs the dataset to fit on the device; collect less, or raise --device-memory-fraction."
        )
    training_windows, validation_windows = (_on_devices if fits else _from_disk)(training, mesh)

    def epoch(state: TrainState) -> tuple[TrainState, CloningLosses, CloningLosses]:
        training_sums = jnp.zeros(4, jnp.float32)
        validation_sums = jnp.zeros(4, jnp.float32)
        for recording, rows in training_windows(int(state.update)):
            state, sums = compiled.learn(state, recording, rows)
            training_sums = training_sums + sums
        for recording, rows in validation_windows(0):
            validation_sums = validation_sums + compiled.measure(state, recording, rows)
        return compiled.finish(state, training_sums, validation_sums)

    return epoch


def _on_devices(training: Training, mesh: Mesh) -> tuple[Windows, Windows]:
    """All rows at once, to train and to validate."""
    seed = training.options.seed
    probabilities = training.probabilities()
    recording = devices.replicate(mesh, on_device(training.recording()))
    rows = jnp.arange(training.data.example_count, dtype=jnp.int32)
    training_rows = rows[: training.length]
    validation_rows = rows[training.length :]
    if probabilities is not None:
        probabilities = jnp.asarray(probabilities)
    shuffle = jax.jit(shuffled, static_argnums=2)
    return (
        lambda epoch: [(recording, shuffle(training_rows, probabilities, seed, epoch))],
        lambda epoch: [(recording, validation_rows)],
    )


def _from_disk(training: Training, mesh: Mesh) -> tuple[Windows, Windows]:
    """Batches of some episodes at a time, to train and to validate."""
    options = training.options
    size = -(-options.batch // mesh.size) * mesh.size

    def read(episodes: list[Episode], epoch: int) -> Iterator[tuple[Recording, Int[Array, "R"]]]:
        for recording, batches in windows(training.data, episodes, size, options.seed, epoch):
            recording = devices.replicate(mesh, recording)
            yield from ((recording, batch) for batch in batches)

    return functools.partial(read, training.training), functools.partial(read, training.validation)


def _memory() -> float:
    """Memory of the first device [bytes]."""
    try:
        return float((jax.devices()[0].memory_stats() or {})["bytes_limit"])
    except (KeyError, RuntimeError, NotImplementedError):  # a CPU, or a backend that does not report it
        return DEFAULT_MEMORY


# ------------------------------------------------------------------ several networks

OWN_OPTIONS = "dataset", "datasets", "part", "seed", "out", "quiet"  # in which the networks may differ
MAX_NETWORKS = 32  # in one program; fewer if their datasets fill the memory


def train_ensemble(several: Sequence[ImitationConfig], console: ProgressLike = None) -> list[TrainState]:
    """Train networks of one kind in parallel; the state of each after its last epoch.

    One program makes an epoch of all of them, so a GPU that one small network leaves idle is filled. Each stops by its
    own validation loss. The folders are as of ``train``; a killed training starts again.

    Args:
        several: they may differ in dataset, seed and folder.
        console: shows the progress; a function receives the share that is done.

    Raises:
        InputError: other options differ, a dataset is too large, or a folder holds something else.
        WriteError: another process trains in a folder.
        IncompleteError: a file is damaged or cannot be written.
        FloatingPointError: a loss is not finite; nothing of the networks that were trained together is written.
    """
    if several[0].pretrained is not None:
        raise InputError("pretrained: networks trained in parallel have none; train this network alone.")
    trainings = [prepare(options) for options in several]
    _check_alike(trainings)
    size = min(MAX_NETWORKS, _networks_at_once(trainings))
    states = []
    with progress(console) as tell, contextlib.ExitStack() as stack:
        for options in several:
            stack.enter_context(writing.folder_lock(options.folder))
        tell.start("training", len(several))
        for first in range(0, len(several), size):
            states += _train_ensemble(trainings[first : first + size], first, tell)
    return states


def _check_alike(trainings: list[Training]) -> None:
    alike = [
        {name: value for name, value in each.options.identity().items() if name not in OWN_OPTIONS}
        for each in trainings
    ]
    first = trainings[0]
    for one in alike[1:]:
        for name in one:
            if one[name] != alike[0][name]:
                raise InputError(f"{name}: {one[name]} and {alike[0][name]}; networks in parallel have the same.")
    if any(each.data.rate != first.data.rate for each in trainings):
        raise InputError("dataset: the datasets have different rates; collect all with the same --rate.")
    if any(each.data.image_shape != first.data.image_shape for each in trainings):
        raise InputError("dataset: the datasets have images of different sizes; collect all with the same --width.")


def _networks_at_once(trainings: list[Training]) -> int:
    """How many of the datasets fit on a device."""
    largest = max(training.bytes for training in trainings)
    number = int(trainings[0].options.device_memory_fraction * _memory() // max(largest, 1))
    if number < 1:
        raise InputError("dataset: it does not fit on the device; train each network alone.")
    return number


def _train_ensemble(trainings: list[Training], first: int, tell: Progress) -> list[TrainState]:
    """Networks whose folders are locked; ``first`` others were trained before."""
    # Folders are compared before anything is computed: networks of other options are not overwritten.
    options = trainings[0].options
    files = [training.file() for training in trainings]
    for training, file in zip(trainings, files, strict=True):
        check_config(training.options.folder, file)

    # The networks are one array program (A, ...), so that small ones fill the device together.
    states = _init_ensemble(trainings)
    data = _stack_data(trainings)
    epoch = _ensemble_epoch(trainings[0])
    over = np.zeros(len(trainings), bool)
    epochs = []

    while not over.all():
        # Networks that have stopped are computed as well and left unchanged: shapes in a program are fixed.
        start = time.time()
        states, losses = epoch(states, jnp.asarray(over), data)
        training_losses, validation_losses = (jax.tree.map(np.asarray, part) for part in losses)
        epochs.append(EnsembleEpoch(training_losses, validation_losses, ~over, start))

        # A network that has stopped may have any loss, since nothing of it is kept.
        if not np.isfinite([training_losses.loss[~over], validation_losses.loss[~over]]).all():
            raise FloatingPointError(
                "a loss is not finite; nothing of these networks is written; lower the learning rate."
            )

        # Each network stops by its own validation loss; the others go on.
        number = np.asarray(states.update)
        best_number = np.asarray(states.best.update)
        over |= (number >= options.epochs) | (number - best_number >= options.patience)
        share = max(float(over.mean()), number.max() / options.epochs)
        mean = float(validation_losses.loss.mean())
        stopped = f"{int(over.sum())} of {len(over)} stopped, loss {mean:.4f} on average"
        tell.update(first + share * len(over), f"epoch {number.max()} · {stopped}")

    # Checkpoints have a leading axis of agents, here of one; the returned states have none.
    own_states = [jax.tree.map(lambda leaf, row=row: leaf[row : row + 1], states) for row in range(len(trainings))]
    for row, (training, file, state) in enumerate(zip(trainings, files, own_states, strict=True)):
        _write_folder(training.options.folder, file, state, epochs, row)
    return [jax.tree.map(lambda leaf: leaf[0], state) for state in own_states]


class EnsembleEpoch(NamedTuple):
    """An epoch of networks that learn in parallel."""

    training: CloningLosses  # (A,)
    validation: CloningLosses  # (A,)
    active: np.ndarray  # (A,) bool, which networks learned
    start: float  # s since 1970


class EnsembleData(NamedTuple):
    """The data of networks that learn in parallel."""

    seed: Int[Array, "A"]
    recording: Recording  # (A, R, ...), filled up to the longest
    training: Int[Array, "A R"]  # rows that train, -1 for none
    validation: Int[Array, "A V"]  # rows that validate, -1 for none
    probabilities: Float[Array, "A R"]  # of the former


def _init_ensemble(trainings: list[Training]) -> TrainState:
    """The states (A, ...) before the first epoch."""
    seeds = jnp.asarray([training.options.seed for training in trainings], jnp.uint32)
    scales = jnp.stack([command_scale(training.read("command")) for training in trainings])
    init = functools.partial(init_state, trainings[0].description, trainings[0].student)
    return jax.jit(lambda *inputs: jax.lax.map(lambda own: init(*own), inputs))(seeds, scales)


def _stack_data(trainings: list[Training]) -> EnsembleData:
    """The data of trainings."""
    recordings = [training.recording() for training in trainings]
    longest = max(len(recording.first) for recording in recordings)
    recordings = [fill_up(recording, longest) for recording in recordings]
    index = np.arange(longest)
    widest = max(training.data.example_count - training.length for training in trainings)
    training_rows = []
    validation_rows = []
    probabilities = []
    for training in trainings:
        length = training.length
        count = training.data.example_count
        rows = length + np.arange(widest)
        training_rows.append(np.where(index < length, index, -1))
        validation_rows.append(np.where(rows < count, rows, -1))

        balanced = training.probabilities()
        chances = np.ones(length) / length if balanced is None else balanced
        probabilities.append(np.concatenate([chances, np.zeros(longest - length)]))

    return EnsembleData(
        seed=jnp.asarray([training.options.seed for training in trainings], jnp.uint32),
        recording=jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *recordings),
        training=jnp.asarray(np.stack(training_rows), jnp.int32),
        validation=jnp.asarray(np.stack(validation_rows), jnp.int32),
        probabilities=jnp.asarray(np.stack(probabilities), jnp.float32),
    )


def _ensemble_epoch(training: Training) -> Callable:
    """(states (A, ...), over (A,), data) -> (states, losses in training and validation); those that are over stay."""
    mesh = devices.mesh(jax.devices()[:1])
    compiled = bc.programs(training.student, training.options.batch, mesh, padded=True)

    def advance(state: TrainState, over: Array, data: EnsembleData) -> tuple[TrainState, list[CloningLosses]]:
        rows = data.training
        key = jax.random.fold_in(random_streams.key("order", data.seed), state.update)
        if training.options.balance:
            drawn = jax.random.choice(key, rows, rows.shape, p=data.probabilities)
            order = jnp.where(rows >= 0, drawn, -1)
        else:  # in another order, with none at the end
            chance = jnp.where(rows >= 0, jax.random.uniform(key, rows.shape), 2.0)
            order = rows[jnp.argsort(chance)]
        after, sums = compiled.learn(state, data.recording, order)
        after, *losses = compiled.finish(after, sums, compiled.measure(after, data.recording, data.validation))
        return jax.tree.map(lambda old, new: jnp.where(over, old, new), state, after), losses

    return jax.jit(jax.vmap(advance), donate_argnums=0)


def _write_folder(
    folder: Path, config: dict[str, Any], state: TrainState, epochs: list[EnsembleEpoch], index: int
) -> None:
    """The folder of a training that has ended; ``state`` is that of network ``index``, (1, ...)."""
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)  # of a killed training with other options
    write_config(folder, config)
    checkpoints = Checkpoints(folder, writes=True)
    checkpoints.save(state, int(state.update[0]), -float(state.best.value[0]))
    checkpoints.wait()

    log = MetricsLog(folder, 0)
    for number, epoch in enumerate((epoch for epoch in epochs if epoch.active[index]), 1):
        losses = (jax.tree.map(lambda value: value[index], part) for part in (epoch.training, epoch.validation))
        log.add(_line(number, *losses) | {"time": epoch.start})

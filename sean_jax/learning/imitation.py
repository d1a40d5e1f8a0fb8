"""``sean train imitation``: learn to drive from demonstrations, with checkpoints (section V-C).

The losses of the local planner and of the velocity controller have equal weight. AdamW minimizes their sum, epoch by
epoch, until the validation loss stops falling. An epoch is one compiled call after the shuffle: a scan over batches,
then a scan over the validation batches, with the dataset on the device. The shuffle depends on (seed, epoch) alone, so
the same command continues from the latest checkpoint after an interruption and ends with the same weights.
"""

import contextlib
import functools
import math
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from flax.typing import VariableDict
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Float, Int

from sean_jax.config import ImitationConfig
from sean_jax.config.flags import command
from sean_jax.core import devices, random_streams
from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.io.progress import Progress, ProgressLike, progress
from sean_jax.io.versions import versions
from sean_jax.learning.checkpoints import Checkpoints
from sean_jax.learning.dataset import ConcatDataset, Episode, on_device, open_datasets, split_each
from sean_jax.learning.examples import Example, Loader, Recording, Token, balanced_probabilities, example
from sean_jax.learning.networks import Decision, Network, Weights, init_weights, read_network
from sean_jax.learning.trainer import Log, Loop, Report, check_config, fit, write_config

MIN_COMMAND_SCALE = 0.05  # m/s, rad/s: the scale of a command that hardly varies
CHECKPOINT_INTERVAL = 10  # epochs between two checkpoints while the loss does not improve
DEFAULT_MEMORY = 4e9  # bytes, for a device that does not report its memory


@struct.dataclass
class TrainState:
    """The state of a training. The field names are the names in checkpoints on disk."""

    weights: Weights
    optimizer: optax.OptState
    epoch: Array  # () int32, epochs done
    best: Array  # () lowest validation loss so far
    best_epoch: Array  # () int32, the epoch that reached it


class Losses(NamedTuple):
    """Means over examples."""

    loss: Array  # () sum of the next two
    local_plan: Array  # () m2, mean squared distance from the places of the next five seconds
    command: Array  # () squared error of the command in units of ``Weights.scale``, summed over speed and turn rate


class TrainPrograms(NamedTuple):
    """The compiled functions of a training. Each compiles at its first call.

    "Sums" are the (4,) of ``_error_sums`` added over examples, from which ``Losses`` are computed.
    """

    # (state, recording, training rows (R,) in their order, validation rows (V,)); a row of -1 counts for nothing
    epoch: Callable  # -> (state, training Losses, validation Losses)
    update: Callable  # (state, examples (B, ...), weight (B,)) -> (state, sums): one step of the optimizer
    measure: Callable  # (state, examples (B, ...), weight (B,)) -> sums
    finish: Callable  # (state, training sums, validation sums) -> (state, Losses, Losses): the end of an epoch


@dataclass(frozen=True)
class Training:
    """A network, and the data from which it learns."""

    options: ImitationConfig
    data: ConcatDataset
    network: Network
    training: list[Episode]
    validation: list[Episode]

    @property
    def situations(self) -> int:
        """The number of social situations."""
        return len(self.data.manifest["situations"])

    @property
    def length(self) -> int:
        """The number of examples that train."""
        return sum(episode.length for episode in self.training)

    def read(self, field: str) -> np.ndarray:
        """A field of the examples that train, (R, ...)."""
        return self.data.read(self.training, (field,))[field]

    def recording(self) -> Recording:
        """All examples on the default device: first the training examples."""
        return on_device(self.data.recording([*self.training, *self.validation]))

    def config(self) -> dict[str, Any]:
        """The configuration of the folder."""
        options, network, data = self.options, self.network, self.data
        if data.example_count < 2:
            raise InputError(f"{data.folder} has {data.example_count} examples, too few to learn from; collect more.")
        return {
            "command": command("train", options),
            "width": network.width,
            "flags": network.flags,
            "image": list(network.image),
            "situations": data.manifest["situations"],
            "sources": {"planner": network.planner_sources, "controller": network.controller_sources},
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
    check_config(options.folder, training.config())  # refuses before anything is written
    with writing.folder_lock(options.folder), progress(console) as tell:
        return _train(training, tell)


def prepare(options: ImitationConfig) -> Training:
    """The data and the network of a training.

    Raises:
        InputError: there is no such dataset, or the pretrained network is missing or another one.
    """
    data = open_datasets([options.dataset, *options.datasets], options.part)
    network = Network(options.width, options.flags, data.image_shape)
    if options.pretrained is not None:
        had, _ = read_network(options.pretrained, data.manifest["situations"])
        if had != network:
            text = f"{options.pretrained} has another network, {had}, not {network}"
            raise InputError(f"pretrained: {text}; ask for the same.")
    return Training(options, data, network, *split_each(data, options.validation, options.seed))


def command_scale(commands: Float[np.ndarray | Array, "R 2"]) -> Float[Array, "2"]:
    """The standard deviation (2,) of commands (R, 2) [m/s, rad/s], the unit of the network's commands."""
    return jnp.maximum(jnp.std(jnp.asarray(commands), 0), MIN_COMMAND_SCALE)


def init_state(
    network: Network, situations: int, options: ImitationConfig, seed: Array | int, scale: Float[Array, "2"]
) -> TrainState:
    """The state before the first epoch; its best loss is infinite. ``scale`` is of ``command_scale``."""
    weights = replace(init_weights(network, situations, random_streams.key("weights", seed)), scale=scale)
    return TrainState(
        weights=weights,
        optimizer=_optimizer(options).init(weights.parameters),
        epoch=jnp.zeros((), jnp.int32),
        best=jnp.full((), jnp.inf, jnp.float32),
        best_epoch=jnp.zeros((), jnp.int32),
    )


def programs(network: Network, options: ImitationConfig, mesh: Mesh, padded: bool = False) -> TrainPrograms:
    """The compiled functions of a training, which donate the memory of the state.

    Args:
        padded: whether the rows may fill whole batches with -1.
    """
    optimizer = _optimizer(options)
    sharding = NamedSharding(mesh, PartitionSpec(devices.AXIS))

    def sums(parameters: VariableDict, scale: Array, examples: Example, weight: Array) -> Array:
        each = jax.vmap(_error_sums, (None, None, None, 0, 0))(network, parameters, scale, examples, weight)
        return jnp.sum(each, 0)

    def loss(parameters: VariableDict, scale: Array, examples: Example, weight: Array) -> tuple[Array, Array]:
        total = sums(parameters, scale, examples, weight)
        return _losses(total).loss, total

    def update(state: TrainState, examples: Example, weight: Array) -> tuple[TrainState, Array]:
        weights = state.weights
        gradient, total = jax.grad(loss, has_aux=True)(weights.parameters, weights.scale, examples, weight)
        with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
            steps, optimizer_state = optimizer.update(gradient, state.optimizer, weights.parameters)
        parameters = optax.apply_updates(weights.parameters, steps)
        return replace(state, weights=replace(weights, parameters=parameters), optimizer=optimizer_state), total

    def measure(state: TrainState, examples: Example, weight: Array) -> Array:
        return sums(state.weights.parameters, state.weights.scale, examples, weight)

    def epoch(
        state: TrainState, recording: Recording, training: Array, validation: Array
    ) -> tuple[TrainState, Losses, Losses]:
        def gather(index: Array) -> tuple[Example, Array]:
            index = jax.lax.with_sharding_constraint(index, sharding)
            return example(recording, jnp.maximum(index, 0)), (index >= 0).astype(jnp.float32)

        def step(state: TrainState, index: Array) -> tuple[TrainState, Array]:
            after, sums = update(state, *gather(index))
            if not padded:
                return after, sums
            some = (index >= 0).any()  # of a batch of none, the optimizer would still move
            return jax.tree.map(lambda old, new: jnp.where(some, new, old), state, after), sums

        state, trained = jax.lax.scan(step, state, in_batches(training, options.batch, mesh.size))
        batches = in_batches(validation, options.batch, mesh.size)
        _, validated = jax.lax.scan(lambda _, index: (_, measure(state, *gather(index))), 0, batches)
        return finish(state, trained.sum(0), validated.sum(0))

    def finish(state: TrainState, training: Array, validation: Array) -> tuple[TrainState, Losses, Losses]:
        training_losses, validation_losses = _losses(training), _losses(validation)
        number = state.epoch + 1
        better = validation_losses.loss < state.best
        state = replace(
            state,
            epoch=number,
            best=jnp.where(better, validation_losses.loss, state.best),
            best_epoch=jnp.where(better, number, state.best_epoch),
        )
        return state, training_losses, validation_losses

    return TrainPrograms(
        jax.jit(epoch, donate_argnums=0), jax.jit(update, donate_argnums=0), jax.jit(measure), jax.jit(finish)
    )


def shuffled(rows: Int[Array, "R"], probabilities: Float[Array, "R"] | None, seed: int, epoch: Array) -> Array:
    """Rows (R,) in the order of an epoch, or drawn with these probabilities."""
    key = jax.random.fold_in(random_streams.key("order", seed), epoch)
    if probabilities is None:
        return jax.random.permutation(key, rows)
    return jax.random.choice(key, rows, rows.shape, p=probabilities)


def in_batches(rows: Int[Array, "R"], size: int, devices: int) -> Int[Array, "batches B"]:
    """Rows (R,) int32 in batches of equal size; -1 fills the last one.

    B is the smaller of ``size`` and R, rounded up to a multiple of the devices.
    """
    number = rows.shape[0]
    size = -(-max(1, min(size, number)) // devices) * devices
    spare = -number % size
    return jnp.concatenate([rows, jnp.full((spare,), -1, jnp.int32)]).reshape(-1, size)


def _error_sums(network: Network, parameters: VariableDict, scale: Array, one: Example, weight: Array) -> Array:
    """(4,) of one example: summed squared distances, number of valid places, squared error of the command, and 1."""
    decision = cast(Decision, network.apply(parameters, one.images, one.plan, one.situations))
    gap = decision.local_plan - one.future
    squared = gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1]
    valid = one.future_valid.astype(jnp.float32)
    off = decision.command - one.command / scale
    parts = jnp.stack([jnp.sum(valid * squared), jnp.sum(valid), jnp.sum(off * off), jnp.ones((), jnp.float32)])
    return weight * parts


def _losses(sums: Array) -> Losses:
    local_plan = sums[0] / jnp.maximum(sums[1], 1.0)
    command = sums[2] / jnp.maximum(sums[3], 1.0)
    return Losses(local_plan + command, local_plan, command)


def _optimizer(options: ImitationConfig) -> optax.GradientTransformation:
    return optax.adamw(options.learning_rate, weight_decay=options.weight_decay)


def _train(training: Training, tell: Progress) -> TrainState:
    """Train in a folder that this process has locked."""
    options, mesh = training.options, devices.mesh()
    init = jax.jit(init_state, static_argnums=(0, 1, 2, 3))
    scale = command_scale(training.read("command"))
    state = init(training.network, training.situations, options, options.seed, scale)
    if options.pretrained is not None:
        state = replace(state, weights=Checkpoints(options.pretrained).best("weights", state.weights))
    epoch = _epoch(training, mesh)

    def advance(state: TrainState) -> tuple[TrainState, Report]:
        start = time.time()
        state, *losses = epoch(state)
        number, best_number, loss = int(state.epoch), int(state.best_epoch), float(losses[1].loss)
        if not all(math.isfinite(float(each.loss)) for each in losses):
            where = f"the loss is not finite in epoch {number}; {options.folder} keeps the checkpoints until then"
            raise FloatingPointError(f"{where}; try a lower --learning-rate in another folder.")
        due = best_number == number or number % CHECKPOINT_INTERVAL == 0 or is_over(state)
        best = f"best {float(state.best):.4f} after {best_number}"
        note = f"epoch {number} · loss {loss:.4f}, {best}, {time.time() - start:.2f} s an epoch"
        return state, Report(number, _line(number, *losses), loss, due, note)

    def is_over(state: TrainState) -> bool:
        epoch = int(state.epoch)
        return epoch >= options.epochs or epoch - int(state.best_epoch) >= options.patience

    place = functools.partial(devices.replicate, mesh)
    loop = Loop(advance=advance, is_over=is_over, done=lambda state: int(state.epoch), place=place)
    return fit(options.folder, training.config(), state, loop, options.epochs, tell)


def _line(epoch: int, training: Losses, validation: Losses) -> dict[str, Any]:
    """A line of metrics.jsonl."""
    losses = (("train", training), ("validation", validation))
    return {"epoch": epoch} | {part: {k: float(v) for k, v in each._asdict().items()} for part, each in losses}


def _epoch(training: Training, mesh: Mesh) -> Callable[[TrainState], tuple[TrainState, Losses, Losses]]:
    """state -> (state, Losses, Losses), with the dataset on the devices if it fits there, else from disk."""
    options, data = training.options, training.data
    compiled = programs(training.network, options, mesh)
    if data.example_count * data.row_bytes <= options.device_memory_fraction * _memory():
        recording = devices.replicate(mesh, training.recording())
        rows, number, probabilities = jnp.arange(data.example_count, dtype=jnp.int32), training.length, None
        if options.balance:
            probabilities = jnp.asarray(balanced_probabilities(training.read("situations")))

        def on_devices(state: TrainState) -> tuple[TrainState, Losses, Losses]:
            order = jax.jit(shuffled, static_argnums=2)(rows[:number], probabilities, options.seed, state.epoch)
            return compiled.epoch(state, recording, order, rows[number:])

        return on_devices
    if options.balance:
        raise InputError(
            "--balance needs the dataset to fit on the device; collect less, or raise --device-memory-fraction."
        )
    size = -(-options.batch // mesh.size) * mesh.size
    loader = Loader(data, training.training, size, options.seed)
    validation_loader = Loader(data, training.validation, size, options.seed, shuffle=False)

    def from_disk(state: TrainState) -> tuple[TrainState, Losses, Losses]:
        training_sums, validation_sums = jnp.zeros(4, jnp.float32), jnp.zeros(4, jnp.float32)
        for _, examples, weight in loader.epoch(Token(int(state.epoch))):
            state, sums = compiled.update(state, examples, weight)
            training_sums = training_sums + sums
        for _, examples, weight in validation_loader.epoch():
            validation_sums = validation_sums + compiled.measure(state, examples, weight)
        return compiled.finish(state, training_sums, validation_sums)

    return from_disk


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
    size, states = min(MAX_NETWORKS, _networks_at_once(trainings)), []
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
    if any(each.network != first.network for each in trainings):
        raise InputError("dataset: the datasets have images of different sizes; collect all with the same --width.")


def _networks_at_once(trainings: list[Training]) -> int:
    """How many of the datasets fit on a device."""
    largest = max(each.data.example_count * each.data.row_bytes for each in trainings)
    number = int(trainings[0].options.device_memory_fraction * _memory() // max(largest, 1))
    if number < 1:
        raise InputError("dataset: it does not fit on the device; train each network alone.")
    return number


def _train_ensemble(trainings: list[Training], first: int, tell: Progress) -> list[TrainState]:
    """Networks whose folders are locked; ``first`` others were trained before."""
    one, options = trainings[0], trainings[0].options
    configs = [each.config() for each in trainings]
    for each, config in zip(trainings, configs, strict=True):
        check_config(each.options.folder, config)
    seeds = jnp.asarray([each.options.seed for each in trainings], jnp.uint32)
    scales = jnp.stack([command_scale(each.read("command")) for each in trainings])
    init = functools.partial(init_state, one.network, one.situations, options)
    states = jax.jit(lambda *each: jax.lax.map(lambda own: init(*own), each))(seeds, scales)
    best = jax.tree.map(jnp.copy, states)
    data, epoch = _stack_data(trainings), _ensemble_epoch(one.network, options)
    over, epochs = np.zeros(len(trainings), bool), []
    while not over.all():
        start = time.time()
        states, best, losses = epoch(states, best, jnp.asarray(over), seeds, *data)
        trained, validated = (jax.tree.map(np.asarray, each) for each in losses)
        if not np.isfinite([trained.loss[~over], validated.loss[~over]]).all():
            raise FloatingPointError(
                "a loss is not finite; nothing of these networks is written; lower the learning rate."
            )
        epochs.append((trained, validated, ~over, start))
        number, last = np.asarray(states.epoch), np.asarray(states.best_epoch)
        over |= (number >= options.epochs) | (number - last >= options.patience)
        share = max(float(over.mean()), number.max() / options.epochs)
        stopped = f"{int(over.sum())} of {len(over)} stopped, loss {float(validated.loss.mean()):.4f} on average"
        tell.update(first + share * len(over), f"epoch {number.max()} · {stopped}")
    result = []
    for index, (each, config) in enumerate(zip(trainings, configs, strict=True)):
        last, top = (jax.tree.map(lambda leaf: leaf[index], tree) for tree in (states, best))  # noqa: B023
        _write_folder(each.options.folder, config, last, top, [epoch for epoch in epochs if epoch[2][index]], index)
        result.append(last)
    return result


def _stack_data(trainings: list[Training]) -> tuple[Recording, Array, Array, Array]:
    """Recordings (A, R, ...) filled up to the longest; rows (A, R) that train and (A, V) that validate, -1 for none;
    and the probabilities (A, R) of the former.
    """
    recordings = [each.recording() for each in trainings]
    most = max(len(one.first) for one in recordings)

    def longer(leaf: Array) -> Array:
        return jnp.concatenate([leaf, jnp.zeros((most - len(leaf), *leaf.shape[1:]), leaf.dtype)])

    index, widest = np.arange(most), max(each.data.example_count - each.length for each in trainings)
    training, validation, odds = [], [], []
    for each in trainings:
        training.append(np.where(index < each.length, index, -1))
        rows = each.length + np.arange(widest)
        validation.append(np.where(rows < each.data.example_count, rows, -1))
        chances = np.ones(each.length) / each.length
        if each.options.balance:
            chances = balanced_probabilities(each.read("situations"))
        odds.append(np.concatenate([chances, np.zeros(most - each.length)]))
    stacked = jax.tree.map(lambda *leaves: jnp.stack([longer(leaf) for leaf in leaves]), *recordings)
    training, validation = (jnp.asarray(np.stack(rows), jnp.int32) for rows in (training, validation))
    return stacked, training, validation, jnp.asarray(np.stack(odds), jnp.float32)


def _ensemble_epoch(network: Network, options: ImitationConfig) -> Callable:
    """(states, best, over, seeds, recordings, training rows, validation rows, chances) -> (states, best, losses)."""
    compiled = programs(network, options, devices.mesh(jax.devices()[:1]), padded=True)

    def one(
        state: TrainState, best: TrainState, over: Array, seed: Array, recording: Recording, rows: Array,
        validation: Array, odds: Array,
    ) -> tuple[TrainState, TrainState, list[Losses]]:  # fmt: skip
        key = jax.random.fold_in(random_streams.key("order", seed), state.epoch)
        if options.balance:
            order = jnp.where(rows >= 0, jax.random.choice(key, rows, rows.shape, p=odds), -1)
        else:  # in another order, with none at the end
            order = rows[jnp.argsort(jnp.where(rows >= 0, jax.random.uniform(key, rows.shape), 2.0))]
        after, *losses = compiled.epoch(state, recording, order, validation)
        better = after.best_epoch == after.epoch
        best = jax.tree.map(lambda old, new: jnp.where(better & ~over, new, old), best, after)
        after = jax.tree.map(lambda old, new: jnp.where(over, old, new), state, after)
        return after, best, losses

    return jax.jit(jax.vmap(one), donate_argnums=(0, 1))


def _write_folder(folder: Path, config: dict, state: TrainState, best: TrainState, epochs: list, index: int) -> None:
    """The folder of a training that has ended."""
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)  # of a killed training with other options
    write_config(folder, config)
    checkpoints = Checkpoints(folder, writes=True)
    for one in (best, state) if int(best.epoch) < int(state.epoch) else (state,):
        loss = epochs[int(one.epoch) - 1][1].loss[index]
        checkpoints.save(one, int(one.epoch), float(loss))
        checkpoints.wait()
    log = Log(folder, 0)
    for number, (*losses, _, start) in enumerate(epochs, 1):
        own = (jax.tree.map(lambda value: value[index], each) for each in losses)
        log.add(_line(number, *own) | {"time": start})

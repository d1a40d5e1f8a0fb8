"""``sean train imitation``: learn to drive from demonstrations, with checkpoints (section V-C).

The losses of the local planner and of the velocity controller have equal weight. AdamW minimizes their sum, epoch by
epoch, until the validation loss stops falling. An epoch is one compiled call: a scan over shuffled batches, then a scan
over the validation batches, with the dataset on the device. The shuffle depends on (seed, epoch) alone, so the same
command continues from the latest checkpoint after an interruption and ends with the same weights.
"""

import contextlib
import math
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
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
from rich.console import Console

from sean_jax import devices, prng, writing
from sean_jax.base import Array
from sean_jax.config import ImitationConfig
from sean_jax.errors import InputError
from sean_jax.flags import command
from sean_jax.learning.dataset import ConcatDataset, Episode, on_device, open_datasets, split_each
from sean_jax.learning.examples import Example, Loader, Recording, Token, balanced_probabilities, example
from sean_jax.learning.networks import Decision, Network, Weights, init_weights, read_network
from sean_jax.learning.trainer import Checkpoints, Log, Loop, Report, check_config, fit, write_config
from sean_jax.progress import progress
from sean_jax.versions import versions

MIN_COMMAND_SCALE = 0.05  # m/s, rad/s: the scale of a command that hardly varies
CHECKPOINT_INTERVAL = 10  # epochs between two checkpoints while the loss does not improve
DEFAULT_MEMORY = 4e9  # bytes, for a device that does not report its memory


@struct.dataclass
class TrainState:
    """Everything that the rest of a training depends on. The field names are those of the checkpoints on disk."""

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

    # (state, recording, training rows (R,), validation rows (R,), probabilities of the former (R,) or None)
    epoch: Callable  # -> (state, training Losses, validation Losses)
    update: Callable  # (state, examples (B, ...), weight (B,)) -> (state, sums): one step of the optimizer
    measure: Callable  # (state, examples (B, ...), weight (B,)) -> sums
    finish: Callable  # (state, training sums, validation sums) -> (state, Losses, Losses): the end of an epoch


def train(options: ImitationConfig, console: Console | Callable[[float], None] | None = None) -> TrainState:
    """Train a network, or resume its training; the state then. ``learning.load`` reads the best weights.

    Args:
        console: shows the progress; a function receives the share that is done.

    Raises:
        InputError: the options are impossible, or the folder holds something else.
        WriteError: another process trains in the folder.
        IncompleteError: a file is damaged or cannot be written. The checkpoints stay.
        FloatingPointError: the loss is not finite. The checkpoints stay.
    """
    data, network = prepare(options)
    training, validation = split_each(data, options.validation, options.seed)
    config = _config(options, data, network)
    check_config(options.folder, config)  # refuses before anything is written
    with writing.folder_lock(options.folder):
        return _train(options, console, data, training, validation, network, config)


def prepare(options: ImitationConfig) -> tuple[ConcatDataset, Network]:
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
    return data, network


def init_state(
    network: Network, situations: int, options: ImitationConfig, commands: Float[np.ndarray | Array, "R 2"]
) -> TrainState:
    """The state before the first epoch, from the commands (R, 2) [m/s, rad/s] of the training examples."""
    weights = init_weights(network, situations, prng.key("weights", options.seed))
    return state_of_weights(replace(weights, scale=command_scale(commands)), options)


def command_scale(commands: Float[np.ndarray | Array, "R 2"]) -> Float[Array, "2"]:
    """The standard deviation (2,) of commands (R, 2) [m/s, rad/s]: what a command of 1 from the network means."""
    return jnp.maximum(jnp.std(jnp.asarray(commands), 0), MIN_COMMAND_SCALE)


def state_of_weights(weights: Weights, options: ImitationConfig) -> TrainState:
    """The state before the first epoch, from weights; its best loss is infinite."""
    return TrainState(
        weights=weights,
        optimizer=_optimizer(options).init(weights.parameters),
        epoch=jnp.zeros((), jnp.int32),
        best=jnp.full((), jnp.inf, jnp.float32),
        best_epoch=jnp.zeros((), jnp.int32),
    )


def programs(network: Network, options: ImitationConfig, mesh: Mesh) -> TrainPrograms:
    """The compiled functions of a training, which donate the memory of the state."""
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

    def gather(recording: Recording, index: Array) -> tuple[Example, Array]:
        index = jax.lax.with_sharding_constraint(index, sharding)
        examples = example(recording, jnp.maximum(index, 0))
        return examples, (index >= 0).astype(jnp.float32)

    def epoch(
        state: TrainState,
        recording: Recording,
        training: Array,
        validation: Array,
        probabilities: Array | None = None,
    ) -> tuple[TrainState, Losses, Losses]:
        key = jax.random.fold_in(prng.key("order", options.seed), state.epoch)
        if probabilities is None:
            order = jax.random.permutation(key, training)
        else:
            order = jax.random.choice(key, training, training.shape, p=probabilities)
        batches = in_batches(order, options.batch, mesh.size)
        state, trained = jax.lax.scan(lambda state, index: update(state, *gather(recording, index)), state, batches)
        batches = in_batches(validation, options.batch, mesh.size)
        _, validated = jax.lax.scan(lambda _, index: (_, measure(state, *gather(recording, index))), 0, batches)
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


def _train(
    options: ImitationConfig,
    console: Console | Callable[[float], None] | None,
    data: ConcatDataset,
    training: list[Episode],
    validation: list[Episode],
    network: Network,
    config: dict[str, Any],
) -> TrainState:
    """Train in a folder that this process has locked."""
    mesh = devices.mesh()
    commands = jnp.asarray(data.read(training, ("command",))["command"])
    state = jax.jit(init_state, static_argnums=(0, 1, 2))(network, len(data.manifest["situations"]), options, commands)
    if options.pretrained is not None:
        state = replace(state, weights=Checkpoints(options.pretrained).best("weights", state.weights))
    epoch = _epoch(data, training, validation, network, options, mesh)

    def advance(state: TrainState) -> tuple[TrainState, Report]:
        start = time.time()
        state, training_losses, validation_losses = epoch(state)
        _check_finite(state, training_losses, validation_losses, options.folder)
        number, best_number, loss = int(state.epoch), int(state.best_epoch), float(validation_losses.loss)
        line = {"epoch": number, "train": _as_dict(training_losses), "validation": _as_dict(validation_losses)}
        due = best_number == number or number % CHECKPOINT_INTERVAL == 0 or _is_over(state, options)
        best = f"best {float(state.best):.4f} after {best_number}"
        note = f"epoch {number} · loss {loss:.4f}, {best}, {time.time() - start:.2f} s an epoch"
        return state, Report(number, line, loss if due else None, note)

    loop = Loop(
        advance=advance,
        is_over=lambda state: _is_over(state, options),
        done=lambda state: int(state.epoch),
        place=lambda state: devices.replicate(mesh, state),
    )
    with progress(console) as tell:
        return fit(options.folder, config, state, loop, options.epochs, tell)


def _epoch(
    data: ConcatDataset,
    training: list[Episode],
    validation: list[Episode],
    network: Network,
    options: ImitationConfig,
    mesh: Mesh,
) -> Callable[[TrainState], tuple[TrainState, Losses, Losses]]:
    """state -> (state, Losses, Losses), with the dataset on the devices if it fits there, else from disk."""
    compiled = programs(network, options, mesh)
    if data.example_count * data.row_bytes <= options.device_memory_fraction * _memory():
        recording = devices.replicate(mesh, on_device(data.recording([*training, *validation])))
        number = sum(episode.length for episode in training)
        rows = jnp.arange(data.example_count, dtype=jnp.int32)
        probabilities = None
        if options.balance:
            probabilities = jnp.asarray(balanced_probabilities(data.read(training, ("situations",))["situations"]))
        return lambda state: compiled.epoch(state, recording, rows[:number], rows[number:], probabilities)
    if options.balance:
        raise InputError(
            "--balance needs the dataset to fit on the device; collect less, or raise --device-memory-fraction."
        )
    size = -(-options.batch // mesh.size) * mesh.size
    loader = Loader(data, training, size, options.seed)
    validation_loader = Loader(data, validation, size, options.seed, shuffle=False)

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


def _is_over(state: TrainState, options: ImitationConfig) -> bool:
    done = int(state.epoch)
    return done >= options.epochs or done - int(state.best_epoch) >= options.patience


def _check_finite(state: TrainState, training: Losses, validation: Losses, folder: Path) -> None:
    if not (math.isfinite(float(training.loss)) and math.isfinite(float(validation.loss))):
        where = f"the loss is not finite in epoch {int(state.epoch)}; {folder} keeps the checkpoints until then"
        raise FloatingPointError(f"{where}; try a lower --learning-rate in another folder.")


def _as_dict(losses: Losses) -> dict[str, float]:
    return {name: float(value) for name, value in losses._asdict().items()}


def _config(options: ImitationConfig, data: ConcatDataset, network: Network) -> dict[str, Any]:
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


# ------------------------------------------------------------------ several networks

OWN_OPTIONS = "dataset", "datasets", "part", "seed", "out", "quiet"  # in which the networks may differ
MAX_NETWORKS = 32  # in one program; fewer if their datasets fill the memory


def train_ensemble(
    several: Sequence[ImitationConfig], console: Console | Callable[[float], None] | None = None
) -> list[TrainState]:
    """Train networks of one kind side by side; the state of each after its last epoch.

    One program makes an epoch of all of them, so a GPU that one small network leaves idle is filled. Each stops by its
    own validation loss. A folder is that of ``train`` afterwards; what is killed midway begins anew.

    Args:
        several: they may differ in dataset, seed and folder.
        console: shows the progress; a function receives the share that is done.

    Raises:
        InputError: other options differ, a dataset is too large, or a folder holds something else.
        WriteError: another process trains in a folder.
        IncompleteError: a file is damaged or cannot be written.
        FloatingPointError: a loss is not finite; nothing of the networks that were trained together is written.
    """
    several = list(several)
    data = [open_datasets([options.dataset, *options.datasets], options.part) for options in several]
    networks = [Network(o.width, o.flags, each.image_shape) for o, each in zip(several, data, strict=True)]
    _check_alike(several, data, networks)
    size = min(MAX_NETWORKS, _networks_at_once(several[0], data))
    states: list[TrainState] = []
    with progress(console) as tell, contextlib.ExitStack() as stack:
        for options in several:
            stack.enter_context(writing.folder_lock(options.folder))
        tell.start("training", len(several))
        for first in range(0, len(several), size):
            part = slice(first, first + size)

            def show(epoch: int, over: np.ndarray, loss: float, first: int = first) -> None:
                share = max(float(over.mean()), epoch / several[0].epochs)
                note = f"epoch {epoch} · {int(over.sum())} of {len(over)} stopped, loss {loss:.4f} on average"
                tell.update(first + share * len(over), note)

            states += _train_ensemble(several[part], data[part], networks[0], show)
    return states


def _check_alike(several: list[ImitationConfig], data: list[ConcatDataset], networks: list[Network]) -> None:
    alike = [
        {name: value for name, value in options.identity().items() if name not in OWN_OPTIONS} for options in several
    ]
    for one in alike[1:]:
        for name in one:
            if one[name] != alike[0][name]:
                raise InputError(f"{name}: {one[name]} beside {alike[0][name]}; networks side by side have the same.")
    if several[0].pretrained is not None:
        raise InputError("pretrained: networks side by side begin from nothing; train this one by itself.")
    if any(each.rate != data[0].rate for each in data):
        raise InputError("dataset: the datasets have different rates; collect all with the same --rate.")
    if any(network != networks[0] for network in networks):
        raise InputError("dataset: the datasets have images of different sizes; collect all with the same --width.")


def _networks_at_once(options: ImitationConfig, data: list[ConcatDataset]) -> int:
    """How many of the datasets fit on a device."""
    largest = max(each.example_count * each.row_bytes for each in data)
    number = int(options.device_memory_fraction * _memory() // max(largest, 1))
    if number < 1:
        raise InputError("dataset: it does not fit on the device; train each network by itself.")
    return number


def _train_ensemble(
    several: list[ImitationConfig],
    data: list[ConcatDataset],
    network: Network,
    show: Callable[[int, np.ndarray, float], None],
) -> list[TrainState]:
    """Networks whose folders are locked."""
    options = several[0]
    configs = [_config(own, each, network) for own, each in zip(several, data, strict=True)]
    for own, config in zip(several, configs, strict=True):
        check_config(own.folder, config)
    splits = [split_each(each, own.validation, own.seed) for own, each in zip(several, data, strict=True)]
    commands = [each.read(split[0], ("command",))["command"] for each, split in zip(data, splits, strict=True)]
    scales = jnp.stack([command_scale(each) for each in commands])
    seeds = jnp.asarray([own.seed for own in several], jnp.uint32)
    states, best = jax.jit(_init_states, static_argnums=(0, 1, 2))(
        network, len(data[0].manifest["situations"]), options, seeds, scales
    )
    recordings, rows, validation, odds = _stack_data(data, splits, options.balance)
    epoch = _ensemble_epoch(network, options)
    over, epochs = np.zeros(len(several), bool), []
    while not over.all():
        start = time.time()
        states, best, losses = epoch(states, best, jnp.asarray(over), recordings, rows, validation, odds, seeds)
        trained, validated = (jax.tree.map(np.asarray, each) for each in losses)
        if not np.isfinite([trained.loss[~over], validated.loss[~over]]).all():
            raise FloatingPointError(
                "a loss is not finite; nothing of these networks is written; lower the learning rate."
            )
        epochs.append((trained, validated, ~over, start))
        number, last = np.asarray(states.epoch), np.asarray(states.best_epoch)
        over |= (number >= options.epochs) | (number - last >= options.patience)
        show(int(number.max()), over, float(validated.loss.mean()))
    result = []
    for index, (own, config) in enumerate(zip(several, configs, strict=True)):
        one, top = (jax.tree.map(lambda leaf: leaf[index], tree) for tree in (states, best))  # noqa: B023
        _write_folder(own.folder, config, one, top, [epoch for epoch in epochs if epoch[2][index]], index)
        result.append(one)
    return result


def _init_states(
    network: Network, situations: int, options: ImitationConfig, seeds: Array, scales: Array
) -> tuple[TrainState, TrainState]:
    """The states before the first epoch, twice: now, and the best so far."""

    def one(carry: tuple[Array, Array]) -> TrainState:
        seed, scale = carry
        weights = init_weights(network, situations, prng.key("weights", seed))
        return state_of_weights(replace(weights, scale=scale), options)

    states = jax.lax.map(one, (seeds, scales))
    return states, jax.tree.map(jnp.copy, states)


def _stack_data(data: list[ConcatDataset], splits: list, balance: bool) -> tuple[Recording, Array, Array, Array]:
    """Recordings (A, R, ...) filled up to the longest; rows (A, R) that train and (A, V) that validate, -1 for none;
    and the probabilities (A, R) of the former.
    """
    each = [
        on_device(one.recording([*training, *validation]))
        for one, (training, validation) in zip(data, splits, strict=True)
    ]
    most = max(len(one.first) for one in each)

    def longer(leaf: Array) -> Array:
        return jnp.concatenate([leaf, jnp.zeros((most - len(leaf), *leaf.shape[1:]), leaf.dtype)])

    recordings = jax.tree.map(lambda *leaves: jnp.stack([longer(leaf) for leaf in leaves]), *each)
    index, training, validation, odds = np.arange(most), [], [], []
    for one, (learned, _) in zip(data, splits, strict=True):
        number, count = sum(episode.length for episode in learned), one.example_count
        training.append(np.where(index < number, index, -1))
        validation.append(np.where((index >= number) & (index < count), index, -1))
        chances = np.ones(number) / number
        if balance:
            chances = balanced_probabilities(one.read(learned, ("situations",))["situations"])
        odds.append(np.concatenate([chances, np.zeros(most - number)]))
    validation = [np.concatenate([row[row >= 0], row[row < 0]]) for row in validation]
    width = max(int((row >= 0).sum()) for row in validation)
    rows, validation = (
        jnp.asarray(np.stack(training), jnp.int32),
        jnp.asarray(np.stack(validation)[:, :width], jnp.int32),
    )
    return recordings, rows, validation, jnp.asarray(np.stack(odds), jnp.float32)


def _ensemble_epoch(network: Network, options: ImitationConfig) -> Callable:
    """(states, best, over, recordings, training rows, validation rows, chances, seeds) -> (states, best, losses)."""
    compiled = programs(network, options, devices.mesh())

    def one(
        state: TrainState, best: TrainState, over: Array, recording: Recording, rows: Array, validation: Array,
        odds: Array, seed: Array,
    ) -> tuple[TrainState, TrainState, tuple]:  # fmt: skip
        key = jax.random.fold_in(prng.key("order", seed), state.epoch)
        if options.balance:
            order = jnp.where(rows >= 0, jax.random.choice(key, rows, rows.shape, p=odds), -1)
        else:  # in another order, with none at the end
            order = rows[jnp.argsort(jnp.where(rows >= 0, jax.random.uniform(key, rows.shape), 2.0))]

        def gather(index: Array) -> tuple:
            return example(recording, jnp.maximum(index, 0)), (index >= 0).astype(jnp.float32)

        def step(state: TrainState, index: Array) -> tuple[TrainState, Array]:
            after, sums = compiled.update(state, *gather(index))
            some = (index >= 0).any()  # of a batch of none, the optimizer would still move
            return jax.tree.map(lambda old, new: jnp.where(some, new, old), state, after), sums

        after, trained = jax.lax.scan(step, state, in_batches(order, options.batch, 1))
        batches = in_batches(validation, options.batch, 1)
        _, validated = jax.lax.scan(lambda _, index: (_, compiled.measure(after, *gather(index))), 0, batches)
        after, *losses = compiled.finish(after, trained.sum(0), validated.sum(0))
        better = after.best_epoch == after.epoch
        best = jax.tree.map(lambda old, new: jnp.where(better & ~over, new, old), best, after)
        after = jax.tree.map(lambda old, new: jnp.where(over, old, new), state, after)
        return after, best, tuple(losses)

    return jax.jit(jax.vmap(one), donate_argnums=(0, 1))


def _write_folder(folder: Path, config: dict, state: TrainState, best: TrainState, epochs: list, index: int) -> None:
    """The folder of a training that has ended."""
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)  # of one that was trained otherwise and killed
    write_config(folder, config)
    checkpoints = Checkpoints(folder, writes=True)
    for one in (best, state) if int(best.epoch) < int(state.epoch) else (state,):
        loss = epochs[int(one.epoch) - 1][1].loss[index]
        checkpoints.save(one, int(one.epoch), float(loss))
        checkpoints.wait()
    log = Log(folder, 0)
    for number, (*losses, _, start) in enumerate(epochs, 1):
        train, validation = (_as_dict(jax.tree.map(lambda value: value[index], each)) for each in losses)
        log.add({"epoch": number, "train": train, "validation": validation, "time": start})

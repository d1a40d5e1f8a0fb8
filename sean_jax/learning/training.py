"""``sean train imitation``: learn to drive from demonstrations, with checkpoints (section V-C).

The losses of the local planner and of the velocity controller have equal weight. AdamW minimizes their sum, epoch by
epoch, until the validation loss stops falling. An epoch is one compiled call: a scan over shuffled batches, then a scan
over the validation batches, with the dataset on the device. The shuffle depends on (seed, epoch) alone, so the same
command continues from the latest checkpoint after an interruption and ends with the same weights.
"""

import math
import time
from collections.abc import Callable
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
from sean_jax.learning.checkpoints import Checkpoints, check_config, write_config
from sean_jax.learning.dataset import on_device
from sean_jax.learning.examples import Example, Recording, example
from sean_jax.learning.loader import Loader, Token, balanced_probabilities
from sean_jax.learning.logs import Log
from sean_jax.learning.network import Decision, Network, Weights, init_weights, read_network
from sean_jax.learning.several import Member, Several, open_datasets, split_each
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
    """Train a network, or continue its training, in the folder of the options.

    Args:
        console: shows the progress; a function receives the fraction done instead, and None shows nothing.

    Returns:
        The state after the last epoch. ``learned.load`` reads the best weights from the folder.

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


def prepare(options: ImitationConfig) -> tuple[Several, Network]:
    """What is learned from, and what learns.

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
    """The state before the first epoch.

    Args:
        commands: (R, 2) m/s, rad/s, the commands of the training examples. Their standard deviation is the scale of
            the network's command.

    Returns:
        The initial state; its best loss is infinite.
    """
    weights = init_weights(network, situations, prng.key("weights", options.seed))
    return begin(replace(weights, scale=command_scale(commands)), options)


def command_scale(commands: Float[np.ndarray | Array, "R 2"]) -> Float[Array, "2"]:
    """What a command of 1 from the network means.

    Args:
        commands: (R, 2) m/s, rad/s, of the training examples.

    Returns:
        (2,) m/s, rad/s, their standard deviation.
    """
    return jnp.maximum(jnp.std(jnp.asarray(commands), 0), MIN_COMMAND_SCALE)


def begin(weights: Weights, options: ImitationConfig) -> TrainState:
    """The state before the first epoch, from weights.

    Returns:
        The initial state; its best loss is infinite.
    """
    return TrainState(
        weights=weights,
        optimizer=_optimizer(options).init(weights.parameters),
        epoch=jnp.zeros((), jnp.int32),
        best=jnp.full((), jnp.inf, jnp.float32),
        best_epoch=jnp.zeros((), jnp.int32),
    )


def programs(network: Network, options: ImitationConfig, mesh: Mesh) -> TrainPrograms:
    """The compiled functions of a training.

    Returns:
        Functions that reuse (donate) the memory of the state that they receive.
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
    """Cut rows into batches of equal size.

    Args:
        rows: (R,) int32.
        size: of a batch. B is the smaller of it and R, rounded up to a multiple of the devices.
        devices: number of devices that share a batch.

    Returns:
        (batches, B) int32; -1 fills the last batch.
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
    data: Several,
    training: list[Member],
    validation: list[Member],
    network: Network,
    config: dict[str, Any],
) -> TrainState:
    """Train in a folder that this process has locked."""
    resumes, mesh = check_config(options.folder, config), devices.mesh()
    commands = jnp.asarray(data.read(training, ("command",))["command"])
    state = jax.jit(init_state, static_argnums=(0, 1, 2))(network, len(data.manifest["situations"]), options, commands)
    if options.pretrained is not None:
        state = replace(state, weights=Checkpoints(options.pretrained).best("weights", state.weights))
    epoch = _epoch(data, training, validation, network, options, mesh)
    if not resumes:
        write_config(options.folder, config)
    checkpoints = Checkpoints(options.folder, writes=True)
    state = (checkpoints.latest(state) if resumes else None) or state
    state = devices.replicate(mesh, state)
    log = Log(options.folder, int(state.epoch))
    with progress(console) as tell:
        tell.start("training", options.epochs)
        try:
            while not _is_over(state, options):
                start = time.time()
                state, training_losses, validation_losses = epoch(state)
                _check_finite(state, training_losses, validation_losses, options.folder)
                number, better = int(state.epoch), int(state.best_epoch) == int(state.epoch)
                losses = {"train": _as_dict(training_losses), "validation": _as_dict(validation_losses)}
                log.add({"epoch": number, **losses, "time": time.time()})
                if better or number % CHECKPOINT_INTERVAL == 0 or _is_over(state, options):
                    checkpoints.save(state, number, float(validation_losses.loss))
                best = f"best {float(state.best):.4f} after {int(state.best_epoch)}"
                note = f"loss {float(validation_losses.loss):.4f}, {best}, {time.time() - start:.2f} s an epoch"
                tell.update(number, f"epoch {number} · {note}")
        finally:
            checkpoints.wait()
    return state


def _epoch(
    data: Several,
    training: list[Member],
    validation: list[Member],
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


def _config(options: ImitationConfig, data: Several, network: Network) -> dict[str, Any]:
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

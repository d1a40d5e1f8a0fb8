"""Several networks of one kind that are trained side by side, each on a dataset and with a seed of its own.

One program makes an epoch of all of them, so a GPU that one small network leaves idle is filled. Each stops by its own
validation loss, and none learns anything of another. A folder is that of ``sean train imitation`` afterwards; what is
killed midway begins anew.
"""

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from sean_jax import devices, prng, writing
from sean_jax.base import Array
from sean_jax.config import ImitationConfig
from sean_jax.errors import InputError
from sean_jax.learning import training
from sean_jax.learning.checkpoints import Checkpoints, check_config, write_config
from sean_jax.learning.dataset import on_device
from sean_jax.learning.examples import Recording, example
from sean_jax.learning.loader import balanced_probabilities
from sean_jax.learning.logs import Log
from sean_jax.learning.network import Network, init_weights
from sean_jax.learning.several import Several, open_datasets, split_each
from sean_jax.learning.training import TrainState
from sean_jax.progress import progress

OWN = "dataset", "datasets", "part", "seed", "out", "quiet"  # options in which the networks may differ
AT_ONCE = 32  # networks in one program, or fewer where their datasets fill the memory


def train(
    several: Sequence[ImitationConfig], console: Console | Callable[[float], None] | None = None
) -> list[TrainState]:
    """Train networks, each in the folder of its options.

    Args:
        several: what to train; they may differ in dataset, seed and folder.
        console: shows the progress; a function receives the fraction done instead, and None shows nothing.

    Returns:
        The state of each after its last epoch. ``learned.load`` reads the best weights from a folder.

    Raises:
        InputError: options differ in something else, a dataset is too large, or a folder holds something else.
        WriteError: another process trains in a folder.
        IncompleteError: a file is damaged or cannot be written.
        FloatingPointError: a loss is not finite; nothing of the networks that were trained together is written.
    """
    several = list(several)
    data = [open_datasets([options.dataset, *options.datasets], options.part) for options in several]
    networks = [Network(o.width, o.flags, each.image_shape) for o, each in zip(several, data, strict=True)]
    _check(several, data, networks)
    size = min(AT_ONCE, _fitting(several[0], data))
    states: list[TrainState] = []
    with progress(console) as tell, _locked(several):
        tell.start("training", len(several))
        for first in range(0, len(several), size):
            part = slice(first, first + size)
            show = _Show(tell, first, len(several[part]), several[0].epochs)
            states += _train(several[part], data[part], networks[0], show)
    return states


def _check(several: list[ImitationConfig], data: list[Several], networks: list[Network]) -> None:
    alike = [{name: value for name, value in options.identity().items() if name not in OWN} for options in several]
    for one in alike[1:]:
        for name in one:
            if one[name] != alike[0][name]:
                raise InputError(f"{name}: {one[name]} beside {alike[0][name]}; networks side by side have the same.")
    if several[0].pretrained is not None:
        raise InputError("pretrained: networks side by side begin from nothing; train this one by itself.")
    if any(each.rate != data[0].rate for each in data):
        raise InputError("dataset: other rates of examples beside one another; collect all with the same --rate.")
    if any(network != networks[0] for network in networks):
        raise InputError("dataset: images of other sizes beside one another; collect all with the same --width.")


def _fitting(options: ImitationConfig, data: list[Several]) -> int:
    """How many of the datasets fit on a device."""
    largest = max(each.example_count * each.row_bytes for each in data)
    number = int(options.device_memory_fraction * training._memory() // max(largest, 1))
    if number < 1:
        raise InputError("dataset: it does not fit on the device; train each network by itself.")
    return number


@contextlib.contextmanager
def _locked(several: list[ImitationConfig]) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        for options in several:
            stack.enter_context(writing.folder_lock(options.folder))
        yield


class _Show:
    """The progress of networks that are trained together."""

    def __init__(self, tell: Any, done: int, number: int, epochs: int):
        self.tell, self.done, self.number, self.epochs = tell, done, number, epochs

    def __call__(self, epoch: int, over: np.ndarray, loss: float) -> None:
        share = max(float(over.mean()), epoch / self.epochs)
        note = f"{int(over.sum())} of {self.number} stopped, loss {loss:.4f} on average"
        self.tell.update(self.done + share * self.number, f"epoch {epoch} · {note}")


def _train(
    several: list[ImitationConfig],
    data: list[Several],
    network: Network,
    show: Callable[[int, np.ndarray, float], None],
) -> list[TrainState]:
    """Networks whose folders are locked."""
    options = several[0]
    configs = [training._config(own, each, network) for own, each in zip(several, data, strict=True)]
    for own, config in zip(several, configs, strict=True):
        check_config(own.folder, config)
    splits = [split_each(each, own.validation, own.seed) for own, each in zip(several, data, strict=True)]
    commands = [each.read(split[0], ("command",))["command"] for each, split in zip(data, splits, strict=True)]
    scales = jnp.stack([training.command_scale(each) for each in commands])
    seeds = jnp.asarray([own.seed for own in several], jnp.uint32)
    states, best = jax.jit(_begin, static_argnums=(0, 1, 2))(
        network, len(data[0].manifest["situations"]), options, seeds, scales
    )
    recordings, rows, held, odds = _stacked(data, splits, options.balance)
    epoch = _epoch(network, options)
    over, lines = np.zeros(len(several), bool), []
    while not over.all():
        begun = time.time()
        states, best, told = epoch(states, best, jnp.asarray(over), recordings, rows, held, odds, seeds)
        losses, validated = (jax.tree.map(np.asarray, each) for each in told)
        if not np.isfinite([losses.loss[~over], validated.loss[~over]]).all():
            raise FloatingPointError(
                "a loss is not finite; nothing of these networks is written; lower the learning rate."
            )
        lines.append((losses, validated, ~over, begun))
        number, last = np.asarray(states.epoch), np.asarray(states.best_epoch)
        over |= (number >= options.epochs) | (number - last >= options.patience)
        show(int(number.max()), over, float(validated.loss.mean()))
    result = []
    for index, (own, config) in enumerate(zip(several, configs, strict=True)):
        one, top = (jax.tree.map(lambda leaf: leaf[index], tree) for tree in (states, best))  # noqa: B023
        _write(own.folder, config, one, top, [line for line in lines if line[2][index]], index)
        result.append(one)
    return result


def _begin(
    network: Network, situations: int, options: ImitationConfig, seeds: Array, scales: Array
) -> tuple[TrainState, TrainState]:
    """The states before the first epoch, twice: now, and the best so far."""

    def one(carry: tuple[Array, Array]) -> TrainState:
        seed, scale = carry
        weights = init_weights(network, situations, prng.key("weights", seed))
        return training.begin(replace(weights, scale=scale), options)

    states = jax.lax.map(one, (seeds, scales))
    return states, jax.tree.map(jnp.copy, states)


def _stacked(data: list[Several], splits: list, balance: bool) -> tuple[Recording, Array, Array, Array]:
    """(A, R, ...) rows of all datasets, filled up to the longest, and of each the rows that train and that validate, -1
    for none; and the chances of the former."""
    each = [on_device(one.recording([*training, *held])) for one, (training, held) in zip(data, splits, strict=True)]
    most = max(len(one.first) for one in each)

    def longer(leaf: Array) -> Array:
        return jnp.concatenate([leaf, jnp.zeros((most - len(leaf), *leaf.shape[1:]), leaf.dtype)])

    recordings = jax.tree.map(lambda *leaves: jnp.stack([longer(leaf) for leaf in leaves]), *each)
    index, training, held, odds = np.arange(most), [], [], []
    for one, (learned, _) in zip(data, splits, strict=True):
        number, count = sum(episode.length for episode in learned), one.example_count
        training.append(np.where(index < number, index, -1))
        held.append(np.where((index >= number) & (index < count), index, -1))
        chances = np.ones(number) / number
        if balance:
            chances = balanced_probabilities(one.read(learned, ("situations",))["situations"])
        odds.append(np.concatenate([chances, np.zeros(most - number)]))
    held = [np.concatenate([row[row >= 0], row[row < 0]]) for row in held]
    width = max(int((row >= 0).sum()) for row in held)
    rows = jnp.asarray(np.stack(training), jnp.int32)
    return recordings, rows, jnp.asarray(np.stack(held)[:, :width], jnp.int32), jnp.asarray(np.stack(odds), jnp.float32)


def _epoch(network: Network, options: ImitationConfig) -> Callable:
    """(states, best, over, recordings, training rows, validation rows, chances, seeds) -> (states, best, losses)."""
    compiled = training.programs(network, options, devices.mesh())

    def one(
        state: TrainState, best: TrainState, over: Array, recording: Recording, rows: Array, held: Array, odds: Array,
        seed: Array,
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

        after, trained = jax.lax.scan(step, state, training.in_batches(order, options.batch, 1))
        batches = training.in_batches(held, options.batch, 1)
        _, validated = jax.lax.scan(lambda _, index: (_, compiled.measure(after, *gather(index))), 0, batches)
        after, *losses = compiled.finish(after, trained.sum(0), validated.sum(0))
        better = after.best_epoch == after.epoch
        best = jax.tree.map(lambda old, new: jnp.where(better & ~over, new, old), best, after)
        after = jax.tree.map(lambda old, new: jnp.where(over, old, new), state, after)
        return after, best, tuple(losses)

    return jax.jit(jax.vmap(one), donate_argnums=(0, 1))


def _write(folder: Path, config: dict, state: TrainState, best: TrainState, lines: list, index: int) -> None:
    """The folder of a training that has ended."""
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)  # of one that was trained otherwise and killed
    write_config(folder, config)
    checkpoints = Checkpoints(folder, writes=True)
    for one in (best, state) if int(best.epoch) < int(state.epoch) else (state,):
        loss = lines[int(one.epoch) - 1][1].loss[index]
        checkpoints.save(one, int(one.epoch), float(loss))
        checkpoints.wait()
    log = Log(folder, 0)
    for number, (losses, validated, _, begun) in enumerate(lines, 1):
        told = [{name: float(value[index]) for name, value in each._asdict().items()} for each in (losses, validated)]
        log.add({"epoch": number, "train": told[0], "validation": told[1], "time": begun})

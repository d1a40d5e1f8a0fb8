"""Imitation (section V-C): equally weighted losses of the local planner and the velocity controller, AdamW, epochs.

Pure functions. An epoch is one call: a scan over shuffled batches, then one over those that validate, with the dataset
on the device. The shuffle comes from (seed, epoch), so a training that was interrupted goes on as it would have.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from sean_jax import chance
from sean_jax.base import Array
from sean_jax.devices import AXIS
from sean_jax.learning.examples import Example, Recording, example
from sean_jax.learning.learned import Weights, initial
from sean_jax.learning.network import Network
from sean_jax.learning.options import Train

STILL = 0.05  # m/s, rad/s: the least scale of a command, where it hardly varies


@struct.dataclass
class TrainState:
    """All that the rest of a training depends on."""

    weights: Weights
    optimizer: Any  # optax's state
    epoch: Array  # () int32, epochs done
    best: Array  # () least loss in validation so far
    best_epoch: Array  # () int32, the epoch that it came after


class Losses(NamedTuple):
    """Means over examples."""

    loss: Array  # () the sum of the next two
    local_plan: Array  # () m2, squared distance from the places of the next five seconds
    command: Array  # () squared error of the command, each part over its standard deviation, added up


class Programs(NamedTuple):
    """What is compiled, at first use."""

    # (state, recording, training rows (N,), rows to validate (M,), odds of the former (N,) or None)
    epoch: Callable  # -> (state, Losses, Losses)
    update: Callable  # (state, examples (B, ...), weight (B,)) -> (state, sums): where the dataset is read from disk
    measure: Callable  # (state, examples, weight) -> sums
    finish: Callable  # (state, sums, sums) -> (state, Losses, Losses): the end of an epoch made of such parts


def begin(network: Network, situations: int, options: Train, commands: Array) -> TrainState:
    """Before the first epoch. ``commands`` (R, 2) are those to be imitated, which decide the scale of the command."""
    weights = initial(network, situations, chance.key("weights", options.seed))
    weights = replace(weights, scale=jnp.maximum(jnp.std(commands, 0), STILL))
    state = _optimizer(options).init(weights.parameters)
    return TrainState(
        weights=weights,
        optimizer=state,
        epoch=jnp.zeros((), jnp.int32),
        best=jnp.full((), jnp.inf, jnp.float32),
        best_epoch=jnp.zeros((), jnp.int32),
    )


def programs(network: Network, options: Train, over: Mesh) -> Programs:
    """Programs on the devices of a mesh, over which each batch is split."""
    optimizer = _optimizer(options)
    split = NamedSharding(over, PartitionSpec(AXIS))

    def sums(parameters: Any, scale: Array, examples: Example, weight: Array) -> Array:
        return jnp.sum(jax.vmap(_errors, (None, None, None, 0, 0))(network, parameters, scale, examples, weight), 0)

    def loss(parameters: Any, scale: Array, examples: Example, weight: Array) -> tuple[Array, Array]:
        total = sums(parameters, scale, examples, weight)
        means = _losses(total)
        return means.loss, total

    def update(state: TrainState, examples: Example, weight: Array) -> tuple[TrainState, Array]:
        weights = state.weights
        slope, total = jax.grad(loss, has_aux=True)(weights.parameters, weights.scale, examples, weight)
        with jax.numpy_dtype_promotion("standard"):  # optax raises floats to whole numbers
            steps, after = optimizer.update(slope, state.optimizer, weights.parameters)
        parameters = optax.apply_updates(weights.parameters, steps)
        return replace(state, weights=replace(weights, parameters=parameters), optimizer=after), total

    def measure(state: TrainState, examples: Example, weight: Array) -> Array:
        return sums(state.weights.parameters, state.weights.scale, examples, weight)

    def taken(recording: Recording, index: Array) -> tuple[Example, Array]:
        index = jax.lax.with_sharding_constraint(index, split)
        examples = example(recording, jnp.maximum(index, 0))
        return examples, (index >= 0).astype(jnp.float32)

    def epoch(state: TrainState, recording: Recording, train: Array, validate: Array, odds: Array | None = None):
        key = jax.random.fold_in(chance.key("order", options.seed), state.epoch)
        if odds is None:
            drawn = jax.random.permutation(key, train)
        else:
            drawn = jax.random.choice(key, train, train.shape, p=odds)
        batches = in_batches(drawn, options.batch, over.size)
        state, trained = jax.lax.scan(lambda state, index: update(state, *taken(recording, index)), state, batches)
        batches = in_batches(validate, options.batch, over.size)
        _, found = jax.lax.scan(lambda _, index: (_, measure(state, *taken(recording, index))), 0, batches)
        return finish(state, trained.sum(0), found.sum(0))

    def finish(state: TrainState, trained: Array, found: Array):
        train, validation = _losses(trained), _losses(found)
        number = state.epoch + 1
        better = validation.loss < state.best
        state = replace(
            state,
            epoch=number,
            best=jnp.where(better, validation.loss, state.best),
            best_epoch=jnp.where(better, number, state.best_epoch),
        )
        return state, train, validation

    return Programs(
        jax.jit(epoch, donate_argnums=0), jax.jit(update, donate_argnums=0), jax.jit(measure), jax.jit(finish)
    )


def in_batches(rows: Array, size: int, devices: int) -> Array:
    """(batches, B) int32 of the rows (N,); -1 fills the last. B is at most N, rounded up for the devices."""
    number = rows.shape[0]
    size = -(-max(1, min(size, number)) // devices) * devices
    spare = -number % size
    return jnp.concatenate([rows, jnp.full((spare,), -1, jnp.int32)]).reshape(-1, size)


def _errors(network: Network, parameters: Any, scale: Array, one: Example, weight: Array) -> Array:
    """(4,) of one example: squared distances added up, places that are known, squared error of the command, and 1."""
    decision: Any = network.apply(parameters, one.images, one.plan, one.situations)
    gap = decision.local_plan - one.future
    far = gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1]
    known = one.known.astype(jnp.float32)
    off = decision.command - one.command / scale
    parts = jnp.stack([jnp.sum(known * far), jnp.sum(known), jnp.sum(off * off), jnp.ones((), jnp.float32)])
    return weight * parts


def _losses(sums: Array) -> Losses:
    local_plan = sums[0] / jnp.maximum(sums[1], 1.0)
    command = sums[2] / jnp.maximum(sums[3], 1.0)
    return Losses(local_plan + command, local_plan, command)


def _optimizer(options: Train) -> optax.GradientTransformation:
    return optax.adamw(options.learning_rate, weight_decay=options.weight_decay)

"""Steps of an optimizer over what an agent has seen: epochs of minibatches of whole scenarios."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Float, PyTree

from sean_jax.base import Array
from sean_jax.learning.actor_critic import ActorCritic, Agent
from sean_jax.learning.rollouts import Seen, unroll


class Descent(NamedTuple):
    """How an update learns."""

    rule: optax.GradientTransformation  # the optimizer, with a learning rate of -1
    rate: Float[Array, ""]  # learning rate
    epochs: int  # how often it goes through what was seen
    minibatches: int  # parts of it, each of which makes a step of the optimizer


def learn(
    descent: Descent,
    loss: Callable[..., tuple[Array, PyTree]],
    network: ActorCritic,
    agent: Agent,
    state: optax.OptState,
    data: tuple[Seen, *tuple[Array, ...]],
    memory: Float[Array, "B M"],
    key: Array,
) -> tuple[Agent, optax.OptState, PyTree]:
    """Go some times through what was seen, in another order each time, with a step of the optimizer for each minibatch.

    Args:
        loss: of a minibatch: (what the agent says now, ``*part``) -> (loss, numbers for the log).
        data: (T, B, ...) what was seen, and what else a loss needs of it; its parts are those of a minibatch.
        key: () typed PRNG key of the update.

    Returns:
        The agent, the state of the optimizer, and means of the numbers for the log.
    """

    def loss_of(parameters: PyTree, part: tuple, memory: Array) -> tuple[Array, PyTree]:
        return loss(unroll(network, replace(agent, parameters=parameters), part[0], memory), *part)

    def step(carry: tuple, rows: Array) -> tuple[tuple, PyTree]:
        parameters, state = carry
        part = jax.tree.map(lambda leaf: leaf[:, rows], data)
        gradient, told = jax.grad(loss_of, has_aux=True)(parameters, part, memory[rows])
        return descend(descent.rule, descent.rate, parameters, state, gradient), told

    def epoch(carry: tuple, key: Array) -> tuple[tuple, PyTree]:
        order = jax.random.permutation(key, memory.shape[0]).reshape(descent.minibatches, -1)
        return jax.lax.scan(step, carry, order)

    keys = jax.random.split(jax.random.fold_in(key, 2**31 - 1), descent.epochs)
    (parameters, state), told = jax.lax.scan(epoch, (agent.parameters, state), keys)
    return replace(agent, parameters=parameters), state, jax.tree.map(jnp.mean, told)


def descend(
    rule: optax.GradientTransformation, rate: Array, parameters: PyTree, state: optax.OptState, gradient: PyTree
) -> tuple[PyTree, optax.OptState]:
    """A step of an optimizer whose learning rate is a number of the program.

    Args:
        rule: the optimizer, with a learning rate of -1.
        rate: () learning rate.
    """
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        change, state = rule.update(gradient, state, parameters)
    return optax.apply_updates(parameters, jax.tree.map(lambda part: -rate * part, change)), state

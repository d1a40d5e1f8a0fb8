"""Proximal policy optimization over minibatches of whole scenarios.

Source: J. Schulman et al., "Proximal policy optimization algorithms", 2017.
"""

import functools
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Float

from sean_jax.config import PPOConfig
from sean_jax.core.data_types import Array
from sean_jax.learning import networks, rollouts
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput, Statistics, entropy, log_density
from sean_jax.learning.rollouts import EnvBatch, Envs, Optimization, Transition

VALUE_WEIGHT = 0.5  # of the critic's loss
MAX_GRADIENT_NORM = 0.5
EPSILON = 1e-8
MEMORY = 100.0  # updates, of the statistics of returns

_ADAM = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.scale_by_adam(eps=1e-5))
OPTIMIZER = optax.partition({"actor": _ADAM, "critic": _ADAM}, networks.owners)  # each with a clip of its own


@struct.dataclass
class Optimizer:
    """The state between updates besides the agent. Checkpoints have these field names."""

    steps: optax.OptState
    returns: Statistics  # (1,) of estimated returns


def init(agent: Agent) -> Optimizer:
    """The optimizer before the first update."""
    return Optimizer(OPTIMIZER.init(agent.parameters), networks.init_statistics(jnp.zeros(1, jnp.float32)))


def update(
    options: PPOConfig,
    hyperparameters: dict[str, Array],
    envs: Envs,
    network: ActorCritic,
    agent: Agent,
    optimizer: Optimizer,
    batch: EnvBatch,
    key: Array,
) -> tuple[Agent, Optimizer, EnvBatch, Transition, dict[str, Any]]:
    """The agent, optimizer and scenarios after a rollout and its epochs, the transitions, and numbers for the log.

    Args:
        hyperparameters: this agent's values of ``PPOConfig.SWEPT``; the learning rate is this update's, and
            ``actor_rate`` the actor's.
        envs: with pools; scenarios are shared out equally.
        key: () typed PRNG key of this update.
    """
    # All scenarios take some steps, of which advantages are estimated.
    memory = batch.memory
    batch, transitions = rollouts.rollout(envs, network, agent, batch, options.horizon, key)
    last = rollouts.forward(network, agent, envs[0].member.observations, batch)

    # Generalized advantage estimation (J. Schulman et al., ICLR 2016); the target is its TD(lambda) return.
    discount = hyperparameters["discount"]
    decay = hyperparameters["advantage_decay"]
    advantage = rollouts.advantages(transitions, last.value, discount, decay)  # (T, B)
    target = advantage + transitions.value

    # The critic learns in units of the returns' deviation, and its value stays the same.
    returns = networks.update_statistics(optimizer.returns, target[..., None])
    returns = replace(returns, count=jnp.minimum(returns.count, MEMORY * target.size))
    scale = jnp.sqrt(returns.variance[0] + EPSILON)  # ()

    # Epochs over minibatches of the transitions.
    rates = {"actor": hyperparameters["actor_rate"], "critic": hyperparameters["learning_rate"]}
    rate = jax.tree.map(rates.get, networks.owners(agent.parameters))
    optimization = Optimization(OPTIMIZER, rate, options.epochs, options.minibatches)

    # The value is scaled by its last layer, before and after: rescaled targets (van Hasselt et al., 2016).
    loss = functools.partial(clipped_loss, hyperparameters, scale)
    data = transitions._replace(info={}), advantage, target
    agent = replace(agent, parameters=networks.scale_value(agent.parameters, 1.0 / scale))
    agent, steps, losses = rollouts.optimize(optimization, loss, network, agent, optimizer.steps, data, memory, key)
    agent = replace(agent, parameters=networks.scale_value(agent.parameters, scale))

    # Statistics follow last: the log densities of the rollout belong to observations as normalized then.
    explained = 1.0 - (target - transitions.value).var() / jnp.maximum(target.var(), EPSILON)
    metrics = {"train": losses | {"explained_variance": explained}, **rollouts.log_numbers(transitions)}
    agent = rollouts.with_statistics(agent, transitions)
    return agent, Optimizer(steps, returns), batch, transitions, metrics


def clipped_loss(
    hyperparameters: dict[str, Array],
    scale: Float[Array, ""],
    output: NetworkOutput,
    transitions: Transition,
    advantage: Float[Array, "T B"],
    target: Float[Array, "T B"],
) -> tuple[Array, dict[str, Array]]:
    """The clipped surrogate objective with the critic's loss and the entropy; and numbers for the log.

    Args:
        scale: of returns, the unit of the critic's value.
        advantage: normalized here, over the minibatch.
        target: of the critic, in units of the reward.
    """
    log_ratio = log_density(output, transitions.action) - transitions.log_density
    ratio = jnp.exp(log_ratio)
    clip = hyperparameters["clip"]
    gain = (advantage - advantage.mean()) / (advantage.std() + EPSILON)
    clipped = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)
    actor = -jnp.minimum(ratio * gain, clipped * gain).mean()

    critic = 0.5 * ((output.value - target / scale) ** 2).mean()
    spread = entropy(output).mean()
    total = actor + VALUE_WEIGHT * critic - hyperparameters["entropy"] * spread
    metrics = {
        "loss": total,
        "actor": actor,
        "critic": critic,
        "entropy": spread,
        "divergence": ((ratio - 1.0) - log_ratio).mean(),
        "clipped": (jnp.abs(ratio - 1.0) > clip).mean(dtype=jnp.float32),
    }
    return total, metrics

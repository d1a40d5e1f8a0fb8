"""Proximal policy optimization: an update goes through what was seen in minibatches of whole scenarios.

Source: J. Schulman et al., "Proximal policy optimization algorithms", 2017.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import optax
from jaxtyping import Float

from sean_jax import mdp
from sean_jax.base import Array
from sean_jax.config import PPOConfig
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput, entropy, log_density, update_statistics
from sean_jax.learning.rollouts import (
    EnvBatch,
    Optimization,
    Transition,
    advantages,
    episode_means,
    forward,
    optimize,
    rollout,
)

VALUE_WEIGHT = 0.5  # of the critic's loss
MAX_GRADIENT_NORM = 0.5
FEW = 1e-8

OPTIMIZER = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.scale_by_adam(eps=1e-5))


def init(agent: Agent) -> optax.OptState:
    """The optimizer before the first update."""
    return OPTIMIZER.init(agent.parameters)


def update(
    options: PPOConfig,
    numbers: dict[str, Array],
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    agent: Agent,
    optimizer: optax.OptState,
    rows: EnvBatch,
    key: Array,
) -> tuple[Agent, optax.OptState, EnvBatch, Transition, dict[str, Any]]:
    """Let the agent drive, and learn from that.

    Args:
        numbers: what an agent of a sweep has for itself, of the names in ``PPOConfig.SWEPT``; the learning rate is that
            of this update.
        envs: what is trained on, with pools; scenarios are shared out equally.
        key: () typed PRNG key of this update.

    Returns:
        The agent, the state of the optimizer, the scenarios, what was seen, and numbers for the log.
    """
    memory = rows.memory
    rows, seen = rollout(envs, network, agent, rows, options.horizon, key)
    last = forward(network, agent, envs[0].observations, rows)
    advantage = advantages(seen, last.value, numbers["discount"], numbers["advantage_decay"])
    agent, optimizer, losses = _learn(options, numbers, network, agent, optimizer, seen, memory, advantage, key)
    statistics = update_statistics(agent.statistics, seen.vector.reshape(-1, seen.vector.shape[-1]))
    wanted = advantage + seen.value
    explained = 1.0 - (wanted - seen.value).var() / jnp.maximum(wanted.var(), FEW)
    told = {
        "train": losses | {"explained_variance": explained},
        "episodes": episode_means(seen),
        "rewards": {name: part.mean() for name, part in seen.told["rewards"].items()},
    }
    return replace(agent, statistics=statistics), optimizer, rows, seen, told


def _learn(
    options: PPOConfig,
    numbers: dict[str, Array],
    network: ActorCritic,
    agent: Agent,
    optimizer: optax.OptState,
    seen: Transition,
    memory: Float[Array, "B M"],
    advantage: Float[Array, "T B"],
    key: Array,
) -> tuple[Agent, optax.OptState, dict[str, Array]]:
    """The agent, the state of the optimizer, and numbers for the log, after the epochs of an update."""

    def loss(said: NetworkOutput, steps: Transition, gain: Array, wanted: Array) -> tuple[Array, dict[str, Array]]:
        change = log_density(said, steps.action) - steps.log_density
        ratio, clip = jnp.exp(change), numbers["clip"]
        gain = (gain - gain.mean()) / (gain.std() + FEW)
        clipped = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)
        actor = -jnp.minimum(ratio * gain, clipped * gain).mean()
        critic = 0.5 * ((said.value - wanted) ** 2).mean()
        spread = entropy(said).mean()
        total = actor + VALUE_WEIGHT * critic - numbers["entropy"] * spread
        told = {
            "loss": total,
            "actor": actor,
            "critic": critic,
            "entropy": spread,
            "divergence": ((ratio - 1.0) - change).mean(),
            "clipped": (jnp.abs(ratio - 1.0) > clip).mean(dtype=jnp.float32),
        }
        return total, told

    descent = Optimization(OPTIMIZER, numbers["learning_rate"], options.epochs, options.minibatches)
    data = seen._replace(told={}), advantage, advantage + seen.value
    return optimize(descent, loss, network, agent, optimizer, data, memory, key)

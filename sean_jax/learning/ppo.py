"""Proximal policy optimization: an update goes through what was seen in minibatches of whole scenarios.

Source: J. Schulman et al., "Proximal policy optimization algorithms", 2017.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Float, PyTree

from sean_jax import mdp
from sean_jax.base import Array
from sean_jax.config import PPOConfig
from sean_jax.learning.actor_critic import ActorCritic, Agent, entropy, log_density, update_statistics
from sean_jax.learning.rollouts import Rows, Seen, advantages, collect, of_episodes, say, unroll

VALUE_WEIGHT = 0.5  # of the critic's loss
MAX_GRADIENT_NORM = 0.5
FEW = 1e-8

OPTIMIZER = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.scale_by_adam(eps=1e-5))


def init(agent: Agent) -> optax.OptState:
    """The optimizer before the first update.

    Args:
        agent: what is trained.

    Returns:
        Its state.
    """
    return OPTIMIZER.init(agent.parameters)


def update(
    options: PPOConfig,
    numbers: dict[str, Array],
    env: mdp.Env,
    network: ActorCritic,
    agent: Agent,
    optimizer: optax.OptState,
    rows: Rows,
    key: Array,
) -> tuple[Agent, optax.OptState, Rows, Seen, dict[str, Any]]:
    """Let the agent drive, and learn from that.

    Args:
        options: sizes.
        numbers: what an agent of a sweep has for itself, of the names in ``PPOConfig.SWEPT``; the learning rate is that
            of this update.
        env: what is trained on, with a pool.
        network: whose parameters the agent has.
        agent: what is trained.
        optimizer: its state.
        rows: the scenarios.
        key: () typed PRNG key of this update.

    Returns:
        The agent, the state of the optimizer, the scenarios, what was seen, and numbers for the log.
    """
    memory = rows.memory
    rows, seen = collect(env, network, agent, rows, options.horizon, key)
    last = say(network, agent, env.observations, rows.observation, rows.memory, rows.start)
    advantage = advantages(seen, last.value, numbers["discount"], numbers["advantage_decay"])
    agent, optimizer, losses = _learn(options, numbers, network, agent, optimizer, seen, memory, advantage, key)
    statistics = update_statistics(agent.statistics, seen.vector.reshape(-1, seen.vector.shape[-1]))
    wanted = advantage + seen.value
    explained = 1.0 - (wanted - seen.value).var() / jnp.maximum(wanted.var(), FEW)
    told = {
        "train": losses | {"explained_variance": explained},
        "episodes": of_episodes(seen),
        "rewards": {name: part.mean() for name, part in seen.told["rewards"].items()},
    }
    return replace(agent, statistics=statistics), optimizer, rows, seen, told


def _learn(
    options: PPOConfig,
    numbers: dict[str, Array],
    network: ActorCritic,
    agent: Agent,
    optimizer: optax.OptState,
    seen: Seen,
    memory: Float[Array, "B M"],
    advantage: Float[Array, "T B"],
    key: Array,
) -> tuple[Agent, optax.OptState, dict[str, Array]]:
    """Steps of the optimizer over minibatches of whole scenarios."""
    data = seen._replace(told={}), advantage, advantage + seen.value

    def loss(parameters: PyTree, part: tuple, memory: Array) -> tuple[Array, dict[str, Array]]:
        steps, gain, wanted = part
        said = unroll(network, replace(agent, parameters=parameters), steps, memory)
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

    def step(carry: tuple, rows: Array) -> tuple[tuple, dict[str, Array]]:
        parameters, optimizer = carry
        part = jax.tree.map(lambda leaf: leaf[:, rows], data)
        gradient, told = jax.grad(loss, has_aux=True)(parameters, part, memory[rows])
        return descend(OPTIMIZER, numbers["learning_rate"], parameters, optimizer, gradient), told

    def epoch(carry: tuple, key: Array) -> tuple[tuple, dict[str, Array]]:
        order = jax.random.permutation(key, options.scenarios).reshape(options.minibatches, -1)
        return jax.lax.scan(step, carry, order)

    keys = jax.random.split(jax.random.fold_in(key, 2**31 - 1), options.epochs)
    (parameters, optimizer), told = jax.lax.scan(epoch, (agent.parameters, optimizer), keys)
    return replace(agent, parameters=parameters), optimizer, jax.tree.map(jnp.mean, told)


def descend(
    rule: optax.GradientTransformation, rate: Array, parameters: PyTree, state: optax.OptState, gradient: PyTree
) -> tuple[PyTree, optax.OptState]:
    """A step of an optimizer whose learning rate is a number of the program.

    Args:
        rule: the optimizer, with a learning rate of -1.
        rate: () learning rate.
        parameters: of the network.
        state: of the optimizer.
        gradient: of the loss by the parameters.

    Returns:
        Parameters and state afterwards.
    """
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        change, state = rule.update(gradient, state, parameters)
    return optax.apply_updates(parameters, jax.tree.map(lambda part: -rate * part, change)), state

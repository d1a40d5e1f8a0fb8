"""What an agent of reinforcement learning does and sees while it learns: steps of many scenarios, and their advantages.

Source: J. Schulman et al., "High-dimensional continuous control using generalized advantage estimation", ICLR 2016.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Bool, Float, PyTree

from sean_jax import mdp
from sean_jax.base import Array
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput, apply, draw_action, log_density
from sean_jax.mdp import observations

INFO_KEYS = ("rewards", "completed", "episode_return", "episode_length", "start", "situations")  # of a step's info


@struct.dataclass
class EnvBatch:
    """Scenarios that step together, between two updates, in one environment or several, of which they take turns."""

    envs: tuple[mdp.EnvState, ...]  # (B / E, ...) of the scenarios of each environment
    observation: dict[str, Array]  # (B, ...)
    memory: Float[Array, "B M"]  # of the network
    start: Bool[Array, "B"]  # whether the observation is the first of an episode


class Transition(NamedTuple):
    """What a step of a scenario gives, or stacked (T, B, ...)."""

    vector: Float[Array, "F"]
    images: dict[str, Array]
    start: Bool[Array, ""]
    action: Float[Array, "2"]
    log_density: Float[Array, ""]
    value: Float[Array, ""]
    reward: Float[Array, ""]
    over: Bool[Array, ""]  # the episode ended with this step
    final_value: Float[Array, ""]  # of what followed a truncation; 0 where none was
    told: dict[str, Any]  # for the log and the curriculum


def split_by_env(tree: PyTree, number: int) -> tuple[PyTree, ...]:
    """What belongs to the scenarios of each environment.

    Args:
        tree: (B, ...) of all scenarios.
        number: of environments, E. They take turns, so that each device has as many scenarios of each.

    Returns:
        E times (B / E, ...).
    """

    def of(turn: int) -> PyTree:
        return jax.tree.map(lambda leaf: leaf.reshape(-1, number, *leaf.shape[1:])[:, turn], tree)

    return tuple(map(of, range(number)))


def merge_envs(parts: Sequence[PyTree]) -> PyTree:
    """The inverse of ``deal``.

    Args:
        parts: E times (B / E, ...).

    Returns:
        (B, ...) of all scenarios.
    """
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, 1).reshape(-1, *leaves[0].shape[1:]), *parts)


def reset_envs(envs: tuple[mdp.Env, ...], network: ActorCritic, key: Array, number: int) -> EnvBatch:
    """Scenarios at the start of their first episodes.

    Args:
        key: () typed PRNG key.
    """
    keys = split_by_env(jax.random.split(key, number), len(envs))
    begun = [jax.vmap(env.reset)(own) for env, own in zip(envs, keys, strict=True)]
    shown, states = merge_envs([shown for shown, _ in begun]), tuple(states for _, states in begun)
    return EnvBatch(states, shown, jnp.zeros((number, network.memory_size), jnp.float32), jnp.ones(number, bool))


def flat_observations(terms: observations.Terms, observation: dict[str, Array]) -> Float[Array, "B F"]:
    """The numbers of observations, without images.

    Args:
        observation: (B, ...) of each term.
    """
    return jax.vmap(functools.partial(observations.flatten, terms))(observation).astype(jnp.float32)


def forward(network: ActorCritic, agent: Agent, terms: observations.Terms, rows: EnvBatch) -> NetworkOutput:
    """The answer to what many scenarios show.

    Returns:
        The answer, (B, ...).
    """
    vector, images = flat_observations(terms, rows.observation), _images(network, rows)
    return apply(network, agent, vector, images, rows.memory, rows.start)


def _images(network: ActorCritic, rows: EnvBatch) -> dict[str, Array]:
    return {name: rows.observation[name].astype(network.image_dtype) for name in network.images}


def step(
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    judge: Agent,
    rows: EnvBatch,
    said: NetworkOutput,
    action: Float[Array, "B 2"],
    key: Array,
) -> tuple[EnvBatch, Transition]:
    """A step of all scenarios.

    Args:
        envs: what is trained on, with pools; scenarios are shared out equally.
        key: () typed PRNG key of the episodes that begin.

    Returns:
        The scenarios afterwards, and what was seen, (B, ...); its value is that of ``said``.
    """
    terms, keys = envs[0].observations, jax.random.split(key, rows.start.shape[0])
    dealt = zip(envs, split_by_env(keys, len(envs)), rows.envs, split_by_env(action, len(envs)), strict=True)
    stepped = [jax.vmap(env.step)(own, before, done) for env, own, before, done in dealt]
    following, reward, terminated, truncated, info = merge_envs([(shown, *rest) for shown, _, *rest in stepped])
    states, over = tuple(each[1] for each in stepped), terminated | truncated
    ended = EnvBatch(states, info["final_observation"], said.memory, jnp.zeros_like(over))
    seen = Transition(
        vector=flat_observations(terms, rows.observation),
        images=_images(network, rows),
        start=rows.start,
        action=action,
        log_density=log_density(said, action),
        value=said.value,
        reward=reward.astype(jnp.float32),
        over=over,
        final_value=jnp.where(truncated, forward(network, judge, terms, ended).value, 0.0),
        told={name: info[name] for name in INFO_KEYS},
    )
    return EnvBatch(states, following, said.memory, over), seen


def rollout(
    envs: tuple[mdp.Env, ...], network: ActorCritic, agent: Agent, rows: EnvBatch, steps: int, key: Array
) -> tuple[EnvBatch, Transition]:
    """Let the agent drive, with the noise of its actions.

    Args:
        envs: what is trained on, with pools; scenarios are shared out equally.
        key: () typed PRNG key of the noise and of the episodes that begin.

    Returns:
        The scenarios afterwards, and (T, B) of what was seen.
    """

    def one(rows: EnvBatch, tick: Array) -> tuple[EnvBatch, Transition]:
        action_key, next_key = jax.random.split(jax.random.fold_in(key, tick))
        said = forward(network, agent, envs[0].observations, rows)
        return step(envs, network, agent, rows, said, draw_action(said, action_key), next_key)

    return jax.lax.scan(one, rows, jnp.arange(steps, dtype=jnp.int32))


def advantages(seen: Transition, last_value: Float[Array, "B"], discount: Array, decay: Array) -> Float[Array, "T B"]:
    """Generalized advantage estimates; an episode that was truncated is worth what followed.

    Args:
        seen: (T, B) of the scenarios.
    """

    def back(carry: tuple[Array, Array], step: Transition) -> tuple[tuple[Array, Array], Array]:
        advantage, following = carry
        following = jnp.where(step.over, step.final_value, following)
        error = step.reward + discount * following - step.value
        advantage = error + jnp.where(step.over, 0.0, discount * decay) * advantage
        return (advantage, step.value), advantage

    nothing = jnp.zeros_like(last_value)
    _, found = jax.lax.scan(back, (nothing, last_value), seen._replace(vector=(), images={}, told={}), reverse=True)
    return found


def unroll(network: ActorCritic, agent: Agent, seen: Transition, memory: Float[Array, "B M"]) -> NetworkOutput:
    """Answers to observations in a row.

    Args:
        seen: (T, B) of the scenarios.

    Returns:
        The answers, (T, B, ...).
    """
    if not network.recurrent:
        empty = jnp.zeros((*seen.start.shape, 0), jnp.float32)
        return apply(network, agent, seen.vector, seen.images, empty, seen.start)

    def one(memory: Array, step: Transition) -> tuple[Array, NetworkOutput]:
        said = apply(network, agent, step.vector, step.images, memory, step.start)
        return said.memory, said

    return jax.lax.scan(one, memory, seen)[1]


def episode_means(seen: Transition) -> dict[str, Array]:
    """Of the episodes that ended in an update: how many, and means, which are NaN if none did.

    Args:
        seen: (T, B) of the scenarios.
    """
    over = seen.over.astype(jnp.float32)
    number = over.sum()

    def mean(values: Array) -> Array:
        return (values.astype(jnp.float32) * over).sum() / number

    return {
        "number": number,
        "return": mean(seen.told["episode_return"]),
        "steps": mean(seen.told["episode_length"]),
        "completed": mean(seen.told["completed"]),
    }


class Optimization(NamedTuple):
    """How an update learns."""

    rule: optax.GradientTransformation  # the optimizer, with a learning rate of -1
    rate: Float[Array, ""]  # learning rate
    epochs: int  # how often it goes through what was seen
    minibatches: int  # parts of it, each of which makes a step of the optimizer


def optimize(
    descent: Optimization,
    loss: Callable[..., tuple[Array, PyTree]],
    network: ActorCritic,
    agent: Agent,
    state: optax.OptState,
    data: tuple[Transition, *tuple[Array, ...]],
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
        return apply_gradient(descent.rule, descent.rate, parameters, state, gradient), told

    def epoch(carry: tuple, key: Array) -> tuple[tuple, PyTree]:
        order = jax.random.permutation(key, memory.shape[0]).reshape(descent.minibatches, -1)
        return jax.lax.scan(step, carry, order)

    keys = jax.random.split(jax.random.fold_in(key, 2**31 - 1), descent.epochs)
    (parameters, state), told = jax.lax.scan(epoch, (agent.parameters, state), keys)
    return replace(agent, parameters=parameters), state, jax.tree.map(jnp.mean, told)


def apply_gradient(
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

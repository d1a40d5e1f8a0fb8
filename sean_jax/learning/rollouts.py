"""Rollouts of many scenarios, advantages, and epochs of minibatches over their transitions.

Source: J. Schulman et al., "High-dimensional continuous control using generalized advantage estimation", ICLR 2016.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax import mdp
from sean_jax.core.data_types import Array
from sean_jax.learning import networks
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput
from sean_jax.mdp import observations
from sean_jax.simulation.scenario_stack import Stack, of_arrays

MIN_POOL = 8  # starts on each of several floors
BLOCKS = 8  # of scenarios at most, within which minibatches are shuffled
Envs = tuple[Stack[mdp.Env], ...]
"""Environments that share the scenarios equally, each on one floor or on several."""
INFO_KEYS = ("rewards", "completed", "episode_return", "episode_length", "start", "situations")  # of a step's info


@struct.dataclass
class EnvBatch:
    """B scenarios that step together; they take turns through E environments. Checkpoints have these field names."""

    envs: tuple[mdp.EnvState, ...]  # E times (B / E, ...)
    observation: dict[str, Array]  # (B, ...)
    memory: Float[Array, "B M"]  # of the network
    start: Bool[Array, "B"]  # whether it is the first observation of an episode


class Transition(NamedTuple):
    """One step of a scenario; stacked: (T, B, ...)."""

    vector: Float[Array, "F"]
    images: dict[str, Array]
    start: Bool[Array, ""]
    action: Float[Array, "2"]
    log_density: Float[Array, ""]
    value: Float[Array, ""]
    reward: Float[Array, ""]
    done: Bool[Array, ""]  # the episode ended with this step
    final_value: Float[Array, ""]  # of the state after a truncation, else 0
    info: dict[str, Any]  # ``INFO_KEYS``, for the log and the curriculum


def split_by_env(tree: PyTree, number: int) -> tuple[PyTree, ...]:
    """(B, ...) of all scenarios as E = ``number`` parts (B / E, ...), one for each environment.

    Environments take turns, so that each device has equally many scenarios of each.
    """

    by_turn = jax.tree.map(lambda leaf: leaf.reshape(-1, number, *leaf.shape[1:]), tree)  # (B / E, E, ...)
    return tuple(jax.tree.map(lambda leaf, turn=turn: leaf[:, turn], by_turn) for turn in range(number))


def merge_envs(parts: Sequence[PyTree]) -> PyTree:
    """(B, ...) of E parts (B / E, ...): the inverse of ``split_by_env``."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, 1).reshape(-1, *leaves[0].shape[1:]), *parts)


def draw_pool(
    env: Stack[mdp.Env], key: Array, size: int, change: Callable[[mdp.Env, mdp.Pool], mdp.Pool] = lambda _, pool: pool
) -> Stack[mdp.Pool] | mdp.Pool:
    """Starts of episodes: ``size`` in all, and on each floor ``MIN_POOL`` at least.

    Args:
        key: () typed PRNG key.
        change: (env, pool) -> the pool in its place.
    """
    number = max(min(MIN_POOL, size), size // env.size)

    def draw(env: mdp.Env, key: Array) -> mdp.Pool:
        pool = env.with_pool(key, number).pool
        assert pool is not None
        return change(env, pool)

    if env.size == 1:
        return draw(env.member, key)
    return of_arrays(env.over_members(draw)(jax.random.split(key, env.size)))


def with_pool(env: Stack[mdp.Env], *arguments: Any) -> Stack[mdp.Env]:
    """The environments with the starts of ``draw_pool``."""
    return env.with_fields(pool=draw_pool(env, *arguments))


def reset_envs(envs: Envs, network: ActorCritic, key: Array, number: int) -> EnvBatch:
    """``number`` scenarios at the start of their first episodes, from the pools; the key is a typed PRNG key ()."""
    keys = split_by_env(jax.random.split(key, number), len(envs))
    observed = []
    states = []
    for env, env_keys in zip(envs, keys, strict=True):
        env_observation, env_states = env.vmap(mdp.Env.start)(env_keys)
        observed.append(env_observation)
        states.append(env_states)
    memory = jnp.zeros((number, network.memory_size), jnp.float32)
    return EnvBatch(tuple(states), merge_envs(observed), memory, jnp.ones(number, bool))


def flat_observations(terms: observations.Terms, observation: dict[str, Array]) -> Float[Array, "B F"]:
    """The numbers of observations (B, ...), without images."""
    return jax.vmap(functools.partial(observations.flatten, terms))(observation).astype(jnp.float32)


def forward(network: ActorCritic, agent: Agent, terms: observations.Terms, batch: EnvBatch) -> NetworkOutput:
    """The network's output (B, ...) for the present observations."""
    vector = flat_observations(terms, batch.observation)
    images = _images(network, batch)
    return networks.apply(network, agent, vector, images, batch.memory, batch.start)


def _images(network: ActorCritic, batch: EnvBatch) -> dict[str, Array]:
    return {name: batch.observation[name].astype(network.image_dtype) for name in network.images}


def step(
    envs: Envs,
    network: ActorCritic,
    target_critic: Agent,
    batch: EnvBatch,
    output: NetworkOutput,
    action: Float[Array, "B 2"],
    key: Array,
) -> tuple[EnvBatch, Transition]:
    """One step of all scenarios, (B, ...).

    Args:
        envs: with pools; scenarios are shared out equally.
        target_critic: values the state after a truncation.
        output: of the agent, for its value and the log density of the action.
        key: () typed PRNG key of the episodes that begin.
    """
    terms = envs[0].member.observations
    keys = jax.random.split(key, batch.start.shape[0])

    # Each environment steps its own share of the scenarios.
    shares = split_by_env(keys, len(envs)), batch.envs, split_by_env(action, len(envs))
    states = []
    results = []
    for env, env_keys, env_states, env_actions in zip(envs, *shares, strict=True):
        observation, env_states, *rest = env.vmap(mdp.Env.step)(env_keys, env_states, env_actions)
        states.append(env_states)
        results.append((observation, *rest))
    following, reward, terminated, truncated, info = merge_envs(results)
    states = tuple(states)
    done = terminated | truncated

    # A truncated episode is worth the value of its last state.
    ended = EnvBatch(states, info["final_observation"], output.memory, jnp.zeros_like(done))
    final_value = forward(network, target_critic, terms, ended).value
    transition = Transition(
        vector=flat_observations(terms, batch.observation),
        images=_images(network, batch),
        start=batch.start,
        action=action,
        log_density=networks.log_density(output, action),
        value=output.value,
        reward=reward.astype(jnp.float32),
        done=done,
        final_value=jnp.where(truncated, final_value, 0.0),
        info={name: info[name] for name in INFO_KEYS},
    )
    return EnvBatch(states, following, output.memory, done), transition


def rollout(
    envs: Envs, network: ActorCritic, agent: Agent, batch: EnvBatch, steps: int, key: Array
) -> tuple[EnvBatch, Transition]:
    """T = ``steps`` transitions (T, B, ...) of an agent with the noise of its actions, and the scenarios afterwards.

    The key is a typed PRNG key () of the noise and of the episodes that begin.
    """

    def advance(batch: EnvBatch, tick: Array) -> tuple[EnvBatch, Transition]:
        action_key, next_key = jax.random.split(jax.random.fold_in(key, tick))
        output = forward(network, agent, envs[0].member.observations, batch)
        return step(envs, network, agent, batch, output, networks.draw_action(output, action_key), next_key)

    return jax.lax.scan(advance, batch, jnp.arange(steps, dtype=jnp.int32))


def advantages(
    transitions: Transition, last_value: Float[Array, "B"], discount: Array, decay: Array
) -> Float[Array, "T B"]:
    """Generalized advantage estimates of transitions (T, B); truncated episodes are worth the value that followed."""

    def back(carry: tuple[Array, Array], step: Transition) -> tuple[tuple[Array, Array], Array]:
        advantage, following = carry
        following = jnp.where(step.done, step.final_value, following)
        error = step.reward + discount * following - step.value
        advantage = error + jnp.where(step.done, 0.0, discount * decay) * advantage
        return (advantage, step.value), advantage

    carry = jnp.zeros_like(last_value), last_value
    numbers = transitions._replace(vector=(), images={}, info={})
    return jax.lax.scan(back, carry, numbers, reverse=True)[1]


def unroll(network: ActorCritic, agent: Agent, transitions: Transition, memory: Float[Array, "B M"]) -> NetworkOutput:
    """The network's output (T, B, ...) for the observations of transitions (T, B), from the memory before them."""
    if not network.recurrent:
        empty = jnp.zeros((*transitions.start.shape, 0), jnp.float32)
        return networks.apply(network, agent, transitions.vector, transitions.images, empty, transitions.start)

    def advance(memory: Array, step: Transition) -> tuple[Array, NetworkOutput]:
        output = networks.apply(network, agent, step.vector, step.images, memory, step.start)
        return output.memory, output

    return jax.lax.scan(advance, memory, transitions)[1]


def with_statistics(agent: Agent, transitions: Transition) -> Agent:
    """The agent whose statistics include the observations of transitions (T, B, ...)."""
    return replace(agent, statistics=networks.update_statistics(agent.statistics, transitions.vector))


def log_numbers(transitions: Transition) -> dict[str, dict[str, Array]]:
    """Numbers for the log of transitions (T, B): how many episodes ended, their means, NaN if none did, and the means
    of rewards.
    """
    done = transitions.done.astype(jnp.float32)
    number = done.sum()

    def mean(values: Array) -> Array:
        return (values.astype(jnp.float32) * done).sum() / number

    info = transitions.info
    episodes = {
        "number": number,
        "return": mean(info["episode_return"]),
        "steps": mean(info["episode_length"]),
        "completed": mean(info["completed"]),
    }
    return {"episodes": episodes, "rewards": {name: values.mean() for name, values in info["rewards"].items()}}


# ------------------------------------------------------------------ minibatches


class Optimization(NamedTuple):
    """How an update learns from its transitions."""

    optimizer: optax.GradientTransformation  # with a learning rate of -1
    learning_rate: PyTree  # of all parameters, or of each
    epochs: int
    minibatches: int  # of whole scenarios in an epoch, each for one step of the optimizer


def optimize(
    how: Optimization,
    loss: Callable[..., tuple[Array, PyTree]],
    network: ActorCritic,
    agent: Agent,
    state: optax.OptState,
    data: tuple[Transition, *tuple[Array, ...]],
    memory: Float[Array, "B M"],
    key: Array,
) -> tuple[Agent, optax.OptState, PyTree]:
    """The agent after epochs over shuffled minibatches, the optimizer's state, and means of the numbers for the log.

    Args:
        loss: ``(network output now, *minibatch of data) -> (loss, numbers for the log)``.
        data: transitions (T, B, ...) and other arrays (T, B, ...) of which minibatches are cut along B.
        memory: of the network before the transitions.
        key: () typed PRNG key of the update.
    """

    def loss_of(parameters: PyTree, part: tuple, memory: Array) -> tuple[Array, PyTree]:
        return loss(unroll(network, replace(agent, parameters=parameters), part[0], memory), *part)

    def step(carry: tuple, rows: Array) -> tuple[tuple, PyTree]:
        parameters, state = carry
        part = jax.tree.map(lambda leaf: take_rows(leaf, rows, axis=1), data)
        gradient, numbers = jax.grad(loss_of, has_aux=True)(parameters, part, take_rows(memory, rows, axis=0))
        return apply_gradient(how.optimizer, how.learning_rate, parameters, state, gradient), numbers

    def epoch(carry: tuple, key: Array) -> tuple[tuple, PyTree]:
        return jax.lax.scan(step, carry, shuffled_rows(key, memory.shape[0], how.minibatches))

    keys = jax.random.split(jax.random.fold_in(key, 2**31 - 1), how.epochs)
    (parameters, state), numbers = jax.lax.scan(epoch, (agent.parameters, state), keys)
    return replace(agent, parameters=parameters), state, jax.tree.map(jnp.mean, numbers)


def shuffled_rows(key: Array, number: int, minibatches: int) -> Int[Array, "minibatches blocks rows"]:
    """Minibatches of ``number`` scenarios in random order, equally many of each block, as rows within the blocks.

    A device that holds whole blocks needs no scenario of another device. Neither the blocks nor the order depend on
    the number of devices.

    Args:
        key: () typed PRNG key.
        number: a multiple of ``minibatches``.
    """
    blocks = math.gcd(number // minibatches, BLOCKS)
    size = number // blocks
    order = jax.vmap(lambda key: jax.random.permutation(key, size))(jax.random.split(key, blocks))
    return order.reshape(blocks, minibatches, -1).swapaxes(0, 1)


def take_rows(values: Array, rows: Int[Array, "blocks rows"], axis: int) -> Array:
    """The rows of each block of an axis, one block after the other: a minibatch of ``shuffled_rows``."""
    before = values.shape[:axis]
    number = values.shape[axis]
    after = values.shape[axis + 1 :]
    blocks, taken = rows.shape
    parts = values.reshape(*before, blocks, number // blocks, *after)

    # A gather with a batch axis stays on each device, while ``values[rows]`` would collect all scenarios on each.
    take = jax.vmap(lambda block, chosen: jnp.take(block, chosen, axis=axis), in_axes=(axis, 0), out_axes=axis)
    return take(parts, rows).reshape(*before, blocks * taken, *after)


def apply_gradient(
    optimizer: optax.GradientTransformation, rate: PyTree, parameters: PyTree, state: optax.OptState, gradient: PyTree
) -> tuple[PyTree, optax.OptState]:
    """Parameters and state after a step of an optimizer with a learning rate of -1, times the traced ``rate`` of all
    parameters, or of each.
    """
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        change, state = optimizer.update(gradient, state, parameters)
    steps = jax.tree.map(lambda rate, part: jax.tree.map(lambda leaf: -rate * leaf, part), rate, change)
    return optax.apply_updates(parameters, steps), state

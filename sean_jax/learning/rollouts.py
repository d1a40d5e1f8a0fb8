"""What an agent of reinforcement learning does and sees while it learns: steps of many scenarios, and their advantages.

Source: J. Schulman et al., "High-dimensional continuous control using generalized advantage estimation", ICLR 2016.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, PyTree

from sean_jax import mdp
from sean_jax.base import Array
from sean_jax.learning.actor_critic import ActorCritic, Agent, Answer, answer, draw_action, log_density
from sean_jax.mdp import observations

TOLD = ("rewards", "completed", "episode_return", "episode_length", "start", "situations")  # of a step's info


@struct.dataclass
class Rows:
    """Scenarios that step together, between two updates, in one environment or several, of which they take turns."""

    envs: tuple[mdp.EnvState, ...]  # (B / E, ...) of the scenarios of each environment
    observation: dict[str, Array]  # (B, ...)
    memory: Float[Array, "B M"]  # of the network
    start: Bool[Array, "B"]  # whether the observation is the first of an episode


class Seen(NamedTuple):
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


def deal(tree: PyTree, number: int) -> tuple[PyTree, ...]:
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


def gather(parts: Sequence[PyTree]) -> PyTree:
    """The inverse of ``deal``.

    Args:
        parts: E times (B / E, ...).

    Returns:
        (B, ...) of all scenarios.
    """
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, 1).reshape(-1, *leaves[0].shape[1:]), *parts)


def begin(envs: tuple[mdp.Env, ...], network: ActorCritic, key: Array, number: int) -> Rows:
    """Scenarios at the start of their first episodes.

    Args:
        key: () typed PRNG key.
    """
    keys = deal(jax.random.split(key, number), len(envs))
    begun = [jax.vmap(env.reset)(own) for env, own in zip(envs, keys, strict=True)]
    shown, states = gather([shown for shown, _ in begun]), tuple(states for _, states in begun)
    return Rows(states, shown, jnp.zeros((number, network.memory_size), jnp.float32), jnp.ones(number, bool))


def vectors(terms: observations.Terms, observation: dict[str, Array]) -> Float[Array, "B F"]:
    """The numbers of observations, without images.

    Args:
        observation: (B, ...) of each term.
    """
    return jax.vmap(functools.partial(observations.flatten, terms))(observation).astype(jnp.float32)


def say(network: ActorCritic, agent: Agent, terms: observations.Terms, rows: Rows) -> Answer:
    """The answer to what many scenarios show.

    Returns:
        The answer, (B, ...).
    """
    vector, images = vectors(terms, rows.observation), _images(network, rows)
    return answer(network, agent, vector, images, rows.memory, rows.start)


def _images(network: ActorCritic, rows: Rows) -> dict[str, Array]:
    return {name: rows.observation[name].astype(network.image_dtype) for name in network.images}


def step(
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    judge: Agent,
    rows: Rows,
    said: Answer,
    action: Float[Array, "B 2"],
    key: Array,
) -> tuple[Rows, Seen]:
    """A step of all scenarios.

    Args:
        envs: what is trained on, with pools; scenarios are shared out equally.
        key: () typed PRNG key of the episodes that begin.

    Returns:
        The scenarios afterwards, and what was seen, (B, ...); its value is that of ``said``.
    """
    terms, keys = envs[0].observations, jax.random.split(key, rows.start.shape[0])
    dealt = zip(envs, deal(keys, len(envs)), rows.envs, deal(action, len(envs)), strict=True)
    stepped = [jax.vmap(env.step)(own, before, done) for env, own, before, done in dealt]
    following, reward, terminated, truncated, info = gather([(shown, *rest) for shown, _, *rest in stepped])
    states, over = tuple(each[1] for each in stepped), terminated | truncated
    ended = Rows(states, info["final_observation"], said.memory, jnp.zeros_like(over))
    seen = Seen(
        vector=vectors(terms, rows.observation),
        images=_images(network, rows),
        start=rows.start,
        action=action,
        log_density=log_density(said, action),
        value=said.value,
        reward=reward.astype(jnp.float32),
        over=over,
        final_value=jnp.where(truncated, say(network, judge, terms, ended).value, 0.0),
        told={name: info[name] for name in TOLD},
    )
    return Rows(states, following, said.memory, over), seen


def collect(
    envs: tuple[mdp.Env, ...], network: ActorCritic, agent: Agent, rows: Rows, steps: int, key: Array
) -> tuple[Rows, Seen]:
    """Let the agent drive, with the noise of its actions.

    Args:
        envs: what is trained on, with pools; scenarios are shared out equally.
        key: () typed PRNG key of the noise and of the episodes that begin.

    Returns:
        The scenarios afterwards, and (T, B) of what was seen.
    """

    def one(rows: Rows, tick: Array) -> tuple[Rows, Seen]:
        action_key, next_key = jax.random.split(jax.random.fold_in(key, tick))
        said = say(network, agent, envs[0].observations, rows)
        return step(envs, network, agent, rows, said, draw_action(said, action_key), next_key)

    return jax.lax.scan(one, rows, jnp.arange(steps, dtype=jnp.int32))


def advantages(seen: Seen, last_value: Float[Array, "B"], discount: Array, decay: Array) -> Float[Array, "T B"]:
    """Generalized advantage estimates; an episode that was truncated is worth what followed.

    Args:
        seen: (T, B) of the scenarios.
    """

    def back(carry: tuple[Array, Array], step: Seen) -> tuple[tuple[Array, Array], Array]:
        advantage, following = carry
        following = jnp.where(step.over, step.final_value, following)
        error = step.reward + discount * following - step.value
        advantage = error + jnp.where(step.over, 0.0, discount * decay) * advantage
        return (advantage, step.value), advantage

    nothing = jnp.zeros_like(last_value)
    _, found = jax.lax.scan(back, (nothing, last_value), seen._replace(vector=(), images={}, told={}), reverse=True)
    return found


def unroll(network: ActorCritic, agent: Agent, seen: Seen, memory: Float[Array, "B M"]) -> Answer:
    """Answers to observations in a row.

    Args:
        seen: (T, B) of the scenarios.

    Returns:
        The answers, (T, B, ...).
    """
    if not network.recurrent:
        empty = jnp.zeros((*seen.start.shape, 0), jnp.float32)
        return answer(network, agent, seen.vector, seen.images, empty, seen.start)

    def one(memory: Array, step: Seen) -> tuple[Array, Answer]:
        said = answer(network, agent, step.vector, step.images, memory, step.start)
        return said.memory, said

    return jax.lax.scan(one, memory, seen)[1]


def of_episodes(seen: Seen) -> dict[str, Array]:
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

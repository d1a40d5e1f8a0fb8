"""Streams of random numbers by name: every use of a seed, and every use of an episode's key, has its own stream.

In JAX ``fold_in(key, i)`` and the i-th of ``split(key, n)`` are the same key. Two uses that both number their draws
from one key would share random numbers. Here each number is a hash of a name, and is far above any count.
"""

import zlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from sean_jax.core.data_types import Array, Streams

USES = (
    "run",  # episodes of `sean run`
    "collect",  # demonstrations of `sean collect`
    "record",  # demonstrations of a learning.Recorder
    "weights",  # of a network, before it is trained
    "order",  # of the examples in an epoch
    "training",  # episodes and updates of reinforcement learning
    "imitation",  # episodes in which an agent imitates a policy, before it learns from rewards
    "curriculum",  # starts from which its episodes begin
    "evaluation",  # episodes in which an agent in training is judged
    "validation",  # the validation episodes
    "table1",  # chains of episodes
    "table1 starts",  # the pool of their starts
    "figure4",  # episodes in which its policies are measured
    "benchmark",  # episodes of `sean benchmark`
    "bench",
    "bench starts",
    "fit-graph",  # people to fit a graph to, and to judge it by
    "calibrate",  # the candidates of a fit
    "draw",  # people on a contact sheet
    "groups",  # episodes in which it is measured whether groups last
    "scene",  # the traits of people in a scene
)
"""The uses of a seed that a user gives, by name."""


TRAITS = zlib.crc32(b"traits")  # folded into the key of an episode: the traits and the first noise of people
TEAM = zlib.crc32(b"team")  # and the tasks of the robots of a team, but for the first
INTENT = zlib.crc32(b"intent")  # and the latents of their intent, and the noise of it
NOISE = zlib.crc32(b"noise")  # and the noise of people in its steps


def stream_id(use: str) -> int:
    """The number of 32 bits of a use, one of ``USES``; ValueError for another."""
    if use not in USES:
        raise ValueError(f"use: '{use}' is not one of {', '.join(USES)}.")
    return zlib.crc32(use.encode())


def key(use: str, seed: int | Array) -> Array:
    """The () typed key of a use, one of ``USES``; the key of its episode ``i``, if any, is ``fold_in(key, i)``."""
    return jax.random.fold_in(jax.random.key(seed), jnp.uint32(stream_id(use)))


def generator(use: str, seed: int, *further: int) -> np.random.Generator:
    """The numpy generator of a use, one of ``USES``; further numbers, such as an epoch, have separate streams."""
    return np.random.default_rng((stream_id(use), len(further), seed, *further))  # numpy takes (1, 0) for (1,)


def streams(key: Array) -> Streams:
    """The streams of an episode, from a () typed key that is used for nothing else."""
    return Streams(*jax.random.split(key, 4), noise=jax.random.fold_in(key, NOISE))


def typed(key: Array) -> Array:
    """A key as a typed one: those of ``jax.random.PRNGKey`` are numbers, and mean the same as ``jax.random.key``."""
    return key if _is_key(key) else jax.random.wrap_key_data(key)


def as_numbers(tree: PyTree) -> PyTree:
    """A tree with uint32 in place of its typed keys, which files and quick calls can hold."""
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if _is_key(leaf) else leaf, tree)


def as_keys(tree: PyTree, like: PyTree) -> PyTree:
    """The inverse of ``as_numbers``: the tree with keys where ``like``, of the same structure, has them."""
    return jax.tree.map(lambda leaf, one: jax.random.wrap_key_data(leaf) if _is_key(one) else leaf, tree, like)


def _is_key(leaf: Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)

"""Chance by name: every use of a seed, and every use of an episode's key, has a stream of its own.

``fold_in(key, i)`` and the i-th of ``split(key, n)`` are the same key in JAX. So two uses that both number what they
draw from one key share their chance; each number here stands for a name, and is far above any count.
"""

import zlib

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Array, Streams

USES = (
    "run",  # episodes of `sean run`
    "collect",  # demonstrations of `sean collect`
    "record",  # demonstrations of a learning.Recorder
    "weights",  # of a network, before it is trained
    "order",  # of the examples in an epoch
    "validation",  # which episodes are held out
    "table1",  # chains of episodes
    "table1 starts",  # what they restart from
    "figure4",  # episodes in which its drivers are measured
    "bench",
    "bench starts",
    "draw",  # what a sheet shows
)
"""Whatever draws from a seed of the user's, by name."""


def number(use: str) -> int:
    """What stands for a use; ValueError if there is none of that name."""
    if use not in USES:
        raise ValueError(f"use: '{use}' is not one of {', '.join(USES)}.")
    return zlib.crc32(use.encode())


def key(use: str, seed: int | Array) -> Array:
    """() typed PRNG key of a use; its i-th episode, if it has some, is that of ``fold_in(key(use, seed), i)``."""
    return jax.random.fold_in(jax.random.key(seed), jnp.uint32(number(use)))


def generator(use: str, seed: int, *further: int) -> np.random.Generator:
    """Likewise for numpy; ``further`` numbers, such as that of an epoch, have streams of their own."""
    return np.random.default_rng((number(use), len(further), seed, *further))  # numpy takes (1, 0) for (1,)


def streams(key: Array) -> Streams:
    """The streams of an episode, of a () typed PRNG key that is used for nothing else."""
    return Streams(*jax.random.split(key, 4))

"""Interfaces of other projects to the same environments: Gymnasium, gymnax, Brax, each imported when asked for."""

from collections.abc import Hashable

import jax

from sean_jax import mdp, prng
from sean_jax.versions import fingerprint

NAMESPACE = "sean"
"""What stands before the names of ``registry.ALL_ENVS`` in other projects' registries."""


def identity(env: mdp.Env) -> Hashable:
    """A hashable value that is equal for environments of the same parts and numbers, and for no others."""
    return jax.tree.structure(env), fingerprint(prng.as_numbers(env))

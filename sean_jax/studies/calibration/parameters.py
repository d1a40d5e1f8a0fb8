"""Which constants of the social forces are fitted, and between which bounds: a table.

A constant is fitted on a scale where every real number is allowed: its logarithm, or the constant itself where the
lower bound is zero, is squeezed between the bounds by a logistic curve. So it stays positive and within reason.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.errors import InputError
from sean_jax.files import unknown_name
from sean_jax.social_forces import Forces
from sean_jax.social_forces.forces import term_name

BOUNDS: dict[str, tuple[float, float]] = {
    "walking.relaxation_time": (0.1, 1.0),  # s; measured starts and stops take .2 to .6
    "repulsion.strength": (0.1, 20.0),  # m/s2
    "repulsion.range": (0.05, 0.6),  # m
    "repulsion.anticipation": (0.0, 3.0),  # s
    "repulsion.back_weight": (0.0, 1.0),
    "headway.length": (-0.5, 0.4),  # m; below zero there is some way yet to go when bodies touch
    "headway.range": (0.05, 3.0),  # m
    "headway.width": (0.1, 0.6),  # m
    "evasion.strength": (0.1, 8.0),  # m/s2
    "evasion.gain": (0.1, 12.0),
    "evasion.horizon": (0.5, 6.0),  # s
    "evasion.width": (0.3, 2.0),  # m
    "sidestep.preference": (0.0, 0.5),  # m/s2
    "walls.strength": (0.1, 20.0),  # m/s2
    "walls.range": (0.03, 0.5),  # m
}
"""term.parameter -> the least and the greatest value; those whose term a model lacks are left out"""

INERT = {"circular": {"repulsion.anticipation", "repulsion.own_motion"}}
"""name of a law of repulsion -> parameters that it does not read"""

EDGE = 1e-3  # share of the scale, next to a bound, in which no fit starts


def names_of(forces: Forces, chosen: Sequence[str] = ()) -> list[str]:
    """The parameters to be fitted.

    Args:
        chosen: names of ``BOUNDS``; all that the forces have and read if empty.

    Raises:
        InputError: a name is not in the table, or the forces have no such term.
    """
    there = {term_name(term): term for term in forces}
    law = getattr(getattr(there.get("repulsion"), "law", None), "__name__", "")
    for name in chosen:
        if name not in BOUNDS:
            raise InputError(unknown_name("fit", name, BOUNDS))
        if name.partition(".")[0] not in there:
            raise InputError(f"fit: the forces have no {name}; there are the terms {', '.join(sorted(there))}.")
    usual = [name for name in BOUNDS if name.partition(".")[0] in there and name not in INERT.get(law, ())]
    return [name for name in BOUNDS if name in chosen] if chosen else usual


def values_of(forces: Forces, names: Sequence[str]) -> Float[Array, "P"]:
    """The parameters of forces.

    Returns:
        (P,) each in its unit.
    """
    return jnp.stack([jnp.asarray(getattr(getattr(forces, a), b), float) for a, b in _split(names)])


def with_values(forces: Forces, names: Sequence[str], values: Float[Array, "P"]) -> Forces:
    """Forces with other parameters, which may be traced.

    Args:
        values: (P,) each in its unit.
    """
    return forces.tree_replace({name: values[index] for index, name in enumerate(names)})


def to_free(names: Sequence[str], values: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
    """Parameters as numbers that may be anything; those outside of their bounds are moved to them first.

    Args:
        values: (..., P) each in its unit.
    """
    low, high, logarithmic = _scales(names, values.ndim)
    safe = jnp.where(logarithmic, low, 1.0)
    by_logarithm = jnp.log(jnp.maximum(values, 1e-9) / safe) / jnp.log(jnp.where(logarithmic, high / safe, 2.0))
    share = jnp.where(logarithmic, by_logarithm, (values - low) / (high - low))
    share = jnp.clip(share, EDGE, 1.0 - EDGE)
    return jnp.log(share) - jnp.log1p(-share)


def from_free(names: Sequence[str], free: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
    """The inverse of ``to_free``.

    Returns:
        (..., P) each in its unit, within its bounds.
    """
    low, high, logarithmic = _scales(names, free.ndim)
    share = jax.nn.sigmoid(free)
    ratio = jnp.where(logarithmic, high / jnp.where(logarithmic, low, 1.0), 1.0)
    return jnp.where(logarithmic, low * ratio**share, low + (high - low) * share)


def _scales(names: Sequence[str], ndim: int) -> tuple[Array, Array, Array]:
    """Bounds (1, ..., P), and whether the scale is that of the logarithm."""
    bounds = np.array([BOUNDS[name] for name in names]).T.reshape((2,) + (1,) * (ndim - 1) + (-1,))
    return jnp.asarray(bounds[0], float), jnp.asarray(bounds[1], float), jnp.asarray(bounds[0] > 0.0)


def _split(names: Sequence[str]) -> list[tuple[str, str]]:
    return [(name.partition(".")[0], name.partition(".")[2]) for name in names]

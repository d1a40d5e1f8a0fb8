"""Costs with a limit: what may happen at most so often a minute, apart from the reward.

A cost is a term of the reward whose weight is minus its multiplier. The multiplier grows while the measured rate is
above the limit and falls while it is below, so the agent seeks the greatest reward within the limit. The critic values
the penalized reward, the simplest form of PPO-Lagrangian.

Source: A. Stooke, J. Achiam & P. Abbeel, "Responsive safety in reinforcement learning by PID Lagrangian methods", ICML
2020; here of the logarithm, so a multiplier stays positive and its steps are shares of it.
"""

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float

from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.mdp import rewards

LEAST, GREATEST = 1e-3, 1e3  # of a multiplier
INTEGRAL, PROPORTIONAL = 0.05, 0.2  # of the logarithm, for an excess as large as the limit
FRESH = 0.1  # share of an update's rate in the smoothed one
MAX_EXCESS = 5.0  # times the limit
PENALTY = 100.0  # of an excess as large as the limit, in comparing agents


@struct.dataclass
class Multiplier:
    """The state of a cost between updates, for each agent. Checkpoints have these field names."""

    log: Float[Array, "A"]  # its integral part
    rate: Float[Array, "A"]  # per minute, smoothed


Multipliers = dict[str, Multiplier]
"""Cost -> its multiplier."""


def with_costs(terms: rewards.Terms, limits: Mapping[str, float]) -> rewards.Terms:
    """The terms of a reward, and the costs as terms with the weights they had, or else -1.

    Raises:
        InputError: there is no such term, or it is a potential.
    """
    known = dict(terms)
    for name in limits:
        if name not in known and name not in rewards.REWARDS:
            raise InputError(files.unknown_name("costs", name, known | rewards.REWARDS))
        term = known.get(name) or rewards.REWARDS[name]
        if term.step is None:
            raise InputError(f"costs: {name} is a potential, which has no rate; choose a term of each step.")
        known[name] = dataclasses.replace(term, weight=-abs(float(term.weight)) or -1.0)
    return tuple(known.items())


def init(terms: rewards.Terms, limits: Mapping[str, float], agents: int) -> Multipliers | None:
    """Multipliers before the first update, from the weights of ``with_costs``; None without costs."""
    known = dict(terms)
    multipliers = {}
    for name, limit in limits.items():
        log = jnp.full(agents, np.log(-known[name].weight), jnp.float32)
        rate = jnp.full(agents, limit, jnp.float32)
        multipliers[name] = Multiplier(log, rate)
    return multipliers or None


def value(multiplier: Multiplier, limit: float) -> Float[Array, "A"]:
    """The multiplier: its integral part, and one in proportion to the excess, which damps its oscillation."""
    return jnp.exp(multiplier.log + PROPORTIONAL * _excess(multiplier.rate, limit))


def weights(multipliers: Multipliers | None, limits: Mapping[str, float]) -> dict[str, Float[Array, "A"]]:
    """Cost -> its weight in the reward."""
    return {name: -value(each, limits[name]) for name, each in (multipliers or {}).items()}


def update(multiplier: Multiplier, rate: Float[Array, "A"], limit: float) -> Multiplier:
    """The multiplier after an update with that rate per minute."""
    smooth = multiplier.rate + FRESH * (rate - multiplier.rate)
    log = multiplier.log + INTEGRAL * _excess(smooth, limit)
    return Multiplier(jnp.clip(log, np.log(LEAST), np.log(GREATEST)), smooth)


def follow(
    multipliers: Multipliers | None, limits: Mapping[str, float], parts: Mapping[str, Array], time_step: float
) -> tuple[Multipliers | None, dict[str, dict[str, Array]]]:
    """The multipliers after an update, and numbers for the log: rates per minute, and multipliers.

    Args:
        parts: name -> mean of the weighted term in a step.
        time_step: s.
    """
    if multipliers is None:
        return None, {}
    now = weights(multipliers, limits)
    rates = {name: parts[name] / now[name] * (60.0 / time_step) for name in multipliers}
    after = {name: update(each, rates[name], limits[name]) for name, each in multipliers.items()}
    return after, {"costs": rates, "multipliers": jax.tree.map(jnp.negative, now)}


def penalty(rates: Mapping[str, Array], limits: Mapping[str, float]) -> Array:
    """How much worse than its return an agent is with these rates per minute; 0 within all limits."""
    return PENALTY * sum((jnp.maximum(rates[name] / limit - 1.0, 0.0) for name, limit in limits.items()), jnp.zeros(()))


def _excess(rate: Array, limit: float) -> Array:
    return jnp.clip(rate / limit - 1.0, -1.0, MAX_EXCESS)

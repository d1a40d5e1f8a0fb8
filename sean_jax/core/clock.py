"""Time in ticks, whole numbers of steps. A sum of seconds is rounded at each step, and may end a step early or late."""

import math
from fractions import Fraction

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array

ROUNDING = 4.0  # units in the last place by which a quotient of two rounded times may miss a whole number


def ceil_ticks(duration: float, time_step: float) -> int:
    """The smallest number of time steps that last for a duration [s]; both are known when a program is traced."""
    return math.ceil(duration / time_step * (1.0 - 1e-12))


def to_ticks(duration: Float[Array, "*shape"], time_step: float) -> Float[Array, "*shape"]:
    """Durations [s] in time steps [s], rounded to a whole number where they differ from one by rounding only."""
    exact = duration / time_step
    whole = jnp.round(exact)
    error = jnp.abs(exact - whole)
    return jnp.where(error <= ROUNDING * jnp.finfo(exact.dtype).eps * whole, whole, exact)


def events_per_tick(time_step: float, rate: float = 1.0) -> tuple[int, int]:
    """Events (``rate`` [1/s]) in one time step [s] as a fraction of small whole numbers: products with ticks are exact.

    Raises:
        ValueError: there is less than one event in 1000 steps, which such a fraction cannot represent.
    """
    share = time_step * rate
    if not share >= 0.001 * (1.0 - 1e-9):
        raise ValueError(
            f"rate: {rate:g} times a second is less than once in 1000 steps of {time_step:g} s; give a greater rate."
        )
    fraction = Fraction(share).limit_denominator(1000)
    return fraction.numerator, fraction.denominator

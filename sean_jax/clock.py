"""Time is counted in ticks: a sum of steps is rounded at each of them, and would end a hold a step late or early."""

import math
from fractions import Fraction

import jax.numpy as jnp

from sean_jax.base import Array

ROUNDED = 4.0  # units in the last place by which a quotient of two rounded times may be off a whole number


def ticks(duration: float, time_step: float) -> int:
    """The least number of time steps [s] that last for a duration [s]; both are known when a program is traced."""
    return math.ceil(duration / time_step * (1.0 - 1e-12))


def in_ticks(duration: Array, time_step: float) -> Array:
    """Durations [s] of any shape in time steps [s]: whole numbers where they are that but for rounding."""
    exact = duration / time_step
    whole = jnp.round(exact)
    return jnp.where(jnp.abs(exact - whole) <= ROUNDED * jnp.finfo(exact.dtype).eps * whole, whole, exact)


def per_tick(time_step: float, rate: float = 1.0) -> tuple[int, int]:
    """How often what happens ``rate`` [1/s] times does so in a time step [s], as a fraction of small whole numbers.

    Their products with ticks are exact, however long it runs. Raises ValueError for less than once in 1000 steps, which
    such a fraction does not meet.
    """
    share = time_step * rate
    if not share >= 0.001 * (1.0 - 1e-9):
        raise ValueError(
            f"rate: {rate:g} times a second is less than once in 1000 steps of {time_step:g} s; give a greater rate."
        )
    fraction = Fraction(share).limit_denominator(1000)
    return fraction.numerator, fraction.denominator

"""What a metric is (section IV-H): a value folded over the moments of a robot's task, in constant memory."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from sean_jax.base import Array, Moment

NEVER = 1e6  # more than any distance or time that is measured


class Metric(NamedTuple):
    """A streaming metric.

    ``start(moment) -> value`` a pytree; ``fold(value, before, after) -> value`` one step later;
    ``result(value) -> array``: () or, where it can be split by situation, (1 + S,), overall first. A mean or an
    extreme over a situation that never occurred is NaN there, since no number would be true; sums are zero.
    """

    start: Callable[[Moment], Any]
    fold: Callable[[Any, Moment, Moment], Any]
    result: Callable[[Any], Array]
    unit: str


def split(moment: Moment) -> Array:
    """(1 + S,) float32 weights by which an amount counts overall and for each situation that occurs now."""
    return jnp.concatenate([jnp.ones(1, jnp.float32), moment.situations.astype(jnp.float32)])


def by_second(moment: Moment) -> Array:
    """() bool: a whole second has passed, when SEAN samples its path metrics."""
    ticks = max(1, round(1.0 / moment.time_step))
    return moment.tick % ticks == 0


def mean(amount: Array, weight: Array) -> Array:
    """(1 + S,) ``amount / weight``: 0 overall as long as there is nothing, NaN for situations that did not occur."""
    none = weight == 0.0
    ratio = jnp.where(none, 0.0, amount / jnp.where(none, 1.0, weight))
    return jnp.concatenate([ratio[:1], jnp.where(none[1:], jnp.nan, ratio[1:])])


def least(value: Array, amount: Array, moment: Moment) -> Array:
    """(1 + S,) the least amount overall and in each situation so far, of values that start as ``never``."""
    return jnp.minimum(value, jnp.where(split(moment) > 0.0, amount, NEVER))


def never(moment: Moment) -> Array:
    """(1 + S,) of a number that stands for no amount, and is finite as everything in a state is."""
    return jnp.full_like(split(moment), NEVER)


def nan_if_never(value: Array) -> Array:
    """(1 + S,) with NaN where there was no amount."""
    return jnp.where(value < NEVER, value, jnp.nan)


def nothing(moment: Moment) -> Array:
    """(1 + S,) zeros."""
    return jnp.zeros_like(split(moment))


def value_itself(value: Array) -> Array:
    """The running value as it stands."""
    return value

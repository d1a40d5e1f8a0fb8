"""What a metric is (section IV-H): a value folded over the moments of a robot's task, in constant memory."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from sean_jax.base import Array, Moment


class Metric(NamedTuple):
    """A streaming metric.

    ``start(moment) -> value`` a pytree; ``fold(value, before, after) -> value`` one step later;
    ``result(value) -> array``: () or, where it can be split by situation, (1 + S,), overall first.
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


def nothing(moment: Moment) -> Array:
    """(1 + S,) zeros."""
    return jnp.zeros_like(split(moment))


def value_itself(value: Array) -> Array:
    """The running value as it stands."""
    return value

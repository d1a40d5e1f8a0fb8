"""What a metric is (section IV-H): a value folded over the moments of a robot's task, in constant memory."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from sean_jax import clock
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
    """(1 + S,) weights by which an amount counts overall and for each situation that occurs now."""
    return jnp.concatenate([jnp.ones(1, float), moment.situations.astype(float)])


class Duration(NamedTuple):
    """A time as a number of steps: a sum of rounded steps would drift."""

    steps: Array  # (1 + S,)
    step: Array  # () s


def no_time(moment: Moment) -> Duration:
    """None so far."""
    return Duration(nothing(moment), jnp.asarray(moment.time_step, float))


def seconds(value: Duration) -> Array:
    """(1 + S,) s."""
    return value.steps * value.step


def by_second(moment: Moment) -> Array:
    """() bool: a whole second has passed within the last step, when SEAN samples its path metrics.

    At 0.1 s that is every tenth tick; at 0.15 s the ticks 7, 14, 20, 27, ... of 1.05, 2.1, 3.0, 4.05 s.
    """
    return _seconds(moment, moment.tick) > _seconds(moment, moment.tick - 1)


def since_second(moment: Moment) -> Array:
    """() s since the last sample before this tick: 1 where seconds are whole steps, else about that."""
    over, under = clock.per_tick(moment.time_step)
    sampled = -((-_seconds(moment, moment.tick - 1) * under) // over)  # the first tick at or after that second
    return (moment.tick - sampled).astype(float) * moment.time_step


def _seconds(moment: Moment, tick: Array) -> Array:
    """() int32 whole seconds that have passed at a tick, exact: a product in float32 would miss some."""
    over, under = clock.per_tick(moment.time_step)
    return tick * over // under


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

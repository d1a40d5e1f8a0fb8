"""Metrics of smoothness (section IV-H): speed, acceleration and jerk, from differences of the robot's velocity."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from sean_jax.base import Array, Moment
from sean_jax.geometry import length
from sean_jax.metrics.metric import Metric, mean, nothing, split, value_itself


class Average(NamedTuple):
    """A sum over steps, how many they are, and the acceleration in the last of them."""

    amount: Array  # (1 + S,)
    steps: Array  # (1 + S,)
    acceleration: Array  # (2,) m/s2
    known: Array  # () 1 once there is an acceleration, else 0


class Greatest(NamedTuple):
    """The greatest so far, and the acceleration in the last step."""

    amount: Array  # ()
    acceleration: Array  # (2,) m/s2
    known: Array  # () 1 once there is an acceleration, else 0


def _acceleration(before: Moment, after: Moment) -> Array:
    return (after.velocity - before.velocity) / after.time_step


def _speed(before: Moment, after: Moment, last: Array, known: Array) -> tuple[Array, Array]:
    return length(after.velocity[0], after.velocity[1]), jnp.ones_like(known)


def _acceleration_size(before: Moment, after: Moment, last: Array, known: Array) -> tuple[Array, Array]:
    now = _acceleration(before, after)
    return length(now[0], now[1]), jnp.ones_like(known)


def _jerk_size(before: Moment, after: Moment, last: Array, known: Array) -> tuple[Array, Array]:
    change = (_acceleration(before, after) - last) / after.time_step
    return known * length(change[0], change[1]), known


def _average(quantity: Callable, unit: str) -> Metric:
    def start(moment: Moment) -> Average:
        none = nothing(moment)
        return Average(none, none, jnp.zeros_like(moment.velocity), jnp.zeros_like(moment.geodesic))

    def fold(value: Average, before: Moment, after: Moment) -> Average:
        size, counts = quantity(before, after, value.acceleration, value.known)
        return Average(
            amount=value.amount + size * split(after),
            steps=value.steps + counts * split(after),
            acceleration=_acceleration(before, after),
            known=jnp.ones_like(value.known),
        )

    return Metric(start, fold, lambda value: mean(value.amount, value.steps), unit)


def _greatest(quantity: Callable, unit: str) -> Metric:
    def start(moment: Moment) -> Greatest:
        zero = jnp.zeros_like(moment.geodesic)
        return Greatest(zero, jnp.zeros_like(moment.velocity), zero)

    def fold(value: Greatest, before: Moment, after: Moment) -> Greatest:
        size, _ = quantity(before, after, value.acceleration, value.known)
        return Greatest(jnp.maximum(value.amount, size), _acceleration(before, after), jnp.ones_like(value.known))

    return Metric(start, fold, lambda value: value_itself(value.amount), unit)


mean_speed = _average(_speed, "m/s")
"""Mean of |v| over the steps."""

mean_acceleration = _average(_acceleration_size, "m/s2")
"""Mean of |v_k+1 - v_k| / dt over the steps: of the velocity vector, so that curves count."""

mean_jerk = _average(_jerk_size, "m/s3")
"""Mean of |a_k+1 - a_k| / dt over the steps from the second on, a as in ``mean_acceleration``."""

max_speed = _greatest(_speed, "m/s")
"""Greatest |v|."""

max_acceleration = _greatest(_acceleration_size, "m/s2")
"""Greatest |v_k+1 - v_k| / dt."""

max_jerk = _greatest(_jerk_size, "m/s3")
"""Greatest |a_k+1 - a_k| / dt."""

"""Metrics of smoothness (section IV-H): speed, acceleration and jerk, from differences of the robot's velocity."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, Moment
from sean_jax.geometry import length
from sean_jax.metrics.metric import Metric, Ratio, mean, ratio, situation_weights, zero_ratio


class MeanJerk(NamedTuple):
    """The sum of the jerk and its steps, and the acceleration in the last step."""

    jerk: Ratio
    acceleration: Float[Array, "2"]  # m/s2
    known: Float[Array, ""]  # 1 once there is an acceleration, else 0


class Maximum(NamedTuple):
    """The maximum so far, and the acceleration in the last step."""

    amount: Float[Array, ""]
    acceleration: Float[Array, "2"]  # m/s2
    known: Float[Array, ""]  # 1 once there is an acceleration, else 0


def _acceleration(before: Moment, after: Moment) -> Array:
    return (after.velocity - before.velocity) / after.time_step


def _speed(before: Moment, after: Moment) -> Array:
    return length(after.velocity[0], after.velocity[1])


def _acceleration_size(before: Moment, after: Moment) -> Array:
    now = _acceleration(before, after)
    return length(now[0], now[1])


def _jerk_size(before: Moment, after: Moment, value: MeanJerk | Maximum) -> Array:
    """0 in the first step, before which no acceleration is known."""
    change = (_acceleration(before, after) - value.acceleration) / after.time_step
    return value.known * length(change[0], change[1])


def _init_mean_jerk(moment: Moment) -> MeanJerk:
    return MeanJerk(zero_ratio(moment), jnp.zeros_like(moment.velocity), jnp.zeros_like(moment.geodesic))


def _update_mean_jerk(value: MeanJerk, before: Moment, after: Moment) -> MeanJerk:
    weights = situation_weights(after)
    return MeanJerk(
        jerk=Ratio(
            value.jerk.amount + _jerk_size(before, after, value) * weights, value.jerk.weight + value.known * weights
        ),
        acceleration=_acceleration(before, after),
        known=jnp.ones_like(value.known),
    )


def _maximum(size: Callable, unit: str, title: str, definition: str) -> Metric:
    """Of ``size(before, after, value)`` over the steps."""

    def init(moment: Moment) -> Maximum:
        zero = jnp.zeros_like(moment.geodesic)
        return Maximum(zero, jnp.zeros_like(moment.velocity), zero)

    def update(value: Maximum, before: Moment, after: Moment) -> Maximum:
        now = size(before, after, value)
        return Maximum(jnp.maximum(value.amount, now), _acceleration(before, after), jnp.ones_like(value.known))

    return Metric(init, update, lambda value: value.amount, unit, title, definition, headline=False)


mean_speed = mean(_speed, unit="m/s", title="mean speed", definition="Mean speed of the robot.", headline=False)
"""Mean of |v| over the steps."""

mean_acceleration = mean(
    _acceleration_size,
    unit="m/s2",
    title="mean acceleration",
    definition="Mean acceleration of the robot, of its velocity vector, so that curves count.",
    headline=False,
)
"""Mean of |v_k+1 - v_k| / dt over the steps: of the velocity vector, so that curves count."""

mean_jerk = Metric(
    _init_mean_jerk,
    _update_mean_jerk,
    lambda value: ratio(value.jerk),
    unit="m/s3",
    title="mean jerk",
    definition="Mean rate of change of the robot's acceleration.",
    headline=False,
)
"""Mean of |a_k+1 - a_k| / dt over the steps from the second on, a as in ``mean_acceleration``."""

max_speed = _maximum(
    lambda before, after, value: _speed(before, after), "m/s", "maximum speed", "Maximum speed of the robot."
)
"""Greatest |v| over the steps."""

max_acceleration = _maximum(
    lambda before, after, value: _acceleration_size(before, after),
    "m/s2",
    "maximum acceleration",
    "Maximum acceleration of the robot, of its velocity vector.",
)
"""Greatest |v_k+1 - v_k| / dt."""

max_jerk = _maximum(_jerk_size, "m/s3", "maximum jerk", "Maximum rate of change of the robot's acceleration.")
"""Greatest |a_k+1 - a_k| / dt."""

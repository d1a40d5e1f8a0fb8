"""Metrics of the robot's path (section IV-H): length, efficiency, irregularity, time not moving, distance to goal."""

from typing import NamedTuple

import jax.numpy as jnp

from sean_jax.base import Array, Moment
from sean_jax.geometry import angle_between, length
from sean_jax.metrics.metric import Metric, by_second, no_time, nothing, seconds, since_second, split, value_itself

STILL = 0.05  # m/s: not moving is having moved no farther than 0.05 m in the last second (SEAN 2.0)


class Sampled(NamedTuple):
    """A sum over whole seconds, and where the robot was at the last of them."""

    position: Array  # (2,) m
    amount: Array  # (1 + S,)
    since: Array  # (1 + S,) m moved since then
    geodesic: Array  # () m


def _start(moment: Moment) -> Sampled:
    return Sampled(moment.position, nothing(moment), nothing(moment), moment.geodesic)


def _sample(value: Sampled, after: Moment, moved: Array, amount: Array) -> Sampled:
    now = by_second(after)
    return value._replace(
        position=jnp.where(now, after.position, value.position),
        amount=value.amount + jnp.where(now, amount, 0.0) * split(after),
        since=jnp.where(now, 0.0, moved) * split(after),
    )


def _moved(value: Sampled, after: Moment) -> Array:
    gap = after.position - value.position
    return length(gap[0], gap[1])


def _fold_length(value: Sampled, before: Moment, after: Moment) -> Sampled:
    moved = _moved(value, after)
    return _sample(value, after, moved, moved)


def _length(value: Sampled) -> Array:
    return value.amount + value.since


def _efficiency(value: Sampled) -> Array:
    return _length(value)[0] / jnp.maximum(value.geodesic, 1e-3)


def _fold_still(value: Sampled, before: Moment, after: Moment) -> Sampled:
    moved, passed = _moved(value, after), since_second(after)
    return _sample(value, after, moved, jnp.where(moved <= STILL * passed, passed, 0.0))


def _still(value: Sampled) -> Array:
    return value.amount


class Turned(NamedTuple):
    """How much the robot has turned by whole seconds, and how much its shortest path does."""

    heading: Array  # (2,) unit vector, at the last whole second
    amount: Array  # () rad
    since: Array  # () rad turned since then
    shortest: Array  # () rad


def _start_turned(moment: Moment) -> Turned:
    zero = jnp.zeros_like(moment.geodesic)
    straight = jnp.abs(angle_between(moment.heading, moment.goal - moment.position))
    return Turned(moment.heading, zero, zero, straight if moment.turning is None else moment.turning)


def _fold_turned(value: Turned, before: Moment, after: Moment) -> Turned:
    now = by_second(after)
    turned = jnp.abs(angle_between(value.heading, after.heading))
    return value._replace(
        heading=jnp.where(now, after.heading, value.heading),
        amount=value.amount + jnp.where(now, turned, 0.0),
        since=jnp.where(now, 0.0, turned),
    )


def _irregularity(value: Turned) -> Array:
    return jnp.maximum(value.amount + value.since - value.shortest, 0.0)


def _to_goal(moment: Moment) -> Array:
    gap = moment.goal - moment.position
    return length(gap[0], gap[1])


path_length = Metric(_start, _fold_length, _length, "m")
"""Length of the path through the robot's positions at 1 Hz, ||p_i+1 - p_i|| summed."""

path_efficiency = Metric(_start, _fold_length, _efficiency, "1")
"""Travelled over geodesic distance of the shortest path from start to goal: at least about 1, lower is better."""

path_irregularity = Metric(_start_turned, _fold_turned, _irregularity, "rad")
"""Rotation, left and right added up, in excess of that on the shortest path from the starting pose, at least 0.

Sum of |angle from heading i to i + 1| at 1 Hz, minus ``Moment.turning``, or minus the angle to the goal where no
shortest path is known.
"""

time_not_moving = Metric(_start, _fold_still, _still, "s")
"""Time of the seconds in which the robot moved no farther than 0.05 m.

Where seconds are no whole number of steps, those from one sample to the next count with the time they took.
"""

min_distance_to_goal = Metric(
    _to_goal, lambda value, before, after: jnp.minimum(value, _to_goal(after)), value_itself, "m"
)
"""Least distance to the goal in a straight line."""

final_distance_to_goal = Metric(_to_goal, lambda value, before, after: _to_goal(after), value_itself, "m")
"""Last distance to the goal in a straight line."""

time_in_situation = Metric(
    no_time, lambda value, before, after: value._replace(steps=value.steps + split(after)), seconds, "s"
)
"""Seconds of the episode, and those spent in each situation."""

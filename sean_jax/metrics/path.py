"""Metrics of the robot's path and success (section IV-H): length, rotation, standing, goal, SPL, STL, smoothness."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Snapshot
from sean_jax.core.geometry import angle_between, length
from sean_jax.metrics.metric import (
    Duration,
    Metric,
    Ratio,
    duration,
    final,
    identity,
    in_seconds,
    mean,
    minimum,
    ratio,
    second_has_passed,
    situation_weights,
    time_since_sample,
    zero_duration,
    zero_ratio,
    zeros,
)

STILL = 0.05  # m/s: not moving is having moved no farther than 0.05 m in the last second (SEAN 2.0)
GOAL_RADIUS = 1.2  # m, for snapshots that have none (SEAN 2.0)
TOP_SPEED = 0.5  # m/s, for snapshots that have none (Kuri)


# --- length, efficiency and standing, from positions at 1 Hz ---


class SampledPath(NamedTuple):
    """A sum over whole seconds, and where the robot was at the last of them."""

    position: Float[Array, "2"]  # m
    amount: Float[Array, " columns"]
    since: Float[Array, " columns"]  # m moved since then
    geodesic: Float[Array, ""]  # m


def _init_path(snapshot: Snapshot) -> SampledPath:
    return SampledPath(snapshot.position, zeros(snapshot), zeros(snapshot), snapshot.geodesic)


def _sample(value: SampledPath, after: Snapshot, moved: Array, amount: Array) -> SampledPath:
    now = second_has_passed(after)
    return value._replace(
        position=jnp.where(now, after.position, value.position),
        amount=value.amount + jnp.where(now, amount, 0.0) * situation_weights(after),
        since=jnp.where(now, 0.0, moved) * situation_weights(after),
    )


def _moved(value: SampledPath, after: Snapshot) -> Array:
    gap = after.position - value.position
    return length(gap[0], gap[1])


def _update_length(value: SampledPath, before: Snapshot, after: Snapshot) -> SampledPath:
    moved = _moved(value, after)
    return _sample(value, after, moved, moved)


def _length(value: SampledPath) -> Array:
    return value.amount + value.since


def _efficiency(value: SampledPath) -> Array:
    return _length(value)[0] / jnp.maximum(value.geodesic, 1e-3)


def _update_still(value: SampledPath, before: Snapshot, after: Snapshot) -> SampledPath:
    moved = _moved(value, after)
    passed = time_since_sample(after)
    return _sample(value, after, moved, jnp.where(moved <= STILL * passed, passed, 0.0))


path_length = Metric(_init_path, _update_length, _length)
"""Length of the path through the robot's positions at 1 Hz, ||p_i+1 - p_i|| summed."""

path_efficiency = Metric(_init_path, _update_length, _efficiency)
"""Travelled over geodesic distance of the shortest path from start to goal, to the goal's centre as in the paper.

The goal counts as reached at the goal radius, so a robot that stops there has less than 1, which is not better than 1.
"""

time_not_moving = Metric(_init_path, _update_still, lambda value: value.amount)
"""Time of the seconds in which the robot moved no farther than 0.05 m.

Where seconds are no whole number of steps, the steps from one sample to the next count with their own time.
"""


# --- irregularity, from headings at 1 Hz ---


class SampledRotation(NamedTuple):
    """Rotation of the robot at whole seconds, and rotation of its shortest path."""

    heading: Float[Array, "2"]  # unit vector, at the last whole second
    amount: Float[Array, ""]  # rad
    since: Float[Array, ""]  # rad turned since then
    shortest: Float[Array, ""]  # rad


def _init_rotation(snapshot: Snapshot) -> SampledRotation:
    zero = jnp.zeros_like(snapshot.geodesic)
    straight = jnp.abs(angle_between(snapshot.heading, snapshot.goal - snapshot.position))
    return SampledRotation(
        snapshot.heading, zero, zero, straight if snapshot.path_rotation is None else snapshot.path_rotation
    )


def _update_rotation(value: SampledRotation, before: Snapshot, after: Snapshot) -> SampledRotation:
    now = second_has_passed(after)
    turned = jnp.abs(angle_between(value.heading, after.heading))
    return value._replace(
        heading=jnp.where(now, after.heading, value.heading),
        amount=value.amount + jnp.where(now, turned, 0.0),
        since=jnp.where(now, 0.0, turned),
    )


def _irregularity(value: SampledRotation) -> Array:
    return jnp.maximum(value.amount + value.since - value.shortest, 0.0)


path_irregularity = Metric(_init_rotation, _update_rotation, _irregularity)
"""Rotation, left and right added up, in excess of that on the shortest path from the starting pose, at least 0.

Sum of |angle from heading i to i + 1| at 1 Hz, minus ``Snapshot.path_rotation``, or the angle to the goal where no
shortest path is known.
"""


# --- the goal ---


def _distance_to_goal(snapshot: Snapshot) -> Array:
    gap = snapshot.goal - snapshot.position
    return length(gap[0], gap[1])


def _goal_radius(snapshot: Snapshot) -> Array | float:
    return GOAL_RADIUS if snapshot.goal_radius is None else snapshot.goal_radius


def _at_goal(snapshot: Snapshot) -> Array:
    """1 inside the goal radius, else 0."""
    inside = _distance_to_goal(snapshot) <= _goal_radius(snapshot)
    return jnp.where(inside, jnp.ones_like(snapshot.geodesic), 0.0)


def _always(snapshot: Snapshot) -> Array:
    return jnp.ones((), bool)


min_distance_to_goal = minimum(_distance_to_goal, by_situation=False)
"""Minimum distance to the goal in a straight line."""

final_distance_to_goal = final(_distance_to_goal)
"""Last distance to the goal in a straight line."""

time_in_situation = duration(_always)
"""Seconds of the episode and in each situation, from which the table makes shares of robot time."""

reached_goal = final(_at_goal)
"""1 if the last position is within the goal radius, else 0: SEAN's Completed, without the hold time."""


# --- success weighted by how short the path or the time was ---


class Success(NamedTuple):
    """Whether the robot is at its goal, its path and time so far, and the shortest possible path and time.

    The path and the time to the goal end where the robot comes into the goal radius for the last time.
    """

    reached: Float[Array, ""]  # 1 or 0
    path: SampledPath
    time: Duration
    path_to_goal: Float[Array, ""]  # m
    time_to_goal: Float[Array, ""]  # s
    shortest: Float[Array, ""]  # m, from the start to the goal radius
    top_speed: Float[Array, ""]  # m/s


def _init_success(snapshot: Snapshot) -> Success:
    known = snapshot.robot_top_speed
    zero = jnp.zeros_like(snapshot.geodesic)
    return Success(
        reached=_at_goal(snapshot),
        path=_init_path(snapshot),
        time=zero_duration(snapshot),
        path_to_goal=zero,
        time_to_goal=zero,
        shortest=jnp.maximum(snapshot.geodesic - _goal_radius(snapshot), 0.0),
        top_speed=jnp.full_like(snapshot.geodesic, TOP_SPEED) if known is None else known,
    )


def _update_success(value: Success, before: Snapshot, after: Snapshot) -> Success:
    reached = _at_goal(after)
    path = _update_length(value.path, before, after)
    time = time_in_situation.update(value.time, before, after)
    return value._replace(
        reached=reached,
        path=path,
        time=time,
        path_to_goal=jnp.where(reached > 0, value.path_to_goal, _length(path)[0]),
        time_to_goal=jnp.where(reached > 0, value.time_to_goal, in_seconds(time)[0]),
    )


def _by_path_length(value: Success) -> Array:
    return value.reached * _quotient(value.shortest, value.path_to_goal)


def _by_time(value: Success) -> Array:
    return value.reached * _quotient(value.shortest / value.top_speed, value.time_to_goal)


def _quotient(best: Array, actual: Array) -> Array:
    """best / max(best, actual); 1 where there was nothing to do."""
    larger = jnp.maximum(best, actual)
    none = larger <= 0.0
    return jnp.where(none, 1.0, best / jnp.where(none, 1.0, larger))


success_by_path_length = Metric(_init_success, _update_success, _by_path_length)
"""SPL, S L* / max(L, L*): S as ``reached_goal``, L the length of the path to the goal radius, L* of the shortest one.

Both end at the goal radius, where the goal counts as reached, so that how far a robot goes on inside it does not
count: L where the robot comes into it for the last time, and L* is the geodesic distance to the centre less the radius.

Source: Anderson et al. (2018), On Evaluation of Embodied Navigation Agents.
"""

success_by_time = Metric(_init_success, _update_success, _by_time)
"""STL, S T* / max(T, T*): T the time to the goal radius [s], T* that of the shortest path at top speed, L* / v.

S and L* are those of ``success_by_path_length``, so that a hold time at the goal does not count.
The iGibson social navigation challenge takes for T* the time of an ORCA robot that is alone, which is a little more.
"""


# --- smoothness, from differences of the velocity ---


class Smoothness(NamedTuple):
    """A figure of the steps so far, and the acceleration in the last step."""

    figure: Array | Ratio
    acceleration: Float[Array, "2"]  # m/s2
    known: Float[Array, ""]  # 1 once there is an acceleration, else 0


def _acceleration(before: Snapshot, after: Snapshot) -> Array:
    return (after.velocity - before.velocity) / after.time_step


def _speed(before: Snapshot, after: Snapshot) -> Array:
    return length(after.velocity[0], after.velocity[1])


def _acceleration_size(before: Snapshot, after: Snapshot) -> Array:
    now = _acceleration(before, after)
    return length(now[0], now[1])


def _jerk_size(before: Snapshot, after: Snapshot, value: Smoothness) -> Array:
    """0 in the first step, before which no acceleration is known."""
    change = (_acceleration(before, after) - value.acceleration) / after.time_step
    return value.known * length(change[0], change[1])


def _add_jerk(value: Smoothness, before: Snapshot, after: Snapshot) -> Ratio:
    weights = situation_weights(after)
    (amount, weight) = value.figure
    return Ratio(amount + _jerk_size(before, after, value) * weights, weight + value.known * weights)


def _smoothness(init: Callable, update: Callable, compute: Callable) -> Metric:
    """A metric whose figure is updated with the acceleration before the step: ``update(value, before, after)``."""

    def start(snapshot: Snapshot) -> Smoothness:
        return Smoothness(init(snapshot), jnp.zeros_like(snapshot.velocity), jnp.zeros_like(snapshot.geodesic))

    def step(value: Smoothness, before: Snapshot, after: Snapshot) -> Smoothness:
        return Smoothness(update(value, before, after), _acceleration(before, after), jnp.ones_like(value.known))

    return Metric(start, step, lambda value: compute(value.figure))


def _maximum(size: Callable) -> Metric:
    """Maximum of ``size(before, after, value)`` over the steps."""
    largest = lambda value, before, after: jnp.maximum(value.figure, size(before, after, value))  # noqa: E731
    return _smoothness(lambda snapshot: jnp.zeros_like(snapshot.geodesic), largest, identity)


mean_speed = mean(_speed)
"""Mean of |v| over the steps."""

mean_acceleration = mean(_acceleration_size)
"""Mean of |v_k+1 - v_k| / dt over the steps: of the velocity vector, so that curves count."""

mean_jerk = _smoothness(zero_ratio, _add_jerk, ratio)
"""Mean of |a_k+1 - a_k| / dt over the steps from the second on, a as in ``mean_acceleration``."""

max_speed = _maximum(lambda before, after, value: _speed(before, after))
"""Maximum of |v| over the steps."""

max_acceleration = _maximum(lambda before, after, value: _acceleration_size(before, after))
"""Maximum of |v_k+1 - v_k| / dt."""

max_jerk = _maximum(_jerk_size)
"""Maximum of |a_k+1 - a_k| / dt."""

"""Metrics of success (section IV-H): the goal reached, weighted by how short the path or the time was."""

from typing import NamedTuple

import jax.numpy as jnp

from sean_jax.base import Array, Moment
from sean_jax.geometry import length
from sean_jax.metrics.metric import Duration, Metric, no_time, seconds, split
from sean_jax.metrics.path import Sampled, path_length

GOAL_RADIUS = 1.2  # m, where a moment does not tell (SEAN 2.0)
TOP_SPEED = 0.5  # m/s, likewise (Kuri)


class Success(NamedTuple):
    """Whether the robot is at its goal, after what path and time, and what the least of both are."""

    reached: Array  # () 1 or 0
    path: Sampled
    time: Duration
    geodesic: Array  # () m
    top_speed: Array  # () m/s


def _reached(moment: Moment) -> Array:
    gap = moment.goal - moment.position
    limit = GOAL_RADIUS if moment.goal_radius is None else moment.goal_radius
    return jnp.where(length(gap[0], gap[1]) <= limit, jnp.ones_like(moment.geodesic), 0.0)


def _start(moment: Moment) -> Success:
    known = moment.robot_top_speed
    return Success(
        reached=_reached(moment),
        path=path_length.start(moment),
        time=no_time(moment),
        geodesic=moment.geodesic,
        top_speed=jnp.full_like(moment.geodesic, TOP_SPEED) if known is None else known,
    )


def _fold(value: Success, before: Moment, after: Moment) -> Success:
    path = path_length.fold(value.path, before, after)
    return value._replace(
        reached=_reached(after), path=path, time=value.time._replace(steps=value.time.steps + split(after))
    )


def _by_length(value: Success) -> Array:
    travelled = path_length.result(value.path)[0]
    return value.reached * _share(value.geodesic, travelled)


def _by_time(value: Success) -> Array:
    return value.reached * _share(value.geodesic / value.top_speed, seconds(value.time)[0])


def _share(best: Array, taken: Array) -> Array:
    """best / max(best, taken); 1 where there was nothing to do."""
    most = jnp.maximum(best, taken)
    none = most <= 0.0
    return jnp.where(none, 1.0, best / jnp.where(none, 1.0, most))


reached_goal = Metric(_reached, lambda value, before, after: _reached(after), lambda value: value, "1")
"""1 if the last position is within the goal radius, else 0: SEAN's Completed, without the time to be held there."""

success_by_path_length = Metric(_start, _fold, _by_length, "1")
"""SPL, S L* / max(L, L*): S as ``reached_goal``, L the path length, L* the geodesic distance from start to goal.

Anderson et al. (2018), On Evaluation of Embodied Navigation Agents. The goal
counts as reached a radius before its centre, to which L* leads, so that 1 is a little easier than it seems.
"""

success_by_time = Metric(_start, _fold, _by_time, "1")
"""STL, S T* / max(T, T*): T the time taken [s], T* the time of the shortest path at the robot's top speed, L* / v.

The iGibson social navigation challenge takes for T* the time of an ORCA robot that is alone, which is a little more.
"""

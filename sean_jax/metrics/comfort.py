"""Metrics of people's comfort (section IV-H): personal space, time to collision, social-force work, being looked at."""

from typing import NamedTuple

import jax.numpy as jnp

from sean_jax.base import Array, Moment
from sean_jax.geometry import TINY, length, sum_vectors, unit
from sean_jax.metrics.metric import (
    Duration,
    Metric,
    least,
    mean,
    nan_if_never,
    never,
    no_time,
    nothing,
    seconds,
    split,
    value_itself,
)

SPACE = 0.5  # m, of the iGibson social navigation challenge
HORIZON = 30.0  # s: a collision later than that counts as one then
STRENGTH, RANGE = 7.0, 0.3  # m/s2, m: V0 / sigma and sigma of Helbing & Molnar (1995), circular
LOOKING = 0.9961947  # cosine of 5 degrees (Arena-Rosnav)
SEEN = 3.6  # m, the end of social distance [Hall]: who is farther away does not meet the robot


class Share(NamedTuple):
    """How many of the steps hold something."""

    amount: Array  # (1 + S,)
    steps: Array  # (1 + S,)


def _gap(moment: Moment) -> tuple[Array, Array]:
    """(N,) x and y [m] from the robot to each person."""
    gap = moment.people.position - moment.position[None, :]
    return gap[:, 0], gap[:, 1]


def _fold_space(value: Share, before: Moment, after: Moment) -> Share:
    x, y = _gap(after)
    near = (x * x + y * y < SPACE * SPACE) & after.people.present
    kept = jnp.where(near.any(), 0.0, split(after))
    return Share(value.amount + kept, value.steps + split(after))


def collision_time(x: Array, y: Array, vx: Array, vy: Array, reach: Array) -> Array:
    """Smallest t >= 0 [s] with |d + v t| <= reach [m], d = (x, y) [m], v = (vx, vy) [m/s]; inf if there is none."""
    speeds, product = vx * vx + vy * vy, x * vx + y * vy
    outside = x * x + y * y - reach * reach
    inner = product * product - speeds * outside
    meets = (product < 0.0) & (inner > 0.0) & (speeds > TINY)
    root = jnp.sqrt(jnp.where(meets, inner, 1.0))
    # c / (-b + root) is (-b - root) / a without the difference of nearly equal numbers.
    time = outside / jnp.where(meets, root - product, 1.0)
    return jnp.where(outside <= 0.0, 0.0, jnp.where(meets, time, jnp.inf))


def _soonest(moment: Moment) -> Array:
    x, y = _gap(moment)
    relative = moment.people.velocity - moment.velocity[None, :]
    time = collision_time(x, y, relative[:, 0], relative[:, 1], moment.robot_radius + moment.person_radius)
    return jnp.min(jnp.where(moment.people.present, time, HORIZON), initial=HORIZON)


def _start_soonest(moment: Moment) -> Array:
    return least(never(moment), _soonest(moment), moment)


def _fold_soonest(value: Array, before: Moment, after: Moment) -> Array:
    return least(value, _soonest(after), after)


def _fold_work(value: Array, before: Moment, after: Moment) -> Array:
    x, y = _gap(after)
    distance = length(x, y)
    push = jnp.where(after.people.present, STRENGTH * jnp.exp(-distance / RANGE), 0.0)
    away_x, away_y = unit(x, y)
    robot = length(*sum_vectors(push * away_x, push * away_y, 0))
    return value + after.time_step * (robot + push.sum()) * split(after)


def _fold_looked(value: Duration, before: Moment, after: Moment) -> Duration:
    x, y = _gap(after)
    distance = length(x, y)
    heading = after.people.heading
    toward = -(heading[:, 0] * x + heading[:, 1] * y) >= LOOKING * distance
    looks = toward & (distance <= SEEN) & after.people.present
    return value._replace(steps=value.steps + jnp.where(looks.any(), split(after), 0.0))


personal_space_compliance = Metric(
    lambda moment: Share(nothing(moment), nothing(moment)),
    _fold_space,
    lambda value: mean(value.amount, value.steps),
    "1",
)
"""Share of the steps in which all people are 0.5 m or farther away, centre to centre (PSC)."""

min_time_to_collision = Metric(_start_soonest, _fold_soonest, nan_if_never, "s")
"""Least time after which the robot and somebody would touch, at most 30 s, if both kept their velocities.

At each step the smallest t >= 0 with |d + v t| <= r_robot + r_person over all people, d and v relative.
"""

social_work = Metric(nothing, _fold_work, value_itself, "m/s")
"""Social-force work: dt (|sum_i f_i| + sum_i |f_i|) summed over the steps, on the robot and on all people, per mass.

The robot and person i push each other with f = (V0 / sigma) exp(-d / sigma) = 7 m/s2 exp(-d / 0.3 m), d between
centres: the circular law of Helbing & Molnar (1995), whatever law moves the people, so that pedestrian models can be
compared. A sum of force over time, which HuNavSim calls work.
"""

time_looked_at = Metric(no_time, _fold_looked, seconds, "s")
"""Time in which at least one person within 3.6 m faces the robot to within 5 degrees; obstacles hide nobody."""

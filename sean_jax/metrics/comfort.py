"""Metrics of people's comfort (section IV-H): personal space, time to collision, social-force work, gazes."""

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, Moment
from sean_jax.geometry import TINY, length, sum_vectors, unit
from sean_jax.metrics.metric import duration, minimum, share_of_time, total

SPACE = 0.5  # m, of the iGibson social navigation challenge
HORIZON = 30.0  # s, maximum of the time to collision
STRENGTH, RANGE = 7.0, 0.3  # m/s2, m: V0 / sigma and sigma of Helbing & Molnar (1995), circular
LOOKING = 0.9961947  # cosine of 5 degrees (Arena-Rosnav)
VISIBLE = 3.6  # m, the end of social distance [Hall]


def collision_time(
    x: Float[Array, "*shape"],
    y: Float[Array, "*shape"],
    vx: Float[Array, "*shape"],
    vy: Float[Array, "*shape"],
    reach: Float[Array, "#*shape"] | float,
) -> Float[Array, "*shape"]:
    """Time [s] until two discs at constant velocities touch: the smallest t >= 0 with |d + v t| <= reach; inf if never.

    Args:
        x, y: m, relative position d.
        vx, vy: m/s, relative velocity v.
        reach: m, sum of both radii; it broadcasts.
    """
    speeds, product = vx * vx + vy * vy, x * vx + y * vy
    outside = x * x + y * y - reach * reach
    inner = product * product - speeds * outside
    meets = (product < 0.0) & (inner > 0.0) & (speeds > TINY)
    root = jnp.sqrt(jnp.where(meets, inner, 1.0))
    # c / (-b + root) is (-b - root) / a without the difference of nearly equal numbers.
    time = outside / jnp.where(meets, root - product, 1.0)
    return jnp.where(outside <= 0.0, 0.0, jnp.where(meets, time, jnp.inf))


def _gap(moment: Moment) -> tuple[Array, Array]:
    """(N,) x and y [m] from the robot to each person."""
    gap = moment.people.position - moment.position[None, :]
    return gap[:, 0], gap[:, 1]


def _respects_space(moment: Moment) -> Array:
    x, y = _gap(moment)
    return ~((x * x + y * y < SPACE * SPACE) & moment.people.present).any()


def _time_to_collision(moment: Moment) -> Array:
    x, y = _gap(moment)
    relative = moment.people.velocity - moment.velocity[None, :]
    time = collision_time(x, y, relative[:, 0], relative[:, 1], moment.robot_radius + moment.person_radius)
    return jnp.min(jnp.where(moment.people.present, time, HORIZON), initial=HORIZON)


def _work(before: Moment, after: Moment) -> Array:
    x, y = _gap(after)
    distance = length(x, y)
    push = jnp.where(after.people.present, STRENGTH * jnp.exp(-distance / RANGE), 0.0)
    away_x, away_y = unit(x, y)
    robot = length(*sum_vectors(push * away_x, push * away_y, 0))
    return after.time_step * (robot + push.sum())


def _is_looked_at(moment: Moment) -> Array:
    x, y = _gap(moment)
    distance = length(x, y)
    heading = moment.people.heading
    toward = -(heading[:, 0] * x + heading[:, 1] * y) >= LOOKING * distance
    return (toward & (distance <= VISIBLE) & moment.people.present).any()


personal_space_compliance = share_of_time(
    _respects_space,
    title="personal space compliance",
    definition="Share of the time in which everybody is 0.5 m or farther away from the robot.",
    headline=False,
)
"""Share of the steps in which all people are 0.5 m or farther away, centre to centre (PSC)."""

min_time_to_collision = minimum(
    _time_to_collision,
    unit="s",
    title="minimum time to collision",
    definition="Time until the robot would touch a person if both kept their velocities; at most 30 s.",
    headline=False,
)
"""Least time after which the robot and somebody would touch, at most 30 s, if both kept their velocities.

At each step the smallest t >= 0 with |d + v t| <= r_robot + r_person over all people, d and v relative.
"""

social_work = total(
    _work,
    unit="m/s",
    title="social-force work",
    definition="Social forces between the robot and people, summed over time.",
    headline=False,
)
"""Social-force work: dt (|sum_i f_i| + sum_i |f_i|) summed over the steps, on the robot and on all people, per mass.

The robot and person i push each other with f = (V0 / sigma) exp(-d / sigma) = 7 m/s2 exp(-d / 0.3 m), d between
centres: the circular law of Helbing & Molnar (1995), whatever law moves the people, so that pedestrian models can be
compared. A sum of force over time, which HuNavSim calls work.
"""

time_looked_at = duration(
    _is_looked_at,
    title="time looked at",
    definition="Time during which a person within 3.6 m faces the robot to within 5 degrees.",
    headline=False,
)
"""Time in which at least one person within 3.6 m faces the robot to within 5 degrees; obstacles hide nobody."""

"""Metrics of closeness to people (section IV-H): distance violations and collisions, each with its fault.

An event is an entry: somebody's distance to the robot (centre to centre, as the paper words it; SEAN's code
subtracts a person's radius) falls below the limit, having been above it a step before. The fault rule is SEAN's:
robot on person if the robot moves and its velocity has a part towards the person, else person on robot.
"""

from collections.abc import Callable

import jax.numpy as jnp

from sean_jax.base import Array, Moment
from sean_jax.geometry import TINY
from sean_jax.metrics.metric import Metric, nothing, split, value_itself

INTIMATE = 0.45  # m [Hall; section IV-H]
PERSONAL = 1.2  # m [Hall; section IV-G]
MOVING = 5e-4  # m/s: SEAN rounds the robot's speed to three decimals


def intimate_limit(moment: Moment) -> Array:
    """() distance [m] of intimacy."""
    return jnp.full_like(moment.robot_radius, INTIMATE)


def personal_limit(moment: Moment) -> Array:
    """() distance [m] of personal space."""
    return jnp.full_like(moment.robot_radius, PERSONAL)


def touch_limit(moment: Moment) -> Array:
    """() distance [m] at which bodies touch, with SEAN's margin of 1 cm."""
    return moment.robot_radius + moment.person_radius + 0.01


def _squares(moment: Moment) -> Array:
    gap = moment.people.position - moment.position[None, :]
    return jnp.where(moment.people.present, (gap * gap).sum(1), jnp.inf)


def _entries(limit: Callable, by_robot: bool) -> Callable:
    def fold(value: Array, before: Moment, after: Moment) -> Array:
        square = limit(after) ** 2
        entered = (_squares(after) <= square) & (_squares(before) > square)
        toward = (after.velocity[None, :] * (after.people.position - after.position[None, :])).sum(1) > 0.0
        moving = (after.velocity * after.velocity).sum() > MOVING * MOVING
        fault = toward & moving
        count = jnp.where(entered & (fault == by_robot), 1.0, 0.0).sum()
        return value + count * split(after)

    return fold


def _least(moment: Moment) -> Array:
    square = jnp.min(_squares(moment), initial=jnp.inf)
    alone = ~jnp.isfinite(square)
    touching = square < TINY
    return jnp.where(alone, 1e3, jnp.where(touching, 0.0, jnp.sqrt(jnp.where(alone | touching, 1.0, square))))


def _metric(limit: Callable, by_robot: bool) -> Metric:
    return Metric(nothing, _entries(limit, by_robot), value_itself, "count")


intimate_robot_on_person = _metric(intimate_limit, True)
"""Times that the moving robot came within 0.45 m of somebody."""

intimate_person_on_robot = _metric(intimate_limit, False)
"""Times that somebody came within 0.45 m of the robot."""

personal_robot_on_person = _metric(personal_limit, True)
"""Times that the moving robot came within 1.2 m of somebody."""

personal_person_on_robot = _metric(personal_limit, False)
"""Times that somebody came within 1.2 m of the robot."""

collision_robot_on_person = _metric(touch_limit, True)
"""Times that the moving robot touched somebody."""

collision_person_on_robot = _metric(touch_limit, False)
"""Times that somebody touched the robot."""

min_distance_to_people = Metric(
    _least, lambda value, before, after: jnp.minimum(value, _least(after)), value_itself, "m"
)
"""Least distance from the robot's centre to anybody's; 1000 where there is nobody."""

"""Metrics of static obstacles (section IV-H): collisions with them, and how close the robot came."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Moment
from sean_jax.geometry import from_box
from sean_jax.metrics.metric import Metric, least, nan_if_never, never, nothing, split, value_itself

TOUCH = 0.01  # m, SEAN's margin
NONE = 1e3  # m, where no obstacles are known


def obstacle_distance(moment: Moment) -> Array:
    """() distance [m] from the robot's centre to the surface of the nearest obstacle; 1000 where there is none."""
    if moment.obstacles is None:
        return jnp.full_like(moment.geodesic, NONE)
    each = jax.vmap(from_box, in_axes=(None, None, 0))(moment.position[0], moment.position[1], moment.obstacles)[0]
    return jnp.min(each, initial=NONE)


def _fold_collisions(value: Array, before: Moment, after: Moment) -> Array:
    limit = after.robot_radius + TOUCH
    entered = (obstacle_distance(after) <= limit) & (obstacle_distance(before) > limit)
    return value + jnp.where(entered, split(after), 0.0)


def _start_distance(moment: Moment) -> Array:
    return least(never(moment), obstacle_distance(moment), moment)


def _fold_distance(value: Array, before: Moment, after: Moment) -> Array:
    return least(value, obstacle_distance(after), after)


collision_with_obstacle = Metric(nothing, _fold_collisions, value_itself, "count")
"""Times that the robot touched an obstacle, having touched none a step before: within its radius and 1 cm.

SEAN's code also counts obstacles that come within 1.2 m and 0.45 m; this counts the body alone.
"""

min_distance_to_obstacles = Metric(_start_distance, _fold_distance, nan_if_never, "m")
"""Least distance from the robot's centre to the surface of an obstacle; 1000 where there is none."""

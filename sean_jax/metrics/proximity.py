"""Metrics of closeness (section IV-H): distance violations and collisions with people, each with its fault; obstacles.

An event is an entry: a person's distance to the robot (centre to centre, as in the paper; SEAN's code subtracts a
person's radius) falls below the limit, having been above it a step before. The fault rule is SEAN's: robot on person if
the robot moves and its velocity has a part towards the person, else person on robot.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.base import Array, Moment
from sean_jax.geometry import TINY, from_box
from sean_jax.metrics.metric import Metric, count_onsets, minimum

INTIMATE = 0.45  # m [Hall; section IV-H]
PERSONAL = 1.2  # m [Hall; section IV-G]
TOUCH = 0.01  # m, SEAN's margin around bodies
MOVING = 5e-4  # m/s: SEAN rounds the robot's speed to three decimals
NONE = 1e3  # m, distance to people or obstacles if there are none


# --- people ---


def _intimate_limit(moment: Moment) -> Float[Array, ""]:
    """Distance [m] of intimacy: () m, the same for all."""
    return jnp.full_like(moment.robot_radius, INTIMATE)


def _personal_limit(moment: Moment) -> Float[Array, ""]:
    """Distance [m] of personal space: () m, the same for all."""
    return jnp.full_like(moment.robot_radius, PERSONAL)


def _touch_limit(moment: Moment) -> Float[Array, ""]:
    """Distance [m] at which the bodies of robot and person touch: () m, with SEAN's margin of 1 cm."""
    return moment.robot_radius + moment.person_radius + TOUCH


def _squares(moment: Moment) -> Array:
    """(N,) m2, squared distance from the robot to each person, infinite for those absent."""
    gap = moment.people.position - moment.position[None, :]
    return jnp.where(moment.people.present, (gap * gap).sum(1), jnp.inf)


def _distance_to_people(moment: Moment) -> Array:
    square = jnp.min(_squares(moment), initial=jnp.inf)
    alone = ~jnp.isfinite(square)
    touching = square < TINY
    return jnp.where(alone, NONE, jnp.where(touching, 0.0, jnp.sqrt(jnp.where(alone | touching, 1.0, square))))


def _robot_at_fault(moment: Moment) -> Array:
    """(N,) bool: the robot moves, and partly towards the person."""
    toward = (moment.velocity[None, :] * (moment.people.position - moment.position[None, :])).sum(1) > 0.0
    moving = (moment.velocity * moment.velocity).sum() > MOVING * MOVING
    return toward & moving


def _person_at_fault(moment: Moment) -> Array:
    return ~_robot_at_fault(moment)


def _entries(limit: Callable[[Moment], Array], by_robot: bool, name: str, distance: float | None = None) -> Metric:
    """Entries of people into a circle around the robot, of which one of both is at fault."""

    def inside(moment: Moment) -> Array:
        return _squares(moment) <= limit(moment) ** 2

    whose = "robot on person" if by_robot else "person on robot"
    who = "the robot, by its own motion," if by_robot else "a person, by their own motion,"
    other = "a person" if by_robot else "the robot"
    what = f"{who} touched {other}" if distance is None else f"{who} came within {distance} m of {other}"
    return count_onsets(
        inside,
        _robot_at_fault if by_robot else _person_at_fault,
        title=f"{name}, {whose}",
        definition=f"Number of times that {what}.",
    )


intimate_robot_on_person = _entries(_intimate_limit, True, "intimate", INTIMATE)
"""Times that the moving robot came within 0.45 m of somebody."""

intimate_person_on_robot = _entries(_intimate_limit, False, "intimate", INTIMATE)
"""Times that somebody came within 0.45 m of the robot."""

personal_robot_on_person = _entries(_personal_limit, True, "personal", PERSONAL)
"""Times that the moving robot came within 1.2 m of somebody."""

personal_person_on_robot = _entries(_personal_limit, False, "personal", PERSONAL)
"""Times that somebody came within 1.2 m of the robot."""

collision_robot_on_person = _entries(_touch_limit, True, "collision")
"""Times that the moving robot touched somebody."""

collision_person_on_robot = _entries(_touch_limit, False, "collision")
"""Times that somebody touched the robot."""

min_distance_to_people = minimum(
    _distance_to_people,
    by_situation=False,
    unit="m",
    title="minimum distance to people",
    definition="Distance from the robot to the nearest person, when it was nearest.",
    headline=False,
)
"""Least distance from the robot's centre to that of a person; 1000 without people."""


# --- obstacles ---


def obstacle_distance(moment: Moment) -> Float[Array, ""]:
    """Distance [m] from the robot's centre to the surface of the nearest obstacle, negative inside.

    It is 1000 if there is no obstacle or none is known.
    """
    if moment.obstacles is None:
        return jnp.full_like(moment.geodesic, NONE)
    each = jax.vmap(from_box, in_axes=(None, None, 0))(moment.position[0], moment.position[1], moment.obstacles)[0]
    return jnp.min(each, initial=NONE)


def _touches_obstacle(moment: Moment) -> Array:
    return obstacle_distance(moment) <= moment.robot_radius + TOUCH


collision_with_obstacle = count_onsets(
    _touches_obstacle,
    title="collision with an obstacle",
    definition="Number of times that the robot touched an obstacle.",
    headline=False,
)
"""Times that the robot touched an obstacle, within its radius and 1 cm, and none a step before.

SEAN's code also counts obstacles that come within 1.2 m and 0.45 m; this counts the body alone.
"""

min_distance_to_obstacles = minimum(
    obstacle_distance,
    unit="m",
    title="minimum distance to obstacles",
    definition="Distance from the robot's centre to the surface of the nearest obstacle, when it was nearest.",
    headline=False,
)
"""Least distance from the robot's centre to the surface of an obstacle; 1000 without obstacles."""

"""The five situations as the code of SEAN 2.0 decides them, where it departs from the equations of section III-A.

Two things are common to all. Directions are those of motion: SEAN fits a line to an agent's last 30 poses and takes
the vector along it, and only for a robot that stands its forward axis; here the velocity stands for that vector. And
SEAN decides once a second, on what it saw then; here it is up to the caller how often to look. SEAN's distances are
to colliders, ours to centres, as in the paper.
"""

from collections.abc import Callable

import jax.numpy as jnp

from sean_jax.base import Array, Moment, Pedestrians
from sean_jax.classifiers.predicates import any_person, cosine, near, walking
from sean_jax.classifiers.situations import Thresholds, empty, thresholds

STILL = 0.02  # m/s: SEAN's 0.01 m within the half second that its 30 poses span


def sean2_thresholds() -> Thresholds:
    """V = 0.4 m/s instead of the paper's 1.4, which SEAN's pedestrians, at most 0.6 m/s fast, never reach."""
    return thresholds(walking=0.4)


def cross_path(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (1) on directions of motion instead of orientations; the limits of the angle are not included."""
    direction = robot_direction(moment)

    def holds(agent: Pedestrians) -> Array:
        across = jnp.abs(cosine(direction, agent.velocity)) < jnp.sin(thresholds.angle)
        return _nearby_walker(moment, agent, thresholds) & across

    return any_person(moment, holds)


def down_path(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (2), but the agent must walk, and coming the other way (anti-parallel) counts as well."""
    direction = robot_direction(moment)

    def holds(agent: Pedestrians) -> Array:
        between = cosine(direction, agent.velocity)
        # -2 says that there is no direction, which must not pass for the opposite one.
        along = (between >= -1.5) & (jnp.abs(between) > jnp.cos(thresholds.angle))
        return _nearby_walker(moment, agent, thresholds) & along

    return any_person(moment, holds)


def join_group(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (3), but anybody near serves, member or not, and the robot must be within D of its goal; also at it."""
    return _at_group(moment, moment.goal_group, moment.goal, thresholds)


def leave_group(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (4), but anybody near serves, member or not, and the robot must still be within D of its start."""
    return _at_group(moment, moment.start_group, moment.start, thresholds)


def robot_direction(moment: Moment) -> Array:
    """(2,) the robot's velocity, or its heading where it stands."""
    moves = (moment.velocity * moment.velocity).sum() >= STILL * STILL
    return jnp.where(moves, moment.velocity, moment.heading)


def _at_group(moment: Moment, group: Array, place: Array, thresholds: Thresholds) -> Array:
    """Somebody is near, and the robot is near the place (2,) [m], which is that of a member of a group () int32."""
    return ~empty(moment, thresholds) & (group >= 0) & near(moment.position, place, thresholds.near)


def _nearby_walker(moment: Moment, agent: Pedestrians, thresholds: Thresholds) -> Array:
    return near(moment.position, agent.position, thresholds.near) & walking(agent.velocity, thresholds.walking)


SEAN2_SITUATIONS: dict[str, Callable[[Moment, Thresholds], Array]] = {
    "cross_path": cross_path,
    "down_path": down_path,
    "join_group": join_group,
    "leave_group": leave_group,
    "empty": empty,
}

"""The five social situations, equations (1)-(5) of section III-A, for a robot among people.

Each equation speaks of one agent; a situation occurs when it holds for any of them. A function takes a
``base.Moment`` and ``Thresholds`` and gives a () bool; nothing but arrays is read, so recordings serve as well.
"""

from collections.abc import Callable

import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, Moment, Pedestrians
from sean_jax.classifiers.predicates import (
    any_person,
    member,
    near,
    parallel_trajectory,
    perpendicular_trajectory,
    walking,
)


@struct.dataclass
class Thresholds:
    """Constants of the predicates (section V-B), and of the situations beyond the paper's five."""

    near: Array  # () m, D: twice the personal distance of Hall
    walking: Array  # () m/s, V
    angle: Array  # () rad, A
    arrival: Array  # () m, x_r = x'_r of equation (3) holds within it; ours, the paper has an equality
    reach: Array  # () m, how far an encounter is foreseen: where Hall's social distance ends
    personal: Array  # () m, Hall's personal distance: passing within it is passing close
    moving: Array  # () m/s, who is slower stands, in the situations beyond the five; ours
    gaining: Array  # () m/s, difference in speed of overtaking, below it of following; ours
    crowd: Array  # () 1/m2, density of people: where Fruin's best level of service for walkways ends
    hides: Array  # () m, height of an obstacle that people and robots cannot look over; ours


def thresholds(
    near: float = 2.4,
    walking: float = 1.4,
    angle: float = jnp.pi / 12,
    arrival: float = 0.2,
    reach: float = 3.6,
    personal: float = 1.2,
    moving: float = 0.1,
    gaining: float = 0.2,
    crowd: float = 0.31,
    hides: float = 1.0,
) -> Thresholds:
    """The paper's thresholds, D = 2.4 m, V = 1.4 m/s, A = 15 degrees, and those of the other situations."""
    values = (near, walking, angle, arrival, reach, personal, moving, gaining, crowd, hides)
    return Thresholds(*(jnp.asarray(value, float) for value in values))


def cross_path(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (1): near an agent who walks with an orientation perpendicular to the robot's."""

    def holds(agent: Pedestrians) -> Array:
        return (
            near(moment.position, agent.position, thresholds.near)
            & walking(agent.velocity, thresholds.walking)
            & perpendicular_trajectory(moment.heading, agent.heading, thresholds.angle)
        )

    return any_person(moment, holds)


def down_path(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (2): near an agent with an orientation parallel to the robot's. As printed: it need not walk."""

    def holds(agent: Pedestrians) -> Array:
        return near(moment.position, agent.position, thresholds.near) & parallel_trajectory(
            moment.heading, agent.heading, thresholds.angle
        )

    return any_person(moment, holds)


def join_group(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (3): near a member of the group that the goal belongs to, and not yet at the goal."""

    def holds(agent: Pedestrians) -> Array:
        return near(moment.position, agent.position, thresholds.near) & member(agent.group, moment.goal_group)

    return any_person(moment, holds) & ~near(moment.position, moment.goal, thresholds.arrival)


def leave_group(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (4): near a member of the group that the start belongs to."""

    def holds(agent: Pedestrians) -> Array:
        return near(moment.position, agent.position, thresholds.near) & member(agent.group, moment.start_group)

    return any_person(moment, holds)


def empty(moment: Moment, thresholds: Thresholds) -> Array:
    """Equation (5): no agent is near."""

    def holds(agent: Pedestrians) -> Array:
        return near(moment.position, agent.position, thresholds.near)

    return ~any_person(moment, holds)


SITUATIONS: dict[str, Callable[[Moment, Thresholds], Array]] = {
    "cross_path": cross_path,
    "down_path": down_path,
    "join_group": join_group,
    "leave_group": leave_group,
    "empty": empty,
}


def classify(moment: Moment, thresholds: Thresholds, situations: tuple = tuple(SITUATIONS.items())) -> Array:
    """(S,) bool: which of the named situations occur at that moment; several can."""
    return jnp.stack([holds(moment, thresholds) for _, holds in situations])

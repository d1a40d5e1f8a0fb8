"""Situations of urgency (section VI): a collision is near in time, or somebody in a hurry comes the robot's way.

Urgency here is what positions and velocities tell. That of the robot's own task, a deadline, is not part of a moment.
"""

import jax.numpy as jnp
from jaxtyping import Bool

from sean_jax.base import Array, Moment, Pedestrians
from sean_jax.classifiers.predicates import ahead_and_aside, any_person, near, walking
from sean_jax.classifiers.situations import Situation, Thresholds
from sean_jax.geometry import TINY


def collision_course(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """Robot and person would touch within seconds if both kept their velocities.

    The time to collision is at most ``imminent``: at some t from 0 to it, the centres are closer than the sum of the
    radii. Who touches already is on collision course as well.

    Returns:
        () bool, whether it occurs.
    Source: I. Karamouzas, B. Skinner & S. Guy, "Universal Power Law Governing Pedestrian Interactions", Physical Review
    Letters 113, 2014: people react to collisions that are up to about 3 s away.
    """
    touch = moment.robot_radius + moment.person_radius

    def holds(agent: Pedestrians) -> Array:
        gap, relative = agent.position - moment.position, agent.velocity - moment.velocity
        square = (relative * relative).sum()
        still = square < TINY
        nearest = -(gap * relative).sum() / jnp.where(still, 1.0, square)  # s, when the centres are closest
        time = jnp.where(still, 0.0, jnp.clip(nearest, 0.0, thresholds.imminent))
        return near(gap + time * relative, jnp.zeros_like(gap), touch)

    return any_person(moment, holds)


def hurrying(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """Somebody in a hurry comes the robot's way, from any side, so that it has to make way.

    The person is faster than ``hurry``, and the robot lies less than ``reach`` ahead and less than ``personal`` aside
    of the direction in which the person moves.

    Returns:
        () bool, whether it occurs.
    Source: section VI, "urgency"; the inequalities are ours. U. Weidmann, "Transporttechnik der Fussgaenger", 1993:
    people walk at 1.34 m/s with a standard deviation of 0.26 m/s, so 2.3 % of them are faster than 1.86 m/s.
    """

    def holds(agent: Pedestrians) -> Array:
        # Both times the speed, which spares a division by that of who stands.
        ahead, aside = ahead_and_aside(agent.velocity, moment.position - agent.position)
        square = (agent.velocity * agent.velocity).sum()
        return (
            walking(agent.velocity, thresholds.hurry)
            & (ahead > 0)
            & (ahead * ahead < thresholds.reach * thresholds.reach * square)
            & (aside * aside < thresholds.personal * thresholds.personal * square)
        )

    return any_person(moment, holds)


URGENT_SITUATIONS: dict[str, Situation] = {
    "collision_course": collision_course,
    "hurrying": hurrying,
}
"""(moment, thresholds) -> () bool"""

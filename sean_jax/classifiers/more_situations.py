"""Situations beyond the paper's five: overtaking, following, frontal approach, crowded; and all of them (section VI).

From the taxonomy of social navigation scenarios by Francis et al., "Principles and Guidelines for Evaluating Social
Robot Navigation Algorithms" (2023), Fig. 7. That paper names them by example; the inequalities are ours. "Moving" is
faster than 0.1 m/s, since agents that stand are obstructions. ``ahead`` and ``aside`` are the parts of a person's
position along the robot's heading and to its left. Those of urgency and of objects have files of their own.
"""

import jax.numpy as jnp
from jaxtyping import Bool

from sean_jax.base import Array, Moment, Pedestrians
from sean_jax.classifiers.objects import OBJECT_SITUATIONS
from sean_jax.classifiers.predicates import ahead_and_aside, any_person, cosine, walking
from sean_jax.classifiers.situations import Situation, Thresholds
from sean_jax.classifiers.urgency import URGENT_SITUATIONS
from sean_jax.geometry import length


def overtaking(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """The faster of robot and person passes the slower one, going the same way.

    Headings parallel within A, both moving, speeds at least ``gaining`` apart, |aside| < ``personal``, and the faster
    one behind or beside (not ahead by the sum of the radii or more), within ``reach``.

    Returns:
        () bool, whether it occurs.
    Source: Francis et al. (2023), Fig. 7 c and d.
    """
    touch = moment.robot_radius + moment.person_radius

    def holds(agent: Pedestrians) -> Array:
        ahead, aside = ahead_and_aside(moment.heading, agent.position - moment.position)
        faster = _speed(moment.velocity) - _speed(agent.velocity)
        before = jnp.where(faster > 0, ahead, -ahead)  # how far the slower one is ahead of the faster one
        return (
            _both_move(moment, agent, thresholds)
            & (cosine(moment.heading, agent.heading) >= jnp.cos(thresholds.angle))
            & (jnp.abs(faster) >= thresholds.gaining)
            & (jnp.abs(aside) < thresholds.personal)
            & (before > -touch)
            & (before < thresholds.reach)
        )

    return any_person(moment, holds)


def following(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """The robot walks behind a person, about as fast.

    Headings parallel within A, both moving, speeds less than ``gaining`` apart, |aside| < ``personal``, and the person
    ahead by more than the sum of the radii and less than ``reach``. Never of the same person as overtaking.

    Returns:
        () bool, whether it occurs.
    Source: Francis et al. (2023), Fig. 7 r.
    """
    touch = moment.robot_radius + moment.person_radius

    def holds(agent: Pedestrians) -> Array:
        ahead, aside = ahead_and_aside(moment.heading, agent.position - moment.position)
        return (
            _both_move(moment, agent, thresholds)
            & (cosine(moment.heading, agent.heading) >= jnp.cos(thresholds.angle))
            & (jnp.abs(_speed(moment.velocity) - _speed(agent.velocity)) < thresholds.gaining)
            & (jnp.abs(aside) < thresholds.personal)
            & (ahead > touch)
            & (ahead < thresholds.reach)
        )

    return any_person(moment, holds)


def frontal_approach(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """Robot and person come head on, and would pass close.

    Headings opposite within A, both moving, the person ahead, within ``reach``, and |aside| < ``personal``.

    Returns:
        () bool, whether it occurs.
    Source: Francis et al. (2023), Fig. 7 a.
    """

    def holds(agent: Pedestrians) -> Array:
        ahead, aside = ahead_and_aside(moment.heading, agent.position - moment.position)
        between = cosine(moment.heading, agent.heading)
        return (
            _both_move(moment, agent, thresholds)
            & (between >= -1.5)  # -2: no direction at all
            & (between <= -jnp.cos(thresholds.angle))
            & (jnp.abs(aside) < thresholds.personal)
            & (ahead > 0)
            & (ahead < thresholds.reach)
        )

    return any_person(moment, holds)


def crowded(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """People stand or walk close together around the robot.

    Density of people on the disc of radius D about the robot of ``crowd`` or more: six people within 2.4 m. The disc
    is taken as all free floor, so that walls make the robot no less crowded than it is.

    Returns:
        () bool, whether it occurs.
    Source: Francis et al. (2023), Fig. 7 u and y.
    """
    people = moment.people
    gaps = people.position - moment.position[None, :]
    inside = (gaps * gaps).sum(-1) < thresholds.near * thresholds.near
    number = (inside & people.present).sum().astype(float)
    return number >= thresholds.crowd * jnp.pi * thresholds.near * thresholds.near


def _both_move(moment: Moment, agent: Pedestrians, thresholds: Thresholds) -> Array:
    return walking(moment.velocity, thresholds.moving) & walking(agent.velocity, thresholds.moving)


def _speed(velocity: Array) -> Array:
    return length(velocity[0], velocity[1])


MORE_SITUATIONS: dict[str, Situation] = {
    "overtaking": overtaking,
    "frontal_approach": frontal_approach,
    "following": following,
    "crowded": crowded,
    **OBJECT_SITUATIONS,
    **URGENT_SITUATIONS,
}
"""Situations beyond the paper's five, as its future work asks: (moment, thresholds) -> () bool."""

"""Situations beyond the paper's five: overtaking, following, frontal approach, crowded, blind corner, narrow passage.

From the taxonomy of social navigation scenarios by Francis et al., "Principles and Guidelines for Evaluating Social
Robot Navigation Algorithms" (2023), Fig. 7. The paper names them by example; the inequalities are ours. "Moving" is
faster than 0.1 m/s, since agents that stand are obstructions. ``ahead`` and ``aside`` are the parts of a person's
position along the robot's heading and to its left.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from sean_jax.base import Array, Moment, Obstacles, Pedestrians
from sean_jax.classifiers.predicates import ahead_and_aside, any_person, cosine, near, walking
from sean_jax.classifiers.situations import Thresholds
from sean_jax.geometry import crosses_box, length, rotate

SAMPLES = 4  # places ahead, besides the robot's own, at which the width of its way is measured
FAR = 1e3  # m, length of a ray that hits nothing


# --- robot and people in motion ---


def overtaking(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """The faster of robot and person passes the slower one, going the same way.

    Headings parallel within A, both moving, speeds at least ``gaining`` apart, |aside| < ``personal``, and the faster
    one behind or beside (not ahead by the sum of the radii or more), within ``reach``.

    Args:
        moment: the robot among people.
        thresholds: of the predicates.

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

    Args:
        moment: the robot among people.
        thresholds: of the predicates.

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

    Args:
        moment: the robot among people.
        thresholds: of the predicates.

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

    Args:
        moment: the robot among people.
        thresholds: of the predicates.

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


# --- obstacles: both read ``moment.obstacles`` and cost some W rays or N times W segments ---


def blind_corner(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """Robot and person cannot see each other, and their ways meet behind the corner.

    Both moving and within 2 ``reach``; an obstacle at least ``hides`` high stands on the line between them; their
    ways, followed straight on, cross at more than the angle A, within ``reach`` of each, and no obstacle of any
    height stands on either way before that place.

    Args:
        moment: the robot among people and obstacles.
        thresholds: of the predicates.

    Returns:
        () bool, whether it occurs; never where obstacles are not known (None).

    Source: Francis et al. (2023), Fig. 7 i.
    """
    obstacles = moment.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    high = obstacles.height >= thresholds.hides

    def holds(agent: Pedestrians) -> Array:
        own, other, sine = _crossing(moment.position, moment.heading, agent.position, agent.heading)
        place = moment.position + own * moment.heading
        return (
            walking(moment.velocity, thresholds.moving)
            & walking(agent.velocity, thresholds.moving)
            & near(moment.position, agent.position, 2 * thresholds.reach)
            & (jnp.abs(sine) > jnp.sin(thresholds.angle))
            & (own > 0)
            & (own < thresholds.reach)
            & (other > 0)
            & (other < thresholds.reach)
            & (_blocks(obstacles, moment.position, agent.position) & high).any()
            & ~_blocks(obstacles, moment.position, place).any()
            & ~_blocks(obstacles, agent.position, place).any()
        )

    return any_person(moment, holds)


def narrow_passage(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """In a hallway or doorway, with a person near: two cannot pass there without coming close.

    The way is narrow where obstacles to the left and right leave less than both radii and ``personal`` across: each
    keeping to its wall, the centres would still come within ``personal``. It is measured at right angles to the
    heading, at the robot and at four places up to ``personal`` ahead, as far as the way is free.

    Args:
        moment: the robot among people and obstacles.
        thresholds: of the predicates.

    Returns:
        () bool, whether it occurs; never where obstacles are not known (None).

    Source: Francis et al. (2023), Fig. 7 j and k.
    """
    obstacles = moment.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    dx, dy = moment.heading[0], moment.heading[1]
    left, right = jnp.stack([-dy, dx]), jnp.stack([dy, -dx])
    free = _ray_length(obstacles, moment.position, moment.heading)
    limit = moment.robot_radius + moment.person_radius + thresholds.personal

    def narrow(ahead: Array) -> Array:
        place = moment.position + ahead * moment.heading
        width = _ray_length(obstacles, place, left) + _ray_length(obstacles, place, right)
        return (width < limit) & (ahead <= free)

    places = jnp.arange(SAMPLES + 1).astype(float) * (thresholds.personal / SAMPLES)
    person_near = any_person(moment, lambda agent: near(moment.position, agent.position, thresholds.near))
    return person_near & jax.vmap(narrow)(places).any()


def _crossing(
    x1: Float[Array, "2"], d1: Float[Array, "2"], x2: Float[Array, "2"], d2: Float[Array, "2"]
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Distances [m] along two unit headings to where the lines cross, and the sine of the angle between them."""
    cross = d1[0] * d2[1] - d1[1] * d2[0]
    parallel = jnp.abs(cross) < 1e-6
    inverse = 1.0 / jnp.where(parallel, 1.0, cross)
    gap = x2 - x1
    first = (gap[0] * d2[1] - gap[1] * d2[0]) * inverse
    second = (gap[0] * d1[1] - gap[1] * d1[0]) * inverse
    return first, second, jnp.where(parallel, 0.0, cross)


def _blocks(obstacles: Obstacles, p: Float[Array, "2"], q: Float[Array, "2"]) -> Bool[Array, " W"]:
    """Which obstacles the straight line from p [m] to q [m] crosses."""
    return jax.vmap(lambda box: crosses_box(p[0], p[1], q[0], q[1], box, 0.0))(obstacles)


def _ray_length(obstacles: Obstacles, place: Float[Array, "2"], direction: Float[Array, "2"]) -> Float[Array, ""]:
    """Distance [m] from a place [m] along a unit direction to the nearest obstacle, ``FAR`` if none; 0 inside one."""

    def distance(box: Obstacles) -> Array:
        cosine, sine = jnp.cos(box.yaw), jnp.sin(box.yaw)
        x, y = rotate(place[0] - box.center[0], place[1] - box.center[1], cosine, -sine)
        dx, dy = rotate(direction[0], direction[1], cosine, -sine)
        near_x, far_x = _slab(x, dx, box.half_extent[0])
        near_y, far_y = _slab(y, dy, box.half_extent[1])
        enter, leave = jnp.maximum(near_x, near_y), jnp.minimum(far_x, far_y)
        return jnp.where((enter < leave) & (leave > 0), jnp.maximum(enter, 0.0), FAR)

    return jnp.min(jax.vmap(distance)(obstacles), initial=FAR)


def _slab(x: Array, dx: Array, half: Array) -> tuple[Array, Array]:
    """Distances [m] at which a ray enters and leaves |x| < half [m]."""
    steep = jnp.abs(dx) > 1e-9
    inverse = 1.0 / jnp.where(steep, dx, 1.0)
    one, other = (-half - x) * inverse, (half - x) * inverse
    within = jnp.abs(x) < half
    enter = jnp.where(steep, jnp.minimum(one, other), jnp.where(within, -FAR, FAR))
    return enter, jnp.where(steep, jnp.maximum(one, other), jnp.where(within, FAR, -FAR))


MORE_SITUATIONS = {
    "overtaking": overtaking,
    "frontal_approach": frontal_approach,
    "following": following,
    "crowded": crowded,
    "blind_corner": blind_corner,
    "narrow_passage": narrow_passage,
}
"""Situations beyond the paper's five, as its future work asks: (moment, thresholds) -> () bool."""

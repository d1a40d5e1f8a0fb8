"""Situations of the configuration of objects (section VI): blind corner, narrow passage, occlusion, activity space.

All read ``moment.obstacles``, and cost some W rays or N times W segments. Blind corner and narrow passage are of the
taxonomy of Francis et al., "Principles and Guidelines for Evaluating Social Robot Navigation Algorithms" (2023).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from sean_jax.base import Array, Moment, Obstacles, Pedestrians
from sean_jax.classifiers.predicates import ahead_and_aside, any_person, near, walking
from sean_jax.classifiers.situations import Situation, Thresholds
from sean_jax.geometry import crosses_box, rotate

SAMPLES = 4  # places ahead, besides the robot's own, at which the width of its way is measured
FAR = 1e3  # m, length of a ray that hits nothing


def blind_corner(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """Robot and person cannot see each other, and their ways meet behind the corner.

    Both moving and within 2 ``reach``; an obstacle at least ``hides`` high stands on the line between them; their
    ways, followed straight on, cross at more than the angle A, within ``reach`` of each, and no obstacle of any
    height stands on either way before that place.

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


def occlusion(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """Somebody is near, but an object stands between: robot and person cannot see each other.

    Near(x_r, x_p) as in the paper, and an obstacle at least ``hides`` high on the line between them.

    Returns:
        () bool, whether it occurs; never where obstacles are not known (None).
    Source: section VI, "the configuration of objects in the environment"; the inequalities are ours.
    """
    obstacles = moment.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    high = obstacles.height >= thresholds.hides

    def holds(agent: Pedestrians) -> Array:
        between = _blocks(obstacles, moment.position, agent.position) & high
        return near(moment.position, agent.position, thresholds.near) & between.any()

    return any_person(moment, holds)


def activity_space(moment: Moment, thresholds: Thresholds) -> Bool[Array, ""]:
    """The robot is between a person and the object that the person is busy with, or about to cross there.

    Somebody in no group stands and faces an obstacle, whose face in that direction is less than ``engaged`` away. The
    activity space is what lies between, up to the sum of the radii beside the line of sight. The robot's centre is
    inside it; or the robot moves, and its way, straight on and as far as it is free, crosses the line of sight within
    ``personal``. Edges of the floor, of no height, are no objects.

    Returns:
        () bool, whether it occurs; never where obstacles are not known (None).
    Source: F. Lindner & C. Eschenbach, "Towards a Formalization of Social Spaces for Socially Aware Robots", COSIT
    2011; J. Rios-Martinez et al., "From Proxemics Theory to Socially-Aware Navigation: A Survey", 2015.
    """
    obstacles = moment.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    touch = moment.robot_radius + moment.person_radius
    free = jnp.minimum(_ray_length(obstacles, moment.position, moment.heading), thresholds.personal)
    moves = walking(moment.velocity, thresholds.moving)
    solid = obstacles.height > 0.0

    def holds(agent: Pedestrians) -> Array:
        depth = _ray_length(obstacles, agent.position, agent.heading, solid)
        ahead, aside = ahead_and_aside(agent.heading, moment.position - agent.position)
        inside = (ahead > 0) & (ahead < depth) & (jnp.abs(aside) < touch)
        own, other, _ = _crossing(moment.position, moment.heading, agent.position, agent.heading)
        crosses = moves & (own > 0) & (own < free) & (other > 0) & (other < depth)
        return (
            ~walking(agent.velocity, thresholds.moving)
            & (agent.group < 0)
            & (depth < thresholds.engaged)
            & (inside | crosses)
        )

    return any_person(moment, holds)


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


def _ray_length(
    obstacles: Obstacles,
    place: Float[Array, "2"],
    direction: Float[Array, "2"],
    counts: Bool[Array, " W"] | None = None,
) -> Float[Array, ""]:
    """Distance [m] from a place [m] along a unit direction to the nearest obstacle, ``FAR`` if none; 0 inside one.

    The ray passes obstacles that do not count.
    """

    def distance(box: Obstacles) -> Array:
        cosine, sine = jnp.cos(box.yaw), jnp.sin(box.yaw)
        x, y = rotate(place[0] - box.center[0], place[1] - box.center[1], cosine, -sine)
        dx, dy = rotate(direction[0], direction[1], cosine, -sine)
        near_x, far_x = _slab(x, dx, box.half_extent[0])
        near_y, far_y = _slab(y, dy, box.half_extent[1])
        enter, leave = jnp.maximum(near_x, near_y), jnp.minimum(far_x, far_y)
        return jnp.where((enter < leave) & (leave > 0), jnp.maximum(enter, 0.0), FAR)

    lengths = jax.vmap(distance)(obstacles)
    return jnp.min(lengths if counts is None else jnp.where(counts, lengths, FAR), initial=FAR)


def _slab(x: Array, dx: Array, half: Array) -> tuple[Array, Array]:
    """Distances [m] at which a ray enters and leaves |x| < half [m]."""
    steep = jnp.abs(dx) > 1e-9
    inverse = 1.0 / jnp.where(steep, dx, 1.0)
    one, other = (-half - x) * inverse, (half - x) * inverse
    within = jnp.abs(x) < half
    enter = jnp.where(steep, jnp.minimum(one, other), jnp.where(within, -FAR, FAR))
    return enter, jnp.where(steep, jnp.maximum(one, other), jnp.where(within, FAR, -FAR))


OBJECT_SITUATIONS: dict[str, Situation] = {
    "blind_corner": blind_corner,
    "narrow_passage": narrow_passage,
    "occlusion": occlusion,
    "activity_space": activity_space,
}
"""Situations of which none occurs where obstacles are not known: (moment, thresholds) -> () bool."""

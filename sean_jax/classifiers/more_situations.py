"""Situations beyond the paper's five (section VI): overtaking, frontal approach, crowds, objects and urgency.

From the taxonomy of social navigation scenarios by Francis et al., "Principles and Guidelines for Evaluating Social
Robot Navigation Algorithms" (2023), Fig. 7, unless a source is named. That paper names them by example; the
inequalities are ours. "Moving" is faster than 0.1 m/s, since standing agents are obstructions. ``ahead`` and ``aside``
are the parts of a person's position along the robot's heading and to its left.

Situations of objects read ``snapshot.obstacles``, W boxes, and never occur if that is None. They cost some W rays or N
times W segments. Urgency is computed from positions and velocities; a deadline of the task is not part of it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from sean_jax.classifiers.predicates import ahead_and_aside, any_person, cosine, near, walking
from sean_jax.classifiers.situations import Situation, Thresholds
from sean_jax.core.data_types import Array, Obstacles, Pedestrians, Snapshot
from sean_jax.core.geometry import TINY, crosses_box, length, rotate

SAMPLES = 4  # places ahead, beside the robot's own, at which the width of its way is measured
FAR = 1e3  # m, length of a ray that hits nothing


def overtaking(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """The faster of robot and person passes the slower one in the same direction.

    Headings parallel within A, both moving, speeds at least ``gaining`` apart, |aside| < ``personal``, and the faster
    one behind or beside (not ahead by the sum of the radii or more), within ``reach``.

    Source: Fig. 7 c and d.
    """
    touch = snapshot.robot_radius + snapshot.person_radius

    def holds(agent: Pedestrians) -> Array:
        ahead, aside = ahead_and_aside(snapshot.heading, agent.position - snapshot.position)
        faster = _speed(snapshot.velocity) - _speed(agent.velocity)
        before = jnp.where(faster > 0, ahead, -ahead)  # distance of the slower one ahead of the faster one
        return (
            _both_move(snapshot, agent, thresholds)
            & (cosine(snapshot.heading, agent.heading) >= jnp.cos(thresholds.angle))
            & (jnp.abs(faster) >= thresholds.gaining)
            & (jnp.abs(aside) < thresholds.personal)
            & (before > -touch)
            & (before < thresholds.reach)
        )

    return any_person(snapshot, holds)


def following(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """The robot walks behind a person, about as fast.

    Headings parallel within A, both moving, speeds less than ``gaining`` apart, |aside| < ``personal``, and the person
    ahead by more than the sum of the radii and less than ``reach``. Excludes overtaking of the same person.

    Source: Fig. 7 r.
    """
    touch = snapshot.robot_radius + snapshot.person_radius

    def holds(agent: Pedestrians) -> Array:
        ahead, aside = ahead_and_aside(snapshot.heading, agent.position - snapshot.position)
        return (
            _both_move(snapshot, agent, thresholds)
            & (cosine(snapshot.heading, agent.heading) >= jnp.cos(thresholds.angle))
            & (jnp.abs(_speed(snapshot.velocity) - _speed(agent.velocity)) < thresholds.gaining)
            & (jnp.abs(aside) < thresholds.personal)
            & (ahead > touch)
            & (ahead < thresholds.reach)
        )

    return any_person(snapshot, holds)


def frontal_approach(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Robot and person come head on, and would pass close.

    Headings opposite within A, both moving, the person ahead, within ``reach``, and |aside| < ``personal``.

    Source: Fig. 7 a.
    """

    def holds(agent: Pedestrians) -> Array:
        ahead, aside = ahead_and_aside(snapshot.heading, agent.position - snapshot.position)
        between = cosine(snapshot.heading, agent.heading)
        return (
            _both_move(snapshot, agent, thresholds)
            & (between >= -1.5)  # -2: no direction at all
            & (between <= -jnp.cos(thresholds.angle))
            & (jnp.abs(aside) < thresholds.personal)
            & (ahead > 0)
            & (ahead < thresholds.reach)
        )

    return any_person(snapshot, holds)


def crowded(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """People stand or walk close together around the robot.

    Density of people on the disc of radius D around the robot of ``crowd`` or more: six people within 2.4 m. The disc
    counts as free floor, also where walls are.

    Source: Fig. 7 u and y.
    """
    people = snapshot.people
    gaps = people.position - snapshot.position[None, :]
    inside = (gaps * gaps).sum(-1) < thresholds.near * thresholds.near
    number = (inside & people.present).sum().astype(float)
    return number >= thresholds.crowd * jnp.pi * thresholds.near * thresholds.near


def blind_corner(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Robot and person cannot see each other, and their ways meet behind the corner.

    Both moving and within 2 ``reach``; an obstacle at least ``hides`` high stands on the line between them; their
    ways, followed straight on, cross at more than the angle A, within ``reach`` of each, and no obstacle of any
    height stands on either way before that place.

    Source: Fig. 7 i.
    """
    obstacles = snapshot.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    high = obstacles.height >= thresholds.hides

    def holds(agent: Pedestrians) -> Array:
        by_robot, by_person, sine = _crossing(snapshot.position, snapshot.heading, agent.position, agent.heading)
        place = snapshot.position + by_robot * snapshot.heading
        return (
            walking(snapshot.velocity, thresholds.moving)
            & walking(agent.velocity, thresholds.moving)
            & near(snapshot.position, agent.position, 2 * thresholds.reach)
            & (jnp.abs(sine) > jnp.sin(thresholds.angle))
            & (by_robot > 0)
            & (by_robot < thresholds.reach)
            & (by_person > 0)
            & (by_person < thresholds.reach)
            & (_blocks(obstacles, snapshot.position, agent.position) & high).any()
            & ~_blocks(obstacles, snapshot.position, place).any()
            & ~_blocks(obstacles, agent.position, place).any()
        )

    return any_person(snapshot, holds)


def narrow_passage(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """A person is near in a hallway or doorway where two cannot pass without coming close.

    The way is narrow where obstacles to the left and right leave less than both radii and ``personal`` across: even
    along opposite walls, the centres come within ``personal``. The width is measured at right angles to the heading, at
    the robot and at four places up to ``personal`` ahead, as far as the way is free.

    Source: Fig. 7 j and k.
    """
    obstacles = snapshot.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    dx = snapshot.heading[0]
    dy = snapshot.heading[1]
    left = jnp.stack([-dy, dx])
    right = jnp.stack([dy, -dx])
    free = _ray_length(obstacles, snapshot.position, snapshot.heading)
    limit = snapshot.robot_radius + snapshot.person_radius + thresholds.personal

    def narrow(ahead: Array) -> Array:
        place = snapshot.position + ahead * snapshot.heading
        width = _ray_length(obstacles, place, left) + _ray_length(obstacles, place, right)
        return (width < limit) & (ahead <= free)

    places = jnp.arange(SAMPLES + 1).astype(float) * (thresholds.personal / SAMPLES)
    person_near = any_person(snapshot, lambda agent: near(snapshot.position, agent.position, thresholds.near))
    return person_near & jax.vmap(narrow)(places).any()


def occlusion(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """A person is near, but an object in between hides robot and person from each other.

    Near(x_r, x_p) as in the paper, and an obstacle at least ``hides`` high on the line between them.

    Source: section VI, "the configuration of objects in the environment"; the inequalities are ours.
    """
    obstacles = snapshot.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    high = obstacles.height >= thresholds.hides

    def holds(agent: Pedestrians) -> Array:
        between = _blocks(obstacles, snapshot.position, agent.position) & high
        return near(snapshot.position, agent.position, thresholds.near) & between.any()

    return any_person(snapshot, holds)


def activity_space(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """The robot is between a person and the object of their activity, or about to cross there.

    A person in no group stands and faces an obstacle, whose face in that direction is less than ``engaged`` away. The
    activity space lies between them, up to the sum of the radii beside the line of sight. The robot's centre is inside
    it; or the robot moves, and its straight path, as far as it is free, crosses the line of sight within
    ``personal``. Edges of the floor, of no height, are no objects.

    Source: F. Lindner & C. Eschenbach, "Towards a Formalization of Social Spaces for Socially Aware Robots", COSIT
    2011; J. Rios-Martinez et al., "From Proxemics Theory to Socially-Aware Navigation: A Survey", 2015.
    """
    obstacles = snapshot.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    touch = snapshot.robot_radius + snapshot.person_radius
    free = jnp.minimum(_ray_length(obstacles, snapshot.position, snapshot.heading), thresholds.personal)
    moves = walking(snapshot.velocity, thresholds.moving)
    solid = obstacles.height > 0.0

    def holds(agent: Pedestrians) -> Array:
        depth = _ray_length(obstacles, agent.position, agent.heading, solid)
        ahead, aside = ahead_and_aside(agent.heading, snapshot.position - agent.position)
        inside = (ahead > 0) & (ahead < depth) & (jnp.abs(aside) < touch)
        by_robot, by_person, _ = _crossing(snapshot.position, snapshot.heading, agent.position, agent.heading)
        crosses = moves & (by_robot > 0) & (by_robot < free) & (by_person > 0) & (by_person < depth)
        return (
            ~walking(agent.velocity, thresholds.moving)
            & (agent.group < 0)
            & (depth < thresholds.engaged)
            & (inside | crosses)
        )

    return any_person(snapshot, holds)


def collision_course(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Robot and person would touch within seconds if both kept their velocities.

    The time to collision is at most ``imminent``: at some t from 0 to it, the centres are closer than the sum of the
    radii. Contact counts as well.

    Source: I. Karamouzas, B. Skinner & S. Guy, "Universal Power Law Governing Pedestrian Interactions", Physical Review
    Letters 113, 2014: people react to collisions that are up to about 3 s away.
    """
    touch = snapshot.robot_radius + snapshot.person_radius

    def holds(agent: Pedestrians) -> Array:
        gap = agent.position - snapshot.position
        relative = agent.velocity - snapshot.velocity
        square = (relative * relative).sum()
        still = square < TINY
        nearest = -(gap * relative).sum() / jnp.where(still, 1.0, square)  # s, when the centres are closest
        time = jnp.where(still, 0.0, jnp.clip(nearest, 0.0, thresholds.imminent))
        return near(gap + time * relative, jnp.zeros_like(gap), touch)

    return any_person(snapshot, holds)


def hurrying(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """A person in a hurry comes the robot's way, from any side, so that it has to make way.

    The person is faster than ``hurry``, and the robot lies less than ``reach`` ahead and less than ``personal`` aside
    of the direction in which the person moves.

    Source: section VI, "urgency"; the inequalities are ours. U. Weidmann, "Transporttechnik der Fussgaenger", 1993:
    people walk at 1.34 m/s with a standard deviation of 0.26 m/s, so 2.3 % of them are faster than 1.86 m/s.
    """

    def holds(agent: Pedestrians) -> Array:
        # Both are times the speed, which may be zero and so is not divided by.
        ahead, aside = ahead_and_aside(agent.velocity, snapshot.position - agent.position)
        square = (agent.velocity * agent.velocity).sum()
        return (
            walking(agent.velocity, thresholds.hurry)
            & (ahead > 0)
            & (ahead * ahead < thresholds.reach * thresholds.reach * square)
            & (aside * aside < thresholds.personal * thresholds.personal * square)
        )

    return any_person(snapshot, holds)


def _both_move(snapshot: Snapshot, agent: Pedestrians, thresholds: Thresholds) -> Array:
    return walking(snapshot.velocity, thresholds.moving) & walking(agent.velocity, thresholds.moving)


def _speed(velocity: Array) -> Array:
    return length(velocity[0], velocity[1])


def _crossing(
    x1: Float[Array, "2"], d1: Float[Array, "2"], x2: Float[Array, "2"], d2: Float[Array, "2"]
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Distances [m] along two unit headings to the crossing of the lines, and the sine of the angle between them."""
    cross = d1[0] * d2[1] - d1[1] * d2[0]
    parallel = jnp.abs(cross) < 1e-6
    inverse = 1.0 / jnp.where(parallel, 1.0, cross)
    gap = x2 - x1
    first = (gap[0] * d2[1] - gap[1] * d2[0]) * inverse
    second = (gap[0] * d1[1] - gap[1] * d1[0]) * inverse
    return first, second, jnp.where(parallel, 0.0, cross)


def _blocks(obstacles: Obstacles, p: Float[Array, "2"], q: Float[Array, "2"]) -> Bool[Array, " W"]:
    """Whether the straight line from p [m] to q [m] crosses each obstacle."""
    return jax.vmap(lambda box: crosses_box(p[0], p[1], q[0], q[1], box, 0.0))(obstacles)


def _ray_length(
    obstacles: Obstacles,
    place: Float[Array, "2"],
    direction: Float[Array, "2"],
    counts: Bool[Array, " W"] | None = None,
) -> Float[Array, ""]:
    """Distance [m] from a place [m] along a unit direction to the nearest obstacle that counts.

    ``FAR`` if there is none; 0 inside one.
    """

    def distance(box: Obstacles) -> Array:
        cosine = jnp.cos(box.yaw)
        sine = jnp.sin(box.yaw)
        x, y = rotate(place[0] - box.center[0], place[1] - box.center[1], cosine, -sine)
        dx, dy = rotate(direction[0], direction[1], cosine, -sine)
        near_x, far_x = _slab(x, dx, box.half_extent[0])
        near_y, far_y = _slab(y, dy, box.half_extent[1])
        enter = jnp.maximum(near_x, near_y)
        leave = jnp.minimum(far_x, far_y)
        return jnp.where((enter < leave) & (leave > 0), jnp.maximum(enter, 0.0), FAR)

    lengths = jax.vmap(distance)(obstacles)
    return jnp.min(lengths if counts is None else jnp.where(counts, lengths, FAR), initial=FAR)


def _slab(x: Array, dx: Array, half: Array) -> tuple[Array, Array]:
    """Distances [m] at which a ray enters and leaves |x| < half [m]."""
    steep = jnp.abs(dx) > 1e-9
    inverse = 1.0 / jnp.where(steep, dx, 1.0)
    low = (-half - x) * inverse
    high = (half - x) * inverse
    within = jnp.abs(x) < half
    enter = jnp.where(steep, jnp.minimum(low, high), jnp.where(within, -FAR, FAR))
    leave = jnp.where(steep, jnp.maximum(low, high), jnp.where(within, FAR, -FAR))
    return enter, leave


OBJECT_SITUATIONS: dict[str, Situation] = {
    "blind_corner": blind_corner,
    "narrow_passage": narrow_passage,
    "occlusion": occlusion,
    "activity_space": activity_space,
}
"""Situations that do not occur without known obstacles: name -> (snapshot, thresholds) -> () bool"""

MORE_SITUATIONS: dict[str, Situation] = {
    "overtaking": overtaking,
    "frontal_approach": frontal_approach,
    "following": following,
    "crowded": crowded,
    **OBJECT_SITUATIONS,
    "collision_course": collision_course,
    "hurrying": hurrying,
}
"""name -> (snapshot, thresholds) -> () bool"""

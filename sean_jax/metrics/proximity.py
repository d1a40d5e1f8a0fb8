"""Metrics of people and obstacles near the robot (section IV-H): violations of distance, collisions, comfort.

An event is an entry: a person's distance to the robot falls below the limit, and was above it a step before. The
distance of violations is that of the centres, as in the paper, or, with ``Snapshot.to_surface``, a person's radius
less, as in SEAN's code. The fault rule is SEAN's: robot on person if the robot moves and its velocity has a part
towards the person, else person on robot.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Snapshot
from sean_jax.core.geometry import TINY, from_box, length, sum_vectors, unit
from sean_jax.metrics.metric import Metric, count_onsets, duration, minimum, share_of_time, total

INTIMATE = 0.45  # m [Hall; section IV-H]
PERSONAL = 1.2  # m [Hall; section IV-G]
TOUCH = 0.01  # m, SEAN's margin around bodies
MOVING = 5e-4  # m/s: SEAN rounds the robot's speed to three decimals
NONE = 1e3  # m, distance to people or obstacles if there are none
SPACE = 0.5  # m, of the iGibson social navigation challenge
HORIZON = 30.0  # s: later collisions count as one then
STRENGTH = 7.0  # m/s2, V0 / sigma of Helbing & Molnar (1995), circular
RANGE = 0.3  # m, their sigma
LOOKING = 0.9961947  # cosine of 5 degrees (Arena-Rosnav)
VISIBLE = 3.6  # m, the end of social distance [Hall]: people farther away do not meet the robot


# --- people ---


def _intimate_limit(snapshot: Snapshot) -> Float[Array, ""]:
    """Intimate distance [m] of the centres."""
    return _limit(snapshot, INTIMATE)


def _personal_limit(snapshot: Snapshot) -> Float[Array, ""]:
    """Personal distance [m] of the centres."""
    return _limit(snapshot, PERSONAL)


def _limit(snapshot: Snapshot, distance: float) -> Array:
    return snapshot.person_radius + distance if snapshot.to_surface else jnp.full_like(snapshot.robot_radius, distance)


def _touch_limit(snapshot: Snapshot) -> Float[Array, ""]:
    """Distance [m] at which the bodies of robot and person touch, with SEAN's margin of 1 cm."""
    return snapshot.robot_radius + snapshot.person_radius + TOUCH


def _squares(snapshot: Snapshot) -> Array:
    """(N,) m2, squared distance from the robot to each person, infinite for those absent."""
    gap = snapshot.people.position - snapshot.position[None, :]
    return jnp.where(snapshot.people.present, (gap * gap).sum(1), jnp.inf)


def _distance_to_people(snapshot: Snapshot) -> Array:
    square = jnp.min(_squares(snapshot), initial=jnp.inf)
    alone = ~jnp.isfinite(square)
    touching = square < TINY
    return jnp.where(alone, NONE, jnp.where(touching, 0.0, jnp.sqrt(jnp.where(alone | touching, 1.0, square))))


def _robot_at_fault(snapshot: Snapshot) -> Array:
    """(N,) bool: the robot moves, and partly towards the person."""
    toward = (snapshot.velocity[None, :] * (snapshot.people.position - snapshot.position[None, :])).sum(1) > 0.0
    moving = (snapshot.velocity * snapshot.velocity).sum() > MOVING * MOVING
    return toward & moving


def _person_at_fault(snapshot: Snapshot) -> Array:
    return ~_robot_at_fault(snapshot)


def _entries(limit: Callable[[Snapshot], Array], fault: Callable[[Snapshot], Array]) -> Metric:
    """Entries of people into the circle of that limit around the robot that are the fault of one side."""
    return count_onsets(lambda snapshot: _squares(snapshot) <= limit(snapshot) ** 2, fault)


intimate_robot_on_person = _entries(_intimate_limit, _robot_at_fault)
"""Number of times that the moving robot came within 0.45 m of a person."""

intimate_person_on_robot = _entries(_intimate_limit, _person_at_fault)
"""Number of times that a person came within 0.45 m of the robot."""

personal_robot_on_person = _entries(_personal_limit, _robot_at_fault)
"""Number of times that the moving robot came within 1.2 m of a person."""

personal_person_on_robot = _entries(_personal_limit, _person_at_fault)
"""Number of times that a person came within 1.2 m of the robot."""

collision_robot_on_person = _entries(_touch_limit, _robot_at_fault)
"""Number of times that the moving robot touched a person."""

collision_person_on_robot = _entries(_touch_limit, _person_at_fault)
"""Number of times that a person touched the robot."""

min_distance_to_people = minimum(_distance_to_people, by_situation=False)
"""Minimum distance from the robot's centre to a person's; 1000 where there is nobody."""


# --- obstacles ---


def obstacle_distance(snapshot: Snapshot) -> Float[Array, ""]:
    """Distance [m] from the robot's centre to the nearest obstacle, negative inside; 1000 where none is known."""
    if snapshot.obstacles is None:
        return jnp.full_like(snapshot.geodesic, NONE)
    x = snapshot.position[0]
    y = snapshot.position[1]
    distances = jax.vmap(from_box, in_axes=(None, None, 0))(x, y, snapshot.obstacles)[0]
    return jnp.min(distances, initial=NONE)


def _touches_obstacle(snapshot: Snapshot) -> Array:
    return obstacle_distance(snapshot) <= snapshot.robot_radius + TOUCH


collision_with_obstacle = count_onsets(_touches_obstacle)
"""Times that the robot touched an obstacle, after no contact one step before: within its radius and 1 cm.

SEAN's code also counts obstacles that come within 1.2 m and 0.45 m; this counts the body alone.
"""

min_distance_to_obstacles = minimum(obstacle_distance)
"""Minimum distance from the robot's centre to the surface of an obstacle; 1000 where there is none."""


# --- other robots of a team ---


def _gaps_to_robots(snapshot: Snapshot) -> Array:
    """(R,) m, from the surface of the robot to that of each other robot of its team."""
    if snapshot.robots is None:
        return jnp.zeros(0, snapshot.position.dtype)
    x, y = (snapshot.robots[:, :2] - snapshot.position[None, :]).T
    return length(x, y) - snapshot.robots[:, 2] - snapshot.robot_radius


def _distance_to_robots(snapshot: Snapshot) -> Array:
    return jnp.min(_gaps_to_robots(snapshot), initial=NONE)


collision_with_robot = count_onsets(
    lambda snapshot: _gaps_to_robots(snapshot) <= TOUCH,
    title="collisions with robots",
    definition="Number of times that the robot and another robot touched: within 1 cm, and not one step before.",
    better="lower",
)
"""Number of times that the robot and another robot of its team touched; each of the two counts it."""

min_distance_to_robots = minimum(
    _distance_to_robots,
    by_situation=False,
    title="minimum distance to robots",
    unit="m",
    definition="Distance between the surfaces of the robot and of the nearest other robot, when it was nearest.",
    better="higher",
    headline=False,
)
"""Minimum distance between the surfaces of the robot and of another robot of its team; 1000 where there is none."""


# --- groups of people ---


def _entries_of_groups(
    groups: Callable[[Snapshot], Array], margin: Callable[[Snapshot], Array], **words: Any
) -> Metric:
    """Entries of the moving robot's centre into the circles of groups of two or more.

    A circle is around the members' mean, and its radius is their mean distance from it less ``margin`` [m].
    ``groups`` are (N,) numbers of groups, -1 none.
    """

    def inside(snapshot: Snapshot) -> tuple[Array, Array]:
        """(N, N) bool, pairs of people in one group; (N,) bool, whether the robot is in the circle of their group."""
        # Absent people keep a number of a group, but belong to none.
        people = snapshot.people
        group = jnp.where(people.present, groups(snapshot), -1)
        same = (group[:, None] == group[None, :]) & (group >= 0)[:, None]  # (N, N)
        members = jnp.maximum(same.sum(1), 1).astype(float)
        middle = jnp.where(same[..., None], people.position[None], 0.0).sum(1) / members[:, None]  # (N, 2)

        # The circle is the o-space of an F-formation (A. Kendon, 1990): members stand around it, not in it.
        dx, dy = (people.position[None] - middle[:, None]).transpose(2, 0, 1)
        radius = jnp.where(same, length(dx, dy), 0.0).sum(1) / members - margin(snapshot)

        # A robot that stands is not to blame if a group forms around it.
        gap = snapshot.position[None, :] - middle  # (N, 2)
        moving = (snapshot.velocity * snapshot.velocity).sum() > MOVING * MOVING
        return same, (members > 1.0) & moving & (length(gap[:, 0], gap[:, 1]) < radius)

    def entries(before: Snapshot, after: Snapshot) -> Array:
        same, in_circle = inside(after)
        first_member = jnp.argmax(same, axis=1) == jnp.arange(len(in_circle))  # so that each group counts once

        # Numbers of groups and not people are compared, because members may come and go between two steps.
        same_group = groups(after)[:, None] == groups(before)[None, :]
        _, was_in_circle = inside(before)
        stays = same_group & was_in_circle[None, :]
        return (in_circle & first_member & ~stays.any(1)).sum().astype(float)

    return replace(total(entries, better="lower", headline=False, **words), kind="count")


def _other_groups(snapshot: Snapshot) -> Array:
    """(N,) numbers of standing groups; -1 for those of the robot's task."""
    group = snapshot.people.group
    return jnp.where((group == snapshot.start_group) | (group == snapshot.goal_group), -1, group)


o_spaces_crossed = _entries_of_groups(
    _other_groups,
    lambda snapshot: snapshot.person_radius,
    title="o-spaces crossed",
    definition="Number of times that the moving robot came between the members of a standing group, its task's aside.",
)
"""Times that the robot's centre entered a standing group's circle, within the members' bodies (Kendon's o-space)."""

groups_split = _entries_of_groups(
    lambda snapshot: snapshot.people.walking_group,
    lambda snapshot: jnp.zeros_like(snapshot.person_radius),
    title="groups split",
    definition="Number of times that the moving robot came between people who walk together.",
)
"""Times that the robot's centre entered the circle of people who walk together."""


# --- seconds of contact, for rewards ---


def _robot_touches_person(snapshot: Snapshot) -> Array:
    touching = _squares(snapshot) <= _touch_limit(snapshot) ** 2
    return (touching & _robot_at_fault(snapshot)).any()


def _is_intimate(snapshot: Snapshot) -> Array:
    return (_squares(snapshot) <= _intimate_limit(snapshot) ** 2).any()


CONTACT_TIME = duration(
    _robot_touches_person, definition="Seconds in which the robot touches and moves towards a person."
)
OBSTACLE_TIME = duration(_touches_obstacle, definition="Seconds in which the robot touches an obstacle.")
INTIMATE_TIME = duration(_is_intimate, definition="Seconds with a person within 0.45 m of the robot.")


# --- comfort ---


def collision_time(
    x: Float[Array, "*shape"],
    y: Float[Array, "*shape"],
    vx: Float[Array, "*shape"],
    vy: Float[Array, "*shape"],
    reach: Float[Array, "#*shape"] | float,
) -> Float[Array, "*shape"]:
    """Time [s] until discs of constant velocities touch: the smallest t >= 0 with |d + v t| <= reach, else infinite.

    Args:
        x, y: (...) m, the relative position d.
        vx, vy: (...) m/s, the relative velocity v.
        reach: m, sum of both radii; it broadcasts.
    """
    speeds = vx * vx + vy * vy
    product = x * vx + y * vy
    outside = x * x + y * y - reach * reach
    inner = product * product - speeds * outside
    meets = (product < 0.0) & (inner > 0.0) & (speeds > TINY)
    root = jnp.sqrt(jnp.where(meets, inner, 1.0))
    # c / (-b + root) is (-b - root) / a without the difference of nearly equal numbers.
    time = outside / jnp.where(meets, root - product, 1.0)
    return jnp.where(outside <= 0.0, 0.0, jnp.where(meets, time, jnp.inf))


def _gap(snapshot: Snapshot) -> tuple[Array, Array]:
    """(N,) x and y [m] from the robot to each person."""
    gap = snapshot.people.position - snapshot.position[None, :]
    return gap[:, 0], gap[:, 1]


def _respects_space(snapshot: Snapshot) -> Array:
    x, y = _gap(snapshot)
    return ~((x * x + y * y < SPACE * SPACE) & snapshot.people.present).any()


def _time_to_collision(snapshot: Snapshot) -> Array:
    x, y = _gap(snapshot)
    relative = snapshot.people.velocity - snapshot.velocity[None, :]
    time = collision_time(x, y, relative[:, 0], relative[:, 1], snapshot.robot_radius + snapshot.person_radius)
    return jnp.min(jnp.where(snapshot.people.present, time, HORIZON), initial=HORIZON)


def _work(before: Snapshot, after: Snapshot) -> Array:
    x, y = _gap(after)
    distance = length(x, y)
    push = jnp.where(after.people.present, STRENGTH * jnp.exp(-distance / RANGE), 0.0)
    away_x, away_y = unit(x, y)
    robot = length(*sum_vectors(push * away_x, push * away_y, 0))
    return after.time_step * (robot + push.sum())


def _is_looked_at(snapshot: Snapshot) -> Array:
    x, y = _gap(snapshot)
    distance = length(x, y)
    heading = snapshot.people.heading
    toward = -(heading[:, 0] * x + heading[:, 1] * y) >= LOOKING * distance
    return (toward & (distance <= VISIBLE) & snapshot.people.present).any()


personal_space_compliance = share_of_time(_respects_space)
"""Share of the steps in which all people are 0.5 m or farther away, centre to centre (PSC)."""

min_time_to_collision = minimum(_time_to_collision)
"""Minimum time until the robot and a person would touch, at most 30 s, if both kept their velocities.

At each step the smallest t >= 0 with |d + v t| <= r_robot + r_person over all people, d and v relative.
"""

social_work = total(_work)
"""Social-force work: dt (|sum_i f_i| + sum_i |f_i|) summed over the steps, on the robot and on all people, per mass.

The robot and person i push each other with f = (V0 / sigma) exp(-d / sigma) = 7 m/s2 exp(-d / 0.3 m), d between
centres: the circular law of Helbing & Molnar (1995), with any law of people's motion, so that pedestrian models can be
compared. A sum of force over time, which HuNavSim calls work.
"""

time_looked_at = duration(_is_looked_at)
"""Time in which at least one person within 3.6 m faces the robot to within 5 degrees; obstacles hide nobody."""

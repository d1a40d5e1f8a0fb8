"""Shortest paths to a goal, looked up inside jit: length, next point, rotation, and the plan ahead (section V-B).

All functions take the ``PathsToGoal`` of the goal, which ``build_paths_to_goal`` makes once for a task. Positions and
goals are in metres.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, PathsToGoal
from sean_jax.core.geometry import angle_between, length, rotate, unit
from sean_jax.world.navigation.arcs import (
    ANGLE,
    push_out_of_obstacles,
    segment_is_free,
    segments_are_free,
    tangent_to_arc,
    tangents,
)
from sean_jax.world.navigation.tables import Navigation, arc_bits, cell_of, visible_words

STRIDE = 10.0  # degrees, of an arc: the next point lies up to that far ahead, which adds 1 % to the arc
MIN_STRIDE = 5e-3  # m, by which the next point is at least ahead
NARROW = 0.7  # of the radius: the free radius of a straight path in ``geodesic_approx``
PLAN_ARCS = 12  # arcs of a plan: more than lie on some metres of a path
FINE = 0.05  # m, between the places on a path among which the points of a plan are chosen
CURVED = 1.6  # length of path searched for a plan, relative to a straight plan
ROUNDING = 1e-3  # m


class PathStart(NamedTuple):
    """The beginning of the shortest path from a place."""

    straight: Bool[Array, ""]  # whether it goes straight to the goal
    around: Float[Array, ""]  # m, length of the shortest path by an arc; inf if there is none
    arc: Int[Array, ""]  # the first arc of that path
    place: Float[Array, "2"]  # m, where it begins, outside of the inflated obstacles
    free_radius: Float[Array, ""]  # m, with which segments from there have to be free


class ArcsToGoal(NamedTuple):
    """The shortest paths to a goal from the middle of each of V arcs."""

    distance: Float[Array, "V"]  # m; inf if there is none
    last_arc: Int[Array, "V"]  # the last arc of the path
    departure_angle: Float[Array, "V"]  # rad, where it leaves the first arc


def build_paths_to_goal(navigation: Navigation, goal: Float[Array, "2"]) -> PathsToGoal:
    """The shortest paths to a goal from all arcs."""
    distance, _, departure_angle = last_arcs(navigation, goal)
    return PathsToGoal(distance, departure_angle)


def geodesic(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> Float[Array, ""]:
    """Length [m] of the shortest path; inf without one."""
    gap = goal - position
    start = first_arc(navigation, position, goal, paths_to_goal)
    return jnp.where(start.straight, length(gap[0], gap[1]), start.around)


def geodesic_approx(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> Float[Array, ""]:
    """Length [m] of the shortest path within about a cell of the visibility grid: cheap for many positions at once."""
    gap = goal - position
    straight = segment_is_free(navigation.obstacles, position, goal, NARROW * navigation.radius)
    cell = cell_of(navigation.visible, navigation.origin, navigation.cell, position)
    visible = arc_bits(visible_words(navigation, *cell), navigation.arcs.side.shape[0])
    far, angle, *_ = tangents(navigation.arcs, position, navigation.radius, True)
    begin = jnp.where(visible, far - navigation.radius * angle, jnp.inf)
    # With the barrier, the minimum of a sum is some 20 times faster on a CPU than the minimum of a choice.
    around = jnp.min(jax.lax.optimization_barrier(begin) + paths_to_goal.distance)
    return jnp.where(straight, length(gap[0], gap[1]), around)


def next_point(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> Float[Array, "2"]:
    """The next point [m] of the shortest path; the goal if it is in sight or if there is no path.

    Otherwise it lies in the direction of the tangent to the next arc, up to 10 degrees of the arc beyond where the
    tangent touches. Going there, and from there to the next point, follows a path that is at most 1 % longer than the
    shortest.
    """
    straight, around, first, spot, free_radius = first_arc(navigation, position, goal, paths_to_goal)
    angle, _, touch, direction = tangent_to_arc(navigation.arcs, first, spot, navigation.radius)
    turn = jnp.clip(paths_to_goal.departure_angle[first] - angle, 0.0, 2 * jnp.radians(STRIDE))
    far = touch + jnp.maximum(navigation.radius * jnp.tan(0.5 * turn), MIN_STRIDE) * direction
    is_free = segment_is_free(navigation.obstacles, spot, far, free_radius)
    aim = jnp.where(is_free, far, touch + MIN_STRIDE * direction)
    return jnp.where(straight | ~jnp.isfinite(around), goal, aim)


def path_rotation(
    navigation: Navigation,
    position: Float[Array, "2"],
    heading: Float[Array, "2"],
    goal: Float[Array, "2"],
    paths_to_goal: PathsToGoal,
) -> Float[Array, ""]:
    """Rotation [rad] along the shortest path, left and right added up, without that at the goal.

    Without another path it is the straight path's.
    """
    arcs, radius = navigation.arcs, navigation.radius
    straight, around, first, spot, _ = first_arc(navigation, position, goal, paths_to_goal)
    last = last_arcs(navigation, goal).last_arc[first]
    arrival, _, _, direction = tangent_to_arc(arcs, first, spot, radius)
    end, _ = push_out_of_obstacles(navigation.obstacles, goal, radius)
    departure = tangents(arcs, end, radius, False).angle[last]
    directly = straight | ~jnp.isfinite(around)
    begin = jnp.abs(angle_between(heading, jnp.where(directly, goal - position, direction)))
    return begin + jnp.where(directly, 0.0, navigation.rotation[first, last] + departure - arrival)


def first_arc(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> PathStart:
    """The beginning of the shortest path."""
    arcs, radius = navigation.arcs, navigation.radius
    spot, free_radius = push_out_of_obstacles(navigation.obstacles, position, radius)
    end, end_radius = push_out_of_obstacles(navigation.obstacles, goal, radius)
    straight = segment_is_free(navigation.obstacles, spot, end, jnp.minimum(free_radius, end_radius))
    far, angle, x, y, on_arc = tangents(arcs, spot, radius, True)
    reachable = on_arc & (angle <= paths_to_goal.departure_angle + ANGLE)
    total = jnp.where(reachable, far - radius * angle + paths_to_goal.distance, jnp.inf)
    # Of the two arcs of a corner only the better one can be on the shortest path.
    right = total[1::2] < total[::2]
    total, x, y = (jnp.where(right, part[1::2], part[::2]) for part in (total, x, y))
    total = jnp.where(segments_are_free(navigation.obstacles, spot, x, y, free_radius), total, jnp.inf)
    best = jnp.argmin(total).astype(jnp.int32)
    return PathStart(straight, total[best], 2 * best + right[best].astype(jnp.int32), spot, free_radius)


def last_arcs(navigation: Navigation, goal: Float[Array, "2"]) -> ArcsToGoal:
    """The shortest paths to a goal from all arcs, with their last arcs."""
    radius = navigation.radius
    end, free_radius = push_out_of_obstacles(navigation.obstacles, goal, radius)
    far, angle, x, y, on_arc = tangents(navigation.arcs, end, radius, False)
    clear = segments_are_free(navigation.obstacles, end, x, y, free_radius)
    rest = jnp.where(on_arc & clear, far + radius * angle, jnp.inf)
    number, tables = rest.shape[0], (navigation.distance, navigation.arrival_angle)
    first = jnp.arange(number, dtype=jnp.int32)

    def by(best: tuple[Array, Array], arc: tuple[Array, ...]) -> tuple[tuple[Array, Array], None]:
        index, angle, rest = arc
        distance, arrival = (table.row((index,), number) for table in tables)
        total = jnp.where(arrival <= angle + ANGLE, distance + rest, jnp.inf)
        shorter = total < best[0]
        return (jnp.where(shorter, total, best[0]), jnp.where(shorter, index, best[1])), None

    # In a loop: XLA on a CPU takes 30 times longer for an argmin over a square of arcs.
    (total, last), _ = jax.lax.scan(by, (jnp.full_like(rest, jnp.inf), first), (first, angle, rest))
    total = jnp.where(first < navigation.distance.shape[0], total, jnp.inf)
    return ArcsToGoal(total, last, jnp.where(last == first, angle[last], navigation.departure_angle[first, last]))


def last_arc_to_goal(navigation: Navigation, goal: Float[Array, "2"]) -> Int[Array, "V"]:
    """The last arc of the shortest path to a goal from each arc: made once for a task, for ``plan``."""
    return last_arcs(navigation, goal).last_arc


def plan(
    navigation: Navigation,
    position: Float[Array, "2"],
    goal: Float[Array, "2"],
    paths_to_goal: PathsToGoal,
    last: Int[Array, "V"],
    points: int = 10,
    apart: float = 0.5,
) -> Float[Array, "{points} 2"]:
    """The next points [m] of the shortest path, as a global planner gives them to a local one; then the goal.

    Args:
        last: of ``last_arc_to_goal``.
        apart: m, minimum distance from one point to the next.
    """
    along = FINE * jnp.arange(1, round(CURVED * points * apart / FINE) + 1, dtype=float)
    x, y = _places_along(navigation, position, goal, paths_to_goal, last, along)
    index = jnp.arange(along.shape[0], dtype=jnp.int32)

    def pick(carry: tuple[Array, Array, Array], _) -> tuple[tuple[Array, Array, Array], Array]:
        before, px, py = carry
        far = (index > before) & (length(x - px, y - py) >= apart - ROUNDING)
        exists, chosen = far.any(), jnp.argmax(far).astype(jnp.int32)
        px, py = jnp.where(exists, x[chosen], goal[0]), jnp.where(exists, y[chosen], goal[1])
        return (jnp.where(exists, chosen, index[-1]), px, py), jnp.stack([px, py])

    return jax.lax.scan(pick, (jnp.full((), -1, jnp.int32), position[0], position[1]), length=points)[1]


def _places_along(
    navigation: Navigation, position: Array, goal: Array, paths_to_goal: PathsToGoal, last: Array, along: Array
) -> tuple[Array, Array]:
    """x and y (K,) [m] of the places at the lengths ``along`` (K,) [m] of the path; the goal beyond its end."""
    radius = navigation.radius
    straight, around, first, spot, _ = first_arc(navigation, position, goal, paths_to_goal)

    def follow(carry: tuple[Array, Array, Array], _) -> tuple[tuple[Array, Array, Array], tuple[Array, ...]]:
        """One segment and the arc after it; once ``free``, the segment to the goal."""
        place, arc, free = carry
        arrival, _, touch, _ = tangent_to_arc(navigation.arcs, arc, place, radius)
        touch = jnp.where(free, goal, touch)
        turn = jnp.where(free, 0.0, jnp.maximum(paths_to_goal.departure_angle[arc] - arrival, 0.0))
        out = jnp.where(free, goal, jnp.stack(_on_arc(navigation, arc, arrival + turn)))
        gap = touch - place
        following = navigation.next_arc[arc, last[arc]].astype(jnp.int32)
        is_last = last[arc] == arc
        part = place, gap, arc, arrival, jnp.stack([length(gap[0], gap[1]), radius * turn])
        return (out, jnp.where(is_last, arc, following), free | is_last), part

    begin = spot, first, straight | ~jnp.isfinite(around)
    _, (place, gap, arc, arrival, far) = jax.lax.scan(follow, begin, length=PLAN_ARCS + 1)
    ends = jnp.cumsum(far.reshape(-1))
    part = jnp.sum(along[:, None] > ends[None, :], axis=1, dtype=jnp.int32)
    over = part >= ends.shape[0]
    part = jnp.minimum(part, ends.shape[0] - 1)
    leg, rest = part // 2, along - (ends - far.reshape(-1))[part]
    ux, uy = unit(gap[leg, 0], gap[leg, 1])
    angle = arrival[leg] + rest / radius
    arc_x, arc_y = jax.vmap(_on_arc, (None, 0, 0))(navigation, arc[leg], angle)
    is_arc = part % 2 == 1
    x = jnp.where(is_arc, arc_x, place[leg, 0] + rest * ux)
    y = jnp.where(is_arc, arc_y, place[leg, 1] + rest * uy)
    return jnp.where(over, goal[0], x), jnp.where(over, goal[1], y)


def _on_arc(navigation: Navigation, arc: Array, angle: Array) -> tuple[Array, Array]:
    """x and y [m] of the place at that angle [rad] of an arc."""
    arcs = navigation.arcs
    middle, corner, signed = arcs.middle[arc], arcs.corner[arc], arcs.side[arc] * angle
    nx, ny = rotate(middle[0], middle[1], jnp.cos(signed), jnp.sin(signed))
    return corner[0] + navigation.radius * nx, corner[1] + navigation.radius * ny

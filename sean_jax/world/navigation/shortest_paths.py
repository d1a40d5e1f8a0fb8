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
    to_goal = length(gap[0], gap[1])
    return jnp.where(start.straight, to_goal, start.around)


def geodesic_approx(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> Float[Array, ""]:
    """Length [m] of the shortest path within about a cell of the visibility grid: cheap for many positions at once."""
    gap = goal - position
    straight = segment_is_free(navigation.obstacles, position, goal, NARROW * navigation.radius)

    i, j = cell_of(navigation.visible, navigation.origin, navigation.cell, position)
    words = visible_words(navigation, i, j)
    visible = arc_bits(words, navigation.arcs.side.shape[0])
    distance, angle, *_ = tangents(navigation.arcs, position, navigation.radius, True)
    to_arc = jnp.where(visible, distance - navigation.radius * angle, jnp.inf)

    # With the barrier, the minimum of a sum is some 20 times faster on a CPU than the minimum of a choice.
    around = jnp.min(jax.lax.optimization_barrier(to_arc) + paths_to_goal.distance)
    return jnp.where(straight, length(gap[0], gap[1]), around)


def next_point(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> Float[Array, "2"]:
    """The next point [m] of the shortest path; the goal if it is in sight or if there is no path.

    Otherwise it lies in the direction of the tangent to the next arc, up to 10 degrees of the arc beyond where the
    tangent touches. Going there, and from there to the next point, follows a path that is at most 1 % longer than the
    shortest.
    """
    radius = navigation.radius
    start = first_arc(navigation, position, goal, paths_to_goal)
    tangent = tangent_to_arc(navigation.arcs, start.arc, start.place, radius)

    # The tangents to both ends of a piece of arc meet half its angle ahead.
    turn = paths_to_goal.departure_angle[start.arc] - tangent.angle
    turn = jnp.clip(turn, 0.0, 2 * jnp.radians(STRIDE))
    stride = jnp.maximum(radius * jnp.tan(0.5 * turn), MIN_STRIDE)
    ahead = tangent.point + stride * tangent.direction
    is_free = segment_is_free(navigation.obstacles, start.place, ahead, start.free_radius)

    # Where the place ahead is not free, the least stride has to do.
    near = tangent.point + MIN_STRIDE * tangent.direction
    aim = jnp.where(is_free, ahead, near)
    to_goal = start.straight | ~jnp.isfinite(start.around)
    return jnp.where(to_goal, goal, aim)


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
    arcs = navigation.arcs
    radius = navigation.radius
    start = first_arc(navigation, position, goal, paths_to_goal)
    first = start.arc
    last = last_arcs(navigation, goal).last_arc[first]

    # The table has the rotation between the middles of the first arc and of the last.
    tangent = tangent_to_arc(arcs, first, start.place, radius)
    end, _ = push_out_of_obstacles(navigation.obstacles, goal, radius)
    departure = tangents(arcs, end, radius, False).angle[last]

    straight = start.straight | ~jnp.isfinite(start.around)
    direction = jnp.where(straight, goal - position, tangent.direction)
    at_start = jnp.abs(angle_between(heading, direction))
    on_arcs = navigation.rotation[first, last] + departure - tangent.angle
    return at_start + jnp.where(straight, 0.0, on_arcs)


def first_arc(
    navigation: Navigation, position: Float[Array, "2"], goal: Float[Array, "2"], paths_to_goal: PathsToGoal
) -> PathStart:
    """The beginning of the shortest path."""
    boxes = navigation.obstacles
    radius = navigation.radius
    place, free_radius = push_out_of_obstacles(boxes, position, radius)
    end, end_radius = push_out_of_obstacles(boxes, goal, radius)
    both_radii = jnp.minimum(free_radius, end_radius)
    straight = segment_is_free(boxes, place, end, both_radii)

    # Length of the path by each arc.
    distance, angle, x, y, on_arc = tangents(navigation.arcs, place, radius, True)
    reachable = on_arc & (angle <= paths_to_goal.departure_angle + ANGLE)
    by_arc = distance - radius * angle + paths_to_goal.distance  # (V,) m
    total = jnp.where(reachable, by_arc, jnp.inf)

    # Of the two arcs of a corner only the better one can be on the shortest path.
    right = total[1::2] < total[::2]
    total, x, y = (jnp.where(right, values[1::2], values[::2]) for values in (total, x, y))
    clear = segments_are_free(boxes, place, x, y, free_radius)
    total = jnp.where(clear, total, jnp.inf)
    corner = jnp.argmin(total).astype(jnp.int32)
    around = total[corner]
    arc = 2 * corner + right[corner].astype(jnp.int32)
    return PathStart(straight, around, arc, place, free_radius)


def last_arcs(navigation: Navigation, goal: Float[Array, "2"]) -> ArcsToGoal:
    """The shortest paths to a goal from all arcs, with their last arcs."""
    radius = navigation.radius
    end, free_radius = push_out_of_obstacles(navigation.obstacles, goal, radius)
    distance, angle, x, y, on_arc = tangents(navigation.arcs, end, radius, False)
    clear = segments_are_free(navigation.obstacles, end, x, y, free_radius)
    to_goal = jnp.where(on_arc & clear, distance + radius * angle, jnp.inf)
    n_arcs = to_goal.shape[0]
    arcs = jnp.arange(n_arcs, dtype=jnp.int32)

    def relax(best: tuple[Array, Array], last_arc: tuple[Array, ...]) -> tuple[tuple[Array, Array], None]:
        """The shorter paths from all arcs: those so far, or those by one last arc."""
        shortest, last = best
        index, angle, to_goal = last_arc
        distance = navigation.distance.row((index,), n_arcs)
        arrival_angle = navigation.arrival_angle.row((index,), n_arcs)
        total = jnp.where(arrival_angle <= angle + ANGLE, distance + to_goal, jnp.inf)
        shorter = total < shortest
        shortest = jnp.where(shorter, total, shortest)
        last = jnp.where(shorter, index, last)
        return (shortest, last), None

    # In a loop: XLA on a CPU takes 30 times longer for an argmin over a square of arcs.
    no_paths = jnp.full_like(to_goal, jnp.inf), arcs
    (total, last), _ = jax.lax.scan(relax, no_paths, (arcs, angle, to_goal))
    exists = arcs < navigation.distance.shape[0]
    total = jnp.where(exists, total, jnp.inf)
    departure_angle = jnp.where(last == arcs, angle[last], navigation.departure_angle[arcs, last])
    return ArcsToGoal(total, last, departure_angle)


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
    count = round(CURVED * points * apart / FINE)
    along = FINE * jnp.arange(1, count + 1, dtype=float)  # (K,) m
    x, y = _places_along(navigation, position, goal, paths_to_goal, last, along)
    index = jnp.arange(along.shape[0], dtype=jnp.int32)

    def pick(carry: tuple[Array, Array, Array], _) -> tuple[tuple[Array, Array, Array], Array]:
        """The next of these places that is far enough from the point before; the goal if there is none."""
        before, px, py = carry
        is_far = (index > before) & (length(x - px, y - py) >= apart - ROUNDING)
        exists = is_far.any()
        chosen = jnp.argmax(is_far).astype(jnp.int32)
        px = jnp.where(exists, x[chosen], goal[0])
        py = jnp.where(exists, y[chosen], goal[1])
        before = jnp.where(exists, chosen, index[-1])
        return (before, px, py), jnp.stack([px, py])

    start = jnp.full((), -1, jnp.int32), position[0], position[1]
    _, points_ahead = jax.lax.scan(pick, start, length=points)
    return points_ahead


class PathLeg(NamedTuple):
    """A straight segment of a path and the arc after it."""

    place: Float[Array, "2"]  # m, where the segment begins
    gap: Float[Array, "2"]  # m, from there to its end
    arc: Int[Array, ""]
    arrival_angle: Float[Array, ""]  # rad, where the segment enters the arc
    lengths: Float[Array, "2"]  # m, of the segment and on the arc


def _places_along(
    navigation: Navigation, position: Array, goal: Array, paths_to_goal: PathsToGoal, last: Array, along: Array
) -> tuple[Array, Array]:
    """x and y (K,) [m] of the places at the lengths ``along`` (K,) [m] of the path; the goal beyond its end."""
    legs = _legs(navigation, position, goal, paths_to_goal, last)

    # The piece of the path, a segment or an arc, on which each place lies.
    lengths = legs.lengths.reshape(-1)
    ends = jnp.cumsum(lengths)
    piece = jnp.sum(along[:, None] > ends[None, :], axis=1, dtype=jnp.int32)
    beyond = piece >= ends.shape[0]
    piece = jnp.minimum(piece, ends.shape[0] - 1)
    leg = piece // 2
    begins = ends - lengths
    on_piece = along - begins[piece]  # (K,) m

    # Segments and arcs take turns.
    ux, uy = unit(legs.gap[leg, 0], legs.gap[leg, 1])
    angle = legs.arrival_angle[leg] + on_piece / navigation.radius
    on_arcs = jax.vmap(_on_arc, (None, 0, 0))
    arc_x, arc_y = on_arcs(navigation, legs.arc[leg], angle)
    is_arc = piece % 2 == 1
    x = jnp.where(is_arc, arc_x, legs.place[leg, 0] + on_piece * ux)
    y = jnp.where(is_arc, arc_y, legs.place[leg, 1] + on_piece * uy)
    x = jnp.where(beyond, goal[0], x)
    y = jnp.where(beyond, goal[1], y)
    return x, y


def _legs(navigation: Navigation, position: Array, goal: Array, paths_to_goal: PathsToGoal, last: Array) -> PathLeg:
    """The next legs of the path, (PLAN_ARCS + 1, ...); the segment to the goal is the last of them, again and again."""
    radius = navigation.radius
    start = first_arc(navigation, position, goal, paths_to_goal)

    def follow(carry: tuple[Array, Array, Array], _) -> tuple[tuple[Array, Array, Array], PathLeg]:
        place, arc, to_goal = carry
        tangent = tangent_to_arc(navigation.arcs, arc, place, radius)
        end = jnp.where(to_goal, goal, tangent.point)
        turn = jnp.maximum(paths_to_goal.departure_angle[arc] - tangent.angle, 0.0)
        turn = jnp.where(to_goal, 0.0, turn)

        after_arc = jnp.stack(_on_arc(navigation, arc, tangent.angle + turn))
        after_arc = jnp.where(to_goal, goal, after_arc)
        gap = end - place
        next_arc = navigation.next_arc[arc, last[arc]].astype(jnp.int32)
        is_last = last[arc] == arc
        lengths = jnp.stack([length(gap[0], gap[1]), radius * turn])
        leg = PathLeg(place, gap, arc, tangent.angle, lengths)
        arc = jnp.where(is_last, arc, next_arc)
        return (after_arc, arc, to_goal | is_last), leg

    carry = start.place, start.arc, start.straight | ~jnp.isfinite(start.around)
    _, legs = jax.lax.scan(follow, carry, length=PLAN_ARCS + 1)
    return legs


def _on_arc(navigation: Navigation, arc: Array, angle: Array) -> tuple[Array, Array]:
    """x and y [m] of the place at that angle [rad] of an arc."""
    arcs = navigation.arcs
    middle = arcs.middle[arc]
    corner = arcs.corner[arc]
    signed = arcs.side[arc] * angle
    nx, ny = rotate(middle[0], middle[1], jnp.cos(signed), jnp.sin(signed))
    x = corner[0] + navigation.radius * nx
    y = corner[1] + navigation.radius * ny
    return x, y

"""Handcrafted pedestrian behavior (section IV-D): people walk loops and stand in groups of a handcrafted layout.

An episode has one of the chosen sets, drawn by its key. Walkers start spread along their loop, or each at a waypoint of
the loop, and walk it without end. Members of a group stand in a conversational formation, with a place left open.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, Behavior, Groups, Pedestrians, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.graph.formation import formation
from sean_jax.people.behaviors.starts import Place
from sean_jax.people.handcrafted import ALL, ARRIVED, Sets, Ways, annotation
from sean_jax.people.handcrafted import build as build_sets
from sean_jax.social_forces import draw_traits
from sean_jax.social_forces.forces import components
from sean_jax.world import navigation as paths

SETTLING = 0.5  # s, in which people return to a seat after a push


class HandcraftedMemory(NamedTuple):
    """The set, and the target of each person in it."""

    set: Int[Array, ""]  # row of the sets
    target: Int[Array, "N"]  # next waypoint of a walker's loop
    seat_position: Float[Array, "N 2"]  # m, of people who stand in a group
    seat_heading: Float[Array, "N 2"]  # unit vector


def build(place: Place, people: int | None = None, *, sets: str = ALL) -> Behavior:
    """People walk loops and stand in groups that were placed by hand for a situation.

    Needs ``handcrafted.yaml``. Each set has its own number of people, so ``people`` must be None, and
    ``Behavior.people`` is the largest.

    Args:
        sets: the name of a set, of a situation or a further collection of the file, from which sets are drawn, or
            ``all``.

    Raises:
        InputError: an unknown file or set, a mistake in the file, a number of people, or there
            is no way from a waypoint to the next one.
    """
    chosen = annotation.read_sets(place.folder, place.environment).chosen(sets)
    if people is not None:
        raise InputError(f"people: {people}, but each handcrafted set has a number of its own; leave people out.")
    tables = build_sets(chosen, place.navigation)
    return Behavior(
        data=tables,
        name="handcrafted",
        reset=reset,
        direct=direct,
        people=tables.present.shape[1],
        offers=("handcrafted_sets",),
    )


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, HandcraftedMemory]:
    """People of a set drawn by its odds, on their loops or at waypoints, and in formations."""
    tables: Sets = scenario.behavior.data
    set_key, form_key, phase_key, trait_key = jax.random.split(key, 4)

    # A set is as likely as all its pairs of start and goal together; the task draws the pair afterwards.
    odds = tables.odds.sum((1, 2))  # (S,)
    index = jax.random.categorical(set_key, jnp.log(odds)).astype(jnp.int32)
    layout = tables.one(index)
    n_groups = layout.capacity.shape[0]
    n_people = layout.group.shape[0]

    # Walkers and absent people take seats of an extra group, which is dropped below.
    center = jnp.concatenate([layout.center, jnp.zeros((1, 2), float)])
    capacity = jnp.concatenate([layout.capacity, jnp.ones(1, jnp.int32)])
    in_group = layout.group >= 0  # (N,)
    seat_group = jnp.where(in_group, layout.group, n_groups)
    seat_position, seat_heading, radius, opening = formation(form_key, capacity, center, seat_group)
    has_group = layout.capacity > 0  # (G,)
    groups = Groups(center=layout.center, radius=radius[:n_groups], opening=opening[:n_groups], present=has_group)

    # One phase for a loop keeps its walkers evenly apart, wherever the first of them is.
    phase = jax.random.uniform(phase_key, layout.waypoints.shape, float)  # (L,)
    on_loops = jax.vmap(_on_loop, in_axes=(None, 0, 0, 0, 0, None))
    place, ahead, target = on_loops(layout, layout.loop, layout.share, layout.way, layout.first, phase)

    # Around obstacles the way ahead is not the straight leg; at a corner itself it has no direction.
    if tables.ways is not None:
        aim = _ahead(tables.ways, index, layout.loop, target, place)  # (N, 2) m
        gap = aim - place
        distance = length(*components(gap))[:, None]  # (N, 1) m
        direction = gap / jnp.maximum(distance, 1e-3)
        ahead = jnp.where(distance > 1e-3, direction, ahead)

    # Walkers begin at full speed, as if the episode had begun long before.
    walks = (layout.loop >= 0)[:, None]  # (N, 1)
    heading = jnp.where(walks, ahead, seat_heading)
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, n_people)
    velocity = jnp.where(walks, preferred_speed[:, None] * heading, 0.0)
    pedestrians = Pedestrians(
        position=jnp.where(walks, place, seat_position),
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=jnp.where(in_group, layout.group, -1),
        walking_group=jnp.full(n_people, -1, jnp.int32),
        present=layout.present,
        preferred_speed=preferred_speed,
        robot_distance=robot_distance,
    )
    memory = HandcraftedMemory(index, target, seat_position, seat_heading)
    return pedestrians, groups, memory


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """The next waypoint for walkers who have arrived; desired velocities to waypoints, or back to the seat.

    The way to a waypoint is straight, or the shortest one around obstacles in sets where people start at waypoints.
    """
    tables: Sets = scenario.behavior.data
    people = state.pedestrians
    memory = state.memory

    # People without a loop have index -1: row 0 stands in for it, and ``walks`` masks the result.
    row = memory.set
    loop_index = tables.loop[row]  # (N,)
    loop = jnp.maximum(loop_index, 0)
    walks = loop_index >= 0
    waypoint = tables.waypoint[row][loop]  # (N, K, 2)
    count = tables.waypoints[row][loop]

    def gap_to(target: Array) -> Array:
        goal = jnp.take_along_axis(waypoint, target[:, None, None], axis=1)  # (N, 1, 2)
        goal = jnp.where(walks[:, None], goal[:, 0], memory.seat_position)
        return goal - people.position

    # Loops have no end: indices wrap around, backwards for people whose ``way`` is -1.
    gap = gap_to(memory.target)
    arrived = length(*components(gap)) < ARRIVED
    next_target = (memory.target + tables.way[row]) % count
    target = jnp.where(arrived & walks, next_target, memory.target)
    gap = gap_to(target)

    # Between waypoints chosen as starts there may be obstacles, which a straight line would run into.
    if tables.ways is not None:
        aim = _ahead(tables.ways, row, loop_index, target, people.position)  # (N, 2) m
        to_aim = aim - people.position
        gap = jnp.where(walks[:, None], to_aim, gap)

    # Near a seat the speed falls with the distance: at full speed people would oscillate about it.
    distance = length(*components(gap))
    settling_speed = jnp.minimum(people.preferred_speed, distance / SETTLING)
    speed = jnp.where(walks, people.preferred_speed, settling_speed)
    speed = jnp.where(people.present, speed, 0.0)
    rate = speed / jnp.maximum(distance, 1e-6)  # (N,) 1/s
    velocity = gap * rate[:, None]
    people = replace(people, desired_velocity=velocity)
    memory = memory._replace(target=target)
    return replace(state, pedestrians=people, memory=memory)


def _ahead(
    ways: Ways, row: Int[Array, ""], loop: Int[Array, "N"], target: Int[Array, "N"], position: Float[Array, "N 2"]
) -> Float[Array, "N 2"]:
    """The waypoint [m] of each person of a set, or a point on the shortest way there."""
    index = ways.index[row, jnp.maximum(loop, 0), target]
    next_points = jax.vmap(paths.next_point_approx, in_axes=(None, 0, 0, 0))
    paths_to_point = jax.tree.map(lambda leaf: leaf[index], ways.paths_to_point)
    return next_points(ways.navigation, position, ways.point[index], paths_to_point)


def _on_loop(
    layout: Sets,
    loop: Int[Array, ""],
    share: Float[Array, ""],
    way: Int[Array, ""],
    first: Int[Array, ""],
    phase: Float[Array, "L"],
) -> tuple[Float[Array, "2"], Float[Array, "2"], Int[Array, ""]]:
    """Place [m] and heading at that share of a loop, or at its waypoint ``first`` unless -1; and the waypoint ahead."""
    loop = jnp.maximum(loop, 0)
    waypoint = layout.waypoint[loop]  # (K, 2)
    count = layout.waypoints[loop]
    walked = layout.walked[loop]  # (K,)

    # The leg on which the share of the length lies.
    ends = jnp.where(jnp.isfinite(walked), walked, 0.0)
    along = ((share + phase[loop]) % 1.0) * ends.max()
    leg = (walked <= along).sum(dtype=jnp.int32)
    leg = jnp.minimum(leg, count - 1)
    next_leg = (leg + 1) % count
    start = waypoint[leg]
    end = waypoint[next_leg]
    gap = end - start
    ahead = gap / jnp.maximum(length(gap[0], gap[1]), 1e-6)
    place = end - (ends[leg] - along) * ahead
    target = jnp.where(way > 0, next_leg, leg)

    # People who start at a waypoint head for the one after it.
    at_waypoint = first >= 0
    first_place = waypoint[jnp.maximum(first, 0)]
    place = jnp.where(at_waypoint, first_place, place)
    target = jnp.where(at_waypoint, (first + way) % count, target)
    heading = way.astype(float) * ahead
    return place, heading, target

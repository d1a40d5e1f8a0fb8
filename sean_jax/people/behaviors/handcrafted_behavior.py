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
from sean_jax.world import navigation as paths

SETTLING = 0.5  # s, in which people return to a seat after a push


class Memory(NamedTuple):
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
    chosen = annotation.read(place.folder, place.environment).chosen(sets)
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


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """People of a set drawn by its odds, on their loops or at waypoints, and in formations."""
    tables: Sets = scenario.behavior.data
    set_key, form_key, phase_key, trait_key = jax.random.split(key, 4)
    number = jax.random.categorical(set_key, jnp.log(tables.odds.sum((1, 2)))).astype(jnp.int32)
    one = tables.one(number)

    # Walkers and absent people take seats of an extra group, which is dropped below.
    groups, people = one.capacity.shape[0], one.group.shape[0]
    center = jnp.concatenate([one.center, jnp.zeros((1, 2), float)])
    capacity = jnp.concatenate([one.capacity, jnp.ones(1, jnp.int32)])
    seat = jnp.where(one.group >= 0, one.group, groups)
    seat_position, seat_heading, radius, opening = formation(form_key, capacity, center, seat)

    phase = jax.random.uniform(phase_key, one.waypoints.shape, float)
    place, ahead, target = jax.vmap(_on_loop, in_axes=(None, 0, 0, 0, 0, None))(
        one, one.loop, one.share, one.way, one.first, phase
    )  # fmt: skip
    if tables.ways is not None:
        gap = _ahead(tables.ways, number, one.loop, target, place) - place
        gap_size = length(gap[:, 0], gap[:, 1])[:, None]
        ahead = jnp.where(gap_size > 1e-3, gap / jnp.maximum(gap_size, 1e-3), ahead)
    walks, stands = one.loop >= 0, one.group >= 0
    heading = jnp.where(walks[:, None], ahead, seat_heading)
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, people)
    velocity = jnp.where(walks[:, None], preferred_speed[:, None] * heading, 0.0)
    pedestrians = Pedestrians(
        position=jnp.where(walks[:, None], place, seat_position),
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=jnp.where(stands, one.group, -1),
        walking_group=jnp.full(people, -1, jnp.int32),
        present=one.present,
        preferred_speed=preferred_speed,
        robot_distance=robot_distance,
    )
    there = one.capacity > 0
    formed = Groups(center=one.center, radius=radius[:groups], opening=opening[:groups], present=there)
    return pedestrians, formed, Memory(number, target, seat_position, seat_heading)


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """The next waypoint for walkers who have arrived; desired velocities to waypoints, or back to the seat.

    The way to a waypoint is straight, or the shortest one around obstacles in sets where people start at waypoints.
    """
    tables: Sets = scenario.behavior.data
    people, memory = state.pedestrians, state.memory
    row, loop = memory.set, jnp.maximum(tables.loop[memory.set], 0)
    walks, waypoint = tables.loop[row] >= 0, tables.waypoint[row][loop]  # (N, K, 2)

    def gap_to(target: Array) -> Array:
        goal = jnp.take_along_axis(waypoint, target[:, None, None], axis=1)[:, 0]
        return jnp.where(walks[:, None], goal, memory.seat_position) - people.position

    gap = gap_to(memory.target)
    arrived = length(gap[:, 0], gap[:, 1]) < ARRIVED
    following = (memory.target + tables.way[row]) % tables.waypoints[row][loop]
    target = jnp.where(arrived & walks, following, memory.target)
    gap = gap_to(target)
    if tables.ways is not None:
        aim = _ahead(tables.ways, row, tables.loop[row], target, people.position)
        gap = jnp.where(walks[:, None], aim - people.position, gap)
    distance = length(gap[:, 0], gap[:, 1])
    speed = jnp.where(walks, people.preferred_speed, jnp.minimum(people.preferred_speed, distance / SETTLING))
    speed = jnp.where(people.present, speed, 0.0)
    velocity = gap * (speed / jnp.maximum(distance, 1e-6))[:, None]
    people = replace(people, desired_velocity=velocity)
    return replace(state, pedestrians=people, memory=memory._replace(target=target))


def _ahead(
    ways: Ways, row: Int[Array, ""], loop: Int[Array, "N"], target: Int[Array, "N"], position: Float[Array, "N 2"]
) -> Float[Array, "N 2"]:
    """The waypoint [m] of each person of a set, or a point on the shortest way there."""
    index = ways.index[row, jnp.maximum(loop, 0), target]
    each_person = jax.vmap(paths.next_point_approx, in_axes=(None, 0, 0, 0))
    paths_to_point = jax.tree.map(lambda leaf: leaf[index], ways.paths_to_point)
    return each_person(ways.navigation, position, ways.point[index], paths_to_point)


def _on_loop(
    one: Sets,
    loop: Int[Array, ""],
    share: Float[Array, ""],
    way: Int[Array, ""],
    first: Int[Array, ""],
    phase: Float[Array, "L"],
) -> tuple[Float[Array, "2"], Float[Array, "2"], Int[Array, ""]]:
    """Place [m] and heading at that share of a loop, or at its waypoint ``first`` unless -1; and the waypoint ahead."""
    loop = jnp.maximum(loop, 0)
    waypoint, count, walked = one.waypoint[loop], one.waypoints[loop], one.walked[loop]
    ends = jnp.where(jnp.isfinite(walked), walked, 0.0)
    along = ((share + phase[loop]) % 1.0) * ends.max()
    leg = jnp.minimum((walked <= along).sum(dtype=jnp.int32), count - 1)
    a, b = waypoint[leg], waypoint[(leg + 1) % count]
    gap = b - a
    size = jnp.maximum(length(gap[0], gap[1]), 1e-6)
    ahead = gap / size
    place = b - (ends[leg] - along) * ahead
    target = jnp.where(way > 0, (leg + 1) % count, leg)
    at_waypoint = first >= 0
    target = jnp.where(at_waypoint, (first + way) % count, target)
    place = jnp.where(at_waypoint, waypoint[jnp.maximum(first, 0)], place)
    return place, way.astype(float) * ahead, target

"""Handcrafted pedestrian behavior (section IV-D): people walk loops and stand in groups that a designer has placed.

An episode has one of the chosen sets, drawn by its key. Walkers start spread along their loop and walk it for ever;
members of a group stand in a conversational formation, with a place left open.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Behavior, Environment, Groups, Pedestrians, Scenario, State
from sean_jax.geometry import length
from sean_jax.graph.formation import formation
from sean_jax.handcrafted import Sets, annotation, sets
from sean_jax.handcrafted.room import ARRIVED
from sean_jax.navigation import Navigation
from sean_jax.social_forces import draw_traits

SETTLING = 0.5  # s, in which somebody who was pushed from a seat steps back


class Memory(NamedTuple):
    """Which set it is, and where each person goes in it."""

    set: Array  # () int32 row of the sets
    target: Array  # (N,) int32 waypoint of the loop that a walker goes to
    seat_position: Array  # (N, 2) m, of who stands in a group
    seat_heading: Array  # (N, 2) unit vector


def build(
    folder: Path, environment: Environment, navigation: Navigation, people: int, handcrafted: str = annotation.ALL
) -> Behavior:
    """People walk loops and stand in groups that were placed by hand for a situation.

    The sets are those of handcrafted.yaml in the folder: the one that is called ``handcrafted``, those of the
    situation of that name, or all. ``people`` is not read: there are as many as a set says.

    Raises:
        ValueError: there is no such file or no such set, or the file has a mistake.
    """
    chosen = annotation.read(folder, environment).chosen(handcrafted)
    return Behavior(data=sets.build(chosen), name="handcrafted", reset=reset, direct=direct)


def most_people(behavior: Behavior) -> int:
    """How many people are in the largest of the sets."""
    return behavior.data.present.shape[1]


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """People of a set drawn by its weight: spread along their loops from a random place on, and in formations."""
    tables: Sets = scenario.behavior.data
    set_key, form_key, phase_key, trait_key = jax.random.split(key, 4)
    number = jax.random.categorical(set_key, jnp.log(tables.weight.sum((1, 2)))).astype(jnp.int32)
    one: Sets = jax.tree.map(lambda leaf: leaf[number], tables)

    # Whoever walks or is absent takes a seat of one group more, which nobody sees.
    groups, people = one.capacity.shape[0], one.group.shape[0]
    center = jnp.concatenate([one.center, jnp.zeros((1, 2), float)])
    capacity = jnp.concatenate([one.capacity, jnp.ones(1, jnp.int32)])
    seat = jnp.where(one.group >= 0, one.group, groups)
    seat_position, seat_heading, radius, opening = formation(form_key, capacity, center, seat)

    phase = jax.random.uniform(phase_key, one.waypoints.shape, float)
    place, ahead, target = jax.vmap(_on_loop, in_axes=(None, 0, 0, 0, None))(
        one, one.loop, one.share, one.way, phase
    )  # fmt: skip
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
        party=jnp.full(people, -1, jnp.int32),
        present=one.present,
        preferred_speed=preferred_speed,
        robot_distance=robot_distance,
    )
    there = one.capacity > 0
    formed = Groups(center=one.center, radius=radius[:groups], opening=opening[:groups], present=there)
    return pedestrians, formed, Memory(number, target, seat_position, seat_heading)


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """The next waypoint for who has arrived; desired velocities to waypoints and, of who stands, back to the seat."""
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
    distance = length(gap[:, 0], gap[:, 1])
    speed = jnp.where(walks, people.preferred_speed, jnp.minimum(people.preferred_speed, distance / SETTLING))
    speed = jnp.where(people.present, speed, 0.0)
    velocity = gap * (speed / jnp.maximum(distance, 1e-6))[:, None]
    people = replace(people, desired_velocity=velocity)
    return replace(state, pedestrians=people, memory=memory._replace(target=target))


def _on_loop(one: Sets, loop: Array, share: Array, way: Array, phase: Array) -> tuple[Array, Array, Array]:
    """Place (2,) m and heading (2,) of who is at that share of a loop's length, and the waypoint () ahead."""
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
    return place, way.astype(float) * ahead, jnp.where(way > 0, (leg + 1) % count, leg)

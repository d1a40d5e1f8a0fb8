"""Graph-based pedestrian behavior (section IV-D): people walk, gather and disperse on the Behavior Graph.

People without a goal are first assigned to seats of group nodes, until all are taken; the rest go to random
waypoint nodes, along the cheapest path over waypoints. Whoever reaches a seat stays for a drawn duration. A seat
that somebody is still far from goes to a nearer walker who passes a node, and the farther one walks elsewhere: so
groups last although people arrive from afar.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import navigation as paths
from sean_jax.base import Array, Behavior, Environment, Groups, Pedestrians, Scenario, State
from sean_jax.behaviors import starts
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph, annotation
from sean_jax.graph.formation import formation, reach
from sean_jax.social_forces import draw_traits

ARRIVED = 1.0  # m from the point aimed at, where a waypoint counts as reached (SEAN 2.0)
SEATED = 0.25  # m from a seat, where the walk ends and the stay begins
NEARER = 5.0  # m, by which a walker's way to a seat must be shorter to take it over
SETTLING = 0.5  # s, in which the last steps to a seat are taken


@struct.dataclass
class Tables:
    """What the behavior looks up: the graph, the ways between its nodes, and where people can start."""

    graph: BehaviorGraph
    navigation: paths.Navigation
    ways: paths.Towards  # to the nodes
    start: Array  # (P, 2) m, places where somebody can start, none too close to another
    start_node: Array  # (P,) int32, the node of each
    start_weight: Array  # (P,) log of the chance


class Memory(NamedTuple):
    """Where each person is on the graph."""

    goal: Array  # (N,) int32 node to reach in the end
    hop: Array  # (N,) int32 node to reach next
    target: Array  # (N, 2) m, the point of that node's disc, or the seat
    seat: Array  # (N,) int32 seat taken or walked to, -1 none
    stay: Array  # (N,) s left to stand at the seat
    seat_position: Array  # (Q, 2) m
    seat_heading: Array  # (Q, 2) unit vector


def build(folder: Path, environment: Environment, navigation: paths.Navigation, people: int) -> Behavior:
    """People walk, gather and disperse on the Behavior Graph of the environment.

    The graph is that of graph.yaml in the folder.

    Raises:
        ValueError: the annotation has a mistake, or so many people do not fit.
    """
    file = folder / "graph.yaml"
    if not file.is_file():
        raise ValueError(f"{file}: there is no such file, and behavior 'graph' needs it; write one or choose another.")
    graph = annotation.read(file, environment)
    avoid = [(graph.position[node], reach(int(graph.capacity[node])) + 0.6) for node in np.asarray(graph.groups)]
    start, node = starts.places(environment, navigation, graph.position, graph.radius, graph.spawn, avoid)
    most = len(start) + graph.seat_group.shape[0]
    if people > most:
        raise ValueError(f"people: {people} do not fit on the graph of {environment.name}; the most that do is {most}.")
    weight = np.asarray(graph.spawn)[node] / np.bincount(node, minlength=len(graph.spawn))[node]
    tables = Tables(
        graph=graph,
        navigation=navigation,
        ways=paths.towards(navigation, graph.position),
        start=jnp.asarray(start, jnp.float32),
        start_node=jnp.asarray(node, jnp.int32),
        start_weight=jnp.asarray(np.log(weight), jnp.float32),
    )
    return Behavior(data=tables, name="graph", reset=reset, direct=direct)


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """People at their starts: seats of groups first, then places of waypoint nodes drawn by their spawn weight."""
    tables: Tables = scenario.behavior.data
    graph, people = tables.graph, scenario.people
    form_key, trait_key, place_key, stay_key, turn_key = jax.random.split(key, 5)
    center = graph.position[graph.groups]
    seat_position, seat_heading, radius, opening = formation(
        form_key, graph.capacity[graph.groups], center, graph.seat_group
    )
    seated = min(people, graph.seat_group.shape[0])
    chance = tables.start_weight + jax.random.gumbel(place_key, tables.start_weight.shape, jnp.float32)
    chosen = jax.lax.top_k(chance, people - seated)[1]
    angle = jax.random.uniform(turn_key, (people - seated,), jnp.float32, 0.0, 2 * jnp.pi)
    facing = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    position = jnp.concatenate([seat_position[:seated], tables.start[chosen]])
    node = jnp.concatenate([graph.groups[graph.seat_group[:seated]], tables.start_node[chosen]])
    seat = jnp.concatenate([jnp.arange(seated, dtype=jnp.int32), jnp.full(people - seated, -1, jnp.int32)])
    limits = graph.stay[graph.groups[graph.seat_group[:seated]]]
    share = jax.random.uniform(stay_key, (2, seated), jnp.float32)
    stay = share[1] * (limits[:, 0] + share[0] * (limits[:, 1] - limits[:, 0]))  # some have been there for a while
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, people)
    pedestrians = Pedestrians(
        position=position,
        velocity=jnp.zeros_like(position),
        heading=jnp.concatenate([seat_heading[:seated], facing]),
        desired_velocity=jnp.zeros_like(position),
        group=jnp.where(seat >= 0, graph.seat_group[jnp.maximum(seat, 0)], -1),
        present=jnp.ones(people, bool),
        preferred_speed=preferred_speed,
        robot_distance=robot_distance,
    )
    groups = Groups(center=center, radius=radius, opening=opening, present=jnp.ones(radius.shape, bool))
    stay = jnp.concatenate([stay, jnp.zeros(people - seated, jnp.float32)])
    memory = Memory(node, node, position, seat, stay, seat_position, seat_heading)
    return pedestrians, groups, memory


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """People's next goals, hops and desired velocities; who stands at a seat is a member of its group."""
    tables: Tables = scenario.behavior.data
    graph, people, memory = tables.graph, state.pedestrians, state.memory
    chance = jax.random.uniform(key, (3, scenario.people), jnp.float32)
    memory, free = _stay_or_leave(scenario, people, memory, graph, chance[0])
    memory = _assign(graph, memory, free, chance[1])
    onward = free | _passes(people, memory)
    memory = _hand_over(graph, people, memory, onward, chance[1])
    memory = _next_hop(graph, memory, onward, chance[2])
    standing = memory.stay > 0.0
    seat = jnp.maximum(memory.seat, 0)
    people = replace(
        people,
        desired_velocity=_desired_velocity(tables, people, memory),
        group=jnp.where(standing, graph.seat_group[seat], -1),
        heading=jnp.where(standing[:, None], memory.seat_heading[seat], people.heading),
    )
    return replace(state, pedestrians=people, memory=memory)


def _stay_or_leave(scenario, people, memory, graph, chance) -> tuple[Memory, Array]:
    """Stays that begin, go on or end; and who is (N,) bool without a goal now."""
    gap = memory.target - people.position
    distance = length(gap[:, 0], gap[:, 1])
    was_standing = memory.stay > 0.0
    stay = jnp.maximum(memory.stay - scenario.time_step, 0.0)
    leaves = was_standing & (stay == 0.0)
    at_last = memory.hop == memory.goal
    sits_down = ~was_standing & (memory.seat >= 0) & at_last & (distance < SEATED)
    limits = graph.stay[graph.groups[graph.seat_group[jnp.maximum(memory.seat, 0)]]]
    stay = jnp.where(sits_down, limits[:, 0] + chance * (limits[:, 1] - limits[:, 0]), stay)
    at_waypoint = ~was_standing & (memory.seat < 0) & at_last & (distance < ARRIVED)
    return memory._replace(stay=stay), leaves | at_waypoint


def _assign(graph: BehaviorGraph, memory: Memory, free: Array, chance: Array) -> Memory:
    """A goal for everybody without one: the empty seats one after the other, then random waypoint nodes.

    Whoever leaves a seat now goes to a waypoint, so that nobody turns on the spot to sit down again.
    """
    seats = jnp.arange(graph.seat_group.shape[0], dtype=jnp.int32)
    taken = (memory.seat[:, None] == seats[None, :]).any(0)
    seekers = free & (memory.seat < 0)
    rank = jnp.cumsum(seekers, dtype=jnp.int32) - 1
    order = jnp.cumsum(~taken, dtype=jnp.int32) - 1
    match = seekers[:, None] & ~taken[None, :] & (rank[:, None] == order[None, :])
    given = match.any(1)
    seat = jnp.where(given, jnp.argmax(match, axis=1).astype(jnp.int32), jnp.where(free, -1, memory.seat))
    node = graph.groups[graph.seat_group[jnp.maximum(seat, 0)]]
    goal = jnp.where(given, node, _other_waypoint(graph, memory.hop, chance))
    return memory._replace(seat=seat, goal=jnp.where(free, goal, memory.goal))


def _other_waypoint(graph: BehaviorGraph, hop: Array, chance: Array) -> Array:
    """(N,) a waypoint node other than ``hop`` (N,), uniform in ``chance`` (N,)."""
    number = graph.waypoints.shape[0]
    is_own = graph.waypoints[None, :] == hop[:, None]
    here, own = is_own.any(1), jnp.argmax(is_own, axis=1).astype(jnp.int32)
    others = number - here.astype(jnp.int32)
    index = jnp.minimum((chance * others.astype(jnp.float32)).astype(jnp.int32), jnp.maximum(others - 1, 0))
    return graph.waypoints[jnp.minimum(index + (here & (index >= own)).astype(jnp.int32), number - 1)]


def _passes(people: Pedestrians, memory: Memory) -> Array:
    """(N,) who has reached a node on the way to another."""
    gap = memory.target - people.position
    return (length(gap[:, 0], gap[:, 1]) < ARRIVED) & (memory.hop != memory.goal)


def _hand_over(graph: BehaviorGraph, people: Pedestrians, memory: Memory, onward: Array, chance: Array) -> Memory:
    """One seat a step goes from somebody who is still nodes away from it to the walker at a node who is nearest."""
    seats = jnp.arange(graph.seat_group.shape[0], dtype=jnp.int32)
    holds = memory.seat[:, None] == seats[None, :]
    holder = jnp.argmax(holds, axis=0).astype(jnp.int32)
    far = holds.any(0) & (memory.hop[holder] != memory.goal[holder])
    node = graph.groups[graph.seat_group]
    gap = memory.target[holder] - people.position[holder]
    rest = graph.cost[memory.hop[holder], node] + length(gap[:, 0], gap[:, 1])
    shorter = rest[None, :] - graph.cost[memory.hop[:, None], node[None, :]]
    shorter = jnp.where((onward & (memory.seat < 0))[:, None] & far[None, :], shorter, -jnp.inf)
    best = jnp.argmax(shorter).astype(jnp.int32)
    taker, seat = best // seats.shape[0], best % seats.shape[0]
    happens = shorter[taker, seat] > NEARER
    person = jnp.arange(memory.seat.shape[0], dtype=jnp.int32)
    takes, loses = happens & (person == taker), happens & (person == holder[seat])
    goal = jnp.where(loses, _other_waypoint(graph, memory.hop, chance), memory.goal)
    return memory._replace(
        seat=jnp.where(takes, seat, jnp.where(loses, -1, memory.seat)),
        goal=jnp.where(takes, node[seat], goal),
    )


def _next_hop(graph: BehaviorGraph, memory: Memory, onward: Array, chance: Array) -> Memory:
    """The next node on the way, for those who go on from one, and a point of its disc."""
    following = graph.next_hop[memory.hop, memory.goal]
    hop = jnp.where(onward, jnp.where(following >= 0, following, memory.goal), memory.hop)
    number = graph.places.shape[1]
    place = graph.places[hop, jnp.minimum((chance * number).astype(jnp.int32), number - 1)]
    to_seat = (memory.seat >= 0) & (hop == memory.goal)
    place = jnp.where(to_seat[:, None], memory.seat_position[jnp.maximum(memory.seat, 0)], place)
    return memory._replace(hop=hop, target=jnp.where(onward[:, None], place, memory.target))


def _desired_velocity(tables: Tables, people: Pedestrians, memory: Memory) -> Array:
    """(N, 2) m/s: at the preferred speed to the target, or to where the way to its node bends; slower into a seat."""

    def ahead(position: Array, target: Array, hop: Array) -> Array:
        return _ahead(tables, position, target, hop) - position

    gap = jax.vmap(ahead)(people.position, memory.target, memory.hop)
    distance = length(gap[:, 0], gap[:, 1])
    at_last = (memory.seat >= 0) & (memory.hop == memory.goal)
    speed = jnp.where(at_last, jnp.minimum(people.preferred_speed, distance / SETTLING), people.preferred_speed)
    return gap * (speed / jnp.maximum(distance, 1e-6))[:, None]


def _ahead(tables: Tables, position: Array, target: Array, hop: Array) -> Array:
    """(2,) m: the target if the way to it is clear, else ahead on the way to its node."""
    navigation = tables.navigation
    clear = paths.sees(navigation.obstacles, position, target, navigation.radius * paths.CLOSE)
    return jnp.where(clear, target, paths.ahead(navigation, tables.ways, position, hop))

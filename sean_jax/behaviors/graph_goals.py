"""Which node of the Behavior Graph a person goes to next, and on which seat somebody stands (section IV-D).

In ``whole``, as in the paper, a goal node is drawn and all of the cheapest path to it is walked. In ``edge``, as in
SEAN 2.0's code, a person chooses anew at every node and is bound to one edge alone.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax.base import Array, Pedestrians
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph

ARRIVED = 1.0  # m from the target, where a waypoint counts as reached (SEAN 2.0)
MIN_GAIN = 5.0  # m, by which a walker's way to a seat must be shorter to take it over


class Memory(NamedTuple):
    """Where each person is on the graph."""

    goal: Int[Array, "N"]  # node to reach in the end
    hop: Int[Array, "N"]  # node to reach next
    origin: Int[Array, "N"]  # node that was left for it; the same one before the first edge
    target: Float[Array, "N 2"]  # m, the point of the next node's disc, or the seat
    seat: Int[Array, "N"]  # seat taken or walked to, -1 none
    stay: Int[Array, "N"]  # ticks left to stand at the seat, 0 for who does not
    seat_position: Float[Array, "Q 2"]  # m
    seat_heading: Float[Array, "Q 2"]  # unit vector


def whole(
    graph: BehaviorGraph, people: Pedestrians, memory: Memory, free: Bool[Array, "N"], chance: Float[Array, "2 N"]
) -> Memory:
    """People keep their goal until they are there: empty seats first, then waypoint nodes.

    A seat is reserved from afar. Somebody much nearer who passes a node takes it over, and the other goes on to a
    waypoint node instead.

    Args:
        graph: of the scenario.
        people: N of them.
        memory: before the step.
        free: (N,) who has no goal.
        chance: (2, N) uniform from 0 to 1.

    Returns:
        The memory with new goals, seats, hops and targets.

    Source: section IV-D.
    """
    alone = people.walking_group < 0  # walking groups take no seats
    memory = assign(graph, memory, free, chance[0], alone)
    onward = free | _passes(people, memory)
    memory = hand_over(graph, people, memory, onward & alone, chance[0])
    return _set_out(graph, memory, onward, chance[1])


def edge(
    graph: BehaviorGraph, people: Pedestrians, memory: Memory, free: Bool[Array, "N"], chance: Float[Array, "2 N"]
) -> Memory:
    """People choose anew at every node: the group that lacks most members, or if none lacks any, a waypoint node.

    A seat is reserved for whoever sets out on the edge that leads to it, first come first served. Whoever finds the
    group full by then draws a waypoint node instead. Those who choose at the same step do so together. Unlike in SEAN
    2.0, paths never lead through a group to somewhere else.

    Args:
        graph: of the scenario.
        people: N of them.
        memory: before the step.
        free: (N,) who has no goal.
        chance: (2, N) uniform from 0 to 1.

    Returns:
        The memory with new goals, seats, hops and targets.

    Source: NavManager of SEAN 2.0.
    """
    onward = free | _passes(people, memory)
    seat = jnp.where(onward, -1, memory.seat)
    goal = _other_waypoint(graph, memory.hop, chance[0])
    if graph.groups.shape[0]:
        empty = ~_taken(memory, graph.seat_group.shape[0])
        group = jnp.arange(graph.groups.shape[0], dtype=jnp.int32)
        of_group = graph.seat_group[:, None] == group[None, :]  # (Q, G)
        lack = jnp.sum(of_group & empty[:, None], axis=0, dtype=jnp.int32)
        neediest = jnp.argmax(lack).astype(jnp.int32)
        node = graph.groups[neediest]
        wants = onward & (people.walking_group < 0) & (lack[neediest] > 0) & (memory.hop != node)
        near = wants & (graph.next_hop[memory.hop, node] == node)
        offered = empty & (graph.seat_group == neediest)
        succeeds, which = _in_turn(near, offered)
        seat = jnp.where(succeeds, which, seat)
        goal = jnp.where(wants & (succeeds | ~near), node, goal)
    memory = memory._replace(seat=seat, goal=jnp.where(onward, goal, memory.goal))
    return _set_out(graph, memory, onward, chance[1])


def of_seat(values: Shaped[Array, "Q *shape"], seat: Int[Array, "N"]) -> Shaped[Array, "N *shape"]:
    """The values of people's seats.

    Args:
        values: (Q, ...) of each seat.
        seat: (N,) of each person, -1 none.

    Returns:
        (N, ...): any row for who has no seat, zeros if there are no seats.
    """
    if values.shape[0] == 0:
        return jnp.zeros((*seat.shape, *values.shape[1:]), values.dtype)
    return values[jnp.maximum(seat, 0)]


def assign(
    graph: BehaviorGraph, memory: Memory, free: Bool[Array, "N"], chance: Float[Array, "N"], alone: Bool[Array, "N"]
) -> Memory:
    """A goal for everybody without one: the empty seats one after the other, then random waypoint nodes.

    Whoever leaves a seat now goes to a waypoint, so that nobody turns on the spot to sit down again.

    Args:
        graph: of the scenario.
        memory: before the step.
        free: (N,) who has no goal.
        chance: (N,) uniform from 0 to 1, of the waypoint.
        alone: (N,) who walks in no group; all others go to waypoints.

    Returns:
        The memory with new goals and seats.
    """
    succeeds, which = _in_turn(free & alone & (memory.seat < 0), ~_taken(memory, graph.seat_group.shape[0]))
    seat = jnp.where(succeeds, which, jnp.where(free, -1, memory.seat))
    goal = jnp.where(succeeds, of_seat(graph.seat_node, seat), _other_waypoint(graph, memory.hop, chance))
    return memory._replace(seat=seat, goal=jnp.where(free, goal, memory.goal))


def hand_over(
    graph: BehaviorGraph, people: Pedestrians, memory: Memory, onward: Bool[Array, "N"], chance: Float[Array, "N"]
) -> Memory:
    """One seat a step goes from somebody who is still nodes away from it to the walker at a node who is nearest.

    Args:
        graph: of the scenario.
        people: N of them.
        memory: before the step.
        onward: (N,) who is at a node and goes on.
        chance: (N,) uniform from 0 to 1, of the waypoint for whoever loses the seat.

    Returns:
        The memory with new goals and seats.
    """
    seats = jnp.arange(graph.seat_group.shape[0], dtype=jnp.int32)
    if seats.shape[0] == 0 or memory.seat.shape[0] == 0:
        return memory
    owns = memory.seat[:, None] == seats[None, :]
    holder = jnp.argmax(owns, axis=0).astype(jnp.int32)
    far = owns.any(0) & (memory.hop[holder] != memory.goal[holder])
    node = graph.seat_node
    gap = memory.target[holder] - people.position[holder]
    rest = graph.cost[memory.hop[holder], node] + length(gap[:, 0], gap[:, 1])
    shorter = rest[None, :] - graph.cost[memory.hop[:, None], node[None, :]]
    leaves = memory.hop[:, None] == node[None, :]  # not to sit down again in the same group
    shorter = jnp.where((onward & (memory.seat < 0))[:, None] & far[None, :] & ~leaves, shorter, -jnp.inf)
    best = jnp.argmax(shorter).astype(jnp.int32)
    taker, seat = best // seats.shape[0], best % seats.shape[0]
    happens = shorter[taker, seat] > MIN_GAIN
    person = jnp.arange(memory.seat.shape[0], dtype=jnp.int32)
    takes, loses = happens & (person == taker), happens & (person == holder[seat])
    goal = jnp.where(loses, _other_waypoint(graph, memory.hop, chance), memory.goal)
    return memory._replace(
        seat=jnp.where(takes, seat, jnp.where(loses, -1, memory.seat)),
        goal=jnp.where(takes, node[seat], goal),
    )


def _taken(memory: Memory, seats: int) -> Bool[Array, "Q"]:
    """(Q,) seats that are reserved."""
    return (memory.seat[:, None] == jnp.arange(seats, dtype=jnp.int32)[None, :]).any(0)


def _in_turn(seekers: Bool[Array, "N"], seats: Bool[Array, "Q"]) -> tuple[Bool[Array, "N"], Int[Array, "N"]]:
    """(N,) who of the seekers gets one of the seats, both in their order; and (N,) which."""
    if seats.shape[0] == 0:
        return jnp.zeros_like(seekers), jnp.full(seekers.shape, -1, jnp.int32)
    rank = jnp.cumsum(seekers, dtype=jnp.int32) - 1
    order = jnp.cumsum(seats, dtype=jnp.int32) - 1
    match = seekers[:, None] & seats[None, :] & (rank[:, None] == order[None, :])
    return match.any(1), jnp.argmax(match, axis=1).astype(jnp.int32)


def _other_waypoint(graph: BehaviorGraph, hop: Int[Array, "N"], chance: Float[Array, "N"]) -> Int[Array, "N"]:
    """(N,) a waypoint node other than ``hop`` if there is one, uniform in ``chance``."""
    number = graph.waypoints.shape[0]
    is_own = graph.waypoints[None, :] == hop[:, None]
    here, own = is_own.any(1), jnp.argmax(is_own, axis=1).astype(jnp.int32)
    others = number - here.astype(jnp.int32)
    index = jnp.minimum((chance * others.astype(float)).astype(jnp.int32), jnp.maximum(others - 1, 0))
    return graph.waypoints[jnp.minimum(index + (here & (index >= own)).astype(jnp.int32), number - 1)]


def _passes(people: Pedestrians, memory: Memory) -> Bool[Array, "N"]:
    """(N,) who has reached a node on the way to another."""
    gap = memory.target - people.position
    return (length(gap[:, 0], gap[:, 1]) < ARRIVED) & (memory.hop != memory.goal)


def _set_out(graph: BehaviorGraph, memory: Memory, onward: Bool[Array, "N"], chance: Float[Array, "N"]) -> Memory:
    """The next node on the way and a point of its disc, for those who go on from a node."""
    following = graph.next_hop[memory.hop, memory.goal]
    hop = jnp.where(onward, jnp.where(following >= 0, following, memory.goal), memory.hop)
    number = graph.places.shape[1]
    place = graph.places[hop, jnp.minimum((chance * number).astype(jnp.int32), number - 1)]
    to_seat = (memory.seat >= 0) & (hop == memory.goal)
    place = jnp.where(to_seat[:, None], of_seat(memory.seat_position, memory.seat), place)
    return memory._replace(
        hop=hop,
        origin=jnp.where(onward, memory.hop, memory.origin),
        target=jnp.where(onward[:, None], place, memory.target),
    )

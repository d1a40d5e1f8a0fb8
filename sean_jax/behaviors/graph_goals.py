"""Which node of the Behavior Graph a person goes to next, and on which seat somebody stands (section IV-D).

In ``whole``, as in the paper, a goal node is drawn and all of the cheapest path to it is walked. In ``edge``, as in
SEAN 2.0's code, a person chooses anew at every node and is bound to one edge alone.
"""

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array, Pedestrians
from sean_jax.behaviors import relaxation, successors
from sean_jax.behaviors.graph_memory import Memory, Seats, of_seat
from sean_jax.behaviors.relaxation import Draws
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph
from sean_jax.graph.behavior_graph import hop_log_chances

ARRIVED = 1.0  # m from the target, where a waypoint counts as reached (SEAN 2.0)


def whole(
    graph: BehaviorGraph,
    people: Pedestrians,
    memory: Memory,
    seats: Seats,
    arrival: Float[Array, "N G"],
    free: Bool[Array, "N"],
    chance: Float[Array, "2 N"],
    draws: Draws | None = None,
) -> Memory:
    """People keep their goal until they are there. Seats that need somebody come first, then waypoint nodes.

    Who is at a node can be sent to a seat, whatever goal they had. A successor whose place somebody else takes goes on
    to a waypoint node.

    Args:
        arrival: (N, G) s, when each would be at each group.
        chance: (2, N) uniform from 0 to 1.
        draws: with a temperature, see ``relaxation``.

    Returns:
        The memory with new goals, seats, hops and targets.
    Source: section IV-D.
    """
    onward = free | _passes(people, memory)
    alone = people.present & (people.walking_group < 0)  # walking groups take no seats
    given, loses = successors.send(graph, arrival, memory, seats, onward & alone, draws)
    aimless = (free & (given.seat < 0)) | loses
    goal = jnp.where(aimless, _other_waypoint(graph, memory.hop, chance[0]), given.goal)
    given = _count_goals(graph, given, goal, aimless, draws)
    return _set_out(graph, given._replace(goal=goal), onward, chance[1], draws)


def edge(
    graph: BehaviorGraph,
    people: Pedestrians,
    memory: Memory,
    free: Bool[Array, "N"],
    chance: Float[Array, "2 N"],
    draws: Draws | None = None,
) -> Memory:
    """People choose anew at every node: the group that lacks most members, or if none lacks any, a waypoint node.

    A seat is reserved for whoever sets out on the edge that leads to it, first come first served. Whoever finds the
    group full by then draws a waypoint node instead. Those who choose at the same step do so together. Unlike in SEAN
    2.0, paths never lead through a group to somewhere else.

    Args:
        chance: (2, N) uniform from 0 to 1.
        draws: with a temperature, see ``relaxation``.

    Returns:
        The memory with new goals, seats, hops and targets.
    Source: NavManager of SEAN 2.0.
    """
    onward = free | _passes(people, memory)
    seat = jnp.where(onward, -1, memory.seat)
    goal, drawn = _other_waypoint(graph, memory.hop, chance[0]), onward
    if graph.groups.shape[0]:
        empty = ~_taken(memory, graph.seat_group.shape[0])
        group = jnp.arange(graph.groups.shape[0], dtype=jnp.int32)
        of_group = graph.seat_group[:, None] == group[None, :]  # (Q, G)
        lack = jnp.sum(of_group & empty[:, None], axis=0, dtype=jnp.int32)
        neediest = jnp.argmax(lack).astype(jnp.int32)
        node = graph.groups[neediest]
        wants = onward & people.present & (people.walking_group < 0) & (lack[neediest] > 0) & (memory.hop != node)
        near = wants & (graph.next_hop[memory.hop, node] == node)
        offered = empty & (graph.seat_group == neediest)
        succeeds, which = _in_turn(near, offered)
        seat = jnp.where(succeeds, which, seat)
        goal, drawn = jnp.where(wants & (succeeds | ~near), node, goal), onward & ~(wants & (succeeds | ~near))
    memory = _count_goals(graph, memory, goal, drawn, draws)
    memory = memory._replace(seat=seat, goal=jnp.where(onward, goal, memory.goal))
    return _set_out(graph, memory, onward, chance[1], draws)


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
    """(N,) a waypoint node other than ``hop`` if there is one: the one at ``chance`` of the sum of their weights."""
    below = jnp.cumsum(_goal_odds(graph, hop), axis=1)
    index = jnp.sum(below <= chance[:, None] * below[:, -1:], axis=1, dtype=jnp.int32)
    return graph.waypoints[jnp.minimum(index, graph.waypoints.shape[0] - 1)]


def _goal_odds(graph: BehaviorGraph, hop: Int[Array, "N"]) -> Float[Array, "N Mw"]:
    """(N, Mw) odds with which somebody at ``hop`` draws each waypoint."""
    other = (graph.waypoints[None, :] != hop[:, None]).astype(float)
    odds = other * graph.weight[graph.waypoints][None, :]
    return jnp.where(jnp.sum(odds, axis=1, keepdims=True) > 0.0, odds, other)  # else all others have weight 0


def _count_goals(
    graph: BehaviorGraph, memory: Memory, goal: Int[Array, "N"], drawn: Bool[Array, "N"], draws: Draws | None
) -> Memory:
    """The memory with the chances of the goals of those who have drawn one at their node; as it is without draws."""
    if draws is None:
        return memory
    odds = _goal_odds(graph, memory.hop)
    own = jnp.sum(jnp.where(graph.waypoints[None, :] == goal[:, None], odds, 0.0), axis=1)
    chance = jnp.where(drawn, own / jnp.maximum(jnp.sum(odds, axis=1), 1e-30), 1.0)
    return relaxation.added(memory, jnp.sum(jnp.log(jnp.maximum(chance, 1e-30))))


def _passes(people: Pedestrians, memory: Memory) -> Bool[Array, "N"]:
    """(N,) who has reached a node on the way to another."""
    gap = memory.target - people.position
    return (length(gap[:, 0], gap[:, 1]) < ARRIVED) & (memory.hop != memory.goal)


def _set_out(
    graph: BehaviorGraph, memory: Memory, onward: Bool[Array, "N"], chance: Float[Array, "N"], draws: Draws | None
) -> Memory:
    """The next node on the way and a point of its disc, for those who go on from a node."""
    following = graph.next_hop[memory.hop, memory.goal]
    if draws is not None:
        ways = hop_log_chances(graph.edge_cost, graph.cost, graph.is_group, draws.temperature)
        onto, log_chance = relaxation.drawn(ways[memory.hop, memory.goal], draws.hop)
        chooses = onward & (following >= 0) & (memory.hop != memory.goal)
        following = jnp.where(chooses, onto, following)
        memory = relaxation.added(memory, jnp.sum(jnp.where(chooses, log_chance, 0.0)))
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

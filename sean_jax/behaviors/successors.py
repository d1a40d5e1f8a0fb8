"""Successors at the seats of groups: who is sent where and when, so that groups last while people come and go (IV-D).

The paper's Behavior Graph "maintains" group formations although each member stays for a few seconds only. So a seat has
a holder, who stands there, and a successor, who walks there and is chosen before the holder's stay ends, among people
who pass a node, by the time at which they would arrive. When the stay is over the holder waits for the successor, for a
bounded time. Whoever is much better in time takes the place of a successor who is still nodes away.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from sean_jax import cache
from sean_jax import navigation as paths
from sean_jax.base import Array, Pedestrians
from sean_jax.behaviors import relaxation
from sean_jax.behaviors.graph_memory import Memory, Seats, of_seat
from sean_jax.behaviors.relaxation import Draws
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph

MAX_WAIT = 5.0  # s, for which the holder of a seat waits for a successor; never longer than a stay at that group
HAND_OVER = 1.0  # m between a successor and the seat, where a holder whose stay is over leaves and the next stay begins
STAND_BY = 0.9  # m from the seat, where a successor who is early waits
CROWD = 1.1  # by which a walk takes longer than its length at the preferred speed
SETTLING = 1.0  # s, that the last steps take beside that
MAX_MISFIT = 8.0  # s between an arrival and the end of a stay, beyond which nobody is sent to a seat that is held
EARLY = 2.0  # by which a second too early counts as much as one too late
RETURN = 2.0  # s, by which a person who has just been in that group counts as later
MIN_GAIN = 2.0  # s, by which somebody must be better in time to take a successor's place
MIN_PACE = 0.6  # of the preferred speed, for a successor who is early


def walking_lengths(graph: BehaviorGraph, navigation: paths.Navigation) -> np.ndarray:
    """Lengths of the ways over waypoints that cost least, which are not their costs. Runs on the host.

    Returns:
        (M, G) m from each node to the centre of each group, by shortest paths around obstacles from node to node.
    """
    position, next_hop = np.asarray(graph.position), np.asarray(graph.next_hop)
    groups = np.asarray(graph.groups)
    code = *paths.CODE, "behaviors/successors"
    table = cache.load_or_build(
        "edge_lengths",
        code,
        [*paths.inputs(navigation), position],
        lambda: {"length": np.asarray(_geodesics(navigation, jnp.asarray(position, float)))},
    )
    straight = np.linalg.norm(position[:, None] - position[None, :], axis=-1)
    edge = np.where(np.isfinite(table["length"]), table["length"], straight)
    walk, at = np.zeros((len(position), len(groups))), np.tile(np.arange(len(position))[:, None], (1, len(groups)))
    for _ in position:
        onward = next_hop[at, groups[None, :]]
        onward = np.where(onward < 0, groups[None, :], onward)
        walk, at = walk + np.where(at == onward, 0.0, edge[at, onward]), onward
    return walk


@jax.jit
def _geodesics(navigation: paths.Navigation, points: Float[Array, "M 2"]) -> Float[Array, "M M"]:
    """(M, M) m, of the shortest paths around obstacles from the row's point to the column's."""

    def to(goal: Array) -> Array:
        rest = paths.build_paths_to_goal(navigation, goal)
        return jax.vmap(lambda point: paths.geodesic(navigation, point, goal, rest))(points)

    return jax.lax.map(to, points).T


def arrival_times(
    graph: BehaviorGraph, walk: Float[Array, "M G"], people: Pedestrians, memory: Memory
) -> Float[Array, "N G"]:
    """When people would be at the groups, if they went there from the next node on their way.

    Args:
        walk: (M, G) m, of ``walking_lengths``.
    """
    gap = memory.target - people.position
    first = length(gap[:, 0], gap[:, 1])
    onward = graph.position[graph.next_hop[:, graph.groups]]  # (M, G, 2), the node after each
    leg = onward - graph.position[:, None]
    after_leg = walk - length(leg[..., 0], leg[..., 1])
    # A target is a point of the node's disc, from which the next node may be nearer than from the node's centre.
    leg = onward[memory.hop] - memory.target[:, None]
    rest = jnp.maximum(after_leg[memory.hop] + length(leg[..., 0], leg[..., 1]), 0.0)
    rest = jnp.where(memory.hop[:, None] == graph.groups[None, :], 0.0, rest)
    return CROWD * (first[:, None] + rest) / jnp.maximum(people.preferred_speed, 1e-3)[:, None] + SETTLING


def send(
    graph: BehaviorGraph,
    arrival: Float[Array, "N G"],
    memory: Memory,
    seats: Seats,
    seekers: Bool[Array, "N"],
    draws: Draws | None = None,
) -> tuple[Memory, Bool[Array, "N"]]:
    """Successors for seats, among people who can turn to them now.

    A seat without a successor gets somebody who would arrive about when the stay ends; if nobody stands there, or only
    to wait, whoever is first there. Each seeker asks for the seat that is due first, and each seat takes the seeker who
    is best in time, if that seeker asks for it. So nobody gets two seats, and no seat gets two successors.

    Args:
        arrival: (N, G) s, when each would be at each group.
        seekers: (N,) who is at a node, goes on, and has no seat.
        draws: with a temperature, people ask and seats take by a chance that falls with the score.

    Returns:
        The memory with new seats and goals; and (N,) who has lost a seat to somebody else.
    """
    number, none = memory.seat.shape[0], jnp.zeros(memory.seat.shape, bool)
    if seats.holder.shape[0] == 0 or number == 0:
        return memory, none
    due, node = jnp.maximum(seats.time_left, 0.0), graph.seat_node
    has_successor, person = seats.successor >= 0, jnp.arange(number, dtype=jnp.int32)
    index = jnp.maximum(seats.successor, 0)
    arrival_of_successor = arrival[index, graph.seat_group]
    far = memory.hop[index] != memory.goal[index]
    replaceable = jnp.where(far, misfit(arrival_of_successor, due) - MIN_GAIN, -jnp.inf)
    limit = jnp.where(has_successor, replaceable, jnp.where(seats.time_left <= 0.0, jnp.inf, MAX_MISFIT))
    returns = jnp.where(memory.origin[:, None] == node[None, :], RETURN, 0.0)
    off = misfit(arrival[:, graph.seat_group], due[None, :]) + returns
    may = (seekers & (memory.seat < 0))[:, None] & (memory.hop[:, None] != node[None, :]) & (off < limit[None, :])
    score = jnp.where(may, off + 2.0 * seats.time_left[None, :], jnp.inf)
    if draws is None:
        seat, taker = jnp.argmin(score, axis=1).astype(jnp.int32), jnp.argmin(score, axis=0).astype(jnp.int32)
    else:
        seat, asks = relaxation.drawn(relaxation.log_chances(score, draws.temperature), draws.seat)
        taker, takes = relaxation.drawn(relaxation.log_chances(score.T, draws.temperature), draws.taker)
        asks, takes = (jnp.where(jnp.any(may, axis=k), part, 0.0) for k, part in ((1, asks), (0, takes)))
        memory = relaxation.added(memory, jnp.sum(asks) + jnp.sum(takes))
    takes = (taker[seat] == person) & jnp.isfinite(jnp.min(score, axis=1))
    given = takes[taker] & (seat[taker] == jnp.arange(taker.shape[0], dtype=jnp.int32))
    walks = (memory.seat >= 0) & (memory.stay == 0)
    loses = walks & of_seat(given, memory.seat)
    memory = memory._replace(
        seat=jnp.where(takes, seat, jnp.where(loses, -1, memory.seat)),
        goal=jnp.where(takes, node[seat], memory.goal),
    )
    return memory, loses


def misfit(arrival: Float[Array, "..."], due: Float[Array, "..."]) -> Float[Array, "..."]:
    """How badly an arrival suits the end of a stay.

    Returns:
        (...) s too late, or so many times ``EARLY`` too early.
    """
    return jnp.maximum(arrival - due, EARLY * (due - arrival))


def pace(graph: BehaviorGraph, arrival: Float[Array, "N G"], memory: Memory, seats: Seats) -> Float[Array, "N"]:
    """Share of the preferred speed at which people walk: successors who would be early go slower.

    Returns:
        (N,) from ``MIN_PACE`` to 1.
    """
    if graph.seat_group.shape[0] == 0:
        return jnp.ones(memory.seat.shape, float)
    own = jnp.take_along_axis(arrival, of_seat(graph.seat_group, memory.seat)[:, None], axis=1)[:, 0]
    left = jnp.where((memory.seat >= 0) & (memory.stay == 0), of_seat(seats.time_left, memory.seat), 0.0)
    return jnp.clip(own / jnp.maximum(left, 1e-3), MIN_PACE, 1.0)

"""Choices on the Behavior Graph (section IV-D): next nodes and goals, and the successors at the seats of groups.

The paper's Behavior Graph "maintains" group formations although each member stays for a few seconds only. So a seat has
a holder, who stands there, and a successor, who walks there. The successor is chosen before the holder's stay ends,
among people who pass a node, by arrival time. When the stay is over, the holder waits for the successor, for a bounded
time. While a successor is still nodes away, a person with a much better arrival time takes the successor's place.

Goals, routes, seats and stay times are discrete: a small change of a weight changes nothing, or everything after it.
With a temperature T each choice is sampled with a differentiable chance, and the state has the sum of the log chances
of all choices. Then

    d E[f] = E[df + (f - b) d(log chance)]

where df is the derivative with fixed samples, and b a baseline that does not depend on this episode's choices. This is
unbiased for all f, unlike a relaxation that walks a bit towards each goal. As T goes to 0 people choose as without one:
the cheapest way, the best seat, stays uniform between two limits. Without a temperature nothing of this is computed.

Source: P. W. Glynn, Likelihood ratio gradient estimation for stochastic systems, Communications of the ACM 33(10),
1990; W. Kool, H. van Hoof & M. Welling, Buy 4 REINFORCE samples, get a baseline for free!, 2019 (b: the others' mean).
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax.core.data_types import Array, Pedestrians
from sean_jax.core.geometry import length
from sean_jax.core.padding import in_programs
from sean_jax.graph import BehaviorGraph
from sean_jax.graph.annotation import NODES
from sean_jax.graph.behavior_graph import costs_of_tastes, hop_log_chances
from sean_jax.io import cache
from sean_jax.social_forces.forces import components
from sean_jax.world import navigation as paths

ARRIVED = 1.0  # m from the target, where a waypoint counts as reached (SEAN 2.0)
MAX_WAIT = 5.0  # s, for which the holder of a seat waits for a successor; at most the longest stay at that group
HAND_OVER = 1.0  # m between a successor and the seat, where a holder whose stay is over leaves
STAND_BY = 0.9  # m from the seat, where an early successor waits
CROWD = 1.1  # duration of a walk over its length at the preferred speed
LAST_STEPS = 1.0  # s, in addition
MAX_MISFIT = 8.0  # s between an arrival and the end of a stay, beyond which nobody is sent to a taken seat
EARLY = 2.0  # cost of a second too early over the cost of a second too late
RETURN = 2.0  # s, penalty of a person who has just left the group
MIN_GAIN = 2.0  # s, by which a person must be better in time to replace a successor
MIN_PACE = 0.6  # of the preferred speed, for an early successor
WALK = 1.0  # m/s, converts a temperature in metres to seconds, for choices between times
SHORTEST = 1e-3  # s, minimum difference of the limits of stays
PERSON_FIELDS = "goal", "hop", "origin", "target", "seat", "stay"  # fields of ``GraphMemory`` with a row a person


class Draws(NamedTuple):
    """Additional uniform numbers, from 0 to 1, of a step with a temperature."""

    temperature: Float[Array, ""]  # m
    hop: Float[Array, "N"]  # route
    stay: Float[Array, "N"]  # stay time beyond its limits
    seat: Float[Array, "N"]  # seat that a person asks for
    taker: Float[Array, "Q"]  # person whom a seat takes


def draw(key: Array, temperature: Float[Array, ""], people: int, seats: int) -> Draws:
    """The draws of a step with a temperature [m]."""
    person_key, seat_key = jax.random.split(key)
    hop, stay, seat = jax.random.uniform(person_key, (3, people), float)
    taker = jax.random.uniform(seat_key, (seats,), float)
    return Draws(temperature, hop, stay, seat, taker)


def sample(log_chance: Float[Array, "N K"], chance: Float[Array, "N"]) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """One of K for each of N by a uniform number from 0 to 1, and its log chance."""
    constant = jax.lax.stop_gradient(log_chance)
    cumulative = jnp.cumsum(jnp.exp(constant), axis=1)  # (N, K)
    index = first_above(cumulative, chance, log_chance.shape[1])
    sampled = jnp.take_along_axis(log_chance, index[:, None], axis=1)
    return index, sampled[:, 0]


def first_above(
    cumulative: Float[Array, "N K"], chance: Float[Array, "N"], count: Int[Array, ""] | int
) -> Int[Array, "N"]:
    """The index, below ``count``, of the first cumulative sum above a share of the whole."""
    limit = chance[:, None] * cumulative[:, -1:]
    index = jnp.sum(cumulative <= limit, axis=1, dtype=jnp.int32)
    return jnp.minimum(index, count - 1)


def log_chances(score: Float[Array, "N K"], temperature: Float[Array, ""]) -> Float[Array, "N K"]:
    """Log chances by a softmax over scores [s], where lower is likelier, with a temperature [m].

    A score of inf cannot be chosen. A row without finite scores gets any finite numbers.
    """
    possible = jnp.isfinite(score)
    finite_score = jnp.where(possible, score, 0.0)
    logits = -finite_score * (WALK / temperature)
    logits = jnp.where(possible, logits, -1e30)
    return jax.nn.log_softmax(logits, axis=1)


def sample_stay(
    limits: Float[Array, "N 2"], chance: Float[Array, "2 N"], temperature: Float[Array, ""], time_step: float
) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """Stay times in ticks, uniform between two limits [s] with soft edges, rounded up; and their log chances.

    The time is the sum of a uniform and a logistic one, whose chances are differences of softplus functions.

    Args:
        chance: uniform from 0 to 1.
        temperature: m.
        time_step: s, of a tick.
    """
    width = temperature / WALK
    low, high = components(limits)
    high = jnp.maximum(high, low + SHORTEST)
    uniform = low + chance[0] * (high - low)
    noise = jnp.clip(chance[1], 1e-6, 1.0 - 1e-6)
    logistic = jnp.log(noise) - jnp.log1p(-noise)
    time = jnp.maximum(uniform + width * logistic, 0.0)
    ticks = jnp.ceil(time / time_step)
    ticks = jax.lax.stop_gradient(ticks)

    def cumulative(time: Array) -> Array:
        """The chance of a shorter time."""
        above_low = jax.nn.softplus((time - low) / width)
        above_high = jax.nn.softplus((time - high) / width)
        return width * (above_low - above_high) / (high - low)

    # The chance of a number of ticks is that of all times that are rounded up to it.
    before = cumulative((ticks - 1.0) * time_step)
    before = jnp.where(ticks > 0.0, before, 0.0)
    share = cumulative(ticks * time_step) - before
    log_chance = jnp.log(jnp.maximum(share, 1e-12))
    return ticks.astype(jnp.int32), log_chance


def switched_share(distance: Float[Array, "N"], before: Float[Array, "N"], radius: float) -> Float[Array, "N"]:
    """The fraction of a step, from 0 to 1, that people walk towards their next target.

    People come within ``radius`` [m] of a target during a step, not at its end. With this share of the new direction
    and the rest of the old direction, positions are continuous in the step of arrival.

    Args:
        distance: m, to the target that is reached.
        before: m, additional distance one step ago, at the present speed.
    """
    return jnp.clip((radius - distance) / jnp.maximum(before, 1e-6), 0.0, 1.0)


def expectation(values: Float[Array, "B"], log_chance: Float[Array, "B"]) -> Float[Array, ""]:
    """The mean over two or more episodes, with an unbiased gradient of the expected value.

    Args:
        values: a measure of each episode.
        log_chance: ``state.memory.log_chance`` of each.
    """
    constant = jax.lax.stop_gradient(values)
    baseline = (jnp.sum(constant) - constant) / max(values.shape[0] - 1, 1)  # mean of the others
    weight = (constant - baseline) * (log_chance - jax.lax.stop_gradient(log_chance))
    return jnp.mean(values) + jnp.mean(weight)


class TripMemory(NamedTuple):
    """What people on trips remember besides."""

    errand: Int[Array, "N"]  # ticks left at a waypoint, in the last of which a person chooses the next goal
    visited: Int[Array, "N 2"]  # the last two goals, -1 none
    intent: Float[Array, "N 2"]  # m/s, the velocity that people want; it changes gradually
    blocked: Float[Array, "N"]  # s for which a person has not got on
    taste: Int[Array, "N"] | None = None  # index into ``BehaviorGraph.tastes``; None if there are none


class GraphMemory(NamedTuple):
    """Where each person is on the graph.

    At most two people have the same seat: its holder, who stands there, and a successor, who walks there.
    """

    goal: Int[Array, "N"]  # final node
    hop: Int[Array, "N"]  # next node
    origin: Int[Array, "N"]  # last node; the next one before the first edge
    target: Float[Array, "N 2"]  # m, the point of the next node's disc, or the seat
    seat: Int[Array, "N"]  # seat of a holder or successor, -1 none
    stay: Int[Array, "N"]  # maximum of ticks left at the seat, waiting included; 0 for people who do not stand
    seat_position: Float[Array, "Q 2"]  # m
    seat_heading: Float[Array, "Q 2"]  # unit vector
    log_chance: Float[Array, ""] | None = None  # of all choices so far; None without a temperature
    trip: TripMemory | None = None  # of ``routing="trips"``
    passengers: Int[Array, "B"] | None = None  # of each bus, who have still to come in; on trips

    def with_choices(self, log_chance: Float[Array, ""]) -> "GraphMemory":
        """The memory after further choices, whose log chances add up to ``log_chance``."""
        assert self.log_chance is not None  # set by reset
        return self._replace(log_chance=self.log_chance + log_chance)

    def of_people(self, person: Int[Array, "K"]) -> "GraphMemory":
        """The memory of some people."""
        fields = {name: getattr(self, name)[person] for name in PERSON_FIELDS}
        trip = jax.tree.map(lambda values: values[person], self.trip)
        return self._replace(**fields, trip=trip)

    def with_trip(self, **fields: Array) -> "GraphMemory":
        """The memory with other values of some fields of ``trip``."""
        assert self.trip is not None  # of ``routing="trips"``
        return self._replace(trip=self.trip._replace(**fields))


def taste_of(memory: GraphMemory) -> Int[Array, "N"] | None:
    """The taste of each person; None if all take the cheapest path."""
    return None if memory.trip is None else memory.trip.taste


def next_nodes(
    graph: BehaviorGraph, memory: GraphMemory, node: Int[Array, "N"], goal: Int[Array, "N"]
) -> Int[Array, "N"]:
    """The node after each person's node on the way to a goal by the person's taste, -1 without a way."""
    taste = taste_of(memory)
    if taste is None or graph.tastes is None:
        return graph.next_hop[node, goal]
    return graph.tastes.next_hop[taste, node, goal]


def target_distance(people: Pedestrians, memory: GraphMemory) -> Float[Array, "N"]:
    """Distances [m] from people to their targets."""
    gap = memory.target - people.position  # (N, 2) m
    return length(*components(gap))


class Seats(NamedTuple):
    """The people of each of the Q seats."""

    holder: Int[Array, "Q"]  # person who stands there, -1 nobody
    successor: Int[Array, "Q"]  # person who walks there, -1 nobody
    time_left: Float[Array, "Q"]  # s, of the holder's drawn stay; 0 or less while the holder waits, and without one


def seats_of(memory: GraphMemory, patience: Int[Array, "Q"], time_step: float) -> Seats:
    """The holder and successor of each seat.

    Args:
        patience: ticks for which the holder of each seat waits for a successor.
        time_step: s, of control.
    """
    seat = jnp.arange(patience.shape[0], dtype=jnp.int32)
    person = jnp.arange(memory.seat.shape[0], dtype=jnp.int32)[:, None]
    has_seat = memory.seat[:, None] == seat[None, :]  # (N, Q)
    stands = (memory.stay > 0)[:, None]

    # A seat has one holder at most, and one successor, so a maximum over people finds them.
    holders = jnp.where(has_seat & stands, person, -1)
    successors = jnp.where(has_seat & ~stands, person, -1)
    stays = jnp.where(has_seat, memory.stay[:, None], 0)
    holder = jnp.max(holders, axis=0, initial=-1)
    successor = jnp.max(successors, axis=0, initial=-1)
    stay = jnp.max(stays, axis=0, initial=0)
    time_left = (stay - patience).astype(float) * time_step
    return Seats(holder, successor, time_left)


def of_seat(values: Shaped[Array, "Q *shape"], seat: Int[Array, "N"]) -> Shaped[Array, "N *shape"]:
    """The values of people's seats; any row for people without a seat (-1), zeros if there are no seats."""
    if values.shape[0] == 0:
        return jnp.zeros((*seat.shape, *values.shape[1:]), values.dtype)
    return values[jnp.maximum(seat, 0)]


def walking_lengths(graph: BehaviorGraph, navigation: paths.Navigation) -> np.ndarray:
    """Lengths (M, G) [m] of the cheapest paths from each node to each group. Runs on the host.

    From node to node they lead around obstacles. Unlike costs they have no factors.
    """
    position = np.asarray(graph.position)
    next_hop = np.asarray(graph.next_hop)
    groups = np.asarray(graph.groups)[None, :]
    code = *paths.CODE, "people/behaviors/graph_choices"
    key = [*paths.inputs(navigation), position]
    table = cache.load_or_build("edge_lengths", code, key, lambda: {"length": _node_distances(navigation, position)})

    # Where no path leads from node to node, the straight line.
    gap = position[:, None] - position[None, :]  # (M, M, 2)
    straight = np.linalg.norm(gap, axis=-1)
    edge = table["length"]
    edge = np.where(np.isfinite(edge), edge, straight)

    # All walks one edge on, until they are at their groups.
    n_nodes = len(position)
    walk = np.zeros((n_nodes, groups.size))
    start = np.arange(n_nodes)[:, None]
    node = np.tile(start, (1, groups.size))  # (M, G)
    for _ in range(n_nodes):
        onward = next_hop[node, groups]
        onward = np.where(onward < 0, groups, onward)
        step = np.where(node == onward, 0.0, edge[node, onward])
        walk = walk + step
        node = onward
    return walk


def _node_distances(navigation: paths.Navigation, position: np.ndarray) -> np.ndarray:
    """(M, M) m of shortest paths around obstacles between nodes."""
    n_nodes = len(position)
    padded = np.pad(position, [(0, -n_nodes % NODES), (0, 0)], mode="edge")
    tables = in_programs(replace(navigation, visible=None, places=None, mesh_places=None))
    distances = _geodesics(tables, jnp.asarray(padded, float))
    return np.asarray(distances)[:n_nodes, :n_nodes]


@jax.jit
def _geodesics(navigation: paths.Navigation, points: Float[Array, "M 2"]) -> Float[Array, "M M"]:
    """Lengths [m] of the shortest paths around obstacles from the row's point [m] to the column's."""

    def lengths_to(goal: Array) -> Array:
        paths_to_goal = paths.build_paths_to_goal(navigation, goal)
        return jax.vmap(lambda point: paths.geodesic(navigation, point, goal, paths_to_goal))(points)

    return jax.lax.map(lengths_to, points).T


def arrival_times(
    graph: BehaviorGraph,
    walk: Float[Array, "M G"],
    people: Pedestrians,
    memory: GraphMemory,
    group: Int[Array, "N J"] | None = None,
) -> Float[Array, "N J"]:
    """Times [s] at which people would be at groups, if they went there from their next node.

    Args:
        walk: m, of ``walking_lengths``.
        group: the groups of each person; all groups if None.
    """
    if group is None:
        every_group = jnp.arange(graph.groups.shape[0], dtype=jnp.int32)
        group = every_group[None, :]
    hop = memory.hop[:, None]
    to_target = target_distance(people, memory)[:, None]
    onward = graph.position[graph.next_hop[:, graph.groups]]  # (M, G, 2), the node after each
    leg = onward - graph.position[:, None]
    after_leg = walk - length(*components(leg))

    # The target is a point of the node's disc, from which the next node may be nearer than from the node's centre.
    leg = onward[hop, group] - memory.target[:, None]  # (N, J, 2)
    after_target = after_leg[hop, group] + length(*components(leg))
    after_target = jnp.maximum(after_target, 0.0)
    is_goal = hop == graph.groups[group]
    after_target = jnp.where(is_goal, 0.0, after_target)

    speed = jnp.maximum(people.preferred_speed, 1e-3)
    return CROWD * (to_target + after_target) / speed[:, None] + LAST_STEPS


def send(
    graph: BehaviorGraph,
    arrival: Float[Array, "N G"],
    memory: GraphMemory,
    seats: Seats,
    seekers: Bool[Array, "N"],
    draws: Draws | None = None,
) -> tuple[GraphMemory, Bool[Array, "N"]]:
    """Sends successors to seats; returns the memory with new seats and goals, and whether people have lost their seat.

    Args:
        arrival: s, of ``arrival_times`` at all groups.
        seekers: people at a node who choose their next goal.
        draws: with a temperature, see ``offer_seats``.
    """
    if seats.holder.shape[0] == 0 or memory.seat.shape[0] == 0:
        return memory, jnp.zeros(memory.seat.shape, bool)
    of_successor = arrival[jnp.maximum(seats.successor, 0), graph.seat_group]
    limit = largest_misfit(memory, seats, of_successor)
    seat, assigned, log_chance = offer_seats(graph, arrival, memory, seats, limit, seekers, draws)

    memory, loses = lose_seats(memory, assigned)
    memory = take_seats(graph, memory, seat)
    if draws is not None:
        memory = memory.with_choices(log_chance)
    return memory, loses


def offer_seats(
    graph: BehaviorGraph,
    arrival: Float[Array, "K G"],
    memory: GraphMemory,
    seats: Seats,
    limit: Float[Array, "Q"],
    seekers: Bool[Array, "K"],
    draws: Draws | None = None,
    barred: Bool[Array, "K G"] | None = None,
) -> tuple[Int[Array, "K"], Bool[Array, "Q"], Float[Array, ""]]:
    """The seat to which each of some people is sent or -1, whether seats get a new successor, and the log chance.

    A seat without a successor gets a person who arrives at the end of the stay, or as soon as possible if nobody
    stands there or the holder waits already. Each seeker asks for the seat that is due first, and each seat takes the
    seeker who is best in time, if that seeker asks for it. So nobody gets two seats, and no seat gets two successors.
    There is at least one person and one seat.

    Args:
        arrival: s, of ``arrival_times`` at all groups.
        memory: of these people.
        limit: s, of ``largest_misfit``.
        seekers: whether they are at a node and choose their next goal.
        draws: with a temperature, people ask and seats take by chances that decrease with the score.
        barred: the groups to which people do not go.
    """
    score = _seat_scores(graph, arrival, memory, seats, limit, seekers)  # (K, Q) s
    if barred is not None:
        score = jnp.where(barred[:, graph.seat_group], jnp.inf, score)
    possible = jnp.isfinite(score)

    # One round of asking and taking, not an optimal assignment: who is left over asks at the next node.
    log_chance = jnp.zeros((), float)
    if draws is None:
        seat = jnp.argmin(score, axis=1).astype(jnp.int32)  # (K,)
        taker = jnp.argmin(score, axis=0).astype(jnp.int32)  # (Q,)
    else:
        seat, log_asked = sample(log_chances(score, draws.temperature), draws.seat)
        taker, log_taken = sample(log_chances(score.T, draws.temperature), draws.taker)
        # A row without a possible pair has no chances: it made no choice, and adds 0.
        log_asked = jnp.where(jnp.any(possible, axis=1), log_asked, 0.0)
        log_taken = jnp.where(jnp.any(possible, axis=0), log_taken, 0.0)
        log_chance = jnp.sum(log_asked) + jnp.sum(log_taken)

    # Both must agree, or one person could get two seats, or one seat two successors.
    person = jnp.arange(score.shape[0], dtype=jnp.int32)
    best_score = jnp.min(score, axis=1)
    is_sent = (taker[seat] == person) & jnp.isfinite(best_score)  # (K,)
    all_seats = jnp.arange(score.shape[1], dtype=jnp.int32)
    assigned = is_sent[taker] & (seat[taker] == all_seats)  # (Q,)
    return jnp.where(is_sent, seat, -1), assigned, log_chance


def lose_seats(memory: GraphMemory, assigned: Bool[Array, "Q"]) -> tuple[GraphMemory, Bool[Array, "N"]]:
    """The memory without former successors of seats that get another one, and who these are.

    A former successor walks on without a goal, and chooses again.
    """
    walks_to_seat = (memory.seat >= 0) & (memory.stay == 0)
    loses = walks_to_seat & of_seat(assigned, memory.seat)
    return memory._replace(seat=jnp.where(loses, -1, memory.seat)), loses


def take_seats(graph: BehaviorGraph, memory: GraphMemory, seat: Int[Array, "N"]) -> GraphMemory:
    """The memory of people, some of whom are sent to a seat; -1: not sent."""
    is_sent = seat >= 0
    return memory._replace(
        seat=jnp.where(is_sent, seat, memory.seat),
        goal=jnp.where(is_sent, of_seat(graph.seat_node, seat), memory.goal),
    )


def largest_misfit(memory: GraphMemory, seats: Seats, arrival: Float[Array, "Q"]) -> Float[Array, "Q"]:
    """The misfit [s] below which a person may be sent to each seat.

    A successor who is nodes away can be replaced by somebody better, an empty seat takes anybody.

    Args:
        memory: of all people.
        arrival: s, of the present successor of each seat; any number without one.
    """
    successor = jnp.maximum(seats.successor, 0)
    is_far = memory.hop[successor] != memory.goal[successor]
    off_of_successor = misfit(arrival, jnp.maximum(seats.time_left, 0.0))
    replaceable = jnp.where(is_far, off_of_successor - MIN_GAIN, -jnp.inf)
    limit = jnp.where(seats.time_left <= 0.0, jnp.inf, MAX_MISFIT)
    return jnp.where(seats.successor >= 0, replaceable, limit)


def _seat_scores(
    graph: BehaviorGraph,
    arrival: Float[Array, "K G"],
    memory: GraphMemory,
    seats: Seats,
    limit: Float[Array, "Q"],
    seekers: Bool[Array, "K"],
) -> Float[Array, "K Q"]:
    """How badly [s] each person suits each seat: by arrival, and how soon the seat is due; inf where nobody is sent."""
    node = graph.seat_node[None, :]
    due = jnp.maximum(seats.time_left, 0.0)
    returns = jnp.where(memory.origin[:, None] == node, RETURN, 0.0)
    off = misfit(arrival[:, graph.seat_group], due[None, :]) + returns

    # Seats that are due first come first.
    seeks = seekers & (memory.seat < 0)
    is_elsewhere = memory.hop[:, None] != node
    possible = seeks[:, None] & is_elsewhere & (off < limit[None, :]) & (node >= 0)
    score = off + 2.0 * seats.time_left[None, :]
    return jnp.where(possible, score, jnp.inf)


def misfit(arrival: Float[Array, "..."], due: Float[Array, "..."]) -> Float[Array, "..."]:
    """The cost [s] of an arrival [s] for a seat that is due [s]: time too late, or ``EARLY`` times time too early."""
    late = arrival - due
    early = due - arrival
    return jnp.maximum(late, EARLY * early)


def pace(
    graph: BehaviorGraph, walk: Float[Array, "M G"], people: Pedestrians, memory: GraphMemory, seats: Seats
) -> Float[Array, "N"]:
    """Fraction of the preferred speed, from ``MIN_PACE`` to 1: early successors walk slower.

    Args:
        walk: m, of ``walking_lengths``.
    """
    if graph.seat_group.shape[0] == 0:
        return jnp.ones(memory.seat.shape, float)
    group = of_seat(graph.seat_group, memory.seat)
    expected = arrival_times(graph, walk, people, memory, group[:, None])[:, 0]
    is_successor = (memory.seat >= 0) & (memory.stay == 0)
    time_left = jnp.where(is_successor, of_seat(seats.time_left, memory.seat), 0.0)
    return jnp.clip(expected / jnp.maximum(time_left, 1e-3), MIN_PACE, 1.0)


def choose_whole(
    graph: BehaviorGraph,
    people: Pedestrians,
    memory: GraphMemory,
    seats: Seats,
    arrival: Float[Array, "N G"],
    free: Bool[Array, "N"],
    chance: Float[Array, "2 N"],
    draws: Draws | None = None,
) -> GraphMemory:
    """New goals as in the paper (section IV-D): people keep a goal until they are there.

    Seats without a successor come first, then waypoint nodes. People at a node can be sent to a seat whatever
    their goal is. A successor whose place another person takes walks to a waypoint node.

    Args:
        arrival: s, of ``arrival_times``.
        free: people without a goal.
        chance: uniform from 0 to 1.
        draws: with a temperature, see the module.
    """
    onward = free | _passes(people, memory)
    alone = people.present & (people.walking_group < 0)  # walking groups take no seats
    memory, loses = send(graph, arrival, memory, seats, onward & alone, draws)
    aimless = (free & (memory.seat < 0)) | loses
    waypoint = _other_waypoint(graph, memory.hop, chance[0])
    goal = jnp.where(aimless, waypoint, memory.goal)
    memory = _count_goals(graph, memory, goal, aimless, draws)
    return set_out(graph, memory._replace(goal=goal), onward, chance[1], draws)


def choose_edge(
    graph: BehaviorGraph,
    people: Pedestrians,
    memory: GraphMemory,
    free: Bool[Array, "N"],
    chance: Float[Array, "2 N"],
    draws: Draws | None = None,
) -> GraphMemory:
    """New goals as in SEAN 2.0's NavManager: people choose at every node and are bound to one edge.

    They go to the group that lacks most members, or if none lacks any, to a random waypoint node. A seat is reserved
    for the first person who sets out on the edge that leads to it; if the group is full by then, people draw a waypoint
    node instead. Choices of one step are simultaneous. Unlike in SEAN 2.0, paths never lead through a group.

    Args:
        free: people without a goal.
        chance: uniform from 0 to 1.
        draws: with a temperature, see the module.
    """
    onward = free | _passes(people, memory)
    seat = jnp.where(onward, -1, memory.seat)
    goal = _other_waypoint(graph, memory.hop, chance[0])
    to_waypoint = onward
    if graph.groups.shape[0]:
        node, to_group, reserves, reserved = _join_neediest(graph, people, memory, onward)
        seat = jnp.where(reserves, reserved, seat)
        goal = jnp.where(to_group, node, goal)
        to_waypoint = onward & ~to_group
    memory = _count_goals(graph, memory, goal, to_waypoint, draws)
    memory = memory._replace(seat=seat, goal=jnp.where(onward, goal, memory.goal))
    return set_out(graph, memory, onward, chance[1], draws)


def _join_neediest(
    graph: BehaviorGraph, people: Pedestrians, memory: GraphMemory, onward: Bool[Array, "N"]
) -> tuple[Int[Array, ""], Bool[Array, "N"], Bool[Array, "N"], Int[Array, "N"]]:
    """The node of the group that lacks most members, who goes there, who of them reserves a seat, and which seat."""
    is_taken = _taken(memory, graph.seat_group.shape[0])
    empty = ~is_taken & (graph.seat_node >= 0)
    group = jnp.arange(graph.groups.shape[0], dtype=jnp.int32)
    in_group = graph.seat_group[:, None] == group[None, :]  # (Q, G)
    lack = jnp.sum(in_group & empty[:, None], axis=0, dtype=jnp.int32)  # (G,)
    neediest = jnp.argmax(lack).astype(jnp.int32)
    node = graph.groups[neediest]

    # On the last edge people need a seat, and reserve it in their order.
    alone = people.present & (people.walking_group < 0)
    wants = onward & alone & (lack[neediest] > 0) & (memory.hop != node)
    on_last_edge = wants & (graph.next_hop[memory.hop, node] == node)
    reserves, seat = _in_turn(on_last_edge, empty & (graph.seat_group == neediest))
    goes = wants & (reserves | ~on_last_edge)
    return node, goes, reserves, seat


def _taken(memory: GraphMemory, seats: int) -> Bool[Array, "Q"]:
    """(Q,) seats that are reserved."""
    seat = jnp.arange(seats, dtype=jnp.int32)
    has_seat = memory.seat[:, None] == seat[None, :]  # (N, Q)
    return has_seat.any(0)


def _in_turn(seekers: Bool[Array, "N"], seats: Bool[Array, "Q"]) -> tuple[Bool[Array, "N"], Int[Array, "N"]]:
    """Whether each seeker gets one of the seats, both in their order; and which seat."""
    if seats.shape[0] == 0:
        return jnp.zeros_like(seekers), jnp.full(seekers.shape, -1, jnp.int32)
    rank = jnp.cumsum(seekers, dtype=jnp.int32) - 1
    order = jnp.cumsum(seats, dtype=jnp.int32) - 1
    match = seekers[:, None] & seats[None, :] & (rank[:, None] == order[None, :])  # (N, Q)
    seat = jnp.argmax(match, axis=1).astype(jnp.int32)
    return match.any(1), seat


def _other_waypoint(graph: BehaviorGraph, hop: Int[Array, "N"], chance: Float[Array, "N"]) -> Int[Array, "N"]:
    """A random waypoint node other than ``hop`` if there is one, in proportion to the weights."""
    return draw_waypoint(graph, waypoint_odds(graph, hop), chance)


def waypoint_odds(graph: BehaviorGraph, hop: Int[Array, "N"]) -> Float[Array, "N Mw"]:
    """The odds with which people at ``hop`` draw each waypoint: its weight, and 0 of ``hop`` itself."""
    waypoints = graph.waypoints[None, :]
    other = (waypoints != hop[:, None]) & (waypoints >= 0)
    other = other.astype(float)
    odds = other * graph.weight[graph.waypoints][None, :]
    total = jnp.sum(odds, axis=1, keepdims=True)
    return jnp.where(total > 0.0, odds, other)  # else all others have weight 0


def draw_waypoint(graph: BehaviorGraph, odds: Float[Array, "N Mw"], chance: Float[Array, "N"]) -> Int[Array, "N"]:
    """A waypoint node for each person by its odds, and a uniform number from 0 to 1."""
    cumulative = jnp.cumsum(odds, axis=1)
    n_waypoints = (graph.waypoints >= 0).sum(dtype=jnp.int32)
    return graph.waypoints[first_above(cumulative, chance, n_waypoints)]


def log_waypoint_chance(graph: BehaviorGraph, odds: Float[Array, "N Mw"], goal: Int[Array, "N"]) -> Float[Array, "N"]:
    """The log of the chance with which each person draws the goal by these odds; 0 without a choice."""
    is_goal = graph.waypoints[None, :] == goal[:, None]  # (N, Mw)
    goal_odds = jnp.sum(jnp.where(is_goal, odds, 0.0), axis=1)
    total = jnp.sum(odds, axis=1)
    chance = goal_odds / jnp.maximum(total, 1e-30)
    log_chance = jnp.log(jnp.maximum(chance, 1e-30))
    return jnp.where(total > 0.0, log_chance, 0.0)


def _count_goals(
    graph: BehaviorGraph, memory: GraphMemory, goal: Int[Array, "N"], to_waypoint: Bool[Array, "N"], draws: Draws | None
) -> GraphMemory:
    """The memory with the log chances of goals that were drawn; unchanged without draws."""
    if draws is None:
        return memory
    log_chance = log_waypoint_chance(graph, waypoint_odds(graph, memory.hop), goal)
    log_chance = jnp.where(to_waypoint, log_chance, 0.0)
    return memory.with_choices(jnp.sum(log_chance))


def _passes(people: Pedestrians, memory: GraphMemory) -> Bool[Array, "N"]:
    """Whether people have reached a node on the way to another."""
    is_there = target_distance(people, memory) < ARRIVED
    return is_there & (memory.hop != memory.goal)


def set_out(
    graph: BehaviorGraph, memory: GraphMemory, onward: Bool[Array, "N"], chance: Float[Array, "N"], draws: Draws | None
) -> GraphMemory:
    """The next node of the path and a point of its disc, for people who leave a node."""
    node = memory.hop
    goal = memory.goal
    next_hop = next_nodes(graph, memory, node, goal)

    # With a temperature the next node is drawn, and the gradient needs the chance of each draw.
    if draws is not None:
        log_chances = _hop_log_chances(graph, memory, node, goal, draws.temperature)
        choice, log_chance = sample(log_chances, draws.hop)
        chooses = onward & (next_hop >= 0) & (node != goal)
        next_hop = jnp.where(chooses, choice, next_hop)
        log_chance = jnp.where(chooses, log_chance, 0.0)
        memory = memory.with_choices(jnp.sum(log_chance))
    next_hop = jnp.where(next_hop >= 0, next_hop, goal)
    hop = jnp.where(onward, next_hop, node)

    # A point of the node's disc, or the seat.
    n_places = graph.places.shape[1]
    index = (chance * n_places).astype(jnp.int32)
    index = jnp.minimum(index, n_places - 1)
    place = graph.places[hop, index]
    to_seat = (memory.seat >= 0) & (hop == memory.goal)
    seat_position = of_seat(memory.seat_position, memory.seat)
    place = jnp.where(to_seat[:, None], seat_position, place)
    return memory._replace(
        hop=hop,
        origin=jnp.where(onward, node, memory.origin),
        target=jnp.where(onward[:, None], place, memory.target),
    )


def _hop_log_chances(
    graph: BehaviorGraph,
    memory: GraphMemory,
    node: Int[Array, "N"],
    goal: Int[Array, "N"],
    temperature: Float[Array, ""],
) -> Float[Array, "N M"]:
    """Log chances of the node after each person's node on the way to a goal, by the costs of the person's taste."""
    taste = taste_of(memory)
    if taste is None or graph.tastes is None:
        return hop_log_chances(graph.edge_cost, graph.cost, graph.is_group, temperature)[node, goal]
    by_taste = jax.vmap(hop_log_chances, in_axes=(0, 0, None, None))
    edge_cost = costs_of_tastes(graph.edge_cost, graph.tastes.factor)
    return by_taste(edge_cost, graph.tastes.cost, graph.is_group, temperature)[taste, node, goal]

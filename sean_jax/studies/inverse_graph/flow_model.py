"""The flows that a graph makes people have: a Markov chain of people with goals, differentiable by its weights.

A person at a node has a goal and goes on to it by ``graph.behavior_graph``, with a temperature. At the goal another one
is drawn, and at any waypoint the person may be sent to a group instead. On the way there somebody else
may take the place; then a goal is drawn at the next node. So the expected number of walks along each edge, and of each
turn, follows from linear equations. The behavior ``graph`` is this chain with temperature 0: how often somebody is sent
to a group comes of the time for which people stay there.

Two kinds of population: in a *closed* one people stay and go on from goal to goal, as in a simulation, and as many go
to a node in the long run as leave it. In an *open* one people enter at their start and leave at their goal, as in most
recordings.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph
from sean_jax.graph.behavior_graph import cheapest_paths, hop_log_chances

RARE = 1e-6  # share of walks that no model explains, such as turning round on the way
SELDOM = -3.0  # logarithm of the odds with which somebody at a node is sent to a group, before anything is known


@struct.dataclass
class FlowWeights:
    """What the flows on a graph of M nodes with G groups depend on, all as logarithms."""

    goal: Float[Array, "M"]  # chance of a node to be a goal, relative to the others; of a group: in an open population
    start: Float[Array, "M"]  # chance to be where somebody enters, relative to the others, in an open population
    factor: Float[Array, "M M"]  # by which the length of the directed edge is multiplied
    sent: Float[Array, "M G"]  # odds with which somebody at a node is sent to each group, in a closed population


class Flows(NamedTuple):
    """Expected numbers, for one walk from goal to goal."""

    edges: Float[Array, "M M"]  # walks from the row's node to the column's
    turns: Float[Array, "U M U"]  # from the first node over the second to the third; index M: enters, or leaves


class Layout(NamedTuple):
    """The geometry that the flows on a graph depend on, besides its weights."""

    length: Float[Array, "M M"]  # m, of each edge, inf without one
    is_group: Bool[Array, "M"]
    groups: Int[Array, "G"]  # node indices
    trips: Bool[Array, "M M"]  # whether a path leads from the row's node to the column's


def layout(graph: BehaviorGraph) -> Layout:
    """The layout of a graph."""
    gap = graph.position[:, None] - graph.position[None, :]
    away = length(gap[..., 0], gap[..., 1])
    here = jnp.eye(graph.radius.shape[0], dtype=bool)
    joined = jnp.where(jnp.isfinite(graph.edge_cost), away, jnp.inf)
    return Layout(joined, graph.is_group, graph.groups, jnp.isfinite(graph.cost) & ~here)


def weights_of(graph: BehaviorGraph) -> FlowWeights:
    """The weights that a graph is annotated with, or 1 where it says nothing; people are seldom sent to groups."""
    distance = layout(graph).length
    joined = jnp.isfinite(distance)
    ratio = jnp.where(joined, graph.edge_cost, 1.0) / jnp.where(joined, jnp.maximum(distance, 1e-6), 1.0)
    return FlowWeights(
        goal=jnp.log(jnp.maximum(jnp.where(graph.is_group, 1.0, graph.weight), 1e-9)),
        start=jnp.log(jnp.maximum(graph.spawn, 1e-9)),
        factor=jnp.log(ratio),
        sent=jnp.full((graph.radius.shape[0], graph.groups.shape[0]), SELDOM),
    )


def expected_flows(
    place: Layout,
    weights: FlowWeights,
    temperature: Float[Array, ""] | float,
    closed: bool = True,
    replaced: Float[Array, "M G"] | None = None,
) -> Flows:
    """The stationary flows of walks along each edge and of turns.

    Args:
        temperature: m, of ``route_choice``.
        closed: whether people go on from goal to goal, or enter and leave.
        replaced: (M, G) the probability that somebody who comes to a node on the way to a group is replaced by another,
            in a closed population; never if None.
    """
    joined = jnp.isfinite(place.length)
    edge_cost = jnp.where(joined, jnp.where(joined, place.length, 1.0) * jnp.exp(weights.factor), jnp.inf)
    cost, _ = cheapest_paths(edge_cost, place.is_group)
    chances = jnp.exp(hop_log_chances(edge_cost, cost, place.is_group, temperature))
    onward = chances.transpose(1, 0, 2)  # (goal, node, next)
    if not closed:
        return _open(place, weights, onward)
    return _closed(place, weights, onward, jnp.zeros_like(weights.sent) if replaced is None else replaced)


def _open(place: Layout, weights: FlowWeights, onward: Float[Array, "M M M"]) -> Flows:
    """People who enter at a start, walk to one goal and leave."""
    count = place.is_group.shape[0]
    trips = jax.nn.softmax(weights.start)[:, None] * _goal_chances(place, weights.goal)
    trips = trips / jnp.maximum(jnp.sum(trips), 1e-30)
    # Departures from u on the way to h: people who begin there, and people who pass.
    balance = jnp.eye(count)[None] - onward.transpose(0, 2, 1)
    leaving = jnp.linalg.solve(balance, trips.T[:, :, None])[..., 0]  # (goal, node)
    walks = leaving[:, :, None] * onward
    turns = jnp.zeros((count + 1, count, count + 1))
    turns = turns.at[:count, :, :count].set(jnp.einsum("huv,hvw->uvw", walks, onward))
    turns = turns.at[count, :, :count].set(jnp.einsum("vh,hvw->vw", trips, onward))
    turns = turns.at[:count, :, count].set(jnp.diagonal(walks, axis1=0, axis2=2))
    return Flows(jnp.sum(walks, axis=0), turns)


def _closed(place: Layout, weights: FlowWeights, onward: Float[Array, "M M M"], replaced: Float[Array, "M G"]) -> Flows:
    """People who go on from goal to goal. Shares are for one goal that is reached, or given up."""
    count, group = place.is_group.shape[0], place.is_group
    itself = jnp.eye(count, dtype=bool)
    drawn = _goal_chances(place, jnp.where(group, -jnp.inf, weights.goal))  # (node, goal): waypoints alone
    sent = _sent_chances(place, weights.sent)  # (node, goal): groups alone
    keeps = 1.0 - jnp.sum(sent, axis=1)  # (node,)
    gives_up = jnp.zeros((count, count)).at[place.groups].set(replaced.T)  # (goal, node)
    gives_up = jnp.where(itself | group[None, :], 0.0, gives_up)

    # Departures towards h are what begins at a node and what passes there without being sent elsewhere.
    passes = jnp.where(itself, 0.0, jnp.where(group[:, None], 1.0 - gives_up, keeps[None, :]))  # (goal, node)
    balance = jnp.eye(count)[None] - passes[:, :, None] * onward.transpose(0, 2, 1)
    departures = jnp.linalg.inv(balance)  # (goal, node, node where it began)
    arrivals = jnp.einsum("huv,hub->hvb", onward, departures)  # (goal, node, node where it began)

    # Goals reached or given up, from one to the next: the stationary state of a chain of nodes.
    begins = drawn * keeps[:, None]  # (node, goal) of arrivals at the node
    met = jnp.einsum("hvb,bh->vb", arrivals, begins)  # waypoints met on the way to the next goal, that one included
    called = jnp.where(group[:, None], jnp.eye(count), met)  # (node, node where it began): chances to be sent there
    again = jnp.einsum("vh,hwv,hw->wv", sent, arrivals, gives_up)  # (node, node where they were sent before)
    called = jnp.linalg.solve(jnp.eye(count) - again, called)
    reached = jnp.einsum("hhb,bh->hb", arrivals, begins)  # (goal, node where it began)
    calls = sent[:, :, None] * called[:, None, :]  # (node, goal, node where it began)
    ends = jnp.where(itself[:, :, None], 1.0, gives_up[:, :, None]) * arrivals  # (goal, node, node where it began)
    reached = jnp.where(group[:, None], 0.0, reached) + jnp.einsum("hwv,vhb->wb", ends, calls)
    system = jnp.concatenate([(reached - jnp.eye(count))[:-1], jnp.ones((1, count))])
    goals = jnp.linalg.solve(system, jnp.zeros(count).at[-1].set(1.0))

    source = begins * goals[:, None] + sent * (called @ goals)[:, None]  # (node, goal)
    leaving = jnp.einsum("hvb,bh->hv", departures, source)
    walks = leaving[:, :, None] * onward  # (goal, node, next)
    arriving = jnp.diagonal(walks, axis1=0, axis2=2)  # (node before, node that was the goal)
    given_up = jnp.einsum("huv,hv->uv", walks, gives_up)  # (node before, node)
    free = jnp.sum(jnp.where(group[:, None, None], 0.0, walks), axis=0) + given_up  # of people without a group to go to
    candidates = jnp.where(group[None, :], arriving, free)
    turns = jnp.einsum("huv,hv,hvw->uvw", walks, passes, onward)
    turns = turns + (arriving + given_up)[:, :, None] * jnp.einsum("vh,hvw->vw", begins, onward)[None]
    turns = turns + candidates[:, :, None] * jnp.einsum("vh,hvw->vw", sent, onward)[None]
    all_turns = jnp.zeros((count + 1, count, count + 1)).at[:count, :, :count].set(turns)
    return Flows(jnp.sum(walks, axis=0), all_turns)


def _goal_chances(place: Layout, log_weight: Float[Array, "M"]) -> Float[Array, "M M"]:
    """(M, M) the probability of the column's node as the next goal at the row's node."""
    weight = jnp.exp(log_weight - jnp.max(log_weight))
    odds = jnp.where(place.trips, weight[None, :], 0.0)
    return odds / jnp.maximum(jnp.sum(odds, axis=1, keepdims=True), 1e-30)


def _sent_chances(place: Layout, log_odds: Float[Array, "M G"]) -> Float[Array, "M M"]:
    """(M, M) the probability at the row's node of being sent to the column's, which is a group."""
    count = place.is_group.shape[0]
    odds = jnp.where(place.trips[:, place.groups], jnp.exp(log_odds), 0.0)
    return jnp.zeros((count, count)).at[:, place.groups].set(odds / (1.0 + jnp.sum(odds, axis=1, keepdims=True)))


def log_odds(chances: Float[Array, "M G"]) -> Float[Array, "M G"]:
    """(M, G) logarithms of odds against being sent nowhere, as in ``FlowWeights.sent``; tiny odds for chances of 0."""
    rest = jnp.maximum(1.0 - jnp.sum(chances, axis=1, keepdims=True), RARE)
    return jnp.log(jnp.maximum(chances, RARE) / rest)


def log_likelihood(flows: Flows, edges: Float[Array, "M M"], turns: Float[Array, "U M U"]) -> Float[Array, ""]:
    """The multinomial log-likelihood of measured turns plus that of walks, each a mean over its counts.

    Args:
        turns: (M + 1, M, M + 1) measured turns; in a closed population without entering and leaving.
    """

    def mean_log(expected: Array, counted: Array) -> Array:
        share = expected / jnp.maximum(jnp.sum(expected), 1e-30)
        return jnp.sum(counted * jnp.log(share + RARE)) / jnp.maximum(jnp.sum(counted), 1.0)

    return mean_log(flows.turns, turns) + mean_log(flows.edges, edges)

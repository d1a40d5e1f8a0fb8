"""A graph fitted to what people do on it: the flows that a graph makes, and the weights, stays and speeds that fit.

The model of flows is a Markov chain of people with goals, differentiable by its weights. A person at a node has a goal
and goes on to it by ``graph.behavior_graph``, with a temperature. At the goal another one is drawn, and at any waypoint
the person may be sent to a group instead. On the way there another person may take the seat; then a goal is drawn at
the next node. So the expected number of walks along each edge, and of each turn, follows from linear equations. The
behavior ``graph`` is this chain with temperature 0: the frequency of calls to a group follows from the time for which
people stay there.

Two kinds of population: in a *closed* one people stay and walk from goal to goal, as in a simulation, and as many go
to a node in the long run as leave it. In an *open* one people enter at their start and leave at their goal, as in most
recordings.

Weights follow the gradient of the likelihood of the measurements, with a temperature that falls from several metres to
a fraction of one: at first all ways contribute gradients, and in the end people choose ways as in the behavior. Stays
and speeds need no gradient: a few numbers describe their distributions.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array
from sean_jax.core.geometry import length
from sean_jax.graph import BehaviorGraph
from sean_jax.graph.annotation import Annotation, Edge, Node
from sean_jax.graph.behavior_graph import cheapest_paths, hop_log_chances
from sean_jax.io.progress import Progress
from sean_jax.studies.inverse_graph.measuring import Calls, FlowMeasure

RARE = 1e-6  # share of walks that no model explains, such as turning round on the way
SELDOM = -3.0  # initial logarithm of the odds that a person at a node is sent to a group


@struct.dataclass
class FlowWeights:
    """The parameters of flows on a graph of M nodes with G groups, all as logarithms."""

    goal: Float[Array, "M"]  # chance of a node to be a goal, relative to the others; of a group: in an open population
    start: Float[Array, "M"]  # weight of the node as an entrance, in an open population
    factor: Float[Array, "M M"]  # by which the length of the directed edge is multiplied
    sent: Float[Array, "M G"]  # odds that a person at a node is sent to each group, in a closed population


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
    itself = jnp.eye(graph.radius.shape[0], dtype=bool)
    edge_length = jnp.where(jnp.isfinite(graph.edge_cost), away, jnp.inf)
    trips = jnp.isfinite(graph.cost) & ~itself
    return Layout(edge_length, graph.is_group, graph.groups, trips)


def weights_of(graph: BehaviorGraph) -> FlowWeights:
    """The weights of a graph, or 1 if it has none; people are seldom called to groups."""
    distance = layout(graph).length
    joined = jnp.isfinite(distance)
    cost = jnp.where(joined, graph.edge_cost, 1.0)
    ratio = cost / jnp.where(joined, jnp.maximum(distance, 1e-6), 1.0)
    goal = jnp.where(graph.is_group, 1.0, graph.weight)
    nodes = graph.radius.shape[0]
    groups = graph.groups.shape[0]
    return FlowWeights(
        goal=jnp.log(jnp.maximum(goal, 1e-9)),
        start=jnp.log(jnp.maximum(graph.spawn, 1e-9)),
        factor=jnp.log(ratio),
        sent=jnp.full((nodes, groups), SELDOM),
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
        temperature: m, of ``hop_log_chances``.
        closed: whether people walk from goal to goal, or enter and leave.
        replaced: (M, G) the probability that a person at a node on the way to a group is replaced by another,
            in a closed population; never if None.
    """
    joined = jnp.isfinite(place.length)
    edge_cost = jnp.where(joined, place.length, 1.0) * jnp.exp(weights.factor)
    edge_cost = jnp.where(joined, edge_cost, jnp.inf)
    cost, _ = cheapest_paths(edge_cost, place.is_group)
    chances = jnp.exp(hop_log_chances(edge_cost, cost, place.is_group, temperature))
    onward = chances.transpose(1, 0, 2)  # (goal, node, next)
    if not closed:
        return _open(place, weights, onward)
    if replaced is None:
        replaced = jnp.zeros_like(weights.sent)
    return _closed(place, weights, onward, replaced)


def _open(place: Layout, weights: FlowWeights, onward: Float[Array, "M M M"]) -> Flows:
    """People who enter at a start, walk to one goal and leave."""
    count = place.is_group.shape[0]
    begins = jax.nn.softmax(weights.start)
    trips = begins[:, None] * _goal_chances(place, weights.goal)
    trips = trips / jnp.maximum(jnp.sum(trips), 1e-30)  # (start, goal)

    # Departures from u on the way to h: people who begin there, and people who pass.
    balance = jnp.eye(count)[None] - onward.transpose(0, 2, 1)
    departures = jnp.linalg.solve(balance, trips.T[:, :, None])[..., 0]  # (goal, node)
    walks = departures[:, :, None] * onward  # (goal, node, next)

    # Turns on the way, those of people who enter, and those of people who leave.
    turns = jnp.zeros((count + 1, count, count + 1))
    passing = jnp.einsum("huv,hvw->uvw", walks, onward)
    turns = turns.at[:count, :, :count].set(passing)
    entering = jnp.einsum("vh,hvw->vw", trips, onward)
    turns = turns.at[count, :, :count].set(entering)
    leaving = jnp.diagonal(walks, axis1=0, axis2=2)
    turns = turns.at[:count, :, count].set(leaving)
    return Flows(jnp.sum(walks, axis=0), turns)


class GoalChanges(NamedTuple):
    """Chances that people of a closed population get another goal; each is an axis of M nodes."""

    begins: Array  # (node, goal) drawn at a node where a walk ends
    sent: Array  # (node, goal): to a group, at any node
    gives_up: Array  # (goal, node): a group that is full, for another goal
    passes: Array  # (goal, node) on the way to a goal that stays the goal


def _goal_changes(place: Layout, weights: FlowWeights, replaced: Float[Array, "M G"]) -> GoalChanges:
    group = place.is_group
    count = group.shape[0]
    itself = jnp.eye(count, dtype=bool)

    # Waypoints alone are drawn; people are sent to groups.
    waypoint_weight = jnp.where(group, -jnp.inf, weights.goal)
    drawn = _goal_chances(place, waypoint_weight)  # (node, goal)
    sent = _sent_chances(place, weights.sent)
    keeps = 1.0 - jnp.sum(sent, axis=1)  # (node,)

    # People give up a group before they are there; on the way to a waypoint they may be sent to a group.
    gives_up = jnp.zeros((count, count)).at[place.groups].set(replaced.T)
    gives_up = jnp.where(itself | group[None, :], 0.0, gives_up)  # (goal, node)
    passes = jnp.where(group[:, None], 1.0 - gives_up, keeps[None, :])
    passes = jnp.where(itself, 0.0, passes)
    return GoalChanges(drawn * keeps[:, None], sent, gives_up, passes)


def _closed(place: Layout, weights: FlowWeights, onward: Float[Array, "M M M"], replaced: Float[Array, "M G"]) -> Flows:
    """People who walk from goal to goal. Shares are per goal that is reached or abandoned."""
    changes = _goal_changes(place, weights, replaced)
    begins, sent, gives_up, passes = changes
    group = place.is_group
    count = group.shape[0]

    # Departures towards h are what begins at a node and what passes there without being sent elsewhere.
    balance = jnp.eye(count)[None] - passes[:, :, None] * onward.transpose(0, 2, 1)
    departures = jnp.linalg.inv(balance)  # (goal, node, node where it began)
    arrivals = jnp.einsum("huv,hub->hvb", onward, departures)
    source = _sources(group, changes, arrivals)  # (node, goal)
    leaving = jnp.einsum("hvb,bh->hv", departures, source)
    walks = leaving[:, :, None] * onward  # (goal, node, next)

    # Walks end at a goal that is reached, or at a group that is abandoned.
    arriving = jnp.diagonal(walks, axis1=0, axis2=2)  # (node before, node that was the goal)
    abandoned = jnp.einsum("huv,hv->uv", walks, gives_up)  # (node before, node)
    to_waypoints = jnp.sum(jnp.where(group[:, None, None], 0.0, walks), axis=0)
    candidates = jnp.where(group[None, :], arriving, to_waypoints + abandoned)  # whom a group may call

    # At a node people go on, begin another walk, or are sent to a group.
    turns = jnp.einsum("huv,hv,hvw->uvw", walks, passes, onward)
    ending = (arriving + abandoned)[:, :, None]
    turns = turns + ending * jnp.einsum("vh,hvw->vw", begins, onward)[None]
    called = candidates[:, :, None]
    turns = turns + called * jnp.einsum("vh,hvw->vw", sent, onward)[None]
    all_turns = jnp.zeros((count + 1, count, count + 1))
    all_turns = all_turns.at[:count, :, :count].set(turns)
    return Flows(jnp.sum(walks, axis=0), all_turns)


def _sources(group: Array, changes: GoalChanges, arrivals: Float[Array, "M M M"]) -> Float[Array, "M M"]:
    """(node, goal) walks that begin, from the stationary distribution of nodes where goals are reached or abandoned.

    Args:
        arrivals: (goal, node, node where it began).
    """
    begins, sent, gives_up, _ = changes
    count = group.shape[0]
    itself = jnp.eye(count, dtype=bool)

    # How often people are called to a group at each node on the way to their next goal, also when called before.
    met = jnp.einsum("hvb,bh->vb", arrivals, begins)  # waypoints met on the way to the next goal, that one included
    called = jnp.where(group[:, None], jnp.eye(count), met)  # (node, node where it began): chances to be sent there
    again = jnp.einsum("vh,hwv,hw->wv", sent, arrivals, gives_up)  # (node, node where they were sent before)
    called = jnp.linalg.solve(jnp.eye(count) - again, called)

    # The chain of nodes where goals are reached or abandoned.
    reached = jnp.einsum("hhb,bh->hb", arrivals, begins)  # (goal, node where it began)
    calls = sent[:, :, None] * called[:, None, :]  # (node, goal, node where it began)
    ends = jnp.where(itself[:, :, None], 1.0, gives_up[:, :, None]) * arrivals  # (goal, node, node where it began)
    reached = jnp.where(group[:, None], 0.0, reached) + jnp.einsum("hwv,vhb->wb", ends, calls)

    # The chain is stationary, and its shares add up to 1.
    balance = (reached - jnp.eye(count))[:-1]
    system = jnp.concatenate([balance, jnp.ones((1, count))])
    total = jnp.zeros(count).at[-1].set(1.0)
    goals = jnp.linalg.solve(system, total)
    drawn = begins * goals[:, None]
    called_on_the_way = sent * (called @ goals)[:, None]
    return drawn + called_on_the_way


def _goal_chances(place: Layout, log_weight: Float[Array, "M"]) -> Float[Array, "M M"]:
    """(M, M) the probability of the column's node as the next goal at the row's node."""
    weight = jnp.exp(log_weight - jnp.max(log_weight))
    odds = jnp.where(place.trips, weight[None, :], 0.0)
    total = jnp.sum(odds, axis=1, keepdims=True)
    return odds / jnp.maximum(total, 1e-30)


def _sent_chances(place: Layout, log_odds: Float[Array, "M G"]) -> Float[Array, "M M"]:
    """(M, M) the probability at the row's node of being sent to the column's, which is a group."""
    count = place.is_group.shape[0]
    odds = jnp.where(place.trips[:, place.groups], jnp.exp(log_odds), 0.0)  # (M, G)
    total = 1.0 + jnp.sum(odds, axis=1, keepdims=True)
    chances = jnp.zeros((count, count))
    return chances.at[:, place.groups].set(odds / total)


def log_odds(chances: Float[Array, "M G"]) -> Float[Array, "M G"]:
    """(M, G) logarithms of odds against being sent nowhere, as in ``FlowWeights.sent``; tiny odds for chances of 0."""
    rest = 1.0 - jnp.sum(chances, axis=1, keepdims=True)
    rest = jnp.maximum(rest, RARE)
    return jnp.log(jnp.maximum(chances, RARE) / rest)


def log_likelihood(flows: Flows, edges: Float[Array, "M M"], turns: Float[Array, "U M U"]) -> Float[Array, ""]:
    """The multinomial log-likelihood of measured turns plus the log-likelihood of walks, each a mean over its counts.

    Args:
        turns: (M + 1, M, M + 1) measured turns; in a closed population without entering and leaving.
    """

    def mean_log(expected: Array, counted: Array) -> Array:
        share = expected / jnp.maximum(jnp.sum(expected), 1e-30)
        total = jnp.sum(counted * jnp.log(share + RARE))
        return total / jnp.maximum(jnp.sum(counted), 1.0)

    return mean_log(flows.turns, turns) + mean_log(flows.edges, edges)


# ------------------------------------------------------------------ the fit

WARM = 4.0  # m, temperature at the beginning
TEMPERATURE = 0.25  # m, in the end
LEARNING_RATE = 0.05
STEPS = 600
PARTS = 12  # progress is shown after each
PLAIN = 2e-3  # weight of the prior: factors near 1, and equal weights, without walks
FULL_SHARE = 0.5  # of the time, for which a group has as many members as its capacity
FEWEST_STAYS = 5  # for a distribution


@dataclass(frozen=True)
class GraphFit:
    """A graph of M nodes with G groups, as people walk on it."""

    weights: FlowWeights
    flows: Flows  # that these weights make, for one walk from a start to a goal
    stay: Float[np.ndarray, "G 2"]  # s, minimum and maximum; NaN of a group with hardly any observed stay
    capacity: np.ndarray  # (G,) people at once; 0 where nobody stood
    speed: tuple[float, float]  # m/s, mean and standard deviation of the preferred speeds; NaN without walkers
    loss: Float[np.ndarray, "K"]  # minus the log likelihood, in the course of the fit


def fit_flows(
    graph: BehaviorGraph,
    measured: FlowMeasure,
    closed: bool = True,
    temperature: float = TEMPERATURE,
    calls: Calls | None = None,
    steps: int = STEPS,
    progress: Progress | None = None,
) -> GraphFit:
    """Find the weights with which people walk as was measured.

    Of a graph only nodes and edges are used: all edges start with their lengths as costs.

    Args:
        closed: whether people walk from goal to goal, as in a simulation, or enter and leave, as in a recording.
        temperature: m, of route choice in the end.
        calls: how people were called to groups, if that is known and not to be fitted, in a closed population.
    """
    import optax

    progress = progress or Progress()

    # Calls to groups are data where they are known, or they could explain flows that routes have to explain.
    data = _fit_data(graph, measured, closed, calls)

    # A high temperature spreads walkers over all routes, so that each edge has a gradient; it cools to the end.
    steps_of_part = max(1, steps // PARTS)
    steps = steps_of_part * PARTS
    cooled = np.minimum(np.arange(steps) / (0.8 * steps), 1.0)
    schedule = WARM * (temperature / WARM) ** cooled

    optimizer = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, steps, 0.1))

    # Steps are a scan on the device; parts exist only to show progress between them.
    @jax.jit
    def descend(carry, temperatures):
        def step(carry, temperature):
            weights, momentum = carry
            value, slope = jax.value_and_grad(_loss)(weights, temperature, data)
            change, momentum = optimizer.update(slope, momentum)
            return (optax.apply_updates(weights, change), momentum), value

        return jax.lax.scan(step, carry, temperatures)

    # The start is the mean of the prior: equal goals, lengths as costs, few people sent to groups.
    weights = jax.tree.map(jnp.zeros_like, weights_of(graph))
    weights = weights.replace(sent=weights.sent + SELDOM)
    carry = weights, optimizer.init(weights)

    losses = []
    progress.start("fitting weights", PARTS)
    for part, temperatures in enumerate(np.split(schedule, PARTS)):
        with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
            carry, values = descend(carry, jnp.asarray(temperatures, float))
        losses.append(np.asarray(values))
        progress.update(part + 1, f"loss {losses[-1][-1]:.4f}")

    # Known calls replace fitted ones, whose gradient was zero.
    weights = data.with_calls(carry[0])
    flows = jax.jit(expected_flows, static_argnums=3)(data.layout, weights, temperature, closed, data.replaced)

    # Stays, capacities and speeds do not affect flows: they are read from the measurement.
    stay, capacity = _groups(measured)
    speed = np.nan, np.nan
    if len(measured.speeds):
        speed = float(np.mean(measured.speeds)), float(np.std(measured.speeds))
    return GraphFit(weights, flows, stay, capacity, speed, np.concatenate(losses))


class FitData(NamedTuple):
    """What flows are fitted to."""

    layout: Layout
    edges: Array  # (M, M) walks
    turns: Array  # (M + 1, M, M + 1)
    closed: bool
    sent: Array | None  # (M, G) chances to be sent to each group; None: they are fitted
    replaced: Array | None  # (M, G)

    def with_calls(self, weights: FlowWeights) -> FlowWeights:
        """The weights, with known chances to be sent to groups."""
        if self.sent is None:
            return weights
        return replace(weights, sent=log_odds(self.sent))


def _fit_data(graph: BehaviorGraph, measured: FlowMeasure, closed: bool, calls: Calls | None) -> FitData:
    edges = jnp.asarray(measured.edges, float)
    turns = jnp.asarray(measured.turns, float)
    count = edges.shape[0]
    if closed:  # people enter and leave only because the measurement begins and ends
        turns = turns.at[count].set(0.0)
        turns = turns.at[:, :, count].set(0.0)
    if calls is None:
        return FitData(layout(graph), edges, turns, closed, None, None)
    return FitData(layout(graph), edges, turns, closed, calls.chance_sent, calls.chance_replaced)


def _loss(weights: FlowWeights, temperature: Array, data: FitData) -> Array:
    """Minus the log-likelihood, and the prior: equal weights, and factors near 1."""
    flows = expected_flows(data.layout, data.with_calls(weights), temperature, data.closed, data.replaced)
    has_edge = np.isfinite(np.asarray(data.layout.length))
    edges = max(has_edge.sum().item(), 1)

    spread = jnp.var(weights.goal) + jnp.var(weights.start)
    sent = (weights.sent - SELDOM) ** 2
    spread = spread + jnp.sum(sent) / max(weights.sent.size, 1)
    factor = jnp.where(has_edge, weights.factor, 0.0)
    spread = spread + jnp.sum(factor**2) / edges
    return PLAIN * spread - log_likelihood(flows, data.edges, data.turns)


def _groups(measured: FlowMeasure) -> tuple[np.ndarray, np.ndarray]:
    """(G, 2) s stays, and (G,) capacities.

    Stays are uniform between two times, by the median and the interquartile range: stays that were broken off, or that
    ended late, bias these less than the extremes.
    """
    limits = []
    for stays in measured.stays:
        enough = len(stays) >= FEWEST_STAYS
        limits.append(_limits(stays) if enough else (np.nan, np.nan))

    # The capacity is the number of members whom a group had for a good share of the time.
    capacity = []
    for times in measured.members:
        as_many = np.cumsum(times[::-1])[::-1]  # s with so many members, or more
        numbers = np.flatnonzero(as_many >= FULL_SHARE * measured.seconds)
        capacity.append(int(np.max(numbers, initial=0)))
    return np.array(limits).reshape(-1, 2), np.array(capacity, int)


def _limits(stays: np.ndarray) -> tuple[float, float]:
    lower, middle, upper = np.quantile(stays, [0.25, 0.5, 0.75]).tolist()
    half = upper - lower
    return max(middle - half, 0.0), middle + half


def flow_error(expected: np.ndarray, measured: np.ndarray) -> float:
    """The total variation of flows (M, M) in any units: sum of absolute differences of their shares, from 0 to 2.

    NaN if one has no walks at all.
    """
    expected_total = float(np.sum(expected))
    measured_total = float(np.sum(measured))
    if not min(expected_total, measured_total) > 0.0:
        return float("nan")
    difference = expected / expected_total - measured / measured_total
    return float(np.abs(difference).sum())


# ------------------------------------------------------------------ graph.yaml

MEDIUM = 0.02  # by which both factors of an edge may differ from 1 and still be "medium"


def annotate(annotation: Annotation, fit: GraphFit, closed: bool, source: str) -> Annotation:
    """An annotation with the weights, stays and capacities of a fit.

    Factors are relative to the median edge, because only their ratios matter.

    Args:
        closed: whether people were in a closed population; otherwise where they enter becomes ``spawn``.
    """
    nodes = _annotated_nodes(annotation, fit, closed)
    factor = np.asarray(fit.weights.factor, float)
    index = {name: number for number, name in enumerate(annotation.nodes)}
    ends = []
    for edge in annotation.edges:
        ends.append([index[name] for name in edge.between])
    median = 0.0
    if ends:
        first, second = np.transpose(ends)
        median = float(np.median([factor[first, second], factor[second, first]]))

    edges = []
    for edge, (a, b) in zip(annotation.edges, ends, strict=True):
        forth = _relative_factor(float(factor[a, b]), median)
        back = _relative_factor(float(factor[b, a]), median)
        plain = max(abs(forth - 1.0), abs(back - 1.0)) <= MEDIUM
        edges.append(Edge(between=edge.between, weights=None if plain else (forth, back)))
    return annotation.model_copy(update={"nodes": nodes, "edges": edges, "source": source})


def _relative_factor(logarithm: float, median: float) -> float:
    """The factor of an edge, relative to the median one."""
    ratio = np.exp(logarithm - median)
    return _digits(np.clip(ratio, 1e-3, 1e3))


def _annotated_nodes(annotation: Annotation, fit: GraphFit, closed: bool) -> dict[str, Node]:
    """The nodes with weights of waypoints, stays and capacities of groups, and in an open population entrances."""
    is_group = np.array([node.kind == "group" for node in annotation.nodes.values()])
    weight = _relative(np.asarray(fit.weights.goal, float), ~is_group)
    every_node = np.ones(len(is_group), bool)
    spawn = _relative(np.asarray(fit.weights.start, float), every_node)
    group = np.cumsum(is_group) - 1  # number of the group
    nodes: dict[str, Node] = {}
    for number, (name, node) in enumerate(annotation.nodes.items()):
        changes: dict[str, object] = {} if closed else {"spawn": spawn[number]}
        if node.kind == "waypoint":
            changes["weight"] = weight[number]
        else:
            stay = fit.stay[group[number]]
            capacity = int(fit.capacity[group[number]])
            if np.isfinite(stay).all():
                shortest, longest = stay.tolist()
                changes["stay"] = (round(shortest, 1), round(longest, 1))
            if capacity >= 2:
                changes["capacity"] = capacity
        nodes[name] = node.model_copy(update=changes)
    return nodes


def _relative(logarithm: np.ndarray, counted: np.ndarray) -> list[float]:
    """Weights with a mean of 1 over the counted ones, to three digits."""
    value = np.exp(logarithm - logarithm[counted].max())
    relative = np.clip(value / value[counted].mean(), 0.0, 1e6)
    return [_digits(weight) for weight in relative]


def _digits(value: float) -> float:
    return float(f"{value:.3g}")

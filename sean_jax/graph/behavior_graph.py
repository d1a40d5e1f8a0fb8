"""The Behavior Graph as arrays (section IV-D), its cheapest paths, route choice with a temperature, congestion costs.

In the paper people take the cheapest path. With a temperature T [m] a person at node u on the way to h walks
to the neighbor v with probability proportional to exp(-(c_uv + C_vh) / T), where c is the cost of an edge and C of
the cheapest path from there: a logit model of route choice, node by node. As T goes to 0 it is the cheapest path.
Unlike it, the chances are differentiable in the costs of edges. Source: R. B. Dial, A probabilistic multipath traffic
assignment model which obviates path enumeration, Transportation Research 5(2), 1971.

In the paper an author directs people away from a congested area by edge weights. With a congestion cost, people avoid
it by themselves.

All people would take one of two routes that are nearly as long. So people differ in taste: for each taste the costs of
edges have other factors, and next nodes are those of the cheapest path by these costs.
"""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, Scenario
from sean_jax.core.devices import to_device
from sean_jax.core.geometry import length

FLOWS = ("medium", "high", "low", "forward", "backward")
"""Categories of the paper's pairs <c_uv, c_vu> of edge weights, as ``graph.yaml`` names them.

Many people walk an edge of high flow: its factors are low, so that more cheapest paths lead over it.
"""
NO_EDGE = -1
MIN_COST = 1e-9  # m, in place of a zero, which scipy would take for no edge
MIN_AREA = 1.0  # m2, of an edge between nodes that coincide
NEVER = -1e30  # log of a chance of zero; -inf would make gradients NaN
TASTE_PAIRS = 2  # of tastes that like opposite edges, besides the one of plain costs
TASTE_SEED = 0  # of the factors, which are equal in all processes
MAX_DETOUR = 1.3  # cost of a route by taste over that of the cheapest, at most


@struct.dataclass
class Tastes:
    """Costs and routes by ``T`` tastes, the first of which is plain cost; pairs of the others have inverse factors."""

    factor: Float[Array, "T M M"] = struct.field(metadata={"pad": 1.0})  # by which the cost of an edge is multiplied
    cost: Float[Array, "T M M"] = struct.field(metadata={"pad": np.inf})  # m, with the factors; as ``BehaviorGraph``'s
    next_hop: Int[Array, "T M M"] = struct.field(metadata={"pad": -1})


@struct.dataclass
class Timetable:
    """When people come in: ``I`` intervals in which entrances are open, and ``B`` buses. Others are always open."""

    open_node: Int[Array, "I"] = struct.field(metadata={"pad": -1})  # the entrance
    open: Float[Array, "I 2"]  # s of the episode, begin and end
    bus_node: Int[Array, "B"] = struct.field(metadata={"pad": -1})  # the entrance, at which nobody else comes in
    every: Float[Array, "B"] = struct.field(metadata={"pad": 1.0})  # s, between two buses
    first: Float[Array, "B"]  # s of the episode
    people: Int[Array, "B"]  # in each bus


@struct.dataclass
class BehaviorGraph:
    """``M`` nodes: ``Mw`` waypoints, and ``G`` groups with ``Q`` seats together; ``P`` places a node."""

    position: Float[Array, "M 2"]  # m
    radius: Float[Array, "M"]  # m, of the disc in which people aim at points
    is_group: Bool[Array, "M"]
    capacity: Int[Array, "M"]  # seats of a group, 0 for a waypoint
    stay: Float[Array, "M 2"]  # s, minimum and maximum of the time spent at a group, 0 for a waypoint
    visit: Float[Array, "M 2"]  # s, the same on trips
    errand: Float[Array, "M 2"]  # s, minimum and maximum of the time spent at a waypoint on trips, 0 for a group
    # people/s who come in at the node on trips, of a bus on average; people also leave where it is above 0
    entrance: Float[Array, "M"]
    timetable: Timetable
    spawn: Float[Array, "M"]  # weight of the node as a start, relative to the other nodes
    weight: Float[Array, "M"]  # chance with which a waypoint is drawn as a goal, relative to the others; 0 for a group
    # index into FLOWS of the edge from row to column, NO_EDGE without an edge
    flow: Int[Array, "M M"] = struct.field(metadata={"pad": NO_EDGE})
    # m, length times factor of the edge from row to column, inf without an edge
    edge_cost: Float[Array, "M M"] = struct.field(metadata={"pad": np.inf})
    # m, of the cheapest path that passes through waypoints only
    cost: Float[Array, "M M"] = struct.field(metadata={"pad": np.inf})
    # the node after the row's on the way to the column's, -1 without a way
    next_hop: Int[Array, "M M"] = struct.field(metadata={"pad": -1})
    waypoints: Int[Array, "Mw"] = struct.field(metadata={"pad": -1})  # node indices
    groups: Int[Array, "G"] = struct.field(metadata={"pad": -1})  # node indices
    seat_group: Int[Array, "Q"] = struct.field(metadata={"pad": -1})  # index into groups (not nodes) of each seat
    seat_node: Int[Array, "Q"] = struct.field(metadata={"pad": -1})  # node of each seat
    places: Float[Array, "M P 2"]  # m, points of the node's disc where a person can stand and see its centre
    names: tuple[str, ...] = struct.field(pytree_node=False)
    tastes: Tastes | None = None  # None: all take the cheapest path

    @property
    def nodes(self) -> int:
        """The number of nodes without padding, on the host."""
        waypoints = np.asarray(self.waypoints) >= 0
        groups = np.asarray(self.groups) >= 0
        return int(waypoints.sum() + groups.sum())


def graph_of(scenario: Scenario) -> BehaviorGraph | None:
    """The Behavior Graph of a scenario: the behavior's ``data`` or its field ``graph``; None if neither is a graph."""
    data = scenario.behavior.data
    for candidate in (data, getattr(data, "graph", None)):
        if isinstance(candidate, BehaviorGraph):
            return candidate
    return None


def routes(edge_cost: np.ndarray, is_group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cheapest paths between all pairs of nodes, by Dijkstra's algorithm on the host (section IV-D, [47]).

    A path may start and end at a group, never pass through one, so that it disrupts no group.

    Args:
        edge_cost: (M, M) m, of the directed edge from row to column, inf without one; the diagonal is ignored.
        is_group: (M,) bool.

    Returns:
        Cost (M, M) m of the path from row to column, float64, inf without a path; and the node (M, M) int32 after the
        row's on it, -1 without a path, the row's own on the diagonal.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    edge_cost = np.asarray(edge_cost, np.float64)
    count = len(edge_cost)

    # A group is two nodes: u, which edges only leave, and count + u, which edges only enter.
    nodes = np.arange(count)
    enter = np.where(np.asarray(is_group, bool), count, 0) + nodes
    is_edge = np.isfinite(edge_cost) & ~np.eye(count, dtype=bool)
    start, end = np.nonzero(is_edge)
    weight = np.maximum(edge_cost[start, end], MIN_COST)
    ends = start.astype(np.int32), enter[end].astype(np.int32)  # int32 for older versions of scipy
    edges = csr_array((weight, ends), shape=(2 * count, 2 * count))
    distance, predecessor = dijkstra(edges, indices=nodes, return_predecessors=True)

    # The first node of a path is that of the path to the predecessor of its end.
    next_hop = np.full((count, count), -1, np.int32)
    for source in range(count):
        first = np.full(2 * count, -1)
        for node in np.argsort(distance[source]):  # nearest first: its predecessor is known
            previous = predecessor[source, node]
            if previous == source:
                first[node] = node % count
            elif previous >= 0:
                first[node] = first[previous]
        next_hop[source] = first[enter]

    cost = distance[:, enter]
    np.fill_diagonal(cost, 0.0)
    np.fill_diagonal(next_hop, nodes)
    return cost, next_hop


def add_tastes(graph: BehaviorGraph, spread: float) -> BehaviorGraph:
    """The graph with tastes, on the host: equal graphs have equal ones.

    Factors of edges are lognormal, the same in both directions. None is so far from 1 that a route costs more than
    ``MAX_DETOUR`` times the cheapest: with factors from 1/s to s, a path that is cheapest by taste costs at most s^2.

    Args:
        spread: standard deviation of the log of a factor.
    """
    edge_cost = np.asarray(graph.edge_cost, np.float64)
    is_group = np.asarray(graph.is_group)
    limit = math.log(MAX_DETOUR) / 2.0 * (1.0 - 1e-5)  # rounding included
    normal = np.random.default_rng(TASTE_SEED).normal(size=(TASTE_PAIRS, *edge_cost.shape))
    upper = np.triu(np.clip(spread * normal, -limit, limit))
    log_factor = upper + np.swapaxes(upper, 1, 2)

    # Where one of a pair prefers one of two routes, the other prefers the other.
    plain = np.zeros((1, *edge_cost.shape))
    factor = np.exp(np.concatenate([plain, log_factor, -log_factor]))
    costs = [np.asarray(graph.cost)]
    next_hops = [np.asarray(graph.next_hop)]
    for taste in factor[1:]:
        cost, next_hop = routes(edge_cost * taste, is_group)
        costs.append(cost)
        next_hops.append(next_hop)
    arrays = to_device((factor, np.stack(costs), np.stack(next_hops)))
    return replace(graph, tastes=Tastes(*arrays))


def cheapest_paths(
    edge_cost: Float[Array, "M M"], is_group: Bool[Array, "M"]
) -> tuple[Float[Array, "M M"], Int[Array, "M M"]]:
    """``routes`` inside jit, by repeated squaring in the min-plus algebra."""
    count = edge_cost.shape[0]
    itself = jnp.eye(count, dtype=bool)

    # All nodes of a path but the last are waypoints: nobody walks through a group.
    onward = jnp.where(is_group[:, None], jnp.inf, edge_cost)
    onward = jnp.where(itself, 0.0, onward)
    squarings = math.ceil(math.log2(max(count - 1, 1)))
    for _ in range(squarings):
        onward = jnp.min(onward[:, :, None] + onward[None, :, :], axis=1)

    # By each first edge; groups may be left.
    first_cost = jnp.where(itself, jnp.inf, edge_cost)
    ways = first_cost[:, :, None] + onward[None, :, :]  # (from, first, to)
    first = jnp.argmin(ways, axis=1).astype(jnp.int32)
    cost = jnp.min(ways, axis=1)
    cost = jnp.where(itself, 0.0, cost)
    next_hop = jnp.where(jnp.isfinite(cost), first, -1)
    node = jnp.arange(count, dtype=jnp.int32)
    row = jnp.broadcast_to(node[:, None], (count, count))
    next_hop = jnp.where(itself, row, next_hop)
    return cost, next_hop


def hop_log_chances(
    edge_cost: Float[Array, "M M"],
    cost: Float[Array, "M M"],
    is_group: Bool[Array, "M"],
    temperature: Float[Array, ""] | float,
) -> Float[Array, "M M M"]:
    """Log chances of the next node: from the first index to the last on the way to the second.

    Chances of zero are ``NEVER``: all of a row where the goal is the node itself or cannot be reached.

    Args:
        edge_cost: m, of the edge from row to column, inf without one.
        cost: m, of ``cheapest_paths``.
        temperature: m, above 0, of the softmax over costs.
    """
    count = edge_cost.shape[0]
    node = jnp.arange(count)
    at_goal = node[None, :] == node[:, None]  # (goal, node)

    # Over edges, towards goals that can be reached, and through no group but the goal; (node, goal, next).
    exists = jnp.isfinite(edge_cost)[:, None, :] & jnp.isfinite(cost.T)[None, :, :]
    passable = ~is_group[None, None, :] | at_goal[None, :, :]
    usable = exists & ~at_goal.T[:, :, None] & passable
    total = edge_cost[:, None, :] + cost.T[None, :, :]
    total = jnp.where(usable, total, 0.0)

    # Costs above the least one, because a large number over a low temperature would be rounded.
    least = jnp.where(usable, total, jnp.inf)
    least = jnp.min(least, axis=-1, keepdims=True)  # (node, goal, 1)
    least = jnp.where(jnp.isfinite(least), least, 0.0)
    least = jax.lax.stop_gradient(least)
    score = -(total - least) / temperature
    score = jnp.where(usable, score, NEVER)
    normalizer = jax.nn.logsumexp(score, axis=-1, keepdims=True)
    return jnp.where(usable, score - normalizer, NEVER)


def rerouted(
    graph: BehaviorGraph,
    position: Float[Array, "M 2"] | None = None,
    factor: Float[Array, "M M"] | None = None,
) -> BehaviorGraph:
    """The graph with nodes at other positions [m], or costs of edges times a factor; differentiable, inside jit.

    Places in nodes' discs move along with them, and edges cost in proportion to their lengths.
    """
    is_edge = jnp.isfinite(graph.edge_cost)
    edge_cost = jnp.where(is_edge, graph.edge_cost, 1.0)
    if factor is not None:
        edge_cost = edge_cost * jnp.where(is_edge, factor, 1.0)
    if position is not None:
        new_length = _lengths(position)
        old_length = _lengths(graph.position)
        edge_cost = edge_cost * new_length / jnp.maximum(old_length, 1e-6)
        shift = position - graph.position  # (M, 2) m
        places = graph.places + shift[:, None]
        graph = replace(graph, position=position, places=places)
    edge_cost = jnp.where(is_edge, edge_cost, jnp.inf)
    return _with_costs(graph, edge_cost)


def _with_costs(graph: BehaviorGraph, edge_cost: Float[Array, "M M"]) -> BehaviorGraph:
    """The graph with other costs [m] of edges, and the cheapest paths over them, by each taste."""
    if graph.tastes is None:
        cost, next_hop = cheapest_paths(edge_cost, graph.is_group)
        return replace(graph, edge_cost=edge_cost, cost=cost, next_hop=next_hop)
    costs_by_taste = costs_of_tastes(edge_cost, graph.tastes.factor)
    cost, next_hop = jax.vmap(cheapest_paths, in_axes=(0, None))(costs_by_taste, graph.is_group)
    tastes = replace(graph.tastes, cost=cost, next_hop=next_hop)
    return replace(graph, edge_cost=edge_cost, cost=cost[0], next_hop=next_hop[0], tastes=tastes)


def costs_of_tastes(edge_cost: Float[Array, "M M"], factor: Float[Array, "K M M"]) -> Float[Array, "K M M"]:
    """Costs [m] of edges by each taste; infinite without an edge, where no number may reach a gradient."""
    is_edge = jnp.isfinite(edge_cost)
    costs = jnp.where(is_edge, edge_cost, 1.0)[None] * jnp.where(is_edge[None], factor, 1.0)
    return jnp.where(is_edge[None], costs, jnp.inf)


def _lengths(position: Float[Array, "M 2"]) -> Float[Array, "M M"]:
    """(M, M) m between nodes; 1 on the diagonal."""
    gap = position[:, None] - position[None, :]  # (M, M, 2) m
    itself = jnp.eye(position.shape[0], dtype=bool)
    dx = jnp.where(itself, 1.0, gap[..., 0])
    dy = jnp.where(itself, 0.0, gap[..., 1])
    return length(dx, dy)


def edge_areas(graph: BehaviorGraph) -> Float[Array, "M M"]:
    """The floor [m2] between two nodes, also without an edge: a strip as wide as the mean diameter of their discs."""
    gap = graph.position[:, None] - graph.position[None, :]  # (M, M, 2) m
    distance = length(gap[..., 0], gap[..., 1])
    width = graph.radius[:, None] + graph.radius[None, :]  # people aim at points of the discs, all over them
    return jnp.maximum(distance * width, MIN_AREA)


def edge_densities(
    graph: BehaviorGraph, origin: Int[Array, "N"], hop: Int[Array, "N"], walking: Bool[Array, "N"]
) -> Float[Array, "M M"]:
    """Density of people [1/m2] between two nodes. Both directions count, because they share the floor."""
    node = jnp.arange(graph.radius.shape[0], dtype=jnp.int32)[None, :]
    on_edge = walking & (origin != hop)
    leaves = (origin[:, None] == node) & on_edge[:, None]  # (N, M)
    enters = hop[:, None] == node
    count = leaves.astype(float).T @ enters.astype(float)
    return (count + count.T) / edge_areas(graph)


def add_congestion_cost(
    graph: BehaviorGraph, density: Float[Array, "M M"], congestion_cost: Float[Array, ""]
) -> BehaviorGraph:
    """The graph with edges that cost ``1 + congestion_cost * density`` times as much, and the cheapest paths over them.

    Args:
        density: 1/m2, of people on each edge.
        congestion_cost: m2; with 1, an edge with one person per m2 costs twice as much.
    """
    edge_cost = graph.edge_cost * (1.0 + congestion_cost * density)
    return _with_costs(graph, edge_cost)

"""Congestion costs: an edge costs more the more people walk on it, and paths follow (section IV-D).

In the paper an author directs people away from a congested area by edge weights. With a congestion cost, people avoid
it by themselves.
"""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array
from sean_jax.geometry import length
from sean_jax.graph.behavior_graph import BehaviorGraph
from sean_jax.graph.route_choice import cheapest_paths

MIN_AREA = 1.0  # m2, of an edge between nodes that coincide


def edge_areas(graph: BehaviorGraph) -> Float[Array, "M M"]:
    """The floor that people share between two nodes: a strip as wide as the mean diameter of the nodes' discs.

    Returns:
        (M, M) m2, whether there is an edge or not.
    """
    gap = graph.position[:, None] - graph.position[None, :]
    width = graph.radius[:, None] + graph.radius[None, :]  # people aim at points of the discs, all over them
    return jnp.maximum(length(gap[..., 0], gap[..., 1]) * width, MIN_AREA)


def edge_densities(
    graph: BehaviorGraph, origin: Int[Array, "N"], hop: Int[Array, "N"], walking: Bool[Array, "N"]
) -> Float[Array, "M M"]:
    """Density of people between two nodes. Both directions count, because they share the floor.

    Returns:
        (M, M) people per m2.
    """
    node = jnp.arange(graph.radius.shape[0], dtype=jnp.int32)
    left = (origin[:, None] == node[None, :]) & (walking & (origin != hop))[:, None]
    count = left.astype(float).T @ (hop[:, None] == node[None, :]).astype(float)
    return (count + count.T) / edge_areas(graph)


def add_congestion_cost(
    graph: BehaviorGraph, density: Float[Array, "M M"], congestion_cost: Float[Array, ""]
) -> BehaviorGraph:
    """The graph with edges that cost more where people are, and the cheapest paths over them.

    An edge costs ``1 + congestion_cost * density`` times as much. The tables of paths are those of ``routes``.

    Args:
        density: (M, M) people per m2 on each edge.
        congestion_cost: () m2; with 1, an edge with one person per m2 costs twice as much.

    Returns:
        The graph with new ``edge_cost``, ``cost`` and ``next_hop``.
    """
    edge_cost = graph.edge_cost * (1.0 + congestion_cost * density)
    cost, next_hop = cheapest_paths(edge_cost, graph.is_group)
    return replace(graph, edge_cost=edge_cost, cost=cost, next_hop=next_hop)

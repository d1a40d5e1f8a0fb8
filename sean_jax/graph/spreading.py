"""Ways that avoid crowds: edges are dearer the more people walk on them, and paths follow (section IV-D).

The paper lets an author direct people away from a congested area by edge weights; here they do so by themselves.
"""

import math
from dataclasses import replace

import jax.numpy as jnp

from sean_jax.base import Array
from sean_jax.geometry import length
from sean_jax.graph.behavior_graph import BehaviorGraph

SMALLEST = 1.0  # m2, of an edge between nodes that coincide


def areas(graph: BehaviorGraph) -> Array:
    """(M, M) m2 that people have to walk on between two nodes: their distance, as wide as their discs on average."""
    gap = graph.position[:, None] - graph.position[None, :]
    width = graph.radius[:, None] + graph.radius[None, :]  # people aim at points of the discs, all over them
    return jnp.maximum(length(gap[..., 0], gap[..., 1]) * width, SMALLEST)


def crowds(graph: BehaviorGraph, origin: Array, hop: Array, walking: Array) -> Array:
    """(M, M) people per m2 between two nodes, walking either way: they share the floor.

    ``origin`` and ``hop`` (N,) int32 are the nodes between which each person is; ``walking`` (N,) bool counts.
    """
    node = jnp.arange(graph.radius.shape[0], dtype=jnp.int32)
    left = (origin[:, None] == node[None, :]) & (walking & (origin != hop))[:, None]
    count = left.astype(float).T @ (hop[:, None] == node[None, :]).astype(float)
    return (count + count.T) / areas(graph)


def spread(graph: BehaviorGraph, density: Array, spreading: Array) -> BehaviorGraph:
    """The graph with each edge's cost times ``1 + spreading * density``, and the cheapest paths over these.

    ``density`` (M, M) is in people per m2, ``spreading`` () in m2: 1 makes an edge with one person per m2 twice as
    dear. The tables are those of ``routes``, by repeated squaring in the min-plus algebra.
    """
    weight = graph.weight * (1.0 + spreading * density)
    count = weight.shape[0]
    itself = jnp.eye(count, dtype=bool)
    # Paths whose nodes but the last are waypoints: nobody walks through a group.
    onward = jnp.where(itself, 0.0, jnp.where(graph.is_group[:, None], jnp.inf, weight))
    for _ in range(math.ceil(math.log2(max(count - 1, 1)))):
        onward = jnp.min(onward[:, :, None] + onward[None, :, :], axis=1)
    ways = jnp.where(itself, jnp.inf, weight)[:, :, None] + onward[None, :, :]
    first = jnp.argmin(ways, axis=1).astype(jnp.int32)
    cost = jnp.where(itself, 0.0, jnp.min(ways, axis=1))
    next_hop = jnp.where(jnp.isfinite(cost), first, -1)
    own = jnp.broadcast_to(jnp.arange(count, dtype=jnp.int32)[:, None], (count, count))
    return replace(graph, weight=weight, cost=cost, next_hop=jnp.where(itself, own, next_hop))

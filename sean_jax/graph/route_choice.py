"""The next node on the way to a goal, as a chance: people choose among ways by their costs (section IV-D, relaxed).

Section IV-D sends everybody along the cheapest path. With a temperature T [m] a person at node u on the way to h goes
on to the neighbor v with a chance in proportion to exp(-(c_uv + C_vh) / T), where c is the cost of an edge and C that
of the cheapest path from there. This is a logit model of route choice, taken node by node. As T goes to 0 it is the
cheapest path. Its chances have a derivative by the costs of edges, which the cheapest path has not.

Source: R. B. Dial, A probabilistic multipath traffic assignment model which obviates path enumeration, Transportation
Research 5(2), 1971: a logit choice at each node, by what the rest of the way costs.
"""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array
from sean_jax.geometry import length
from sean_jax.graph.behavior_graph import BehaviorGraph

NEVER = -1e30  # log of the chance of what cannot be; -inf would make gradients NaN


def cheapest_paths(
    edge_cost: Float[Array, "M M"], is_group: Bool[Array, "M"]
) -> tuple[Float[Array, "M M"], Int[Array, "M M"]]:
    """``graph.routes`` inside jit, by repeated squaring in the min-plus algebra.

    Args:
        edge_cost: (M, M) m, of the edge from row to column, inf without one.
        is_group: (M,) nodes at which paths may only start and end.

    Returns:
        Cost (M, M) m of the cheapest path, inf without one; and the node (M, M) after the row's on it, -1 without a
        path, the row's own on the diagonal.
    """
    count = edge_cost.shape[0]
    itself = jnp.eye(count, dtype=bool)
    # Paths whose nodes but the last are waypoints: nobody walks through a group.
    onward = jnp.where(itself, 0.0, jnp.where(is_group[:, None], jnp.inf, edge_cost))
    for _ in range(math.ceil(math.log2(max(count - 1, 1)))):
        onward = jnp.min(onward[:, :, None] + onward[None, :, :], axis=1)
    ways = jnp.where(itself, jnp.inf, edge_cost)[:, :, None] + onward[None, :, :]
    first = jnp.argmin(ways, axis=1).astype(jnp.int32)
    cost = jnp.where(itself, 0.0, jnp.min(ways, axis=1))
    next_hop = jnp.where(jnp.isfinite(cost), first, -1)
    own = jnp.broadcast_to(jnp.arange(count, dtype=jnp.int32)[:, None], (count, count))
    return cost, jnp.where(itself, own, next_hop)


def hop_log_chances(
    edge_cost: Float[Array, "M M"],
    cost: Float[Array, "M M"],
    is_group: Bool[Array, "M"],
    temperature: Float[Array, ""] | float,
) -> Float[Array, "M M M"]:
    """With what chance people at a node go on to each other node, for each goal.

    Args:
        edge_cost: (M, M) m, of the edge from row to column, inf without one.
        cost: (M, M) m, of the cheapest path from row to column, of ``cheapest_paths``.
        temperature: m, above 0: ways that are dearer by so much are chosen e times less often.

    Returns:
        (M, M, M) natural logarithm of the chance to go from the first index to the last on the way to the second;
        ``NEVER`` where nobody goes. All of a row is ``NEVER`` where the goal is the node itself or cannot be reached.
    """
    count = edge_cost.shape[0]
    node = jnp.arange(count)
    at_goal = node[None, :] == node[:, None]  # (goal, node)
    usable = jnp.isfinite(edge_cost)[:, None, :] & jnp.isfinite(cost.T)[None, :, :]
    usable = usable & ~at_goal.T[:, :, None] & (~is_group[None, None, :] | at_goal[None, :, :])
    rest = jnp.where(usable, edge_cost[:, None, :] + cost.T[None, :, :], 0.0)
    # Costs beyond the least one, because a large number over a low temperature would be rounded.
    least = jnp.min(jnp.where(usable, rest, jnp.inf), axis=-1, keepdims=True)
    least = jax.lax.stop_gradient(jnp.where(jnp.isfinite(least), least, 0.0))
    score = jnp.where(usable, -(rest - least) / temperature, NEVER)
    whole = jax.nn.logsumexp(score, axis=-1, keepdims=True)
    return jnp.where(usable, score - whole, NEVER)


def rerouted(
    graph: BehaviorGraph,
    position: Float[Array, "M 2"] | None = None,
    factor: Float[Array, "M M"] | None = None,
) -> BehaviorGraph:
    """The graph with nodes at other places or with other costs of edges, differentiable by both, inside jit.

    Places in nodes' discs move along with them, and edges cost in proportion to their lengths.

    Args:
        position: (M, 2) m, of its nodes; as they are if None.
        factor: (M, M) by which the cost of the edge from row to column is multiplied; 1 if None.

    Returns:
        The graph with new ``position``, ``places``, ``edge_cost``, ``cost`` and ``next_hop``.
    """
    joined = jnp.isfinite(graph.edge_cost)
    edge_cost = jnp.where(joined, graph.edge_cost, 1.0)
    if factor is not None:
        edge_cost = edge_cost * jnp.where(joined, factor, 1.0)
    if position is not None:
        edge_cost = edge_cost * _lengths(position) / jnp.maximum(_lengths(graph.position), 1e-6)
        graph = replace(graph, position=position, places=graph.places + (position - graph.position)[:, None])
    edge_cost = jnp.where(joined, edge_cost, jnp.inf)
    cost, next_hop = cheapest_paths(edge_cost, graph.is_group)
    return replace(graph, edge_cost=edge_cost, cost=cost, next_hop=next_hop)


def _lengths(position: Float[Array, "M 2"]) -> Float[Array, "M M"]:
    """(M, M) m between nodes; 1 on the diagonal."""
    gap = position[:, None] - position[None, :]
    itself = jnp.eye(position.shape[0], dtype=bool)
    return length(jnp.where(itself, 1.0, gap[..., 0]), jnp.where(itself, 0.0, gap[..., 1]))

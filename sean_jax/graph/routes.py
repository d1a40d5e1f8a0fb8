"""Dijkstra's shortest paths between all nodes, none of which disrupts a group (section IV-D, [47])."""

import numpy as np

SHORTEST = 1e-9  # m, in place of a zero, which scipy would take for no edge


def routes(weight: np.ndarray, is_group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Costs (M, M) [m] float64 of the cheapest paths from row to column, and the next node (M, M) int32 on them.

    ``weight`` (M, M) [m] holds the cost of each directed edge, inf without one; ``is_group`` (M,) bool. A path may
    start and end at a group node, never pass one. ``next_hop[u, u] = u``; without a path the cost is inf and the
    next node -1. Edges from a node to itself are ignored.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    weight, is_group = np.asarray(weight, np.float64), np.asarray(is_group, bool)
    count = len(weight)
    # A group is two nodes: u, which edges only leave, and count + u, which edges only enter.
    enter = np.where(is_group, count, 0) + np.arange(count)
    start, end = np.nonzero(np.isfinite(weight) & ~np.eye(count, dtype=bool))
    size = (2 * count, 2 * count)
    edges = csr_array((np.maximum(weight[start, end], SHORTEST), (start, enter[end])), shape=size)
    distance, before = dijkstra(edges, indices=np.arange(count), return_predecessors=True)

    cost = distance[:, enter]
    next_hop = np.full((count, count), -1, np.int32)
    for source in range(count):
        first = np.full(2 * count, -1)
        for node in np.argsort(distance[source]):  # nearest first, so that what lies before a node is known
            previous = before[source, node]
            if previous >= 0:
                first[node] = node % count if previous == source else first[previous]
        next_hop[source] = first[enter]
    np.fill_diagonal(cost, 0.0)
    np.fill_diagonal(next_hop, np.arange(count))
    return cost, next_hop

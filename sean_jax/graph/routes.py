"""Dijkstra's shortest paths between all nodes, none of which disrupts a group (section IV-D, [47])."""

import numpy as np

MIN_COST = 1e-9  # m, in place of a zero, which scipy would take for no edge


def routes(edge_cost: np.ndarray, is_group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cheapest paths between all pairs of nodes. A path may start and end at a group, never pass one.

    Args:
        edge_cost: (M, M) m, of the directed edge from row to column, inf without one; the diagonal is ignored.
        is_group: (M,) bool.

    Returns:
        Cost (M, M) m of the path from row to column, float64, inf without a path; and the node (M, M) int32 after the
        row's on it, -1 without a path, the row's own on the diagonal.
    Source: section IV-D, [47].
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    edge_cost, is_group = np.asarray(edge_cost, np.float64), np.asarray(is_group, bool)
    count = len(edge_cost)
    # A group is two nodes: u, which edges only leave, and count + u, which edges only enter.
    enter = np.where(is_group, count, 0) + np.arange(count)
    start, end = np.nonzero(np.isfinite(edge_cost) & ~np.eye(count, dtype=bool))
    size = (2 * count, 2 * count)
    ends = start.astype(np.int32), enter[end].astype(np.int32)  # which scipy's older versions ask for
    edges = csr_array((np.maximum(edge_cost[start, end], MIN_COST), ends), shape=size)
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

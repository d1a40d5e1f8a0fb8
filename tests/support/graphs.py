"""Behavior graphs that are made up, and their shortest routes by exhaustion."""

import networkx
import numpy as np

from sean_jax.graph import annotation
from sean_jax.world import environment as environments
from support.scenes import room


def yard(folder, floor=(-12.0, -12.0, 12.0, 12.0), boxes=()):
    """An environment without or with boxes."""
    return environments.load(room(folder, floor, boxes, 6, name="yard"))


RING = 6


def ring(groups: int = 0) -> annotation.Annotation:
    """A ring of six waypoints, with groups outside of it beside the first ones."""
    angle = 2 * np.pi * np.arange(RING) / RING
    reach = 6.0 + np.array([0.0, 0.7, -0.4, 0.3, -0.6, 0.5])  # no two ways round are equally long
    nodes = {
        f"n{k}": {
            "kind": "waypoint",
            "position": (round(r * np.cos(a), 3), round(r * np.sin(a), 3)),
            "radius": 0.6,
            "spawn": 1,
        }
        for k, (r, a) in enumerate(zip(reach, angle, strict=True))
    }
    edges = [{"between": (f"n{k}", f"n{(k + 1) % RING}")} for k in range(RING)]
    for k in range(groups):
        place = (round(9.0 * np.cos(angle[k]), 3), round(9.0 * np.sin(angle[k]), 3))
        nodes[f"g{k}"] = {"kind": "group", "position": place, "radius": 1, "capacity": 2, "stay": (5, 9)}
        edges.append({"between": (f"n{k}", f"g{k}")})
    made = {"version": 1, "c_min": 0.2, "c_max": 100, "nodes": nodes, "edges": edges}
    return annotation.Annotation.model_validate(made)


def oracle(weight: np.ndarray, is_group: np.ndarray, source: int, target: int) -> float:
    """Cost of the cheapest path by networkx, on a graph without all groups but the two ends."""
    keep = [node for node in range(len(weight)) if not is_group[node] or node in (source, target)]
    directed = networkx.DiGraph()
    directed.add_nodes_from(keep)
    for u in keep:
        for v in keep:
            if u != v and np.isfinite(weight[u, v]):
                directed.add_edge(u, v, weight=weight[u, v])
    try:
        return networkx.dijkstra_path_length(directed, source, target)
    except networkx.NetworkXNoPath:
        return np.inf


def assert_routes(weight: np.ndarray, is_group: np.ndarray, cost: np.ndarray, next_hop: np.ndarray) -> None:
    count = len(weight)
    for source in range(count):
        for target in range(count):
            wanted = 0.0 if source == target else oracle(weight, is_group, source, target)
            np.testing.assert_allclose(cost[source, target], wanted, rtol=1e-5)
            if not np.isfinite(wanted):
                assert next_hop[source, target] == -1
                continue
            here, total, passed = source, 0.0, []
            while here != target and len(passed) <= count:
                after = next_hop[here, target]
                total += weight[here, after]
                passed.append(here := after)
            np.testing.assert_allclose(total, wanted, rtol=1e-5, atol=1e-6)
            assert not any(is_group[node] for node in passed[:-1])
            assert source != target or next_hop[source, source] == source

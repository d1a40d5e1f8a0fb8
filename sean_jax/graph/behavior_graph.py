"""The Behavior Graph as arrays that a simulation looks up (section IV-D)."""

from typing import Any

from flax import struct

from sean_jax.base import Array, Scenario


@struct.dataclass
class BehaviorGraph:
    """``M`` nodes, of which ``Mw`` waypoints and ``G`` groups with ``Q`` seats together; ``P`` places a node."""

    position: Array  # (M, 2) m
    radius: Array  # (M,) m, of the disc in which people aim at points
    is_group: Array  # (M,) bool
    capacity: Array  # (M,) int32 seats of a group, 0 for a waypoint
    stay: Array  # (M, 2) s, least and greatest time spent at a group, 0 for a waypoint
    spawn: Array  # (M,) weight with which somebody starts at the node
    weight: Array  # (M, M) m, length times flow weight of the edge from row to column, inf without an edge
    cost: Array  # (M, M) m, of the cheapest path that passes through waypoints only
    next_hop: Array  # (M, M) int32, the node after the row's on the way to the column's, -1 without a way
    waypoints: Array  # (Mw,) int32 node indices
    groups: Array  # (G,) int32 node indices
    seat_group: Array  # (Q,) int32 index into groups (not nodes) of each seat
    seat_node: Array  # (Q,) int32 node of each seat
    places: Array  # (M, P, 2) m, points of the node's disc where a person can stand and see its centre
    names: tuple[str, ...] = struct.field(pytree_node=False)


def graph_of(scenario: Scenario) -> Any:
    """The behavior graph that the scenario's people walk on, None if they walk otherwise."""
    data = scenario.behavior.data
    for found in (data, getattr(data, "graph", None)):
        if all(hasattr(found, field) for field in ("position", "radius", "is_group", "weight", "names")):
            return found
    return None

"""The Behavior Graph as arrays that a simulation looks up (section IV-D)."""

from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array, Scenario

FLOWS = ("medium", "high", "low", "forward", "backward")
"""Categories of the paper's pairs <c_uv, c_vu> of edge weights, as ``graph.yaml`` names them.

Many people walk an edge of high flow: its factors are low, so that more cheapest paths lead over it.
"""
NO_EDGE = -1


@struct.dataclass
class BehaviorGraph:
    """``M`` nodes: ``Mw`` waypoints, and ``G`` groups with ``Q`` seats together; ``P`` places a node."""

    position: Float[Array, "M 2"]  # m
    radius: Float[Array, "M"]  # m, of the disc in which people aim at points
    is_group: Bool[Array, "M"]
    capacity: Int[Array, "M"]  # seats of a group, 0 for a waypoint
    stay: Float[Array, "M 2"]  # s, minimum and maximum of the time spent at a group, 0 for a waypoint
    spawn: Float[Array, "M"]  # chance with which somebody starts at the node, relative to the other nodes
    weight: Float[Array, "M"]  # chance with which a waypoint is drawn as a goal, relative to the others; 0 for a group
    flow: Int[Array, "M M"]  # index into FLOWS of the edge from row to column, NO_EDGE without an edge
    edge_cost: Float[Array, "M M"]  # m, length times factor of the edge from row to column, inf without an edge
    cost: Float[Array, "M M"]  # m, of the cheapest path that passes through waypoints only
    next_hop: Int[Array, "M M"]  # the node after the row's on the way to the column's, -1 without a way
    waypoints: Int[Array, "Mw"]  # node indices
    groups: Int[Array, "G"]  # node indices
    seat_group: Int[Array, "Q"]  # index into groups (not nodes) of each seat
    seat_node: Int[Array, "Q"]  # node of each seat
    places: Float[Array, "M P 2"]  # m, points of the node's disc where a person can stand and see its centre
    names: tuple[str, ...] = struct.field(pytree_node=False)


def graph_of(scenario: Scenario) -> BehaviorGraph | None:
    """The Behavior Graph that the people of a scenario walk on.

    Args:
        scenario: of any behavior; its behavior's ``data`` is a graph or has one as its field ``graph``.

    Returns:
        The graph, or None if people walk otherwise.
    """
    data = scenario.behavior.data
    for candidate in (data, getattr(data, "graph", None)):
        if isinstance(candidate, BehaviorGraph):
            return candidate
    return None

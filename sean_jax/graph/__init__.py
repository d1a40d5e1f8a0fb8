"""The Behavior Graph (section IV-D): annotation, shortest-path tables, conversational formations."""

from sean_jax.graph.behavior_graph import FLOWS, NO_EDGE, BehaviorGraph, graph_of
from sean_jax.graph.route_choice import rerouted

__all__ = ["FLOWS", "NO_EDGE", "BehaviorGraph", "graph_of", "rerouted"]

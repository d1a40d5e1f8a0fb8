"""The Behavior Graph (section IV-D): annotation, shortest-path tables, conversational formations."""

from sean_jax.graph.behavior_graph import FLOWS, NO_EDGE, BehaviorGraph, graph_of, rerouted

__all__ = ["FLOWS", "NO_EDGE", "BehaviorGraph", "graph_of", "rerouted"]

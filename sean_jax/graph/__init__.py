"""The Behavior Graph (section IV-D): annotation, shortest-path tables, conversational formations."""

from sean_jax.graph.behavior_graph import BehaviorGraph, graph_of

__all__ = ["BehaviorGraph", "graph_of"]

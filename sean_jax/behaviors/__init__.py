"""Pedestrian behaviors (section IV-D, high level): who goes where."""

from sean_jax.behaviors import graph_behavior, handcrafted_behavior, parties, playback, random_behavior

BEHAVIORS = {
    "graph": graph_behavior.build,
    "random": random_behavior.build,
    "handcrafted": handcrafted_behavior.build,
    "playback": playback.build,
}
"""name -> (folder of the environment, environment, navigation for people, number of people) -> Behavior"""

__all__ = ["BEHAVIORS", "graph_behavior", "handcrafted_behavior", "parties", "playback"]

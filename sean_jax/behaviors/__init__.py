"""Pedestrian behaviors (section IV-D, high level): who goes where."""

from sean_jax.behaviors import graph_behavior, playback, random_behavior

BEHAVIORS = {"graph": graph_behavior.build, "random": random_behavior.build, "playback": playback.build}
"""name -> (folder of the environment, environment, navigation for people, number of people) -> Behavior"""
WITH_PARTIES = ("graph", "random")
"""behaviors that take as a fifth argument which shares of the people walk in pairs and in triples"""

__all__ = ["BEHAVIORS", "playback"]

"""Pedestrian behaviors (section IV-D, high level): the goals of people."""

from sean_jax.people.behaviors import graph_behavior, handcrafted_behavior, playback, random_behavior
from sean_jax.people.behaviors.starts import Place, count_walking_groups

BEHAVIORS = {
    "graph": graph_behavior.build,
    "random": random_behavior.build,
    "handcrafted": handcrafted_behavior.build,
    "playback": playback.build,
}
"""name -> build(place, people=None, **its own options) -> Behavior

``people`` None means the number of the environment or of the behavior's data; ``Behavior.people`` is the number.
"""

OFFERS = {"graph": ("groups",), "random": (), "handcrafted": ("handcrafted_sets",), "playback": ()}
"""name -> what robot tasks can require of the behavior (``Behavior.offers``), if its files have it"""

__all__ = ["BEHAVIORS", "OFFERS", "Place", "count_walking_groups", "graph_behavior"]

"""Pedestrian behaviors (section IV-D, high level): who goes where."""

from sean_jax.behaviors import graph_behavior, handcrafted_behavior, playback, random_behavior, walking_groups
from sean_jax.behaviors.place import Place

BEHAVIORS = {
    "graph": graph_behavior.build,
    "random": random_behavior.build,
    "handcrafted": handcrafted_behavior.build,
    "playback": playback.build,
}
"""name -> build(place, people=None, **options of its own) -> Behavior

``people`` None is as many as the environment or the behavior's data says; ``Behavior.people`` is how many there are.
"""

OFFERS = {"graph": ("groups",), "random": (), "handcrafted": ("handcrafted_sets",), "playback": ()}
"""name -> what a behavior of that name can offer to robot tasks (``Behavior.offers``), as far as its files have it"""

__all__ = ["BEHAVIORS", "OFFERS", "Place", "graph_behavior", "handcrafted_behavior", "playback", "walking_groups"]

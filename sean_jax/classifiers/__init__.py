"""Classifiers of social situations (sections III-A and IV-G), and of conversational groups."""

from sean_jax.classifiers.conversation import match_groups, o_space_groups, o_space_votes
from sean_jax.classifiers.more_situations import MORE_SITUATIONS, OBJECT_SITUATIONS
from sean_jax.classifiers.sean2 import SEAN2_SITUATIONS, sean2_thresholds
from sean_jax.classifiers.situations import SITUATIONS, Situation, Thresholds, as_situation, classify, thresholds

SITUATION_SETS = {"paper": SITUATIONS, "sean2": SEAN2_SITUATIONS, "more": SITUATIONS | MORE_SITUATIONS}
"""name -> situations: the paper's, SEAN 2.0's code, the paper's and more."""

THRESHOLD_SETS = {"paper": thresholds, "sean2": sean2_thresholds, "more": thresholds}
"""name of a set of situations -> () -> its thresholds"""

__all__ = [
    "MORE_SITUATIONS",
    "OBJECT_SITUATIONS",
    "SEAN2_SITUATIONS",
    "SITUATIONS",
    "SITUATION_SETS",
    "THRESHOLD_SETS",
    "Situation",
    "Thresholds",
    "as_situation",
    "classify",
    "match_groups",
    "o_space_groups",
    "o_space_votes",
    "sean2_thresholds",
    "thresholds",
]

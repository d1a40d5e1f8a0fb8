"""Classifiers of social situations (sections III-A and IV-G)."""

from sean_jax.classifiers.situations import SITUATIONS, Thresholds, classify, thresholds

__all__ = ["SITUATIONS", "Thresholds", "classify", "thresholds"]

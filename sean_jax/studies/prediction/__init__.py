"""Prediction: recorded people predicted by any pedestrian model, and the errors."""

from sean_jax.studies.prediction.benchmark import Scores, Windows, cut_windows, evaluate, read_windows, score
from sean_jax.studies.prediction.forecast import HABITS, observed_people, predict

__all__ = [
    "HABITS",
    "Scores",
    "Windows",
    "cut_windows",
    "evaluate",
    "observed_people",
    "predict",
    "read_windows",
    "score",
]

"""Metrics (section IV-H): one update per step, constant memory, split by social situation if that is meaningful."""

from jaxtyping import PyTree

from sean_jax.base import Array, Moment
from sean_jax.metrics import comfort, motion, path, proximity
from sean_jax.metrics.bootstrap import Estimate, aggregate, aggregate_ratio, interval, resamples
from sean_jax.metrics.metric import (
    Metric,
    as_metric,
    count_onsets,
    duration,
    final,
    maximum,
    mean,
    minimum,
    share_of_time,
    total,
)

METRICS: dict[str, Metric] = {
    "time_in_situation": path.time_in_situation,
    "path_length": path.path_length,
    "path_efficiency": path.path_efficiency,
    "path_irregularity": path.path_irregularity,
    "time_not_moving": path.time_not_moving,
    "min_distance_to_goal": path.min_distance_to_goal,
    "final_distance_to_goal": path.final_distance_to_goal,
    "min_distance_to_people": proximity.min_distance_to_people,
    "intimate_robot_on_person": proximity.intimate_robot_on_person,
    "intimate_person_on_robot": proximity.intimate_person_on_robot,
    "personal_robot_on_person": proximity.personal_robot_on_person,
    "personal_person_on_robot": proximity.personal_person_on_robot,
    "collision_robot_on_person": proximity.collision_robot_on_person,
    "collision_person_on_robot": proximity.collision_person_on_robot,
    "collision_with_obstacle": proximity.collision_with_obstacle,
    "min_distance_to_obstacles": proximity.min_distance_to_obstacles,
    "reached_goal": path.reached_goal,
    "success_by_path_length": path.success_by_path_length,
    "success_by_time": path.success_by_time,
    "personal_space_compliance": comfort.personal_space_compliance,
    "min_time_to_collision": comfort.min_time_to_collision,
    "social_work": comfort.social_work,
    "time_looked_at": comfort.time_looked_at,
    "mean_speed": motion.mean_speed,
    "mean_acceleration": motion.mean_acceleration,
    "mean_jerk": motion.mean_jerk,
    "max_speed": motion.max_speed,
    "max_acceleration": motion.max_acceleration,
    "max_jerk": motion.max_jerk,
}
TOPICS = {path: "way and goal", proximity: "distances and collisions", comfort: "comfort", motion: "motion"}
"""module of metrics -> their topic"""

Metrics = tuple[tuple[str, Metric], ...]
DEFAULT: Metrics = tuple(METRICS.items())


def topic(name: str) -> str:
    """The topic of a metric; "your own" for a user's."""
    metric = METRICS.get(name)  # a user's metric may have the name of something else in a module
    topics = (words for module, words in TOPICS.items() if metric is not None and getattr(module, name, None) is metric)
    return next(topics, "your own")


def init(moment: Moment, metrics: Metrics = DEFAULT) -> dict[str, PyTree]:
    """Running values before the first step: name -> value."""
    return {name: metric.init(moment) for name, metric in metrics}


def update(values: dict[str, PyTree], before: Moment, after: Moment, metrics: Metrics = DEFAULT) -> dict[str, PyTree]:
    """Running values one step later."""
    return {name: metric.update(values[name], before, after) for name, metric in metrics}


def compute(values: dict[str, PyTree], metrics: Metrics = DEFAULT) -> dict[str, Array]:
    """The metrics so far: name -> () or (1 + S,) with the overall figure first."""
    return {name: metric.compute(values[name]) for name, metric in metrics}


__all__ = [
    "METRICS",
    "Estimate",
    "Metric",
    "aggregate",
    "aggregate_ratio",
    "as_metric",
    "compute",
    "count_onsets",
    "duration",
    "final",
    "init",
    "interval",
    "maximum",
    "mean",
    "minimum",
    "resamples",
    "share_of_time",
    "total",
    "update",
]

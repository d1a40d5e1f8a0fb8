"""Metrics (section IV-H): one update per step, constant memory, split by social situation where that makes sense."""

from sean_jax.metrics import path, proximity
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

PATH = {
    "time_in_situation": path.time_in_situation,
    "path_length": path.path_length,
    "path_efficiency": path.path_efficiency,
    "path_irregularity": path.path_irregularity,
    "time_not_moving": path.time_not_moving,
    "min_distance_to_goal": path.min_distance_to_goal,
    "final_distance_to_goal": path.final_distance_to_goal,
}
PROXIMITY = {
    "min_distance_to_people": proximity.min_distance_to_people,
    "intimate_robot_on_person": proximity.intimate_robot_on_person,
    "intimate_person_on_robot": proximity.intimate_person_on_robot,
    "personal_robot_on_person": proximity.personal_robot_on_person,
    "personal_person_on_robot": proximity.personal_person_on_robot,
    "collision_robot_on_person": proximity.collision_robot_on_person,
    "collision_person_on_robot": proximity.collision_person_on_robot,
    "collision_with_obstacle": proximity.collision_with_obstacle,
    "min_distance_to_obstacles": proximity.min_distance_to_obstacles,
}
SUCCESS = {
    "reached_goal": path.reached_goal,
    "success_by_path_length": path.success_by_path_length,
    "success_by_time": path.success_by_time,
}
COMFORT = {
    "personal_space_compliance": proximity.personal_space_compliance,
    "min_time_to_collision": proximity.min_time_to_collision,
    "social_work": proximity.social_work,
    "time_looked_at": proximity.time_looked_at,
}
MOTION = {
    "mean_speed": path.mean_speed,
    "mean_acceleration": path.mean_acceleration,
    "mean_jerk": path.mean_jerk,
    "max_speed": path.max_speed,
    "max_acceleration": path.max_acceleration,
    "max_jerk": path.max_jerk,
}
METRICS: dict[str, Metric] = PATH | PROXIMITY | SUCCESS | COMFORT | MOTION
"""All metrics, in the order of the columns of episodes.csv."""

TOPICS = {
    "way and goal": PATH | SUCCESS,
    "distances and collisions": PROXIMITY,
    "comfort": COMFORT,
    "motion": MOTION,
}
"""What metrics are about -> metrics, for the sections of the report."""


def topic(name: str) -> str:
    """What a metric is about, in a few words; "your own" for one that does not come with the package."""
    return next((topic for topic, group in TOPICS.items() if name in group), "your own")


__all__ = [
    "METRICS",
    "TOPICS",
    "Estimate",
    "Metric",
    "aggregate",
    "aggregate_ratio",
    "as_metric",
    "count_onsets",
    "duration",
    "final",
    "interval",
    "maximum",
    "mean",
    "minimum",
    "resamples",
    "share_of_time",
    "topic",
    "total",
]

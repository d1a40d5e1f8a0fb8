"""Metrics (section IV-H): one fold per step, constant memory, split by social situation where that has a sense."""

from typing import Any

from sean_jax.base import Array, Moment
from sean_jax.metrics import comfort, motion, obstacles, path, proximity, success
from sean_jax.metrics.aggregation import Estimate, aggregate, aggregate_ratio, resamples
from sean_jax.metrics.metric import Metric

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
    "collision_with_obstacle": obstacles.collision_with_obstacle,
    "min_distance_to_obstacles": obstacles.min_distance_to_obstacles,
    "reached_goal": success.reached_goal,
    "success_by_path_length": success.success_by_path_length,
    "success_by_time": success.success_by_time,
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


def start(moment: Moment, metrics: tuple = tuple(METRICS.items())) -> dict[str, Any]:
    """Running values before the first step."""
    return {name: metric.start(moment) for name, metric in metrics}


def fold(values: dict[str, Any], before: Moment, after: Moment, metrics: tuple = tuple(METRICS.items())) -> dict:
    """Running values one step later."""
    return {name: metric.fold(values[name], before, after) for name, metric in metrics}


def results(values: dict[str, Any], metrics: tuple = tuple(METRICS.items())) -> dict[str, Array]:
    """The metrics so far: () each, or (1 + S,) with the overall figure before those by situation."""
    return {name: metric.result(values[name]) for name, metric in metrics}


__all__ = ["METRICS", "Estimate", "Metric", "aggregate", "aggregate_ratio", "fold", "resamples", "results", "start"]

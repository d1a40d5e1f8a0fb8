"""Metrics (section IV-H): one update per step, constant memory, split by social situation where that makes sense."""

from dataclasses import replace
from pathlib import Path

from sean_jax.io import files
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


def _read_metrics() -> tuple[dict[str, Metric], dict[str, dict[str, Metric]]]:
    """The metrics of metrics.yaml by name, and by topic and name."""
    functions = vars(path) | vars(proximity)
    by_name = {}
    by_topic = {}
    rows = files.read_yaml(Path(__file__).with_name("metrics.yaml"))[1]
    for name, fields in rows.items():
        group = by_topic.setdefault(fields.pop("topic"), {})
        group[name] = by_name[name] = replace(functions[name], **fields)
    return by_name, by_topic


METRICS: dict[str, Metric]
"""All metrics, in the order of the columns of episodes.csv."""

TOPICS: dict[str, dict[str, Metric]]
"""Topic -> metrics, for the sections of the report."""

METRICS, TOPICS = _read_metrics()


OF_TEAMS: dict[str, Metric] = {
    "collision_with_robot": proximity.collision_with_robot,
    "min_distance_to_robots": proximity.min_distance_to_robots,
}
"""The metrics that robots of a team have besides those of their scenario."""


OF_GROUPS: dict[str, Metric] = {
    "o_spaces_crossed": proximity.o_spaces_crossed,
    "groups_split": proximity.groups_split,
}
"""The metrics of groups, which compare all pairs of people; the benchmark measures them."""


def topic(name: str) -> str:
    """The topic of a metric in a few words; "your own" for metrics outside the package."""
    if name in OF_TEAMS | OF_GROUPS:
        return "distances and collisions"
    return next((topic for topic, group in TOPICS.items() if name in group), "your own")


__all__ = [
    "METRICS",
    "OF_GROUPS",
    "OF_TEAMS",
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

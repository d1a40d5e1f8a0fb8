"""The tracks and the scores of ``sean benchmark``, fixed for each version of the protocol.

A track is an environment with people of a behavior and a task for the robot. Its options are written out here, and not
left to this package's defaults, which may change. A digest covers the files of environments and robots and the
constants of the social forces: if it differs, results are not comparable, and nothing is run.
"""

import dataclasses
import hashlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from sean_jax import environment, files, robots
from sean_jax.config import CollectConfig
from sean_jax.metrics import Estimate, aggregate, aggregate_ratio, bootstrap
from sean_jax.social_forces import preset

VERSION = 1
EPISODES = 8_400  # of each track; 100,800 of all
SEED = 20_260  # of all episodes
QUICK = 16  # episodes of each track that tell on a CPU whether a driver works

CONTENT = "fe83b135db59a554"
"""The digest of all files and constants that the tracks of this version read."""

SITUATIONS = ("cross_path", "down_path", "join_group", "leave_group", "empty")
COMMON: dict[str, Any] = {
    "robot": "kuri",
    "dynamics": "twin",
    "model": "social_forces",
    "forces": "calibrated",
    "situations": "paper",
    "goal_sampling": "uniform",
    "time_step": 0.1,
    "time_limit": 120.0,
    "goal_radius": 1.2,
    "hold_time": 5.0,
    "task_distance": (4.0, 20.0),
    "warm_up": 0.0,
    "noise": None,
    "rate": 1,
}
PEOPLE = {"warehouse": 62, "lab": 5, "outdoor": 30}
GRAPH = {"kind": "graph", "routing": "whole", "group_membership": "turnover", "congestion_cost": 0.0,
         "temperature": 0.0, "walking_groups": (0.0, 0.0)}  # fmt: skip
RANDOM = {"kind": "random", "walking_groups": (0.0, 0.0)}
HANDCRAFTED = {"kind": "handcrafted", "sets": "all"}
BY_TASK = {"join_group": GRAPH, "leave_group": GRAPH, "random_ab_nav": RANDOM, "handcrafted": HANDCRAFTED}

TRACKS: dict[str, dict[str, Any]] = {
    f"{place}-{task}": {
        **COMMON,
        "environment": place,
        "behavior": behavior,
        "task": task,
        "people": None if behavior is HANDCRAFTED else people,
    }
    for place, people in PEOPLE.items()
    for task, behavior in BY_TASK.items()
}
"""name -> the options that make its scenario"""


def description(track: str) -> CollectConfig:
    """The scenario of one of ``TRACKS``."""
    return CollectConfig(**TRACKS[track])


def content() -> str:
    """The digest, 16 letters, of all that the tracks read beside their options."""
    digest = hashlib.sha256()
    folders = [environment.find(place) for place in PEOPLE]
    read = [file for folder in folders for file in sorted(folder.iterdir()) if file.is_file()]
    for file in [*read, robots.ROBOTS["kuri"]]:
        digest.update(f"{file.name}\n{files.read_text(file)}".encode())
    for leaf in jax.tree.leaves(preset("calibrated")):
        digest.update(" ".join(f"{value:.5g}" for value in np.ravel(np.asarray(leaf))).encode())
    return digest.hexdigest()[:16]


# ------------------------------------------------------------------ scores

RESAMPLES = 1_000
ROBOTS_FAULT = "intimate_robot_on_person", "collision_robot_on_person", "collision_with_obstacle"
COUNTED = (*ROBOTS_FAULT, "intimate_person_on_robot", "collision_person_on_robot")
METRICS = ("time_in_situation", *COUNTED, "time_not_moving", "path_efficiency")
Columns = dict[str, np.ndarray]  # of the E episodes of a track: (E,), or (E, 1 + S) overall and by situation


@dataclasses.dataclass(frozen=True)
class Scores:
    """The scores of a policy, over all tracks or on one; each number has its 95 % interval."""

    FIGURES = {
        "polite": "completed politely %",
        "completed": "completed %",
        "seconds": "s",
        "intimate_robot_on_person": "within 0.45 m, by the robot",
        "intimate_person_on_robot": "by people",
        "collision_robot_on_person": "touched people",
        "collision_with_obstacle": "touched obstacles",
    }
    figures: dict[str, Estimate]  # name of FIGURES -> () mean of an episode
    shares: Estimate  # (S,) of the time in each situation
    violations: Estimate  # (S,) times a minute, in each situation, that the robot came within 0.45 m of somebody


def polite(columns: Columns) -> np.ndarray:
    """(E,) bool, tasks that were completed without an intimate violation or a collision by the robot's fault."""
    return columns["completed"] & ~np.any([_overall(columns[name]) > 0 for name in ROBOTS_FAULT], axis=0)


def scores(measured: dict[str, Columns]) -> Scores:
    """Scores over some tracks with equal weights; a resample draws as many episodes of each."""
    each = list(measured.values())
    sizes = [len(columns["completed"]) for columns in each]
    weights = np.concatenate([bootstrap.resamples(size, seed, RESAMPLES) for seed, size in enumerate(sizes)], axis=1)

    def joined(take: Callable[[Columns], np.ndarray]) -> np.ndarray:
        return np.concatenate([np.asarray(take(columns), float) for columns in each])

    def percent(take: Callable[[Columns], np.ndarray]) -> Estimate:
        share = bootstrap.of_share(aggregate(joined(take), weights=weights))
        return share._replace(mean=100.0 * share.mean, low=100.0 * share.low, high=100.0 * share.high)

    figures = {"polite": percent(polite), "completed": percent(lambda columns: columns["completed"])}
    for name in Scores.FIGURES:
        if name not in figures:
            figures[name] = aggregate(joined(lambda columns, name=name: _overall(columns[name])), weights=weights)
    time = joined(lambda columns: columns["time_in_situation"])
    events = joined(lambda columns: columns["intimate_robot_on_person"][:, 1:])
    whole = np.repeat(time[:, :1], time.shape[1] - 1, axis=1)
    return Scores(
        figures,
        aggregate_ratio(time[:, 1:], whole, weights=weights),
        aggregate_ratio(events, time[:, 1:] / 60.0, weights=weights),
    )


def _overall(values: np.ndarray) -> np.ndarray:
    return values if values.ndim == 1 else values[:, 0]

"""The tracks of ``sean benchmark``: what drivers are compared on, fixed for each version of the protocol.

A track is an environment with people of a behavior and a task for the robot. Its options are written out here, and not
left to this package's defaults, which may change. Files of environments and robots, and the
constants of the social forces, are held by their digest: where it differs, nothing is comparable, and nothing is run.
"""

import hashlib
from typing import Any

import jax
import numpy as np

from sean_jax import environment, files, robots
from sean_jax.config import CollectConfig
from sean_jax.social_forces import preset

VERSION = 1
EPISODES = 8_400  # of each track; 100,800 of all
SEED = 20_260  # of all episodes
QUICK = 16  # episodes of each track that tell on a CPU whether a driver works

CONTENT = "fe83b135db59a554"
"""The digest of all that the tracks of this version read."""

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
    """What a track simulates.

    Args:
        track: one of ``TRACKS``.
    """
    return CollectConfig(**TRACKS[track])


def content() -> str:
    """The digest of all that the tracks read beside their options.

    Returns:
        16 letters.
    """
    digest = hashlib.sha256()
    folders = [environment.find(place) for place in PEOPLE]
    read = [file for folder in folders for file in sorted(folder.iterdir()) if file.is_file()]
    for file in [*read, robots.ROBOTS["kuri"]]:
        digest.update(f"{file.name}\n{files.read_text(file)}".encode())
    for leaf in jax.tree.leaves(preset("calibrated")):
        digest.update(" ".join(f"{value:.5g}" for value in np.ravel(np.asarray(leaf))).encode())
    return digest.hexdigest()[:16]

"""An evaluation that nobody simulated, and its report."""

import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

from sean_jax.evaluation import Evaluation, compare, results
from sean_jax.metrics import METRICS
from sean_jax.web import replay
from support.drawn import Graph, environment, frames

NAMES = ("cross_path", "down_path", "join_group", "leave_group", "empty")
EPISODES = 12
MEASURED = ("path_efficiency", "time_in_situation", "intimate_robot_on_person", "min_distance_to_people")


def evaluation() -> Evaluation:
    draw = np.random.default_rng(3)
    spent = draw.uniform(0, 5, (EPISODES, 5)).astype(np.float32)
    spent[:, 1] = 0.0  # nobody walked down the robot's path
    spent[::2, 2] = 0.0
    seconds = spent.sum(1)
    completed = np.arange(EPISODES) % 3 != 0
    counts = draw.poisson(0.7, (EPISODES, 5)).astype(np.float32)
    efficiency = draw.uniform(1, 1.5, EPISODES).astype(np.float32)
    return Evaluation(
        scenario=None,  # pyright: ignore[reportArgumentType] # not needed here
        policy="go_to_goal",
        situations=NAMES,
        tasks=["join_group", "leave_group"] * (EPISODES // 2),
        completed=completed,
        timed_out=~completed,
        seconds=seconds,
        metrics={
            "path_efficiency": efficiency,
            "time_in_situation": np.concatenate([seconds[:, None], spent], 1),
            "intimate_robot_on_person": np.concatenate([counts.sum(1, keepdims=True), counts], 1),
            "min_distance_to_people": np.where(np.arange(EPISODES) == 4, np.inf, 0.8).astype(np.float32),
        },
        definitions={name: METRICS[name] for name in MEASURED},
        heat=np.ones((20, 24)),
        walks=np.array([[0, 30, 9], [0, 0, 0], [9, 0, 0]]),
        together=np.array([1.0, 2.0, 0.0, 4.0] + [0.0] * 28),
        penetration=-0.1,
        group_size=np.array([5, 3, 3]),
        frames=[frames()],
        compile_seconds=1.0,
        run_seconds=2.0,
        wanted=EPISODES,
    )


def page(given: Evaluation, runs: Sequence[compare.SavedRun] = ()) -> str:
    """The report of those results, beside a baseline."""
    there = dataclasses.replace(environment(), name="yard <1>")
    robot = SimpleNamespace(name="kuri", radius=0.16)
    scenario: Any = SimpleNamespace(
        environment=there,
        behavior=SimpleNamespace(name="graph", data=Graph),
        robot=robot,
        people=3,
        time_step=0.1,
        time_limit=25.0,
        others=None,
    )
    given = dataclasses.replace(given, scenario=scenario)
    summary = results.aggregate_episodes(given) | {
        "simulated_seconds": 25.0,
        "checks": {"largest_penetration_mm": 0.0, "largest_groups": [5, 3, 3], "not_finite": 0},
        "timing": {"compile_seconds": 1.0, "run_seconds": 2.0, "simulated_seconds_per_second": 5.0, "device": "cpu"},
    }
    shown = [replay.ReplayEpisode(frames, f"episode {k}") for k, frames in enumerate(given.frames)]
    recording = replay.recording(shown, environment(), graph=Graph, situations=given.situations)
    with mock.patch.object(results.drawing, "graph_of", lambda scenario: Graph):
        return results.report_page(
            given, summary, recording, "sean run --environment yard", {"jax": "1.2.3"}, runs=runs
        )

"""Scores of the benchmark: rows of the episodes of tracks, and means over tracks with equal weights, with intervals."""

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from sean_jax.metrics import OF_GROUPS
from sean_jax.metrics.bootstrap import of_count, resamples
from sean_jax.studies.experiments.measures import percent
from sean_jax.studies.experiments.results_table import ALL, Estimates, Table, estimate, join, rows
from sean_jax.studies.experiments.shares import NAMES

SCORE_RESAMPLES = 1_000
APPROACHES = "intimate_robot_on_person"
ROBOTS_FAULT = APPROACHES, "collision_robot_on_person", "collision_with_obstacle"
COUNTED = (*ROBOTS_FAULT, "intimate_person_on_robot", "collision_person_on_robot", *OF_GROUPS)
MEASURED = ("time_in_situation", *COUNTED, "time_not_moving", "path_efficiency")
Arrays = dict[str, np.ndarray]  # of the E episodes of a track: (E,), or (E, 1 + S) overall and by situation

FIGURES = {
    "polite": "completed politely %",
    "completed": "completed %",
    "seconds": "s",
    "intimate_robot_on_person": "within 0.45 m, by the robot",
    "intimate_person_on_robot": "by people",
    "collision_robot_on_person": "touched people",
    "collision_with_obstacle": "touched obstacles",
    "o_spaces_crossed": "crossed o-spaces",
    "groups_split": "split groups",
}
"""Measure of an episode -> its title."""
SHARE_OF_TIME, PER_MINUTE = "share_of_time", "violations_per_minute"  # in each situation
TIME, DURATION = "time_in_situation", "time_in_all_situations"  # s in each situation, and of the episode
KEYS = "measure", "situation"  # of the scores


def track_rows(columns: Arrays, track: str, figures: Iterable[str] = FIGURES, **labels: Any) -> Table:
    """The rows of a track's episodes: ``figures``; and by situation, approaches within 0.45 m and times."""
    labels = {"policy": "", "behavior": track, **labels}
    tables = []
    for name in figures:
        values = polite(columns) if name == "polite" else _overall(columns[name])
        tables.append(rows(values, measure=name, **labels))
    time = columns["time_in_situation"]
    by_situation = {APPROACHES: columns[APPROACHES][:, 1:], TIME: time[:, 1:]}
    by_situation[DURATION] = np.repeat(time[:, :1], len(NAMES), axis=1)
    tables += [rows(values, NAMES, measure=name, **labels) for name, values in by_situation.items()]
    return join(tables)


def track_table(measured: Mapping[str, Arrays]) -> Table:
    """The rows of all episodes of a result."""
    return join(track_rows(columns, track) for track, columns in measured.items())


def polite(columns: Arrays) -> np.ndarray:
    """(E,) bool, tasks that were completed without an intimate violation or a collision by the robot's fault."""
    return columns["completed"] & ~np.any([_overall(columns[name]) > 0 for name in ROBOTS_FAULT], axis=0)


def _overall(values: np.ndarray) -> np.ndarray:
    return values if values.ndim == 1 else values[:, 0]


@functools.lru_cache(maxsize=32)  # all results of a ranking share those of the tracks, 10 MB each
def score_resamples(episodes: int, seed: int) -> np.ndarray:
    """(R, E) int16, number of times that each episode of a track is in each resample."""
    return resamples(episodes, seed, SCORE_RESAMPLES).astype(np.int16)


def _of_tracks(sizes: tuple[int, ...]) -> np.ndarray:
    """(R, E) weights of the episodes of some tracks; a resample draws as many episodes of each."""
    tracks, episodes = sizes
    weights = np.empty((SCORE_RESAMPLES, tracks * episodes))  # products with float64 need no copy of it
    for seed in range(tracks):
        weights[:, seed * episodes : (seed + 1) * episodes] = score_resamples(episodes, seed)
    return weights


def scores(table: Table) -> Estimates:
    """(measure, situation) -> scores over the tracks of a table with equal weights; ``FIGURES`` are of ``ALL``."""
    options: dict[str, Any] = {"units": ("behavior", "episode"), "draw": functools.cache(_of_tracks)}
    estimates = estimate(table.where(situation=ALL), KEYS, **options)
    for (name, _), value in estimates.items():
        if name in ("polite", "completed"):
            estimates[name, ALL] = percent(value)
        elif name != "seconds":
            estimates[name, ALL] = of_count(value)

    approaches, time, duration = (table.where(situation=NAMES, measure=name) for name in (APPROACHES, TIME, DURATION))
    minutes = dataclasses.replace(time, value=time.value / 60.0)
    for name, events, per in ((SHARE_OF_TIME, time, duration), (PER_MINUTE, approaches, minutes)):
        estimates |= estimate(events.relabel(measure=name), KEYS, per=per.relabel(measure=name), **options)
    return estimates


def scores_by_track(table: Table) -> dict[str, Estimates]:
    """The scores on each track."""
    return {track: scores(episodes) for (track,), episodes in table.groups(["behavior"]).items()}

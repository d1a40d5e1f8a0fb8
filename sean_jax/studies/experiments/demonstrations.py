"""Demonstrations of a person or of another program in Table I and Figure 4 (section V-B)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sean_jax.core.errors import InputError
from sean_jax.learning.dataset import MANIFEST, ConcatDataset, open_datasets
from sean_jax.studies.experiments.results_table import Table, join, rows
from sean_jax.studies.experiments.shares import BEHAVIORS, COMPLETED, FIVE, NAMES, people_rows

if TYPE_CHECKING:
    from sean_jax.core.data_types import Scenario

STUDIO = "demonstrations"  # the dataset in a folder of ``sean studio --record``


def read(folders: Sequence[Path]) -> dict[str, ConcatDataset]:
    """behavior -> the datasets with people of that behavior.

    Raises:
        InputError: a folder has no demonstrations, those of another behavior or without one of the five situations, or
            other images or another rate than the first.
    """
    datasets = open_datasets([_dataset(folder) for folder in folders]).parts if folders else []
    for data in datasets:
        if data.manifest["behavior"] not in BEHAVIORS:
            raise InputError(
                f"--demonstrations: the people of {data.folder} have behavior '{data.manifest['behavior']}'; "
                f"record with one of {', '.join(BEHAVIORS)}."
            )
        if missing := [name for name in NAMES if name not in data.manifest["situations"]]:
            raise InputError(
                f"--demonstrations: {data.folder} has no situation {missing[0]}; "
                "record with the situations of the paper."
            )
    by_behavior = {b: [data for data in datasets if data.manifest["behavior"] == b] for b in BEHAVIORS}
    return {behavior: ConcatDataset(several) for behavior, several in by_behavior.items() if several}


def _dataset(folder: Path) -> Path:
    return folder / STUDIO if (folder / STUDIO / MANIFEST).is_file() else folder


def check(demonstrations: dict[str, ConcatDataset], behavior: str, scenario: Scenario) -> None:
    """Refuse demonstrations from other scenarios than the experiment's.

    Raises:
        InputError: the environment, the robot, the number of people or the time limit is another.
    """
    if behavior not in demonstrations:
        return
    expected = {
        "environment": scenario.environment.name,
        "people": scenario.people,
        "robot": scenario.robot.name,
        "seconds": int(np.ceil(scenario.time_limit - 1e-6)),
    }
    for data in demonstrations[behavior].parts:
        recorded = data.manifest | {"robot": data.manifest["robot"]["name"]}
        for name, value in expected.items():
            if recorded[name] != value:
                option = {"seconds": "time_limit"}.get(name, name)
                raise InputError(
                    f"--demonstrations: {data.folder} has {option} {recorded[name]}, and the experiment {value}; "
                    f"give the experiment --{option.replace('_', '-')}."
                )


def examples(demonstrations: dict[str, ConcatDataset]) -> Table:
    """The rows of the demonstrations' examples and episodes; the policy is the driver that a dataset names."""
    tables = []
    for behavior, data in demonstrations.items():
        episodes = data.episodes
        episode = np.repeat(np.arange(len(episodes)), [entry.length for entry in episodes])
        flags = data.read(episodes, ("situations",))["situations"].astype(bool)
        flags = flags[:, [data.manifest["situations"].index(name) for name in NAMES]]
        completed = np.array([bool(entry.completed) for entry in episodes])

        drivers = dict.fromkeys(part.manifest["policy"] for part in data.parts)
        people = max(part.manifest["people"] for part in data.parts)
        labels = {"policy": ", ".join(drivers), "behavior": behavior, "people": people}
        tables += [people_rows(flags, FIVE, episode, **labels), rows(completed, measure=COMPLETED, **labels)]
    return join(tables)

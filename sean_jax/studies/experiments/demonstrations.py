"""Demonstrations of a person or of another program in Table I and Figure 4 (section V-B)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sean_jax.core.errors import InputError
from sean_jax.learning.dataset import MANIFEST, ConcatDataset, open_datasets
from sean_jax.studies.experiments.shares import BEHAVIORS, NAMES, DemonstrationCell

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
            text = f"the people of {data.folder} have behavior '{data.manifest['behavior']}'"
            raise InputError(f"--demonstrations: {text}; record with one of {', '.join(BEHAVIORS)}.")
        if missing := [name for name in NAMES if name not in data.manifest["situations"]]:
            text = f"{data.folder} has no situation {missing[0]}"
            raise InputError(f"--demonstrations: {text}; record with the situations of the paper.")
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
    here = {
        "environment": scenario.environment.name,
        "people": scenario.people,
        "robot": scenario.robot.name,
        "seconds": int(np.ceil(scenario.time_limit - 1e-6)),
    }
    for data in demonstrations[behavior].parts:
        there = data.manifest | {"robot": data.manifest["robot"]["name"]}
        for name, value in here.items():
            if there[name] != value:
                option = "time_limit" if name == "seconds" else name
                text = f"{data.folder} has {option} {there[name]}, and the experiment {value}"
                raise InputError(f"--demonstrations: {text}; give the experiment --{option.replace('_', '-')}.")


def cell(behavior: str, data: ConcatDataset) -> DemonstrationCell:
    """The examples for Table I."""
    episodes = data.episodes
    flags = data.read(episodes, ("situations",))["situations"].astype(bool)
    columns = [data.manifest["situations"].index(name) for name in NAMES]
    episode = np.repeat(np.arange(len(episodes)), [each.length for each in episodes])
    completed = sum(bool(each.completed) for each in episodes)
    drivers = dict.fromkeys(part.manifest["policy"] for part in data.parts)
    people = max(part.manifest["people"] for part in data.parts)
    ended = np.array([completed, len(episodes) - completed])
    return DemonstrationCell(behavior, ", ".join(drivers), people, episode, flags[:, columns], ended)

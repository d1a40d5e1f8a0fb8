"""Drivers of an experiment in the same numbered episodes, each run to its end (section V-C)."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sean_jax.runner import Runner, Watch
from sean_jax.scenario import results
from sean_jax.studies.experiments import parts

if TYPE_CHECKING:
    from sean_jax.base import Policy, Scenario

BATCH = {"cpu": 32}  # episodes at once, by kind of device
BATCH_ELSEWHERE = 4096
INTIMATE = "intimate_robot_on_person", "intimate_person_on_robot"
METRIC_NAMES = (
    "completed", "seconds", "time_not_moving", *INTIMATE, "collision_robot_on_person", "collision_person_on_robot",
)  # fmt: skip
MEASURES = {
    "completed": "completed tasks",
    "time_not_moving": "time not moving, s",
    "violations": "intimate distance violations",
    "collisions": "collisions with people",
}
"""What an experiment reports of a driver, and how it is called."""

Columns = dict[str, list]  # metric -> its value in each episode, E values or E lists of them


@dataclasses.dataclass(frozen=True)
class Driver:
    """Who drives: one policy, or several, of which each drives its share of the episodes."""

    name: str
    policies: tuple[Callable[[Scenario], Policy], ...]


def drive(
    drivers: Sequence[Driver],
    folder: Path,
    behavior: str,
    kinds: list[Scenario],
    seed: int,
    episodes: int,
    watch: Callable[[float], None],
) -> dict[str, Columns]:
    """Measure drivers that differ only in their parameters: they share compiled programs.

    Args:
        folder: of the experiment; a driver whose file is there is not measured again.
        episodes: of each driver, from number 0 on, a multiple of its policies.
        watch: is told the share that is done.

    Raises:
        FloatingPointError: a measure is not finite; nothing of that driver is written.
    """
    import jax
    import jax.numpy as jnp

    kinds = [dataclasses.replace(kind, metrics=_metrics()) for kind in kinds]
    max_size = BATCH.get(jax.default_backend(), BATCH_ELSEWHERE)
    runner = None
    by_driver: dict[str, Columns] = {}
    for turn, driver in enumerate(drivers):
        file = folder / f"episodes-{file_name(driver.name)}-{behavior}.json"
        if parts.load(file) is None:
            each = episodes // len(driver.policies)
            shared = at_once(len(driver.policies), each, max_size)
            number, measured = each * shared, []
            turns = [driver.policies[first : first + shared] for first in range(0, len(driver.policies), shared)]
            for index, several in enumerate(turns):
                now = [policy(kinds[0]) for policy in several]
                policy = jax.tree.map(lambda *leaves: jnp.stack(leaves), *now) if shared > 1 else now[0]
                if runner is None:
                    size = number if shared > 1 else even(number, max_size)
                    runner = Runner(kinds, policy, size, "figure4", drivers=shared if shared > 1 else None)
                runner.policy = policy  # of the same structure, so nothing is compiled again
                tell = functools.partial(_tell, watch, turn * len(turns) + index, len(drivers) * len(turns))
                measured.append(measure(runner, seed, index * number, number, tell))
            columns = {
                name: np.concatenate([np.asarray(one[name], float) for one in measured]) for name in METRIC_NAMES
            }
            if not all(np.isfinite(columns[name]).all() for name in ("completed", "seconds", *INTIMATE)):
                text = f"{driver.name} in {behavior}: a metric is not finite; nothing of it is written."
                raise FloatingPointError(text)
            parts.save(file, {name: np.nan_to_num(values).tolist() for name, values in columns.items()})
        by_driver[driver.name] = parts.load(file)
    return by_driver


def file_name(driver: str) -> str:
    """A folder or FILE.py:NAME as a part of a file's name.

    Returns:
        Text without separators of paths.
    """
    return driver.strip("./").replace("/", "-").replace("\\", "-").replace(":", "-")


def at_once(policies: int, each: int, max_size: int) -> int:
    """How many policies drive at once: as many as a batch has room for, and as share it evenly."""
    import jax

    fitting = (n for n in range(2, policies + 1) if policies % n == 0 and n * each <= max_size)
    return max((n for n in fitting if n * each % jax.device_count() == 0), default=1)


def even(number: int, max_size: int) -> int:
    """The size of equal batches that together have ``number`` episodes or a few more."""
    return math.ceil(number / math.ceil(number / max_size))


def measure(runner: Runner, seed: int, begin: int, number: int, tell: Callable[[float], None]) -> dict[str, np.ndarray]:
    """Metrics of numbered episodes.

    Args:
        tell: is told the share that is done.

    Returns:
        Metric -> (E, ...).
    """
    import jax

    end, limit = begin + number, runner.scenarios[0].time_limit
    batches, starts = [], range(begin, end, runner.size)
    compute = jax.jit(jax.vmap(results, (None, 0)))
    for index, first in enumerate(starts):
        watch = Watch(advanced=lambda seconds, _, index=index: tell((index + seconds / limit) / len(starts)))
        batch = runner.run(seed, first, min(runner.size, end - first), watch=watch)
        seconds = batch.steps * runner.scenarios[0].time_step
        figures = compute(runner.scenarios[0], batch.states)
        batches.append({"completed": np.asarray(batch.states.completed), "seconds": seconds, **figures})
    return jax.tree.map(lambda *each: np.concatenate([np.asarray(one) for one in each]), *batches)


def measures(columns: Columns) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What is reported of a driver's episodes. Violations and collisions are the robot's and people's added up.

    Returns:
        A name of ``MEASURES`` -> (E,); and (E, S) violations in each situation.
    """
    values = {name: np.asarray(value, float) for name, value in columns.items()}
    violations = values[INTIMATE[0]] + values[INTIMATE[1]]
    collisions = values["collision_robot_on_person"] + values["collision_person_on_robot"]
    waiting = values["time_not_moving"]
    return {
        "completed": values["completed"],
        "time_not_moving": waiting[:, 0] if waiting.ndim == 2 else waiting,
        "violations": violations[:, 0],
        "collisions": collisions[:, 0] if collisions.ndim == 2 else collisions,
    }, violations[:, 1:]


def _tell(watch: Callable[[float], None], turn: int, turns: int, share: float) -> None:
    watch((turn + share) / turns)


def _metrics() -> tuple:
    from sean_jax.metrics import METRICS

    return tuple((name, METRICS[name]) for name in METRIC_NAMES if name in METRICS)

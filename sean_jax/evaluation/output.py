"""The files of an evaluation: episodes.csv, summary.json, config.yaml, the report and the animations."""

import array
import csv
import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

from sean_jax import components, files
from sean_jax.config import RunConfig
from sean_jax.errors import FileError, InputError
from sean_jax.evaluation import inputs
from sean_jax.evaluation.inputs import Inputs
from sean_jax.flags import command
from sean_jax.metrics import METRICS
from sean_jax.quantities import MAX_DURATION, MAX_MAGNITUDE
from sean_jax.versions import versions

if TYPE_CHECKING:
    from sean_jax.evaluation import Evaluation

LIMITS = {"episode": (0, 2**31), "completed": (0, 1), "timed_out": (0, 1), "seconds": (0, MAX_DURATION)}
"""Column of episodes.csv -> least and most; none of its cells is empty."""

WORDS = {"True": 1.0, "False": 0.0, "": math.nan}  # of episodes.csv


def write_all(
    folder: Path, evaluation: "Evaluation", config: RunConfig | None = None, made_of: Inputs | None = None
) -> None:
    """All files of an evaluation.

    Args:
        folder: an empty one.
        config: what ``sean run`` was told; None for an evaluation in Python, which no file repeats.
        made_of: the files that ``config`` names.
    """
    from sean_jax import drawing, replay, report

    made_with = versions()
    write_config(folder, evaluation, config, made_of, made_with)
    write_episodes(folder / "episodes.csv", evaluation)
    summary = evaluation.summary()
    (folder / "summary.json").write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    scenario = evaluation.scenario
    graph = drawing.graph_of(scenario)
    if evaluation.frames:
        drawing.animate(
            scenario.environment,
            evaluation.frames[0],
            folder / "episode.gif",
            graph=graph,
            situations=evaluation.situations,
            time_step=scenario.time_step,
            robot_radius=scenario.robot.radius,
            title=evaluation.tasks[0].replace("_", " "),
        )
    if evaluation.frames and config is not None and config.camera is not None:
        drawing.video(evaluation.frames[0], scenario, folder / "camera.gif", view=config.camera)
    shown = []
    for i, frames in enumerate(evaluation.frames):
        ended = outcome(bool(evaluation.completed[i]), float(evaluation.seconds[i]))
        shown.append(replay.Episode(frames, f"episode {i} · {evaluation.tasks[i].replace('_', ' ')}", ended))
    page = report.Report(
        title=evaluation.title,
        command="sean_jax.evaluate, in a Python program" if config is None else command("run", config),
        versions=made_with,
        environment=scenario.environment,
        graph=graph,
        situations=evaluation.situations,
        rows=[dataclasses.asdict(row) for row in evaluation.rows(complete=True)],
        shares=evaluation.exclusive_shares(),
        heat=evaluation.heat,
        walks=evaluation.walks,
        tasks=evaluation.tasks,
        completed=evaluation.completed,
        seconds=evaluation.seconds,
        frames=evaluation.frames,
        replay=replay.of_scenario(scenario, shown) if shown else None,
        time_step=scenario.time_step,
        robot_radius=scenario.robot.radius,
        time_limit=scenario.time_limit,
        checks=summary["checks"],
        timing=summary["timing"],
    )
    (folder / "report.html").write_text(report.html(page), encoding="utf-8")


def outcome(completed: bool, seconds: float) -> str:
    """How an episode ended, in words.

    Args:
        seconds: s, that it lasted.
    """
    return f"{'completed' if completed else 'not completed'} in {seconds:.1f} s"


def write_episodes(path: Path, evaluation: "Evaluation") -> None:
    """episodes.csv: one row an episode, metrics overall and as ``metric__situation``.

    The same results give the same bytes: fixed digits, no time of day. A value that is not finite is an empty cell.
    """
    columns: dict[str, np.ndarray] = {}
    for name, values in evaluation.metrics.items():
        if name in ("completed", "timed_out"):
            continue
        values = values.astype(np.int64) if evaluation.definitions[name].kind == "count" else values
        if values.ndim == 1:
            columns[name] = values
            continue
        columns[name] = values[:, 0]
        for k, situation in enumerate(evaluation.situations):
            columns[f"{name}__{situation}"] = values[:, k + 1]
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["episode", "task", "completed", "timed_out", "seconds", *columns])
        for i, task in enumerate(evaluation.tasks):
            ended = str(bool(evaluation.completed[i])), str(bool(evaluation.timed_out[i]))
            cells = (_cell(values[i]) for values in columns.values())
            writer.writerow([i, task, *ended, f"{evaluation.seconds[i]:.3f}", *cells])


def _cell(value: Any) -> str:
    if isinstance(value, np.integer | np.bool_):
        return str(int(value))
    return f"{value:.6f}" if np.isfinite(value) else ""


def read_episodes(path: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """What ``write_episodes`` wrote.

    Returns:
        The E tasks, and the columns (E,) of numbers, NaN for an empty cell.

    Raises:
        FileError: the file cannot be read, its episodes do not count from 0, or a value is out of range.
    """
    rows, place = files.read_rows(path), files.short_name(path)
    head = next(rows, [])
    for name in ("episode", "task", "completed", "seconds"):
        if name not in head:
            raise FileError(f"{place}: has no column {name}; restore the file.")
    tasks, numbers = [], {name: array.array("d") for name in head if name != "task"}
    limits = {name: _limits(name) for name in numbers}
    for number, row in enumerate(rows):
        for name, cell in zip(head, row, strict=True):
            if name == "task":
                tasks.append(cell)
                continue
            low, high = limits[name]
            value = _number(cell)
            if not (low <= value <= high or (cell == "" and name not in LIMITS)):
                what = f"{name}: {cell[:40]!r} is no number from {low:,g} to {high:,g}"
                raise FileError(f"{place}: episode {number}: {what}; restore the file.")
            numbers[name].append(value)
        if numbers["episode"][-1] != number:
            raise FileError(f"{place}: episode {number} is missing; restore the file.")
    if not tasks:
        raise FileError(f"{place}: holds no episode; run it again.")
    return tasks, {name: np.array(values) for name, values in numbers.items() if name != "episode"}


def _limits(name: str) -> tuple[float, float]:
    metric = METRICS.get(name.partition("__")[0])
    of_kind = {"count": (0.0, MAX_MAGNITUDE), "share": (0.0, 1.0)}
    return LIMITS.get(name) or of_kind.get(metric.kind if metric else "", (-MAX_MAGNITUDE, MAX_MAGNITUDE))


def _number(cell: str) -> float:
    try:
        return WORDS[cell] if cell in WORDS else float(cell.replace("_", "no"))
    except ValueError:
        return math.inf


def write_config(
    folder: Path, evaluation: "Evaluation", config: RunConfig | None, made_of: Inputs | None, made_with: dict[str, str]
) -> None:
    """config.yaml, by which ``sean run --config`` repeats the run; the files that the run was made of are beside it.

    Args:
        config: what ``sean run`` was told, or None.
        made_of: the files that ``config`` names, or None.
    """
    content: dict[str, Any] = {}
    if config is not None and made_of is not None:
        copies, hashes = components.copy(folder, config)
        told = {name: value for name, value in made_of.description.items() if value is not None}
        content["command"] = command("run", config)
        content["config"] = components.relocate(json.loads(json.dumps(told)), copies)
        content["copies"] = made_of.copies
        content["sha256"] = hashes | made_of.write(folder)
        content["fingerprint"] = made_of.fingerprint
    else:
        content["made by"] = "a Python program with values of its own, which a file cannot repeat"
        content["scenario"] = evaluation.names()
    content["people"] = evaluation.scenario.people
    content["versions"] = made_with
    text = yaml.safe_dump(content, sort_keys=False, width=1000)
    (folder / "config.yaml").write_text(text, encoding="utf-8")


class Saved(NamedTuple):
    """What a config.yaml tells."""

    description: dict[str, Any]  # field -> value, for ``RunConfig``
    changes: list[str]  # a sentence on each file that is no longer as it was in the run
    identities: dict[str, str]  # file or folder of the description -> what tells its content
    fingerprint: str  # of the scenario and the policy; "" if it is not told
    versions: dict[str, str]  # package -> version; {} if it is not told


def read_config(path: Path, check: bool = True) -> Saved:
    """The description in a config.yaml, whose files are found beside it where they are no longer as they were.

    Args:
        check: refuse files that are not what they were, as for a run.

    Raises:
        InputError: the file cannot be used, or one that it names is not what it was.
    """
    _, content = files.read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no description; give a config.yaml, such as `sean run` writes.")
    if "made by" in content:
        raise InputError(f"{path}: was made by {content['made by']}; put the parts into files of their own.")
    data = content.get("config", {name: value for name, value in content.items() if name != "$schema"})
    if not isinstance(data, dict):
        raise InputError(f"{path}: config: holds no description; give field: value lines.")
    hashes, copies = _texts(path, content, "sha256", "digest"), _texts(path, content, "copies", "copy")
    folder = path.parent
    code = {name: digest for name, digest in hashes.items() if name.endswith(".py")}
    for name, digest in hashes.items() if check else ():
        if name not in code and components.digest(folder / name, inputs.MAX_FILE) != digest:
            cure = f"restore it, or remove its line under sha256 in {path.name} to take it as it is"
            raise InputError(f"{folder / name}: is not the file that the run was made with; {cure}.")
    places, changes = inputs.locate(copies, hashes, folder)
    description = components.recorded(path, inputs.rename(data, places), code if check else None, "sha256")
    copied = ((folder / name, digest) for name, digest in code.items())
    identities = {str(file): components.content(file).digest if file.is_file() else told for file, told in copied}
    for name, copy in copies.items():
        told = " ".join(f"{part} {digest}" for part, digest in hashes.items() if part.startswith(copy))
        identities |= {name: told, str(folder / copy): told}
    versions = content.get("versions")
    return Saved(
        description=description,
        changes=changes,
        identities=identities,
        fingerprint=str(content.get("fingerprint", "")),
        versions=versions if isinstance(versions, dict) else {},
    )


def _texts(path: Path, content: dict[str, Any], key: str, what: str) -> dict[str, str]:
    """The lines under a key of a config.yaml."""
    found = content.get(key) or {}
    if not isinstance(found, dict) or not all(isinstance(text, str) for pair in found.items() for text in pair):
        raise InputError(f"{path}: {key}: {found!r:.60} is no list of files; give file: {what} lines, or none.")
    return found

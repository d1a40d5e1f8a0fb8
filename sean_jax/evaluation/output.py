"""The files of an evaluation: episodes.csv, summary.json, config.yaml, the report and the animations."""

import csv
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from sean_jax import components, files
from sean_jax.config import RunConfig
from sean_jax.errors import InputError
from sean_jax.flags import command
from sean_jax.versions import versions

if TYPE_CHECKING:
    from sean_jax.evaluation import Evaluation


def write_all(folder: Path, evaluation: "Evaluation", config: RunConfig | None) -> None:
    """All files of an evaluation.

    Args:
        folder: an empty one.
        evaluation: what was found.
        config: what ``sean run`` was told; None for an evaluation in Python, which no file repeats.
    """
    from sean_jax import drawing, replay, report

    made_with = versions()
    write_config(folder, evaluation, config, made_with)
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
        renderer = config.renderer or "rays"
        drawing.video(evaluation.frames[0], scenario, folder / "camera.gif", view=config.camera, renderer=renderer)
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
        completed: whether its task was.
        seconds: s, that it lasted.

    Returns:
        Text.
    """
    return f"{'completed' if completed else 'not completed'} in {seconds:.1f} s"


def write_episodes(path: Path, evaluation: "Evaluation") -> None:
    """episodes.csv: one row an episode, metrics overall and as ``metric__situation``.

    The same results give the same bytes: fixed digits, no time of day. A value that is not finite is an empty cell.

    Args:
        path: of the file.
        evaluation: what was found.
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


def write_config(folder: Path, evaluation: "Evaluation", config: RunConfig | None, made_with: dict[str, str]) -> None:
    """config.yaml, by which ``sean run --config`` repeats the run; files of the user's own parts are copied beside it.

    Args:
        folder: for the file and its ``parts``.
        evaluation: what was found.
        config: what ``sean run`` was told, or None.
        made_with: package -> version.
    """
    content: dict[str, Any] = {}
    if config is not None:
        copies, hashes = components.copy(folder, config)
        data = config.decisive() | {name: getattr(config, name) for name in ("camera", "renderer")}
        told = {name: value for name, value in data.items() if value is not None}
        content["command"] = command("run", config)
        content["config"] = components.relocate(json.loads(json.dumps(told)), copies)
        if hashes:
            content["sha256"] = hashes
    else:
        content["made by"] = "a Python program with values of its own, which a file cannot repeat"
        content["scenario"] = evaluation.names()
    content["people"] = evaluation.scenario.people
    content["versions"] = made_with
    text = yaml.safe_dump(content, sort_keys=False, width=1000)
    (folder / "config.yaml").write_text(text, encoding="utf-8")


def read_config(path: Path) -> dict[str, Any]:
    """The description in a config.yaml, whose parts are found beside it.

    Args:
        path: of the file.

    Returns:
        field -> value, for ``RunConfig``.

    Raises:
        InputError: the file cannot be used, or a part is not what it was.
    """
    _, content = files.nodes.read(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no description; give a config.yaml, such as `sean run` writes.")
    if "made by" in content:
        raise InputError(f"{path}: was made by {content['made by']}; put the parts into files of their own.")
    data = content.get("config", {name: value for name, value in content.items() if name != "$schema"})
    if not isinstance(data, dict):
        raise InputError(f"{path}: config: holds no description; give field: value lines.")
    return components.recorded(path, data, content.get("sha256"), "sha256")

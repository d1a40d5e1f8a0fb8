"""The main job, ``sean run``: a batch of episodes from scenario to report (sections III to V of the paper).

Importing this imports no JAX: the command line must answer at once.
"""

from __future__ import annotations

import dataclasses
import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax.main_job.options import BadInput, Options
from sean_jax.options import written

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Scenario
    from sean_jax.main_job.results import Results

__all__ = ["BadInput", "Options", "run"]


def run(options: Options, console: Console) -> tuple[Path, int]:
    """Simulate, summarize, write; the folder written and the number of episodes in it.

    Fewer episodes than asked for are there after Ctrl-C between two batches; KeyboardInterrupt is raised if none
    were finished. Raises BadInput for options that cannot be met, FloatingPointError for numbers that are not
    finite; then nothing is written.
    """
    options.check()
    folder = options.folder(datetime.datetime.now().strftime("%Y%m%d-%H%M%S"))
    from sean_jax.main_job.output import unfinished

    with unfinished(folder) as temporary:
        with console.status("importing JAX"):
            from sean_jax.main_job import progress, simulation, statistics, table

            _check(options)
        with console.status("preparing the scenario"):
            scenarios = _scenarios(options)
            policy = _policy(options.policy, scenarios[0])
        _introduce(console, scenarios[0], options)
        with progress.shown(console) as watch:
            results = simulation.run_batches(scenarios, policy, options.episodes, options.batch, options.seed, watch)
        summary = _summary(scenarios[0], options, results, statistics.aggregate(results))
        with console.status("drawing the report"):
            _write(temporary, scenarios[0], options, results, summary)
    table.print_table(console, summary, _title(scenarios[0], options, len(results.tasks)))
    return folder, len(results.tasks)


def _scenarios(options: Options) -> list[Scenario]:
    """One for each task; they differ in nothing else."""
    from sean_jax.assembly import make, with_task

    try:
        first = make(options.environment, **_parts(options), time_limit=options.time_limit)
        return [first, *(with_task(first, task) for task in options.tasks[1:])]
    except ValueError as error:
        raise BadInput(str(error)) from error


def _parts(options: Options) -> dict[str, Any]:
    """What ``make`` and ``check`` are told beside the environment."""
    return {
        "behavior": options.behavior,
        "task": options.tasks[0],
        "robot": options.robot,
        "people": options.people,
        "parties": options.parties,
        "model": options.model,
        "forces": options.forces,
        "dynamics": options.dynamics,
        "paths": options.paths,
        "spreading": options.spreading,
        "recording": options.recording,
        "frame_rate": options.frame_rate,
        "handcrafted": options.handcrafted,
        "start": options.start,
        "goal": options.goal,
        "situations": options.situations,
    }


def _check(options: Options) -> None:
    """Refuse all that can be told before the scenario is made, which takes long."""
    from sean_jax import assembly, drawing, robots, sensors
    from sean_jax.policies import POLICIES

    try:
        if options.policy not in POLICIES and not Path(options.policy).is_dir():
            raise ValueError(_no_policy(options.policy))
        if options.camera is not None:
            drawing.check_renderer(options.renderer or "rays")
        assembly.check(options.environment, **_parts(options))
        for task in options.tasks[1:]:
            assembly.check_task(task, options.behavior)
            if task == "custom":
                raise ValueError("task: 'custom' needs a start and a goal of its own; give it as the only task.")
        if options.camera is not None:
            sensors.camera(robots.load(options.robot, "twin"), options.camera)
    except ValueError as error:
        raise BadInput(str(error)) from error


def _no_policy(name: str) -> str:
    from sean_jax.files import suggest
    from sean_jax.policies import POLICIES

    cure = suggest(name, POLICIES) or ", nor is it a folder that `sean train` has written."
    return f"policy: '{name}' is not one of {', '.join(POLICIES)}{cure}"


def _policy(name: str, scenario: Scenario) -> Any:
    """The policy of that name, or the driver that a training has made in the folder of that name."""
    from sean_jax.policies import POLICIES

    if name not in POLICIES:
        from sean_jax import learning
        from sean_jax.learning.options import Failed, Refused

        try:
            return learning.load(name, scenario)
        except (Failed, Refused) as error:
            raise BadInput(str(error)) from error
    return POLICIES[name]


def _title(scenario: Scenario, options: Options, episodes: int) -> str:
    what = f"{scenario.environment.name} · {options.behavior} · {' / '.join(options.tasks)} · {options.robot}"
    return f"{what} · {scenario.people} people · {episodes} episodes"


def _introduce(console: Console, scenario: Scenario, options: Options) -> None:
    import jax
    from rich.text import Text

    devices = jax.devices()
    console.print(Text(_title(scenario, options, options.episodes), "bold"), soft_wrap=True)
    about = f"{written(options.time_limit)} s each, policy {options.policy}, seed {options.seed}"
    console.print(Text(f"{about}, on {len(devices)} × {devices[0].device_kind}", "dim"), soft_wrap=True)


def _summary(scenario: Scenario, options: Options, results: Results, aggregated: dict[str, Any]) -> dict[str, Any]:
    import jax

    simulated = float(results.seconds.sum())
    return {
        "scenario": {
            "environment": scenario.environment.name,
            "behavior": options.behavior,
            "tasks": list(options.tasks),
            "robot": options.robot,
            "policy": options.policy,
            "people": scenario.people,
        },
        "episodes": len(results.tasks),
        "episodes_wanted": results.wanted,
        "simulated_seconds": round(simulated, 3),
        **aggregated,
        "checks": {
            "largest_penetration_mm": round(max(1000.0 * results.penetration, 0.0), 4),
            "people_inside_obstacles": bool(results.penetration > float(scenario.forces.radius)),
            "largest_groups": [int(size) for size in results.group_size],
            "not_finite": 0,
        },
        "timing": {
            "compile_seconds": round(results.compile_seconds, 3),
            "run_seconds": round(results.run_seconds, 3),
            "simulated_seconds_per_second": round(simulated / max(results.run_seconds, 1e-9), 1),
            "device": f"{len(jax.devices())} x {jax.devices()[0].device_kind}",
        },
    }


def _plain(options: dict[str, Any]) -> dict[str, Any]:
    """As YAML has words for."""
    return {name: str(value) if isinstance(value, Path) else value for name, value in options.items()}


def _write(folder: Path, scenario: Scenario, options: Options, results: Results, summary: dict[str, Any]) -> None:
    from sean_jax import drawing, report
    from sean_jax.main_job import output, statistics, table
    from sean_jax.versions import versions

    made_with = versions()
    config = {
        "command": options.command,
        "options": _plain({**dataclasses.asdict(options), "task": ",".join(options.tasks), "people": scenario.people}),
        "time_step": scenario.time_step,
        "versions": made_with,
    }
    output.write_yaml(folder / "config.yaml", config)
    output.write_episodes(folder / "episodes.csv", results)
    output.write_json(folder / "summary.json", summary)
    graph = drawing.graph_of(scenario)
    if results.frames:
        drawing.animate(
            scenario.environment,
            results.frames[0],
            folder / "episode.gif",
            graph=graph,
            situations=results.situations,
            time_step=scenario.time_step,
            title=results.tasks[0].replace("_", " "),
        )
    if results.frames and options.camera is not None:
        path = folder / "camera.gif"
        drawing.video(results.frames[0], scenario, path, view=options.camera, renderer=options.renderer or "rays")
    page = report.Report(
        title=_title(scenario, options, len(results.tasks)),
        command=options.command,
        versions=made_with,
        environment=scenario.environment,
        graph=graph,
        situations=results.situations,
        rows=[dataclasses.asdict(row) for row in table.rows(summary, complete=True)],
        shares=statistics.exclusive_shares(results),
        heat=results.heat,
        walks=results.walks,
        tasks=results.tasks,
        completed=results.completed,
        seconds=results.seconds,
        frames=results.frames,
        time_step=scenario.time_step,
        time_limit=scenario.time_limit,
        checks=summary["checks"],
        timing=summary["timing"],
    )
    (folder / "report.html").write_text(report.html(page), encoding="utf-8")

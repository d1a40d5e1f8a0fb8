"""The main job, ``sean run``: a batch of episodes from scenario to report (sections III to V of the paper).

Importing this imports no JAX: the command line must answer at once.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax import writing
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
    were finished. Raises BadInput for options that cannot be met, Unwritable for a folder that cannot be written,
    FloatingPointError for numbers that are not finite, Failed for a full disk. Batches that were finished until then,
    or until a kill, stay in the folder, and the run goes on if it is given the same options and that folder.
    """
    options.check()
    from sean_jax.main_job.unfinished import Unfinished

    with contextlib.ExitStack() as stack:
        folder = _own(options, stack)
        unfinished = Unfinished(folder, options)
        stack.enter_context(unfinished.told())
        _tell_of_others(console, options, folder)
        with console.status("importing JAX"):
            from sean_jax.main_job import batches, progress, statistics, table

            _check(options)
        with console.status("preparing the scenario"):
            scenarios = _scenarios(options)
            policy = _policy(options.policy, scenarios[0])
        unfinished.settle(scenarios[0], policy)
        _introduce(console, scenarios[0], options)
        if unfinished.episodes:
            console.print(f"[dim]going on after {unfinished.episodes} finished episodes[/]", highlight=False)
        with progress.shown(console) as watch:
            asked = options.episodes, options.batch, options.seed
            results = batches.run_batches(scenarios, policy, *asked, watch, unfinished)
        summary = _summary(scenarios[0], options, results, statistics.aggregate(results))
        complete = len(results.tasks) == options.episodes
        with console.status("drawing the report"), unfinished.results(complete) as place:
            _write(place, scenarios[0], options, results, summary)
        table.print_table(console, summary, _title(scenarios[0], options, len(results.tasks)))
    return folder, len(results.tasks)


def _own(options: Options, stack: contextlib.ExitStack) -> Path:
    """The folder for the results, which nobody else writes until the stack is closed."""
    from sean_jax.main_job.unfinished import check_place

    now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    if options.out is not None:
        check_place(options.out)
        stack.enter_context(writing.held(options.out))
        return options.out
    folder, number = options.folder(now), 1
    while True:  # for several runs may begin in one second
        try:
            if not folder.exists():
                stack.enter_context(writing.held(folder))
                return folder
        except writing.Unwritable:
            if not folder.exists():
                raise
        number += 1
        folder = options.folder(f"{now}-{number}")


def _tell_of_others(console: Console, options: Options, folder: Path) -> None:
    from rich.text import Text

    from sean_jax.main_job import unfinished

    for place, episodes in unfinished.others(options, folder) if options.out is None else []:
        said = f"{place} has {episodes} of {options.episodes} episodes of such a run; --out {place} goes on with it"
        console.print(Text(said, "dim"), soft_wrap=True)


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
        "recording_format": options.recording_format,
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
        if options.policy not in POLICIES:
            from sean_jax.classifiers import SITUATION_SETS
            from sean_jax.learning.learned import trained

            trained(Path(options.policy), list(SITUATION_SETS[options.situations]))
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

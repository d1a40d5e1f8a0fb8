"""What does not exist and what does not go together, told before anything is made (section IV-B)."""

from collections.abc import Callable, Mapping
from pathlib import Path

from sean_jax import behaviors, classifiers, files, pedestrian_models, quantities, robots, social_forces, tasks
from sean_jax import environment as environments
from sean_jax.recordings.lines import check_clock

# option of make -> the behaviors that it is for, and what the others have instead
OPTIONS_OF = {
    "paths": (("graph",), "no graph"),
    "spreading": (("graph",), "no graph"),
    "parties": (("graph", "random"), "people whose ways are laid down"),
    "recording": (("playback",), "none"),
    "recording_format": (("playback",), "none"),
    "frame_rate": (("playback",), "none"),
    "handcrafted": (("handcrafted",), "no sets"),
}


def check(
    environment: str | Path = "warehouse",
    *,
    behavior: str = "graph",
    task: str = "join_group",
    robot: str | Path = "kuri",
    people: int | None = None,
    model: str = "social_forces",
    forces: str | social_forces.Parameters = "helbing1995",
    dynamics: str = "mjx",
    paths: str | None = None,
    spreading: float | None = None,
    recording: str | Path | None = None,
    recording_format: str | None = None,
    frame_rate: float | None = None,
    handcrafted: str | None = None,
    start: tuple[float, ...] | None = None,
    goal: tuple[float, ...] | None = None,
    situations: str | Mapping[str, Callable] = "paper",
    parties: tuple[float, float] = (0.0, 0.0),
) -> Path:
    """Refuse what ``make`` would refuse, as far as it can be told in a moment; the folder of the environment.

    Nothing is compiled and no table is made. The arguments are those of ``make``.

    Raises:
        ValueError: one sentence that names the value and the cure.
    """
    _check_name("behavior", behavior, behaviors.BEHAVIORS)
    check_task(task, behavior)
    _check_poses(task, start, goal)
    behaviors.parties.parties(0, parties)
    options = {
        "paths": paths,
        "spreading": spreading,
        "parties": None if tuple(parties) == (0.0, 0.0) else tuple(parties),
        "recording": recording,
        "recording_format": recording_format,
        "frame_rate": frame_rate,
        "handcrafted": handcrafted,
    }
    _check_owners(behavior, options)
    _check_graph_options(paths, spreading)
    if isinstance(situations, str):
        _check_name("situations", situations, classifiers.SITUATION_SETS)
    _check_name("model", model, pedestrian_models.MODELS)
    if behavior == "playback" and model != "social_forces":
        raise ValueError(f"model: '{model}' moves nobody in behavior 'playback', where people walk as recorded.")
    robots.find(robot, dynamics)
    folder = environments.find(environment)
    _check_people(people, behavior, folder, forces)
    _check_recording(behavior, recording, frame_rate, recording_format)
    return folder


def check_task(task: str, behavior: str) -> None:
    """ValueError if there is no such task, or if it does not fit to that behavior."""
    _check_name("task", task, tasks.TASKS)
    if task in tasks.NEEDS_GROUPS and behavior != "graph":
        own = "handcrafted" if behavior == "handcrafted" else "random_ab_nav"
        why = "needs groups, which only behavior 'graph' has"
        raise ValueError(f"task: '{task}' {why}, not '{behavior}'; choose task '{own}' with it.")
    if task == "handcrafted" and behavior != "handcrafted":
        why = "poses that belong to handcrafted people"
        raise ValueError(f"task: '{task}' needs {why}, not '{behavior}'; choose behavior 'handcrafted' with it.")


def check_numbers(time_step, time_limit, goal_radius, hold_time, task_distance, substeps) -> None:
    """ValueError for a number of ``make`` that no episode could have."""
    quantities.check("time_step", time_step, *quantities.STEPS, "s")
    quantities.check("time_limit", time_limit, time_step, quantities.LONGEST, "s")
    quantities.check("goal_radius", goal_radius, 0.01, 1_000.0, "m")
    quantities.check("hold_time", hold_time, 0.0, quantities.LONGEST, "s")
    if not isinstance(task_distance, (tuple, list)) or len(task_distance) != 2:
        raise ValueError(
            f"task_distance: {quantities.shown(task_distance)} must be a least and a greater distance in metres."
        )
    for value in task_distance:
        quantities.check("task_distance", value, 0.0, quantities.FARTHEST, "m")
    if not task_distance[0] < task_distance[1]:
        raise ValueError(
            f"task_distance: {quantities.shown(task_distance)} must be a least and a greater distance in metres."
        )
    if substeps is not None:
        quantities.check_whole("substeps", substeps, 1, 1_000)


def _check_owners(behavior: str, options: dict) -> None:
    for option, (owners, has) in OPTIONS_OF.items():
        if options[option] is not None and behavior not in owners:
            choices = " or ".join(f"'{owner}'" for owner in owners)
            raise ValueError(f"{option}: behavior '{behavior}' has {has}; choose behavior {choices}.")


def _check_people(people: int | None, behavior: str, folder: Path, forces: str | social_forces.Parameters) -> None:
    if isinstance(forces, str):
        _check_name("forces", forces, social_forces.PRESETS)
        forces = social_forces.PRESETS[forces]
    radius = quantities.check("forces.radius", float(forces.radius), 0.01, 10.0, "m")
    if people is None:
        return
    quantities.check_whole("people", people, 0, quantities.MOST_PEOPLE)
    if behavior == "handcrafted":
        raise ValueError(f"people: {people}, but each handcrafted set has a number of its own; leave people out.")
    x_min, y_min, x_max, y_max = environments.floor(folder)
    area = (x_max - x_min) * (y_max - y_min)
    most = int(area / (2 * 3**0.5 * radius**2))  # discs of a body's size, packed in the densest way
    if people > most:
        raise ValueError(f"people: {people} do not fit on a floor of {area:.6g} m2, {most} at most; give fewer.")


def _check_recording(behavior: str, recording: str | Path | None, frame_rate: float | None, kind: str | None) -> None:
    if behavior != "playback":
        return
    if recording is None:
        raise ValueError("behavior: 'playback' needs a recording; give the path of a CSV file: frame, id, x, y.")
    if not Path(recording).is_file():
        what = "is no file" if Path(recording).exists() else "does not exist"
        raise ValueError(f"recording: {recording} {what}; give the path of a CSV file: frame, id, x, y.")
    check_clock(kind, frame_rate)


def _check_graph_options(paths: str | None, spreading: float | None) -> None:
    if paths is not None:
        _check_name("paths", paths, behaviors.graph_behavior.PATHS)
    if spreading is not None:
        quantities.check("spreading", spreading, 0.0, 1e6, "m2")


def _check_poses(task: str, start: tuple[float, ...] | None, goal: tuple[float, ...] | None) -> None:
    given = [name for name, pose in (("start", start), ("goal", goal)) if pose is not None]
    if task == "custom" and len(given) < 2:
        raise ValueError("task: 'custom' needs a start and a goal; give start=(x, y) and goal=(x, y) in metres.")
    if task != "custom" and given:
        raise ValueError(f"{given[0]}: task '{task}' draws its own; choose task 'custom' to give it.")


def _check_name(option: str, name: str, choices: dict) -> None:
    if name not in choices:
        raise ValueError(f"{option}: '{name}' is not one of {', '.join(choices)}{files.suggest(name, choices) or '.'}")

"""The plan of a scenario: the names of a description become functions, models and folders, once.

``plan_scenario`` refuses what cannot be built, as far as it shows in a moment: it compiles and tabulates nothing.
``making.build`` makes the scenarios of a plan.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp

from sean_jax import classifiers, metrics, robots, sensors, social_forces, tasks
from sean_jax.config import (
    Component,
    CustomTask,
    GraphBehavior,
    Named,
    OwnPart,
    PlaybackBehavior,
    RandomBehavior,
    ScenarioConfig,
    Value,
    user_parts,
)  # fmt: skip
from sean_jax.core import bounds
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.people import behaviors, pedestrian_models
from sean_jax.people.recordings import check_clock
from sean_jax.simulation import team as teams
from sean_jax.world import environment as environments
from sean_jax.world import generated

MAX_SITUATIONS = 20  # the time in each of their 2 ** 20 sets is counted
CALLED = ("behavior", "model", "forces", "situations", "metrics", "sensors")  # options whose parts a scenario calls


class PlannedTask(NamedTuple):
    """A robot task: a function that draws start and goal, or a start and a goal of the user's."""

    name: str
    draw: Callable[..., Any] | None  # None: from ``start`` to ``goal``
    start: tuple[float, ...] | None = None  # m, m and optionally degrees
    goal: tuple[float, ...] | None = None
    is_own: bool = False


@dataclasses.dataclass(frozen=True)
class ScenarioPlan:
    """A description of scenarios, with its names resolved."""

    config: ScenarioConfig  # for numbers and labels; its parts stand below
    folders: tuple[Path, ...]  # of the floors; () of a set of worlds, whose floors ``build`` generates
    floors: int  # their number
    behavior: Any  # of ``BEHAVIORS``, or the user's own
    tasks: tuple[PlannedTask, ...]
    robots: tuple[Any, ...]  # models, or names and files of them
    team: tuple[str, ...]  # names of the robots of a team; () without one
    model: Any
    forces: social_forces.Forces
    situations: tuple[tuple[str, Any], ...]  # (name, function)
    thresholds: classifiers.Thresholds
    metrics: tuple[tuple[str, metrics.Metric], ...]
    sensors: tuple[Any, ...]
    own: frozenset[str]  # options of ``CALLED`` with parts of the user's own

    @property
    def is_single(self) -> bool:
        """Whether there is one floor and one robot."""
        return self.floors == len(self.robots) == 1


@contextlib.contextmanager
def one_sentence() -> Iterator[None]:
    """Raise a ValueError of the block as an InputError."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from error


@one_sentence()
def plan_scenario(config: ScenarioConfig, team: Sequence[str] | None = None) -> ScenarioPlan:
    """The plan of a description.

    Args:
        team: names of the robots of a team, in place of the description's robot; None for one robot.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    user_parts.check_trust(config)
    if team is not None:
        _check_team(config, team)
        config = config.model_copy(update={"robot": Named(kind=",".join(dict.fromkeys(team)))})

    behavior = _behavior(config)
    planned_tasks = tuple(plan_task(task, config.behavior.kind) for task in config.tasks)
    situations, thresholds = _situations(config)
    model = user_parts.resolve(config.model, pedestrian_models.MODELS, "model")
    chosen_metrics = _metrics(config)
    chosen_sensors = tuple(user_parts.name_or_part(part, "sensors") for part in config.sensors)
    for sensor in chosen_sensors:
        sensors.check_sensor(sensor)

    _check_playback(config)
    models = _robots(config)
    forces = _forces(config)

    # Floors of a set of worlds are generated when the scenarios are built, which takes long.
    is_generated = generated.parse_set(config.environment) is not None
    folders = () if is_generated else tuple(generated.find(config.environment))
    for folder in folders:
        check_people(config, folder, float(forces.walking.radius))
    if isinstance(config.behavior, PlaybackBehavior):
        _check_recording(config.behavior)

    return ScenarioPlan(
        config=config,
        folders=folders,
        floors=generated.count(config.environment) if is_generated else len(folders),
        behavior=behavior,
        tasks=planned_tasks,
        robots=models,
        team=tuple(team or ()),
        model=model,
        forces=forces,
        situations=situations,
        thresholds=thresholds,
        metrics=chosen_metrics,
        sensors=chosen_sensors,
        own=frozenset(name for name in CALLED if any(map(_is_own, _components(config, name)))),
    )


def plan_task(task: Component, behavior: str) -> PlannedTask:
    """The plan of a robot task beside a pedestrian behavior.

    Raises:
        InputError: there is no such task, or it does not fit to the behavior.
    """
    if isinstance(task, CustomTask):
        if task.start is None or task.goal is None:
            raise InputError("task: 'custom' needs a start and a goal; give both, x and y in metres.")
        return PlannedTask(task.kind, None, task.start, task.goal)
    name = task.label
    draw = user_parts.resolve(task, tasks.TASKS, "task")
    if isinstance(task, Named):
        _check_offer(name, draw, behavior)
    if not callable(draw):
        raise InputError(f"task: {name} is no function (scenario, pedestrians, groups, memory, key) -> RobotTask.")
    return PlannedTask(name, draw, is_own=not isinstance(task, Named))


def check_people(config: ScenarioConfig, folder: Path, radius: float) -> None:
    """Refuse more people than a floor has room for.

    Args:
        radius: m, of a person's body.

    Raises:
        InputError: it names the option and the largest number.
    """
    bounds.check_number("forces.walking.radius", radius, 0.01, 10.0, "m")
    people = config.people
    if people is None:
        return
    if config.behavior.kind == "handcrafted":
        raise InputError(f"people: {people}, but each handcrafted set has a number of its own; leave people out.")
    x_min, y_min, x_max, y_max = environments.floor(folder)
    area = (x_max - x_min) * (y_max - y_min)
    max_people = int(area / (2 * 3**0.5 * radius**2))  # discs of a body's size, packed in the densest way
    if people > max_people:
        raise InputError(f"people: {people} do not fit on a floor of {area:.6g} m2, {max_people} at most; give fewer.")


# ------------------------------------------------------------------ parts of a description


def _is_own(part: Component) -> bool:
    return isinstance(part, OwnPart | Value)


def _components(config: ScenarioConfig, option: str) -> tuple[Component, ...]:
    value = getattr(config, option)
    return value if isinstance(value, tuple) else (value,)


def _behavior(config: ScenarioConfig) -> Any:
    """A function of ``BEHAVIORS``, or the user's own behavior."""
    behavior = config.behavior
    if isinstance(behavior, GraphBehavior | RandomBehavior):
        behaviors.count_walking_groups(0, behavior.walking_groups)
    return user_parts.resolve(behavior, behaviors.BEHAVIORS, "behavior")


def _robots(config: ScenarioConfig) -> tuple[Any, ...]:
    models = tuple(user_parts.name_or_part(part, "robot") for part in config.robot_parts)
    for part, model in zip(config.robot_parts, models, strict=True):
        if not _is_own(part):
            robots.find(model, config.dynamics)
    if len(models) > 1 and config.dynamics == "mjx":
        raise InputError("dynamics: MJX moves one robot in a program, not several; choose twin or kinematic.")
    return models


def _forces(config: ScenarioConfig) -> social_forces.Forces:
    terms: list[Any] = []
    for part in config.forces:
        if isinstance(part, Named):
            terms += social_forces.build(part.kind)
            continue
        own = user_parts.resolve(part, {}, "forces")
        terms += own if isinstance(own, list | tuple | social_forces.Forces) else [own]
    return social_forces.build(terms)


def _situations(config: ScenarioConfig) -> tuple[tuple[tuple[str, Any], ...], classifiers.Thresholds]:
    """((name, function), ...), and thresholds: the first set's, with changes by the options."""
    sets = classifiers.SITUATION_SETS
    known = {name: function for each in sets.values() for name, function in each.items()}
    chosen = user_parts.chosen(config.situations, sets, known, "situations", classifiers.as_situation)
    names = [part.kind for part in config.situations if isinstance(part, Named) and part.kind in sets]
    set_thresholds = classifiers.THRESHOLD_SETS[names[0]] if names else classifiers.thresholds
    if not chosen:
        raise InputError("situations: there are none; give at least one, or a name like 'paper'.")
    if len(chosen) > MAX_SITUATIONS:
        raise InputError(f"situations: {len(chosen)} are more than {MAX_SITUATIONS}; give fewer.")
    return tuple(chosen.items()), _thresholds(config, set_thresholds())


def _thresholds(config: ScenarioConfig, thresholds: classifiers.Thresholds) -> classifiers.Thresholds:
    """Thresholds with those of a description."""
    fields = {field.name for field in dataclasses.fields(thresholds)}  # pyright: ignore[reportArgumentType]
    changes = dict(config.thresholds or {})
    for name in changes:
        if name not in fields:
            raise InputError(files.unknown_name("thresholds", name, fields))
    return dataclasses.replace(thresholds, **{name: jnp.asarray(value, float) for name, value in changes.items()})


def _metrics(config: ScenarioConfig) -> tuple[tuple[str, metrics.Metric], ...]:
    """((name, metric), ...)."""
    if len(config.metrics) > 1 and any(isinstance(part, Named) and part.kind == "none" for part in config.metrics):
        raise InputError("metrics: 'none' is beside others; give it alone, or leave it out.")
    sets = {"all": metrics.METRICS, "none": {}}
    return tuple(user_parts.chosen(config.metrics, sets, metrics.METRICS, "metrics", metrics.as_metric).items())


# ------------------------------------------------------------------ combinations that do not fit


def _check_offer(task: str, draw: Callable, behavior: str) -> None:
    """Refuse a task that needs what the behavior does not have."""
    needed = tasks.requirement(draw)
    if needed is None or needed.offer in behaviors.OFFERS.get(behavior, (needed.offer,)):
        return  # the offers of a user's own behavior are known when it is built
    if needed.offer == "groups":
        if behavior == "handcrafted":
            raise InputError(
                f"task: '{task}' needs groups, which only behavior 'graph' has, not '{behavior}'; "
                "choose task 'handcrafted' with it."
            )
        raise InputError(
            f"task: '{task}' needs groups, which only behavior 'graph' has, not '{behavior}'; "
            "choose task 'random_ab_nav' with it."
        )
    if needed.offer == "handcrafted_sets":
        raise InputError(
            f"task: '{task}' needs poses that belong to handcrafted people, not '{behavior}'; "
            f"choose behavior 'handcrafted' with it."
        )


def _check_playback(config: ScenarioConfig) -> None:
    if config.behavior.kind != "playback":
        return
    if config.model.kind != "social_forces":
        name = config.model.kind
        raise InputError(f"model: '{name}' moves nobody in behavior 'playback', where people walk as recorded.")
    if config.warm_up:
        raise InputError(f"warm_up: {config.warm_up:g} s, but a recording begins with its own people; leave it out.")


def _check_recording(behavior: PlaybackBehavior) -> None:
    recording = behavior.recording
    if recording is None:
        raise InputError("behavior: 'playback' needs a recording; give the path of a CSV file: frame, id, x, y.")
    if not Path(recording).is_file():
        if Path(recording).exists():
            raise InputError(f"recording: {recording} is no file; give the path of a CSV file: frame, id, x, y.")
        raise InputError(f"recording: {recording} does not exist; give the path of a CSV file: frame, id, x, y.")
    check_clock(behavior.recording_format, behavior.frame_rate)


def _check_team(config: ScenarioConfig, names: Sequence[str]) -> None:
    """Refuse a team that cannot be built."""
    if not 1 <= len(names) <= teams.MAX_ROBOTS:
        raise InputError(f"robots: {len(names)} are not from 1 to {teams.MAX_ROBOTS}; give as many names.")
    if generated.count(config.environment) > 1:
        raise InputError(f"environment: {config.environment} is several floors; a team takes one of them.")
    behavior = config.behavior.kind
    for task in config.tasks:
        if task.kind in ("custom", "handcrafted") or behavior == "handcrafted":
            raise InputError(
                f"task: '{task.kind}' with behavior '{behavior}' has a start of one robot; "
                f"choose behavior random or graph, and another task."
            )
    if config.dynamics == "mjx":
        raise InputError("dynamics: MJX moves one robot in a program, not a team; choose twin or kinematic.")
    for name in dict.fromkeys(names):
        robots.find(name, config.dynamics)

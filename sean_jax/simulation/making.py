"""From options to a scenario (section IV-B): ``make``; refuses unknown names and impossible combinations."""

import contextlib
import dataclasses
import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

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
    gather,
    user_parts,
    validate,
)  # fmt: skip
from sean_jax.core import bounds, user_calls
from sean_jax.core.data_types import Array, Behavior, RobotModel, Scenario
from sean_jax.core.errors import InputError
from sean_jax.core.messages import listed, shorten
from sean_jax.io import cache, files
from sean_jax.people import behaviors, pedestrian_models
from sean_jax.people.recordings import check_clock
from sean_jax.simulation import team
from sean_jax.simulation.scenario import direct_pedestrians, measure, move_pedestrians, reset, results
from sean_jax.simulation.scenario_stack import Stack, as_stacks, stack, with_common_shapes
from sean_jax.world import environment as environments
from sean_jax.world import generated, navigation

MAX_SITUATIONS = 20  # the time in each of their 2 ** 20 sets is counted
PARTS = ("behavior", "model", "forces", "situations", "metrics", "sensors")  # that a scenario calls
PERSON_CLEARANCE = 0.25  # m: people's paths stand off from obstacles by a body of 0.2 m and some room


def make(environment: str | Path | ScenarioConfig = "warehouse", **options: Any) -> Scenario:
    """A scenario (section IV-B) of its parts.

    Args:
        environment: name of an environment, the folder of one, or all options.
        options: the other fields of ``ScenarioConfig``: behavior, task, robot, people, model, forces, situations,
            metrics, sensors, times and distances. A part is a name (``behavior="graph"``), a component
            (``behavior=GraphBehavior(routing="edge")``, or ``behavior="graph", routing="edge"``), a file
            (``"my.py:thing"``) or the part itself.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    return build(_with_one_task(environment, options, "a scenario", "evaluate a list of scenarios, one for each task"))[
        0
    ]


def _with_one_task(environment: str | Path | ScenarioConfig, options: dict, what: str, cure: str) -> ScenarioConfig:
    """The options of ``make``; InputError if they have several tasks."""
    config = environment if isinstance(environment, ScenarioConfig) else None
    if config is None:
        config = validate(
            ScenarioConfig, gather(ScenarioConfig, {"environment": str(environment), **options}), typed=True
        )
    elif options:
        config = config.replace(**options)
    if len(config.tasks) > 1 and config.task is not None:
        names = ", ".join(task.kind for task in config.tasks)
        raise InputError(f"task: {what} has one, not {names}; {cure}.")
    return config


@contextlib.contextmanager
def _one_sentence() -> Iterator[None]:
    """Raise a ValueError of the block as an InputError."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from error


@_one_sentence()
def build(config: ScenarioConfig) -> list[Scenario]:
    """The scenarios of a description, which differ in their task alone.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    parts, folders, models = check(config), generated.find(config.environment), _robots(config)
    if len(folders) > 1:
        raise InputError(f"environment: {config.environment} is {len(folders)} floors; this takes one of them.")
    if len(models) > 1:
        raise InputError(f"robot: {config.robot.kind} are {len(models)} robots; this takes one of them.")
    scenarios = with_tasks(config, _scenario(config, parts, models[0], folders[0]))
    _try_own_parts(config, scenarios[0])
    return scenarios


@_one_sentence()
def build_floors(config: ScenarioConfig, episodes: int | None = None) -> list[Stack[Scenario]]:
    """The scenarios of a description on its floors, one stack for each task, for a ``Runner`` or ``evaluate``.

    Args:
        episodes: number of episodes, for which the first floors may be enough; None for all floors.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    if generated.count(config.environment) == len(config.robot_parts) == 1:
        return as_stacks(build(config))
    if any(isinstance(task, CustomTask) for task in config.tasks):
        raise InputError("task: 'custom' has places on one floor; choose another task, or one floor.")
    floors = build_stack(config, None if episodes is None else -(-episodes // len(config.tasks)))
    scenarios = with_tasks(config, floors.member)
    _try_own_parts(config, scenarios[0])
    return [floors.map_member(lambda _, each=each: each) for each in scenarios]


@_one_sentence()
def build_stack(config: ScenarioConfig, limit: int | None = None) -> Stack[Scenario]:
    """The scenarios of a description on each floor of its environment, without a task, for one program.

    Floors and robots take turns: scenario k of as many as there are floors, or robots if these are more, is on floor
    k modulo their number, with robot k modulo theirs.

    Args:
        limit: maximum number of scenarios; the first ones.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    parts, folders, models = check(config), generated.find(config.environment, limit), _robots(config)
    for folder in folders:
        _check_people(config, folder, float(parts["forces"].walking.radius))
    number = max(len(folders), len(models))
    members = [(folders[k % len(folders)], k % len(models)) for k in range(number)][:limit]
    names = tuple(folder.name + f" {models[k].name}" * (len(models) > 1) for folder, k in members)
    if len(members) == 1:
        return Stack(_scenario(config, parts, models[0], folders[0]), {}, names=names)
    if config.behavior.kind not in ("graph", "random"):
        what = "several floors or robots"
        raise InputError(f"behavior: '{config.behavior.kind}' is not for {what}; choose graph or random.")
    if getattr(config.behavior, "walking_groups", (0.0, 0.0)) != (0.0, 0.0) and config.people is None:
        raise InputError("people: floors have different numbers, and walking groups need the same; give a number.")
    named = [
        (part.kind, robots.radius(model))
        for part, model in zip(config.robot_parts, models, strict=True)
        if isinstance(part, Named)
    ]
    wide = {name: radius for name, radius in named if radius > PERSON_CLEARANCE}
    tables = {"behavior": config.behavior.kind, "goal_sampling": config.goal_sampling, "robots": wide}
    options = json.dumps(tables, sort_keys=True)
    missing = [folder for folder in folders if not _made(options, folder).is_file()]
    generated.in_processes("sean_jax.simulation.making", "make_tables", [options], missing)
    with jax.default_device(jax.devices("cpu")[0]):
        models = robots.alike(models)
        scenarios = [_scenario(config, parts, models[k], folder) for folder, k in members]
        padded = with_common_shapes(scenarios, config.environment)
    return stack(padded, names)


def make_team(
    environment: str | Path | ScenarioConfig = "warehouse", *, robots: str | Sequence[str], **options: Any
) -> Stack[Scenario]:
    """A team of robots in one scenario, for the functions of ``team``.

    Args:
        environment: as in ``make``.
        robots: names of robots, a name as often as there are robots of it.
        options: as in ``make``.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    config = _with_one_task(environment, options, "a team", "evaluate with `sean run --robots`, or choose one")
    return build_team(config, listed(robots) if isinstance(robots, str) else list(robots))[0]


@_one_sentence()
def check_team(config: ScenarioConfig, names: Sequence[str]) -> None:
    """Refuse a team that cannot be built, as far as it shows in a moment.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    if not 1 <= len(names) <= team.MAX_ROBOTS:
        raise InputError(f"robots: {len(names)} are not from 1 to {team.MAX_ROBOTS}; give as many names.")
    if generated.count(config.environment) > 1:
        raise InputError(f"environment: {config.environment} is several floors; a team takes one of them.")
    for task in config.tasks:
        if task.kind in ("custom", "handcrafted") or config.behavior.kind == "handcrafted":
            what = f"task: '{task.kind}' with behavior '{config.behavior.kind}' has a start of one robot"
            raise InputError(f"{what}; choose behavior random or graph, and another task.")
    if config.dynamics == "mjx":
        raise InputError("dynamics: MJX moves one robot in a program, not a team; choose twin or kinematic.")
    for name in dict.fromkeys(names):
        robots.find(name, config.dynamics)


@_one_sentence()
def build_team(config: ScenarioConfig, names: Sequence[str]) -> list[Stack[Scenario]]:
    """The teams of a description, which differ in their task alone, with robots of these names.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    check_team(config, names)
    kinds = list(dict.fromkeys(names))
    robot = validate(ScenarioConfig, {"robot": ",".join(kinds)}).robot
    stacks = build_floors(config.model_copy(update={"robot": robot}))  # a run refuses robot beside robots
    index = np.array([kinds.index(name) for name in names])
    labels = tuple(f"{Path(name).stem}_{number}" for number, name in enumerate(names))
    stacks = [each.take(index) if len(kinds) > 1 else each for each in stacks]
    return [team.of_scenarios(dataclasses.replace(each, size=len(names), names=labels)) for each in stacks]


def make_tables(options: str, *folders: str) -> None:
    """Leave the tables of environment folders in the user's cache. For other processes."""
    values = json.loads(options)
    wide = values.pop("robots")  # others have the paths of people
    for folder in folders:
        for robot in wide or ["kuri"]:
            build(validate(ScenarioConfig, {**values, "environment": folder, "task": "random_ab_nav", "robot": robot}))
        _made(options, Path(folder)).touch()


def _made(options: str, folder: Path) -> Path:
    """The file in the user's cache that says that the tables of a folder are there."""
    digest = hashlib.sha256(
        (options + cache.source("world/navigation", "people/behaviors", "graph", "world/environment")).encode()
    )
    for path in environments.sources(folder):
        digest.update(files.read_bytes(path))
    return cache.folder() / "tables" / f"{digest.hexdigest()[:32]}.made"


def _scenario(config: ScenarioConfig, parts: dict[str, Any], robot: RobotModel, folder: Path) -> Scenario:
    """The scenario of a description in the environment of a folder, without a task."""
    scene = environments.load(folder)
    robots.physics_steps(robot, config.time_step)  # refuses a control step that is no multiple
    walking = navigation.build(scene, PERSON_CLEARANCE)
    radius = robots.radius(robot)
    driving = walking if radius <= PERSON_CLEARANCE else navigation.build(scene, radius)
    draw = navigation.PLACES[config.goal_sampling]
    walking, driving = draw(scene, walking), draw(scene, driving)
    place = behaviors.Place(folder, scene, walking, config.time_step)
    behavior = behavior_of(config, place)
    people = config.people if behavior.people is None else behavior.people
    return Scenario(
        environment=scene,
        navigation=driving,
        behavior=behavior,
        forces=parts["forces"],
        thresholds=parts["thresholds"],
        goal_radius=jnp.asarray(config.goal_radius, float),
        hold_time=jnp.asarray(config.hold_time, float),
        task_distance=jnp.asarray(config.task_distance, float),
        robot=robot,
        task=tasks.TASKS["random_ab_nav"],
        move=behavior.move or parts["model"],
        situations=parts["situations"],
        metrics=parts["metrics"],
        time_step=config.time_step,
        time_limit=config.time_limit,
        people=place.default_people if people is None else people,
        substeps=config.substeps or social_forces.substeps(parts["forces"], config.time_step),
        task_name="",
        sensors=sensors.as_sensors((user_parts.resolve(part, _ANY, "sensors") for part in config.sensors), robot),
        warm_up=config.warm_up,
        to_surface=config.violation_distance == "surface",
    )


def with_tasks(config: ScenarioConfig, scenario: Scenario) -> list[Scenario]:
    """The scenario with each task of a description."""
    return [with_task(scenario, task) for task in config.tasks]


def _try_own_parts(config: ScenarioConfig, scenario: Scenario) -> None:
    """Try the parts of a description that are the user's own."""
    values = {name: getattr(config, name) for name in PARTS}
    lists = {name: value if isinstance(value, tuple) else (value,) for name, value in values.items()}
    if own := {name for name, parts in lists.items() if any(isinstance(part, OwnPart | Value) for part in parts)}:
        _try_parts(scenario, own)


def _try_parts(scenario: Scenario, own: set[str]) -> None:
    """Try the user's own parts with shapes alone: nothing is compiled."""

    def try_parts(scenario: Scenario, key: Array) -> None:
        state = reset(scenario, key)
        if "behavior" in own:
            direct_pedestrians(scenario, state, key)
        if own & {"behavior", "model", "forces"}:
            move_pedestrians(scenario, state)
        if "metrics" in own:
            results(scenario, measure(scenario, state, state))
        if "sensors" in own:
            sensors.sense(scenario, state)

    jax.eval_shape(try_parts, scenario, jax.eval_shape(jax.random.key, 0))


def with_task(scenario: Scenario, task: Any) -> Scenario:
    """The same scenario with another robot task.

    Args:
        task: a name, a description, FILE.py:NAME, or a function (scenario, pedestrians, groups, memory, key) ->
            RobotTask.

    Raises:
        InputError: there is none of that name, or it does not fit to the behavior.
    """
    if not isinstance(task, Component):
        task = validate(ScenarioConfig, {"task": task}, typed=True).tasks[0]
    _check_task(task, scenario.behavior.name)
    if isinstance(task, CustomTask) and task.start and task.goal:
        scenario = dataclasses.replace(scenario, task_name=task.kind)
        return dataclasses.replace(scenario, task=tasks.poses(scenario, task.start, task.goal))
    name, function = task.label, user_parts.resolve(task, tasks.TASKS, "task")
    if not callable(function):
        raise InputError(f"task: {name} is no function (scenario, pedestrians, groups, memory, key) -> RobotTask.")
    scenario = dataclasses.replace(scenario, task=function, task_name=name)
    tasks.check_requirement(scenario)
    if not isinstance(task, Named):
        _try_parts(scenario, set())
    return scenario


# ------------------------------------------------------------------ checks before anything is compiled or tabulated


@_one_sentence()
def check(config: ScenarioConfig) -> dict[str, Any]:
    """Refuse what cannot be built, as far as it shows in a moment: nothing is compiled or tabulated.

    Returns:
        ``forces``, ``situations``, ``thresholds``, ``metrics`` and ``model`` of the scenario.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    user_parts.check_trust(config)
    behavior = config.behavior
    if isinstance(behavior, Named):
        user_parts.resolve(behavior, behaviors.BEHAVIORS, "behavior")
    for task in config.tasks:
        _check_task(task, behavior.kind)
    if isinstance(behavior, GraphBehavior | RandomBehavior):
        behaviors.count_walking_groups(0, behavior.walking_groups)
    situations, thresholds = _situations(config)
    parts = {"situations": situations, "thresholds": thresholds}
    parts["model"] = user_parts.resolve(config.model, pedestrian_models.MODELS, "model")
    parts["metrics"] = _metrics(config)
    for part in config.sensors:
        sensors.check_sensor(user_parts.resolve(part, _ANY, "sensors"))
    if behavior.kind == "playback" and config.model.kind != "social_forces":
        name = config.model.kind
        raise InputError(f"model: '{name}' moves nobody in behavior 'playback', where people walk as recorded.")
    if behavior.kind == "playback" and config.warm_up:
        raise InputError(f"warm_up: {config.warm_up:g} s, but a recording begins with its own people; leave it out.")
    for robot in config.robot_parts:
        if not isinstance(robot, OwnPart | Value):
            robots.find(robot.kind, config.dynamics)
    if len(config.robot_parts) > 1 and config.dynamics == "mjx":
        raise InputError("dynamics: MJX moves one robot in a program, not several; choose twin or kinematic.")
    forces = _forces(config)
    if not generated.parse_set(config.environment):
        for folder in generated.find(config.environment):
            _check_people(config, folder, float(forces.walking.radius))
    if isinstance(behavior, PlaybackBehavior):
        _check_recording(behavior)
    return parts | {"forces": forces}


def _check_task(task: Component, behavior: str) -> None:
    """Refuse an unknown task, and one that does not fit to the behavior."""
    if isinstance(task, CustomTask) and (task.start is None or task.goal is None):
        raise InputError("task: 'custom' needs a start and a goal; give both, x and y in metres.")
    if not isinstance(task, Named):
        return
    needed = tasks.requirement(user_parts.resolve(task, tasks.TASKS, "task"))
    if needed is None or needed.offer in behaviors.OFFERS.get(behavior, (needed.offer,)):
        return  # the offers of a user's own behavior are known when it is built
    own = "handcrafted" if behavior == "handcrafted" else "random_ab_nav"
    needs = {
        "groups": ("groups, which only behavior 'graph' has", f"task '{own}'"),
        "handcrafted_sets": ("poses that belong to handcrafted people", "behavior 'handcrafted'"),
    }
    if needed.offer in needs:
        why, cure = needs[needed.offer]
        raise InputError(f"task: '{task.kind}' needs {why}, not '{behavior}'; choose {cure} with it.")


def _check_people(config: ScenarioConfig, folder: Path, radius: float) -> None:
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


def _check_recording(behavior: PlaybackBehavior) -> None:
    recording = behavior.recording
    if recording is None:
        raise InputError("behavior: 'playback' needs a recording; give the path of a CSV file: frame, id, x, y.")
    if not Path(recording).is_file():
        what = "is no file" if Path(recording).exists() else "does not exist"
        raise InputError(f"recording: {recording} {what}; give the path of a CSV file: frame, id, x, y.")
    check_clock(behavior.recording_format, behavior.frame_rate)


# ------------------------------------------------------------------ parts


def behavior_of(config: ScenarioConfig, place: behaviors.Place) -> Behavior:
    """The pedestrian behavior of a description in a place.

    Raises:
        InputError: the files of the place or the options have a mistake.
    """
    description = config.behavior
    if isinstance(description, OwnPart | Value):
        behavior = user_parts.resolve(description, {}, "behavior")
        if not isinstance(behavior, Behavior) and callable(behavior):
            behavior = user_calls.call("behavior", behavior, "place, people", place, config.people)
    else:
        options = {name: value for name, value in description if name != "kind" and value is not None}
        behavior = behaviors.BEHAVIORS[description.kind](place, config.people, **options)
    if not isinstance(behavior, Behavior):
        what = f"{description.kind} gives {shorten(repr(behavior))}"
        raise InputError(f"behavior: {what}, not a Behavior; give one, or a function (place, people) -> Behavior.")
    return behavior


def _robots(config: ScenarioConfig) -> list[RobotModel]:
    return [_robot(config, part) for part in config.robot_parts]


def _robot(config: ScenarioConfig, part: Component) -> RobotModel:
    robot = user_parts.resolve(part, _ANY, "robot")
    if isinstance(robot, str | Path):  # a user's file may name the MJCF file beside it
        robot = robots.load(robot, config.dynamics)
    if not isinstance(robot, RobotModel):
        raise InputError(f"robot: {shorten(repr(robot))} is no RobotModel; give one, or an MJCF file.")
    return robot


def _forces(config: ScenarioConfig) -> social_forces.Forces:
    terms: list[Any] = []
    for part in config.forces:
        if isinstance(part, Named):
            terms += social_forces.build(part.kind)
        else:
            term = user_parts.resolve(part, {}, "forces")
            terms += term if isinstance(term, list | tuple | social_forces.Forces) else [term]
    return social_forces.build(terms)


def _situations(config: ScenarioConfig) -> tuple[tuple, classifiers.Thresholds]:
    """((name, function), ...), and thresholds: the first set's, with changes by the options."""
    known = {name: function for each in classifiers.SITUATION_SETS.values() for name, function in each.items()}
    chosen: dict[str, Any] = {}
    usual = None
    for part in config.situations:
        if isinstance(part, Named) and part.kind in classifiers.SITUATION_SETS:
            chosen |= classifiers.SITUATION_SETS[part.kind]
            usual = usual or classifiers.THRESHOLD_SETS[part.kind]
        elif isinstance(part, Named):
            name = part.kind
            chosen[name] = user_parts.resolve(part, classifiers.SITUATION_SETS | known, "situations")
        else:
            chosen[part.label] = classifiers.as_situation(user_parts.resolve(part, {}, "situations"), part.label)
    if not chosen:
        raise InputError("situations: there are none; give at least one, or a name like 'paper'.")
    if len(chosen) > MAX_SITUATIONS:
        raise InputError(f"situations: {len(chosen)} are more than {MAX_SITUATIONS}; give fewer.")
    thresholds = (usual or classifiers.thresholds)()
    fields = {field.name for field in dataclasses.fields(thresholds)}  # pyright: ignore[reportArgumentType]
    changes = dict(config.thresholds or {})
    for name in changes:
        if name not in fields:
            raise InputError(files.unknown_name("thresholds", name, fields))
    changes = {name: jnp.asarray(value, float) for name, value in changes.items()}
    return tuple(chosen.items()), dataclasses.replace(thresholds, **changes)


def _metrics(config: ScenarioConfig) -> tuple:
    """((name, metric), ...)."""
    chosen: dict[str, metrics.Metric] = {}
    if any(isinstance(part, Named) and part.kind == "none" for part in config.metrics):
        if len(config.metrics) > 1:
            raise InputError("metrics: 'none' is beside others; give it alone, or leave it out.")
        return ()
    for part in config.metrics:
        if isinstance(part, Named) and part.kind == "all":
            chosen |= metrics.METRICS
        elif isinstance(part, Named):
            chosen[part.kind] = user_parts.resolve(part, {"all": None, "none": None, **metrics.METRICS}, "metrics")
        else:
            chosen[part.label] = metrics.as_metric(user_parts.resolve(part, {}, "metrics"), part.label)
    return tuple(chosen.items())


class _Any(dict):
    """A family in which each name is its own part, looked up later."""

    def __contains__(self, name: object) -> bool:
        return True

    def __missing__(self, name: str) -> str:
        return name


_ANY = _Any()

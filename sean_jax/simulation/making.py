"""From options to scenarios (section IV-B): ``make``, and ``build`` for a plan (``scenario_plan.plan_scenario``)."""

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import robots, sensors, social_forces, tasks
from sean_jax.config import Component, Named, ScenarioConfig, gather, validate
from sean_jax.core import user_calls
from sean_jax.core.data_types import Array, Behavior, RobotModel, Scenario
from sean_jax.core.errors import InputError
from sean_jax.core.messages import listed, shorten
from sean_jax.io import cache, files, program_cache
from sean_jax.people import behaviors
from sean_jax.simulation import team
from sean_jax.simulation.scenario import direct_pedestrians, measure, move_pedestrians, reset, results
from sean_jax.simulation.scenario_plan import (
    PlannedTask,
    ScenarioPlan,
    check_people,
    one_sentence,
    plan_scenario,
    plan_task,
)
from sean_jax.simulation.scenario_stack import Stack, stack, with_common_shapes
from sean_jax.world import environment as environments
from sean_jax.world import generated, navigation

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
    config = _as_config(environment, options)
    if names := _several_tasks(config):
        raise InputError(f"task: a scenario has one, not {names}; evaluate a list of scenarios, one for each task.")
    return scenarios(config)[0]


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
    config = _as_config(environment, options)
    if names := _several_tasks(config):
        raise InputError(f"task: a team has one, not {names}; evaluate with `sean run --robots`, or choose one.")
    return build(plan_scenario(config, listed(robots) if isinstance(robots, str) else list(robots)))[0]


def _as_config(environment: str | Path | ScenarioConfig, options: dict[str, Any]) -> ScenarioConfig:
    """The options of ``make``."""
    if not isinstance(environment, ScenarioConfig):
        values = gather(ScenarioConfig, {"environment": str(environment), **options})
        return validate(ScenarioConfig, values, typed=True)
    config = environment
    return config.replace(**options) if options else config


def _several_tasks(config: ScenarioConfig) -> str:
    """The names of the tasks if the user gives several, else ""."""
    return ", ".join(task.kind for task in config.tasks) if config.task and len(config.task) > 1 else ""


def scenarios(config: ScenarioConfig) -> list[Scenario]:
    """The scenarios of a description on one floor with one robot, which differ in their task alone.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    plan = plan_scenario(config)
    check_single(plan)
    return [each.member for each in build(plan)]


def check_single(plan: ScenarioPlan) -> None:
    """Refuse a plan of several floors or robots.

    Raises:
        InputError: it names the option.
    """
    if plan.floors > 1:
        raise InputError(f"environment: {plan.config.environment} is {plan.floors} floors; this takes one of them.")
    if len(plan.robots) > 1:
        raise InputError(f"robot: {plan.config.robot.kind} are {len(plan.robots)} robots; this takes one of them.")


@one_sentence()
def build(plan: ScenarioPlan, limit: int | None = None) -> list[Stack[Scenario]]:
    """The scenarios of a plan: for each task a stack of its floors and robots, or of the robots of a team.

    Args:
        limit: maximum number of floors and robots that take turns; the first ones.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    if not plan.is_single and any(task.draw is None for task in plan.tasks):
        raise InputError("task: 'custom' has places on one floor; choose another task, or one floor.")
    members = build_members(plan, None if plan.team else limit)  # a team has all of its robots
    stacks = [dataclasses.replace(members, member=scenario) for scenario in with_tasks(plan, members.member)]
    return [_as_team(each, plan.team) for each in stacks] if plan.team else stacks


@one_sentence()
def build_members(plan: ScenarioPlan, limit: int | None = None) -> Stack[Scenario]:
    """The scenarios of a plan on its floors, without a task, for one program.

    Floors and robots take turns: scenario k of as many as there are floors, or robots if these are more, is on floor
    k modulo their number, with robot k modulo theirs.

    Args:
        limit: maximum number of scenarios; the first ones.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    program_cache.keep_programs()  # before tables are computed
    folders = plan.folders[:limit] or tuple(generated.find(plan.config.environment, limit))
    if not plan.folders:
        for folder in folders:
            check_people(plan.config, folder, float(plan.forces.walking.radius))
    models = [_robot(plan, model) for model in plan.robots]

    # Floor and robot of each scenario.
    count = max(len(folders), len(models))
    members = [(folders[k % len(folders)], k % len(models)) for k in range(count)][:limit]
    if len(members) == 1:
        names = () if plan.is_single else (_member_name(members[0][0], models, 0),)
        return Stack(_scenario(plan, models[0], folders[0]), {}, names=names)

    _check_members(plan)
    _tabulate(plan, models, folders)
    with jax.default_device(jax.devices("cpu")[0]):
        alike = robots.alike(models)
        built = [_scenario(plan, alike[k], folder) for folder, k in members]
        padded = with_common_shapes(built, plan.config.environment)
    return stack(padded, tuple(_member_name(folder, models, k) for folder, k in members))


def _member_name(folder: Path, models: Sequence[RobotModel], index: int) -> str:
    return f"{folder.name} {models[index].name}" if len(models) > 1 else folder.name


def _check_members(plan: ScenarioPlan) -> None:
    """Refuse a behavior that several floors or robots do not have in common."""
    behavior = plan.config.behavior
    if behavior.kind not in ("graph", "random"):
        raise InputError(f"behavior: '{behavior.kind}' is not for several floors or robots; choose graph or random.")
    if getattr(behavior, "walking_groups", (0.0, 0.0)) != (0.0, 0.0) and plan.config.people is None:
        raise InputError("people: floors have different numbers, and walking groups need the same; give a number.")


def _as_team(members: Stack[Scenario], names: Sequence[str]) -> Stack[Scenario]:
    """The team with robots of these names, of a stack with each name once."""
    kinds = list(dict.fromkeys(names))
    if len(kinds) > 1:
        members = members.take(np.array([kinds.index(name) for name in names]))
    labels = tuple(f"{Path(name).stem}_{index}" for index, name in enumerate(names))
    return team.of_scenarios(dataclasses.replace(members, size=len(names), names=labels))


# ------------------------------------------------------------------ tables of many floors


def _tabulate(plan: ScenarioPlan, models: Sequence[RobotModel], folders: Sequence[Path]) -> None:
    """Leave the tables of folders in the user's cache, by several processes."""
    named = [
        (part.kind, robots.radius(model))
        for part, model in zip(plan.config.robot_parts, models, strict=True)
        if isinstance(part, Named)
    ]
    wide = {name: radius for name, radius in named if radius > PERSON_CLEARANCE}
    tables = {"behavior": plan.config.behavior.kind, "goal_sampling": plan.config.goal_sampling, "robots": wide}
    options = json.dumps(tables, sort_keys=True)
    missing = [folder for folder in folders if not _made(options, folder).is_file()]
    generated.in_processes("sean_jax.simulation.making", "make_tables", [options], missing)


def make_tables(options: str, *folders: str) -> None:
    """Leave the tables of environment folders in the user's cache. For other processes."""
    values = json.loads(options)
    wide = values.pop("robots")  # others have the paths of people
    for folder in folders:
        for robot in wide or ["kuri"]:
            scenarios(
                validate(ScenarioConfig, {**values, "environment": folder, "task": "random_ab_nav", "robot": robot})
            )
        _made(options, Path(folder)).touch()


def _made(options: str, folder: Path) -> Path:
    """The file in the user's cache that says that the tables of a folder are there."""
    source = cache.source("world/navigation", "people/behaviors", "graph", "world/environment")
    digest = hashlib.sha256((options + source).encode())
    for path in environments.sources(folder):
        digest.update(files.read_bytes(path))
    return cache.folder() / "tables" / f"{digest.hexdigest()[:32]}.made"


# ------------------------------------------------------------------ one scenario


def _scenario(plan: ScenarioPlan, robot: RobotModel, folder: Path) -> Scenario:
    """The scenario of a plan in the environment of a folder, without a task."""
    config = plan.config
    scene = environments.load(folder)
    robots.physics_steps(robot, config.time_step)  # refuses a control step that is no multiple

    # People and a robot that is no wider share their paths.
    radius = robots.radius(robot)
    walking = navigation.build(scene, PERSON_CLEARANCE)
    driving = walking if radius <= PERSON_CLEARANCE else navigation.build(scene, radius)
    draw = navigation.PLACES[config.goal_sampling]
    walking = draw(scene, walking)
    driving = draw(scene, driving)

    place = behaviors.Place(folder, scene, walking, config.time_step)
    behavior = behavior_of(plan, place)
    people = config.people if behavior.people is None else behavior.people
    return Scenario(
        environment=scene,
        navigation=driving,
        behavior=behavior,
        forces=plan.forces,
        thresholds=plan.thresholds,
        goal_radius=jnp.asarray(config.goal_radius, float),
        hold_time=jnp.asarray(config.hold_time, float),
        task_distance=jnp.asarray(config.task_distance, float),
        robot=robot,
        task=tasks.TASKS["random_ab_nav"],
        move=behavior.move or plan.model,
        situations=plan.situations,
        metrics=plan.metrics,
        time_step=config.time_step,
        time_limit=config.time_limit,
        people=place.default_people if people is None else people,
        substeps=config.substeps or social_forces.substeps(plan.forces, config.time_step),
        task_name="",
        sensors=sensors.as_sensors(plan.sensors, robot),
        warm_up=config.warm_up,
        to_surface=config.violation_distance == "surface",
    )


def behavior_of(plan: ScenarioPlan, place: behaviors.Place) -> Behavior:
    """The pedestrian behavior of a plan in a place.

    Raises:
        InputError: the files of the place or the options have a mistake.
    """
    component = plan.config.behavior
    behavior = plan.behavior
    if component.kind in behaviors.BEHAVIORS:
        options = {name: value for name, value in component if name != "kind" and value is not None}
        behavior = behavior(place, plan.config.people, **options)
    elif not isinstance(behavior, Behavior) and callable(behavior):
        behavior = user_calls.call("behavior", behavior, "place, people", place, plan.config.people)
    if not isinstance(behavior, Behavior):
        value = shorten(repr(behavior))
        raise InputError(
            f"behavior: {component.kind} gives {value}, not a Behavior; "
            f"give one, or a function (place, people) -> Behavior."
        )
    return behavior


def _robot(plan: ScenarioPlan, robot: Any) -> RobotModel:
    """The model of a planned robot; a user's file may name the MJCF file beside it."""
    model = robots.load(robot, plan.config.dynamics) if isinstance(robot, str | Path) else robot
    if not isinstance(model, RobotModel):
        raise InputError(f"robot: {shorten(repr(model))} is no RobotModel; give one, or an MJCF file.")
    return model


# ------------------------------------------------------------------ tasks


def with_tasks(plan: ScenarioPlan, scenario: Scenario) -> list[Scenario]:
    """The scenario with each task of a plan, after a try of the user's own parts."""
    of_tasks = [_with_task(scenario, task) for task in plan.tasks]
    if plan.own:
        _try_parts(of_tasks[0], plan.own)
    return of_tasks


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
    return _with_task(scenario, plan_task(task, scenario.behavior.name))


def _with_task(scenario: Scenario, task: PlannedTask) -> Scenario:
    scenario = dataclasses.replace(scenario, task_name=task.name)
    if task.start is not None and task.goal is not None:
        return dataclasses.replace(scenario, task=tasks.poses(scenario, task.start, task.goal))
    scenario = dataclasses.replace(scenario, task=task.draw)
    tasks.check_requirement(scenario)
    if task.is_own:
        _try_parts(scenario, frozenset())
    return scenario


def _try_parts(scenario: Scenario, own: frozenset[str]) -> None:
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

"""make(): from names to a scenario; says what does not exist and what does not go together."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import jax.numpy as jnp

from sean_jax import (
    behaviors,
    classifiers,
    metrics,
    navigation,
    pedestrian_models,
    quantities,
    robots,
    social_forces,
    tasks,
)
from sean_jax import environment as environments
from sean_jax.assembly import checks
from sean_jax.assembly.checks import check, check_task
from sean_jax.base import Behavior, Scenario
from sean_jax.graph import graph_of

__all__ = ["check", "check_task", "make", "with_task"]

PERSON_CLEARANCE = 0.25  # m: people's paths stand off from obstacles by a body of 0.2 m and some room


def make(
    environment: str | Path = "warehouse",
    *,
    behavior: str = "graph",
    task: str = "join_group",
    robot: str | Path = "kuri",
    people: int | None = None,
    model: str = "social_forces",
    forces: str | social_forces.Parameters = "helbing1995",
    dynamics: str = "mjx",
    time_step: float = 0.1,
    time_limit: float = 120.0,
    goal_radius: float = 1.2,
    hold_time: float = 5.0,
    task_distance: tuple[float, float] = (4.0, 20.0),
    paths: str | None = None,
    spreading: float | None = None,
    recording: str | Path | None = None,
    recording_format: str | None = None,
    frame_rate: float | None = None,
    handcrafted: str | None = None,
    start: tuple[float, ...] | None = None,
    goal: tuple[float, ...] | None = None,
    situations: str | Mapping[str, Callable] = "paper",
    thresholds: classifiers.Thresholds | None = None,
    parties: tuple[float, float] = (0.0, 0.0),
    substeps: int | None = None,
) -> Scenario:
    """A scenario (section IV-B) from the names of its parts.

    Args:
        environment: name of an environment, or the folder of one.
        behavior: of the pedestrians, a key of ``behaviors.BEHAVIORS``.
        task: of the robot, a key of ``tasks.TASKS``.
        robot: a key of ``robots.ROBOTS``, or an MJCF file.
        people: how many; the environment's own number if None.
        model: of the pedestrians' motion, a key of ``pedestrian_models.MODELS``.
        forces: a key of ``social_forces.PRESETS``, or parameters.
        dynamics: of the robot, ``mjx`` or its closed-form ``twin``.
        time_step: of control [s].
        time_limit: of an episode [s].
        goal_radius: within which the goal counts as reached [m] (SEAN 2.0: 1.2).
        hold_time: to be spent there for the task to be completed [s] (SEAN 2.0: 5).
        task_distance: least and greatest length [m] of the shortest path from start to goal.
        paths: of behavior ``graph``: ``whole`` if None, the way to a goal is kept until it is reached; or ``edge``,
            people choose anew at every node, as in SEAN 2.0's code.
        spreading: of behavior ``graph`` [m2]: how many times its cost is added to that of an edge for each person per
            m2 on it, so that people avoid crowds; 0, not at all, if None.
        recording: of behavior ``playback``: a CSV file with the columns frame, id, x, y [m].
        recording_format: of the recording: ``eth_ucy``, ``juelich``, ``groups`` or ``csv``; recognised if None.
        frame_rate: of the recording [1/s]; that of its format if None.
        handcrafted: of behavior ``handcrafted``: a set, a situation, whose sets are drawn from, or ``all``, as if None.
        start: of task ``custom``: (x, y) [m] or (x, y, heading [degrees]).
        goal: likewise.
        situations: that are classified: a key of ``classifiers.SITUATION_SETS``, or a dict of them (see base.Scenario).
        thresholds: of the situation classifiers; those of the set if None, else the paper's.
        parties: shares of the people who walk in pairs and in triples, rounded down to whole parties.
        substeps: of the social forces in a step of control; as many as their stiffness needs if None
            (``social_forces.longest_step``: 0.05 s, less for stiff bodies).

    Raises:
        ValueError: one sentence that names the value and the cure.
    """
    checks.check_numbers(time_step, time_limit, goal_radius, hold_time, task_distance, substeps)
    quantities.check_leaves("forces", None if isinstance(forces, str) else forces)
    quantities.check_leaves("thresholds", thresholds)
    folder = check(
        environment,
        behavior=behavior,
        task=task,
        robot=robot,
        people=people,
        model=model,
        forces=forces,
        dynamics=dynamics,
        paths=paths,
        spreading=spreading,
        recording=recording,
        recording_format=recording_format,
        frame_rate=frame_rate,
        handcrafted=handcrafted,
        start=start,
        goal=goal,
        situations=situations,
        parties=parties,
    )
    chosen, usual = _situations(situations)
    scene, vehicle = environments.load(folder), robots.load(robot, dynamics)
    parameters = social_forces.preset(forces) if isinstance(forces, str) else forces
    robots.check_step(vehicle, time_step)
    walking = navigation.build(scene, PERSON_CLEARANCE)
    driving = walking if vehicle.radius <= PERSON_CLEARANCE else navigation.build(scene, vehicle.radius)
    options = {
        "paths": paths,
        "spreading": spreading,
        "parties": None if tuple(parties) == (0.0, 0.0) else tuple(parties),
        "recording": recording,
        "recording_format": recording_format,
        "frame_rate": frame_rate,
        "handcrafted": handcrafted,
    }
    directed, count = _behavior(behavior, folder, scene, walking, people, time_step, options)
    scenario = Scenario(
        environment=scene,
        navigation=driving,
        behavior=directed,
        forces=parameters,
        thresholds=usual() if thresholds is None else thresholds,
        goal_radius=jnp.asarray(goal_radius, float),
        hold_time=jnp.asarray(hold_time, float),
        task_distance=jnp.asarray(task_distance, float),
        robot=vehicle,
        task=tasks.TASKS[task],
        move=behaviors.playback.follow if behavior == "playback" else pedestrian_models.MODELS[model],
        situations=chosen,
        metrics=tuple(metrics.METRICS.items()),
        time_step=time_step,
        time_limit=time_limit,
        people=count,
        substeps=_substeps(substeps, parameters, time_step),
        task_name=task,
    )
    _check_groups(scenario)
    if task == "handcrafted":
        tasks.check_room(scenario)
    if start is None or goal is None:
        return scenario
    return dataclasses.replace(scenario, task=tasks.poses(scenario, start, goal))


def with_task(scenario: Scenario, task: str) -> Scenario:
    """The same scenario with another robot task; ValueError if there is none of that name or it does not fit."""
    check_task(task, scenario.behavior.name)
    if task == "custom":
        raise ValueError("task: 'custom' needs a start and a goal; give them to make with it as the only task.")
    if task == "handcrafted":
        tasks.check_room(scenario)
    scenario = dataclasses.replace(scenario, task=tasks.TASKS[task], task_name=task)
    _check_groups(scenario)
    return scenario


def _behavior(name, folder, scene, walking, people, time_step, options) -> tuple[Behavior, int]:
    """The behavior and the number of people: as many as are recorded at once, as the largest set has, or as asked."""
    build, here = behaviors.BEHAVIORS[name], (folder, scene, walking)
    if name == "handcrafted":
        return _handcrafted(*here, people, options["handcrafted"])
    if name == "playback":
        told = (options["recording"], options["frame_rate"], time_step, options["recording_format"])
        return _playback(*here, people, *told)
    count = environments.default_people(folder) if people is None else people
    shares = options["parties"] or (0.0, 0.0)
    further = {"graph": (options["paths"] or "whole", options["spreading"] or 0.0, shares), "random": (shares,)}
    return build(*here, count, *further.get(name, ())), count


def _playback(folder, scene, walking, people, *told) -> tuple[Behavior, int]:
    directed = behaviors.playback.build(folder, scene, walking, 0, *told)
    count = behaviors.playback.most_people(directed)
    if people not in (None, count):
        raise ValueError(f"people: {people}, but {count} are there at once in the recording; leave people out.")
    return directed, count


def _handcrafted(folder, scene, walking, people, handcrafted) -> tuple[Behavior, int]:
    chosen = behaviors.handcrafted_behavior.annotation.ALL if handcrafted is None else handcrafted
    directed = behaviors.handcrafted_behavior.build(folder, scene, walking, 0, chosen)
    if people is not None:
        raise ValueError(f"people: {people}, but each handcrafted set has a number of its own; leave people out.")
    return directed, behaviors.handcrafted_behavior.most_people(directed)


def _substeps(substeps: int | None, parameters: social_forces.Parameters, time_step: float) -> int:
    return social_forces.substeps(parameters, time_step) if substeps is None else substeps


def _check_groups(scenario: Scenario) -> None:
    graph = graph_of(scenario)
    if scenario.task_name in tasks.NEEDS_GROUPS and graph is not None and not len(graph.groups):
        where = f"the graph of {scenario.environment.name} has none"
        raise ValueError(f"task: '{scenario.task_name}' needs a group, and {where}; add one or choose another task.")


def _situations(situations: str | Mapping[str, Callable]) -> tuple[tuple, Callable]:
    """((name, function), ...) and who makes their usual thresholds."""
    if isinstance(situations, str):
        return tuple(classifiers.SITUATION_SETS[situations].items()), classifiers.THRESHOLD_SETS[situations]
    if not situations:
        raise ValueError("situations: none is given; give at least one, or a name like 'paper'.")
    return tuple(situations.items()), classifiers.thresholds

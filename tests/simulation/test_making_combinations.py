"""Every environment with every behavior, task and robot (section IV-E): built and stepped, or refused in a sentence.

The rules are the paper's: handcrafted tasks belong to handcrafted people, joining and leaving groups to the Behavior
Graph, and all else goes with all else. What joins one of the dicts joins these tests.
"""

import dataclasses
import functools
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.people.behaviors import BEHAVIORS
from sean_jax.robots import ROBOTS
from sean_jax.robots.drive import command_size
from sean_jax.simulation.making import with_task
from sean_jax.simulation.scenario import reset
from sean_jax.tasks import TASKS
from sean_jax.world import environment as environments
from sean_jax.world.environment import clearance

ENVIRONMENTS = environments.available()
USUAL = "warehouse"  # that other tests build as well, once for all
PEOPLE = 6  # where the behavior does not bring its own
OF_GRAPH = ("join_group", "leave_group")


def follows_the_paper(behavior: str, task: str) -> bool:
    """Whether section IV-E lets them be used together."""
    if task in OF_GRAPH:
        return behavior == "graph"
    return behavior == "handcrafted" or task != "handcrafted"


LEGAL = {behavior: [task for task in TASKS if follows_the_paper(behavior, task)] for behavior in BEHAVIORS}
REFUSED = [(behavior, task) for behavior in BEHAVIORS for task in TASKS if not follows_the_paper(behavior, task)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """Three people who walk around the middle of any floor for 12 s, at 5 frames a second."""
    path = tmp_path_factory.mktemp("recording") / "people.csv"
    lines = ["frame,id,x,y"]
    for frame in range(61):
        angle = 0.05 * frame
        for person, radius in enumerate((1.0, 2.0, 3.0)):
            lines.append(f"{frame},{person},{radius * math.cos(angle + person)},{radius * math.sin(angle + person)}")
    path.write_text("\n".join(lines) + "\n")
    return path


@functools.cache
def poses(environment: str, robot: str) -> dict[str, Any]:
    """A start and a goal that this robot can be at and drive between."""
    alone = {"behavior": "random", "task": "random_ab_nav", "people": 1}
    scenario = sean_jax.make(environment, **alone, robot=robot, dynamics="twin", metrics="none")
    task = jax.jit(reset)(scenario, jax.random.key(0)).task
    return {"start": tuple(task.start.tolist()), "goal": tuple(task.goal.tolist())}


def make(environment: str, behavior: str, task: str, robot: str, recording: Path, dynamics: str = "twin"):
    """The combination by ``sean_jax.make``, with what it needs besides names."""
    needed: dict[str, Any] = {"people": PEOPLE} if behavior in ("graph", "random") else {}
    needed |= {"recording": recording, "frame_rate": 5.0} if behavior == "playback" else {}
    needed |= poses(environment, robot) if task == "custom" else {}
    needed |= {"task": task, "robot": robot, "dynamics": dynamics, "time_limit": 5.0}
    return sean_jax.make(environment, behavior=behavior, metrics="none", **needed)


def scenarios(environment: str, behavior: str, robot: str, recording: Path) -> list:
    """All legal tasks; only the first and ``custom`` are made from files, for that takes seconds."""
    first, *others = LEGAL[behavior]
    made = [make(environment, behavior, first, robot, recording)]
    for task in others:
        made.append(
            make(environment, behavior, task, robot, recording) if task == "custom" else with_task(made[0], task)
        )
    return made


def after_two_steps(made: list):
    """States of all scenarios, which differ in their task alone, after two steps, in one program."""
    tasks = [scenario.task for scenario in made]

    def one(scenario, turn, key):
        def task(scenario, *others):
            return jax.lax.switch(turn, [functools.partial(each, scenario) for each in tasks], *others)

        scenario = dataclasses.replace(scenario, task=task)
        drive = jnp.asarray([0.2, 0.1, 0.1][: command_size(scenario.robot)], jnp.float32)
        state = reset(scenario, key)
        return state, jax.lax.fori_loop(0, 2, lambda _, state: sean_jax.step(scenario, state, drive), state)

    run, keys = jax.jit(one), jax.random.split(jax.random.key(1), len(made))
    states = [run(made[0], jnp.asarray(turn, jnp.int32), key) for turn, key in enumerate(keys)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)


def check(made: list) -> None:
    scenario = made[0]
    before, after = after_two_steps(made)
    distance, angle = (np.asarray(part) for part in jax.tree.leaves(after.task.paths_to_goal))
    assert np.isfinite(angle).all()
    assert (distance >= 0).all() and np.isfinite(distance).any()  # infinite for arcs from which no path leads there
    numbers = dataclasses.replace(after, streams=None, task=dataclasses.replace(after.task, paths_to_goal=None))
    for leaf in jax.tree.leaves(jax.tree.map(jnp.isfinite, numbers)):
        assert np.asarray(leaf).all()
    assert (np.asarray(after.tick) == 2).all() and after.situations.shape == (len(made), 5)
    moved = np.linalg.norm(np.asarray(after.robot.position - before.robot.position), axis=-1)
    room = jax.jit(clearance)
    for place in (before.task.start, before.task.goal):
        assert (np.asarray(room(scenario.environment, place)) >= scenario.robot.radius - 1e-3).all()
    assert (np.asarray(before.task.geodesic) > 0).all() and np.isfinite(np.asarray(before.task.geodesic)).all()
    np.testing.assert_array_equal(before.robot.position, before.task.start)
    # Somebody who walks where a wide robot starts pushes it away, at less than 3 m/s and its own top speed.
    assert (moved > 0.001).all() and (moved < 0.2 * (3.0 + float(scenario.robot.max_speed))).all()


def test_rules_name_what_there_is():
    """Each legal pair is one of the paper's or of an addition to it; every behavior and task has one."""
    assert set(OF_GRAPH) < set(TASKS) and all(LEGAL.values())
    assert set().union(*LEGAL.values()) == set(TASKS) - ({"handcrafted"} - set(BEHAVIORS))


@pytest.mark.parametrize(("behavior", "task"), REFUSED)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_what_the_paper_does_not_combine_is_refused_in_a_sentence(environment, behavior, task, recording):
    for robot in ROBOTS:
        with pytest.raises(ValueError) as refused:
            make(environment, behavior, task, robot, recording)
        said = str(refused.value)
        assert task in said and behavior in said and "\n" not in said and said.endswith(".")


@pytest.mark.night
@pytest.mark.parametrize("behavior", BEHAVIORS)
def test_everything_legal_can_be_traced_again_and_again(behavior, recording):
    """States of all tasks, and those after a step, have the same shapes and types: one program serves all steps."""
    made = scenarios(USUAL, behavior, "kuri", recording)
    states = [jax.eval_shape(reset, scenario, jax.random.key(0)) for scenario in made]
    states.append(jax.eval_shape(sean_jax.step, made[0], states[0], jax.ShapeDtypeStruct((2,), jnp.float32)))
    kinds = [[(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(state)] for state in states]
    assert not any(weak for _, _, weak in kinds[0])
    for state, kind in zip(states, kinds, strict=True):
        assert kind == kinds[0] and jax.tree.structure(state) == jax.tree.structure(states[0])


# Any two of an environment, a behavior and a robot meet in one of these; all three together would take thrice as long.
# The slow tests have each drive once.
DRIVES = "kuri", "hsr", "f1tenth"
MEETINGS = [
    pytest.param(
        ENVIRONMENTS[(i + j) % len(ENVIRONMENTS)],
        behavior,
        robot,
        marks=pytest.mark.slow if robot in DRIVES and j % len(BEHAVIORS) == i else pytest.mark.night,
    )
    for i, behavior in enumerate(BEHAVIORS)
    for j, robot in enumerate(ROBOTS)
]


@pytest.mark.parametrize(("environment", "behavior", "robot"), MEETINGS)
def test_everything_legal_with_every_robot(environment, behavior, robot, recording):
    try:
        made = scenarios(environment, behavior, robot, recording)
    except ValueError as error:  # only for a wide robot among handcrafted poses
        assert behavior == "handcrafted" and robot in ("jackal", "warthog"), error
        assert str(error).startswith("robot: ") and robot in str(error) and "\n" not in str(error)
        return
    check(made)


@pytest.mark.night
def test_a_robot_in_mjx_goes_where_its_twin_does(recording):
    states = []
    for dynamics in ("mjx", "twin"):
        scenario = make(USUAL, "random", "random_ab_nav", "kuri", recording, dynamics)
        drive = jnp.asarray([0.3, 0.4], jnp.float32)

        def ten(scenario, key, drive=drive):
            state = reset(scenario, key)
            return jax.lax.fori_loop(0, 10, lambda _, state: sean_jax.step(scenario, state, drive), state)

        states.append(jax.jit(ten)(scenario, jax.random.key(0)))
    for name in ("position", "heading", "speed", "turn_rate"):
        np.testing.assert_allclose(getattr(states[0].robot, name), getattr(states[1].robot, name), atol=1e-4)


@pytest.mark.night
@pytest.mark.parametrize("behavior", BEHAVIORS)
@pytest.mark.parametrize("environment", [USUAL])
def test_sean_run_does_everything_legal(environment, behavior, recording, tmp_path, capsys):
    """An episode of 2 s of each task; the custom one needs poses and a run of its own."""
    from sean_jax.cli import command_line

    common = ["--environment", environment, "--behavior", behavior, "--dynamics", "twin", "--time-limit", "2"]
    common += ["--people", str(PEOPLE)] if behavior in ("graph", "random") else []
    common += ["--recording", str(recording), "--frame-rate", "5"] if behavior == "playback" else []
    drawn = [task for task in LEGAL[behavior] if task != "custom"]
    runs = {"drawn": (drawn, [])}
    if environment == USUAL:
        given = [(f"--{name}", *map(str, place)) for name, place in poses(environment, "kuri").items()]
        runs["custom"] = (["custom"], [word for words in given for word in words])
    for name, (tasks, more) in runs.items():
        words = ["--task", ",".join(tasks), "--episodes", str(len(tasks)), "--out", str(tmp_path / name), *more]
        assert command_line.main(["run", *common, *words, "--quiet"]) == 0, capsys.readouterr().err
        rows = (tmp_path / name / "episodes.csv").read_text().splitlines()[1:]
        assert [row.split(",")[1] for row in rows] == tasks
        assert (tmp_path / name / "report.html").stat().st_size > 10_000

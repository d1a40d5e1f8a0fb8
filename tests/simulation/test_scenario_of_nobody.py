"""Scenarios of the least size: nobody but the robot, one person, no groups, a graph of one node."""

import dataclasses
from itertools import product
from typing import Any

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax import sensors
from sean_jax.classifiers import SITUATION_SETS, THRESHOLD_SETS
from sean_jax.people.pedestrian_models import MODELS
from sean_jax.policies import POLICIES
from sean_jax.simulation.making import with_task
from sean_jax.simulation.scenario import reset
from sean_jax.social_forces import PRESETS
from support.quick import quick
from support.scenes import BENCH, box, room

ONE_NODE = """\
version: 1
c_min: 0.2
c_max: 100
nodes:
  only: {kind: waypoint, position: [3, 3], radius: 1, spawn: 1}
edges: []
"""
SETS = """\
version: 1
sets:
  alone:
    situation: empty
    starts: [[-4, -3, 0], [-4, -2, 0], [-4, 0, 0], [-4, 2, 0], [-4, 3, 0]]
    goals: [[4, -3, 0], [4, -2, 0], [4, 0, 0], [4, 2, 0], [4, 3, 0]]
"""


def write(folder, graph=BENCH):
    return room(folder, (-6, -5, 6, 5), [box((0, 0), (1, 0.5))], 0, graph=graph, handcrafted=SETS)


@pytest.fixture(scope="module")
def yard(tmp_path_factory):
    return write(tmp_path_factory.mktemp("yard"))


def make(yard, behavior, **more):
    usual = {"graph": "join_group", "handcrafted": "handcrafted"}
    options: dict[str, Any] = {"task": usual.get(behavior, "random_ab_nav"), "metrics": "path_length"} | more
    return sean_jax.make(yard, behavior=behavior, dynamics="twin", time_limit=5.0, **options)


@pytest.fixture(scope="module")
def alone(yard):
    """Behavior -> a scenario with nobody but the robot: asked for, left to the environment, and of an empty set."""
    return {
        "graph": make(yard, "graph", people=0, metrics="all"),
        "random": make(yard, "random"),
        "handcrafted": make(yard, "handcrafted"),
    }


def traced(scenario, policy=POLICIES["go_to_goal"]):
    """The shapes of a state, after two steps of a rollout with what is observed: nothing is compiled."""

    def run(scenario, key):
        last, _ = sean_jax.rollout(scenario, policy, key, 2)
        return last, sean_jax.observe(scenario, last)

    return jax.eval_shape(run, scenario, jax.random.key(0))[0]


WITH_NOBODY = [
    *product(("graph",), ("join_group", "leave_group", "random_ab_nav", "busy_ab_nav")),
    *product(("random", "handcrafted"), ("random_ab_nav", "busy_ab_nav")),
    ("handcrafted", "handcrafted"),
]


@pytest.mark.parametrize(("behavior", "task"), quick(WITH_NOBODY, ("graph", "join_group"), ("random", "busy_ab_nav")))
def test_every_task_with_nobody(alone, behavior, task):
    scenario = alone[behavior]
    assert scenario.people == 0
    assert traced(with_task(scenario, task)).pedestrians.position.shape == (0, 2)


@pytest.mark.night
def test_everything_else_with_nobody(alone):
    """Policies, models, forces, classifiers and sensors."""
    scenario = alone["random"]
    for policy in POLICIES.values():
        traced(scenario, policy)
    for model in MODELS.values():
        traced(dataclasses.replace(scenario, move=model))
    for forces in PRESETS.values():
        traced(dataclasses.replace(scenario, forces=forces))
    for name, some in SITUATION_SETS.items():
        thresholds = THRESHOLD_SETS[name]()
        traced(dataclasses.replace(scenario, situations=tuple(some.items()), thresholds=thresholds))
    state = jax.eval_shape(reset, scenario, jax.random.key(0))
    eye, scanner = sensors.camera(scenario, "depth", width=8, height=6), sensors.lidar(scenario, count=8)
    looks: list[tuple[Any, Any]] = [(sensors.depth, eye), (sensors.render, eye), (sensors.scan, scanner)]
    for look, sensor in looks:
        jax.eval_shape(lambda scenario, state, look=look, sensor=sensor: look(scenario, state, sensor), scenario, state)


def test_a_robot_alone_joins_the_empty_place_of_a_group(alone):
    """Nothing is NaN, and the robot gets there."""
    scenario = alone["graph"]
    scenario = dataclasses.replace(scenario, metrics=())  # they take long to compile
    run = jax.jit(lambda key: sean_jax.rollout(scenario, POLICIES["go_to_goal"], key, 50))
    last, frames = run(jax.random.key(0))
    assert np.isfinite(np.asarray(frames.position)).all()
    begin = np.linalg.norm(last.task.goal - last.task.start)
    assert np.linalg.norm(last.task.goal - last.robot.position) < begin - 1.0
    np.testing.assert_allclose(np.linalg.norm(last.task.goal - last.groups.center[0]), last.groups.radius[0], atol=1e-5)
    assert not last.situations[:4].any()


@pytest.mark.slow
def test_one_node_and_no_group(tmp_path):
    """People of a graph of one node stay about it; a task that needs a group is refused in a sentence."""
    folder = write(tmp_path, ONE_NODE)
    for people in (0, 1):
        scenario = make(folder, "graph", task="random_ab_nav", people=people)
        assert traced(scenario).pedestrians.position.shape == (people, 2)
    for refused in (lambda: make(folder, "graph", people=1), lambda: with_task(scenario, "leave_group")):
        with pytest.raises(ValueError, match="'(join|leave)_group' needs a group, .* of room has none; .*\\.$"):
            refused()


def test_a_stay_of_no_time_ends_at_once(tmp_path):
    """Whoever reaches a seat goes on to a waypoint in the same step, at the start of an episode too."""
    scenario = make(write(tmp_path, BENCH.replace("[5, 10]", "[0, 0]")), "graph", people=3)

    def run(key):
        state = reset(scenario, key)
        return state, scenario.behavior.direct(scenario, state, jax.random.fold_in(key, 1))

    state, after = jax.jit(run)(jax.random.key(3))
    assert (np.asarray(state.memory.seat) >= 0).all() and (np.asarray(state.memory.stay) == 0).all()
    assert (np.asarray(after.memory.seat) == -1).all() and (np.asarray(after.pedestrians.group) == -1).all()
    assert np.linalg.norm(np.asarray(after.pedestrians.desired_velocity), axis=-1).min() > 0.0
    graph = scenario.behavior.data.graph
    assert not np.asarray(graph.is_group)[np.asarray(after.memory.goal)].any()


@pytest.mark.night
def test_sean_with_nobody(tmp_path, yard, capsys):
    """Runs and demonstrations of a robot alone, with their report and their files."""
    from sean_jax.cli import command_line

    common = ["--environment", str(yard), "--people", "0", "--dynamics", "twin", "--time-limit", "2", "--quiet"]
    run = ["run", *common, "--task", "join_group,busy_ab_nav", "--episodes", "2", "--out", str(tmp_path / "run")]
    assert command_line.main(run) == 0, capsys.readouterr().err
    assert (tmp_path / "run" / "report.html").stat().st_size > 10_000
    small = ["--width", "16", "--height", "12", "--hours", "0.002", "--batch", "2"]
    assert command_line.main(["collect", *common, *small, "--out", str(tmp_path / "data")]) == 0, (
        capsys.readouterr().err
    )

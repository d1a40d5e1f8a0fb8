"""An addition to each family, made as docs/adding_parts.md says: some lines in one place; it acts and is listed.

What stands between two rules below would be a file of its own. Counted are its lines, those of the docstrings included.
"""

import dataclasses
import inspect
import json
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import classifiers, metrics, policies, robots, social_forces, tasks
from sean_jax.classifiers.predicates import any_person, cosine, near
from sean_jax.cli import command_line
from sean_jax.core.data_types import Behavior, Pedestrians
from sean_jax.people import behaviors, pedestrian_models
from sean_jax.people.behaviors.starts import no_groups
from sean_jax.social_forces import draw_traits
from sean_jax.tasks.random_tasks import far_place
from sean_jax.world import environment as environments
from support import programs
from support.checkout import ROOT
from support.robot_files import PUCK
from support.scenes import BENCH, box, room

MOST = 30  # lines
RECIPES = (ROOT / "docs" / "adding_parts.md").read_text(encoding="utf-8")


# --- a force ---


def magnetic(parameters, pair):
    """Repulsion that falls with the square of the distance: accelerations [m/s2]."""
    square = pair.dx * pair.dx + pair.dy * pair.dy + 1e-4
    size = parameters.strength * parameters.range * parameters.range / (square * jnp.sqrt(square))
    return size * pair.dx, size * pair.dy


# --- a pedestrian model ---


def glide(scenario, state):
    """Everybody has the velocity that they desire, and minds nobody."""
    people = state.pedestrians
    position = people.position + scenario.time_step * people.desired_velocity
    return dataclasses.replace(people, position=position, velocity=people.desired_velocity)


# --- a situation ---


def watched(snapshot, thresholds):
    """Somebody near looks at the robot, to within the angle A."""

    def holds(agent):
        toward = cosine(agent.heading, snapshot.position - agent.position)
        return near(snapshot.position, agent.position, thresholds.near) & (toward >= jnp.cos(thresholds.angle))

    return any_person(snapshot, holds)


# --- a metric ---


def turn(before, after):
    """Angle [rad] by which the robot's heading turns in a step."""
    cross = before.heading[0] * after.heading[1] - before.heading[1] * after.heading[0]
    return jnp.abs(jnp.arctan2(cross, (before.heading * after.heading).sum()))


turned_angle = metrics.total(turn, unit="rad", title="angle turned", definition="Sum of all turns of the robot.")


# --- a task ---


def to_first_place(scenario, pedestrians, groups, *memory_and_key):
    """From anywhere to the first of the free places."""
    key, goal = memory_and_key[-1], scenario.navigation.places[0]
    start = far_place(scenario, pedestrians, goal, key)
    return tasks.build_task(scenario, start, goal)


# --- a policy ---


def dance(scenario, state, key):
    """Turns on the spot, one way and then the other."""
    way = jnp.where(state.tick % 20 < 10, 1.0, -1.0)
    return jnp.stack([jnp.zeros(()), 2.0 * way])


# --- a behavior ---


def parade(place, people=None):
    """People march up and down, 10 s each way."""
    return Behavior(data=place.navigation.places, name="parade", reset=line_up, direct=march)


def line_up(scenario, key):
    """Everybody at one of the free places, at rest."""
    number = scenario.people
    speed, distance = draw_traits(scenario.forces, key, number)
    still = jnp.zeros((number, 2), jnp.float32)
    ahead = still + jnp.array([[1.0, 0.0]], jnp.float32)
    nobody, there = jnp.full(number, -1, jnp.int32), jnp.ones(number, bool)
    chosen = jax.random.choice(key, scenario.behavior.data, (number,), replace=False)
    return Pedestrians(chosen, still, ahead, still, nobody, nobody, there, speed, distance), no_groups(), ()


def march(scenario, state, key):
    """Desired velocities along x or against it."""
    way = jnp.where(state.tick // 100 % 2 == 0, 1.0, -1.0)
    velocity = (way * state.pedestrians.preferred_speed)[:, None] * jnp.array([[1.0, 0.0]], jnp.float32)
    return dataclasses.replace(state, pedestrians=dataclasses.replace(state.pedestrians, desired_velocity=velocity))


# --- a robot and an environment, which are files ---


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Folder of the environment and file of the robot, both outside the package."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "puck.xml").write_text(PUCK)
    boxes = box((0, 0), (1.5, 0.5)), box((-4, 2), (0.5, 1), height=1.0, turn=30)
    return room(folder / "yard", (-8, -6, 8, 6), boxes, 5, name="yard", graph=BENCH), folder / "puck.xml"


@pytest.fixture
def added(monkeypatch):
    """One line in each dict, as in the package's own `__init__.py` files."""
    for family, name, value in (
        (
            social_forces.PRESETS,
            "magnetic",
            social_forces.preset("helbing1995").tree_replace({"repulsion.law": magnetic}),
        ),
        (pedestrian_models.MODELS, "glide", glide),
        (classifiers.SITUATIONS, "watched", watched),
        (metrics.METRICS, "turned_angle", turned_angle),
        (tasks.TASKS, "to_first_place", to_first_place),
        (policies.POLICIES, "dance", dance),
        (behaviors.BEHAVIORS, "parade", parade),
    ):
        monkeypatch.setitem(family, name, value)


def test_additions_are_short(files):
    for name, parts in {
        "force": [magnetic], "model": [glide], "situation": [watched], "metric": [turn],
        "task": [to_first_place], "policy": [dance], "behavior": [parade, line_up, march],
    }.items():  # fmt: skip
        assert sum(len(inspect.getsource(part).splitlines()) for part in parts) <= MOST, name
    environment_files = [file.read_text() for file in files[0].iterdir()]
    assert len(PUCK.splitlines()) <= MOST and sum(len(text.splitlines()) for text in environment_files) <= MOST


def test_recipes_name_what_is_added_here_and_no_other_way():
    """Sections 'Add a ...', signatures and dicts are those used in this file; no call that registers anything."""
    titles = set(re.findall(r"^## Add an? (.+)$", RECIPES, re.M))
    assert {"force", "situation", "task", "metric", "robot", "environment", "behavior or a policy"} <= titles
    calls = ("pair(self, pair)", "person(self, crowd)", "name(snapshot, thresholds)", "policy(scenario, state, key)",
             "move(scenario, state)", "build(place, people)", "reset(scenario, key)",
             "direct(scenario, state, key)")  # fmt: skip
    families = ("PRESETS", "SITUATIONS", "METRICS", "TASKS", "BEHAVIORS", "POLICIES", "MODELS")
    for said in (*calls, *(f"`{family}`" for family in families)):
        assert said in RECIPES, said
    assert "register(" not in RECIPES


def test_all_are_handed_over_without_touching_the_package(scenario):
    """Force, situation, metric and task as values of one scenario, and the policy to rollout."""
    mine = scenario.replace(
        forces=scenario.forces.tree_replace({"repulsion.law": magnetic}),
        situations=(*scenario.situations, ("watched", watched)),
        metrics=(*scenario.metrics[:2], ("turned_angle", turned_angle)),
        task=to_first_place,
    )
    last, frames = programs.rollout(mine, dance, jax.random.key(2), 40)
    np.testing.assert_allclose(last.task.goal, scenario.navigation.places[0])
    np.testing.assert_allclose(np.asarray(frames.action)[:, 1], [2.0] * 10 + [-2.0] * 10 + [2.0] * 10 + [-2.0] * 10)
    np.testing.assert_allclose(frames.position[-1], last.task.start, atol=1e-2)  # it dances on the spot
    people, heading = np.asarray(frames.people), np.asarray(frames.people_heading)
    gap = np.asarray(frames.position)[:, None] - people
    distance = np.linalg.norm(gap, axis=-1)
    looks = (heading * gap).sum(-1) / distance.clip(1e-9) >= np.cos(np.pi / 12)
    np.testing.assert_array_equal(frames.situations[:, 5], (looks & (distance < 2.4)).any(1))
    heading = np.concatenate([np.asarray(last.task.start_heading)[None], np.asarray(frames.heading)])
    angle = np.abs(np.diff(np.unwrap(np.arctan2(heading[:, 1], heading[:, 0])))).sum()
    assert angle > 5.0 and programs.results(mine, last)["turned_angle"][0] == pytest.approx(angle, rel=1e-3)


def test_a_force_pushes(scenario):
    """Two who stand 1 m apart are pushed by A B^2 / d^2 each, where they see each other."""
    facing = jnp.array([[1.0, 0.0], [-1.0, 0.0]], jnp.float32)
    still, both = jnp.zeros((2, 2), jnp.float32), jnp.ones(2, jnp.float32)
    alone = jnp.full(2, -1, jnp.int32)
    people = Pedestrians(jnp.array([[0.0, 0.0], [1.0, 0.0]], jnp.float32), still, facing, still,
                         alone, alone, jnp.ones(2, bool), both, both)  # fmt: skip
    changes = {"repulsion.law": magnetic, "walking.backward_scale": 1.0}
    forces = scenario.forces.tree_replace(changes)
    after = jax.jit(lambda people: social_forces.integrate(forces, people, None, None, None, 0.01))(people)
    push = float(forces.repulsion.strength * forces.repulsion.range**2)
    np.testing.assert_allclose(after.velocity, [[-0.01 * push, 0.0], [0.01 * push, 0.0]], rtol=1e-3, atol=1e-6)


def test_a_robot_an_environment_a_behavior_and_a_model_by_name_and_path(files, added):
    """The robot by its twin; `sean run` below has it in MJX."""
    yard, puck = files
    mine = sean_jax.make(
        yard, behavior="parade", task="to_first_place", robot=puck, model="glide", people=4, dynamics="twin"
    )
    assert mine.environment.name == "yard" and mine.robot.name == "puck" and mine.move is glide
    quick = dataclasses.replace(mine, metrics=mine.metrics[-1:])
    last, frames = programs.rollout(quick, dance, jax.random.key(0), 20)
    moved = np.asarray(frames.people)[-1] - np.asarray(frames.people)[0]
    speed = np.asarray(last.pedestrians.preferred_speed)
    np.testing.assert_allclose(moved, np.stack([1.9 * speed, 0 * speed], -1), atol=1e-3)
    assert np.abs(np.asarray(frames.heading)[9] - np.asarray(frames.heading)[0]).max() > 0.5
    assert float(programs.results(quick, last)["turned_angle"][0]) > 1.0


def test_sean_list_shows_them(files, added, monkeypatch, capsys):
    yard, puck = files
    monkeypatch.setitem(robots.ROBOTS, "puck", puck)
    monkeypatch.setattr(environments, "ENVS", yard.parent)
    assert command_line.main(["list"]) == 0
    said = capsys.readouterr().out
    for line in (
        "yard", "16 x 12 m and, unless told otherwise, 5 people.", "puck", "Puck", "Magnetic repulsion", "minds nobody",
        "watched", "turned_angle", "From anywhere to the first of the free places",
        "Turns on the spot", "People march up and down",
    ):  # fmt: skip
        assert line in said


@pytest.mark.night
def test_sean_run_measures_and_reports_them(files, added, tmp_path, capsys):
    """All at once on the command line: columns of the table, of episodes.csv and of the report."""
    yard, puck = files
    options = "--behavior parade --task to_first_place --policy dance --forces magnetic --dynamics mjx --people 4"
    asked = ["run", "--environment", str(yard), "--robot", str(puck), *options.split(), "--out", str(tmp_path / "run")]
    assert command_line.main([*asked, "--episodes", "2", "--time-limit", "3"]) == 0
    assert "watched" in capsys.readouterr().out
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["metrics"]["turned_angle"]["overall"]["mean"] > 1.0 and "watched" in summary["situations"]
    assert "turned_angle__watched" in (tmp_path / "run" / "episodes.csv").read_text().splitlines()[0]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "angle turned" in page and "Sum of all turns of the robot." in page and "watched" in page

"""Free places: drawn alike, or as on SEAN's navigation mesh, against a loop that shares nothing with the package."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import sean_jax
from sean_jax import environment as environments
from sean_jax import navigation

RADIUS, MESH, EDGE = 0.25, 0.5, 0.25
FLOOR = (-6.0, -4.0, 7.0, 5.0)
BOXES = [(0.0, 0.0, 1.0, 0.5), (0.8, 0.9, 0.6, 0.8), (6.0, 3.0, 2.0, 0.2), (-3.3, -3.7, 0.4, 0.6)]  # centre, half
CORNERS = [  # of the free floor by hand: rectangles grown by 0.5 m, two of which overlap, in a room shrunk by 0.5 m
    (-5.5, -3.5), (-5.5, 4.5), (6.5, 4.5), (6.5, -3.5),  # the room
    (-1.5, -1.0), (1.5, -1.0), (-1.5, 1.0),  # the first box; the second covers its fourth corner
    (1.9, -0.4), (1.9, 2.2), (-0.3, 2.2), (-0.3, 1.0), (1.5, -0.4),  # the second, and where their sides meet
    (3.5, 2.3), (3.5, 3.7), (6.5, 2.3), (6.5, 3.7),  # the third, whose far end is in the wall
    (-4.2, -2.6), (-2.4, -2.6), (-4.2, -3.5), (-2.4, -3.5),  # the fourth, which stands in the wall below
]  # fmt: skip


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hall")
    (folder / "environment.yaml").write_text(f"name: hall\nfloor: {list(FLOOR)}\npeople: 3\n")
    boxes = "".join(f'<geom type="box" size="{hx} {hy} 1" pos="{x} {y} 1"/>' for x, y, hx, hy in BOXES)
    (folder / "scene.xml").write_text(f"<mujoco><worldbody>{boxes}</worldbody></mujoco>")
    return folder


def clearance(x: float, y: float) -> float:
    """To the nearest box, or edge of the floor."""
    away = [x - FLOOR[0], y - FLOOR[1], FLOOR[2] - x, FLOOR[3] - y]
    for cx, cy, hx, hy in BOXES:
        u, v = abs(x - cx) - hx, abs(y - cy) - hy
        away.append(max(u, v) if max(u, v) < 0 else float(np.hypot(max(u, 0), max(v, 0))))
    return min(away)


def by_hand(places: np.ndarray, number: int) -> np.ndarray:
    """So many draws, one at a time: how often each of the places stands for one."""
    random, count = np.random.default_rng(7), np.zeros(len(places), int)
    while count.sum() < number:
        (x1, y1), (x2, y2) = (CORNERS[random.integers(len(CORNERS))] for _ in range(2))
        if int(x1) == int(x2) or int(y1) == int(y2):
            continue
        share = random.uniform(0.05, 0.95)
        x, y = x1 + share * (x2 - x1), y1 + share * (y2 - y1)
        if clearance(x, y) < MESH + EDGE:
            continue
        for place in np.argsort(np.hypot(places[:, 0] - x, places[:, 1] - y)):
            steps = np.linspace(0.0, 1.0, 20)
            if min(clearance(*(np.array([x, y]) + k * (places[place] - [x, y]))) for k in steps) >= RADIUS - 1e-3:
                count[place] += 1
                break
    return count


def chance_of(counts: np.ndarray) -> float:
    """Of counts (2, cells) that differ as much, if both are of one distribution."""
    return float(stats.chi2_contingency(counts)[1])  # pyright: ignore[reportArgumentType]


def test_corners_are_those_of_the_free_floor(hall):
    found = navigation.mesh_corners(environments.load(hall), MESH)
    assert {(round(x, 4), round(y, 4)) for x, y in found.tolist()} == set(CORNERS)


def test_corners_of_a_box_that_is_turned(tmp_path):
    (tmp_path / "environment.yaml").write_text("name: turned\nfloor: [-5, -5, 5, 5]\npeople: 1\nopen: true\n")
    box = '<geom type="box" size="1 0.5 1" pos="1 0 1" euler="0 0 90"/>'
    (tmp_path / "scene.xml").write_text(f"<mujoco><worldbody>{box}</worldbody></mujoco>")
    found = navigation.mesh_corners(environments.load(tmp_path), 0.5)
    room, around = {(x, y) for x in (-4.5, 4.5) for y in (-4.5, 4.5)}, {(x, y) for x in (0.0, 2.0) for y in (-1.5, 1.5)}
    assert {(round(x, 4) + 0.0, round(y, 4) + 0.0) for x, y in found.tolist()} == room | around


def test_mesh_draws_places_as_often_as_a_loop_by_hand(hall):
    scene = environments.load(hall)
    tables = navigation.build(scene, RADIUS)
    mesh = navigation.PLACES["mesh"](scene, tables)
    places = np.asarray(tables.places, float)
    expected = by_hand(places, 4000)
    drawn = jax.jit(lambda key: navigation.draw_places(mesh, key, 40_000))(jax.random.key(0))
    ours = np.bincount(np.asarray(drawn), minlength=len(places))
    cell = np.floor(places / 1.5).astype(int)
    cell = (cell[:, 0] - cell[:, 0].min()) * 100 + cell[:, 1] - cell[:, 1].min()
    by_cell = np.array([[count[cell == each].sum() for each in np.unique(cell)] for count in (ours, expected)])
    by_cell = by_cell[:, by_cell.sum(0) > 100]
    assert by_cell.shape[1] > 20
    assert chance_of(by_cell) > 1e-3
    even = np.bincount(jax.random.randint(jax.random.key(0), (40_000,), 0, len(places)), minlength=len(places))
    by_cell = np.array([[count[cell == each].sum() for each in np.unique(cell)] for count in (even, expected)])
    assert chance_of(by_cell) < 1e-30  # which the test would see


def test_uniform_draws_as_ever(hall):
    scene = environments.load(hall)
    tables = navigation.build(scene, RADIUS)
    again = navigation.PLACES["uniform"](scene, navigation.PLACES["mesh"](scene, tables))
    assert jax.tree.structure(again) == jax.tree.structure(tables)
    for key in jax.random.split(jax.random.key(3), 5):
        expected = jax.random.randint(key, (70,), 0, tables.places.shape[0], jnp.int32)
        np.testing.assert_array_equal(navigation.draw_places(again, key, 70), expected)


def test_goals_of_people_and_of_the_robot_are_drawn_on_the_mesh(hall):
    """Half of the places have more than 0.7 of the mesh's draws, and so of goals and starts; of uniform ones a half."""
    common: Any = dict(behavior="random", task="random_ab_nav", people=3, dynamics="twin", task_distance=(0.0, np.inf))
    mesh = sean_jax.make(hall, goal_sampling="mesh", **common)
    chance = np.bincount(np.asarray(mesh.navigation.mesh_places), minlength=mesh.navigation.places.shape[0])
    often = chance > np.median(chance)
    assert chance[often].sum() > 0.7 * chance.sum()
    for scenario, least, most in ((mesh, 0.68, 1.0), (sean_jax.make(hall, **common), 0.4, 0.6)):

        def one(key, scenario=scenario):
            people, groups, memory = scenario.behavior.reset(scenario, key)
            task = scenario.task(scenario, people, groups, memory, jax.random.fold_in(key, 1))
            return memory.goal, task.start, task.goal

        goal, start, end = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), 400))
        ends = np.concatenate([start, end])
        gap = np.abs(ends[:, None] - np.asarray(scenario.navigation.places)).sum(-1)
        for drawn in (np.asarray(goal).ravel(), gap.argmin(1)):
            assert least < often[drawn].mean() < most


def test_a_floor_without_room_for_the_mesh_is_refused(tmp_path):
    (tmp_path / "environment.yaml").write_text("name: alley\nfloor: [0, 0, 9, 1.2]\npeople: 1\n")
    (tmp_path / "scene.xml").write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(ValueError, match="hardly any is 0.75 m from obstacles.*choose uniform"):
        sean_jax.make(
            tmp_path, behavior="random", task="random_ab_nav", people=1, dynamics="twin", goal_sampling="mesh"
        )
    with pytest.raises(ValueError, match="goal_sampling: 'mash' is not one of uniform, mesh; did you mean 'mesh'?"):
        sean_jax.make(goal_sampling="mash")

"""Free places: drawn alike, or as on SEAN's navigation mesh, against a loop that shares nothing with the package."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from scipy import stats
from shapely import affinity

import sean_jax
from sean_jax.core.data_types import Environment
from sean_jax.world import environment as environments
from sean_jax.world import generated, navigation
from sean_jax.world.navigation.triangulation import free_triangles
from support.scenes import box, room

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
    boxes = [box((x, y), half_extent) for x, y, *half_extent in BOXES]
    return room(tmp_path_factory.mktemp("hall"), FLOOR, boxes, 3)


def clearance(x: float, y: float) -> float:
    """To the nearest box, or edge of the floor."""
    away = [x - FLOOR[0], y - FLOOR[1], FLOOR[2] - x, FLOOR[3] - y]
    for cx, cy, hx, hy in BOXES:
        u, v = abs(x - cx) - hx, abs(y - cy) - hy
        away.append(max(u, v) if max(u, v) < 0 else float(np.hypot(max(u, 0), max(v, 0))))
    return min(away)


def by_hand(vertices: np.ndarray, places: np.ndarray, number: int) -> np.ndarray:
    """So many draws between vertices, one at a time: how often each of the places stands for one."""
    random, count = np.random.default_rng(7), np.zeros(len(places), int)
    while count.sum() < number:
        (x1, y1), (x2, y2) = (vertices[random.integers(len(vertices))] for _ in range(2))
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


def make(boxes: list, floor: tuple, open: bool) -> Environment:
    """Boxes of center, half extent and yaw."""
    settings = environments.Settings(name="boxes", floor=floor, people=1, open=open)
    return environments.of_boxes(settings, np.reshape([[*box, 1.0] for box in boxes], (-1, 6)))


def free_floor(scene: Environment, radius: float):
    """The same by shapely: the room, shrunk, without the boxes, grown."""
    x0, y0, x1, y1 = np.asarray(scene.floor, float)
    free = shapely.box(x0 + radius, y0 + radius, x1 - radius, y1 - radius)
    free = free if min(x1 - x0, y1 - y0) > 2 * radius else shapely.Polygon()
    boxes = scene.obstacles
    center, half_extent, angle = (np.asarray(each, float) for each in (boxes.center, boxes.half_extent, boxes.yaw))
    for (x, y), half, yaw in zip(center, half_extent, angle, strict=True):
        grown = shapely.box(*(-half - radius), *(half + radius))
        free = free.difference(affinity.translate(affinity.rotate(grown, yaw, (0, 0), use_radians=True), x, y))
    return free


def check_triangles(scene: Environment, radius: float = MESH) -> np.ndarray:
    """Triangles cover the free floor, and nothing else or twice, up to the rounding of corners."""
    triangles, free = free_triangles(scene, radius), free_floor(scene, radius)
    polygons = shapely.polygons(triangles)
    assert shapely.is_ccw(shapely.get_exterior_ring(polygons)).all()
    assert shapely.area(polygons).sum() == pytest.approx(free.area, abs=1e-3)
    assert shapely.union_all(polygons).symmetric_difference(free).area < 1e-3
    return triangles


def test_triangles_are_those_of_the_free_floor(hall):
    """Their vertices are its corners, and as many as triangles, as in any triangulation of a floor with one hole."""
    triangles = check_triangles(environments.load(hall))
    assert {(round(x, 4), round(y, 4)) for x, y in triangles.reshape(-1, 2).tolist()} == set(CORNERS)
    assert len(triangles) == len(CORNERS)


@pytest.mark.parametrize("family", generated.FAMILIES)
def test_triangles_of_worlds(family):
    for seed in range(2):
        check_triangles(generated.generate(family, seed).environment)


def test_triangles_of_random_boxes():
    random = np.random.default_rng(0)
    for case in range(24):
        number = random.integers(0, 30)
        center, half = random.uniform(-1.0, 13.0, (number, 2)), random.uniform(0.05, 2.0, (number, 2))
        yaw = random.choice([0.0, np.pi / 4, np.pi / 2, random.uniform(0.0, 6.0)], number)
        if case % 3 == 0:  # sides on common lines
            center, half, yaw = np.round(center), np.round(half * 2) / 2 + 0.5, 0.0 * yaw
        boxes = np.concatenate([center, half, yaw[:, None]], 1)
        check_triangles(make(list(boxes), (0.0, 0.0, 12.0, 9.0), bool(case % 2)), random.choice([0.5, 0.25, 0.0]))


def test_triangles_of_degenerate_floors():
    assert len(check_triangles(make([], (0.0, 0.0, 5.0, 4.0), True))) == 2
    assert len(check_triangles(make([], (0.0, 0.0, 9.0, 1.2), False))) == 2  # a corridor
    assert len(check_triangles(make([], (0.0, 0.0, 9.0, 1.0), True))) == 0  # as wide as the disc
    assert len(check_triangles(make([], (0.0, 0.0, 9.0, 0.8), False))) == 0
    assert len(check_triangles(make([(2.0, 2.0, 3.0, 3.0, 0.3)], (0.0, 0.0, 4.0, 4.0), True))) == 0  # no floor is free
    check_triangles(make([(2.0, 2.0, 0.5, 1.5, 0.0)] * 2, (0.0, 0.0, 4.0, 4.0), True))  # the same box twice
    touching = [(3.0, 0.5, 0.5, 0.5, 0.0), (3.0, 3.5, 0.5, 1.0, 0.0)]  # the disc just fits between
    assert len(check_triangles(make(touching, (0.0, 0.0, 6.0, 4.5), True), 0.75)) == 6  # of two separate floors


def test_mesh_draws_places_as_often_as_a_loop_by_hand(hall):
    scene = environments.load(hall)
    tables = navigation.build(scene, RADIUS)
    mesh = navigation.PLACES["mesh"](scene, tables)
    places = np.asarray(tables.places, float)
    expected = by_hand(check_triangles(scene).reshape(-1, 2), places, 4000)
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
    room(tmp_path, (0, 0, 9, 1.2))
    with pytest.raises(ValueError, match="hardly any is 0.75 m from obstacles.*choose uniform"):
        sean_jax.make(
            tmp_path, behavior="random", task="random_ab_nav", people=1, dynamics="twin", goal_sampling="mesh"
        )
    with pytest.raises(ValueError, match="goal_sampling: 'mash' is not one of uniform, mesh; did you mean 'mesh'?"):
        sean_jax.make(goal_sampling="mash")

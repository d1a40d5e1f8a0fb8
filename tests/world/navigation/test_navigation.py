"""Shortest paths: lengths and ways against a visibility graph in float64 (shortest_paths.py), and who follows them."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.core.data_types import Environment, Obstacles
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.graph import annotation
from sean_jax.world import environment as environments
from sean_jax.world import navigation
from sean_jax.world.environment import plain_scenery
from sean_jax.world.navigation import Navigation
from support import shortest_paths as oracle
from support.quick import quick, slow

RADIUS = 0.25  # m
KURI, WARTHOG = 0.16, 0.95  # m
PAIRS = 60
STRIDE = 0.1  # m
POINTS = 200  # next points, at most, on a way


class Place(NamedTuple):
    environment: Environment
    tables: Navigation
    boxes: oracle.Boxes


def yard(rows, floor=(-8.0, -8.0, 8.0, 8.0)) -> Environment:
    """A floor with boxes (center x, y, half extent x, y, yaw in rad)."""
    rows = np.array(rows, np.float32).reshape(-1, 5)
    parts = (rows[:, :2], rows[:, 2:4], rows[:, 4], np.ones(len(rows), np.float32))
    obstacles, edges = Obstacles(*(jnp.asarray(part) for part in parts)), jnp.asarray(floor, jnp.float32)
    return Environment(
        floor=edges,
        obstacles=obstacles,
        obstacle_grid=build_obstacle_grid(obstacles, edges),
        scenery=plain_scenery(obstacles),
        name="yard",
    )


@functools.cache
def place(name: str, radius: float = RADIUS) -> Place:
    if name == "yard":
        random = np.random.default_rng(0)
        center = np.stack(np.meshgrid(np.arange(-6, 7, 3), np.arange(-6, 7, 3)), -1).reshape(-1, 2)
        center = center + random.uniform(-0.4, 0.4, center.shape)
        half = np.stack([random.uniform(0.4, 0.9, 25), random.uniform(0.1, 0.4, 25)], -1)
        here = yard(np.concatenate([center, half, random.uniform(-3, 3, (25, 1))], 1))
    elif name == "heap":  # boxes of all sizes that lie across each other and over the edge, with narrow gaps
        random = np.random.default_rng(8)
        rows = [random.uniform(-5, 5, (40, 2)), random.exponential(0.5, (40, 2)), random.uniform(-3, 3, (40, 1))]
        here = yard(np.concatenate(rows, 1), (-5.0, -5.0, 5.0, 5.0))
    else:
        here = environments.load(name)
    return Place(here, navigation.build(here, radius), oracle.boxes_of(here))


def check_ways(here: Place, start, path, goal, exact, apart, most):
    """Ways end at the goal, keep so far off obstacles [m], and are at most so many times as long as they must be."""
    path = np.concatenate([start[:, None], np.asarray(path, float)], 1)
    assert np.linalg.norm(path[:, -1] - goal, axis=1).max() < 1e-3
    assert oracle.walked_clearance(path, here.boxes) > apart
    walked = np.linalg.norm(np.diff(path, axis=1), axis=-1).sum(1)
    assert (walked <= most * exact + 1e-3).all() and (walked >= 0.999 * exact - 1e-3).all()


def check_pairs(here: Place, radius: float, pairs: int, arc: int = 12):
    """Lengths and walked ways between random free places; gives the excess of the lengths."""
    points = environments.free_points(here.environment, radius, 2 * pairs, seed=3)
    start, goal = points[:pairs], points[pairs:]
    exact = oracle.geodesics(here.boxes, radius, start.astype(float), goal.astype(float), arc)
    ours = np.asarray(oracle.lengths(here.tables, start, goal), float)
    there = np.isfinite(exact)
    np.testing.assert_array_equal(np.isfinite(ours), there)
    start, goal, exact, ours = start[there], goal[there], exact[there], ours[there]
    assert (ours <= 1.005 * exact + 1e-4).all() and (ours >= 0.999 * exact - 1e-4).all()
    path = oracle.follow(here.tables, start, goal, jnp.asarray(jnp.inf, jnp.float32), POINTS)
    check_ways(here, start, path, goal, exact, radius - 1e-3, 1.01)
    back = np.asarray(oracle.lengths(here.tables, goal, start), float)
    np.testing.assert_allclose(back, ours, rtol=1e-3, atol=1e-4)
    return exact / np.maximum(np.linalg.norm(start - goal, axis=1), 1e-6)


@pytest.mark.parametrize("name", quick(["warehouse", "lab", "outdoor", "yard"], "warehouse"))
def test_paths_and_who_follows_them(name):
    detour = check_pairs(place(name), RADIUS, PAIRS)
    assert (detour > 1.01).sum() > 12  # there was something to go around


@pytest.mark.slow
@pytest.mark.parametrize("radius", [RADIUS, pytest.param(0.06, marks=pytest.mark.slow)])
def test_paths_through_a_heap_of_boxes(radius):
    assert (check_pairs(place("heap", radius), radius, 2 * PAIRS) > 1.05).sum() > 20


@pytest.mark.parametrize(
    ("name", "radius"), slow([("warehouse", KURI), ("lab", KURI), ("outdoor", WARTHOG)], ("lab", KURI))
)
def test_hundreds_of_paths(name, radius):
    check_pairs(place(name, radius), radius, 300, arc=24)


def test_way_around_one_corner_is_two_tangents_and_an_arc():
    """In closed form, at the corners of a box that is turned; and there and back again is twice as long."""
    turn, radius = 0.4, 0.5
    tables = navigation.build(yard([(0, 0, 1, 1, turn)]), radius)
    start, goal = np.array([-2.5, 0.2]), np.array([0.3, -3.1])  # in the box's own frame, around its corner (-1, -1)
    gaps = [spot - np.array([-1, -1]) for spot in (start, goal)]
    far = [np.linalg.norm(gap) for gap in gaps]
    between = np.arccos(gaps[0] @ gaps[1] / far[0] / far[1])
    straight = [np.sqrt(part**2 - radius**2) for part in far]
    exact = sum(straight) + radius * (between - sum(np.arccos(radius / part) for part in far))
    rotate = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    ends = [jnp.asarray((spot @ rotate)[None], jnp.float32) for spot in (start, goal)]
    np.testing.assert_allclose(oracle.lengths(tables, *ends), exact, rtol=1e-5)
    np.testing.assert_allclose(oracle.lengths(tables, *ends[::-1]), exact, rtol=1e-5)
    np.testing.assert_array_equal(oracle.lengths(tables, ends[0], ends[0]), 0.0)


@pytest.mark.parametrize("room", [0.002, -0.002])
def test_a_disc_goes_through_a_gap_that_is_a_little_wider(room):
    """And not through one that is a little narrower."""
    half = (8.0 - RADIUS - room / 2) / 2
    walls = [(-8 + half, 0, half, 0.1, 0), (8 - half, 0, half, 0.1, 0)]
    tables = navigation.build(yard(walls), RADIUS)
    start, goal = jnp.array([[0.0, -2.0], [3.0, -0.5]]), jnp.array([[0.0, 2.0], [3.0, 0.5]])
    found = np.asarray(oracle.lengths(tables, start, goal))
    assert np.isfinite(found).all() == (room > 0)
    if room > 0:
        np.testing.assert_allclose(found[0], 4.0, rtol=1e-4)
        path = np.asarray(oracle.follow(tables, start, goal, jnp.float32(jnp.inf), POINTS))
        np.testing.assert_allclose(path[:, -1], goal, atol=1e-3)


def test_tables_of_bends():
    """A way back is the way there, with left and right, and enter and leave, exchanged."""
    tables = place("warehouse").tables
    count = tables.arcs.side.shape[0]
    back = np.arange(count) ^ 1  # the other arc of the corner
    np.testing.assert_array_equal(np.asarray(tables.arcs.side)[back], -np.asarray(tables.arcs.side))
    distance, turn = tables.distance.on_host().T, tables.rotation.on_host()
    # Not quite everywhere: for loops that are on no shortest path, one of the two may be missed.
    assert np.isclose(distance.T[back][:, back], distance, atol=1e-4).mean() > 0.99
    there = np.isfinite(distance) & np.isfinite(distance.T[back][:, back])
    assert there.mean() > 0.3 and (np.diag(distance) == 0).all()
    assert np.median(np.abs(turn.T[back][:, back] - turn)[there]) < 1e-4
    here = place("warehouse")
    free = oracle.clearance(np.asarray(tables.places, float), here.boxes)
    assert free.min() > RADIUS and len(free) > 900


def test_gradients_point_along_the_way():
    """Of the length by the start: away from the next point; finite on arcs, at walls, in obstacles and at the goal."""
    here = place("yard")
    points = jnp.asarray(environments.free_points(here.environment, RADIUS, 240, seed=5))
    start, goal = points[:120], points[120:]
    corner = np.asarray(here.tables.arcs.corner)[:20]
    odd = jnp.concatenate([goal[:20], jnp.asarray(corner), here.environment.obstacles.center[:20]])

    @jax.jit
    @functools.partial(jax.vmap, in_axes=(0, 0))
    def slope(start, goal):
        def far(start):
            return navigation.geodesic(here.tables, start, goal, navigation.build_paths_to_goal(here.tables, goal))

        ahead = navigation.next_point(here.tables, start, goal, navigation.build_paths_to_goal(here.tables, goal))
        return jax.grad(far)(start), ahead - start

    by_start, ahead = map(np.asarray, slope(jnp.concatenate([start, odd]), jnp.concatenate([goal, *[goal[:20]] * 3])))
    assert np.isfinite(by_start).all() and np.isfinite(ahead).all()
    by_start, ahead = by_start[:120], ahead[:120]
    there = np.linalg.norm(ahead, axis=1) > 1e-3
    along = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-6)
    assert there.sum() > 100
    np.testing.assert_allclose(by_start[there], -along[there], atol=2e-2)


def test_rough_lengths_are_near_the_exact_ones():
    tables = place("warehouse").tables
    start, goal = tables.places[:200], tables.places[200:400]

    @jax.jit
    @jax.vmap
    def both(start, goal):
        paths_to_goal = navigation.build_paths_to_goal(tables, goal)
        exact = navigation.geodesic(tables, start, goal, paths_to_goal)
        return navigation.geodesic_approx(tables, start, goal, paths_to_goal), exact

    rough, exact = map(np.asarray, both(start, goal))
    near = np.abs(rough - exact) < 0.5
    assert near.mean() > 0.97 and np.isfinite(exact).all()


@pytest.mark.parametrize("name", quick(["warehouse", "lab"], "warehouse"))
def test_tables_of_people_lead_to_every_node_of_the_graph(name):
    """Around obstacles, by as much as their bodies need, and on ways that are hardly longer than they must be."""
    here = place(name)
    goals = annotation.read_graph(environments.find(name) / "graph.yaml", here.environment).position
    ways = navigation.build_next_corner_table(here.tables, goals)
    starts = environments.free_points(here.environment, RADIUS + 0.01, 20, seed=5)

    @jax.jit
    def walk(starts):
        def one(start, node):
            def stride(position, _):
                gap = navigation.next_corner(here.tables, ways, position, node) - position
                far = jnp.sqrt((gap * gap).sum())
                position = position + gap * (jnp.minimum(far, STRIDE) / jnp.maximum(far, 1e-6))
                return position, position

            return jax.lax.scan(stride, start, length=700)[1]

        nodes = jnp.arange(goals.shape[0], dtype=jnp.int32)
        return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(starts, nodes)

    path = np.asarray(walk(jnp.asarray(starts))).reshape(-1, 700, 2)
    start = np.repeat(starts, len(goals), 0)
    goal = np.tile(np.asarray(goals), (len(starts), 1))
    exact = np.asarray(oracle.lengths(here.tables, start, goal), float)
    check_ways(here, start, path, goal, exact, 0.2, 1.05)


def test_sees_is_exact():
    here = place("yard")
    random = np.random.default_rng(6)
    p = random.uniform(-8, 8, (800, 2)).astype(np.float32)
    q = p + random.normal(0, 2, p.shape).astype(np.float32)
    exact = oracle.ways_clearance(p.astype(float), q.astype(float), here.boxes)
    ours = jax.jit(jax.vmap(navigation.segment_is_free, (None, 0, 0, None)))(here.environment.obstacles, p, q, RADIUS)
    told = np.abs(exact - RADIUS) > 1e-5
    np.testing.assert_array_equal(np.asarray(ours)[told], exact[told] >= RADIUS)
    assert 0.1 < ours.mean() < 0.9


WALLED_IN = [(0, 1.5, 1.6, 0.1, 0), (0, -1.5, 1.6, 0.1, 0), (1.5, 0, 0.1, 1.6, 0), (-1.5, 0, 0.1, 1.6, 0)]


def test_a_place_without_a_way_is_infinitely_far():
    tables = navigation.build(yard(WALLED_IN, (-4.0, -4.0, 4.0, 4.0)), RADIUS)
    outside = np.abs(np.asarray(tables.places)).max(1) > 1.6
    assert outside.all() and len(outside) > 500  # from where one can go anywhere else
    start, goal = jnp.array([[3.0, 0.5], [0.5, 0.3], [3.0, 0.5]]), jnp.array([[0.5, 0.0], [0.0, 3.0], [-3.0, 0.0]])
    found = np.asarray(oracle.lengths(tables, start, goal))
    np.testing.assert_array_equal(np.isinf(found), [True, True, False])
    assert 6.5 < found[2] < 9.0

    def onward(position, goal):
        return navigation.next_point(tables, position, goal, navigation.build_paths_to_goal(tables, goal))

    following = np.asarray(jax.jit(jax.vmap(onward))(start, goal))
    np.testing.assert_array_equal(following[:2], goal[:2])  # straight on, for want of a way
    assert np.isfinite(following).all()
    ways, count = navigation.build_next_corner_table(tables, goal), tables.arcs.side.shape[0]
    for table in (ways.first_arc, ways.next_arc):
        assert (table.values >= -1).all() and (table.values < count).all()


def test_a_room_without_corners_to_go_around():
    """Nothing but outer walls: every way is straight."""
    walls = [(0, 4, 4, 0.1, 0), (0, -4, 4, 0.1, 0), (4, 0, 0.1, 4, 0), (-4, 0, 0.1, 4, 0)]
    tables = navigation.build(yard(walls, (-4.0, -4.0, 4.0, 4.0)), RADIUS)
    start, goal = jnp.array([[3.0, 0.5], [-2.0, -3.0]]), jnp.array([[-3.0, 0.5], [1.0, 1.0]])
    np.testing.assert_allclose(oracle.lengths(tables, start, goal), [6.0, 5.0], rtol=1e-5)
    first = navigation.build_next_corner_table(tables, goal).first_arc.on_host()
    assert (first[4:-4, 4:-4] == -1).all()
    assert len(tables.places) > 500


def test_no_room_is_refused():
    with pytest.raises(ValueError, match="hardly any place"):
        navigation.build(yard([(0, 0, 8, 8, 0)]), 0.5)

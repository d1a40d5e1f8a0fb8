"""Shortest paths: lengths against a visibility graph of rounded corners in float64, and the ways that walkers take."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from sean_jax import environment as environments
from sean_jax import navigation
from sean_jax.base import Environment, Obstacles
from sean_jax.graph import annotation
from sean_jax.navigation import Navigation
from sean_jax.nearby import tabulate
from sean_jax.scenery import plain

RADIUS = 0.25
PAIRS = 48


class Place(NamedTuple):
    environment: Environment
    tables: Navigation
    boxes: tuple[np.ndarray, ...]  # center, half extent, yaw in float64


def yard(rows, floor=(-8.0, -8.0, 8.0, 8.0)) -> Environment:
    """A floor with boxes (center x, y, half extent x, y, yaw in rad)."""
    rows = np.array(rows, np.float32).reshape(-1, 5)
    parts = (rows[:, :2], rows[:, 2:4], rows[:, 4], np.ones(len(rows), np.float32))
    obstacles, edges = Obstacles(*(jnp.asarray(part) for part in parts)), jnp.asarray(floor, jnp.float32)
    return Environment(
        floor=edges, obstacles=obstacles, nearby=tabulate(obstacles, edges), scenery=plain(obstacles), name="yard"
    )


@functools.cache
def place(name: str) -> Place:
    if name == "warehouse":
        here = environments.load(name)
    else:
        random = np.random.default_rng(0)
        center = np.stack(np.meshgrid(np.arange(-6, 7, 3), np.arange(-6, 7, 3)), -1).reshape(-1, 2)
        center = center + random.uniform(-0.4, 0.4, center.shape)
        half = np.stack([random.uniform(0.4, 0.9, 25), random.uniform(0.1, 0.4, 25)], -1)
        here = yard(np.concatenate([center, half, random.uniform(-3, 3, (25, 1))], 1))
    boxes = here.obstacles
    exact = tuple(np.asarray(part, np.float64) for part in (boxes.center, boxes.half_extent, boxes.yaw))
    return Place(here, navigation.build(here, RADIUS), exact)


def locals_of(points, boxes):
    """(..., W, 2) points (..., 2) in the frames of the boxes."""
    center, _, yaw = boxes
    offset = np.asarray(points, float)[..., None, :] - center
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.stack([cosine * offset[..., 0] + sine * offset[..., 1],
                     cosine * offset[..., 1] - sine * offset[..., 0]], -1)  # fmt: skip


def clearance(points, boxes) -> np.ndarray:
    """(...,) m outside the nearest box; 0 inside one."""
    return np.linalg.norm(np.maximum(np.abs(locals_of(points, boxes)) - boxes[1], 0), axis=-1).min(-1)


def ways_clearance(p, q, boxes) -> np.ndarray:
    """(...,) distance from the segments p to q (..., 2) to the nearest box, 0 if they meet."""
    a, b = locals_of(p, boxes), locals_of(q, boxes)
    half = boxes[1]
    along = b - a
    still, inside = along == 0, np.abs(a) <= half
    slope = np.where(still, 1.0, along)
    one, other = (-half - a) / slope, (half - a) / slope
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(one, other)).max(-1)
    leave = np.where(still, np.inf, np.maximum(one, other)).min(-1)
    meets = np.maximum(enter, 0) <= np.minimum(leave, 1)
    ends = np.minimum(*(np.linalg.norm(np.maximum(np.abs(end) - half, 0), axis=-1) for end in (a, b)))
    square = np.maximum((along**2).sum(-1), 1e-30)
    nearest = ends
    for su in (-1, 1):
        for sv in (-1, 1):
            corner = np.array([su, sv]) * half
            share = np.clip(((corner - a) * along).sum(-1) / square, 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(a + share[..., None] * along - corner, axis=-1))
    return np.where(meets, 0.0, nearest).min(-1)


def geodesics(here: Place, p, q, arc: int = 5) -> np.ndarray:
    """Shortest ways of a disc from each p to each q (K, 2): over points on the arcs about all corners, in float64."""
    center, half, yaw = here.boxes
    nodes = []
    angle = (np.arange(arc) + 0.5) / arc * np.pi / 2
    out = RADIUS / np.cos(np.pi / 4 / arc)  # the polygon about the arc
    for su, sv in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        u = su * (half[:, :1] + out * np.cos(angle))
        v = sv * (half[:, 1:] + out * np.sin(angle))
        turned = np.stack([np.cos(yaw)[:, None] * u - np.sin(yaw)[:, None] * v,
                           np.sin(yaw)[:, None] * u + np.cos(yaw)[:, None] * v], -1)  # fmt: skip
        nodes.append((turned + center[:, None]).reshape(-1, 2))
    nodes = np.concatenate(nodes)
    floor = np.asarray(here.environment.floor, float)
    on_floor = (np.minimum(nodes - floor[:2], floor[2:] - nodes) >= RADIUS).all(1)
    nodes = np.concatenate([nodes[on_floor & (clearance(nodes, here.boxes) >= RADIUS - 1e-9)], p, q])
    i, j = np.triu_indices(len(nodes), 1)
    free = np.concatenate([ways_clearance(nodes[a], nodes[b], here.boxes) >= RADIUS - 1e-9
                           for a, b in zip(np.array_split(i, 40), np.array_split(j, 40), strict=True)])  # fmt: skip
    graph = np.zeros((len(nodes), len(nodes)))
    graph[i[free], j[free]] = np.linalg.norm(nodes[i] - nodes[j], axis=1)[free]
    first = len(nodes) - len(p) - len(q)
    lengths = dijkstra(graph, directed=False, indices=np.arange(first, first + len(p)))
    return lengths[np.arange(len(p)), first + len(p) + np.arange(len(q))]


@functools.cache
def pairs(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Free places, exactly representable in float32: starts and goals (PAIRS, 2)."""
    points = environments.free_points(place(name).environment, RADIUS + 0.01, 2 * PAIRS, seed=3)
    return points[:PAIRS].astype(float), points[PAIRS:].astype(float)


@jax.jit
def lengths(tables: Navigation, starts, goals):
    def one(start, goal):
        return navigation.geodesic(tables, start, goal, navigation.to_goal(tables, goal))

    return jax.vmap(one)(starts, goals)


STRIDE, STRIDES = 0.1, 700


@jax.jit
def follow(tables: Navigation, starts, goals):
    """Positions (K, STRIDES, 2) of points that go straight to the next point, a stride at a time."""

    def one(start, goal):
        to_goal = navigation.to_goal(tables, goal)

        def stride(position, _):
            gap = navigation.next_point(tables, position, goal, to_goal) - position
            far = jnp.sqrt((gap * gap).sum())
            position = position + gap * (jnp.minimum(far, STRIDE) / jnp.maximum(far, 1e-6))
            return position, position

        return jax.lax.scan(stride, start, length=STRIDES)[1]

    return jax.vmap(one)(starts, goals)


def check_ways(here: Place, start, path, goal, exact, apart):
    """Ways end at the goal, keep so far off the obstacles [m], and are as long as they have to be."""
    path = np.concatenate([start[:, None], np.asarray(path, float)], 1)
    assert np.linalg.norm(path[:, -1] - goal, axis=1).max() < 1e-3
    assert ways_clearance(path[:, :-1], path[:, 1:], here.boxes).min() > apart
    walked = np.linalg.norm(np.diff(path, axis=1), axis=-1).sum(1)
    assert (walked <= 1.03 * exact + 0.1).all() and (walked >= 0.97 * exact - 0.1).all()


@pytest.mark.parametrize("name", ["warehouse", "yard"])
def test_geodesics_and_the_ways_that_follow_them(name):
    here, (start, goal) = place(name), pairs(name)
    exact = geodesics(here, start, goal)
    single = jnp.asarray(start, jnp.float32), jnp.asarray(goal, jnp.float32)
    ours = np.asarray(lengths(here.tables, *single), float)
    near = 0.1 if name == "warehouse" else 0.2  # in the yard, ways are short and bends are many
    np.testing.assert_allclose(ours, exact, rtol=0.02, atol=near)
    straight = np.linalg.norm(start - goal, axis=1)
    assert (exact > 1.02 * straight).sum() > 15  # there was something to go around
    check_ways(here, start, follow(here.tables, *single), goal, exact, 0.65 * RADIUS)
    back = np.asarray(lengths(here.tables, *single[::-1]), float)
    np.testing.assert_allclose(back, exact, rtol=0.02, atol=near)
    np.testing.assert_allclose(lengths(here.tables, single[0], single[0]), 0.0)


def test_tables_of_via_points():
    tables, boxes = place("warehouse").tables, place("warehouse").boxes
    via, edge, distance = (np.asarray(part, float) for part in (tables.via, tables.edge, tables.distance))
    assert clearance(via, boxes).min() > RADIUS
    np.testing.assert_allclose(distance, distance.T, rtol=1e-6)
    np.testing.assert_allclose(np.diag(distance), 0.0)
    np.testing.assert_allclose(dijkstra(np.where(np.isfinite(edge), edge, 0.0)), distance, rtol=1e-5)
    i, j = np.nonzero(np.triu(np.isfinite(edge)))
    assert ways_clearance(via[i], via[j], boxes).min() > RADIUS - 2e-3
    blocked = ~np.isfinite(edge) & ~np.eye(len(via), dtype=bool)
    assert (ways_clearance(*(via[k] for k in np.nonzero(blocked)), boxes) < RADIUS).all()
    assert clearance(tables.places, boxes).min() > RADIUS and len(tables.places) > 900


def test_towards_leads_to_every_node_of_the_graph():
    """By the cell's via point, and, once that is passed, by the one after it."""
    here = place("warehouse")
    tables, goals = (
        here.tables,
        annotation.read(environments.find("warehouse") / "graph.yaml", here.environment).position,
    )
    first, after = navigation.towards(tables, goals)
    starts = environments.free_points(here.environment, RADIUS + 0.01, 12, seed=5)
    none = tables.via.shape[0]

    @jax.jit
    def walk(starts):
        def one(start, node):
            def stride(position, _):
                cell = jnp.floor((position - tables.origin) / navigation.CELL).astype(jnp.int32)
                via = first[cell[0], cell[1], node].astype(jnp.int32)
                seen = jnp.minimum(via, none - 1)
                near = jnp.linalg.norm(tables.via[seen] - position) < navigation.AT
                via = jnp.where((via < none) & near, after[seen, node].astype(jnp.int32), via)
                aim = jnp.where(via < none, tables.via[jnp.minimum(via, none - 1)], goals[node])
                gap = aim - position
                far = jnp.sqrt((gap * gap).sum())
                position = position + gap * (jnp.minimum(far, STRIDE) / jnp.maximum(far, 1e-6))
                return position, position

            return jax.lax.scan(stride, start, length=STRIDES)[1]

        nodes = jnp.arange(goals.shape[0], dtype=jnp.int32)
        return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(starts, nodes)

    path = np.asarray(walk(jnp.asarray(starts))).reshape(-1, STRIDES, 2)
    start = np.repeat(starts.astype(float), len(goals), 0)
    goal = np.tile(np.asarray(goals, float), (len(starts), 1))
    ours = np.asarray(lengths(tables, jnp.asarray(start, jnp.float32), jnp.asarray(goal, jnp.float32)), float)
    check_ways(here, start, path, goal, ours, 0.02)  # cells are coarse, and people have forces


def test_clear_way_equals_samples_along_the_way():
    """Rectangles grown on each side, corners included; cases within a millimetre are left out."""
    here = place("yard")
    random = np.random.default_rng(4)
    p, q = random.uniform(-8, 8, (2, 400, 2)).astype(np.float32)
    q[:200] = p[:200] + (q[:200] - p[:200]) * 0.15
    q[-20:] = p[-20:]
    along = np.linspace(0, 1, 501)[:, None, None]
    for growth in (0.0, 0.2):
        boxes = here.environment.obstacles
        ours = jax.jit(jax.vmap(navigation.clear_way, (None, 0, 0, None)))(boxes, p, q, jnp.float32(growth))
        way = p.astype(float) + along * (q.astype(float) - p)
        over = (np.abs(locals_of(way, here.boxes)) - here.boxes[1] - growth).max(-1).min((0, 2))
        told = np.abs(over) > 2e-2  # samples are 4 cm apart at most
        np.testing.assert_array_equal(np.asarray(ours)[told], over[told] > 0)
        assert told.sum() > 350 and 0.2 < ours.mean() < 0.9


def test_sees_is_exact():
    here = place("yard")
    random = np.random.default_rng(6)
    p = random.uniform(-8, 8, (800, 2)).astype(np.float32)
    q = p + random.normal(0, 2, p.shape).astype(np.float32)
    exact = ways_clearance(p.astype(float), q.astype(float), here.boxes)
    ours = jax.jit(jax.vmap(navigation.sees, (None, 0, 0, None)))(here.environment.obstacles, p, q, RADIUS)
    told = np.abs(exact - RADIUS) > 1e-5
    np.testing.assert_array_equal(np.asarray(ours)[told], exact[told] >= RADIUS)
    assert 0.1 < ours.mean() < 0.9


WALLED_IN = [(0, 1.5, 1.6, 0.1, 0), (0, -1.5, 1.6, 0.1, 0), (1.5, 0, 0.1, 1.6, 0), (-1.5, 0, 0.1, 1.6, 0)]


def test_a_place_without_a_way_is_infinitely_far():
    tables = navigation.build(yard(WALLED_IN, (-4.0, -4.0, 4.0, 4.0)), RADIUS)
    outside = np.abs(np.asarray(tables.places)).max(1) > 1.6
    assert outside.all() and len(outside) > 500  # from where one can go anywhere else
    start, goal = jnp.array([[3.0, 0.5], [0.5, 0.3], [3.0, 0.5]]), jnp.array([[0.5, 0.0], [0.0, 3.0], [-3.0, 0.0]])
    found = np.asarray(lengths(tables, start, goal))
    np.testing.assert_array_equal(np.isinf(found), [True, True, False])
    assert 6.5 < found[2] < 9.0

    def onward(position, goal):
        return navigation.next_point(tables, position, goal, navigation.to_goal(tables, goal))

    following = np.asarray(jax.jit(jax.vmap(onward))(start, goal))
    np.testing.assert_array_equal(following[:2], goal[:2])  # straight on, for want of a way
    assert np.isfinite(following).all()
    first, after = navigation.towards(tables, goal)
    assert (np.asarray(first) >= 0).all() and (np.asarray(first) <= tables.via.shape[0]).all()
    assert (np.asarray(after) >= 0).all() and (np.asarray(after) <= tables.via.shape[0]).all()


def test_a_room_without_corners_to_go_around():
    """Nothing but outer walls: every way is straight."""
    walls = [(0, 4, 4, 0.1, 0), (0, -4, 4, 0.1, 0), (4, 0, 0.1, 4, 0), (-4, 0, 0.1, 4, 0)]
    tables = navigation.build(yard(walls, (-4.0, -4.0, 4.0, 4.0)), RADIUS)
    start, goal = jnp.array([[3.0, 0.5], [-2.0, -3.0]]), jnp.array([[-3.0, 0.5], [1.0, 1.0]])
    np.testing.assert_allclose(lengths(tables, start, goal), [6.0, 5.0], rtol=1e-5)
    first, _ = navigation.towards(tables, goal)
    assert (np.asarray(first)[4:-4, 4:-4] == tables.via.shape[0]).all()
    assert len(tables.places) > 500


def test_no_room_is_refused():
    with pytest.raises(ValueError, match="hardly any place"):
        navigation.build(yard([(0, 0, 8, 8, 0)]), 0.5)

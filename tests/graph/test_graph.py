"""The Behavior Graph: its file, its tables against networkx, its places, and how groups stand."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import yaml

from sean_jax.core.errors import FileError
from sean_jax.graph import FLOWS, BehaviorGraph, annotation
from sean_jax.graph.behavior_graph import routes
from sean_jax.graph.formation import MEASURED, formation, reach
from sean_jax.io import files
from sean_jax.world import environment
from support import programs
from support.graphs import assert_routes
from support.scenes import box, room

FILE = environment.find("warehouse") / "graph.yaml"


@pytest.fixture(scope="module")
def warehouse():
    return environment.load("warehouse")


@pytest.fixture(scope="module")
def graph(warehouse) -> BehaviorGraph:
    return annotation.read_graph(FILE, warehouse)


def test_warehouse_is_the_graph_of_the_paper(graph):
    names = graph.names
    assert len(names) == 15 and graph.waypoints.shape == (12,) and graph.groups.shape == (3,)
    assert np.asarray(graph.capacity)[np.asarray(graph.groups)].tolist() == [5, 3, 3]
    assert np.asarray(graph.seat_group).tolist() == [0] * 5 + [1] * 3 + [2] * 3
    weight = np.asarray(graph.edge_cost)
    assert np.isfinite(weight).sum() == 42 and np.array_equal(np.isfinite(weight), np.isfinite(weight).T)
    position = np.asarray(graph.position)
    ratio = weight / np.linalg.norm(position[:, None] - position, axis=-1).clip(1e-9)
    one_way = {(names[u], names[v]) for u, v in np.argwhere(np.isclose(ratio, 100, rtol=1e-4))}
    against = [("east_aisle_2", "east_aisle_1"), ("east_aisle_1", "tables_1"), ("tables_1", "tables_2")]
    assert one_way == {*against, ("east_aisle_1", "middle_aisle_1")}
    assert np.allclose(ratio[np.isfinite(ratio) & (ratio < 99)], 1, rtol=1e-4)
    flow = np.asarray(graph.flow)
    assert ((flow >= 0) == np.isfinite(weight)).all()
    assert {(names[u], names[v]) for u, v in np.argwhere(flow == FLOWS.index("backward"))} == one_way
    assert (flow.T[flow == FLOWS.index("backward")] == FLOWS.index("forward")).all()
    assert set(np.unique(flow)) == {-1, *(FLOWS.index(word) for word in ("medium", "forward", "backward"))}
    ids = {node["id"]: name for name, node in yaml.safe_load(FILE.read_text(encoding="utf-8"))["nodes"].items()}
    assert sorted(ids) == list(range(1, 16)) and ids[13] == "dock"
    assert np.all(np.asarray(graph.spawn) >= 0) and float(graph.spawn.sum()) == 55
    stay = np.asarray(graph.stay)
    assert np.all(stay[12:] == [5, 10]) and not stay[:12].any()
    for leaf in jax.tree.leaves(graph):
        assert not leaf.weak_type and leaf.dtype in (jnp.float32, jnp.int32, jnp.bool_)


def test_warehouse_routes_equal_networkx(graph):
    is_group = np.asarray(graph.is_group)
    assert_routes(np.asarray(graph.edge_cost), is_group, np.asarray(graph.cost), np.asarray(graph.next_hop))


def test_one_way_edges_are_walked_around(graph):
    index = graph.names.index
    step = np.asarray(graph.next_hop)
    assert step[index("tables_2"), index("tables_1")] == index("tables_1")
    assert step[index("tables_1"), index("tables_2")] != index("tables_2")
    assert step[index("dock"), index("tables_4")] == index("tables_1")


@pytest.mark.parametrize("seed", range(6))
def test_random_routes_equal_networkx(seed):
    generator = np.random.default_rng(seed)
    count = 9
    is_group = generator.random(count) < 0.35
    joined = np.triu(generator.random((count, count)) < 0.3, 1)
    pairs = np.array([(1, 1), (0.2, 0.2), (100, 100), (1, 100), (100, 1)], float)
    weight = np.full((count, count), np.inf)
    for u, v in np.argwhere(joined):
        there, back = pairs[generator.integers(5)] * generator.uniform(1, 9)
        weight[u, v], weight[v, u] = there, back
    assert_routes(weight, is_group, *routes(weight, is_group))


def test_groups_are_never_passed_and_coincident_nodes_are_joined():
    line = np.array([[np.inf, 1, 9], [1, np.inf, 1], [9, 1, np.inf]])
    cost, step = routes(line, np.array([False, True, False]))
    assert cost[0, 2] == 9 and step[0, 2] == 2
    line[0, 2] = line[2, 0] = np.inf
    cost, step = routes(line, np.array([False, True, False]))
    assert cost[0, 2] == np.inf and step[0, 2] == -1 and cost[0, 1] == 1 and cost[1, 2] == 1
    cost, step = routes(np.array([[0.0, 0.0], [0.0, 0.0]]), np.zeros(2, bool))
    assert cost[0, 1] < 1e-6 and step[0, 1] == 1


def test_places_are_free_and_seen_from_the_centre(graph, warehouse):
    places, position, radius = (np.asarray(leaf) for leaf in (graph.places, graph.position, graph.radius))
    assert places.shape == (15, 64, 2) and places.dtype == np.float32
    assert np.all(np.linalg.norm(places - position[:, None], axis=-1) <= radius[:, None] + 1e-4)
    boxes = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), warehouse.obstacles)
    for share in np.linspace(0, 1, 21):  # a disc of 0.25 m on its way from the centre to the place; all yaws are 0
        points = position[:, None] + share * (places - position[:, None])
        away = np.maximum(np.abs(points[:, :, None] - boxes.center) - boxes.half_extent, 0)
        assert np.linalg.norm(away, axis=-1).min() >= 0.25 - 1e-4
    # Half of a free disc's points are in the inner half of its area.
    free = np.asarray(programs.clearance(warehouse, graph.position)) > radius + 0.25
    inner = np.linalg.norm(places - position[:, None], axis=-1)[free] < radius[free, None] / np.sqrt(2)
    assert free.sum() >= 3 and abs(np.mean(inner) - 0.5) < 4 * 0.5 / np.sqrt(inner.size)
    assert len(np.unique(places.reshape(-1, 2), axis=0)) > 900


def test_places_in_a_narrow_spot_stay_near_the_centre(tmp_path):
    place = yard(tmp_path, [box((x, 0), (0.05, 4)) for x in (0.36, -0.36)])
    text = "".join(GOOD.splitlines(keepends=True)[:5]).replace("radius: 1", "radius: 3") + "edges: []\n"
    (tmp_path / "graph.yaml").write_text(text, encoding="utf-8")
    found = annotation.read_graph(tmp_path / "graph.yaml", place)
    assert np.abs(np.asarray(found.places)[0, :, 0]).max() <= 0.06 + 1e-4
    assert found.groups.shape == (0,) and found.seat_group.shape == (0,)
    seat, _, _, opening = formation(jax.random.key(0), found.capacity[:0], found.position[:0], found.seat_group)
    assert seat.shape == (0, 2) and opening.shape == (0, 2)


CORNER_BOX = [box((4, 4), (0.5, 0.5))]


def yard(folder: Path, boxes=CORNER_BOX):
    """A floor of 10 m with some boxes."""
    return environment.load(room(folder, (-5, -5, 5, 5), boxes, 3))


GOOD = """\
version: 1
c_min: 0.2
c_max: 100
nodes:
  gate: {kind: waypoint, position: [0, 0], radius: 1, spawn: 1}
  hall: {kind: waypoint, position: [-3, 0], radius: 1}
  dock: {kind: group, position: [0, -3], radius: 1, capacity: 3, stay: [5, 10]}
edges:
  - {between: [gate, hall], flow: forward}
  - {between: [hall, dock], weights: [0.2, 0.2]}
"""


def test_flows_and_weights_mean_the_papers_pairs(tmp_path):
    (tmp_path / "graph.yaml").write_text(GOOD, encoding="utf-8")
    found = annotation.read_graph(tmp_path / "graph.yaml", yard(tmp_path))
    length = np.sqrt(18)
    infinite = np.inf
    wanted = [[infinite, 3, infinite], [300, infinite, 0.2 * length], [infinite, 0.2 * length, infinite]]
    np.testing.assert_allclose(found.edge_cost, wanted, rtol=1e-6)
    assert [[FLOWS[flow] if flow >= 0 else None for flow in row] for row in np.asarray(found.flow)] == [
        [None, "forward", None],
        ["backward", None, "high"],
        [None, "high", None],
    ]
    words = {"medium": [1, 1], "high": [0.2, 0.2], "low": [100, 100], "forward": [1, 100], "backward": [100, 1]}
    edges = [annotation.Edge(between=("gate", "hall"), flow=word) for word in words]
    whole = files.load(tmp_path / "graph.yaml", annotation.Annotation)
    assert [whole.flow_of(edge) for edge in edges] == list(words)
    by_weights = [annotation.Edge(between=("gate", "hall"), weights=tuple(pair)) for pair in words.values()]
    assert [whole.flow_of(edge) for edge in by_weights] == list(words)
    for pair, nearest in (((0.9, 1.2), "medium"), ((30.0, 0.9), "backward"), ((40.0, 900.0), "low")):
        edge = annotation.Edge(between=("gate", "hall"), weights=pair)
        assert whole.flow_of(edge) == nearest and whole.factors_of(edge) == pair
    assert [list(whole.flow_factors()[whole.flow_of(edge)]) for edge in edges] == list(words.values())


@pytest.mark.parametrize(
    ("old", "new", "at", "message"),
    [
        ("[hall, dock]", "[hall, dcok]", "dcok", "edges[1].between[1]: there is no node 'dcok'; did you mean 'dock'?"),
        ("[hall, dock]", "[hall, x]", "x]", "edges[1].between[1]: there is no node 'x'; add it to nodes or remove"),
        ("[gate, hall]", "[dock, hall]", "[hall, dock]", "edges[1].between: edges[0] already joins these two; remove"),
        ("[gate, hall]", "[gate, gate]", "[gate, gate]", "edges[0].between: the edge leads from 'gate' to itself"),
        ("capacity: 3, ", "", "dock: {", "nodes.dock.capacity: is missing; a group needs one, such as 'capacity: 4'."),
        (", stay: [5, 10]", "", "dock: {", "nodes.dock.stay: is missing; a group needs one in seconds, such as"),
        ("[5, 10]", "[10, 5]", "[10, 5]", "nodes.dock.stay: [10, 5] is not ordered; give the shorter time first."),
        ("radius: 1}", "radius: 1, capacity: 29}", "29}", "nodes.hall.capacity: only a group has one and this is a"),
        ("[0.2, 0.2]", "[1, 5e-4]", "5e-4]", "edges[1].weights[1]: 0.0005 is less than 0.001, the least allowed."),
        ("capacity: 3", "weight: 2, capacity: 3", "2, cap", "nodes.dock.weight: only a waypoint has one and this is a"),
        ("radius: 1}", "radius: 1, weight: -1}", "-1}", "nodes.hall.weight: -1 is less than 0, the least allowed."),
        ("flow: forward", "flow: low, weights: [1, 1]", "[1, 1]", "edges[0].weights: flow is given as well; remove"),
        ("c_min: 0.2", "c_min: -7", "-7", "c_min: -7 is less than 0.001, the least allowed."),
        ("c_min: 0.2", "c_min: 1", "1\nc_max", "c_min: 1 is not less than 1."),
        ("c_max: 100", "c_max: 1", "1\nnodes", "c_max: 1 is not greater than 1."),
        ("capacity: 3", "capacity: 1", "1, stay", "nodes.dock.capacity: 1 is less than 2, the least allowed."),
        ("radius: 1}", "radius: 0}", "0}", "nodes.hall.radius: 0 is less than 0.001, the least allowed."),
        ("[hall, dock]", "[dock, dock]", "dock: {", "nodes.dock: no path over waypoints leads here from 'gate'"),
        ("[gate, hall]", "[gate, dock]", "hall: {", "nodes.hall: no path over waypoints leads here from 'gate'"),
        ("spawn: 1", "spawn: 0", "nodes", "nodes: no spawn is 0.001 or more; give at least one node 'spawn: 1'."),
        ("spawn: 1", "spawn: -1", "-1}", "nodes.gate.spawn: -1 is less than 0, the least allowed."),
        ("[-3, 0]", "[4, 3.8]", "[4, 3.8]", "nodes.hall.position: [4, 3.8] is inside an obstacle; move it by 0.60 m"),
        ("[-3, 0]", "[3.4, 4]", "[3.4, 4]", "nodes.hall.position: [3.4, 4] is 0.10 m from an obstacle, less than 0.3"),
        ("[-3, 0]", "[-4.9, 0]", "[-4.9, 0]", "nodes.hall.position: [-4.9, 0] is 0.10 m from an edge of the floor"),
        ("[-3, 0]", "[-6, 0]", "[-6, 0]", "nodes.hall.position: [-6, 0] is not on the floor [-5, -5, 5, 5]; move it."),
        ("[0, -3]", "[0, -4.5]", "[0, -4.5]", "nodes.dock.position: [0, -4.5] has 0.50 m of room where a group of 3"),
        ("kind: group", "kind: gruop", "gruop", "nodes.dock.kind: 'gruop' is not one of waypoint, group; did you mean"),
        ("flow: forward", "flow: fast", "fast", "edges[0].flow: 'fast' is not one of medium, high, low, forward, back"),
        ("version: 1", "version: 2", "2\nc_min", "version: 2 is not one of 1."),
        ("flow: forward", "folw: forward", "folw", "edges[0].folw: 'folw' is not a known key; did you mean 'flow'?"),
    ],
)
def test_mistakes_are_named_with_place_and_cure(tmp_path, old, new, at, message):
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    (tmp_path / "graph.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FileError) as caught:
        annotation.read_graph(tmp_path / "graph.yaml", yard(tmp_path))
    before = text[: text.index(at)]
    place = f"{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
    assert f"{tmp_path.name}/graph.yaml:{place}: {message}" in str(caught.value)
    assert all(line.endswith((".", "?")) for line in str(caught.value).splitlines())


def test_graphs_without_waypoints_are_refused(tmp_path):
    text = GOOD.replace("kind: waypoint", "kind: group, capacity: 2, stay: [1, 2]")
    (tmp_path / "graph.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="4:1: nodes: none is a waypoint"):
        annotation.read_graph(tmp_path / "graph.yaml", yard(tmp_path))


def test_group_between_two_parts_joins_them_for_nobody(tmp_path):
    text = GOOD.replace("[gate, hall]", "[gate, dock]")
    (tmp_path / "graph.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="no path over waypoints leads here"):
        annotation.read_graph(tmp_path / "graph.yaml", yard(tmp_path))


SIZES = (2, 3, 4, 5, 6, 8)
SEATS = np.repeat(np.arange(len(SIZES)), SIZES)


@pytest.fixture(scope="module")
def formations():
    """2000 formations of groups of several sizes, and their centres."""
    center = jnp.asarray(np.arange(12, dtype=np.float32).reshape(6, 2) - 4)
    capacity, seat_group = jnp.asarray(SIZES, jnp.int32), jnp.asarray(SEATS, jnp.int32)
    draw = jax.jit(jax.vmap(lambda key: formation(key, capacity, center, seat_group)))
    return (*(np.asarray(part) for part in draw(jax.random.split(jax.random.key(3), 2000))), np.asarray(center))


def test_formation_keeps_distances(formations):
    seat, _, radius, opening, center = formations
    for group, size in enumerate(SIZES):
        points = np.concatenate([seat[:, SEATS == group], opening[:, group : group + 1]], 1)
        apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1) + 9 * np.eye(size + 1)
        assert apart.min() >= 0.5
        assert np.linalg.norm(points - center[group], axis=-1).max() <= reach(size)
        np.testing.assert_allclose(
            np.linalg.norm(opening[:, group] - center[group], axis=-1), radius[:, group], rtol=1e-4
        )


def test_formation_has_the_measured_radius_and_neighbours(formations):
    seat = formations[0]
    nearest = {2: 0.90, 3: 0.82, 4: 0.78, 5: 0.76, 6: 0.72}
    for group, size in enumerate(SIZES):
        if size not in MEASURED:
            continue
        mean, deviation = MEASURED[size]
        points = seat[:, SEATS == group]
        from_centroid = np.linalg.norm(points - points.mean(1, keepdims=True), axis=-1).mean(1)
        assert abs(from_centroid.mean() - mean) < 0.03
        assert np.all(np.abs(from_centroid - mean) < deviation + 0.12)
        assert 0.3 * deviation < from_centroid.std() < deviation
        apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1) + 9 * np.eye(size)
        assert abs(apart.min(-1).mean() - nearest[size]) < 0.1


def test_formation_is_differentiable_and_follows_its_key(graph):
    capacity, center, seats = graph.capacity[graph.groups], graph.position[graph.groups], graph.seat_group
    shape = jax.jit(lambda key, at: formation(key, capacity, at, seats))
    first, again, other = (shape(jax.random.key(seed), center) for seed in (0, 0, 1))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.allclose(first[0], other[0])
    slope = jax.jit(jax.grad(lambda at: sum(part.sum() for part in shape(jax.random.key(0), at)[:2])))
    np.testing.assert_allclose(slope(center), np.array([[5, 5], [3, 3], [3, 3]], np.float32), atol=1e-5)


def test_whole_groups_fit_in_the_warehouse(graph, warehouse):
    """Every seat is clear of obstacles, by MuJoCo's own distance from a ray straight down."""
    model = mujoco.MjModel.from_xml_path(str(environment.find("warehouse") / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "floor")
    capacity, center = graph.capacity[graph.groups], graph.position[graph.groups]
    draw = jax.jit(jax.vmap(lambda key: formation(key, capacity, center, graph.seat_group)))
    hit = np.zeros(1, np.int32)
    for x, y in np.asarray(draw(jax.random.split(jax.random.key(5), 20))[0]).reshape(-1, 2):
        mujoco.mj_ray(model, data, np.array([x, y, 10.0]), np.array([0.0, 0.0, -1.0]), None, 1, -1, hit, None)
        assert hit[0] == floor

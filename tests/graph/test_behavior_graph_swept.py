"""The Behavior Graph as arrays, and its costs under way, against loops over drawn graphs in double precision."""

import itertools
import json
import math

import jax
import jax.numpy as jnp
import networkx
import numpy as np
import pytest
import yaml

from sean_jax.graph import annotation, formation
from sean_jax.graph.behavior_graph import (
    FLOWS,
    MIN_AREA,
    add_congestion_cost,
    cheapest_paths,
    edge_areas,
    edge_densities,
    hop_log_chances,
    rerouted,
)
from sean_jax.world import environment

BACK = {"forward": "backward", "backward": "forward"}


def words(seed: int) -> dict:
    """An annotation of 8 waypoints and 3 groups in any order; groups hang on one or two waypoints."""
    random = np.random.default_rng(seed)
    kinds = random.permutation(["waypoint"] * 8 + ["group"] * 3)
    nodes, names = {}, []
    for k, kind in enumerate(kinds):
        node = {
            "kind": str(kind),
            "position": tuple(random.uniform(-9, 9, 2).round(3).tolist()),
            "radius": float(random.uniform(0.4, 1.5)),
        }
        if kind == "group":
            low = float(random.uniform(1, 9))
            node |= {"capacity": int(random.integers(2, 6)), "stay": (low, low + float(random.uniform(0, 9)))}
        else:
            node |= {"spawn": float(random.uniform(0, 3))} | (
                {"weight": float(random.uniform(0.1, 4))} if random.random() < 0.6 else {}
            )
        nodes[f"n{k}"] = node
        names.append(f"n{k}")
    ways = [name for name in names if nodes[name]["kind"] == "waypoint"]
    pairs = {(a, b) for a, b in zip(ways, ways[1:], strict=False)}
    pairs |= {tuple(random.permutation(ways)[:2].tolist()) for _ in range(4)}
    pairs = {pair for pair in pairs if pair[::-1] not in pairs or pair < pair[::-1]}
    pairs |= {(str(random.choice(ways)), name) for name in names if name not in ways}
    edges = []
    for a, b in sorted(pairs):
        how = random.integers(3)
        more = {"flow": str(random.choice(FLOWS))} if how == 0 else {}
        more = {"weights": tuple(random.uniform(0.3, 30.0, 2).tolist())} if how == 1 else more
        edges.append({"between": (a, b)} | more)
    return {"version": 1, "c_min": 0.2, "c_max": 40.0, "nodes": nodes, "edges": edges}


def factors(flow: str) -> tuple[float, float]:
    """<c_uv, c_vu> of the paper."""
    return {"medium": (1, 1), "high": (0.2, 0.2), "low": (40.0, 40.0), "forward": (1, 40.0), "backward": (40.0, 1)}[
        flow
    ]


@pytest.mark.parametrize("seed", range(6))
def test_arrays_are_what_is_written(seed):
    given = words(seed)
    graph = jax.tree.map(np.asarray, annotation.build_graph(annotation.Annotation.model_validate(given), None))
    nodes, names = list(given["nodes"].values()), list(given["nodes"])
    groups = [k for k, node in enumerate(nodes) if node["kind"] == "group"]
    assert graph.names == tuple(names) and graph.groups.tolist() == groups
    assert graph.waypoints.tolist() == [k for k in range(len(nodes)) if k not in groups]
    np.testing.assert_allclose(graph.position, [node["position"] for node in nodes], rtol=1e-6)
    np.testing.assert_array_equal(graph.places, graph.position[:, None])
    np.testing.assert_allclose(graph.radius, [node["radius"] for node in nodes], rtol=1e-6)
    np.testing.assert_array_equal(graph.is_group, [k in groups for k in range(len(nodes))])
    np.testing.assert_array_equal(graph.capacity, [node.get("capacity", 0) for node in nodes])
    np.testing.assert_allclose(graph.stay, [node.get("stay", (0, 0)) for node in nodes], rtol=1e-6)
    np.testing.assert_allclose(graph.spawn, [node.get("spawn", 0) for node in nodes], rtol=1e-6)
    weight = [0.0 if node["kind"] == "group" else node.get("weight", 1.0) for node in nodes]
    np.testing.assert_allclose(graph.weight, weight, rtol=1e-6)
    seats = [(number, node) for number, node in enumerate(groups) for _ in range(nodes[node]["capacity"])]
    assert list(zip(graph.seat_group.tolist(), graph.seat_node.tolist(), strict=True)) == seats
    joined = np.zeros(graph.edge_cost.shape, bool)
    for edge in given["edges"]:
        a, b = (names.index(name) for name in edge["between"])
        apart = math.dist(nodes[a]["position"], nodes[b]["position"])
        if "weights" in edge:
            logs = {flow: math.dist(np.log(edge["weights"]), np.log(factors(flow))) for flow in FLOWS}
            flow, (there, back) = min(logs, key=logs.__getitem__), edge["weights"]
        else:
            flow = edge.get("flow", "medium")
            there, back = factors(flow)
        assert graph.edge_cost[a, b] == pytest.approx(apart * there) and graph.edge_cost[b, a] == pytest.approx(
            apart * back
        )
        assert FLOWS[graph.flow[a, b]] == flow and FLOWS[graph.flow[b, a]] == BACK.get(flow, flow)
        joined[a, b] = joined[b, a] = True
    assert np.isinf(graph.edge_cost[~joined]).all() and (graph.flow[~joined] == -1).all()
    assert_cheapest(graph)


def test_places_are_uniform_on_the_disc_of_a_node():
    """Where nothing is in the way: as many on each side, and half of them beyond the radius that halves the area."""
    place, radius = environment.load("lab"), 0.5
    clear = np.array([[0.0, 0.0]])
    points = annotation._draw_places(place, clear, np.array([radius]), 0)[0] - clear[0]
    away, angle = np.hypot(*points.T), np.arctan2(*points.T[::-1])
    assert away.max() <= radius and 0.3 < (away > radius / np.sqrt(2)).mean() < 0.7
    assert (np.histogram(angle, 4, (-np.pi, np.pi))[0] > len(points) / 10).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_written_annotation_is_read_as_it_was(seed):
    """All fields of every node and edge, groups' seats and stays included."""
    given = json.loads(json.dumps(words(seed)), parse_float=lambda text: round(float(text), 6))
    again = yaml.safe_load(annotation.to_yaml(annotation.Annotation.model_validate(given)))
    for edge in given["edges"]:
        if "weights" not in edge:
            edge.setdefault("flow", "medium")
    assert annotation.Annotation.model_validate(again) == annotation.Annotation.model_validate(given)
    groups = {name: node for name, node in again["nodes"].items() if node["kind"] == "group"}
    assert len(groups) == 3 and all({"capacity", "stay"} <= set(node) for node in groups.values())
    assert not any({"capacity", "stay"} & set(node) for name, node in again["nodes"].items() if name not in groups)


def assert_cheapest(graph) -> None:
    """Costs are networkx', and the next node lies on a way of that cost."""
    size, is_group = len(graph.is_group), np.asarray(graph.is_group)
    edge_cost, cost, hop = (np.asarray(part, float) for part in (graph.edge_cost, graph.cost, graph.next_hop))
    whole = networkx.DiGraph()
    whole.add_nodes_from(range(size))
    whole.add_weighted_edges_from((u, v, edge_cost[u, v]) for u, v in np.argwhere(np.isfinite(edge_cost)))
    for u, h in itertools.product(range(size), repeat=2):
        allowed = whole.subgraph([node for node in whole if node in (u, h) or not is_group[node]])
        way = networkx.single_source_dijkstra_path_length(allowed, u)
        assert cost[u, h] == pytest.approx(way.get(h, np.inf), rel=1e-4)
        if u == h:
            assert hop[u, h] == u
        elif np.isfinite(cost[u, h]):
            onward = int(hop[u, h])
            assert edge_cost[u, onward] + cost[onward, h] == pytest.approx(cost[u, h], rel=1e-4)
            assert onward == h or not is_group[onward]
        else:
            assert hop[u, h] == -1


@pytest.mark.parametrize("seed", range(3))
def test_costs_under_way(seed):
    """Paths inside jit, other positions and factors, areas, densities, and what they cost."""
    random = np.random.default_rng(seed)
    graph = annotation.build_graph(annotation.Annotation.model_validate(words(seed)), None)
    size = len(graph.names)
    known = jax.tree.map(lambda leaf: np.asarray(leaf, float), graph)
    cost, hop = jax.jit(cheapest_paths)(graph.edge_cost, graph.is_group)
    assert_cheapest(graph.replace(cost=cost, next_hop=hop))

    moved = (known.position + random.normal(0, 0.5, (size, 2))).astype(np.float32)
    factor = random.uniform(0.5, 2.0, (size, size)).astype(np.float32)
    other = jax.jit(rerouted)(graph, jnp.asarray(moved), jnp.asarray(factor))
    lengths = [np.hypot(*(p[:, None] - p[None]).transpose(2, 0, 1)) + np.eye(size) for p in (known.position, moved)]
    np.testing.assert_allclose(other.edge_cost, known.edge_cost * factor * lengths[1] / lengths[0], rtol=1e-4)
    np.testing.assert_allclose(other.places - graph.places, (moved - known.position)[:, None], atol=1e-5)
    np.testing.assert_array_equal(other.position, moved)
    assert_cheapest(other)
    np.testing.assert_allclose(
        rerouted(graph, factor=jnp.asarray(factor)).edge_cost, known.edge_cost * factor, rtol=1e-5
    )
    np.testing.assert_allclose(rerouted(graph).edge_cost, known.edge_cost, rtol=1e-6)

    people = 40
    origin, target = random.integers(0, size, (2, people))
    walking = random.random(people) < 0.7
    densities = np.asarray(
        edge_densities(graph, *(jnp.asarray(part, jnp.int32) for part in (origin, target)), jnp.asarray(walking))
    )
    areas = np.asarray(edge_areas(graph))
    for a, b in itertools.product(range(size), repeat=2):
        length = math.dist(known.position[a], known.position[b])
        area = max(length * (known.radius[a] + known.radius[b]), MIN_AREA)
        between = sum(
            {int(o), int(h)} == {a, b} and o != h and w for o, h, w in zip(origin, target, walking, strict=True)
        )
        assert areas[a, b] == pytest.approx(area, rel=1e-5) and MIN_AREA == 1.0
        assert densities[a, b] == pytest.approx(between / area, rel=1e-5)
    assert (densities > 0).any()
    full = add_congestion_cost(graph, jnp.asarray(densities), jnp.float32(2.5))
    np.testing.assert_allclose(full.edge_cost, known.edge_cost * (1 + 2.5 * densities), rtol=1e-5)
    assert_cheapest(full)


@pytest.mark.parametrize("temperature", [0.5, 5.0])
def test_chances_of_the_next_node_are_a_logit(temperature):
    graph = annotation.build_graph(annotation.Annotation.model_validate(words(9)), None)
    found = np.asarray(jax.jit(hop_log_chances)(graph.edge_cost, graph.cost, graph.is_group, temperature), float)
    edge_cost, cost, is_group = (np.asarray(part, float) for part in (graph.edge_cost, graph.cost, graph.is_group))
    for u, h in itertools.product(range(len(graph.names)), repeat=2):
        costs = {
            v: edge_cost[u, v] + cost[v, h]
            for v in range(len(graph.names))
            if u != h and np.isfinite(edge_cost[u, v] + cost[v, h]) and (v == h or not is_group[v])
        }
        least = min(costs.values(), default=0.0)
        total = sum(math.exp((least - each) / temperature) for each in costs.values())
        for v in range(len(graph.names)):
            if v in costs:
                expected = (least - costs[v]) / temperature - math.log(total)
                assert found[u, h, v] == pytest.approx(expected, abs=2e-4 * (1 + abs(expected)))
            else:
                assert found[u, h, v] == pytest.approx(-1e30)


def test_rings_are_as_wide_as_measured():
    """Of n people on n + 1 places, the mean distance from their own centroid is the data's."""
    for size in range(1, formation.MAX_SIZE + 1):
        angle = [2 * math.pi * k / (size + 1) for k in range(1, size + 1)]
        x, y = (np.mean([turn(a) for a in angle]) for turn in (math.cos, math.sin))
        share = np.mean([math.hypot(math.cos(a) - x, math.sin(a) - y) for a in angle]) if size > 1 else 1.0
        mean, spread = formation.MEASURED.get(size, (0.26 + 0.1 * size, 0.18))
        assert formation.MEAN[size] == pytest.approx(mean / share) and formation.DEVIATION[size] == pytest.approx(
            spread / share
        )
        assert formation.reach(size) == pytest.approx((mean + spread) / share + 0.12)
    assert formation.reach(99) == formation.reach(32)
    assert formation.MEASURED == {2: (0.45, 0.14), 3: (0.58, 0.19), 4: (0.67, 0.2), 5: (0.77, 0.2), 6: (0.83, 0.17)}


def test_seats_follow_their_draws():
    """Each group's seats are on its own ring, in places 1 to n, turned from the center by angles of both signs."""
    capacity, center = jnp.asarray([2, 5, 3], jnp.int32), jnp.asarray([[0.0, 0.0], [20.0, 0.0], [0.0, 20.0]])
    seat_group = jnp.asarray([0, 0, 1, 1, 1, 1, 1, 2, 2, 2], jnp.int32)
    draw = jax.jit(jax.vmap(formation.formation, in_axes=(0, None, None, None)))
    position, heading, radius, opening = (
        np.asarray(part, float)
        for part in draw(jax.random.split(jax.random.key(1), 3000), capacity, center, seat_group)
    )
    turn = np.arctan2(*np.moveaxis(opening - np.asarray(center), -1, 0)[::-1])
    np.testing.assert_allclose(np.hypot(*np.moveaxis(opening - np.asarray(center), -1, 0)), radius, rtol=1e-4)
    bins = np.histogram(turn, 8, (-np.pi, np.pi))[0]
    assert bins.min() > 0.9 * bins.mean() and bins.max() < 1.1 * bins.mean()
    places = []
    for seat, group in enumerate(np.asarray(seat_group)):
        gap = position[:, seat] - np.asarray(center)[group]
        own, size = np.arctan2(gap[:, 1], gap[:, 0]), int(capacity[group])
        place = ((own - turn[:, group]) % (2 * np.pi)) / (2 * np.pi / (size + 1))
        places.append(np.rint(place).astype(int))
        there = turn[:, group] + places[-1] * 2 * np.pi / (size + 1)
        ring = radius[:, group, None] * np.stack([np.cos(there), np.sin(there)], -1)
        off = np.hypot(*(gap - ring).T)
        room = np.clip(radius[:, group] * math.sin(math.pi / (size + 1)) - 0.25, 0.0, 0.12)
        assert (off <= room + 1e-4).all() and off.max() > 0.8 * 0.12
        side = np.arctan2(heading[:, seat, 1], heading[:, seat, 0]) - np.arctan2(-gap[:, 1], -gap[:, 0])
        side = np.rad2deg((side + np.pi) % (2 * np.pi) - np.pi)
        for limit, share in ((30, 0.5), (45, 0.68), (90, 0.91)):
            assert (np.abs(side) <= limit).mean() == pytest.approx(share, abs=0.04)
        assert (side > 0).mean() == pytest.approx(0.5, abs=0.04)
    for group in range(3):
        own = np.stack([place for place, g in zip(places, np.asarray(seat_group), strict=True) if g == group])
        np.testing.assert_array_equal(np.sort(own, 0), np.arange(1, len(own) + 1)[:, None] + np.zeros_like(own))
        assert (own[0] == 1).mean() == pytest.approx(1 / len(own), abs=0.04)
    for group, size in enumerate(np.asarray(capacity)):
        mean, spread = formation.MEAN[size], formation.DEVIATION[size]
        least = np.clip((0.275 / math.sin(math.pi / (size + 1)) - mean) / spread, -1.0, 0.999)
        assert radius[:, group].min() >= mean + least * spread - 1e-3 and radius[:, group].max() <= mean + spread + 1e-3
        assert np.ptp(radius[:, group]) > 0.9 * (1 - least) * spread

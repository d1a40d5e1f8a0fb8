"""Tastes on trips: people judge routes differently, and no route by taste is absurd."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.core.padding import common_sizes, pad
from sean_jax.graph import annotation, rerouted
from sean_jax.graph.behavior_graph import MAX_DETOUR, add_congestion_cost, add_tastes, costs_of_tastes, routes
from sean_jax.people.behaviors import graph_choices, trips
from sean_jax.simulation.scenario import direct_pedestrians
from sean_jax.world import environment as environments
from sean_jax.world import generated
from support import programs


def fork(detour: float):
    """A graph with two routes from a to d, over b and over c, and the second is so much longer."""
    half = 5.0 * detour
    places = {
        "a": (-5.0, 0.0),
        "b": (0.0, 5.0),
        "c": (0.0, -np.sqrt((half * np.sqrt(2.0)) ** 2 - 25.0)),
        "d": (5.0, 0.0),
    }
    nodes = {name: {"kind": "waypoint", "position": at, "radius": 0.6, "spawn": 1} for name, at in places.items()}
    edges = [{"between": pair} for pair in (("a", "b"), ("b", "d"), ("a", "c"), ("c", "d"))]
    made = {"version": 1, "c_min": 0.2, "c_max": 100, "nodes": nodes, "edges": edges}
    return annotation.build_graph(annotation.Annotation.model_validate(made), None)


@pytest.mark.parametrize(("detour", "nodes"), [(1.0, {1, 2}), (1.01, {1, 2}), (1.4, {1})])
@pytest.mark.parametrize("spread", [0.1, 1.0])
def test_tastes_use_both_of_two_routes_only_if_they_are_nearly_equal(detour, nodes, spread):
    tastes = add_tastes(fork(detour), spread).tastes
    assert set(np.asarray(tastes.next_hop)[:, 0, 3].tolist()) == nodes


def route_costs(edge_cost: np.ndarray, next_hop: np.ndarray, is_group: np.ndarray) -> np.ndarray:
    """(M, M) costs of the routes from row to column; fails where one does not end, or passes through a group."""
    count = len(edge_cost)
    total = np.zeros((count, count))
    for source in range(count):
        for goal in range(count):
            node = source
            for _ in range(count):
                if node == goal or next_hop[node, goal] < 0:
                    break
                onward = next_hop[node, goal]
                assert onward == goal or not is_group[onward]
                total[source, goal] += edge_cost[node, onward]
                node = onward
            assert node == goal or next_hop[source, goal] < 0
            total[source, goal] = total[source, goal] if node == goal else np.inf
    return total


def assert_reasonable(graph):
    """All routes by taste end, pass through no group, and cost little more than the cheapest, which the first are."""
    edge_cost, is_group = np.asarray(graph.edge_cost, float), np.asarray(graph.is_group)
    cheapest, _ = routes(edge_cost, is_group)
    reached = np.isfinite(cheapest)
    costs = []
    for next_hop in np.asarray(graph.tastes.next_hop):
        cost = route_costs(edge_cost, next_hop, is_group)
        assert (np.isfinite(cost) == reached).all()
        assert (cost[reached] <= MAX_DETOUR * cheapest[reached] + 1e-3).all()
        costs.append(cost)
    np.testing.assert_allclose(costs[0][reached], cheapest[reached], rtol=1e-5)
    factor = np.asarray(graph.tastes.factor)
    np.testing.assert_allclose(factor, np.swapaxes(factor, 1, 2))
    np.testing.assert_allclose(factor[1:3] * factor[3:5], 1.0, rtol=1e-5)
    return np.stack(costs)[:, reached] / np.maximum(cheapest[reached], 1e-9)


FLOORS = "lab", "warehouse", "outdoor", "worlds:lobby:1:4"


@pytest.fixture(scope="module")
def graphs():
    """Name of a floor -> its graph with trips, whose tastes differ as much as they can."""
    read = {}
    for name in FLOORS:
        (folder,) = generated.find(name)
        graph = annotation.read_graph(folder / "graph.yaml", environments.load(folder), trips=True)
        read[name] = add_tastes(graph, 1.0)
    return read


@pytest.mark.parametrize("name", FLOORS)
def test_routes_by_taste_are_not_absurd(graphs, name):
    ratio = assert_reasonable(graphs[name])
    assert ratio.max() > 1.0 + 1e-3  # some differ
    again = add_tastes(graphs[name], 1.0)
    assert all((a == b).all() for a, b in zip(*map(jax.tree.leaves, (again, graphs[name])), strict=True))


@pytest.mark.parametrize("name", ["lab", "warehouse"])
def test_so_are_those_around_crowds_and_of_other_costs(graphs, name):
    graph = graphs[name]
    generator = np.random.default_rng(2)
    density = jnp.asarray(generator.uniform(0.0, 0.3, graph.edge_cost.shape), jnp.float32)
    factor = jnp.asarray(generator.uniform(0.3, 3.0, graph.edge_cost.shape), jnp.float32)
    assert_reasonable(programs.jit_once(add_congestion_cost)(graph, density, jnp.float32(20.0)))
    assert_reasonable(jax.jit(lambda factor: rerouted(graph, factor=factor))(factor))


def test_padding_has_no_effect_on_tastes(graphs):
    small, large = (replace(graphs[name], names=()) for name in ("lab", "warehouse"))
    padded = pad(small, common_sizes([small, large]))
    nodes = small.radius.shape[0]
    assert padded.tastes.next_hop.shape == large.tastes.next_hop.shape
    assert (np.asarray(padded.tastes.next_hop)[:, :nodes, :nodes] == np.asarray(small.tastes.next_hop)).all()
    again = jax.jit(rerouted)(jax.tree.map(jnp.asarray, padded))
    cost = np.asarray(again.tastes.cost)
    np.testing.assert_allclose(cost[:, :nodes, :nodes], small.tastes.cost, rtol=1e-5)
    assert (np.asarray(again.tastes.next_hop)[:, :nodes, nodes:] == -1).all()


def memory_of(graph, taste: np.ndarray, node: np.ndarray, goal: np.ndarray):
    """The memory of people with tastes on the way from nodes to goals."""
    node, goal, taste = (jnp.asarray(row, jnp.int32) for row in (node, goal, taste))
    none, points = jnp.zeros_like(node), jnp.zeros((len(node), 2))
    memory = graph_choices.GraphMemory(goal, node, node, points, none - 1, none, points[:0], points[:0])
    begun = trips.begin(graph, memory, len(node), jax.random.key(0))
    return memory._replace(trip=begun._replace(taste=taste))


def test_people_take_the_way_of_their_taste_and_at_low_temperature_hardly_another(graphs):
    graph = graphs["warehouse"]
    count, n_tastes = graph.radius.shape[0], graph.tastes.factor.shape[0]
    taste, node, goal = (part.ravel() for part in np.meshgrid(range(n_tastes), range(count), range(count)))
    taste, node, goal = (part[node != goal] for part in (taste, node, goal))
    memory = memory_of(graph, taste, node, goal)
    wanted = np.asarray(graph.tastes.next_hop)[taste, node, goal]
    assert (wanted != np.asarray(graph.next_hop)[node, goal]).any()
    assert (np.asarray(graph_choices.next_nodes(graph, memory, memory.hop, memory.goal)) == wanted).all()
    chances = jax.jit(graph_choices._hop_log_chances)
    log_chance = chances(graph, memory, memory.hop, memory.goal, jnp.float32(1e-3))
    assert (np.argmax(log_chance, axis=1) == wanted).all()
    directions = jax.jit(trips.bearings)(graph).to_waypoints
    way = np.asarray(graph.position)[wanted] - np.asarray(graph.position)[node]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    column = {waypoint: index for index, waypoint in enumerate(np.asarray(graph.waypoints).tolist())}
    to_waypoint = np.isin(goal, list(column))
    columns = np.array([column[waypoint] for waypoint in goal[to_waypoint]])
    found = np.asarray(directions)[taste[to_waypoint], node[to_waypoint], columns]
    np.testing.assert_allclose(found, way[to_waypoint], atol=1e-5)


def test_the_chance_of_a_way_has_a_derivative_by_costs_of_edges():
    graph = add_tastes(fork(1.0), 0.1)

    def chance(factor):
        moved = rerouted(graph, factor=jnp.ones((4, 4)).at[0, 1].set(factor))
        memory = memory_of(moved, np.arange(5), np.zeros(5), np.full(5, 3))
        log_chance = graph_choices._hop_log_chances(moved, memory, memory.hop, memory.goal, jnp.float32(1.0))
        return jnp.exp(log_chance[:, 1])

    slope = jax.jit(jax.jacfwd(chance))(1.0)
    low, high = np.asarray(jax.jit(jax.vmap(chance))(jnp.array([0.99, 1.01])))
    central = (high - low) / 0.02
    assert (np.asarray(slope) < -0.5).all()
    np.testing.assert_allclose(slope, central, rtol=1e-2)


def test_only_people_on_trips_have_tastes():
    for options in ({"routing": "whole"}, {"taste": 0.0}):
        scenario = sean_jax.make("lab", people=3, dynamics="twin", **options)
        assert scenario.behavior.data.graph.tastes is None
        begin = jax.eval_shape(lambda key, scenario=scenario: sean_jax.reset(scenario, key), jax.random.key(0))
        assert graph_choices.taste_of(begin.memory) is None
    with pytest.raises(ValueError, match="taste: .* must be from 0 to 1"):
        sean_jax.make("lab", taste=-0.1)


def test_people_keep_their_taste_and_walk_by_it():
    scenario = sean_jax.make("warehouse", people=40, task="random_ab_nav", dynamics="twin", taste=1.0)
    graph = scenario.behavior.data.graph

    def walk(key):
        def one(state, _):
            key = jax.random.fold_in(state.streams.people, state.tick)
            after = direct_pedestrians(scenario, state, key)
            people = after.pedestrians
            position = people.position + scenario.time_step * people.desired_velocity
            people = replace(people, position=position, velocity=people.desired_velocity)
            return replace(after, pedestrians=people, tick=state.tick + 1), state.memory

        return jax.lax.scan(one, sean_jax.reset(scenario, key), length=600)[1]

    memory = jax.tree.map(np.asarray, jax.jit(walk)(jax.random.key(0)))
    taste = memory.trip.taste
    assert (taste == taste[:1]).all() and len(np.unique(taste)) == graph.tastes.factor.shape[0]
    hop, origin, goal = memory.hop[1:], memory.origin[1:], memory.goal[1:]
    moved = (origin == memory.hop[:-1]) & (hop != memory.hop[:-1])
    by_taste = np.asarray(graph.tastes.next_hop)[taste[1:], origin, goal]
    by_cost = np.asarray(graph.next_hop)[origin, goal]
    assert (hop == by_taste)[moved].all() and not (hop == by_cost)[moved].all()


def test_no_missing_edge_reaches_a_gradient():
    edge_cost = jnp.array([[jnp.inf, 2.0], [3.0, jnp.inf]])
    factor = jnp.full((2, 2, 2), 1.1)

    def shortest(edge_cost, factor):
        return jnp.exp(-costs_of_tastes(edge_cost, factor)).sum()

    slopes = jax.grad(shortest, argnums=(0, 1))(edge_cost, factor)
    assert all(np.isfinite(slope).all() and (slope != 0.0).any() for slope in slopes)

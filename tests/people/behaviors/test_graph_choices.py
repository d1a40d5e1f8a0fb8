"""How people choose on the Behavior Graph (section IV-D): edge by edge, around crowds, by flow words, on odd graphs."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import networkx
import numpy as np
import pytest

import sean_jax
from sean_jax.graph.behavior_graph import add_congestion_cost, edge_areas, edge_densities, routes
from sean_jax.people.behaviors import Place, graph_behavior, graph_choices
from sean_jax.simulation import scenario as stages
from sean_jax.studies.inverse_graph.measuring import begin_alone
from sean_jax.world import environment as environments
from support import crowds, programs
from support.graphs import assert_routes
from support.quick import quick
from support.scenes import box, room

HEAD = "version: 1\nc_min: 0.2\nc_max: 100\n"


@pytest.fixture(scope="module")
def scenario(whole_scenario):
    """People walk along whole paths."""
    return whole_scenario


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """``hall(graph, people, routing, congestion_cost)``: a scenario of that graph.yaml on one floor around a block."""
    folder = room(tmp_path_factory.mktemp("choices"), (-11, -9, 11, 9), [box((0, 0), (5, 1.5))], 4)
    made = sean_jax.make(folder, behavior="random", task="random_ab_nav", dynamics="twin")

    def scenario(graph: str, people: int, routing: str = "whole", congestion_cost: float = 0.0):
        (folder / "graph.yaml").write_text(HEAD + graph)
        place = Place(folder, made.environment, made.behavior.data.navigation)
        behavior = graph_behavior.build(place, people, routing=routing, congestion_cost=congestion_cost)
        return dataclasses.replace(made, behavior=behavior, people=people)

    return scenario


def frames_and_memories(before, after):
    return stages.frame(before, after, jnp.zeros(2, jnp.float32)), after.memory


# --- Flow words ---

RING = 6
STEPS = 1500


def ring(word: str) -> str:
    """A ring of six waypoints whose first edge has that flow word."""
    angle = 2 * np.pi * (np.arange(RING) + 0.5) / RING
    radius = 6.8 + np.array([0.0, 0.4, -0.3, 0.2, -0.4, 0.3])  # so that no two ways round are equally long
    nodes = "".join(
        f"  n{k}: {{kind: waypoint, position: [{r * np.cos(a):.3f}, {r * np.sin(a):.3f}], radius: 0.8, spawn: 1}}\n"
        for k, (r, a) in enumerate(zip(radius, angle, strict=True))
    )
    edges = "".join(
        f"  - {{between: [n{k}, n{(k + 1) % RING}], flow: {'medium' if k else word}}}\n" for k in range(RING)
    )
    return f"nodes:\n{nodes}edges:\n{edges}"


@pytest.fixture(scope="module")
def ring_flows(hall):
    """word -> (walks (M, M) in two episodes, the graph): they differ in the word of one edge and not in chance."""

    @jax.jit
    def walks(scenario):
        def one(key):
            frames, _ = crowds.walk(scenario, key, STEPS, frames_and_memories)
            return sean_jax.congestion(scenario, frames, span=STEPS * 0.1, cells=(1, 1)).flow[0] * (STEPS * 0.1 / 60)

        return jax.vmap(one)(jax.random.split(jax.random.key(2), 2)).sum(0)

    found, made = {}, hall(ring("medium"), 10)
    for word in ("low", "medium", "high", "forward", "backward"):
        graph = hall(ring(word), 10).behavior.data.graph
        data = made.behavior.data.replace(graph=graph)  # people's starts stay the same
        found[word] = np.asarray(walks(made.replace(behavior=made.behavior.replace(data=data)))), graph
    assert walks._cache_size() == 1
    return found


def expected_walks(graph) -> np.ndarray:
    """(M, M) share of all walks along each edge, if each goal is drawn uniformly from all other nodes, by networkx."""
    directed = networkx.DiGraph()
    cost = np.asarray(graph.edge_cost)
    directed.add_weighted_edges_from((u, v, cost[u, v]) for u, v in np.argwhere(np.isfinite(cost)))
    count = np.zeros(cost.shape)
    for u in directed:
        for v in set(directed) - {u}:
            way = networkx.dijkstra_path(directed, u, v)
            np.add.at(count, (way[:-1], way[1:]), 1)
    return count / count.sum()


@pytest.mark.night
def test_more_people_walk_where_the_flow_word_says_so(ring_flows):
    """Low < medium < high on the same edge of the same graph, all else equal, and as many as networkx expects.

    People take the cheapest path, so a cost matters only where there is another way. On a ring there always is one, and
    the cost of the marked edge decides for how many pairs of nodes it is part of the cheaper way round.
    """
    share = {}
    for word, (walks, graph) in ring_flows.items():
        expected, total = expected_walks(graph), walks.sum()
        assert total > 300
        spread_of_chance = np.sqrt(expected * total) + 1.0
        assert (np.abs(walks - expected * total) <= 5 * spread_of_chance).all(), word
        share[word] = (walks[0, 1] + walks[1, 0]) / total
    assert share["low"] < 0.1 * share["medium"] and share["medium"] * 1.3 < share["high"]


@pytest.mark.slow
@pytest.mark.parametrize(("word", "forth", "back"), [("forward", (0, 1), (1, 0)), ("backward", (1, 0), (0, 1))])
def test_a_one_way_edge_carries_ten_times_more_forward(ring_flows, word, forth, back):
    walks = ring_flows[word][0]
    assert walks[forth] >= 15 and walks[forth] >= 10 * walks[back]


# --- Edge by edge ---


@pytest.fixture(scope="module")
def choosers(scenario):
    """The graph of the warehouse, a memory of people at its nodes, ``at(hop, seat)``, and these people: at (0, 0)."""
    graph = scenario.behavior.data.graph
    nobody = jax.eval_shape(functools.partial(sean_jax.reset, scenario), jax.random.key(0)).pedestrians
    nobody = jax.tree.map(lambda leaf: jnp.zeros((12, *leaf.shape[1:]), leaf.dtype), nobody)
    nobody = dataclasses.replace(nobody, walking_group=jnp.full(12, -1, jnp.int32), present=jnp.ones(12, bool))

    def at(hop, seat) -> graph_choices.GraphMemory:
        hop, seat = jnp.asarray(hop, jnp.int32), jnp.asarray(seat, jnp.int32)
        nowhere, rows = jnp.zeros((len(hop), 2)), jnp.zeros((graph.seat_node.shape[0], 2))
        return graph_choices.GraphMemory(hop, hop, hop, nowhere, seat, jnp.zeros(len(hop)), rows, rows)

    return graph, at, nobody


def test_people_choose_at_each_node_as_sean2_does(choosers):
    """Against a loop over people: the neediest group or a waypoint, one edge of the cheapest path, seats in turn."""
    graph, at, nobody = choosers
    choose = jax.jit(graph_choices.choose_edge)
    group, seats = np.asarray(graph.groups), np.asarray(graph.seat_group)
    waypoints, step = np.asarray(graph.waypoints), np.asarray(graph.next_hop)
    draw, sent = np.random.default_rng(0), 0
    for _ in range(40):
        held = draw.permutation(11)[: draw.integers(12)]
        seat = np.full(12, -1)
        seat[: len(held)] = held
        hop = np.where(seat >= 0, group[seats[seat]], draw.choice(waypoints, 12))
        free = (seat < 0) | (draw.random(12) < 0.3)
        chance = draw.uniform(size=(2, 12)).astype(np.float32)
        after = choose(graph, nobody, at(hop, seat), jnp.asarray(free), jnp.asarray(chance))
        left = [np.setdiff1d(np.flatnonzero(seats == g), seat).tolist() for g in range(3)]
        neediest = int(np.argmax([len(empty) for empty in left]))
        lacks = len(left[neediest]) > 0
        for n in range(12):
            if not free[n]:
                assert (int(after.hop[n]), int(after.seat[n])) == (hop[n], seat[n])
                continue
            goal, got, target = int(after.goal[n]), -1, group[neediest]
            wants = lacks and hop[n] != target
            full = wants and step[hop[n], target] == target and not left[neediest]
            if wants and not full:
                assert goal == target
                got = left[neediest].pop(0) if step[hop[n], target] == target else -1
            else:
                assert goal in waypoints and goal != hop[n]
                sent += full
            assert int(after.hop[n]) == step[hop[n], goal] and int(after.seat[n]) == got
            assert int(after.origin[n]) == hop[n]
    assert sent > 0


def test_whoever_finds_the_group_full_goes_on_to_a_waypoint(choosers):
    """Two set out for the last seat from afar: the first at the last edge has it, the other is sent elsewhere."""
    graph, at, nobody = choosers
    names = {name: index for index, name in enumerate(graph.names)}
    dock, near, far = names["dock"], names["tables_1"], names["tables_2"]
    chance = jnp.full((2, 12), 0.4, jnp.float32)
    choose = jax.jit(graph_choices.choose_edge)
    # All seats but one of the dock are taken; 10 and 11 are a node away from it, and 11 farther.
    memory = at([*np.asarray(graph.seat_node)[1:], near, far], [*range(1, 11), -1, -1])
    first = choose(graph, nobody, memory, jnp.arange(12) == 11, chance)
    assert int(first.goal[11]) == dock and int(first.seat[11]) == -1  # it aims at the dock without a seat there
    second = choose(graph, nobody, first, jnp.arange(12) == 10, chance)
    assert int(second.goal[10]) == int(second.hop[10]) == dock and int(second.seat[10]) == 0
    there = jnp.where(jnp.arange(12) == 11, near, second.hop)  # 11 comes to the node before the dock
    third = choose(graph, nobody, second._replace(hop=there), jnp.arange(12) == 11, chance)
    assert int(third.seat[11]) == -1 and not bool(graph.is_group[third.goal[11]])
    assert int(third.hop[11]) == int(graph.next_hop[near, third.goal[11]]) != dock


def test_waypoints_are_drawn_by_their_weights(scenario):
    """As often as their weights say, and if all are equal, exactly as by whole numbers of others."""
    shipped = scenario.behavior.data.graph
    waypoints, draw = np.asarray(shipped.waypoints), np.random.default_rng(0)
    choose = jax.jit(graph_choices._other_waypoint)
    hop = jnp.asarray(draw.integers(0, 15, 20_000), jnp.int32)
    chance = jnp.asarray(draw.random(20_000), jnp.float32)
    goal = np.asarray(choose(shipped, hop, chance))
    for at in range(15):
        here, others = np.asarray(hop) == at, waypoints[waypoints != at]
        index = (np.asarray(chance)[here] * np.float32(len(others))).astype(int)
        assert (goal[here] == others[index]).all()
    weight = np.where(np.asarray(shipped.is_group), 0.0, draw.uniform(0.0, 3.0, 15)).astype(np.float32)
    weight[waypoints[3]] = 0.0
    goal = np.asarray(choose(shipped.replace(weight=jnp.asarray(weight)), jnp.full_like(hop, waypoints[0]), chance))
    odds = np.where(np.arange(15) == waypoints[0], 0.0, weight)
    np.testing.assert_allclose(np.bincount(goal, minlength=15) / len(goal), odds / odds.sum(), atol=0.012)
    alone = jnp.zeros(15).at[waypoints[0]].set(1.0)  # who is there has to go elsewhere
    goal = np.asarray(choose(shipped.replace(weight=alone), jnp.full_like(hop, waypoints[0]), chance))
    assert set(goal) == set(waypoints[1:])


def test_choices_of_a_graph_are_refused_elsewhere():
    for option, value in (("routing", "edge"), ("congestion_cost", 2.0)):
        with pytest.raises(ValueError, match=f"{option}: behavior 'random' has no such option; choose .*'graph'"):
            sean_jax.make("lab", behavior="random", task="random_ab_nav", **{option: value})
    with pytest.raises(ValueError, match="routing: 'hole' is not one of trips, whole, edge; did you mean 'whole'?"):
        sean_jax.make("lab", routing="hole")
    for value in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="congestion_cost: .* must be from 0 to "):
            sean_jax.make("lab", congestion_cost=value)


# --- Around crowds ---


@pytest.fixture(scope="module")
def random_graph(scenario):
    """``graph_of(seed)``: ten nodes with random edges and groups, in arrays of one shape."""
    shipped = scenario.behavior.data.graph

    def graph_of(seed: int):
        draw = np.random.default_rng(seed)
        is_group, joined = draw.random(10) < 0.3, np.triu(draw.random((10, 10)) < 0.35, 1)
        cost = np.full((10, 10), np.inf, np.float32)
        for u, v in np.argwhere(joined):
            cost[u, v], cost[v, u] = draw.uniform(1, 9, 2)
        return shipped.replace(
            position=jnp.asarray(draw.uniform(-9, 9, (10, 2)), jnp.float32),
            radius=jnp.asarray(draw.uniform(0.5, 2, 10), jnp.float32),
            is_group=jnp.asarray(is_group),
            edge_cost=jnp.asarray(cost),
        )

    return graph_of


def test_ways_around_crowds_equal_dijkstra_on_the_dearer_edges(random_graph):
    table = programs.jit_once(add_congestion_cost)
    draw = np.random.default_rng(1)
    for seed in range(8):
        graph, density = random_graph(seed), draw.uniform(0, 0.5, (10, 10)).astype(np.float32)
        found = table(graph, density, jnp.float32(10.0))
        dearer, is_group = np.asarray(graph.edge_cost) * (1 + 10 * density), np.asarray(graph.is_group)
        np.testing.assert_allclose(found.cost, routes(dearer, is_group)[0], rtol=1e-5)  # scipy
        assert_routes(dearer, is_group, np.asarray(found.cost), np.asarray(found.next_hop))  # networkx


def test_empty_edges_cost_what_they_did(scenario):
    graph = scenario.behavior.data.graph
    found = jax.jit(add_congestion_cost)(graph, jnp.zeros((15, 15)), jnp.float32(50.0))
    np.testing.assert_allclose(found.cost, graph.cost, rtol=1e-5)
    assert (np.asarray(found.next_hop) == np.asarray(graph.next_hop)).all()


def test_crowds_are_counted_both_ways_over_the_area_of_an_edge(random_graph):
    graph, draw = random_graph(3), np.random.default_rng(0)
    origin, hop, walking = draw.integers(0, 10, 40), draw.integers(0, 10, 40), draw.random(40) < 0.8
    found = edge_densities(graph, jnp.asarray(origin, jnp.int32), jnp.asarray(hop, jnp.int32), jnp.asarray(walking))
    count = np.zeros((10, 10))
    for u, v, walks in zip(origin, hop, walking, strict=True):
        if walks and u != v:
            count[u, v] += 1
            count[v, u] += 1
    gap = np.asarray(graph.position)[:, None] - np.asarray(graph.position)
    wide = np.add.outer(np.asarray(graph.radius), np.asarray(graph.radius))
    area = np.maximum(np.hypot(*np.moveaxis(gap, -1, 0)) * wide, 1.0)
    np.testing.assert_allclose(edge_areas(graph), area, rtol=1e-5)
    np.testing.assert_allclose(found, count / area, rtol=1e-5)


FORK = """\
nodes:
  west: {kind: waypoint, position: [-9, 0], radius: 1.5, spawn: 1}
  north: {kind: waypoint, position: [0, 2.8], radius: 0.7, spawn: 0}
  south: {kind: waypoint, position: [0, -3], radius: 0.7, spawn: 0}
  east: {kind: waypoint, position: [9, 0], radius: 1.5, spawn: 1}
edges:
  - {between: [west, north]}
  - {between: [west, south]}
  - {between: [east, north]}
  - {between: [east, south]}
"""


@pytest.mark.slow
def test_congestion_cost_lowers_the_peak_of_congestion(hall):
    """Two ways around a block, the southern a little longer: with a congestion cost people take both of them.

    Some walk south anyway, whose goal is the southern node.
    """
    made = hall(FORK, 16, congestion_cost=20.0)

    @jax.jit
    def measured(congestion_cost):
        data = made.behavior.data.replace(congestion_cost=congestion_cost)
        scenario = made.replace(behavior=made.behavior.replace(data=data))

        def one(key):
            frames, memory = crowds.walk(scenario, key, 1200, frames_and_memories)
            walking = jnp.ones(16, bool)
            crowd = jax.vmap(lambda origin, hop: edge_densities(data.graph, origin, hop, walking).max())
            halves = sean_jax.congestion(scenario, frames, span=20.0, cells=(2, 11)).density[1:, :, 3:8]
            return halves.mean(-1), crowd(memory.origin, memory.hop)[200:].max()

        return jax.vmap(one)(jax.random.split(jax.random.key(0), 8))

    (halves, peak), (even, lower) = (jax.tree.map(np.asarray, measured(jnp.float32(value))) for value in (0.0, 20.0))
    south, share = (density[..., 0].mean() / density.sum(-1).mean() for density in (halves, even))
    assert south < 0.42 < share < 0.54
    assert lower.mean() < 0.9 * peak.mean()  # people per m2 on the fullest edge, at the worst moment
    assert even.max(-1).mean() < 0.95 * halves.max(-1).mean()


def test_gradients_with_congestion_cost_are_finite(scenario):
    data = scenario.behavior.data.replace(congestion_cost=jnp.asarray(10.0, jnp.float32))
    crowded = scenario.replace(behavior=scenario.behavior.replace(data=data))
    state = jax.jit(functools.partial(begin_alone, crowded))(jax.random.key(0))

    @jax.jit
    @jax.grad
    def slope(position):
        before = state.replace(pedestrians=state.pedestrians.replace(position=position))
        return jnp.sum(
            stages.direct_pedestrians(crowded, before, state.streams.people).pedestrians.desired_velocity ** 2
        )

    assert np.isfinite(np.asarray(slope(state.pedestrians.position))).all()


# --- Odd graphs ---

WAY = "{kind: waypoint, radius: 1, spawn: 1, position: "
TALK = "{kind: group, radius: 1, spawn: 1, stay: [0.2, 0.6], capacity: 2, position: "
ODD = {  # nodes, edges, and (people, routing, congestion_cost) to try
    "neighbouring groups": (
        f"  a: {WAY}[-4, 4]}}\n  b: {WAY}[4, 4]}}\n  g: {TALK}[-2, 7]}}\n  h: {TALK}[2, 7]}}\n",
        ("[a, b]", "[a, g]", "[b, h]", "[g, h]"),
        ((4, "edge", 0.0), (9, "whole", 5.0)),
    ),
    "one waypoint": (
        f"  a: {WAY}[-3, 4]}}\n  g: {TALK}[2, 6]}}\n",
        ("[a, g]",),
        ((5, "edge", 5.0),),
    ),
    "one node": (f"  a: {WAY}[-3, 4]}}\n", (), ((2, "whole", 5.0), (2, "edge", 0.0))),
}


@pytest.mark.night
@pytest.mark.parametrize("kind", quick(ODD, "one node"))
def test_odd_graphs_and_numbers_of_people(kind, hall):
    """People are put where they aim at, so that they come to a node at every step; seats for all, or too few."""
    nodes, pairs, cases = ODD[kind]
    edges = "edges: []\n" if not pairs else "edges:\n" + "".join(f"  - {{between: {pair}}}\n" for pair in pairs)
    for people, routing, congestion_cost in cases:
        scenario = hall(f"nodes:\n{nodes}{edges}", people, routing, congestion_cost)

        def one(state, _, scenario=scenario):
            after = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
            there = after.pedestrians.replace(position=after.memory.target)
            return after.replace(pedestrians=there, tick=state.tick + 1), (after.memory, after.pedestrians)

        start = jax.jit(begin_alone)(scenario, jax.random.key(0))
        run = jax.jit(lambda start, one=one: jax.lax.scan(one, start, length=120)[1])
        memory, crowd = jax.tree.map(np.asarray, run(start))
        graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((crowd, memory)))
        for whose in (memory.stay > 0, memory.stay == 0):  # a seat has one holder and one successor at most
            seat = np.sort(np.where(whose, memory.seat, -1), axis=1)
            assert not ((seat[:, 1:] == seat[:, :-1]) & (seat[:, 1:] >= 0)).any()
        before, after = memory.hop[:-1], memory.hop[1:]
        moved = before != after
        assert np.isfinite(graph.edge_cost[before[moved], after[moved]]).all()
        assert not (graph.is_group[memory.hop] & (memory.hop != memory.goal)).any()  # nobody passes through a group
        if len(graph.groups):
            joined = (crowd.group[1:] >= 0) & (crowd.group[:-1] < 0)
            assert joined.sum() >= people and (crowd.group[-60:] < 0).any()
        else:
            assert (crowd.group == -1).all()
        assert set(memory.hop.ravel()) == set(range(len(graph.names)))  # every node is gone to


# --- All environments ---


@pytest.mark.night
@pytest.mark.parametrize("routing", graph_behavior.ROUTINGS)
@pytest.mark.parametrize("name", environments.available())
def test_five_minutes_of_each_environment(name, routing):
    """Every edge that a cheapest path can use is walked, none against its one way, and groups are joined and left.

    The cheapest paths between few pairs of nodes alone lead along some edges: what nobody walked in the first ten
    minutes must have been walked after some more.
    """
    scenario = sean_jax.make(name, routing=routing, dynamics="twin")
    run = jax.jit(jax.vmap(lambda key: crowds.walk(scenario, key, 3000, frames_and_memories)))
    flow = jax.jit(lambda frames: sean_jax.congestion(scenario, frames, span=300.0, cells=(1, 1)).flow)

    def simulated(seed: int):
        frames, memory = run(jax.random.split(jax.random.key(seed), 2))
        return frames, memory, 5 * np.asarray(flow(frames)).sum((0, 1))

    frames, memory, walks = simulated(1)
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    used = np.zeros(walks.shape, bool)
    start, goal = np.nonzero(~np.eye(len(used), dtype=bool))
    used[start, graph.next_hop[start, goal]] = True
    against = np.isfinite(graph.edge_cost) & (graph.edge_cost > 10 * graph.edge_cost.T)
    assert (used == np.isfinite(graph.edge_cost) & ~against).all()  # against the one way, there is always another
    every = walks
    for seed in range(2, 8):
        if (every[used] > 0).all():
            break
        every = every + simulated(seed)[2]
    assert (every[used] > 0).all(), np.argwhere(used & (every == 0))
    assert (every.T[against] >= 10 * np.maximum(every[against], 1)).all()
    # What is told from positions is what people had in mind.
    origin, hop = np.asarray(memory.origin), np.asarray(memory.hop)
    done = (origin[:, 1:] != origin[:, :-1]) | (hop[:, 1:] != hop[:, :-1])
    meant = np.zeros(walks.shape)
    np.add.at(meant, (origin[:, :-1][done], hop[:, :-1][done]), 1)
    np.fill_diagonal(meant, 0)
    if name != "lab":  # where two nodes are so near that one can turn round between them
        np.testing.assert_allclose(walks.sum(), meant.sum(), rtol=0.04)
        assert np.abs(walks - meant).max() <= 4 + 0.05 * meant.max()
    group = np.asarray(frames.group)
    joined = ((group[:, 1:] >= 0) & (group[:, :-1] < 0)).sum()
    assert joined >= 20 and ((group[:, 1:] < 0) & (group[:, :-1] >= 0)).sum() >= 20
    for index, node in enumerate(graph.groups):
        members = (group == index).sum(-1)
        assert members.max() == graph.capacity[node]
        assert routing == "whole" or members.min() < graph.capacity[node]  # where successors may keep a group full

"""Successors at the seats of groups: who is sent, when they would be there, and that groups last."""

import jax
import jax.numpy as jnp
import networkx
import numpy as np
import pytest

import sean_jax
from sean_jax.people.behaviors import graph_choices
from sean_jax.people.behaviors.graph_choices import GraphMemory, seats_of
from sean_jax.studies.validation.groups import group_occupancy
from sean_jax.world import environment as environments
from support import crowds

PEOPLE, PATIENCE = 14, 50


@pytest.fixture(scope="module")
def scenario(whole_scenario):
    """People walk along whole paths."""
    return whole_scenario


@pytest.fixture(scope="module")
def sent(scenario):
    """The graph, and 150 random moments: what was there, who asked, and what came out."""
    graph = scenario.behavior.data.graph
    seats, nodes = graph.seat_group.shape[0], graph.radius.shape[0]
    patience = jnp.full(seats, PATIENCE, jnp.int32)

    @jax.jit
    def send(memory, arrival, seekers):
        found = seats_of(memory, patience, 0.1)
        return found, *graph_choices.send(graph, arrival, memory, found, seekers)

    draw, moments = np.random.default_rng(0), []
    node, waypoints = np.asarray(graph.seat_node), np.asarray(graph.waypoints)
    for _ in range(150):
        seat = np.full(PEOPLE, -1)
        stay, hop, goal = np.zeros(PEOPLE, int), draw.choice(waypoints, PEOPLE), draw.choice(waypoints, PEOPLE)
        order = draw.permutation(PEOPLE)
        holders, walkers = order[: draw.integers(9)], order[9 : 9 + draw.integers(4)]
        seat[holders], seat[walkers] = draw.permutation(seats)[: len(holders)], draw.permutation(seats)[: len(walkers)]
        stay[holders], goal[walkers] = draw.integers(1, 160, len(holders)), node[seat[walkers]]
        hop[holders] = goal[holders] = node[seat[holders]]
        arrives = walkers[draw.random(len(walkers)) < 0.5]
        hop[arrives] = goal[arrives]
        rises = draw.random(PEOPLE) < 0.2
        hop = np.where((seat < 0) & rises, draw.choice(node, PEOPLE), hop)
        ints = [jnp.asarray(part, jnp.int32) for part in (goal, hop, draw.integers(nodes, size=PEOPLE), seat, stay)]
        rows = jnp.zeros((seats, 2))
        memory = GraphMemory(*ints[:3], jnp.zeros((PEOPLE, 2)), *ints[3:], rows, rows)
        arrival, seekers = draw.uniform(2, 25, (PEOPLE, 3)).astype(np.float32), draw.random(PEOPLE) < 0.6
        found = send(memory, jnp.asarray(arrival), jnp.asarray(seekers))
        moments.append(jax.tree.map(np.asarray, (memory, arrival, seekers, *found)))
    return jax.tree.map(np.asarray, graph), moments


def test_holders_successors_and_the_time_left(sent):
    for memory, _, _, seats, _, _ in sent[1]:
        for q in range(len(seats.holder)):
            own = memory.seat == q
            assert np.flatnonzero(own & (memory.stay > 0)).tolist() == [seats.holder[q]] * int(seats.holder[q] >= 0)
            assert np.flatnonzero(own & (memory.stay == 0)).tolist() == [seats.successor[q]] * int(
                seats.successor[q] >= 0
            )
            left = memory.stay[seats.holder[q]] if seats.holder[q] >= 0 else 0
            np.testing.assert_allclose(seats.time_left[q], (left - PATIENCE) * 0.1, atol=1e-4)


def test_nobody_is_sent_twice_and_only_seekers_are_sent(sent):
    graph, moments = sent
    gained = 0
    for memory, _, seekers, _, after, loses in moments:
        takes = (memory.seat < 0) & (after.seat >= 0)
        gained += takes.sum()
        assert (seekers & (memory.hop != graph.seat_node[after.seat]))[takes].all()
        assert (after.goal[takes] == graph.seat_node[after.seat[takes]]).all()
        assert (after.goal == memory.goal)[~takes].all() and (after.stay == memory.stay).all()
        assert (after.seat == memory.seat)[~takes & ~loses].all() and (after.seat[loses] == -1).all()
        walked = after.seat[(after.seat >= 0) & (after.stay == 0)]
        assert len(set(walked.tolist())) == len(walked)
    assert gained > 100


def late(arrival: float, due: float) -> float:
    return arrival - due if arrival >= due else 2.0 * (due - arrival)


def test_only_who_is_better_in_time_takes_the_place_of_another(sent):
    graph, moments = sent
    replaced = 0
    for memory, arrival, _, seats, after, loses in moments:
        for old in np.flatnonzero(loses):
            seat, replaced = memory.seat[old], replaced + 1
            (new,) = np.flatnonzero((after.seat == seat) & (after.stay == 0))
            due, group = max(seats.time_left[seat], 0.0), graph.seat_group[seat]
            assert memory.stay[old] == 0 and memory.hop[old] != memory.goal[old]
            assert late(arrival[new, group], due) < late(arrival[old, group], due) - graph_choices.MIN_GAIN
    assert replaced > 10


def test_a_seat_that_is_due_gets_somebody_if_anybody_can_come(sent):
    graph, moments = sent
    lacked = 0
    for memory, _, seekers, seats, after, _ in moments:
        due = (seats.time_left <= 0) & (seats.successor < 0)
        free = seekers & (memory.seat < 0)
        could = free[:, None] & due[None, :] & (memory.hop[:, None] != graph.seat_node[None, :])
        if could.any():
            lacked += 1
            assert ((memory.seat < 0) & (after.seat >= 0)).any()
    assert lacked > 50


def test_the_seat_that_is_due_first_is_asked_first(sent):
    """Nobody takes a seat while a seat of the same group, for which they would do, has nobody and is due earlier."""
    graph, moments = sent
    chosen = 0
    for memory, arrival, _, seats, after, _ in moments:
        for person in np.flatnonzero((memory.seat < 0) & (after.seat >= 0)):
            seat = after.seat[person]
            others = np.flatnonzero((graph.seat_group == graph.seat_group[seat]) & (seats.successor < 0))
            earlier = [other for other in others if seats.time_left[other] < seats.time_left[seat]]
            chosen += any(seats.time_left[other] > seats.time_left[seat] for other in others)
            for other in earlier:
                left = seats.time_left[other]
                returns = graph_choices.RETURN * (memory.origin[person] == graph.seat_node[other])
                when = late(arrival[person, graph.seat_group[other]], max(left, 0.0)) + returns
                assert left > 0 and when >= graph_choices.MAX_MISFIT
    assert chosen > 20


def test_walks_are_as_long_as_the_ways_that_cost_least(scenario):
    """Against networkx, which is given costs and whose ways are measured in straight lines: nothing can be shorter."""
    data = scenario.behavior.data
    graph, walk = jax.tree.map(np.asarray, data.graph), np.asarray(data.walk)
    directed = networkx.DiGraph()
    directed.add_weighted_edges_from(
        (u, v, graph.edge_cost[u, v]) for u, v in np.argwhere(np.isfinite(graph.edge_cost))
    )
    for column, group in enumerate(graph.groups):
        others = directed.subgraph([node for node in directed if node == group or not graph.is_group[node]])
        for node in np.flatnonzero(~graph.is_group):
            way = networkx.dijkstra_path(others, node, group)
            straight = sum(
                np.hypot(*(graph.position[u] - graph.position[v])) for u, v in zip(way, way[1:], strict=False)
            )
            assert straight - 1e-3 <= walk[node, column] <= 1.15 * straight
        assert walk[group, column] == 0.0


def test_arrivals_are_foretold(occupied):
    """People who walk to a seat get there about when it was expected, on average and one by one."""
    scenario, seat, stay, near, arrival = (occupied[key] for key in ("scenario", "seat", "stay", "near", "arrival"))
    off = []
    for n in range(seat.shape[1]):
        walks = (seat[:, n] >= 0) & (stay[:, n] == 0)
        for tick in np.flatnonzero(walks[1:] & ~walks[:-1]) + 1:
            there = np.flatnonzero((seat[tick:, n] != seat[tick, n]) | near[tick:, n])
            if len(there) and near[tick + there[0], n]:
                off.append(there[0] * scenario.time_step - arrival[tick, n])
    assert len(off) > 15 and abs(np.median(off)) < 2.0 and np.quantile(np.abs(off), 0.8) < 5.0


@pytest.fixture(scope="module")
def occupied():
    """A minute and a half of 30 people in the warehouse: their seats and stays, who is near, expected arrivals."""
    scenario = sean_jax.make(people=30, routing="whole", task="random_ab_nav", dynamics="twin")
    data = scenario.behavior.data

    def seats(before, after):
        people, memory = after.pedestrians, after.memory
        seat = jnp.maximum(memory.seat, 0)
        gap = jnp.linalg.norm(people.position - memory.seat_position[seat], axis=-1)
        arrival = graph_choices.arrival_times(data.graph, data.walk, people, memory)
        own = jnp.take_along_axis(arrival, data.graph.seat_group[seat][:, None], axis=1)[:, 0]
        near = (gap < graph_choices.HAND_OVER) & (memory.seat >= 0)
        return dict(group=people.group, seat=memory.seat, stay=memory.stay, near=near, arrival=own)

    history = jax.jit(lambda key: crowds.walk(scenario, key, 900, seats))(jax.random.key(0))
    return jax.tree.map(np.asarray, history) | {"scenario": scenario}


def test_groups_last_while_their_members_change(occupied):
    scenario, group = occupied["scenario"], occupied["group"]
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    found = group_occupancy(group, graph.capacity[graph.groups], scenario.time_step, warm_up=0.0)
    assert found.mean.mean() > 0.75 and (found.largest == graph.capacity[graph.groups]).all()
    for stays, node in zip(found.stays, graph.groups, strict=True):
        assert len(stays) > 3 and stays.max() <= graph.stay[node, 1] + graph_choices.MAX_WAIT + 1e-3
    members = {g: set(np.nonzero(group == g)[1].tolist()) for g in range(len(graph.groups))}
    assert all(len(people) > graph.capacity[node] for people, node in zip(members.values(), graph.groups, strict=True))


@pytest.mark.night
@pytest.mark.parametrize("name", environments.available())
def test_groups_last_in_each_environment(name):
    """Five minutes, 16 episodes, after 20 s: at least 80 % of a group is there, and 50 % of the time everybody."""
    scenario = sean_jax.make(name, task="random_ab_nav", dynamics="twin")
    run = jax.jit(jax.vmap(lambda key: crowds.walk(scenario, key, 3000, lambda _, after: after.pedestrians.group)))
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    capacity, keys = graph.capacity[graph.groups], jax.random.split(jax.random.key(0), 16)
    group = np.asarray(run(keys))
    found = group_occupancy(group, capacity, scenario.time_step)
    assert (found.mean >= 0.8).all() and (found.full >= 0.5).all() and (found.largest <= capacity).all(), found
    begun = group_occupancy(group[:, :200], capacity, scenario.time_step, warm_up=0.0)
    assert (begun.mean >= 0.8).all() and (begun.full >= 0.45).all(), begun
    for stays, node in zip(found.stays, graph.groups, strict=True):
        shortest, longest = graph.stay[node]
        assert stays.min() >= shortest - 1e-3 and stays.max() <= longest + graph_choices.MAX_WAIT + 1e-3
        assert (shortest + longest) / 2 <= stays.mean() <= (shortest + longest) / 2 + 0.5 * graph_choices.MAX_WAIT
        most = longest + graph_choices.MAX_WAIT
        assert len(stays) >= 0.6 * 16 * 280 * graph.capacity[node] * found.mean.min() / most

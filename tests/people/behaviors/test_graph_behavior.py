"""Graph-based behavior (section IV-D): seats are filled first, paths follow the tables, stays last as drawn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.people.behaviors import graph_behavior, graph_choices
from support import crowds


@pytest.fixture(scope="module")
def scenario(whole_scenario):
    """People walk along whole paths."""
    return whole_scenario


@pytest.fixture(scope="module")
def history(scenario):
    """Memories and people of two episodes of 400 steps."""
    run = jax.jit(jax.vmap(lambda key: crowds.walk(scenario, key, 400)))
    people, memory = jax.tree.map(np.asarray, run(jax.random.split(jax.random.key(5), 2)))
    return memory, people


@pytest.fixture(scope="module")
def starts(scenario):
    """People, groups and memories (4,) at the start of four episodes."""
    run = jax.jit(jax.vmap(lambda key: scenario.behavior.reset(scenario, key)))
    return jax.tree.map(np.asarray, run(jax.random.split(jax.random.key(0), 4)))


def graph_of(scenario):
    return jax.tree.map(np.asarray, scenario.behavior.data.graph)


def test_groups_are_full_at_the_start_and_never_over_capacity(scenario, starts, history):
    graph = graph_of(scenario)
    capacity = graph.capacity[graph.groups]
    counts = [(starts[0].group[0] == g).sum() for g in range(3)]
    assert counts == capacity.tolist() == [5, 3, 3]
    group = history[1].group
    for g in range(3):
        assert ((group == g).sum(-1) <= capacity[g]).all()


def test_a_seat_has_one_holder_and_one_successor_at_most(history):
    memory = history[0]
    for who in (memory.stay > 0, memory.stay == 0):
        seat = np.sort(np.where(who, memory.seat, -1), axis=-1)
        assert not ((seat[..., 1:] == seat[..., :-1]) & (seat[..., 1:] >= 0)).any()


def test_hops_follow_the_table_and_aim_inside_the_disc(scenario, history):
    graph, memory = graph_of(scenario), history[0]
    before, after = jax.tree.map(lambda leaf: leaf[:, :-1], memory), jax.tree.map(lambda leaf: leaf[:, 1:], memory)
    moved = before.hop != after.hop
    assert moved.sum() > 20
    assert (after.hop[moved] == graph.next_hop[before.hop[moved], after.goal[moved]]).all()
    assert not graph.is_group[after.hop[moved & (after.hop != after.goal)]].any()  # nobody walks through a group
    waypoint = ~graph.is_group[after.hop] & moved
    off = np.linalg.norm(after.target - graph.position[after.hop], axis=-1)
    assert (off[waypoint] <= graph.radius[after.hop][waypoint] + 1e-4).all()


def test_stays_last_as_drawn_and_members_face_inward(scenario, history):
    graph, (memory, people) = graph_of(scenario), history
    standing = memory.stay > 0
    begins = standing[:, 1:] & ~standing[:, :-1]
    drawn = memory.stay[:, 1:][begins]
    waiting = round(graph_choices.MAX_WAIT / scenario.time_step)
    assert begins.sum() >= 3 and (drawn >= 50 + waiting).all() and (drawn <= 100 + waiting).all()
    assert (drawn > 80 + waiting).any() and (drawn < 70 + waiting).any(), "over the whole range of the limits"
    assert (people.group[standing] >= 0).all() and (people.group[~standing] == -1).all()
    center = graph.position[graph.groups][people.group[standing]]
    inward = center - people.position[standing]
    cosine = (people.heading[standing] * inward).sum(-1) / np.linalg.norm(inward, axis=-1)
    assert np.median(cosine) > 0.7
    gap = np.linalg.norm(
        people.position[standing]
        - np.take_along_axis(
            np.broadcast_to(memory.seat_position[:, :, :, :], memory.seat_position.shape),
            np.maximum(memory.seat, 0)[..., None],
            axis=2,
        )[standing],
        axis=-1,
    )
    assert np.median(gap) < 0.2 and np.quantile(gap, 0.99) < graph_choices.HAND_OVER + 0.2


def test_a_stay_ends_when_the_successor_is_there_or_after_some_waiting(scenario, history):
    memory, waiting = history[0], round(graph_choices.MAX_WAIT / scenario.time_step)
    before, after = (jax.tree.map(lambda leaf: leaf[:, part], memory) for part in (slice(None, -1), slice(1, None)))  # noqa: B023
    relieved = 0
    for episode, tick, person in np.argwhere((before.stay > 0) & (after.stay == 0)):
        left, seat = before.stay[episode, tick, person] - 1, before.seat[episode, tick, person]
        assert left <= waiting
        if left > 0:
            (new,) = np.flatnonzero((after.seat[episode, tick] == seat) & (after.stay[episode, tick] > 0))
            assert before.seat[episode, tick, new] == seat and before.stay[episode, tick, new] == 0
            relieved += 1
    assert relieved >= 5


@pytest.mark.night
def test_one_way_edges_are_walked_forward_only(scenario, history):
    graph, memory = graph_of(scenario), history[0]
    length = np.linalg.norm(graph.position[:, None] - graph.position[None], axis=-1)
    against = np.argwhere(
        np.isfinite(graph.edge_cost) & (graph.edge_cost > 50 * np.maximum(length, 1e-6)) & (length > 0)
    )
    assert len(against) == 4
    hop, following = memory.hop[:, :-1], memory.hop[:, 1:]
    for u, v in against:
        assert not ((hop == u) & (following == v)).any()


def test_few_people_fill_the_groups_first():
    small = sean_jax.make(people=4, dynamics="twin")
    people, _, _ = jax.jit(lambda key: small.behavior.reset(small, key))(jax.random.key(0))
    assert (np.asarray(people.group) >= 0).all()


def test_permanent_members_never_leave_and_visitors_come_besides(scenario):
    """Whoever starts in a group stays; the last seat of each group is empty at first, and its members change."""
    lasting = sean_jax.make(people=16, routing="whole", group_membership="permanent", dynamics="twin")
    run = jax.jit(lambda key: crowds.walk(lasting, key, 600, lambda _, after: after.pedestrians.group))
    group = np.asarray(run(jax.random.key(2)))
    assert [(group[0] == g).sum() for g in range(3)] == [4, 2, 2]
    first = group[0] >= 0
    assert (group[:, first] == group[0, first]).all()
    assert len({tuple(np.flatnonzero(row >= 0)) for row in group}) > 4
    assert (group[-300:] == 0).sum(-1).max() == 5


def test_the_rest_of_a_stay_is_as_at_a_random_moment_of_many_stays():
    """Against stays one after the other, looked at now and then."""
    draw = np.random.default_rng(0)
    for shortest, longest in ((5.0, 10.0), (0.0, 4.0), (3.0, 3.0), (86400.0, 86400.0)):
        ends = np.cumsum(draw.uniform(shortest, longest, 40_000))
        moments = draw.uniform(0.0, ends[-2], 20_000)
        expected = ends[np.searchsorted(ends, moments)] - moments
        limits = jnp.tile(jnp.asarray([shortest, longest], jnp.float32), (20_000, 1))
        chance = jax.random.uniform(jax.random.key(1), (20_000, 2), jnp.float32)
        found = graph_behavior._residual_stay(limits, chance)
        shares = [0.1, 0.5, 0.9]
        np.testing.assert_allclose(
            np.quantile(found, shares), np.quantile(expected, shares), rtol=0.01, atol=0.015 * longest
        )
    assert not np.asarray(graph_behavior._residual_stay(jnp.zeros((3, 2)), jnp.ones((3, 2)))).any()


def test_rings_have_a_place_for_each_seat_and_one_open(scenario, starts):
    """At the start, seats are at whole places of their ring, counted from the opening: a sixth of it for five seats."""
    graph = graph_of(scenario)
    seats, groups = starts[2].seat_position, starts[1]
    for seat, group in enumerate(graph.seat_group):
        gap, opening = (part - groups.center[:, group] for part in (seats[:, seat], groups.opening[:, group]))
        turn = np.angle((gap[:, 0] + 1j * gap[:, 1]) / (opening[:, 0] + 1j * opening[:, 1]))
        place = turn / (2 * np.pi / (graph.capacity[graph.groups[group]] + 1))
        off = np.abs(place - np.rint(place)) * 2 * np.pi / (graph.capacity[graph.groups[group]] + 1)
        assert (off * np.hypot(*gap.T) < 0.13).all() and (np.rint(place) != 0).all()

"""Graph-based behavior (section IV-D): seats are filled first, paths follow the tables, stays last as drawn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import scenario as stages
from sean_jax.behaviors import graph_goals
from sean_jax.behaviors.graph_goals import Memory


@pytest.fixture(scope="module")
def history(scenario):
    """Memories and groups of two episodes of 400 steps, the robot at rest."""

    def one(state, _):
        after = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
        after = stages.move_pedestrians(scenario, after).replace(tick=state.tick + 1)
        return after, (after.memory, after.pedestrians)

    def run(key):
        return jax.lax.scan(one, sean_jax.reset(scenario, key), length=400)[1]

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(5), 2)))


def graph_of(scenario):
    return jax.tree.map(np.asarray, scenario.behavior.data.graph)


def test_groups_are_full_at_the_start_and_never_over_capacity(scenario, history):
    graph = graph_of(scenario)
    capacity = graph.capacity[graph.groups]
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(0))
    counts = [(np.asarray(state.pedestrians.group) == g).sum() for g in range(3)]
    assert counts == capacity.tolist() == [5, 3, 3]
    group = history[1].group
    for g in range(3):
        assert ((group == g).sum(-1) <= capacity[g]).all()


def test_no_seat_is_given_twice(history):
    seat = np.sort(history[0].seat, axis=-1)
    same = (seat[..., 1:] == seat[..., :-1]) & (seat[..., 1:] >= 0)
    assert not same.any()


def test_people_without_a_goal_take_empty_seats_first(scenario):
    graph = scenario.behavior.data.graph
    people, seats = 16, 11
    nobody = jnp.full(people, -1, jnp.int32)
    at = jnp.full(people, int(graph.waypoints[0]), jnp.int32)
    memory = Memory(
        at, at, at, jnp.zeros((people, 2)), nobody, jnp.zeros(people), jnp.zeros((seats, 2)), jnp.zeros((seats, 2))
    )
    chance = jnp.linspace(0.0, 0.999, people, dtype=jnp.float32)
    free = jnp.ones(people, bool)
    given = graph_goals.assign(graph, memory, free, chance, jnp.ones_like(free))
    assert np.asarray(given.seat).tolist() == [*range(seats), *[-1] * (people - seats)]
    goals = np.asarray(given.goal)
    assert (goals[:seats] == np.asarray(graph.groups)[np.asarray(graph.seat_group)]).all()
    assert np.isin(goals[seats:], np.asarray(graph.waypoints)).all() and (goals[seats:] != int(at[0])).all()
    # with all seats taken, everybody else goes to a waypoint, all of which but one's own are drawn
    others = graph_goals.assign(graph, given, free & (given.seat < 0), chance, jnp.ones_like(free))
    assert np.asarray(others.seat).tolist() == np.asarray(given.seat).tolist()


def test_waypoint_goals_are_drawn_uniformly_from_all_but_the_own(scenario):
    graph, people = scenario.behavior.data.graph, 1200
    own = int(graph.waypoints[4])
    at = jnp.full(people, own, jnp.int32)
    taken = jnp.full(people, -1, jnp.int32).at[:11].set(jnp.arange(11, dtype=jnp.int32))
    memory = Memory(
        at, at, at, jnp.zeros((people, 2)), taken, jnp.zeros(people), jnp.zeros((11, 2)), jnp.zeros((11, 2))
    )
    chance = jax.random.uniform(jax.random.key(0), (people,), jnp.float32)
    goals = np.asarray(graph_goals.assign(graph, memory, taken < 0, chance, jnp.ones(people, bool)).goal)[11:]
    counts = np.bincount(goals, minlength=15)
    assert counts[own] == 0
    others = counts[np.setdiff1d(np.asarray(graph.waypoints), own)]
    assert others.min() > 0.6 * others.mean() and others.max() < 1.4 * others.mean()


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
    assert begins.sum() >= 3 and (drawn >= 50).all() and (drawn <= 100).all()
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
    assert np.quantile(gap, 0.95) < 0.35


@pytest.mark.slow
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
    state = jax.jit(sean_jax.reset)(small, jax.random.key(0))
    assert (np.asarray(state.pedestrians.group) >= 0).all()


def test_a_seat_goes_over_to_a_much_nearer_walker(scenario):
    graph = scenario.behavior.data.graph
    names = {name: index for index, name in enumerate(graph.names)}
    dock, near, far = names["dock"], names["tables_1"], names["west_aisle_2"]
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(0))
    people = state.pedestrians
    nobody = jnp.full(16, -1, jnp.int32)
    seat = nobody.at[0].set(0)  # person 0 is on the way to a seat at the dock from the far corner
    hop = jnp.full(16, far, jnp.int32).at[1].set(near).at[2].set(near)
    goal = jnp.full(16, names["tables_4"], jnp.int32).at[0].set(dock)
    zeros = jnp.zeros(16, jnp.float32)
    memory = Memory(goal, hop, hop, people.position, seat, zeros, state.memory.seat_position, state.memory.seat_heading)
    chance = jnp.full(16, 0.3, jnp.float32)

    def hand_over(onward):
        return graph_goals.hand_over(graph, people, memory, onward, chance)

    after = hand_over(jnp.arange(16) == 1)
    assert int(after.seat[1]) == 0 and int(after.goal[1]) == dock
    assert int(after.seat[0]) == -1 and not bool(graph.is_group[after.goal[0]])
    unchanged = hand_over(jnp.arange(16) == 3)  # who is at the far node as well has no shorter way
    assert (np.asarray(unchanged.seat) == np.asarray(seat)).all()

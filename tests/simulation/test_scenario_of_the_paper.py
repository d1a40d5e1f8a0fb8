"""What sections III and IV of the paper say, sentence by sentence, asked of the running system.

Names give the section and the gist; other test files look closer at each part, with oracles. Sections III-A and IV-G
are checked on scenes placed by hand, IV-D on episodes in the warehouse, IV-H on what those episodes leave behind.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import networkx
import numpy as np
import pytest

import sean_jax
from sean_jax import classifiers, metrics
from sean_jax.classifiers import predicates
from sean_jax.graph import annotation, behavior_graph
from sean_jax.io import files
from sean_jax.people.behaviors import BEHAVIORS
from sean_jax.people.behaviors.graph_choices import MAX_WAIT
from sean_jax.policies import go_to_goal
from sean_jax.simulation.making import with_task
from sean_jax.simulation.scenario import frame
from sean_jax.social_forces import integrate
from sean_jax.tasks import TASKS
from sean_jax.world import environment as environments
from sean_jax.world.environment import clearance
from support import programs
from support.scenes import room
from support.situations import AHEAD, BACK, LEFT, NAMES, occurring, snapshot, turned

D, V, A = 2.4, 1.4, math.radians(15)
ENVIRONMENTS = ("lab", "outdoor", "warehouse")
KEYS, STEPS, STEP = 8, 600, 0.1
MEASURED = (  # all of them would take long to compile
    "time_in_situation", "path_efficiency", "time_not_moving", "intimate_robot_on_person", "intimate_person_on_robot",
    "personal_robot_on_person", "personal_person_on_robot",
)  # fmt: skip


def record(before, after, action):
    return frame(before, after, action), after.memory


@pytest.fixture(scope="module")
def scenario():
    """The warehouse with more people than seats in groups, by far: groups are full at times."""
    walks = {"behavior": "graph", "routing": "whole"}
    made = sean_jax.make("warehouse", **walks, task="join_group", robot="kuri", people=36, dynamics="twin")
    return dataclasses.replace(made, metrics=tuple((name, metrics.METRICS[name]) for name in MEASURED))


@pytest.fixture(scope="module")
def joining(scenario):
    """Eight minutes of robots that join groups in the warehouse: first states, last states, frames, memories."""

    @jax.jit
    @jax.vmap
    def run(key):
        return sean_jax.reset(scenario, key), *sean_jax.rollout(scenario, go_to_goal, key, STEPS, record)

    first, last, (frames, memory) = run(jax.random.split(jax.random.key(3), KEYS))
    return first, last, jax.tree.map(np.asarray, frames), jax.tree.map(np.asarray, memory)


@pytest.fixture(scope="module")
def at_random(scenario):
    """States after reset of people who walk at random in the warehouse, for 40 keys."""
    wandering = sean_jax.make(behavior="random", task="random_ab_nav", people=16, dynamics="twin", metrics="none")
    states = programs.resets(wandering, jax.random.split(jax.random.key(5), 40))
    return wandering, states


@pytest.fixture(scope="module")
def closet(tmp_path_factory):
    """One person and a robot who move where nowhere is 2.4 m from anywhere: floor 1.9 m square, bodies of 0.25 m."""
    folder = room(tmp_path_factory.mktemp("closet"), (-0.95, -0.95, 0.95, 0.95))
    tiny = sean_jax.make(folder, behavior="random", task="random_ab_nav", people=1, dynamics="twin", metrics="none")
    run = jax.jit(jax.vmap(lambda key: sean_jax.rollout(tiny, go_to_goal, key, 200)))
    return jax.tree.map(np.asarray, run(jax.random.split(jax.random.key(0), 3))[1])


# --- III-A: predicates


def test_3a_near_is_a_distance_of_less_than_d():
    just_inside = float(np.nextafter(np.float32(D), np.float32(0)))
    for degrees in (0, 90, 180, 270):
        assert "empty" not in occurring([(turned(degrees, just_inside - 1e-6), turned(45), 0.0, -1)])
    assert "empty" in occurring([((D, 0.0), turned(45), 0.0, -1)])


def test_3a_walking_is_a_speed_of_more_than_v():
    v = jnp.float32(V)
    assert not predicates.walking(jnp.array([V, 0.0], jnp.float32), v)
    assert predicates.walking(jnp.array([0.0, -V - 1e-5], jnp.float32), v)
    assert predicates.walking(jnp.array([-1.0, 1.0], jnp.float32), v)  # 1.414 m/s: the norm counts, not a component


@pytest.mark.parametrize(
    ("degrees", "perpendicular", "parallel"),
    [(0, 0, 1), (14.9, 0, 1), (15.1, 0, 0), (74.9, 0, 0), (75.1, 1, 0), (90, 1, 0), (104.9, 1, 0), (105.1, 0, 0),
     (165.1, 0, 0), (180, 0, 0), (194.9, 0, 0), (255.1, 1, 0), (270, 1, 0), (284.9, 1, 0), (345.1, 0, 1)],
)  # fmt: skip
def test_3a_angles_are_right_or_zero_within_a(degrees, perpendicular, parallel):
    """Perpendicular on either side; parallel one way only; vectors need no unit length."""
    for length in (0.2, 1.0, 7.0):
        d1, d2 = jnp.array(turned(20, 3.0)), jnp.array(turned(20 + degrees, length))
        assert predicates.perpendicular_trajectory(d1, d2, jnp.float32(A)) == bool(perpendicular)
        assert predicates.parallel_trajectory(d1, d2, jnp.float32(A)) == bool(parallel)


def test_3a_membership_is_given_by_the_simulator(scenario, joining):
    """Who stands at a seat of a group is its member, and nobody else is."""
    _, _, frames, memory = joining
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    seated = memory.stay > 0
    assert ((frames.group >= 0) == seated).all() and seated.any()
    np.testing.assert_array_equal(frames.group[seated], graph.seat_group[memory.seat[seated]])


# --- III-A: the five equations; each holds, and fails when any one of its conjuncts does

WALKER, MEMBER = ((2.0, 0.5), LEFT, 1.41, -1), ((2.0, 0.5), BACK, 0.0, 1)
EQUATIONS: list[tuple[str, dict[str, Any], dict[str, dict[str, Any]]]] = [
    (
        "cross_path",
        {"agents": [WALKER]},
        {
            "Near": {"agents": [((2.4, 0.5), LEFT, 1.41, -1)]},
            "Walking": {"agents": [((2.0, 0.5), LEFT, 1.39, -1)]},
            "PerpTraj": {"agents": [((2.0, 0.5), turned(106), 1.41, -1)]},
        },
    ),
    (
        "down_path",
        {"agents": [((2.0, 0.5), turned(14), 0.0, -1)]},
        {
            "Near": {"agents": [((2.4, 0.5), turned(14), 0.0, -1)]},
            "ParTraj": {"agents": [((2.0, 0.5), turned(16), 0.0, -1)]},
        },
    ),
    (
        "join_group",
        {"agents": [MEMBER], "goal_group": 1},
        {
            "Near": {"agents": [((2.4, 0.5), BACK, 0.0, 1)], "goal_group": 1},
            "Member of the agent": {"agents": [((2.0, 0.5), BACK, 0.0, -1)], "goal_group": 1},
            "Member of the goal": {"agents": [MEMBER], "goal_group": -1},
            "the same group": {"agents": [MEMBER], "goal_group": 2},
            "not at the goal": {"agents": [MEMBER], "goal_group": 1, "goal": (0.0, 0.0)},
        },
    ),
    (
        "leave_group",
        {"agents": [MEMBER], "start_group": 1},
        {
            "Near": {"agents": [((2.4, 0.5), BACK, 0.0, 1)], "start_group": 1},
            "Member of the agent": {"agents": [((2.0, 0.5), BACK, 0.0, -1)], "start_group": 1},
            "Member of the start": {"agents": [MEMBER], "start_group": -1},
            "the same group": {"agents": [MEMBER], "start_group": 2},
        },
    ),
    ("empty", {"agents": [((2.41, 0.0), AHEAD, 1.5, 1)]}, {"not Near": {"agents": [((2.39, 0.0), BACK, 0.0, 1)]}}),
]


@pytest.mark.parametrize(("name", "holds", "breaks"), EQUATIONS, ids=[f"({k})" for k in range(1, 6)])
def test_3a_equations_are_the_conjunctions_that_are_printed(name, holds, breaks):
    assert name in occurring(**holds)
    for conjunct, scene in breaks.items():
        assert name not in occurring(**scene), conjunct


def test_3a_equation_2_does_not_ask_the_agent_to_walk():
    assert "down_path" in occurring([((1.0, 0.0), AHEAD, 0.0, -1)])


def test_3a_equation_3_ends_on_arrival_and_4_does_not_depend_on_the_place_left():
    for away in (0.0, 0.5, 1.5):
        found = occurring([MEMBER], start_group=1, goal_group=1, goal=(away, 0.0))
        assert ("join_group" in found) == (away > 0.2) and "leave_group" in found


def test_3a_equation_5_excludes_all_others_and_is_that_nobody_is_near():
    random = np.random.default_rng(0)
    seen = set()
    for _ in range(60):
        agents = [
            (
                tuple(random.uniform(-3, 3, 2)),
                turned(random.uniform(0, 360)),
                random.uniform(0, 2),
                int(random.integers(3)),
            )
            for _ in range(int(random.integers(0, 4)))
        ]
        found = occurring(agents, start_group=0, goal_group=1)
        assert ("empty" in found) == all(math.hypot(*place) >= D for place, *_ in agents)
        assert "empty" not in found or len(found) == 1
        seen |= found
    assert seen == set(NAMES)


# --- III-A: remarks on satisfiability


def test_3a_all_non_empty_situations_can_hold_with_agents_who_move_and_groups_that_stand():
    agents = [((1, 0), LEFT, 1.5, -1), ((0, 1), AHEAD, 1.5, -1), ((0, -1), BACK, 0, 1), ((-1, 0), BACK, 0, 3)]
    assert occurring(agents, goal_group=1, start_group=3) == set(NAMES) - {"empty"}


@pytest.mark.slow
def test_3a_without_groups_nothing_is_joined_or_left(closet, at_random):
    random = np.random.default_rng(1)
    for _ in range(40):
        agents = [(tuple(random.uniform(-2, 2, 2)), turned(random.uniform(0, 360)), 1.5, -1) for _ in range(4)]
        assert not occurring(agents) & {"join_group", "leave_group"}
    join, leave = NAMES.index("join_group"), NAMES.index("leave_group")
    for flags in (closet.situations, np.asarray(at_random[1].situations)):
        assert not flags[..., [join, leave]].any()


@pytest.mark.night
def test_3a_empty_cannot_hold_where_nowhere_is_farther_than_d(closet, joining):
    """A robot and a person in a space smaller than D; in the warehouse, which is larger, it does hold at times."""
    assert np.linalg.norm(closet.people - closet.position[:, :, None], axis=-1).max() < D
    assert closet.present.all() and not closet.situations[..., NAMES.index("empty")].any()
    assert np.ptp(closet.position, axis=1).max() > 0.3  # although the robot moves about
    assert joining[2].situations[..., NAMES.index("empty")].mean() > 0.02


# --- IV-B, IV-C: scenarios and environments


def test_4b_a_scenario_is_an_environment_a_behavior_and_a_task(scenario):
    assert scenario.environment.name == "warehouse" and scenario.behavior.name == "graph"
    assert scenario.task is TASKS["join_group"] and scenario.task_name == "join_group"


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_4c_each_environment_has_a_behavior_graph_with_two_directed_edges_per_pair(name):
    """And each pair has one of the four sets of weights of IV-D, with 0 < c_min < 1 < c_max."""
    assert name in environments.available()
    folder = environments.find(name)
    told = files.load(folder / "graph.yaml", annotation.Annotation, annotation.check)
    assert 0 < told.c_min < 1 < told.c_max
    graph = annotation.build_graph(told, environments.load(folder))
    weight, position = np.asarray(graph.edge_cost, float), np.asarray(graph.position, float)
    joined = np.isfinite(weight)
    assert joined.any() and (joined == joined.T).all()
    ratio = weight / np.linalg.norm(position[:, None] - position, axis=-1).clip(1e-9)
    medium, high, low, one_way = ((1.0,) * 2, (told.c_min,) * 2, (told.c_max,) * 2, (1.0, told.c_max))
    for u, v in np.argwhere(np.triu(joined, 1)):
        pair = sorted((ratio[u, v], ratio[v, u]))
        assert any(np.allclose(pair, allowed, rtol=1e-3) for allowed in (medium, high, low, one_way))


def test_4c_static_elements_constrain_everybody(scenario, joining):
    _, _, frames, _ = joining
    room = jax.jit(lambda points: clearance(scenario.environment, points))
    assert np.asarray(room(jnp.asarray(frames.people.reshape(-1, 2)))).min() > 0.2 - 1e-3
    assert np.asarray(room(jnp.asarray(frames.position.reshape(-1, 2)))).min() > scenario.robot.radius - 0.02


# --- IV-D: pedestrian behaviors


def test_4d_behaviors_include_those_of_the_paper():
    assert {"random", "graph"} <= set(BEHAVIORS)


def test_4d_people_keep_individual_distances_from_the_robot(joining, scenario):
    """Drawn anew for each person and episode [45]; one who keeps more is pushed farther off by a passing robot."""
    drawn = np.asarray(joining[0].pedestrians.robot_distance)
    assert len(np.unique(drawn)) == drawn.size and drawn.std() > 0.02
    people = one_walker(scenario, [(0.0, 0.0), (0.0, 50.0)])
    robot = dataclasses.replace(joining[0].robot, drive_state=())
    robot = jax.tree.map(lambda leaf: leaf[0], robot)
    robot = dataclasses.replace(
        robot, position=jnp.array([1.2, -0.3]), speed=jnp.float32(0.5), heading=-people.heading[0]
    )
    aside = []
    for extra in (0.0, 0.5):
        shy = dataclasses.replace(people, robot_distance=jnp.full(2, extra, jnp.float32))
        aside.append(float(walk(scenario, shy, robot, 20).position[0, 1]))
    assert aside[1] > aside[0] + 0.05


def test_4d_people_pass_each_other_on_one_side(scenario):
    """Side preference [44]: two who meet head on, to the millimetre, go by on each other's left: both keep right."""
    people = one_walker(scenario, [(-4.0, 0.0), (4.0, 0.0)])
    after = walk(scenario, people, None, 30)
    y = np.asarray(after.position)[:, 1]
    assert y[0] < -0.15 and y[1] > 0.15  # each to the right of their own way
    assert np.asarray(after.position)[0, 0] > np.asarray(after.position)[1, 0] or abs(y[0] - y[1]) > 0.4


def one_walker(scenario, places):
    """People at those places, the first walking along +x and the second along -x."""
    number = jnp.float32
    facing = jnp.array([[1.0, 0.0], [-1.0, 0.0]], number)
    two = jax.tree.map(
        lambda leaf: leaf[:2], sean_jax.core.data_types.Pedestrians(*snapshot().people.__dict__.values())
    )
    return dataclasses.replace(
        two, position=jnp.array(places, number), velocity=1.3 * facing, heading=facing, desired_velocity=1.3 * facing,
        preferred_speed=jnp.full(2, 1.3, number), group=jnp.full(2, -1, jnp.int32), present=jnp.ones(2, bool),
    )  # fmt: skip


def walk(scenario, people, robot, steps):
    """People after so many steps of the social forces in the open."""
    return jax.lax.fori_loop(
        0, 2 * steps, lambda _, people: integrate(scenario.forces, people, None, None, robot, 0.05, 0.16), people
    )


@pytest.mark.slow
def test_4d_random_people_start_and_go_anywhere_and_form_no_groups(closet, at_random):
    wandering, states = at_random
    assert wandering.behavior.name == "random"
    floor = np.asarray(wandering.environment.floor)
    places = np.asarray(wandering.behavior.data.navigation.places)
    for spots in (np.asarray(states.pedestrians.position), places[np.asarray(states.memory.goal)]):
        share = (spots.reshape(-1, 2) - floor[:2]) / (floor[2:] - floor[:2])
        free = (places - floor[:2]) / (floor[2:] - floor[:2])
        for axis in (0, 1):  # as spread as the navigable floor is: quartiles of 640 agree to some percent
            quartiles = np.quantile(share[:, axis], [0.25, 0.5, 0.75])
            np.testing.assert_allclose(quartiles, np.quantile(free[:, axis], [0.25, 0.5, 0.75]), atol=0.08)
    assert (np.asarray(states.pedestrians.group) == -1).all() and states.groups.radius.shape[1] == 0
    assert (closet.group == -1).all()  # nor later


def test_4d_graph_people_start_at_nodes_drawn_by_chance(scenario, joining):
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    first = joining[0]
    node, place = np.asarray(first.memory.hop), np.asarray(first.pedestrians.position)
    off = np.linalg.norm(place - graph.position[node], axis=-1)
    waypoint = ~graph.is_group[node]
    assert (off[waypoint] <= graph.radius[node][waypoint] + 1e-4).all() and (graph.spawn[node][waypoint] > 0).all()
    assert (off[~waypoint] < 1.5).all()
    assert len({tuple(sorted(row)) for row in node.tolist()}) > 1  # episodes differ


def test_4d_groups_fill_first_and_the_rest_go_to_waypoints(scenario, joining):
    """Nobody without a goal is sent to a waypoint while a seat is free, but for one who has just risen from it.

    Ours is that people go to seats whose holders are about to leave as well. Of those who ask for the same seat in one
    step, one gets it and the others go on to a waypoint.
    """
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    memory, seats = joining[3], len(graph.seat_group)
    before, after = (jax.tree.map(lambda leaf: leaf[:, part], memory) for part in (slice(None, -1), slice(1, None)))  # noqa: B023
    taken_before = (before.seat[..., None] == np.arange(seats)).any(2)
    taken = (after.seat[..., None] == np.arange(seats)).any(2)
    risen = taken_before & ~taken
    sent = (before.goal != after.goal) & (before.seat < 0) & ~graph.is_group[after.goal]
    assert sent.sum() > 10
    full = (taken | risen).all(-1)
    took_over = ((before.seat != after.seat) & (after.seat >= 0)).any(-1)
    assert full[sent.any(-1) & ~took_over].all()
    assert (sent.any(-1) & full).sum() > 10
    to_group = (before.seat < 0) & (after.seat >= 0)
    assert to_group.sum() >= 3 and graph.is_group[after.goal[to_group]].all()
    goals = after.goal[sent]
    assert len(np.unique(goals)) > 4 and np.isin(goals, graph.waypoints).all()  # stochastically


def test_4d_groups_never_hold_more_than_their_capacity_and_stand_for_the_given_time(scenario, joining):
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    group = joining[2].group
    for index, node in enumerate(graph.groups):
        assert (group == index).sum(-1).max() == graph.capacity[node]
    least, most = graph.stay[graph.groups][0]
    assert (graph.stay[graph.groups] == [least, most]).all()
    lasted = []
    for episode in range(KEYS):
        for person in range(scenario.people):
            standing = group[episode, :, person] >= 0
            edges = np.flatnonzero(np.diff(standing.astype(int)))
            lasted += [(b - a) * STEP for a, b in zip(edges, edges[1:], strict=False) if standing[a + 1]]
    assert len(lasted) > 8
    most += MAX_WAIT  # ours: for a successor, so that the group lasts
    assert min(lasted) >= least - STEP and max(lasted) <= most + STEP and np.std(lasted) > 0.5


def test_4d_people_go_from_walking_to_a_group_and_back(joining):
    group = joining[2].group
    joined, left = (group[:, 1:] >= 0) & (group[:, :-1] < 0), (group[:, 1:] < 0) & (group[:, :-1] >= 0)
    assert joined.sum() >= 4 and left.sum() >= 4


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_4d_ways_are_those_of_dijkstra_over_waypoints_only(name):
    graph = annotation.read_graph(environments.find(name) / "graph.yaml", environments.load(name))
    weight, is_group = np.asarray(graph.edge_cost, float), np.asarray(graph.is_group)
    step, cost = np.asarray(graph.next_hop), np.asarray(graph.cost, float)
    for goal in range(len(weight)):
        for start in range(len(weight)):
            kept = [node for node in range(len(weight)) if node in (start, goal) or not is_group[node]]
            links = networkx.DiGraph()
            links.add_nodes_from(kept)
            links.add_weighted_edges_from((u, v, weight[u, v]) for u in kept for v in kept if np.isfinite(weight[u, v]))
            wanted = networkx.dijkstra_path_length(links, start, goal)
            assert cost[start, goal] == pytest.approx(wanted, rel=1e-4)
            here, passed = start, []
            while here != goal:
                here = int(step[here, goal])
                passed.append(here)
            assert not is_group[passed[:-1]].any()


def test_4d_edge_costs_direct_the_flow():
    """Of two equally long ways from 0 to 3, over 1 or 2: the one of high flow, not that of low or contrary flow."""
    none, is_group = math.inf, np.zeros(4, bool)
    for over_1, over_2, chosen in (((0.2, 0.2), (1, 1), 1), ((100, 100), (1, 1), 2), ((100, 1), (1, 1), 2)):
        weight = np.full((4, 4), none)
        for middle, (there, back) in ((1, over_1), (2, over_2)):
            for u, v in ((0, middle), (middle, 3)):
                weight[u, v], weight[v, u] = there, back
        _, step = behavior_graph.routes(weight, is_group)
        assert step[0, 3] == chosen
    assert step[3, 0] == 1 or step[3, 0] == 2  # the way back of a uni-directional pair costs 1, as the other does


def test_4d_nobody_walks_against_a_uni_directional_edge_that_can_be_walked_around(scenario, joining):
    graph, memory = jax.tree.map(np.asarray, scenario.behavior.data.graph), joining[3]
    against = np.isfinite(graph.edge_cost) & (graph.edge_cost > 50 * graph.edge_cost.T)
    assert against.sum() == 4
    hop, following = memory.hop[:, :-1], memory.hop[:, 1:]
    assert not against[hop, following].any() and against.T[hop, following].any()


# --- IV-E: robot tasks


@pytest.fixture(scope="module")
def tasks(scenario):
    """People and groups at the start of 40 episodes, and each task of the graph behavior among them."""
    names = ("join_group", "leave_group", "random_ab_nav", "busy_ab_nav")

    @jax.jit
    @jax.vmap
    def draw(key):
        people = scenario.behavior.reset(scenario, key)
        found = {}
        for name in names:
            among = dataclasses.replace(scenario.behavior, reset=lambda scenario, key: people)
            one = dataclasses.replace(
                with_task(scenario, name), behavior=among, metrics=(), situations=scenario.situations[:1]
            )
            found[name] = sean_jax.reset(one, key).task
        return people[0], people[1], found

    return draw(jax.random.split(jax.random.key(9), 40))


@pytest.mark.night
def test_4e_random_ab_nav_draws_both_poses_from_the_navigable_plane(scenario, tasks):
    task = tasks[2]["random_ab_nav"]
    floor = np.asarray(scenario.environment.floor)
    for place in (task.start, task.goal):
        assert np.asarray(programs.clearance(scenario.environment, place)).min() >= scenario.robot.radius
        share = (np.asarray(place) - floor[:2]) / (floor[2:] - floor[:2])
        assert (np.ptp(share, axis=0) > 0.7).all() and len(np.unique(share[:, 0])) > 30
    assert (np.asarray(task.start_group) == -1).all() and (np.asarray(task.goal_group) == -1).all()


@pytest.mark.slow
def test_4e_busy_ab_nav_lies_by_the_largest_cluster(scenario, tasks):
    """Both poses are 5 m, give or take one, from the same person; more people are about than around random poses."""
    people, task = np.asarray(tasks[0].position), tasks[2]["busy_ab_nav"]
    ends = np.stack([np.asarray(task.start), np.asarray(task.goal)], 1)
    off = np.abs(np.linalg.norm(people[:, :, None] - ends[:, None], axis=-1) - 5.0).max(-1)
    assert (off.min(1) <= 1.0 + 1e-3).mean() > 0.9

    def about(task):
        return (np.linalg.norm(people - np.asarray(task.start)[:, None], axis=-1) < 8.0).sum(1).mean()

    assert about(task) > 1.3 * about(tasks[2]["random_ab_nav"])


@pytest.mark.parametrize("name", ["join_group", "leave_group"])
@pytest.mark.slow
def test_4e_group_tasks_have_one_pose_in_a_group_of_the_graph_and_one_farther_away(scenario, tasks, name):
    people, groups, task = tasks[0], tasks[1], tasks[2][name]
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    inside, outside = (task.goal, task.start) if name == "join_group" else (task.start, task.goal)
    index = np.asarray(task.goal_group if name == "join_group" else task.start_group)
    other = np.asarray(task.start_group if name == "join_group" else task.goal_group)
    assert set(index.tolist()) == {0, 1, 2} and (other == -1).all()
    center, rows = graph.position[graph.groups][index], np.arange(len(index))
    radius = np.asarray(groups.radius)[rows, index]
    np.testing.assert_allclose(np.linalg.norm(np.asarray(inside) - center, axis=-1), radius, atol=1e-3)
    assert (np.linalg.norm(np.asarray(outside) - center, axis=-1) > radius + 1.0).all()
    gap = np.linalg.norm(np.asarray(people.position) - np.asarray(inside)[:, None], axis=-1)
    assert gap.min() > scenario.robot.radius + 0.2  # the place is not a person's


@pytest.mark.slow
def test_4e_group_tasks_need_the_graph_and_all_others_any_behavior(at_random):
    """The handcrafted pair and every other combination are in test_combinations.py."""
    wandering = at_random[0]
    for name in ("join_group", "leave_group"):
        with pytest.raises(ValueError, match="only behavior 'graph'"):
            with_task(wandering, name)
    for name in ("random_ab_nav", "busy_ab_nav"):
        assert with_task(wandering, name).task is TASKS[name]


def test_4e_a_task_makes_its_situation_likely_but_only_the_propositions_decide(scenario, joining):
    _, _, frames, _ = joining
    join = frames.situations[..., NAMES.index("join_group")]
    assert join.any(1).mean() > 0.5 and not join.all(1).any()
    assert not join[np.linalg.norm(frames.position - frames.goal, axis=-1) < 0.19].any()
    assert not frames.situations[..., NAMES.index("leave_group")].any()


# --- IV-G: classifiers


def test_4g_five_classifiers_with_the_papers_parameters():
    """Twice the personal space of 1.2 m, 1.4 m/s, and pi / 12 (V-B)."""
    assert NAMES == ("cross_path", "down_path", "join_group", "leave_group", "empty")
    usual = classifiers.thresholds()
    np.testing.assert_allclose([usual.near, usual.walking, usual.angle], [2 * 1.2, 1.4, math.pi / 12], rtol=1e-6)
    assert tuple(sean_jax.SITUATIONS) == NAMES


# --- IV-H: metrics, aggregated over the robot's task


def seconds_of(frames, first, episode):
    """Positions (K, 2) at whole seconds of an episode, its start and its end included, and how many steps it had."""
    active = int(frames.active[episode].sum())
    path = np.concatenate([np.asarray(first.robot.position)[episode][None], frames.position[episode][:active]])
    return path, np.unique([*range(0, active + 1, 10), active])


def test_4h_path_efficiency_is_travelled_over_geodesic_distance(scenario, joining):
    first, last, frames, _ = joining
    found = sean_jax_results(scenario, last)["path_efficiency"]
    for episode in range(KEYS):
        path, looked = seconds_of(frames, first, episode)
        travelled = np.linalg.norm(np.diff(path[looked], axis=0), axis=-1).sum()
        assert found[episode] == pytest.approx(travelled / float(first.task.geodesic[episode]), rel=1e-3)


def test_4h_time_not_moving_is_seconds_in_which_the_robot_stood(scenario, joining):
    first, last, frames, _ = joining
    found = sean_jax_results(scenario, last)["time_not_moving"]
    for episode in range(KEYS):
        path, looked = seconds_of(frames, first, episode)
        whole = looked[looked % 10 == 0]
        stood = np.linalg.norm(np.diff(path[whole], axis=0), axis=-1) <= 0.05
        assert found[episode, 0] == pytest.approx(stood.sum())


@pytest.mark.parametrize(("kind", "limit"), [("intimate", 0.45), ("personal", 1.2)])
def test_4h_distance_violations_count_approaches_within_the_limit(scenario, joining, kind, limit):
    """0.45 m is the paper's; by the robot and by people add up to all entries into the circle."""
    first, last, frames, _ = joining
    found = sean_jax_results(scenario, last)
    robot, person = (found[f"{kind}_{who}"][:, 0] for who in ("robot_on_person", "person_on_robot"))
    entries = []
    for episode in range(KEYS):
        active = int(frames.active[episode].sum())
        begin = np.linalg.norm(
            np.asarray(first.pedestrians.position)[episode] - np.asarray(first.robot.position)[episode], axis=-1
        )
        gap = np.linalg.norm(frames.people[episode] - frames.position[episode][:, None], axis=-1)[:active]
        inside = np.concatenate([begin[None], gap]) <= limit
        entries.append((inside[1:] & ~inside[:-1]).sum())
    np.testing.assert_array_equal(robot + person, entries)
    assert kind == "intimate" or sum(entries) > 5


def test_4h_metrics_are_split_by_situation_and_end_with_the_task(scenario, joining):
    """V-C: amounts count for each situation that holds; nothing is added once the episode has ended."""
    _, last, frames, _ = joining
    spent = sean_jax_results(scenario, last)["time_in_situation"]
    held = (frames.situations & frames.active[..., None]).sum(1) * STEP
    np.testing.assert_allclose(spent[:, 1:], held, atol=1e-2)
    np.testing.assert_allclose(spent[:, 0], frames.active.sum(1) * STEP, atol=1e-2)
    assert (spent[:, 0] < STEPS * STEP).any() and np.asarray(last.completed).any()


def sean_jax_results(scenario, last) -> dict[str, np.ndarray]:
    """Metrics of each episode."""
    return jax.tree.map(np.asarray, jax.vmap(lambda state: sean_jax.results(scenario, state))(last))


def test_4h_metrics_include_the_papers():
    assert {"path_efficiency", "time_not_moving", "intimate_robot_on_person", "intimate_person_on_robot"} <= set(
        metrics.METRICS
    )

"""Trips on the Behavior Graph: errands, entrances, curves, and people who give up."""

import itertools
import types
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import sean_jax
from sean_jax.core.data_types import Obstacles
from sean_jax.core.errors import FileError
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.graph import annotation
from sean_jax.io import files
from sean_jax.people.behaviors import graph_behavior, graph_choices, trips
from sean_jax.simulation.scenario import direct_pedestrians, move_pedestrians
from sean_jax.social_forces import walls
from sean_jax.studies.validation.floor_measures import Observed, liveliness
from support import graphs

STEPS = 900


@pytest.fixture(scope="module")
def lab():
    return sean_jax.make("lab", behavior="graph", routing="trips", task="random_ab_nav", dynamics="twin")


def walk(scenario, key, steps, robot=(100.0, 100.0)):
    """States of people beside a robot that stands somewhere, one a step."""
    state = sean_jax.reset(scenario, key)
    here = jnp.asarray(robot, jnp.float32)
    state = replace(state, robot=scenario.robot.place(scenario.robot, here, state.robot.heading))

    def one(state, _):
        key = jax.random.fold_in(state.streams.people, state.tick)
        after = move_pedestrians(scenario, direct_pedestrians(scenario, state, key))
        return replace(after, tick=state.tick + 1), (after.pedestrians, after.memory)

    return jax.lax.scan(one, state, length=steps)[1]


def walled(scenario, center, half_extent):
    """The environment of a scenario with one box alone."""
    box = Obstacles(jnp.array([center]), jnp.array([half_extent]), jnp.zeros(1), jnp.ones(1))
    grid = build_obstacle_grid(box, jnp.array([-5.0, -5.0, 5.0, 5.0]))
    return replace(scenario.environment, obstacles=box, obstacle_grid=grid)


@pytest.fixture(scope="module")
def history(lab):
    """People and memories (3, T, ...) of three episodes in the lab."""
    run = jax.jit(jax.vmap(lambda key: walk(lab, key, STEPS)))
    return jax.tree.map(np.asarray, run(jax.random.split(jax.random.key(3), 3)))


def test_people_come_in_and_leave_at_the_entrance_alone(lab, history):
    people, _ = history
    graph = lab.behavior.data.graph
    (hall,) = np.flatnonzero(np.asarray(graph.entrance) > 0.0)
    center, radius = np.asarray(graph.position)[hall], float(graph.radius[hall])
    before, after = people.present[:, :-1], people.present[:, 1:]
    comes, leaves = ~before & after, before & ~after
    assert comes.sum() >= 3 and leaves.sum() >= 3
    entered = people.position[:, 1:][comes]
    left = people.position[:, :-1][leaves]
    assert (np.linalg.norm(entered - center, axis=-1) <= radius + 0.2).all()
    assert (np.linalg.norm(left - center, axis=-1) <= radius + graph_choices.ARRIVED + 0.2).all()
    assert (people.present.sum(-1) <= lab.people).all()


def test_errands_last_as_drawn_where_people_stand(lab, history):
    people, memory = history
    errand = memory.trip.errand
    limits = np.asarray(lab.behavior.data.graph.errand)[memory.goal]
    begins = (errand[:, 1:] > 1) & (errand[:, :-1] == 0) & people.present[:, 1:]
    seconds = errand[:, 1:][begins] * lab.time_step
    low, high = np.moveaxis(limits[:, 1:][begins], -1, 0)
    assert begins.sum() >= 5 and (seconds >= low).all() and (seconds <= high + lab.time_step + 1e-4).all()
    assert (high[seconds > 5.0] > 5.0).all()
    wanted = np.linalg.norm(people.desired_velocity, axis=-1)
    long_errand = (errand[:, 40:] > 1) & (errand[:, :-40] > 1) & (errand[:, 40:] < errand[:, :-40])
    assert (wanted[:, 40:][long_errand] < 0.05).all()


def test_what_people_want_changes_gradually(history):
    people, _ = history
    change = np.linalg.norm(np.diff(people.desired_velocity, axis=1), axis=-1)
    stays = people.present[:, 1:] & people.present[:, :-1]
    bound = np.hypot(trips.MAX_CHANGE, trips.MAX_CHANGE) * 0.1
    within = change[stays] <= bound + 1e-5
    assert within.mean() > 0.99  # a wall may stop people sooner: there they brake as hard as they have to
    assert change[stays].max() < 0.4
    assert change[stays].max() > 0.5 * trips.CHANGE * 0.1


def test_who_walks_into_a_wall_stops_before_it(lab):
    """Beside a wall of 2 m people may walk along it, and towards it no faster than their gap allows."""
    environment = walled(lab, center=(0.0, 0.0), half_extent=(0.1, 1.0))
    scenario = replace(lab, environment=environment)
    state = sean_jax.reset(lab, jax.random.key(1))
    n = lab.people
    radius = float(lab.forces.walking.radius)
    gap = np.linspace(0.02, 2.5, n, dtype=np.float32)
    place = jnp.stack([-0.1 - radius - gap, jnp.zeros(n)], -1)
    people = replace(state.pedestrians, position=place)
    intent = jnp.tile(jnp.array([1.4, 0.3]), (n, 1))
    _, limited = trips.stop_before_walls(scenario, people, state.memory, intent)
    allowed = np.minimum(gap / trips.STOPPING_TIME, 1.4)
    np.testing.assert_allclose(limited[:, 0], allowed, atol=1e-3)
    np.testing.assert_allclose(limited[:, 1], 0.3, atol=1e-5)
    assert allowed.min() < 0.1 and allowed.max() == np.float32(1.4)


def test_nobody_slows_down_before_an_open_door(lab):
    """Its posts are beside the way; the wall next to it is not."""
    width = 0.8
    posts = Obstacles(
        jnp.array([[0.0, 2.0 + width / 2], [0.0, -2.0 - width / 2]]),
        jnp.array([[0.065, 2.0], [0.065, 2.0]]),
        jnp.zeros(2),
        jnp.ones(2),
    )
    grid = build_obstacle_grid(posts, jnp.array([-5.0, -5.0, 5.0, 5.0]))
    x = jnp.linspace(-1.5, 0.0, 16)
    ahead, none = jnp.full(16, 1.3), jnp.zeros(16)
    radius = float(lab.forces.walking.radius)
    through, aside = walls.limit_approach(x, none, ahead, none, grid, radius, trips.STOPPING_TIME)
    np.testing.assert_allclose(through, 1.3)
    np.testing.assert_allclose(aside, 0.0)
    into_wall, _ = walls.limit_approach(x, jnp.full(16, width), ahead, none, grid, radius, trips.STOPPING_TIME)
    gap = -np.asarray(x) - 0.065 - radius
    np.testing.assert_allclose(into_wall[gap > 0], np.minimum(gap / trips.STOPPING_TIME, 1.3)[gap > 0], atol=1e-5)


def test_who_is_held_up_wants_to_be_a_little_faster_only(lab):
    state = sean_jax.reset(lab, jax.random.key(1))
    n = lab.people
    memory = state.memory.with_trip(intent=jnp.tile(jnp.array([1.3, 0.0]), (n, 1)))
    wanted = jnp.full(n, 1.3)
    for ahead, speed in ((0.0, trips.MIN_PUSH), (-1.0, trips.MIN_PUSH), (0.7, 0.7 + trips.MAX_LEAD), (1.25, 1.3)):
        velocity = jnp.tile(jnp.array([ahead, 0.9]), (n, 1))  # being pushed aside is no progress
        people = replace(state.pedestrians, velocity=velocity)
        np.testing.assert_allclose(trips.held_up_speed(people, memory, wanted), speed, atol=1e-6)


def test_bodies_turn_into_their_seats(history, lab):
    people, _ = history
    heading = people.heading
    cosine = (heading[:, 1:] * heading[:, :-1]).sum(-1)
    stays = people.present[:, 1:] & people.present[:, :-1]
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))[stays]
    assert angle.max() <= float(lab.forces.walking.turn_rate) * lab.time_step + 1e-2


def test_people_hardly_turn_about(history, lab):
    people, memory = history
    standing = (people.group >= 0) | (memory.trip.errand > 0)
    for k in range(3):
        seen = Observed(people.position[k], people.present[k], standing[k], people.heading[k], lab.time_step)
        values = liveliness(seen)
        assert values.heading_jumps == 0 and not values.half_turns > 0.5
        assert values.acceleration_p95 < 0.8


def test_a_walking_person_is_not_sent_back(lab):
    graph = lab.behavior.data.graph
    door, corner = graph.names.index("door"), graph.names.index("corner")
    memory = sean_jax.reset(lab, jax.random.key(0)).memory
    people = lab.people
    way = np.asarray(graph.position)[corner] - np.asarray(graph.position)[door]
    ahead = jnp.tile(jnp.asarray(way / np.linalg.norm(way), jnp.float32), (people, 1))
    at_corner = jnp.full(people, corner, jnp.int32)
    walking = memory._replace(
        hop=at_corner,
        goal=jnp.full(people, graph.names.index("desk"), jnp.int32),
        stay=jnp.zeros(people, jnp.int32),
        trip=memory.trip._replace(intent=ahead, errand=jnp.zeros(people, jnp.int32)),
    )
    bearing = lab.behavior.data.bearings
    back = np.asarray(trips.turns_back(walking, bearing.to_waypoints))
    waypoints = np.asarray(graph.waypoints).tolist()
    assert back[:, waypoints.index(door)].all()
    standing = walking._replace(trip=walking.trip._replace(errand=jnp.ones(people, jnp.int32)))
    assert not np.asarray(trips.turns_back(standing, bearing.to_waypoints)).any()
    odds = np.asarray(trips.goal_odds(graph, walking, bearing))
    assert (odds[:, waypoints.index(door)] < 1e-5 * odds.max(1)).all()


def test_a_goal_of_weight_zero_is_not_drawn_even_if_people_would_turn_back_for_all_others(lab):
    data = lab.behavior.data
    desk = data.graph.names.index("desk")
    graph = replace(data.graph, weight=data.graph.weight.at[desk].set(0.0))
    memory = sean_jax.reset(lab, jax.random.key(0)).memory
    n = lab.people
    everywhere = jax.tree.map(lambda way: jnp.zeros_like(way).at[..., 0].set(1.0), data.bearings)
    west = jnp.tile(jnp.array([-1.0, 0.0]), (n, 1))
    memory = memory._replace(
        goal=jnp.full(n, -1, jnp.int32),
        stay=jnp.zeros(n, jnp.int32),
        trip=memory.trip._replace(intent=west, errand=jnp.zeros(n, jnp.int32)),
    )
    odds = np.asarray(trips.goal_odds(graph, memory, everywhere))
    column = np.asarray(graph.waypoints).tolist().index(desk)
    assert (odds[:, column] == 0.0).all() and (odds.sum(1) > 0.0).all()


def test_who_has_left_begins_no_errand(lab):
    state = sean_jax.reset(lab, jax.random.key(0))
    n = lab.people
    memory = state.memory
    corner = jnp.full(n, lab.behavior.data.graph.names.index("corner"), jnp.int32)
    memory = memory._replace(
        goal=corner,
        hop=corner,
        seat=jnp.full(n, -1, jnp.int32),
        stay=jnp.zeros(n, jnp.int32),
        target=state.pedestrians.position,
        trip=memory.trip._replace(errand=jnp.zeros(n, jnp.int32)),
    )
    present = jnp.arange(n) > 0
    people = replace(state.pedestrians, present=present)
    graph = lab.behavior.data.graph
    far = replace(state.robot, position=jnp.full(2, 100.0))
    after, _ = trips.advance_errands(graph, people, far, memory, jnp.full(n, 0.5), lab.time_step)
    assert ((np.asarray(after.trip.errand) > 0) == np.asarray(present)).all()


def come_in(scenario, robot, taken=False):
    """Whether those outside come in when somebody arrives, with a robot at a place, and a person in each place [m]."""
    state = sean_jax.reset(scenario, jax.random.key(0))
    graph = scenario.behavior.data.graph
    outside = state.pedestrians.walking_group == state.pedestrians.walking_group[-1]
    outside = outside & (jnp.arange(scenario.people) >= scenario.people - 3)
    hall = int(np.argmax(np.asarray(graph.entrance)))
    far = jnp.full((scenario.people, 2), 50.0)
    robots = replace(state.robot, position=jnp.asarray(robot))
    chance = jnp.array([0.0, 0.999, 0.5, 0.5])
    people = replace(state.pedestrians, position=far, present=~outside)
    state = replace(state, pedestrians=people, robot=robots)
    after, _ = trips.come_in(scenario, graph, state, outside, chance)
    if not taken:
        return graph.position[hall], np.asarray(after.present & outside)
    came = []
    for person in np.flatnonzero(np.asarray(after.present & outside)):
        occupied = replace(people, position=far.at[0].set(after.position[person]))
        again, _ = trips.come_in(scenario, graph, replace(state, pedestrians=occupied), outside, chance)
        came.append(np.asarray(again.present & outside))
    return np.stack(came)


def test_nobody_comes_in_beside_a_robot(lab):
    hall, comes = come_in(lab, [100.0, 100.0])
    assert comes.sum() == 1
    assert not come_in(lab, hall)[1].any()
    assert not come_in(lab, np.stack([[100.0, 100.0], hall]))[1].any()  # of a team


def test_no_companion_comes_in_where_somebody_stands():
    scenario = sean_jax.make("lab", people=6, walking_groups=(0.34, 0.5), task="random_ab_nav", dynamics="twin")
    assert come_in(scenario, [100.0, 100.0])[1].sum() == 3
    came = come_in(scenario, [100.0, 100.0], taken=True)
    assert len(came) == 3 and not came.any()


def test_who_stands_at_a_waypoint_does_not_crowd_an_edge(lab):
    data = lab.behavior.data.replace(congestion_cost=jnp.asarray(20.0))
    graph = data.graph
    door, corner = graph.names.index("door"), graph.names.index("corner")
    state = sean_jax.reset(lab, jax.random.key(0))
    nodes = {name: jnp.full(lab.people, node, jnp.int32) for name, node in (("origin", door), ("hop", corner))}
    memory = state.memory._replace(stay=jnp.zeros(lab.people, jnp.int32), **nodes)
    cost = {}
    for errand in (0, 50):
        ticks = jnp.full(lab.people, errand, jnp.int32)
        standing = replace(state, memory=memory.with_trip(errand=ticks))
        cost[errand] = float(graph_behavior._graph_with_congestion(data, standing).edge_cost[door, corner])
    assert cost[0] > 1.5 * cost[50] and cost[50] == pytest.approx(float(graph.edge_cost[door, corner]))


def test_who_rises_from_a_seat_may_go_anywhere(lab):
    graph = lab.behavior.data.graph
    memory = sean_jax.reset(lab, jax.random.key(0)).memory
    meeting = jnp.full(lab.people, graph.names.index("meeting"), jnp.int32)
    none = jnp.zeros(lab.people, jnp.int32)
    last_step = jnp.tile(jnp.array([0.02, 0.0]), (lab.people, 1))  # m/s, to a seat
    rising = memory._replace(hop=meeting, goal=meeting, seat=none - 1, stay=none)
    rising = rising.with_trip(errand=none, intent=last_step)
    assert not np.asarray(trips.turns_back(rising, lab.behavior.data.bearings.to_waypoints)).any()


def test_walking_groups_come_in_and_leave_together():
    """All members of a group are always present, or none; they come in apart, and from time to time."""
    scenario = sean_jax.make("lab", people=6, walking_groups=(0.34, 0.5), task="random_ab_nav", dynamics="twin")
    run = jax.jit(jax.vmap(lambda key: walk(scenario, key, 3000)[0]))
    people = jax.tree.map(np.asarray, run(jax.random.split(jax.random.key(0), 3)))
    changes = 0
    for present, group, position in zip(people.present, people.walking_group[:, 0], people.position, strict=True):
        for leader in np.unique(group[group >= 0]):
            members = present[:, group == leader]
            assert (members == members[:, :1]).all()
            comes = np.flatnonzero(members[1:, 0] & ~members[:-1, 0]) + 1
            changes += len(comes)
            for moment in comes:
                place = position[moment, group == leader]
                gaps = np.linalg.norm(place[:, None] - place, axis=-1)[~np.eye(len(place), dtype=bool)]
                assert 0.2 < gaps.min() and gaps.max() < 1.6
    assert changes >= 1


def test_nobody_makes_a_trip():
    nobody = sean_jax.make("lab", behavior="graph", routing="trips", people=0, task="random_ab_nav", dynamics="twin")
    people, memory = jax.jit(lambda key: walk(nobody, key, 2))(jax.random.key(0))
    assert people.position.shape == (2, 0, 2) and memory.goal.shape == (2, 0)


def test_a_few_choose_in_a_step_and_the_others_in_the_next():
    candidates = jnp.asarray(np.arange(40) % 2 == 1)
    few = trips.choosers(candidates)
    assert np.flatnonzero(few.chooses).tolist() == [1, 3, 5, 7, 9] == few.person.tolist()
    assert few.exists.all()
    nobody = trips.choosers(jnp.zeros(40, bool))
    assert not nobody.exists.any() and not nobody.chooses.any()
    one = trips.choosers(jnp.arange(40) == 0)
    assert one.exists.tolist() == [True] + [False] * 4 and one.person[0] == 0
    last = trips.choosers(jnp.arange(40) == 39)
    assert last.exists.tolist() == [True] + [False] * 4 and last.person[0] == 39


def test_who_does_not_get_on_gives_up(lab):
    state = sean_jax.reset(lab, jax.random.key(1))
    memory = state.memory
    n = lab.people
    east = jnp.tile(jnp.array([1.0, 0.0]), (n, 1))
    memory = memory._replace(
        seat=jnp.full(n, -1, jnp.int32),
        stay=jnp.zeros(n, jnp.int32),
        trip=memory.trip._replace(intent=east, errand=jnp.zeros(n, jnp.int32)),
    )
    people = replace(state.pedestrians, velocity=jnp.zeros((n, 2)), present=jnp.ones(n, bool))
    far = replace(state.robot, position=jnp.array([50.0, 50.0]))
    for _ in range(round(trips.PATIENCE / 0.1)):
        memory, gives_up = trips.wait(people, far, memory, 0.1)
        assert not np.asarray(gives_up).any() or np.asarray(memory.trip.blocked).min() > trips.PATIENCE - 0.05
    memory, gives_up = trips.wait(people, far, memory, 0.1)
    assert np.asarray(gives_up).all()

    graph = lab.behavior.data.graph
    after = trips.turn_round(graph, people.position, memory, jnp.full(n, 0.5), gives_up)
    waypoint = np.asarray(graph.position)[np.asarray(after.goal)]
    behind = waypoint[:, 0] < np.asarray(people.position)[:, 0]
    all_ahead = (np.asarray(graph.position)[np.asarray(graph.waypoints), 0] > np.asarray(people.position)[:, :1]).all(1)
    assert (behind | all_ahead).all() and (np.asarray(after.hop) == np.asarray(after.goal)).all()
    beside = replace(state.robot, position=people.position[0] + 0.5)
    short = memory.with_trip(blocked=jnp.full(n, trips.PATIENCE_AT_ROBOT))
    _, gives_up_here = trips.wait(people, beside, short, 0.1)
    gap = np.asarray(people.position) - np.asarray(beside.position)
    is_beside = np.linalg.norm(gap, axis=-1) < trips.BESIDE_ROBOT
    assert (np.asarray(gives_up_here) == is_beside).all() and is_beside[0] and not is_beside.all()
    moving, gives_up = trips.wait(replace(people, velocity=east), far, memory, 0.1)
    assert (np.asarray(moving.trip.blocked) < np.asarray(memory.trip.blocked)).all()


def test_who_gives_up_does_not_go_to_a_waypoint_beyond_a_wall():
    """From the door of room 0, the waypoint of room 1 is nearer, but the way there leads through the same door."""
    places = {
        "room_0": (-4.0, -5.0),
        "door_0": (-1.0, 2.0),
        "hall": (2.0, 4.0),
        "door_1": (5.0, 2.0),
        "room_1": (1.2, 0.0),
    }
    nodes = {name: {"kind": "waypoint", "position": at, "radius": 0.5, "spawn": 1} for name, at in places.items()}
    edges = [{"between": pair} for pair in itertools.pairwise(nodes)]
    made = {"version": 1, "c_min": 0.2, "c_max": 100, "nodes": nodes, "edges": edges}
    graph = annotation.build_graph(annotation.Annotation.model_validate(made), None)
    before_door, to_door = jnp.array([[-1.0, 1.2]]), jnp.array([[0.0, 1.0]])
    for origin in ("room_0", "door_0"):
        assert back(graph, before_door, to_door, origin, "hall") == "room_0"

    # Nor again to the one that is given up: the way there may lead through what is in the way.
    assert back(graph, before_door, to_door, "door_0", "room_0") != "room_0"


def back(graph, position, intent, origin, goal):
    """The waypoint to which a person (1, 2) m goes who gives up a goal."""
    node = {name: jnp.array([graph.names.index(name)]) for name in (origin, goal)}
    memory = types.SimpleNamespace(origin=node[origin], goal=node[goal])
    return graph.names[int(trips._waypoint_behind(graph, position, intent, memory)[0])]


def test_trips_have_nodes_of_their_own(lab):
    sean = sean_jax.make("lab", behavior="graph", routing="edge", task="random_ab_nav")
    names = sean.behavior.data.graph.names
    assert names == ("door", "corner", "meeting")
    assert lab.behavior.data.graph.names == (*names, "hall", "desk", "board")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n0": {"entrance": -1}}, "entrance"),
        ({"n0": {"errand": [9, 5]}}, r"errand.*\[9, 5\] is not ordered"),
        ({"g0": {"errand": [5, 9]}}, "errand.*only a waypoint has one"),
        ({"g0": {"entrance": True}}, "entrance.*only a waypoint can be one"),
        ({"n0": {"visit": [5, 9]}}, "visit.*only a group has one"),
        ({"g0": {"visit": [9, 5]}}, r"visit.*\[9, 5\] is not ordered"),
    ],
)
def test_mistakes_of_trips_are_told(tmp_path, change, message):
    text = annotation.to_yaml(graphs.ring(1))
    content = yaml.safe_load(text)
    for name, fields in change.items():
        content["nodes"][name] |= fields
    yard = graphs.yard(tmp_path / "yard")
    path = tmp_path / "graph.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(FileError, match=message):
        annotation.read_graph(path, yard)


def test_mistakes_in_further_nodes_stand_where_they_are(tmp_path):
    further = annotation.Trips(
        nodes={"n0": annotation.Node(kind="waypoint", position=(1.0, 1.0), radius=1.0)},
        edges=[annotation.Edge(between=("n0", "nowhere"))],
    )
    made = graphs.ring(0).model_copy(update={"trips": further})
    path = tmp_path / "graph.yaml"
    path.write_text(annotation.to_yaml(made))
    with pytest.raises(FileError, match=r"trips.nodes.n0.*another node of that name(.|\n)*trips.edges\[?.?0"):
        annotation.read_graph(path, graphs.yard(tmp_path / "yard"))


def test_a_graph_with_trips_is_written_as_it_is_read(tmp_path):
    further = annotation.Trips(
        nodes={
            "gate": annotation.Node(kind="waypoint", position=(1.0, 1.0), radius=1.0, entrance=0.5, errand=(1.0, 2.0)),
            "door": annotation.Node(kind="waypoint", position=(-1.0, 1.0), radius=1.0, entrance=True),
        },
        edges=[annotation.Edge(between=("n0", "gate")), annotation.Edge(between=("gate", "door"))],
    )
    made = graphs.ring(2).model_copy(update={"trips": further})
    path = tmp_path / "graph.yaml"
    path.write_text(annotation.to_yaml(made))
    read = files.load(path, annotation.Annotation, annotation.check)
    assert read.with_trips().nodes == made.with_trips().nodes
    assert annotation.to_yaml(read) == annotation.to_yaml(made)
    graph = annotation.build_graph(read.with_trips(), None)
    assert graph.entrance[graph.names.index("gate")] == 0.5
    assert graph.entrance[graph.names.index("door")] == annotation.RATE
    assert not annotation.build_graph(read, None).entrance.any()


@pytest.mark.night
def test_gradients_are_finite():
    scenario = sean_jax.make(
        "warehouse", behavior="graph", routing="trips", people=24, walking_groups=(0.3, 0.0), dynamics="twin",
        temperature=0.5, time_limit=10.0,
    )  # fmt: skip
    keys = jax.random.key(4)

    def spread(strength):
        walking = replace(scenario.forces.walking, speed_mean=strength)
        people, memory = walk(replace(scenario, forces=scenario.forces.replace(walking=walking)), keys, 60)
        return people.position.sum() + memory.log_chance[-1]

    value, gradient = jax.value_and_grad(spread)(scenario.forces.walking.speed_mean)
    assert np.isfinite(value) and np.isfinite(gradient)

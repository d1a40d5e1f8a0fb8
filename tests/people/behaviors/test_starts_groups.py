"""Walking groups: who belongs together, where they start, that they stay side by side, and what they leave alone."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import social_forces
from sean_jax.core.geometry import crosses_box
from sean_jax.people.behaviors import starts
from sean_jax.people.behaviors.starts import WalkingGroups
from sean_jax.social_forces import Crowd
from sean_jax.studies.inverse_graph.measuring import begin_alone
from sean_jax.studies.prediction import predict
from support import crowds, walkers

PEOPLE, SHARES = 24, (0.35, 0.25)  # four pairs and two triples
MEMBERS = [(10, 11), (12, 13), (14, 15), (16, 17), (18, 19, 20), (21, 22, 23)]
begin = jax.jit(begin_alone)
TASKS = {"random": "random_ab_nav", "graph": "join_group"}


@pytest.fixture(scope="module", params=["random", "graph"])
def mixed(request):
    """A scenario with walking groups, people at their starts, and 60 s of an episode of them alone."""
    scenario = sean_jax.make(
        behavior=request.param, task=TASKS[request.param], people=PEOPLE, walking_groups=SHARES, dynamics="twin"
    )
    start = begin(scenario, jax.random.key(3))
    history = jax.jit(lambda start: crowds.walk(scenario, start, 600))(start)
    return scenario, start, jax.tree.map(np.asarray, history)


@pytest.mark.parametrize(("people", "shares", "pairs", "triples"), [
    (62, (0.0, 0.0), 0, 0), (62, (0.3, 0.2), 9, 4), (10, (0.2, 0.0), 1, 0), (10, (0.39, 0.59), 1, 1),
    (6, (0.5, 0.5), 1, 1), (3, (0.0, 1.0), 0, 1), (2, (0.99, 0.0), 0, 0),
])  # fmt: skip
def test_shares_round_down_to_whole_walking_groups(people, shares, pairs, triples):
    assert starts.count_walking_groups(people, shares) == WalkingGroups(pairs, triples)
    assert WalkingGroups(pairs, triples).members <= people


@pytest.mark.parametrize("shares", [(-0.1, 0.0), (0.6, 0.5), (0.0, 1.2), (float("nan"), 0.0)])
def test_shares_that_cannot_be_are_refused(shares):
    with pytest.raises(ValueError, match="^walking_groups: .* must be two shares"):
        starts.count_walking_groups(10, shares)
    with pytest.raises(ValueError, match="walking_groups: .* must be "):
        sean_jax.make(behavior="random", task="random_ab_nav", people=10, walking_groups=shares, dynamics="twin")


def test_companions_are_the_others_of_the_walking_group():
    table = np.asarray(WalkingGroups(4, 2).companions(PEOPLE))
    for person in range(PEOPLE):
        walking_group = next((walking_group for walking_group in MEMBERS if person in walking_group), (person,))
        assert sorted(table[person][table[person] >= 0]) == [one for one in walking_group if one != person]
    assert WalkingGroups(0, 0).companions(PEOPLE) is None
    leaders = np.asarray(starts.leaders(jnp.asarray(table), PEOPLE))
    assert leaders.tolist() == [-1] * 10 + [walking_group[0] for walking_group in MEMBERS for _ in walking_group]


def test_nobody_has_company_unless_asked(scenario):
    assert scenario.behavior.companions is None
    walking_group = starts.leaders(None, 5)
    assert walking_group.tolist() == [-1] * 5 and walking_group.dtype == jnp.int32


def test_where_everybody_goes_is_laid_down_walking_groups_are_refused(tmp_path):
    file = tmp_path / "walks.csv"
    file.write_text("frame,id,x,y\n" + "\n".join(f"{k},1,{0.1 * k},0" for k in range(30)))
    with pytest.raises(
        ValueError,
        match="^walking_groups: behavior 'playback' has no such option; choose behavior 'graph' or 'random'",
    ):
        sean_jax.make(
            behavior="playback", task="random_ab_nav", recording=file, walking_groups=(0.5, 0.0), dynamics="twin"
        )


@pytest.mark.slow
def test_more_walking_groups_than_fit_are_refused(mixed):
    tables = mixed[0].behavior.data
    start = np.asarray(tables.start)[:40]
    with pytest.raises(ValueError, match="^walking_groups: 20 do not fit here, .* at most; give smaller") as no:
        starts.find_spawn_clusters(tables.navigation, start, WalkingGroups(20, 0))
    most = int(str(no.value).split("here, ")[1].split(" ")[0])
    assert most < 14
    assert len(starts.find_spawn_clusters(tables.navigation, start, WalkingGroups(0, 0))) == 0


def test_spawn_clusters_share_no_start(mixed):
    spawn_clusters = np.asarray(mixed[0].behavior.data.spawn_clusters)
    assert len(np.unique(spawn_clusters)) == spawn_clusters.size > 3 * 6


def test_walking_groups_start_together_and_everybody_apart(mixed):
    scenario, start, _ = mixed
    people = jax.tree.map(np.asarray, start.pedestrians)
    gap = np.linalg.norm(people.position[:, None] - people.position, axis=-1)
    assert (gap + 9 * np.eye(PEOPLE)).min() >= starts.MIN_DISTANCE - 1e-5
    boxes = scenario.environment.obstacles
    for first, *others in MEMBERS:
        for other in others:
            assert gap[first, other] <= starts.MAX_SPAWN_DISTANCE + 1e-5
            p, q = people.position[first], people.position[other]
            assert not np.asarray(crosses_box(*p, *q, boxes, 0.0)).any()
        assert len(set(people.preferred_speed[[first, *others]].tolist())) == 1
    np.testing.assert_array_equal(
        people.walking_group, [-1] * 10 + [walking_group[0] for walking_group in MEMBERS for _ in walking_group]
    )


def test_walking_groups_are_slower_by_as_much_as_their_companions_take_off(mixed):
    """The same draw of speeds, with and without the slowness."""
    scenario, start, _ = mixed
    slowness = float(scenario.forces.walking.companion_slowdown)
    quick = scenario.replace(forces=scenario.forces.tree_replace({"walking.companion_slowdown": 0.0}))
    free = np.asarray(begin(quick, jax.random.key(3)).pedestrians.preferred_speed)
    less = free - np.asarray(start.pedestrians.preferred_speed)
    np.testing.assert_allclose(less, slowness * np.array([0] * 10 + [1] * 8 + [2] * 6), atol=1e-6)


def test_followers_have_the_leaders_goal_and_walking_groups_take_no_seats(mixed):
    scenario, _, (people, memory) = mixed
    for first, *others in MEMBERS:
        for other in others:
            np.testing.assert_array_equal(memory.goal[:, first], memory.goal[:, other])
    led = [walking_group[0] for walking_group in MEMBERS]
    assert (memory.goal[0, led] != memory.goal[-1, led]).any()  # some have arrived, and gone on together
    if scenario.behavior.name == "graph":
        assert (memory.seat[:, 10:] == -1).all() and (people.group[:, 10:] == -1).all()
        assert (people.group[:, :10] >= 0).any()
        assert not np.asarray(scenario.behavior.data.graph.is_group)[memory.goal[:, 10:]].any()


def test_walking_groups_stay_together_side_by_side(mixed):
    """As measured, spacing .71-.92 m and more than 60 degrees off in 63-89 %, with room for few people and corners."""
    scenario, _, (people, _) = mixed
    found = walkers.together(people.position[100:], people.velocity[100:], np.asarray(scenario.behavior.companions))
    assert 0.6 < found[2]["spacing"] < 0.95 and 0.6 < found[3]["spacing"] < 0.95
    assert found[2]["beside"] > 0.5 and found[3]["beside"] > 0.3
    assert found[2]["apart"] < 0.05 and found[3]["apart"] < 0.15


def test_walking_groups_in_the_open_walk_abreast_at_the_measured_distance_and_speed():
    parameters = social_forces.preset("helbing1995")
    found = {size: walkers.together(*walkers.in_the_open(parameters, size, 32, 25.0))[size] for size in (1, 2, 3)}
    for size in (2, 3):
        assert 0.71 <= found[size]["spacing"] <= 0.92
        assert found[size]["beside"] > 0.89 and found[size]["apart"] == 0.0
    assert 0.04 <= found[1]["speed"] - found[2]["speed"] <= 0.15
    assert found[3]["speed"] < found[2]["speed"]


def test_directions_of_the_leader_equal_a_plain_loop():
    """Members near the leader, whose own direction is at most 60 degrees off, go in the leader's direction."""
    random, number = np.random.default_rng(4), 300
    group = np.where(random.random(number) < 0.8, random.integers(0, 40, number), -1).astype(np.int32)
    place, velocity = random.uniform(-1.5, 1.5, (number, 2)), random.normal(0, 1, (number, 2))
    people = SimpleNamespace(position=jnp.asarray(place, jnp.float32), walking_group=jnp.asarray(group))
    found = starts.walk_abreast(people, jnp.asarray(velocity, jnp.float32))
    expected, turned = velocity.copy(), 0
    for k in np.flatnonzero(group >= 0):
        ahead, own = velocity[group[k]], np.linalg.norm(velocity[k])
        cosine = ahead @ velocity[k] / (np.linalg.norm(ahead) * own)
        if np.linalg.norm(place[group[k]] - place[k]) < 1.5 and cosine > 0.5:
            expected[k] = own * ahead / np.linalg.norm(ahead)
            turned += group[k] != k
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert 20 < turned < 200


def test_the_first_person_is_a_companion_as_any_other():
    """A crowd of pairs alone: person 0 takes as much off a companion's speed as everybody does."""
    groups = WalkingGroups(pairs=2, triples=0)
    walking = SimpleNamespace(companion_slowdown=jnp.float32(0.1))
    scenario = SimpleNamespace(
        behavior=SimpleNamespace(companions=groups.companions(4)), forces=SimpleNamespace(walking=walking)
    )
    speeds = starts.group_speeds(scenario, jnp.asarray([0, 0, 2, 2], jnp.int32), jnp.asarray([1.0, 1.5, 1.2, 0.9]))
    np.testing.assert_allclose(speeds, [0.9, 0.9, 1.1, 1.1], rtol=1e-6)


def test_cohesion_of_strength_zero_is_none():
    names = ("cohesion.gaze", "cohesion.attraction", "cohesion.repulsion", "contact.stiffness")
    parameters = social_forces.preset("helbing1995").tree_replace(dict.fromkeys(names, 0.0))
    people = walkers.walkers(jnp.array([[0.0, 0.0], [3.0, 0.3], [0.1, 0.2]]), jnp.ones((3, 2)))
    companions = jnp.array([[1, 2], [0, 2], [0, 1]], jnp.int32)
    crowd = Crowd(parameters, people, *people.heading.T, None, None, None, 0.0, companions)
    force = parameters.cohesion.person(crowd)
    np.testing.assert_array_equal(np.asarray(force), 0.0)


def test_who_is_absent_is_nobodys_company():
    parameters = social_forces.preset("helbing1995")
    people = walkers.walkers(jnp.array([[0.0, 0.0], [3.0, 0.3], [0.1, 0.2]]), jnp.ones((3, 2)))
    people = people.replace(present=jnp.array([True, False, False]))
    companions = jnp.array([[1, 2], [0, 2], [0, 1]], jnp.int32)
    crowd = Crowd(parameters, people, *people.heading.T, None, None, None, 0.0, companions)
    force = parameters.cohesion.person(crowd)
    np.testing.assert_array_equal(np.asarray(force)[:, 0], 0.0)


@jax.jit
def _aligned(parameters, desired, companions):
    """The part (N, 2) m/s2 of cohesion without gaze that alignment adds."""
    parameters = parameters.tree_replace({"cohesion.gaze": 0.0})
    place = jnp.array([[0.0, 0.0], [3.0, 0.3], [0.1, 0.2]])
    people = walkers.walkers(place, jnp.ones((3, 2))).replace(desired_velocity=desired)
    forces = [parameters.tree_replace({"cohesion.alignment": share}) for share in (1.0, 0.0)]
    crowds = [Crowd(each, people, *people.heading.T, None, None, None, 0.0, companions) for each in forces]
    with_it, without = (jnp.stack(crowd.forces.cohesion.person(crowd), -1) for crowd in crowds)
    return with_it - without


def test_aligned_companions_desire_the_mean_of_their_velocities():
    parameters = social_forces.preset("helbing1995")
    desired = jnp.array([[1.0, 0.2], [1.4, -0.1], [0.5, 0.0]])
    pair = jnp.array([[1, -1], [0, -1], [-1, -1]], jnp.int32)
    drive = _aligned(parameters, desired, pair) * parameters.walking.relaxation_time
    mean = desired[:2].mean(0)
    np.testing.assert_allclose(drive, jnp.stack([mean - desired[0], mean - desired[1], jnp.zeros(2)]), atol=1e-5)
    trio = jnp.array([[1, 2], [0, 2], [0, 1]], jnp.int32)
    drive = _aligned(parameters, desired, trio) * parameters.walking.relaxation_time
    np.testing.assert_allclose(drive, desired.mean(0, keepdims=True) - desired, atol=1e-5)
    slope = jax.grad(lambda desired: (_aligned(parameters, desired, trio) ** 2).sum())(jnp.ones((3, 2)))
    np.testing.assert_allclose(slope, 0.0, atol=1e-5)  # finite where all agree


def test_gaze_does_not_slow_aligned_companions():
    """One walks ahead of the others and brakes; without alignment nobody hurries."""
    names = ("cohesion.attraction", "cohesion.repulsion")
    parameters = social_forces.preset("helbing1995").tree_replace(dict.fromkeys(names, 0.0))
    companions = jnp.array([[1, 2], [0, 2], [0, 1]], jnp.int32)
    people = walkers.walkers(jnp.array([[1.0, 0.1], [0.0, 0.8], [0.0, 0.0]]), jnp.tile(jnp.array([1.2, 0.0]), (3, 1)))
    people = people.replace(heading=jnp.tile(jnp.array([1.0, 0.0]), (3, 1)))
    people = people.replace(desired_velocity=people.velocity)
    forces = []
    for share in (1.0, 0.0):
        own = parameters.tree_replace({"cohesion.alignment": share})
        crowd = Crowd(own, people, *people.heading.T, None, None, None, 0.0, companions)
        forces.append(np.asarray(own.cohesion.person(crowd)[0]))
    aligned, printed = forces
    assert printed[0] < -0.5 and (printed[1:] >= -1e-6).all()
    np.testing.assert_allclose(aligned, printed - printed.mean(), atol=1e-5)


def test_companions_are_predicted_with_their_mean_velocity():
    usual = social_forces.preset("calibrated")
    forces = social_forces.build([usual.walking, usual.cohesion.replace(alignment=1.0)])
    time = 0.4 * jnp.arange(8.0)[:, None]
    tracks = jnp.stack([jnp.concatenate([speed * time, y + 0.0 * time], 1) for speed, y in ((1.0, 0.0), (1.1, 0.7))], 1)
    walked = predict(forces, tracks, 0.4, 12, settled=0.5)[-1] - tracks[-1]
    np.testing.assert_allclose(walked[:, 0], 1.05 * 4.8, rtol=0.02)


@pytest.mark.night
@pytest.mark.parametrize("behavior", list(TASKS))
def test_walking_groups_among_other_people(behavior):
    """The warehouse's own number of people, half of them in walking groups."""
    scenario = sean_jax.make(behavior=behavior, task=TASKS[behavior], dynamics="twin", walking_groups=(0.3, 0.3))
    found = walkers.together(*walkers.in_scenario(scenario, 8))
    assert 0.54 <= found[2]["spacing"] <= 0.92 and 0.54 <= found[3]["spacing"] <= 0.92
    assert 0.63 <= found[2]["beside"] <= 0.95  # measured: .63 to .89
    assert found[2]["apart"] < 0.02 and found[3]["apart"] < 0.05
    alone, pairs, triples = (found[size]["speed"] for size in (1, 2, 3))
    assert alone > pairs - 0.02 and pairs > triples - 0.02  # measured: slower in four of five places

"""Situations as SEAN 2.0's code has them, those beyond the paper's five, and groups from positions and facing."""

import itertools
import math
import runpy
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import classifiers
from sean_jax.classifiers import MORE_SITUATIONS, SEAN2_SITUATIONS, SITUATIONS
from sean_jax.core.data_types import Obstacles
from support.checkout import ROOT
from support.people import people_at, snapshot_of

D, V, A = 2.4, 0.4, np.pi / 12
SLOTS = 7


@jax.jit
def sean2(snapshot):
    return classifiers.classify(snapshot, classifiers.sean2_thresholds(), tuple(SEAN2_SITUATIONS.items()))


@jax.jit
def more(snapshot):
    return classifiers.classify(snapshot, classifiers.thresholds(), tuple(MORE_SITUATIONS.items()))


def turned(degrees, length=1.0):
    return (length * math.cos(math.radians(degrees)), length * math.sin(math.radians(degrees)))


AHEAD, LEFT, BACK, RIGHT = turned(0), turned(90), turned(180), turned(-90)


def boxes(*rows) -> Obstacles:
    """Rows of center x, y and half extent x, y; a fifth number is the height [m], 2 otherwise, a sixth the yaw."""
    filled = np.array([(*row, *(2.0, 0.0)[len(row) - 4 :]) for row in rows], np.float32)
    return Obstacles(
        center=jnp.asarray(filled[:, :2]),
        half_extent=jnp.asarray(filled[:, 2:4]),
        height=jnp.asarray(filled[:, 4]),
        yaw=jnp.asarray(filled[:, 5]),
    )


FAR_AWAY = boxes((90, 90, 1, 1), (90, 80, 1, 1))


def snapshot(people=(), heading=AHEAD, speed=0.5, obstacles=FAR_AWAY, start=(9, 9), goal=(9, 0), groups=(-1, -1)):
    """A robot at the origin; people are (position, heading, speed); spare slots are absent and stand right ahead."""
    rows = [*people, *[((0.5, 0.0), AHEAD, 0.5)] * (SLOTS - len(people))]
    places, headings, speeds = (np.array(part, np.float32) for part in zip(*rows, strict=True))
    velocity, there = headings * speeds[:, None], np.arange(SLOTS) < len(people)
    persons = people_at(places, velocity=velocity, heading=headings, present=there)
    way = {"start": start, "goal": goal, "start_group": groups[0], "goal_group": groups[1]}
    velocity = np.multiply(heading, speed)
    return jax.device_put(snapshot_of(persons, heading=heading, velocity=velocity, **way, obstacles=obstacles))


def by_sean2(*args, **kwargs) -> set[str]:
    flags = np.asarray(sean2(snapshot(*args, **kwargs)))
    return {name for name, flag in zip(SEAN2_SITUATIONS, flags, strict=True) if flag}


def beyond(*args, **kwargs) -> set[str]:
    flags = np.asarray(more(snapshot(*args, **kwargs)))
    return {name for name, flag in zip(MORE_SITUATIONS, flags, strict=True) if flag}


def test_sean2_walks_at_its_own_speed():
    assert by_sean2([((1, 0), LEFT, 0.41)]) == {"cross_path"}
    assert by_sean2([((1, 0), LEFT, 0.39)]) == set()


def test_sean2_down_path_is_walked_either_way():
    assert by_sean2([((1, 0), AHEAD, 0.5)]) == by_sean2([((1, 0), BACK, 0.5)]) == {"down_path"}
    assert by_sean2([((1, 0), AHEAD, 0.0)]) == set()  # as printed it would hold for who stands
    limits = {14.9: {"down_path"}, 15.1: set(), 164.9: set(), 165.1: {"down_path"}, 75.1: {"cross_path"}, 74.9: set()}
    for degrees, names in limits.items():
        assert by_sean2([((1, 0), turned(degrees), 0.5)]) == names


def test_sean2_goes_by_motion_and_not_by_orientation():
    here = snapshot([((1, 0), AHEAD, 0.5)], heading=LEFT, speed=0.0)
    assert by_sean2([((1, 0), AHEAD, 0.5)], heading=LEFT, speed=0.0) == {"cross_path"}  # stands: its heading
    sideways = replace(here, velocity=jnp.array([0.3, 0.0]))
    assert {name for name, flag in zip(SEAN2_SITUATIONS, sean2(sideways), strict=True) if flag} == {"down_path"}


def test_sean2_groups_need_anybody_near_and_the_robot_near_the_place():
    stranger = [((1, 0), LEFT, 0.0)]
    assert by_sean2(stranger, goal=(2.3, 0), groups=(-1, 3)) == {"join_group"}
    assert by_sean2(stranger, goal=(0, 0), groups=(-1, 3)) == {"join_group"}  # no end at the goal
    assert by_sean2(stranger, goal=(2.5, 0), groups=(-1, 3)) == set()
    assert by_sean2(stranger, goal=(2.3, 0)) == set()
    assert by_sean2(stranger, start=(0, -2.3), groups=(3, -1)) == {"leave_group"}
    assert by_sean2(stranger, start=(0, -2.5), groups=(3, -1)) == set()
    assert by_sean2([((3, 0), LEFT, 0.0)], start=(0, 0), goal=(0, 0), groups=(3, 3)) == {"empty"}


def test_blind_corner():
    """A block stands to the left of the robot's way up; the person comes round its upper side."""
    corner = boxes((-3.0, 2.0, 2.2, 1.5), (90, 90, 1, 1))  # x from -5.2 to -0.8, y from 0.5 to 3.5
    coming = ((-2.5, 4.2), AHEAD, 0.5)  # above the block, towards the robot's way at x = 0
    meeting = {"heading": LEFT, "obstacles": corner}
    near_top = ((-1.2, 4.2), AHEAD, 0.5)
    assert beyond([((-2.0, 3.55), AHEAD, 0.5)], **meeting) == {"blind_corner"}
    assert beyond([((-2.0, 3.55), AHEAD, 0.5)], heading=LEFT) == set()  # no corner
    assert beyond([((-2.0, 3.55), AHEAD, 0.5)], heading=LEFT, obstacles=None) == set()  # nothing known
    low = boxes((-3.0, 2.0, 2.2, 1.5, 0.8), (90, 90, 1, 1))
    assert beyond([((-2.0, 3.55), AHEAD, 0.5)], heading=LEFT, obstacles=low) == set()  # seen over it
    assert beyond([((-2.0, 3.55), BACK, 0.5)], **meeting) == set()  # goes away
    assert beyond([((-2.0, 3.55), AHEAD, 0.0)], **meeting) == set()  # stands
    assert beyond([coming], **meeting) == set()  # meets 4.2 m ahead: out of reach
    assert beyond([near_top], **meeting) == set()
    assert beyond([((-0.7, 3.55), AHEAD, 0.5)], **meeting) == set()  # in sight
    wall = boxes((-3.0, 2.0, 2.2, 1.5), (0.0, 2.0, 0.5, 0.2, 0.3))
    assert beyond([((-2.0, 3.55), AHEAD, 0.5)], heading=LEFT, obstacles=wall) == set()  # its way is blocked, lowly


def test_narrow_passage():
    """Both radii and the personal distance make 1.56 m."""
    somebody = [((2.0, 0.0), LEFT, 0.0)]
    along = [(turned(30, 2.0), LEFT, 0.0)]

    def hallway(width):
        half = width / 2
        return boxes((0.0, half + 0.5, 4.0, 0.5), (0.0, -half - 0.5, 4.0, 0.5))

    assert beyond(somebody, obstacles=hallway(1.5)) == {"narrow_passage"}
    assert beyond(somebody, obstacles=hallway(1.6)) == set()
    assert beyond([((2.5, 0.0), LEFT, 0.0)], obstacles=hallway(1.5)) == set()  # nobody is near
    assert beyond(somebody, obstacles=None) == set()
    doorway = boxes((1.0, 2.5, 0.1, 2.0), (1.0, -2.5, 0.1, 2.0))
    assert beyond(somebody, obstacles=doorway) == {"narrow_passage"}
    assert beyond(somebody, obstacles=doorway, heading=BACK) == set()  # behind
    far = boxes((1.5, 2.5, 0.1, 2.0), (1.5, -2.5, 0.1, 2.0))
    assert beyond(somebody, obstacles=far) == set()
    one_side = boxes((0.0, 0.8, 4.0, 0.5), (90, 90, 1, 1))
    assert beyond(somebody, obstacles=one_side) == set()
    turned_hall = boxes((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    turned_hall = replace(
        turned_hall,
        center=jnp.array([turned(120, 1.2), turned(-60, 1.2)], jnp.float32),
        half_extent=jnp.full((2, 2), 0.5, jnp.float32).at[:, 0].set(4.0),
        yaw=jnp.full(2, math.radians(30), jnp.float32),
    )  # 1.4 m wide, along 30 degrees
    assert beyond(along, obstacles=turned_hall, heading=turned(30)) == {"narrow_passage"}
    blocked = boxes((0.7, 0.0, 0.1, 4.0), (1.0, 0.6, 0.1, 0.1))  # narrow behind a wall does not count
    assert beyond(somebody, obstacles=blocked) == {"occlusion"}


def test_beyond_under_vmap_equals_a_loop():
    snapshots = [
        snapshot([((1.5, 0.3), AHEAD, 0.25), ((3.0, 0.5), BACK, 0.5)]),
        snapshot([((-2.0, 3.55), AHEAD, 0.5)], heading=LEFT, obstacles=boxes((-3.0, 2.0, 2.2, 1.5), (90, 90, 1, 1))),
        snapshot(),
    ]
    together = jax.vmap(more)(jax.tree.map(lambda *leaves: jnp.stack(leaves), *snapshots))
    np.testing.assert_array_equal(np.asarray(together), np.stack([more(one) for one in snapshots]))
    assert together.dtype == jnp.bool_ and np.asarray(together).sum() == 3


def test_make_takes_sets_of_situations(scenario):
    assert tuple(name for name, _ in scenario.situations) == tuple(SITUATIONS)
    made = sean_jax.make("warehouse", people=4, dynamics="twin", situations="sean2")
    assert made.situations == tuple(SEAN2_SITUATIONS.items()) and float(made.thresholds.walking) == pytest.approx(0.4)
    made = sean_jax.make("warehouse", people=4, dynamics="twin", situations=SITUATIONS | MORE_SITUATIONS)
    assert made.situations == tuple(classifiers.SITUATION_SETS["more"].items())
    assert float(made.thresholds.walking) == pytest.approx(1.4)
    state = jax.eval_shape(sean_jax.reset, made, jax.random.key(0))
    assert state.situations.shape == (15,)
    for wrong, words in (("seen2", "did you mean 'sean2'"), ({}, "at least one")):
        with pytest.raises(ValueError, match=words):
            sean_jax.make(situations=wrong)


def close(snapshot):
    """Somebody is within 1 m: a situation that needs no thresholds."""
    gap = snapshot.people.position - snapshot.position[None, :]
    return (((gap * gap).sum(1) < 1.0) & snapshot.people.present).any()


def test_a_function_is_a_situation():
    """With thresholds or without; what it gives is checked when the program is traced."""
    mine = classifiers.as_situation(close, "close")
    rules = (("empty", SITUATIONS["empty"]), ("close", mine))
    look = jax.jit(lambda here: classifiers.classify(here, classifiers.thresholds(), rules))
    assert look(snapshot([((0.9, 0), LEFT, 0.0)])).tolist() == [False, True]
    assert look(snapshot([((1.1, 0), LEFT, 0.0)])).tolist() == [False, False]
    assert classifiers.as_situation(close, "close") == mine, "or a scenario made again would be compiled again"
    assert hash(classifiers.as_situation(close, "close")) == hash(mine) and classifiers.as_situation(mine) is mine
    near = classifiers.as_situation(lambda snapshot, thresholds: close(snapshot) & (thresholds.near > 1.0), "near")
    assert near(snapshot([((0.9, 0), LEFT, 0.0)]), classifiers.thresholds())
    assert classifiers.as_situation(SITUATIONS["empty"], "empty") is SITUATIONS["empty"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: classifiers.as_situation(close, "overall"), "'overall' means something else"),
        (lambda: classifiers.as_situation(7, "seven"), "seven is 7; give a function"),
        (lambda: classifiers.as_situation(lambda: True, "nothing"), "give a function"),
        (
            lambda: classifiers.as_situation(lambda here: here.people.present, "all")(snapshot(), None),
            r"gives bool \(7,\), not bool \(\)",
        ),
        (
            lambda: classifiers.as_situation(lambda here: here.position[0], "x")(snapshot(), None),
            r"gives float32 \(\), not bool \(\)",
        ),
    ],
)
def test_what_is_no_situation_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as refused:
        call()
    assert "\n" not in str(refused.value)


def groups_of(labels) -> set[frozenset]:
    labels = np.asarray(labels)
    return {frozenset(np.flatnonzero(labels == label).tolist()) for label in set(labels.tolist()) - {-1}}


def partition_by_hand(votes, price) -> set[frozenset]:
    """Ward's linkage in double precision, every merger priced by the sums of squares themselves."""
    clusters = [[k] for k in range(len(votes))]

    def spread(members):
        return ((votes[members] - votes[members].mean(0)) ** 2).sum()

    while len(clusters) > 1:
        costs = {
            (a, b): spread(clusters[a] + clusters[b]) - spread(clusters[a]) - spread(clusters[b])
            for a, b in itertools.combinations(range(len(clusters)), 2)
        }
        a, b = min(costs, key=costs.__getitem__)
        if costs[a, b] >= price:
            break
        clusters[a] += clusters.pop(b)
    return {frozenset(members) for members in clusters if len(members) > 1}


def test_conversation_by_hand():
    """Three face each other, two stand face to face, one passes by, and an absent one stands in the middle."""
    angles = np.deg2rad([90, 210, 330])
    ring = 0.7 * np.stack([np.cos(angles), np.sin(angles)], -1)
    position = np.concatenate([ring, [[5, 0], [6, 0]], [[0.5, 3.5]], [[0, 0]]]).astype(np.float32)
    heading = np.concatenate([-ring / 0.7, [[1, 0], [-1, 0]], [[0, 1]], [[1, 0]]]).astype(np.float32)
    present = jnp.arange(7) < 6
    votes = classifiers.o_space_votes(jnp.asarray(position), jnp.asarray(heading))
    found = classifiers.o_space_groups(votes, present)
    assert found.dtype == jnp.int32 and np.asarray(found).tolist() == [0, 0, 0, 3, 3, -1, -1]
    away = classifiers.o_space_votes(jnp.asarray(position[:5]), -jnp.asarray(heading[:5]), 1.5)
    assert (classifiers.o_space_groups(away, present[:5]) == -1).all()  # back to back is no conversation


def test_partition_equals_double_precision_and_vmap():
    random = np.random.default_rng(0)
    votes = random.uniform(0, 5, (24, 8, 2)).astype(np.float32)
    present = np.arange(8)[None] < random.integers(0, 9, (24, 1))
    together = jax.jit(jax.vmap(classifiers.o_space_groups))(jnp.asarray(votes), jnp.asarray(present))
    for one, there, labels in zip(votes.astype(float), present, np.asarray(together), strict=True):
        assert groups_of(labels) == partition_by_hand(one[there], classifiers.conversation.PRICE)
    assert max(len(groups_of(labels)) for labels in np.asarray(together)) >= 2


def test_match_groups_by_hand():
    present = jnp.ones(6, bool)

    def count(estimated, annotated, tolerance=2 / 3):
        arrays = (jnp.array(labels, jnp.int32) for labels in (estimated, annotated))
        return np.asarray(classifiers.match_groups(*arrays, present, tolerance)).tolist()

    assert count([0, 0, 0, 3, 3, -1], [1, 1, 1, 2, 2, -1]) == [2, 2, 2]
    assert count([0, 0, -1, -1, -1, -1], [1, 1, 1, -1, -1, -1]) == [1, 1, 1]  # two of three
    assert count([0, 0, -1, -1, -1, -1], [1, 1, 1, -1, -1, -1], 1.0) == [0, 1, 1]
    assert count([0, 0, 0, 0, 0, -1], [1, 1, 1, -1, -1, -1]) == [0, 1, 1]  # two too many
    assert count([0, 0, 0, 0, -1, -1], [1, 1, 1, -1, -1, -1]) == [1, 1, 1]
    assert count([0, 0, 2, 2, -1, -1], [1, 1, 1, 1, -1, -1]) == [0, 2, 1]
    assert count([-1] * 6, [1, 1, -1, -1, -1, -1]) == [0, 0, 1]
    assert count([-1, 2, 2, -1, -1, -1], [-1, 5, -1, -1, -1, -1]) == [0, 1, 0]  # one is no group


def test_figure_of_the_documentation_shows_what_it_says():
    """Each example that docs/situations.py draws is of the one situation that it is named after."""
    file = ROOT / "docs" / "situations.py"
    examples = runpy.run_path(str(file))
    assert set(examples["EXAMPLES"]) == set(MORE_SITUATIONS)
    for name, example in examples["EXAMPLES"].items():
        flags = np.asarray(more(examples["snapshot"](*example)))
        assert {other for other, flag in zip(MORE_SITUATIONS, flags, strict=True) if flag} == {name}
    assert set(examples["PAPER"]) == set(classifiers.SITUATIONS)
    for name, example in examples["PAPER"].items():
        examples["check"](name, example, classifiers.SITUATIONS)  # raises SystemExit
    with pytest.raises(SystemExit, match=r"empty: the classifiers give \['cross_path'\]"):
        examples["check"]("empty", examples["PAPER"]["cross_path"], classifiers.SITUATIONS)

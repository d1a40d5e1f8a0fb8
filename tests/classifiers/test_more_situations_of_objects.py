"""Situations of urgency and of the configuration of objects, against double-precision loops over random snapshots."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import classifiers
from sean_jax.classifiers import more_situations
from sean_jax.core.data_types import Obstacles, Snapshot
from support.people import people_at, snapshot_of

NAMES = ("collision_course", "hurrying", "occlusion", "activity_space")
RULES = tuple((name, classifiers.MORE_SITUATIONS[name]) for name in NAMES)
PEOPLE, BOXES = 4, 3
TOUCH = 0.16 + 0.2  # m, both radii


@jax.jit
def found(snapshots, values):
    return jax.vmap(lambda one: classifiers.classify(one, values, RULES))(snapshots)


def drawn(number: int, seed: int) -> Snapshot:
    """Random snapshots; half of the people stand, one in five is absent, and boxes are turned and of many heights."""
    random = np.random.default_rng(seed)

    def unit(*shape):
        angle = random.uniform(-np.pi, np.pi, shape)
        return np.stack([np.cos(angle), np.sin(angle)], -1)

    speed = random.uniform(0.0, 2.6, (number, PEOPLE, 1)) * (random.random((number, PEOPLE, 1)) < 0.5)
    heading, own = unit(number, PEOPLE), unit(number)
    velocity = speed * heading
    places = random.uniform(-3.0, 3.0, (number, PEOPLE, 2))
    robot = random.uniform(-0.5, 0.5, (number, 2))
    middles = random.uniform(-3.0, 3.0, (number, BOXES, 2))
    middles[::2, 0] = (places + heading * random.uniform(0.5, 3.5, (number, 1, 1)))[::2, 0]  # before the first person
    seen = places[:, 0] + heading[:, 0] * random.uniform(0.0, 2.0, (number, 1)) + robot
    people = people_at(
        places,
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=random.integers(-5, 2, (number, PEOPLE)).clip(-1),
        present=random.random((number, PEOPLE)) < 0.8,
    )
    here = snapshot_of(
        people,
        np.where(random.random((number, 1)) < 0.5, robot, seen),  # or before the first person
        heading=own,
        velocity=own * random.uniform(0.0, 1.0, (number, 1)) * (random.random((number, 1)) < 0.8),
        situations=np.zeros((number, 0), bool),
        obstacles=Obstacles(
            center=middles,
            half_extent=random.uniform(0.1, 0.9, (number, BOXES, 2)),
            yaw=random.uniform(-np.pi, np.pi, (number, BOXES)),
            height=random.choice([0.0, 0.6, 1.0, 2.0], (number, BOXES)),
        ),
    )
    return jax.device_put(here)


def corners(box) -> np.ndarray:
    """(4, 2) m, around."""
    c, s = math.cos(box.yaw), math.sin(box.yaw)
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * np.asarray(box.half_extent, float)
    return np.asarray(box.center, float) + signs @ np.array([[c, s], [-s, c]])


def meeting(p, q, a, b) -> tuple[float, float] | None:
    """Shares of the way p to q and of a to b at which these lines cross; None if they are parallel."""
    matrix = np.stack([q - p, a - b], -1)
    return None if abs(np.linalg.det(matrix)) < 1e-12 else tuple(np.linalg.solve(matrix, a - p))


def inside(place, box) -> bool:
    edges = corners(box)
    turns = [np.linalg.det(np.stack([b - a, place - a])) for a, b in zip(edges, np.roll(edges, -1, 0), strict=True)]
    return min(turns) > 0 or max(turns) < 0


def hit(place, way, box) -> float:
    """Share of a way after which it meets a box: 0 inside one, infinite if it does not on that way or beyond."""
    if inside(place, box):
        return 0.0
    edges = corners(box)
    meets = [meeting(place, place + way, a, b) for a, b in zip(edges, np.roll(edges, -1, 0), strict=True)]
    return min((t for t, u in (each for each in meets if each) if t > 0 and 0 <= u <= 1), default=math.inf)


def in_double_precision(one: Snapshot) -> list[bool]:
    """The four situations by other ways: roots of a polynomial, and lines that cross the edges of boxes."""
    values = [False] * 4
    robot, heading, own = (np.asarray(part, float) for part in (one.position, one.heading, one.velocity))
    boxes = [jax.tree.map(lambda leaf, k=k: leaf[k], one.obstacles) for k in range(BOXES)]
    free = min([1.2, *(hit(robot, heading, box) for box in boxes)])
    for k in range(PEOPLE):
        if not one.people.present[k]:
            continue
        place, facing, velocity = (
            np.asarray(part[k], float) for part in (one.people.position, one.people.heading, one.people.velocity)
        )
        gap, relative = place - robot, velocity - own
        polynomial = np.array([relative @ relative, 2 * gap @ relative, gap @ gap - TOUCH**2])
        roots = np.roots(np.trim_zeros(polynomial, "f"))
        first, last = (roots.real.min(), roots.real.max()) if len(roots) == 2 and np.isreal(roots).all() else (1, -1)
        values[0] |= bool(polynomial[2] < 0 or (first < last and last > 0 and first < 3.0 and first > 0))

        speed = np.linalg.norm(velocity)
        if speed > 1.86:
            turn = math.atan2(*(robot - place)[::-1]) - math.atan2(*velocity[::-1])
            away = math.dist(robot, place)
            values[1] |= 0 < away * math.cos(turn) < 3.6 and abs(away * math.sin(turn)) < 1.2

        high = [box for box in boxes if box.height >= 1.0]
        hidden = any(inside(robot, box) or hit(robot, gap, box) < 1 for box in high)
        values[2] |= bool(hidden and np.linalg.norm(gap) < 2.4)

        if speed <= 0.1 and one.people.group[k] < 0:
            depth = min((hit(place, facing, box) for box in boxes if box.height > 0), default=math.inf)
            if depth < 2.4:
                along = (robot - place) @ facing
                beside = np.linalg.norm(robot - place - along * facing)
                within = 0 < along < depth and beside < TOUCH
                meets = meeting(robot, robot + heading, place, place + facing)
                crosses = meets and np.linalg.norm(own) > 0.1 and 0 < meets[0] < free and 0 < meets[1] < depth
                values[3] |= bool(within or crosses)
    return values


def test_they_equal_loops_in_double_precision():
    snapshots = drawn(600, 0)
    together = np.asarray(found(snapshots, classifiers.thresholds()))
    singles = jax.device_get(snapshots)
    expected = [in_double_precision(jax.tree.map(lambda leaf, k=k: leaf[k], singles)) for k in range(600)]
    np.testing.assert_array_equal(together, expected)
    assert (together.sum(0) > 12).all() and (together.sum(0) < 360).all(), together.sum(0)


def test_thresholds_are_leaves_that_widen_them():
    snapshots, usual = drawn(300, 1), classifiers.thresholds()
    before = np.asarray(found(snapshots, usual))
    wider = {"imminent": 6.0, "hurry": 1.0, "hides": 0.5, "engaged": 5.0}
    for k, (name, value) in enumerate(wider.items()):
        after = np.asarray(found(snapshots, dataclasses.replace(usual, **{name: jnp.asarray(value, jnp.float32)})))
        assert (after[:, k] >= before[:, k]).all() and after[:, k].sum() > before[:, k].sum(), name
        others = [other for other in range(4) if other != k]
        np.testing.assert_array_equal(after[:, others], before[:, others])


def person(snapshot: Snapshot, **fields) -> Snapshot:
    """The first snapshot of a batch, with one person, whose fields are given, and the robot at the origin."""
    one = jax.tree.map(lambda leaf: leaf[0], snapshot)
    people = {name: getattr(one.people, name).at[0].set(jnp.asarray(value)) for name, value in fields.items()}
    people["present"] = jnp.arange(PEOPLE) < 1
    return dataclasses.replace(one, people=dataclasses.replace(one.people, **people), position=jnp.zeros(2))


def holds(one: Snapshot) -> set[str]:
    flags = np.asarray(found(jax.tree.map(lambda leaf: leaf[None], one), classifiers.thresholds()))[0]
    return {name for name, flag in zip(NAMES, flags, strict=True) if flag}


NOWHERE = Obstacles(jnp.full((BOXES, 2), 90.0), jnp.ones((BOXES, 2)), jnp.zeros(BOXES), jnp.full(BOXES, 2.0))
AWAY = (math.sqrt(0.5), math.sqrt(0.5))


@pytest.mark.parametrize(
    ("place", "velocity", "own", "names"),
    [
        ((3.3, 0.0), (-0.5, 0.0), (0.5, 0.0), {"collision_course"}),  # in 2.94 s
        ((3.4, 0.0), (-0.5, 0.0), (0.5, 0.0), set()),  # in 3.04 s
        ((2.0, 0.35), (-0.5, 0.0), (0.5, 0.0), {"collision_course"}),
        ((2.0, 0.37), (-0.5, 0.0), (0.5, 0.0), set()),  # passes
        ((2.0, 0.0), (0.6, 0.0), (0.5, 0.0), set()),  # goes away
        ((1.5, 0.0), (0.0, 0.0), (0.5, 0.0), {"collision_course"}),  # stands in the way
        ((0.3, 0.0), (0.0, 0.0), (0.0, 0.0), {"collision_course"}),  # touches already
        ((0.4, 0.0), (0.0, 0.0), (0.0, 0.0), set()),  # both stand
        ((-3.5, 1.1), (1.9, 0.0), (0.5, 0.0), {"hurrying"}),  # from behind
        ((0.3, 3.5), (0.0, -1.9), (0.5, 0.0), {"hurrying"}),  # across, behind the robot by then
        ((-3.5, 1.1), (1.8, 0.0), (0.5, 0.0), set()),  # walks fast
        ((-3.7, 1.1), (1.9, 0.0), (0.5, 0.0), set()),  # far
        ((-3.5, 1.3), (1.9, 0.0), (0.5, 0.0), set()),  # passes
        ((0.5, 1.1), (1.9, 0.0), (0.5, 0.0), set()),  # has passed
    ],
)
def test_urgency_and_what_nearly_is(place, velocity, own, names):
    one = person(drawn(1, 2), position=place, velocity=velocity, heading=AWAY)
    one = dataclasses.replace(one, velocity=jnp.asarray(own), heading=jnp.array([1.0, 0.0]), obstacles=NOWHERE)
    assert holds(one) == names


def box(x: float, y: float, half_x: float, half_y: float, height: float = 2.0) -> Obstacles:
    first = [jnp.array([x, y]), jnp.array([half_x, half_y]), jnp.zeros(()), jnp.array(height)]
    fields = [getattr(NOWHERE, field.name) for field in dataclasses.fields(NOWHERE)]
    return Obstacles(*(leaf.at[0].set(value) for leaf, value in zip(fields, first, strict=True)))


SHELF = {"place": (0.9, 1.0), "obstacle": box(0.9, -0.9, 0.8, 0.2)}  # 1.7 m from the person's place


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (SHELF, {"activity_space"}),  # the way leads through
        ({**SHELF, "own": (0.0, 0.0)}, set()),  # stands before it
        ({**SHELF, "facing": (0.0, 1.0)}, set()),  # looks the other way
        ({**SHELF, "velocity": (0.0, -0.2)}, set()),  # walks
        ({**SHELF, "group": 0}, set()),  # is in conversation
        ({**SHELF, "place": (0.9, 1.8)}, set()),  # looks from 2.5 m
        ({**SHELF, "place": (1.3, 1.0)}, set()),  # the robot is 1.3 m away
        ({**SHELF, "obstacle": box(0.9, -0.9, 0.8, 0.2, 0.0)}, set()),  # the floor's edge
        ({**SHELF, "obstacle": box(0.9, 0.4, 0.8, 0.2)}, {"occlusion"}),  # it is nearer than the robot's way
        ({**SHELF, "place": (0.3, 1.0), "own": (0.0, 0.0)}, {"activity_space"}),  # stands in it
        ({**SHELF, "place": (0.4, 1.0), "own": (0.0, 0.0)}, set()),  # stands beside it
        ({"place": (0.0, 2.3), "obstacle": box(0.0, 1.2, 1.0, 0.1, 1.0), "facing": (0.0, 1.0)}, {"occlusion"}),
        ({"place": (0.0, 2.3), "obstacle": box(0.0, 1.2, 1.0, 0.1, 0.9), "facing": (0.0, 1.0)}, set()),  # low
        ({"place": (0.0, 2.5), "obstacle": box(0.0, 1.2, 1.0, 0.1), "facing": (0.0, 1.0)}, set()),  # not near
        ({"place": (0.0, 2.3), "obstacle": box(1.1, 1.2, 1.0, 0.1), "facing": (0.0, 1.0)}, set()),  # beside
    ],
)
def test_objects_and_what_nearly_is(given, names):
    one = person(
        drawn(1, 3),
        position=given["place"],
        velocity=given.get("velocity", (0.0, 0.0)),
        heading=given.get("facing", (0.0, -1.0)),
        group=given.get("group", -1),
    )
    own = jnp.asarray(given.get("own", (0.5, 0.0)))
    one = dataclasses.replace(one, velocity=own, heading=jnp.array([1.0, 0.0]), obstacles=given["obstacle"])
    assert holds(one) == names
    without = dataclasses.replace(one, obstacles=None)
    assert holds(without) == set(), "nothing is known of objects"


def test_they_are_registered_once():
    assert set(classifiers.OBJECT_SITUATIONS) == {"blind_corner", "narrow_passage", "occlusion", "activity_space"}
    more = {*classifiers.OBJECT_SITUATIONS, "collision_course", "hurrying"}
    assert more <= set(classifiers.MORE_SITUATIONS) and len(classifiers.MORE_SITUATIONS) == 4 + len(more)
    assert not set(classifiers.MORE_SITUATIONS) & set(classifiers.SITUATIONS)


def test_nobody_and_degenerate_states():
    """Nobody present; person and robot at one place, at rest, without a heading, inside a box: no error, no NaN."""
    snapshots = drawn(4, 4)
    one = person(snapshots, position=(0.0, 0.0), velocity=(0.0, 0.0), heading=(0.0, 0.0), group=-1)
    one = dataclasses.replace(one, velocity=jnp.zeros(2), heading=jnp.zeros(2), obstacles=box(0.0, 0.0, 1.0, 1.0))
    assert holds(one) == {"collision_course", "occlusion"}  # they touch, and a box stands on the point between
    nobody = dataclasses.replace(one, people=dataclasses.replace(one.people, present=jnp.zeros(PEOPLE, bool)))
    assert holds(nobody) == set()

    def amount(place):
        people = dataclasses.replace(one.people, position=one.people.position.at[0].set(place))
        here = dataclasses.replace(one, people=people)
        flags = classifiers.classify(here, classifiers.thresholds(), RULES)
        ray = more_situations._ray_length(here.obstacles, place, place)
        return jnp.where(flags, place.sum(), ray).sum()

    places = np.array([*itertools.product((0.0, 1.0), repeat=2)], np.float32)
    assert np.isfinite(jax.jit(jax.vmap(jax.grad(amount)))(places)).all()

"""All situations against their inequalities as margins in double precision, on states about every threshold.

A margin is above zero if its inequality holds: the least margin decides a conjunction, the greatest one "any person".
Cases whose margin is nearly zero are left to the tests of limits. Every drawn quantity lies about its threshold, people
have motions apart from their headings, and some have no direction at all, so each constant and each guard decides.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import classifiers
from sean_jax.core.data_types import Obstacles, Snapshot
from support.people import people_at, snapshot_of

NUMBER, PEOPLE, BOXES = 6000, 7, 3
ROBOT, PERSON = 0.16, 0.2  # m, radii
SURE = 2e-4  # margins below it are left out
SETS = {"paper": classifiers.SITUATIONS, "sean2": classifiers.SEAN2_SITUATIONS, "more": classifiers.MORE_SITUATIONS}
ANOTHER_WAY = "occlusion", "activity_space", "collision_course", "hurrying"  # swept in test_urgency_and_objects


def unit(angle):
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def drawn(seed: int) -> Snapshot:
    """Snapshots whose people, but for one in eight, are one or two, so that one person's margins decide."""
    random = np.random.default_rng(seed)

    def speeds(*shape):
        scales = random.choice([0.02, 0.1, 0.5, 1.0, 2.0], shape)
        return scales * random.uniform(0.0, 2.0, shape) * (random.random(shape) < 0.9)

    robot = random.uniform(-5.0, 5.0, (NUMBER, 2))
    way = random.uniform(-np.pi, np.pi, NUMBER)
    # Headings about the limits of the angles, from 0 to 180 degrees either side of the robot's.
    turn = random.choice([0.0, 15.0, 75.0, 90.0, 105.0, 165.0, 180.0], (NUMBER, PEOPLE)) * random.choice(
        [-1, 1], (NUMBER, PEOPLE)
    )
    facing = way[:, None] + np.deg2rad(turn + random.uniform(-12.0, 12.0, (NUMBER, PEOPLE)))
    heading = unit(facing) * (random.random((NUMBER, PEOPLE, 1)) < 0.95)
    elsewhere = unit(random.uniform(-np.pi, np.pi, (NUMBER, PEOPLE)))
    own = speeds(NUMBER)
    speed = np.where(
        random.random((NUMBER, PEOPLE)) < 0.5,
        np.abs(own[:, None] + random.uniform(-0.5, 0.5, (NUMBER, PEOPLE))),
        speeds(NUMBER, PEOPLE),
    )
    velocity = speed[..., None] * np.where(random.random((NUMBER, PEOPLE, 1)) < 0.7, unit(facing), elsewhere)
    ahead, aside = random.uniform(-4.0, 4.0, (NUMBER, PEOPLE)), random.normal(0.0, 1.0, (NUMBER, PEOPLE))
    ahead = np.where(random.random((NUMBER, PEOPLE)) < 0.3, random.uniform(-0.6, 0.6, (NUMBER, PEOPLE)), ahead)
    ahead[::8] /= 2.0  # crowds
    place = robot[:, None] + ahead[..., None] * unit(way)[:, None] + aside[..., None] * unit(way + np.pi / 2)[:, None]
    here = random.random((NUMBER, PEOPLE)) < np.where(np.arange(NUMBER)[:, None] % 8, 0.2, 0.9)
    drive = np.where(random.random(NUMBER) < 0.8, way, random.uniform(-np.pi, np.pi, NUMBER))
    walls = Obstacles(
        center=robot[:, None] + random.uniform(-2.5, 2.5, (NUMBER, BOXES, 2)),
        half_extent=random.uniform(0.1, 1.0, (NUMBER, BOXES, 2)),
        yaw=random.uniform(-np.pi, np.pi, (NUMBER, BOXES)),
        height=random.choice([0.0, 0.9, 1.1, 2.0], (NUMBER, BOXES)),
    )
    walls.half_extent[::2, 0, 1] = 3.0  # long ones
    corners = slice(1, None, 3)  # one block before the first person, who crosses the robot's way, and nothing else
    ahead, aside = random.uniform(0.8, 3.9, (2, NUMBER, 1))
    side = unit(way + np.pi / 2)
    place[corners, 0] = (robot + ahead * unit(way) + aside * side)[corners]
    heading[corners, 0] = -unit(way + np.pi / 2 + random.uniform(-1.4, 1.4, NUMBER))[corners]
    walls.center[corners, 0] = (robot + 0.5 * ahead * unit(way) + 0.6 * aside * side)[corners]
    walls.half_extent[corners, 0] = 0.35
    walls.center[corners, 1:] += random.choice([4.0, 20.0], (NUMBER, 1, 1))[corners]
    here[corners, 0] = True
    people = people_at(
        place,
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=random.integers(-1, 3, (NUMBER, PEOPLE)),
        present=here,
    )
    return snapshot_of(
        people,
        robot,
        heading=unit(way),
        velocity=own[:, None] * unit(drive),
        start=robot + random.uniform(-3.0, 3.0, (NUMBER, 2)),
        goal=robot + random.uniform(-3.0, 3.0, (NUMBER, 2)) * random.choice([0.1, 1.0], (NUMBER, 1)),
        start_group=random.integers(-1, 3, NUMBER),
        goal_group=random.integers(-1, 3, NUMBER),
        situations=np.zeros((NUMBER, 0), bool),
        obstacles=walls,
    )


@pytest.fixture(scope="module")
def cases():
    """The snapshots, in double precision, and what the package says of them: set -> (NUMBER, S)."""
    snapshots = drawn(5)
    found = {}
    for name, rules in SETS.items():
        values = classifiers.THRESHOLD_SETS[name]()

        def look(one, values=values, rules=rules):
            return classifiers.classify(one, values, tuple(rules.items()))

        found[name] = np.asarray(jax.jit(jax.vmap(look))(jax.device_put(snapshots)))
    exact = jax.tree.map(lambda leaf: leaf.astype(float) if leaf.dtype == np.float32 else leaf, snapshots)
    return exact, {name: dict(zip(SETS[name], flags.T, strict=True)) for name, flags in found.items()}


def every(*margins):
    return np.minimum.reduce(np.broadcast_arrays(*margins))


def anybody(one, *margins):
    return np.where(one.people.present, every(*margins), -np.inf).max(-1)


def truth(flags):
    """The margin of what holds or does not."""
    return np.where(flags, np.inf, -np.inf)


def norm(vector):
    return np.hypot(vector[..., 0], vector[..., 1])


def degrees(first, second):
    """Angles between vectors; NaN where one has no direction."""
    angle = np.rad2deg(np.arctan2(first[..., 1], first[..., 0]) - np.arctan2(second[..., 1], second[..., 0]))
    return np.where((norm(first) > 0) & (norm(second) > 0), np.abs((angle + 180.0) % 360.0 - 180.0), np.nan)


def limit(angle, margin):
    """The margin of an angle [degrees], in the size of the others; none without a direction."""
    return np.where(np.isnan(angle), -np.inf, margin / 10.0)


def looks(one):
    """What the inequalities are about: distances, speeds, parts ahead and aside of the robot."""
    offset = one.people.position - one.position[:, None]
    heading = one.heading[:, None]
    return {
        "distance": norm(offset),
        "speed": norm(one.people.velocity),
        "own": norm(one.velocity)[:, None],
        "ahead": (offset * heading).sum(-1),
        "aside": heading[..., 0] * offset[..., 1] - heading[..., 1] * offset[..., 0],
        "between": degrees(one.people.heading, heading),
    }


def compare(found, margin):
    sure = np.abs(margin) > SURE
    wrong = np.flatnonzero(sure & (found != (margin > 0)))
    assert not len(wrong), f"{len(wrong)} of {sure.sum()}, first {wrong[:5]}"
    assert 20 < (found & sure).sum() < NUMBER - 20, "drawn so that it holds and does not hold"


def test_the_five_of_the_paper(cases):
    one, found = cases
    here, (near, fast, wide) = looks(one), (2.4, 1.4, 15.0)
    angle, close = here["between"], near - here["distance"]
    across, along = limit(angle, wide - np.abs(angle - 90)), limit(angle, wide - angle)
    compare(found["paper"]["cross_path"], anybody(one, close, here["speed"] - fast, across))
    compare(found["paper"]["down_path"], anybody(one, close, along))
    to_goal = norm(one.goal - one.position)
    for name, group in (("join_group", one.goal_group), ("leave_group", one.start_group)):
        member = truth((group[:, None] >= 0) & (one.people.group == group[:, None]))
        margin = anybody(one, close, member)
        compare(found["paper"][name], every(margin, to_goal - 0.2) if name == "join_group" else margin)
    compare(found["paper"]["empty"], -anybody(one, close))


def test_the_five_of_sean2(cases):
    """By motion; a robot below .02 m/s has its heading's direction."""
    one, found = cases
    here, (near, fast, wide) = looks(one), (2.4, 0.4, 15.0)
    moving = here["own"][:, 0] - 0.02
    direction = np.where(moving[:, None] > 0, one.velocity, one.heading)
    angle = degrees(one.people.velocity, direction[:, None])
    walker = every(near - here["distance"], here["speed"] - fast)
    sure = np.abs(moving) > 1e-5
    assert (sure & (moving < 0) & (here["own"][:, 0] > 0)).sum() > 200, "robots that creep"
    assert (sure & (moving > 0) & (moving < 0.1)).sum() > 200, "and robots that are just faster"
    across, along = limit(angle, wide - np.abs(angle - 90)), limit(angle, wide - np.minimum(angle, 180 - angle))
    compare(found["sean2"]["cross_path"], np.where(sure, anybody(one, walker, across), 0.0))
    compare(found["sean2"]["down_path"], np.where(sure, anybody(one, walker, along), 0.0))
    somebody = anybody(one, near - here["distance"])
    for name, group, place in (("join_group", one.goal_group, one.goal), ("leave_group", one.start_group, one.start)):
        compare(found["sean2"][name], every(somebody, truth(group >= 0), near - norm(place - one.position)))
    compare(found["sean2"]["empty"], -somebody)


def test_passing_and_crowds(cases):
    one, found = cases
    here, touch = looks(one), ROBOT + PERSON
    angle, faster = here["between"], here["own"] - here["speed"]
    both = every(here["own"] - 0.1, here["speed"] - 0.1, 1.2 - np.abs(here["aside"]))
    ahead = here["ahead"]
    before = np.where(faster > 0, ahead, -ahead)
    parallel = limit(angle, 15.0 - angle)
    overtaking = every(both, parallel, np.abs(faster) - 0.2, before + touch, 3.6 - before)
    following = every(both, parallel, 0.2 - np.abs(faster), ahead - touch, 3.6 - ahead)
    frontal = every(both, limit(angle, angle - 165.0), ahead, 3.6 - ahead)
    compare(found["more"]["overtaking"], anybody(one, overtaking))
    compare(found["more"]["following"], anybody(one, following))
    compare(found["more"]["frontal_approach"], anybody(one, frontal))
    # Six people on the disc are .332 a square metre.
    inside = np.where(one.people.present, 2.4 - here["distance"], -np.inf)
    compare(found["more"]["crowded"], np.sort(inside, -1)[:, -6])


def edges(walls, grown):
    """Begin and way [m] of the four edges of each box, which is that much larger: (..., W, 4, 2) each."""
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    u, v = unit(walls.yaw)[..., None, :], unit(walls.yaw + np.pi / 2)[..., None, :]
    extent = (walls.half_extent[..., None, :] + grown) * signs
    corner = walls.center[..., None, :] + extent[..., :1] * u + extent[..., 1:] * v
    return corner, np.roll(corner, -1, -2) - corner


def cross(first, second):
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def hits(walls, place, way, grown):
    """Share of ways after which they meet each box: 0 inside one, infinite if they do not. (..., W)"""
    begin, along = edges(walls, grown)
    place, way = place[..., None, None, :], way[..., None, None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = cross(begin - place, along) / cross(way, along)
        beside = cross(begin - place, way) / cross(way, along)
    met = np.where((share > 0) & (beside >= 0) & (beside <= 1), share, np.inf).min(-1)
    return np.where((cross(along, place - begin) > 0).all(-1), 0.0, met)


def blocked(walls, place, way, counts=True):
    """The margin of a box on the straight way: undecided if a millimetre decides."""
    small, large = ((((hits(walls, place, way, grown) < 1.0) & counts).any(-1)) for grown in (-1e-3, 1e-3))
    return np.where(small, np.inf, np.where(large, 0.0, -np.inf))


def test_blind_corners(cases):
    one, found = cases
    here = looks(one)
    result = np.full(NUMBER, -np.inf)
    for k in range(PEOPLE):
        place, heading = one.people.position[:, k], one.people.heading[:, k]
        sine = cross(one.heading, heading)
        safe = np.where(np.abs(sine) > 1e-3, sine, 1.0)
        by_robot = cross(place - one.position, heading) / safe
        by_person = cross(place - one.position, one.heading) / safe
        meeting = one.position + by_robot[:, None] * one.heading
        margin = every(
            here["own"][:, 0] - 0.1,
            here["speed"][:, k] - 0.1,
            7.2 - here["distance"][:, k],
            np.abs(sine) - np.sin(np.deg2rad(15.0)),
            by_robot,
            3.6 - by_robot,
            by_person,
            3.6 - by_person,
            blocked(one.obstacles, one.position, place - one.position, one.obstacles.height >= 1.0),
            -blocked(one.obstacles, one.position, meeting - one.position),
            -blocked(one.obstacles, place, meeting - place),
        )
        result = np.where(one.people.present[:, k], np.maximum(result, margin), result)
    compare(found["more"]["blind_corner"], result)


def test_narrow_passages(cases):
    one, found = cases
    side = np.stack([-one.heading[:, 1], one.heading[:, 0]], -1)

    def free(place, way):
        """Metres to the next box, and whether a millimetre changes much."""
        small, large = (hits(one.obstacles, place, way, grown).min(-1) for grown in (-1e-3, 1e-3))
        return np.minimum(hits(one.obstacles, place, way, 0.0).min(-1), 1e3), (small > large + 0.02)

    forward, unsure = free(one.position, one.heading)
    narrow, doubt = np.full(NUMBER, -np.inf), unsure
    for ahead in 1.2 * np.arange(5) / 4:
        place = one.position + ahead * one.heading
        (left, first), (right, second) = free(place, side), free(place, -side)
        narrow = np.maximum(narrow, every(ROBOT + PERSON + 1.2 - (left + right), forward - ahead + (ahead == 0)))
        doubt = doubt | first | second
    margin = every(narrow, anybody(one, 2.4 - looks(one)["distance"]))
    assert doubt.mean() < 0.3
    compare(found["more"]["narrow_passage"], np.where(doubt, 0.0, margin))


def test_limits_of_the_constants_are_as_documented():
    """Each threshold by its own value: a table of the defaults would be compared with itself."""
    values = {
        "near": 2.4, "walking": 1.4, "angle": np.pi / 12, "arrival": 0.2, "reach": 3.6, "personal": 1.2, "moving": 0.1,
        "gaining": 0.2, "crowd": 0.31, "hides": 1.0, "engaged": 2.4, "imminent": 3.0, "hurry": 1.86,
    }  # fmt: skip
    for name, more in (("paper", {}), ("sean2", {"walking": 0.4}), ("more", {})):
        made = classifiers.THRESHOLD_SETS[name]()
        assert {field: float(getattr(made, field)) for field in values} == pytest.approx(values | more)
    one = jnp.asarray(7.0)
    for field in values:
        changed = classifiers.thresholds(**{field: one})
        assert [name for name in values if float(getattr(changed, name)) == 7.0] == [field]


def test_distances_and_speeds_at_their_limits():
    """Numbers that float32 has exactly: what shall be less than a limit is not there at it, and "at least" is."""
    ahead = np.array([[1.0, 0.0]], np.float32)
    one = jax.tree.map(lambda leaf: leaf[0] if np.ndim(leaf) else leaf, drawn(1))
    rules = tuple(classifiers.MORE_SITUATIONS.items())
    values = classifiers.thresholds(near=2.0, angle=0.5, reach=3.0, personal=1.0, moving=0.25, gaining=0.25, crowd=0.1)

    @jax.jit
    def look(place, velocity, heading, number):
        people = one.people.replace(
            position=jnp.zeros((PEOPLE, 2)).at[:].set(place),
            velocity=jnp.zeros((PEOPLE, 2)).at[:].set(velocity),
            heading=jnp.zeros((PEOPLE, 2)).at[:].set(heading),
            present=jnp.arange(PEOPLE) < number,
        )
        robot = {"position": jnp.zeros(2), "heading": ahead[0], "velocity": ahead[0]}
        here = one.replace(people=people, robot_radius=0.25, person_radius=0.25, **robot)
        return classifiers.classify(here, values, rules)

    def seen(x, y, speed, number=1):
        walker = jnp.array([speed, 0.0])
        flags = look(jnp.array([x, y]), walker, jnp.sign(walker), number)
        return {name for (name, _), flag in zip(rules, np.asarray(flags), strict=True) if flag} & {
            "overtaking", "following", "frontal_approach", "crowded"
        }  # fmt: skip

    least = 2.0**-10
    # A person who is slower by .25 m/s is overtaken and not followed.
    assert seen(2.5, 0.0, 0.75) == {"overtaking"} and seen(2.5, 0.0, 0.75 + least) == {"following"}
    # The slower one ahead, by more than minus the sum of the radii and less than the reach.
    assert seen(-0.5, 0.0, 0.5) == set() and seen(least - 0.5, 0.0, 0.5) == {"overtaking"}
    assert seen(3.0, 0.0, 0.5) == set() and seen(3.0 - least, 0.0, 0.5) == {"overtaking"}
    assert seen(0.5, 0.0, 1.0) == set() and seen(0.5 + least, 0.0, 1.0) == {"following"}
    assert seen(3.0, 0.0, 1.0) == set() and seen(3.0 - least, 0.0, 1.0) == {"following"}
    for speed, name in ((0.5, "overtaking"), (1.0, "following"), (-1.0, "frontal_approach")):
        assert seen(2.5, 1.0, speed) == set() and seen(2.5, least - 1.0, speed) == {name}
    assert seen(3.0, 0.0, -1.0) == set() and seen(3.0 - least, 0.0, -1.0) == {"frontal_approach"}
    # Two people on the disc of 2 m are .16 a square metre, one is .08.
    assert seen(2.0, 0.0, 0.0, 2) == set() and seen(2.0 - least, 0.0, 0.0, 2) == {"crowded"}
    assert seen(1.0, 0.0, 0.0, 1) == set()

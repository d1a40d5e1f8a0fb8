"""Metrics beyond SEAN's counts against a plain loop in double precision, on episodes of random moments.

Episodes end between whole seconds. People, boxes and robots lie about the limits, headings are no velocities, and
every situation has values of its own, so a figure of the wrong step, side or situation is another number.
"""

import math

import jax
import numpy as np
import pytest

from sean_jax import metrics
from sean_jax.core.data_types import Obstacles, Snapshot
from sean_jax.metrics import proximity
from support import metric_values
from support.people import people_at, snapshot_of

EPISODES, STEPS, PEOPLE, BOXES, ROBOTS, SITUATIONS, STEP = 24, 38, 5, 3, 2, 3, 0.1
SECONDS = {name: getattr(proximity, name) for name in ("CONTACT_TIME", "OBSTACLE_TIME", "INTIMATE_TIME")}
OTHERS = (
    "path_irregularity success_by_time mean_speed max_speed mean_acceleration max_acceleration mean_jerk max_jerk "
    "personal_space_compliance min_time_to_collision social_work time_looked_at collision_with_obstacle "
    "min_distance_to_obstacles time_in_situation reached_goal success_by_path_length"
).split()
RULES = {name: metrics.METRICS[name] for name in OTHERS} | metrics.OF_TEAMS | metrics.OF_GROUPS | SECONDS


def unit(angle):
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def drawn(seed: int) -> Snapshot:
    """(EPISODES, STEPS) moments; each is a little other than the one before."""
    random, shape = np.random.default_rng(seed), (EPISODES, STEPS)

    def walk(size: float, *more: int):
        return np.cumsum(random.normal(0.0, size, (*shape, *more)), 1)

    velocity = walk(0.15, 2) * (random.random((*shape, 1)) < 0.8)
    position = np.cumsum(velocity, 1) * STEP + random.normal(0.0, 0.3, (EPISODES, 1, 2))
    place = position[:, :, None] + walk(0.12, PEOPLE, 2) + random.normal(0.0, 0.6, (EPISODES, 1, PEOPLE, 2))
    toward = np.arctan2(*np.moveaxis(position[:, :, None] - place, -1, 0)[::-1])
    facing = toward + np.deg2rad(random.choice([2.0, 4.5, 5.5, 60.0, 180.0], (*shape, PEOPLE)))
    people = people_at(
        place,
        velocity=walk(0.3, PEOPLE, 2),
        heading=unit(facing),
        group=np.broadcast_to(random.integers(-1, 3, (EPISODES, 1, PEOPLE)), (*shape, PEOPLE)),
        walking_group=np.broadcast_to(random.integers(-1, 2, (EPISODES, 1, PEOPLE)), (*shape, PEOPLE)),
        present=random.random((*shape, PEOPLE)) < 0.9,
    )
    boxes = Obstacles(
        center=random.uniform(-1.5, 1.5, (EPISODES, 1, BOXES, 2)),
        half_extent=random.uniform(0.05, 0.5, (EPISODES, 1, BOXES, 2)),
        yaw=random.uniform(-3.0, 3.0, (EPISODES, 1, BOXES)),
        height=np.ones((EPISODES, 1, BOXES)),
    )
    each = lambda low, high: np.broadcast_to(random.uniform(low, high, (EPISODES, 1)), shape)  # noqa: E731
    robots = position[:, :, None] + walk(0.1, ROBOTS, 2) + random.normal(0.0, 0.5, (EPISODES, 1, ROBOTS, 2))
    fixed = lambda size: np.broadcast_to(random.normal(0.0, size, (EPISODES, 1, 2)), (*shape, 2))  # noqa: E731
    group = lambda: np.broadcast_to(random.integers(-1, 3, (EPISODES, 1)), shape)  # noqa: E731
    return snapshot_of(
        people,
        position,
        heading=unit(walk(0.4)),
        velocity=velocity,
        start=fixed(1.0),
        goal=fixed(1.0),
        start_group=group(),
        goal_group=group(),
        geodesic=each(0.3, 4.0),
        situations=random.random((*shape, SITUATIONS)) < [0.5, 0.2, 0.0],
        tick=np.broadcast_to(np.arange(STEPS), shape),
        robot_radius=each(0.1, 0.3),
        person_radius=each(0.15, 0.3),
        time_step=STEP,
        obstacles=jax.tree.map(lambda leaf: np.repeat(leaf, STEPS, 1), boxes),
        path_rotation=each(0.0, 2.0),
        goal_radius=each(0.5, 2.0),
        robot_top_speed=each(0.3, 1.5),
        robots=np.concatenate([robots, random.uniform(0.1, 0.4, (*shape, ROBOTS, 1))], -1),
    )


def to_box(place, boxes, k) -> float:
    """m from a place to the surface of a box, negative inside."""
    offset = place - boxes.center[k]
    ahead = unit(boxes.yaw[k])
    local = np.array([offset @ ahead, ahead[0] * offset[1] - ahead[1] * offset[0]])
    over = np.abs(local) - boxes.half_extent[k]
    return float(max(over)) if max(over) < 0 else math.hypot(*np.maximum(over, 0.0))


def meets(gap, relative, reach) -> float:
    """s until the bodies touch, at most 30."""
    if gap @ gap <= reach * reach:
        return 0.0
    roots = np.roots([relative @ relative, 2 * gap @ relative, gap @ gap - reach * reach])
    return min([30.0, *(root for root in roots.real if root >= 0 and np.isreal(roots).all())])


def circle(one, groups, margin):
    """Group -> whether the moving robot is in the circle of its present members, of two or more."""
    inside = {}
    for label in set(groups.tolist()) - {-1}:
        members = one.people.position[(groups == label) & one.people.present]
        if len(members) > 1 and np.hypot(*one.velocity) > 5e-4:
            radius = np.hypot(*(members - members.mean(0)).T).mean() - margin
            inside[label] = np.hypot(*(one.position - members.mean(0))) < radius
    return inside


def moment(one) -> dict[str, float]:
    """What a moment has by itself."""
    there = one.people.present
    gaps, relative = one.people.position - one.position, one.people.velocity - one.velocity
    apart, reach = np.hypot(*gaps.T), one.robot_radius + one.person_radius
    boxes = min(to_box(one.position, one.obstacles, k) for k in range(BOXES))
    at_fault = (gaps @ one.velocity > 0) & (np.hypot(*one.velocity) > 5e-4)
    cosines = -(one.people.heading * gaps).sum(1) / apart
    force = 7.0 * np.exp(-apart / 0.3)[:, None] * gaps / apart[:, None]
    others = np.hypot(*(one.robots[:, :2] - one.position).T) - one.robots[:, 2] - one.robot_radius
    standing = np.where(np.isin(one.people.group, [one.start_group, one.goal_group]), -1, one.people.group)
    return {
        "free": float(not (there & (apart < 0.5)).any()),
        "collision": min([30.0, *(meets(g, v, reach) for g, v in zip(gaps[there], relative[there], strict=True))]),
        "work": STEP * (np.hypot(*force[there].sum(0)) + np.hypot(*force[there].T).sum()),
        "looked": float((there & (cosines >= math.cos(math.radians(5.0))) & (apart <= 3.6)).any()),
        "box": boxes,
        "contact": float((there & (apart <= reach + 0.01) & at_fault).any()),
        "intimate": float((there & (apart <= 0.45)).any()),
        "robots": others,
        "spaces": circle(one, standing, one.person_radius),
        "walking": circle(one, one.people.walking_group, 0.0),
        "goal": float(np.hypot(*(one.goal - one.position)) <= one.goal_radius),
    }


def turned(first, second) -> float:
    return abs(math.remainder(math.atan2(*second[::-1]) - math.atan2(*first[::-1]), 2 * math.pi))


def by_loop(episode: list) -> dict[str, np.ndarray]:
    each = [moment(one) for one in episode]
    weights = np.array([[1.0, *one.situations] for one in episode])
    after = weights[1:]
    velocities = np.array([one.velocity for one in episode])
    speeds = np.hypot(*velocities.T)
    accelerations = np.diff(velocities, axis=0) / STEP
    jerks = np.hypot(*np.diff(accelerations, axis=0).T) / STEP
    accelerated = np.hypot(*accelerations.T)

    def mean(values, weights):
        with np.errstate(invalid="ignore"):
            return (values[:, None] * weights).sum(0) / weights.sum(0)

    def summed(name):
        return (np.array([one[name] for one in each[1:]])[:, None] * after).sum(0)

    def least(name):
        values = np.array([one[name] for one in each])[:, None]
        found = np.where(weights > 0, values, np.inf).min(0)
        return np.where(np.isinf(found), np.nan, found)

    def entered(now, then):
        return sum(inside and not then.get(label, False) for label, inside in now.items())

    def entries(name):
        pairs = zip(each[1:], each[:-1], strict=True)
        return (np.array([entered(now[name], then[name]) for now, then in pairs])[:, None] * after).sum(0)

    samples = [episode[k] for k in (*range(0, STEPS, 10), STEPS - 1)]
    pairs = list(zip(samples[:-1], samples[1:], strict=True))
    rotation = sum(turned(a.heading, b.heading) for a, b in pairs)
    first, reached = episode[0], each[-1]["goal"]

    # The way to the goal ends at the last moment outside of the goal radius, and so does the shortest one.
    outside = max([k for k in range(1, STEPS) if not each[k]["goal"]], default=0)
    places = [episode[k].position for k in sorted({*range(0, outside + 1, 10), outside})]
    path = sum(np.hypot(*(b - a)) for a, b in zip(places[:-1], places[1:], strict=True))
    shortest = max(first.geodesic - first.goal_radius, 0.0)
    quickest = shortest / first.robot_top_speed

    def success(best, actual):
        return reached * (best / max(best, actual) if max(best, actual) > 0.0 else 1.0)

    robots = np.array([one["robots"] for one in each])
    bumps = ((robots[1:] <= 0.01) & ~(robots[:-1] <= 0.01)).sum(1)
    hits = np.array([one["box"] for one in each]) <= first.robot_radius + 0.01
    return {
        "path_irregularity": max(rotation - first.path_rotation, 0.0),
        "success_by_path_length": success(shortest, path),
        "success_by_time": success(quickest, STEP * outside),
        "reached_goal": reached,
        "mean_speed": mean(speeds[1:], after),
        "max_speed": speeds[1:].max(),
        "mean_acceleration": mean(accelerated, after),
        "max_acceleration": accelerated.max(),
        "mean_jerk": mean(jerks, weights[2:]),
        "max_jerk": jerks.max(),
        "personal_space_compliance": mean(np.array([one["free"] for one in each[1:]]), after),
        "min_time_to_collision": least("collision"),
        "social_work": summed("work"),
        "time_looked_at": STEP * summed("looked"),
        "collision_with_obstacle": ((hits[1:] & ~hits[:-1])[:, None] * after).sum(0),
        "min_distance_to_obstacles": least("box"),
        "time_in_situation": STEP * after.sum(0),
        "collision_with_robot": (bumps[:, None] * after).sum(0),
        "min_distance_to_robots": robots.min(),
        "o_spaces_crossed": entries("spaces"),
        "groups_split": entries("walking"),
        "CONTACT_TIME": STEP * summed("contact"),
        "OBSTACLE_TIME": STEP * (hits[1:, None] * after).sum(0),
        "INTIMATE_TIME": STEP * summed("intimate"),
    }


@pytest.fixture(scope="module")
def measured():
    """What the package and what the loop find for each episode: name -> (EPISODES, ...) each."""
    episodes = drawn(3)
    rules = tuple(RULES.items())
    run = jax.jit(jax.vmap(lambda one: metric_values.compute(metric_values.along(one, rules), rules)))
    found = {name: np.asarray(value) for name, value in run(jax.device_put(episodes)).items()}
    exact = jax.tree.map(lambda leaf: leaf.astype(float) if leaf.dtype == np.float32 else leaf, episodes)
    each = [
        by_loop([jax.tree.map(lambda leaf, e=e, k=k: leaf[e, k], exact) for k in range(STEPS)]) for e in range(EPISODES)
    ]
    return found, {name: np.stack([one[name] for one in each]) for name in each[0]}


def test_the_loop_has_them_all(measured):
    assert set(measured[0]) == set(measured[1]) == set(RULES)


@pytest.mark.parametrize("name", RULES)
def test_a_metric_equals_a_plain_loop(measured, name):
    found, expected = (each[name] for each in measured)
    # Where nothing of a situation was measured, a count is zero and a mean unknown.
    np.testing.assert_allclose(found, expected, rtol=3e-4, atol=3e-5)
    overall = expected.reshape(EPISODES, -1)[:, 0]
    distinct = len(set(overall.round(6).tolist()))
    assert distinct > 2 or (name, distinct) in (("time_in_situation", 1), ("reached_goal", 2)), (
        "drawn so that it varies"
    )
    if expected.ndim > 1:
        assert (np.isnan(expected[:, -1]) | (expected[:, -1] == 0)).all(), "never occurs"
        assert name in ("groups_split", "o_spaces_crossed") or np.nanmax(np.abs(expected[:, 2] - expected[:, 1])) > 0

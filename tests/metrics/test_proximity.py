"""Metrics beyond the paper's own (section IV-H), on cases with a closed form."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import metrics
from sean_jax.core.data_types import Obstacles
from sean_jax.metrics.proximity import collision_time, obstacle_distance
from sean_jax.simulation import scenario as scenario_module
from sean_jax.world import navigation
from support import metric_values, programs
from support import shortest_paths as oracle
from support.checkout import ROOT
from support.metric_snapshots import ROBOT_RADIUS, SITUATIONS, STEP, along, at, measure, wander
from support.metric_snapshots import as_snapshot as of_wander
from support.people import people_at, snapshot_of

REACH = 0.36  # m, of a robot and a person who touch


def driven(way, headings=None, speed=0.5, **others):
    """The metrics along positions every 0.1 s, headings and velocities along the way unless given."""
    way = np.array(way, float)
    step = np.diff(way, axis=0, prepend=[way[0] - (way[1] - way[0])])
    snapshots = []
    for tick, position in enumerate(way):
        here = at(tick, position, step[tick] / STEP, **others)
        size = np.linalg.norm(step[tick])
        ahead = headings[tick] if headings is not None else step[tick] / size if size else snapshots[-1].heading
        snapshots.append(replace(here, heading=jnp.asarray(ahead, jnp.float32)))
    return measure(snapshots)


def test_straight_path_is_perfect():
    found = driven(along((0, 0), (4, 0)), goal=(4, 0), geodesic=4.0)
    assert found["path_irregularity"] == pytest.approx(0.0, abs=1e-5)
    assert found["reached_goal"] == 1.0
    assert found["success_by_path_length"] == pytest.approx(1.0, rel=1e-5)
    assert found["success_by_time"] == pytest.approx(1.0, rel=1e-5)  # at 0.5 m/s, the top speed where none is told
    np.testing.assert_allclose([found["mean_speed"][0], found["max_speed"]], 0.5, rtol=1e-4)
    np.testing.assert_allclose([found["mean_acceleration"][0], found["max_jerk"]], 0.0, atol=2e-2)
    assert found["personal_space_compliance"][0] == 1.0
    assert found["min_time_to_collision"][0] == 30.0
    assert found["social_work"][0] == found["time_looked_at"][0] == found["collision_with_obstacle"][0] == 0.0
    assert found["min_distance_to_obstacles"][0] == 1000.0


def test_detour_along_three_sides_of_a_square():
    """Three times as long, three quarter turns more: left at the start, right, right; half of the robot's top speed.

    To the goal radius of 1.2 m it is 4.8 m instead of 0.8 m, of which the last step is not counted.
    """
    way = along((0, 0), (0, 2), (2, 2), (2, 0))
    others = dict(goal=(2, 0), geodesic=2.0)
    found = driven(way, headings=[(1, 0), *[(0, 1)] * 40, *[(1, 0)] * 40, *[(0, -1)] * 40], **others)
    assert found["path_irregularity"] == pytest.approx(1.5 * np.pi, rel=1e-5)
    assert found["success_by_path_length"] == pytest.approx(0.8 / 4.75, rel=1e-4)
    assert found["success_by_time"] == pytest.approx(0.8 / 4.75, rel=1e-4)
    snapshots = [
        replace(at(k, p, **others), path_rotation=jnp.float32(0.5), robot_top_speed=jnp.float32(1.0))
        for k, p in enumerate(way)
    ]
    turned = [replace(here, heading=jnp.asarray((np.cos(0.1 * k), np.sin(0.1 * k)), jnp.float32)) for k, here
              in enumerate(snapshots)]  # fmt: skip
    found = measure(turned)
    assert found["path_irregularity"] == pytest.approx(12.0 - 0.5, rel=1e-4)  # 1 rad/s for 12 s, 0.5 of which it had to
    assert found["success_by_time"] == pytest.approx(0.8 / 9.5, rel=1e-4)


def test_turning_less_than_the_shortest_path_is_not_irregular():
    """Not a negative figure; a goal behind the robot asks for half a turn, which the robot did not make."""
    found = driven([(0, 0)] * 5, headings=[(1, 0)] * 5, goal=(-2, 0), geodesic=2.0)
    assert found["path_irregularity"] == 0.0


@pytest.mark.parametrize(("radius", "reached"), [(None, 1.0), (1.0, 0.0), (1.2, 1.0)])
def test_success_needs_the_last_position_in_the_goal_radius(radius, reached):
    way = along((0, 0), (4, 0), (2.9, 0))  # through the goal and 1.1 m back
    goal_radius = None if radius is None else jnp.float32(radius)
    snapshots = [replace(at(k, p, goal=(4, 0), geodesic=4.0), goal_radius=goal_radius) for k, p in enumerate(way)]
    found = measure(snapshots)
    assert found["reached_goal"] == reached
    assert found["success_by_path_length"] == found["success_by_time"] == reached


@pytest.mark.parametrize("stop", [3.0, 4.0])
def test_success_ends_at_the_goal_radius(stop):
    """Where the robot stops inside it, what it does there and a hold time do not count; a second way there does."""
    straight = along((0, 0), (stop, 0))
    for after in ([(stop, 0)] * 50, along((stop, 0), (stop, 0.4), (stop, -0.4), (stop, 0.4))):
        found = driven([*straight, *after], goal=(4, 0), geodesic=4.0)
        assert found["success_by_path_length"] == found["success_by_time"] == 1.0
    left = along((0, 0), (stop, 0), (1.5, 0), (stop, 0))
    found = driven(left, goal=(4, 0), geodesic=4.0)
    expected = 2.8 / (stop + stop - 1.5 + 1.3)
    assert found["success_by_path_length"] == pytest.approx(expected, rel=0.02)
    assert found["success_by_time"] == pytest.approx(expected, rel=0.02)
    stays = driven([(3, 0)] * 30, headings=[(1, 0)] * 30, goal=(4, 0), geodesic=1.0)
    assert stays["success_by_time"] == 1.0, "at the goal from the start"


def test_person_at_an_arms_length():
    """Somebody at 0.4 m for 12 of 40 steps, else at 2 m; absent people, who stand on the robot, do not count."""
    inside = range(5, 17)
    spots = [(0.4, 0) if k in inside else (2.0, 0) for k in range(41)]
    occurring = [(0,) if k <= 10 else (2,) for k in range(41)]
    found = measure([at(k, people=[spots[k]], situations=occurring[k]) for k in range(41)])
    assert found["personal_space_compliance"][0] == pytest.approx(1 - 12 / 40)
    assert found["personal_space_compliance"][1] == pytest.approx(1 - 6 / 10)
    assert found["personal_space_compliance"][3] == pytest.approx(1 - 6 / 30)
    assert np.isnan(found["personal_space_compliance"][[2, 4, 5]]).all()
    pushes = [7.0 * np.exp(-spots[k][0] / 0.3) for k in range(1, 41)]
    assert found["social_work"][0] == pytest.approx(2 * STEP * sum(pushes), rel=1e-5)
    assert found["social_work"][1] == pytest.approx(2 * STEP * sum(pushes[:10]), rel=1e-5)


def test_forces_of_opposite_people_cancel_on_the_robot_alone():
    found = measure([at(k, people=[(0.6, 0), (-0.6, 0)]) for k in range(11)])
    assert found["social_work"][0] == pytest.approx(10 * STEP * 2 * 7.0 * np.exp(-2.0), rel=1e-5)


@pytest.mark.parametrize("y", [0.3, 0.8])
def test_lateral_pass(y):
    """At 0.5 m/s past somebody who stands at a lateral distance: nearest y; a collision is ahead only if y < 0.36 m."""
    way = along((0, 0), (4, 0))
    found = driven(way, people=[(2.0, y)])
    assert found["min_distance_to_people"] == pytest.approx(y, rel=1e-4)
    if y > REACH:
        assert found["min_time_to_collision"][0] == 30.0
    else:
        assert found["min_time_to_collision"][0] == 0.0  # it did touch
        early = driven(way[:11], people=[(2.0, y)])  # until x = 0.5 m
        assert early["min_time_to_collision"][0] == pytest.approx((1.5 - np.sqrt(REACH**2 - y**2)) / 0.5, rel=1e-3)


def test_time_to_collision_of_two_bodies():
    """Head on (d - r) / (v + w); from behind (d - r) / (v - w); parallel, apart, at rest: none; touching: 0."""
    cases = [
        ((3.0, 0.0), (-0.7, 0.0), (0.5, 0.0), (3.0 - REACH) / 1.2),
        ((3.0, 0.0), (0.2, 0.0), (0.5, 0.0), (3.0 - REACH) / 0.3),
        ((3.0, 0.0), (0.5, 0.0), (0.5, 0.0), 30.0),
        ((3.0, 0.0), (0.9, 0.0), (0.5, 0.0), 30.0),
        ((3.0, 0.0), (0.0, 0.0), (0.0, 0.0), 30.0),
        ((0.3, 0.0), (0.9, 0.0), (0.0, 0.0), 0.0),
        ((2.0, 2.0), (0.0, -0.5), (0.5, 0.0), (2.0 * np.sqrt(2) - REACH) / (0.5 * np.sqrt(2))),
    ]
    for gap, walks, drives, expected in cases:
        here = at(0, velocity=drives, people=[gap])
        velocity = jnp.asarray([walks, (9.0, 0.0), (-9.0, 0.0)], jnp.float32)
        found = measure(
            [replace(here, people=replace(here.people, velocity=velocity), tick=jnp.int32(k)) for k in (0, 1)]
        )
        assert found["min_time_to_collision"][0] == pytest.approx(expected, rel=1e-5), gap


def test_time_to_collision_equals_a_search_in_time():
    random = np.random.default_rng(0)
    x, y, vx, vy = random.normal(size=(4, 600)).astype(np.float32) * [[1.5], [1.5], [1.0], [1.0]]
    ours = np.asarray(jax.vmap(collision_time, (0, 0, 0, 0, None))(*map(jnp.float32, (x, y, vx, vy)), jnp.float32(0.7)))
    times = np.linspace(0, 10, 10_001)
    apart = np.hypot(x[:, None] + vx[:, None] * times, y[:, None] + vy[:, None] * times)
    meets = (apart <= 0.7).any(1)
    first = times[np.argmax(apart <= 0.7, axis=1)]
    assert 60 < meets.sum() < 540
    np.testing.assert_allclose(ours[meets], first[meets], atol=2e-3)
    grazing = (apart.min(1) > 0.7) & (apart.min(1) < 0.7005)
    assert (ours[~meets & ~grazing] > 9.9).all()


def test_speed_acceleration_and_jerk():
    """1 s at 0.2 m/s2 from rest, then 1 s at a constant speed: two jumps of the acceleration, of which one counts."""
    speeds = [0.02 * min(k, 10) for k in range(21)]
    found = measure([at(k, velocity=(0, v), situations=(1,) if k > 10 else (0,)) for k, v in enumerate(speeds)])
    assert found["mean_speed"][0] == pytest.approx(np.mean(speeds[1:]), rel=1e-5)
    assert found["max_speed"] == pytest.approx(0.2, rel=1e-5)
    assert found["mean_acceleration"][0] == pytest.approx(0.1, rel=1e-4)
    assert found["mean_acceleration"][1] == pytest.approx(0.2, rel=1e-4)
    assert found["mean_acceleration"][2] == pytest.approx(0.0, abs=1e-5)
    assert found["max_acceleration"] == pytest.approx(0.2, rel=1e-4)
    assert found["max_jerk"] == pytest.approx(2.0, rel=1e-3)
    assert found["mean_jerk"][0] == pytest.approx(2.0 / 19, rel=1e-3)
    assert found["mean_jerk"][1] == pytest.approx(0.0, abs=1e-3) and found["mean_jerk"][2] == pytest.approx(
        0.2, rel=1e-3
    )


def test_curve_has_the_acceleration_of_its_bend():
    """At 0.5 m/s on a circle of 0.5 m: v2 / r = 0.5 m/s2, jerk v3 / r2 = 0.5 m/s3."""
    angle = 0.1 * np.arange(40)
    velocity = 0.5 * np.stack([-np.sin(angle), np.cos(angle)], -1)
    found = measure([at(k, velocity=v) for k, v in enumerate(velocity)])
    for name in ("mean_acceleration", "mean_jerk"):
        assert found[name][0] == pytest.approx(0.5, rel=2e-3)
    assert found["max_acceleration"] == pytest.approx(0.5, rel=2e-3)


@pytest.mark.parametrize(
    ("degrees", "distance", "seen"), [(0, 2, 1), (4.9, 2, 1), (5.1, 2, 0), (180, 2, 0), (0, 3.7, 0)]
)
def test_time_looked_at(degrees, distance, seen):
    """Somebody straight ahead of the robot who faces it, or looks past it; two who do so count once."""
    here = [at(k, people=[(distance, 0), (0, distance)]) for k in range(11)]
    angle = np.deg2rad([180 + degrees, 270 - degrees, 0])
    heading = jnp.asarray(np.stack([np.cos(angle), np.sin(angle)], -1), jnp.float32)
    found = measure([replace(one, people=replace(one.people, heading=heading)) for one in here])
    assert found["time_looked_at"][0] == pytest.approx(seen * 1.0)
    absent = [replace(one, people=replace(one.people, present=jnp.zeros(3, bool))) for one in here]
    assert measure(absent)["time_looked_at"][0] == 0.0


def test_static_obstacles():
    """Up to a wall of two boxes, along it past their joint, off and on again: two collisions, none within 1.2 m."""
    boxes = Obstacles(
        center=jnp.asarray([(2.0, -1.0), (2.0, 1.0), (9.0, 9.0)]),
        half_extent=jnp.asarray([(0.5, 1.0), (0.5, 1.0), (1.0, 1.0)]),
        yaw=jnp.zeros(3),
        height=jnp.ones(3),
    )
    touching = 1.5 - ROBOT_RADIUS - 0.005
    way = along((0, -0.5), (touching, -0.5), (touching, 0.5), (1.0, 0.5), (touching, 0.5))
    occurring = [(0,) if k < 30 else (3,) for k in range(len(way))]
    snapshots = [replace(at(k, p, situations=occurring[k]), obstacles=boxes) for k, p in enumerate(way)]
    found = measure(snapshots)
    np.testing.assert_array_equal(found["collision_with_obstacle"], [2, 1, 0, 0, 1, 0])
    assert found["min_distance_to_obstacles"][0] == pytest.approx(ROBOT_RADIUS + 0.005, abs=1e-4)
    assert np.isnan(found["min_distance_to_obstacles"][2])
    aside = replace(at(0, (4.5, 0.0)), obstacles=boxes)
    assert float(obstacle_distance(aside)) == pytest.approx(2.0)


def test_random_moments_vmap_equals_a_loop_and_nothing_depends_on_the_number_of_steps():
    sequences = [[of_wander(k, now) for k, now in enumerate(wander(seed, 60))] for seed in range(2)]
    each = [measure(sequence) for sequence in sequences]
    stack = lambda *leaves: np.stack(leaves)  # noqa: E731
    stacked = jax.tree.map(stack, *[jax.tree.map(stack, *moments) for moments in sequences])

    def run(sequence):
        values = metric_values.along(sequence)
        return metric_values.compute(values), values

    together, values = jax.jit(jax.vmap(run))(stacked)
    for name, value in together.items():
        np.testing.assert_allclose(value, np.stack([one[name] for one in each]), rtol=1e-4, atol=1e-5, err_msg=name)
    assert sum(leaf[0].size for leaf in jax.tree.leaves(values)) < 60 * len(metrics.METRICS)
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(values))


def test_rotation_of_the_shortest_path_equals_that_of_a_graph_search(scenario):
    """In float64, over points on the circles about all corners; starts and goals all over the warehouse."""
    tables = scenario.navigation
    places, heading = tables.places[:80].reshape(40, 2, 2), jnp.asarray([0.6, 0.8], jnp.float32)

    def by_tables(start, goal):
        return navigation.path_rotation(tables, start, heading, goal, navigation.build_paths_to_goal(tables, goal))

    ours = np.asarray(jax.jit(jax.vmap(by_tables))(places[:, 0], places[:, 1]))
    starts, goals = np.moveaxis(np.asarray(places, float), 1, 0)
    ways = oracle.shortest(oracle.boxes_of(scenario.environment), float(tables.radius), starts, goals)[1]
    for k, way in enumerate(ways):
        angles = np.concatenate([[np.arctan2(0.8, 0.6)], np.arctan2(*np.diff(way, axis=0).T[::-1])])
        turns = np.abs((np.diff(angles) + np.pi) % (2 * np.pi) - np.pi)
        assert ours[k] == pytest.approx(turns.sum(), abs=2e-2), k
    assert 3 <= sum(len(way) == 2 for way in ways) <= 37  # straight ones


def test_an_episode_fills_a_moment_with_all_that_metrics_read(scenario):
    """The rotation of the path, the goal radius, the top speed and the obstacles are those of the scenario."""
    state = programs.reset(scenario, jax.random.key(0))
    here = jax.jit(scenario_module.snapshot)(scenario, state)
    assert float(here.path_rotation) == float(state.task.path_rotation) >= 0.0
    assert float(here.goal_radius) == pytest.approx(1.2) and float(here.robot_top_speed) == pytest.approx(0.5)
    nearest = float(programs.clearance(scenario.environment, here.position[None, :])[0])
    assert float(obstacle_distance(here)) == pytest.approx(nearest, abs=1e-4)
    found = {name: np.asarray(value) for name, value in programs.results(scenario, state).items()}
    assert all(np.isfinite(value.reshape(-1)[0]) for value in found.values())


def test_every_metric_of_seans_documentation_is_there():
    seans = {
        "reached_goal", "path_length", "min_distance_to_goal", "final_distance_to_goal", "time_not_moving",
        "path_irregularity", "path_efficiency", "personal_robot_on_person", "personal_person_on_robot",
        "intimate_robot_on_person", "intimate_person_on_robot", "collision_robot_on_person",
        "collision_person_on_robot", "collision_with_obstacle",
    }  # fmt: skip
    assert len(seans) == 14 and seans <= set(metrics.METRICS)


def test_documentation_lists_every_metric_as_it_is():
    text = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    listed = [line for line in text.splitlines() if line.startswith("| `") and line.count("|") == 5]
    expected = [
        f"| `{name}` | {metric.unit} | {metric.definition} | {metric.better} |".replace("  |", " |")
        for name, metric in metrics.METRICS.items()
    ]
    assert [line for line in listed if line.split("`")[1] in metrics.METRICS] == expected
    assert all(metric.title and metric.definition.endswith(".") for metric in metrics.METRICS.values())


def test_example_of_the_documentation_runs():
    """Its own metrics, of the second block of code, along a path past somebody."""
    text = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    block = text.split("```python\n")[2].split("```")[0]
    space: dict = {}
    exec(block.split("scenario = ")[0], space)
    own = tuple((name, metrics.as_metric(metric, name)) for name, metric in space["own"].items())
    turned = [(np.cos(0.1 * k), np.sin(0.1 * k)) for k in range(31)]
    snapshots = [at(k, (0.1 * k, 0.0), people=[(1.5, 0.2)]) for k in range(31)]
    snapshots = [replace(one, heading=jnp.asarray(ahead, jnp.float32))
               for one, ahead in zip(snapshots, turned, strict=True)]  # fmt: skip
    values = metric_values.init(snapshots[0], own)
    for before, after in zip(snapshots[:-1], snapshots[1:], strict=True):
        values = metric_values.update(values, before, after, own)
    found = metric_values.compute(values, own)
    assert found["rotation"][0] == pytest.approx(3.0, rel=1e-4) and found["times_too_close"][0] == 1.0
    assert found["too_close"][0] == pytest.approx(STEP * sum(abs(0.1 * k - 1.5) < 0.5656 for k in range(31)))


def test_means_and_extremes_are_unknown_only_where_a_situation_never_occurred():
    found = measure([at(k, people=[(1, 0)], situations=(1,)) for k in range(4)])
    for name, value in found.items():
        if value.shape:
            assert value.shape == (1 + SITUATIONS,)
            assert np.isfinite(value[[0, 2]]).all(), name
            unknown = np.isnan(value[[1, 3, 4, 5]])
            assert unknown.all() or not unknown.any(), name


def test_the_table_in_the_terminal_has_the_metrics_of_the_paper():
    """Those of section IV-H; all others are in the report and in episodes.csv."""
    entries = {
        f"{space}_{who}"
        for space in ("intimate", "personal", "collision")
        for who in ("robot_on_person", "person_on_robot")
    }
    told = {name for name, metric in (metrics.METRICS | metrics.OF_GROUPS).items() if metric.headline}
    assert told == {"path_efficiency", "time_not_moving"} | entries


def test_o_spaces_and_walking_groups_equal_a_plain_loop():
    """Groups of two to four among eight people; the robot's own group is not counted, nor a robot that stands."""
    random, people, steps = np.random.default_rng(5), 8, 200
    groups = np.array([0, 0, 0, 1, 1, -1, 2, 3])
    expected, snapshots, inside = np.zeros(2), [], np.zeros((2, 4), bool)
    for tick in range(steps):
        place, velocity = random.normal(0, 1, 2), random.normal(0, 0.3, 2) * (random.uniform() < 0.8)
        position = random.normal(0, 0.8, (people, 2))
        present = random.uniform(size=people) < 0.9
        persons = people_at(position, present=present, group=groups, walking_group=groups)
        snapshots.append(snapshot_of(persons, place, velocity=velocity, goal_group=1, tick=tick))
        before, inside = inside, np.zeros((2, 4), bool)
        for group in range(4):
            members = [position[k] for k in range(people) if groups[k] == group and present[k]]
            if len(members) < 2 or not velocity.any():
                continue
            middle = sum(members) / len(members)
            radius = sum(np.hypot(*(member - middle)) for member in members) / len(members)
            gap = np.hypot(*(place - middle))
            inside[0, group] = group != 1 and gap < radius - 0.2
            inside[1, group] = gap < radius
        if tick:
            expected += (inside & ~before).sum(1)
    of_groups = tuple(metrics.OF_GROUPS.items())
    stacked = jax.tree.map(lambda *moments: np.stack(moments), *snapshots)
    counts = jax.jit(lambda moments: metric_values.compute(metric_values.along(moments, of_groups), of_groups))(stacked)
    assert list(metrics.OF_GROUPS) == ["o_spaces_crossed", "groups_split"]
    np.testing.assert_array_equal([counts[name][0] for name in metrics.OF_GROUPS], expected)
    assert (expected > 5).all()

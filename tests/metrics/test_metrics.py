"""Metrics of section IV-H, updated along paths made by hand and over random ones that a plain loop measures too."""

import math
from dataclasses import replace
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import metrics
from sean_jax.core.data_types import Snapshot
from sean_jax.metrics import metric
from support import metric_values
from support.metric_snapshots import (
    PEOPLE,
    PERSON_RADIUS,
    SITUATIONS,
    STEP,
    along,
    as_snapshot,
    at,
    compute,
    measure,
    update,
    wander,
)

FAR = (50.0, 50.0)


def test_every_metric_has_a_topic_and_only_those_of_the_package():
    assert all(metrics.topic(name) in metrics.TOPICS for name in metrics.METRICS)
    assert set().union(*metrics.TOPICS.values()) == set(metrics.METRICS)
    assert {metrics.topic(name) for name in ("mean", "Metric", "jnp", "mine")} == {"your own"}


EVENTS = [f"{limit}_{who}" for limit in ("intimate", "personal", "collision")
          for who in ("robot_on_person", "person_on_robot")]  # fmt: skip


def drive(positions, **others) -> dict[str, np.ndarray]:
    return measure([at(tick, position, **others) for tick, position in enumerate(positions)])


def test_straight_line():
    found = drive(along((0, 0), (3, 4)), goal=(3, 4), geodesic=5.0)
    assert found["path_length"][0] == pytest.approx(5.0, rel=1e-5)
    assert found["path_efficiency"] == pytest.approx(1.0, rel=1e-5)
    assert found["time_in_situation"][0] == pytest.approx(10.0, rel=1e-5)
    assert found["time_not_moving"][0] == 0.0
    assert found["final_distance_to_goal"] == pytest.approx(0.0, abs=1e-6)
    assert found["min_distance_to_goal"] == pytest.approx(0.0, abs=1e-6)


def test_detour_and_the_rest_of_the_last_second():
    """Three sides of a square of 2 m, then 0.7 s more: whole seconds, and what is left."""
    way = along((0, 0), (0, 2), (2, 2), (2, 0), (2, -0.35))
    found = drive(way, goal=(2, 0), geodesic=2.0)
    assert found["path_length"][0] == pytest.approx(6.35, rel=1e-5)
    assert found["path_efficiency"] == pytest.approx(3.175, rel=1e-5)
    assert found["min_distance_to_goal"] == pytest.approx(0.0, abs=1e-6)
    assert found["final_distance_to_goal"] == pytest.approx(0.35, rel=1e-5)


def test_path_is_sampled_once_a_second():
    """A robot that shakes within each second has gone nowhere; it does move, at other times than SEAN looks."""
    way = [(0.2 * (tick % 10 != 0), 0.0) for tick in range(41)]
    found = drive(way)
    assert found["path_length"][0] == pytest.approx(0.0, abs=1e-6)
    assert found["time_not_moving"][0] == 4.0


def test_time_not_moving():
    """2 s of standing, 3 s at 0.049 m/s, 4 s at 0.06 m/s."""
    x = np.concatenate([np.zeros(21), 0.0049 * np.arange(1, 31), 0.147 + 0.006 * np.arange(1, 41)])
    found = drive([(value, 0.0) for value in x])
    assert found["time_not_moving"][0] == 5.0
    assert found["path_length"][0] == pytest.approx(0.147 + 0.24, rel=1e-4)


def timed(ticks: np.ndarray, step: float) -> Snapshot:
    """Snapshots that differ in their tick alone, stacked."""
    here = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(ticks), *leaf.shape)), at())
    return replace(here, tick=jnp.asarray(ticks, jnp.int32), time_step=step)


@pytest.mark.parametrize("step", [0.15, 0.3, 0.4, 0.7, 1.0, 2.5, 1 / 30])
def test_time_not_moving_adds_up_at_any_time_step(step):
    """21 s of standing, then 21 s at 0.06 m/s, also in steps that do not divide a second."""
    ticks = round(42 / step)
    time = step * np.arange(ticks + 1)
    x = 0.06 * np.maximum(time - 21.0, 0.0)
    sequence = timed(np.arange(ticks + 1), step)
    sequence = replace(sequence, position=jnp.asarray(np.stack([x, 0 * x], -1), jnp.float32))

    @jax.jit
    def whole(sequence):
        chosen = tuple((name, metrics.METRICS[name]) for name in ("time_not_moving", "path_length"))
        return metric_values.compute(metric_values.along(sequence, chosen), chosen)

    found = whole(sequence)
    # The second in which it starts belongs to neither or to one: 0.05 m of it may be standing.
    assert abs(found["time_not_moving"][0] - 21.0) <= max(1.0, step)
    assert found["path_length"][0] == pytest.approx(x[-1], rel=1e-4)
    if step in (0.15, 0.3, 1.0):  # 21 s are a sample
        assert found["time_not_moving"][0] == pytest.approx(21.0, rel=1e-5)


@pytest.mark.parametrize("step", [0.1, 0.15, 0.3, 0.4, 0.7, 2.5])
def test_samples_are_the_first_ticks_at_or_after_whole_seconds(step):
    decimal = Fraction(str(step))
    passed = [math.floor(decimal * tick) - math.floor(decimal * (tick - 1)) > 0 for tick in range(1, 201)]
    look = jax.jit(jax.vmap(lambda snapshot: (metric.second_has_passed(snapshot), metric.time_since_sample(snapshot))))
    by, since = look(timed(np.arange(1, 201), step))
    assert np.asarray(by).tolist() == passed
    ticks = np.flatnonzero(passed) + 1
    np.testing.assert_allclose(np.asarray(since)[ticks - 1], step * np.diff(ticks, prepend=0), rtol=1e-6)
    assert abs(step * ticks[-1] - 200 * step) < max(1.0, step)


def test_one_person_met_twice():
    """The robot drives up to somebody, within each limit, backs off out of all, and comes again."""
    there, away = 1.5 - 0.36, -0.4
    way = along((0, 0), (there, 0), (away, 0), (there, 0), (away, 0))
    speed = np.diff(np.array(way), axis=0, prepend=[way[0]]) / STEP
    found = measure([at(k, p, v, people=[(1.5, 0)]) for k, (p, v) in enumerate(zip(way, speed, strict=True))])
    assert {name: found[name][0] for name in EVENTS} == {
        name: 2.0 if name.endswith("robot_on_person") else 0.0 for name in EVENTS
    }
    assert found["min_distance_to_people"] == pytest.approx(0.36, abs=1e-5)


@pytest.mark.parametrize(
    ("velocity", "who"),
    [
        ((0.3, 0.0), "robot_on_person"),  # towards the person, who is at +x
        ((0.01, 0.4), "robot_on_person"),  # hardly towards
        ((-0.3, 0.0), "person_on_robot"),  # fleeing
        ((0.0, 0.5), "person_on_robot"),  # across: no part towards
        ((0.0, 0.0), "person_on_robot"),  # at rest
        ((4e-4, 0.0), "person_on_robot"),  # at rest to three decimals
        ((6e-4, 0.0), "robot_on_person"),
    ],
)
def test_fault(velocity, who):
    for limit, distance in (("personal", 1.1), ("intimate", 0.4), ("collision", 0.3)):
        snapshots = [at(0, people=[(2.0, 0.0)]), at(1, velocity=velocity, people=[(distance, 0.0)])]
        found = measure(snapshots)
        for name in EVENTS:
            reached = {"personal": 1.2, "intimate": 0.45, "collision": 0.37}[name.split("_")[0]] > distance
            assert found[name][0] == float(reached and name.endswith(who)), (limit, name)


@pytest.mark.parametrize(("limit", "metres"), [("collision", 0.37), ("intimate", 0.45), ("personal", 1.2)])
def test_limits(limit, metres):
    for distance, expected in ((metres + 1e-4, 0.0), (metres - 1e-4, 1.0)):
        found = measure([at(0, people=[(3.0, 0.0)]), at(1, people=[(0.0, distance)])])
        assert found[f"{limit}_person_on_robot"][0] == expected


def test_staying_or_starting_inside_is_no_entry():
    inside = [at(k, people=[(0.3, 0.0)]) for k in range(5)]
    assert all(measure(inside)[name][0] == 0.0 for name in EVENTS)
    entered = [at(0, people=[(3.0, 0.0)]), *inside]
    assert measure(entered)["collision_person_on_robot"][0] == 1.0


def test_each_person_counts_and_absent_people_do_not():
    found = measure([at(0, people=[(3, 0), (0, 3), (9, 9)]), at(1, people=[(1, 0), (0, 1), (9, 9)])])
    assert found["personal_person_on_robot"][0] == 2.0
    found = measure([at(0), at(1), at(2)])  # all absent ones stand on the robot
    assert all(found[name][0] == 0.0 for name in EVENTS)
    assert found["min_distance_to_people"] == pytest.approx(1000.0)
    here = at(0, people=[(3, 0)])
    appears = replace(at(1, people=[(1, 0)]), people=at(1, people=[(1, 0)]).people)
    gone = replace(here, people=replace(here.people, present=jnp.zeros(PEOPLE, bool)))
    assert measure([gone, appears])["personal_person_on_robot"][0] == 1.0


def test_split_by_situation():
    """Amounts count for every situation of the snapshot at which they are counted, and once overall."""
    way = along((0, 0), (4, 0))  # 80 steps
    occurring = [(0,) if tick <= 40 else (1, 4) for tick in range(81)]
    people = [[(2.05, 1.0)]] * 81
    found = measure([at(k, p, (0.5, 0), people[k], occurring[k], geodesic=4.0) for k, p in enumerate(way)])
    np.testing.assert_allclose(found["time_in_situation"], [8.0, 4.0, 4.0, 0, 0, 4.0], rtol=1e-5)
    np.testing.assert_allclose(found["path_length"], [4.0, 2.0, 2.0, 0, 0, 2.0], rtol=1e-5)
    np.testing.assert_array_equal(found["personal_robot_on_person"], [1, 1, 0, 0, 0, 0])
    halves = [at(k, p, situations=(k % 2,)) for k, p in enumerate([(0, 0)] * 31)]
    found = measure(halves)  # a whole second is an even tick
    np.testing.assert_array_equal(found["time_not_moving"], [3, 3, 0, 0, 0, 0])
    assert found["time_in_situation"][1:].sum() == pytest.approx(found["time_in_situation"][0])


def by_loop(sequence, body: float = 0.0) -> dict[str, np.ndarray]:
    """The same metrics in plain Python and double precision; the limits of violations are ``body`` [m] more."""
    out = {name: np.zeros(1 + SITUATIONS) for name in (*EVENTS, "path_length", "time_not_moving", "time_in_situation")}
    sampled = sequence[0]["position"]
    least, near_goal = np.inf, np.inf
    for tick, now in enumerate(sequence):
        weights = np.array([1.0, *now["situations"]])
        gaps = np.linalg.norm(now["people"] - now["position"], axis=1)[now["present"]]
        least, near_goal = min([least, *gaps]), min(near_goal, np.linalg.norm(now["position"] - now["goal"]))
        if tick == 0:
            continue
        then = sequence[tick - 1]
        out["time_in_situation"] += STEP * weights
        if tick % 10 == 0:
            moved = np.linalg.norm(now["position"] - sampled)
            out["path_length"] += moved * weights
            out["time_not_moving"] += (moved <= 0.05) * weights
            sampled = now["position"]
        for k in range(PEOPLE):
            for name, limit in (("intimate", 0.45 + body), ("personal", 1.2 + body), ("collision", 0.37)):
                was = then["present"][k] and np.linalg.norm(then["people"][k] - then["position"]) <= limit
                inside = now["present"][k] and np.linalg.norm(now["people"][k] - now["position"]) <= limit
                if inside and not was:
                    moving = round(float(np.linalg.norm(now["velocity"])), 3) != 0
                    robot = moving and now["velocity"] @ (now["people"][k] - now["position"]) > 0
                    out[f"{name}_{'robot_on_person' if robot else 'person_on_robot'}"] += weights
    last = sequence[-1]
    out["path_length"] += np.linalg.norm(last["position"] - sampled) * np.array([1.0, *last["situations"]])
    out["path_efficiency"] = out["path_length"][0] / last["geodesic"]
    out["min_distance_to_people"], out["min_distance_to_goal"] = least, near_goal
    out["final_distance_to_goal"] = np.linalg.norm(last["position"] - last["goal"])
    return out


def test_random_paths_equal_a_plain_loop_and_vmap_equals_a_loop():
    sequences = [wander(seed) for seed in range(3)]
    snapshots = [[as_snapshot(tick, now) for tick, now in enumerate(sequence)] for sequence in sequences]
    found = [measure(sequence) for sequence in snapshots]
    seen = np.zeros(len(EVENTS))
    for ours, sequence in zip(found, sequences, strict=True):
        theirs = by_loop(sequence)
        assert set(theirs) <= set(ours) == set(metrics.METRICS)
        for name, value in theirs.items():
            np.testing.assert_allclose(ours[name], value, rtol=2e-5, atol=1e-5, err_msg=name)
        seen += [theirs[name][0] for name in EVENTS]
    assert (seen > 2).all()
    together = jax.tree.map(
        lambda *leaves: jnp.stack(leaves), *[jax.tree.map(lambda *x: jnp.stack(x), *m) for m in snapshots]
    )

    def run(sequence):
        values = metric_values.along(sequence)
        return metric_values.compute(values)

    for name, value in jax.jit(jax.vmap(run))(together).items():
        np.testing.assert_allclose(value, np.stack([one[name] for one in found]), rtol=1e-5, atol=1e-6, err_msg=name)


def test_violations_to_the_surface_of_people():
    """SEAN 2.0's distance: a person's radius less than between the centers; contact and distances stay as they are."""
    sequence = wander(7)
    snapshots = [replace(as_snapshot(tick, now), to_surface=True) for tick, now in enumerate(sequence)]
    found, theirs = measure(snapshots), by_loop(sequence, PERSON_RADIUS)
    centers = by_loop(sequence)
    for name in (*EVENTS, "min_distance_to_people"):
        np.testing.assert_allclose(found[name], theirs[name], rtol=1e-6, err_msg=name)
    assert any(theirs[name][0] != centers[name][0] for name in EVENTS)


def test_units_shapes_and_types():
    """Values keep their types from step to step, or a rollout would be traced again; each metric names its unit."""
    here = at(0, people=[(1, 0)])
    values = metric_values.init(here)
    after = update(values, here, here)
    for one, other in zip(jax.tree.leaves(values), jax.tree.leaves(after), strict=True):
        assert one.dtype == other.dtype == jnp.float32 and one.shape == other.shape and not one.weak_type
    units = {"m", "s", "1", "rad", "m/s", "m/s2", "m/s3"}
    assert {metric.unit for metric in metrics.METRICS.values()} <= units
    for name, value in compute(after).items():
        assert value.shape in ((), (1 + SITUATIONS,)), name


def test_gradients_are_finite_where_the_robot_stands_at_its_goal_on_somebody():
    def loss(position):
        here = [replace(at(k, people=[(0, 0)]), position=position) for k in (0, 10)]
        values = metric_values.update(metric_values.init(here[0]), *here)
        return sum(value.sum() for value in metric_values.compute(values).values())

    assert np.isfinite(jax.jit(jax.grad(loss))(jnp.zeros(2))).all()


@pytest.mark.parametrize("kind", [np.float32, np.float16, np.int32])
def test_time_is_counted_in_the_precision_that_is_set_whatever_the_path_is_given_in(kind):
    whole = metric.zero_duration(replace(at(), geodesic=np.array(3, kind)))
    assert whole.step == np.float32(STEP) and whole.step.dtype == jnp.result_type(float)

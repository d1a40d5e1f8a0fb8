"""Scenario: valid resets, one trace, episodes that a key alone decides, and how they end."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.metrics import METRICS
from sean_jax.policies import go_to_goal
from sean_jax.world.environment import clearance
from support import programs, trees
from support.quick import quick

SEEDS, STEPS = 24, 150
MEASURED = ("time_in_situation", "path_length", "mean_speed")  # all of them would take long to compile


@pytest.fixture(scope="module")
def scenario(scenario):
    """The scenario that all tests share, with few metrics and 12 s for an episode."""
    return scenario.replace(metrics=tuple((name, METRICS[name]) for name in MEASURED), time_limit=12.0)


@pytest.fixture(scope="module")
def lab():
    return sean_jax.make("lab", people=5, dynamics="twin", metrics=MEASURED)


@pytest.fixture(scope="module")
def starts(scenario):
    """States after reset for many keys."""
    keys = jax.random.split(jax.random.key(0), SEEDS)
    return programs.resets(scenario, keys)


@pytest.fixture(scope="module")
def episode(scenario):
    """A compiled rollout until after the end, the last state and the frames of two keys."""
    run = jax.jit(jax.vmap(lambda key: sean_jax.rollout(scenario, go_to_goal, key, STEPS)))
    return run, *run(jax.random.split(jax.random.key(1), 2))


def test_nobody_starts_in_an_obstacle_or_in_somebody(scenario, starts):
    people = np.asarray(starts.pedestrians.position)
    free = jax.jit(lambda points: clearance(scenario.environment, points))
    assert np.asarray(free(jnp.asarray(people.reshape(-1, 2)))).min() >= 0.2
    apart = np.linalg.norm(people[:, :, None] - people[:, None], axis=-1) + 9 * np.eye(people.shape[1])
    assert apart.min() >= 0.5


def test_robot_starts_free_and_clear_of_people(scenario, starts):
    robots = starts.robot.position
    free = np.asarray(programs.clearance(scenario.environment, robots))
    assert free.min() >= scenario.robot.radius
    gap = np.linalg.norm(np.asarray(starts.pedestrians.position) - np.asarray(robots)[:, None], axis=-1)
    assert gap.min() >= 0.5


def test_start_and_goal_are_as_far_apart_as_asked(scenario, starts):
    walk = np.asarray(starts.task.geodesic)
    straight = np.linalg.norm(np.asarray(starts.task.goal - starts.task.start), axis=-1)
    assert (walk >= straight - 1e-3).all()
    assert (walk >= 3.9).all() and (walk <= 20.1).all()
    assert len(np.unique(np.asarray(starts.task.goal_group))) == 3  # every group is drawn at times


def test_equal_keys_give_equal_episodes_and_others_do_not(episode):
    run, last, frames = episode
    again_last, again_frames = run(jax.random.split(jax.random.key(1), 2))
    pairs = zip(jax.tree.leaves((last.robot, frames)), jax.tree.leaves((again_last.robot, again_frames)), strict=True)
    for one, other in pairs:
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
    assert np.abs(np.asarray(frames.people[0]) - np.asarray(frames.people[1])).max() > 1.0


def test_a_rollout_stays_finite_out_of_obstacles_and_within_speed(scenario, episode):
    _, last, frames = episode
    for leaf in jax.tree.leaves((last.pedestrians, last.robot, last.metrics, frames)):
        assert np.isfinite(np.asarray(leaf, float)).all()
    everyone = jnp.asarray(np.asarray(frames.people).reshape(-1, 2))
    assert np.asarray(programs.clearance(scenario.environment, everyone)).min() >= 0.2 - 1e-3
    assert np.asarray(programs.clearance(scenario.environment, frames.position.reshape(-1, 2))).min() >= 0.16 - 0.02
    speed = np.linalg.norm(np.asarray(frames.people_velocity), axis=-1)
    assert speed.max() <= 1.3 * np.asarray(last.pedestrians.preferred_speed).max() + 0.3


def test_a_step_traces_once_and_a_batch_is_its_episodes(lab):
    @programs.jit_once
    def step(state, action):
        return sean_jax.step(lab, state, action)

    states = programs.resets(lab, jax.random.split(jax.random.key(6), 8))
    state, action = jax.tree.map(lambda leaf: leaf[3], states), jnp.asarray([0.3, 0.2])
    for _ in range(3):
        state, states = step(state, action), programs.steps(lab, states, action)
    row = jax.tree.map(lambda leaf: leaf[3], states)
    for name in ("pedestrians", "robot", "task", "groups", "metrics", "situations", "tick"):
        trees.assert_close(getattr(row, name), getattr(state, name), atol=1e-5, rtol=1e-5)
    assert int(state.tick) == 3


def test_a_task_is_completed_after_the_goal_is_held_and_never_timed_out_too(scenario, starts):
    short = scenario.replace(time_limit=1.0, hold_time=jnp.float32(0.3))
    state = jax.tree.map(lambda leaf: leaf[2], starts)
    at_goal = state.replace(robot=short.robot.place(short.robot, state.task.goal, state.task.goal_heading))
    step = jax.jit(lambda state: sean_jax.step(short, state, jnp.zeros(2, jnp.float32)))
    ended = {}
    for name, begun in (("held", at_goal), ("away", state)):
        flags = []
        for _ in range(12):
            begun = step(begun)
            flags.append((bool(begun.completed), bool(begun.timed_out)))
        ended[name] = flags
    assert ended["held"][:2] == [(False, False)] * 2 and ended["held"][2:] == [(True, False)] * 10
    assert ended["away"][:9] == [(False, False)] * 9 and ended["away"][9:] == [(False, True)] * 3


def test_a_robot_is_placed_at_rest_and_its_task_goes_on(scenario, starts):
    state = jax.tree.map(lambda leaf: leaf[5], starts)
    going = replace(state, robot=replace(state.robot, speed=jnp.float32(0.5)), ticks_at_goal=jnp.int32(7))
    spots = jnp.asarray([[1.0, 2.0], [-3.0, 0.5], [0.0, 0.0]])
    heading = jnp.asarray([[0.0, -2.0], [0.6, 0.8], [0.0, 0.0]])
    place = jax.jit(jax.vmap(lambda spot, heading: sean_jax.teleport(scenario, going, spot, heading)))
    placed = place(spots, heading)
    np.testing.assert_array_equal(placed.robot.position, spots)
    np.testing.assert_allclose(placed.robot.heading, [[0.0, -1.0], [0.6, 0.8], [1.0, 0.0]], atol=1e-6)
    fresh = jax.vmap(scenario.robot.place, (None, 0, 0))(scenario.robot, spots, heading)
    trees.assert_close(placed.robot, fresh, atol=1e-6)
    assert not placed.ticks_at_goal.any()
    jax.tree.map(lambda old, new: np.testing.assert_array_equal(old[None], new[:1]), going.task, placed.task)
    jax.tree.map(lambda old, new: np.testing.assert_array_equal(old[None], new[:1]), going.metrics, placed.metrics)
    slope = jax.jit(jax.jacobian(lambda turn: sean_jax.teleport(scenario, going, spots[0], turn).robot.heading))
    np.testing.assert_allclose(slope(jnp.asarray([0.0, 2.0])), [[0.5, 0.0], [0.0, 0.0]], atol=1e-6)
    assert np.isfinite(slope(jnp.zeros(2))).all()


def test_metrics_stand_still_after_the_end(scenario, episode):
    _, last, frames = episode
    seconds = np.asarray(frames.active).sum(1) * scenario.time_step
    measured = jax.jit(jax.vmap(lambda state: sean_jax.results(scenario, state)))(last)
    np.testing.assert_allclose(measured["time_in_situation"][:, 0], seconds, rtol=1e-5)
    assert seconds.max() == pytest.approx(scenario.time_limit)


def test_observation_is_in_the_robots_frame(scenario, starts):
    state = jax.tree.map(lambda leaf: leaf[4], starts)
    seen = programs.observe(scenario, state)
    heading, position = np.asarray(state.robot.heading), np.asarray(state.robot.position)
    left = np.array([-heading[1], heading[0]])
    gap = np.asarray(state.pedestrians.position) - position
    np.testing.assert_allclose(np.asarray(seen.people), np.stack([gap @ heading, gap @ left], -1), atol=1e-5)
    to_goal = np.asarray(state.task.goal) - position
    np.testing.assert_allclose(np.asarray(seen.goal), [to_goal @ heading, to_goal @ left], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (dict(environment="warehose"), "did you mean 'warehouse'"),
        (dict(behavior="grap"), "did you mean 'graph'"),
        (dict(task="join"), "task: 'join' is not one of join_group, leave_group"),
        (dict(robot="kurri"), "did you mean 'kuri'"),
        (dict(forces="helbing1996"), "did you mean 'helbing1995'"),
        (dict(people=10_000), "the most that do is"),
        (dict(people=-1), "people: -1 must be from 0 to 100,000"),
        (dict(time_limit=-1.0), "time_limit: -1.0 must be from 0.1 to 86,400 s"),
        (dict(time_step=0.0), "time_step: 0.0 must be from 0.001 to 1 s"),
        (dict(hold_time=-2.0), "hold_time: -2.0 must be from 0 to 86,400 s"),
        (dict(task_distance=(5.0, 4.0)), "task_distance"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_sentence(arguments, words):
    with pytest.raises(ValueError, match="(?s)" + words.replace("(", r"\(")) as refused:
        sean_jax.make(**({"people": 16, "dynamics": "twin"} | arguments))
    assert "\n" not in str(refused.value)


@pytest.mark.night
def test_the_largest_number_that_fits_fits():
    with pytest.raises(ValueError) as refused:
        sean_jax.make(people=10_000, dynamics="twin")
    most = int(str(refused.value).rstrip(".").split()[-1])
    full = sean_jax.make(people=most, dynamics="twin", metrics="none")
    people = np.asarray(programs.reset(full, jax.random.key(0)).pedestrians.position)
    apart = np.linalg.norm(people[:, None] - people[None], axis=-1) + 9 * np.eye(most)
    assert apart.min() >= 0.5
    with pytest.raises(ValueError, match=f"the most that do is {most}"):
        sean_jax.make(people=most + 1, dynamics="twin")


@pytest.mark.night
@pytest.mark.parametrize("behavior", quick(["graph", "random"], "graph"))
def test_a_crowd_that_warms_up_has_walked_before_the_task_begins(behavior):
    """As people walk among themselves, and the robot begins free of who is there by then."""
    cold = sean_jax.make("lab", behavior=behavior, people=5, dynamics="twin", metrics=MEASURED)
    warm = replace(cold, warm_up=3.0)
    keys = jax.random.split(jax.random.key(5), 8)
    first = programs.resets(cold, keys)
    then = programs.resets(warm, keys)

    robot = first.robot
    far = replace(robot, position=jnp.full_like(robot.position, 1e4))
    for _ in range(30):
        first = programs.steps(cold, replace(first, robot=far), jnp.zeros(2))
    np.testing.assert_allclose(then.pedestrians.position, first.pedestrians.position, atol=1e-4)
    np.testing.assert_allclose(then.pedestrians.velocity, first.pedestrians.velocity, atol=1e-3)
    assert np.asarray(jnp.abs(then.pedestrians.velocity).max((1, 2)) > 0.2).all()
    assert (np.asarray(then.tick) == 0).all() and not np.asarray(then.completed | then.timed_out).any()
    np.testing.assert_array_equal(then.robot.position, then.task.start)
    gap = jnp.linalg.norm(then.pedestrians.position - then.robot.position[:, None], axis=-1)
    assert float(gap.min()) > warm.robot.radius + 0.2


def test_the_next_task_leaves_the_crowd_as_it_is(lab):
    keys = jax.random.split(jax.random.key(6), 8)
    go_on = jax.jit(jax.vmap(lambda state, key: sean_jax.next_task(lab, state, key)))
    state = programs.resets(lab, keys)
    for _ in range(15):
        state = programs.steps(lab, state, jnp.asarray([0.3, 0.2]))
    after = go_on(state, jax.random.split(jax.random.key(7), 8))
    for name in ("pedestrians", "groups", "memory"):
        trees.assert_equal(getattr(state, name), getattr(after, name))
    assert (np.asarray(after.tick) == 0).all() and (np.asarray(after.robot.speed) == 0.0).all()
    np.testing.assert_array_equal(after.robot.position, after.task.start)
    assert not np.allclose(after.task.start, state.task.start)  # the lab has one group
    measured = jax.jit(jax.vmap(lambda state: sean_jax.results(lab, state)["mean_speed"]))
    assert float(jnp.nanmax(measured(state)[:, 0])) > 0.1 and not float(jnp.nanmax(measured(after)[:, 0])) > 0.0
    assert not np.array_equal(jax.random.key_data(after.streams.people), jax.random.key_data(state.streams.people))


def test_a_recording_does_not_warm_up(tmp_path):
    file = tmp_path / "walk.csv"
    file.write_text("frame,id,x,y\n0,1,0,0\n10,1,1,0\n")
    with pytest.raises(ValueError, match="warm_up: 3 s, but a recording begins with its own people; leave it out."):
        sean_jax.make("lab", behavior="playback", recording=str(file), warm_up=3.0)

"""A scenario as an environment of reinforcement learning: observations, rewards, ends, delays, randomization."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import mdp, metrics, registry, robots
from sean_jax.core import random_streams
from sean_jax.core.errors import InputError
from sean_jax.mdp import REWARDS, Env, delayed, make_env, of_metric, rewards, stacked
from sean_jax.mdp import observations as observing
from sean_jax.simulation.scenario import snapshot

LIMIT = 3.0  # s, of an episode


@pytest.fixture(scope="module")
def scenario():
    return sean_jax.make("lab", people=6, dynamics="twin", behavior="random", time_limit=LIMIT)


COUNTED = ("personal_robot_on_person", "intimate_person_on_robot", "collision_with_obstacle")
TERMS = {
    "goal": "goal",
    "path": "path",
    "people": mdp.observations.people(3),
    "late": delayed("goal", 2),
    "somewhat_late": delayed("goal", 0, 3),
    "last": stacked("speeds", 3),
    "mine": lambda scenario, state: state.robot.position,
}
WEIGHTS = {"progress": 1.0, "completed": 10.0, "time": -1.0, **dict.fromkeys(COUNTED, 1.0)}


@pytest.fixture(scope="module")
def env(scenario):
    return make_env(scenario, TERMS, WEIGHTS, action_delay=(0, 2))


def test_an_environment_compiles_itself(scenario):
    """A loop in a notebook, without jit, traces each function once."""
    traced = []

    def counted(scenario, before, after):
        traced.append(after)
        return 0.0

    own = make_env(scenario, ("goal",), {"counted": counted})
    traced.clear()
    own = own.with_pool(jax.random.key(0), 2)
    _, state = own.reset(jax.random.key(0))
    for k in range(3):
        _, state, *_ = own.step(jax.random.key(k), state, jnp.zeros(2))
    assert len(traced) == 1


@pytest.fixture(scope="module")
def episodes(env):
    """What 40 random steps of 8 environments give, stacked (T, B, ...), with what the simulation was before each."""

    @jax.jit
    def play(env, key):
        first, state = jax.vmap(env.reset)(jax.random.split(key, 8))

        def one(state, tick):
            act, follow = jax.random.split(jax.random.fold_in(key, tick))
            action = jax.random.uniform(act, (8, 2), minval=-0.3, maxval=1.0)
            seen, after, *rest = jax.vmap(env.step)(jax.random.split(follow, 8), state, action)
            return after, (state, seen, after, action, *rest)

        return first, jax.lax.scan(one, state, jnp.arange(40))[1]

    return play(env, jax.random.key(4))


def lie_within(space, observation):
    """Whether observations (..., shape) lie within the bounds of each term."""
    return space.keys() == observation.keys() and all(
        observation[name].shape[-len(box.shape) :] == box.shape
        and ((observation[name] >= box.low) & (observation[name] <= box.high)).all()
        for name, box in space.items()
    )


@pytest.mark.night
def test_observations_lie_in_their_space(env, episodes):
    first, (_, seen, *_) = episodes
    space = env.observation_space
    assert set(first) == set(TERMS) == {name for name, _ in space.items()}
    assert lie_within(space, first) and lie_within(space, seen)
    assert env.action_space == (-1.0, 1.0, (2,))


def _merged(leaf):
    """(T, B, ...) as (T B, ...)."""
    return leaf.reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:])


def test_terms_are_those_of_observe(scenario, episodes):
    """Against ``sean_jax.observe``, which the policies read; the nearest people against a loop."""
    _, (before, seen, after, *_) = episodes
    state = jax.tree.map(_merged, after.simulation)
    flat = {name: np.asarray(_merged(part)) for name, part in seen.items()}
    wanted = jax.jit(jax.vmap(sean_jax.observe, (None, 0)))(scenario, state)
    np.testing.assert_allclose(flat["goal"], wanted.goal, atol=1e-4)
    np.testing.assert_allclose(flat["path"], wanted.path, atol=1e-4)
    np.testing.assert_allclose(flat["mine"], state.robot.position, atol=1e-6)
    for row in range(0, len(flat["people"]), 7):
        near = np.argsort(np.linalg.norm(wanted.people[row], axis=1))[:3]
        rows = np.concatenate([wanted.people[row][near], wanted.people_velocity[row][near], np.ones((3, 1))], 1)
        rows[np.linalg.norm(rows[:, :2], axis=1) > mdp.observations.REACH] = 0.0
        np.testing.assert_allclose(flat["people"][row], rows, atol=1e-4)


def test_visible_people_are_not_behind_obstacles(scenario, episodes):
    """Against 400 points of each line of sight, in MuJoCo's boxes of the lab."""
    _, (_, seen, after, *_) = episodes
    state = jax.tree.map(_merged, after.simulation)
    term = mdp.observations.people(3, visible=True)
    rows = np.asarray(jax.jit(jax.vmap(lambda state: term.read(scenario, state, ())))(state), float)
    people = np.asarray(_merged(seen["people"]), float)
    boxes, share = scenario.environment.obstacles, np.linspace(0.0, 1.0, 400)[:, None]
    center, half, yaw = (np.asarray(part, float) for part in (boxes.center, boxes.half_extent, boxes.yaw))
    turn = np.stack([np.stack([np.cos(yaw), np.sin(yaw)], -1), np.stack([-np.sin(yaw), np.cos(yaw)], -1)], 1)
    hidden = 0
    for row in range(0, len(rows), 5):
        heading = np.asarray(state.robot.heading[row], float)
        for shown, person in zip(rows[row], people[row], strict=True):
            ahead = person[:2] @ np.array([heading, [-heading[1], heading[0]]])
            line = np.asarray(state.robot.position[row], float) + share * ahead
            inside = np.abs(np.einsum("kij,pkj->pki", turn, line[:, None] - center)) - half
            depth = inside.max(-1).min()  # m, negative in a box
            if abs(depth) > 1e-2:
                np.testing.assert_allclose(shown, person * (depth > 0.0), atol=1e-4)
                hidden += person[4] > 0.0 and depth < 0.0
    assert hidden > 5


def test_the_term_robot_has_its_limits(scenario):
    state = jax.eval_shape(sean_jax.reset, scenario, jax.random.key(0))
    kuri = mdp.observations.OBSERVATIONS["robot"].read(scenario, state, ())
    np.testing.assert_allclose(kuri, [0.16, 0.5, 0.5, 5.0, 5.0, 3.0, 10.0])
    other = replace(scenario, robot=robots.load("turtlebot3"))
    np.testing.assert_allclose(
        mdp.observations.OBSERVATIONS["robot"].read(other, state, ()), [0.11, 1.0, 0.5, 0.8, 0.4, 1.7, 1.5]
    )


def test_episodes_end_and_others_begin(env, episodes):
    _, (_, seen, after, _, _, terminated, truncated, info) = episodes
    length, over = np.asarray(info["episode_length"]), np.asarray(terminated | truncated)
    assert over.sum() >= 8 and not (terminated & truncated).any()
    assert (length[np.asarray(truncated)] == round(LIMIT / 0.1)).all()
    assert (np.asarray(after.episode_length)[over] == 0).all() and (np.asarray(after.simulation.tick)[over] == 0).all()
    np.testing.assert_array_equal(np.asarray(after.episode_length)[~over], length[~over])
    moved = np.abs(np.asarray(info["final_observation"]["mine"]) - np.asarray(seen["mine"])).max(-1)
    assert (moved[~over] == 0).all() and (moved[over] > 0.1).all()


def test_random_people_have_no_groups(scenario, episodes):
    """Nor the situations of groups; ``test_random_behavior`` has long episodes."""
    _, (*_, after, _, _, _, _, info) = episodes
    assert (np.asarray(after.simulation.pedestrians.group) == -1).all()
    assert after.simulation.groups.radius.shape[-1] == 0
    names = [name for name, _ in scenario.situations]
    seen = np.asarray(info["situations"])
    assert not seen[..., [names.index("join_group"), names.index("leave_group")]].any() and seen.any()


def test_counted_rewards_add_up_to_the_metrics(env, episodes):
    _, (*_, terminated, truncated, info) = episodes
    for row in range(8):
        ends = np.flatnonzero(np.asarray(terminated | truncated)[:, row])
        last = int(ends[0])
        for name in COUNTED:
            total = np.asarray(info["rewards"][name])[: last + 1, row].sum()
            assert total == np.asarray(info["metrics"][name])[last, row, 0], name
    assert sum(np.asarray(info["rewards"][name]).sum() for name in COUNTED) > 0


@pytest.mark.night
def test_no_metrics_change_nothing_but_the_work(env, episodes):
    """Each step of the episodes by a program with fewer operations, to rounding: XLA fuses the two differently."""
    bare = replace(env, scenario=sean_jax.make("lab", people=6, behavior="random", time_limit=LIMIT, metrics="none"))
    _, (before, seen, after, action, reward, terminated, truncated, _) = episodes
    unmeasured = replace(before, simulation=replace(before.simulation, metrics={}))
    ticks = jnp.arange(action.shape[0])
    keys = jax.vmap(lambda tick: jax.random.split(jax.random.split(jax.random.fold_in(jax.random.key(4), tick))[1], 8))

    def steps(env, states):
        return jax.vmap(jax.vmap(env.step))(keys(ticks), states, action)

    *outcome, info = jax.jit(steps)(bare, unmeasured)
    assert info["metrics"] == {} and np.asarray(terminated | truncated).any()
    expected = seen, replace(after, simulation=replace(after.simulation, metrics={})), reward, terminated, truncated
    for ours, theirs in zip(
        *map(jax.tree.leaves, (random_streams.as_numbers(outcome), random_streams.as_numbers(expected))), strict=True
    ):
        exact = not jnp.issubdtype(ours.dtype, jnp.floating)
        np.testing.assert_allclose(ours, theirs, rtol=0.0 if exact else 1e-5, atol=0.0 if exact else 1e-5)
    sizes = [len(jax.make_jaxpr(steps)(*given).jaxpr.eqns) for given in ((env, before), (bare, unmeasured))]
    assert sizes[1] < 0.95 * sizes[0], sizes


@pytest.mark.parametrize("part", ["rewards", "terminations"])
def test_a_metric_that_is_left_out_is_missed_in_one_sentence(part):
    bare = sean_jax.make("lab", people=2, behavior="random", metrics="none")

    def mine(scenario, before, after):
        return after.metrics["path_length"][0] if part == "rewards" else after.metrics["path_length"][0] > 9.0

    given = {"rewards": {"mine": mine}} if part == "rewards" else {"terminations": [mine]}
    text = (
        rf"^{part}: .*test_env.py:\d+: KeyError: 'path_length', a metric that is not measured here; take mdp.of_metric"
    )
    with pytest.raises(InputError, match=text):
        make_env(bare, **given)


def test_none_is_alone():
    with pytest.raises(InputError, match="metrics: 'none' is beside others"):
        sean_jax.make("lab", people=2, behavior="random", metrics=["none", "path_length"])


def test_progress_adds_up_to_the_way(env, episodes):
    """From the first state of the first episode to its last: telescoping potentials."""
    _, (before, *_, terminated, truncated, info) = episodes
    for row in range(8):
        last = int(np.flatnonzero(np.asarray(terminated | truncated)[:, row])[0])
        start = -float(before.potentials["progress"][0, row])
        parts = np.asarray(info["rewards"]["progress"])[: last + 1, row]
        end = start - parts.sum()
        assert start == pytest.approx(float(before.simulation.task.geodesic[0, row]), abs=1e-3)
        straight = np.linalg.norm(np.asarray(info["final_observation"]["goal"])[last, row])
        assert end >= straight - 1e-3
        returned = np.asarray(info["episode_return"])[last, row]
        everything = sum(np.asarray(part)[: last + 1, row].sum() for part in info["rewards"].values())
        assert returned == pytest.approx(everything, abs=1e-3)


def test_delays_and_stacks(env, episodes):
    first, (_, seen, _, _, _, terminated, truncated, _) = episodes
    goal = np.concatenate([np.asarray(first["goal"])[None], np.asarray(seen["goal"])])
    late = np.concatenate([np.asarray(first["late"])[None], np.asarray(seen["late"])])
    any_late = np.concatenate([np.asarray(first["somewhat_late"])[None], np.asarray(seen["somewhat_late"])])
    end = int(np.flatnonzero(np.asarray(terminated | truncated).any(1))[0])
    np.testing.assert_array_equal(late[0], goal[0])
    np.testing.assert_array_equal(late[2 : end + 1], goal[: end - 1])
    drawn = set()
    for row in range(8):
        fits = [d for d in range(4) if np.array_equal(any_late[d : end + 1, row], goal[: end + 1 - d, row])]
        assert len(fits) == 1
        drawn |= set(fits)
    assert len(drawn) > 1
    last = np.asarray(seen["last"])
    assert last.shape[-2:] == (3, 2)
    np.testing.assert_array_equal(last[2:end, :, 2], last[: end - 2, :, 0])


def test_commands_are_late(env, episodes):
    """The robot's speed does not change before the first command has arrived."""
    _, (before, _, after, action, *_) = episodes
    late = np.asarray(before.late[0])
    assert set(late) > {0} and late.max() == 2
    moving = np.abs(np.asarray(after.simulation.robot.speed)) > 1e-6
    for row in range(8):
        assert int(np.argmax(moving[:, row])) == late[row]


def slippery(key, scenario):
    """Another top speed in each episode."""
    top = jax.random.uniform(key, (), minval=0.1, maxval=0.5)
    return scenario.replace(robot=replace(scenario.robot, max_speed=top))


@pytest.fixture(scope="module")
def pooled(scenario):
    """Of four starts."""
    env = make_env(scenario, TERMS, WEIGHTS, action_delay=(0, 2), randomization=slippery)
    return jax.jit(Env.with_pool, static_argnums=2)(env, jax.random.key(1), 4)


env_step = jax.jit(Env.step)


@pytest.mark.night
def test_a_pool_gives_its_starts(pooled, episodes):
    assert pooled.pool.weights.shape == (4,) and (np.asarray(episodes[1][0].start) == -1).all()
    state = jax.tree.map(lambda leaf: leaf[2], pooled.pool.states)
    state = replace(state, simulation=replace(state.simulation, streams=random_streams.streams(jax.random.key(2))))
    for tick in range(round(LIMIT / 0.1)):
        seen, state, _, terminated, truncated, _ = env_step(pooled, jax.random.key(tick), state, jnp.zeros(2))
    assert bool(truncated) and not bool(terminated)
    starts = np.asarray(pooled.pool.states.simulation.robot.position)
    gaps = np.abs(starts - np.asarray(state.simulation.robot.position)).max(-1)
    assert (gaps == 0.0).sum() == 1
    np.testing.assert_array_equal(seen["goal"], np.asarray(pooled.pool.observations["goal"])[gaps.argmin()])
    streams = jax.random.key_data(pooled.pool.states.simulation.streams.people)
    assert not (np.asarray(streams) == np.asarray(jax.random.key_data(state.simulation.streams.people))).all(-1).any()


def test_randomization_is_of_the_key(scenario, pooled):
    states, tops = pooled.pool.states, []
    for row in range(4):
        state = jax.tree.map(lambda leaf, row=row: leaf[row], states)
        tops.append(float(slippery(state.randomization, scenario).robot.max_speed))
        for tick in range(25):
            seen, state, *_ = env_step(pooled, jax.random.key(tick), state, jnp.array([1.0, 0.0]))
        assert int(state.start) == row and float(seen["last"][0, 0]) == pytest.approx(tops[-1], rel=0.02)
    assert np.std(tops) > 0.02


@pytest.mark.night
def test_ends_of_ones_own(scenario):
    """A wall ends the episode when the robot has touched it, and so does a function."""

    def fifth(scenario, before, after):
        return after.tick >= 5

    env = make_env(replace(scenario, time_limit=60.0), ["goal"], {"time": -1.0}, terminations=["obstacle", fifth])
    assert [name for name, _ in env.terminations] == ["obstacle", "fifth"]
    walls = replace(env, terminations=env.terminations[:1])
    _, start = jax.jit(env.reset)(jax.random.key(0))
    ends = []
    for one in (env, walls):
        advance, state = jax.jit(one.advance), start
        for tick in range(1, 300):
            state, _, _, terminated, truncated, info = advance(state, jnp.array([1.0, 0.0]))
            if terminated:
                ends.append(tick)
                break
    assert ends[0] == 5 < ends[1] and float(info["metrics"]["collision_with_obstacle"][0]) == 1
    assert not bool(truncated) and not bool(info["completed"])


@pytest.mark.night
def test_gradients_by_actions_through_people(scenario):
    """Through robot, people and depth: finite, and equal to differences in float64 elsewhere (test_gradients)."""
    weights = {"progress": 1.0, "personal_space": -1.0, "acceleration": -0.1}
    env = make_env(scenario, ["goal", "people"], weights).with_transition_gradients()
    _, start = jax.jit(env.reset)(jax.random.key(1))

    def total(actions):
        def one(state, action):
            state, seen, reward, *_ = env.advance(state, action)
            return state, reward + 0.0 * seen["people"].sum()

        return jax.lax.scan(one, start, actions)[1].sum()

    actions = jnp.tile(jnp.array([0.6, 0.1]), (8, 1))
    slope = jax.jit(jax.grad(total))(actions)
    assert jnp.isfinite(slope).all() and (jnp.abs(slope[:, 0]) > 1e-4).all()
    up, down = (jax.jit(total)(actions.at[0, 0].add(sign * 0.02)) for sign in (1, -1))
    assert float(slope[0, 0]) == pytest.approx(float(up - down) / 0.04, rel=0.1)


def test_actions_are_shares_of_the_limits(scenario):
    robot = replace(scenario.robot, max_reverse_speed=jnp.asarray(0.2))
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 2)):
        command = mdp.to_command(robot, jnp.asarray(action))
        np.testing.assert_allclose(mdp.to_action(robot, command), action, atol=1e-6)
    assert float(mdp.to_command(robot, jnp.array([-5.0, 0.0]))[0]) == pytest.approx(-0.2)


@pytest.mark.night
def test_every_term_works():
    """All terms of both dicts under jit and vmap, with finite numbers."""
    scenario = sean_jax.make("lab", people=4, dynamics="twin", sensors=["lidar"])
    seen = {**mdp.OBSERVATIONS, "noisy": mdp.observations.sensor("lidar", 0.0, 6.0)}
    env = make_env(scenario, seen, dict.fromkeys(REWARDS, 1.0))
    observation, state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 2))
    out = jax.jit(jax.vmap(env.advance))(state, jnp.full((2, 2), 0.5))
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves((observation, out[1], out[2])))
    assert lie_within(env.observation_space, out[1])
    flat = jax.vmap(lambda one: mdp.flatten(env.observations, one))(observation)
    assert flat.shape == (2, sum(math.prod(box.shape) for box in env.observation_space.values()) - 48 * 64 * 4)


def test_contacts_cost_by_their_time(scenario, episodes):
    """Against distances by numpy, of a robot and a person placed by hand: also in steps after the onset."""
    state = jax.tree.map(lambda leaf: leaf[0, 0], episodes[1][0].simulation)
    reach = float(scenario.robot.radius) + float(scenario.forces.walking.radius)
    for gap, speed, contact, intimate in [
        (reach - 0.05, 0.3, True, reach - 0.05 <= 0.45),
        (reach - 0.05, 0.0, False, reach - 0.05 <= 0.45),  # the person's fault
        (reach - 0.05, -0.3, False, reach - 0.05 <= 0.45),
        (0.44, 0.0, False, True),
        (0.46, 0.0, False, False),
        (5.0, 0.3, False, False),
    ]:
        robot = replace(state.robot, speed=jnp.asarray(speed))
        ahead = robot.position + gap * robot.heading
        position = jnp.full_like(state.pedestrians.position, 1e3).at[0].set(ahead)
        people = replace(state.pedestrians, position=position, present=jnp.ones_like(state.pedestrians.present))
        after = replace(state, robot=robot, pedestrians=people)
        found = {name: float(REWARDS[name].step(scenario, after, after)) for name in ("contact_time", "intimate_time")}
        assert found == pytest.approx({"contact_time": 0.1 * contact, "intimate_time": 0.1 * intimate}), (gap, speed)
        nobody = replace(people, present=jnp.zeros_like(people.present))
        alone = replace(after, pedestrians=nobody)
        assert not any(float(REWARDS[name].step(scenario, alone, alone)) for name in found)


def test_a_robot_that_stays_at_an_obstacle_goes_on_to_pay(scenario, episodes):
    """The count is of the onset alone; the time is of each step."""
    state = jax.tree.map(lambda leaf: leaf[0, 0], episodes[1][0].simulation)
    distance = lambda place: metrics.proximity.obstacle_distance(  # noqa: E731
        snapshot(scenario, replace(state, robot=replace(state.robot, position=place)))
    )
    spots = state.robot.position[None] + 8.0 * jax.random.uniform(jax.random.key(0), (2000, 2), float, -1.0, 1.0)
    far = np.asarray(jax.vmap(distance)(spots)) - float(scenario.robot.radius)
    for row in (int(np.argmin(np.abs(far))), int(np.argmax(far))):
        at = replace(state, robot=replace(state.robot, position=spots[row]))
        found = [float(REWARDS[name].step(scenario, at, at)) for name in ("obstacle_time", "collision_with_obstacle")]
        assert found == pytest.approx([0.1 if far[row] <= 0.01 else 0.0, 0.0])
    assert far.min() < 0.01 < far.max()


def test_the_default_agent_sees_its_hold_and_no_clock(scenario, episodes):
    """Its episodes are bootstrapped at the time limit, which would be another end if it saw it come."""
    state = jax.tree.map(lambda leaf: leaf[0, 0], episodes[1][0].simulation)
    late = replace(state, tick=state.tick + 20, ticks_at_goal=jnp.asarray(3, jnp.int32))
    seen = [dict(observing.begin(make_env(scenario).observations, scenario, one, jax.random.key(0))[0]) for one in
            (replace(late, tick=state.tick), late)]  # fmt: skip
    for name in seen[0]:
        np.testing.assert_array_equal(seen[0][name], seen[1][name])
    share = 3 * 0.1 / max(float(scenario.hold_time), 0.1)
    assert float(seen[0]["hold"][0]) == pytest.approx(min(share, 1.0))
    shown = observing.begin(observing.as_terms(["time"]), scenario, late, jax.random.key(0))[0]["time"]
    np.testing.assert_allclose(shown, [float(late.tick) * 0.1 / LIMIT, min(share, 1.0)], rtol=1e-5)


def test_situations_weigh(scenario, episodes):
    term = mdp.in_situations(REWARDS["time"], ["empty"])
    state = jax.tree.map(lambda leaf: leaf[0, 0], episodes[1][0].simulation)
    for value in (False, True):
        after = replace(state, situations=jnp.full(5, value))
        assert float(term.step(scenario, state, after)) == pytest.approx(0.1 * value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"observations": ["gaol"]}, "observations: 'gaol' is not one of .*goal"),
        ({"observations": []}, "observations: there is none"),
        ({"observations": {"x": mdp.observations.sensor("sonar", 0, 1)}}, "no sensor 'sonar'"),
        ({"rewards": {"progres": 1.0}}, "rewards: 'progres' is not one of .*progress"),
        ({"rewards": {}}, "rewards: there is none"),
        ({"rewards": {"progress": "much"}}, "rewards: progress is 'much'"),
        ({"terminations": ["colision"]}, "terminations: 'colision' is not one of .*collision"),
        ({"action_delay": (2, 1)}, "action_delay: 2 to 1"),
    ],
)
def test_bad_input(scenario, arguments, message):
    with pytest.raises(InputError, match=message):
        make_env(scenario, **arguments)


def test_bad_terms():
    with pytest.raises(InputError, match="delay: -1"):
        delayed("goal", -1)
    with pytest.raises(InputError, match="stack"):
        stacked("goal", 0)
    with pytest.raises(InputError, match="either"):
        rewards.RewardTerm()
    with pytest.raises(InputError, match="no metric"):
        of_metric("nothing")
    with pytest.raises(InputError, match="potential"):
        mdp.in_situations(REWARDS["progress"], ["empty"])


def test_registry():
    assert "Warehouse-Graph-JoinGroup-v0" in registry.ALL_ENVS
    env = registry.load("Lab-Graph-Mixed-v0", config_overrides={"people": 5, "rewards.progress": 3.0})
    assert env.scenario.people == 5 and dict(env.rewards)["progress"].weight == 3.0
    assert env.scenario.task_name == "join_group,leave_group"
    states = jax.jit(jax.vmap(lambda key: env.reset(key)[1].simulation))(jax.random.split(jax.random.key(0), 16))
    joins = np.asarray(states.task.goal_group) >= 0
    assert 0 < joins.sum() < 16
    for name, override, message in [
        ("Lab-Graph-Mixd-v0", {}, "Lab-Graph-Mixed-v0"),
        ("Lab-Graph-Mixed-v0", {"peeple": 3}, "peeple"),
        ("Lab-Graph-Mixed-v0", {"rewards.progres": 3}, "progres"),
    ]:
        with pytest.raises(InputError, match=message):
            registry.load(name, config_overrides=override)

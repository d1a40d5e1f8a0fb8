"""Chance: no key is drawn from twice, within an episode or between the uses of a seed."""

import dataclasses
import itertools

import jax
import jax.extend.random as extend_random
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import sensors
from sean_jax.core import random_streams
from sean_jax.core.data_types import as_policy
from sean_jax.policies import POLICIES
from sean_jax.simulation import episode_runner, episodes
from sean_jax.simulation.episodes import init_policy, policy_step
from sean_jax.simulation.scenario_stack import Stack
from support.draws import noisy, still
from support.quick import quick

TICKS = 4


@pytest.fixture(scope="module")
def written():
    """A PRNG that is JAX's own, and writes down each key that is drawn from or split, and each that is derived."""
    used, derived, own = [], [], extend_random.threefry_prng_impl

    def told(key, found):
        used.append(tuple(key.tolist()))
        derived.extend(map(tuple, found.tolist()))

    def split(key, shape):
        found = own.split(key, shape)
        jax.debug.callback(told, key, found.reshape(-1, 2))
        return found

    def fold_in(key, data):
        found = own.fold_in(key, data)
        jax.debug.callback(lambda found: derived.append(tuple(found.tolist())), found)
        return found

    def random_bits(key, width, shape):
        jax.debug.callback(lambda key: used.append(tuple(key.tolist())), key)
        return own.random_bits(key, width, shape)

    parts = {"key_shape": own.key_shape, "seed": own.seed, "split": split, "fold_in": fold_in}
    return extend_random.define_prng_impl(**parts, random_bits=random_bits, name="written"), used, derived


def lives(scenario, policy, starts, key):
    """Some ticks of an episode that restarts midway, with noise on a scan."""

    def one(state, _):
        noise = sensors.noise(jax.random.fold_in(state.streams.sensors, state.tick), jnp.ones(3), far=2.0)
        state, _ = policy_step(scenario, policy, state)
        return episodes.autoreset(starts, state), noise

    return jax.lax.scan(one, init_policy(scenario, policy, sean_jax.reset(scenario, key)), length=TICKS)


def test_no_key_is_used_twice_or_derived_twice(scenario, written):
    """Over people's, policies', sensors' and restarts' streams, resets and the pool of starts."""
    impl, used, derived = written
    quiet = still(scenario)
    key = jax.random.key(3, impl=impl)
    pool_key, *keys = jax.random.split(key, 4)

    @jax.jit
    def run(keys, pool_key):
        starts = episodes.reset_pool(quiet, pool_key, 2)
        return jax.vmap(lambda key: lives(quiet, noisy, starts, key)[0].tick)(keys)

    jax.block_until_ready(run(jnp.stack(keys), pool_key))
    jax.effects_barrier()
    assert len(used) > 3 * TICKS * 3 and len(derived) > len(used)
    for each in (used, derived):
        assert len(set(each)) == len(each)


def test_the_writer_sees_keys_that_are_used_twice(written):
    impl, used, derived = written
    before = len(used), len(derived)
    key = jax.random.key(9, impl=impl)
    for same in (jax.random.fold_in(key, 1), jax.random.split(key, 2)[1]):
        jax.random.normal(same)
    jax.effects_barrier()
    assert len(set(used[before[0] :])) < len(used) - before[0]
    assert len(set(derived[before[1] :])) < len(derived) - before[1]


def checked(scenario, policy):
    """A tick of an episode and the one that follows it, traced and not run, by JAX's own checker."""

    def tick(starts, key):
        state = init_policy(scenario, policy, sean_jax.reset(scenario, key))
        noise = sensors.noise(jax.random.fold_in(state.streams.sensors, state.tick), jnp.ones(3), far=2.0)
        return episodes.autoreset(starts, policy_step(scenario, policy, state)[0]), noise

    with jax.debug_key_reuse(True):
        starts = jax.eval_shape(lambda key: episodes.reset_pool(scenario, key, 2, policy), jax.random.key(0))
        jax.jit(tick).trace(starts, jax.random.key(1))


@pytest.fixture(scope="module")
def state(scenario):
    """Of an episode, its shapes alone."""
    return jax.eval_shape(sean_jax.reset, scenario, jax.random.key(0))


def check_policy(scenario, policy, state):
    """A command is traced and not run, by JAX's own checker; the rest of a tick draws from other streams."""

    def command(state):
        state = init_policy(scenario, policy, state)
        key = jax.random.fold_in(state.streams.policy, state.tick)
        return episodes.command(scenario, policy, state, key), jax.random.bits(state.streams.people)

    with jax.debug_key_reuse(True):
        jax.jit(command).trace(state)


@pytest.mark.parametrize("name", quick(POLICIES, "mppi"))
def test_policies_use_no_key_twice(scenario, state, name):
    check_policy(scenario, as_policy(POLICIES[name]), state)


@pytest.mark.night
@pytest.mark.parametrize("name", ["mppi", "expert", "sensing_expert"])
def test_the_checker_sees_policies_that_use_a_key_twice(scenario, state, name):
    """These draw, so the checker has something to see: commands of one key, asked for twice."""
    policy = as_policy(POLICIES[name])

    def twice(scenario, params, state, key):
        memory = policy.apply(scenario, params, state, key)[1]
        return policy.apply(scenario, params, dataclasses.replace(state, policy_state=memory), key)

    with pytest.raises(jax.errors.KeyReuseError):
        check_policy(scenario, dataclasses.replace(policy, apply=twice), state)


@pytest.mark.parametrize(
    ("behavior", "task"),
    [
        ("graph", "leave_group"),
        pytest.param("graph", "busy_ab_nav", marks=pytest.mark.slow),
        pytest.param("random", "random_ab_nav", marks=pytest.mark.slow),
        pytest.param("handcrafted", "handcrafted", marks=pytest.mark.slow),
        pytest.param("playback", "random_ab_nav", marks=pytest.mark.slow),
    ],
)
def test_behaviors_and_tasks_use_no_key_twice(behavior, task, tmp_path):
    file = tmp_path / "walk.csv"
    file.write_text("\n".join(["frame,id,x,y", *(f"{frame},1,{0.02 * frame},0.5" for frame in range(100))]))
    given = {"recording": file, "frame_rate": 25.0} if behavior == "playback" else {}
    checked(sean_jax.make("lab", behavior=behavior, task=task, dynamics="twin", **given), noisy)


def test_the_checker_sees_keys_that_are_used_twice(scenario):
    def twice(scenario, state, key):
        return noisy(scenario, state, key) + noisy(scenario, state, key)

    with pytest.raises(jax.errors.KeyReuseError):
        checked(still(scenario), twice)


def test_uses_of_one_seed_share_no_episode():
    """Nor with the keys of a split of ``key(seed)``, which is what a user takes."""
    seeds, episodes = range(3), range(200)
    keys = [
        jax.vmap(lambda i, key=key: jax.random.fold_in(key, i))(jnp.asarray(episodes))
        for key in (random_streams.key(use, seed) for use, seed in itertools.product(random_streams.USES, seeds))
    ]
    keys += [jax.random.split(jax.random.key(seed), len(episodes)) for seed in seeds]
    found = np.concatenate([jax.random.key_data(each) for each in keys])
    assert len(np.unique(found, axis=0)) == len(found) == (len(random_streams.USES) + 1) * 600
    numbers = [random_streams.stream_id(use) for use in random_streams.USES]
    assert len(set(numbers)) == len(numbers) and min(numbers) > 10**6
    first = {
        random_streams.generator(use, 0, *more).integers(2**60)
        for use in random_streams.USES
        for more in ((), (0,), (1,))
    }
    assert len(first) == 3 * len(random_streams.USES)
    with pytest.raises(ValueError, match="'walk' is not one of run, collect"):
        random_streams.key("walk", 0)


def test_commands_draw_other_episodes(scenario):
    """What `sean run`, `collect` and `experiment figure4` reset with, taken from the one runner."""
    quiet, numbers = still(scenario), jnp.arange(8, dtype=jnp.uint32)
    index = jnp.zeros(8, jnp.int32)

    @jax.jit  # of which nothing but the keys is compiled
    def drawn(numbers):
        def people(use):
            return episode_runner._draw(
                (quiet.task,), use, (Stack(quiet, {}), {}), jnp.uint32(0), numbers, index
            ).streams.people

        return [people(use) for use in ("run", "collect", "figure4")]

    keys = [np.asarray(jax.random.key_data(each)) for each in drawn(numbers)]
    assert len(np.unique(np.concatenate(keys), axis=0)) == 24


@pytest.mark.slow
def test_keys_of_both_kinds_can_be_mixed(scenario):
    """``jax.random.PRNGKey`` gives numbers, and the same episodes."""
    env = sean_jax.make_env(still(scenario))
    step = jax.eval_shape(env.reset, jax.random.PRNGKey(0))[1]
    for old, new in ((jax.random.PRNGKey(0), jax.random.key(0)), (jax.random.key(0), jax.random.PRNGKey(0))):
        state = jax.eval_shape(env.reset, old)[1]
        after = jax.eval_shape(env.step, new, state, jax.numpy.zeros(2))[1]
        assert jax.tree.map(lambda leaf: leaf.dtype, after) == jax.tree.map(lambda leaf: leaf.dtype, step)
    assert (
        jax.random.key_data(random_streams.typed(jax.random.PRNGKey(7))) == jax.random.key_data(jax.random.key(7))
    ).all()

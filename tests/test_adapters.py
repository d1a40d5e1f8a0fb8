"""Adapters: each passes its own project's checker, and rows are what single environments are."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import mdp, registry

pytestmark = pytest.mark.slow
NAME = "Lab-Random-RandomAbNav-v0"
SMALL = {"people": 3, "time_limit": 1.5, "observations": ["goal", "speeds", "people"]}


@pytest.fixture(scope="module")
def env() -> mdp.Env:
    return registry.load(NAME, config_overrides=SMALL)


@pytest.fixture
def gymnasium():
    return pytest.importorskip("gymnasium")


def test_gymnasium_checker_has_nothing_to_say(gymnasium):
    from gymnasium.utils.env_checker import check_env

    import sean_jax.adapters.gymnasium  # noqa: F401

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(f"sean/{NAME}", render_mode="rgb_array", **SMALL).unwrapped)


def test_gymnasium_finds_it_by_name(gymnasium):
    import sean_jax.adapters.gymnasium  # noqa: F401

    made = gymnasium.make(f"sean/{NAME}", **SMALL)
    observation, _ = made.reset(seed=3)
    assert made.observation_space.contains(observation)
    with pytest.raises(gymnasium.error.NameNotFound):
        gymnasium.make("sean/Nowhere-v0")


def test_rows_are_single_environments(gymnasium, env):
    """Row k with seed s is the single environment with seed s + k, over the ends of episodes."""
    from sean_jax.adapters.gymnasium import SocialNavigation, VectorSocialNavigation

    rows, seed, steps = 2, 7, 40  # two and a half episodes of 15 steps
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, rows, 2)).astype(np.float32)
    vector = VectorSocialNavigation(env, rows)
    observation, _ = vector.reset(seed=seed)
    singles = [SocialNavigation(env) for _ in range(rows)]
    first = [single.reset(seed=seed + row)[0] for row, single in enumerate(singles)]
    _same(observation, first)
    ends = 0
    for action in actions:
        observation, reward, terminated, truncated, info = vector.step(action)
        for row, single in enumerate(singles):
            seen, gain, term, trunc, _ = single.step(action[row])
            assert (term, trunc) == (terminated[row], truncated[row])
            np.testing.assert_allclose(gain, reward[row], atol=2e-5)
            if term or trunc:
                ends += 1
                _close({name: part[row] for name, part in info["final_obs"].items()}, seen)
                seen, _ = single.reset()
            _close({name: part[row] for name, part in observation.items()}, seen)
    assert ends == rows * (steps // 15)


def _same(batch: dict, rows: list[dict]) -> None:
    for row, one in enumerate(rows):
        _close({name: part[row] for name, part in batch.items()}, one)


def _close(one: dict, other: dict) -> None:
    for name in one:
        np.testing.assert_allclose(one[name], other[name], atol=2e-4, err_msg=name)


def test_gymnax(env):
    pytest.importorskip("gymnax")
    from sean_jax.adapters.gymnax import SocialNavigation

    adapted = SocialNavigation(env)
    params = adapted.default_params
    assert params.max_steps_in_episode == 15
    observation, state = jax.jit(adapted.reset_env)(jax.random.key(0), params)
    for name, box in adapted.observation_space(params).spaces.items():  # its Dict knows no dicts of its own
        assert box.contains(observation[name]) and box.shape == observation[name].shape
    step = jax.jit(adapted.step)
    for tick in range(16):
        observation, state, reward, terminated, truncated, info = step(jax.random.key(tick), state, jnp.ones(2), params)
        assert bool(truncated) == (tick == 14)
    assert int(state.episode_length) == 1 and {"final_observation", "terminated", "truncated"} <= info.keys()


@pytest.mark.parametrize("through", [False, True])
def test_gymnax_gradients_end_with_the_step_unless_asked_for(env, through):
    pytest.importorskip("gymnax")
    from sean_jax.adapters.gymnax import SocialNavigation

    adapted = SocialNavigation(env)
    adapted = adapted.with_transition_gradients() if through else adapted
    params = adapted.default_params
    _, state = jax.jit(adapted.reset_env)(jax.random.key(0), params)

    def second_reward(action):
        _, after, first, *_ = adapted.step(jax.random.key(1), state, action, params)
        return adapted.step(jax.random.key(2), after, jnp.zeros(2), params)[2]

    slope = jax.jit(jax.grad(second_reward))(jnp.array([0.3, 0.2]))
    assert bool((slope != 0.0).any()) == through


def test_brax(env):
    pytest.importorskip("brax")
    from sean_jax.adapters.brax import SocialNavigation

    adapted = SocialNavigation(env)
    state = jax.jit(adapted.reset)(jax.random.PRNGKey(0))
    assert state.obs.shape == (adapted.observation_size,)
    step = jax.jit(adapted.step)
    state = state.replace(info=state.info | {"of a wrapper": jnp.zeros(())})
    for tick in range(15):
        after = step(state, jnp.ones(2))
        assert jax.tree.structure(after) == jax.tree.structure(state)
        state = after
        assert bool(state.done) == (tick == 14) == bool(state.info["truncation"])


def test_stable_baselines_checker_finds_nothing_wrong():
    """It advises to flatten what has two axes, which its own policy of dicts does."""
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    from sean_jax.adapters.gymnasium import SocialNavigation

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "Your observation people has an unconventional shape")
        checker.check_env(SocialNavigation(NAME, **SMALL))


def test_rows_of_stable_baselines_are_those_of_gymnasium(env):
    """Over the ends of episodes, of which a time limit is told apart from a completed task."""
    pytest.importorskip("stable_baselines3")
    from sean_jax.adapters.gymnasium import VectorSocialNavigation
    from sean_jax.adapters.stable_baselines3 import VecSocialNavigation

    rows, vector = VecSocialNavigation(env, 2), VectorSocialNavigation(env, 2)
    rows.seed(7)
    seen, wanted = rows.reset(), vector.reset(seed=7)[0]
    ends = 0
    for action in np.random.default_rng(0).uniform(-1, 1, (40, 2, 2)).astype(np.float32):
        for name, part in wanted.items():
            np.testing.assert_array_equal(seen[name], part)
        seen, reward, over, infos = rows.step(action)
        wanted, expected, terminated, truncated, told = vector.step(action)
        np.testing.assert_array_equal(reward, expected)
        np.testing.assert_array_equal(over, terminated | truncated)
        for row, info in enumerate(infos):
            assert bool(info) == over[row]
            if info:
                ends += 1
                assert info["TimeLimit.truncated"] == truncated[row] and info["is_success"] == told["completed"][row]
                for name, part in told["final_obs"].items():
                    np.testing.assert_array_equal(info["terminal_observation"][name], part[row])
    assert ends >= 4
    assert rows.get_attr("num_envs", [0]) == [2] and rows.env_is_wrapped(object) == [False, False]

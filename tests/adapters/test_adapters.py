"""Adapters: each passes its own project's checker, and rows are what single environments are."""

import functools
import importlib
import json
import re
import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import mdp, registry
from sean_jax.core.errors import InputError
from support.checkout import ROOT

pytestmark = pytest.mark.slow
NAME = "Lab-Random-RandomAbNav-v0"
SMALL = {"people": 3, "time_limit": 1.5, "observations": ["goal", "speeds", "people"]}


@pytest.fixture(scope="module")
def env() -> mdp.Env:
    return registry.load(NAME, config_overrides=SMALL)


@pytest.fixture
def gymnasium():
    return pytest.importorskip("gymnasium")


@pytest.mark.night
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


@pytest.mark.night
@pytest.mark.parametrize("mode", ["SAME_STEP", "NEXT_STEP"])
def test_rows_are_what_gymnasium_makes_of_single_environments(gymnasium, env, mode):
    """Over the ends of episodes. Row k with seed s is the single environment with seed s + k."""
    from sean_jax.adapters.gymnasium import SocialNavigation, VectorSocialNavigation

    rows, seed, steps = 2, 7, 40  # two and a half episodes of 15 steps
    singles = [lambda: SocialNavigation(env)] * rows
    wanted = gymnasium.vector.SyncVectorEnv(singles, autoreset_mode=gymnasium.vector.AutoresetMode[mode])
    vector = VectorSocialNavigation(env, rows, autoreset_mode=mode)
    assert vector.metadata["autoreset_mode"] == wanted.metadata["autoreset_mode"]
    _close(vector.reset(seed=seed)[0], wanted.reset(seed=seed)[0])
    ends = 0
    for action in np.random.default_rng(0).uniform(-1, 1, (steps, rows, 2)).astype(np.float32):
        observation, *numbers, info = vector.step(action)
        expected, *others, told = wanted.step(action)
        _close(observation, expected)
        for value, other in zip(numbers, others, strict=True):  # reward, terminated, truncated
            np.testing.assert_allclose(value, other, atol=2e-5)
        over = numbers[1] | numbers[2]
        ends += over.sum()
        assert ("final_obs" in info) == ("final_obs" in told) and ("_metrics" in info) == ("_metrics" in told)
        metrics, theirs = info.get("metrics"), told.get("metrics")
        if "final_obs" in told:
            metrics, theirs = info["final_info"]["metrics"], told["final_info"]["metrics"]
            for row in np.flatnonzero(over):
                _close({name: part[row] for name, part in info["final_obs"].items()}, told["final_obs"][row])
        if over.any():
            for name in metrics:
                np.testing.assert_allclose(metrics[name][over], theirs[name][over], atol=1e-3, err_msg=name)
    assert ends == rows * 2
    with pytest.raises(InputError, match="3 seeds for 2 environments"):
        vector.reset(seed=[1, 2, 3])
    with pytest.raises(InputError, match="autoreset_mode: 'DISABLED' is not SAME_STEP or NEXT_STEP"):
        VectorSocialNavigation(env, rows, autoreset_mode="DISABLED")


def test_wrappers_of_gymnasium_take_the_vector_environment(gymnasium):
    """Those of observations accept NEXT_STEP alone."""
    import sean_jax.adapters.gymnasium  # noqa: F401

    made = gymnasium.make_vec(f"sean/{NAME}", num_envs=2, autoreset_mode="NextStep", **SMALL)
    flat = gymnasium.wrappers.vector.FlattenObservation(gymnasium.wrappers.vector.RecordEpisodeStatistics(made))
    normal = gymnasium.wrappers.vector.NormalizeObservation(flat)
    observation, _ = normal.reset(seed=0)
    assert observation.shape == flat.observation_space.shape
    for _ in range(16):
        observation, _, _, truncated, info = normal.step(np.ones((2, 2), np.float32))
        assert np.isfinite(observation).all()
        if truncated.any():
            assert info["episode"]["l"].tolist() == [15, 15]
    assert not truncated.any()


@pytest.mark.night
def test_equal_instances_share_compiled_programs(gymnasium):
    """Of the same name and options; those of other options have their own."""
    from sean_jax.adapters.gymnasium import SocialNavigation, VectorSocialNavigation

    compiled = []

    def count(name, seconds, **others):
        compiled.extend([name] * name.endswith("backend_compile_duration"))

    def compiles(**others) -> int:
        before = len(compiled)
        for made, action in (
            (SocialNavigation(NAME, **SMALL | others), np.zeros(2)),
            (VectorSocialNavigation(NAME, 2, **SMALL), np.zeros((2, 2))),
        ):
            made.reset(seed=0)
            made.step(action)
        return len(compiled) - before

    jax.monitoring.register_event_duration_secs_listener(count)
    try:
        compiles()
        assert compiles() == 0 and compiles(observations=["goal"]) > 0
    finally:
        jax.monitoring.unregister_event_duration_listener(count)


def _close(one: dict, other: dict) -> None:
    assert one.keys() == other.keys()
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


def test_gymnax_flattens_observations(env):
    """As its own wrappers need them; and equal instances are one to jax, which compiles for each instance."""
    gymnax = pytest.importorskip("gymnax")
    from gymnax.wrappers.purerl import FlattenObservationWrapper, LogWrapper

    import sean_jax.adapters.gymnax

    (adapted, params), (again, _) = (gymnax.make(f"sean/{NAME}", flat=True, **SMALL) for _ in range(2))
    assert adapted == again and hash(adapted) == hash(again)
    others = [sean_jax.adapters.gymnax.SocialNavigation(NAME, **SMALL), adapted.with_transition_gradients()]
    others.append(sean_jax.adapters.gymnax.SocialNavigation(NAME, flat=True, **{**SMALL, "people": 2}))
    assert len({adapted, again, *others}) == 4
    wrapped = LogWrapper(FlattenObservationWrapper(adapted))
    space = wrapped.observation_space(params)
    observation, state = wrapped.reset(jax.random.key(0), params)
    plain = jax.jit(env.reset)(jax.random.key(0))[0]
    np.testing.assert_array_equal(observation, np.concatenate([np.ravel(plain[name]) for name, _ in env.observations]))
    for tick in range(15):
        assert observation.shape == space.shape and bool(space.contains(observation))
        with jax.numpy_dtype_promotion("standard"):  # its own arithmetic is not strict
            observation, state, *_, info = wrapped.step(jax.random.key(tick), state, jnp.ones(2), params)
    assert int(info["returned_episode_lengths"]) == 15 and info["final_observation"].shape == space.shape


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
    assert adapted.backend == "twin" and SocialNavigation(NAME, **SMALL, dynamics="mjx").backend == "mjx"
    state = jax.jit(adapted.reset)(jax.random.PRNGKey(0))
    assert state.obs.shape == (adapted.observation_size,)
    step = jax.jit(adapted.step)
    state = state.replace(info=state.info | {"of a wrapper": jnp.zeros(())})
    for tick in range(16):
        after = step(state, jnp.ones(2))
        assert jax.tree.structure(after) == jax.tree.structure(state)
        state = after
        assert bool(state.info["truncation"]) == (tick >= 14) and bool(state.done) == (tick == 15)


def test_trainers_of_brax_bootstrap_at_the_time_limit(env):
    """``EpisodeWrapper`` takes no episode for truncated that has ``done`` already."""
    training = pytest.importorskip("brax.envs.wrappers.training")
    from sean_jax.adapters.brax import SocialNavigation

    adapted = SocialNavigation(env)
    assert adapted.episode_length == 15
    wrapped = training.AutoResetWrapper(training.EpisodeWrapper(adapted, adapted.episode_length, 1))
    with jax.numpy_dtype_promotion("standard"):  # its own arithmetic is not strict
        first = state = jax.jit(wrapped.reset)(jax.random.PRNGKey(0))
        step = jax.jit(wrapped.step)
        for tick in range(16):
            state = step(state, jnp.ones(2))
            assert bool(state.done) == (tick == 14) == bool(state.info["truncation"])
            assert bool((state.obs == first.obs).all()) == (tick == 14)


def test_playground(env):
    """By its own registry, whose config is JSON; its wrapper ends episodes at their time limit, and starts others."""
    theirs = pytest.importorskip("mujoco_playground")
    from sean_jax.adapters import playground

    config = theirs.registry.get_default_config(f"sean/{NAME}")
    assert json.loads(json.dumps(config.to_dict()))["episode_length"] == 1200
    config.people = 2
    assert playground.load(NAME, config).mjx_model.people == 2
    made = theirs.registry.load(f"sean/{NAME}", config, SMALL | {"impl": "jax"})
    assert made.mjx_model.people == 3 and made.dt == 0.1 and made.n_substeps == 5
    assert made.xml_path.endswith("kuri.xml") and made.mj_model.nu == made.action_size == 2
    wrapped = theirs.wrapper.wrap_for_brax_training(made, episode_length=15)
    with jax.numpy_dtype_promotion("standard"):  # its own arithmetic is not strict
        first = state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 2))
        step = jax.jit(wrapped.step)
        for _ in range(15):
            assert not state.done.any()
            state = step(state, jnp.ones((2, 2)))
    assert state.obs.shape == (2, made.observation_size) and bool((state.obs == first.obs).all())
    assert state.done.all() and state.info["truncation"].all()
    (picture,) = made.render([jax.tree.map(lambda leaf: leaf[0], state)])
    assert picture.dtype == np.uint8 and picture.shape[-1] == 3 and picture.std() > 0


def test_rows_of_playground_have_people_of_their_own():
    """Each is the environment of its scenario; what does not differ is there once."""
    theirs = pytest.importorskip("mujoco_playground")
    from sean_jax.adapters import playground

    made = playground.load(NAME, config_overrides=SMALL)
    randomize = functools.partial(playground.get_domain_randomizer(NAME), rng=jax.random.split(jax.random.key(1), 3))
    model, axes = randomize(made.mjx_model)
    assert len(np.unique(model.forces.walking.speed_mean)) == 3 and not jax.tree.leaves(axes.environment)
    wrapped = theirs.wrapper.BraxDomainRandomizationVmapWrapper(made, randomize)
    keys = jax.random.split(jax.random.key(0), 3)
    state = wrapped.step(wrapped.reset(keys), jnp.ones((3, 2)))
    assert made.mjx_model is made.env.scenario
    for row, key in enumerate(keys):
        pick = functools.partial(jax.tree.map, is_leaf=lambda leaf: leaf is None)
        scenario = pick(lambda axis, leaf, row=row: leaf if axis is None else leaf[row], axes, model)
        alone = replace(made.env, scenario=scenario)
        _, observation, *_ = alone.advance(alone.reset(key)[1], jnp.ones(2))
        wanted = np.concatenate([np.ravel(observation[name]) for name, _ in alone.observations])
        np.testing.assert_allclose(state.obs[row], wanted, atol=1e-4)


def test_rows_of_rsl_rl_are_those_of_gymnasium(env):
    """Over the ends of episodes; and tensors are arrays of jax."""
    torch = pytest.importorskip("torch")
    pytest.importorskip("tensordict")
    from sean_jax.adapters.gymnasium import VectorSocialNavigation
    from sean_jax.adapters.rsl_rl import VecSocialNavigation

    rows, vector = VecSocialNavigation(env, 2, seed=7), VectorSocialNavigation(env, 2)
    assert (rows.num_envs, rows.num_actions, rows.max_episode_length) == (2, 2, 15)
    wanted, ends = vector.reset(seed=7)[0], 0
    for action in np.random.default_rng(0).uniform(-1, 1, (40, 2, 2)).astype(np.float32):
        flat = np.concatenate([wanted[name].reshape(2, -1) for name, _ in env.observations], axis=1)
        np.testing.assert_allclose(rows.get_observations()["policy"], flat, atol=2e-4)
        _, reward, done, extras = rows.step(torch.from_numpy(action))
        wanted, expected, terminated, truncated, told = vector.step(action)
        np.testing.assert_allclose(reward, expected, atol=2e-5)
        np.testing.assert_array_equal(done, terminated | truncated)
        np.testing.assert_array_equal(extras["time_outs"], truncated)
        assert len(extras["log"]["/completed"]) == done.sum()
        ends += int(done.sum())
    assert ends >= 4
    assert rows.episode_length_buf.data_ptr() == rows._states.simulation.tick.unsafe_buffer_pointer()
    rows.episode_length_buf = torch.tensor([14, 0])
    assert rows.step(torch.zeros(2, 2))[3]["time_outs"].tolist() == [True, False]


def test_brax_is_imported_with_a_warning_where_its_trainers_cannot_run(monkeypatch):
    """Their own error does not say what to do; the cure of docs/training.md ends the warning."""
    pmap = pytest.importorskip("brax.training.pmap")
    import sean_jax.adapters.brax

    if not hasattr(jax, "device_put_replicated"):
        with pytest.raises(AttributeError, match="device_put_replicated"):
            pmap.bcast_local_devices(jnp.zeros(2))
        with pytest.warns(UserWarning, match="docs/training.md"):
            importlib.reload(sean_jax.adapters.brax)
    text = (ROOT / "docs/training.md").read_text(encoding="utf-8")
    (cure,) = re.findall(r"^    (jax\.device_put_replicated = .*)$", text, re.M)
    monkeypatch.setattr(jax, "device_put_replicated", None, raising=False)
    exec(cure, {"jax": jax})  # noqa: S102
    np.testing.assert_array_equal(pmap.bcast_local_devices(jnp.arange(2.0)), [[0.0, 1.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        importlib.reload(sean_jax.adapters.brax)


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

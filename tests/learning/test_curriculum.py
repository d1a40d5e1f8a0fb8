"""A curriculum: weights of starts, situations that follow the worst, regret, randomized people, and resuming."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chisquare

import sean_jax
from sean_jax.core import random_streams
from sean_jax.core.data_types import as_policy
from sean_jax.core.errors import InputError
from sean_jax.learning import curriculum as curricula
from sean_jax.learning.curriculum import CurriculumPlan, StepRecord
from sean_jax.mdp import Env, make_env
from sean_jax.mdp.env import _choose
from sean_jax.policies import POLICIES
from support import trees

SIZE = 16
DRIVER = as_policy(POLICIES["go_to_goal"])
SITUATIONS = CurriculumPlan(ahead=2.0, memory=0.5)
REGRET = CurriculumPlan("regret", memory=1.0, mutated=1.0)

begin = jax.jit(curricula.init, static_argnums=(1, 3))
observe = jax.jit(curricula.observe, static_argnums=1)
refill = jax.jit(curricula.refill, static_argnums=1)
step = jax.jit(Env.step)


@pytest.fixture(scope="module")
def env():
    scenario = sean_jax.make("lab", routing="whole", people=5, dynamics="twin", time_limit=3.0, metrics=[])
    randomization = {"people": (0.2, 1.0), "speed": (0.5, 2.0), "waypoints": (0.5, 2.0)}
    return make_env(scenario, ["goal"], {"progress": 1.0, "personal_space": -1.0}, randomization=randomization)


@pytest.fixture(scope="module")
def by_situations(env):
    return begin(env, SITUATIONS, jax.random.key(0), SIZE, DRIVER)


@pytest.fixture(scope="module")
def by_regret(env):
    return begin(env, REGRET, jax.random.key(0), SIZE, None)


def record(start, returns=None, situations=None, cost=0.0, over=True, steps=1) -> StepRecord:
    """Equal steps of as many scenarios as there are starts."""
    start = jnp.tile(jnp.asarray(start, jnp.int32), (steps, 1))
    shape = start.shape
    found = jnp.zeros((*shape, 5), bool) if situations is None else jnp.tile(jnp.asarray(situations), (steps, 1, 1))
    returns = jnp.zeros(shape) if returns is None else jnp.asarray(returns, float)[None]
    cost = jnp.broadcast_to(jnp.asarray(cost, float), shape)
    return StepRecord(start, found, cost, jnp.full(shape, over), returns)


# ------------------------------------------------------------------ a pool with weights


def test_starts_are_taken_by_their_weights():
    weights = np.array([0.0, 1.0, 2.0, 0.0, 5.0, 1e-12, 0.25, 0.0])
    keys = jax.random.split(jax.random.key(0), 20_000)
    drawn = np.bincount(jax.jit(jax.vmap(_choose, (0, None)))(keys, jnp.asarray(weights)), minlength=8)
    assert len(drawn) == 8 and (drawn[[0, 3, 5, 7]] == 0).all()
    expected = weights[[1, 2, 4, 6]] / weights[[1, 2, 4, 6]].sum() * 20_000
    assert chisquare(drawn[[1, 2, 4, 6]], expected).pvalue > 1e-3


def test_a_start_of_no_weight_is_never_taken():
    """Every other one of four thousand, whose weights do not add up exactly."""
    weights = jnp.where(jnp.arange(4000) % 2 == 1, jax.random.uniform(jax.random.key(1), (4000,)), 0.0)
    found = jax.jit(jax.vmap(_choose, (0, None)))(jax.random.split(jax.random.key(2), 50_000), weights)
    assert (np.asarray(weights)[np.asarray(found)] > 0).all() and len(np.unique(found)) > 1900


@pytest.fixture(scope="module")
def pooled(env, by_regret):
    """The environment whose episodes all begin with start 2."""
    return replace(env, pool=replace(by_regret.pool, weights=jnp.zeros(SIZE).at[2].set(1.0)))


@pytest.mark.night
def test_episodes_know_their_start(env, pooled):
    state = jax.tree.map(lambda leaf: leaf[7], pooled.pool.states)
    told = []
    for tick in range(31):
        _, state, _, _, over, info = step(pooled, jax.random.key(tick), state, jnp.zeros(2))
        told.append(int(info["start"]))
    assert told == [7] * 30 + [2] and int(state.start) == 2
    for name, value in state.randomization.items():
        np.testing.assert_array_equal(value, pooled.pool.states.randomization[name][2])


# ------------------------------------------------------------------ people who behave otherwise


def test_randomized_people(env, pooled):
    """As many are there as is said, they are as fast as is said, and reset and step are as of any episode."""
    states = pooled.pool.states
    drawn, people = states.randomization, states.simulation.pedestrians
    share = np.asarray(drawn["people"])
    assert share.min() >= 0.2 and share.max() <= 1.0 and share.std() > 0.1
    there = np.asarray(people.present).sum(1)
    np.testing.assert_array_equal(there, np.ceil(share * 5 - 1e-4))
    assert set(there) >= {2, 3, 4, 5}
    assert (np.sort(np.asarray(people.present), 1)[:, ::-1] == np.asarray(people.present)).all()
    absent = ~np.asarray(people.present)
    assert (np.asarray(people.group)[absent] == -1).all() and (
        np.asarray(states.simulation.memory.seat)[absent] == -1
    ).all()
    factor, speed = np.asarray(drawn["speed"]), np.asarray(people.preferred_speed).mean(1)
    walking = env.scenario.forces.walking
    assert np.corrcoef(factor, speed)[0, 1] > 0.9
    assert (np.asarray(people.preferred_speed) <= factor[:, None] * float(walking.speed_max) + 1e-5).all()
    assert drawn["waypoints"].shape == (SIZE, env.scenario.behavior.data.graph.waypoints.shape[0])
    for row in range(0, SIZE, 2):
        state = jax.tree.map(lambda leaf, row=row: leaf[row], states)
        for tick in range(20):
            state = step(pooled, jax.random.key(tick), state, jnp.array([0.5, 0.1]))[1]
        assert int(state.start) == row  # the same episode still
        leaves = jax.tree.leaves((state.simulation.pedestrians, state.simulation.robot))
        assert all(np.isfinite(np.asarray(leaf, float)).all() for leaf in leaves)
        assert (np.asarray(state.simulation.pedestrians.group)[absent[row]] == -1).all()
        assert (np.asarray(state.simulation.memory.seat)[absent[row]] == -1).all()


# ------------------------------------------------------------------ by situation


@pytest.mark.night
def test_situations_that_occur_are_those_of_a_rollout(env, by_situations):
    """Against ``simulate`` from one of the starts, step by step."""
    for row in (0, 5):
        start = jax.tree.map(lambda leaf, row=row: leaf[row], by_situations.pool.states)
        scenario = env.scenario_of(start.randomization)
        state = sean_jax.simulation.episodes.init_policy(scenario, DRIVER, start.simulation)
        _, seen = jax.jit(sean_jax.simulate, static_argnums=3)(scenario, DRIVER, state, 20)
        wanted = (np.asarray(seen.situations) & np.asarray(seen.active)[:, None]).sum(0) * 0.1
        np.testing.assert_allclose(by_situations.occurs[row], wanted, atol=1e-4)
        assert float(by_situations.seconds[row]) == pytest.approx(np.asarray(seen.active).sum() * 0.1, abs=1e-4)


def test_weights_follow_the_worst_situation(env, by_situations):
    """Starts of the situation that costs most are drawn more; when another is the worst, those of that one."""
    names = [name for name, _ in env.scenario.situations]
    state = by_situations
    starts = np.asarray(state.pool.states.start)
    shares = np.asarray(curricula.occurrences(state))
    common = np.argsort(shares.max(0))[::-1][:2]  # situations that occur from some start, and not from all
    for worst in common:
        found = np.ones((SIZE, 5), bool)
        found[: SIZE // 2], found[:, worst], found[: SIZE // 2, worst] = False, False, True
        cost = np.where(found[:, worst], 3.0, 0.01)
        nowhere = np.full(SIZE, -1)
        for _ in range(8):
            seen = record(nowhere, situations=found, cost=cost, over=False, steps=50)
            state = observe(env, SITUATIONS, state, seen)
        weights = np.asarray(curricula.situation_weights(env, SITUATIONS, state))
        assert weights.argmax() == worst and weights[worst] > 0.7, names[worst]
        assert weights.sum() == pytest.approx(1.0, abs=1e-5)
        taken = np.asarray(state.pool.weights)
        assert taken.sum() == pytest.approx(1.0, abs=1e-5) and taken.min() >= 0.2 / SIZE - 1e-6
        assert taken @ shares[:, worst] > shares[:, worst].mean() + 0.3 * shares[:, worst].std()
    np.testing.assert_array_equal(starts, state.pool.states.start)


@pytest.mark.night
def test_chosen_situations_occur(env, by_situations):
    """Starts are drawn as often as they lead there, and new ones that lead there more come in."""
    column = int(np.asarray(curricula.occurrences(by_situations)).std(0).argmax())
    name = env.scenario.situations[column][0]
    plan = CurriculumPlan(situations=((name, 1.0),), floor=0.0, ahead=2.0, memory=1.0)
    state = observe(env, plan, by_situations, record(np.full(SIZE, -1), over=False))
    shares = np.asarray(curricula.occurrences(state))[:, column]
    np.testing.assert_allclose(state.pool.weights, shares / shares.sum(), atol=1e-5)
    richer = refill(env, plan, state, jax.random.key(9), DRIVER)
    after = np.asarray(curricula.occurrences(richer))[:, column]
    gone = np.asarray(state.pool.states.start) != np.asarray(richer.pool.states.start)
    assert 0 < gone.sum() <= 4 and after[gone].min() > shares[gone].max() - 0.1 and after.mean() > shares.mean()
    with pytest.raises(InputError, match="situation 'join_grup' is not one of .*join_group"):
        curricula.init(env, CurriculumPlan(situations=(("join_grup", 1.0),)), jax.random.key(0), 2)


# ------------------------------------------------------------------ by regret


def _regretted(env, state, gaps):
    """After four episodes from each start, three of which returned nothing and one its gap."""
    starts = np.asarray(state.pool.states.start)
    for returns in (np.zeros(SIZE), np.zeros(SIZE), gaps, np.zeros(SIZE)):
        state = observe(env, REGRET, state, record(starts, returns))
    return state


def test_regret_is_the_best_return_less_the_mean(env, by_regret):
    gaps = np.random.default_rng(0).permutation(SIZE) * 2.0
    np.testing.assert_array_equal(by_regret.pool.weights, np.full(SIZE, np.float32(1 / SIZE)))
    state = _regretted(env, by_regret, gaps)
    np.testing.assert_allclose(curricula.regret(state), gaps * 0.75, atol=1e-3)
    order = np.argsort(np.asarray(state.pool.weights))
    np.testing.assert_array_equal(order, np.argsort(gaps))
    ranks = 0.8 / (np.arange(SIZE, 0, -1) * (1 / np.arange(1, SIZE + 1)).sum()) + 0.2 / SIZE
    np.testing.assert_allclose(np.asarray(state.pool.weights)[order], ranks, rtol=1e-4)


@pytest.mark.night
def test_starts_of_least_regret_are_replaced_by_others_like_the_best(env, by_regret):
    gaps = np.random.default_rng(1).permutation(SIZE) * 2.0
    before = _regretted(env, by_regret, gaps)
    after = refill(env, REGRET, before, jax.random.key(5))
    lowest = np.argsort(gaps)[:4]
    gone = np.asarray(before.pool.states.start) != np.asarray(after.pool.states.start)
    np.testing.assert_array_equal(np.flatnonzero(gone), np.sort(lowest))
    np.testing.assert_array_equal(np.asarray(after.pool.states.start)[lowest], lowest + SIZE)
    old_keys, new_keys = (np.asarray(jax.random.key_data(each.keys)) for each in (before, after))
    for slot in lowest:
        parent = int(np.flatnonzero((old_keys == new_keys[slot]).all(1))[0])
        old, new = before.pool.states, after.pool.states
        for name, low, high in env.randomization.bounds:
            change = np.abs(np.asarray(new.randomization[name][slot] - old.randomization[name][parent]))
            assert 0 < change.max() < 0.8 * (high - low) and change.mean() < 0.5 * (high - low)
        assert float(after.guess[slot]) == pytest.approx(float(curricula.regret(before)[parent]))
        assert float(after.episodes[slot]) == 0.0
        position = np.asarray(new.simulation.pedestrians.position)[slot, 0]
        np.testing.assert_allclose(position, np.asarray(old.simulation.pedestrians.position)[parent, 0], atol=1e-5)
    for one, other in zip(*(jax.tree.leaves(each.pool.observations) for each in (before, after)), strict=True):
        np.testing.assert_array_equal(np.asarray(one)[~gone], np.asarray(other)[~gone])
    # An episode from a start that is gone counts no more, and one from its successor does.
    seen = observe(env, REGRET, after, record(np.r_[lowest, lowest + SIZE], np.full(8, 100.0)))
    np.testing.assert_allclose(np.asarray(seen.episodes)[lowest], 1.0)
    # What is not known stays: there is nothing to replace after one episode.
    once = observe(env, REGRET, by_regret, record(np.arange(SIZE), gaps))
    same = refill(env, REGRET, once, jax.random.key(5))
    np.testing.assert_array_equal(same.pool.states.start, once.pool.states.start)


# ------------------------------------------------------------------ as a whole


@pytest.mark.slow
def test_it_is_a_function_of_its_arrays(env, by_regret):
    """Through numbers, as a checkpoint keeps it, and on: the same to the bit; and one program serves all."""

    state = _regretted(env, by_regret, np.arange(SIZE) * 1.0)
    kept = jax.tree.map(np.asarray, random_streams.as_numbers(state))
    again = random_streams.as_keys(jax.tree.map(jnp.asarray, kept), state)
    one, other = (refill(env, REGRET, each, jax.random.key(8)) for each in (state, again))
    trees.assert_equal(random_streams.as_numbers(one), random_streams.as_numbers(other))
    traced = observe._cache_size()
    observe(env, REGRET, one, record(np.arange(SIZE), np.arange(SIZE)))
    assert observe._cache_size() == traced


def test_sums_by_start_are_exact_in_any_order():
    rng = np.random.default_rng(0)
    values, slot = rng.normal(size=(50, 40, 3)) * [1e-3, 1.0, 1e4], rng.integers(0, 7, (50, 40))
    order = rng.permutation(2000)
    found = curricula._by_start(jnp.asarray(values, jnp.float32), jnp.asarray(slot), 7)
    mixed = values.reshape(-1, 3)[order].reshape(50, 40, 3), slot.reshape(-1)[order].reshape(50, 40)
    again = curricula._by_start(jnp.asarray(mixed[0], jnp.float32), jnp.asarray(mixed[1]), 7)
    wanted = np.stack([values[slot == each].sum(0) for each in range(7)])
    np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=1e-3 * np.abs(values).mean())
    np.testing.assert_allclose(found, again, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"by": "luck"}, "'luck' is not one of situations, regret"),
        ({"floor": 1.5}, "floor 1.5 must be a share"),
        ({"temperature": 0.0}, "temperature 0 must be above 0"),
        ({"situations": (("empty", 0.0),)}, "one above 0"),
    ],
)
def test_bad_plans(options, message):
    with pytest.raises(InputError, match=message):
        CurriculumPlan(**options)


def test_what_people_are_cost():
    parts = {"progress": jnp.array([-3.0]), "personal_space": jnp.array([-0.5]), "intimate_x": jnp.array([-2.0]),
             "collision_y": jnp.array([1.0])}  # fmt: skip
    np.testing.assert_allclose(curricula.social_cost(parts), [2.5])
    with pytest.raises(InputError, match="no term of the reward is about people"):
        curricula.social_cost({"progress": jnp.zeros(1)})


# ------------------------------------------------------------------ in a training


@pytest.mark.night
@pytest.mark.parametrize("kind", ["situations", "regret"])
def test_a_training_with_a_curriculum_goes_on_to_the_same_curve(kind, tmp_path, monkeypatch):
    """Stopped between two draws of new starts, it ends with the same agent and the same starts."""
    from sean_jax.config import PPOConfig
    from sean_jax.learning import reinforcement

    def options(out) -> PPOConfig:
        return PPOConfig(
            method="ppo", environment="lab", people=3, time_limit=1.0, scenarios=8, horizon=16, minibatches=2, epochs=1,
            width=16, pool=8, evaluate_every=3, evaluation_episodes=2, steps=8 * 16 * 6, metrics=["mean_speed"],
            observations=["goal", "speeds"], curriculum=kind, curriculum_every=2, out=out,
        )  # fmt: skip

    whole = reinforcement.train(options(tmp_path / "whole"))
    assert whole.curriculum is not None
    assert int(np.asarray(whole.curriculum.pool.states.start).max()) >= 8  # some have been replaced
    numbers, calls = reinforcement._finite_means, []

    def until(values):
        calls.append(values)
        if len(calls) == 4 * 5:  # in the fifth update, after a checkpoint in the third
            raise KeyboardInterrupt
        return numbers(values)

    monkeypatch.setattr(reinforcement, "_finite_means", until)
    with pytest.raises(KeyboardInterrupt):
        reinforcement.train(options(tmp_path / "stopped"))
    monkeypatch.undo()
    again = reinforcement.train(options(tmp_path / "stopped"))
    assert int(again.update) == 6
    for one, other in zip(*(jax.tree.leaves(random_streams.as_numbers(each)) for each in (whole, again)), strict=True):
        np.testing.assert_array_equal(one, other)

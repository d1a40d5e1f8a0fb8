"""Costs with a limit: multipliers against a plant whose answer is known, and in a training."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import registry
from sean_jax.config import PPOConfig
from sean_jax.core.errors import InputError
from sean_jax.learning import costs, reinforcement
from sean_jax.mdp import rewards

LIMITS = {"intimate_robot_on_person": 0.2, "personal_space": 0.5}
SMALL = dict(
    method="ppo", environment="lab", behavior="random", people=3, time_limit=4.0, scenarios=8, horizon=8, minibatches=2,
    width=16, pool=8, evaluate_every=2, evaluation_episodes=2, steps=8 * 8 * 4, metrics=["mean_speed"],
    observations=["goal", "speeds"], rewards=["progress", "personal_space"],
)  # fmt: skip


FAST = """
def fast(scenario, before, after):
    share = after.robot.speed / scenario.robot.max_speed
    return share * share * scenario.time_step
"""


def options(out=None, **others) -> PPOConfig:
    return PPOConfig(**{**SMALL, "out": out, **others})  # pyright: ignore


def settled(limit: float, free: float, scale: float, noise: float = 0.0, steps: int = 4000):
    """Multipliers of three agents whose rate falls as exp(-multiplier / scale), a while after it has changed."""
    terms = costs.with_costs(rewards.as_terms({"personal_space": -1.0}), {"personal_space": limit})
    first = costs.init(terms, {"personal_space": limit}, 3)["personal_space"]

    def one(carry, key):
        multiplier, rate = carry
        seen = rate * jnp.exp(noise * jax.random.normal(key, rate.shape) - 0.5 * noise**2)
        multiplier = costs.update(multiplier, seen, limit)
        rate = rate + 0.1 * (free * jnp.exp(-costs.value(multiplier, limit) / scale) - rate)
        return (multiplier, rate), (costs.value(multiplier, limit), rate)

    keys = jax.random.split(jax.random.key(0), steps)
    _, (values, rates) = jax.lax.scan(one, (first, jnp.full(3, free)), keys)
    return np.asarray(values), np.asarray(rates)


@pytest.mark.parametrize(("limit", "free", "scale"), [(0.1, 2.0, 5.0), (0.5, 1.0, 0.3), (1.0, 30.0, 10.0)])
def test_the_limit_is_kept_by_the_least_multiplier_that_does(limit, free, scale):
    """scale * log(free / limit) is the Lagrange multiplier."""
    values, rates = settled(limit, free, scale)
    np.testing.assert_allclose(rates[-1], limit, rtol=0.02)
    np.testing.assert_allclose(values[-1], scale * np.log(free / limit), rtol=0.02)
    values, rates = settled(limit, free, scale, noise=1.0)
    np.testing.assert_allclose(rates[2000:].mean(0), limit, rtol=0.25)


def test_a_limit_that_binds_nobody_costs_nothing():
    values, rates = settled(limit=2.0, free=0.5, scale=5.0)
    assert (values[-1] <= 1.01 * costs.LEAST).all() and (rates <= 0.5).all()


def test_a_limit_that_nobody_can_keep_stays_finite():
    values, _ = settled(limit=1e-6, free=1e6, scale=1e9)
    most = costs.GREATEST * np.exp(costs.PROPORTIONAL * costs.MAX_EXCESS)
    assert np.isfinite(values).all() and values.max() <= 1.001 * most


def test_costs_are_terms_of_the_reward_with_the_weights_they_had():
    terms = costs.with_costs(rewards.as_terms({"progress": 2.0, "personal_space": -3.0}), LIMITS)
    assert [(name, term.weight) for name, term in terms] == [
        ("progress", 2.0), ("personal_space", -3.0), ("intimate_robot_on_person", -1.0),
    ]  # fmt: skip
    multipliers = costs.init(terms, LIMITS, 2)
    found = costs.weights(multipliers, LIMITS)
    np.testing.assert_allclose(found["personal_space"], [-3.0, -3.0], rtol=1e-6)
    np.testing.assert_allclose(found["intimate_robot_on_person"], [-1.0, -1.0], rtol=1e-6)
    assert costs.init(terms, {}, 2) is None and costs.weights(None, {}) == {} and costs.with_costs(terms, {}) == terms
    parts = {"personal_space": jnp.array([-0.06, 0.0]), "intimate_robot_on_person": jnp.array([0.0, -0.01])}
    after, told = costs.follow(multipliers, LIMITS, parts, 0.1)  # in a step of 0.1 s
    np.testing.assert_allclose(told["costs"]["personal_space"], [0.02 * 600, 0.0], rtol=1e-5)
    np.testing.assert_allclose(told["costs"]["intimate_robot_on_person"], [0.0, 0.01 * 600], rtol=1e-5)
    np.testing.assert_allclose(told["multipliers"]["personal_space"], [3.0, 3.0], rtol=1e-5)
    now = costs.value(after["personal_space"], 0.5)
    assert now[0] > 3.0 > now[1] > 0.0
    assert float(costs.penalty({"personal_space": 0.75, "intimate_robot_on_person": 0.1}, LIMITS)) == 50.0


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"costs": ["collision"]}, "costs: collision has no limit above 0 per minute; write collision=0.1"),
        ({"costs": ["collision=0"]}, "costs: collision=0 has no limit above 0"),
        ({"costs": ["time=1", "time=2"]}, "costs: 'time' is listed twice"),
        (
            {"costs": ["time=1"], "sweep": ["rewards.time=-1,-2"]},
            "the weight of the cost time is learned; leave rewards",
        ),
    ],
)
def test_bad_costs_are_refused(more, message):
    with pytest.raises(InputError, match=message):
        options(**more)


def test_costs_that_are_none_are_refused():
    for name, message in (
        ("colision_with_obstacle", "costs: .*did you mean 'collision_with_"),
        ("progress", "a potential"),
    ):
        with pytest.raises(InputError, match=message):
            reinforcement.build(options(costs=[f"{name}=1"]))


@pytest.mark.night
def test_a_training_learns_multipliers_and_goes_on_with_them(tmp_path, monkeypatch):
    """Of a cost that no reward names and of one that does; resumed, the curve is the same; each seed has its own."""
    more = {"costs": ["time=30", "personal_space=1000"], "seeds": 2}
    whole = reinforcement.train(options(tmp_path / "whole", **more))
    lines = [json.loads(line) for line in (tmp_path / "whole" / "metrics.jsonl").read_text().splitlines()]
    told = [line["multipliers"]["time"] for line in lines]
    assert all(line["costs"]["time"] == pytest.approx(60.0, rel=1e-3) for line in lines)  # a second each second
    assert told[0] == pytest.approx(1.0) and told == sorted(told) and told[-1] > 1.0  # REWARDS have time at weight 1
    calm = [line["multipliers"]["personal_space"] for line in lines]
    assert calm[0] == pytest.approx(1.0, rel=1e-3) and calm[-1] < calm[0]
    last = lines[-1]["evaluation"]
    assert last["time a minute"] == pytest.approx(60.0, rel=1e-3) and "personal_space a minute" in last
    assert float(whole.best.value.max()) == pytest.approx(max(float(whole.best.value[0]), float(whole.best.value[1])))
    assert (np.asarray(whole.best.value) < -90.0).all()  # twice the limit costs 100

    numbers, calls = reinforcement._finite_means, []

    def until(values):
        calls.append(values)
        if len(calls) == 3 * 5:  # of the third update: an update has five parts
            raise KeyboardInterrupt
        return numbers(values)

    monkeypatch.setattr(reinforcement, "_finite_means", until)
    with pytest.raises(KeyboardInterrupt):
        reinforcement.train(options(tmp_path / "parts", **more))
    monkeypatch.undo()
    again = reinforcement.train(options(tmp_path / "parts", **more))
    for one, other in zip(*(jax.tree.leaves((each.agent, each.multipliers)) for each in (whole, again)), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.night
def test_an_agent_keeps_a_limit_that_its_reward_would_break(tmp_path):
    """Paid by the metre, it would drive at full speed, 60 a minute; 20 a minute are 0.29 m/s, at which the cost of
    another metre is its reward if the multiplier is 0.43.
    """
    (tmp_path / "mine.py").write_text(FAST)
    config = options(
        tmp_path / "run", people=0, time_limit=20.0, scenarios=32, horizon=32, steps=32 * 32 * 200, minibatches=4,
        evaluate_every=200, evaluation_episodes=32, width=32, pool=64, observations=["goal", "path"],
        task_distance=(4.0, 8.0), rewards=["progress", f"{tmp_path}/mine.py:fast"], costs=["fast=20"],
        learning_rate=2e-3, discount=0.9,
    )  # fmt: skip
    reinforcement.train(config)
    lines = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    rates, multipliers = ([line[part]["fast"] for line in lines] for part in ("costs", "multipliers"))
    assert np.mean(rates[-50:]) == pytest.approx(20.0, rel=0.15), (rates, multipliers)
    assert np.mean(multipliers[-50:]) == pytest.approx(0.43, rel=0.3), multipliers


def test_a_term_of_the_users_own_may_be_a_cost(tmp_path):
    (tmp_path / "mine.py").write_text("def near(scenario, before, after):\n    return before.robot.speed\n")
    config = options(rewards=["progress", f"{tmp_path}/mine.py:near"], costs=["near=3"])
    terms = costs.with_costs(registry.build(config).member.rewards, config.cost_limits)
    assert dict(terms)["near"].weight == -1.0

"""``sean train ppo``: its parts against plain loops, resuming to the same curve, driving, and failing in sentences."""

import json
import shutil
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import cli, learning, registry
from sean_jax.config import PPOConfig
from sean_jax.errors import InputError
from sean_jax.learning import actor_critic, ppo
from sean_jax.learning.actor_critic import ActorCritic, Agent, Statistics

SMALL = dict(
    method="ppo", environment="lab", behavior="random", people=2, time_limit=4.0, scenarios=8, horizon=8, minibatches=2,
    epochs=2, width=16, pool=8, evaluate_every=2, evaluation_episodes=2, steps=8 * 8 * 6, metrics=["mean_speed"],
    observations=["goal", "speeds"], rewards=["progress", "time"],
)  # fmt: skip


def options(out, **others) -> PPOConfig:
    return PPOConfig(**{**SMALL, "out": out, **others})  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A training of six updates, and its folder."""
    folder = tmp_path_factory.mktemp("ppo") / "whole"
    return ppo.train(options(folder)), folder


def curve(folder) -> list[dict]:
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [{name: part for name, part in line.items() if name not in ("time", "per_second")} for line in lines]


def test_advantages_are_those_of_the_definition():
    """Against the sum of discounted errors as printed, in float64; truncated ends are bootstrapped, others are not."""
    rng = np.random.default_rng(0)
    steps, rows = 12, 5
    config = options(None, discount=0.9, advantage_decay=0.8)
    reward, value, final = rng.normal(size=(3, steps, rows))
    over = rng.random((steps, rows)) < 0.2
    final = np.where(over & (rng.random((steps, rows)) < 0.5), final, 0.0)
    last = rng.normal(size=rows)
    zero = jnp.zeros((steps, rows))
    seen = ppo.Seen((), {}, zero, zero, zero, jnp.asarray(value), jnp.asarray(reward), jnp.asarray(over),
                    jnp.asarray(final), {})  # fmt: skip
    found = ppo._advantages(seen, jnp.asarray(last), config)
    for row in range(rows):
        for begin in range(steps):
            total, weight = 0.0, 1.0
            for step in range(begin, steps):
                following = (
                    final[step, row] if over[step, row] else (value[step + 1, row] if step + 1 < steps else last[row])
                )
                total += weight * (reward[step, row] + 0.9 * following - value[step, row])
                weight *= 0.9 * 0.8
                if over[step, row]:
                    break
            assert float(found[begin, row]) == pytest.approx(total, abs=1e-5)


def test_statistics_are_those_of_all_together():
    rng = np.random.default_rng(1)
    statistics = Statistics(jnp.zeros(3), jnp.ones(3), jnp.full((), 1e-4))
    parts = [rng.normal(5.0, 2.0, (number, 3)).astype(np.float32) for number in (7, 1, 300)]
    for part in parts:
        statistics = actor_critic.update_statistics(statistics, jnp.asarray(part))
    everything = np.concatenate(parts)
    np.testing.assert_allclose(statistics.mean, everything.mean(0), rtol=1e-4)
    np.testing.assert_allclose(statistics.variance, everything.var(0), rtol=1e-3)


def test_density_and_entropy_are_those_of_a_normal_distribution():
    from scipy.stats import norm

    rng = np.random.default_rng(2)
    mean, log_std, action = rng.normal(size=(3, 4, 2))
    said = actor_critic.Answer(*map(jnp.asarray, (mean, log_std)), jnp.zeros(4), jnp.zeros((4, 0)))
    wanted = norm(mean, np.exp(log_std))
    np.testing.assert_allclose(actor_critic.log_density(said, jnp.asarray(action)), wanted.logpdf(action).sum(-1), 1e-5)
    np.testing.assert_allclose(actor_critic.entropy(said), wanted.entropy().sum(-1), 1e-5)


def test_a_memory_begins_anew_with_an_episode():
    network = ActorCritic(8, 1, (), recurrent=True)
    env = registry.load("Lab-Random-RandomAbNav-v0", config_overrides={"people": 2, "observations": ["goal"]})
    agent = actor_critic.init_agent(network, env.observations, env.observation_space, jax.random.key(0))
    goal, full, empty = jnp.array([1.0, 2.0]), jnp.full(8, 0.7), jnp.zeros(8)
    say = lambda memory, start: actor_critic.answer(network, agent, goal, {}, memory, jnp.asarray(start))  # noqa: E731
    assert float(say(full, True).value) == float(say(empty, True).value) == float(say(empty, False).value)
    assert float(say(full, False).value) != float(say(empty, False).value)


def test_a_training_has_its_files(trained):
    state, folder = trained
    lines = curve(folder)
    assert [line["epoch"] for line in lines] == [1, 2, 3, 4, 5, 6] and int(state.update) == 6
    assert ["evaluation" in line for line in lines] == [False, True] * 3
    assert lines[-1]["steps"] == 8 * 8 * 6 and 0.0 <= lines[-1]["evaluation"]["completed"] <= 1.0
    assert "mean_speed in empty" in lines[-1]["evaluation"]
    assert float(state.best) == pytest.approx(max(line["evaluation"]["return"] for line in lines[1::2]))
    assert (folder / "config.json").is_file() and list(folder.glob("events.*"))


@pytest.mark.slow
def test_a_stopped_training_goes_on_to_the_same_curve(trained, tmp_path, monkeypatch):
    """Stopped before and after checkpoints, it ends with the same numbers and the same agent."""
    folder = tmp_path / "run"
    for last in (1, 5):
        monkeypatch.setattr(ppo, "_numbers", _until(ppo._numbers, last))
        with pytest.raises(KeyboardInterrupt):
            ppo.train(options(folder))
        monkeypatch.undo()
    state = ppo.train(options(folder))
    assert curve(folder) == curve(trained[1])
    for one, other in zip(jax.tree.leaves(state.agent), jax.tree.leaves(trained[0].agent), strict=True):
        np.testing.assert_array_equal(one, other)


def _until(numbers, last):
    """``ppo._numbers``, which is called three times an update, until Ctrl-C in update ``last`` of this process."""
    calls = []

    def call(values):
        calls.append(values)
        if len(calls) == 3 * last:
            raise KeyboardInterrupt
        return numbers(values)

    return call


@pytest.mark.slow
def test_it_drives_as_it_was_evaluated(trained):
    """The policy of the folder, in ``evaluate``, and in an env step by step: the same commands."""
    _, folder = trained
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    driver = learning.load(folder, scenario)
    assert driver.name == folder.name
    _, recorded = jax.jit(sean_jax.rollout, static_argnums=3)(scenario, driver, jax.random.key(5), 10)
    env = replace(registry.build(options(folder)), scenario=scenario)
    state = sean_jax.reset(scenario, jax.random.key(5))
    seen, envs = env.reset(jax.random.key(0))
    envs = replace(envs, simulation=state)
    agent: Agent = driver.params.agent
    seen, _ = sean_jax.mdp.observations.begin(env.observations, scenario, state, jax.random.key(0))
    advance = jax.jit(env.advance)
    for tick in range(10):
        vector = sean_jax.mdp.flatten(env.observations, seen)
        said = actor_critic.answer(driver.params.network, agent, vector, {}, jnp.zeros(0), jnp.zeros((), bool))
        envs, seen, *_, info = advance(envs, said.mean)
        np.testing.assert_allclose(info["command"], recorded.action[tick], atol=1e-4)


@pytest.mark.slow
def test_it_learns_to_go_to_the_goal(tmp_path):
    """From nothing to half of the tasks, alone in the lab, in some 300,000 steps."""
    config = options(
        tmp_path / "run", people=0, time_limit=40.0, scenarios=64, horizon=32, minibatches=4, epochs=4, width=64,
        steps=400_000, evaluate_every=100, evaluation_episodes=32, task_distance=(2.0, 4.0), pool=256, hold_time=1.0,
        observations=["goal", "path", "distance", "speeds"], rewards=["default"], metrics=["path_length"],
    )  # fmt: skip
    ppo.train(config)
    found = [line["evaluation"]["completed"] for line in curve(tmp_path / "run") if "evaluation" in line]
    assert max(found) > 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["train"], "train: '' is not one of imitation, dagger, ppo"),
        (["train", "poo"], "did you mean 'ppo'"),
        (["train", "ppo", "--scenarios", "10", "--minibatches", "4"], "10 scenarios do not make 4 minibatches"),
        (["train", "ppo", "--observations", "gaol"], "gaol"),
        (["train", "ppo", "--discount", "1.5"], "--discount"),
    ],
)
def test_bad_words(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_it_goes_on_with_another_agent(trained, tmp_path):
    state, folder = trained
    config = options(tmp_path / "next", pretrained=folder, learning_rate=1e-12, steps=8 * 8, evaluate_every=1)
    agent = ppo.train(config).agent
    best = learning.load(folder, registry.build(config).scenario).params.agent
    for one, other in zip(*map(jax.tree.leaves, (agent.parameters, best.parameters)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)
    with pytest.raises(InputError, match="width 16, not 32"):
        ppo.train(options(tmp_path / "wide", pretrained=folder, width=32))
    with pytest.raises(InputError, match="no trained agent"):
        ppo.train(options(tmp_path / "none", pretrained=tmp_path))


def test_other_options_are_refused_in_its_folder(trained):
    with pytest.raises(InputError, match="discount"):
        ppo.train(options(trained[1], discount=0.5))


def test_a_config_of_another_version_is_refused(trained, tmp_path):
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin")
    config = json.loads((trained[1] / "config.json").read_text())
    for change, message in [
        ({"method": "magic"}, "method"),
        ({"width": -3}, "width"),
        ({"observations": ["no"]}, "no"),
    ]:
        (tmp_path / "config.json").write_text(json.dumps(config | change))
        with pytest.raises(ValueError, match=message):
            learning.load(tmp_path, scenario)


def test_a_packed_agent_drives_as_its_training(trained, tmp_path, capsys):
    """Its commands are those of the checkpoint but for the rounding of the weights to 16 bits."""
    folder, out = trained[1], tmp_path / "small"
    assert cli.main(["export", "agent", str(folder), "--out", str(out), "--quiet"]) == 0
    assert {path.name for path in out.iterdir()} == {"config.json", "weights.npz"}
    told = json.loads((out / "config.json").read_text())
    best = max(curve(folder)[1::2], key=lambda line: line["evaluation"]["return"])
    assert told["agent"]["steps"] == best["steps"] and told["width"] == 16
    assert told["agent"]["evaluation"]["return"] == best["evaluation"]["return"]
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    state = sean_jax.reset(scenario, jax.random.key(5))
    driven = []
    for driver in (learning.load(folder, scenario), learning.load(out, scenario)):
        begun = replace(state, policy_state=driver.init(scenario, driver.params, state))
        driven.append(driver.apply(scenario, driver.params, begun, jax.random.key(0))[0])
    assert driver.name == "small" and 0 < np.abs(driven[0] - driven[1]).max() + 1e-9 < 1e-3
    with pytest.raises(InputError, match="packed already"):
        learning.pack(out, tmp_path / "again")
    with pytest.raises(InputError, match="not empty"):
        learning.pack(folder, out)


def test_a_training_that_saw_something_else_is_refused(trained, tmp_path):
    """Of this folder the observation is changed, as if a term gave other numbers than when it was trained."""
    shutil.copytree(trained[1], tmp_path / "other")
    file = tmp_path / "other" / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"observations": ["goal", "situations"]}))
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin")
    with pytest.raises(InputError, match="sees 4 numbers, and this scenario shows 7 .goal, situations.; make"):
        learning.load(tmp_path / "other", scenario)

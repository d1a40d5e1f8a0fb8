"""``sean train ppo``: its parts against plain loops, resuming to the same curve, driving, and failing in sentences."""

import json
import shlex
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import learning, mdp, registry
from sean_jax.cli import command_line, commands
from sean_jax.config import COMMANDS, APGConfig, PPOConfig, flags
from sean_jax.core.errors import InputError
from sean_jax.learning import networks, ppo, reinforcement, rollouts, shac
from sean_jax.learning.networks import ActorCritic, Agent, Statistics
from sean_jax.learning.policy import AGENTS, Best
from sean_jax.learning.trainer import TrainState
from sean_jax.mdp import rewards
from sean_jax.simulation.scenario_stack import Stack
from support import trees
from support.quick import quick
from support.scenes import box, room

SMALL = dict(
    method="ppo", environment="lab", behavior="random", people=2, time_limit=4.0, scenarios=8, horizon=8, minibatches=2,
    epochs=2, width=16, pool=8, evaluate_every=2, evaluation_episodes=2, steps=8 * 8 * 6, metrics=["mean_speed"],
    observations=["goal", "speeds"], rewards=["progress", "time"],
)  # fmt: skip


def options(out, **others) -> PPOConfig:
    return PPOConfig(**{**SMALL, "out": out, **others})  # pyright: ignore[reportArgumentType]


def analytic(out, **others) -> APGConfig:
    fields = {name: value for name, value in SMALL.items() if name != "epochs"} | {"method": "apg", "out": out}
    return APGConfig(**(fields | others))  # pyright: ignore[reportArgumentType]


def standing(config: PPOConfig, network: ActorCritic, over) -> reinforcement.Programs:
    """Programs of a training in which nobody moves: they compile at once, and all around them is as ever."""
    number = len(config.agents)

    def begin(envs, first: Agent) -> TrainState:
        best = Best(first, jnp.full(number, -jnp.inf, jnp.float32), jnp.zeros(number, jnp.int32))
        return TrainState(first, (), best, jnp.zeros((), jnp.int32))

    def update(envs, state):
        agent = jax.tree.map(lambda leaf: leaf + 0.1, state.agent)
        none = jnp.zeros(number)
        told = {"train": {"loss": none}, "episodes": {"return": none, "completed": none}}
        return replace(state, agent=agent, update=state.update + 1), told

    def evaluate(scenarios, envs, starts, several: Agent):
        value = jnp.sin(10.0 * several.statistics.mean[:, 0])  # of update 2 highest
        found = {"return": value, "completed": value**2, "mean_speed": jnp.ones((number, 6)) * value[:, None]}
        return value, [found] * len(envs)

    refill = jax.jit(lambda envs, state: state)
    best = jax.jit(reinforcement.keep_best)
    return reinforcement.Programs(jax.jit(begin), jax.jit(update), jax.jit(evaluate), refill, best)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """What a training of six updates in which nobody moves leaves, and its folder."""
    folder = tmp_path_factory.mktemp("ppo") / "whole"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(reinforcement, "programs", standing)
        patched.setattr(reinforcement, "draw_starts", lambda options, scenarios, envs: (envs, ()))
        return reinforcement.train(options(folder)), folder


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """The same of a training that has learned: of slow tests."""
    folder = tmp_path_factory.mktemp("ppo") / "learned"
    return reinforcement.train(options(folder)), folder


@pytest.fixture(scope="module")
def env() -> mdp.Env:
    """Where agents see their goal and nothing else."""
    return registry.load("Lab-Random-RandomAbNav-v0", config_overrides={"people": 2, "observations": ["goal"]})


def begun(network: ActorCritic, env: mdp.Env) -> Agent:
    """An agent before it has learned."""
    return jax.jit(lambda key: networks.init_agent(network, env.observations, env.observation_space, key))(
        jax.random.key(0)
    )


def curve(folder) -> list[dict]:
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [
        {name: part for name, part in line.items() if name not in ("time", "seconds", "per_second")} for line in lines
    ]


def test_advantages_are_those_of_the_definition():
    """Against the sum of discounted errors as printed, in float64; truncated ends are bootstrapped, others are not."""
    rng = np.random.default_rng(0)
    steps, rows = 12, 5
    reward, value, final = rng.normal(size=(3, steps, rows))
    over = rng.random((steps, rows)) < 0.2
    final = np.where(over & (rng.random((steps, rows)) < 0.5), final, 0.0)
    last = rng.normal(size=rows)
    zero = jnp.zeros((steps, rows))
    seen = rollouts.Transition((), {}, zero, zero, zero, jnp.asarray(value), jnp.asarray(reward), jnp.asarray(over),
                    jnp.asarray(final), {})  # fmt: skip
    found = rollouts.advantages(seen, jnp.asarray(last), 0.9, 0.8)
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
        statistics = networks.update_statistics(statistics, jnp.asarray(part))
    everything = np.concatenate(parts)
    np.testing.assert_allclose(statistics.mean, everything.mean(0), rtol=1e-4)
    np.testing.assert_allclose(statistics.variance, everything.var(0), rtol=1e-3)


def test_density_and_entropy_are_those_of_a_normal_distribution():
    from scipy.stats import norm

    rng = np.random.default_rng(2)
    mean, log_std, action = rng.normal(size=(3, 4, 2))
    said = networks.NetworkOutput(*map(jnp.asarray, (mean, log_std)), jnp.zeros(4), jnp.zeros((4, 0)))
    wanted = norm(mean, np.exp(log_std))
    np.testing.assert_allclose(networks.log_density(said, jnp.asarray(action)), wanted.logpdf(action).sum(-1), 1e-5)
    np.testing.assert_allclose(networks.entropy(said), wanted.entropy().sum(-1), 1e-5)


def test_a_memory_begins_anew_with_an_episode(env):
    network = ActorCritic(8, 1, (), recurrent=True)
    agent = begun(network, env)
    goal, full, empty = jnp.array([1.0, 2.0]), jnp.full(8, 0.7), jnp.zeros(8)
    say = lambda memory, start: networks.apply(network, agent, goal, {}, memory, jnp.asarray(start))  # noqa: E731
    assert float(say(full, True).value) == float(say(empty, True).value) == float(say(empty, False).value)
    assert float(say(full, False).value) != float(say(empty, False).value)


def test_matrices_of_several_agents_are_factorized_one_by_one(env):
    """jaxlib deadlocks on two cores where two batches of factorizations run at once, as under vmap."""
    keys = jax.random.split(jax.random.key(0), 3)
    seen = ActorCritic(8, 1), env.observations, env.observation_space

    def factorizations(program):
        for step in program.eqns:
            if step.primitive.name in ("qr", "geqrf", "householder_product"):
                yield step
            for part in jax.tree.leaves(list(step.params.values())):
                if hasattr(inner := getattr(part, "jaxpr", part), "eqns"):
                    yield from factorizations(inner)

    program = jax.make_jaxpr(lambda keys: networks.init_agents(*seen, keys))(keys).jaxpr
    found = list(factorizations(program))
    assert found and all(step.invars[0].aval.ndim == 2 for step in found)
    agents = jax.jit(lambda keys: networks.init_agents(*seen, keys))(keys)
    alone = jax.jit(lambda key: networks.init_agent(*seen, key))(keys[1])
    for one, other in zip(*map(jax.tree.leaves, (agents, alone)), strict=True):
        np.testing.assert_allclose(one[1], other, atol=1e-6)


def test_noise_is_what_is_asked_for(env):
    network = ActorCritic(8, 1)
    agent = begun(network, env)
    agent = networks.with_noise(agent, 0.1)
    seen = jnp.array([[1.0, 2.0], [-3.0, 0.5]])
    said = networks.apply(network, agent, seen, {}, jnp.zeros((2, 0)), jnp.ones(2, bool))
    np.testing.assert_allclose(jnp.exp(said.log_std), 0.1, rtol=1e-5)


@pytest.mark.parametrize("training", quick(["trained", "learned"], "trained"))
def test_a_training_has_its_files(training, request):
    state, folder = request.getfixturevalue(training)
    lines = curve(folder)
    assert [line["epoch"] for line in lines] == [1, 2, 3, 4, 5, 6] and int(state.update) == 6
    assert ["evaluation" in line for line in lines] == [False, True] * 3
    assert lines[-1]["steps"] == 8 * 8 * 6 and 0.0 <= lines[-1]["evaluation"]["completed"] <= 1.0
    assert "mean_speed in empty" in lines[-1]["evaluation"]
    assert float(state.best.value[0]) == pytest.approx(max(line["evaluation"]["return"] for line in lines[1::2]))
    assert (folder / "config.json").is_file() and (folder / "curve.png").is_file()


@pytest.mark.night
@pytest.mark.parametrize("method", quick(["ppo", "apg"], "ppo"))
def test_programs_of_a_training_fit_together(method):
    """Traced, not compiled: an update gives a state like the one that it gets, and an evaluation what is logged."""
    config = (options if method == "ppo" else analytic)(None)
    scenarios, (env,), network = reinforcement.build(config)
    run = reinforcement.programs(config, network, reinforcement.device_layout(1))

    def together(key):
        starts = reinforcement.evaluation_starts(config, scenarios, (env,))
        pooled = (rollouts.with_pool(env, key, config.pool),)
        several = networks.init_agents(network, env.member.observations, env.member.observation_space, key[None])
        before = run.begin(pooled, several)
        return before, *run.update(pooled, before), run.evaluate(scenarios, (env,), starts, several)

    before, after, told, (value, (found,)) = jax.eval_shape(together, jax.random.key(0))
    assert jax.tree.structure(before) == jax.tree.structure(after)
    for one, other in zip(*map(jax.tree.leaves, (before, after)), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
    assert all(leaf.shape == (1,) for leaf in jax.tree.leaves((told["train"]["loss"], told["episodes"])))
    assert value.shape == found["completed"].shape == (1,) and found["mean_speed"].shape == (1, 6)


def test_progress_is_of_a_hundred_episodes_or_more():
    """Updates of two agents, each of which ends few episodes: means are of all recent ones, each counted once."""
    recent = reinforcement.Recent()
    assert recent.note() == "no episode has ended"
    recent.add(
        {name: np.array([np.nan, np.nan]) for name in ("return", "completed")} | {"number": np.zeros(2)}, 64, 9.0
    )
    assert recent.note() == "no episode has ended"
    random, returns, completed = np.random.default_rng(0), [], []
    for k in range(60):
        number = random.integers(0, 7, 2)
        values = random.normal(size=2) + k
        shares = np.array([0.0, 1.0])
        nothing = np.where(number == 0, np.nan, 0.0)
        update = {"number": number.astype(float), "return": values + nothing, "completed": shares + nothing}
        recent.add(update, 64.0, 0.5)
        returns.append(np.repeat(values, number))
        completed.append(np.repeat(shares, number))
        counts = np.cumsum([len(each) for each in returns[::-1]])
        first = len(counts) - 1 - int(np.argmax(counts >= 100)) if counts[-1] >= 100 else 0
        latest, done = np.concatenate(returns[first:]), np.concatenate(completed[first:])
        if len(latest):
            note = f"last {len(latest)} episodes: return {latest.mean():.1f}, completed {done.mean():.0%} · 128 steps/s"
            assert recent.note() == note, k
    assert counts[-1] > 150 and 100 <= len(latest) < 112


def test_the_command_after_a_training_drives_where_it_was_trained(tmp_path):
    config = options(tmp_path, environment="yard,lab", robot="kuri,fetch", hold_time=1.0, forces="sean2").as_run()
    words = shlex.split(commands.run_command(tmp_path / "made", True, config))
    assert words[:4] == ["sean", "run", "--policy", str(tmp_path / "made")] and words[-1] == "--trust"
    assert words[4:-1] == shlex.split(
        "--environment yard --behavior random --walking-groups 0 0 --robot kuri --people 2 --forces sean2 "
        "--time-limit 4 --hold-time 1"
    )
    plain = commands.run_command(Path("mine"), options=PPOConfig(out=tmp_path).as_run())
    assert plain == "sean run --policy ./mine --environment warehouse"


@pytest.mark.night
def test_evaluations_use_the_weights_of_each_agent():
    """Two agents with the same parameters, whose rewards are k and -2 k: returns of the step in the same proportion."""
    config = options(None, sweep=["rewards.time=1,-2"], rewards=["time"], evaluation_episodes=1, time_limit=0.5)
    scenarios, envs, network = reinforcement.build(config)
    agent = begun(network, envs[0].member)
    agents = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), agent)
    starts = reinforcement.evaluation_starts(config, scenarios, envs)
    run = reinforcement.programs(config, network, reinforcement.device_layout(2))
    value, (found,) = run.evaluate(scenarios, envs, starts, agents)
    np.testing.assert_allclose(value, [0.5, -1.0], rtol=1e-5)
    np.testing.assert_allclose(found["return"], value)


@pytest.mark.parametrize("words", [{}, {"recurrent": True}, {"images": ("depth",)}, {"layers": 3, "private": 2}])
def test_a_parameter_has_one_owner(words):
    """The value alone depends on what the critic owns, and on all of that; the action on all else."""
    network = ActorCritic(8, **words)
    vector, images = jnp.linspace(-1.0, 1.0, 6), {"depth": jnp.full((16, 16), 2.0)}
    memory = jnp.full(network.memory_size, 0.3)
    inputs = vector, images if network.images else {}, memory, jnp.zeros((), bool)
    parameters = network.init(jax.random.key(0), *inputs)
    of = lambda name: jax.grad(  # noqa: E731
        lambda parameters: sum(part.sum() for part in [getattr(network.apply(parameters, *inputs), name)])
    )(parameters)
    moved = [jax.tree.map(lambda leaf: bool((leaf != 0).any()), of(name)) for name in ("mean", "log_std", "value")]
    owners = networks.owners(parameters)
    for owner, *by in zip(*map(jax.tree.leaves, (owners, *moved)), strict=True):
        assert owner == ("actor" if by[0] or by[1] else "critic") and any(by)


@pytest.mark.parametrize("owner", ["actor", "critic"])
def test_an_optimizer_of_shac_moves_its_own_part_alone(env, owner):
    network = ActorCritic(8, 1, recurrent=True)
    agent = begun(network, env)
    optimizer = {"actor": shac.ACTOR, "critic": shac.CRITIC}[owner]
    ones = jax.tree.map(jnp.ones_like, agent.parameters)
    rate = jnp.asarray(0.1)
    moved, _ = rollouts.apply_gradient(optimizer, rate, agent.parameters, optimizer.init(agent.parameters), ones)
    parts = map(jax.tree.leaves, (networks.owners(agent.parameters), agent.parameters, moved))
    for mine, old, new in zip(*parts, strict=True):
        assert bool((old != new).all() if mine == owner else (old == new).all())


def test_the_clip_of_one_does_not_shorten_the_steps_of_the_other(env):
    """A gradient of the critic a million times as large leaves the actor's step as it is."""
    network = ActorCritic(8, 1)
    agent = begun(network, env)
    owners = networks.owners(agent.parameters)

    def step_of_the_actor(size: float) -> list:
        sizes = {"actor": 1e-6, "critic": size}
        gradient = jax.tree.map(lambda owner, leaf: jnp.full_like(leaf, sizes[owner]), owners, agent.parameters)
        rate, optimizer = jnp.asarray(0.1), ppo.OPTIMIZER.init(agent.parameters)
        moved, _ = rollouts.apply_gradient(ppo.OPTIMIZER, rate, agent.parameters, optimizer, gradient)
        parts = zip(*map(jax.tree.leaves, (owners, moved)), strict=True)
        return [new for owner, new in parts if owner == "actor"]

    for one, other in zip(step_of_the_actor(1e-3), step_of_the_actor(1e3), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.night
def test_first_episodes_end_at_different_times():
    """Each row reaches the limit of 4 s by itself, after as many steps as were left; later episodes are whole."""
    env = registry.load("Lab-Random-RandomAbNav-v0", config_overrides={"people": 0, "time_limit": 4.0})
    env = jax.jit(mdp.Env.with_pool, static_argnums=2)(env, jax.random.key(0), 4)
    network, rows = ActorCritic(4, 1), 64

    @jax.jit
    def play(key):
        batch = rollouts.reset_envs((Stack(env, {}),), network, key, rows)
        batch = reinforcement.stagger((Stack(env, {}),), batch, jax.random.fold_in(key, 1))
        ages = batch.envs[0].simulation.tick

        def one(states, tick):
            keys = jax.random.split(jax.random.fold_in(key, tick), rows)
            _, states, _, _, truncated, info = jax.vmap(env.step)(keys, states, jnp.zeros((rows, 2)))
            return states, (truncated, info["episode_length"])

        return ages, jax.lax.scan(one, batch.envs[0], jnp.arange(80))[1]

    ages, (truncated, length) = jax.tree.map(np.asarray, play(jax.random.key(3)))
    assert ages.min() >= 0 and ages.max() <= 39 and len(np.unique(ages)) > 25
    first = truncated.argmax(0)
    np.testing.assert_array_equal(first, 39 - ages)
    np.testing.assert_array_equal(length[first, np.arange(rows)], 40 - ages)
    np.testing.assert_array_equal(length[first + 40, np.arange(rows)], 40)
    assert truncated[first + 40, np.arange(rows)].all() and truncated.sum() == 2 * rows
    assert truncated.sum(1).max() < 10


@pytest.mark.night
def test_the_critic_learns_alone_after_imitation(env):
    """In an update whose actor does not move; and the value of the network stays that of returns in their own unit."""
    config = options(None, observations=["goal"], rewards=["time"], epochs=1, minibatches=1)
    network = ActorCritic(8, 1)
    pooled = (jax.jit(rollouts.with_pool, static_argnums=2)(Stack(env, {}), jax.random.key(1), 8),)
    agent, numbers = begun(network, env), {name: jnp.asarray(0.01) for name in PPOConfig.SWEPT}

    @jax.jit
    def update(rate):
        batch = rollouts.reset_envs(pooled, network, jax.random.key(0), 8)
        own = numbers | {"actor_rate": rate}
        return ppo.update(config, own, pooled, network, agent, ppo.init(agent), batch, jax.random.key(2))[0]

    for rate, moves in ((0.0, False), (0.01, True)):
        parts = networks.owners(agent.parameters), agent.parameters, update(jnp.asarray(rate)).parameters
        for owner, old, new in zip(*map(jax.tree.leaves, parts), strict=True):
            assert bool((old != new).any()) == (moves or owner == "critic")


def test_a_value_is_scaled_and_nothing_else(env):
    network = ActorCritic(8, 2)
    agent, seen = begun(network, env), jnp.array([1.0, -2.0])
    larger = replace(agent, parameters=networks.scale_value(agent.parameters, jnp.asarray(3.0)))
    one, other = (networks.apply(network, each, seen, {}, jnp.zeros(0), jnp.ones((), bool)) for each in (agent, larger))
    np.testing.assert_allclose(other.value, 3.0 * one.value, rtol=1e-6)
    np.testing.assert_array_equal(other.mean, one.mean)


@pytest.fixture
def quiet(monkeypatch):
    """Trainings in which nobody moves."""
    monkeypatch.setattr(reinforcement, "programs", standing)
    monkeypatch.setattr(reinforcement, "draw_starts", lambda options, scenarios, envs: (envs, ()))


@pytest.mark.night
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_checkpoint_of_the_present_update(number, quiet, tmp_path, monkeypatch, capsys):
    """Between two evaluations; the same command goes on from there, and the exit code is that of the signal."""
    means = reinforcement._finite_means

    def send(values):
        calls.append(values)
        if len(calls) == 2 * 3:  # twice an update
            signal.raise_signal(number)
        return means(values)

    words = ["train", "ppo", "--environment", "lab", "--behavior", "random", "--people", "2", "--scenarios", "8",
             "--minibatches", "2", "--horizon", "8", "--steps", "384", "--width", "16", "--evaluate-every", "10",
             "--out", str(tmp_path / "run"), "--quiet"]  # fmt: skip
    for already in (0, 3):
        calls = []
        monkeypatch.setattr(reinforcement, "_finite_means", send)
        assert command_line.main(words) == {signal.SIGINT: 130, signal.SIGTERM: 143}[number]
        assert "the same command resumes" in " ".join(capsys.readouterr().err.split())
        if already == 0:
            assert [line["epoch"] for line in curve(tmp_path / "run")] == [1, 2, 3]
        assert sorted(path.name for path in (tmp_path / "run" / "checkpoints").iterdir())[-1] == str(already + 3)
    monkeypatch.setattr(reinforcement, "_finite_means", means)
    assert command_line.main(words) == 0 and [line["epoch"] for line in curve(tmp_path / "run")] == [1, 2, 3, 4, 5, 6]


CALLBACKS = """
seen = []

def log(line):
    seen.append(line)

def broken(line):
    return line["no such number"]
"""


@pytest.mark.night
def test_callbacks_get_each_line_of_the_log(quiet, tmp_path, capsys):
    """A function of Python, and one of a file, whose content is no part of the training: it may change."""
    (tmp_path / "my.py").write_text(CALLBACKS)
    lines, folder = [], tmp_path / "run"
    reinforcement.train(options(folder, callbacks=[lines.append, f"{tmp_path}/my.py:log"]))
    assert lines == [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert json.loads((folder / "config.json").read_text())["parts"] == {} and lines[0]["epoch"] == 1
    with pytest.raises(InputError, match=r"callback broken: .*my.py:8: .*no such number"):
        reinforcement.train(options(tmp_path / "other", callbacks=[f"{tmp_path}/my.py:broken"]))
    with pytest.raises(InputError, match="callbacks: 'nothing'"):
        reinforcement.train(options(tmp_path / "third", callbacks=["nothing"]))
    assert not (tmp_path / "third").exists()


@pytest.mark.slow
def test_an_error_of_a_callback_keeps_the_checkpoints(quiet, tmp_path):
    def broken(line):
        if line["epoch"] == 3:
            raise OSError("no network")

    config = options(tmp_path / "run", callbacks=[broken])
    with pytest.raises(InputError, match=r"callback broken: .*test_ppo.py:\d+: OSError: no network"):
        reinforcement.train(config)
    assert int(reinforcement.train(config.replace(callbacks=())).update) == 6
    assert [line["epoch"] for line in curve(tmp_path / "run")] == [1, 2, 3, 4, 5, 6]


@pytest.mark.night
def test_a_training_of_a_constant_learning_rate_goes_on_with_more_steps(quiet, tmp_path):
    for schedule in ("constant", "linear"):
        folder = tmp_path / schedule
        config = options(folder, learning_rate_schedule=schedule)
        reinforcement.train(config)
        longer = config.replace(steps=8 * 8 * 9)
        if schedule == "constant":
            assert int(reinforcement.train(longer).update) == 9
            assert [line["epoch"] for line in curve(folder)] == list(range(1, 10))
        else:
            with pytest.raises(InputError, match="with steps 384, not 576"):
                reinforcement.train(longer)


def test_steps_beyond_a_thousand_million():
    config = options(None, steps=10**12, scenarios=8192)
    assert config.updates == -(-(10**12) // (8192 * 8)) and config.updates < 2**31
    with pytest.raises(InputError, match="steps: .* make 15,625,000,000 updates, more than 2,147,483,647; take more"):
        options(None, steps=10**12)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["progress=2,time=-0.2"], {**rewards.DEFAULT, "progress": 2.0, "time": -0.2}),
        (["default,at_goal=0.5"], {**rewards.DEFAULT, "at_goal": 0.5}),
        (["progress,time=-0.2"], {"progress": 1.0, "time": -0.2}),
        (["progress,time"], {"progress": 1.0, "time": 1.0}),
        (["time=-3", "--reward", "my.py:gain"], {**rewards.DEFAULT, "time": -3.0, "gain": 1.0}),
        (["gain=4", "--reward", "my.py:gain"], {**rewards.DEFAULT, "gain": 4.0}),
    ],
)
def test_weights_of_rewards_on_the_command_line(words, wanted, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("my.py").write_text("def gain(scenario, before, after):\n    return after.robot.speed\n")
    given = ["ppo", "--environment", "lab", "--behavior", "random", "--people", "2", "--rewards", *words]
    config = flags.read(PPOConfig, flags.parse("train", PPOConfig, given, configurable=True), typed=True)
    terms = registry.plan_env(config.per_environment[0]).rewards
    assert {name: term.weight for name, term in terms.items()} == wanted
    again = flags.parse("train", PPOConfig, shlex.split(flags.command("train", config))[2:], configurable=True)
    assert flags.read(PPOConfig, again).identity() == config.identity()


FILE = """
environment: lab
behavior: {kind: random}
people: 2
rewards: [progress=2, time=-0.2]
scenarios: 10
minibatches: 5
seeds: 2
"""


def test_options_of_a_training_from_a_file(tmp_path, monkeypatch, capsys):
    """Flags override its values, and an option that is none is refused with the file."""
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(FILE)
    model = COMMANDS["train ppo"]

    def read(*words):
        given = ["ppo", "--config", "mine.yaml", *words]
        return command_line._read(model, flags.parse("train", model, given, configurable=True, trust=True))

    config = read("--seeds", "3", "--people", "4")
    assert (config.scenarios, config.minibatches, config.seeds, config.people) == (10, 5, 3, 4)
    assert config.reward_weights == {"progress": 2.0, "time": -0.2} and config.behavior.kind == "random"
    assert read("--rewards", "progress").reward_weights == {}
    for text, message in [("secnarios: 3\n", "mine.yaml: 'secnarios'"), ("clip: 3\n", "mine.yaml: clip: 3")]:
        Path("mine.yaml").write_text(FILE + text)
        assert command_line.main(["train", "ppo", "--config", "mine.yaml"]) == 2
        assert message in " ".join(capsys.readouterr().err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["mine.yaml"]


def test_a_pretrained_agent_that_does_not_fit_is_refused_first(trained, tmp_path, monkeypatch):
    """Before starts are drawn and anything is written: of another size, with other inputs, or without weights."""
    never = lambda *_: pytest.fail("it was built")  # noqa: E731
    monkeypatch.setattr(reinforcement, "programs", never)
    monkeypatch.setattr(reinforcement, "draw_starts", never)
    shutil.copytree(trained[1], tmp_path / "empty")
    shutil.rmtree(tmp_path / "empty" / "checkpoints")
    for folder, other, message in [
        (trained[1], {"width": 32}, "width 16, not 32"),
        (trained[1], {"observations": ["goal", "path"]}, "observations"),
        (tmp_path / "empty", {}, "no checkpoint"),
        (Path("ppo"), {}, "ppo has observations"),
    ]:
        with pytest.raises(InputError, match=message):
            reinforcement.train(options(tmp_path / "next", pretrained=folder, **other))
    assert not (tmp_path / "next").exists()


@pytest.mark.night
def test_a_stopped_training_goes_on_to_the_same_curve(learned, tmp_path, monkeypatch):
    """Stopped before and after checkpoints, it ends with the same numbers and the same agent."""
    folder = tmp_path / "run"
    for last in (1, 5):
        monkeypatch.setattr(reinforcement, "_finite_means", _until(reinforcement._finite_means, last))
        with pytest.raises(KeyboardInterrupt):
            reinforcement.train(options(folder))
        monkeypatch.undo()
    state = reinforcement.train(options(folder))
    assert curve(folder) == curve(learned[1])
    trees.assert_equal(state.agent, learned[0].agent)


def _until(numbers, last):
    """``reinforcement._finite_means``, called three times an update, until Ctrl-C in update ``last``."""
    calls = []

    def call(values):
        calls.append(values)
        if len(calls) == 3 * last:
            raise KeyboardInterrupt
        return numbers(values)

    return call


@pytest.mark.slow
def test_it_drives_as_it_was_evaluated(learned):
    """The policy of the folder, in ``evaluate``, and in an env step by step: the same commands."""
    _, folder = learned
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    driver = learning.load(folder, scenario)
    assert driver.name == folder.name
    _, recorded = jax.jit(sean_jax.rollout, static_argnums=3)(scenario, driver, jax.random.key(5), 10)
    env = replace(registry.build(options(folder)).member, scenario=scenario)
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(5))
    seen, envs = jax.jit(env.reset)(jax.random.key(0))
    envs = replace(envs, simulation=state)
    agent: Agent = driver.params.agent
    seen, _ = sean_jax.mdp.observations.begin(env.observations, scenario, state, jax.random.key(0))
    advance = jax.jit(env.advance)
    for tick in range(10):
        vector = sean_jax.mdp.flatten(env.observations, seen)
        said = networks.apply(driver.params.network, agent, vector, {}, jnp.zeros(0), jnp.zeros((), bool))
        envs, seen, *_, info = advance(envs, said.mean)
        np.testing.assert_allclose(info["command"], recorded.action[tick], atol=1e-4)


@pytest.mark.night
def test_it_learns_to_go_to_the_goal(tmp_path):
    """From nothing to half of the tasks, alone in the lab, in some 300,000 steps."""
    config = options(
        tmp_path / "run", people=0, time_limit=40.0, scenarios=64, horizon=32, minibatches=4, epochs=4, width=64,
        steps=400_000, evaluate_every=100, evaluation_episodes=32, task_distance=(2.0, 4.0), pool=256, hold_time=1.0,
        observations=["goal", "path", "distance", "speeds"], rewards=["default"], metrics=["path_length"],
    )  # fmt: skip
    reinforcement.train(config)
    found = [line["evaluation"]["completed"] for line in curve(tmp_path / "run") if "evaluation" in line]
    assert max(found) > 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["train"], "train: '' is not one of imitation, dagger, ppo, apg"),
        (["train", "poo"], "did you mean 'ppo'"),
        (["train", "ppo", "--scenarios", "10", "--minibatches", "4"], "10 scenarios do not make 4 minibatches"),
        (["train", "ppo", "--environment", "lab", "--behavior", "random", "--observations", "gaol"], "gaol"),
        (["train", "ppo", "--discount", "1.5"], "--discount"),
        (
            ["train", "ppo", "--environment", "lab,outdoor,warehouse"],
            "64 do not divide equally among 3 environments",
        ),
        (["train", "ppo", "--environment", "lab,outdoor", "--curriculum", "regret"], "not of lab,outdoor; choose one"),
        (["train", "ppo", "--environment", "lab,labb"], "labb"),
    ],
)
def test_bad_words(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command_line.main(words) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


OWN = """
import jax

def slower(key, scenario):
    share = jax.random.uniform(key, (), float, 0.5, 1.0)
    return scenario.replace(robot=scenario.robot.replace(max_speed=share * scenario.robot.max_speed))

def backward(scenario, before, after):
    return after.robot.speed < -0.05

def smaller(key, scenario):
    return scenario.replace(goal_radius=scenario.goal_radius * scenario.task_distance)

def nothing(key, scenario):
    return None
"""


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    file = tmp_path_factory.mktemp("own") / "mine.py"
    file.write_text(OWN)
    return file


def varied(out, mine, **others) -> PPOConfig:
    ends = ["obstacle", f"{mine}:backward"]
    return options(out, terminations=ends, randomization=f"{mine}:slower", action_delay=(1, 2), **others)


@pytest.mark.slow
def test_randomization_delay_and_ends_reach_the_environment_of_a_training(mine, tmp_path):
    _, (floors,), _ = reinforcement.build(varied(tmp_path, mine))
    env = floors.member
    assert [name for name, _ in env.terminations] == ["obstacle", "backward"] and env.action_delay == (1, 2)
    assert env.randomization is not None
    keys = jax.random.split(jax.random.key(0), 32)
    drawn = jax.vmap(lambda key: env.scenario_of(key).robot.max_speed)(keys) / env.scenario.robot.max_speed
    assert drawn.min() < 0.6 and drawn.max() > 0.9
    (_, (floors,), _) = reinforcement.build(options(tmp_path, randomization="behavior", action_delay=3))
    usual = floors.member
    assert usual.randomization == mdp.RANDOMIZATIONS["behavior"] and usual.action_delay == (3, 3)


@pytest.mark.parametrize(
    ("name", "text"),
    [("smaller", r"gives goal_radius of shape \(2,\), not \(\)"), ("nothing", "gives None, not a Scenario")],
)
def test_a_randomization_that_gives_something_else_is_refused(mine, name, text, tmp_path):
    with pytest.raises(InputError, match=f"randomization: .*{text}"):
        reinforcement.build(options(tmp_path, randomization=f"{mine}:{name}"))


@pytest.mark.night
def test_a_training_with_randomization_delay_and_own_ends_goes_on(mine, tmp_path):
    half, whole = tmp_path / "half", tmp_path / "whole"
    reinforcement.train(varied(whole, mine))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reinforcement.trainer, "must_stop", lambda done: done == 3)
        with pytest.raises(KeyboardInterrupt):
            reinforcement.train(varied(half, mine))
    reinforcement.train(varied(half, mine))
    assert [line["train"] for line in curve(half)] == [line["train"] for line in curve(whole)]
    with pytest.raises(InputError, match="randomization"):
        reinforcement.train(options(half, terminations=["obstacle", f"{mine}:backward"], action_delay=(1, 2)))


@pytest.mark.night
@pytest.mark.parametrize("of_package", [False, True])
def test_it_goes_on_with_another_agent(learned, tmp_path, of_package):
    folder, other = learned[1], {}
    if of_package:
        saved = json.loads((AGENTS["ppo"] / "config.json").read_text())
        folder, other = "ppo", {name: saved[name] for name in ("observations", "width", "layers")}
    same = {"learning_rate": 1e-12, "steps": 8 * 8, "evaluate_every": 1}
    config = options(tmp_path / "next", pretrained=folder, **same, **other)
    agent = reinforcement.train(config).agent
    best = learning.load(folder, registry.build(config).member.scenario).params.agent
    for one, other in zip(*map(jax.tree.leaves, (agent.parameters, best.parameters)), strict=True):
        np.testing.assert_allclose(one[0], other, atol=1e-6)
    if of_package:
        return
    with pytest.raises(InputError, match="width 16, not 32"):
        reinforcement.train(options(tmp_path / "wide", pretrained=folder, width=32))
    with pytest.raises(InputError, match="no trained agent"):
        reinforcement.train(options(tmp_path / "none", pretrained=tmp_path))


def test_other_options_are_refused_in_its_folder(trained):
    with pytest.raises(InputError, match="discount"):
        reinforcement.train(options(trained[1], discount=0.5))


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


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    """Two seeds and two learning rates side by side, with a critic that sees more."""
    folder = tmp_path_factory.mktemp("ppo") / "several"
    return reinforcement.train(options(folder, **SEVERAL)), folder


SEVERAL = dict(seeds=2, seed=3, sweep=["learning_rate=1e-3,1e-5"], critic=["people"], steps=8 * 8 * 2)


@pytest.mark.night
def test_agents_side_by_side_are_those_that_would_be_trained_alone(several, tmp_path):
    state, folder = several
    assert [agent["seed"] for agent in options(folder, **SEVERAL).agents] == [3, 4, 3, 4]
    assert state.agent.statistics.mean.shape[0] == 4
    alone = reinforcement.train(
        options(tmp_path / "alone", **(SEVERAL | dict(seeds=1, seed=4, sweep=[], learning_rate=1e-5)))
    )
    last = jax.tree.map(lambda part: part[3], state.agent.parameters)
    pairs = zip(jax.tree.leaves(last), jax.tree.leaves(alone.agent.parameters), strict=True)
    assert max(np.abs(one - other[0]).max() for one, other in pairs) < 1e-3  # of another pool, from the same weights
    line = curve(folder)[-1]
    assert {"agent 0", "agent 3", "evaluation"} <= set(line)
    returns = [line[f"agent {number}"]["return"] for number in range(4)]
    assert line["evaluation"]["return"] == pytest.approx(np.mean(returns), abs=1e-4)
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    driver = learning.load(folder, scenario)
    best = jax.tree.map(lambda part: part[int(state.best.value.argmax())], state.best.agent)
    trees.assert_equal(driver.params.agent, best)


@pytest.mark.slow
def test_what_the_critic_alone_sees_never_reaches_the_actor(several):
    _, folder = several
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    driver = learning.load(folder, scenario).params
    private = driver.network.private
    assert private == 12 * 5
    key = jax.random.key(0)
    vector = jax.random.normal(key, (4 + private,))
    other = vector.at[4:].set(jax.random.normal(jax.random.key(1), (private,)))
    say = lambda numbers: networks.apply(  # noqa: E731
        driver.network, driver.agent, numbers, {}, jnp.zeros(0), jnp.ones((), bool)
    )
    assert jnp.array_equal(say(vector).mean, say(other).mean)
    assert float(say(vector).value) != float(say(other).value)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sweep", "width=3,4"], "'width' cannot be swept"),
        (["--sweep", "clip=0.1,many"], "sweep: clip=0.1,many must be numbers"),
        (["--sweep", "clip=0.1,7"], "sweep: clip=0.1,7 must be numbers"),
        (["--sweep", "clip=0.1", "--sweep", "entropy=0"], "--sweep is repeated; give it once"),
        (["--sweep", "rewards.time=inf"], "sweep: rewards.time=inf must be numbers"),
        (["--rewards", "tine=1"], "rewards: 'tine' is not one of progress"),
        (["--rewards", "time=many"], "--rewards: time=many has no number as the weight; write time=2"),
        (["--rewards", "time=1,time=2"], "--rewards: 'time' is listed twice"),
        (["--callback", "none.py:log"], "none.py: there is no such file"),
        (["--sweep", "rewards.tine=1"], "rewards: 'tine' is not one of progress"),
        (["--critic", "depth"], "critic: depth is an image"),
        (["--critic", "goal"], "critic: goal is already an observation of the actor"),
    ],
)
def test_bad_agents(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (
        command_line.main(["train", "ppo", "--environment", "lab", "--behavior", "random", "--people", "2", *words])
        == 2
    )
    assert message in " ".join(capsys.readouterr().err.split())


@pytest.mark.night
def test_analytic_gradients_are_those_of_differences():
    """The derivative of what an actor gets in some steps by a weight of its last layer, in people that are held."""
    from sean_jax.learning import shac

    config = analytic(None, horizon=4, scenarios=2)
    _, (env,), network = reinforcement.build(config)
    env = jax.jit(rollouts.with_pool, static_argnums=2)(env, jax.random.key(1), 4)
    env, member = env.map_member(mdp.Env.with_transition_gradients), env.member
    agent = networks.init_agent(network, member.observations, member.observation_space, jax.random.key(2))
    rows = jax.jit(rollouts.reset_envs, static_argnums=(1, 3))((env,), network, jax.random.key(3), 2)

    def lost(change):
        last = f"Dense_{2 * config.layers}"
        parameters = jax.tree.map(lambda leaf: leaf, agent.parameters)
        bias = parameters["params"][last]["bias"]
        parameters["params"][last]["bias"] = bias.at[0].add(change)
        acting = replace(agent, parameters=parameters)
        horizon = shac.Horizon((env,), network, agent, rows, 4, jax.random.key(4), jnp.asarray(0.99))
        return shac._actor_loss(horizon, acting)[0]

    found = jax.jit(jax.grad(lost))(0.3)
    step = 1e-3  # at 1e-2 limits of the robot come in between
    wanted = (jax.jit(lost)(0.3 + step) - jax.jit(lost)(0.3 - step)) / (2 * step)
    assert float(found) == pytest.approx(float(wanted), rel=0.05, abs=1e-4) and float(found) != 0.0


@pytest.mark.night
def test_an_agent_begins_as_the_policy_that_it_imitates(tmp_path):
    """In a lab without people it acts as ``go_to_goal`` does, before any reward: most of its tasks are completed."""
    config = options(
        tmp_path / "run", people=0, time_limit=40.0, scenarios=32, horizon=32, minibatches=4, width=64, pool=64,
        steps=1, evaluate_every=1, evaluation_episodes=32, task_distance=(2.0, 4.0), hold_time=1.0, learning_rate=1e-3,
        observations=["goal", "path", "distance", "speeds"], imitate="go_to_goal",
    )  # fmt: skip
    state = reinforcement.train(config)
    assert int(state.update) == 1
    assert curve(tmp_path / "run")[-1]["evaluation"]["completed"] > 0.6
    with pytest.raises(InputError, match="imitate: 'nobody'"):
        reinforcement.build(options(tmp_path / "other", imitate="nobody"))


@pytest.mark.night
def test_apg_trains_and_goes_on_from_ppo(learned, tmp_path):
    config = analytic(tmp_path / "apg", pretrained=learned[1], steps=8 * 8 * 3)
    state = reinforcement.train(config)
    assert int(state.update) == 3 and np.isfinite(float(state.best.value[0]))
    lines = curve(tmp_path / "apg")
    assert all(line["train"]["lost"] == 0.0 and line["train"]["gradient"] > 0.0 for line in lines)
    assert learning.load(tmp_path / "apg", registry.build(config).member.scenario).name == "apg"


def test_a_packed_agent_drives_as_its_training(trained, tmp_path, capsys):
    """Its commands are those of the checkpoint but for the rounding of the weights to 16 bits."""
    folder, out = trained[1], tmp_path / "small"
    assert command_line.main(["export", "agent", str(folder), "--out", str(out), "--quiet"]) == 0
    assert {path.name for path in out.iterdir()} == {"config.json", "weights.npz"}
    told = json.loads((out / "config.json").read_text())
    best = max(curve(folder)[1::2], key=lambda line: line["evaluation"]["return"])
    assert told["agent"]["steps"] == best["steps"] and told["width"] == 16
    assert told["agent"]["evaluation"]["return"] == best["evaluation"]["return"]
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    drivers = [learning.load(each, scenario) for each in (folder, out)]
    seen, driven = jnp.array([1.0, -2.0, 0.3, 0.5]), []
    for driver in drivers:
        said = networks.apply(driver.params.network, driver.params.agent, seen, {}, jnp.zeros(0), jnp.ones((), bool))
        driven.append(said.mean)
    assert drivers[1].name == "small" and drivers[0].apply is drivers[1].apply
    assert 0 < np.abs(driven[0] - driven[1]).max() + 1e-9 < 1e-3
    with pytest.raises(InputError, match="packed already"):
        learning.pack(out, tmp_path / "again")
    with pytest.raises(InputError, match="not empty"):
        learning.pack(folder, out)


WITH_HELPER = """import jax.numpy as jnp
import helper
from sean_jax.mdp.rewards import RewardTerm

seen = lambda scenario, state: helper.scale * state.robot.position
near = RewardTerm(lambda scenario, before, after: after.robot.speed, weight=1000.0)
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A training with an observation and a reward of files of one's own, and a folder that has them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(reinforcement, "programs", standing)
    monkeypatch.setattr(reinforcement, "draw_starts", lambda options, scenarios, envs: (envs, ()))
    (tmp_path / "mine.py").write_text(WITH_HELPER)
    (tmp_path / "helper.py").write_text("scale = 0.1\n")
    parts = {"observations": ["goal", "mine.py:seen"], "rewards": ["progress", "mine.py:near"]}
    reinforcement.train(options(tmp_path / "trained", **parts))
    return parts


@pytest.mark.night
def test_a_training_goes_on_with_the_same_own_files_alone(own, tmp_path):
    kept = (tmp_path / "trained" / "config.json").read_bytes()
    assert set(json.loads(kept)["parts"]) == {"mine.py", "helper.py"}
    for file, old, new in [("mine.py", "1000.0", "1.0"), ("helper.py", "0.1", "0.2"), ("mine.py", "", "# as it was")]:
        text = (tmp_path / file).read_text()
        (tmp_path / file).write_text(text.replace(old, new) if old else text + new)
        with pytest.raises(InputError, match=f"trained was begun with another {file}; ask for the same or choose"):
            reinforcement.train(options(tmp_path / "trained", **own))
        with pytest.raises(InputError, match=f"{file}: is not the file that .*config.json was made with; restore"):
            learning.pack(tmp_path / "trained", tmp_path / "packed")
        (tmp_path / file).write_text(text)
    reinforcement.train(options(tmp_path / "trained", **own))
    assert (tmp_path / "trained" / "config.json").read_bytes() == kept and not (tmp_path / "packed").exists()


@pytest.mark.night
def test_a_packed_agent_has_its_own_files_with_it(own, tmp_path, monkeypatch, capsys):
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    with pytest.raises(InputError, match="mine.py:seen is code, and trained/config.json names it, not you"):
        learning.pack("trained", "packed")
    assert command_line.main(["export", "agent", "trained", "--out", "packed", "--trust"]) == 0
    assert "next: sean run --policy ./packed --trust" in capsys.readouterr().out
    names = {path.relative_to("packed").as_posix() for path in Path("packed").rglob("*.*")}
    assert names == {"config.json", "weights.npz", "parts/mine.py", "parts/helper.py"}
    with sean_jax.trust():
        expected = learning.load("trained", scenario).params.agent.statistics.mean
    away = tmp_path / "away"
    away.mkdir()
    shutil.move("packed", away / "packed")
    for file in ("mine.py", "helper.py"):
        (tmp_path / file).unlink()
    monkeypatch.chdir(away)
    with sean_jax.trust():
        driver = learning.load("packed", scenario)
    np.testing.assert_array_equal(driver.params.agent.statistics.mean, expected)
    state = SimpleNamespace(robot=SimpleNamespace(position=jnp.array([3.0, -2.0])))
    np.testing.assert_allclose(dict(driver.params.terms)["seen"].read(scenario, state, ()), [0.3, -0.2], rtol=1e-6)
    (away / "packed" / "parts" / "helper.py").write_text("scale = 0.3\n")
    with pytest.raises(InputError, match="parts/helper.py: is not the file that packed/config.json was made with"):
        learning.load("packed", scenario)


def test_a_training_that_saw_something_else_is_refused(trained, tmp_path):
    """Of this folder the observation is changed, as if a term gave other numbers than when it was trained."""
    shutil.copytree(trained[1], tmp_path / "other")
    file = tmp_path / "other" / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"observations": ["goal", "situations"]}))
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin")
    with pytest.raises(InputError, match="sees 4 numbers, and this scenario shows 7 .goal, situations.; make"):
        learning.load(tmp_path / "other", scenario)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A room of 8 by 6 m, to train in beside the lab."""
    return room(tmp_path_factory.mktemp("places") / "cell", (0, 0, 8, 6), [box((6, 3), (0.3, 0.3))], name="cell")


def test_scenarios_of_environments_take_turns():
    rows = {"row": jnp.arange(12).reshape(6, 2), "keys": jax.random.split(jax.random.key(0), 6)}
    parts = rollouts.split_by_env(rows, 3)
    assert [part["row"][:, 0].tolist() for part in parts] == [[0, 6], [2, 8], [4, 10]]
    again = rollouts.merge_envs(parts)
    assert jnp.array_equal(again["row"], rows["row"]) and bool((again["keys"] == rows["keys"]).all())


def test_environments_that_do_not_go_together_are_refused(cell, tmp_path):
    with pytest.raises(InputError, match="environment: 'lab' is listed twice"):
        reinforcement.build(options(None, environment="lab,lab"))
    file = tmp_path / "mine.py"
    file.write_text("def crowd(scenario, state):\n    return state.pedestrians.position[:, 0]\n")
    config = options(None, environment=f"lab,{cell}", people=None, observations=["goal", f"{file}:crowd"])
    with pytest.raises(InputError, match=r"cell shows crowd of the size \(1,\), and lab \([0-9]+,\); leave it out"):
        reinforcement.build(config)


@pytest.mark.night
def test_one_agent_learns_in_several_environments(cell, tmp_path, monkeypatch):
    """Stopped and given again, with two seeds: it sees each place as it is, is judged in each, and drives in each."""
    config = options(tmp_path / "run", environment=f"lab,{cell}", seeds=2, steps=8 * 8 * 4)
    assert config.replace(out=None).folder.name == "ppo-lab-cell-random-0"
    numbers, told = reinforcement._finite_means, []

    def until(values):
        told.append(numbers(values))
        if len(told) == 3 * 3:  # of the third update, whose line is not written yet
            raise KeyboardInterrupt
        return told[-1]

    monkeypatch.setattr(reinforcement, "_finite_means", until)
    with pytest.raises(KeyboardInterrupt):
        reinforcement.train(config)
    monkeypatch.undo()
    state, lines = reinforcement.train(config), curve(tmp_path / "run")
    assert [line["epoch"] for line in lines] == [1, 2, 3, 4]
    assert all(part in lines[2].values() for part in told[6:])

    scenarios, envs, _ = reinforcement.build(config)
    np.testing.assert_allclose(state.agent.statistics.count, 8 * 8 * 4, atol=0.01)  # learned from all
    of_one = jax.tree.map(lambda leaf: leaf[1], state.rows)  # of the agents
    look = jax.jit(jax.vmap(mdp.observations.begin, (None, None, 0, 0)), static_argnums=0)
    for number, seen in enumerate(rollouts.split_by_env(of_one.observation, 2)):
        there = of_one.envs[number].simulation
        now, _ = look(envs[number].member.observations, scenarios[number], there, there.streams.sensors)
        assert now["goal"].shape == (4, 2)
        np.testing.assert_allclose(now["goal"], seen["goal"], atol=1e-5)
    inside = np.asarray(state.rows.envs[1].simulation.robot.position)
    assert ((inside > 0.0) & (inside < [8.0, 6.0])).all()

    last, judged = lines[-1], [line for line in lines if "evaluation" in line]
    returns = [last[f"evaluation in {name}"]["return"] for name in ("lab", "cell")]
    assert returns[0] != returns[1]
    of_agents = [last[f"agent {number}"]["return"] for number in range(2)]
    for each in (returns, of_agents):
        assert last["evaluation"]["return"] == pytest.approx(np.mean(each), abs=1e-5)
    for number, value in enumerate(state.best.value):
        assert float(value) == pytest.approx(max(line[f"agent {number}"]["return"] for line in judged), abs=1e-5)

    learning.pack(tmp_path / "run", tmp_path / "packed")
    for scenario in scenarios:
        drive = jax.jit(sean_jax.rollout, static_argnums=3)
        ways = []
        for folder in ("run", "packed"):
            driver = learning.load(tmp_path / folder, scenario)
            ways.append(drive(scenario, driver, jax.random.key(0), 5)[0].robot.position)
        np.testing.assert_allclose(*ways, atol=1e-2)


@pytest.mark.night
def test_all_ways_to_learn_know_several_environments(cell, tmp_path):
    """Imitation at first, and then derivatives, of both."""
    config = analytic(
        tmp_path / "run", environment=f"lab,{cell}", imitate="go_to_goal", steps=8 * 8, learning_rate=1e-3
    )
    state = reinforcement.train(config)
    line = curve(tmp_path / "run")[-1]
    assert int(state.update) == 1 and line["train"]["gradient"] > 0.0 and line["train"]["lost"] == 0.0
    assert {"evaluation in lab", "evaluation in cell"} <= set(line)

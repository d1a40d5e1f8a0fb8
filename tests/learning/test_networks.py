"""Networks of agents: attention over people, convolutions, the user's own, and squashed actions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import sean_jax
from sean_jax import learning, registry
from sean_jax.config import APGConfig, PPOConfig, user_parts
from sean_jax.core.errors import InputError, PartError
from sean_jax.learning import networks, reinforcement
from sean_jax.learning.networks import AttentionEncoder, ConvEncoder, NetworkOutput
from sean_jax.learning.policy import agent_network, check_policy, load_policy, save_agent
from sean_jax.simulation import episodes

SMALL = dict(
    environment="lab", behavior="random", people=3, time_limit=4.0, scenarios=4, horizon=4, minibatches=2, width=16,
    pool=4, evaluate_every=1, evaluation_episodes=2, steps=4 * 4, metrics=["mean_speed"],
    observations=["goal", "speeds", "people"], rewards=["progress", "time"],
)  # fmt: skip
OWN = """
import jax.numpy as jnp
from flax import linen as nn


class Net(nn.Module):
    width: int = 8

    @nn.compact
    def __call__(self, observation):
        people = nn.relu(nn.Dense(self.width)(observation["people"]))
        crowd = jnp.where(observation["people"][:, -1:] > 0.5, people, 0.0).max(0)
        return jnp.concatenate([observation["goal"], observation["speeds"], crowd])


class Pair(nn.Module):
    @nn.compact
    def __call__(self, observation):
        return nn.Dense(2)(observation["goal"]), jnp.zeros(())


class Misspelt(nn.Module):
    @nn.compact
    def __call__(self, observation):
        return nn.Dense(2)(observation["gaol"])


class Batched(nn.Module):
    @nn.compact
    def __call__(self, observation):
        return nn.Dense(2)(observation["goal"]).sum(1)


class Normed(nn.Module):
    @nn.compact
    def __call__(self, observation):
        return nn.BatchNorm(use_running_average=False)(observation["people"]).reshape(-1)


class Listed(nn.Module):
    sizes: list = None

    @nn.compact
    def __call__(self, observation):
        return observation["goal"]


class Needs(nn.Module):
    width: int

    @nn.compact
    def __call__(self, observation):
        return nn.Dense(self.width)(observation["goal"])


def function(observation):
    return observation["goal"]


listed = Listed([3])
"""


def options(out=None, **others) -> PPOConfig:
    return PPOConfig(**{"method": "ppo", **SMALL, "epochs": 2, "out": out, **others})  # pyright: ignore


def crowd(present: list[int], seed: int = 0) -> dict[str, jax.Array]:
    rng = np.random.default_rng(seed)
    rows = rng.normal(0.0, 3.0, (len(present), 5)).astype(np.float32)
    rows[:, -1] = present
    return {"goal": jnp.asarray(rng.normal(size=2), jnp.float32), "people": jnp.asarray(rows)}


@pytest.fixture(scope="module")
def attention():
    encoder = AttentionEncoder(8, (), ("people",), jnp.float32)
    return encoder, jax.jit(encoder.init)(jax.random.key(0), crowd([1, 1, 0, 1, 0])), jax.jit(encoder.apply)


# ------------------------------------------------------------------ attention over people


def test_attention_is_that_of_a_plain_loop(attention):
    """In float64, person by person."""
    encoder, variables, apply = attention
    seen = crowd([1, 0, 1, 1, 0])
    inner = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), variables["params"]["PeopleAttention_0"])
    dense = lambda number, x: x @ inner[f"Dense_{number}"]["kernel"] + inner[f"Dense_{number}"]["bias"]  # noqa: E731
    rows, goal = np.asarray(seen["people"], np.float64), np.asarray(seen["goal"], np.float64)
    heads, size = networks.HEADS, networks.EMBEDDING // networks.HEADS
    asked, total, weight = dense(4, goal).reshape(heads, size), np.zeros((heads, size)), np.zeros(heads)
    for row in rows[rows[:, -1] == 1]:
        hidden = np.maximum(dense(1, np.maximum(dense(0, row / 8.0), 0.0)), 0.0)
        share = np.exp((dense(2, hidden).reshape(heads, size) * asked).sum(1) / np.sqrt(size))
        total, weight = total + share[:, None] * dense(3, hidden).reshape(heads, size), weight + share
    expected = np.concatenate([goal, (total / weight[:, None]).ravel()])
    np.testing.assert_allclose(apply(variables, seen), expected, rtol=1e-4, atol=1e-5)


def test_the_order_of_people_does_not_matter(attention):
    _, variables, apply = attention
    seen = crowd([1, 0, 1, 1, 0])
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(5)
        found = apply(variables, seen | {"people": seen["people"][order]})
        np.testing.assert_allclose(found, apply(variables, seen), rtol=1e-5, atol=1e-6)


def test_absent_people_have_no_effect_at_all(attention):
    """Whatever their numbers are, and however many they are; but those present have."""
    encoder, variables, apply = attention
    seen = crowd([1, 1, 0, 1, 0])
    rows = seen["people"]
    for other in (1e6, jnp.nan):
        changed = seen | {"people": rows.at[jnp.array([2, 4]), :4].set(other)}
        np.testing.assert_array_equal(apply(variables, changed), apply(variables, seen))
    few = encoder.apply(variables, seen | {"people": rows[jnp.array([0, 1, 3])]})
    np.testing.assert_allclose(few, apply(variables, seen), rtol=1e-5, atol=1e-6)
    moved = apply(variables, seen | {"people": rows.at[3, 0].add(1.0)})
    assert float(jnp.abs(moved - apply(variables, seen)).max()) > 1e-3


def test_nobody_gives_nothing_and_finite_gradients(attention):
    _, variables, apply = attention
    for present in ([0] * 5, [0, 0, 1, 0, 0], [1] * 5):
        seen = crowd(present)
        found = apply(variables, seen)
        assert bool((found[2:] == 0.0).all()) == (not any(present))
        slopes = jax.grad(lambda variables, seen: (apply(variables, seen) ** 2).sum(), (0, 1))(variables, seen)
        assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(slopes))


def test_readings_of_several_times_are_attended_to_each_by_itself(attention):
    encoder, variables, _ = attention
    one, other = crowd([1, 1, 0, 1, 0]), crowd([0, 1, 1, 0, 0], 1)
    both = one | {"people": jnp.stack([one["people"], other["people"]])}
    found = encoder.apply(variables, both)
    expected = [encoder.apply(variables, one), encoder.apply(variables, one | {"people": other["people"]})[2:]]
    np.testing.assert_allclose(found, jnp.concatenate(expected), rtol=1e-6)


# ------------------------------------------------------------------ in the agent


def described(kind: str, **others):
    """A network of options, an agent, and an observation of three scenarios."""
    config = options(network=kind, **others)
    env = registry.build(config).member
    network = agent_network(config, env.observation_space)
    agent = jax.jit(lambda key: networks.init_agent(network, env.observations, env.observation_space, key))(
        jax.random.key(0)
    )
    seen, _ = jax.vmap(env.reset)(jax.random.split(jax.random.key(1), 3))
    return env, network, agent, seen


def say(env, network, agent, seen) -> NetworkOutput:
    flat = jax.vmap(lambda each: sean_jax.mdp.flatten(env.observations, each))(seen).astype(jnp.float32)
    number = flat.shape[0]
    images = {name: seen[name] for name in network.images}
    return networks.apply(
        network, agent, flat, images, jnp.zeros((number, network.memory_size)), jnp.ones(number, bool)
    )


@pytest.mark.night
@pytest.mark.parametrize("recurrent", [False, True])
def test_an_agent_sees_people_in_any_order(recurrent):
    """Also after it has seen others in the first row than in the last, so their statistics differ."""
    env, network, agent, seen = described("attention", recurrent=recurrent)
    mean = jnp.arange(agent.statistics.mean.shape[0], dtype=jnp.float32)
    agent = agent.replace(statistics=agent.statistics.replace(mean=0.1 * mean, variance=1.0 + mean))
    flipped = seen | {"people": seen["people"][:, ::-1]}
    for one, other in zip(say(env, network, agent, seen)[:4], say(env, network, agent, flipped)[:4], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.bfloat16])
def test_convolutions_see_all_of_an_image(dtype):
    """Each part of it has an effect, and colors are taken as they are."""
    encoder = ConvEncoder(16, ("depth",), dtype)
    for shape in ((48, 64), (48, 64, 3), (20, 31)):
        image = jax.random.uniform(jax.random.key(0), shape, jnp.float32, 0.0, 1.0)
        seen = {"goal": jnp.ones(2), "depth": image}
        found, variables = encoder.init_with_output(jax.random.key(1), seen)
        loss = jax.grad(lambda seen, variables: (encoder.apply(variables, seen) ** 2).sum())
        slope = loss(seen, variables)["depth"]
        assert found.shape == (18,) and found.dtype == jnp.float32 and bool(jnp.isfinite(slope).all())
        share = (jnp.abs(slope.reshape(*shape[:2], -1)).sum(-1) > 0.0).mean()
        assert float(share) > 0.9


def test_networks_for_other_observations_are_refused():
    for kind, seen, message in (
        ("conv", ["goal"], "conv is for images, and none is observed"),
        ("attention", ["goal"], "needs observations of people and others"),
        ("attention", ["people"], "needs observations of people and others"),
        ("attentive", ["goal"], "'attentive' is not one of mlp, attention, conv"),
    ):
        config = options(network=kind, observations=seen)
        env = registry.build(config).member
        with pytest.raises(InputError, match=f"network: .*{message}"):
            agent_network(config, env.observation_space)


# ------------------------------------------------------------------ the user's own


@pytest.fixture
def mine(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    return "mine.py"


@pytest.mark.slow
def test_an_own_network_takes_one_observation_and_people_as_they_are(mine):
    env, network, agent, seen = described(f"{mine}:Net")
    assert agent.parameters["params"]["encoder"]["Dense_0"]["kernel"].shape == (5, 8)
    assert agent.parameters["params"]["Dense_0"]["kernel"].shape == (2 + 2 + 8, 16)
    found = say(env, network, agent, seen)
    assert found.mean.shape == (3, 2) and found.value.shape == (3,)
    far = seen | {"people": seen["people"].at[..., -1].set(0.0)}
    other = seen | {"people": jnp.zeros_like(seen["people"])}
    np.testing.assert_array_equal(say(env, network, agent, far).mean, say(env, network, agent, other).mean)
    wider = options(network={"kind": f"{mine}:Net", "width": 4})
    assert agent_network(wider, env.observation_space).encoder.width == 4


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Pair", r"mine.py:\d+: Pair gives a tuple of 2, not float32 \(features,\); give the features of one observ"),
        ("Misspelt", r"mine.py:\d+: KeyError: 'gaol'"),
        ("Batched", r"mine.py:\d+: .*"),
        ("Normed", r"mine.py:\d+: Normed gives batch_stats, not parameters alone; leave out layers with a state"),
        ("listed", "listed has a field that cannot be hashed; give a tuple for a list"),
        ("Needs", "Needs cannot be made: .*width.*; give its fields defaults"),
        ("function", "function is a function, not a module of flax.linen; give a class"),
        ("Nest", "mine.py has no 'Nest'"),
    ],
)
def test_a_wrong_own_network_is_refused(mine, name, message):
    config = options(network=f"{mine}:{name}")
    env = registry.build(config).member
    with pytest.raises((InputError, PartError), match=f"^network: {message}"):
        agent_network(config, env.observation_space)


@pytest.mark.slow
def test_an_agent_with_an_own_network_is_loaded_from_its_folder(mine, tmp_path):
    """Its config.json names the file, which runs if it is trusted, and must be the same."""
    config = options(network={"kind": f"{mine}:Net", "width": 4}, distribution="squashed")
    env, network, agent, _ = described({"kind": f"{mine}:Net", "width": 4}, distribution="squashed")
    folder = tmp_path / "run"
    folder.mkdir()
    save_agent(folder, agent, {**config.identity(), "method": "ppo", "parts": user_parts.digests(config)})
    with pytest.raises(InputError, match="network: mine.py:Net is code, and run/config.json names it, not you"):
        check_policy("run", config)
    with sean_jax.trust():
        driver = load_policy("run", env.scenario)
        assert driver.params.network == network and driver.params.network.squashed

        def drive(key):
            state = episodes.init_policy(env.scenario, driver, sean_jax.reset(env.scenario, key))
            return episodes.policy_step(env.scenario, driver, state)[1]

        command = jax.eval_shape(drive, jax.random.key(0))
        assert command.shape == (2,)
        text = (tmp_path / mine).read_text()
        (tmp_path / mine).write_text(text.replace("width: int = 8", "width: int = 9"))
        with pytest.raises(InputError, match="mine.py: is not the file that run/config.json was made with"):
            load_policy("run", env.scenario)
        (tmp_path / mine).unlink()
        with pytest.raises(InputError, match="mine.py"):
            load_policy("run", env.scenario)


@pytest.mark.night
@pytest.mark.parametrize("method", ["ppo", "apg", "imitate"])
@pytest.mark.parametrize("kind", ["own", "attention"])
def test_agents_with_other_networks_learn_and_drive(mine, tmp_path, method, kind):
    """An update of each method, its checkpoint, and the packed agent."""
    network = f"{mine}:Net" if kind == "own" else kind
    more = {"imitate": "go_to_goal"} if method == "imitate" else {}
    config = options(tmp_path / "run", network=network, distribution="squashed", **more)
    if method == "apg":
        config = APGConfig(**SMALL, method="apg", network=network, recurrent=True, out=tmp_path / "run")  # pyright: ignore
    state = reinforcement.train(config)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(state.agent))
    scenario = registry.build(config).member.scenario
    with sean_jax.trust():
        learning.pack(tmp_path / "run", tmp_path / "packed")
        drivers = [learning.load(tmp_path / name, scenario) for name in ("run", "packed")]
    ways = [jax.jit(sean_jax.rollout, static_argnums=3)(scenario, each, jax.random.key(0), 5)[0] for each in drivers]
    np.testing.assert_allclose(ways[0].robot.position, ways[1].robot.position, atol=1e-2)


# ------------------------------------------------------------------ squashed actions


def output(location, log_std) -> NetworkOutput:
    location, log_std = jnp.asarray(location, jnp.float32), jnp.asarray(log_std, jnp.float32)
    return NetworkOutput(jnp.tanh(location), log_std, jnp.zeros(location.shape[:-1]), jnp.zeros(0), location)


PAIRS = [(0.0, -0.7), (1.5, -1.0), (-3.9, 0.0), (0.3, 0.7), (4.0, -3.0)]


@pytest.mark.parametrize(("location", "log_std"), PAIRS)
def test_the_density_of_squashed_actions_integrates_to_one(location, log_std):
    """On a grid of one action that is finer near the limits; and is that of scipy."""
    before = np.linspace(location - 8 * np.exp(log_std), location + 8 * np.exp(log_std), 200_001)
    before = before[np.abs(before) < 7.0]
    action = np.tanh(before)
    said = output(
        np.broadcast_to([location, 0.0], (len(action), 2)), np.broadcast_to([log_std, -0.7], (len(action), 2))
    )
    found = networks.log_density(said, jnp.stack([jnp.asarray(action, jnp.float32), jnp.zeros(len(action))], -1))
    other = norm(0.0, np.exp(-0.7)).logpdf(0.0)  # of the other action, 0
    np.testing.assert_allclose(np.trapezoid(np.exp(np.asarray(found, float) - other), action), 1.0, atol=3e-3)
    clear = np.abs(before) < 5.0  # nearer to the limits, 32 bits do not hold the action
    expected = norm(location, np.exp(log_std)).logpdf(before) - np.log1p(-(action**2))
    np.testing.assert_allclose((np.asarray(found) - other)[clear], expected[clear], rtol=1e-2, atol=2e-2)


@pytest.mark.parametrize(("location", "log_std"), PAIRS)
def test_squashed_actions_are_drawn_from_their_density_within_the_limits(location, log_std):
    """Against the distribution function, and the entropy against the mean of -log density in float64."""
    said = output([location, -location], [log_std, log_std])
    drawn = np.asarray(
        jax.vmap(lambda key: networks.draw_action(said, key))(jax.random.split(jax.random.key(0), 20_000))
    )
    assert (np.abs(drawn) < 1.0).all() and np.abs(said.mean).max() < 1.0
    spread = norm(location, np.exp(log_std))
    for quantile in (0.1, 0.5, 0.9):
        assert (drawn[:, 0] <= np.tanh(spread.ppf(quantile))).mean() == pytest.approx(quantile, abs=0.02)
    before = spread.rvs(400_000, random_state=0)
    density = spread.logpdf(before) - np.log(4.0) + 2.0 * (before + np.logaddexp(0.0, -2.0 * before))
    assert float(networks.entropy(said)) == pytest.approx(-2.0 * density.mean(), abs=0.03)


def test_gradients_of_squashed_actions_are_finite_at_extremes():
    for location in (-1e3, -20.0, -4.0, 0.0, 4.0, 20.0, 1e3):
        for log_std in (-10.0, -0.7, 3.0):
            for action in (-1.0, -0.5, 0.0, 1.0):

                def numbers(location, log_std, action):
                    said = output(location, log_std)
                    drawn = networks.draw_action(said, jax.random.key(0)).sum()
                    return networks.log_density(said, action) * 1e-6 + networks.entropy(said) + drawn

                places = (jnp.full(2, float(each)) for each in (location, log_std, action))
                value, slopes = jax.value_and_grad(numbers, (0, 1, 2))(*places)
                assert np.isfinite(value) and all(bool(jnp.isfinite(slope).all()) for slope in slopes)


def test_the_mean_action_of_an_agent_stays_within_the_limits():
    env, network, agent, seen = described("mlp", distribution="squashed")
    inner = agent.parameters["params"]
    far = agent.replace(
        parameters={"params": inner | {"Dense_4": jax.tree.map(lambda leaf: leaf + 1e4, inner["Dense_4"])}}
    )
    for each in (agent, far):
        found = say(env, network, each, seen)
        assert float(jnp.abs(found.mean).max()) < 1.0 and float(jnp.abs(found.location).max()) <= networks.FAR_LOCATION
        np.testing.assert_allclose(found.mean, jnp.tanh(found.location))

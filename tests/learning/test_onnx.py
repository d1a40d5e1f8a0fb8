"""Export of agents as ONNX: onnxruntime gives the commands of the jax policy, from files that say what they take."""

import functools
import json
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import learning, mdp, registry
from sean_jax.cli import command_line
from sean_jax.config import PPOConfig
from sean_jax.core.errors import InputError
from sean_jax.learning import networks, onnx, policy
from sean_jax.learning.policy import AGENTS, agent_network, agent_terms, save_agent
from support.quick import quick

OWN = """
import jax.numpy as jnp
from flax import linen as nn


class Net(nn.Module):
    @nn.compact
    def __call__(self, observation):
        people = nn.LayerNorm()(nn.gelu(nn.Dense(8)(observation["people"])))
        first, last = jnp.split(people, 2)
        mixed = jnp.stack([first, last[::-1]], -1).max(0) + jnp.tile(people.mean(0)[:, None], 2)
        return jnp.concatenate([nn.softplus(mixed).reshape(-1), observation["goal"] ** 3])


class Sorted(nn.Module):
    @nn.compact
    def __call__(self, observation):
        return nn.Dense(3)(jnp.sort(observation["goal"]))
"""


@pytest.fixture
def runtime():
    pytest.importorskip("onnx")
    return pytest.importorskip("onnxruntime")


def described(**others) -> PPOConfig:
    fields = dict(
        method="ppo", environment="lab", behavior="random", people=3, time_limit=4.0, scenarios=4, minibatches=2,
        width=16, observations=["goal", "speeds", "people"], distribution="squashed",
    )  # fmt: skip
    return PPOConfig(**{**fields, **others})  # pyright: ignore


def saved(folder: Path, config: PPOConfig):
    """An agent before its training, whose statistics and outputs are no trivial ones, packed in a folder."""
    env = registry.build(config).member
    env = replace(env, observations=sum(agent_terms(config), ()))
    network = agent_network(config, env.observation_space)
    init = jax.jit(lambda key: networks.init_agent(network, env.observations, env.observation_space, key))
    agent = init(jax.random.key(0))
    size = agent.statistics.mean.shape[0]
    statistics = agent.statistics.replace(mean=jnp.linspace(-1.0, 2.0, size), variance=jnp.linspace(0.1, 5.0, size))
    louder = lambda leaf: leaf + 0.05 if leaf.ndim == 1 else leaf * (30.0 if leaf.shape[1:] == (2,) else 1.0)  # noqa: E731
    parameters = jax.tree.map(louder, agent.parameters)
    folder.mkdir()
    save_agent(folder, networks.Agent(parameters, statistics), config.identity() | {"method": "ppo"})
    return env.scenario


def inputs(session, terms, seed: int) -> dict[str, np.ndarray]:
    """An observation at random, partly beyond the bounds; people are present or not."""
    rng, terms, found = np.random.default_rng(seed), dict(terms), {}
    for each in session.get_inputs():
        if each.name in terms:
            term = terms[each.name]
            values = rng.normal(0.5 * (term.low + term.high), 0.3 * (term.high - term.low), each.shape)
            if each.name == "people":
                values[..., -1] = rng.random(each.shape[:-1]) < 0.5
            found[each.name] = values.astype(np.float32)
    return found


def check(runtime, file: Path, scenario, driver, bfloat16: bool = False) -> None:
    """Ten steps of the model beside the policy's function of the same observations."""
    session = runtime.InferenceSession(file.read_bytes())
    params, robot = driver.params, scenario.robot
    network = params.network if bfloat16 else params.network.clone(bfloat16=False)
    memory = kept = np.zeros(network.memory_size, np.float32)

    @jax.jit
    def act(seen, memory):
        shown = {name: jnp.clip(seen[name], term.low, term.high) for name, term in params.terms}
        vector = jnp.pad(mdp.flatten(params.terms, shown), (0, network.private))
        images = {name: shown[name].astype(network.image_dtype) for name in network.images}
        said = networks.apply(network, params.agent, vector, images, memory, jnp.zeros((), bool))
        return mdp.to_command(robot, said.mean), said.memory

    commands = []
    for step in range(10):
        seen = inputs(session, params.terms, step)
        expected, memory = act(seen, memory)
        command, action, *rest = session.run(None, {**seen, **({"memory": kept} if network.recurrent else {})})
        np.testing.assert_allclose(command, expected, atol=1e-2 if bfloat16 else 1e-5)
        np.testing.assert_allclose(mdp.to_command(robot, jnp.asarray(action)), command, atol=1e-6)
        if network.recurrent:
            (kept,) = rest
            np.testing.assert_allclose(kept, memory, atol=1e-5)
        commands.append(command)
    assert np.ptp(commands, 0).min() > 1e-3


@pytest.mark.parametrize("name", quick([*AGENTS], "ppo_lidar"))
def test_agents_of_the_package_drive_alike(runtime, tmp_path, name):
    file = onnx.export(name, tmp_path / "agent.onnx")
    scenario = sean_jax.make("lab", behavior="random", people=3, dynamics="twin")
    driver = learning.load(name, scenario)
    check(runtime, file, scenario, driver)


KINDS = {
    "attention": {"network": "attention"},
    "memory": {"network": "attention", "recurrent": True, "critic": ["obstacles"], "distribution": "gaussian"},
    "conv": {"network": "conv", "observations": ["goal", "rgb", "depth"], "bfloat16": True},
    "own": {"network": "mine.py:Net"},
}


@pytest.mark.parametrize("kind", quick([*KINDS], "memory"))
def test_agents_with_other_networks_drive_alike(runtime, tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(OWN)
    config = described(**KINDS[kind])
    scenario = saved(tmp_path / "packed", config)
    with sean_jax.trust():
        file = onnx.export(tmp_path / "packed", tmp_path / "agent.onnx")
        driver = learning.load(tmp_path / "packed", scenario)
    if kind == "conv":
        network = driver.params.network
        network = network.clone(encoder=network.encoder.clone(dtype=jnp.float32))
        driver = replace(driver, params=replace(driver.params, network=network))
    check(runtime, file, scenario, driver)


@pytest.mark.parametrize("flags", [False, True])
def test_a_network_that_imitates_drives_alike(runtime, tmp_path, flags):
    """With its local plan and the shares of its attention."""
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin")
    names = [name for name, _ in scenario.situations]
    command = "sean collect --environment lab --behavior random --people 2 --dynamics twin"
    config = {"width": 8, "flags": flags, "image": [13, 16], "situations": names, "dataset": {"command": command}}
    description = networks.describe_imitation(networks.NetworkConfig(**config), scenario.time_step)
    agent = jax.jit(description.init)(jax.random.key(0))
    agent = jax.tree.map(lambda leaf: leaf + 0.05, agent).replace(command_scale=jnp.array([0.3, 0.8]))
    (tmp_path / "packed").mkdir()
    save_agent(tmp_path / "packed", agent, config)
    params = learning.load(tmp_path / "packed", scenario).params
    session = runtime.InferenceSession(onnx.export(tmp_path / "packed", tmp_path / "agent.onnx").read_bytes())
    rng, commands = np.random.default_rng(0), []
    for _ in range(5):
        seen = {each.name: rng.uniform(0.0, 1.0, each.shape).astype(np.float32) for each in session.get_inputs()}
        expected = jax.jit(policy._forward)(params, seen, jnp.zeros(0), jnp.zeros((), bool))
        found = dict(zip([each.name for each in session.get_outputs()], session.run(None, seen), strict=True))
        np.testing.assert_allclose(found.pop("command"), expected.mean * params.agent.command_scale, atol=1e-5)
        commands.append(found.pop("action"))
        assert found.keys() == expected.auxiliary.keys() and found["local_plan"].shape == (5, 2)
        for name, values in found.items():
            np.testing.assert_allclose(values, expected.auxiliary[name], atol=1e-5)
    assert np.ptp(commands, 0).max() > 1e-4


def test_a_model_says_what_it_takes(runtime, tmp_path, monkeypatch, capsys):
    """In the words of the package, in the order of the parts; written by the command line."""
    import onnx as format

    monkeypatch.chdir(tmp_path)
    saved(tmp_path / "packed", described(recurrent=True, observations=["goal", "people"]))
    assert command_line.main(["export", "onnx", "packed", "--out", "agent.onnx"]) == 0
    assert "written: agent.onnx" in capsys.readouterr().out
    model = format.load("agent.onnx")
    facts = {each.key: each.value for each in model.metadata_props}
    first, second = json.loads(facts["observation"])
    assert first == {
        "name": "goal", "shape": [2], "low": -30.0, "high": 30.0, "image": False, "stack": 0, "every": 1,
        "definition": "Where the goal is: (2,) m.",
    }  # fmt: skip
    assert second["name"] == "people" and second["shape"] == [12, 5] and second["high"] == 8.0
    limits = json.loads(facts["robot"])
    assert limits["name"] == "kuri" and limits["max_speed"] == 0.5 and limits["max_turn_rate"] == 3.0
    assert facts["period"] == "0.1" and facts["memory"].startswith("memory begins with 16 zeros")
    assert [each.name for each in model.graph.input] == ["goal", "people", "memory"]
    assert [each.name for each in model.graph.output] == ["command", "action", "next_memory"]


def test_operations_are_those_of_jax(runtime):
    """Each against jax, on random numbers; what is not known is refused by its name."""
    import onnx as format

    matrix = jax.random.normal(jax.random.key(1), (3, 4))
    kernel, wide = (jax.random.normal(jax.random.key(2), (3, 3, *channels)) for channels in ((2, 4), (1, 8)))
    convolve = functools.partial(jax.lax.conv_general_dilated, dimension_numbers=("NHWC", "HWIO", "NHWC"))

    def program(seen):
        x, y = seen["x"], seen["y"]  # (2, 3) and (5, 4, 3)
        image = jnp.stack([y.sum(2), y.max(2)], -1)  # (5, 4, 2)
        return [
            jnp.where((x > 0.0) & ~(x != x), x, -x), jnp.clip(x, -0.5, x[0, 0] + 2.0), x @ matrix,
            jnp.einsum("bij,kj->bki", y, x), jnp.einsum("bij,bkj->bik", y, y), jnp.pad(x, ((1, 2), (0, 1))),
            jax.nn.softmax(y, 0), jax.nn.softplus(x), jax.nn.gelu(x), jax.nn.elu(x), jax.nn.sigmoid(x),
            jnp.sqrt(jnp.abs(x)), jnp.expm1(x), jnp.log1p(jnp.abs(x)), jax.lax.rsqrt(x * x + 1.0), x**4, x**-2,
            y.transpose(2, 0, 1)[:, ::2, 1:], y[::-1], jnp.tile(x, (2, 1)), jnp.concatenate(jnp.split(y, 2, 1), 2),
            (y > 0.0).all(2), (y > 2.0).any((0, 1)), y.prod(0), y.min(), y.var(1), x[..., -1].reshape(1, 2).squeeze(0),
            jnp.arange(3.0)[None] + x, jnp.broadcast_to(x[:, None], (2, 4, 3)), jnp.sign(x) * jnp.cos(x),
            convolve(image[None], kernel, (2, 1), "SAME"),
            convolve(image[None], wide, (1, 1), [(0, 1), (2, 0)], rhs_dilation=(1, 2), feature_group_count=2),
        ]  # fmt: skip

    like = {"x": jax.ShapeDtypeStruct((2, 3), jnp.float32), "y": jax.ShapeDtypeStruct((5, 4, 3), jnp.float32)}
    expected = jax.eval_shape(program, like)
    names = [f"out_{number}" for number in range(len(expected))]
    graph = onnx.graph_of(lambda seen: dict(zip(names, program(seen), strict=True)), like, names)
    opset = [format.helper.make_opsetid("", onnx.OPSET)]
    model = format.helper.make_model(graph, opset_imports=opset, ir_version=onnx.IR_VERSION)
    format.checker.check_model(model, full_check=True)
    session = runtime.InferenceSession(model.SerializeToString())
    rng = np.random.default_rng(0)
    for _ in range(3):
        seen = {name: rng.normal(size=each.shape).astype(np.float32) for name, each in like.items()}
        found = session.run(None, seen)
        for number, (one, other) in enumerate(zip(found, program(jax.tree.map(jnp.asarray, seen)), strict=True)):
            assert one.dtype == other.dtype and one.shape == other.shape, number
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5, err_msg=str(number))
    with pytest.raises(InputError, match="the operation sort, which is not translated; layers, convolutions"):
        onnx.graph_of(lambda seen: {"out": jnp.sort(seen["x"])}, like, ["out"])


def test_exports_that_cannot_be_are_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command_line.main(["export", "onnx", "ppo", "--out", "agent.txt"]) == 2
    assert "--out: agent.txt ends in .txt, but must end in one of .onnx" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match=r'onnx is missing; pip install "sean_jax\[export\]"'):
        onnx.export("ppo", tmp_path / "agent.onnx")
    assert not list(tmp_path.iterdir())

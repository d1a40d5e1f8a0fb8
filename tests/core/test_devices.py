"""Scenarios over several devices and processes equal those on one, and restarts are episodes of their own."""

import dataclasses
import json
import os
import socket
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh

import sean_jax
from sean_jax import learning
from sean_jax.core import devices
from sean_jax.core.data_types import Policy
from sean_jax.learning import reinforcement, rollouts
from sean_jax.policies import go_to_goal
from sean_jax.simulation import episodes
from support.commands import cpu_devices, python
from support.scenes import room

PROGRAM = """
import sys, json
import jax
if len(sys.argv) > 2:
    jax.distributed.initialize(sys.argv[1], num_processes=2, process_id=int(sys.argv[2]))
import numpy as np
import sean_jax
from sean_jax.core import devices
from sean_jax.policies import go_to_goal
scenario = sean_jax.make("lab", people=4, dynamics="twin")
over = devices.mesh()
run = devices.shard(over, lambda fixed, key: sean_jax.rollout(fixed[0], go_to_goal, key, 20)[0].pedestrians.position)
drawn = devices.keys(over, jax.random.key(3), 8)
fixed = devices.replicate(over, (scenario, jax.random.key(3)))  # keys are replicated and split as other arrays are
own = devices.split(over, jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(3), np.arange(8)))
same = bool((jax.random.key_data(own) == jax.random.key_data(drawn)).all())
same &= bool((jax.random.key_data(fixed[1]) == jax.random.key_data(jax.random.key(3))).all())
found = run(fixed, own)
mine = {str(part.index[0].start or 0): np.asarray(part.data).tolist() for part in found.addressable_shards}
print(json.dumps({"devices": over.size if same else 0, "shards": mine}))
"""


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def run(*arguments, count=1):
    command, environment = [sys.executable, "-c", PROGRAM, *arguments], {**os.environ, **cpu_devices(count)}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def shards(process):
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    answer = json.loads(out.splitlines()[-1])
    rows = {int(start): np.array(values) for start, values in answer["shards"].items()}
    return answer["devices"], rows


@pytest.mark.night
def test_four_devices_and_two_processes_equal_one():
    address = f"127.0.0.1:{free_port()}"
    count, alone = shards(run())
    assert count == 1 and alone[0].shape == (8, 4, 2)
    count, four = shards(run(count=4))
    assert count == 4 and sorted(four) == [0, 2, 4, 6]
    pair = [run(address, "0", count=2), run(address, "1", count=2)]
    count, two = 0, {}
    for process in pair:
        count, part = shards(process)
        two |= part
    assert count == 4 and sorted(two) == [0, 2, 4, 6]
    for rows in (four, two):
        joined = np.concatenate([rows[start] for start in sorted(rows)])
        assert np.allclose(joined, alone[0], atol=1e-4)


def test_keys_are_those_of_the_scenarios_numbers():
    over = devices.mesh(jax.devices()[:1])
    key = jax.random.key(5)
    drawn = devices.keys(over, key, 3)
    expected = [jax.random.key_data(jax.random.fold_in(key, number)) for number in range(3)]
    assert np.array_equal(jax.random.key_data(drawn), np.stack(expected))
    with pytest.raises(ValueError, match="0 scenarios do not spread evenly over 1 devices; take 1"):
        devices.keys(over, key, 0)


@pytest.fixture(scope="module")
def short():
    """Episodes of 1 s in the lab, so that restarts come soon."""
    return sean_jax.make("lab", people=4, dynamics="twin", time_limit=1.0)


@pytest.fixture(scope="module")
def starts(short):
    return jax.jit(episodes.reset_pool, static_argnums=2)(short, jax.random.key(0), 5)


@pytest.mark.night
def test_episodes_follow_one_another(short, starts):
    def record(before, after, action):
        return before.tick, after.timed_out, before.pedestrians.position, jax.random.key_data(before.streams.people)

    def run(state):
        return episodes.rollout_autoreset(short, go_to_goal, starts, state, 35, record)

    state = jax.tree.map(lambda leaf: leaf[0], starts.starts)
    last, (tick, timed_out, people, key) = jax.jit(run)(state)
    assert np.array_equal(tick, [*range(10), *range(10), *range(10), *range(5)])
    assert np.array_equal(np.flatnonzero(timed_out), [9, 19, 29])
    assert int(last.tick) == 5
    pool = np.asarray(starts.starts.pedestrians.position)
    for first in (10, 20, 30):
        assert (np.abs(pool - np.asarray(people[first])).max((1, 2)) < 1e-6).any()
    assert len({tuple(row) for row in np.asarray(key)[[0, 10, 20, 30]].tolist()}) == 4
    assert jax.tree.structure(last) == jax.tree.structure(state)


@pytest.mark.night
def test_a_driver_remembers_its_episode_and_no_other(short):
    """It counts the steps it drove since the episode began, in steps of its parameter."""
    counter = Policy(
        params=jnp.asarray(2.0, jnp.float32),
        name="counter",
        init=lambda scenario, params, state: jnp.zeros((), jnp.float32),
        apply=lambda scenario, params, state, key: (jnp.zeros(2, jnp.float32), state.policy_state + params),
    )

    def run(policy):
        starts = episodes.reset_pool(short, jax.random.key(0), 2, policy)
        state = jax.tree.map(lambda leaf: leaf[0], starts.starts)
        return episodes.rollout_autoreset(
            short, policy, starts, state, 12, lambda before, after, action: after.policy_state
        )[1]

    counted = jax.jit(run)(counter)
    np.testing.assert_array_equal(counted, [*np.arange(2.0, 22.0, 2.0), 2.0, 4.0])


def test_a_running_episode_is_left_alone(short):
    """Every leaf of it, where all starts have other values."""
    shapes = jax.eval_shape(lambda key: episodes.reset_pool(short, key, 5), jax.random.key(0))

    def filled(leaf, value):
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return jax.random.split(jax.random.key(value), leaf.shape)
        return jnp.full(leaf.shape, value, leaf.dtype)

    starts = jax.tree.map(lambda leaf: filled(leaf, 1), shapes)
    state = jax.tree.map(lambda leaf: filled(leaf, 0)[1], shapes.starts)  # of zeros: neither completed nor timed out
    after = jax.jit(episodes.autoreset)(starts, state)
    same = jax.tree.map(lambda old, new: jnp.array_equal(jax_data(old), jax_data(new)), state, after)
    assert all(jax.tree.leaves(same))
    after = jax.jit(episodes.autoreset)(starts, dataclasses.replace(state, timed_out=jnp.ones((), bool)))
    assert (after.pedestrians.position == 1.0).all() and bool((after.robot.position == 1.0).all())


def jax_data(leaf):
    return jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf


TRAIN = """
import sys
from sean_jax.cli import command_line as cli
calls, last = [], int(sys.argv[1])

def numbers(values):
    calls.append(values)
    if len(calls) == 3 * last:  # three calls an update
        raise KeyboardInterrupt
    return before(values)

if last:
    from sean_jax.learning import reinforcement
    before, reinforcement._finite_means = reinforcement._finite_means, numbers
sys.exit(cli.main(sys.argv[2:]))
"""
SMALL = "--environment lab --behavior random --people 2 --dynamics twin --time-limit 2 --scenarios 4 --horizon 4"
SMALL += " --minibatches 2 --epochs 1 --width 4 --pool 4 --steps 64 --evaluate-every 2 --evaluation-episodes 2"
SMALL += " --observations goal,speeds --rewards progress,time --metrics mean_speed"


def train(folder, last, number=None, port=0, more=(), count=2):
    """Four updates, or until Ctrl-C in update ``last``, alone on two devices or as a process of two with one each."""
    flags = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"  # compiles in half the time
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "XLA_FLAGS": flags}
    words = ["train", "ppo", *SMALL.split(), "--out", str(folder), *more]
    if number is None:
        environment["XLA_FLAGS"] += f" --xla_force_host_platform_device_count={count}"
    else:  # as SLURM starts them
        environment |= {"SLURM_JOB_ID": "1", "SLURM_STEP_NODELIST": "127.0.0.1", "SLURM_NTASKS": "2"}
        environment |= {"SLURM_PROCID": str(number), "SLURM_LOCALID": "0", "JAX_COORDINATOR_PORT": str(port)}
        words.append("--distributed")
    command = [sys.executable, "-c", TRAIN, str(last), *words]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def curve(folder):
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    parts = [name for name in lines[-1] if isinstance(lines[-1][name], dict)]
    return [{f"{part} {name}": line[part][name] for part in parts for name in line.get(part, {})} for line in lines]


@pytest.mark.night
def test_two_processes_train_as_one_with_two_devices(tmp_path):
    """Stopped and given again, they come to the same curve, and leave the same files, each once."""
    alone, both = tmp_path / "alone", tmp_path / "both"
    process = train(alone, 0)
    for last, code in ((3, 130), (0, 0)):
        port = free_port()
        pair = [train(both, last, number, port) for number in range(2)]
        said = [process.communicate(timeout=300) for process in pair]
        assert pair[0].returncode == code, said
        assert pair[1].returncode == code or (code and pair[1].returncode), said  # or ended as the first one had
        assert len(curve(both)) == (4 if last == 0 else 2)
    told = process.communicate(timeout=300)
    assert process.returncode == 0, told
    assert "4 updates" in said[0][0] and "updates" not in said[1][0]
    assert {path.name for path in both.iterdir()} == {path.name for path in alone.iterdir()}
    assert [path.name for path in (both / "checkpoints").iterdir()] == ["4"]
    for one, other in zip(curve(both), curve(alone), strict=True):
        assert one == pytest.approx(other, rel=1e-3, abs=1e-5)
    driver = learning.load(both, sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=2.0))
    assert driver.name == "both"  # one process reads what two have written


@pytest.mark.night
def test_several_environments_on_two_devices_are_those_on_one(tmp_path):
    cell = room(tmp_path / "cell", (0, 0, 8, 6))
    more = ("--environment", f"lab,{cell}")
    told = [train(tmp_path / str(count), 0, more=more, count=count) for count in (1, 2)]
    assert [(process.communicate(timeout=600), process.returncode)[1] for process in told] == [0, 0]
    for one, other in zip(curve(tmp_path / "1"), curve(tmp_path / "2"), strict=True):
        assert one == pytest.approx(other, rel=1e-3, abs=1e-5)
    refused = train(tmp_path / "4", 0, more=more, count=4)
    assert "4 do not spread evenly over 4 devices in 2 environments; take a multiple" in " ".join(
        refused.communicate(timeout=600)[1].split()
    )


@pytest.mark.night
def test_two_agents_on_two_devices_are_those_on_one(tmp_path):
    more = ("--seeds", "2")
    told = [train(tmp_path / str(count), 0, more=more, count=count) for count in (1, 2)]
    assert [(process.communicate(timeout=600), process.returncode)[1] for process in told] == [0, 0]
    for one, other in zip(curve(tmp_path / "1"), curve(tmp_path / "2"), strict=True):
        assert one == pytest.approx(other, rel=1e-3, abs=1e-5)


EXCHANGES = """
import re
import jax
from sean_jax.core import devices
from sean_jax.config import PPOConfig
from sean_jax.learning import reinforcement

place = dict(environment="lab", behavior="random", people=2)
terms = dict(observations=["goal", "speeds"], rewards=["progress"])
sizes = dict(seeds=AGENTS, scenarios=SCENARIOS, horizon=4, minibatches=4, epochs=1, width=4, pool=4)
options = PPOConfig(method="ppo", **place, **terms, **sizes)
setting = reinforcement.build(options)
layout = reinforcement.device_layout(AGENTS)
assert layout.mesh.size == 2
run = reinforcement.programs(options, setting.network, layout)
envs, _ = reinforcement.draw_starts(options, setting.scenarios, setting.envs)
state = run.begin(envs, reinforcement._first_agents(options, setting))
state = devices.place(state, reinforcement.placement(layout))
text = run.update.lower(devices.replicate(layout.mesh, envs), state).compile().as_text()
kinds = "all-reduce|all-gather|all-to-all|collective-permute|reduce-scatter"
lines = [line for line in text.splitlines() if "top_k" not in line]  # which XLA splits on GPUs, and not on CPUs
shapes = [shape for line in lines for shape, _ in re.findall(rf" = (.*?) ({kinds})(?:-start)?\\(", line)]
brackets = [found for shape in shapes for found in re.findall(r"\\[([0-9,]+)\\]", shape)]
axes = [int(axis) for found in brackets for axis in found.split(",")]
print(max(axes, default=0))
"""


@pytest.mark.night
@pytest.mark.parametrize("agents", [1, 2])
def test_an_update_exchanges_no_scenarios_between_devices(agents):
    """What devices exchange has no axis of scenarios: gradients and means, and for several agents the log alone."""
    scenarios = 4096  # more than any layer has weights
    program = EXCHANGES.replace("AGENTS", str(agents)).replace("SCENARIOS", str(scenarios))
    assert int(python("-c", program, env=cpu_devices(2, "--xla_backend_optimization_level=0"))) < scenarios // 2


def test_agents_that_do_not_divide_among_devices_leave_some_idle(monkeypatch):
    monkeypatch.setattr(jax, "devices", lambda: 4 * jax.local_devices())
    monkeypatch.setattr(
        devices, "mesh", lambda chosen=None: Mesh(np.array(chosen or 4 * jax.local_devices()), "scenarios")
    )
    idle = {agents: reinforcement.unused_devices(agents) for agents in (1, 4, 6, 8)}
    assert idle == {
        1: None,
        4: None,
        6: "6 agents divide among 3 of 4 devices; the others are idle. Train a multiple of 4.",
        8: None,
    }


@pytest.mark.parametrize("number, minibatches", [(8, 8), (12, 2), (64, 4), (30, 5), (96, 3)])
def test_minibatches_take_each_scenario_once_and_equally_many_of_each_block(number, minibatches):
    rows = rollouts.shuffled_rows(jax.random.key(number), number, minibatches)
    values = jnp.arange(2 * number).reshape(2, number)
    taken = np.stack([rollouts.take_rows(values, each, axis=1) for each in rows])  # (minibatches, 2, rows)
    assert sorted(taken[:, 0].ravel()) == list(range(number))
    np.testing.assert_array_equal(taken[:, 1], taken[:, 0] + number)

    blocks = rows.shape[1]
    for minibatch in taken[:, 0]:
        counts = np.bincount(minibatch // (number // blocks), minlength=blocks)
        assert (counts == counts[0]).all()
    assert number // minibatches == 1 or (np.diff(taken[0, 0]) != 1).any()


def test_on_host_computes_on_the_cpu_and_gives_arrays_of_the_default_device(monkeypatch):
    """As on a GPU."""
    run = devices.on_host(jax.jit(lambda key, pair: (jax.random.split(key, 2), pair[0] + pair[1])))
    arguments = jax.random.key(3), (jnp.arange(3.0), np.ones(3, np.float32))
    wanted = run(*arguments)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    keys, total = run(*arguments)
    assert (jax.random.key_data(keys) == jax.random.key_data(wanted[0])).all() and total.devices() == {jax.devices()[0]}
    np.testing.assert_array_equal(total, wanted[1])

"""The agents that come with the package: small, described, found by name, and read without the extra ``learning``."""

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import sean_jax
from sean_jax import learning
from sean_jax.cli import commands
from sean_jax.config import PPOConfig, validate
from sean_jax.core.errors import FileError, InputError
from sean_jax.learning.policy import AGENTS, MAX_WEIGHTS_BYTES, WEIGHTS, load_agent, load_policy, save_agent
from sean_jax.mdp import observations
from support import trees
from support.checkout import ROOT
from support.commands import python

WITHOUT = """
import sys
sys.modules.update(dict.fromkeys(("optax", "orbax", "tensorstore")))  # as if they were not installed
from sean_jax.cli import command_line as cli
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def lab():
    return sean_jax.make("lab", behavior="random", people=2, dynamics="twin")


def test_each_is_small_and_says_what_it_is():
    assert [*AGENTS] == ["ppo", "ppo_lidar"]
    for folder in AGENTS.values():
        assert {path.name for path in folder.iterdir()} == {WEIGHTS, "config.json"}
        assert sum(path.stat().st_size for path in folder.iterdir()) < 1_000_000
        told = json.loads((folder / "config.json").read_text())
        assert told["command"].startswith("sean train ") and "/" not in told["command"]
        assert told["agent"]["steps"] > 0 and told["agent"]["weights"] == "float16"
        assert 0.0 <= told["agent"]["evaluation"]["completed"] <= 1.0
        assert "sean-jax" in told["versions"] or "sean-jax" in told["agent"]["packed_with"]


def test_the_file_of_a_training_has_the_options_of_its_agent():
    """benchmarks/ppo_lidar.yaml, besides the agent that the training begins with."""
    path = ROOT / "benchmarks" / "ppo_lidar.yaml"
    options = validate(PPOConfig, yaml.safe_load(path.read_text()))
    saved = json.loads((AGENTS["ppo_lidar"] / "config.json").read_text())
    for name, value in json.loads(json.dumps(options.identity())).items():
        if name in ("out", "pretrained") or name not in saved:
            continue
        if isinstance(value, dict):  # of a part, whose newer options the agent does not know
            value = {option: value[option] for option in saved[name]}
        assert saved[name] == value, name


@pytest.mark.parametrize("name", ["sarl", "ds_rnn"])
def test_entries_of_others_papers_see_visible_people_alone(name):
    """benchmarks/sarl.yaml and ds_rnn.yaml: attention over people; one has a memory."""
    path = ROOT / "benchmarks" / f"{name}.yaml"
    options = validate(PPOConfig, yaml.safe_load(path.read_text()))
    terms = dict(observations.as_terms([term.kind for term in options.observations]))
    assert observations.sensing(tuple(terms.items())) == "tracks" and terms["visible_people"].people
    assert options.network.kind == "attention" and options.recurrent == (name == "ds_rnn")


def test_one_is_loaded_by_its_name(lab):
    driver = learning.load("ppo", lab)
    assert driver.name == "ppo"
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(driver.params.agent))
    with pytest.raises(InputError, match="'ppoo' is not one of .*; did you mean 'ppo'"):
        load_policy("ppoo", lab)


def test_it_is_written_and_read(lab, tmp_path):
    """Of numbers that 16 bits hold all come back; statistics keep 32, and what 16 cannot hold is refused."""
    agent = learning.load("ppo", lab).params.agent
    agent = replace(agent, statistics=replace(agent.statistics, variance=agent.statistics.variance * 1e6 + 1e-6))
    config = json.loads((AGENTS["ppo"] / "config.json").read_text())
    save_agent(tmp_path, agent, config)
    _, found, _ = load_agent(tmp_path, lab)
    trees.assert_equal(found, agent)
    huge = jax.tree.map(lambda leaf: leaf * 0.0 + 1e6, agent)
    with pytest.raises(InputError, match="16 bits cannot hold"):
        save_agent(tmp_path, huge, config)


def test_it_is_refused_where_it_sees_something_else(lab, tmp_path):
    config = json.loads((AGENTS["ppo"] / "config.json").read_text())
    save_agent(tmp_path, learning.load("ppo", lab).params.agent, config | {"observations": ["goal", "situations"]})
    with pytest.raises(InputError, match="agent sees 80 numbers, and this scenario shows 7 .goal, situations.; make"):
        learning.load(tmp_path, lab)


@pytest.mark.slow
def test_damaged_weights_are_told(lab, tmp_path):
    folder = tmp_path / "ppo"
    folder.mkdir()
    for name in ("config.json", WEIGHTS):
        (folder / name).write_bytes((AGENTS["ppo"] / name).read_bytes())
    weights = folder / WEIGHTS
    for wrong in (np.array(["a"]), np.array([np.nan])):
        np.savez(weights, **{"statistics/mean": wrong})
        with pytest.raises(InputError, match="statistics/mean has a number that is not finite"):
            learning.load(folder, lab)
    weights.write_bytes((AGENTS["ppo"] / WEIGHTS).read_bytes()[:-5000])
    with pytest.raises(FileError, match="ppo/weights.npz: is damaged; get the file again"):
        learning.load(folder, lab)
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(MAX_WEIGHTS_BYTES + 1))
    weights.write_bytes(bomb.getvalue())
    with pytest.raises(FileError, match="unpacks to"):
        learning.load(folder, lab)


def test_a_folder_of_that_name_is_not_shadowed(lab, tmp_path, monkeypatch):
    """A name that may mean both is refused; a path means the folder."""
    monkeypatch.chdir(tmp_path)
    Path("ppo").mkdir()
    assert learning.load("ppo", lab).name == "ppo"  # a folder without an agent is no rival
    Path("ppo/config.json").write_text('{"method": "ppo", "width": -3}')
    for load in (learning.load, lambda name, lab: load_policy(name, lab)):
        with pytest.raises(InputError, match="an agent of the package and a folder here; write ./ppo for the folder"):
            load("ppo", lab)
    with pytest.raises(InputError, match="ppo/config.json"):
        load_policy("./ppo", lab)
    with pytest.raises(InputError, match="ppo/config.json"):
        learning.load(Path("ppo"), lab)


def test_the_next_command_names_the_folder():
    assert commands.run_command(Path("ppo")) == "sean run --policy ./ppo"
    assert commands.run_command(Path("runs/ppo")) == "sean run --policy runs/ppo"


@pytest.mark.night
def test_it_drives_without_the_extra(tmp_path):
    words = ["run", "--policy", "ppo", "--environment", "lab", "--people", "4", "--dynamics", "twin"]
    words += ["--episodes", "2", "--time-limit", "3", "--out", "here", "--quiet"]
    python("-c", WITHOUT, *words, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)})
    assert json.loads((tmp_path / "here" / "summary.json").read_text())


@pytest.mark.night
@pytest.mark.parametrize("name", AGENTS)
def test_it_completes_most_tasks(name):
    scenario = sean_jax.make("lab", people=5, task="join_group", dynamics="twin", time_limit=60.0)
    found = sean_jax.evaluate(scenario, name, episodes=16, seed=5)
    assert np.mean(found.completed) > 0.7

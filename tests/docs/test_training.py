"""docs/training.md: its tables have every term with its default, and its examples run."""

import re
import sys
from types import SimpleNamespace

import jax
import pytest

from sean_jax import config, mdp
from sean_jax.learning.policy import AGENTS
from sean_jax.mdp import rewards
from support.checkout import ROOT

pytestmark = pytest.mark.form
TEXT = (ROOT / "docs" / "training.md").read_text(encoding="utf-8")


def table(head: str) -> list[list[str]]:
    """The rows of the table that begins with that cell, as cells."""
    lines = TEXT[TEXT.index(f"| {head} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def names(cell: str) -> list[str]:
    return re.findall(r"`(\w+)`", cell)


def test_observations_are_told():
    assert {name for cells in table("name | content") for name in names(cells[0])} == set(mdp.OBSERVATIONS)
    assert f"The default is `{', '.join(config.OBSERVED)}`" in TEXT


def test_randomization_is_told(tmp_path):
    section = TEXT.split("### Randomization\n")[1].split("\n## ")[0]
    told = {name for cells in table("key | factor of") for name in re.findall(r"`([\w.]+)`", cells[0])}
    told |= set(re.findall(r"`(sensors\.\w+)`", section)) & set(mdp.PARAMETERS)
    assert told == set(mdp.PARAMETERS)
    file = tmp_path / "my.yaml"
    file.write_text(re.findall(r"```yaml\n(.*?)```", section, re.S)[0])
    assert len(mdp.as_randomization(file).bounds) == 7


def test_rewards_are_told():
    told = {}
    for first, _, weights, privileged in table("name | value per step"):
        for name, weight in zip(names(first), (weights.split(", ") * 2), strict=False):
            told[name] = (float(weight or 0), privileged == "yes")
    assert {name: weight for name, (weight, _) in told.items() if weight} == rewards.DEFAULT
    for name, (_, privileged) in told.items():
        assert mdp.REWARDS[name].privileged is privileged, name
    assert {name for name, term in mdp.REWARDS.items() if not term.privileged} <= set(told)


def examples() -> list[str]:
    return re.findall(r"```python\n(.*?)```", TEXT, re.S)


def test_agents_of_the_package_are_told():
    assert {name for cells in table("name | command") for name in names(cells[0])} == set(AGENTS)


@pytest.mark.night
def test_examples_run(tmp_path, monkeypatch):
    pytest.importorskip("gymnasium")
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    for block in examples():
        if not any(package in block for package in ("stable_baselines3", "rejax", "rsl_rl", "wandb", "onnxruntime")):
            exec(block, scope)  # noqa: S102
    assert scope["reward"].shape == (16,) and scope["driver"].name == "short" and scope["many"].num_envs == 16


def test_the_example_of_a_callback_logs_numbers_by_their_names(monkeypatch):
    (block,) = [block for block in examples() if "wandb" in block]
    logged, begun = [], []
    run = SimpleNamespace(log=lambda numbers, step: logged.append((numbers, step)))
    monkeypatch.setitem(sys.modules, "wandb", SimpleNamespace(init=lambda project: begun.append(project) or run))
    scope: dict = {}
    exec(block, scope)  # noqa: S102
    for epoch in (1, 2):
        scope["log"]({"epoch": epoch, "steps": 64, "train": {"loss": 0.5, "actor": 0.1}})
    assert begun == ["sean"] and [step for _, step in logged] == [1, 2]
    assert logged[1][0] == {"epoch": 2, "steps": 64, "train/loss": 0.5, "train/actor": 0.1}


def run_example(package: str, changes: dict[str, str]) -> dict:
    """What the example of an optional package defines, with smaller numbers."""
    pytest.importorskip(package)
    (block,) = [block for block in examples() if package in block]
    for old, new in changes.items():
        assert old in block
        block = block.replace(old, new)
    scope: dict = {}
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):  # theirs are not strict
        exec(block, scope)  # noqa: S102
    return scope


@pytest.mark.slow
def test_the_example_of_stable_baselines_runs():
    scope = run_example("stable_baselines3", {"80_000": "64 * 32", "verbose=1": "verbose=0"})
    assert scope["model"].num_timesteps == 64 * 32


@pytest.mark.slow
def test_the_example_of_rejax_learns():
    returns = run_example("rejax", {"262_144": "32_768", "65_536": "16_384", "30.0": "6.0"})["returns"].mean(1)
    assert returns[-1] > 0.8 * returns[0], returns  # which are negative


@pytest.mark.slow
def test_the_example_of_rsl_rl_runs():
    scope = run_example("rsl_rl", {"learn(60": "learn(2", '"num_steps_per_env": 64': '"num_steps_per_env": 8'})
    assert scope["runner"].current_learning_iteration == 1

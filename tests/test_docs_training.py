"""docs/training.md: its tables have every term with its default, and its examples run."""

import re
from pathlib import Path

import pytest

from sean_jax import config, mdp
from sean_jax.learning.policy import AGENTS
from sean_jax.mdp import rewards

TEXT = (Path(__file__).parent.parent / "docs" / "training.md").read_text(encoding="utf-8")


def table(head: str) -> list[list[str]]:
    """The rows of the table that begins with that cell, as cells."""
    lines = TEXT[TEXT.index(f"| {head} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def names(cell: str) -> list[str]:
    return re.findall(r"`(\w+)`", cell)


def test_observations_are_told():
    assert {name for cells in table("name | content") for name in names(cells[0])} == set(mdp.OBSERVATIONS)
    assert f"The default is `{', '.join(config.OBSERVED)}`" in TEXT


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


@pytest.mark.slow
def test_examples_run(tmp_path, monkeypatch):
    pytest.importorskip("gymnasium")
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    for block in examples():
        if "stable_baselines3" not in block and "onnxruntime" not in block:
            exec(block, scope)  # noqa: S102
    assert scope["reward"].shape == (16,) and scope["driver"].name == "short" and scope["many"].num_envs == 16


@pytest.mark.slow
def test_the_example_of_stable_baselines_runs():
    pytest.importorskip("stable_baselines3")
    (block,) = [block for block in examples() if "stable_baselines3" in block]
    scope: dict = {}
    exec(block.replace("80_000", "64 * 32").replace("verbose=1", "verbose=0"), scope)  # noqa: S102
    assert scope["model"].num_timesteps == 64 * 32

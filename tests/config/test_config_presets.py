"""Presets of options: they reach the scenario, what the user gives wins, and what was filled in is what is repeated."""

import json
import math
import re
import shlex
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import sean_jax
from sean_jax import classifiers, robots, social_forces
from sean_jax.cli import command_line
from sean_jax.config import (
    PRESETS,
    CollectConfig,
    GraphBehavior,
    Named,
    PPOConfig,
    RandomBehavior,
    RunConfig,
    ScenarioConfig,
    flags,
    validate,
)
from sean_jax.evaluation.run_folder import read_config
from sean_jax.simulation.making import scenarios
from support import trees
from support.checkout import ROOT

OTHER = {  # a value of each option that is neither the preset's nor the default
    "routing": "whole", "group_membership": "turnover", "forces": "johansson2007", "situations": "more",
    "goal_sampling": "uniform",
    "task_distance": (1.0, 5.5), "dynamics": "twin", "goal_radius": 0.7, "hold_time": 2.5, "time_limit": 33.0,
    "warm_up": 1.5, "violation_distance": "centers",
}  # fmt: skip
SEAN2 = PRESETS["sean2"].options


def read(words: str, model=RunConfig, base=None):
    return flags.read(model, flags.parse("run", model, shlex.split(words), model is RunConfig), base)


def value(description: ScenarioConfig, option: str):
    """As it stands in a preset."""
    held = getattr(description.behavior if option in ("routing", "group_membership") else description, option)
    return held[0].kind if isinstance(held, tuple) and isinstance(held[0], Named) else held


def given(option: str, chosen: dict) -> str:
    words = chosen[option] if isinstance(chosen[option], tuple) else (chosen[option],)
    return " ".join([flags.flag(option), *map(str, words)])


def test_presets_are_those_that_can_be_named():
    literal = typing.get_args(ScenarioConfig.model_fields["preset"].annotation)[0]
    assert set(typing.get_args(literal)) == set(PRESETS)
    assert OTHER.keys() == SEAN2.keys()


def test_the_command_line_has_all_values_of_the_preset():
    told = read("--preset sean2")
    assert {option: value(told, option) for option in SEAN2} == SEAN2
    assert told.preset is None and told.behavior == GraphBehavior(routing="edge", group_membership="permanent")
    assert {option: value(read(""), option) for option in SEAN2} != SEAN2
    assert "--preset" not in flags.command("run", told)
    for model in (CollectConfig, ScenarioConfig):
        assert {option: value(model(preset="sean2"), option) for option in SEAN2} == SEAN2
    assert PPOConfig(method="ppo", preset="sean2").dynamics == "kinematic"


@pytest.mark.parametrize("option", SEAN2)
def test_each_switch_is_an_option_and_what_is_given_wins(option):
    alone, without = read(given(option, SEAN2)), read(f"--preset sean2 {given(option, OTHER)}")
    for each in SEAN2:
        assert value(alone, each) == (SEAN2 if each == option else {each: value(read(""), each)})[each]
        assert value(without, each) == (OTHER if each == option else SEAN2)[each]
    in_a_file = read("--preset sean2", base=json.loads(json.dumps({"preset": "sean2"} | _as_field(option))))
    assert in_a_file.model_dump() == without.model_dump()
    assert validate(RunConfig, {"preset": "sean2"} | _as_field(option)).model_dump() == without.model_dump()


def _as_field(option: str) -> dict:
    if option in ("routing", "group_membership"):
        return {"behavior": {"kind": "graph", option: OTHER[option]}}
    return {option: OTHER[option]}


def test_options_of_another_behavior_are_left_out():
    told = read("--preset sean2 --behavior random")
    assert told.behavior == RandomBehavior() and told.goal_sampling == "mesh"
    again = ScenarioConfig(people=3, behavior=GraphBehavior(congestion_cost=2.0)).replace(preset="sean2")
    assert again.behavior == GraphBehavior(routing="edge", group_membership="permanent", congestion_cost=2.0)
    assert again.people == 3 and again.replace(people=4, behavior="graph").behavior == GraphBehavior()
    assert read("--preset sean2 --behavior playback --recording walk.csv").warm_up == 0.0  # it has people of its own
    own = read("--preset sean2 --behavior my.py:parade --force my.py:push --situation my.py:near")
    assert own.behavior.kind == "my.py:parade"
    assert [part.kind for part in own.forces] == ["sean2", "my.py:push"]
    assert [part.kind for part in own.situations] == ["sean2", "my.py:near"]


@pytest.mark.parametrize("model", [RunConfig, CollectConfig])
def test_what_was_filled_in_is_repeated(model):
    """By the command, by config.yaml, and by JSON, which knows no infinity."""
    told = read("--preset sean2 --people 3 --time-limit 7", model)
    written = json.loads(json.dumps(told.identity(), allow_nan=False))
    assert written["task_distance"] == [0.0, "inf"] and "preset" not in written
    words = shlex.split(flags.command("run", told))[2:]
    for again in (validate(model, yaml.safe_load(yaml.safe_dump(written))), read(shlex.join(words), model)):
        assert again.identity() == told.identity() and again.task_distance == (0.0, math.inf)
    assert validate(model, written | {"preset": "sean2", "dynamics": "mjx"}).dynamics == "mjx"


def test_the_scenario_is_the_one_of_its_parts():
    scenario = sean_jax.make("lab", people=3, preset="sean2")
    assert scenario.robot.drive is robots.DYNAMICS["kinematic"] and scenario.navigation.mesh_places is not None
    assert jax.tree.all(jax.tree.map(jnp.array_equal, scenario.forces, social_forces.preset("sean2")))
    assert dict(scenario.situations) == classifiers.SITUATION_SETS["sean2"]
    assert float(scenario.thresholds.walking) == np.float32(0.4)
    np.testing.assert_array_equal(scenario.task_distance, [0.0, np.inf])
    times = float(scenario.goal_radius), float(scenario.hold_time), scenario.time_limit
    assert times == (np.float32(1.2), 5.0, 120.0)
    assert scenario.to_surface and not sean_jax.make("lab", people=3).to_surface
    parts = {
        "behavior": GraphBehavior(routing="edge", group_membership="permanent"),
        "goal_sampling": "mesh",
        "forces": "sean2",
    }
    same = scenarios(ScenarioConfig(environment="lab", people=3, **parts, situations="sean2", dynamics="kinematic"))[0]
    trees.assert_equal(scenario.behavior, same.behavior)
    assert jax.tree.structure(scenario.behavior) == jax.tree.structure(same.behavior)
    mine = sean_jax.make(ScenarioConfig(environment="lab", people=3), preset="sean2", dynamics="twin")
    assert mine.robot.drive is robots.DYNAMICS["twin"] and mine.navigation.mesh_places is not None


@pytest.mark.night
def test_a_run_says_what_was_filled_in(tmp_path):
    words = "--environment lab --people 2 --behavior random --time-limit 2 --episodes 2 --quiet"
    assert command_line.main(["run", "--preset", "sean2", *words.split(), "--out", str(tmp_path / "run")]) == 0
    file = tmp_path / "run" / "config.yaml"
    held = yaml.safe_load(file.read_text())["config"]
    assert held["task_distance"] == [0.0, "inf"] and held["forces"] == ["sean2"] and held["dynamics"] == "kinematic"
    description = read_config(file).description
    assert description["environment"] == str(tmp_path / "run" / "environment" / "lab")  # the copy in the run's folder
    description["environment"] = "lab"
    assert validate(RunConfig, description).identity() == validate(RunConfig, held).identity()
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert list(summary["situations"]) == list(classifiers.SITUATION_SETS["sean2"])


def test_the_page_has_each_switch_with_its_default():
    page = (ROOT / "docs" / "sean2.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([^|]+) \| `", page, re.M)

    def text(value):
        parts = value if isinstance(value, tuple) else (value,)
        return " ".join(f"`{each}`" if isinstance(each, str) else flags.number(each) for each in parts)

    usual = read("")
    assert rows == [(option, text(value(usual, option)), text(SEAN2[option])) for option in SEAN2]


def test_what_cannot_be_is_one_sentence(capsys):
    assert command_line.main(["run", "--preset", "sean3"]) == 2
    assert "--preset: 'sean3' is not one of sean2; did you mean 'sean2'?" in " ".join(capsys.readouterr().err.split())
    assert command_line.main(["run", "--preset", "sean2", "--dynamics", "cinematic"]) == 2
    assert "--dynamics: 'cinematic' is not one of twin, mjx, kinematic; did you mean 'kinematic'?" in " ".join(
        capsys.readouterr().err.split()
    )
    with pytest.raises(ValueError, match="preset: 3 is not one of sean2"):
        sean_jax.make("lab", preset=3)
    with pytest.raises(ValueError, match="the default behavior|behavior 'random' has no such option"):
        sean_jax.make("lab", preset="sean2", behavior="random", routing="edge")
    assert command_line.main(["list"]) == 0
    assert "The world of SEAN 2.0" in capsys.readouterr().out

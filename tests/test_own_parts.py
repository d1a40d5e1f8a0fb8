"""Parts from a file outside the package in every command and in Python: docs/extending.md, as it stands."""

import csv
import json
import re
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest
import yaml

import sean_jax
from sean_jax import cli, components, config, learning
from sean_jax.config import CollectConfig, RunConfig
from sean_jax.errors import InputError
from sean_jax.evaluation.output import read_config

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
SMALL = "--environment lab --people 4 --dynamics twin --time-limit 2 --quiet".split()
PARTS = [
    *("--policy", "my_parts.py:drive", "--task", "my_parts.py:across", "--force", "my_parts.py:distancing"),
    *("--situation", "my_parts.py:crowd", "--metric", "my_parts.py:near_time", "--robot", "my_robot.xml"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The page's file, and a robot that is slower than Kuri."""
    place = tmp_path_factory.mktemp("mine")
    blocks = re.findall(r"```python\n(.*?)```", PAGE.partition("## my_parts.py")[2], re.S)
    (place / "my_parts.py").write_text("\n\n".join(blocks))
    robot = (ROOT / "envs" / "robots" / "kuri.xml").read_text(encoding="utf-8")
    (place / "my_robot.xml").write_text(robot.replace('model="kuri"', 'model="my_robot"'))
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(place)
        yield place


def rows(file: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(file.open()))


@pytest.fixture(scope="module")
def run(folder):
    """A run with a part of each family that `sean run` has an option for."""
    assert cli.main(["run", *SMALL, *PARTS, "--episodes", "3", "--seed", "5", "--out", "made"]) == 0
    return folder / "made"


def test_a_run_has_own_parts_in_table_csv_and_report(run):
    found = rows(run / "episodes.csv")
    assert len(found) == 3 and {row["task"] for row in found} == {"across"}
    assert {"near_time", "near_time__crowd", "path_length__crowd"} <= found[0].keys()
    summary = json.loads((run / "summary.json").read_text())
    assert "crowd" in summary["situations"] and "near_time" in summary["metrics"]
    assert summary["scenario"]["policy"] == "drive" and summary["scenario"]["robot"] == "my_robot"
    report = (run / "report.html").read_text()
    assert "time near people" in report and "Somebody is within 1 m of the robot." in report and "crowd" in report


def test_its_config_repeats_it_to_the_byte(run, capsys):
    before = (run / "episodes.csv").read_bytes()
    assert cli.main(["run", "--config", str(run / "config.yaml"), "--out", "again", "--quiet"]) == 0
    again = run.parent / "again"
    assert (again / "episodes.csv").read_bytes() == before
    told, retold = (yaml.safe_load((place / "config.yaml").read_text()) for place in (run, again))
    assert told["config"] | {"policy": 0} == retold["config"] | {"policy": 0} and told["sha256"] == retold["sha256"]


@pytest.mark.slow
def test_a_flag_changes_a_config_and_a_changed_part_is_refused(run, capsys):
    copy = run.parent / "copy"
    shutil.copytree(run, copy)
    with (copy / "parts" / "my_parts.py").open("a") as stream:
        stream.write("\n# changed\n")
    assert cli.main(["run", "--config", str(copy / "config.yaml"), "--out", "never"]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "is not the file that the run was made with" in error and "sha256" in error
    assert not (run.parent / "never").exists()
    asked = ["run", "--config", str(run / "config.yaml"), "--episodes", "1", "--out", "fewer", "--quiet"]
    assert cli.main(asked) == 0
    first, told = rows(run.parent / "fewer" / "episodes.csv"), rows(run / "episodes.csv")
    assert len(first) == 1 and abs(float(first[0]["path_length"]) - float(told[0]["path_length"])) < 1e-4


@pytest.mark.slow
def test_demonstrations_of_an_own_policy_task_and_robot(folder):
    asked = ["collect", *SMALL, *PARTS[:4], *PARTS[-2:], "--width", "16", "--height", "12", "--hours", "0.002"]
    assert cli.main([*asked, "--batch", "2", "--out", "data"]) == 0
    data = learning.open_dataset("data")
    assert data.manifest["policy"] == "my_parts.py:drive" and data.manifest["streams"] == ["across"]
    assert data.example_count >= 7 and set(data.manifest["parts"]) == {"my_parts.py"}


def test_values_are_evaluated_as_their_file_is(run, folder):
    mine = components.load(config.OwnPart(kind="my_parts.py:drive"), "policy").__globals__
    scenario = sean_jax.make(
        "lab", people=4, dynamics="twin", time_limit=2.0, robot="my_robot.xml", task=mine["across"],
        situations={**sean_jax.SITUATIONS, "crowd": mine["crowd"]},
        metrics={**sean_jax.METRICS, "near_time": mine["near_time"]},
        forces=[*sean_jax.preset("calibrated"), mine["distancing"]],
    )  # fmt: skip
    found = sean_jax.evaluate(scenario, mine["drive"], episodes=3, seed=5, out=folder / "values")
    for name in ("near_time", "path_length"):
        expected = [float(row[name]) for row in rows(run / "episodes.csv")]
        np.testing.assert_allclose(found.metrics[name][:, 0], expected, atol=1e-5)
    assert "time near people" in found.table() and found.metrics["near_time"].shape == (3, 7)
    assert (folder / "values" / "report.html").is_file()
    with pytest.raises(InputError, match="a Python program with values of its own"):
        read_config(folder / "values" / "config.yaml")


@pytest.mark.slow
def test_behavior_model_sensor_and_a_policy_that_remembers(folder):
    mine = components.load(config.OwnPart(kind="my_parts.py:drive"), "policy").__globals__
    scenario = sean_jax.make(
        "lab", people=3, dynamics="twin", task="random_ab_nav", behavior="my_parts.py:circling",
        model="my_parts.py:gliding", sensors=["my_parts.py:counter"],
    )  # fmt: skip
    policy = mine["smooth"]
    last, frames = jax.jit(lambda policy, key: sean_jax.rollout(scenario, policy, key, 20))(policy, jax.random.key(0))
    assert scenario.behavior.name == "circling" and frames.people.shape == (20, 3, 2)
    np.testing.assert_allclose(np.linalg.norm(frames.people_velocity, axis=-1), 1.0, atol=1e-5)
    assert 0 <= int(sean_jax.sense(scenario, last)["counter"]) <= 3
    slope = jax.grad(lambda policy: sean_jax.rollout(scenario, policy, jax.random.key(0), 5)[0].robot.turn_rate)(policy)
    assert np.isfinite(float(slope.params)) and float(slope.params) != 0.0


def test_an_option_of_an_own_part_is_given_to_it(folder):
    forces = ["helbing1995", {"kind": "my_parts.py:Distancing", "strength": 3.0, "distance": 1.0}]
    scenario = sean_jax.make("lab", people=2, dynamics="twin", task="random_ab_nav", forces=forces)
    assert float(scenario.forces.distancing.strength) == 3.0


BAD = {
    "my_parts.py:driv": "has no 'driv'; did you mean 'drive'",
    "nowhere.py:drive": "nowhere.py: there is no such file",
    "broken.py:drive": r"broken.py cannot be imported: ZeroDivisionError: division by zero \(line 2 of broken.py\)",
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_wrong_with_a_file_is_told_in_one_sentence(folder, kind, capsys):
    (folder / "broken.py").write_text("drive = None\n1 / 0\n")
    assert cli.main(["run", *SMALL, "--policy", kind, "--out", "never"]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert re.search(BAD[kind], error) and error.startswith("sean: policy: "), error
    assert not (folder / "never").exists()


def test_no_file_holds_a_value():
    described = RunConfig(policy=lambda scenario, state, key: None).decisive()
    assert described["policy"] == {"kind": "value", "name": "<lambda>"}
    with pytest.raises(InputError, match="policy: was a value of a Python program"):
        config.validate(RunConfig, described)


def test_the_schema_of_config_yaml_names_every_option(capsys):
    assert cli.main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["properties"].keys() == RunConfig.model_fields.keys()
    assert "routing" in schema["$defs"]["GraphBehavior"]["properties"]
    assert CollectConfig.model_json_schema()["properties"]["hours"]["maximum"] == config.MAX_HOURS


def test_more_situations_than_can_be_counted_are_refused():
    many = {f"situation_{k}": lambda moment: moment.tick > 0 for k in range(21)}
    with pytest.raises(InputError, match="situations: 21 are more than 20; give fewer"):
        sean_jax.make("lab", people=2, dynamics="twin", task="random_ab_nav", situations=many)


def test_digests_that_are_none_are_refused_in_a_sentence(tmp_path):
    file = tmp_path / "config.yaml"
    for wrong in ("1.5", "[a, b]", "text"):
        file.write_text(f"config: {{environment: lab}}\nsha256: {wrong}\n", encoding="utf-8")
        with pytest.raises(InputError, match="sha256: .* is no list of files; give file: digest lines, or none"):
            read_config(file)

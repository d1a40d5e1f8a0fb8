"""Parts from a file outside the package in every command and in Python: docs/extending.md, as it stands."""

import csv
import hashlib
import json
import os
import py_compile
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import yaml

import sean_jax
from sean_jax import config, learning
from sean_jax.cli import command_line
from sean_jax.config import (
    BenchmarkConfig,
    CollectConfig,
    Figure4Config,
    RunConfig,
    Table1Config,
    ValidateConfig,
    flags,
    user_parts,
)
from sean_jax.config.workspace import Workspace, identity
from sean_jax.core.errors import InputError
from sean_jax.evaluation.run_folder import read_config
from sean_jax.learning import dataset
from sean_jax.learning.policy import AGENTS
from sean_jax.studies.validation import checks
from support.checkout import ROOT
from support.files import write, write_all

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
    assert command_line.main(["run", *SMALL, *PARTS, "--episodes", "3", "--seed", "5", "--out", "made"]) == 0
    return folder / "made"


@pytest.mark.night
def test_a_run_has_own_parts_in_table_csv_and_report(run):
    found = rows(run / "episodes.csv")
    assert len(found) == 3 and {row["task"] for row in found} == {"across"}
    assert {"near_time", "near_time__crowd", "path_length__crowd"} <= found[0].keys()
    summary = json.loads((run / "summary.json").read_text())
    assert "crowd" in summary["situations"] and "near_time" in summary["metrics"]
    assert summary["scenario"]["policy"] == "drive" and summary["scenario"]["robot"] == "my_robot"
    report = (run / "report.html").read_text()
    assert "time near people" in report and "Somebody is within 1 m of the robot." in report and "crowd" in report


@pytest.mark.night
def test_its_config_repeats_it_to_the_byte(run, capsys):
    before = (run / "episodes.csv").read_bytes()
    assert command_line.main(["run", "--config", str(run / "config.yaml"), "--trust", "--out", "again", "--quiet"]) == 0
    again = run.parent / "again"
    assert (again / "episodes.csv").read_bytes() == before
    told, retold = (yaml.safe_load((place / "config.yaml").read_text()) for place in (run, again))
    assert {name for name in told["config"] if told["config"][name] != retold["config"][name]} <= {
        "environment",
        "robot",
        "policy",
    }
    assert told["sha256"] == retold["sha256"]


@pytest.mark.night
def test_a_flag_changes_a_config_and_a_changed_part_is_refused(run, capsys):
    copy = run.parent / "copy"
    shutil.copytree(run, copy)
    with (copy / "parts" / "my_parts.py").open("a") as stream:
        stream.write("\n# changed\n")
    assert command_line.main(["run", "--config", str(copy / "config.yaml"), "--out", "never"]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "parts/my_parts.py: is not the file that copy/config.yaml was made with" in error.replace(
        f"{run.parent}/", ""
    )
    assert "or remove sha256 from config.yaml" in error
    assert not (run.parent / "never").exists()
    asked = ["run", "--config", str(run / "config.yaml"), "--trust", "--episodes", "1", "--out", "fewer", "--quiet"]
    assert command_line.main(asked) == 0
    first, told = rows(run.parent / "fewer" / "episodes.csv"), rows(run / "episodes.csv")
    assert len(first) == 1 and abs(float(first[0]["path_length"]) - float(told[0]["path_length"])) < 1e-4


@pytest.mark.night
def test_demonstrations_of_an_own_policy_task_and_robot(folder):
    asked = ["collect", *SMALL, *PARTS[:4], *PARTS[-2:], "--width", "16", "--height", "12", "--hours", "0.002"]
    assert command_line.main([*asked, "--batch", "2", "--out", "data"]) == 0
    data = learning.open_dataset("data")
    assert data.manifest["policy"] == "my_parts.py:drive" and data.manifest["streams"] == ["across"]
    assert data.example_count >= 7 and set(data.manifest["parts"]) == {"my_parts.py"}


@pytest.mark.night
def test_values_are_evaluated_as_their_file_is(run, folder):
    mine = user_parts.load(config.OwnPart(kind="my_parts.py:drive"), "policy").__globals__
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


@pytest.mark.night
def test_behavior_model_sensor_and_a_policy_that_remembers(folder):
    mine = user_parts.load(config.OwnPart(kind="my_parts.py:drive"), "policy").__globals__
    scenario = sean_jax.make(
        "lab", people=3, dynamics="twin", task="random_ab_nav", behavior="my_parts.py:circling",
        model="my_parts.py:gliding", sensors=["my_parts.py:counter"],
    )  # fmt: skip
    policy = mine["smooth"]

    def turn_rate(policy):
        last, frames = sean_jax.rollout(scenario, policy, jax.random.key(0), 5)
        return last.robot.turn_rate, (sean_jax.sense(scenario, last)["counter"], frames)

    (_, (count, frames)), slope = jax.jit(jax.value_and_grad(turn_rate, has_aux=True))(policy)
    assert scenario.behavior.name == "circling" and frames.people.shape == (5, 3, 2)
    np.testing.assert_allclose(np.linalg.norm(frames.people_velocity, axis=-1), 1.0, atol=1e-5)
    assert 0 <= int(count) <= 3
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
    assert command_line.main(["run", *SMALL, "--policy", kind, "--out", "never"]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert re.search(BAD[kind], error) and error.startswith("sean: policy: "), error
    assert not (folder / "never").exists()


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder to work in, where Python writes and reads bytecode as it usually does."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    return tmp_path


def thing(name: str = "my.py:f"):
    return user_parts.load(config.OwnPart(kind=name), "policy")


def test_what_runs_is_what_the_file_holds_now(place):
    """Contents of one size that are written within a second: bytecode tells them apart by neither."""
    digests = set()
    for k in range(1, 9):
        for name, text in {
            "my": f"from helper import y\n\ndef f():\n    return {k}, y\n",
            "helper": f"y = {k}\n",
        }.items():
            (place / f"{name}.py").write_text(text)
            os.utime(place / f"{name}.py", (1e9, 1e9))
        assert thing()() == (k, k)
        digests.add(user_parts.content("my.py").digest)
    assert len(digests) == 8 and thing() is thing()
    (place / "helper.py").write_text("y = 7\n")
    assert thing()() == (8, 7)


def test_bytecode_beside_a_file_is_never_run(place):
    for name in ("my", "helper"):
        (place / f"{name}.py").write_text("def f():\n    return 'forged'\n")
        cached = py_compile.compile(f"{name}.py", invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
        (place / f"{name}.py").write_text("def f():\n    return 'true'\n")
        assert cached is not None and Path(cached).is_file()
    (place / "both.py").write_text("import my, helper\n\ndef f():\n    return my.f(), helper.f()\n")
    assert thing()() == "true" and thing("both.py:f")() == ("true", "true")
    assert not list(place.rglob("both*.pyc"))


def tree(rng: random.Random) -> dict[str, str]:
    """Modules at random that import each other in all ways of Python, those of packages with dots, too."""
    names = ["my", *rng.sample(["a", "b", "p", "p.c", "p.d", "q.e", "json", "colorsys"], 6)]
    names = [name for name in names if name != "p"] + ["p"] * any(name[:2] == "p." for name in names)
    texts = {}
    for number, name in enumerate(names):
        lines = [f"value = [{rng.randrange(100)}]"]
        for other in names[:0:-1][: len(names) - 1 - number]:  # never in a circle
            if other.startswith(f"{name}.") or name.startswith(f"{other}."):
                continue
            above, _, last = other.rpartition(".")
            ways = [f"import {other}\nvalue += {other}.value", f"from {other} import value as v\nvalue += v"]
            ways.append(f"import {other} as m\nvalue += m.value")
            ways.append(f"def late():\n    from {other} import value\n    return value\nvalue += late()")
            ways += [f"from {above} import {last}\nvalue += {last}.value"] * bool(above)
            if above and name.startswith(f"{above}."):
                ways += [f"from . import {last}\nvalue += {last}.value", f"from .{last} import value as v\nvalue += v"]
            if rng.random() < 0.6:
                lines.append(rng.choice(ways))
        texts[name] = "\n".join(lines)
    texts["my"] += "\n\ndef f():\n    return value\n"
    paths = {name: name.replace(".", "/") + ("/__init__.py" if name == "p" else ".py") for name in names}
    return {paths[name]: text for name, text in texts.items()}


def test_imports_beside_a_file_are_those_of_a_script(place):
    """The oracle is Python itself, which runs each file as a script, and tells which modules it has read."""
    ask = "import sys, my; print(my.value, [m.__file__ for m in sys.modules.values() if hasattr(m, 'value')])"
    rng = random.Random(int(os.environ.get("SEAN_JAX_FUZZ_SEED", 0)))
    for number in range(12):
        folder = write_all(place / f"{number}", tree(rng))
        found = thing(f"{number}/my.py:f")()
        held = user_parts.content(folder / "my.py").digests
        ran = subprocess.run([sys.executable, "-S", "-B", "-c", ask], cwd=folder, capture_output=True, text=True)
        value, _, read = ran.stdout.partition("] ")
        assert ran.returncode == 0 and str(found) == f"{value}]", (number, ran.stderr)
        read = {Path(file).relative_to(folder).as_posix() for file in eval(read) if Path(file).is_relative_to(folder)}
        assert read <= held.keys() and "my.py" in read, number
        for path, digest in held.items():
            assert hashlib.sha256((folder / path).read_bytes()).hexdigest() == digest


def test_what_is_not_beside_a_file_is_told(place):
    (place / "my.py").write_text("import p.q\n")
    write(place / "p" / "__init__.py", "")
    with pytest.raises(
        InputError, match=r"^policy: my.py cannot be imported: .*No module named 'p.q' \(line 1 of my.py"
    ):
        thing()
    for text, message in {"import sys; sys.exit()": "SystemExit", "def f(:": "SyntaxError", "\0": "null byte"}.items():
        (place / "my.py").write_text(text)
        with pytest.raises(InputError, match=f"cannot be imported: .*{message}"):
            thing()


def test_a_command_reads_a_file_once(place):
    (place / "my.py").write_text("import b\n\ndef f():\n    return b.v\n")
    (place / "other.py").write_text("import b\n\ndef f():\n    return b.v\n")
    (place / "b.py").write_text("v = 1\n")
    with user_parts.read_once():
        assert thing()() == 1
        (place / "b.py").write_text("v = 2\n")
        assert thing()() == 1 and thing("other.py:f")() == 1
        kept = config.RunConfig(policy="my.py:f", metrics="other.py:f")  # pyright: ignore
        copied = user_parts.input_files(kept)
        hashes = copied.bundle(place / "kept")
        assert user_parts.digests(kept).keys() == {"my.py", "other.py", "b.py"}
    assert copied.copies == {name: f"parts/{name}" for name in ("my.py", "b.py", "other.py")}
    assert (place / "kept" / "parts" / "b.py").read_text() == "v = 1\n" and len(hashes) == 3
    assert thing()() == 2


def test_what_was_begun_with_another_file_is_not_gone_on_with(place):
    """Experiments and benchmarks tell by the record; drivers that are added later are recorded then."""
    (place / "my.py").write_text("f = 1\n")
    (place / "more.py").write_text("f = 1\n")
    for kind, own in [(Table1Config, {"policies": "expert,my.py:f"}),
                      (BenchmarkConfig, {"policy": "my.py:f"})]:  # fmt: skip
        options = kind(**own, out=place / kind.__name__)
        options.folder.mkdir()
        Workspace(options.folder, identity(options)).begin()
        assert Workspace(options.folder, identity(options)).begun()
        (place / "my.py").write_text("f = 2\n")
        with pytest.raises(InputError, match="was begun with another my.py; ask for the same or choose another --out"):
            Workspace(options.folder, identity(options)).begun()
        (place / "my.py").write_text("f = 1\n")
    (place / "figure4").mkdir()
    for others in ("none", "none,more.py:f"):
        options = Figure4Config(baselines=others, out=place / "figure4")
        Workspace(options.folder, identity(options)).begin()
    (place / "more.py").write_text("f = 2\n")
    with pytest.raises(InputError, match="was begun with another more.py"):
        Workspace(options.folder, identity(options)).begin()


def test_a_row_of_a_validation_is_that_of_the_force_of_now(place):
    """A law of one's own with the same constants."""
    law = """
import sean_jax
from flax import struct

@struct.dataclass
class Law:
    strength: float = 1.0

    def pair(self, pair):
        return self.strength * pair.dx, NUMBER * pair.dy

f = [*sean_jax.preset("helbing1995"), Law()]
"""
    laws = set()
    for number in ("1.0", "2.0"):
        (place / "my.py").write_text(law.replace("NUMBER", number))
        (model,) = checks.models_of("my.py:f", typed=True)
        laws.add(json.dumps(checks._provenance(model, ValidateConfig())))
    assert len(laws) == 2


CODE = """
import pathlib

(pathlib.Path(__file__).parent / "ran").touch()
raise ValueError("it ran")
"""
FIELDS = ["behavior", "task", "robot", "model", "forces", "situations", "metrics", "sensors", "policy"]
NAMED = {  # command -> the option whose code it would run
    **{f"run --config {field}/config.yaml": field for field in FIELDS},
    **{f"replay {field}": field for field in FIELDS},
    "run --policy agent": "observations",
    "run --policy training": "critic",
    "collect --policy agent": "observations",
    "collect --labels training": "critic",
    "train ppo --imitate training": "critic",
    "train dagger dataset --expert expert --hours 0.02": "task",
    "experiment table1 --quick --policies agent": "observations",
    "experiment figure4 --quick --baselines training": "critic",
    "benchmark run agent --quick": "observations",
    "export agent training --out new": "critic",
    "replay training": "critic",
    "replay imitates": "imitate",
    "replay learned": "task",
    "replay dataset": "task",
    "replay validated": "models",
}


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """Folders of all kinds in whose files code is named."""
    folder = tmp_path_factory.mktemp("named")
    (folder / "code.py").write_text(CODE)
    for field in FIELDS:
        (folder / field).mkdir()
        (folder / field / "episodes.csv").write_text("episode,task,completed,timed_out,seconds\n0,a,True,False,1.0\n")
        (folder / field / "config.yaml").write_text(
            f"environment: lab\npeople: 2\ndynamics: twin\n{field}: code.py:f\n"
        )
    saved = json.loads((AGENTS["ppo"] / "config.json").read_text())
    for name, own in {"agent": "observations", "training": "critic", "imitates": "imitate"}.items():
        shutil.copytree(AGENTS["ppo"], folder / name)
        value = "code.py:f" if own == "imitate" else [*saved.get(own, []), "code.py:f"]
        (folder / name / "config.json").write_text(json.dumps(saved | {own: value}))
        if name != "agent":
            (folder / name / "weights.npz").unlink()
            (folder / name / "checkpoints").mkdir()
    camera, shard = {"width": 16, "height": 12}, dict(stream=0, lengths=[3], completed=[True])
    sizes = dict.fromkeys(dataset.fields(1, 1, 1), 1)
    manifest = dict(
        format=1, command="sean collect", options={"environment": "lab", "task": ["code.py:f"]}, hours=0.01, batch=1,
        seconds=120, rate=1, streams=["a"], situations=["b"], camera=camera, robot={"name": "kuri"},
        shards=[{**shard, "bytes": sizes}],
    )  # fmt: skip
    for name, file, content in [
        ("dataset", "dataset.json", manifest),
        ("learned", "config.json", {"dataset": {"command": "sean collect --environment lab --task code.py:f"}}),
        ("validated", "results.json", {"command": "sean validate --models code.py:f", "rows": [{"check": "rimea-1"}]}),
    ]:
        (folder / name).mkdir()
        (folder / name / file).write_text(json.dumps(content))
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        yield folder


@pytest.mark.parametrize("words", NAMED)
def test_code_that_a_file_names_does_not_run(named, words, capsys):
    """With ``--trust`` it runs, which it tells by an error of its own."""
    small = "--environment lab --people 2 --dynamics twin".split() if "ppo" in words else []
    begin = set(named.rglob("*"))
    assert command_line.main([*words.split(), *small]) == 2
    error = " ".join(capsys.readouterr().err.split())
    pattern = rf"{NAMED[words]}: \S*code.py:f is code, and \S+ names it, not you; read it, then add --trust \(in Python"
    assert re.search(pattern, error), error
    assert set(named.rglob("*")) == begin
    assert command_line.main([*words.split(), *small, "--trust"]) == 2
    error = " ".join(capsys.readouterr().err.split())
    if words.startswith("train dagger"):  # whose networks learn before one drives
        assert "dataset has 1 episodes" in error
        return
    assert "code.py cannot be imported: ValueError: it ran" in error, error
    (named / "ran").unlink()


def test_in_python_a_file_is_trusted_within_a_block_alone(named):
    lab = sean_jax.make("lab", behavior="random", people=2, dynamics="twin")
    with pytest.raises(InputError, match=r"code.py:f is code, and agent.config.json names it, not you"):
        learning.load("agent", lab)
    with sean_jax.trust(), sean_jax.trust(), pytest.raises(InputError, match="it ran"):
        learning.load("agent", lab)
    (named / "ran").unlink()
    with pytest.raises(InputError, match="not you"):
        sean_jax.evaluate(lab, "training", episodes=1)
    with pytest.raises(InputError, match="it ran"):
        sean_jax.make("lab", task="code.py:f")
    (named / "ran").unlink()


def test_to_compare_runs_nothing(named):
    assert command_line.main(["compare", "policy", "metrics", "--out", "page.html", "--quiet"]) == 0
    assert not (named / "ran").exists()
    (named / "page.html").unlink()


@pytest.mark.parametrize("field", FIELDS)
def test_only_what_is_typed_is_yours(named, field, capsys):
    """Of a description that flags change, and of its copies with other values."""
    text = f"environment: lab\n{field}: {{kind: code.py:f, size: 1}}\n"
    (named / "mixed.yaml").write_text(
        text if field in ("robot", "model", "policy") else text.replace("size: 1", "routing: whole")
    )

    def read(*words):
        given = flags.parse("run", RunConfig, ["--config", "mixed.yaml", *words], configurable=True)
        return dict(user_parts._parts(command_line._read(RunConfig, given).replace(people=3)))

    source = Path("mixed.yaml")
    assert {name: part.named_in for name, part in read().items()} == {field: source}
    singular = {"forces": "force", "situations": "situation", "metrics": "metric", "sensors": "sensor"}.get(field)
    if singular:
        config = flags.parse(
            "run", RunConfig, ["--config", "mixed.yaml", f"--{singular}", "my.py:g"], configurable=True
        )
        parts = getattr(command_line._read(RunConfig, config), field)
        assert [(part.kind, part.named_in) for part in parts] == [("code.py:f", source), ("my.py:g", None)]
        assert [part.is_typed for part in parts] == [False, True]
    else:
        part = read(f"--{field}", "my.py:g")[field]
        assert part.named_in is None and part.is_typed
    if field == "behavior":
        (part,) = read("--routing", "edge").values()
        assert part.named_in == source and part.options["routing"] == "edge"
    (named / "mixed.yaml").write_text(f"config: {{{field}: code.py:f, trust: true}}\n")
    assert command_line.main(["run", "--config", "mixed.yaml"]) == 2
    assert "'trust' is not a known key" in capsys.readouterr().err


def test_no_file_holds_a_value():
    described = RunConfig(policy=lambda scenario, state, key: None).identity()
    assert described["policy"] == {"kind": "value", "name": "<lambda>"}
    with pytest.raises(InputError, match="policy: was a Python value"):
        config.validate(RunConfig, described)


def test_the_schema_of_config_yaml_names_every_option(capsys):
    assert command_line.main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["properties"].keys() == RunConfig.model_fields.keys()
    assert "routing" in schema["$defs"]["GraphBehavior"]["properties"]
    assert CollectConfig.model_json_schema()["properties"]["hours"]["maximum"] == config.MAX_HOURS


def test_more_situations_than_can_be_counted_are_refused():
    many = {f"situation_{k}": lambda snapshot: snapshot.tick > 0 for k in range(21)}
    with pytest.raises(InputError, match="situations: 21 are more than 20; give fewer"):
        sean_jax.make("lab", people=2, dynamics="twin", task="random_ab_nav", situations=many)


def test_digests_that_are_none_are_refused_in_a_sentence(tmp_path):
    file = tmp_path / "config.yaml"
    for wrong in ("1.5", "[a, b]", "text"):
        file.write_text(f"config: {{environment: lab}}\nsha256: {wrong}\n", encoding="utf-8")
        with pytest.raises(InputError, match="sha256: .* is no list of files; give file: digest lines, or none"):
            read_config(file)

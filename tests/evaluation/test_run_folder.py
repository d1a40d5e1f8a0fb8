"""Files that a description names: copied beside a config.yaml, and read from there."""

import json
import random
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sean_jax.cli import command_line
from sean_jax.config import RunConfig, validate
from sean_jax.core.errors import InputError
from sean_jax.evaluation import compare, replay_command, run_folder, run_plan
from sean_jax.world import environment
from support import mjcf
from support.files import write

FILES = ["environment.yaml", "graph.yaml", "handcrafted.yaml", "scene.xml"]
SMALL = "--people 4 --dynamics twin --time-limit 6 --episodes 2 --quiet".split()


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """A folder to work in, with an environment, a robot, forces and a recording of one's own."""
    work = tmp_path / "work"
    shutil.copytree(environment.ENVS / "lab", work / "mine" / "hall")
    shutil.copyfile(environment.ENVS / "robots" / "kuri.xml", work / "mine" / "robot.xml")
    (work / "mine" / "forces.yaml").write_text("preset: helbing1995\n")
    (work / "mine" / "people.csv").write_text("frame,id,x,y\n0,1,0,0\n1,1,0.1,0\n")
    monkeypatch.chdir(work)
    return work


def described(**options: Any) -> RunConfig:
    return validate(RunConfig, {"environment": "mine/hall", **options})


def written(folder: Path, config: RunConfig) -> Path:
    """The config.yaml of a run of that description."""
    folder.mkdir(parents=True)
    run_plan.write_config(folder, {"people": 4, "versions": {"python": "3"}}, run_plan.plan_run(config))
    return folder / "config.yaml"


@pytest.mark.parametrize("name", FILES)
def test_an_environment_is_read_from_the_run_when_it_was_changed(place, name):
    file = written(place / "run", described())
    before = {each: (place / "mine" / "hall" / each).read_bytes() for each in FILES}
    same = run_folder.read_config(file)
    with (place / "mine" / "hall" / name).open("a") as stream:
        stream.write("\n<!-- moved -->\n" if name.endswith("xml") else "\n# moved\n")
    config_file = run_folder.read_config(file)
    copy = Path(config_file.description["environment"])
    assert copy.name == "hall" and copy.is_relative_to(place / "run")
    assert {each: (copy / each).read_bytes() for each in FILES} == before
    assert config_file == same


def test_a_run_is_repeated_where_its_files_are_not(place, monkeypatch, tmp_path):
    options = {"robot": "mine/robot.xml", "forces": ["mine/forces.yaml"]}
    written(place / "runs" / "one", described(**options))
    elsewhere = tmp_path / "elsewhere"
    shutil.move(place / "runs" / "one", elsewhere)
    shutil.rmtree(place / "mine")
    monkeypatch.chdir(tmp_path)
    config_file = run_folder.read_config(Path("elsewhere/config.yaml"))
    config = validate(RunConfig, config_file.description)
    found = [Path(config.environment), Path(config.robot.kind), Path(config.forces[0].kind)]
    assert all(path.exists() and path.resolve().is_relative_to(elsewhere) for path in found)
    environment.load(config.environment)


def test_files_that_a_robot_and_a_scene_read_are_copied_along(place):
    robot = place / "mine" / "robot.xml"
    robot.write_text(mjcf.with_includes(robot.read_text(), "more/limits.xml"))
    write(place / "mine" / "more" / "limits.xml", mjcf.EMPTY)
    file = written(place / "run", described(robot="mine/robot.xml"))
    (place / "mine" / "more" / "limits.xml").write_text(mjcf.scene())
    config_file = run_folder.read_config(file)
    copy = Path(config_file.description["robot"])
    assert (copy.parent / "more" / "limits.xml").read_text() == mjcf.EMPTY


def test_what_a_scene_reads_outside_its_folder_is_not_copied_and_must_be_as_it_was(place):
    (place / "mine" / "wall.xml").write_text(mjcf.EMPTY)
    scene = place / "mine" / "hall" / "scene.xml"
    scene.write_text(mjcf.with_includes(scene.read_text(), "../wall.xml"))
    file = written(place / "run", described())
    assert [path.name for path in (place / "run").rglob("*")] == ["config.yaml"]
    run_folder.read_config(file)
    (place / "mine" / "wall.xml").write_text(mjcf.scene())
    with pytest.raises(InputError, match=r"wall\.xml: is not the file that the run was made with"):
        run_folder.read_config(file)


def test_two_files_of_one_name_are_two_copies(place):
    names = ["mine/sensor.yaml", "other/sensor.yaml"]
    for name in names:
        write(place / name, f"kind: {name}\n")
    file = written(place / "run", described(sensors=names))
    for name in names:
        (place / name).unlink()
    copies = run_folder.read_config(file).description["sensors"]
    assert [Path(copy).read_text() for copy in copies] == [f"kind: {name}\n" for name in names]


def test_a_recording_stays_where_it_is_and_a_changed_one_is_refused(place, monkeypatch, tmp_path):
    behavior = {"kind": "playback", "recording": "mine/people.csv"}
    file = written(place / "run", described(behavior=behavior))
    monkeypatch.chdir(tmp_path)
    config_file = run_folder.read_config(file)
    assert config_file.description["behavior"]["recording"] == str(place / "mine" / "people.csv")
    (place / "mine" / "people.csv").write_text("frame,id,x,y\n0,1,0,0\n1,1,0.2,0\n")
    with pytest.raises(InputError, match=r"people\.csv: is not the file that the run was made with"):
        run_folder.read_config(file)
    run_folder.read_config(file, check=False)


def test_a_changed_copy_is_refused(place):
    """Any byte of any copy."""
    file, draw = written(place / "run", described(robot="mine/robot.xml")), random.Random(0)
    copies = [path for path in (place / "run").rglob("*") if path.is_file() and path != file]
    assert len(copies) == len(FILES) + 1
    for path in copies:
        content = bytearray(path.read_bytes())
        content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        before = path.read_bytes()
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"{path.name}: is not the file that the run was made with"):
            run_folder.read_config(file)
        path.write_bytes(before)
    run_folder.read_config(file)


@pytest.mark.parametrize("text", ["copies: 7", "copies: {a: 7}", "copies: [a]"])
def test_lines_of_copies_that_are_none_are_refused(tmp_path, text):
    (tmp_path / "config.yaml").write_text(f"config: {{environment: lab}}\n{text}\n")
    with pytest.raises(InputError, match="copies: .* is no list of files; give file: copy lines, or none"):
        run_folder.read_config(tmp_path / "config.yaml")


def test_runs_are_compared_by_the_content_of_their_files_and_not_by_their_names(place):
    """Of a copy elsewhere the episodes are the same; of a changed one under the same name they are others."""
    shutil.copytree(place / "mine" / "hall", place / "hall")
    runs = []
    for number, name in enumerate(("mine/hall", "hall", "hall")):
        if number == 2:
            graph = (place / "hall" / "graph.yaml").read_text()
            (place / "hall" / "graph.yaml").write_text(graph.replace("2.526", "-1.474"))
        folder = written(place / f"run{number}", described(environment=name)).parent
        (folder / "episodes.csv").write_text("episode,task,completed,timed_out,seconds\n0,join_group,True,False,5\n")
        runs.append(compare.read_run(folder))
    assert compare.differing_options(runs[0], runs[1]) == [] and compare.paired(runs[0], runs[1]) == 1
    assert compare.differing_options(runs[1], runs[2]) == ["environment"] and compare.paired(runs[1], runs[2]) == 0


def test_why_an_episode_is_another_is_told_as_far_as_it_is_known():
    assert replay_command._cause({"jax": "0.1"}, "a", "a").startswith("it was made with jax 0.1, not")
    assert "has no fingerprint" in replay_command._cause({}, "", "a")
    assert "was another" in replay_command._cause({}, "b", "a")
    assert "rounding" in replay_command._cause({}, "a", "a")


@pytest.mark.night
def test_a_group_that_was_moved_stays_where_it_was_in_a_replay_and_a_repeated_run(place, tmp_path, monkeypatch, capfd):
    assert command_line.main(["run", "--environment", "mine/hall", *SMALL, "--out", "run"]) == 0
    graph = place / "mine" / "hall" / "graph.yaml"
    graph.write_text(graph.read_text().replace("2.526", "-1.474"))
    monkeypatch.chdir(tmp_path)
    capfd.readouterr()
    assert command_line.main(["replay", str(place / "run")]) == 0
    text = (place / "run" / "replay.html").read_text(encoding="utf-8")
    (held,) = re.findall(r'<script type="application/json" id="replay">(.*?)</script>', text, re.S)
    recording = json.loads(held)
    meeting = recording["graph"]["names"].index("meeting")
    np.testing.assert_allclose(recording["graph"]["position"][meeting], [2.53, 0.25], atol=0.01)
    assert "in the run:" not in recording["episodes"][0]["outcome"]
    assert command_line.main(["run", "--config", str(place / "run" / "config.yaml"), "--out", "again", "--quiet"]) == 0
    assert (tmp_path / "again" / "episodes.csv").read_bytes() == (place / "run" / "episodes.csv").read_bytes()

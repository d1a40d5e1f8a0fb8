"""``sean replay`` of datasets, trainings and validations: what is played is what the folder was made of."""

import json
import shutil
import subprocess
from typing import Any

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax import scenes
from sean_jax.cli import command_line
from sean_jax.config import PPOConfig
from sean_jax.core import random_streams
from sean_jax.people.recordings import Tracks
from sean_jax.studies.validation.replay import trajectory
from support.replays import played
from support.scenes import room

LAB = "--environment lab --behavior random --people 2 --dynamics twin".split()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    pytest.importorskip("tensorstore")
    out = tmp_path_factory.mktemp("data") / "demonstrations"
    words = "--time-limit 4 --hours 0.01 --batch 4 --width 16 --height 12 --noise 0.3 --quiet --out".split()
    assert command_line.main(["collect", *LAB, *words, str(out)]) == 0
    return out


@pytest.mark.night
def test_demonstrations_are_driven_again(dataset, capsys):
    """Each second the robot is where the dataset's row was recorded, with the speed of then, led astray as then."""
    from sean_jax.learning.dataset import open_dataset

    assert command_line.main(["replay", str(dataset), "--episodes", "5", "0", "--quiet"]) == 0
    ((first, second),) = (part["episodes"] for part in played(dataset / "replay.html"))
    data = open_dataset(dataset)
    shards = data.manifest["shards"]
    for number, episode in ((5, first), (0, second)):
        assert episode["title"].startswith(f"episode {number} · ") and "in the dataset" not in episode["outcome"]
        (recorded,) = [each for each in data.episodes if each.number == number]
        assert recorded.length == shards[number // 4]["lengths"][number % 4] == -(-episode["frames"] // 10)
        rows, columns = data.read([recorded]), episode["columns"]  # rows are before each second's first step
        where = np.stack([columns["robot x"][9::10, 0], columns["robot y"][9::10, 0]], -1)[: recorded.length - 1]
        np.testing.assert_allclose(rows["pose"][1:, :2], where, atol=0.01)
        speed = columns["speed"][9::10, 0][: recorded.length - 1]
        np.testing.assert_allclose(np.abs(rows["velocity"][1:, 0]), speed, atol=2e-3)
    assert command_line.main(["replay", str(dataset), "--episodes", str(4 * len(shards))]) == 2
    assert f"is none of the {4 * len(shards)} of" in capsys.readouterr().err


@pytest.mark.night
def test_a_network_that_imitates_drives_where_its_demonstrations_were(dataset, tmp_path):
    from sean_jax import learning

    out = tmp_path / "network"
    words = "--epochs 1 --batch 16 --width 8 --quiet --out".split()
    assert command_line.main(["train", "imitation", str(dataset), *words, str(out)]) == 0
    assert command_line.main(["replay", str(out), "--episodes", "3", "--quiet"]) == 0
    ((episode,),) = (part["episodes"] for part in played(out / "replay.html"))
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", time_limit=4.0)
    policy = learning.load(out, scenario)
    key = jax.random.fold_in(random_streams.key("evaluation", 0), 3)
    frames = jax.jit(lambda key: sean_jax.rollout(scenario, policy, key, 40)[1])(key)
    length = episode["frames"]
    assert length == int(frames.active.sum())
    np.testing.assert_allclose(episode["columns"]["robot x"][:, 0], frames.position[:length, 0], atol=0.02)


@pytest.mark.night
def test_episodes_of_an_evaluation_are_those_that_the_training_measured(tmp_path):
    from sean_jax.learning import reinforcement

    fields: dict[str, Any] = dict(
        method="ppo", environment="lab", behavior="random", people=2, time_limit=4.0, scenarios=8, horizon=8,
        minibatches=2, epochs=2, width=16, pool=8, evaluate_every=3, evaluation_episodes=3, steps=8 * 8 * 6,
        metrics=["mean_speed"], observations=["goal", "speeds"], rewards=["progress", "time"], out=tmp_path / "agent",
        terminations="intimate",
    )  # fmt: skip
    asked = PPOConfig(**fields)
    state = reinforcement.train(asked)
    assert command_line.main(["replay", str(asked.folder), "--episodes", "0", "1", "2", "--quiet"]) == 0
    (page,) = played(asked.folder / "replay.html")
    lines = [json.loads(line) for line in (asked.folder / "metrics.jsonl").read_text().splitlines()]
    (best,) = [line["evaluation"] for line in lines if line["epoch"] == int(state.best.update[0])]
    speeds = [each["columns"]["speed"].mean() for each in page["episodes"]]
    assert np.mean(speeds) == pytest.approx(best["mean_speed"], abs=0.01)


@pytest.mark.web
def test_a_validation_plays_the_scenes_of_its_tests(tmp_path, capsys):
    """One person walks 40 m in the time that was measured; there is no robot, and there are no situations."""
    out = tmp_path / "validation"
    assert command_line.main(["validate", "--only", "rimea-1,imo-1", "--out", str(out), "--quiet"]) == 0
    assert command_line.main(["replay", str(out), "--quiet"]) == 0
    (page,) = played(out / "replay.html")
    assert page["robot"] is None and page["situations"] == [] and len(page["place"]["obstacles"]) == 2
    columns = page["episodes"][0]["columns"]
    assert "robot x" not in columns
    there = columns["person present"][:, 0] > 0.5
    way = np.ptp(columns["person x"][there, 0])
    (row,) = [row for row in json.loads((out / "results.json").read_text())["rows"] if row["check"] == "rimea-1"]
    (seconds,) = [value for name, value in row["numbers"].items() if "time" in name]
    assert there.sum() * 0.1 >= seconds - 0.2 and way / (there.sum() * 0.1) == pytest.approx(40 / seconds, rel=0.05)
    assert command_line.main(["replay", str(out), "--only", "imo-1,rimea-1", "--quiet"]) == 0
    assert len(played(out / "replay.html")) == 2
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is not None:  # a player is ready as soon as it has drawn
        words = [chromium, "--headless", "--no-sandbox", "--virtual-time-budget=5000", "--dump-dom"]
        shown = subprocess.run([*words, (out / "replay.html").as_uri()], capture_output=True, timeout=120, text=True)
        assert shown.stdout.count('data-ready="0"') == 2 and ">follow<" not in shown.stdout
    capsys.readouterr()
    assert command_line.main(["replay", str(out), "--only", "rimea-6"]) == 2
    assert "'rimea-6' is none of the tests" in capsys.readouterr().err


def test_who_goes_around_a_periodic_scene_does_not_cross_it():
    """A person leaves at the right and comes back at the left: absent in between, with their place as it was."""
    x = np.array([8.0, 9.0, 9.9, 0.8, 1.7])
    people = np.stack([x, np.zeros(5)], -1)[:, None]

    arrays: dict[str, Any] = dict(
        position=people, facing=np.ones((5, 1, 2)), group=np.full((5, 1), -1), present=np.ones((5, 1), bool),
        person=np.zeros((5, 1), int), frame=np.arange(5),
    )  # fmt: skip
    tracks = Tracks(**arrays, time_step=0.1)
    scene: Any = scenes.Scene(walls=np.zeros((0, 5)), walkers=None, period=10.0)  # pyright: ignore
    frames = trajectory(scene, tracks)
    assert frames.present[:, 0].tolist() == [True, True, False, True, True]


@pytest.mark.night
def test_an_agent_of_several_environments_is_seen_in_one_of_them(tmp_path, capsys):
    for name in ("one", "other"):
        room(tmp_path / name, (-4, -4, 4, 4), name=name)
    places = f"{tmp_path / 'one'},{tmp_path / 'other'}"
    options = {"method": "ppo", "environment": places, "behavior": {"kind": "random"}, "people": 2}
    (tmp_path / "config.json").write_text(json.dumps(options))
    assert command_line.main(["replay", str(tmp_path), "--episodes", "2", "3"]) == 2
    assert "those are in one and other" in capsys.readouterr().err
    assert command_line.main(["replay", str(tmp_path), "--episodes", "3", "5"]) == 2
    assert "checkpoint" in capsys.readouterr().err


def test_other_folders_are_refused_in_a_sentence(tmp_path, capsys):
    assert command_line.main(["replay", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "holds no config.yaml, dataset.json, config.json" in said and said.count("\n") <= 2
    (tmp_path / "results.json").write_text('{"rows": [], "command": "sean bench"}')
    assert command_line.main(["replay", str(tmp_path)]) == 2
    assert "was not made by `sean validate`" in capsys.readouterr().err

"""From demonstrations to a driver, as a user does it (section V): slow."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

from sean_jax import learning
from sean_jax.cli import command_line
from sean_jax.learning.dataset import open_dataset
from sean_jax.simulation import episodes
from support import learning_data
from support.commands import cpu_devices, python

pytestmark = pytest.mark.night


def test_a_learned_driver_completes_most_of_what_its_teacher_does(tmp_path):
    small = ["--environment", "lab", "--people", "4", "--dynamics", "twin", "--time-limit", "40", "--quiet"]
    size = ["--width", "16", "--height", "12", "--batch", "8"]
    data, run = str(tmp_path / "data"), str(tmp_path / "run")
    assert command_line.main(["collect", *small, *size, "--hours", "0.3", "--out", data]) == 0
    trained = ["--batch", "128", "--epochs", "100", "--quiet", "--out", run]
    assert command_line.main(["train", "imitation", data, *trained]) == 0
    asked = ["--task", "join_group", "--episodes", "4", "--out", str(tmp_path / "report"), "--policy", run]
    assert command_line.main(["run", *small, *asked]) == 0
    summary = json.loads((tmp_path / "report" / "summary.json").read_text())
    assert summary["scenario"]["policy"] == Path(run).name and summary["episodes"] == 4
    scenario = learning_data.streams(learning_data.options(time_limit=40.0))["join_group"]
    keys = jax.random.split(jax.random.key(77), 64)  # episodes that nobody has seen

    def share(policy):
        run = jax.jit(jax.vmap(lambda key: episodes.rollout(scenario, policy, key, 400)[0].completed))
        completed = np.asarray(run(keys))
        return float(np.mean(completed))

    teacher, pupil = share(learning_data.DRIVE), share(learning.load(run, scenario))
    assert teacher > 0.5 and pupil > 0.5 * teacher, (teacher, pupil)


def test_two_devices_collect_and_learn_what_one_does(tmp_path):
    """Equal to rounding: what is recorded, and the losses of a training on the same records.

    Crowds are chaotic: some records differ by more, which a loss shows.
    """
    options = ["--environment", "lab", "--people", "4", "--dynamics", "twin", "--time-limit", "10", "--quiet"]
    options += ["--width", "16", "--height", "12", "--batch", "8", "--hours", "0.02"]
    runs = []
    for count in (1, 2):
        data, run = str(tmp_path / f"data{count}"), str(tmp_path / f"run{count}")
        learn = ["train", "imitation", str(tmp_path / "data1"), "--batch", "32", "--width", "16", "--epochs", "3"]
        for command in (["collect", *options, "--out", data], [*learn, "--quiet", "--out", run]):
            python("-m", "sean_jax", *command, env=cpu_devices(count))
        dataset = open_dataset(data)
        lines = (tmp_path / f"run{count}" / "metrics.jsonl").read_text().splitlines()
        runs.append((dataset.read(dataset.episodes)["pose"], [json.loads(line)["train"]["loss"] for line in lines]))
    (pose, loss), (other_pose, other_loss) = runs
    assert pose.shape == other_pose.shape
    assert np.median(np.abs(pose - other_pose)) < 1e-4
    np.testing.assert_allclose(loss, other_loss, rtol=1e-3)

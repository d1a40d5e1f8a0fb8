"""Kills at random moments: nothing that was finished is lost, and the same command comes to the same bytes."""

import json
import os
import random
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from support import forked
from support.files import contents

pytestmark = [
    pytest.mark.night,
    pytest.mark.skipif(not hasattr(os, "fork") or not Path("/proc/self/stat").exists(), reason="needs fork and /proc"),
]
KILLS = 20
SMALL = "--environment lab --behavior random --task random_ab_nav --people 2 --dynamics twin --seed 3 --quiet".split()
RUN = ["run", *SMALL, "--time-limit", "0.5", "--episodes", "24", "--batch", "2", "--out", "made"]
IMAGES = ["--width", "8", "--height", "8", "--policy", "go_to_goal"]
COLLECT = ["collect", *SMALL, "--time-limit", "2", "--hours", "0.008", "--batch", "2", *IMAGES, "--out", "made"]
TRAIN = ["train", "imitation", "../data/made", "--width", "4", "--batch", "8", "--epochs", "12", "--validation", "0.3"]
TRAIN += ["--seed", "3", "--quiet", "--out", "made"]
PPO = ["train", "ppo", *SMALL, "--time-limit", "2", "--scenarios", "4", "--horizon", "4", "--minibatches", "2"]
PPO += ["--epochs", "1", "--width", "4", "--pool", "4", "--steps", "192", "--evaluate-every", "2"]
PPO += ["--evaluation-episodes", "2", "--observations", "goal,speeds", "--rewards", "progress,time", "--out", "made"]
CODES = {  # of who was killed before it could answer, and of who answered
    signal.SIGKILL: (-signal.SIGKILL,), signal.SIGTERM: (-signal.SIGTERM, 143), signal.SIGINT: (-signal.SIGINT, 130),
}  # fmt: skip


@pytest.fixture(scope="module")
def sean():
    """All compiled programs are cached, small ones too, so that only the first command of each kind compiles."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        with forked.sean() as server:
            yield server


def killed(
    sean,
    place: Path,
    arguments: list[str],
    finished: Callable,
    result: Callable,
    seed: int,
    is_over=lambda folder: False,
) -> None:
    """Kill the command in folders of ``place`` so often, give it again after each kill, and compare.

    ``finished(folder)`` is what was finished in the folder, by name: it may only grow, and never change.
    ``result(folder)`` is what an undisturbed command and one that was killed and given again have in common.
    """
    chance, kinds = random.Random(seed), [*CODES] * (KILLS // len(CODES) + 1)
    (place / "compiling").mkdir(parents=True)
    (place / "whole").mkdir()
    assert sean.wait(sean.start(place / "compiling", *arguments)) == 0
    began = time.monotonic()
    assert sean.wait(sean.start(place / "whole", *arguments)) == 0
    took, wanted = time.monotonic() - began, result(place / "whole" / "made")
    assert wanted == result(place / "compiling" / "made"), "two undisturbed ones are equal"
    kills = turns = 0
    while kills < KILLS:
        turns += 1
        folder, before = place / f"killed{turns}", {}
        folder.mkdir()
        while True:
            kind = kinds[kills]
            process = sean.start(folder, *arguments)
            _wait_for_a_moment(sean, process, folder, chance, took)
            os.kill(process, kind)
            code = sean.wait(process)
            said = (place / "said.txt").read_text()
            # A signal in a callback of code in C, where it cannot be put off, is told and forgotten by Python.
            assert "Traceback" not in re.sub(r"Exception ignored in.*\nTraceback", "", said), said
            assert code in (0, *CODES[kind]), (code, kind, said)
            now, over = finished(folder / "made"), code == 0 or is_over(folder / "made")
            assert over or before.items() <= now.items()
            before = now
            kills += code != 0
            if over:
                assert code == 0 or sean.wait(sean.start(folder, *arguments)) in (0, 2), "it was killed at its very end"
                break
            if kills == KILLS:
                assert sean.wait(sean.start(folder, *arguments)) == 0
                break
        assert result(folder / "made") == wanted, (turns, kills)
        assert os.listdir(folder) == ["made"] and ".lock" not in os.listdir(folder / "made")


def _wait_for_a_moment(sean, process: int, folder: Path, chance: random.Random, took: float) -> None:
    """Any time of the whole job, or, as often, shortly after something was written for some times."""
    if chance.random() < 0.5:
        end = time.monotonic() + chance.uniform(0.0, took)
        while time.monotonic() < end and not sean.is_over(process):
            time.sleep(0.005)
        return
    changes, seen = chance.randint(1, 12), _names(folder)
    while changes and not sean.is_over(process):
        time.sleep(0.004)
        if (now := _names(folder)) != seen:
            seen, changes = now, changes - 1
    time.sleep(chance.uniform(0.0, 0.02))


def _names(folder: Path) -> list[str]:
    return sorted(os.path.join(at, name) for at, _, names in os.walk(folder) for name in names)


def test_run(sean, tmp_path):
    def finished(folder: Path) -> dict[str, bytes]:
        return {name: data for name, data in contents(folder / "unfinished").items() if name.endswith(".npz")}

    def result(folder: Path) -> dict:
        found = contents(folder)
        summary = json.loads(found.pop("summary.json"))
        timing = summary.pop("timing")
        page = found.pop("report.html").decode()
        speeds = [f"{timing['simulated_seconds_per_second']:,.0f} s per second"]
        speeds += [f"{timing[name]:.1f} s to" for name in ("compile_seconds", "run_seconds")]
        for each in speeds:
            assert each in page
            page = page.replace(each, "")
        return {**found, "summary": summary, "page": page}

    def is_over(folder: Path) -> bool:
        return (folder / "report.html").exists() and not (folder / "unfinished" / "run.json").exists()

    killed(sean, tmp_path, RUN, finished, result, 1, is_over)


def test_collect(sean, tmp_path):
    def finished(folder: Path) -> dict[str, bytes]:
        manifest = folder / "dataset.json"
        shards = json.loads(manifest.read_text())["shards"] if manifest.exists() else []
        names = [str(k) for k in range(len(shards))]
        arrays = {name: data for name, data in contents(folder).items() if "/c/" in name and "__lock" not in name}
        return {
            **{f"shard {k}": json.dumps(shard).encode() for k, shard in enumerate(shards)},
            **{name: data for name, data in arrays.items() if name.split("/c/")[1].split("/")[0] in names},
        }

    killed(sean, tmp_path, COLLECT, finished, contents, 2)


def steps(folder: Path) -> list[int]:
    """Of the checkpoints that are there."""
    names = os.listdir(folder / "checkpoints") if (folder / "checkpoints").is_dir() else []
    return sorted(int(name) for name in names if name.isdigit())


def states(folder: Path) -> dict[int, list[tuple[str, bytes]]]:
    """Step -> type and bytes of each array of its checkpoint."""
    import jax
    import orbax.checkpoint as ocp

    from sean_jax.learning.checkpoints import Checkpoints

    manager, kept = Checkpoints(folder).manager, {}
    for step in steps(folder):
        state = manager.restore(step, args=ocp.args.Composite(state=ocp.args.PyTreeRestore()))["state"]
        kept[step] = [(np.asarray(leaf).dtype.str, np.asarray(leaf).tobytes()) for leaf in jax.tree.leaves(state)]
    return kept


def test_train(sean, tmp_path):
    (tmp_path / "jobs" / "data").mkdir(parents=True)
    assert sean.wait(sean.start(tmp_path / "jobs" / "data", *COLLECT)) == 0

    def epochs(folder: Path) -> list[dict]:
        lines = (folder / "metrics.jsonl").read_text().splitlines()
        return [{name: value for name, value in json.loads(line).items() if name != "time"} for line in lines]

    def finished(folder: Path) -> dict[str, bytes]:
        return {f"epoch {number}": b"" for number in range(1, max(steps(folder), default=0) + 1)}

    def result(folder: Path) -> dict:
        return {
            "names": sorted(os.listdir(folder)),
            "config": (folder / "config.json").read_bytes(),
            "epochs": epochs(folder),
            "checkpoints": sorted(os.listdir(folder / "checkpoints")),
            "states": states(folder),
        }

    killed(sean, tmp_path / "jobs", TRAIN, finished, result, 3)


def test_ppo(sean, tmp_path):
    """Stopped again and again, reinforcement learning comes to the same curve and the same agent."""

    def finished(folder: Path) -> dict[str, bytes]:
        return {f"update {number}": b"" for number in range(1, max(steps(folder), default=0) + 1)}

    def result(folder: Path) -> dict:
        lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
        curve = [{name: line[name] for name in line if name not in ("time", "seconds", "per_second")} for line in lines]
        return {"names": sorted(os.listdir(folder)), "curve": curve, "states": states(folder)}

    killed(sean, tmp_path, PPO, finished, result, 4)

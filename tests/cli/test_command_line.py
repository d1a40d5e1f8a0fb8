"""The command line: quick help, whole folders or none, one sentence for what is wrong."""

import contextlib
import importlib.metadata
import io
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import yaml
from jax.errors import JaxRuntimeError
from PIL import Image
from rich.console import Console

import sean_jax
from sean_jax import __version__, learning
from sean_jax.classifiers import SITUATION_SETS
from sean_jax.cli import bench, command_line, commands, xla_flags
from sean_jax.config import COMMANDS, flags
from sean_jax.core import random_streams
from sean_jax.io import cache, interrupts
from sean_jax.io import progress as progress_of
from sean_jax.policies import POLICIES
from sean_jax.simulation import making
from support import programs
from support.commands import python
from support.quick import quick

WRAPPED = ValueError("an interrupt, as code in C passes it on")
WRAPPED.__cause__ = KeyboardInterrupt()


def test_help_imports_no_jax_and_names_every_option():
    program = (
        "import sys\n"
        "from sean_jax.cli import command_line as cli\n"
        "for word in ('--help', '--help-scenario'):\n"
        "    try:\n        cli.main(['run', word])\n"
        "    except SystemExit as end:\n        assert end.code == 0\n"
        "print([name for name in ('jax', 'numpy', 'mujoco', 'matplotlib') if name in sys.modules])"
    )
    said = python("-c", program)
    assert said.splitlines()[-1] == "[]"
    for option in "environment behavior task robot policy people episodes seed time-limit out".split():
        assert f"--{option} " in said


def test_every_command_does_something():
    assert commands.DO.keys() == COMMANDS.keys()


@pytest.mark.parametrize("words", COMMANDS)
def test_help_fills_one_screen_and_topics_have_the_other_options(words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    word, model = words.split()[0], COMMANDS[words]
    known = flags.flags_of(model, word in command_line.CONFIGURABLE, word in command_line.READERS)
    shown = list[str]()
    for topic in ("", *(topic.word for topic in flags.topics(model))):
        page = f"--help-{topic}" if topic else "--help"
        with pytest.raises(SystemExit) as end:
            command_line.main([*words.split(), page])
        assert end.value.code == 0
        options = re.findall(r"^[│ ] --([a-z0-9-]+)", capsys.readouterr().out, re.M)
        assert len(options) <= 45 and not {*options} & {*shown}
        assert {*options} == {
            option.name.replace("_", "-") for option in known if option.topic == topic and not option.positional
        }
        shown += options


def test_version_is_printed(capsys):
    assert command_line.main(["--version"]) == 0
    assert capsys.readouterr().out == f"sean_jax {__version__}\n"


def test_compilation_cache_goes_to_the_users_cache_unless_set(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    xla_flags.configure()
    assert Path(os.environ["JAX_COMPILATION_CACHE_DIR"]) == tmp_path / "sean_jax" / "xla"
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "elsewhere")
    xla_flags.configure()
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == "elsewhere"


def test_alarms_of_xla_are_off_unless_the_user_sets_a_level(monkeypatch):
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)
    xla_flags.configure()
    assert os.environ["TF_CPP_MIN_LOG_LEVEL"] == "3"
    monkeypatch.setenv("TF_CPP_MIN_LOG_LEVEL", "0")
    xla_flags.configure()
    assert os.environ["TF_CPP_MIN_LOG_LEVEL"] == "0"


@pytest.mark.parametrize("version", ["0.10.2", "0.11.2", "0.12.0.1"])
def test_the_users_flags_for_the_compiler_stay_and_new_versions_get_none(monkeypatch, version):
    monkeypatch.setattr(importlib.metadata, "version", lambda name: version)
    ours = " --xla_cpu_use_fusion_emitters=false" if version == "0.10.2" else ""
    for theirs in ("--xla_dump_to=here", "--xla_cpu_use_fusion_emitters=true"):
        monkeypatch.setenv("XLA_FLAGS", theirs)
        for _ in range(2):
            xla_flags.configure()
            assert os.environ["XLA_FLAGS"] == (theirs if "emitters" in theirs else theirs + ours)


@pytest.mark.parametrize("words", quick(["run", "collect", "experiment table1", "experiment figure4"], "run"))
def test_too_many_people_are_refused_with_the_most_that_fit(words, capsys, monkeypatch, tmp_path):
    """And no trace is left, so that nothing is in the way of the right command."""
    monkeypatch.chdir(tmp_path)
    assert command_line.main([*words.split(), "--people", "10000", "--quiet"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("sean: ") and len(error.splitlines()) == 1
    assert "10000 do not fit" in error and "the most that do is" in error and not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (OSError(28, "No space left on device", "episodes.csv"), 1, "the disk is full (episodes.csv); nothing was"),
        (FloatingPointError("1 of 4 episodes hold numbers that are not finite: 2."), 1, "finite: 2. Nothing was"),
        (JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory"), 1, "the device is out of memory; set XLA_PYTHON_CLIENT"),
        (KeyboardInterrupt(), 130, "stopped"),
        (WRAPPED, 130, "stopped"),
    ],
)
def test_what_goes_wrong_midway_ends_in_one_sentence(raised, code, said, capsys, monkeypatch, tmp_path):
    def fail(*arguments):
        raise raised

    monkeypatch.setattr(making, "build", fail)
    assert command_line.main(["run", "--out", str(tmp_path / "run")]) == code
    assert said in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(("kind", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_while_another_is_answered_ends_in_its_code_and_no_traceback(kind, code, capsys, monkeypatch):
    monkeypatch.setattr(command_line, "_main", lambda *_: signal.raise_signal(kind))
    assert command_line.main(["run"]) == code
    assert capsys.readouterr() == ("", "")


def test_an_interrupt_when_all_is_done_changes_nothing(monkeypatch):
    @contextlib.contextmanager
    def freeing_much():
        with interrupts.interruptible() as received:
            yield received
            signal.raise_signal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(command_line, "_main", lambda *_: 0)
    monkeypatch.setattr(command_line, "interrupts", SimpleNamespace(interruptible=freeing_much))
    assert command_line.main(["run"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before


def test_run_writes_a_whole_folder(tmp_path, capsys):
    """With the table, columns, report and animation of a set of situations."""
    words = "run --environment lab --people 4 --time-limit 3 --episodes 3 --batch 2 --seed 1".split()
    out = ["--situations", "more", "--camera", "depth", "--out", str(tmp_path / "a")]
    assert command_line.main([*words, *out]) == 0
    table = capsys.readouterr().out.replace("\n", " ")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    written = {"config.yaml", "environment", "episodes.csv", "summary.json", "report.html", "episode.gif", "camera.gif"}
    assert {path.name for path in (tmp_path / "a").iterdir()} == written
    header, *rows = (line.split(",") for line in (tmp_path / "a" / "episodes.csv").read_text().splitlines())
    assert [row[1] for row in rows] == ["join_group", "leave_group", "join_group"]
    config = yaml.safe_load((tmp_path / "a" / "config.yaml").read_text())
    assert config["config"]["people"] == 4 and config["people"] == 4
    assert "--seed 1" in config["command"] and "--situations more" in config["command"]
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert summary["episodes"] == 3 and 0 < summary["simulated_seconds"] <= 9.0
    assert summary["checks"]["largest_penetration_mm"] <= 1.0
    assert max(summary["checks"]["largest_groups"]) <= 5
    page = (tmp_path / "a" / "report.html").read_text(encoding="utf-8")
    assert list(summary["situations"]) == list(SITUATION_SETS["more"])
    for situation in SITUATION_SETS["more"]:
        assert f"time_in_situation__{situation}" in header and f"</i>{situation.replace('_', ' ')}</th>" in page
        assert all(word in table for word in situation.split("_"))
    for name in ("episode.gif", "camera.gif"):
        assert Image.open(tmp_path / "a" / name).n_frames > 3  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.night
def test_a_batch_equals_each_episode_alone():
    tasks, drive = ("join_group", "leave_group"), POLICIES["go_to_goal"]
    scenarios = [sean_jax.make(task=task, people=8, dynamics="twin", time_limit=2.0) for task in tasks]
    evaluation = sean_jax.evaluate(scenarios, drive, episodes=3, batch=2, seed=5)
    for episode, task in enumerate(evaluation.tasks):
        scenario = scenarios[tasks.index(task)]
        key = jax.random.fold_in(random_streams.key("run", 5), episode)
        last, frames = programs.rollout(scenario, drive, key, 20)
        for name, value in programs.results(scenario, last).items():
            np.testing.assert_allclose(evaluation.metrics[name][episode], value, atol=1e-3, err_msg=name)
        if episode < len(evaluation.frames):
            np.testing.assert_allclose(evaluation.frames[episode].people, frames.people, atol=1e-3)


def test_list_names_every_choice(capsys):
    assert command_line.main(["list"]) == 0
    said = capsys.readouterr().out
    names = "warehouse graph join_group leave_group kuri go_to_goal helbing1995 twin sean2 overtaking"
    assert all(name in said for name in names.split())


SLOW_TO_COMPILE = """
import sys
if len(sys.argv) > 1:
    from sean_jax.cli import xla_flags
    xla_flags.configure()
import jax
ones = jax.numpy.ones((2, 30000))
jax.jit(lambda: jax.lax.reduce_window(ones, 0.0, jax.lax.add, (1, 60), (1, 1), "SAME").sum())()
"""


@pytest.mark.slow
@pytest.mark.parametrize("configured", [False, True])
def test_alarms_of_the_compiler_reach_nobody(configured, monkeypatch):
    """XLA takes seconds to fold this constant, and says so on the terminal, unless the command line starts it."""
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)
    monkeypatch.setenv("JAX_ENABLE_COMPILATION_CACHE", "false")
    program = [sys.executable, "-c", SLOW_TO_COMPILE, *["configured"] * configured]
    said = subprocess.run(program, capture_output=True, text=True, check=True).stderr
    assert ("slow_operation_alarm" in said) != configured


MUTED = """
import logging, sys, threading
from sean_jax.cli import command_line as cli

class Task:
    def __del__(self):
        raise RuntimeError("Event loop is closed")

def speak():
    logging.getLogger("absl").warning("of orbax")
    logging.getLogger("asyncio").error("Task of orbax")
    logging.getLogger("asyncio").error("Task of another")
    thread = threading.Thread(target=Task)
    thread.start()
    thread.join()

if len(sys.argv) > 1:
    cli.main(["--version"])
else:
    cli.main()
speak()
"""


@pytest.mark.parametrize("called", [False, True])
def test_tasks_of_orbax_print_nothing_in_a_process_of_the_command_line(called):
    """A program that calls it keeps its own loggers and hooks."""
    program = [sys.executable, "-c", MUTED, *["called"] * called]
    said = subprocess.run(program, capture_output=True, text=True, check=True).stderr
    assert "Task of another" in said
    assert ("of orbax" in said) == ("Task of orbax" in said) == ("Event loop is closed" in said) == called


@pytest.mark.parametrize("raised", [OSError(28, "No space left on device", "shard"), KeyboardInterrupt(), WRAPPED])
@pytest.mark.parametrize("kept", [True, False])
def test_what_is_kept_of_learning_is_told(raised, kept, capsys, monkeypatch, tmp_path):
    folder = tmp_path / "made"
    folder.mkdir()

    def fail(*arguments):
        if kept:
            (folder / "part").touch()
        raise raised

    monkeypatch.setattr(learning, "collect", fail)
    code = command_line.main(["collect", "--out", str(folder)])
    error = capsys.readouterr().err
    assert code == (1 if isinstance(raised, OSError) else 130) and len(error.splitlines()) == 1
    assert ("the disk is full (shard); " if code == 1 else "stopped; ") in error
    assert (f"finished parts are in {folder}, and the same command resumes" in error) is kept
    assert ("nothing was written" in error) is not kept


def test_a_missing_extra_is_named_by_every_command(capsys, monkeypatch, tmp_path):
    def fail(*arguments):
        raise ModuleNotFoundError("No module named 'orbax'", name="orbax.checkpoint")

    monkeypatch.setattr(making, "build", fail)
    assert command_line.main(["run", "--out", str(tmp_path / "run")]) == 2
    assert 'orbax.checkpoint is missing; pip install "sean_jax[learning]".' in capsys.readouterr().err


def test_who_has_no_home_has_a_cache(monkeypatch):
    def none():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", none)
    assert cache.folder().is_relative_to(tempfile.gettempdir())


def test_a_full_disk_leaves_what_a_benchmark_measured(monkeypatch, capsys, tmp_path):
    def measures(options, scenario):
        (tmp_path / "made" / "table.txt").write_text("one row")
        raise OSError(28, "No space left on device")
        yield

    monkeypatch.setattr(bench, "_prepare", lambda options: (None, {}))
    monkeypatch.setattr(bench, "title", lambda about: "")
    monkeypatch.setattr(bench, "CASES", dict.fromkeys(bench.CASES, measures))
    assert command_line.main(["bench", "--out", str(tmp_path / "made")]) == 1
    said = f"the disk is full; what was measured until then is in {tmp_path / 'made'}."
    assert said in capsys.readouterr().err


def test_progress_is_plain_lines_into_a_pipe_and_rarer_with_time(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress_of.time, "monotonic", lambda: now[0])
    pipe = io.StringIO()
    for console in (Console(file=pipe), Console(file=pipe, quiet=True)):
        now[0] = 0.0
        with progress_of.progress(console) as tell:
            tell.stage("drawing starts")
            tell.start("training", 7_200)
            for second in range(1, 7_201):
                now[0] = float(second)
                tell.update(second, f"update {second} [/x] :smile:")
    lines = pipe.getvalue().splitlines()
    assert lines[0] == "training 0% · update 10 [/x] :smile: · 0:00:10, 1:59:50 left" and len(lines) < 160
    shown = [int(line.split("update ")[1].split()[0]) for line in lines]
    assert all(
        10 <= after - before <= min(max(10, 0.11 * before), 60) for before, after in zip(shown, shown[1:], strict=False)
    )
    assert shown[-1] > 7_100 and "\x1b" not in pipe.getvalue()


def test_work_beside_the_stage_is_named_and_does_not_count_in_its_rate(monkeypatch):
    """A training of 100 updates of a second each, with an evaluation of 90 s after every tenth."""
    now = [0.0]
    monkeypatch.setattr(progress_of.time, "monotonic", lambda: now[0])
    pipe = io.StringIO()
    with progress_of.progress(Console(file=pipe)) as tell:
        tell.start("training", 100)
        for update in range(1, 101):
            now[0] += 1.0
            if update % 10 == 0:
                with tell.aside("evaluating"):
                    for _ in range(9):
                        now[0] += 10.0
                        tell.line()  # pyright: ignore[reportAttributeAccessIssue]
            tell.update(update)
    lines = pipe.getvalue().splitlines()
    evaluating = [line for line in lines if line.startswith("training, evaluating 49%")]
    assert len(evaluating) > 1 and all("left" in line for line in evaluating)
    for line in lines:
        if "left" in line:
            share, left = re.findall(r" (\d+)%.*, 0:0(\d:\d\d) left", line)[0]
            minutes, seconds = map(int, left.split(":"))
            assert 60 * minutes + seconds == pytest.approx(100 - int(share), rel=0.15), line


def test_progress_goes_on_while_nothing_is_told(monkeypatch):
    """As while a program is compiled: lines of the stage come by themselves."""
    monkeypatch.setattr(progress_of, "INTERVAL", 0.01)
    pipe, deadline = io.StringIO(), time.monotonic() + 60.0
    with progress_of.progress(Console(file=pipe)) as tell:
        tell.stage("compiling")
        while pipe.getvalue().count("compiling") < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert pipe.getvalue().count("compiling · 0:00:0") >= 3

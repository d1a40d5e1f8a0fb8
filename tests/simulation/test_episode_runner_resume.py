"""A run that is disturbed in whatever way keeps its finished batches, and the same command comes to the same bytes."""

import csv
import dataclasses
import json
import os
import shutil
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from sean_jax import drawing, evaluation
from sean_jax.cli import command_line
from sean_jax.config import RunConfig, gather, validate
from sean_jax.core.data_types import Trajectory
from sean_jax.core.errors import FileError, InputError
from sean_jax.evaluation import batches
from sean_jax.evaluation.run_plan import identity_of
from sean_jax.io import writing
from sean_jax.io.progress import Progress
from sean_jax.io.trajectories import load_trajectory
from sean_jax.simulation import making
from sean_jax.simulation.episode_runner import Callbacks, Runner
from sean_jax.simulation.scenario_stack import as_stacks
from support.files import contents, write
from support.runs import at_second_batch

SMALL = "--environment lab --behavior random --task random_ab_nav --people 2 --dynamics twin --time-limit 0.5".split()
SMALL += ["--metrics", "path_length"]  # all of them would take long to compile
RUN = ["run", *SMALL, "--seed", "3", "--episodes", "5", "--batch", "2", "--out", "made"]


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    """All runs here are of one scenario: it is made and compiled once."""
    made: dict = {}

    def once(function):
        def first(*arguments, **named):
            if function not in made:
                made[function] = function(*arguments, **named)
            return made[function]

        return first

    def compiled(*arguments, **named):
        runner = Runner(*arguments, **named)
        runner.compile(Callbacks())
        runner.compile = lambda callbacks: None
        return runner

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(making, "build", once(making.build))
        patched.setattr(evaluation, "Runner", once(compiled))
        yield


@pytest.fixture
def simulated(monkeypatch, tmp_path):
    """The numbers of the first episodes of the batches that were simulated; the folder is the test's own."""
    monkeypatch.chdir(tmp_path)
    bases, run = [], Runner.run

    def counted(runner, seed, first, *others, **named):
        bases.append(first)
        return run(runner, seed, first, *others, **named)

    monkeypatch.setattr(Runner, "run", counted)
    return bases


def files(folder: Path) -> dict[str, bytes | dict]:
    """All but what tells how long it took."""
    found: dict = {**contents(folder)}
    summary = json.loads(found["summary.json"])
    del summary["timing"], found["report.html"]
    return found | {"summary.json": summary}


@pytest.fixture(scope="module")
def whole(compiled_once, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(tmp_path_factory.mktemp("whole"))
        assert command_line.main(RUN) == 0
        return files(Path("made"))


def poisoned(batch):
    def one(leaf):
        return leaf.at[1].set(np.nan) if np.issubdtype(leaf.dtype, np.floating) else leaf

    metrics = {**batch.states.metrics, "path_length": jax.tree.map(one, batch.states.metrics["path_length"])}
    return batch._replace(states=dataclasses.replace(batch.states, metrics=metrics))


def full(*arguments, **others):
    raise OSError(28, "No space left on device", "somewhere")


KEPT = "the 2 finished episodes are"


def stopped(kind):
    return lambda patched: at_second_batch(patched, lambda _: signal.raise_signal(kind))


def with_nan(patched):
    at_second_batch(patched, poisoned)


def with_a_full_disk(patched):
    at_second_batch(patched, lambda _: patched.setattr(np, "savez_compressed", full))


def with_a_full_disk_at_the_report(patched):
    patched.setattr(drawing, "animate", full)


def stopped_at_the_report(patched):
    patched.setattr(drawing, "animate", lambda *_, **__: signal.raise_signal(signal.SIGINT))


@pytest.mark.parametrize(
    "disturb, code, said, written",
    [
        pytest.param(stopped(signal.SIGINT), 130, f"stopped; {KEPT} in", True, marks=pytest.mark.slow, id="Ctrl-C"),
        pytest.param(stopped(signal.SIGTERM), 143, f"stopped; {KEPT} in", True, id="SIGTERM"),
        pytest.param(with_nan, 1, "1 of 2 episodes hold numbers that are not finite: 3. The 2", False, id="NaN"),
        pytest.param(with_a_full_disk, 1, KEPT, False, marks=pytest.mark.slow, id="full"),
        pytest.param(with_a_full_disk_at_the_report, 1, "the 5 finished episodes are kept", False, id="full report"),
        pytest.param(
            stopped_at_the_report,
            130,
            "stopped; the 5 finished episodes",
            False,
            marks=pytest.mark.slow,
            id="Ctrl-C, report",
        ),
    ],
)
def test_a_disturbed_run_goes_on(disturb, code, said, written, whole, simulated, capsys):
    with pytest.MonkeyPatch.context() as patched:
        disturb(patched)
        assert command_line.main(RUN) == code
    error = capsys.readouterr().err
    assert error.startswith("sean: ") and said in error and len(error.splitlines()) == 1
    assert "and the same command with --out made resumes it" in error
    assert Path("made/episodes.csv").exists() is written and not Path("made/unfinished/written").exists()
    if written:
        rows = Path("made/episodes.csv").read_text().splitlines()
        assert rows == whole["episodes.csv"].decode().splitlines()[:3]
    before = list(simulated)
    assert command_line.main(RUN) == 0
    assert files(Path("made")) == whole
    kept = 2 if "the 2" in said.lower() else 5
    assert simulated[len(before) :] == list(range(0, 5, 2))[(kept + 1) // 2 :], "what was finished is not done again"
    assert [path.name for path in Path().iterdir()] == ["made"]


def test_stopped_before_anything_was_finished_leaves_nothing(whole, simulated, monkeypatch, capsys):
    monkeypatch.setattr(Runner, "run", lambda *_, **__: signal.raise_signal(signal.SIGTERM))
    assert command_line.main(RUN) == 143
    assert "nothing was written, for no batch of episodes was finished" in capsys.readouterr().err
    assert not list(Path().iterdir())


def test_two_runs_into_one_folder(whole, simulated, monkeypatch, capsys):
    """The second is refused at its start, and the first does not notice."""
    codes = []
    at_second_batch(monkeypatch, lambda _: codes.append(command_line.main(RUN)))
    assert command_line.main(RUN) == 0 and codes == [2, 2]
    error = capsys.readouterr().err
    assert "made is being written by process" in error and "choose another folder with --out" in error
    assert files(Path("made")) == whole and simulated == [0, 2, 4]
    assert command_line.main(RUN) == 2 and "is not empty" in capsys.readouterr().err


def test_other_options_do_not_go_on_with_it(whole, simulated, monkeypatch, capsys):
    with monkeypatch.context() as patched:
        at_second_batch(patched, lambda _: signal.raise_signal(signal.SIGINT))
        assert command_line.main(RUN) == 130
    capsys.readouterr()
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    for option, value, said in (("--seed", "4", "--seed 3, not 4"), ("--people", "3", "--people 2, not 3")):
        assert command_line.main([*RUN, option, value]) == 2
        error = capsys.readouterr().err
        assert "made was begun with " + said in error and len(error.splitlines()) == 1
    (stack,) = making.build(making.plan_scenario(RunConfig()))  # the one of all runs here
    scenario = stack.member
    changed = dataclasses.replace(scenario, goal_radius=scenario.goal_radius * 2)
    with monkeypatch.context() as patched:
        patched.setattr(making, "build", lambda *_: as_stacks(changed))
        assert command_line.main(RUN) == 2
    assert "with another scenario and policy" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


def test_runs_with_the_default_folder_tell_of_one_that_was_not_finished(whole, simulated, monkeypatch, capsys):
    with monkeypatch.context() as patched:
        at_second_batch(patched, lambda _: signal.raise_signal(signal.SIGINT))
        assert command_line.main([*RUN[:-2]]) == 130
    (left,) = Path("runs").iterdir()
    Path("runs/killed").mkdir()
    (Path("runs/killed") / writing.LOCK).write_text("process 1 on a machine that is no more")
    capsys.readouterr()
    scenario = {"environment": "lab", "behavior": "random", "task": "random_ab_nav", "people": 2, "dynamics": "twin"}
    run = {"time_limit": 0.5, "metrics": "path_length", "seed": 3, "episodes": 5, "batch": 2}
    asked = validate(RunConfig, gather(RunConfig, scenario | run))
    assert list(batches.unfinished_runs(identity_of(asked), 1, Path("runs/new"))) == [(left, 2)]
    assert list(batches.unfinished_runs(identity_of(asked.replace(seed=4)), 1, Path("runs/new"))) == []
    with writing.folder_lock(left):
        assert list(batches.unfinished_runs(identity_of(asked), 1, Path("runs/new"))) == []
    assert list(Path("runs").iterdir()) == [left]
    assert command_line.main(RUN[:-2]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{left} has 2 of 5 episodes of such a run; --out {left} resumes it" in said


@pytest.mark.parametrize("left", [[], [".run.json.new"], [".run.json.new", "written"]])
def test_what_a_kill_leaves_at_the_very_beginning_is_in_nobodys_way(left, tmp_path):
    place = tmp_path / "made" / "unfinished"
    place.mkdir(parents=True)
    (tmp_path / "made" / writing.LOCK).write_text("process 1 on a machine")
    for name in left:
        (place / name).write_text("half of it") if name.endswith(".new") else (place / name).mkdir()
    batches.check_run_folder(tmp_path / "made")
    assert not place.exists()
    write(place / "letter.txt", "dear")
    with pytest.raises(InputError, match="is not empty"):
        batches.check_run_folder(tmp_path / "made")
    assert (place / "letter.txt").exists()


def test_what_a_kill_leaves_at_the_very_end_goes_with_the_next_start(tmp_path):
    """The results stay, and are not written over."""
    place = tmp_path / "made" / "unfinished"
    place.mkdir(parents=True)
    (tmp_path / "made" / "summary.json").write_text("{}")
    for _ in range(2):
        (tmp_path / "made" / writing.LOCK).write_text("process 1 on a machine")
        with pytest.raises(InputError, match="is not empty"):
            batches.check_run_folder(tmp_path / "made")
        assert [path.name for path in (tmp_path / "made").iterdir()] == ["summary.json"]


def test_what_is_damaged_is_named(tmp_path):
    write(tmp_path / "made" / "unfinished" / "run.json", "{")
    with pytest.raises(InputError, match="damaged .*run.json:1:2: is not JSON: .*; choose another folder with --out"):
        batches.RunFolder(tmp_path / "made", identity_of(RunConfig()))


def test_a_run_does_not_end_by_what_others_have_beside_it(tmp_path, monkeypatch):
    """Folders of other people, and those that vanish while they are looked at."""
    for name in ("a", "b", "c"):
        (tmp_path / name / "unfinished").mkdir(parents=True)
    (tmp_path / "c" / "unfinished" / "run.json").write_text(json.dumps(identity_of(RunConfig())))
    listdir = os.listdir

    def refused(folder):
        if Path(folder).name in ("a", "b"):
            raise PermissionError(13, "Permission denied") if Path(folder).name == "a" else FileNotFoundError(2, "gone")
        return listdir(folder)

    monkeypatch.setattr(os, "listdir", refused)
    assert batches.unfinished_runs(identity_of(RunConfig()), 1, tmp_path / "new") == [(tmp_path / "c", 0)]
    assert batches.unfinished_runs(identity_of(RunConfig()), 1, tmp_path / "none" / "new") == []


def test_a_damaged_batch_is_named(tmp_path):
    kept = batches.RunFolder(tmp_path / "made", identity_of(RunConfig()))
    kept.place.mkdir(parents=True)
    np.savez_compressed(kept._file(0, 2), completed=np.zeros(2, bool))
    content = kept._file(0, 2).read_bytes()
    for broken in (content, b"", content[:-30], content[:40] + b"0" * 40 + content[80:], b"\x93NUMPY" + content[6:]):
        kept._file(0, 2).write_bytes(broken)
        with pytest.raises(FileError, match="batch-00000000-2.npz: is damaged; remove it"):
            kept.load(0, 2)
    for name in ("batch-x.npz", "batch-0-x.npz", "batch-00000000-2-x.npz"):
        (kept.place / name).touch()
    assert kept.episodes == 2


def test_a_run_that_does_not_tell_its_options_is_not_gone_on_with(tmp_path):
    write(tmp_path / "unfinished" / "run.json", "{}")
    with pytest.raises(InputError, match="was begun without --environment; ask for the same"):
        batches.RunFolder(tmp_path, identity_of(RunConfig()))


def test_results_have_nothing_of_one_who_was_killed(tmp_path):
    kept = batches.RunFolder(tmp_path, identity_of(RunConfig()))
    (kept.place / "written").mkdir(parents=True)
    (kept.place / "written" / "camera.gif").write_text("half of it")
    with kept.results(True) as place:
        (place / "summary.json").write_text("{}")
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


def test_a_folder_that_was_filled_meanwhile_is_not_said_to_be_written_by_oneself(tmp_path):
    with writing.folder_lock(tmp_path):
        (tmp_path / "summary.json").write_text("{}")
        with pytest.raises(InputError, match="is not empty"):
            batches.RunFolder(tmp_path, identity_of(RunConfig()))


def test_batches_after_a_removed_one_are_not_simulated_again(whole, simulated, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(drawing, "animate", full)
        assert command_line.main(RUN) == 1
    (removed,) = Path("made/unfinished").glob("batch-00000000-*")
    removed.unlink()
    assert command_line.main(RUN) == 0 and simulated == [0, 2, 4, 0]
    assert files(Path("made")) == whole


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_stopped_run_has_the_frames_of_all_episodes(simulated, monkeypatch, kind):
    """Each episode until its end, as long as episodes.csv tells, and on the way that its path_length measures."""
    pytest.importorskip({"csv": "csv", "parquet": "pyarrow"}[kind])
    asked = [*RUN, "--trajectories", kind]
    with monkeypatch.context() as patched:
        at_second_batch(patched, lambda _: signal.raise_signal(signal.SIGINT))
        assert command_line.main(asked) == 130
    assert not list(Path("made/unfinished").glob(".batch*"))
    assert load_trajectory(Path(f"made/trajectories.{kind}")).active.shape[0] == 2
    assert command_line.main(RUN) == 2, "the finished batches have frames, which such a run has not"
    assert command_line.main(asked) == 0 and simulated == [0, 2, 2, 4]
    assert sorted(name for name in os.listdir("made") if name.startswith(("trajec", "unfin"))) == [
        f"trajectories.{kind}"
    ]
    found = load_trajectory(Path(f"made/trajectories.{kind}"))
    rows = list(csv.DictReader(Path("made/episodes.csv").open()))
    assert found.active.shape[0] == len(rows) == 5
    for k, row in enumerate(rows):
        length = int(found.active[k].sum())
        assert length == round(float(row["seconds"]) / 0.1) and found.active[k, :length].all()
        way = np.linalg.norm(np.diff(found.position[k, :length], axis=0), axis=-1).sum()
        first = np.linalg.norm(found.velocity[k, 0]) * 0.1  # from the start, which is no frame
        assert float(row["path_length"]) == pytest.approx(way + first, abs=0.02)
    assert len({tuple(np.round(place, 3)) for place in found.position[:, 0]}) == 5, "five starts"


def test_frames_of_one_batch_lie_on_disk_and_are_cut_at_their_end(tmp_path):
    """Chunks of time until after the time limit; of nobody and of three people."""
    random = np.random.default_rng(0)
    for people in (0, 3):
        scratch = tmp_path / str(people)
        scratch.mkdir()
        ends = np.array([1, 13, 25])
        active = np.arange(30)[:, None] < ends
        shapes = {name: (2,) for name in ("position", "heading", "velocity", "action", "goal")}
        shapes |= {name: (people, 2) for name in ("people", "people_velocity", "people_heading")}
        shapes |= {"group": (people,), "present": (people,), "situations": (5,)}
        arrays: Any = {name: random.normal(size=(30, 4, *shape)).astype(np.float32) for name, shape in shapes.items()}
        given = Trajectory(**arrays, active=np.pad(active, ((0, 0), (0, 1))))  # pyright: ignore
        taken = batches.BatchFrames(scratch, count=3, steps=25)
        for begin, end in ((0, 10), (10, 20), (20, 30)):
            taken.add(jax.tree.map(lambda leaf: leaf[begin:end], given))  # noqa: B023
        for k, end in enumerate(ends):
            assert taken.episode(k).robots is None
            for name in arrays:
                values = getattr(taken.episode(k), name)
                np.testing.assert_array_equal(values, getattr(given, name)[:end, k], err_msg=name)
        assert isinstance(taken.arrays["position"], np.memmap)


def test_a_missing_package_is_told_at_the_start(simulated, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert command_line.main([*RUN, "--trajectories", "parquet"]) == 2
    said = capsys.readouterr().err
    assert "pyarrow is missing; pip install" in said and not simulated and not Path("made").exists()


def test_ever_so_many_batches_are_no_list():
    """A list of them would fill the memory before the first one."""

    class Stop(Exception):
        pass

    def load(base, kept):
        assert (base, kept) == (0, 1)
        raise Stop

    asked: Any = SimpleNamespace(load=load)
    with pytest.raises(Stop):
        stack: Any = SimpleNamespace(member=SimpleNamespace(time_limit=1.0), size=1)
        schedule = evaluation.Schedule(episodes=2**31 - 1, seed=0, batch=1)
        evaluation._evaluate([stack], asked, schedule, 1, evaluation.RunContext(Progress(), folder=asked))


def test_a_resumed_run_replaces_the_parts_of_its_earlier_report(tmp_path):
    """Own parts lie in a folder, which a report at Ctrl-C has written already."""
    for text in ("old", "new"):
        run = batches.RunFolder(tmp_path, identity_of(RunConfig()))
        with run.results(complete=text == "new") as stage:
            write(stage / "parts" / "mine.py", text)
        (tmp_path / batches.PLACE).mkdir(exist_ok=True)
        (tmp_path / batches.IDENTITY).write_text(json.dumps(run.work.identity))
    assert (tmp_path / "parts" / "mine.py").read_text() == "new"


def test_results_are_on_disk_before_the_batches_go(tmp_path, monkeypatch):
    """Each file by itself, then the folder that names it: a power cut at any time leaves one or the other."""
    order, fsync, replace, rmtree = [], os.fsync, os.replace, shutil.rmtree

    def name(descriptor: int) -> str:
        return Path(f"/proc/self/fd/{descriptor}").resolve().name

    monkeypatch.setattr(os, "fsync", lambda descriptor: (order.append(f"sync {name(descriptor)}"), fsync(descriptor)))
    monkeypatch.setattr(os, "replace", lambda a, b: (order.append(f"rename {Path(b).name}"), replace(a, b)))
    monkeypatch.setattr(shutil, "rmtree", lambda a, **k: (order.append(f"remove {Path(a).name}"), rmtree(a, **k)))
    kept = batches.RunFolder(tmp_path, identity_of(RunConfig()))
    with kept.results(True) as place:
        write(place / "parts" / "mine.py", "")
        (place / "summary.json").write_text("{}")
        order.clear()
    assert order[-1] == "remove unfinished" and order[-2] == f"sync {tmp_path.name}"
    assert sorted(order[:3]) == ["sync mine.py", "sync parts", "sync summary.json"]
    assert order.index("sync mine.py") < order.index("sync parts")
    assert sorted(order[3:-2]) == ["rename parts", "rename summary.json"]

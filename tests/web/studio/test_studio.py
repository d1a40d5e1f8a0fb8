"""``sean studio``: drives are simulated again to the byte, the server is for this computer alone, Chromium drives."""

import asyncio
import base64
import contextlib
import gzip
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
import zlib

import jax
import numpy as np
import pytest
from PIL import Image
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

import support.studio
from sean_jax import learning
from sean_jax.config import StudioConfig, user_parts, validate
from sean_jax.core.errors import FileError, InputError
from sean_jax.learning import Recorder
from sean_jax.simulation import making
from sean_jax.web import local_server, pages
from sean_jax.web.studio import address, server, trial
from sean_jax.web.studio.server import Studio
from sean_jax.web.studio.session import Choice, Session
from support.checkout import ROOT
from support.commands import wait
from support.studio import OPTIONS
from support.web import browse, chromium, get, until

session, fresh, served = support.studio.session, support.studio.fresh, support.studio.served  # fixtures


def drive(session, steps, ahead, left):
    """Let a person drive for at least so many steps."""
    session.drive(True)
    until = len(session.commands) + steps
    session.command(ahead, left)
    session.play(True)
    while len(session.commands) < until and not session.over:
        session.command(ahead, left)
        time.sleep(0.005)
    session.play(False)


def equal(one, other):
    leaves = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True) for a, b in leaves if a.dtype.kind == "f")


# ------------------------------------------------------------------ a session


@pytest.mark.night
def test_a_drive_is_simulated_again_to_the_byte(fresh, tmp_path):
    """Also one that returned to an earlier moment, in which person and policy take turns."""
    fresh.record()
    drive(fresh, 12, 1.0, 0.3)
    fresh.drive(False)
    fresh.play(True)
    wait(lambda: len(fresh.commands) >= 30)
    fresh.play(False)
    fresh.rewind(7)
    assert len(fresh.commands) == 7 and len(fresh.frames) == 8 and int(fresh.state.tick) == 7
    drive(fresh, 15, -0.5, 1.0)
    state, commands = fresh.state, list(fresh.commands)
    file = fresh.end_trial()
    told = trial.read_trial(file)
    assert told.outcome == trial.STOPPED and told.episode == 0
    np.testing.assert_array_equal(told.commands, commands)
    np.testing.assert_array_equal(told.by_person, fresh.by_person)
    recorder = Recorder(tmp_path / "again", fresh.scenario, seed=0)
    repeated = trial.replay(recorder, 0, told.commands)
    assert equal(repeated.robot, state.robot) and equal(repeated.pedestrians, state.pedestrians)


@pytest.mark.night
def test_a_drive_of_an_omnidirectional_robot_is_kept(tmp_path):
    """With three numbers a command; it is listed, and simulated again to the byte. Networks are for two wheels."""
    hsr = Session(validate(StudioConfig, OPTIONS | {"robot": "hsr"}).replace(record=tmp_path))
    hsr.record()
    for _ in range(12):
        hsr._advance(np.array([0.2, 0.1, 0.2]))
    told = trial.read_trial(hsr.end_trial())
    np.testing.assert_array_equal(told.commands, hsr.commands)
    assert told.commands.shape == (12, 3) and [row["seconds"] for row in hsr.drives()] == [1.2]
    state = hsr.moments[0].state
    for command in told.commands:
        state = hsr._step(hsr.scenario, state, jax.numpy.asarray(command))
    assert equal(state.robot, hsr.state.robot)
    assert trial._beyond_robot(told, hsr.scenario.robot) == ""
    two = told._replace(commands=told.commands[:, :2])
    assert "has commands of 2 numbers, and those of hsr have 3" in trial._beyond_robot(two, hsr.scenario.robot)
    made = trial.demonstrations(hsr.config)
    assert made.data is None and "the drive of hsr is omnidirectional" in made.said[0]
    assert trial.recover(tmp_path) == [] and told.file.exists()
    assert not server._hello(hsr)["demonstrates"]


def test_a_person_has_the_robots_limits_and_a_dead_man_switch(fresh):
    forward, backward, turn = fresh.limits
    drive(fresh, 8, 1.0, -1.0)
    assert fresh.commands[-1] == pytest.approx((forward, -turn)) and all(fresh.by_person)
    drive(fresh, 4, -1.0, 0.0)
    assert fresh.commands[-1] == pytest.approx((-backward, 0.0))
    fresh.play(True)
    wait(lambda: fresh.commands[-1] == (0.0, 0.0))  # half a second after the last command
    fresh.play(False)
    assert fresh.by_person[-1]


def test_one_step_at_a_time_and_no_further_than_memory(fresh, monkeypatch):
    for number in range(1, 4):
        fresh.step()
        wait(lambda number=number: len(fresh.commands) == number)
    time.sleep(0.1)
    assert len(fresh.commands) == 3 and not any(fresh.by_person)
    fresh.moments.popleft()  # as if it had been longer ago than MEMORY
    assert fresh.rewind(0) == 1 and fresh.status()["first"] == 1
    assert fresh.rewind(99) == 1


def test_time_passes_as_fast_as_asked(fresh):
    """Real time, and four times that, on a busy machine never faster."""
    for speed in (1.0, 4.0):
        fresh.restart(0)
        fresh.set_speed(speed)
        began = time.monotonic()
        fresh.play(True)
        wait(lambda: len(fresh.commands) * fresh.scenario.time_step > 0.5)
        fresh.play(False)
        simulated = len(fresh.commands) * fresh.scenario.time_step
        assert simulated <= speed * (time.monotonic() - began) + 2 * fresh.scenario.time_step


def test_an_episode_ends_and_is_compared_with_policies(fresh):
    fresh.play(True)
    wait(lambda: fresh.over, 60.0)
    assert fresh.outcome in ("completed", "timed out")
    wait(lambda: not fresh.status()["playing"])
    length = len(fresh.commands)
    fresh.play(True)
    time.sleep(0.1)
    assert len(fresh.commands) == length and not fresh.status()["playing"]
    cards = dict(fresh.baselines(["go_to_goal"]))
    mine = next(iter(cards.values()))
    assert list(cards) == ["go_to_goal"]  # the policy drove, and is its own baseline
    assert mine["seconds"] == pytest.approx(length * fresh.scenario.time_step)
    assert {"completed", "path_length", "intimate_robot_on_person"} <= set(mine)


def columns_of(episode):
    """The numbers of an encoded episode by name, (K, T), decoded by the format's description alone."""
    numbers = np.frombuffer(zlib.decompress(base64.b64decode(episode["data"])), np.uint8).reshape(2, -1).astype(int)
    levels, columns = numbers[0] + 256 * numbers[1], {}
    for each in episode["columns"]:
        size = each["count"] * episode["frames"]
        steps, levels = levels[:size].reshape(each["count"], -1), levels[size:]
        columns[each["name"]] = np.cumsum(steps, 1) % 2**16 * each["scale"] + each["offset"]
    return columns


def test_whole_episodes_are_compared(fresh):
    """The first is the episode that the policy drives here; another seed and another number are other episodes."""
    fresh.play(True)
    wait(lambda: fresh.over and not fresh.playing, 60.0)  # the last frame comes after the last state
    driven = np.stack([frame.trajectory.position for frame in fresh.frames])
    (_, summary) = next(fresh.baselines([]))
    choices = [Choice("go_to_goal", 0, 0), Choice("go_to_goal", 7, 0), Choice("go_to_goal", 0, 3)]
    *progress, result = fresh.compare(choices)
    assert {each["index"] for each in progress} == {0, 1, 2}
    assert progress[0]["seconds"] == 0.0 and all(each["seconds"] <= each["limit"] for each in progress)
    assert result["metrics"][0] == summary
    starts = []
    for recording, metrics in zip(result["recordings"], result["metrics"], strict=True):
        (episode,) = recording["episodes"]
        columns = columns_of(episode)
        assert episode["frames"] == round(metrics["seconds"] / fresh.scenario.time_step) + 1
        starts.append((columns["robot x"][0, 0], columns["robot y"][0, 0], columns["person x"][0, 0]))
    first = columns_of(result["recordings"][0]["episodes"][0])
    np.testing.assert_allclose(np.stack([first["robot x"][0], first["robot y"][0]], 1), driven, atol=0.0051)
    assert len(set(starts)) == 3 and "seed 7" in result["recordings"][1]["title"]


def test_an_error_stops_the_episode_and_not_the_studio(fresh, monkeypatch):
    news = []
    fresh.send = lambda kind, content: news.append((kind, content))
    step = fresh._step
    monkeypatch.setattr(fresh, "_step", lambda *_: (_ for _ in ()).throw(ValueError("a part of one's own broke")))
    fresh.play(True)
    wait(lambda: not fresh.playing)
    assert ("error", "the episode has stopped: a part of one's own broke") in news
    monkeypatch.setattr(fresh, "_step", step)
    fresh.restart(0)
    fresh.step()
    wait(lambda: len(fresh.commands) == 1)
    fresh.send = lambda kind, content: None


@pytest.mark.slow
def test_pictures_of_the_robots_cameras(fresh):
    for name, (width, height) in server.VIEWS.items():
        picture = fresh.picture(name, width, height)
        assert picture.shape == (height, width, 3) and picture.dtype == np.uint8 and np.ptp(picture) > 20


# ------------------------------------------------------------------ trials


def record(session, number, steps=25, left=0.2):
    """A recorded drive of a person that is stopped; its file."""
    session.restart(number)
    session.record()
    drive(session, steps, 0.8, left)
    return session.end_trial()


def sources(data):
    """The drives that demonstrations are from."""
    return [shard["trial"] for shard in data.manifest["shards"]]


def test_trials_become_demonstrations(fresh, tmp_path):
    """Each once, also those of a later session; one without a step leaves no file."""
    folder, everything = fresh.config.record, fresh.config.replace(demonstrations="all")
    for number in range(2):
        record(fresh, number)
    fresh.restart(2)
    fresh.record()
    assert fresh.status()["recording"]
    fresh.end_trial()
    assert len(list((folder / trial.TRIALS).iterdir())) == 2
    data = trial.demonstrations(everything).data
    assert len(data.episodes) == 2 and data.example_count >= 2 * 2
    again = []
    said = trial.demonstrations(everything, again.append)
    assert len(said.data.episodes) == 2 and again == [], "nothing is simulated again"
    record(fresh, 2, 12)
    assert len(trial.demonstrations(everything).data.episodes) == 3
    assert trial.demonstrations(fresh.config.replace(record=tmp_path / "none")).data is None


def test_a_drive_that_is_discarded_is_no_demonstration(fresh):
    """Whichever it is, and although another one follows; a name changes nothing else."""
    config = fresh.config.replace(demonstrations="all")
    names = [record(fresh, number).name for number in (0, 1)]
    assert sources(trial.demonstrations(config).data) == names
    first = trial.demonstrations(config).data.read([trial.demonstrations(config).data.episodes[1]])["pose"]
    fresh.discard(names[0])
    names.append(record(fresh, 2, left=-0.4).name)
    assert names[2] == "000002.jsonl", "a number is used once"
    data = trial.demonstrations(config).data
    assert sources(data) == names[1:]
    np.testing.assert_array_equal(data.read([data.episodes[0]])["pose"], first)
    fresh.rename(names[2], "a good one")
    seen = []
    assert sources(trial.demonstrations(config, seen.append).data) == [names[1], "000002-a good one.jsonl"] and not seen
    listed = fresh.drives()
    assert [row["name"] for row in listed] == ["", "a good one"] and listed[1]["by_person"] == 1.0
    for name in ("../evil", "a/b", "x" * 61, 3, "\ud83d"):
        with pytest.raises(InputError, match="give a name of letters"):
            fresh.rename(names[1], name)
    for file in ("nobody.jsonl", "../../etc/passwd", None, ["x"]):
        with pytest.raises(InputError, match="there is no such drive"):
            fresh.discard(file)
    fresh.restart(3)
    fresh.record()
    with pytest.raises(InputError, match="is being recorded"):
        fresh.discard(fresh.trial.file.name)


def finished(folder, name, by_person, outcome="completed", options=None):
    """A drive in a file, which stands still."""
    options = validate(StudioConfig, OPTIONS).identity() if options is None else options
    lines = [{"version": 2, "options": options, "episode": 0}]
    steps = {"commands": [[0.0, 0.0]] * len(by_person), "by_person": by_person}
    file = folder / trial.TRIALS / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("".join(json.dumps(line) + "\n" for line in [*lines, steps, {"end": outcome}]))
    return file


def test_demonstrations_are_the_steps_of_a_person(tmp_path, monkeypatch):
    """A person's whole seconds of completed drives, each piece by itself; of all steps if they are asked for."""
    monkeypatch.setattr(trial, "_belied", lambda drive, state: "")  # they stand still
    finished(tmp_path, "000000.jsonl", [False] * 20 + [True] * 35 + [False] * 15 + [True] * 20)
    finished(tmp_path, "000001.jsonl", [True] * 30, "stopped")
    finished(tmp_path, "000002.jsonl", [False] * 30)
    config = validate(StudioConfig, OPTIONS).replace(record=tmp_path)
    made = trial.demonstrations(config)
    shards = made.data.manifest["shards"]
    assert [shard["rows"] for shard in shards] == [[2, 5], [7, 9]] and set(sources(made.data)) == {"000000.jsonl"}
    assert made.data.by_person(made.data.episodes).all() and made.data.example_count == 5
    assert "2 of 3 drives have no demonstration of a person" in made.said[0] and "--demonstrations all" in made.said[0]
    everything = trial.demonstrations(config.replace(demonstrations="all")).data
    assert everything.manifest["policy"] == "human and policy" and everything.folder != made.data.folder
    assert [sum(shard["lengths"]) for shard in everything.manifest["shards"]] == [9, 3, 3]
    column = everything.by_person(everything.episodes)
    np.testing.assert_array_equal(np.flatnonzero(column), [2, 3, 4, 7, 8, 9, 10, 11])


def test_a_drive_is_what_it_says_when_it_is_simulated_again(fresh):
    """One that stood still was not completed, and nobody drives faster than the robot; a completed one is one."""
    folder = fresh.config.record
    fresh.record()
    fresh.play(True)
    wait(lambda: fresh.over and not fresh.playing, 60.0)
    real = fresh.end_trial() or folder / trial.TRIALS / "000000.jsonl"
    assert fresh.outcome == "completed"
    real.write_text(real.read_text().replace("false", "true"))
    options = json.loads(real.read_text().split("\n")[0])["options"]
    still = finished(folder, "000001.jsonl", [True] * 30, options=options)
    fast = still.with_name("000002.jsonl")
    fast.write_text(still.read_text().replace('"commands": [[0.0', '"commands": [[100.0'))
    longer = still.with_name("000003.jsonl")
    last = '{"commands": [[0.0, 0.0]], "by_person": [true]}\n{"end"'
    longer.write_text(real.read_text().replace('{"end"', last))
    made = trial.demonstrations(fresh.config)
    assert set(sources(made.data)) == {"000000.jsonl"}
    said = "\n".join(made.said)
    assert "000001.jsonl says that it was completed, and does not complete when it is simulated again; move it" in said
    assert "000002.jsonl has a person's command [100.0, 0.0] at step 0, beyond the limits of kuri" in said
    assert f"and its episode ends after {len(fresh.commands)}; move it" in said and "000003.jsonl" in said


def test_a_drive_ends_before_its_file_is_too_large_to_be_read(fresh, monkeypatch):
    """And before a command that the file cannot have: time goes on, and the page says why."""
    news = []
    fresh.send = lambda kind, content: news.append((kind, content))
    monkeypatch.setattr(trial, "MAX_TRIAL", 4_000)
    monkeypatch.setattr(trial, "END_ROOM", 1_500)
    fresh.record()
    file = fresh.trial.file
    drive(fresh, 120, 0.123456789, 0.1)
    assert fresh.trial is None and len(fresh.commands) >= 120
    assert ("error", "record: a drive has at most 20 MB; the recording has ended after its last whole second.") in news
    told = trial.read_trial(file)
    assert file.stat().st_size < 4_000 and told.outcome == trial.STOPPED and len(told.commands) % 10 == 0
    np.testing.assert_array_equal(told.commands, fresh.commands[: len(told.commands)])
    fresh.restart(1)
    fresh.record()
    drive(fresh, 12, 0.1, 0.1)
    fresh._write_trial(lambda one: one.add([(float("nan"), 0.0)], [False]))
    assert "the command [nan, 0.0] is not from -100 to 100" in news[-3][1] and fresh.trial is None
    assert len(fresh.drives()) == 2 and trial.recover(fresh.config.record) == []
    fresh.send = lambda kind, content: None


def test_the_card_says_who_has_driven(fresh):
    drive(fresh, 3, 1.0, 0.0)
    fresh.drive(False)
    count = len(fresh.commands)
    fresh.play(True)
    wait(lambda: len(fresh.commands) >= 3 * count)
    fresh.play(False)
    share = round(100 * count / len(fresh.commands))
    assert next(fresh.baselines([]))[0] == f"you {share} %, go_to_goal {100 - share} %"


def test_code_that_a_trial_names_is_not_run(tmp_path):
    """Drives from elsewhere may name a file; only the command line's own files are run."""
    (tmp_path / "mine.py").write_text("raise SystemExit('it ran')\ndef move(*_): pass\n")
    config = validate(StudioConfig, OPTIONS | {"model": f"{tmp_path}/mine.py:move"}).replace(record=tmp_path)
    one = trial.TrialFile.begin(config, 0)
    one.add([(0.1, 0.0)] * 10, [True] * 10)
    one.end("")
    plain = validate(StudioConfig, OPTIONS).replace(record=tmp_path)
    with pytest.raises(InputError, match="000000.jsonl needs the code .*mine.py:move; start the studio with"):
        trial.demonstrations(plain)


@pytest.mark.parametrize(
    ("name", "source", "said"),
    [
        ("other", "pass", "000000.jsonl needs the code .*mine.py:other; start the studio"),
        ("move", "# changed", "was driven with another .*mine.py, or does not say with which; restore that file"),
    ],
)
@pytest.mark.parametrize("people", [3, 5])
def test_code_that_a_trial_names_is_the_users_own_by_content(tmp_path, name, source, said, people):
    """Neither another name in a file that the user typed, nor a file that has changed since the drive, is run."""
    (tmp_path / "mine.py").write_text("raise SystemExit('it ran')\n")
    typed = OPTIONS | {"model": f"{tmp_path}/mine.py:move"}
    driven = validate(StudioConfig, typed | {"model": f"{tmp_path}/mine.py:{name}"}).replace(record=tmp_path)
    one = trial.TrialFile.begin(driven, 0)
    one.add([(0.1, 0.0)] * 10, [True] * 10)
    one.end("completed")
    (tmp_path / "mine.py").write_text(f"raise SystemExit('it ran')\n{source if name == 'move' else ''}")
    studio = validate(StudioConfig, typed | {"people": people}, typed=True).replace(record=tmp_path)
    with pytest.raises(InputError, match=said):
        trial.demonstrations(studio)
    if name == "move":
        with pytest.raises(InputError, match="has drives with (another .*mine.py|people 3)"):
            trial.TrialFile.begin(studio, 0)


def test_other_options_of_a_trial_run_with_the_users_own_code(tmp_path):
    """Of its own digest; what other files name is not trusted for that."""
    (tmp_path / "mine.py").write_text("def move(*_): pass\n")
    typed = OPTIONS | {"model": {"kind": f"{tmp_path}/mine.py:move", "force": 2}}
    studio = validate(StudioConfig, typed | {"people": 5}, typed=True).replace(record=tmp_path)
    driven = validate(StudioConfig, typed)
    code = user_parts.digests(driven)
    drive = trial.RecordedDrive(tmp_path / "a", "", json.loads(json.dumps(driven.identity())), 0, None, None, "", code)
    recorded = trial._options(studio, drive)
    assert recorded.people == 3 and recorded.model is studio.model and recorded.model.is_typed
    stronger = drive._replace(options=drive.options | {"model": {**drive.options["model"], "force": 9}})
    with pytest.raises(InputError, match="needs the code"):
        trial._options(studio, stronger)


def test_a_full_disk_ends_the_recording_alone(fresh, monkeypatch):
    """Time goes on, the page says why, and the seconds before are a drive."""
    news = []
    fresh.send = lambda kind, content: news.append((kind, content))
    fresh.record()
    drive(fresh, 15, 0.5, 0.0)
    file, fsync = fresh.trial.file, os.fsync

    def full(number):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    before = len(fresh.commands)
    drive(fresh, 15, 0.5, 0.0)
    monkeypatch.setattr(os, "fsync", fsync)
    assert len(fresh.commands) >= before + 15 and not fresh.status()["recording"]
    assert ("error", "record: No space left on device; the recording has ended after its last whole second.") in news
    assert "it ends after its last whole second" in trial.recover(fresh.config.record)[0]
    assert len(trial.read_trial(file).commands) >= 10 and trial.read_trial(file).outcome == trial.STOPPED

    def fails(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(trial.writing, "write", fails)
    with pytest.raises(InputError, match="record: the disk is full; nothing is recorded"):
        fresh.record()
    assert not fresh.status()["recording"]
    fresh.send = lambda kind, content: None


def test_a_folder_has_drives_of_the_same_options(fresh):
    fresh.record()
    drive(fresh, 3, 1.0, 0.0)
    fresh.end_trial()
    other = fresh.config.replace(people=5)
    with pytest.raises(InputError, match="record: .* has drives with people 3, not 5; choose another folder"):
        trial.TrialFile.begin(other, 0)
    fresh.config = fresh.config.replace(record=None)
    with pytest.raises(InputError, match="start the studio with --record FOLDER"):
        fresh.record()


@pytest.mark.parametrize("cut", range(0, 1900, 130))
def test_a_killed_trial_ends_after_its_last_whole_second(tmp_path, cut):
    """Or is removed if it was killed in its first second, also in the middle of its first line."""
    config = validate(StudioConfig, OPTIONS).replace(record=tmp_path)
    killed = trial.TrialFile.begin(config, 4)
    rows = [(0.1 * step, -0.2) for step in range(37)]
    killed.add(rows, [step > 5 for step in range(37)])
    killed._stream.close()
    whole = killed.file.read_bytes()
    killed.file.write_bytes(whole[: max(0, len(whole) - cut)])
    seconds = killed.file.read_bytes().count(b"\n") - 1
    (said,) = trial.recover(tmp_path)
    if seconds <= 0:
        assert "before its first step; it is removed" in said and not killed.file.exists()
        return
    told = trial.read_trial(killed.file)
    assert "it ends after its last whole second" in said and told.outcome == trial.STOPPED and told.episode == 4
    np.testing.assert_array_equal(told.commands, rows[: 10 * seconds])
    assert trial.recover(tmp_path) == []


def test_files_that_are_no_drives_stop_nobody(tmp_path, monkeypatch):
    """They are told with the cure, they stay as they are, and other drives are demonstrations."""
    monkeypatch.setattr(trial, "_belied", lambda drive, state: "")  # it stands still
    finished(tmp_path, "000001.jsonl", [True] * 30)
    (tmp_path / trial.TRIALS / "000000.jsonl").write_text("a colleague's\n")
    (tmp_path / trial.TRIALS / "000002.jsonl").mkdir()
    finished(tmp_path, "000003.jsonl", [True] * 900)
    config = validate(StudioConfig, OPTIONS).replace(record=tmp_path)
    said = trial.recover(tmp_path)
    assert len(said) == 2 and all("The drive is left out." in text for text in said)
    made = trial.demonstrations(config)
    assert sources(made.data) == ["000001.jsonl"]
    assert any("has 900 steps, and an episode at most 200" in text for text in made.said)
    assert (tmp_path / trial.TRIALS / "000000.jsonl").read_text() == "a colleague's\n"
    trial.TrialFile.begin(config, 0).end("")


def test_a_drive_with_wrong_options_is_left_out_by_name(tmp_path, monkeypatch):
    """Also if it is the first: it hinders neither other drives nor a recording, and its numbers close no page."""
    monkeypatch.setattr(trial, "_belied", lambda drive, state: "")
    config = validate(StudioConfig, OPTIONS).replace(record=tmp_path)
    good = json.loads(json.dumps(config.identity()))
    finished(tmp_path, "000000.jsonl", [True] * 20, options={"fly": 1})
    finished(tmp_path, "000001.jsonl", [True] * 20, options=good | {"time_step": 1e308})
    finished(tmp_path, "000002.jsonl", [True] * 20, options=good | {"environment": "nowhere"})
    finished(tmp_path, "000003.jsonl", [True] * 20)
    other = finished(tmp_path, "0.jsonl", [True] * 20, options={})  # another scenario, and first in the folder
    rows = trial.rows_of_page(tmp_path)
    assert [row["seconds"] for row in rows] == [None, None, None, 2.0, 2.0] and json.dumps(rows, allow_nan=False)
    trial.TrialFile.begin(config, 0).end("")
    made = trial.demonstrations(config)
    assert sources(made.data) == ["000003.jsonl"]
    for name in ("0", "000000", "000001", "000002"):
        assert any(f"/{name}.jsonl" in text and "The drive is left out." in text for text in made.said), made.said
    shutil.rmtree(tmp_path / trial.DATASETS["person"])
    (tmp_path / trial.TRIALS / "000003.jsonl").unlink()
    other.unlink()
    with pytest.raises(InputError, match="000000.jsonl"):
        trial.demonstrations(config)


def test_a_drive_never_takes_the_name_of_another_file(tmp_path):
    """A discarded one gets a free name; a name that is taken is refused in a sentence."""
    place = tmp_path / trial.TRIALS
    for _ in range(2):
        finished(tmp_path, "000000.jsonl", [True])
        trial.discard_trial(tmp_path, "000000.jsonl")
    assert sorted(file.name for file in (place / trial.DISCARDED).iterdir()) == ["000000 2.jsonl", "000000.jsonl"]
    assert trial.rows_of_page(tmp_path) == []
    for name in ("000001.jsonl", "000001-good.jsonl"):
        finished(tmp_path, name, [True])
    with pytest.raises(InputError, match="there is a file 000001-good.jsonl already, so 000001.jsonl stays; give"):
        trial.rename_trial(tmp_path, "000001.jsonl", "good")
    trial.rename_trial(tmp_path, "000001-good.jsonl", "good")
    assert len(trial.rows_of_page(tmp_path)) == 2


def test_nothing_is_written_through_links(tmp_path):
    """Of a folder that somebody has sent: neither the end of a drive, nor a new, discarded or committed one."""
    outside, folder = tmp_path / "outside", tmp_path / "received"
    live = finished(outside, "live.jsonl", [True] * 20)
    live.write_text(live.read_text().rpartition('{"end"')[0] + "half a line")
    before = live.read_bytes()
    place = folder / trial.TRIALS
    place.mkdir(parents=True)
    (place / "000000.jsonl").symlink_to(live)
    os.link(live, place / "000001.jsonl")
    (place / ".x.jsonl.new").mkdir()
    said = trial.recover(folder)
    assert len(said) == 2 and all("is a link" in text and "The drive is left out." in text for text in said)
    assert live.read_bytes() == before and trial.rows_of_page(folder) == []
    with pytest.raises(InputError, match="there is no such drive"):
        trial.discard_trial(folder, "000000.jsonl")
    finished(folder, "000002.jsonl", [True] * 20)
    (place / trial.DISCARDED).symlink_to(outside)
    with pytest.raises(InputError, match="discarded is a link"):
        trial.discard_trial(folder, "000002.jsonl")
    config = validate(StudioConfig, OPTIONS).replace(record=folder)
    (folder / "demonstrations").symlink_to(outside)
    with pytest.raises(InputError, match="demonstrations is a link"):
        trial.demonstrations(config)
    other = config.replace(record=tmp_path / "other")
    other.record.mkdir()
    (other.record / trial.TRIALS).symlink_to(outside / trial.TRIALS)
    assert "is a link" in trial.recover(other.record)[0] and trial.rows_of_page(other.record) == []
    with pytest.raises(InputError, match="trials is a link"):
        trial.TrialFile.begin(other, 0)
    assert sorted(file.name for file in outside.rglob("*")) == ["live.jsonl", "trials"]


HEAD = '{"version": 2, "options": {}, "episode": 0}'
STEPS = '{"commands": [[1, 2], [0, 0]], "by_person": [true, false]}'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "it has no line of a trial; move it out of the folder"),
        ("nonsense\n", "is not JSON"),
        ('{"version": 1, "options": {}, "episode": 0}\n', "version"),
        ('{"version": 3}\n', "version"),
        ("[1]\n", "no line of a trial"),
        (f"{STEPS}\n", "version"),
        ('{"version": 2, "options": [], "episode": 0}\n', "options"),
        ('{"version": 2, "options": {}, "episode": -1}\n', "episode"),
        ('{"version": 2, "options": {}, "episode": "x"}\n', "episode"),
        (f'{HEAD}\n{{"commands": [[{"9" * 400}, 0]], "by_person": [true]}}\n', "400 digits"),
        (f'{HEAD}\n{{"commands": [[{"9" * 5000}, 0]], "by_person": [true]}}\n', "000000.jsonl:2"),
        (f'{HEAD}\n{{"commands": [[1e300, 0]], "by_person": [true]}}\n', "commands"),
        (f'{HEAD}\n{{"commands": [[NaN, 0]], "by_person": [true]}}\n', "NaN is not JSON"),
        (f'{HEAD}\n{{"commands": [[1, 2, 3, 4]], "by_person": [true]}}\n', "commands"),
        (f'{HEAD}\n{{"commands": [[1]], "by_person": [true]}}\n', "commands"),
        (f'{HEAD}\n{STEPS}\n{{"commands": [[1, 2, 3]], "by_person": [true]}}\n', "some have 2 numbers, and some 3"),
        (f'{HEAD}\n{{"commands": [[1, 2]], "by_person": []}}\n', "by_person"),
        (f'{HEAD}\n{{"commands": [[1, 2]]}}\n', "by_person"),
        (f'{HEAD}\n{STEPS}\n{{"rewind": -5}}\n', "rewind"),
        (f'{HEAD}\n{STEPS}\n{{"rewind": 1.5}}\n', "rewind"),
        (f'{HEAD}\n{STEPS}\n{{"rewind": 1e999}}\n', "000000.jsonl:3"),
        (f'{HEAD}\n{STEPS}\n{{"rewind": 3}}\n', "rewind: 3 is beyond the 2 steps before it"),
        (f'{HEAD}\n{STEPS}\n{{"end": "won"}}\n', "end"),
        (f'{HEAD}\n{{"end": "stopped"}}\n{STEPS}\n', "has ended in an earlier line"),
        (f'{HEAD}\n{{"fly": 1}}\n', "none of commands, rewind, end"),
        (HEAD + "\n" + "[" * 4000 + "\n", "nested too deeply"),
    ],
)
def test_files_that_are_no_trials_are_refused(tmp_path, text, said):
    """In one sentence, which names the file and the line."""
    file = tmp_path / "000000.jsonl"
    file.write_text(text)
    with pytest.raises(FileError, match=re.escape("000000.jsonl")) as raised:
        trial.read_trial(file)
    assert said in str(raised.value) and len(str(raised.value)) < 1000


# ------------------------------------------------------------------ the server


@pytest.fixture
def impatient(monkeypatch, request):
    """``served``, with half a second of patience."""
    monkeypatch.setattr(local_server, "PATIENCE", 0.5)
    return request.getfixturevalue("served")


def socket_of(studio, token=None, origin=None, path="socket", name=""):
    address = f"ws://127.0.0.1:{studio.port}/{path}?token={token or studio.token}&tab={name}"
    return connect(address, origin=origin or f"http://127.0.0.1:{studio.port}", compression=None)


def test_the_page_is_for_this_computer_and_for_the_token(served):
    base = f"http://127.0.0.1:{served.port}"
    assert get(served.url) == (200, "<p>the page</p>")
    assert get(base + "/")[0] == get(base + "/?token=no")[0] == 403
    assert get(served.url, Host="evil.example")[0] == 403
    assert get(f"{base}/other?token={served.token}")[0] == 404
    with urllib.request.urlopen(served.url, timeout=5) as answer:
        policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and f"connect-src ws://127.0.0.1:{served.port} " in policy


def test_a_socket_is_for_the_page_alone(served):
    async def refused(**options):
        with pytest.raises(InvalidStatus) as raised:
            await socket_of(served, **options).__aenter__()
        return raised.value.response.status_code

    async def all_of_them():
        assert await refused(token="no") == 403
        assert await refused(origin="http://evil.example") == 403
        assert await refused(path="other") == 404

    asyncio.run(all_of_them())


def test_tabs_see_the_same_and_one_drives(served, fresh):
    async def go():
        async with socket_of(served) as one, socket_of(served) as two:
            for tab in one, two:
                assert (await until(tab, "hello"))["record"]
                assert (await until(tab, "frames"))["frames"] == 1
            await one.send(json.dumps({"do": "drive", "on": True}))
            await one.send(json.dumps({"do": "play", "on": True}))
            await one.send(json.dumps({"do": "command", "ahead": 1.0, "left": 5}))
            for tab in one, two:
                news = await until(tab, "frames")
                assert news["first"] >= 1 and len(news["bytes"]) % 2 == 0
            await two.send(json.dumps({"do": "rewind", "tick": 0}))
            assert "another tab drives" in (await until(two, "error"))["content"]
            for bad in ("x", "[]", "{}", '{"do": 3}', '{"do": "fly"}', '{"do": "command", "ahead": "fast"}',
                        '{"do": "speed", "speed": NaN}', '{"do": "rewind"}', b"\x00"):  # fmt: skip
                await one.send(bad)
                assert (await until(one, "error"))["content"]
            assert fresh.commands and abs(fresh.commands[-1][1]) <= fresh.limits[2]
        for _ in range(100):  # the driver's tab is closed: time stands still, and another may drive
            if not fresh.playing:
                break
            await asyncio.sleep(0.02)
        assert not fresh.playing
        length = len(fresh.commands)
        async with socket_of(served) as three:
            assert (await until(three, "frames"))["frames"] == length + 1
            await three.send(json.dumps({"do": "step"}))
            assert (await until(three, "frames"))["first"] == length + 1

    asyncio.run(go())


async def ask(tab, **request):
    await tab.send(json.dumps(request))


async def role(tab, expected):
    """The first status that says that this tab has a role."""
    while (status := (await until(tab, "status"))["content"])["you"] != expected:
        pass
    return status


def test_a_role_belongs_to_a_tab(served, fresh, monkeypatch):
    """A driver that loads its page again drives; nobody becomes the driver by a command, and anybody by the wheel."""
    monkeypatch.setattr(server, "RETURN", 1.0)
    one_name, two_name = "a" * 36, "b" * 36

    async def go():
        async with socket_of(served, name=two_name) as two:
            await role(two, "free")
            async with socket_of(served, name=one_name) as one:
                await ask(two, do="command", ahead=1.0, left=0.0)
                await ask(two, do="view", name="none")
                await role(one, "free")
                await ask(one, do="drive", on=True)
                await role(one, "driver")
                assert (await role(two, "watcher"))["you"] == "watcher"
                await ask(one, do="play", on=True)
                await ask(two, do="command", ahead=1.0, left=0.0)
                await until(one, "frames")

            # its page is loaded again: meanwhile another tab does what tabs do, and gets nothing by it
            await ask(two, do="command", ahead=1.0, left=0.0)
            await ask(two, do="play", on=True)
            assert "another tab drives" in (await until(two, "error"))["content"]
            async with socket_of(served, name=one_name) as one:
                assert (await role(one, "driver"))["human"]
                assert not fresh.playing, "time stands still meanwhile"
                await ask(one, do="play", on=True)
                await ask(two, do="take")
                await role(two, "driver")
                await role(one, "watcher")
                assert not fresh.playing
                await ask(one, do="give back")
                while "has taken the wheel" in (said := (await until(one, "error"))["content"]):
                    pass  # its play came too late
                assert "take the wheel, or watch" in said
                await ask(one, do="take")
                await role(one, "driver")
                await role(two, "watcher")

            # it does not come again: after a while anybody may drive
            await role(two, "free")
            await ask(two, do="drive", on=False)
            await role(two, "driver")

    asyncio.run(go())


def held_up(session, monkeypatch):
    """The next changes of files wait for an event; and an event that says that one has come so far."""
    goes_on, here, made = threading.Event(), threading.Event(), session.editor._with_file

    def slow(name, scenario):
        here.set()
        assert goes_on.wait(30)
        return made(name, scenario)

    monkeypatch.setattr(session.editor, "_with_file", slow)
    return goes_on, here


def test_changes_of_a_tab_that_lost_the_wheel_have_no_effect(served, fresh, monkeypatch):
    """Those of the tab that has it come one after the other, and none is lost."""
    goes_on, here = held_up(fresh, monkeypatch)

    async def go():
        async with socket_of(served) as one, socket_of(served) as two:
            await ask(one, do="edit", change={"node": "corner", "radius": 0.9})
            await asyncio.to_thread(here.wait, 30)
            await ask(two, do="take")
            await role(two, "driver")
            await ask(two, do="edit", change={"node": "door", "radius": 0.8})
            await ask(two, do="edit", change={"node": "door", "radius": 0.7})
            goes_on.set()
            assert "another tab has taken the wheel; nothing is changed" in (await until(one, "error"))["content"]
            while (news := (await until(two, "edit"))["content"])["changes"] < 2:
                pass
            assert "0.7" in news["difference"] and "0.9" not in news["difference"]
            await ask(two, do="undo")
            await ask(two, do="undo")
            while (await until(two, "edit"))["content"]["changes"]:
                pass

    asyncio.run(go())
    with pytest.raises(InputError, match="another tab has taken the wheel"):
        served._apply_of(object(), fresh, "play", {"on": True})
    assert not fresh.playing


def test_a_number_that_json_has_not_closes_no_tab():
    assert server._text({"a": [1.0, float("inf")], "b": {"c": float("nan")}}) == '{"a": [1.0, null], "b": {"c": null}}'


def test_no_drive_is_recorded_while_a_file_is_changed(fresh, monkeypatch):
    """A check of seconds, during which another tab presses record."""
    goes_on, here = held_up(fresh, monkeypatch)
    change = threading.Thread(target=fresh.edit, args=({"node": "door", "radius": 0.8},))
    change.start()
    assert here.wait(30)
    with pytest.raises(InputError, match="record: a file is being changed; wait until it is done"):
        fresh.record()
    goes_on.set()
    change.join(60)
    with pytest.raises(InputError, match="changes that are not saved"):
        fresh.record()
    fresh.edit(None)
    fresh.restart(0)
    fresh.record()
    for act in (lambda: fresh.edit(None), fresh.save):
        with pytest.raises(InputError, match="this drive is recorded on the files as they are"):
            act()


def test_a_tab_that_comes_before_the_old_one_is_gone_gets_its_role(served):
    """The server hears of the closed socket later than of the new one."""

    async def go():
        async with socket_of(served, name="c" * 36) as new:
            async with socket_of(served, name="c" * 36) as old:
                await ask(old, do="drive", on=True)
                await role(old, "driver")
                await role(new, "watcher")
            await role(new, "driver")

    asyncio.run(go())


def test_a_page_opens_what_it_offers_alone(served, fresh, tmp_path, monkeypatch):
    """A message names no file: code that nobody typed is not run, in whatever option it stands."""
    marker = tmp_path / "executed"
    (tmp_path / "evil.py").write_text(f"import pathlib\npathlib.Path({str(marker)!r}).touch()\ndef go(*_): pass\n")
    code = f"{tmp_path}/evil.py:go"

    def build(config):
        making.scenarios(config)
        learning.load_policy(config.policy, fresh.scenario)
        return fresh

    monkeypatch.setattr(server, "Session", build)
    bad = [{name: value} for name in server.CHOICES for value in (code, {"kind": code}, [code])]
    bad += [{"environment": str(tmp_path)}, {"people": code}, {"people": 10**400}, {"seed": True}, {"seed": -1},
            {"model": code}, {"forces": [code]}, [code], code]  # fmt: skip

    async def go():
        async with socket_of(served) as tab:
            for options in bad:
                await ask(tab, do="open", options=options)
                said = (await until(tab, "error"))["content"]
                assert ("reload the page" in said or "no number" in said) and len(said) < 300, said

    asyncio.run(go())
    assert not marker.exists()


def test_what_a_user_typed_stays_when_a_page_opens_another_scenario(tmp_path):
    (tmp_path / "mine.py").write_text("def go(*_): pass\n")
    code = f"{tmp_path}/mine.py:go"
    config = validate(StudioConfig, OPTIONS | {"policy": code, "behavior": {"kind": "graph", "routing": "edge"}})
    opened = server._opened(config, {"policy": code, "behavior": "graph", "environment": "warehouse", "people": ""})
    assert opened.policy == config.policy and opened.behavior == config.behavior and opened.people is None
    assert opened.environment == "warehouse" and opened.time_limit == config.time_limit
    other = server._opened(config.replace(task="join_group"), {"behavior": "random"})
    assert other.behavior.kind == "random" and other.task is None and other.people is None


def test_a_tab_that_comes_later_has_the_metrics(served, fresh):
    """Of the episode that has ended, until another one begins."""

    async def go():
        async with socket_of(served) as one:
            await ask(one, do="play", on=True)
            first = (await until(one, "card"))["content"]
            async with socket_of(served) as two:
                assert (await until(two, "card"))["content"] == first
            await ask(one, do="episode", episode=1)
            await until(one, "cut")
            async with socket_of(served) as two:
                kinds = [
                    json.loads(text)["kind"] for text in [await two.recv() for _ in range(5)] if isinstance(text, str)
                ]
                assert kinds == ["hello", "edit", "drives", "status"]

    asyncio.run(go())


def test_a_view_that_compiles_holds_up_no_other_view(served, monkeypatch):
    """The tab hears that it is prepared, and the other views go on."""
    compiled = threading.Event()

    def slow(self, name):
        if name == "third_person":
            assert compiled.wait(30)
        return local_server.framed({"kind": "scan" if name == "lidar" else "picture", "name": name}, b"")

    monkeypatch.setattr(Studio, "_view", slow)

    async def go():
        async with socket_of(served) as one, socket_of(served) as two:
            await ask(one, do="view", name="third_person")
            assert (await until(one, "preparing"))["content"] == "third_person"
            await ask(two, do="view", name="lidar")
            assert (await until(two, "scan"))["name"] == "lidar"
            compiled.set()
            assert (await until(one, "picture"))["name"] == "third_person"
            await ask(two, do="view", name="third_person")
            while (news := await asyncio.wait_for(two.recv(), 30)) and isinstance(news, str):
                assert json.loads(news)["kind"] != "preparing", "it is there already"

    try:
        asyncio.run(go())
    finally:
        compiled.set()


def test_wrong_messages_of_a_tab_that_does_not_read(served, caplog, monkeypatch):
    """The tab is closed, in no error of the server's own; another one goes on."""

    async def never(self, tab, queue):
        await asyncio.sleep(60)

    async def go():
        with monkeypatch.context() as patched:
            patched.setattr(Studio, "_write", never)
            async with socket_of(served) as tab:
                with pytest.raises(ConnectionClosed) as closed:
                    for _ in range(400):
                        await ask(tab, do="fly")
                    await tab.recv()
                assert closed.value.rcvd.code == 1013
        async with socket_of(served) as tab:
            await until(tab, "hello")

    asyncio.run(go())
    assert not [record for record in caplog.records if record.exc_info], caplog.text


def test_the_address_is_kept_for_its_owner_alone(tmp_path):
    """So that a page goes on with a studio that has started again; an address that others may know is not used."""
    first = address.recall(tmp_path)
    assert first.port == 0 and len(first.token) == 22
    address.keep(tmp_path, first._replace(port=4321))
    file = tmp_path / address.FILE
    assert file.stat().st_mode & 0o777 == 0o600 and address.recall(tmp_path) == (first.token, 4321)
    copy = tmp_path.with_name(tmp_path.name + "-copy")
    shutil.copytree(tmp_path, copy)
    assert (copy / address.FILE).stat().st_mode & 0o777 == 0o600
    sent = address.recall(copy)
    assert sent.token != first.token and sent.port == 0, "nobody chooses another's token"
    file.chmod(0o644)
    assert address.recall(tmp_path).token != first.token
    for text in ("", "[", '{"token": "x", "port": 1}', '{"token": "' + "a" * 22 + '", "port": 99999999999}', "[" * 900):
        file.unlink()
        file.touch(0o600)
        file.write_text(text)
        assert address.recall(tmp_path).port == 0
    file.unlink()
    file.symlink_to("/dev/zero")
    assert address.recall(tmp_path).port == 0
    address.keep(tmp_path, first._replace(port=5))
    assert not file.is_symlink() and address.recall(tmp_path).port == 5
    assert address.recall(None).port == 0


def test_large_messages_and_many_tabs_hurt_nobody(served):
    async def go():
        async with socket_of(served) as good:
            await until(good, "hello")
            async with socket_of(served) as bad:
                await bad.send("x" * 1_000_000)
                with pytest.raises(ConnectionClosed):
                    while True:
                        await asyncio.wait_for(bad.recv(), 10)
            async with contextlib.AsyncExitStack() as stack:
                refused = 0
                for _ in range(100):
                    try:
                        await stack.enter_async_context(socket_of(served))
                    except InvalidStatus as error:
                        assert error.response.status_code == 503
                        refused += 1
                assert refused == 100 - server.CONNECTIONS + 1
                await good.send(json.dumps({"do": "step"}))
                assert (await until(good, "frames"))["frames"] == 1
        await asyncio.sleep(0.1)
        async with socket_of(served) as last:
            await until(last, "hello")

    asyncio.run(go())


def test_a_tab_gets_pictures_while_it_shows_them(served, fresh):
    async def go():
        async with socket_of(served) as tab:
            await tab.send(json.dumps({"do": "view", "name": "depth"}))
            news = await until(tab, "picture")
            width, height = server.VIEWS["depth"]
            assert len(news["bytes"]) == width * height * 3 and (news["width"], news["height"]) == (width, height)
            await tab.send(json.dumps({"do": "view", "name": "lidar"}))
            news = await until(tab, "scan")
            distances = np.frombuffer(news["bytes"], "<u2") / 1000.0
            np.testing.assert_allclose(distances, fresh.scan(server.RAYS)[0], atol=2e-3)
            assert len(distances) == server.RAYS and distances.max() <= news["far"] + 1e-3
            await tab.send(json.dumps({"do": "view", "name": "none"}))

    asyncio.run(go())


def test_a_comparison_goes_to_the_tab_that_asks_and_ends_with_it(served, fresh):
    async def go():
        async with socket_of(served) as one, socket_of(served) as two:
            pair = [{"policy": "go_to_goal", "seed": 0, "episode": number} for number in (0, 1)]
            for choices, message in [
                ([pair[0], pair[0]], "both episodes are the same"),
                ([pair[0] | {"policy": "/tmp/mine.py:drive"}, pair[1]], "is not on the page"),
                ([pair[0] | {"policy": ["go_to_goal"]}, pair[1]], "is not on the page"),
                ([pair[0] | {"seed": None}, pair[1]], "seed: None is no number"),
                ([pair[0], 3], "no two episodes"),
                (pair * 2, "no two episodes"),
                ("all", "no two episodes"),
            ]:
                await one.send(json.dumps({"do": "compare", "choices": choices}))
                assert message in (await until(one, "error"))["content"]
            await one.send(json.dumps({"do": "play", "on": True}))
            await one.send(json.dumps({"do": "compare", "choices": pair}))
            assert (await until(one, "comparison"))["content"]["index"] == 0
            assert not fresh.playing, "time stands still meanwhile"
            await one.send(json.dumps({"do": "compare", "choices": []}))
            await one.send(json.dumps({"do": "fly"}))
            assert "no request" in (await until(one, "error"))["content"]
            assert served._comparison is None
            await one.send(json.dumps({"do": "compare", "choices": pair}))
            while "recordings" not in (content := (await until(one, "comparison"))["content"]):
                assert set(content) == {"index", "seconds", "limit"}
            assert len(content["recordings"]) == len(content["metrics"]) == 2
            await two.send(json.dumps({"do": "fly"}))  # the other tab has no news of it
            while True:
                news = await asyncio.wait_for(two.recv(), 10)
                kind = json.loads(news)["kind"] if isinstance(news, str) else "frames"
                assert kind != "comparison"
                if kind == "error":
                    break
            await one.send(json.dumps({"do": "compare", "choices": pair}))
            await until(one, "comparison")
            running = served._comparison
        await asyncio.wait_for(asyncio.to_thread(wait, lambda: running.done()), 20)
        assert running.cancelled() or running.done()

    asyncio.run(go())


def raw(studio, text=b""):
    """A TCP connection that has sent some bytes, and no more."""
    plain = socket.socket()
    plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    plain.settimeout(20)
    plain.connect(("127.0.0.1", studio.port))
    plain.sendall(text)
    return plain


def upgrade(studio):
    """The bytes that open a web socket."""
    lines = [f"GET /socket?token={studio.token} HTTP/1.1", f"Host: 127.0.0.1:{studio.port}", "Upgrade: websocket",
             f"Origin: http://127.0.0.1:{studio.port}", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
             "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="]  # fmt: skip
    return "\r\n".join([*lines, "", ""]).encode()


@pytest.mark.parametrize("text", [b"", b"GET / HTTP/1.1\r\nHost:"])
def test_a_connection_without_a_handshake_is_closed(impatient, text):
    """Also a hundred of them at once, which are no tabs; the service goes on."""
    silent = [raw(impatient, text) for _ in range(100)]

    async def go():
        async with socket_of(impatient) as tab:
            await until(tab, "hello")

    asyncio.run(go())
    for each in silent:
        while each.recv(4096):
            pass
        each.close()


def test_a_tab_that_answers_no_longer_is_closed(impatient, fresh):
    """It drove: time stands still, and another tab may drive."""
    fresh.set_speed(1.0)
    half_open = raw(impatient, upgrade(impatient))
    wait(lambda: len(impatient._tabs) == 1)
    request = json.dumps({"do": "play", "on": True}).encode()
    half_open.sendall(bytes([0x81, 0x80 | len(request), 0, 0, 0, 0]) + request)  # a frame with the mask 0
    wait(lambda: len(fresh.commands) > 0)

    async def go():
        async with socket_of(impatient) as tab:
            reading = asyncio.ensure_future(until(tab, "nothing"))  # or it would not answer either
            await asyncio.to_thread(wait, lambda: impatient._driver is None and not fresh.playing)
            assert len(impatient._tabs) == 1
            length = len(fresh.commands)
            await tab.send(json.dumps({"do": "step"}))
            await asyncio.to_thread(wait, lambda: len(fresh.commands) == length + 1)
            assert not fresh.over and set(impatient._tabs) == {impatient._driver}
            reading.cancel()

    asyncio.run(go())
    half_open.close()


def test_a_tab_that_stops_reading_holds_up_nobody(served):
    """Its queue is bounded: it is closed when that is full, while another tab gets all messages."""
    half_open = raw(served, upgrade(served))
    wait(lambda: len(served._tabs) == 1)

    async def go():
        async with socket_of(served) as tab:
            await until(tab, "status")
            for number in range(600):
                content = {"number": number, "text": 50_000 * "x"}
                served._loop.call_soon_threadsafe(served._put, {"kind": "flood", "content": content})
                assert (await until(tab, "flood"))["content"]["number"] == number
            assert len(served._tabs) == 1

    asyncio.run(go())
    half_open.close()


def test_tabs_that_come_at_once_are_no_more_than_allowed(served):
    async def come():
        try:
            tab = await socket_of(served).__aenter__()
            await until(tab, "hello")
        except (InvalidStatus, ConnectionClosed) as error:
            return error
        return tab

    async def go():
        came = await asyncio.gather(*(come() for _ in range(100)))
        tabs = [each for each in came if not isinstance(each, Exception)]
        assert len(tabs) == server.CONNECTIONS == len(served._tabs)
        await asyncio.gather(*(tab.close() for tab in tabs))
        async with socket_of(served) as tab:
            await until(tab, "hello")

    asyncio.run(go())


# ------------------------------------------------------------------ the command


def start(folder, *more, environment="lab", people=3):
    """`sean studio` in a process of its own, and the address that it prints."""
    number = [] if people is None else ["--people", str(people)]
    words = ["studio", "--environment", environment, *number, "--record", "drives", *more]
    process = subprocess.Popen([sys.executable, "-u", "-m", "sean_jax", *words], cwd=folder, stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True, env=os.environ)  # fmt: skip
    line = ""
    while not (found := re.search(r"http://\S+", line)):
        line = process.stdout.readline()
        assert line, "it ended"
    return process, found.group()


async def record_one(address, steps):
    port, token = re.search(r":(\d+)/\?token=(\S+)", address).groups()
    async with connect(f"ws://127.0.0.1:{port}/socket?token={token}", origin=f"http://127.0.0.1:{port}") as tab:
        first = (await until(tab, "status"))["content"]
        await asyncio.sleep(0.3)  # until the server has noticed that the tab before is closed
        await tab.send(json.dumps({"do": "episode", "episode": first["episode"] + bool(first["tick"])}))
        await until(tab, "cut")
        for request in ({"do": "record", "on": True}, {"do": "drive", "on": True}, {"do": "speed", "speed": 16},
                        {"do": "play", "on": True}):  # fmt: skip
            await tab.send(json.dumps(request))
        while True:
            await tab.send(json.dumps({"do": "command", "ahead": 0.5, "left": 0.1}))
            news = await until(tab, "frames")
            if news["first"] >= steps:
                return tab


@pytest.mark.night
def test_a_killed_studio_loses_one_second_and_no_finished_drive(tmp_path):
    process, address = start(tmp_path)
    for _ in range(2):
        asyncio.run(record_one(address, 30))
    asyncio.run(record_one(address, 45))
    process.kill()
    process.wait(10)
    trials = sorted((tmp_path / "drives" / trial.TRIALS).iterdir())
    lengths = [len(trial.read_trial(file).commands) for file in trials]
    assert len(trials) == 3 and min(lengths[:2]) >= 30 and lengths[2] >= 36
    process, again = start(tmp_path, "--demonstrations", "all")
    assert again == address, "open pages go on with it"
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0 and "3 demonstrations: drives/demonstrations-all" in " ".join(output.split()), output
    assert "demonstrations: drive 3 of 3, 000002.jsonl" in output, "it says what it does"
    data = learning.open_dataset(tmp_path / "drives" / trial.DATASETS["all"])
    assert len(data.episodes) == 3 and data.by_person(data.episodes).all()


@pytest.mark.night
def test_another_scenario_is_opened(tmp_path):
    """All tabs get it; one that is refused leaves the present one as it is."""
    process, address = start(tmp_path)
    port, token = re.search(r":(\d+)/\?token=(\S+)", address).groups()

    async def go():
        def tab():
            return connect(f"ws://127.0.0.1:{port}/socket?token={token}", origin=f"http://127.0.0.1:{port}")

        async with tab() as one, tab() as two:
            first = await until(one, "hello")
            assert (
                first["options"]["environment"] == "lab"
                and first["options"]["environment"] in first["choices"]["environment"]
            )
            await until(two, "hello")
            for options, message in [
                ({"behavior": "handcrafted", "task": "join_group"}, "needs groups"),
                ({"people": -1}, "people"),
                ({"policy": "nobody"}, "nobody"),
                ({"record": "/tmp"}, "options that the page does not have"),
                (3, "options that the page does not have"),
            ]:
                await one.send(json.dumps({"do": "open", "options": options}))
                assert message in (await until(one, "error"))["content"]
            await one.send(json.dumps({"do": "step"}))
            assert (await until(one, "frames"))["first"] <= 1
            await one.send(
                json.dumps(
                    {"do": "open", "options": {"robot": "jackal", "behavior": "random", "task": "", "people": 2}}
                )
            )
            for each in one, two:
                hello = await asyncio.wait_for(until(each, "hello"), 60)
                assert hello["recording"]["robot"]["name"] == "jackal" and "--robot jackal" in hello["command"]
                assert (await until(each, "frames"))["frames"] == 1
                assert (await until(each, "status"))["content"]["tick"] == 0

    asyncio.run(go())
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 0


@pytest.mark.night
def test_a_taken_port_is_refused(tmp_path):
    process, address = start(tmp_path)
    port = re.search(r":(\d+)/", address).group(1)
    words = ["studio", "--environment", "lab", "--people", "3", "--port", port]
    done = subprocess.run(
        [sys.executable, "-m", "sean_jax", *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    process.terminate()
    process.wait(60)
    assert done.returncode == 2 and f"port: {port} of 127.0.0.1 is not free (Address already in use)" in done.stderr, (
        done.stderr
    )


@pytest.mark.web
@pytest.mark.slow
def test_a_browser_drives(tmp_path):
    """Keys, a rewind, a take-over and two recorded drives in Chromium; the drives train a network."""
    chromium()
    process, address = start(tmp_path, "--demonstrations", "all")
    try:
        seen = json.loads(browse("test/studio.mjs", address, tmp_path))
    finally:
        process.terminate()
        output, _ = process.communicate(timeout=120)
    assert seen["errors"] == [] and set(seen["hosts"]) == {address.split("/")[2]}
    assert seen["outcomes"] == ["completed", "completed"] and seen["cards"][1:] == ["go_to_goal", "expert"]
    assert re.fullmatch(r"you \d+ %, go_to_goal \d+ %", seen["cards"][0])
    assert seen["gamepad"] > 0.1 and seen["rewound"] < seen["before"] and seen["picture"] == "third_person"
    assert "2 demonstrations" in " ".join(output.split())
    words = ["train", "imitation", "drives/demonstrations-all", "--epochs", "1", "--out", "network", "--quiet"]
    subprocess.run([sys.executable, "-m", "sean_jax", *words], cwd=tmp_path, check=True)


@pytest.mark.web
@pytest.mark.slow
def test_two_tabs_in_a_browser(tmp_path):
    """A hand that clicks: keys drive afterwards, the other tab watches, and a reload changes neither role nor card."""
    chromium()
    process, address = start(tmp_path)
    try:
        seen = json.loads(browse("test/roles.mjs", address, tmp_path))
    finally:
        process.terminate()
        process.communicate(timeout=120)
    assert seen["errors"] == [] and seen["sent"] == 0, "a tab that watches sends no command"
    assert set(seen["speeds"].values()) == {True} and seen["list"], "keys drive, and change no list"
    assert "nobody has the wheel" in seen["free"]
    state, disabled, note = seen["connecting"]
    assert state == "connecting" and note == "connecting to the studio" and "drive" in disabled
    state, disabled, note = seen["watching"]
    assert "watching · another tab drives" in state and note == ""
    assert {"give back", "step", "stop recording", "edit", "next episode"} <= set(disabled)
    assert "you drive" in seen["reloaded"][0] and "watching" in seen["reloaded"][1] and "watching" in seen["taken"]
    assert seen["moved"] == 0 and seen["cards"][2:] == ["go_to_goal", "expert"]
    assert re.fullmatch(r"you \d+ %, go_to_goal \d+ %", seen["cards"][1]) and seen["rows"][0] == "completedyesyesyes"
    assert seen["drive"][4] == "completed" and seen["drive"][6] == "yes"
    assert seen["preparing"] == ["none", False] and seen["caption"] == "depth"


@pytest.mark.web
@pytest.mark.slow
def test_a_browser_compares_and_has_a_3d_view(tmp_path):
    """Two episodes on one clock, one above the other on a narrow screen; the robot in the middle of the 3-D view."""
    chromium()
    process, address = start(tmp_path)
    results = []
    try:
        for script in "scene", "comparison":
            results.append(json.loads(browse(f"test/{script}.mjs", address, tmp_path)))
    finally:
        process.terminate()
        process.communicate(timeout=120)
    for seen in results:
        assert seen["errors"] == [] and seen["findings"] == [] and set(seen["hosts"]) == {address.split("/")[2]}
    scene, compared = results
    (first, scrolled, dragged, near, again), (narrow,) = scene["views"]
    for view in first, narrow:
        assert view["orange"] > 100, "the robot is in the middle"
    assert first["bright"] > narrow["bright"] + 0.1, "a dark page has a dark view"
    assert scrolled == first == again and dragged != first, "the wheel turns nothing before the view has the focus"
    assert near["orange"] > 2 * dragged["orange"] and scene["removed"] == 0
    assert scene["without"] == ["3-D (this browser has no WebGL)", True]
    assert "both episodes are the same" in compared["same"] and compared["canceled"] == 0 and compared["paused"]
    assert compared["titles"] == ["go_to_goal · seed 0 · episode 0", "expert · seed 0 · episode 0"]
    assert all(one == other for one, other in compared["clocks"]) and compared["clocks"][1][0] == 9.0
    (wide, narrow), rows = compared["tops"], compared["columns"]
    assert wide[0] == wide[1] and narrow[1] > narrow[0] + 200 and compared["width"] == 0
    assert rows[1:3] == compared["titles"] and "time, s" in rows


@pytest.mark.web
@pytest.mark.slow
@pytest.mark.parametrize("behavior", ["graph", "handcrafted"])
def test_a_browser_edits_the_files(tmp_path, behavior):
    """By a mouse that is real: nodes, edges, obstacles and a picture below, or the sets; comments are kept."""
    chromium()
    lab, mine = ROOT / "envs" / "lab", tmp_path / "mine"
    shutil.copytree(lab, mine)
    Image.new("RGB", (40, 20), (220, 30, 30)).save(tmp_path / "red.png")
    people = 3 if behavior == "graph" else None  # sets have their own
    process, address = start(tmp_path, "--behavior", behavior, environment="mine", people=people)
    try:
        assert json.loads(browse("test/axe.mjs", address)) == []
        seen = json.loads(browse("test/edit.mjs", address, tmp_path, tmp_path / "red.png"))
    finally:
        process.terminate()
        process.communicate(timeout=120)
    assert seen["errors"] == [] and seen["after"] > seen["before"] > 0
    names = "graph.yaml", "handcrafted.yaml", "scene.xml"
    old, new = ({name: (folder / name).read_text().split("\n") for name in names} for folder in (lab, mine))
    lines = {name: [line for line in new[name] if line not in old[name]] for name in new}
    if behavior == "graph":
        assert re.match(r"graph.yaml:\d+:\d+: nodes.door.position: .* is inside an obstacle", seen["note"])
        assert not seen["far"] and 0.0 < seen["scale"] < 6.4 / 20 / 1.9
        assert lines["handcrafted.yaml"] == [] and [len(lines[name]) for name in ("graph.yaml", "scene.xml")] == [5, 1]
        text = "\n".join(lines["graph.yaml"])
        for part in ("position: [-2.5, -0.5], radius: 1,", "flow: high", "[corner, east]", "[east, meeting]"):
            assert part in text
        assert 'pos="1.9 2.05 0.9" size="0.35 0.05 0.9" euler="0 0 90"' in lines["scene.xml"][0]
    else:
        assert re.search(r"handcrafted.yaml:\d+:\d+: sets.empty_1.goals\[0\]: .* is inside an obstacle", seen["note"])
        assert lines["graph.yaml"] == lines["scene.xml"] == [] and len(lines["handcrafted.yaml"]) == 1
        assert "goals: [[2.7, -0.2, 45]," in lines["handcrafted.yaml"][0]


def test_the_page_has_its_program():
    assert len(gzip.compress((pages.PACKAGE / "web/studio/page.min.js").read_bytes())) < 180_000
    assert (pages.PACKAGE / "web/replay/page.min.js").stat().st_size < 30_000, "three.js is for the studio alone"
    assert making.scenarios(validate(StudioConfig, OPTIONS))[0].warm_up == 1.0


# ------------------------------------------------------------------ the graph


@pytest.fixture(scope="module")
def edited(tmp_path_factory):
    """A session on a copy of the lab whose time stands still, with three people."""
    folder = tmp_path_factory.mktemp("edited") / "mine"
    shutil.copytree(ROOT / "envs" / "lab", folder)
    options = OPTIONS | {"environment": str(folder), "warm_up": 0.0, "record": str(folder.parent / "drives")}
    return Session(validate(StudioConfig, options))


GOOD = [
    {"node": "door", "position": [-2.9, -0.7004]},
    {"node": "door", "radius": 0.8},
    {"node": "meeting", "stay": [2, 3.5]},
    {"edge": ["corner", "door"], "flow": "high"},
    {"edge": ["corner", "door"], "flow": None},
]
BAD = [
    ({"node": "door", "position": [-6.0, -2.9]}, r"graph.yaml:\d+:\d+: nodes.door.position: .* is inside an obstacle"),
    ({"node": "door", "radius": -1}, "radius"),
    ({"node": "door", "radius": "wide"}, "radius: 'wide' is no number"),
    ({"node": "door", "position": [1.0]}, "position has two numbers"),
    ({"node": "door", "stay": [1, 2]}, "door has no stay"),
    ({"node": "door", "id": 3}, "'id' of node 'door' is not for the page"),
    ({"node": "door", "position": [1.0, 2.0], "remove": True}, "of node 'door' is not for the page"),
    ({"node": "door", "radius": 10**400}, "radius: 1000.* is no number from"),
    ({"node": "door", "radius": 1e300}, "radius: 1e.300 is no number from"),
    ({"node": "x" * 5000, "add": "waypoint", "position": [0, 0], "edge": "door"}, "5,000 characters, and a name has"),
    ({"edge": ["door", "y" * 5000], "flow": "low"}, "5,000 characters, and a name has"),
    ({"edge": ["door", "corner"], "flow": "z" * 5000}, "5,000 characters, and a name has"),
    ({"node": "nobody", "radius": 1}, "there is no node 'nobody'"),
    ({"edge": ["door", "corner"], "flow": "fast"}, "'fast' is not one of"),
    ({"edge": ["door"], "flow": "low"}, "are no two nodes"),
    ({}, "it names no node, edge, set or box"),
]


@pytest.mark.night
def test_people_go_on_with_a_changed_graph(edited):
    """In the same programs; what is refused changes nothing; undo leads back to the file."""
    edited.restart(0)
    edited._advance(None)
    programs = edited._step._cache_size()
    for change in GOOD[:4]:
        edited.edit(change)
        edited._advance(None)
    graph = edited.edits()["graph"]
    assert graph["position"][graph["names"].index("door")] == [-2.9, -0.7] and len(edited.commands) == 5
    before = dict(edited.editor.texts)
    for change, message in BAD:
        with pytest.raises(InputError, match=message) as raised:
            edited.edit(change)
        assert len(str(raised.value)) < 1000
    assert edited.editor.texts == before
    with pytest.raises(InputError, match="changes that are not saved"):
        edited.record()
    for _ in GOOD[:4]:
        assert edited.edits()["difference"]
        edited.edit(None)
    assert edited.edits()["difference"] == "" and edited._step._cache_size() == programs
    with pytest.raises(InputError, match="was changed in this episode; begin another one"):
        edited.record()
    with pytest.raises(InputError, match="there is no change"):
        edited.edit(None)


@pytest.mark.night
def test_people_begin_anew_on_another_graph_and_floor(edited):
    """A node and a box more: other tables, in which time goes on; undo leads back to the files."""
    edited.restart(0)
    for change in ({"node": "east", "add": "waypoint", "position": [0.6, 1.2], "edge": "corner"},
                   {"box": "box_1", "add": True, "position": [3.1, 1.9]}):  # fmt: skip
        edited._advance(None)
        edited.edit(change)
        assert len(edited.commands) == 0
        edited._advance(None)
    news = edited.edits()
    assert "east" in news["graph"]["names"] and [3.1, 1.9, 0.4, 0.4, 0.0, 1.0] in news["place"]["obstacles"]
    box = np.asarray(edited.scenario.environment.obstacles.center)
    assert (np.abs(box - [3.1, 1.9]).max(1) < 1e-6).any()
    edited.edit(None)
    edited.edit(None)
    assert edited.edits()["difference"] == "" and edited.on_file


@pytest.mark.night
def test_a_graph_is_saved_where_it_was_read(edited):
    file = edited.editor.folder / "graph.yaml"
    edited.edit({"node": "meeting", "capacity": 3})  # other seats: the episode begins anew
    assert len(edited.commands) == 0
    edited._advance(None)
    edited.save()
    assert "capacity: 3" in file.read_text() and edited.edits()["difference"] == ""
    edited.edit({"node": "door", "radius": 0.9})
    edited._advance(None)
    with pytest.raises(InputError, match="the files are saved. Another tab has the wheel: its next episode is on them"):
        edited.save(lambda: False)
    assert len(edited.commands) == 1 and "radius: 0.9" in file.read_text()
    with pytest.raises(InputError, match="a file was changed in this episode; begin another one"):
        edited.record()
    saved = edited._saved
    edited.restart(1)
    assert edited.scenario is saved and edited.on_file
    edited.edit({"node": "door", "radius": 0.95})
    file.write_text(file.read_text() + "\n# a colleague\n")
    with pytest.raises(InputError, match="has changed meanwhile"):
        edited.save()
    assert file.read_text().endswith("# a colleague\n")


def test_files_of_the_package_are_not_saved(fresh):
    fresh.edit({"node": "door", "radius": 0.9})
    with pytest.raises(InputError, match="an environment of the package; copy the folder"):
        fresh.save()
    fresh.edit(None)

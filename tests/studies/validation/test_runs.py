"""Recorded runs that are walked again: people come as recorded and go on freely, and their measures are as put in."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.studies.scenes import model
from sean_jax.studies.validation import runs
from sean_jax.studies.validation.checks import CheckContext, Skipped
from support.files import write
from support.tracks import moved, straight, tracks_of

STEADY = slice(150, 450)


def column(speed=1.2, gap=1.5, people=40):
    """People one behind the other in a file, who walk to the exit and 1.5 m on."""
    time = 0.1 * np.arange(600)
    y = 7.5 + gap * np.arange(people) - speed * time[:, None]
    present = (y < 7.5) & (y > -5.5)
    x = 0.9 + 0.2 * (-1.0) ** np.arange(people)
    return tracks_of(np.stack([np.broadcast_to(x, y.shape), y], -1), present)


def lanes_at_two_speeds(scenario, state):
    """Walks at 1 m/s on one side of the corridor, and at 1.4 m/s on the other."""
    people = state.pedestrians
    speed = jnp.where(people.position[:, :1] > 0.9, 1.0, 1.4)
    way = jnp.asarray([[0.0, -1.0]])
    return moved(people, jnp.where(people.present[:, None], speed * way, 0.0), scenario.time_step)


def run_of(tracks, width=1.8):
    return runs.RecordedRun("made", width, tracks, STEADY)


def test_people_come_as_recorded_and_are_free_from_the_line_on():
    run = run_of(column(), 0.95)
    scene, tracks = runs.walk_on(run, model(straight), 0)
    position, known = np.asarray(tracks.position), np.asarray(run.tracks.position)[: STEADY.stop + 1]
    before = np.asarray(run.tracks.present)[: STEADY.stop + 1] & (known[..., 1] > runs.FREE_FROM + 0.2)
    before[1:] &= before[:-1]  # people appear after their first step
    before[0] = False
    assert tracks.present[before].all() and np.abs(position - known)[before].max() < 1e-3

    # Free people walk at their own speeds, and leave behind the exit; nobody comes twice.
    speed = runs.individual_speeds(tracks, STEADY)
    assert speed.std() > 0.1 and speed.mean() == pytest.approx(1.55, abs=0.1)
    assert not np.asarray(tracks.present)[-1, :10].any()
    assert (np.abs(np.diff(np.asarray(tracks.present).astype(int), axis=0)).sum(0) <= 2).all()
    again = runs.walk_on(run, model(straight), 1)[1]
    assert np.abs(np.asarray(again.position) - position).max() > 0.1 and len(scene.gates) == 2


def test_measures_of_a_file_are_those_put_in():
    pytest.importorskip("pedpy")
    tracks = column(1.2, 1.5)
    passage = runs.measure(tracks, STEADY)
    assert passage.speed == pytest.approx(1.2, rel=0.01) and passage.deviation < 1e-6
    assert passage.flow == pytest.approx(1.2 / 1.5, rel=0.02)
    assert passage.density[:-1] == pytest.approx(1.0 / (1.5 * runs.WIDTH), rel=0.1)


def test_a_run_that_is_walked_as_recorded_passes_and_others_do_not():
    known = runs.Passage(1.0, 0.1, 2.0, np.array([1.0, 1.2, 1.4, 1.6]), np.ones(4))
    assert runs.compare_passages({"run": known}, {"run": known}).passed
    thick = known.density * [0.8, 1.0, 1.0, 1.1]
    for changes in (
        {"speed": 1.2},
        {"deviation": 0.06},
        {"deviation": 0.14},
        {"flow": 1.6},
        {"density": thick},
        {"density": 1.2 * known.density},
    ):
        found = runs.compare_passages(
            {"run": known, "other": known}, {"run": known, "other": known._replace(**changes)}
        )
        assert not found.passed and "missed: other" in found.reason


def test_a_file_is_sampled_and_knows_its_exit(tmp_path):
    lines = [f"{100 + 4 * k},7,0.9,{7.5 - 0.3 * k}" for k in range(40)]
    lines += [f"{140 + 4 * k},9,0.5,{7.5 - 0.2 * k}" for k in range(20)]
    path = tmp_path / "uo-180-180-095_4of16fps.csv"
    write(path, "frame,ped_id,x_m,y_m\n" + "\n".join(lines) + "\n")
    run = runs.read_run(path, (116, 164))
    assert (run.name, run.exit_width, run.steady) == ("uo-180-180-095", 0.95, slice(10, 40))
    position, present = np.asarray(run.tracks.position), np.asarray(run.tracks.present)
    assert position[:, 0, 1][present[:, 0]] == pytest.approx(7.5 - 0.12 * np.arange(present[:, 0].sum()))
    assert present[:, 1].argmax() == 25 and present[:, 1].sum() == pytest.approx(19 * 2.5, abs=1.0)


def test_the_check_walks_recordings_again(tmp_path, monkeypatch):
    pytest.importorskip("pedpy")
    monkeypatch.setattr(runs, "STEADY", {"uo-180-180-180": [160, 400]})
    lines = []
    for number in range(40):
        speed, x = ((1.0, 1.2), (1.4, 0.6))[number % 2]
        begin = 32 * (number // 2)
        moments = [frame for frame in range(begin, 480, 4) if speed * (frame - begin) / 16.0 < 13.0]
        lines += [f"{frame},{number},{x},{7.5 - speed * (frame - begin) / 16.0}" for frame in moments]
    path = tmp_path / "juelich" / "uo-180-180-180_4of16fps.csv"
    write(path, "frame,ped_id,x_m,y_m\n" + "\n".join(lines) + "\n")

    found = {}
    for walks in (lanes_at_two_speeds, straight):
        context = CheckContext(model(walks), quick=True, data=tmp_path)
        found[walks] = runs.walk_runs_again(context)
        assert [caption for caption, *_ in context.pictures] == ["uo-180-180-180"]
    assert found[lanes_at_two_speeds].passed, found[lanes_at_two_speeds].reason
    assert found[lanes_at_two_speeds].numbers["speed_uo-180-180-180"] == pytest.approx(0.0, abs=0.02)
    assert not found[straight].passed and "speed" in found[straight].reason


def test_runs_are_skipped_where_there_are_none(tmp_path):
    pytest.importorskip("pedpy")
    context = CheckContext(model(straight), quick=True, data=tmp_path)
    for missing in (context, replace(context, data=None)):
        with pytest.raises(Skipped, match="--data"):
            runs.walk_runs_again(missing)

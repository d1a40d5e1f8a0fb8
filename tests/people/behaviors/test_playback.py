"""Playback (section IV-D): recorded people are where they were recorded, enter and leave; an open place works too."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.drawing import view
from sean_jax.people.recordings import reading
from sean_jax.policies import go_to_goal
from sean_jax.simulation import scenario as stages
from sean_jax.studies.inverse_graph.measuring import begin_alone
from support import crowds, programs
from support.scenes import room

RATE = 2.5  # frames a second, as of a recording at every tenth of 25 frames
WALKS = {  # id: (first frame, last frame, place at the first, velocity [m/s])
    "7": (0, 40, (-8.0, 2.0), (1.0, 0.0)),
    "8": (10, 30, (8.0, -2.0), (-1.25, 0.0)),
    "9": (35, 55, (0.0, 8.0), (0.0, -0.5)),  # enters after 8 has left
    "10": (20, 55, (3.0, 3.0), (0.0, 0.0)),
}


def where(person, seconds):
    """Place [m] of a recorded person, None if absent."""
    first, last, place, velocity = WALKS[person]
    if not first / RATE - 1e-6 <= seconds <= last / RATE + 1e-6:
        return None
    return np.array(place) + (seconds - first / RATE) * np.array(velocity)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An open square and a recording of it."""
    path = room(tmp_path_factory.mktemp("square"), (-10, -10, 10, 10), people=4)
    lines = ["frame,id,x,y"]
    for person, (first, last, _, _) in WALKS.items():
        for frame in range(first, last + 1):
            x, y = where(person, frame / RATE)
            lines.append(f"{frame},{person},{x:.4f},{y:.4f}")
    (path / "people.csv").write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def played(folder):
    scenario = sean_jax.make(
        folder,
        behavior="playback",
        task="random_ab_nav",
        recording=folder / "people.csv",
        frame_rate=RATE,
        dynamics="twin",
        time_limit=30.0,
    )
    run = jax.jit(lambda key: sean_jax.rollout(scenario, go_to_goal, key, 250))
    return scenario, *run(jax.random.key(0))


@pytest.mark.night
def test_everybody_is_where_they_were_recorded_and_nobody_else(played):
    scenario, _, frames = played
    assert scenario.people == 3  # never more than that at once: 9 takes the row of 8
    people, present = np.asarray(frames.people), np.asarray(frames.present)
    for step in range(250):
        seconds = (step + 1) * 0.1
        expected = [place for person in WALKS if (place := where(person, seconds)) is not None]
        found = people[step][present[step]]
        assert len(found) == len(expected), seconds
        gap = np.linalg.norm(found[:, None] - np.array(expected).reshape(-1, 1, 2).swapaxes(0, 1), axis=-1)
        assert not len(expected) or gap.min(0).max() < 1e-3
    assert np.isfinite(people).all() and not present[-1].any()


def test_velocities_and_headings_are_those_of_the_walks(played):
    _, _, frames = played
    velocity, heading = np.asarray(frames.people_velocity), np.asarray(frames.people_heading)
    row = np.flatnonzero((np.abs(np.asarray(frames.people[20]) - where("7", 2.1)) < 1e-3).all(-1))[0]
    np.testing.assert_allclose(velocity[20, row], [1.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(heading[20, row], [1.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(heading, axis=-1), 1.0, atol=1e-5)
    assert np.abs(velocity[~np.asarray(frames.present)]).max() == 0.0


def test_the_robot_moves_among_them_and_is_measured(played):
    scenario, last, frames = played
    travelled = np.linalg.norm(np.diff(np.asarray(frames.position), axis=0), axis=-1).sum()
    assert travelled > 2.0
    people, present = np.asarray(frames.people), np.asarray(frames.present)
    gap = np.linalg.norm(people - np.asarray(frames.position)[:, None], axis=-1)
    measured = float(np.ravel(programs.results(scenario, last)["min_distance_to_people"])[0])
    before = min(np.linalg.norm(place - np.asarray(last.task.start)) for place in [where("7", 0.0)])
    active = np.asarray(frames.active)
    assert measured == pytest.approx(min(gap[active][present[active]].min(), before), abs=1e-3)
    assert view(frames, scenario).axes


def test_an_episode_is_a_part_of_a_longer_recording(folder):
    scenario = sean_jax.make(
        folder,
        behavior="playback",
        task="busy_ab_nav",
        recording=str(folder / "people.csv"),
        frame_rate=RATE,
        dynamics="twin",
        time_limit=5.0,
    )
    keys = jax.random.split(jax.random.key(0), 40)
    people, _, memory = jax.jit(jax.vmap(lambda key: scenario.behavior.reset(scenario, key)))(keys)
    first = np.asarray(memory.first)
    assert first.min() >= 0 and first.max() <= 220 - 50 and len(np.unique(first)) > 20
    for moment, there in zip(first, np.asarray(people.present), strict=True):
        assert there.sum() == sum(where(person, moment * 0.1) is not None for person in WALKS)


def test_whoever_is_not_seen_for_long_has_left(tmp_path):
    path = tmp_path / "gap.csv"
    rows = [(frame, 0.1 * frame) for frame in (*range(10), *range(40, 50), 53)]
    path.write_text("frame,ped_id,x_m,y_m\n" + "".join(f"{frame},a,{x},0\n" for frame, x in rows))
    table = reading.read(path, frame_rate=10.0, time_step=0.1)
    there = np.asarray(table.present)[:, 0]
    assert there.tolist() == [True] * 10 + [False] * 30 + [True] * 14  # a short gap is bridged
    np.testing.assert_allclose(np.asarray(table.position)[50:54, 0, 0], [5.0, 5.1, 5.2, 5.3][:4], atol=0.01)


@pytest.mark.parametrize("rate", [2.5, 3.0, 7.0, 10.0, 16.0, 29.97, 30.0])
def test_a_gap_of_two_seconds_is_bridged_wherever_it_is(tmp_path, rate):
    """Whatever rounding does to the times of its ends; only rates that have a frame two seconds later are asked."""
    gap, path = int(2.0 * rate), tmp_path / "gap.csv"
    for first in (0, 1, 7, 1001, 12345, 999_999):
        rows = "".join(f"{frame},a,{0.1 * k},0\n" for k, frame in enumerate((first, first + gap, first + gap + 1)))
        path.write_text("frame,id,x,y\n" + rows)
        assert np.asarray(reading.read(path, frame_rate=rate, time_step=0.1).present)[:20].all(), first


def test_columns_are_those_of_first_fit():
    """Each walk is in the first column that has been free for a step, by looking through all of them."""
    generator = np.random.default_rng(0)
    for _ in range(50):
        begins = np.sort(generator.integers(0, 60, 80)).tolist()
        walks = [reading.RecordedWalk(begin, np.zeros((int(generator.integers(2, 25)), 2)), 0) for begin in begins]
        plain: list = []
        for walk in walks:
            column = next((each for each in plain if each[-1].begin + len(each[-1].places) < walk.begin), None)
            if column is None:
                plain.append(column := [])
            column.append(walk)
        found = reading._columns(walks, Path("people.csv"))
        assert [[id(walk) for walk in column] for column in found] == [
            [id(walk) for walk in column] for column in plain
        ]


def test_more_people_at_once_than_there_can_be_are_refused(monkeypatch):
    monkeypatch.setattr(reading, "MAX_PEOPLE", 3)
    walks = [reading.RecordedWalk(0, np.zeros((5, 2)), 0)] * 4
    assert len(reading._columns(walks[:3], Path("people.csv"))) == 3
    with pytest.raises(ValueError, match="people.csv: more than 3 people are there at once; cut the recording"):
        reading._columns(walks, Path("people.csv"))


def test_a_recording_of_many_people_is_read(tmp_path):
    path = tmp_path / "many.csv"
    lines = [f"{2 * person + k},{person},{0.1 * k:.1f},0" for person in range(20_000) for k in range(5)]
    path.write_text("frame,id,x,y\n" + "\n".join(lines) + "\n")
    assert np.asarray(reading.read(path, frame_rate=10.0, time_step=0.1).present).sum() == 100_000


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame,x,y\n0,1,1\n", "bad.csv:1: has no column ped_id or id or person but frame, x, y"),
        ("frame,id,x,y\n0,a,1,1\n1,a,one,1\n", "bad.csv:3: is no line of a person and numbers"),
        ("frame,id,x,y\n0,a,1,nan\n", "bad.csv:2: y is nan, which is not finite"),
        ("frame,id,x,y\n0,a,1,1\n0,a,1,2\n", "bad.csv:3: the person is already there in frame 0"),
        ("frame,id,x,y\n0,a,1,1\n", "nobody is there for two control steps"),
    ],
)
def test_a_recording_that_cannot_be_used_is_refused(tmp_path, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        reading.read(path, frame_rate=25.0, time_step=0.1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (dict(), "'playback' needs a recording"),
        (dict(recording="nowhere.csv"), "recording: nowhere.csv does not exist"),
        (dict(recording="people.csv", people=5), "people: 5, but 3 are there at once"),
        (dict(recording="people.csv", frame_rate=0.0), "frame_rate: 0.0 must be from 0.001"),
        (
            dict(recording="people.csv", frame_rate=None),
            "does not tell how many frames a second it has; give frame_rate",
        ),
        (dict(recording="people.csv", frame_rate=25.0), "people walk at .* m/s, and nobody does; look at frame_rate"),
        (dict(recording="people.csv", recording_format="juelch"), "did you mean 'juelich'"),
        (dict(recording="people.csv", behavior="random"), "recording: behavior 'random' has no such option"),
        (dict(recording="people.csv", task="join_group"), "needs groups"),
        (dict(recording="people.csv", model="orca"), "where people walk as recorded"),
    ],
)
def test_what_does_not_go_together_is_refused(folder, arguments, words):
    if arguments.get("recording") == "people.csv":
        arguments = arguments | {"recording": folder / "people.csv"}
    given = dict(behavior="playback", task="random_ab_nav", frame_rate=RATE, dynamics="twin") | arguments
    with pytest.raises(ValueError, match=words):
        sean_jax.make(folder, **given)


@pytest.mark.slow
def test_gradients_pass(played):
    """Of the distance between the robot and people after a step, by the command and by where people were."""
    scenario = played[0]
    start = jax.jit(begin_alone)(scenario, jax.random.key(1))

    @jax.jit
    @functools.partial(jax.grad, argnums=(0, 1))
    def slope(action, position):
        before = start.replace(pedestrians=start.pedestrians.replace(position=position))
        after = stages.move_robot(scenario, crowds.people_step(scenario, before), action)
        return ((after.robot.position[None] - after.pedestrians.position) ** 2).sum()

    by_action, by_position = slope(jnp.asarray([0.3, 0.1], jnp.float32), start.pedestrians.position)
    assert np.isfinite(by_action).all() and np.abs(by_action).max() > 0.0 and np.isfinite(by_position).all()

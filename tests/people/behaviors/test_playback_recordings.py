"""Playback of real recordings (section IV-D): ETH Hotel, UCY Zara 1 and two corridors of Juelich, beside a robot.

The recordings are other people's work: without SEAN_JAX_DATA these tests are skipped.
"""

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax.people.recordings import motion_between_rows, reading
from sean_jax.policies import go_to_goal
from support.scenes import room

FILES = {  # path, format, frames a second
    "eth": ("eth_ucy/eth.csv", None, 15.0),
    "hotel": ("eth_ucy/hotel.csv", None, 25.0),
    "zara01": ("eth_ucy/zara01.csv", None, 25.0),
    "uo": ("juelich/uo-180-180-180_4of16fps.csv", "juelich", 16.0),
    "bo": ("juelich/bo-360-160-160_4of16fps.csv", "juelich", 16.0),
}
EPISODES, SECONDS, STEP = 4, 20, 0.1
GAP = 2.0  # s, after which somebody who is not seen has left


QUICK = "hotel"  # each file takes a compilation of its own


@pytest.fixture(
    scope="module", params=[name if name == QUICK else pytest.param(name, marks=pytest.mark.slow) for name in FILES]
)
def played(request, recordings, tmp_path_factory):
    """The rows of a recording, and episodes of it on an open floor that holds everybody."""
    path, kind, rate = FILES[request.param]
    table = np.loadtxt(recordings / path, delimiter=",", skiprows=1, usecols=(0, 1, 2, 3))
    low, high = table[:, 2:].min(0) - 2.0, table[:, 2:].max(0) + 2.0
    folder = room(tmp_path_factory.mktemp(request.param), [round(float(value), 2) for value in (*low, *high)])
    scenario = sean_jax.make(
        folder, behavior="playback", task="random_ab_nav", recording=recordings / path,
        recording_format=kind, dynamics="twin", time_limit=float(SECONDS), task_distance=(2.0, 12.0),
    )  # fmt: skip
    scenario = scenario.replace(metrics=scenario.metrics[:2])  # pyright: ignore[reportAttributeAccessIssue]

    @jax.jit
    @jax.vmap
    def run(key):
        first = sean_jax.reset(scenario, key)
        return first, *sean_jax.simulate(scenario, go_to_goal, first, round(SECONDS / STEP))

    first, _, frames = run(jax.random.split(jax.random.key(0), EPISODES))
    table[:, 0] = (table[:, 0] - table[:, 0].min()) / rate
    return scenario, first, jax.tree.map(np.asarray, frames), table


@pytest.mark.parametrize(
    ("path", "kind", "reader"),
    [
        ("eth_ucy/eth.csv", None, "eth_ucy"),
        ("eth_ucy/hotel.csv", None, "eth_ucy"),
        ("eth_ucy/zara01.csv", None, "eth_ucy"),
        ("juelich/uo-050-180-180_4of16fps.csv", "juelich", "juelich"),
    ],
)
def test_people_walk_as_fast_in_playback_as_in_the_reader(recordings, path, kind, reader):
    """Both know the clock of the format: ETH's 15 frames a second were played at 25, and people walked 2.4 m/s."""
    played = reading.read(recordings / path, kind, time_step=STEP)
    speed = np.linalg.norm(motion_between_rows(played)[0], axis=-1)[np.asarray(played.present)].mean()
    read = reading.read(recordings / path, reader)
    steps = np.linalg.norm(np.diff(read.position, axis=0), axis=-1) / read.time_step
    both = np.asarray(read.present[1:] & read.present[:-1])
    assert 1.0 < speed < 1.6
    assert speed == pytest.approx(steps[both].mean(), rel=0.03)


def stretches(table):
    """(time (K,), places (K, 2)) for each stretch in which somebody is seen, from rows time, id, x, y."""
    for person in np.unique(table[:, 1]):
        rows = table[table[:, 1] == person]
        rows = rows[np.argsort(rows[:, 0])]
        for part in np.split(rows, np.flatnonzero(np.diff(rows[:, 0]) > GAP) + 1):
            yield part[:, 0], part[:, 2:]


def test_everybody_is_where_they_were_recorded_and_nobody_else(played):
    """At each step as many as were there, each on the line between two recorded places, to 2 mm."""
    scenario, first, frames, table = played
    walks = list(stretches(table))
    begin = np.asarray(first.memory.first)
    assert len(set(begin.tolist())) > 1
    for episode in range(EPISODES):
        for k in range(0, frames.people.shape[1], 7):
            now = (begin[episode] + k + 1) * STEP
            places = [
                [np.interp(now, time, place[:, axis]) for axis in (0, 1)]
                for time, place in walks
                # a control step is the least that somebody is there for, and only whole ones count
                if np.ceil(time[0] / STEP - 1e-6) * STEP <= now + 1e-6 <= np.floor(time[-1] / STEP + 1e-6) * STEP + 2e-6
                and np.floor(time[-1] / STEP + 1e-6) > np.ceil(time[0] / STEP - 1e-6)
            ]
            found = frames.people[episode, k][frames.present[episode, k]]
            assert len(found) == len(places), (episode, now)
            if places:
                apart = np.linalg.norm(found[:, None] - np.array(places)[None], axis=-1)
                assert apart.min(1).max() < 2e-3 and apart.min(0).max() < 2e-3


def test_people_enter_and_leave_and_nobody_is_moved_by_the_robot(played):
    scenario, first, frames, table = played
    entered = frames.present[:, 1:] & ~frames.present[:, :-1]
    left = frames.present[:, :-1] & ~frames.present[:, 1:]
    assert entered.sum() >= 2 and left.sum() >= 2
    assert np.isfinite(frames.people).all() and np.isfinite(frames.position).all()
    heading = np.linalg.norm(frames.people_heading, axis=-1)
    np.testing.assert_allclose(heading[frames.present], 1.0, atol=1e-4)
    speed = np.linalg.norm(frames.people_velocity, axis=-1)[frames.present]
    assert 0.2 < np.median(speed) < 2.0


def test_the_robot_moves_among_them_and_is_in_situations(played):
    scenario, first, frames, _ = played
    travelled = np.linalg.norm(np.diff(frames.position, axis=1), axis=-1).sum(1)
    assert (travelled > 0.5).all() and travelled.max() > 2.0
    gap = np.linalg.norm(frames.people - frames.position[:, :, None], axis=-1)
    nearest = np.where(frames.present, gap, np.inf).min(-1)
    assert nearest.min() < 2.4
    names = [name for name, _ in scenario.situations]
    share = dict(zip(names, frames.situations.mean((0, 1)), strict=True))
    assert share["join_group"] == share["leave_group"] == 0.0  # a recording has no groups
    assert 0.0 < share["empty"] < 1.0 or nearest.max() < 2.4
    np.testing.assert_array_equal(frames.situations[..., names.index("empty")], nearest >= 2.4)

"""Demonstrations of section V-B: rows against single steps, examples against numpy, the shares of the protocol."""

from types import SimpleNamespace
from typing import Any, cast

import jax
import numpy as np
import pytest

from sean_jax import sensors
from sean_jax.config import CollectConfig, GraphBehavior, flags, gather, validate
from sean_jax.core import random_streams
from sean_jax.core.errors import InputError
from sean_jax.learning import dataset, examples
from sean_jax.learning.collection import (
    Recorder,
    check_collection,
    next_stream,
    record,
    row_record,
    simulate_shard,
    streams,
)
from sean_jax.simulation import episode_runner
from sean_jax.simulation.scenario import reset
from support import learning_data, trees


@pytest.fixture(scope="module")
def batch():
    return learning_data.batches()[0]


@pytest.mark.night
def test_a_recorder_fed_with_the_drivers_commands_records_the_same(tmp_path):
    """Step by step, outside of jit, from another source: in the same episodes, the same rows as those of the batch.

    Rounding differs, and crowds are chaotic: rows are compared in the first ten seconds of each episode.
    """
    parts, _ = learning_data.setting()
    scenario = parts["join_group"]
    drive = jax.jit(learning_data.DRIVE)
    recorder = Recorder(tmp_path / "one", scenario, seed=learning_data.SEED, width=16, height=12)
    for number in range(2):
        state = recorder.begin(jax.random.fold_in(random_streams.key("collect", learning_data.SEED), number))
        while not bool(state.completed | state.timed_out):
            state = recorder.step(drive(scenario, state, state.streams.policy))
        recorder.commit()
    data, batch = recorder.data, learning_data.batches()[0]
    assert [episode.length for episode in data.episodes] == batch.lengths[:2].tolist()
    assert [episode.completed for episode in data.episodes] == batch.completed[:2].tolist()
    firsts = np.minimum(batch.lengths[:2], 10)
    found = data.read(data.episodes)
    starts = np.cumsum([0, data.episodes[0].length])
    for name, values in batch.rows.items():
        expected = np.concatenate([one[:first] for one, first in zip(values[:2], firsts, strict=True)])
        rows = [found[name][start : start + first] for start, first in zip(starts, firsts, strict=True)]
        found[name] = np.concatenate(rows)
        if name == "depth":
            off = np.abs(found[name].astype(float) - expected)
            assert np.median(off) <= 1.0 and np.mean(off > 20.0) < 0.01, "equal but at edges"
        elif name == "situations":
            assert np.mean(found[name] != expected) < 0.02
        else:
            np.testing.assert_allclose(found[name], expected, atol=2e-2, err_msg=name)
    drawn = jax.random.fold_in(random_streams.key("record", learning_data.SEED), recorder.number)
    own = jax.jit(reset)(scenario, drawn)
    state, see = recorder.begin(), jax.jit(lambda state: sensors.depth(scenario, state, recorder.camera))
    np.testing.assert_allclose(state.robot.position, own.robot.position, atol=1e-5)
    image = 1000.0 * np.asarray(see(state))
    recorder.step((0.1, 0.2))
    recorder.step(None)
    recorder.commit()
    last = recorder.data.read(recorder.data.episodes[-1:])
    np.testing.assert_allclose(last["depth"][0], image, atol=1.0)
    np.testing.assert_allclose(last["command"], [[0.1, 0.2]], atol=1e-6)
    with pytest.raises(InputError, match="nothing to commit"):
        recorder.commit()
    data = record(Recorder(tmp_path / "two", scenario, width=16, height=12), [(0.3, 0.0)] * 12, 5)
    assert [episode.length for episode in data.episodes] == [2], "what was driven until the commands ended"
    with pytest.raises(InputError, match="rate: 3 rows per second do not divide its 10 steps"):
        Recorder(tmp_path / "three", scenario, width=16, height=12, rate=3)
    data = record(Recorder(tmp_path / "three", scenario, width=16, height=12, rate=5), [(0.3, 0.0)] * 12, 5)
    assert [episode.length for episode in data.episodes] == [6] and data.rate == 5
    with pytest.raises(InputError, match="another scenario, driver, seed or rate"):
        Recorder(tmp_path / "three", scenario, width=16, height=12)
    with pytest.raises(InputError, match="another scenario, driver, seed or rate"):
        Recorder(tmp_path / "two", scenario, seed=1, width=16, height=12)


def test_an_episode_ends_when_it_is_over_and_zeros_follow(batch):
    assert batch.lengths.max() <= learning_data.SECONDS and batch.lengths.min() >= 1
    for values in batch.rows.values():
        for one, length in zip(values, batch.lengths, strict=True):
            assert not one[length:].any()
    unfinished = ~batch.completed
    assert (batch.lengths[unfinished] == learning_data.SECONDS).all()


@pytest.mark.night
def test_rows_at_a_higher_rate_hold_those_of_each_second(batch):
    """Of the same episodes: every tenth row is one of those, the robot drives from row to row, and zeros come after."""
    parts, camera = learning_data.setting()
    scenarios = list(parts.values())
    recorded = row_record(scenarios[0], camera, rate=10)
    running = episode_runner.Runner(scenarios, learning_data.DRIVE, learning_data.EPISODES // 2, "collect", recorded)
    fine = simulate_shard(running, learning_data.SEED, 0, 0)
    assert fine.rows["pose"].shape[1] == 10 * learning_data.SECONDS
    np.testing.assert_array_equal(np.ceil(fine.lengths / 10), batch.lengths)
    for one, seconds, length in zip(fine.rows["pose"], batch.rows["pose"], fine.lengths, strict=True):
        np.testing.assert_allclose(one[:length:10], seconds[: -(-length // 10)], atol=2e-2)
        gone = np.linalg.norm(np.diff(one[:length, :2], axis=0), axis=1)
        fast = gone > 0.1 * float(scenarios[0].robot.max_speed) * 1.05  # in a few rows a person's body pushes the robot
        assert fast.mean() <= 0.05 and not one[length:].any()
    off = np.abs(fine.rows["depth"][:, ::10].astype(float) - batch.rows["depth"])
    assert np.median(off) <= 1.0 and np.mean(off > 20.0) < 0.01, "equal but at edges"


@pytest.mark.parametrize("rate", [1, 3])
def test_examples_equal_a_loop_in_numpy(batch, rate):
    """Histories stop at the first row of the episode, futures at its last, and all places are in the robot's frame.

    With three rows a second, the same rows are those of shorter episodes.
    """
    lengths = batch.lengths
    ends = np.cumsum(lengths)
    flat = {name: np.concatenate([v[i, :n] for i, n in enumerate(lengths)]) for name, v in batch.rows.items()}
    rows = examples.DemonstrationRow(**flat)
    recording = examples.Recording(
        rows, np.repeat(ends - lengths, lengths).astype(np.int32), np.repeat(ends, lengths).astype(np.int32), rate
    )
    index = np.arange(int(ends[-1]), dtype=np.int32)
    onto = jax.tree.map(jax.numpy.asarray, recording)
    made = jax.jit(jax.vmap(examples.example, (None, 0)))(onto, index)
    again = examples.example(recording, index, np)
    trees.assert_close(made, again, atol=1e-5)
    for row in (*range(0, 7), int(ends[0]) - 3, int(ends[0]) - 1, int(ends[0]), int(ends[1]) + 2):
        episode = int(np.searchsorted(ends, row, side="right"))
        first, end = int(ends[episode] - lengths[episode]), int(ends[episode])
        x, y, c, s = flat["pose"][row].astype(np.float64)
        inverse = np.linalg.inv(np.array([[c, -s, x], [s, c, y], [0, 0, 1]]))
        for age in range(5):
            np.testing.assert_array_equal(made.images[row, 4 - age], flat["depth"][max(row - rate * age, first)])
            past = np.array([*flat["pose"][max(row - rate * (1 + age), first), :2], 1.0])
            np.testing.assert_allclose(made.past[row, 4 - age], (inverse @ past)[:2], atol=1e-4)
            ahead = row + rate * (1 + age)
            assert bool(made.future_valid[row, age]) == (ahead < end)
            future = np.array([*flat["pose"][min(ahead, end - 1), :2], 1.0])
            np.testing.assert_allclose(made.future[row, age], (inverse @ future)[:2], atol=1e-4)


def test_streams_get_equal_time_in_any_order_of_asking():
    """A longer collection begins like a shorter one, so it can go on from there."""
    random = np.random.default_rng(0)
    took = random.integers(5, 60, 300).tolist()

    def order(wanted):
        seconds, chosen = [0, 0, 0], []
        for spent in took:
            stream = next_stream(seconds, wanted)
            if stream is None:
                return chosen, seconds
            seconds[stream] += spent
            chosen.append(stream)
        raise AssertionError("never enough")

    (short, some), (long, many) = order(400), order(1000)
    assert long[: len(short)] == short
    assert min(some) >= 400 and min(many) >= 1000 and max(many) < 1060
    assert dataset.stream_seconds(1.0, 5) == 720, "12 minutes of each of five"


def test_the_papers_protocol():
    parts = streams(CollectConfig(environment="lab", behavior="handcrafted", dynamics="twin"))
    assert set(parts) == {"cross_path", "down_path", "join_group", "leave_group", "empty"}
    assert len({part.task for part in parts.values()}) == 1
    first = parts["cross_path"]
    for name, part in parts.items():
        sets = part.behavior.data
        drawn = {of for of, odds in zip(sets.situations, np.asarray(sets.odds), strict=True) if odds.any()}
        assert drawn == {name}
        assert jax.tree.structure(part) == jax.tree.structure(first), "one program serves all"
    chosen = [[task.kind for task in CollectConfig(behavior=behavior).tasks] for behavior in ("graph", "random")]
    assert chosen == [["join_group", "leave_group"], ["random_ab_nav"]]


def test_people_of_demonstrations_are_those_asked_for():
    """Walking groups, and choices on the graph, as `sean run` has them; and the command says so."""
    given = GraphBehavior(walking_groups=(0.5, 0.0), routing="edge", congestion_cost=10.0)
    asked = CollectConfig(environment="lab", dynamics="twin", people=4, behavior=given)
    behavior = streams(asked)["join_group"].behavior
    assert (np.asarray(behavior.companions) >= 0).sum() == 2 and float(behavior.data.congestion_cost) == 10.0
    usual = asked.replace(behavior=given.replace(routing="trips"))
    assert behavior.direct is not streams(usual)["join_group"].behavior.direct
    words = flags.command("collect", asked)
    assert "--walking-groups 0.5 0 " in words and "--routing edge" in words and "--congestion-cost 10" in words
    fields = {"environment": "lab", "behavior": "handcrafted", "walking_groups": (0.5, 0.0)}
    with pytest.raises(InputError, match="walking_groups"):
        gather(CollectConfig, fields)


def test_wrong_names_are_answered_in_a_sentence():
    with pytest.raises(InputError, match="policy: 'go_to_gaol' is not one of .*; did you mean 'go_to_goal'"):
        check_collection(CollectConfig(policy="go_to_gaol"))
    with pytest.raises(InputError, match="'join_grup' is not one of"):
        streams(CollectConfig(environment="lab", task="join_grup"))
    with pytest.raises(InputError, match="hours: 0.0 must be from 1e-06 to 1e\\+06 h"):
        validate(CollectConfig, {"hours": 0.0})


def test_a_nan_is_refused_with_the_episodes_number(batch):
    """In a row, in whatever a policy or a sensor gave; the runner itself looks at people and robots."""
    rows = examples.DemonstrationRow(**{name: np.swapaxes(values, 0, 1).copy() for name, values in batch.rows.items()})
    rows.pose[0, 1, 2] = np.nan
    states = SimpleNamespace(completed=batch.completed)
    ended = episode_runner.Batch(cast(Any, states), batch.lengths, (), [(rows, np.ones(rows.pose.shape[:2], bool))])
    scenarios = list(learning_data.setting()[0].values())
    record = row_record(scenarios[0], learning_data.setting()[1])
    running: Any = SimpleNamespace(size=8, scenarios=scenarios, record=record, run=lambda *_, **__: ended)
    with pytest.raises(FloatingPointError, match="1 of 8 episodes hold numbers that are not finite: 9"):
        simulate_shard(running, 3, 1, 1)

"""Networks side by side: each learns as by itself, none disturbs another, and folders are those of ``sean train``."""

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax import learning
from sean_jax.config import ImitationConfig
from sean_jax.core.errors import InputError
from sean_jax.learning import imitation
from sean_jax.learning.trainer import METRICS, read_metrics
from support import learning_data


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return learning_data.write(tmp_path_factory.mktemp("data") / "made")


def options(data, out, **others) -> ImitationConfig:
    small = {"width": 8, "batch": 32, "validation": 0.2, "epochs": 6, "patience": 3}
    return ImitationConfig(method="imitation", dataset=data.folder, out=out, **{**small, **others})


@pytest.fixture(scope="module")
def three(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("three")
    asked = [options(data, folder / str(seed), seed=seed) for seed in range(3)]
    return imitation.train_ensemble(asked), asked


@pytest.mark.parametrize("time", ["-1", "NaN", "Infinity", '"x"', "1e999"])
def test_a_log_ends_before_a_line_without_a_time(tmp_path, time):
    """A line has its epoch as an integer and its time as a number, however the file writes them."""
    (tmp_path / METRICS).write_text(f'{{"epoch": 1.0, "time": "2.5"}}\n{{"epoch": 2, "time": {time}}}\n')
    assert read_metrics(tmp_path) == [{"epoch": 1, "time": 2.5}] and type(read_metrics(tmp_path)[0]["epoch"]) is int


@pytest.mark.night
def test_each_learns_and_has_the_folder_of_a_training(three, data):
    states, asked = three
    for state, own in zip(states, asked, strict=True):
        lines = read_metrics(own.folder)
        assert [line["epoch"] for line in lines] == list(range(1, int(state.update) + 1))
        assert lines[-1]["train"]["loss"] < lines[0]["train"]["loss"]
        best = min(lines, key=lambda line: line["validation"]["loss"])
        assert best["epoch"] == int(state.best.update)
        assert best["validation"]["loss"] == pytest.approx(-float(state.best.value))
        assert len(lines) == 6 or len(lines) - best["epoch"] == 3
        scenario = sean_jax.make("lab", people=2, dynamics="twin")
        assert learning.load(own.folder, scenario).name == own.folder.name
    alike = jax.tree.map(lambda one, other: np.array_equal(one, other), states[0].agent, states[1].agent)
    assert not all(jax.tree.leaves(alike))


@pytest.mark.slow
def test_none_learns_anything_of_another(three, data, tmp_path):
    """The second of three is what it is by itself."""
    states, _ = three
    (alone,) = imitation.train_ensemble([options(data, tmp_path / "alone", seed=1)])
    assert int(alone.update) == int(states[1].update)
    itself, same, another = (
        np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(state.agent)])
        for state in (alone, states[1], states[0])
    )
    rounding, apart = (np.sqrt(np.mean((itself - other) ** 2)) for other in (same, another))
    assert rounding < 1e-3 * apart


@pytest.mark.night
def test_it_learns_as_a_training_by_itself_does(three, data, tmp_path):
    """From the same weights, in another order of the same batches."""
    states, _ = three
    state = imitation.train(options(data, tmp_path / "one", seed=0, epochs=int(states[0].update), patience=1000))
    lines = [read_metrics(folder) for folder in (tmp_path / "one", three[1][0].folder)]
    first, last = ([each[k]["validation"]["loss"] for each in lines] for k in (0, -1))
    assert first[0] == pytest.approx(first[1], rel=0.1) and last[0] == pytest.approx(last[1], rel=0.15)
    np.testing.assert_allclose(state.agent.command_scale, states[0].agent.command_scale)


def test_what_cannot_stand_beside_one_another_is_refused(data, tmp_path):
    pair = [options(data, tmp_path / "a"), options(data, tmp_path / "b", width=16)]
    with pytest.raises(InputError, match="width: 16 and 8; networks in parallel have the same"):
        imitation.train_ensemble(pair)
    with pytest.raises(InputError, match="pretrained: networks trained in parallel have none"):
        imitation.train_ensemble([options(data, tmp_path / "a", pretrained=tmp_path)])
    assert not (tmp_path / "a").exists()


@pytest.mark.slow
def test_parts_of_a_dataset_share_its_episodes_evenly(data, tmp_path):
    """Each episode is in one part, and each part has as much of every task; networks of other parts are others."""
    whole = {episode.number for episode in data.episodes}
    for parts in (1, 2, 3, 5):
        opened = [learning.open_dataset(data.folder, (which, parts)) for which in range(1, parts + 1)]
        numbers = [[episode.number for episode in each.episodes] for each in opened]
        assert sorted(sum(numbers, [])) == sorted(whole)
        assert sum(each.example_count for each in opened) == data.example_count
        assert len({each.fingerprint() for each in opened}) == parts
        for stream in {episode.stream for episode in data.episodes}:
            counts = [sum(episode.stream == stream for episode in each.episodes) for each in opened]
            assert max(counts) - min(counts) <= 1
    states = imitation.train_ensemble([options(data, tmp_path / str(k), part=(k, 2), epochs=2) for k in (1, 2)])
    alike = jax.tree.map(lambda one, other: np.array_equal(one, other), states[0].agent, states[1].agent)
    assert not all(jax.tree.leaves(alike))
    with pytest.raises(InputError, match="episodes in part 1 of 16, too few"):
        imitation.train(options(data, tmp_path / "few", part=(1, 16)))
    with pytest.raises(ValueError, match="part: 3 2, but there are only 2 parts; give a smaller first number"):
        options(data, tmp_path / "none", part=(3, 2))

"""``sean train dagger`` and ``collect --labels``: the driver's states, the labeller's commands, several datasets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import learning
from sean_jax.cli import command_line
from sean_jax.config import DaggerConfig
from sean_jax.core.errors import InputError
from sean_jax.learning import dagger, dataset
from sean_jax.learning.dataset import open_dataset, split
from sean_jax.learning.policy import NOISE_TIME, label, labelled
from sean_jax.simulation import episodes
from support import learning_data

SMALL = "--environment lab --behavior random --people 2 --dynamics twin --time-limit 3 --width 8 --height 8 --quiet"


def spin(scenario, state, key):
    """Turns on the spot."""
    return jnp.array([0.1, 0.5])


@pytest.mark.night
def test_the_driver_drives_and_the_other_labels():
    scenario = sean_jax.make("lab", behavior="random", people=3, dynamics="twin")
    helper = sean_jax.POLICIES["go_to_goal"]
    both = labelled(spin, helper)

    @jax.jit
    def begin(key):
        return episodes.init_policy(scenario, both, sean_jax.reset(scenario, key))

    @jax.jit
    def step(state):
        alone = sean_jax.step(scenario, state, jnp.array([0.1, 0.5]))
        return episodes.policy_step(scenario, both, state)[0], alone, helper(scenario, state, jax.random.key(0))

    state = begin(jax.random.key(0))
    for _ in range(5):
        after, alone, wanted = step(state)
        np.testing.assert_allclose(after.robot.position, alone.robot.position, atol=1e-6)
        np.testing.assert_allclose(label(after), wanted, atol=1e-6)
        state = after


@pytest.mark.night
def test_a_disturbed_driver_is_led_astray_and_its_own_command_is_the_label():
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin", sensors=())
    helper = sean_jax.POLICIES["go_to_goal"]
    noisy = labelled(helper, deviation=0.2)

    @jax.jit
    def commands(key):
        state = episodes.init_policy(scenario, noisy, sean_jax.reset(scenario, key))

        def one(state, _):
            after, action = episodes.policy_step(scenario, noisy, state)
            return after, (action, label(after), helper(scenario, state, jax.random.key(0)))

        return jax.lax.scan(one, state, length=40)[1]

    given, labels, wanted = jax.vmap(commands)(jax.random.split(jax.random.key(1), 64))
    np.testing.assert_allclose(labels, wanted, atol=1e-5)
    noise = np.asarray(given - labels)[:, 20:] / np.array([scenario.robot.max_speed, scenario.robot.max_turn_rate])
    np.testing.assert_allclose(noise.std((0, 1)), 0.2, rtol=0.15)
    alike = (noise[:, 1:] * noise[:, :-1]).mean((0, 1)) / noise.var((0, 1))
    np.testing.assert_allclose(alike, np.exp(-0.1 / NOISE_TIME), atol=0.06)
    both = labelled(helper, spin, 0.2)
    state = jax.jit(lambda key: episodes.init_policy(scenario, both, sean_jax.reset(scenario, key)))(jax.random.key(2))
    after = jax.jit(lambda state: episodes.policy_step(scenario, both, state)[0])(state)
    np.testing.assert_allclose(label(after), [0.1, 0.5])


def test_several_datasets_are_read_as_one(tmp_path):
    parts = [learning_data.write(tmp_path / name) for name in ("one", "two")]
    both = dataset.open_datasets([part.folder for part in parts])
    training, validation = dataset.split_each(both, 0.3, 5)
    found = both.recording([*training, *validation])
    assert both.example_count == sum(part.example_count for part in parts) == len(found.first)
    chosen = [split(part, 0.3, 5) for part in parts]
    wanted = [part.read(pair[0])["command"] for part, pair in zip(parts, chosen, strict=True)]
    wanted += [part.read(pair[1])["command"] for part, pair in zip(parts, chosen, strict=True)]
    np.testing.assert_array_equal(found.rows.command, np.concatenate(wanted))
    lengths = found.end - found.first
    assert (np.arange(len(found.first)) >= found.first).all() and (np.arange(len(found.first)) < found.end).all()
    assert set(lengths) == {episode.length for part in parts for episode in part.episodes}
    assert both.fingerprint() != parts[0].fingerprint() == dataset.ConcatDataset(parts[:1]).fingerprint()


def test_other_images_are_refused(tmp_path):
    one = learning_data.write(tmp_path / "one")
    two = learning_data.write(tmp_path / "two")
    two.save({**two.manifest, "situations": ["other"]})
    with pytest.raises(InputError, match="situations"):
        dataset.open_datasets([one.folder, two.folder])


@pytest.mark.night
def test_dagger_learns_in_rounds_and_goes_on(tmp_path, monkeypatch):
    """From the command line; stopped after the first round, it goes on to what an undisturbed one has."""
    monkeypatch.chdir(tmp_path)
    collect = ["collect", *SMALL.split(), "--hours", "0.01", "--batch", "4", "--policy", "go_to_goal", "--out", "data"]
    assert command_line.main(collect) == 0
    words = ["train", "dagger", "data", "--expert", "go_to_goal", "--rounds", "2", "--hours", "0.005", "--epochs", "3"]
    words += ["--batch", "8", "--validation", "0.3", "--width", "4", "--quiet"]
    assert command_line.main([*words, "--out", "whole"]) == 0
    names = {"config.json", "round-0", "round-1", "round-2", "data-1", "data-2"}
    assert {path.name for path in (tmp_path / "whole").iterdir()} == names
    real, calls = dagger.collection.collect, []

    def stop(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(dagger.collection, "collect", stop)
    assert command_line.main([*words, "--out", "stopped"]) == 130
    monkeypatch.setattr(dagger.collection, "collect", real)
    assert command_line.main([*words, "--out", "stopped"]) == 0
    for part in ("data-1", "data-2"):
        found = [open_dataset(tmp_path / run / part) for run in ("whole", "stopped")]
        assert found[0].fingerprint() != open_dataset("data").fingerprint() and found[0].example_count == 18
        one, other = (data.read(data.episodes) for data in found)
        assert all(np.array_equal(one[name], other[name]) for name in one)
    scenario = sean_jax.make("lab", behavior="random", people=2, dynamics="twin")
    one, other, first = (learning.load(tmp_path / run, scenario) for run in ("whole", "stopped", "whole/round-0"))
    weights = [jax.tree.leaves(policy.params.agent) for policy in (one, other, first)]
    assert all(np.array_equal(a, b) for a, b in zip(*weights[:2], strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(weights[0], weights[2], strict=True))
    assert one.name == "whole"
    options = DaggerConfig(method="dagger", dataset=tmp_path / "data", rounds=3, out=tmp_path / "whole", width=4)
    with pytest.raises(InputError, match="batch 8|rounds 2|hours"):
        dagger.train(options)

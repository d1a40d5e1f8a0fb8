"""The network and its imitation (section V-C): it learns, resumes to the bit, drives, and fails in sentences."""

import functools
import json
import logging
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.cli import command_line
from sean_jax.config import ImitationConfig, PPOConfig
from sean_jax.core import devices, random_streams
from sean_jax.core.errors import IncompleteError, InputError
from sean_jax.io import writing
from sean_jax.learning import imitation, reinforcement, trainer
from sean_jax.learning.checkpoints import Checkpoints
from sean_jax.learning.collection import row_record, simulate_shard
from sean_jax.learning.dataset import on_device, split
from sean_jax.learning.examples import example
from sean_jax.learning.networks import Network
from sean_jax.learning.policy import load_imitation
from sean_jax.learning.trainer import Log
from sean_jax.simulation import episodes
from sean_jax.simulation.episode_runner import Runner
from support import learning_data, trees


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return learning_data.write(tmp_path_factory.mktemp("data") / "made")


def options(data, out, **others) -> ImitationConfig:
    small = {"width": 16, "batch": 32, "validation": 0.2, "epochs": 12}
    return ImitationConfig(method="imitation", dataset=data.folder, out=out, **{**small, **others})


def unread(**others) -> ImitationConfig:
    """Options of a training whose dataset nobody opens."""
    return ImitationConfig(method="imitation", dataset=Path("none"), **others)


@pytest.fixture(scope="module")
def recording(data):
    return on_device(data.recording(data.episodes))


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    """A training of 12 epochs and its folder."""
    folder = tmp_path_factory.mktemp("run") / "whole"
    return imitation.train(options(data, folder)), folder


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def begin(network, situations, chosen, commands):
    """The state before the first epoch."""
    scale = imitation.command_scale(commands)
    return imitation.init_state(network, situations, chosen, chosen.seed, scale)


@functools.partial(jax.jit, static_argnums=0)
def answers(network, weights, examples):
    """What a network says to a batch of examples."""
    say = functools.partial(network.apply, weights.parameters)
    return jax.vmap(lambda one: say(one.images, one.plan, one.situations))(examples)


def test_documented_sizes():
    from sean_jax.learning import networks
    from sean_jax.learning.networks import Network

    for flags, shares in ((False, (2, 3)), (True, (3, 4))):
        weights = jax.eval_shape(lambda flags=flags: networks.init_weights(Network(flags=flags), 5, jax.random.key(0)))
        count = sum(leaf.size for leaf in jax.tree.leaves(weights.parameters))
        assert f"{count:,} parameters" in networks.__doc__.replace("\n", " ") or f"{count:,} with" in networks.__doc__
        one = Network(flags=flags)
        assert (len(one.planner_sources), len(one.controller_sources)) == shares


@pytest.mark.slow
def test_it_learns_two_hundred_examples_by_heart(recording):
    chosen = unread(width=32, batch=64, learning_rate=3e-3, weight_decay=0.0)
    network = Network(32, True, (12, 16))
    state = begin(network, 5, chosen, recording.rows.command)
    programs = imitation.programs(network, chosen, devices.mesh())
    rows = jnp.arange(len(recording.first), dtype=jnp.int32)
    losses = []
    for _ in range(80):
        state, train, _ = programs.epoch(state, recording, rows, rows[:32])
        losses.append(float(train.loss))
    assert losses[-1] < losses[0] / 10
    decision = answers(network, state.weights, jax.jit(jax.vmap(example, (None, 0)))(recording, rows))
    for shares in (decision.planner_attention, decision.controller_attention):
        np.testing.assert_allclose(shares.sum(-1), 1.0, atol=1e-5)
        assert (np.asarray(shares) >= 0).all() and np.asarray(shares).std(0).max() > 0.01, "it depends on what is there"


def test_losses_equal_a_loop_in_numpy(recording, data):
    """Equal weights; only what is known of the future counts; the filling of the last batch does not."""
    network, chosen = Network(16, False, (12, 16)), unread(width=16, batch=32)
    state = begin(network, 5, chosen, recording.rows.command)
    np.testing.assert_allclose(state.weights.scale, np.std(recording.rows.command, 0), rtol=1e-5)
    programs = imitation.programs(network, chosen, devices.mesh())
    rows = np.arange(3, 50, dtype=np.int32)
    examples = jax.jit(jax.vmap(example, (None, 0)))(recording, jnp.asarray(rows))
    answer = answers(network, state.weights, examples)
    far, known, off = 0.0, 0, 0.0
    for k in range(len(rows)):
        for second in range(5):
            if examples.future_valid[k, second]:
                known += 1
                far += float(np.sum((np.asarray(answer.local_plan[k, second]) - examples.future[k, second]) ** 2))
        command = np.asarray(examples.command[k]) / np.asarray(state.weights.scale)
        off += float(np.sum((np.asarray(answer.command[k]) - command) ** 2))
    _, _, found = programs.epoch(
        jax.tree.map(jnp.copy, state),
        recording,
        jnp.asarray(rows[:0]),
        jnp.asarray(rows),
    )
    assert known < 5 * len(rows)
    np.testing.assert_allclose(found.local_plan, far / known, rtol=1e-4)
    np.testing.assert_allclose(found.command, off / len(rows), rtol=1e-4)
    np.testing.assert_allclose(found.loss, found.local_plan + found.command, rtol=1e-6)


def test_an_interrupted_training_comes_to_the_same_bits(data, trained, tmp_path, monkeypatch):
    whole, folder = trained
    saves = []
    save = Checkpoints.save

    def stopping(self, state, epoch, loss):
        save(self, state, epoch, loss)
        saves.append(int(state.epoch))
        if len(saves) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(Checkpoints, "save", stopping)
    with pytest.raises(KeyboardInterrupt):
        imitation.train(options(data, tmp_path / "run"))
    with (tmp_path / "run" / "metrics.jsonl").open("a") as stream:  # as a kill leaves it: beyond the checkpoint, cut
        stream.write('{"epoch": 99, "time": 0.0}\n{"epo')
    again = imitation.train(options(data, tmp_path / "run"))
    trees.assert_equal(whole, again)
    logs = [
        [{name: line[name] for name in ("epoch", "train", "validation")} for line in lines(place)]
        for place in (folder, tmp_path / "run")
    ]
    assert logs[0] == logs[1] and [line["epoch"] for line in logs[0]] == list(range(1, 13))


def lines(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_the_latest_and_the_best_checkpoint_are_kept(trained):
    state, folder = trained
    losses = {line["epoch"]: line["validation"]["loss"] for line in lines(folder)}
    best = min(losses, key=losses.get)
    steps = sorted(int(path.name) for path in (folder / "checkpoints").iterdir())
    assert steps == sorted({best, 12}) and int(state.best_epoch) == best
    assert float(state.best) == pytest.approx(losses[best])


def test_events_for_tensorboard_need_an_optional_package(tmp_path, monkeypatch):
    """Of a log with scalars in dicts, those after the last checkpoint are purged at a restart."""
    written = []

    class SummaryWriter:
        def __init__(self, folder, purge_step):
            written.append((folder, purge_step))

        def add_scalar(self, *values):
            written.append(values)

        def flush(self):
            pass

    monkeypatch.setitem(sys.modules, "tensorboardX", SimpleNamespace(SummaryWriter=SummaryWriter))
    Log(tmp_path, 3).add({"epoch": 4, "train": {"loss": 0.5}, "seconds": 2.0, "time": 10.0})
    assert written == [(str(tmp_path), 4), ("train/loss", 0.5, 4, 10.0), ("seconds", 2.0, 4, 10.0)]
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    Log(tmp_path, 4).add({"epoch": 5, "time": 11.0})
    assert [line["epoch"] for line in lines(tmp_path)] == [4, 5]


@pytest.mark.night
def test_training_from_disk_learns_as_well(data, tmp_path):
    state = imitation.train(options(data, tmp_path / "disk", device_memory_fraction=0.0, epochs=3))
    losses = [line["train"]["loss"] for line in lines(tmp_path / "disk")]
    assert int(state.epoch) == 3 and losses[-1] < losses[0]
    validation = split(data, 0.2, 0)[1]
    recording = on_device(data.recording(validation))
    network = Network(16, False, (12, 16))
    programs = imitation.programs(network, options(data, None), devices.mesh())
    rows = jnp.arange(len(recording.first), dtype=jnp.int32)
    _, _, found = programs.epoch(jax.tree.map(jnp.copy, state), recording, rows[:0], rows)
    assert float(found.loss) == pytest.approx(lines(tmp_path / "disk")[-1]["validation"]["loss"], rel=1e-4)


@pytest.mark.night
def test_training_stops_when_nothing_gets_better(data, tmp_path):
    state = imitation.train(options(data, tmp_path / "run", learning_rate=0.3, patience=2, epochs=30))
    assert int(state.epoch) == int(state.best_epoch) + 2 < 30


def test_a_loss_that_is_not_finite_ends_it_and_keeps_what_there_was(data, tmp_path, monkeypatch):
    made = imitation.programs

    def poisoned(network, chosen, over):
        programs = made(network, chosen, over)

        def epoch(state, *others):
            state, train, validation = programs.epoch(state, *others)
            bad = train._replace(loss=train.loss / jnp.where(state.epoch == 4, 0.0, 1.0) * 1.0)
            return state, bad, validation

        return programs._replace(epoch=epoch)

    monkeypatch.setattr(imitation, "programs", poisoned)
    with pytest.raises(FloatingPointError, match="the loss is not finite in epoch 4; .* keeps the checkpoints"):
        imitation.train(options(data, tmp_path / "run"))
    assert max(int(path.name) for path in (tmp_path / "run" / "checkpoints").iterdir()) <= 3
    scenario = learning_data.setting()[0]["join_group"]
    assert load_imitation(tmp_path / "run", scenario).name == "run"


def test_checkpoints_of_another_network_are_refused(data, trained, tmp_path, capsys):
    folder = trained[1]
    for others, message in (
        ({"width": 24}, "width 16, not 24"),
        ({"flags": True}, "flags off, not on"),
        ({"seed": 1}, "seed 0, not 1"),
    ):
        with pytest.raises(InputError, match=f"was begun with {message}"):
            imitation.train(options(data, folder, **others))
    command = ["train", "imitation", str(data.folder), "--width", "24", "--out", str(folder)]
    assert command_line.main(command) == 2
    error = capsys.readouterr().err
    assert error.startswith("sean: ") and "was begun with width 16, not 24" in error and len(error.splitlines()) == 1
    with pytest.raises(InputError, match="has no trained network"):
        load_imitation(tmp_path, learning_data.setting()[0]["join_group"])


def test_opening_a_policy_changes_nothing(data, trained, tmp_path):
    """Above all not what a training that goes on has half written; the training itself removes what a kill left."""
    import shutil

    folder = tmp_path / "run"
    shutil.copytree(trained[1], folder)
    half = folder / "checkpoints" / "13.orbax-checkpoint-tmp"
    (half / "state").mkdir(parents=True)
    (half / "state" / "array").write_bytes(b"half of it")

    def everything() -> dict:
        paths = [folder, *folder.rglob("*")]
        return {path: (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else b"") for path in paths}

    before = everything()
    scenario = learning_data.setting()[0]["join_group"]
    weights, expected = (load_imitation(place, scenario).params.weights for place in (folder, trained[1]))
    assert everything() == before
    trees.assert_equal(weights, expected)
    with writing.folder_lock(folder), pytest.raises(writing.WriteError, match="run is being written by process"):
        imitation.train(options(data, folder, epochs=13))
    imitation.train(options(data, folder, epochs=13))
    assert not half.exists() and (folder / "checkpoints" / "13").is_dir()


def test_what_a_kill_left_half_deleted_is_no_checkpoint(data, trained, tmp_path):
    """Readers pass it by, whatever is left of it, and the next start removes it."""
    import random
    import shutil

    folder, chance = tmp_path / "run", random.Random(5)
    shutil.copytree(trained[1], folder)
    checkpoints, best = folder / "checkpoints", int(trained[0].best_epoch)
    steps = sorted(path.name for path in checkpoints.iterdir())
    for number in [number for number in range(1, best) if str(number) not in steps][:8]:
        half = checkpoints / str(number)
        shutil.copytree(checkpoints / str(best), half)  # as good as the best, which came after it
        paths = sorted(half.rglob("*"))
        for path in chance.sample(paths, chance.randint(1, len(paths))):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    assert len([*checkpoints.iterdir()]) > len(steps) + 3
    scenario = learning_data.setting()[0]["join_group"]
    weights, expected = (load_imitation(place, scenario).params.weights for place in (folder, trained[1]))
    trees.assert_equal(weights, expected)
    again = imitation.train(options(data, folder))
    trees.assert_equal(trained[0], again)
    assert sorted(path.name for path in checkpoints.iterdir()) == steps


def test_a_policy_is_opened_while_its_training_replaces_the_best(trained, tmp_path, monkeypatch):
    """The best is half deleted between the look at what there is and the reading of it, and a better one is there."""
    import shutil

    folder = tmp_path / "run"
    shutil.copytree(trained[1], folder)
    best, restore = int(trained[0].best_epoch), Checkpoints._restore
    old, new = (folder / "checkpoints" / str(number) for number in (best, 13))

    def replaced(self, *arguments, **options):
        if not new.exists():
            shutil.copytree(old, new)
            shutil.rmtree(old / "state")
        return restore(self, *arguments, **options)

    monkeypatch.setattr(Checkpoints, "_restore", replaced)
    scenario = learning_data.setting()[0]["join_group"]
    weights, expected = (load_imitation(place, scenario).params.weights for place in (folder, trained[1]))
    assert new.exists()
    trees.assert_equal(weights, expected)


def test_a_refused_training_leaves_no_folder(data, tmp_path):
    with pytest.raises(InputError, match="--balance needs the dataset to fit"):
        imitation.train(options(data, tmp_path / "deep" / "run", balance=True, device_memory_fraction=0.0))
    assert not any(tmp_path.iterdir())


def test_a_damaged_checkpoint_is_named(data, trained, tmp_path):
    import shutil

    folder = tmp_path / "run"
    shutil.copytree(trained[1], folder)
    latest = max(int(path.name) for path in (folder / "checkpoints").iterdir())
    for path in (folder / "checkpoints" / str(latest) / "state").rglob("*"):
        if path.is_file():
            path.write_bytes(b"broken")
    with pytest.raises(IncompleteError, match=f"checkpoints/{latest} cannot be read .* remove it to resume"):
        imitation.train(options(data, folder, epochs=14))


def test_a_byte_that_changed_in_a_checkpoint_changes_no_weight(trained, tmp_path):
    """Orbax has no checksum: without the digests, some of these policies would act otherwise."""
    import shutil

    random, refused = np.random.default_rng(0), 0
    scenario = learning_data.setting()[0]["join_group"]
    expected = jax.tree.leaves(load_imitation(trained[1], scenario).params.weights)
    for number in range(24):
        folder = tmp_path / str(number)
        shutil.copytree(trained[1], folder)
        best = folder / "checkpoints" / str(int(trained[0].best_epoch)) / "state"
        files = sorted(path for path in best.rglob("*") if path.is_file() and path.stat().st_size)
        sizes = np.array([path.stat().st_size for path in files])
        file = files[random.choice(len(files), p=sizes / sizes.sum())]
        content = bytearray(file.read_bytes())
        content[random.integers(len(content))] ^= 1 << random.integers(8)
        file.write_bytes(content)
        try:
            found = jax.tree.leaves(load_imitation(folder, scenario).params.weights)
        except (InputError, IncompleteError) as error:
            refused += "cannot be read" in str(error)
            continue
        assert all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))
    assert refused >= 3


def test_checkpoints_leave_loggers_and_hooks_alone_and_warn_of_nothing(tmp_path, caplog):
    """Of the program that trains or loads; the command line alone mutes orbax, in its own process."""

    def process():
        absl, tasks = logging.getLogger("absl"), logging.getLogger("asyncio")
        return absl.level, absl.disabled, absl.filters[:], tasks.filters[:], sys.unraisablehook

    before = process()
    writer = Checkpoints(tmp_path, writes=True)
    writer.save({"weights": np.ones(3, np.float32)}, 1, 0.5)
    writer.wait()
    np.testing.assert_array_equal(Checkpoints(tmp_path).best("weights", np.zeros(3, np.float32)), 1.0)
    assert process() == before and "read" not in caplog.text


def test_a_full_disk_keeps_the_checkpoints(data, trained, tmp_path, monkeypatch):
    import shutil

    folder = tmp_path / "run"
    shutil.copytree(trained[1], folder)
    before = sorted(path.name for path in (folder / "checkpoints").iterdir())
    usage = shutil.disk_usage(folder)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    with pytest.raises(IncompleteError, match="the disk is full; earlier checkpoints are as they were"):
        imitation.train(options(data, folder, epochs=14))
    assert sorted(path.name for path in (folder / "checkpoints").iterdir()) == before


def test_a_log_goes_on_where_the_training_does(tmp_path):
    for begin in (0, 2):
        log = Log(tmp_path, begin)
        for epoch in range(begin, begin + 4):
            log.add({"epoch": epoch + 1, "train": {"loss": float(begin)}, "time": 1.0})
    assert [(line["epoch"], line["train"]["loss"]) for line in lines(tmp_path)] == [
        (1, 0.0), (2, 0.0), (3, 2.0), (4, 2.0), (5, 2.0), (6, 2.0),
    ]  # fmt: skip


@pytest.mark.slow
def test_the_driver_sees_and_answers_what_the_examples_say(data, trained):
    """Driven step by step, in a batch, its decisions each second are those for the examples of the recording."""
    parts, camera = learning_data.setting()
    scenario = parts["join_group"]
    policy = load_imitation(trained[1], scenario)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(random_streams.key("collect", learning_data.SEED), jnp.arange(3))

    def follow(before, after, action):
        return after.policy_state.decision, action

    drive = jax.vmap(lambda policy, key: episodes.rollout(scenario, policy, key, 61, follow), (None, 0))
    _, (decisions, actions) = jax.jit(drive)(policy, keys)
    running = Runner(scenario, policy, 3, "collect", row_record(scenario, camera))
    batch = simulate_shard(running, learning_data.SEED, 0, 0)
    np.testing.assert_allclose(batch.rows["command"][:, :7], actions[:, ::10], atol=1e-3)
    lengths = np.minimum(batch.lengths, 7)
    assert (lengths == 7).all()
    rows = {name: values[:, :7].reshape(21, *values.shape[2:]) for name, values in batch.rows.items()}
    first = np.repeat(np.arange(3, dtype=np.int32) * 7, 7)
    from sean_jax.learning.examples import Recording, Row

    recording = on_device(Recording(Row(**rows), first, first + 7))
    params = policy.params
    rows = jnp.arange(21, dtype=jnp.int32)
    answer = answers(params.network, params.weights, jax.jit(jax.vmap(example, (None, 0)))(recording, rows))
    for name in ("local_plan", "planner_attention", "controller_attention"):
        expected = getattr(answer, name).reshape(3, 7, *getattr(answer, name).shape[1:])
        np.testing.assert_allclose(getattr(decisions, name)[:, ::10], expected, atol=2e-3)
    scale = np.asarray(params.weights.scale)
    np.testing.assert_allclose(actions[:, ::10].reshape(21, 2), np.asarray(answer.command) * scale, atol=2e-3)


def test_another_number_of_devices_is_refused_before_anything_is_drawn(tmp_path, monkeypatch):
    options = PPOConfig(environment="lab", people=2, dynamics="twin", out=tmp_path / "made")
    (tmp_path / "made").mkdir()
    config = json.loads(json.dumps(trainer.method_config(options, devices=3)))
    trainer.write_config(tmp_path / "made", config)
    monkeypatch.setattr(reinforcement, "build", lambda options: pytest.fail("it is built"))
    with pytest.raises(InputError, match=r"made was begun with devices 3, not \d+; ask for the same or choose another"):
        reinforcement.train(options)

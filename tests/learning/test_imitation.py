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

from sean_jax import mdp
from sean_jax.cli import command_line
from sean_jax.config import ImitationConfig, PPOConfig
from sean_jax.core import devices, random_streams
from sean_jax.core.errors import IncompleteError, InputError
from sean_jax.io import writing
from sean_jax.learning import bc, examples, imitation, networks, reinforcement, trainer
from sean_jax.learning.checkpoints import Checkpoints
from sean_jax.learning.collection import row_record, simulate_shard
from sean_jax.learning.dataset import on_device, split
from sean_jax.learning.examples import example
from sean_jax.learning.networks import NetworkConfig, NetworkOutput
from sean_jax.learning.policy import load, pack
from sean_jax.learning.trainer import MetricsLog
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


def described(width: int = 64, flags: bool = False, image: tuple[int, int] = (12, 16)):
    """The description of an agent that imitates."""
    config = NetworkConfig(width=width, flags=flags, image=image, situations=list("abcde"))
    return networks.describe_imitation(config, time_step=1.0)


def begin(description, chosen, commands):
    """The student and the state before the first epoch."""
    student = bc.make_student(description, chosen.learning_rate, chosen.weight_decay)
    init = jax.jit(functools.partial(imitation.init_state, description, student))
    return student, init(chosen.seed, imitation.command_scale(commands))


def answers(description, agent, batch) -> NetworkOutput:
    """The output of a network for a batch of examples."""
    network, terms = description.network, description.terms

    @jax.jit
    def answer(agent, batch):
        observation = examples.observation(terms, batch)
        vector = jax.vmap(lambda one: mdp.flatten(terms, one))(observation)
        images = {name: observation[name] for name in network.images}
        count = len(vector)
        return networks.apply(network, agent, vector, images, jnp.zeros((count, 0)), jnp.ones(count, bool))

    return answer(agent, batch)


def test_documented_sizes():
    for flags, shares in ((False, (2, 3)), (True, (3, 4))):
        agent = jax.eval_shape(described(64, flags, (48, 64)).init, jax.random.key(0))
        count = sum(leaf.size for leaf in jax.tree.leaves(agent.parameters))
        assert f"{count:,} parameters" in networks.__doc__.replace("\n", " ") or f"{count:,} with" in networks.__doc__
        sources = networks.attention_sources(flags)
        assert (len(sources["planner"]), len(sources["controller"])) == shares


@pytest.mark.slow
def test_it_learns_two_hundred_examples_by_heart(recording):
    chosen = unread(width=32, batch=64, learning_rate=3e-3, weight_decay=0.0)
    description = described(32, True)
    student, state = begin(description, chosen, recording.rows.command)
    programs = bc.programs(student, chosen.batch, devices.mesh())
    rows = jnp.arange(len(recording.first), dtype=jnp.int32)
    losses = []
    for _ in range(80):
        state, sums = programs.learn(state, recording, rows)
        losses.append(float(bc.losses(sums).loss))
    assert losses[-1] < losses[0] / 10
    output = answers(description, state.agent, jax.jit(jax.vmap(example, (None, 0)))(recording, rows))
    for shares in (output.auxiliary["planner_attention"], output.auxiliary["controller_attention"]):
        np.testing.assert_allclose(shares.sum(-1), 1.0, atol=1e-5)
        assert (np.asarray(shares) >= 0).all() and np.asarray(shares).std(0).max() > 0.01, "it depends on what is there"


@pytest.mark.slow
def test_losses_equal_a_loop_in_numpy(recording, data):
    """Equal weights; only what is known of the future counts; the filling of the last batch does not."""
    description, chosen = described(16), unread(width=16, batch=32)
    student, state = begin(description, chosen, recording.rows.command)
    np.testing.assert_allclose(state.agent.command_scale, np.std(recording.rows.command, 0), rtol=1e-5)
    programs = bc.programs(student, chosen.batch, devices.mesh())
    rows = np.arange(3, 50, dtype=np.int32)
    batch = jax.jit(jax.vmap(example, (None, 0)))(recording, jnp.asarray(rows))
    answer = answers(description, state.agent, batch)
    far, known, off = 0.0, 0, 0.0
    for k in range(len(rows)):
        for second in range(5):
            if batch.future_valid[k, second]:
                known += 1
                place = np.asarray(answer.auxiliary["local_plan"][k, second])
                far += float(np.sum((place - batch.future[k, second]) ** 2))
        command = np.asarray(batch.command[k]) / np.asarray(state.agent.command_scale)
        off += float(np.sum((np.asarray(answer.mean[k]) - command) ** 2))
    found = bc.losses(programs.measure(state, recording, jnp.asarray(rows)))
    assert known < 5 * len(rows)
    np.testing.assert_allclose(found.local_plan, far / known, rtol=1e-4)
    np.testing.assert_allclose(found.command, off / len(rows), rtol=1e-4)
    np.testing.assert_allclose(found.loss, found.local_plan + found.command, rtol=1e-6)


@pytest.mark.night
def test_an_interrupted_training_comes_to_the_same_bits(data, trained, tmp_path, monkeypatch):
    whole, folder = trained
    saves = []
    save = Checkpoints.save

    def stopping(self, state, epoch, loss):
        save(self, state, epoch, loss)
        saves.append(int(state.update[0]))
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
    assert steps == sorted({best, 12}) and int(state.best.update) == best
    assert -float(state.best.value) == pytest.approx(losses[best])


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
    MetricsLog(tmp_path, 3).add({"epoch": 4, "train": {"loss": 0.5}, "seconds": 2.0, "time": 10.0})
    assert written == [(str(tmp_path), 4), ("train/loss", 0.5, 4, 10.0), ("seconds", 2.0, 4, 10.0)]
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    MetricsLog(tmp_path, 4).add({"epoch": 5, "time": 11.0})
    assert [line["epoch"] for line in lines(tmp_path)] == [4, 5]


@pytest.mark.night
def test_training_from_disk_learns_as_well(data, tmp_path):
    state = imitation.train(options(data, tmp_path / "disk", device_memory_fraction=0.0, epochs=3))
    losses = [line["train"]["loss"] for line in lines(tmp_path / "disk")]
    assert int(state.update) == 3 and losses[-1] < losses[0]
    validation = split(data, 0.2, 0)[1]
    recording = on_device(data.recording(validation))
    chosen = options(data, None)
    student = bc.make_student(described(16), chosen.learning_rate, chosen.weight_decay)
    programs = bc.programs(student, chosen.batch, devices.mesh())
    rows = jnp.arange(len(recording.first), dtype=jnp.int32)
    found = bc.losses(programs.measure(state, recording, rows))
    assert float(found.loss) == pytest.approx(lines(tmp_path / "disk")[-1]["validation"]["loss"], rel=1e-4)


@pytest.mark.night
def test_training_stops_when_nothing_gets_better(data, tmp_path):
    state = imitation.train(options(data, tmp_path / "run", learning_rate=0.3, patience=2, epochs=30))
    assert int(state.update) == int(state.best.update) + 2 < 30


def test_a_loss_that_is_not_finite_ends_it_and_keeps_what_there_was(data, tmp_path, monkeypatch):
    made = bc.programs

    def poisoned(student, batch, over):
        programs = made(student, batch, over)

        def finish(state, *sums):
            state, train, validation = programs.finish(state, *sums)
            bad = train._replace(loss=train.loss / jnp.where(state.update == 4, 0.0, 1.0) * 1.0)
            return state, bad, validation

        return programs._replace(finish=finish)

    monkeypatch.setattr(bc, "programs", poisoned)
    with pytest.raises(FloatingPointError, match="the loss is not finite in epoch 4; .* keeps the checkpoints"):
        imitation.train(options(data, tmp_path / "run"))
    assert max(int(path.name) for path in (tmp_path / "run" / "checkpoints").iterdir()) <= 3
    scenario = learning_data.setting()[0]["join_group"]
    assert load(tmp_path / "run", scenario).name == "run"


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
        load(tmp_path, learning_data.setting()[0]["join_group"])


def test_a_packed_network_is_the_network_in_16_bits(trained, tmp_path):
    scenario = learning_data.setting()[0]["join_group"]
    packed = pack(trained[1], tmp_path / "packed")
    assert {path.name for path in packed.iterdir()} == {"config.json", "weights.npz"}
    agents = [load(folder, scenario).params.agent for folder in (packed, trained[1])]
    trees.assert_close(*agents, rtol=1e-3, atol=1e-6)
    with pytest.raises(InputError, match="is packed already; copy it"):
        pack(packed, tmp_path / "again")


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
    weights, expected = (load(place, scenario).params.agent for place in (folder, trained[1]))
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
    checkpoints, best = folder / "checkpoints", int(trained[0].best.update)
    steps = sorted(path.name for path in checkpoints.iterdir())
    for number in [number for number in range(1, best) if str(number) not in steps][:8]:
        half = checkpoints / str(number)
        shutil.copytree(checkpoints / str(best), half)  # as good as the best, which came after it
        paths = sorted(half.rglob("*"))
        for path in chance.sample(paths, chance.randint(1, len(paths))):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    assert len([*checkpoints.iterdir()]) > len(steps) + 3
    scenario = learning_data.setting()[0]["join_group"]
    weights, expected = (load(place, scenario).params.agent for place in (folder, trained[1]))
    trees.assert_equal(weights, expected)
    again = imitation.train(options(data, folder))
    trees.assert_equal(trained[0], again)
    assert sorted(path.name for path in checkpoints.iterdir()) == steps


def test_a_policy_is_opened_while_its_training_replaces_the_best(trained, tmp_path, monkeypatch):
    """The best is half deleted between the look at what there is and the reading of it, and a better one is there."""
    import shutil

    folder = tmp_path / "run"
    shutil.copytree(trained[1], folder)
    best, restore = int(trained[0].best.update), Checkpoints._restore
    old, new = (folder / "checkpoints" / str(number) for number in (best, 13))

    def replaced(self, *arguments, **options):
        if not new.exists():
            shutil.copytree(old, new)
            shutil.rmtree(old / "state")
        return restore(self, *arguments, **options)

    monkeypatch.setattr(Checkpoints, "_restore", replaced)
    scenario = learning_data.setting()[0]["join_group"]
    weights, expected = (load(place, scenario).params.agent for place in (folder, trained[1]))
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


@pytest.mark.slow
def test_a_byte_that_changed_in_a_checkpoint_changes_no_weight(trained, tmp_path):
    """Orbax has no checksum: without the digests, some of these policies would act otherwise."""
    import shutil

    random, refused = np.random.default_rng(0), 0
    scenario = learning_data.setting()[0]["join_group"]
    expected = jax.tree.leaves(load(trained[1], scenario).params.agent)
    for number in range(24):
        folder = tmp_path / str(number)
        shutil.copytree(trained[1], folder)
        best = folder / "checkpoints" / str(int(trained[0].best.update)) / "state"
        files = sorted(path for path in best.rglob("*") if path.is_file() and path.stat().st_size)
        sizes = np.array([path.stat().st_size for path in files])
        file = files[random.choice(len(files), p=sizes / sizes.sum())]
        content = bytearray(file.read_bytes())
        content[random.integers(len(content))] ^= 1 << random.integers(8)
        file.write_bytes(content)
        try:
            found = jax.tree.leaves(load(folder, scenario).params.agent)
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
        log = MetricsLog(tmp_path, begin)
        for epoch in range(begin, begin + 4):
            log.add({"epoch": epoch + 1, "train": {"loss": float(begin)}, "time": 1.0})
    assert [(line["epoch"], line["train"]["loss"]) for line in lines(tmp_path)] == [
        (1, 0.0), (2, 0.0), (3, 2.0), (4, 2.0), (5, 2.0), (6, 2.0),
    ]  # fmt: skip


@pytest.mark.night
def test_the_driver_sees_and_answers_what_the_examples_say(data, trained):
    """Driven step by step, in a batch, its decisions each second are those for the examples of the recording."""
    parts, camera = learning_data.setting()
    scenario = parts["join_group"]
    policy = load(trained[1], scenario)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(random_streams.key("collect", learning_data.SEED), jnp.arange(3))

    def follow(before, after, action):
        return after.policy_state.auxiliary, action

    drive = jax.vmap(lambda policy, key: episodes.rollout(scenario, policy, key, 61, follow), (None, 0))
    _, (outputs, actions) = jax.jit(drive)(policy, keys)
    running = Runner(scenario, policy, 3, "collect", row_record(scenario, camera))
    batch = simulate_shard(running, learning_data.SEED, 0, 0)
    np.testing.assert_allclose(batch.rows["command"][:, :7], actions[:, ::10], atol=1e-3)
    lengths = np.minimum(batch.lengths, 7)
    assert (lengths == 7).all()
    rows = {name: values[:, :7].reshape(21, *values.shape[2:]) for name, values in batch.rows.items()}
    first = np.repeat(np.arange(3, dtype=np.int32) * 7, 7)
    from sean_jax.learning.examples import DemonstrationRow, Recording

    recording = on_device(Recording(DemonstrationRow(**rows), first, first + 7))
    params = policy.params
    rows = jnp.arange(21, dtype=jnp.int32)
    answer = answers(described(16), params.agent, jax.jit(jax.vmap(example, (None, 0)))(recording, rows))
    for name, values in answer.auxiliary.items():
        expected = values.reshape(3, 7, *values.shape[1:])
        np.testing.assert_allclose(outputs[name][:, ::10], expected, atol=2e-3)
    scale = np.asarray(params.agent.command_scale)
    np.testing.assert_allclose(actions[:, ::10].reshape(21, 2), np.asarray(answer.mean) * scale, atol=2e-3)


def test_another_number_of_devices_is_refused_before_anything_is_drawn(tmp_path, monkeypatch):
    options = PPOConfig(environment="lab", people=2, dynamics="twin", out=tmp_path / "made")
    (tmp_path / "made").mkdir()
    config = json.loads(json.dumps(trainer.method_config(options, devices=3)))
    trainer.write_config(tmp_path / "made", config)
    monkeypatch.setattr(reinforcement, "build", lambda options: pytest.fail("it is built"))
    with pytest.raises(InputError, match=r"made was begun with devices 3, not \d+; ask for the same or choose another"):
        reinforcement.train(options)

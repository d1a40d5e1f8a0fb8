"""Datasets on disk: whole after any kill, the same to the byte, and one sentence for whatever is wrong with them."""

import dataclasses
import importlib.util
import io
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sean_jax.cli import command_line
from sean_jax.config import CollectConfig, Figure4Config, ImitationConfig, validate
from sean_jax.core.errors import IncompleteError, InputError
from sean_jax.io import writing
from sean_jax.learning import collection, dataset, lerobot
from sean_jax.learning.collection import Recorder
from sean_jax.learning.dataset import check_manifest, open_dataset, open_datasets, split, windows
from sean_jax.learning.examples import example
from sean_jax.learning.networks import read_network_config
from sean_jax.world import environment
from support import learning_data
from support.checkout import DATA, benchmark
from support.files import contents, write
from support.mjcf import box, with_geom


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return learning_data.write(tmp_path_factory.mktemp("data") / "made")


@pytest.fixture
def data(tmp_path):
    return learning_data.write(tmp_path / "data")


@pytest.mark.night
def test_what_was_written_is_read(made):
    again = open_dataset(made.folder)
    whole = [dataset.Episode(e.number, e.stream, e.length, e.completed) for e in again.episodes]
    assert again.example_count == 2 * 90, "3 minutes, half of them each"
    found = again.read(whole)
    lengths = {e.number: e.length for e in whole}
    for name, values in found.items():
        parts = []
        for k, batch in enumerate(learning_data.batches()):
            parts += [batch.rows[name][i, : lengths.get(8 * k + i, 0)] for i in range(8)]
        np.testing.assert_array_equal(values, np.concatenate(parts))


def test_other_readers_of_zarr_find_what_the_format_prescribes(made):
    """The metadata as zarr 3 has it, and the file's end: an index of (offset, size) pairs and its crc32c."""
    metadata = json.loads((made.folder / "depth" / "zarr.json").read_text())
    assert metadata["zarr_format"] == 3 and metadata["node_type"] == "array" and metadata["data_type"] == "uint16"
    assert metadata["shape"] == [16, 20, 12, 16] and metadata["codecs"][0]["name"] == "sharding_indexed"
    raw = (made.folder / "depth/c/1/0/0/0").read_bytes()
    index = np.frombuffer(raw[-4 - 16 * 8 : -4], "<u8").reshape(8, 2)
    assert int.from_bytes(raw[-4:], "little") == learning_data.crc32c(raw[-4 - 16 * 8 : -4])
    assert (index[:, 0] + index[:, 1] <= len(raw)).all() and learning_data.crc32c(b"123456789") == 0xE3069283


def test_a_collection_that_was_interrupted_goes_on(data, tmp_path, monkeypatch):
    """After each step that a kill could come before, what is done again gives the same bytes."""
    whole = contents(data.folder)
    simulated = []

    def simulate(runner, seed, shard, stream, watch, turn):
        assert stream == shard
        simulated.append(shard)
        return learning_data.batches()[shard]

    monkeypatch.setattr(collection, "simulate_shard", simulate)
    for number in range(6):
        folder, steps = tmp_path / f"killed{number}", [number]

        def step(original, steps=steps):
            def stopping(*arguments):
                steps[0] -= 1
                if steps[0] == 0:
                    raise KeyboardInterrupt
                return original(*arguments)

            return stopping

        with monkeypatch.context() as patched:
            patched.setattr(writing.os, "replace", step(os.replace))
            patched.setattr(dataset, "shard_file", step(dataset.shard_file))
            try:
                collection.collect(learning_data.options(folder))
            except KeyboardInterrupt:
                assert number > 0
        collection.collect(learning_data.options(folder))
        assert contents(folder) == whole, number
        before = len(simulated)
        collection.collect(learning_data.options(folder))
        assert len(simulated) == before, "nothing is recorded twice"


def everything(folder: Path) -> dict[str, tuple]:
    """Of each file and folder what a writer would change."""
    paths = [folder, *folder.rglob("*")]
    return {str(p): (p.stat().st_mtime_ns, p.read_bytes() if p.is_file() else sorted(os.listdir(p))) for p in paths}


def test_readers_change_nothing(made, tmp_path, monkeypatch):
    """Nor need they be allowed to. The path is one as people type it."""
    monkeypatch.chdir(tmp_path)
    before = everything(made.folder)
    paths = [made.folder, *made.folder.rglob("*")]
    for path in paths:
        path.chmod(path.stat().st_mode & ~0o222)
    try:
        again = open_dataset(os.path.relpath(made.folder))
        assert ".." in str(again.folder) and again.damaged_shards() == [] and again.fingerprint() == made.fingerprint()
        train, validation = split(again, 0.25, 0)
        assert len(again.recording(validation).first) and len(list(windows(again, train, 64)))
        if importlib.util.find_spec("pyarrow"):
            lerobot.export(made.folder, tmp_path / "out")
        assert everything(made.folder) == before
    finally:
        for path in paths:
            path.chmod(path.stat().st_mode | 0o200)


def test_two_collections_into_one_folder(tmp_path, monkeypatch):
    """The later one is refused before it simulates anything, and the earlier one's dataset is whole."""
    folder, refused = tmp_path / "data", []

    def simulate(runner, seed, shard, stream, watch, turn):
        with pytest.raises(writing.WriteError, match="data is being written by process"):
            collection.collect(learning_data.options(folder))
        refused.append(shard)
        return learning_data.batches()[shard]

    monkeypatch.setattr(collection, "simulate_shard", simulate)
    assert collection.collect(learning_data.options(folder)).example_count == 180 and refused == [0, 1]
    assert not (folder / writing.LOCK).exists()


def test_a_shard_that_cannot_be_written_ends_the_collection(tmp_path, monkeypatch):
    """The next one, which was simulated meanwhile, is not written, and the same command goes on."""
    monkeypatch.setattr(
        collection, "simulate_shard", lambda runner, seed, shard, *others: learning_data.batches()[shard]
    )
    folder, asked = tmp_path / "data", []

    def full(folder, shard, fields):
        asked.append(shard)
        raise IncompleteError("the disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(dataset, "write_shard", full)
        with pytest.raises(IncompleteError, match="the disk is full"):
            collection.collect(learning_data.options(folder))
    assert asked == [0] and open_dataset(folder).stream_rows == [0, 0]
    assert collection.collect(learning_data.options(folder)).example_count == 180


def test_lost_and_damaged_files(data, monkeypatch):
    whole, file = contents(data.folder), data.folder / "depth/c/0/0/0/0"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(
        IncompleteError, match=r"depth/c/0/0/0/0 is damaged; remove the damaged file, and `sean collect`"
    ):
        data.recording(data.episodes)
    second = [episode for episode in data.episodes if episode.number >= 8]
    assert len(data.recording(second).first), "other shards are intact"
    file.unlink()
    with pytest.raises(IncompleteError, match="is missing or damaged; remove the damaged file"):
        data.recording(data.episodes)
    monkeypatch.setattr(collection, "simulate_shard", lambda *others: learning_data.batches()[0])
    collection.collect(learning_data.options(data.folder))
    assert contents(data.folder) == whole


def test_a_full_disk_leaves_what_was_committed(data, monkeypatch):
    whole = contents(data.folder)

    def full(*arguments, **others):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(dataset, "_open_array", full)
        with pytest.raises(IncompleteError, match="the disk is full; committed shards are unchanged"):
            data.commit(0, learning_data.batches()[0])
    with monkeypatch.context() as patched:
        patched.setattr(writing.os, "replace", full)
        with pytest.raises(IncompleteError, match="the disk is full; committed shards are unchanged"):
            data.save({**data.manifest, "hours": 2.0})
    again = open_dataset(data.folder)
    assert again.manifest == data.manifest and {name: contents(data.folder)[name] for name in whole} == whole


def test_other_options_are_refused(data):
    for others, message in (
        ({"people": 5}, "was begun with --people 4, not 5"),
        ({"seed": 4}, "was begun with --seed 3, not 4"),
        ({"walking_groups": (0.5, 0.0)}, "--walking-groups 0 0, not graph .* --walking-groups 0.5 0;"),
        ({"routing": "edge"}, "was begun with --behavior graph --routing trips .*, not graph --routing edge "),
        ({"batch": 4}, "was begun with --batch 8, not 4"),
        ({"hours": 0.01}, "was begun with --hours 0.05, not 0.01"),
    ):
        with pytest.raises(InputError, match=message):
            learning_data.begin(learning_data.options(data.folder, **others))
    assert open_dataset(data.folder).manifest == data.manifest
    assert learning_data.begin(learning_data.options(data.folder)).stream_rows == data.stream_rows


def test_more_hours_continue_a_dataset(data):
    longer = learning_data.begin(learning_data.options(data.folder, 0.06))
    assert longer.example_count > 180 and longer.manifest["shards"] == data.manifest["shards"]


def test_folders_that_hold_no_dataset(tmp_path, capsys):
    with pytest.raises(InputError, match="has no dataset.json; make a dataset with `sean collect"):
        open_dataset(tmp_path)
    (tmp_path / "dataset.json").write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        open_dataset(tmp_path)
    (tmp_path / "dataset.json").write_text('{"format": 99}')
    with pytest.raises(InputError, match="dataset.json has format 99, but this version reads 1"):
        open_dataset(tmp_path)
    assert command_line.main(["train", "imitation", str(tmp_path / "none"), "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("sean: ") and "has no dataset.json" in error and len(error.splitlines()) == 1
    assert command_line.main(["collect", "--hours", "-1"]) == 2 and "--hours: -1" in capsys.readouterr().err


def test_the_loader_shuffles_everything_once_and_goes_on_from_a_token(made):
    train, validation = split(made, 0.25, 0)
    assert {one.number for one in train} & {one.number for one in validation} == set()
    assert len(validation) == round(0.25 * (len(train) + len(validation)))
    recording = made.recording(train)
    every = example(recording, np.arange(len(recording.first)), np)

    def futures(epoch: int) -> list[tuple]:
        rows, sizes = [], set()
        for window, batches in windows(made, train, 32, seed=1, epoch=epoch, size=4):
            sizes.add(len(window.first))
            assert batches.shape[1] == 32
            rows += [example(window, np.array(row), np).future for row in batches.ravel() if row >= 0]
        assert len(sizes) == 1, "one program for all"
        return [tuple(future.ravel()) for future in rows]

    assert sorted(futures(0)) == sorted(map(tuple, every.future.reshape(len(every.future), -1)))
    assert futures(0) == futures(0) != futures(1), "another order in another epoch"


@pytest.fixture(scope="module")
def fine(tmp_path_factory):
    """A dataset of ten rows a second."""
    return learning_data.write_fine(tmp_path_factory.mktemp("data") / "fine")


def test_ten_rows_a_second(fine, made):
    """The hours are as many, the examples ten times as many, and what one example is made of lies a second apart."""
    again = open_dataset(fine.folder)
    assert again.rate == 10 and again.manifest["seconds"] == learning_data.SECONDS
    assert again.example_count == 10 * made.example_count == 1800 and again.stream_rows == [1000, 1000]
    recording = again.recording(again.episodes)
    first = again.episodes[0].length
    one = example(recording, np.array(first - 1), np)
    assert first > 60 and (np.diff(recording.rows.pose[:first, 0]) == 1.0).all()
    np.testing.assert_array_equal(one.past[:, 0], [-50.0, -40.0, -30.0, -20.0, -10.0])
    np.testing.assert_array_equal(one.images[:, 0, 0], first - 1 - np.array([40, 30, 20, 10, 0]))
    assert not one.future_valid.any()
    begun = example(recording, np.array(0), np)
    np.testing.assert_array_equal(begun.future[:, 0], [10.0, 20.0, 30.0, 40.0, 50.0])
    late = example(recording, np.array(45), np)
    np.testing.assert_array_equal(late.past[:, 0], [-45.0, -40.0, -30.0, -20.0, -10.0])


def test_rates_are_not_mixed(fine, made, data):
    from sean_jax.config import ImitationConfig
    from sean_jax.learning import imitation

    with pytest.raises(InputError, match="10 examples per second, and .* 1; collect with the same --rate"):
        open_datasets([made.folder, fine.folder])
    pair = [ImitationConfig(method="imitation", dataset=one.folder, out=one.folder / "no") for one in (made, fine)]
    with pytest.raises(InputError, match="the datasets have different rates"):
        imitation.train_ensemble(pair)
    with pytest.raises(InputError, match="was begun with --rate 1, not 2"):
        learning_data.begin(learning_data.options(data.folder, rate=2))
    for rate in (0.5, 2.5, 1e9, "fast"):
        data.save({**data.manifest, "rate": rate})
        with pytest.raises(InputError, match="rate.* cannot be read"):
            open_dataset(data.folder)


def test_export_to_lerobot_has_the_rate(fine, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow, of the extra lerobot, is not installed")
    out = lerobot.export(fine.folder, tmp_path / "out")
    assert json.loads((out / "meta/info.json").read_text())["fps"] == 10
    rows = parquet.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    np.testing.assert_allclose(rows["timestamp"], np.array(rows["frame_index"]) / 10, atol=1e-5)


def test_export_to_lerobot(made, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow, of the extra lerobot, is not installed")
    out = lerobot.export(made.folder, tmp_path / "out")
    names = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    table = "chunk-000/file-000.parquet"
    assert names == {
        "meta/info.json",
        "meta/stats.json",
        "meta/tasks.parquet",
        f"meta/episodes/{table}",
        f"data/{table}",
    }
    info = json.loads((out / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["total_frames"] == 180 and info["fps"] == 1
    rows = parquet.read_table(out / "data" / table).to_pydict()
    assert set(rows) == set(info["features"])
    recording = made.recording(made.episodes)
    np.testing.assert_array_equal(np.array(rows["action"], np.float32), recording.rows.command)
    image = Image.open(io.BytesIO(rows["observation.images.depth"][77]["bytes"]))
    np.testing.assert_array_equal(np.asarray(image), recording.rows.depth[77])
    episodes = parquet.read_table(out / "meta/episodes" / table).to_pydict()
    for number, (first, last) in enumerate(
        zip(episodes["dataset_from_index"], episodes["dataset_to_index"], strict=True)
    ):
        assert set(rows["episode_index"][first:last]) == {number} and rows["index"][first] == first
        assert rows["frame_index"][first:last] == list(range(episodes["length"][number]))
    assert parquet.read_table(out / "meta/tasks.parquet").to_pydict()["task"] == ["join group", "leave group"]
    with pytest.raises(InputError, match="is not empty"):
        lerobot.export(made.folder, out)


def test_an_export_has_the_form_that_lerobot_writes(made, tmp_path):
    """Recorded of LeRobot's own writer by ``benchmarks/lerobot_oracle.py --record``, which also compares the values."""
    pytest.importorskip("pyarrow")
    lerobot_oracle = benchmark("lerobot_oracle")

    recorded = json.loads((DATA / "lerobot_schema.json").read_text())
    assert recorded.pop("lerobot") == "0.6.1"
    ours = lerobot_oracle.schema(lerobot.export(made.folder, tmp_path / "out"))
    assert json.loads(json.dumps(ours)) == recorded


def test_statistics_of_an_export_are_those_of_its_data(made, tmp_path):
    """So that a policy which normalizes by them gets numbers around 0. Depth is in mm there as in its pixels."""
    parquet = pytest.importorskip("pyarrow.parquet")
    out = lerobot.export(made.folder, tmp_path / "out")
    table = parquet.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    images = [cell["bytes"] for cell in table["observation.images.depth"]]
    table["observation.images.depth"] = [np.asarray(Image.open(io.BytesIO(image))) for image in images]
    stats = json.loads((out / "meta/stats.json").read_text())
    episodes = parquet.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    tasks = parquet.read_table(out / "meta/tasks.parquet").to_pydict()["task"]
    assert {name for each in episodes["tasks"] for name in each} == set(tasks)
    which = np.array(table["episode_index"])
    for name, column in table.items():
        values = np.array(column, np.float64)
        cases = [(stats[name], values)]
        for number in range(len(episodes["length"])):
            own = {key: episodes[f"stats/{name}/{key}"][number] for key in stats[name]}
            cases.append((own, values[which == number]))
        for own, rows in cases:
            assert own["count"] == [len(rows)]
            rows = rows.reshape(-1, 1) if name.endswith("depth") else rows.reshape(len(rows), -1)
            for key, wanted in {
                "min": rows.min(0),
                "max": rows.max(0),
                "mean": rows.mean(0),
                "std": rows.std(0),
            }.items():
                np.testing.assert_allclose(np.ravel(own[key]), wanted, rtol=1e-9, atol=1e-9, err_msg=f"{name} {key}")
            for key in ("q01", "q10", "q50", "q90", "q99"):
                level, share = np.ravel(own[key]), int(key[1:]) / 100
                assert ((rows <= level).mean(0) >= share - 1e-9).all(), (name, key)
                assert ((rows < level).mean(0) <= share + 1e-9).all(), (name, key)


def test_one_situation_is_exported_as_a_number(fine, tmp_path):
    """LeRobot reads a feature of shape (1,) as a plain column."""
    parquet = pytest.importorskip("pyarrow.parquet")
    manifest = {**fine.manifest, "situations": ["passing"]}
    one = dataset.create_dataset(tmp_path / "one", {name: manifest[name] for name in manifest if name != "shards"})
    blank = {name: np.zeros((8, one.most_rows, *shape), kind) for name, (shape, kind) in one.fields.items()}
    for stream in range(2):
        one.commit(stream, dataset.EpisodeBatch(blank, np.full(8, 90), np.ones(8, bool)))
    out = lerobot.export(one.folder, tmp_path / "out")
    feature = json.loads((out / "meta/info.json").read_text())["features"]["observation.situations"]
    assert feature == {"dtype": "float32", "shape": [1], "names": ["passing"]}
    columns = parquet.read_schema(out / "data/chunk-000/file-000.parquet")
    assert str(columns.field("observation.situations").type) == "float"


def test_what_the_options_stand_for_must_not_have_changed(data):
    """As when somebody edits an environment between two collections of the same options."""
    parts, _ = learning_data.setting()
    asked = learning_data.options(data.folder, 0.06)
    others = {name: dataclasses.replace(part, goal_radius=part.goal_radius * 2) for name, part in parts.items()}
    with pytest.raises(InputError, match="was begun with another scenario and policy; ask for the same"):
        learning_data.begin(asked, others)
    before = data.manifest
    for name, value, message in (
        ("versions", {**before["versions"], "jax": "0.1"}, "begun with jax 0.1, not "),
        ("people", 3, "begun with people 3, not"),
        ("robot", {**before["robot"], "max_speed": 9.0}, "begun with another robot"),
        ("camera", {**before["camera"], "far": 1.0}, "begun with another camera"),
        ("situations", before["situations"][::-1], "begun with another situations"),
        ("content", "0" * 16, "begun with another scenario and policy"),
    ):
        data.save({**before, name: value})
        with pytest.raises(InputError, match=message):
            learning_data.begin(asked)


def test_options_allow_no_more_than_datasets_and_networks_may_hold(data, tmp_path):
    most = CollectConfig(hours=1e6, batch=100_000, width=4096, height=976, time_limit=86_400.0)
    camera = {"width": most.width, "height": most.height}
    manifest = {
        **data.manifest,
        "hours": most.hours,
        "batch": most.batch,
        "camera": camera,
        "seconds": 86_400,
        "shards": [],
    }
    check_manifest(tmp_path, manifest, tuple(data.fields))
    for beyond in ({"hours": 1.1e6}, {"batch": 100_001}, {"width": 4097}, {"height": 4097}, {"height": 977}):
        (name,) = beyond
        name = "width" if beyond == {"height": 977} else name  # of both together
        with pytest.raises(InputError, match=f"^{name}: "):
            validate(CollectConfig, {**dict(most), **beyond})
    Figure4Config(hours=1e6)
    with pytest.raises(InputError, match="^hours: "):
        validate(Figure4Config, {"hours": 1.1e6})
    train = ImitationConfig(method="imitation", dataset=data.folder, width=4096)
    config = {"width": train.width, "flags": True, "image": [most.height, most.width], "situations": ["joining"]}
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert read_network_config(tmp_path / "config.json").width == train.width
    with pytest.raises(InputError, match="^width: "):
        validate(ImitationConfig, {**dict(train), "width": 4097})


def test_an_export_into_what_a_killed_process_left(made, tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / writing.LOCK).write_text("process 1 on a machine that is no more")
    monkeypatch.setattr(lerobot, "_export", lambda data, out: (out / "kept").touch())
    lerobot.export(made.folder, tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["kept"]


def test_a_recorder_goes_on_where_a_kill_left_no_manifest(tmp_path):
    parts, _ = learning_data.setting()
    (tmp_path / "data" / "depth").mkdir(parents=True)
    (tmp_path / "data" / writing.LOCK).write_text("process 1 on a machine that is no more")
    Recorder(tmp_path / "data", parts["join_group"], width=16, height=12)
    assert open_dataset(tmp_path / "data").stream_rows == [0]
    write(tmp_path / "full" / "letter.txt", "dear")
    with pytest.raises(InputError, match="holds something else already"):
        Recorder(tmp_path / "full", parts["join_group"], width=16, height=12)
    with pytest.raises(InputError, match="more than 4,000,000 pixels"):
        Recorder(tmp_path / "new", parts["join_group"], width=4096, height=4096)


@pytest.mark.slow
def test_an_environment_that_was_edited_ends_a_collection_before_it_is_mixed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(collection, "_due", lambda *_: iter(()))
    shutil.copytree(environment.find("lab"), tmp_path / "place")
    words = "--behavior random --people 2 --dynamics twin --width 16 --height 12 --hours 0.01 --quiet".split()
    command = ["collect", "--environment", str(tmp_path / "place"), *words, "--out", str(tmp_path / "data")]
    assert command_line.main(command) == 0 == command_line.main(command)
    scene = tmp_path / "place" / "scene.xml"
    scene.write_text(with_geom(scene.read_text(), box((0.5, 0.5), (0.1, 0.1), height=1.0)))
    assert command_line.main(command) == 2
    assert "was begun with another scenario and policy" in capsys.readouterr().err

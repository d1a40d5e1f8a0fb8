"""Bags as recorders write them: clocks that differ, resets, and files made to do harm."""

import bz2
import os
import shutil
import sqlite3

import numpy as np
import pytest

from sean_jax.cli import command_line
from sean_jax.core.errors import FileError
from sean_jax.io.trajectories import load_trajectory
from sean_jax.people import recordings
from sean_jax.ros import bag_import, bag_opening, bag_tables, messages
from support.bags import fill, write_bag1, write_bag2

pytest.importorskip("rosbags")
SECOND = messages.SECOND
WALL = 1_790_000_000 * SECOND  # ns, of a recorder whose stamps begin at 1 s
ODOM, PEOPLE, TWIST = "nav_msgs/msg/Odometry", "people_msgs/msg/People", "geometry_msgs/msg/Twist"
GOAL = "geometry_msgs/msg/PoseStamped"


def header(stamp, frame="map"):
    return {"stamp": messages.stamp(stamp), "frame_id": frame}


def pose(x, y=0.0):
    return {
        "position": {"x": float(x), "y": float(y), "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }


def odometry(stamp, x, y=0.0, speed=0.0):
    twist = {"twist": messages.twist(speed, 0.0, 0.0)}
    return {"header": header(stamp), "child_frame_id": "base_link", "pose": {"pose": pose(x, y)}, "twist": twist}


def people(stamp, places):
    rows = [{"name": name, "position": {"x": x, "y": y, "z": 0.0}} for name, (x, y) in places.items()]
    return {"header": header(stamp), "people": rows}


def drive(received, resets=(), goals=True, steps=40, step=SECOND // 10):
    """Rows of a drive: a robot at .3 m/s and two people at 1 m/s, who are elsewhere after each reset.

    Args:
        received: (step, stamp) -> ns, the recorder's clock.
        resets: steps at which everybody is put back.
    """
    rows, begin = [], 0
    for k in range(steps):
        stamp = SECOND + k * step
        begin = k if k in resets else begin
        t = (k - begin) * step / SECOND
        at = received(k, stamp)
        shift = 20.0 * sum(reset <= k for reset in resets)
        if goals and k == begin:
            rows.append(("/goal", GOAL, at, {"header": header(stamp), "pose": pose(7.0 + shift, 3.0)}))
        rows.append(("/odom", ODOM, at, odometry(stamp, 0.3 * t + shift)))
        rows.append(("/people", PEOPLE, at, people(stamp, {"a": (t, 2.0 + shift), "b": (5.0 - t, -2.0 - shift)})))
        rows.append(("/cmd_vel", TWIST, at + step // 50, messages.twist(0.01 * (k + 1), 0.0, 0.0)))
    return rows


CLOCKS = {
    "wall": lambda k, stamp: WALL + k * SECOND // 10 + (k % 3) * SECOND // 200,  # a recorder that was there first
    "lockstep": lambda k, stamp: WALL + k * SECOND // 78,  # 7.8 times as fast as real time
    "laptop": lambda k, stamp: stamp + 7 * SECOND,  # 7 s ahead of the robot
    "same": lambda k, stamp: stamp,
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_goals_and_commands_are_at_the_time_of_headers(tmp_path, clock):
    write_bag1(tmp_path / "drive.bag", drive(CLOCKS[clock]))
    result = bag_import.import_bag(tmp_path / "drive.bag", tmp_path / "out")
    assert result[1:] == (40, 2, True, "map", 1, [])
    frames = load_trajectory(tmp_path / "out" / bag_import.ROBOT)
    np.testing.assert_allclose(frames.goal, [[7.0, 3.0]] * 40)
    np.testing.assert_allclose(frames.position[:, 0], 0.03 * np.arange(40), atol=1e-6)
    np.testing.assert_allclose(frames.action[:, 0], 0.01 * np.arange(40), atol=1e-6)  # of the state before


def test_rosbag2_of_a_recorder_with_the_clock_of_the_wall(tmp_path):
    write_bag2(tmp_path / "drive", drive(CLOCKS["wall"]), "SQLITE3")
    assert bag_import.import_bag(tmp_path / "drive", tmp_path / "out").notes == []
    frames = load_trajectory(tmp_path / "out" / bag_import.ROBOT)
    np.testing.assert_allclose(frames.action[:, 0], 0.01 * np.arange(40), atol=1e-6)


def test_what_falls_on_no_row_is_told(tmp_path, capsys):
    late = [("/goal", GOAL, WALL, {"header": header(100 * SECOND), "pose": pose(1)})]
    write_bag1(tmp_path / "drive.bag", [row for row in drive(CLOCKS["same"]) if row[0] != "/goal"] + late)
    assert command_line.main(["import-bag", str(tmp_path / "drive.bag"), "--out", str(tmp_path / "out")]) == 0
    assert "note: no goal of the bag falls on a row" in capsys.readouterr().out


@pytest.mark.parametrize("goals", [True, False])
def test_a_reset_begins_an_episode_with_other_people(tmp_path, capsys, goals):
    """With a new goal at the reset, or because all that is there jumps."""
    write_bag1(tmp_path / "drive.bag", drive(CLOCKS["wall"], resets=(15, 30), goals=goals))
    assert command_line.main(["import-bag", str(tmp_path / "drive.bag"), "--out", str(tmp_path / "out")]) == 0
    assert "the bag has 2 resets, so there are 3 episodes" in capsys.readouterr().out
    table = np.genfromtxt(tmp_path / "out" / bag_import.PEOPLE, delimiter=",", names=True)
    assert np.hypot(table["vx_mps"], table["vy_mps"]).max() < 1.01
    assert [sorted(set(table["id"][table["episode"] == k])) for k in range(3)] == [[0, 1], [2, 3], [4, 5]]
    assert recordings.read(tmp_path / "out" / bag_import.PEOPLE, frame_rate=100.0).position.shape[1] == 6
    frames = load_trajectory(tmp_path / "out" / bag_import.ROBOT)
    assert np.asarray(frames.active).sum(axis=1).tolist() == [15, 15, 10]
    assert np.abs(np.asarray(frames.people_velocity)).max() < 1.01
    if goals:
        np.testing.assert_allclose(frames.goal[:, 0, 0], [7.0, 27.0, 47.0])


@pytest.mark.parametrize("version", [1, 2])
def test_time_that_goes_back_begins_an_episode(tmp_path, version):
    """Two drives in one bag, each from 1 s on, as of a simulation that was started again."""
    rows = drive(CLOCKS["wall"]) + drive(lambda k, stamp: WALL + 9 * SECOND + k * SECOND // 10)
    path = write_bag1(tmp_path / "two.bag", rows) if version == 1 else write_bag2(tmp_path / "two", rows)
    assert bag_import.import_bag(path, tmp_path / "out").episodes == 2
    frames = load_trajectory(tmp_path / "out" / bag_import.ROBOT)
    for episode in (0, 1):
        np.testing.assert_allclose(frames.position[episode, :, 0], 0.03 * np.arange(40), atol=1e-6)
        np.testing.assert_allclose(frames.action[episode, :, 0], 0.01 * np.arange(40), atol=1e-6)


def test_one_who_jumps_alone_is_a_new_person(tmp_path):
    rows = []
    for k in range(40):
        stamp = SECOND + k * SECOND // 10
        places = {"a": (0.1 * k + (30 if k >= 20 else 0), 0.0), "b": (0.1 * k, 1.0), "c": (0.0, 0.1 * k)}
        rows.append(("/people", PEOPLE, stamp, people(stamp, places)))
    result = bag_import.import_bag(write_bag1(tmp_path / "p.bag", rows), tmp_path / "out")
    assert (result.people, result.episodes) == (4, 1) and "1 times somebody jumped" in result.notes[0]


# ------------------------------------------------------------------ numbers


@pytest.mark.parametrize("number", [np.inf, -np.inf, np.nan, 1e39])
@pytest.mark.parametrize("topic", ["/cmd_vel", "/odom", "/goal", "/people"])
def test_numbers_that_cannot_be_are_refused(tmp_path, topic, number):
    rows = drive(CLOCKS["same"], steps=5)
    wrong = {
        "/cmd_vel": messages.twist(number, 0.0, 0.0),
        "/odom": odometry(2 * SECOND, number),
        "/goal": {"header": header(2 * SECOND), "pose": pose(number)},
        "/people": people(2 * SECOND, {"a": (number, 0.0)}),
    }
    kinds = {name: kind for name, kind, *_ in rows}
    write_bag1(tmp_path / "drive.bag", [*rows, (topic, kinds[topic], 2 * SECOND, wrong[topic])])
    with pytest.raises(FileError, match=f"{topic}: .* cut those messages out"):
        bag_import.import_bag(tmp_path / "drive.bag", tmp_path / "out")


def test_days_are_refused(tmp_path):
    rows = [
        ("/odom", ODOM, SECOND, odometry(SECOND, 0)),
        ("/odom", ODOM, 2 * SECOND, odometry(22 * 86_400 * SECOND, 1)),
    ]
    with pytest.raises(FileError, match="lasts 528 h, and at most 24 are read"):
        bag_import.import_bag(write_bag1(tmp_path / "long.bag", rows), tmp_path / "out")


def test_rows_are_bounded_in_bytes(tmp_path):
    rows = drive(CLOCKS["same"], steps=2, step=3600 * SECOND)
    with pytest.raises(FileError, match="more than 200 MB"):
        bag_import.import_bag(write_bag1(tmp_path / "long.bag", rows), tmp_path / "out", 0.001)


def test_people_who_are_at_no_row_make_no_recording(tmp_path):
    rows = [("/odom", ODOM, k * SECOND // 10, odometry(k * SECOND // 10, 0.0)) for k in range(10, 20)]
    rows.append(("/people", PEOPLE, 20 * SECOND, people(20 * SECOND, {"a": (0.0, 0.0)})))
    result = bag_import.import_bag(write_bag1(tmp_path / "r.bag", rows), tmp_path / "out")
    assert sorted(each.name for each in result.folder.iterdir()) == [bag_import.ROBOT]
    assert "no people in the rows" in result.notes[0]


# ------------------------------------------------------------------ files made to do harm


def picture(stamp, size):
    data = np.zeros(size, np.uint8)
    return {"header": header(stamp), "height": 1, "width": size, "encoding": "mono8", "step": size, "data": data}


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_what_a_chunk_of_rosbag1_unpacks_to_is_bounded(tmp_path, monkeypatch, compression):
    from rosbags.rosbag1 import Writer

    monkeypatch.setattr(bag_opening, "MAX_PART", 1_000_000)
    rows = drive(CLOCKS["same"], steps=5)
    big = [*rows, ("/camera", "sensor_msgs/msg/Image", rows[-1][2], picture(SECOND, 3_000_000))]
    form = getattr(Writer.CompressionFormat, compression.upper())
    path = write_bag1(tmp_path / "big.bag", big, form)
    assert path.stat().st_size < 100_000
    with pytest.raises(FileError, match="a chunk of more than 1,000,000 bytes"):
        bag_import.import_bag(path, tmp_path / "out")
    write_bag1(tmp_path / "small.bag", rows, form)
    assert bag_import.import_bag(tmp_path / "small.bag", tmp_path / "out").people == 2


def compressed(folder, rows, mode):
    """A rosbag2 with zstd."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    plugin = StoragePlugin.MCAP if mode == "storage" else StoragePlugin.SQLITE3
    writer = Writer(folder, version=9, storage_plugin=plugin)
    writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    return fill(writer, folder, rows, 2)


@pytest.mark.parametrize("mode", ["storage", "message", "file"])
def test_what_a_rosbag2_unpacks_to_is_bounded(tmp_path, monkeypatch, mode):
    rows = drive(CLOCKS["same"], steps=5)
    compressed(tmp_path / "small", rows, mode)
    assert bag_import.import_bag(tmp_path / "small", tmp_path / "out").people == 2
    monkeypatch.setattr(bag_opening, "MAX_PART", 1_000_000)
    monkeypatch.setattr(bag_opening, "MAX_UNPACKED", (1_000_000, 1))
    big = [(topic, kind, time, dict(message)) for topic, kind, time, message in rows]
    many = {f"{k}": (0.0, 0.0) for k in range(30_000)}
    big.append(("/people", PEOPLE, rows[-1][2], people(SECOND, many)))
    if mode == "storage":  # a picture that nobody asked for, in the chunk of all others
        big[-1] = ("/camera", "sensor_msgs/msg/Image", rows[-1][2], picture(SECOND, 3_000_000))
    with pytest.raises(FileError, match="a chunk of more than|unpacks to far more"):
        bag_import.import_bag(compressed(tmp_path / "big", big, mode), tmp_path / "out2")


def test_pipes_and_devices_are_refused_at_once(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe.bag")
    (tmp_path / "zero.bag").symlink_to("/dev/zero")
    (tmp_path / "zero.mcap").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.db3")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "folder" / "metadata.yaml")
    write_bag2(tmp_path / "inside", drive(CLOCKS["same"], steps=2), "SQLITE3")
    (tmp_path / "inside" / "inside.db3").unlink()
    os.mkfifo(tmp_path / "inside" / "inside.db3")
    for name in ("pipe.bag", "zero.bag", "zero.mcap", "pipe.db3", "folder", "inside"):
        assert command_line.main(["import-bag", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert "it is a pipe" in said or "it is a device" in said, said


def test_databases_that_compute_rows_are_refused(tmp_path):
    folder = write_bag2(tmp_path / "view", drive(CLOCKS["same"], steps=2), "SQLITE3")
    with sqlite3.connect(folder / "view.db3") as database:
        database.execute("ALTER TABLE messages RENAME TO others")
        endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id,"
        database.execute(f"CREATE VIEW messages AS {endless} i AS timestamp, zeroblob(9) AS data FROM n")
    with pytest.raises(FileError, match="messages is no plain table"):
        bag_import.import_bag(folder, tmp_path / "out")


def computed(file):
    """A database whose messages are a gigabyte each, which stands nowhere."""
    with sqlite3.connect(file) as database:
        database.execute("DROP TABLE messages")
        columns = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(999999000))"
        database.execute(f"CREATE TABLE messages ({columns})")
        database.execute("INSERT INTO messages (topic_id, timestamp) VALUES (1, 1)")


def test_databases_that_are_packed_are_looked_at_when_they_are_unpacked(tmp_path):
    from backports import zstd

    folder = compressed(tmp_path / "bag", drive(CLOCKS["same"], steps=2), "file")
    (packed,) = folder.glob("*.zstd")
    (tmp_path / "plain.db3").write_bytes(zstd.decompress(packed.read_bytes()))
    computed(tmp_path / "plain.db3")
    packed.write_bytes(zstd.compress((tmp_path / "plain.db3").read_bytes()))
    with pytest.raises(FileError, match="messages is no plain table"):
        bag_import.import_bag(folder, tmp_path / "out")


@pytest.mark.parametrize(
    ("named", "beside"), [("x%41.db3", "xA.db3"), ("x.db3?mode=rw&y=.db3", "x.db3"), ("x#.db3", "x")]
)
@pytest.mark.parametrize("is_folder", [True, False])
def test_the_file_that_is_named_is_the_one_that_is_read(tmp_path, named, beside, is_folder):
    """Not the one whose name an address of SQLite means by it; also in a folder of such a name."""
    folder = tmp_path / "a%20b#c?d"
    write_bag2(tmp_path / "bag", drive(CLOCKS["same"], steps=2), "SQLITE3").rename(folder)
    (folder / "bag.db3").rename(folder / named)
    shutil.copy(folder / named, folder / beside)
    computed(folder / beside)
    text = (folder / "metadata.yaml").read_text().replace("bag.db3", named)
    (folder / "metadata.yaml").write_text(text)
    if not is_folder:
        (folder / "metadata.yaml").unlink()
    path = folder if is_folder else folder / named
    assert bag_import.import_bag(path, tmp_path / "out").people == 2
    computed(folder / named)
    with pytest.raises(FileError, match="messages is no plain table"):
        bag_import.import_bag(path, tmp_path / "out2")


def test_values_of_a_database_are_bounded_before_they_are_read(tmp_path, monkeypatch):
    """In all tables, of which a few packed bytes may be a gigabyte."""
    folder = write_bag2(tmp_path / "bag", drive(CLOCKS["same"], steps=2), "SQLITE3")
    monkeypatch.setattr(bag_opening, "MAX_PART", 100_000)
    assert bag_import.import_bag(folder, tmp_path / "out").people == 2
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("UPDATE message_definitions SET encoded_message_definition = zeroblob(200000)")
    with pytest.raises(FileError, match="is damaged"):
        bag_import.import_bag(folder, tmp_path / "out2")


@pytest.mark.parametrize(
    ("given", "other", "words"),
    [
        ("version: 9", "version: 99", "99 is not one of 1 to 9"),
        ("message_count: 8", "message_count: x", "message_count"),
        ("storage_identifier: sqlite3", "storage_identifier: 3", "storage_identifier"),
        ("relative_file_paths:", "relative_file_path:", "relative_file_paths"),
    ],
)
def test_metadata_is_checked_in_own_words(tmp_path, given, other, words):
    folder = write_bag2(tmp_path / "bag", drive(CLOCKS["same"], steps=2, goals=False)[:8], "SQLITE3")
    path = folder / "metadata.yaml"
    text = path.read_text()
    if given == "message_count: 8":
        given = next(line.strip() for line in text.splitlines() if line.strip().startswith("message_count"))
    assert given in text
    path.write_text(text.replace(given, other))
    with pytest.raises(FileError) as error:
        bag_import.import_bag(folder, tmp_path / "out")
    assert words in str(error.value) and "metadata.yaml:" in str(error.value)


def test_definitions_of_messages_are_bounded(tmp_path):
    """An array of a type without fields takes no bytes, and so a short message could have a billion of them."""
    data = write_bag1(tmp_path / "a.bag", drive(CLOCKS["same"], steps=2)).read_bytes()
    text = b"float64 x\nfloat64 y\nfloat64 z\n"
    assert data.count(text) > 2
    (tmp_path / "b.bag").write_bytes(data.replace(text, b"#".ljust(len(text), b" ")))
    with pytest.raises(FileError, match="definition of .* cannot be used"):
        bag_import.import_bag(tmp_path / "b.bag", tmp_path / "out")


def test_a_budget_counts_streams_behind_one_another(tmp_path):
    budget = bag_opening.Budget(tmp_path, 0)
    packed = bz2.compress(b"x" * 100)
    assert budget.unpack(bz2.BZ2Decompressor, packed * 3) == b"x" * 300
    with pytest.raises(FileError, match="cut off"):
        budget.unpack(bz2.BZ2Decompressor, packed[:-4])


def test_tables_have_what_was_added():
    table = bag_tables.BagTable(2, 1)
    table.add((1, 2), (0.5,))
    table.add((3, 4), (1.5,))
    assert table.whole.tolist() == [[1, 2], [3, 4]] and table.numbers.tolist() == [[0.5], [1.5]] and table.size == 48

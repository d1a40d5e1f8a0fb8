"""ROS messages and bags: every field by three readers, frames and maps against numpy, people and robots of bags."""

import contextlib
import dataclasses
import json
import math
import os
import shutil
import socket
import subprocess
import sys
import xmlrpc.client
from pathlib import Path
from time import monotonic, sleep

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sean_jax
from sean_jax import sensors
from sean_jax.cli import command_line
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.io.trajectories import load_trajectory
from sean_jax.people import recordings
from sean_jax.ros import bag_episodes, bag_import, bag_tables, bag_writing, messages
from sean_jax.simulation.scenario import snapshot
from sean_jax.studies.calibration.windows import find
from sean_jax.studies.prediction import read_windows
from sean_jax.world import environment, ros_map
from support.bags import write_bag1
from support.scenes import box, room

pytest.importorskip("rosbags")
DEBIAN = Path("/usr/bin/python3")
STEPS = 3
START = messages.SECOND


def has_debian_rosbag() -> bool:
    return DEBIAN.exists() and subprocess.run([DEBIAN, "-c", "import rosbag"], capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def scenario(scenario):
    """The scenario that all tests share, with sensors; the episode is simulated without them."""
    depth = sensors.depth_sensor(sensors.camera(scenario, "depth", width=8, height=6))
    color = sensors.color_sensor(sensors.camera(scenario, "first_person", width=8, height=6))
    lidar = sensors.lidar_sensor(sensors.lidar(scenario, count=24))
    rings = sensors.lidar(scenario, count=24, far=20.0, elevations=np.deg2rad([-5.0, 0.0, 5.0]))
    rings = sensors.lidar_sensor(rings, name="rings")
    told = {"min_distance_to_goal", "min_distance_to_people", *messages._COUNTS.values()}
    few = tuple((name, metric) for name, metric in scenario.metrics if name in told)
    return dataclasses.replace(scenario, sensors=(lidar, depth, color, rings), metrics=few)


@pytest.fixture(scope="module")
def states(scenario):
    """Some states of an episode and the quantities of each on the host; what sensors but the lidar read is random."""
    random, (lidar, depth, color, rings) = np.random.default_rng(7), scenario.sensors
    draws = {
        "depth": lambda: np.minimum(random.uniform(0.3, 2 * depth.read.device.far, (6, 8)), depth.read.device.far),
        "first_person": lambda: random.uniform(0.0, 1.0, (6, 8, 3)),
        "rings": lambda: np.minimum(random.uniform(0.5, 30.0, (3, 24)), rings.read.device.far),
    }
    assert list(draws) == [depth.name, color.name, rings.name]
    seeing = dataclasses.replace(scenario, sensors=(lidar,))
    advance, quantities = jax.jit(sean_jax.step), jax.jit(messages.step)
    bare, command, found = dataclasses.replace(scenario, sensors=()), jnp.asarray([0.4, 0.3]), []
    state = jax.jit(sean_jax.reset)(bare, jax.random.key(3))
    for _ in range(STEPS):
        state = advance(bare, state, command)
        step = quantities(seeing, state, command)
        more = {name: draw().astype(np.float32) for name, draw in draws.items()}
        found.append(jax.device_get((state, dataclasses.replace(step, readings=step.readings | more))))
    return found


def time_of(step, scenario) -> int:
    return START + round(int(step.tick) * scenario.time_step * 1e9)


@pytest.fixture(scope="module", params=["ros", "sean"])
def bag(request, scenario, states, tmp_path_factory):
    """Bags of the states, and the messages in them: (folder, table, [(time, topic, message)])."""
    folder, rows = tmp_path_factory.mktemp(request.param), []
    table = messages.topics(scenario, request.param, 7)
    with bag_writing.Bag(folder, "walk", table) as writer:
        for number, (_, step) in enumerate(states):
            time = time_of(step, scenario)
            for latched in (True, False) if number == 0 else (False,):
                content = messages.messages(table, step, time, latched)
                writer.write(content, time)
                rows += [(time, name, message) for name, message in content.items()]
    assert writer.count == 2 * len(rows)
    return folder, table, rows


def plain(value):
    """A message as JSON holds it; numbers that are not finite as text."""
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, bytes | bytearray):
        return list(value)
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(each) for each in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, np.generic):
        value = value.item()
    return value if not isinstance(value, float) or math.isfinite(value) else str(value)


def differences(ours, theirs, path=""):
    """Paths at which a message differs from a decoded object or dict; fields that only the object has are empty."""
    if isinstance(ours, dict):
        found = []
        for name, value in ours.items():
            get = theirs.get if isinstance(theirs, dict) else lambda name, default=None: getattr(theirs, name, default)
            aliases = {"sec": "secs", "nanosec": "nsecs"}
            other = next((o for o in map(get, (name, name.upper(), aliases.get(name, name))) if o is not None), None)
            found += differences(value, other, f"{path}.{name}")
        return found
    if isinstance(ours, np.ndarray) and ours.dtype.kind in "iu":  # a map or a picture
        theirs = list(theirs) if isinstance(theirs, bytes | bytearray) else theirs
        return [] if np.array_equal(ours, np.asarray(theirs)) else [f"{path}: other numbers"]
    ours = plain(ours)
    if isinstance(ours, list):
        theirs = list(theirs) if not isinstance(theirs, bytes | bytearray) else list(theirs)
        if len(ours) != len(theirs):
            return [f"{path}: {len(ours)} {len(theirs)}"]
        if ours and isinstance(ours[0], dict):
            return [each for a, b in zip(ours, theirs, strict=True) for each in differences(a, b, path)]
        theirs = [plain(each) for each in theirs]
    theirs = plain(theirs) if not isinstance(ours, list) else theirs
    same = ours == theirs or np.allclose(
        np.array(ours, float), np.array(theirs, float), rtol=1e-6, atol=1e-7, equal_nan=True
    ) if not isinstance(ours, str) else ours == theirs  # fmt: skip
    return [] if same else [f"{path}: {ours!r:.60} {theirs!r:.60}"]


def compare(rows, read):
    """Every message of a bag with every message read: (time, topic, object)."""
    read = list(read)
    assert len(read) == len(rows)
    by_place = {(time, topic): message for time, topic, message in read}
    assert len(by_place) == len(rows)
    for time, topic, message in rows:
        assert not (wrong := differences(message, by_place[time, topic])), f"{topic}: {wrong}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["walk.bag", "walk"])
def test_rosbags_reads_every_field(bag, name):
    from rosbags.highlevel import AnyReader

    folder, table, rows = bag
    with AnyReader([folder / name]) as reader:
        assert {topic: info.msgtype for topic, info in reader.topics.items()} == {k: t.type for k, t in table.items()}
        compare(
            rows, [(time, each.topic, reader.deserialize(raw, each.msgtype)) for each, time, raw in reader.messages()]
        )


def test_mcap_reads_every_field(bag):
    reading = pytest.importorskip("mcap.reader")
    ros2 = pytest.importorskip("mcap_ros2.decoder")
    folder, _, rows = bag
    with (folder / "walk" / "walk.mcap").open("rb") as stream:
        reader = reading.make_reader(stream, decoder_factories=[ros2.DecoderFactory()])
        compare(
            rows, [(m.log_time, channel.topic, content) for _, channel, m, content in reader.iter_decoded_messages()]
        )


def records(data):
    """The records of a bag of rosbag 1, or of a chunk in it: (fields of the header, content)."""
    at = 0
    while at < len(data):
        parts = []
        for _ in range(2):
            length = int.from_bytes(data[at : at + 4], "little")
            parts.append(data[at + 4 : at + 4 + length])
            at += 4 + length
        yield fields(parts[0]), parts[1]


def fields(header):
    """The fields of a header."""
    at, found = 0, {}
    while at < len(header):
        length = int.from_bytes(header[at : at + 4], "little")
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        found[name.decode()] = value
        at += 4 + length
    return found


def test_the_definitions_in_a_bag_decode_every_field(bag):
    """Rosbag 1 record by record, decoded by mcap's package for ROS 1 with the definitions that the bag has."""
    ros1, records_of_mcap = pytest.importorskip("mcap_ros1.decoder"), pytest.importorskip("mcap.records")
    folder, _, rows = bag
    head, _, data = (folder / "walk.bag").read_bytes().partition(b"\n")
    assert head == b"#ROSBAG V2.0"
    factory, decoders, read = ros1.DecoderFactory(), {}, []
    for outer, content in records(data):
        if outer["op"] != b"\x05":  # a chunk
            continue
        assert outer["compression"] == b"none"
        for header, body in records(content):
            if header["op"] == b"\x07":  # a connection
                about = fields(body)
                schema = records_of_mcap.Schema(
                    id=len(decoders), encoding="ros1msg", name=about["type"].decode(), data=about["message_definition"]
                )
                decoders[header["conn"]] = header["topic"].decode(), factory.decoder_for("ros1", schema)
            elif header["op"] == b"\x02":  # a message
                topic, decode = decoders[header["conn"]]
                second, nanosecond = np.frombuffer(header["time"], "<u4").tolist()
                read.append((second * 10**9 + nanosecond, topic, decode(body)))
    compare(rows, read)


DUMP = """
import json, math, sys, rosbag
def plain(value):
    if hasattr(value, "__slots__") and not hasattr(value, "secs"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if hasattr(value, "secs"):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
with rosbag.Bag(sys.argv[1]) as bag:
    rows = [[time.to_nsec(), topic, plain(message)] for topic, message, time in bag.read_messages()]
    latched = [c.topic for c in bag._get_connections() if c.header.get("latching") == b"1"]
print(json.dumps([rows, latched]))
"""


@pytest.mark.skipif(not has_debian_rosbag(), reason="Debian's python3-rosbag is not installed")
def test_debian_rosbag_reads_every_field(bag):
    folder, table, rows = bag
    run = subprocess.run([DEBIAN, "-c", DUMP, folder / "walk.bag"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    read, latched = json.loads(run.stdout)
    compare(rows, [(time, topic, message) for time, topic, message in read])
    assert sorted(set(latched)) == sorted(name for name, topic in table.items() if topic.latched)


def test_messages_are_the_state(scenario, states):
    table = messages.topics(scenario)
    for state, step in states:
        now = time_of(step, scenario)
        content = {**messages.messages(table, step, now, True), **messages.messages(table, step, now)}
        assert content["/clock"]["clock"]["sec"] * 10**9 + content["/clock"]["clock"]["nanosec"] == now
        pose = content["/odom"]["pose"]["pose"]
        yaw = math.atan2(*state.robot.heading[::-1])
        assert np.allclose([pose["position"]["x"], pose["position"]["y"]], state.robot.position)
        turn = Rotation.from_quat([pose["orientation"][axis] for axis in "xyzw"]).as_euler("xyz")
        assert np.allclose(turn, [0, 0, yaw], atol=1e-6)
        linked = {each["child_frame_id"]: each["header"]["frame_id"] for each in content["/tf"]["transforms"]}
        assert linked == {"odom": "map", "base_link": "odom"}
        names = {each["child_frame_id"] for each in content["/tf_static"]["transforms"]}
        assert names == {"lidar", "rings", "depth_optical_frame", "first_person_optical_frame"}
        scan, readings = content["/scan"], step.readings
        points, ring = sensors.point_cloud(scenario.sensors[3].read.device, np.asarray(readings["rings"]))
        rows = np.frombuffer(content["/rings/points"]["data"].tobytes(), [("xyz", "<f4", 3), ("ring", "<u2")])
        assert len(rows) > 20 and np.allclose(rows["xyz"], points, atol=1e-4) and np.array_equal(rows["ring"], ring)
        far = scenario.sensors[0].read.device.far
        expected = np.where(np.asarray(readings["lidar"]) >= np.float32(far), np.inf, np.asarray(readings["lidar"]))
        assert np.allclose(scan["ranges"], expected, atol=1e-5)
        assert np.isclose(scan["angle_min"] + 23 * scan["angle_increment"], scan["angle_max"])
        depth = np.frombuffer(content["/depth/image_raw"]["data"].tobytes(), "<f4").reshape(6, 8)
        near = np.isfinite(depth)
        assert np.array_equal(near, readings["depth"] < scenario.sensors[1].read.device.far) and 0 < near.sum() < 48
        assert np.allclose(depth[near], np.asarray(readings["depth"])[near], atol=1e-4)
        color = np.asarray(content["/first_person/image_raw"]["data"]).reshape(6, 8, 3)
        assert np.allclose(color, 255 * np.asarray(readings["first_person"]), atol=0.5 + 1e-3)
        people = content["/people"]["people"]
        assert len(people) == int(state.pedestrians.present.sum())
        assert content["/goal"]["pose"]["position"]["x"] == pytest.approx(float(state.task.goal[0]))
        assert content["/cmd_vel"]["angular"]["z"] == pytest.approx(0.3)


def test_scan_hits_are_where_walls_and_people_are(scenario, states):
    """Each hit of the scan, moved by the transforms of the messages alone, lies on an obstacle or on a person."""
    table = messages.topics(scenario)
    for _, step in states:
        content = {**messages.messages(table, step, START, True), **messages.messages(table, step, START)}
        scan = content["/scan"]
        angle = scan["angle_min"] + scan["angle_increment"] * np.arange(len(scan["ranges"]))
        hit = np.isfinite(scan["ranges"])
        points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)[hit] * scan["ranges"][hit, None]
        chain = [*content["/tf_static"]["transforms"], *content["/tf"]["transforms"][::-1]]
        for part in [each for each in chain if each["child_frame_id"] in ("lidar", "base_link", "odom")]:
            turn, origin = part["transform"]["rotation"], part["transform"]["translation"]
            points = Rotation.from_quat([turn[axis] for axis in "xyzw"]).apply(points) + list(origin.values())
        walls = np.abs(signed_distances_on_host(scenario.environment, points[:, :2])[0])
        gaps = np.linalg.norm(points[:, None, :2] - np.asarray(step.people.position)[None], axis=-1)
        assert hit.sum() > 3
        assert (np.minimum(walls, np.abs(gaps - 0.2).min(1)) < 0.12).mean() > 0.85  # shelves are decoration


def test_optical_frames_look_along_the_view(scenario):
    step, table = None, messages.topics(scenario)
    transforms = table["/tf_static"].message(step, 0)["transforms"]
    cameras = [each for each in transforms if each["child_frame_id"].endswith("_optical_frame")]
    assert len(cameras) == 2
    for each in cameras:
        axes = Rotation.from_quat([each["transform"]["rotation"][axis] for axis in "xyzw"]).as_matrix()
        assert axes[0, 2] > 0.9  # z of the optical frame ahead
        assert axes[1, 0] == pytest.approx(-1.0, abs=1e-6)  # x to the right
        assert axes[2, 1] < -0.9  # y down


def test_depth_of_the_floor_lies_on_the_floor():
    """Pixels by camera_info alone, moved by the transforms of the messages, are at height 0."""
    lab = sean_jax.make("lab", behavior="random", people=0, dynamics="twin", metrics="none")
    depth = sensors.depth_sensor(sensors.camera(lab, "depth", width=40, height=30))
    scenario = dataclasses.replace(lab, sensors=(depth,))
    state = jax.jit(sean_jax.reset)(lab, jax.random.key(1))
    step = jax.device_get(jax.jit(messages.step)(scenario, state, jnp.zeros(2)))
    table = messages.topics(scenario)
    content = {**messages.messages(table, step, START, True), **messages.messages(table, step, START)}
    about = content["/depth/camera_info"]
    values = np.frombuffer(content["/depth/image_raw"]["data"].tobytes(), "<f4").reshape(30, 40).astype(float)
    rows, columns = np.nonzero(np.isfinite(values))
    pixels = np.stack([columns, rows, np.ones(len(rows))])  # middles of pixels, as ROS counts them
    points = (np.linalg.inv(about["k"].reshape(3, 3)) @ pixels * values[rows, columns]).T
    np.testing.assert_array_equal(about["p"].reshape(3, 4)[:, :3], about["k"].reshape(3, 3))
    (mount,) = content["/tf_static"]["transforms"]
    turn, origin = mount["transform"]["rotation"], mount["transform"]["translation"]
    height = (Rotation.from_quat([turn[axis] for axis in "xyzw"]).apply(points) + list(origin.values()))[:, 2]
    assert (np.abs(height) < 1e-6).sum() > 200 and height.min() > -1e-6


def test_plan_is_the_shortest_path(scenario, states):
    plan, way = messages.topics(scenario)["/plan"], jax.jit(sean_jax.world.navigation.geodesic)
    for state, step in states:
        poses = plan.message(step, 0)["poses"]
        points = np.array([[each["pose"]["position"][axis] for axis in "xy"] for each in poses])
        legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
        task = state.task
        length = way(scenario.navigation, state.robot.position, task.goal, task.paths_to_goal)
        assert np.allclose(points[0], state.robot.position, atol=1e-6)
        assert np.allclose(points[-1], task.goal, atol=1e-6)
        assert legs.max() <= messages.SPACING + 1e-6
        assert float(length) - 1e-3 <= legs.sum() <= 1.02 * float(length) + 0.02


def test_point_cloud_keeps_points():
    points = np.random.default_rng(0).normal(size=(17, 3)).astype(np.float32)
    points[3] = np.nan
    cloud = messages.point_cloud(points, np.arange(17), "velodyne", 5)
    rows = np.frombuffer(cloud["data"].tobytes(), [("xyz", "<f4", 3), ("ring", "<u2")])
    assert np.array_equal(rows["xyz"], points, equal_nan=True) and np.array_equal(rows["ring"], np.arange(17))
    assert not cloud["is_dense"]
    store = messages.typestore(2)
    assert store.serialize_cdr(
        messages.fill(store, "sensor_msgs/msg/PointCloud2", cloud), "sensor_msgs/msg/PointCloud2"
    )


def test_unknown_fields_are_refused():
    store = messages.typestore(1)
    with pytest.raises(ValueError, match="lenght"):
        messages.fill(store, "geometry_msgs/msg/Point", {"x": 1.0, "lenght": 2.0})


# ------------------------------------------------------------------ maps


def test_map_is_where_obstacles_are():
    random = np.random.default_rng(1)
    boxes = np.column_stack([
        random.uniform(1, 9, (30, 2)), random.uniform(0.05, 1.0, (30, 2)), random.uniform(-4, 4, 30),
        random.uniform(0.1, 3.0, 30),
    ])  # fmt: skip
    settings = environment.Settings(name="swept", floor=(0.0, 0.0, 10.0, 8.3), people=1)
    place = environment.of_boxes(settings, boxes)
    for resolution, height in ((0.05, 0.0), (0.17, 1.0), (0.5, 2.5)):
        raster = ros_map.of_environment(place, resolution, height)
        rows, columns = raster.occupied.shape
        x, y = np.meshgrid((np.arange(columns) + 0.5) * resolution, (np.arange(rows) + 0.5) * resolution)
        inside, near = np.zeros_like(x, bool), np.zeros_like(x, bool)
        for cx, cy, hx, hy, yaw in boxes[boxes[:, 5] >= height, :5]:
            turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
            gap = (
                np.abs(np.einsum("ij,jrc->irc", turned, np.stack([x - cx, y - cy]))) - np.array([hx, hy])[:, None, None]
            )
            inside |= gap.max(0) < 0
            near |= np.abs(gap.max(0)) < 1e-4
        assert ((raster.occupied == inside) | near).all()
        assert inside.any()


@pytest.mark.parametrize("resolution", [0.05, 0.1, 0.25])
def test_exported_map_comes_back_exactly(tmp_path, resolution):
    first = ros_map.export_map(environment.load("lab"), tmp_path / "a.yaml", resolution)
    assert np.array_equal(ros_map.read_map(tmp_path / "a.yaml").occupied, first.occupied)
    ros_map.import_map(tmp_path / "a.yaml", tmp_path / "place")
    ros_map.export_map(environment.load(tmp_path / "place"), tmp_path / "b.yaml", resolution)
    assert (tmp_path / "a.pgm").read_bytes() == (tmp_path / "b.pgm").read_bytes()


def test_tall_map_has_less_than_short_map(tmp_path):
    short, tall = (ros_map.of_environment(environment.load("warehouse"), 0.1, height) for height in (0.0, 1.0))
    assert tall.occupied.sum() < short.occupied.sum() and not (tall.occupied & ~short.occupied).any()


def test_map_mistakes_are_sentences(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for words in (
        ["lab", "--out", "map.png"],
        ["lab", "--out", "map.yaml", "--resolution", "0.0011"],
        ["lab", "--out", "map.yaml", "--height", "-1"],
        ["labb", "--out", "map.yaml"],
    ):
        assert command_line.main(["export", "map", *words]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


# ------------------------------------------------------------------ bags in


def test_import_gives_back_positions_and_situations(bag, scenario, states, tmp_path):
    folder, table, _ = bag
    for name in ("walk.bag", "walk", "walk/walk.mcap"):
        out = tmp_path / name.replace("/", "-")
        result = bag_import.import_bag(folder / name, out)
        assert (result.frames, result.robot, result.frame) == (STEPS, True, "map")
        assert result.people == states[0][0].pedestrians.present.sum()
        frames = load_trajectory(out / bag_import.ROBOT)
        expect = lambda get: np.stack([np.asarray(get(state), float) for state, _ in states])  # noqa: E731
        assert np.allclose(frames.position, expect(lambda s: s.robot.position), atol=1e-6)
        assert np.allclose(frames.heading, expect(lambda s: s.robot.heading), atol=1e-6)
        assert np.allclose(frames.velocity, expect(lambda s: s.robot.speed * s.robot.heading), atol=1e-6)
        assert np.allclose(frames.people, expect(lambda s: s.pedestrians.position), atol=1e-6)
        assert np.allclose(frames.people_velocity, expect(lambda s: s.pedestrians.velocity), atol=1e-6)
        assert np.allclose(frames.people_heading, expect(lambda s: s.pedestrians.heading), atol=1e-5)
        assert np.allclose(frames.goal, expect(lambda s: s.task.goal), atol=1e-6)
        assert np.allclose(frames.action, [0.4, 0.3], atol=1e-6)
        tracks = recordings.read(out / bag_import.PEOPLE, frame_rate=100.0)
        assert np.allclose(tracks.position, expect(lambda s: s.pedestrians.position), atol=1e-6)
        if "/social_sim/metrics" in table:
            names = sorted(each for each, _ in scenario.situations)
            order = [names.index(each) for each, _ in scenario.situations]
            assert np.array_equal(frames.situations[:, order], expect(lambda s: s.situations) > 0.5)
        else:
            assert np.array_equal(frames.group, expect(lambda s: s.pedestrians.group))


def test_situations_of_an_imported_bag_are_those_of_the_episode(bag, scenario, states, tmp_path):
    """The classifiers see the same situations in the imported frames as in the simulation."""
    folder, table, _ = bag
    bag_import.import_bag(folder / "walk", tmp_path / "in")
    frames = load_trajectory(tmp_path / "in" / bag_import.ROBOT)
    names = [name for name, _ in scenario.situations]
    apart = [names.index(name) for name in ("join_group", "leave_group") if "/social_sim/metrics" in table]
    for t, (state, _) in enumerate(states):
        people = dataclasses.replace(
            state.pedestrians,
            position=frames.people[t], velocity=frames.people_velocity[t], heading=frames.people_heading[t],
            group=frames.group[t], present=frames.present[t],
        )  # fmt: skip
        robot = dataclasses.replace(state.robot, position=frames.position[t], heading=frames.heading[t])
        again = dataclasses.replace(state, pedestrians=people, robot=robot)
        now = snapshot(scenario, jax.tree.map(lambda a, b: jnp.asarray(a, b.dtype), again, state))
        holds = np.array([bool(classify(now, scenario.thresholds)) for _, classify in scenario.situations])
        same = holds == np.asarray(state.situations)
        same[apart] = True  # SEAN's agents have no group
        assert same.all()


def quaternion(yaw: float) -> dict:
    return dict(zip("xyzw", Rotation.from_euler("z", yaw).as_quat().tolist(), strict=True))


def test_frames_of_a_robot_with_drifting_odometry(tmp_path):
    """A person who stands still in the map, seen from a moving robot by a turned sensor."""
    random, rows = np.random.default_rng(2), []
    person = np.array([4.0, -1.5])
    truth = []
    at = lambda x, y: {"x": float(x), "y": float(y), "z": 0.0}  # noqa: E731
    mount = (0.3, 0.1, 0.7)
    for k in range(8):
        time = START + k * 10**8
        head = lambda frame, time=time: {"stamp": messages.stamp(time), "frame_id": frame}  # noqa: E731
        drift, inner = random.uniform(-2, 2, 3), random.uniform(-3, 3, 3)

        def compose(a, b):
            turn = np.array([[np.cos(a[2]), -np.sin(a[2])], [np.sin(a[2]), np.cos(a[2])]])
            return np.array([*(a[:2] + turn @ b[:2]), a[2] + b[2]])

        robot = compose(drift, inner)
        truth.append(robot)
        sensor = compose(robot, np.array(mount))
        turn = np.array([[np.cos(sensor[2]), np.sin(sensor[2])], [-np.sin(sensor[2]), np.cos(sensor[2])]])
        seen = turn @ (person - sensor[:2])
        links = [("map", "odom", drift), ("odom", "base_link", inner)] + (
            [("base_link", "laser", mount)] if k == 0 else []
        )
        rows.append(("/tf", "tf2_msgs/msg/TFMessage", time, {"transforms": [
            messages.transform(parent, child, time, at(*pose[:2]), quaternion(pose[2])) for parent, child, pose in links
        ]}))  # fmt: skip
        pose = {"pose": {"position": at(*inner[:2]), "orientation": quaternion(inner[2])}}
        rows.append(
            (
                "/odom",
                "nav_msgs/msg/Odometry",
                time,
                {"header": head("odom"), "child_frame_id": "base_link", "pose": pose},
            )
        )
        each = {"name": "anna", "position": at(*seen), "velocity": at(0, 0)}
        rows.append(("/people", "people_msgs/msg/People", time, {"header": head("laser"), "people": [each]}))
    write_bag1(tmp_path / "drift.bag", rows)
    (episode,) = bag_episodes.split_at_resets(bag_tables.read_bag(tmp_path / "drift.bag")).episodes
    frames = bag_import.as_trajectory(episode, 0.1)
    truth = np.array(truth)
    assert np.allclose(frames.position, truth[:, :2], atol=1e-9)
    assert np.allclose(np.exp(1j * truth[:, 2]), frames.heading @ [1, 1j], atol=1e-9)
    assert np.allclose(frames.people[:, 0], person, atol=1e-9)


@pytest.mark.parametrize("kind", ["PoseArray", "MarkerArray"])
def test_other_messages_of_people_and_gaps(tmp_path, kind):
    rows, gone = [], range(5, 40)
    for k in range(45):
        time, pose = START + k * 10**8, {"position": {"x": 0.1 * k, "y": 1.0, "z": 0.0}, "orientation": quaternion(0.0)}
        header = {"stamp": messages.stamp(time), "frame_id": "map"}
        if kind == "PoseArray":
            message = {"header": header, "poses": [] if k in gone else [pose]}
        else:
            marker = {"header": header, "ns": "person", "id": 3, "type": 3, "action": 0, "pose": pose}
            message = {"markers": [] if k in gone else [marker]}
        type_name = f"{'geometry' if kind == 'PoseArray' else 'visualization'}_msgs/msg/{kind}"
        rows.append(("/detected_people", type_name, time, message))
    write_bag1(tmp_path / "people.bag", rows)
    result = bag_import.import_bag(tmp_path / "people.bag", tmp_path / "out")
    assert not result.robot and sorted(each.name for each in result.folder.iterdir()) == [bag_import.PEOPLE]
    tracks = recordings.read(result.folder / bag_import.PEOPLE, frame_rate=100.0)
    assert np.array_equal(np.flatnonzero(~np.asarray(tracks.present[:, 0])), list(gone))
    assert np.allclose(np.asarray(tracks.position)[:5, 0, 0], 0.1 * np.arange(5))


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """A folder with a square and a bag of two people who walk past a robot; the bag's velocities are zeros."""
    folder, rows = tmp_path_factory.mktemp("walks"), []
    room(folder / "square", (-9, -9, 9, 9), [box((0, -3), (0.5, 0.5), height=1.0)], 2)
    at = lambda x, y: {"x": float(x), "y": float(y), "z": 0.0}  # noqa: E731
    for k in range(101):
        time = START + k * 10**8
        head = {"stamp": messages.stamp(time), "frame_id": "map"}
        people = [{"name": name, "position": at(*walk(k / 10, name))} for name in "ab"]
        pose = {"pose": {"position": at(0.02 * k, -1), "orientation": quaternion(0.0)}}
        odometry = {"header": head, "child_frame_id": "base_link", "pose": pose}
        rows.append(("/people", "people_msgs/msg/People", time, {"header": head, "people": people}))
        rows.append(("/odom", "nav_msgs/msg/Odometry", time, odometry))
    write_bag1(folder / "walks.bag", rows)
    for name, step in (("tenths", 0.1), ("moments", 0.4)):
        bag_import.import_bag(folder / "walks.bag", folder / name, step)
    return folder


def walk(seconds, name):
    """The place of a person of ``walks``."""
    return (-6 + 1.2 * seconds, 0.0) if name == "a" else (5 - 0.9 * seconds, 2.0)


def test_people_of_a_bag_are_recordings_for_prediction(walks):
    """In both clocks of the windows; people who keep their velocity are predicted without error."""
    prediction, corridors = find(walks / "moments")
    assert list(prediction) == ["people"] and not corridors
    for clock in ("social_gan", "recorded"):
        windows = read_windows(walks / "moments" / bag_import.PEOPLE, clock)
        position = np.asarray(windows.position)  # (B, T, N, 2), 0.4 s apart
        assert position.shape[1:] == (20, 2, 2) and np.asarray(windows.present).all()
        np.testing.assert_allclose(np.diff(position, axis=1)[..., 0], [[[0.48, -0.36]] * 19] * len(position), atol=1e-6)
    text = (walks / "tenths" / bag_import.PEOPLE).read_text().splitlines()
    assert text[0].split(",")[4:6] == ["vx_mps", "vy_mps"] and text[1].startswith("0,0,-6.0,0.0,")
    np.testing.assert_allclose([float(each) for each in text[1].split(",")[4:6]], [1.2, 0.0], atol=1e-6)


@pytest.mark.night
def test_people_of_a_bag_are_played_back_measured_calibrated_on_and_shown(walks, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    people, rate = str(walks / "tenths" / bag_import.PEOPLE), ("--frame-rate", "100")
    run = ["run", "--environment", str(walks / "square"), "--behavior", "playback", "--task", "random_ab_nav", *rate]
    run += ["--recording", people, "--time-limit", "3", "--episodes", "1", "--trajectories", "csv", "--quiet"]
    assert command_line.main([*run, "--out", "run"]) == 0
    frames = load_trajectory("run/trajectories.csv")
    place = np.asarray(frames.people)[0]
    x = np.take_along_axis(place[..., 0], place[..., 1].argsort(-1), -1)  # of a, who walks along y = 0, and of b
    begin = (x[0, 0] + 6) / 1.2  # s of the recording
    times = begin + 0.1 * np.arange(len(x))
    np.testing.assert_allclose(x, np.stack([-6 + 1.2 * times, 5 - 0.9 * times], -1), atol=1e-3)
    study = ["experiment", "table1", "--policies", "none", "--recordings", people, *rate, "--quiet", "--out", "table1"]
    assert command_line.main([*study, "--speeds", "1.4"]) == 0
    rows = Path("table1/recordings.csv").read_text().splitlines()
    assert len(rows) > 3 and all(row.startswith("people,") for row in rows[1:])
    fit = ["calibrate", "--data", str(walks / "moments"), "--fit", "none", "--generations", "1", "--population", "4"]
    assert command_line.main([*fit, "--leave-out", "none", "--quick", "--quiet", "--out", "fit"]) == 0
    scores = json.loads(Path("fit/results.json").read_text())["scores"]["people (social_gan)"]
    assert scores["constant velocity"]["ade"] < 1e-5  # m
    sean_jax.view(load_trajectory(walks / "tenths" / bag_import.ROBOT)).save("page.html")
    assert Path("page.html").stat().st_size > 10_000


def test_bad_bags_are_sentences_and_write_nothing(bag, tmp_path, monkeypatch, capsys):
    folder, _, _ = bag
    monkeypatch.chdir(tmp_path)
    whole = (folder / "walk.bag").read_bytes()
    random = np.random.default_rng(4)
    for number in range(6):
        Path(f"cut{number}.bag").write_bytes(whole[: int(random.integers(0, len(whole) - 1))])
    Path("text.bag").write_text("no bag\n")
    write_bag1(Path("empty.bag"), [("/clock", "rosgraph_msgs/msg/Clock", START, {"clock": messages.stamp(START)})])
    before = sorted(Path().iterdir())
    for name in (*map(str, before), "missing.bag", "."):
        assert command_line.main(["import-bag", name, "--out", "new"]) == 2, name
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    for words in (["--people-topic", "/nobody"], ["--people-topic", "/clock"], ["--time-step", "0"]):
        assert command_line.main(["import-bag", str(folder / "walk.bag"), "--out", "new", *words]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert sorted(Path().iterdir()) == before


# ------------------------------------------------------------------ the commands


@pytest.mark.night
def test_bags_of_a_run(tmp_path, monkeypatch, capsys):
    """Bags of a run hold the frames of the run; a broken export leaves nothing."""
    monkeypatch.chdir(tmp_path)
    run = ["run", "--environment", "lab", "--people", "4", "--time-limit", "5", "--episodes", "2", "--out", "run"]
    assert command_line.main([*run, "--trajectories", "csv", "--quiet"]) == 0
    assert command_line.main(["export", "bag", "run", "--episodes", "1", "0", "--out", "bags", "--quiet"]) == 0
    recorded = load_trajectory("run/trajectories.csv")
    for number in (0, 1):
        for name in (f"bags/episode_{number}.bag", f"bags/episode_{number}"):
            out = Path(f"in-{Path(name).name}")
            bag_import.import_bag(name, out)
            frames, length = load_trajectory(out / bag_import.ROBOT), int(recorded.active[number].sum())
            assert len(frames.position) == length
            for field in ("position", "heading", "velocity", "people", "people_velocity", "action"):
                ours, theirs = getattr(frames, field), getattr(recorded, field)[number][:length]
                assert np.allclose(ours, theirs, atol=2e-4), field
    monkeypatch.setattr(
        bag_writing.Bag, "write", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device"))
    )
    assert command_line.main(["export", "bag", "run", "--out", "broken", "--quiet"]) != 0
    assert not Path("broken").exists()
    assert command_line.main(["export", "bag", "run", "--out", "broken", "--episodes", "2", "--quiet"]) == 2
    assert command_line.main(["export", "bag", "run", "--out", "broken", "--sensors", "sonar", "--quiet"]) == 2
    assert not Path("broken").exists()


@pytest.mark.night
def test_killed_export_leaves_nothing_half_written(tmp_path):
    run = ["run", "--environment", "lab", "--people", "4", "--time-limit", "60", "--episodes", "1", "--quiet"]
    assert command_line.main([*run, "--out", str(tmp_path / "run")]) == 0
    words = ["export", "bag", str(tmp_path / "run"), "--out", str(tmp_path / "bags")]
    process = subprocess.Popen([sys.executable, "-m", "sean_jax", *words])
    unfinished = tmp_path / ".bags.unfinished"
    while process.poll() is None and not any(unfinished.glob("whole/episode_0.bag")):
        pass
    process.kill()
    process.wait()
    assert not (tmp_path / "bags").exists()
    assert command_line.main([*words, "--quiet"]) == 0
    assert len(bag_tables.read_bag(tmp_path / "bags" / "episode_0.bag").people) and not unfinished.exists()


# ------------------------------------------------------------------ rviz


def screen(path: Path) -> np.ndarray:
    """The picture of Xvfb's file, as integers (H, W, 3): a header of big-endian words, then rows of B, G, R, unused."""
    content = path.read_bytes()
    words = np.frombuffer(content, ">u4", 25)
    width, height, stride = words[4], words[5], words[12]
    pixels = np.frombuffer(content, np.uint8, height * stride, words[0] + 12 * words[19])
    return pixels.reshape(height, -1, 4)[:, :width, 2::-1].astype(int)


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.skipif(
    not all(map(shutil.which, ("rviz", "Xvfb", "rosmaster", "rosbag"))),
    reason="Debian's rviz, xvfb, python3-rosmaster and python3-rosbag are not installed",
)
def test_rviz_draws_a_bag(scenario, states, tmp_path):
    """Map, scan, robot, people and goal have their colors in the picture that rviz draws with view.rviz."""
    with bag_writing.Bag(tmp_path, "walk", messages.topics(scenario)) as writer:
        for number, (_, step) in enumerate(states):
            moment = time_of(step, scenario)
            for latched in (True, False) if number == 0 else (False,):
                writer.write(messages.messages(writer.table, step, moment, latched), moment)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    variables = {
        "PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path), "ROS_MASTER_URI": address,
        "ROS_IP": "127.0.0.1", "ROS_HOSTNAME": "127.0.0.1", "LIBGL_ALWAYS_SOFTWARE": "1",
    }  # fmt: skip
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    processes, end = [], monotonic() + 120.0

    def start(*words, **options):
        processes.append(subprocess.Popen([*map(str, words)], env=variables, **quiet, **options))

    def wait(condition, problem):
        while not condition():
            assert monotonic() < end, problem
            sleep(0.2)

    def subscribed() -> bool:
        with contextlib.suppress(OSError):
            topics = {name for name, _ in master.getSystemState("/test")[2][1]}
            return {"/map", "/markers", "/scan", "/tf"} <= topics
        return False

    def clock_is_set() -> bool:
        with contextlib.suppress(OSError):
            return master.setParam("/test", "/use_sim_time", True)[0] == 1
        return False

    master = xmlrpc.client.ServerProxy(address)
    red_green_blue = {name: np.round(255 * np.array(color[:3])) for name, color in messages.COLORS.items()}
    *green, alpha = messages.COLORS["goal"]
    goal = np.round(250 * (1.0 - alpha) + 255 * alpha * np.array(green))  # on the white of rviz's map
    wanted = {  # color and least number of pixels; the map's is rviz's own
        "map": ((72, 72, 72), 5_000), "scan": ((220, 30, 40), 60), "robot": (red_green_blue["robot"], 30),
        "people": (red_green_blue["people"], 150), "goal": (goal, 1_000),
    }  # fmt: skip
    pixels = {}

    def drawn() -> bool:
        picture = screen(tmp_path / "Xvfb_screen0")
        for name, (color, _) in wanted.items():
            pixels[name] = int((np.abs(picture - color).max(-1) <= 2).sum())
        return all(pixels[name] >= least for name, (_, least) in wanted.items())

    try:
        reader, writer_end = os.pipe()
        size = ("-screen", "0", "1000x800x24", "-fbdir", tmp_path, "-nolisten", "tcp")
        start("/usr/bin/Xvfb", "-displayfd", writer_end, *size, pass_fds=[writer_end])
        os.close(writer_end)
        with os.fdopen(reader) as display:
            variables["DISPLAY"] = f":{display.readline().strip()}"
        start("/usr/bin/rosmaster", "--core", "-p", port)
        wait(clock_is_set, "the master does not answer")
        view = (Path(bag_writing.__file__).parent / "view.rviz").read_text(encoding="utf-8")
        assert "Scale: 75\n" in view
        (tmp_path / "view.rviz").write_text(
            view.replace("Scale: 75\n", "Scale: 40\n"), encoding="utf-8"
        )  # all of the lab
        start("/usr/bin/rviz", "-d", tmp_path / "view.rviz")
        wait(subscribed, "rviz does not subscribe")
        start("/usr/bin/rosbag", "play", "--clock", "--keep-alive", "--quiet", tmp_path / "walk.bag")
        wait(drawn, pixels)
    finally:
        for process in reversed(processes):
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def test_missing_package_is_a_sentence(monkeypatch):
    monkeypatch.setattr(bag_writing.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"sean_jax\[ros\]"):
        bag_writing.check_package()

"""A live robot: what comes in is checked and bounded, and what goes out reaches rosbridge's and DDS's real clients."""

import asyncio
import contextlib
import csv
import json
import math
import os
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace

import jax
import numpy as np
import pytest
from rich.console import Console

import sean_jax
from sean_jax import evaluation, sensors
from sean_jax.config import BridgeConfig, Named, RunConfig, outside, validate
from sean_jax.core.errors import ControllerError, InputError
from sean_jax.evaluation import results
from sean_jax.evaluation.batches import Totals
from sean_jax.learning.policy import check_policy
from sean_jax.ros import bridge, messages, ros1, rosbridge
from sean_jax.ros.names import RosNames
from sean_jax.ros.transport import REQUESTS, Mailbox, Output, TransportLog, read_pose
from sean_jax.simulation.scenario_stack import as_stacks
from sean_jax.web import local_server
from support.commands import python, wait

pytest.importorskip("websockets")
from websockets.asyncio.client import connect  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402

OUTPUTS = {
    "/odom": Output("nav_msgs/msg/Odometry", False),
    "/scan": Output("sensor_msgs/msg/LaserScan", False),
    "/goal": Output("geometry_msgs/msg/PoseStamped", True),
    "/clock": Output("rosgraph_msgs/msg/Clock", False),
}
LIMIT = 20.0  # s, for anything that has to happen


def twist(ahead, turn):
    return {"linear": {"x": ahead, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": turn}}


class Sentences(list):
    """The sentences of a log."""

    def __call__(self, sentence):
        self.append(sentence)


@pytest.fixture
def sentences():
    return Sentences()


@pytest.fixture
def mailbox(sentences):
    return Mailbox(TransportLog(sentences))


@pytest.fixture
def server(mailbox):
    server = rosbridge.Server("127.0.0.1:0", mailbox, OUTPUTS)
    yield server
    server.close()


# ------------------------------------------------------------------ names and options


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("ros1:", ("ros1", "")),
        ("rosbridge:127.0.0.1:9090", ("rosbridge", "127.0.0.1:9090")),
        ("dds:3", ("dds", "3")),
        ("ros1", None),
        ("runs/ros1:x", None),
        ("go_to_goal", None),
    ],
)
def test_a_controller_outside_is_named_by_its_transport(text, place):
    assert outside(Named(kind=text)) == place


def test_a_bridge_has_one_transport():
    for options in ({}, {"ros1": True, "dds": True}):
        with pytest.raises(InputError, match="--ros1, --rosbridge and --dds"):
            validate(BridgeConfig, options)
    assert validate(BridgeConfig, {"dds": True, "domain": 4}).place == ("dds", "4")
    assert validate(BridgeConfig, {"dds": True, "sensors": "none"}).sensors == ()


@pytest.mark.parametrize(
    ("option", "wrong"),
    [(option, wrong) for option in ("node_name", "namespace") for wrong in ("", "1", "/robot1", "a b", "a__b", "a//b")]
    + [("node_name", "a/b"), ("namespace", "robot1/"), ("naming", "mine")],
)
def test_a_wrong_name_is_refused_in_one_sentence(option, wrong):
    with pytest.raises(InputError, match=option.replace("_", ".")) as error:
        validate(BridgeConfig, {"ros1": True, option: wrong})
    assert "\n" not in str(error.value).strip()


def test_names_of_a_bridge():
    plain, robot = RosNames(), RosNames("other", "team/robot1", "sean")
    assert list(plain.services) == ["/sean_jax/reset", "/sean_jax/new_task", "/sean_jax/step"]
    assert list(robot.services) == [f"/team/robot1/other/{word}" for word in ("reset", "new_task", "step")]
    assert list(plain.inputs) == ["/cmd_vel", "/initialpose"]
    assert list(robot.inputs) == ["/team/robot1/mobile_base_controller/cmd_vel", "/team/robot1/initialpose"]
    everywhere = ("/clock", "/map", "/tf", "/tf_static")
    assert [robot.topic(name) for name in everywhere] == list(everywhere)
    assert robot.topic("/odom") == "/team/robot1/robot_odom" and robot.topic("/scan") == "/team/robot1/laser_raycast"


def test_frames_of_the_robot_are_in_the_namespace_and_the_map_is_not():
    message = {"transforms": [{"header": {"frame_id": "map"}, "child_frame_id": "odom"}], "data": np.zeros(2)}
    assert RosNames().frames(message) is message
    moved = RosNames(namespace="robot1").frames(message)
    assert moved["transforms"] == [{"header": {"frame_id": "map"}, "child_frame_id": "robot1/odom"}]
    assert moved["data"] is message["data"] and message["transforms"][0]["child_frame_id"] == "odom"


class Memory:
    """A transport that keeps what is published."""

    address = "memory"

    def __init__(self):
        self.sent = {}

    def wanted(self, topic):
        return any(word in topic for word in ("scan", "laser", "odom", "metrics")) or topic in ("/tf", "/clock")

    def publish(self, topic, message):
        self.sent[topic] = message

    def close(self):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("naming", ["ros", "sean"])
def test_a_bridge_of_a_namespace_has_its_topics_and_frames(scenario, monkeypatch, naming):
    pytest.importorskip("rosbags")
    memory, names = Memory(), RosNames("other", "robot1", naming)
    monkeypatch.setattr(bridge, "connect", lambda place, mailbox, outputs: memory)
    lidar, depth = sensors.lidar_sensor(sensors.lidar(scenario, count=24)), bridge.SENSORS["depth"](scenario.robot)
    made = bridge.Bridge(replace(scenario, sensors=(lidar, depth)), ("ros1", ""), print, names=names)
    made.begin(made.scenario, 3)
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(3))
    made.publish(state, made.no_command)
    odom, scan = memory.sent[names.topic("/odom")], memory.sent[names.topic("/scan")]
    assert odom["header"]["frame_id"] == "robot1/odom" and odom["child_frame_id"] == "robot1/base_link"
    assert scan["header"]["frame_id"] == "robot1/lidar" and len(scan["ranges"]) == 24
    pairs = [(each["header"]["frame_id"], each["child_frame_id"]) for each in memory.sent["/tf"]["transforms"]]
    assert pairs == [("map", "robot1/odom"), ("robot1/odom", "robot1/base_link")]
    assert memory.sent["/map"]["header"]["frame_id"] == "map" and list(memory.sent)[-1] == "/clock"
    assert {name for name in memory.sent if not name.startswith("/robot1/")} == {"/clock", "/map", "/tf", "/tf_static"}
    if naming == "sean":
        assert "/robot1/robot_odom" in memory.sent and "/robot1/laser_raycast" in memory.sent
        assert memory.sent["/robot1/social_sim/metrics"]["trial_number"] == 3
    made.mailbox.receive(names.topic("/cmd_vel"), twist(0.25, -0.5))
    assert made.mailbox.take_command().tolist() == [0.25, -0.5]


@pytest.mark.slow
@pytest.mark.parametrize("ros", [1, 2])
def test_the_topics_of_sean_have_types_that_each_transport_writes(scenario, ros):
    pytest.importorskip("rosbags")
    store = messages.typestore(ros)
    for topic in messages.topics(scenario, "sean").values():
        assert store.generate_msgdef(topic.type)


def finished(scenario, missed):
    """A batch of one episode, whose metrics are 1 where a run measures them."""
    one = lambda tree: jax.tree.map(lambda leaf: np.ones((1, *leaf.shape), leaf.dtype), tree)  # noqa: E731
    state = jax.eval_shape(sean_jax.reset, scenario, jax.random.key(0))
    metrics = one(jax.eval_shape(sean_jax.simulation.scenario.results, scenario, state)) | {
        evaluation.MISSED: np.array([missed])
    }
    counts = np.zeros((2, 3), np.int32)
    totals = Totals(counts, counts, counts, counts[0], np.float32(0.0), counts[0])
    yes, no, steps = np.array([True]), np.array([False]), np.array([8], np.int32)
    return evaluation.FinishedBatch(yes, no, steps, metrics, totals, [], 1.0)


@pytest.mark.parametrize(("missed", "column"), [((0, 2), ["0", "2"]), ((0, 0), None)])
def test_episodes_csv_has_a_column_of_missed_commands_if_there_are_any(scenario, tmp_path, missed, column):
    batches = [finished(scenario, number) for number in missed]
    policy = sean_jax.core.data_types.Policy(
        jax.numpy.zeros(2), "ros1:", sean_jax.core.data_types.no_memory, bridge._command
    )
    joined = evaluation._join(as_stacks(scenario), policy, batches, 2, 0, 0.0)
    results.write_episodes(tmp_path / "episodes.csv", joined)
    with open(tmp_path / "episodes.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2
    assert ([row["missed_commands"] for row in rows] if column else rows[0].get("missed_commands")) == column


@pytest.mark.parametrize("answers", [0, 1])
def test_a_controller_that_does_not_answer_is_no_result(scenario, monkeypatch, answers):
    """One that never answers, and one that dies: nothing of the episode can be written."""
    pytest.importorskip("rosbags")
    memory, left = Memory(), [True] * answers
    memory.wanted = lambda topic: topic == "/odom"  # no sensor has to be compiled
    monkeypatch.setattr(bridge, "connect", lambda place, mailbox, outputs: memory)
    for name, value in {"FIRST": 0.3, "PATIENCE": 0.01, "SILENT": 0.3, "REPEAT": 0.01}.items():
        monkeypatch.setattr(bridge, name, value)
    driver = bridge.ControllerDriver(scenario, "ros1:", ("ros1", ""), Console(quiet=True))
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(3))
    states = jax.tree.map(lambda leaf: leaf[None], state)
    publish = memory.publish

    def answer(topic, message):
        publish(topic, message)
        if topic == "/odom" and left:
            left.pop()
            driver._bridge.mailbox.receive("/cmd_vel", twist(0.1, 0.0))

    memory.publish = answer
    sentence = "sent no command for 0.3 s of episode 7, which is therefore no result; start the controller"
    with pytest.raises(ControllerError, match=sentence):
        for _ in range(5):
            driver(scenario, 7, states)
    assert not left


@pytest.mark.parametrize("pace", ["real", "lockstep", "fast", "service"])
def test_that_a_controller_has_gone_is_told_once(scenario, sentences, pace):
    live = bridge.LiveBridge.__new__(bridge.LiveBridge)
    live.config = BridgeConfig(ros1=True, pace=pace)
    live.scenarios, live._write, live._silent = [scenario], sentences, None
    third = round(bridge.SILENT / scenario.time_step)
    for commands in ([False] * 100, [True] + [False] * (third - 1), [True] + [False] * third, [False] * 100):
        before = len(sentences)
        for commanded in commands:
            live._notice(commanded)
        told = commands == [True] + [False] * third and pace in ("real", "lockstep")
        assert sentences[before:] == ["no command for 3 s; the robot stands"] * told
    live._notice(True)
    for _ in range(third):
        live._notice(False)
    assert len(sentences) == (2 if pace in ("real", "lockstep") else 0)


def test_people_are_measured_from_a_pose_if_they_are_there(scenario):
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(3))
    people = state.pedestrians
    here = np.asarray(people.position, float)[0]
    gone = state.replace(pedestrians=people.replace(present=np.zeros(len(people.present), bool)))
    there = state.replace(pedestrians=people.replace(present=np.ones(len(people.present), bool)))
    assert bridge._gap_to_people(there, here + [0.3, 0.4])[0] == pytest.approx(0.5)
    assert np.isinf(bridge._gap_to_people(gone, here)).all()


def test_only_runs_take_a_controller_outside():
    with pytest.raises(InputError, match="outside of this program"):
        check_policy("ros1:", RunConfig())


@pytest.mark.parametrize("place", ["127.0.0.1", "here:9090", "127.0.0.1:99999", "127.0.0.1:port"])
def test_an_address_that_is_none_is_refused(mailbox, place):
    with pytest.raises(InputError, match="address and port"):
        rosbridge.Server(place, mailbox, OUTPUTS)


def test_a_port_that_is_taken_is_refused(mailbox, server):
    place = server.address.removeprefix("ws://")
    with pytest.raises(InputError, match="not free"):
        rosbridge.Server(place, mailbox, OUTPUTS)


# ------------------------------------------------------------------ the mailbox


@pytest.mark.parametrize("turn", np.linspace(-math.pi, math.pi, 7))
def test_a_pose_is_a_place_and_a_heading(turn):
    orientation = {"x": 0.0, "y": 0.0, "z": 2 * math.sin(turn / 2), "w": 2 * math.cos(turn / 2)}  # of any length
    position, heading = read_pose({"pose": {"pose": {"position": {"x": 1, "y": -2.5}, "orientation": orientation}}})
    np.testing.assert_allclose(position, [1.0, -2.5])
    np.testing.assert_allclose(heading, [math.cos(turn), math.sin(turn)], atol=1e-12)


MALFORMED = [
    {},
    {"linear": {"x": 1.0}},
    {"linear": {}, "angular": {"z": 0.0}},
    {"linear": 3, "angular": {"z": 0.0}},
    {"linear": None, "angular": None},
    twist("fast", 0.0),
    twist(None, 0.0),
    twist(True, 0.0),
    twist([1.0], 0.0),
    twist(math.nan, 0.0),
    twist(0.0, math.inf),
    twist(0.0, -math.inf),
    twist(1e300, 0.0),
    twist(10**400, 0.0),
]


@pytest.mark.parametrize("message", MALFORMED, ids=lambda message: str(message)[:40])
def test_a_malformed_command_is_dropped_and_named(mailbox, sentences, message):
    mailbox.receive("/cmd_vel", message)
    assert mailbox.take_command() is None
    assert len(sentences) == 1 and sentences[0].startswith("/cmd_vel: a message was dropped: ")
    mailbox.receive("/cmd_vel", twist(0.25, -0.5))
    np.testing.assert_array_equal(mailbox.take_command(), np.array([0.25, -0.5], np.float32))
    assert mailbox.take_command() is None  # each one once


def test_a_pose_without_a_rotation_is_dropped(mailbox, sentences):
    zero = {"position": {"x": 0.0, "y": 0.0}, "orientation": {"z": 0.0, "w": 0.0}}
    mailbox.receive("/initialpose", {"pose": {"pose": zero}})
    assert mailbox.take_pose() is None and "no rotation" in sentences[0]


@pytest.mark.parametrize("frame", ["odom", "base_link", "/world"])
def test_a_pose_in_another_frame_is_dropped(mailbox, sentences, frame):
    there = {"position": {"x": 0.0, "y": 0.0}, "orientation": {"z": 0.0, "w": 1.0}}
    mailbox.receive("/initialpose", {"header": {"frame_id": frame}, "pose": {"pose": there}})
    assert mailbox.take_pose() is None and "and not map" in sentences[0]
    mailbox.receive("/initialpose", {"header": {"frame_id": "map"}, "pose": {"pose": there}})
    assert mailbox.take_pose() is not None


@pytest.mark.parametrize(
    ("master", "given", "address"),
    [
        ("http://localhost:11311", {}, "127.0.0.1"),
        ("http://127.0.0.1:11311/", {}, "127.0.0.1"),
        ("http://robot:11311", {}, None),
        ("http://localhost:11311", {"ROS_IP": "10.0.0.2"}, "10.0.0.2"),
        ("http://localhost:11311", {"ROS_HOSTNAME": "me"}, None),
    ],
)
def test_ros1_listens_on_loopback_if_its_master_does(mailbox, sentences, monkeypatch, master, given, address):
    for name in ("ROS_IP", "ROS_HOSTNAME"):
        monkeypatch.setenv(name, "x")  # so that both are as before in the end
        monkeypatch.delenv(name)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    ros1.listen_on_loopback(master, mailbox)
    assert os.environ.get("ROS_IP") == address
    assert bool(sentences) == (address == "127.0.0.1")


def test_the_latest_command_counts():
    mailbox = Mailbox(TransportLog(lambda sentence: None))
    for speed in range(1000):
        mailbox.receive("/cmd_vel", twist(speed / 1000, 0.0))
    assert mailbox.take_command()[0] == np.float32(0.999)


def test_commands_of_omnidirectional_robots_have_the_speed_to_the_left():
    mailbox = Mailbox(TransportLog(lambda sentence: None), 3)
    mailbox.receive("/cmd_vel", {"linear": {"x": 0.1, "y": 0.2}, "angular": {"z": 0.3}})
    assert mailbox.take_command().tolist() == np.float32([0.1, 0.2, 0.3]).tolist()


def test_the_log_writes_a_kind_of_sentence_once(sentences):
    log = TransportLog(sentences)
    for number in range(100):
        log("one", f"one {number}")
        log("other", f"other {number}")
    assert sentences == ["one 0", "other 0"]


def test_requests_are_bounded(mailbox):
    answers = []
    ask = [threading.Thread(target=lambda: answers.append(mailbox.request("reset"))) for _ in range(REQUESTS)]
    for thread in ask:
        thread.start()
    wait(lambda: len(mailbox._requests) == REQUESTS)
    refused = mailbox.request("reset")
    assert not refused.success and "wait already" in refused.message
    while (request := mailbox.take_request()) is not None:
        request.answer(True, "done")
    for thread in ask:
        thread.join(LIMIT)
    assert answers == [(True, "done")] * REQUESTS


# ------------------------------------------------------------------ rosbridge, message by message


def talk(server, scene, **options):
    """Run a conversation with the server: ``scene(connection)``, a coroutine."""

    async def run():
        async with connect(server.address, **options) as connection:
            return await scene(connection)

    return asyncio.run(run())


async def ask(connection, **message):
    await connection.send(json.dumps(message))


async def receive(connection, op):
    """The next message of an op."""
    while True:
        message = json.loads(await asyncio.wait_for(connection.recv(), LIMIT))
        if message["op"] == op:
            return message


BAD = [
    "no json",
    "[]",
    "{}",
    '{"op": 3}',
    '{"op": "fly"}',
    '{"op": "publish"}',
    '{"op": "publish", "topic": "/odom", "msg": {}}',
    '{"op": "subscribe", "topic": "/nothing"}',
    '{"op": "subscribe", "topic": "/odom", "throttle_rate": "often"}',
    '{"op": "subscribe", "topic": "/odom", "queue_length": -1}',
    "[" * 30_000,
    b"\xff\x00",
]


@pytest.mark.parametrize("text", BAD, ids=lambda text: repr(text[:40]))
def test_a_bad_message_is_answered_and_the_connection_stays(server, mailbox, sentences, text):
    async def scene(connection):
        await connection.send(text)
        status = await receive(connection, "status")
        assert status["level"] == "error" and status["msg"]
        await ask(connection, op="publish", topic="/cmd_vel", msg=twist(0.1, 0.2))
        await asyncio.to_thread(wait, lambda: mailbox.commands == 1)

    talk(server, scene)
    assert len(sentences) == 1


@pytest.mark.parametrize("message", [None, 3, [], *MALFORMED[:12]], ids=lambda message: str(message)[:40])
def test_a_malformed_command_of_a_client_is_dropped(server, mailbox, sentences, message):
    async def scene(connection):
        await ask(connection, op="publish", topic="/cmd_vel", msg=message)
        await asyncio.to_thread(wait, lambda: sentences)

    talk(server, scene)
    assert mailbox.commands == 0


def test_a_message_that_is_too_long_ends_its_connection_alone(server, mailbox):
    async def long(connection):
        with pytest.raises(ConnectionClosed):
            await connection.send("x" * (rosbridge.LONGEST + 1))
            await asyncio.wait_for(connection.recv(), LIMIT)

    async def other(connection):
        await ask(connection, op="publish", topic="cmd_vel", msg=twist(0.1, 0.2))
        await asyncio.to_thread(wait, lambda: mailbox.commands == 1)

    talk(server, long)
    talk(server, other)


def test_subscribers_get_numbers_bytes_times_and_what_is_not_finite(server):
    message = {
        "header": {"stamp": {"sec": 3, "nanosec": 4}, "frame_id": "lidar"},
        "ranges": np.array([1.5, np.inf, np.nan], np.float32),
        "data": np.array([0, 255], np.uint8),
        "angle_min": math.nan,
        "names": ["a"],
    }

    async def scene(connection):
        await ask(connection, op="subscribe", topic="/scan", type="sensor_msgs/LaserScan")
        await asyncio.to_thread(wait, lambda: server.wanted("/scan"))
        server.publish("/scan", message)
        return await receive(connection, "publish")

    assert not server.wanted("/scan")
    got = talk(server, scene)
    stamp = {"sec": 3, "nanosec": 4, "secs": 3, "nsecs": 4}
    head = {"stamp": stamp, "frame_id": "lidar"}
    others = {"ranges": [1.5, None, None], "data": "AP8=", "angle_min": None, "names": ["a"]}
    assert got == {"op": "publish", "topic": "/scan", "msg": {"header": head, **others}}
    wait(lambda: not server.wanted("/scan"))  # its subscription ended with it


def test_a_latched_message_reaches_later_subscribers(server):
    server.publish("/goal", {"number": 1})
    server.publish("/goal", {"number": 2})

    async def scene(connection):
        await ask(connection, op="subscribe", topic="/goal")
        return (await receive(connection, "publish"))["msg"]

    assert talk(server, scene) == {"number": 2}


def test_throttle_and_unsubscribe(server):
    async def scene(connection):
        await ask(connection, op="subscribe", topic="/odom", throttle_rate=60_000)
        await ask(connection, op="subscribe", topic="/scan")
        await asyncio.to_thread(wait, lambda: server.wanted("/scan"))
        for number in range(20):
            server.publish("/odom", {"number": number})
            server.publish("/scan", {"number": number})
        got = [await receive(connection, "publish") for _ in range(21)]
        assert [each["msg"]["number"] for each in got if each["topic"] == "/odom"] == [0]
        assert [each["msg"]["number"] for each in got if each["topic"] == "/scan"] == list(range(20))
        await ask(connection, op="unsubscribe", topic="/scan")
        await asyncio.to_thread(wait, lambda: not server.wanted("/scan"))

    talk(server, scene)


def answer_requests(mailbox, number):
    """Answer requests as a simulation does, in a thread."""

    def work():
        for _ in range(number):
            wait(lambda: mailbox._requests)
            request = mailbox.take_request()
            request.answer(request.name != "step", f"{request.name}: seen")

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def test_services(server, mailbox):
    thread = answer_requests(mailbox, 2)

    async def scene(connection):
        await ask(connection, op="call_service", service="/sean_jax/reset", id="one")
        done = await receive(connection, "service_response")
        assert done["values"] == {"success": True, "message": "reset: seen"} and done["result"] and done["id"] == "one"
        await ask(connection, op="call_service", service="/sean_jax/step", args={})
        assert (await receive(connection, "service_response"))["values"]["success"] is False
        await ask(connection, op="call_service", service="/sean_jax/fly")
        assert (await receive(connection, "service_response"))["result"] is False
        await ask(connection, op="call_service", service="/rosapi/topic_type", args={"topic": "/cmd_vel"})
        assert (await receive(connection, "service_response"))["values"] == {"type": "geometry_msgs/Twist"}
        server.publish("/clock", {"clock": {"sec": 4, "nanosec": 5}})
        answers = {
            "get_time": {"time": {"sec": 4, "nanosec": 5, "secs": 4, "nsecs": 5}},
            "nodes": {"nodes": ["/sean_jax"]},
            "get_param": {"value": "true"},
        }
        for name, values in answers.items():
            await ask(connection, op="call_service", service=f"/rosapi/{name}", args={"name": "/use_sim_time"})
            assert (await receive(connection, "service_response"))["values"] == values

    talk(server, scene)
    thread.join(LIMIT)


# ------------------------------------------------------------------ many, slow, flooding and foreign clients


def test_a_hundred_clients_get_each_message(server):
    async def scene():
        clients = [await connect(server.address) for _ in range(100)]
        for client in clients:
            await ask(client, op="subscribe", topic="/odom")
        await asyncio.to_thread(wait, lambda: server._subscribed["/odom"] == 100)
        for number in range(5):
            server.publish("/odom", {"number": number})
        for client in clients:
            got = [(await receive(client, "publish"))["msg"]["number"] for _ in range(5)]
            assert got == list(range(5))
        for client in clients:
            await client.close()

    asyncio.run(scene())
    wait(lambda: not server._clients and not server.wanted("/odom"))


def test_more_clients_than_the_limit_are_refused(server, monkeypatch):
    monkeypatch.setattr(rosbridge, "CONNECTIONS", 2)

    async def scene():
        first, second = [await connect(server.address) for _ in range(2)]
        with pytest.raises(InvalidStatus) as error:
            await connect(server.address)
        assert error.value.response.status_code == 503
        await first.close()
        await second.close()

    asyncio.run(scene())


def test_a_client_that_floods_is_slowed_and_others_are_served(server, mailbox, sentences, monkeypatch):
    monkeypatch.setattr(rosbridge, "RATE", 100)

    async def scene():
        hasty = connect(server.address, close_timeout=0.1)  # as the server is slow to read that this client ends
        async with hasty as flood, connect(server.address) as other:
            text = json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": twist(0.1, 0.0)})
            sending = asyncio.ensure_future(send_all(flood, text, 20_000))
            await asyncio.to_thread(wait, lambda: any("slowed down" in each for each in sentences))
            await ask(other, op="subscribe", topic="/odom")
            await asyncio.to_thread(wait, lambda: server.wanted("/odom"))
            server.publish("/odom", {"number": 1})
            assert (await receive(other, "publish"))["msg"] == {"number": 1}
            assert mailbox.commands < 20_000
            sending.cancel()

    asyncio.run(scene())


async def send_all(connection, text, number):
    for _ in range(number):
        await connection.send(text)


@pytest.fixture
def impatient(monkeypatch, request):
    monkeypatch.setattr(local_server, "PATIENCE", 0.3)
    return request.getfixturevalue("server")


def half_open(server):
    """The socket of a client that has subscribed and reads nothing more, not even pings."""
    host, port = server.address.removeprefix("ws://").split(":")
    opened = socket.create_connection((host, int(port)))
    head = f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    opened.sendall((head + "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n").encode())
    assert b"101" in opened.recv(4096)
    text = json.dumps({"op": "subscribe", "topic": "/scan"}).encode()
    opened.sendall(bytes([0x81, 0x80 | len(text)]) + bytes(4) + text)  # masked with zeros
    return opened


def test_a_half_open_client_is_bounded_and_closed(impatient):
    server = impatient
    with half_open(server):
        wait(lambda: server.wanted("/scan"))
        client = next(iter(server._clients.values()))
        for _ in range(3 * rosbridge.QUEUE):
            server.publish("/scan", {"ranges": np.zeros(5_000)})
        assert max(map(len, client._queues.values())) <= rosbridge.QUEUE
        wait(lambda: not server._clients)
    assert not server.wanted("/scan")


def test_sockets_that_send_nothing_are_closed_and_others_are_served(impatient, mailbox):
    host, port = impatient.address.removeprefix("ws://").split(":")
    with contextlib.ExitStack() as stack:
        silent = [stack.enter_context(socket.create_connection((host, int(port)), LIMIT)) for _ in range(100)]

        async def scene(connection):
            await ask(connection, op="publish", topic="/cmd_vel", msg=twist(0.1, 0.2))
            await asyncio.to_thread(wait, lambda: mailbox.commands == 1)

        talk(impatient, scene)
        assert not any(each.recv(1) for each in silent)  # the end of the connection


@pytest.mark.parametrize("origin", ["http://example.org", "null", "http://127.0.0.1.example.org"])
def test_pages_from_elsewhere_are_refused(server, origin):
    with pytest.raises(InvalidStatus) as error:
        talk(server, lambda connection: asyncio.sleep(0), origin=origin)
    assert error.value.response.status_code == 403


def test_a_foreign_host_is_refused(server):
    with pytest.raises(InvalidStatus):
        talk(server, lambda connection: asyncio.sleep(0), additional_headers={"Host": "example.org:80"})


def test_a_page_of_this_computer_is_served(server):
    talk(server, lambda connection: asyncio.sleep(0), origin="http://localhost:8000")


def test_other_computers_need_the_token(mailbox):
    server = rosbridge.Server("0.0.0.0:0", mailbox, OUTPUTS)
    try:
        address = server.address.replace("0.0.0.0", "127.0.0.1")
        for wrong in (address.partition("/?")[0], address[:-1]):
            with pytest.raises(InvalidStatus):
                asyncio.run(greet(wrong))
        asyncio.run(greet(address))
    finally:
        server.close()


async def greet(address):
    async with connect(address):
        pass


# ------------------------------------------------------------------ clients of others

ROSLIBPY = """
import json, sys, threading
import roslibpy

client = roslibpy.Ros(sys.argv[1])
client.run(timeout=20)
here, got = threading.Event(), []

def receive(message):
    got.append(message)
    here.set()

roslibpy.Topic(client, "/goal", "geometry_msgs/PoseStamped").subscribe(receive)
here.wait(20)
topics = client.get_topics()
kind = client.get_topic_type("/odom")
topic = roslibpy.Topic(client, "/cmd_vel", "geometry_msgs/Twist")
topic.advertise()
topic.publish(roslibpy.Message({"linear": {"x": 0.3, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": -0.2}}))
answer = roslibpy.Service(client, "/sean_jax/new_task", "std_srvs/Trigger").call(roslibpy.ServiceRequest(), timeout=20)
print(json.dumps([got[0], topics, kind, dict(answer)]))  # the command is there, as the answer came after it
client.terminate()
"""


def test_roslibpy_talks_with_the_server(server, mailbox):
    pytest.importorskip("roslibpy")
    server.publish("/goal", {"pose": {"position": {"x": 2.5}}})
    thread = answer_requests(mailbox, 1)
    goal, topics, kind, answer = json.loads(python("-c", ROSLIBPY, server.address, timeout=60))
    assert goal == {"pose": {"position": {"x": 2.5}}}
    assert set(topics) == {*OUTPUTS, "/cmd_vel", "/initialpose"} and kind == "nav_msgs/Odometry"
    assert answer == {"success": True, "message": "new_task: seen"}
    np.testing.assert_array_equal(mailbox.take_command(), np.array([0.3, -0.2], np.float32))
    thread.join(LIMIT)


DDS = """
import sys, time
from dataclasses import dataclass
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int8, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

def struct(package, name, **fields):
    made = type(name, (IdlStruct,), {"__annotations__": fields}, typename=f"{package}::msg::dds_::{name}_")
    return dataclass(made)

Vector3 = struct("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
Point = struct("geometry_msgs", "Point", x=float64, y=float64, z=float64)
Quaternion = struct("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = struct("geometry_msgs", "Pose", position=Point, orientation=Quaternion)
Twist = struct("geometry_msgs", "Twist", linear=Vector3, angular=Vector3)
Time = struct("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
Header = struct("std_msgs", "Header", stamp=Time, frame_id=str)
PoseWithCovariance = struct("geometry_msgs", "PoseWithCovariance", pose=Pose, covariance=array[float64, 36])
TwistWithCovariance = struct("geometry_msgs", "TwistWithCovariance", twist=Twist, covariance=array[float64, 36])
Odometry = struct("nav_msgs", "Odometry", header=Header, child_frame_id=str, pose=PoseWithCovariance,
                  twist=TwistWithCovariance)
MetaData = struct("nav_msgs", "MapMetaData", map_load_time=Time, resolution=__import__("cyclonedds").idl.types.float32,
                  width=uint32, height=uint32, origin=Pose)
Grid = struct("nav_msgs", "OccupancyGrid", header=Header, info=MetaData, data=sequence[int8])

domain = Domain(int(sys.argv[1]), sys.argv[2])
participant = DomainParticipant(int(sys.argv[1]))
reliable = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(10))
latched = Qos(Policy.Reliability.Reliable(10**9), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
writer = DataWriter(participant, Topic(participant, "rt/cmd_vel", Twist, qos=reliable), qos=reliable)
maps = DataReader(participant, Topic(participant, "rt/map", Grid, qos=latched), qos=latched)
reader = DataReader(participant, Topic(participant, "rt/odom", Odometry, qos=reliable), qos=reliable)
cells, answered, end = None, 0, time.monotonic() + 40
while time.monotonic() < end and (answered < 20 or cells is None):
    for grid in maps.take(1):
        cells = list(grid.data)
    for sample in reader.take(10):
        at, turn = sample.pose.pose.position, sample.twist.twist.angular.z
        writer.write(Twist(linear=Vector3(x=at.x / 10, y=0.0, z=0.0), angular=Vector3(x=0.0, y=0.0, z=turn)))
        answered += 1
    time.sleep(0.001)
print(cells, sample.header.frame_id)
"""


@pytest.mark.slow  # participants need seconds to find each other
def test_another_participant_talks_with_the_bridge_in_the_types_of_ros_2(mailbox):
    pytest.importorskip("cyclonedds")
    from sean_jax.ros.dds import LOCAL, Participant

    outputs = {"/odom": OUTPUTS["/odom"], "/map": Output("nav_msgs/msg/OccupancyGrid", True)}
    bridge = Participant("171", mailbox, outputs)
    bridge.publish("/map", {"data": np.array([0, 100, -1], np.int8)})
    program = [sys.executable, "-c", DDS, "171", LOCAL]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as other:
        try:
            wait(lambda: bridge.wanted("/odom"))
            time.sleep(0.5)  # it has found the reader; the reader has to find it, too
            for number in range(20):
                pose = {"pose": {"position": {"x": float(number), "y": 0.0, "z": 0.0}}}
                spin = {"twist": {"angular": {"x": 0.0, "y": 0.0, "z": -0.5}}}
                bridge.publish("/odom", {"header": {"frame_id": "odom"}, "pose": pose, "twist": spin})
                mailbox.wait(LIMIT, for_command=True)
                np.testing.assert_array_equal(mailbox.take_command(), np.array([number / 10, -0.5], np.float32))
            output, errors = other.communicate(timeout=60)
            assert output.strip() == "[0, 100, -1] odom", errors
        finally:
            other.kill()
            bridge.close()

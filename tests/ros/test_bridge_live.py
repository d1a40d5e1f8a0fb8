"""Episodes of ``sean bridge`` with a transport in memory: paces, services, poses and clocks."""

import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from sean_jax.config import BridgeConfig
from sean_jax.core import random_streams
from sean_jax.core.errors import ControllerError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.ros import bridge, messages
from sean_jax.ros.transport import TransportLog
from sean_jax.simulation import scenario as scenarios
from support.commands import wait

pytest.importorskip("rosbags")
pytestmark = pytest.mark.slow
LIMIT = 60.0  # s, for anything that has to happen


class Memory:
    """A transport that keeps what is published, and calls ``heard`` with each topic and message."""

    address = "memory"

    def __init__(self):
        self.sent, self.heard = [], lambda topic, message: None

    def wanted(self, topic):
        return topic in ("/odom", "/clock", "/goal", "/map", "/scan", "/depth/image_raw", "/tf_static")

    def publish(self, topic, message):
        self.sent.append((topic, message))
        self.heard(topic, message)

    def close(self):
        pass

    def of(self, topic):
        return [message for name, message in self.sent if name == topic]


@pytest.fixture(scope="module")
def made():
    """A live scenario that is compiled once."""
    memory = Memory()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bridge, "connect", lambda place, mailbox, outputs: memory)
        config = BridgeConfig(
            ros1=True, environment="lab", people=4, dynamics="twin", metrics="none", time_limit=2.0, pace="lockstep",
            patience=5.0,
        )  # fmt: skip
        live = bridge.LiveBridge(config, Console(quiet=True))
    yield live, config
    live.close()


@pytest.fixture
def live(made):
    live, config = made
    live.config, live.bridge.transport.heard = config, lambda topic, message: None
    live.bridge.transport.sent.clear()
    return live


def twist(ahead, turn):
    return {"linear": {"x": ahead}, "angular": {"z": turn}}


def seconds(message):
    stamp = message["clock"] if "clock" in message else message["header"]["stamp"]
    return stamp["sec"] + 1e-9 * stamp["nanosec"]


def in_thread(live, number):
    """Run an episode in a thread; its result is in the list."""
    ended = []
    thread = threading.Thread(target=lambda: ended.append(live._episode(number)), daemon=True)
    thread.start()
    return thread, ended


def test_lockstep_takes_the_command_that_answers_each_state(live):
    """As a plain loop over ``scenario.step`` with these commands, from the start that ``sean run`` draws."""
    memory, commands = live.bridge.transport, iter(np.random.default_rng(5).uniform(-0.5, 0.5, (100, 2)))
    used = []

    def answer(topic, message):
        if topic == "/odom":
            used.append(next(commands))
            live.bridge.mailbox.receive("/cmd_vel", twist(*map(float, used[-1])))

    memory.heard = answer
    for number in (0, 1):  # with the two tasks of the graph
        memory.sent.clear()
        used.clear()
        assert live._episode(number)
        scenario = live.scenarios[number]
        state = jax.jit(scenarios.reset)(scenario, jax.random.fold_in(random_streams.key("run", 0), number))
        places = [np.asarray(state.robot.position)]
        for command in used[:-1]:  # the last one answers the last state
            state = jax.jit(scenarios.step)(scenario, state, jnp.asarray(command, jnp.float32))
            places.append(np.asarray(state.robot.position))
        assert bool(state.timed_out) and len(used) == 21 and live.bridge.missed == 0
        sent = [[each["pose"]["pose"]["position"][axis] for axis in "xy"] for each in memory.of("/odom")]
        np.testing.assert_allclose(sent, places, atol=1e-5)
        goal = memory.of("/goal")
        assert len(goal) == len(memory.of("/map")) == 1 and memory.sent[-1][0] == "/clock"
        np.testing.assert_allclose(goal[0]["pose"]["position"]["x"], float(state.task.goal[0]), rtol=1e-6)
        assert len(memory.of("/scan")[0]["ranges"]) == 360 and len(memory.of("/depth/image_raw")) == 21


def test_states_without_a_command_are_counted_and_the_robot_stands(live):
    live.config = live.config.replace(patience=0.01)
    live.bridge.mailbox.take_command()
    assert live._episode(0)
    assert live.bridge.missed == 20
    last = live.bridge.transport.of("/odom")[-1]
    assert last["twist"]["twist"]["linear"]["x"] == 0.0


def test_the_clock_never_goes_back(live):
    live.config = live.config.replace(pace="fast")
    for number in range(3):
        live._episode(number)
    times = [seconds(message) for message in live.bridge.transport.of("/clock")]
    np.testing.assert_allclose(np.diff(times), 0.1, atol=1e-6)
    odometry = [seconds(message) for message in live.bridge.transport.of("/odom")]
    np.testing.assert_allclose(odometry, times)


def test_a_state_after_a_step_at_t_has_the_stamp_t(made, monkeypatch):
    """Counted from the stamp of the first state of all, as in bags and in trajectories.csv."""
    live, config = made
    memory = Memory()
    monkeypatch.setattr(bridge, "connect", lambda place, mailbox, outputs: memory)
    fresh = bridge.Bridge(live.scenarios[0], config.place, live._write)
    state = live._begin(0)
    fresh.begin(live.scenarios[0], 0)
    for _ in range(3):
        fresh.publish(state, fresh.no_command)
        state = bridge._step(live.scenarios[0], state, jnp.zeros(2))
    fresh.begin(live.scenarios[0], 1)
    fresh.publish(live._begin(1), fresh.no_command)
    begin = 1e-9 * messages.BEGIN
    np.testing.assert_allclose([seconds(each) - begin for each in memory.of("/odom")], [0.0, 0.1, 0.2, 0.3], atol=1e-9)


def test_the_robot_stays_if_it_cannot_stand_at_a_pose(live, capsys):
    sentences = []
    live.bridge.mailbox.log = TransportLog(sentences.append)
    scenario, state = live.scenarios[0], live._begin(0)
    live.bridge.begin(scenario, 0)
    centers = np.asarray(scenario.environment.obstacles.center, float)
    box = centers[signed_distances_on_host(scenario.environment, centers)[1].argmax()]  # the farthest from the edge
    for place, word in (((1e6, -1e6), "not on the floor"), (box, "in an obstacle")):
        live.bridge.mailbox.log = TransportLog(sentences.append)
        stays = live.bridge.place(state, (np.array(place, float), np.array([1.0, 0.0])))
        assert stays is state and word in sentences[-1] and len(sentences) <= 4
    person = np.asarray(state.pedestrians.position, float)[np.asarray(state.pedestrians.present)][0]
    for away in (0.0, 0.2):
        live.bridge.mailbox.log = TransportLog(sentences.append)
        stays = live.bridge.place(state, (person + [away, 0.0], np.array([1.0, 0.0])))
        assert stays is state and sentences[-1].endswith("is on a person; the robot stays.")
    start = np.asarray(state.task.start, float)
    moved = live.bridge.place(state, (start, np.array([1.0, 0.0])))
    np.testing.assert_allclose(moved.robot.position, start, atol=1e-6)


def test_a_transport_that_ends_ends_the_episode_with_its_sentence(live):
    live.config = live.config.replace(pace="service")
    mailbox = live.bridge.mailbox
    ended = []

    def work():
        with pytest.raises(ControllerError, match="the node was shut down"):
            live._episode(0)
        ended.append(True)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    time.sleep(0.3)
    mailbox.end("the node was shut down.")
    thread.join(LIMIT)
    mailbox._ended = ""
    assert ended == [True]


def test_a_dead_controller_is_no_result(made, monkeypatch):
    """One that has answered and is silent for 3 s of an episode; before, missed commands are counted."""
    live, config = made
    memory = Memory()
    monkeypatch.setattr(bridge, "connect", lambda place, mailbox, outputs: memory)
    driver = bridge.ControllerDriver(live.scenarios[0], "ros1:", config.place, Console(quiet=True))
    answers = [True] * 3 + [False] * 2 + [True] * 2

    def answer(topic, message):
        if topic == "/odom" and (not answers or answers.pop(0)) and not dead:
            driver._bridge.mailbox.receive("/cmd_vel", twist(0.1, 0.0))

    dead, memory.heard = [], answer
    batch = lambda state: jax.tree.map(lambda leaf: leaf[None], state)  # noqa: E731
    state = live._begin(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bridge, "PATIENCE", 0.2)
        for _ in range(6):
            policy = driver(live.scenarios[0], 0, batch(state))
            state = bridge._step(live.scenarios[0], state, policy.params)
        assert driver._bridge.missed == 2 and driver.finish(batch(state)) == 2
        dead.append(True)
        with pytest.raises(ControllerError, match="no command for 3 s of episode 0, which is therefore no result"):
            for _ in range(40):
                driver(live.scenarios[0], 0, batch(state))


def test_services_and_poses(live):
    live.config = live.config.replace(pace="service")
    mailbox, memory = live.bridge.mailbox, live.bridge.transport
    thread, ended = in_thread(live, 0)
    for count in (1, 2, 3):
        mailbox.receive("/cmd_vel", twist(0.4, 0.0))
        answer = mailbox.request("step")
        assert answer.success and f"{0.1 * count:.3g} s" in answer.message
    goals = len(memory.of("/goal"))
    assert mailbox.request("new_task").success
    assert mailbox.request("step").success
    assert len(memory.of("/goal")) == goals + 1
    there = {"position": {"x": 1.25, "y": -0.5}, "orientation": {"z": 1.0, "w": 0.0}}
    mailbox.receive("/initialpose", {"pose": {"pose": there}})
    wait(lambda: memory.of("/odom")[-1]["pose"]["pose"]["position"]["x"] == 1.25, LIMIT)
    turn = memory.of("/odom")[-1]["pose"]["pose"]["orientation"]
    np.testing.assert_allclose(abs(turn["z"]), 1.0, atol=1e-6)
    assert mailbox.request("reset").success
    thread.join(LIMIT)
    assert ended == [False]
    times = [seconds(message) for message in memory.of("/clock")]
    assert (np.diff(times) >= 0.0).all()


def test_a_step_is_refused_where_time_passes_by_itself(live):
    live.config = live.config.replace(pace="real", factor=2.0)
    thread, ended = in_thread(live, 0)
    answer = live.bridge.mailbox.request("step")
    assert not answer.success and "--pace service" in answer.message
    thread.join(LIMIT)
    assert ended == [True]


def test_poses_do_not_hold_the_clock(live):
    """One every 10 ms, each of which would begin the wait for a command anew."""
    live.config = live.config.replace(patience=0.05)
    state = live._begin(0)
    place = dict(zip("xy", map(float, state.task.start), strict=True))
    message = {"pose": {"pose": {"position": place, "orientation": {"z": 0.0, "w": 1.0}}}}
    thread, ended = in_thread(live, 0)
    end = time.monotonic() + LIMIT
    while not ended and time.monotonic() < end:
        live.bridge.mailbox.receive("/initialpose", message)
        time.sleep(0.01)
    thread.join(1.0)
    live.bridge.mailbox.take_pose()
    assert ended == [True] and live.bridge.missed == 20

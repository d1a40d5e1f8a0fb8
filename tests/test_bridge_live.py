"""Episodes of ``sean bridge`` with a transport in memory: paces, services, poses and clocks."""

import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from sean_jax import prng
from sean_jax import scenario as scenarios
from sean_jax.config import BridgeConfig
from sean_jax.ros import bridge

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
            ros1=True, environment="lab", people=4, dynamics="twin", time_limit=2.0, pace="lockstep", patience=5.0
        )
        live = bridge.Live(config, Console(quiet=True))
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
        state = jax.jit(scenarios.reset)(scenario, jax.random.fold_in(prng.key("run", 0), number))
        places = [np.asarray(state.robot.position)]
        for command in used:
            state = jax.jit(scenarios.step)(scenario, state, jnp.asarray(command, jnp.float32))
            places.append(np.asarray(state.robot.position))
        assert bool(state.timed_out) and len(used) == 20 and live.bridge.missed == 0
        sent = [[each["pose"]["pose"]["position"][axis] for axis in "xy"] for each in memory.of("/odom")]
        np.testing.assert_allclose(sent, places[:-1], atol=1e-5)
        goal = memory.of("/goal")
        assert len(goal) == len(memory.of("/map")) == 1 and memory.sent[-1][0] == "/clock"
        np.testing.assert_allclose(goal[0]["pose"]["position"]["x"], float(state.task.goal[0]), rtol=1e-6)
        assert len(memory.of("/scan")[0]["ranges"]) == 360 and len(memory.of("/depth/image_raw")) == 20


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
    end = time.monotonic() + LIMIT
    while memory.of("/odom")[-1]["pose"]["pose"]["position"]["x"] != 1.25:
        assert time.monotonic() < end
        time.sleep(0.01)
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

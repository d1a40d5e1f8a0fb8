"""The bridge with a real ROS 1 master of Debian's packages; skipped where they are missing."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import types

import numpy as np
import pytest

from sean_jax.core.errors import InputError
from sean_jax.io.trajectories import load_trajectory
from sean_jax.ros.ros1 import DEBIAN, import_rospy
from support.checkout import ROOT
from support.commands import output, python, wait

pytestmark = [pytest.mark.slow, pytest.mark.ros]
SCENARIO = ("--environment", "lab", "--people", "6", "--dynamics", "twin", "--seed", "3")
PYTHON = "/usr/bin/python3"  # of Debian's ROS
LIMIT = 120.0  # s, for anything that has to happen


def ros_is_missing():
    """Why there is no ROS 1 here; empty if there is one."""
    if shutil.which("rosmaster") is None:
        return "Debian's ROS is not installed"
    words = "from sean_jax.ros.ros1 import import_rospy as i; i(); import nav_msgs.msg, sensor_msgs.msg, tf2_msgs.msg"
    try:
        subprocess.run([sys.executable, "-c", words], cwd=ROOT, check=True)
    except subprocess.CalledProcessError:
        return f"rospy of {DEBIAN} or its messages are missing or not for this Python"
    return ""


@pytest.fixture(scope="module")
def ros(tmp_path_factory):
    """The environment variables of a master on a free port, which the fixture starts."""
    if reason := ros_is_missing():
        pytest.skip(reason)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    folder = tmp_path_factory.mktemp("ros")
    here = {"ROS_IP": "127.0.0.1", "ROS_HOSTNAME": "127.0.0.1", "ROS_LOG_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
    variables = {**os.environ, **here, "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "PORT": str(port)}
    with contextlib.ExitStack() as stack:
        stack.enter_context(master(variables))
        yield variables


@contextlib.contextmanager
def master(ros):
    with started(["rosmaster", "--core", "-p", ros["PORT"]], ros) as process:
        end = time.monotonic() + LIMIT
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", int(ros["PORT"]))):
                break
            assert time.monotonic() < end, "the master has not begun"
            time.sleep(0.05)
        yield process


@contextlib.contextmanager
def started(words, ros, **options):
    """A process that is ended with the block."""
    with subprocess.Popen([*map(str, words)], env=ros, cwd=ROOT, text=True, **options) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


def sean(ros, *words):
    return python("-m", "sean_jax", *words, env=ros, cwd=ROOT)


def program(ros, text, *words):
    """What a program of rospy prints."""
    return output(PYTHON, "-c", text, *words, env=ros, cwd=ROOT, timeout=LIMIT)


def test_the_tutorial_controller_outside_equals_the_same_controller_inside(ros, tmp_path):
    """To the byte, in all metrics of all episodes: no command is missed, and the programs round alike."""
    options = (*SCENARIO, "--episodes", "2", "--time-limit", "30")
    controller = ROOT / "examples" / "ros1_controller.py"
    with started([PYTHON, controller], ros):
        said = sean(ros, "run", "--policy", "ros1:", *options, "--out", tmp_path / "outside")
    assert "no command came" not in said
    sean(ros, "run", "--policy", f"{controller}:inside", "--batch", "1", *options, "--out", tmp_path / "inside")
    outside, inside = ((tmp_path / name / "episodes.csv").read_bytes() for name in ("outside", "inside"))
    assert outside == inside and len(outside.splitlines()) == 3


BENCHMARK = """
import sys
from sean_jax.cli import command_line as cli
from sean_jax.studies.experiments import benchmark

names = ("lab-random_ab_nav", "lab-join_group")  # two tracks, so that the controller is connected twice
for name, track in list(benchmark.TRACKS.items()):
    track.options["time_limit"] = 12.0
benchmark.TRACKS = {name: benchmark.TRACKS[name] for name in names}
for policy, folder in zip(sys.argv[1::2], sys.argv[2::2]):
    assert cli.main(["benchmark", "run", policy, "--episodes", "1", "--out", folder]) == 0
"""


@pytest.mark.night
def test_a_controller_outside_gets_a_result_of_the_benchmark(ros, tmp_path):
    """The measurements of the same controller inside; two compiled programs may round a metric differently."""
    controller = ROOT / "examples" / "ros1_controller.py"
    words = ("ros1:", tmp_path / "outside", f"{controller}:inside", tmp_path / "inside")
    with started([PYTHON, controller], ros):
        said = python("-c", BENCHMARK, *words, env=ros, cwd=ROOT)
    assert "no command came" not in said
    outside, inside = (json.loads((tmp_path / name / "result.json").read_text()) for name in ("outside", "inside"))
    assert outside["policy"] == "ros1:" and outside["scores"] == inside["scores"]
    for track in outside["tracks"]:
        ours, theirs = (np.load(tmp_path / name / f"{track}.npz") for name in ("outside", "inside"))
        for name in theirs.files:
            np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-6, err_msg=f"{track} {name}")


LISTEN = """
import sys, threading
import rospy
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import Image, LaserScan
from geometry_msgs.msg import Twist
from std_srvs.srv import Trigger

rospy.init_node("listener", anonymous=True)
topics = {"/odom": Odometry, "/scan": LaserScan, "/depth/image_raw": Image, "/map": OccupancyGrid}
got, moved = {}, threading.Event()

def receive(topic):
    def one(message):
        got[topic] = message
        if topic == "/odom" and message.twist.twist.linear.x > 0.2:
            moved.set()
    return one

subscribers = [rospy.Subscriber(topic, kind, receive(topic)) for topic, kind in topics.items()]
publisher = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
twist = Twist()
if "drive" in sys.argv:
    twist.linear.x = 0.3
rest = 50 if "record" in sys.argv else 0  # messages that the recorder gets, which is connected then
while not (len(got) == len(topics) and moved.is_set() and rest <= 0):
    rest -= publisher.get_num_connections() > 1
    if "drive" in sys.argv:
        twist.linear.y = float("nan")  # of no use to this robot
        publisher.publish(twist)
        broken = Twist()
        broken.linear.x = float("nan")
        publisher.publish(broken)
    rospy.sleep(0.02)
answer = rospy.ServiceProxy("/sean_jax/reset", Trigger)()
scan, image = got["/scan"], got["/depth/image_raw"]
print(len(scan.ranges), image.encoding, len(image.data) == 4 * image.width * image.height, answer.success)
"""


STUCK = """
import rospy
from sensor_msgs.msg import Image

rospy.init_node("stuck", anonymous=True)
rospy.Subscriber("/depth/image_raw", Image, lambda message: print("got", flush=True), queue_size=1)
rospy.spin()
"""


def read_line(process, word, lines):
    """Read the process's output until a line has a word."""
    while word not in (line := process.stdout.readline()):
        assert line, "".join(lines)
        lines.append(line)
    lines.append(line)
    return line


@pytest.mark.night
def test_publish_subscribe_record_play_a_stuck_subscriber_and_a_killed_master(ros, tmp_path):
    variables, lines = ros, []
    bridge = [sys.executable, "-m", "sean_jax", "bridge", "--ros1", *SCENARIO, "--factor", "2", "--time-limit", "20"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    ros = {**variables, "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "PORT": str(port)}
    with contextlib.ExitStack() as stack, contextlib.ExitStack() as first:
        first.enter_context(master(ros))
        process = stack.enter_context(started(bridge, ros, **pipes))
        read_line(process, "bridge: ", lines)
        bag = tmp_path / "drive.bag"
        record = ["rosbag", "record", "-O", bag, "/odom", "/cmd_vel", "/people", "/tf", "/clock", "/map"]
        with started(record, ros) as recorder:
            wait(bag.with_suffix(".bag.active").exists, LIMIT)
            assert program(ros, LISTEN, "drive", "record").split() == ["360", "32FC1", "True", "True"]
            recorder.send_signal(signal.SIGINT)
            recorder.wait(LIMIT)
        read = "import rosbag, sys; print(sorted({topic for topic, _, _ in rosbag.Bag(sys.argv[1])}))"
        assert program(ros, read, bag).strip() == str(["/clock", "/cmd_vel", "/map", "/odom", "/people", "/tf"])
        stuck = stack.enter_context(started([PYTHON, "-c", STUCK], ros, **pipes))
        read_line(stuck, "got", [])
        stuck.send_signal(signal.SIGSTOP)  # it keeps its connection and reads nothing more
        stack.callback(stuck.kill)
        with started(["rosbag", "play", "-l", bag, "--topics", "/cmd_vel"], ros):
            assert program(ros, LISTEN).split()[-1] == "True"
        if not any("x is nan" in line for line in lines):
            read_line(process, "/cmd_vel: a message was dropped: x is nan", lines)
        first.close()  # the master ends
        read_line(process, "does not answer", lines)
        read_line(process, "episode", lines)  # the simulation goes on
        stack.enter_context(master(ros))
        read_line(process, "registered at a new master", lines)
        assert program(ros, LISTEN, "drive").split()[-1] == "True"


def test_a_bag_of_a_real_recorder_has_goals_commands_and_episodes(ros, tmp_path):
    """Recorded from before the bridge sets /use_sim_time, so that the recorder's clock is the wall's."""
    bag, out = tmp_path / "drive.bag", tmp_path / "in"
    controller = ROOT / "examples" / "ros1_controller.py"
    options = (*SCENARIO, "--episodes", "2", "--time-limit", "8", "--trajectories", "csv")
    wall = ["rosparam", "set", "/use_sim_time", "false"]  # as before any bridge
    output(*wall, env=ros, timeout=LIMIT)
    with started(["rosbag", "record", "-a", "-O", bag], ros) as recorder:
        wait(bag.with_suffix(".bag.active").exists, LIMIT)
        with started([PYTHON, controller], ros):
            sean(ros, "run", "--policy", "ros1:", *options, "--out", tmp_path / "run")
        recorder.send_signal(signal.SIGINT)
        recorder.wait(LIMIT)
    said = sean(ros, "import-bag", bag, "--out", out)
    assert "so there are 2 episodes" in said and "falls on a row" not in said
    recorded, ours = load_trajectory(tmp_path / "run" / "trajectories.csv"), load_trajectory(out / "trajectory.csv")
    assert np.hypot(*np.moveaxis(ours.people_velocity, -1, 0)).max() < 4.0
    for number in (0, 1):
        length = int(ours.active[number].sum())
        states = int(recorded.active[number].sum())
        place, truth = ours.position[number, :length], recorded.position[number, :states]
        np.testing.assert_allclose(place[-states:], truth, atol=1e-5)  # the bag begins with the first state
        np.testing.assert_allclose(ours.goal[number, length - 1], recorded.goal[number, 0], atol=1e-5)
        assert (np.abs(ours.action[number, :length]).sum(axis=1) > 0).mean() > 0.8


ONE_MESSAGE = """
import sys
import rospy
from nav_msgs.msg import Odometry
from std_srvs.srv import Trigger

rospy.init_node("listener", anonymous=True)
message = rospy.wait_for_message(sys.argv[1], Odometry, 60)
print(message.header.frame_id, message.child_frame_id, rospy.ServiceProxy(sys.argv[2], Trigger)().success)
"""


@pytest.mark.night
def test_a_second_bridge_ends_the_first_in_one_sentence(ros):
    bridge = [sys.executable, "-m", "sean_jax", "bridge", "--ros1", *SCENARIO]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with started(bridge, ros, **pipes) as first:
        read_line(first, "bridge: ", [])
        with started(bridge, ros, **pipes) as second:
            read_line(second, "bridge: ", [])
            rest = first.communicate(timeout=LIMIT)[0]
            assert first.returncode == 1 and "--node-name" in rest and "Traceback" not in rest, rest
            output("rosnode", "kill", "/sean_jax", env=ros, timeout=LIMIT)
            rest = second.communicate(timeout=LIMIT)[0]
            assert second.returncode == 1 and "was shut down" in rest and "Traceback" not in rest, rest


def test_two_bridges_of_two_names_live_beside_each_other(ros):
    """Each with its topics, in its namespace, and its service."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with contextlib.ExitStack() as stack:
        bridges = []
        for name, naming in (("one", "ros"), ("two", "sean")):
            own = ("--node-name", name, "--namespace", f"robot_{name}", "--naming", naming)
            command = [sys.executable, "-m", "sean_jax", "bridge", "--ros1", *SCENARIO, *own]
            bridges.append(stack.enter_context(started(command, ros, **pipes)))
            read_line(bridges[-1], "ready", [])
        assert {"/one", "/two"} <= set(output("rosnode", "list", env=ros, timeout=LIMIT).split())
        for name, odom in (("one", "/robot_one/odom"), ("two", "/robot_two/robot_odom")):
            said = program(ros, ONE_MESSAGE, odom, f"/robot_{name}/{name}/reset").split()
            assert said == [f"robot_{name}/odom", f"robot_{name}/base_link", "True"]
        assert [each.poll() for each in bridges] == [None, None]


def test_there_has_to_be_a_master(ros):
    nobody = {**ros, "ROS_MASTER_URI": "http://127.0.0.1:1"}
    words = [sys.executable, "-m", "sean_jax", "bridge", "--ros1", *SCENARIO]
    done = subprocess.run(words, env=nobody, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "no ROS master answers at http://127.0.0.1:1" in done.stderr.replace("\n", " ")


def test_rospy_leaves_no_trace_where_it_is_missing():
    """The search path is as before if the import fails."""
    if not ros_is_missing():
        assert import_rospy().__name__ == "rospy"
        return
    before = list(sys.path)
    with pytest.raises(InputError, match="ros1: rospy"):
        import_rospy()
    assert sys.path == before


def test_messages_that_are_missing_are_named(monkeypatch):
    for name in ("rospy", "geometry_msgs", "geometry_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, "std_srvs.srv", None)
    with pytest.raises(InputError, match=r"ros1: rospy cannot be imported \(.*std_srvs.*\); .* python3-std-srvs"):
        import_rospy()

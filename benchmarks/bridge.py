"""A live robot over ROS 1, rosbridge and DDS: messages a second, real-time factor, latency from command to motion.

The controller is another process, with the real client of each transport: rospy, roslibpy, Cyclone DDS. It answers each
/odom with a /cmd_vel. ROS 1 needs Debian's packages, and is left out without them.

python benchmarks/bridge.py --out benchmarks/results/bridge.json
"""

import argparse
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from options import Option, parser
from timing import stopwatch, write_json

TOPICS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/people": "people_msgs/msg/People",
    "/clock": "rosgraph_msgs/msg/Clock",
}
MOVES = 0.01  # m/s, from which on the robot moves
REST = 1.5  # s, for which it brakes between two measurements
REPEATS = 8


# ------------------------------------------------------------------ the controller's process


class Controller:
    """Counts messages, and answers each odometry."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(TOPICS, 0)
        self.answers, self.speed, self.changed = True, 0.0, threading.Condition()

    def receive(self, topic: str, speed: float = 0.0) -> None:
        self.counts[topic] += 1
        if topic == "/odom":
            with self.changed:
                self.speed = speed
                self.changed.notify_all()
            if self.answers:
                self.send(0.2, 0.1)

    def send(self, ahead: float, turn: float) -> None:
        raise NotImplementedError

    def latency(self) -> float:
        """Seconds from a command to an odometry that shows motion."""
        self.send(0.0, 0.0)
        time.sleep(REST + 0.1 * np.random.default_rng().random())  # at any time between two steps
        begin = time.perf_counter()
        self.send(0.4, 0.0)
        with self.changed:
            self.changed.wait_for(lambda: self.speed > MOVES, 5.0)
        return time.perf_counter() - begin


class Ros1(Controller):
    def __init__(self, address: str) -> None:
        super().__init__()
        from sean_jax.ros.ros1 import import_rospy

        rospy = import_rospy()
        from geometry_msgs.msg import Twist
        from nav_msgs.msg import Odometry

        rospy.init_node("controller", disable_signals=True)
        self._twist, self._publisher = Twist, rospy.Publisher("/cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
        for topic in TOPICS:
            kind = Odometry if topic == "/odom" else rospy.AnyMsg
            rospy.Subscriber(topic, kind, self._receive, topic, tcp_nodelay=True)

    def _receive(self, message, topic) -> None:
        self.receive(topic, message.twist.twist.linear.x if topic == "/odom" else 0.0)

    def send(self, ahead: float, turn: float) -> None:
        twist = self._twist()
        twist.linear.x, twist.angular.z = ahead, turn
        self._publisher.publish(twist)


class Rosbridge(Controller):
    def __init__(self, address: str) -> None:
        super().__init__()
        import roslibpy

        self._client = roslibpy.Ros(address)
        self._client.run(timeout=30)
        self._topic = roslibpy.Topic(self._client, "/cmd_vel", "geometry_msgs/Twist")
        for topic, kind in TOPICS.items():
            name = kind.replace("/msg/", "/")
            roslibpy.Topic(self._client, topic, name).subscribe(
                lambda message, topic=topic: self._receive(message, topic)
            )

    def _receive(self, message, topic) -> None:
        self.receive(topic, message["twist"]["twist"]["linear"]["x"] if topic == "/odom" else 0.0)

    def send(self, ahead: float, turn: float) -> None:
        flat = {"x": 0.0, "y": 0.0, "z": 0.0}
        self._topic.publish({"linear": {**flat, "x": ahead}, "angular": {**flat, "z": turn}})


class Dds(Controller):
    def __init__(self, address: str) -> None:
        super().__init__()
        from cyclonedds.core import Policy, Qos
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        from sean_jax.ros.dds import LOCAL, Types

        domain, types = int(address.rpartition(" ")[2]), Types()
        qos = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(100))
        self._keep = Domain(domain, LOCAL), DomainParticipant(domain)
        self._types, participant = types, self._keep[1]
        self._writer = DataWriter(
            participant, Topic(participant, "rt/cmd_vel", types.struct("geometry_msgs/msg/Twist"), qos=qos), qos=qos
        )
        for name, kind in TOPICS.items():
            reader = DataReader(participant, Topic(participant, f"rt{name}", types.struct(kind), qos=qos), qos=qos)
            threading.Thread(target=self._read, args=(name, reader), daemon=True).start()

    def _read(self, topic, reader) -> None:
        from cyclonedds.util import duration

        while True:
            for sample in reader.take_iter(timeout=duration(seconds=1)):
                if hasattr(sample, "__idl__"):
                    self.receive(topic, sample.twist.twist.linear.x if topic == "/odom" else 0.0)

    def send(self, ahead: float, turn: float) -> None:
        twist = {"linear": {"x": ahead}, "angular": {"z": turn}}
        self._writer.write(self._types.fill("geometry_msgs/msg/Twist", twist))


CONTROLLERS = {"ros1": Ros1, "rosbridge": Rosbridge, "dds": Dds}


def control(transport: str, address: str) -> None:
    """The controller's process: it obeys the lines of its input."""
    controller = CONTROLLERS[transport](address)
    print("ready", flush=True)
    for line in sys.stdin:
        if line.strip() == "counts":
            print(json.dumps(controller.counts), flush=True)
        elif line.strip() == "latency":
            controller.answers = False
            print(json.dumps([controller.latency() for _ in range(REPEATS)]), flush=True)
            controller.answers = True
    os._exit(0)


# ------------------------------------------------------------------ the simulation's process


def measure(transport: str, environment: str, people: int, seconds: float) -> dict:
    """The figures of a transport."""
    from rich.console import Console

    from sean_jax.config import BridgeConfig
    from sean_jax.ros.bridge import LiveBridge

    config = BridgeConfig(
        **{transport: True},
        environment=environment,
        people=people,
        dynamics="twin",
        address="127.0.0.1:0",
        domain=173,
        patience=2.0,
        time_limit=seconds,
        task="random_ab_nav",
        task_distance=(8.0, 1e3),
    )
    live = LiveBridge(config, Console(quiet=True))
    command = [sys.executable, __file__, "--controller", transport, live.bridge.transport.address]
    result: dict = {}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        assert process.stdout.readline().strip() == "ready"
        while not all(live.bridge.transport.wanted(topic) for topic in TOPICS):
            time.sleep(0.1)
        for pace in ("lockstep", "fast"):
            live.config = config.replace(pace=pace)
            result[pace] = rates(live, process)
        live.config = config.replace(pace="real", time_limit=(REST + 1.0) * (REPEATS + 2))
        result["command_to_motion_ms"] = latency(live, process)
        process.stdin.close()
    live.close()
    return result


def ask(process: subprocess.Popen, word: str) -> Any:
    """The answer of the controller's process to a line."""
    process.stdin.write(f"{word}\n")
    process.stdin.flush()
    return json.loads(process.stdout.readline())


def rates(live: Any, process: subprocess.Popen) -> dict:
    """Steps and messages a second of an episode."""
    live._episode(0)  # connections of all topics
    before = ask(process, "counts")
    with stopwatch() as watch:
        live._episode(1)
    time.sleep(0.5)
    received = sum(number - before[topic] for topic, number in ask(process, "counts").items())
    steps = live.bridge._now + 1 - live.bridge._start
    return {
        "steps_per_second": round(steps / watch.seconds, 1),
        "real_time_factor": round(steps * live.config.time_step / watch.seconds, 2),
        "messages_per_second": round(received / watch.seconds, 1),
        "messages_received_share": round(received / (steps * len(TOPICS)), 3),
        "states_without_command": live.bridge.missed if live.config.pace == "lockstep" else None,
    }


def latency(live: Any, process: subprocess.Popen) -> dict:
    """Milliseconds from a command to motion, while episodes run in real time."""
    latencies: list = []
    dialog = threading.Thread(target=lambda: latencies.extend(ask(process, "latency")))
    dialog.start()
    while dialog.is_alive():
        live._episode(2)
    milliseconds = 1e3 * np.array(latencies)
    return {"median": round(float(np.median(milliseconds)), 1), "max": round(float(np.max(milliseconds)), 1)}


def start_master() -> subprocess.Popen:
    """A ROS master at a free port, which this process and its children use."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
    master = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL)
    time.sleep(2.0)
    return master


def main() -> None:
    """Print the figures, and write them."""
    command = parser(
        __doc__,
        environment="lab",
        people=6,
        seconds=Option(30.0, "simulated seconds of each measurement"),
        transports=Option(list(CONTROLLERS), choices=list(CONTROLLERS)),
        out=Option(kind=Path),
    )
    command.add_argument("--controller", nargs=2, help=argparse.SUPPRESS)
    options = command.parse_args()
    if options.controller:
        return control(*options.controller)
    import jax

    from sean_jax.cli import xla_flags

    xla_flags.configure()  # compiled programs stay in the cache
    about = {
        "environment": options.environment,
        "people": options.people,
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
        "device": jax.devices()[0].device_kind,
    }
    figures, master = {}, None
    for transport in options.transports:
        if transport == "ros1":
            if shutil.which("rosmaster") is None:
                print("ros1: Debian's ROS is not installed")
                continue
            master = start_master()
        figures[transport] = measure(transport, options.environment, options.people, options.seconds)
        print(transport, json.dumps(figures[transport]), flush=True)
    if options.out:
        write_json(options.out, {"about": about, "figures": figures})
    if master is not None:
        master.terminate()


if __name__ == "__main__":
    main()

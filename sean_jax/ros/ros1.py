"""ROS 1: a node of rospy, as Debian's packages or a ROS installation bring it.

The messages are written by the package ``rosbags``, so a type that the installation lacks, such as people_msgs/People,
can be published too: each publisher has its definition. When the master ends, connections stay; when another one
begins, the node registers there.
"""

from __future__ import annotations

import atexit
import importlib
import itertools
import os
import sys
import threading
import xmlrpc.client
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sean_jax.core.errors import InputError
from sean_jax.ros.messages import fill, typestore
from sean_jax.ros.names import COMMAND, POSE
from sean_jax.ros.transport import Mailbox, Output

QUEUE = 100  # messages of a topic that may wait for its subscribers
WATCH = 2.0  # s, between two looks at the master
SHORT = 0.2  # s, between two looks at the node
DEBIAN = "/usr/lib/python3/dist-packages"
MESSAGES = {"geometry_msgs": "msg", "std_srvs": "srv"}  # packages of the node's topics and services


def import_rospy() -> Any:
    """The module rospy. Where this Python has none, the one of Debian's packages is imported.

    Raises:
        InputError: there is none for this Python, or a package of messages is missing.
    """
    try:
        return _import()
    except ImportError as error:
        missing = error
    if DEBIAN not in sys.path and Path(DEBIAN, "rospy").is_dir():
        sys.path.append(DEBIAN)
        try:
            return _import()
        except ImportError as error:
            sys.path.remove(DEBIAN)
            missing = error
        if (missing.name or "").partition(".")[0] not in MESSAGES:
            version = f"Python {sys.version_info.major}.{sys.version_info.minor}"
            raise InputError(f"ros1: rospy of {DEBIAN} is not for {version} ({missing}); use Debian's version.")
    raise InputError(
        f"ros1: rospy cannot be imported ({missing}); on Debian: apt-get install ros-core python3-rospy "
        "python3-geometry-msgs python3-std-srvs."
    )


def listen_on_loopback(master: str, mailbox: Mailbox) -> None:
    """Let rospy listen on this computer alone if its master is there, unless the user has set where it listens."""
    if "ROS_IP" in os.environ or "ROS_HOSTNAME" in os.environ:
        return
    name = master.partition("//")[2].partition("/")[0].rpartition(":")[0].strip("[]")
    if name == "localhost" or name.startswith("127."):
        os.environ["ROS_IP"] = "127.0.0.1"
        text = "ros1: the master is on this computer, so the node listens on 127.0.0.1 alone; ROS_IP says otherwise."
        mailbox.log("ros1 address", text)


def _import() -> Any:
    for package, module in MESSAGES.items():
        importlib.import_module(f"{package}.{module}")
    return importlib.import_module("rospy")


def command_fields(message: Any) -> dict[str, Any]:
    """The fields of a Twist of rospy that ``read_command`` reads."""
    linear = {"x": message.linear.x, "y": message.linear.y}
    return {"linear": linear, "angular": {"z": message.angular.z}}


def pose_fields(message: Any) -> dict[str, Any]:
    """The fields of a PoseWithCovarianceStamped of rospy that ``read_pose`` reads."""
    pose = message.pose.pose
    position = {"x": pose.position.x, "y": pose.position.y}
    orientation = {"z": pose.orientation.z, "w": pose.orientation.w}
    header = {"frame_id": message.header.frame_id}
    return {"header": header, "pose": {"pose": {"position": position, "orientation": orientation}}}


class RosNode:
    """A node of rospy as a ``Transport``. A process has one."""

    def __init__(self, mailbox: Mailbox, outputs: Mapping[str, Output]):
        """Connect to the master of ROS_MASTER_URI.

        Raises:
            InputError: there is no rospy, or no master.
        """
        rospy = import_rospy()
        import genpy  # pyright: ignore[reportMissingImports]
        import rosgraph  # pyright: ignore[reportMissingImports]
        from geometry_msgs.msg import PoseWithCovarianceStamped, Twist  # pyright: ignore[reportMissingImports]
        from std_srvs.srv import Trigger, TriggerResponse  # pyright: ignore[reportMissingImports]

        self.address = os.environ.get("ROS_MASTER_URI", "")
        if not self.address:
            raise InputError("ros1: ROS_MASTER_URI is not set; set it to the master, such as http://127.0.0.1:11311.")
        if not rosgraph.is_master_online():
            raise InputError(f"ros1: no ROS master answers at {self.address}; start roscore, or set ROS_MASTER_URI.")
        listen_on_loopback(self.address, mailbox)
        rospy.init_node(mailbox.names.node, disable_signals=True)
        rospy.set_param("/use_sim_time", True)
        atexit.register(rospy.signal_shutdown, "the program ends")
        self._rospy = rospy
        self._rosgraph = rosgraph
        self._mailbox = mailbox
        self._advertise(genpy.Message, outputs)
        subscriptions = {
            mailbox.names.topic(COMMAND): (Twist, command_fields),
            mailbox.names.topic(POSE): (PoseWithCovarianceStamped, pose_fields),
        }
        self._subscribers = [self._subscribe(topic, *about) for topic, about in subscriptions.items()]
        self._services = [
            rospy.Service(service, Trigger, lambda _, name=name: TriggerResponse(*mailbox.request(name)))
            for service, name in mailbox.names.services.items()
        ]
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="sean-ros1", daemon=True)
        self._thread.start()

    def _advertise(self, base: type, outputs: Mapping[str, Output]) -> None:
        """Make a publisher for each topic of the simulation."""
        self._store = typestore(1)
        self._types = {topic: output.type for topic, output in outputs.items()}
        self._counts = {topic: itertools.count() for topic in outputs}
        self._classes = {kind: self._raw(base, kind) for kind in set(self._types.values())}
        self._publishers = {}
        for topic, output in outputs.items():
            self._publishers[topic] = self._rospy.Publisher(
                topic, self._classes[output.type], queue_size=QUEUE, latch=output.latched, tcp_nodelay=True
            )

    def _subscribe(self, topic: str, kind: type, fields: Callable[[Any], dict[str, Any]]) -> Any:
        """A subscriber that puts the fields of messages into the mailbox."""

        def receive(message: Any) -> None:
            self._mailbox.receive(topic, fields(message))

        return self._rospy.Subscriber(topic, kind, receive, queue_size=1, tcp_nodelay=True)

    def _raw(self, base: type, kind: str) -> type:
        """A class of rospy's messages whose only field is the message as bytes."""
        text, digest = self._store.generate_msgdef(kind)

        def init(self: Any, content: bytes = b"") -> None:
            self.content = content

        def serialize(self: Any, buffer: Any) -> None:
            buffer.write(self.content)

        attributes = {
            "__slots__": ["content"],
            "_slot_types": ["uint8[]"],
            "_has_header": False,
            "_type": kind.replace("/msg/", "/"),
            "_md5sum": digest,
            "_full_text": text,
            "__init__": init,
            "serialize": serialize,
        }
        return type("Raw", (base,), attributes)

    def wanted(self, topic: str) -> bool:
        """Whether a node subscribes to a topic; latched ones are kept for later."""
        publisher = self._publishers[topic]
        return publisher.impl.is_latch or publisher.get_num_connections() > 0

    def publish(self, topic: str, message: dict[str, Any]) -> None:
        """Send a message to all subscribers."""
        kind = self._types[topic]
        if "header" in message:  # as rospy counts the messages of a publisher
            message = {**message, "header": {**message["header"], "seq": next(self._counts[topic])}}
        content = self._store.serialize_ros1(fill(self._store, kind, message), kind)
        try:
            self._publishers[topic].publish(self._classes[kind](bytes(content)))
        except self._rospy.ROSException:  # the node has been shut down
            self._mailbox.end(self._ended())
            self._mailbox.check()

    def close(self) -> None:
        """End all connections; the node itself ends with the process."""
        self._closed.set()
        for service in self._services:
            service.shutdown("the bridge ends")
        for end in (*self._publishers.values(), *self._subscribers):
            end.unregister()
        self._thread.join(5.0)

    def _ended(self) -> str:
        """The sentence of a node that was shut down."""
        return (
            f"ros1: the node {self._rospy.get_name()} was shut down, by rosnode kill or by another node of this name; "
            "end the other node or give one of the two another --node-name, and start this command again."
        )

    def _watch(self) -> None:
        """Register again when a master has ended and another one has begun."""
        was_online = True
        master_id = self._master_id()
        looks = itertools.count(1)
        while not self._closed.wait(SHORT):
            if self._rospy.is_shutdown():
                return self._mailbox.end(self._ended())
            if next(looks) % round(WATCH / SHORT):
                continue
            now = self._master_id()
            if now is None and was_online:
                text = f"ros1: the master at {self.address} does not answer; existing connections go on."
                self._mailbox.log("ros1 lost", text)
            elif now is not None and now != master_id:
                try:
                    self._register()
                except Exception as error:  # the new master has ended, too
                    self._mailbox.log("ros1 error", f"ros1: registration at the new master failed: {error}.")
                    now = None
                else:
                    master_id = now
                    self._mailbox.log("ros1 back", f"ros1: the node is registered at a new master at {self.address}.")
            was_online = now is not None

    def _master_id(self) -> int | None:
        """The process of the master; None if it does not answer."""
        try:
            return int(self._rosgraph.Master(self._rospy.get_name()).getPid())
        except Exception:  # of sockets, XML and HTTP
            return None

    def _register(self) -> None:
        master = self._rosgraph.Master(self._rospy.get_name())
        uri = self._rospy.get_node_uri()
        self._rospy.set_param("/use_sim_time", True)
        for topic, kind in self._types.items():
            master.registerPublisher(topic, kind.replace("/msg/", "/"), uri)
        for subscriber in self._subscribers:
            publishers = master.registerSubscriber(subscriber.resolved_name, subscriber.type, uri)
            xmlrpc.client.ServerProxy(uri).publisherUpdate("/master", subscriber.resolved_name, publishers)
        for service in self._services:
            master.registerService(service.resolved_name, service.uri, uri)

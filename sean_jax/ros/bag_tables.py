"""What a bag says about people and the robot: its messages as tables, in the order in which they were recorded."""

import math
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.core.bounds import MAX_COORDINATE, MAX_PEOPLE, parse_digits
from sean_jax.io.files import file_error, suggest
from sean_jax.ros.bag_opening import BagMessage, OpenBag, open_bag
from sean_jax.ros.messages import SECOND

MAX_BYTES = 200_000_000  # of all tables of a bag
MAX_SPEED = 1e3  # m/s or rad/s of any number
UNKNOWN = math.nan, math.nan  # velocity of a person in messages without any
BASES = ("base_link", "base_footprint")  # frames of a robot
PEOPLE_WORDS = ("people", "person", "pedestrian", "agent", "human", "track")
SITUATIONS = "/social_sim/situations/rule_based/"

ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
PEOPLE_TYPES = (
    "social_sim_ros/msg/AgentArray",
    "people_msgs/msg/People",
    "geometry_msgs/msg/PoseArray",
    "visualization_msgs/msg/MarkerArray",
)
"""Message types of people, the best known first."""


class BagTable:
    """Rows of whole numbers and of others, with eight bytes for each."""

    def __init__(self, whole: int, numbers: int):
        self._whole = array("q")  # row after row
        self._numbers = array("d")
        self._whole_columns = whole
        self._number_columns = numbers

    def add(self, whole: tuple[int, ...], numbers: tuple[float, ...]) -> None:
        """Add a row."""
        self._whole.extend(whole)
        self._numbers.extend(numbers)

    def __len__(self) -> int:
        return len(self._whole) // self._whole_columns

    @property
    def size(self) -> int:
        """The memory of all rows in bytes."""
        return 8 * (len(self._whole) + len(self._numbers))

    @property
    def whole(self) -> np.ndarray:
        """(R, K) the whole numbers."""
        return np.array(self._whole, np.int64).reshape(len(self), self._whole_columns)

    @property
    def numbers(self) -> np.ndarray:
        """(R, K) the other numbers."""
        return np.array(self._numbers, float).reshape(len(self), self._number_columns)


class Names:
    """Numbers of names, in the order in which they were seen."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def __call__(self, name: str) -> int:
        """The number of a name."""
        return self._numbers.setdefault(name, len(self._numbers))

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def all(self) -> list[str]:
        """The names by number."""
        return list(self._numbers)


class BagRecording:
    """The messages of a bag. Rows begin with the time of receipt and the stamp [ns], 0 if the message has none."""

    def __init__(self) -> None:
        self.frames = Names()
        self.people_names = Names()
        self.situation_names = Names()
        self.transforms = BagTable(4, 3)  # parent, child; x, y, yaw
        self.static = BagTable(4, 3)  # likewise
        self.odometry = BagTable(3, 5)  # frame; x, y, yaw, m/s ahead, m/s to the left
        self.poses = BagTable(3, 3)  # frame; x, y, yaw: of the robot, without speeds
        self.people = BagTable(5, 5)  # frame, person, group or -1; x, y, vx, vy, yaw with NaN for what is not known
        self.commands = BagTable(2, 2)  # m/s, rad/s
        self.goals = BagTable(3, 2)  # frame; x, y
        self.maps = BagTable(2, 0)
        self.situations = BagTable(3, 1)  # situation; 1 while it holds
        self.robot_topic = ""  # as the user names it
        self.people_topic: str | None = None

    @property
    def tables(self) -> list[BagTable]:
        """All tables, to count their memory."""
        return [table for table in vars(self).values() if isinstance(table, BagTable)]


def read_bag(path: Path | str, people: str | None = None, robot: str | None = None) -> BagRecording:
    """The messages of a bag about people and the robot.

    Args:
        path: a .bag file, the folder of a rosbag2, or a .mcap or .db3 file in it.
        people: topic of the people; the first with people if None.
        robot: topic of the robot's pose; odometry, transforms or a pose, in this order, if None.

    Raises:
        FileError: the bag cannot be read, or has neither people nor a robot.
    """
    path = Path(path)
    with open_bag(path) as bag:
        for topic in (people, robot):
            if topic is not None and topic not in bag.types:
                raise file_error(path, f"has no topic {topic}{suggest(topic, bag.types) or '; it has others'}")
        people = people or _topic_of_people(bag.types)
        reader = Reader(path, bag, people, robot or _topic_of_robot(bag.types))
        reader.recording.robot_topic = robot or ""
        return reader.read()


def _topic_of_people(kinds: dict[str, str]) -> str | None:
    """The topic of people by its type, or by its type and name."""
    for kind in PEOPLE_TYPES:
        for name in sorted(kinds):
            speaks_of_people = kind in PEOPLE_TYPES[:2] or any(word in name.lower() for word in PEOPLE_WORDS)
            if kinds[name] == kind and speaks_of_people:
                return name
    return None


def _topic_of_robot(kinds: dict[str, str]) -> str | None:
    """Odometry, or else a pose with covariance, which counts if there are no transforms of the robot."""
    named = [name for name, kind in kinds.items() if kind == ODOMETRY]
    if named:
        return min(named, key=lambda name: (name not in ("/odom", "/robot_odom"), name))
    return next((name for name, kind in kinds.items() if kind == POSE_WITH_COVARIANCE and "initial" not in name), None)


class Reader:
    """Reads the messages of a bag into the tables of a ``BagRecording``."""

    def __init__(self, path: Path, bag: OpenBag, people: str | None, robot: str | None):
        self._path = path
        self._bag = bag
        self._people = people
        self._robot = robot
        self.recording = BagRecording()
        self.recording.people_topic = people

    def read(self) -> BagRecording:
        """All messages that count.

        Raises:
            FileError: the bag is damaged, too large, or has neither people nor a robot.
        """
        readers = self._readers()
        maps = [name for name, kind in self._bag.types.items() if kind == "nav_msgs/msg/OccupancyGrid"]
        recording = self.recording
        for message in self._bag.messages(readers, [name for name in maps if name not in readers]):
            if message.content is None:
                recording.maps.add((message.received, 0), ())
            else:
                readers[message.topic](message)
            if sum(table.size for table in recording.tables) > MAX_BYTES:
                raise self._error("has more than 200 MB of positions, transforms and commands; cut the bag")
        in_transforms = any(name in BASES for name in recording.frames.all)
        if not (len(recording.odometry) or len(recording.poses) or len(recording.people) or in_transforms):
            kinds = sorted(self._bag.types.items())
            listed = ", ".join(f"{name[:60]} ({kind.rpartition('/')[2][:40]})" for name, kind in kinds[:12])
            raise self._error(
                f"has neither people nor a robot that are known, but {listed or 'nothing'}; name them by "
                "--people-topic or --robot-topic"
            )
        return recording

    def _error(self, text: str) -> Exception:
        return file_error(self._path, text)

    def _readers(self) -> dict[str, Callable[[BagMessage], None]]:
        """Topic -> what reads its messages."""
        readers: dict[str, Callable[[BagMessage], None]] = {}
        for topic, kind in self._bag.types.items():
            if kind in TRANSFORMS:
                readers[topic] = self._transforms
            elif kind in TWISTS and topic.endswith("cmd_vel"):
                readers[topic] = self._command
            elif kind == POSE and "goal" in topic:
                readers[topic] = self._goal
            elif kind == "std_msgs/msg/Float32" and topic.startswith(SITUATIONS):
                readers[topic] = self._situation
        if self._people is not None:
            self._check_kind(self._people, PEOPLE_TYPES)
            readers[self._people] = self._people_of
        if self._robot is not None:
            self._check_kind(self._robot, (ODOMETRY, POSE_WITH_COVARIANCE, POSE))
            has_odometry = self._bag.types[self._robot] == ODOMETRY
            readers[self._robot] = self._odometry if has_odometry else self._pose
        return readers

    def _check_kind(self, topic: str, known: tuple[str, ...]) -> None:
        """FileError if the messages of a topic are of none of the known types."""
        kind = self._bag.types[topic]
        if kind not in known:
            names = ", ".join(name.replace("/msg", "") for name in known)
            raise self._error(f"{topic} has messages {kind}; give a topic of {names}")

    # ---------------------------------------------------------------- messages

    def _transforms(self, message: BagMessage) -> None:
        table = self.recording.static if message.topic.endswith("tf_static") else self.recording.transforms
        for stamped in message.content.transforms:
            origin = stamped.transform.translation
            pose = (origin.x, origin.y, _yaw(stamped.transform.rotation))
            if not all(abs(value) <= MAX_COORDINATE for value in pose):
                continue  # as tf2 does with transforms that are not finite
            parent = self._frame(stamped.header)
            child = self.recording.frames(_bare(stamped.child_frame_id))
            table.add((message.received, _stamp(stamped.header), parent, child), pose)

    def _odometry(self, message: BagMessage) -> None:
        content = message.content
        pose = self._checked_pose(message, content.pose.pose)
        speed = content.twist.twist.linear
        speeds = self._checked(message, "speed", (speed.x, speed.y), MAX_SPEED)
        self.recording.odometry.add(self._times(message), (*pose, *speeds))

    def _pose(self, message: BagMessage) -> None:
        pose = message.content.pose
        pose = self._checked_pose(message, pose.pose if hasattr(pose, "pose") else pose)
        self.recording.poses.add(self._times(message), pose)

    def _command(self, message: BagMessage) -> None:
        velocity = getattr(message.content, "twist", message.content)
        command = self._checked(message, "command", (velocity.linear.x, velocity.angular.z), MAX_SPEED)
        stamp = _stamp(getattr(message.content, "header", None))
        self.recording.commands.add((message.received, stamp), command)

    def _goal(self, message: BagMessage) -> None:
        x, y, _ = self._checked_pose(message, message.content.pose, "goal")
        self.recording.goals.add(self._times(message), (x, y))

    def _situation(self, message: BagMessage) -> None:
        number = self.recording.situation_names(message.topic.removeprefix(SITUATIONS))
        self.recording.situations.add((message.received, 0, number), (float(message.content.data > 0.5),))

    def _people_of(self, message: BagMessage) -> None:
        """Add the people of a message; its type says by a field which one it is."""
        content = message.content
        if hasattr(content, "people"):
            self._people_msgs(message)
        elif hasattr(content, "agents"):
            self._agents(message)
        elif hasattr(content, "poses"):
            self._poses(message)
        else:
            self._markers(message)

    def _people_msgs(self, message: BagMessage) -> None:
        for person in message.content.people:
            tags = dict(zip(person.tagnames, person.tags, strict=False))
            group = parse_digits(str(tags.get("group", "")))
            if group is None or group >= 2**31:  # 32 bits hold it
                group = -1
            velocity = person.velocity.x, person.velocity.y
            yaw = _number(tags.get("heading"))
            self._add_person(message, message.content.header, person.name, person.position, velocity, yaw, group)

    def _agents(self, message: BagMessage) -> None:
        for agent in message.content.agents:
            velocity = agent.twist.linear.x, agent.twist.linear.y
            yaw = _yaw(agent.pose.orientation)
            name = str(agent.track_id)
            self._add_person(message, message.content.header, name, agent.pose.position, velocity, yaw)

    def _poses(self, message: BagMessage) -> None:
        for index, pose in enumerate(message.content.poses):
            yaw = _yaw(pose.orientation)
            self._add_person(message, message.content.header, str(index), pose.position, UNKNOWN, yaw)

    def _markers(self, message: BagMessage) -> None:
        for marker in message.content.markers:
            if marker.action == 0 and marker.type in (1, 2, 3, 10):  # boxes, balls, cylinders, meshes
                yaw = _yaw(marker.pose.orientation)
                name = f"{marker.ns} {marker.id}"
                self._add_person(message, marker.header, name, marker.pose.position, UNKNOWN, yaw)

    def _add_person(
        self, message: BagMessage, header: Any, name: str, place: Any, velocity: tuple, yaw: float, group: int = -1
    ) -> None:
        """Add a person; FileError if a number is not finite, or there are too many people."""
        position = self._checked(message, f"{name[:40]}, a person,", (place.x, place.y), MAX_COORDINATE)
        if not all(math.isnan(value) for value in velocity):
            velocity = self._checked(message, f"the speed of {name[:40]}", velocity, MAX_SPEED)
        names = self.recording.people_names
        whole = (message.received, _stamp(header), self._frame(header), names(name), group)
        self.recording.people.add(whole, (*position, *velocity, yaw))
        if len(names) > MAX_PEOPLE:
            raise self._error(f"{message.topic}: has more than {MAX_PEOPLE:,} people; cut the bag")

    # ---------------------------------------------------------------- parts of messages

    def _frame(self, header: Any) -> int:
        return self.recording.frames(_bare(header.frame_id))

    def _times(self, message: BagMessage) -> tuple[int, int, int]:
        header = message.content.header
        return message.received, _stamp(header), self._frame(header)

    def _checked_pose(self, message: BagMessage, pose: Any, what: str = "robot") -> tuple[float, float, float]:
        x, y = self._checked(message, what, (pose.position.x, pose.position.y), MAX_COORDINATE)
        (yaw,) = self._checked(message, f"heading of the {what}", (_yaw(pose.orientation),), MAX_SPEED)
        return x, y, yaw

    def _checked(self, message: BagMessage, what: str, values: tuple[float, ...], limit: float) -> tuple[float, ...]:
        """The numbers of a message; FileError if one is not finite, or beyond the limit."""
        if not all(abs(value) <= limit for value in values):
            numbers = ", ".join(f"{value:g}" for value in values)
            raise self._error(f"{message.topic}: {what} is at ({numbers}); cut those messages out")
        return values


def _bare(frame: str) -> str:
    return frame.lstrip("/")


def _stamp(header: Any) -> int:
    """The time [ns] of a header; 0 if it has none."""
    if header is None:
        return 0
    return header.stamp.sec * SECOND + header.stamp.nanosec


def _yaw(turn: Any) -> float:
    """The angle [rad] of a quaternion about the vertical."""
    sine = 2 * (turn.w * turn.z + turn.x * turn.y)
    cosine = 1 - 2 * (turn.y * turn.y + turn.z * turn.z)
    return math.atan2(sine, cosine)


def _number(text: str | None) -> float:
    """A finite number in a text, or NaN."""
    try:
        value = float(text or "nan")
    except ValueError:
        return math.nan
    return value if abs(value) < 1e3 else math.nan

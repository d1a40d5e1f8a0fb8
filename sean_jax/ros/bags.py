"""Bags of ROS messages, written and read without ROS: rosbag 1 files, and rosbag2 folders with MCAP.

The package ``rosbags`` (extra ``ros``) does both. A bag holds the definitions of its messages, so readers do not need
this package. Reading takes people and the robot out of any bag, as positions at even times in one frame.
"""

import bisect
import contextlib
import dataclasses
import importlib.util
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from sean_jax import files, writing
from sean_jax.base import Trajectory
from sean_jax.errors import FileError, InputError
from sean_jax.quantities import MAX_COORDINATE, MAX_PEOPLE, check_number, parse_digits
from sean_jax.recordings import headings
from sean_jax.ros.messages import SECOND, Message, Topic, fill, typestore
from sean_jax.trajectories import save_trajectory

Version = Literal["1", "2", "both"]
PEOPLE, ROBOT = "people.csv", "trajectory.csv"  # of an import
FRAMES = 10  # frame numbers from row to row of people.csv, as in UCY's recordings
LONGEST_GAP = 2.0  # s: a person without messages for longer has left
MAX_CELLS = 20_000_000  # of times and people
BASES = ("base_link", "base_footprint")  # frames of a robot
PEOPLE_WORDS = ("people", "person", "pedestrian", "agent", "human", "track")
SITUATIONS = "/social_sim/situations/rule_based/"


def check_package() -> None:
    """Raise InputError if the package ``rosbags`` is missing."""
    if importlib.util.find_spec("rosbags") is None:
        raise InputError('rosbags is missing; pip install "sean_jax[ros]".')


# ------------------------------------------------------------------ writing


class Bag:
    """The bags of one episode: a file of rosbag 1, a folder of rosbag2, or both."""

    def __init__(self, folder: Path, name: str, table: dict[str, Topic], version: Version = "both"):
        """Bags ``NAME.bag`` and ``NAME`` in an existing folder; a context manager."""
        self.table, self.count = table, 0
        self._folder, self._name, self._version = folder, name, version
        self._stack = contextlib.ExitStack()
        self._writers: list[tuple[Any, Any, dict[str, Any], int]] = []

    def __enter__(self) -> "Bag":
        if self._version != "2":
            self._open_ros1()
        if self._version != "1":
            self._open_ros2()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def _open_ros1(self) -> None:
        from rosbags.rosbag1 import Writer

        store, writer = typestore(1), self._stack.enter_context(Writer(self._folder / f"{self._name}.bag"))
        connections = {
            name: writer.add_connection(name, topic.type, typestore=store, latching=int(topic.latched))
            for name, topic in self.table.items()
        }
        self._writers.append((writer, store, connections, 1))

    def _open_ros2(self) -> None:
        from rosbags.interfaces import (
            Qos,
            QosDurability,
            QosHistory,
            QosLiveliness,
            QosReliability,
            QosTime,
        )
        from rosbags.rosbag2 import StoragePlugin, Writer

        never = QosTime(sec=2**31 - 1, nsec=2**32 - 1)

        def qos(latched: bool) -> Any:
            durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
            times = (never, never, QosLiveliness.AUTOMATIC, never)
            return Qos(QosHistory.KEEP_LAST, 1 if latched else 10, QosReliability.RELIABLE, durability, *times, False)

        store = typestore(2)
        new = Writer(self._folder / self._name, version=9, storage_plugin=StoragePlugin.MCAP)
        writer = self._stack.enter_context(new)
        connections = {
            name: writer.add_connection(name, topic.type, typestore=store, offered_qos_profiles=[qos(topic.latched)])
            for name, topic in self.table.items()
        }
        self._writers.append((writer, store, connections, 2))

    def write(self, messages: dict[str, Message], time: int) -> None:
        """Add the messages of a time [ns] by topic."""
        for writer, store, connections, version in self._writers:
            for name, message in messages.items():
                kind = self.table[name].type
                filled = fill(store, kind, message)
                pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
                writer.write(connections[name], time, pack(filled, kind))
                self.count += 1


# ------------------------------------------------------------------ reading


class Pose(NamedTuple):
    """A pose on the plane."""

    x: float  # m
    y: float  # m
    yaw: float  # rad

    def then(self, inner: "Pose") -> "Pose":
        """A pose in the frame of this pose, in this pose's parent frame."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        x, y = self.x + cosine * inner.x - sine * inner.y, self.y + sine * inner.x + cosine * inner.y
        return Pose(x, y, self.yaw + inner.yaw)


NOWHERE = Pose(0.0, 0.0, 0.0)


class Transforms:
    """The transforms of /tf and /tf_static on the plane."""

    def __init__(self) -> None:
        """No transforms."""
        self.parent: dict[str, str] = {}
        self._times: dict[str, list[int]] = defaultdict(list)
        self._poses: dict[str, list[Pose]] = defaultdict(list)

    def add(self, parent: str, child: str, time: int, pose: Pose) -> None:
        """Add the pose of a frame in its parent's, at a time [ns]."""
        self.parent[child] = parent
        self._times[child].append(time)
        self._poses[child].append(pose)

    def sort(self) -> None:
        """Put the transforms into the order of time."""
        for child, times in self._times.items():
            order = np.argsort(times, kind="stable")
            self._times[child] = [times[k] for k in order]
            self._poses[child] = [self._poses[child][k] for k in order]

    def root(self, frame: str) -> str:
        """The frame at the end of the parents of a frame."""
        seen = {frame}
        while frame in self.parent and self.parent[frame] not in seen:
            frame = self.parent[frame]
            seen.add(frame)
        return frame

    def pose(self, frame: str, time: int) -> Pose:
        """The pose of a frame in its root, by the last transforms until a time [ns], or else the first ones."""
        result, seen = NOWHERE, set[str]()
        while frame in self.parent and frame not in seen:
            seen.add(frame)
            index = max(0, bisect.bisect_right(self._times[frame], time) - 1)
            result, frame = self._poses[frame][index].then(result), self.parent[frame]
        return result

    def times(self, frame: str) -> list[int]:
        """The times [ns] of the transforms of a frame."""
        return self._times.get(frame, [])


@dataclasses.dataclass
class Contents:
    """What a bag says about people and the robot. Times are ns."""

    frame: str  # of all positions
    robot: list[tuple[int, Pose]]
    speeds: list[tuple[int, float, float]]  # m/s ahead and to the left
    people: dict[str, list[tuple]]  # name -> (time, x, y, vx, vy, yaw, group); NaN: not known, group -1: none
    commands: list[tuple[int, float, float]]  # m/s, rad/s
    goals: list[tuple[int, float, float]]  # m
    situations: dict[str, list[tuple[int, bool]]]


def read(path: Path | str, people: str | None = None, robot: str | None = None) -> Contents:
    """The people and the robot of a bag.

    Args:
        path: a .bag file, the folder of a rosbag2, or a .mcap or .db3 file in it.
        people: topic of the people; the first with people if None.
        robot: topic of the robot's pose; odometry, transforms or a pose, in this order, if None.

    Raises:
        FileError: the bag cannot be read, or has neither people nor a robot.
    """
    check_package()
    path = Path(path)
    if not path.exists():
        raise files.file_error(path, "there is no such file; give a .bag file or the folder of a rosbag2")
    folder = path.parent if path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").is_file() else path
    from rosbags.highlevel import AnyReader

    try:
        with AnyReader([folder], default_typestore=typestore(2)) as reader:
            return _contents(path, reader, people, robot)
    except FileError:
        raise
    except Exception as error:  # rosbags and its decoders raise many types of errors for damaged files
        cause = writing.reason(error) or type(error).__name__
        cure = "mend it with `rosbag reindex` or `mcap recover`, or record it again"
        raise files.file_error(path, f"is no bag that can be read ({cause:.120}); {cure}") from None


def _contents(path: Path, reader: Any, people: str | None, robot: str | None) -> Contents:
    kinds = {name: info.msgtype for name, info in reader.topics.items()}
    for topic in (people, robot):
        if topic is not None and topic not in kinds:
            raise files.file_error(path, f"has no topic {topic}{files.suggest(topic, kinds) or '; it has others'}")
    people = people or _topic_of_people(kinds)
    transforms = Transforms()
    for connection, time, message in _messages(reader, kinds, ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")):
        del connection
        for each in message.transforms:
            place, turn = each.transform.translation, each.transform.rotation
            pose = Pose(place.x, place.y, _yaw(turn))
            names = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            transforms.add(*names, _time(each.header, time), pose)
    transforms.sort()
    robot_rows, speeds, frame = _robot(reader, kinds, robot, transforms)
    contents = Contents(frame, robot_rows, speeds, {}, [], [], {})
    if people is not None:
        contents.people, where = _people(path, reader, kinds, people, transforms)
        contents.frame = contents.frame or where
    if not contents.robot and not contents.people:
        listed = ", ".join(f"{name} ({kind.rpartition('/')[2]})" for name, kind in sorted(kinds.items())[:12])
        cure = "name them by --people-topic or --robot-topic"
        raise files.file_error(
            path, f"has neither people nor a robot that are known, but {listed or 'nothing'}; {cure}"
        )
    for connection, time, message in _messages(
        reader, kinds, ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
    ):
        if connection.topic.endswith("cmd_vel"):
            velocity = getattr(message, "twist", message)
            contents.commands.append((time, velocity.linear.x, velocity.angular.z))
    for connection, time, message in _messages(reader, kinds, ("geometry_msgs/msg/PoseStamped",)):
        if "goal" in connection.topic:
            pose = _in_root(transforms, message.header, time, message.pose)
            contents.goals.append((time, pose.x, pose.y))
    for connection, time, message in _messages(reader, kinds, ("std_msgs/msg/Float32",)):
        if connection.topic.startswith(SITUATIONS):
            name = connection.topic.removeprefix(SITUATIONS)
            contents.situations.setdefault(name, []).append((time, message.data > 0.5))
    return contents


def _messages(
    reader: Any, kinds: dict[str, str], wanted: Sequence[str], topic: str | None = None
) -> Iterator[tuple[Any, int, Any]]:
    """Connection, time [ns] and message of the topics of some types, or of one topic, in the order of time."""
    names = {name for name, kind in kinds.items() if kind in wanted and topic in (None, name)}
    connections = [each for each in reader.connections if each.topic in names]
    for connection, time, raw in reader.messages(connections) if connections else ():
        yield connection, time, reader.deserialize(raw, connection.msgtype)


def _time(header: Any, received: int) -> int:
    """The time [ns] of a header, or when its message was received if it has none."""
    return (header.stamp.sec * SECOND + header.stamp.nanosec) or received


def _yaw(turn: Any) -> float:
    return math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y * turn.y + turn.z * turn.z))


def _in_root(transforms: Transforms, header: Any, received: int, pose: Any) -> Pose:
    inner = Pose(pose.position.x, pose.position.y, _yaw(pose.orientation))
    return transforms.pose(header.frame_id.lstrip("/"), _time(header, received)).then(inner)


def _robot(
    reader: Any, kinds: dict[str, str], topic: str | None, transforms: Transforms
) -> tuple[list[tuple[int, Pose]], list[tuple[int, float, float]], str]:
    """Poses and speeds of the robot, and the frame of the poses ("" without a robot)."""
    odometry, stamped = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped"
    rows, speeds, frame = [], [], ""
    if topic is None:
        named = [name for name, kind in kinds.items() if kind == odometry]
        topic = min(named, key=lambda name: (name not in ("/odom", "/robot_odom"), name)) if named else None
    base = next((name for name in BASES if name in transforms.parent), None)
    if topic is None and base is None:
        topic = next((name for name, kind in kinds.items() if kind == stamped and "initial" not in name), None)
    if topic is not None:
        for _, time, message in _messages(reader, kinds, (odometry, stamped, "geometry_msgs/msg/PoseStamped"), topic):
            pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            frame = frame or transforms.root(message.header.frame_id.lstrip("/"))
            at = _time(message.header, time)
            rows.append((at, _in_root(transforms, message.header, time, pose)))
            if kinds[topic] == odometry:
                speeds.append((at, message.twist.twist.linear.x, message.twist.twist.linear.y))
    elif base is not None:
        frame = transforms.root(base)
        rows = [(time, transforms.pose(base, time)) for time in transforms.times(base)]
    return rows, speeds, frame


PEOPLE_TYPES = (
    "social_sim_ros/msg/AgentArray",
    "people_msgs/msg/People",
    "geometry_msgs/msg/PoseArray",
    "visualization_msgs/msg/MarkerArray",
)
"""Message types of people, the best known first."""


def _topic_of_people(kinds: dict[str, str]) -> str | None:
    for kind in PEOPLE_TYPES:
        for name in sorted(name for name, each in kinds.items() if each == kind):
            if kind in PEOPLE_TYPES[:2] or any(word in name.lower() for word in PEOPLE_WORDS):
                return name
    return None


def _people(
    path: Path, reader: Any, kinds: dict[str, str], topic: str, transforms: Transforms
) -> tuple[dict[str, list[tuple]], str]:
    """The people of a topic by name, and the frame of their positions."""
    if kinds[topic] not in PEOPLE_TYPES:
        known = ", ".join(kind.replace("/msg", "") for kind in PEOPLE_TYPES)
        raise files.file_error(path, f"{topic} has messages {kinds[topic]}; give a topic of {known}")
    people: dict[str, list[tuple]] = defaultdict(list)
    unknown, frame = math.nan, ""

    def add(name: str, header: Any, time: int, place: Any, velocity: tuple, yaw: float, group: int) -> None:
        at = _time(header, time)
        parent = transforms.pose(header.frame_id.lstrip("/"), at)
        pose, flow = (
            parent.then(Pose(place.x, place.y, yaw)),
            Pose(0.0, 0.0, parent.yaw).then(Pose(velocity[0], velocity[1], 0.0)),
        )
        if not (abs(pose.x) <= MAX_COORDINATE and abs(pose.y) <= MAX_COORDINATE):
            raise files.file_error(path, f"{topic}: {name} is at ({pose.x:g}, {pose.y:g}); cut those messages out")
        people[name].append((at, pose.x, pose.y, flow.x, flow.y, pose.yaw, group))
        if len(people) > MAX_PEOPLE:
            raise files.file_error(path, f"{topic}: has more than {MAX_PEOPLE:,} people; cut the bag")

    for _, time, message in _messages(reader, kinds, PEOPLE_TYPES, topic):
        header = getattr(message, "header", None)
        if header is not None:
            frame = frame or transforms.root(header.frame_id.lstrip("/"))
        if hasattr(message, "people"):
            for each in message.people:
                tags = dict(zip(each.tagnames, each.tags, strict=False))
                number = parse_digits(str(tags.get("group", "")))
                group = -1 if number is None or number >= 2**31 else number  # 32 bits hold it
                velocity = each.velocity.x, each.velocity.y
                add(each.name, header, time, each.position, velocity, _number(tags.get("heading")), group)
        elif hasattr(message, "agents"):
            for each in message.agents:
                velocity, yaw = (each.twist.linear.x, each.twist.linear.y), _yaw(each.pose.orientation)
                add(str(each.track_id), header, time, each.pose.position, velocity, yaw, -1)
        elif hasattr(message, "poses"):
            for index, each in enumerate(message.poses):
                add(str(index), header, time, each.position, (unknown, unknown), _yaw(each.orientation), -1)
        else:
            for each in message.markers:
                if each.action == 0 and each.type in (1, 2, 3, 10):  # boxes, balls, cylinders, meshes
                    frame = frame or transforms.root(each.header.frame_id.lstrip("/"))
                    name, place = f"{each.ns} {each.id}", each.pose.position
                    add(name, each.header, time, place, (unknown, unknown), _yaw(each.pose.orientation), -1)
    return dict(people), frame


def _number(text: str | None) -> float:
    """A finite number in a text, or NaN."""
    try:
        value = float(text or "nan")
    except ValueError:
        return math.nan
    return value if abs(value) < 1e3 else math.nan


class Import(NamedTuple):
    """Result of an import."""

    folder: Path
    frames: int
    people: int
    robot: bool
    frame: str  # of the positions


def import_bag(
    path: Path | str, folder: Path | str, time_step: float = 0.1, people: str | None = None, robot: str | None = None
) -> Import:
    """Write the people of a bag as a recording, and with its robot as a trajectory.

    Args:
        folder: new or empty; ``people.csv`` is for playback and ``recordings.read`` with ``FRAMES`` / time_step frames
            a second, ``trajectory.csv`` for ``load_trajectory``.
        time_step: s between rows, between which the bag's positions are interpolated; 0.4 makes people.csv a
            recording in the format of ETH and UCY.
        people, robot: topics, as of ``read``.

    Raises:
        FileError: the bag cannot be used.
        WriteError: the folder cannot be written.
    """
    check_number("time_step", time_step, 1e-3, 10.0, "s")
    contents = read(path, people, robot)
    frames = as_trajectory(contents, time_step, Path(path))
    names = sorted(contents.situations)
    here = np.asarray(frames.present)
    with writing.atomic_folder(Path(folder)) as new:
        if contents.people:
            writing.write(new / PEOPLE, _recording(frames, time_step))
        if contents.robot:
            save_trajectory(frames, new / ROBOT, time_step=time_step, situations=names)
    return Import(Path(folder), len(here), here.shape[1], bool(contents.robot), contents.frame)


def _recording(frames: Trajectory, time_step: float) -> str:
    """The people of frames as a recording; velocities are those of the positions, as some trackers send zeros."""
    present, place, group = (np.asarray(part) for part in (frames.present, frames.people, frames.group))
    yaw = np.arctan2(*np.moveaxis(np.asarray(frames.people_heading, float), -1, 0)[::-1])
    flow = np.zeros(place.shape)
    both = present[1:] & present[:-1]
    flow[1:][both] = (np.diff(place, axis=0) / time_step)[both]
    first = both & ~np.concatenate([np.zeros_like(both[:1]), both[:-1]])
    flow[:-1][first] = flow[1:][first]
    lines = ["frame,id,x_m,y_m,vx_mps,vy_mps,theta_rad,group_id"]
    for t, n in np.argwhere(present):
        numbers = ",".join(repr(float(value)) for value in (*place[t, n], *flow[t, n], yaw[t, n]))
        lines.append(f"{FRAMES * t},{n},{numbers},{group[t, n]}")
    return "\n".join(lines) + "\n"


def as_trajectory(contents: Contents, time_step: float, path: Path) -> Trajectory:
    """The people and the robot of a bag at even times, (T, ...) numpy arrays.

    Rows begin with the robot's first pose, or without a robot with the first person. Without one, the robot stands at
    the origin.
    """
    step = round(time_step * SECOND)
    robot = sorted(contents.robot)
    times = np.array([time for time, _ in robot] or sorted(row[0] for rows in contents.people.values() for row in rows))
    count = int((times[-1] - times[0] + step // 1000) // step) + 1
    if count * max(1, len(contents.people)) > MAX_CELLS:
        raise files.file_error(path, f"{count:,} times of {len(contents.people):,} people are too many; cut the bag")
    grid = times[0] + step * np.arange(count)
    position, heading, velocity = np.zeros((count, 2)), np.tile([1.0, 0.0], (count, 1)), np.zeros((count, 2))
    if robot:
        x, y, yaw = np.array([pose for _, pose in robot]).T
        position = np.stack([_interpolated(grid, times, values) for values in (x, y)], -1)
        angle = _interpolated(grid, times, np.unwrap(yaw))
        heading = np.stack([np.cos(angle), np.sin(angle)], -1)
        if contents.speeds:
            at, ahead, left = np.array(sorted(contents.speeds)).T
            ahead, left = (_interpolated(grid, at.astype(np.int64), values) for values in (ahead, left))
            side = np.stack([-heading[:, 1], heading[:, 0]], -1)
            velocity = ahead[:, None] * heading + left[:, None] * side
        elif count > 1:
            velocity = np.gradient(position, time_step, axis=0)
    columns = [_walk(np.array(sorted(rows), float), grid, time_step) for rows in contents.people.values()]
    shape = (count, len(columns))
    people, flow, facing = (np.zeros((*shape, 2)) for _ in range(3))
    present, group = np.zeros(shape, bool), np.full(shape, -1, np.int32)
    for n, walk in enumerate(columns):
        people[:, n], flow[:, n], facing[:, n], present[:, n], group[:, n] = walk
    blind = present & np.isnan(facing[..., 0])
    if blind.any():
        facing = np.where(
            blind[..., None], np.asarray(headings(jnp.asarray(flow), jnp.asarray(present)), float), facing
        )
    goal = _latest(grid, contents.goals, position[-1] if robot else np.zeros(2))
    situations = [_latest(grid, rows, [0.0])[:, 0] > 0.5 for _, rows in sorted(contents.situations.items())]
    return Trajectory(
        **{
            "position": position,
            "heading": heading,
            "velocity": velocity,
            "action": _latest(grid, contents.commands, np.zeros(2)),
            "people": people,
            "people_velocity": flow,
            "people_heading": np.where(present[..., None], facing, 0.0),
            "group": group,
            "present": present,
            "goal": goal,
            "situations": np.stack(situations, -1) if situations else np.zeros((count, 0), bool),
            "active": np.ones(count, bool),
        }
    )


def _interpolated(grid: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at the times of the grid [ns], exact where the times agree."""
    begin = grid[0]
    return np.interp((grid - begin).astype(float), (times - begin).astype(float), values)


def _latest(grid: np.ndarray, rows: Sequence[tuple], default: Any) -> np.ndarray:
    """(T, K) the last values until each time of the grid, or the default before the first."""
    default = np.asarray(default, float)
    if not rows:
        return np.tile(default, (len(grid), 1))
    table = sorted(rows, key=lambda row: row[0])
    index = np.searchsorted([row[0] for row in table], grid, side="right") - 1
    values = np.array([row[1:] for row in table], float)
    return np.where((index >= 0)[:, None], values[np.maximum(index, 0)], default)


def _walk(rows: np.ndarray, grid: np.ndarray, time_step: float) -> tuple[np.ndarray, ...]:
    """Position, velocity, heading (NaN if not known), presence and group of a person at the times of the grid."""
    times = rows[:, 0].astype(np.int64)
    keep = np.append(np.diff(times) > 0, True)
    rows, times = rows[keep], times[keep]
    index = np.searchsorted(times, grid, side="right") - 1
    inside = (index >= 0) & (grid <= times[-1])
    before, after = np.clip(index, 0, len(times) - 1), np.clip(index + 1, 0, len(times) - 1)
    exact = times[before] == grid
    present = inside & (exact | (times[after] - times[before] <= LONGEST_GAP * SECOND))
    place = np.stack([_interpolated(grid, times, rows[:, k]) for k in (1, 2)], -1)
    if np.isnan(rows[:, 3]).any():
        flow = np.gradient(place, time_step, axis=0) if len(grid) > 1 else np.zeros_like(place)
    else:
        flow = np.stack([_interpolated(grid, times, rows[:, k]) for k in (3, 4)], -1)
    yaw = rows[before, 5]
    facing = np.stack([np.cos(yaw), np.sin(yaw)], -1)
    shown = present[:, None]
    return np.where(shown, place, 0.0), np.where(shown, flow, 0.0), facing, present, rows[before, 6].astype(np.int32)

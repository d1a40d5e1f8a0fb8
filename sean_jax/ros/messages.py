"""ROS messages of a state: which topics there are, and their messages as plain dictionaries.

A message is a nested dict with the field names of the ROS 2 definitions: a stamp is ``{"sec": 1, "nanosec": 0}``, the
matrix of a camera is ``k``, and there is no ``seq``. Long arrays are numpy arrays. ``step`` computes the arrays of a
step in one program; the functions of a ``Topic`` turn them into a message on the host. So a bag and a live robot have
the same messages.

Frames follow REP 105: ``map``, ``odom``, ``base_link`` (on the floor, x ahead), and one for each sensor. Odometry has
no errors, so ``odom`` lies on ``map``.
"""

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from PIL import Image

from sean_jax import sensors
from sean_jax.core.data_types import Array, Groups, Pedestrians, Scenario, Sensor, State
from sean_jax.sensors import Camera, Lidar, focal_length, sense
from sean_jax.simulation.scenario import results
from sean_jax.world import navigation as paths
from sean_jax.world import ros_map

Message = dict[str, Any]
Naming = Literal["ros", "sean"]

MAP, ODOM, BASE = "map", "odom", "base_link"  # frames
SECOND = 1_000_000_000  # ns
BEGIN = SECOND  # ns, stamp of the first state, as a time of 0 means no time in ROS
CORNERS = 48  # of a plan, at most
SPACING = 0.25  # m, between the poses of a plan
RESOLUTION = 0.05  # m, of a cell of the map
PERSON_HEIGHT = 1.73  # m
COLORS = {
    "people": (0.20, 0.45, 0.85, 1.0),
    "groups": (0.95, 0.60, 0.15, 0.9),
    "robot": (0.85, 0.20, 0.25, 1.0),
    "goal": (0.20, 0.65, 0.30, 0.6),
    "situations": (0.10, 0.10, 0.10, 1.0),
}
"""Red, green, blue, opacity of the markers of each namespace."""
COVARIANCE = np.diag([1e-6, 1e-6, 1e6, 1e6, 1e6, 1e-6]).reshape(-1)
"""Of odometry without errors on the plane: filters refuse zeros, and take large numbers as not measured."""
ARROW, CYLINDER, LINE_STRIP, TEXT = 0, 3, 4, 9  # types of markers
ADD, DELETE = 0, 2  # actions of markers
UINT16, FLOAT32 = 4, 7  # datatypes of a PointField
BYTES = {"byte": "uint8", "char": "uint8", "octet": "uint8"}
"""Names that ROS has for a byte -> its type."""


SEAN_TOPICS = {
    "/odom": "/robot_odom",
    "/scan": "/laser_raycast",
    "/goal": "/move_base_simple/goal",
    "/plan": "/move_base/GlobalPlanner/plan",
    "/cmd_vel": "/mobile_base_controller/cmd_vel",
    "/depth": "/center_depth",
    "/first_person": "/robot_firstperson_rgb",
    "/third_person": "/robot_thirdperson_rgb",
    "/overhead": "/robot_overhead_rgb",
}
"""Topic, or namespace of a camera -> its name in SEAN 2.0."""

_POSE, _HEADER = "geometry_msgs/Pose", "std_msgs/Header header"
_COUNTS = {
    "robot_on_person_intimate_dist_violations": "intimate_robot_on_person",
    "person_on_robot_intimate_dist_violations": "intimate_person_on_robot",
    "robot_on_person_personal_dist_violations": "personal_robot_on_person",
    "person_on_robot_personal_dist_violations": "personal_person_on_robot",
    "robot_on_person_collisions": "collision_robot_on_person",
    "person_on_robot_collisions": "collision_person_on_robot",
    "obj_collisions": "collision_with_obstacle",
}
"""Field of TrialInfo -> metric."""

DEFINITIONS = {
    "people_msgs/msg/Person": (
        "string name",
        "geometry_msgs/Point position",
        "geometry_msgs/Point velocity",
        "float64 reliability",
        "string[] tagnames",
        "string[] tags",
    ),
    "people_msgs/msg/People": (_HEADER, "people_msgs/Person[] people"),
    "social_sim_ros/msg/Agent": (
        _HEADER,
        "uint64 track_id",
        "string type",
        f"{_POSE} pose",
        "geometry_msgs/Twist twist",
    ),
    "social_sim_ros/msg/AgentArray": (_HEADER, "social_sim_ros/Agent[] agents"),
    "social_sim_ros/msg/SceneInfo": (
        _HEADER,
        "string scenario_name",
        f"{_POSE} robot_start_pose",
        f"{_POSE} robot_target_pose",
        "uint16 num_people",
        "uint16 num_groups",
        "string environment",
    ),
    "social_sim_ros/msg/TrialInfo": (
        _HEADER,
        "builtin_interfaces/Time trial_start",
        "float64 timeout_time",
        "string trial_name",
        "uint16 trial_number",
        "uint32 num_actors",
        f"{_POSE} robot_start",
        f"{_POSE} robot_goal",
        "float64 dist_to_target",
        "float64 min_dist_to_target",
        f"{_POSE}[] robot_poses",
        "builtin_interfaces/Time[] robot_poses_ts",
        "float64 min_dist_to_ped",
        *(f"uint32 {name}" for name in _COUNTS),
    ),
}
"""Message type -> its fields, of types that ROS's own packages lack. Source: wg-perception/people and SEAN 2.0's
social_sim_ros.
"""


@struct.dataclass
class StepValues:
    """The quantities of one step that messages need."""

    tick: Int[Array, ""]
    position: Float[Array, "2"]  # m, of the robot
    heading: Float[Array, "2"]  # unit vector
    velocity: Float[Array, "3"]  # m/s ahead, m/s to the left, rad/s
    command: Float[Array, "command"]  # m/s and rad/s; NaN: none
    people: Pedestrians
    groups: Groups
    start: Float[Array, "2"]  # m
    start_heading: Float[Array, "2"]  # unit vector
    goal: Float[Array, "2"]  # m
    goal_heading: Float[Array, "2"]  # unit vector
    plan: Float[Array, "K 2"]  # m, corners of the shortest path from the robot, then the goal
    situations: Bool[Array, "S"]
    metrics: dict[str, Array]  # of the whole episode so far
    readings: dict[str, Any]  # of the sensors


def step(scenario: Scenario, state: State, command: Float[Array, "command"]) -> StepValues:
    """The quantities of a state, and the command [m/s, rad/s] that led there. For ``jax.jit`` and ``jax.vmap``."""
    robot = state.robot
    task = state.task
    left = jnp.zeros_like(robot.speed) if robot.sideways is None else robot.sideways

    def corner(place: Array, _: None) -> tuple[Array, Array]:
        return paths.next_point(scenario.navigation, place, task.goal, task.paths_to_goal), place

    return StepValues(
        tick=state.tick,
        position=robot.position,
        heading=robot.heading,
        velocity=jnp.stack([robot.speed, left, robot.turn_rate]),
        command=command,
        people=state.pedestrians,
        groups=state.groups,
        start=task.start,
        start_heading=task.start_heading,
        goal=task.goal,
        goal_heading=task.goal_heading,
        plan=jax.lax.scan(corner, robot.position, length=CORNERS)[1],
        situations=state.situations,
        metrics={name: value.reshape(-1)[0] for name, value in results(scenario, state).items()},
        readings=sense(scenario, state),
    )


@dataclass(frozen=True)
class Topic:
    """A topic and its messages."""

    type: str  # such as sensor_msgs/msg/LaserScan
    message: Callable[[StepValues, int], Message]  # of a step on the host at a time [ns]
    latched: bool = False  # whether one message is enough until the next episode (ROS 2: transient local)
    sensor: str = ""  # whose reading the message has


def topics(scenario: Scenario, naming: Naming = "ros", number: int = 0) -> dict[str, Topic]:
    """The topics of a scenario: name -> type and messages.

    Args:
        naming: ``sean`` for the names of SEAN 2.0 and its own topics.
        number: of the episode, for SEAN's TrialInfo.
    """
    table = {
        "/clock": Topic("rosgraph_msgs/msg/Clock", lambda step, time: {"clock": stamp(time)}),
        "/tf": Topic("tf2_msgs/msg/TFMessage", _transforms),
        "/tf_static": Topic("tf2_msgs/msg/TFMessage", _static_transforms(scenario), latched=True),
        "/odom": Topic("nav_msgs/msg/Odometry", _odometry),
        "/map": Topic("nav_msgs/msg/OccupancyGrid", _occupancy_grid(scenario), latched=True),
        "/goal": Topic("geometry_msgs/msg/PoseStamped", _goal, latched=True),
        "/plan": Topic("nav_msgs/msg/Path", _plan),
        "/cmd_vel": Topic("geometry_msgs/msg/Twist", lambda step, time: twist(*_finite(step.command))),
        "/people": Topic("people_msgs/msg/People", _people),
        "/markers": Topic("visualization_msgs/msg/MarkerArray", _markers(scenario)),
    }
    for sensor in scenario.sensors:
        table |= _of_sensor(scenario, sensor, naming)
    if naming == "sean":
        table = {_sean_name(name): topic for name, topic in table.items()} | sean_topics(scenario, number)
    return table


def messages(table: dict[str, Topic], step: StepValues, time: int, latched: bool = False) -> dict[str, Message]:
    """The messages of a step on the host by topic, of latched topics or of the others.

    Args:
        time: ns, of the stamps.
    """
    return {name: topic.message(step, time) for name, topic in table.items() if topic.latched == latched}


def _sean_name(topic: str) -> str:
    """The name of a topic in SEAN 2.0, as a whole or by its namespace."""
    if topic in SEAN_TOPICS:
        return SEAN_TOPICS[topic]
    space, slash, name = topic[1:].partition("/")
    return SEAN_TOPICS.get(f"/{space}", f"/{space}") + slash + name


# --- parts of messages ---


def stamp(time: int) -> Message:
    """A time [ns] as a Time message."""
    return {"sec": int(time // SECOND), "nanosec": int(time % SECOND)}


def header(frame: str, time: int) -> Message:
    """The header of a message in a frame at a time [ns]."""
    return {"stamp": stamp(time), "frame_id": frame}


def vector(x: Any, y: Any, z: Any = 0.0) -> Message:
    """A Point or a Vector3."""
    return {"x": float(x), "y": float(y), "z": float(z)}


def rotation(heading: ArrayLike) -> Message:
    """The quaternion of a heading (2,) about the vertical."""
    x, y = np.asarray(heading, float)
    half = 0.5 * np.arctan2(y, x)
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(half)), "w": float(np.cos(half))}


def rotation_of_axes(axes: np.ndarray) -> Message:
    """The quaternion of a rotation matrix (3, 3), whose columns are the axes of the turned frame."""
    from scipy.spatial.transform import Rotation  # late: it takes time

    x, y, z, w = Rotation.from_matrix(axes).as_quat(canonical=True).tolist()
    return {"x": x, "y": y, "z": z, "w": w}


def pose(position: ArrayLike, heading: ArrayLike, height: float = 0.0) -> Message:
    """A Pose at a position (2,) [m] and a height [m], with a heading (2,)."""
    x, y = np.asarray(position, float)
    return {"position": vector(x, y, height), "orientation": rotation(heading)}


def twist(ahead: Any, left: Any, turn: Any) -> Message:
    """A Twist [m/s, m/s, rad/s]."""
    return {"linear": vector(ahead, left), "angular": vector(0.0, 0.0, turn)}


def transform(parent: str, child: str, time: int, origin: Message, turn: Message) -> Message:
    """A TransformStamped."""
    return {
        "header": header(parent, time),
        "child_frame_id": child,
        "transform": {"translation": origin, "rotation": turn},
    }


def color(values: tuple[float, ...]) -> Message:
    """A ColorRGBA."""
    return dict(zip("rgba", map(float, values), strict=True))


NO_ROTATION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def _present(people: Pedestrians | Groups) -> np.ndarray:
    """The indices of those who are there."""
    return np.flatnonzero(np.asarray(people.present))


def _finite(command: ArrayLike) -> tuple[float, float, float]:
    """Ahead, left and turn of a command, without those that mean none."""
    ahead, *left, turn = np.nan_to_num(np.asarray(command, float)).tolist()
    return ahead, left[0] if left else 0.0, turn


# --- the robot ---


def _transforms(step: StepValues, time: int) -> Message:
    return {
        "transforms": [
            transform(MAP, ODOM, time, vector(0.0, 0.0), NO_ROTATION),
            transform(ODOM, BASE, time, vector(*step.position), rotation(step.heading)),
        ]
    }


def _static_transforms(scenario: Scenario) -> Callable[[StepValues, int], Message]:
    mounts = {mount.name: mount for mount in reversed(scenario.robot.mounts)}  # the first of equal names
    places = []
    for sensor in scenario.sensors:
        device = getattr(sensor.read, "device", None)
        if device is None:
            continue
        origin = device.origin
        if origin is None:
            origin = mounts[device.name].origin if device.name in mounts else (0.0, 0.0, 0.0)
        axes = np.asarray(device.axes, float).reshape(3, 3)
        if isinstance(device, Camera):
            axes = axes * [1.0, -1.0, -1.0]  # ROS: z along the view, y down
        places.append((frame_of(sensor), vector(*np.asarray(origin, float)), rotation_of_axes(axes)))
    return lambda step, time: {"transforms": [transform(BASE, name, time, *place) for name, *place in places]}


def _odometry(step: StepValues, time: int) -> Message:
    return {
        "header": header(ODOM, time),
        "child_frame_id": BASE,
        "pose": {"pose": pose(step.position, step.heading), "covariance": COVARIANCE},
        "twist": {"twist": twist(*step.velocity), "covariance": COVARIANCE},
    }


def _goal(step: StepValues, time: int) -> Message:
    return {"header": header(MAP, time), "pose": pose(step.goal, step.goal_heading)}


def _plan(step: StepValues, time: int) -> Message:
    goal = np.asarray(step.goal, float)
    corners = np.asarray(step.plan, float)
    count = int(np.argmax((corners == goal).all(1))) or len(corners)  # the rest repeats the goal
    corners = np.concatenate([corners[:count], goal[None]])  # (C, 2)

    # A pose every 0.25 m.
    points = [corners[0]]
    for begin, end in zip(corners, corners[1:], strict=False):
        pieces = max(1, int(np.ceil(np.linalg.norm(end - begin) / SPACING)))
        points.extend(begin + (end - begin) * piece / pieces for piece in range(1, pieces + 1))

    # Each looks at the next one, and the last one as the robot shall at its goal.
    if len(points) > 1:
        headings = [*np.diff(points, axis=0), np.asarray(step.goal_heading)]
    else:
        headings = [np.asarray(step.heading, float)]
    plan_header = header(MAP, time)
    poses = []
    for point, heading in zip(points, headings, strict=True):
        poses.append({"header": plan_header, "pose": pose(point, heading)})
    return {"header": plan_header, "poses": poses}


def _occupancy_grid(scenario: Scenario) -> Callable[[StepValues, int], Message]:
    raster = ros_map.of_environment(scenario.environment, RESOLUTION)
    cells = np.where(raster.occupied, 100, 0).astype(np.int8).reshape(-1)
    rows, columns = raster.occupied.shape

    def message(step: StepValues, time: int) -> Message:
        corner = {"position": vector(*raster.origin), "orientation": NO_ROTATION}
        size = {"resolution": raster.resolution, "width": columns, "height": rows}
        return {
            "header": header(MAP, time),
            "info": {"map_load_time": stamp(time), **size, "origin": corner},
            "data": cells,
        }

    return message


# --- people ---


def _people(step: StepValues, time: int) -> Message:
    people = step.people
    rows = []
    for index in _present(people):
        x, y = np.asarray(people.heading[index], float)
        tags = {"heading": repr(float(np.arctan2(y, x)))}
        if people.group[index] >= 0:
            tags["group"] = str(int(people.group[index]))
        person = {
            "name": f"person_{index}",
            "position": vector(*people.position[index]),
            "velocity": vector(*people.velocity[index]),
            "reliability": 1.0,
            "tagnames": list(tags),
            "tags": list(tags.values()),
        }
        rows.append(person)
    return {"header": header(MAP, time), "people": rows}


# --- markers ---


def _markers(scenario: Scenario) -> Callable[[StepValues, int], Message]:
    person_radius = float(scenario.forces.walking.radius)
    robot_radius = float(scenario.robot.radius)
    goal_radius = float(scenario.goal_radius)
    names = [name.replace("_", " ") for name, _ in scenario.situations]

    def message(step: StepValues, time: int) -> Message:
        text = ", ".join(name for name, holds in zip(names, step.situations, strict=True) if holds)
        markers = [
            *_person_markers(step.people, person_radius),
            *_group_markers(step.groups),
            *_robot_markers(step, robot_radius, goal_radius),
            _text_marker(step, text),
        ]
        marker_header = header(MAP, time)
        return {"markers": [{"header": marker_header, **marker} for marker in markers]}

    return message


def _marker(
    space: str, number: int, kind: int, place: Message, size: tuple[float, ...], present: bool = True, **others: Any
) -> Message:
    """A Marker without its header; absent ones are deleted."""
    return {
        "ns": space,
        "id": number,
        "type": kind,
        "action": ADD if present else DELETE,
        "pose": place,
        "scale": vector(*size),
        "color": color(COLORS[space]),
        "lifetime": {"sec": 0, "nanosec": 0},
        "frame_locked": False,
        **others,
    }


def _person_markers(people: Pedestrians, radius: float) -> Iterator[Message]:
    """A cylinder, and an arrow on it along the heading, of each person."""
    for index, present in enumerate(people.present):
        position = people.position[index]
        heading = people.heading[index]
        body = pose(position, heading, PERSON_HEIGHT / 2)
        yield _marker("people", 2 * index, CYLINDER, body, (2 * radius, 2 * radius, PERSON_HEIGHT), present)
        head = pose(position, heading, PERSON_HEIGHT)
        yield _marker("people", 2 * index + 1, ARROW, head, (0.5, 0.08, 0.08), present)


def _group_markers(groups: Groups) -> Iterator[Message]:
    """A circle around each group."""
    angle = np.linspace(0.0, 2 * np.pi, 33)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    for index, present in enumerate(groups.present):
        center = np.asarray(groups.center[index])
        radius = np.asarray(groups.radius[index])
        outline = center + radius * circle  # (33, 2)
        points = [vector(x, y, 0.02) for x, y in outline]
        yield _marker("groups", index, LINE_STRIP, _origin_pose(), (0.05, 0.0, 0.0), present, points=points)


def _robot_markers(step: StepValues, radius: float, goal_radius: float) -> Iterator[Message]:
    """The robot, an arrow on it along the heading, and its goal."""
    body = pose(step.position, step.heading, 0.2)
    yield _marker("robot", 0, CYLINDER, body, (2 * radius, 2 * radius, 0.4))
    top = pose(step.position, step.heading, 0.45)
    yield _marker("robot", 1, ARROW, top, (3 * radius, 0.08, 0.08))
    goal = pose(step.goal, step.goal_heading, 0.01)
    yield _marker("goal", 0, CYLINDER, goal, (2 * goal_radius, 2 * goal_radius, 0.02))


def _text_marker(step: StepValues, text: str) -> Message:
    """The situations that hold, beside the robot as it is seen from above."""
    beside = pose(np.asarray(step.position) + [0.0, 0.6], step.heading, 1.0)
    return _marker("situations", 0, TEXT, beside, (0.0, 0.0, 0.4), text=text or " ")


def _origin_pose() -> Message:
    return {"position": vector(0.0, 0.0), "orientation": NO_ROTATION}


# --- sensors ---


def frame_of(sensor: Sensor) -> str:
    """The frame of a sensor; a camera's has z along the view."""
    device = getattr(sensor.read, "device", None)
    return f"{sensor.name}_optical_frame" if isinstance(device, Camera) else sensor.name


def _of_sensor(scenario: Scenario, sensor: Sensor, naming: Naming) -> dict[str, Topic]:
    """The topics of a sensor; none for sensors that are neither a camera nor a lidar."""
    device = getattr(sensor.read, "device", None)
    if isinstance(device, Lidar):
        miss = 0.0 if naming == "sean" else np.inf  # as REP 117 says, and as SEAN's lidar does
        return _of_lidar(sensor, device, scenario.time_step, miss)
    if isinstance(device, Camera):
        return _of_camera(sensor, device, compress=naming == "sean" and not hasattr(sensor.read, "measure"))
    return {}


def _of_lidar(sensor: Sensor, device: Lidar, time_step: float, miss: float) -> dict[str, Topic]:
    """Points of a lidar with several rings, or distances in one plane."""
    name = sensor.name
    frame = frame_of(sensor)

    def laser(step: StepValues, time: int) -> Message:
        return laser_scan(np.asarray(step.readings[name]), device, frame, time, time_step, miss)

    def cloud(step: StepValues, time: int) -> Message:
        return point_cloud(*sensors.point_cloud(device, np.asarray(step.readings[name])), frame, time)

    if device.elevations:
        return {f"/{name}/points": Topic("sensor_msgs/msg/PointCloud2", cloud, sensor=name)}
    topic = "/scan" if name == "lidar" else f"/{name}/scan"
    return {topic: Topic("sensor_msgs/msg/LaserScan", laser, sensor=name)}


def _of_camera(sensor: Sensor, device: Camera, compress: bool) -> dict[str, Topic]:
    """Pictures of a camera, and its lens if it has perspective."""
    name = sensor.name
    frame = frame_of(sensor)

    def picture(step: StepValues, time: int) -> Message:
        reading = np.asarray(step.readings[name])
        if reading.ndim == 2:
            return depth_image(reading, device.far, frame, time)
        return color_image(reading, frame, time)

    def packed(step: StepValues, time: int) -> Message:
        return compressed_image(np.asarray(step.readings[name]), frame, time)

    if compress:
        table = {f"/{name}/compressed": Topic("sensor_msgs/msg/CompressedImage", packed, sensor=name)}
    else:
        table = {f"/{name}/image_raw": Topic("sensor_msgs/msg/Image", picture, sensor=name)}
    if not device.orthographic:
        table[f"/{name}/camera_info"] = Topic(
            "sensor_msgs/msg/CameraInfo", lambda step, time: camera_info(device, frame, time)
        )
    return table


def laser_scan(
    distance: np.ndarray, device: Lidar, frame: str, time: int, time_step: float, miss: float = np.inf
) -> Message:
    """A LaserScan of distances (rays,) [m]; a ray that hits nothing has the distance ``miss``."""
    increment = device.span / device.count
    ranges = np.asarray(distance, np.float32)
    return {
        "header": header(frame, time),
        "angle_min": float(device.first),
        "angle_max": float(device.first + increment * (device.count - 1)),
        "angle_increment": float(increment),
        "time_increment": 0.0,
        "scan_time": float(time_step),
        "range_min": float(device.near),
        "range_max": float(device.far),
        "ranges": np.where(ranges >= np.float32(device.far), np.float32(miss), ranges),
        "intensities": np.zeros(0, np.float32),
    }


def depth_image(depth: np.ndarray, far: float, frame: str, time: int) -> Message:
    """An Image 32FC1 of distances (H, W) [m] along the view; +inf where nothing is nearer than ``far`` (REP 118)."""
    values = np.asarray(depth, np.float32)
    values = np.where(values >= np.float32(far), np.float32(np.inf), values)
    return _image(values.astype("<f4"), "32FC1", frame, time)


def color_image(rgb: np.ndarray, frame: str, time: int) -> Message:
    """An Image rgb8 of colors (H, W, 3) from 0 to 1."""
    return _image(_bytes(rgb), "rgb8", frame, time)


def compressed_image(rgb: np.ndarray, frame: str, time: int) -> Message:
    """A CompressedImage, as PNG, of colors (H, W, 3) from 0 to 1."""
    with io.BytesIO() as stream:
        Image.fromarray(_bytes(rgb)).save(stream, "PNG")
        data = np.frombuffer(stream.getvalue(), np.uint8)
    return {"header": header(frame, time), "format": "rgb8; png compressed bgr8", "data": data}


def _bytes(rgb: np.ndarray) -> np.ndarray:
    return np.round(255 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8)


def _image(pixels: np.ndarray, encoding: str, frame: str, time: int) -> Message:
    height, width = pixels.shape[:2]
    data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
    size = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": len(data) // height}
    return {"header": header(frame, time), **size, "data": data}


def camera_info(device: Camera, frame: str, time: int) -> Message:
    """The CameraInfo of a camera with perspective and no distortion."""
    # In ROS the middle of the first pixel is at 0, so the middle of the picture is half a pixel before its half.
    focal = focal_length(device)
    x = (device.width - 1) / 2
    y = (device.height - 1) / 2
    matrix = np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])
    return {
        "header": header(frame, time),
        "height": device.height,
        "width": device.width,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": matrix.reshape(-1),
        "r": np.eye(3).reshape(-1),
        "p": np.concatenate([matrix, np.zeros((3, 1))], 1).reshape(-1),
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def point_cloud(points: np.ndarray, ring: np.ndarray, frame: str, time: int) -> Message:
    """A PointCloud2 of points (P, 3) [m] and the number (P,) of the ring of each, with Velodyne names.

    Points that are not finite are kept, and ``is_dense`` says so.
    """
    values = np.zeros(len(points), [("xyz", "<f4", 3), ("ring", "<u2")])
    values["xyz"] = points
    values["ring"] = ring
    fields = [{"name": name, "offset": 4 * k, "datatype": FLOAT32, "count": 1} for k, name in enumerate("xyz")]
    fields += [{"name": "ring", "offset": 12, "datatype": UINT16, "count": 1}]
    return {
        "header": header(frame, time),
        "height": 1,
        "width": len(values),
        "fields": fields,
        "is_bigendian": False,
        "point_step": values.itemsize,
        "row_step": values.nbytes,
        "data": np.frombuffer(values.tobytes(), np.uint8),
        "is_dense": bool(np.isfinite(values["xyz"]).all()),
    }


# --- SEAN 2.0's own topics ---


def sean_topics(scenario: Scenario, number: int) -> dict[str, Topic]:
    """SEAN's topics beyond those that it shares with others; facts of its tcp_server.py."""
    name = f"{scenario.behavior.name.capitalize()}_{scenario.task_name}"
    trial = SeanTrial(name, number, scenario.environment.name, scenario.time_step, float(scenario.time_limit))
    space = "/social_sim/"
    table = {
        f"{space}agents": Topic("social_sim_ros/msg/AgentArray", _agents),
        f"{space}agent_positions": Topic("geometry_msgs/msg/PoseArray", _agent_positions),
        f"{space}group_positions": Topic("geometry_msgs/msg/PoseArray", _group_positions),
        f"{space}scene_info": Topic("social_sim_ros/msg/SceneInfo", trial.scene_info, latched=True),
        f"{space}metrics": Topic("social_sim_ros/msg/TrialInfo", trial.trial_info),
    }
    for index, (name, _) in enumerate(scenario.situations):
        table[f"{space}situations/rule_based/{name}"] = Topic("std_msgs/msg/Float32", _situation(index))
    return table


def _agents(step: StepValues, time: int) -> Message:
    people = step.people
    array_header = header(MAP, time)
    rows = []
    for index in _present(people):
        vx, vy = people.velocity[index]
        agent = {
            "header": array_header,
            "track_id": int(index),
            "type": "person",
            "pose": pose(people.position[index], people.heading[index]),
            "twist": twist(vx, vy, 0.0),
        }
        rows.append(agent)
    return {"header": array_header, "agents": rows}


def _agent_positions(step: StepValues, time: int) -> Message:
    people = step.people
    poses = [pose(people.position[index], people.heading[index]) for index in _present(people)]
    return {"header": header(MAP, time), "poses": poses}


def _group_positions(step: StepValues, time: int) -> Message:
    centers = np.asarray(step.groups.center)[np.asarray(step.groups.present)]
    return {"header": header(MAP, time), "poses": [pose(center, np.array([1.0, 0.0])) for center in centers]}


def _situation(index: int) -> Callable[[StepValues, int], Message]:
    return lambda step, time: {"data": float(step.situations[index])}


@dataclass(frozen=True)
class SeanTrial:
    """What SEAN's messages tell of an episode."""

    name: str
    number: int
    environment: str
    time_step: float  # s
    time_limit: float  # s

    def scene_info(self, step: StepValues, time: int) -> Message:
        """The SceneInfo of a step at a time [ns]."""
        return {
            "header": header(MAP, time),
            "scenario_name": self.name,
            "robot_start_pose": pose(step.start, step.start_heading),
            "robot_target_pose": pose(step.goal, step.goal_heading),
            "num_people": len(_present(step.people)),
            "num_groups": len(_present(step.groups)),
            "environment": self.environment,
        }

    def trial_info(self, step: StepValues, time: int) -> Message:
        """The TrialInfo of a step at a time [ns]."""
        begin = time - round(int(step.tick) * self.time_step * SECOND)
        to_goal = np.linalg.norm(np.asarray(step.position) - np.asarray(step.goal))
        return {
            "header": header(MAP, time),
            "trial_start": stamp(max(0, begin)),
            "timeout_time": self.time_limit,
            "trial_name": self.name,
            "trial_number": self.number % 2**16,
            "num_actors": len(_present(step.people)),
            "robot_start": pose(step.start, step.start_heading),
            "robot_goal": pose(step.goal, step.goal_heading),
            "dist_to_target": float(to_goal),
            "min_dist_to_target": float(step.metrics.get("min_distance_to_goal", np.nan)),
            "robot_poses": [],
            "robot_poses_ts": [],
            "min_dist_to_ped": float(step.metrics.get("min_distance_to_people", np.nan)),
            **{field: int(step.metrics.get(metric, 0)) for field, metric in _COUNTS.items()},
        }


# --- classes of rosbags ---


def typestore(ros: Literal[1, 2]) -> Any:
    """The message types of Noetic or Jazzy as of the package ``rosbags``, with those of ``DEFINITIONS``."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    own = {**DEFINITIONS, "tf2_msgs/msg/TFMessage": ("geometry_msgs/TransformStamped[] transforms",)}
    for name, fields in own.items():
        if name not in store.fielddefs:
            types |= get_types_from_msg("\n".join(fields), name)
    store.register(types)
    return store


def fill(store: Any, kind: str, message: Message) -> Any:
    """The object of a message type that a ``typestore`` writes; fields that the message lacks are 0 or empty.

    Raises:
        ValueError: the type lacks a field of the message.
    """
    fields = dict(store.fielddefs[kind][1])
    lower = {name.lower() for name in fields}
    if unknown := [name for name in message if name not in fields and name not in lower]:
        raise ValueError(f"{kind}: has no fields {', '.join(unknown)}")
    values = {}
    for name, field in fields.items():
        values[name] = _value(store, field, message.get(name, message.get(name.lower())))
    return store.types[kind](**values)


def _value(store: Any, field: tuple, value: Any) -> Any:
    """The value of a field, which is of a type (kind, inner) as the typestore describes it; 0 or empty for None."""
    kind, inner = field
    name = getattr(kind, "name", kind)
    if name == "NAME":
        return fill(store, inner, value or {})
    if name == "BASE":
        return _zero(inner[0]) if value is None else value

    # An array or a sequence, of messages, of texts or of numbers.
    (element, about), count = inner
    if getattr(element, "name", element) == "NAME":
        return [fill(store, about, item) for item in ([] if value is None else value)]
    base = about[0]
    if base == "string":
        return list(value or [])
    dtype = np.dtype(BYTES.get(base, base))
    if value is None:
        return np.zeros(count if name == "ARRAY" else 0, dtype)
    return np.asarray(value, dtype)


def _zero(base: str) -> str | bool | float | int:
    """The value of a field that a message lacks, by its type."""
    if base == "string":
        return ""
    if base == "bool":
        return False
    return 0.0 if base.startswith("float") else 0

"""The shared data of a scenario (section IV-B) and the signatures that a user's own function must have.

Units are SI, angles are radians, the ground plane is (x, y) with z up. Headings are unit vectors. Absent
people are masked by ``present``, never NaN. ``N`` people, ``G`` groups, ``W`` obstacles, ``S`` situations,
``V`` via points of a navigation table. None of these has a batch axis: ``jax.vmap`` adds it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
from flax import struct

Array = jax.Array


@struct.dataclass
class Pedestrians:
    position: Array  # (N, 2) m
    velocity: Array  # (N, 2) m/s
    heading: Array  # (N, 2) unit vector
    desired_velocity: Array  # (N, 2) m/s, set by the behavior, followed by the pedestrian model
    group: Array  # (N,) int32 index of the group that the person stands in, -1 none
    party: Array  # (N,) int32 index of whoever leads the party that the person walks in, -1 none
    present: Array  # (N,) bool
    preferred_speed: Array  # (N,) m/s, drawn per episode
    robot_distance: Array  # (N,) m, drawn per episode: how much farther from a moving robot than from a person


@struct.dataclass
class Groups:
    """Conversational groups: each with one place left open, where a robot can join (section IV-E)."""

    center: Array  # (G, 2) m, centre of the o-space
    radius: Array  # (G,) m, of the ring on which members stand
    opening: Array  # (G, 2) m, the open place on that ring
    present: Array  # (G,) bool


@struct.dataclass
class Robot:
    """The one place of a robot's pose and speed: the physics go on from what is replaced here."""

    position: Array  # (2,) m
    heading: Array  # (2,) unit vector; of another one the direction counts, from the next step on
    speed: Array  # () m/s, along the heading
    turn_rate: Array  # () rad/s, counter-clockwise
    body: Any  # of the robot model: wheels, slip, the last command and its age; nothing that stands above


@struct.dataclass
class Obstacles:
    """Upright boxes: the one source of geometry for forces, navigation and contact.

    Those of no height are edges of the floor, which hold who comes there and which nobody sees.
    """

    center: Array  # (W, 2) m
    half_extent: Array  # (W, 2) m
    yaw: Array  # (W,) rad
    height: Array  # (W,) m


@struct.dataclass
class Nearby:
    """For each cell of a grid the obstacles within reach of it: what people and robots feel, without the rest."""

    rows: Array  # (X, Y, K, 6): center x, y and half extent x, y [m], cosine and sine of the yaw; spare rows far away
    origin: Array  # (2,) m, lower left corner of the grid
    cell: Array  # () m, side of a cell


@struct.dataclass
class Solids:
    """Bodies as rays see them, each with a color (3,): red, green and blue from 0 to 1."""

    boxes: Array  # (B, 8): middle x, y, z, half extent x, y, z [m], cosine and sine of the yaw
    cylinders: Array  # (C, 8): middle x, y, z [m], axis x, y, z (unit), radius, half length [m]
    spheres: Array  # (S, 4): middle x, y, z, radius [m]
    color: Array  # (B + C + S, 3) of the boxes, then the cylinders, then the spheres


@struct.dataclass
class Scenery:
    """What an environment looks like."""

    solids: Solids  # the obstacles that have a height first, then what nothing can touch
    floor: Array  # (2, 3) two colors of its squares
    square: Array  # () m, side of a square
    sky: Array  # (2, 3) colors at the zenith and at the horizon
    sun: Array  # (3,) unit vector towards the light


@struct.dataclass
class Environment:
    """A physical environment (section IV-C)."""

    floor: Array  # (4,) m: x_min, y_min, x_max, y_max
    obstacles: Obstacles
    nearby: Nearby
    scenery: Scenery
    name: str = struct.field(pytree_node=False)
    open: bool = struct.field(pytree_node=False, default=False)  # whether people and robots may leave the floor


@struct.dataclass
class RobotTask:
    """Where the robot starts and where it shall go (section IV-E)."""

    start: Array  # (2,) m
    start_heading: Array  # (2,) unit vector
    goal: Array  # (2,) m
    goal_heading: Array  # (2,) unit vector
    start_group: Array  # () int32 index of the group that the start is a member's place of, -1 none
    goal_group: Array  # () int32 likewise for the goal
    geodesic: Array  # () m, length of the shortest path from start to goal
    to_goal: Array  # (2, V) shortest paths to the goal from each bend: m, inf if none leads there; rad, where it leaves
    turning: Array | None = None  # () rad, rotation along the shortest path from the start's heading; reset fills it in


@struct.dataclass
class Moment:
    """A robot among people at one moment, as arrays alone: all that situations and metrics read.

    A simulation fills it from its state (``scenario.moment``); a recording can fill it as well.
    """

    people: Pedestrians
    position: Array  # (2,) m, of the robot
    heading: Array  # (2,) unit vector
    velocity: Array  # (2,) m/s
    start: Array  # (2,) m
    goal: Array  # (2,) m
    start_group: Array  # () int32, -1 none
    goal_group: Array  # () int32, -1 none
    geodesic: Array  # () m, shortest path from start to goal
    situations: Array  # (S,) bool, () of zeros before they are classified
    tick: Array  # () int32
    robot_radius: Array  # () m
    person_radius: Array  # () m
    time_step: float = struct.field(pytree_node=False)  # s
    obstacles: Obstacles | None = None  # all upright boxes; None where nothing is known of them
    turning: Array | None = None  # () rad, rotation along the shortest path from the start's heading; None: straight
    goal_radius: Array | None = None  # () m, inside it the goal is reached; None: SEAN's 1.2
    robot_top_speed: Array | None = None  # () m/s; None: Kuri's 0.5


@struct.dataclass
class Streams:
    """The chance of an episode, () typed PRNG keys: a use at a tick draws from ``fold_in(stream, tick)`` alone."""

    people: Array  # of the pedestrian behavior
    policy: Array  # of who drives
    sensors: Array  # of the noise that a caller adds; further split by whoever has several sensors
    restart: Array  # of what follows the episode


@struct.dataclass
class State:
    """Everything that the future depends on: equal states and equal actions give equal futures."""

    streams: Streams  # never advanced
    tick: Array  # () int32, steps taken
    pedestrians: Pedestrians
    groups: Groups
    robot: Robot
    task: RobotTask
    memory: Any  # of the pedestrian behavior
    situations: Array  # (S,) bool, in the order of scenario.situations
    metrics: Any  # dict of name -> running value
    ticks_at_goal: Array  # () int32, steps spent inside the goal radius without a break
    completed: Array  # () bool, latched
    timed_out: Array  # () bool, latched; never together with completed
    driver: Any = ()  # what a Driver remembers; () for a policy that remembers nothing


@struct.dataclass
class Behavior:
    """A pedestrian behavior (section IV-D): who goes where.

    ``reset(scenario, key) -> (Pedestrians, Groups, memory)``
    ``direct(scenario, state, key) -> State`` with new desired velocities, group members and memory.
    """

    data: Any  # what the functions look up
    name: str = struct.field(pytree_node=False)
    reset: Callable = struct.field(pytree_node=False)
    direct: Callable = struct.field(pytree_node=False)
    companions: Array | None = None  # (N, 2) int32, those that each person walks with, -1 none; None: all walk alone


class Mount(NamedTuple):
    """Where a sensor sits on a robot."""

    name: str
    origin: tuple[float, ...]  # (3,) m in the robot's frame: x ahead, y to the left, z up from the floor
    axes: tuple[float, ...]  # (9,) unit vectors x, y, z (a camera's right, up and back), as columns row by row
    fovy: float  # degrees, vertical field of view; 0 for what is no camera


@struct.dataclass
class RobotModel:
    """A robot (Fig. 3): its limits and how it moves.

    ``place(model, position, heading) -> Robot`` at rest;
    ``drive(scenario, state, action) -> Robot`` one control step later.
    """

    mass: Array  # () kg, wheels included
    inertia: Array  # () kg m2 about the vertical axis
    wheel_radius: Array  # () m
    wheel_inertia: Array  # () kg m2, about its axle, gears included
    track: Array  # () m between the wheels, effective for skid steer
    friction: Array  # () tyre friction coefficient
    servo_gain: Array  # () N m s/rad, of the wheel speed servo
    servo_torque: Array  # () N m, at most
    max_speed: Array  # () m/s
    max_turn_rate: Array  # () rad/s
    max_acceleration: Array  # () m/s2
    max_turn_acceleration: Array  # () rad/s2
    command_timeout: Array  # () s, for which a command holds when no new one (a NaN) follows it; then the robot stops
    data: Any  # the MJX model, or ()
    solids: Solids  # what it looks like, in its own frame
    name: str = struct.field(pytree_node=False)
    mounts: tuple[Mount, ...] = struct.field(pytree_node=False)
    radius: float = struct.field(pytree_node=False)  # m, of the disc that touches people and obstacles
    time_step: float = struct.field(pytree_node=False)  # s, of the physics
    place: Callable = struct.field(pytree_node=False)
    drive: Callable = struct.field(pytree_node=False)
    max_reverse_speed: Array | None = None  # () m/s, backward; None: max_speed
    max_deceleration: Array | None = None  # () m/s2, by which the speed ahead may fall; None: max_acceleration


@struct.dataclass
class Scenario:
    """A physical environment, a pedestrian behavior and a robot task (section IV-B), with all that they look up."""

    environment: Environment
    navigation: Any  # navigation.Navigation for the robot's radius
    behavior: Behavior
    forces: Any  # social_forces.Parameters
    thresholds: Any  # classifiers.Thresholds
    goal_radius: Array  # () m, the goal is reached inside it
    hold_time: Array  # () s, to be spent inside it for the task to be completed
    task_distance: Array  # (2,) m, least and greatest geodesic distance from start to goal
    robot: RobotModel
    task: Callable = struct.field(pytree_node=False)  # (scenario, pedestrians, groups, memory, key) -> RobotTask
    move: Callable = struct.field(pytree_node=False)  # (scenario, state) -> Pedestrians: the pedestrian model
    situations: tuple = struct.field(pytree_node=False)  # ((name, (moment, thresholds) -> () bool), ...)
    metrics: tuple = struct.field(pytree_node=False)  # ((name, metrics.Metric), ...)
    time_step: float = struct.field(pytree_node=False)  # s, of control
    time_limit: float = struct.field(pytree_node=False)  # s
    people: int = struct.field(pytree_node=False)
    substeps: int = struct.field(pytree_node=False)  # of the social forces in a step of control
    task_name: str = struct.field(pytree_node=False)


@struct.dataclass
class Frame:
    """What a rollout keeps of each step: enough to draw, and to compute anything of section IV-H afterwards."""

    position: Array  # (2,) m, of the robot
    heading: Array  # (2,) unit vector
    velocity: Array  # (2,) m/s
    action: Array  # (2,) m/s and rad/s, the command that led here
    people: Array  # (N, 2) m
    people_velocity: Array  # (N, 2) m/s
    people_heading: Array  # (N, 2) unit vector
    group: Array  # (N,) int32, -1 none
    present: Array  # (N,) bool
    goal: Array  # (2,) m
    situations: Array  # (S,) bool
    active: Array  # () bool, the episode had not ended before this step


@struct.dataclass
class Driver:
    """A policy that has learned something, or that remembers: who drives when the state alone does not tell how.

    ``start(scenario, data, state) -> memory`` of an episode that begins in that state;
    ``drive(scenario, data, state, key) -> (command (2,), memory)``, where ``state.driver`` is the memory until then.
    """

    data: Any  # leaves, such as the parameters of a network
    name: str = struct.field(pytree_node=False)
    start: Callable = struct.field(pytree_node=False)
    drive: Callable = struct.field(pytree_node=False)


Policy = Callable[[Scenario, State, Array], Array] | Driver  # (scenario, state, key) -> (2,) linear m/s, angular rad/s

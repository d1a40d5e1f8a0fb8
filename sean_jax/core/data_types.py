"""The data types that all rooms share (section IV-B), and the signatures of a user's own functions.

Units are SI, angles are radians, the ground plane is (x, y) with z up. Headings are unit vectors. Absent people are
masked by ``present``; NaN never marks anything.

Shapes stand in the annotations, with one letter for each dimension: ``N`` people, ``G`` groups, ``W`` obstacles, ``S``
situations, ``V`` corner arcs of shortest paths, ``M`` nodes of a behavior graph, ``B`` batch, ``T`` time, ``E``
episodes, ``P`` places. No type has a batch axis: ``jax.vmap`` adds it. Tests check the shapes:
``tests/support/shapes.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, PyTree

if TYPE_CHECKING:
    Array = jax.Array
else:  # every function takes arrays and scalars of numpy as well, so checks of shapes have to accept them
    Array = jax.Array | np.ndarray | np.generic

FAR = 1e4  # m, where unused rows lie
SMALL = 0.01  # m, size of bodies there
NO_BOX = FAR, FAR, FAR, SMALL, SMALL, SMALL, 1.0, 0.0
NO_CYLINDER = FAR, FAR, FAR, 0.0, 0.0, 1.0, SMALL, SMALL
NO_SPHERE = FAR, FAR, FAR, SMALL
NO_OBSTACLE = FAR, FAR, 0.0, 0.0, 1.0, 0.0


@struct.dataclass
class Traits:
    """What distinguishes people: standard normal numbers, which the deviations of the forces multiply."""

    relaxation: Float[Array, "N"]
    headway: Float[Array, "N"]
    width: Float[Array, "N"]
    side: Float[Array, "N"]


@struct.dataclass
class Reaction:
    """How people react to the robot and to a phone in their hand, as ``social_forces.Reactions`` draws it."""

    kind: Int[Array, "N"]  # of ``social_forces.Kind``
    alertness: Float[Array, "N"]  # 1, share of the time ahead in which the person notices others; 1 without a phone
    attention: Float[Array, "N"]  # 1, to the robot now, from 0 to 1
    patience: Float[Array, "N"]  # s, for which the person still attends to the robot


@struct.dataclass
class Pedestrians:
    """The people of a scenario, present or not."""

    position: Float[Array, "N 2"]  # m
    velocity: Float[Array, "N 2"]  # m/s
    heading: Float[Array, "N 2"]  # unit vector
    desired_velocity: Float[Array, "N 2"]  # m/s, set by the behavior, followed by the pedestrian model
    group: Int[Array, "N"]  # index of the conversational group in which the person stands, -1 none
    walking_group: Int[Array, "N"]  # index of the leader of the person's walking group, -1 none
    present: Bool[Array, "N"]
    preferred_speed: Float[Array, "N"]  # m/s, drawn per episode
    robot_distance: Float[Array, "N"]  # m, drawn per episode: added distance to a moving robot
    traits: Traits | None = None  # drawn per episode; None if the forces have no deviations
    noise: Float[Array, "N 2"] | None = None  # 1, of the drive, forward and to the left; None without a term ``Noise``
    reaction: Reaction | None = None  # drawn per episode; None without a term ``Reactions``


@struct.dataclass
class Groups:
    """Conversational groups (section IV-E). Each leaves one place open, where a robot can join."""

    center: Float[Array, "G 2"]  # m, centre of the o-space
    radius: Float[Array, "G"]  # m, of the ring on which members stand
    opening: Float[Array, "G 2"]  # m, the open place on that ring
    present: Bool[Array, "G"]


@struct.dataclass
class Robot:
    """A robot's pose and speed, and their only place: physics continue from values that are replaced here."""

    position: Float[Array, "2"]  # m
    heading: Float[Array, "2"]  # unit vector; normalised at the next step
    speed: Float[Array, ""]  # m/s, along the heading
    turn_rate: Float[Array, ""]  # rad/s, counter-clockwise
    drive_state: PyTree  # more state of the robot model, such as wheel angles, slip and the last command
    sideways: Float[Array, ""] | None = None  # m/s, to the left; None: of a differential drive, which rolls ahead


@struct.dataclass
class Obstacles:
    """Upright boxes: the one source of geometry for forces, navigation and contact.

    Boxes of no height are edges of the floor. They stop people and robots, and sensors do not see them.
    """

    center: Float[Array, "W 2"] = struct.field(metadata={"pad": FAR})  # m
    half_extent: Float[Array, "W 2"] = struct.field(metadata={"pad": 1.0})  # m
    yaw: Float[Array, "W"]  # rad
    height: Float[Array, "W"]  # m


@struct.dataclass
class ObstacleGrid:
    """The obstacles near each cell of a grid, so that forces and costs need not look at all obstacles."""

    # center x, y, half extent x, y [m], cosine, sine of yaw; unused rows lie far away
    rows: Float[Array, "X Y K 6"] = struct.field(metadata={"pad": NO_OBSTACLE})
    origin: Float[Array, "2"]  # m, lower left corner of the grid
    cell: Float[Array, ""]  # m, side of a cell


PATTERNS = ("plain", "wall", "shelf", "facade")
"""What color cameras see on the sides of a body."""


@struct.dataclass
class Solids:
    """Bodies as rays see them."""

    # middle x, y, z, half extent x, y, z [m], cosine and sine of the yaw
    boxes: Float[Array, "boxes 8"] = struct.field(metadata={"pad": NO_BOX})
    # middle x, y, z [m], axis x, y, z (unit), radius, half length [m]
    cylinders: Float[Array, "cylinders 8"] = struct.field(metadata={"pad": NO_CYLINDER})
    spheres: Float[Array, "spheres 4"] = struct.field(metadata={"pad": NO_SPHERE})  # middle x, y, z, radius [m]
    color: Float[Array, "solids 4"]  # red, green, blue from 0 to 1, index into PATTERNS: boxes, cylinders, spheres


@struct.dataclass
class Scenery:
    """The looks of an environment."""

    solids: Solids  # first the obstacles that have a height, then decoration
    floor: Float[Array, "3 3"]  # the two colors of its squares, and of the joints
    square: Float[Array, ""]  # m, side of a square; a joint follows every second one
    joint: Float[Array, ""]  # m, width of a joint; 0: none
    ceiling: Float[Array, ""]  # m, height of the ceiling, which color cameras see; 0: none, but sky
    sky: Float[Array, "2 3"]  # colors at the zenith and at the horizon
    sun: Float[Array, "3"]  # unit vector towards the light


@struct.dataclass
class Environment:
    """A physical environment (section IV-C)."""

    floor: Float[Array, "4"]  # m: x_min, y_min, x_max, y_max
    obstacles: Obstacles
    obstacle_grid: ObstacleGrid
    scenery: Scenery
    name: str = struct.field(pytree_node=False)
    open: bool = struct.field(pytree_node=False, default=False)  # whether people and robots may leave the floor


@struct.dataclass
class PathsToGoal:
    """The shortest paths to one goal from each corner arc of a navigation (``CornerArcs``)."""

    # m, from the middle of the arc to the goal; inf if no path leads there
    distance: Float[Array, "V"] = struct.field(metadata={"pad": np.inf})
    departure_angle: Float[Array, "V"]  # rad, from the middle of the arc to where the path leaves it, along the travel


@struct.dataclass
class RobotTask:
    """Start and goal of the robot (section IV-E)."""

    start: Float[Array, "2"]  # m
    start_heading: Float[Array, "2"]  # unit vector
    goal: Float[Array, "2"]  # m
    goal_heading: Float[Array, "2"]  # unit vector
    start_group: Int[Array, ""]  # index of the group of which the start is a member's place, -1 none
    goal_group: Int[Array, ""]  # likewise for the goal
    geodesic: Float[Array, ""]  # m, length of the shortest path from start to goal
    paths_to_goal: PathsToGoal
    path_rotation: Float[Array, ""] | None = None  # rad, of navigation.path_rotation; reset sets it


@struct.dataclass
class Snapshot:
    """A robot among people at one time: everything that situations and metrics read, in arrays alone."""

    people: Pedestrians
    position: Float[Array, "2"]  # m, of the robot
    heading: Float[Array, "2"]  # unit vector
    velocity: Float[Array, "2"]  # m/s
    start: Float[Array, "2"]  # m
    goal: Float[Array, "2"]  # m
    start_group: Int[Array, ""]  # -1 none
    goal_group: Int[Array, ""]  # -1 none
    geodesic: Float[Array, ""]  # m, shortest path from start to goal
    situations: Bool[Array, "S"]  # all false before they are classified
    tick: Int[Array, ""]
    robot_radius: Float[Array, ""]  # m
    person_radius: Float[Array, ""]  # m
    time_step: float = struct.field(pytree_node=False)  # s
    obstacles: Obstacles | None = None  # None where they are not known
    path_rotation: Float[Array, ""] | None = None  # rad, of navigation.path_rotation; None: of a straight path
    goal_radius: Float[Array, ""] | None = None  # m, within which the goal is reached; None: SEAN's 1.2
    robot_top_speed: Float[Array, ""] | None = None  # m/s; None: Kuri's 0.5
    robots: Float[Array, "R 3"] | None = None  # m: x, y and radius of the other robots of a team; None: no team
    to_surface: bool = struct.field(pytree_node=False, default=False)  # as of Scenario


@struct.dataclass
class Streams:
    """The random streams of an episode, () typed PRNG keys. A use at a tick draws from ``fold_in(stream, tick)``."""

    people: Array  # of the pedestrian behavior
    policy: Array  # of the policy
    sensors: Array  # of the noise of sensors; ``sensors.sense`` folds in the name of each
    restart: Array  # of the episode that follows
    noise: Array  # of the noise of people


@struct.dataclass
class State:
    """Everything on which the future depends: equal states and equal actions give equal futures."""

    streams: Streams  # they never change
    tick: Int[Array, ""]  # steps taken
    pedestrians: Pedestrians
    groups: Groups
    robot: Robot
    task: RobotTask
    memory: PyTree  # of the pedestrian behavior
    situations: Bool[Array, "S"]  # in the order of scenario.situations
    metrics: PyTree  # dict of name -> running value
    ticks_at_goal: Int[Array, ""]  # steps spent inside the goal radius without a break
    completed: Bool[Array, ""]  # latched
    timed_out: Bool[Array, ""]  # latched; never together with completed
    policy_state: PyTree = ()  # memory of the policy
    others: Robot | None = None  # (R, ...) the other robots of a team; None: no team
    goals_of_others: Float[Array, "R 2"] | None = None  # m


@struct.dataclass
class Behavior:
    """A pedestrian behavior (section IV-D): where people start and where they go.

    ``reset(scenario, key) -> (Pedestrians, Groups, memory)``
    ``direct(scenario, state, key) -> State`` with new desired velocities, group members and memory.
    ``move(scenario, state) -> Pedestrians`` replaces the pedestrian model, for people without one.
    """

    data: PyTree  # the tables of the functions
    name: str = struct.field(pytree_node=False)
    reset: Callable = struct.field(pytree_node=False)
    direct: Callable = struct.field(pytree_node=False)
    companions: Int[Array, "N 2"] | None = None  # companions of each person, -1 none; None: all walk alone
    people: int | None = struct.field(pytree_node=False, default=None)  # N; None: the scenario's number
    move: Callable | None = struct.field(pytree_node=False, default=None)  # None: the scenario's pedestrian model
    offers: tuple[str, ...] = struct.field(pytree_node=False, default=())  # what tasks may need: "groups", ...


@struct.dataclass
class Mount:
    """The place of a sensor on a robot. Its rotation is static, for the rays of a sensor are made before a program."""

    origin: Float[Array, "3"]  # m in the robot's frame: x ahead, y to the left, z up from the floor
    name: str = struct.field(pytree_node=False)
    axes: tuple[float, ...] = struct.field(pytree_node=False)  # (9,) unit vectors x, y, z (a camera's right, up and
    # back), as columns row by row
    fovy: float = struct.field(pytree_node=False)  # degrees, vertical field of view; 0 if it is no camera
    low: bool = struct.field(pytree_node=False)  # whether it stays below people's shoulders, where less has to be seen


@struct.dataclass
class Lateral:
    """Motion to the left of an omnidirectional robot, and the servo of its turn rate."""

    max_speed: Float[Array, ""]  # m/s
    max_acceleration: Float[Array, ""]  # m/s2
    turn_gain: Float[Array, ""]  # N m s/rad
    turn_torque: Float[Array, ""]  # N m, at most


@struct.dataclass
class Steering:
    """The steered front axle of a car. The robot's position lies between its axles."""

    wheelbase: Float[Array, ""]  # m
    rear_axle: Float[Array, ""]  # m, of the rear axle behind the robot's position
    max_angle: Float[Array, ""]  # rad, of the front wheel in the middle (bicycle law)
    max_rate: Float[Array, ""]  # rad/s


@struct.dataclass
class RobotModel:
    """A robot (Fig. 3): its limits and how it moves.

    An omnidirectional robot has no wheels of its own: their radius, inertia and track are 0, and its servos push the
    base [N s/m, N]. A car has one driven wheel, the rear axle, and its track is 0.

    ``place(model, position, heading) -> Robot`` at rest;
    ``drive(scenario, state, action) -> Robot`` one control step later.
    """

    mass: Float[Array, ""]  # kg, wheels included
    inertia: Float[Array, ""]  # kg m2 about the vertical axis
    wheel_radius: Float[Array, ""]  # m
    wheel_inertia: Float[Array, ""]  # kg m2, about its axle, gears included
    track: Float[Array, ""]  # m between the wheels, effective for skid steer
    friction: Float[Array, ""]  # tyre friction coefficient
    servo_gain: Float[Array, ""]  # N m s/rad, of the wheel speed servo
    servo_torque: Float[Array, ""]  # N m, at most
    max_speed: Float[Array, ""]  # m/s
    max_turn_rate: Float[Array, ""]  # rad/s
    max_acceleration: Float[Array, ""]  # m/s2
    max_turn_acceleration: Float[Array, ""]  # rad/s2
    command_timeout: Float[Array, ""]  # s, until the robot stops if no finite command follows
    radius: Float[Array, ""]  # m, of the disc that people and obstacles touch
    data: PyTree  # the MJX model, or ()
    solids: Solids  # its looks, in its own frame
    mounts: tuple[Mount, ...]  # of its sensors
    name: str = struct.field(pytree_node=False)
    time_step: float = struct.field(pytree_node=False)  # s, of the physics
    place: Callable = struct.field(pytree_node=False)
    drive: Callable = struct.field(pytree_node=False)
    max_reverse_speed: Float[Array, ""] | None = None  # m/s, backward; None: max_speed
    max_deceleration: Float[Array, ""] | None = None  # m/s2, of the forward speed; None: max_acceleration
    lateral: Lateral | None = None  # None: the robot does not drive sideways
    steering: Steering | None = None  # None: the robot is no car

    @property
    def drive_type(self) -> str:
        """``differential``, ``omnidirectional`` or ``ackermann``."""
        if self.lateral is not None:
            return "omnidirectional"
        return "differential" if self.steering is None else "ackermann"


@struct.dataclass
class Sensor:
    """A sensor of the robot (section IV-F): a pure function with its parameters.

    ``read(scenario, params, state, key)`` gives the reading, an array or any pytree; the key is all that its noise may
    depend on. Constructors are in ``sensors``, such as ``sensors.depth_sensor``.
    """

    params: PyTree  # leaves, such as the deviation of the noise: to be an argument of jit, grad and vmap
    name: str = struct.field(pytree_node=False)
    read: Callable = struct.field(pytree_node=False)


@struct.dataclass
class Scenario:
    """A physical environment, a pedestrian behavior and a robot task (section IV-B), with everything they need."""

    environment: Environment
    navigation: Any  # navigation.Navigation for the robot's radius
    behavior: Behavior
    forces: Any  # social_forces.Forces
    thresholds: Any  # classifiers.Thresholds
    goal_radius: Float[Array, ""]  # m, within which the goal is reached
    hold_time: Float[Array, ""]  # s, within goal_radius to complete the task
    task_distance: Float[Array, "2"]  # m, minimum and maximum geodesic distance from start to goal
    robot: RobotModel
    task: Callable = struct.field(pytree_node=False)  # (scenario, pedestrians, groups, memory, key) -> RobotTask
    move: Callable = struct.field(pytree_node=False)  # (scenario, state) -> Pedestrians: the pedestrian model
    situations: tuple = struct.field(pytree_node=False)  # ((name, (snapshot, thresholds) -> () bool), ...)
    metrics: tuple = struct.field(pytree_node=False)  # ((name, metrics.Metric), ...)
    time_step: float = struct.field(pytree_node=False)  # s, of control
    time_limit: float = struct.field(pytree_node=False)  # s
    people: int = struct.field(pytree_node=False)
    substeps: int = struct.field(pytree_node=False)  # of the social forces in a step of control
    task_name: str = struct.field(pytree_node=False)
    sensors: tuple[Sensor, ...] = ()  # of the robot, read by ``sensors.sense``
    sensor_errors: Any = None  # sensors.DistanceErrors of the sensors that have none; None: they are exact
    people_present: Int[Array, ""] | None = None  # number of people present, the first ones; None: all
    warm_up: float = struct.field(pytree_node=False, default=0.0)  # s, for which people walk before there is a robot
    to_surface: bool = struct.field(pytree_node=False, default=False)  # whether violations are of a person's surface
    others: RobotModel | None = None  # (R, ...) models of the other robots of a team; None: no team
    robot_number: Int[Array, ""] | None = None  # of the robot in its team


@struct.dataclass
class Observation:
    """The input of a policy (section IV-F), in the robot's frame: x ahead, y to the left, the robot at the origin."""

    goal: Float[Array, "2"]  # m
    goal_heading: Float[Array, "2"]  # unit vector
    path: Float[Array, "2"]  # m, the next corner of the shortest path, or the goal
    speed: Float[Array, ""]  # m/s
    turn_rate: Float[Array, ""]  # rad/s
    people: Float[Array, "N 2"]  # m
    people_velocity: Float[Array, "N 2"]  # m/s, over the ground
    people_present: Bool[Array, "N"]
    situations: Bool[Array, "S"]


@struct.dataclass
class Trajectory:
    """The record of a step, or of T steps, stacked (T, ...): enough for pictures and for all metrics (IV-H)."""

    position: Float[Array, "2"]  # m, of the robot
    heading: Float[Array, "2"]  # unit vector
    velocity: Float[Array, "2"]  # m/s
    action: Float[Array, "command"]  # m/s and rad/s, the command that led here
    people: Float[Array, "N 2"]  # m
    people_velocity: Float[Array, "N 2"]  # m/s
    people_heading: Float[Array, "N 2"]  # unit vector
    group: Int[Array, "N"]  # -1 none
    present: Bool[Array, "N"]
    goal: Float[Array, "2"]  # m
    situations: Bool[Array, "S"]
    active: Bool[Array, ""]  # the episode had not ended before this step
    robots: Float[Array, "R 6"] | None = None  # other robots of a team: x, y [m], heading x, y, goal x, y [m]


@struct.dataclass
class Policy:
    """Commands for the robot: a pure function with its parameters and its memory of an episode.

    ``init(scenario, params, state)`` gives the memory at the beginning of an episode, any pytree; ``apply(scenario,
    params, state, key)`` gives the command (2,) [m/s, rad/s] and the new memory; ``state.policy_state`` is the memory
    so far. ``as_policy`` makes one of a plain function.
    """

    params: PyTree  # leaves, such as the weights of a network: to be an argument of jit, grad and vmap
    name: str = struct.field(pytree_node=False)
    init: Callable = struct.field(pytree_node=False)
    apply: Callable = struct.field(pytree_node=False)
    sensing: str = struct.field(pytree_node=False, default="all-knowing")  # one of SENSING


SENSING = {
    "all-knowing": "knows people whom no sensor of the robot shows, or their goals",
    "tracks": "knows positions and velocities of visible people",
    "raw": "knows of people what its sensors read, or nothing",
}
"""Class of a policy -> its knowledge of people. The map, the robot's pose and its goal are known in each class."""


PolicyLike = Policy | Callable[[Scenario, State, Array], Array]
"""Any form of a policy: a ``Policy``, or a function (scenario, state, key) -> (2,) [m/s, rad/s]."""


@dataclass(frozen=True)
class _Stateless:
    """``Policy.apply`` of a plain function; equal for equal functions, so that compiled programs are reused."""

    function: Callable[[Scenario, State, Array], Array]
    arguments = "scenario, state, key"

    def __call__(self, scenario: Scenario, params: PyTree, state: State, key: Array) -> tuple[Array, tuple]:
        return self.function(scenario, state, key), ()


def no_memory(scenario: Scenario, params: PyTree, state: State) -> tuple:
    """``Policy.init`` of a policy without memory."""
    return ()


def as_policy(policy: PolicyLike) -> Policy:
    """A ``Policy``; a plain function becomes one without parameters and memory. TypeError for anything else."""
    if isinstance(policy, Policy):
        return policy
    if not callable(policy):
        raise TypeError(f"policy: {policy!r:.60} must be a Policy or a function (scenario, state, key) -> (2,).")
    name = getattr(policy, "__name__", type(policy).__name__)
    sensing = getattr(policy, "sensing", "all-knowing")
    return Policy(params=(), name=name, init=no_memory, apply=_Stateless(policy), sensing=sensing)

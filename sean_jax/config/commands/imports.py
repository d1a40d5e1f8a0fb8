"""The options of ``sean import-map``, ``import-bag`` and ``import-robot``."""

from pathlib import Path
from typing import Annotated, Literal

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Option


class ImportMapConfig(Config):
    """Make an environment of a ROS map, the YAML file of a map_server with its image."""

    map: Annotated[Path, Option(positional=True)]
    """YAML file of the map."""
    out: Path
    """Folder to write; it must be new or empty. Its path then serves as --environment."""
    people: option_types.People | None = None
    """Default number of people; by default one for each 25 m2 of free floor."""
    height: option_types.Height = 2.0
    """Height of all obstacles in metres, which a map does not have."""
    unknown: Literal["obstacle", "free"] = "obstacle"
    """Meaning of the map's unknown cells."""


class ImportBagConfig(Config):
    """Take people and the robot out of a ROS bag, as a recording and a trajectory."""

    bag: Annotated[Path, Option(positional=True)]
    """File of rosbag 1, or folder of rosbag2."""
    out: Path
    """Folder to write; it must be new or empty."""
    time_step: Annotated[float, option_types.Number(0.001, 10.0, "s")] = 0.1
    """Seconds between rows; positions of the bag are interpolated."""
    people_topic: option_types.Text | None = None
    """Topic of the people; by default the first one with people."""
    robot_topic: option_types.Text | None = None
    """Topic of the robot's pose; by default odometry, else transforms, else a pose with covariance."""


class ImportRobotConfig(Config):
    """Make a robot file of the URDF file, or of the MJCF file with a freejoint, of a robot."""

    file: Annotated[Path, Option(positional=True)]
    """URDF or MJCF file of the robot."""
    out: Path
    """Robot file to write, such as robot.xml, with a picture beside it. Its path then serves as --robot."""
    drive: Literal["differential", "omnidirectional", "ackermann"] | None = None
    """Drive; by default by the places and axes of the wheels."""
    wheels: option_types.Names | None = None
    """Joints of the driven wheels, separated by commas; by default the wheels on the floor."""
    wheel_radius: option_types.Radius | None = None
    """Radius of the wheels in metres; by default of their shapes."""
    wheel_separation: option_types.Radius | None = None
    """Distance in metres of the left and right wheels, as odometry uses it; by default of their joints."""
    mass: option_types.Mass | None = None
    """Mass in kilograms; by default of all links."""
    radius: option_types.Radius | None = None
    """Radius in metres of the disc that touches people and obstacles; by default around base and wheels."""
    max_speed: option_types.RobotSpeed | None = None
    """Top speed in m/s; by default by the velocity limit of the wheels' joints."""
    max_turn_rate: option_types.RobotTurnRate | None = None
    """Top turn rate in rad/s; by default that of a turn in place at the top speed of the wheels."""
    max_acceleration: option_types.RobotAcceleration | None = None
    """Greatest acceleration in m/s2; by default by the effort limit of the wheels' joints and the grip of tyres."""

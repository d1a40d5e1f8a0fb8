"""The options of ``sean bridge``, and names of controllers outside of this program."""

import ipaddress
import re
from typing import Annotated, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Component
from sean_jax.config.option_types import Option
from sean_jax.config.scenario_options import ScenarioConfig

TRANSPORTS = ("ros1", "rosbridge", "dds")
"""Ways to a robot's controller outside of this program."""

LOCALHOST = "127.0.0.1"

ROS_NAME = re.compile(r"[A-Za-z](_?[A-Za-z0-9]){0,62}", re.ASCII)
"""A name in ROS 1 and ROS 2: a letter, then letters, digits and single underscores."""


def outside(policy: Component) -> tuple[str, str] | None:
    """Transport and place of a controller outside of this program: "rosbridge:127.0.0.1:9090", "ros1:", "dds:0"."""
    transport, colon, place = policy.kind.partition(":")
    return (transport, place) if colon and transport in TRANSPORTS else None


def host_and_port(address: str) -> tuple[str, int]:
    """The host and the port of ADDRESS:PORT; ValueError if it is none."""
    host, _, port = address.rpartition(":")
    host = {"localhost": LOCALHOST, "": LOCALHOST}.get(host, host.strip("[]"))
    try:
        ipaddress.ip_address(host)
        if not 0 <= int(port) < 65_536:
            raise ValueError
    except ValueError:
        raise ValueError(f"{address} is no address and port; give one such as {LOCALHOST}:9090") from None
    return host, int(port)


class BridgeConfig(ScenarioConfig):
    """Let a controller outside of this program drive the robot: over ROS 1, a rosbridge websocket, or DDS."""

    ros1: Annotated[bool, Option(affects_results=False)] = False
    """Connect to the ROS 1 master of ROS_MASTER_URI, by rospy."""
    rosbridge: Annotated[bool, Option(affects_results=False)] = False
    """Serve the rosbridge protocol, version 2, on a websocket."""
    dds: Annotated[bool, Option(affects_results=False)] = False
    """Join a DDS domain with the types and topic names of ROS 2, by Cyclone DDS."""
    address: Annotated[option_types.Text, Option(affects_results=False)] = "127.0.0.1:9090"
    """For rosbridge: address and port. If other computers reach it, clients need the token that is printed."""
    domain: Annotated[int, option_types.Number(0, 230), Option(affects_results=False)] = 0
    """For DDS: its domain, as ROS_DOMAIN_ID."""
    node_name: Annotated[option_types.Text, Option(affects_results=False)] = "sean_jax"
    """Name of the node and of its services. On a master of ROS 1 two bridges need two names."""
    namespace: Annotated[option_types.Text | None, Option(affects_results=False)] = None
    """Namespace of the robot's topics and frames, such as robot1; /clock, /map, /tf and /tf_static are in none."""
    naming: Annotated[Literal["ros", "sean"], Option(affects_results=False)] = "ros"
    """Names of topics: ros as in Nav2 and move_base; sean as in SEAN 2.0, with its own topics."""
    pace: Literal["real", "fast", "lockstep", "service"] = "real"
    """Advance of time: by the clock; as fast as possible; after each command; or by the service step alone."""
    factor: Annotated[float, option_types.Number(0.01, 1000.0)] = 1.0
    """For pace real: simulated seconds per second."""
    patience: option_types.Duration = 0.5
    """For pace lockstep: seconds of waiting for a command; without one the robot's command timeout acts."""
    episodes: option_types.EpisodeCount | None = None
    """Number of episodes; by default they go on until Ctrl-C."""
    seed: option_types.Seed = 0
    """The same seed gives the same episodes, which are the episodes of sean run."""
    quiet: option_types.Quiet = False

    @pydantic.field_validator("address")
    @classmethod
    def _check_address(cls, value: str) -> str:
        host_and_port(value)
        return value

    @pydantic.field_validator("node_name")
    @classmethod
    def _check_node_name(cls, value: str) -> str:
        if not ROS_NAME.fullmatch(value):
            raise ValueError(f"is {value[:40]!r}, and no name of ROS; give one such as robot1_bridge")
        return value

    @pydantic.field_validator("namespace")
    @classmethod
    def _check_namespace(cls, value: str | None) -> str | None:
        if value is not None and not all(ROS_NAME.fullmatch(part) for part in value.split("/")):
            raise ValueError(f"is {value[:40]!r}, and no namespace of ROS; give names with / between, such as robot1")
        return value

    @pydantic.field_validator("sensors", mode="before")
    @classmethod
    def _no_sensors(cls, value: object) -> object:
        return () if value in ("none", ["none"], ("none",)) else value

    @pydantic.model_validator(mode="after")
    def _check_transport(self) -> "BridgeConfig":
        if sum((self.ros1, self.rosbridge, self.dds)) != 1:
            raise ValueError("ros1: a bridge has one transport; give one of --ros1, --rosbridge and --dds")
        return self

    @property
    def place(self) -> tuple[str, str]:
        """The transport and its place, as of ``outside``."""
        if self.ros1:
            return "ros1", ""
        return ("rosbridge", self.address) if self.rosbridge else ("dds", str(self.domain))

"""Names that a bridge has outside: of its node, its topics, its services and its robot's frames."""

from __future__ import annotations

import contextlib
import ipaddress
from dataclasses import dataclass
from typing import Any

import numpy as np

from sean_jax.ros.messages import MAP, SEAN_TOPICS, Naming

COMMAND, POSE = "/cmd_vel", "/initialpose"
INPUTS = {COMMAND: "geometry_msgs/msg/Twist", POSE: "geometry_msgs/msg/PoseWithCovarianceStamped"}
"""Topic of a controller -> its message type."""

REQUESTS_BY_NAME = ("reset", "new_task", "step")  # services of type std_srvs/Trigger
GLOBAL = {"/clock", "/map", "/tf", "/tf_static"}  # topics without a namespace, as all robots share them


@dataclass(frozen=True)
class RosNames:
    """The names of a bridge."""

    node: str = "sean_jax"
    namespace: str = ""  # of the robot, such as robot1; empty for none
    naming: Naming = "ros"

    def topic(self, name: str) -> str:
        """The name outside of a topic such as /odom."""
        return self.within(SEAN_TOPICS.get(name, name) if self.naming == "sean" else name)

    def within(self, topic: str) -> str:
        """A topic in the namespace; those of ``GLOBAL`` are in none."""
        return topic if topic in GLOBAL or not self.namespace else f"/{self.namespace}{topic}"

    @property
    def inputs(self) -> dict[str, str]:
        """Topic of a controller, by its name outside -> its message type."""
        return {self.topic(name): kind for name, kind in INPUTS.items()}

    @property
    def services(self) -> dict[str, str]:
        """Service -> request of a ``Mailbox``; those of two nodes differ."""
        return {self.within(f"/{self.node}/{word}"): word for word in REQUESTS_BY_NAME}

    def frames(self, message: Any) -> Any:
        """A message whose frames, except for the map, are in the namespace."""
        if not self.namespace or isinstance(message, np.ndarray):
            return message
        if isinstance(message, list):
            return [self.frames(item) for item in message]
        if not isinstance(message, dict):
            return message
        renamed = {name: self.frames(field) for name, field in message.items()}
        for name in ("frame_id", "child_frame_id"):
            if message.get(name, "") not in ("", MAP):
                renamed[name] = f"{self.namespace}/{message[name]}"
        return renamed


DEFAULT_NAMES = RosNames()
"""The names of ``sean run --policy ros1:``, too."""


def is_open(place: tuple[str, str]) -> bool:
    """Whether other computers reach a transport, by its name and place as of ``config.outside``."""
    transport, where = place
    host = where.rpartition(":")[0].strip("[]")
    if transport != "rosbridge" or host in ("", "localhost"):
        return False
    with contextlib.suppress(ValueError):  # no address, which the server refuses
        return not ipaddress.ip_address(host).is_loopback
    return False

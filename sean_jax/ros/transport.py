"""What all ways to a robot's controller share: a mailbox for what comes in, and a log that does not repeat itself."""

from __future__ import annotations

import collections
import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from sean_jax.core.errors import ControllerError
from sean_jax.ros.messages import MAP
from sean_jax.ros.names import COMMAND, DEFAULT_NAMES, RosNames

REQUESTS = 16  # that may wait for their answer
ANSWER = 30.0  # s, within which a request has an answer
FAR = 1e6  # m, m/s or rad/s, more than any robot has
SILENCE = 10.0  # s, for which a sentence is not repeated


class TransportLog:
    """Sentences for the user: each kind at most once in ``SILENCE``, with the number of those left out."""

    def __init__(self, write: Callable[[str], None]):
        self._write = write
        self._lock = threading.Lock()
        self._last: dict[str, float] = {}
        self._left_out: collections.Counter[str] = collections.Counter()

    def __call__(self, kind: str, sentence: str) -> None:
        """Write a sentence of a kind; from any thread."""
        with self._lock:
            now = time.monotonic()
            if now - self._last.get(kind, -math.inf) < SILENCE:
                self._left_out[kind] += 1
                return
            self._last[kind] = now
            left_out = self._left_out.pop(kind, 0)
        self._write(f"{sentence} ({left_out} more of this kind)" if left_out else sentence)


class Answer(NamedTuple):
    """The answer to a request, as of std_srvs/Trigger."""

    success: bool
    message: str


class Request:
    """A request that waits for its answer."""

    def __init__(self, name: str):
        self.name = name
        self._done = threading.Event()
        self._answer = Answer(False, "the simulation has not answered in time.")

    def answer(self, success: bool, message: str) -> None:
        """Answer the request; its ``wait`` returns."""
        self._answer = Answer(success, message)
        self._done.set()

    def wait(self) -> Answer:
        """The answer, or a refusal after ``ANSWER``."""
        self._done.wait(ANSWER)
        return self._answer


class Mailbox:
    """The latest command, the latest pose, and a few requests, until the simulation takes them. Any thread may add."""

    def __init__(self, log: TransportLog, command_size: int = 2, names: RosNames = DEFAULT_NAMES):
        self.log = log
        self.names = names
        self._command_size = command_size
        self._command_topic = names.topic(COMMAND)
        self.commands = 0  # received so far
        self._ended = ""
        self._changed = threading.Condition()
        self._command: np.ndarray | None = None
        self._pose: tuple[np.ndarray, np.ndarray] | None = None
        self._requests: collections.deque[Request] = collections.deque()

    def receive(self, topic: str, message: Mapping[str, Any]) -> None:
        """Take a message of ``names.inputs``. One that is malformed is named in the log, and dropped."""
        try:
            content = read_command(message, self._command_size) if topic == self._command_topic else read_pose(message)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            reason = f"the field {error} is missing" if isinstance(error, KeyError) else str(error)
            self.log(topic, f"{topic}: a message was dropped: {reason}.")
            return
        with self._changed:
            if topic == self._command_topic:
                self._command = np.asarray(content)
                self.commands += 1
            else:
                self._pose = content  # pyright: ignore[reportAttributeAccessIssue]
            self._changed.notify_all()

    def end(self, sentence: str) -> None:
        """The transport has ended: who waits for it gets the sentence as an error."""
        with self._changed:
            self._ended = self._ended or sentence
            self._changed.notify_all()

    def check(self) -> None:
        """Raise ControllerError if the transport has ended."""
        if self._ended:
            raise ControllerError(self._ended)

    def request(self, name: str) -> Answer:
        """Ask the simulation for something; waits for the answer."""
        request = Request(name)
        with self._changed:
            if len(self._requests) >= REQUESTS:
                return Answer(False, f"{REQUESTS} requests wait already.")
            self._requests.append(request)
            self._changed.notify_all()
        return request.wait()

    def wait(self, seconds: float, for_command: bool = False) -> None:
        """Wait until a request or a pose is there, or a command if it counts; at most for so long.

        Raises:
            ControllerError: nothing can come any more.
        """

        def came() -> bool:
            has_command = for_command and self._command is not None
            return bool(self._ended or self._requests or self._pose or has_command)

        with self._changed:
            self._changed.wait_for(came, max(0.0, seconds))
        self.check()

    def take_command(self) -> np.ndarray | None:
        """The command [m/s, rad/s] since the previous call; None if there was none."""
        with self._changed:
            command = self._command
            self._command = None
        return command

    def take_pose(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The position (2,) [m] and heading (2,) since the previous call; None if there was none."""
        with self._changed:
            pose = self._pose
            self._pose = None
        return pose

    def take_request(self) -> Request | None:
        """The request that has waited longest; None if there is none."""
        with self._changed:
            return self._requests.popleft() if self._requests else None


def _numbers(part: Any, *names: str) -> list[float]:
    """The numbers of a message's fields.

    Raises:
        ValueError: one is no number, not finite, or beyond ``FAR``.
    """
    if not isinstance(part, Mapping):
        raise ValueError(f"{str(part)[:40]!r} is no group of fields")
    values = []
    for name in names:
        value = part[name]
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise ValueError(f"{name} is {str(value)[:40]!r}, and no number")
        if not abs(value) <= FAR:  # nor is NaN
            raise ValueError(f"{name} is {str(value)[:40]}, and not a number from {-FAR:,.0f} to {FAR:,.0f}")
        values.append(float(value))
    return values


def read_command(message: Mapping[str, Any], size: int) -> np.ndarray:
    """The command (size,) [m/s, rad/s] of a Twist; of size 3 it has the velocity to the left in the middle.

    Raises:
        KeyError: a field is missing.
        ValueError: a field is no finite number.
    """
    linear = _numbers(message["linear"], *("x", "y")[: size - 1])
    return np.array([*linear, *_numbers(message["angular"], "z")], np.float32)


def read_pose(message: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The position (2,) [m] and heading (2,) of a PoseWithCovarianceStamped in the map.

    Raises:
        KeyError: a field is missing.
        ValueError: a field is no finite number, or the pose is in another frame.
    """
    frame = str(message.get("header", {}).get("frame_id", "")).lstrip("/")
    if frame not in ("", MAP):
        raise ValueError(f"its frame_id is {frame[:40]!r}, and not {MAP}; choose {MAP} as fixed frame")
    pose = message["pose"]["pose"]
    x, y = _numbers(pose["position"], "x", "y")
    z, w = _numbers(pose["orientation"], "z", "w")
    if z == w == 0.0:
        raise ValueError("the orientation is 0, and no rotation")
    angle = 2.0 * math.atan2(z, w)
    return np.array([x, y]), np.array([math.cos(angle), math.sin(angle)])


class Output(NamedTuple):
    """A topic of the simulation."""

    type: str  # such as nav_msgs/msg/Odometry
    latched: bool  # whether a later subscriber gets the latest message


class Transport(Protocol):
    """A way to the robot's controller. Its threads write into a ``Mailbox``."""

    address: str
    """Where a controller finds it, for the user."""

    def wanted(self, topic: str) -> bool:
        """Whether anybody subscribes to a topic."""
        ...

    def publish(self, topic: str, message: dict[str, Any]) -> None:
        """Send a message; it never waits for a subscriber."""
        ...

    def close(self) -> None:
        """End all threads and connections."""
        ...

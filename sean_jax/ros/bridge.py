"""A live robot: a controller outside of this program drives it, over ROS 1, a rosbridge websocket or DDS.

``sean bridge`` runs numbered episodes at the pace of the clock, of commands or of a service. ``ControllerDriver`` is
the policy of ``sean run --policy ros1:``: in lock-step, so that the runner measures an outside controller as any other.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.config import BridgeConfig
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Policy, Scenario, State, no_memory
from sean_jax.core.errors import ControllerError, InputError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.robots.drive import command_size
from sean_jax.ros import messages
from sean_jax.ros.names import COMMAND, DEFAULT_NAMES, POSE, RosNames
from sean_jax.ros.transport import REQUESTS, Mailbox, Output, Request, Transport, TransportLog
from sean_jax.sensors import SENSORS, sense
from sean_jax.simulation import making
from sean_jax.simulation import scenario as scenarios
from sean_jax.simulation.episode_runner import first_state, varying_leaves

if TYPE_CHECKING:
    from rich.console import Console

NAMES = ("lidar", "depth")  # sensors that every robot has for its controller
PATIENCE = 5.0  # s, of a driver in lock-step: within which a controller that answers has its next command ready
REPEAT = 0.1  # s, after which the first state is sent again, a step later, while nobody has answered yet
FIRST = 60.0  # s, within which a controller has to send its first command
SILENT = 3.0  # s of an episode without a command, after which the controller counts as dead
GOAL_STEPS = 50  # such steps, after which the goal is sent again: move_base drops goals that come while it starts
WAITING = ("lockstep", "service")  # paces at which time stands still until something comes
LAG = 0.5  # s behind the clock from which on the clock waits

_step = jax.jit(scenarios.step)
_reset = jax.jit(first_state, static_argnums=0)
_teleport = jax.jit(scenarios.teleport)
_next_task = jax.jit(scenarios.next_task)
_quantities = jax.jit(messages.step)
_sense = jax.jit(sense)


@jax.jit
def _only(states: State) -> State:
    """The state of a batch of one."""
    return jax.tree.map(lambda leaf: leaf[0], states)


def connect(place: tuple[str, str], mailbox: Mailbox, outputs: dict[str, Output]) -> Transport:
    """A transport by its name and place, as of ``config.outside``.

    Raises:
        InputError: a package is missing, or nothing answers there.
    """
    name, where = place
    if name == "ros1":
        from sean_jax.ros.ros1 import RosNode

        return RosNode(mailbox, outputs)
    try:
        if name == "dds":
            from sean_jax.ros.dds import Participant

            return Participant(where or "0", mailbox, outputs)
        from sean_jax.ros.rosbridge import Server
    except ModuleNotFoundError as error:
        extra = "dds" if name == "dds" else "ros"
        raise InputError(f'{name}: {error.name} is missing; pip install "sean_jax[{extra}]".') from None
    return Server(where or BridgeConfig.model_fields["address"].default, mailbox, outputs)


def _gap_to_people(state: State, position: np.ndarray) -> np.ndarray:
    """Distances (N,) [m] from a position to the middles of the people; infinite of those who are absent."""
    people = state.pedestrians
    gap = np.linalg.norm(np.asarray(people.position, float) - position, axis=-1)
    return np.where(np.asarray(people.present), gap, np.inf)


class Bridge:
    """The states of a scenario as messages, and the commands that answer them."""

    def __init__(
        self,
        scenario: Scenario,
        place: tuple[str, str],
        write: Callable[[str], None],
        now: int = 0,
        names: RosNames = DEFAULT_NAMES,
    ):
        """Connect, and compile what messages need.

        Args:
            now: steps of control on the clock so far; the first state of all has 0, and the stamp ``BEGIN``.

        Raises:
            InputError: a package is missing, or nothing answers there.
        """
        present = {sensor.name for sensor in scenario.sensors}
        added = [SENSORS[name](scenario.robot) for name in NAMES if name not in present]
        self.scenario = replace(scenario, sensors=(*scenario.sensors, *added))
        self._plain = replace(scenario, sensors=())
        self.names = names
        self._goal_topic = names.topic("/goal")
        self._number = 0
        self._table = self._topics()

        # The clock goes on through all episodes.
        self.now = now
        self._start = now + 1 if now else 0  # steps on the clock at the begin of an episode
        self._begun = False  # whether a state was sent
        self._fresh = True  # whether latched messages are to be sent
        self._goal = False  # whether the goal is to be sent again

        size = command_size(scenario.robot)
        self.no_command = np.full(size, np.nan, np.float32)
        self.mailbox = Mailbox(TransportLog(write), size, names)
        outputs = {name: Output(topic.type, topic.latched) for name, topic in self._table.items()}
        self.transport = connect(place, self.mailbox, outputs)
        self.missed = 0  # commands that did not come in time, in lock-step

    def _topics(self) -> dict[str, messages.Topic]:
        """Topics by their names outside; the clock is the last one."""
        table = messages.topics(self.scenario, self.names.naming, self._number)
        named = {self.names.within(name): topic for name, topic in table.items() if name != "/clock"}
        del named[self.names.topic(COMMAND)]
        return named | {"/clock": table["/clock"]}

    def compile(self, state: State) -> None:
        """Compile everything that a subscription may need, so that time does not stand still later."""
        _quantities(self._plain, state, jnp.asarray(self.no_command, float))
        for sensor in self.scenario.sensors:
            _sense(replace(self.scenario, sensors=(sensor,)), state)

    def begin(self, scenario: Scenario, number: int) -> None:
        """Another episode, or another task, begins; ``scenario`` has its task. Time goes on."""
        self.scenario = replace(scenario, sensors=self.scenario.sensors)
        self._plain = replace(scenario, sensors=())
        self._number = number
        self._fresh = True
        if self.names.naming == "sean":  # they have the task and the number of the episode
            own = messages.sean_topics(self.scenario, number)
            self._table |= {self.names.within(name): topic for name, topic in own.items()}
        if self._begun:
            self._start = self.now + 1
        self.missed = 0

    def stand(self) -> None:
        """A step passes on the clock and not for the robot, for nodes that wait for time before they answer."""
        self._start += 1
        self._goal = self._start % GOAL_STEPS == 0

    def publish(self, state: State, command: np.ndarray) -> None:
        """Send the messages of a state to all who subscribe; latched ones once an episode."""
        step = jax.device_get(_quantities(self._plain, state, jnp.asarray(command, float)))
        self._begun = True
        self.now = self._start + int(step.tick)
        moment = messages.BEGIN + round(self.now * self.scenario.time_step * messages.SECOND)

        latched = []
        wanted = []
        for name, topic in self._table.items():
            if not topic.latched and self.transport.wanted(name):
                wanted.append(name)
            elif topic.latched and (self._fresh or (self._goal and name == self._goal_topic)):
                latched.append(name)
        self._fresh = self._goal = False

        # Only sensors that somebody subscribes to are computed.
        readings = {}
        for sensor in self.scenario.sensors:
            if any(self._table[name].sensor == sensor.name for name in wanted):
                readings |= _sense(replace(self.scenario, sensors=(sensor,)), state)
        step = replace(step, readings=jax.device_get(readings))
        for name in (*latched, *wanted):
            self.transport.publish(name, self.names.frames(self._table[name].message(step, moment)))

    def place(self, state: State, pose: tuple[np.ndarray, np.ndarray]) -> State:
        """The state with the robot at a position (2,) [m] and a heading (2,); as it was if it cannot stand there."""
        position, heading = pose
        (to_wall,), (to_edge,) = signed_distances_on_host(self.scenario.environment, position[None])
        radius = float(self.scenario.robot.radius)
        x, y = position
        topic = self.names.topic(POSE)
        if to_edge < (0.0 if self.scenario.environment.open else radius):
            self.mailbox.log("pose", f"{topic}: ({x:g}, {y:g}) is not on the floor; the robot stays.")
        elif to_wall < radius:
            self.mailbox.log(
                "pose",
                f"{topic}: ({x:g}, {y:g}) is in an obstacle, or nearer than the robot's radius; the robot stays.",
            )
        elif (_gap_to_people(state, position) < radius + float(self.scenario.forces.walking.radius)).any():
            self.mailbox.log("pose", f"{topic}: ({x:g}, {y:g}) is on a person; the robot stays.")
        else:
            return _teleport(self._plain, state, jnp.asarray(position, float), jnp.asarray(heading, float))
        return state

    def answer(self, seconds: float) -> np.ndarray | None:
        """The command that comes within so many seconds; None if none came, or something else was asked."""
        self.mailbox.wait(seconds, for_command=True)
        return self.mailbox.take_command()

    def close(self) -> None:
        """End all connections; requests that wait are refused."""
        for _ in range(REQUESTS):
            if (request := self.mailbox.take_request()) is not None:
                request.answer(False, "the bridge ends.")
        self.transport.close()


# ------------------------------------------------------------------ sean run --policy ros1:


def _command(scenario: Scenario, params: Array, state: State, key: Array) -> tuple[Array, tuple]:
    """The command that has come from outside."""
    return params, ()


class ControllerDriver:
    """A controller outside of this program as the policy of a runner with one episode at a time, in lock-step."""

    def __init__(self, scenario: Scenario, name: str, place: tuple[str, str], console: Console, now: int = 0):
        """Connect; arguments as of ``Bridge``.

        Raises:
            InputError: a package is missing, or nothing answers there.
        """
        write = functools.partial(console.print, highlight=False, markup=False, soft_wrap=True)
        self._bridge = Bridge(scenario, place, write, now)
        self.policy = Policy(jnp.asarray(self._bridge.no_command, float), name, no_memory, _command)
        self._console = console
        self._write = write
        self._command = self._bridge.no_command
        self._answered = False  # whether a command has come
        self._late = False  # whether the last command did not come in time
        self._silent = 0  # steps without a command
        write(f"controller: {self._bridge.transport.address}")

    def __call__(self, scenario: Scenario, number: int, states: State) -> Policy:
        """The policy for the next step of an episode, after its state was sent and answered.

        Args:
            states: of a batch of one.
        """
        bridge = self._bridge
        state = _only(states)
        if int(state.tick) == 0:
            bridge.begin(scenario, number)
            self._command = bridge.no_command
        bridge.mailbox.take_command()  # of an earlier state
        bridge.publish(state, self._command)
        self._command = self._wait(state)
        return replace(self.policy, params=jnp.asarray(self._command, float))

    def _wait(self, state: State) -> np.ndarray:
        """The command that answers a state; NaN if there is none in time. The first one may come within ``FIRST``."""
        if not self._answered:
            command = self._wait_for_first(state)
            self._answered = True
            return command
        bridge = self._bridge
        end = time.monotonic() + (self.time_step if self._late else PATIENCE)
        while (command := bridge.answer(end - time.monotonic())) is None and time.monotonic() < end:
            self._refuse()
        self._late = command is None
        if command is not None:
            self._silent = 0
            return command
        self._silent += 1
        bridge.missed += 1
        bridge.mailbox.log(
            "missed", f"no command came for a state of episode {bridge._number}; the robot's command timeout acts."
        )
        if self._silent * self.time_step >= SILENT:  # an episode so far is no result
            raise self._dead(SILENT)
        return bridge.no_command

    def _wait_for_first(self, state: State) -> np.ndarray:
        """The first command, while the state is sent again and again."""
        bridge = self._bridge
        self._write(f"waiting for the first command on {COMMAND}")
        begin = time.monotonic()
        while (command := bridge.answer(REPEAT)) is None:
            self._refuse()
            if time.monotonic() - begin > FIRST:
                raise self._dead(FIRST)
            bridge.stand()
            bridge.publish(state, self._command)
        time.sleep(REPEAT)  # answers to the states that were sent before, as none may count for the next one
        newer = bridge.mailbox.take_command()
        return command if newer is None else newer

    def _dead(self, seconds: float) -> ControllerError:
        """The error of a controller that has been silent for so long."""
        return ControllerError(
            f"the controller has sent no command for {seconds:g} s of episode {self._bridge._number}, which is "
            "therefore no result; start the controller, and then this command again."
        )

    def finish(self, states: State) -> int:
        """Send the last state of an episode, in which the goal is reached; the number of missed commands."""
        missed = self._bridge.missed
        self._bridge.publish(_only(states), self._command)
        self._bridge.answer(self.time_step)  # it may not count for the next episode
        return missed

    def _refuse(self) -> None:
        """Refuse what would change the episode, as sean run measures it."""
        bridge = self._bridge
        if bridge.mailbox.take_pose() is not None:
            bridge.mailbox.log(
                "pose", "/initialpose: sean run measures whole episodes; use sean bridge to move the robot."
            )
        if (request := bridge.mailbox.take_request()) is not None:
            request.answer(False, "sean run measures whole episodes; use sean bridge.")

    @property
    def now(self) -> int:
        """Steps of control on the clock so far."""
        return self._bridge.now

    @property
    def time_step(self) -> float:
        """Seconds of a control step."""
        return self._bridge.scenario.time_step

    def close(self) -> None:
        """End all connections."""
        self._bridge.close()


# ------------------------------------------------------------------ sean bridge


class LiveBridge:
    """Numbered episodes of a scenario that go on until they are stopped."""

    def __init__(self, config: BridgeConfig, console: Console):
        """Build the scenario, connect and compile.

        Raises:
            InputError: the options cannot be met, a package is missing, or nothing answers.
        """
        self.config = config
        self.scenarios = making.scenarios(config)
        self._varying = varying_leaves(self.scenarios)
        self._tasks = tuple(scenario.task for scenario in self.scenarios)
        self._write = functools.partial(console.print, highlight=False, markup=False, soft_wrap=True)
        names = RosNames(config.node_name, config.namespace or "", config.naming)
        self.bridge = Bridge(self.scenarios[0], config.place, self._write, names=names)
        self._write(f"bridge: {self.bridge.transport.address}")  # first, as it listens already, perhaps with a token
        self._write("compiling; no message is sent until then")
        self._due = 0.0
        self._silent: float | None = None  # s of the clock without a command; None before the first and once told
        state = self._begin(0)
        self.bridge.compile(state)
        for _ in range(2):  # a state that begins, and one of a step
            state = _step(self.scenarios[0], state, jnp.asarray(self.bridge.no_command, float))
        for scenario in self.scenarios:  # so that time does not stand still later
            _next_task(scenario, state, state.streams.restart)
        _teleport(self.bridge._plain, state, state.robot.position, state.robot.heading)

    def run(self) -> None:
        """Simulate the episodes of the options; without a number of them, until Ctrl-C."""
        numbers = itertools.count() if self.config.episodes is None else range(self.config.episodes)
        self._write("ready")
        for number in numbers:
            while not self._episode(number):
                pass

    def close(self) -> None:
        """End all connections."""
        self.bridge.close()

    def _begin(self, number: int) -> State:
        """The first state of an episode, as ``sean run`` has it."""
        key = jax.random.fold_in(random_streams.key("run", self.config.seed), number)
        index = jnp.asarray(number % len(self.scenarios), jnp.int32)
        return _reset(self._tasks, self.scenarios[0], self._varying, index, key)

    def _episode(self, number: int) -> bool:
        """One episode; False if it shall begin again."""
        # Scenarios take turns by the episode's number, so an episode is repeated by its number.
        scenario = self.scenarios[number % len(self.scenarios)]
        bridge = self.bridge
        lockstep = self.config.pace == "lockstep"
        state = self._begin(number)
        command = bridge.no_command
        tasks = 0  # begun by the service new_task
        bridge.begin(scenario, number)
        self._due = waiting = time.monotonic()
        while not (bool(state.completed) or bool(state.timed_out)):
            # Send the state, and wait as the pace says.
            if lockstep:
                bridge.mailbox.take_command()  # of an earlier state
            bridge.publish(state, command)
            command, request, pose = self._wait(waiting)

            # A pose moves the robot; where time stands still, the wait for this step goes on.
            if pose is not None:
                state = bridge.place(state, pose)
                if request is None and self._may_wait(waiting):
                    command = bridge.no_command
                    continue
                bridge.missed += lockstep and request is None

            # A request may begin the episode or a task anew.
            if request is not None and request.name == "reset":
                request.answer(True, f"episode {number} begins again.")
                return False
            if request is not None and request.name == "new_task":
                tasks += 1
                state = _next_task(scenario, state, jax.random.fold_in(state.streams.restart, tasks))
                bridge.begin(scenario, number)
                request.answer(True, f"task {tasks + 1} of episode {number} begins.")
                command = bridge.no_command
                waiting = time.monotonic()
                continue

            # A command that is not finite means none: the robot keeps its last one until its timeout.
            self._notice(command is not None)
            command = bridge.no_command if command is None else command
            state = _step(scenario, state, jnp.asarray(command, float))
            waiting = time.monotonic()
            if request is not None:
                request.answer(True, f"{int(state.tick) * scenario.time_step:.3g} s of episode {number} have passed.")

        # The last state is sent, too: in it clients see that the goal is reached.
        self._end(scenario, state, command, f"episode {number}" + (f", task {tasks + 1}" if tasks else ""))
        return True

    def _may_wait(self, begin: float) -> bool:
        """Whether the wait for a step that began then may go on, as time stands still meanwhile."""
        pace = self.config.pace
        return pace == "service" or (pace == "lockstep" and time.monotonic() - begin < self.config.patience)

    def _end(self, scenario: Scenario, state: State, command: np.ndarray, name: str) -> None:
        """Send the last state, in which the goal is reached, and print a line on the episode."""
        lockstep = self.config.pace == "lockstep"
        self.bridge.publish(state, command)
        if lockstep:
            self.bridge.answer(min(scenario.time_step, self.config.patience))  # it may not count for the next episode
        outcome = "completed" if bool(state.completed) else "timed out"
        seconds = int(state.tick) * scenario.time_step
        missed = f", {self.bridge.missed} states without a command" if lockstep else ""
        self._write(f"{name}, {scenario.task_name}: {outcome} after {seconds:.1f} s{missed}")

    def _notice(self, commanded: bool) -> None:
        """Tell once that commands have come, and then none for ``SILENT``, until they come again."""
        if self.config.pace not in ("real", "lockstep"):
            return
        if commanded:
            self._silent = 0.0
        elif self._silent is not None:
            self._silent += self.scenarios[0].time_step
            if self._silent > SILENT - 1e-6:
                self._silent = None
                self._write(f"no command for {SILENT:g} s; the robot stands")

    def _wait(self, begin: float) -> tuple[np.ndarray | None, Request | None, tuple[np.ndarray, np.ndarray] | None]:
        """Wait as the pace says; the command for the next step, a request and a pose that came meanwhile.

        A request of the service ``step`` ends the waiting of the pace ``service``, and is refused otherwise.

        Args:
            begin: when the wait for this step began, as of ``time.monotonic``; poses do not begin it anew.
        """
        pace = self.config.pace
        mailbox = self.bridge.mailbox
        pose = None
        end = begin + self.config.patience
        if pace == "real":
            if time.monotonic() - self._due > LAG:
                self._due = time.monotonic()
            self._due += self.scenarios[0].time_step / self.config.factor
            end = self._due
        while True:
            if pace != "fast":
                remaining = REPEAT if pace == "service" else end - time.monotonic()
                mailbox.wait(remaining, for_command=pace == "lockstep")
            pose = mailbox.take_pose() or pose
            request = mailbox.take_request()
            if request is not None and request.name == "step" and pace != "service":
                request.answer(False, "time passes by itself; start sean bridge with --pace service.")
            elif request is not None:
                return mailbox.take_command() if request.name == "step" else None, request, pose
            if pose is not None and pace in WAITING:
                return None, None, pose
            late = pace == "fast" or (pace != "service" and time.monotonic() >= end)
            command = mailbox.take_command() if late or pace == "lockstep" else None
            if command is not None or late:
                self.bridge.missed += command is None
                return command, None, pose


def run_bridge(config: BridgeConfig, console: Console) -> None:
    """``sean bridge``: episodes until Ctrl-C.

    Raises:
        InputError: the options cannot be met, a package is missing, or nothing answers.
    """
    with console.status("compiling"):
        live = LiveBridge(config, console)
    with contextlib.closing(live):
        live.run()

"""A live scenario: control steps at the pace of the clock, commands of a person or a policy, and the way back.

Steps are those of ``learning.Recorder``, in the same programs, so a drive that is simulated again from its commands is
equal to the byte. The states of the last two minutes stay in memory: a session can return to each of them.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from sean_jax import sensors
from sean_jax.config import StudioConfig
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Policy, Scenario, State, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.learning import load_policy
from sean_jax.learning.collection import begin_episode
from sean_jax.robots.drive import command_size, max_reverse_speed
from sean_jax.simulation import episodes, making
from sean_jax.simulation import scenario as scenarios
from sean_jax.web import replay
from sean_jax.web.studio import trial as trials
from sean_jax.web.studio.editor import Editor, same_shapes
from sean_jax.web.studio.trial import TrialFile
from sean_jax.world import navigation

MEMORY = 120.0  # s, for which one can return
DEAD_MAN = 0.5  # s without a command after which the robot brakes
SPEED_RANGE = 0.25, 16.0  # times the clock
SHADE = 4.0  # m, after which a picture of depth is darker by a factor of e
LAG = 0.5  # s behind the clock from which on the clock waits


class SessionFrame(NamedTuple):
    """What the page draws of a moment."""

    trajectory: Trajectory
    path: np.ndarray  # (K, 2) m, the shortest way to the goal


def episode(frames: Sequence[SessionFrame], title: str = "", outcome: str = "") -> replay.ReplayEpisode:
    """Frames as an episode of a page."""
    stacked, path = jax.tree.map(lambda *leaves: np.stack(leaves), *frames)
    return replay.ReplayEpisode(stacked, title, outcome, plan=path, begin=0)


class Moment(NamedTuple):
    """The state after a step."""

    state: State
    memory: PyTree  # of the policy


class Choice(NamedTuple):
    """An episode to compare."""

    policy: str
    seed: int
    episode: int


@jax.jit
def _command(scenario: Scenario, policy: Policy, state: State, memory: PyTree) -> tuple[Array, PyTree]:
    key = jax.random.fold_in(state.streams.policy, state.tick)
    return episodes.command(scenario, policy, dataclasses.replace(state, policy_state=memory), key)


@jax.jit
def _way(table: navigation.Navigation, goal: Array) -> tuple[PyTree, Array]:
    return navigation.build_paths_to_goal(table, goal), navigation.last_arc_to_goal(table, goal)


@jax.jit
def _path(table: navigation.Navigation, place: Array, goal: Array, way: tuple) -> Array:
    return navigation.plan(table, place, goal, *way, points=replay.PLAN_POINTS, apart=replay.PLAN_SPACING)


@jax.jit
def _memory(scenario: Scenario, policy: Policy, state: State) -> PyTree:
    return episodes.init_policy(scenario, policy, state).policy_state


# sessions of equal options share these programs
_begin = jax.jit(begin_episode)
_step = jax.jit(scenarios.step)
_frame = jax.jit(scenarios.frame)
_results = jax.jit(scenarios.results)
_scan = jax.jit(sensors.scan, static_argnums=2)


@functools.partial(jax.jit, static_argnums=2)
def _picture(scenario: Scenario, state: State, camera: sensors.Camera) -> Array:
    if camera.name != "depth":
        rgb = sensors.render(scenario, state, camera).rgb
        return jnp.round(255.0 * jnp.clip(rgb, 0.0, 1.0)).astype(jnp.uint8)
    nearness = jnp.exp(-sensors.depth(scenario, state, camera) / SHADE)
    gray = jnp.round(255.0 * nearness).astype(jnp.uint8)[..., None]
    return jnp.broadcast_to(gray, (camera.height, camera.width, 3))


class Session:
    """An episode that a person or a policy drives. Methods may be called from any thread."""

    send: Callable[[str, Any], None]
    """Called with a kind of news and its content: ``frames``, the number of the first one and the frames; ``cut``, the
    number of frames that remain; ``status``; ``edit``, what the page can change."""

    def __init__(self, config: StudioConfig, scenario: Scenario | None = None):
        """Build the scenario and compile its programs.

        Args:
            scenario: of a session whose options differ in the policy and the seed alone.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.config = config
        self.send = lambda kind, content: None
        self.scenario = making.scenarios(config)[0] if scenario is None else scenario
        self.policy = load_policy(config.policy, self.scenario)
        robot = self.scenario.robot
        self.limits = float(robot.max_speed), float(max_reverse_speed(robot)), float(robot.max_turn_rate)

        # The files of the environment, which the page may change, and the recorded drive.
        self.editor = Editor(config)
        self.on_file = True  # whether all of this episode is on the graph of the file
        self.trial: TrialFile | None = None
        self._editing = threading.Lock()  # a change of the files is checked, built and compiled; it takes seconds
        self._saved: Scenario | None = None  # of the saved files, which the next episode has

        # Time, and who drives.
        self.playing = False
        self.human = False
        self.speed = 1.0
        self.slowdown = 1.0  # of the clock
        self.number = 0
        self._lock = threading.RLock()
        self._wake = threading.Condition(self._lock)
        self._closed = False
        self._single = 0  # steps to be taken while time stands still
        self._latest = np.zeros(command_size(robot)), -np.inf  # the person's latest command, and its time
        self._step = _step
        self._compile(self.scenario)
        self.restart(0)

    # ------------------------------------------------------------------ what clients ask for

    def restart(self, number: int) -> None:
        """Begin the episode of a number."""
        with self._lock:
            self.end_trial()
            if self._saved is not None:
                self.scenario = self._saved
                self._saved = None
            state, _ = _begin(self.scenario, self._key(number))
            self.on_file = not self.editor.changed
            self.number = number
            self.frames: list[SessionFrame] = []
            self.commands: list[tuple[float, ...]] = []
            self.by_person: list[bool] = []  # who gave each command
            first = Moment(state, _memory(self.scenario, self.policy, state))
            keep = 1 + round(MEMORY / self.scenario.time_step)
            self.moments: collections.deque[Moment] = collections.deque([first], maxlen=keep)
            self._way = _way(self.scenario.navigation, state.task.goal)
            self._append(_frame(state, state, jnp.zeros(command_size(self.scenario.robot), float)))
            self.send("cut", 0)
            self.send("frames", (0, self.frames[:]))
            self._send_status()

    def standing(self) -> AbstractContextManager[Any]:
        """Within the block no other thread changes anything, and no step is taken."""
        return self._lock

    def play(self, on: bool) -> None:
        """Let time pass, or not."""
        with self._wake:
            self.playing = on and not self.over
            self._wake.notify()
            self._send_status()

    def step(self) -> None:
        """One control step, while time does not pass."""
        with self._wake:
            self._single += not (self.playing or self.over)
            self._wake.notify()

    def set_speed(self, speed: float) -> None:
        """Speed of time, in ``SPEED_RANGE``."""
        with self._wake:
            self.speed = speed
            self._wake.notify()
            self._send_status()

    def drive(self, on: bool) -> None:
        """A person drives, or the policy, which then begins with a new memory."""
        with self._lock:
            if self.human and not on:
                state = self.moments[-1].state
                memory = _memory(self.scenario, self.policy, state)
                self.moments[-1] = Moment(state, memory)
            self.human = on
            self._latest = np.zeros(command_size(self.scenario.robot)), -np.inf
            self._send_status()

    def command(self, ahead: float, left: float) -> None:
        """The person's command, from -1 to 1 of the robot's limits each; it holds for ``DEAD_MAN``."""
        forward, backward, turn = self.limits
        speed = ahead * (forward if ahead >= 0.0 else backward)
        steering = self.scenario.robot.steering
        if steering is not None:
            turn = speed * float(np.tan(left * steering.max_angle) / steering.wheelbase)
        else:
            turn = left * turn
        sides = np.zeros(command_size(self.scenario.robot) - 2)  # nobody drives sideways by two keys
        self._latest = np.array([speed, *sides, turn]), time.monotonic()  # at once: a step may hold the lock

    def rewind(self, tick: int) -> int:
        """Return to the moment after ``tick`` steps, or to the earliest in memory, and forget all later moments."""
        with self._lock:
            now = len(self.commands)
            tick = min(max(tick, now + 1 - len(self.moments)), now)
            for _ in range(now - tick):
                self.moments.pop()
            del self.commands[tick:], self.by_person[tick:], self.frames[tick + 1 :]
            self._write_trial(lambda trial: trial.rewind(tick))
            self.playing = False
            self.send("cut", tick + 1)
            self._send_status()
            return tick

    def record(self) -> None:
        """Record this drive: from now on each second is on disk.

        Raises:
            InputError: there is no folder for it, or the graph differs from its file, or is being changed.
        """
        with self._lock:
            if self.config.record is None:
                raise InputError("record: there is no folder for drives; start the studio with --record FOLDER.")
            if self._closed:
                raise InputError("record: another scenario is open; reload the page.")
            if self._editing.locked():
                raise InputError("record: a file is being changed; wait until it is done.")
            if self.editor.changed:
                raise InputError("record: the files have changes that are not saved; save or undo them.")
            if not self.on_file:
                raise InputError("record: a file was changed in this episode; begin another one.")
            if self.trial is None:
                try:
                    self.trial = TrialFile.begin(self.config, self.number)
                except OSError as error:  # such as a full disk
                    raise InputError(f"record: {writing.reason(error)}; nothing is recorded.") from None
                self._write_trial(lambda trial: trial.add(self.commands, self.by_person))
            self._send_status()

    def end_trial(self) -> Path | None:
        """End the recording; its file, if there was one."""
        with self._lock:
            if self.trial is None:
                return None
            file = self.trial.file
            self._write_trial(lambda trial: trial.end(self.outcome))
            self.trial = None
            self._send_status()
            self.send("drives", self.drives())
            return file

    def _write_trial(self, write: Callable[[TrialFile], None]) -> None:
        """Write to the recorded drive, if there is one; if it cannot be written, the recording ends."""
        if self.trial is None:
            return
        try:
            write(self.trial)
        except InputError as error:  # the file is full, or the policy's command is no number
            self._end_early(str(error), lambda trial: trial.end(trials.STOPPED))
        except OSError as error:  # such as a full disk: time goes on, and earlier drives are whole
            self._end_early(str(error.strerror), TrialFile.abandon)

    def _end_early(self, why: str, end: Callable[[TrialFile], None]) -> None:
        assert self.trial is not None
        try:
            end(self.trial)
        except OSError:
            self.trial.abandon()
        self.trial = None
        self.send("error", f"record: {why}; the recording has ended after its last whole second.")
        self._send_status()
        self.send("drives", self.drives())

    # ------------------------------------------------------------------ the recorded drives

    def drives(self) -> list[dict[str, Any]] | None:
        """The recorded drives as the page lists them; None without a folder for them."""
        if self.config.record is None:
            return None
        return trials.rows_of_page(self.config.record, None if self.trial is None else self.trial.file)

    def discard(self, file: Any) -> None:
        """Move a recorded drive away, so that it becomes no demonstration.

        Raises:
            InputError: there is no such drive, or it is being recorded.
        """
        try:
            trials.discard_trial(self._folder_of(file), file)
        finally:  # also if it has failed: the page shows what is so
            self.send("drives", self.drives())

    def rename(self, file: Any, name: Any) -> None:
        """Give a recorded drive a name.

        Raises:
            InputError: there is no such drive, it is being recorded, or the name is none.
        """
        try:
            trials.rename_trial(self._folder_of(file), file, name)
        finally:  # also if it has failed: the page shows what is so
            self.send("drives", self.drives())

    def _folder_of(self, file: Any) -> Path:
        """The folder of the recorded drives, unless the drive is being recorded."""
        if self.config.record is None:
            raise InputError("drives: there is no folder for them; start the studio with --record FOLDER.")
        if self.trial is not None and self.trial.file.name == file:
            raise InputError("drives: this drive is being recorded; stop the recording first.")
        return self.config.record

    # ------------------------------------------------------------------ the files of the environment

    def edit(self, change: Mapping[str, Any] | None, allowed: Callable[[], bool] = lambda: True) -> None:
        """Change a file of the environment as ``Editor.change``, or take the latest change back.

        People go on if the programs take the new tables; the episode begins anew if not, and on another floor. No drive
        is recorded meanwhile.

        Args:
            allowed: whether the change may take effect; it is asked when all is built and compiled.

        Raises:
            InputError: the change has a mistake, or is not allowed; nothing is changed.
        """
        with self._editing:
            with self._lock:
                self._check_no_trial("edit")
                before = self.scenario if self._saved is None else self._saved
                playing = self.playing

            def prepare(edited: Scenario) -> None:
                if self._begins_anew(edited):
                    self._compile(edited)
                if not allowed():
                    raise InputError("edit: another tab has taken the wheel; nothing is changed.")

            undone = change is None
            edited = self.editor.undo(before, prepare) if undone else self.editor.change(change, before, prepare)
            if edited is not before:  # as of a drag that ends where it began
                with self._lock:
                    anew = self._begins_anew(edited)
                    self.scenario = edited
                    self._saved = None
                    self.on_file = False
                    if anew:
                        self.restart(self.number)
                        self.play(playing)  # the episode may have ended meanwhile
            self.send("edit", self.edits())

    def _begins_anew(self, edited: Scenario) -> bool:
        """Whether the present episode cannot go on in an edited scenario."""
        before = self.scenario
        tables = before.behavior.data, edited.behavior.data
        return before.environment is not edited.environment or not same_shapes(*tables)

    def save(self, allowed: Callable[[], bool] = lambda: True) -> None:
        """Write the changes to the environment's files, and begin the episode anew on them.

        Args:
            allowed: whether the present episode may end; it is asked when all is built and compiled.

        Raises:
            InputError: they are files of the package, or one has changed meanwhile; or the present episode may not end.
        """
        with self._editing:
            with self._lock:
                self._check_no_trial("save")
            self.editor.save()
            scenario = making.scenarios(self.config)[0]
            self._compile(scenario)
            with self._lock:
                self._saved = scenario
                self.on_file = False
                goes_on = not allowed()
                if not goes_on:
                    self.restart(self.number)
            self.send("edit", self.edits())
        if goes_on:
            raise InputError("save: the files are saved. Another tab has the wheel: its next episode is on them.")

    def _check_no_trial(self, word: str) -> None:
        if self.trial is not None:
            raise InputError(f"{word}: this drive is recorded on the files as they are; stop the recording first.")

    def edits(self) -> dict[str, Any]:
        """What the page draws and changes, as ``Editor.of_page``, and the handcrafted set of the episode."""
        edits = self.editor.of_page(self.scenario)
        if edits["sets"] is not None:
            edits["set"] = self.scenario.behavior.data.names[int(self.state.memory.set)]
        return edits

    # ------------------------------------------------------------------ time

    @property
    def state(self) -> State:
        """After the latest step."""
        return self.moments[-1].state

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return bool(self.state.completed) or bool(self.state.timed_out)

    @property
    def outcome(self) -> str:
        """Of the episode: completed, timed out, or nothing yet."""
        if bool(self.state.completed):
            return "completed"
        return "timed out" if bool(self.state.timed_out) else ""

    def status(self) -> dict[str, Any]:
        """What the page shows beside the frames."""
        with self._lock:
            return {
                "playing": self.playing,
                "human": self.human,
                "speed": self.speed,
                "slowdown": round(self.slowdown, 2),
                "episode": self.number,
                "tick": len(self.commands),
                "first": len(self.commands) + 1 - len(self.moments),
                "outcome": self.outcome,
                "recording": self.trial is not None,
            }

    def picture(self, name: str, width: int, height: int) -> np.ndarray:
        """What a camera of the robot sees now, (height, width, 3) bytes; of ``depth``, near is bright."""
        with self._lock:
            state = self.state
        camera = sensors.camera(self.scenario, name, width=width, height=height)
        return np.asarray(_picture(self.scenario, state, camera))

    def scan(self, count: int) -> tuple[np.ndarray, float]:
        """(count,) m along rays of the robot's lidar, from ahead to the left; and its range."""
        with self._lock:
            state = self.state
            scenario = self.scenario
        device = sensors.lidar(scenario, count=count, first=0.0)
        return np.asarray(_scan(scenario, state, device)), device.far

    def complete(self) -> None:
        """The rest of the episode, driven by the policy, without the clock."""
        while not self.over:
            with self._lock:
                self._advance(None)

    def metrics(self) -> dict[str, float]:
        """The finite overall metrics of the episode so far, and its duration in seconds."""
        with self._lock:
            return self._summary(self.scenario, self.state)

    def driver(self) -> str:
        """Who has driven this episode: a person, the policy, or both with their shares of the steps."""
        policy = self.policy.name
        if not any(self.by_person):
            return policy
        if all(self.by_person):
            return "you"
        share = min(99, max(1, round(100 * sum(self.by_person) / len(self.by_person))))
        return f"you {share} %, {policy} {100 - share} %"

    def baselines(self, names: Sequence[str]) -> Iterator[tuple[str, dict[str, float]]]:
        """The metrics of this episode, then those of policies in the same one; empty if another episode begins."""
        with self._lock:
            number = self.number
            state = self.state
            scenario = self.scenario
            driver = self.driver()
        yield driver, self._summary(scenario, state)
        for name in names:
            if name == driver:
                continue  # the policy has driven this episode itself
            for step in self._steps(scenario, load_policy(name, scenario), self._key(number)):
                if self.number != number or self._closed:
                    return
                state = step[1]
            yield name, self._summary(scenario, state)

    def compare(self, choices: Sequence[Choice]) -> Iterator[dict[str, Any]]:
        """Whole episodes of this scenario: the progress after each second, and at last recordings and metrics.

        Raises:
            InputError: a policy does not fit the scenario.
        """
        with self._lock:
            scenario = self.scenario
        recordings = []
        metrics = []
        for index, choice in enumerate(choices):
            own = choice.policy == self.config.policy.kind
            policy = self.policy if own else load_policy(choice.policy, scenario)
            frames: list[Trajectory] = []
            state = self.state
            every = max(1, round(1.0 / scenario.time_step))
            for before, state, action in self._steps(scenario, policy, self._key(choice.episode, choice.seed)):
                frames.append(jax.tree.map(np.asarray, _frame(before, state, action)))
                if len(frames) % every == 1:
                    seconds = int(state.tick) * scenario.time_step
                    yield {"index": index, "seconds": seconds, "limit": scenario.time_limit}
            summary = self._summary(scenario, state)
            metrics.append(summary)
            outcome = f"{'completed' if bool(state.completed) else 'timed out'} · {summary['seconds']:.1f} s"
            stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *frames)
            episode = replay.ReplayEpisode(stacked, "", outcome, begin=0)
            title = f"{choice.policy} · seed {choice.seed} · episode {choice.episode}"
            recordings.append(replay.of_scenario(scenario, [episode], title))
        yield {"recordings": recordings, "metrics": metrics}

    def _steps(self, scenario: Scenario, policy: Policy, key: Array) -> Iterator[tuple[State, State, Array]]:
        """States before and after each step of a policy's episode, and the action; first of all its first state."""
        state, _ = _begin(scenario, key)
        memory = _memory(scenario, policy, state)
        action = jnp.zeros(command_size(self.scenario.robot), float)
        yield state, state, action
        while not (bool(state.completed) or bool(state.timed_out)):
            before = state
            action, memory = _command(scenario, policy, before, memory)
            state = self._step(scenario, before, action)
            yield before, state, action

    def _summary(self, scenario: Scenario, state: State) -> dict[str, float]:
        """The finite overall metrics of an episode, and its duration in seconds."""
        values = {name: float(np.ravel(value)[0]) for name, value in _results(scenario, state).items()}
        seconds = int(state.tick) * scenario.time_step
        known = {"completed": float(state.completed), "seconds": seconds}
        return known | {name: value for name, value in values.items() if math.isfinite(value)}

    def _compile(self, scenario: Scenario) -> None:
        """Compile the programs of a scenario; time passes meanwhile."""
        state, _ = _begin(scenario, self._key(0))
        memory = _memory(scenario, self.policy, state)
        for _ in range(2):  # a state that begins, and one of a step
            action, memory = _command(scenario, self.policy, state, memory)
            before = state
            state = self._step(scenario, before, action)
            _frame(before, state, action)
        goal = state.task.goal
        _path(scenario.navigation, state.robot.position, goal, _way(scenario.navigation, goal))

    def _key(self, number: int, seed: int | None = None) -> Array:
        root = random_streams.key("record", self.config.seed if seed is None else seed)
        return jax.random.fold_in(root, jnp.uint32(number))

    def run(self) -> None:
        """Let time pass until ``close``; for a thread of its own."""
        due = time.monotonic()  # of the next step
        sent = 0.0  # when the last status was sent
        while True:
            with self._wake:
                while not (self._closed or self.playing or self._single):
                    self._wake.wait()
                    due = time.monotonic()
                if self._closed:
                    self.end_trial()
                    return
                wait = due - time.monotonic() if self.playing else 0.0
                if wait > 0.0:
                    self._wake.wait(wait)  # a change of speed, or a pause, ends it
                    continue
                self._single -= bool(self._single)
                try:
                    self._advance(self._held_command() if self.human else None)
                except Exception as error:  # of a user's own part: the page says so, and another episode may begin
                    self.playing = False
                    self.send("error", f"the episode has stopped: {error}")
                    self._send_status()
                    continue
                due = self._next_step(due)
                if self.over:
                    self.playing = False
                    self.end_trial()
                if self.over or time.monotonic() - sent > 0.5:
                    sent = time.monotonic()
                    self._send_status()

    def _held_command(self) -> np.ndarray:
        """The person's latest command; zeros if it is too long ago."""
        command, received = self._latest
        if time.monotonic() - received < DEAD_MAN:
            return command
        return np.zeros(command_size(self.scenario.robot))

    def _next_step(self, due: float) -> float:
        """When the next step is due, after one that was due then; time that is lost is not made up for."""
        due += self.scenario.time_step / self.speed
        late = time.monotonic() - due
        slowdown = 1.0 + max(0.0, late) * self.speed / self.scenario.time_step
        self.slowdown = 0.9 * self.slowdown + 0.1 * slowdown
        return time.monotonic() if late > LAG else due

    def close(self) -> None:
        """Let ``run`` return; a recording ends."""
        with self._wake:
            self._closed = True
            self._wake.notify()

    def _advance(self, command: np.ndarray | None) -> None:
        """One control step, by a person's command or by the policy's."""
        before, memory = self.moments[-1]
        if command is None:
            action, memory = _command(self.scenario, self.policy, before, memory)
        else:
            action = jnp.asarray(command, float)
        after = self._step(self.scenario, before, action)
        self.moments.append(Moment(after, memory))
        self._append(_frame(before, after, action))
        row = tuple(np.asarray(action, np.float64).tolist())
        self.commands.append(row)
        self.by_person.append(command is not None)
        self.send("frames", (len(self.frames) - 1, self.frames[-1:]))
        self._write_trial(lambda trial: trial.add([row], [command is not None]))

    def _append(self, trajectory: Trajectory) -> None:
        """Another frame; its path is new once a second."""
        every = max(1, round(1.0 / self.scenario.time_step))
        if len(self.frames) % every == 0:
            table = self.scenario.navigation
            robot = self.state.robot
            path = np.asarray(_path(table, robot.position, self.state.task.goal, self._way))
        else:
            path = self.frames[-1].path
        self.frames.append(SessionFrame(jax.tree.map(np.asarray, trajectory), path))

    def _send_status(self) -> None:
        if hasattr(self, "moments"):
            self.send("status", self.status())

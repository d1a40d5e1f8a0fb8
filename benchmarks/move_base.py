"""ROS's own move_base drives numbered episodes in lock-step, with the parameters of SEAN 2.0's files.

It needs Debian 12 with ROS of Debian's packages, Python 3.11, and checkouts of four projects in one folder:

    SOURCES/navigation         github.com/ros-planning/navigation at 9ad644198e13 (noetic-devel)
    SOURCES/navigation_layers  github.com/DLu/navigation_layers at a9ee49b4a061
    SOURCES/people             github.com/wg-perception/people at bc73fa0c2ff9 (melodic)
    SOURCES/social_sim_ros     github.com/yale-sean/social_sim_ros at 2211bec63b5d

    python benchmarks/move_base.py build --sources SOURCES --workspace WORKSPACE
    python benchmarks/move_base.py drive --sources SOURCES --workspace WORKSPACE --layers social lidar --out LOGS
    python benchmarks/move_base.py summary LOGS/*.json --out benchmarks/results/move_base.json

and the same beside its re-makes, on the episodes of `sean experiment figure4 --preset sean2`, each in turn for graph,
random and handcrafted:

    python benchmarks/move_base.py drive --sources SOURCES --workspace WORKSPACE --figure4 graph --seed 0 --episodes 50
        --out results/figure4-real
    python benchmarks/move_base.py compare results/figure4-real

`build` copies the packages it needs into WORKSPACE and compiles them there, five minutes on one core; it names the
packages that apt-get has to install. `drive` writes LOGS/TASK-LAYERS-SEED.json after each episode, and goes on from
there if it is started again. `summary` prints a table of such files and writes it. `compare` drives `social_costmap`
(N) and `move_base` on the CPU, prints the differences in equal episodes, and writes figure4.csv and contrasts.csv.

Lock-step: the state is published, the clock goes on by 0.1 s in five ticks, and the simulation waits up to 0.4 s for a
command. Without one the robot keeps its last command until its own time-out. Each episode has a fresh move_base.
SEAN's files have no person on any map. `--layers social` adds the proxemic layer that they name in a comment, to both
maps; `--layers social lidar` also the lidar, 360 rays to 3.5 m, whose misses are 0 as in SEAN. `--layers` without a
name takes the files as they are. Runs depend on the time that threads of move_base get, so two runs of an episode
differ. `sean run --policy ros1:` drives move_base, too, with the remaps odom:=/odom laser:=/scan
/move_base_simple/goal:=/goal; its goal comes once an episode and the clock goes on by 0.1 s at once.

A file is {"options", "versions", "columns", "episodes"}. An episode has `episode`, `completed`, `seconds`, `start`,
`goal` [m], `geodesic` [m], `still` [s] (time_not_moving), `rtf` (simulated seconds a second), `silent` (steps without a
command), `plans_per_s`, `recovery` [[s, name]], `result` [[s, status, text]] (2 preempted, 3 succeeded, 4 aborted),
`results` (metrics), `stops` (of 5 s and more) and, without --figure4, `log`, a row a step with these columns: time s,
x m, y m, heading rad, command m/s, rad/s (null without one), number of commands, number of feedback messages, nearest
person m, people within 3.5 m.
"""

import argparse
import contextlib
import functools
import importlib.util
import json
import math
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, add_options, parser
from timing import Stopwatch, write_json

import sean_jax
from sean_jax import metrics
from sean_jax.config import Figure4Config, validate
from sean_jax.config.workspace import IDENTITY, Workspace, identity, refuse_difference
from sean_jax.core import random_streams
from sean_jax.core.errors import IncompleteError, InputError, SeanError
from sean_jax.io import writing
from sean_jax.io.versions import versions
from sean_jax.learning.policy import load_policy
from sean_jax.metrics import bootstrap
from sean_jax.metrics.differences import difference, holm
from sean_jax.ros import messages
from sean_jax.ros.ros1 import RosNode, import_rospy
from sean_jax.ros.transport import Mailbox, Output, TransportLog
from sean_jax.sensors import lidar, lidar_sensor
from sean_jax.simulation.episode_runner import first_state, varying_leaves
from sean_jax.studies.experiments import figure4, measures, write_csv
from sean_jax.world import ros_map

CHECKOUTS = {
    "navigation": ("https://github.com/ros-planning/navigation", "9ad644198e132d0e950579a3bc72c29da46e60b0"),
    "navigation_layers": ("https://github.com/DLu/navigation_layers", "a9ee49b4a0611f665e6ac0d03a63fa6f387ae00a"),
    "people": ("https://github.com/wg-perception/people", "bc73fa0c2ff96da27688e3ad503a1aa4342d214a"),
    "social_sim_ros": ("https://github.com/yale-sean/social_sim_ros", "2211bec63b5d3badd096fed0be58f8ee619c7573"),
}
ROS_PACKAGES = {
    "navigation": "base_local_planner clear_costmap_recovery costmap_2d global_planner move_base nav_core navfn "
    "rotate_recovery voxel_grid",
    "navigation_layers": "social_navigation_layers",
    "people": "people_msgs",
}
DEBIAN_PACKAGES = """catkin cmake g++ make libangles-dev libactionlib-dev libbullet-dev libclass-loader-dev
libdynamic-reconfigure-config-init-mutex-dev libeigen3-dev liblaser-geometry-dev libmap-msgs-dev libmessage-filters-dev
libmove-base-msgs-dev libnav-msgs-dev liborocos-kdl-dev libroscpp-dev librosbag-dev librostest-dev libstd-srvs-dev
libtf2-geometry-msgs-dev libtf2-msgs-dev libtf2-ros-dev libtf2-sensor-msgs-dev libvisualization-msgs-dev libyaml-cpp-dev
pluginlib-dev python3-actionlib python3-dynamic-reconfigure python3-geometry-msgs python3-map-msgs
python3-move-base-msgs python3-nav-msgs python3-rosgraph-msgs python3-rosmaster python3-rospy python3-sensor-msgs
python3-std-srvs python3-tf2-msgs ros-actionlib-msgs ros-cmake-modules ros-geometry-msgs ros-map-msgs
ros-move-base-msgs ros-nav-msgs ros-rosgraph-msgs ros-sensor-msgs ros-std-msgs ros-tf2-msgs
ros-visualization-msgs""".split()
PARAMETERS = {  # of kuri_move_base.launch: file -> namespaces below /move_base
    "costmap_common_params.yaml": ("global_costmap", "local_costmap"),
    "map_nav_params/local_costmap_params.yaml": ("",),
    "map_nav_params/global_costmap_params.yaml": ("",),
    "base_local_planner_params.yaml": ("",),
    "move_base_params.yaml": ("",),
}
SYSTEM_PATH = "/usr/bin:/bin"  # without other Pythons
BUILD_LIMIT, START_LIMIT, ANSWER_LIMIT = 3600.0, 60.0, 0.4  # s
TICK, TICK_PAUSE = 20_000_000, 0.01  # ns of a tick of the clock, and s of wall time after each
MAP_CELL = 0.1  # m, of SEAN's maps
GOAL = "/move_base_simple/goal"
STATE = "/tf", "/robot_odom", "/laser/scan", "/people"  # topics, each control step
LATCHED = "/map", "/tf_static"
OPTIONS = "environment", "task", "people", "seed", "layers"
SETTLE = 20  # control steps at rest before an episode, in which the maps fill
GOAL_PERIOD = 10.0  # s, after which SEAN publishes the goal again
NEAR = 3.5  # m, in which people are counted; the lidar's range
COLUMNS = ("time", "x", "y", "heading", "speed", "turn_rate", "commands", "feedback", "nearest", "people")
ANSWERS = "zero", "turn", "none"  # of move_base where the robot stands: (0, 0), a turn on the spot, no command
PAPER = 28.7  # s, Table III: time not moving of N
PERSONAL = "personal_robot_on_person", "personal_person_on_robot"
REAL, REMAKES = "real", {measures.NAVIGATION: "social_costmap", "move_base": "move_base"}  # drivers of `compare`
MEAN = measures.MEAN  # over the three scenarios


# --- build ---


def checkout(sources: Path, name: str) -> Path:
    """The folder of a checkout.

    Raises:
        InputError: it is not there, or at another commit. A copy without .git is not checked.
    """
    folder, (address, commit) = sources / name, CHECKOUTS[name]
    cure = f"git -C {folder} checkout {commit[:12]}"
    if not folder.is_dir():
        raise InputError(f"{folder} is missing; git clone {address} {folder} && {cure}")
    if (folder / ".git").exists():
        command = ["git", "-C", str(folder), "rev-parse", "--verify", "-q", "HEAD"]
        head = subprocess.run(command, capture_output=True, text=True, timeout=60).stdout.strip()
        if head != commit:
            raise InputError(f"{folder} is at {head[:12] or 'no commit'}; {cure}")
    return folder


def check_debian() -> None:
    """Raise InputError unless the packages are installed."""
    if shutil.which("dpkg-query") is None:
        raise InputError("dpkg-query is missing: the build needs Debian 12 and its ROS packages.")
    command = ["dpkg-query", "-W", "-f", "${Package} ${db:Status-Status}\n", *DEBIAN_PACKAGES]
    listing = subprocess.run(command, capture_output=True, text=True, timeout=60).stdout.splitlines()
    installed = {line.split()[0] for line in listing if line.endswith(" installed")}
    missing = [name for name in DEBIAN_PACKAGES if name not in installed]
    if missing:
        raise InputError(f"packages are missing; apt-get install --no-install-recommends {' '.join(missing)}")


def patch(text: str) -> str:
    """A file of social_navigation_layers for Boost and pluginlib of Debian 12."""
    text = text.replace("pluginlib/class_list_macros.h>", "pluginlib/class_list_macros.hpp>").replace(";-Werror", "")
    bind = re.sub(r"(boost::bind\([^()]*), _1, _2\)", r"\1, boost::placeholders::_1, boost::placeholders::_2)", text)
    return text if bind == text else "#include <boost/bind/bind.hpp>\n" + bind


def build(sources: Path, workspace: Path) -> None:
    """Copy the packages, patch them and compile them.

    Raises:
        InputError: a checkout or a package of Debian is missing.
        IncompleteError: the build fails.
    """
    for name in CHECKOUTS:
        checkout(sources, name)
    check_debian()
    for name, packages in ROS_PACKAGES.items():
        for package in packages.split():
            source, target = checkout(sources, name) / package, workspace / "src" / package
            if not source.is_dir():
                raise InputError(f"{source} is missing; check out {CHECKOUTS[name][1][:12]} of {name}.")
            for file in sorted(path for path in source.rglob("*") if path.is_file()):
                content, copy = file.read_bytes(), target / file.relative_to(source)
                if package == "social_navigation_layers" and file.suffix in (".cpp", ".txt"):
                    content = patch(content.decode()).encode()
                if not copy.is_file() or copy.read_bytes() != content:  # equal files are not compiled again
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    copy.write_bytes(content)
    options = "-DPYTHON_EXECUTABLE=/usr/bin/python3", "-DCMAKE_BUILD_TYPE=Release", "-DCATKIN_ENABLE_TESTING=OFF"
    environment = {"HOME": os.environ.get("HOME", "/"), "PATH": SYSTEM_PATH}  # without ROS_DISTRO
    begin, lines, log = time.monotonic(), [], workspace / "build.log"
    with log.open("w") as output, subprocess.Popen(
        ["catkin_make", "-j1", *options], cwd=workspace, env=environment, text=True, errors="replace",
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:  # fmt: skip
        timer = threading.Timer(BUILD_LIMIT, process.kill)
        timer.start()
        try:
            share = -1
            for line in process.stdout or ():
                output.write(line)
                lines = [*lines[-11:], line.rstrip()]
                match = re.match(r"\[ *(\d+)%\]", line)
                if match and int(match[1]) >= share + 10:
                    share = int(match[1])
                    print(f"build: {share} % after {time.monotonic() - begin:.0f} s", flush=True)
        finally:
            timer.cancel()
            if sys.exc_info()[0]:
                process.kill()
    if process.returncode:
        last = "\n".join(lines)
        raise IncompleteError(f"catkin_make failed ({process.returncode}); {log} ends with\n{last}")
    print(f"build: done after {time.monotonic() - begin:.0f} s")


# --- drive ---


def parameters(sources: Path, layers: list[str]) -> dict[str, Any]:
    """The parameters below /move_base."""
    import yaml

    folder = checkout(sources, "social_sim_ros") / "social_sim_ros" / "params" / "kuri"
    tree: dict[str, Any] = {}
    for name, spaces in PARAMETERS.items():
        for space in spaces:
            if not (folder / name).is_file():
                raise InputError(f"{folder / name} is missing; check out {CHECKOUTS['social_sim_ros'][1][:12]}.")
            _merge(tree, {space: yaml.safe_load((folder / name).read_text())} if space else
                   yaml.safe_load((folder / name).read_text()))  # fmt: skip
    local, whole = tree["local_costmap"], tree["global_costmap"]
    for costmap in (local, whole):
        if "social" in layers:
            social = {"name": "social_layer", "type": "social_navigation_layers::ProxemicLayer"}
            costmap["plugins"] = [*costmap["plugins"], social]
        if "lidar" in layers:
            costmap["obstacles_layer"] = {**local["obstacles_layer"], "enabled": True}
    return tree


def _merge(tree: dict[str, Any], other: dict[str, Any]) -> None:
    for key, value in other.items():
        if isinstance(value, dict):
            _merge(tree.setdefault(key, {}), value)
        else:
            tree[key] = value


class World:
    """The simulation: ``reset(number)`` and ``step(state, action)`` return a state and what is published of it."""

    def __init__(self, chosen: argparse.Namespace) -> None:
        if chosen.figure4:
            names = (*measures.METRIC_NAMES, *PERSONAL)
            known = tuple((name, metrics.METRICS[name]) for name in names if name in metrics.METRICS)
            scenarios, use = figure4.scenarios(figure4_options(chosen))[chosen.figure4], "figure4"
            scenarios = [replace(scenario, metrics=known) for scenario in scenarios]
        else:
            options = {"behavior": "graph", "task": chosen.task, "people": chosen.people, "preset": "sean2"}
            scenarios, use = [sean_jax.make(chosen.environment, robot="kuri", **options)], "run"
        laser = lidar_sensor(lidar(scenarios[0]), name="laser")
        scenarios = [replace(scenario, sensors=(laser,)) for scenario in scenarios]
        self.scenario = first = scenarios[0]
        self._tasks, self._varying = tuple(each.task for each in scenarios), varying_leaves(scenarios)
        self._alike = [replace(each, task=first.task, task_name=first.task_name) for each in scenarios]  # one program
        self._root = random_streams.key(use, chosen.seed)
        self._first = jax.jit(first_state, static_argnums=0)
        self._step, self._quantities = jax.jit(sean_jax.step), jax.jit(messages.step)
        self.results = jax.jit(functools.partial(sean_jax.results, first))

    def reset(self, number: int):
        """Episode ``number``, which the scenarios take in turn, as a ``Runner`` draws it."""
        turn, key = number % len(self._alike), jax.random.fold_in(self._root, number)
        self._place = self._alike[turn]
        state = self._first(self._tasks, self.scenario, self._varying, jnp.int32(turn), key)
        return state, self._quantities(self._place, state, jnp.zeros(2))

    def step(self, state, action):
        """One control step."""
        state = self._step(self._place, state, action)
        return state, self._quantities(self._place, state, action)


def figure4_options(chosen: argparse.Namespace) -> Figure4Config:
    """The experiment whose episodes are driven."""
    options = {"environment": chosen.environment, "people": chosen.people, "seed": chosen.seed, "preset": "sean2"}
    return validate(Figure4Config, options | {"out": chosen.out})


def occupancy_grid(scenario) -> dict[str, Any]:
    """The map in cells of 0.1 m, a meter beyond the floor."""
    x0, y0, x1, y1 = np.asarray(scenario.environment.floor, float)
    empty = np.zeros((round((y1 - y0 + 2) / MAP_CELL), round((x1 - x0 + 2) / MAP_CELL)), bool)
    cells = ros_map.rasterize(scenario.environment.obstacles, ros_map.Raster(empty, empty, MAP_CELL, (x0 - 1, y0 - 1)))
    origin = {"position": messages.vector(x0 - 1, y0 - 1), "orientation": messages.NO_ROTATION}
    rows, columns = cells.shape
    info = {"resolution": MAP_CELL, "width": columns, "height": rows, "origin": origin}
    return {"header": messages.header("map", 0), "info": info, "data": (100 * cells).astype(np.int8).ravel()}


class Ros:
    """A master, the node of the bridge, and a move_base that can be started anew."""

    def __init__(self, world: World, chosen: argparse.Namespace, tree: dict[str, Any]) -> None:
        self.workspace = chosen.workspace.resolve()
        self.folder = self.workspace / f"logs-{chosen.port}"  # of processes
        self.folder.mkdir(exist_ok=True)
        self.table = messages.topics(world.scenario, naming="sean")
        self.processes: list[subprocess.Popen] = []
        self.ticks, self.feedback, self.plans, self.active = 0, 0, 0, False
        self.recovery: list = []
        self.result: list = []
        self.environment = {
            "HOME": os.environ.get("HOME", "/"), "PATH": SYSTEM_PATH, "ROS_IP": "127.0.0.1",
            "ROS_MASTER_URI": f"http://127.0.0.1:{chosen.port}", "ROS_HOSTNAME": "127.0.0.1",
        }  # fmt: skip
        os.environ.update(self.environment | {"PATH": os.environ["PATH"]})
        if listens(chosen.port):
            raise InputError(f"--port: a server listens on port {chosen.port} already; give a free one.")
        try:
            self.start("rosmaster", ["/usr/bin/rosmaster", "--core", "-p", str(chosen.port)])
            self.wait(lambda: listens(chosen.port), "rosmaster does not listen")
            names = *STATE, "/clock", "/map", "/tf_static", GOAL
            self.mailbox = Mailbox(TransportLog(print))
            self.node = RosNode(self.mailbox, {name: Output(self.table[name].type, name in LATCHED) for name in names})
            self.read(import_rospy())
            import_rospy().set_param("/move_base", tree)
            self.node.publish("/map", occupancy_grid(world.scenario))
            self.node.publish("/tf_static", self.table["/tf_static"].message(None, 0))
        except BaseException:
            self.close()
            raise

    def read(self, rospy) -> None:
        """Subscribe to what move_base tells of itself."""
        from move_base_msgs.msg import MoveBaseActionFeedback, MoveBaseActionResult, RecoveryStatus
        from nav_msgs.msg import Path as Plan

        def result(message) -> None:
            self.result.append([self.time / 1e9, message.status.status, message.status.text])
            self.active = message.status.status == 2  # preempted by the same goal, published again

        def recovery(message) -> None:
            self.recovery.append([self.time / 1e9, message.recovery_behavior_name])

        def count(name: str):
            return lambda message: setattr(self, name, getattr(self, name) + 1)

        self.readers = [
            rospy.Subscriber("/move_base/result", MoveBaseActionResult, result),
            rospy.Subscriber("/move_base/recovery_status", RecoveryStatus, recovery),
            rospy.Subscriber("/move_base/feedback", MoveBaseActionFeedback, count("feedback"), tcp_nodelay=True),
            rospy.Subscriber("/move_base/GlobalPlanner/plan", Plan, count("plans")),
        ]

    @property
    def time(self) -> int:
        """Simulated time [ns]."""
        return self.ticks * TICK

    def start(self, name: str, command: list[str]) -> None:
        """Start a process, whose output goes to a log."""
        with (self.folder / f"{name}.log").open("w") as log:
            self.processes.append(
                subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=self.environment, cwd=self.folder,
                                 start_new_session=True)
            )  # fmt: skip

    def check(self) -> None:
        """Raise IncompleteError if a process has ended."""
        for process, name in zip(self.processes, ("rosmaster", "move_base"), strict=False):
            if process.poll() is not None:
                log = self.folder / f"{name}.log"
                last = " | ".join(log.read_text(errors="replace").splitlines()[-5:])
                raise IncompleteError(f"{name} ended with {process.returncode}; {log} ends with: {last}")

    def wait(self, condition, problem: str) -> None:
        """Wait for something that processes do."""
        end = time.monotonic() + START_LIMIT
        while not condition():
            self.check()
            if time.monotonic() > end:
                raise IncompleteError(f"{problem} after {START_LIMIT:g} s; see the logs in {self.folder}.")
            time.sleep(0.02)

    def restart(self, step: messages.StepValues) -> None:
        """A fresh move_base, at the robot's place, after its maps are filled."""
        for process in self.processes[1:]:
            stop(process)
        del self.processes[1:]
        remaps = "__name:=move_base odom:=/robot_odom laser:=/laser/scan cmd_vel:=/cmd_vel"
        script = f". devel/setup.sh && exec devel/lib/move_base/move_base {remaps}"
        self.start("move_base", ["/bin/sh", "-c", f"cd {shlex.quote(str(self.workspace))} && {script}"])

        def ready() -> bool:
            self.advance(step)
            return all(self.node.wanted(topic) for topic in (GOAL, "/robot_odom", "/tf", "/clock"))

        self.wait(ready, "move_base does not subscribe")
        for _ in range(SETTLE):
            self.advance(step)

    def advance(self, step: messages.StepValues) -> np.ndarray | None:
        """Publish a state, advance the clock by 0.1 s, and return the command that follows, if any."""
        for name in STATE:
            self.node.publish(name, self.table[name].message(step, self.time))
        self.mailbox.take_command()
        self.mailbox.commands = self.feedback = 0
        for _ in range(round(0.1e9 / TICK)):
            self.ticks += 1
            self.node.publish("/clock", self.table["/clock"].message(step, self.time))
            time.sleep(TICK_PAUSE)
        if self.active:
            self.mailbox.wait(ANSWER_LIMIT, for_command=True)
        return self.mailbox.take_command()

    def publish_goal(self, step: messages.StepValues) -> None:
        """Publish the goal, which preempts an earlier one."""
        self.active = True
        self.node.publish(GOAL, self.table[GOAL].message(step, self.time))

    def close(self) -> None:
        """End the processes."""
        if hasattr(self, "node"):
            self.node.close()
        for process in reversed(self.processes):
            stop(process)


def listens(port: int) -> bool:
    """Whether a server listens there."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def stop(process: subprocess.Popen) -> None:
    """End a process, within ten seconds."""
    process.terminate()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(5)


def drive_episode(world: World, ros: Ros, number: int) -> dict[str, Any]:
    """Drive one episode; returns its log."""
    state, step = world.reset(number)
    jax.block_until_ready(world.step(state, np.zeros(2, np.float32)))  # compile
    step = jax.device_get(step)
    ros.restart(step)
    first, rows, silent, period = ros.time / 1e9, [], 0, round(GOAL_PERIOD / 0.1)
    ros.recovery, ros.result, ros.plans = [], [], 0
    watch = Stopwatch()
    while not (state.completed or state.timed_out):
        ros.check()
        if len(rows) % period == 0:
            ros.publish_goal(step)
        command = ros.advance(step)
        silent += command is None
        rows.append(log_row(ros, step, round(len(rows) * 0.1, 1), command))
        action = np.full(2, math.nan, np.float32) if command is None else command
        state, step = world.step(state, action)
        step = jax.device_get(step)

    seconds = len(rows) * 0.1
    results = {name: finite(value) for name, value in world.results(state).items()}
    return {
        "episode": number,
        "completed": bool(state.completed),
        "seconds": round(seconds, 1),
        "start": rows[0][1:3],
        "goal": step.goal.tolist(),
        "geodesic": float(state.task.geodesic),
        "still": results["time_not_moving"][0],
        "rtf": seconds / watch.seconds,
        "silent": silent,
        "plans_per_s": ros.plans / seconds,
        "recovery": [[round(time - first, 2), name] for time, name in ros.recovery],
        "result": [[round(time - first, 2), status, text] for time, status, text in ros.result],
        "results": results,
        "stops": stops(rows, COLUMNS),
        "log": [[round(value, 5) if isinstance(value, float) else value for value in row] for row in rows],
    }


def log_row(ros: Ros, step: messages.StepValues, seconds: float, command: np.ndarray | None) -> list:
    """A moment of an episode, as ``COLUMNS``."""
    gaps = np.linalg.norm(step.people.position - step.position, axis=1)[step.people.present]
    pose = [*step.position.tolist(), math.atan2(step.heading[1], step.heading[0])]
    answer = [None, None] if command is None else command.tolist()
    nearest = float(gaps.min()) if len(gaps) else None
    return [seconds, *pose, *answer, ros.mailbox.commands, ros.feedback, nearest, int((gaps < NEAR).sum())]


def finite(value: Any) -> list[float | None]:
    """The numbers of a metric; None for those that are no number."""
    numbers = np.asarray(value, float).reshape(-1).tolist()
    return [None if math.isnan(number) else number for number in numbers]


def elsewhere(world: World, episodes: list[dict[str, Any]]) -> dict[int, list[float]]:
    """Number -> place [m] of the episodes that have another start or goal in this version or on this machine."""
    others = {}
    for episode in episodes:
        state, _ = world.reset(episode["episode"])
        start, geodesic = np.asarray(state.robot.position), float(state.task.geodesic)
        if not np.allclose([*start, geodesic], [*episode["start"][:2], episode["geodesic"]], atol=1e-3):
            others[episode["episode"]] = start.round(3).tolist()
    return others


def check_starts(world: World, driven: list[dict[str, Any]], file: Path) -> None:
    """Refuse episodes of a version whose episodes begin elsewhere.

    Raises:
        InputError: the first, the middle or the last of them.
    """
    for episode in driven[:: max(1, len(driven) // 2)]:
        for number, start in elsewhere(world, [episode]).items():
            text = f"episode {number} began at {episode['start'][:2]}, and begins at {start} in this version"
            raise InputError(f"{file}: {text}; drive all anew with another --out.")


def drive(chosen: argparse.Namespace) -> Path:
    """Drive the episodes that the file lacks; returns the file."""
    binary = chosen.workspace / "devel/lib/move_base/move_base"
    if not binary.is_file():
        raise InputError(f"{binary} is missing; build it: python benchmarks/move_base.py build --workspace ...")
    import_rospy()
    if importlib.util.find_spec("rosbags") is None:
        raise InputError('rosbags is missing; pip install "sean_jax[ros]"')
    if shutil.which("/usr/bin/rosmaster") is None:
        raise InputError("/usr/bin/rosmaster is missing; apt-get install python3-rosmaster")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the processes end too
    tree = parameters(chosen.sources, chosen.layers)
    names = ("environment", "people", "seed", "layers") if chosen.figure4 else OPTIONS
    options = {name: getattr(chosen, name) for name in names}
    options |= {"preset": "sean2", "behavior": chosen.figure4 or "graph"}
    chosen.out.mkdir(parents=True, exist_ok=True)
    layers = "_".join(chosen.layers) or "public"
    file = chosen.out / f"{chosen.figure4 or chosen.task}-{layers}-{chosen.seed}.json"
    commits = {name: commit for name, (_, commit) in CHECKOUTS.items()}
    content = {"options": options, "versions": versions() | commits, "columns": COLUMNS, "episodes": []}
    if file.is_file():
        content = read(file)
        if content["options"] != options:
            raise InputError(f"{file} has other options; give another folder with --out.")
    present = {episode["episode"] for episode in content["episodes"]}
    missing = [number for number in range(chosen.episodes) if number not in present]
    if not missing:
        return file
    world = World(chosen)
    check_starts(world, content["episodes"], file)
    with contextlib.closing(Ros(world, chosen, tree)) as ros:
        for number in missing:
            episode = drive_episode(world, ros, number)
            if chosen.figure4:
                del episode["log"]
            content["episodes"] = sorted([*content["episodes"], episode], key=lambda driven: driven["episode"])
            writing.write(file, content)
            print(f"{file.stem}: {line(episode)}", flush=True)
    return file


# --- summary ---


def read(file: Path) -> dict[str, Any]:
    """A file of episodes.

    Raises:
        InputError: it cannot be read.
    """
    try:
        content = json.loads(file.read_text())
        if not content["episodes"] or "results" not in content["episodes"][0]:
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"{file} has no episodes that `drive` wrote.") from error
    return content


def stops(rows: list, columns: Sequence[str], shortest: float = 5.0) -> list[dict[str, Any]]:
    """Where the robot stood for ``shortest`` seconds or more, and the shares of its answers there."""
    column = {name: np.array([row[k] if row[k] is not None else math.nan for row in rows], float)
              for k, name in enumerate(columns)}  # fmt: skip
    moves = np.hypot(np.diff(column["x"]), np.diff(column["y"])) > 1e-3
    edges = np.flatnonzero(np.concatenate([[True], moves, [True]]))
    intervals = []
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        if (last - first) * 0.1 >= shortest:
            speed, turn = column["speed"][first : last - 1], column["turn_rate"][first : last - 1]
            answers = (speed == 0) & (turn == 0), (speed == 0) & (turn != 0), np.isnan(speed)
            shares = {name: round(float(part.mean()), 3) for name, part in zip(ANSWERS, answers, strict=True)}
            place = [float(column[axis][first]) for axis in "xy"]
            begin, seconds = float(column["time"][first]), round((last - first) * 0.1, 1)
            intervals.append({"time": begin, "seconds": seconds, "place": place, **shares})
    return intervals


def line(episode: dict[str, Any]) -> str:
    """One episode in a line."""
    still, aborts = episode["results"]["time_not_moving"][0], sum(status == 4 for _, status, _ in episode["result"])
    ended = "completed" if episode["completed"] else "not completed"
    return (f"episode {episode['episode']}: {ended}, {episode['seconds']:.1f} s, still {still:.0f} s, "
            f"{len(episode['recovery'])} recoveries, {aborts} aborts, {episode['rtf']:.2f} x real time")  # fmt: skip


def summary(file: Path) -> dict[str, Any]:
    """The figures of a file of episodes."""
    content = read(file)
    episodes = content["episodes"]

    def mean(name: str) -> float:
        return float(np.mean([episode["results"][name][0] for episode in episodes]))

    still = np.array([episode["results"]["time_not_moving"][0] for episode in episodes])
    draws = np.random.default_rng(0).choice(still, (10_000, len(still))).mean(1)
    steps = sum(round(episode["seconds"] / 0.1) for episode in episodes)
    places = []
    for episode in episodes:
        episode_stops = episode["stops"] if "stops" in episode else stops(episode["log"], content["columns"])
        places += [{"episode": episode["episode"], **stop} for stop in episode_stops]
    return {
        "file": file.name,
        **content["options"],
        "episodes": len(episodes),
        "completed": float(np.mean([episode["completed"] for episode in episodes])),
        "still": [round(float(value), 1) for value in still],
        "still_mean": float(still.mean()),
        "still_interval": np.quantile(draws, (0.025, 0.975)).tolist(),
        "intimate": mean("intimate_robot_on_person") + mean("intimate_person_on_robot"),
        "personal": mean("personal_robot_on_person") + mean("personal_person_on_robot"),
        "collisions": mean("collision_robot_on_person"),
        "recoveries": sum(len(episode["recovery"]) for episode in episodes),
        "aborts": sum(status == 4 for episode in episodes for _, status, _ in episode["result"]),
        "silent": sum(episode["silent"] for episode in episodes) / steps,
        "plans_per_s": float(np.mean([episode["plans_per_s"] for episode in episodes])),
        "rtf": float(np.mean([episode["rtf"] for episode in episodes])),
        "stops": places,
        "stop_seconds": {name: sum(stop["seconds"] * stop[name] for stop in places) for name in ANSWERS},
        "versions": content["versions"],
    }  # fmt: skip


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table."""
    print(
        f"{'file':32} {'n':>3} {'done %':>6} {'still s':>8} {'95 %':>14} {'intim.':>6} {'pers.':>6} recoveries aborts"
    )
    for row in rows:
        low, high = row["still_interval"]
        print(f"{row['file']:32} {row['episodes']:3} {100 * row['completed']:6.0f} {row['still_mean']:8.1f} "
              f"{f'[{low:.1f}, {high:.1f}]':>14} {row['intimate']:6.2f} {row['personal']:6.1f} {row['recoveries']:10} "
              f"{row['aborts']:6}")  # fmt: skip
        print("    still s: " + " ".join(f"{value:.0f}" for value in row["still"]))
        seconds = ", ".join(f"{name} {value:.0f}" for name, value in row["stop_seconds"].items())
        print(f"    s of stops of 5 s and more, by command: {seconds}")
    print(f"paper: {PAPER} s")


# --- compare ---


def compare(chosen: argparse.Namespace) -> None:
    """Drive the re-makes, write the tables and print them.

    Raises:
        InputError: a file of the real move_base is missing, or the folder has another experiment.
    """
    experiment = figure4_options(chosen)
    work = Workspace(chosen.out, identity(experiment))
    real = {
        behavior: read(chosen.out / f"{behavior}-social_lidar-{chosen.seed}.json")["episodes"]
        for behavior in measures.BEHAVIORS
    }
    numbers = {behavior: [episode["episode"] for episode in episodes] for behavior, episodes in real.items()}
    if (had := work.load(IDENTITY)) is not None:
        refuse_difference(chosen.out, had, {"options": work.identity["options"]})
    else:
        work.save(IDENTITY, work.identity)

    values = drive_remakes(chosen, work, figure4.scenarios(experiment), real, numbers)
    equal = dict[str, list[int]]()  # numbers of the episodes that are the same here
    for behavior, episodes in real.items():
        others = elsewhere(World(argparse.Namespace(**vars(chosen) | {"figure4": behavior})), episodes)
        equal[behavior] = [number for number in numbers[behavior] if number not in others]
        print(f"{behavior}: {len(others)} of {len(episodes)} episodes begin elsewhere here, and have no pairs")

    pairs = {name: selected(by, numbers, equal) for name, by in values.items()}
    values = {name: selected(by, numbers, numbers) for name, by in values.items()}
    contrasts = "policy,other,behavior,episodes,measure,difference,low,high,d,p,holm"
    write_table(chosen.out / "figure4.csv", "policy,behavior,episodes,measure,mean,low,high", estimates(values))
    write_table(chosen.out / "contrasts.csv", contrasts, differences(pairs))
    for behavior, episodes in real.items():
        steady = [episode for episode in episodes if not episode["recovery"]]  # after an abort there are no commands
        commands = sum(10.0 * episode["seconds"] for episode in steady)
        silent = sum(episode["silent"] for episode in steady) / max(commands, 1.0)
        speed = np.mean([episode["rtf"] for episode in episodes])
        missing = f"{100 * silent:.1f} % of commands missing in {len(steady)} without recoveries"
        print(f"{behavior}: {len(episodes)} episodes, {missing}, {speed:.2f} x real time")


def drive_remakes(
    chosen: argparse.Namespace, work: Workspace, kinds: dict, real: dict[str, list], numbers: dict[str, list[int]]
) -> dict[str, dict[str, dict[str, np.ndarray]]]:
    """Driver -> behavior -> measure -> (E,) of the episodes that the real move_base drove."""
    values: dict[str, dict[str, dict[str, np.ndarray]]] = {REAL: {}, **{name: {} for name in REMAKES}}
    for behavior, episodes in real.items():
        columns, count = {}, max(numbers[behavior]) + 1
        for name, policy in REMAKES.items():  # one after the other: their programs differ
            file = f"episodes-{name}-{behavior}.json"
            if len((work.load(file) or {"completed": ()})["completed"]) < count:
                (work.folder / file).unlink(missing_ok=True)
            loaders = {name: [functools.partial(load_policy, policy, typed=True)]}
            columns |= figure4.drive(loaders, work, behavior, kinds[behavior], chosen.seed, count, lambda share: None)
        values[REAL][behavior] = measures.episode_measures(columns_of(episodes))[0]
        for name, driven in columns.items():
            by_measure = measures.episode_measures(driven)[0]
            values[name][behavior] = {measure: value[numbers[behavior]] for measure, value in by_measure.items()}
    return values


def write_table(path: Path, head: str, rows: list[tuple]) -> None:
    """Write a table and print it."""
    write_csv(path, head, rows)
    for row in (head.split(","), *rows):
        print(*(f"{cell:.3f}" if isinstance(cell, float | np.ndarray) else cell for cell in row))


def selected(
    by_behavior: dict[str, dict[str, np.ndarray]], numbers: dict[str, list[int]], chosen: dict[str, list[int]]
) -> dict[str, dict[str, np.ndarray]]:
    """behavior -> measure -> (E,) of the chosen episodes, and their mean over the scenarios, of the common numbers."""
    common = set.intersection(*map(set, chosen.values()))

    def cut(behavior: str, wanted: set[int] | list[int]) -> dict[str, np.ndarray]:
        rows = np.isin(numbers[behavior], list(wanted))
        return {measure: value[rows] for measure, value in by_behavior[behavior].items()}

    in_all = [cut(behavior, common) for behavior in measures.BEHAVIORS]
    mean = {measure: np.mean([columns[measure] for columns in in_all], 0) for measure in in_all[0]}
    return {behavior: cut(behavior, chosen[behavior]) for behavior in by_behavior} | {MEAN: mean}


def columns_of(episodes: list[dict[str, Any]]) -> measures.Columns:
    """The metrics of episodes that ``drive`` wrote, as those of the experiment: 0 where there is none."""
    columns = {}
    for name in measures.METRIC_NAMES:
        values = [episode[name] if name in episode else episode["results"][name] for episode in episodes]
        columns[name] = np.nan_to_num(np.array(values, float))
    return columns


def estimates(values: dict[str, dict[str, dict[str, np.ndarray]]]) -> list[tuple]:
    """Rows of each driver, scenario and measure, with the intervals of the experiment."""
    rows = []
    for name, by in values.items():
        for behavior, by_measure in by.items():
            for measure, value in by_measure.items():
                estimate = bootstrap.aggregate(value)
                if measure == "completed":  # a mean over scenarios is no share
                    estimate = bootstrap.of_share(estimate, where=behavior != MEAN)
                elif measure != "time_not_moving":
                    estimate = bootstrap.of_count(estimate)
                rows.append((name, behavior, len(value), measure, *estimate[:3]))
    return rows


def differences(values: dict[str, dict[str, dict[str, np.ndarray]]]) -> list[tuple]:
    """Rows of the real move_base less each re-make in the same episodes, with the tests of ``metrics.differences``."""
    rows = []
    for name in REMAKES:
        for behavior, by_measure in values[REAL].items():
            for measure, value in by_measure.items():
                gap = difference(values[name][behavior][measure], value, paired=True)
                assert gap is not None  # there are episodes
                figures = gap.difference, gap.low, gap.high, gap.effect, gap.p
                rows.append((REAL, name, behavior, len(value), measure, *figures))
    return [(*row, corrected) for row, corrected in zip(rows, holm([row[-1] for row in rows]), strict=True)]


def main(arguments: list[str] | None = None) -> None:
    """Build, drive, summarize or compare."""
    command = parser(__doc__)
    parts = command.add_subparsers(dest="part", required=True)
    builder = parts.add_parser("build", help="compile move_base in a workspace")
    driver = parts.add_parser("drive", help="drive episodes, and write their logs")
    for part in (builder, driver):
        add_options(
            part,
            sources=Option(None, "folder of the four checkouts", kind=Path, required=True),
            workspace=Option(None, "folder of the build", kind=Path, required=True),
        )
    driver.add_argument("--layers", nargs="*", choices=["social", "lidar"], default=["social", "lidar"])
    add_options(
        driver,
        out=Option(None, "folder of the logs", kind=Path, required=True),
        task=Option("join_group", choices=["join_group", "leave_group"]),
        figure4=Option(None, "drive this scenario of Figure 4 instead", choices=measures.BEHAVIORS),
        environment="warehouse",
        people=62,
        seed=5,
        episodes=10,
        port=Option(11404, "of the ROS master"),
    )
    table = parts.add_parser("summary", help="print and write figures")
    table.add_argument("files", nargs="+", type=Path)
    table.add_argument("--out", type=Path)
    pairs = parts.add_parser("compare", help="the real move_base and its re-makes in the same episodes of Figure 4")
    pairs.add_argument("out", type=Path, help="folder of `drive --figure4`")
    pairs.set_defaults(environment="warehouse", people=62, seed=0)
    chosen = command.parse_args(arguments)
    try:
        if chosen.part == "build":
            build(chosen.sources.resolve(), chosen.workspace.resolve())
        elif chosen.part == "drive":
            show([summary(drive(chosen))])
        elif chosen.part == "compare":
            compare(chosen)
        else:
            rows = [summary(file) for file in chosen.files]
            show(rows)
            if chosen.out is not None:
                words = "python benchmarks/move_base.py summary " + " ".join(row["file"] for row in rows)
                content = {"command": words, "cores": os.cpu_count(), "paper": PAPER, "conditions": rows}
                write_json(chosen.out, content)
    except SeanError as error:
        sys.exit(f"move_base.py: {error}")


if __name__ == "__main__":
    main()

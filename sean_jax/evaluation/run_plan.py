"""The plan of ``sean run``: the options are checked, and the files that they name are read, before anything is built.

An environment, a robot, forces and sensors in files are copied into the folder of the run, and config.yaml names the
copies. A recording may be large and stays where it is, as the folder of a policy does.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from sean_jax import robots, sensors
from sean_jax.config import Named, PlaybackBehavior, RunConfig, outside, user_parts
from sean_jax.config.flags import command
from sean_jax.config.input_files import InputFiles, sha256
from sean_jax.core.errors import InputError
from sean_jax.evaluation import compare
from sean_jax.evaluation.compare import SavedRun
from sean_jax.evaluation.run_folder import MAX_FILE, rename_files
from sean_jax.io import files, trajectories
from sean_jax.io.files import mjcf
from sean_jax.learning.policy import AGENTS, check_policy
from sean_jax.policies import POLICIES
from sean_jax.simulation.scenario_plan import ScenarioPlan, plan_scenario
from sean_jax.world import environment

MAX_COPY = 10_000_000  # bytes of an environment's or a robot's files; more stay where they are
ENDINGS = (".yaml", ".yml")  # of forces and sensors in a file
COPIED = ("environment", "robot", "forces", "sensors")  # options whose files are copied


@dataclass(frozen=True)
class RunPlan:
    """A run, with the names of its description resolved."""

    config: RunConfig  # for numbers and names
    scenario: ScenarioPlan
    identity: dict[str, Any]  # by which an unfinished run is resumed
    files: InputFiles
    code: InputFiles  # of the user's own parts
    description: dict[str, Any]  # field -> value, with absolute paths
    baseline: SavedRun | None

    @property
    def robots(self) -> int:
        """The number of robots in an episode."""
        return len(self.scenario.team) or 1

    def command(self, complete: bool = False) -> str:
        """The command that repeats the run; ``complete`` with every option."""
        return command("run", self.config, chosen=not complete)


def plan_run(config: RunConfig, is_driven: bool = False) -> RunPlan:
    """The plan of a run.

    Args:
        is_driven: whether a controller outside of this program is the policy.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    identity = identity_of(config)
    baseline = None if config.baseline is None else compare.read_run(config.baseline)
    if config.trajectories is not None:
        trajectories.check_packages(f".{config.trajectories}")
    for name in config.team:
        if name not in robots.ROBOTS:  # a file of a robot is not copied beside the results
            raise InputError(files.unknown_name("robots", name, robots.ROBOTS))

    scenario = plan_scenario(config, config.team or None)
    for policy in () if is_driven else config.policies:
        check_policy(policy, config)

    input_files, names = _read_inputs(config, scenario)
    description = rename_files(config.identity() | {"camera": config.camera}, names)
    plan = RunPlan(
        config=config,
        scenario=scenario,
        identity=identity,
        files=input_files,
        code=user_parts.input_files(config),
        description={name: value for name, value in description.items() if value is not None},
        baseline=baseline,
    )
    if config.camera is not None:
        _check_camera(plan.scenario, config.camera)
    return plan


def identity_of(config: RunConfig) -> dict[str, Any]:
    """The identity of an unfinished run, but for versions, device and content.

    Raises:
        InputError: a file of the user's own cannot be read.
    """
    options = config.identity() | {"batch": min(config.batch, config.episodes)}
    return {"options": options, "parts": user_parts.digests(config)}


def _check_camera(scenario: ScenarioPlan, camera: str) -> None:
    """Refuse a camera that a robot of the package or of a file does not have."""
    for component, robot in zip(scenario.config.robot_parts, scenario.robots, strict=True):
        if isinstance(component, Named):
            try:
                sensors.camera(robots.load(robot), camera)
            except ValueError as error:
                raise InputError(str(error)) from error


# ------------------------------------------------------------------ files


def _read_inputs(config: RunConfig, scenario: ScenarioPlan) -> tuple[InputFiles, dict[str, str]]:
    """The files that a description names, but for code; and file or folder as it is named -> its absolute path.

    Raises:
        InputError: a file cannot be read.
    """
    inputs = InputFiles({}, {}, {})
    names = dict[str, str]()
    for option, name, path, sources in _named_files(config, scenario):
        names[name] = name if name in environment.available() else os.path.abspath(path)
        root = Path(os.path.abspath(path if path.is_dir() else path.parent))
        absolute = [Path(os.path.abspath(source)) for source in sources]
        contents = {source: files.read_bytes(source, MAX_FILE) for source in absolute}

        # Large files stay where they are, as do those that a scene reads from elsewhere.
        is_small = sum(map(len, contents.values())) <= MAX_COPY
        is_inside = all(source.is_relative_to(root) for source in contents)
        if not (option in COPIED and is_small and is_inside):
            for source, content in contents.items():
                inputs.hashes[str(source)] = sha256(content)
            continue

        count = sum(copy.startswith(option) for copy in inputs.copies.values())
        place = f"{option}_{count + 1}" if count else option
        copy = f"{place}/{path.name}"
        inputs.copies[names[name]] = copy
        folder = copy if path.is_dir() else place
        for source, content in contents.items():
            inside = source.relative_to(root).as_posix()
            inputs.content[f"{folder}/{inside}"] = content
    return inputs, names


def _named_files(config: RunConfig, scenario: ScenarioPlan) -> Iterator[tuple[str, str, Path, list[Path]]]:
    """Option, name and path of each file and folder of a description but for code; and the files that are read for it.

    Those of a policy are in the fingerprint.
    """
    if scenario.folders:  # else a set of worlds, which is generated from its name
        folder = scenario.folders[0]
        sources = [source for folder in scenario.folders for source in environment.sources(folder)]
        yield "environment", config.environment, folder if len(scenario.folders) == 1 else folder.parent, sources
    for robot in config.robot_parts:
        if isinstance(robot, Named) and robot.kind not in robots.ROBOTS:
            path = Path(robot.kind)
            yield "robot", robot.kind, path, [path, *mjcf.sources(path)]
    for option, parts in (("forces", config.forces), ("sensors", config.sensors)):
        for part in parts:
            if isinstance(part, Named) and part.kind.lower().endswith(ENDINGS):
                yield option, part.kind, Path(part.kind), [Path(part.kind)]
    for policy in config.policies:
        if isinstance(policy, Named) and not (policy.kind in POLICIES or policy.kind in AGENTS or outside(policy)):
            yield "policy", policy.kind, Path(policy.kind), []
    behavior = config.behavior
    if isinstance(behavior, PlaybackBehavior) and behavior.recording is not None:
        yield "behavior", behavior.recording, Path(behavior.recording), [Path(behavior.recording)]


def write_config(folder: Path, about: dict[str, Any], plan: RunPlan | None, fingerprint: str = "") -> None:
    """Write config.yaml, by which ``sean run --config`` repeats the run, and copies of its input files beside it.

    Args:
        about: names of the scenario, the number of people and the versions.
        plan: of ``sean run``; None for an evaluation in Python.
        fingerprint: of the scenario and the policy.
    """
    content: dict[str, Any] = {}
    if plan is not None:
        content["command"] = plan.command(complete=True)
        content["config"] = plan.code.describe(json.loads(json.dumps(plan.description)))
        content["copies"] = plan.files.copies
        content["sha256"] = plan.code.bundle(folder) | plan.files.bundle(folder)
        content["fingerprint"] = fingerprint
    else:
        content["made by"] = "a Python program with values of its own, which a file cannot repeat"
        content["scenario"] = about["scenario"]
    content |= {name: about[name] for name in ("people", "versions")}
    text = yaml.safe_dump(content, sort_keys=False, width=1000)
    (folder / "config.yaml").write_text(text, encoding="utf-8")

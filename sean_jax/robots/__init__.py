"""Robots (Fig. 3): one MJCF file each in ``envs/robots``, closed-form, in MJX or kinematic; and whole bodies in MJX."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core import padding
from sean_jax.core.data_types import Mount, RobotModel, Scenario
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.robots import description
from sean_jax.robots import dynamics as physics
from sean_jax.robots.drive import drive_kinematic, drive_mjx, drive_twin, physics_steps, place
from sean_jax.robots.whole_body import articulated
from sean_jax.world.environment import ENVS

ROBOTS: dict[str, Path] = {path.stem: path for path in sorted((ENVS / "robots").glob("*.xml"))}
BACKWARD = {"max_reverse_speed": "max_speed", "max_deceleration": "max_acceleration"}
"""Limit that a robot may lack -> the limit that holds then."""
DYNAMICS = {"twin": drive_twin, "mjx": drive_mjx, "kinematic": drive_kinematic}


def load(robot: str | Path, dynamics: str = "twin") -> RobotModel:
    """Load a robot.

    Args:
        robot: a name in ``ROBOTS``, or the path of an MJCF file.
        dynamics: "twin" for the closed form, "mjx" for the same law by MJX, or "kinematic" for a robot without
            inertia.

    Raises:
        InputError: the name, the dynamics or the file does not exist, or the file does not describe a planar base of
            its drive with all of its limits.
    """
    path = find(robot, dynamics)
    model, fields, mass = description.read_robot(path)
    data = physics.mjx_data(model, jnp.asarray(mass, fields["mass"].dtype)) if dynamics == "mjx" else ()
    return RobotModel(**fields, data=data, name=path.stem, place=place, drive=DYNAMICS[dynamics])


def find(robot: str | Path, dynamics: str = "twin") -> Path:
    """The file of a robot; name and dynamics as in ``load``.

    Raises:
        InputError: the name, the dynamics or the file does not exist.
    """
    if dynamics not in DYNAMICS:
        raise InputError(f"unknown dynamics {dynamics!r}{_hint(dynamics, DYNAMICS)}")
    path = ROBOTS.get(str(robot), Path(robot))
    if not path.is_file():
        hint = _hint(str(robot), ROBOTS)
        if path.suffix == ".xml":
            raise InputError(f"no robot file {str(robot)!r}{hint} The path of an MJCF file works as well as a name.")
        raise InputError(f"unknown robot {str(robot)!r}{hint} The path of an MJCF file works as well as a name.")
    return path


def radius(model: RobotModel) -> float:
    """The radius [m] of a robot on the host, to a micrometre, as its file has it."""
    return round(float(model.radius), 6)


def radii(scenario: Scenario) -> list[float]:
    """The radii [m] of the robot, and of the other robots of its team."""
    others = [] if scenario.others is None else np.round(np.asarray(scenario.others.radius, float), 6).tolist()
    return [radius(scenario.robot), *others]


def alike(models: Sequence[RobotModel]) -> list[RobotModel]:
    """Robots that differ in numbers alone, for one program: each moves as before, under the names of all.

    They keep the mounts of sensors that all of them have, with the same rotation and field of view.

    Raises:
        InputError: they do not go together.
    """
    first, *others = models
    if not others:
        return [first]
    for model in others:
        _check_alike(first, model)
    if any(jax.tree.leaves(model.data) for model in models):
        raise InputError(f"dynamics: MJX moves one robot in a program, not {len(models)}; choose twin or kinematic.")

    # A limit that some robots have is a leaf of all.
    for name, default in BACKWARD.items():
        if any(getattr(model, name) is not None for model in models):
            models = [_with_limit(model, name, default) for model in models]

    sizes = padding.common_sizes(models)
    names = ",".join(dict.fromkeys(model.name for model in models))
    models = [
        replace(model, name=names, mounts=mounts) for model, mounts in zip(models, _shared_mounts(models), strict=True)
    ]
    return [padding.pad(model, sizes) for model in models]


def _check_alike(first: RobotModel, second: RobotModel) -> None:
    """InputError unless one program can move both robots."""
    names = f"{first.name} and {second.name}"
    if second.time_step != first.time_step:
        steps = f"{first.time_step:g} and {second.time_step:g} s"
        raise InputError(f"robot: {names} have physics steps of {steps}; robots of one program need the same.")
    if second.drive_type != first.drive_type:
        drives = f"{first.drive_type} and {second.drive_type}"
        raise InputError(f"robot: {names} are {drives}; robots of one program need the same drive.")
    if (second.place, second.drive) != (first.place, first.drive):
        raise InputError(f"robot: {names} move by different functions; robots of one program need the same.")


def _with_limit(model: RobotModel, name: str, default: str) -> RobotModel:
    """The robot with a limit, which is another limit if it has none."""
    if getattr(model, name) is not None:
        return model
    return replace(model, **{name: getattr(model, default)})


def _shared_mounts(models: Sequence[RobotModel]) -> list[tuple[Mount, ...]]:
    """The mounts of each robot that all have; they are low if those of all are."""
    by_place = [{(mount.name, mount.axes, mount.fovy): mount for mount in model.mounts} for model in models]
    shared = [place for place in by_place[0] if all(place in mounts for mounts in by_place)]
    low = {place: all(mounts[place].low for mounts in by_place) for place in shared}
    return [tuple(replace(mounts[place], low=low[place]) for place in shared) for mounts in by_place]


def _hint(name: str, choices: Iterable[str]) -> str:
    """The end of a message about an unknown name: the choice most like it, or all choices."""
    return files.suggest(name, choices) or f"; there are: {', '.join(choices)}."


__all__ = ["DYNAMICS", "ROBOTS", "alike", "articulated", "find", "load", "physics_steps", "radius"]

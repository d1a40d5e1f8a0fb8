"""Robots (Fig. 3): one MJCF file each in ``envs/robots``, simulated by closed-form twins, by MJX or kinematic."""

from collections.abc import Iterable
from pathlib import Path

import jax.numpy as jnp

from sean_jax import files
from sean_jax.base import RobotModel
from sean_jax.environment import ENVS
from sean_jax.errors import InputError
from sean_jax.robots import description
from sean_jax.robots import dynamics as physics
from sean_jax.robots.drive import drive_kinematic, drive_mjx, drive_twin, physics_steps, place

ROBOTS: dict[str, Path] = {path.stem: path for path in sorted((ENVS / "robots").glob("*.xml"))}
DYNAMICS = {"twin": drive_twin, "mjx": drive_mjx, "kinematic": drive_kinematic}


def load(robot: str | Path, dynamics: str = "twin") -> RobotModel:
    """Load a robot.

    Args:
        robot: a name in ``ROBOTS``, or the path of an MJCF file.
        dynamics: "twin" for the closed form, "mjx" for the same law by MJX, or "kinematic" for a robot without
            inertia.

    Raises:
        InputError: the name, the dynamics or the file does not exist, or the file does not describe a planar
            differential-drive base with all of its limits.
    """
    path = find(robot, dynamics)
    model, fields, mass = description.read(path)
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
        problem = f"no robot file {str(robot)!r}" if path.suffix == ".xml" else f"unknown robot {str(robot)!r}"
        raise InputError(f"{problem}{_hint(str(robot), ROBOTS)} The path of an MJCF file works as well as a name.")
    return path


def radius(model: RobotModel) -> float:
    """The radius [m] of a robot on the host, to a micrometre, as its file has it."""
    return round(float(model.radius), 6)


def _hint(name: str, choices: Iterable[str]) -> str:
    """The end of a message about an unknown name: the choice most like it, or all choices."""
    return files.suggest(name, choices) or f"; there are: {', '.join(choices)}."


__all__ = ["DYNAMICS", "ROBOTS", "find", "load", "physics_steps", "radius"]

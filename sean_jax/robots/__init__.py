"""Robots (Fig. 3): one MJCF file each in ``envs/robots``, simulated by MJX or by their closed-form twins."""

import difflib
from pathlib import Path

import jax.numpy as jnp

from sean_jax.base import RobotModel
from sean_jax.environment import ENVS
from sean_jax.robots import description, mjx_dynamics
from sean_jax.robots.drive import drive_mjx, drive_twin, place

ROBOTS: dict[str, Path] = {path.stem: path for path in sorted((ENVS / "robots").glob("*.xml"))}
DYNAMICS = {"mjx": drive_mjx, "twin": drive_twin}


def load(robot: str | Path, dynamics: str = "mjx") -> RobotModel:
    """The robot of that name in ``ROBOTS``, or of that MJCF file, moved by ``dynamics``: "mjx" or "twin".

    Raises ValueError, in one sentence, for an unknown name or dynamics, a missing file, and a file that describes no
    planar differential-drive base with all of its limits.
    """
    path = find(robot, dynamics)
    model, figures, mass = description.read(path)
    data = mjx_dynamics.put(model, jnp.asarray(mass, figures["mass"].dtype)) if dynamics == "mjx" else ()
    return RobotModel(**figures, data=data, name=path.stem, place=place, drive=DYNAMICS[dynamics])


def find(robot: str | Path, dynamics: str = "mjx") -> Path:
    """The file of a robot. Raises ValueError, in one sentence, for an unknown name or dynamics, and a missing file."""
    if dynamics not in DYNAMICS:
        raise ValueError(f"unknown dynamics {dynamics!r}{_meant(dynamics, DYNAMICS)}")
    path = ROBOTS.get(str(robot), Path(robot))
    if not path.is_file():
        problem = f"no robot file {str(robot)!r}" if path.suffix == ".xml" else f"unknown robot {str(robot)!r}"
        raise ValueError(f"{problem}{_meant(str(robot), ROBOTS)} The path of an MJCF file works as well as a name.")
    return path


def check_step(model: RobotModel, time_step: float) -> None:
    """Raises ValueError if a step of control [s] is no multiple of the robot's step of physics."""
    if abs(round(time_step / model.time_step) * model.time_step - time_step) > 1e-6:
        raise ValueError(f"time_step: {time_step:g} s is no multiple of {model.name}'s step of {model.time_step:g} s.")


def _meant(wrong: str, right: dict) -> str:
    """How a message about a wrong name goes on: with the name that was probably meant, or with all there are."""
    close = difflib.get_close_matches(wrong, right, n=1)
    return f"; did you mean {close[0]!r}?" if close else f"; there are: {', '.join(right)}."

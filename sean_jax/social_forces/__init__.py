"""Social forces (section IV-D, low level): how people keep a distance from people, walls, groups and the robot.

A sum of terms (``forces``), each with its own parameters: ``[*preset("helbing1995"), mine]``.
"""

from sean_jax.social_forces.forces import Crowd, Forces, GatherTerm, Pair, PairTerm, PersonTerm, Term, Walking
from sean_jax.social_forces.model import draw_traits, individualize, integrate, move
from sean_jax.social_forces.presets import PRESETS, build, preset, with_parameters
from sean_jax.social_forces.reactions import Kind, Reactions
from sean_jax.social_forces.terms import (
    Cohesion,
    Evasion,
    GroupSpace,
    Headway,
    Noise,
    Repulsion,
    RobotRepulsion,
    Sidestep,
)
from sean_jax.social_forces.walls import SUBSTEP, Contact, Walls, longest_step, substeps

__all__ = [
    "PRESETS",
    "SUBSTEP",
    "Cohesion",
    "Contact",
    "Crowd",
    "Evasion",
    "Forces",
    "GatherTerm",
    "GroupSpace",
    "Headway",
    "Kind",
    "Noise",
    "Pair",
    "PairTerm",
    "PersonTerm",
    "Repulsion",
    "Reactions",
    "RobotRepulsion",
    "Sidestep",
    "Term",
    "Walking",
    "Walls",
    "build",
    "draw_traits",
    "individualize",
    "integrate",
    "longest_step",
    "move",
    "preset",
    "substeps",
    "with_parameters",
]

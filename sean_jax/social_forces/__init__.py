"""Social forces (section IV-D, low level): how people keep apart from people, walls, groups and the robot.

A sum of terms (``terms``), each with parameters of its own: ``[*preset("helbing1995"), mine]``.
"""

from sean_jax.social_forces.cohesion import Cohesion
from sean_jax.social_forces.constants import build
from sean_jax.social_forces.contact import SUBSTEP, Contact, longest_step, substeps
from sean_jax.social_forces.evasion import Evasion
from sean_jax.social_forces.groups import GroupSpace
from sean_jax.social_forces.headway import Headway
from sean_jax.social_forces.model import draw_traits, integrate, move
from sean_jax.social_forces.presets import PRESETS, preset
from sean_jax.social_forces.repulsion import Repulsion
from sean_jax.social_forces.robot_repulsion import RobotRepulsion
from sean_jax.social_forces.sidestep import Sidestep
from sean_jax.social_forces.terms import Crowd, Forces, GatherTerm, Pair, PairTerm, PersonTerm, Term
from sean_jax.social_forces.walking import Walking
from sean_jax.social_forces.walls import Walls

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
    "Pair",
    "PairTerm",
    "PersonTerm",
    "Repulsion",
    "RobotRepulsion",
    "Sidestep",
    "Term",
    "Walking",
    "Walls",
    "build",
    "draw_traits",
    "integrate",
    "longest_step",
    "move",
    "preset",
    "substeps",
]

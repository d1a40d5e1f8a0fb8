"""Social forces (section IV-D, low level): how people keep apart from people, walls, groups and the robot."""

from sean_jax.social_forces.model import advance, move
from sean_jax.social_forces.parameters import PRESETS, Parameters, preset
from sean_jax.social_forces.stability import SUBSTEP, longest_step, substeps
from sean_jax.social_forces.traits import draw_traits

__all__ = ["PRESETS", "SUBSTEP", "Parameters", "advance", "draw_traits", "longest_step", "move", "preset", "substeps"]

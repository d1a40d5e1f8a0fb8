"""Pedestrian models (section IV-D, low level): how people get where the behavior directs them."""

from sean_jax import social_forces
from sean_jax.pedestrian_models.constant_velocity import constant_velocity
from sean_jax.pedestrian_models.orca import orca

MODELS = {"social_forces": social_forces.move, "constant_velocity": constant_velocity, "orca": orca}
"""name -> (scenario, state) -> Pedestrians one control step later"""

__all__ = ["MODELS"]

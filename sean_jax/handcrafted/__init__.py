"""Handcrafted sets (section IV-D): people's loops and groups, and the robot's poses, chosen by hand for a situation.

``annotation`` reads and checks handcrafted.yaml, ``sets`` makes arrays of it.
"""

from sean_jax.handcrafted.annotation import ALL, ARRIVED, read
from sean_jax.handcrafted.sets import Sets

__all__ = ["ALL", "ARRIVED", "Sets", "read"]

"""Handcrafted sets (section IV-D): people's loops and groups, and the robot's poses, chosen by hand for a situation.

``annotation`` is what handcrafted.yaml may say, ``validation`` reads and checks it, ``sets`` makes arrays of it.
"""

from sean_jax.handcrafted.annotation import ALL
from sean_jax.handcrafted.sets import Sets
from sean_jax.handcrafted.validation import ARRIVED, read

__all__ = ["ALL", "ARRIVED", "Sets", "read"]

"""Handcrafted sets (section IV-D): people's loops and groups, and the robot's poses, chosen by hand for a situation."""

from sean_jax.handcrafted.sets import Sets

__all__ = ["Sets"]

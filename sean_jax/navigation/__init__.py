"""Shortest paths around obstacles, exact for discs: tables over the bends of grown obstacles, looked up inside jit."""

from sean_jax.navigation.people import CLOSE, Towards, ahead, next_point_roughly, towards
from sean_jax.navigation.plan import bend_to_goal, plan
from sean_jax.navigation.sight import SLACK, sees
from sean_jax.navigation.tables import CELL, CODE, MOST_CELLS, Navigation, build, inputs
from sean_jax.navigation.ways import geodesic, geodesic_roughly, next_point, to_goal, turning

__all__ = [
    "CELL",
    "CLOSE",
    "CODE",
    "MOST_CELLS",
    "SLACK",
    "Navigation",
    "Towards",
    "ahead",
    "bend_to_goal",
    "build",
    "geodesic",
    "geodesic_roughly",
    "inputs",
    "next_point",
    "next_point_roughly",
    "plan",
    "sees",
    "to_goal",
    "towards",
    "turning",
]

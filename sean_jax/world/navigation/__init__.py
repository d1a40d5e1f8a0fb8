"""Shortest paths around obstacles, exact for discs: tables over the corners of inflated obstacles, looked up in jit."""

from sean_jax.world.navigation.arcs import segment_is_free, segments_are_free
from sean_jax.world.navigation.free_places import PLACES, draw_places, draw_uniform_places
from sean_jax.world.navigation.next_corner_table import (
    CLOSE,
    NextCornerTable,
    build_next_corner_table,
    next_corner,
    next_point_approx,
)
from sean_jax.world.navigation.shortest_paths import (
    build_paths_to_goal,
    geodesic,
    geodesic_approx,
    last_arc_to_goal,
    next_point,
    path_rotation,
    plan,
)
from sean_jax.world.navigation.tables import CELL, CODE, Navigation, build, inputs

__all__ = [
    "CELL",
    "CLOSE",
    "CODE",
    "PLACES",
    "Navigation",
    "NextCornerTable",
    "build",
    "build_next_corner_table",
    "build_paths_to_goal",
    "draw_places",
    "draw_uniform_places",
    "geodesic",
    "geodesic_approx",
    "inputs",
    "last_arc_to_goal",
    "next_corner",
    "next_point",
    "next_point_approx",
    "path_rotation",
    "plan",
    "segment_is_free",
    "segments_are_free",
]

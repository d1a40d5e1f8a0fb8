"""Pictures of a scenario from above: stills, heat maps and animations (Figs. 1 and 2 of the paper); videos of cameras.

The robot is an orange square and people are discs, as in Fig. 2. x points right, y up the page, distances are metres.
Situations and policies may have any names. Nothing here touches pyplot's global state, and matplotlib is imported only
when something is drawn.
"""

from sean_jax.drawing.colors import policy_colors, situation_colors
from sean_jax.drawing.gifs import animate, video
from sean_jax.drawing.pictures import (
    congestion_map,
    empty_floor,
    graph_sheet,
    handcrafted_sheet,
    heat_map,
    top_down,
    view,
)
from sean_jax.graph import graph_of

__all__ = [
    "animate",
    "congestion_map",
    "empty_floor",
    "graph_of",
    "graph_sheet",
    "handcrafted_sheet",
    "heat_map",
    "policy_colors",
    "situation_colors",
    "top_down",
    "video",
    "view",
]

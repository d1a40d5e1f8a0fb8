"""Ray casting for cameras and lidars (section IV-F).

``make_view`` transforms all bodies to the frame of a sensor. ``search`` finds the first body that each ray of a bundle
meets. ``surface`` gives distance and normal there.
"""

from sean_jax.sensors.raycast.intersect import along, attach, distance, search, search_behind, surface
from sean_jax.sensors.raycast.view import MISS, SHOULDER, Rays, View, bundle, by_rows, make_view

__all__ = [
    "MISS",
    "SHOULDER",
    "Rays",
    "View",
    "along",
    "attach",
    "bundle",
    "by_rows",
    "distance",
    "make_view",
    "search",
    "search_behind",
    "surface",
]

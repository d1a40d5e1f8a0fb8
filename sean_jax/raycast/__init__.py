"""Ray casting for cameras and lidars (section IV-F).

``make_view`` transforms all bodies to the frame of a sensor. ``search`` finds the first body that each ray of a bundle
meets. ``surface`` gives distance and normal there.
"""

from sean_jax.raycast.bodies import MISS, View, make_view
from sean_jax.raycast.intersect import along, distance, search, surface
from sean_jax.raycast.rays import Rays, bundle, by_rows

__all__ = ["MISS", "Rays", "View", "along", "bundle", "by_rows", "distance", "make_view", "search", "surface"]

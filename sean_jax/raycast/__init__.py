"""Ray casting for cameras and lidars (section IV-F).

``make_view`` transforms all bodies to the frame of a sensor. ``search`` finds the first body that each ray of a bundle
meets. ``surface`` gives distance and normal there. ``distance`` is the distance of ``search`` with the gradient of
``surface``.
"""

from functools import partial

import jax
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.raycast.intersect import along, nearest, search, surface
from sean_jax.raycast.laws import MISS
from sean_jax.raycast.rays import Rays, bundle, by_rows
from sean_jax.raycast.view import View, make_view

__all__ = ["MISS", "Rays", "View", "along", "bundle", "by_rows", "distance", "make_view", "search", "surface"]


def distance(view: View, rays: Rays) -> Float[Array, "tiles rays"]:
    """The distance along each ray to the first body.

    The gradient is that of the distance to this body: exact within its outline, finite on edges.

    Returns:
        (tiles, rays) m; ``MISS`` where a ray meets no body.
    """
    return _distance(rays, view)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _distance(rays: Rays, view: View) -> Array:
    return nearest(view, rays)


@_distance.defjvp
def _move(rays: Rays, primals: tuple[View], tangents: tuple[View]) -> tuple[Array, Array]:
    here = jax.lax.stop_gradient(primals[0])
    distances, number = search(here, rays)
    return distances, jax.jvp(lambda view: surface(view, rays, number)[0], primals, tangents)[1]

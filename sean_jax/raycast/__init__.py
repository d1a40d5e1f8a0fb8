"""Rays against everything that can be seen (section IV-F): what cameras and lidars are made of.

``look`` puts all bodies around a sensor, ``search`` finds what each ray of a bundle meets first, ``surface`` says where
and how steep it is there; ``distance`` is the first and the second in one, with the gradient of the third.
"""

from functools import partial

import jax

from sean_jax.base import Array
from sean_jax.raycast.laws import MISS
from sean_jax.raycast.meeting import along, nearest, search, surface
from sean_jax.raycast.rays import Rays, bundle, by_rows
from sean_jax.raycast.view import View, look

__all__ = ["MISS", "Rays", "View", "along", "bundle", "by_rows", "distance", "look", "search", "surface"]


def distance(view: View, rays: Rays) -> Array:
    """(T, P) m along each ray to what it meets first, ``MISS`` where that is nothing.

    Its gradient in the view is that of the distance to the body that each ray meets: exact but on edges, finite there.
    """
    return _distance(rays, view)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _distance(rays: Rays, view: View) -> Array:
    return nearest(view, rays)


@_distance.defjvp
def _move(rays: Rays, primals: tuple[View], tangents: tuple[View]) -> tuple[Array, Array]:
    here = jax.lax.stop_gradient(primals[0])
    found, number = search(here, rays)
    return found, jax.jvp(lambda view: surface(view, rays, number)[0], primals, tangents)[1]

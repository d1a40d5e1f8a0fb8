"""Free segments: whether a disc can move straight from one place to another, past boxes inflated by its radius."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PyTree

from sean_jax.base import Array, Obstacles
from sean_jax.geometry import crosses_box, from_box

SLACK = 5e-4  # m, by which a path may pass nearer than the radius: far above rounding in float32, too little to matter
BATCH = 8192  # rows computed at once on the host


def segment_is_free(
    boxes: Obstacles, start: Float[Array, "2"], end: Float[Array, "2"], radius: Float[Array, ""] | float
) -> Bool[Array, ""]:
    """Whether a disc can move straight from one place to another; exact.

    Args:
        start: (2,) m.
        end: (2,) m.
        radius: m, of the disc.

    Returns:
        () bool.
    """
    hit = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))(
        start[0], start[1], end[0], end[1], boxes, radius
    )
    return ~hit.any()


def segments_are_free(
    boxes: Obstacles,
    start: Float[Array, "2"],
    x: Float[Array, "V"],
    y: Float[Array, "V"],
    radius: Float[Array, ""] | float,
) -> Bool[Array, "V"]:
    """``segment_is_free`` between one place and several others.

    Args:
        start: (2,) m.
        x: (V,) m, of the other places.
        y: (V,) m.
        radius: m, of the disc.
    """
    hit = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))(start[0], start[1], x, y, boxes, radius)
    return ~hit.any(0)  # over the first axis: several times faster on a CPU than over the last


def push_out_of_obstacles(
    boxes: Obstacles, place: Float[Array, "2"], radius: Float[Array, ""] | float
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Move a place out of the inflated boxes, in which the tables know no path.

    Args:
        place: (2,) m.
        radius: m, of the disc.

    Returns:
        (2,) m the place itself, or the nearest one found outside; its gradient is that of the place. And () m the
        radius with which segments from there have to be free, which is smaller where there is too little room.
    """
    if boxes.yaw.shape[0] == 0:
        return place, jnp.full_like(place[0], jnp.maximum(radius - SLACK, 0.0))
    spot = place
    for _ in range(2):
        distance, nx, ny = jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)
        nearest = jnp.argmin(distance)
        out = jnp.maximum(radius - distance[nearest], 0.0)
        spot = spot + out * jnp.stack([nx[nearest], ny[nearest]])
    clearance = jnp.min(jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)[0], initial=jnp.inf)
    free_radius = jnp.maximum(jnp.minimum(radius, clearance) - SLACK, 0.0)
    # Without the barrier XLA computes the spot again for each pair of a point and a box, and compiles for minutes.
    shift, free_radius = jax.lax.optimization_barrier(jax.lax.stop_gradient((spot - place, free_radius)))
    return place + shift, free_radius


def pairs_are_free(
    boxes: Obstacles, radius: float, starts: Float[np.ndarray, "K 2"], ends: Float[np.ndarray, "K 2"]
) -> Bool[np.ndarray, "K"]:
    """``segment_is_free`` for many pairs, on the host.

    Args:
        radius: m, of the disc.
        starts: (K, 2) m.
        ends: (K, 2) m.
    """
    return map_in_batches(_pair_is_free, (boxes, jnp.asarray(radius, float)), starts, ends)


def _pair_is_free(shared: tuple[Obstacles, Array], start: Array, end: Array) -> Array:
    boxes, radius = shared
    return segment_is_free(boxes, start, end, radius)


def map_in_batches(function: Callable, shared: PyTree, *rows: np.ndarray) -> PyTree:
    """Apply a function to each of many rows, batch by batch. It is compiled once for all numbers of rows.

    Args:
        function: (shared, row, ...) -> pytree; at module level, or it is compiled at each call.
        rows: (K, ...) each, the further arguments.

    Returns:
        The results, stacked as numpy arrays (K, ...).
    """
    rows = tuple(each.astype(float) if each.dtype.kind == "f" else each for each in rows)  # jit casts to its precision
    parts = []
    for start in range(0, max(len(rows[0]), 1), BATCH):
        part = [each[start : start + BATCH] for each in rows]
        count = len(part[0])
        padded = [np.pad(each, [(0, BATCH - count)] + [(0, 0)] * (each.ndim - 1)) for each in part]
        parts.append(jax.tree.map(lambda each: np.asarray(each)[:count], _map(function, shared, *padded)))  # noqa: B023
    return jax.tree.map(lambda *each: np.concatenate(each), *parts)


@functools.partial(jax.jit, static_argnums=0)
def _map(function: Callable, shared: PyTree, *rows: Array) -> PyTree:
    return jax.vmap(lambda *row: function(shared, *row))(*rows)

"""Sight: whether a disc can move straight from one place to another, past boxes grown by its radius."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.base import Array, Obstacles
from sean_jax.geometry import crosses_box, from_box

SLACK = 5e-4  # m, by which a way may pass nearer than the radius: far more than float32 rounds, too little to matter
BATCH = 8192  # rows in one part


def sees(boxes: Obstacles, p: Array, q: Array, radius: Array | float) -> Array:
    """() bool: a disc of that radius [m] can move straight from p (2,) to q (2,), exactly."""
    hit = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))(p[0], p[1], q[0], q[1], boxes, radius)
    return ~hit.any()


def sees_each(boxes: Obstacles, place: Array, x: Array, y: Array, radius: Array | float) -> Array:
    """(V,) bool: ``sees`` from a place (2,) to the points (x, y) [m] (V,) and (V,), or back."""
    hit = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))(place[0], place[1], x, y, boxes, radius)
    return ~hit.any(0)  # over the first axis: several times faster on a CPU than over the last


def led_out(boxes: Obstacles, place: Array, radius: Array | float) -> tuple[Array, Array]:
    """(2,) [m] the place (2,), led out of the grown boxes if it is inside, and () [m] how near ways from it may pass.

    That is the radius, or less where there is no room for it. Gradients are those of the place itself.
    """
    if boxes.yaw.shape[0] == 0:
        return place, jnp.full_like(place[0], jnp.maximum(radius - SLACK, 0.0))
    spot = place
    for _ in range(2):
        distance, nx, ny = jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)
        nearest = jnp.argmin(distance)
        out = jnp.maximum(radius - distance[nearest], 0.0)
        spot = spot + out * jnp.stack([nx[nearest], ny[nearest]])
    room = jnp.min(jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)[0], initial=jnp.inf)
    near = jnp.maximum(jnp.minimum(radius, room) - SLACK, 0.0)
    # Kept apart, or XLA finds the spot anew for each pair of a point and a box, and compiles for minutes.
    shift, near = jax.lax.optimization_barrier(jax.lax.stop_gradient((spot - place, near)))
    return place + shift, near


def pairs_see(boxes: Obstacles, radius: float, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(K,) ``sees`` for many pairs p and q (K, 2); on the host."""
    return in_parts(_pair_sees, (boxes, jnp.asarray(radius, float)), p, q)


def _pair_sees(shared: tuple, p: Array, q: Array) -> Array:
    boxes, radius = shared
    return sees(boxes, p, q, radius)


def in_parts(function: Callable, shared: Any, *rows: np.ndarray) -> Any:
    """``function(shared, row, ...)`` of each of the rows (K, ...), as numpy arrays; part by part, on the host.

    Compiled once for all numbers of rows; ``function`` is at module level, or it is compiled each time.
    """
    rows = tuple(each.astype(float) if each.dtype.kind == "f" else each for each in rows)  # which jit makes its own
    parts = []
    for start in range(0, max(len(rows[0]), 1), BATCH):
        part = [each[start : start + BATCH] for each in rows]
        count = len(part[0])
        padded = [np.pad(each, [(0, BATCH - count)] + [(0, 0)] * (each.ndim - 1)) for each in part]
        parts.append(jax.tree.map(lambda each: np.asarray(each)[:count], _each(function, shared, *padded)))  # noqa: B023
    return jax.tree.map(lambda *each: np.concatenate(each), *parts)


@functools.partial(jax.jit, static_argnums=0)
def _each(function: Callable, shared: Any, *rows: Array) -> Any:
    return jax.vmap(lambda *row: function(shared, *row))(*rows)

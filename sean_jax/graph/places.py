"""Where in a node's disc people can stand (section IV-D: goals are points of the disc, not its centre)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from sean_jax import cache
from sean_jax.base import Array, Environment
from sean_jax.geometry import crosses_box, signed_distances_on_host

CODE = "graph/places", "geometry"  # that the places depend on
PERSON = 0.25  # m, kept free around a place: a body of 0.2 m and some room
NUMBER = 64  # places a node
ROUND = 256  # candidates a node in one round
FULL_ROUNDS = 4  # with candidates from the whole disc, before discs shrink
SHRINK = 0.7  # of the disc's radius, each later round


def in_sight(environment: Environment, center: Float[Array, "P 2"], points: Float[Array, "P 2"]) -> Bool[Array, "P"]:
    """Whether a person can walk straight from a centre to a point, pair by pair.

    Args:
        center: (P, 2) m.
        points: (P, 2) m.
    """
    each_box = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))
    each_pair = jax.vmap(each_box, in_axes=(0, 0, 0, 0, None, None))
    px, py, qx, qy = center[:, 0], center[:, 1], points[:, 0], points[:, 1]
    return ~jnp.any(each_pair(px, py, qx, qy, environment.obstacles, PERSON), axis=1)


def places(environment: Environment, position: np.ndarray, radius: np.ndarray, seed: int = 0) -> np.ndarray:
    """Points uniform over the part of each node's disc that is free and in sight of its centre.

    They are drawn on the host, outside jit, once for all processes. Where a disc has too little room, the rest are
    points nearer to its centre, which must be clear of obstacles and of the floor's edge by more than the radius of a
    person.

    Args:
        position: (M, 2) m, of the nodes.
        radius: (M,) m, of their discs.

    Returns:
        (M, 64, 2) m, float32.

    Raises:
        ValueError: the centre of a node is not clear.
    """
    boxes = environment.obstacles
    inputs = environment.floor, boxes.center, boxes.half_extent, boxes.yaw, position, radius, seed
    return cache.load_or_build("places", CODE, inputs, lambda: {"places": _draw(environment, position, radius, seed)})[
        "places"
    ]


def _draw(environment: Environment, position: np.ndarray, radius: np.ndarray, seed: int) -> np.ndarray:
    """As ``places``."""
    count = len(position)
    generator = np.random.default_rng(seed)
    chosen = [np.zeros((0, 2), np.float32) for _ in range(count)]
    radius = np.array(radius, np.float64)
    center = jnp.asarray(np.repeat(np.asarray(position, np.float32), ROUND, axis=0), float)
    rounds = 0
    while min(len(points) for points in chosen) < NUMBER:
        distance = np.sqrt(generator.uniform(size=(count, ROUND))) * radius[:, None]
        angle = generator.uniform(0.0, 2.0 * np.pi, (count, ROUND))
        offset = np.stack([distance * np.cos(angle), distance * np.sin(angle)], -1)
        drawn = (np.asarray(position, np.float64)[:, None, :] + offset).astype(np.float32)
        flat = drawn.reshape(-1, 2)
        visible = jax.jit(in_sight)(environment, center, jnp.asarray(flat, float))  # seconds less than op by op
        free = (np.asarray(visible) & (signed_distances_on_host(environment, flat)[1] >= PERSON)).reshape(count, ROUND)
        chosen = [np.concatenate([old, new[ok]])[:NUMBER] for old, new, ok in zip(chosen, drawn, free, strict=True)]
        rounds += 1
        if rounds >= FULL_ROUNDS:
            radius *= SHRINK
        if rounds > 100:
            raise ValueError("a node's centre is not clear of obstacles.")
    return np.stack(chosen)

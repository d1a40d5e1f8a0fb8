"""Clusters of people: k-means by Lloyd's iterations, and the person in the middle of the largest (section IV-E)."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array


def k_means(points: Array, counted: Array, start: Array, iterations: int = 10) -> tuple[Array, Array]:
    """Centres (k, 2) [m] of the ``counted`` (N,) bool among the points (N, 2) [m], and labels (N,) int32.

    Lloyd's iterations from the centres ``start`` (k, 2): everybody is labelled by the nearest centre, the first of
    equally near ones; then centres move to the mean of theirs, and one without any stays. The labels are those that
    the last move was made from. Who is not counted has the label -1.
    """
    number = start.shape[0]

    def once(centers: Array, _) -> tuple[Array, None]:
        mine = (_labels(points, centers)[:, None] == jnp.arange(number, dtype=jnp.int32)[None, :]) & counted[:, None]
        size = mine.sum(0, dtype=float)
        total = jnp.where(mine[:, :, None], points[:, None, :], 0.0).sum(0)
        mean = total / jnp.maximum(size, 1.0)[:, None]
        return jnp.where(size[:, None] > 0.0, mean, centers), None

    before = jax.lax.scan(once, start, length=iterations - 1)[0]
    after = once(before, None)[0]
    return after, jnp.where(counted, _labels(points, before), -1)


def busiest(points: Array, counted: Array, key: Array, number: int = 3) -> Array:
    """() int32 the medoid of the largest of three clusters: who has the least sum of distances to all others of it.

    The first centres are people drawn at random. An index of somebody not counted if nobody is.
    """
    chance = jnp.where(counted, jax.random.uniform(key, counted.shape, float), -1.0)
    # With fewer points than clusters, the last one stands for more of them, which then stay empty.
    order = jnp.argsort(-chance)[jnp.minimum(jnp.arange(number), counted.shape[0] - 1)]
    _, label = k_means(points, counted, points[order])
    size = (label[:, None] == jnp.arange(number, dtype=jnp.int32)[None, :]).sum(0, dtype=jnp.int32)
    mine = label == jnp.argmax(size).astype(jnp.int32)
    gaps = points[:, None, :] - points[None, :, :]
    apart = jnp.sqrt((gaps * gaps).sum(-1))
    total = jnp.where(mine[None, :], apart, 0.0).sum(1)
    return jnp.argmin(jnp.where(mine, total, jnp.inf)).astype(jnp.int32)


def _labels(points: Array, centers: Array) -> Array:
    """(N,) int32 index of the nearest centre of each point."""
    gaps = points[:, None, :] - centers[None, :, :]
    return jnp.argmin((gaps * gaps).sum(-1), axis=1).astype(jnp.int32)

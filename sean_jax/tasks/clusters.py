"""Clusters of people: k-means by Lloyd's iterations, and the person in the middle of the largest (section IV-E)."""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array


def k_means(
    points: Float[Array, "N 2"], counted: Bool[Array, "N"], start: Float[Array, "K 2"], iterations: int = 10
) -> tuple[Float[Array, "K 2"], Int[Array, "N"]]:
    """Clusters by Lloyd's iterations.

    Each point is labelled by the nearest centre, the first of equally near ones. Then each centre moves to the mean of
    its points, and one without any stays.

    Args:
        points: (N, 2) m.
        start: (K, 2) m, the first centres.

    Returns:
        Centres (K, 2) m, and labels (N,) from which they moved last, -1 of who is not counted.
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


def busiest(points: Float[Array, "N 2"], counted: Bool[Array, "N"], key: Array, number: int = 3) -> Int[Array, ""]:
    """The medoid of the largest cluster: the person with the smallest sum of distances to all others of it.

    Args:
        points: (N, 2) m, of people.
        key: of the draw of people who are the first centres.

    Returns:
        () index of the person, of somebody not counted if nobody is.
    Source: section IV-E.
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


def _labels(points: Float[Array, "N 2"], centers: Float[Array, "K 2"]) -> Int[Array, "N"]:
    """(N,) index of the nearest centre of each point."""
    gaps = points[:, None, :] - centers[None, :, :]
    return jnp.argmin((gaps * gaps).sum(-1), axis=1).astype(jnp.int32)
